"""Whether the numbers of a calculator can be meant: frequencies and densities of the right order, forces that are finite."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..errors import shown
from .bond import sizes

if TYPE_CHECKING:
    from .calculator import PairCalculator
    from .repulsion import Repulsion

FREQUENCIES_Hz = 1e-4, 1e13
"""Range of frequencies, from a period of three hours to the atoms of a solid; outside it a unit or an exponent is wrong."""
DENSITY = 50.0
"""Mass per cube of the shortest bond in g/mm^3 above which a unit is wrong.  No solid has more than 0.023, a lattice of unit
masses and lengths has 1; kg and m read as g and mm give a million times what it should be."""


def frequency_scale(calc: Repulsion) -> float:
    """About the highest frequency in Hz: that of the lightest particle on its spring and the stiffest bond."""
    stiffest = sizes(calc.bonds.vectors[:, : calc.dim], calc.interaction)[1].max(initial=0.0)
    return units.hertz(np.sqrt((stiffest + np.max(abs(calc.site_stiffness))) / calc.reference.get_masses().min()))


def warn_of_units(calc: Repulsion) -> None:
    """Warn of frequencies beyond FREQUENCIES_Hz, which a law and springs without stiffness do not have, and of DENSITY."""
    heaviest, shortest = calc.reference.get_masses().max(), calc.bonds.lengths.min(initial=np.inf)
    if (density := heaviest / shortest**3) > DENSITY:
        warnings.warn(f'a mass of {heaviest:.3g} g every {shortest:.3g} mm is {1e3 * density:.2g} g/cm^3; numbers are in mm, '
                      'g, ms and N: multiply SI values by their units, as in lattices.triangular(0.01 * m, 7e-4 * kg), see '
                      'magphonon.units', stacklevel=3)
    f, (least, most) = frequency_scale(calc), FREQUENCIES_Hz
    if f and not least <= f <= most:
        warnings.warn(f'{calc.laws!r}, the foundation and the masses give frequencies of about {f:.1g} Hz, outside the '
                      f'range {least:g} to {most:g} Hz; numbers are in mm, g, ms and N: multiply SI values by their units, as '
                      'in InversePower(b=1.6e-10 * N * m**4.58, a=4.58) and 1e-3 * kg, see magphonon.units', stacklevel=3)


def refuse_infinite(calc: PairCalculator) -> None:
    """Refuse a law whose force or stiffness at some bond is not a finite number."""
    bonds = calc.bonds
    for what, unit, value in zip(('force', 'stiffness'), ('N', 'N/mm'), sizes(calc.bond_vectors, calc.interaction), strict=True):
        for b in np.flatnonzero(~np.isfinite(value))[:1]:
            raise ValueError(f'the law {shown(calc.laws)} gives the {what} {value[b]} {unit} at the distance '
                             f'{bonds.lengths[b]:g} mm of the particles {bonds.i[b]} and {bonds.j[b]}; check its parameters and '
                             'their units (mm, N)')
