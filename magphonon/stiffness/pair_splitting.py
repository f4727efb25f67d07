"""D0 and D* of a structure with any ASE calculator that sums over pairs: its pair law is read off two atoms.

An energy that is a sum over pairs, `E = sum phi(r_ij)`, has the stiffness D0 + D* for each pair (Eq. 3).  A many-body
energy has no unique D*: the six distances among four points in a plane obey one equation. A multiple of this equation, added to
the energy, changes the force in each pair and so D*, but no force on any point.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field, replace
from itertools import combinations_with_replacement
from typing import Any

import ase.units
import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator, all_changes
from ase.neighborlist import neighbor_list
from numpy.typing import NDArray

from ..errors import finite, positive
from .calculator import PairCalculator

MM = 1e-7  # per Angstrom
MJ = ase.units._e / 1e-3  # per eV
GRAM = ase.units._amu * 1e3  # per amu
STEP = 1e-3
"""Step of the differences for the curvature, relative to the distance: of fourth order, so off by 1e-9 for a law as steep as
r^-13, while round-off of the forces is some 1e-13.  It is smaller near the end of the forces, which often end by a jump."""
LEAST_STEP = 1e-8  # of a pair at the very end, which `find_bonds` refuses
SHAKEN = 0.02  # standard deviation of the places at which forces are compared, in shortest distances
SAME = 1e-6  # difference of forces, in largest forces, above which they are no sum over pairs
FEW = 64  # atoms of a cell below which forces are compared in twice the cell along each period: a single atom cannot be shaken
BOX = 4.0  # sides of the cell around two atoms, in their distances, for calculators that need one
FARTHEST = 30.0  # shortest distances within which the force of a pair must have ended, if no cutoff is given


@dataclass(frozen=True, eq=False)
class PairOf:
    """The pair law of two atoms according to an ASE calculator, in mm and mJ.

    Its slope is a force of the calculator, its curvature a difference of two forces. No difference is taken across the distance
    `end`, beyond which the atoms do not act on each other.
    """

    calculator: Calculator
    symbols: tuple[str, str]
    end: float = np.inf
    _known: dict[float, tuple[float, float]] = field(default_factory=dict, repr=False, compare=False)

    def _of(self, r: Any, which: int) -> NDArray[np.float64]:
        r = np.asarray(r, float)
        for apart in {*r.ravel().tolist()} - self._known.keys():
            two = Atoms(self.symbols, [[0, 0, 0], [apart / MM, 0, 0]])
            try:
                self.calculator.calculate(two, ['energy', 'forces'], all_changes)  # directly: comparing atoms takes as long again
            except np.linalg.LinAlgError:  # matscipy and LAMMPS need a cell; lists of others take long in a small one
                two.cell = BOX * apart / MM * np.eye(3)
                self.calculator.calculate(two, ['energy', 'forces'], all_changes)
            found = self.calculator.results
            self._known[apart] = found['energy'] * MJ, found['forces'][0, 0] * MJ / MM
        return np.array([self._known[apart][which] for apart in r.ravel().tolist()]).reshape(r.shape)

    def phi(self, r: Any) -> NDArray[np.float64]:
        """Energy in mJ of two atoms at the distances `r` in mm."""
        return self._of(r, 0)

    def dphi(self, r: Any) -> NDArray[np.float64]:
        """Slope of the energy in N."""
        return self._of(r, 1)

    def slopes(self, r: NDArray[np.float64]) -> NDArray[np.float64]:
        """`dphi` at many distances, shape (distances,), by one calculation of pairs too far apart to act on each other."""
        if np.isinf(self.end) or not len(r):
            return self.dphi(r)
        side, step = int(np.ceil(np.sqrt(len(r)))), 2 * (self.end + r.max())
        places = np.zeros((len(r), 2, 3))
        places[:, :, 1], places[:, :, 2] = (step * k[:, None] for k in np.divmod(np.arange(len(r)), side))
        places[:, 1, 0] = r
        many = Atoms(self.symbols * len(r), places.reshape(-1, 3) / MM, cell=np.diag([step, side * step, side * step]) / MM)
        self.calculator.calculate(many, ['energy', 'forces'], all_changes)
        return self.calculator.results['forces'][::2, 0] * MJ / MM

    def d2phi(self, r: Any) -> NDArray[np.float64]:
        """Curvature of the energy in N/mm."""
        r = np.asarray(r, float)
        h = np.clip(abs(self.end - r) / (3 * r), LEAST_STEP, STEP)
        near, far = (self.dphi(r * (1 + k * h)) - self.dphi(r * (1 - k * h)) for k in (1, 2))
        return (8 * near - far) / (12 * h * r)


def split(atoms: Atoms, cutoff: float | None = None) -> Atoms:
    """The same structure with a calculator that separates D0 and D*, for any ASE calculator that is a sum over pairs.

    Every tool of this package accepts the result: bands of both models, the Hessian by parts, sound speeds, the verdict.

    Parameters
    ----------
    atoms : ase.Atoms
        In ASE's units (Angstrom, eV, amu), with a calculator: Lennard-Jones, Morse, pair potentials of matscipy or LAMMPS.
    cutoff : float, optional
        Distance in Angstrom within which atoms interact; by default the distance at which the force between two atoms ends.

    Returns
    -------
    ase.Atoms
        A copy in mm, g and ms with a PairCalculator, so that its frequencies are given in Hz.  Each element is a kind.

    Raises
    ------
    ValueError
        If the forces on the shaken structure are not a sum over its pairs, as with embedded-atom, bond-order and
        machine-learned potentials; the message says by how much.  Also if no cutoff is given and the force never ends.

    Examples
    --------
    >>> from ase.build import bulk
    >>> from ase.calculators.lj import LennardJones
    >>> from magphonon import analytic_bands
    >>> from magphonon.stiffness import split
    >>> argon = bulk('Ar', 'fcc', a=5.256)
    >>> argon.calc = LennardJones(sigma=3.4, epsilon=0.0103, rc=7.5)
    >>> both = [analytic_bands(split(argon), 'GX', model).frequencies_Hz[-1, 0] / 1e12 for model in ('complete', 'conventional')]
    >>> [round(float(f), 3) for f in both]  # the transverse branch at X in THz: D* lowers it by 3 %
    [1.389, 1.431]
    """
    if atoms.calc is None:
        raise ValueError('the atoms carry no calculator to split; attach a calculator of ASE that is a sum over pairs')
    symbols = atoms.get_chemical_symbols()
    kinds = sorted(set(symbols))
    finite('positions', atoms.positions)
    grid = _shortest(atoms) * MM * np.arange(1, FARTHEST, 0.2)
    if cutoff is not None:
        last = positive('cutoff', cutoff, 'Angstrom') * MM * (1 + 3 * STEP)
        grid = np.append(grid[grid < last], last)
    laws = {(a, b): _ended(PairOf(atoms.calc, (kinds[a], kinds[b])), grid)
            for a, b in combinations_with_replacement(range(len(kinds)), 2)}
    tags = [kinds.index(symbol) for symbol in symbols]
    here = Atoms(atoms.symbols, atoms.positions * MM, cell=atoms.cell.array * MM, pbc=atoms.pbc, tags=tags,
                 masses=atoms.get_masses() * GRAM)
    here.set_constraint(atoms.constraints)
    reach = _reach(laws.values(), grid[-1]) if cutoff is None else cutoff * MM
    _refuse_many_bodies(atoms, tags, laws, reach)
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', message='a mass of')  # atoms are denser than magnets, and their units are right
        here.calc = PairCalculator(here, laws if len(kinds) > 1 else laws[0, 0], cutoff=reach)
    return here


def _shortest(atoms):
    """The shortest distance between two atoms in Angstrom."""
    cutoff = 1.0
    while not len(found := neighbor_list('d', atoms, cutoff)):
        cutoff *= 2
        if cutoff > 1e6:
            raise ValueError('no two of these atoms are near each other: there is no pair to split')
    if not (shortest := found.min()):
        raise ValueError('two of these atoms coincide; move one of them')
    return shortest


def _ended(law: PairOf, grid: NDArray[np.float64]) -> PairOf:
    """The law with its end, if no force is left at the last of the distances `grid` in mm."""
    acting = np.flatnonzero(law.dphi(grid))
    if len(acting) and acting[-1] == len(grid) - 1:
        return law
    inside, outside = (grid[acting[-1]], grid[acting[-1] + 1]) if len(acting) else (0.0, grid[0])
    while outside - inside > 1e-9 * outside:
        middle = (inside + outside) / 2
        inside, outside = (middle, outside) if law.dphi(middle) != 0 else (inside, middle)
    return replace(law, end=outside)


def _reach(laws, farthest):
    """Distance in mm beyond which no pair of atoms acts."""
    for law in laws:
        if np.isinf(law.end):
            raise ValueError(f'the atoms {" and ".join(law.symbols)} still act on each other {farthest / MM:.3g} Angstrom apart: '
                             'give a cutoff= in Angstrom')
    return max(law.end for law in laws)


def _refuse_many_bodies(atoms, tags, laws, reach):
    """Refuse a calculator whose forces on the shaken structure differ from the sum over its pairs.

    A few atoms of a periodic cell are also shaken in two cells along each direction, where images move apart.
    """
    rng, largest, apart = np.random.default_rng(0), 0.0, 0.0
    for cells in {(1, 1, 1), tuple(2 if periodic and len(atoms) < FEW else 1 for periodic in atoms.pbc.tolist())}:
        shaken = atoms.repeat(cells)
        shaken.set_constraint()
        shaken.positions += SHAKEN * _shortest(atoms) * rng.normal(size=(len(shaken), 3))
        shaken.calc = atoms.calc
        forces = shaken.get_forces() * MJ / MM
        which = np.tile(tags, len(shaken) // len(atoms))
        i, j, r, R = neighbor_list('ijdD', shaken, reach / MM)
        sums = np.zeros_like(forces)
        for (a, b), law in laws.items():
            mine = (np.minimum(which[i], which[j]) == a) & (np.maximum(which[i], which[j]) == b)
            np.add.at(sums, i[mine], (law.slopes(r[mine] * MM) / r[mine])[:, None] * R[mine])
        largest, apart = max(largest, abs(forces).max()), np.maximum(apart, abs(forces - sums).max())
    if not apart <= SAME * largest:  # nor NaN
        raise ValueError(f'{type(atoms.calc).__name__} is not a sum over pairs: when the atoms are shaken by {SHAKEN:.0%} of '
                         f'their distance, its forces differ from those of all pairs within {reach / MM:.4g} Angstrom by up to '
                         f'{apart / largest:.2g} of the largest. D* is defined only for energies that are functions of the '
                         'distances of pairs')
