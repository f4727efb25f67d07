"""Displacements of a run, frame by frame, in bounded memory."""

from __future__ import annotations

import os
from contextlib import suppress
from hashlib import sha256
from tempfile import SpooledTemporaryFile, gettempdir
from typing import TYPE_CHECKING
from weakref import finalize

import numpy as np

from ..errors import whole
from ..files import room_for, save_arrays
from .motion import Motion

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike

    from numpy.typing import ArrayLike, NDArray

    from .verlet import DrivenVerlet

MEMORY = 2**26
"""Number of bytes of frames kept in memory; more frames go to a temporary file."""
PIECE = 2**22
"""Number of bytes read at a time for the checksum of the frames."""


class Recorder:
    """Observer that keeps the displacements of particles, in float64, as exact as the engine has them.

    Parameters
    ----------
    dyn : DrivenVerlet
        The recorder attaches itself.
    particles : array_like of int, optional
        All of them if not given.
    interval : int
        Steps between two frames.

    Examples
    --------
    >>> from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Recorder, lattices
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
        self.particles = np.arange(count) if particles is None else np.atleast_1d(particles)
        if not (np.issubdtype(self.particles.dtype, np.integer) and self.particles.min(initial=0) >= 0
                and self.particles.max(initial=0) < count):
            raise ValueError(f'particles to record must be indices from 0 to {count - 1}, not {particles!r}')
        self._frames = []  # their times
        self._shape = len(self.particles), dyn.displacements.shape[1]
        self._sum = None  # of the frames in a file beside a checkpoint
        self._open(SpooledTemporaryFile(MEMORY), gettempdir())  # noqa: SIM115  open as long as the recorder
        dyn.recorders.append(self)
        dyn.attach(self, self.interval)

    def _open(self, file, place):
        self._file, self._place = file, place
        finalize(self, _close, file)

    def __call__(self) -> None:
        frame = self._dyn.displacements[self.particles].tobytes()
        with room_for(self._place):
            self._file.write(frame)
        if self._sum is not None:
            self._sum.update(frame)
        self._frames.append(self._dyn.get_time())

    @property
    def times(self) -> NDArray[np.float64]:
        """Times of the frames in ms, shape (frames,)."""
        return np.array(self._frames)

    @property
    def displacements(self) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (frames, particles, dim); a read-only map of the file if they are many."""
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
        """What is recorded so far."""
        return Motion(self.times, self.particles, self.displacements)

    def save(self, path: str | PathLike[str]) -> None:
        """Write `times` (ms), `displacements` (mm) and `particles` to a .npz file, whole or not at all."""
        save_arrays(path, {'times': self.times, 'displacements': self.displacements, 'particles': self.particles},
                    {'times': ('ms', 'frames'), 'displacements': ('mm', 'frames', 'particles', 'dim'),
                     'particles': ('', 'particles')})

    def forget_after(self, time: float) -> None:
        """Drop the frames later than `time` (ms), those of a run that has gone wrong."""
        self._cut(int(np.searchsorted(self._frames, time, side='right')))

    def _cut(self, frames):
        size = 8 * int(np.prod(self._shape)) * frames
        self._file.flush()
        self._file.truncate(size)
        if self._sum is not None:
            self._sum = self._checksum(size)
        self._file.seek(size)
        del self._frames[frames:]

    def _checksum(self, size):
        """Checksum of the first `size` bytes of frames; reading takes about a second for each GB."""
        total = sha256()
        self._file.seek(0)
        while size and (piece := self._file.read(min(PIECE, size))):
            total.update(piece)
            size -= len(piece)
        return total

    def keep_at(self, path: str | PathLike[str], times: Sequence[float] | NDArray[np.float64] | None = None,
                checksum: str | None = None) -> None:
        """Keep the frames in a file from now on; with `times`, go on after that many frames which are there already.

        Raises
        ------
        ValueError
            If the file is shorter than that, or its frames are not those of the `checksum`; it is left as it is.
        """
        if times is None:
            frames = self.displacements.tobytes()
            self._open(open(path, 'w+b'), path)  # noqa: SIM115
            self._file.write(frames)
            self._sum = sha256(frames)
            return
        size = 8 * int(np.prod(self._shape)) * len(times)
        if not os.path.exists(path) or os.path.getsize(path) < size:
            raise ValueError(f'{path} does not hold the {len(times)} frames of its checkpoint; delete both and start again')
        self._open(open(path, 'r+b'), path)  # noqa: SIM115
        self._sum = self._checksum(size)
        if self._sum.hexdigest() != checksum:
            raise ValueError(f'the frames in {path} are not those that were written with its checkpoint; '
                             'delete both and start again')
        self._frames = list(times)
        self._file.truncate(size)  # frames later than the checkpoint are computed again
        self._file.seek(size)

    def keep(self) -> tuple[NDArray[np.float64], str]:
        """Make sure that the frames are on the disk; returns their times and their checksum."""
        with room_for(self._place):
            self._file.flush()
            os.fsync(self._file.fileno())
        return self.times, self._sum.hexdigest()


def _close(file):
    with suppress(OSError):  # what a full disk has not taken was reported when it was written
        file.close()
