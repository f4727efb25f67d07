"""What a scene file may not say: each fault is refused by name, with its value and how to mend it, and all of them at once."""

import copy
import math
import os
import sys
import tomllib
from functools import partial

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene

from magphonon import analytic_bands, finite_displacements, phonopy_bands
from magphonon.scenes.fields import unit_of
from magphonon.scenes.scene import Scene, read_scene
from magphonon.scenes.sources import Source

NAN = math.nan
FORCES = {'distances_m': [0.008, 0.01, 0.012, 0.015], 'forces_N': [0.66, 0.2369, 0.103, 0.037]}
HERTZ = {'kind': 'hertz', 'diameter_m': 0.0101, 'youngs_modulus_Pa': 1e6, 'poisson_ratio': 0.3, 'shells': 1}


def refusal(file):
    """What a scene that cannot be read says of its faults."""
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the caller looks at the message
        read_scene(file)
    message = str(caught.value)
    assert message.startswith(str(file))
    assert 'pydantic' not in message
    return message.replace(f'{file}: ', '')


# --- drawn faults ----------------------------------------------------------------------------------------------------

SCENES = 'bench', 'tolerances', 'vacancy', 'layer', 'oscillator'
DRAWN = 12
"""Scenes drawn from each ready one."""
SCHEMA = Scene.model_json_schema()
RANGED = '_Hz', '_kg', '_Pa'  # ends of keys whose values have an upper end


def tables_of(scene, place='', schema=SCHEMA):
    """The tables of a scene with their places, '' for the scene itself, 'foundation.pillar', and their schemas."""
    yield place, scene, schema
    for name, value in scene.items():
        if isinstance(value, dict):
            found = schema['properties'][name]
            found = found.get('anyOf', [found])[0]
            ref = found['discriminator']['mapping'][value['kind']] if 'discriminator' in found else found['$ref']
            yield from tables_of(value, f'{place}.{name}' if place else name, SCHEMA['$defs'][ref.rpartition('/')[2]])


def spoil(place, table, schema, rng):
    """Spoil one key of a table; the beginning of the line that must tell it."""
    name = str(rng.choice([name for name in table if name != 'kind' and not isinstance(table[name], dict)] or ['']))
    whole = f'{place}.{name}' if place else name
    told = place or 'the scene'
    fault = rng.choice(['unknown', 'missing', 'type', 'range']) if name else 'unknown'
    if fault == 'missing' and name in schema.get('required', ()):
        del table[name]
        return f"{told} lacks the key '{name}'; add "
    if fault == 'type' and not (isinstance(table[name], list) and isinstance(table[name][0], dict)):
        table[name] = {'no': 1}
        return f'{whole} must be '
    if fault == 'range' and unit_of(name) and '_deg' not in name and isinstance(table[name], int | float):
        table[name] = -1e-3 if rng.integers(2) or not name.endswith(RANGED) else 1e30
        return f'{whole} must '
    table['zzz'] = 1
    return f"{told} has no key 'zzz'; its keys are "


def answer(scene, as_toml):
    content = ''.join(f'{key} = {as_toml(value)}\n' for key, value in scene.items()).encode()
    try:
        read_scene(Source('drawn', content, ready_scene('bench').parent))
    except ValueError as error:
        return [line.removeprefix('drawn: ') for line in str(error).splitlines()]
    return []


@pytest.mark.parametrize('name', SCENES)
def test_one_answer_names_every_fault_and_no_other(name, as_toml):
    rng = np.random.default_rng(sum(map(ord, name)))
    good = tomllib.loads(ready_scene(name).read_text(encoding='utf-8'))
    assert answer(good, as_toml) == []  # the control: as_toml writes what the file says
    most = 0
    for _ in range(DRAWN):
        scene = copy.deepcopy(good)
        places = list(tables_of(scene))
        chosen = rng.permutation(len(places))[: rng.integers(2, len(places) + 1)]
        expected = sorted(spoil(*places[k], rng) for k in chosen)
        said = sorted(answer(scene, as_toml))
        assert [begin for begin in expected if not any(line.startswith(begin) for line in said)] == []
        assert len(said) == len(expected)
        most = max(most, len(said))
    assert most >= 4


# --- one by one ------------------------------------------------------------------------------------------------------

FAULTS = [  # what is changed in the scene of the prototype, and words of the answer: the key or value, and the mend
    ({'law.shells': 1000}, "law.shells must be a whole number from 1 to 300, 'auto' or 'all', not 1000"),
    ({'law': {'kind': 'table', 'distances_m': [0.008, NAN, 0.012, 0.015], 'forces_N': FORCES['forces_N'], 'shells': 1}},
     'law.distances_m[1] must be a positive number, not nan'),
    ({'lattice.spacing_m': 1e-7}, 'lattice.spacing_m must lie between 1e-06 and 1e+06, not 1e-07; it is in metres'),
    ({'lattice.spacing_m': 12}, 'no force acts beside [foundation], 19.7 N/m; check their units'),
    ({'foundation.pillar.height_m': 0.15e-6}, 'no force acts beside [foundation], 1.97e+19 N/m; check their units'),
    ({'foundation.pillar.radius_m': 1.0}, 'foundation.pillar.radius_m = 1.0: such pillars would overlap'),
    ({'law': {'kind': 'yukawa', 'strength_J_m': 3.3e-20, 'screening_length_m': 1e-9, 'shells': 1}}, 'screening_length_m = 1e-09'),
    ({'law.b_N_m_a': 1e30}, 'law, foundation and lattice.mass_kg give frequencies of about 5e+21 Hz; check their units'),
    ({'law.b_N_m_a': 1.6209e300}, 'law: b must be a positive number in N mm^a, not inf; check units and exponents of law.b_'),
    ({'law.a': 1e3}, 'its numbers are too large or too small to compute with ('),
    ({'lattice.kind': 'hexagonal'}, "lattice.kind must be one of 'chain', 'square', "),
    ({'lattice.kind': 'triangle'}, "did you mean 'triangular'?"),
    ({'law.kind': 'dipoles'}, "law has no key 'b_N_m_a'; its keys are kind, moment_A_m2, shells"),
    ({'foundation': {}}, 'foundation has neither of stiffness_N_per_m and [foundation.pillar]; give one'),
    ({'foundation.stiffness_N_per_m': 19.7}, 'foundation has both of stiffness_N_per_m and [foundation.pillar]; give one'),
    ({'title': 'two\nlines'}, 'title must be one line'), ({'title': 300 * 'x'}, 'at most 200 printable characters'),
    ({'title': '$\\input{x}$'}, 'title holds a formula that cannot be drawn'),
    ({'title': '\x1b[31m'}, 'title must be one line'),
    ({'bands.path': 'GXMG'},
     "bands.path of the triangular lattice must join different ones of the points G, M, K, not 'GXMG'"),
    ({'bands.path': 'GG'}, 'must join different ones of the points'),
    *(({'bands.path': path}, "did you mean 'GMKG'?") for path in ('gmkg', 'G-M-K-G', 'ΓMKΓ')),
    ({'bands.supercell': [3, 3, 1]}, 'must hold 2 whole numbers, not [3, 3, 1]'),
    ({'law': {'kind': 'table', 'shells': 1, 'distances_m': [0.01], 'forces_N': [1.0]}}, 'at least 4 points'),
    ({'law.shells': 'all', 'law.a': 0.9}, "law.shells = 'all': the force r^-0.9 has no energy"),
    ({'law': HERTZ, 'lattice.spacing_m': 0.101}, 'lattice.spacing_m = '),
    ({'law': HERTZ | {'poisson_ratio': 0.6}}, 'law.poisson_ratio must lie between 0 and 0.5, not 0.6'),
    ({'lattice.relative_masses': [1.0, 2.0]}, 'lattice.relative_masses must hold 1 numbers'),
    ({'uncertainty': {'mass_percent': 450.0}}, 'uncertainty.mass_percent must lie between 0 and 50, not 450.0'),
    *(({'law': None, wrong: {}} if wrong == 'laws' else {key: None, wrong: 1.0}, f'did you mean {meant!r}?')
      for key, wrong, meant in (('lattice.spacing_m', 'lattice.spacing_mm', 'spacing_m'), ('law.shells', 'law.shels', 'shells'),
                                ('lattice', 'latice', 'lattice'), ('law.b_N_m_a', 'law.b', 'b_N_m_a'),
                                ('foundation.pillar.height_m', 'foundation.pillar.height', 'height_m')))]


@pytest.mark.filterwarnings('ignore:the stiffest bond')
@pytest.mark.parametrize(('changes', 'words'), FAULTS, ids=str)
def test_refused_with_its_name_and_value_and_the_mend(changes, words, scene_file):
    assert words in refusal(scene_file(changes))


@pytest.mark.parametrize('key', ['lattice.spacing_m', 'lattice.mass_kg', 'law.b_N_m_a', 'law.a', 'foundation.pillar.radius_m'])
@pytest.mark.parametrize('value', [1e308, 1e100, 1e-100, 5e-324])
def test_absurd_number_is_refused_or_computed_with(key, value, scene_file):
    """A wrong unit or exponent overflows somewhere; that is said in words, and what is accepted stays finite."""
    file = scene_file({key: value})
    try:
        scene = read_scene(file)
    except ValueError:
        message = refusal(file)
        assert any(mend in message for mend in ('check their units', 'must be a', 'must lie between'))
    else:
        assert np.isfinite(analytic_bands(scene.atoms(), scene.band_path()).omega).all()


@pytest.mark.filterwarnings('ignore:.*denser than any metal', r'ignore:a mass of .* g/cm\^3')
@pytest.mark.parametrize('spacing', [2e-6, 3e-4, 5e5])
def test_lattices_of_every_size(spacing, scene_file):
    """Frequencies depend on b r^-(a+1) alone; ASE knows no lattice of 2 um, and the path is made for it all the same."""
    k = read_scene(ready_scene('bench')).foundation.pillar.stiffness_N_per_m  # such pillars would overlap in a small lattice
    small = {'lattice.spacing_m': spacing, 'law.b_N_m_a': 1.6209e-10 * (spacing / 0.01) ** 5.5824,
             'foundation': {'stiffness_N_per_m': k}}
    expected = analytic_bands(read_scene(ready_scene('bench')).atoms(), read_scene(ready_scene('bench')).band_path())
    scene = read_scene(scene_file(small))
    numerical = phonopy_bands(finite_displacements(scene.atoms(), scene.supercell()), scene.band_path())
    assert_allclose(analytic_bands(scene.atoms(), scene.band_path()).omega, expected.omega, rtol=1e-10)
    assert_allclose(numerical.omega, expected.omega, atol=1e-8 * expected.omega.max())  # phonopy's promise


@pytest.mark.parametrize('table', [None, {}])
@pytest.mark.parametrize(('shells', 'cells'), [(1, (3, 3, 1)), (2, (5, 5, 1)), (3, (5, 5, 1)), (4, (7, 7, 1))])
def test_a_scene_without_bands_has_those_of_ases_path(scene_file, table, shells, cells):
    """A supercell of n cells is 0.87 n spacings wide, and its bonds 1, 1.73, 2 and 2.65: twice as wide is the least."""
    scene = read_scene(scene_file({'bands': table, 'law.shells': shells}))
    path = scene.band_path()
    assert (path.path, len(path.kpts)) == ('GMKG', 200)
    assert scene.supercell() == cells


@pytest.mark.parametrize('table', ['patch', 'burst', 'frf', 'uncertainty'])
def test_missing_table_is_shown_in_a_scene_that_has_it(table):
    wanting = read_scene(ready_scene('bench')).model_copy(update={table: None})
    with pytest.raises(ValueError, match=r'add one, as in') as caught:
        wanting.wanted(table)
    assert getattr(read_scene(ready_scene(str(caught.value).split()[-1].strip('"'))), table) is not None


@pytest.mark.parametrize(('content', 'words'), [
    (b'spacing: 10 mm', 'line 1'), (b'title = "\xff"', 'byte 10'), (b'', "lacks the key 'title'"),
    (b'x = ' + 1200 * b'[' + 1200 * b']', 'is not a scene: it nests lists or tables hundreds deep'),
    (b'title = "a"\n[lattice]\n[lattice]\n', 'is not TOML (Cannot declare [lattice] twice'),
    (b'x' + 50_000 * b'.x' + b' = 1', 'is not a scene: it nests lists or tables hundreds deep'),  # which took 10 GB
    (b'[lattice]\nspacing_m = 0,01', 'numbers take a decimal point, as in 0.01'),
    (b'[lattice]\nspacing_m = 10 mm', 'its unit is in the name of the key'),
    (b'title = "C:\\Users\\x"', "a path takes slashes, as in 'C:/bench/particles.csv'"),
    (b'#' * (10 * 2**20 + 1), 'more than the 10 MB that are read')], ids=range(10))
def test_files_that_are_no_scene(content, words, tmp_path, request):
    request.addfinalizer(partial(sys.setrecursionlimit, sys.getrecursionlimit()))
    sys.setrecursionlimit(1000)  # Python's own; symfc, which other tests import, raises it
    file = tmp_path / 'my.toml'
    file.write_bytes(content)
    assert words in refusal(file)


def test_windows_byte_order_mark(tmp_path):
    file = tmp_path / 'windows.toml'
    file.write_bytes(b'\xef\xbb\xbf' + ready_scene('bench').read_text().replace('\n', '\r\n').encode())
    assert read_scene(file) == read_scene(ready_scene('bench'))


@pytest.mark.skipif(not os.path.exists('/dev/zero'), reason='a system without such files')
def test_devices_and_pipes_do_not_hang(tmp_path):
    pipe = tmp_path / 'pipe'
    os.mkfifo(pipe)
    for file in ('/dev/zero', pipe):
        with pytest.raises(ValueError, match='is a pipe or a device and may never end'):
            read_scene(file)


@pytest.mark.parametrize(('changes', 'words'), [
    ({'lattice.mass_kg': 0.707}, 'lattice.mass_kg = 0.707 and lattice.spacing_m = 0.01 make 7.1e[+]02 g/cm3'),
    *(({f'foundation.pillar.{key}': value}, 'would buckle under .* check the units of its keys') for key, value in (
        ('youngs_modulus_Pa', 71.0), ('youngs_modulus_Pa', 71e3), ('height_m', 15.0), ('height_m', 150.0))),
])
def test_a_number_in_another_unit(changes, words, scene_file):
    with pytest.warns(UserWarning, match=words):
        read_scene(scene_file(changes))


@pytest.mark.parametrize(('name', 'old', 'new', 'words'), [
    ('oscillator', 'theta0_deg = 30.0', 'theta0_deg = 90.1', 'lattice.theta0_deg must lie between 0 and 90, not 90.1'),
    ('steel', 'diameter_m = 0.02 ', 'diameter_m = 0.2 ',
     'lattice.spacing_m = 0.019997, law.diameter_m = 0.2, law.shells = 1: spheres are only 0.1 of the distance apart'),
    ('steel', 'diameter_m = 0.02 ', 'diameter_m = 0.002 ', 'law.diameter_m = 0.002'),
])
def test_bounds_of_ready_scenes(name, old, new, words, tmp_path):
    text = ready_scene(name).read_text()
    assert old in text
    (tmp_path / 'my.toml').write_text(text.replace(old, new))
    assert words in refusal(tmp_path / 'my.toml')
