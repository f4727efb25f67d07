"""DrivenVerlet as any dynamics of ASE: observers, files, runs after runs, engines, arguments."""

import subprocess
import sys

import numba
import numpy as np
import pytest
from ase.constraints import FixCom
from ase.io import read
from motion import DT, apart, patch, states_of

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, ToneBurst, lattices
from magphonon.dynamics import Constant
from magphonon.interactions import Tabulated
from magphonon.stiffness import restored


@pytest.mark.parametrize('engine', ['ase', 'compiled'])
def test_observers_are_called_as_by_ase(engine):
    calls = {3: [], 7: [], -11: []}
    dyn = DrivenVerlet(patch(speed=0.01), DT, engine=engine)
    for interval, steps in calls.items():
        dyn.attach(lambda steps=steps: steps.append(dyn.nsteps), interval)
    dyn.run(20)
    dyn.run(4)
    assert calls == {3: [0, 3, 6, 9, 12, 15, 18, 21, 24], 7: [0, 7, 14, 21], -11: [11]}


def test_one_magnet_in_a_cell_moves_on_its_spring_alone():
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=1.0)
    cell.set_velocities([[0.1, 0.0, 0.0]])
    dyn = DrivenVerlet(cell, 0.03)
    dyn.run(2500)  # enough for compiled steps, but bonds to its own images never change
    w = 2 * np.arcsin(0.015)  # rad a step
    assert (dyn.engine, dyn.displacements[0, 0]) == ('ase', pytest.approx(0.003 / np.sin(w) * np.sin(2500 * w), rel=1e-8))


def test_trajectory_and_log(tmp_path):
    atoms = patch(speed=0.05)
    with DrivenVerlet(atoms, DT, trajectory=tmp_path / 'run.traj', logfile=str(tmp_path / 'run.log'), loginterval=5) as dyn:
        dyn.run(20)
    frames = read(tmp_path / 'run.traj', ':')
    assert len(frames) == 5
    assert np.array_equal(frames[-1].positions, atoms.positions)
    assert frames[-1].get_potential_energy() == atoms.get_potential_energy()
    names, *lines = (tmp_path / 'run.log').read_text().splitlines()
    assert names.split() == ['Time[ms]', 'Etot[mJ]', 'Epot[mJ]', 'Ekin[mJ]']
    logged = np.array([line.split() for line in lines], float)
    np.testing.assert_allclose(logged[:, 0], DT * np.arange(0, 21, 5), rtol=1e-9)
    assert logged[-1, 2] == pytest.approx(atoms.get_potential_energy(), rel=1e-11)
    v = atoms.get_momenta() / atoms.get_masses()[:, None]
    assert logged[-1, 3] == pytest.approx(0.5 * np.sum(atoms.get_masses()[:, None] * v**2), rel=1e-11)
    assert logged[:, 1] == pytest.approx(logged[:, 2:].sum(axis=1), rel=1e-10)
    assert logged[0, 3] > 0  # in four decimals, as ASE writes them, it is not much more than zero


def test_the_engine_is_chosen_by_what_it_can_do(monkeypatch):
    dyn = DrivenVerlet(patch(), DT)
    dyn.run(2)
    assert dyn.engine == 'ase'
    monkeypatch.setattr('magphonon.dynamics.verlet.COMPILING_PAYS', 1)
    dyn.run(2)
    assert dyn.engine == 'compiled'
    atoms = patch()
    atoms.set_constraint(FixCom())
    dyn = DrivenVerlet(atoms, DT)
    dyn.run(2)
    assert dyn.engine == 'ase'
    with pytest.raises(ValueError, match=r"engine='compiled' cannot .*FixCom.*use engine='ase'"):
        DrivenVerlet(atoms, DT, engine='compiled')
    atoms = patch()
    atoms.set_momenta(np.outer(np.arange(49) == 24, (0, 0, 1)))
    with pytest.raises(ValueError, match=r'particle 24 moves out of the plane.*FixedPlane'):  # nothing acts along z
        DrivenVerlet(atoms, DT).run(2)
    with pytest.raises(ValueError, match=r"engine='compiled' cannot .* out of the plane"):
        DrivenVerlet(atoms, DT, engine='compiled')


def test_a_short_run_imports_no_numba():
    code = ('import sys; from magphonon import *; a = lattices.parallelogram(lattices.square(1., 1.), 5, 5); '
            'a.calc = MagneticRepulsion(a, InversePower(1., 4.), foundation=1.); DrivenVerlet(a, .01).run(20); '
            'print("numba" in sys.modules, "matplotlib" in sys.modules)')
    out = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True)
    assert out.stdout.split() == ['False', 'False']


@pytest.mark.parametrize('reach', [0.02, 0.3])
def test_a_law_that_no_polynomial_fits_is_evaluated_itself(reach):
    r = np.array([4, 6, 8, 9, 10 - 0.4 * reach, 10 + 0.3 * reach, 11, 13, 16, 20])  # knots within reach of the motion
    law = Tabulated(r, 8900 * r**-4.5 * (1 + 0.01 * np.sin(3 * r)))
    ase, blocks = (states_of(patch(speed=reach, law=law), 100, 10, engine=engine) for engine in ('ase', 'compiled'))
    assert apart(blocks, ase) < 1e-8


@pytest.mark.parametrize(('arguments', 'words'), [
    ({'timestep': 0}, 'timestep must be a positive number in ms, not 0'),
    ({'damping': -1}, 'damping must be a zero or positive number in 1/ms'),
    ({'damping': [1, 2]}, 'one for each of the 49 particles'),
    ({'engine': 'fast'}, "engine must be one of 'auto', 'ase', 'compiled', not 'fast'"),
    ({'drives': [3]}, 'a drive must be'),
    ({'drives': [Constant(49, (1, 0), 1.0)]}, 'particle 49, but the structure has particles 0 to 48'),
])
def test_bad_arguments_are_refused(arguments, words):
    with pytest.raises(ValueError, match=words):
        DrivenVerlet(patch(), **{'timestep': DT, **arguments})


@pytest.mark.parametrize('engine', ['ase', 'compiled'])
def test_a_killed_run_goes_on_from_its_trajectory(engine, tmp_path):
    def driven(atoms, **options):
        return DrivenVerlet(atoms, DT, [ToneBurst(24, (1, 2), 1e-3, omega=3.0, cycles=3)], damping=0.05, engine=engine, **options)

    def killed():
        if dyn.nsteps == 77:
            raise KeyboardInterrupt

    whole = driven(patch())
    whole.run(200)
    dyn = driven(patch(), trajectory=str(tmp_path / 'run.traj'), loginterval=20)
    dyn.attach(killed, interval=7)
    with pytest.raises(KeyboardInterrupt):
        dyn.run(200)
    frames = read(tmp_path / 'run.traj', ':')
    again = driven(restored(frames[-1]))
    again.nsteps = 20 * (len(frames) - 1)
    assert again.nsteps == 60
    again.run(200 - again.nsteps)
    apart = abs(again.displacements - whole.displacements).max() / abs(whole.displacements).max()
    assert apart < 1e-9  # positions in the file are rounded
    late = driven(restored(frames[-1]))  # the control: without its clock the drive begins anew
    late.run(140)
    assert abs(late.displacements - whole.displacements).max() > 1e-3 * abs(whole.displacements).max()


def test_a_run_that_becomes_long_is_compiled_and_stays_so(monkeypatch):
    monkeypatch.setattr('magphonon.dynamics.verlet.COMPILING_PAYS', 1049 * 30)
    exact = DrivenVerlet(patch(speed=0.01), DT, tolerance=1e-5)  # of an order of more stages, which count from the first run on
    exact.run(29)
    assert (exact.splitting.stages > 1, exact.engine) == (True, 'compiled')
    dyn, whole = DrivenVerlet(patch(speed=0.01), DT), DrivenVerlet(patch(speed=0.01), DT, engine='ase')
    engines = []
    for steps in (29, 30, 29):  # on both sides of what pays
        dyn.run(steps)
        engines.append(dyn.engine)
    whole.run(88)
    assert engines == ['ase', 'compiled', 'compiled']
    assert apart(dyn.displacements, whole.displacements) < 1e-11
    dyn.atoms.set_momenta(dyn.atoms.get_momenta() + np.outer(np.arange(49) == 24, (0, 0, 1)))  # blocks are refused now
    with pytest.raises(ValueError, match='moves out of the plane'):
        dyn.run(29)


@pytest.mark.parametrize(('absent', 'cause'), [(False, 'NUMBA_DISABLE_JIT is set'), (True, 'numba halted')])
def test_a_numba_that_compiles_nothing_or_is_absent_is_an_error_and_not_motion_without_forces(absent, cause, monkeypatch):
    monkeypatch.setattr(numba.config, 'DISABLE_JIT', 1)
    if absent:
        monkeypatch.setitem(sys.modules, 'numba', None)
    monkeypatch.delitem(sys.modules, 'magphonon.dynamics.kernel', raising=False)
    with pytest.raises(ImportError, match=rf"{cause}.*, but long runs .* need compiled code; mend this, or use engine='ase'"):
        DrivenVerlet(patch(), DT, engine='compiled').run(3)
