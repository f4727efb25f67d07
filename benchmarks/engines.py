"""Which engine for which size: `python benchmarks/engines.py [--sizes 1e3 1e4 1e5 1e6] [--chart FILE.png]`.

A tone burst in the middle of a patch of the paper's magnets, 20 ms of it, by every engine from the same start: NumPy blocks,
compiled blocks on one and two threads, LAMMPS on one and two MPI ranks, and exact propagation, which takes no time steps.  In
turns, the least of ROUNDS counts.  The error is that of the displacements along a row, relative to the largest: of time steps
against those of NumPy blocks, of propagation against the same run with a tenth of the step.
The first table is measured.  The second one is
computed from it: 1e8 magnets on the nodes of a cluster, by the time for a step of one rank and what it sends to its neighbours.
`magphonon plan` names engines by the constants in `magphonon/planning/plan.py`, which were measured by this program.
"""

import argparse
import re
import resource
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter

import numpy as np
import steps

from magphonon import DrivenVerlet, MagneticRepulsion, Recorder, ToneBurst, lattices, propagate, units as u
from magphonon.dynamics.lammps import run_lammps
from magphonon.planning.plan import COMPILED, LAMMPS

ROUNDS = 3
STEPS = 200
LARGEST = {'NumPy blocks': 1e5, 'LAMMPS, 1 rank': 1e6, 'LAMMPS, 2 ranks': 1e6, 'exact propagation': 1e6}
FORCE = 1e-6 * u.N

NODES, RANKS_PER_NODE = (1, 10, 100), 48
LATENCY, BANDWIDTH = 2e-6, 1.25e9
"""Of one message between two nodes in s, and of the share of a rank in the network in bytes/s, as clusters have them."""
SKIN = 1.3
"""Reach of the pair law and the skin of LAMMPS's list of neighbours, in spacings."""


@dataclass
class Measured:
    """An engine at one size."""

    engine: str
    particles: int
    seconds: float
    error: float

    @property
    def per_step(self):
        """Seconds for a particle and a time step, or the time of one."""
        return self.seconds / self.particles / STEPS


def patch(n):
    """`n x n` magnets, a burst on the one in the middle, and the row to be recorded."""
    atoms = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), n, n)
    atoms.calc = MagneticRepulsion(atoms, steps.LAW, foundation=steps.FOUNDATION)
    middle = n // 2 * n + n // 2
    burst = ToneBurst(middle, (0, 1), FORCE, omega=2 * np.pi * 40 * u.Hz, cycles=1)
    return atoms, burst, middle + np.arange(min(n // 2 - 1, 10))


def stepped(atoms, burst, row, engine, threads, dt=steps.DT):
    """Seconds of the steps, and the displacements of the row; what is compiled, is compiled before."""
    moving = atoms.copy()
    moving.calc = atoms.calc
    dyn = DrivenVerlet(moving, dt, [burst], engine=engine, threads=threads)
    recorder = Recorder(dyn, row, round(STEPS * steps.DT / dt))
    dyn.run(0)
    start = perf_counter()
    dyn.run(round(STEPS * steps.DT / dt))
    return perf_counter() - start, recorder.displacements[-1]


def by_lammps(atoms, burst, row, ranks):
    """The same by LAMMPS, whose log tells its time without the start."""
    with TemporaryDirectory() as folder:
        record, = run_lammps(atoms, steps.DT, STEPS, records=[(row, STEPS)], drives=[burst], ranks=ranks, directory=folder)
        log = Path(folder, 'log.lammps').read_text()
    return float(re.search(r'Loop time of (\S+)', log)[1]), record.displacements[-1]


def linear(atoms, burst, row):
    """The same by exact propagation."""
    start = perf_counter()
    moved = propagate(atoms, [STEPS * steps.DT], [burst], particles=row)
    return perf_counter() - start, moved.displacements[-1]


def engines(atoms, burst, row):
    """Name -> function that runs it."""
    return {'NumPy blocks': lambda: stepped(atoms, burst, row, 'numpy', 1),
            'compiled, 1 thread': lambda: stepped(atoms, burst, row, 'compiled', 1),
            'compiled, 2 threads': lambda: stepped(atoms, burst, row, 'compiled', 2),
            'LAMMPS, 1 rank': lambda: by_lammps(atoms, burst, row, 1),
            'LAMMPS, 2 ranks': lambda: by_lammps(atoms, burst, row, 2),
            'exact propagation': lambda: linear(atoms, burst, row)}


def measure(size):
    """All engines at one size, in turns."""
    what = patch(round(np.sqrt(size)))
    particles = len(what[0])
    candidates = {name: run for name, run in engines(*what).items() if particles <= 1.1 * LARGEST.get(name, np.inf)}
    best, found = dict.fromkeys(candidates, np.inf), {}
    for _ in range(ROUNDS):
        for name, run in candidates.items():
            try:
                seconds, found[name] = run()
            except ImportError as missing:
                print(f'{name}: {missing}')
                continue
            best[name] = min(best[name], seconds)
    by_steps = found.get('NumPy blocks', found['compiled, 1 thread'])
    exact = stepped(*what, 'compiled', 1, dt=steps.DT / 10)[1] if 'exact propagation' in found else None
    largest = abs(by_steps).max()
    return [Measured(name, particles, best[name],
                     abs(end - (exact if name == 'exact propagation' else by_steps)).max() / largest)
            for name, end in found.items()]


def memory(size):
    """Peak of a process that builds the patch and runs the compiled blocks, less that of an empty one, in bytes a particle."""
    peaks = []
    for n in (10, round(np.sqrt(size))):
        code = (f'import engines; engines.stepped(*engines.patch({n}), "compiled", 1); '  # getrusage tells the parent's peak, too
                'print(next(line for line in open("/proc/self/status") if line.startswith("VmHWM")).split()[1])')
        done = subprocess.run([sys.executable, '-c', code], cwd=Path(__file__).parent, capture_output=True,  # noqa: S603  our own
                              text=True, check=True)
        peaks.append(1024 * int(done.stdout))
    return (peaks[1] - peaks[0]) / size


def on_paper(particles, nodes):
    """Seconds of a step on nodes of a cluster, and the share of it that is spent on sending.

    Each rank holds a square of `particles / ranks` magnets and sends the positions of a frame around it, SKIN wide, in four
    messages to its neighbours; half the messages of a rank go to another node at most, all are taken to.
    """
    ranks = nodes * RANKS_PER_NODE
    own = particles / ranks
    frame = 4 * SKIN * np.sqrt(own)
    computing = own * LAMMPS.seconds
    sending = 4 * LATENCY + 24 * frame / BANDWIDTH
    return computing + sending, sending / (computing + sending)


def draw(rows, file):
    """Time of a step by the number of magnets."""
    from matplotlib.figure import Figure

    figure = Figure((3.4, 3.6), layout='constrained')
    ax = figure.add_subplot()
    styles = dict(zip(dict.fromkeys(row.engine for row in rows), ('o:', 's-', 's--', '^-', '^--', 'd-.'), strict=False))
    shades = {'NumPy': '0.5', 'compiled': '#0072b2', 'LAMMPS': '#d55e00', 'exact': 'k'}
    for name, style in styles.items():
        own = [row for row in rows if row.engine == name]
        ax.loglog([row.particles for row in own], [1e9 * row.per_step for row in own], style, markersize=4, linewidth=1,
                  color=shades[re.split('[ ,]', name)[0]], label=name)
    ax.set(xlabel='magnets', ylabel='time per magnet and time step (ns)')
    figure.legend(loc='outside upper center', ncols=2, fontsize=6.5, frameon=False)
    figure.savefig(file, dpi=200)


def main():
    """Print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--sizes', nargs='+', type=float, default=[1e3, 1e4, 1e5, 1e6])
    parser.add_argument('--chart', metavar='FILE.png')
    options = parser.parse_args()
    rows = []
    print(f'{"magnets":>9}  {"engine":20} {"ns a step":>10}  {"error":>8}')
    for size in options.sizes:
        for row in measure(size):
            rows.append(row)
            print(f'{row.particles:9d}  {row.engine:20} {1e9 * row.per_step:10.2f}  {row.error:8.1e}', flush=True)
    bytes_each = memory(5e5)
    print(f'\nCompiled blocks take {bytes_each:.0f} bytes a magnet (told: {COMPILED.bytes:.0f}); this process took '
          f'{resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20:.1f} GiB.')
    print(f'\nOn paper, with LAMMPS at {1e9 * LAMMPS.seconds:.0f} ns, {RANKS_PER_NODE} ranks a node, {1e6 * LATENCY:g} us a '
          f'message, {BANDWIDTH / 1e9:g} GB/s a rank:')
    print(f'{"magnets":>9}  {"nodes":>5}  {"s a step":>9}  {"sending":>7}  {"1e5 steps":>10}')
    for particles in (1e6, 1e7, 1e8):
        for nodes in NODES:
            seconds, share = on_paper(particles, nodes)
            print(f'{particles:9.0e}  {nodes:5d}  {seconds:9.1e}  {share:7.1%}  {1e5 * seconds / 3600:8.2f} h')
        seconds = particles * COMPILED.seconds
        print(f'{particles:9.0e}  {"one":>5}  {seconds:9.1e}  {"":7}  {1e5 * seconds / 3600:8.2f} h   compiled blocks, one '
              f'thread, {particles * COMPILED.bytes / 2**30:.0f} GiB')
    if options.chart:
        draw(rows, options.chart)


if __name__ == '__main__':
    main()
