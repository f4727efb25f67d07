"""What constraints leave free, against projectors of their own."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixBondLength, FixCartesian, FixedLine, FixedPlane
from numpy.testing import assert_allclose
from oracles import allowed_motion, free_basis, small_cluster

from magphonon import InversePower, MagneticRepulsion, modes
from magphonon.stiffness.rest import LinearSystem, freedom, refuse_held

LAW = InversePower(b=5e3, a=4.0)


def cluster(*constraints):
    atoms = small_cluster()
    atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=18.0, foundation=1.0)
    atoms.set_constraint(constraints)
    return atoms


def drawn(seed):
    """Six of nine particles are held, or guided along or across a direction: any one in the plane, an axis, or z.

    Of two thirds of them every particle is also held in the plane, as the messages on motion out of it advise, before or after.
    """
    rng = np.random.default_rng(seed)
    plane = [FixedPlane(range(9), (0, 0, 1))]
    if seed % 3 == 1:
        yield from plane
    for particle in rng.permutation(9)[:6].tolist():
        angle = rng.uniform(0, 2 * np.pi)
        direction = [(np.cos(angle), np.sin(angle), 0), (np.cos(angle), np.sin(angle), 0), (1, 0, 0), (0, 0, 1)][rng.integers(4)]
        direction = direction + 1e-17 * rng.normal(size=3)  # turned by a matrix
        yield [FixAtoms([particle]), FixedLine(particle, direction), FixedPlane(particle, direction),
               FixCartesian([particle], rng.random(3) < 0.5)][rng.integers(4)]
    if seed % 3 == 2:
        yield from plane


@pytest.mark.parametrize('seed', range(12))
def test_free_directions_span_what_the_constraints_allow(seed):
    atoms = cluster(*drawn(seed))
    B, expected = LinearSystem(atoms).free.toarray(), free_basis(atoms, 2)
    assert_allclose(B.T @ B, np.eye(B.shape[1]), atol=1e-15)
    assert_allclose(B @ B.T, expected @ expected.T, atol=1e-14)  # the same space, whatever its basis
    assert ((B != 0).reshape(9, 2, -1).any(axis=1).sum(axis=0) == 1).all()  # one particle in each column
    mobile, guided, barred = freedom(atoms)
    allowed = mobile[:, None, None] * np.eye(2)
    allowed[guided] -= barred
    assert_allclose(allowed, allowed_motion(atoms, 2), atol=1e-15)
    other = cluster(*drawn(seed + 1))  # the control
    assert abs(free_basis(other, 2) @ free_basis(other, 2).T - B @ B.T).max() > 0.1


@pytest.mark.parametrize(('constraints', 'message'), [
    ([FixedLine(2, (1, 0, 1))], 'guides a particle'),
    ([FixedPlane(2, (0, 1, 0.5))], 'guides a particle'),
    ([FixedLine([2, 3], (1, 0, 0)), FixedPlane([3, 4], (0, 1, 0))], 'guides a particle'),
    ([FixBondLength(0, 1)], 'only FixAtoms, FixCartesian, FixedLine and FixedPlane are supported'),
    ([FixAtoms(range(9))], 'hold every particle'),
])
def test_other_constraints_are_refused(constraints, message):
    with pytest.raises(ValueError, match=message):
        modes(cluster(*constraints))


@pytest.mark.parametrize('seed', range(12))
def test_forces_are_refused_only_where_nothing_is_left_of_them(seed):
    atoms = cluster(*drawn(seed))
    held = np.eye(2) - allowed_motion(atoms, 2)
    force = np.zeros((9, 3))
    force[:, :2] = np.einsum('pxy,py->px', held, np.random.default_rng(seed).normal(size=(9, 2)))
    with pytest.raises(ValueError, match='would do nothing'):
        refuse_held(force, atoms, 'the force')
    force[np.trace(held, axis1=1, axis2=2).argmin(), :2] += 1e-9  # of particles that are free, or of the freest
    refuse_held(force, atoms, 'the force')
    refuse_held(np.zeros((9, 3)), atoms, 'the force')
