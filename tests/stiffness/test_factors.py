"""Sparse factors by CHOLMOD and by SuperLU, on structures drawn at random, against dense algebra."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from numpy.testing import assert_allclose
from scipy import sparse
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.interactions import Yukawa
from magphonon.stiffness import LinearSystem, factors
from magphonon.stiffness.factors import factorised, inverse
from magphonon.stiffness.lowest import count_below, lowest_mode


def drawn(seed):
    """K of one of: a patch with holes, a torus, a lattice in space, pieces far apart, pairs of columns that coincide, a strip."""
    rng = np.random.default_rng(seed)
    planar = (lattices.triangular, lattices.square, lattices.honeycomb)[rng.integers(3)](1.0, 1.0)
    match seed % 6:
        case 0:
            atoms = lattices.hexagon(planar, rng.uniform(7, 9))
            atoms = atoms[np.sort(rng.permutation(len(atoms))[: int(0.9 * len(atoms))])]
        case 1:
            atoms = planar.repeat((*rng.integers(8, 11, 2), 1))
        case 2:
            atoms = (lattices.fcc, lattices.bcc)[rng.integers(2)](1.0, 1.0).repeat(rng.integers(4, 6, 3))
            atoms.set_constraint(FixAtoms(rng.permutation(len(atoms))[:9]))
        case 3:
            atoms = lattices.hexagon(planar, rng.uniform(4, 6))
            far = atoms.copy()
            far.positions[:, 0] += 100
            atoms = atoms + far[: len(far) // 2]
        case 4:
            atoms = lattices.parallelogram(planar, *rng.integers(6, 9, 2))
        case 5:
            atoms = lattices.parallelogram(planar, 4, int(rng.integers(40, 60)))
    atoms.set_masses(rng.uniform(0.5, 1.5, len(atoms)))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, rng.uniform(1.5, 6)), cutoff=1.2, foundation=rng.uniform(0, 3))
    K = LinearSystem.about(atoms.calc, atoms).K
    if seed % 6 == 4:  # a second particle at each place, with the same neighbours and none of its own
        K = sparse.csr_array(sparse.kron(np.eye(2), K) + sparse.kron([[0, 1], [1, 0]], 0.1 * sparse.eye_array(K.shape[0])))
    return K


@pytest.fixture(params=['CHOLMOD', 'SuperLU'])
def library(request, monkeypatch):
    """CHOLMOD for matrices of all sizes, or for none."""
    if request.param == 'CHOLMOD':
        pytest.importorskip('cvxopt')
    monkeypatch.setattr(factors, 'LARGE', 0 if request.param == 'CHOLMOD' else np.inf)


@pytest.mark.parametrize('seed', few_first(range(12), 8))
def test_factors_tell_the_same(seed, library):
    """Solutions, real and complex, definite and not, and counts at shifts drawn between the eigenvalues of dense algebra."""
    K, rng = drawn(seed), np.random.default_rng(seed)
    size = K.shape[0]
    squares = np.linalg.eigvalsh(K.toarray())
    apart = np.flatnonzero(np.diff(squares) > 1e-6 * squares[-1])
    b = rng.normal(size=(size, 2)) @ [1, 1j]
    for k in rng.choice(apart, 2):
        shift = squares[[k, k + 1]].mean()
        assert count_below(K, shift) == k + 1
        for A in (K - shift * sparse.eye_array(size), K + (0.1j - shift) * sparse.eye_array(size)):
            there = np.linalg.solve(A.toarray(), b)
            assert_allclose(inverse(A)(b), there, rtol=0, atol=1e-9 * abs(there).max())
    several = rng.normal(size=(size, 3))
    assert_allclose(A @ inverse(A)(several), several, atol=1e-9)
    low, _, mode = lowest_mode(K)
    assert low == pytest.approx(squares[0], abs=1e-12 * squares[-1])
    assert_allclose(K @ mode, low * mode, atol=1e-10 * squares[-1])


def test_one_magnet_and_no_bonds(library):
    for diagonal in ([2.0], [2.0, -3.0, 4.0], np.arange(1.0, 100)):
        A = sparse.csr_array(sparse.diags_array(diagonal))
        assert_allclose(inverse(A)(np.ones(len(diagonal))), 1 / np.array(diagonal), rtol=1e-15)


def test_diagonal_pivots_that_fail_are_replaced(library):
    """Those of two rows next to nothing; the control: without other pivots the answer is wrong."""
    A = sparse.csr_array([[1e-18, 1.0, 0], [1.0, 1e-18, 1.0], [0, 1.0, 1.0]])
    b = np.array([1.0, 2.0, 3.0])
    there = np.linalg.solve(A.toarray(), b)
    assert_allclose(inverse(A)(b), there, atol=1e-12)
    lone = factorised(A)
    assert abs(lone.solve(b) - there).max() > 1e-3
    with pytest.raises(RuntimeError, match='singular'):
        inverse(sparse.csr_array(np.ones((2, 2))))


def test_cholmod_proves_what_is_definite_and_leaves_the_rest_to_pivots(monkeypatch):
    pytest.importorskip('cvxopt')
    monkeypatch.setattr(factors, 'LARGE', 0)
    for seed in range(6):
        K = drawn(seed)
        squares = np.linalg.eigvalsh(K.toarray())
        above = factorised(K + (0.01 * squares[-1] - squares[0]) * sparse.eye_array(K.shape[0]), definite=True)
        assert (above.lu, above.negative()) == (None, 0)
        middle = squares[len(squares) // 2 + np.diff(squares)[len(squares) // 2 :].argmax() :][:2].mean()
        within = factorised(K - middle * sparse.eye_array(K.shape[0]), definite=True)
        assert within.negative() == (squares < middle).sum() > 0


def test_an_order_of_elimination_serves_matrices_of_the_same_pattern():
    """The same fill; the control: rows in a random order have more."""
    for seed in range(6):
        K, rng = drawn(seed), np.random.default_rng(seed)
        first = factorised(K + 30 * sparse.eye_array(K.shape[0]))
        again, random = (factorised(K + 40 * sparse.eye_array(K.shape[0]), order)
                         for order in (first.order, rng.permutation(K.shape[0])))
        assert again.lu.nnz <= 1.02 * first.lu.nnz
        assert random.lu.nnz > 1.3 * first.lu.nnz
        b = rng.normal(size=(K.shape[0], 2))
        assert_allclose(again.solve(b), random.solve(b), rtol=1e-10, atol=1e-14)


def test_a_hessian_keeps_no_round_off_and_every_bond():
    """In a honeycomb torus 12 entries a particle: its own 2, 2 of the bond along y, 4 of each of the others."""
    atoms = lattices.honeycomb(1.0, 1.0).repeat((40, 40, 1))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), cutoff=1.2, foundation=9.0)
    K, blocks = abs(LinearSystem.about(atoms.calc, atoms).K.data), abs(atoms.calc.rest_stiffness('complete'))
    assert len(K) == 12 * len(atoms)
    assert K.min() > 0.01 * K.max()
    assert 0 < blocks[blocks > 0].min() < 1e-14 * blocks.max()  # the control: what would stay of the bonds along y
    row = lattices.chain(1.0, 1.0).repeat((40, 1, 1))
    row.calc = MagneticRepulsion(row, Yukawa(1.0, 0.02), cutoff=2.1, foundation=1e-40)  # second neighbours are e^50 times weaker
    assert LinearSystem.about(row.calc, row).K.nnz == 2 * 5 * len(row)
