"""Anchors, dead load and the place of rest in the calculator: three things, each with its own effect."""

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from oracles import LAWS, displaced, small_cluster

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.lattices import find_bonds

LAW = LAWS['magnets']
K = 0.03


def drawn(name, seed=4):
    """A small supercell, displacements from rest, and places of anchors and a load that have nothing to do with them."""
    rest, atoms, u = displaced(name)
    rng, dim = np.random.default_rng(seed), 3 if rest.pbc.all() else 2
    slack, load = np.zeros((2, len(rest), 3))
    slack[:, :dim], load[:, :dim] = rng.uniform(-0.5, 0.5, (len(rest), dim)), rng.uniform(-0.2, 0.2, (len(rest), dim))
    return rest, atoms, u, slack, load


def test_anchors_at_the_reference_and_no_load_change_no_bit():
    rest, atoms, *_ = drawn('triangular')
    atoms.calc = MagneticRepulsion(rest, LAW, foundation=K)
    expected = atoms.get_forces(), atoms.get_potential_energy()
    atoms.calc = MagneticRepulsion(rest, LAW, foundation=K, anchors=rest.positions, load=np.zeros((len(rest), 3)))
    assert_array_equal(atoms.get_forces(), expected[0])
    assert atoms.get_potential_energy() == expected[1]


def test_a_rest_elsewhere_leaves_the_forces_as_they_are():
    """`about` moves the origin of displacements and of energy: the same physics, of which only the zero of energy differs."""
    rest, atoms, _, slack, load = drawn('kagome')
    calc = MagneticRepulsion(rest, LAW, foundation=K, anchors=rest.positions - slack, load=load)
    middle = atoms.copy()
    middle.positions[:, :2] -= np.random.default_rng(8).uniform(-0.2, 0.2, (len(rest), 2))
    other = calc.about(middle)
    assert not other.displacements(middle).any()
    atoms.calc = calc
    there, middle.calc = middle.copy(), other
    there.calc = calc
    expected, work = atoms.get_forces(), atoms.get_potential_energy() - there.get_potential_energy()
    atoms.calc = other
    assert_allclose(atoms.get_forces(), expected, atol=1e-12)
    assert_allclose(atoms.get_potential_energy(), work, rtol=1e-11)
    assert middle.get_potential_energy() == 0
    frozen = calc.about(middle, model='conventional')
    assert frozen.parameters.model == 'conventional'
    assert_allclose(frozen.bonds.vectors, other.bonds.vectors)


def test_bonds_of_another_place_are_taken_anew_or_refused():
    atoms = small_cluster()
    bonds = find_bonds(atoms, cutoff=13.0)
    moved = atoms.copy()
    moved.positions[:, :2] += np.random.default_rng(0).uniform(-1, 1, (len(atoms), 2))
    calc = MagneticRepulsion(moved, LAW, bonds=bonds)
    pairs = list(zip(bonds.i.tolist(), bonds.j.tolist(), strict=True))
    assert_array_equal(calc.bonds.vectors, MagneticRepulsion(moved, LAW, bonds=pairs).bonds.vectors)
    assert abs(calc.bonds.vectors - bonds.vectors).max() > 0.5
    assert calc.bonds.cutoff is None
    assert MagneticRepulsion(atoms, LAW, bonds=bonds).bonds is bonds
    with pytest.raises(ValueError, match='belongs to another structure'):
        MagneticRepulsion(atoms[::-1], LAW, bonds=bonds)


def test_a_law_without_stiffness_is_refused_like_one_without_force():
    class Broken(InversePower):
        def d2phi(self, r):
            return np.nan * r

    with pytest.raises(ValueError, match='gives the stiffness nan N/mm at the distance 10 mm of the particles 0 and 0'):
        MagneticRepulsion(lattices.triangular(10.0, 0.7), Broken(b=1.0, a=4.0))


@pytest.mark.parametrize('name', ['chain', 'kagome', 'fcc'])
def test_what_the_forces_are_made_of_once_cannot_be_changed_beneath_them(name):
    """A change would be seen by some answers and not by others; a calculator that is made anew sees all of it."""
    rest, atoms, _, slack, load = drawn(name)
    atoms.calc = calc = MagneticRepulsion(rest, LAW, foundation=K, anchors=rest.positions - slack, load=load)
    forces = atoms.get_forces()
    for array in calc.load, calc.anchors, calc.reference.positions:
        with pytest.raises(ValueError, match='read-only'):
            array[0] += 0.1
    for attribute in 'load', 'anchors', 'laws':
        with pytest.raises(AttributeError, match=attribute):
            setattr(calc, attribute, getattr(calc, attribute))
    assert_array_equal(atoms.get_forces(), forces)
    load[0, 0] += 0.1  # the caller's own array is his
    assert_array_equal(atoms.get_forces(), forces)
    atoms.calc = calc.about(rest, load=load)
    expected = np.zeros((len(rest), 3))
    expected[0, 0] = 0.1
    assert_allclose(atoms.get_forces() - forces, expected, atol=1e-12)
