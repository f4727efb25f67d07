"""Runs with a tolerance against double precision with the whole law and finer steps, on drawn patches."""

from dataclasses import dataclass
from unittest import mock

import numpy as np
import pytest
from ase.calculators.emt import EMT
from ase.constraints import FixAtoms

from magphonon import DrivenVerlet, InversePower, ToneBurst, lattices
from magphonon.dynamics import Harmonic, PrescribedMotion, Recorder, engine, memory_layout
from magphonon.dynamics.engine import highest_frequency
from magphonon.dynamics.splittings import SPLITTINGS
from magphonon.stiffness import LinearSystem, PairCalculator

pytestmark = pytest.mark.slow   # each compiles kernels of its own, which takes seconds

FINER = 4


@dataclass
class Case:
    """A patch that moves for `duration` ms: displaced by a strain, pushed and damped, of which a tolerance is asked."""

    seed: int
    longest: float = 100.0  # rad, of the fastest wave, which goes through one in about a ms
    size: float = 1.0  # of one and the same patch, in other units of length

    def __post_init__(self):
        rng, L0, mass = np.random.default_rng(self.seed), 10.0 * self.size, 0.7 * self.size**3
        cell, law = lattices.triangular(L0, mass), InversePower(b=8900.0 * self.size**5.5, a=4.5)
        atoms = [lattices.parallelogram(cell, *rng.integers(7, 13, 2)), lattices.hexagon(cell, self.size * rng.uniform(40, 60)),
                 lattices.rectangle(cell, *self.size * rng.uniform(70, 130, 2))][rng.integers(3)]
        if rng.random() < 0.4:
            atoms = atoms[rng.random(len(atoms)) > 0.06]
        if rng.random() < 0.3:
            atoms.positions[:, :2] += 0.03 * L0 * rng.uniform(-1, 1, (len(atoms), 2))
        if rng.random() < 0.3:
            atoms.set_constraint()
        self.table = rng.random() < 0.2
        if self.table:
            atoms = atoms[rng.permutation(len(atoms))]
        atoms.set_array('site', None)
        if rng.random() < 0.3:
            atoms.set_masses(mass * rng.uniform(0.5, 2, len(atoms)))
        springs = rng.uniform(0.3, 2.0)
        atoms.calc = PairCalculator(atoms, law, foundation=springs, cutoff=1.4 * L0)
        atoms.calc = atoms.calc.balanced(np.arange(len(atoms)))
        self.free = np.setdiff1d(np.arange(len(atoms)), atoms.constraints[0].index if atoms.constraints else [])
        self.atoms, self.omega = atoms, highest_frequency(atoms)
        self.strain = 10 ** rng.uniform(-4, -0.9)
        self.u = np.zeros((len(atoms), 3))
        self.u[self.free, :2] = self.strain * L0 / 2 * rng.uniform(-1, 1, (len(self.free), 2))
        self.damping = rng.uniform(0, 0.05) * (rng.random() < 0.4)
        pushed = rng.choice(self.free, 3, replace=False)
        kind = rng.integers(3)
        force = self.size * self.strain
        self.drives = [[], [Harmonic(pushed, (0.6, 0.8), 0.1 * force, 0.5 * self.omega)],
                       [ToneBurst(pushed[0], (0, 1), force, 0.4 * self.omega, cycles=3)]][kind]
        self.tolerance = 10 ** rng.uniform(-5, -2.5)
        self.phase = 10 ** rng.uniform(0.7, np.log10(self.longest))
        longest = max(one.longest(self.phase, self.tolerance / 4) for one in SPLITTINGS.values()) / self.omega
        self.steps = int(np.ceil(self.phase / self.omega / longest / rng.uniform(0.3, 0.95))) + 1
        self.dt = self.phase / self.omega / self.steps

    def run(self, finer=1, **settings):
        atoms = self.atoms.copy()
        atoms.calc, atoms.positions = self.atoms.calc, atoms.positions + self.u
        dyn = DrivenVerlet(atoms, self.dt / finer, self.drives, self.damping, **settings)
        recorder = Recorder(dyn, interval=max(1, finer * self.steps // 20))
        with mock.patch.object(memory_layout, 'SPREAD', 0 if self.table else memory_layout.SPREAD):
            dyn.run(finer * self.steps)
        return dyn, abs(recorder.displacements).max()

    def misfit(self, **settings):
        """Error of a run with the tolerance as a fraction of it, and that run."""
        dyn, _ = self.run(tolerance=self.tolerance, engine='compiled', threads=1, **settings)
        reference, largest = self.run(FINER, engine='compiled', order=6)
        return abs(dyn.displacements - reference.displacements).max() / largest / self.tolerance, dyn


@pytest.mark.parametrize('seeds', [range(20), range(20, 40), pytest.param(range(40, 200), marks=pytest.mark.long)])
def test_the_error_is_within_the_tolerance(seeds):
    for seed in seeds:
        misfit, dyn = Case(seed).misfit()
        assert misfit < 1, seed
        assert dyn.engine == 'compiled'


def test_units_of_length_do_not_matter():
    for seed, size in zip((6, 9), 10.0 ** np.random.default_rng(0).uniform((-5, 3), (-4, 4)), strict=True):
        (here, _), (there, dyn) = (Case(seed, size=one).misfit() for one in (1.0, size))
        assert max(here, there) < 1
        assert dyn._blocks._dtype is np.float32
        powers = dyn._blocks._increments.r0[0] ** (-2.0 * len(dyn._blocks._law))
        assert not 1e-45 < powers < 3e38  # the control: in such units single precision has no coefficients


@pytest.mark.long
def test_the_error_of_200_runs_of_up_to_three_seconds_is_within_the_tolerance():
    """`python -m pytest -m long -n 0 -s tests/dynamics/test_tolerance.py`, some twenty minutes."""
    misfits = []
    for seed in range(200):
        case = Case(1000 + seed, 3300.0)
        misfits.append(case.misfit()[0])
        print(seed, f'{misfits[-1]:.3f}, strain {case.strain:.1e}, tolerance {case.tolerance:.1e}, {case.phase:.0f} rad')
        assert misfits[-1] < 1, seed
    print(f'largest error {max(misfits):.3f} of the tolerance')


def test_a_law_cut_too_short_misses_the_tolerance():
    case = Case(17)  # a strain of a tenth
    with mock.patch.object(engine, 'LAW_SHARE', 1e4):
        misfit, dyn = case.misfit()
    assert len(dyn._blocks._law) == 6  # where eleven are due
    assert misfit > 2  # 5.4, where eleven have 0.003


def test_single_precision_drifts_and_long_runs_are_in_double():
    case, found = Case(1), {}
    case.tolerance, case.steps, case.drives, case.damping = 1e-5, 4000, [], 0.0
    exact = case.run(engine='compiled', order=6)[0].displacements
    for least in (0.0, engine.SINGLE):
        with mock.patch.object(engine, 'SINGLE', least):
            dyn, largest = case.run(tolerance=case.tolerance, engine='compiled', order=6)
        found[dyn._blocks._dtype] = abs(dyn.displacements - exact).max() / largest / case.tolerance
    assert found[np.float64] < 0.5
    assert found[np.float32] > 2  # the control


def test_a_run_that_grows_long_goes_on_in_double_precision():
    case = Case(1)
    case.tolerance, case.drives, case.damping = 1e-5, [], 0.0
    dyn, _ = case.run(tolerance=case.tolerance, engine='compiled', order=6)
    assert dyn._blocks._dtype is np.float32
    before = dyn.displacements
    dyn.run(1500)
    assert dyn._blocks._dtype is np.float64
    assert before.dtype == np.float64
    exact = case.run(engine='compiled', order=6)[0]
    assert abs(before - exact.displacements).max() < case.tolerance * abs(case.u).max()
    exact.run(1500)
    assert abs(dyn.displacements - exact.displacements).max() < case.tolerance * abs(case.u).max()


def test_the_lowest_order_that_meets_the_tolerance_is_taken_or_the_longest_step_told():
    case = Case(1)
    stages = []
    for tolerance in (0.1, 3e-4, 2e-7):
        dyn, _ = case.run(finer=6, tolerance=tolerance)
        stages.append(dyn.splitting.stages)
    assert stages == sorted(stages)
    assert stages[0] == 1
    assert stages[-1] == 11
    with pytest.raises(ValueError, match='take steps of at most') as refused:
        case.run(tolerance=1e-9)
    case.dt = float(str(refused.value).split('at most ')[1].split(' ')[0])
    case.run(tolerance=1e-9)
    assert case.run(finer=3)[0].splitting.stages == 1  # without a tolerance


@pytest.mark.parametrize('led', [False, True])
def test_what_drives_or_leads_faster_than_the_lattice_counts(led):
    """A row at steps that are fine for its own waves; the control: the frequency of the drive is forgotten."""
    row, ratio = lattices.chain(10.0, 0.7).repeat((6, 1, 1)), np.random.default_rng(led).uniform(12, 15)
    row.pbc = False
    row.calc = PairCalculator(row, InversePower(b=8900.0, a=4.5), foundation=0.05).balanced(np.arange(6))
    row.set_constraint(FixAtoms([0]))
    omega, amplitude = highest_frequency(row), 1e-3
    course = Harmonic([0 if led else 1], (1, 0), amplitude, omega=ratio * omega)

    def end(dt, **settings):
        atoms, steps = row.copy(), int(np.ceil(20 / omega / dt))
        atoms.calc = row.calc
        drive = PrescribedMotion(course) if led else course
        dyn = DrivenVerlet(atoms, 20 / omega / steps, [drive], engine='compiled', **settings)
        dyn.run(steps)
        return dyn.displacements

    with pytest.raises(ValueError, match='take steps of at most') as refused:
        end(0.5 / omega, tolerance=1e-3)
    exact = end(0.02 / omega, order=6)
    allowed = 1e-3 * (amplitude if led else abs(exact).max())
    assert abs(end(float(str(refused.value).split('at most ')[1].split(' ')[0]), tolerance=1e-3) - exact).max() < allowed
    with mock.patch.object(DrivenVerlet, '_driven', 0.0):
        assert abs(end(0.5 / omega, tolerance=1e-3) - exact).max() > 2 * allowed


def test_a_tolerance_is_a_positive_number_for_magnets():
    case = Case(1)
    with pytest.raises(ValueError, match='tolerance must be a positive number'):
        case.run(tolerance=-1.0)
    atoms = case.atoms.copy()
    atoms.calc = EMT()
    with pytest.raises(ValueError, match='a tolerance needs PairCalculator'):
        DrivenVerlet(atoms, 0.1, tolerance=1e-3)


def test_the_bound_of_the_highest_frequency_by_particles_holds_and_is_near():
    for seed in range(10):
        case = Case(seed)
        over = engine.particle_bound(LinearSystem.nearest(case.atoms)) / case.omega
        assert 1 <= over < np.sqrt(2), seed  # half of it in the square would be no bound


@pytest.mark.parametrize('order', [2, 4, 6])
def test_uniform_motion_in_many_short_steps_is_not_lost_in_single_precision(order):
    """Rounded always the same way, it was 5 tolerances off; in steps fifty times as long, single precision serves."""
    cell, v = lattices.triangular(1.0, 1.0).repeat((6, 6, 1)), np.array([1e-3, 0.37e-3, 0.0])
    cell.calc = PairCalculator(cell, InversePower(1.0, 3.0))
    for phase, steps, single in ((0.01, 100_000, False), (0.5, 3000, True)):
        atoms, dt = cell.copy(), phase / highest_frequency(cell)
        atoms.calc = cell.calc
        atoms.set_velocities(np.tile(v, (len(atoms), 1)))
        dyn = DrivenVerlet(atoms, dt, order=order, tolerance=1e-3, engine='compiled')
        dyn.run(steps)
        assert (dyn._blocks._dtype == np.float32) == single
        np.testing.assert_allclose(dyn.displacements, np.tile(v[:2] * dt * steps, (len(atoms), 1)), rtol=1e-3 if single else 1e-6)
