"""Modes and frequency responses: chains in closed form, direct solution, and where each way of computing them ends."""

from contextlib import suppress

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from motion import patch
from numpy.testing import assert_allclose
from scipy import sparse
from scipy.sparse.linalg import eigsh
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.response import chebyshev, frf, normal_modes
from magphonon.response.chebyshev import (
    BLOCK,
    Crowded,
    Interval,
    Outside,
    chebyshev_blocks,
    coefficients,
    lowest_by_products,
    sizes,
    stable_interval,
    whole_interval,
)
from magphonon.response.frf import frequency_response, harmonic_response
from magphonon.response.normal_modes import modes
from magphonon.response.propagation import free_motion, separated
from magphonon.stiffness import lowest
from magphonon.stiffness.rest import LinearSystem

SPRING, MASS = 3 * 5e3 * 10.0**-4, 2.0  # a b L^-(a+1) N/mm; g


def chain(count, foundation=0.0, model='complete'):
    """Free particles between two held ones."""
    atoms = lattices.chain(spacing=10.0, mass=MASS).repeat((count + 2, 1, 1))
    atoms.pbc = False
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=5e3, a=3.0), foundation=foundation, model=model)
    atoms.set_constraint(FixAtoms([0, count + 1]))
    return atoms


def pushed(atoms, particle, direction=(1, 0)):
    force = np.zeros((len(atoms), 3), complex)
    force[particle, :2] = direction
    return force


def test_chain_has_its_modes_and_buckles():
    count = 9
    found = modes(chain(count))
    k = np.arange(1, count + 1)
    wave = 4 * np.sin(np.pi * k / 2 / (count + 1)) ** 2
    along, across = np.sqrt(SPRING / MASS * wave), -np.sqrt(5e3 * 10.0**-4 / MASS * wave)  # f/L pushes sideways
    np.testing.assert_allclose(found.omega, np.sort(np.append(across, along)), rtol=1e-12)
    lowest = found.shapes[count]  # the first stable one, along the chain
    np.testing.assert_allclose(MASS * (lowest**2).sum(), 1, rtol=1e-12)
    expected = np.sin(np.pi * np.arange(count + 2) / (count + 1)) * np.sqrt(2 / (count + 1) / MASS)
    np.testing.assert_allclose(lowest[:, 0] * np.sign(lowest[1, 0]), expected, atol=1e-13)
    assert abs(lowest[:, 1]).max() < 1e-13


@pytest.mark.parametrize('foundation', [0.0, 2.0])
def test_the_lowest_modes_of_a_long_chain_without_diagonalising(foundation):
    count, wanted = 400, 8  # 800 degrees of freedom, over SMALL; without a foundation the lowest ones are unstable
    k = np.arange(1, count + 1)
    wave = 4 * np.sin(np.pi * k / 2 / (count + 1)) ** 2
    squares = np.concatenate([SPRING * wave, -5e3 * 10.0**-4 * wave]) + foundation
    squares = np.sort(squares)[:wanted] / MASS
    found = modes(chain(count, foundation), wanted)
    np.testing.assert_allclose(found.omega, np.sign(squares) * np.sqrt(abs(squares)), rtol=1e-9)
    overlap = MASS * np.einsum('apx,bpx->ab', found.shapes, found.shapes)
    np.testing.assert_allclose(overlap, np.eye(wanted), atol=1e-9)


def test_the_lowest_modes_are_the_lowest_of_many_that_are_nearly_zero():
    """Sideways nothing but the foundation resists in the conventional model: each particle moves alone, the heaviest slowest."""
    count, wanted, foundation = 200, 5, 3e-7 * SPRING
    atoms = chain(count, foundation, 'conventional')
    masses = np.random.default_rng(5).permutation(np.linspace(1, 3, count + 2)) * MASS
    atoms.set_masses(masses)
    expected = np.sqrt(foundation / np.sort(masses[1:-1])[::-1][:wanted])
    np.testing.assert_allclose(modes(atoms, wanted).omega, expected, rtol=1e-7)  # round-off of the highest square, 4e6 as large


def test_the_lowest_modes_of_a_large_patch_need_no_dense_matrix(monkeypatch):
    """They crowd far above zero, where a shift at zero, the control, does not separate them; SciPy's own inverse finds them."""
    monkeypatch.setattr(lowest, 'eigh', None)
    monkeypatch.setattr(lowest, 'LARGEST', 1000)
    monkeypatch.setattr(lowest, 'RESTARTS', 8)  # two suffice; the control needs more than 32
    patch = lattices.parallelogram(lattices.triangular(1.0, 1.0), 26, 26)
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=100.0)
    K = LinearSystem.of(patch).K
    assert K.shape[0] > lowest.LARGEST
    found = modes(patch, 6)
    squares = eigsh(K, 6, sigma=99.9, return_eigenvectors=False)
    assert_allclose(found.omega**2, np.sort(squares), rtol=1e-12)
    with pytest.raises(ValueError, match='too many for a complete diagonalisation'):
        lowest.lowest_eigenpairs(K, 6, near=np.zeros(1))


@pytest.mark.parametrize('seed', range(4))
def test_equal_frequencies_have_one_shape_on_every_processor(monkeypatch, seed):
    """Symmetric structures, solved by one that returns any basis of equal eigenvalues with any sign, as processors do."""
    rng = np.random.default_rng(seed)
    cell = (lattices.triangular, lattices.honeycomb, lattices.square, lattices.kagome)[seed](1.0, 1.0)
    atoms = lattices.hexagon(cell, 3.0) if seed % 2 else cell.repeat((4, 4, 1))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), cutoff=1.2, foundation=7.0)
    eigh, drawn = np.linalg.eigh, []

    def another(A):
        w, V = eigh(A)
        for group in np.split(np.arange(len(w)), np.flatnonzero(np.diff(w) > 1e-9) + 1):
            V[:, group] = V[:, group] @ np.linalg.qr(rng.normal(size=(len(group),) * 2))[0] * rng.choice([-1, 1], len(group))
        drawn.append(V)
        return w, V

    monkeypatch.setattr(np.linalg, 'eigh', another)
    first, second = modes(atoms), modes(atoms)
    assert_allclose(second.shapes, first.shapes, atol=1e-9)
    assert abs(drawn[1] - drawn[0]).max() > 0.1  # the control: as they come
    system = LinearSystem.of(atoms).moving()
    Y = first.shapes.reshape(len(first.omega), -1)
    Y = np.sqrt(np.repeat(atoms.get_masses(), 2)) * Y
    assert_allclose(Y @ Y.T, np.eye(len(Y)), atol=1e-12)
    y = Y @ system.free.toarray()
    assert_allclose(system.K @ y.T, y.T * first.omega**2, atol=1e-9)
    sets = np.split(Y, np.flatnonzero(np.diff(first.omega) > 1e-9) + 1)
    assert max(len(alike) for alike in sets) >= (1 if seed % 2 else 4)
    for alike in sets:  # of those the first moves at the first component, with a plus, the others do not
        moved = np.sqrt((alike**2).sum(axis=0))
        at = np.flatnonzero(moved > 0.37 * moved.max())[0]
        assert_allclose(alike[:, at], [moved[at], *np.zeros(len(alike) - 1)], atol=1e-12)


@pytest.mark.parametrize('heavier', [False, True])
@pytest.mark.parametrize(('shape', 'side', 'mirrors'), [(lattices.hexagon, 9, 2), (lattices.half_hexagon, 14, 1),
                                                        (lattices.hexagon, 5, 0)])  # small ones are not split
def test_modes_of_each_parity_are_those_of_the_whole(shape, side, mirrors, heavier):
    atoms = shape(lattices.triangular(1.0, 0.7), side)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=np.random.default_rng(side).uniform(1, 3))
    k = np.linalg.norm(atoms.positions - atoms.positions.mean(axis=0) - [2.1, 0.9, 0], axis=1).argmin()  # beside the middle
    atoms.set_masses(0.7 + 0.3 * heavier * (np.arange(len(atoms)) == k))
    system = LinearSystem.of(atoms)
    assert len(normal_modes._mirrors(system)) == mirrors * (not heavier)
    found, squares = modes(system), np.linalg.eigvalsh(system.K.toarray())
    assert_allclose(found.omega * abs(found.omega), squares, atol=1e-12 * squares[-1])
    y = np.sqrt(np.repeat(atoms.get_masses(), 2)) * found.shapes.reshape(len(squares), -1) @ system.free
    assert_allclose(y @ y.T, np.eye(len(y)), atol=1e-12)
    assert_allclose(system.K @ y.T, y.T * squares, atol=1e-11 * squares[-1])


@pytest.mark.filterwarnings('ignore:the stiffest bond has')
@pytest.mark.filterwarnings('ignore:a mass of')
def test_mirrors_are_of_all_sites_however_stiff_others_are_and_commute():
    """Beside a stiff pillar in the middle, two springs differ by 1e-4; of bodies without forces any two are exchanged."""
    for off, mirrors in ((0.0, 2), (1e-4, 1)):
        atoms = lattices.hexagon(lattices.triangular(1.0, 1.0), 9.0)
        at, springs = (atoms.positions - atoms.positions.mean(axis=0)).round(6), np.full((len(atoms), 2), 4.0)
        springs[~at[:, :2].any(axis=1)] = 1e8
        springs[(at[:, 0] == 4) & (at[:, 1] == 0)] *= 1 + off
        atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=springs)
        assert len(normal_modes._mirrors(LinearSystem.of(atoms))) == mirrors
    free = [[-0.19, 0.1, 0.0], [-0.04, -0.1, 0.0], [0.19, 0.05, 0.0]]
    atoms = lattices.square(1.0, 1.0).repeat((16, 16, 1))
    atoms.positions -= atoms.positions.mean(axis=0)
    atoms = atoms[abs(atoms.positions).max(axis=1) > 1]
    held = np.flatnonzero(abs(atoms.positions).max(axis=1) > 7), np.flatnonzero(abs(atoms.positions).max(axis=1) < 2)
    atoms = Atoms(positions=[*atoms.positions, *free], masses=np.ones(len(atoms) + 3), constraint=FixAtoms(np.concatenate(held)))
    strengths = np.append(np.ones(len(atoms) - 3), np.zeros(3))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=3.0, strengths=strengths, cutoff=1.2)
    squares, omega = np.linalg.eigvalsh(LinearSystem.of(atoms).K.toarray()), modes(atoms).omega
    assert_allclose(omega * abs(omega), squares, atol=1e-12 * squares[-1])


def test_modes_are_those_about_rest():
    atoms, moved = patch(), patch()
    moved.positions[24] += 0.3
    with pytest.raises(ValueError, match=r'not at rest.* N acts on particle 24 .* set the positions back .* 0\.424 mm away'):
        modes(moved)
    moved.positions[24] -= 0.3
    np.testing.assert_array_equal(modes(moved).omega, modes(atoms).omega)


GAMMA = 0.05


@pytest.mark.parametrize('count', few_first([20, 200], 1))
def test_an_unstable_structure_has_no_steady_state(count):
    atoms = chain(count)  # buckles sideways
    with pytest.raises(ValueError, match=r'is unstable and has no steady response: .* rate [0-9]+(\.[0-9]+)? 1/s'):
        frequency_response(atoms, pushed(atoms, 3, (1, 1)), [0.5], 0.05)
    stable = chain(count, model='conventional')
    assert frequency_response(stable, pushed(stable, 3, (1, 0)), [0.5], 0.05).response.any()


@pytest.mark.slow
def test_every_undamped_resonance_is_refused_where_others_are_soft():
    count = 20
    atoms = chain(count, model='conventional')  # nothing resists sideways: the lowest twenty squares are zero
    for k in range(1, count + 1):
        omega = np.sqrt(SPRING / MASS) * 2 * np.sin(np.pi * k / 2 / (count + 1))
        with pytest.raises(ValueError, match=r'undamped response .* is infinite'):
            frequency_response(atoms, pushed(atoms, 3), [omega], 0.0)
        assert np.isfinite(frequency_response(atoms, pushed(atoms, 3), [(1 + 1e-6) * omega], 0.0).response).all()


@pytest.mark.parametrize('tolerance', [1e-3, 1e-6, 1e-10])
def test_a_series_ends_where_its_tolerance_is_met(monkeypatch, tolerance):
    taken = []

    def counted(*args):
        for block in chebyshev_blocks(*args):
            taken.append(len(block))
            yield block

    monkeypatch.setattr(frf, 'chebyshev_blocks', counted)
    atoms, omega = patch(12), 0.7
    system, force = LinearSystem.of(atoms), pushed(atoms, 65)
    s = system.shapes.T @ force[:, :2].real.ravel()
    *_, products = frf.series_response(system, s, np.array([omega]), GAMMA, np.arange(len(atoms)), tolerance)
    assert products == sum(taken)
    # what n terms of 1/(z - x) leave: 2 |w|^n/(1 - |w|)/|z - w| with w + 1/w = 2 z, on every particle at most
    interval = stable_interval(system.K)
    z = (omega**2 - 1j * GAMMA * omega - interval.centre) / interval.radius
    w = min(np.roots([1, -2 * z, 1]), key=abs)
    largest = abs(harmonic_response(atoms, force, [omega], GAMMA).response).max()
    first = 2 / (1 - abs(w)) / abs(z - w) / interval.radius * np.linalg.norm(s) * sizes(system.shapes).max()
    needed = np.log(tolerance * largest / first) / np.log(abs(w))
    assert needed <= products < needed + BLOCK


def test_the_interval_holds_the_spectrum():
    for atoms in (patch(), patch(law=InversePower(b=6.0, a=1.5), model='complete'), chain(6), chain(30)):
        K = LinearSystem.of(atoms).K
        squares = np.linalg.eigvalsh(K.toarray())
        wide, whole = stable_interval(K), whole_interval(K)
        assert wide.lowest == 0
        assert wide.highest >= squares[-1]
        assert whole.lowest <= min(squares[0], 0)
        assert whole.lowest >= min(1.01 * squares[0], 0)


@pytest.mark.parametrize('seed', few_first(range(60), 4))
def test_products_find_the_lowest_of_drawn_patches(seed):
    """Hexagons have pairs of equal frequency; on soft springs some patches are unstable, on stiff ones no frequency is low."""
    rng = np.random.default_rng(seed)
    shape = [lattices.hexagon, lattices.rectangle][seed % 2]
    atoms = shape(lattices.triangular(1.0, 0.7), *rng.uniform(5, 7, 1 + seed % 2) * [1, 1.5][seed % 2])
    if seed % 3:
        atoms = atoms[rng.random(len(atoms)) > 0.1]
        atoms.set_masses(rng.uniform(0.5, 2, len(atoms)))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, 4.0), foundation=rng.uniform(0, 3) + 60 * (seed % 4 == 1))
    atoms.calc = atoms.calc.balanced(np.arange(len(atoms)))
    K, count = LinearSystem.of(atoms).K, int(rng.integers(1, 13))
    squares = np.linalg.eigvalsh(K.toarray())
    found, shapes = lowest_by_products(K, len(squares), count)
    assert_allclose(found, squares[:count], atol=1e-12 * squares[-1])
    assert_allclose(shapes.T @ shapes, np.eye(count), atol=1e-12)
    assert_allclose(K @ shapes, shapes * found, atol=1e-9 * squares[-1])


def test_products_do_not_find_what_is_crowded():
    for squares in (np.full(300, 2.0), np.append(np.linspace(1, 1 + 1e-9, 20), np.linspace(2, 3, 280))):
        with pytest.raises(Crowded):
            lowest_by_products(sparse.csr_array(sparse.diags_array(squares)), 300, 4)
    with pytest.raises(Crowded):  # they leave no room for those that may not grow
        lowest_by_products(sparse.csr_array(sparse.diags_array(np.linspace(1, 3, 300))), 300, 200)
    ends = chebyshev.Matrix(sparse.csr_array(sparse.eye_array(2))), 0.0, 5e-6, 1.0  # 1342 products, for a million magnets few
    with pytest.raises(Crowded):
        chebyshev._Filter(ends[0], 2e5, *ends[1:])
    assert chebyshev._Filter(ends[0], 2e6, *ends[1:]).degree > chebyshev.LONGEST


@pytest.mark.parametrize('seed', [40, 56, 3])
def test_products_leave_a_few_modes_far_below_the_others_to_factors_or_find_them(seed):
    rng = np.random.default_rng(seed)  # the first two overflow in what may not grow
    deep = -(10 ** rng.uniform(-1, 1.5, rng.integers(1, 5)))
    squares = np.sort(np.append(deep, np.linspace(1, 9, 400) + rng.uniform(-0.01, 0.01, 400)))
    count, K = int(rng.integers(1, 6)), sparse.csr_array(sparse.diags_array(squares))
    with suppress(Crowded):
        assert_allclose(lowest_by_products(K, len(squares), count)[0], squares[:count], atol=1e-9)


def test_modes_that_were_missed_grow_in_a_random_vector(monkeypatch):
    K, answers = LinearSystem.of(patch(12)).K, []

    def without_two(filtered, count, *args):
        values, vectors, left = answer = lowest_filtered(filtered, count, *args)
        answers.append(count)
        kept = ~np.isin(np.arange(count), [1, 3])
        return answer if count == chebyshev.ROUGH else (values[kept], vectors[:, kept], left[kept])

    lowest_filtered = chebyshev._lowest_filtered
    monkeypatch.setattr(chebyshev, '_lowest_filtered', without_two)
    assert_allclose(lowest_by_products(K, K.shape[0], 5)[0], np.linalg.eigvalsh(K.toarray())[:5], rtol=1e-11)
    assert answers[-1] > chebyshev.ROUGH
    monkeypatch.setattr(chebyshev, 'MISSED', 1)
    with pytest.raises(Crowded):
        lowest_by_products(K, K.shape[0], 5)


def test_chebyshev_vectors_give_any_function_and_notice_what_is_outside():
    K = LinearSystem.of(patch()).K
    squares, vectors = np.linalg.eigh(K.toarray())
    s = np.random.default_rng(0).normal(size=len(squares))
    interval = stable_interval(K)
    c = coefficients(np.exp(-3 * interval.nodes(48)))
    blocks = chebyshev_blocks(K, interval, s[:, None], slice(None))
    T = np.concatenate([next(blocks)[:, 0].copy() for _ in range(3)])
    np.testing.assert_allclose(c @ T, vectors @ (np.exp(-3 * squares) * (vectors.T @ s)), atol=1e-13)
    with pytest.raises(Outside):
        for _, _block in zip(range(20), chebyshev_blocks(K, Interval(0, 0.9 * squares[-1]), s[:, None], [0]), strict=False):
            pass


def test_free_motion_is_smooth_through_critical_damping():
    gamma, t = 0.8, np.array([[0.0], [1.0], [30.0]])
    w2 = gamma**2 / 4 + np.array([-1e-2, -1e-8, -1e-14, 0, 1e-14, 1e-8, 1e-2])
    c, s = free_motion(w2, gamma, t)
    W = np.sqrt(w2 - gamma**2 / 4 + 0j)
    W[abs(W) == 0] = 1e-20
    np.testing.assert_allclose(c, (np.exp(-gamma * t / 2) * np.cos(W * t)).real, rtol=1e-13)
    np.testing.assert_allclose(s, (np.exp(-gamma * t / 2) * np.sin(W * t) / W).real, rtol=1e-13, atol=1e-300)


def test_forces_fall_into_as_many_terms_as_there_are_time_courses():
    t = np.linspace(0, 10, 200)
    patterns = np.random.default_rng(0).normal(size=(3, 40))
    values = np.column_stack([np.sin(t), np.exp(-t), t**2]) @ patterns
    courses, found = separated(values)
    assert courses.shape == (200, 3)
    np.testing.assert_allclose(courses @ found, values, atol=1e-12 * abs(values).max())
    assert separated(np.zeros((5, 4)))[0].shape == (5, 0)
