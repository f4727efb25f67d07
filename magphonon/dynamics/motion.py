"""Motion of some particles over time: a record from time steps, a linear solution, LAMMPS or a vibrometer."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import finite
from ..results import Saved

MOTION_UNITS = {'times': ('ms', 'times'), 'particles': ('', 'particles'), 'displacements': ('mm', 'times', 'particles', 'dim'),
                'velocities': ('mm/ms', 'times', 'particles', 'dim')}


@dataclass(frozen=True)
class Motion(Saved, kind='motions', units=MOTION_UNITS):
    """Record of the displacements of some particles over time, and of their velocities if known.

    Attributes
    ----------
    times : ndarray, shape (times,)
        In ms, ascending.
    particles : ndarray of int, shape (particles,)
        Indices of the particles; for a row, in its order.
    displacements : ndarray, shape (times, particles, dim)
        Displacements from rest, in mm.
    velocities : ndarray, shape (times, particles, dim), optional
        In mm/ms.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.dynamics import Motion
    >>> motion = Motion(np.arange(5.0), np.array([3, 4]), np.zeros((5, 2, 2)))
    >>> float(motion.dt), motion.along((0, 1)).shape
    (1.0, (5, 2))
    """

    times: np.ndarray
    particles: np.ndarray
    displacements: np.ndarray
    velocities: np.ndarray | None = None

    @property
    def dt(self) -> float:
        """Time between frames in ms, if they are equally spaced."""
        return (self.times[-1] - self.times[0]) / (len(self.times) - 1)

    def along(self, direction: ArrayLike) -> NDArray[np.float64]:
        """Displacements along a direction, which need not be normalised, in mm, shape (times, particles)."""
        direction = finite('direction', direction, self.displacements.shape[2:])
        if not direction.any():
            raise ValueError(f'the direction must not be zero, not {direction}')
        return self.displacements @ (direction / np.linalg.norm(direction))
