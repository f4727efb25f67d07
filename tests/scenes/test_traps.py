"""[trap]: one anchor for all particles, whose modes of the centre and of breathing are known for any number of ions."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene

from magphonon import modes, read_scene, units as u

MASS = 1.4965e-26  # kg


def trapped(tmp_path, old='', new=''):
    text = ready_scene('penning').read_text(encoding='utf-8')
    assert old in text
    (tmp_path / 'penning.csv').write_bytes(ready_scene('penning').with_suffix('.csv').read_bytes())
    (tmp_path / 'own.toml').write_text(text.replace(old, new), encoding='utf-8')
    return read_scene(tmp_path / 'own.toml')


def test_modes_of_a_round_trap_are_those_of_its_closed_forms(tmp_path):
    k, g = 6e-13 / MASS, 4e7  # 1/s^2, rad/s
    atoms = trapped(tmp_path, 'stiffness_y_N_per_m = 9e-13', 'stiffness_y_N_per_m = 6e-13').atoms()
    found = modes(atoms).omega * u.s  # rad/s
    known = (np.sqrt(g**2 + 4 * k) - g) / 2, (np.sqrt(g**2 + 4 * k) + g) / 2, np.sqrt(3 * k + g**2)  # centre twice, breathing
    for exact in known:
        assert abs(found - exact).min() < 1e-8 * g
    assert abs(found).min() < 1e-6 * g  # nothing holds it against turning
    atoms.calc = atoms.calc.about(atoms, model='conventional')
    assert abs(modes(atoms).omega * u.s - known[2]).min() > 1e-3 * abs(known[2] - g)  # the control: D0 alone breathes otherwise
    assert_allclose(atoms.positions.mean(axis=0), 0, atol=1e-9)


def test_the_centre_is_where_the_scene_says(tmp_path):
    atoms = trapped(tmp_path, '[trap]', '[trap]\ncentre_m = [1e-5, -2e-5]').atoms()
    assert_allclose(atoms.positions.mean(axis=0), [0.01, -0.02, 0], atol=1e-9)


@pytest.mark.parametrize(('old', 'new'), [
    ('[trap]', '[foundation]\nstiffness_N_per_m = 1e-12\n\n[trap]'),
    ('mass_kg', 'cell_m = [[5e-5, 0.0], [0.0, 5e-5]]\nmass_kg'),
])
def test_a_trap_is_for_a_finite_structure_without_foundation(old, new, tmp_path):
    with pytest.raises(ValueError, match='trap: a trap needs a finite structure from a file'):
        trapped(tmp_path, old, new)


def test_a_trap_in_space_is_refused_in_words_of_the_trap(tmp_path):
    (tmp_path / 'three.csv').write_text('x_m,y_m,z_m\n0,0,0\n1e-5,0,0\n0,1e-5,1e-5\n')
    with pytest.raises(ValueError, match='trap: it acts in a plane, but the particles of the file stand at different heights'):
        trapped(tmp_path, 'penning.csv', 'three.csv').atoms()
