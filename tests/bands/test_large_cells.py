"""The lowest branches of cells with defects, found by inverses and counted by pivots, against dense algebra on the energy."""

import numpy as np
import pytest
from ase.constraints import FixAtoms
from numpy.testing import assert_allclose
from oracles import LAWS, Pairs, lattice
from scipy import sparse
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices, modes
from magphonon.bands import bloch, bloch_modes, group_velocities
from magphonon.stiffness import AllNeighbours, lowest
from magphonon.stiffness.lowest import inverse_pays, lowest_eigenpairs

SIDES = {'triangular': 16, 'square': 16, 'honeycomb': 11, 'kagome': 9, 'fcc': 5}
MODELS = 'complete', 'conventional'


def drawn(seed):
    """A large cell with vacancies, light and heavy particles, some of them held; on soft springs or none, where many buckle."""
    rng = np.random.default_rng(seed)
    name = list(SIDES)[seed % 5]
    cell = lattice(name)
    perfect = cell.repeat(np.where(cell.pbc, SIDES[name] + rng.integers(0, 2), 1))
    perfect = perfect[np.sort(rng.permutation(len(perfect))[: -int(rng.integers(1, 5))])]
    perfect.set_masses(rng.uniform(0.3, 2, len(perfect)))
    law = LAWS[str(rng.choice(['magnets', 'yukawa', 'logarithm']))]
    if seed % 2:
        perfect.set_constraint(FixAtoms(rng.choice(len(perfect), 3, replace=False)))
    k = float(rng.choice([0.0, 0.02, 0.2]))
    perfect.calc = MagneticRepulsion(perfect, law, cutoff=12.0, foundation=k).balanced(range(len(perfect)))
    return perfect, law, k


@pytest.mark.parametrize('seed', range(3))
def test_a_cell_of_which_one_matrix_exceeds_a_batch_has_modes_and_velocities(seed, monkeypatch):
    """Then there are fewer wavevectors than parts: as of 257 particles in the plane, and here of fewer in smaller batches."""
    rng = np.random.default_rng([17, seed])
    cell = lattice(str(rng.choice(['honeycomb', 'kagome'])))
    cell.set_masses(rng.uniform(0.3, 2, len(cell)))
    cell.calc = MagneticRepulsion(cell, LAWS['yukawa'], foundation=1.0)
    q, pairs = rng.uniform(-0.5, 0.5, (int(rng.integers(1, 4)), 3)) * cell.pbc, Pairs(cell, LAWS['yukawa'], 10.0 * 1.01)
    root = np.sqrt(np.repeat(cell.get_masses(), 2))
    D = (pairs.bloch(cell.positions, q) + np.eye(len(root))) / (root * root[:, None])
    monkeypatch.setattr(bloch, 'BATCH_BYTES', D[0].nbytes // 3)
    monkeypatch.setattr(bloch, 'DIVIDE', int(rng.choice([1, 400])))
    omega, vectors = bloch_modes(cell, q, vectors=True)
    v = vectors.reshape(len(q), len(root), -1).swapaxes(1, 2)
    assert_allclose(D @ v, v * squared(omega)[:, None], atol=1e-12 * abs(D).max())  # Cauchy's formula: 1e-13
    step = 1e-4 * (cell.cell.array @ [1, 0, 0])  # along x, in 1/mm
    beside = [np.sqrt(np.linalg.eigvalsh((pairs.bloch(cell.positions, q + sign * step / (2 * np.pi)) + np.eye(len(root)))
                                         / (root * root[:, None]))) for sign in (1, -1)]
    slope = (beside[0] - beside[1]) / 2e-4
    assert_allclose(group_velocities(cell, q)[1][..., 0], slope, atol=1e-5 * abs(slope).max())  # of central differences: 1e-7
    assert bloch_modes(cell, q[:0], vectors=True)[1].shape == (0, len(root), len(cell), 2)


def squared(omega):
    return np.sign(omega) * omega**2


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(5))
def test_lowest_branches_of_cells_with_defects(seed):
    """Frequencies and modes; the control is the other model, and one wavevector for another."""
    atoms, law, k = drawn(seed)
    rng, dim = np.random.default_rng(seed), atoms.calc.dim
    free = np.repeat(~np.isin(np.arange(len(atoms)), [c.index for c in atoms.constraints]), dim)
    q = np.array([rng.uniform(-0.5, 0.5, 3), [0.5, 0, 0]]) * atoms.pbc
    count = int(rng.integers(2, free.sum() // 20 + 1))
    root, pairs = np.sqrt(np.repeat(atoms.get_masses(), dim)), Pairs(atoms, law, 12.0, images=1)
    exact = {}
    for pairs.model in MODELS:
        D = (pairs.bloch(atoms.positions, q) + k * np.eye(len(root))) / (root * root[:, None])
        D = D[:, free][:, :, free]
        exact[pairs.model] = np.linalg.eigvalsh(D)
        omega, vectors = bloch_modes(atoms, q, pairs.model, vectors=True, branches=count)
        top, v = abs(exact[pairs.model]).max(), vectors.reshape(2, count, -1)
        assert inverse_pays(free.sum(), count, real=False)
        assert_allclose(squared(omega), exact[pairs.model][:, :count], rtol=0, atol=1e-12 * top)  # Cauchy's formula: 1e-13
        assert not v[:, :, ~free].any()
        v = v[:, :, free]
        assert_allclose(D @ v.swapaxes(1, 2), v.swapaxes(1, 2) * squared(omega)[:, None], atol=1e-12 * top)
        assert_allclose(v.conj() @ v.swapaxes(1, 2), np.tile(np.eye(count), (2, 1, 1)), atol=1e-13)
    assert abs(exact['complete'] - exact['conventional'])[:, :count].max() > 1e-3 * top
    assert abs(exact['complete'][0] - exact['complete'][1])[:count].max() > 1e-9 * top


@pytest.mark.parametrize('count', few_first([1, 2, 4, 13], 2))
def test_twins_of_a_perfect_supercell_are_all_found(count):
    """Its branches are those of one cell, folded; at Gamma and at a border many are twins, also among the last ones."""
    side = 16
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, LAWS['magnets'], foundation=0.1)
    large = cell.repeat((side, side, 1))
    large.calc = cell.calc.on(large)
    q = np.array([[0.0, 0, 0], [0.5, 0, 0], [1 / 3, 1 / 3, 0], [0.01, 0, 0]])
    n = np.stack(np.meshgrid(*2 * [np.arange(side)], 0, indexing='ij'), axis=-1).reshape(-1, 3)
    folded = np.sort([bloch_modes(cell, (at + n) / side)[0].ravel() for at in q])
    assert_allclose(bloch_modes(large, q, branches=count)[0], folded[:, :count], rtol=1e-11)
    assert abs(bloch_modes(large, q[::-1], branches=count)[0] - folded[:, :count]).max() > 1e-4 * folded.max()


def losing(k, **options):
    """What Lanczos iterations may do: one of two twins is missed, and the next one is returned in its place."""
    values, vectors = EIGSH(k=k + 1, **options)
    order = np.delete(np.argsort(values), 2)
    return values[order], vectors[:, order]


def endless(**options):
    raise sparse.linalg.ArpackNoConvergence('no convergence', np.empty(0), np.empty((0, 0)))


EIGSH = sparse.linalg.eigsh


@pytest.mark.parametrize('failing', [losing, endless])
@pytest.mark.parametrize('complex_', [False, True])
def test_what_lanczos_iterations_miss_is_noticed(failing, complex_, monkeypatch):
    rng = np.random.default_rng(0)
    values = np.concatenate([[1.0, 2, 2, 2, 3], rng.uniform(4, 9, 855)])
    turn = sparse.kron(sparse.eye_array(430), np.array([[0.6, 0.8j], [0.8j, 0.6]] if complex_ else [[0.6, 0.8], [-0.8, 0.6]]))
    D = sparse.csr_array(turn.conj().T @ sparse.diags_array(values) @ turn)
    monkeypatch.setattr('scipy.sparse.linalg.eigsh', lambda D, **options: failing(A=D, **options))
    monkeypatch.setattr(lowest, '_factors_close_below', lambda D, highest: lowest.factors_below(D, 0.0, 0.1))
    assert_allclose(lowest_eigenpairs(D, 4)[0], [1, 2, 2, 2], rtol=1e-12)
    monkeypatch.setattr(lowest, '_none_missed', lambda *_: True)
    if failing is losing:
        assert_allclose(lowest_eigenpairs(D, 4)[0], [1, 2, 2, 3], rtol=1e-12)  # the control: nobody counts


@pytest.mark.slow
@pytest.mark.parametrize('complex_', [False, True])
def test_each_side_of_the_thresholds(complex_):
    """The smallest matrices that are inverted and the largest that are not; a few more branches than an inverse pays for."""
    most = lowest.INVERSE // (1 + complex_)
    for size in most, most + 1:
        rng = np.random.default_rng(size)
        off = rng.normal(size=size - 1) + (1j * rng.normal(size=size - 1) if complex_ else 0)
        D = sparse.csr_array(sparse.diags_array([rng.normal(size=size), off, off.conj()], offsets=[0, -1, 1]))
        exact = np.linalg.eigvalsh(D.toarray())
        for count in 1, size // lowest.FEW, size // lowest.FEW + 1:
            assert inverse_pays(size, count, real=not complex_) == (size > most and count <= size // lowest.FEW)
            first, vectors = lowest_eigenpairs(D, count)
            again, _ = lowest_eigenpairs(D, count, near=first + 0.3)  # which is above, as an estimate may be
            for values in first, again:
                assert_allclose(values, exact[:count], rtol=0, atol=1e-13 * size)
            assert_allclose(D @ vectors, vectors * first, atol=1e-11)
    empty = sparse.csr_array((2 * most, 2 * most))
    assert not lowest_eigenpairs(empty, 3)[0].any()


def test_small_cells_and_sums_over_all_neighbours_give_the_lowest_branches_of_all():
    cell = lattices.kagome(1.0, 1.0)
    q = np.random.default_rng(0).uniform(size=(5, 3)) * cell.pbc
    for calc in MagneticRepulsion(cell, InversePower(1.0, 4.0)), AllNeighbours(cell, InversePower(1.0, 4.0)):
        cell.calc = calc
        every, shapes = bloch_modes(cell, q, vectors=True)
        few, some = bloch_modes(cell, q, vectors=True, branches=4)
        np.testing.assert_array_equal(few, every[:, :4])
        np.testing.assert_array_equal(some, shapes[:, :4])


def test_lowest_modes_of_a_supercell_are_its_branches_at_gamma():
    atoms, *_ = drawn(0)
    assert_allclose(squared(modes(atoms, 12).omega), squared(bloch_modes(atoms, [[0, 0, 0]], branches=12)[0][0]), atol=1e-12)
