"""Forces of sites beyond constant springs, on the slots of a layout, for blocks of time steps."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..stiffness.site_laws import SiteLaw, Travelling

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from ..stiffness.calculator import MagneticRepulsion
    from .memory_layout import Layout


class SiteForces:
    """What a `SiteLaw` adds to constant springs at the time t: of Travelling springs `-(cos Wt A + sin Wt B)(slack + u)`.

    Of others `-g(t) V'(slack + u) + V'(slack)`, as static forces count the last term already.  `waves`, shape (2, 2, slots), are
    A and B in N/mm along x and y, None of others; `slack`, shape (2, slots), are displacements from the anchors at rest in mm.
    """

    def __init__(self, calc: MagneticRepulsion, layout: Layout) -> None:
        law = calc.sites.foundation
        self.law, self.layout = law, layout
        self.slack, self.waves = layout.scatter(calc.slack[:, :2]), None
        if isinstance(law, Travelling):
            phase, k = law.phases(calc.anchors), np.broadcast_to(law.k, (len(calc.reference), 2))
            self.waves = layout.scatter(law.eps * np.stack([np.cos(phase), np.sin(phase)], axis=1)[..., None] * k[:, None])
        else:
            self.at_rest = law.slope(calc.slack[:, :2])  # which is among the static forces

    def beats(self, times: NDArray[np.float64]) -> NDArray[np.float64]:
        """Cos Wt and sin Wt, shape (times, 2)."""
        return np.stack([np.cos(self.law.W * times), np.sin(self.law.W * times)], axis=1)

    def __call__(self, u: NDArray[np.float64], t: float) -> NDArray[np.float64]:
        """In N, shape (2, slots), at the displacements u from rest."""
        if self.waves is None:
            d = self.layout.gather(self.slack + u).T
            return self.layout.scatter(self.at_rest - (self.law.factor(t) * self.law.slope(d).T).T)
        return -np.tensordot(self.beats(np.array([t]))[0], self.waves, 1) * (self.slack + u)


def site_forces(calc: MagneticRepulsion, layout: Layout) -> tuple[Any, SiteForces | None]:
    """The constant springs of a calculator in N/mm, one number or shape (2, slots), and the other forces of its sites, if any."""
    law, site = calc.sites.foundation, None
    if isinstance(law, SiteLaw):
        law, site = getattr(law, 'k', 0.0), SiteForces(calc, layout)
    return layout.scatter(law) if isinstance(law, np.ndarray) else law, site
