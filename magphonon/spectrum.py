"""Wavenumber-frequency maps of waves along a row of particles, their ridges, and how far a ridge lies from a branch.

A row of equal steps R samples a wave only through the phase per step xi = k.R, so maps are drawn over xi (rad) and no
length enters.  The wave of the paper is e^{i(k.R + omega t)}; here a wave that travels towards the end of the row
appears at positive xi (numpy's `fft2` would put it into the quadrant omega > 0, k < 0).

A burst has a source spectrum, and the record ends: at a fixed frequency the peak over xi is pulled towards the
carrier, by half a bin and more.  Each cell of the map therefore knows the centre of gravity of what it has collected
(reassignment, Kodera 1976, Auger and Flandrin 1995).  For window h and transform G_h(xi, omega),

    omega_centre = omega - Im(G_h'/G_h)        xi_centre = xi + Im(G_h'/G_h)        h' along time, along the row

Whatever spectrum weights a narrow piece of a branch, both centres are weighted alike: their point lies on the branch.
"""

from dataclasses import dataclass

import numpy as np

from .bands import bloch_modes
from .errors import finite, one_of, positive
from .files import Saved

FEWEST = 8
"""Frames, and points, that a map is made of at least."""

PAD = 4
"""Zero padding along both axes: smooth pictures and finely placed peaks; the resolution stays that of the record."""

LEAST_POWER = 1e-2
"""Ridge points weaker than this share of the strongest cell of the map (-20 dB) are dropped."""

LEAST_CONTRAST = 20
"""Ridge points weaker than this multiple of their line's background are dropped: noise alone gets there once in 1e6 lines."""

BRANCH_POINTS = 2001
"""Samples of a branch; straight lines between them keep 1e-6 of its highest frequency."""


@dataclass(frozen=True)
class Spectrum(Saved, kind='spectra', units={
    'xi': ('rad', 'wavenumbers'), 'omega': ('rad/ms', 'frequencies'), 'power': ('mm^2', 'frequencies', 'wavenumbers'),
    'xi_centre': ('rad', 'frequencies', 'wavenumbers'), 'omega_centre': ('rad/ms', 'frequencies', 'wavenumbers'),
    'bin_xi': ('rad',), 'bin_omega': ('rad/ms',),
}):
    """Power over phase per step and frequency.

    Attributes
    ----------
    xi : ndarray, shape (wavenumbers,)
        Phase per step k.R in rad, ascending from -pi; positive for waves that travel along the row.
    omega : ndarray, shape (frequencies,)
        Angular frequency in rad/ms, ascending from 0.
    power : ndarray, shape (frequencies, wavenumbers)
        In mm^2: a plane wave of amplitude A has the peak A^2.
    xi_centre, omega_centre : ndarray, shape (frequencies, wavenumbers)
        Where the power in each cell comes from; NaN where there is none.
    bin_xi, bin_omega : float
        Resolution of the record, 2 pi/points and 2 pi/duration; the map is padded and its grid is finer.
    """

    xi: np.ndarray
    omega: np.ndarray
    power: np.ndarray
    xi_centre: np.ndarray
    omega_centre: np.ndarray
    bin_xi: float
    bin_omega: float


def wavenumber_frequency(displacements, dt):
    """Wavenumber-frequency map of one displacement component along a row, Hann windows in time and space.

    Parameters
    ----------
    displacements : array_like, shape (frames, points)
        In mm, at equal times, of particles in equal steps.  Project on a direction first, `u @ direction`: then the
        waves of that polarisation stand alone on the map.
    dt : float
        Time between frames in ms.

    Returns
    -------
    Spectrum

    Raises
    ------
    ValueError
        For another shape, fewer than 8 frames or points, entries that are not finite, or a row at rest.
    """
    u = finite('displacements', displacements)
    dt = positive('dt', dt, 'ms')
    if u.ndim != 2 or min(u.shape) < FEWEST:
        raise ValueError(f'a map needs displacements of the shape (frames, points), at least {FEWEST} of each, not {u.shape}')
    if not u.any():
        raise ValueError('the row is at rest throughout the record; record longer, or another component')
    frames, points = u.shape
    in_time, in_space = _hann(frames), _hann(points)
    G = _transform(u, in_time[0], in_space[0])
    with np.errstate(divide='ignore', invalid='ignore'):
        d_omega = -(_transform(u, in_time[1] / dt, in_space[0]) / G).imag
        d_xi = (_transform(u, in_time[0], in_space[1]) / G).imag
    xi = 2 * np.pi * np.fft.fftshift(np.fft.fftfreq(PAD * points))
    omega = 2 * np.pi * np.fft.rfftfreq(PAD * frames, dt)
    amplitude = 2 * abs(G) / (in_time[0].sum() * in_space[0].sum())
    return Spectrum(xi, omega, amplitude**2, xi + d_xi, omega[:, None] + d_omega, 2 * np.pi / points, 2 * np.pi / (frames * dt))


def _hann(n):
    """Hann window of n samples, and its derivative by the sample number."""
    phase = 2 * np.pi * (np.arange(n) + 0.5) / n
    return (1 - np.cos(phase)) / 2, np.pi / n * np.sin(phase)


def _transform(u, in_time, in_space):
    """Sum of `u e^{-i omega t} e^{+i xi n}` over the windowed record, zero padded, xi ascending from -pi."""
    frames, points = u.shape
    over_time = np.fft.rfft(u * in_time[:, None] * in_space, PAD * frames, axis=0)
    return np.fft.fftshift(np.fft.ifft(over_time, PAD * points, axis=1, norm='forward'), axes=1)


@dataclass(frozen=True)
class Ridge:
    """Points along the crest of a map, one for each frequency line of the record.

    Attributes
    ----------
    xi, omega : ndarray, shape (points,)
        Phase per step in rad, angular frequency in rad/ms.
    sigma_xi, sigma_omega : ndarray, shape (points,)
        Their standard uncertainties from the background of the map.
    power : ndarray, shape (points,)
        In mm^2.
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


def ridge(spectrum):
    """Crest of the waves that travel along the row: at each frequency of the record the strongest xi > 0.

    With white noise of the power B per cell below a peak of the power P, a Hann window leaves the centre of gravity, d
    bins away from its cell, uncertain by sqrt((1/3 + d^2) B/(2 P)) bins.  B is taken from the median over the frequency
    line, so that leakage and other waves count as noise too.

    Without noise the curvature of the branch within the width of the window remains: 0.01 bins for a five-cycle burst
    over 60 particles.

    Parameters
    ----------
    spectrum : Spectrum

    Returns
    -------
    Ridge

    Raises
    ------
    ValueError
        If no wave rises above the background.
    """
    forward = spectrum.xi > 0
    lines = slice(PAD, None, PAD)  # the lines between them, from padding, say nothing new; omega = 0 is no wave
    power = spectrum.power[lines]
    peak = np.argmax(np.where(forward, power, 0), axis=1)
    at = np.arange(len(power)), peak
    background = np.median(power, axis=1) / np.log(2)  # of an exponential distribution, from its median to its mean
    height = power[at]
    keep = (height > LEAST_POWER * power.max()) & (height > LEAST_CONTRAST * background)
    for step in (1, -1):  # else no crest, but the flank of a wave that runs the other way or stands still
        keep &= height > np.roll(power, step, axis=1)[at]
    keep &= spectrum.xi_centre[lines][at] > spectrum.bin_xi / 2  # half a wave along the row: else it moves as one, or decays
    if not keep.any():
        raise ValueError('no wave along the row rises above the background of the map; '
                         'average or record longer, reverse the row, or drive harder')
    xi, omega = spectrum.xi_centre[lines][at][keep], spectrum.omega_centre[lines][at][keep]
    noise = np.sqrt(background[keep] / (2 * height[keep]))
    sigma_xi = noise * np.hypot(spectrum.bin_xi / np.sqrt(3), xi - spectrum.xi[peak[keep]])
    sigma_omega = noise * np.hypot(spectrum.bin_omega / np.sqrt(3), omega - spectrum.omega[lines][keep])
    return Ridge(xi, omega, sigma_xi, sigma_omega, height[keep], spectrum.bin_xi, spectrum.bin_omega)


@dataclass(frozen=True)
class Branch:
    """One branch of the bands over the phase per step.

    Attributes
    ----------
    xi : ndarray, shape (points,)
        In rad, ascending.
    omega : ndarray, shape (points,)
        In rad/ms.
    """

    xi: np.ndarray
    omega: np.ndarray


def branch(atoms, direction, mode, model='complete'):
    """Branch of the analytic bands for the waves that a row of particles sees.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion.
    direction : array_like, shape (3,)
        Wavevector of xi = 2 pi in fractions of the reciprocal vectors.  In the triangular lattice, along R2:
        (0, 1, 0) for plane waves from a row of sources along R1 (Gamma-M), (1/2, 1, 0) for the waves from a
        point source (Gamma-K).
    mode : int
        Number of the branch from below, from 0; in the triangular lattice shear is 0 and longitudinal 1.
    model : {'complete', 'conventional'}

    Returns
    -------
    Branch
        From xi = 0 to pi.

    Raises
    ------
    ValueError
        For an unknown model or mode.
    """
    xi = np.linspace(0, np.pi, BRANCH_POINTS)
    omega, _ = bloch_modes(atoms, xi[:, None] / (2 * np.pi) * finite('direction', direction, (3,)), model)
    one_of('mode', mode, range(omega.shape[1]))
    return Branch(xi, omega[:, mode])


@dataclass(frozen=True)
class Misfit:
    """Distance of a ridge from a branch, root mean square over its points.

    Attributes
    ----------
    omega : float
        Along the frequency axis, at the wavenumber of each point, in rad/ms.
    sigma_omega : float
        What the uncertainty of the points alone makes of `omega`.
    bins : float
        Along the wavenumber axis, at the frequency of each point, in bins of the record.
    points : int
    """

    omega: float
    sigma_omega: float
    bins: float
    points: int


def compare(ridge, branch):
    """Distance between a ridge and a branch along either axis.

    A branch that nowhere reaches a frequency is met where it comes nearest: there the wave is evanescent, and the
    real part of its wavenumber stays at that of the band edge.

    Parameters
    ----------
    ridge : Ridge
    branch : Branch

    Returns
    -------
    Misfit
    """
    d_omega = ridge.omega - np.interp(ridge.xi, branch.xi, branch.omega)
    d_xi = ridge.xi - np.array([_nearest_crossing(branch, omega, xi) for omega, xi in zip(ridge.omega, ridge.xi, strict=True)])
    slope = np.interp(ridge.xi, branch.xi, np.gradient(branch.omega, branch.xi))
    sigma = np.hypot(ridge.sigma_omega, slope * ridge.sigma_xi)
    return Misfit(_rms(d_omega), _rms(sigma), _rms(d_xi) / ridge.bin_xi, len(d_xi))


def _nearest_crossing(branch, omega, xi):
    above = branch.omega - omega
    before = np.flatnonzero(above[:-1] * above[1:] <= 0)
    if not len(before):
        return branch.xi[abs(above).argmin()]
    run, rise = branch.xi[before + 1] - branch.xi[before], above[before + 1] - above[before]
    crossings = branch.xi[before] - above[before] * run / np.where(rise == 0, np.inf, rise)
    return crossings[abs(crossings - xi).argmin()]


def _rms(x):
    return float(np.sqrt(np.mean(x**2)))
