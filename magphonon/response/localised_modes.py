"""Extent of each mode of a structure, and the local modes of defects, walls and edges in a gap of the lattice."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..errors import finite
from ..files import Saved
from ..stiffness.linear_system import LinearSystem
from ..stiffness.lowest import eigenpairs_between
from ..stiffness.matrices import signed_root
from .normal_modes import Modes

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray


@dataclass(frozen=True)
class Extent(units.InHertz, Saved, kind='extents of modes', units={
    'omega': ('rad/ms', 'modes'), 'participation': ('', 'modes'), 'centre': ('mm', 'modes', 'dim'), 'length': ('mm', 'modes'),
    'along': ('', 'modes', 'dim'),
}):
    """Centre, extent and direction of the motion in each mode of a structure.

    The share of a particle in a mode is that of the kinetic energy, `m u^2` of a mode normalised to `sum m u^2 = 1`.

    Attributes
    ----------
    omega : ndarray, shape (modes,)
        Ascending, in rad/ms; that of an unstable mode is minus its growth rate.
    participation : ndarray, shape (modes,)
        Number of particles that take part, `1/sum share^2`: 1 if one moves alone, their number if all move alike.
    centre : ndarray, shape (modes, dim)
        Centre of the shares, in mm.
    length : ndarray, shape (modes,)
        Localisation length in mm: the l of a decay e^{-r/l} of the displacement that has the same second moment of the shares.
        For a mode that extends over the whole structure it is about the size of the structure.
    along : ndarray, shape (modes, dim)
        Share of the motion along each axis.
    """

    omega: np.ndarray
    participation: np.ndarray
    centre: np.ndarray
    length: np.ndarray
    along: np.ndarray


def extents(found: Modes, atoms: Atoms | LinearSystem) -> Extent:
    """Participation, centre, localisation length and polarisation of each mode.

    Parameters
    ----------
    found : Modes
    atoms : ase.Atoms or LinearSystem
        The structure of the modes.  In periodic directions distances are those of the images nearest to the particle that moves
        most.

    Returns
    -------
    Extent

    Raises
    ------
    ValueError
        If the structure has another number of particles.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> from magphonon.response import extents
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> found = extents(modes(patch), patch)
    >>> bool((found.participation > 0).all())
    True
    """
    rest = atoms.atoms if isinstance(atoms, LinearSystem) else atoms
    dim = found.shapes.shape[2]
    if found.shapes.shape[1] != len(rest):
        raise ValueError(f'the modes are those of {found.shapes.shape[1]} particles, but the structure has {len(rest)}; give the '
                         'one from which they were computed')
    energy = rest.get_masses()[:, None] * found.shapes**2
    share = energy.sum(axis=2)
    centre, spread = np.empty((len(share), dim)), np.empty(len(share))
    for mode, weight in enumerate(share):
        at = rest.positions[weight.argmax()]
        away = _nearest_images(rest.positions - at, rest)[:, :dim]
        middle = weight @ away
        centre[mode] = at[:dim] + middle
        spread[mode] = weight @ ((away - middle) ** 2).sum(axis=1)
    d = max(1, np.linalg.matrix_rank(rest.positions - rest.positions[0], tol=1e-6 * np.ptp(rest.positions)))
    length = np.sqrt(4 * spread / (d * (d + 1)))  # of shares e^{-2r/l} the second moment is d (d + 1) l^2/4
    return Extent(found.omega, 1 / (share**2).sum(axis=1), centre, length, energy.sum(axis=1))


def _nearest_images(vectors: NDArray[np.float64], atoms: Atoms) -> NDArray[np.float64]:
    if not atoms.pbc.any():
        return vectors
    cells = atoms.cell.scaled_positions(vectors)
    return (cells - np.where(atoms.pbc, cells.round(), 0)) @ atoms.cell.array


def local_modes(atoms: Atoms | LinearSystem, gap: ArrayLike) -> Modes:
    """All modes with frequencies within a gap of the lattice: the local modes of defects, in structures of any size.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with MagneticRepulsion.
    gap : two numbers
        Lower and upper end in rad/ms, such as a row of `magphonon.bands.band_gaps`; imaginary frequencies are negative.

    Returns
    -------
    Modes
        Ascending; none if the gap is empty.

    Raises
    ------
    ValueError
        If nothing is free, the structure is not at rest, or the ends do not increase.

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
    shapes = (system.shapes @ vectors).T.reshape(len(squares), len(system), system.dim)
    return Modes(signed_root(squares), shapes)
