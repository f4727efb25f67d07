"""Scans as instruments write them, drawn at random, whose branch is known: units, velocities, missing and dead points, jitter."""

import re
from pathlib import Path

import numpy as np
import pytest
from scans import packet, scene_text, triangular_branches
from scipy.interpolate import CubicSpline, make_interp_spline
from structures import few_first

from magphonon import read_scene
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.main import main
from magphonon.scenes import ready_scene
from magphonon.waves import Scan, compare, read_scan, ridge, scan_waves, wavenumber_frequency, wavevector
from magphonon.waves.rows import row_of
from magphonon.waves.scan_tables import read_places
from magphonon.waves.scans import DEGREES, RESAMPLED, Samples, assembled, integrated
from magphonon.waves.wave_analysis import Branch

NORMAL = 1.96
LENGTH = {'m': 1.0, 'mm': 1e3, 'um': 1e6, 'nm': 1e9}
TIME = {'s': 1.0, 'ms': 1e3, 'us': 1e6}


class Drawn:
    """A lattice like the prototype, a burst of one polarisation along one of its close-packed rows, and its scan in SI."""

    def __init__(self, seed, points=30, missing=0.15, noise=0.03, mode=None):
        rng = self.rng = np.random.default_rng(seed)
        self.L, self.m, self.a = rng.uniform(0.008, 0.014), rng.uniform(5e-4, 1e-3), rng.uniform(3, 5)
        self.f, self.k = rng.uniform(0.15, 0.4), rng.uniform(15, 30)
        self.angle, self.mode = rng.choice([0, 60, 120]), rng.integers(2) if mode is None else mode
        self.xi = np.linspace(0, np.pi, 3001)
        self.omega, self.wrong = (self.branch(tension) for tension in (self.f / self.L, 0.0))
        carrier = np.interp(rng.uniform(0.8, 2.2), self.xi, self.omega)
        self.t = np.arange(0, 0.8, 1 / 500)
        n = np.arange(points)
        self.n = np.sort(rng.permutation(n)[: round(points * (1 - missing))])
        self.motion = lambda t: 1e-6 * packet(t, self.n, self.xi, self.omega, carrier, 0.1 * carrier, 0.15)
        self.u = self.motion(self.t) + 1e-6 * noise * rng.normal(size=(len(self.t), len(self.n)))
        row = np.array([np.cos(np.radians(self.angle)), np.sin(np.radians(self.angle))])
        self.places = self.L * self.n[:, None] * row * rng.choice([-1, 1]) + rng.uniform(-1, 1, 2)
        self.across = np.array([-row[1], row[0]]) if self.mode == 0 else row
        self.places += 0.02 * self.L * rng.normal(size=self.places.shape)  # as well as a camera tells them

    def branch(self, tension):
        return triangular_branches(self.xi, self.angle, self.L, self.m, tension, self.a * self.f / self.L, self.k)[:, self.mode]

    def cell(self, folder):
        (folder / 'my.toml').write_text(scene_text(self.L, self.m, self.f * self.L**self.a, self.a, self.k))
        return read_scene(folder / 'my.toml').atoms()

    def rows(self, values, names, time='s', length='m', place='m'):
        """Lines of a table, shuffled; `values` is a dict of column to (frames, points)."""
        lines = [','.join([f'{t * TIME[time]:.9g}', names[p], *(f'{x * LENGTH[place]:.9g}' for x in self.places[p]),
                           *(f'{v[k, p]:.9g}' for v in values.values())])
                 for k, t in enumerate(self.t) for p in range(len(self.n))]
        header = f'time_{time},point,x_{place},y_{place},{",".join(values)}'
        return '\n'.join([header, *self.rng.permutation(lines)]) + '\n'

    def held(self, wave):
        """Share of points within 1.96 of their uncertainties of the true branch and of the conventional one."""
        r = wave.ridge
        return [np.mean(abs(r.omega - np.interp(r.xi, self.xi, om / 1e3))
                        < NORMAL * np.hypot(r.sigma_omega, np.interp(r.xi, self.xi, np.gradient(om, self.xi)) / 1e3 * r.sigma_xi))
                for om in (self.omega, self.wrong)]


def scanned(drawn, folder, text):
    (folder / 'scan.csv').write_text(text)
    scan = read_scan(folder / 'scan.csv')
    return scan, scan_waves(scan, drawn.cell(folder))


def without_gaps(d):
    """The ridge of the same motion, had the points been neighbours."""
    return ridge(wavenumber_frequency(1e3 * d.u, 1e3 * (d.t[1] - d.t[0])))


@pytest.mark.parametrize('seed', range(4))
def test_a_drawn_scan_has_its_ridge_on_the_true_branch(seed, tmp_path):
    """Two components, own names, units of the header, 15 % of the points missing, one dead, samples shuffled."""
    d = Drawn(seed)
    unit, time, place = d.rng.choice(list(LENGTH)), d.rng.choice(list(TIME)), d.rng.choice(['m', 'mm', 'um'])
    dead = d.rng.integers(len(d.n))
    u = d.u * (np.arange(len(d.n)) != dead) * LENGTH[unit]
    scan, (wave, *_) = scanned(d, tmp_path, d.rows({f'u_x_{unit}': d.across[0] * u, f'u_y_{unit}': d.across[1] * u},
                                                   [f'P{k:03d}' for k in d.rng.permutation(len(d.n))], time, unit, place))
    assert len(scan.names) == len(d.n) - 1
    assert 'do not move (dead): P' in scan.notes[0]
    assert wave.motion == ('transverse', 'longitudinal')[d.mode]
    right, wrong = d.held(wave)
    assert len(wave.ridge.xi) >= 5
    assert right >= 0.9
    if d.mode == 0:  # longitudinal branches of the two models are closer than the row resolves
        assert wrong < 0.2  # the control
    own = Branch(d.xi, d.omega / 1e3)
    assert compare(wave.ridge, own).bins < 0.2
    assert compare(without_gaps(d), own).bins > 0.5  # the control: gaps that nobody told of
    # the branch of the package is that of the closed form
    mine = wave.branches['complete', ('shear', 'longitudinal')[d.mode]]
    np.testing.assert_allclose(np.interp(d.xi, mine.xi, mine.omega), own.omega, rtol=1e-5)


def test_the_ridge_of_velocities_is_that_of_displacements(tmp_path):
    d = Drawn(7, points=16, noise=0)
    names = [str(k) for k in range(len(d.n))]
    fine = (d.motion(d.t + 1e-6) - d.motion(d.t - 1e-6)) / 2e-6
    _, (u_wave,) = scanned(d, tmp_path, d.rows({'u_m': d.u}, names))
    scan, (v_wave,) = scanned(d, tmp_path, d.rows({'v_mm_per_s': 1e3 * fine}, names))
    assert any('velocities were integrated' in note for note in scan.notes)
    np.testing.assert_allclose(v_wave.ridge.xi, u_wave.ridge.xi, rtol=1e-5)
    np.testing.assert_allclose(v_wave.ridge.power, u_wave.ridge.power, rtol=1e-5)  # in mm^2, as it was displaced
    _, (mapped,) = scanned(d, tmp_path, d.rows({'u_mm': 1e3 * fine}, names))  # the control: velocities under the other header
    assert mapped.spectrum.peak > 1e3 * u_wave.spectrum.peak


def test_integration_undoes_the_derivative_at_any_start_and_leaves_a_mean_velocity_out(tmp_path):
    t = np.linspace(0, 1, 200, endpoint=False)[:, None]
    phase = 2 * np.pi * 7 * t
    np.testing.assert_allclose(integrated(3 + np.cos(phase), 1 / 200), np.sin(phase) / (2 * np.pi * 7), atol=1e-15)
    rows = [f'{5 + s:.6g},{p},{np.cos(x):.12g}' for (s,), (x,) in zip(t, phase, strict=True) for p in range(8)]
    (tmp_path / 'scan.csv').write_text('time_s,point,v_y_mm_per_s\n' + '\n'.join(rows))
    found = read_scan(tmp_path / 'scan.csv').motions['y']  # in mm
    np.testing.assert_allclose(found, np.tile(np.sin(phase) / (2 * np.pi * 7), 8), atol=1e-6)


@pytest.mark.parametrize(('jitter', 'resampled'), [(0.004, False), (0.2, True)])  # of a step; a distance of 0.01 counts as equal
def test_uneven_times_are_resampled(jitter, resampled, tmp_path):
    d = Drawn(9, points=16, missing=0, noise=0, mode=0)
    names, even = [str(k) for k in range(len(d.n))], d.t
    _, (wave,) = scanned(d, tmp_path, d.rows({'u_m': d.u}, names))
    d.t = even + jitter / 500 * d.rng.uniform(-1, 1, len(even))
    u = d.motion(d.t)
    scan, (again,) = scanned(d, tmp_path, d.rows({'u_m': u}, names))
    assert any('resampled' in note for note in scan.notes) == resampled
    np.testing.assert_allclose(np.interp(again.ridge.omega, wave.ridge.omega, wave.ridge.xi), again.ridge.xi, atol=0.02)


def gappy(folder, gap, noise=0.0):
    """A record of 40 Hz at steps of 1 ms, a twentieth of a step off equal times, with a gap: its scan, and how far it is off."""
    t = np.arange(0, 1, 1 / 1000) + 5e-5 * (-1) ** np.arange(1000)
    kept, rng = np.r_[t[:500], t[500 + gap - 1:]], np.random.default_rng(gap)

    def motion(s):
        return np.sin(2 * np.pi * 40 * s - 1.1 * np.arange(12)) * np.sin(np.pi * s) ** 2

    u = motion(kept[:, None]) + noise * rng.normal(size=(len(kept), 12))
    rows = [f'{s:.9g},{10 * n},{u[k, n]:.9g}' for k, s in enumerate(kept) for n in range(12)]
    (folder / 'scan.csv').write_text('\n'.join(['time_s,x_mm,u_um', *rows]))
    scan = read_scan(folder / 'scan.csv')
    return scan, 1e3 * scan.motions[''] - motion(scan.times[:, None] / 1000)


@pytest.mark.parametrize('gap', few_first([2, 5, 8, 11], 2))
@pytest.mark.parametrize('noise', [0.0, 0.01, 0.1])
def test_a_short_gap_in_time_is_filled_within_the_error_that_is_told(gap, noise, tmp_path):
    try:
        scan, off = gappy(tmp_path, gap, noise)
    except ValueError as error:  # noise in a long gap: what is off by more than told is not filled
        assert noise
        assert gap > 5
        assert 'gaps of' in str(error)  # noqa: PT017
        return
    told = float(re.search(r'error of up to ([\d.e-]+) %', scan.notes[-1])[1]) / 100
    assert told <= max(RESAMPLED, 3.3 * noise)
    inside = abs(off[500:500 + gap])
    assert np.sqrt(np.mean(inside**2)) <= 1.5 * told  # of 12 points, each of one error within a gap: scattered by a fifth
    assert inside.max() > told / 100  # and it is no empty promise


def test_a_long_gap_in_time_is_refused(tmp_path):
    """Beyond the gap that is filled: there a spline of any degree is off by more than a hundredth."""
    with pytest.raises(ValueError, match=r'too far apart for motion at 42.* Hz: all points have gaps of 0\.016'):
        gappy(tmp_path, 16)
    t = np.arange(-100, 100.0)
    kept = (t < 0) | (t > 14)
    wave = np.sin(2 * np.pi * 0.042 * t)
    for degree in DEGREES:
        assert abs(make_interp_spline(t[kept], wave[kept], degree)(t) - wave).max() > RESAMPLED


@pytest.mark.parametrize(('step_ms', 'noise'), [(4.0, 0.0), (4.0, 0.03), (2.0, 0.1)])
def test_scattered_missing_samples_are_filled_in(step_ms, noise, tmp_path):
    """A fiftieth of the samples of a burst with 7 to 18 to a period, and most of one point; the truth is the motion itself."""
    rng, n = np.random.default_rng(13), np.arange(20)
    t = np.arange(0, 800, step_ms)[:, None]
    truth = np.sin(0.2 * t - 0.9 * n) * np.exp(-(((t - 300 - 8 * n) / 80) ** 2))
    u = truth + noise * rng.normal(size=truth.shape)
    gone = rng.random(u.shape) < 0.02
    gone[:, 5] = rng.random(len(t)) < 0.6
    gone[[0, -1]] = False
    rows = [f'{t[i, 0]},{10 * k},{u[i, k]:.9g}' for i in range(len(t)) for k in n if not gone[i, k]]
    (tmp_path / 'scan.csv').write_text('\n'.join(['time_ms,x_mm,u_um', *rows]))
    scan = read_scan(tmp_path / 'scan.csv')
    assert re.search(r'points left out because too many of their samples are missing: \(50 mm, 0 mm\)', scan.notes[0])
    assert re.search(r'\d+ missing samples of \d+ points are interpolated, .* error of up to [\d.]+ %', scan.notes[1])
    kept, lacking = np.delete(truth, 5, axis=1), np.delete(gone, 5, axis=1)
    off = 1e3 * scan.motions[''] - kept
    stated = float(re.search(r'up to ([\d.]+) %', scan.notes[1])[1]) / 100
    assert np.sqrt(np.mean(off[lacking] ** 2)) < stated  # of a motion of size one
    assert stated <= max(0.01, 3.3 * noise)  # the noise is known to a tenth
    spline = [CubicSpline(t[~g, 0], v[~g])(t[g, 0]) - x[g] for g, v, x in zip(gone.T, u.T, truth.T, strict=True)]
    if not noise:  # the control: a cubic spline, which is worse than what is asked for
        assert np.sqrt(np.mean(np.concatenate(spline[:5]) ** 2)) > 10 * np.sqrt(np.mean(off[lacking] ** 2))


@pytest.mark.parametrize(('u', 'fine'), [('1e300', False), ('1e-300', False), ('2e3', False), ('0', True), ('1e-12', True)])
def test_motions_that_no_lattice_makes(u, fine, tmp_path):
    """Their squares, the power on a map, are infinite or zero."""
    (tmp_path / 'scan.csv').write_text('time_s,particle,u_x_m\n' + ''.join(f'{0.001 * k},7,{u}\n' for k in range(4)))
    if fine:
        assert read_scan(tmp_path / 'scan.csv').motions['x'].shape == (4, 1)
        return
    with pytest.raises(ValueError, match='impossible in a lattice; check the unit in the header and the exponents'):
        read_scan(tmp_path / 'scan.csv')


def test_a_component_that_does_not_move_at_all_may_lack_samples(tmp_path):
    rng, n, t = np.random.default_rng(1), np.arange(8), np.arange(300.0)[:, None]
    truth = np.sin(0.3 * t - 0.9 * n) * np.exp(-(((t - 120 - 8 * n) / 40) ** 2))
    there = rng.random(truth.shape) > 0.02
    there[[0, -1]] = True
    rows = [f'{t[i, 0]},{10 * k},0,{truth[i, k]:.9g}' for i, k in zip(*np.nonzero(there), strict=True)]
    (tmp_path / 'scan.csv').write_text('\n'.join(['time_ms,x_mm,u_x_um,u_y_um', *rows]))
    still, moving = (1e3 * read_scan(tmp_path / 'scan.csv').motions[part] for part in 'xy')
    assert (still == 0).all()
    assert abs(moving - truth).max() < 1e-3


def line(lattice, steps, **changes):
    """Places along R1 in mm at these steps of a lattice, and what is wrong with them."""
    places = np.stack([lattice * np.array(steps), 0 * np.array(steps)], axis=1).astype(float)
    for k, change in changes.get('moved', {}).items():
        places[k] += change
    return places @ changes.get('turn', np.eye(2))


def turned(degrees):
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return np.array([[c, s], [-s, c]])


@pytest.mark.parametrize(('places', 'message'), [
    (line(10, range(12), moved={4: [0, 3.5]}), r'point 5 at \(40 mm, 3.5 mm\) is 3.* mm off the line through all'),
    (np.concatenate([line(10, range(12)), np.add(line(10, range(12)), [5, 8.66])]),
     'lie on 2 rows, about 8.6 mm apart; keep the points of one'),
    (line(10, range(12), turn=turned(11)), 'runs at 11 degrees from the x axis, and no row of the lattice does; the nearest'),
    (line(10, range(12), moved={4: [3, 0]}), 'the point 4. mm along the measured row is .* mm off a whole number of steps'),
    (line(10.5, range(12)), 'a step of the measured row is 10.5 mm, and of the lattice 10 mm; check the unit'),
    (line(1e4, range(12)), '1e[+]04 mm apart, .* is 10 mm; are the positions in mm, under a header in m?'),
    (line(0.01, range(12)), '0.01 mm apart, .* is 10 mm; are the positions in m, under a header in mm?'),
    (line(10, [0, 1, 2, 2, 3, 4, 5, 6, 7, 8]), '0 mm apart'),
    (line(10, range(0, 24, 2)), r'waves look the same when their wavenumbers differ by 3.14 rad per step \(aliasing'),
    (line(10, range(7)), 'at least 8 of each'),
])
def test_points_that_are_no_row_of_the_lattice_are_refused(places, message, prototype):
    t = np.arange(0, 400, 2.0)
    u = np.sin(0.25 * t[:, None] - 0.9 * np.arange(len(places)))
    with pytest.raises(ValueError, match=message):
        scan_waves(Scan(t, tuple(map(str, range(len(places)))), places, {'y': u}), prototype)


@pytest.fixture(scope='module')
def prototype():
    return read_scene(ready_scene('prototype')).atoms()


@pytest.mark.parametrize('degrees', [0, 1.9, 60, 121.9, 30])  # 30: the rows of steps of sqrt(3) spacings
def test_rows_of_the_lattice_are_found_in_any_order_from_any_origin(degrees, prototype):
    rng, n = np.random.default_rng(3), np.array([0, 1, 2, 4, 5, 8, 9, 10])
    step = 10 * (3**0.5 if degrees == 30 else 1)
    order = rng.permutation(len(n))
    row = row_of((1.02 * line(step, n, turn=turned(degrees)) + [40, -7])[order], prototype)
    np.testing.assert_array_equal(row.steps, n)
    np.testing.assert_array_equal(order[row.order], range(len(n)))
    assert np.linalg.norm(row.vector) == pytest.approx(step)
    back = row.reversed
    np.testing.assert_array_equal(back.steps, 10 - n[::-1])
    # along R2 the wavevectors are those of the rows of bursts
    if degrees == 60:
        for source in ('row', 'point'):
            np.testing.assert_allclose(row.wavevector(prototype, source), wavevector(prototype, source), atol=1e-12)
    if degrees == 0:
        with pytest.raises(ValueError, match='runs along R1, as do the fronts'):
            row.wavevector(prototype, 'row')


def test_places_may_stand_in_a_table_of_their_own(tmp_path, prototype):
    (tmp_path / 'points.csv').write_text('# by camera\npoint;x_mm;y_mm\n' + ''.join(f'A{k};{10 * k};3\n' for k in range(12)))
    places = read_places(tmp_path / 'points.csv')
    assert places['A2'] == (20, 3)
    t = np.arange(0, 400, 2.0)
    u = np.sin(0.25 * t[:, None] - 0.9 * np.arange(12)[::-1]) * np.sin(np.pi * t[:, None] / 400) ** 2  # from the other end
    scan = Scan(t, tuple(f'A{k}' for k in range(12)), None, {'y': u})
    with pytest.raises(ValueError, match='does not say where its points are'):
        scan_waves(scan, prototype)
    wave = scan_waves(scan.placed(places), prototype)[0]
    np.testing.assert_allclose(wave.ridge.xi, 0.9, atol=0.02)
    assert scan.placed({name: places[name] for name in list(places)[:9]}).names == scan.names[:9]
    (tmp_path / 'points.csv').write_text('point,x_mm\nA,1\nA,2\n')
    with pytest.raises(ValueError, match='point A has two different places'):
        read_places(tmp_path / 'points.csv')


def test_backward_waves_are_picked_where_the_row_may_be_turned_round(tmp_path):
    """Shear in the square lattice on springs falls with the wavenumber: energy from the source, phases towards it."""
    cell = read_scene(ready_scene('square')).atoms()
    step, n, t = np.linalg.norm(cell.cell[0]), np.arange(30), np.arange(0, 900, 2.0)
    xi = np.linspace(0, np.pi, 500)
    omega = bloch_modes(cell, np.outer(xi / (2 * np.pi), [1, 0, 0]))[0][:, 0]
    assert (np.diff(omega) < 0).all()
    carrier = omega[220]
    u = 1e-3 * packet(t, -n, xi[::-1], omega[::-1], carrier, 0.03 * carrier, 300)
    places = np.stack([step * n, 0 * n], axis=1)
    scan = Scan(t, tuple(map(str, n)), places, {'y': u})
    (wave,) = scan_waves(scan, cell, 'point')
    assert ('complete', 'shear') in wave.agrees_with
    assert compare(wave.ridge, Branch(xi, omega)).bins < 0.2
    (known,) = scan_waves(scan, cell, 'point', row_of(places, cell))  # a row that begins at the source, as in burst
    assert known.ridge is None


def test_motion_out_of_the_plane_alone_is_refused(prototype):
    t = np.arange(0, 400, 2.0)
    with pytest.raises(ValueError, match='motion along z alone'):
        scan_waves(Scan(t, tuple('abcdefgh'), line(10, range(8)), {'z': np.sin(t[:, None] - np.arange(8))}), prototype)


def test_the_command_needs_nothing_but_lattice_and_law(tmp_path, capsys):
    """A scene without [patch] and [burst]; places in a table of their own; one component; velocities; the waves run backwards."""
    d = Drawn(3, points=20, mode=0)
    d.cell(tmp_path)
    names = [f'P{k}' for k in range(len(d.n))]
    step = 1e-6
    v = (d.motion(d.t + step) - d.motion(d.t - step)) / (2 * step)
    rows = [f'{t:.6g},{name},{value:.9g}' for t, row in zip(d.t, v, strict=True) for name, value in zip(names, row, strict=True)]
    (tmp_path / 'scan.csv').write_text('\n'.join(['time_s,node,v_m_per_s', *rows]) + '\n')
    (tmp_path / 'points.csv').write_text('\n'.join(['point,x_m,y_m', *(f'{name},{x!r},{y!r}' for name, (x, y) in zip(
        names, d.places.tolist(), strict=True))]) + '\n')
    words = ['spectrum', '--verbose', str(tmp_path / 'scan.csv'), str(tmp_path / 'my.toml'), '-o', str(tmp_path / 'out')]
    assert main(words) == 2
    assert 'the scan does not say where its points are; add the columns x_m and y_m' in capsys.readouterr().err
    assert main([*words, '--geometry', str(tmp_path / 'points.csv')]) == 0
    shown = capsys.readouterr().out
    assert 'scan.csv: 17 points on 20 places of the row, 400 frames\nvelocities were integrated over time' in shown
    assert 'scan, measured motion: agrees with the complete shear branch (0.0' in shown
    assert (tmp_path / 'out' / 'spectrum_scan_measured.png').exists()


@pytest.mark.slow
def test_several_scans_are_analysed_in_one_call_as_each_alone(tmp_path, capsys):
    names = []
    for seed, folder in ((3, '.'), (4, '.'), (3, 'other')):
        d = Drawn(3, points=20, mode=0)  # one lattice, and
        d.cell(tmp_path)
        d.rng = np.random.default_rng(seed)  # another noise
        (tmp_path / folder).mkdir(exist_ok=True)
        names.append(str(tmp_path / folder / f'scan{seed}.csv'))
        noisy = d.u + 1e-8 * d.rng.normal(size=d.u.shape)
        Path(names[-1]).write_text(d.rows({'u_m': noisy}, [str(k) for k in range(len(d.n))]))
    scene = str(tmp_path / 'my.toml')
    assert main(['spectrum', '--verbose', *names, scene, '-o', str(tmp_path / 'no')]) == 2
    assert 'two of the scans are called scan3' in capsys.readouterr().err
    assert not (tmp_path / 'no').exists()
    assert main(['spectrum', '--verbose', *names[:2], scene, '-o', str(tmp_path / 'out')]) == 0
    tables = [str(tmp_path / 'out' / f'spectrum_scan{seed}_ridges.csv') for seed in (3, 4)]
    assert f'"magphonon fit {" ".join(tables)} --bands {scene}" fits' in capsys.readouterr().out
    assert main(['spectrum', '--verbose', names[1], scene, '-o', str(tmp_path / 'one')]) == 0
    assert (tmp_path / 'one' / Path(tables[1]).name).read_text() == Path(tables[1]).read_text()


@pytest.mark.parametrize('seed', range(6))
def test_clipped_signals_are_named(seed):
    """Held at 0.6 of the top, in steps of one hundredth too; the same waves, whole, are not."""
    rng, t = np.random.default_rng(seed), np.arange(600)
    phase = 2 * np.pi * rng.uniform(0.04, 0.08, 3) * t[:, None] + rng.uniform(0, 6, 3)
    waves = np.sin(phase) * np.exp(-(((t - 300) / 150.0) ** 2))[:, None]
    for whole in (waves + 0.01 * rng.standard_normal(waves.shape), np.round(waves, 2)):
        clipped = np.where(np.arange(3) == 1, np.clip(whole, -0.6, 0.6), whole)
        for values, wanted in ((whole, []), (clipped, ['points 1 stay'])):
            points = {str(k): Samples(1.0 * t, {'y': values[:, k]}) for k in range(3)}
            told = [note for note in assembled('f.csv', points, False).notes if 'clipped' in note]
            assert len(told) == len(wanted)
            assert all(words in told[0] for words in wanted)


@pytest.mark.parametrize('mains', [0, 50, 60])
@pytest.mark.parametrize('kind', ['burst', 'noise'])
def test_hum_is_named(mains, kind):
    """A line in each point; bursts of 50 Hz, and noise with a mode there, are none."""
    rng, t = np.random.default_rng(mains + len(kind)), np.arange(1200.0)
    points = {}
    for k in range(12):
        if kind == 'burst':
            u = np.where(t > 60 + 5 * k, np.exp(-(t - 60 - 5 * k) / 80) * np.sin(0.1 * np.pi * (t - 5 * k)), 0.0)
        else:
            line = np.exp(-0.006 * t) * np.sin(2e-3 * np.pi * (35 if mains else 50) * t)
            u = np.convolve(rng.normal(size=2400), line)[1200:2400]
        u = u / u.std() + 0.02 * rng.normal(size=1200)
        if mains:
            u = u + (0.15 if kind == 'burst' else 1.0) * np.sin(2e-3 * np.pi * mains * t + rng.uniform(0, 6))
        points[f'{k}'] = Samples(t, {'x': u}, (10.0 * k, 0.0))
    told = [note for note in assembled('f.csv', points, False).notes if note.startswith('hum')]
    assert [f'a steady line at {mains} Hz' in note for note in told] == [True] * bool(mains)
