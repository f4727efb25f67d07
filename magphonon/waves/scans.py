"""Scans of a real instrument: points of its own numbering, some missing or dead, displacements or velocities, as one record.

Samples that a record lacks, from the others: motion has a band, and more samples than it needs tell those that are missing.

With the orthonormal cosines c_k of the record (DCT-II, which no offset or drift spoils) let B project on those below a limit K.
The missing samples m that leave least outside the band are

    u_m = (1 - B_mm)^-1 (B u_0)_m                    u_0: the record with zeros where it lacks samples

The variance of each about the motion is then e^2 (1 - B_mm)^-1 + s^2 ((1 - B_mm)^-1 - 1) for white noise of variance s^2 and a
motion that has the mean square e^2 outside the band.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from .spectrum import ROUND_OFF, without_drift

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from numpy.typing import NDArray

LIMITS = 32
"""Number of limits of the band that are tried; the one with the smallest error is taken."""
SINGULAR = 1e9
"""Variance of a missing sample, in that of a measured one, from which round-off tells more of it than the record."""
WIDEST = 0.9
"""Widest band, as a fraction of that of the record: what lies above tells the noise."""


def filled(values: NDArray[np.float64], missing: NDArray[np.intp]) -> tuple[NDArray[np.float64], float, float]:
    """A record with its missing samples.

    Parameters
    ----------
    values : ndarray, shape (frames,)
        Anything finite where samples are missing, best a first guess, which only serves to find the band.
    missing : ndarray of int, shape (samples,)

    Returns
    -------
    values : ndarray, shape (frames,)
    error : float
        Root mean square error that is to be expected of the worst of them.
    noise : float
        That of the measured samples, from the upper quarter of the frequencies.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.waves.scans import filled
    >>> t = np.arange(400)
    >>> u = np.sin(2 * np.pi * t / 7) * np.sin(np.pi * t / 400) ** 2  # seven samples to a period
    >>> missing = np.array([150, 151, 230])
    >>> found, error, _ = filled(np.where(np.isin(t, missing), 0, u), missing)
    >>> bool(abs(found - u).max() < 1e-3)
    True
    """
    from scipy.fft import dct
    from scipy.linalg import cho_factor, cho_solve

    n, gappy = len(values), values.copy()
    gappy[missing] = 0
    power, inside = np.asarray(dct(values, norm='ortho')) ** 2, np.asarray(dct(gappy, norm='ortho'))
    cosines = np.cos(np.pi * np.arange(n)[:, None] * (missing + 0.5) / n) * np.sqrt(2 / n)
    cosines[0] /= np.sqrt(2)
    noise = float(np.sqrt(power[3 * n // 4 :].mean()))
    total = power.sum() or 1.0  # a component that does not move has no power at all
    best, error, left, before = values, np.inf, np.eye(len(missing)), 0
    for K in np.unique(np.linspace(1, WIDEST * n, LIMITS).astype(int)):
        left -= cosines[before:K].T @ cosines[before:K]
        before = K
        try:
            factor = cho_factor(left)
        except np.linalg.LinAlgError:
            break
        worst = cho_solve(factor, np.eye(len(missing))).diagonal().max()
        if worst > SINGULAR or noise**2 * (worst - 1) >= error**2:  # it grows with K: a wider band is no better
            break
        outside = max(power[K:].sum() - (n - K) * noise**2, 0) / total * abs(values).max() ** 2  # where it is strongest
        own = float(np.sqrt(outside * worst + noise**2 * (worst - 1)))
        if own < error:
            error, best = own, gappy.copy()
            best[missing] = cho_solve(factor, cosines[:K].T @ inside[:K])
    return best, error, noise


JITTER = 0.01
"""Largest deviation from equal time steps, as a fraction of a step; with ten samples per period it adds a background of -44
dB."""
MOTIONS_m = 1e-24, 1e3
"""Range of possible displacements, with a wide margin; the squares of others overflow."""
LEAST_TIME = 0.9
"""Part of the longest record that a point must have, to be used."""
STRONG = 1e-2
"""Power of a frequency, as a fraction of the strongest, that counts as motion of the row (-20 dB, as for ridges)."""
NOISY = 3.0
"""Largest error of an interpolated sample, in the noise of a measured one, if that is more than RESAMPLED of the motion: one
sample of fifty that is so uncertain adds a fifth to the power of the noise."""
RESAMPLED = 1e-2
"""Largest error of a spline between samples, as a fraction of the motion; it is (omega h)^4/384 for the step h, so that this asks
for 4.5 samples to a period."""


@dataclass(frozen=True)
class Samples:
    """What one point of a scan measured.

    Attributes
    ----------
    times : ndarray, shape (samples,)
        In ms.
    motions : dict of str to ndarray, shape (samples,)
        By component, 'x', 'y', 'z' or '' for an unknown direction: displacements in mm or velocities in mm/ms; NaN where blank.
    place : tuple of float, optional
        x and y in mm.
    """

    times: np.ndarray
    motions: dict[str, np.ndarray]
    place: tuple[float, float] | None = None


@dataclass(frozen=True)
class Scan:
    """Displacements of some points at equal times.

    Attributes
    ----------
    times : ndarray, shape (frames,)
        In ms, in equal steps.
    names : tuple of str
        The points, as the instrument numbers them.
    places : ndarray, shape (points, 2), or None
        In mm.
    motions : dict of str to ndarray, shape (frames, points)
        Displacements in mm by component, 'x', 'y', 'z' or '' for an unknown direction.
    notes : tuple of str
        What was done to the record, in words.
    """

    times: np.ndarray
    names: tuple[str, ...]
    places: np.ndarray | None
    motions: dict[str, np.ndarray]
    notes: tuple[str, ...] = ()

    @property
    def dt(self) -> float:
        """Time between frames in ms."""
        return (self.times[-1] - self.times[0]) / (len(self.times) - 1)

    def placed(self, places: Mapping[str, tuple[float, float]]) -> Scan:
        """The points of which `places` tells x and y in mm, by name; the others are left out.

        Raises
        ------
        ValueError
            If there are none.
        """
        kept = [k for k, name in enumerate(self.names) if name in places]
        if not kept:
            raise ValueError(f'of the points {_listed(self.names)} no place is known; places are those of the points '
                             f'{_listed(list(places))}')
        names = tuple(self.names[k] for k in kept)
        motions = {part: u[:, kept] for part, u in self.motions.items()}
        left_out = [name for name in self.names if name not in places]
        notes = (*self.notes, *([f'left out, as their places are unknown: points {_listed(left_out)}'] if left_out else []))
        return Scan(self.times, names, np.array([places[name] for name in names]), motions, notes)


def assembled(path: object, points: Mapping[str, Samples], velocities: bool) -> Scan:
    """One record of all points that moved: at equal times, as displacements.

    Parameters
    ----------
    path : path-like
        For messages.
    points : dict of str to Samples
        By the name of the point; all have the same components.
    velocities : bool
        Whether the motions are velocities; they are integrated.

    Returns
    -------
    Scan

    Raises
    ------
    ValueError
        If there is no motion, or the samples are too far apart in time for it.
    """
    notes = []
    points = {name: _without_blanks(path, name, point) for name, point in points.items()}
    points = _alive(points, notes)
    times = _equal_times(path, points.values())
    points, motions = _without_gaps(path, times, points, notes)
    if velocities:
        motions = {part: integrated(v, times[1] - times[0]) for part, v in motions.items()}
        notes.append('velocities were integrated over time, in the frequency domain')
    largest = max(abs(u).max() for u in motions.values()) / units.m
    if largest and not MOTIONS_m[0] <= largest <= MOTIONS_m[1]:
        raise ValueError(f'{path}: the largest displacement is {largest:.3g} m, no motion of a lattice; check the unit in the '
                         'header and the exponents of the values')
    places = [point.place for point in points.values()]
    return Scan(times, tuple(points), None if None in places else np.array(places), motions, tuple(notes))


def integrated(velocities: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Displacements of velocities, shape (frames, points), about zero mean.

    Each frequency is divided by i omega.  A mean velocity would be a steady drift, and is left out.

    Parameters
    ----------
    velocities : ndarray, shape (frames, points)
        In mm/ms, at equal times.
    dt : float
        In ms.

    Returns
    -------
    ndarray, shape (frames, points)
        In mm.
    """
    V = np.fft.rfft(velocities, axis=0)
    omega = 2 * np.pi * np.fft.rfftfreq(len(velocities), dt)[1:, None]
    return np.fft.irfft(np.concatenate([0 * V[:1], V[1:] / (1j * omega)]), len(velocities), axis=0)


def _without_blanks(path, name, point):
    """The samples of a point that have a value in every component, in the order of their times."""
    whole = np.isfinite(list(point.motions.values())).all(axis=0)
    order = np.flatnonzero(whole)[np.argsort(point.times[whole], kind='stable')]
    t = point.times[order]
    for k in np.flatnonzero(np.diff(t) == 0)[:1]:
        raise ValueError(f'{path} lists point {name} at {t[k] / units.s:.9g} s twice; keep one of the samples')
    return Samples(t, {part: values[order] for part, values in point.motions.items()}, point.place)


def _alive(points: Mapping[str, Samples], notes: list[str]) -> dict[str, Samples]:
    """The points that were recorded and moved; what is left out is noted."""
    recorded = {name: np.ptp(point.times) if len(point.times) else 0.0 for name, point in points.items()}
    longest = max(recorded.values())
    short = [name for name, length in recorded.items() if length < LEAST_TIME * longest]
    still = [name for name, point in points.items() if name not in short and not any(map(_moves, point.motions.values()))]
    if short:
        notes.append(f'left out, as they miss more than {100 * (1 - LEAST_TIME):.0f} % of the record: points {_listed(short)}')
    kept = {name: point for name, point in points.items() if name not in short}
    if not still or len(still) == len(kept):  # a row at rest is refused by the map
        return kept
    notes.append(f'left out, as they do not move (dead): points {_listed(still)}')
    return {name: point for name, point in kept.items() if name not in still}


def _moves(values):
    return np.ptp(values) > ROUND_OFF * abs(values).max()


def _equal_times(path, points: Collection[Samples]) -> NDArray[np.float64]:
    """Equal times within all records, at the usual step."""
    steps = np.concatenate([np.diff(point.times) for point in points])
    if not len(steps):
        raise ValueError(f'{path} holds a single sample of each point; a wave needs a record over time')
    dt = steps[steps < 1.5 * np.median(steps)].mean()
    first, last = max(point.times[0] for point in points), min(point.times[-1] for point in points)
    frames = int((last - first) / dt + 2 * JITTER) + 1
    if frames < 2:
        raise ValueError(f'{path}: its points were not recorded at the same times, counted from the trigger; export all records '
                         'with the same start')
    if frames > 2 * max(len(point.times) for point in points):
        raise ValueError(f'{path} lacks most samples: its record lasts {(last - first) / units.s:.4g} s at steps of '
                         f'{dt / units.s:.3g} s; check the times, or cut the record at the gap')
    return first + dt * np.arange(frames)


def _without_gaps(path, times, points: Mapping[str, Samples], notes: list[str]):
    """The points at these times, without those that lack too much, and their motions by component, (frames, points)."""
    found = {name: _at(times, point) for name, point in points.items()}
    bad = [name for name, one in found.items() if one.error > 1]
    if len(bad) == len(points):
        raise ValueError(f'{path}: all of its points lack so many samples that interpolation is no better than the noise; export '
                         'the record without gaps, or sample faster')
    if bad:
        notes.append(f'left out, as they lack more samples than the others tell: points {_listed(bad)}')
    found = {name: one for name, one in found.items() if name not in bad}
    some = next(iter(found.values())).motions
    motions = {part: np.stack([one.motions[part] for one in found.values()], axis=1) for part in some}
    if lacking := [one for one in found.values() if one.missing]:
        worst = max(one.error * one.allowed for one in lacking)
        notes.append(f'{sum(one.missing for one in lacking)} missing samples of {len(lacking)} points are interpolated within '
                     f'the band of the motion, with an error of up to {100 * worst:.2g} % of the largest displacement')
    if splined := [name for name, one in found.items() if one.splined]:
        _refuse_coarse(path, times, motions, max(np.diff(points[name].times).max() for name in splined))
        notes.append(f'{len(splined)} of {len(found)} points were not sampled at equal times: resampled by a cubic spline to '
                     f'steps of {(times[1] - times[0]) / units.s:.4g} s')
    return {name: points[name] for name in found}, motions


@dataclass(frozen=True)
class _AtTimes:
    """Motions of a point at equal times; how many samples are filled in, their error in units of the largest `allowed` one."""

    motions: dict[str, np.ndarray]
    missing: int = 0
    error: float = 0.0
    allowed: float = 0.0
    splined: bool = False


def _at(times, point):
    """The motions of a point at these times: measured, filled in between, or resampled."""
    from scipy.interpolate import CubicSpline

    dt = times[1] - times[0]
    k = np.clip(np.searchsorted(point.times, times - dt / 2), 0, len(point.times) - 1)
    there = abs(point.times[k] - times) <= JITTER * dt
    if there.all():
        return _AtTimes({part: values[k] for part, values in point.motions.items()})
    guess = {part: CubicSpline(point.times, values)(times) for part, values in point.motions.items()}
    place = (point.times - times[0]) / dt
    if abs(place - np.rint(place)).max() > 2 * JITTER:  # no gaps, but other times
        return _AtTimes(guess, splined=True)
    largest, motions, error, allowed = max(abs(u).max() for u in point.motions.values()), {}, 0.0, 0.0
    for part, values in guess.items():
        values[there] = point.motions[part][k[there]]
        motions[part], own, noise = filled(values, np.flatnonzero(~there))
        limit = max(RESAMPLED * largest, NOISY * noise)
        if own / limit >= error:
            error, allowed = own / limit, limit / largest
    return _AtTimes(motions, int((~there).sum()), error, allowed)


def _refuse_coarse(path, times, motions, step):
    """Raise ValueError if a spline over this time step may miss the motion between samples."""
    dt = times[1] - times[0]
    window = np.sin(np.pi * (np.arange(len(times)) + 0.5) / len(times))[:, None] ** 2
    power = np.sum([abs(np.fft.rfft(window * without_drift(u), axis=0)) ** 2 for u in motions.values()], axis=(0, 2))
    fastest = 2 * np.pi * np.fft.rfftfreq(len(times), dt)[power >= STRONG * power.max()].max()
    if (fastest * step) ** 4 / 384 > RESAMPLED:
        most = (384 * RESAMPLED) ** 0.25 / fastest
        raise ValueError(f'{path}: its times are not equally spaced, and cannot be resampled: a gap of {step / units.s:.4g} s is '
                         f'too long for motion at {units.hertz(fastest):.4g} Hz (allowed {most / units.s:.3g} s); leave the '
                         'point or the part of the record with the gap out, or sample faster')


def _listed(names):
    return ', '.join(names[:8]) + (f' and {len(names) - 8} more' if len(names) > 8 else '')
