"""Magnets in scenes: by grade and by remanence; mistakes are named."""

import pytest

from magphonon import units as u
from magphonon.interactions.magnets import Cuboid, Ring
from magphonon.scenes.scene import read_scene, ready_scene

RING = Ring(6.35, 1.5875, 3.175, 1.3 * u.T)


# --- scenes ---

SCENE = ready_scene('rings').read_text()


def write(folder, *changes):
    text = SCENE
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    (folder / 'scene.toml').write_text(text)
    return folder / 'scene.toml'


RING_TABLE = SCENE[SCENE.index('[law.ring]'):SCENE.index('[foundation.pillar]')]


def test_a_scene_of_magnets_by_grade_and_by_remanence(tmp_path):
    law = read_scene(write(tmp_path)).law
    assert law.magnet() == RING
    assert read_scene(write(tmp_path, ('remanence_T = 1.30', 'grade = "N42"'))).law.potential() == law.potential()


@pytest.mark.parametrize(('table', 'magnet'), [
    ('[law.ring]\nouter_diameter_m = 6e-3\nheight_m = 2e-3', Ring(6, 0, 2, 1.3 * u.T)),
    ('[law.cuboid]\nlength_m = 4e-3\nwidth_m = 5e-3\nheight_m = 6e-3', Cuboid(4, 5, 6, 1.3 * u.T)),
])
def test_scenes_of_other_shapes(tmp_path, table, magnet):
    scene = read_scene(write(tmp_path, (RING_TABLE, table + '\n')))
    assert scene.law.magnet() == magnet
    assert scene.atoms().calc.laws.dphi(10.0) < 0


@pytest.mark.parametrize(('changes', 'message'), [
    ([('remanence_T = 1.30', 'grade = "N99"')], "law.grade must be one of 'N30'"),
    ([('remanence_T = 1.30', '')], 'law has neither of grade and remanence_T'),
    ([('remanence_T = 1.30', 'remanence_T = 1.30\ngrade = "N42"')], 'law has both of grade and remanence_T'),
    ([(RING_TABLE, '')], r'law has no shape; give one of \[law.ring\], \[law.cuboid\]'),
    ([('inner_diameter_m = 1.5875e-3', 'inner_diameter_m = 7e-3')], 'inner must be less than outer = 6.35 mm, not 7'),
    ([('spacing_m = 0.01', 'spacing_m = 0.0065')], '6.5 mm apart are too close'),
])
def test_mistakes_in_a_scene_of_magnets_are_named(tmp_path, changes, message):
    with pytest.raises(ValueError, match=message):
        read_scene(write(tmp_path, *changes))
