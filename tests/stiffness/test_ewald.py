"""Infinite sums against closed forms, numbers of others, and direct sums; nothing may depend on the splitting."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy.optimize import brentq
from scipy.special import zeta

from magphonon import InversePower, lattices
from magphonon.interactions import Yukawa
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.ewald import lattice_sum, points_within

TRIANGULAR = np.array([[1, 0], [0.5, np.sqrt(0.75)]])
SQUARE = np.eye(2)
CHAIN = np.eye(1)
SC = np.eye(3)
FCC = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]]) / np.sqrt(2)
BCC = np.array([[-1, 1, 1], [1, -1, 1], [1, 1, -1]]) / np.sqrt(3)
OBLIQUE = np.array([[1.0, 0.1], [0.4, 1.3]])
SKEW = np.array([[1.0, 0.1, 0], [0.3, 1.1, -0.2], [0.1, 0.4, 0.9]])

ROUND_OFF = 1e-14  # some hundred terms


def volume(lattice):
    return np.sqrt(np.linalg.det(lattice @ lattice.T))


# --- closed forms ----------------------------------------------------------------------------------------------------

def dirichlet(x, modulus, signs):
    """L-series of a periodic sign, `sum_n sign(n) n^-x`, from Hurwitz zeta functions."""
    return modulus**-x * sum(sign * zeta(x, k / modulus) for k, sign in signs.items())


def particle_sums(atoms, s):
    """Over all other particles, as seen from each of a cell."""
    periods, r = atoms.cell.array[atoms.pbc], atoms.positions
    return [sum(lattice_sum(periods, s, offset=end - start) for end in r) for start in r]


@pytest.mark.parametrize('s', [2.5, 3.0, 3.5824, 4.0, 6.0, 12.0, 40.0])
def test_planar_lattices_factorise_into_two_series(s):
    triangular = 6 * zeta(s / 2) * dirichlet(s / 2, 3, {1: 1, 2: -1})
    square = 4 * zeta(s / 2) * dirichlet(s / 2, 4, {1: 1, 3: -1})
    assert_allclose(lattice_sum(TRIANGULAR, s), triangular, rtol=ROUND_OFF)
    assert_allclose(lattice_sum(SQUARE, s), square, rtol=ROUND_OFF)
    # and from sublattices of the triangular one, what several particles in a cell see
    assert_allclose(particle_sums(lattices.honeycomb(1, 1), s), [triangular * (1 + 3 ** (-s / 2)) / 2] * 2, rtol=ROUND_OFF)
    assert_allclose(particle_sums(lattices.kagome(1, 1), s), [triangular * (2 + 2**-s) / 3] * 3, rtol=ROUND_OFF)
    assert_allclose(lattice_sum(TRIANGULAR, s, offset=[0.5, np.sqrt(1 / 12)]), triangular * (3 ** (s / 2) - 1) / 2,
                    rtol=10 * ROUND_OFF)  # of the centres of its triangles


def test_charges_in_several_sublattices():
    """The continued series in 50-digit arithmetic, 6 zeta(1/2) L_{-3}(1/2); each sublattice brings its own background."""
    triangular = -4.213422636136906890029546
    assert_allclose(lattice_sum(TRIANGULAR, 1), triangular, rtol=ROUND_OFF)
    for atoms, share in ((lattices.honeycomb(1, 1), (1 + 3**-0.5) / 2), (lattices.kagome(1, 1), (2 + 2**-1) / 3)):
        assert_allclose(particle_sums(atoms, 1), [share * triangular] * len(atoms), rtol=ROUND_OFF)
        atoms.calc = AllNeighbours(atoms, InversePower(b=1.0, a=2.0))
        assert_allclose(atoms.get_potential_energy(), len(atoms) * share * triangular / 2, rtol=ROUND_OFF)


def test_layers_above_a_lattice():
    """Far above a plane of density n a particle feels the plane as a whole: 2 pi n h^(2-s)/(s - 2)."""
    plane = np.append(TRIANGULAR, [[0], [0]], axis=1)
    for s, height in ((3.0, 8.0), (6.5, 9.0)):
        smooth = 2 * np.pi / np.sqrt(0.75) * height ** (2 - s) / (s - 2)
        assert_allclose(lattice_sum(plane, s, offset=[0.1, 0.2, height]), smooth, rtol=1e-13)  # waves fall like e^{-7 h}
        assert abs(lattice_sum(plane, s, offset=[0.1, 0.2, 0.7]) / (smooth * (0.7 / height) ** (2 - s)) - 1) > 1e-2


# --- what others found -----------------------------------------------------------------------------------------------

@pytest.mark.parametrize(('lattice', 'exact', 'printed'), [
    (TRIANGULAR, -3.921031578639783302411505, -1.106103), (SQUARE, -3.900264920001955882845475, -1.100244),
])
def test_planar_wigner_crystals(lattice, exact, printed):
    """Exact: continued series in 50-digit arithmetic; printed: Bonsall and Maradudin, Phys. Rev. B 15, 1959 (1977), in e^2/r0."""
    total = lattice_sum(lattice, 1) * np.sqrt(volume(lattice))
    assert_allclose(total, exact, rtol=ROUND_OFF)
    r0 = np.sqrt(1 / np.pi)  # in units of the root of the area per electron
    assert_allclose(total * r0 / 2, printed, rtol=0, atol=6e-7)


@pytest.mark.parametrize(('lattice', 'printed'), [(BCC, -0.895929), (FCC, -0.895874), (SC, -0.880059)])
def test_coulomb_crystals(lattice, printed):
    """Energy per particle in e^2 over the Wigner-Seitz radius: Baus and Hansen, Phys. Rep. 59, 1 (1980)."""
    radius = (3 * volume(lattice) / (4 * np.pi)) ** (1 / 3)
    assert_allclose(lattice_sum(lattice, 1) * radius / 2, printed, rtol=0, atol=6e-7)


def yukawa_energy(lattice, kappa):
    """Per particle, for a Wigner-Seitz radius of one."""
    lattice = lattice * (4 * np.pi / 3 / volume(lattice)) ** (1 / 3)
    return lattice_sum(lattice, Yukawa(1.0, kappa)) / 2


def test_yukawa_crystals_change_from_bcc_to_fcc():
    """At kappa = 1.066 Wigner-Seitz radii: Hamaguchi, Farouki and Dubin, Phys. Rev. E 56, 4671 (1997)."""
    crossing = brentq(lambda kappa: yukawa_energy(FCC, kappa) - yukawa_energy(BCC, kappa), 0.5, 2)
    assert_allclose(crossing, 1.066, atol=5e-4, rtol=0)


# --- direct sums and the splitting -----------------------------------------------------------------------------------

@pytest.mark.parametrize('lattice', [[[1.0, 0.0]], TRIANGULAR, OBLIQUE, SKEW], ids=['chain', 'triangular', 'oblique', 'skew'])
@pytest.mark.parametrize('kappa', [0.8, 4.0, 80.0])
def test_yukawa_against_the_direct_sum(lattice, kappa):
    lattice, law = np.array(lattice), Yukawa(2.0, kappa)
    offset = 0.3 * np.arange(1, lattice.shape[1] + 1) / lattice.shape[1]
    R = points_within(lattice, -offset, 1 + 38 / kappa)  # e^-38 is round-off
    direct = law.phi(np.linalg.norm(R + offset, axis=1)).sum()
    assert_allclose(lattice_sum(lattice, law, offset), direct, rtol=1e-13)
    nearest = law.phi(np.linalg.norm(R + offset, axis=1).min())
    assert (abs(nearest / direct - 1) > 1e-2) == (kappa < 20)  # the control: there the nearest particle is all there is


@pytest.mark.parametrize('lattice', [TRIANGULAR, OBLIQUE, SKEW, [[1.0, 0.0]]], ids=['triangular', 'oblique', 'skew', 'chain'])
@pytest.mark.parametrize('s', [8.0, 11.3])
def test_inverse_powers_against_the_direct_sum(lattice, s):
    lattice = np.array(lattice)
    d, dim = lattice.shape
    q, offset = np.array([0.3, -0.2, 0.45])[:d], np.array([0.2, 0.35, -0.1])[:dim]
    R = points_within(lattice, -offset, reach := 25.0)
    terms = np.linalg.norm(R + offset, axis=1) ** -s * np.exp(2j * np.pi * R @ np.linalg.pinv(lattice) @ q)
    beyond = 4 * np.pi * reach ** (d - s) / (s - d)  # the integral over what is left out bounds it
    assert_allclose(lattice_sum(lattice, s, offset, q), terms.sum(), rtol=1e-13, atol=2 * beyond)


@pytest.mark.parametrize('split', [0.7, 1.4])
@pytest.mark.parametrize('lattice', [CHAIN, [[1.0, 0.0]], TRIANGULAR, OBLIQUE, SKEW, BCC],
                         ids=['chain', 'chain in the plane', 'triangular', 'oblique', 'skew', 'bcc'])
@pytest.mark.parametrize('s', [0.01, 0.5, 2.7, 12.0, 40.0])
def test_the_splitting_does_not_matter(lattice, s, split):
    lattice = np.array(lattice)
    d, dim = lattice.shape
    for offset in (None, 0.3 * np.arange(1, dim + 1)):
        for q in (None, [0.2, 0.4, 0.1][:d]):
            # at s = 12 and split = 1.4 the two sums are some hundred times larger than what they leave, of some hundred terms
            assert_allclose(lattice_sum(lattice, s, offset, q, split), lattice_sum(lattice, s, offset, q), rtol=4e-12)


# --- refusals --------------------------------------------------------------------------------------------------------

@pytest.mark.parametrize('lattice', [CHAIN, SQUARE, SC])
def test_no_background_mends_a_logarithm(lattice):
    with pytest.raises(ValueError, match='diverges with the logarithm'):
        lattice_sum(lattice, len(lattice))
    assert np.isfinite(lattice_sum(lattice, len(lattice), q=[0.3] * len(lattice)))
