"""Bond forces as differences from rest, so that a displacement of 1e-12 of the spacing keeps its digits.

A bond with the rest vector R and length r0, whose ends have moved apart by du, has the increment

    e = (2 R.du + t |du|^2) / r0^2

and pulls its far end j (and pushes its near end i) with the force, counted from rest,

    H(e) R + (g + t H(e)) du

    complete      t = 1    H = f(r)/r - f(r0)/r0       r = r0 sqrt(1 + e)      g = f(r0)/r0
    conventional  t = 0    H = (f(r) - f(r0))/r0       r = r0 (1 + e/2)        g = 0

H has no constant term, so no large numbers are ever subtracted.  It is a polynomial, fitted through its slope, in which nothing
cancels.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.polynomial import chebyshev
from numpy.typing import NDArray

from ..interactions.bond_laws import BondLaws, taken

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairLaw
    from ..stiffness.matrices import Model

TOLERANCE = 1e-13  # largest error of a fitted slope dH/de, as a fraction of the slope at rest
RANGES = (1 / 1024, 1 / 64, 1 / 32, 1 / 16, 1 / 8, 3 / 16, 1 / 4, 3 / 8, 1 / 2)
"""Largest increments |e| of the fitted polynomials; motion beyond the last one is left to ASE's loop."""
COUNTS = (6, 11, 16, 24, 31, 40)
"""Numbers of coefficients: few, because the kernel is compiled for each, which takes seconds."""
ALIKE = 1e-14
"""Relative difference up to which the slopes of two laws differ by a factor only; a few times the round-off of a power."""
TOGETHER = 2048  # number of kinds that are fitted at a time, so that their samples stay within tens of megabytes
POWERS = np.eye(COUNTS[-1])
"""Chebyshev polynomials in powers of x, one in each row."""
for n in range(2, COUNTS[-1]):  # T_n = 2 x T_(n-1) - T_(n-2)
    POWERS[n] = 2 * np.roll(POWERS[n - 1], 1) - POWERS[n - 2]


@dataclass(frozen=True)
class Increments:
    """The increment law of bonds whose rest lengths and laws fall into a few kinds."""

    potential: PairLaw  # the law of all bonds, or the laws of the kinds of bonds
    model: Model
    r0: np.ndarray  # shape (kinds,): rest length of each kind of bond, mm

    @property
    def g(self) -> NDArray[np.float64]:
        """Static force over length f(r0)/r0 where it turns with the bond, N/mm, shape (kinds,)."""
        return -self.potential.dphi(self.r0) / self.r0 * (self.model == 'complete')

    def slope(self, e: NDArray[np.float64]) -> NDArray[np.float64]:
        """Slope dH/de in N/mm at the increments e, shape (count,), of each kind, shape (count, kinds)."""
        r0, e = self.r0[:, None], np.asarray(e)
        if self.model == 'conventional':
            return -self.potential.d2phi(r0 * (1 + e / 2)).T / 2
        r = r0 * np.sqrt(1 + e)
        return -((r0**2 / (2 * r**2)) * (self.potential.d2phi(r) - self.potential.dphi(r) / r)).T

    @property
    def factors(self) -> NDArray[np.float64] | None:
        """Factor of the law of each kind, if all H differ by factors only, as they do for a power of the distance; else None."""
        try:
            with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
                slopes = self.slope(np.append(0.0, RANGES[-1] * chebyshev.chebpts2(13)))
                quotients = slopes / slopes[0]
        except ValueError:  # the law does not reach that far
            return None
        alike = (abs(quotients - quotients[:, :1]) <= ALIKE * abs(quotients[:, :1])).all()
        return slopes[0] / slopes[0, 0] if alike else None

    def polynomial(self, reach: float, tolerance: float = TOLERANCE) -> NDArray[np.float64] | None:
        """Coefficients of `H = e (c0 + c1 e + ...)` for |e| <= reach, shape (coefficients, kinds), or None.

        Their number is the smallest of COUNTS for which the errors of slopes are below `tolerance` times the slope at rest.  None
        if the law is not smooth enough there: a table with a knot within reach, or its end.
        """
        fits = []
        for kinds in np.array_split(np.arange(len(self.r0)), -(-len(self.r0) // TOGETHER) or 1):
            law = taken(self.potential, kinds) if isinstance(self.potential, BondLaws) else self.potential
            fits.append(Increments(law, self.model, self.r0[kinds])._fitted(reach, tolerance))
            if fits[-1] is None:
                return None
        count = max(map(len, fits))
        return np.hstack([np.vstack([c, np.zeros((count - len(c), c.shape[1]))]) for c in fits])

    def _fitted(self, reach: float, tolerance: float) -> Any:
        x = np.cos(np.linspace(0, np.pi, 301))
        nodes = chebyshev.chebpts1(COUNTS[-1])
        try:
            exact, sampled, at_rest = (self.slope(reach * at) for at in (x, nodes, np.zeros(1)))
        except ValueError:  # the law does not reach that far
            return None
        series = chebyshev.chebvander(nodes, COUNTS[-1] - 1).T @ sampled * (2 / COUNTS[-1])
        series[0] /= 2
        for count in COUNTS:
            powers = POWERS[:count, :count].T @ series[:count]
            if tolerance > TOLERANCE:  # the slope at rest is kept: its error would be a drift of every phase
                columns = np.vander(nodes, count, increasing=True)[:, 1:]
                powers = np.vstack([at_rest, np.linalg.lstsq(columns, sampled - at_rest)[0]])
            with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
                error = abs((np.vander(x, count, increasing=True) @ powers - exact) / at_rest).max()
            if error < tolerance:
                k = np.arange(count)[:, None]
                return powers / reach**k / (k + 1)
        return None
