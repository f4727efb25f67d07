"""Bands of a periodic lattice from its Bloch matrix: frequencies and modes along a path, group velocities, the speeds of sound in
long waves, and how much of each mode of a ribbon lies at its edges.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import permutations
from os import PathLike
from typing import TYPE_CHECKING, Any, NamedTuple, Self

import numpy as np
from ase import Atoms
from ase.cell import Cell
from ase.dft.kpoints import BandPath, parse_path_string
from numpy.typing import ArrayLike, NDArray

from ..errors import finite, positive
from ..results import InHertz, Saved, saved_arrays
from ..stiffness.matrices import mass_weighted, signed_root
from ..stiffness.rest import LinearSystem, freedom
from ..stiffness.sites import each_spring
from ..traits import LINEAR, takes
from .bloch import bloch_modes, damped_modes, in_batches, wavevectors

if TYPE_CHECKING:
    from ase.spectrum.band_structure import BandStructure
    from matplotlib.axes import Axes

    from ..stiffness.matrices import Model

UNITS = {
    'cell': ('mm', 'vectors', 'dim'), 'kpts': ('reciprocal vectors', 'wavevectors', 'vectors'), 'path': ('',),
    'names': ('', 'special points'), 'points': ('reciprocal vectors', 'special points', 'vectors'),
    'omega': ('rad/ms', 'wavevectors', 'modes'), 'decay': ('1/ms', 'wavevectors', 'modes'),
    'vectors': ('', 'wavevectors', 'modes', 'particles', 'dim'),
}
"""Units and axes of the arrays in a file of bands."""
SAME_LATTICE = 1e-3
"""Largest relative difference of products of lattice vectors at which a path belongs to the cell.  ASE takes a cell for a lattice
whose products differ by up to 2e-4 of its volume^(2/3), which is at most 8e-4 of the largest one for periods above 0.1 mm."""
CROSSINGS = 1024  # wavevectors treated at a time, so that pairs of branches of a large mesh fit in memory
ROUND_OFF = 1e-9  # relative tolerance of the depth, so that a row exactly at this depth belongs to the edge


@dataclass(frozen=True)
class Bands(InHertz, Saved, kind='bands', units=UNITS):
    """Frequencies along a path through the Brillouin zone.

    Attributes
    ----------
    path : ase.dft.kpoints.BandPath
        Wavevectors `path.kpts` in fractions of the reciprocal vectors, and the names of special points.
    omega : ndarray, shape (wavevectors, modes)
        Angular frequencies in rad/ms, ascending; negative for an unstable mode, -sqrt(-omega^2).
    vectors : ndarray of complex, shape (wavevectors, modes, particles, dim), optional
        Modes, normalised to one and weighted with the square root of the mass: displacements are `vectors / sqrt(m)`.
    decay : ndarray, shape (wavevectors, modes), optional
        With damping, the rate in 1/ms at which each mode falls, as e^{-decay t}; negative for one that grows.  An overdamped mode
        has the frequency zero.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices
    >>> cell = lattices.chain(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=4.0)
    >>> bands = analytic_bands(cell, cell.cell.bandpath('GX', npoints=3, pbc=cell.pbc), vectors=True)
    >>> bands.frequencies_Hz.shape
    (3, 2)
    >>> bands.polarisations[1].tolist()
    ['transverse', 'longitudinal']
    """

    path: BandPath
    omega: np.ndarray
    vectors: np.ndarray | None = None
    decay: np.ndarray | None = None

    @cached_property
    def longitudinal(self) -> NDArray[np.float64]:
        """Share of each mode's motion that is along the wavevector, 0 to 1, shape (wavevectors, modes); NaN at k = 0.

        Where branches cross, their modes are arbitrary, so each gets the mean share of the crossing branches.
        """
        if self.vectors is None:
            raise ValueError('these bands were computed without modes; compute them with vectors=True')
        k = self.path.kpts @ self.path.cell.reciprocal().array
        with np.errstate(invalid='ignore'):
            direction = (k / np.linalg.norm(k, axis=1)[:, None])[:, : self.vectors.shape[-1]]
        share = (abs(np.einsum('qmix,qx->qmi', self.vectors, direction)) ** 2).sum(axis=2)
        return _mean_over_crossings(self.omega, share[..., None])[..., 0]

    @property
    def polarisations(self) -> NDArray[np.str_]:
        """Label of each mode, shape (wavevectors, modes): 'longitudinal' or 'transverse' if over 90 %, 'mixed', '' at k = 0."""
        share = self.longitudinal
        return np.select([share > 0.9, share < 0.1, share == share], ['longitudinal', 'transverse', 'mixed'], '')

    def to_ase(self) -> BandStructure:
        """Convert to an `ase.spectrum.band_structure.BandStructure`, whose energies are frequencies in Hz and are drawn as
        such.
        """
        from ase.spectrum.band_structure import BandStructure

        class InHertz(BandStructure):
            def plot(self, ax=None, **options):
                low, high = self.energies.min(), self.energies.max()
                room = 0.05 * (high - min(low, 0.0))
                options = {'emin': low - room if low < 0 else 0.0, 'emax': high + room, 'ylabel': 'frequency (Hz)'} | options
                return super().plot(ax, **options)

        return InHertz(self.path, self.frequencies_Hz[None])

    def plot(self, ax: Axes | None = None, **options: Any) -> Axes:
        """Draw the bands in Hz as ASE does; `plot_bands` uses the style of this package and takes several bands on the same
        axes.
        """
        return self.to_ase().plot(ax, **options)  # pyright: ignore[reportReturnType]

    def _arrays(self) -> dict[str, Any]:
        special = self.path.special_points
        arrays = {'cell': self.path.cell.array, 'kpts': self.path.kpts, 'path': self.path.path, 'omega': self.omega,
                  'names': np.array(list(special)), 'points': np.array(list(special.values())).reshape(-1, 3)}
        return arrays | {name: value for name in ('vectors', 'decay') if (value := getattr(self, name)) is not None}

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read bands from the file that `save` wrote."""
        data = saved_arrays(path, 'bands', UNITS)
        special = dict(zip(map(str, data['names']), data['points'], strict=True))
        return cls(BandPath(Cell(data['cell']), data['kpts'], special, str(data['path'])), data['omega'], data.get('vectors'),
                   data.get('decay'))


@takes(*LINEAR, 'all neighbours')
def analytic_bands(atoms: Atoms, path: BandPath | str | ArrayLike, model: Model | None = None, vectors: bool = False,
                   branches: int | None = None, damping: ArrayLike | None = None) -> Bands:
    """Bands along a path from the analytic Bloch matrix (Eq. 18).

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator or AllNeighbours.
    path : ase.dft.kpoints.BandPath, str or array_like
        From `atoms.cell.bandpath('GMKG', npoints=300, pbc=atoms.pbc)`, or the names 'GMKG' of its special points alone; or
        wavevectors, shape (wavevectors, 3), in fractions of the reciprocal vectors.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.
    vectors : bool
        Keep the modes too.
    branches : int, optional
        Number of lowest branches to compute, by default all. In cells of hundreds of particles, a few take far less time.
    damping : float or array_like, shape (particles,), optional
        Damping rate in 1/ms, force divided by momentum. The bands then also have a `decay`, and all branches are computed.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> path = cell.cell.bandpath('GMKG', npoints=4, pbc=cell.pbc)
    >>> (analytic_bands(cell, path).omega[1] ** 2).round(10)  # at M: 2 (a - 3) and 2 (3 a - 1), times f/L0
    array([ 2., 22.])
    >>> (analytic_bands(cell, path, 'conventional').omega[1] ** 2).round(10)  # 2 a and 6 a
    array([ 8., 24.])
    >>> float(analytic_bands(cell, [[0.25, 0.0, 0.0]]).omega.max().round(6))  # a longitudinal wave: sqrt(3 a - 1)
    3.316625
    >>> large = cell.repeat((15, 15, 1))
    >>> large.calc = cell.calc.on(large)
    >>> analytic_bands(large, large.cell.bandpath('GM', npoints=3, pbc=large.pbc), branches=4).omega.shape  # of 450 branches
    (3, 4)
    """
    path = path_of(atoms, path)
    if damping is None:
        return Bands(path, *bloch_modes(atoms, path.kpts, model, vectors, branches))
    if branches is not None:
        raise ValueError(f'with damping all branches are computed, not only the lowest {branches}; omit damping or branches')
    omega, decay, modes = damped_modes(atoms, path.kpts, damping, model, vectors)
    return Bands(path, omega, modes, decay)


def band_path(atoms: Atoms, points: str | None = None, npoints: int = 300) -> BandPath:
    """Path through special points of the Brillouin zone, for a cell of any size.

    Does what `atoms.cell.bandpath(points, npoints=npoints, pbc=atoms.pbc)` does, for lattices of any size. ASE itself compares
    lengths in absolute numbers and recognises no lattice whose constant is below about 0.01 mm.

    Parameters
    ----------
    atoms : ase.Atoms
        One periodic cell; it needs no calculator.
    points : str, optional
        Names of special points, such as 'GMKG'; by default ASE's path through the zone of this lattice.
    npoints : int

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.bands import band_path
    >>> band_path(lattices.triangular(5e-6, 1.0), 'GMKG', 50).kpts.shape  # a cell too small for ASE's own
    (50, 3)
    """
    if not atoms.pbc.any():
        raise ValueError('the structure is not periodic and has no bands; use the unit cell from which it was made')
    alike = Atoms(cell=atoms.cell.array / atoms.cell.lengths()[atoms.pbc].max(), pbc=atoms.pbc)
    try:
        path = alike.cell.bandpath(points, npoints=npoints, pbc=alike.pbc.tolist())
    except KeyError as error:
        known = ', '.join(alike.cell.get_bravais_lattice(pbc=alike.pbc.tolist()).get_special_points())  # pyright: ignore
        raise ValueError(f'this lattice has no special point {error}; a path joins some of {known}, without signs between them'
                         ) from None
    except RuntimeError as error:
        raise ValueError(f'ASE finds no path {points or "of its own"} through the zone of {atoms.cell.array.tolist()} mm '
                         f'({error}); use the primitive cell, with more digits if its vectors are rounded, or put '
                         'your own wavevectors into a BandPath') from None
    path = path_of(alike, path)
    return BandPath(atoms.cell, path.kpts, path.special_points, path.path)


def path_of(atoms: Atoms, path: BandPath | str | ArrayLike) -> BandPath:
    """A path on the cell of `atoms`, made from a path of ASE, from special points as in `band_path`, or from wavevectors.

    ASE's `bandpath` returns a path on a rotated copy of the cell. This copy has exactly the lengths and angles of the lattice
    that ASE recognised, and its vectors may be in another order.  Only the fractions of the reciprocal vectors matter, so they
    are kept and applied to the cell of the atoms as it is.
    """
    if not atoms.pbc.any():
        raise ValueError('the structure is not periodic and has no bands; use the unit cell from which it was made')
    if isinstance(path, str):
        return band_path(atoms, path)
    if not isinstance(path, BandPath):
        return _path_through(atoms, path)
    axes = np.flatnonzero(atoms.pbc)
    ours, theirs = (cell[axes] @ cell[axes].T for cell in (atoms.cell.array, path.cell.array))
    off = {order: abs(ours - theirs[np.ix_(order, order)]).max() / abs(ours).max() for order in permutations(range(len(axes)))}
    for order in sorted(off, key=lambda order: round(off[order], 9))[:1]:  # in a square cell, the vectors stay as they are
        if off[order] <= SAME_LATTICE:
            own = np.arange(3)
            own[axes] = axes[list(order)]
            special = {name: np.asarray(point)[own] for name, point in path.special_points.items()}
            return BandPath(atoms.cell, path.kpts[:, own], special, path.path)
    own, foreign = (', '.join(f'{length:.6g}' for length in np.sqrt(np.diag(metric))) for metric in (ours, theirs))
    raise ValueError(f'the path belongs to a cell of another shape: its vectors are {foreign} mm long, those of the atoms {own} '
                     'mm; get the path with atoms.cell.bandpath(..., pbc=atoms.pbc). If you did, ASE chose another cell of '
                     'the same lattice: use that cell, or give bandpath your own points as special_points=')


def _path_through(atoms, q):
    try:
        return BandPath(atoms.cell, wavevectors(q))
    except ValueError as error:
        raise ValueError(f"the path must be a BandPath, names such as 'GMKG' or wavevectors, not {type(q).__name__} "
                         f'({error}); get one from atoms.cell.bandpath(...)') from None


def points_on(path: BandPath) -> dict[str, NDArray[np.float64]]:
    """The special points that a path goes through, in its order."""
    return {name: path.special_points[name] for leg in parse_path_string(path.path) for name in leg}


def _mean_over_crossings(omega, values):
    """Average `values`, shape (wavevectors, modes, any), over the modes of equal frequency, whose eigenvectors are arbitrary."""
    means, apart = np.empty_like(values), 1e-9 * abs(omega).max()
    for first in range(0, len(omega), CROSSINGS):
        part = slice(first, first + CROSSINGS)
        same = abs(omega[part, :, None] - omega[part, None, :]) <= apart
        means[part] = np.einsum('qmn,qnx->qmx', same / same.sum(axis=2, keepdims=True), values[part])
    return means


class GroupVelocities(NamedTuple):
    """Frequencies and group velocities at some wavevectors.

    Attributes
    ----------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms.
    velocity : ndarray, shape (wavevectors, modes, dim)
        In mm/ms = m/s; NaN where the frequency is zero or imaginary.
    """

    omega: np.ndarray
    velocity: np.ndarray


@takes(*LINEAR, 'all neighbours')
def group_velocities(atoms: Atoms | LinearSystem, q: ArrayLike, model: Model | None = None) -> GroupVelocities:
    """Group velocities `dw/dk` by the analytic derivative of the Bloch matrix.

    For a mode v of frequency w, `(2 w + i v^+ B v) dw/dk = v^+ (dD/dk) v`, with the matrix B of `LinearSystem`.  At degenerate
    points the velocity depends on the direction of approach, so each crossing branch gets the mean velocity of all of them.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        One cell with its PairCalculator or AllNeighbours.
    q, model
        As for `bloch_modes`.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.bands import group_velocities
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=1.0)
    >>> found = group_velocities(cell, [[0.1, 0.2, 0.0]])
    >>> found.omega.shape, found.velocity.shape
    ((1, 2), (1, 2, 2))
    """
    system = LinearSystem.of(atoms)
    calc: Any = system.atoms.calc
    B = (system.free @ system.B() @ system.free.T).toarray()
    omegas, slopes = [], []
    for part in in_batches(wavevectors(q), calc):
        omega, vectors = bloch_modes(system, part, model, vectors=True)
        v = vectors.reshape(*omega.shape, -1)
        gradient = mass_weighted(calc.bloch_gradient(part, model), system.masses)
        omegas.append(omega)
        weight = 2 * omega - (np.einsum('qma,ab,qmb->qm', v.conj(), B, v).imag if B.any() else 0.0)
        with np.errstate(divide='ignore', invalid='ignore'):
            slopes.append(np.einsum('qma,xqab,qmb->qmx', v.conj(), gradient, v).real / weight[..., None])
    omega = np.concatenate(omegas)
    velocity = _mean_over_crossings(omega, np.concatenate(slopes))
    velocity[omega <= 1e-6 * abs(omega).max()] = np.nan  # the root of a square's round-off
    return GroupVelocities(omega, velocity)


@takes('all neighbours', *LINEAR)
def cut_off(atoms: Atoms) -> float | None:
    """The cut-off frequency of a lattice on a foundation or between walls: the lowest frequency at Gamma. Long waves do not
    propagate below it.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator or AllNeighbours.

    Returns
    -------
    float or None
        In rad/ms. None if long acoustic waves propagate, however low their frequency: if there is neither a foundation nor a held
        particle, or if the foundation leaves a direction free.

    Examples
    --------
    >>> from magphonon import read_scene, units as u
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands.bands import cut_off
    >>> round(u.hertz(cut_off(read_scene(ready_scene('prototype')).atoms())), 3)
    26.551
    """
    supported = each_spring(atoms.calc.foundation, len(atoms), atoms.calc.dim).reshape(len(atoms), -1).any(axis=0)
    if not (supported.all() or atoms.constraints):
        return None
    return float(bloch_modes(atoms, np.zeros((1, 3)))[0].min())


@takes('all neighbours', 'conventional', 'oblique')
def sound_speeds(atoms: Atoms, direction: ArrayLike | None = None, model: Model | None = None) -> NDArray[np.float64]:
    """Speeds of sound along a direction, from the Bloch matrix to second order in k.

    With a foundation there is no acoustic branch; the speeds returned are those of the lattice without it.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator or AllNeighbours.
    direction : array_like, shape (dim,), optional
        By default along x.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Returns
    -------
    ndarray, shape (dim,)
        Ascending, in mm/ms = m/s; negative for an unstable branch, -sqrt(-c^2). Infinite where the repulsion has such a
        long range that w/k grows without bound in long waves, as in Coulomb crystals. NaN where a zero-stiffness mode of the unit
        cell (a mechanism) couples to the acoustic branch (the conventional kagome lattice).

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.bands import sound_speeds
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 5.0))
    >>> (sound_speeds(cell) ** 2 * 8 / 3).round(9)  # a - 3 and 3 a - 1, times f L0/m
    array([ 2., 14.])
    """
    system = LinearSystem.of(atoms)
    calc: Any = system.atoms.calc
    along = finite('direction', np.eye(calc.dim)[0] if direction is None else direction, (calc.dim,))
    if not along.any():
        raise ValueError(f'the direction must not be zero, not {along}')
    along = along / np.linalg.norm(along)
    masses, dim = system.masses, system.dim
    A, B, C = (system.reduced(term) for term in calc.bloch_series(along, model))

    # the internal modes follow the translations u: second-order perturbation theory
    u = np.kron(np.sqrt(masses)[:, None], np.eye(dim)) / np.sqrt(masses.sum())
    internal = np.linalg.svd(u)[0][:, dim:]
    stiffness, modes = np.linalg.eigh(internal.T @ A @ internal)
    floppy = abs(stiffness) <= 1e-12 * abs(A).max()
    modes = internal @ modes
    follow = -modes[:, ~floppy] / stiffness[~floppy] @ modes[:, ~floppy].conj().T @ B @ u
    squares = u.T @ (C @ u + B @ follow)
    mechanism = modes[:, floppy].conj().T @ (C @ u + B @ follow)
    if abs(mechanism).max(initial=0) > 1e-9 * abs(squares).max():
        return np.full(dim, np.nan)
    endless, axes = np.linalg.eigh(calc.singular(along, model))
    regular = axes[:, abs(endless) <= 1e-12 * abs(endless).max()]
    ends = np.copysign(np.inf, endless[abs(endless) > 1e-12 * abs(endless).max()])
    return np.sort(np.append(signed_root(np.linalg.eigvalsh(regular.T @ squares @ regular)), ends))


@takes(*LINEAR, 'all neighbours')
def edge_weights(atoms: Atoms, bands: Bands, depth: float | None = None) -> NDArray[np.float64]:
    """Share of the kinetic energy of each mode in the rows at the two edges of a ribbon, from 0 to 1.

    An edge wave has most of its energy at an edge, however wide the ribbon is; in all other modes this share falls with the
    width. Where branches cross, as those of two equal edges do, their modes are arbitrary, so each gets the mean share.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell of the ribbon, periodic in one direction, with the calculator that `bands` were computed with.
    bands : Bands
        Bands of these atoms, computed with vectors=True.
    depth : float, optional
        Distance in mm from the outermost free particle within which rows belong to the edge; by default the shortest bond.

    Returns
    -------
    ndarray, shape (wavevectors, modes, 2)
        The edge on the right of the periodic direction comes first, then the edge on the left: for a ribbon along x the lower
        edge comes first.
    """
    calc: Any = LinearSystem.of(atoms).atoms.calc
    if atoms.pbc.sum() != 1:
        raise ValueError(f'only a ribbon, periodic in one direction, has edges, but these atoms have {atoms.pbc.sum()} '
                         f'periodic directions; lattices.ribbon cuts one out of a lattice')
    if bands.vectors is None:
        raise ValueError('these bands were computed without modes; compute them with vectors=True')
    if bands.vectors.shape[2] != len(atoms):
        raise ValueError(f'the bands are those of {bands.vectors.shape[2]} particles, but the ribbon has {len(atoms)}; compute '
                         'them with analytic_bands(atoms, path, vectors=True)')
    depth = float(calc.bonds.lengths.min()) if depth is None else positive('depth', depth, 'mm')
    edges = edge_rows(atoms, depth)
    energy = (abs(bands.vectors) ** 2).sum(axis=3)  # the modes are weighted with the root of the mass
    return _mean_over_crossings(bands.omega, energy @ edges.T)


def edge_rows(atoms: Atoms, depth: float) -> NDArray[np.bool_]:
    """Which free particles lie within `depth` mm of the outermost one, on the right and on the left; shape (2, particles)."""
    along = atoms.cell.array[atoms.pbc][0, :2]
    left = np.array([-along[1], along[0]]) / np.linalg.norm(along)
    across, free = atoms.positions[:, :2] @ left, freedom(atoms)[0]
    reach = depth * (1 + ROUND_OFF)
    return free & np.array([across <= across[free].min() + reach, across >= across[free].max() - reach])
