"""The first Brillouin zone of a planar lattice, and the effect of the static forces over the whole zone."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product

import numpy as np
from ase import Atoms
from ase.cell import Cell
from ase.geometry import minkowski_reduce
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import Voronoi

from ..errors import whole
from ..results import InHertz, Saved
from ..stiffness.matrices import Model
from ..traits import LINEAR, takes
from .bands import group_velocities

PLANAR = (True, True, False)
ROUND_OFF = 1e-6  # fraction of the highest frequency that is zero: the square root of a rounded eigenvalue


def first_zone(cell: ArrayLike) -> NDArray[np.float64]:
    """Corners of the first Brillouin zone, the Wigner-Seitz cell of the reciprocal lattice.

    Parameters
    ----------
    cell : array_like, shape (3, 3)
        Lattice vectors in rows, mm; the first two are those of the planar lattice.

    Returns
    -------
    ndarray, shape (corners, 2)
        Anticlockwise, in rad/mm.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.bands.zone import first_zone
    >>> first_zone(lattices.triangular(1.0, 1.0).cell).shape  # six corners
    (6, 2)
    """
    b = 2 * np.pi * Cell(np.asarray(cell, dtype=float)).reciprocal().array
    reduced = minkowski_reduce(b, pbc=PLANAR)[0]  # pyright: ignore[reportArgumentType]  three pbc
    b = np.asarray(reduced)[:2, :2]  # of a reduced basis the eight nearest G bound the zone
    G = np.array(list(product((0, 1, -1), repeat=2))) @ b
    diagram = Voronoi(G)
    corners = diagram.vertices[diagram.regions[diagram.point_region[0]]]
    return corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]


@dataclass(frozen=True)
class ZoneMap(InHertz, Saved, kind='frequencies over the zone', units={
    'cell': ('mm', 'vectors', 'dim'), 'q': ('reciprocal vectors', 'n1', 'n2', 'vectors'),
    'omega': ('rad/ms', 'n1', 'n2', 'branches'), 'velocity': ('mm/ms', 'n1', 'n2', 'branches', 'dim'),
}, missing=('velocity',)):
    """Frequencies and group velocities on a mesh that covers the first Brillouin zone.

    The mesh runs along the reciprocal vectors, contains Gamma and shares the symmetry of the lattice.

    Attributes
    ----------
    cell : ndarray, shape (3, 3)
        Lattice vectors in rows, mm.
    q : ndarray, shape (n1, n2, 3)
        Wavevectors in fractions of the reciprocal vectors.
    omega : ndarray, shape (n1, n2, branches)
        Angular frequencies in rad/ms, ascending; negative for an unstable mode, as in `Bands`.
    velocity : ndarray, shape (n1, n2, branches, 2)
        Group velocities in mm/ms = m/s; NaN where the frequency is zero or imaginary.
    """

    cell: np.ndarray
    q: np.ndarray
    omega: np.ndarray
    velocity: np.ndarray

    @property
    def wavevectors(self) -> NDArray[np.float64]:
        """Wavevectors in rad/mm, shape (n1, n2, 2)."""
        return 2 * np.pi * (self.q @ Cell(self.cell).reciprocal().array)[..., :2]


@takes(*LINEAR, 'all neighbours')
def zone_map(atoms: Atoms, steps: int = 96, model: Model | None = None) -> ZoneMap:
    """Frequencies and group velocities over the first Brillouin zone.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell of a planar lattice with its PairCalculator or AllNeighbours.
    steps : int
        Mesh steps along each reciprocal vector; a multiple of 6 puts M and K of the hexagonal lattices on the mesh.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import frequency_ratio, zone_map
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> complete, conventional = zone_map(cell, 12), zone_map(cell, 12, 'conventional')
    >>> float(frequency_ratio(complete, conventional).min().round(2))
    0.63
    """
    steps = whole('steps', steps)
    if tuple(atoms.pbc) != PLANAR:
        raise ValueError(f'the zone is mapped for planar lattices with pbc (1, 1, 0), not {tuple(map(int, atoms.pbc))}; '
                         'draw the bands along a path instead')
    corners = first_zone(atoms.cell) @ atoms.cell.array[:2, :2].T / (2 * np.pi)  # in fractions: q_i = k.a_i/2 pi
    n1, n2 = np.ceil(steps * abs(corners).max(axis=0) - 1e-9).astype(int)
    q = np.stack(np.meshgrid(np.arange(-n1, n1 + 1), np.arange(-n2, n2 + 1), 0, indexing='ij'), axis=-1)[:, :, 0] / steps
    omega, velocity = group_velocities(atoms, q, model)
    mesh = q.shape[:2]
    return ZoneMap(atoms.cell.array.copy(), q, omega.reshape(*mesh, -1), velocity.reshape(*mesh, -1, 2))


def frequency_ratio(complete: ZoneMap, conventional: ZoneMap) -> NDArray[np.float64]:
    """`omega_complete/omega_conventional` of each branch over the zone, shape (n1, n2, branches).

    The ratio says how much the static forces shift each mode. It is at most 1, because D* of repelling particles only softens,
    and negative where the complete model is unstable. It is NaN where the conventional frequency vanishes: at Gamma without a
    foundation both frequencies vanish, and the limit is the ratio of the sound speeds, which may depend on the direction of
    approach.

    Parameters
    ----------
    complete, conventional : ZoneMap
        Maps of both models, for the same lattice on the same mesh.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import frequency_ratio, zone_map
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> ratio = frequency_ratio(zone_map(cell, 12), zone_map(cell, 12, 'conventional'))
    >>> float(ratio.min().round(2)), float(ratio.max().round(2))
    (0.63, 1.0)
    """
    k = complete.wavevectors
    if complete.omega.shape != conventional.omega.shape or not np.allclose(k, conventional.wavevectors, rtol=1e-9, atol=0):
        raise ValueError(f'the two maps belong to different meshes, {complete.omega.shape} and {conventional.omega.shape}, '
                         'or to different lattices; compute both from the same atoms and steps')
    zero = abs(conventional.omega) <= ROUND_OFF * abs(conventional.omega).max()
    return np.divide(complete.omega, conventional.omega, out=np.full(zero.shape, np.nan), where=~zero)
