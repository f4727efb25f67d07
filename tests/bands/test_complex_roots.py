"""Complex wavenumbers of cells drawn at random, counted by the winding of a determinant that the energy of a bond gives.

Hundreds of cells: `python -m pytest -n 0 -m long tests/bands/test_complex_roots.py`.
"""

from itertools import product

import numpy as np
import pytest
from ase import Atoms
from oracles import Pairs, neighbour_vectors
from structures import few_first

from magphonon import InversePower, MagneticRepulsion
from magphonon.bands import evanescent
from magphonon.bands.evanescent import complex_bands

LAW = InversePower(b=0.2 * 10**4.5824, a=4.5824)
DIRECTIONS = (1, 0, 0), (0, 1, 0), (1, 1, 0), (2, 0, 0), (1, 2, 0), (1 / 2, 1, 0), (1, -1, 0)
CIRCLES = 1.0, 2.5, 4.0, 6.0
"""Decays per step below which waves are counted."""
EXACT = 1e-11
"""Of the largest terms of the equations of motion: round-off, after Newton's steps, beside roots that nearly coincide."""


class Cell:
    """A cell of one to eight particles in the plane or in space, scattered, with a direction and three frequencies.

    `rate` multiplies all frequencies: it stands for another unit of time.
    """

    def __init__(self, seed, rate=1.0):
        rng, law = np.random.default_rng(seed), InversePower(b=LAW.b * rate**2, a=LAW.a)
        dim, n, apart = (2 if rng.random() < 0.7 else 3), int(rng.integers(1, 9)), 6.5
        side, cell = 10 * n ** (1 / dim), 20 * np.eye(3)
        cell[:dim, :dim] = side * (np.diag(rng.uniform(0.8, 1.25, dim)) + np.tril(rng.uniform(-0.3, 0.3, (dim, dim)), -1))
        images, places = np.array(list(product(range(-2, 3), repeat=dim))) @ cell[:dim], []
        while len(places) < n:
            apart *= 0.999  # so that there is room in the end
            place = np.pad(rng.uniform(0, 1, dim), (0, 3 - dim)) @ cell
            if all(np.linalg.norm(place - other + images, axis=1).min() > apart for other in places):
                places.append(place)
        self.atoms = Atoms(['Nd'] * n, places, cell=cell, pbc=np.arange(3) < dim, masses=rng.uniform(0.5, 1.5, n))
        lengths = np.sort([0, 13, *(np.linalg.norm(v) for *_, v in neighbour_vectors(self.atoms, 17)), 17])
        lengths = lengths[lengths >= 13]
        widest, k = np.diff(lengths).argmax(), float(rng.choice([0, 0.3])) * rate**2
        reach = lengths[widest : widest + 2].mean()
        self.pairs = Pairs(self.atoms, law, reach)
        self.atoms.calc = MagneticRepulsion(self.atoms, law, foundation=k, cutoff=reach).balanced(np.arange(n))
        self.direction, upwards = np.zeros(3), dim == 3 and rng.random() < 0.5
        while not (self.pairs.cell @ self.direction).any():  # a row of large cells may have no bonds across
            self.direction = np.array([*DIRECTIONS[rng.integers(len(DIRECTIONS))][:2], upwards], float)
        self.k, self.m = k, np.repeat(self.atoms.get_masses(), dim)
        top = np.linalg.eigvalsh(self.stiffness(1.0) / np.sqrt(self.m * self.m[:, None]))[-1]
        self.omega = np.sqrt(top) * rng.uniform(0.05, 1.2, 3)

    def stiffness(self, xi):
        """At phases xi per step, which may be complex."""
        q = np.asarray(xi)[..., None] / (2 * np.pi) * self.direction
        return self.pairs.bloch(self.atoms.positions, q) + self.k * np.eye(len(self.m))

    def equations(self, xi, omega):
        """Of motion, in N/mm; singular where there is a wave."""
        return self.stiffness(xi) - omega**2 * np.diag(self.m)

    def left(self, xi, vectors, omega):
        """What is left of the forces of waves, over the largest of the terms, bond by bond, that cancel in them."""
        u = vectors.reshape(len(xi), -1) / np.sqrt(self.m)
        forces, size = np.einsum('wab,wb->wa', self.equations(xi, omega), u), abs(u).reshape(len(xi), len(self.atoms), -1)
        pairs, K = self.pairs, abs(self.pairs._derivatives(self.atoms.positions)[1])
        falls = np.exp(-xi.imag[:, None] * (pairs.cell @ self.direction))
        terms = np.einsum('bxy,wby->wbx', K, size[:, pairs.i] + falls[..., None] * size[:, pairs.j])
        total = (self.k + self.m * omega**2) * abs(u)
        np.add.at(total.reshape(size.shape), (slice(None), pairs.i), terms)
        return abs(forces).max(axis=1) / total.max(axis=1)

    def count(self, decay, omega):
        """Families of waves that decay by less, by the argument principle.

        det A(mu) = det A(1/mu), so beyond the circle |mu| = e^decay lie as many roots as within |mu| = e^-decay, and the winding
        numbers of det A along both are opposite.  Their difference is the number of roots between, two for each family.
        """
        steps = abs(np.round(6 * self.pairs.cell @ self.direction)).astype(int)
        points, unit = 256, np.gcd.reduce(steps) / 6
        while True:
            xi = 2 * np.pi / unit * np.arange(points) / points + 1j * decay
            sign = np.linalg.slogdet(self.equations(xi, omega))[0]
            turned = np.angle(np.roll(sign, -1) / sign)
            if abs(turned).max() < 1:
                return -round(turned.sum() / (2 * np.pi))
            points *= 2


def wrong_counts(cell):
    """How many waves the package finds below each decay and at each frequency, where that is not the winding number."""
    waves, wrong = complex_bands(cell.atoms, cell.direction, cell.omega), []
    for omega, decay in product(cell.omega, CIRCLES):
        decays = waves.xi[cell.omega == omega].imag
        while abs(decays - decay).min() < 0.05:  # a circle through a root has no winding number
            decay += 0.03
        if (found := np.count_nonzero(decays < decay)) != (there := cell.count(decay, omega)):
            wrong.append((decay, found, there))
    return wrong


def what_is_left(cell):
    """The largest, over all waves that do not end at once."""
    waves = complex_bands(cell.atoms, cell.direction, cell.omega)
    left = 0.0
    for omega, xi, vectors in zip(cell.omega, waves.xi, waves.vectors, strict=True):
        finite = np.isfinite(xi)
        left = max(left, cell.left(xi[finite], vectors[finite], omega).max(initial=0))
    return left


@pytest.mark.slow
@pytest.mark.parametrize('seeds', [range(8), pytest.param(range(100, 400), marks=pytest.mark.long)], ids=['few', 'many'])
def test_no_wave_is_missing_and_none_is_false(seeds):
    for seed in seeds:
        cell = Cell(seed)
        assert not wrong_counts(cell), seed
        assert what_is_left(cell) < EXACT, seed


@pytest.mark.parametrize('rate', few_first([1e-4, 1e8], 1))
def test_waves_do_not_depend_on_the_unit_of_time(rate):
    for seed in range(4):
        cell = Cell(seed, rate)
        assert not wrong_counts(cell), seed
        assert what_is_left(cell) < EXACT, seed


def sampled(calc, model, exponents):
    """Coefficients by Fourier transform, which leaves round-off where nothing is coupled."""
    P = abs(exponents).max()
    D = evanescent_coefficients(calc, model, exponents)
    phases = np.exp(2j * np.pi * np.outer(np.arange(2 * P + 1), np.arange(-P, P + 1)) / (2 * P + 1))
    return np.fft.fftshift(np.fft.fft(np.einsum('sp,pab->sab', phases, D), axis=0, norm='forward'), axes=0).real


evanescent_coefficients = evanescent._laurent


def test_chains_of_roots_that_are_not_taken_off_turn_into_false_waves(monkeypatch):
    """The control: the pencil as it stands."""
    cells = [Cell(seed) for seed in (1, 11, 31)]
    assert max(what_is_left(cell) for cell in cells) < EXACT
    there = [np.isfinite(complex_bands(cell.atoms, cell.direction, cell.omega).xi).sum() for cell in cells]
    monkeypatch.setattr(evanescent, '_without_chains', lambda L, R, lengths=None: (L, R, []))
    monkeypatch.setattr(evanescent, 'polished', lambda A, mu, v: (mu, v))
    monkeypatch.setattr(evanescent, '_laurent', sampled)
    with np.errstate(divide='ignore', invalid='ignore'):  # infinite roots
        found = [np.isfinite(complex_bands(cell.atoms, cell.direction, cell.omega).xi).sum() for cell in cells]
        left = [what_is_left(cell) for cell in cells]
    assert (np.array(found) > there).all()
    assert min(left) > 1e-7


@pytest.mark.parametrize(('direction', 'steps'), [((1, 0, 0), 2), ((1, 1, 0), 3), ((1 / 2, 1, 0), 2)])
def test_the_same_waves_lie_along_a_multiple_of_a_direction(direction, steps):
    for seed in range(4):
        cell = Cell(seed)
        once = complex_bands(cell.atoms, direction, cell.omega)
        many = complex_bands(cell.atoms, steps * np.array(direction), cell.omega)
        assert many.xi.shape == once.xi.shape
        ends = np.isfinite(once.xi)
        np.testing.assert_allclose(many.xi[ends], once.xi[ends] / steps, rtol=0, atol=1e-7)  # band edges: root of round-off
