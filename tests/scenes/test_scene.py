"""Scenes: what a file turns into, the scenes that come with the package, and what is refused."""

import copy
import json
import math
import tomllib
from importlib.resources import files

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import (
    AllNeighbours,
    MagneticRepulsion,
    analytic_bands,
    finite_displacements,
    phonopy_bands,
    sound_speeds,
    units as u,
)
from magphonon.interactions.pair_laws import repulsion
from magphonon.scenes.scene import read_scene, ready_scene, ready_scenes, reference
from magphonon.stability.buckling import foundation_needed

NAN, INF = math.nan, math.inf
SCENE = tomllib.loads(ready_scene('prototype').read_text())
del SCENE['plan']  # its edge M belongs to the triangular lattice, which tests change

# A law of each kind, with forces of some tenths of a newton at 10 mm
LAWS = {
    'inverse_power': {'b_N_m_a': 1.6209e-10, 'a': 4.5824},
    'dipoles': {'moment_A_m2': 0.0889},
    'yukawa': {'strength_J_m': 1.5e-5, 'screening_length_m': 0.02},
    'coulomb': {'charge_C': 5e-8},
    'hertz': {'diameter_m': 0.0101, 'youngs_modulus_Pa': 1e6, 'poisson_ratio': 0.3},
    'table': {'distances_m': [0.008, 0.01, 0.012, 0.015], 'forces_N': [0.66, 0.2369, 0.103, 0.037]},
}


def toml(value):
    """A value as TOML."""
    if isinstance(value, dict):
        return '{' + ', '.join(f'{key} = {toml(item)}' for key, item in value.items()) + '}'
    if isinstance(value, list):
        return '[' + ', '.join(map(toml, value)) + ']'
    return repr(value) if isinstance(value, float) else json.dumps(value)


@pytest.fixture
def scene_file(tmp_path):
    """A function that writes the prototype's scene with changes, {'law.a': 3.0}; a value of None removes the key."""
    def write(changes, base=SCENE):
        scene = copy.deepcopy(base)
        for name, value in changes.items():
            *tables, key = name.split('.')
            table = scene
            for step in tables:
                table = table[step]
            table[key] = value
            if value is None:
                del table[key]
        file = tmp_path / 'my.toml'
        file.write_text(''.join(f'{key} = {toml(value)}\n' for key, value in scene.items()))
        return file
    return write


def refusal(file):
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the caller looks at the message
        read_scene(file)
    message = str(caught.value)
    assert message.startswith(f'{file}: ')
    assert 'pydantic' not in message
    assert 'http' not in message
    return message.removeprefix(f'{file}: ')


# --- what comes with the package -------------------------------------------------------------------------------------

def test_prototype_is_the_papers(tmp_path):
    """Frequencies of the supplement, recomputed in 50-digit arithmetic; 1e-9 is the accuracy wanted, round-off is 1e-14."""
    numbers = reference()['prototype']
    scene = read_scene(ready_scene('prototype'))
    atoms = scene.atoms()
    assert_allclose(scene.foundation.k / (u.N / u.m), numbers['k_eq'], rtol=1e-9)
    assert_allclose(repulsion(atoms.calc.potential, 10 * u.mm) / u.N, numbers['f_at_spacing'], rtol=1e-9)
    path = scene.band_path()
    assert len(path.kpts) == 300
    for model in ('complete', 'conventional'):
        bands = analytic_bands(atoms, path, model=model).frequencies_Hz
        at = {name: abs(path.kpts - point).max(axis=1).argmin() for name, point in path.special_points.items()}
        assert_allclose(bands[at['G']], [numbers['gamma_Hz']] * 2, rtol=1e-9)
        assert_allclose(bands[at['M']], numbers[f'M_{model}_Hz'], rtol=1e-9)
        assert_allclose(bands[at['K']], [numbers[f'K_{model}_Hz']] * 2, rtol=1e-9)


def test_ideal_is_the_papers():
    numbers = reference()['triangular']
    atoms = read_scene(ready_scene('ideal')).atoms()
    for model, end in {'complete': '', 'conventional': '_conventional'}.items():
        speeds = sound_speeds(atoms, model=model) / (u.m / u.s)
        assert_allclose(speeds, [numbers['c_T' + end], numbers['c_L' + end]], rtol=1e-9)


def test_chain_holds_only_because_of_its_foundation():
    atoms = read_scene(ready_scene('chain')).atoms()
    f = 1e4 * u.N
    needed, softest = foundation_needed(atoms)
    assert_allclose(needed, 4 * f / u.m, rtol=1e-12)  # alternate particles step aside, each against two bonds: 4 f/L0
    assert_allclose(softest, [0.5, 0, 0])
    assert atoms.calc.parameters.foundation > needed


def test_every_ready_scene_reads_and_says_where_its_numbers_come_from():
    assert {'prototype', 'ideal', 'chain'} <= set(ready_scenes())
    for file in ready_scenes().values():
        assert read_scene(file).title
        numbers = [line for line in file.read_text().splitlines() if '=' in line and any(c.isdigit() for c in line.split('#')[0])
                   and not line.startswith(('#', 'title'))]
        assert numbers
        assert all('#' in line for line in numbers), f'{file.name} has a number without its source'


def test_reference_is_what_the_formulas_give():
    """The closed forms of the paper; digits as printed in data/reference.toml."""
    tables = reference()
    t, p, o = tables['triangular'], tables['prototype'], tables['oscillator']
    a, f = 4, 1e4
    assert_allclose(t['M_complete'], np.sqrt([(2 * a - 6) * f, (6 * a - 2) * f]), rtol=1e-12)
    assert_allclose(t['M_conventional'], np.sqrt([2 * a * f, 6 * a * f]), rtol=1e-12)
    assert_allclose([t['c_T'], t['c_L']], np.sqrt([3 / 8 * (a - 3) * f, 3 / 8 * (3 * a - 1) * f]), rtol=1e-12)
    assert_allclose(p['f_at_spacing'], p['b'] * p['spacing'] ** -p['a'], rtol=1e-11)
    inertia = math.pi * p['pillar_radius'] ** 4 / 4
    assert_allclose(p['k_eq'], 3 * p['youngs_modulus'] * inertia / p['pillar_height'] ** 3, rtol=1e-10)
    assert_allclose(np.add(o['D_xx'], o['D_yy']), 3 * (a - 1) * f, rtol=1e-12)  # traces: three bonds, (a - 1) f/L0 each
    assert files('magphonon.data').joinpath('reference.toml').read_text().count('arXiv:1911.10410')


# --- what a file turns into ------------------------------------------------------------------------------------------

@pytest.mark.parametrize('kind', LAWS)
def test_every_law(kind, scene_file):
    """Forces in SI by the formula of each law, at 10 and 11 mm."""
    scene = read_scene(scene_file({'law': {'kind': kind, **LAWS[kind], 'shells': 1}}))
    r = np.array([0.010, 0.011])
    expected = {
        'inverse_power': 1.6209e-10 * r**-4.5824,
        'dipoles': 3e-7 * 0.0889**2 * r**-4.0,  # 3 mu0/(4 pi) = 3e-7 N/A^2
        'yukawa': 1.5e-5 * np.exp(-r / 0.02) * (1 / r**2 + 1 / (0.02 * r)),
        'coulomb': 8.9875517862e9 * 5e-8**2 * r**-2,
        'hertz': 1e6 * np.sqrt(0.0101) / (3 * (1 - 0.3**2)) * np.maximum(0.0101 - r, 0) ** 1.5,
        'table': [0.2369, np.nan],
    }[kind]
    known = np.isfinite(expected)
    # mu0 departs from 4e-7 pi by 1.3e-10 in CODATA 2022; the other conversions are exact to round-off
    assert_allclose(repulsion(scene.law.potential(), r * u.m)[known], np.array(expected)[known] * u.N, rtol=1e-9)


@pytest.mark.parametrize(('kind', 'path', 'particles', 'supercell'), [
    ('chain', 'GX', 1, [3]), ('square', 'GXMG', 1, [3, 3]), ('triangular', 'GM,KG', 1, [4, 3]), ('honeycomb', 'GMKG', 2, [3, 3]),
    ('kagome', 'GMKG', 3, [2, 2]), ('fcc', 'GXWKGL', 1, [3, 3, 3]), ('bcc', 'GHNGP', 1, [3, 3, 3])])
def test_every_lattice(kind, path, particles, supercell, scene_file):
    scene = read_scene(scene_file({'lattice.kind': kind, 'bands.path': path, 'bands.supercell': supercell}))
    atoms = scene.atoms()
    assert len(atoms) == particles
    assert_allclose(atoms.get_masses(), 0.707)  # g
    assert_allclose(atoms.calc.bonds.lengths, 10)  # mm
    assert scene.band_path().path == path
    assert scene.supercell() == (*supercell, *[1] * (3 - len(supercell)))


def test_foundation_in_each_form(scene_file):
    stiffness = {'foundation': {'stiffness_N_per_m': 12.5}}
    assert read_scene(scene_file(stiffness)).atoms().calc.parameters.foundation == pytest.approx(12.5e-3, rel=1e-15)  # N/mm
    assert read_scene(scene_file({'foundation': None})).atoms().calc.parameters.foundation == 0


def test_law_from_a_file_beside_the_scene(scene_file, tmp_path):
    columns = LAWS['table']
    rows = zip(columns['distances_m'], columns['forces_N'], strict=True)
    text = '# from a spreadsheet\nr_m, f_N\n' + ''.join(f'{r},{f}\n' for r, f in rows) + '\n'
    (tmp_path / 'law.csv').write_text(text, encoding='utf-8-sig')
    inside = read_scene(scene_file({'law': {'kind': 'table', **columns, 'shells': 1}}))
    beside = read_scene(scene_file({'law': {'kind': 'table', 'file': 'law.csv', 'shells': 1}}))
    assert beside.law.distances_m == pytest.approx(inside.law.distances_m, rel=4e-16)  # m into mm and back
    assert beside.law.forces_N == inside.law.forces_N


def test_a_measured_law_gives_the_bands_of_the_true_one(scene_file):
    """A table of 9 points of the prototype's law: a straight line in log-log, so the spline is exact to round-off."""
    r = [0.006 + 0.001 * k for k in range(9)]
    true = read_scene(ready_scene('prototype'))
    table = {'kind': 'table', 'distances_m': r, 'forces_N': [1.6209e-10 * x**-4.5824 for x in r], 'shells': 1}
    measured = read_scene(scene_file({'law': table}))
    expected = analytic_bands(true.atoms(), true.band_path()).omega
    assert_allclose(analytic_bands(measured.atoms(), measured.band_path()).omega, expected, rtol=1e-10)
    table['forces_N'][4] *= 1.01  # the control: one point at 10 mm off by 1 % shows
    wrong = read_scene(scene_file({'law': table}))
    assert abs(analytic_bands(wrong.atoms(), wrong.band_path()).omega / expected - 1).max() > 1e-3


@pytest.mark.parametrize('name', ['neighbours', 'wigner', 'dust'])
def test_scenes_of_all_neighbours(name):
    """`shells = "all"` is what many shells tend to, and phonopy agrees where the wave fits its supercell."""
    scene = read_scene(ready_scene(name))
    atoms = scene.atoms()
    assert isinstance(atoms.calc, AllNeighbours)
    corners = atoms.cell.bandpath('GMK', npoints=3, pbc=atoms.pbc)
    exact = analytic_bands(atoms, corners).omega
    other = phonopy_bands(finite_displacements(atoms, scene.supercell()), corners).omega
    assert_allclose(other[1:], exact[1:], rtol=1e-7)
    few, many = (analytic_bands(with_bonds(scene, shells), corners).omega for shells in (1, 40))
    assert abs(many - exact).max() < 0.5 * abs(few - exact).max()


def with_bonds(scene, shells):
    atoms = scene.cell()
    k = scene.foundation.k if scene.foundation else 0.0
    atoms.calc = MagneticRepulsion(atoms, scene.law.potential(), shells=shells, foundation=k)
    return atoms


@pytest.mark.parametrize('name', ['fcc', 'steel'])
def test_other_matter_by_both_roads(name):
    scene = read_scene(ready_scene(name))
    numerical = phonopy_bands(finite_displacements(scene.atoms(), scene.supercell()), scene.band_path()).omega
    exact = analytic_bands(scene.atoms(), scene.band_path()).omega
    top = exact.max() ** 2
    # of squares, as zero frequencies are roots of round-off; in space phonopy has all three branches
    assert_allclose(np.sign(numerical) * numerical**2, np.sign(exact) * exact**2, rtol=0, atol=1e-8 * top)
    conventional = analytic_bands(scene.atoms(), scene.band_path(), model='conventional').omega
    assert abs(conventional**2 - exact**2).max() > 5e-5 * top  # the control; in steel D* is but 1e-4 of D0


def test_masses_by_turns_part_the_branches_at_K():
    """Two sublattices that do not couple at K: with equal masses two branches meet there."""
    scene = read_scene(ready_scene('honeycomb'))
    atoms = scene.atoms()
    assert_allclose(atoms.get_masses(), [0.707, 1.0605])
    gaps = []
    for masses in (atoms.get_masses(), [0.707, 0.707]):
        atoms.set_masses(masses)
        path = atoms.cell.bandpath('K', npoints=1, pbc=atoms.pbc)
        f = analytic_bands(atoms, path).frequencies_Hz[0]
        gaps.append(f[2] - f[1])
    assert gaps[0] > 10
    assert abs(gaps[1]) < 1e-9


def test_pillars_with_mass(scene_file):
    """Aluminium pillars: 33/140 of 0.802 g moves with each magnet, 27 % of its mass."""
    scene = read_scene(scene_file({'foundation.pillar.density_kg_per_m3': 2700}))
    expected = 0.707 + 33 / 140 * 2700e-6 * math.pi * 0.79375**2 * 150
    assert_allclose(scene.atoms().get_masses(), expected, rtol=1e-12)
    assert_allclose(scene.patch_atoms().get_masses(), expected, rtol=1e-12)
    assert expected / 0.707 == pytest.approx(1.27, abs=0.005)
    message = refusal(scene_file({'foundation.pillar.density_kg_per_m3': 2700, 'uncertainty': {'mass_kg': 1e-5}}))
    assert message.startswith('foundation.pillar.density_kg_per_m3: [uncertainty] and [design] treat pillars as massless')


def test_a_patch_of_all_neighbours_is_refused(scene_file):
    scene = read_scene(scene_file({'law.shells': 'all'}))
    with pytest.raises(ValueError, match=r"law\.shells = 'all'"):
        scene.patch_atoms()


def test_scene_feeds_phonopy():
    scene = read_scene(ready_scene('chain'))
    numerical = phonopy_bands(finite_displacements(scene.atoms(), scene.supercell()), scene.band_path())
    exact = analytic_bands(scene.atoms(), scene.band_path())
    # the curvature of the law leaves some (d/L0)^2 = 1e-10 at the default displacement
    assert_allclose(numerical.omega, exact.omega, atol=1e-8 * exact.omega.max())


def test_a_scene_does_not_change():
    scene = read_scene(ready_scene('prototype'))
    with pytest.raises(ValueError, match='frozen'):
        scene.lattice.spacing_m = 0.02


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


REQUIRED = ['title', 'lattice', 'law', 'lattice.kind', 'lattice.spacing_m', 'lattice.mass_kg', 'law.b_N_m_a', 'law.a',
            'law.shells', 'bands.path', 'bands.points', 'bands.supercell', 'foundation.pillar.radius_m',
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
                                    "'fcc', 'bcc', 'oscillator', not 'hexagonal'"),
    ({'law.kind': 'gravity'}, "law.kind must be one of 'inverse_power', 'dipoles', 'coulomb', 'yukawa', 'hertz', 'table', "
                              "'magnets', not 'gravity'"),
    ({'law.kind': ['dipoles']}, "law.kind must be one of 'inverse_power', 'dipoles', 'coulomb', 'yukawa', 'hertz', 'table', "
                                "'magnets', not ['dipoles']"),
    ({'law.kind': 'dipoles'}, "law has no key 'b_N_m_a'; its keys are kind, moment_A_m2, shells"),
    ({'law.cutoff_m': 0.02}, "law has no key 'cutoff_m'; its keys are kind, b_N_m_a, a, shells"),
    ({'law': 4.5}, 'law must be a table [law] with a kind, one of inverse_power, dipoles, coulomb, yukawa, hertz, table, '
                   'magnets, not 4.5'),
    ({'law.kind': None}, 'law must be a table [law] with a kind, one of'),
    ({'lattice': 'triangular'},
     "lattice must be a table in brackets with the keys kind, spacing_m, mass_kg, relative_masses, not 'triangular'"),
    ({'foundation': 19.7}, 'foundation must be a table in brackets with the keys stiffness_N_per_m, pillar, not 19.7'),
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
    ({'law': {'kind': 'table', **LAWS['table'], 'shells': 2}}, 'distance 17.3205 mm is outside the table (8 to 15 mm); extend'),
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
    ('', "begins with ''; its header must be r_m,f_N"), ('r,f\n1,2\n', "begins with 'r,f'; its header must be r_m,f_N"),
    ('r_m,f_N\n0.01,strong\n', "line 2: '0.01,strong' is not 2 numbers"), ('r_m,f_N\n0.01\n', "line 2: '0.01' is not 2 numbers"),
    ('r_m,f_N\n0.01,nan\n', "line 2: '0.01,nan' is not 2 numbers"), ('r_m,f_N\n0.01,-1\n', 'force 1 is -1 N')])
def test_refused_file_of_a_law(content, reason, scene_file, tmp_path):
    (tmp_path / 'law.csv').write_text(content)
    message = refusal(scene_file({'law': {'kind': 'table', 'shells': 1, 'file': 'law.csv'}}))
    assert message.startswith(f'law.file: {tmp_path / "law.csv"}')
    assert reason in message


def test_all_faults_are_named_at_once(scene_file):
    with pytest.raises(ValueError) as caught:  # noqa: PT011, the message is looked at
        read_scene(scene_file({'lattice.spacing_m': -1.5, 'bands.points': 0, 'law.a': 'four'}))
    assert [line.split(': ')[1].split(' must')[0] for line in str(caught.value).splitlines()] == [
        'lattice.spacing_m', 'law.a', 'bands.points']
