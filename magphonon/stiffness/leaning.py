"""A lattice whose magnets lean with their pillars: applies `magphonon.interactions.leaning` to its bonds and its foundation."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..interactions.leaning import leaning_law
from .all_neighbours import AllNeighbours
from .ewald import lattice_sum
from .matrices import own_stiffness
from .repulsion import Repulsion
from .sites import each_spring

EQUAL = 1e-9  # relative difference of what leaning takes from the springs of two sites that is round-off


def leaning(calc: Any, height: float) -> Repulsion:
    """The calculator of a perfect planar lattice of upright magnets that lean with pillars of this height (mm).

    Leaning reduces the stiffness of each spring. ValueError if the reduction differs between sites or between x and y (kagome),
    or if it exceeds the stiffness.
    """
    law = leaning_law(calc.laws, calc.bonds.lengths.min(), height)
    springs = each_spring(calc.foundation, len(calc.reference), calc.dim).reshape(-1, calc.dim) - _taken(calc, law.charges)
    if springs.min() < 0:
        raise ValueError(f'pillars of {height:g} mm lean so much that the magnets would tip over ({springs.min():.3g} N/mm are '
                         'left of the foundation); take a stiffer pillar')
    return calc.changed(laws=law, sites=replace(calc.sites, foundation=springs))


def _taken(calc, charges) -> NDArray[np.float64]:
    """Reduction of the spring of a site by leaning, sum of 3 c nn over its bonds, along x and y: shape (1, 2), N/mm."""
    if isinstance(calc, AllNeighbours):
        if len(calc.reference) > 1 or not hasattr(calc.laws, 'gaussians'):
            raise ValueError('the sum over all neighbours of leaning magnets is known for one magnet in a cell and laws in '
                             'closed form; choose a number of shells')
        return np.full((1, 2), 1.5 * charges.b * lattice_sum(calc.reference, 3.0))
    R = calc.bond_vectors
    T = 3 * charges.b * np.linalg.norm(R, axis=1)[:, None, None] ** -5 * R[:, :, None] * R[:, None, :]
    sites = own_stiffness(calc.bonds, T)
    if abs(sites - sites[0] * np.eye(2)).max() > EQUAL * abs(sites).max():
        raise ValueError('leaning gives the sites of this lattice different springs, or oblique ones, which foundations here do '
                         'not support; remove lean = true')
    return np.diagonal(sites[0])[None]
