"""Defects and disorder: structures changed site by site against structures that were built so at once."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.interactions import UprightMagnets
from magphonon.stiffness.defects import (
    Scatter,
    scattered,
    site_normals,
    substituted,
    with_vacancies,
)
from tests.oracles import LAWS

LAW = LAWS['magnets']


FIRST = [0.3188911351482975, 1.265834339532767, 0.757703305852264, -2.557900920033579, 0.9200566366572172, 0.8311991366017707]
"""x, y, z of the first two sites of seed 7: raw bits of PCG64 through statistics.NormalDist.inv_cdf of Python, to 15 digits."""


def supercell(seed):
    """A periodic structure or a patch, drawn: masses, strengths, springs and load differ from site to site."""
    rng = np.random.default_rng(seed)
    cell = getattr(lattices, ('triangular', 'square', 'honeycomb')[seed % 3])(10.0, 0.7)
    atoms = cell.repeat((5, 4, 1)) if seed % 2 else lattices.parallelogram(cell, 5, 6)
    n = len(atoms)
    atoms.set_masses(rng.uniform(0.5, 1, n))
    atoms.calc = MagneticRepulsion(atoms, LAW, cutoff=12.0, foundation=rng.uniform(1, 2, (n, 2)),
                                   strengths=rng.uniform(0.8, 1.2, n),
                                   load=np.pad(0.01 * rng.normal(size=(n, 2)), ((0, 0), (0, 1))))
    return atoms, rng


def same(found, expected):
    """Equal but for round-off of sums in another order."""
    u = 0.1 * np.random.default_rng(1).normal(size=(len(found), 2))
    for atoms in found, expected:
        atoms.positions[:, :2] += u
    largest = abs(expected.get_forces()).max()
    assert_allclose(found.get_forces(), expected.get_forces(), rtol=0, atol=1e-12 * largest)
    H = expected.calc.get_hessian(expected).toarray()
    assert_allclose(found.calc.get_hessian(found).toarray(), H, rtol=0, atol=1e-12 * abs(H).max())
    assert np.array_equal(found.get_masses(), expected.get_masses())
    assert [c.todict() for c in found.constraints] == [c.todict() for c in expected.constraints]
    for atoms in found, expected:
        atoms.positions[:, :2] -= u


def built(atoms, calc, kept, **sites):
    """The structure of some of the particles, made at once with what the sites have."""
    bare = atoms[kept]
    bare.calc = None
    given = {name: getattr(calc, name)[kept] for name in ('foundation', 'strengths', 'anchors', 'load')}
    bare.calc = MagneticRepulsion(bare, calc.laws, cutoff=12.0, **given | sites)
    return bare


@pytest.mark.parametrize('seed', range(4))
def test_vacancies(seed):
    atoms, rng = supercell(seed)
    gone = rng.choice(len(atoms), 3, replace=False)
    kept = np.setdiff1d(np.arange(len(atoms)), gone)
    found = with_vacancies(atoms, gone)
    same(found, built(atoms, atoms.calc, kept))
    with pytest.raises(AssertionError):  # the control: another site is missing
        same(found, built(atoms, atoms.calc, np.setdiff1d(np.arange(len(atoms)), (gone + 1) % len(atoms))))


@pytest.mark.parametrize('seed', range(4))
def test_substitutions(seed):
    atoms, _ = supercell(seed)
    calc, k = atoms.calc, len(atoms) // 2
    found = substituted(atoms, k, mass=0.3, strength=0.6, stiffness=0.2)
    changed, factors = atoms.copy(), np.ones(len(atoms))
    masses = atoms.get_masses()
    masses[k] *= 0.3
    changed.set_masses(masses)
    factors[k] = 0.6
    springs = calc.foundation.copy()
    springs[k] *= 0.2
    same(found, built(changed, calc, np.arange(len(atoms)), strengths=calc.strengths * factors, foundation=springs))
    assert atoms.calc is calc  # what was given stays


@pytest.mark.parametrize('law', [LAW, UprightMagnets(LAW)])
def test_places_in_a_layer_scatter_in_its_plane(law):
    cell = lattices.triangular(10.0, 0.7).repeat((3, 3, 1))
    found = []
    for foundation in (1.0, [[1.0, 1.0, 4.0]]):
        cell.calc = MagneticRepulsion(cell, law, foundation=foundation)
        found.append(relaxed(scattered(cell, Scatter(0.2, stiffness=0.1), seed=3)).atoms)
    flat, layer = found
    assert_allclose(layer.positions, flat.positions, rtol=0, atol=1e-9)
    assert not np.ptp(layer.positions[:, 2])
    assert not np.allclose(flat.positions, cell.positions, rtol=0, atol=0.1)  # the control: they scatter
    assert_allclose(layer.calc.foundation[:, 2], 4 * flat.calc.foundation[:, 0])


def test_what_repels_nothing_is_refused():
    cell = lattices.chain(10.0, 0.7).repeat((3, 1, 1))
    cell.pbc = False
    cell.calc = MagneticRepulsion(cell, LAW, foundation=1.0)
    with pytest.raises(ValueError, match='no two of the 2 particles are bonded'):
        with_vacancies(cell, 1)
    with pytest.raises(ValueError, match='no force acts between'):
        relaxed(substituted(cell, 1, strength=0.0))
    relaxed(substituted(cell, 1, strength=1e-6))


def test_the_numbers_of_a_seed():
    """Pinned: they are those of every machine, and must stay those of every version."""
    assert_allclose(site_normals(7, 2)[:, :3].ravel(), FIRST, rtol=1e-12)
    many = site_normals(3, 30_000)
    assert abs(many.mean(axis=0)).max() < 5 / np.sqrt(30_000)  # five standard errors
    assert_allclose(np.cov(many.T), np.eye(6), atol=5 * np.sqrt(2 / 30_000))
    assert_allclose((abs(many) < 1).mean(), 0.682689, atol=5 * 0.47 / np.sqrt(180_000))
    assert not np.array_equal(site_normals(4, 10), site_normals(3, 10))


@pytest.mark.parametrize('seed', range(4))
def test_sites_scatter_each_by_itself(seed):
    atoms, _ = supercell(seed)
    calc = atoms.calc
    found = scattered(atoms, Scatter(0.2, 0.05, 0.03, 0.1), seed=11)
    z = site_normals(11, len(atoms))
    moved = np.pad(0.2 * z[:, :2], ((0, 0), (0, 1)))
    changed = atoms.copy()
    changed.positions += moved
    changed.set_masses(atoms.get_masses() * (1 + 0.03 * z[:, 4]))
    bare = changed.copy()
    bare.calc = MagneticRepulsion(changed, LAW, bonds=calc.bonds.at(changed), anchors=calc.anchors + moved, load=calc.load,
                                  strengths=calc.strengths * (1 + 0.05 * z[:, 3]),
                                  foundation=calc.foundation * (1 + 0.1 * z[:, 5:]))
    assert np.array_equal(scattered(atoms, Scatter(0.2, 0.05, 0.03, 0.1), seed=11).positions, found.positions)
    same(found, bare)
    # one quantity more or less leaves the others what they are
    alone = scattered(atoms, Scatter(strength=0.05), seed=11)
    assert np.array_equal(alone.calc.strengths, found.calc.strengths)
    assert np.array_equal(alone.positions, atoms.positions)
    assert not np.array_equal(scattered(atoms, Scatter(0.2), seed=12).positions, found.positions)


def test_how_far_disorder_moves_a_structure():
    """Linear response for small scatter: the particles move by the pushes over the stiffness."""
    cell = lattices.triangular(10.0, 0.7).repeat((6, 6, 1))
    cell.calc = MagneticRepulsion(cell, InversePower(6200.0, 4.5824), foundation=0.5)
    weak = scattered(cell, Scatter(strength=1e-5), seed=2)
    rest = relaxed(weak)
    push = weak.get_forces()[:, :2].ravel()
    u = np.linalg.solve(weak.calc.rest_hessian().toarray(), push).reshape(-1, 2)
    far = np.linalg.norm(u, axis=1)
    assert rest.shift == pytest.approx(far.max(), rel=1e-3)
    assert rest.rms == pytest.approx(np.sqrt((far**2).mean()), rel=1e-3)
    assert f'moved by up to {rest.shift:.4g} mm (rms {rest.rms:.4g} mm)' in str(rest)
