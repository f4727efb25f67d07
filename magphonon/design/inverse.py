"""Inverse design: the spacing and the foundation that give a lattice the wanted frequencies.

The cut-off, the frequency of uniform motion, fixes the foundation, `k = m w^2`.  Given k, the edge of a band or the width
of a gap fixes the spacing.  Only spacings at which the lattice is stable on this foundation are considered: their range is
searched for crossings of the wanted value, and each crossing is refined by Brent's method.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ase import Atoms
from scipy.optimize import brentq

from ..errors import PhysicsError, finite, positive
from ..stability.buckling import common_spring, critical_foundation
from ..stiffness.repulsion import masses_of
from ..stiffness.rest import LinearSystem
from ..traits import takes
from .objectives import Objective, Rest
from .scatter import SiteSlopes

SCAN_POINTS = 49
"""Number of spacings tried in the range; between two of them the wanted value is crossed at most once."""
VERGE_TOLERANCE = 1e-9
"""Relative accuracy of the spacing at which the lattice begins to buckle."""
EQUAL_MASSES = 1e-12
"""Relative difference of two masses below which they are equal, because of the round-off of their units."""


@dataclass(frozen=True)
class Design:
    """A spacing at which a lattice has the wanted value, and the foundation that it needs there.

    Attributes
    ----------
    spacing : float
        In mm.
    value, slope : float
        The value at this spacing, and its derivative with respect to the logarithm of the spacing, rad/ms.
    needed : float
        Foundation in N/mm that the static forces require at this spacing.
    """

    spacing: float
    value: float
    slope: float
    needed: float


@takes('all neighbours', 'conventional', 'oblique')
def foundation_for(atoms: Atoms, cut_off: float) -> float:
    """Foundation stiffness in N/mm at which uniform motion has the frequency `cut_off` in rad/ms.

    Raises
    ------
    ValueError
        If the cut-off is not positive, or the particles have different masses, because then no mode on a common foundation is
        uniform.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene, ready_scene, units as u
    >>> from magphonon.design import foundation_for
    >>> k = foundation_for(read_scene(ready_scene('prototype')).atoms(), 2 * np.pi * 26.550686524 * u.Hz)
    >>> round(k / (u.N / u.m), 4)
    19.6757
    """
    masses = masses_of(atoms)
    if np.ptp(masses) > EQUAL_MASSES * masses.max():
        raise ValueError(f'the masses range from {masses.min():g} to {masses.max():g} g: on a common foundation they swing at '
                         'different frequencies, and no motion is uniform; give all particles equal masses, or vary the '
                         'foundation until analytic_bands begin at the cut-off')
    return float(atoms.get_masses()[0] * positive('cut-off', cut_off, 'rad/ms') ** 2)


def spacings_for(build: Callable[[float], Atoms], target: Objective, wanted: float,
                  between: tuple[float, float]) -> list[Design]:
    """All spacings in a range at which a lattice is stable and a target has the wanted value.

    Parameters
    ----------
    build : callable
        Function that takes the spacing in mm and returns the cell with its PairCalculator.
    target : Objective
        A quantity in rad/ms, such as a `BandEdge` or `band_gap` with infinite sharpness.
    wanted : float
        Wanted value in rad/ms.
    between : (float, float)
        Range of spacings in mm.

    Returns
    -------
    list of Design
        In order of increasing spacing.

    Raises
    ------
    NoDesign
        If no spacing in the range is stable, or none of these gives the value.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import BandEdge, spacings_for
    >>> def build(spacing):
    ...     cell = lattices.triangular(spacing, 1.0)
    ...     cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    ...     return cell
    >>> edge = BandEdge([0.5, 0, 0], below=1, sharp=np.inf)  # branch 1 at M
    >>> [design] = spacings_for(build, edge, wanted=1.0, between=(0.5, 2.0))
    >>> round(design.spacing, 9), round(2 ** (1 / 5), 9)  # omega^2 = 2 (a - 3) L^-(a + 1)
    (1.148698355, 1.148698355)
    """
    low, high = finite('between', between, (2,))
    if not 0 < low < high:
        raise ValueError(f'the range of spacings must be two increasing positive numbers in mm, not {low:g} and {high:g}')
    stretches = _stable_stretches(build, np.geomspace(low, high, SCAN_POINTS))
    if not stretches:
        raise NoDesign(None, None)

    def off(spacing):
        return target.value(LinearSystem.of(build(float(spacing)))) - wanted

    misses, found = [np.array([off(L) for L in spacings]) for spacings in stretches], []
    for spacings, miss in zip(stretches, misses, strict=True):
        for k in np.flatnonzero((miss[:-1] < 0) != (miss[1:] < 0)):
            found.append(brentq(off, spacings[k], spacings[k + 1], xtol=1e-15 * low))
        if miss[-1] == 0:
            found.append(spacings[-1])
    if not found:
        reach = wanted + np.concatenate(misses)
        raise NoDesign([(s[0], s[-1]) for s in stretches], (reach.min(), reach.max()))
    designs = []
    for L in map(float, found):
        atoms = build(L)
        rest = Rest(LinearSystem.of(atoms))
        value, slope = target.value_and_slope(rest)
        by_spacing = SiteSlopes(rest.system).of(slope)['spacing']
        designs.append(Design(L, float(value), float(by_spacing), critical_foundation(atoms, 'complete')[0]))
    return designs


class NoDesign(PhysicsError):
    """No spacing in the range gives a lattice the wanted value.

    Attributes
    ----------
    stable : list of (float, float), or None
        The stable ranges of spacing in mm.
    reach : (float, float), or None
        The smallest and the largest value in these ranges, rad/ms.
    """

    def __init__(self, stable: list[tuple[float, float]] | None, reach: tuple[float, float] | None) -> None:
        super().__init__('no spacing in the range gives the wanted value' if stable else 'the range holds no stable spacing')
        self.stable, self.reach = stable, reach


def _holds(build, spacing):
    atoms = build(spacing)
    return common_spring(atoms) >= critical_foundation(atoms, 'complete')[0]


def _stable_stretches(build, spacings):
    holds = np.array([_holds(build, L) for L in spacings])
    stretches = []
    for run in np.split(np.arange(len(spacings)), np.flatnonzero(np.diff(holds)) + 1):
        if not holds[run[0]]:
            continue
        ends = [_verge(build, spacings[inside], spacings[outside])
                for inside, outside in ((run[0], run[0] - 1), (run[-1], run[-1] + 1)) if 0 <= outside < len(spacings)]
        stretches.append(np.unique([*spacings[run], *ends]))
    return stretches


def _verge(build, inside, outside):
    while abs(outside - inside) > VERGE_TOLERANCE * inside:
        middle = (inside + outside) / 2
        if middle in (inside, outside):
            break
        inside, outside = (middle, outside) if _holds(build, middle) else (inside, middle)
    return inside
