"""Whether numbers are plausible: frequencies, densities, masses and springs of the right order, forces that are finite."""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import finite, shown
from .bond import sizes

if TYPE_CHECKING:

    from .calculator import PairCalculator
    from .repulsion import Repulsion

FREQUENCIES_Hz = 1e-4, 1e13
"""Range of frequencies, from a period of three hours to the atoms of a solid; outside it a unit or an exponent is wrong."""
DENSITY = 50.0
"""Mass per cube of the shortest bond in g/mm^3 above which a unit is wrong.  No solid has more than 0.023, a lattice of unit
masses and lengths has 1; kg and m read as g and mm give a million times what it should be."""
STIFF = 100.0, 2e3
"""Between these multiples of the stiffest bond a foundation was probably typed in N/m: it then is 0.1 to 2 bonds, where waves
are to be seen (the prototype's is
0.18).  Supports of benches have 1 N/m or more; a lattice of unit masses or lengths has no units."""
UNEQUAL = 1e9  # ratio of masses from which frequencies lose digits (4e-8 at 1e9, 4e-5 at 1e12): D holds K/sqrt(m m')
FAST = 30.0, 5.0
"""A frequency above the first multiple of that of the stiffest bond and spring was probably typed in Hz, if it is below the
second once converted.  The highest of a lattice is up to about four; a number of Hz is 159 times that of rad/ms."""
EPS = np.finfo(float).eps


def _stiffest(calc: Repulsion) -> tuple[float, float]:
    """Stiffness in N/mm of the stiffest bond, and of the stiffest spring of a site."""
    return (float(sizes(calc.bonds.vectors[:, : calc.dim], calc.interaction)[1].max(initial=0.0)),
            float(np.max(abs(np.asarray(calc.foundation)))))


def frequency_scale(calc: Repulsion) -> float:
    """Estimate of the highest frequency in Hz: that of the lightest particle on its spring and the stiffest bond."""
    return units.hertz(np.sqrt(sum(_stiffest(calc)) / calc.reference.get_masses().min()))


def warn_of_units(calc: Repulsion) -> None:
    """Warn of masses and of springs in other units, and of frequencies beyond FREQUENCIES_Hz; say what was probably meant."""
    masses, shortest = calc.reference.get_masses(), calc.bonds.lengths.min(initial=np.inf)
    lightest, heaviest = masses.min(), masses.max()
    if (density := heaviest / shortest**3) > DENSITY:
        warnings.warn(f'a mass of {heaviest:.3g} g every {shortest:.3g} mm is {1e3 * density:.2g} g/cm^3; numbers are in mm, '
                      'g, ms and N: multiply SI values by their units, as in lattices.triangular(0.01 * m, 7e-4 * kg), see '
                      'magphonon.units', stacklevel=3)
    if (ratio := heaviest / lightest) > UNEQUAL:
        warnings.warn(f'masses of {lightest:.3g} and {heaviest:.3g} g: the low frequencies, those of the heavy particles, are '
                      f'accurate only to {EPS * ratio:.0e}; hold the heavy particles with FixAtoms, or take masses of at most '
                      f'{UNEQUAL * lightest:.3g} g',
                      stacklevel=3)
    bond, spring = _stiffest(calc)
    if STIFF[0] * bond < spring < STIFF[1] * bond and spring >= 1 and shortest != 1 and heaviest != 1:
        warnings.warn(f'the foundation of {spring:.6g} N/mm is {spring / bond:.3g} times as stiff as a bond; if {spring:.6g} N/m '
                      f'was meant, give {spring:.6g} * units.N / units.m, which is {spring / 1e3:.6g} N/mm', stacklevel=3)
    f, (least, most) = frequency_scale(calc), FREQUENCIES_Hz
    if f and not least <= f <= most:
        warnings.warn(f'{calc.laws!r}, the foundation and the masses give frequencies of about {f:.1g} Hz, outside the '
                      f'range {least:g} to {most:g} Hz; numbers are in mm, g, ms and N: multiply SI values by their units, as '
                      'in InversePower(b=1.6e-10 * N * m**4.58, a=4.58) and 1e-3 * kg, see magphonon.units', stacklevel=3)


def asked_frequencies(calc: Repulsion, omega: ArrayLike) -> NDArray[np.float64]:
    """The angular frequencies given to a tool, in rad/ms, as an array of shape (frequencies,); warns if they look like Hz."""
    omega = np.atleast_1d(finite('omega', omega))
    finite('omega', omega, (len(omega),))
    warn_of_hertz(calc, omega)
    return omega


def warn_of_hertz(calc: Repulsion, omega: NDArray[np.float64]) -> None:
    """Warn of angular frequencies in rad/ms that are far above those of a structure, but would be within their range in Hz."""
    if omega.size and (w := float(np.median(abs(omega)))):
        hertz = 2 * np.pi * units.Hz
        scale = hertz * frequency_scale(calc) + calc.turning
        if w > FAST[0] * scale > 0 and abs(omega).max() * hertz < FAST[1] * scale:
            warnings.warn(f'omega = {w:.4g} rad/ms is {w / hertz:.4g} Hz, far above the frequencies of the structure, about '
                          f'{scale / hertz:.3g} Hz; if {w:.4g} Hz was meant, give {w:.4g} * 2 * pi * units.Hz, which is '
                          f'{w * hertz:.4g} rad/ms', stacklevel=4)


def refuse_infinite(calc: PairCalculator) -> None:
    """Refuse a law whose force or stiffness at some bond is not a finite number."""
    bonds = calc.bonds
    for what, unit, value in zip(('force', 'stiffness'), ('N', 'N/mm'), sizes(calc.bond_vectors, calc.interaction), strict=True):
        for b in np.flatnonzero(~np.isfinite(value))[:1]:
            raise ValueError(f'the law {shown(calc.laws)} gives the {what} {value[b]} {unit} at the distance '
                             f'{bonds.lengths[b]:g} mm of the particles {bonds.i[b]} and {bonds.j[b]}; check its parameters and '
                             'their units (mm, N)')
