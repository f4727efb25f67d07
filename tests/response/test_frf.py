"""Frequency response: the oscillator and small chains in closed form, lock-in, steady state, one impulse."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixedLine

from magphonon import lattices, units
from magphonon.dynamics.drives import Harmonic
from magphonon.dynamics.recorder import Recorder
from magphonon.dynamics.verlet import DrivenVerlet
from magphonon.interactions.pair_laws import InversePower
from magphonon.response.frf import FrequencyResponse, frequency_response, harmonic_response
from magphonon.response.stepped import fourier, impulse_response, lock_in, remaining_transient, steady_amplitudes
from magphonon.stiffness.calculator import MagneticRepulsion

# Sec. III of the paper: M = 1 kg, L0 = 1 m, f = gamma r^-4, gamma = 1e4 N m^4.  Stiffness of the free particle in N/m
D_YY = [20000.0, 45000.0, 70000.0, 120000.0]
MASS = 1 * units.kg
GAMMA = 2.0 / units.s  # damping ratio 0.3 to 0.7 %
OMEGA = 2 * np.pi * np.linspace(5, 80, 151) * units.Hz


def free_magnet(theta0, constraint=None, model='complete'):
    atoms = lattices.oscillator(theta0, spacing=1 * units.m, mass=MASS)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=1e4 * units.N * units.m**4, a=4), bonds=lattices.OSCILLATOR_BONDS,
                                   model=model).balanced([3])
    if constraint is not None:
        atoms.set_constraint([*atoms.constraints, constraint])
    return atoms


def one_degree(k, omega=OMEGA, m=MASS, gamma=GAMMA):
    """Receptance u/F = 1/(k - m w^2 + i m gamma w)."""
    return 1 / (k - m * omega**2 + 1j * m * gamma * omega)


@pytest.mark.parametrize('frames', [400, 437])
def test_lock_in_returns_a_steady_oscillation_exactly(frames):
    omega = np.array([0.05, 0.31, 1.7])
    U = np.array([2 - 1j, 1e-6j, -3.0])
    t = 17.3 + np.arange(frames)
    signal = 0.7 + (U * np.exp(1j * np.multiply.outer(t, omega))).real
    found = lock_in(signal, 1.0, omega, start=17.3)
    np.testing.assert_allclose(found, U, rtol=0, atol=1e-13 * 3)  # round-off of the largest
    np.testing.assert_allclose(lock_in(signal[:, 1], 1.0, 0.31, start=17.3), U[1], rtol=0, atol=1e-12)
    # the control: the bare mean of signal e^{-i w t} wants whole periods and no constant
    bare = 2 * (signal * np.exp(-1j * np.multiply.outer(t, omega))).mean(axis=0)
    assert abs(bare - U).max() > 1e-3


def test_lock_in_suppresses_other_frequencies():
    t = 0.5 * np.arange(1000)
    other = np.cos(0.62 * t + 1)
    # 49 and 24.7 periods in the window: 24 bins away a Hann window lets pass 1/(24^3 pi) = 2e-5, no window 1/24
    assert abs(lock_in(np.cos(0.31 * t) + other, 0.5, 0.31) - 1) < 5e-5


def from_rest(t, omega, omega_0, gamma=GAMMA, m=MASS):
    """Displacement under F cos(omega t), F = 1, from rest: the steady part and the transient that cancels it at t = 0."""
    U = one_degree(m * omega_0**2, omega, m, gamma)
    free = -gamma / 2 + 1j * np.sqrt(omega_0**2 - gamma**2 / 4)
    B = -U.real + 1j * (-U.real * free.real + (1j * omega * U).real) / free.imag
    return (U * np.exp(1j * np.multiply.outer(t, omega)) + B * np.exp(np.multiply.outer(t, 0 * omega + free))).real, U


def test_remaining_transient_bounds_the_error_of_the_whole_curve():
    omega_0 = np.sqrt(0.07)  # theta0 = pi/4
    dt, frames = 1.0, 640  # three periods of the slowest
    t = dt * np.arange(30 * frames)
    omega = np.append(OMEGA, np.sqrt(omega_0**2 - GAMMA**2 / 4))
    signal, U = from_rest(t, omega, omega_0)
    amplitudes = [lock_in(signal[k : k + frames], dt, omega, k * dt) for k in range(0, len(t), frames)]
    decay = np.exp(-GAMMA * frames * dt / 2)
    for windows in (4, 10, 20, 30):
        left = remaining_transient(amplitudes[:windows], decay)
        error = abs(1 - U / amplitudes[windows - 1])
        # far from resonance the window leaves some 1e-6 of two free parts, +w_0 and -w_0, which may cancel in both steps
        assert (error < 1.05 * left + 1e-5).all()
        assert left[-1] == pytest.approx(error[-1], rel=0.03)  # sharp at resonance
    assert remaining_transient(amplitudes[:8], decay).max() > 1e-3 > remaining_transient(amplitudes, decay).max()


def test_two_free_vibrations_that_cancel_in_one_step_do_not_hide():
    omega_0, dt, frames = np.sqrt(0.045), 1.0, 333
    omega = np.array([0.11820328892])  # found by a scan: the third step is three times too short
    signal, U = from_rest(np.arange(4.0 * frames), omega, omega_0)
    amplitudes = [lock_in(signal[k : k + frames], dt, omega, k * dt) for k in range(0, 4 * frames, frames)]
    decay = np.exp(-GAMMA * frames * dt / 2)
    error = abs(1 - U / amplitudes[-1])
    assert error < 1.1 * remaining_transient(amplitudes, decay)
    assert error > 2 * abs(1 - amplitudes[-2] / amplitudes[-1]) * decay / (1 - decay)


def driven_magnet(omega, damping=GAMMA):
    """The free magnet on its vertical line under a force of 10 mN cos(omega t), theta0 = pi/4, and its record."""
    atoms = free_magnet(np.pi / 4, FixedLine(3, (0, 1, 0)))
    drives = [Harmonic(3, (0, 1), 0.01, omega, phase=np.pi / 2)]
    dyn = DrivenVerlet(atoms, 0.5, drives, damping)
    return dyn, Recorder(dyn, [3], 4)


@pytest.mark.slow
@pytest.mark.parametrize('omega', [0.1, 0.264, 0.4])
def test_run_ends_when_the_motion_is_steady(omega):
    gamma = 5 * GAMMA
    found = {}
    for tolerance in (1e-2, 1e-6):
        dyn, recorder = driven_magnet(omega, gamma)
        found[tolerance], left = steady_amplitudes(dyn, recorder, [omega], axis=1, tolerance=tolerance)
        assert 0 < left < tolerance
        steps = dyn.nsteps
    assert abs(found[1e-2] / found[1e-6] - 1) < 1.05e-2  # bound of the transient; see above
    # velocity Verlet moves the resonance by w_0 (w_0 dt)^2/24, of its half width gamma/2: 4 % here in phase
    exact = one_degree(D_YY[2] * units.N / units.m, omega, gamma=gamma)
    assert abs(found[1e-6] / 0.01 / exact - 1) < np.sqrt(0.07) * 0.07 * 0.5**2 / 24 / (gamma / 2)
    assert driven_magnet(omega)[0].nsteps < steps < 30 / gamma / 0.5  # e^-15 = 3e-7


@pytest.mark.slow
def test_motion_at_another_frequency_is_never_steady():
    dyn, recorder = driven_magnet(0.2, 10 * GAMMA)
    with pytest.raises(ValueError, match=r'the motion is not steady.*drive only at omega'):
        steady_amplitudes(dyn, recorder, [0.203], axis=1)


def test_steady_motion_needs_damping():
    with pytest.raises(ValueError, match=r'the least damping must be a positive number in 1/ms, not 0.0'):
        steady_amplitudes(*driven_magnet(0.2, 0.0), [0.2], axis=1)


def free_decay(t, omega_0):
    """Displacement after the impulse 1 N ms."""
    ringing = np.sqrt(omega_0**2 - GAMMA**2 / 4)
    return np.exp(-GAMMA * t / 2) * np.sin(ringing * t) / (MASS * ringing)


@pytest.mark.parametrize('lives', [3, 6, 9])
def test_impulse_response_errs_by_what_is_left_at_its_end(lives):
    omega_0 = np.sqrt(D_YY[1] / 1e6)  # rad/ms
    t = np.arange(0, lives * 2 / GAMMA, 0.5)
    found = impulse_response(7 * free_decay(t, omega_0), 0.5, 7.0, OMEGA)
    error = abs(found.response / one_degree(MASS * omega_0**2) - 1)
    left = np.exp(-lives)
    # 2.2: the ratio of 1/|w - w_0| to 1/|w^2 - w_0^2| over the range; 1e-5: (w dt)^4/720 at its upper end
    assert error.max() < 2.2 * left * max(1, OMEGA.max() / omega_0) + 1e-5
    assert error.max() > 0.3 * left
    assert left < found.transient < 3 * left  # of the last tenth of the record


def test_impulse_response_is_of_fourth_order_in_the_step():
    omega_0, omega = 0.2, np.array([0.1, 0.35])
    errors, plain = [], []
    for dt in (2.0, 1.0):
        t = np.arange(0, 30000, dt)
        exact = one_degree(MASS * omega_0**2, omega)
        errors.append(abs(impulse_response(free_decay(t, omega_0), dt, 1.0, omega).response / exact - 1))
        plain.append(abs(fourier(free_decay(t, omega_0), dt, omega) / exact - 1))
    assert np.log2(errors[0] / errors[1]) == pytest.approx(4, abs=0.2)
    assert np.log2(plain[0] / plain[1]) == pytest.approx(2, abs=0.2)  # without the end correction
    assert (plain[1] > 30 * errors[1]).all()


def test_response_finds_its_peak():
    omega_0 = np.sqrt([0.02, 0.07])
    curves = FrequencyResponse(OMEGA, one_degree(MASS * omega_0**2, OMEGA[:, None]))
    assert (abs(curves.peak - omega_0) <= OMEGA[1] - OMEGA[0]).all()


@pytest.mark.parametrize('respond', [frequency_response, harmonic_response])
@pytest.mark.parametrize('direction', [(0, 0, 1), (1, 0, 1e-3)])
def test_a_force_out_of_the_plane_is_refused_and_not_answered_by_zero(respond, direction):
    patch = lattices.hexagon(lattices.triangular(10.0, 0.7), 30.0)
    patch.calc = MagneticRepulsion(patch, InversePower(3e3, 4.6), foundation=0.5)
    force = np.zeros((len(patch), 3))
    force[18] = direction
    with pytest.raises(ValueError, match='pushes along z, but the structure is planar'):
        respond(patch, force, [0.3], 0.1)
    force[18] = 1, 0, 0
    assert abs(respond(patch, force, [0.3], 0.1).response).max() > 1


@pytest.mark.parametrize('tool', [harmonic_response, frequency_response])
@pytest.mark.parametrize('seed', range(4))
def test_an_undamped_resonance_is_refused_and_its_neighbourhood_is_not(tool, seed):
    """Uncoupled oscillators, whose amplitudes F/m (w_k^2 - w^2 + i gamma w) are closed; the second one resonates."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 30))
    atoms = Atoms(['Nd'] * n, positions=10.0 * np.arange(n)[:, None] * (1, 0, 0), masses=rng.uniform(0.5, 2, n))
    k, m = rng.uniform(1, 9, n), atoms.get_masses()
    atoms.calc = MagneticRepulsion(atoms, InversePower(1e-30, 4.0), foundation=k).balanced(range(n))
    force, w = np.ones((n, 3)) * (1, 0, 0), np.sqrt(k[1] / m[1])
    with pytest.raises(ValueError, match='is infinite; damp it'):
        tool(atoms, force, [w], 0.0)
    for near, gamma in (1 + 1e-11, 0.0), (1 - 1e-11, 0.0), (1.0, 1e-12):
        square = w**2 * (1 - near) * (1 + near) + 1j * gamma * w * near
        assert abs(tool(atoms, force, [w * near], gamma).response[0, 1, 0] * m[1] * square - 1) < 0.05  # of 1e-16 (k/m)/1e-11
