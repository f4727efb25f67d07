"""How many neighbours matter: what the omitted ones would change, and how many shells the frequencies need.

It is an assumption that one shell of neighbours is enough. Here the frequencies with a few shells are compared with those with
all neighbours, at given wavevectors. All neighbours are summed by Ewald's method if the law has a tail
(`magphonon.stiffness.all_neighbours`), otherwise directly, up to the last of `REACHES`. A table of forces goes on from its end
(`interactions.Tabulated`), and `NeighbourShifts.known` says so.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from ..interactions.bond_laws import Laws, laws_of
from ..lattices.bonds import ON_SHELL, SHELL_WIDTH, Bonds, bonds_within, clear_shells, distances_within
from ..stiffness.all_neighbours import MOST_BONDS, TAIL, AllNeighbours, nearest_distance, tail_of
from ..stiffness.matrices import (
    bloch_matrix,
    hermitian_eigenvalues,
    interaction_along,
    lossless_modes,
    mass_weighted,
    signed_root,
)
from ..stiffness.rest import LinearSystem
from ..traits import LINEAR, takes
from .bloch import bloch_modes

REACHES = {1: (19.3, 75.3), 2: (12.3, 24.3), 3: (3.3, 6.3)}
"""Distances in spacings up to which neighbours are counted one by one, by the number of periods; the second one is used if the
first is not enough.  It includes about a thousand bonds of each particle, whose sum takes as long as Ewald's sum over all
neighbours."""
LOW, SOFT = 0.01, 0.1
"""Below the first fraction of the highest frequency, shifts are given relative to that fraction and not to the frequency itself:
near buckling a frequency is the small difference of large terms, and at Gamma it is zero.  Below the second one a frequency needs
no more shells than there: to know it better would take hundreds, and forces and foundations that nobody measures so well."""
MOST_TRIED, FEW = (400, 40), 8
"""Largest number of shells, in cells of a FEW particles and in larger ones. In the latter positions may be irregular, so that
every distance is a shell."""


@dataclass(frozen=True)
class NeighbourShifts:
    """Frequencies of a lattice with the neighbours in its bond list, and with all neighbours.

    Attributes
    ----------
    omega, every : ndarray, shape (wavevectors, branches)
        In rad/ms, with the neighbours in the bond list (`omega`) and with all (`every`); negative for unstable modes.
    known : bool
        Whether the law was measured at all distances that were needed; if not, it was continued from its end.
    """

    omega: np.ndarray
    every: np.ndarray
    known: bool

    @property
    def relative(self) -> NDArray[np.float64]:
        """How much each frequency rises with all neighbours, as a fraction of itself; for very low frequencies see `LOW`."""
        return (self.every - self.omega) / np.maximum(abs(self.omega), LOW * abs(self.every).max())


@takes('all neighbours', *{*LINEAR} - {'conventional', 'radii'})
def neighbour_shifts(atoms: Atoms, q: ArrayLike) -> NeighbourShifts:
    """How the frequencies of a lattice change if all neighbours repel each other.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator or AllNeighbours; of a layer, only waves in its plane count.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.bands import neighbour_shifts
    >>> shear, longitudinal = neighbour_shifts(read_scene('prototype').atoms(), [[0.5, 0, 0]]).relative[0]
    >>> round(float(shear), 3), round(float(longitudinal), 3)  # M: 58.2 Hz become 67.5, and 149.5 become 150.5
    (0.158, 0.007)
    """
    atoms, q = _in_plane(LinearSystem.of(atoms).atoms), np.reshape(np.asarray(q, dtype=float), (-1, 3))
    omega = bloch_modes(atoms, q, 'complete')[0]
    if not atoms.calc.pairwise:
        return NeighbourShifts(omega, omega, True)
    every, known = _every(atoms, q)
    return NeighbourShifts(omega, every, known)


@dataclass(frozen=True)
class ConvergedShells:
    """The number of shells that the frequencies of a lattice need.

    Attributes
    ----------
    shells : int
    cutoff : float
        A distance in mm between the last shell that is counted and the next one.
    error : float
        Largest relative error of a frequency with these shells, half of that of its square; for low frequencies see `SOFT`.
    clear : bool
        Whether the shells are clearly separated (`find_bonds`); if not, the cutoff says which neighbours are meant.
    """

    shells: int
    cutoff: float
    error: float
    clear: bool


@takes('all neighbours', *{*LINEAR} - {'conventional', 'radii'})
def converged_shells(atoms: Atoms, q: ArrayLike, tolerance: float) -> ConvergedShells:
    """The smallest number of shells that, like every larger number, gives each frequency to within a tolerance.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator, of any number of shells.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    tolerance : float
        Allowed relative error of a frequency due to omitted neighbours.

    Returns
    -------
    ConvergedShells
        If even all shells that can be counted are not enough, the result has all of them and an `error` above the tolerance.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.bands import converged_shells
    >>> cell = read_scene('prototype').atoms()
    >>> [converged_shells(cell, [[0.5, 0, 0]], tolerance).shells for tolerance in (0.2, 0.01, 0.001)]
    [1, 4, 12]
    """
    atoms, q = _in_plane(atoms), np.reshape(np.asarray(q, dtype=float), (-1, 3))
    every, _ = _every(atoms, q)
    for reach in REACHES[int(atoms.pbc.sum())]:
        shells = neighbour_shells(atoms, reach)
        ends, starts = (np.array([end(shell.lengths) for shell in shells]) for end in (np.max, np.min))
        gaps = np.append(starts[1:], (1 + 2 * SHELL_WIDTH) * ends[-1]) - ends
        tried = np.flatnonzero(gaps > 4 * ON_SHELL * ends)
        most = MOST_TRIED[len(atoms) > FEW]
        if len(tried) > most:  # about evenly spaced over the logarithm of the distance
            wanted = np.geomspace(ends[0], ends[-1], most)
            tried = np.unique(tried[np.minimum(np.searchsorted(ends[tried], wanted), len(tried) - 1)])
        parts: Any = [sum(_bloch(atoms, shells[k], q, 0.0 if k else atoms.calc.foundation) for k in range(first, last + 1))
                 for first, last in zip(np.append(0, tried[:-1] + 1), tried, strict=True)]
        omega = _omega(atoms, np.cumsum(parts, axis=0))
        squares, right = omega * abs(omega), every * abs(every)
        errors = (abs(squares - right) / (2 * np.maximum(abs(right), SOFT**2 * abs(right).max()))).max(axis=(1, 2))
        good = np.maximum.accumulate(errors[::-1])[::-1] <= tolerance  # with more shells, too, and not by accident
        if good.any():
            break
    k = int(good.argmax()) if good.any() else len(errors) - 1
    n = int(tried[k])
    around = np.unique(np.concatenate([shell.lengths for shell in shells]))
    clear = n + 1 == len(shells) or bool(clear_shells(atoms, around, [n + 1]))
    return ConvergedShells(n + 1, float(ends[n] + gaps[n] / 2), float(errors[k]), clear)


def whole_reach(atoms: Atoms, laws: Laws) -> float:
    """Cutoff in mm that includes all pairs of a finite structure. If there are too many pairs, or the structure is periodic, it
    includes all pairs up to the distance to which the law is known or from which its tail is used.
    """
    nearest = nearest_distance(atoms)
    extent = 1.01 * float(np.linalg.norm(np.ptp(atoms.positions, axis=0)))
    every = not atoms.pbc.any() and len(atoms) ** 2 / 2 < MOST_BONDS
    r = distances_within(atoms, extent if every else TAIL * nearest)
    r = r[: np.searchsorted([not is_known(laws, x) for x in r[:: max(1, len(r) // 512)]], True) * max(1, len(r) // 512)]
    if every and len(r) and is_known(laws, extent):
        return float(extent)
    gaps = np.flatnonzero(np.diff(r) > 4 * ON_SHELL * r[1:])
    return float(r[gaps[-1] : gaps[-1] + 2].mean()) if len(gaps) else float(1.001 * nearest)


def neighbour_shells(atoms: Atoms, reach: float) -> list[Bonds]:
    """The bonds of each neighbour shell, as a list of Bonds, within `reach` spacings and as far as the law is known."""
    calc: Any = atoms.calc
    every = bonds_within(calc.reference, reach * calc.bonds.lengths.min())
    order = np.argsort(every.lengths, kind='stable')
    lengths = every.lengths[order]
    ends = np.flatnonzero(np.diff(lengths) > SHELL_WIDTH * lengths[1:]) + 1
    shells = [every.among(s) for s in np.split(order, ends)]
    return shells[: sum(is_known(calc.laws, shell.lengths.max()) for shell in shells)]


def is_known(laws: Laws, r: float) -> bool:
    """Whether all laws have a force at a distance in mm; a law of your own may end."""
    try:
        for law in laws_of(laws):
            _planar(law).dphi(r)
    except ValueError:
        return False
    return True


def _measured(laws, r):
    """Whether all laws were measured up to a distance in mm, and not continued from the end of a table."""
    return all(r <= getattr(_planar(law), 'farthest', np.inf) for law in laws_of(laws))


def _planar(law: Any) -> Any:
    """The law as a function of the distance; for upright magnets, their law within the plane."""
    return law.central(2) if hasattr(law, 'central') else law


def _in_plane(atoms):
    """The atoms at the reference of their calculator; a layer loses its motion out of the plane."""
    calc = atoms.calc.in_plane() if atoms.calc.layer else atoms.calc
    return LinearSystem.about(calc, atoms).atoms


def _bloch(atoms, bonds, q, foundation=0.0):
    calc = atoms.calc
    interaction = interaction_along(calc.laws, bonds, calc.reference.get_tags(), calc.strengths, calc.dim)
    D0, Dstar = interaction.stiffness(bonds.vectors[:, : calc.dim])
    return bloch_matrix(bonds, D0 + Dstar, q, foundation)


def _omega(atoms, D):
    if not (atoms.constraints or atoms.calc.turning):
        return signed_root(hermitian_eigenvalues(mass_weighted(D, atoms.get_masses())))
    system = LinearSystem.about(atoms.calc, atoms)
    shapes = system.shapes.toarray()
    K = shapes.T @ D @ shapes
    return lossless_modes(system.B().toarray(), K)[0] if system.turning else signed_root(np.linalg.eigvalsh(K))


def with_all(atoms: Atoms) -> tuple[Atoms | None, bool]:
    """The atoms of a plane with AllNeighbours, or None if their law has no tail; and whether the law is known far enough."""
    calc: Any = atoms.calc
    if isinstance(calc.laws, Mapping):
        return None, True
    law, known = _planar(calc.laws), _measured(calc.laws, TAIL * nearest_distance(atoms))
    tail = tail_of(law, atoms)
    if tail is None or tail.decay <= 0:
        return None, known
    every = atoms.copy()
    every.calc = AllNeighbours(calc.reference, law, foundation=calc.foundation, strengths=calc.strengths, dim=calc.dim)
    return every, known


def _every(atoms, q):
    """Frequencies with all neighbours, and whether the law is known at all distances that they need."""
    calc, (sums, known) = atoms.calc, with_all(atoms)
    if sums is not None:
        return _omega(atoms, sums.calc.bloch_matrix(q)), known
    first, *others = neighbour_shells(atoms, REACHES[int(atoms.pbc.sum())][-1])
    known = known and _measured(calc.laws, REACHES[int(atoms.pbc.sum())][-1] * first.lengths.max())
    return _omega(atoms, sum((_bloch(atoms, shell, q) for shell in others), _bloch(atoms, first, q, calc.foundation))), known
