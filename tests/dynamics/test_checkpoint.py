"""Runs that are killed go on to the same bits; checkpoints that do not belong to a run are refused."""

import errno
import os
import signal
import time

import numpy as np
import pytest

from magphonon import Constant, Diverged, DrivenVerlet, Harmonic, InversePower, MagneticRepulsion, Recorder, ToneBurst, lattices

LAW = InversePower(b=8900.0, a=4.5)
EVERY = 100


def prepare(engine='numpy', dt=0.1, amplitude=0.02, foundation=0.02, interval=7, seed=3, more=()):
    atoms = lattices.hexagon(lattices.triangular(10.0, 0.7), 25.0)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=foundation)
    v = np.zeros((len(atoms), 3))
    v[:, :2] = np.random.default_rng(seed).normal(scale=0.02, size=(len(atoms), 2))
    atoms.set_momenta(0.7 * v)
    dyn = DrivenVerlet(atoms, dt, [Harmonic([9], (1, 0), amplitude, 0.5), *more], damping=0.001, engine=engine)
    return atoms, dyn, Recorder(dyn, interval=interval)


def result(atoms, dyn, recorder):
    return {'positions': atoms.positions, 'momenta': atoms.get_momenta(), 'u': dyn.displacements, 'v': dyn.velocities,
            'nsteps': dyn.nsteps, 'frames': recorder.displacements, 'times': recorder.times}


def same_bits(a, b):
    return all(np.array_equal(a[name], b[name]) for name in a)


def child(directory, engine, steps):
    run = prepare(engine)
    run[1].run(steps, checkpoint=directory / 'state.npz', every=steps // 24)
    np.savez(directory / 'partial.npz', **result(*run))
    os.rename(directory / 'partial.npz', directory / 'result.npz')


@pytest.mark.parametrize('engine', ['ase', 'numpy'])
def test_a_run_that_ends_before_its_first_checkpoint_starts_anew(engine, tmp_path, monkeypatch):
    def interrupted(*_, **__):
        raise KeyboardInterrupt

    whole = prepare(engine)
    whole[1].run(100, checkpoint=tmp_path / 'whole.npz', every=50)
    with monkeypatch.context() as patch:
        patch.setattr(DrivenVerlet, 'step', interrupted)
        patch.setattr('magphonon.dynamics.engine.Blocks.advance', interrupted)
        with pytest.raises(KeyboardInterrupt):
            prepare(engine)[1].run(100, checkpoint=tmp_path / 'state.npz', every=50)
    run = prepare(engine)
    run[1].run(100, checkpoint=tmp_path / 'state.npz', every=50)
    assert same_bits(result(*whole), result(*run))


@pytest.mark.slow
@pytest.mark.filterwarnings('ignore:.*fork:DeprecationWarning')
@pytest.mark.parametrize(('engine', 'kills', 'steps'), [('ase', 3, 600), ('numpy', 4, 2400), ('compiled', 3, 48_000)])
def test_killed_at_random_moments_every_resume_ends_in_the_same_bits(engine, kills, steps, tmp_path):
    if engine == 'compiled':
        pytest.importorskip('numba')
    prepare(engine)[1].run(200)  # compiles, where there is something to compile
    whole = prepare(engine)
    started = time.perf_counter()
    whole[1].run(steps, checkpoint=tmp_path / 'whole.npz', every=steps // 24)
    duration = time.perf_counter() - started
    rng = np.random.default_rng(7)
    attempts = killed = 0
    while killed < kills:  # on a busy machine a run may end before its turn comes: then another one is killed
        directory = tmp_path / f'attempt{attempts}'
        directory.mkdir()
        attempts += 1
        while not (directory / 'result.npz').exists():
            pid = os.fork()
            if not pid:
                try:
                    child(directory, engine, steps)
                finally:
                    os._exit(0)
            if killed < kills:
                time.sleep(rng.uniform(0, 2 * duration / kills))
                os.kill(pid, signal.SIGKILL)
            struck = os.WIFSIGNALED(os.waitpid(pid, 0)[1])
            killed += struck
            assert struck or (directory / 'result.npz').exists()
        with np.load(directory / 'result.npz') as data:
            assert same_bits(result(*whole), data)
    other = prepare(engine, seed=4)
    other[1].run(steps)
    assert not same_bits(result(*whole), result(*other))  # the control


def test_a_finished_run_is_not_run_again(tmp_path):
    def watched():
        run, calls = prepare(), []
        run[1].attach(lambda: calls.append(run[1].nsteps), 10)  # where observers look decides how sums are rounded
        return run, calls

    first, calls = watched()
    first[1].run(300, checkpoint=tmp_path / 'state.npz', every=EVERY)
    assert calls == list(range(0, 301, 10))
    again, calls = watched()
    assert again[1].run(300, checkpoint=tmp_path / 'state.npz', every=EVERY)
    assert not calls
    assert same_bits(result(*first), result(*again))
    longer = watched()[0]
    longer[1].run(500, checkpoint=tmp_path / 'state.npz', every=EVERY)  # and one that shall be longer goes on
    assert longer[1].nsteps == 500
    with pytest.raises(ValueError, match='at step 500, but the run is to end at step 300'):
        watched()[0][1].run(300, checkpoint=tmp_path / 'state.npz', every=EVERY)


def test_a_resumed_run_keeps_its_engine(tmp_path, monkeypatch):
    pytest.importorskip('numba')
    prepare('auto')[1].run(300, checkpoint=tmp_path / 'state.npz', every=EVERY)
    monkeypatch.setattr('magphonon.dynamics.verlet.COMPILING_PAYS', 1)  # it would compile now
    _, dyn, _ = prepare('auto')
    dyn.run(600, checkpoint=tmp_path / 'state.npz', every=EVERY)
    assert dyn.engine == 'numpy'


@pytest.mark.parametrize('change', [
    {'dt': 0.11}, {'amplitude': 0.021}, {'foundation': 0.021}, {'interval': 8}, {'seed': 4}, {'engine': 'ase'},
    {'more': [Constant([9], (0, 1), 1e-9)]}, {'more': [ToneBurst([9], (0, 1), 1e-3, 0.5, start=20.0)]},
])
def test_a_foreign_checkpoint_is_refused(change, tmp_path):
    path = tmp_path / 'state.npz'
    prepare()[1].run(200, checkpoint=path, every=EVERY)
    before = path.read_bytes()
    with pytest.raises(ValueError, match='belongs to another run'):
        prepare(**change)[1].run(200, checkpoint=path, every=EVERY)
    assert path.read_bytes() == before


def test_a_damaged_checkpoint_is_refused(tmp_path):
    path = tmp_path / 'state.npz'
    prepare()[1].run(200, checkpoint=path, every=EVERY)
    good = path.read_bytes()
    for bad in (good[: len(good) // 2], good[:-1], b'', b'not a checkpoint', good[:1000] + b'\0' * 300 + good[1300:]):
        path.write_bytes(bad)
        with pytest.raises(ValueError, match='no complete checkpoint'):
            prepare()[1].run(200, checkpoint=path, every=EVERY)
    path.write_bytes(good)
    frames = tmp_path / 'state.npz.frames0'
    frames.write_bytes(frames.read_bytes()[:-8])
    with pytest.raises(ValueError, match='does not hold the 29 frames'):
        prepare()[1].run(200, checkpoint=path, every=EVERY)
    with pytest.raises(FileNotFoundError):
        prepare()[1].run(200, checkpoint=tmp_path / 'nowhere' / 'state.npz', every=EVERY)
    with pytest.raises(ValueError, match='every must be a whole number'):
        prepare()[1].run(200, checkpoint=tmp_path / 'new.npz', every=0)


@pytest.mark.parametrize('engine', ['ase', 'numpy'])
def test_the_last_good_state_of_a_run_that_goes_wrong_is_saved(engine, tmp_path):
    atoms, dyn, recorder = prepare(engine, interval=1)
    seen = []
    dyn.attach(lambda: seen.append(dyn.get_time()), 1)
    atoms.positions[9, 0] += 0.1
    dyn.attach(lambda: atoms.set_momenta(np.outer(np.arange(len(atoms)) == 9, [0.7 * 97, 0, 0])), -130)
    with pytest.raises(Diverged) as caught:
        dyn.run(400, checkpoint=tmp_path / 'state.npz', every=EVERY)
    with np.load(tmp_path / 'state.npz') as saved:
        assert saved['nsteps'] * 0.1 == pytest.approx(caught.value.last_good)
        assert caught.value.last_good >= 13 - 1e-9  # of the steps after 130, not of the last checkpoint
        assert np.array_equal(saved['positions'], atoms.positions)
        assert np.array_equal(saved['frames0'], recorder.times)
    # ASE's loop has shown observers a state that is not good; no frame of it is left
    assert (seen[-1] > caught.value.last_good) == (engine == 'ase')
    assert recorder.times[-1] == caught.value.last_good == dyn.get_time()
    assert len(recorder.displacements) == dyn.nsteps + 1
    # the momenta set by hand made the blocks start from positions again, which round to 1e-15 of 50 mm
    np.testing.assert_allclose(recorder.displacements[-1], dyn.displacements, atol=1e-13)
    assert (tmp_path / 'state.npz.frames0').stat().st_size == recorder.displacements.nbytes


def test_a_run_that_has_moved_is_told_to_be_prepared_afresh(tmp_path):
    _, dyn, _ = prepare()
    dyn.run(200, checkpoint=tmp_path / 'state.npz', every=EVERY)
    with pytest.raises(ValueError, match='goes on with atoms and dynamics prepared afresh'):
        dyn.run(200, checkpoint=tmp_path / 'state.npz', every=EVERY)


@pytest.mark.skipif(not os.path.exists('/dev/full'), reason='needs a device that is always full')
@pytest.mark.parametrize(('file', 'named'), [('.state.npz.{pid}.partial', 'state.npz'),
                                             ('state.npz.frames0', 'state.npz.frames0')])
def test_a_full_disk_is_named_with_the_file_and_what_to_do(file, named, tmp_path):
    (tmp_path / file.format(pid=os.getpid())).symlink_to('/dev/full')
    _, dyn, _ = prepare()
    with pytest.raises(OSError, match=rf"no space left; make room .*: '.*/{named}'$") as caught:
        dyn.run(200, checkpoint=tmp_path / 'state.npz', every=EVERY)
    assert caught.value.errno == errno.ENOSPC
    assert not (tmp_path / 'state.npz').exists()
