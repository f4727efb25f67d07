"""DrivenVerlet against ASE's VelocityVerlet, closed forms of the discrete oscillator, and static forces."""

import tracemalloc

import numpy as np
import pytest
from ase import Atoms
from ase.calculators.lj import LennardJones
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from ase.md.verlet import VelocityVerlet
from motion import DT, L0, MASS, apart, oscillator, patch, states_of
from structures import few_first

from magphonon import DrivenVerlet, MagneticRepulsion, ToneBurst, lattices, units as u
from magphonon.dynamics import Constant, Harmonic, Recorder
from magphonon.dynamics.engine import highest_frequency
from magphonon.interactions import Yukawa

# --- it is ASE's VelocityVerlet -------------------------------------------------------------------------------------


@pytest.mark.parametrize('constraint', [None, FixAtoms(range(9)), FixedLine(24, (0.6, 0.8, 0)), FixedPlane([17], (1, 0, 0))])
@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_without_drive_and_damping_it_is_velocity_verlet_bit_for_bit(constraint, model):
    ours, theirs = (patch(model=model, speed=0.05) for _ in range(2))
    for atoms in (ours, theirs):
        atoms.set_constraint(constraint)
    seen, expected = [], []
    for dyn, trace in ((DrivenVerlet(ours, DT, engine='ase'), seen), (VelocityVerlet(theirs, DT), expected)):
        dyn.attach(lambda dyn=dyn, trace=trace: trace.append((dyn.nsteps, dyn.get_time(), dyn.atoms.get_positions(),
                                                              dyn.atoms.get_momenta())), 3)
        dyn.run(50)
        dyn.run(1)
    assert len(seen) == len(expected) == 18
    for a, b in zip(seen, expected, strict=True):
        assert all(np.array_equal(x, y) for x, y in zip(a, b, strict=True))


def test_any_calculator_of_ase_will_do():
    def argon():
        atoms = Atoms('Ar4', positions=[[0, 0, 0], [3.9, 0, 0], [0, 4.1, 0], [0.2, 0, 4.0]])
        atoms.calc = LennardJones(sigma=3.4, epsilon=0.01)
        return atoms

    ours, theirs = argon(), argon()
    dyn = DrivenVerlet(ours, 5.0)
    for _ in range(2):
        dyn.run(40)
    VelocityVerlet(theirs, 5.0).run(80)
    assert np.array_equal(ours.positions, theirs.positions)
    assert np.array_equal(dyn.displacements, theirs.positions - argon().positions)
    assert np.array_equal(dyn.velocities, theirs.get_velocities())
    assert abs(dyn.displacements).max() > 0.1


@pytest.mark.parametrize('engine', few_first(['auto', 'ase', 'compiled'], 2))
def test_motion_is_told_before_the_first_step_and_between_runs(engine):
    atoms = patch(speed=0.05)
    atoms.positions[24] += 0.3, -0.2, 0
    u, p = atoms.positions - atoms.calc.reference.positions, atoms.get_momenta()
    dyn = DrivenVerlet(atoms, DT, engine=engine)
    np.testing.assert_allclose(dyn.displacements, u[:, :2], atol=1e-14)  # positions of 50 mm are rounded
    np.testing.assert_allclose(dyn.velocities, p[:, :2] / atoms.get_masses()[:, None], rtol=1e-14)
    dyn.run(20)
    dyn.dt = DT / 2  # so that blocks are prepared anew
    np.testing.assert_allclose(dyn.displacements, (atoms.positions - atoms.calc.reference.positions)[:, :2], atol=1e-14)
    np.testing.assert_allclose(dyn.velocities * atoms.get_masses()[:, None], atoms.get_momenta()[:, :2], atol=1e-14)
    assert abs(dyn.displacements - u[:, :2]).max() > 0.01


@pytest.mark.parametrize('engine', ['ase', 'compiled'])
@pytest.mark.parametrize('what', ['drive', 'record'])
def test_another_time_step_would_turn_the_clock_back_and_is_refused(engine, what):
    atoms = patch(speed=0.05)
    dyn = DrivenVerlet(atoms, DT, [Harmonic([24], (1, 0), 1e-4, 1.3)] if what == 'drive' else [], engine=engine)
    if what == 'record':
        Recorder(dyn, [24], 5)
    dyn.dt = DT / 3  # nothing has happened yet
    dyn.run(20)
    dyn.dt = DT
    with pytest.raises(ValueError, match=r'for 20 steps .* would change the time of drives and records'):
        dyn.run(10)
    dyn.dt = DT / 3
    dyn.run(10)
    assert dyn.get_time() == pytest.approx(10 * DT)


@pytest.mark.parametrize('kappa', [40.0, 50.0])
def test_shells_at_which_a_law_underflows_say_nothing(kappa):
    """e^-693 is the last of them; warnings are errors in these tests."""
    atoms = lattices.hexagon(lattices.triangular(L0, MASS), 3 * L0)
    free = np.flatnonzero(atoms.get_tags() == 0)
    near, both = (MagneticRepulsion(atoms, Yukawa(1.0, kappa), shells=shells, foundation=0.5).balanced(free) for shells in (1, 3))
    ends = []
    for calc in (near, both):
        atoms = calc.reference.copy()
        atoms.calc = calc
        atoms.positions[free[3], 0] += 0.1
        DrivenVerlet(atoms, DT, engine='compiled').run(50)
        ends.append(atoms.positions)
    np.testing.assert_allclose(*ends, rtol=0, atol=1e-250)  # forces of 1e-300 N change nothing


@pytest.mark.slow
def test_blocks_follow_ases_loop_with_drives_damping_lines_and_planes():

    def run(engine):
        atoms = patch(speed=0.01)
        atoms.set_constraint([*atoms.constraints, FixedLine([24], (0.6, 0.8, 0)), FixedPlane([17, 18], (1, 0, 0)),
                              FixedPlane(25, (0, 0, 1)), FixedLine(30, (0, 0, 1))])
        drives = [ToneBurst([24, 16], (1, 1), 0.02, 0.3), Harmonic(17, (0, 1), 0.01, 0.2, phase=1.0),
                  Constant([31], (1, 0), 1e-3), lambda t: 1e-4 * t * np.outer(np.arange(49) == 32, (1, 0, 0))]
        return states_of(atoms, 600, 7, engine=engine, drives=drives, damping=np.linspace(0, 0.05, 49))

    ase, blocks = run('ase'), run('compiled')
    assert apart(blocks, ase) < 1e-9
    assert not ase[:, 30].any()  # a line along z
    assert not blocks[:, 30].any()
    across = blocks[:, 24] @ (0.8, -0.6)
    assert abs(across).max() < 1e-15 * L0  # round-off of u - dt v
    assert abs(blocks[:, 24] @ (0.6, 0.8)).max() > 1e-3 * L0


# --- order, frequency, decay ----------------------------------------------------------------------------------------


@pytest.mark.parametrize(('omega_dt', 'gamma'), [(0.1, 0.0), (1.0, 0.0), (1.9, 0.0), (0.3, 0.02), (1.9, 0.1)])
def test_discrete_frequency_and_decay_are_exact(omega_dt, gamma, paper):
    # One step is linear here, so u[n+1] = trace u[n] - det u[n-1].  Velocity Verlet has det = 1 and trace = 2 - (omega dt)^2,
    # that is sin(omega' dt/2) = omega dt/2; two half decays make det = exp(-gamma dt), trace = (1 + det)(1 - (omega dt)^2/2).
    omega = paper['oscillator']['omega_y'][0] / u.s  # 141.42 rad/s
    dt = omega_dt / omega
    atoms = oscillator()
    atoms.set_constraint([*atoms.constraints, FixedLine(3, (0, 1, 0))])
    atoms.set_momenta([[0, 0, 0]] * 3 + [[0, 1e-8, 0]])  # amplitude below 1e-13 of the spacing: as linear as that
    frames = states_of(atoms, 400, 1, dt, damping=gamma, engine='compiled', allow_unstable=True)[:, 3]
    assert not frames[:, 0].any()
    y = frames[:, 1] / abs(frames[:, 1]).max()
    (trace, det), *_ = np.linalg.lstsq(np.stack([y[1:-1], -y[:-2]], axis=1), y[2:])
    assert det == pytest.approx(np.exp(-gamma * dt), rel=1e-10)
    assert trace == pytest.approx((1 + np.exp(-gamma * dt)) * (1 - omega_dt**2 / 2), abs=1e-9)
    if not gamma:
        assert 2 * np.arcsin(omega_dt / 2) == pytest.approx(np.arccos(trace / 2), rel=1e-9)


@pytest.mark.slow
def test_energy_stays_bounded_over_a_million_steps():
    atoms, energy = patch(5, speed=0.1), []
    dyn = DrivenVerlet(atoms, DT, engine='compiled')
    dyn.attach(lambda: energy.append(atoms.get_total_energy()), 1000)
    dyn.run(1_000_000)
    assert dyn.engine == 'compiled'
    energy = np.array(energy) / energy[0] - 1
    assert abs(energy).max() < (highest_frequency(atoms) * DT) ** 2 / 4  # velocity Verlet's own ripple is of this order
    assert abs(energy[1:300].mean() - energy[-300:].mean()) < 0.05 * abs(energy).max()  # and no drift


# --- static forces --------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize('theta0', [0, np.pi / 6, np.pi / 2])
def test_balanced_static_forces_leave_nothing(theta0):
    atoms = oscillator(theta0)
    assert not states_of(atoms, 300, dt=0.5, engine='compiled').any()  # unstable at pi/2, yet not one bit
    balance = Constant(3, (0, 1), atoms.calc.load[3, 1])
    atoms.calc = atoms.calc.about(atoms, load=np.zeros((4, 3)))
    assert not states_of(atoms, 300, dt=0.5, drives=[balance], engine='compiled').any()
    pushed = states_of(atoms, 10, dt=0.5, engine='compiled')[-1, 3]
    assert pushed[1] > 0.01  # the control: three magnets push it up


def test_bytes_of_a_magnet_at_the_peak():
    """Of a patch with its calculator, forces and a run in blocks: 783 were measured, 1350 with lists of 64 bits."""
    def peak(n):
        tracemalloc.start()
        atoms = patch(n)
        atoms.get_forces()
        DrivenVerlet(atoms, DT, engine='compiled').run(2)
        most = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return most

    peak(100)  # what is loaded or compiled, is so before
    assert peak(100) - peak(40) < 850 * (100**2 - 40**2)
