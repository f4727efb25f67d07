"""Normal modes of a structure about its rest, `K y = omega^2 y` (`magphonon.stiffness.rest`): all modes, the lowest ones, or
those in a gap of the lattice, which are local modes of defects, walls and edges; and how far each mode extends.
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass

import numpy as np
from ase import Atoms
from ase.cell import Cell
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.spatial import KDTree

from .. import units
from ..errors import Unstable, finite, refuse_memory, whole
from ..results import InHertz, Saved
from ..stiffness.lowest import MATRICES, ROUND_OFF, eigenpairs_between, lowest_eigenpairs, lowest_mode
from ..stiffness.matrices import lossless_modes, signed_root
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, LINEAR, takes

SMALL = 300
"""Largest number of degrees of freedom of a structure that is diagonalised; above it, products with its matrix are cheaper."""

MOST_DIRECTIONS = 3000
"""Largest number of free directions for which `lowest_and_local` computes all modes."""
MOST_TURNING = 1500  # the same limit with gyroscopic forces: matrices are complex and of twice the size
LOWEST = 60  # number of the lowest modes of a larger patch
BY_PRODUCTS = 16000
"""Number of free directions from which products with K find modes sooner than its factors, if its bonds lie on a grid: four times
as soon at 19 000, where loading the compiled code takes as long again, in a quarter of the memory at 200 000.  In a periodic
structure many waves have the same frequency, which takes products eight times as long."""

EQUAL = 1e-11  # difference of squared frequencies, as a fraction of the largest entry of K, up to which they are equal
WELL = 0.37  # about a third, but no ratio that symmetry can produce, because round-off would then decide


@dataclass(frozen=True)
class Modes(InHertz, Saved, kind='modes', units={
    'omega': ('rad/ms', 'modes'), 'shapes': ('g^-1/2', 'modes', 'particles', 'dim'),
}):
    """Natural frequencies and mode shapes of a structure.

    Attributes
    ----------
    omega : ndarray, shape (modes,)
        Ascending, in rad/ms; for an unstable mode, minus its growth rate.
    shapes : ndarray, shape (modes, particles, dim)
        Displacements in g^-1/2, normalised so that `sum m |u|^2 = 1`. If the particles are gyroscopes the shapes are complex, for
        the motion `Re u e^{-i omega t}`.  Modes are the same on every machine, if all modes of equal frequency are computed: the
        sign is positive at the first particle and axis that moves by more than a third of the largest motion. Among modes of
        equal frequency only the first moves there, and the rule is repeated for the others.
    """

    omega: np.ndarray
    shapes: np.ndarray


@takes(*LINEAR)
def modes(atoms: Atoms | LinearSystem, count: int | None = None) -> Modes:
    """Natural frequencies and mode shapes about rest, within the constraints.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        With PairCalculator.
    count : int, optional
        Number of lowest modes to compute; by default all. In a large structure they are found without diagonalising it, and none
        is missed: the signs of pivots count them, or a random vector shows that there is no other
        (`chebyshev.lowest_by_products`).

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> found = modes(patch)
    >>> found.shapes.shape  # modes, particles, x and y: 19 particles are free, the rim is held
    (38, 37, 2)
    """
    system = LinearSystem.of(atoms).moving()
    size = system.directions
    count = size if count is None else whole('count', count)
    if count > size:
        raise ValueError(f'the structure has {size} modes, not {count}')
    if system.turning or count == size:
        _refuse_all(system)
    if system.turning:
        omega, vectors = (part[..., :count] for part in lossless_modes(system.B().toarray(), system.K.toarray()))
        return Modes(omega, _fixed(np.arange(count), (system.shapes @ vectors).T, system))
    squares, vectors = _diagonalised(system.K, _mirrors(system)) if count == size else _lowest(system, count)
    return Modes(signed_root(squares), _fixed(squares / (abs(system.K).max() or 1.0), (system.shapes @ vectors).T, system))


def _lowest(system, count):
    """The lowest squared frequencies and their eigenvectors, by products with K where these are cheap, or else by its factors."""
    if system.directions >= BY_PRODUCTS and not system.atoms.pbc.any():
        from .chebyshev import Crowded, Matrix, lowest_by_products, products_of

        if not isinstance(K := products_of(system), Matrix):
            with suppress(Crowded, sparse.linalg.ArpackError):  # the latter if K is zero
                return lowest_by_products(K, system.directions, count)
    return lowest_eigenpairs(system.K, count)


def _mirrors(system):
    """Reflections of a structure along each axis, as matrices of its coordinates, which leave K as it is and commute.

    Their coordinates are exchanged in pairs or stay, with a sign: in each row and column one number is not zero, 1 or -1.
    """
    if system.directions <= SMALL:
        return []
    places, dim, found = system.atoms.positions, system.dim, []
    middle, sizes = (places.max(axis=0) + places.min(axis=0)) / 2, abs(system.K).sum(axis=1)
    for turn in 1 - 2 * np.eye(3)[:dim]:
        partner = KDTree(places).query(middle + turn * (places - middle))[1]
        exchange = sparse.kron(sparse.csr_array(sparse.eye_array(len(places)))[partner], sparse.diags_array(turn[:dim]))
        P = sparse.csr_array(system.free.T @ exchange @ system.free)
        once = P.nnz == system.directions and (abs(P.data) == 1).all()
        if once and not (P != P.T).nnz and not any((P @ other != other @ P).nnz for other in found):
            off = abs(P @ system.K @ P - system.K).tocoo()
            if (off.data <= ROUND_OFF * np.sqrt(sizes[off.row] * sizes[off.col])).all():  # a stiff site hides nothing elsewhere
                found.append(P)
    return found


def _diagonalised(K, mirrors):
    """All eigenvalues of a sparse K, ascending, and its eigenvectors, of which each is even or odd in each of the `mirrors`.

    Those of one parity take an eighth of the time of all.
    """
    if not mirrors:
        return np.linalg.eigh(K.toarray())
    (P, *others), parts = mirrors, []
    for sign in (1, -1):
        Q = sparse.csc_array(sparse.eye_array(K.shape[0]) + sign * P)[:, P.indices >= np.arange(K.shape[0])]  # one of each pair
        length = np.sqrt(Q.power(2).sum(axis=0))
        Q = Q[:, length > 0.5] @ sparse.diags_array(1 / length[length > 0.5])
        values, vectors = _diagonalised(Q.T @ K @ Q, [Q.T @ other @ Q for other in others])
        parts.append((values, Q @ vectors))
    values, vectors = (np.concatenate(part, axis=-1) for part in zip(*parts, strict=True))
    order = np.argsort(values)
    return values[order], vectors[:, order]


def _refuse_all(system):
    size, turning = system.K.shape[0], bool(system.turning)
    refuse_memory(f'all {size} modes', MATRICES * 8 * size**2 * (4 if turning else 1),
                  'take a smaller structure' if turning else 'ask for the lowest modes, modes(atoms, count=...)')


def _fixed(squares, shapes, system):
    """The shapes in the form that `Modes` describes: with fixed signs, and a unique basis of modes with equal `squares`.

    Without a rotation, eigenvectors of equal eigenvalues differ from one processor to another. As in QR with pivots, successive
    rows q of the rotation maximise the motion q V at the first component that V moves well.
    """
    found = np.array(shapes, order='C')  # each mode in one piece
    for shape in np.split(found, np.flatnonzero(np.diff(squares) > EQUAL) + 1):
        V = shape.copy()
        for k in range(len(V)):
            moved = np.linalg.norm(V, axis=0)
            first = V[:, (moved > WELL * moved.max()).argmax()]
            q = first.conj() / np.linalg.norm(first)
            shape[k] = q @ V
            V -= q.conj()[:, None] * shape[k]
    return found.reshape(len(shapes), len(system), system.dim)


@takes(*LINEAR)
def natural_frequencies(atoms: Atoms | LinearSystem) -> NDArray[np.float64]:
    """Frequencies of all `modes` without their shapes, in a third of the time; ascending, in rad/ms, shape (modes,).

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.response import natural_frequencies
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> natural_frequencies(patch).shape
    (38,)
    """
    system = LinearSystem.of(atoms).moving()
    _refuse_all(system)
    return modes(system).omega if system.turning else signed_root(np.linalg.eigvalsh(system.K.toarray()))


def refuse_unstable(system: LinearSystem, damping: ArrayLike = 0.0) -> None:
    """Raise Unstable for a structure of any size that is unstable; no spectrum is needed if stiffness alone holds it."""
    if not system.stable:
        refuse_growing(*((-(system.growth(damping) ** 2), 0.0) if system.turning else lowest_mode(system.K)[:2]))


def refuse_growing(lowest: float, highest: float) -> None:
    """Raise Unstable if the ends of a spectrum (rad^2/ms^2) show an unstable structure, which has no steady response."""
    if lowest < -ROUND_OFF * highest:
        raise Unstable('the structure is unstable and has no steady response: its fastest growing mode has the rate '
                         f'{np.sqrt(-lowest) * units.s:.4g} 1/s; a stiffer foundation or a larger spacing would hold it; '
                         '"magphonon check" or magphonon.verdict says how much is needed')


@dataclass(frozen=True)
class Localisation(InHertz, Saved, kind='extents of modes', units={
    'omega': ('rad/ms', 'modes'), 'participation': ('', 'modes'), 'centre': ('mm', 'modes', 'dim'), 'length': ('mm', 'modes'),
    'along': ('', 'modes', 'dim'),
}):
    """Centre, extent and direction of the motion in each mode of a structure.

    The share of a particle in a mode is its share of the kinetic energy: `m u^2` for a mode normalised to `sum m u^2 = 1`.

    Attributes
    ----------
    omega : ndarray, shape (modes,)
        Ascending, in rad/ms; for an unstable mode, minus its growth rate.
    participation : ndarray, shape (modes,)
        Number of particles that take part, `1/sum share^2`: 1 if one moves alone, the number of particles if all move alike.
    centre : ndarray, shape (modes, dim)
        Centre of the shares, in mm.
    length : ndarray, shape (modes,)
        Localisation length l in mm: a displacement that decays as e^{-r/l} has the same second moment of the shares.
        For a mode that extends over the whole structure it is about the size of the structure.
    along : ndarray, shape (modes, dim)
        Share of the motion along each axis.
    """

    omega: np.ndarray
    participation: np.ndarray
    centre: np.ndarray
    length: np.ndarray
    along: np.ndarray


def localisation(found: Modes, atoms: Atoms | LinearSystem) -> Localisation:
    """Participation, centre, localisation length and polarisation of each mode.

    Parameters
    ----------
    found : Modes
    atoms : ase.Atoms or LinearSystem
        The structure of the modes.  In periodic directions distances are those of the images nearest to the particle that moves
        most.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> from magphonon.response import localisation
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> found = localisation(modes(patch), patch)
    >>> bool((found.participation > 0).all())
    True
    """
    rest = atoms.atoms if isinstance(atoms, LinearSystem) else atoms
    dim = found.shapes.shape[2]
    if found.shapes.shape[1] != len(rest):
        raise ValueError(f'the modes are those of {found.shapes.shape[1]} particles, but the structure has {len(rest)}; give the '
                         'structure from which they were computed')
    energy = rest.get_masses()[:, None] * abs(found.shapes) ** 2
    share = energy.sum(axis=2)
    centre, spread = np.empty((len(share), dim)), np.empty(len(share))
    # a vector along which nothing repeats may be missing, or lean over the periodic ones
    cell = Cell(np.where(rest.pbc[:, None], rest.cell.array, 0)).complete()
    reciprocal, places = np.linalg.inv(cell.array), rest.positions.T.copy()  # sums over rows are fast
    for mode, weight in enumerate(share):
        at = places[:, weight.argmax()]
        away = places - at[:, None]
        if rest.pbc.any():
            away -= cell.array.T @ (rest.pbc[:, None] * (reciprocal.T @ away).round())
        middle = away[:dim] @ weight
        centre[mode] = at[:dim] + middle
        spread[mode] = ((away[:dim] - middle[:, None]) ** 2).sum(axis=0) @ weight
    d = max(1, np.linalg.matrix_rank(rest.positions - rest.positions[0], tol=1e-6 * np.ptp(rest.positions)))
    length = np.sqrt(4 * spread / (d * (d + 1)))  # of shares e^{-2r/l} the second moment is d (d + 1) l^2/4
    return Localisation(found.omega, 1 / (share**2).sum(axis=1), centre, length, energy.sum(axis=1))


@takes(*LIKE)
def local_modes(atoms: Atoms | LinearSystem, gap: ArrayLike) -> Modes:
    """All modes with frequencies within a gap of the lattice: the local modes of defects, in structures of any size.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with PairCalculator.
    gap : two numbers
        Lower and upper end in rad/ms, such as a row of `magphonon.bands.band_gaps`; negative for imaginary frequencies.

    Returns
    -------
    Modes
        Ascending; none if the gap is empty.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> from magphonon.response import local_modes
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> every = modes(patch).omega
    >>> found = local_modes(patch, [every[0] - 0.1, every[2] + 1e-6])
    >>> len(found.omega) == int((every < every[2] + 1e-6).sum())
    True
    """
    low, high = finite('gap', gap, (2,))
    if not low < high:
        raise ValueError(f'the gap must be two increasing frequencies in rad/ms, not {low:g} and {high:g}')
    system = LinearSystem.of(atoms).moving()
    squares, vectors = eigenpairs_between(system.K, float(np.sign(low) * low**2), float(np.sign(high) * high**2))
    return Modes(signed_root(squares), _fixed(squares / abs(system.K).max(), (system.shapes @ vectors).T, system))


def lowest_and_local(system: LinearSystem, ranges: NDArray[np.float64]) -> Modes:
    """All modes of a patch, or of a large one the lowest and those between the bands.

    Parameters
    ----------
    system : LinearSystem
    ranges : ndarray, shape (ranges, 2)
        Frequency ranges of the bands of the lattice, as `band_ranges` returns them; none for a finite structure.
    """
    from .chebyshev import stable_interval

    size = system.K.shape[0]
    if system.turning and size > MOST_TURNING:
        raise ValueError(f'the patch has {size} free directions; modes of gyroscopes need dense matrices, '
                         f'which may have up to {MOST_TURNING} rows: use a smaller patch, or "magphonon frf"')
    if size <= MOST_DIRECTIONS:
        return modes(system)
    lowest = modes(system, LOWEST)
    top = np.sqrt(stable_interval(system.K).highest)
    gaps = [*zip(ranges[:-1, 1], ranges[1:, 0], strict=True), *((high, top) for high in ranges[-1:, 1] if high < top)]
    between = [local_modes(system, gap) for gap in gaps]
    omega = np.concatenate([lowest.omega, *(found.omega for found in between)])
    new = np.concatenate([np.ones(LOWEST, bool), *(found.omega > lowest.omega[-1] for found in between)])
    return Modes(omega[new], np.concatenate([lowest.shapes, *(found.shapes for found in between)])[new])
