"""Drives are the functions of time that they say, on the particles that they name."""

import numpy as np
import pytest
from ase.constraints import FixedLine
from motion import DT, patch

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, ToneBurst, lattices, propagate
from magphonon.dynamics import Constant, Harmonic
from magphonon.response.frf import frequency_response, harmonic_response


def test_drives_are_what_they_say():
    t = np.linspace(0, 40, 401)
    burst = ToneBurst([3], (0, 2), 1.5, omega=0.8, cycles=5, start=4.0)
    inside = (t >= 4) & (t <= burst.end)
    expected = np.where(inside, 1.5 * np.sin(0.8 * (t - 4)) * np.sin(0.8 * (t - 4) / 10) ** 2, 0)
    assert burst.end == pytest.approx(4 + 5 * 2 * np.pi / 0.8)
    assert abs(burst(t)[:, 0] - np.outer(expected, (0, 1, 0))).max() < 1e-14
    omega, phase = np.array([0.1, 0.2]), np.array([0.0, 1.0])
    drive = Harmonic([1, 2], (3, 4), [1.0, 2.0], omega, phase)
    force = np.array([1.0, 2.0]) * np.sin(np.outer(t, omega) + phase)
    assert abs(drive(t) - force[..., None] * (0.6, 0.8, 0)).max() < 1e-14
    assert np.array_equal(drive(7.0), drive(np.array([7.0]))[0])
    constant = Constant(0, (0, 0, 1), 2.0)
    assert np.array_equal(constant(5.0), [[0, 0, 2.0]])
    assert np.array_equal(constant(t), np.tile([0, 0, 2.0], (len(t), 1, 1)))


@pytest.mark.parametrize(('make', 'words'), [
    (lambda: Harmonic([-1], (1, 0), 1, 1), 'particles must be different indices'),
    (lambda: Harmonic([1, 1], (1, 0), 1, 1), 'particles must be different'),
    (lambda: Harmonic([0.5], (1, 0), 1, 1), 'particles must be'),
    (lambda: Harmonic([[1], [2, 3]], (1, 0), 1, 1), 'particles must be'),
    (lambda: Harmonic([1], (0, 0), 1, 1), 'direction must be a vector'),
    (lambda: Harmonic([1], (1, 0, 0, 0), 1, 1), 'direction must be a vector'),
    (lambda: Harmonic([1, 2], (1, 0), [1, 2, 3], 1), 'one for each of the 2 particles'),
    (lambda: Harmonic([1], (1, 0), np.inf, 1), 'amplitude'),
    (lambda: ToneBurst([1], (1, 0), 1, omega=0), 'omega must be a positive number in rad/ms'),
    (lambda: ToneBurst([1], (1, 0), 1, omega=1, cycles=0), 'cycles must be'),
    (lambda: ToneBurst([1], (1, 0), 1, omega=1, start=np.nan), 'start'),
])
def test_bad_drives_are_refused(make, words):
    with pytest.raises(ValueError, match=words):
        make()


def test_bad_forces_are_refused():
    for drive, words in ((lambda t: np.zeros((3, 3)), 'must have the shape'), (lambda t: np.full((49, 3), np.nan), 'finite'),
                         (Constant([24], (0, 0, 1), 1.0), 'along z'), (lambda t: np.ones((49, 3)), 'along z')):
        with pytest.raises(ValueError, match=words):
            DrivenVerlet(patch(), DT, drives=[drive], engine='compiled').run(3)


AT_THE_RIM, INSIDE = 0, 12


def guided():
    atoms = lattices.parallelogram(lattices.square(10.0, 0.7), 5, 5)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=5e3, a=4.0), foundation=0.02)
    atoms.set_constraint([*atoms.constraints, FixedLine(INSIDE, (0.6, 0.8, 0))])
    return atoms


@pytest.mark.parametrize('drive', [
    ToneBurst(AT_THE_RIM, (1, 0), 1e-3, 0.3),
    Harmonic([AT_THE_RIM, INSIDE], (0.8, -0.6), [1e-3, 1e-3], 0.3),  # one on the rim, one across its guide
    Constant([AT_THE_RIM, INSIDE], (1, 0), [1e-3, 0.0]),  # no force on the one that is free
])
def test_a_drive_on_what_is_held_is_refused(drive):
    message = f'the drive {type(drive).__name__} pushes particle.*would do nothing'
    with pytest.raises(ValueError, match=message):
        DrivenVerlet(guided(), 0.1, [drive])
    with pytest.raises(ValueError, match=message):
        propagate(guided(), [1.0], [drive])
    force = np.zeros((25, 3))
    strength = drive.force if isinstance(drive, Constant) else drive.amplitude
    force[drive.particles] = strength[:, None] * drive.direction
    for response in (frequency_response, harmonic_response):
        with pytest.raises(ValueError, match=r'the force pushes particle.*would do nothing'):
            response(guided(), force, [0.3], 0.01)


def test_a_row_that_touches_the_rim_is_driven():
    """What the rim holds of it is lost; the rest moves as if the rim had not been named."""
    row, along = Harmonic([AT_THE_RIM, 11, INSIDE], (0.6, 0.8), 1e-3, 0.3), Harmonic([11, INSIDE], (0.6, 0.8), 1e-3, 0.3)
    found, expected = (propagate(guided(), [5.0, 9.0], [drive]).displacements for drive in (row, along))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-15)
    assert abs(found[:, [11, INSIDE]]).max() > 1e-4
    dyn = DrivenVerlet(guided(), 0.1, [row])
    dyn.run(90)
    np.testing.assert_allclose(dyn.displacements, expected[1], atol=2e-2 * abs(expected).max())  # (omega dt)^2/24 and strains
