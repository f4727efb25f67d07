"""The limit of the time step, and what happens beyond it."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from motion import DT, MASS, patch

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, verdict
from magphonon.dynamics.cages import Diverged
from magphonon.dynamics.engine import highest_frequency
from magphonon.dynamics.splittings import SPLITTINGS

pytestmark = [pytest.mark.slow,  # each compiles kernels of its own, which takes seconds
              pytest.mark.filterwarnings('ignore:a damping of')]


def test_a_step_over_the_limit_is_refused_with_both_numbers():
    limit = 2 / highest_frequency(patch())
    DrivenVerlet(patch(), 0.9999 * limit)
    with pytest.raises(ValueError, match=rf'{1.0001 * limit:.9g} ms .* 2/omega_max = {limit:.9g} ms.*allow_unstable'):
        DrivenVerlet(patch(), 1.0001 * limit)
    dyn = DrivenVerlet(patch(), DT)
    dyn.atoms.calc.set(foundation=1e4)
    with pytest.raises(ValueError, match='stability limit'):
        dyn.run(10)


@pytest.mark.parametrize('engine', ['ase', 'compiled'])
def test_a_run_that_goes_wrong_stops_in_the_last_good_state(engine):
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


@pytest.mark.parametrize('engine', ['ase', 'compiled'])
@pytest.mark.parametrize(('order', 'ratio'), [(2, 2.0), (2, 10.0), (4, 1.0), (4, 10.0), (6, 1.0), (6, 30.0)])
def test_overdamped_motion_is_right_to_percents_up_to_the_damping_that_is_refused(engine, order, ratio):
    """One particle between two held ones, let go: the closed form, on both sides of the threshold."""
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
    free = verdict(atoms)['timestep_limit']
    assert verdict(atoms, damping=0.1 / free)['timestep_limit'] == free
    judged = verdict(atoms, damping=5 / free)
    assert judged['timestep_limit'] == pytest.approx(free / 10)
    DrivenVerlet(atoms, 0.999 * judged['timestep_limit'], damping=5 / free)
    with pytest.raises(ValueError, match='times the time step'):
        DrivenVerlet(atoms, 1.001 * judged['timestep_limit'], damping=5 / free)
