"""The table [foundation.out_of_plane]: supports along z."""

import pytest
from scene_files import ready_scene

from magphonon import read_scene, verdict
from magphonon.cli.main import main
from magphonon.interactions import UprightMagnets

SCENE = '''title = "layer"
[lattice]
kind = "{kind}"
spacing_m = 0.01
mass_kg = 7e-4
[law]
kind = "inverse_power"
b_N_m_a = 1e-8
a = 4.0
shells = 1
[foundation]
stiffness_N_per_m = 20
[foundation.out_of_plane]
stiffness_N_per_m = {support}
upright_magnets = {upright}
'''

BURST = '''
[patch]
kind = "hexagon"
side_m = 0.08
[burst]
source = "point"
carriers_Hz = [30]
directions_deg = [90]
cycles = 5
force_N = 1e-6
damping_ratio = 0.01
duration_s = 0.5
'''


def scene_of(tmp_path, more='', kind='triangular', support=500, upright='false'):
    path = tmp_path / 'layer.toml'
    path.write_text(SCENE.format(kind=kind, support=support, upright=upright) + more)
    return read_scene(path)


@pytest.mark.parametrize(('upright', 'factor'), [('false', 1.0), ('true', 3.0)])
def test_supports_enter_in_N_per_m_and_hold_from_nine_bonds_of_dstar_on(tmp_path, upright, factor):
    force = 1e-8 * 0.01**-4  # N; a bond of the law 1/r^4 pushes out of the plane with f/L, upright dipoles with 3 f/L
    needed = factor * 9 * force / 0.01
    for support, stable in ((1.001 * needed, True), (0.999 * needed, False)):
        atoms = scene_of(tmp_path, support=support, upright=upright).atoms()
        assert atoms.calc.foundation[0] == pytest.approx([0.02, 0.02, support / 1000])
        assert isinstance(atoms.calc.laws, UprightMagnets) == (upright == 'true')
        assert verdict(atoms).stable == stable


def test_a_patch_moves_out_of_the_plane_too(tmp_path):
    scene = scene_of(tmp_path, '[patch]\nkind = "hexagon"\nside_m = 0.03\n')
    patch = scene.patch_atoms()
    assert patch.calc.layer
    assert patch.calc.foundation.shape == (len(patch), 3)
    assert verdict(patch)['out_of_plane'].spring == pytest.approx(0.5)


@pytest.mark.parametrize(('kind', 'more', 'words'), [
    ('fcc', '', 'fcc has no plane'),
    ('triangular', BURST, 'cannot be computed out of the plane'),
])
def test_what_cannot_be_computed_out_of_the_plane_is_refused(tmp_path, kind, more, words):
    with pytest.raises(ValueError, match=words):
        scene_of(tmp_path, more, kind)


def test_the_report_of_modes_names_the_branch_out_of_the_plane(tmp_path, capsys):
    assert main(['modes', '--verbose', str(ready_scene('layer')), '-o', str(tmp_path / 'out')]) == 0
    rows = [line for line in capsys.readouterr().out.splitlines() if line.startswith('  M, branch')]
    assert [row.endswith('out of the plane') for row in rows] == [False, False, True]
