"""Sweeps: scenes against closed forms, what is refused, and what a file keeps."""

import json
import os
from concurrent.futures import ThreadPoolExecutor
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scene_files import ready_scene
from sweeping import calls, formula, noted

from magphonon import read_scene, units
from magphonon.cli.main import main
from magphonon.cli.sweep import axis_of
from magphonon.plotting import plot_sweep
from magphonon.sweeps import observables, sweep

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
    with pytest.warns(UserWarning, match='the force between neighbours varies'):
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


def test_gyration_splits_what_moves_alike(prototype):
    """All magnets in a circle on springs k: w^2 -+ g w = k/m; the control is what the two frequencies are without g."""
    g = np.array([0.0, 40.0, 160.0])
    found = sweep(prototype, {'lattice.gyration_rad_per_s': g}, ['bands.G.1', 'bands.G.2'])
    squared = prototype.foundation.pillar.stiffness_N_per_m / prototype.lattice.mass_kg
    for branch, sign in ((1, -1), (2, 1)):
        w = np.sqrt(squared + g**2 / 4) + sign * g / 2
        assert_allclose(found[f'bands.G.{branch}'], w / (2 * np.pi), rtol=1e-9)
    assert abs(found['bands.G.1'][2] / found['bands.G.1'][0] - 1) > 0.2


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
    found = sweep(read_scene(tmp_path / 'three.toml'), {'law.b_N_m_a': [1e-10, 1.6209e-10]}, 'stability.needed')
    sideways = 2 * found['law.b_N_m_a'].values * 0.01 ** -(1 + 4.5824)  # 2 f/L0
    assert_allclose(found['stability.needed'], sideways, rtol=1e-9, err_msg=str(found.fault.values))
    with pytest.raises(ValueError, match='a finite structure has no bands'):
        sweep(read_scene(tmp_path / 'three.toml'), {'law.a': [4.0]}, 'bands.G.1')


@pytest.mark.parametrize(('over', 'ask', 'words'), [
    ({'law.exponent': [3.0]}, 'bands.M.1', 'no number law.exponent'),
    ({'lattice.kind': [3.0]}, 'bands.M.1', 'only single numbers'),
    ({'law.a': [3.0, 3.0]}, 'bands.M.1', 'different numbers'),
    ({'law.a': []}, 'bands.M.1', 'different numbers'),
    ({}, 'bands.M.1', 'names no axis'),
    ({'law.a': [np.nan]}, 'bands.M.1', 'must be a finite number'),
    ({'law.a': [3.0]}, 'band.M.1', 'band.M.1 is no question'),
    ({'law.a': [3.0]}, (), 'no question'),
    ({'law.a': [3.0]}, 'bands.Q.1', 'the point must be one of'),
    ({'law.a': [3.0]}, 'bands.M.3', 'the branch must be at most 2, not 3'),
    ({'law.a': [3.0]}, 'bands.gap.2', 'the branch must be at most 1, not 2'),
    ({'law.a': [3.0]}, 'bands.M.x', 'a whole number'),
])
def test_mistakes_are_refused_before_anything_is_computed(prototype, over, ask, words):
    with pytest.raises(ValueError, match=words):
        sweep(prototype, over, ask)


def test_every_question_is_answered(prototype):
    scene = read_scene(ready_scene('oscillator'))
    names = [name.replace('POINT', 'M').replace('BRANCH', '1') for name in observables()]
    of_lattice = [name for name in names if not name.startswith('frf')]
    found = sweep(prototype, {'law.a': [4.5824]}, of_lattice)
    assert found.fault.values[0].startswith('stability.spacing: between a tenth')  # it holds itself, with a > 3
    assert all(np.isfinite(found[name].values[0]) for name in of_lattice if name != 'stability.spacing')
    found = sweep(scene, {'frf.points': [501]}, ['frf.peak_Hz', 'frf.peak_m_per_N'])
    step = np.diff(units.hertz(scene.frf.omega[:2]))  # at least, as 501 points lie closer
    assert_allclose(found['frf.peak_Hz'].values[0], np.sqrt(4.5e4) / (2 * np.pi), atol=step[0], rtol=0)
    assert_allclose(found['frf.peak_m_per_N'].values[0], 1 / (12 * np.sqrt(4.5e4)), rtol=0.05)  # 1/(M gamma omega), on a grid
    with pytest.raises(ValueError, match='the oscillator has no bands'):
        sweep(scene, {'frf.points': [501]}, 'bands.M.1')
    with pytest.raises(ValueError, match=r'no table \[frf\]'):
        sweep(read_scene(ready_scene('fcc')), {'lattice.mass_kg': [1.0]}, 'frf.peak_Hz')


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


def test_processes_compute_the_same_bits():
    over = {'x': np.linspace(0, 1, 5), 'y': [0.0, 1.0]}
    assert sweep(formula, over, workers=2).identical(sweep(formula, over))


def test_a_journal_goes_on_wherever_it_was_cut(tmp_path):
    function, file = noted_here(tmp_path), tmp_path / 'journal'
    whole = sweep(function, OVER, journal=file, name='noted')
    text = file.read_bytes()
    head = text.index(b'\n') + 1
    assert set(calls(tmp_path / 'calls').values()) == {1}
    for cut in range(head, len(text), 7):  # at ends of lines, within numbers
        file.write_bytes(text[:cut])
        before = calls(tmp_path / 'calls')
        assert sweep(function, OVER, journal=file, name='noted').identical(whole)
        assert sum(calls(tmp_path / 'calls').values()) - sum(before.values()) == 8 - (text[:cut].count(b'\n') - 1)
    for cut in range(0, head - 1, 7):
        file.write_bytes(text[:cut])
        with pytest.raises(ValueError, match='not the journal'):
            sweep(function, OVER, journal=file, name='noted')


@pytest.mark.filterwarnings('ignore:.*damaged lines')
def test_a_damaged_journal_gives_no_other_number(tmp_path):
    file = tmp_path / 'journal'
    whole = sweep(formula, OVER, journal=file, name='formula')
    text, draw = file.read_bytes(), np.random.default_rng(5)
    believed = refused = 0
    for _ in range(200):
        flipped = bytearray(text)
        flipped[draw.integers(len(text))] ^= 1 << int(draw.integers(8))
        file.write_bytes(flipped)
        try:
            found = sweep(formula, OVER, journal=file, name='formula')
        except ValueError as error:
            refused += 'not the journal' in str(error)
            continue
        assert found.identical(whole)
        believed += 1
    assert believed + refused == 200
    assert believed > 100


def test_the_journal_of_another_sweep_is_refused(tmp_path):
    function, file = noted_here(tmp_path), tmp_path / 'journal'
    with pytest.raises(ValueError, match='give a name='):
        sweep(function, OVER, journal=file)
    sweep(function, OVER, journal=file, name='sums')
    for over, name in ((OVER | {'y': [0.0, 1.5]}, 'sums'), (OVER, 'other sums')):
        with pytest.raises(ValueError, match='a different sweep'):
            sweep(function, over, journal=file, name=name)
    scene = read_scene(ready_scene('chain'))
    sweep(scene, {'lattice.mass_kg': [1.0]}, 'stability.needed', journal=tmp_path / 'chain')
    for other, over, ask in ((read_scene('square'), [1.0], 'stability.needed'), (scene, [2.0], 'stability.needed'),
                             (scene, [1.0], 'stability.margin')):
        with pytest.raises(ValueError, match='a different sweep'):
            sweep(other, {'lattice.mass_kg': over}, ask, journal=tmp_path / 'chain')


@pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='a system without pipes that have names')
def test_no_file_of_a_user_becomes_a_journal(tmp_path):
    notes, empty = tmp_path / 'notes', tmp_path / 'empty'
    notes.write_text('my notes')
    empty.touch()
    (tmp_path / 'link').symlink_to(empty)
    (tmp_path / 'dangling').symlink_to(tmp_path / 'nothing')
    os.mkfifo(tmp_path / 'pipe')
    (tmp_path / 'folder').mkdir()
    for name, words in (('notes', 'not the journal'), ('empty', 'not the journal'), ('link', 'is a link'),
                        ('dangling', 'is a link'), ('pipe', 'pipe'), ('folder', '.*'), ('none/there', 'cannot be written')):
        with pytest.raises((ValueError, OSError), match=words):
            sweep(formula, OVER, journal=tmp_path / name, name='formula')
    assert (notes.read_text(), empty.read_text()) == ('my notes', '')
    assert sorted(path.name for path in tmp_path.iterdir()) == ['dangling', 'empty', 'folder', 'link', 'notes', 'pipe']


@pytest.mark.parametrize('text', ['law.a', 'law.a=', '=1:2:3', 'law.a=1:2', 'law.a=1:2:0', 'law.a=1:2:2.5', 'law.a=-1:2:3:log',
                                  'law.a=1:2:3:lin', 'law.a=1,x', 'law.a=1:2:1e9', 'law.a=nan:1:3'])
def test_axes_that_are_none(text):
    with pytest.raises(ValueError, match='--over'):
        axis_of(text)


def test_axes():
    assert_array_equal(axis_of('law.a=3:6:4')[1], [3, 4, 5, 6])
    assert_allclose(axis_of('k=1e-2:1:3:log')[1], [0.01, 0.1, 1], rtol=1e-15)
    assert_array_equal(axis_of('k=4,2')[1], [4, 2])


def test_command(tmp_path, capsys):
    file, out = tmp_path / 'chain.toml', tmp_path / 'out'
    file.write_text(ready_scene('chain').read_text())
    words = ['sweep', str(file), '--verbose', '--executor', 'here', '--over', 'foundation.stiffness_N_per_m=2e4:6e4:3',
             '--over', 'law.a=3,4', '--ask', 'bands.X.1', '--ask', 'stability.margin', '-o', str(out)]
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
    buckled = [*words[:4], 'here', '--over', 'foundation.stiffness_N_per_m=1e4:3e4:3', '--ask', 'bands.X.1', '-o']
    assert main([*buckled, str(tmp_path / 'empty')]) == 2
    error = capsys.readouterr().err
    assert '3 times: the lattice buckles: it needs a foundation of 4e+04 N/m and has 1e+04 to 3e+04 N/m' in error


def test_the_journal_of_an_earlier_command_is_taken_up_and_stays(tmp_path, capsys):
    file, out = tmp_path / 'chain.toml', tmp_path / 'out'
    file.write_text(ready_scene('chain').read_text())
    out.mkdir()
    over = {'foundation.stiffness_N_per_m': [5e4, 6e4]}
    sweep(read_scene(file), over, ['bands.X.1'], journal=out / 'sweep.journal')  # as a killed command leaves it
    before = (out / 'sweep.journal').read_bytes()
    words = ['sweep', str(file), '--executor', 'here', '--over', 'foundation.stiffness_N_per_m=5e4,6e4', '--ask', 'bands.X.1',
             '-o', str(out)]
    assert main(words) == 0
    assert 'sweep.journal of an earlier command is still there' in ''.join(capsys.readouterr())
    assert (out / 'sweep.journal').read_bytes() == before
    assert (out / 'sweep.nc').exists()


def test_the_second_of_two_commands_in_one_folder_ends_well(tmp_path, monkeypatch, capsys):
    """It takes the journal of the first one up, which the first one removes meanwhile; none removes what the other made."""
    file, out = tmp_path / 'chain.toml', tmp_path / 'out'
    file.write_text(ready_scene('chain').read_text())
    words = ['sweep', str(file), '--executor', 'here', '--over', 'foundation.stiffness_N_per_m=5e4,6e4', '--ask', 'bands.X.1',
             '-o', str(out)]
    journal, ends = out / 'sweep.journal', []

    def second(*asked, journal, **more):  # the whole of another command, while the first one computes
        monkeypatch.setattr('magphonon.sweeps.dataset.sweep', sweep)
        found = sweep(*asked, journal=journal, **more)
        ends.append(main(words))
        assert (out / 'sweep.journal').exists()  # it is the first one's
        if len(ends) > 1:
            (out / 'sweep.journal').unlink()
        return found

    for _ in range(2):
        monkeypatch.setattr('magphonon.sweeps.dataset.sweep', second)
        ends.append(main(words))
        assert not journal.exists()
        assert (out / 'sweep.nc').exists()
    assert ends == [0, 0, 0, 0]
    with pytest.raises(ValueError, match='law'):  # a mistake leaves no journal behind
        sweep(read_scene(file), {'law.nothing': [1.0]}, ['bands.X.1'], journal=journal)
    assert main([*words[:5], 'law.nothing=1', *words[6:]]) == 2
    assert not journal.exists()


@pytest.mark.parametrize(('name', 'words'), [('fault', 'the reasons'), ('x', 'an axis')])
def test_answers_that_take_the_name_of_something_else_are_refused(name, words):
    with pytest.raises(TypeError, match=words):
        sweep(lambda x: {name: x}, {'x': [1.0, 2.0]}, workers=1)


def test_a_patch_with_defects_is_judged_as_check_judges_it(tmp_path, capsys):
    """A vacancy lets the prototype buckle on its foundation and not on one of 80 N/m: `magphonon check` of each scene says so."""
    scene = """
title = "hole"
[lattice]
kind = "triangular"
spacing_m = 0.01
mass_kg = 7.07e-4
[law]
kind = "inverse_power"
b_N_m_a = 1.6209e-10
a = 4.5824
shells = 1
[foundation]
stiffness_N_per_m = 19.6757
[patch]
kind = "hexagon"
side_m = 0.06
[defects]
vacancies_m = [[0.0, 0.0]]
"""
    (tmp_path / 'hole.toml').write_text(scene)
    found = sweep(read_scene(tmp_path / 'hole.toml'), {'foundation.stiffness_N_per_m': [19.6757, 80.0]},
                  ['stability.growth', 'verdict.faults', 'timestep.limit'], workers=1)
    (tmp_path / 'stiff.toml').write_text(scene.replace('19.6757', '80'))
    assert [main(['check', '--verbose', str(tmp_path / name)]) for name in ('hole.toml', 'stiff.toml')] == [1, 0]
    assert found['verdict.faults'].values.tolist() == [1, 0]
    assert np.isnan(found['stability.growth'].values[0])
    assert found['stability.growth'].values[1] == 0
    assert 'stability.growth' in str(found.fault.values[0])
    perfect = sweep(read_scene(ready_scene('prototype')), {'law.a': [4.5824]}, ['verdict.faults'], workers=1)
    assert perfect['verdict.faults'].values.tolist() == [0]  # the control: what was answered without the hole


@pytest.mark.parametrize('key', ['damping_per_s', 'temperature_J'])
def test_a_frequency_with_losses_or_heat_is_refused(prototype, key):
    found = sweep(prototype, {f'bands.{key}': [4.0 if key == 'damping_per_s' else 1e-6]}, ['bands.M.1', 'bands.gap.1'], workers=1)
    assert np.isnan(found['bands.M.1'].values).all()
    assert str(found.fault.values[0]).count(f'bands.{key}') == 2


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


def test_pictures_are_labelled_in_words_and_small_units():
    over = {'lattice.spacing_m': [0.01, 0.012], 'foundation.pillar.height_m': [0.2], 'law.a': [4, 5], 'law.force_N': [0.25]}
    found = sweep(read_scene('prototype'), over, ['bands.M.1', 'linear.amplitude', 'verdict.faults'])
    assert plot_sweep(found.isel({'law.a': 0}), 'verdict.faults').get_ylabel() == 'faults'  # without a unit
    ax = plot_sweep(found, 'bands.M.1')
    assert (ax.get_xlabel(), ax.get_ylabel()) == ('exponent a', 'lattice spacing (mm)')
    assert ax.get_title() == 'pillar height = 0.2 m, force between neighbours = 0.25 N'
    assert ax.get_ylim() == pytest.approx((9, 13))
    line = plot_sweep(found.isel({'law.a': 0}), 'linear.amplitude')
    assert line.get_ylabel() == 'amplitude for an error of 1 % (mm)'
    assert_allclose(line.lines[0].get_ydata(), 1e3 * found['linear.amplitude'].values[:, 0, 0, 0])
