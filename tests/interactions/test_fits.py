"""Laws from data: estimates against their covariance over many synthetic draws, and what they are worth."""

import tomllib

import numpy as np
import pytest
from measured_forces import L0, LAW, A, R, rings, without_sigma
from scipy.stats import chi2, kstest, norm

from magphonon import units as u
from magphonon.design.uncertainty import frequency_spread
from magphonon.interactions.fits import curvature, fit_inverse_power, scene_entry
from magphonon.interactions.force_tables import Forces, synthetic_forces
from magphonon.interactions.law_choice import fit_laws
from magphonon.interactions.pair_laws import local_exponent, repulsion
from magphonon.interactions.smooth_laws import fit_spline
from magphonon.plotting.fits import plot_fits
from magphonon.scenes.scene import Scene, ready_scene

TRUE = np.array([repulsion(LAW, L0), -LAW.d2phi(L0)])
NOISE = 1e-3
DRAWS = 400


# --- statistics ---


@pytest.fixture(scope='module')
def draws():
    return [synthetic_forces(LAW, R, NOISE, seed) for seed in range(DRAWS)]


@pytest.fixture(scope='module')
def powers(draws):
    return {space: [fit_inverse_power(forces, L0, space) for forces in draws] for space in ('force', 'log')}


@pytest.mark.parametrize('space', ['force', 'log'])
def test_estimates_scatter_as_their_covariance_says(powers, space):
    fits = powers[space]
    off = np.array([fit.at_spacing - TRUE for fit in fits])
    distances = [d @ np.linalg.solve(fit.covariance, d) for d, fit in zip(off, fits, strict=True)]
    # The seeds are fixed: these are no random failures.  A right covariance falls below in one set of 1000.
    assert kstest(distances, chi2(2).cdf).pvalue > 1e-3
    assert kstest([fit.chi2 for fit in fits], chi2(len(R) - 2).cdf).pvalue > 1e-3
    for k in range(2):
        pulls = off[:, k] / [fit.sigma[k] for fit in fits]
        assert kstest(pulls, norm.cdf).pvalue > 1e-3
        assert kstest(pulls / 1.5, norm.cdf).pvalue < 1e-3  # control: uncertainties 50 % too large are seen
    exponents = [(fit.exponent - A) / fit.exponent_sigma for fit in fits]
    assert kstest(exponents, norm.cdf).pvalue > 1e-3


def test_noise_estimated_from_the_residuals_gives_students_pulls(draws):
    from scipy.stats import t

    fits = [fit_inverse_power(without_sigma(forces), L0) for forces in draws]
    pulls = [(fit.at_spacing[0] - TRUE[0]) / fit.sigma[0] for fit in fits]
    assert kstest(pulls, t(len(R) - 2).cdf).pvalue > 1e-3
    assert np.isnan(fits[0].chi2)


def test_the_offset_is_found_with_its_uncertainty():
    # small noise: with more, the three parameters are so correlated that the linear covariance fails (see below)
    c, noise = 0.3, 1e-4
    fits = [fit_inverse_power(Forces(R + c, *_noisy(R, noise, seed)), L0, offset=True) for seed in range(200)]
    pulls = [(fit.offset - c) / fit.offset_sigma for fit in fits]
    assert kstest(pulls, norm.cdf).pvalue > 1e-3
    distances = [(fit.at_spacing - TRUE) @ np.linalg.solve(fit.covariance, fit.at_spacing - TRUE) for fit in fits]
    assert np.mean(distances) == pytest.approx(2, rel=0.3)  # 200 draws of a chi2 of two: +- 7 %, and nonlinearity
    ignored = [fit_inverse_power(Forces(R + c, *_noisy(R, noise, seed)), L0) for seed in range(5)]
    assert all(fit.chi2 > 10 * fit.freedom for fit in ignored)  # control


def _noisy(r, noise, seed):
    forces = synthetic_forces(LAW, r, noise, seed)
    return forces.f, forces.sigma


def test_a_fit_in_log_force_of_data_with_constant_noise_is_biased_and_worse():
    # far points, where noise is a large part of the force: the mean of ln(f + e) lies below ln f by about sigma^2/(2 f^2)
    r = np.linspace(8, 20, 25)
    noise = 0.22 * repulsion(LAW, 20.0)
    draws = [without_sigma(synthetic_forces(LAW, r, noise, seed)) for seed in range(DRAWS)]
    force, log = ([fit_inverse_power(forces, L0, space).exponent - A for forces in draws] for space in ('force', 'log'))
    z_force, z_log = (np.mean(off) / np.std(off) * np.sqrt(len(draws)) for off in (force, log))
    assert abs(z_force) < 3 < 4 < z_log  # too steep, by several of its own uncertainties
    assert np.std(log) > 3 * np.std(force)


def test_the_curvature_tells_a_power_law_from_rings(draws):
    powers = [curvature(forces) for forces in draws]
    assert kstest(powers, norm.cdf).pvalue > 1e-3
    bent = [curvature(synthetic_forces(rings(), R, 2e-3, seed)) for seed in range(50)]
    assert max(bent) < -4  # the exponent falls towards 4


# --- exact laws ---


@pytest.mark.parametrize('space', ['force', 'log'])
def test_an_exact_power_law_is_recovered(space):
    fit = fit_inverse_power(Forces(R, repulsion(LAW, R)), L0, space)
    assert (fit.law.b, fit.law.a) == pytest.approx((LAW.b, LAW.a), rel=1e-9)
    assert fit.at_spacing == pytest.approx(TRUE, rel=1e-9)
    exact = fit_inverse_power(Forces(R + 0.5, repulsion(LAW, R)), L0, space, offset=True)
    assert exact.offset == pytest.approx(0.5, abs=1e-6)
    assert exact.law.a == pytest.approx(A, rel=1e-6)


def test_b_and_a_are_correlated_where_force_and_slope_are_known(powers):
    fits = powers['force']
    fit, var = fits[0], fits[0].strength_covariance
    # the same from many draws, for which b and a are computed one by one
    scatter = np.cov([[np.log(f.law.b / (u.N * u.m**f.law.a)), f.law.a] for f in fits], rowvar=False)
    assert var[0, 1] / np.sqrt(var[0, 0] * var[1, 1]) < -0.999
    np.testing.assert_allclose(np.sqrt(np.diag(var)), np.sqrt(np.diag(scatter)), rtol=0.15)  # 400 draws: 4 %, three times
    assert np.sqrt(var[0, 0]) > 10 * fit.sigma[0] / fit.at_spacing[0]


def test_the_curve_is_a_decreasing_law_with_consistent_derivatives():
    forces = synthetic_forces(rings(), R, 2e-3, 5)
    fit = fit_spline(forces, L0)
    r = np.linspace(R[0], R[-1], 500)
    assert (np.diff(repulsion(fit.law, r)) < 0).all()
    assert fit.at_spacing == pytest.approx([repulsion(fit.law, L0), -fit.law.d2phi(L0)], rel=1e-10)
    assert fit.exponent == pytest.approx(local_exponent(fit.law, L0), rel=1e-10)
    # nothing is lost on the way to the table: what the fit leaves is what the table leaves
    np.testing.assert_allclose(fit.residuals, forces.f - repulsion(fit.law, forces.r), atol=1e-12)


def test_the_curve_follows_rings_where_no_power_does():
    off = {'curve': [], 'power': []}
    for seed in range(60):
        forces = synthetic_forces(rings(), R, 2e-3, seed)
        for name, fit in (('curve', fit_spline(forces, L0)), ('power', fit_inverse_power(forces, L0))):
            off[name].append((fit.at_spacing[0] - repulsion(rings(), L0)) / fit.sigma[0])
    assert abs(np.mean(off['curve'])) < 0.5  # what is left of the bias; it is a part of the uncertainty
    assert np.std(off['curve']) == pytest.approx(1, rel=0.35)  # 60 draws: 9 %, three times, and that the average is no normal
    assert np.mean(off['power']) > 3  # control


def test_noise_of_a_power_law_does_not_bend_the_curve():
    fit = fit_spline(synthetic_forces(LAW, R, 1e-5, 3), L0)
    np.testing.assert_allclose([local_exponent(fit.law, r) for r in R[1:-1]], A, atol=5e-3)
    noisy = [5.0, 4.0, 4.2, 2.0, 2.1, 2.05, 1.0, 1.1]  # rises here and there: the law must not
    law = fit_spline(Forces(np.linspace(8, 15, 8), np.array(noisy)), L0).law
    assert (np.diff(repulsion(law, np.linspace(8, 15, 300))) < 0).all()
    rising = Forces(np.linspace(8, 15, 8), np.array([5.0, 4.0, 3.0, 2.0, 2.5, 3.0, 3.5, 4.0]))
    with pytest.raises(ValueError, match='does not fall everywhere'):
        fit_spline(rising, L0)


def test_with_an_offset_all_laws_are_compared_at_one_place():
    c = 0.5
    forces = Forces(R + c, *_noisy(R, NOISE, 4))
    choice = fit_laws(forces, L0, offset=True, contact=7.0)
    assert choice.is_power
    assert choice.advised == 'touch'
    for fit in choice.fits.values():
        assert (abs(fit.at_spacing - TRUE) < fit.half_width).all()
    apart = fit_spline(forces, L0)  # control: the same place on the scale of the table is another one
    assert (abs(apart.at_spacing - TRUE) > apart.half_width).all()


def test_sigma_of_half_the_noise_is_noticed_as_often_as_the_report_says():
    """With three points, whose inverse power has one freedom; the noise is drawn, the probability is that of a chi2."""
    r, sets = np.linspace(8, 15, 3), 200
    choices = [fit_laws(Forces(r, synthetic_forces(LAW, r, 2 * NOISE, seed).f, np.full(3, NOISE)), L0) for seed in range(sets)]
    noticed = sum(not choice.scatter_explained for choice in choices)
    assert abs(noticed - sets * choices[0].notices_twice) < 3 * np.sqrt(sets * 0.2 * 0.8)  # 40 +- 6
    right = [fit_laws(synthetic_forces(LAW, r, NOISE, seed), L0).scatter_explained for seed in range(100)]
    assert sum(right) > 93  # control: of 100 right ones one is called wrong on average


def test_curves_of_measurements_in_any_unit_of_length_can_be_drawn():
    """One of these lost the last digit of its end in a logarithm, and the law was asked beyond its table."""
    for power in range(-6, 1):
        r = np.array([8, 9.75, 11.5, 13.25, 15]) * 10.0**power
        forces = Forces(r, np.array([0.348098, 0.22347, 0.148242, 0.100461, 0.0893715]), np.full(5, 1e-3))
        fit = fit_spline(forces, r[2])
        assert (fit.law.r[0], fit.law.r[-1]) == (r[0], r[-1])
        plot_fits(forces, [fit])


def test_entry_carries_the_uncertainty_of_the_fit_to_the_bands():
    """At M, m w^2 = k - 2 f' - 6 f/L on the triangular lattice: linear in the force and its slope, whose covariance is the fit's;
    b, a and their correlation, pasted into a scene, must say the same."""
    fit = fit_inverse_power(synthetic_forces(LAW, R, NOISE, 1), L0)
    data = tomllib.loads(ready_scene('prototype').read_text()) | tomllib.loads(scene_entry(fit))
    scene = Scene.model_validate(data)
    spread = frequency_spread(scene.atoms(), [[0.5, 0, 0]], scene.uncertainty.tolerances(scene))
    by_force = np.array([-6 / fit.spacing, -2.0])
    expected = np.sqrt(by_force @ fit.covariance @ by_force) / scene.atoms().get_masses()[0] / (2 * spread.values[0, 0])
    # correlated to 1 - 1e-4 or so, the product of the two loses that many digits
    assert spread.std[0, 0] == pytest.approx(expected, rel=1e-9)
    apart = scene.uncertainty.model_copy(update={'correlation_a_b': None}).tolerances(scene)
    assert frequency_spread(scene.atoms(), [[0.5, 0, 0]], apart).std[0, 0] > 5 * expected  # the control


# --- forces without noise ---


@pytest.mark.parametrize('relative', [None, 1e-12, 1e-3])
@pytest.mark.parametrize(('r', 'f'), [
    ([1.0, 2.0, 4.0, 8.0, 16.0], [16.0, 8.0, 4.0, 2.0, 1.0]),
    ([5.0, 6.0, 8.0, 10.0], [1e3 / r**2 for r in (5, 6, 8, 10)]),
    (np.linspace(6, 20, 15), 1.6209e-10 * (np.linspace(6, 20, 15) / 1e3) ** -4.5824),
])
def test_computed_forces_are_fitted_as_well_as_measured_ones(r, f, relative):
    r, f = np.array(r), np.array(f)
    exponent = np.log(f[0] / f[-1]) / np.log(r[-1] / r[0])
    choice = fit_laws(Forces(r, f, None if relative is None else relative * f), r[2])
    assert (choice.advised, choice.apart, choice.scatter_explained) == ('touch', (), True)
    for fit in choice.fits.values():
        true = f[2] * np.array([1, -exponent / r[2]])
        assert (abs(fit.at_spacing - true) < fit.half_width).all()
        assert (fit.half_width > 1e-7 * abs(true)).all()  # round-off is no uncertainty of a measurement
        assert fit.exponent == pytest.approx(exponent, rel=1e-9)  # what is left is round-off
