"""Millimetre, gram, millisecond: the units inside magphonon, used like those of `ase.units`.

With them 1 g mm/ms^2 = 1 N and 1 N mm = 1 mJ, so the numbers of a lattice of magnets are near one and no
formula needs a conversion factor.  Multiply inputs by units, divide results by them::

    spacing = 10 * mm            law = InversePower(b=1.6209e-10 * N * m**4.5824, a=4.5824)
    frequency / Hz               stiffness / (N / m)

Angular frequencies are in rad/ms, frequencies in kHz = 1/ms, speeds in mm/ms = m/s.
"""

from __future__ import annotations

from math import floor, log10, pi
from typing import Any

mm = g = ms = rad = A = 1.0
m = kg = s = 1e3
N = kg * m / s**2
J = N * m
mJ = N * mm
Pa = N / m**2
GPa = 1e9 * Pa
Hz = 1 / s
kHz = 1e3 * Hz
T = N / (A * m)
deg = pi / 180
mu0 = 1.25663706127e-6 * N / A**2
"""Magnetic constant, CODATA 2022."""
c = 299792458 * m / s
"""Speed of light."""


def hertz(omega: Any) -> Any:
    """Frequency in Hz of an angular frequency in rad/ms."""
    return omega / (2 * pi) / Hz


PREFIXES = {-18: 'a', -15: 'f', -12: 'p', -9: 'n', -6: 'µ', -3: 'm', 0: '', 3: 'k', 6: 'M', 9: 'G', 12: 'T'}
"""Prefixes of a unit by the power of ten."""


def prefix_power(value: float) -> int:
    """Power of ten of the prefix with which a value is printed as 1 to 999, one of `PREFIXES`."""
    power = 3 * floor((log10(abs(value)) + 1e-9) / 3) if value else 0  # 1e-9: 0.999999999 m is a rounded metre
    return min(max(power, min(PREFIXES)), max(PREFIXES))


def in_words(unit: str, *values: float, digits: int = 4) -> str:
    """One value, or a range, with the prefix of the unit that suits the largest: `in_words('m', 2e-5)` is '20 µm'."""
    power = prefix_power(max(map(abs, values)))
    rounded = [float(f'{value / 10.0**power:.{digits}g}') for value in values]  # 310 and not 3.1e+02
    return ' to '.join(f'{value:.{max(digits, 4)}g}' for value in rounded) + f' {PREFIXES[power]}{unit}'
