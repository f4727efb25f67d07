"""Input that nobody writes on purpose: many faults at once, files that are none, empty names."""

import os

import pytest
from refusals import refusal

from magphonon.cli.main import main
from magphonon.scenes.scene import read_scene, ready_scene

pytestmark = pytest.mark.usefixtures('no_impacts')

PROTOTYPE = ready_scene('prototype').read_text()


# --- many faults at once, and what was meant -------------------------------------------------------------------------


def test_every_fault_is_told_at_once(scene_file):
    """Unknown keys, missing keys and bad values, in tables and in tables of tables."""
    said = refusal(scene_file({
        'b_N_m_a = 1.6209e-10': 'b = 1.6209e-10', 'a = 4.5824 ': 'a = -4.5824 ', 'mass_kg = 7.07e-4': 'colour = "red"',
        'radius_m = 7.9375e-4': 'radius_m = "thin"', 'height_m = 0.15': '', 'points = 300': 'points = 2.5',
        '[plan]': '[plans]', 'force_N = 2.5e-4': '', 'at_m = [0.0, 0.009]': 'at_m = [0.0]'})).splitlines()
    assert said == [
        "the scene has no key 'plans'; did you mean 'plan'?",
        "lattice has no key 'colour'; its keys are kind, spacing_m, mass_kg, relative_masses",
        "lattice lacks the key 'mass_kg'; add the mass of a particle in kg",
        "law has no key 'b'; did you mean 'b_N_m_a'?",
        'law.a must be a positive number, not -4.5824',
        "foundation.pillar.radius_m must be a positive number, not 'thin'",
        "foundation.pillar lacks the key 'height_m'; add the height in m",
        'bands.points must be a whole number of at least 2, not 2.5',
        'frf.force.at_m must be a place [x, y], not [0.0]',
        "burst lacks the key 'force_N'; add the largest force on a particle in N"]


def test_tables_that_do_not_belong_together_are_told_at_once(scene_file):
    said = refusal(scene_file({'path = "GMKG"': 'path = "GXMG"', 'edge = "M"': 'edge = "X"', 'noise_m = 5e-9': 'noise_m = 0.5',
                               '"Prototype of': '"$\\\\input{x}$ Prototype of'})).splitlines()
    assert [line.split(' ')[0] for line in said] == ['title', 'bands.path', 'plan.edge', 'vibrometer.noise_m']


@pytest.mark.parametrize(('arguments', 'meant'), [
    (['bnads', 'x.toml'], "there is no command 'bnads'; did you mean 'bands'?"),
    (['scene', 'protoype'], "did you mean 'prototype'?"),
    (['Bands'], "did you mean 'bands'?"), (['zzz'], "there is no command 'zzz'; the commands are bands, burst"),
    (['density'], "did you mean 'dos'?"),
    (['bands', 'chain', '--outptu', 'x'], """"magphonon bands" has no option '--outptu'; did you mean '--output'?"""),
    (['check', 'chain', 'dust'], """"magphonon check" takes no further argument 'dust'""")])
def test_misspelt_command(arguments, meant, capsys):
    try:
        assert main(arguments) == 2
    except SystemExit as ended:  # argparse's way out
        assert ended.code == 2  # noqa: PT017
    assert meant in capsys.readouterr().err


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('kind = "triangular"', 'kind = "triangle"', "did you mean 'triangular'?"),
    ('kind = "inverse_power"', 'kind = "inverse"', "did you mean 'inverse_power'?"),
    ('shells = 1 ', 'shells = "ALL" ', "law.shells must be a whole number from 1 to 9007199254740992, or 'all', not 'ALL'")])
def test_misspelt_value(old, new, words, scene_file):
    assert words in refusal(scene_file({old: new}))


def test_no_internals_in_what_is_refused(scene_file):
    said = refusal(scene_file({'shells = 1 ': 'shells = "all" '}, 'rings'))
    assert "law.shells = 'all': the sum over all neighbours is known for inverse powers and Yukawa repulsion, not for" in said
    assert '(' not in said


# --- files that are none ---------------------------------------------------------------------------------------------


def test_windows_byte_order_mark(scene_file, tmp_path):
    file = tmp_path / 'windows.toml'
    file.write_bytes(b'\xef\xbb\xbf' + PROTOTYPE.replace('\n', '\r\n').encode())
    assert read_scene(file) == read_scene(ready_scene('prototype'))


def test_deep_nesting(tmp_path):
    file = tmp_path / 'deep.toml'
    file.write_text('x = ' + 1200 * '[' + 1200 * ']')
    assert refusal(file).startswith(f'{file} is not a scene: it nests lists or tables hundreds deep')


@pytest.mark.skipif(not os.path.exists('/dev/zero'), reason='a system without such files')
def test_devices_and_pipes_do_not_hang(tmp_path, scene_file):
    pipe = tmp_path / 'pipe.toml'
    os.mkfifo(pipe)
    for file in ('/dev/zero', pipe):
        with pytest.raises(ValueError, match='is a pipe or a device and may never end'):
            read_scene(file)
        law = f'[law]\nkind = "table"\nfile = "{file}"\nshells = 1\n'
        text = PROTOTYPE.partition('[law]')[0] + law
        (tmp_path / 'my.toml').write_text(text)
        assert refusal(tmp_path / 'my.toml').startswith(f'law.file: {file} is a pipe or a device')


def test_a_film_is_no_scene(tmp_path):
    film = tmp_path / 'film.toml'
    with open(film, 'wb') as file:
        file.truncate(50 * 2**20)  # sparse
    with pytest.raises(ValueError, match='has 50 MB, more than the 10 MB that are read'):
        read_scene(film)


def test_character_zero(tmp_path):
    (tmp_path / 'my.toml').write_text(PROTOTYPE.partition('[law]')[0] + '[law]\nkind = "table"\nfile = "a\\u0000b"\nshells = 1\n')
    assert refusal(tmp_path / 'my.toml').startswith("law.file must be the name of a file in quotes, not 'a\\x00b'")
    with pytest.raises(ValueError, match='contains the character 0'):
        read_scene('a\0b')


@pytest.mark.parametrize(('title', 'words'), [
    ('"two\\nlines"', 'title must be one line'), ('"' + 300 * 'x' + '"', 'at most 200 printable characters'),
    ('"$\\\\input{x}$"', 'title holds a formula that cannot be drawn')])
def test_titles_that_cannot_be_drawn(title, words, scene_file, capsys):
    file = scene_file({'"Prototype of arXiv:1911.10410: magnets on pillars"': title})
    assert words in refusal(file)
    assert main(['check', str(file)]) == 2
    assert 'title' in capsys.readouterr().err


def test_mathematics_in_a_title_is_welcome(scene_file):
    assert read_scene(scene_file({'"Prototype of': '"$D^0 + D^*$ and 5 \\\\$ of'})).title.startswith('$D^0')


# --- refusals that name what to change -----------------------------------------------------------------------------


@pytest.mark.parametrize(('command', 'changes', 'scene', 'words'), [
    ('check', {'side_m = 0.3 ': 'side_m = 0.005 '}, 'prototype',
     'patch.side_m = 0.005, lattice.spacing_m = 0.01: the patch holds 1 particles, none of them inside its rim; make it larger'),
    ('frf', {'spacing_m = 0.01 ': 'spacing_m = 0.012 ', 'side_m = 0.3 ': 'side_m = 0.006 '}, 'prototype',
     'patch.side_m = 0.006, lattice.spacing_m = 0.012: the patch holds 1 particles'),
    ('burst', {'cells_1 = 60 ': 'cells_1 = 2 ', 'cells_2 = 60 ': 'cells_2 = 2 '}, 'ideal',
     'patch.cells_1 = 2, patch.cells_2 = 2, lattice.spacing_m = 1.0: the patch holds 4 particles'),
    ('check', {'side_m = 0.3 ': 'side_m = 300.0 '}, 'prototype',
     'patch.side_m = 300.0, lattice.spacing_m = 0.01: the patch of 1.4e+09 cells is too large'),
    ('bands', {'supercell = [3, 3]': 'supercell = [2, 2]'}, 'prototype',
     'bands.supercell = [2, 2]: the supercell (2, 2, 1) repeats every 20 mm'),
    ('design', {'frequency_Hz = 58.2326897819 ': 'frequency_Hz = 500.0 '}, 'design',
     'design.edge.frequency_Hz, branch 1 at M: no spacing gives 500 Hz; where the lattice is stable'),
    ('check', {'b_N_m_a = 1.6209e-10': 'b_N_m_a = 1.6209e300'}, 'prototype',
     'law: b must be a positive number in N mm^a, not inf; check units and exponents of law.b_N_m_a = 1.6209e+300, law.a = 4.58'),
    ('check', {'b_N_m_a = 1.6209e-10': 'b_N_m_a = 1.6209e90'}, 'prototype',
     'law, foundation and lattice.mass_kg give frequencies of about 6e+51 Hz; check their units and exponents (law.b_N_m_a = ')])
def test_refusals_name_the_keys(command, changes, scene, words, scene_file, tmp_path, capsys):
    arguments = [command, str(scene_file(changes, scene))]
    assert main(arguments + ([] if command in ('check', 'design') else ['-o', str(tmp_path / 'out')])) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / 'out').exists()


@pytest.mark.parametrize(('table', 'words'), [
    ('r_m,f_N\n0.008,0.3e300\n0.009,0.2e300\n0.01,0.1e300\n', 'f_N must lie between 1e-30 and 1e+12 N, and is 3e+299 N'),
    ('r_m,f_N,sigma_N\n0.008,0.3,1e-300\n0.009,0.2,1\n0.01,0.1,1\n', 'sigma_N must lie between'),
    ('r_m,f_N\n1e-300,0.3\n0.009,0.2\n0.01,0.1\n', 'r_m must lie between 1e-12 and 1e+06 m, and is 1e-300 m in line 2'),
    ('r_m,f_N\n0.008,5e8\n0.009,0.2\n0.01,0.1\n0.011,0.08\n', 'the forces fall as r^-'),
    ('r_m,f_N\n0.008,0.1\n0.009,0.2\n0.01,0.3\n', 'the forces do not fall with the distance')], ids=range(5))
def test_refusals_name_the_table(table, words, tmp_path, capsys):
    file = tmp_path / 'forces.csv'
    file.write_text(table)
    assert main(['fit', str(file)]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f'magphonon: {file}')
    assert words in said
    assert len(said) < 400


def test_speeds_that_are_no_numbers_have_words(tmp_path, capsys):
    """Of electrons w/k grows without end in long waves; a kagome lattice of D0 alone has a mode without stiffness."""
    for name, word in (('wigner', 'unbounded'), ('kagome', 'none')):
        text = ready_scene('wigner').read_text() if name == 'wigner' else ready_scene('ideal').read_text().replace(
            'kind = "triangular"', 'kind = "kagome"')
        file = tmp_path / f'{name}.toml'
        file.write_text(text.replace('points = 300', 'points = 3'))
        assert main(['bands', str(file), '-o', str(tmp_path / name)]) == 0
        said = capsys.readouterr().out
        assert word in said.partition('long-wave speeds')[2]
        assert not {'nan', 'inf'} & set(said.split())


def test_an_error_without_bound_has_a_word(scene_file, capsys):
    """So strong a force that no periodic vibration answers it: linear models are off by whatever it is."""
    file = scene_file({'spacing_m = 1.0 ': 'spacing_m = 1.2 ', 'damping_per_s = 12.0 ': 'damping_per_s = 0.1 '}, 'oscillator')
    assert main(['plan', str(file)]) == 0
    said = capsys.readouterr().out
    assert [line.split()[2] for line in said.splitlines() if 'complete linear' in line] == ['unbounded']
    assert 'inf' not in said.split()


def test_names_and_keys_that_are_empty_or_stand_twice(tmp_path, scene_file, capsys):
    assert main(['check', '']) == 2
    assert "'' names no file" in capsys.readouterr().err
    twice = tmp_path / 'twice.toml'
    twice.write_text(ready_scene('chain').read_text() + '\n[lattice]\n')
    assert main(['check', str(twice)]) == 2
    assert 'is not TOML (Cannot declare [lattice] twice' in capsys.readouterr().err
    assert main(['check', str(scene_file({'path = "GX"': 'path = "GG"'}, 'chain'))]) == 2
    assert "bands.path goes from G to G in 'GG'" in capsys.readouterr().err


def test_no_name_for_the_results(scene_file, capsys):
    with pytest.raises(SystemExit) as ended:
        main(['bands', str(scene_file({})), '-o', ''])
    assert ended.value.code == 2
    assert "-o '' names no directory" in capsys.readouterr().err
