"""Samples that a record lacks, from the others: motion has a band, and more samples than it needs tell those that are missing.

With the orthonormal cosines c_k of the record (DCT-II, which no offset or drift spoils) let B project on those below a limit K.
The missing samples m that leave least outside the band are

    u_m = (1 - B_mm)^-1 (B u_0)_m                    u_0: the record with zeros where it lacks samples

The variance of each about the motion is then e^2 (1 - B_mm)^-1 + s^2 ((1 - B_mm)^-1 - 1) for white noise of variance s^2 and a
motion that has the mean square e^2 outside the band.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
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
    >>> from magphonon.waves.gaps import filled
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
