"""Runs of a patch by the program `lmp` of LAMMPS, on any number of MPI ranks, instead of by `DrivenVerlet`.

All files of a run are in one folder, which can be copied to a cluster: `submit.sh` runs it there, and continues from the newest
restart file if it is submitted again.  `run_lammps` with the same arguments then reads the records.
"""

from __future__ import annotations

import shutil
import subprocess
import sysconfig
from dataclasses import dataclass
from importlib import metadata
from os import environ, pathsep
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np

from ..errors import whole
from ..files import whole_file
from .lammps import RESTARTS, write_lammps_input

if TYPE_CHECKING:
    from collections.abc import Sequence
    from os import PathLike
    from typing import Any

    from ase import Atoms
    from numpy.typing import NDArray

    from .drives import ToneBurst

FRAME = 'ITEM: TIMESTEP\n'
HEADER = 8
"""Number of header lines between FRAME and the particles of a frame."""
RESTARTS_OF_A_RUN = 20
"""Number of restart files that a run writes; a killed run loses at most this fraction of its steps."""
BATCH = """\
#!/bin/bash
#SBATCH --job-name=magphonon
#SBATCH --ntasks={ranks}
#SBATCH --time=24:00:00
# Runs on {ranks} ranks: `sbatch submit.sh` on a cluster with SLURM, `bash submit.sh` elsewhere.  LAMMPS must be in the search
# path (on a cluster perhaps by: module load lammps).  If it is submitted again, it continues from the newest restart file.
set -e
cd "${{SLURM_SUBMIT_DIR:-$(dirname "$0")}}"
newest=$(ls -t {restarts} 2>/dev/null | head -n 1 || true)
if [ -n "$newest" ]; then
  mpiexec -n "${{SLURM_NTASKS:-{ranks}}}" lmp -in in.restart -var state "$newest"
else
  mpiexec -n "${{SLURM_NTASKS:-{ranks}}}" lmp -in in.lammps
fi
"""


@dataclass(frozen=True)
class LammpsRecord:
    """A record of particles, with the same content as that of a `Recorder`.

    Attributes
    ----------
    times : ndarray, shape (frames,)
        In ms.
    particles : ndarray of int, shape (particles,)
    displacements : ndarray, shape (frames, particles, 2)
        From rest, in mm.
    """

    times: NDArray[np.float64]
    particles: NDArray[np.int_]
    displacements: NDArray[np.float64]


def run_lammps(atoms: Atoms, timestep: float, steps: int, *, records: Sequence[tuple[Any, int]], drives: Sequence[ToneBurst] = (),
               damping: float = 0.0, ranks: int = 1, directory: str | PathLike[str] | None = None) -> tuple[LammpsRecord, ...]:
    """Run a patch from rest by LAMMPS.

    LAMMPS computes forces from absolute positions, so displacements have an absolute error of 1e-15 times the size of the
    patch, however small they are.

    Parameters
    ----------
    atoms : ase.Atoms
        As for `write_lammps_input`; they are not changed.
    timestep : float
        In ms.
    steps : int
    records : sequence of (particles, interval)
        Which particles (None for all) are recorded, and how many steps lie between two frames.
    drives : sequence of ToneBurst
    damping : float
        Decay rate of the velocities in 1/ms.
    ranks : int
        MPI ranks.
    directory : path-like, optional
        Folder for the files of the run.  If it holds files of the same run they are used: complete records are read, and a
        stopped run continues from its newest restart file.

    Returns
    -------
    tuple of LammpsRecord
        One for each of `records`.

    Raises
    ------
    ValueError
        If LAMMPS cannot run this scene, or stops, or if the folder holds the files of another run.
    ImportError
        If LAMMPS is not installed, or mpiexec for more than one rank.
    """
    ranks = whole('ranks', ranks)
    if directory is None:
        with TemporaryDirectory() as made:
            return run_lammps(atoms, timestep, steps, records=records, drives=drives, damping=damping, ranks=ranks,
                              directory=made)
    directory = Path(directory)
    directory.mkdir(exist_ok=True)
    _write(directory, atoms, timestep, steps, drives, damping, records)
    with whole_file(directory / 'submit.sh') as file:
        file.write(BATCH.format(ranks=ranks, restarts=' '.join(RESTARTS)))
    if not (directory / 'complete').exists():
        _run(directory, ranks)
    return tuple(_record(directory / f'record{n}.dump', atoms, particles, timestep) for n, (particles, _) in enumerate(records))


def _write(directory, atoms, timestep, steps, drives, damping, records):
    """Write the input; refuse a folder whose input differs."""
    with TemporaryDirectory() as made:
        stage = Path(made)
        write_lammps_input(stage, atoms, timestep, steps, drives=drives, damping=damping, records=records,
                           restart=max(1, steps // RESTARTS_OF_A_RUN))
        names = [file.name for file in stage.iterdir()]
        there = [name for name in names if (directory / name).exists()]
        for name in there:
            if (directory / name).read_bytes() != (stage / name).read_bytes():
                raise ValueError(f'{directory / name} belongs to another run; name another folder, or remove this one')
        for name in set(names) - set(there):
            shutil.copyfile(stage / name, directory / name)


def _run(directory, ranks):
    """Start LAMMPS in the folder, from the newest restart file if there is one."""
    lmp = [_program('lmp', 'lammps')]
    command = [_program('mpiexec', 'mpich'), '-n', str(ranks), *lmp] if ranks > 1 else lmp
    states = sorted((directory / name for name in RESTARTS if (directory / name).exists()), key=lambda file: file.stat().st_mtime)
    given = ['-in', 'in.restart', '-var', 'state', states[-1].name] if states else ['-in', 'in.lammps']
    done = subprocess.run([*command, *given, '-screen', 'none', '-nocite'], cwd=directory,  # noqa: S603  no shell
                          capture_output=True, text=True, stdin=subprocess.DEVNULL, check=False)
    if done.returncode or not (directory / 'complete').exists():
        log = directory / 'log.lammps'
        lines = (log.read_text() if log.exists() else done.stderr + done.stdout).splitlines()
        why = next((line for line in lines if 'ERROR' in line), lines[-1] if lines else f'exit status {done.returncode}')
        raise ValueError(f'LAMMPS stopped: {why.strip()}; its files are in {directory}; lower the drives or the time step')


def _program(name, package):
    """Path of a program: in the folder of this Python's scripts, in the search path, or where a wheel installed it."""
    found = shutil.which(name, path=f'{sysconfig.get_path("scripts")}{pathsep}{environ.get("PATH", "")}')
    try:
        installed = [file.locate() for file in metadata.files(package) or () if file.name == name and file.parent.name == 'bin']
    except metadata.PackageNotFoundError:
        installed = []
    for path in (found, *installed):
        if path is not None and Path(str(path)).exists():
            return str(Path(str(path)).resolve())  # mpiexec looks for its helpers beside itself
    raise ImportError(f"the program {name} is not installed; pip install 'magphonon[peers]', or load it as the manual of your "
                      'cluster says')


def _record(file, atoms, particles, timestep):
    """Read a dump; of a frame that was written twice, before and after a restart, the later one counts."""
    particles = np.arange(len(atoms)) if particles is None else np.atleast_1d(particles)
    ordered, back = np.unique(particles, return_inverse=True)  # LAMMPS sorts by number
    rest = atoms.positions[ordered, :2]
    frames = {}
    for frame in file.read_text().split(FRAME)[1:]:
        lines = frame.split('\n')
        if len(lines) > HEADER + len(ordered):  # or cut off
            rows = np.array(' '.join(lines[HEADER:HEADER + len(ordered)]).split(), dtype=float).reshape(-1, 3)
            frames[int(lines[0])] = (rows[:, 1:] - rest)[back]
    numbers = sorted(frames)
    return LammpsRecord(timestep * np.array(numbers), particles, np.array([frames[n] for n in numbers]))
