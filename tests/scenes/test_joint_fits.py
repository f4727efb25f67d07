"""All records of a lattice in one fit, against a laboratory that shares nothing with the package."""

from dataclasses import replace

import numpy as np
import pytest

from magphonon import read_scene, units as u
from magphonon.cli.fitted import entries_of
from magphonon.cli.main import main
from magphonon.design.joint_fits import Joint, Record, told
from magphonon.interactions import Forces, SharedErrors
from magphonon.interactions.pair_laws import repulsion
from magphonon.response import Dof, TransferFunction
from magphonon.scenes import fit_records
from magphonon.scenes.band_fits import value_of
from magphonon.scenes.frf_fits import responses_of, with_dofs
from magphonon.waves import RidgePoints
from magphonon.waves.ridge_tables import write_points
from workflows import bench_lattice as bench

L = 10e-3
LAWS = {'power': bench.power_law(0.28, 4.6, L), 'two powers': lambda r: 0.18 * (L / r) ** 3.2 + 0.09 * (L / r) ** 6}
DISC = 'kind = "magnets"\ndisc = {diameter_m = 0.005, height_m = 0.005}\nremanence_T = 1.3'
ERRORS = {'distance': 0.1, 'zero': 0.012, 'hysteresis': 0.002, 'backlash': 0.06, 'gain': 0.01}  # mm and N, standard deviations
PAIR = 0.035  # of the force of one pair, of magnets whose strengths scatter by 2.5 %
MASS, SPRINGS = 8e-4, {'triangular': (20.0, 24.0), 'square': (60.0, 72.0)}  # softer ones do not hold the square lattice
REACH = 10 * L  # of the laboratory: where its neighbours end must not show


def table(law, rng, gain=0.0):
    """Fifteen distances there and back, with errors that all rows share."""
    r, way = np.tile(np.linspace(0.8, 2.0, 15) * L, 2), np.repeat([-1.0, 1.0], 15)
    e = {name: size * rng.standard_normal() for name, size in ERRORS.items()}
    f = (1 + e['gain'] + gain + PAIR * rng.standard_normal()) * law(r + 1e-3 * e['distance'] + way * 5e-4 * e['backlash'])[0]
    f = f + e['zero'] + way * e['hysteresis']
    return Forces(1e3 * r, f + np.hypot(0.005, 0.01 * f) * rng.standard_normal(len(r)), None, way)


def ridges(law, rng, clock=0.0, static=True, lattice='triangular'):
    """Eight points of each branch along a row of 25, of which each branch has a shift of its own."""
    xi, branch = np.tile(np.linspace(0.5, 2.6, 8), 2), np.repeat([0, 1], 8)
    vectors, bins, one = bench.triangular(L) if lattice == 'triangular' else L * np.eye(2), 2 * np.pi / 25, np.ones(16)
    true = xi + 0.05 * bins * rng.standard_normal(2)[branch]
    k = np.outer(true, np.linalg.inv(vectors)[:, 1])
    omega = 1e-3 * bench.bloch(law, vectors, REACH, k, MASS, SPRINGS[lattice], static)[np.arange(16), branch] * (1 + clock)
    sigma = 0.25 * 2e-3 * np.pi
    return RidgePoints(('1', '2'), ('transverse', 'longitudinal'), branch, np.outer(xi / (2 * np.pi), [0, 1, 0]), xi, 0.01 * one,
                       omega + sigma * rng.standard_normal(16), sigma * one, one, 0 * one, ('row', 'row'), bins * one)


PATCHES = {'triangular': 'kind = "hexagon"\nside_m = 0.04', 'square': 'kind = "rectangle"\nwidth_m = 0.065\nheight_m = 0.065'}
FRF = """
[frf]
from_Hz = 8
to_Hz = 160
points = 120
damping_per_s = 6.6
force = {at_m = [0, 0], direction_deg = 40}
response = {at_m = [0.01, 0], direction_deg = 0}
"""


def responses(scene, law, rng):
    """Three magnets of a patch of the same batch, seen along x and y, with noise of 1 % of the peak and a gain of 1 %."""
    atoms, push = scene.shaken()[0], np.array([np.cos(0.7), np.sin(0.7)])
    places, w = 1e-3 * atoms.positions[:, :2], 2 * np.pi * np.linspace(8, 160, 120)
    held = np.isin(np.arange(len(atoms)), atoms.constraints[0].index)
    reach = 1.001e-3 * atoms.calc.bonds.lengths.max()  # magnets farther off, all held, add to the springs of a patch
    lab = bench.built(places, law, reach, rng, mass=MASS, springs=SPRINGS[scene.lattice.kind], held=held)
    drive, *seen = (int(np.linalg.norm(places - at, axis=1).argmin()) for at in ((0, 0), (0.01, 0), (-0.015, 0.017), (0, -0.017)))
    u = 1e3 * bench.response(lab, bench.pushed(lab, drive, push), w)[:, seen]  # mm/N
    sigma = 0.01 * abs(u).max()
    u = u * (1 + 0.01 * rng.standard_normal()) + sigma * (rng.standard_normal(u.shape) + 1j * rng.standard_normal(u.shape))
    return [TransferFunction(f'{k}, {axis}', 1e-3 * w, u[:, k, axis], sigma, 0, Dof(seen[k], np.eye(3)[axis]),
                             Dof(drive, [*push, 0])) for k in range(3) for axis in (0, 1)]


def specimen(folder, name, seed, shells='"auto"', lattice='triangular', named=None, **faults):
    """A scene that is some ten percent off, its table and its ridges, and what is true of force, exponent and springs."""
    force_of = LAWS[name] if name in LAWS else bench.disc_force(2.5e-3, 5e-3, 1.3)
    rng, law = np.random.default_rng([seed, len(name)]), bench.tabulated(force_of, 0.62 * L, 1.1 * REACH)
    force, slope = (float(value) for value in law(L))
    truth = {'force': force, 'a': -slope * L / force, 'bond stiffness': -slope,
             'foundation_x': SPRINGS[lattice][0], 'foundation_y': SPRINGS[lattice][1]}
    f, a, x, y = (truth[key] * float(np.exp(0.1 * rng.standard_normal())) for key in truth if key != 'bond stiffness')
    shape = named or f'kind = "inverse_power"\nforce_N = {f}\na = {a}'
    (folder / 'lab.toml').write_text(
        f'title = "lab"\n[lattice]\nkind = "{lattice}"\nspacing_m = {L}\nmass_kg = {MASS}\n[law]\n{shape}\nshells = {shells}\n'
        f'[foundation]\nstiffness_N_per_m = {x}\nstiffness_y_N_per_m = {y}\n[patch]\n{PATCHES[lattice]}\n{FRF}')
    gain = faults.pop('gain', 0.0)
    return read_scene(folder / 'lab.toml'), table(law, rng, gain), ridges(law, rng, lattice=lattice, **faults), truth


def fitted(scene, forces, points):
    return fit_records(scene, {'table': forces}, points, shared=SharedErrors(**ERRORS), pair_sigma=PAIR)


@pytest.mark.slow
@pytest.mark.parametrize('name', LAWS)
def test_a_table_and_ridges_together(tmp_path, name):
    """Every interval holds, and is narrower than that of either record; with nearest neighbours alone the same check fails."""
    *given, truth = specimen(tmp_path, name, 2)
    fits = fitted(*given)
    joint, along = fits.joints['complete'], np.array([*fits.along().values()])
    alone = [np.sqrt(np.diag(along @ joint.alone(record).covariance() @ along.T)) for record in fits.records]
    off = {key: (np.log(value / truth[key]), sigma) for key, (value, sigma) in fits.values().items()}
    assert max(abs(error) / sigma for error, sigma in off.values()) < 3.5  # of five, correlated: once in a thousand
    sigmas = np.array([sigma for _, sigma in off.values()])
    assert (sigmas[:, None] < np.transpose(alone)).all()
    assert (sigmas[:2] < 0.85 * np.min(alone, axis=0)[:2]).all()  # force and exponent, of which each record knows a part
    assert joint.pulls()[0].sigmas < 3
    assert fits.evidence > 10
    head = (tmp_path / 'lab.toml').read_text().split('[law]')[0]
    (tmp_path / 'pasted.toml').write_text('\n'.join([head, *entries_of(fits.fitted())[3:]]))
    pasted = read_scene(tmp_path / 'pasted.toml')
    for key in ('force', 'foundation_x', 'foundation_y'):
        assert value_of(pasted, key) == pytest.approx(fits.values()[key][0], rel=1e-4)  # a force between the readings of a table
    control = fitted(*specimen(tmp_path, name, 2, shells='1')[:3]).values()
    value, sigma = control['foundation_x']  # by 30 % and more, several times the interval that the fit states
    assert np.log(value / truth['foundation_x']) > 3 * sigma


@pytest.mark.slow
def test_transfer_functions_join(tmp_path):
    """They know springs and bonds that a row of waves does not; a table that reads 30 % too much is the one that is named."""
    scene, forces, points, truth = specimen(tmp_path, 'power', 4)
    functions = responses(scene, bench.tabulated(LAWS['power'], 0.62 * L, 1.1 * REACH), np.random.default_rng([4, 99]))
    found = fit_records(scene, {'table': forces}, points, SharedErrors(**ERRORS), PAIR, functions=functions)
    before = fitted(scene, forces, points).values()
    for name, (value, sigma) in found.values().items():
        assert abs(np.log(value / truth[name])) < 3.5 * sigma  # of five, correlated: once in a thousand
        assert sigma < before[name][1]
    assert found.values()['foundation_y'][1] < 0.3 * before['foundation_y'][1]
    assert found.responses['conventional'].square > 2 * found.responses['complete'].square
    assert found.joints['complete'].pulls()[0].sigmas < 3
    joint = found.joints['complete']
    table, *others = joint.records
    wrong = replace(table, estimate=table.estimate + 0.3 * np.eye(len(joint.x))[0])
    first, *_ = Joint(joint.names, told([wrong, *others])[1], (wrong, *others)).pulls()
    assert (first.record, first.fault) == ('table', 'the gain (or the strength of the pair)')
    assert found.laws['an inverse power'] > 0.5
    assert found.one_spring < 0.1  # 20 and 24 N/m, each known to 2 %
    softer = np.log(found.values()['foundation_x'][0] / found.values()['foundation_y'][0])
    same = replace(joint, x=joint.x + softer * np.array([name == 'foundation_y' for name in joint.names]))
    assert replace(found, joints={'complete': same}).one_spring > 0.8


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(2))
def test_transfer_functions_know_no_less_than_nothing_beside_a_table_that_contradicts_them(seed, tmp_path):
    scene, forces, _, _ = specimen(tmp_path, 'power', seed, shells='1')
    rng, omega = np.random.default_rng([seed, 7]), 2 * np.pi * np.linspace(8, 160, 60) * u.Hz
    places = [np.array([*place, angle]) for place in ((10.0, 0.0), (-15.0, 15 / np.sqrt(3))) for angle in (0.0, np.pi / 2)]
    seen = with_dofs(scene, [TransferFunction(f'{k}', omega, 0j * omega, 1.0, 0, place) for k, place in enumerate(places)])
    h = np.array(responses_of(scene, 'complete', seen))
    sigma = 0.01 * abs(h).max()
    h = h + sigma * (rng.standard_normal(h.shape) + 1j * rng.standard_normal(h.shape))
    functions = [replace(one, response=row, sigma=sigma) for one, row in zip(seen, h, strict=True)]
    force = scene.law.potential()
    table = replace(forces, f=1.3 * repulsion(force, forces.r) * (1 + 0.002 * rng.standard_normal(len(forces.r))))
    found = fit_records(scene, {'table': table}, functions=functions).joints['complete']
    for one in found.records:
        known = np.linalg.eigvalsh(one.information / np.sqrt(np.outer(*2 * [np.diag(found.information)])))
        assert known.min() > -1e-9  # round-off
    assert found.pulls()[0].record == 'table'


@pytest.mark.slow
def test_the_law_that_is_true_has_the_weight(tmp_path):
    """Discs that are named rise above their first weight of 0.1, and fall from it where another law is true; so does a power,
    which a table and ridges can only keep apart from laws that bend.
    """
    discs, others = (fitted(*specimen(tmp_path, name, 6, named=DISC)[:3]).laws for name in ('disc', 'two powers'))
    assert discs['the shape in the scene'] > 0.5
    assert others['the shape in the scene'] < 0.01
    power, others = (fitted(*specimen(tmp_path, name, 6)[:3]).laws for name in ('power', 'two powers'))
    assert power['an inverse power'] > 0.05
    assert others['an inverse power'] < 1e-3


@pytest.mark.long
def test_coverage(tmp_path, capsys):
    """Share of intervals that hold the truth, and that are narrower than those of each record; 96 of 96 would be chance, too."""
    held, narrower, errors, widths = [], [], [], []
    for name in LAWS:
        for seed in range(10, 22):
            *given, truth = specimen(tmp_path, name, seed)
            fits = fitted(*given)
            joint, along = fits.joints['complete'], np.array([*fits.along().values()])
            error, sigma = np.transpose([(np.log(value / truth[key]), sigma) for key, (value, sigma) in fits.values().items()])
            alone = [np.sqrt(np.diag(along @ joint.alone(record).covariance() @ along.T)) for record in fits.records]
            held.append(abs(error) < 1.96 * sigma)
            narrower.append((sigma < np.min(alone, axis=0)).all())
            errors.append(error)
            widths.append(1.96 * sigma)
            assert fits.evidence > 0
    with capsys.disabled():
        print(f'\n{[*truth]}: hold {np.mean(held, axis=0)}, half widths (%) {100 * np.median(widths, axis=0)}, rms errors (%) '
              f'{100 * np.sqrt(np.mean(np.square(errors), axis=0))}; narrower {np.sum(narrower)} of {len(narrower)}')
    assert np.mean(held) >= 0.9
    assert all(narrower)


@pytest.mark.long
def test_coverage_with_transfer_functions(tmp_path, capsys):
    """The same of 24 specimens with transfer functions, and faults of 4 sigma that are planted in each of their records."""
    errors, halves, narrower, found, first, false = [], [], [], [], [], []
    for lattice in PATCHES:
        for name in LAWS:
            for seed in range(30, 36):
                scene, forces, points, truth = specimen(tmp_path, name, seed, lattice=lattice)
                law, rng = bench.tabulated(LAWS[name], 0.62 * L, 1.1 * REACH), np.random.default_rng([seed, 99])
                fits = fit_records(scene, {'table': forces}, points, SharedErrors(**ERRORS), PAIR,
                                   functions=responses(scene, law, rng))
                joint, along = fits.joints['complete'], np.array([*fits.along().values()])
                error, sigma = np.transpose([(np.log(value / truth[key]), sigma)
                                             for key, (value, sigma) in fits.values().items()])
                alone = [np.sqrt(np.diag(along @ joint.alone(one.name).covariance() @ along.T)) for one in joint.records[:-1]]
                errors.append(100 * error)
                halves.append(196 * sigma)
                narrower.append((sigma < np.min(alone, axis=0)).all())
                false.append(joint.pulls()[0].sigmas > 2.7)
                C = joint.covariance()
                for k, one in enumerate(joint.records[:-1]):
                    for fault, v in one.faults.items():
                        seen = v @ (one.information - one.information @ C @ one.information) @ v
                        if not any((pull.record, pull.fault) == (one.name, fault) for pull in joint.pulls()):
                            continue  # nothing else knows what it moves
                        wrong = [*joint.records]
                        wrong[k] = replace(one, estimate=one.estimate + 4 / np.sqrt(seen) * v)
                        pulls = Joint(joint.names, told(wrong)[1], tuple(wrong)).pulls()
                        mine = next(pull for pull in pulls if (pull.record, pull.fault) == (one.name, fault))
                        found.append(mine.sigmas > 2.7)
                        first.append(pulls[0].record == one.name)
                with capsys.disabled():
                    print(f'{lattice}, {name} {seed}:', {key: f'{e:.2f} of {h:.2f}' for key, e, h in zip(
                        truth, errors[-1], halves[-1], strict=True)}, f'narrower: {narrower[-1]}; faults found '
                          f'{np.sum(found)}, right first {np.sum(first)} of {len(found)}', flush=True)
    held = abs(np.array(errors)) < halves
    with capsys.disabled():
        for key, h, half, error in zip(truth, held.sum(axis=0), np.median(halves, axis=0), np.transpose(errors), strict=True):
            print(f'{key}: {h} of {len(held)} hold, half width {half:.2f} %, 1.96 rms error '
                  f'{1.96 * np.sqrt(np.mean(error**2)):.2f} %')
        print(f'all: {held.mean():.3f}; narrower {np.sum(narrower)} of {len(narrower)}; faults found {np.mean(found):.2f}, right '
              f'first {np.mean(first):.2f}, none planted but one named {np.mean(false):.2f}')
    assert held.mean() >= 0.9
    assert all(narrower)
    assert np.mean(found) >= 0.8


@pytest.mark.slow
def test_a_lattice_without_static_forces(tmp_path):
    """The table knows the forces, and the ridges that they are not there."""
    assert fitted(*specimen(tmp_path, 'power', 3, static=False)[:3]).evidence < -5


def records_of(rng, size, fault=''):
    """Three records of two parameters, drawn about the truth 0; `fault` moves that of one by `size` units of its pull."""
    sizes = {'table': (0.04, 0.5), 'ridges': (0.08, 0.03), 'responses': (0.03, 0.03)}
    moved = {'table': np.array([1.0, 0.0]), 'ridges': np.array([1.0, 1.0]), 'responses': np.array([1.0, -1.0])}
    infos = {name: np.diag(np.array(s) ** -2.0) for name, s in sizes.items()}
    total = sum(infos.values()) + 1e-2 * np.eye(2)
    records = []
    for name, s in sizes.items():
        M = infos[name] - infos[name] @ np.linalg.inv(total) @ infos[name]
        x = s * rng.standard_normal(2) + (name == fault) * size / np.sqrt(moved[name] @ M @ moved[name]) * moved[name]
        records.append(Record(name, x, np.zeros(2), infos[name], {'gain': moved[name]}))
    records.append(Record('known before', np.zeros(2), np.zeros(2), 1e-2 * np.eye(2)))
    return Joint(('force', 'spring'), told(records)[1], tuple(records))


def test_planted_contradictions_are_found():
    """A fault of 4 sigma is found beyond 2.7 in 0.90 by the normal distribution, and the right record is named first."""
    rng = np.random.default_rng(0)
    found, first = [], []
    for fault in ('table', 'ridges', 'responses') * 100:
        pulls = records_of(rng, 4.0, fault).pulls()
        found.append(max(pull.sigmas for pull in pulls if pull.record == fault) > 2.7)
        first.append(pulls[0].record == fault)
    assert np.mean(found) > 0.85  # 0.903 +- 0.017
    assert np.mean(first) > 0.8
    agree = [records_of(rng, 0.0) for _ in range(300)]
    assert np.mean([joint.pulls()[0].sigmas > 2.7 for joint in agree]) < 0.05  # three faults of 0.007 each: 0.02
    pulls = np.array([[pull.sigmas for pull in joint.pulls() if pull.record == 'table'] for joint in agree])
    assert 0.85 < np.sqrt(np.mean(pulls**2)) < 1.15  # 1 +- 0.04: what a pull is counted in is what it scatters by
    contradictions = np.array([joint.contradiction('table') for joint in agree])
    assert abs(np.mean(contradictions < 1) - 0.683) < 0.11  # a probability, as of a normal distribution: +- 0.027


def test_another_record_narrows_as_it_says():
    """The width foretold for the same record once more is that of a fit with both."""
    joint = records_of(np.random.default_rng(1), 0.0)
    again = Joint(joint.names, joint.x, (joint.records[0], *joint.records))
    np.testing.assert_allclose(again.covariance(), joint.covariance(joint.records[0].information))
    assert (again.sigma < joint.sigma).all()


@pytest.mark.slow
def test_files_are_recognised_by_what_they_hold(tmp_path, capsys):
    _, forces, points, _ = specimen(tmp_path, 'power', 4, gain=0.3)
    rows = [f'{r!r},{f!r},{"approach" if way < 0 else "return"}'
            for r, f, way in np.stack([forces.r, forces.f, forces.direction], 1).tolist()]
    (tmp_path / 'a.csv').write_text('\n'.join(['r_mm,f_N,direction', *rows]))
    write_points(tmp_path / 'b.csv', points)
    lab, a, b = (str(tmp_path / name) for name in ('lab.toml', 'a.csv', 'b.csv'))
    assert main(['fit', '--verbose', lab, b, a, '--pair-sigma', '0.02', '--distance-sigma', '0.1mm',
                 '-o', str(tmp_path / 'out')]) == 0
    told = capsys.readouterr().out
    assert 'gain (or the strength of the pair) would have to be off' in told
    assert 'D*: all records together are evidence of' in told
    assert told.count(' instead of ') == 3
    assert (tmp_path / 'out' / 'joint_fit.txt').read_text() in told + '\n'
    assert main(['fit', lab, a]) == 0
    assert 'At 10 mm the force is ' in capsys.readouterr().out
    (tmp_path / 'h.csv').write_text('frequency_Hz,re_m_per_N,im_m_per_N\n20,0.001,0\n21,0.001,0\n')
    (tmp_path / 'lab.toml').write_text((tmp_path / 'lab.toml').read_text().split('[patch]')[0])
    assert main(['fit', lab, a, str(tmp_path / 'h.csv')]) != 0
    assert "the scene 'lab' has no table [frf]" in capsys.readouterr().err
    (tmp_path / 'c.csv').write_text('colour,size\nred,2\n')
    assert main(['fit', lab, a, str(tmp_path / 'c.csv')]) != 0
    assert 'c.csv is no kind of record that can be read' in capsys.readouterr().err
