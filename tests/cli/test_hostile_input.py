"""Input that nobody writes on purpose: numbers beyond all range, files that are none, closed streams, many faults at once."""

import os
import subprocess
import sys
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from magphonon import InversePower
from magphonon.bands.zone import ZoneMap
from magphonon.cli.main import main
from magphonon.errors import finite, not_negative, number, positive, whole
from magphonon.files import write_columns
from magphonon.planning.plan import Plan
from magphonon.response.frf import FrequencyResponse
from magphonon.scenes.scene import read_scene, ready_scene
from magphonon.waves.vibrometer import read_displacements

PROTOTYPE = ready_scene('prototype').read_text()


@pytest.fixture
def scene_file(tmp_path):
    """A function that writes a ready scene with texts replaced by others."""
    def write(changes, name='prototype'):
        text = ready_scene(name).read_text()
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new)
        file = tmp_path / 'my.toml'
        file.write_bytes(text.encode())
        return file
    return write


def refusal(file):
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the caller looks at the message
        read_scene(file)
    return str(caught.value).replace(f'{file}: ', '')


def command(*arguments, **options):
    """The command in a process of its own, as a shell would start it."""
    return subprocess.run([sys.executable, '-m', 'magphonon', *map(str, arguments)], timeout=60, text=True,
                          **({'capture_output': True} | options))


# --- numbers ---------------------------------------------------------------------------------------------------------

HUGE = [2**64, 10**25, 10**400, -(10**400), Fraction(10**400, 3), 10**5000]


@pytest.mark.parametrize('value', HUGE, ids=lambda value: f'{len(hex(int(value)))} digits')
def test_numbers_beyond_all_range_are_taken_or_refused_by_name(value):
    for check in (number, positive, not_negative, whole):
        try:
            assert check('b', value) == float(value)
        except ValueError as error:
            assert str(error).startswith('b must be a ')  # noqa: PT017  one of both may happen
            assert len(str(error)) < 400  # noqa: PT017
        else:
            assert abs(value) < 1e308
            assert check is not whole
    with pytest.raises(ValueError, match=r'b\[0\] is inf|b must hold numbers'):
        finite('b', [10**400])


def test_whole_numbers_end_where_floats_skip_some():
    assert whole('n', 2**53) == 2**53
    for value in (2**53 + 2, 1e300):
        with pytest.raises(ValueError, match='n must be a whole number of at least 1 and at most 9007199254740992, not'):
            whole('n', value)


def test_numbers_of_numpy_are_shown_as_numbers():
    for value in (np.float64(-2.5), np.float32(-2.5), np.int64(-3)):
        with pytest.raises(ValueError, match=f'b must be a positive number, not {value.item()}$'):
            positive('b', value)


@pytest.mark.parametrize('tolerance', [np.nan, 0.0, -1.0, np.inf])
def test_a_plan_has_a_tolerance(tolerance):
    with pytest.raises(ValueError, match='tolerance must be a positive number'):
        Plan('bands', 'the highest', tolerance, (), (), 0.0)


def test_laws_take_large_whole_numbers():
    assert InversePower(10**30, 4).dphi(2.0) == InversePower(1e30, 4.0).dphi(2.0)


@pytest.mark.parametrize('value', [2**64, 10**25])
@pytest.mark.parametrize(('key', 'line'), [
    ('law.a', 'a = 4.5824'), ('lattice.mass_kg', 'mass_kg = 7.07e-4'), ('bands.points', 'points = 300'),
    ('foundation.pillar.youngs_modulus_Pa', 'youngs_modulus_Pa = 71e9'), ('frf.to_Hz', 'to_Hz = 70.0'),
    ('burst.duration_s', 'duration_s = 0.5'), ('vibrometer.sampling_rate_Hz', 'sampling_rate_Hz = 1000'),
    ('patch.side_m', 'side_m = 0.3'), ('burst.cycles', 'cycles = 5  ')])
def test_huge_whole_number_in_a_scene_is_named(key, line, value, scene_file):
    said = refusal(scene_file({line: f'{line.split(" =")[0]} = {value}'}))
    assert said.startswith((key, 'its numbers are too large'))


@pytest.mark.parametrize(('key', 'value', 'bound'), [
    ('burst.cycles', '1e-300', '0.5'), ('burst.force_N', '5e-324', '1e-30'), ('burst.damping_ratio', '1e300', '1'),
    ('burst.duration_s', '1e300', '1e+09'), ('vibrometer.noise_m', '1e12', '1e+06'), ('lattice.mass_kg', '1e12', '1e+09'),
    ('frf.to_Hz', '1e300', '1e+12'), ('frf.from_Hz', '1e-300', '1e-09'), ('frf.damping_per_s', '1e-300', '1e-09'),
    ('patch.side_m', '1e300', '1e+06')])
def test_absurd_values_are_refused_with_their_range(key, value, bound, scene_file):
    table, name = key.split('.')
    after = PROTOTYPE.partition(f'[{table}]')[2]
    line = next(line for line in after.splitlines() if line.startswith(f'{name} = '))
    said = refusal(scene_file({line: f'{name} = {value}'}))
    assert said.startswith(f'{key} must lie between ')
    assert bound in said
    assert f'not {float(value)!r}' in said


def test_millimetres_in_place_of_metres(scene_file):
    """12 m between magnets that need 12 mm: the static forces would be 4e-17 of the foundation, below any round-off."""
    said = refusal(scene_file({'spacing_m = 0.01 ': 'spacing_m = 12 '}))
    assert said.startswith('lattice.spacing_m = 12.0: the repulsion then has a stiffness of ')
    assert 'did you mean 0.012?' in said
    assert read_scene(scene_file({'spacing_m = 0.01 ': 'spacing_m = 0.012 '})).lattice.spacing_m == 0.012


@pytest.mark.parametrize(('mass', 'fine'), [(1.13e-3, True), (1.13, False), (1.13e-6, False)])
def test_a_magnet_has_the_density_of_a_magnet(mass, fine, tmp_path):
    """A disc of 8 x 3 mm has 0.15 cm3: 1.13 g is NdFeB; 1.13 kg would be 7.5e6 kg/m3."""
    text = (f'title = "discs"\n[lattice]\nkind = "square"\nspacing_m = 0.012\nmass_kg = {mass}\n[law]\nkind = "magnets"\n'
            'grade = "N42"\nshells = 1\n[law.disc]\ndiameter_m = 8e-3\nheight_m = 3e-3\n')
    file = tmp_path / 'my.toml'
    file.write_text(text)
    if fine:
        read_scene(file)
    else:
        assert refusal(file).startswith(f'lattice.mass_kg = {mass!r} would give the magnet {mass / 1.508e-7:.3g} kg/m3')


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
    (['Bands'], "did you mean 'bands'?"), (['zzz'], "there is no command 'zzz'; the commands are 'bands', 'burst'")])
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


def test_the_name_of_a_ready_scene_is_no_file(tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name, mend in (('prototype', '"magphonon scene prototype > prototype.toml" writes'), ('x', '"magphonon scene" lists')):
        assert main(['check', name]) == 2
        assert mend in capsys.readouterr().err


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
    with pytest.raises(ValueError, match='holds the character 0'):
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


# --- results that are no numbers -----------------------------------------------------------------------------------

@pytest.mark.parametrize('number', [np.nan, np.inf, complex(0, -np.inf)])
def test_results_that_are_no_numbers_are_not_written(number, tmp_path):
    response = FrequencyResponse(np.array([1.0, 2.0]), np.array([1 + 1j, number]))
    with pytest.raises(FloatingPointError, match=r'response would be .* in 1 of 2 entries of r.npz, so it is not written'):
        response.save(tmp_path / 'r.npz')
    with pytest.raises(FloatingPointError, match=r'b_m would be'):
        write_columns(tmp_path / 'r.csv', ['a_m', 'b_m'], [[1.0, 2.0], [3.0, abs(number)]])
    assert list(tmp_path.iterdir()) == []


def test_nan_where_it_means_no_value_is_written(tmp_path):
    """Group velocities have none at a frequency of zero; infinity has no such meaning."""
    mesh = ZoneMap(np.eye(3), np.zeros((1, 1, 3)), np.zeros((1, 1, 2)), np.full((1, 1, 2, 2), np.nan))
    mesh.save(tmp_path / 'zone.npz')
    assert np.isnan(ZoneMap.load(tmp_path / 'zone.npz').velocity).all()
    with pytest.raises(FloatingPointError, match='velocity would be inf'):
        replace(mesh, velocity=np.full((1, 1, 2, 2), np.inf)).save(tmp_path / 'zone.npz')


def test_a_command_whose_result_overflows_writes_nothing(tmp_path, capsys, monkeypatch):
    from magphonon.response import frf

    def overflown(*arguments):
        response = receptance(*arguments)
        return replace(response, response=response.response * np.where(np.arange(len(response.omega)) < 3, np.inf, 1))

    receptance = frf.receptance
    file = tmp_path / 'my.toml'
    file.write_text(ready_scene('oscillator').read_text())
    with np.errstate(invalid='ignore'):
        monkeypatch.setattr(frf, 'receptance', overflown)
        assert main(['frf', str(file), '-o', str(tmp_path / 'out')]) == 2
    said = capsys.readouterr().err
    assert said.startswith('magphonon: response would be ')
    assert said.endswith(f'check units and exponents in [lattice], [law] and [frf] of {file}\n')
    assert list(tmp_path.iterdir()) == [file]


# --- magnitudes that no formula bears ------------------------------------------------------------------------------

@pytest.mark.parametrize(('given', 'key'), [('a_percent = 450.0', 'a_percent = 450.0'), ('a = 20.6', 'a = 20.6'),
                                            ('a_percent = 51.0', 'a_percent = 51.0')])
def test_tolerances_in_which_nothing_is_linear(given, key, scene_file):
    with pytest.raises(ValueError, match=f'uncertainty.{key} is .* of a, more than the 0.5 within which a linear propagation'):
        read_scene(scene_file({'a_percent = 0.45': given}, 'tolerances'))


def test_half_is_still_a_tolerance(scene_file):
    scene = read_scene(scene_file({'a_percent = 0.45': 'a_percent = 50.0'}, 'tolerances'))
    assert scene.uncertainty.tolerances(scene).covariance.max() == pytest.approx(0.25)


@pytest.mark.parametrize(('u', 'fine'), [('1e300', False), ('1e-300', False), ('2e3', False), ('0', True), ('1e-12', True)])
def test_displacements_that_no_lattice_makes(u, fine, tmp_path):
    """Their squares, the power on a map, are infinite or zero."""
    file = tmp_path / 'scan.csv'
    file.write_text('time_s,particle,u_x_m,u_y_m\n' + ''.join(f'{0.001 * k},7,{u},0\n' for k in range(4)))
    if fine:
        assert read_displacements(file).displacements.shape == (4, 1, 2)
        return
    with pytest.raises(ValueError, match='no motion of a lattice; check the unit and the exponents of u_x_m and u_y_m'):
        read_displacements(file)


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
    ('r_m,f_N\n0.008,0.3\n0.009,0.2\n', 'an inverse power takes at least 3 points, not 2; measure more'),
    ('r_m,f_N\n0.008,0.3e300\n0.009,0.2e300\n0.01,0.1e300\n', 'force 1 is 3e+299 N, and must lie between 1e-30 and 1e+12 N'),
    ('r_m,f_N,sigma_N\n0.008,0.3,1e-300\n0.009,0.2,1\n0.01,0.1,1\n', 'sigma 1 is 1e-300 N, and must lie between'),
    ('r_m,f_N\n1e-300,0.3\n0.009,0.2\n0.01,0.1\n', 'distance 1 is 1e-300 m, and must lie between 1e-12 and 1e+06 m'),
    ('r_m,f_N\n0.008,5e8\n0.009,0.2\n0.01,0.1\n0.011,0.08\n', 'the forces fall as r^-'),
    ('r_m,f_N\n0.008,0.1\n0.009,0.2\n0.01,0.3\n', 'the forces do not fall with the distance'),
    ('r_m,f_N\n0.008,"0.1\n2"\n0.01,0.3\n', "line 2: '0.008,\"0.1' is not 2 numbers"),
    ('r_m,f_N\n0.008,' + 140_000 * '1' + '\n0.01,0.3\n', 'is not 2 numbers')], ids=range(8))
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


# --- streams ---------------------------------------------------------------------------------------------------------

def test_closed_streams_cost_nothing(tmp_path):
    """As `>&-` and `2>&-` close them: results are written all the same."""
    file = tmp_path / 'chain.toml'
    file.write_text(ready_scene('chain').read_text())
    for stream in (1, 2):
        out = tmp_path / str(stream)
        done = command('bands', file, '-o', out, capture_output=False, stdout=subprocess.PIPE, stderr=subprocess.PIPE,
                       preexec_fn=lambda stream=stream: os.close(stream))
        assert (done.returncode, done.stderr) == (0, '')
        assert (out / 'bands.csv').exists()


def test_letters_that_the_terminal_lacks(tmp_path):
    file = tmp_path / 'chain.toml'
    file.write_text(ready_scene('chain').read_text().replace('title = "', 'title = "größe 😀 '), encoding='utf-8')
    done = command('check', file, env={**os.environ, 'PYTHONIOENCODING': 'ascii', 'LC_ALL': 'C'})
    assert (done.returncode, done.stderr) == (0, '')
    assert done.stdout.startswith('gr\\xf6\\xdfe \\U0001f600')


@pytest.mark.skipif(not os.path.exists('/dev/full'), reason='a system without such files')
def test_a_report_that_cannot_be_shown_has_a_status_of_its_own(tmp_path):
    (tmp_path / 'law.csv').write_text('r_mm,f_N\n1,16\n2,8\n4,4\n8,2\n16,1\n')
    fit = ('fit', tmp_path / 'law.csv', '-o', tmp_path / 'out')
    for arguments, written in ((('scene', 'chain'), ''), (fit, '; the results are written')):
        with open('/dev/full', 'w') as full:
            done = command(*arguments, capture_output=False, stdout=full, stderr=subprocess.PIPE)
        assert done.returncode == 3
        assert done.stderr.strip() == f'magphonon: the report could not be shown (No space left on device){written}'


@pytest.mark.skipif(not os.path.exists('/dev/full'), reason='a system without such files')
def test_a_mistake_keeps_its_status_where_its_message_cannot_be_shown(tmp_path):
    with open('/dev/full', 'w') as full:
        done = command('check', tmp_path / 'none.toml', capture_output=False, stderr=full, stdout=subprocess.PIPE)
    assert (done.returncode, done.stdout) == (2, '')


def test_python_without_docstrings_and_a_shell_with_another_backend_change_nothing(tmp_path):
    shell = {**os.environ, 'PYTHONOPTIMIZE': '2', 'MPLBACKEND': 'bogus'}
    (tmp_path / 'chain.toml').write_text(ready_scene('chain').read_text())
    done = command('bands', tmp_path / 'chain.toml', '-o', tmp_path / 'out', env=shell)
    assert (done.returncode, done.stderr) == (0, '')
    assert (tmp_path / 'out' / 'bands.png').exists()
    assert command('--version', env=shell).stdout.startswith('magphonon ')


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
