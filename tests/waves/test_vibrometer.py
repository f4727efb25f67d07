"""Tables of displacements, and simulated records as a vibrometer sees them."""

import contextlib

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from waves.test_spectrum import CARRIER, OMEGA_M, closed_branch, driven_row

from magphonon.waves.spectrum import ridge, wavenumber_frequency
from magphonon.waves.vibrometer import Displacements, measure, read_displacements, write_displacements
from magphonon.waves.wave_analysis import compare

HEADER = 'time_s,particle,u_x_m,u_y_m'


def table(frames=6, particles=(3, 1, 7)):
    rng = np.random.default_rng(1)
    return Displacements(2.0 + 0.37 * np.arange(frames), np.array(particles), rng.normal(size=(frames, len(particles), 2)))


@pytest.fixture
def lines(tmp_path):
    """A sound table as lines, header first."""
    write_displacements(tmp_path / 'sound.csv', table())
    return (tmp_path / 'sound.csv').read_text().splitlines()


def read(tmp_path, lines, **options):
    (tmp_path / 'table.csv').write_text('\n'.join(lines) + '\n')
    return read_displacements(tmp_path / 'table.csv', **options)


def test_table_is_si_and_comes_back_to_round_off(tmp_path, lines):
    d = table()
    assert lines[0] == HEADER
    first = [float(value) for value in lines[1].split(',')]
    assert first == pytest.approx([2e-3, 3, *(d.displacements[0, 0] * 1e-3)], rel=1e-15)  # ms, mm
    again = read(tmp_path, lines, particles=(3, 1, 7))
    np.testing.assert_allclose(again.times, d.times, rtol=1e-14)
    np.testing.assert_allclose(again.displacements, d.displacements, rtol=1e-15)
    assert again.dt == pytest.approx(0.37, rel=1e-13)


def test_rows_may_come_in_any_order_with_comments_and_further_columns(tmp_path, lines):
    shuffled = [lines[0], *np.random.default_rng(2).permutation(lines[1:])]
    dressed = [
        '\ufeff# a scan of 21 June',
        ' u_y_m , temperature_K,particle,time_s,u_x_m', '',
        *(f'{y},295, {p} ,{t},{x}' for t, p, x, y in (line.split(',') for line in shuffled[1:])),
    ]
    for rows in (shuffled, dressed):
        again = read(tmp_path, rows)
        np.testing.assert_array_equal(again.particles, [1, 3, 7])
        np.testing.assert_allclose(again.displacements, table().displacements[:, [1, 0, 2]], rtol=1e-15)


def test_only_the_particles_of_the_row_are_read(tmp_path, lines):
    gap = [line for line in lines if not line.startswith('0.002,1,')]  # in a particle that nobody asks for
    again = read(tmp_path, gap, particles=(7, 3))
    np.testing.assert_allclose(again.displacements, table().displacements[:, [2, 0]], rtol=1e-15)


def test_times_rounded_by_the_instrument_are_equal_steps(tmp_path):
    write_displacements(tmp_path / 'a.csv', table(frames=500))
    lines = (tmp_path / 'a.csv').read_text().splitlines()
    rounded = [lines[0], *(f'{float(line.split(",")[0]):.6f}{line[line.index(","):]}' for line in lines[1:])]
    # to 1 us: 0.5/370 of a step
    assert read(tmp_path, rounded).dt == pytest.approx(0.37, rel=1e-5)


def jittered(lines):
    t, rest = lines[8].split(',', 1)
    return [*lines[:8], f'{float(t) + 1e-5},{rest}', *lines[9:]]


@pytest.mark.parametrize(('spoil', 'message'), [
    (lambda a: [], 'table.csv is empty; its first line must name time_s, particle'),
    (lambda a: a[:1], 'no samples below its header'),
    (lambda a: [a[0].replace('u_y_m', 'u_y_mm'), *a[1:]], r"lacks the column u_y_m \(its header is '.*,u_x_m,u_y_mm'\)"),
    (lambda a: [line.replace(',', ';') for line in a], 'separated by commas'),
    (lambda a: [*a[:-1], a[-1][:12]], 'line 19 of .* has [123] values, not 4; it was cut off'),
    (lambda a: [*a, '0.1,3,1,2,'], 'line 20 of .* has 5 values, not 4'),
    (lambda a: [*a[:4], '0.1,abc,1,2', *a[4:]], "line 5 of .*: particle is 'abc', not a whole number"),
    (lambda a: [*a[:4], '0.1,1.5,1,2', *a[4:]], "line 5 of .*: particle is '1.5', not a whole number"),
    (lambda a: [*a[:4], '0.1,1e300,1,2', *a[4:]], "particle is '1e300', not a whole number"),
    (lambda a: [*a[:4], '0.1,1,,2', *a[4:]], "line 5 of .*: u_x_m is '', not a finite number"),
    (lambda a: [*a[:4], '0.1,1,1,nan', *a[4:]], "line 5 of .*: u_y_m is 'nan', not a finite number"),
    (lambda a: [*a, a[7]], 'lists particle 3 at 0.00274 s twice'),
    (lambda a: a[:-1], r'lacks the sample of particle 7 near 0.00385 s \(1 of 6 missing\)'),
    (lambda a: [line for line in a if line != a[1]], r'lacks the sample of particle 3 near 0.002 s'),
    (lambda a: [line for line in a if not line.startswith('0.00274')], 'lacks samples between 0.00237 and 0.00311 s'),
    (jittered, 'samples particle 1 at 0.00275 s, 0.027 of a step of 0.00037 s off equal times'),
    (lambda a: a[:4], 'single sample of particle'),
])
def test_a_table_that_is_not_whole_is_refused_with_the_place(tmp_path, lines, spoil, message):
    with pytest.raises(ValueError, match=message):
        read(tmp_path, spoil(lines))


def test_unknown_particles_and_other_files_are_refused(tmp_path, lines):
    with pytest.raises(ValueError, match='holds no particle 4; it holds 1, 3, 7'):
        read(tmp_path, lines, particles=(1, 4))
    with pytest.raises(ValueError, match='names no particle'):
        read(tmp_path, lines, particles=())
    (tmp_path / 'picture.csv').write_bytes(bytes(range(256)))
    with pytest.raises(ValueError, match='is not a text file; export it as CSV'):
        read_displacements(tmp_path / 'picture.csv')
    with pytest.raises(FileNotFoundError):
        read_displacements(tmp_path / 'missing.csv')


@settings(max_examples=200, deadline=None)
@given(st.lists(st.text(alphabet='0123456789.,-+einfNaN"# \t;x', max_size=30), max_size=12))
def test_whatever_stands_below_the_header_is_read_or_refused_in_words(tmp_path_factory, rows):
    path = tmp_path_factory.getbasetemp() / 'fuzz.csv'
    path.write_text('\n'.join([HEADER, *rows]))
    with contextlib.suppress(ValueError):
        assert np.isfinite(read_displacements(path).displacements).all()


def test_component_along_a_direction():
    d = table()
    np.testing.assert_allclose(d.along((3, 4)), 0.6 * d.displacements[..., 0] + 0.8 * d.displacements[..., 1])
    for direction, message in (((0, 0), 'must not be zero'), ((1, 0, 0), r'shape \(2,\)')):
        with pytest.raises(ValueError, match=message):
            d.along(direction)


def test_vibrometer_samples_at_its_own_rate():
    t = 5 + 0.1 * np.arange(400)
    motion = lambda t: np.stack([np.sin(2 * t), np.cos(3 * t)], axis=-1)[:, None]  # noqa: E731, a formula
    d = measure(t, motion(t), [4], rate=2.3)
    np.testing.assert_allclose(np.diff(d.times), 1 / 2.3)
    assert d.times[0] == 5
    assert t[-1] - d.times[-1] < 1 / 2.3
    # a cubic spline with 21 points to a period: (w h)^4/384 within, a few times that at its ends
    np.testing.assert_allclose(d.displacements, motion(d.times), rtol=0, atol=2e-4)


def test_noise_has_its_size_and_its_seed():
    t, u = np.arange(1000.0), np.zeros((1000, 5, 2))
    d = measure(t, u, range(5), rate=1.0, noise=3e-5, seed=8)
    assert d.displacements.std() == pytest.approx(3e-5, rel=0.03)  # 10 000 samples: 0.7 %
    np.testing.assert_array_equal(d.displacements, measure(t, u, range(5), rate=1.0, noise=3e-5, seed=8).displacements)
    assert (d.displacements != measure(t, u, range(5), rate=1.0, noise=3e-5, seed=9).displacements).all()
    assert not measure(t, u, range(5), rate=1.0).displacements.any()


@pytest.mark.parametrize(('change', 'message'), [
    ({'rate': 0.0}, 'rate must be a positive number in kHz'),
    ({'noise': -1.0}, 'noise must be a zero or positive number in mm'),
    ({'rate': 0.01}, 'less than one step of the sampling rate 0.01 kHz'),
    ({'u': np.zeros((20, 2))}, r'u must have the shape \(20, 2, 2\)'),
])
def test_impossible_measurements_are_refused(change, message):
    with pytest.raises(ValueError, match=message):
        measure(**({'t': np.arange(20.0), 'u': np.zeros((20, 2, 2)), 'particles': [0, 1], 'rate': 1.0} | change))


def test_a_measured_table_is_analysed_like_a_simulated_record(tmp_path):
    omega_m = OMEGA_M['shear', 'complete']
    along = driven_row(omega_m, CARRIER['shear'], points=30, duration=1000, dt=2.0)
    u = along[..., None] * np.array([0.6, 0.8])
    d = measure(2.0 * np.arange(len(u)), u, range(30), rate=0.3, noise=0.03 * abs(along).max())
    write_displacements(tmp_path / 'scan.csv', d)
    scan = read_displacements(tmp_path / 'scan.csv')
    found = ridge(wavenumber_frequency(scan.along((0.6, 0.8)), scan.dt))
    # the demand is half a bin; noise of 3 % costs a tenth of it
    assert compare(found, closed_branch(omega_m)).bins < 0.1
    assert compare(found, closed_branch(2 * omega_m)).bins > 4.5
    across = wavenumber_frequency(scan.along((0.8, -0.6)), scan.dt).power.max()
    assert across < 1e-3 * wavenumber_frequency(scan.along((0.6, 0.8)), scan.dt).power.max()
