"""Maps, ridges and misfits against waves whose dispersion is known in closed form."""

from dataclasses import replace

import numpy as np
import pytest

from magphonon.waves.spectrum import Ridge, _jumps, ridge, wavenumber_frequency
from magphonon.waves.wave_analysis import Branch, compare

# Sec. IV of the paper, gamma = 1e4 N m^4, a = 4, L0 = 1 m, M = 1 kg: omega = omega_M sin(xi/2) along Gamma-M, rad/ms
OMEGA_M = {('shear', 'complete'): 0.141421356237310, ('longitudinal', 'complete'): 0.469041575982343,
           ('shear', 'conventional'): 0.282842712474619, ('longitudinal', 'conventional'): 0.489897948556636}
CARRIER = {'shear': 0.120, 'longitudinal': 0.400}
OTHER = {'complete': 'conventional', 'conventional': 'complete'}


def driven_row(omega_m, carrier, points, duration, dt, zeta=0.005, rim=None):
    """Exact record of a chain of dispersion `omega_m sin(xi/2)`, its end n = 0 moved by a five-cycle Hann burst.

    At each frequency the chain answers with e^{-i xi n}, xi complex where damping or the band edge makes it so; held at
    n = rim, with the standing wave sin(xi (rim - n))/sin(xi rim).
    """
    frames = round(duration / dt)
    padded = 8 * frames  # the response has died before it could wrap around
    t = dt * np.arange(padded)
    burst = 5 * 2 * np.pi / carrier
    source = np.fft.rfft(np.where(t < burst, np.sin(carrier * t) * np.sin(np.pi * t / burst) ** 2, 0))
    w = 2 * np.pi * np.fft.rfftfreq(padded, dt)
    c = 1 - 2 * (w**2 - 2j * zeta * omega_m * w) / omega_m**2
    mu = c - np.sqrt(c**2 - 1)
    mu = np.where(abs(mu) > 1, 1 / mu, mu)[:, None]
    n = np.arange(points)
    if rim is None:
        answer = mu**n
    else:
        with np.errstate(invalid='ignore'):
            answer = (mu**n - mu ** (2 * rim - n)) / (1 - mu ** (2 * rim))
        answer[0] = 1 - n / rim
    return np.fft.irfft(source[:, None] * answer, padded, axis=0)[:frames]


def closed_branch(omega_m):
    xi = np.linspace(0, np.pi, 2001)
    return Branch(xi, omega_m * np.sin(xi / 2))


def travelling(direction):
    frames, points, xi, omega = 64, 32, 2 * np.pi * 5 / 32, 2 * np.pi * 9 / 64
    t, n = np.meshgrid(np.arange(frames), np.arange(points), indexing='ij')
    return xi, omega, 3e-4 * np.cos(omega * t - direction * xi * n)


@pytest.mark.parametrize('direction', [1, -1])
def test_a_wave_along_the_row_appears_at_positive_xi_with_its_amplitude_squared(direction):
    xi, omega, u = travelling(direction)
    s = wavenumber_frequency(u, dt=1.0)
    row, column = np.unravel_index(s.power.argmax(), s.power.shape)
    # xi and omega are grid points of the map; what the wave at -omega adds through the Hann window's tails is below 1e-4
    assert s.xi[column] == pytest.approx(direction * xi, rel=1e-12)
    assert s.omega[row] == s.loudest == pytest.approx(omega, rel=1e-12)
    assert s.power[row, column] == pytest.approx(9e-8, rel=2e-4)
    assert (s.bin_xi, s.bin_omega) == pytest.approx((2 * np.pi / 32, 2 * np.pi / 64))
    # the control: numpy's own sign puts the forward wave on the other side
    frame, point = divmod(abs(np.fft.fft2(u)[: 64 // 2]).argmax(), 32)
    assert frame == 9
    assert np.sign(np.fft.fftfreq(32)[point]) == -direction


@pytest.mark.parametrize(('motion', 'model'), OMEGA_M)
def test_ridge_of_each_model_lies_on_its_own_branch(motion, model):
    own, other = OMEGA_M[motion, model], OMEGA_M[motion, OTHER[model]]
    # long enough for the burst to cross 60 particles at least once
    u = driven_row(own, CARRIER[motion], points=60, duration={'shear': 1200, 'longitudinal': 400}[motion], dt=1.0)
    found = ridge(wavenumber_frequency(u, 1.0))
    near, far = compare(found, closed_branch(own)), compare(found, closed_branch(other))
    # the curvature of the branch within the width of the window is what remains: 0.02 bins, twenty times below the demand
    assert near.bins < 0.03
    assert near.points >= 8
    # 1.1 rad against bins of 0.1 rad for shear; the longitudinal branches lie 0.13 rad apart, small but resolved
    assert far.bins > {'shear': 5, 'longitudinal': 0.9}[motion]
    assert far.omega > 30 * near.omega


def test_the_plain_peak_over_xi_misses_the_branch_where_the_centre_of_gravity_does_not():
    u = driven_row(OMEGA_M['shear', 'complete'], CARRIER['shear'], points=60, duration=1200, dt=2.0)
    s = wavenumber_frequency(u, 2.0)
    found, truth = ridge(s), closed_branch(OMEGA_M['shear', 'complete'])
    lines = s.power[4::4]
    strong = lines.max(axis=1) > 1e-2 * lines.max()
    grid = s.xi[np.where(s.xi > 0, lines, 0).argmax(axis=1)][strong]  # the grid step is a quarter of a bin
    plain = compare(Ridge(grid, s.omega[4::4][strong], 0 * grid, 0 * grid, grid, s.bin_xi, s.bin_omega), truth)
    assert plain.bins > 0.4
    assert compare(found, truth).bins < plain.bins / 20


@pytest.mark.parametrize('points', [24, 60])
def test_reflections_from_a_rim_run_backwards_and_leave_the_ridge_on_its_branch(points):
    omega_m = OMEGA_M['shear', 'complete']
    u = driven_row(omega_m, 0.1, points, duration=3000, dt=2.0, rim=points + 2)
    s = wavenumber_frequency(u, 2.0)
    back = s.power[:, s.xi < 0].max() / s.power.max()
    assert back > 0.1  # the reflection is there
    # forward and backward wave are many bins apart; what is left is the damping's round trip and the curvature
    assert compare(ridge(s), closed_branch(omega_m)).bins < 0.1
    assert compare(ridge(s), closed_branch(2 * omega_m)).bins > 3


@pytest.mark.parametrize('times_the_wave', [0.3, 3, 300])
def test_offset_and_drift_of_each_point_leave_the_ridge_where_it_is(times_the_wave):
    u = driven_row(OMEGA_M['shear', 'complete'], CARRIER['shear'], points=60, duration=1200, dt=2.0)
    rng = np.random.default_rng(1)
    offset, drift = times_the_wave * abs(u).max() * rng.normal(size=(2, 60))
    clean, spoilt = (ridge(wavenumber_frequency(v, 2.0)) for v in (u, u + offset + drift * np.linspace(-1, 1, len(u))[:, None]))
    for name in ('xi', 'omega', 'sigma_xi'):  # nothing is left of them but round-off
        np.testing.assert_allclose(getattr(spoilt, name), getattr(clean, name), rtol=1e-6)
    # what bends is not taken off, but ends in the frequency lines that are passed over: half a wave a record
    bent = u + offset * np.sin(np.pi * np.linspace(0, 1, len(u)))[:, None]
    if times_the_wave < 1:
        np.testing.assert_allclose(ridge(wavenumber_frequency(bent, 2.0)).xi, clean.xi, atol=0.02 * 2 * np.pi / 60)


def points_at(xi, omega):
    xi, omega = np.array(xi), np.array(omega)
    return Ridge(xi, omega, 0.02 + 0 * xi, 0.01 + 0 * xi, 1 + 0 * xi, bin_xi=0.1, bin_omega=0.05)


def test_misfit_is_the_distance_along_each_axis():
    straight = Branch(np.linspace(0, 3, 31), 2 * np.linspace(0, 3, 31))
    m = compare(points_at([1.05, 1.95], [2, 4]), straight)  # 0.05 rad beside omega = 2 xi
    assert (m.omega, m.bins, m.points) == (pytest.approx(0.1), pytest.approx(0.5), 2)
    assert m.sigma_omega == pytest.approx(np.hypot(0.01, 2 * 0.02))
    assert not m.agrees  # 0.1 is more than 1.96 sigma, 0.081
    assert compare(points_at([1.03, 1.97], [2, 4]), straight).agrees  # 0.06 is less


def test_two_waves_a_bin_apart_do_not_agree_however_uncertain():
    straight = Branch(np.linspace(0, 3, 31), 2 * np.linspace(0, 3, 31))
    for aside, agrees in ((0.09, True), (0.11, False)):  # of a bin of 0.1
        ridge = replace(points_at([1 + aside, 2 - aside], [2, 4]), sigma_xi=np.ones(2))
        assert compare(ridge, straight).agrees == agrees


def test_misfit_takes_the_nearest_of_several_crossings():
    xi = np.linspace(0, np.pi, 4001)
    arch = Branch(xi, np.sin(xi))  # reaches 0.5 at pi/6 and at 5 pi/6
    assert compare(points_at([np.pi / 6, 5 * np.pi / 6], [0.5, 0.5]), arch).bins < 1e-4
    assert compare(points_at([np.pi / 6 + 0.2], [0.5]), arch).bins == pytest.approx(2, abs=1e-4)


def test_above_its_top_a_branch_is_met_at_the_band_edge():
    top = closed_branch(1.0)
    assert compare(points_at([np.pi], [1.1]), top).bins == pytest.approx(0, abs=1e-9)
    assert compare(points_at([np.pi - 0.3], [1.1]), top).bins == pytest.approx(3)


def test_a_reversed_row_and_plain_noise_have_no_ridge():
    u = driven_row(OMEGA_M['shear', 'complete'], CARRIER['shear'], points=60, duration=1200, dt=2.0)
    with pytest.raises(ValueError, match='reverse the row'):
        ridge(wavenumber_frequency(u[:, ::-1], 2.0))
    for seed in range(5):
        with pytest.raises(ValueError, match='no wave along the row'):
            ridge(wavenumber_frequency(np.random.default_rng(seed).normal(size=(600, 60)), 2.0))


def test_motion_that_stands_or_decays_has_no_ridge():
    t = np.arange(400.0)
    burst = np.sin(0.1 * t) * np.sin(np.pi * t / 400) ** 2
    with pytest.raises(ValueError, match='no wave along the row'):
        ridge(wavenumber_frequency(burst[:, None] * np.exp(-0.2 * np.arange(40)), 1.0))
    n, t = np.arange(40), t[:, None]  # damping lends a decaying wave some phase: a third of a bin of 0.157 rad
    with pytest.raises(ValueError, match='no wave along the row'):
        ridge(wavenumber_frequency(np.sin(0.1 * t - 0.05 * n) * np.exp(-0.8 * n), 1.0))
    np.testing.assert_allclose(ridge(wavenumber_frequency(np.sin(0.1 * t - 0.15 * n), 1.0)).xi, 0.15, atol=0.01)


def test_the_flank_of_a_backward_wave_at_the_edge_of_the_zone_is_no_crest():
    n, t = np.arange(40), np.arange(400.0)[:, None]
    with pytest.raises(ValueError, match='no wave along the row'):
        ridge(wavenumber_frequency(np.cos(0.5 * t + 3.1 * n), 1.0))
    np.testing.assert_allclose(ridge(wavenumber_frequency(np.cos(0.5 * t - 3.1 * n), 1.0)).xi, 3.1, atol=0.01)


def test_beside_a_stronger_wave_that_runs_backwards_a_weak_one_is_dropped():
    n, t = np.arange(64), np.arange(256.0)[:, None]
    for amplitude in (0.05, 0.2):  # -26 and -14 dB; the limit is -20
        u = np.cos(0.5 * t + 0.8 * n) + amplitude * np.cos(1.1 * t - 1.3 * n)
        s = wavenumber_frequency(u, 1.0)
        if amplitude < 0.1:
            with pytest.raises(ValueError, match='no wave along the row'):
                ridge(s)
        else:
            np.testing.assert_allclose(ridge(s).xi, 1.3, rtol=1e-3)


def test_jumps_are_the_variance_that_points_have_about_a_smooth_branch():
    """Every window of seven lines counts, the last one too; drawn jumps come back in the mean."""
    rng, lines = np.random.default_rng(5), np.arange(20, 33)
    omega = lines.astype(float)
    smooth = np.arccos(0.9 - 1.5e-3 * omega**2)  # cos xi is a parabola of omega^2
    still = np.zeros(len(lines))
    assert len(_jumps(smooth, omega, still, still, lines)) == len(lines) - 6
    np.testing.assert_allclose(_jumps(smooth, omega, still, still, lines), 0, atol=1e-20)
    for k, hit in ((0, [0]), (-1, [-1])):  # only the windows with that point see it: the first, the last
        moved = smooth.copy()
        moved[k] += 1e-3
        seen = np.flatnonzero(_jumps(moved, omega, still, still, lines) > 1e-9)
        np.testing.assert_array_equal(seen, np.arange(len(lines) - 6)[hit])
    drawn = [_jumps(smooth + 1e-3 * rng.normal(size=len(lines)), omega, still, still, lines).mean() for _ in range(2000)]
    assert np.mean(drawn) == pytest.approx(1e-6, rel=0.1)  # 2000 means of seven windows that overlap scatter by 2 %
    noise = np.full(len(lines), 1e-3)
    drawn = [_jumps(smooth + 1e-3 * rng.normal(size=len(lines)), omega, noise, still, lines).mean() for _ in range(2000)]
    assert abs(np.mean(drawn)) < 0.1e-6  # what noise makes of it is taken off
