"""Simulated records as a vibrometer sees them, and as a table that is read again."""

import numpy as np
import pytest

from magphonon.dynamics.motion import Motion
from magphonon.waves.scans import sampled


def test_component_along_a_direction():
    u = np.random.default_rng(1).normal(size=(6, 3, 2))
    motion = Motion(np.arange(6.0), np.arange(3), u)
    np.testing.assert_allclose(motion.along((3, 4)), 0.6 * u[..., 0] + 0.8 * u[..., 1])
    for direction, message in (((0, 0), 'must not be zero'), ((1, 0, 0), r'shape \(2,\)')):
        with pytest.raises(ValueError, match=message):
            motion.along(direction)


def test_vibrometer_samples_at_its_own_rate():
    t = 5 + 0.1 * np.arange(400)
    moved = lambda t: np.stack([np.sin(2 * t), np.cos(3 * t)], axis=-1)[:, None]  # noqa: E731, a formula
    d = sampled(Motion(t, np.array([4]), moved(t)), rate=2.3)
    np.testing.assert_allclose(np.diff(d.times), 1 / 2.3)
    assert d.times[0] == 5
    assert t[-1] - d.times[-1] < 1 / 2.3
    # a cubic spline with 21 points to a period: (w h)^4/384 within, a few times that at its ends
    np.testing.assert_allclose(d.displacements, moved(d.times), rtol=0, atol=2e-4)


def test_noise_has_its_size_and_its_seed():
    still = Motion(np.arange(1000.0), np.arange(5), np.zeros((1000, 5, 2)))
    d = sampled(still, rate=1.0, noise=3e-5, seed=8)
    assert d.displacements.std() == pytest.approx(3e-5, rel=0.03)  # 10 000 samples: 0.7 %
    np.testing.assert_array_equal(d.displacements, sampled(still, rate=1.0, noise=3e-5, seed=8).displacements)
    assert (d.displacements != sampled(still, rate=1.0, noise=3e-5, seed=9).displacements).all()
    assert not sampled(still, rate=1.0).displacements.any()
