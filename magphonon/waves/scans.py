"""Scans of a real instrument: points with its own numbering, some missing or dead, displacements or velocities, made into one
record.

Missing samples, and samples at unequal times, are interpolated by a spline through the samples of the same point, unless the
gap is too long.  The error of this spline is measured, not assumed: the same interpolation, at the same times, is applied to two
known signals, a wave of the highest frequency in the record and white noise.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..dynamics.motion import Motion
from ..errors import finite, not_negative, positive
from .spectrum import ROUND_OFF, without_drift

JITTER = 0.01
"""Largest deviation from equal time steps, as a fraction of a step; with ten samples per period it adds a background of -44
dB."""
MOTIONS_m = 1e-24, 1e3  # range of possible displacements, with a wide margin; the squares of others overflow
LEAST_TIME = 0.9  # part of the longest record that a point must have, to be used
STRONG = 1e-2  # power of a frequency, as a fraction of the strongest, that counts as motion of the row (-20 dB, as for ridges)
RESAMPLED, NOISY = 1e-2, 3.0
"""Largest error of an interpolated sample: a fraction of the motion or a multiple of the noise of a measured sample, whichever
is larger. If one sample of fifty has this error, the power of the noise grows by a fifth."""
FOLLOWED = 0.1
"""Largest error of the fastest wave by itself, however large the noise: motion up to the end of the band looks like noise."""
HELD, ABRUPT = 3, 8.0
"""A clipped signal stays at its largest value for HELD samples in a row, and reaches it by a jump of at least ABRUPT smallest
steps; of smooth peaks that are equally flat, at most one in five does."""
MAINS_Hz, MAINS_TIME, MAINS_PARTS, MAINS_STEADY = (50, 60, 100, 120), 0.1 * units.s, 4, 0.9
"""Frequencies of a hum, a time with whole periods of all, the smallest number of such times, and the smallest share of constant
phase."""
DEGREES = 3, 5, 7  # degrees of the splines that are tried: a higher one follows faster motion, and carries more noise into a gap
NOISES = 32  # number of records of white noise by which it is seen how much of it a spline carries


@dataclass(frozen=True)
class Samples:
    """Samples that one point of a scan measured."""

    times: np.ndarray  # shape (samples,): in ms
    # shape (samples,): by component, 'x', 'y', 'z' or '' for an unknown direction: displacements in mm or velocities in mm/ms;
    # NaN where blank
    motions: dict[str, np.ndarray]
    place: tuple[float, float] | None = None  # x and y in mm

    @property
    def duration(self) -> float:
        """Time from the first sample to the last one in ms."""
        return float(np.ptp(self.times)) if len(self.times) else 0.0


@dataclass(frozen=True)
class Scan:
    """Displacements of some points at equal times.

    Attributes
    ----------
    times : ndarray, shape (frames,)
        In ms, in equal steps.
    names : tuple of str
        Names of the points, such as the numbers that the instrument gave them.
    places : ndarray, shape (points, 2), or None
        Positions of the points in mm.
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
        """The scan with positions in mm from `places`, by name; points that `places` lacks are left out."""
        kept = [k for k, name in enumerate(self.names) if name in places]
        if not kept:
            raise ValueError(f'the positions of the points {_listed(self.names)} are missing; only those of the points '
                             f'{_listed(list(places))} are known')
        names = tuple(self.names[k] for k in kept)
        motions = {part: u[:, kept] for part, u in self.motions.items()}
        left_out = [name for name in self.names if name not in places]
        notes = (*self.notes, *([f'points of unknown position are left out: {_listed(left_out)}'] if left_out else []))
        return Scan(self.times, names, np.array([places[name] for name in names]), motions, notes)


def assembled(path: object, points: Mapping[str, Samples], velocities: bool) -> Scan:
    """Make one record of all points that moved: displacements at equal times.

    All `points`, by their names, have the same components; velocities are integrated.  Messages name the path.
    """
    notes = []
    points = {name: _without_blanks(path, name, point) for name, point in points.items()}
    points = _alive(path, points, notes)
    clipped = {name: at for name, point in points.items() if (at := _clipped(point)).any()}
    _refuse_absurd(path, [u for point in points.values() for u in point.motions.values()])  # before it overflows
    times = _equal_times(path, points.values())
    points, motions = _at_equal_times(path, times, _unclipped(path, times, points, clipped, notes), notes)
    notes += _hum(motions, times[1] - times[0])
    if velocities:
        motions = {part: integrated(v, times[1] - times[0]) for part, v in motions.items()}
        notes.append('velocities were integrated over time, in the frequency domain')
    _refuse_absurd(path, motions.values())
    places = [point.place for point in points.values()]
    return Scan(times, tuple(points), None if None in places else np.array(places), motions, tuple(notes))


def _refuse_absurd(path, motions):
    largest = max(abs(u).max() for u in motions) / units.m
    if largest and not MOTIONS_m[0] <= largest <= MOTIONS_m[1]:
        raise ValueError(f'{path}: the largest motion is {largest:.3g} m (or m/ms), impossible in a lattice; check the unit '
                         'in the header and the exponents of the values')


def integrated(velocities: NDArray[np.float64], dt: float) -> NDArray[np.float64]:
    """Displacements in mm, with zero mean, from velocities in mm/ms at equal times; both of shape (frames, points).

    Each frequency is divided by i omega.  The mean velocity, a steady drift, is left out.
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


def _clipped(point):
    """Mask of clipped samples: they stay at the largest or smallest value, and reach it by a jump, not in small steps."""
    held = np.zeros(len(point.times), bool)
    for u in point.motions.values():
        found, step, top = 0, np.diff(np.unique(u)).min(initial=np.inf), np.zeros(len(u), bool)  # of an instrument of few digits
        for end in (u.max(initial=-np.inf), u.min(initial=np.inf)):
            edges = np.diff(np.concatenate([[0], u == end, [0]]))
            starts, ends = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)
            found += np.sum((ends - starts >= HELD) & (abs(u[np.maximum(starts - 1, 0)] - end) > ABRUPT * step))
            top |= u == end
        held |= top & (found > 1)
    return held


def _unclipped(path, times, points, clipped, notes):
    """The points without their clipped samples, to be interpolated like missing ones; unchanged if these are too many."""
    if not clipped:
        return points
    within = {name: at & (np.arange(len(at)) % (len(at) - 1) > 0) for name, at in clipped.items()}  # first and last stay
    kept = {name: point if name not in clipped else Samples(point.times[~within[name]], {
        part: u[~within[name]] for part, u in point.motions.items()}, point.place) for name, point in points.items()}
    told = f'clipped: points {_listed(list(clipped))} stay at their largest value for some samples, again and again; '
    try:
        _at_equal_times(path, times, kept, [])
    except ValueError:
        notes.append(f'{told}these samples are too many to be interpolated, so amplitudes are wrong: drive less, or set a wider '
                     'range')
        return points
    notes.append(f'{told}these samples are taken as missing: drive less, or set a wider range')
    return kept


def _hum(motions, dt):
    """A line about the mains frequency at which most signals have a constant phase in their quiet parts; none if there is no hum.

    Each part of the record holds whole periods of all mains frequencies. Noise, and waves that decay, have no constant phase.
    """
    frames, u = round(MAINS_TIME / dt), np.concatenate([*motions.values()], axis=1)
    count = len(u) // max(frames, 1)
    if count < 2 * MAINS_PARTS or frames < 2 * MAINS_TIME * max(MAINS_Hz) * units.Hz:
        return []
    t = dt * np.arange(count * frames)
    parts = u[: len(t)].reshape(count, frames, -1)
    quiet = np.argsort(parts.var(axis=(1, 2)))[: count // 2]
    for f in MAINS_Hz:
        each = (parts * np.exp(-2j * np.pi * f * units.Hz * t).reshape(count, frames, 1)).mean(axis=1)[quiet]
        steady = abs(each.mean(axis=0)) > MAINS_STEADY * np.sqrt(np.mean(abs(each) ** 2, axis=0))
        if steady.mean() > 0.5:
            return [f'hum: {100 * steady.mean():.0f} % of the signals contain a steady line at {f} Hz, the frequency of the '
                    'mains. Points of a ridge near it are suspect']
    return []


def _alive(path, points: Mapping[str, Samples], notes: list[str]) -> dict[str, Samples]:
    """The points that were recorded and moved; those left out are listed in `notes`."""
    recorded = {name: point.duration for name, point in points.items()}
    longest = max(recorded.values())
    if not longest:
        raise ValueError(f'{path} has no point that was sampled at two times or more in every component; a wave needs a record '
                         'over time')
    short = [name for name, length in recorded.items() if length < LEAST_TIME * longest]
    if short:
        notes.append(f'points that miss more than {100 * (1 - LEAST_TIME):.0f} % of the record are left out: {_listed(short)}')
    kept = _without(points, short)
    dead = [name for name, point in kept.items()
            if not any(np.ptp(u) > ROUND_OFF * abs(u).max() for u in point.motions.values())]
    if not dead or len(dead) == len(kept):  # the map refuses a row at rest
        return kept
    notes.append(f'points left out because they do not move (dead): {_listed(dead)}')
    return _without(kept, dead)


def _without(points, names):
    return {name: point for name, point in points.items() if name not in names}


def _equal_times(path, points: Collection[Samples]) -> NDArray[np.float64]:
    """Equal times within all records, at the usual step."""
    steps = np.concatenate([np.diff(point.times) for point in points])
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


@dataclass(frozen=True)
class _Filled:
    """Motions of a point at equal times, and the error of those that are interpolated, relative to the largest motion."""

    motions: dict[str, np.ndarray]
    lacks: np.ndarray  # mask of the times at which the point was not sampled
    error: float = 0.0
    allowed: float = 0.0
    uneven: bool = False  # whether it was sampled at other times, instead of missing some


def _at_equal_times(path, times, points: Mapping[str, Samples], notes: list[str]):
    """The points, without those that lack too many samples, and their motions by component at these times, (frames, points)."""
    found = {name: _nearest(times, point) for name, point in points.items()}
    if any(one.lacks.any() for one in found.values()):
        fastest = _fastest(times, _whole(times, points, found))
        found = {name: _interpolated(times, points[name], one, fastest) for name, one in found.items()}
        left_out = [name for name, one in found.items() if one.error > one.allowed]
        found = _without(found, left_out)
        if not found:
            gap = min(np.diff(point.times).max() for point in points.values())
            raise ValueError(f'{path}: its samples are too far apart for motion at {units.hertz(fastest):.4g} Hz: all points '
                             f'have gaps of {gap / units.s:.4g} s or more. Interpolation there would be off by more than '
                             f'{100 * RESAMPLED:g} % of the motion and {NOISY:g} times its noise; leave that part of the record '
                             'out, or sample faster')
        notes += _told(found, left_out, times[1] - times[0])
    parts = next(iter(found.values())).motions
    return ({name: points[name] for name in found},
            {part: np.stack([one.motions[part] for one in found.values()], axis=1) for part in parts})


def _nearest(times, point):
    """The samples of a point that are nearest to these times."""
    dt = times[1] - times[0]
    at = np.clip(np.searchsorted(point.times, times - dt / 2), 0, len(point.times) - 1)
    return _Filled({part: u[at] for part, u in point.motions.items()}, abs(point.times[at] - times) > JITTER * dt)


def _whole(times, points, found):
    """Motions of the points that lack no sample; if there are none, of all points by a spline."""
    from scipy.interpolate import CubicSpline

    return [one.motions for one in found.values() if not one.lacks.any()] or [
        {part: CubicSpline(point.times, u)(times) for part, u in point.motions.items()} for point in points.values()]


def _told(found, left_out, dt):
    """Notes on the points that were interpolated, and on those that could not be."""
    repaired = [one for one in found.values() if one.lacks.any()]
    off = f'with an error of up to {100 * max([0.0, *(one.error for one in repaired)]):.2g} % of the largest displacement'
    splined = sum(one.uneven for one in repaired)
    notes = []
    if left_out:
        notes.append(f'points left out because too many of their samples are missing: {_listed(left_out)}')
    if missing := sum(one.lacks.sum() for one in repaired if not one.uneven):
        notes.append(f'{missing} missing samples of {len(repaired) - splined} points are interpolated, {off}')
    if splined:
        notes.append(f'{splined} of {len(found)} points were not sampled at equal times: resampled to steps of '
                     f'{dt / units.s:.4g} s, {off}')
    return notes


def _fastest(times, motions):
    """Highest angular frequency at which these motions are strong, in rad/ms."""
    window = np.sin(np.pi * (np.arange(len(times)) + 0.5) / len(times))[:, None] ** 2
    u = without_drift(np.stack([values for one in motions for values in one.values()], axis=1))
    power = np.sum(abs(np.fft.rfft(window * u, axis=0)) ** 2, axis=1)
    return 2 * np.pi * np.fft.rfftfreq(len(times), times[1] - times[0])[power >= STRONG * power.max()].max()


def _interpolated(times, point, near, fastest):
    """A point with the samples that it lacks filled in; with all of them, if it was sampled at other times."""
    if not near.lacks.any():
        return near
    places = (point.times - times[0]) / (times[1] - times[0])
    uneven = bool(abs(places - np.rint(places)).max() > 2 * JITTER)  # not gaps, but other times
    wanted = near.lacks | uneven
    largest = max(abs(u).max() for u in near.motions.values()) or 1.0
    tried = [_by_spline(times, point, near.motions, wanted, fastest, degree) for degree in DEGREES if degree < len(point.times)]
    if not tried:  # too few samples
        return replace(near, error=np.inf)
    noise = min(_noise(motions) for motions, *_ in tried) / largest  # what a spline gets wrong can only add to it
    errors = [float(np.hypot(off, noise * carried).max()) if off.max() < FOLLOWED else np.inf for _, off, carried in tried]
    best = int(np.argmin(errors))
    return _Filled(tried[best][0], wanted, errors[best], max(RESAMPLED, NOISY * noise), uneven)


def _by_spline(times, point, measured, wanted, fastest, degree):
    """Motions with the `wanted` samples from a spline; its error for the fastest wave, and how much of white noise it carries."""
    from scipy.interpolate import make_interp_spline

    t = point.times
    wave, white = np.exp(1j * fastest * t), np.random.default_rng(0).normal(size=(len(t), NOISES))
    known = np.column_stack([*point.motions.values(), wave.real, wave.imag, white])
    values = make_interp_spline(t, known, degree)(times[wanted])
    off = abs(values[:, -NOISES - 2] + 1j * values[:, -NOISES - 1] - np.exp(1j * fastest * times[wanted]))
    motions = {part: u.copy() for part, u in measured.items()}
    for k, u in enumerate(motions.values()):
        u[wanted] = values[:, k]
    return motions, off, np.sqrt(np.mean(values[:, -NOISES:] ** 2, axis=1))


def _noise(motions):
    """Noise of a sample, from the highest quarter of the frequencies, where only noise is."""
    from scipy.fft import dct

    beyond = [np.asarray(dct(u, norm='ortho'))[3 * len(u) // 4 :] for u in motions.values()]
    return np.sqrt(max(np.mean(one**2) for one in beyond))


def _listed(names):
    return ', '.join(names[:8]) + (f' and {len(names) - 8} more' if len(names) > 8 else '')


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
