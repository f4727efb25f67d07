"""Every site its own: kinds, strengths and springs against a double loop over pairs, derived numerically."""

import itertools
import pickle

import numpy as np
import pytest
from ase.constraints import FixAtoms
from oracles import SiteEnergy, free_basis, gradient, in_plane, lattice, second_derivatives
from scipy.linalg import eigh

from magphonon import (
    AllNeighbours,
    InversePower,
    MagneticRepulsion,
    Yukawa,
    analytic_bands,
    finite_displacements,
    lattices,
    modes,
    phonopy_bands,
    relaxed,
    units as u,
    verdict,
)
from magphonon.bands import band_path
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions import UprightMagnets
from magphonon.interactions.bond_laws import BondLaws
from magphonon.stiffness.matrices import bloch_series

LAWS = {(0, 0): InversePower(b=6200.0, a=4.5824), (1, 0): InversePower(b=25.0, a=2.0), (1, 1): Yukawa(c=20.0, kappa=0.3)}
"""About 0.2 N at 10 mm each, and of different slope."""
REACH = 12.0
CELLS = 'chain', 'square', 'triangular', 'honeycomb', 'kagome', 'fcc'


class Drawn:
    """A structure made of one number: kinds, strengths, springs, masses, scatter, a hole, held walls; periodic or not.

    With `cells` along each vector it is periodic.
    """

    def __init__(self, seed, cells=None):
        rng = np.random.default_rng(seed)
        name = CELLS[seed % len(CELLS)]
        cell = lattice(name)
        self.atoms = atoms = cell.repeat(np.where(cell.pbc, cells or (4 if name == 'chain' else 2), 1))
        self.dim = 3 if cell.pbc.all() else 2
        if self.dim == 2 and not cells and rng.random() < 0.5:
            atoms.pbc = False
            if rng.random() < 0.5:
                del atoms[len(atoms) // 2]
        n = len(atoms)
        atoms.positions[:, : self.dim] += rng.uniform(-0.3, 0.3, (n, self.dim))
        atoms.set_tags(rng.integers(0, 2, n))
        atoms.set_masses(rng.uniform(0.5, 1.5, n))
        self.strengths = rng.uniform(0.7, 1.3, n)
        self.given = rng.uniform(0.2, 0.6, [(n,), (n, self.dim), (1, self.dim), ()][seed // len(CELLS) % 4])
        shape = self.given[:, None] if self.given.ndim == 1 else self.given
        self.springs = np.broadcast_to(shape, (n, self.dim))
        self.anchors = atoms.positions + np.pad(rng.uniform(-0.2, 0.2, (n, self.dim)), ((0, 0), (0, 3 - self.dim)))
        if rng.random() < 0.5:
            atoms.set_constraint(FixAtoms([0, n - 1]))
        self.calc = MagneticRepulsion(atoms, LAWS, foundation=self.given if self.given.ndim else float(self.given),
                                      strengths=self.strengths, anchors=self.anchors, cutoff=REACH)
        atoms.calc = self.calc
        self.rng = rng

    def energy(self, kinds=None, strengths=None, springs=None):
        """The oracle's, or one that mistakes sites for each other."""
        perfect = self.atoms.copy()
        if kinds is not None:
            perfect.set_tags(kinds)
        return SiteEnergy(perfect, {frozenset(pair): law for pair, law in LAWS.items()}, REACH,
                          self.strengths if strengths is None else strengths, self.springs if springs is None else springs,
                          self.anchors[:, : self.dim])

    def mistaken(self):
        """Oracles with kinds, strengths or springs of other sites, where that makes a difference."""
        yield self.energy(kinds=1 - self.atoms.get_tags())
        yield self.energy(strengths=self.strengths[::-1])
        if np.ptp(self.springs):
            yield self.energy(springs=self.springs[::-1, ::-1])

    def displaced(self):
        atoms = self.atoms.copy()
        atoms.calc = self.calc
        atoms.set_constraint()
        atoms.positions[:, : self.dim] += self.rng.uniform(-0.3, 0.3, (len(atoms), self.dim))
        return atoms, atoms.positions[:, : self.dim].ravel()


def apart(found, expected):
    return abs(found - expected).max() / abs(expected).max()


@pytest.mark.parametrize('seed', range(12))
def test_forces_and_energies_are_those_of_the_double_loop(seed):
    drawn = Drawn(seed)
    atoms, x = drawn.displaced()
    rest = drawn.atoms.positions[:, : drawn.dim].ravel()
    for k, energy in enumerate((drawn.energy(), *drawn.mistaken())):
        force = apart(atoms.get_forces()[:, : drawn.dim].ravel(), -gradient(energy, x))
        spent = apart(atoms.get_potential_energy(), energy(x) - energy(rest))
        assert (max(force, spent) < 1e-11) if k == 0 else (force > 1e-3)
    assert atoms.get_potential_energies().sum() == pytest.approx(atoms.get_potential_energy())


@pytest.mark.parametrize('seed', [1, 9])
def test_relaxed_structures_and_their_modes_are_those_of_the_double_loop(seed):
    drawn = Drawn(seed)
    rest = relaxed(drawn.atoms).atoms
    x, B, mass = rest.positions[:, : drawn.dim].ravel(), free_basis(rest, drawn.dim), np.repeat(rest.get_masses(), drawn.dim)
    found = modes(rest).omega
    for k, energy in enumerate((drawn.energy(), *drawn.mistaken())):
        left = abs(B.T @ gradient(energy, x)).max()
        H = second_derivatives(energy, x)
        squares = eigh(B.T @ H @ B, B.T @ (mass[:, None] * B), eigvals_only=True)
        off = apart(found * abs(found), squares)
        stiffness = apart(in_plane(rest.calc.get_hessian(rest), drawn.dim), H)
        assert (left < 1e-10 and max(off, stiffness) < 1e-9) if k == 0 else (left > 1e-4 and min(off, stiffness) > 1e-5)
    assert verdict(rest).stable == (squares[0] > 0)


@pytest.mark.parametrize('seed', [3, 4])
def test_bands_of_cells_whose_sites_differ_by_both_methods(seed):
    """Waves that fit twice into the cell are the vibrations of twice the cell, which the double loop knows at q = 0 only."""
    drawn = Drawn(seed, cells=1)
    cell = drawn.atoms
    cell.set_constraint()
    cell.calc = drawn.calc.about(cell).balanced(np.arange(len(cell)))
    double = cell.repeat((2, 1, 1))
    omega = bloch_modes(cell, [[0, 0, 0], [0.5, 0, 0]])[0].ravel()
    order = drawn.rng.permutation(len(double))
    carried = cell.calc.on(double[order])
    assert np.array_equal(carried.reference.get_tags(), double.get_tags()[order])
    energy = SiteEnergy(double, {frozenset(pair): law for pair, law in LAWS.items()}, REACH, np.tile(drawn.strengths, 2),
                        np.tile(drawn.springs, (2, 1)), 0.0)
    H = second_derivatives(energy, double.positions[:, : drawn.dim].ravel())
    mass = np.repeat(double.get_masses(), drawn.dim)
    squares = np.linalg.eigvalsh(H / np.sqrt(mass * mass[:, None]))
    assert apart(np.sort(omega * abs(omega)), squares) < 1e-10
    path = band_path(cell, npoints=4)
    exact = analytic_bands(cell, path).omega
    assert apart(phonopy_bands(finite_displacements(cell), path).omega, exact) < 1e-8
    without = MagneticRepulsion(cell, LAWS, cutoff=REACH, foundation=drawn.given)
    cell.calc = without.balanced(np.arange(len(cell)))
    assert apart(analytic_bands(cell, path).omega, exact) > 1e-3


def test_upright_magnets_of_different_kinds_and_strengths_have_the_same_bands_by_both_methods():
    cell = lattice('honeycomb')
    cell.set_tags([0, 1])
    laws = {pair: UprightMagnets(law) for pair, law in LAWS.items()}
    cell.calc = MagneticRepulsion(cell, laws, foundation=[[0.3, 0.3, 0.9]], strengths=[1.0, 0.9], shells=2)
    path = band_path(cell, npoints=4)
    exact = analytic_bands(cell, path).omega
    assert apart(phonopy_bands(finite_displacements(cell), path).omega, exact) < 1e-8
    cell.calc = MagneticRepulsion(cell, laws, foundation=[[0.3, 0.3, 0.9]], shells=2)
    assert apart(analytic_bands(cell, path).omega, exact) > 1e-3


def test_particles_that_are_alike_have_the_one_law_and_one_number():
    cell = lattice('honeycomb')
    law = LAWS[0, 0]
    for potential in (law, LAWS):
        calc = MagneticRepulsion(cell, potential, foundation=[0.3, 0.3], strengths=[1, 1])
        assert calc.law is law
        assert calc.foundation == 0.3
        assert isinstance(calc.foundation, float)


def test_law_along_bonds_is_that_of_each_pair():
    drawn = Drawn(2)
    law, bonds = drawn.calc.law, drawn.calc.bonds
    assert isinstance(law, BondLaws)
    tags, s = drawn.atoms.get_tags(), drawn.strengths
    r = np.linspace(8.0, 12.0, 3 * len(bonds)).reshape(-1, 1, 3)
    for name, b in itertools.product(('phi', 'dphi', 'd2phi'), range(len(bonds))):
        i, j = bonds.i[b], bonds.j[b]
        own = LAWS.get((tags[i], tags[j])) or LAWS[tags[j], tags[i]]
        assert getattr(law, name)(r)[b] == pytest.approx(s[i] * s[j] * getattr(own, name)(r[b]))


def test_another_calculator_keeps_what_is_each_sites_own():
    drawn = Drawn(1)
    atoms, _ = drawn.displaced()
    forces = atoms.get_forces()
    other = pickle.loads(pickle.dumps(drawn.calc))
    assert np.array_equal(other.get_forces(atoms), forces)
    assert abs(drawn.calc.about(atoms).get_forces(atoms) - forces).max() < 1e-12 * abs(forces).max()
    atoms.calc.set(foundation=np.full((1, drawn.dim), 0.1))
    assert atoms.calc.foundation == 0.1
    with pytest.raises(ValueError, match='read-only'):
        drawn.calc.strengths[0] = 2.0


def test_springs_of_their_own_in_sums_over_all_neighbours():
    cell = lattice('honeycomb')
    springs = np.array([[0.1, 0.2], [0.3, 0.4]])
    cell.calc = AllNeighbours(cell, LAWS[0, 0], foundation=springs)
    q = np.array([[0.1, 0.3, 0.0]])
    bare = AllNeighbours(cell, LAWS[0, 0]).bloch_matrix(q)
    assert np.allclose(cell.calc.bloch_matrix(q) - bare, np.diag(springs.ravel()), atol=1e-14)
    double = cell.repeat((2, 1, 1))
    assert np.array_equal(cell.calc.on(double).foundation, np.tile(springs, (2, 1)))
    there = cell.copy()
    there.positions[:, :2] += 1e-3
    force = cell.calc.get_forces(there) - AllNeighbours(cell, LAWS[0, 0]).get_forces(there)
    assert np.allclose(force[:, :2], -1e-3 * springs, rtol=1e-9)


@pytest.mark.parametrize(('given', 'words'), [
    ({'foundation': [0.1, 0.2, 0.3]}, r'one of the shapes \(2,\), \(2, 1\), \(1, 2\), \(2, 2\)'),
    ({'foundation': [0.1, -0.2]}, r'foundation\[1\] must be a zero or positive number in N/mm, not -0.2'),
    ({'foundation': [0.1, np.nan]}, r'foundation\[1\] is nan'),
    ({'strengths': [1.0]}, r'strengths must have the shape \(2,\)'),
    ({'strengths': [1.0, -1.0]}, r'strengths\[1\] must be a zero or positive number, not -1.0'),
    ({'laws': {(0, 0): LAWS[0, 0]}}, r'the particles 0 and 1 are bonded, but no law is given for their kinds, 0 and 1'),
    ({'laws': {0: LAWS[0, 0]}}, 'laws belong to pairs of kinds'),
    ({'laws': {(0, 1): LAWS[0, 0], (1, 0): LAWS[1, 1]}}, 'the kinds 0 and 1 have two laws'),
    ({'laws': {(0, 1): 3.0}}, 'lacks the method phi'),
])
def test_refusals_of_what_is_no_site(given, words):
    cell = lattice('honeycomb')
    cell.set_tags([0, 1])
    with pytest.raises(ValueError, match=words):
        MagneticRepulsion(cell, **{'laws': LAWS, **given})


@pytest.mark.parametrize('name', ['honeycomb', 'kagome', 'chain'])
def test_strengths_in_sums_over_all_neighbours(name):
    """Of a law so steep that far shells are nothing, against many shells."""
    law, rng = InversePower(b=2e13, a=13.0), np.random.default_rng(3)
    cell = lattice(name).repeat((2, 1, 1))
    n = len(cell)
    cell.positions[:, :2] += rng.uniform(-0.3, 0.3, (n, 2))
    strengths, q = rng.uniform(0.7, 1.3, n), np.array([[0.0, 0, 0], [0.2, 0.1, 0], [0.5, 0.3, 0]]) * cell.pbc
    everything = AllNeighbours(cell, law, foundation=0.3, strengths=strengths)
    many = MagneticRepulsion(cell, law, foundation=0.3, strengths=strengths, cutoff=61.0)
    alike = AllNeighbours(cell, law, foundation=0.3)
    there = cell.copy()
    there.positions[:, :2] += rng.uniform(-0.2, 0.2, (n, 2))
    along = np.array([1.0, 0.0])

    def series(calc):  # with the phases of the particles, not of their cells
        return calc.bloch_series(along)[2] if calc is not many else bloch_series(many.bonds, many.rest_stiffness(),
                                                                                 many.bond_vectors @ along)[2]

    for ask in (lambda calc: calc.bloch_matrix(q), lambda calc: calc.bloch_matrix(q, 'conventional'),
                lambda calc: calc.get_forces(there), series):
        expected = ask(many)
        assert apart(ask(everything), expected) < 1e-6  # the shells beyond, which fall by r^-13
        assert apart(ask(alike), expected) > 1e-2
    energy = everything.get_potential_energy(there) - everything.get_potential_energy(cell)
    assert energy == pytest.approx(many.get_potential_energy(there) - many.get_potential_energy(cell), rel=1e-7)
    order = rng.permutation(2 * n)
    double = cell.repeat((2, 1, 1))[order]
    assert np.allclose(everything.on(double).strengths, np.tile(strengths, 2)[order])
    assert np.allclose(everything.onsite(), everything.onsite('D0') + everything.onsite('Dstar'))


@pytest.mark.parametrize('strengths', [[1.0, 0.4], [0.0, 1.0]])
def test_bands_of_all_neighbours_of_two_strengths(strengths):
    """A double loop over all neighbours within 15 cells, where exp(-0.3 r) has died away; other masses are noticed."""
    law, cell, q = Yukawa(c=20.0, kappa=0.3), lattice('honeycomb'), np.array([0.17, 0.31, 0.0])
    cell.calc = AllNeighbours(cell, law, foundation=[[0.3, 0.4]], strengths=strengths)
    D = np.kron(np.eye(2), np.diag([0.3, 0.4])).astype(complex)
    for shift in itertools.product(range(-15, 16), repeat=2):
        phase = np.exp(2j * np.pi * (q[:2] @ shift))
        for i, j in itertools.product(range(2), repeat=2):
            d = (cell.positions[j] - cell.positions[i] + np.array([*shift, 0]) @ cell.cell.array)[:2]
            if not (r := np.linalg.norm(d)):
                continue
            n = d / r
            K = law.d2phi(r) * np.outer(n, n) + law.dphi(r) / r * (np.eye(2) - np.outer(n, n))
            K = strengths[i] * strengths[j] * K
            D[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += K
            D[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] -= phase * K
    mass = np.repeat(cell.get_masses(), 2)
    squares = np.linalg.eigvalsh(D / np.sqrt(mass * mass[:, None]))
    assert apart(bloch_modes(cell, [q])[0][0] ** 2, squares) < 1e-10
    assert phonopy_bands(finite_displacements(cell, (3, 3, 1)), band_path(cell, 'GK', 2)).omega.shape == (2, 4)
    assert verdict(cell).stable
    cell.set_masses([1.0, 3.0])
    assert apart(bloch_modes(cell, [q])[0][0] ** 2, squares) > 1e-3


def test_si_numbers_without_units_are_warned_of():
    """They give frequencies that look possible, 1000 times too high."""
    typed = lattices.triangular(0.01, 7.07e-4)
    with pytest.warns(UserWarning, match=r'7.1e\+05 g/cm\^3; numbers are in mm, g, ms and N'):
        MagneticRepulsion(typed, InversePower(1.6209e-10, 4.5824), foundation=19.6757)
    right = lattices.triangular(0.01 * u.m, 7.07e-4 * u.kg)
    MagneticRepulsion(right, InversePower(1.6209e-10 * u.N * u.m**4.5824, 4.5824), foundation=19.6757 * u.N / u.m)
    MagneticRepulsion(lattices.triangular(1.0, 1.0), InversePower(1.0, 4.0))  # a lattice in units of its own
