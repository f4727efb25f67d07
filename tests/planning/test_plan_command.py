"""Plans of scenes, and the command that prints and runs them."""

import numpy as np
import pytest
from scene_files import ready_scene

from magphonon.response import propagation
from magphonon.scenes.scene import read_scene


def scene_file(folder, name, extra):
    file = folder / 'scene.toml'
    file.write_text(ready_scene(name).read_text(encoding='utf-8') + extra, encoding='utf-8')
    return file


@pytest.mark.parametrize(('name', 'extra', 'files'), [
    ('oscillator', '', ['plan_frf.csv', 'plan_frf.npz', 'provenance.json', 'scene.toml']),
])
def test_command_runs_what_it_chose(tmp_path, capsys, name, extra, files):
    from magphonon.cli.main import main

    scene = scene_file(tmp_path, name, extra)
    assert main(['plan', '--verbose', str(scene), '--tolerance', '1e-3', '--run', '-o', str(tmp_path / 'out')]) == 0
    assert sorted(file.name for file in (tmp_path / 'out').iterdir()) == files
    text = capsys.readouterr().out
    assert '<- recommended' in text
    assert text.startswith('Frequency of the highest peak: the complete linear model is enough (a closed form); its error '
                           'is at most 0.0012 %.')
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
    assert main(['plan', '--verbose', str(scene), '--tolerance', '1e-5', '--run', '-o', str(tmp_path / 'out')]) == 0
    assert ': the nonlinear model is enough (' in capsys.readouterr().out
    rows = np.loadtxt(tmp_path / 'out' / 'plan_frf.csv', delimiter=',', skiprows=1)
    assert rows[:, 0] == pytest.approx([32, 33, 34, 35, 36])
    assert rows[:, 1].argmax() == 2  # 33.76 Hz


def test_a_burst_is_propagated_exactly(tmp_path, monkeypatch, capsys):
    import magphonon.planning.waveform  # noqa: F401  before the patch, so that the plan's own solutions are not counted
    from magphonon.cli.main import main

    text = ready_scene('ideal').read_text(encoding='utf-8')
    text = text.replace('cells_1 = 60', 'cells_1 = 12').replace('cells_2 = 60', 'cells_2 = 12')
    (tmp_path / 'scene.toml').write_text(text[:text.index('[bands]')] if text.index('[bands]') > text.index('[burst]') else text)
    called = []
    real = propagation.propagate
    monkeypatch.setattr('magphonon.response.propagation.propagate', lambda *a, **k: called.append(a) or real(*a, **k))
    command = ['plan', str(tmp_path / 'scene.toml'), '--tolerance', '2e-2', '--run', '-o', str(tmp_path / 'out')]
    assert main(command) == 0
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
    ('\n[plan]\nedge = "X"\n', [], "plan has no key 'edge'"),
    ('\n[plan]\nforce = 1.0\n', [], "plan has no key 'force'; did you mean 'force_N'?"),
])
def test_bad_plans_are_refused_with_words(tmp_path, capsys, extra, arguments, message):
    from magphonon.cli.main import main

    assert main(['plan', '--verbose', str(scene_file(tmp_path, 'chain', extra)), *arguments]) == 2
    assert message in capsys.readouterr().err


def test_a_burst_that_scatters_the_lattice_is_refused(tmp_path, capsys, monkeypatch):
    from magphonon.cli.main import main

    monkeypatch.setattr('magphonon.dynamics.verlet.COMPILING_PAYS', float('inf'))  # steps of laws in pieces take long to compile
    text = ready_scene('ideal').read_text(encoding='utf-8')
    text = text.replace('force_N = 1.0', 'force_N = 1e12').replace('= 60 ', '= 10 ')
    (tmp_path / 'scene.toml').write_text(text)
    assert main(['plan', '--verbose', str(tmp_path / 'scene.toml')]) == 2
    assert 'there is nothing to plan' in capsys.readouterr().err


def test_a_scene_that_asks_for_nothing_is_refused(tmp_path, capsys):
    from magphonon.cli.main import main

    text = ready_scene('chain').read_text(encoding='utf-8')
    (tmp_path / 'scene.toml').write_text(text)
    assert main(['plan', '--verbose', str(tmp_path / 'scene.toml')]) == 2
    assert 'has nothing to plan; add a table [frf] or [burst] (bands need no plan' in capsys.readouterr().err
