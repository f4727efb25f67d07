"""Sweeps in one process: scenes against closed forms, what is refused, and what a file keeps."""

import json
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from sweeping import calls, formula, noted

from magphonon import read_scene, ready_scene, units
from magphonon.cli.main import main
from magphonon.plotting import plot_sweep
from magphonon.sweeps import axis_of, known_questions, sweep
from magphonon.sweeps.grid import unit_of

xarray = pytest.importorskip('xarray')
OVER = {'x': [0.0, 1.0, 2.0, 3.0], 'y': [0.0, 1.0]}


@pytest.fixture(scope='module')
def prototype():
    return read_scene(ready_scene('prototype'))


@pytest.mark.parametrize('seed', range(3))
def test_a_scene_is_asked_at_every_point(prototype, seed):
    # shear at M by the paper's formula, omega^2 = k/m + (2a - 6) b L^-a/(L m), and 2 (3 - a) f/L as what holds the lattice
    draw = np.random.default_rng(seed)
    a, L, H = draw.uniform(1.5, 6, 3), draw.uniform(0.007, 0.02, 2), draw.uniform(0.1, 0.5, 2)
    found = sweep(prototype, {'law.a': a, 'lattice.spacing_m': L, 'foundation.pillar.height_m': H},
                  ['bands.M.1', 'stability.needed', 'stability.margin'])
    a, L, H = np.meshgrid(a, L, H, indexing='ij')
    k = prototype.foundation.pillar.stiffness_N_per_m * (prototype.foundation.pillar.height_m / H) ** 3
    f, m = prototype.law.b_N_m_a * L**-a, prototype.lattice.mass_kg
    needed = 2 * np.maximum(3 - a, 0) * f / L
    scale = (k + f / L).max()
    assert_allclose(found['stability.needed'], needed, atol=1e-9 * scale)  # the search ends at a share of 1e-9 of the stiffness
    assert_allclose(found['stability.margin'], k - needed, atol=1e-9 * scale)
    squared = (k + (2 * a - 6) * f / L) / m
    held = needed <= k
    assert_allclose(found['bands.M.1'].values[held], np.sqrt(squared[held]) / (2 * np.pi), rtol=1e-9)
    assert_array_equal(np.isnan(found['bands.M.1']), ~held)
    assert all('buckles' in fault for fault in found.fault.values[~held])
    assert not any(found.fault.values[held])
    without_static_forces = np.sqrt((k + 2 * a * f / L) / m) / (2 * np.pi)  # control: D0 + D* is not D0
    assert abs(without_static_forces / found['bands.M.1'] - 1).max() > 1e-2
    assert found['bands.M.1'].attrs['units'] == 'Hz'
    assert found['foundation.pillar.height_m'].attrs['units'] == 'm'


def test_buckled_and_refused_points_are_recorded(prototype):
    scene = read_scene(ready_scene('ideal'))
    found = sweep(scene, {'law.a': [2.5, 4.0], 'lattice.mass_kg': [1.0, 1e-60]}, ['bands.K.1', 'stability.needed'])
    assert found['bands.K.1'].isnull().values.tolist() == [[True, True], [False, True]]
    assert found['stability.needed'].isnull().values.tolist() == [[False, True], [False, True]]
    assert 'bands.K.1: the lattice buckles: it needs a foundation of' in found.fault.values[0, 0]
    assert 'lattice.mass_kg must lie between' in found.fault.values[1, 1]
    assert found.fault.values[1, 0] == ''


def test_scenes_with_files_and_disorder(tmp_path):
    text = ready_scene('chain').read_text()
    (tmp_path / 'law.csv').write_text('r_m,f_N\n' + ''.join(f'{r},{1e4 * r**-4}\n' for r in np.linspace(0.5, 2, 40)))
    of_file = 'kind = "table"\nfile = "law.csv"\n'
    for old, new in (('kind = "inverse_power"\n', of_file), ('b_N_m_a = 1e4', '#'), ('a = 4.0', '#')):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / 'my.toml').write_text(text)
    found = sweep(read_scene(tmp_path / 'my.toml'), {'foundation.stiffness_N_per_m': [6e4]}, 'stability.needed')
    assert_allclose(found['stability.needed'], [4e4], rtol=1e-6)  # 4 f/L0 of the chain; a spline through 40 points of r^-4
    (tmp_path / 'three.csv').write_text('x_m,y_m,held\n0.0,0.0,1\n0.01,0.0,0\n0.02,0.0,1\n')
    lattice = '[lattice]\nkind = "file"\nfile = "three.csv"\nmass_kg = 7.07e-4\ncutoff_m = 0.012\n'
    law = '[law]\nkind = "inverse_power"\nb_N_m_a = 1.6209e-10\na = 4.5824\nshells = 1\n[foundation]\nstiffness_N_per_m = 20.0\n'
    (tmp_path / 'three.toml').write_text(f'title = "three"\n{lattice}{law}')
    found = sweep(read_scene(tmp_path / 'three.toml'), {'law.a': [4.0, 4.5824]}, ['stability.needed', 'bands.G.1'])
    sideways = 2 * 1.6209e-10 * 0.01 ** -(1 + found['law.a'].values)  # 2 f/L0
    assert_allclose(found['stability.needed'], sideways, rtol=1e-9, err_msg=str(found.fault.values))
    assert 'is finite and has no bands' in found.fault.values[0]


@pytest.mark.parametrize(('over', 'ask', 'words'), [
    ({'law.exponent': [3.0]}, 'bands.M.1', 'no number law.exponent'),
    ({'lattice.kind': [3.0]}, 'bands.M.1', 'only single numbers'),
    ({'law.a': [3.0, 3.0]}, 'bands.M.1', 'different numbers'),
    ({'law.a': []}, 'bands.M.1', 'different numbers'),
    ({}, 'bands.M.1', 'names no axis'),
    ({'law.a': [np.nan]}, 'bands.M.1', 'must be a finite number'),
    ({'law.a': [3.0]}, 'band.M.1', 'band.M.1 is no question'),
    ({'law.a': [3.0]}, (), 'no question'),
])
def test_mistakes_are_refused_before_anything_is_computed(prototype, over, ask, words):
    with pytest.raises(ValueError, match=words):
        sweep(prototype, over, ask)


def test_every_question_is_answered(prototype):
    scene = read_scene(ready_scene('oscillator'))
    names = [name.replace('POINT', 'M').replace('BRANCH', '1') for name in known_questions()]
    of_lattice = [name for name in names if not name.startswith('frf')]
    found = sweep(prototype, {'law.a': [4.5824]}, of_lattice)
    assert found.fault.values[0].startswith('stability.spacing: no spacing')  # it holds itself, with a > 3
    assert all(np.isfinite(found[name].values[0]) for name in of_lattice if name != 'stability.spacing')
    found = sweep(scene, {'frf.points': [501]}, ['frf.peak_Hz', 'frf.peak_m_per_N', 'bands.M.1'])
    step = np.diff(units.hertz(scene.frf.omega[:2]))  # at least, as 501 points lie closer
    assert_allclose(found['frf.peak_Hz'].values[0], np.sqrt(4.5e4) / (2 * np.pi), atol=step[0], rtol=0)
    assert_allclose(found['frf.peak_m_per_N'].values[0], 1 / (12 * np.sqrt(4.5e4)), rtol=0.05)  # 1/(M gamma omega), on a grid
    assert 'no bands' in found.fault.values[0]


def test_a_function_returns_numbers_or_arrays(tmp_path):
    found = sweep(formula, {'x': [0.1, 0.2], 'y': [1.0, 2.0, 3.0]}, units={'x': 'mm', 'trace': 'N'})
    assert found['row'].dims == ('x', 'y', 'row_0')
    assert found.trace.values[1, 2] == formula(0.2, 3.0)['trace']
    assert_array_equal(found['row'].values[0, 1], formula(0.1, 2.0)['row'])
    assert (found.x.attrs['units'], found.trace.attrs['units']) == ('mm', 'N')
    found.to_netcdf(tmp_path / 'a.nc', engine='h5netcdf')
    assert xarray.load_dataset(tmp_path / 'a.nc', engine='h5netcdf').identical(found)


def test_zarr_keeps_it(tmp_path):
    pytest.importorskip('zarr')
    found = sweep(noted_here(tmp_path), OVER)
    found.to_zarr(tmp_path / 'a.zarr', consolidated=False)
    assert xarray.load_dataset(tmp_path / 'a.zarr', engine='zarr', consolidated=False).equals(found)


def noted_here(folder):
    (folder / 'calls').mkdir(exist_ok=True)
    return partial(noted, str(folder / 'calls'))


def mistaken(x, y):
    return x + y if x < 2 else x + undefined  # noqa: F821  that is the mistake


def texts(x, y):
    return 'text'


def infinite(x, y):
    return {'good': x, 'bad': np.inf}


def test_mistakes_in_a_program_are_no_bad_points():
    with pytest.raises(NameError):
        sweep(mistaken, OVER)
    with pytest.raises(TypeError, match='real numbers'):
        sweep(texts, OVER)
    found = sweep(infinite, OVER)
    assert found.fault.values[0, 0] == 'bad is inf'
    assert found.good.values[3, 0] == 3


def test_threads_compute_the_same_bits():
    over = {'x': np.linspace(0, 1, 5), 'y': [0.0, 1.0]}
    with ThreadPoolExecutor(3) as pool:
        assert sweep(formula, over, executor=pool).identical(sweep(formula, over))


def test_a_journal_goes_on_wherever_it_was_cut(tmp_path):
    function, file = noted_here(tmp_path), tmp_path / 'journal'
    whole = sweep(function, OVER, journal_file=file)
    text = file.read_bytes()
    assert set(calls(tmp_path / 'calls').values()) == {1}
    for cut in range(0, len(text), 7):  # in the first line, at ends of lines, within numbers
        file.write_bytes(text[:cut])
        before = calls(tmp_path / 'calls')
        assert sweep(function, OVER, journal_file=file).identical(whole)
        kept = max(text[:cut].count(b'\n') - 1, 0)
        assert sum(calls(tmp_path / 'calls').values()) - sum(before.values()) == 8 - kept


def test_the_journal_of_another_sweep_is_refused(tmp_path):
    function, file = noted_here(tmp_path), tmp_path / 'journal'
    sweep(function, OVER, journal_file=file)
    for other, over in ((function, OVER | {'y': [0.0, 1.5]}), (partial(function, pause=1e-9), OVER), (infinite, OVER)):
        with pytest.raises(ValueError, match='another sweep'):
            sweep(other, over, journal_file=file)
    file.write_text('my notes')
    with pytest.raises(ValueError, match='no journal'):
        sweep(function, OVER, journal_file=file)
    assert file.read_text() == 'my notes'
    (tmp_path / 'damaged').write_text('{"x\n[1, 2]\n')
    with pytest.raises(ValueError, match='damaged in line 1'):
        sweep(function, OVER, journal_file=tmp_path / 'damaged')


def test_two_sweeps_do_not_share_a_journal(tmp_path):
    function, file = noted_here(tmp_path), tmp_path / 'journal'

    def meddling(x, y):
        with pytest.raises(ValueError, match='written by another sweep'):
            sweep(function, OVER, journal_file=file)
        return x

    sweep(function, OVER, journal_file=tmp_path / 'other')
    from magphonon.sweeps.journal import journal

    with journal(file, 'mark', 8):
        assert meddling(1.0, 1.0) == 1.0


@pytest.mark.parametrize('text', ['law.a', 'law.a=', '=1:2:3', 'law.a=1:2', 'law.a=1:2:0', 'law.a=1:2:2.5', 'law.a=-1:2:3:log',
                                  'law.a=1:2:3:lin', 'law.a=1,x', 'law.a=nan:1:3'])
def test_axes_that_are_none(text):
    with pytest.raises(ValueError, match='--over'):
        axis_of(text)


def test_axes():
    assert_array_equal(axis_of('law.a=3:6:4')[1], [3, 4, 5, 6])
    assert_allclose(axis_of('k=1e-2:1:3:log')[1], [0.01, 0.1, 1], rtol=1e-15)
    assert_array_equal(axis_of('k=4,2')[1], [4, 2])
    assert [unit_of(key) for key in ('law.a', 'foundation.stiffness_N_per_m', 'frf.damping_per_s', 'law.b_N_m_a')] == [
        '', 'N/m', '1/s', 'N m^a']


def test_command(tmp_path, capsys):
    file, out = tmp_path / 'chain.toml', tmp_path / 'out'
    file.write_text(ready_scene('chain').read_text())
    words = ['sweep', str(file), '--executor', 'here', '--over', 'foundation.stiffness_N_per_m=2e4:6e4:3', '--over', 'law.a=3,4',
             '--ask', 'bands.X.1', '--ask', 'stability.margin', '-o', str(out)]
    assert main(words) == 0
    told = capsys.readouterr().out
    assert '6 points: 3 of foundation.stiffness_N_per_m x 2 of law.a' in told
    assert '2 times: bands.X.1: the lattice buckles' in told
    assert sorted(path.name for path in out.iterdir()) == [
        'provenance.json', 'scene.toml', 'sweep.nc', 'sweep_bands.X.1.png', 'sweep_stability.margin.png']
    answers = xarray.load_dataset(out / 'sweep.nc', engine='h5netcdf')
    # sideways, k - 4 f/L0 at the edge of the zone, with f = 1e4 N and unit mass
    assert_allclose(answers['bands.X.1'].values[2], np.sqrt(6e4 - 4e4) / (2 * np.pi), rtol=1e-9)
    assert json.loads(answers.attrs['scene'])['title'] == answers.attrs['title']
    assert main([*words, '--scheduler', 'tcp://x']) == 2
    assert main([*words[:-2], '--over', 'law.a=5', '-o', str(out)]) == 2
    assert 'twice' in capsys.readouterr().err


def refusing(x, y):
    if y == 0 or (x == 100 and y == 2):
        raise ValueError('not here')
    return np.log(x) - y


def test_bad_points_are_hatched():
    found = sweep(refusing, {'x': np.geomspace(1, 100, 4), 'y': [0.0, 1.0, 2.0]})
    assert found.value.isnull().sum() == 5
    hatched = [c for c in plot_sweep(found, 'value').collections if c.get_hatch()]
    assert sum(len(c.get_paths()) for c in hatched) == 5
    ax = plot_sweep(found.isel(y=2), 'value')
    assert len([patch for patch in ax.patches if patch.get_hatch()]) == 1
    assert ax.get_xscale() == 'log'


@pytest.mark.parametrize(('largest', 'scale'), [(1.9e3, 'log'), (100.0, 'linear')])
def test_answers_over_decades_are_drawn_on_a_logarithmic_scale(largest, scale):
    table = np.geomspace(20.0, largest, 6).reshape(3, 2)
    table[1, 0] = np.nan
    answers = xarray.Dataset({'f': (('y', 'x'), table)}, coords={'x': [1.0, 2.0], 'y': [1.0, 2.0, 3.0]})
    assert plot_sweep(answers.isel(x=1), 'f').get_yscale() == scale
    ax = plot_sweep(answers, 'f')
    assert type(ax.collections[-1].norm).__name__ == {'log': 'LogNorm', 'linear': 'Normalize'}[scale]
