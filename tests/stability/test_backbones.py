"""Vibrations of finite amplitude: the backbone against closed forms and the period of a run."""

import numpy as np
import pytest
from ase.constraints import FixedLine

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Yukawa, lattices
from magphonon.response.frf import Dof
from magphonon.response.normal_modes import modes
from magphonon.response.stepped import stepped_response
from magphonon.stability.amplitude_shifts import frequency_shifts, vibration

LAW, YUKAWA = InversePower(1.0, 4.0), Yukawa(1.0, 2.0)
UP = Dof(3, [0.0, 1.0, 0.0])


def oscillator(degrees, law=LAW):
    atoms = lattices.oscillator(np.deg2rad(degrees), 1.0, 1.0)
    atoms.set_constraint([*atoms.constraints, FixedLine(3, (0, 1, 0))])
    atoms.calc = MagneticRepulsion(atoms, law, bonds=lattices.OSCILLATOR_BONDS).balanced([3])
    return atoms


@pytest.mark.parametrize(('degrees', 'coefficient'), [(0, -275 / 48), (90, -35 / 48)])
def test_small_amplitudes_follow_the_closed_form(degrees, coefficient):
    atoms = oscillator(degrees)
    linear = modes(atoms)
    for A in (1e-3, 1e-2):
        shift = vibration(atoms, linear, 0, lambda W, A=A: A).omega / linear.omega[0] - 1
        # the next term is (A/L0)^2 of the first, times 5 and less
        assert shift == pytest.approx(coefficient * A**2, rel=10 * A**2, abs=1e-12)


def test_a_vibration_of_a_patch_returns_after_its_period():
    """Started in the shape found, time stepping comes back to it; with the period of the linear mode it does not."""
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW)
    patch = lattices.hexagon(cell, 2.0)
    patch.calc = MagneticRepulsion(patch, LAW)
    linear = modes(patch)
    found = vibration(patch, linear, 0, lambda W: 0.05)
    start = np.einsum('m,mix->ix', found.harmonics.sum(axis=0), linear.shapes)

    def miss(omega):
        atoms, steps = patch.copy(), 2000
        atoms.calc = patch.calc
        atoms.positions[:, :2] += start
        dyn = DrivenVerlet(atoms, 2 * np.pi / omega / steps, engine='numpy')
        dyn.run(steps)
        return abs(dyn.displacements - start).max() / abs(start).max()

    # steps of T/2000 turn the phase by 2 pi (2 pi/2000)^2/24 = 3e-6, and the ends of an oscillation are flat
    assert miss(found.omega) < 1e-4
    assert abs(found.omega / linear.omega[0] - 1) > 1e-3
    assert miss(linear.omega[0]) > 10 * miss(found.omega)


def test_the_backbone_starts_with_the_curvature_of_second_order():
    """Of a patch without symmetry, softest and stiffest mode; the other way there contracts third and fourth derivatives."""
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, LAW)
    patch = lattices.parallelogram(cell, 5, 6)
    patch.calc = MagneticRepulsion(patch, LAW, foundation=0.3)
    linear, shifts, A = modes(patch), frequency_shifts(patch), 1e-3
    for mode, curvature in zip((0, -1), shifts.curvature, strict=True):
        largest = np.linalg.norm(linear.shapes[mode], axis=1).max()
        found = vibration(patch, linear, mode, lambda W, largest=largest: A / largest)
        # the next order is A^2 times some hundred
        assert found.omega / linear.omega[mode] - 1 == pytest.approx(curvature * A**2, rel=3e-4)


def test_the_driven_peak_stands_on_the_backbone():
    """The steady response in time steps peaks where the plan says, not at the linear frequency."""
    atoms, damping = oscillator(90), 0.1
    linear = modes(atoms)
    force = 0.08 * damping * linear.omega[0]
    swing = vibration(atoms, linear, 0, lambda W: force / (damping * W))
    off = np.linspace(-0.012, 0.012, 13)
    response = abs(stepped_response(atoms, UP, UP, swing.omega * (1 + off), damping, force, dt=0.02).response)
    curve, fine = np.polyfit(off, response, 4), np.linspace(-0.012, 0.012, 2001)
    peak = fine[np.polyval(curve, fine).argmax()]
    # damping moves the peak by -(gamma/2w)^2 = -2e-4, time steps by (w dt)^2/24 = 2e-4, the transient the fit by as much
    assert peak == pytest.approx(0, abs=8e-4)
    assert linear.omega[0] / swing.omega - 1 > 4e-3


def test_a_vibration_through_the_magnets_is_refused_as_none():
    atoms = oscillator(0)
    with pytest.raises(ValueError, match=r'no periodic vibration of 2 mm, 200 % of the shortest bond.* smaller amplitude'):
        vibration(atoms, modes(atoms), 0, lambda W: 2.0)
