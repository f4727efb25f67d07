"""The pair law through a table of measured forces."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from ..errors import finite

if TYPE_CHECKING:
    from typing import Any

# Gauss-Legendre on [0, 1]: the energy between two table points to round-off, also for a law as steep as r^-12
# sampled twice per octave.
_NODES, _WEIGHTS = (0.5 * (x + shift) for x, shift in zip(np.polynomial.legendre.leggauss(16), (1, 0), strict=True))


@dataclass(frozen=True)
class Tabulated:
    """A smooth law through measured force-distance data: cubic spline of `log f` over `log r`.

    On logarithmic axes an inverse power is a straight line, which the spline reproduces exactly; between
    measured points the force stays positive and has a continuous slope and curvature.  The energy is the
    integral of the force, zero at the last point.

    Parameters
    ----------
    r : array_like, shape (n,)
        Distances in mm, increasing, n >= 4.
    f : array_like, shape (n,)
        Repulsive forces in N, positive.

    Raises
    ------
    ValueError
        If the table is malformed, or when the law is asked for a distance outside it.

    Examples
    --------
    >>> from magphonon import Tabulated
    >>> law = Tabulated([8.0, 9.0, 10.0, 12.0], [0.66, 0.38, 0.24, 0.10])
    >>> round(float(-law.dphi(9.5)), 3)
    0.3
    """

    r: np.ndarray
    f: np.ndarray
    _slopes: np.ndarray = field(init=False, repr=False, compare=False)
    _energies: np.ndarray = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        from scipy.interpolate import CubicSpline

        r, f = finite('r', self.r).copy(), finite('f', self.f).copy()
        if r.ndim != 1 or r.shape != f.shape or len(r) < 4:
            raise ValueError(f'a table needs two columns of at least 4 points, not r {r.shape} and f {f.shape}')
        if not (r[0] > 0 and (np.diff(r) > 0).all()):
            raise ValueError(f'table distances must be positive and increasing, not {r}; sort them and drop repeats')
        if not (f > 0).all():
            raise ValueError(f'table forces must be positive (repulsive), not {f.min():g} N; drop the points at the noise floor')
        spline = CubicSpline(np.log(r), np.log(f))
        for name, value in (('r', r), ('f', f), ('_slopes', spline.c), ('_energies', np.zeros(len(r)))):
            object.__setattr__(self, name, value)
        # phi at each point from the integral over the interval beyond it
        steps = [self._force_integral(k, r[k + 1]) for k in range(len(r) - 1)]
        object.__setattr__(self, '_energies', np.append(np.cumsum(steps[::-1])[::-1], 0.0))

    def _interval(self, r):
        """Index k of the table interval that holds each distance."""
        real = np.real(r)
        if not ((real >= self.r[0]) & (real <= self.r[-1])).all():
            bad = np.asarray(real)[~((real >= self.r[0]) & (real <= self.r[-1]))].flat[0]
            raise ValueError(f'distance {bad:g} mm is outside the table ({self.r[0]:g} to {self.r[-1]:g} mm); '
                             'extend the measurement, or check the spacing and its unit: a table is not extrapolated')
        return np.clip(np.searchsorted(self.r, real, side='right') - 1, 0, len(self.r) - 2)

    def _force(self, k, r):
        """Force, and d log f/d log r, on the spline piece k."""
        x = np.log(r) - np.log(self.r[k])
        c3, c2, c1, c0 = self._slopes[:, k]
        return np.exp(c0 + x * (c1 + x * (c2 + x * c3))), c1 + x * (2 * c2 + x * 3 * c3)

    def _force_integral(self, k, r):
        """Integral of the force from the point k of the table to `r`."""
        start = self.r[k]
        span = r - start
        return span * sum(w * self._force(k, start + node * span)[0] for node, w in zip(_NODES, _WEIGHTS, strict=True))

    def phi(self, r: Any) -> Any:
        """Energy in mJ, zero at the last point of the table."""
        k = self._interval(r)
        return self._energies[k] - self._force_integral(k, r)

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N."""
        return -self._force(self._interval(r), r)[0]

    def d2phi(self, r: Any) -> Any:
        """Curvature of the energy in N/mm."""
        f, slope = self._force(self._interval(r), r)
        return -f * slope / r
