"""Cells with their calculator, and paths through their zones, for the tests of several rooms."""

import numpy as np
from oracles import LAWS, lattice

from magphonon import InversePower, MagneticRepulsion, lattices, units as u

LAW = LAWS['magnets']


def cell_of(name, law=LAW, **options):
    atoms = lattice(name)
    atoms.calc = MagneticRepulsion(atoms, law, **options)
    return atoms


PROTOTYPE = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
PILLAR = 19.675721234 * u.N / u.m


def prototype(lattice='triangular', law=PROTOTYPE, foundation=PILLAR, **kwargs):
    cell = getattr(lattices, lattice)(spacing=10 * u.mm, mass=0.707 * u.g)
    cell.calc = MagneticRepulsion(cell, law, foundation=foundation, **kwargs)
    return cell


def path_through(cell, names, npoints=40):
    return cell.cell.bandpath(names, npoints=npoints, pbc=cell.pbc)


def at(cell, point):
    return path_through(cell, point, npoints=1)


def triangular_patch(**options):
    """A 4 x 3 periodic patch displaced by a few percent, with its calculator."""
    rest = lattice('triangular').repeat((4, 3, 1))
    atoms = rest.copy()
    atoms.positions[:, :2] += np.random.default_rng(5).uniform(-0.3, 0.3, (12, 2))
    atoms.calc = MagneticRepulsion(rest, LAW, **options)
    return atoms


def cauchy_stress(atoms):
    """Stress of a cell without foundation as a force per length in a plane, from ASE's, which is per area of the cell's walls."""
    periods, dim = atoms.cell.array[atoms.pbc], atoms.calc.dim
    across = atoms.get_volume() / np.sqrt(np.linalg.det(periods @ periods.T))
    return across * atoms.get_stress(voigt=False)[:dim, :dim]
