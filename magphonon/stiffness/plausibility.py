"""Whether numbers are plausible: frequencies, densities, masses and springs of the right order, forces that are finite."""

from __future__ import annotations

import inspect
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import finite, not_negative, shown

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
are to be seen (the prototype's is 0.18).  A lattice of unit masses or lengths has no units."""
TYPED = 5.0  # stiffness in N/mm of the stiffest supports of benches; those typed in N/m are mostly larger numbers
WEAK = 1e-25, 1e-7
"""Fractions of the foundation between which the stiffest bond was probably typed in N m^a instead of N mm^a, which is 1000^a
times as large.  Magnets of 1 mN beside pillars of 5 N/mm have 6e-6."""
BENCH = 2.0, 5e-3
"""From this spacing in mm on, a particle of less than this mass in g was probably typed in kg."""
TALL = 0.4
"""Mass per cube of the shortest bond in g/mm^3 above which a bench has its masses in mg: rods of steel would be fifty times as
tall as they are apart."""
PRESSURE = 100.0
"""Force per square of the spacing in N/mm^2 above which a length was probably typed in cm, inches or m.  Magnets in contact have
about 1, since B^2/(2 mu_0) is 1 N/mm^2 at 1.6 T."""
LONGER = 0.2, 9.9  # spacings in mm between which cm or inches of a bench may be meant
IMPOSSIBLE = 1e8  # N/mm^2, which no slip of a length explains, but a b that was converted twice, by 1000^a
LOSSY = 5.0
"""A damping above this multiple of the frequency of the stiffest bond and spring, which lets no wave oscillate, was probably
typed in 1/s, if it is below that frequency once converted."""
SHORT = (4e-6, 0.04), (5e-6, 2e-4)
"""Radians of the stiffest bond and spring in a whole run, and in a time step, between which s was meant: 1000 times as many."""
HASTY = 3.0  # bonds passed in the time of such a radian, up to a thousand times which velocities were typed in mm/s
UNEQUAL = 1e9  # ratio of masses from which frequencies lose digits (4e-8 at 1e9, 4e-5 at 1e12): D holds K/sqrt(m m')
FAST = 30.0, 5.0
"""A frequency above the first multiple of that of the stiffest bond and spring was probably typed in Hz, if it is below the
second once converted.  The highest of a lattice is up to about four; a number of Hz is 159 times that of rad/ms."""
EPS = np.finfo(float).eps


def _stiffest(calc: Repulsion) -> tuple[float, float]:
    """Stiffness in N/mm of the stiffest bond, and of the stiffest spring of a site."""
    return calc.largest[1], float(np.max(abs(np.asarray(calc.foundation))))


def frequency_scale(calc: Repulsion) -> float:
    """Estimate of the highest frequency in Hz: that of the lightest particle on its spring and the stiffest bond."""
    return units.hertz(np.sqrt(sum(_stiffest(calc)) / calc.reference.get_masses().min()))


class UnitWarning(UserWarning):
    """A number that was probably typed in another unit: `what` is unlikely, and the `mend` in Python.

    Examples
    --------
    >>> from magphonon.stiffness.plausibility import UnitWarning
    >>> print(UnitWarning('a spring of 20 N/mm is stiff', 'if 20 N/m was meant, give 20 * units.N / units.m'))
    a spring of 20 N/mm is stiff; if 20 N/m was meant, give 20 * units.N / units.m
    """

    def __init__(self, what: str, mend: str) -> None:
        super().__init__(what, mend)
        self.what, self.mend = what, mend

    def __str__(self) -> str:
        return f'{self.what}; {self.mend}'


def _warn(what, mend):
    """Warn of a number, at the line outside this package that led to it."""
    frame, level = inspect.currentframe(), 1
    while frame and frame.f_back and frame.f_globals['__name__'].startswith('magphonon.'):
        frame, level = frame.f_back, level + 1
    warnings.warn(UnitWarning(what, mend), stacklevel=level)


def warn_of_units(calc: Repulsion) -> None:
    """Warn of masses and of springs in other units, and of frequencies beyond FREQUENCIES_Hz; say what was probably meant."""
    f, (least, most) = frequency_scale(calc), FREQUENCIES_Hz
    masses, shortest = calc.reference.get_masses(), calc.bonds.shortest
    _warn_of_masses(masses.min(), masses.max(), shortest)
    _warn_of_turning_and_layers(calc)
    if not f or least <= f <= most:
        _warn_of_stiffness(calc, shortest, *_stiffest(calc), has_units=shortest != 1 and masses.max() != 1)
    else:
        _warn(f'{calc.laws!r}, the foundation and the masses give frequencies of about {f:.1g} Hz, outside the range {least:g} '
              f'to {most:g} Hz', 'numbers are in mm, g, ms and N: multiply SI values by their units, as in '
              'InversePower(b=1.6e-10 * N * m**4.58, a=4.58) and 1e-3 * kg, see magphonon.units')


def _warn_of_masses(lightest, heaviest, shortest):
    density = heaviest / shortest**3
    dense = f'a mass of {heaviest:.6g} g every {shortest:.6g} mm is {1e3 * density:.2g} g/cm^3'
    if density > DENSITY:
        _warn(dense, 'numbers are in mm, g, ms and N: multiply SI values by their units, as in '
              'lattices.triangular(0.01 * m, 7e-4 * kg), see magphonon.units')
    elif density > TALL and shortest >= BENCH[0]:
        _warn(dense, f'if {heaviest:.6g} mg was meant, give {heaviest:.6g} * 1e-3 * units.g')
    if shortest >= BENCH[0] and lightest < BENCH[1]:
        _warn(f'a mass of {lightest:.6g} g is little for particles {shortest:.6g} mm apart',
              f'if {lightest:.6g} kg was meant, give {lightest:.6g} * units.kg')
    if (ratio := heaviest / lightest) > UNEQUAL:
        _warn(f'masses of {lightest:.3g} and {heaviest:.3g} g: the low frequencies, those of the heavy particles, are accurate '
              f'only to {EPS * ratio:.0e}', 'hold the heavy particles with FixAtoms, or take masses of at most '
              f'{UNEQUAL * lightest:.3g} g')


def _warn_of_stiffness(calc, shortest, bond, spring, has_units):
    if STIFF[0] * bond < spring < STIFF[1] * bond and spring > TYPED and has_units:
        _warn(f'the foundation of {spring:.6g} N/mm is {spring / bond:.3g} times as stiff as a bond', f'if {spring:.6g} N/m was '
              f'meant, give {spring:.6g} * units.N / units.m, which is {spring / 1e3:.6g} N/mm')
    if WEAK[0] * spring < bond < WEAK[1] * spring:
        _warn(f'the stiffest bond has {bond:.3g} N/mm beside a foundation of {spring:.6g} N/mm',
              'if b of the law was meant in N m^a, give b * units.N * units.m**a')
    force = calc.largest[0]
    if not force > PRESSURE * shortest**2 or not _repel(calc):
        return
    what, a = f'a force of {force:.3g} N between particles {shortest:.6g} mm apart is more than magnets can have', bond / force
    if LONGER[0] < shortest < LONGER[1] and force * 0.1 ** (2 + min(a * shortest, 100)) < PRESSURE * shortest**2:
        _warn(what, f'if {shortest:.6g} cm or inches were meant, give {shortest:.6g} * 10 * units.mm or {shortest:.6g} * 25.4 * '
              'units.mm')
    elif force > IMPOSSIBLE * shortest**2 and shortest >= BENCH[0]:
        _warn(what, 'give b of the law as b * units.N * units.m**a if it is in N m^a, and as it is if it is in N mm^a')


def _repel(calc):
    """Whether all particles repel each other: members in tension are no magnets."""
    R = calc.bonds.vectors[:, : calc.dim]
    return bool((np.einsum('bx,bx->b', calc.interaction.forces(R)[1], R) <= 0).all())


def _warn_of_turning_and_layers(calc):
    if calc.turning > FAST[0] * (scale := _scale(calc)) > 0 and calc.turning / units.s < scale:
        _warn(f'a gyration of {calc.turning:.6g} rad/ms is far above the frequencies of the structure',
              f'if {calc.turning:.6g} rad/s was meant, give {calc.turning:.6g} / units.s')
    if calc.dim == 3 and calc.reference.pbc.all():
        for axis in np.flatnonzero(~calc.bonds.shift.any(axis=0)):
            _warn(f'no particles interact across the period of {np.linalg.norm(calc.reference.cell[axis]):.6g} mm along the cell '
                  f'vector {"abc"[axis]}, so that nothing holds a layer there', 'for motion in the plane set atoms.pbc = '
                  f'{tuple(bool(x) for x in np.arange(3) != axis)} before the calculator is made')


def _scale(calc):
    """`frequency_scale` in rad/ms; zero for another calculator."""
    return frequency_scale(calc) * 2 * np.pi * units.Hz if hasattr(calc, 'bonds') else 0.0


def site_damping(damping: ArrayLike, particles: int, calc: Any = None) -> NDArray[np.float64]:
    """The damping of each particle in 1/ms, shape (particles,), from one number or one for each; zero or above, or ValueError.

    Warns of rates that look like 1/s for a `calc`.
    """
    given = finite('damping', damping)
    if given.shape not in ((), (particles,)):
        raise ValueError(f'damping must be one number or one for each of the {particles} particles, not the shape {given.shape}')
    not_negative('damping', float(given.min(initial=0.0)), '1/ms')
    least, scale = float(given.min(initial=np.inf)), _scale(calc)
    if LOSSY * scale < least < np.inf and given.max() / units.s < scale:
        _warn(f'a damping of {least:.6g} 1/ms lets nothing oscillate',
              f'if {least:.6g} 1/s was meant, give {least:.6g} / units.s')
    return np.broadcast_to(given, particles)


def warn_of_times(calc: Any, last: float, timestep: bool = False) -> None:
    """Warn of a duration, or of a time step, in ms that was probably typed in s."""
    radians, (least, most) = _scale(calc) * last, SHORT[timestep]
    if least < radians < most:
        _warn(f'{"time steps of" * timestep or "times up to"} {last:.6g} ms are {radians:.2g} radians of the fastest motion',
              f'if {last:.6g} s was meant, give {last:.6g} * units.s')


def warn_of_speed(calc: Any, velocities: NDArray[np.float64]) -> None:
    """Warn of velocities in mm/ms that would move a particle beyond a bond, and were probably typed in mm/s."""
    fastest, scale = float(np.sqrt((velocities**2).sum(axis=-1).max(initial=0.0))), _scale(calc)
    if scale and HASTY < fastest / (scale * calc.bonds.shortest) < HASTY * units.s:
        _warn(f'a velocity of {fastest:.4g} mm/ms would move a particle by {fastest / scale:.3g} mm, beyond its neighbours',
              f'if {fastest:.4g} mm/s was meant, give {fastest:.4g} * units.mm / units.s')


def warn_of_amplitude(calc: Any, displacements: NDArray[np.float64]) -> None:
    """Warn of a linear answer that moves particles by more than the shortest bond."""
    most = float(abs(displacements).max(initial=0.0))
    if most > (shortest := calc.bonds.shortest):
        _warn(f'particles move by up to {most:.3g} mm, more than the {shortest:.6g} mm between them, where linear theory fails',
              f'take forces {most / (0.01 * shortest):.2g} times smaller for a hundredth of the spacing, or DrivenVerlet')


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
        if w > FAST[0] * scale > 0 and abs(omega).max() / units.s < FAST[1] * scale:
            _warn(f'omega = {w:.4g} rad/ms is {w / hertz:.4g} Hz, far above the frequencies of the structure, about '
                  f'{scale / hertz:.3g} Hz', f'if {w:.4g} Hz was meant, give {w:.4g} * 2 * pi * units.Hz, which is '
                  f'{w * hertz:.4g} rad/ms; if {w:.4g} rad/s was meant, give {w:.4g} / units.s')


def refuse_infinite(calc: PairCalculator) -> None:
    """Refuse a law whose force or stiffness at some bond is not a finite number."""
    if np.isfinite(calc.largest).all():
        return
    bonds = calc.bonds
    for what, unit, value in zip(('force', 'stiffness'), ('N', 'N/mm'), calc.bond_sizes, strict=True):
        for b in np.flatnonzero(~np.isfinite(value))[:1]:
            raise ValueError(f'the law {shown(calc.laws)} gives the {what} {value[b]} {unit} at the distance '
                             f'{bonds.lengths[b]:g} mm of the particles {bonds.i[b]} and {bonds.j[b]}; check its parameters and '
                             'their units (mm, N)')
