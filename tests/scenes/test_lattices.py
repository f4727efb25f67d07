"""The table [patch]: what is cut, and what is refused."""

import re

import numpy as np
import pytest
from scene_files import ready_scene

from magphonon import lattices, read_scene, units as u
from magphonon.lattices.patches import RIM

L0 = 10 * u.mm
SHAPES = {  # as the scene says it, and as the library cuts it
    'kind = "parallelogram"\ncells_1 = 8\ncells_2 = 7': lambda cell: lattices.parallelogram(cell, 8, 7),
    'kind = "rectangle"\nwidth_m = 0.1\nheight_m = 0.07': lambda cell: lattices.rectangle(cell, 100 * u.mm, 70 * u.mm),
    'kind = "hexagon"\nside_m = 0.05': lambda cell: lattices.hexagon(cell, 50 * u.mm),
    'kind = "half_hexagon"\nside_m = 0.07': lambda cell: lattices.half_hexagon(cell, 70 * u.mm),
}


@pytest.fixture
def scene_with(tmp_path):
    """A function from the text of a table [patch] to a ready scene with it instead of its own."""
    def scene(table, name='bench', old='', new=''):
        text = re.sub(r'\[patch\].*?\n\n', '', ready_scene(name).read_text(), flags=re.DOTALL).replace(old, new)
        file = tmp_path / 'my.toml'
        file.write_text(f'{text}\n[patch]\n{table}\n' if table else text)
        return read_scene(file)
    return scene


@pytest.mark.parametrize('table', SHAPES)
@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_every_shape(table, model, scene_with):
    scene = scene_with(table)
    patch, cut = scene.patch_atoms(model), SHAPES[table](lattices.triangular(L0, 0.707))
    np.testing.assert_allclose(patch.positions, cut.positions, rtol=1e-14, atol=1e-12 * L0)
    assert patch.calc.parameters.model == model
    assert patch.calc.parameters.foundation == scene.foundation.stiffness
    inside = patch.get_tags() != RIM
    # full shells balance; the rim pushes outwards with a force of the order of f(L0) = 0.24 N
    assert abs(patch.get_forces(apply_constraint=False)[inside]).max() < 1e-12
    assert abs(patch.get_forces(apply_constraint=False)[~inside]).max() > 0.1


@pytest.mark.parametrize(('arguments', 'message'), [
    (('', 'chain'), r'has no table \[patch\]; add one'),
    (('kind = "hexagon"\nside_m = 300',), r'the patch of 2.7e\+09 cells is too large .* check its unit'),
    (('kind = "half_hexagon"\nside_m = 0.01',), 'none of them inside its rim; make it larger'),
    (('kind = "hexagon"\nside_m = 3e-5', 'wigner'), "law.shells = 'all': the force reaches so far"),
    (('kind = "hexagon"\nside_m = 5', 'chain'), 'cut from a planar cell'),
])
def test_patches_that_cannot_be_cut_are_refused_when_they_are_wanted(arguments, message, scene_with):
    scene = scene_with(*arguments)
    assert len(scene.atoms()) == 1
    with pytest.raises(ValueError, match=message):
        scene.patch_atoms()
