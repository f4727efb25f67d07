"""The exact linear transient: oscillators and chains in closed form, matrix exponentials."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixCom, FixedLine, FixedPlane
from hypothesis import given, settings, strategies as st
from motion import apart, oscillator, patch

from magphonon import InversePower, MagneticRepulsion, ToneBurst, lattices, units as u
from magphonon.dynamics import Harmonic
from magphonon.response import propagation
from magphonon.response.chebyshev import Interval, Outside
from magphonon.response.propagation import _resolved, propagate
from magphonon.stiffness.rest import LinearSystem

K_YY, MASS = 20000 * u.N / u.m, 1 * u.kg  # Sec. III of the paper, theta0 = 0, vertical
OMEGA = np.sqrt(K_YY / MASS)
TIMES = np.linspace(0, 300, 40)


def released(atoms, seed=0, size=1e-3):
    """Random displacements and velocities of what is free."""
    rng = np.random.default_rng(seed)
    dim = atoms.calc.dim
    free = np.ones(len(atoms), bool)
    for constraint in atoms.constraints:
        free[constraint.index] = False
    d, p = np.zeros((2, len(atoms), 3))
    d[free, :dim], p[free, :dim] = size * rng.standard_normal((2, free.sum(), dim))
    atoms.positions += d
    atoms.set_momenta(p)
    return atoms


@pytest.mark.parametrize('omega', [0.3 * OMEGA, OMEGA, 3.7 * OMEGA])
def test_harmonic_force_is_the_closed_form_at_resonance_too(omega):
    atoms = oscillator()
    force = 1e-2
    found = propagate(atoms, TIMES, [Harmonic(3, (0, 1), force, omega)]).displacements[:, 3, 1]
    if omega == OMEGA:
        expected = (np.sin(OMEGA * TIMES) / OMEGA - TIMES * np.cos(OMEGA * TIMES)) / 2 / OMEGA
    else:
        expected = (np.sin(omega * TIMES) - omega / OMEGA * np.sin(OMEGA * TIMES)) / (OMEGA**2 - omega**2)
    np.testing.assert_allclose(found, force / MASS * expected, atol=1e-9 * abs(force / MASS * expected).max())


def test_a_step_and_a_ramp_as_plain_functions():
    atoms = oscillator()
    on = 123.456789  # ms, where no panel ends

    def force(course):
        def drive(t):
            return np.array([[0.0] * 3] * 3 + [[0, 1e-2 * course(t), 0]])
        return drive

    late = on < TIMES
    s = TIMES[late] - on
    step = propagate(atoms, TIMES, [force(lambda t: float(t > on))]).displacements[:, 3, 1]
    expected = 1e-2 / K_YY * (1 - np.cos(OMEGA * s))
    np.testing.assert_allclose(step[late], expected, atol=1e-9 * expected.max())
    ramp = propagate(atoms, TIMES, [force(lambda t: max(t - on, 0.0))]).displacements[:, 3, 1]
    expected = 1e-2 / K_YY * (s - np.sin(OMEGA * s) / OMEGA)
    np.testing.assert_allclose(ramp[late], expected, atol=1e-9 * expected.max())
    assert abs(step[~late]).max() < 1e-12 * abs(step).max()


@pytest.mark.slow
def test_a_drive_that_is_no_function_of_the_time_is_refused():
    atoms = oscillator()
    rng = np.random.default_rng(0)
    with pytest.raises(ValueError, match=r'the drive cannot be resolved near \d+'):
        propagate(atoms, [20.0], [lambda t: np.array([[0.0] * 3] * 3 + [[0, rng.normal(), 0]])])


@pytest.mark.filterwarnings('ignore:a damping of')
@settings(deadline=None, max_examples=12)
@given(tolerance=st.floats(1e-12, 1e-1), duration=st.floats(0.1, 1000), gamma=st.sampled_from([0.0, 0.01, 3.0]),
       frames=st.integers(1, 20), driven=st.booleans())
def test_the_tolerance_is_met(tolerance, duration, gamma, frames, driven):
    atoms = released(patch(5))
    drives = [ToneBurst([6, 12], (1, 2), 1e-4, 2 * np.pi * 0.05)] if driven else []
    times = duration * np.arange(1, frames + 1) / frames
    exact = propagate(atoms, times, drives, damping=gamma, tolerance=1e-14)  # the tests above have judged it
    found = propagate(atoms, times, drives, damping=gamma, tolerance=tolerance)
    error = abs(found.displacements - exact.displacements).max()
    largest = abs(exact.displacements).max()
    assert error <= tolerance * largest + exact.error  # what round-off spoils, exact.error tells
    assert error <= found.error + exact.error
    assert found.products <= exact.products


def test_the_estimate_of_the_error_holds_round_off_too():
    """Far below what floating numbers can do, after hundreds of periods, against the modes of the dense matrix."""
    atoms, times = patch(speed=0.05), np.array([700.0, 900.0])
    squares, vectors = np.linalg.eigh(LinearSystem.of(atoms).K.toarray())
    shapes = LinearSystem.of(atoms).shapes
    start = vectors.T @ (shapes.T @ atoms.get_momenta()[:, :2].ravel())
    omega = np.sqrt(squares)
    expected = np.array([shapes @ (vectors @ (np.sin(omega * t) / omega * start)) for t in times]).reshape(2, -1, 2)
    found = propagate(atoms, times, tolerance=1e-15)
    off, largest = abs(found.displacements - expected).max(), abs(expected).max()
    assert 1e-15 * largest < off < found.error < 1e-9 * largest  # off by more than the series was asked for


def test_a_particle_in_another_image_of_its_cell_is_at_rest_on_its_guide():
    """The way back from there costs a round-off of 1e-15 mm across the guide, which was refused as a displacement."""
    atoms = lattices.triangular(spacing=10.0, mass=0.7).repeat((3, 2, 1))
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=5e3, a=3.0))
    atoms.set_constraint(FixedPlane(2, (0.6, 0.8, 0)))
    momenta = np.zeros((6, 3))
    momenta[2] = 1e-3 * np.array([0.8, -0.6, 0])
    atoms.set_momenta(momenta)
    here = propagate(atoms, [3.0]).displacements
    seen = 0.0
    for image in range(1, 9):
        there = atoms.copy()
        there.calc = atoms.calc
        there.positions[2] += image * (atoms.cell.array[0] - atoms.cell.array[1])
        seen = max(seen, abs(there.calc.displacements(there)).max())
        assert propagate(there, [3.0]).displacements == pytest.approx(here, abs=1e-12 * abs(here).max())
        there.positions[2, 0] += 1e-11  # mm, across its guide too
        with pytest.raises(ValueError, match='in which it is held'):
            propagate(there, [3.0])
    assert seen > 0


def test_parts_of_a_long_run_join(monkeypatch):
    atoms = released(patch(5))
    drives = [ToneBurst(12, (1, 0), 1e-4, 2 * np.pi * 0.05, start=20.0), Harmonic([7, 8], (0, 1), 1e-4, [0.2, 0.35])]
    times = np.linspace(0, 200, 33)
    whole = propagate(atoms, times, drives, damping=0.01, tolerance=1e-12)
    for name, value in (('SPAN', 30.0), ('LARGEST', 500)):
        with monkeypatch.context() as patched:
            patched.setattr(propagation, name, value)
            parts = propagate(atoms, times, drives, damping=0.01, tolerance=1e-12)
            coarse = propagate(atoms, times[-1:], drives, damping=0.01, tolerance=1e-3)
        assert apart(coarse.displacements, whole.displacements[-1:]) < 1e-3
        assert parts.products > whole.products
        assert apart(parts.displacements, whole.displacements) < 2e-12
        assert apart(parts.velocities, whole.velocities) < 2e-12


def test_a_motion_without_a_series_is_refused_and_does_not_fill_the_memory():
    interval = Interval(0.0, 1.0)
    smooth = _resolved(lambda w2: np.cos(3 * w2)[None, None, None], interval, 20)
    assert smooth.shape == (1, 1, 1, 20)
    with pytest.raises(ArithmeticError, match='needs over 320 terms'):
        _resolved(lambda w2: (w2 > 0.3).astype(float)[None, None, None], interval, 20)


def test_chosen_particles_move_as_in_the_whole():
    atoms = released(patch(6))
    burst = ToneBurst(14, (1, 0), 1e-4, 2 * np.pi * 0.05)
    everywhere = propagate(atoms, TIMES, [burst], tolerance=1e-11)
    some = propagate(atoms, TIMES, [burst], particles=[21, 0, 8], tolerance=1e-11)
    assert apart(some.displacements, everywhere.displacements[:, [21, 0, 8]]) < 3e-11
    np.testing.assert_array_equal(some.particles, [21, 0, 8])


@pytest.mark.filterwarnings('ignore:the stiffest bond')
def test_replicas_at_frequencies_of_their_own():
    omega = np.array([0.05, 0.1, 0.3])
    atoms = Atoms('Nd4', positions=[[0, 0, 0], [10, 0, 0], [20, 0, 0], [30, 0, 0]], masses=[2.0] * 4)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=1e-9, a=3.0), foundation=0.08)  # a law too weak to matter
    atoms.calc = atoms.calc.balanced([0, 3])
    found = propagate(atoms, TIMES, [Harmonic([0, 1, 3], (0, 1), 1e-3, omega)]).displacements[..., 1]
    own = 0.2  # sqrt(0.08/2)
    expected = 1e-3 / 2 * (np.sin(omega * TIMES[:, None]) - omega / own * np.sin(own * TIMES[:, None])) / (own**2 - omega**2)
    np.testing.assert_allclose(found[:, [0, 1, 3]], expected, atol=1e-9 * abs(expected).max())
    assert abs(found[:, 2]).max() < 1e-9 * abs(expected).max()


def test_a_vector_outside_the_interval_is_noticed(monkeypatch):
    atoms = released(patch(5))
    monkeypatch.setattr(propagation, 'stable_interval', lambda K: Interval(0.0, 0.5))  # omega_max^2 is 0.88
    monkeypatch.setattr(propagation, 'whole_interval', lambda K: Interval(-0.1, 0.5))
    with pytest.raises(Outside):
        propagate(atoms, [200.0])


def test_bad_structures_are_refused():
    atoms = patch(5)
    atoms.positions[1, 0] += 0.1  # beside a free one; at a corner it would only be another rest
    with pytest.raises(ValueError, match=r'particle 1 is 0\.1 mm away from rest in a direction in which it is held'):
        propagate(atoms, [1.0])
    atoms = patch(5)
    atoms.set_constraint(FixCom())
    with pytest.raises(ValueError, match='FixCartesian, FixedLine and FixedPlane'):
        propagate(atoms, [1.0])
    atoms.set_constraint(FixAtoms(range(25)))
    with pytest.raises(ValueError, match='hold every particle'):
        propagate(atoms, [1.0])


@pytest.mark.parametrize('seed', range(4))
def test_a_guided_particle_starts_from_however_small_a_displacement_wherever_the_patch_lies(seed, monkeypatch):
    """Far from the origin positions round a displacement along an oblique line by more than a share of itself."""
    rng = np.random.default_rng(seed)
    patch = lattices.hexagon(lattices.triangular(10.0, 0.7), 25.0)
    i = rng.choice(np.flatnonzero(patch.get_tags() == 0))
    angle, places = rng.uniform(0.2, 1.3), rng.uniform(500, 5000, 2)
    line = np.array([np.cos(angle), np.sin(angle), 0])
    patch.set_constraint([*patch.constraints, FixedLine(i, line)])

    def motion(amplitude, offset):
        atoms = patch.copy()
        atoms.positions[:, :2] += offset
        atoms.calc = MagneticRepulsion(atoms, InversePower(b=3e3, a=4.6), foundation=0.2)
        atoms.positions[i] += amplitude * line
        return propagate(atoms, [1.0, 5.0]).displacements

    expected, amplitude = motion(1e-2, 0), 10 ** -rng.uniform(4, 7)
    # positions of some 1e3 mm keep 1e-13 of their displacements
    np.testing.assert_allclose(motion(amplitude, places), expected * amplitude / 1e-2, rtol=0, atol=4e-12)
    monkeypatch.setattr('magphonon.response.propagation.IN_PLACE', 0.0)  # the control
    with pytest.raises(ValueError, match='in which it is held'):
        motion(1e-7, places)
