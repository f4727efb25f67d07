"""`magphonon design` of every site: its folder, where it was stopped, and scenes that it cannot take."""

import csv
import re

import numpy as np
import pytest

from magphonon import read_scene, ready_scene
from magphonon.cli.main import main

TARGET = '[[design.targets]]'


def small(tmp_path, **replaced):
    """The ready demultiplexer on a small patch, with few neighbours, steps and draws."""
    text = re.sub('    # chosen$', '', ready_scene('demultiplexer').read_text(encoding='utf-8'), flags=re.MULTILINE)
    for old, new in {'side_m = 0.06': 'side_m = 0.03', 'shells = 9 ': 'shells = 2 ', 'draws = 4': 'draws = 2',
                     'points = 241': 'points = 5', '[-0.04, 0.0]': '[-0.02, 0.0]', '0.03464': '0.01732', '[0.03, ': '[0.01, ',
                     f'{TARGET}         # chosen': f'[design]\nsteps = 2\n{TARGET}  # chosen', **replaced}.items():
        assert old in text
        text = text.replace(old, new)
    file = tmp_path / 'my.toml'
    file.write_text(text, encoding='utf-8')
    return file


@pytest.mark.slow
def test_it_leaves_a_build_list_and_goes_on_from_it(tmp_path, capsys):
    file, out = small(tmp_path), tmp_path / 'out'
    assert main(['design', str(file), '-o', str(out)]) == 0
    told = capsys.readouterr().out
    assert 'a design with D0 alone promises' in told
    assert 'copies out of 60 that reach 30 dB' in told
    names = {path.name for path in out.iterdir()}
    assert names >= {'design.csv', 'design.npy', 'design.png', 'design_levels.png', 'design_convergence.png',
                     'design_tolerances.png', 'design_60Hz.gif', 'design_80Hz.gif'}
    rows = list(csv.DictReader((out / 'design.csv').read_text(encoding='utf-8').splitlines()))
    assert {row['part_strength'] for row in rows if row['held'] == '0'} <= set('12345')
    assert {'part_spring', 'tolerance_strength', 'tolerance_spring'} <= set(rows[0])
    parameters = np.load(out / 'design.npy')
    assert main(['design', str(file), '--resume', '-o', str(out)]) == 0
    assert 'this design, from each start' in capsys.readouterr().out
    assert len(np.load(out / 'design.npy')) == len(parameters)


def test_targets_are_an_objective(tmp_path):
    scene = read_scene(small(tmp_path))
    patch, source, objective, robust = scene.design.sites(scene)
    levels = [[part for _, part in one.parts] for one in objective.of]
    assert [[round(part.omega / (2 * np.pi) * 1e3) for part in both] for both in levels] == [[60, 60], [80, 80]]
    assert levels[0][0].seen.particle == levels[1][1].seen.particle != levels[0][1].seen.particle
    np.testing.assert_allclose(patch.positions[source.particle, :2] - patch.positions.mean(0)[:2], [-20, 0], atol=1e-9)
    assert robust.scatter.strength == pytest.approx(0.01)
    assert scene.design.over.bounds()['strength'] == (0.86, 1.14)


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('[design.over]', '[design.out]', 'has no key'),
    ('strength = [0.86, 1.14]\nspring = [0.8145, 1.2156]', '', r'\[design.over\] with a range'),
    ('strength = [0.86, 1.14]', 'strength = [1.14, 0.86]', 'must be a range'),
    ('[frf.force]', '[frf.wall]', 'frf'),
])
def test_scenes_that_are_refused(tmp_path, old, new, words):
    with pytest.raises(ValueError, match=words):
        read_scene(small(tmp_path, **{old: new}))


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('[0.01, 0.01732], direction_deg = 0.0}\nquiet', '[0.03, 0.0], direction_deg = 0.0}\nquiet', 'is on the held rim'),
    ('[0.01, 0.01732], direction_deg = 0.0}\nquiet', '[0.3, 0.0], direction_deg = 0.0}\nquiet', 'is outside the patch'),
])
def test_places_that_are_refused(tmp_path, old, new, words):
    scene = read_scene(small(tmp_path, **{old: new}))
    with pytest.raises(ValueError, match=f'design.targets or frf.force: .*{words}'):
        scene.design.sites(scene)


def test_nothing_to_go_on_from(tmp_path, capsys):
    assert main(['design', str(small(tmp_path)), '--resume', '-o', str(tmp_path / 'out')]) == 2
    assert 'cannot be read' in capsys.readouterr().err
