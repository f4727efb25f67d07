"""Direct sums with a bound on what they leave out, against the exact infinite sums."""

import numpy as np
import pytest
from oracles import LAWS as ORACLES, TABLE, lattice

from magphonon import AllNeighbours, InversePower, Yukawa, analytic_bands, lattices
from magphonon.interactions.pair_laws import Hertz
from magphonon.lattices.bonds import bonds_within
from magphonon.stiffness.all_neighbours import missing_stiffness, reach
from magphonon.stiffness.bond import bond_stiffness
from magphonon.stiffness.calculator import MagneticRepulsion

LAWS = {'magnets': InversePower(6200.0, 4.5824), 'dipoles': InversePower(1e4, 4.0), 'yukawa': Yukawa(20.0, 0.1)}


def summed(atoms, law, cutoff, dim):
    bonds = bonds_within(atoms, cutoff)
    total = np.zeros((len(atoms), dim, dim))
    for ends in (bonds.i, bonds.j):
        np.add.at(total, ends, sum(bond_stiffness(bonds.vectors[:, :dim], law)))
    return total


@pytest.mark.parametrize('law', LAWS.values(), ids=LAWS)
@pytest.mark.parametrize('name', ['chain', 'triangular', 'kagome', 'fcc'])
def test_the_bound_holds_and_is_no_exaggeration(name, law):
    atoms = lattice(name)
    exact = AllNeighbours(atoms, law).onsite()
    for cutoff in (75.0, 151.7):
        missing = abs(exact - summed(atoms, law, cutoff, exact.shape[1])).max()
        bound = missing_stiffness(atoms, law, cutoff)
        assert missing < bound < 200 * missing  # it begins one cell too early, and adds up what partly cancels


def test_a_cutoff_within_reach_meets_its_tolerance():
    atoms, law = lattices.triangular(10.0, 0.7), LAWS['magnets']
    atoms.calc = AllNeighbours(atoms, law)
    path = atoms.cell.bandpath('GMK', npoints=9, pbc=atoms.pbc)
    exact = analytic_bands(atoms, path).omega ** 2
    for tolerance in (1e-2, 1e-4):
        atoms.calc = MagneticRepulsion(atoms, law, cutoff=reach(atoms, law, tolerance))
        assert abs(analytic_bands(atoms, path).omega ** 2 - exact).max() < tolerance * exact.max()
    atoms.calc = MagneticRepulsion(atoms, law)
    assert abs(analytic_bands(atoms, path).omega ** 2 - exact).max() > 1e-2 * exact.max()


def test_contacts_reach_no_farther_than_their_diameter():
    atoms = lattices.triangular(19.997, 30.0)
    assert missing_stiffness(atoms, Hertz(1e5, 20.0), 80.0) == 0


def test_what_cannot_be_summed_is_refused():
    atoms = lattices.triangular(10.0, 1.0)
    with pytest.raises(ValueError, match='raise the tolerance'):
        reach(atoms, InversePower(1.0, 2.0), 1e-5)
    with pytest.raises(ValueError, match='diverges in 3 dimensions'):
        missing_stiffness(lattices.fcc(10.0, 1.0), InversePower(1.0, 1.5), 100.0)
    with pytest.raises(ValueError, match='outside the table'):
        missing_stiffness(atoms, ORACLES['table'], 4 * TABLE[-1])
