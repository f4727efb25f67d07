"""How the linear tools grow with the patch: `python benchmarks/linear_tools.py [PARTICLES ...] [--chart FILE.png]`.

Free motion of 20 ms after a random kick of every magnet, the response to a force in the middle at 100 frequencies, and the
number of modes below a frequency by the density of states, with the methods of SciPy that a reader would take instead.  Each job
runs in a process of its own.  All begin with the atoms and make the matrix of stiffness, whose time has a line of its own, as has
that of the proof that the patch is stable, a part of `frequency_response`.  Only the lines "alone" leave out what is made before.

Seconds are those of the processor on one thread, the least of up to three rounds; those of a response are for each frequency.
The memory is the largest of the process, Python and the patch included.  An error is relative to the largest value of a tighter
reference: DOP853 with a tolerance of 1e-13, sparse LU refined by its residual, the number of negative pivots (Sylvester's law).
"""

import argparse
import json
import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time

os.environ.setdefault('OMP_NUM_THREADS', '1')

import numpy as np
import steps
from scipy import sparse
from scipy.integrate import solve_ivp, trapezoid
from scipy.sparse.linalg import expm_multiply, splu

from magphonon import MagneticRepulsion, frequency_response, lattices, propagate, units as u
from magphonon.response import density_of_states, series_response
from magphonon.stiffness import LinearSystem
from magphonon.stiffness.lowest import count_below

PARTICLES = 1_000, 3_000, 10_000, 100_000, 1_000_000
ROUNDS, PATIENCE = 3, 1.0
DURATION = 20 * u.ms
KICK = 1e-6
"""Momenta in g mm/ms: the motion is linear, so that their size does not matter."""
OMEGA, CHOSEN = 2 * np.pi * np.linspace(32, 143, 100) * u.Hz, 50
"""Of the response, within the bands; the answer at one of them is compared."""
GAMMA, TOLERANCE = 20 / u.s, 1e-6
BELOW, MOMENTS, VECTORS = 2 * np.pi * 80 * u.Hz, 128, 8
RTOL = 1e-10
"""Of DOP853, which brings its error near to that of `propagate`."""


@dataclass(frozen=True)
class Scene:
    """A patch, kicked; its matrix is made when it is first asked for."""

    atoms: object
    side: int

    @classmethod
    def of(cls, particles):
        side = round(np.sqrt(particles))
        atoms = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), side, side)
        atoms.calc = MagneticRepulsion(atoms, steps.LAW, foundation=steps.FOUNDATION)
        kick = np.random.default_rng(0).normal(size=(len(atoms), 3))
        atoms.set_momenta(KICK * kick * (1, 1, 0))
        return cls(atoms, side)

    @cached_property
    def system(self):
        return LinearSystem.of(self.atoms)

    @cached_property
    def force(self):
        """1 N on the magnet in the middle, and the row of ten that begins there."""
        middle = self.side // 2 * self.side + self.side // 2
        force = np.zeros((len(self.atoms), 3))
        force[middle, 1] = 1.0
        return force, middle + np.arange(10)

    @cached_property
    def source(self):
        """The same in the coordinates of the matrix."""
        return self.system.shapes.T @ self.force[0][:, :2].ravel()

    @cached_property
    def start(self):
        """Coordinates, zero, and velocities."""
        velocities = self.system.shapes.T @ self.atoms.get_momenta()[:, :2].ravel()
        return np.append(np.zeros_like(velocities), velocities)


def propagated(scene):
    """Ours: displacements of all magnets."""
    return propagate(scene.atoms, [DURATION]).displacements[0].ravel()


def exponential(scene):
    """`e^{A t}` of the equations of first order, `(y, v)' = (v, -K y)`."""
    K = scene.system.K
    A = sparse.block_array([[None, sparse.eye_array(K.shape[0])], [-K, None]], format='csr')
    return scene.system.shapes @ expm_multiply(A * DURATION, scene.start, traceA=0.0)[: K.shape[0]]


def dop853(scene, rtol=RTOL):
    """Steps of the order eight."""
    K, size = scene.system.K, scene.system.K.shape[0]
    ended = solve_ivp(lambda _, x: np.append(x[size:], -(K @ x[:size])), (0, DURATION), scene.start, 'DOP853', [DURATION],
                      rtol=rtol, atol=rtol * abs(scene.start).max())
    return scene.system.shapes @ ended.y[:size, 0]


def responded(scene):
    """Ours, with the proof that the patch is stable: at the chosen frequency, the row."""
    force, row = scene.force
    return frequency_response(scene.atoms, force, OMEGA, GAMMA, row, TOLERANCE).response[CHOSEN, :, :2]


def series(scene):
    """The Chebyshev series alone."""
    return series_response(scene.system, scene.source, OMEGA, GAMMA, scene.force[1], TOLERANCE)[0][CHOSEN]


def factorised(scene, refined=False):
    """Sparse LU at the chosen frequency."""
    w, size = OMEGA[CHOSEN], scene.system.K.shape[0]
    D = sparse.csc_array(scene.system.K + (1j * GAMMA * w - w**2) * sparse.eye_array(size))
    lu = splu(D)
    y = lu.solve(scene.source + 0j)
    if refined:
        y += lu.solve(scene.source - D @ y)
    return (scene.system.shapes @ y).reshape(-1, 2)[scene.force[1]]


def counted(scene):
    """Ours: the share of the modes below a frequency."""
    found = density_of_states(scene.atoms, np.linspace(0, BELOW, 400), MOMENTS, VECTORS)
    return np.array([trapezoid(found.density, found.omega) / found.modes])


def dense(scene):
    """All squared frequencies."""
    return np.array([(np.linalg.eigvalsh(scene.system.K.toarray()) < BELOW**2).mean()])


@dataclass(frozen=True)
class Job:
    """What is measured, for up to `most` magnets; a task's first job is ours, and `reference` is its tighter answer."""

    run: Callable
    task: str
    most: float
    works: int = 1
    alone: bool = False  # the matrix is made before


REFERENCES = {'20 ms of motion': lambda scene: dop853(scene, 1e-13),
              'response, a frequency': lambda scene: factorised(scene, refined=True),
              'modes below 80 Hz': lambda scene: np.array([count_below(scene.system.K, BELOW**2) / scene.system.K.shape[0]])}
MOTION, RESPONSE, MODES = REFERENCES
PARTS = 'parts of the others'
JOBS = {'propagate': Job(propagated, MOTION, 1e6),
        'expm_multiply': Job(exponential, MOTION, 1e5),
        'DOP853': Job(dop853, MOTION, 1e5),
        'frequency_response': Job(responded, RESPONSE, 1e5, len(OMEGA)),
        'its series alone': Job(series, RESPONSE, 1e5, len(OMEGA), alone=True),
        'sparse LU': Job(factorised, RESPONSE, 1e5),
        'density_of_states': Job(counted, MODES, 1e6),
        'dense eigvalsh': Job(dense, MODES, 3e3),
        'matrix of stiffness': Job(lambda scene: scene.system.K, PARTS, 1e6),
        'proof of stability alone': Job(lambda scene: scene.system.stable, PARTS, 1e5, alone=True)}
REFERRED = 1e5
"""Largest patch with a reference."""


def least(job, scene):
    """Seconds of a work, and the answer; systems are made anew in each round."""
    best, rounds = np.inf, 0
    while rounds == 0 or (rounds < ROUNDS and best * job.works < PATIENCE):
        new = Scene(scene.atoms, scene.side)
        if job.alone:
            _ = new.system.K, new.source
        begin = process_time()
        answer = job.run(new)
        best, rounds = min(best, (process_time() - begin) / job.works), rounds + 1
    return best, answer


def peak():
    """Largest resident memory of this process so far, bytes; what getrusage says is at least that of its parent."""
    with open('/proc/self/status') as file:
        return 1024 * int(next(line for line in file if line.startswith('VmHWM')).split()[1])


def one(name, particles, file):
    """Measure a job in this process, or find a reference; the answer goes to a file."""
    if name in REFERENCES:
        np.save(file, REFERENCES[name](Scene.of(particles)))
        return {}
    least(JOBS[name], Scene.of(500))  # what is loaded and compiled only once
    seconds, answer = least(JOBS[name], scene := Scene.of(particles))
    if JOBS[name].task in REFERENCES:
        np.save(file, answer)
    return {'job': name, 'task': JOBS[name].task, 'particles': len(scene.atoms), 'seconds': seconds, 'peak': peak()}


def elsewhere(name, particles, file):
    """`one` in a process of its own."""
    done = subprocess.run([sys.executable, __file__, '--one', name, str(particles), file], capture_output=True,  # noqa: S603
                          text=True, check=True)
    return json.loads(done.stdout.splitlines()[-1])


def off(answer, reference):
    """Largest difference, as a share of the largest value."""
    return abs(answer - reference).max() / abs(reference).max()


def measured(particles, folder):
    """Rows of the table at one size."""
    references = {}
    for task in REFERENCES if particles <= REFERRED else ():
        elsewhere(task, particles, f'{folder}/reference.npy')
        references[task] = np.load(f'{folder}/reference.npy')
    for name, job in JOBS.items():
        if particles <= job.most:
            found = elsewhere(name, particles, f'{folder}/answer.npy')
            reference = references.get(job.task)
            error = np.nan if reference is None else off(np.load(f'{folder}/answer.npy'), reference)
            yield found | {'error': error}


def slope(rows):
    """Exponent of N in the seconds, from the two largest patches."""
    (n, seconds), (more, longer) = ((row['particles'], row['seconds']) for row in rows[-2:])
    return np.log(longer / seconds) / np.log(more / n)


def draw(rows, file):
    """Seconds by the number of magnets, a panel for each task."""
    from matplotlib.figure import Figure

    figure = Figure((7, 3.6), layout='constrained')
    for ax, task in zip(figure.subplots(1, 3, sharex=True), REFERENCES, strict=True):
        names = (name for name in JOBS if JOBS[name].task == task)
        for name, style, colour in zip(names, ('o-', 's--', '^:'), ('k', '#d55e00', '#0072b2'), strict=False):
            own = [row for row in rows if row['job'] == name]
            if len(own) > 1:
                ax.loglog([row['particles'] for row in own], [row['seconds'] for row in own], style, markersize=4, linewidth=1,
                          color=colour, label=f'{name}, $N^{{{slope(own):.2f}}}$')
        ax.set(xlabel='number of magnets $N$', ylabel='processor time (s)')
        ax.set_title(task, fontsize=9)
        ax.legend(fontsize=7, frameon=False, loc='upper center', bbox_to_anchor=(0.5, -0.2))
    figure.savefig(file, dpi=200)


def main():
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('particles', nargs='*', type=int, default=list(PARTICLES), help='by default 1e3 to 1e6')
    parser.add_argument('--chart', metavar='FILE.png')
    parser.add_argument('--one', nargs=3, metavar=('JOB', 'PARTICLES', 'FILE'), help='one job in this process, as JSON')
    options = parser.parse_args()
    if options.one:
        name, particles, file = options.one
        print(json.dumps(one(name, int(particles), file)))
        return
    print(f'{"magnets":>8}  {"task":22} {"job":24} {"s":>9}  {"us/magnet":>9}  {"GiB":>6}  {"error":>7}')
    rows = []
    with TemporaryDirectory() as folder:
        for particles in options.particles:
            for row in measured(particles, Path(folder)):
                rows.append(row)
                error = '' if np.isnan(row['error']) else f'{row["error"]:7.0e}'
                print(f'{row["particles"]:8d}  {row["task"]:22} {row["job"]:24} {row["seconds"]:9.2g}  '
                      f'{1e6 * row["seconds"] / row["particles"]:9.3g}  {row["peak"] / 2**30:6.2f}  {error}', flush=True)
    for name in JOBS:
        own = [row for row in rows if row['job'] == name]
        if len(own) > 1:
            print(f'{name}: N^{slope(own):.2f} between {own[-2]["particles"]} and {own[-1]["particles"]} magnets')
    if options.chart:
        draw(rows, options.chart)


if __name__ == '__main__':
    main()
