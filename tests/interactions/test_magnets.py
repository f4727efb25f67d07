"""Forces between real magnets: against charges, multipoles, published values, and each derivative of the law."""

from itertools import product
from math import comb

import numpy as np
import pytest
from numpy.polynomial.legendre import Legendre, leggauss

from magphonon import InversePower, units as u
from magphonon.interactions import UprightMagnets
from magphonon.interactions.magnet_pairs import calibrated, magnet_law, pair_energy, pair_force
from magphonon.interactions.magnets import GRADES_T, Cuboid, Ring, grade_remanence, moment
from magphonon.interactions.pair_laws import local_exponent, repulsion

RING = Ring(6.35, 1.5875, 3.175, 1.3 * u.T)
MAGNETS = {
    'ring': RING,
    'thin ring': Ring(10, 9, 5, 1 * u.T),
    'flat disc': Ring(10, 0, 1, 1 * u.T),
    'rod': Ring(4, 0, 20, 1 * u.T),
    'cube': Cuboid(5, 5, 5, 1.2 * u.T),
    'plate': Cuboid(4, 10, 3, 1 * u.T),
}
every_magnet = pytest.mark.parametrize('magnet', MAGNETS.values(), ids=MAGNETS)


def away(magnet, gaps):
    """Distances at which the gap between two magnets is so many of their widths."""
    return magnet.contact + np.asarray(gaps) * magnet.width


# --- independent methods for the same force ---


def face_charges(magnet, n):
    """Points and charges of the two end faces of a prism."""
    x, weight = leggauss(n)
    if isinstance(magnet, Cuboid):
        a, b = magnet.length / 2, magnet.width / 2
        plane = np.stack(np.meshgrid(a * x, b * x), axis=-1).reshape(-1, 2)
        area = a * b * np.outer(weight, weight).ravel()
    else:
        half = (magnet.outer - magnet.inner) / 4
        radius, angle = magnet.inner / 2 + half * (x + 1), np.pi * np.arange(2 * n) / n
        plane = np.stack([np.outer(radius, np.cos(angle)), np.outer(radius, np.sin(angle))], axis=-1).reshape(-1, 2)
        area = np.repeat(half * weight * radius * np.pi / n, 2 * n)
    faces = [np.insert(plane, 2, side * magnet.height / 2, axis=1) for side in (1, -1)]
    return np.concatenate(faces), np.concatenate([area, -area]) * magnet.remanence / u.mu0


def coulomb(first, second, offset):
    """Force between clouds of magnetic charges, F = mu0 q q' d/(4 pi |d|^3)."""
    (here, q), (there, p) = first, second
    force = np.zeros(3)
    for x, charge in zip(here, q, strict=True):
        d = there + offset - x
        force += charge * (p / np.linalg.norm(d, axis=1) ** 3) @ d
    return u.mu0 / (4 * np.pi) * force


def multipole_force(ring, r, most=121):
    """Force of two rings side by side from their axial multipoles q_l, odd l only, beyond the spheres that hold them.

    U = mu0/(4 pi) sum q_l q_k (-1)^k (l+k)!/(l! k!) P_{l+k}(0)/r^{l+k+1}, with q_l the integral of the charge times
    R^l P_l(cos theta), a polynomial on the face, which Gauss's rule integrates exactly.
    """
    x, weight = leggauss(most)
    half = (ring.outer - ring.inner) / 4
    rho = ring.inner / 2 + half * (x + 1)
    R, M = np.hypot(rho, ring.height / 2), ring.remanence / u.mu0
    orders = range(1, most, 2)
    q = {l: 2 * M * np.sum(2 * np.pi * rho * half * weight * R**l * Legendre.basis(l)(ring.height / 2 / R)) for l in orders}
    # P_{2m}(0) = (-1)^m comb(2m, m)/4^m
    return u.mu0 / (4 * np.pi) * sum(
        -q[l] * q[k] * comb(l + k, l) * (-1) ** ((l + k) // 2) * comb(l + k, (l + k) // 2) / 2.0 ** (l + k)
        * (l + k + 1) / r ** (l + k + 2)
        for l, k in product(orders, orders) if l + k <= most)


@pytest.mark.parametrize('r', [9.0, 10.0, 15.0, 40.0])
def test_rings_side_by_side_have_the_force_of_their_multipoles(r):
    # the series to order 120 leaves (2 * 3.55/9)^120 = 4e-13
    assert repulsion(magnet_law(RING), r) == pytest.approx(multipole_force(RING, r), rel=1e-11)
    assert pair_force(RING, RING, (r, 0, 0))[0] == pytest.approx(multipole_force(RING, r), rel=1e-11)
    assert abs(multipole_force(RING, 9.0, most=5) / multipole_force(RING, 9.0) - 1) > 1e-3  # control: too few of them


@every_magnet
def test_prisms_side_by_side_have_the_force_of_their_charges(magnet):
    charges = face_charges(magnet, 16)
    (r,) = away(magnet, [0.6])
    # 16 nodes at this gap; a thin face resolved far better than the gap
    assert repulsion(magnet_law(magnet), r) == pytest.approx(coulomb(charges, charges, (r, 0, 0))[0], rel=1e-8)


@pytest.mark.slow
@every_magnet
def test_the_force_is_converged(magnet):
    r = away(magnet, [0.1, 0.2, 0.5, 1.0])
    exact = [pair_force(magnet, magnet, (d, 0, 0), n=240)[0] for d in r]  # exp(-240 asinh(0.2)) = 2e-21
    np.testing.assert_allclose(repulsion(magnet_law(magnet), r), exact, rtol=1e-9)
    np.testing.assert_allclose([pair_force(magnet, magnet, (d, 0, 0), n=140)[0] for d in r], exact, rtol=1e-9)
    # control: at the least gap a few points are not enough
    assert abs(pair_force(magnet, magnet, (r[0], 0, 0), n=12)[0] / exact[0] - 1) > 1e-4


# --- published values ---

# Forces between coaxial cylinders 50 mm apart, Br = 1.3 T, in the test suite of W. Robertson's magcode, which evaluates
# Robertson, Cazzolato and Zander, IEEE Trans. Magn. 47, 2045 (2011); printed to 1 mN.  (diameter, height), (diameter, height)
COAXIAL = [((40, 40), (40, 40), 265.537), ((40, 40), (30, 30), 111.490), ((40, 20), (40, 10), 18.953)]


@pytest.mark.parametrize(('one', 'other', 'published'), COAXIAL)
def test_coaxial_cylinders(one, other, published):
    first, second = (Ring(diameter, 0, height, 1.3 * u.T) for diameter, height in (one, other))
    force = pair_force(first, second, (0, 0, 50.0))
    assert -force[2] / u.N == pytest.approx(published, abs=6e-4)  # rounded to 1e-3
    assert force[:2] == pytest.approx(0, abs=1e-9)


# Akoun and Yonnet, IEEE Trans. Magn. 20, 1962 (1984): forces on a cuboid 12 x 20 x 6 mm that passes over one of 20 x 12 x 6 mm,
# J = 0.38 T, centres (-4 + d, -4, 8) mm apart, d = 0, 2, ..., 30 mm; read off the paper's figure by the authors of cudamag.
FIGURE = np.array([
    [0.6, 0.25, 0, -0.25, -0.6, -0.9, -1.05, -1.1, -1.05, -0.88, -0.55, -0.25, -0.08, 0, 0.05, 0.05],
    [0.6, 0.63, 0.64, 0.63, 0.6, 0.51, 0.425, 0.31, 0.23, 0.14, 0.05, 0.02, 0, -0.01, -0.02, -0.02],
    [-1.76, -1.85, -1.85, -1.85, -1.76, -1.47, -1.08, -0.64, -0.25, 0.15, 0.4, 0.43, 0.33, 0.25, 0.18, 0.15]]).T
OBLIQUE = Cuboid(20, 12, 6, 0.38 * u.T), Cuboid(12, 20, 6, 0.38 * u.T)
OFFSETS = [(-4.0 + 2 * k, -4.0, 8.0) for k in range(16)]


def akoun_yonnet(first, second, offset):
    """The closed form of Akoun and Yonnet (1984) for parallel cuboids."""
    force = np.zeros(3)
    for i, j, k, l, p, q in product((1, -1), repeat=6):
        x = offset[0] + (j * second.length - i * first.length) / 2
        y = offset[1] + (l * second.width - k * first.width) / 2
        z = offset[2] + (q * second.height - p * first.height) / 2
        r = np.sqrt(x * x + y * y + z * z)
        X, Y, A = np.log(r - x), np.log(r - y), np.arctan(x * y / (r * z))
        force += i * j * k * l * p * q * np.array([(y * y - z * z) / 2 * X + x * y * Y + y * z * A + r * x / 2,
                                                   (x * x - z * z) / 2 * Y + x * y * X + x * z * A + r * y / 2,
                                                   -x * z * X - y * z * Y + x * y * A - r * z])
    return first.remanence * second.remanence / (4 * np.pi * u.mu0) * force


@pytest.mark.slow
def test_oblique_cuboids_follow_the_published_figure_and_its_closed_form():
    forces = np.array([pair_force(*OBLIQUE, offset) for offset in OFFSETS])
    np.testing.assert_allclose(forces, FIGURE, atol=0.035)  # as finely as the figure can be read
    # 5 digits are lost in the closed form's alternating sum of 64 terms, those that vanish by symmetry apart
    np.testing.assert_allclose(forces, [akoun_yonnet(*OBLIQUE, offset) for offset in OFFSETS], rtol=1e-10, atol=1e-12)
    wrong = np.array([pair_force(OBLIQUE[0], OBLIQUE[0], offset) for offset in OFFSETS])
    assert abs(wrong - FIGURE).max() > 0.3  # control: the upper magnet not turned


@pytest.mark.parametrize(('first', 'second', 'offset', 'apart'), [
    (RING, RING, (6.35, 0, 0), (6.36, 0, 0)),
    (RING, RING, (3, 4, 3.1), (3, 4, 3.2)),  # one over the other
    (Ring(10, 9, 5, 1.0), Ring(4, 0, 5, 1.0), (2.5, 0, 0), (2.4, 0, 0)),  # in the bore
    (Ring(4, 0, 5, 1.0), Ring(10, 9, 5, 1.0), (2.5, 0, 0), (2.4, 0, 0)),
    (Cuboid(4, 10, 3, 1.0), Cuboid(4, 10, 3, 1.0), (3.9, 9.9, 2.9), (3.9, 10.1, 2.9)),
    (Cuboid(4, 10, 3, 1.0), Ring(4, 0, 3, 1.0), (3.4, 6.4, 0), (3.5, 6.5, 0)),  # beyond the corner, 1.98 and 2.12 mm
    (Ring(20, 15.2, 3, 1.0), Cuboid(10, 10, 3, 1.0), (1, 0, 0), (0.5, 0, 0)),  # in the bore: corner at 7.81 and 7.43 mm
])
def test_magnets_in_one_another_have_no_force(first, second, offset, apart):
    with pytest.raises(ValueError, match='touch or overlap'):
        pair_force(first, second, offset)
    assert np.isfinite(pair_force(first, second, apart)).all()


# --- the law ---


@every_magnet
def test_derivatives_follow_from_the_energy_by_the_complex_step(magnet):
    law, r = magnet_law(magnet), away(magnet, np.linspace(0.1, 5, 40))
    np.testing.assert_allclose(law.dphi(r), law.phi(r + 1e-30j).imag / 1e-30, rtol=1e-12)
    np.testing.assert_allclose(law.d2phi(r), law.dphi(r + 1e-30j).imag / 1e-30, rtol=1e-11)
    np.testing.assert_allclose(law.phi(r), [pair_energy(magnet, d) for d in r], rtol=1e-10)


def test_slender_rods_take_more_terms_and_the_slenderest_are_refused():
    """20 diameters: with 127 terms the force at the nearest distance is 1.6 % off, without a word."""
    rod = Ring(5, 0, 100, 1 * u.T)
    r = magnet_law(rod).nearest * np.array([1.0, 1.5])
    exact = [pair_force(rod, rod, (d, 0, 0), n=200)[0] for d in r]
    np.testing.assert_allclose(repulsion(magnet_law(rod), r), exact, rtol=1e-7)  # least at the end of the series
    with pytest.raises(ValueError, match='such slender rods'):
        magnet_law(Ring(2, 0, 200, 1 * u.T))


@every_magnet
def test_far_away_every_magnet_is_a_dipole(magnet):
    law, dipoles = magnet_law(magnet), InversePower.dipoles(moment(magnet))
    r = 1e4 * magnet.contact
    assert repulsion(law, r) == pytest.approx(repulsion(dipoles, r), rel=1e-5)  # (size/r)^2, a rod is five times its diameter
    assert local_exponent(law, r) == pytest.approx(4, abs=1e-5)
    near = away(magnet, 0.2)
    assert abs(local_exponent(law, near) - 4) > 0.1  # control


@pytest.mark.parametrize('name', ['ring', 'flat disc', 'rod'])
def test_round_magnets_tip_out_of_the_plane_as_laplace_says(name):
    magnet, dz = MAGNETS[name], 1e-3
    law, r = magnet_law(magnet), 1.6 * magnet.contact
    f = repulsion(law, r)
    lift, aside = (pair_force(magnet, magnet, offset) for offset in ((r, 0, dz), (r, dz, 0)))
    # differences of first order: (dz/r)^2 = 1e-8, and round-off 1e-13/(dz/r)
    assert -lift[2] / dz == pytest.approx(UprightMagnets(law).vertical(r), rel=1e-5)
    assert -aside[1] / dz == pytest.approx(-f / r, rel=1e-5)
    assert UprightMagnets(law).vertical(r) == pytest.approx(-(local_exponent(law, r) - 1) * f / r, rel=1e-12)
    assert abs(-lift[2] / dz / (-f / r) - 1) > 0.2  # control: a central phi(r) is too weak, least for the rod, a = 2.3


@pytest.mark.parametrize(('magnet', 'less'), [(Cuboid(5, 5, 5, 1 * u.T), 0.04), (MAGNETS['plate'], 0.40), (RING, 0.0)])
def test_cuboids_resist_a_sideways_displacement_less_than_a_central_law_says(magnet, less):
    r, dy = 10.0, 1e-3
    aside = -pair_force(magnet, magnet, (r, dy, 0))[1] / dy
    assert aside / (-repulsion(magnet_law(magnet), r) / r) == pytest.approx(1 - less, abs=0.005)  # as its docstring says


def test_the_papers_exponent_is_explained_and_its_force_is_not(paper):
    from scipy.optimize import curve_fit

    r = np.linspace(8, 15, 71)
    (_, a), _ = curve_fit(lambda r, f, a: f * (r / 10) ** -a, r, repulsion(magnet_law(RING), r), p0=(0.3, 4))
    assert a == pytest.approx(paper['prototype']['a'], abs=0.02)
    assert abs(local_exponent(magnet_law(RING), 20.0) - paper['prototype']['a']) > 0.2  # control
    ratio = repulsion(magnet_law(RING), 10.0) / (paper['prototype']['f_at_spacing'] * u.N)
    assert ratio == pytest.approx(1.59, abs=0.01)
    assert 7.5e-3 * RING.volume == pytest.approx(0.707, abs=5e-4)  # g: the mass that identifies the ring


def test_calibration_sets_the_remanence():
    weaker = calibrated(RING, 10.0, 0.2369)
    assert repulsion(magnet_law(weaker), 10.0) == pytest.approx(0.2369, rel=1e-12)
    assert weaker.remanence / RING.remanence == pytest.approx(1.5914**-0.5, rel=1e-4)
    assert local_exponent(magnet_law(weaker), 12.0) == pytest.approx(local_exponent(magnet_law(RING), 12.0), rel=1e-9)


def test_grades():
    assert grade_remanence('N42') == pytest.approx(1.30 * u.T)
    assert all(low < high for low, high in GRADES_T.values())
    assert sorted(GRADES_T.values()) == list(GRADES_T.values())
    with pytest.raises(ValueError, match=r"must be one of 'N30'.*not 'N99'"):
        grade_remanence('N99')


def test_slopes_of_the_stiffness_out_of_the_plane_are_those_of_differences():
    rng, h = np.random.default_rng(3), 1e-3
    for law in (magnet_law(RING), InversePower(6200.0, rng.uniform(3, 6))):
        r = rng.uniform(8, 14, 5)
        below, here, above = (UprightMagnets(law).vertical(r + step) for step in (-h, 0, h))
        slope, curvature = UprightMagnets(law)._vertical_slopes(r)
        np.testing.assert_allclose(slope, (above - below) / (2 * h), rtol=1e-5)  # 3 (h/r)^2 of it
        np.testing.assert_allclose(curvature, (above - 2 * here + below) / h**2, rtol=1e-4)  # round-off over h^2
