"""Laws of members: springs and bars, which pull and push, and cables, which go slack; lengths in mm, forces in N."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from ..errors import not_negative, positive
from .pair_laws import Composed


@dataclass(frozen=True)
class Spring:
    """A spring or an elastic bar, `phi(r) = k (r - L0)^2/2`: it pulls where it is longer than `L0` and pushes where shorter.

    Parameters
    ----------
    k : float
        Stiffness in N/mm, positive.
    L0 : float
        Length without load in mm; 0 for a spring whose pull is proportional to its length.

    Examples
    --------
    >>> from magphonon.interactions import Spring
    >>> float(Spring(k=2.0, L0=10.0).dphi(10.5))  # it pulls with 1 N
    1.0
    """

    k: float
    L0: float

    def __post_init__(self) -> None:
        positive('k', self.k, 'N/mm')
        not_negative('L0', self.L0, 'mm')

    def phi(self, r: Any) -> Any:
        return self.k * (r - self.L0) ** 2 / 2

    def dphi(self, r: Any) -> Any:
        """Slope of the energy in N, the tension."""
        return self.k * (r - self.L0)

    def d2phi(self, r: Any) -> Any:
        return self.k + 0 * r


@dataclass(frozen=True)
class Cable(Composed, Spring):
    """A cable: a spring if it is longer than `L0`; if it is shorter it is slack and has neither force nor stiffness.

    Examples
    --------
    >>> from magphonon.interactions import Cable
    >>> cable = Cable(k=2.0, L0=10.0)
    >>> float(cable.dphi(10.5)), float(cable.d2phi(10.5)), float(cable.d2phi(9.5))
    (1.0, 2.0, 0.0)
    """

    def _part(self, name, r):
        return (np.real(r) > self.L0) * getattr(Spring, name)(self, r)
