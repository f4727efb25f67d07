"""Magnets whose axes are normal to their plane: the interaction of a pair in the plane and out of it.

Supports keep the axes of the magnets from turning.  If the magnets are round, the energy U of a pair depends on the distance rho
in the plane and on the difference z of heights.  Outside the magnets U obeys Laplace's equation, therefore

    U_zz = -(phi'' + phi'/rho) = g(rho)    at z = 0,  where U = phi(rho)

and to second order in z

    U(rho, z) = phi(rho) + g(rho) z^2/2

An inverse power phi' = -f, f = b rho^-a, has g = -(a - 1) f/rho: as long as a > 1 the magnets push each other out of the plane,
for dipoles (a = 4) three times as strongly as a force along the line that joins them, which has phi'/rho = -f/rho.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .law_cards import Card
from .pair_laws import PairLaw, higher_derivatives


@dataclass(frozen=True)
class UprightMagnets:
    """The interaction of magnets with axes normal to a plane; for motion in the plane it is the law `planar`.

    It differs from `planar` only if the particles move out of the plane (`PairCalculator` with `foundation=[[k, k, kz]]`).  A law
    that is not wrapped in this class describes a force along the line that joins two particles, as between charges or grains of
    dust.

    Attributes
    ----------
    planar : PairLaw
        Energy of two magnets at the same height.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import UprightMagnets
    >>> dipoles = UprightMagnets(InversePower(b=8.0, a=4.0))
    >>> energy, gradient = dipoles.forces(np.array([[2.0, 0.0, 0.1]]))
    >>> (gradient[0] + 0).round(4).tolist()  # a push apart, and one out of the plane: g z = -0.75 N/mm x 0.1 mm
    [-0.4906, 0.0, -0.075]
    """

    planar: PairLaw

    card: ClassVar[Card] = Card(magnets=True)

    def vertical(self, r: Any) -> Any:
        """Stiffness g of a pair out of the plane in N/mm, at the distances `r` in mm."""
        return -(self.planar.d2phi(r) + self.planar.dphi(r) / r)

    def forces(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Energy `phi + g z^2/2` and its gradient; see `PairInteraction`."""
        rho, z = _apart(R)
        g, (slope, _) = self.vertical(rho), self._vertical_slopes(rho)
        pull = (self.planar.dphi(rho) + slope * z**2 / 2) / rho
        return self.planar.phi(rho) + g * z**2 / 2, np.column_stack([pull[:, None] * R[:, :2], g * z])

    def stiffness(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """D0, which resists stretching in the plane, and D*, everything else; see `PairInteraction`."""
        rho, z = (x[:, None, None] for x in _apart(R))
        e = np.array([0.0, 0.0, 1.0])
        n = R * (1 - e) / rho[:, 0]
        nn, ne, vertical = n[:, :, None] * n[:, None, :], n[:, :, None] * e, np.outer(e, e)
        slope, curvature = (x[:, None, None] for x in self._vertical_slopes(rho[:, 0, 0]))
        turning = (self.planar.dphi(rho) + slope * z**2 / 2) / rho * (np.eye(3) - vertical - nn)
        lifting = self.vertical(rho) * vertical + slope * z * (ne + ne.swapaxes(1, 2)) + curvature * z**2 / 2 * nn
        return self.planar.d2phi(rho) * nn, turning + lifting

    def central(self, dim: int) -> PairLaw | None:
        """The planar law for motion in the plane, otherwise None."""
        return self.planar if dim == 2 else None

    def _vertical_slopes(self, r):
        """First and second derivative of `vertical` with respect to the distance, in N/mm^2 and N/mm^3; real, as z is small."""
        r = np.real(r)
        p1, p2, (p3, p4) = self.planar.dphi(r), self.planar.d2phi(r), higher_derivatives(self.planar, r)
        return -(p3 + p2 / r - p1 / r**2), -(p4 + p3 / r - 2 * p2 / r**2 + 2 * p1 / r**3)


def _apart(R):
    """Distances in the plane and differences of height, shape (bonds,)."""
    return np.sqrt(R[:, 0] ** 2 + R[:, 1] ** 2), R[:, 2]
