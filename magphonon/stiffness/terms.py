"""A structure is a sum of terms: each adds its part to the forces about a rest, and to M u'' + B u' + K u = f.

The bonds are one term, which is kept apart because it is a sum over pairs. The others are terms of single sites, each made from
one property of `Sites` if any site has it. Calculators and `LinearSystem` use only the sums.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from .repulsion import Repulsion


class Term:
    """Contribution of one property of the sites to forces and matrices, zero by default; u are displacements from rest in mm."""

    def __init__(self, calc: Repulsion) -> None:
        raise NotImplementedError

    def constant(self) -> Any:
        """Force at rest in N, shape (particles, dim)."""
        return 0.0

    def force(self, u: NDArray[np.float64]) -> Any:
        """Change of the force by displacements u from rest, in N, shape (particles, dim)."""
        return 0.0

    def energy(self, u: NDArray[np.float64]) -> Any:
        """Energy relative to that at rest in mJ, shape (particles,)."""
        return 0.0

    def stiffness(self, u: NDArray[np.float64] | float) -> Any:
        """Blocks of K in N/mm: one number, or shape (particles, dim) or (particles, dim, dim)."""
        return 0.0

    def rate(self) -> Any:
        """Blocks of B without losses, force per momentum in 1/ms: shape (1 or particles, dim, dim)."""
        return 0.0

    def pumped(self, u: NDArray[np.float64], t: float) -> Any:
        """Part of the force that depends on the time t (ms), in N, shape (particles, dim)."""
        return 0.0


class Load(Term):
    """A constant force h, of energy -h.u."""

    def __init__(self, calc: Repulsion) -> None:
        self.h = calc.sites.load[:, : calc.dim]

    def constant(self) -> Any:
        return self.h

    def energy(self, u: NDArray[np.float64]) -> Any:
        return -(self.h * u).sum(axis=1)


class Tie(Term):
    """The law V of the displacement of each site from its anchor; at rest this displacement is `slack`."""

    def __init__(self, calc: Repulsion) -> None:
        self.law, self.slack, self.anchors = calc.tie, calc.slack[:, : calc.dim], calc.sites.anchors

    def constant(self) -> Any:
        return -self.law.gradient(self.slack)

    def force(self, u: NDArray[np.float64]) -> Any:
        return -self.law.pull(self.slack, u)

    def energy(self, u: NDArray[np.float64]) -> Any:
        return self.law.gain(self.slack, u)

    def stiffness(self, u: NDArray[np.float64] | float) -> Any:
        return self.law.stiffness(self.slack + u)

    def pumped(self, u: NDArray[np.float64], t: float) -> Any:
        return self.law.pumped(self.slack + u, t, self.anchors)


class Gyration(Term):
    """The force m u' x g with the vector g of each site; a single number is the component along z."""

    def __init__(self, calc: Repulsion) -> None:
        g = np.asarray(calc.gyration)
        g = g if g.ndim == 2 else g.reshape(-1, 1) * [0.0, 0.0, 1.0]
        self.blocks = -np.cross(np.eye(3), g[:, None]).swapaxes(1, 2)[:, : calc.dim, : calc.dim]

    def rate(self) -> Any:
        return self.blocks


TERMS = {'load': Load, 'foundation': Tie, 'gyration': Gyration}
"""The term of each property of the sites that has one."""


def terms_of(calc: Repulsion) -> list[Term]:
    """The terms of the sites of a calculator."""
    return [term(calc) for name, term in TERMS.items() if calc.sites.has(name)]
