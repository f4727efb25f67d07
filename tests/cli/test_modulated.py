"""The scene `modulated`: what its commands print and write, and what a modulation refuses beside it."""

import csv
import tomllib

import numpy as np
import pytest

from magphonon import ready_scene
from magphonon.cli.main import main
from magphonon.scenes.scene import scene_of

TABLES = tomllib.loads(ready_scene('modulated').read_text(encoding='utf-8'))


def with_tables(**changed):
    return scene_of(TABLES | changed)


def test_bands_open_on_one_side(tmp_path, capsys):
    file = tmp_path / 'm.toml'
    file.write_text(ready_scene('modulated').read_text(encoding='utf-8').replace('points = 200', 'points = 9'), encoding='utf-8')
    assert main(['bands', '--verbose', str(file), '-o', str(tmp_path / 'out')]) == 0
    said = capsys.readouterr().out
    assert 'complete: no wave grows' in said
    assert 'Waves grow in narrow ranges' in said  # and they are narrower than the steps of a path
    rows = [*csv.reader((tmp_path / 'out' / 'bands.csv').read_text(encoding='utf-8').splitlines())]
    names, values = rows[0], np.array(rows[1:], float)
    shear = values[:, names.index('complete_1_Hz')]
    assert abs(shear - shear[::-1]).max() > 1  # waves there and back differ
    assert (tmp_path / 'out' / 'bands.png').exists()


@pytest.mark.slow
def test_check_judges_growth(tmp_path, capsys):
    foundation = TABLES['foundation'] | {'modulation': {'depth': 0.2, 'frequency_Hz': 90.5}}
    text = ready_scene('modulated').read_text(encoding='utf-8')
    head = text[: text.index('[foundation.modulation]')]
    for damping, problem in ((0.0, 1), (20.0, 0)):
        file = tmp_path / f'm{problem}.toml'
        tail = '[foundation.modulation]\ndepth = 0.2\nfrequency_Hz = 90.5\n\n[bands]\npath = "GM"\n'
        file.write_text(head + tail + (f'damping_per_s = {damping}\n' if damping else ''), encoding='utf-8')
        assert main(['check', '--verbose', str(file)]) == problem
        assert ('makes waves grow' in capsys.readouterr().out) == bool(problem)
    assert scene_of(TABLES | {'foundation': foundation}).perfect_cell().calc.parameters.foundation.kap == (0, 0, 0)


@pytest.mark.parametrize('table', [{'frf': {'from_Hz': 20.0, 'to_Hz': 70.0, 'points': 5, 'damping_per_s': 4.0}},
                                   {'disorder': {'seed': 1, 'mass_percent': 1.0}}])
def test_what_supposes_constant_springs_is_refused(table):
    with pytest.raises(ValueError, match=r'foundation\.modulation|frf|disorder'):
        with_tables(patch={'kind': 'hexagon', 'side_m': 0.05}, **table)
