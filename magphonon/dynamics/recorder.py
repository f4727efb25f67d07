"""Displacements of a run, frame by frame, in bounded memory."""

from __future__ import annotations

from contextlib import suppress
from tempfile import SpooledTemporaryFile, gettempdir
from typing import TYPE_CHECKING
from weakref import finalize

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..errors import indices, whole
from ..files import room_for
from .motion import Motion

if TYPE_CHECKING:
    from .verlet import DrivenVerlet

MEMORY = 2**26  # number of bytes of frames kept in memory; more frames go to a temporary file


class Recorder:
    """Observer that keeps the displacements of particles in float64, with the full precision of the engine.

    Parameters
    ----------
    dyn : DrivenVerlet
        The run to record; the recorder attaches itself to it.
    particles : array_like of int, optional
        Indices of the recorded particles; by default all.
    interval : int
        Steps between two frames.

    Examples
    --------
    >>> from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
    >>> from magphonon.dynamics import Recorder
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 4.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> dyn = DrivenVerlet(patch, 0.05)
    >>> recorder = Recorder(dyn, [30, 31], interval=10)
    >>> dyn.run(100)
    True
    >>> recorder.displacements.shape  # frames, particles, x and y
    (11, 2, 2)
    """

    def __init__(self, dyn: DrivenVerlet, particles: ArrayLike | None = None, interval: int = 10) -> None:
        self._dyn, self.interval = dyn, whole('interval', interval)
        count = len(dyn.atoms)
        self.particles = np.arange(count) if particles is None else indices('particles to record', particles, count)
        self._frames = []  # their times
        self._shape = len(self.particles), dyn.displacements.shape[1]
        self._file = SpooledTemporaryFile(MEMORY)  # noqa: SIM115  open as long as the recorder
        finalize(self, _close, self._file)
        dyn.recorders.append(self)
        dyn.attach(self, self.interval)

    def __call__(self) -> None:
        with room_for(gettempdir()):
            self._file.write(self._dyn.displacements[self.particles].tobytes())
        self._frames.append(self._dyn.get_time())

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames in ms, shape (frames,)."""
        return np.array(self._frames)

    @property
    def displacements(self) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (frames, particles, dim); if they are many, a read-only memory map."""
        shape = len(self._frames), *self._shape
        if not np.prod(shape):
            return np.zeros(shape)
        self._file.flush()
        if 8 * np.prod(shape) > MEMORY:
            return np.memmap(self._file, dtype=float, mode='r', shape=shape)
        self._file.seek(0)
        return np.frombuffer(self._file.read()).reshape(shape)

    @property
    def motion(self) -> Motion:
        """The record so far, as a Motion, which `save` writes to a file."""
        return Motion(self.times, self.particles, self.displacements)

    def forget_after(self, time: float) -> None:
        """Drop the frames later than `time` (ms), for example after a run has diverged."""
        frames = int(np.searchsorted(self._frames, time, side='right'))
        size = 8 * int(np.prod(self._shape)) * frames
        self._file.flush()
        self._file.truncate(size)
        self._file.seek(size)
        del self._frames[frames:]


def _close(file):
    with suppress(OSError):  # what a full disk has not taken was reported when it was written
        file.close()
