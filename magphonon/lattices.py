"""Lattices of particles as ASE Atoms: unit cells, finite patches with their rim, and the oscillator of Sec. III.

Lengths in mm, masses in g (`magphonon.units`).  Planar lattices lie in z = 0, periodic along their lattice
vectors only; the third vector, `2 * spacing` long, is the vacuum above the plane.  `fcc` and `bcc` fill space.
Particles carry the symbol 'Nd' (phonopy refuses 'X') and their own mass.  `spacing` is always the nearest-neighbour distance.
"""

from numbers import Real

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from .bonds import bonds_within, find_bonds
from .errors import positive, whole

SYMBOL = 'Nd'
RIM = 1
"""Tag of the particles on the rim of a patch; those inside have the tag 0."""

OSCILLATOR_BONDS = ((0, 3), (1, 3), (2, 3))
"""The bonds of `oscillator`, to be given explicitly: at theta0 = pi/2 its fixed magnets coincide."""


def chain(spacing, mass):
    """Straight chain along x; one particle per cell."""
    return _cell(spacing, mass, [1, 0], [0, 2], [[0, 0]], pbc=(1, 0, 0))


def square(spacing, mass):
    """Square lattice; one particle per cell."""
    return _cell(spacing, mass, [1, 0], [0, 1], [[0, 0]])


def triangular(spacing, mass):
    """Triangular lattice in the paper's basis, R1 = (1, 0) L0 and R2 = (1/2, sqrt(3)/2) L0; one particle per cell."""
    return _cell(spacing, mass, [1, 0], [1 / 2, np.sqrt(3) / 2], [[0, 0]])


def honeycomb(spacing, mass):
    """Honeycomb lattice; two particles per cell, lattice constant `sqrt(3) * spacing`."""
    a = np.sqrt(3)
    return _cell(spacing, mass, [a, 0], [a / 2, 3 / 2], [[0, 0], [a / 2, 1 / 2]])


def kagome(spacing, mass):
    """Kagome lattice; three particles per cell, lattice constant `2 * spacing`."""
    return _cell(spacing, mass, [2, 0], [1, np.sqrt(3)], [[0, 0], [1, 0], [1 / 2, np.sqrt(3) / 2]])


def fcc(spacing, mass):
    """Face-centred cubic lattice, periodic in space; one particle per cell, lattice constant `sqrt(2) * spacing`."""
    return _crystal(spacing, mass, np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]]) / np.sqrt(2))


def bcc(spacing, mass):
    """Body-centred cubic lattice, periodic in space; one particle per cell, lattice constant `2/sqrt(3) * spacing`."""
    return _crystal(spacing, mass, np.array([[-1, 1, 1], [1, -1, 1], [1, 1, -1]]) / np.sqrt(3))


def _crystal(spacing, mass, vectors):
    spacing, mass = positive('spacing', spacing, 'mm'), positive('mass', mass, 'g')
    return Atoms(SYMBOL, masses=[mass], cell=spacing * vectors, pbc=True)


def _cell(spacing, mass, a1, a2, positions, pbc=(1, 1, 0)):
    spacing, mass = positive('spacing', spacing, 'mm'), positive('mass', mass, 'g')
    plane = spacing * np.array([a1, a2])
    cell = np.zeros((3, 3))
    cell[:2, :2] = plane
    cell[2, 2] = 2 * spacing
    flat = np.zeros((len(positions), 3))
    flat[:, :2] = spacing * np.array(positions)
    return Atoms([SYMBOL] * len(flat), positions=flat, masses=[mass] * len(flat), cell=cell, pbc=pbc)


def parallelogram(cell, n1, n2):
    """Patch of `n1 x n2` cells of a planar lattice, its rim held fixed.

    Every patch is centred on the origin, carries the tag `RIM` on the particles that lack a nearest neighbour,
    and holds them with ASE's FixAtoms: inside the rim each particle has its full shell and is in equilibrium.
    Deleting the constraint leaves a free edge, which the static forces push outwards.  The array 'site' numbers
    the particles on the parallelogram from which the patch was cut.

    Parameters
    ----------
    cell : ase.Atoms
        Planar unit cell, pbc (1, 1, 0).
    n1, n2 : int
        Number of cells along the two lattice vectors.

    Returns
    -------
    ase.Atoms
        The patch, not periodic.

    Raises
    ------
    ValueError
        If the cell is not planar, or no particle of the patch lies inside its rim.
    """
    return _patch(cell, whole('n1', n1), whole('n2', n2), lambda x, y: np.zeros(x.shape))


def rectangle(cell, width, height):
    """Patch of the particles within a `width` x `height` (mm) rectangle; rim and errors as in `parallelogram`."""
    width, height = positive('width', width, 'mm'), positive('height', height, 'mm')
    return _cut(cell, np.hypot(width, height) / 2, lambda x, y: np.maximum(abs(x) - width / 2, abs(y) - height / 2))


def hexagon(cell, side):
    """Patch within a regular hexagon of `side` (mm), corners on the x axis; rim and errors as in `parallelogram`."""
    side = positive('side', side, 'mm')
    return _cut(cell, side, lambda x, y: _beyond_hexagon(x, y, side))


def half_hexagon(cell, side):
    """Upper half (y >= 0) of `hexagon`, the shape of the paper's prototype; rim and errors as in `parallelogram`."""
    side = positive('side', side, 'mm')
    return _cut(cell, side, lambda x, y: np.maximum(_beyond_hexagon(x, y, side), -y))


def _beyond_hexagon(x, y, side):
    return np.maximum(abs(y), (abs(y) + np.sqrt(3) * abs(x)) / 2) - side * np.sqrt(3) / 2


def _cut(cell, radius, beyond):
    """Patch within a shape that fits in a circle of `radius`; `beyond(x, y)` is the distance outside its border."""
    if tuple(cell.pbc) != (True, True, False):
        raise ValueError(f'a patch is cut from a planar cell with pbc (1, 1, 0), not {tuple(map(int, cell.pbc))}')
    rows = cell.cell.reciprocal()[:2]  # their inverse lengths are the distances between lattice rows
    n1, n2 = 2 * np.ceil(radius * np.linalg.norm(rows, axis=1)).astype(int) + 3
    return _patch(cell, n1, n2, beyond)


def _patch(cell, n1, n2, beyond):
    if tuple(cell.pbc) != (True, True, False):
        raise ValueError(f'a patch is cut from a planar cell with pbc (1, 1, 0), not {tuple(map(int, cell.pbc))}')
    shell = find_bonds(cell)
    patch = cell.repeat((n1, n2, 1))
    patch.positions -= cell.positions[0] + np.array([n1 - 1, n2 - 1, 0]) @ cell.cell.array / 2
    patch.set_array('site', np.arange(len(patch)))
    x, y = patch.positions[:, :2].T
    inside = beyond(x, y) <= 1e-9 * shell.lengths[0]  # a particle on the border belongs to the patch
    coordination = np.tile(shell.coordination, n1 * n2)[inside]
    patch = patch[inside]
    patch.pbc, patch.cell = False, None
    rim = bonds_within(patch, shell.cutoff).coordination < coordination if len(patch) else np.array([True])
    if rim.all():
        raise ValueError(f'the patch holds {len(patch)} particles, none of them inside its rim; make it larger')
    patch.set_tags(np.where(rim, RIM, 0))
    patch.set_constraint(FixAtoms(mask=rim))
    return patch


def oscillator(theta0, spacing, mass):
    """One free magnet on three fixed ones: the paper's single-particle oscillator (Sec. III, Fig. 1).

    The free particle, the paper's number 4, rests at the origin.  One fixed magnet stands `spacing` below it, two
    stand at the angle `theta0` below the horizontal on its left and right.  The three push it upwards; an external
    force must balance them.  Give the calculator `bonds=OSCILLATOR_BONDS`.

    Parameters
    ----------
    theta0 : float
        Angle in rad, 0 to pi/2.
    spacing, mass : float
        Bond length in mm, mass of each particle in g.

    Returns
    -------
    ase.Atoms
        Four particles, the first three held by FixAtoms.

    Raises
    ------
    ValueError
        If `theta0` is outside 0 to pi/2, or spacing or mass is not positive.
    """
    spacing, mass = positive('spacing', spacing, 'mm'), positive('mass', mass, 'g')
    if not isinstance(theta0, Real) or not 0 <= theta0 <= np.pi / 2:
        raise ValueError(f'theta0 must lie between 0 and pi/2 rad, not {theta0!r}; degrees are given as 30 * units.deg')
    c, s = np.cos(theta0), np.sin(theta0)
    atoms = Atoms([SYMBOL] * 4, positions=spacing * np.array([[-c, -s, 0], [c, -s, 0], [0, -1, 0], [0, 0, 0]]),
                  masses=[mass] * 4)
    atoms.set_constraint(FixAtoms([0, 1, 2]))
    return atoms
