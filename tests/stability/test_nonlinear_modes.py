"""Families of periodic vibrations: a period by quadrature, perturbation theory, time steps on both sides of stability."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from scipy.integrate import quad

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Recorder, lattices, modes
from magphonon.errors import PhysicsError
from magphonon.stability import frequency_shifts, nonlinear_modes

LAW = InversePower(1.0, 4.0)


def row(masses, lines=True):
    atoms = lattices.chain(1.0, 1.0).repeat((len(masses), 1, 1))
    atoms.pbc = False
    atoms.set_masses(masses)
    held = [FixAtoms([0, len(masses) - 1])]
    atoms.set_constraint([*held, *(FixedLine(k, (1, 0, 0)) for k in range(1, len(masses) - 1))] if lines else held)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.0 if lines else 6.0)
    return atoms


@pytest.fixture(scope='module')
def light():
    """A row with a light particle in the middle, and the family of its local mode."""
    atoms = row([1, 1, 1, 1, 0.5, 1, 1, 1, 1])
    return atoms, nonlinear_modes(atoms, 6, 0.26, points=14)


def test_one_particle_has_the_period_of_its_energy():
    family = nonlinear_modes(row([1.0, 0.8, 1.0]), 0, 0.35, points=4)

    def energy(x):
        return ((1 + x) ** -3 + (1 - x) ** -3) / 3

    for A, omega in zip(family.amplitude, family.omega, strict=True):
        quarter = quad(lambda s, A=A: A * np.cos(s) / np.sqrt(2 / 0.8 * (energy(A) - energy(A * np.sin(s)))), 0, np.pi / 2)[0]
        assert omega == pytest.approx(2 * np.pi / (4 * quarter), rel=2e-4)  # the seventh harmonic is left out
    assert family.stable.all()
    assert family.omega[-1] > 1.2 * family.omega[0]


def drawn_patch(rng):
    """Seven particles of drawn masses, law and springs, each at rest."""
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 1.1)
    patch.set_masses(rng.uniform(0.5, 2, len(patch)))
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, rng.uniform(2, 6)), foundation=rng.uniform(12, 20)).balanced(
        np.arange(len(patch)))
    return patch


@pytest.mark.parametrize('seed', range(2))
def test_families_of_the_conventional_model_start_by_its_own_shifts(seed):
    rng = np.random.default_rng([seed, 8])
    patch = drawn_patch(rng)
    complete = frequency_shifts(patch).curvature[-1]
    patch.calc.set(model='conventional')
    shift, last = frequency_shifts(patch), len(modes(patch).omega) - 1
    family = nonlinear_modes(patch, last, 2e-3, points=1)
    found = (family.omega[0] / shift.omega[-1] - 1) / family.amplitude[0] ** 2
    assert found == pytest.approx(shift.curvature[-1], rel=0.02)
    assert abs(complete / shift.curvature[-1] - 1) > 0.04  # the control


@pytest.mark.parametrize('seed', range(3))
def test_small_amplitudes_of_drawn_patches(seed):
    rng = np.random.default_rng([seed, 3])
    patch = drawn_patch(rng)
    linear, A = modes(patch).omega, 2e-3
    family = nonlinear_modes(patch, len(linear) - 1, A, points=1)
    shift = frequency_shifts(patch)
    assert shift.omega[-1] == pytest.approx(linear[-1])
    assert family.omega[0] / linear[-1] - 1 == pytest.approx(shift.curvature[-1] * family.amplitude[0] ** 2, rel=0.02)
    # what small disturbances do then: each mode turns by its own frequency
    turns = np.exp(2j * np.pi * linear / linear[-1])
    nearest = abs(family.multipliers[0][:, None] - np.concatenate([turns, turns.conj()])).min(axis=1)
    assert nearest.max() < 2e-2


def grown(atoms, family, point, periods):
    """By how much two runs have come apart that begin 1e-7 from each other, and what Floquet says."""
    here, period = family.harmonics[point].sum(axis=0), 2 * np.pi / family.omega[point]
    away = np.zeros_like(here)
    away[1:-1, 0] = np.random.default_rng(1).normal(size=len(atoms) - 2)
    runs = []
    for shift in (0, 1e-7 / np.linalg.norm(away)):
        start = atoms.copy()
        start.calc = atoms.calc
        start.positions[:, :2] += here + shift * away
        dyn = DrivenVerlet(start, period / 16, order=4, engine='numpy')
        record = Recorder(dyn, interval=16)
        dyn.run(16 * periods)
        runs.append(record.displacements)
    apart = np.linalg.norm(runs[1] - runs[0], axis=(1, 2))
    return apart[-8:].max() / 1e-7, np.exp(family.growth[point] * period * periods)


@pytest.mark.slow
def test_stability_by_time_steps_on_both_sides(light):
    """Between 5.8 and 25 % of the spacing two waves beside the local mode feed on it; below and above it lasts."""
    atoms, family = light
    lasts = np.flatnonzero(np.diff(family.stable.astype(int)))
    assert len(lasts) == 2  # lost and found again
    before, again = lasts[0], len(family.omega) - 1
    assert family.amplitude[before] == pytest.approx(0.058, abs=0.02)
    for point in (before, again):
        size, _ = grown(atoms, family, point, 40)
        assert size < 10  # a neighbour of another frequency goes away in proportion to the time
    size, expected = grown(atoms, family, int(abs(family.multipliers[:, 0]).argmax()), 80)
    assert expected > 500
    assert 0.03 < size / expected < 3  # a disturbance has only a part in what grows
    assert size > 100


def test_the_mode_is_a_motion_of_time_steps(light):
    atoms, family = light
    start = atoms.copy()
    start.calc = atoms.calc
    here = family.harmonics[-1].sum(axis=0)
    start.positions[:, :2] += here
    dyn = DrivenVerlet(start, 2 * np.pi / family.omega[-1] / 80, order=6, engine='numpy')
    dyn.run(80)
    assert abs(dyn.displacements - here).max() < 2e-4 * family.amplitude[-1]  # the seventh harmonic is left out
    assert abs(dyn.velocities).max() < 2e-3 * family.amplitude[-1] * family.omega[-1]


def test_symmetric_loses_to_asymmetric():
    """A row that may leave its line: at 29 % of the spacing a multiplier leaves the circle at +1, for a mode across the row."""
    atoms = row([1, 1, 1, 0.5, 1, 1, 1], lines=False)
    family = nonlinear_modes(atoms, 9, 0.33, points=8)
    lost = family.multipliers[~family.stable, 0]
    assert len(lost)
    assert not family.stable[-1]
    assert family.stable[0]
    assert abs(lost[-1].imag) < 1e-9 < lost[-1].real - 1
    assert abs(family.harmonics[..., 1]).max() == 0  # the family itself stays on the line


def test_what_it_cannot_follow_is_refused():
    atoms = row([1.0, 0.8, 1.0])
    with pytest.raises(PhysicsError, match='was lost at an amplitude'):
        nonlinear_modes(atoms, 0, 0.8, points=3)
    with pytest.raises(ValueError, match='mode must be'):
        nonlinear_modes(atoms, 1, 0.1)
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 12.0)
    patch.calc = MagneticRepulsion(patch, LAW, foundation=6.0)
    with pytest.raises(ValueError, match='too many'):
        nonlinear_modes(patch, 0, 0.1)


def test_rest_is_no_vibration():
    """A step too long for Newton's method once led to rest, which "vibrates" at any frequency, and was returned as the family."""
    patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 1.0)
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=6.0)
    assert (nonlinear_modes(patch, 0, 0.1, points=3).amplitude > 1e-3).all()
    with pytest.raises(PhysicsError, match='ask for a smaller amplitude'):
        nonlinear_modes(patch, 0, 5.0, points=3)
