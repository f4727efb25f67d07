"""Buckling out of the plane: on both sides of the support that a layer needs."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed, verdict
from magphonon.interactions import Spring, UprightMagnets

LAW = InversePower(6000.0, 4.5824)


def vertical(atoms, law, q):
    """Stiffness along z without supports, by a sum over all images; shape (wavevectors, particles, particles)."""
    n, reach = len(atoms), 1.2 * 10.0
    D = np.zeros((len(q), n, n), complex)
    for shift in np.ndindex(7, 7):
        cell = np.array([*shift, 3]) - 3
        for i in range(n):
            for j in range(n):
                r = np.linalg.norm(atoms.positions[j] + cell @ atoms.cell.array - atoms.positions[i])
                if 0 < r < reach:
                    slope, curvature = -law.b * r**-law.a, law.a * law.b * r ** (-law.a - 1)
                    k = -(curvature + slope / r) if law.upright else slope / r
                    D[:, i, i] += k
                    D[:, i, j] -= k * np.exp(2j * np.pi * q @ cell)
    return D


class Law:
    b, a = LAW.b, LAW.a

    def __init__(self, upright):
        self.upright = upright
        self.law = UprightMagnets(LAW) if upright else LAW


@pytest.mark.slow
@pytest.mark.parametrize(('name', 'upright'), [('square', False), ('triangular', True), ('honeycomb', False), ('kagome', True)])
def test_the_verdict_turns_at_the_support_that_the_softest_wave_needs(name, upright):
    atoms, law = getattr(lattices, name)(10.0, 0.7), Law(upright)
    q = np.stack(np.meshgrid(*[np.arange(24) / 24] * 2, [0.0]), axis=-1).reshape(-1, 3)
    needed = -np.linalg.eigvalsh(vertical(atoms, law, q)).min()  # of these lattices at corners of the zone, which are on the mesh
    for factor, stable in ((1.001, True), (0.999, False)):
        atoms.calc = MagneticRepulsion(atoms, law.law, foundation=[[1.0, 1.0, factor * needed]])
        judged = verdict(atoms)
        assert judged['out_of_plane'].needed == pytest.approx(needed, rel=1e-9)
        assert judged.stable == judged['out_of_plane'].stable == stable
        assert ('buckles out of the plane' in str(judged)) != stable
    planar = MagneticRepulsion(atoms, law.law, foundation=1.0)
    atoms.calc = planar
    assert verdict(atoms)['out_of_plane'] is None


def test_below_the_threshold_a_layer_relaxes_to_a_zigzag_out_of_its_plane_and_above_it_does_not():
    """A row of grains between held ends: the zigzag of a trapped chain."""
    atoms = lattices.chain(10.0, 0.7).repeat((8, 1, 1))
    atoms.pbc = False
    atoms.set_constraint(FixAtoms([0, 7]))
    needed = 4 * -LAW.dphi(10.0) / 10.0 * np.sin(np.pi * 6 / 14) ** 2  # six free grains, fixed ends
    for factor, flat in ((1.02, True), (0.98, False)):
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=[[1.0, 1.0, factor * needed]])
        assert verdict(atoms).stable == flat
        settled = relaxed(atoms).atoms
        z = settled.positions[:, 2] - settled.positions[0, 2]
        assert (abs(z).max() < 1e-9) == flat
        if not flat:
            assert (z[1:6] * z[2:7] < 0).all()
            moved = settled.copy()
            moved.calc = atoms.calc
            assert moved.get_potential_energy() < 0


@pytest.mark.parametrize(('stiff', 'words'),
                         [(50.0, 'if all supports were softer by 1 N/m'), (1e-3, 'needs supports along z of 200')])
def test_what_needs_no_supports_is_told_of_supports_as_soft_as_the_softest(stiff, words):
    """One particle hangs in stretched springs, another stands between two that repel it."""
    layer = Atoms('H6', [[x, y, 0] for y in (0, 5) for x in (0, -1, 1)], masses=[1e-3] * 6, tags=[0, 0, 0, 1, 1, 1])
    layer.set_constraint(FixAtoms([1, 2, 4, 5]))
    supports = np.full((6, 3), [1.0, 1.0, 1e-3])
    supports[3, 2] = stiff
    laws = {(0, 0): Spring(1.0, 0.5), (1, 1): InversePower(0.1, 4.0), (0, 1): InversePower(0.1, 4.0)}
    layer.calc = MagneticRepulsion(layer, laws, foundation=supports, bonds=[(0, 1), (0, 2), (3, 4), (3, 5)], dim=3)
    assert words in str(verdict(layer))


@pytest.mark.parametrize('seed', range(6))
def test_a_layer_whose_gyration_is_oblique(seed):
    """A square lattice on supports: stable as all poles of its own u'' + B u' + K u, with B of any axis, over the zone."""
    rng = np.random.default_rng(seed)
    f, a, k, g = rng.uniform(0.5, 2), rng.uniform(2, 5), rng.uniform(1, 10, 3), rng.uniform(-3, 3, 3)
    cell = lattices.square(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(f, a), foundation=[k], gyration=[g])
    q = np.array(list(np.ndindex(24, 24))) / 24
    x, y = (2 - 2 * np.cos(2 * np.pi * q)).T
    K = f * np.stack([a * x - y, a * y - x, -x - y], axis=1) + k
    B = -np.cross(np.eye(3), g).T
    A = np.zeros((len(q), 6, 6))
    A[:, :3, 3:], A[:, 3:, 3:] = np.eye(3), -B
    A[:, np.arange(3, 6), np.arange(3)] = -K
    rate = np.linalg.eigvals(A).real.max()
    assert rate < 1e-6 or rate > 1e-2
    judged = verdict(cell)
    assert judged.stable == (rate < 1e-6)
    assert judged['buckling'].growth == pytest.approx(rate if rate > 1e-2 else 0.0, rel=1e-6)
