"""Nonlinearity by perturbation theory, against time steps with the law alone."""

from dataclasses import replace

import numpy as np
import pytest

from magphonon.dynamics.timestep import highest_frequency
from magphonon.planning.slight_nonlinearity import relative_correction
from magphonon.planning.waveform import SLIGHT, SLIGHT_DOUBT, plan_waveform
from magphonon.stiffness.linear_system import LinearSystem

from .test_step_plans import Verlet, drawn


def with_effect(seed, effect):
    """A drawn burst with the amplitude at which nonlinearity changes the motion by about this share, in perturbation theory."""
    patch, burst, row, damping, duration, _ = drawn(seed)
    system = LinearSystem.of(patch)
    dt = 0.5 / highest_frequency(system)
    clock = dt, 2, int(duration / dt)
    for _ in range(8):
        found = relative_correction(system, burst, damping, row, clock)
        burst = replace(burst, amplitude=burst.amplitude * (effect / found) ** 0.7)
    verlet = Verlet(patch, burst, row, damping)
    full, weak = (verlet.run(dt, clock[2], 1, share)[1::2] for share in (1, 1e-6))
    exact = np.linalg.norm(full - weak) / np.linalg.norm(weak)
    return (patch, burst, row, damping, duration), relative_correction(system, burst, damping, row, clock), exact


@pytest.mark.parametrize('seed', [2, 9, 26])
def test_a_slight_nonlinearity_is_that_of_the_law(seed):
    """The doubt that plans allow is that of the worst of 40 bursts; at a thirtieth of the effect the theory is closer."""
    _, found, exact = with_effect(seed, SLIGHT)
    assert found == pytest.approx(exact, rel=SLIGHT_DOUBT)
    _, small, exact = with_effect(seed, SLIGHT / 30)
    assert small == pytest.approx(exact, rel=SLIGHT_DOUBT / 5)
    assert small < found / 20


def test_beyond_a_slight_nonlinearity_perturbation_theory_is_wrong_and_plans_make_trial_runs():
    burst, found, exact = with_effect(29, 3.3 * SLIGHT)
    assert abs(found / exact - 1) > 3 * SLIGHT_DOUBT
    evidence = plan_waveform(*burst, tolerance=0.02).evidence
    assert 'trial run' in evidence[1]
    burst, _, exact = with_effect(29, SLIGHT / 3)
    plan = plan_waveform(*burst, tolerance=0.02)
    assert 'perturbation theory' in plan.evidence[1]
    linear = next(method for method in plan.methods if method.name == 'complete linear')
    assert linear.error == pytest.approx(exact, rel=linear.doubt)
