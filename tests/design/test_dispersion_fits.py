"""Residuals of fitted branches against generalised least squares written out here."""

from dataclasses import replace

import numpy as np
import pytest
from oracles import Gaussian, lattice
from scipy.linalg import inv, sqrtm

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.bands import bloch_modes
from magphonon.design import Shells, StiffnessDerivative, fit_dispersion
from magphonon.design.dispersion_fits import Bands, residuals_of
from magphonon.plotting import plot_band_fits
from magphonon.stiffness.matrices import MODELS
from magphonon.waves.ridge_tables import RidgePoints


def test_residuals_are_whitened_by_the_covariance():
    """Toward M shear has omega^2 m = k + A (1 - cos xi): C = diag(sigma^2) + (tau d)(tau d)^T with d = A sin xi/(2 m omega)."""
    rng, m, k, n = np.random.default_rng(2), 0.7, 0.05, 8
    start = lattices.triangular(10.0, m)
    start.calc = MagneticRepulsion(start, InversePower(0.25 * 10**4.2, 4.2), foundation=k)
    A = 0.025 * (4.2 - 3)

    def build(factors):
        springs = k * factors['foundation']
        return start.calc.laws, springs, {'foundation': StiffnessDerivative(foundation=springs)}

    def points_of(xi, off):
        omega = np.sqrt((k + A * (1 - np.cos(xi))) / m)
        d = A * np.sin(xi) / (2 * m * omega)
        sigma = 1e-3 * omega
        points = RidgePoints(('1',), ('transverse',), 0 * np.arange(n), np.outer(xi / (2 * np.pi), [0, 1, 0]), xi, 0 * xi,
                             omega + off * sigma, sigma, 1 + 0 * xi, 0 * xi, ('row',), 0.2 + 0 * xi)
        tilt = points.shift * d / sigma
        return points, sqrtm(inv(np.eye(n) + np.outer(tilt, tilt))) @ off

    xi = np.linspace(0.6, 2.6, n)
    points, _ = points_of(xi, 0 * xi)
    fit = fit_dispersion(Shells(start), build, ('foundation',), points, priors={'foundation': (1.0, 1e-9)})
    assert fit.factors == pytest.approx([1.0], rel=1e-8)
    others, expected = points_of(rng.uniform(0.6, 2.6, n), 0.5 + rng.normal(size=n))
    found = np.array(residuals_of(Bands(Shells(start), 'complete', *build(fit.by_name)), others))
    assert abs(found - expected).max() < 1e-5  # the slope is one of differences
    plain = (others.omega - points_of(others.xi, 0 * xi)[0].omega) / others.sigma_omega
    assert abs(plain - expected).max() > 0.3  # the control: as if the points shared nothing
    drawn = plot_band_fits(points, {'complete': (start, fit)}).axes[0].lines
    (x, f) = next(line.get_data() for line in drawn if len(line.get_xdata()) > 100)
    assert f == pytest.approx(np.sqrt((k + A * (1 - np.cos(x))) / m) * 1e3 / (2 * np.pi), rel=1e-6)


@pytest.mark.parametrize('name', ['chain', 'square', 'honeycomb', 'kagome', 'bcc'])
def test_sums_over_shells_are_the_bands_of_the_bonds_one_by_one(name):
    """Three shells, strengths and masses drawn, a law of no power; the slopes are those of differences."""
    rng, cell, law = np.random.default_rng(4), lattice(name), Gaussian()
    cell.set_masses(rng.uniform(0.5, 2, len(cell)))
    n = len(cell)
    cell.calc = MagneticRepulsion(cell, law, foundation=0.4, shells=3, strengths=rng.uniform(0.5, 1.5, n))
    shells, q = Shells(cell), rng.uniform(-0.5, 0.5, (4, 3)) * cell.pbc
    for model in MODELS:
        bands = Bands(shells, model, law, 0.4, {'k': StiffnessDerivative(foundation=0.4), 'f': StiffnessDerivative(law=law)})
        expected = bloch_modes(cell, q, model)[0]
        assert bands.omega(q) == pytest.approx(expected, rel=1e-9)
        squares, slopes = bands.slopes(q, ['k', 'f'])
        assert slopes.sum(axis=0) == pytest.approx(squares, rel=1e-9, abs=1e-12)  # all springs are stiffer in one proportion
        stiffer = replace(bands, foundation=0.4 * (1 + 1e-6)).omega(q) ** 2
        assert slopes[0] == pytest.approx((stiffer - expected**2) / 1e-6, rel=1e-4)
