"""What each site has of its own is carried along every way by which one structure is made from another."""

import pickle
from copy import deepcopy

import numpy as np
import pytest
from ase.io import read, write

from magphonon import MagneticRepulsion, lattices
from magphonon.bands import finite_displacements
from magphonon.interactions import Overlap
from magphonon.response import replicas
from magphonon.stiffness import Scatter, restored, scattered, substituted, with_vacancies
from magphonon.stiffness.sites import Sites

EACH = {
    'strengths': lambda rng, n: rng.uniform(0.9, 1.1, n),
    'anchors': lambda rng, n: 0.1 * np.pad(rng.normal(size=(n, 2)), ((0, 0), (0, 1))),  # from the positions
    'load': lambda rng, n: 0.01 * np.pad(rng.normal(size=(n, 2)), ((0, 0), (0, 1))),
    'foundation': lambda rng, n: rng.uniform(1.0, 2.0, (n, 2)),
    'gyration': lambda rng, n: rng.uniform(0.1, 0.2, n),
    'radii': lambda rng, n: rng.uniform(6.0, 7.0, n),  # spheres of 12 mm and more, 10 mm apart
}
"""Values of each property, no two alike: what is lost or comes from another site is seen."""


def drawn(seed):
    """A periodic honeycomb or a square patch whose sites all differ, and the values."""
    rng = np.random.default_rng(seed)
    square, honeycomb = lattices.square(10.0, 0.7), lattices.honeycomb(10.0, 0.7)
    atoms = honeycomb.repeat((2, 3, 1)) if seed % 2 else lattices.parallelogram(square, 3, 4)
    values = {name: draw(rng, len(atoms)) for name, draw in EACH.items()}
    given = values | {'anchors': atoms.positions - values['anchors']}
    atoms.calc = MagneticRepulsion(atoms, Overlap(100.0), cutoff=12.0, model='conventional', **given)
    return atoms, values, rng


def supercell(atoms, rng):
    """On a supercell, in any order."""
    twice = atoms.repeat((2, 1, 1)) if atoms.pbc.any() else atoms
    order = rng.permutation(len(twice)) if atoms.pbc.any() else np.arange(len(atoms))
    other = twice[order]
    other.calc = atoms.calc.on(other) if atoms.pbc.any() else atoms.calc
    return other, order % len(atoms), 0.0


def elsewhere(atoms, rng):
    moved = np.pad(0.3 * rng.normal(size=(len(atoms), 2)), ((0, 0), (0, 1)))
    other = atoms.copy()
    other.positions += moved
    other.calc = atoms.calc.about(other)
    return other, np.arange(len(atoms)), moved


def balanced(atoms, rng):
    other = atoms.copy()
    other.calc = atoms.calc.balanced([0])
    other.calc = other.calc.about(other, atoms.calc.load)  # the load is what it changes
    return other, np.arange(len(atoms)), 0.0


def vacancies(atoms, rng):
    gone = rng.choice(len(atoms), 3, replace=False)
    return with_vacancies(atoms, gone), np.setdiff1d(np.arange(len(atoms)), gone), 0.0


def of_another_mass(atoms, rng):
    return substituted(atoms, 2, mass=2.0), np.arange(len(atoms)), 0.0


def scatter(atoms, rng):
    return scattered(atoms, Scatter(position=0.1, mass=0.05), 1), np.arange(len(atoms)), 0.0


def several(atoms, rng):
    return replicas([atoms, atoms, atoms]), np.tile(np.arange(len(atoms)), 3), 0.0


def copied(atoms, rng):
    return deepcopy(atoms), np.arange(len(atoms)), 0.0


def changed(atoms, rng):
    other = atoms.copy()
    other.calc = atoms.calc.changed(laws=Overlap(200.0))
    return other, np.arange(len(atoms)), 0.0


WAYS = supercell, elsewhere, balanced, vacancies, of_another_mass, scatter, several, copied, changed


def lost(atoms, values, image, moved):
    """The properties that are not those of the sites from which they should come."""
    expected = {name: value[image] for name, value in values.items()}
    expected['anchors'] = expected['anchors'] + moved
    found = vars(atoms.calc.sites) | {'anchors': atoms.calc.slack}
    return {name for name, value in expected.items()
            if np.shape(found[name]) != value.shape or abs(found[name] - value).max() > 1e-12 * abs(value).max()}


def test_each_property_is_drawn():
    assert set(EACH) == set(Sites.names())


@pytest.mark.parametrize('way', WAYS, ids=lambda way: way.__name__)
def test_every_way_carries_every_property(way):
    for seed in range(4):
        atoms, values, rng = drawn(seed)
        other, image, moved = way(atoms, rng)
        assert not lost(other, values, image, moved)
        assert other.calc.model == 'conventional'
        shifted = lost(other, values, np.roll(image, 1), moved)
        assert shifted == set(EACH)  # the control: values of other sites are seen, property by property


def test_files_carry_every_property(tmp_path):
    for seed in range(2):
        atoms, values, _ = drawn(seed)
        write(tmp_path / 'atoms.traj', atoms)
        for found in restored(read(tmp_path / 'atoms.traj')), pickle.loads(pickle.dumps(atoms)):
            assert not lost(found, values, np.arange(len(atoms)), 0.0)


def test_supercells_of_phonopy_have_the_springs_of_their_sites():
    atoms, values, *_ = drawn(1)
    atoms.calc = atoms.calc.about(atoms, anchors=atoms.positions, gyration=0.0, model='complete')
    atoms.calc = atoms.calc.balanced(range(len(atoms)))
    sums = finite_displacements(atoms, (1, 2, 1)).force_constants.sum(axis=1)  # rigid motion feels the springs alone
    springs = np.repeat(values['foundation'], len(sums) // len(atoms), axis=0)  # in the order of phonopy
    away = abs(np.einsum('ixx->ix', sums)[:, :2] - springs[::-1]).max()
    assert abs(np.einsum('ixx->ix', sums)[:, :2] - springs).max() < 1e-6 < 1e-2 < away
