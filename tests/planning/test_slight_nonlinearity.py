"""Nonlinearity by perturbation theory, against time steps with the law alone."""

from dataclasses import replace

import numpy as np
import pytest

from magphonon.dynamics.engine import highest_frequency
from magphonon.planning.waveform import NEXT_ORDER, SLIGHT, plan_waveform, relative_correction
from magphonon.stiffness.rest import LinearSystem

from .test_step_plans import Verlet, drawn

BELOW = 0.07
"""Largest error of perturbation theory at an effect of 3 %, as a fraction, of 40 bursts with carriers below the cut-off."""


def with_effect(seed, effect, faster=1.0):
    """A drawn burst with the amplitude at which nonlinearity changes the motion by about this share, in perturbation theory."""
    patch, burst, row, damping, duration, _ = drawn(seed)
    burst = replace(burst, omega=faster * burst.omega)
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
    """Below the cut-off, within that of the worst of 40 bursts; at a thirtieth of the effect the theory is closer."""
    _, found, exact = with_effect(seed, SLIGHT)
    assert found == pytest.approx(exact, rel=BELOW)
    _, small, exact = with_effect(seed, SLIGHT / 30)
    assert small == pytest.approx(exact, rel=BELOW / 5)
    assert small < found / 20


@pytest.mark.parametrize('seed', [11, 16, 21])
def test_above_the_cut_off_plans_allow_for_what_the_next_order_changes(seed):
    """Three of the worst of 36 bursts whose carriers are four times as fast; the control is the doubt of those below."""
    _, found, exact = with_effect(seed, SLIGHT, faster=4)
    assert BELOW < abs(exact / found - 1) < NEXT_ORDER * found


def test_beyond_a_slight_nonlinearity_perturbation_theory_is_wrong_and_plans_make_trial_runs():
    burst, found, exact = with_effect(29, 3.3 * SLIGHT)
    assert abs(found / exact - 1) > 3 * BELOW
    evidence = plan_waveform(*burst, tolerance=0.02).evidence
    assert 'trial run' in evidence[1]
    burst, _, exact = with_effect(29, SLIGHT / 3)
    plan = plan_waveform(*burst, tolerance=0.02)
    assert 'perturbation theory' in plan.evidence[1]
    linear = next(method for method in plan.methods if method.name == 'complete linear')
    assert linear.error == pytest.approx(exact, rel=linear.doubt)
