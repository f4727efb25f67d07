"""Stiffness out of the plane of a pair of magnets whose axes are normal to the plane.

The axes of the magnets of a lattice are normal to its plane, and supports keep them from turning.  If they are round, the energy
U of a pair depends on the distance rho in the plane and on the difference z of heights.  Outside the magnets U obeys Laplace's
equation, therefore

    U_zz = -(phi'' + phi'/rho) = g(rho)    at z = 0,  where U = phi(rho)

and to second order in z

    U(rho, z) = phi(rho) + g(rho) z^2/2

An inverse power phi' = -f, f = b rho^-a, has g = -(a - 1) f/rho: as long as a > 1 the magnets push each other out of the plane,
for dipoles (a = 4) three times as strongly as a force along the line that joins them, which has phi'/rho = -f/rho.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .pair_laws import higher_derivatives

if TYPE_CHECKING:
    from typing import Any

    from .pair_laws import PairLaw


@dataclass(frozen=True)
class UprightMagnets:
    """The pair law of magnets with axes normal to a plane; for motion in the plane it is `planar`.

    It differs from `planar` only if the particles move out of the plane (`MagneticRepulsion` with `foundation=[[k, k, kz]]`).  A
    law that is not wrapped in it is that of a force along the line that joins two particles, as between charges or grains of
    dust.

    Attributes
    ----------
    planar : PairLaw
        Energy of two magnets at the same height.

    Examples
    --------
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import UprightMagnets
    >>> dipoles = UprightMagnets(InversePower(b=8.0, a=4.0))
    >>> float(dipoles.dphi(2.0)), float(dipoles.vertical(2.0))
    (-0.5, -0.75)
    """

    planar: PairLaw

    def phi(self, r: Any) -> Any:
        """Energy in mJ at equal height."""
        return self.planar.phi(r)

    def dphi(self, r: Any) -> Any:
        """First derivative of the energy at equal height, in N."""
        return self.planar.dphi(r)

    def d2phi(self, r: Any) -> Any:
        """Second derivative of the energy at equal height, in N/mm."""
        return self.planar.d2phi(r)

    def vertical(self, r: Any) -> Any:
        """Stiffness g of a pair out of the plane in N/mm, at the distances `r` in mm."""
        return -(self.planar.d2phi(r) + self.planar.dphi(r) / r)

    def vertical_derivatives(self, r: Any) -> tuple[Any, Any]:
        """First and second derivative of `vertical` with respect to the distance, in N/mm^2 and N/mm^3."""
        p1, p2, (p3, p4) = self.planar.dphi(r), self.planar.d2phi(r), higher_derivatives(self.planar, r)
        return -(p3 + p2 / r - p1 / r**2), -(p4 + p3 / r - 2 * p2 / r**2 + 2 * p1 / r**3)
