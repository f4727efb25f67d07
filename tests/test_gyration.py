"""Gyration: particles whose velocities turn, against the matrix exponential and the quadratic eigenproblem written out here."""

from __future__ import annotations

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from ase.io import read, write
from scipy.linalg import expm

from magphonon import AllNeighbours, DrivenVerlet, InversePower, MagneticRepulsion, lattices, restored
from magphonon.dynamics import Diverged, Harmonic, highest_frequency
from magphonon.response import replicas
from magphonon.stiffness import LinearSystem, for_ase_tools
from magphonon.stiffness.defects import Scatter, scattered, without

J = np.array([[0.0, 1.0], [-1.0, 0.0]])


def drawn(rng, held=True, guided=True, n=9, alike=False):
    """A patch of random particles with masses, springs and gyration of their own, and a load that balances them."""
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)[:n]
    patch.set_constraint()
    patch.positions[:, :2] += 0.1 * rng.normal(size=(n, 2))
    patch.set_masses(rng.uniform(0.5, 2.0, n))
    if held:
        patch.set_constraint([FixAtoms([0])] + ([FixedLine([3], (1, 2, 0)), FixedLine([5], (0, 1, 0))] if guided else []))
    calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), cutoff=1.6, foundation=rng.uniform(5, 9, (n, 2)),
                             gyration=1.3 if alike else 1.5 * rng.normal(size=n))
    patch.calc = calc.balanced(range(n))
    return patch


def oracle(atoms, damping=0.0, gyration=True):
    """Matrices M, C and K of all directions by definition, and the free directions."""
    n, m = len(atoms), atoms.get_masses()
    K = atoms.calc.rest_hessian().toarray()
    g = np.broadcast_to(atoms.calc.gyration, n) * gyration
    C = np.zeros((2 * n, 2 * n))
    for k in range(n):
        C[2 * k : 2 * k + 2, 2 * k : 2 * k + 2] = m[k] * (np.broadcast_to(damping, n)[k] * np.eye(2) - g[k] * J)
    P = []
    lines = {k: c.dir[:2] / np.linalg.norm(c.dir[:2]) for c in atoms.constraints if isinstance(c, FixedLine) for k in c.index}
    held = {k for c in atoms.constraints if isinstance(c, FixAtoms) for k in c.index}
    for k in set(range(n)) - held:
        for d in [lines[k]] if k in lines else np.eye(2):
            P.append(np.zeros((n, 2)))
            P[-1][k] = d
    P = np.array(P).reshape(len(P), -1).T
    return np.diag(np.repeat(m, 2)), C, K, P


def flow(M, C, K, P):
    """Generator of (u, v) of the free directions."""
    M, C, K = (P.T @ X @ P for X in (M, C, K))
    return np.block([[np.zeros_like(M), np.eye(len(M))], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])


@pytest.mark.parametrize('engine', ['ase', 'numpy', 'compiled'])
def test_time_steps_turn_velocities_as_the_matrix_exponential_does_to_second_order(engine):
    rng = np.random.default_rng(1)
    for alike in False, True:
        patch = drawn(rng, alike=alike)
        damping = rng.uniform(0, 0.3, len(patch))
        M, C, K, P = oracle(patch, damping)
        wrong = flow(M, oracle(patch, damping, gyration=False)[1], K, P)
        z = 1e-6 * rng.normal(size=2 * P.shape[1])
        w, force = 2.0, P @ rng.normal(size=P.shape[1]) * 1e-6
        # a harmonic force as two more coordinates, cos and sin
        push = np.concatenate([np.zeros(P.shape[1]), np.linalg.solve(P.T @ M @ P, P.T @ force)])
        ends = []
        for A in flow(M, C, K, P), wrong:
            whole = np.block([[A, push[:, None], 0 * push[:, None]], [np.zeros((2, len(z))), w * np.array([[0, 1], [-1, 0]])]])
            ends.append(P @ (expm(2.0 * whole) @ [*z, 0, 1])[: P.shape[1]])
        exact, without = (end.reshape(-1, 2) for end in ends)
        errors = []
        for steps in 80, 160:
            atoms = patch.copy()
            atoms.calc = patch.calc
            start = (P @ z.reshape(2, -1).T).reshape(-1, 2, 2)
            atoms.positions[:, :2] += start[..., 0]
            atoms.set_momenta(np.pad(start[..., 1], ((0, 0), (0, 1))) * atoms.get_masses()[:, None])
            drive = Harmonic(range(len(atoms)), (1, 0, 0), force.reshape(-1, 2)[:, 0], w)
            other = Harmonic(range(len(atoms)), (0, 1, 0), force.reshape(-1, 2)[:, 1], w)
            dyn = DrivenVerlet(atoms, 2.0 / steps, [drive, other], damping=damping, engine=engine)
            dyn.run(steps)
            errors.append(abs(dyn.displacements - exact).max() / abs(exact).max())
        assert errors[1] < 0.01
        assert 3.5 < errors[0] / errors[1] < 4.5
        assert abs(without - exact).max() > 0.2 * abs(exact).max()  # what it would be if nothing turned


def test_compiled_threads_and_tables_turn_as_numpy_does():
    ends = []
    for engine in 'numpy', 'compiled':
        patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 40.0)
        patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0, gyration=2.0)
        patch.set_momenta(1e-3 * np.random.default_rng(3).normal(size=(len(patch), 3)) * [1, 1, 0])
        dyn = DrivenVerlet(patch, 0.05, engine=engine, threads=2)
        dyn.run(60)
        ends.append(dyn.displacements)
    assert abs(ends[1] - ends[0]).max() < 1e-13 * abs(ends[0]).max()


@pytest.mark.parametrize('engine', ['ase', 'numpy', 'compiled'])
def test_turning_does_no_work_and_leaves_the_limit_of_the_time_step_alone(engine):
    def largest(share):
        patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
        patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0, gyration=3.0)
        patch.set_momenta(1e-9 * np.random.default_rng(3).normal(size=(len(patch), 3)) * [1, 1, 0])
        dyn = DrivenVerlet(patch, share * 2 / highest_frequency(patch), engine=engine, allow_unstable=True)
        start = patch.get_kinetic_energy()
        dyn.run(400)
        return patch.get_kinetic_energy() / start

    assert largest(0.99) < 10
    if engine == 'numpy':
        with pytest.raises(Diverged):
            largest(1.3)


def test_orders_above_two_are_refused_when_anything_turns():
    patch = drawn(np.random.default_rng(0))
    with pytest.raises(ValueError, match='steps of order 4 and 6 know no gyration'):
        DrivenVerlet(patch, 0.01, order=4)
    patch.calc.set(gyration=0.0)
    dyn = DrivenVerlet(patch, 0.01, order=4)
    patch.calc.set(gyration=1.0)
    with pytest.raises(ValueError, match='know no gyration'):
        dyn.run(1)


def test_the_matrix_of_velocities_is_that_of_the_definition():
    rng = np.random.default_rng(4)
    for guided in False, True:
        patch = drawn(rng, guided=guided)
        damping = rng.uniform(0, 1, len(patch))
        M, C, _, P = oracle(patch, damping)
        system, root = LinearSystem.of(patch, gyrating=True), np.sqrt(np.linalg.inv(P.T @ M @ P))
        ours = system.shapes.toarray() @ system.B(damping).toarray() @ system.shapes.toarray().T  # in any order of directions
        assert abs(ours - P @ root @ (root @ P.T @ C @ P @ root) @ root @ P.T).max() < 1e-14
    assert system.gyration.shape == (len(patch),)


def test_gyration_is_kept_by_files_supercells_and_places(tmp_path):
    cell = lattices.honeycomb(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=6.0, gyration=[1.0, 2.0])
    write(tmp_path / 'cell.traj', cell)
    again = restored(read(tmp_path / 'cell.traj'))
    assert again.calc.gyration.tolist() == [1.0, 2.0]
    large = cell.repeat((2, 3, 1))
    assert cell.calc.on(large).gyration.tolist() == 6 * [1.0, 2.0]
    assert cell.calc.about(cell).gyration.tolist() == [1.0, 2.0]
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    own = np.arange(len(patch)) / 10
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=6.0, gyration=own)
    assert without(patch, [3]).calc.gyration.tolist() == np.delete(own, 3).tolist()
    assert scattered(patch, Scatter(mass=0.1), 1).calc.gyration.tolist() == own.tolist()
    assert replicas([patch, patch]).calc.gyration.tolist() == 2 * own.tolist()
    assert not cell.calc.gyration.flags.writeable
    cell.calc.set(gyration=0.0)
    assert cell.calc.gyration == 0.0
    assert 'gyration' not in cell.calc.todict()
    for bad, words in (([1.0], 'one for each of the 2'), (np.nan, 'gyration'), ('x', 'gyration')):
        with pytest.raises(ValueError, match=words):
            cell.calc.set(gyration=bad)


def test_who_sees_forces_alone_refuses_particles_that_gyrate():
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=6.0, gyration=1.0)
    large = cell.repeat((2, 2, 1))
    large.calc = cell.calc
    for ask in (lambda: LinearSystem.of(cell), lambda: LinearSystem.nearest(cell), lambda: for_ase_tools(cell),
                large.get_forces, lambda: LinearSystem.of(LinearSystem.of(cell, gyrating=True))):
        with pytest.raises(ValueError, match=r'know no gyration.*1000 rad/s'):
            ask()
    with pytest.raises(TypeError, match='gyration'):
        AllNeighbours(cell, InversePower(1.0, 4.0), gyration=1.0)
    with pytest.raises(ValueError, match='in the plane'):
        MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=[[6.0, 6.0, 9.0]], gyration=1.0)
