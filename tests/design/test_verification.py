"""Designs judged by what did not make them: time steps, neighbours that were left out, and lattices that scatter."""

from dataclasses import replace

import numpy as np
import pytest

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.design import (
    BandEdge,
    BurstEnergy,
    Level,
    Robust,
    Worst,
    by_time_steps,
    optimise,
    verify,
)
from magphonon.response import Dof
from magphonon.stiffness import LinearSystem, Scatter

LAW = InversePower(b=6200.0, a=4.5824)


def patch(model='complete', seed=0):
    """A drawn hexagon at rest, on feet that stand a little aside."""
    rng = np.random.default_rng(seed)
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), 30.0)
    atoms.positions[:, :2] += rng.normal(scale=0.2, size=(len(atoms), 2))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.02, strengths=rng.uniform(0.9, 1.1, len(atoms)), cutoff=21.0)
    rest = relaxed(atoms).atoms
    rest.calc = rest.calc.changed(model=model)
    return rest


def places(atoms, seed=0):
    rng, free = np.random.default_rng(seed), LinearSystem.of(atoms).mobile
    return [Dof(int(k), np.append(rng.normal(size=2), 0)) for k in rng.choice(np.flatnonzero(free), 3, replace=False)]


def test_time_steps_find_the_levels():
    source, one, other = places(patch())
    level = Worst((Level(source, one, 0.4, 0.05, 1e-3) - Level(source, other, 0.4, 0.05), 1.5 * Level(source, one, 0.5, 0.05)))
    steps = by_time_steps(level, patch())
    assert steps == pytest.approx(level.value(LinearSystem.of(patch())), abs=0.02)
    assert abs(steps - level.value(LinearSystem.of(patch('conventional')))) > 0.2  # the control


def test_time_steps_follow_a_force_above_all_frequencies():
    """A fast force was once taken in the steps of slow waves; far above these a free mass answers 1/(m omega^2)."""
    atoms = patch()
    source, *_ = places(atoms)
    omega, damping = 9.0, 0.5
    steps = by_time_steps(Level(source, source, omega, damping), atoms)
    m = atoms.get_masses()[source.particle]
    assert steps == pytest.approx(20 * np.log10(source.direction @ source.direction / (m * omega**2)), abs=0.4)


@pytest.mark.parametrize('amplitude', [0.0, pytest.param(0.3, marks=pytest.mark.slow)])
def test_time_steps_find_the_share_of_a_burst(amplitude):
    source, *_ = places(patch())
    burst = BurstEnergy(source, (20, 21, 22), (20.0, 60.0), 0.5, 3, 0.02, dt=0.1, amplitude=amplitude)
    share = burst - replace(burst, region=tuple(range(len(patch()))))
    steps = by_time_steps(share, patch())
    assert steps == pytest.approx(share.value(LinearSystem.of(patch())), abs=0.02)
    linear = share.value(LinearSystem.of(patch('conventional'))) if not amplitude else \
        by_time_steps(replace(burst, amplitude=0.0) - replace(burst, region=tuple(range(len(patch()))), amplitude=0.0), patch())
    assert abs(steps - linear) > 0.05  # the controls: D0 alone, or small motion


def test_time_steps_know_no_bands():
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, LAW, foundation=0.02)
    assert np.isnan(by_time_steps(BandEdge(np.array([0.5, 0, 0]), 1), cell))


@pytest.mark.slow
def test_one_table_says_what_is_true():
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), 30.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.02, cutoff=21.0)
    x = atoms.positions - atoms.positions.mean(0)
    source, right, left = (Dof(int(np.hypot(*(x[:, :2] - at).T).argmin()), np.array([1.0, 0, 0]))
                           for at in ([0, 0], [20, 0], [-20, 0]))
    objective = Level(source, right, 0.4, 0.05, 0.1) - Level(source, left, 0.4, 0.05, 0.1)
    design = optimise(atoms, objective, {'strength': (0.85, 1.15)}, steps=8, starts=2, compare=True)
    found = verify(design, Robust(Scatter(strength=0.01), draws=5))
    assert found.promised == design.starts
    assert max(found.promised_by_D0) == design.conventional.value
    assert max(found.given_by_D0) < found.value
    assert found.time_steps == pytest.approx(found.value, abs=0.05)
    near = atoms.copy()  # the same strengths with nearest neighbours, by the package's other minimiser
    near.calc = MagneticRepulsion(atoms, LAW, foundation=0.02, strengths=design.atoms.calc.strengths, cutoff=13.0)
    assert found.nearest == pytest.approx(objective.value(LinearSystem.of(relaxed(near).atoms)), abs=1e-5)
    assert abs(found.nearest - found.value) > 1
    assert len(found.scattered) == 5
    words = found.table('dB', goal=-100.0)
    assert 'copies out of 5 that reach -100 dB' in words
    assert words.splitlines()[-1].split()[-1] == '5'
