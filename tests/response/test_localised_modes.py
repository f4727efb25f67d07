"""Local modes of defects, edges and disorder: closed forms of chains, a vacancy in the honeycomb, all modes of drawn patches."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from motion import L0, LAW, MASS, patch
from numpy.testing import assert_allclose
from scipy import sparse

from magphonon import MagneticRepulsion, lattices, modes, relaxed, units as u
from magphonon.bands import band_gaps
from magphonon.response import Modes, local_modes, localisation
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.lowest import eigenpairs_between

K = LAW.d2phi(L0)  # N/mm


def chain(masses):
    """Particles between two held ones, that move along the chain only."""
    atoms = lattices.chain(L0, MASS).repeat((len(masses) + 2, 1, 1))
    atoms.pbc = False
    atoms.positions += [3 * L0, 5 * L0, 0]  # a line that misses the origin has one dimension too
    atoms.set_masses(np.concatenate([[MASS], masses, [MASS]]))
    atoms.calc = MagneticRepulsion(atoms, LAW)
    atoms.set_constraint([FixAtoms([0, len(masses) + 1]), FixedLine(np.arange(1, len(masses) + 1), (1, 0, 0))])
    return atoms


@pytest.mark.parametrize('mu', [0.3, 0.6, 0.9])
def test_a_light_mass_in_a_chain_is_the_closed_form(mu):
    """`omega/omega_max = 1/sqrt(mu (2 - mu))`, and from site to site the displacement is -x = -mu/(2 - mu) times as large."""
    masses = np.full(401, MASS)
    masses[200] *= mu
    atoms, top = chain(masses), 2 * np.sqrt(K / MASS)
    found = local_modes(atoms, (1.0001 * top, 3 * top))
    assert_allclose(found.omega, [top / np.sqrt(mu * (2 - mu))], rtol=1e-9)
    x = mu / (2 - mu)
    shape = found.shapes[0, 201:211, 0]
    assert_allclose(shape[1:] / shape[:-1], -x, rtol=1e-6)
    extent = localisation(found, atoms)
    inside, outside = mu, 2 * x**2 / (1 - x**2)  # shares of the light mass and of all others, before they are normalised
    second = 2 * x**2 * (1 + x**2) / (1 - x**2) ** 3 / (inside + outside)
    fourth = (inside**2 + 2 * x**4 / (1 - x**4)) / (inside + outside) ** 2
    assert_allclose(extent.participation, 1 / fourth, rtol=1e-6)
    assert_allclose(extent.length, L0 * np.sqrt(2 * second), rtol=1e-6)
    assert_allclose(extent.centre[0], atoms.positions[201, :2], atol=1e-6)
    assert_allclose(extent.along, [[1, 0]], atol=1e-12)
    if mu == 0.9:  # a slow decay: the length is that of e^{-r/l}
        assert extent.length[0] == pytest.approx(L0 / np.log(1 / x), rel=0.05)
    assert not len(local_modes(chain(np.full(401, MASS)), (1.0001 * top, 3 * top)).omega)


def dimers(cells, spacings, walls=True):
    """Chain of cells of two particles at two spacings by turns, between walls or periodic; dead loads balance it."""
    steps = np.resize(spacings, 2 * cells + walls)
    atoms = lattices.chain(L0, MASS).repeat((2 * cells + 2 * walls, 1, 1))
    atoms.positions[:, 0] = np.concatenate([[0.0], np.cumsum(steps)])[: len(atoms)]
    atoms.cell[0, 0] = sum(spacings) * cells
    atoms.pbc = (not walls, False, False)
    ring = [] if walls else [(len(atoms) - 1, 0, (1, 0, 0))]
    bonds = [(k, k + 1, (0, 0, 0)) for k in range(len(atoms) - 1)] + ring
    atoms.calc = MagneticRepulsion(atoms, LAW, bonds=bonds).balanced(range(len(atoms)))
    inside = np.arange(walls, len(atoms) - walls)
    atoms.set_constraint([FixAtoms(np.setdiff1d(np.arange(len(atoms)), inside)), FixedLine(inside, (1, 0, 0))])
    return atoms


def test_a_dimerised_chain_has_its_gap_and_a_mode_at_each_end():
    near, far = 9.0, 11.0
    strong, weak = LAW.d2phi(near), LAW.d2phi(far)
    infinite = dimers(1, (near, far), walls=False)
    gaps = band_gaps(infinite)
    assert_allclose(gaps, [np.sqrt([2 * weak / MASS, 2 * strong / MASS])], rtol=1e-12)
    (gap,) = gaps
    finite = dimers(30, (near, far))
    found = local_modes(finite, gap)
    assert_allclose(found.omega, np.sqrt((strong + weak) / MASS), rtol=1e-9)
    assert len(found.omega) == 2
    # the pair is degenerate, and any two combinations of left and right may come out
    energy = (MASS * found.shapes[:, :, 0] ** 2).sum(axis=0)
    assert_allclose(energy[1:30:2][1:10] / energy[1:30:2][:9], (weak / strong) ** 2, rtol=1e-6)
    assert_allclose(energy[2:20:2], 0, atol=1e-9)
    assert_allclose(energy, energy[::-1], atol=1e-9)
    everything = modes(finite)
    assert everything.omega[-1] < np.sqrt(2 * (strong + weak) / MASS) < 1.01 * everything.omega[-1]
    assert not len(local_modes(dimers(30, (far, near)), gap).omega)


def vacancy():
    """Honeycomb of two masses, 10 x 10 cells, periodic, with one magnet missing."""
    cell = lattices.honeycomb(L0, MASS)
    cell.set_masses([MASS, 1.5 * MASS])
    atoms = cell.repeat((10, 10, 1))
    del atoms[0]
    cell.calc, atoms.calc = (MagneticRepulsion(which, LAW, foundation=80 * u.N / u.m) for which in (cell, atoms))
    return cell, atoms


def test_a_missing_magnet_holds_three_modes_in_the_gap_once_it_is_relaxed():
    cell, atoms = vacancy()
    (gap,) = band_gaps(cell)
    rest = relaxed(atoms).atoms
    found = local_modes(rest, gap)
    assert_allclose(found.frequencies_Hz, [78.83, 78.83, 80.27], atol=0.005)
    extent = localisation(found, rest)
    assert (extent.participation < 16).all()  # of 199
    hole = np.zeros(3)
    away = extent.centre - hole[:2]
    cells = np.linalg.solve(atoms.cell.array[:2, :2].T, away.T).T
    assert np.linalg.norm((cells - cells.round()) @ atoms.cell.array[:2, :2], axis=1).max() < L0
    unrelaxed = LinearSystem.about(atoms.calc, atoms)
    assert not (abs(local_modes(unrelaxed, gap).frequencies_Hz[:, None] - [78.83, 80.27]) < 0.5).any()


def test_random_masses_localise_as_the_inverse_square_of_the_frequency():
    """Weak disorder: amplitudes decay by `omega^2 <dm^2>/(8 k <m>)` a site (Matsuda and Ishii 1970)."""
    rng = np.random.default_rng(2)
    masses = MASS * rng.choice([0.5, 1.5], 5000)
    system, top = LinearSystem.of(chain(masses)), 2 * np.sqrt(K / MASS)
    means = []
    for at in (0.2, 0.4):
        found = local_modes(system, np.array([at - 0.004, at + 0.004]) * top)
        assert len(found.omega) > 15
        means.append(localisation(found, system).length.mean())
        theory = L0 * 8 * K * MASS / (at * top) ** 2 / (0.5 * MASS) ** 2
        # a mode is no pure exponential: peaks of some lengths side by side, so that its second moment is of this order only
        assert 0.4 < means[-1] / theory < 2.0
    assert means[0] / means[1] == pytest.approx(4, rel=0.35)  # of 25 modes each
    ordered = localisation(local_modes(chain(np.full(5000, MASS)), np.array([0.198, 0.202]) * top), chain(np.full(5000, MASS)))
    assert ordered.length.min() > 5 * means[0]  # which ends with the chain


@pytest.mark.parametrize('seed', range(6))
def test_all_modes_of_a_range_are_found(seed):
    rng = np.random.default_rng(seed)
    atoms = patch(int(rng.integers(11, 15)))  # 81 to 169 inside: both sides of what is diagonalised completely
    atoms.set_masses(rng.uniform(0.5, 1.5, len(atoms)) * MASS)
    everything = modes(atoms)
    ends = np.sort(rng.uniform(0.3, 0.95, 2))
    found = local_modes(atoms, ends)
    inside = (everything.omega > ends[0]) & (everything.omega < ends[1])
    assert_allclose(found.omega, everything.omega[inside], rtol=1e-10)
    overlap = np.einsum('apx,bpx,p->ab', found.shapes, everything.shapes[inside], atoms.get_masses())
    assert_allclose(abs(np.linalg.det(overlap)), 1, rtol=1e-8)


def test_pairs_of_equal_eigenvalues_are_counted():
    D = sparse.diags_array(np.repeat(np.arange(1.0, 151.0), 2)).tocsr()
    values, vectors = eigenpairs_between(D, 99.5, 102.5)
    assert_allclose(values, np.repeat([100.0, 101.0, 102.0], 2), rtol=1e-12)
    assert_allclose(vectors.T @ vectors, np.eye(6), atol=1e-10)
    assert eigenpairs_between(D, 99.2, 99.7)[0].shape == (0,)


def test_extent_of_motion_across_a_periodic_border():
    atoms = lattices.square(L0, MASS).repeat((8, 8, 1))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=1.0)
    shape = np.zeros((1, 64, 2))
    corners = [0, 7, 56, 63]  # neighbours through the border
    shape[0, corners, 0] = 0.5 / np.sqrt(MASS)
    extent = localisation(Modes(np.ones(1), shape), atoms)
    assert extent.participation == pytest.approx(4)
    assert extent.length == pytest.approx(np.sqrt(4 / 6 * L0**2 / 2))
    assert_allclose(extent.along, [[1, 0]])


@pytest.mark.parametrize('periodic', [False, True])
def test_extents_do_not_ask_for_a_cell_where_nothing_repeats(periodic):
    """A cell may have no vectors where nothing is periodic, or vectors that lean over the others, as that of a ribbon does."""
    atoms = lattices.ribbon(lattices.triangular(L0, MASS), 5).repeat((5, 1, 1)) if periodic else patch()
    atoms.set_masses(np.random.default_rng(0).uniform(0.5, 1.5, len(atoms)))  # no two images are equally near to a mode
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=1.0)
    bare = atoms.copy()
    bare.cell[~bare.pbc] = 0
    found = modes(atoms)
    with_cell, without = localisation(found, atoms), localisation(found, bare)
    assert with_cell.length.max() > L0 / 2
    for name in ('centre', 'length', 'participation'):
        assert_allclose(getattr(without, name), getattr(with_cell, name), rtol=1e-9, atol=1e-9)
