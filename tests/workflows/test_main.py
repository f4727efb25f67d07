"""The main job: its table, its exit status, its report."""

import json

import pytest

from workflows.__main__ import NAMES, main
from workflows.checks import Check


def test_every_workflow_passes_and_writes_its_report(tmp_path, capsys):
    assert main(['-o', str(tmp_path)]) == 0
    summary = json.loads((tmp_path / 'summary.json').read_text())
    assert tuple(summary) == NAMES
    assert all(row['passed'] for rows in summary.values() for row in rows)
    assert any(row['control'] for row in summary['two_roads'])
    html = (tmp_path / 'report.html').read_text()
    assert html.count('data:image/png;base64,') == len(list(tmp_path.glob('*.png')))
    assert 'FAIL' not in capsys.readouterr().out


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
