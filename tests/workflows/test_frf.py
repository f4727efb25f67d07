"""The batch of oscillators behind Fig. 2, smaller and coarser: both models, and the angle that runs away."""

import numpy as np
import pytest

from magphonon import units
from magphonon.dynamics.cages import Diverged
from workflows.frf import DAMPING, SPARSE, respond

# Sec. III of the paper: vertical stiffness in N/m at theta0 = 0, pi/6, pi/4, pi/2, with D* and without
THETA0 = np.pi * np.array([0, 1 / 6, 1 / 4, 1 / 2])
STIFFNESS = {'complete': [2e4, 4.5e4, 7e4, 12e4], 'conventional': [4e4, 6e4, 8e4, 12e4]}
OMEGA = np.arange(100, 401, 12.5) * units.rad / units.s
DT, STEADY = 0.2, 3e-4


def receptance(model):
    """One degree of freedom, 1/(k - m w^2 + i m gamma w) in mm/N, shape (frequencies, angles)."""
    k, m, w = np.array(STIFFNESS[model]) * units.N / units.m, 1 * units.kg, OMEGA[:, None]
    return 1 / (k - m * w**2 + 1j * m * DAMPING * w)


@pytest.mark.slow
@pytest.mark.parametrize('model', STIFFNESS)
def test_batch_is_as_many_single_oscillators(model):
    guided, free, impulse = respond(THETA0, OMEGA, model, DT, STEADY)
    expected = receptance(model)
    omega_0 = np.sqrt(np.array(STIFFNESS[model]) / 1e6)
    # Verlet moves a resonance by w_0 (w_0 dt)^2/24, which the half width gamma/2 turns into an error of this size
    shift = omega_0 * (omega_0 * DT) ** 2 / 24 / (DAMPING / 2)
    for found in (guided, impulse.response):  # what is left of the impulse counts up to six times off resonance
        assert (abs(found / expected - 1).max(axis=0) < 1.1 * shift + 6 * STEADY).all()
    assert abs(free / expected[::SPARSE, :3] - 1).max() < 1.1 * shift[2] + 6 * STEADY
    other = receptance({'complete': 'conventional', 'conventional': 'complete'}[model])
    assert (abs(guided / other - 1).max(axis=0)[:3] > 0.5).all()


def test_magnet_between_magnets_runs_away_without_its_line():
    with pytest.raises(Diverged):
        respond(THETA0[[3, 3]], OMEGA[:4], dt=DT)
