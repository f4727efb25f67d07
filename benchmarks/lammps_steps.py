"""LAMMPS at its fastest honest setting on one core: seconds per step of an undriven patch, its forces checked first.

A tabulated pair force with linear interpolation, foundation springs, a neighbour list that is built once, no output.
The plain styles are the faster ones on small patches and their OPENMP versions, on one thread, on large ones.
"""

import ctypes
import os
from contextlib import contextmanager
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np

from magphonon.lammps_input import lammps_session, write_lammps_input

STYLES = {'plain': (), 'omp': ('-package', 'omp', '1', '-suffix', 'omp')}


@contextmanager
def lammps_stepper(atoms, timestep, displacements, style):
    """Yield `seconds(steps)` of a run from `displacements`, and the largest error of a force by the largest force.

    Parameters
    ----------
    atoms : ase.Atoms
        A patch with its MagneticRepulsion, as for `write_lammps_input`.
    timestep : float
        In ms.
    displacements : ndarray, shape (particles, 3)
        From rest in mm, zero where a particle is fixed.
    style : {'plain', 'omp'}

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
        with lammps_session(directory, *STYLES[style]) as lammps:
            x = displaced.positions.ravel()
            lammps.command('timer off')  # a tenth of the step of a hundred particles
            lammps.scatter_atoms('x', 1, 3, (ctypes.c_double * len(x))(*x))
            lammps.command('run 0 post no')
            forces = np.array(lammps.gather_atoms('f', 1, 3)).reshape(-1, 3)
            free = abs(displacements).any(axis=1)  # LAMMPS sums no forces between fixed particles
            error = abs(forces - expected)[free].max() / abs(expected[free]).max()
            if not error < 1e-6:  # a linear table of 100 000 points is good for 1e-8
                raise RuntimeError(f'LAMMPS ({style}) has forces of its own: they differ by {error:.1e} of the largest force')

            def seconds(steps):
                start = perf_counter()
                lammps.command(f'run {steps} pre no post no')
                return perf_counter() - start

            yield seconds, error


def lammps_seconds_per_step(atoms, timestep, displacements, steps, rounds=3):
    """Seconds per step of the faster style, the least of `rounds`, and the error of its forces; see `lammps_stepper`."""
    found = []
    for style in STYLES:
        with lammps_stepper(atoms, timestep, displacements, style) as (seconds, error):
            seconds(max(steps // 10, 2))  # warms the caches
            found.append((min(seconds(steps) for _ in range(rounds)) / steps, error, style))
    return min(found)


if __name__ == '__main__':
    from magphonon import InversePower, MagneticRepulsion, lattices
    from magphonon import units as u

    law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
    for n in (10, 32, 100, 316):
        atoms = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), n, n)
        atoms.calc = MagneticRepulsion(atoms, law, foundation=19.6757 * u.N / u.m)
        displacements = np.zeros((n * n, 3))
        displacements[:, :2] = 1e-2 * np.random.default_rng(1).standard_normal((n * n, 2)) * (atoms.get_tags() == 0)[:, None]
        second, error, style = lammps_seconds_per_step(atoms, 0.1 * u.ms, displacements, max(20, 10**6 // n**2))
        print(f'N = {n * n:6d}  {second / n**2 * 1e9:5.1f} ns per particle-step ({style}), force error {error:.1e}', flush=True)
