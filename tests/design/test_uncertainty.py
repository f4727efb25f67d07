"""Tolerances propagated to first order, against 40 000 lattices by closed forms, and where that ends."""

import tomllib

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene

from magphonon import MagneticRepulsion, lattices, read_scene, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.main import main
from magphonon.design.sensitivities import StiffnessDerivative, spacing_change
from magphonon.design.uncertainty import Spread, Tolerances, frequency_spread
from magphonon.interactions.pair_laws import InversePower
from magphonon.scenes.band_fits import varied
from magphonon.scenes.scene import PAIRS, Scene
from magphonon.scenes.tolerances import Uncertainty

SAMPLES = 40_000
CHANCE = 0.02  # asked for; 40 000 samples know a standard deviation to 1/sqrt(8e4) = 0.35 %
GMK = [[0, 0, 0], [0.5, 0, 0], [2 / 3, 1 / 3, 0]]
ONE_PERCENT = {f'{name}_percent': 1.0 for name in ('spacing', 'mass', 'force', 'stiffness')} | {'exponent': 0.05}
CASES = {'all': ONE_PERCENT | {'force_percent': 3.0, 'correlation_force_exponent': -0.99},
         'apart': ONE_PERCENT, 'spacing': {'spacing_percent': 1.0}}


@pytest.fixture(scope='module')
def scene():
    return read_scene('prototype')


def samples(tolerances, count=SAMPLES):
    """Factors of the parameters, log-normal because they are positive, by name; of the exponent, what is added to it."""
    normal = np.random.default_rng(1).multivariate_normal(np.zeros(len(tolerances.changes)), tolerances.covariance, count)
    return {name: column if name == 'exponent' else np.exp(column)
            for name, column in zip(tolerances.changes, normal.T, strict=True)}


def closed_form(scene, tolerances):
    """Frequencies of sampled prototypes at Gamma, M (both), K from the paper's formulas, rad/ms, shape (samples, 4)."""
    drawn, L0 = samples(tolerances), scene.lattice.spacing_m
    L, m = L0 * drawn.get('spacing', 1.0), scene.lattice.mass_kg * drawn.get('mass', 1.0)
    a, pillar = scene.law.a + drawn.get('exponent', 0.0), scene.foundation.pillar
    f = scene.law.b_N_m_a * L0**-scene.law.a * drawn.get('force', 1.0) * (L / L0) ** -a
    k, t = 3 * np.pi * pillar.youngs_modulus_Pa * pillar.radius_m**4 / (4 * pillar.height_m**3) / m, f / (L * m)
    k = k * drawn.get('stiffness', 1.0)
    squares = np.broadcast_arrays(k, k + (2 * a - 6) * t, k + (6 * a - 2) * t, k + 4.5 * (a - 1) * t)
    return np.sqrt(np.transpose(squares)) / u.s


def four(spread):
    """Values or deviations at Gamma, M, M, K."""
    return np.array([spread[0, 0], spread[1, 0], spread[1, 1], spread[2, 0]])


@pytest.mark.parametrize('case', CASES)
def test_linear_spread_is_that_of_many_lattices(case, scene):
    tolerances = Uncertainty.model_validate(CASES[case]).tolerances(scene)
    spread = frequency_spread(scene.atoms(), GMK, tolerances)
    drawn = closed_form(scene, tolerances)
    assert_allclose(four(spread.std), drawn.std(axis=0, ddof=1), rtol=CHANCE, atol=1e-12)
    assert_allclose(np.median(drawn, axis=0), four(spread.values), rtol=5 * 1.25 * 0.12 / SAMPLES**0.5)  # of a median, at 12 %
    assert_allclose(spread.std[2, 0], spread.std[2, 1], rtol=1e-9)  # at K, where the branches meet
    if case == 'all':  # the controls: without the correlation, and without D*
        apart = Tolerances(tolerances.changes, np.diag(np.diag(tolerances.covariance)))
        assert abs(four(frequency_spread(scene.atoms(), GMK, apart).std)[1] / drawn[:, 1].std() - 1) > 10 * CHANCE
    if case != 'apart':
        conventional = frequency_spread(scene.atoms(), GMK, tolerances, model='conventional').std
        assert abs(four(conventional)[1] / drawn[:, 1].std() - 1) > 10 * CHANCE


@pytest.mark.parametrize(('percent', 'holds'), [(1.0, True), (2.0, True), (12.0, False), (20.0, False)])
def test_linear_propagation_ends_where_tolerances_are_wide(percent, holds, scene):
    """In the second order std/omega grows by about (2.7 sigma)^2: 4 % at 8 % of spacing."""
    tolerances = Uncertainty(spacing_percent=percent).tolerances(scene)
    linear, drawn = four(frequency_spread(scene.atoms(), GMK, tolerances).std)[1:], closed_form(scene, tolerances).std(axis=0)[1:]
    assert (abs(drawn / linear - 1) < CHANCE).all() == holds


@pytest.mark.parametrize(('foundation', 'holds'), [(8.0, True), (4.001, False), (4.0, False)])
def test_linear_propagation_ends_at_the_verge_of_instability(foundation, holds):
    """The zigzag of a chain, w^2 = k - 4 f/L0 with f = L0^-4: 1 % of L0 is 20 % of what 4.001 leaves of k, many times over."""
    law = InversePower(1.0, 4.0)
    chain = lattices.chain(1.0, 1.0)
    chain.calc = MagneticRepulsion(chain, law, foundation=foundation)
    tolerances = Tolerances({'spacing': StiffnessDerivative(law=spacing_change(law))}, [[1e-4]])
    spread = frequency_spread(chain, [[0.5, 0, 0]], tolerances)
    assert np.isnan(spread.std[0]).tolist() == [foundation == 4, False]  # without stiffness its slope is unbounded
    squares = foundation - 4 * samples(tolerances)['spacing'] ** -5.0
    drawn = np.sign(squares) * np.sqrt(abs(squares))
    assert (abs(drawn.std() / spread.std[0, 0] - 1) < CHANCE) == holds
    assert ((drawn < 0).any()) != holds


def test_contributions_add_up_and_correlated_ones_stay_together(scene):
    spread = frequency_spread(scene.atoms(), GMK, Uncertainty.model_validate(CASES['all']).tolerances(scene))
    parts = spread.contributions
    assert set(parts) == {'spacing', 'mass', 'force, exponent', 'stiffness'}
    assert_allclose(np.sqrt(sum(std**2 for std in parts.values())), spread.std, rtol=1e-12)
    # at Gamma w^2 = k/m: 1 % of each is 0.5 %
    assert_allclose([parts[name][0, 0] / spread.values[0, 0] for name in ('stiffness', 'mass')], [0.005, 0.005], rtol=1e-9)
    assert_allclose(parts['force, exponent'][0], 0, atol=1e-12)


@pytest.mark.parametrize('law', [
    {'kind': 'dipoles', 'moment_A_m2': 0.0889}, {'kind': 'yukawa', 'strength_J_m': 1.5e-5, 'screening_length_m': 0.02},
    {'kind': 'table', 'distances_m': [0.008, 0.01, 0.012, 0.015], 'forces_N': [0.66, 0.2369, 0.103, 0.037]},
    {'kind': 'magnets', 'remanence_T': 1.3, 'ring': {'outer_diameter_m': 6e-3, 'inner_diameter_m': 2e-3, 'height_m': 3e-3}}])
def test_every_law_has_a_force_and_an_exponent(law):
    """Against differences of lattices whose spacing, force or springs are a part in 1e5 off."""
    data = tomllib.loads(ready_scene('prototype').read_text())
    scene = Scene.model_validate({'title': 'x', 'lattice': data['lattice'], 'law': law | {'shells': 1},
                                  'foundation': {'stiffness_N_per_m': 20.0}})
    step = 1e-5  # of a central difference, whose error is some 10 step^2

    def changed(name, factor):
        if name == 'spacing':
            lattice = scene.lattice.model_copy(update={'spacing_m': factor * scene.lattice.spacing_m})
            return scene.model_copy(update={'lattice': lattice})
        if name == 'stiffness':
            return varied(scene, {'stiffness': factor})
        strength = {'dipoles': 'moment', 'yukawa': 'strength', 'table': 'forces', 'magnets': 'remanence'}[law['kind']]
        return varied(scene, {strength: factor ** (0.5 if strength in ('moment', 'remanence') else 1.0)})

    for name in ('spacing', 'force', 'stiffness'):
        tolerances = Uncertainty(**{f'{name}_percent': 1.0}).tolerances(scene)
        up, down = (bloch_modes(changed(name, 1 + e).atoms(), GMK)[0] for e in (step, -step))
        slope = frequency_spread(scene.atoms(), GMK, tolerances).slopes[0]
        assert_allclose(slope, (up - down) / (2 * step), atol=1e-7 * up.max(), err_msg=name)
        assert abs(slope).max() > 0.01 * up.max()


@pytest.mark.parametrize('covariance', [[[1.0, 2.0], [2.0, 1.0]], [[1.0, 0.5], [0.0, 1.0]], [[1.0]], [[np.nan, 0], [0, 1]]])
def test_impossible_covariance_is_refused(covariance):
    with pytest.raises(ValueError, match='covariance'):
        Tolerances({'mass': StiffnessDerivative(mass=1.0), 'k': StiffnessDerivative(foundation=1.0)}, covariance)


@pytest.mark.parametrize(('table', 'words'), [
    ({}, 'names no tolerance; add one'),
    ({'stiffness_y_percent': 1.0}, 'uncertainty.stiffness_y_percent belongs to a spring that the scene does not have'),
    ({'exponent': 0.1, 'correlation_force_exponent': 0.5}, 'needs both force_percent and exponent')])
def test_tolerances_that_make_no_sense_are_refused(table, words, scene):
    with pytest.raises(ValueError, match=words):
        Uncertainty(**table).tolerances(scene)


def test_of_all_neighbours_as_many_are_taken_as_matter(scene):
    every = scene.model_copy(update={'law': scene.law.model_copy(update={'shells': 'all'})})
    tolerances = Uncertainty(spacing_percent=1.0).tolerances(every)
    found = frequency_spread(every.counted().perfect_cell(), GMK, tolerances)
    exact = bloch_modes(every.perfect_cell(), GMK)[0]
    assert_allclose(found.values, exact, rtol=PAIRS)
    assert abs(frequency_spread(scene.perfect_cell(), GMK, tolerances).values / exact - 1).max() > 0.1  # the control


def test_the_command_draws_ribbons_and_prints_deviations(tmp_path, capsys):
    """Without foundation, 1 % of spacing is (a + 1)/2 = 2.5 % of every frequency, and 1 % of the mass 0.5 %: 2.55 % together."""
    text = ready_scene('ideal').read_text().partition('[patch]')[0]
    (tmp_path / 'my.toml').write_text(f'{text}\n[bands]\npath = "GMKG"\npoints = 30\nsupercell = [3, 3]\n'
                                      '[uncertainty]\nspacing_percent = 1.0\nmass_percent = 1.0\n')
    assert main(['bands', str(tmp_path / 'my.toml'), '-o', str(tmp_path / 'out')]) == 0
    columns = np.genfromtxt(tmp_path / 'out' / 'bands_spread.csv', delimiter=',', names=True)
    bands = np.genfromtxt(tmp_path / 'out' / 'bands.csv', delimiter=',', names=True)
    moving = bands['complete_1_Hz'] > 1e-3
    assert moving.sum() == 28  # all but Gamma at both ends, where translations have no deviation
    assert (columns['std_1_Hz'][~moving] == 0).all()
    for branch in (1, 2):
        assert_allclose(columns[f'std_{branch}_Hz'][moving] / bands[f'complete_{branch}_Hz'][moving], np.hypot(0.025, 0.005),
                        rtol=1e-9)
    shown = [line.split() for line in capsys.readouterr().out.splitlines()]
    # omega_M = 141.42 rad/s of the paper is 22.5079 Hz
    assert ['M,', 'branch', '1', '0.574', '0.563', '0.113'] in shown
    assert Spread.load(tmp_path / 'out' / 'bands_spread.npz').names == ('spacing', 'mass')
