"""The rows of Figs. 7 and 9: that each of them can fail, and the decay that they expect."""

import numpy as np
import pytest

from magphonon import read_scene
from magphonon.dynamics.motion import Motion
from magphonon.scenes import ready_scene
from magphonon.waves.wave_analysis import waves
from magphonon.waves.wave_source import polarisations
from workflows.bursts import compared
from workflows.vibrometer import shaken, slowest

# Gamma-M of the ideal lattice, omega = omega_M sin(xi/2), rad/ms
OMEGA_M = {('complete', 'shear'): 0.141421356, ('conventional', 'shear'): 0.282842712,
           ('complete', 'longitudinal'): 0.469041576, ('conventional', 'longitudinal'): 0.489897949}
MOTION = {'shear': 'transverse', 'longitudinal': 'longitudinal'}


@pytest.mark.parametrize(('model', 'branch'), OMEGA_M)
def test_rows_pass_for_a_wave_on_the_branch_and_fail_for_any_other(model, branch, ideal):
    xi = 2.0
    t, n = 2.0 * np.arange(600)[:, None], np.arange(58)
    wave = np.cos(OMEGA_M[model, branch] * np.sin(xi / 2) * t - xi * n)
    record = Motion(t[:, 0], n, wave[..., None] * polarisations(ideal, 'row')[MOTION[branch]])
    (found,) = waves(record, ideal, 'row')
    verdicts = {case: [check.passed for check in compared('burst', found, MOTION[case[1]], *case)] for case in OMEGA_M}
    assert all(verdicts.pop((model, branch)))
    # here the conventional longitudinal wave lies 1.2 bins off the complete branch
    assert not any(all(rows) for rows in verdicts.values())


@pytest.mark.parametrize(('model', 'edge_Hz'), [('complete', 51.8276683282), ('conventional', 88.1962321315)])
def test_decay_of_the_row_is_the_closed_form(model, edge_Hz):
    """Shear without foundation ends at `edge` at M: omega^2 = cut-off^2 + (edge sin(xi/2))^2, with xi imaginary."""
    expected = 2 * np.arcsinh(np.sqrt(26.550686524**2 - 15**2) / edge_Hz)
    cell = read_scene(ready_scene('prototype')).atoms()
    assert slowest(cell, 'row', 'transverse', model) == pytest.approx(expected, rel=1e-8)  # the references carry 11 digits


@pytest.fixture(scope='module')
def small():
    """The prototype on a patch of a sixth of its area."""
    scene = read_scene(ready_scene('prototype'))
    return scene.model_copy(update={'patch': scene.patch.model_copy(update={'side_m': 0.12})})


@pytest.mark.parametrize(('source', 'force', 'motion'), [('point', (0, 1), 'longitudinal'), ('row', (1, 0), 'transverse')])
def test_amplitudes_in_the_gap_are_those_of_linear_response_without_a_window(source, force, motion, small):
    _, amplitudes = shaken(small, small.atoms(), source, force, motion)
    measured = amplitudes['measured'][:5]
    # what rings on past the end of the record, as in the workflow; modulus and phase, nothing is fitted
    np.testing.assert_allclose(measured, amplitudes['complete'][:5], rtol=5e-3)
    assert abs(measured / amplitudes['conventional'][:5] - 1).max() > 0.3  # the control
