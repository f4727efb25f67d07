"""Methods that split a time step h into kicks, `v <- v + b_k h F/m`, and drifts, `u <- u + a_k h v`, in turns.

Velocity Verlet is the method of order 2.  The methods of order 4 and 6 are the Runge-Kutta-Nystroem splittings SRKN_6^b and
SRKN_11^b of Blanes and Moan (J. Comput. Appl. Math. 142, 313 (2002), Tables 2 and 3), which begin and end with a kick.  They
require forces that do not depend on velocities. A force that depends on time is evaluated at the time of its kick. Damping
belongs to the drift, which is then exact: `u <- u + (1 - e^{-gamma a h})/gamma v`, `v <- e^{-gamma a h} v`.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np


class StepsTooLong(ValueError):
    """Time steps are too long for the tolerance of a run; `longest` is what they may have, in ms."""

    def __init__(self, what: str, longest: float) -> None:
        super().__init__(f'{what}; take steps of at most {0.999 * longest:.4g} ms')
        self.longest = longest


@dataclass(frozen=True)
class Splitting:
    """A method that splits a time step into kicks and drifts, and the limits within which it is valid.

    Attributes
    ----------
    order : int
        Order of the error in the time step.
    kicks, drifts : tuple of float
        b_0 to b_s and a_1 to a_s, palindromes whose sums are one.
    limit : float
        Largest omega h of an oscillator for which the method is stable.
    damped : float
        Largest gamma h up to which overdamped motion is right to 2 %, at damping ratios of 1 to 100.  Beyond, a
        step of Verlet moves by h^2 F/2m however large gamma is; drifts that know the damping serve longer.
    """

    order: int
    kicks: tuple[float, ...]
    drifts: tuple[float, ...]
    limit: float
    damped: float

    @property
    def stages(self) -> int:
        """Number of evaluations of the forces in a step; the last kick of a step and the first of the next share one."""
        return len(self.drifts)

    @cached_property
    def times(self) -> np.ndarray:
        """Times of the kicks after the first, as fractions of a step, shape (stages,)."""
        return np.append(np.cumsum(self.drifts)[:-1], 1.0)

    def error(self, x: Any, phase: Any) -> Any:
        """Relative error of an oscillator with omega h = x after `phase` radians; NaN where the method is not stable.

        Verlet errs by x^2/24 in frequency and by x^2/8 in the shape of the orbit; of others, the worse of both counts for both.
        """
        at = np.maximum(x, EXACT)
        state = np.array([[1 + 0 * at, 0 * at], [0 * at, 1 + 0 * at]])  # columns (u, h v)
        for kick, drift in zip(self.kicks, (*self.drifts, 0.0), strict=True):
            state[1] -= kick * at**2 * state[0]
            state[0] += drift * state[1]
        with np.errstate(invalid='ignore'):
            frequency = np.arccos((state[0, 0] + state[1, 1]) / 2) / at - 1
            shape = np.sqrt(-state[1, 0] / state[0, 1]) / at - 1
        worse = np.maximum(abs(frequency) * 24, abs(shape) * 8) * (x / at) ** self.order
        return np.where(x < self.limit, worse * (phase / 24 + 1 / 8), np.nan)

    def longest(self, phase: float, tolerance: float) -> float:
        """Largest omega h at which the `error` of a wave stays below `tolerance` over a phase of `phase` radians."""
        x = self.limit * np.geomspace(0.01, 1, 1000)[:-1]
        error = self.error(x, phase)
        if not (good := error <= tolerance)[0]:  # such short steps err as the leading term does
            return float(x[0] * (tolerance / error[0]) ** (1 / self.order))
        return float(x[good.cumprod().sum() - 1])

    def flow(self, dt: float, gamma: float) -> tuple[np.ndarray, np.ndarray]:
        """Effect of each drift: distance per velocity in ms, and the factor by which damping reduces it; shape (stages,)."""
        h = dt * np.array(self.drifts)
        return (-np.expm1(-gamma * h) / gamma if gamma else h), np.exp(-gamma * h)


def _both_ways(first, middle):
    """A palindrome of numbers that begins with `first`; its middle, one number or two equal ones, makes the sum one."""
    rest = 1 - 2 * sum(first)
    return (*first, *([rest] if middle == 1 else [rest / 2] * 2), *first[::-1])


SPLITTINGS = {one.order: one for one in (
    Splitting(2, (0.5, 0.5), (1.0,), 2.0, 0.5),
    Splitting(4, _both_ways((0.0829844064174052, 0.396309801498368, -0.0390563049223486), 1),
              _both_ways((0.245298957184271, 0.604872665711080), 2), 3.1634, 4.0),
    Splitting(6, _both_ways((0.0414649985182624, 0.198128671918067, -0.0400061921041533, 0.0752539843015807,
                             -0.0115113874206879), 2),
              _both_ways((0.123229775946271, 0.290553797799558, -0.127049212625417, -0.246331761062075, 0.357208872795928), 1),
                 3.1414, 6.0))}
"""The methods, by the order of their error."""
EXACT = 0.1  # omega h up to which errors are those of the leading term, and below which round-off would hide them
