"""The limit of the time step, and what happens beyond it."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine
from motion import DT, MASS, oscillator, patch

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, units as u, verdict
from magphonon.dynamics.cages import Diverged
from magphonon.dynamics.engine import frequency_bound, highest_frequency
from magphonon.dynamics.splittings import SPLITTINGS


@pytest.mark.parametrize('engine', ['ase', 'numpy'])
def test_the_limit_is_sharp(engine):
    atoms = patch(5)
    omega = highest_frequency(atoms)

    def largest(omega_dt):
        atoms = patch(5, speed=1e-6)
        dyn = DrivenVerlet(atoms, omega_dt / omega, engine=engine, allow_unstable=True)
        try:
            dyn.run(400)
        except Diverged:
            return np.inf
        return abs(dyn.displacements).max()

    # growth per step is acosh(omega^2 dt^2/2 - 1) = 0.063 at 2.001: e^25 in 400 steps.  Below, the amplitude is at most
    # v dt/sqrt(1 - (omega dt/2)^2), some 30 v dt.
    assert largest(1.999) < 1e-3
    assert largest(2.001) > 1


def test_highest_frequency_is_the_top_of_the_spectrum():
    atoms = patch(8)
    H = atoms.calc.get_hessian(atoms).toarray().reshape(64, 3, 64, 3)
    free = np.flatnonzero(atoms.get_tags() == 0)
    H = H[np.ix_(free, [0, 1], free, [0, 1])].reshape(2 * len(free), -1)
    expected = np.sqrt(np.linalg.eigvalsh(H / MASS)[-1])
    assert highest_frequency(atoms) == pytest.approx(expected, rel=1e-9)
    assert expected < frequency_bound(atoms, DT) < 2 * expected  # the cheap bound is a bound, and not useless
    large = patch(16)  # by Lanczos
    assert highest_frequency(large) == pytest.approx(highest_frequency(patch(14)), rel=0.01)


def test_lines_count_in_the_limit(paper):
    atoms = oscillator(np.pi / 6)  # D_xx = D_yy
    atoms.set_constraint([FixAtoms([0, 1, 2]), FixedLine(3, (0, 1, 0))])
    assert highest_frequency(atoms) * u.s == pytest.approx(paper['oscillator']['omega_y'][1], rel=1e-9)
    atoms = oscillator(0)
    assert highest_frequency(atoms) * u.s == pytest.approx(np.sqrt(paper['oscillator']['D_xx'][0]), rel=1e-9)


def test_a_step_over_the_limit_is_refused_with_both_numbers():
    limit = 2 / highest_frequency(patch())
    DrivenVerlet(patch(), 0.9999 * limit)
    with pytest.raises(ValueError, match=rf'{1.0001 * limit:.9g} ms .* 2/omega_max = {limit:.9g} ms.*allow_unstable'):
        DrivenVerlet(patch(), 1.0001 * limit)
    dyn = DrivenVerlet(patch(), DT)
    dyn.atoms.calc.set(foundation=1e4)
    with pytest.raises(ValueError, match='stability limit'):
        dyn.run(10)


@pytest.mark.parametrize('engine', ['ase', 'numpy', pytest.param('compiled', marks=pytest.mark.slow)])
def test_a_run_that_goes_wrong_stops_in_the_last_good_state(engine):
    if engine == 'compiled':
        pytest.importorskip('numba')
    atoms = patch()
    atoms.set_momenta(np.outer(np.arange(49) == 24, [MASS * 98, 0, 0]))  # 9.8 of the 10 mm to its neighbour in one step
    seen = []
    dyn = DrivenVerlet(atoms, DT, engine=engine)
    dyn.attach(lambda: seen.append(atoms.get_positions()), 1)
    with pytest.raises(Diverged, match=r'particle \d+ .* last good state.*shorter time step') as caught:
        dyn.run(1000)
    error = caught.value
    assert 0 <= error.last_good < error.time
    assert error.particle in range(49)
    assert error.atoms is atoms
    assert np.isfinite(atoms.positions).all()
    assert np.array_equal(atoms.positions, seen[round(error.last_good / DT)])
    assert dyn.get_time() == error.last_good


def test_a_soft_collision_is_noticed_too():
    soft = InversePower(b=1e-6, a=1.0)  # too weak to stop anything
    atoms = patch(law=soft)
    atoms.set_momenta(np.outer(np.arange(49) == 24, [MASS * 2, 0, 0]))
    with pytest.raises(Diverged, match='mm from its neighbour'):
        DrivenVerlet(atoms, DT, engine='numpy').run(100)


@pytest.mark.parametrize('engine', ['ase', 'numpy', 'compiled'])
@pytest.mark.parametrize(('order', 'ratio'), [(2, 2.0), (2, 10.0), (4, 1.0), (4, 10.0), (6, 1.0), (6, 30.0)])
def test_overdamped_motion_is_right_to_percents_up_to_the_damping_that_is_refused(engine, order, ratio):
    """One particle between two held ones, let go: the closed form, on both sides of the threshold."""
    pytest.importorskip('numba') if engine == 'compiled' else None
    atoms = Atoms('Nd3', positions=[(-1, 0, 0), (0, 0, 0), (1, 0, 0)], masses=[1.0, 1.0, 1.0])
    atoms.set_constraint(FixAtoms([0, 2]))
    atoms.calc = MagneticRepulsion(atoms, InversePower(1e-9, 4.0), foundation=1.0)  # omega = 1
    gamma, most = 2 * ratio, SPLITTINGS[order].damped
    slow, fast = (np.roots([1, gamma, 1]).real if ratio > 1 else np.array([-1 + 1e-6, -1 - 1e-6]))[::-1 if ratio > 1 else 1]

    def error(damped, allow=False):
        here = atoms.copy()
        here.calc = atoms.calc
        here.positions[1, 0] = 1e-3
        dyn = DrivenVerlet(here, damped / gamma, damping=gamma, engine=engine, order=order, allow_unstable=allow)
        steps = max(1, round(-1 / slow / dyn.dt))
        dyn.run(steps)
        t = steps * dyn.dt
        return abs(dyn.displacements[1, 0] / (1e-3 * (fast * np.exp(slow * t) - slow * np.exp(fast * t)) / (fast - slow)) - 1)

    assert error(0.99 * most) < 0.05
    with pytest.raises(ValueError, match=f'take a time step of at most {most / gamma:.4g}'):
        error(1.01 * most)
    if order == 2:
        assert error(4 * most, allow=True) > 0.1


def test_the_step_that_the_verdict_accepts_knows_the_damping():
    atoms = patch(5)
    free = verdict(atoms).timestep_limit
    assert verdict(atoms, damping=0.1 / free).timestep_limit == free
    judged = verdict(atoms, damping=5 / free)
    assert judged.timestep_limit == pytest.approx(free / 10)
    DrivenVerlet(atoms, 0.999 * judged.timestep_limit, damping=5 / free)
    with pytest.raises(ValueError, match='damping by'):
        DrivenVerlet(atoms, 1.001 * judged.timestep_limit, damping=5 / free)
