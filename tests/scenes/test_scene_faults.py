"""What a scene file may not say: each fault is refused by name, with its value and how to mend it."""

import math
import re

import numpy as np
import pytest
from numpy.testing import assert_allclose
from refusals import refusal

from magphonon import analytic_bands, finite_displacements, phonopy_bands
from magphonon.interactions.pair_laws import repulsion
from magphonon.scenes.scene import read_scene, ready_scene
from magphonon.scenes.tolerances import varied

NAN, INF = math.nan, math.inf

# A law of each kind, with forces of some tenths of a newton at 10 mm
LAWS = {
    'inverse_power': {'b_N_m_a': 1.6209e-10, 'a': 4.5824},
    'dipoles': {'moment_A_m2': 0.0889},
    'yukawa': {'strength_J_m': 1.5e-5, 'screening_length_m': 0.02},
    'coulomb': {'charge_C': 5e-8},
    'hertz': {'diameter_m': 0.0101, 'youngs_modulus_Pa': 1e6, 'poisson_ratio': 0.3},
    'table': {'distances_m': [0.008, 0.01, 0.012, 0.015], 'forces_N': [0.66, 0.2369, 0.103, 0.037]},
}


# --- what is refused -------------------------------------------------------------------------------------------------

NUMBERS = ['lattice.spacing_m', 'lattice.mass_kg', 'law.b_N_m_a', 'law.a', 'law.shells', 'bands.points',
           'foundation.pillar.youngs_modulus_Pa', 'foundation.pillar.radius_m', 'foundation.pillar.height_m']


@pytest.mark.parametrize('key', NUMBERS)
@pytest.mark.parametrize('value', [NAN, INF, 0, -1.5, 'ten', [2.0], True], ids=repr)
def test_impossible_number(key, value, scene_file):
    assert refusal(scene_file({key: value})).startswith(f'{key} must be a ')
    assert refusal(scene_file({key: value})).endswith(f'not {value!r}')


@pytest.mark.parametrize('key', [key for key in NUMBERS if key not in ('law.shells', 'bands.points')])
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


@pytest.mark.parametrize(('changes', 'message'), [
    ({'lattice.spacing_m': 1e-7}, 'lattice.spacing_m must lie between 1e-06 and 1e+06, not 1e-07; it is in metres'),
    ({'law.b_N_m_a': 1e30}, 'law, foundation and lattice.mass_kg give frequencies of about 5e+21 Hz; check their units'),
    ({'law.a': 1e3}, 'its numbers are too large or too small to compute with (')])
def test_absurd_scale(changes, message, scene_file):
    assert refusal(scene_file(changes)).startswith(message)


@pytest.mark.filterwarnings('ignore:.*denser than any metal')
@pytest.mark.parametrize('spacing', [2e-6, 3e-4, 5e5])
def test_lattices_of_every_size(spacing, scene_file):
    """Frequencies depend on b r^-(a+1) alone; ASE knows no lattice of 2 um, and the path is made for it all the same."""
    small = {'lattice.spacing_m': spacing, 'law.b_N_m_a': 1.6209e-10 * (spacing / 0.01) ** 5.5824}
    expected = analytic_bands(read_scene(ready_scene('prototype')).atoms(), read_scene(ready_scene('prototype')).band_path())
    scene = read_scene(scene_file(small))
    numerical = phonopy_bands(finite_displacements(scene.atoms(), scene.supercell()), scene.band_path())
    assert_allclose(analytic_bands(scene.atoms(), scene.band_path()).omega, expected.omega, rtol=1e-10)
    assert_allclose(numerical.omega, expected.omega, atol=1e-8 * expected.omega.max())  # phonopy's promise


@pytest.mark.parametrize('kind', LAWS)
@pytest.mark.parametrize('value', [NAN, -1.5])
def test_impossible_number_in_every_law(kind, value, scene_file):
    for key, good in LAWS[kind].items():
        bad = [good[0], value, *good[2:]] if isinstance(good, list) else value
        name = f'law.{key}[1]' if isinstance(good, list) else f'law.{key}'
        law = {'kind': kind, **LAWS[kind], 'shells': 1, key: bad}
        assert refusal(scene_file({'law': law})) == f'{name} must be a positive number, not {value!r}'


REQUIRED = ['title', 'lattice', 'law', 'lattice.kind', 'lattice.spacing_m', 'lattice.mass_kg', 'law.a', 'law.shells',
            'bands.path', 'bands.points', 'bands.supercell', 'foundation.pillar.radius_m',
            'foundation.pillar.height_m', 'foundation.pillar.youngs_modulus_Pa']


@pytest.mark.parametrize('key', REQUIRED)
def test_missing_key(key, scene_file):
    table, _, name = key.rpartition('.')
    assert refusal(scene_file({key: None})).startswith(f'{table or "the scene"} lacks the key {name!r}; add ')


def test_scene_without_bands_is_one_until_they_are_wanted(scene_file):
    scene = read_scene(scene_file({'bands': None}))
    assert scene.atoms().get_forces() == pytest.approx(0)
    with pytest.raises(ValueError, match=r'has no table \[bands\]; add one, as in "magphonon scene prototype"'):
        scene.band_path()


@pytest.mark.parametrize('table', ['bands', 'patch', 'burst', 'frf', 'uncertainty'])
def test_missing_table_is_shown_in_a_scene_that_has_it(table):
    wanting = read_scene(ready_scene('prototype')).model_copy(update={table: None})
    with pytest.raises(ValueError, match=r'add one, as in') as caught:
        wanting.wanted(table)
    assert getattr(read_scene(ready_scene(str(caught.value).split()[-1].strip('"'))), table) is not None


@pytest.mark.parametrize(('key', 'wrong', 'suggestion'), [
    ('lattice.spacing_m', 'lattice.spacing_mm', 'spacing_m'), ('lattice.mass_kg', 'lattice.mass_g', 'mass_kg'),
    ('law.shells', 'law.shels', 'shells'), ('bands.points', 'bands.npoints', 'points'), ('lattice', 'latice', 'lattice'),
    ('foundation.pillar', 'foundation.piller', 'pillar'),
    ('foundation.pillar.youngs_modulus_Pa', 'foundation.pillar.youngs_modulus', 'youngs_modulus_Pa')])
def test_misspelt_key_is_told_the_near_one(key, wrong, suggestion, scene_file):
    table, _, name = wrong.rpartition('.')
    message = refusal(scene_file({key: None, wrong: 1.0}))
    assert message == f'{table or "the scene"} has no key {name!r}; did you mean {suggestion!r}?'


@pytest.mark.parametrize(('changes', 'message'), [
    ({'lattice.kind': 'hexagonal'}, "lattice.kind must be one of 'chain', 'square', 'triangular', 'honeycomb', 'kagome', "
                                    "'fcc', 'bcc', 'oscillator', 'file', not 'hexagonal'"),
    ({'law.kind': 'gravity'}, "law.kind must be one of 'inverse_power', 'dipoles', 'coulomb', 'yukawa', 'hertz', 'table', "
                              "'magnets', 'saved', not 'gravity'"),
    ({'law.kind': ['dipoles']}, "law.kind must be one of 'inverse_power', 'dipoles', 'coulomb', 'yukawa', 'hertz', 'table', "
                                "'magnets', 'saved', not ['dipoles']"),
    ({'law.kind': 'dipoles'}, "law has no key 'b_N_m_a'; its keys are kind, moment_A_m2, shells"),
    ({'law.cutoff_m': 0.02}, "law has no key 'cutoff_m'; its keys are kind, b_N_m_a, force_N, a, shells"),
    ({'law': 4.5}, "law must be a table in brackets with a kind, one of 'inverse_power', 'dipoles', 'coulomb', 'yukawa', "
                   "'hertz', 'table', 'magnets', 'saved', not 4.5"),
    ({'law.kind': None}, "law lacks the key 'kind'; add one of 'inverse_power', 'dipoles', "),
    ({'lattice': 'triangular'}, "lattice must be a table in brackets with a kind, one of 'chain', 'square', 'triangular', "
                                "'honeycomb', 'kagome', 'fcc', 'bcc', 'oscillator', 'file', not 'triangular'"),
    ({'foundation': 19.7},
     'foundation must be a table in brackets with the keys stiffness_N_per_m, pillar, out_of_plane, not 19.7'),
    ({'foundation': {}}, 'foundation has neither of stiffness_N_per_m and [foundation.pillar]; give one'),
    ({'foundation.stiffness_N_per_m': 19.7}, 'foundation has both of stiffness_N_per_m and [foundation.pillar]; give one'),
    ({'foundation': {'stiffness_N_per_m': -19.7}}, 'foundation.stiffness_N_per_m must be a zero or positive number, not -19.7'),
    ({'foundation': {'stiffness_N_per_m': NAN}}, 'foundation.stiffness_N_per_m must be a zero or positive number, not nan'),
    ({'title': 3}, 'title must be text in quotes, not 3'),
    ({'title': ' '}, "title must be text in quotes, not ' '"),
    ({'bands.path': 'GXMG'}, "bands.path of the triangular lattice must join points out of G, M, K, not 'GXMG'"),
    ({'bands.path': 'G'}, "bands.path of the triangular lattice must join points out of G, M, K, not 'G'"),
    ({'bands.path': 'GM,'}, "bands.path of the triangular lattice must join points out of G, M, K, not 'GM,'"),
    ({'bands.path': 'Γ-M'}, "bands.path of the triangular lattice must join points out of G, M, K, not 'Γ-M'"),
    ({'bands.path': ['G', 'M']}, "bands.path must be text in quotes, not ['G', 'M']"),
    ({'bands.points': 1}, 'bands.points must be a whole number of at least 2, not 1'),
    ({'bands.supercell': 3}, 'bands.supercell must be a list in brackets, not 3'),
    ({'bands.supercell': [3]}, 'bands.supercell of the triangular lattice must hold 2 whole numbers, not [3]'),
    ({'bands.supercell': [3, 3, 1]}, 'bands.supercell of the triangular lattice must hold 2 whole numbers, not [3, 3, 1]'),
    ({'bands.supercell': [3, 2.5]}, 'bands.supercell[1] must be a whole number of at least 1, not 2.5'),
    ({'law': {'kind': 'table', 'shells': 1, 'distances_m': 0.01, 'forces_N': [1.0]}},
     'law.distances_m must be a list in brackets, not 0.01'),
    ({'law': {'kind': 'table', 'shells': 1, 'distances_m': [0.01], 'forces_N': [1.0]}},
     'law: a table needs two columns of at least 4 points, not r (1,) and f (1,)'),
    ({'law': {'kind': 'table', **LAWS['table'], 'shells': 2}},
     'lattice.spacing_m = 0.01, law.shells = 2: distance 17.3205 mm is outside the table (8 to 15 mm); extend'),
    ({'law': {'kind': 'table', **LAWS['table'], 'shells': 1, 'file': 'law.csv'}}, 'law has both file and '),
    ({'law': {'kind': 'table', **LAWS['table'], 'shells': 'all'}},
     "law.shells = 'all': the sum over all neighbours is known for inverse powers and Yukawa repulsion, not for Tabulated"),
    ({'law.shells': 'all', 'law.a': 0.9}, "law.shells = 'all': the force r^-0.9 has no energy r^-s with s = a - 1 > 0"),
    ({'law': {'kind': 'hertz', **LAWS['hertz'], 'shells': 1}, 'lattice.spacing_m': 10 * LAWS['hertz']['diameter_m']},
     'lattice.spacing_m = '),
    ({'law': {'kind': 'hertz', **LAWS['hertz'], 'poisson_ratio': 0.6, 'shells': 1}},
     'law.poisson_ratio must not exceed 0.5, not be 0.6'),
    ({'lattice.relative_masses': [1.0, 2.0]},
     'lattice.relative_masses must hold 1 numbers, one for each particle of the triangular cell, not [1.0, 2.0]'),
    ({'lattice.relative_masses': [0.0]}, 'lattice.relative_masses[0] must be a positive number, not 0.0'),
    ({'law': {'kind': 'table', 'shells': 1, 'file': 'law.csv'}}, 'law.file: '),
    ({'law': {'kind': 'table', 'shells': 1, 'file': 3}}, 'law.file must be the name of a file in quotes, not 3'),
], ids=str)
def test_refused_with_its_name_and_value_and_the_mend(changes, message, scene_file):
    assert refusal(scene_file(changes)).startswith(message)


@pytest.mark.parametrize(('content', 'reason'), [
    ('', 'is empty'), ('r,f\n1,2\n', "the column 'r' says no unit that is known; write r_m, r_mm"),
    ('r_m,f_N\n0.01,strong\n', "f_N is 'strong', not a finite number"), ('r_m,f_N\n0.01\n', 'it has 1 values, not 2'),
    ('r_m,f_N\n0.01,-1\n', 'the forces are negative'), ('r_mm,f_N\n9,2\n11,-0.1\n', 'holds the force -0.1 N at 0.011 m'),
    ('r_mm,f_N\n9,2\n10,1.5\n9,1\n', 'holds the distance 0.009 m more than once')])
def test_refused_file_of_a_law(content, reason, scene_file, tmp_path):
    (tmp_path / 'law.csv').write_text(content)
    message = refusal(scene_file({'law': {'kind': 'table', 'shells': 1, 'file': 'law.csv'}}))
    assert message.startswith('law.file: ')
    assert f'{tmp_path / "law.csv"}' in message
    assert reason in message


def test_a_file_of_a_law_may_have_its_rows_in_any_order(scene_file, tmp_path):
    rows, laws = ['10,0.24', '12,0.1', '14,0.05', '17,0.02', '20,0.01'], []
    for order in ([0, 1, 2, 3, 4], [3, 0, 4, 2, 1]):
        (tmp_path / 'law.csv').write_text('r_mm,f_N\n' + '\n'.join(rows[k] for k in order))
        laws.append(read_scene(scene_file({'law': {'kind': 'table', 'shells': 1, 'file': 'law.csv'}})).law.potential())
    assert laws[0].d2phi(10.0) == laws[1].d2phi(10.0) > 0


def test_all_faults_are_named_at_once(scene_file):
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the message is looked at
        read_scene(scene_file({'lattice.spacing_m': -1.5, 'bands.points': 0, 'law.a': 'four'}))
    assert [line.split(': ')[1].split(' must')[0] for line in str(caught.value).splitlines()] == [
        'lattice.spacing_m', 'law.a', 'bands.points']


@pytest.mark.parametrize(('changes', 'words'), [
    ({'lattice.mass_kg': 0.707}, 'lattice.mass_kg = 0.707 and lattice.spacing_m = 0.01 make 7.1e[+]02 g/cm3'),
])
def test_a_mass_in_another_unit(changes, words, scene_file):
    with pytest.warns(UserWarning, match=words):
        read_scene(scene_file(changes))


@pytest.mark.parametrize(('name', 'old', 'new', 'words'), [
    ('oscillator', 'theta0_deg = 30.0', 'theta0_deg = 90.1', 'lattice.theta0_deg must lie between 0 and 90 degrees, not 90.1'),
    ('design', 'branch = 1', 'branch = 3', 'design.edge.branch must be at most 2'),
    ('vacancy', 'vacancies_m = [[0.0, 0.0]]', 'substitutions = [{at_m = [0.0, 0.0], relative_mass = 1.2e6}]',
     r'defects.substitutions[0].relative_mass must lie between 1e-06 and 1e+06'),
    ('vacancy', 'vacancies_m = [[0.0, 0.0]]', 'substitutions = [{at_m = [0.0, 0.0], relative_strength = 1.2e6}]',
     r'defects.substitutions[0].relative_strength must lie between 0 and 1e+06'),
    ('steel', 'diameter_m = 0.02 ', 'diameter_m = 0.2 ', 'the spheres overlap by 90 % of their diameter'),
    ('steel', 'diameter_m = 0.02 ', 'diameter_m = 0.002 ', 'take a smaller one than law.diameter_m = 0.002'),
])
def test_bounds_of_ready_scenes(name, old, new, words, tmp_path):
    text = ready_scene(name).read_text()
    assert old in text
    (tmp_path / 'my.toml').write_text(text.replace(old, new))
    assert words in refusal(tmp_path / 'my.toml')


def test_the_gap_of_a_design_has_a_branch_above(tmp_path):
    text = re.sub(r'\[design.edge\].*', '[design.gap]\nabove_branch = 2\nwidth_Hz = 1.0\n', ready_scene('design').read_text(),
                  flags=re.DOTALL)
    (tmp_path / 'my.toml').write_text(text)
    assert 'design.gap.above_branch must be at most 1' in refusal(tmp_path / 'my.toml')


def test_a_measured_force_in_place_of_the_grade(tmp_path):
    """As the comment of the ready scene says; the force has a tolerance, in proportion to which all forces go."""
    text = ready_scene('disc').read_text().replace('grade = "N45"', '# grade')
    assert '\n# [law.calibration]' in text
    for line in ('[law.calibration]', 'distance_m', 'force_N'):
        text = text.replace(f'# {line}', line)
    (tmp_path / 'my.toml').write_text(text + '\n[uncertainty]\nforce_N = 0.001\n')
    scene = read_scene(tmp_path / 'my.toml')
    law = scene.law.potential()
    assert repulsion(law, 12.0) == pytest.approx(0.05)
    (change,) = scene.uncertainty.tolerances(scene).changes.values()
    assert change.law.dphi(15.0) == pytest.approx(law.dphi(15.0))
    assert repulsion(varied(scene, {'force': 1.1}).law.potential(), 15.0) == pytest.approx(1.1 * repulsion(law, 15.0))
    assert scene.uncertainty.tolerances(scene).covariance[0, 0] == pytest.approx(0.02**2)
    (tmp_path / 'my.toml').write_text(text + '\n[uncertainty]\nremanence_percent = 1.0\n')
    assert 'its parameters are spacing, mass, force' in refusal(tmp_path / 'my.toml')
