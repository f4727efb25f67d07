"""Pair laws: each derivative against the complex step of the one before it, and against the physics they stand for."""

from dataclasses import dataclass
from itertools import pairwise
from textwrap import dedent

import numpy as np
import pytest
from oracles import LAWS, TABLE
from scipy.integrate import quad

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions import Tabulated, Yukawa
from magphonon.interactions.pair_laws import PIECE, Overlap, PairLaw, repulsion
from magphonon.lattices.crystals import triangular

R = np.linspace(3.5, 44.0, 60)
STEP = 1e-30  # of the complex step: its error is the square, its round-off none


def known(law):
    """Distances where a law is known."""
    return R[(R > 8.6) & (R < 16.9)] if isinstance(law, Overlap) else R


@pytest.mark.parametrize('law', LAWS.values(), ids=LAWS)
def test_derivatives_follow_from_the_energy_by_the_complex_step(law):
    R = known(law)
    slope = law.phi(R + 1j * STEP).imag / STEP
    curvature = law.dphi(R + 1j * STEP).imag / STEP
    # the energy of a table is a sum of 16 quadrature terms; the others are single expressions
    np.testing.assert_allclose(law.dphi(R), slope, rtol=2e-13)
    # the Gaussian's curvature passes through zero, where only an absolute error has a meaning
    np.testing.assert_allclose(law.d2phi(R), curvature, rtol=2e-14, atol=2e-14 * abs(curvature).max())


def test_logarithm_is_the_limit_of_inverse_powers():
    # phi_a(r) - phi_a(1) -> -b log r as a -> 1; the next term is (a - 1) log(r)^2/2 of it
    near, log = InversePower(b=1.0, a=1 + 1e-6), InversePower(b=1.0, a=1.0)
    np.testing.assert_allclose(near.phi(R) - near.phi(1.0), log.phi(R) - log.phi(1.0), rtol=3e-6)


def test_screening_vanishes_with_its_constant():
    np.testing.assert_allclose(Yukawa(c=2.0, kappa=1e-14).dphi(R), InversePower(b=2.0, a=2.0).dphi(R), rtol=1e-12)


def test_a_table_of_an_inverse_power_is_that_inverse_power():
    law = InversePower(b=6200.0, a=4.5824)
    table = Tabulated(TABLE, repulsion(law, TABLE))
    # a straight line on logarithmic axes: round-off of the spline's coefficients, times the exponent, and its
    # second derivative times (log-distance between points)^-2
    np.testing.assert_allclose(table.dphi(R), law.dphi(R), rtol=1e-13)
    np.testing.assert_allclose(table.d2phi(R), law.d2phi(R), rtol=1e-12)
    np.testing.assert_allclose(table.phi(R), law.phi(R) - law.phi(TABLE[-1]), rtol=1e-12)


GAPPED = np.array([2.5, 10.6, 11.4, 12.5, 14.0, 18.0, 24.0]), np.array([150, 0.19, 0.16, 0.085, 0.062, 0.017, 0.005])
GAP = pytest.mark.filterwarnings('ignore:.*nothing constrains the table:UserWarning')


@GAP
@pytest.mark.parametrize('seed', range(6))
def test_energy_of_a_rough_table_is_the_integral_of_its_force_in_a_gap_too(seed):
    """By SciPy's adaptive quadrature; the control is one rule of 16 points over each interval, of the same spline."""
    rng = np.random.default_rng(seed)
    r, f = GAPPED
    if seed:
        r = np.append(rng.uniform(2.5, 5), 10 + np.cumsum(rng.uniform(0.5, 2, 6)))
        f = 8900 * r**-4.58 * np.exp(rng.normal(scale=0.2, size=7))
    table = Tabulated(r, f)
    x, w = np.polynomial.legendre.leggauss(16)
    for a, b in pairwise([r[0], *np.sort(rng.uniform(r[0], r[1], 3)), r[1]]):
        told, true = table.phi(a) - table.phi(b), quad(lambda s: -table.dphi(s), a, b, epsabs=0, epsrel=1e-12, limit=200)[0]
        assert told == pytest.approx(true, rel=2e-11)  # 50 digits of the energy at the nearest reading may cancel
    if not seed:
        rule = (r[1] - r[0]) / 2 * w @ -table.dphi((r[0] + r[1]) / 2 + (r[1] - r[0]) / 2 * x)
        assert abs(rule / (table.phi(r[0]) - table.phi(r[1])) - 1) > 1e-3


@GAP
def test_a_patch_with_a_hole_relaxes_by_a_rough_table_and_loses_the_work_of_its_forces(monkeypatch):
    """The control is the rule of 16 points over a whole gap, whose energy disagrees with the forces."""
    patch = lattices.hexagon(lattices.triangular(11.0, 0.7), 45.0)
    del patch[len(patch) // 2]
    for piece, agrees in ((PIECE, True), (np.inf, False)):
        monkeypatch.setattr('magphonon.interactions.pair_laws.PIECE', piece)
        patch.calc = MagneticRepulsion(patch, Tabulated(*GAPPED), foundation=0.05)
        found, way = relaxed(patch).atoms, patch.copy()
        free = np.delete(np.arange(len(found)), found.constraints[0].index)
        assert abs(found.get_forces()[free]).max() < 1e-12
        way.calc, shift, work = patch.calc, found.positions - patch.positions, 0.0
        for x, w in zip(*np.polynomial.legendre.leggauss(40), strict=True):
            way.positions = patch.positions + (1 + x) / 2 * shift
            work += w / 2 * np.sum(way.get_forces() * shift)
        way.positions = found.positions
        lost = patch.get_potential_energy() - way.get_potential_energy()
        assert (lost == pytest.approx(work, rel=1e-6)) == agrees


def test_readings_that_do_not_hold_a_table_are_told():
    r, f = np.arange(7.0, 14.1, 0.5), 8900 * np.arange(7.0, 14.1, 0.5) ** -4.58
    noise = np.exp(0.05 * np.random.default_rng(1).normal(size=len(r)))
    Tabulated(r, f * noise)  # evenly spaced: no warning, which would be an error here
    Tabulated(np.sort(np.append(r, 10.005)), 8900 * np.sort(np.append(r, 10.005)) ** -4.58)  # close and right
    with pytest.warns(UserWarning, match=r'readings at 2\.5 and 10\.6 mm nothing constrains the table: .* measure there'):
        Tabulated(*GAPPED)
    twice, forces = np.insert(r, 7, 10.49), np.insert(f, 7, 1.02 * f[7])
    with pytest.warns(UserWarning, match=r'readings at 10\.49 and 10\.5 mm are close together'):
        Tabulated(twice, forces)
    with pytest.raises(ValueError, match='are equal; average their forces'):
        Tabulated([1, 1 + 1e-12, 2, 3], [4, 3, 2, 1])


def test_a_table_passes_smoothly_through_its_points():
    table = LAWS['table']
    knots = TABLE[1:-1]
    for method in (table.phi, table.dphi, table.d2phi):
        # 1e-9 to the left and to the right: continuous up to that distance times the logarithmic slope, below 50 here;
        # straight lines between the points would make the curvature jump by tens of percent
        np.testing.assert_allclose(method(knots * (1 - 1e-9)), method(knots * (1 + 1e-9)), rtol=2e-9 * 50)
    np.testing.assert_allclose(table.dphi(TABLE), -table.f, rtol=1e-14)


def test_a_table_goes_on_by_a_tenth_towards_contact_and_at_least_as_steeply_as_dipoles_away_from_it():
    """Its exponent rises evenly to 4 over an octave, if it is less; also of an end that rises in the noise (-0.5)."""
    for a in (-0.5, 0.8, 2.9, 4.0, 5.3):
        x = np.log(TABLE / 45)
        law = Tabulated(TABLE, np.exp(-a * x + 0.2 * x**3 * (TABLE < 45)))  # bent, and flat towards its end
        end = 45 * law.d2phi(45.0) / -law.dphi(45.0)  # of the spline, which is known in between
        steep = max(end, 4.0)

        def exponent(r, end=end, steep=steep):
            return end + (steep - end) * np.minimum(np.log(r / 45) / np.log(2), 1)

        for r in 45 * np.geomspace(1.01, 9000, 7):
            fallen = [quad(lambda s: exponent(np.exp(s)), *part, epsabs=0)[0]
                      for part in pairwise(np.log([45, min(r, 90.0), r]))]
            assert -law.dphi(r) == pytest.approx(np.exp(-sum(fallen)), rel=1e-10)
            assert law.d2phi(r) * r / -law.dphi(r) == pytest.approx(exponent(r), rel=1e-10)
            work = sum(quad(lambda s: -law.dphi(np.exp(s)) * np.exp(s), *part, epsabs=0)[0]  # noqa: B023
                       for part in pairwise(np.log([45, min(r, 90.0), r])))
            assert law.phi(r) == pytest.approx(-work, rel=1e-9)
        first = 3 * law.d2phi(3.0) / -law.dphi(3.0)
        assert law.dphi(3 / 1.09) == pytest.approx(law.dphi(3.0) * 1.09**first, rel=1e-11)
        assert law.phi(45.0) == 0
        for r in (3 / 1.11, 1.1e4 * 45, np.array([10.0, 2.0]), 2 + 1e-20j):
            with pytest.raises(ValueError, match='outside the table'):
                law.d2phi(r)


def test_steel_spheres_in_contact():
    """Johnson, Contact Mechanics: f = 4/3 E* sqrt(R*) delta^3/2, E* = E/2(1 - nu^2), R* = d/4."""
    law = Overlap.spheres(youngs_modulus=206 * u.GPa, poisson_ratio=0.3, diameter=20 * u.mm)
    E, R, overlap = 206e9 / (2 * (1 - 0.3**2)), 0.005, 2e-6
    assert repulsion(law, 20 * u.mm - overlap * u.m) / u.N == pytest.approx(4 / 3 * E * R**0.5 * overlap**1.5, rel=1e-9)
    assert law.phi(20.1) == law.dphi(20.1) == law.d2phi(20.1) == 0


@pytest.mark.parametrize('law', [LAWS['magnets'], LAWS['steep'], LAWS['dipoles'], LAWS['yukawa']], ids=str)
def test_mixtures_of_gaussians(law):
    """The density of Gaussians integrates to the law, its moment to the moment."""
    for r in (4.0, 20.0):
        total = quad(lambda v, r=r: law.gaussians(np.exp(v)) * np.exp(v - np.exp(v) * r**2), -40, 5, epsabs=0, limit=200)[0]
        assert total == pytest.approx(law.phi(r), rel=1e-8)
    for t in (1e-3, 0.1):
        moment = quad(lambda v: law.gaussians(np.exp(v)) * np.exp(2 * v), -60, np.log(t), epsabs=0, limit=200)[0]
        assert law.gaussian_moment(t) == pytest.approx(moment, rel=1e-8)


def test_the_law_in_the_documentation_works_as_written():
    """The example for users in PairLaw: a law, and bands that follow from it."""
    example = dedent(PairLaw.__doc__.split('own::')[1].split('Requirements on')[0]).strip()
    atoms = triangular(10.0, 0.5)
    names = {'np': np, 'dataclass': dataclass, 'PairCalculator': MagneticRepulsion, 'atoms': atoms}
    exec(example, names)
    law = atoms.calc.laws
    assert isinstance(law, PairLaw)
    np.testing.assert_allclose(law.phi(R + 1j * STEP).imag / STEP, law.dphi(R), rtol=1e-13)
    np.testing.assert_allclose(law.dphi(R + 1j * STEP).imag / STEP, law.d2phi(R), rtol=1e-13)
    assert bloch_modes(atoms, np.array([[0.5, 0, 0]]))[0].max() > 0


def test_spheres_that_lie_in_one_another_are_no_contact():
    """A spacing typed a hundred times too small gave bands of -829434 Hz."""
    balls = Overlap.spheres(206 * u.GPa, 0.3, 20 * u.mm)
    assert repulsion(balls, 10.1) > 0
    cell = triangular(0.2, 3e-5)
    with pytest.raises(ValueError, match=r'are only 0\.01 of the distance apart at which they touch'):
        MagneticRepulsion(cell, balls)
