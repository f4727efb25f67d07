"""A particle and a direction: the place of a force or of a measured displacement."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import finite

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray


@dataclass(frozen=True, eq=False)
class Place:
    """A particle and a direction: where a force acts, or where a displacement is seen.

    Attributes
    ----------
    particle : int
    direction : ndarray, shape (3,)
        Direction of the force or displacement; a unit vector unless a multiple is meant.

    Examples
    --------
    >>> from magphonon.response import Place
    >>> Place(3, (0, 2, 0)).particle
    3
    """

    particle: int
    direction: np.ndarray

    def __post_init__(self) -> None:
        object.__setattr__(self, 'direction', finite('direction', self.direction, (3,)))

    def force(self, particles: int) -> NDArray[np.float64]:
        """A unit force there, zero on all other of the `particles`; shape (particles, 3)."""
        force = np.zeros((particles, 3))
        force[self.particle] = self.direction
        return force

    def seen(self, displacements: NDArray[Any]) -> NDArray[Any]:
        """The component of displacements, shape (..., particles, dim), that is measured there."""
        return displacements[..., self.particle, :] @ self.direction[: displacements.shape[-1]]
