"""LAMMPS at its fastest honest setting on one core, for `steps.py`; its forces are checked first.

A tabulated pair force with linear interpolation, foundation springs, a neighbour list that is built once, no output.  Pairs
within a cutoff take the place of bonds, which are right at any strain but take LAMMPS 1.5 times as long.  A run ends
wherever an observer would look, and the next one goes on without another set-up; positions stay in LAMMPS.
The plain styles are the faster ones on small patches and their OPENMP versions, on one thread, on large ones.  More
threads are not asked for, neither here nor of magphonon.
"""

import ctypes
import os
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from magphonon.dynamics.lammps import lammps_session, write_lammps_input

STYLES = {'plain': (), 'omp': ('-package', 'omp', '1', '-suffix', 'omp')}


@contextmanager
def lammps_stepper(atoms, timestep, displacements, style, every=10):
    """Yield `seconds(steps)` of a run from `displacements`, and the displacements after its first 100 steps.

    Parameters
    ----------
    atoms : ase.Atoms
        A patch with its MagneticRepulsion, as for `write_lammps_input`.
    timestep : float
        In ms.
    displacements : ndarray, shape (particles, 3)
        From rest in mm, zero where a particle is fixed.
    style : {'plain', 'omp'}
    every : int
        Steps after which it stops.

    Raises
    ------
    RuntimeError
        If the forces are not those of the calculator.
    """
    os.environ['OMP_NUM_THREADS'] = '1'
    displaced = atoms.copy()
    displaced.positions += displacements
    expected = atoms.calc.get_forces(displaced)
    with TemporaryDirectory() as directory:
        write_lammps_input(directory, atoms, timestep, steps=0, interpolation='linear', points=100_000)
        with_pairs(Path(directory, 'in.lammps'), atoms.calc.bonds.cutoff)
        with lammps_session(directory, *STYLES[style]) as lammps:
            x = displaced.positions.ravel()
            lammps.command('timer off')  # a tenth of the step of a hundred particles
            lammps.scatter_atoms('x', 1, 3, (ctypes.c_double * len(x))(*x))
            lammps.command('run 0 post no')
            forces = np.array(lammps.gather_atoms('f', 1, 3)).reshape(-1, 3)
            free = abs(displacements).any(axis=1)  # LAMMPS sums no forces between fixed particles
            error = abs(forces - expected)[free].max() / abs(expected[free]).max()
            if not error < 1e-7:  # a linear table of 100 000 points is good for 1e-8
                raise RuntimeError(f'LAMMPS ({style}) has forces of its own: they differ by {error:.1e} of the largest force')

            def seconds(steps):
                start = perf_counter()
                for _ in range(steps // every):
                    lammps.command(f'run {every} pre no post no')
                return perf_counter() - start

            seconds(100)
            end = np.array(lammps.gather_atoms('x', 1, 3)).reshape(-1, 3) - atoms.positions
            yield seconds, end[:, :2]


def with_pairs(file, cutoff):
    """Let LAMMPS find pairs by their distance instead of by the list of bonds, which is right while none crosses the cutoff."""
    text = file.read_text()
    for old, new in (('lj/coul 0 1 1\nbond_style special', 'lj/coul 1 1 1\nbond_style zero nocoeff'),
                     ('LAW0', f'LAW0 {cutoff:.17g}'), ('neighbor 0 bin', f'neighbor {0.02 * cutoff:.17g} bin'),
                     ('exclude group all all', 'exclude group fixed fixed')):
        if text.count(old) != 1:
            raise RuntimeError(f'the input for LAMMPS has changed: {old!r} is not in it')
        text = text.replace(old, new)
    file.write_text(text)
