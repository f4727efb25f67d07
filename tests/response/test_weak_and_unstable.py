"""Frequency response where the wave has died out, and of structures that are unstable: small ones, large ones, every model."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from oracles import Pairs, free_basis
from scipy import sparse
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, frequency_response, lattices
from magphonon.response import frf
from magphonon.response.chebyshev import Matrix, none_negative
from magphonon.response.frf import harmonic_response
from magphonon.response.normal_modes import SMALL
from magphonon.stiffness.rest import LinearSystem

L0, HOLES = 10.0, 5
TOLERANCE = 1e-9  # the default, at each frequency, of the largest displacement of the particles that are asked for


def chain(rng, count):
    """Particles on one line between two that are held; their law, their mass and their spring."""
    law, mass, k = InversePower(b=rng.uniform(1e3, 1e4), a=rng.uniform(3, 6)), rng.uniform(0.3, 2), rng.uniform(0.05, 0.5)
    atoms = lattices.chain(L0, mass).repeat((count + 2, 1, 1))
    atoms.pbc = False
    atoms.set_constraint([FixAtoms([0, count + 1]), FixedLine(range(1, count + 1), (1, 0, 0))])
    atoms.calc = MagneticRepulsion(atoms, law, foundation=k)
    return atoms, law.d2phi(L0), mass, k


def green(s, m, k, gamma, omega, count, source):
    """Response of the chain in closed form, `u_n = sinh(a n<) sinh(a (N + 1 - n>))/(s sinh(a) sinh(a (N + 1)))`.

    With cosh(a) = 1 + (k - m w^2 + i m gamma w)/(2 s), and n<, n> the lesser and the greater of n and the source.
    """
    a = np.arccosh(1 + (k - m * omega**2 + 1j * m * gamma * omega) / (2 * s) + 0j)[:, None]
    a = np.where(a.real < 0, -a, a)
    n = np.arange(1, count + 1)
    least, most = np.minimum(n, source), np.maximum(n, source)

    def sinh(x):  # e^x/2 apart, so that nothing overflows
        return -np.expm1(-2 * x)

    away = np.exp(a * (least - most))
    return away * sinh(a * least) * sinh(a * (count + 1 - most)) / (2 * s * np.sinh(a) * sinh(a * (count + 1)))


@pytest.mark.parametrize(('seed', 'count'), few_first(
    [(0, 120), (6, 400), *((seed, 120) for seed in range(1, 6)), *((seed, 400) for seed in range(7, 10))], 2))
def test_a_wave_that_has_died_out_keeps_its_digits(seed, count):
    rng = np.random.default_rng(seed)
    atoms, s, m, k = chain(rng, count)
    assert (count > SMALL) == (seed >= 6)  # by modes, or by a series
    cutoff, top = np.sqrt(k / m), np.sqrt((k + 4 * s) / m)
    omega = np.concatenate([rng.uniform(0, 0.9, 3) * cutoff, rng.uniform(cutoff, top, 3), rng.uniform(1.1, 1.5, 3) * top])
    gamma, source = 10 ** rng.uniform(-1.5, 0), int(rng.integers(1, count + 1))
    force = np.zeros((count + 2, 3), complex)
    force[source, 0] = 1e-3 * np.exp(1j * rng.uniform(0, 6))
    exact = force[source, 0] * green(s, m, k, gamma, omega, count, source)
    system = LinearSystem.of(atoms)
    raw = frf._by_modes if count <= SMALL else lambda *scene: frf.series_response(*scene, TOLERANCE)
    lost = 0
    for particles in ([source], [1 + (source + count // 2) % count], rng.choice(count, 3) + 1):
        found = frequency_response(atoms, force, omega, gamma, particles).response[..., 0]
        expected = exact[:, np.array(particles) - 1]
        allowed = TOLERANCE * abs(expected).max(axis=1) + 1e-300  # some are beyond all numbers
        assert (abs(found - expected).max(axis=1) < allowed).all()
        # the control: modes and series alone leave 1e-17 of the source everywhere
        alone = raw(system, system.shapes.T @ force[:, :2].ravel(), omega, gamma, np.array(particles))[0][..., 0]
        lost += (abs(alone - expected).max(axis=1) > allowed).sum()
    assert lost > 3


def test_what_keeps_its_digits_anyway_is_not_solved_again(monkeypatch):
    def never(*scene):
        raise AssertionError('a direct solution')

    monkeypatch.setattr(frf, 'harmonic_response', never)
    for count in (60, 400):
        atoms, s, m, k = chain(np.random.default_rng(1), count)
        force = np.zeros((count + 2, 3))
        force[9, 0] = 1
        omega = np.sqrt((k + s * np.array([0.3, 1, 2, 3])) / m)
        found = frequency_response(atoms, force, omega, 0.2, [9, 15]).response[..., 0]
        exact = green(s, m, k, 0.2, omega, count, 9)[:, [8, 14]]
        assert abs(found - exact).max() < TOLERANCE * abs(exact).max()


class Patch:
    """A patch with holes of 150 to 250 free particles of different masses, on a foundation, and its stiffness by the oracle."""

    def __init__(self, seed, model='complete'):
        rng = np.random.default_rng(seed)
        kind, held = ('square', 'honeycomb')[seed % 2], 0
        while not SMALL < 2 * held < 500:
            atoms = lattices.rectangle(getattr(lattices, kind)(L0, 0.7), *rng.uniform(90, 250, 2))
            held = (atoms.get_tags() != lattices.RIM).sum() - HOLES
        del atoms[rng.choice(np.flatnonzero(atoms.get_tags() != lattices.RIM), HOLES, replace=False)]
        atoms.set_masses(rng.uniform(0.5, 1.5, len(atoms)))
        self.law = InversePower(b=rng.uniform(1e3, 1e4), a=rng.uniform(2, 6))
        self.atoms, self.model, self.B = atoms, model, free_basis(atoms, 2)
        pairs = Pairs(atoms, self.law, 1.2 * L0, 'complete' if model == 'complete' else 'conventional')
        self.H = self.B.T @ pairs.hessian(atoms.positions) @ self.B
        self.M = self.B.T @ np.diag(np.repeat(atoms.get_masses(), 2)) @ self.B
        self.force = np.zeros((len(atoms), 3), complex)
        self.force[rng.choice(np.flatnonzero(self.B.reshape(len(atoms), -1).any(axis=1))), :2] = rng.normal(size=(2, 2)) @ [1, 1j]

    def on(self, foundation):
        atoms = self.atoms.copy()
        atoms.calc = MagneticRepulsion(atoms, self.law, foundation=foundation, model=self.model).balanced(np.arange(len(atoms)))
        return atoms

    def exact(self, foundation, omega, gamma):
        K = self.H + foundation * np.eye(len(self.H))
        return np.array([self.B @ np.linalg.solve(K - (w**2 - 1j * gamma * w) * self.M, self.B.T @ self.force[:, :2].ravel())
                         for w in omega])


@pytest.mark.filterwarnings('ignore:a damping of')
@pytest.mark.slow
@pytest.mark.parametrize('seed', range(6))
def test_unstable_structures_are_refused_however_weakly(seed):
    patch = Patch(seed)
    rng, needed = np.random.default_rng(seed), -np.linalg.eigvalsh(patch.H)[0]
    assert needed > 0
    omega, gamma = rng.uniform(0, 3, 2), 10 ** rng.uniform(-1.5, 0.5)
    for share in 10 ** rng.uniform(-8, -1, 2):
        stable, unstable = patch.on((1 + share) * needed), patch.on((1 - share) * needed)
        exact = patch.exact((1 + share) * needed, omega, gamma)
        for response in (frequency_response, harmonic_response):
            found = response(stable, patch.force, omega, gamma).response[..., :2].reshape(len(omega), -1)
            assert abs(found - exact).max() < 1e-8 * abs(exact).max()  # 1e-8 from buckling, round-off of a slow force is 1e-8
            with pytest.raises(ValueError, match='unstable and has no steady response') as refused:
                response(unstable, patch.force, omega, gamma)
            growth = np.sqrt(-np.linalg.eigvalsh(np.linalg.solve(np.sqrt(patch.M), np.linalg.solve(
                np.sqrt(patch.M), patch.H + (1 - share) * needed * np.eye(len(patch.H))).T))[0])
            assert float(str(refused.value).split('the rate ')[1].split()[0]) == pytest.approx(1e3 * growth, rel=1e-3)


@pytest.mark.parametrize('seed', few_first(range(20), 2))
def test_a_random_vector_shows_which_side_of_the_threshold(seed):
    """Patches with holes and drawn masses: what is just stable passes without a factorisation, what is just unstable never."""
    rng, patch = np.random.default_rng(seed), Patch(seed)
    K = patch.H / np.sqrt(np.outer(np.diag(patch.M), np.diag(patch.M)))
    low, high = np.linalg.eigvalsh(K)[[0, -1]]
    for share in 10 ** rng.uniform(-5, -1, 2):
        above, below = (Matrix(sparse.csr_array(K + (sign * share * (high - low) - low) * np.eye(len(K)))) for sign in (1, -1))
        assert none_negative(above, len(K), int(60 / np.sqrt(share)))
        assert not none_negative(above, len(K), int(2 / np.sqrt(share)))  # the control: too few products to tell
        assert not none_negative(below, len(K), int(60 / np.sqrt(share)))
    assert not none_negative(Matrix(sparse.csr_array((9, 9))), 9, 100)  # no force at all: shown by other means


@pytest.mark.slow
@pytest.mark.parametrize(('model', 'other'), [('conventional', 'complete'), ('complete', 'conventional')])
def test_every_model_answers_damped_and_undamped(model, other):
    patch, wrong, k = Patch(4, model), Patch(4, other), 0.3
    below = 0.5 * np.sqrt(k / patch.atoms.get_masses().max())  # below all modes of the conventional model
    if model == 'complete':
        k += max(-np.linalg.eigvalsh(patch.H)[0], 0)
    for gamma in (0.0, 0.1):
        exact = patch.exact(k, [below], gamma)
        assert abs(wrong.exact(k, [below], gamma) - exact).max() > 1e3 * TOLERANCE * abs(exact).max()
        for response in (frequency_response, harmonic_response):
            found = response(patch.on(k), patch.force, [below], gamma).response[..., :2].reshape(1, -1)
            assert abs(found - exact).max() < TOLERANCE * abs(exact).max()
