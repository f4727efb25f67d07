"""Sweeps whose first process is killed, on Dask, and on the ranks of MPI."""

import shutil
import subprocess
import sys
import sysconfig
import time
from functools import partial
from os import environ, pathsep
from pathlib import Path

import numpy as np
import pytest
from scene_files import ready_scene
from sweeping import calls, formula, noted

from magphonon.sweeps import sweep

xarray = pytest.importorskip('xarray')
TESTS = Path(__file__).parents[1]
OVER = {'x': np.arange(10.0, 20.0), 'y': np.arange(4.0)}

MASTER = '''
import sys
sys.path.insert(0, {tests!r})
from functools import partial
import numpy as np
from sweeping import noted
from magphonon.sweeps import sweep
if __name__ == '__main__':
    over = {{'x': np.arange(10.0, 20.0), 'y': np.arange(4.0)}}
    sweep(partial(noted, {folder!r}, pause=0.02), over, workers={workers}, journal={journal!r}, name='noted')
'''


def killed_master(folder, workers, lines):
    """Start a sweep in a process of its own, kill it when its journal has so many lines; those lines."""
    (folder / 'calls').mkdir(exist_ok=True)
    journal, program = folder / 'journal', folder / 'program.py'
    program.write_text(MASTER.format(tests=str(TESTS), folder=str(folder / 'calls'), journal=str(journal), workers=workers))
    process = subprocess.Popen([sys.executable, str(program)])
    while process.poll() is None and (not journal.exists() or journal.read_bytes().count(b'\n') < lines):
        time.sleep(0.005)
    process.kill()
    process.wait()
    return journal.read_bytes().split(b'\n')[:-1]


@pytest.mark.slow
@pytest.mark.parametrize('workers', [1, 2])
def test_a_killed_sweep_keeps_what_was_answered(tmp_path, workers):
    kept = []
    for lines in (6, 17):
        after = killed_master(tmp_path, workers, lines)
        assert after[:len(kept)] == kept
        kept = after
    before = sum(calls(tmp_path / 'calls').values())
    found = sweep(partial(noted, str(tmp_path / 'calls')), OVER, journal=tmp_path / 'journal', name='noted')
    np.testing.assert_array_equal(found.value, np.add.outer(OVER['x'], OVER['y']))
    # workers of the killed process may finish the few points that they were given, which no journal has
    assert 40 - len(kept) + 1 <= sum(calls(tmp_path / 'calls').values()) - before + 4 * (workers - 1) <= 40 - len(kept) + 1 + 16


@pytest.mark.slow
def test_dask(tmp_path):
    distributed, joblib = pytest.importorskip('distributed'), pytest.importorskip('joblib')
    over = {'x': np.linspace(0.1, 0.4, 6), 'y': [0.0, 1.0]}
    with distributed.LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=':0', silence_logs=50) as cluster, \
            distributed.Client(cluster) as client, joblib.parallel_config(backend='dask'):
        client.run(sys.path.insert, 0, str(TESTS))
        assert sweep(formula, over).identical(sweep(formula, over, workers=1))


@pytest.mark.peer
@pytest.mark.slow
def test_mpi_with_two_ranks(tmp_path):
    pytest.importorskip('mpi4py')
    mpiexec = shutil.which('mpiexec', path=f'{sysconfig.get_path("scripts")}{pathsep}{environ["PATH"]}')
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
