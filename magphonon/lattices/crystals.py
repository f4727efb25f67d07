"""Lattices of particles as ASE Atoms: unit cells, and the oscillator of Sec. III.

Lengths in mm, masses in g (`magphonon.units`).  Planar lattices lie in z = 0, periodic along their lattice
vectors only; the third vector, `2 * spacing` long, is the vacuum above the plane.  `fcc` and `bcc` fill space.
Particles carry the symbol 'Nd' (phonopy refuses 'X') and their own mass.  `spacing` is always the nearest-neighbour distance.
"""

from numbers import Real

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from ..errors import positive

SYMBOL = 'Nd'
OSCILLATOR_BONDS = ((0, 3), (1, 3), (2, 3))
"""The bonds of `oscillator` between its fixed magnets and the free one; the calculator also finds them without this list."""


def chain(spacing: float, mass: float) -> Atoms:
    """Straight chain along x; one particle per cell.

    Examples
    --------
    >>> from magphonon import lattices
    >>> lattices.chain(10.0, 1.0).pbc.tolist()
    [True, False, False]
    """
    return _cell(spacing, mass, [1, 0], [0, 2], [[0, 0]], pbc=(1, 0, 0))


def square(spacing: float, mass: float) -> Atoms:
    """Square lattice; one particle per cell.

    Examples
    --------
    >>> from magphonon import lattices
    >>> lattices.square(10.0, 1.0).cell.lengths()[:2].tolist()
    [10.0, 10.0]
    """
    return _cell(spacing, mass, [1, 0], [0, 1], [[0, 0]])


def triangular(spacing: float, mass: float) -> Atoms:
    """Triangular lattice in the paper's basis, R1 = (1, 0) L0 and R2 = (1/2, sqrt(3)/2) L0; one particle per cell.

    Examples
    --------
    >>> from magphonon import lattices
    >>> cell = lattices.triangular(spacing=10.0, mass=0.7)
    >>> round(float(cell.cell.angles()[2]), 9), cell.get_masses().tolist()
    (60.0, [0.7])
    """
    return _cell(spacing, mass, [1, 0], [1 / 2, np.sqrt(3) / 2], [[0, 0]])


def honeycomb(spacing: float, mass: float) -> Atoms:
    """Honeycomb lattice; two particles per cell, lattice constant `sqrt(3) * spacing`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices import find_bonds
    >>> cell = lattices.honeycomb(10.0, 1.0)
    >>> len(cell), len(find_bonds(cell))
    (2, 3)
    """
    a = np.sqrt(3)
    return _cell(spacing, mass, [a, 0], [a / 2, 3 / 2], [[0, 0], [a / 2, 1 / 2]])


def kagome(spacing: float, mass: float) -> Atoms:
    """Kagome lattice; three particles per cell, lattice constant `2 * spacing`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices import find_bonds
    >>> cell = lattices.kagome(10.0, 1.0)
    >>> len(cell), len(find_bonds(cell))
    (3, 6)
    """
    return _cell(spacing, mass, [2, 0], [1, np.sqrt(3)], [[0, 0], [1, 0], [1 / 2, np.sqrt(3) / 2]])


def fcc(spacing: float, mass: float) -> Atoms:
    """Face-centred cubic lattice, periodic in space; one particle per cell, lattice constant `sqrt(2) * spacing`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices import find_bonds
    >>> 2 * len(find_bonds(lattices.fcc(1.0, 1.0)))  # neighbours of a particle
    12
    """
    return _crystal(spacing, mass, np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]]) / np.sqrt(2))


def bcc(spacing: float, mass: float) -> Atoms:
    """Body-centred cubic lattice, periodic in space; one particle per cell, lattice constant `2/sqrt(3) * spacing`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices import find_bonds
    >>> 2 * len(find_bonds(lattices.bcc(1.0, 1.0)))  # neighbours of a particle
    8
    """
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


def oscillator(theta0: float, spacing: float, mass: float) -> Atoms:
    """One free magnet on three fixed ones: the paper's single-particle oscillator (Sec. III, Fig. 1).

    The free particle, number 4 in the paper, is at the origin.  One fixed magnet is at the distance `spacing` below it, two
    are at the angle `theta0` below the horizontal on its left and right.  The three push it upwards; an external
    force must balance them: `PairCalculator(atoms, law).balanced([3])`.

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

    Examples
    --------
    >>> from magphonon import lattices, units as u
    >>> lattices.oscillator(30 * u.deg, 1.0, 1.0).get_distances(3, [0, 1, 2]).round(12).tolist()
    [1.0, 1.0, 1.0]
    """
    spacing, mass = positive('spacing', spacing, 'mm'), positive('mass', mass, 'g')
    if not isinstance(theta0, Real) or not 0 <= theta0 <= np.pi / 2:
        raise ValueError(f'theta0 must lie between 0 and pi/2 rad, not {theta0!r}; degrees are given as 30 * units.deg')
    c, s = np.cos(theta0), np.sin(theta0)
    atoms = Atoms([SYMBOL] * 4, positions=spacing * np.array([[-c, -s, 0], [c, -s, 0], [0, -1, 0], [0, 0, 0]]),
                  masses=[mass] * 4)
    atoms.set_constraint(FixAtoms([0, 1, 2]))
    return atoms
