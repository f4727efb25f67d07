"""Tables of displacements over time, measured or simulated, and the virtual vibrometer for simulated records."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..errors import finite, not_negative, positive
from ..files import MEGABYTE, refuse_endless, refuse_overflow, told_as_table, whole_file

if TYPE_CHECKING:
    from os import PathLike

    from numpy.typing import ArrayLike, NDArray

COLUMNS = ('time_s', 'particle', 'u_x_m', 'u_y_m')
MOST_BYTES = 1000 * MEGABYTE
"""Largest size of a table of displacements in bytes; a row of 100 particles over 10 000 frames has 50 MB."""
JITTER = 0.01
"""Largest deviation from equal time steps, as a fraction of a step; with ten samples per period it adds a background of -44
dB."""


@dataclass(frozen=True)
class Displacements:
    """Displacements of some particles at equal times.

    Attributes
    ----------
    times : ndarray, shape (frames,)
        In ms, in equal steps.
    particles : ndarray of int, shape (points,)
        Numbers of the particles, in the order of the row.
    displacements : ndarray, shape (frames, points, 2)
        In mm.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.waves import Displacements
    >>> record = Displacements(np.arange(5.0), np.array([3, 4]), np.zeros((5, 2, 2)))
    >>> record.displacements.shape  # frames, particles, x and y
    (5, 2, 2)
    """

    times: np.ndarray
    particles: np.ndarray
    displacements: np.ndarray

    @property
    def dt(self) -> float:
        """Time between frames in ms."""
        return (self.times[-1] - self.times[0]) / (len(self.times) - 1)

    def along(self, direction: ArrayLike) -> NDArray[np.float64]:
        """Component along a direction (need not be normalised), in mm, shape (frames, points)."""
        direction = finite('direction', direction, (2,))
        if not direction.any():
            raise ValueError(f'the direction must not be zero, not {direction}')
        return self.displacements @ (direction / np.linalg.norm(direction))


def measure(t: ArrayLike, u: ArrayLike, particles: ArrayLike, rate: float, noise: float = 0.0, seed: int = 0) -> Displacements:
    """A simulated record as a vibrometer sees it: at its own sampling rate, with its noise.

    Parameters
    ----------
    t : array_like, shape (frames,)
        Times of the record in ms, ascending, at least ten to a period: between them goes a cubic spline.
    u : array_like, shape (frames, points, 2)
        In mm.
    particles : array_like of int, shape (points,)
    rate : float
        Samples per ms (kHz).
    noise : float
        Standard deviation of each sample, mm; white.
    seed : int
        Seed of the noise.

    Returns
    -------
    Displacements

    Raises
    ------
    ValueError
        If the shapes do not belong together, or the record is shorter than two samples.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.waves import measure
    >>> t = np.arange(0, 100, 0.1)
    >>> u = np.zeros((len(t), 2, 2))
    >>> measure(t, u, [0, 1], rate=1.0, noise=1e-6).displacements.shape
    (100, 2, 2)
    """
    from scipy.interpolate import CubicSpline

    t, particles = finite('t', t), np.asarray(particles, dtype=int)
    u = finite('u', u, (len(t), len(particles), 2))
    rate, noise = positive('rate', rate, 'kHz'), not_negative('noise', noise, 'mm')
    samples = 1 + int((t[-1] - t[0]) * rate * (1 + 1e-12))
    if samples < 2:
        raise ValueError(f'the record lasts {t[-1] - t[0]:g} ms, less than one step of the sampling rate {rate:g} kHz')
    times = t[0] + np.arange(samples) / rate
    sampled = CubicSpline(t, u)(times)
    return Displacements(times, particles, sampled + noise * np.random.default_rng(seed).normal(size=sampled.shape))


MOTIONS_m = 1e-24, 1e3
"""Range of possible displacements, with a wide margin; the squares of others overflow."""


def write_displacements(path: str | PathLike[str], displacements: Displacements) -> None:
    """Write a table in SI, columns time_s, particle, u_x_m, u_y_m, to the last digit; whole or not at all.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from magphonon.waves import Displacements, read_displacements, write_displacements
    >>> file = tempfile.mkdtemp() + '/scan.csv'
    >>> write_displacements(file, Displacements(np.arange(5.0), np.array([3, 4]), np.full((5, 2, 2), 1e-3)))
    >>> read_displacements(file).particles
    array([3, 4])
    """
    t, u = displacements.times / units.s, displacements.displacements / units.m
    refuse_overflow(path, {'time_s': t, 'u_x_m and u_y_m': u})
    with whole_file(path) as file:
        print(*COLUMNS, sep=',', file=file)
        for k, time in enumerate(t):
            for particle, (x, y) in zip(displacements.particles, u[k], strict=True):
                print(float(time), int(particle), float(x), float(y), sep=',', file=file)


def read_displacements(path: str | PathLike[str], particles: ArrayLike | None = None) -> Displacements:
    """Read a table of displacements in SI: time_s, particle, u_x_m, u_y_m, one sample a row, rows in any order.

    Other columns, blank lines and lines that start with # are passed over.

    Parameters
    ----------
    path : path to a CSV file
    particles : sequence of int, optional
        The particles wanted, in the order of the row; by default all, in ascending order of their numbers.

    Returns
    -------
    Displacements

    Raises
    ------
    ValueError
        If a column, a number or a sample is missing, a sample is listed twice, or the times are not equally spaced.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from magphonon.waves import Displacements, read_displacements, write_displacements
    >>> file = tempfile.mkdtemp() + '/scan.csv'
    >>> write_displacements(file, Displacements(np.arange(5.0), np.array([3, 4]), np.full((5, 2, 2), 1e-3)))
    >>> read_displacements(file, particles=[4]).displacements.shape
    (5, 1, 2)
    """
    time, number, x, y = _columns(path)
    present = np.unique(number)
    wanted = present if particles is None else np.asarray(particles, dtype=int)
    if not len(wanted):
        raise ValueError(f'the row for {path} names no particle; name those wanted, or None for all')
    for particle in wanted[~np.isin(wanted, present)][:1]:
        raise ValueError(f'{path} holds no particle {particle}; it holds {_listed(present)}')
    samples = {particle: _in_order(path, particle, np.flatnonzero(number == particle), time) for particle in wanted}
    t = _equal_steps(path, *max(samples.items(), key=lambda item: len(item[1])), time)
    u = np.empty((len(t), len(wanted), 2))
    for k, particle in enumerate(wanted):
        rows = samples[particle]
        _refuse_gaps(path, particle, time[rows], t)
        u[:, k, 0], u[:, k, 1] = x[rows], y[rows]
    largest = abs(u).max()
    if largest and not MOTIONS_m[0] <= largest <= MOTIONS_m[1]:
        raise ValueError(f'{path}: the largest displacement is {largest:.3g} m, no motion of a lattice; check the unit and the '
                         'exponents of u_x_m and u_y_m')
    return Displacements(t * units.s, wanted, u * units.m)


def _columns(path):
    refuse_endless(path, MOST_BYTES)
    with open(path, encoding='utf-8-sig', newline='') as file, told_as_table(path):
        lines = ((n, line) for n, line in enumerate(file, 1) if line.strip() and not line.lstrip().startswith('#'))
        rows = ((n, next(csv.reader([line]))) for n, line in lines)
        header = [name.strip() for name in next(rows, (0, []))[1]]
        if not header:
            raise ValueError(f'{path} is empty; its first line must name {", ".join(COLUMNS)}, separated by commas')
        missing = [name for name in COLUMNS if name not in header]
        if missing:
            raise ValueError(f'{path} lacks the column {missing[0]} (its header is {",".join(header)!r}); '
                             f'the first line must name {", ".join(COLUMNS)}, separated by commas')
        at = [header.index(name) for name in COLUMNS]
        values = [_sample(path, n, row, header, at) for n, row in rows]
    if not values:
        raise ValueError(f'{path} holds no samples below its header')
    time, number, x, y = np.array(values).T
    return time, number.astype(int), x, y


def _sample(path, line, row, header, at):
    if len(row) != len(header):
        raise ValueError(f'line {line} of {path} has {len(row)} values, not {len(header)}; '
                         'it was cut off or holds a stray comma: complete or delete it')
    sample = []
    for k in at:
        try:
            value = float(row[k])
        except ValueError:
            value = np.nan
        if not np.isfinite(value) or (header[k] == 'particle' and not (value == int(value) and abs(value) < 2**53)):
            kind = 'a whole number' if header[k] == 'particle' else 'a finite number'
            raise ValueError(f'line {line} of {path}: {header[k]} is {row[k].strip()!r}, not {kind}')
        sample.append(value)
    return sample


def _in_order(path, particle, rows, time):
    """Rows of one particle, sorted by time."""
    rows = rows[np.argsort(time[rows], kind='stable')]
    for r in np.flatnonzero(np.diff(time[rows]) == 0)[:1]:
        raise ValueError(f'{path} lists particle {particle} at {time[rows[r]]:.9g} s twice; keep one of the samples')
    return rows


def _equal_steps(path, particle, rows, time):
    """The times of the record, from the particle with the most samples."""
    own = time[rows]
    if len(own) < 2:
        raise ValueError(f'{path} holds a single sample of particle {particle}; a wave needs a record over time')
    steps = np.diff(own)
    for k in np.flatnonzero(steps > 1.5 * np.median(steps))[:1]:
        raise ValueError(f'{path} lacks samples between {own[k]:.9g} and {own[k + 1]:.9g} s, where the step is {steps[k]:.3g} s '
                         f'instead of {np.median(steps):.3g} s; measure again, or cut the record there')
    return np.linspace(own[0], own[-1], len(own))


def _refuse_gaps(path, particle, own, t):
    """Raise unless the times of one particle are those of the record."""
    dt = t[1] - t[0]
    nearest = np.clip(np.rint((own - t[0]) / dt).astype(int), 0, len(t) - 1)
    absent = np.setdiff1d(np.arange(len(t)), nearest)
    jitter = abs(own - t[nearest]) / dt
    if jitter.max() > JITTER:
        k = jitter.argmax()
        raise ValueError(f'{path} samples particle {particle} at {own[k]:.9g} s, {jitter[k]:.2g} of a step of {dt:.3g} s '
                         f'off equal times (allowed {JITTER:g}); resample it to equal steps')
    if len(absent):
        raise ValueError(f'{path} lacks the sample of particle {particle} near {t[absent[0]]:.9g} s '
                         f'({len(absent)} of {len(t)} missing); measure again, or leave out the particle or the time')


def _listed(numbers):
    return f'{len(numbers)}, from {numbers[0]} to {numbers[-1]}' if len(numbers) > 5 else ', '.join(map(str, numbers))
