"""The calculator as physics: forces are the slope of an energy, as `test_methods_compared` asks of drawn ones."""

import numpy as np
import pytest
from ase import Atoms
from cells import LAW, triangular_patch
from oracles import lattice

from magphonon import MagneticRepulsion
from magphonon.interactions.pair_laws import repulsion


def planar_forces(atoms, calc):
    atoms.calc = calc
    return atoms.get_forces(apply_constraint=False)[:, : calc.dim].ravel()


def test_planar_particles_feel_nothing_along_z():
    atoms = triangular_patch(foundation=0.02)
    plane = atoms.get_forces()
    assert not plane[:, 2].any()
    atoms.positions[3, 2] += 0.7
    np.testing.assert_array_equal(atoms.get_forces(), plane)


@pytest.mark.parametrize('z', [-3.7, 0.1, 1e5 / 3])
def test_the_plane_may_lie_at_any_height(z):
    rest = lattice('kagome')
    raised = rest.copy()
    raised.positions[:, 2] = z
    raised.positions[1, 2] = np.nextafter(z, np.inf)  # the round-off of fractions of a tall cell
    raised.calc = MagneticRepulsion(raised, LAW)
    rest.calc = MagneticRepulsion(rest, LAW)
    for atoms in (rest, raised):
        atoms.positions[0, :2] += [0.3, -0.2]
    np.testing.assert_allclose(raised.get_forces(), rest.get_forces(), rtol=0, atol=1e-12 * repulsion(LAW, 10.0))


# Anchors


def test_anchors_stay_where_they_were():
    rest = lattice('square').repeat((3, 3, 1))
    calc = MagneticRepulsion(rest, LAW, foundation=0.5)
    atoms = rest.copy()
    rest.positions += 1.0  # after the calculator was made
    assert abs(planar_forces(atoms, calc)).max() < 1e-14
    assert abs(planar_forces(rest, calc) + 0.5).max() < 1e-14  # a translation stretches the springs alone


# Contact


def test_frozen_directions_do_not_let_particles_pass():
    rest = Atoms('Nd2', positions=[[0, 0, 0], [10, 0, 0]])
    atoms = rest.copy()
    atoms.positions[0, 0] = 14.0  # on the other side: for the complete model a place like any other
    assert planar_forces(atoms, MagneticRepulsion(rest, LAW))[0] > 0
    with pytest.raises(ValueError, match='passed through each other'):
        planar_forces(atoms, MagneticRepulsion(rest, LAW, model='conventional'))
