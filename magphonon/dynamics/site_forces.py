"""Site forces that are not those of constant springs, on the slots of a layout, for blocks of time steps."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..stiffness.calculator import PairCalculator
from .memory_layout import Layout


class SiteForces:
    """Force that a law of the sites adds to constant springs at the time t.

    For modulated springs it is `-(cos Wt A + sin Wt B)(slack + u)`.  For other laws it is the part of -V' beyond springs, minus
    its value at rest, which the static forces contain.  `waves`, shape (2, 2, slots), are A and B in N/mm along x and y, or None
    for other laws; `slack`, shape (2, slots), are displacements from the anchors at rest in mm.
    """

    def __init__(self, calc: PairCalculator, layout: Layout) -> None:
        self.law, self.layout, self.anchors = calc.tie, layout, calc.anchors
        self.slack, self.waves = layout.scatter(calc.slack[:, :2]), None
        self.at_rest, wave = self.law.beyond(calc.slack[:, :2]), self.law.modulation(calc.anchors)
        if wave is not None:
            A = np.broadcast_to(2 * wave.A, (len(calc.reference), 2))
            self.W, self.waves = wave.W, layout.scatter(np.stack([A.real, -A.imag], axis=1))

    def beats(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of cos Wt and sin Wt, shape (times, 2)."""
        return np.stack([np.cos(self.W * times), np.sin(self.W * times)], axis=1)

    def __call__(self, u: NDArray[np.float64], t: float) -> NDArray[np.float64]:
        """Added force in N, shape (2, slots), at the displacements u from rest and the time t."""
        if self.waves is None:
            d = self.layout.gather(self.slack + u).T
            return self.layout.scatter(self.at_rest - self.law.beyond(d, t, self.anchors))
        return -np.tensordot(self.beats(np.array([t]))[0], self.waves, 1) * (self.slack + u)


def site_forces(calc: PairCalculator, layout: Layout) -> tuple[Any, SiteForces | None]:
    """The constant springs of a calculator in N/mm, one number or shape (2, slots), and other forces of its sites, or None."""
    k = calc.tie.k
    return layout.scatter(k) if isinstance(k, np.ndarray) else k, SiteForces(calc, layout) if calc.tie.known else None
