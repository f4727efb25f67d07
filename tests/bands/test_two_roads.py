"""phonopy's finite displacements and D0 + D* against Bloch matrices written here, for laws whose static force may vanish.

A spring at its natural length has a force of round-off, of either sign. The displacement that phonopy uses must not depend on it.
"""

import numpy as np
import pytest
from oracles import LATTICES, lattice, neighbour_vectors
from structures import few_first

from magphonon import InversePower, analytic_bands, finite_displacements, phonopy_bands
from magphonon.bands import band_path
from magphonon.bands.force_constants import default_distance
from magphonon.interactions import Cable, Spring, Yukawa
from magphonon.interactions.pair_laws import Overlap
from magphonon.stiffness import PairCalculator

OFF = [0.0, *(sign * 10.0**power for sign in (1, -1) for power in (-15, -12, -9, -7, -4, -1))]
"""Relative differences of the natural length from the length of the bonds: force of round-off, of compression, of tension."""
REFERENCE = 5e-7
"""Of the highest frequency, above round-off of the differences; what `magphonon bands` calls a disagreement is twice that."""


class LennardJones:
    """phi = e ((r0/r)^12 - 2 (r0/r)^6), at its minimum where r = r0."""

    def __init__(self, e, r0):
        self.e, self.r0 = e, r0

    def phi(self, r):
        return self.e * ((self.r0 / r) ** 12 - 2 * (self.r0 / r) ** 6)

    def dphi(self, r):
        return -12 * self.e / r * ((self.r0 / r) ** 12 - (self.r0 / r) ** 6)

    def d2phi(self, r):
        return 12 * self.e / r**2 * (13 * (self.r0 / r) ** 12 - 7 * (self.r0 / r) ** 6)


class Morse:
    """phi = e (1 - exp(-(r - r0)/w))^2."""

    def __init__(self, e, r0, w):
        self.e, self.r0, self.w = e, r0, w

    def phi(self, r):
        return self.e * (1 - np.exp((self.r0 - r) / self.w)) ** 2

    def dphi(self, r):
        x = np.exp((self.r0 - r) / self.w)
        return 2 * self.e / self.w * x * (1 - x)

    def d2phi(self, r):
        x = np.exp((self.r0 - r) / self.w)
        return 2 * self.e / self.w**2 * x * (2 * x - 1)


def drawn_law(rng, L):
    """A law whose bond of the length L has a stiffness of about one, with its phi' and phi'' at L in closed form."""
    t, kind = rng.choice(OFF), rng.choice(['spring', 'cable', 'lennard-jones', 'morse', 'contact', 'power', 'screened'])
    if kind == 'spring':
        return Spring(1.0, L * (1 + t)), L - L * (1 + t), 1.0
    if kind == 'cable':
        rest = L * (1 - max(abs(t), 1e-7))
        return Cable(1.0, rest), L - rest, 1.0
    if kind == 'lennard-jones':
        x6, e = (1 + t / 10) ** 6, L**2 / 72
        return LennardJones(e, L * (1 + t / 10)), -12 * e / L * (x6**2 - x6), 12 * e / L**2 * (13 * x6**2 - 7 * x6)
    if kind == 'morse':
        w, e = 0.2 * L, 0.02 * L**2
        x = np.exp(t * L / w)
        return Morse(e, L * (1 + t), w), 2 * e / w * x * (1 - x), 2 * e / w**2 * x * (2 * x - 1)
    if kind == 'contact':
        overlap = L * 10 ** rng.uniform(-5, -1)
        diameter = L + overlap
        A = 1 / (1.5 * np.sqrt(overlap))
        return Overlap(A * diameter**2.5, 2.5, diameter), -A * (diameter - L) ** 1.5, 1.5 * A * np.sqrt(diameter - L)
    if kind == 'power':
        a = rng.uniform(1.5, 30)
        return InversePower(L ** (a + 1) / a, a), -L / a, 1.0
    kappa = rng.uniform(0.5, 6) / L
    phi = L**2 / (2 + 2 * kappa * L + (kappa * L) ** 2)
    return Yukawa(phi * L * np.exp(kappa * L), kappa), -phi * (kappa + 1 / L), 1.0


def bloch_squares(cell, L, slope, stiffness, k, q):
    """Squared frequencies by the nearest neighbours, each found over the images and written by its formula."""
    dim, n = 3 if cell.pbc.all() else 2, len(cell)
    D = np.zeros((len(q), n, dim, n, dim), complex)
    for i in range(n):
        D[:, i, :, i] += k * np.eye(dim)
    for i, j, shift, R in neighbour_vectors(cell, 1.01 * L, images=2):
        nn = np.outer(R, R)[:dim, :dim] / (R @ R)
        K = stiffness * nn + slope / L * (np.eye(dim) - nn)
        D[:, i, :, i] += K
        D[:, i, :, j] -= np.exp(2j * np.pi * q @ shift)[:, None, None] * K
    return np.linalg.eigvalsh(D.reshape(len(q), n * dim, n * dim) / cell.get_masses()[0])


def apart(found, squares):
    """Largest difference of frequencies, as a fraction of the highest; none where their squares agree to 1e-7."""
    omega, top = np.sign(squares) * np.sqrt(abs(squares)), np.sqrt(abs(squares).max())
    near_zero = abs(np.sign(found) * found**2 - squares) < 1e-7 * top**2
    return (abs(found - omega) / top * ~near_zero).max()


@pytest.mark.parametrize('name', LATTICES)
@pytest.mark.parametrize('seed', few_first(range(12), 4))
def test_both_roads_are_right_whatever_the_static_force(name, seed):
    rng = np.random.default_rng([seed, 46])
    L = 10 ** rng.uniform(-3, 3)  # mm
    law, slope, stiffness = drawn_law(rng, L)
    cell, k = lattice(name, L, 1e-3 * L**3), rng.choice([0.0, 0.05, 1.0])
    cell.calc = PairCalculator(cell, law, foundation=k)
    path = band_path(cell, npoints=40)
    squares = bloch_squares(cell, L, slope, stiffness, k, path.kpts)
    phonon = finite_displacements(cell)
    assert apart(analytic_bands(cell, path).omega, squares) < 1e-12
    found = phonopy_bands(phonon, path).omega
    assert found.shape == squares.shape
    assert apart(found, squares) < REFERENCE
    assert 1e-9 * L * 0.99 < default_distance(cell.calc) < 1.01e-5 * L


@pytest.mark.parametrize('off', OFF)
def test_a_displacement_as_small_as_the_force_of_a_spring_would_be_wrong(off):
    """Unless it is in tension, which the old rule did not shorten."""
    cell = lattice('triangular', 1.0)
    cell.calc = PairCalculator(cell, Spring(5.0, 1.0 + off), foundation=1.0)
    assert default_distance(cell.calc) == pytest.approx(1e-5)
    exact = analytic_bands(cell, 'GMKG')
    right = phonopy_bands(finite_displacements(cell), exact.path)
    assert abs(right.omega - exact.omega).max() < 1e-9 * exact.omega.max()
    if 0 < off < 1e-9:
        wrong = phonopy_bands(finite_displacements(cell, distance=max(2e-4 * off, 1e-12)), exact.path)
        assert abs(wrong.omega - exact.omega).max() > 1e-6 * exact.omega.max()


def test_the_law_decides_where_it_changes_over_a_short_length():
    cell = lattice('chain', 20.0)
    cell.calc = PairCalculator(cell, Overlap(20.003**2.5, 2.5, 20.003), foundation=0.1)
    exact = analytic_bands(cell, 'GX')
    assert default_distance(cell.calc) < 1e-3 * 3e-3
    assert abs(phonopy_bands(finite_displacements(cell), exact.path).omega - exact.omega).max() < 1e-7 * exact.omega.max()
    coarse = phonopy_bands(finite_displacements(cell, distance=2e-4), exact.path)
    assert abs(coarse.omega - exact.omega).max() > 1e-6 * exact.omega.max()


def test_one_number_is_a_supercell_along_the_periodic_directions():
    cell = lattice('triangular')
    cell.calc = PairCalculator(cell, InversePower(6200.0, 4.5824), foundation=0.02)
    assert np.array_equal(finite_displacements(cell, 4).force_constants, finite_displacements(cell, (4, 4, 1)).force_constants)
    with pytest.raises(ValueError, match=r'17\.3205 mm'):
        finite_displacements(cell, [[2, 0, 0], [1, 2, 0], [0, 0, 1]])
