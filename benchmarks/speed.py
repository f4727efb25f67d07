"""What is fast, and by how much: `python benchmarks/speed.py [ROW ...] [--chart FILE.png]` measures and prints one table.

A row is a job and its peers, run in turns in one process, of which the least time of several rounds counts; a peer that is
not installed is left out.  A row says what error the time bought, what ratio was wished for, and whether it was reached.
Other benchmarks add theirs with `@row(...)`.  Set OMP_NUM_THREADS=1: threads are asked for by name.
"""

import argparse
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, process_time, sleep, thread_time

import large_cells
import linear_tools
import numpy as np
import steps
from lammps_steps import STYLES, lammps_stepper
from matplotlib.ticker import EngFormatter

from magphonon import DrivenVerlet, Harmonic, MagneticRepulsion, analytic_bands, finite_displacements, phonopy_bands
from magphonon.bands import bloch_modes
from magphonon.dynamics.engine import PIECES
from magphonon.sweeps import sweep

DURATION = EngFormatter('s', places=2)
ROUNDS, SECONDS = 7, 0.15
ROWS = {}
"""Name of a row -> function that measures it and returns Results."""


@dataclass
class Result:
    """One line of the table: seconds of a job and of its peer, per unit of work."""

    job: str
    peer: str
    seconds: float
    peer_seconds: float
    error: float  # nan where the answer is the same
    goal: float

    @property
    def ratio(self):
        return self.peer_seconds / self.seconds

    def __str__(self):
        met = 'met' if self.ratio >= self.goal else f'{self.ratio / self.goal:.0%} of it'
        error = '' if np.isnan(self.error) else f'error {self.error:.0e}'
        return (f'{self.job:44s} {DURATION(self.seconds):>9s}   {self.peer:24s} {DURATION(self.peer_seconds):>9s}   '
                f'{self.ratio:6.2f} x   goal {self.goal:4.1f}: {met:10s} {error}')


def row(name):
    """Add a function to the table under a name."""

    def add(function: Callable[[], list[Result]]):
        ROWS[name] = function
        return function

    return add


def in_turns(candidates, clock=thread_time, together=10):
    """The least seconds of each, per unit; `candidates` is name -> function(repeats), of so many units `together`.

    On one thread they are seconds of that thread, which other users of the machine do not lengthen.
    """
    def seconds(work, repeats):
        start = clock()
        work(repeats)
        return clock() - start

    best = dict.fromkeys(candidates, np.inf)
    repeats = {name: together * max(1, round(SECONDS / (seconds(work, 2 * together) / 2 + 1e-9)))
               for name, work in candidates.items()}
    for _ in range(ROUNDS):
        for name, work in candidates.items():
            best[name] = min(best[name], seconds(work, repeats[name]) / repeats[name])
    return best


def scattered(n):
    """The patch with its magnets up to 2 % of the spacing off their places, in any order, and stiffly held there."""
    atoms, _ = steps.patch(n)
    rng = np.random.default_rng(5)
    atoms.positions[:, :2] += 0.02 * 10 * rng.uniform(-1, 1, (len(atoms), 2))
    atoms = atoms[rng.permutation(len(atoms))]
    atoms.set_array('site', None)
    return atoms, steps._displaced(atoms)


def irregular(n):
    """The same with magnets up to 15 % off, which lie on no grid any more."""
    atoms, displacements = scattered(n)
    atoms.positions[:, :2] += 0.13 * 10 * np.random.default_rng(6).uniform(-1, 1, (len(atoms), 2))
    return atoms, displacements


def compiled(start, threads=1, engine='compiled', every=10):
    """`seconds(steps)` of blocks of steps, with an observer every so many steps, and the displacements after the first 100."""
    dyn = DrivenVerlet(moving(*start), steps.DT, engine=engine, threads=threads)
    dyn.attach(lambda: None, every)
    return steps._stepper(dyn, lambda: dyn.displacements)


def moving(atoms, displacements, foundation, cutoff=13.0):
    """A copy with bonds up to a distance, that starts from the displacements."""
    copy = atoms.copy()
    copy.calc = MagneticRepulsion(atoms, steps.LAW, foundation=foundation, cutoff=cutoff)
    copy.positions += displacements
    return copy


def against_lammps(job, make, n, foundation, goal, every=10):
    """Compiled blocks on one thread against the faster one of LAMMPS's styles, both of which stop after so many steps."""
    atoms, displacements = make(n)
    start = atoms, displacements, foundation
    seconds, end = compiled(start, every=every)
    dyn = DrivenVerlet(moving(*start), steps.DT, engine='numpy')
    dyn.run(0)
    dyn._blocks._fit(len(steps.RANGES) + 1)
    dyn.run(100)
    error = steps.apart(end, dyn.displacements)
    candidates = {'magphonon': seconds}
    with ExitStack() as stack:
        at_rest = atoms.copy()
        at_rest.calc = moving(*start).calc
        try:
            for style in STYLES:
                stepper = lammps_stepper(at_rest, steps.DT, displacements, style, every)
                candidates[f'LAMMPS {style}'] = stack.enter_context(stepper)[0]
        except ImportError:
            print(f'{job}: LAMMPS is not installed')
            return []
        best = in_turns(candidates, together=every)
    peer = min((name for name in best if name != 'magphonon'), key=best.get)
    count = len(atoms)
    return [Result(f'{job}, {count} magnets', peer, best['magphonon'] / count, best[peer] / count, error, goal)]


for n, name in ((100, 'patch 1e4'), (316, 'patch 1e5'), (1000, 'patch 1e6')):
    row(name)(lambda n=n: against_lammps('patch', steps.patch, n, steps.FOUNDATION, 10))
for n, name in ((100, 'seldom 1e4'), (316, 'seldom 1e5')):
    row(name)(lambda n=n: against_lammps('patch, looked at every 100 steps', steps.patch, n, steps.FOUNDATION, 10, every=100))
row('scattered 1e4')(lambda: against_lammps('2 % off their places', scattered, 100, 100 * steps.FOUNDATION, 3))
row('scattered 1e5')(lambda: against_lammps('2 % off their places', scattered, 316, 100 * steps.FOUNDATION, 3))


@row('disorder')
def disorder():
    """Scattered against ordered, of the same size."""
    ordered, other = (*steps.patch(100), steps.FOUNDATION), (*scattered(100), 100 * steps.FOUNDATION)
    one, two = compiled(ordered), compiled(other)
    best = in_turns({'ordered': one[0], 'scattered': two[0]})
    return [Result('2 % off their places, 10000 magnets', 'ordered (1/1.5 wanted)', best['scattered'] / 1e4,
                   best['ordered'] / 1e4, np.nan, 1 / 1.5)]


@row('irregular 1e4')
def table():
    """Magnets on no grid, by compiled and by NumPy blocks; LAMMPS would see pairs come and go at the end of its reach."""
    start = *irregular(100), 1000 * steps.FOUNDATION
    one, two = compiled(start), compiled(start, engine='numpy')
    best = in_turns({'compiled': one[0], 'numpy': two[0]})
    return [Result('15 % off, a table, 10000 magnets', 'NumPy blocks', best['compiled'] / 1e4, best['numpy'] / 1e4,
                   steps.apart(one[1], two[1]), 2)]


@row('threads')
def threads():
    """Two threads against one; the error is whether any bit differs."""
    found = []
    for n in (316, 1000):
        start = *steps.patch(n), steps.FOUNDATION
        one, two = compiled(start), compiled(start, threads=2)
        best = in_turns({'one': one[0], 'two': two[0]}, clock=perf_counter)
        found.append(Result(f'two threads, {n * n} magnets', 'one thread', best['two'] / n**2, best['one'] / n**2,
                            steps.apart(two[1], one[1]), 1.8))
    return found


def shaken(force, engine='compiled'):
    """A patch in the middle of which one magnet is shaken, by a force in N that the damping balances, after 300 steps."""
    atoms = steps.patch(100)[0]
    middle = np.linalg.norm(atoms.positions - atoms.positions.mean(axis=0), axis=1).argmin()
    dyn = DrivenVerlet(moving(atoms, 0 * atoms.positions, steps.FOUNDATION), steps.DT, [Harmonic([middle], (0, 1), force, 0.4)],
                       damping=0.05, engine=engine, threads=1)
    return after(dyn, 300, engine)


def hot(size, engine='compiled'):
    """A patch whose magnets all have left their places by `size` in mm, along x and along y, after 100 steps."""
    atoms, displacements = steps.patch(100)
    dyn = DrivenVerlet(moving(atoms, displacements * (size / 0.01), steps.FOUNDATION), steps.DT, engine=engine, threads=1)
    return after(dyn, 100, engine)


def after(dyn, count, engine):
    """The run after some steps with an observer every ten; by NumPy with the law itself."""
    dyn.attach(lambda: None, 10)
    dyn.run(0)
    if engine == 'numpy':
        dyn._blocks._fit(PIECES + 1)
    dyn.run(count)
    return dyn


@row('large motion')
def large():
    """Motion beyond the reach of the polynomials, against one a thousand times as small, of the same patch.

    In the first, bonds are far near the source only, and the other runs of slots keep a polynomial.  In the second all bonds are
    spread: a third take the polynomial that reaches furthest, which has four times as many coefficients, and the others the
    pieces, five coefficients of which are looked up for each bond: these loads are what limits it.
    """
    found = []
    for job, scene, size in (('shaken by 0.5 N', shaken, 0.5), ('all displaced by 5 %', hot, 0.5)):
        small, far, exact = scene(size / 1000), scene(size), scene(size, 'numpy').displacements
        if far._blocks._level != PIECES:
            raise RuntimeError(f'the strain of "{job}" does not call for the law in pieces')
        error = steps.apart(far.displacements, exact)
        strain = far._blocks._strain()
        best = in_turns({'small': small.run, 'far': far.run})
        found.append(Result(f'{job}, strain {strain:.1f}, 10000 magnets', 'a thousandth of it', best['far'] / 1e4,
                            best['small'] / 1e4, error, 0.5))
    return found


def waiting(point, seconds):
    """How long a point of a sweep really took."""
    start = perf_counter()
    sleep(seconds)
    return perf_counter() - start


@row('sweeps')
def sweep_rows():
    """Two workers against one that spends no time on anything but the points; the workers run already."""
    found = []
    sweep(waiting, {'point': np.arange(4.0), 'seconds': [0.01]}, workers=2)
    for points, seconds in (10_000, 1e-3), (40, 0.25):
        with TemporaryDirectory() as folder:
            start = perf_counter()
            busy = sweep(waiting, {'point': np.arange(float(points)), 'seconds': [seconds]}, workers=2,
                         journal=Path(folder, 'journal'), name='waiting').value.sum()
            wall = perf_counter() - start
        found.append(Result(f'sweep, {points} points of {1e3 * seconds:g} ms', 'one worker, points alone',
                            wall * seconds / float(busy), seconds, np.nan, 1.9))
    return found


@row('bands')
def path_rows():
    """300 wavevectors of the prototype: the Bloch matrix, and phonopy's displacements in 3 x 3 cells."""
    cell = large_cells.prototype()
    path = cell.cell.bandpath('GMKG', npoints=300, pbc=cell.pbc)

    def phonopy():
        return phonopy_bands(finite_displacements(cell, supercell=(3, 3, 1)), path)

    exact = analytic_bands(cell, path).omega
    error = abs(phonopy().omega - exact).max() / exact.max()  # of the peer
    best = in_turns({'analytic': lambda n: [analytic_bands(cell, path) for _ in range(n)],
                     'phonopy': lambda n: [phonopy() for _ in range(n)]}, clock=process_time)
    return [Result('bands of the prototype, 300 wavevectors', f'phonopy, error {error:.0e}', best['analytic'], best['phonopy'],
                   np.nan, 20)]


@row('large cells')
def large_cell_rows():
    """The lowest eight branches of cells of disorder, for each wavevector, against all of them and against phonopy."""
    found = []
    for side, peer, goal in ((17, large_cells.PHONOPY, 20), (17, large_cells.ALL, 2), (32, large_cells.ALL, 10)):
        count, seconds, errors = large_cells.large_cell(side, phonopy=peer == large_cells.PHONOPY)
        own, others = (seconds[name] / large_cells.WAVEVECTORS for name in (large_cells.LOWEST, peer))
        found.append(Result(f'{large_cells.LOWEST} of {count} magnets', peer, own, others, errors[large_cells.LOWEST], goal))
    return found


@row('mesh')
def mesh_rows():
    """A million wavevectors of the prototype, each, and phonopy's at some thousands of them."""
    cell = large_cells.prototype()
    phonon = finite_displacements(cell, supercell=(3, 3, 1))
    q = np.random.default_rng(0).uniform(size=(large_cells.MESH**2, 3)) * cell.pbc
    some = q[:4000]
    seconds, answers = large_cells.least({'magphonon': lambda: bloch_modes(cell, q)[0],
                                          'phonopy': lambda: phonon.run_qpoints(some).frequencies})
    exact = answers['magphonon'][: len(some)]
    error = abs(np.sort(answers['phonopy'], axis=1)[:, 1:] * 2 * np.pi / 1e3 - exact).max() / exact.max()
    return [Result(f'a mesh of {len(q):.0e} wavevectors', f'phonopy, error {error:.0e}', seconds['magphonon'] / len(q),
                   seconds['phonopy'] / len(some), np.nan, 1)]


@row('linear tools')
def linear_tool_rows():
    """Motion, response and density of states of a patch, from the atoms to the answer."""
    found = []
    for own, peer, particles, goal in (('propagate', 'expm_multiply', 20_000, 1), ('propagate', 'DOP853', 20_000, 1),
                                       ('frequency_response', 'sparse LU', 20_000, 1),
                                       ('density_of_states', 'dense eigvalsh', 1_000, 1)):
        scene, task = linear_tools.Scene.of(particles), linear_tools.JOBS[own].task
        rounds = [[linear_tools.least(linear_tools.JOBS[name], scene) for name in (own, peer)] for _ in range(2)]
        seconds, peer_seconds = (min(turn[k][0] for turn in rounds) for k in (0, 1))
        exact = linear_tools.REFERENCES[task](scene)
        error, peer_error = (linear_tools.off(answer, exact) for _, answer in rounds[0])
        found.append(Result(f'{own}, {len(scene.atoms)} magnets', f'{peer}, error {peer_error:.0e}', seconds, peer_seconds, error,
                            goal))
    return found


def draw(results, file):
    """Ratios on a logarithmic axis, and what was wished for."""
    from matplotlib import pyplot as plt

    figure, ax = plt.subplots(figsize=(7, 0.8 + 0.22 * len(results)), layout='constrained')
    y = np.arange(len(results))[::-1]
    ratios = [result.ratio for result in results]
    ax.hlines(y, 1, ratios, color='0.6', linewidth=2)
    ax.plot(ratios, y, 'o', color='#0072b2', markersize=5, label='measured')
    ax.plot([result.goal for result in results], y, 'k|', markersize=10, label='wanted')
    ax.set_yticks(y, [f'{result.job} / {result.peer}' for result in results], fontsize=7)
    ax.axvline(1, color='k', linewidth=0.5)
    ax.set(xlabel='times as fast as the peer', xscale='log')
    figure.legend(loc='outside upper right', ncols=2, fontsize=8)
    figure.savefig(file, dpi=150)


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('rows', nargs='*', metavar='ROW', help=f'of {", ".join(ROWS)}; all by default')
    parser.add_argument('--chart', metavar='FILE.png')
    options = parser.parse_args()
    begin, results = perf_counter(), []
    for name in options.rows or ROWS:
        for result in ROWS[name]():
            print(result, flush=True)
            results.append(result)
    print(f'{len(results)} lines in {perf_counter() - begin:.0f} s; {sum(r.ratio >= r.goal for r in results)} goals met')
    if options.chart:
        draw(results, options.chart)
