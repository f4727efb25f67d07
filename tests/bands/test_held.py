"""Bands of structures some of whose particles are held: strips between walls, ribbons, guided particles."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.bands import (
    analytic_bands,
    band_path,
    complex_bands,
    edge_weights,
    finite_displacements,
    foundation_recovered,
    phonopy_bands,
)
from magphonon.bands.bands import edge_rows
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions import Yukawa
from magphonon.stiffness import AllNeighbours
from tests.oracles import Pairs, free_basis

LAW = InversePower(2.3e4, 4.1)
REACH = 17.4  # of all these lattices the first two shells


def strip(seed):
    """A ribbon drawn at random: lattice, width, masses, foundation, which rows are held."""
    rng = np.random.default_rng(seed)
    name = ('triangular', 'square', 'honeycomb', 'kagome')[seed % 4]
    atoms = lattices.ribbon(getattr(lattices, name)(10.0, 0.7), 3 if name in ('honeycomb', 'kagome') else int(rng.integers(3, 6)))
    atoms.set_masses(0.7 * rng.uniform(0.5, 2, len(atoms)))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=rng.choice([0.0, 0.07]), cutoff=REACH).balanced(range(len(atoms)))
    held = np.union1d(atoms.constraints[0].index, rng.choice(len(atoms), 1))[rng.integers(2) :]
    atoms.set_constraint(FixAtoms(held))
    return atoms


def truth(atoms, q):
    """Frequencies by the energy of single bonds, found by brute force; the barred directions are struck out."""
    n, calc = len(atoms), atoms.calc
    P = free_basis(atoms, 2) / np.sqrt(np.repeat(atoms.get_masses(), 2))[:, None]
    D = Pairs(atoms, LAW, REACH).bloch(atoms.positions, q) + calc.foundation * np.eye(2 * n)
    squares = np.linalg.eigvalsh(P.T @ D @ P)
    return np.sign(squares) * np.sqrt(abs(squares))


@pytest.mark.parametrize('seed', range(4))
def test_phonopy_displaces_the_free_particles_among_the_held_ones(seed):
    atoms = strip(seed)
    atoms.cell[2] = 0, 0, 30.0
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=atoms.calc.foundation, cutoff=REACH, load=atoms.calc.load)
    path = band_path(atoms, 'GX', 6)
    phonon = finite_displacements(atoms)
    exact = analytic_bands(atoms, path).omega
    found = phonopy_bands(phonon, path, vectors=True)
    # 1e-9 of the highest squared frequency, of the displacement by 1e-5 of a bond
    assert_allclose(found.omega * abs(found.omega), exact * abs(exact), rtol=0, atol=5e-9 * abs(exact).max() ** 2)
    held = atoms.constraints[0].index
    assert found.vectors.shape[2] == len(phonon.unitcell) == len(atoms) - len(held)
    # moving the free particles together stretches the springs to the held ones, and the foundation
    free = np.setdiff1d(np.arange(len(atoms)), held)
    H = truth_hessian(atoms)
    springs = H[np.ix_(free, free)].sum(axis=1)
    assert_allclose(foundation_recovered(phonon), springs, rtol=0, atol=1e-8 * abs(H).max())
    assert abs(springs - atoms.calc.foundation * np.eye(2)).max() > 1e-2 * abs(H).max()  # the control: not the foundation alone
    atoms.set_constraint([*atoms.constraints, FixedLine([free[0]], (1, 0, 0))])
    with pytest.raises(ValueError, match='phonopy moves particles in every direction'):
        finite_displacements(atoms)


def truth_hessian(atoms):
    """Shape (particles, particles, 2, 2) at zero wavevector."""
    n = len(atoms)
    H = Pairs(atoms, LAW, REACH).hessian(atoms.positions) + atoms.calc.foundation * np.eye(2 * n)
    return H.reshape(n, 2, n, 2).swapaxes(1, 2)


@pytest.mark.parametrize('seed', [0, 1, 2, 5])
def test_evanescent_waves_of_a_channel(seed):
    """A propagating wave of the strip is one of its waves at that frequency; far above the bands all of them decay."""
    atoms = strip(seed)
    xi = 0.9
    omega = truth(atoms, [xi / (2 * np.pi), 0, 0])
    wave = complex_bands(atoms, (1, 0, 0), omega[omega > 0])
    nearest = abs(wave.xi - xi).min(axis=1)
    assert nearest.max() < 1e-6
    assert not wave.vectors[:, :, atoms.constraints[0].index].any()
    above = complex_bands(atoms, (1, 0, 0), 1.5 * omega.max())
    assert (above.xi.imag > 0).all()
    # every finite wave obeys the equation of motion of the free particles, written with its complex phase
    free = np.setdiff1d(np.arange(len(atoms)), atoms.constraints[0].index)
    rows = (2 * free[:, None] + [0, 1]).ravel()
    M = np.repeat(atoms.get_masses(), 2)
    for phase, mode in zip(above.xi[0], above.vectors[0], strict=True):
        if np.isinf(phase.imag):
            continue
        D = laurent(atoms, np.exp(1j * phase)) / np.sqrt(np.outer(M, M))
        v = mode.ravel()
        size = abs(D).max()
        assert abs((D @ v - above.omega[0] ** 2 * v)[rows]).max() < 1e-8 * size


def laurent(atoms, mu):
    """The Bloch matrix at a complex phase mu of one cell."""
    pairs = Pairs(atoms, LAW, REACH)
    K, n = pairs._derivatives(atoms.positions)[1], len(atoms)
    D = np.zeros((n, n, 2, 2), complex)
    np.add.at(D, (pairs.i, pairs.i), K)
    np.add.at(D, (pairs.i, pairs.j), -K * (mu ** pairs.cell[:, 0])[:, None, None])
    return D.swapaxes(1, 2).reshape(2 * n, 2 * n) + atoms.calc.foundation * np.eye(2 * n)


def test_ribbons_with_held_and_free_edges():
    """A free edge carries waves of its own; a held edge has none."""
    cell, law = lattices.triangular(10.0, 0.7), InversePower(2.3e4, 4.1)
    ribbon = lattices.ribbon(cell, 14)
    ribbon.calc = MagneticRepulsion(ribbon, law, foundation=0.3)
    path = band_path(ribbon, 'GX', 9)
    held = analytic_bands(ribbon, path, vectors=True)
    middle = ribbon.positions[:, 1] < np.median(ribbon.positions[:, 1])
    free = ribbon.copy()
    free.calc = ribbon.calc
    free.set_constraint(FixAtoms(np.flatnonzero((ribbon.get_tags() == 1) & middle)))  # the lower edge stays
    free = relaxed(free).atoms
    bands = analytic_bands(free, path, vectors=True)
    depth = 2 * 8.7
    at_held, at_free = edge_weights(ribbon, held, depth), edge_weights(free, bands, depth)
    edge = at_free[-1, :, 1].argmax()  # at the end of the zone
    assert at_free[-1, edge, 1] > 0.95
    assert at_free[-1, edge, 0] < 1e-4
    assert at_held[-1].max() < 0.8
    # what these shares are: kinetic energy in the rows counted by hand
    rows = free.positions[:, 1] >= free.positions[:, 1].max() - depth
    motion = abs(bands.vectors[-1, edge]) ** 2
    assert at_free[-1, edge, 1] == pytest.approx(motion[rows].sum() / motion.sum(), rel=1e-12)
    assert rows.sum() == 2  # the free edge has moved outwards
    assert edge_rows(free, 1e4).sum(axis=1).tolist() == [13, 13]
    assert_allclose(edge_weights(free, bands, 1e4), 1, rtol=1e-9)


def test_edge_weights_of_crossing_branches_are_shared():
    """Both edges alike: their waves have one frequency, and any mixture of them is a mode."""
    ribbon = lattices.ribbon(lattices.square(10.0, 0.7), 9)
    ribbon.set_constraint()
    masses = ribbon.get_masses()
    masses[[0, -1]] = 0.35  # light edges
    ribbon.set_masses(masses)
    ribbon.calc = MagneticRepulsion(ribbon, Yukawa(9e3, 0.3), foundation=0.5).balanced(range(9))
    bands = analytic_bands(ribbon, band_path(ribbon, 'GX', 5), vectors=True)
    weights = edge_weights(ribbon, bands, depth=1.0)
    assert_allclose(weights[-1, -2:], weights[-1, -2:][:, ::-1], rtol=1e-6)


def test_one_sum_of_all_neighbours_between_walls():
    """Walls and the row between them, each particle with all others: a wide cell that holds two of three rows."""
    cell = lattices.triangular(10.0, 0.7).repeat((1, 3, 1))
    cell.calc = AllNeighbours(cell, InversePower.dipoles(2e3))
    cell.set_constraint(FixAtoms([0, 2]))
    q = [[0.2, 0.1, 0]]
    omega = bloch_modes(cell, q)[0]
    D = cell.calc.bloch_matrix(np.array(q))[0][2:4, 2:4] / 0.7
    assert_allclose(omega[0] ** 2, np.linalg.eigvalsh(D), rtol=1e-10)
