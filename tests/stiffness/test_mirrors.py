"""Structures that are their own mirror image, in parts: against dense algebra of the whole matrix."""

import numpy as np
import pytest
from ase.constraints import FixedLine
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, lattices
from magphonon.stiffness import LinearSystem, mirrors
from magphonon.stiffness.mirrors import eigenpairs_of, eigenvalues_of, symmetric_parts

SHAPES = {'hexagon': (lambda rng: lattices.hexagon(lattices.triangular(1.0, 1.0), rng.uniform(2.5, 4.5)), 4),
          'half hexagon': (lambda rng: lattices.half_hexagon(lattices.triangular(1.0, 1.0), rng.integers(3, 7)), 2),
          'square': (lambda rng: lattices.parallelogram(lattices.square(1.0, 1.0), *rng.integers(4, 8, 2)), 4),
          'parallelogram': (lambda rng: lattices.parallelogram(lattices.triangular(1.0, 1.0), 5, 4), 1)}


def drawn(shape, seed, spoilt=False):
    """A patch, with masses and springs that depend on the distances from the middle, and how many parts it should have."""
    rng = np.random.default_rng(seed)
    cut, parts = SHAPES[shape]
    patch = cut(rng)
    x, y = abs(patch.positions[:, :2] - (patch.positions.min(axis=0) + patch.positions.max(axis=0))[:2] / 2).round(6).T
    patch.set_masses(1 + 0.1 * np.cos(3 * x) * np.cos(2 * y))
    springs = 5 + np.sin(x) * y
    if spoilt:
        springs[rng.choice(np.flatnonzero(patch.get_tags() == 0))] *= 1.001
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, rng.uniform(2, 5)), foundation=springs)
    patch.calc = patch.calc.balanced(range(len(patch)))
    return patch, parts


@pytest.fixture(autouse=True)
def small(monkeypatch):
    monkeypatch.setattr(mirrors, 'SMALLEST', 1)


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('shape', SHAPES)
def test_parts_have_the_modes_of_the_whole(shape, seed):
    patch, parts = drawn(shape, seed)
    system = LinearSystem.of(patch)
    K = system.K.toarray()
    found = symmetric_parts(system)
    assert len(found) == parts
    assert sum(B.shape[1] for B in found) == len(K)
    squares, vectors = eigenpairs_of(system)
    assert_allclose(squares, np.linalg.eigvalsh(K), atol=1e-13 * abs(K).max())
    assert_allclose(eigenvalues_of(system), squares, atol=1e-13 * abs(K).max())
    assert_allclose(K @ vectors, vectors * squares, atol=1e-13 * abs(K).max())
    assert_allclose(vectors.T @ vectors, np.eye(len(K)), atol=1e-13)


@pytest.mark.parametrize('shape', ['hexagon', 'half hexagon', 'square'])
def test_one_spring_that_differs_leaves_no_mirror_image(shape, monkeypatch):
    """Control: were the matrix not asked, the parts would give other frequencies."""
    system = LinearSystem.of(drawn(shape, 3, spoilt=True)[0])
    assert len(symmetric_parts(system)) < SHAPES[shape][1]
    exact = np.linalg.eigvalsh(system.K.toarray())
    assert_allclose(eigenvalues_of(system), exact, atol=1e-13 * exact[-1])
    monkeypatch.setattr(mirrors, 'UNCHANGED', np.inf)
    assert abs(eigenvalues_of(system) - exact).max() > 1e-8 * exact[-1]


@pytest.mark.parametrize(('along', 'parts'), [((1, 0, 0), 4), ((3, 4, 0), 1)])
def test_guides_along_a_slope_have_no_mirror_image(along, parts):
    patch, _ = drawn('square', 5)
    patch.set_constraint([*patch.constraints, FixedLine(np.flatnonzero(patch.get_tags() == 0), along)])
    system = LinearSystem.of(patch)
    assert len(symmetric_parts(system)) == parts
    assert_allclose(eigenvalues_of(system), np.linalg.eigvalsh(system.K.toarray()), atol=1e-13 * abs(system.K).max())
