"""Processes that are killed in the middle of a sweep: workers, the master, Dask's workers; and MPI."""

import json
import os
import shutil
import signal
import subprocess
import sys
import sysconfig
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from sweeping import calls, deadly, formula, noted

from magphonon import ready_scene
from magphonon.sweeps import processes, sweep

xarray = pytest.importorskip('xarray')
TESTS = Path(__file__).parents[1]
OVER = {'x': [0.0, 1.0, 2.0, 3.0], 'y': [0.0, 1.0, 2.0]}
EXPECTED = np.add.outer(OVER['x'], OVER['y'])
EXPECTED[3] = np.nan  # refused

MASTER = '''
import sys
sys.path.insert(0, {tests!r})
from functools import partial
import numpy as np
from sweeping import noted
from magphonon.sweeps import processes, sweep
if __name__ == '__main__':
    over = {{'x': np.arange(10.0, 20.0), 'y': np.arange(4.0)}}
    sweep(partial(noted, {folder!r}, pause=0.02), over, executor={executor}, journal_file={journal!r})
'''


@pytest.mark.slow
def test_a_killed_worker_costs_no_point_and_a_deadly_point_is_recorded(tmp_path):
    found = sweep(partial(deadly, str(tmp_path)), OVER, executor=processes(2))
    expected = EXPECTED.copy()
    expected[2, 0] = np.nan
    np.testing.assert_array_equal(found.value, expected)
    assert 'every process that computed it died' in found.fault.values[2, 0]
    assert found.fault.values[3].tolist() == ['three is refused'] * 3
    assert (tmp_path / 'died').exists()


def killed_master(folder, executor, lines):
    """Start a sweep in a process of its own, kill it when its journal has so many lines; those lines."""
    (folder / 'calls').mkdir(exist_ok=True)
    journal, program = folder / 'journal', folder / 'program.py'
    program.write_text(MASTER.format(tests=str(TESTS), folder=str(folder / 'calls'), journal=str(journal), executor=executor))
    process = subprocess.Popen([sys.executable, str(program)])
    while process.poll() is None and (not journal.exists() or journal.read_bytes().count(b'\n') < lines):
        time.sleep(0.005)
    process.kill()
    process.wait()
    return [json.loads(line) for line in journal.read_bytes().split(b'\n')[:-1]]


@pytest.mark.slow
def test_a_killed_master_loses_no_finished_point(tmp_path):
    went_on(tmp_path, 'None', [9])


@pytest.mark.long
@pytest.mark.parametrize('seed', range(20))
def test_many_kills(tmp_path, seed):
    """Twenty sweeps whose masters are killed three times each, at lines of the journal drawn at random.

    python -m pytest -m long tests/sweeps/test_kills.py
    """
    draw = np.random.default_rng(seed)
    went_on(tmp_path, ['None', 'processes(2)'][seed % 2], sorted(draw.integers(2, 40, 3)))


def went_on(folder, executor, kills):
    kept = []
    for lines in kills:
        after = killed_master(folder, executor, lines)
        assert after[:len(kept)] == kept  # nothing that was answered is lost or computed again
        kept = after
    numbers = [line[0] for line in kept[1:]]
    assert len(set(numbers)) == len(numbers) >= kills[-1] - 1
    before = calls(folder / 'calls')
    over = {'x': np.arange(10.0, 20.0), 'y': np.arange(4.0)}
    found = sweep(partial(noted, str(folder / 'calls'), pause=0.02), over, journal_file=folder / 'journal')
    np.testing.assert_array_equal(found.value, np.add.outer(over['x'], over['y']))
    assert sum(calls(folder / 'calls').values()) - sum(before.values()) == 40 - len(numbers)


def alive(pid):
    """Whether a process runs still, and is not only waited for."""
    try:
        return Path(f'/proc/{pid}/stat').read_text().rpartition(')')[2].split()[0] != 'Z'
    except FileNotFoundError:
        return False


@pytest.mark.slow
@pytest.mark.skipif(not Path(f'/proc/self/task/{os.getpid()}/children').exists(), reason='a system that does not list children')
def test_workers_end_with_a_killed_master(tmp_path):
    program = tmp_path / 'program.py'
    program.write_text(MASTER.format(tests=str(TESTS), folder=str(tmp_path), journal=str(tmp_path / 'journal'),
                                     executor='processes(2)').replace('0.02', '5.0'))
    process = subprocess.Popen([sys.executable, str(program)])
    while process.poll() is None and len(list(tmp_path.glob('1*_*'))) < 2:  # until both compute
        time.sleep(0.02)
    children = [int(pid) for pid in Path(f'/proc/{process.pid}/task/{process.pid}/children').read_text().split()]
    process.kill()
    process.wait()
    assert len(children) >= 2
    deadline = time.monotonic() + 300  # far longer than it takes; it is no measure
    while any(map(alive, children)) and time.monotonic() < deadline:
        time.sleep(0.02)
    assert not any(map(alive, children))


@pytest.mark.slow
def test_dask_with_a_killed_worker(tmp_path):
    distributed = pytest.importorskip('distributed')
    over = {'x': np.linspace(0.1, 0.4, 6), 'y': [0.0, 1.0]}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=':0', silence_logs=50) as cluster, \
            distributed.Client(cluster) as client:
        client.run(sys.path.insert, 0, str(TESTS))
        executor = client.get_executor(pure=False)
        assert sweep(formula, over, executor=executor).identical(sweep(formula, over))
        function = partial(slow_noted, str(tmp_path), cluster.workers[0].pid)
        found = sweep(function, OVER, executor=executor)
    np.testing.assert_array_equal(found.value, EXPECTED)
    assert (tmp_path / 'died').exists()


def slow_noted(folder, victim, x, y):
    """As `noted`; the worker `victim` is killed when (2, 1) is computed for the first time."""
    if (x, y) == (2.0, 1.0) and not (Path(folder) / 'died').exists():
        (Path(folder) / 'died').touch()
        os.kill(victim, signal.SIGKILL)
        time.sleep(0.5)
    return noted(folder, x, y)


@pytest.mark.peer
@pytest.mark.slow
def test_mpi_with_two_ranks(tmp_path):
    pytest.importorskip('mpi4py')
    mpiexec = shutil.which('mpiexec', path=f'{sysconfig.get_path("scripts")}{os.pathsep}{os.environ["PATH"]}')
    if mpiexec is None:
        pytest.skip('there is no mpiexec')
    mpiexec = str(Path(mpiexec).resolve())  # it looks for its helpers beside itself
    scene = tmp_path / 'chain.toml'
    scene.write_text(ready_scene('chain').read_text())
    words = ['sweep', str(scene), '--over', 'law.a=2:5:7', '--ask', 'bands.X.2', '--ask', 'stability.margin']
    lone = [sys.executable, '-m', 'magphonon', *words]
    subprocess.run([mpiexec, '-n', '2', *lone, '--executor', 'mpi', '-o', str(tmp_path / 'a')], check=True, timeout=600)
    subprocess.run([*lone, '--executor', 'here', '-o', str(tmp_path / 'b')], check=True)
    a, b = (xarray.load_dataset(tmp_path / name / 'sweep.nc', engine='h5netcdf') for name in 'ab')
    assert a.identical(b)
    refused = subprocess.run([mpiexec, '-n', '2', *lone[:-1], 'band.X', '--executor', 'mpi', '-o', str(tmp_path / 'c')],
                             timeout=600, capture_output=True, text=True)
    assert 'is no question' in refused.stderr
    assert refused.returncode == 2
