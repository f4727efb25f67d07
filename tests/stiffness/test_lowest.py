"""The lowest eigenvalue of large matrices against dense algebra, on patches drawn at random."""

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scipy import sparse

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.lattices.bonds import find_bonds
from magphonon.response.chebyshev import whole_interval
from magphonon.stiffness import lowest
from magphonon.stiffness.lowest import lowest_mode
from magphonon.stiffness.rest import LinearSystem


def patch_matrix(seed):
    """Of a patch with holes, with a free rim, whose lowest eigenvalues crowd; more than 200 rows."""
    rng = np.random.default_rng(seed)
    cell = (lattices.honeycomb, lattices.kagome, lattices.triangular, lattices.square)[seed % 4](1.0, 1.0)
    shape = (lattices.hexagon, lattices.half_hexagon)[seed // 4 % 2]
    patch = shape(cell, rng.uniform(9, 12))
    patch = patch[np.sort(rng.permutation(len(patch))[: int(0.97 * len(patch))])]
    patch.set_constraint()
    patch.set_masses(rng.uniform(0.5, 1.5, len(patch)))
    law = InversePower(1.0, rng.uniform(1.5, 6))
    patch.calc = MagneticRepulsion(patch, law, cutoff=1.2, foundation=rng.uniform(0, 2)).balanced(range(len(patch)))
    return LinearSystem.of(patch).K


@pytest.mark.parametrize('seed', range(8))
def test_lowest_eigenvalue_of_a_patch_to_round_off(seed):
    K = patch_matrix(seed)
    values, vectors = np.linalg.eigh(K.toarray())
    assert K.shape[0] > lowest.DENSE
    low, high, mode = lowest_mode(K)
    assert low == pytest.approx(values[0], abs=1e-13 * values[-1])
    assert values[-1] <= high < 3 * values[-1]
    assert_allclose(K @ mode, low * mode, atol=1e-12 * high)
    alike = vectors[:, values < values[0] + 1e-6 * high]  # those that crowd so closely mix
    assert np.linalg.norm(alike.T @ mode) == pytest.approx(1, abs=1e-6)


@pytest.mark.slow
def test_lanczos_on_the_matrix_itself_stops_short():
    """The control: what was done before, to 1e-4 of the eigenvalue."""
    short = []
    for seed in range(8):
        K = patch_matrix(seed)
        start = np.random.default_rng(0).normal(size=K.shape[0])
        rough = sparse.linalg.eigsh(K, k=1, which='SA', v0=start, tol=1e-4, return_eigenvectors=False)[0]
        short.append((rough - np.linalg.eigvalsh(K.toarray())[0]) / lowest_mode(K)[1])
    assert max(short) > 1e-11  # a hundred times what is allowed above


@pytest.mark.parametrize('seed', range(3))
def test_chains_of_soft_and_stiff_springs_have_a_lowest_mode(seed):
    """Springs drawn over four and more decades; the control: Lanczos iterations on the matrix itself do not end."""
    rng, size = np.random.default_rng(seed), 300
    k = 10 ** rng.uniform(0, rng.uniform(4, 8), size + 1)
    K = sparse.csr_array(sparse.diags_array([k[:-1] + k[1:], -k[1:-1], -k[1:-1]], offsets=[0, 1, -1]))
    exact = np.linalg.eigvalsh(K.toarray())
    assert lowest_mode(K)[0] == pytest.approx(exact[0], abs=1e-13 * exact[-1])
    shifted = whole_interval(sparse.csr_array(K - exact[1] * sparse.eye_array(size)))
    assert shifted.lowest <= exact[0] - exact[1] < 0
    with pytest.raises(sparse.linalg.ArpackNoConvergence):
        sparse.linalg.eigsh(K, k=1, which='SA', v0=rng.normal(size=size), tol=1e-3, maxiter=300)


def test_a_shift_above_the_lowest_eigenvalue_is_noticed_by_its_pivots(monkeypatch):
    """The first look is so rough that the first shifts lie between eigenvalues; inverted there, another one is found."""
    K = patch_matrix(0)
    values = np.linalg.eigvalsh(K.toarray())
    between = (2 * values[9] + values[10]) / 3  # a shift nearer to the tenth
    assert sparse.linalg.eigsh(sparse.csc_array(K), k=1, sigma=between, return_eigenvectors=False)[0] > values[5]
    eigsh = sparse.linalg.eigsh

    def rough(D, **options):
        return eigsh(D, **options) if options.get('return_eigenvectors', True) else np.array([between])

    monkeypatch.setattr(sparse.linalg, 'eigsh', rough)
    monkeypatch.setattr(lowest, 'ROUGH', 1e-9)
    assert lowest_mode(K)[0] == pytest.approx(values[0], abs=1e-13 * values[-1])


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(3))
def test_the_lowest_of_a_crowd_in_a_flat_band(seed):
    """Motion out of the plane of a kagome patch with a held rim: a third of all modes lie in or next to the lowest band."""
    rng = np.random.default_rng(seed)
    patch = lattices.parallelogram(lattices.kagome(1.0, 1.0), *map(int, rng.integers(14, 20, 2)))
    i, j = find_bonds(patch).i, find_bonds(patch).j
    free = np.flatnonzero(patch.get_tags() != lattices.RIM)
    graph = sparse.coo_array((np.ones(len(i)), (i, j)), (len(patch), len(patch))).tocsr()
    graph = graph + graph.T
    D = sparse.csr_array((graph - sparse.diags_array(graph.sum(axis=1))).tocsr()[free][:, free])  # springs of -1
    exact = np.linalg.eigvalsh(D.toarray())
    low, high, mode = lowest_mode(D)
    assert low == pytest.approx(exact[0], abs=lowest.ROUND_OFF * high)
    assert np.linalg.norm(D @ mode - low * mode) < 1e-9 * high  # of a mixture of modes in the crowd
    with pytest.raises(sparse.linalg.ArpackNoConvergence):  # from as far as is near enough elsewhere
        sparse.linalg.eigsh(D, k=1, sigma=exact[0] - lowest.ROUGH * (high - exact[0]), v0=rng.normal(size=len(free)),
                            maxiter=lowest.FEW_RESTARTS)


def test_nothing_free_and_nothing_stiff():
    assert lowest_mode(sparse.csr_array((0, 0)))[:2] == (0, 0)
    for size in (3, 300):
        low, high, mode = lowest_mode(sparse.csr_array((size, size)))
        assert (low, high, np.linalg.norm(mode)) == (0, 0, 1)
