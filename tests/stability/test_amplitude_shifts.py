"""Amplitude dependence of frequencies: closed forms of the oscillator, and runs of lattices."""

import numpy as np
import pytest
from ase.constraints import FixedLine

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Recorder, Yukawa, lattices
from magphonon.interactions.pair_laws import higher_derivatives
from magphonon.stability import frequency_shifts

LAW = InversePower(1.0, 4.0)


def oscillator(theta0):
    atoms = lattices.oscillator(theta0, 1.0, 1.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, bonds=lattices.OSCILLATOR_BONDS).balanced([3])
    atoms.set_constraint([*atoms.constraints, FixedLine(3, (0, 1, 0))])
    return atoms


def derivatives_of_energy(atoms, h=0.02):
    """k and beta of V = k y^2/2 + alpha y^3/3 + beta y^4/4 by differences of the energy, good to some h^2 of themselves."""
    home, energies = atoms.positions.copy(), []
    for step in (-2, -1, 0, 1, 2):
        atoms.positions[3] = home[3] + [0, step * h, 0]
        energies.append(atoms.get_potential_energy())
    V = np.array(energies)
    return V @ [-1, 16, -30, 16, -1] / (12 * h**2), V @ [1, -4, 6, -4, 1] / (6 * h**4)


@pytest.mark.parametrize(('theta0', 'curvature'), [(0.0, -275 / 48), (np.pi / 2, -35 / 48)])
def test_oscillator_softens_by_its_closed_form(theta0, curvature):
    # from V = k y^2/2 + alpha y^3/3 + beta y^4/4: dw/w = (3 beta/(8 k) - 5 alpha^2/(12 k^2)) A^2
    shifts = frequency_shifts(oscillator(theta0))
    assert shifts.curvature == pytest.approx([curvature], rel=1e-10)
    assert shifts.amplitude(0.01) == pytest.approx(np.sqrt(0.01 / abs(curvature)), rel=1e-10)
    # control: without the third derivative of the energy the frequency would rise
    k, beta = derivatives_of_energy(oscillator(theta0))
    assert 3 * beta / (8 * k) > 1 > 0 > shifts.curvature


@pytest.mark.parametrize('a', [2.0, 4.5824, 9.0])
def test_above_three_magnets_for_any_exponent(a):
    # theta0 = pi/2: V = 3 phi(1 + y), k = 3 a, alpha = -3 a (a+1)/2, beta = a (a+1)(a+2)/2
    atoms = oscillator(np.pi / 2)
    atoms.calc = MagneticRepulsion(atoms, InversePower(1.0, a), bonds=lattices.OSCILLATOR_BONDS).balanced([3])
    expected = 3 / 16 * (a + 1) * (a + 2) / 3 - 5 / 48 * (a + 1) ** 2
    assert frequency_shifts(atoms).curvature == pytest.approx([expected], rel=1e-10)


@pytest.mark.parametrize('mode', [0, 1])
def test_wave_at_m_is_shifted_as_in_a_run(mode):
    """Two rows of the triangular lattice, moving against each other, at two amplitudes: what remains grows as A^4."""
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=7.0)
    shifts = frequency_shifts(cell)
    first = np.flatnonzero((shifts.q == (0.5, 0, 0)).all(axis=1))[mode]
    omega, curvature = shifts.omega[first], shifts.curvature[first]
    assert omega**2 == pytest.approx((2 * (4 - 3), 6 * 4 - 2)[mode] + 7.0, rel=1e-12)
    direction = np.array([(1, np.sqrt(3)), (np.sqrt(3), -1)][mode]) / 2

    def run(amplitude):
        pair = cell.repeat((2, 1, 1))
        pair.calc = MagneticRepulsion(pair, LAW, foundation=7.0)
        pair.positions[:, :2] += amplitude * np.array([direction, -direction])
        dyn = DrivenVerlet(pair, 0.04 / omega, engine='numpy')
        recorder = Recorder(dyn, interval=1)
        dyn.run(int(8 * 2 * np.pi / 0.04))
        x = recorder.displacements[:, 0] @ direction
        down = np.flatnonzero((x[:-1] > 0) & (x[1:] <= 0))
        crossings = (down + x[down] / (x[down] - x[down + 1])) * dyn.dt
        discrete = 2 * np.arcsin(0.02) / 0.04  # the frequency of Verlet's steps over the true one
        return 2 * np.pi / ((crossings[-1] - crossings[0]) / (len(crossings) - 1)) / omega / discrete - 1

    for amplitude in (0.01, 0.03):
        # the next order is some (10 A)^2 of this one, and crossings interpolate to 4e-6
        assert run(amplitude) == pytest.approx(curvature * amplitude**2, rel=100 * amplitude**2, abs=4e-6)


@pytest.mark.parametrize('a', [4.0, 5.0])
def test_the_twist_of_kagome_stiffens_by_its_closed_form(a):
    # triangles turn rigidly, so that a particle moves by A and each bond of a cell's six grows to sqrt(1 + 3 A^2): its energy is
    # 3/2 (k - 6) A^2 + 27/4 (a + 1) A^4 with three particles of unit mass
    cell = lattices.kagome(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, a), foundation=6.06)
    shifts = frequency_shifts(cell)
    softest = shifts.omega.argmin()
    assert shifts.omega[softest] ** 2 == pytest.approx(0.06, rel=1e-9)
    assert shifts.curvature[softest] == pytest.approx(27 / 8 * (a + 1) / 0.06, rel=1e-6)  # circles in the plane: 1e-11/0.06
    # the control: the edges of the zone alone know nothing of it
    edges = shifts.q.any(axis=1)
    assert abs(shifts.curvature[edges]).max() < 0.1 * shifts.curvature[softest]


def test_an_unstable_mode_does_not_vibrate():
    chain = lattices.chain(1.0, 1.0)
    chain.calc = MagneticRepulsion(chain, LAW)
    shifts = frequency_shifts(chain)
    assert shifts.omega == pytest.approx([4.0])  # of the two waves at X, the longitudinal one: 4 a f/(L0 m)


def test_amplitude_shrinks_to_nothing_at_the_threshold():
    def amplitude(a):
        cell = lattices.triangular(1.0, 1.0)
        cell.calc = MagneticRepulsion(cell, InversePower(1.0, a))
        return frequency_shifts(cell).amplitude(0.01)

    # the shear stiffness at M goes as a - 3, so dw/w over A^2 as its inverse
    assert amplitude(3.0001) / amplitude(3.01) == pytest.approx(0.1, rel=0.02)


@pytest.mark.parametrize('law', [InversePower(2.0, 4.5), Yukawa(3.0, 0.7)])
def test_higher_derivatives(law):
    # the complex step of phi'' and differences of it
    r, h = np.array([1.3, 2.1]), 1e-20
    third, fourth = higher_derivatives(law, r)
    exact = [law.d2phi(x + 1j * h).imag / h for x in (r, r + 1e-4, r - 1e-4)]
    np.testing.assert_allclose(third, exact[0], rtol=1e-10)
    np.testing.assert_allclose(fourth, (exact[1] - exact[2]) / 2e-4, rtol=1e-6)  # 1e-8 of differences, times (a + 4)^2/6
