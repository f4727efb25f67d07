"""Integrals over the widths of the Gaussians of an Ewald sum: t is the inverse square of a width, in 1/mm^2.

Done in closed form these integrals are the incomplete gamma functions of the usual Ewald sum.  Done by quadrature they also
allow offsets across a chain, and every mixture rho(t) of `magphonon.stiffness.ewald`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from numpy.typing import NDArray

    from .ewald import EwaldSums

REACH = 42.0
"""Exponent at which both sums are truncated: e^-42 is 6e-19."""
_X, _W = np.polynomial.legendre.leggauss(16)
_PANEL = 1.5  # of log t: with 16 nodes the double exponential exp(-x e^v) is integrated to round-off, without a power of t


class WideGaussians:
    """Integrals over the wide Gaussians, `int f(t) (pi/t)^{d/2}/V exp(-p^2/4t - t x^2) dt` up to eta^2, one for each p^2."""

    def __init__(self, sums: EwaldSums, p2: NDArray[np.float64], x2: Any) -> None:
        self.sums = sums
        algebraic = np.isfinite(sums.decay)
        # p = 0: below t = 1/x^2 the integrand without the offset across is a power of t, integrated in closed form
        self.uniform = (p2 < 1e-24 * sums.eta2) & algebraic
        self.flat = sums.eta2 / max(1, x2 * sums.eta2) if algebraic else sums.eta2
        low = min(np.where(self.uniform, np.inf, p2).min(initial=np.inf), 4 * sums.eta2)
        low = (low if algebraic else low + sums.law.screening**2) / 4 / (REACH + 20)
        if x2 > 0 and algebraic:
            low = min(low, self.flat * np.exp(-80))
        power = 2 * sums.decay if algebraic else 0
        self.t, w = (np.concatenate(both) for both in zip(nodes(low, self.flat, power), nodes(self.flat, sums.eta2, power),
                                                          strict=True))
        self.w = w * (np.pi / self.t) ** (sums.d / 2) / sums.volume
        self.gauss = np.exp(-p2[..., None] / (4 * self.t)) * np.exp(-self.t * x2)
        self.gauss[self.uniform] = np.where(self.t < self.flat, np.expm1(-self.t * x2), np.exp(-self.t * x2))

    def moment(self, f: Callable[..., Any], m: int, uniform: bool = True) -> NDArray[np.float64]:
        """The integral of a function that behaves as rho t^m near t = 0; without the term p = 0 if not `uniform`."""
        sums = self.sums
        result = self.gauss @ (self.w * f(self.t))
        if not self.uniform.any():
            return result
        if not uniform:
            return np.where(self.uniform, 0.0, result)
        exponent = (sums.decay - sums.d) / 2 + m
        # an exponent of zero gives a logarithm of the size, equal for all particles: the zero of the energy is then arbitrary
        factor = 1 / exponent if abs(exponent) > 1e-12 else np.log(self.flat * sums.volume ** (2 / sums.d))
        closed = self.flat * f(self.flat) * (np.pi / self.flat) ** (sums.d / 2) / sums.volume * factor
        return result + np.where(self.uniform, closed, 0.0)


def nodes(low: float, high: float, power: float = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gauss-Legendre nodes and weights of an integral over t, on panels of equal ratio, narrower for a high power of t."""
    if low >= high:  # the screening is so strong that there are no wide Gaussians
        return np.array([high]), np.zeros(1)
    panels = max(1, int(np.ceil(np.log(high / low) / _PANEL * (1 + power / 32))))
    half = np.log(high / low) / panels / 2
    centre = np.log(low) + half * (2 * np.arange(panels) + 1)
    t = np.exp(centre[:, None] + half * _X)
    return t.ravel(), (half * _W * t).ravel()
