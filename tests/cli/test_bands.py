"""`magphonon bands`: it fails where phonopy and D0 + D* disagree."""

import pytest

from magphonon import lattices
from magphonon.cli.main import main
from magphonon.interactions import Cable, Spring
from magphonon.scenes import write_scene
from magphonon.stiffness import PairCalculator


@pytest.mark.parametrize(('law', 'rest', 'status'), [
    (Spring, 10.0, 0), (Spring, 10.0000000001, 0), (Spring, 10.5, 0), (Spring, 12.0, 0), (Cable, 9.9, 0),
    (Cable, 10 * (1 - 1e-11), 1)])  # it goes slack within any displacement
def test_bands_fails_where_the_two_roads_disagree(law, rest, status, tmp_path, capsys):
    net = lattices.triangular(10.0, 1.0)
    net.calc = PairCalculator(net, law(0.02, rest), foundation=0.01)
    write_scene(net, tmp_path / 'net.toml')
    assert main(['bands', str(tmp_path / 'net.toml'), '-o', str(tmp_path / 'out')]) == status
    assert ('disagree' in capsys.readouterr().out) == bool(status)


@pytest.mark.parametrize('shells', ['1', '"all"'])
def test_interpolation_between_wavevectors_is_no_disagreement(shells, scene_file, tmp_path):
    assert main(['bands', str(scene_file({'shells = 1': f'shells = {shells}'})), '-o', str(tmp_path / 'out')]) == 0
