"""Neighbours that are left out: against a plain sum over very many, written here, for drawn lattices and laws."""

import numpy as np
import pytest
from ase import Atoms
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices, read_scene
from magphonon.bands import converged_shells, neighbour_shifts
from magphonon.bands.neighbours import whole_reach
from magphonon.interactions import Overlap, Tabulated, UprightMagnets, Yukawa
from magphonon.lattices.bonds import bonds_within

FAR = {1: 4000, 2: 80, 3: 18}  # cells to every side of the plain sum, by the number of periods
CELLS = ('chain', 'square', 'triangular', 'honeycomb', 'kagome', 'rectangular', 'fcc')


def drawn_cell(rng, kind):
    """A cell of 10 mm or so with drawn masses."""
    if kind == 'rectangular':
        return Atoms('Nd', cell=[[10.0, 0, 0], [0, 10 * rng.uniform(1.1, 1.6), 0], [0, 0, 40]], pbc=(True, True, False),
                     masses=[rng.uniform(0.3, 2)])
    cell = getattr(lattices, kind)(10.0, 1.0)
    cell.set_masses(rng.uniform(0.3, 2, len(cell)))
    return cell


def drawn_law(rng, periods):
    """A law of some kind, and its first and second derivatives as functions written here."""
    a, l, b = rng.uniform(periods**2 / 2 + 1.5, 7), rng.uniform(8, 60 / periods), rng.uniform(0.1, 3)
    power = lambda r: (-b * (r / 10) ** -a, a * b / r * (r / 10) ** -a)  # noqa: E731

    def screened(r):
        phi = b * 10 * np.exp(-(r - 10) / l) / r
        return -phi * (1 / l + 1 / r), phi * (1 / l**2 + 2 / l / r + 2 / r**2)

    return ((InversePower(b * 10**a, a), power) if rng.random() < 0.6 else
            (Yukawa(b * 10 * np.exp(10 / l), 1 / l), screened))


def plain_sum(cell, derivatives, k, q, reach=np.inf, g=0.0):
    """Frequencies from a double loop over cells and particles, without anything of the package; to a distance `reach` in mm.

    Particles of a plane that gyrate at g rad/ms: the upper half of the roots of the companion matrix.
    """
    periods = int(cell.pbc.sum())
    dim, n, far = (3 if periods == 3 else 2), len(cell), FAR[periods]
    grid = np.stack(np.meshgrid(*[np.arange(-far, far + 1)] * periods, indexing='ij'), -1).reshape(-1, periods)
    T = grid @ cell.cell.array[:periods]
    D = np.zeros((len(q), n, dim, n, dim), complex)
    for i in range(n):
        D[:, i, :, i, :] += k * np.eye(dim)
        for j in range(n):
            R = (T + cell.positions[j] - cell.positions[i])[:, :dim]
            r = np.linalg.norm(R, axis=1)
            near = (r > 1e-9) & (r < min(reach * (1 + 1e-9), 0.9 * far * 10))
            R, r, shift = R[near], r[near], grid[near]
            slope, curvature = derivatives(r)
            nn = R[:, :, None] * R[:, None, :] / r[:, None, None] ** 2
            K = curvature[:, None, None] * nn + (slope / r)[:, None, None] * (np.eye(dim) - nn)
            D[:, i, :, i, :] += K.sum(axis=0)
            D[:, i, :, j, :] -= np.einsum('bq,bxy->qxy', np.exp(2j * np.pi * shift @ q[:, :periods].T), K)
    root = np.repeat(1 / np.sqrt(cell.get_masses()), dim)
    K = D.reshape(len(q), n * dim, n * dim) * root * root[:, None]
    if g:
        turn, one = np.kron(np.eye(n), g * np.array([[0, 1], [-1, 0]])), np.eye(2 * n)
        roots = [np.linalg.eigvals(np.block([[0 * one, one], [-each, turn]])).imag for each in K]
        return np.sort(roots, axis=1)[:, -2 * n :]
    squares = np.linalg.eigvalsh(K)
    return np.sign(squares) * np.sqrt(abs(squares))


def largest_error(omega, exact):
    """Of a frequency by its square, relative to that of a tenth of the highest frequency if it is lower."""
    squares = exact * abs(exact)
    return (abs(omega * abs(omega) - squares) / np.maximum(abs(squares), squares.max() / 100)).max() / 2


@pytest.mark.parametrize('seed', few_first(range(3), 1))
@pytest.mark.parametrize('kind', CELLS)
def test_what_all_neighbours_shift(kind, seed):
    rng = np.random.default_rng([CELLS.index(kind), seed])
    cell = drawn_cell(rng, kind)
    periods = int(cell.pbc.sum())
    law, derivatives = drawn_law(rng, periods)
    k = rng.uniform(0.5, 2) * law.d2phi(10.0)
    cell.calc = MagneticRepulsion(cell, law, foundation=k, shells=1)
    q = np.pad(rng.uniform(-0.5, 0.5, (2, periods)), ((0, 0), (0, 3 - periods)))
    found = neighbour_shifts(cell, q)
    exact, nearest = plain_sum(cell, derivatives, k, q), plain_sum(cell, derivatives, k, q, cell.calc.bonds.lengths.max())
    np.testing.assert_allclose(found.omega, nearest, rtol=1e-9)
    np.testing.assert_allclose(found.every, exact, rtol=2e-4)  # the plain sum leaves out up to 1e-4 of the stiffness
    assert abs(found.every / nearest - 1).max() > 5 * abs(found.every / exact - 1).max()  # the control: one shell
    assert found.known


@pytest.mark.parametrize('seed', few_first(range(3), 1))
@pytest.mark.parametrize('kind', ['chain', 'square', 'triangular', 'honeycomb', 'rectangular'])
def test_enough_on_each_side_of_the_tolerance(kind, seed):
    """So many shells are within the tolerance of the plain sum, and one less is not, unless with fewer it is so by accident."""
    rng = np.random.default_rng([seed, 7])
    cell = drawn_cell(rng, kind)
    law, derivatives = drawn_law(rng, int(cell.pbc.sum()))
    k, tolerance = rng.uniform(0.5, 2) * law.d2phi(10.0), 10 ** rng.uniform(-2.8, -1.5)
    cell.calc = MagneticRepulsion(cell, law, foundation=k)
    q = np.pad(rng.uniform(-0.5, 0.5, (3, int(cell.pbc.sum()))), ((0, 0), (0, 3 - int(cell.pbc.sum()))))
    found = converged_shells(cell, q, tolerance)
    exact = plain_sum(cell, derivatives, k, q)
    error = largest_error(plain_sum(cell, derivatives, k, q, found.cutoff), exact)
    assert error == pytest.approx(found.error, abs=2e-4)
    assert error <= tolerance + 2e-4
    if found.shells > 1:
        one_less = bonds_within(cell, found.cutoff).lengths.max() * (1 - 1e-6)
        assert largest_error(plain_sum(cell, derivatives, k, q, one_less), exact) > tolerance - 2e-4


@pytest.mark.parametrize('kind', ['triangular', 'honeycomb'])
def test_particles_that_gyrate(kind):
    """What all neighbours shift, and how many shells are enough, of the frequencies with gyration; those without are others."""
    cell, law, k, g = getattr(lattices, kind)(10.0, 0.7), InversePower(1e4, 4.0), 0.5, 3.0
    derivatives = lambda r: (law.dphi(r), law.d2phi(r))  # noqa: E731
    q = np.array([[0.5, 0, 0], [0.31, 0.12, 0]])
    cell.calc = MagneticRepulsion(cell, law, foundation=k, gyration=g)
    found, exact = neighbour_shifts(cell, q), plain_sum(cell, derivatives, k, q, g=g)
    np.testing.assert_allclose(found.omega, plain_sum(cell, derivatives, k, q, cell.calc.bonds.lengths.max(), g), rtol=1e-9)
    np.testing.assert_allclose(found.every, exact, rtol=2e-4)
    enough = converged_shells(cell, q, 0.05)
    error = {turns: largest_error(plain_sum(cell, derivatives, k, q, enough.cutoff, turns),
                                  plain_sum(cell, derivatives, k, q, g=turns)) for turns in (0.0, g)}
    assert enough.error == pytest.approx(error[g], abs=2e-4)
    assert abs(error[0.0] - error[g]) > 1e-3  # the control
    assert enough.error <= 0.05


def test_a_table_goes_on_from_its_end():
    cell, a = lattices.triangular(10.0, 0.7), 4.3
    q = np.array([[0.5, 0, 0], [1 / 3, 1 / 3, 0]])
    power = InversePower(10**a, a)
    cell.calc = MagneticRepulsion(cell, power, foundation=0.5)
    whole, needed = neighbour_shifts(cell, q), converged_shells(cell, q, 1e-3)
    for end in (13.0, 17.4, 39.0):  # before the second neighbours, just behind them, and behind the seventh
        r = np.geomspace(8, end, 12)
        cell.calc = MagneticRepulsion(cell, Tabulated(r, -power.dphi(r)), foundation=0.5)
        found = neighbour_shifts(cell, q)
        np.testing.assert_allclose(found.every, whole.every, rtol=1e-9)
        assert not found.known
        assert converged_shells(cell, q, 1e-3).shells == needed.shells
    assert whole.known


def test_forces_of_short_range_need_no_more():
    cell = lattices.triangular(19.9, 30.0)
    cell.calc = MagneticRepulsion(cell, Overlap(1e5 * 20**2.5, 2.5, 20.0), foundation=1.0)
    found = neighbour_shifts(cell, [[0.5, 0, 0]])
    np.testing.assert_allclose(found.every, found.omega, rtol=1e-12)
    assert converged_shells(cell, [[0.5, 0, 0]], 1e-9).shells == 1


def test_waves_in_the_plane_of_a_layer_and_of_differing_particles():
    """Strengths multiply; of two kinds without a common law the neighbours are summed to the end, as in a plain sum to there."""
    rng = np.random.default_rng(3)
    cell, law = lattices.honeycomb(10.0, 1.0), InversePower(1e4, 4.4)
    q = rng.uniform(-0.5, 0.5, (3, 3)) * [1, 1, 0]
    flat = MagneticRepulsion(cell, law, foundation=0.3)
    cell.calc = flat
    expected = neighbour_shifts(cell, q).every
    cell.calc = MagneticRepulsion(cell, UprightMagnets(law), foundation=[[0.3, 0.3, 3.0]])
    np.testing.assert_allclose(neighbour_shifts(cell, q).every, expected, rtol=1e-12)
    cell.calc = MagneticRepulsion(cell, InversePower(2e4, 4.4), foundation=0.3, strengths=[0.5**0.5, 0.5**0.5])
    np.testing.assert_allclose(neighbour_shifts(cell, q).every, expected, rtol=1e-12)
    cell.set_tags([0, 1])
    cell.calc = MagneticRepulsion(cell, dict.fromkeys([(0, 0), (0, 1), (1, 1)], law), foundation=0.3)
    found = neighbour_shifts(cell, q).every
    np.testing.assert_allclose(found, expected, rtol=1e-4)
    assert abs(neighbour_shifts(cell, q).omega / expected - 1).max() > 0.02  # the control


def test_the_papers_prototype():
    """58.2327 Hz becomes 67.45254 and 149.5 becomes 150.54738, by a sum of its own to 240 spacings."""
    found = neighbour_shifts(read_scene('prototype').atoms(), [[0.5, 0, 0]])
    np.testing.assert_allclose(found.every[0] / (2 * np.pi) * 1e3, [67.45254, 150.54738], rtol=1e-7)
    assert found.relative[0, 0] == pytest.approx(67.45254 / 58.2327 - 1, abs=1e-5)


@pytest.mark.filterwarnings('ignore:between the readings at')  # a table with a gap: its reach is asked, not its forces
def test_all_pairs_of_a_finite_structure():
    rng = np.random.default_rng(0)
    some = Atoms('Nd20', positions=np.column_stack([rng.uniform(0, 100, (20, 2)), np.zeros(20)]))
    farthest = max(some.get_all_distances().ravel())
    assert whole_reach(some, InversePower(1.0, 4.0)) > farthest
    table = Tabulated([0.01, 10.0, 30.0, 60.0], [10.0, 1.0, 0.1, 0.01])
    assert whole_reach(some, table) > farthest  # it goes on from its end
