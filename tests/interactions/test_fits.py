"""Intervals of fitted forces hold the truth of laws that the fit does not know, from tables whose rows share drawn errors.

The full table, 100 tables a cell (half an hour of one core; in docs/coverage.md):

    python -m pytest -m long -n 0 -s tests/interactions/test_fits.py
"""

import re
import tomllib
from dataclasses import replace
from itertools import product

import numpy as np
import pytest
from scipy.stats import binom

from magphonon import InversePower, magnet_law, units as u
from magphonon.cli.fit_report import force_report
from magphonon.interactions import Cuboid, Ring
from magphonon.interactions.fits import (
    FamilyLaw,
    Fit,
    LawFamily,
    SharedErrors,
    fit_forces,
    scene_entry,
)
from magphonon.interactions.force_tables import Forces
from magphonon.interactions.pair_laws import local_exponent, repulsion

L0 = 10.0
RANGES = (7, 20), (8, 16), (8, 40)
ERRORS = SharedErrors(distance=0.1, zero=12e-3, hysteresis=2e-3, backlash=0.06)  # mm and N, as drawn


class Force:
    """A law by its force alone, its slope by differences."""

    def __init__(self, force):
        self.force = force

    def dphi(self, r):
        return -self.force(r)

    def d2phi(self, r):
        return -(self.force(1.0001 * r) - self.force(0.9999 * r)) / (2e-4 * r)


def over_steel(r, height=6.0):
    """Upright dipoles above a sheet of soft iron: each also sees the image of the other below the sheet."""
    def energy(r):
        s = np.hypot(r, 2 * height)
        return r**-3.0 + s**-3.0 - 12 * height**2 * s**-5.0
    return -300 * (energy(1.0001 * r) - energy(0.9999 * r)) / (2e-4 * r)


LAWS = {
    'disc': magnet_law(Ring(5, 0, 5, 1.32 * u.T)),
    'ring': magnet_law(Ring(6.35, 1.5875, 3.175, 1.3 * u.T)),
    'cuboid': magnet_law(Cuboid(5, 5, 5, 1.3 * u.T)),
    'dipoles': InversePower(2400.0, 4.0),
    'r^-4.58': InversePower(0.24 * L0**4.5824, 4.5824),
    'screened': Force(lambda r: 0.25 * (L0 / r) ** 4 * np.exp(-(r - L0) / 15)),
    'two powers': Force(lambda r: 0.2 * (L0 / r) ** 3 + 0.08 * (L0 / r) ** 7),
    'over steel': Force(over_steel),
}


def table(law, window, seed, errors=None, known=False):
    """Fifteen distances there and back; all but the noise is shared by all rows."""
    rng = np.random.default_rng(seed)
    nearest = getattr(law, 'nearest', 0.0)
    r = np.linspace(max(window[0], nearest + 0.4), window[1], 15)
    r, s = np.concatenate([r, r[::-1]]), np.repeat([-1.0, 1.0], 15)
    drawn = rng.normal(size=5) if errors is None else np.asarray(errors)
    d, zero, hysteresis, backlash, gain = drawn * [ERRORS.distance, ERRORS.zero, ERRORS.hysteresis, ERRORS.backlash, ERRORS.gain]
    f = repulsion(law, np.maximum(r + d + s * backlash / 2, nearest))
    sigma = np.hypot(5e-3, 0.01 * f)
    return Forces(r, (1 + gain) * f + zero + s * hysteresis + sigma * rng.normal(size=30), sigma if known else None, s)


def misses(fit, law):
    """Distance of the answer from the truth: of ln f, ln(-f') and a."""
    return np.array([np.log(fit.force / repulsion(law, L0)), np.log(-fit.slope / law.d2phi(L0)),
                     fit.exponent - local_exponent(law, L0)])


def trial(law, window, shape, tables, errors=ERRORS):
    """Shares of intervals that hold the truth, mean half widths over 1.96 rms errors, mean weight of the shape."""
    fits = [fit_forces(table(law, window, seed), L0, errors, shape) for seed in range(tables)]
    off, half = np.array([misses(fit, law) for fit in fits]), np.array([fit.half_widths for fit in fits])
    return (abs(off) < half).mean(axis=0), half.mean(axis=0) / (1.96 * np.sqrt((off**2).mean(axis=0))), \
        np.mean([fit.weight for fit in fits])


@pytest.mark.long
@pytest.mark.parametrize('named', ['', 'the same', 'disc'])
def test_coverage_over_all_laws_and_ranges(named):
    """Acceptance: f and f' >= 0.88 in each cell and >= 0.94 in the mean, a >= 0.88; half width <= 1.3 x 1.96 rms error.

    Of 100 errors the root mean square is known to 7 %; a cell beyond the limit has 400 tables to decide.
    """
    told = LAWS if not named else ('disc', 'ring', 'cuboid') if named == 'the same' else ('ring',)
    cells = {}
    for window, name in product(RANGES, told):
        shape = LAWS.get(name if named == 'the same' else named)
        cells[window, name] = held, wide, weight = trial(LAWS[name], window, shape, 100)
        print(f'{named:9} {window} {name:10} {held.round(2)} {wide.round(2)} {weight:.3f}', flush=True)
        if (wide[:2] > 1.3).any():
            wide = trial(LAWS[name], window, shape, 400)[1]
            print(f'{"":9} 400 tables: {wide.round(2)}', flush=True)
        assert (held >= (0.90 if named == 'disc' else 0.88)).all()
        assert (wide[:2] <= 1.3).all()
        assert named != 'disc' or weight < 0.05
    mean = np.mean([held for held, *_ in cells.values()], axis=0)
    print(f'{named:9} mean {mean.round(3)}')
    assert (mean[:2] >= 0.94).all()


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'window'), [('ring', (7, 20)), ('screened', (8, 16)), ('over steel', (8, 40))])
def test_intervals_hold_the_truth(name, window):
    held, *_ = trial(LAWS[name], window, None, 30)
    assert (30 * held >= binom.ppf(1e-3, 30, 0.92)).all()  # the least that was measured with 100 tables a cell


def test_errors_that_are_left_out_are_missed():
    """The control: told that the distances are exact, the intervals miss the truth of tables whose zero is 0.15 mm off."""
    exact = SharedErrors(distance=0.0, zero=12e-3, hysteresis=2e-3, backlash=0.0)
    for side in (-1.5, 1.5):
        rows = table(LAWS['disc'], (7, 20), 0, errors=[side, 0, 0, 0, 0])
        told, left_out = (fit_forces(rows, L0, errors) for errors in (ERRORS, exact))
        assert (abs(misses(told, LAWS['disc'])) < told.half_widths)[:2].all()
        assert not (abs(misses(left_out, LAWS['disc'])) < left_out.half_widths)[:2].all()


@pytest.mark.slow
@pytest.mark.parametrize(('true', 'named', 'least', 'most'), [('disc', 'disc', 0.3, 1.0), ('ring', 'disc', 0.0, 0.05)])
def test_a_named_shape_can_win_and_lose(true, named, least, most):
    fits = [fit_forces(table(LAWS[true], (7, 20), seed), L0, ERRORS, LAWS[named]) for seed in range(4)]
    assert least <= np.mean([fit.weight for fit in fits]) <= most
    free = [fit_forces(table(LAWS[true], (7, 20), seed), L0, ERRORS) for seed in range(4)]
    narrower = np.mean([fit.half_widths[1] for fit in fits]) / np.mean([fit.half_widths[1] for fit in free])
    assert (narrower < 0.95) == (true == named)


def test_a_fixed_error_of_one_sigma_is_within():
    for errors in np.eye(5):
        fit = fit_forces(table(LAWS['disc'], (8, 16), 1, errors), L0, ERRORS)
        assert (abs(misses(fit, LAWS['disc'])) < fit.half_widths)[:2].all()


@pytest.mark.parametrize('seed', range(3))
def test_order_repeats_and_negative_forces_change_nothing(seed):
    rows = table(LAWS['disc'], (8, 40), seed)
    assert (rows.f < 0).any() or seed  # far out, where the zero is larger than the force
    order = np.random.default_rng(seed).permutation(30)
    fit = fit_forces(rows, L0, ERRORS)
    shuffled = fit_forces(Forces(rows.r[order], rows.f[order], None, rows.direction[order]), L0, ERRORS)
    apart = [np.log(shuffled.force / fit.force), np.log(shuffled.slope / fit.slope), shuffled.exponent - fit.exponent]
    assert (abs(np.array(apart)) < 0.3 * fit.half_widths).all()  # what is left of the order is a drift
    np.testing.assert_allclose(shuffled.half_widths, fit.half_widths, rtol=0.3)


def test_known_noise_is_used_as_it_is():
    """With noise of its own size the chi2 of the residuals is about their number, and an exact table gives the law itself."""
    fit = fit_forces(table(LAWS['disc'], (7, 20), 3, known=True), L0, ERRORS)
    assert 0.4 < np.mean((fit.residuals / fit.noise) ** 2) < 1.6  # 30 rows: a standard deviation of 0.26
    r = np.linspace(8, 16, 12)
    law = InversePower(2400.0, 4.0)
    exact = fit_forces(Forces(r, repulsion(law, r), 1e-9 * np.ones(12)), L0, SharedErrors(0.0, 0.0, 0.0, 0.0, 0.0))
    np.testing.assert_allclose([exact.force, exact.exponent], [0.24, 4.0], rtol=1e-6)
    assert abs(exact.exponent - 4.5) > 0.4


def test_shares_add_up_and_name_what_dominates():
    loose = fit_forces(table(LAWS['disc'], (7, 20), 0), L0, SharedErrors(distance=0.5, zero=12e-3, backlash=0.0))
    assert sum(loose.shares.values()) == pytest.approx(1)
    assert max(loose.shares, key=loose.shares.get) == 'zero of distance'
    care = fit_forces(table(LAWS['disc'], (7, 20), 0), L0, SharedErrors(distance=0.02, zero=12e-3, backlash=0.0))
    assert care.half_widths[1] < 0.5 * loose.half_widths[1]


def report_of(forces):
    fit = fit_forces(forces, L0, ERRORS)
    return force_report('f.csv', None, forces, fit, ERRORS)


@pytest.mark.slow
def test_faults_of_the_load_cell_are_named():
    """Saturated, warming, and short tables; good ones make no alarm (30 were tried)."""
    for seed in range(4):
        good = table(LAWS['disc'], (7, 20), seed)
        said = report_of(good)
        assert not any(word in said for word in ('saturated', 'rows are correlated', 'are few', 'towards contact'))
    worst = np.sort(good.f)[-4]
    said = report_of(Forces(good.r, np.minimum(good.f, worst), None, good.direction))
    assert f'have the same largest force, {worst:g} N: the load cell was saturated' in said
    nearest = good.r == good.r.min()
    both = replace(good, f=np.minimum(good.f, good.f[nearest].min()))  # the noise of others shows that these were cut
    assert f'2 rows at {good.r.min():g} mm have the same largest force' in report_of(both)
    coarse = Forces(good.r, np.round(good.f, 1), None, good.direction)  # a balance of few digits is not at its end
    assert not coarse.saturated.any()
    soft = replace(good, f=good.f * np.exp(-2 * np.maximum(9 - good.r, 0)))  # the carriage bends
    assert 'the fitted force falls towards contact' in report_of(soft)
    warm = np.sin(np.arange(len(good.r)) / 2)
    assert 'errors of successive rows are correlated' in report_of(replace(good, f=good.f + 0.05 * abs(good.f).max() * warm))
    assert 'rows are too few' in report_of(Forces(good.r[:9], good.f[:9], None, good.direction[:9]))


def test_a_zero_that_contradicts_what_was_told_is_named():
    slack = table(LAWS['ring'], (8, 40), 2, errors=[0, 0, 8.0, 0, 0])  # up and down differ by 32 mN
    assert fit_forces(slack, L0, ERRORS).conflicts[2] > 3
    assert (fit_forces(table(LAWS['ring'], (8, 40), 2), L0, ERRORS).conflicts < 3).all()
    exact = table(LAWS['ring'], (8, 40), 2, errors=[0, 0, 0, 0, 0])
    assert 'A zero of the force' not in report_of(exact)
    zero, sigma = re.search(r'A zero of the force of (\S+) \+- (\S+) N is', report_of(replace(exact, f=exact.f + 0.02))).groups()
    assert abs(float(zero) - 0.02) < 3 * float(sigma) < 0.02


def test_the_entry_of_a_scene_is_the_fit():
    fit: Fit = fit_forces(table(LAWS['disc'], (8, 40), 0), L0, ERRORS)
    entry = tomllib.loads(scene_entry(fit))
    law, told = entry['law'], entry['uncertainty']
    at = law['distances_m'].index(L0 / u.m)
    assert law['forces_N'][at] == pytest.approx(fit.force, rel=1e-6)
    assert told['force_percent'] / 100 * 1.959964 == pytest.approx(fit.half_widths[0], rel=1e-5)
    assert told['exponent'] * 1.959964 == pytest.approx(fit.half_widths[2], rel=1e-5)
    assert local_exponent(fit.law, L0) == pytest.approx(fit.exponent, rel=1e-4)  # a spline through the curve


@pytest.mark.parametrize('digits', [6, 8, 10, 16])
def test_tables_without_noise_have_the_intervals_of_those_with_little(digits):
    """No smooth law is followed to more than some digits: a floor of the noise keeps false certainty and false conflicts out."""
    r = np.linspace(8, 16, 15)
    fit = fit_forces(Forces(r, np.array([float(f'{f:.{digits}g}') for f in (r / L0) ** -4.0])), L0)
    assert 0.15 < fit.half_widths[2] < 0.25  # 0.192 at 6 digits
    assert abs(fit.exponent - 4) < 1e-3
    assert (fit.conflicts < 1).all()


def test_rows_that_scatter_more_than_their_sigma_widen_the_intervals():
    rng, r = np.random.default_rng(5), np.linspace(8, 16, 15)
    f = repulsion(LAWS['dipoles'], r)
    noise = np.hypot(5e-3, 0.01 * f)
    rows = f + noise * rng.normal(size=15)
    right, small = (fit_forces(Forces(r, rows, sigma), L0, ERRORS) for sigma in (noise, noise / 10))
    assert right.scatter == 1
    assert 5 < small.scatter < 16
    assert small.half_widths[2] == pytest.approx(right.half_widths[2], rel=0.5)  # the scatter of 15 rows is known to a fifth
    tiny = noise.copy()
    tiny[0] = 1e-12
    assert np.isfinite(fit_forces(Forces(r, rows, tiny), L0, ERRORS).half_widths).all()


def test_the_unit_of_the_force_does_not_matter():
    rows = table(LAWS['disc'], (7, 20), 1)
    fits = [fit_forces(Forces(rows.r, s * rows.f, None, rows.direction), L0, SharedErrors(0.1, 12e-3 * s, 2e-3 * s, 0.06))
            for s in (1.0, 1e-12)]
    assert fits[1].exponent == pytest.approx(fits[0].exponent, rel=1e-6)
    assert fits[1].force == pytest.approx(1e-12 * fits[0].force, rel=1e-6)


@pytest.mark.parametrize('absurd', [{'gain': 1e300}, {'distance': 1e300}, {'backlash': 1e200}, {'zero': 1e9}])
def test_prior_errors_larger_than_the_table_are_refused(absurd):
    with pytest.raises(ValueError, match='larger than what was measured'):
        fit_forces(table(LAWS['disc'], (7, 20), 1), L0, SharedErrors(**absurd))


def pink(rows, rng):
    """A drift of the power 1/f and the root mean square 1."""
    parts = rng.normal(size=(rows // 2 + 1, 2)).view(complex)[:, 0]
    found = np.fft.irfft(parts * np.append(0, np.arange(1, rows // 2 + 1) ** -0.5), rows)
    return found / found.std()


@pytest.mark.slow
def test_a_load_cell_that_drifts_is_in_the_intervals(monkeypatch):
    """Drifts of three times the noise; the control takes rows as independent."""
    def shares():
        held = []
        for seed in range(24):
            rows, law = table(list(LAWS.values())[seed % 8], (7, 20), seed), list(LAWS.values())[seed % 8]
            rows = replace(rows, f=rows.f + 0.015 * pink(len(rows.f), np.random.default_rng(seed + 999)))
            fit = fit_forces(rows, L0, ERRORS)
            held.append(abs(misses(fit, law)) < fit.half_widths)
        return np.mean(held)

    assert shares() >= 0.88
    monkeypatch.setattr('magphonon.interactions.fits.DRIFTS', (0.0,))
    assert shares() < 0.93


@pytest.mark.slow
def test_several_pairs_tell_the_mean_of_the_lattice():
    """Intervals of the mean force hold it; told of one pair (the control) they do not."""
    known = replace(ERRORS, distance=0.02, zero=1e-3)
    told, one = [], []
    for seed in range(24):
        law = list(LAWS.values())[seed % 8]
        rng, once, count = np.random.default_rng(seed), np.linspace(8, 18, 8), 5
        r, pair = np.tile(once, count), np.repeat(np.arange(count), len(once))
        f = np.exp(0.05 * rng.normal(size=count))[pair] * repulsion(law, r + known.distance * rng.normal())
        f = (1 + known.gain * rng.normal()) * f + known.zero * rng.normal()
        f = f + np.hypot(2e-3, 5e-3 * f) * rng.normal(size=len(r))
        rows = Forces(r, f, None, None, np.char.mod('pair %d', pair))
        for found, forces in ((told, rows), (one, rows[pair == 0])):
            fit = fit_forces(forces, L0, known)
            found.append(abs(misses(fit, law))[:2] < fit.half_widths[:2])
    print(np.mean(told), np.mean(one))
    assert np.mean(told) >= 0.88
    assert np.mean(one) < 0.8


def test_what_a_pair_may_be_off_is_in_the_interval():
    rows = table(LAWS['disc'], (7, 20), 3)
    alone, off = (fit_forces(rows, L0, replace(ERRORS, pair=pair)) for pair in (None, 0.06))
    wider = np.sqrt(off.half_widths**2 - alone.half_widths**2) / 1.96
    assert wider[:2] == pytest.approx([0.06, 0.06], rel=0.15)
    assert off.half_widths[2] == pytest.approx(alone.half_widths[2], rel=0.05)
    assert off.shares['pairs'] > 0.1 > alone.shares['pairs']
    assert 'whose forces scatter about their mean by 6 %' in force_report('f.csv', None, rows, off,
                                                                         replace(ERRORS, pair=0.06))
    assert 'The table holds one pair' in report_of(rows)


def test_a_law_goes_on_falling_where_noise_is_all_there_is():
    """Neighbours beyond a table go on as it ends, so its end must fall; measured to 60 mm."""
    for seed in (5, 6):
        rows = table(LAWS['cuboid'], (8, 60), seed)
        law = fit_forces(replace(rows, f=rows.f + 0.01 * np.random.default_rng(seed).normal(size=30)), L0, ERRORS).law
        assert float(local_exponent(law, law.r[-1])) > 1


def test_a_law_of_the_family_and_its_derivatives():
    """By differences, of the law, of its energy and of its parameters."""
    family, p, r, h = LawFamily(L0), np.array([-1.4, 0.6, 0.8, -0.5]), np.linspace(7, 40, 12), 1e-4
    law, v = FamilyLaw(family, p), np.random.default_rng(0).normal(size=4)
    assert law.phi(L0) == pytest.approx(0, abs=1e-15)
    change, there = family.change(law, v), [FamilyLaw(family, p + way * h * v) for way in (1, -1)]
    np.testing.assert_allclose((law.phi(r + h) - law.phi(r - h)) / (2 * h), law.dphi(r), rtol=1e-7)
    np.testing.assert_allclose((law.dphi(r + h) - law.dphi(r - h)) / (2 * h), law.d2phi(r), rtol=1e-7)
    for name in ('dphi', 'd2phi'):
        by_difference = np.subtract(*(getattr(one, name)(r) for one in there)) / (2 * h)
        np.testing.assert_allclose(getattr(change, name)(r), by_difference, rtol=1e-6)
