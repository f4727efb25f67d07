"""Lattices from measured ridges: what is not determined, the evidence for D*, and what a report says."""

import re
import tomllib
from dataclasses import replace

import numpy as np
import pytest
from oracles import Pairs, lattice
from ridge_lattices import Drawn
from scans import Experiment, scene_text, triangular_branches
from scene_files import ready_scene
from scipy.stats import binom

from magphonon import InversePower, read_scene
from magphonon.bands.bloch import bloch_modes
from magphonon.cli.fit_report import band_report
from magphonon.cli.main import main
from magphonon.design.least_squares import DETERMINED
from magphonon.scenes import fit_bands
from magphonon.scenes.band_fits import MODELS, NEAREST, TELLS, parameters_of, with_factors
from magphonon.waves import Scan, read_ridges, scan_waves
from magphonon.waves.ridge_tables import RidgePoints, write_ridges

NORMAL = 1.96
ALONG = {'K': ([1, 0.5, 0], 0), 'M': ([0, 1, 0], 90)}
"""Wavevector at xi = 2 pi in fractions, and its angle to R1: along R1, and across it for rows along R2."""


def measured(rng, truth, modes, sigma=0.005, n=12, toward='K', with_dstar=True, reach=1.0):
    """Ridge points with a noise of their stated size; force, exponent and springs of their lattice of 10 mm are `truth`.

    Neighbours act within `reach` spacings; the closed form of the nearest is that of other tests.
    """
    f, a, k = (truth[name] for name in ('force', 'a', 'foundation'))
    q, angle = ALONG[toward]
    step = 10 * (1 if toward == 'K' else np.sqrt(3) / 2)  # of the phase xi along the wavevector, in mm
    xi = np.concatenate([rng.uniform(0.5, 2.9, n) for _ in modes])
    ridge = np.repeat(np.arange(len(modes)), n)
    both = triangular_branches(xi * 10 / step, angle, 10, 0.7, f / 10 * with_dstar, a * f / 10, k / 1e3)
    if reach > 1:
        of_power = Drawn.with_law('triangular', lambda r: r**-a, f, k / 100 / a / f, reach)
        both = of_power.omega(np.outer(xi / (2 * np.pi), q))
    omega = both[np.arange(len(xi)), np.array(modes)[ridge]]
    motions = tuple(('transverse', 'longitudinal')[mode] for mode in modes)
    noisy = omega * (1 + sigma * rng.normal(size=len(xi)))
    one = np.ones(len(xi))
    return RidgePoints(motions, motions, ridge, np.outer(xi / (2 * np.pi), q), xi, 0 * xi, noisy, sigma * omega, one, 0 * xi,
                       ('row',) * len(modes), 1e-3 * one)  # of a row so long that no source shifts a ridge


def scene_of(folder, truth, mass=7e-4):
    (folder / 'my.toml').write_text(scene_text(0.01, mass, truth['force'] * 0.01 ** truth['a'], truth['a'], truth['foundation']))
    return read_scene(folder / 'my.toml')


TRUTH = {'force': 0.25, 'a': 4.2, 'foundation': 20.0}
START = {'force': 0.22, 'a': 4.6, 'foundation': 23.0}


def holds(fits, truth, model='complete', width=1.0):
    """Whether the interval of each parameter holds the truth."""
    return {name: abs(np.log(value / truth[name])) < width * NORMAL * sigma
            for name, (value, sigma) in fits.values(model).items() if name in truth}


def test_intervals_of_drawn_measurements_hold_the_truth(tmp_path):
    rng, scene, draws = np.random.default_rng(0), scene_of(tmp_path, START), 6
    fits = [fit_bands(scene, measured(rng, TRUTH, (0, 1))) for _ in range(draws)]
    # fewer hits of 8 than this come by a chance of 1e-3; intervals of a quarter of the width, the control, have fewer
    least = binom.ppf(1e-3, draws, 0.95)
    hits, narrow = (np.sum([list(holds(fit, TRUTH, width=width).values()) for fit in fits], axis=0) for width in (1, 0.25))
    assert (hits >= least).all()
    assert (narrow < least).any()
    assert min(fit.evidence for fit in fits) > 5
    assert max(fit.fits['conventional'].chance for fit in fits) < 1e-3
    # the covariance is that of the scatter: chi of 6 draws over the root of 6 is 0.25 to 1.9 but for 1e-3
    scatter = np.std([np.log([value for value, _ in fit.values().values()][:3]) for fit in fits], axis=0)
    stated = np.sqrt(np.diag(np.mean([fit.fits['complete'].covariance for fit in fits], axis=0)))
    assert ((scatter / stated > 0.25) & (scatter / stated < 1.9)).all()


def test_one_branch_does_not_tell_force_from_exponent(tmp_path):
    """Toward M shear has omega^2 m = k + A (1 - cos xi) with one A of both."""
    rng, scene = np.random.default_rng(1), scene_of(tmp_path, START)
    points = measured(rng, TRUTH, (0,), toward='M', n=20)
    fits = fit_bands(scene, points)
    values = fits.values()
    assert min(values[name][1] for name in ('force', 'a')) > DETERMINED
    assert values['foundation'][1] < 0.05
    assert abs(values['foundation'][0] / 20 - 1) < 3 * values['foundation'][1]
    assert abs(fits.evidence) < TELLS  # conventional shear has the same form
    told = band_report(fits, len(points), [])
    assert 'The points cannot decide whether farther neighbours act: ' in told
    assert 'not determined' in told
    assert not re.search(r'force [\d.]+ N', told)
    known = fit_bands(scene_of(tmp_path, START | {'a': 4.2}), points, fixed=['a'])  # of the truth
    assert all(holds(known, TRUTH, width=1.5).values())  # 3 sigma
    law = fit_bands(scene_of(tmp_path, TRUTH | {'foundation': 23.0}), points, fixed=['force', 'a'])  # as from measured forces
    assert law.evidence > 10
    assert holds(law, TRUTH, width=1.5)['foundation']
    wrong = fit_bands(scene, points, fixed=['a'])  # the control: a wrong exponent moves the force
    assert not holds(wrong, TRUTH, width=1.5)['force']


def test_a_lattice_without_static_forces_speaks_against_dstar(tmp_path):
    fits = fit_bands(scene_of(tmp_path, START), measured(np.random.default_rng(2), TRUTH, (0, 1), with_dstar=False))
    assert fits.evidence < -5
    assert fits.fits['conventional'].chance > 0.01 > fits.fits['complete'].chance
    value, sigma = fits.values('conventional')['bond stiffness']
    assert abs(value / (4.2 * 25) - 1) < 3 * sigma
    assert fits.values('conventional')['a'][1] > DETERMINED  # only a f/L is known of D0


@pytest.mark.slow
@pytest.mark.parametrize(('seed', 'far'), [(17, False), (9, True)])
def test_ridges_whose_motion_does_not_tell_find_their_branches(tmp_path, seed, far):
    """From a start that is off, the nearest branch may be another one, which speaks for the wrong model.

    Of 24 starts that are 30 % off one of the 13 that begin so; of 65 that are `far`, force and springs by up to a factor of two,
    one of the 9 that began with several ridges on other branches, and stayed there when one ridge at a time was tried.
    """
    rng, L, a = np.random.default_rng([3, seed]), 10.0, 4.2
    name, with_dstar = str(rng.choice(['honeycomb', 'kagome'])), bool(seed % 2)
    cell, f, k = lattice(name), rng.uniform(0.15, 0.4), rng.uniform(0.2, 0.3)
    xi = np.linspace(0.4, 2.9, 12)
    q = np.outer(xi / (2 * np.pi), [0, 1, 0])
    pairs = Pairs(cell, InversePower(f * L**a, a), 7.9 * L, MODELS[not with_dstar])
    omega = np.sqrt(np.linalg.eigvalsh(pairs.bloch(cell.positions, q) / 0.7 + k / 0.7 * np.eye(2 * len(cell))))
    branches = rng.choice(2 * len(cell), 3, replace=False)
    of_all = np.concatenate(omega.T[branches])
    sigma, n = 2e-3 * of_all.mean(), len(of_all)
    points = RidgePoints(('1', '2', '3'), ('x', 'y', 'x'), np.repeat([0, 1, 2], 12), np.tile(q, (3, 1)),
                         np.tile(xi, 3), np.zeros(n), of_all + sigma * rng.normal(size=n), np.full(n, sigma), np.ones(n),
                         np.zeros(n), sources=('row',) * 3)
    F, A, K = (f, a, k) * np.array([1.3, 1, 0.75])
    if far:
        F, A, K = (f, a, k) * 2 ** (np.random.default_rng([7, seed]).uniform(-1, 1, 3) * [1, 0.5, 1])
    text = scene_text(0.01, 7e-4, F * 0.01**A, A, 1000 * K).replace('triangular', name).replace('shells = 1', 'shells = 2')
    (tmp_path / 'start.toml').write_text(text)
    fits = fit_bands(read_scene(tmp_path / 'start.toml'), points)
    right = fits.fits[MODELS[not with_dstar]]
    assert right.branches == tuple(branches)
    assert right.chance > 1e-3
    assert (fits.evidence > 2) == with_dstar


def test_where_no_model_follows_no_evidence_is_named(tmp_path):
    """Ridges that are taken for those of the other motion, and the control, as they are."""
    rng, scene = np.random.default_rng(6), scene_of(tmp_path, START)
    points = measured(rng, TRUTH, (0, 1))
    told = {}
    for name, motions in (('right', points.motions), ('wrong', points.motions[::-1])):
        found = fit_bands(scene, replace(points, motions=motions))
        told[name] = band_report(found, len(points), [])
        assert found.better.follows == (name == 'right')
    assert 'No model follows these ridges' in told['wrong']
    assert not re.search(r'sigma|for a scene file', told['wrong'])
    assert re.search(r'evidence of [\d.]+ sigma for D\*', told['right'])
    assert 'for a scene file' in told['right']


def test_points_that_share_noise_are_thinned():
    line = 0.01
    omega = 0.2 + line * np.arange(12)
    one = np.ones(12)
    power = np.exp(-((np.arange(12) - 5.2) ** 2) / 20)
    points = RidgePoints(('a', 'b'), ('', ''), np.zeros(12, int), np.outer(omega, [1, 0, 0]), omega, 0 * one, omega, 0.01 * one,
                         power, line * one)
    kept = points.independent
    np.testing.assert_array_equal(np.rint((kept.omega - 0.2) / line), [2, 5, 8, 11])  # from the strongest, every third
    ridge = np.arange(12) % 2  # of two records every second line each: neighbours are two lines apart, too near
    two = replace(points, ridge=ridge).independent
    assert min(np.diff(np.sort(two.omega[two.ridge == k])).min() for k in (0, 1)) > 2.5 * line
    assert len(points[power > 0.5].independent) == 3


def ridges_of(drawn, folder, cell):
    """The table of ridges of the drawn scans, written and read again."""
    records = {}
    for name, t, places, x, y in drawn.scans():
        records[name] = scan_waves(Scan(t, tuple(map(str, range(len(places)))), places, {'x': x, 'y': y}), cell)[:1]
    write_ridges(folder / 'ridges.csv', records)
    return read_ridges(folder / 'ridges.csv')


@pytest.fixture(scope='module')
def experiment(tmp_path_factory):
    """A drawn experiment, its folder with the table of ridges and the scene."""
    folder, drawn = tmp_path_factory.mktemp('experiment'), Experiment([5, 0])
    ridges_of(drawn, folder, read_scene(drawn.scene(folder)).atoms())
    return drawn, folder


def intervals(shown):
    """Name, value and ends of the intervals of the complete model in the report."""
    return {name.split(' (')[0]: tuple(map(float, numbers)) for name, *numbers in re.findall(
        r'^(force|a|foundation|bond stiffness)[^\d]* ([\d.]+), ([\d.]+) to ([\d.]+)', shown, re.M)}


@pytest.mark.slow
def test_the_command_tells_parameters_and_evidence(experiment, capsys, tmp_path):
    drawn, folder = experiment
    # the waves are those of a point: exponent and foundation must be known from elsewhere
    known = ['--prior', f"a={drawn.truth['a']:g}+-3%", '--prior', f"foundation_N_per_m={drawn.truth['foundation']:g}+-5%"]
    assert main(['fit', '--verbose', str(folder / 'ridges.csv'), '--bands', str(folder / 'my.toml'), *known, '-o',
                 str(tmp_path / 'out')]) == 0
    shown = capsys.readouterr().out
    found = intervals(shown)
    assert found.keys() == drawn.truth.keys()
    for name, (_, low, high) in found.items():
        assert low < drawn.truth[name] < high
    assert re.search(r'D\*: the complete model fits better, by \d+.* in chi2, which is evidence of [\d.]+ sigma for D\*', shown)
    assert {'band_fit.png', 'band_fit.txt'} == {file.name for file in (tmp_path / 'out').iterdir()}
    entries = tomllib.loads(shown[shown.index('\n[law]\n') + 1:shown.index('\n\n', shown.index('\n[foundation]\n'))])
    of_entry = entries['law']['b_N_m_a'] / (1e-3 * drawn.L) ** entries['law']['a']  # of the fit with the larger weight
    assert found['force'][1] < of_entry < found['force'][2]
    assert entries['foundation']['stiffness_N_per_m'] == pytest.approx(found['foundation'][0], rel=0.02)
    assert re.search(r'Correlations: a and force -?[01]\.\d\d, foundation and force', shown)
    # the control: a mass that is wrong by 30 % is one of the scene's, and moves the force by as much
    wrong = drawn.scene(tmp_path, mass=1.3)
    known[3] = f"foundation_N_per_m={1.3 * drawn.truth['foundation']:g}+-5%"
    assert main(['fit', '--verbose', str(folder / 'ridges.csv'), '--bands', str(wrong), *known]) == 0
    assert intervals(capsys.readouterr().out)['force'][0] == pytest.approx(1.3 * found['force'][0], rel=0.05)


@pytest.mark.slow
def test_what_makes_a_fit_doubtful_is_said_although_it_is_accepted(tmp_path):
    """Longitudinal ridges of a point source, which an unknown source is taken for; points that name no motion."""
    scene, points = scene_of(tmp_path, START), measured(np.random.default_rng(8), TRUTH, (0, 1))

    def said(points):
        found = fit_bands(scene, points)
        assert found.better.follows
        return band_report(found, len(points), [])

    for sources, biased in (((), True), (('point', 'point'), True), (('point', 'row'), True), (('row', 'row'), False)):
        told = said(replace(points, sources=sources))
        assert ('The values are biased and their intervals wide: the waves come from a point source' in told) == biased
        assert ('0.2 bins for the ' in told) == biased
    assert 'no column motion' not in told
    assert 'The table has no column motion: which branch' in said(replace(points, motions=('', '')))


@pytest.mark.parametrize(('name', 'words', 'message'), [
    ('', ['--fix', 'force_N,a, foundation'], 'all parameters are fixed'),
    ('', ['--fix', 'foundation_N_per_m', '--prior', 'foundation=20+-2'], 'foundation is fixed and has a prior'),
    ('', ['--fix', 'b'], "the fixed parameter must be one of 'force', 'a', 'foundation', not 'b'"),
    ('', ['--spacing', '0.01'], '--spacing belongs to a fit of forces'),
    ('', ['--prior', 'force=0.3+-0.1', '--prior', 'force_N=0.2+-0.1'], '--prior names a parameter twice'),
    ('', ['--prior', 'forces=0.3+-0.1'], "the parameter of --prior must be one of 'force_N', 'a'"),
    ('', ['--prior', 'force_N=0.3'], 'is not a parameter with its value and standard uncertainty, such as force_N=0.288+-0.01'),
    ('', ['--without', 'x'], 'the ridge to be omitted must be one of'),
    ('wigner', [], "law.shells = 'all': the force reaches so far"),
    ('steel', [], 'law.kind must be one of '), ('oscillator', [], "lattice.kind = 'oscillator'"),
])
def test_wrong_words_and_scenes_whose_law_is_not_fitted_are_refused(name, words, message, experiment, capsys):
    _, folder = experiment
    scene = ready_scene(name) if name else folder / 'my.toml'
    assert main(['fit', str(folder / 'ridges.csv'), '--bands', str(scene), *words]) == 2
    assert message in capsys.readouterr().err


@pytest.mark.parametrize(('spoil', 'message'), [
    (lambda a: a[:3], '2 points are too few|independent points are too few for 3 parameters'),
    (lambda a: [*a[:4], a[4].replace('longitudinal', 'x').replace(',0.', ',zero.')], r"line 5 of .* is 'zero\."),
    (lambda a: [a[0], re.sub(r'(motion|verse|dinal),[\d.]+', r'\1,-1', a[1])], 'xi_rad must be a positive phase.*, not -1'),
    (lambda a: [re.sub('(frequency_Hz),sigma_(frequency_Hz)', r'sigma_\1,\2', a[0]), *a[1:]],
     r'line 2 of .*sigma_frequency_Hz must be less than the frequency \(are columns exchanged'),
    (lambda a: [a[0], *('60Hz_complete' + line[line.index(','):] for line in a[1:9]),
                *('60Hz_conventional' + line[line.index(','):] for line in a[9:])], 'ridges of both models'),
])
def test_tables_that_are_no_ridges_are_refused(spoil, message, experiment, capsys, tmp_path):
    _, folder = experiment
    lines = (folder / 'ridges.csv').read_text().splitlines()
    (tmp_path / 'r.csv').write_text('\n'.join(spoil(lines)) + '\n')
    assert main(['fit', str(tmp_path / 'r.csv'), '--bands', str(folder / 'my.toml')]) == 2
    assert re.search(message, capsys.readouterr().err)


@pytest.mark.parametrize(('law', 'names'), [
    ('kind = "yukawa"\nstrength_J_m = 2e-5\nscreening_length_m = 0.004', ('force', 'screening_length', 'foundation')),
    ('kind = "dipoles"\nmoment_A_m2 = 0.1', ('force', 'foundation')),
    ('kind = "table"\ndistances_m = [0.008, 0.009, 0.01, 0.012]\nforces_N = [0.6, 0.37, 0.24, 0.11]', ('force', 'foundation')),
    *((f'kind = "magnets"\nring = {{outer_diameter_m = 0.005, height_m = 0.003}}\n{strength}', ('force', 'foundation'))
      for strength in ('grade = "N45"', 'remanence_T = 1.1')),
])
def test_other_laws_are_fitted_by_their_force_and_shape(law, names, tmp_path):
    """Ridges of the branches of the scene, by the analytic bands; the fit starts from a force and springs that are 20 % off."""
    text = scene_text(0.01, 7e-4, 1.0, 1.0, 20.0)
    before, _, after = text.partition('kind = "inverse_power"')
    (tmp_path / 'my.toml').write_text(before + law + after[after.index('\nshells'):])
    scene = read_scene(tmp_path / 'my.toml')
    scene = scene.with_shells('all' if len(names) == 2 else 1)  # a law of known shape acts between all
    assert parameters_of(scene) == names
    points = measured(np.random.default_rng(4), TRUTH, (0, 1))
    omega = bloch_modes(scene.atoms(), points.q)[0][np.arange(len(points)), points.ridge]
    exact = replace(points, omega=omega, sigma_omega=1e-3 * omega)
    start = with_factors(scene, {'force': 1.2, 'foundation': 0.8} | ({names[1]: 1.1} if len(names) > 2 else {}))
    fits = fit_bands(start, exact)
    law, own = (some.law.potential() for some in (scene, fits.fitted()))
    assert own.dphi(10.0) == pytest.approx(law.dphi(10.0), rel=1e-3)  # 'all' reaches beyond the neighbours of a fit
    assert own.d2phi(10.0) == pytest.approx(law.d2phi(10.0), rel=1e-3)
    assert start.law.potential().dphi(10.0) == pytest.approx(1.2 * law.dphi(10.0), rel=1e-9)  # the control: it started elsewhere
    assert fits.values()['foundation'][0] == pytest.approx(20, rel=1e-3)


@pytest.mark.slow
def test_a_shift_that_all_ridges_of_a_branch_share_is_in_the_intervals(tmp_path):
    """Ridges of a point source, each branch shifted as a whole: the residuals are as good, and only the wide intervals hold."""
    rng, scene = np.random.default_rng(3), scene_of(tmp_path, START)
    exact = measured(rng, TRUTH, (0, 1))
    narrow = fit_bands(scene, exact).values()  # the control: what a fit states that does not know of the shift
    kept, missed = [], []
    for _ in range(6):
        exact = measured(rng, TRUTH, (0, 1))
        step = 0.04 * rng.normal(size=2)[exact.ridge]  # a fifth of a bin of a row of 30 points
        fits = fit_bands(scene, replace(exact, xi=exact.xi + step, q=exact.q * (1 + step / exact.xi)[:, None],
                                        sources=('point', 'point'), bin_xi=0.2 + 0 * exact.xi))
        kept.append(all(holds(fits, TRUTH).values()))
        missed += [abs(np.log(fits.values()[name][0] / TRUTH[name])) > NORMAL * narrow[name][1] for name in TRUTH]
    assert sum(kept) >= 4  # specimens of which each quantity holds, at most 0.15 of them do not; fewer come once in 100
    assert np.mean(missed) > 0.4


@pytest.mark.slow
def test_what_is_known_from_elsewhere_narrows_the_fit(tmp_path):
    rng, scene = np.random.default_rng(5), scene_of(tmp_path, START)
    points = replace(measured(rng, TRUTH, (0, 1)), sources=('point', 'point'), bin_xi=np.full(24, 0.2))
    alone = fit_bands(scene, points)
    known = fit_bands(scene, points, priors={'a': (4.2, 0.05), 'foundation': (20.0, 0.2)})
    assert all(known.values()[name][1] < 0.8 * alone.values()[name][1] for name in TRUTH)
    assert alone.biased
    assert not known.biased
    assert known.fits['complete'].freedom == alone.fits['complete'].freedom + 1  # an exponent always has a prior
    wrong = fit_bands(scene, points, priors={'a': (2.0, 0.02)})  # the control: what is wrong is seen in chi2
    assert wrong.fits['complete'].chi2 > known.fits['complete'].chi2 + 10
    assert 'at what --prior says' in band_report(wrong, 24, [])
    for priors, message in (({'b': (1, 0.1)}, "must be one of 'force', 'a'"), ({'a': (4.2, 3)}, 'known to 50 % or better')):
        with pytest.raises(ValueError, match=message):
            fit_bands(scene, points, priors=priors)
    with pytest.raises(ValueError, match='a is fixed and has a prior'):
        fit_bands(scene, points, ['a'], {'a': (4.2, 0.1)})


def test_ridges_that_are_left_out_widen_the_intervals(tmp_path):
    """One of three ridges is off by a fifth: with it no model follows; without it the fit says what it misses."""
    rng, scene = np.random.default_rng(6), scene_of(tmp_path, START)
    points = measured(rng, TRUTH, (0, 1, 0))
    points = replace(points, names=('a', 'b', 'bad'), omega=points.omega * np.where(points.ridge == 2, 1.2, 1.0))
    assert not fit_bands(scene, points).better.follows
    bare, out = fit_bands(scene, points[points.ridge < 2]), fit_bands(scene, points, without=['bad'])
    assert out.better.follows
    same = [fits.values(part=NEAREST)['force'][0] for fits in (out, bare)]
    assert same[0] == pytest.approx(same[1], rel=1e-9)
    assert out.values()['force'][1] > 5 * bare.values()['force'][1]
    assert 'Omitted from the fit: bad. With them the points scatter' in band_report(out, len(points), [])
    with pytest.raises(ValueError, match="'a', 'b', 'bad'"):
        fit_bands(scene, points, without=['nothing'])


@pytest.mark.slow
def test_the_ridge_that_is_wrong_is_named(tmp_path):
    """One shell made the points, and one of five ridges is off by 2 %; noise of all ridges names none."""
    scene, points = scene_of(tmp_path, START), measured(np.random.default_rng(6), TRUTH, (0, 1, 0, 0, 0))
    points = replace(points, names=('a', 'b', 'bad', 'd', 'e'))
    wrong = replace(points, omega=points.omega * np.where(points.ridge == 2, 1.02, 1.0))
    assert 'Look at the ridge "bad" first' in band_report(fit_bands(scene, wrong), len(points), [])
    assert 'Look at the ridge' not in band_report(fit_bands(scene, wrong, without=['bad']), len(points), [])
    alike = fit_bands(scene, replace(points, omega=points.omega * (1 + 0.02 * np.random.default_rng(1).normal(size=len(points)))))
    assert 'No ridge stands out' in band_report(alike, len(points), [])  # noise of four times what is stated, in all ridges


def scene_of_table(folder, force, a, uncertainty):
    """A scene whose forces are a table, of a force at 10 mm and an exponent."""
    r = np.linspace(0.008, 0.015, 12)
    f = force * (r / 0.01) ** -a
    scene_of(folder, START)
    text = (folder / 'my.toml').read_text()
    law = text[text.index('[law]') : text.index('[foundation]')]
    (folder / 'table.toml').write_text(text.replace(law, '[law]\nkind = "table"\nshells = 1\n'
        f'distances_m = {r.tolist()}\nforces_N = {f.tolist()}\n\n{uncertainty}'))
    return read_scene(folder / 'table.toml')


@pytest.mark.slow
def test_intervals_allow_for_the_exponent_of_a_table(tmp_path):
    """Tables whose exponents are drawn about that of the lattice; the control: taken as exact, they miss the force."""
    rng, held, n = np.random.default_rng(3), np.zeros((2, 2)), 12
    for _ in range(n):
        truth = {'force': rng.uniform(0.15, 0.4), 'a': rng.uniform(3.5, 5), 'foundation': rng.uniform(15, 30)}
        points, a = measured(rng, truth, (0, 1), reach=30.0), truth['a'] + 0.4 * rng.normal()
        for k, known in enumerate(('[uncertainty]\nforce_percent = 8\nexponent = 0.4\n\n', '')):
            fits = fit_bands(scene_of_table(tmp_path, 0.2, a, known), points)
            assert fits.names == ('force', 'foundation')
            held[k] += list(holds(fits, truth).values())
    assert (held[0] >= binom.ppf(1e-3, n, 0.95)).all()
    assert held[1, 0] < 0.5 * n


@pytest.mark.parametrize(('stated', 'steep', 'apart'), [
    (0.25, 0.3, 'deviations apart.\n'), (0.36, 0.001, 'One of the two is wrong')])
def test_the_force_of_a_table_is_compared_with_that_of_the_ridges(tmp_path, stated, steep, apart):
    """The scene has a table of 0.25 N or 0.36 N +- 8 % at 10 mm; the ridges are of 0.25 N."""
    scene = scene_of_table(tmp_path, stated, TRUTH['a'], f'[uncertainty]\nforce_percent = 8\nexponent = {steep}\n\n')
    found = fit_bands(scene, measured(np.random.default_rng(6), TRUTH, (0, 1), reach=30.0))
    assert found.stated == pytest.approx((stated, 0.08 * stated), rel=1e-3)
    told = band_report(found, len(found.points), []) + '\n'
    assert f'The scene states a force of {stated} +- {0.08 * stated:.2g} N' in told
    assert apart in told
    assert f'known to {steep:.2g}; the intervals above include this' in told


def test_two_springs_and_their_frequencies(tmp_path):
    """Pillars with kx unlike ky, from waves across rows along x; one spring for both is the control."""
    (tmp_path / 'two.toml').write_text(scene_text(0.01, 7e-4, 0.22 * 0.01**4.6, 4.6, 23.0) + 'stiffness_y_N_per_m = 23.0\n')
    scene, rng = read_scene(tmp_path / 'two.toml'), np.random.default_rng(7)
    truth = with_factors(scene, {'force': 0.25 / 0.22, 'a': 4.2 / 4.6, 'foundation_x': 20 / 23, 'foundation_y': 27 / 23})
    points = measured(rng, TRUTH, (0, 1), toward='M', n=20)
    omega = bloch_modes(truth.perfect_cell(), points.q)[0][np.arange(40), points.ridge]
    points = replace(points, omega=omega * (1 + 0.003 * rng.normal(size=40)), sigma_omega=0.003 * omega)
    fits = fit_bands(scene, points)
    exact = TRUTH | {'foundation_x': 20.0, 'foundation_y': 27.0}
    assert all(holds(fits, exact, width=1.5).values())
    assert fits.values()['foundation_y'][1] < 0.1
    omega, sigma = fits.predicted(scene.special_points['M'])
    assert abs(np.log(omega / bloch_modes(truth.perfect_cell(), [scene.special_points['M']])[0])).max() < 3 * sigma.max() < 0.05
    with pytest.raises(ValueError, match='ridges of a point source are shifted and cannot determine two springs'):
        fit_bands(scene, replace(points, sources=('point', 'point')))
    one = fit_bands(scene_of(tmp_path, START), points)
    assert one.fits['complete'].chi2 > fits.fits['complete'].chi2 + 20


@pytest.mark.slow
def test_several_tables_are_one_measurement(experiment, capsys, tmp_path):
    _, folder = experiment
    table, scene = folder / 'ridges.csv', str(folder / 'my.toml')
    lines = table.read_text().splitlines()
    parts = [tmp_path / name for name in ('a.csv', 'b.csv')]
    for part, motion in zip(parts, ('transverse', 'longitudinal'), strict=True):
        part.write_text('\n'.join([lines[0], *(line for line in lines[1:] if f',{motion},' in line)]))
    shown = []
    for files in ([table], parts):
        assert main(['fit', '--verbose', *map(str, files), '--bands', scene, '--prior', 'a=4+-10%', '--prior',
                     'foundation_N_per_m=20±3']) == 0
        shown.append(capsys.readouterr().out)
    assert shown[0] == shown[1]
    assert 'before: a = 4 +- 0.4, foundation_N_per_m = 20 +- 3.' in shown[0]
    with pytest.raises(ValueError, match=r'ridges: .* and ridges: .* hold the same numbers'):
        fit_bands(read_scene(scene), read_ridges(table, table))
    assert main(['fit', *map(str, parts)]) == 2
    assert 'a fit of forces takes one table, not 2' in capsys.readouterr().err


@pytest.mark.slow
def test_waves_of_a_point_source_may_follow_the_next_branch(tmp_path):
    """Some points of a longitudinal ridge lie on the shear branch: a fit follows those of a point source, not those of a row."""
    points = measured(np.random.default_rng(9), TRUTH, (0, 1, 1))
    both = bloch_modes(scene_of(tmp_path, TRUTH).perfect_cell(), points.q)[0]
    astray = (points.ridge == 2) & (np.arange(36) % 3 == 0)
    points = replace(points, omega=np.where(astray, both[:, 0], points.omega), sources=('point',) * 3, bin_xi=np.full(36, 0.2))
    fits = fit_bands(scene_of(tmp_path, START), points)
    assert fits.better.follows
    assert not fit_bands(scene_of(tmp_path, START), replace(points, sources=('row',) * 3)).better.follows
