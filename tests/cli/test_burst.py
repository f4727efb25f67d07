"""The commands burst and spectrum: what they write, that a table read again gives the same ridge, and how they fail."""

import argparse
import csv
import io
import re
import signal
import subprocess
import sys
import time
from contextlib import redirect_stderr, redirect_stdout
from functools import cache

import matplotlib as mpl
import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene

from magphonon import read_scene
from magphonon.cli import burst
from magphonon.cli.main import main
from magphonon.stability.amplitude_shifts import frequency_shifts
from magphonon.waves.spectrum import Spectrum


def test_a_burst_is_called_loud_just_above_the_amplitude_that_linear_bands_bear():
    cell = read_scene(ready_scene('ideal')).atoms()
    bound = frequency_shifts(cell).amplitude(0.01)  # frequencies one percent off
    (quiet,), (loud,) = burst._amplitudes(cell, {'quiet': 0.99 * bound, 'loud': 1.01 * bound}, burst._linear_range(cell))
    assert 'WARNING' not in quiet
    assert 'WARNING' in loud


# the paper's ideal lattice on a patch of 32 x 32, one burst: quick, and yet 3 and more bins between the models
SMALL = [(r'cells_(.) = 60', r'cells_\1 = 32'), (r'carriers_Hz = .*', 'carriers_Hz = [19.1]'),
         (r'directions_deg = .*', 'directions_deg = [0]'), ('duration_s = 1.0', 'duration_s = 0.6')]
NAMES = ('19.1Hz_0deg_complete', '19.1Hz_0deg_conventional')


@pytest.fixture
def scene_file(tmp_path):
    """A function that writes the small scene with further replacements and an addition."""
    def write(*changes, more='', name='ideal', small=SMALL):
        text = ready_scene(name).read_text()
        for old, new in (*small, *changes):
            assert re.search(old, text), old
            text = re.sub(old, new, text)
        file = tmp_path / 'my.toml'
        file.write_text(text + more)
        return file
    return write


@pytest.fixture(scope='module')
def run_of(tmp_path_factory):
    """A function that runs the small scene, once for all tests: its file, its results, what it has shown."""
    @cache
    def run():
        folder = tmp_path_factory.mktemp('run')
        text = ready_scene('ideal').read_text()
        for old, new in SMALL:
            text = re.sub(old, new, text)
        (folder / 'my.toml').write_text(text)
        with mpl.rc_context({'savefig.dpi': 20}), redirect_stdout(io.StringIO()) as out, redirect_stderr(io.StringIO()) as err:
            assert main(['burst', str(folder / 'my.toml'), '-o', str(folder / 'out'), '--verbose']) == 0
        return folder / 'my.toml', folder / 'out', out.getvalue(), err.getvalue()
    return run


def ridges(folder, name='ridges.csv'):
    """Rows of the table of ridges by record and motion, as arrays of their numbers."""
    with open(folder / name, newline='') as file:
        _, *rows = csv.reader(file)
    return {key: np.array([row[2:7] for row in rows if (row[0], row[1]) == key], dtype=float)
            for key in dict.fromkeys((row[0], row[1]) for row in rows)}


def reported(text):
    """Bins off complete and conventional shear, by record, for transverse motion."""
    rows = [line.split() for line in text.splitlines() if ' transverse ' in line and 'motion:' not in line]
    return {row[0]: (float(row[5]), float(row[7])) for row in rows}


@pytest.mark.slow
def test_what_burst_writes_spectrum_reads_to_the_same_ridge(run_of, tmp_path, capsys):
    scene, out, shown, said = run_of()
    assert 'UNSTABLE' not in shown
    assert said == ''  # no progress where nobody watches
    assert (out / 'ridges.txt').read_text().strip() in shown
    written = {file.name for file in out.iterdir()}
    assert {'row.csv', 'ridges.csv', 'ridges.txt', '19.1Hz_0deg_maps.png', '19.1Hz_0deg_snapshot.png',
            *(f'{name}.csv' for name in NAMES), *(f'{name}_transverse.npz' for name in NAMES)} <= written

    off = reported(shown)
    # half a bin is the demand; noise of a thousandth of the wave does not show
    assert off[NAMES[0]][0] < 0.5 < 3 < off[NAMES[0]][1]
    assert off[NAMES[1]][1] < 0.5 < 3 < off[NAMES[1]][0]
    table = (out / 'ridges.csv').read_text().splitlines()
    for name, model in zip(NAMES, ('complete', 'conventional'), strict=True):
        own = {line.split(',')[7] for line in table if line.startswith(f'{name},transverse,')}
        assert own == {f'{model} shear'}
        assert f'{name}, transverse motion: agrees with the {model} shear branch (' in shown

    burst = ridges(out)
    for name in NAMES:
        again = tmp_path / name
        assert main(['spectrum', '--verbose', str(out / f'{name}.csv'), str(scene), '-o', str(again)]) == 0
        said = capsys.readouterr().out
        assert reported(said)[name] == off[name]
        assert f'spectrum_{name}_ridges.csv --bands {scene}" fits the lattice' in said
        for key, points in ridges(again, f'spectrum_{name}_ridges.csv').items():
            # times come back to 1e-15 of the record, which the round-off of the transform hardly moves
            assert_allclose(points, burst[key], rtol=1e-6)
        assert {file.name for file in again.iterdir()} >= {f'spectrum_{name}_ridges.csv', f'spectrum_{name}_ridges.txt',
                                                           f'spectrum_{name}_transverse.png'}
        assert Spectrum.load(again / f'spectrum_{name}_transverse.npz').power.max() > 0


@pytest.mark.slow
def test_loud_bursts_are_told_from_quiet_ones(run_of, scene_file, tmp_path, capsys):
    """By second-order perturbation theory a frequency of the lattice is 1 % off at 2.37 % of the spacing."""
    _, out, soft, _ = run_of()
    assert main(['burst', str(scene_file(('force_N = 1.0', 'force_N = 300.0'))), '-o', str(tmp_path / 'loud'), '--verbose']) == 0
    told = []
    for shown in (soft, capsys.readouterr().out):
        found = {line.split(':')[0]: line for line in shown.splitlines() if 'largest displacement' in line}
        assert found.keys() == set(NAMES)
        lines = [found[name] for name in NAMES]
        read = [re.search(r'displacement ([0-9.]+) (.?)m,', line) for line in lines]
        told.append([float(value) * {'': 1.0, 'm': 1e-3, 'µ': 1e-6}[prefix] for value, prefix in map(re.Match.groups, read)])
        for u, line in zip(told[-1], lines, strict=True):
            assert f'm, {u:.2%} of the spacing' in line  # of 1 m
            assert ('WARNING: beyond the linear range: at 23.7 mm frequencies are already off by 1%' in line) == (u > 0.0237)
    (quiet, stiff), (loud, _) = told
    assert stiff < quiet < 0.0237 < loud
    record = np.loadtxt(out / f'{NAMES[0]}.csv', delimiter=',', skiprows=1)
    measured = np.hypot(*record[:, 2:].T).max()
    assert quiet == pytest.approx(2 * measured, rel=0.15)  # the row starts half way up the beam, whose middle moves most


@pytest.mark.slow
def test_the_row_to_measure_and_an_animation_on_request(scene_file, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('magphonon.cli.burst.FILM', 5)  # frames are slow to draw
    assert main(['burst', str(scene_file()), '-o', str(tmp_path / 'out'), '--animation']) == 0
    film = (tmp_path / 'out' / f'{NAMES[0].rpartition("_")[0]}_film.gif').read_bytes()
    assert film.startswith(b'GIF89a')
    assert int.from_bytes(film[6:8], 'little') == 1000  # pixels: both models side by side
    assert film.count(b'\x21\xf9\x04') >= 5  # frames
    step, particle, x, y = np.loadtxt(tmp_path / 'out' / 'row.csv', delimiter=',', skiprows=1).T
    assert_allclose(step, np.arange(30))
    assert_allclose(np.transpose([np.diff(x), np.diff(y)]), np.tile([0.5, np.sqrt(0.75)], (29, 1)), rtol=1e-12)
    patch = read_scene(scene_file()).patch_atoms()
    assert_allclose(patch.positions[particle.astype(int), :2], np.transpose([x, y]) * 1e3, rtol=1e-12)


@pytest.mark.slow
def test_a_burst_in_the_gap_is_said_not_to_travel(scene_file, tmp_path, capsys):
    """At 15 Hz, below the cut-off of 26.55 Hz, the waves of a point source decay by 0.3423 and 0.3298 a step."""
    changes = [('side_m = 0.3', 'side_m = 0.15'), (r'carriers_Hz = .*', 'carriers_Hz = [15]'), ('cycles = 5', 'cycles = 12'),
               (r'directions_deg = .*', 'directions_deg = [90]'), ('duration_s = 0.5', 'duration_s = 0.9')]
    scene = scene_file(*changes, name='bench', small=())
    assert main(['burst', str(scene), '-o', str(tmp_path / 'out')]) == 0
    shown = capsys.readouterr().out
    for model, steps in (('complete', 2.92), ('conventional', 3.03)):
        assert (f'15Hz_90deg_{model}: 15 Hz lies in a band gap along R2; the wave that decays most slowly falls to 1/e in '
                f'{steps} steps') in shown
    assert ridges(tmp_path / 'out') == {}


def test_a_lattice_that_buckles_is_called_unstable(scene_file, tmp_path, capsys):
    """The square lattice needs springs of 4 f(L0)/L0 = 40 kN/m."""
    scene = scene_file(('"triangular"', '"square"'), ('GMKG', 'GXM'), ('= 32', '= 14'), ('0.6', '0.27'))
    assert main(['burst', str(scene), '-o', str(tmp_path / 'out')]) == 2  # what grows takes the particles out of their cells
    shown = capsys.readouterr().err
    assert 'UNSTABLE: the static forces buckle the infinite lattice. It buckles' in shown
    assert 'It needs a foundation of 40 kN/m and has 0 N/m.' in shown
    assert 'lower force_N' not in shown
    assert 'lower burst.force_N' not in shown
    assert not (tmp_path / 'out').exists()


# --- how they fail ---------------------------------------------------------------------------------------------------

@pytest.mark.parametrize(('change', 'message'), [
    (('force_N = 1.0', 'force_N = 1e6'), r'19.1Hz_0deg, complete simulation: it diverged at .* ms .*lower burst.force_N'),
    (('19.1', ''), 'burst.carriers_Hz names no burst'),
    (('19.1', '19.1, 20'), r'burst.directions_deg must hold a direction for each of the 2 carriers, not \[0.0\]'),
    ((r'(?s)\[19.1\](.*?)\[0\]', r'[19.1, 19.1]\1[0, 0]'), 'burst lists a burst twice, among 19.1Hz_0deg, 19.1Hz_0deg; keep'),
    (('duration_s = 0.6', 'duration_s = 0.2'), 'burst.duration_s must be longer than the longest burst, 0.26178 s, not 0.2'),
    ((r'\[19.1\]', '[91]'), 'the carrier of 91 Hz lies above .* in the complete model, 74.* conventional model reaches'),
    (('(?s)\\[patch\\].*?\n\n', ''), r'has no table \[patch\]; add one'),
    (('(?s)\\[burst\\].*?\n\n', ''), r'has no table \[burst\]; add one'),
    ((r'cells_(.) = 32', r'cells_\1 = 9'), r'the row along R2 has 7 particles .* at least 8; make \[patch\] 1\.3 times as large'),
])
def test_impossible_scene_is_refused_in_words_and_nothing_is_written(change, message, scene_file, tmp_path, capsys):
    assert main(['burst', str(scene_file(change)), '-o', str(tmp_path / 'out'), '--engine', 'ase']) == 2
    assert re.search(message, capsys.readouterr().err)
    assert {file.name for file in tmp_path.iterdir()} == {'my.toml'}


@pytest.fixture(scope='module')
def measured(tmp_path_factory):
    """The small scene and a table of noise for its row."""
    folder = tmp_path_factory.mktemp('measured')
    text = ready_scene('ideal').read_text()
    for old, new in SMALL:
        text = re.sub(old, new, text)
    (folder / 'my.toml').write_text(text)
    scene = read_scene(folder / 'my.toml')
    from magphonon.waves.wave_source import burst_setup

    row = burst_setup(scene.atoms(), scene.patch_atoms(), 'row').row
    noise = np.random.default_rng(0).normal(size=(20, len(row), 2))
    lines = [f'{0.01 * k},{particle},{x:.6e},{y:.6e}' for k in range(20) for particle, (x, y) in zip(row, noise[k], strict=True)]
    return folder, ['time_s,particle,u_x_m,u_y_m', *lines], row


def swinging(lines):
    """The same table with a motion at 21 Hz instead of noise."""
    rows = [line.split(',')[:2] for line in lines[1:]]
    return [lines[0], *(f'{t},{particle},{np.sin(132 * float(t)):.6e},{np.cos(132 * float(t)):.6e}' for t, particle in rows)]


@pytest.mark.parametrize(('spoil', 'message'), [
    (lambda a, row: [line for n, line in enumerate(a) if n == 0 or int(line.split(',')[1]) in row[::2]], 'differ by 3.14 rad'),
    (lambda a, row: [re.sub(r',\d+,', ',A,', line) if n else line for n, line in enumerate(a)], 'lists point A at 0 s twice'),
    (lambda a, row: [line.replace('0.05,', '0.053,', 1) if line.startswith('0.05,') else line for line in a],
     'too far apart for motion at [0-9.]+ Hz: all points have gaps of 0.013 s or more'),
    (lambda a, row: [line for line in swinging(a) if not re.match(r'0\.(0[4-9]|1[0-4])', line)],
     'too far apart for motion at [0-9.]+ Hz: all points have gaps of 0.07 s or more'),
    (lambda a, row: [re.sub(r',(\d+),', r',a\1,', line) for line in a], 'are missing; only those of the points'),
    (lambda a, row: [re.sub(r'(,[^,]*){2}$', ',0,0', line) if k else line for k, line in enumerate(a)], 'at rest throughout'),
    (lambda a, row: a[: 1 + 6 * len(row)], 'at least 8 of each'),
])
def test_a_table_that_cannot_be_analysed_is_refused_in_words(spoil, message, measured, tmp_path, capsys):
    folder, lines, row = measured
    (tmp_path / 'scan.csv').write_text('\n'.join(spoil(lines, row)) + '\n')
    assert main(['spectrum', '--verbose', str(tmp_path / 'scan.csv'), str(folder / 'my.toml'), '-o', str(tmp_path / 'out')]) == 2
    assert re.search(message, capsys.readouterr().err)
    assert {file.name for file in tmp_path.iterdir()} == {'scan.csv'}


def test_noise_is_a_map_without_ridge(measured, tmp_path, capsys):
    folder, lines, _ = measured
    (tmp_path / 'scan.csv').write_text('\n'.join(lines) + '\n')
    assert main(['spectrum', '--verbose', str(tmp_path / 'scan.csv'), str(folder / 'my.toml'), '-o', str(tmp_path / 'out')]) == 0
    assert ridges(tmp_path / 'out', 'spectrum_scan_ridges.csv') == {}
    assert 'fits the lattice' not in capsys.readouterr().out


def struck(number, scene_file, tmp_path):
    """A burst that a signal strikes between the first files and the last: its directory, exit status and last words."""
    scene = scene_file((r'\[19.1\]', '[19.1, 18, 17, 16]'), (r'directions_deg = \[0\]', 'directions_deg = [0, 0, 0, 0]'))
    out = tmp_path / 'out'
    out.mkdir()
    process = subprocess.Popen([sys.executable, '-m', 'magphonon', 'burst', str(scene), '-o', str(out)],
                               stderr=subprocess.PIPE, text=True)
    try:
        while process.poll() is None and not list(out.glob('.magphonon-*/*.csv')):
            time.sleep(0.02)
    finally:
        process.send_signal(number)
        words = process.communicate()[1]
    return out, process.returncode, words


@pytest.mark.slow
def test_terminated_burst_leaves_nothing(scene_file, tmp_path):
    """As a batch system ends a job that has run for too long."""
    out, status, words = struck(signal.SIGTERM, scene_file, tmp_path)
    assert (status, words) == (130, 'magphonon: interrupted\n')
    assert not list(out.iterdir())


@pytest.mark.parametrize('engine', ['ase', 'compiled', None])
def test_the_engine_of_a_burst(engine, scene_file, tmp_path, monkeypatch, capsys):
    """What the time steps are asked for, before the first of them."""
    def strike(atoms, timestep, drives, damping, engine, *_, **options):
        raise ValueError(f'{engine} steps')

    monkeypatch.setattr('magphonon.waves.wave_source.DrivenVerlet', strike)
    assert main(['burst', str(scene_file()), '-o', str(tmp_path / 'out'), *(['--engine', engine] if engine else [])]) == 2
    assert f'{engine or "auto"} steps' in capsys.readouterr().err


def test_lammps_without_files_runs_in_a_folder_of_its_own():
    options = argparse.Namespace(engine='lammps', ranks=None, files=None, animation=False)
    assert burst._engine(options)('burst', 'complete')['directory'] is None
