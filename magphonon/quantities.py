"""Units of files by name, each in mm, g and ms, and the name that this package gives to a unit as an instrument writes it."""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from . import units as u

GRAVITY = 9.80665 * u.m / u.s**2
GRAM_FORCE = 1e-3 * u.kg * GRAVITY
LENGTH = {'m': u.m, 'mm': u.mm, 'um': 1e-3 * u.mm, 'nm': 1e-6 * u.mm, 'cm': 10 * u.mm, 'in': 25.4 * u.mm}
TIME = {'s': u.s, 'ms': u.ms, 'us': 1e-3 * u.ms}
FORCE = {'N': u.N, 'mN': 1e-3 * u.N, 'uN': 1e-6 * u.N, 'kN': 1e3 * u.N} | {
    name: grams * GRAM_FORCE for name, grams in (('gf', 1.0), ('g', 1.0), ('kgf', 1e3), ('mgf', 1e-3), ('lbf', 453.59237))}
"""Units of forces, including the gram of a balance, which is the weight of a gram."""
MASS = {'kg': u.kg, 'g': u.g, 'mg': 1e-3 * u.g}
SPEED = {f'{length}_per_{time}': x / t for length, x in LENGTH.items() for time, t in TIME.items()}
STIFFNESS = {f'{force}_per_{length}': f / x for force, f in FORCE.items() for length, x in LENGTH.items()}
FREQUENCY = {'Hz': 2 * np.pi * u.Hz, 'kHz': 2 * np.pi * u.kHz}  # an angular frequency in rad/ms
AREA = {'m2': u.m**2, 'mm2': u.mm**2}
ANGLE = {'rad': 1.0}
PURE = {'': 1.0}
TEXT: dict[str, float] = {}
"""Units of a column of words."""
MOTIONS = {f'{length}{per}': (factor * u.s**-order, order) for length, factor in LENGTH.items()
           for order, per in enumerate(('', '_per_s', '_per_s2'))} | {'g': (GRAVITY, 2)}
"""Units of measured motions in mm and ms, and how often the displacement is differentiated."""
SPELT = {'hz': 'Hz', 'hertz': 'Hz', 'khz': 'kHz', 'sec': 's', 'sek': 's', 'seconds': 's', 'msec': 'ms', 'newton': 'N',
         '°': 'deg', 'degrees': 'deg', 'grad': 'deg', 'degree': 'deg', 'radians': 'rad', 'micron': 'um', '-': '', '1': '',
         'gf': 'gf', 'lb': 'lbf', 'lbs': 'lbf', 'inch': 'in', 'inches': 'in'}
"""Units as instruments spell them, in small letters."""
SIGNS = str.maketrans({'µ': 'u', 'μ': 'u', '²': '2', **dict.fromkeys('[]()^*·. ')})
ATOM = re.compile(r'([munk]?N|[munc]?m|in|[mu]?s|[km]?gf|lbf)(2?)')


def named_unit(unit: str, units: Mapping[str, float]) -> str | None:
    """The name in `units` of a unit as an instrument writes it; None if it is none of them.

    Examples
    --------
    >>> from magphonon.quantities import FORCE, LENGTH, SPEED, named_unit
    >>> named_unit('µm', LENGTH), named_unit('(mm/s)', SPEED), named_unit('lbs', FORCE), named_unit('ft', LENGTH)
    ('um', 'mm_per_s', 'lbf', None)
    """
    plain = unit.strip().strip('[]()')
    plain = SPELT.get(plain.lower(), plain)
    if plain in units or not (plain or units):
        return plain
    return next((name for name in units if name and _parts(name) == _parts(unit)), None)


def _parts(unit):
    """Numerator and sorted denominators of a unit: those of m/(N·s), (m/s)/N and m_per_s_per_N are the same."""
    over, *under = unit.translate(SIGNS).replace('_per_', '/').replace('sec', 's').split('/')
    below = ''.join(under)
    return over, ATOM.sub('', below), sorted(atom for atom, square in ATOM.findall(below) for _ in range(2 if square else 1))
