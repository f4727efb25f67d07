"""The virtual vibrometer: a simulated record as an instrument would have measured it."""

from __future__ import annotations

import numpy as np

from ..dynamics.motion import Motion
from ..errors import finite, not_negative, positive


def sampled(motion: Motion, rate: float, noise: float = 0.0, seed: int = 0) -> Motion:
    """A simulated motion as a vibrometer records it, with its own sampling rate and noise; only displacements are returned.

    Parameters
    ----------
    motion : Motion
        With at least ten frames per period, because it is interpolated by a cubic spline.
    rate : float
        Samples per ms (kHz).
    noise : float
        Standard deviation of each sample, mm; white.
    seed : int
        Seed of the noise.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.dynamics import Motion
    >>> from magphonon.waves import sampled
    >>> still = Motion(np.arange(0, 100, 0.1), np.array([0, 1]), np.zeros((1000, 2, 2)))
    >>> sampled(still, rate=1.0, noise=1e-6).displacements.shape
    (100, 2, 2)
    """
    from scipy.interpolate import CubicSpline

    t, u = finite('times', motion.times), finite('displacements', motion.displacements)
    rate, noise = positive('rate', rate, 'kHz'), not_negative('noise', noise, 'mm')
    samples = 1 + int((t[-1] - t[0]) * rate * (1 + 1e-12))
    if samples < 2:
        raise ValueError(f'the record lasts {t[-1] - t[0]:g} ms, less than one step of the sampling rate {rate:g} kHz')
    times = t[0] + np.arange(samples) / rate
    u = CubicSpline(t, u)(times)
    return Motion(times, motion.particles, u + noise * np.random.default_rng(seed).normal(size=u.shape))
