"""Millimetre, gram, millisecond: a coherent system, in which no formula needs a factor."""

import math

import pytest
from scipy import constants

from magphonon import units as u

# Products of powers of ten: round-off only.
EXACT = 4e-16


@pytest.mark.parametrize(('left', 'right'), [
    (u.N, u.g * u.mm / u.ms**2),
    (u.N, u.kg * u.m / u.s**2),
    (u.J, u.kg * u.m**2 / u.s**2),
    (u.mJ, u.N * u.mm),
    (u.mJ, 1e-3 * u.J),
    (u.Pa, u.N / u.m**2),
    (u.GPa, 1e3 * u.N / u.mm**2),
    (u.Hz, 1 / u.s),
    (u.kHz, 1 / u.ms),
    (u.m / u.s, u.mm / u.ms),
    (u.T, u.kg / (u.A * u.s**2)),
    (180 * u.deg, math.pi * u.rad),
], ids=str)
def test_derived_units(left, right):
    assert left == pytest.approx(right, rel=EXACT)


def test_magnetic_constant():
    # CODATA 2018 and 2022, of which SciPy may hold either, differ by 1.2e-10
    assert u.mu0 / (u.N / u.A**2) == pytest.approx(constants.mu_0, rel=1e-9)


def test_a_harmonic_oscillator_comes_out_in_hertz():
    # 1 kg on 4 pi^2 N/m swings once a second
    omega = math.sqrt(4 * math.pi**2 * u.N / u.m / u.kg)
    assert omega / (2 * math.pi) / u.Hz == pytest.approx(1, rel=EXACT)
    assert u.hertz(omega) == pytest.approx(1, rel=EXACT)
