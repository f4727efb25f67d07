"""The main job: its table, its exit status, its report."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import workflows
from workflows import frf, rows, stability, vibrometer
from workflows.__main__ import NAMES, main
from workflows.rows import Check


@pytest.fixture
def small(monkeypatch):
    """Pictures of few pixels, and fewer points or bursts than the job has, in rows of the same kind with the same bounds."""
    monkeypatch.setattr(rows, 'DPI', 20)
    monkeypatch.setattr(frf, 'OMEGA', frf.OMEGA[::3])
    monkeypatch.setattr(stability, 'EXPONENTS', stability.EXPONENTS[::2])  # the corner at 3 among them
    read = vibrometer.read_scene

    def two_bursts(file):
        """Of four: the lowest carrier, where two lines of the zone are as fast, and the highest, where they are not."""
        scene = read(file)
        ends = {key: getattr(scene.burst, key)[::3] for key in ('carriers_Hz', 'directions_deg')}
        return scene.model_copy(update={'burst': scene.burst.model_copy(update=ends)})

    monkeypatch.setattr(vibrometer, 'read_scene', two_bursts)


@pytest.mark.slow
@pytest.mark.usefixtures('small')
@pytest.mark.parametrize('name', NAMES)
def test_every_number_of_a_workflow_passes(tmp_path, name):
    status = main([name, '--quick', '-o', str(tmp_path)])
    rows = json.loads((tmp_path / 'summary.json').read_text())[name]
    assert [row for row in rows if not row['passed']] == []
    assert rows
    assert status == 0


@pytest.mark.slow
def test_the_command_itself(tmp_path):
    done = subprocess.run([sys.executable, '-m', 'workflows', 'prototype_bands', 'chain', '-o', str(tmp_path)], check=True,
                          cwd=Path(workflows.__file__).parents[1], capture_output=True, text=True)
    assert '0 rows fail' in done.stdout
    assert list(json.loads((tmp_path / 'summary.json').read_text())) == ['prototype_bands', 'chain']
    drawn = {file.stem for file in tmp_path.glob('*.png')}
    assert (tmp_path / 'report.html').read_text().count('data:image/png;base64,') == len(drawn) > 0
    assert {file.stem for file in tmp_path.glob('*.pdf')} == drawn


def test_a_wrong_reference_fails_the_run(tmp_path, monkeypatch, capsys):
    from workflows import chain

    right = chain.reference_growth
    monkeypatch.setattr(chain, 'reference_growth', lambda law, L0, m: 1.001 * right(law, L0, m))
    assert main(['chain', '-o', str(tmp_path)]) == 1
    assert 'FAIL' in capsys.readouterr().out


def test_unknown_workflow_and_unusable_directory_are_refused(tmp_path, capsys):
    with pytest.raises(SystemExit):
        main(['no_such', '-o', str(tmp_path)])
    assert "'no_such'" in capsys.readouterr().err
    (tmp_path / 'file').write_text('')
    with pytest.raises(SystemExit):
        main(['chain', '-o', str(tmp_path / 'file')])
    assert 'name another directory' in capsys.readouterr().err


@pytest.mark.parametrize(('here', 'control', 'passed'), [
    (1.0, False, True), (1.2, False, False), (float('nan'), False, False),
    (1.2, True, True), (1.0, True, False), (float('nan'), True, False),
])
def test_a_check_passes_inside_its_tolerance_and_a_control_outside(here, control, passed):
    assert Check('x', here, 1.0, 0.1, control).passed is passed
