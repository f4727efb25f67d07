"""Every site its own: what `tests/test_methods_compared.py` does not ask."""

import numpy as np
import pytest
from oracles import lattice

from magphonon import InversePower, MagneticRepulsion
from magphonon.interactions import Yukawa
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.matrices import bloch_series

LAWS = {(0, 0): InversePower(b=6200.0, a=4.5824), (1, 0): InversePower(b=25.0, a=2.0), (1, 1): Yukawa(c=20.0, kappa=0.3)}
"""About 0.2 N at 10 mm each, and of different slope."""


def apart(found, expected):
    return abs(found - expected).max() / abs(expected).max()


def test_particles_that_are_alike_have_the_one_law_and_one_number():
    cell = lattice('honeycomb')
    law = LAWS[0, 0]
    for potential in (law, LAWS):
        calc = MagneticRepulsion(cell, potential, foundation=[0.3, 0.3], strengths=[1, 1])
        assert calc.law is law
        assert calc.foundation == 0.3
        assert isinstance(calc.foundation, float)
        with pytest.raises(ValueError, match='read-only'):
            calc.strengths[0] = 2.0


@pytest.mark.parametrize(('given', 'words'), [
    ({'foundation': [0.1, 0.2, 0.3]}, r'one of the shapes \(2,\), \(2, 1\), \(1, 2\), \(2, 2\)'),
    ({'foundation': [0.1, -0.2]}, r'foundation\[1\] must be a zero or positive number in N/mm, not -0.2'),
    ({'foundation': [0.1, np.nan]}, r'foundation\[1\] is nan'),
    ({'strengths': [1.0]}, r'strengths must have the shape \(2,\)'),
    ({'strengths': [1.0, np.nan]}, 'strengths'),
    ({'laws': {(0, 0): LAWS[0, 0]}}, r'the particles 0 and 1 are bonded, but no law is given for their kinds, 0 and 1'),
    ({'laws': {0: LAWS[0, 0]}}, 'laws belong to pairs of kinds'),
    ({'laws': {(0, 1): LAWS[0, 0], (1, 0): LAWS[1, 1]}}, 'the kinds 0 and 1 have two laws'),
    ({'laws': {(0, 1): 3.0}}, 'lacks the method phi'),
])
def test_refusals_of_what_is_no_site(given, words):
    cell = lattice('honeycomb')
    cell.set_tags([0, 1])
    with pytest.raises(ValueError, match=words):
        MagneticRepulsion(cell, **{'laws': LAWS, **given})


@pytest.mark.parametrize('name', ['honeycomb', 'kagome', 'chain'])
def test_strengths_in_sums_over_all_neighbours(name):
    """Against many shells, beyond which the law has died away; its wide Gaussians are no small part of the sum."""
    law, rng = Yukawa(c=2000.0, kappa=0.5), np.random.default_rng(3)
    cell = lattice(name).repeat((2, 1, 1))
    n = len(cell)
    cell.positions[:, :2] += rng.uniform(-0.3, 0.3, (n, 2))
    strengths, q = rng.uniform(0.7, 1.3, n), np.array([[0.0, 0, 0], [0.2, 0.1, 0], [0.5, 0.3, 0]]) * cell.pbc
    everything = AllNeighbours(cell, law, foundation=0.3, strengths=strengths)
    many = MagneticRepulsion(cell, law, foundation=0.3, strengths=strengths, cutoff=61.0)
    alike = AllNeighbours(cell, law, foundation=0.3)
    there = cell.copy()
    there.positions[:, :2] += rng.uniform(-0.2, 0.2, (n, 2))
    along = np.array([1.0, 0.0])

    def series(calc):  # with the phases of the particles, not of their cells
        return calc.bloch_series(along)[2] if calc is not many else bloch_series(many.bonds, many.rest_stiffness(),
                                                                                 many.bond_vectors @ along)[2]

    for ask in (lambda calc: calc.bloch_matrix(q), lambda calc: calc.bloch_matrix(q, 'conventional'),
                lambda calc: calc.get_forces(there), series):
        expected = ask(many)
        assert apart(ask(everything), expected) < 1e-6  # the shells beyond
        assert apart(ask(alike), expected) > 1e-2
    energy = everything.get_potential_energy(there) - everything.get_potential_energy(cell)
    assert energy == pytest.approx(many.get_potential_energy(there) - many.get_potential_energy(cell), rel=1e-7)
    order = rng.permutation(2 * n)
    double = cell.repeat((2, 1, 1))[order]
    assert np.allclose(everything.on(double).strengths, np.tile(strengths, 2)[order])
