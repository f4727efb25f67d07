"""Complex wavenumbers against closed forms, the bands, and the direct solution of finite lattices."""

import numpy as np
import pytest

from magphonon import lattices, units
from magphonon.bands.bloch import bloch_modes
from magphonon.bands.evanescent import complex_bands
from magphonon.interactions.pair_laws import InversePower
from magphonon.response.frf import harmonic_response
from magphonon.stiffness.calculator import MagneticRepulsion

# The paper's prototype (Supplement).  Along Gamma-M: omega^2 = cut-off^2 + (edge sin(xi/2))^2
CUTOFF_Hz = 26.550686524
EDGE_Hz = {'complete': (51.8276683282, 147.099410946),  # shear, longitudinal at M without foundation, recomputed
           # sqrt(2a), sqrt(6a) f/(L M) with f = 0.236895178822 N, a = 4.5824: the same without D*
           'conventional': tuple(np.sqrt(k * 4.5824 * 0.236895178822 / (0.01 * 7.07e-4)) / (2 * np.pi) for k in (2, 6))}
LAW = InversePower(b=1.6209e-10 * units.N * units.m**4.5824, a=4.5824)
FOUNDATION = 19.675721234 * units.N / units.m
GAMMA_M, GAMMA_K = (0, 1, 0), (1 / 2, 1, 0)


def prototype(lattice=lattices.triangular, foundation=FOUNDATION, **bonds):
    cell = lattice(spacing=10 * units.mm, mass=0.707 * units.g)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=foundation, **bonds)
    return cell


def rad_per_ms(frequency_Hz):
    return 2 * np.pi * np.atleast_1d(frequency_Hz) * units.Hz


@pytest.mark.parametrize('frequency_Hz', [0, 15, 26.5, 26.6, 40, 60, 150, 300])
@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_row_of_sources_in_the_prototype_is_the_closed_form(frequency_Hz, model):
    found = complex_bands(prototype(), GAMMA_M, rad_per_ms(frequency_Hz), model).xi[0]
    sine = np.sqrt(frequency_Hz**2 - CUTOFF_Hz**2 + 0j) / np.array(EDGE_Hz[model])
    expected = 2 * np.arcsin(sine)
    found, expected = (abs(xi.real) + 1j * abs(xi.imag) for xi in (found, expected))
    found, expected = (xi[np.argsort(abs(xi.real) + abs(xi.imag))] for xi in (found, expected))
    # the reference frequencies carry 11 digits; 0.05 Hz beside the cut-off the root of a difference amplifies 1e-10 by 1e3
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-7)


def test_a_driven_row_decays_as_the_complex_wavenumber_says():
    strip = prototype().repeat((1, 40, 1))
    strip.pbc = (True, False, False)  # the free ends lie tens of decay lengths away
    strip.calc = MagneticRepulsion(strip, LAW, foundation=FOUNDATION).balanced([0, 39])  # what the missing neighbours did
    omega = rad_per_ms(15.0)
    for axis, decay in ((0, 0.822055), (1, 0.296770)):  # 2 arsinh(sqrt(26.5507^2 - 15^2)/edge): shear, longitudinal
        force = np.zeros((40, 3))
        force[0, axis] = 1
        u = harmonic_response(strip, force, omega, damping=0.0).response[0, :, axis]
        ratio = -np.polyfit(np.arange(2, 12), np.log(abs(u[2:12])), 1)[0]
        assert ratio == pytest.approx(decay, abs=2e-6)  # the closed form's printed digits, the far end e^-20
        own = complex_bands(prototype(), GAMMA_M, omega)
        assert abs(own.xi.imag - ratio).min() < 1e-8
        wrong = complex_bands(prototype(), GAMMA_M, omega, 'conventional').xi.imag
        assert abs(wrong / ratio - 1).min() > 0.03  # longitudinal 4 %, shear 40 %


def test_waves_are_sorted_counted_and_say_how_far_they_reach():
    waves = complex_bands(prototype(), GAMMA_K, rad_per_ms([15, 40, 60]))
    assert waves.xi.shape == (3, 4)  # 2 components, bonds bridging up to 2 half steps
    assert waves.vectors.shape == (3, 4, 1, 2)
    assert (np.diff(waves.xi.imag, axis=1) >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(waves.vectors, axis=(2, 3)), 1)
    assert (waves.decay_steps[1:, 0] == np.inf).all()
    assert waves.decay_steps[0, 0] == pytest.approx(1 / waves.xi[0, 0].imag)
    along = np.array([1, np.sqrt(3)]) / 2
    assert abs(waves.vectors[0, 0, 0] @ along) == pytest.approx(1)  # the slowest is longitudinal


def test_an_unstable_band_is_met_at_its_negative_frequency():
    chain = prototype(lattices.chain, foundation=0.0)  # buckles: transverse omega^2 = 2 phi'/(m r) (1 - cos xi) < 0
    omega = bloch_modes(chain, [0.2, 0, 0])[0][0]
    assert omega[0] < 0
    assert abs(complex_bands(chain, (1, 0, 0), [omega[0]]).xi[0] - 0.4 * np.pi).min() < 1e-9
    assert abs(complex_bands(chain, (1, 0, 0), [-omega[0]]).xi[0] - 0.4 * np.pi).min() > 0.1


def test_waves_that_end_at_once_are_infinite_and_not_round_off():
    kagome = prototype(lattices.kagome, foundation=0.3)
    decay = complex_bands(kagome, GAMMA_K, [0.5, 0.7]).xi.imag
    assert np.isinf(decay).sum() == 2 * 8  # the outermost bonds couple few of the six components
    assert decay[np.isfinite(decay)].max() < 10


def test_a_flat_band_has_no_wavenumber():
    honeycomb = prototype(lattices.honeycomb)
    flat = np.sqrt(FOUNDATION / 0.707)  # without D* the honeycomb has a floppy mode at every wavevector
    with pytest.raises(ValueError, match=r'at omega = 0\.1668\d* rad/ms a band is flat'):
        complex_bands(honeycomb, GAMMA_M, [0.1, flat], 'conventional')
    assert np.isfinite(complex_bands(honeycomb, GAMMA_M, [0.1, 1.001 * flat], 'conventional').xi[:, 0]).all()
