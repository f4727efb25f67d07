"""An independent code: LAMMPS runs the input that magphonon writes; forces and trajectories particle by particle."""

import ctypes
import os

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine
from lammps_session import lammps_session
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.dynamics.drives import Harmonic, ToneBurst
from magphonon.dynamics.lammps import read_lammps_displacements, write_lammps_input
from magphonon.dynamics.recorder import Recorder
from magphonon.dynamics.verlet import DrivenVerlet

pytestmark = pytest.mark.peer

TIMESTEP, STEPS, INTERVAL = 0.2 * u.ms, 800, 10  # a tenth of the stability limit; the burst ends after 645 steps
N = 12


@pytest.fixture
def lammps():
    return pytest.importorskip('lammps')


@pytest.fixture
def patch(prototype):
    """Prototype magnets within a fixed rim on their foundation, some of them heavier."""
    atoms = lattices.parallelogram(prototype, N, N)
    masses = atoms.get_masses()
    masses[::7] *= 1.5
    atoms.set_masses(masses)
    atoms.calc = MagneticRepulsion(atoms, prototype.calc.laws, **prototype.calc.parameters)
    return atoms


def burst(amplitude=1e-4 * u.N):
    """Five cycles at 40 Hz, oblique, on half a row, from the fourth millisecond on."""
    return ToneBurst(np.arange(N * N // 2 + 2, N * N // 2 + 8), (3, 4), amplitude, omega=2 * np.pi * 40 * u.Hz, start=4 * u.ms)


def by_magphonon(atoms, drive, damping=0.0, engine='compiled'):
    moving = atoms.copy()
    moving.calc = atoms.calc
    dyn = DrivenVerlet(moving, TIMESTEP, [drive], damping, engine=engine)
    recorder = Recorder(dyn, interval=INTERVAL)
    dyn.run(STEPS)
    return recorder.displacements


def by_lammps(directory, atoms, drive, **options):
    write_lammps_input(directory, atoms, TIMESTEP, STEPS, drives=[drive], interval=INTERVAL, **options)
    with lammps_session(directory):
        return read_lammps_displacements(directory, atoms)


def difference(a, b):
    """Largest difference of a displacement by the largest displacement."""
    return abs(a - b).max() / abs(b).max()


@pytest.mark.slow
def test_motion_out_of_the_plane_is_that_of_lammps_in_space(lammps, prototype, tmp_path):
    """Driven obliquely to the plane; the supports along z are a little stiffer than the layer needs."""
    atoms = lattices.parallelogram(prototype, N, N)
    law, k = prototype.calc.laws, prototype.calc.foundation
    needed = 9 * -law.dphi(prototype.calc.bonds.lengths[0]) / prototype.calc.bonds.lengths[0]
    atoms.calc = MagneticRepulsion(atoms, law, foundation=[[k, k, 1.3 * needed]])
    drive = ToneBurst(np.arange(N * N // 2 + 2, N * N // 2 + 8), (3, 4, 5), 1e-4 * u.N, omega=2 * np.pi * 40 * u.Hz)
    ours, theirs = by_magphonon(atoms, drive, engine='ase'), by_lammps(tmp_path, atoms, drive)
    assert abs(theirs[..., 2]).max() > 0.1 * abs(theirs).max()
    assert difference(theirs, ours) < 1e-7  # LAMMPS takes forces from absolute positions: 1e-16 L0/u, over 800 steps
    stiffer = atoms.copy()
    stiffer.calc = MagneticRepulsion(atoms, law, foundation=[[k, k, 1.3 * needed + k]])  # control: supports of other stiffness
    assert difference(theirs, by_magphonon(stiffer, drive, engine='ase')) > 1e-2


def test_forces_at_random_displacements(lammps, patch, tmp_path):
    displaced = patch.copy()
    free = patch.get_tags() != lattices.RIM
    displaced.positions[free, :2] += 0.1 * np.random.default_rng(5).standard_normal((free.sum(), 2))
    write_lammps_input(tmp_path, patch, TIMESTEP, steps=0)
    with lammps_session(tmp_path) as session:
        x = displaced.positions.ravel()
        session.scatter_atoms('x', 1, 3, (ctypes.c_double * len(x))(*x))
        session.command('run 0 post no')
        forces = np.array(session.gather_atoms('f', 1, 3)).reshape(-1, 3)[free]
    # a spline of 10 000 points interpolates to round-off, which the positions (1e-14 mm) pass on to the forces
    assert difference(forces, patch.calc.get_forces(displaced)[free]) < 1e-12
    patch.calc.set(model='conventional')
    assert difference(forces, patch.calc.get_forces(displaced)[free]) > 0.01


# 1e-7 is the promise.  What is left is round-off of the absolute positions, in LAMMPS (see the next test), and of the
# momenta that FixAtoms rebuilds from them in ASE's loop: found 3e-11 and 3e-10.
@pytest.mark.parametrize(('engine', 'tolerance', 'damping'), few_first(
    [('ase', 1e-8, 0.02 / u.ms), ('ase', 1e-8, 0.0), ('compiled', 1e-9, 0.02 / u.ms), ('compiled', 1e-9, 0.0)], 1))
def test_burst_particle_by_particle(lammps, patch, tmp_path, engine, tolerance, damping):
    found = by_lammps(tmp_path, patch, burst(), damping=damping)
    assert difference(found, by_magphonon(patch, burst(), damping, engine)) < tolerance
    if damping:
        assert difference(found, by_magphonon(patch, burst(), 0.0, engine)) > 0.1
    patch.calc.set(model='conventional')
    assert difference(found, by_magphonon(patch, burst(), damping, engine)) > 0.1


@pytest.mark.slow
def test_what_limits_the_agreement(lammps, patch, tmp_path):
    expected = by_magphonon(patch, burst())

    def error(**table):
        return difference(by_lammps(tmp_path, patch, burst(), **table), expected)

    # A linear table errs in the force by the second power of its step and in the stiffness by the first, which is
    # what counts where bonds stretch by less than a step; a cubic spline errs in the stiffness by the third power.
    coarse, fine = (error(interpolation='linear', points=n) for n in (10_000, 100_000))
    assert coarse > 1e-6
    assert fine < coarse / 5
    coarse, fine = (error(points=n) for n in (200, 2000))
    assert coarse > 1e-7
    assert fine < coarse / 300
    # With enough points the round-off of the absolute positions is left: an error in mm whatever the amplitude,
    # within the factor of ten that chance may make.
    larger = difference(by_lammps(tmp_path, patch, burst(1e-2 * u.N)), by_magphonon(patch, burst(1e-2 * u.N)))
    assert 1e-3 < larger / error() < 1e-1


def test_silent_and_leaves_nothing_in_the_working_directory(lammps, patch, tmp_path, monkeypatch, capfd):
    here, there = tmp_path / 'here', tmp_path / 'with a space'
    here.mkdir()
    there.mkdir()
    monkeypatch.chdir(here)
    by_lammps(there, patch, burst())
    assert not os.listdir(here)
    assert sorted(os.listdir(there)) == ['in.lammps', 'law.table', 'particles.data', 'trajectory.dump']
    assert capfd.readouterr() == ('', '')


def test_lammps_stops_where_a_bond_leaves_its_table(lammps, patch, tmp_path):
    with pytest.raises(Exception, match=r'Pair distance . table .* cutoff'):
        by_lammps(tmp_path, patch, burst(1.0 * u.N))


@pytest.mark.slow
def test_bonds_hold_beyond_the_cutoff_that_found_them(lammps, patch, tmp_path):
    patch.calc = MagneticRepulsion(patch, patch.calc.laws, foundation=patch.calc.foundation, cutoff=1.01 * 10 * u.mm)
    expected = by_magphonon(patch, burst(1e-2 * u.N))
    i, j, places = patch.calc.bonds.i, patch.calc.bonds.j, patch.positions[:, :2] + expected
    assert np.linalg.norm(places[:, j] - places[:, i], axis=2).max() > 1.02 * 10 * u.mm
    assert difference(by_lammps(tmp_path, patch, burst(1e-2 * u.N)), expected) < 1e-9


def no_calculator(atoms):
    atoms.calc = None


def periodic(atoms):
    cell = lattices.triangular(10 * u.mm, 0.707 * u.g)
    atoms.set_cell(cell.cell * N)
    atoms.set_pbc(cell.pbc)
    atoms.calc = MagneticRepulsion(atoms, atoms.calc.laws)


def displaced(atoms):
    atoms.positions[70, 0] += 0.1


def moving(atoms):
    atoms.set_velocities(np.full((len(atoms), 3), 0.1))


def on_a_line(atoms):
    atoms.set_constraint([FixAtoms([0]), FixedLine(70, [0, 1, 0])])


@pytest.mark.parametrize(('spoil', 'message'), [
    (no_calculator, 'must be a PairCalculator, not None'),
    (periodic, r'pbc \(1, 1, 0\)'),
    (displaced, 'at rest in their reference positions'),
    (moving, 'at rest in their reference positions'),
    (on_a_line, 'FixAtoms.* only, not FixedLine'),
])
def test_scene_that_lammps_cannot_run_is_refused(patch, tmp_path, spoil, message):
    spoil(patch)
    with pytest.raises(ValueError, match=message):
        write_lammps_input(tmp_path, patch, TIMESTEP, STEPS)
    assert not os.listdir(tmp_path)


@pytest.mark.parametrize(('drive', 'message'), [
    (Harmonic([70], (1, 0), 1e-4, 0.25), 'tone bursts .* not Harmonic'),
    (ToneBurst([70], (1, 0), 1e-4, 0.25, start=-1.0), 't >= 0'),
    (ToneBurst([N * N], (1, 0), 1e-4, 0.25), f'particle {N * N}, but the structure has particles 0 to {N * N - 1}'),
])
def test_drive_that_lammps_cannot_apply_is_refused(patch, tmp_path, drive, message):
    with pytest.raises(ValueError, match=message):
        write_lammps_input(tmp_path, patch, TIMESTEP, STEPS, drives=[drive])
    assert not os.listdir(tmp_path)


@pytest.mark.slow
def test_a_cluster_in_space_moves_as_in_lammps(lammps, tmp_path):
    """Sixteen particles at drawn places, driven along a direction in space; the control is in the model without D*."""
    rng = np.random.default_rng(1)
    corners = np.argwhere(np.ones((4, 2, 2))) * 10.0
    atoms = Atoms('Nd16', corners + rng.uniform(-1, 1, (16, 3)), masses=rng.uniform(0.5, 1, 16))
    atoms.calc = MagneticRepulsion(atoms, InversePower(3000.0, 4.0), cutoff=15.0, foundation=0.5).balanced(range(16))
    drive = ToneBurst([5], (0.3, 0.5, 0.8), 1e-4, 0.25)
    found = by_lammps(tmp_path, atoms, drive)
    assert found.shape[-1] == 3
    assert difference(found, by_magphonon(atoms, drive, engine='ase')) < 1e-7
    atoms.calc.set(model='conventional')
    assert difference(found, by_magphonon(atoms, drive, engine='ase')) > 1e-2


@pytest.mark.slow
def test_magnets_that_attract_some_others(lammps, patch, tmp_path):
    """Some stand upside down, balanced and held by their pillars; all of them upright are the control."""
    signs = np.where(np.arange(len(patch)) % 7 == 3, -1.0, 1.0)

    def calculator(strengths):
        calc = MagneticRepulsion(patch, patch.calc.laws, strengths=strengths, foundation=1.0)
        return calc.balanced(range(len(patch)))

    patch.calc = calculator(signs)
    found = by_lammps(tmp_path, patch, burst())
    assert difference(found, by_magphonon(patch, burst())) < 1e-8  # stiff pillars: positions round more of less motion
    patch.calc = calculator(abs(signs))
    assert difference(found, by_magphonon(patch, burst())) > 1e-3


@pytest.mark.slow
def test_kinds_strengths_and_springs_of_their_own(lammps, patch, tmp_path):
    """Weak magnets, a second kind, and pillars that are stiffer along one direction; the control forgets one of them."""
    n, law = len(patch), patch.calc.laws
    patch.set_tags(np.arange(n) % 5 == 0)
    # so little that what is out of balance at first does not fly apart
    strengths, springs = np.where(np.arange(n) % 3, 1.0, 0.99), np.where((np.arange(n) % 4 == 0)[:, None], [0.03, 0.02], 0.025)
    laws = {(0, 0): law, (0, 1): InversePower(1.02 * law.b, law.a), (1, 1): InversePower(law.b * 10.0, law.a + 1.0)}

    def calculator(laws=laws, strengths=strengths, springs=springs):
        return MagneticRepulsion(patch, laws, strengths=strengths, foundation=springs)

    patch.calc = calculator()
    found = by_lammps(tmp_path, patch, burst())
    assert difference(found, by_magphonon(patch, burst())) < 1e-9
    for other in {'laws': law}, {'strengths': None}, {'springs': 0.025}:
        patch.calc = calculator(**other)
        assert difference(found, by_magphonon(patch, burst())) > 1e-3


def test_more_records_than_lammps_has_groups_are_refused(patch, tmp_path):
    with pytest.raises(ValueError, match='groups for at most 29 drives and records of some particles, not for 30'):
        write_lammps_input(tmp_path, patch, TIMESTEP, 0, records=[([0], 1)] * 30)
