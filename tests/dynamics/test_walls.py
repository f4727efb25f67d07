"""Held particles that move as prescribed: time steps, linear answers and scenes, against equations of motion written out here."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from oracles import free_basis
from scipy.linalg import expm
from structures import held_by, structure

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    ToneBurst,
    frequency_response,
    lattices,
    propagate,
    read_scene,
    units as u,
)
from magphonon.dynamics import Harmonic, PrescribedMotion, Recorder, write_lammps_input
from magphonon.response.frf import Transmissibility
from magphonon.stiffness.rest import LinearSystem

pytestmark = pytest.mark.slow   # each compiles kernels of its own, which takes seconds


def held_patches(count, **options):
    """Drawn finite structures in the plane with a held part that bonds reach, the oracle's pairs, and their walls."""
    seed = 40
    while count:
        case, seed = structure(seed, periodic=False, layer=False, **{'free edges': False}, **options), seed + 1
        held = held_by(case.atoms)
        if case.dim == 2 and 0 < len(held) < len(case.atoms):
            rng = np.random.default_rng([seed, 4])
            yield case, rng.permutation(held)[: rng.integers(1, len(held) + 1)], rng
            count -= 1


def steps_by_hand(case, atoms, walls, dt, steps, gamma, load):
    """Velocity Verlet with forces of the oracle, where walls are put to their places before each evaluation."""
    x0, m, B = case.truth.x, case.truth.masses[:, None], free_basis(atoms, 2)
    x, v, decay = x0.copy(), np.zeros((len(x0), 2)), np.exp(-gamma * dt / 2)[:, None]
    particles, course = walls

    def force(x):
        f = case.truth.pairs.forces(x) - case.truth.k * (x - x0)[:, :2] + load
        return (B @ (B.T @ f.ravel())).reshape(-1, 2)

    x[particles] = x0[particles] + course(0.0)
    f = force(x)
    for n in range(1, steps + 1):
        v = decay * v + dt / 2 * f / m
        x[:, :2] += dt * v
        x[particles] = x0[particles] + course(n * dt)
        f = force(x)
        v = decay * (v + dt / 2 * f / m)
    return (x - x0)[:, :2]


@pytest.mark.parametrize('engine', ['ase', 'compiled'])
def test_engines_take_walls_where_they_are_prescribed(engine):
    for case, walls, rng in held_patches(2, conventional=False, most=12):
        atoms = LinearSystem.about(case.atoms.calc.about(case.atoms), case.atoms).atoms
        pitch, phase = rng.normal(size=(len(walls), 2)) * 0.2, rng.uniform(0, 6, len(walls))
        gamma = rng.uniform(0, 0.01, len(atoms))
        fastest = np.sqrt(case.truth.fastest(np.linalg.eigvalsh(case.truth.stiffness) / case.truth.masses.min()) ** 2)
        dt, w = 0.05 / fastest, 0.7 * fastest

        def course(t, pitch=pitch, w=w, phase=phase):
            return np.pad(pitch * np.sin(w * t + phase)[:, None], ((0, 0), (0, 1)))

        load = -case.truth.pairs.forces(case.truth.x)  # what stands for all that held it at rest
        expected = steps_by_hand(case, atoms, (walls, course), dt, 45, gamma, load)
        atoms.calc = atoms.calc.balanced(np.arange(len(atoms)))
        dyn = DrivenVerlet(atoms, dt, [PrescribedMotion(course, walls)], gamma, engine=engine)
        seen = Recorder(dyn, interval=15)
        dyn.run(45)
        assert dyn.engine == engine
        np.testing.assert_allclose(dyn.displacements, expected, rtol=0, atol=1e-9)
        np.testing.assert_allclose(seen.displacements[0][walls], course(0.0)[:, :2], atol=1e-14)
        still = np.setdiff1d(held_by(atoms), walls)
        assert not dyn.displacements[still].any()
        assert not dyn.velocities[walls].any()


@pytest.mark.slow
def test_every_engine_and_order_takes_the_walls_along():
    row, ends = chain(10), {}
    for engine in ('ase', 'compiled'):
        for order in (2, 4, 6):
            atoms = row.copy()
            atoms.calc = row.calc
            wall = PrescribedMotion(ToneBurst([0], (1, 0.4), 0.03, 2.0, 2))
            dyn = DrivenVerlet(atoms, 0.004 if order == 2 else 0.03, [wall], 0.1, engine=engine, order=order)
            dyn.run(round(6 / dyn.dt))
            ends[engine, order] = dyn.displacements
    most = abs(ends['ase', 6]).max()
    for (_, order), u_end in ends.items():
        assert abs(u_end - ends['ase', order]).max() < 1e-9 * most  # ASE's loop has absolute positions
        assert abs(u_end - ends['ase', 6]).max() < {2: 1e-4, 4: 1e-6, 6: 1e-9}[order] * most


def chain(n, k=5.0):
    row = lattices.chain(1.0, 1.0).repeat((n, 1, 1))
    row.pbc = False
    row.calc = MagneticRepulsion(row, InversePower(1.0, 4.0), foundation=k).balanced([0, n - 1])
    row.set_constraint(FixAtoms([0]))
    return row


@pytest.mark.parametrize('engine', ['ase', 'compiled'])
def test_walls_may_be_exchanged_and_runs_restarted(engine):
    row = chain(8)
    dyn = DrivenVerlet(row, 0.05, [PrescribedMotion(Harmonic([0], (1, 0), 0.02, 1.5))], 0.1, engine=engine)
    dyn.run(41)
    dyn.drives = [PrescribedMotion(Harmonic([0], (0, 1), 0.02, 1.2))]  # from where it is back to its line, at once
    dyn.run(20)
    assert dyn.displacements[0] == pytest.approx([0, 0.02 * np.sin(1.2 * 61 * 0.05)], abs=1e-12)
    again = chain_like(row)
    other = DrivenVerlet(again, 0.05, dyn.drives, 0.1, engine=engine)
    other.nsteps = dyn.nsteps
    for one in (dyn, other):
        one.run(20)
    np.testing.assert_allclose(other.displacements, dyn.displacements, rtol=0, atol=1e-13)


class Toda:
    """phi = e^{-(r - L)}, the lattice of Toda: a chain of it has exact solitary waves."""

    def phi(self, r):
        return np.exp(10.0 - r)

    def dphi(self, r):
        return -self.phi(r)

    def d2phi(self, r):
        return self.phi(r)


def test_a_driven_end_sends_the_exact_solitary_wave_of_toda():
    """u_n = ln[(1 + e^{2 (kappa (n - 1) - s t)})/(1 + e^{2 (kappa n - s t)})] + 2 kappa, s = sinh kappa: Toda, 1967."""
    n, kappa, start = 16, 1.1, 7.0
    row = lattices.chain(10.0, 1.0).repeat((n, 1, 1))
    row.pbc = False
    row.calc = MagneticRepulsion(row, Toda()).balanced([0, n - 1])
    row.set_constraint([FixAtoms([0, n - 1]), FixedLine(range(1, n - 1), (1, 0, 0))])

    def exact(k, t):
        s = np.sinh(kappa)
        return 2 * kappa + np.logaddexp(0, 2 * (kappa * (k - 1) - s * (t - start))) - np.logaddexp(
            0, 2 * (kappa * k - s * (t - start)))

    dyn = DrivenVerlet(row, 0.1, [PrescribedMotion(lambda t: [[exact(0, t), 0, 0]], [0])], order=6)
    seen = Recorder(dyn, interval=20)
    dyn.run(140)
    true = exact(np.arange(n), seen.times[:, None])
    before = exact(np.arange(n), 0.0)  # what the wave has done at the start, e^-18 of it
    assert abs(before).max() < 1e-7
    assert abs(seen.displacements[..., 0] - true)[:, :-3].max() < 2e-7
    wall = PrescribedMotion(lambda t: [[exact(0, t), 0, 0]], [0])
    linear = propagate(chain_like(row), seen.times, [wall]).displacements[..., 0]
    assert abs(linear - true)[:, :-3].max() > 0.3  # the control: no sum of linear waves


def chain_like(row):
    other = row.copy()
    other.calc = row.calc
    return other


def test_walls_drive_linear_answers_by_the_stiffness_of_their_bonds():
    for case, walls, rng in held_patches(5, most=14):
        atoms, n = case.atoms, len(case.atoms)
        H, M, B = case.reduced(case.truth)
        if not H.size or np.linalg.eigvalsh(H)[0] < 1e-3 * abs(H).max():
            continue
        U = np.zeros((n, 3), complex)
        U[walls, :2] = rng.normal(size=(len(walls), 2)) + 1j * rng.normal(size=(len(walls), 2))
        gamma = rng.uniform(0.01, 0.2, n) if rng.random() < 0.5 else np.full(n, 0.1)
        c = B.T @ (np.repeat(gamma * case.truth.masses, 2)[:, None] * B)
        w = np.sqrt(abs(H).max() / np.diag(M).max()) * 0.6
        found = frequency_response(atoms, None, [w], gamma, walls=U)
        assert isinstance(found, Transmissibility)
        pull = -B.T @ case.truth.stiffness @ U[:, :2].ravel()
        free = (B @ np.linalg.solve(H - w**2 * M + 1j * w * c, pull)).reshape(n, 2)
        np.testing.assert_allclose(found.response[0, :, :2], free + U[:, :2], rtol=0, atol=1e-9 * abs(U).max())

        # in time, the wall as a clock beside: U cos(wt) and its turn
        real, zero = U.real, np.zeros_like(H)
        push = np.linalg.solve(M, -B.T @ case.truth.stiffness @ real[:, :2].ravel())
        whole = np.zeros((2 * len(H) + 2,) * 2)
        whole[:-2, :-2] = np.block([[zero, np.eye(len(H))], [-np.linalg.solve(M, H), -np.linalg.solve(M, c)]])
        whole[len(H) : -2, -2], whole[-2, -1], whole[-1, -2] = push, w, -w
        times = np.array([0.0, 2.0, 30.0]) / w
        moved = propagate(LinearSystem.of(atoms).atoms, times,
                          [PrescribedMotion(lambda t, real=real, walls=walls, w=w: real[walls] * np.cos(w * t), walls)],
                          gamma).displacements
        for t, here in zip(times, moved, strict=True):
            y = expm(whole * t)[:, -2]
            true = (B @ y[: len(H)]).reshape(n, 2) + real[:, :2] * np.cos(w * t)
            np.testing.assert_allclose(here, true, rtol=0, atol=1e-8 * abs(real).max())


@pytest.mark.parametrize(('model', 'amplitude'), [('complete', 0.8178), ('conventional', 0.9025)])
def test_behind_a_wall_the_prototype_moves_as_its_complex_wave(model, amplitude):
    strip = read_scene('prototype').atoms().repeat((1, 700, 1))
    strip.pbc = (True, False, False)
    strip.calc = MagneticRepulsion(strip, read_scene('prototype').atoms().calc.laws, model=model,
                                   foundation=19.675721234 * u.N / u.m).balanced([0, 699])
    strip.set_constraint(FixAtoms([0, 699]))
    U = np.zeros((700, 3))
    U[0, 0] = 1.0
    found = frequency_response(strip, None, [2 * np.pi * 40 * u.Hz], 4 / u.s, walls=U).response[0, :, 0]
    assert abs(found[10]) == pytest.approx(amplitude, abs=5e-5)
    edge = {'complete': 51.8276683282, 'conventional': np.sqrt(2 * 4.5824 * 0.236895178822 / 7.07e-6) / (2 * np.pi)}[model]
    xi = 2 * np.arcsin(np.sqrt(40**2 + 1j * 40 * 4 / (2 * np.pi) - 26.550686524**2) / edge)
    np.testing.assert_allclose(found[:12], np.exp(-1j * xi.conj() * np.arange(12)), atol=2e-5)  # what the far side sends back


def test_walls_are_refused_where_they_mean_nothing(tmp_path):
    row, push = chain(8), Harmonic([0], (1, 0), 1e-3, 1.0)
    for run in (lambda wall: DrivenVerlet(row, 0.01, [wall]), lambda wall: propagate(row, [1.0], [wall])):
        with pytest.raises(ValueError, match='particle 3 is free; hold it'):
            run(PrescribedMotion(Harmonic([0, 3], (1, 0), 1e-3, 1.0)))
    with pytest.raises(ValueError, match='must be a drive, with amplitudes in mm'):
        PrescribedMotion(np.sin)
    with pytest.raises(ValueError, match='only forces are accepted'):
        write_lammps_input(tmp_path, row, timestep=0.01, steps=1, drives=[PrescribedMotion(push)])
    free = np.zeros((8, 3))
    free[3, 0] = 1
    with pytest.raises(ValueError, match='particle 3 is free'):
        frequency_response(row, None, [1.0], 0.1, walls=free)
    with pytest.raises(ValueError, match='nothing drives the structure; give a force'):
        frequency_response(row, None, [1.0], 0.1)
    with pytest.raises(ValueError, match=r'\(8, 3\)'):
        frequency_response(row, None, [1.0], 0.1, walls=free[:3])
