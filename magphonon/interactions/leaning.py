"""Magnets on pillars that lean: a cantilever bent by u at its tip turns there by 3u/(2H), and the magnet with it.

Two dipoles have the energy phi if they are upright.  With the slopes t_i = s u_i, s = 3/(2H), it becomes to second order

    U = phi [1 - (t_i^2 + t_j^2)/2 + t_i.(I - 3 nn) t_j]         c = s^2 phi = s^2 f L/3
      = phi + c u_i.(I - 3 nn) u_j - c (u_i^2 + u_j^2)/2

for a bond of the direction n.  The dipoles m s u in the plane are equivalent to charges m s that move by u. So each bond gets the
additional force of charges, b/r^2 with b = c L^3, and each of its ends loses 3 c nn of the stiffness of its foundation:

    c u_i.(I - 3nn) u_j = (u_i - u_j).c (3nn - I) (u_i - u_j)/2 - [u_i.c (3nn - I) u_i + u_j.c (3nn - I) u_j]/2

A leaning magnet also sinks, but this does not matter: the sinking is of second order in u, and the energy does not depend on the
height to first order.  Magnets are treated as point dipoles with the force of the law at the distance of nearest neighbours.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from .pair_laws import Composed, GaussianMixture, InversePower, PairLaw


@dataclass(frozen=True)
class LeaningMagnets(Composed):
    """The law of upright magnets plus the law of charges that leaning adds.

    Attributes
    ----------
    upright : PairLaw
    charges : InversePower
        The law with the force b r^-2.
    """

    upright: PairLaw
    charges: InversePower

    def _part(self, name, r):
        return getattr(self.upright, name)(r) + getattr(self.charges, name)(r)


class LeaningMixture(LeaningMagnets):
    """Leaning magnets whose law is a mixture of Gaussians, so that all neighbours can be summed."""

    upright: GaussianMixture

    def gaussians(self, t: Any) -> Any:
        return self.upright.gaussians(t) + self.charges.gaussians(t)

    def gaussian_moment(self, t: Any) -> Any:
        return self.upright.gaussian_moment(t) + self.charges.gaussian_moment(t)

    @property
    def decay(self) -> float:
        """Exponent of the decay: 1, as for charges, or less for a law of longer range."""
        return min(self.upright.decay, self.charges.decay)

    @property
    def screening(self) -> float:
        """Inverse screening length in 1/mm, which is zero."""
        return 0.0


def leaning_law(upright: PairLaw, spacing: float, height: float) -> LeaningMagnets:
    """The law of magnets at `spacing` (mm) from their nearest neighbours on pillars of the `height` (mm)."""
    charges = InversePower((1.5 / height) ** 2 * -float(upright.dphi(spacing)) * spacing**4 / 3, 2.0)
    return (LeaningMixture if isinstance(upright, GaussianMixture) else LeaningMagnets)(upright, charges)
