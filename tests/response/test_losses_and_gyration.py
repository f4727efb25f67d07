"""Losses and gyration of each site: structures times questions, against the equations of motion written out densely.

M u'' + C u' + K u = f, with losses on the diagonal of C and gyration beside it.  K is that of single pairs (`structures.Truth`).
Each comparison must fail if nothing gyrates, and if the losses are those of other sites.
"""

import numpy as np
import pytest
from scipy.linalg import expm
from structures import few_first, structure

from magphonon import DrivenVerlet, frequency_response, propagate
from magphonon.bands import complex_bands, group_velocities
from magphonon.bands.bloch import bloch_modes, damped_modes
from magphonon.dynamics import Harmonic
from magphonon.response import Dof, natural_frequencies, receptance
from magphonon.stiffness import LinearSystem

J = np.array([[0.0, 1.0], [-1.0, 0.0]])


class Drawn:
    """A structure in the plane that stands, with losses and gyration of each site in units of its fastest bond."""

    def __init__(self, seed, periodic):
        self.case = structure(seed, periodic=periodic, most=6 if periodic else 24, guided=not periodic, strip=False, layer=False)
        self.truth, self.rng, n = self.case.truth, np.random.default_rng([seed, 7]), len(self.case.atoms)
        self.H, self.M, self.B = self.case.reduced(self.truth)
        self.stands = self.case.dim == 2 and self.H.size and np.linalg.eigvalsh(self.H)[0] > 1e-3 * abs(self.H).max()
        if self.stands:
            self.fast = np.sqrt(abs(self.H).max() / np.diag(self.M).min())
            self.gamma, self.g = self.fast * self.rng.uniform(0.01, 0.3, n), self.fast * self.rng.normal(size=n) / 3
            self.atoms = LinearSystem.of(self.case.atoms).atoms
            self.atoms.calc.set(gyration=self.g)

    def mistakes(self):
        """Losses and gyration as they are, and two mistaken ones."""
        return (self.gamma, self.g), (self.gamma, 0 * self.g), (self.gamma[::-1], self.g)

    def C(self, gamma, g):
        """Over the masses, of all directions."""
        return np.diag(np.repeat(gamma, 2)) - np.kron(np.diag(g), J)

    def reduced(self, gamma, g):
        """Of the free directions, times the masses."""
        return self.B.T @ (self.truth.rows[:, None] * self.C(gamma, g)) @ self.B


def some(count, periodic):
    seed = 0
    while count:
        one, seed = Drawn(seed, periodic), seed + 1
        if one.stands and (one.atoms.pbc.any() or not periodic):
            yield one
            count -= 1


def flow(H, M, c):
    """Generator of (u, v)."""
    return np.block([[np.zeros_like(H), np.eye(len(H))], [-np.linalg.solve(M, H), -np.linalg.solve(M, c)]])


# each question: what the package answers, and what the equations of motion say with these losses and this gyration

def response(one, gamma, g):
    rng, n = np.random.default_rng(1), len(one.atoms)
    force = np.pad(rng.normal(size=(n, 2)) + 1j * rng.normal(size=(n, 2)), ((0, 0), (0, 1)))
    omega = one.fast * np.array([0.3, 0.9])
    exact = [one.B @ np.linalg.solve(one.H - w**2 * one.M + 1j * w * one.reduced(gamma, g), one.B.T @ force[:, :2].ravel())
             for w in omega]
    return frequency_response(one.atoms, force, omega, one.gamma).response[..., :2].reshape(2, -1), np.array(exact)


def motion(one, gamma, g):
    """From a start, under a force F cos(wt): the motion of a clock beside, exactly one more exponential."""
    rng, n, free = np.random.default_rng(2), len(one.atoms), len(one.H)
    x, F, w = rng.normal(size=2 * free), np.pad(rng.normal(size=(n, 2)), ((0, 0), (0, 1))), 0.7 * one.fast
    whole = np.zeros((2 * free + 2,) * 2)
    whole[:-2, :-2] = flow(one.H, one.M, one.reduced(gamma, g))
    whole[free:-2, -2], whole[-2, -1], whole[-1, -2] = np.linalg.solve(one.M, one.B.T @ F[:, :2].ravel()), w, -w
    atoms, times = one.atoms.copy(), np.array([3.0, 3.7, 40.0]) / one.fast
    atoms.calc = one.atoms.calc
    atoms.positions[:, :2] += (one.B @ x[:free]).reshape(n, 2)
    v = (one.B @ x[free:]).reshape(n, 2) * one.truth.masses[:, None]
    atoms.set_momenta(np.pad(v, ((0, 0), (0, 1))), apply_constraint=False)
    found = propagate(atoms, times, [lambda t: F * np.cos(w * t)], one.gamma).displacements
    return found.reshape(3, -1), np.array([one.B @ (expm(whole * t) @ [*x, 1.0, 0.0])[:free] for t in times])


def shaken(one, gamma, g):
    """A shaken bench, u = d u_b + P y: damping and gyration depend on u' - d u_b'."""
    d, omega, n = np.array([0.6, 0.8, 0.0]), one.fast * np.array([0.3, 0.9]), len(one.atoms)
    site = int(abs(one.B).sum(axis=1).argmax()) // 2
    ub, exact = np.tile(d[:2], n), []
    for w in omega:
        y = np.linalg.solve(one.H - w**2 * one.M + 1j * w * one.reduced(gamma, g), one.B.T @ (-(w**2) * one.truth.rows * ub))
        exact.append((ub - one.B @ y)[2 * site + 1])
    return receptance(one.atoms, d, Dof(site, np.array([0, 1.0, 0])), omega, one.gamma).response, np.array(exact)


def frequencies(one, gamma, g):
    """Of what gyrates without losses."""
    rates = np.linalg.eigvals(flow(one.H, one.M, one.reduced(0 * gamma, g)))
    return natural_frequencies(one.atoms), np.sort(rates.imag)[len(one.H):]


def of_waves(one, gamma, g):
    """Stiffness over masses of two waves, and all their rates s, e^{st}."""
    q = np.random.default_rng(3).uniform(-0.5, 0.5, (2, 3)) * one.atoms.pbc
    K = one.truth.waves(q) / np.sqrt(one.truth.rows * one.truth.rows[:, None])
    one_, none = np.eye(K.shape[1]), np.zeros(K.shape[1:])
    return q, K, [np.linalg.eigvals(np.block([[none, one_], [-k, -one.C(gamma, g)]])) for k in K]


def bands(one, gamma, g):
    """Frequencies of both; those of -q are the conjugate rates."""
    q, K, rates = of_waves(one, 0 * gamma, g)
    return bloch_modes(one.atoms, q, one.truth.model)[0], np.sort(-np.imag(rates), axis=1)[:, K.shape[1]:]


def damped(one, gamma, g):
    """Each pole, in order of its frequency: w and decay; overdamped motion has two decays and no frequency."""
    q, _, rates = of_waves(one, gamma, g)
    omega, decay, _ = damped_modes(one.atoms, q, one.gamma, one.truth.model)
    swinging = [np.sort_complex(s[-s.imag > 1e-3 * one.fast].conj()) for s in rates]
    ours = [np.sort_complex((-fall + 1j * w)[w > 1e-3 * one.fast]) for w, fall in zip(omega, decay, strict=True)]
    return np.concatenate(ours), np.concatenate(swinging)


def velocities(one, gamma, g, h=1e-5):
    q, *_ = of_waves(one, gamma, g)
    step, b = h * one.atoms.pbc, one.atoms.cell.reciprocal().array[:, :2] * 2 * np.pi
    ends = [one.truth.waves(q + sign * step) / np.sqrt(one.truth.rows * one.truth.rows[:, None]) for sign in (1, -1)]
    up, down = (np.array([np.sort(-np.linalg.eigvals(np.block([[0 * k, np.eye(len(k))], [-k, -one.C(0 * gamma, g)]])).imag)
                          for k in K])[:, ends[0].shape[1]:] for K in ends)
    found = group_velocities(one.atoms, q, one.truth.model).velocity
    return found @ (b * one.atoms.pbc[:, None]).sum(axis=0), (up - down) / (2 * h)


QUESTIONS = {  # and its tolerance, of the largest entry, and whether it is asked of lattices
    response: (1e-9, False), motion: (1e-9, False), shaken: (1e-9, False), frequencies: (1e-9, False),
    bands: (1e-9, True), damped: (1e-7, True),  # beside double poles
    velocities: (1e-5, True),  # differences over 1e-5 of the zone
}


def compare(question, count):
    tolerance, periodic = QUESTIONS[question]
    noticed = np.zeros(2, bool)
    for one in some(count, periodic):
        right, *wrong = one.mistakes()
        found, exact = question(one, *right)
        assert found.shape == exact.shape
        assert abs(found - exact).max() < tolerance * abs(exact).max(), one.case.seed
        others = [question(one, *mistaken)[1] for mistaken in wrong]
        noticed |= [other.shape != exact.shape or abs(other - exact).max() > 1e-4 * abs(exact).max() for other in others]
    assert noticed[0]
    assert noticed[1] or question in (frequencies, bands, velocities)  # which know no losses


@pytest.mark.filterwarnings('ignore:particles move by up to')
@pytest.mark.parametrize('count', few_first([2, 5], 1))
@pytest.mark.parametrize('question', QUESTIONS)
def test_the_equations_of_motion_answer(question, count):
    compare(question, count)


@pytest.mark.slow
@pytest.mark.parametrize('engine', ['ase', 'compiled'])
def test_time_steps_are_of_second_order(engine):
    for one in some(3, False):
        rng, free, n = np.random.default_rng(5), len(one.H), len(one.atoms)
        x, F, w, errors = 1e-6 * rng.normal(size=2 * free), 1e-6 * rng.normal(size=(n, 2)), 0.7 * one.fast, []
        F = (one.B @ one.B.T @ F.ravel()).reshape(n, 2)
        x[free:] *= one.fast
        ends = []
        for gamma, g in one.mistakes():
            whole = np.zeros((2 * free + 2,) * 2)
            whole[:-2, :-2] = flow(one.H, one.M, one.reduced(gamma, g))
            whole[free:-2, -2], whole[-2, -1], whole[-1, -2] = np.linalg.solve(one.M, one.B.T @ F.ravel()), w, -w
            ends.append(one.B @ (expm(whole * 4 / one.fast) @ [*x, 0.0, 1.0])[:free])
        for steps in (80, 160):
            atoms = one.atoms.copy()
            atoms.calc = one.atoms.calc
            atoms.positions[:, :2] += (one.B @ x[:free]).reshape(n, 2)
            v = (one.B @ x[free:]).reshape(n, 2) * one.truth.masses[:, None]
            atoms.set_momenta(np.pad(v, ((0, 0), (0, 1))), apply_constraint=False)
            free_ones = np.flatnonzero(F.any(axis=1))
            drives = [Harmonic(free_ones, along, F[free_ones, axis], w) for axis, along in enumerate(((1, 0, 0), (0, 1, 0)))]
            dyn = DrivenVerlet(atoms, 4 / one.fast / steps, drives, damping=one.gamma, engine=engine)
            dyn.run(steps)
            errors.append(abs(dyn.displacements.ravel() - ends[0]).max() / abs(ends[0]).max())
        assert 3.5 < errors[0] / errors[1] < 4.5
        assert min(abs(end - ends[0]).max() for end in ends[1:]) > 10 * errors[1] * abs(ends[0]).max()


def test_complex_waves_solve_the_equations_of_motion_and_none_is_missing():
    """The determinant winds round zero along |mu| = 1 and 1/10 as often as there are waves that decay by less than that."""
    counted = 0
    for one in some(4, True):
        if not one.atoms.pbc[0]:
            continue
        omega, rows = one.fast * one.rng.uniform(0.3, 0.9), one.truth.rows
        try:
            found = complex_bands(one.atoms, (1, 0, 0), [omega], one.truth.model, one.gamma)
        except ValueError:  # no bonds along this direction
            continue

        def equations(xi, one=one, omega=omega, rows=rows, lost=0):
            K = one.truth.waves(np.atleast_1d(xi)[:, None] / (2 * np.pi) * np.eye(3)[0]) / np.sqrt(rows * rows[:, None])
            return K - omega**2 * np.eye(len(rows)) - 1j * omega * one.C(one.gamma, (1 - lost) * one.g)

        xi, v = found.xi[0], found.vectors[0].reshape(len(found.xi[0]), -1)
        near = np.isfinite(xi) & (xi.imag < 5)
        if not near.any():
            continue
        left, without = (np.einsum('wab,wb->wa', equations(xi[near], lost=lost), v[near]) for lost in (0, 1))
        assert abs(left).max() < 1e-8 * abs(equations(xi[near])).max()
        assert abs(without).max() > 1e3 * abs(left).max()
        assert (xi.imag > 0).all()
        turns = []
        for decay in (0.0, np.log(10)):
            phases = np.angle(np.linalg.det(equations(np.linspace(0, 2 * np.pi, 801) + 1j * decay)))
            turns.append(np.round(np.diff(np.unwrap(phases)).sum() / (2 * np.pi)))
        assert abs(turns[0] - turns[1]) == np.count_nonzero(xi.imag < np.log(10)), one.case.seed
        counted += 1
    assert counted > 1
