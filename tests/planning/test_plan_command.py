"""Plans of scenes, and the command that prints and runs them."""

import numpy as np
import pytest

from magphonon.planning.plan import Method, Plan, Settings
from magphonon.planning.scene import _time_steps, scene_plans
from magphonon.response import propagation
from magphonon.scenes.scene import read_scene, ready_scene


def scene_file(folder, name, extra):
    file = folder / 'scene.toml'
    file.write_text(ready_scene(name).read_text(encoding='utf-8') + extra, encoding='utf-8')
    return file


def test_the_plan_of_an_edge_is_that_of_its_frequency():
    """Of the prototype's shear at M all neighbours make 67.4 Hz out of 58.2: 14 %."""
    scene = read_scene(ready_scene('prototype'))
    plan = next(iter(scene_plans(scene, 1e-2))).plan
    nearest = next(method for method in plan.methods if method.settings == Settings('complete', 1))
    true = 1 - 58.2326897819 / 67.4525  # of docs and README, from the exact sums
    assert true <= nearest.error <= true + 0.25e-2  # a quarter of the tolerance may be lacking in the reference


@pytest.mark.parametrize(('name', 'extra', 'files'), [
    ('chain', '', ['plan_bands.csv', 'plan_bands.npz', 'provenance.json', 'scene.toml']),
    ('oscillator', '', ['plan_frf.csv', 'plan_frf.npz', 'provenance.json', 'scene.toml']),
])
def test_command_runs_what_it_chose(tmp_path, capsys, name, extra, files):
    from magphonon.cli.main import main

    scene = scene_file(tmp_path, name, extra)
    assert main(['plan', str(scene), '--tolerance', '1e-3', '--run', '-o', str(tmp_path / 'out')]) == 0
    assert sorted(file.name for file in (tmp_path / 'out').iterdir()) == files
    text = capsys.readouterr().out
    assert '<- recommended' in text
    assert 'Recommended: complete linear' in text
    if name == 'oscillator':  # its stiffness: 4 f/L0 of the lower magnet, f/8L0 of each outer one, with f = 1e4 N, L0 = 1 m, 1 kg
        f, amplitude, _ = np.loadtxt(tmp_path / 'out' / 'plan_frf.csv', delimiter=',', skiprows=1).T
        w = 2 * np.pi * f
        assert amplitude == pytest.approx(1 / abs(4.5e4 - w**2 + 12j * w), rel=1e-9)


@pytest.mark.slow
def test_a_strong_force_is_run_in_time_steps(tmp_path, capsys):
    from magphonon.cli.main import main

    text = ready_scene('oscillator').read_text(encoding='utf-8')
    for old, new in (('force_N = 20.0', 'force_N = 40.0'), ('points = 961', 'points = 5'), ('from_Hz = 16.0', 'from_Hz = 32.0'),
                     ('to_Hz = 64.0', 'to_Hz = 36.0')):
        assert old in text
        text = text.replace(old, new)
    scene = tmp_path / 'scene.toml'
    scene.write_text(text)
    assert main(['plan', str(scene), '--tolerance', '1e-5', '--run', '-o', str(tmp_path / 'out')]) == 0
    assert 'Recommended: nonlinear, by velocity Verlet' in capsys.readouterr().out
    rows = np.loadtxt(tmp_path / 'out' / 'plan_frf.csv', delimiter=',', skiprows=1)
    assert rows[:, 0] == pytest.approx([32, 33, 34, 35, 36])
    assert rows[:, 1].argmax() == 2  # 33.76 Hz


@pytest.mark.parametrize(('tolerance', 'words'), [
    (0.1, []), (1e-3, ['1000000 particles in 10000 steps', ' 1 min and 0.7 GiB ', ' 5.4 min ', ' 15 min ']), (1e-9, [])])
def test_the_cost_of_time_steps_is_told_where_they_are_recommended(tolerance, words):
    """A million particles, 10000 steps of 6, 32 and 90 ns, with 9 and 110 us of Python each: 60, 321 and 900 s."""
    methods = (Method('complete linear', 'products', 1.0, 0.01, 0.0, Settings('complete')),
               Method('nonlinear', 'steps', 9.0, 1e-6, 0.0, Settings('complete', dt=0.1)))
    told = _time_steps(Plan('Waveform', 'its rms', tolerance, methods, (), 0.0), 10**6, 1000.0)
    assert len(told) == (1 if words else 0)
    assert all(word in told[0] for word in words)


def test_a_burst_is_propagated_exactly(tmp_path, monkeypatch, capsys):
    import magphonon.planning.waveform  # noqa: F401  before the patch, so that the plan's own solutions are not counted
    from magphonon.cli.main import main

    text = ready_scene('ideal').read_text(encoding='utf-8')
    text = text.replace('cells_1 = 60', 'cells_1 = 12').replace('cells_2 = 60', 'cells_2 = 12')
    (tmp_path / 'scene.toml').write_text(text[:text.index('[bands]')] if text.index('[bands]') > text.index('[burst]') else text)
    called = []
    real = propagation.propagate
    monkeypatch.setattr('magphonon.response.propagation.propagate', lambda *a, **k: called.append(a) or real(*a, **k))
    assert main(['plan', str(tmp_path / 'scene.toml'), '--tolerance', '2e-2', '--run', '-o', str(tmp_path / 'out')]) == 0
    assert len(list((tmp_path / 'out').glob('plan_burst_*.csv'))) == 2
    assert 'exact propagation' in capsys.readouterr().out
    assert called
    burst = read_scene(tmp_path / 'scene.toml').burst
    for (patch, times, drives, damping, row), carrier, name in zip(called, burst.carriers_Hz, burst.names, strict=True):
        assert damping == pytest.approx(2 * 0.01 * 2 * np.pi * carrier / 1e3)  # 2 zeta omega, in 1/ms
        assert np.diff(times).max() * carrier / 1e3 == pytest.approx(1 / 12)  # a dozen of frames in a period
        table = np.loadtxt(tmp_path / 'out' / f'plan_burst_{name}.csv', delimiter=',', skiprows=1)
        expected = real(patch, times, drives, damping, row).displacements
        assert table[:, 0] == pytest.approx(np.repeat(times, len(row)) / 1e3)
        assert table[:, 2:] == pytest.approx(expected.reshape(-1, 2) / 1e3, rel=1e-12)


@pytest.mark.parametrize(('extra', 'arguments', 'message'), [
    ('', ['--tolerance', '-1'], '--tolerance must be a positive number'),
    ('', ['--tolerance', '1e-8'], '--tolerance must lie between 1e-07 and 1, not 1e-08'),
    ('', ['--tolerance', '5'], '--tolerance must lie between 1e-07 and 1, not 5'),
    ('', ['-o', 'out'], '-o out is the directory for the results of --run; add --run'),
    ('\n[plan]\nedge = "K"\n', [], 'plan.edge of the chain lattice must be one of'),
    ('\n[plan]\nedge = "X"\nbranch = 3\n', [], 'plan.branch must be at most 2, not 3'),
    ('\n[plan]\nforce = 1.0\n', [], "plan has no key 'force'; did you mean 'force_N'?"),
])
def test_bad_plans_are_refused_with_words(tmp_path, capsys, extra, arguments, message):
    from magphonon.cli.main import main

    assert main(['plan', str(scene_file(tmp_path, 'chain', extra)), *arguments]) == 2
    assert message in capsys.readouterr().err


def test_an_edge_at_zero_frequency_and_a_burst_that_scatters_the_lattice_are_refused(tmp_path, capsys):
    from magphonon.cli.main import main

    text = ready_scene('ideal').read_text(encoding='utf-8')
    (tmp_path / 'scene.toml').write_text(text + '\n[plan]\nedge = "G"\n')
    assert main(['plan', str(tmp_path / 'scene.toml')]) == 2
    assert 'Frequency of branch 1 at G is zero or imaginary' in capsys.readouterr().err
    text = text.replace('force_N = 1.0', 'force_N = 1e12').replace('= 60 ', '= 10 ')
    (tmp_path / 'scene.toml').write_text(text)
    assert main(['plan', str(tmp_path / 'scene.toml')]) == 2
    assert 'there is nothing to plan' in capsys.readouterr().err


def test_a_scene_that_asks_for_nothing_is_refused(tmp_path, capsys):
    from magphonon.cli.main import main

    text = ready_scene('chain').read_text(encoding='utf-8')
    (tmp_path / 'scene.toml').write_text(text[:text.index('[bands]')])
    assert main(['plan', str(tmp_path / 'scene.toml')]) == 2
    assert 'has nothing to plan; add a table [bands], [frf] or [burst]' in capsys.readouterr().err
