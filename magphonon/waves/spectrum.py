"""Wavenumber-frequency maps of waves along a row of particles, their ridges, and how far a ridge lies from a branch.

A row of equal steps R samples a wave only through the phase per step xi = k.R, so maps are drawn over xi (rad) and no
length enters.  The wave of the paper is e^{i(k.R + omega t)}; here a wave that travels towards the end of the row
appears at positive xi (numpy's `fft2` would put it into the quadrant omega > 0, k < 0).

A burst has a source spectrum, and the record ends: at a fixed frequency the peak over xi is pulled towards the
carrier, by half a bin or more.  For each cell of the map the centre of gravity of the collected power is therefore computed
(reassignment, Kodera 1976, Auger and Flandrin 1995).  For window h and transform G_h(xi, omega),

    omega_centre = omega - Im(G_h'/G_h)        xi_centre = xi + Im(G_h'/G_h)        h' along time, along the row

The source spectrum shifts both centres along the branch, so that the point (xi_centre, omega_centre) still lies on the branch.

This holds for a single plane wave. If fronts are curved near a source, a beam of finite width spreads, or a dead particle
scatters, the phase per step changes along the row. The row itself shows by how much: its two halves are analysed separately, and
half of their difference is the uncertainty of the whole (the jackknife with two blocks). Waves reflected from the rim may
be too close in wavenumber to be resolved, even in the halves.  They add up at one frequency and cancel at the next, so that the
ridge jumps from line to line: how far neighbouring points lie from a smooth curve is the other part of the uncertainty.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import stdtrit

from .. import units
from ..errors import finite, positive
from ..results import InHertz, Saved

FEWEST = 8  # smallest number of frames, and of points, for a map
PAD = 4
"""Factor of zero padding along both axes: smooth pictures and finely placed peaks; the resolution stays that of the record."""
FIRST = 3  # lowest frequency line used, in periods per record: a Hann window spreads offset and drift over the two lines below it
ROUND_OFF = 1e-13
"""Motion below this fraction of the displacements is the remainder after offset and drift of a row at rest are subtracted."""
LARGEST = 1e100  # largest displacement in mm; its square is near the end of the floating-point range, as is that of the inverse
LEAST_POWER = 1e-2  # power of a ridge point, as a fraction of the strongest cell of the map (-20 dB), below which it is dropped
LEAST_CONTRAST = 20
"""Ratio of the power of a ridge point to the background of its frequency line below which it is dropped: noise alone exceeds it
once in 1e6 lines."""
LEAST_ABOVE_NOISE = 16
"""Ratio of the power of a ridge point to the median background of all lines, below which the point is dropped.  The background of
one line with 30 points scatters by a third, so that noise was taken for a wave in one record of 200.  In records of 400 lines
with 15 points each, noise exceeds this ratio in one record of 1000."""
GHOST = 0.5
"""Amplitude of a wave at a wrong wavenumber, relative to that at its own, above which it counts as an alias: at a half, noise of
a tenth of the wave does not make the wrong peak the stronger one.  Points at random on half of 30 places have 0.4. """
NORMAL = 1.96  # half width of a 95 % interval in standard deviations of a normal distribution
RESOLVED = 1.0  # distance in bins at which two waves have separate peaks; 2 pi over the number of points is the resolution


@dataclass(frozen=True)
class Spectrum(InHertz, Saved, kind='spectra', units={
    'xi': ('rad', 'wavenumbers'), 'omega': ('rad/ms', 'frequencies'), 'power': ('mm^2', 'frequencies', 'wavenumbers'),
    'xi_centre': ('rad', 'frequencies', 'wavenumbers'), 'omega_centre': ('rad/ms', 'frequencies', 'wavenumbers'),
    'xi_spread': ('rad', 'frequencies', 'wavenumbers'), 'omega_spread': ('rad/ms', 'frequencies', 'wavenumbers'),
    'xi_change': ('rad', 'frequencies', 'wavenumbers'), 'bin_xi': ('rad',), 'bin_omega': ('rad/ms',),
}, missing=('xi_centre', 'omega_centre', 'xi_spread', 'omega_spread', 'xi_change')):
    """Power as a function of phase per step and frequency.

    Attributes
    ----------
    xi : ndarray, shape (wavenumbers,)
        Phase per step k.R in rad, ascending from -pi; positive for waves that travel along the row.
    omega : ndarray, shape (frequencies,)
        Angular frequency in rad/ms, ascending from 0.
    power : ndarray, shape (frequencies, wavenumbers)
        Power in mm^2: a plane wave of amplitude A has the peak A^2.
    xi_centre, omega_centre : ndarray, shape (frequencies, wavenumbers)
        Centre of gravity of the power in each cell; NaN if it has no power.
    xi_spread, omega_spread : ndarray, shape (frequencies, wavenumbers)
        Spread of these centres by noise as strong as the wave: sqrt(2) times their standard deviation, divided by the ratio of
        noise to signal.
    xi_change : ndarray, shape (frequencies, wavenumbers)
        How much larger xi_centre is in the second half of the row than in the first; zero for a single plane wave.
    bin_xi, bin_omega : float
        Resolution of the record, 2 pi/points and 2 pi/duration; the map is padded and its grid is finer.
    """

    xi: np.ndarray
    omega: np.ndarray
    power: np.ndarray
    xi_centre: np.ndarray
    omega_centre: np.ndarray
    xi_spread: np.ndarray
    omega_spread: np.ndarray
    xi_change: np.ndarray
    bin_xi: float
    bin_omega: float

    @property
    def peak(self) -> float:
        """Power of the strongest cell, apart from the cells of offset and drift."""
        return self.power[FIRST * PAD :].max()

    @property
    def loudest(self) -> float:
        """Angular frequency of the strongest cell in rad/ms."""
        return self.omega[FIRST * PAD + int(self.power[FIRST * PAD :].max(axis=1).argmax())]


def wavenumber_frequency(displacements: ArrayLike, dt: float, steps: ArrayLike | None = None) -> Spectrum:
    """Wavenumber-frequency map of one displacement component along a row, with Hann windows in time and space.

    Each particle may be offset from its rest and drift steadily: both are subtracted first, see `without_drift`.

    Where points of the row are missing, each cell of the map is the plane wave fitted by least squares, with the window as
    weights, to the points that are there (the periodogram of Lomb): a missing point has no weight.

    Parameters
    ----------
    displacements : array_like, shape (frames, points)
        In mm, at equal times, of particles in equal steps.  Project them on a direction first, `u @ direction`, so that the
        map shows only the waves of that polarisation.
    dt : float
        Time between frames in ms.
    steps : array_like of int, shape (points,), optional
        Step of each point along the row, ascending from 0, if points are missing; by default 0, 1, 2 and so on.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.waves import wavenumber_frequency
    >>> t, x = np.arange(0, 200, 0.5)[:, None], np.arange(24)
    >>> spectrum = wavenumber_frequency(1e-3 * np.cos(0.8 * t - 0.9 * x), 0.5)
    >>> line, column = np.unravel_index(spectrum.power.argmax(), spectrum.power.shape)
    >>> bool(abs(spectrum.omega[line] - 0.8) < spectrum.bin_omega), bool(abs(spectrum.xi[column] - 0.9) < spectrum.bin_xi)
    (True, True)
    """
    u = finite('displacements', displacements)
    dt = positive('dt', dt, 'ms')
    if u.ndim != 2 or min(u.shape) < FEWEST:
        raise ValueError(f'a map needs displacements of the shape (frames, points), at least {FEWEST} of each, not {u.shape}')
    largest = abs(u).max()
    if largest and not 1 / LARGEST < largest < LARGEST:
        raise ValueError(f'the largest displacement of the row is {largest / units.m:g} m: too large or too small to compute '
                         'with; check the unit')
    u = without_drift(u)
    if abs(u).max() <= ROUND_OFF * largest:
        raise ValueError('the row is at rest throughout the record, or only drifts; record longer, or another component')
    there = np.arange(u.shape[1]) if steps is None else _places(steps, u.shape[1])
    row = np.zeros((len(u), there[-1] + 1))
    row[:, there] = u
    frames, points = row.shape
    in_time, in_space = hann(frames), hann(points)
    _refuse_aliasing(in_space[0], there)
    over_time, moment = (np.fft.rfft(row * window[:, None], PAD * frames, axis=0) for window in in_time)
    G = _over_space(over_time, in_space[0])
    with np.errstate(divide='ignore', invalid='ignore'):
        d_omega = 1j * _over_space(moment / dt, in_space[0]) / G
    d_xi = _wavenumber_shift(over_time, in_space)
    first, second = (_wavenumber_shift(over_time, half).real for half in _hann_halves(points))
    bin_xi, bin_omega = 2 * np.pi / points, 2 * np.pi / (frames * dt)
    xi = 2 * np.pi * np.fft.fftshift(np.fft.fftfreq(PAD * points))
    omega = 2 * np.pi * np.fft.rfftfreq(PAD * frames, dt)
    amplitude = 2 * abs(G) / (in_time[0].sum() * in_space[0][there].sum())
    return Spectrum(xi, omega, amplitude**2, xi + d_xi.real, omega[:, None] + d_omega.real,
                    np.hypot(bin_xi / np.sqrt(3), abs(d_xi)), np.hypot(bin_omega / np.sqrt(3), abs(d_omega)), second - first,
                    bin_xi, bin_omega)


def _places(steps, points):
    there = np.asarray(steps)
    if there.shape != (points,) or there.dtype.kind not in 'iu' or there[0] != 0 or (np.diff(there) < 1).any():
        raise ValueError(f'steps must be {points} whole numbers that ascend from 0, one for each point, not {there.tolist()}')
    return there


def _refuse_aliasing(window, there):
    """Raise ValueError if a wave would also appear at a second wavenumber, as a ghost on the map."""
    weights = np.zeros_like(window)
    weights[there] = window[there]
    ghosts = abs(np.fft.rfft(weights, PAD * len(weights))) / weights.sum()
    beyond = slice(3 * PAD, None)  # the peak of a Hann window ends two bins away
    worst = ghosts[beyond].max(initial=0.0)
    if worst > GHOST:
        apart = 2 * np.pi * (3 * PAD + ghosts[beyond].argmax()) / (PAD * len(weights))
        raise ValueError(f'the {len(there)} measured points on {len(window)} places of the row are so far apart that waves look '
                         f'the same when their wavenumbers differ by {apart:.2f} rad per step (aliasing; the ghost has '
                         f'{100 * worst:.0f} % of the amplitude, at most {100 * GHOST:.0f} % are allowed); measure points in '
                         'between, some of them one step apart')


def without_drift(displacements: NDArray[np.float64]) -> NDArray[np.float64]:
    """Displacements without the constant and the steady drift of each point, shape (frames, points).

    Both are fitted with the weights of the window, so that the map of the rest vanishes at zero frequency.
    """
    weight = hann(len(displacements))[0]
    t = np.arange(len(displacements)) - (len(displacements) - 1) / 2  # weights are even in t: constant and slope do not mix
    offset, slope = (weight * t**k @ displacements / (weight @ t ** (2 * k)) for k in (0, 1))
    return displacements - offset - t[:, None] * slope


def hann(n):
    """Hann window of n samples, and its derivative by the sample number."""
    phase = 2 * np.pi * (np.arange(n) + 0.5) / n
    return (1 - np.cos(phase)) / 2, np.pi / n * np.sin(phase)


def _hann_halves(n):
    """Hann windows of the first and of the second half of n samples, and their derivatives."""
    half = (n + 1) // 2
    rest = np.zeros(n - half)
    window, derivative = hann(half)
    return [(np.r_[window, rest], np.r_[derivative, rest]), (np.r_[rest, window], np.r_[rest, derivative])]


def _wavenumber_shift(over_time, in_space):
    """Distance in xi from each cell of the map to the centre of gravity of its power."""
    with np.errstate(divide='ignore', invalid='ignore'):
        return (_over_space(over_time, in_space[1]) / _over_space(over_time, in_space[0])).imag


def _over_space(over_time, window):
    """Sum of `u e^{-i omega t} e^{+i xi n}` over the row, from the transform over time; zero padded, xi ascending from -pi."""
    points = over_time.shape[1]
    from_minus_pi = (-1.0) ** np.arange(points)  # e^{-i pi n}; a shift of the sum itself would take as long as the sum
    return np.fft.ifft(over_time * (window * from_minus_pi), PAD * points, axis=1, norm='forward')


@dataclass(frozen=True)
class Ridge(InHertz):
    """Points along the crest of a map, one for each frequency line of the record.

    Attributes
    ----------
    xi, omega : ndarray, shape (points,)
        Phase per step in rad, angular frequency in rad/ms.
    sigma_xi, sigma_omega : ndarray, shape (points,)
        Standard uncertainties of xi and omega. Both contain noise of the record; that of xi also contains the difference between
        the halves of the row, and the jumps from line to line.
    power : ndarray, shape (points,)
        Power of the map at the ridge in mm^2.
    bin_xi, bin_omega : float
        Resolution of the record.
    """

    xi: np.ndarray
    omega: np.ndarray
    sigma_xi: np.ndarray
    sigma_omega: np.ndarray
    power: np.ndarray
    bin_xi: float
    bin_omega: float


def ridge(spectrum: Spectrum) -> Ridge:
    """Ridge of the waves that travel along the row: the strongest xi > 0 at each frequency of the record.

    With white noise of the power B per cell below a peak of the power P, a Hann window leaves the centre of gravity uncertain
    by sqrt((1/3 + |G_h'/G_h|^2) B/(2 P)) bins.  The imaginary part of G_h'/G_h is the distance from the cell. The real part
    is not zero if the wave grows or decays within the window, as a pulse early or late in the record does.  B is taken from the
    median over the frequency line, so leakage and other waves count as noise too.

    If the motion is not a plane wave, the halves of the row disagree by D, and the whole is uncertain by D/2, less the
    contribution of noise to D.  A half has 8 times the variance of the whole (a bin of twice the width, half the power over the
    background), so noise alone makes (D/2)^2 four times the variance of the whole.  A single D may be small by chance, so each
    point gets the mean square over the ridge, enlarged by Student's t if points are few, or its own square if that is larger.
    The variance of the points about a smooth branch is averaged in the same way, and added. If D is more than a bin, it is no
    uncertainty of one wave: one half has found another wave, which the whole row would resolve.

    For a dispersive wave without reflections this overestimates the uncertainty: in a long row the wave reaches the two halves at
    different times, when different parts of its branch are strong.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.waves import ridge, wavenumber_frequency
    >>> t, x = np.arange(0, 400, 0.5)[:, None], np.arange(24)
    >>> s = t - x / 0.6 - 100
    >>> crest = ridge(wavenumber_frequency(1e-3 * np.exp(-((s / 20) ** 2)) * np.cos(0.5 * s), 0.5))
    >>> bool(abs(crest.omega / crest.xi - 0.6).max() < 0.01)  # the speed of the pulse
    True
    """
    forward = spectrum.xi > 0
    lines = slice(FIRST * PAD, None, PAD)  # the lines between them, from padding, say nothing new
    power = spectrum.power[lines]
    peak = np.argmax(np.where(forward, power, 0), axis=1)
    at = np.arange(len(power)), peak
    background = np.median(power, axis=1) / np.log(2)  # of an exponential distribution, from its median to its mean
    height = power[at]
    keep = (height > LEAST_POWER * power.max()) & (height > LEAST_CONTRAST * background)
    keep &= height > LEAST_ABOVE_NOISE * np.median(background)  # in a short row a line is quiet by chance
    for step in (1, -1):  # else no crest, but the flank of a wave that runs the other way or stands still
        keep &= height > np.roll(power, step, axis=1)[at]
    keep &= spectrum.xi_centre[lines][at] > spectrum.bin_xi / 2  # half a wave along the row: else it moves as one, or decays
    if not keep.any():
        raise ValueError('no wave along the row rises above the background of the map; '
                         'average or record longer, reverse the row, or drive harder')
    xi, omega = spectrum.xi_centre[lines][at][keep], spectrum.omega_centre[lines][at][keep]
    noise = np.sqrt(background[keep] / (2 * height[keep]))
    noise_xi, sigma_omega = (noise * spread[lines][at][keep] for spread in (spectrum.xi_spread, spectrum.omega_spread))
    most = (RESOLVED * spectrum.bin_xi) ** 2
    halves = np.minimum((spectrum.xi_change[lines][at][keep] / 2) ** 2, most) - 4 * noise_xi**2
    jumps = _jumps(xi, omega / spectrum.bin_omega, noise_xi, sigma_omega / spectrum.bin_omega, np.flatnonzero(keep))
    jumps = np.minimum(jumps, most)
    sigma_xi = np.sqrt(noise_xi**2 + np.minimum(np.maximum(halves, _pooled(halves) + _pooled(jumps)), most))
    return Ridge(xi, omega, sigma_xi, sigma_omega, height[keep], spectrum.bin_xi, spectrum.bin_omega)


def _jumps(xi, omega, noise_xi, noise_omega, line):
    """Variances of xi from the distances of groups of four points from a smooth branch, minus the part due to noise.

    The smooth branch is a parabola of cos xi over omega^2; for a chain this is a straight line, from long waves to the zone edge.
    The four points lie on every other line: because of the Hann window, neighbouring lines share two thirds of their error, these
    a sixth.
    """
    four = np.arange(max(len(xi) - 6, 0))[:, None] + 2 * np.arange(4)
    x, y = omega[four] ** 2, np.cos(xi[four])
    beside = (line[four[:, 3]] - line[four[:, 0]] == 6) & (np.diff(x, axis=1) > 0).all(axis=1)
    four, x, y = four[beside], x[beside], y[beside]
    weights = 1 / np.prod(x[:, :, None] - x[:, None, :] + np.eye(4), axis=2)  # third divided difference, zero for a parabola
    to_xi, to_omega = np.sin(xi[four]), 2 * omega[four] * ((y[:, 3] - y[:, 0]) / (x[:, 3] - x[:, 0]))[:, None]
    noise = np.sum(weights**2 * ((to_xi * noise_xi[four]) ** 2 + (to_omega * noise_omega[four]) ** 2), axis=1)
    return (np.sum(weights * y, axis=1) ** 2 - noise) / np.sum((weights * to_xi) ** 2, axis=1)


def _pooled(variances):
    """Mean of a few variances, enlarged so that NORMAL times its root is the interval of Student's t; zero if there are none."""
    n = len(variances)
    return max(variances.mean(), 0) * (stdtrit(n, 0.975) / NORMAL) ** 2 if n else 0.0
