"""Time steps that a plan offers, judged by a velocity Verlet written here; and peaks that are round-off."""

import numpy as np
import pytest
from scipy.linalg import eigh

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Recorder, ToneBurst, critical_foundation, lattices, modes
from magphonon.dynamics.splittings import SPLITTINGS
from magphonon.planning import waveform
from magphonon.planning.peak import highest_peak, plan_peak
from magphonon.planning.waveform import plan_waveform
from magphonon.response.frf import Dof


def drawn(seed):
    """A patch on pillars, a burst with its carrier below the cut-off, particles to watch, duration, damping, tolerance.

    With the seeds 15 and 21 the time steps taken from a quiet burst missed the tolerance.
    """
    rng = np.random.default_rng(seed)
    patch = lattices.rectangle(getattr(lattices, rng.choice(['square', 'triangular']))(10.0, 1.0), 60.0, 50.0)
    a = rng.uniform(2, 7)
    patch.set_masses(rng.choice([0.5, 1.0, 2.0], len(patch)))
    patch.calc = MagneticRepulsion(patch, InversePower(0.3 * 10.0**a, a), foundation=1.0)
    patch.calc.set(foundation=float(critical_foundation(patch)[0] * rng.uniform(1.05, 4) + 10 ** rng.uniform(-2, 0.3)))
    cutoff, free = modes(patch).omega[0], np.flatnonzero(patch.get_tags() == 0)
    source, row = int(rng.choice(free)), rng.choice(free, 5, replace=False)
    burst = ToneBurst(source, (0, 1), 10 ** rng.uniform(-1.5, 0.3), omega=rng.uniform(0.3, 1.0) * cutoff,
                      cycles=float(rng.choice([1, 2, 3, 5])))
    duration, damping = float(rng.uniform(1.2, 3) * burst.end), float(rng.choice([0, 0, 0.05]))
    return patch, burst, row, damping, duration, 10 ** rng.uniform(-2.5, -0.7)


class Verlet:
    """Velocity Verlet of a driven patch with nearest neighbours, from the law r^-a alone."""

    def __init__(self, patch, burst, row, damping):
        self.burst, self.row, self.damping, self.k, law = burst, row, damping, patch.calc.foundation, patch.calc.laws
        X = patch.positions[:, :2]
        lengths = np.linalg.norm(X[:, None] - X, axis=2)
        i, j = np.nonzero(np.triu((lengths > 0) & (lengths < 10.1)))
        self.incidence = np.zeros((len(i), len(X)))
        self.incidence[np.arange(len(i)), j], self.incidence[np.arange(len(i)), i] = 1, -1
        strengths = np.ones(len(X)) if patch.calc.strengths is None else patch.calc.strengths
        self.b, self.a, self.R = law.b * (strengths[i] * strengths[j])[:, None], law.a, X[j] - X[i]
        self.free = (patch.get_tags() == 0)[:, None] / patch.get_masses()[:, None]
        self.rest = self.repulsion(0 * X)

    def repulsion(self, u):
        R = self.R + self.incidence @ u
        return self.incidence.T @ (self.b * (R**2).sum(axis=1, keepdims=True) ** (-(self.a + 1) / 2) * R)

    def run(self, dt, steps, fine, share=1.0):
        """Displacements of the row over `share` after each of `steps` steps dt, in `fine` parts."""
        dt, burst = dt / fine, self.burst
        t = dt * np.arange(1, steps * fine + 1)
        pushes = share * burst.amplitude[0] * np.sin(burst.omega * t) * (1 - np.cos(burst.omega * t / burst.cycles)) / 2
        pushes[t > burst.end] = 0
        u = np.zeros((len(self.free), 2))
        v, acceleration, decay, found = 0 * u, 0 * u, np.exp(-self.damping * dt / 2), []
        for step, push in enumerate(pushes, 1):
            v = decay * v + dt / 2 * acceleration
            u = u + dt * v
            force = self.repulsion(u) - self.rest - self.k * u
            force[burst.particles[0]] += push * burst.direction[:2]
            acceleration = self.free * force
            v = decay * (v + dt / 2 * acceleration)
            if step % fine == 0:
                found.append(u[self.row])
        return np.array(found) / share

    def error(self, dt, duration, share=1.0):
        """Relative error of the step dt, against dt/2 and dt/4 extrapolated to zero."""
        own, half, quarter = (self.run(dt, int(duration / dt), fine, share) for fine in (1, 2, 4))
        exact = quarter + (quarter - half) / 3
        return np.linalg.norm(own - exact) / np.linalg.norm(exact)


@pytest.mark.parametrize('seed', [15, 21, 18])
def test_the_step_of_a_loud_burst_below_the_cut_off_meets_its_tolerance(seed):
    """Control: the step from the error of a quiet burst, for which the frequencies of the lattice are not shifted."""
    patch, burst, row, damping, duration, tolerance = drawn(seed)
    limit, verlet = 2 / modes(patch).omega[-1], Verlet(patch, burst, row, damping)
    plan = plan_waveform(patch, burst, row, damping, duration, tolerance)
    assert plan.choice.dt is not None
    choice = plan.methods[-1]  # which steps of higher order may undercut
    error = verlet.error(choice.dt, duration)
    assert error <= choice.at_most <= tolerance
    assert error > choice.error / 2  # not far shorter than need be
    assert 0.3 < choice.doubt < 1  # what the next order of the step adds to its square is not known, but is less
    quiet = verlet.error(limit / 4, duration, 1e-6)
    naive = min(limit / 4 * np.sqrt(0.6 * tolerance / quiet), limit / 2)
    assert verlet.error(naive, duration) > tolerance


@pytest.mark.parametrize('seed', [4, *(pytest.param(seed, marks=pytest.mark.slow) for seed in (1, 12))])
def test_steps_of_higher_order_meet_a_narrow_tolerance_at_less_cost(seed):
    """Control: Verlet with as many evaluations.  With the seed 12 bonds get so short that they are much stiffer than at rest."""
    patch, burst, row, damping, duration, _ = drawn(seed)
    plan, verlet = plan_waveform(patch, burst, row, damping, duration, 1e-3), Verlet(patch, burst, row, damping)
    choice, dt, stages = plan.choice, plan.choice.dt, SPLITTINGS[plan.choice.order].stages
    assert choice.order > 2
    assert stages / dt < 1 / plan.methods[-1].dt / 1.5  # evaluations per time
    steps = int(duration / dt)
    half, exact = (verlet.run(dt, steps, fine) for fine in (4 * stages, 8 * stages))
    exact += (exact - half) / 3
    dyn = DrivenVerlet(waveform.as_model(patch, 'complete'), dt, [burst], damping, order=choice.order, engine='numpy')
    recorder = Recorder(dyn, row, 1)
    dyn.run(steps)
    assert waveform.difference(recorder.displacements[1:], exact) <= choice.at_most <= 1e-3
    assert waveform.difference(verlet.run(dt, steps, stages), exact) > 1e-3


@pytest.mark.parametrize('seed', [3, 8])
def test_magnets_of_different_strengths_are_planned_for(seed):
    """The nonlinearity that a plan tells, against time steps with the strengths; control: that of equal magnets is another."""
    patch, burst, row, damping, duration, _ = drawn(seed)
    equal, law, springs = Verlet(patch, burst, row, damping), patch.calc.law, patch.calc.foundation
    free, strengths = np.flatnonzero(patch.get_tags() == 0), np.random.default_rng(seed).uniform(0.7, 1.3, len(patch))
    patch.calc = MagneticRepulsion(patch, law, foundation=1.3**2 * springs, strengths=strengths).balanced(free)
    plan = plan_waveform(patch, burst, row, damping, duration, 1e-3)
    linear = next(method for method in plan.methods if method.name == 'complete linear')
    dt = 0.5 / modes(patch).omega[-1]
    frames = 2 * int(np.pi / burst.omega / waveform.FRAMES / dt)
    errors = []
    for verlet in (Verlet(patch, burst, row, damping), equal):
        full, weak = (verlet.run(dt, int(duration / dt), 4, share)[frames - 1 :: frames] for share in (1, 1e-6))
        errors.append(np.linalg.norm(full - weak) / np.linalg.norm(weak))
    assert linear.error == pytest.approx(errors[0], rel=0.02)  # its steps are longer
    assert linear.error != pytest.approx(errors[1], rel=0.05)


def test_steps_that_do_not_converge_are_no_promise(monkeypatch):
    patch, burst, row, damping, duration, tolerance = drawn(15)
    monkeypatch.setattr(waveform, 'LARGEST_CHANGE', 1e-9)
    monkeypatch.setattr(waveform, 'HALVINGS', 1)
    plan = plan_waveform(patch, burst, row, damping, duration, tolerance)
    assert plan.methods[-1].error == np.inf
    assert plan.methods[-1].dt > 0
    assert 'their error is unknown' in plan.evidence[-1]
    with pytest.raises(ValueError, match=r'no model here gives .* time steps do not converge'):
        _ = plan.choice


def test_a_peak_of_round_off_is_none():
    """Without D* a square lattice is made of chains that do not move each other, and their modes mix by round-off only."""
    omega, alive = np.linspace(0.5, 3.0, 200), 0
    for seed in range(6):
        rng = np.random.default_rng(seed)
        patch = lattices.rectangle(lattices.square(10.0, 1.0), 70.0, 60.0)
        patch.set_masses(rng.choice([0.5, 1.0, 2.0], len(patch)))
        patch.calc = MagneticRepulsion(patch, InversePower(3e3, 4.0), foundation=2.0)
        free, X, along = np.flatnonzero(patch.get_tags() == 0), patch.positions, np.array([0.6, 0.8, 0.0])
        source = rng.choice(free)
        answer = rng.choice(free[(abs(X[free] - X[source])[:, :2] > 5).all(axis=1)])
        here, there = Dof(int(source), along), Dof(int(answer), along)
        found = plan_peak(patch, here, there, omega, 0.002, 0.05)
        frozen = found.methods[0]
        assert frozen.error == np.inf
        assert 'without D* there is none' in found.evidence[0]

        # The control: without D* by dense algebra, products that are not zero in floating point, with a response that is.
        other = patch.copy()
        other.calc = patch.calc.about(patch.calc.reference, model='conventional')
        shapes = modes(other).shapes
        alive += (here.seen(shapes) * there.seen(shapes) != 0).any()
        squares, v = eigh(chains(patch), np.diag(np.repeat(patch.get_masses()[free], 2)))
        e = v.reshape(len(free), 2, -1)
        push, seen = (along[:2] @ e[np.flatnonzero(free == p)[0]] for p in (source, answer))
        response = (push * seen / (squares - omega[:, None] ** 2 + 0.002j * omega[:, None])).sum(axis=1)
        assert abs(response).max() < 1e-9
        assert highest_peak(patch, here, there, omega, 0.002).omega > 0
    assert alive


def chains(patch):
    """Stiffness of the free particles of a square patch without D*: a f(10 mm)/10 mm of a bond along it, N/mm."""
    free, X = np.flatnonzero(patch.get_tags() == 0), patch.positions[:, :2]
    stiffness = 4 * 3e3 / 10.0**5
    K = np.zeros((len(X), 2, len(X), 2))
    for i in range(len(X)):
        for j in range(len(X)):
            R = X[j] - X[i]
            if 0 < np.linalg.norm(R) < 10.1:
                block = stiffness * np.outer(R, R) / (R @ R)
                K[i, :, i] += block
                K[i, :, j] -= block
        K[i, :, i] += 2.0 * np.eye(2)
    return K[free][:, :, free].reshape(2 * len(free), -1)
