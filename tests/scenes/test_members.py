"""[[members]]: nets of springs and cables in a scene, whose tensions follow from balance."""

import re

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import analytic_bands, modes, read_scene, units as u
from magphonon.cli.main import main
from magphonon.scenes import ready_scene

GRID = """title = "A net of one node"
[lattice]
kind = "file"
file = "node.csv"
mass_kg = 0.002
cell_m = [[0.1, 0.0], [0.0, 0.1]]
[law]
kind = "members"
[[members]]
between = [[0, 0, 1, 0], [0, 0, 0, 1]]
stiffness_N_per_m = 300
tension_N = 5
"""


def grid(folder, old='', new=''):
    assert old in GRID
    (folder / 'node.csv').write_text('x_m,y_m\n0,0\n')
    (folder / 'grid.toml').write_text(GRID.replace(old, new))
    return folder / 'grid.toml'


def prism(folder, old='', new=''):
    text = ready_scene('prism').read_text(encoding='utf-8')
    assert old in text
    (folder / 'prism.csv').write_bytes(ready_scene('prism').with_suffix('.csv').read_bytes())
    (folder / 'own.toml').write_text(text.replace(old, new), encoding='utf-8')
    return folder / 'own.toml'


def test_tensions_per_length_of_the_prism_are_those_of_its_closed_form():
    calc = read_scene('prism').atoms().calc
    lengths = calc.bonds.lengths
    flat = 50 / (0.1 * np.sqrt(3)) * u.N / u.m  # 50 N in a triangle about a circle of 0.1 m
    # Connelly and Terrell 1995: +-sqrt(3) of that of the triangles
    assert_allclose(calc.law.dphi(lengths) / lengths, flat * np.repeat([1, np.sqrt(3), -np.sqrt(3)], [6, 3, 3]), rtol=1e-9)


def test_self_stress_leaves_the_prism_the_six_motions_of_a_body_and_D0_one_more(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['modes', 'prism']) == 0
    assert 'modes that cost no energy: 6; with D0 alone there would be 7' in capsys.readouterr().out
    assert main(['check', '--verbose', 'prism']) == 0
    assert 'OK' in (said := capsys.readouterr().out)
    assert 'magnet' not in said
    lax = read_scene(prism(tmp_path, 'tension_N = 50 ', 'rest_length_m = 0.173 ')).atoms()  # the control: less tension
    assert 0 < modes(lax).omega[6] < 0.99 * modes(read_scene('prism').atoms()).omega[6]


def test_bands_of_a_periodic_net_are_those_of_strings_and_springs(tmp_path):
    cell = read_scene(grid(tmp_path)).atoms()
    squares = analytic_bands(cell, [[0.5, 0, 0], [0, 0.5, 0]]).omega ** 2 / (u.N / u.m / u.kg)
    assert_allclose(squares, [[4 * 5 / 0.1 / 0.002, 4 * 300 / 0.002]] * 2, rtol=1e-12)


@pytest.mark.parametrize('taut', [True, False])
def test_a_flat_net_says_what_it_would_do_out_of_its_plane(taut, tmp_path, capsys, monkeypatch):
    """A membrane of 5 by 5 nodes: omega^2 = 4 T/(m a) (sin^2 pi/8 + sin^2 pi/8) with the tension T; slack, nothing holds it."""
    monkeypatch.chdir(tmp_path)
    rows = [f'{x / 10},{y / 10},{int({x, y} & {0, 4} != set())}' for x in range(5) for y in range(5)]
    (tmp_path / 'net.csv').write_text('x_m,y_m,held\n' + '\n'.join(rows) + '\n')
    pairs = [[5 * x + y, 5 * x + y + 5] for x in range(4) for y in range(5)] + [
        [5 * x + y, 5 * x + y + 1] for x in range(5) for y in range(4)]
    text = f'''title = "x"
lattice = {{kind = "file", file = "net.csv", mass_kg = 0.001}}
law = {{kind = "members"}}
[[members]]
between = {pairs}
stiffness_N_per_m = 10000
slack = true
rest_length_m = {0.099 if taut else 0.101}
'''
    (tmp_path / 'net.toml').write_text(text)
    f = np.sqrt(4 * 10 / (0.001 * 0.1) * 2) * np.sin(np.pi / 8) / (2 * np.pi)
    assert main(['check', 'net.toml']) == int(not taut)
    said = capsys.readouterr().out
    assert (f'motion along z, whose lowest frequency would be {f:.6g} Hz' in said) == taut
    assert ('It is slack in the plane: 18 motions cost no energy, which 40 slack members would resist' in said) == (not taut)
    if taut:
        assert main(['modes', 'net.toml', '-o', 'out']) == 0
        assert f'would be {f:.6g} Hz' in capsys.readouterr().out
        (tmp_path / 'net.toml').write_text(text.replace('[[members]]', """foundation.stiffness_N_per_m = 0
foundation.out_of_plane = {stiffness_N_per_m = 0, upright_magnets = false}
[[members]]"""))
        assert modes(read_scene('net.toml').atoms()).frequencies_Hz[0] == pytest.approx(f, rel=1e-12)
        assert main(['check', 'net.toml']) == 0


def test_bands_that_are_all_zero_are_refused_with_the_cause(tmp_path, capsys):
    scene = grid(tmp_path, 'tension_N = 5', 'slack = true\nrest_length_m = 0.11')
    assert main(['bands', str(scene), '-o', str(tmp_path / 'out')]) == 2
    assert 'all bands are zero: It is slack in the plane: 2 motions cost no energy, which 2 slack' in capsys.readouterr().err


def test_rest_lengths_move_nodes_to_where_they_balance(tmp_path):
    (tmp_path / 'three.csv').write_text('x_m,y_m,held\n0,0,1\n0.11,0.0,0\n0.2,0,1\n')
    scene = prism(tmp_path, 'slack = true', 'slack = false')
    text = scene.read_text().replace('prism.csv"', 'three.csv"\npositions = "anchors"').partition('[[members]]')[0]
    for pair, k in (([0, 1], 100), ([1, 2], 300)):
        text += f'[[members]]\nbetween = [{pair}]\nstiffness_N_per_m = {k}\nrest_length_m = 0.08\n'
    scene.write_text(text)
    x = read_scene(scene).atoms().positions[1, 0] / u.m
    assert_allclose(100 * (x - 0.08), 300 * (0.12 - x), rtol=1e-9)


@pytest.mark.filterwarnings('ignore:a mass of')
@pytest.mark.parametrize(('make', 'old', 'new', 'said'), [
    (prism, 'kind = "members"', 'kind = "dipoles"\nmoment_A_m2 = 1.0', 'give both or neither'),
    (prism, 'tension_N = 50', 'tension_N = 5e4', 'stretches a member of stiffness_N_per_m = 10000.0 by more than its length'),
    (prism, 'tension_N = 50 ', '', 'have 1 states of self-stress; give tension_N or rest_length_m of 1 more'),
    (prism, '[1, 2], [2, 0], ', '', 'the other members cannot balance the given tensions'),
    (prism, 'stiffness_N_per_m = 1e5', 'stiffness_N_per_m = 1e5\ntension_N = -50', 'cannot balance the given tensions'),
    (prism, 'stiffness_N_per_m = 1e5', 'slack = true\nstiffness_N_per_m = 1e5',
     'from 0 to 4 would push with 114 N'),  # 50 N/0.1 m of 0.228 m
    (prism, 'tension_N = 50', 'tension_N = -50', 'the cable from 0 to 1 would push with 50 N'),
    (prism, 'stiffness_N_per_m = 1e5 ', '', "lacks the key 'stiffness_N_per_m'"),
    (prism, 'tension_N = 50 ', 'tension_N = 50\nrest_length_m = 0.1 ', 'both rest_length_m and tension_N'),
    (prism, '[2, 0], [3, 4]', '[2, 6], [3, 4]', 'names a particle outside 0 to 5'),
    (prism, '[2, 0], [3, 4]', '[2], [3, 4]', r'must be two nodes, as \[0, 1\]'),
    (prism, 'mass_kg', 'cutoff_m = 0.2\nmass_kg', 'says which particles interact; remove it'),
    (grid, ', [0, 0, 0, 1]]', ']\nstiffness_N_per_m = 1.0\nrest_length_m = 0.1\n[[members]]\n'
     'between = [[0, 0, 0, 1]]', 'two members of different laws join the nodes 0 and 0'),
    (grid, 'mass_kg = 0.002', 'mass_kg = 2e-30', 'frequencies of about'),
])
def test_members_that_do_not_make_a_net_are_refused_with_a_way_out(make, old, new, said, tmp_path):
    with pytest.raises(ValueError, match=said) as caught:
        read_scene(make(tmp_path, old, new))
    assert not re.search('(?i)magnet', str(caught.value))
