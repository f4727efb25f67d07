"""Stress and moduli against the energy under any small change of shape, on drawn lattices; against sound and closed forms."""

import numpy as np
import pytest
from ase import Atoms
from oracles import gradient, length, neighbour_vectors, second_derivatives

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.bands import sound_speeds
from magphonon.interactions import Yukawa
from magphonon.stiffness import elastic_moduli

SCALE = 10.0  # mm: a displacement gradient of one counts as this displacement in the oracle's steps
BASES = {  # cell and fractions of lattices
    'honeycomb': ([[3**0.5, 0], [3**0.5 / 2, 1.5]], [[0, 0], [1 / 3, 1 / 3]]),
    'kagome': ([[2, 0], [1, 3**0.5]], [[0, 0], [0.5, 0], [0, 0.5]]),
    'triangular': ([[1, 0], [0.5, 3**0.5 / 2]], [[0, 0]]),
    'diamond': (np.array([[0, 2, 2], [2, 0, 2], [2, 2, 0]]) / 3**0.5, [[0, 0, 0], [0.25, 0.25, 0.25]]),
    'fcc': (np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]]) / 2**0.5, [[0, 0, 0]]),
}
FOLLOWING = ('honeycomb', 'diamond')  # in the others every particle is a centre of inversion


def drawn(name, seed):
    """A relaxed, obliquely strained cell of drawn masses and strengths with a drawn law of several shells, and its energy."""
    rng = np.random.default_rng(seed)
    plane, fractions = (np.array(x) for x in BASES[name])
    dim, n = len(plane), len(fractions)
    cell, positions = 20.0 * np.eye(3), np.full((n, 3), 3.0)
    cell[:dim, :dim] = 10 * plane @ (np.eye(dim) + rng.uniform(-0.08, 0.08, (dim, dim)))
    positions[:, :dim] = fractions @ cell[:dim, :dim]
    atoms = Atoms(['Nd'] * n, positions=positions, cell=cell, pbc=[1, 1, dim == 3], masses=rng.uniform(0.5, 1.5, n))
    law = InversePower(b=4000.0, a=rng.uniform(4, 8)) if rng.random() < 0.5 else Yukawa(c=20.0, kappa=rng.uniform(0.3, 0.6))
    reach = rng.uniform(20, 24)
    strengths = rng.uniform(0.8, 1.2, n)
    atoms.calc = MagneticRepulsion(atoms, law, cutoff=reach, strengths=strengths)
    pairs = [(i, j, v[:dim]) for i, j, _, v in neighbour_vectors(atoms, reach)]
    rest = relaxed(atoms).atoms
    return rest, Deformed(pairs, law, strengths, (rest.positions - atoms.positions)[:, :dim])


class Deformed:
    """Energy of a cell whose lattice is deformed by 1 + h and whose particles move by u besides, analytic in x = (h SCALE, u)."""

    def __init__(self, pairs, law, strengths, moved):
        self.i, self.j = np.array([pair[:2] for pair in pairs]).T
        self.R = np.array([pair[2] for pair in pairs]) + moved[self.j] - moved[self.i]
        self.law, self.n, self.dim = law, *moved.shape
        self.strength = strengths[self.i] * strengths[self.j]

    def __call__(self, x):
        h = x[..., : self.dim**2].reshape(*x.shape[:-1], self.dim, self.dim) / SCALE
        u = x[..., self.dim**2 :].reshape(*x.shape[:-1], self.n, self.dim)
        R = self.R + np.einsum('...xy,by->...bx', h, self.R) + u[..., self.j, :] - u[..., self.i, :]
        return (self.law.phi(length(R)) - self.law.phi(length(self.R))) @ self.strength / 2

    def slopes(self):
        """Derivative of the energy by h, its second derivative at fixed u, and that with u where forces balance."""
        d = self.dim**2
        x0 = np.zeros(d + self.n * self.dim)
        g, H = gradient(self, x0)[:d] * SCALE, second_derivatives(self, x0)
        u = slice(d + self.dim, None)  # the first particle stays: all together would be no motion
        follow = H[:d, u] @ np.linalg.solve(H[u, u], H[u, :d])
        shape = (self.dim,) * 4
        return g.reshape(shape[:2]), H[:d, :d].reshape(shape) * SCALE**2, (H[:d, :d] - follow).reshape(shape) * SCALE**2


def carried(moduli, constants):
    """The second derivatives by h that stress and Lagrangian constants make: C_ijkl + delta_ik sigma_jl."""
    return constants + np.einsum('ik,jl->ijkl', np.eye(len(moduli.stress)), moduli.stress)


@pytest.mark.parametrize('seed', range(2))
@pytest.mark.parametrize('name', BASES)
def test_stress_and_moduli_are_derivatives_of_the_energy(name, seed):
    atoms, energy = drawn(name, seed)
    dim = atoms.calc.dim
    V = abs(np.linalg.det(atoms.cell.array[:dim, :dim]))
    slope, clamped, free = (value / V for value in energy.slopes())
    found = elastic_moduli(atoms)
    scale = abs(clamped).max()  # 1e-9: relaxation leaves forces of 1e-9 of a bond's, and the oracle 1e-12
    np.testing.assert_allclose(found.stress, slope, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(carried(found, found.clamped), clamped, rtol=0, atol=1e-9 * scale)
    np.testing.assert_allclose(carried(found, found.constants), free, rtol=0, atol=1e-8 * scale)
    # controls: without the static stress, and with particles that do not follow
    assert abs(found.constants - free).max() > 1e-2 * scale
    if name in FOLLOWING:
        assert abs(carried(found, found.clamped) - free).max() > 1e-4 * scale


def test_a_stress_that_is_no_pressure_takes_a_symmetry_of_birchs_constants_and_the_words_name_it():
    """B_xxyy - B_yyxx is the difference of the two normal stresses."""
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    assert 'B_ijkl' not in str(elastic_moduli(cell))
    cell.set_cell(cell.cell.array * [1.05, 1.0, 1.0], scale_atoms=True)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), cutoff=1.3)
    lost = abs(np.diff(np.diag(elastic_moduli(cell).stress)))[0]
    assert f'B_ijkl differs from B_klij by up to {lost * 1e3:.3g} N/m' in str(elastic_moduli(cell))


@pytest.mark.parametrize('name', BASES)
def test_sound_of_the_bands(name):
    atoms = drawn(name, 5)[0]
    found = elastic_moduli(atoms)
    n = np.random.default_rng(5).normal(size=atoms.calc.dim)
    n /= np.linalg.norm(n)
    squares = lambda c: c * abs(c)  # noqa: E731  a soft branch is the small root of a rounded square
    bands = squares(sound_speeds(atoms, n))
    np.testing.assert_allclose(squares(found.speeds(n)), bands, rtol=0, atol=1e-9 * abs(bands).max())
    # the control: the constants without the static stress
    without = np.linalg.eigvalsh(np.einsum('ijkl,j,l->ik', found.constants, n, n)) / found.density
    assert abs(np.sort(without) - bands).max() > 1e-2 * abs(bands).max()
