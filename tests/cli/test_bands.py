"""`magphonon bands`: it fails where phonopy and D0 + D* disagree."""

import pytest

from magphonon.cli.main import main

SCENE = """title = "A net"
lattice = {{kind = "triangular", spacing_m = 0.01, mass_kg = 0.001}}
law = {{kind = "{kind}", stiffness_N_per_m = 20.0, rest_length_m = {rest!r}}}
foundation = {{stiffness_N_per_m = 10.0}}
"""


@pytest.mark.parametrize(('kind', 'rest', 'status'), [
    ('spring', 0.01, 0), ('spring', 0.0100000000001, 0), ('spring', 0.0105, 0), ('spring', 0.012, 0), ('cable', 0.0099, 0),
    ('cable', 0.01 * (1 - 1e-11), 1)])  # it goes slack within any displacement
def test_bands_fails_where_the_two_roads_disagree(kind, rest, status, tmp_path, capsys):
    (tmp_path / 'net.toml').write_text(SCENE.format(kind=kind, rest=rest))
    assert main(['bands', str(tmp_path / 'net.toml'), '-o', str(tmp_path / 'out')]) == status
    assert ('disagree' in capsys.readouterr().out) == bool(status)


@pytest.mark.parametrize('shells', ['1', '"all"'])
def test_interpolation_between_wavevectors_is_no_disagreement(shells, scene_file, tmp_path):
    assert main(['bands', str(scene_file({'shells = 1': f'shells = {shells}'})), '-o', str(tmp_path / 'out')]) == 0
