"""Products by a stencil, against the sparse matrix, and what the linear tools answer with either."""

import numpy as np
import pytest
from structures import structure

from magphonon import InversePower, MagneticRepulsion, ToneBurst, frequency_response, lattices, propagate
from magphonon.response import chebyshev, density_of_states
from magphonon.stiffness.rest import LinearSystem

stencil_of = pytest.importorskip('magphonon.response.stencil', exc_type=ImportError).stencil_of


def regular(seed):
    """A hexagon of equal magnets, whose bonds share their stiffness."""
    patch = lattices.hexagon(lattices.triangular(1.0, 0.7), 3.0 + seed // 20)
    model = 'complete' if seed % 40 else 'conventional'
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=0.5, model=model)
    return patch


@pytest.mark.filterwarnings('ignore:no particles interact across')
@pytest.mark.slow
def test_products_of_drawn_structures():
    rng, on_grids, each = np.random.default_rng(0), 0, 0
    for seed in range(200):
        atoms = structure(seed).atoms if seed % 20 else regular(seed)
        system = LinearSystem.about(atoms.calc, atoms)
        stencil = stencil_of(system) if system.directions else None
        if stencil is None or len(stencil.offsets) > 4:  # each number of groups is compiled by itself
            continue
        factor, shift = rng.uniform(0.1, 2), rng.uniform(-1, 1)
        x, y = rng.normal(size=(2, system.directions, 3))
        slots, into, scaled = stencil.enter(x), stencil.enter(y), stencil.scaled(factor, shift)
        count, rows = int(rng.choice([1, 2, 6])), rng.permutation(system.directions)[: rng.integers(1, 9)]
        taken = np.full((count, 3, len(rows)), np.nan)
        sums = scaled.advance(slots, into, count, rows, taken)
        source, target = x, y
        for n in range(count):
            np.testing.assert_allclose(taken[n], source[rows].T, atol=1e-12 * abs(source).max())
            source, target = factor * (system.K @ source - shift * source) - target, source
            largest = max(abs(source).max(), abs(target).max())
            expected = [(source**2).sum(axis=0), (source * target).sum(axis=0)]
            np.testing.assert_allclose(sums[:, n], expected, atol=1e-11 * largest**2 * len(x))
        last = into if count == 1 else slots
        assert np.count_nonzero(last) <= source.size  # nothing moves in slots of held particles, and in empty ones
        np.testing.assert_allclose(stencil.leave(last), source, atol=1e-12 * abs(source).max())
        row_sum = abs(system.K).sum(axis=1).max()
        assert stencil.row_sum >= (1 - 1e-12) * row_sum
        if not atoms.pbc.any():  # in small cells bonds of opposite sign join the same two
            assert stencil.row_sum == pytest.approx(row_sum, rel=1e-12)
        if chebyshev.none_negative(stencil, system.directions, 300):
            assert np.linalg.eigvalsh(system.K.toarray())[0] >= 0
        on_grids, each = on_grids + 1, each + (stencil.D.ndim == 3)
    assert min(each, on_grids - each) > 2


@pytest.mark.parametrize('scattered', [0.0, 0.2], ids=['alike', 'own strengths'])
@pytest.mark.parametrize('foundation', [1.0, 0.0], ids=['stable', 'unstable'])
def test_the_same_answers(monkeypatch, scattered, foundation):
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 12.0)
    del patch[200]
    strengths = 1 + scattered * np.random.default_rng(0).uniform(-1, 1, len(patch))
    exponent = 4.0 if foundation else 0.5  # which the rim alone does not hold
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, exponent), foundation=foundation, strengths=strengths)
    patch.calc = patch.calc.balanced(np.arange(len(patch)))
    force = np.zeros((len(patch), 3), complex)
    force[180, :2] = 1.0, 0.5j
    burst = ToneBurst(180, (0, 1), 1e-3, omega=2.0)

    def answers():
        dos = density_of_states(patch, moments=64, vectors=2)
        moved = propagate(patch, [3.0, 8.0], [burst], damping=0.1)
        found = [dos.omega, dos.density, moved.displacements, moved.velocities]
        if foundation:
            found.append(frequency_response(patch, force, [0.5, 2.0], 0.3, [100, 180]).response)
        return found

    by_matrix = answers()
    monkeypatch.setattr(chebyshev, 'LARGE', 0)
    assert type(chebyshev.products_of(LinearSystem.of(patch))) is not chebyshev.Matrix
    for one, other in zip(answers(), by_matrix, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-11 * abs(other).max())
