"""Interactions that depend on the vector between two particles: a new one needs a class, and no change of the package."""

from dataclasses import dataclass

import numpy as np
import pytest
from oracles import gradient, neighbour_vectors, second_derivatives
from structures import few_first

from magphonon import (
    DrivenVerlet,
    InversePower,
    MagneticRepulsion,
    lattices,
    relaxed,
)
from magphonon.design import mode_scatter
from magphonon.dynamics import refusal
from magphonon.interactions import PairInteraction, UprightMagnets, Yukawa
from magphonon.stiffness import Scatter
from magphonon.stiffness.calculator import bond_virial, measure
from magphonon.stiffness.matrices import Central, interaction_of, stiffness_change

C = 2000.0  # mu0 m^2/(4 pi), mJ mm^3
UPRIGHT = InversePower(3 * C, 4.0)  # the same dipoles, upright, in their plane


@dataclass(frozen=True)
class TiltedDipoles:
    """Dipoles that all point along one direction: U = C (1 - 3 (t.n)^2)/r^3 of the components that move."""

    tilt: float  # from the normal of the plane, towards x, rad

    @property
    def direction(self):
        return np.array([np.sin(self.tilt), 0.0, np.cos(self.tilt)])

    def energy(self, R):
        """Of complex vectors, shape (..., 2 or 3)."""
        r2, along = (R * R).sum(axis=-1), R @ self.direction[: R.shape[-1]]
        return C * (r2**-1.5 - 3 * along**2 * r2**-2.5)

    def forces(self, R):
        t = self.direction[: R.shape[1]]
        r2, along = (R * R).sum(axis=1)[:, None], (R @ t)[:, None]
        return self.energy(R), C * (-3 * R * r2**-2.5 - 6 * along * t * r2**-2.5 + 15 * along**2 * R * r2**-3.5)

    def stiffness(self, R):
        t, one = self.direction[: R.shape[1]], np.eye(R.shape[1])
        r2, along = (R * R).sum(axis=1)[:, None, None], (R @ t)[:, None, None]
        RR, tR = R[:, :, None] * R[:, None, :], t[:, None] * R[:, None, :]
        H = C * ((15 * along**2 * r2**-3.5 - 3 * r2**-2.5) * one - 6 * r2**-2.5 * np.outer(t, t)
                 + 30 * along * (tR + tR.swapaxes(1, 2)) * r2**-3.5 + (15 * r2**-3.5 - 105 * along**2 * r2**-4.5) * RR)
        D0 = np.einsum('bxy,bxy->b', H, RR / r2)[:, None, None] * RR / r2
        return D0, H - D0

    def central(self, dim):
        return None


class Energy:
    """Of drawn particles, by brute-force neighbours, analytic in their displacements."""

    def __init__(self, atoms, laws, reach, strengths, springs):
        self.pairs = [(i, j, v, laws[frozenset((atoms.get_tags()[i], atoms.get_tags()[j]))], strengths[i] * strengths[j])
                      for i, j, _, v in neighbour_vectors(atoms, reach)]  # each bond twice, from both ends
        self.springs, self.dim = springs, springs.shape[1]

    def __call__(self, u):
        u = u.reshape(*u.shape[:-1], *self.springs.shape)
        total = (self.springs * u**2).sum(axis=(-2, -1)) / 2
        for i, j, v, law, strength in self.pairs:
            total = total + strength * self.of(law, v[: self.dim] + u[..., j, :] - u[..., i, :]) / 2
        return total

    @staticmethod
    def of(law, R):
        if isinstance(law, TiltedDipoles):
            return law.energy(R)
        flat, planar = np.sqrt(R[..., 0] ** 2 + R[..., 1] ** 2), law
        if isinstance(law, UprightMagnets):
            planar, z = law.planar, (R[..., 2] if R.shape[-1] == 3 else 0.0)
            return planar.phi(flat) - (planar.d2phi(flat) + planar.dphi(flat) / flat) * z**2 / 2
        return planar.phi(np.sqrt((R * R).sum(axis=-1)))


def drawn(seed):
    """Two kinds in a jittered lattice, in the plane or as a layer: tilted dipoles, and what they do to others."""
    rng = np.random.default_rng(seed)
    cell = getattr(lattices, rng.choice(['square', 'triangular', 'honeycomb', 'kagome']))(10.0, 0.7)
    atoms = cell.repeat((2, 1, 1))
    atoms.positions[:, :2] += rng.uniform(-0.4, 0.4, (len(atoms), 2))
    atoms.set_tags([0, *rng.integers(0, 2, len(atoms) - 1)])
    dim = int(rng.integers(2, 4))
    springs, strengths = rng.uniform(0.5, 1.5, (len(atoms), dim)), rng.uniform(0.7, 1.3, len(atoms))
    laws = {(0, 0): TiltedDipoles(rng.uniform(0, 1)), (0, 1): Yukawa(20.0, 0.3), (1, 1): UprightMagnets(UPRIGHT)}
    atoms.calc = MagneticRepulsion(atoms, laws, foundation=springs, strengths=strengths, cutoff=12.345)
    oracle = Energy(atoms, {frozenset(pair): law for pair, law in laws.items()}, 12.345, strengths, springs)
    return atoms, oracle, dim, rng


@pytest.mark.parametrize('seed', few_first(range(12), 4))
def test_forces_and_hessian_are_derivatives_of_the_energy(seed):
    atoms, energy, dim, rng = drawn(seed)
    u = rng.uniform(-0.3, 0.3, (len(atoms), dim))
    moved = atoms.copy()
    moved.calc = atoms.calc
    moved.positions[:, :dim] += u
    forces, H = -gradient(energy, u.ravel()).reshape(-1, dim), second_derivatives(energy, u.ravel())
    assert moved.get_potential_energy() == pytest.approx(energy(u.ravel()) - energy(0 * u.ravel()), rel=1e-11)
    assert abs(moved.get_forces()[:, :dim] - forces).max() < 1e-12 * abs(forces).max()
    own = np.flatnonzero(np.tile(np.arange(3) < dim, len(atoms)))
    found = moved.calc.get_hessian(moved).toarray()[np.ix_(own, own)]
    assert abs(found - H).max() < 1e-11 * abs(H).max()
    # the control: all of them as forces along the line between two particles
    same = {'foundation': atoms.calc.foundation, 'strengths': atoms.calc.strengths, 'cutoff': 12.345}
    moved.calc = MagneticRepulsion(atoms, UPRIGHT, **same)
    assert abs(moved.get_forces()[:, :dim] - forces).max() > 1e-2 * abs(forces).max()


def test_what_is_no_interaction_is_a_force_along_the_bond():
    assert not isinstance(UPRIGHT, PairInteraction)
    assert isinstance(interaction_of(UPRIGHT, 3), Central)
    assert interaction_of(UprightMagnets(UPRIGHT), 2).central(2) is UPRIGHT
    assert isinstance(TiltedDipoles(0.1), PairInteraction)


@pytest.mark.parametrize('law', [UPRIGHT, UprightMagnets(UPRIGHT), TiltedDipoles(0.4)])
def test_the_change_of_the_stiffness_is_its_derivative(law):
    rng = np.random.default_rng(3)
    R, change = rng.uniform(8, 12, (9, 3)) * [1, 1, 0], rng.uniform(-1, 1, (9, 3))
    step = 1e-4
    ends = [sum(interaction_of(law, 3).stiffness(R + sign * step * change)) for sign in (1, -1)]
    expected = (ends[0] - ends[1]) / (2 * step)
    assert abs(stiffness_change(R, change, law) - expected).max() < 1e-7 * abs(expected).max()


@pytest.mark.parametrize('law', [UprightMagnets(UPRIGHT), TiltedDipoles(0.4)])
def test_tools_that_were_for_central_forces_answer_for_any(law):
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, law, foundation=[[1.0, 1.0, 3.0]])
    energies = []
    for strain in (1e-4, -1e-4):
        stretched = lattices.triangular(10.0, 0.7)
        stretched.calc = MagneticRepulsion(cell, law)
        stretched.set_cell(stretched.cell * [1 + strain, 1, 1], scale_atoms=True)
        energies.append(stretched.get_potential_energy())
    stress = (energies[0] - energies[1]) / 2e-4 / np.linalg.det(cell.cell[:2, :2])
    assert bond_virial(cell.calc)[0, 0] / measure(cell) == pytest.approx(stress, rel=1e-6)
    supercell = cell.repeat((3, 3, 1))
    supercell.calc = cell.calc.on(supercell)
    _, std = mode_scatter(supercell, Scatter(strength=0.01))
    assert np.isfinite(std).all()


def test_they_relax_and_move_in_ases_loop():
    cell = lattices.triangular(10.0, 0.7)
    patch = cell.repeat((4, 4, 1))
    patch.calc = MagneticRepulsion(patch, TiltedDipoles(0.4), foundation=1.0)
    del patch[5]
    patch.calc = MagneticRepulsion(patch, TiltedDipoles(0.4), foundation=1.0, cutoff=12.0)
    rest = relaxed(patch).atoms
    assert abs(rest.get_forces()).max() < 1e-9 < abs(patch.get_forces()).max()
    assert 'not along the bonds' in refusal(rest)
    rest.positions[7, 0] += 0.1
    start = rest.get_potential_energy()
    DrivenVerlet(rest, 0.01).run(200)
    kinetic = rest.get_kinetic_energy()
    assert kinetic > 0.1 * start
    assert rest.get_potential_energy() + kinetic == pytest.approx(start, rel=1e-4)


def test_kinds_that_leave_the_plane_otherwise_may_be_mixed():
    atoms = lattices.honeycomb(10.0, 0.7)
    atoms.set_tags([0, 1])
    atoms.calc = MagneticRepulsion(atoms, {(0, 1): UprightMagnets(UPRIGHT)}, foundation=[[1, 1, 1]])
    D = atoms.calc.bloch_matrix(np.zeros((1, 3)))[0]
    assert D[2, 5].real == pytest.approx(3 * 3 * -UPRIGHT.dphi(10.0) / 10.0, rel=1e-12)  # of three bonds, (a - 1) f/r each
