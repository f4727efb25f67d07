"""The frequency scale of a law, a foundation and masses, by which missing units are detected."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from .. import units

if TYPE_CHECKING:
    from .repulsion import Repulsion

FREQUENCIES_Hz = 1e-4, 1e13
"""Range of frequencies, from a period of three hours to the atoms of a solid; outside it a unit or an exponent is wrong."""


def frequency_scale(calc: Repulsion) -> float:
    """About the highest frequency in Hz: that of the lightest particle on its spring and the stiffest bond."""
    stiffest = abs(calc.law.d2phi(calc.bonds.lengths)).max(initial=0.0)
    return units.hertz(np.sqrt((stiffest + np.max(calc.foundation)) / calc.reference.get_masses().min()))


def warn_of_units(calc: Repulsion) -> None:
    """Warn of frequencies beyond FREQUENCIES_Hz; a law and springs without any stiffness have none."""
    f, (least, most) = frequency_scale(calc), FREQUENCIES_Hz
    if f and not least <= f <= most:
        warnings.warn(f'{calc.potential!r}, the foundation and the masses give frequencies of about {f:.1g} Hz, outside the '
                      f'range {least:g} to {most:g} Hz; numbers are in mm, g, ms and N: multiply SI values by their units, as '
                      'in InversePower(b=1.6e-10 * N * m**4.58, a=4.58) and 1e-3 * kg, see magphonon.units', stacklevel=3)
