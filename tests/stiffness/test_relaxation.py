"""Patches whose particles repel beyond their nearest neighbours: where they rest, and what the linear theory needs."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from numpy.testing import assert_allclose
from scipy.optimize import brentq

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.interactions.pair_laws import repulsion
from magphonon.lattices.patches import RIM
from magphonon.stiffness.relaxation import relaxed

LAW = InversePower(b=6200.0, a=4.5824)


def patch(shells, foundation=0.02):
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), 50.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, shells=shells, foundation=foundation)
    return atoms


def test_nearest_neighbours_are_in_balance():
    atoms = patch(1)
    result = relaxed(atoms)
    assert not result.needed
    assert (result.atoms.positions == atoms.positions).all()


@pytest.mark.parametrize('foundation', [0.0, 0.02])
def test_second_neighbours_push_the_row_inside_the_rim(foundation):
    atoms = patch(2, foundation)
    result = relaxed(atoms)
    f = repulsion(LAW, 10.0)
    assert result.before > 0.1 * f
    assert result.after < 1e-9 * f
    assert result.needed
    rim = atoms.get_tags() == RIM
    assert (result.atoms.positions[rim] == atoms.positions[rim]).all()
    assert 0.05 < result.shift < 0.5  # mm, of 10 mm
    # in balance, a small push answers by the Hessian at rest; at the lattice sites it would not
    for rest, holds in ((result.atoms, True), (atoms, False)):
        pushed = rest.copy()
        pushed.calc = rest.calc
        pushed.positions[~rim, :2] += 1e-5 * np.random.default_rng(1).normal(size=((~rim).sum(), 2))
        linear = -rest.calc.get_hessian(rest) @ (pushed.positions - rest.positions).ravel()
        error = abs(pushed.get_forces() - linear.reshape(-1, 3))[~rim].max() / abs(linear).max()
        assert (error < 1e-4) == holds


def test_one_particle_between_two_rests_where_the_forces_balance():
    """On a spring anchored off the middle, by a root search in one dimension; the anchor stays."""
    line = Atoms('Nd3', positions=[[-10, 0, 0], [1.0, 0, 0], [10, 0, 0]], masses=[1, 1, 1])
    line.set_constraint(FixAtoms([0, 2]))
    line.calc = MagneticRepulsion(line, LAW, bonds=[(0, 1), (1, 2)], foundation=0.05)
    expected = brentq(lambda x: repulsion(LAW, 10 + x) - repulsion(LAW, 10 - x) - 0.05 * (x - 1), -5, 5, xtol=1e-14)
    result = relaxed(line, tolerance=1e-12)
    assert_allclose(result.atoms.positions[1], [expected, 0, 0], atol=1e-9)
    assert 0 < expected < 1
    assert result.atoms.calc.anchors[1, 0] == 1.0
    assert_allclose(result.atoms.calc.reference.positions[1], [expected, 0, 0], atol=1e-9)


def test_what_buckles_is_refused():
    """A free pair flies apart for ever."""
    pair = Atoms('Nd2', positions=[[0, 0, 0], [10, 0, 0]], masses=[1, 1])
    pair.calc = MagneticRepulsion(pair, LAW)
    with pytest.raises(ValueError, match='buckles or slides'):
        relaxed(pair, steps=30)
