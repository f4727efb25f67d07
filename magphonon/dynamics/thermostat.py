"""Thermal noise of damped particles: exact half steps of the Ornstein-Uhlenbeck process.

Let E be the factor of a velocity after half a step of damping and gyration (a number for v_x + i v_y, or a matrix in space), and
xi independent normal numbers. Half a step is

    v <- E v + sqrt((1 - |E|^2) kT/m) xi

which keeps the Maxwell distribution for any time step.  Two half steps around a step of velocity Verlet solve Langevin's equation

    m u'' = F(u) - m gamma u' + sqrt(2 m gamma kT) xi(t)

whose positions have the distribution exp(-V/kT); for harmonic forces the time step changes the variance kT/k to kT/(k (1 - (w
dt)^2/4)). The random numbers depend only on the seed and the number of the step, so the noise is the same if a run is interrupted
and continued, and in every engine.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

DRAWN = 2**17  # about how many normal numbers are drawn at a time


class Bath:
    """The noise that half steps add to velocities, for kT in mJ and the decay E of each particle, complex if it gyrates."""

    def __init__(self, temperature: float, masses: NDArray[np.float64], decay: NDArray[np.float64], seed: int, dim: int) -> None:
        self.decay, self.seed, self.thermal = decay, seed, float(np.sqrt(temperature / masses.min()))
        left = abs(decay) ** 2 if decay.ndim == 1 else (decay**2).sum(axis=(1, 2)) / 3
        self._spread = np.sqrt((1 - left) * temperature / masses)[:, None]
        self._shape = max(1, DRAWN // (2 * len(masses) * dim)), 2, len(masses), dim
        self._part, self._drawn = -1, np.zeros(0)

    def kicks(self, step: int) -> NDArray[np.float64]:
        """Velocities in mm/ms that the half steps at the beginning and the end of a step add, shape (2, particles, dim)."""
        part, row = divmod(step, self._shape[0])
        if part != self._part:
            numbers = np.random.Generator(np.random.Philox(key=self.seed, counter=[0, 0, 0, part]))
            self._part, self._drawn = part, self._spread * numbers.normal(size=self._shape)
        return self._drawn[row]
