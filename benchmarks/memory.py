"""How memory and time grow with the number of magnets: `python benchmarks/memory.py [PARTICLES ...] [--chart FILE.png]`.

For each number one process builds a patch on a triangular lattice, finds its bonds, takes time steps with a burst and a
recorded row, and maps the row over wavenumber and frequency.  The table says what each magnet takes: processor time of
each stage, memory that is kept, and the largest memory at any time.
"""

import argparse
import json
import subprocess
import sys
from time import process_time

import numpy as np

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Recorder, ToneBurst, lattices, units as u

PARTICLES = (10_000, 100_000, 1_000_000)
STEPS, EVERY = 60, 5
STAGES = 'patch', 'bonds', 'first step', 'steps', 'map'
GIB = 2.0**30


def peak():
    """Largest resident memory of this process so far, bytes; what getrusage says is at least that of its parent."""
    with open('/proc/self/status') as file:
        return 1024 * int(next(line for line in file if line.startswith('VmHWM')).split()[1])


def kept():
    """Resident memory of this process now, bytes."""
    with open('/proc/self/statm') as file:
        return 4096 * int(file.read().split()[1])


def measure(particles):
    """Seconds of the stages, and bytes at the start, kept and at most, of a patch from its lattice to its map."""
    from magphonon.waves import wavenumber_frequency

    small = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), 9, 9)  # what is loaded and compiled only once
    small.calc = MagneticRepulsion(small, InversePower(1.6209e-10 * u.N * u.m**4.5824, 4.5824), foundation=19.6757 * u.N / u.m)
    DrivenVerlet(small, 0.1 * u.ms, engine='compiled', threads=1).run(2)
    side, seconds, begin, start = round(np.sqrt(particles)), {}, kept(), process_time()

    def stage(name):
        nonlocal start
        seconds[name] = process_time() - start
        start = process_time()

    patch = lattices.parallelogram(lattices.triangular(10 * u.mm, 0.707 * u.g), side, side)
    stage('patch')
    patch.calc = MagneticRepulsion(patch, small.calc.laws, foundation=19.6757 * u.N / u.m)
    stage('bonds')
    row = np.arange(side) * side + side // 2
    burst = ToneBurst(row[1], (0, 1), 1e-4 * u.N, omega=2 * np.pi * 40 * u.Hz)
    dyn = DrivenVerlet(patch, 0.1 * u.ms, [burst], damping=4 / u.s, engine='compiled', threads=1)
    record = Recorder(dyn, row, interval=EVERY)
    dyn.run(1)
    stage('first step')
    dyn.run(STEPS - 1)
    stage('steps')
    wavenumber_frequency(record.displacements[:, 1:-1, 1], EVERY * dyn.dt)
    stage('map')
    return {'particles': len(patch), 'seconds': seconds, 'begin': begin, 'kept': kept(), 'peak': peak()}


def report(found):
    """One line of the table."""
    n, seconds = found['particles'], found['seconds']
    each = '  '.join(f'{1e6 * seconds[name] / n:10.2f}' for name in STAGES[:3])
    kept, most = ((found[name] - found['begin']) / n for name in ('kept', 'peak'))
    return (f'{n:10d}  {each}  {1e9 * seconds["steps"] / n / (STEPS - 1):8.1f}  {seconds["map"]:6.2f}  {kept:8.0f}  {most:8.0f}  '
            f'{found["peak"] / GIB:8.2f}')


def draw(results, file):
    """Seconds until the first step has been made, and the largest memory, over the number of magnets; lines of slope one."""
    from matplotlib import pyplot as plt

    n = np.array([found['particles'] for found in results])
    figure, (left, right) = plt.subplots(1, 2, figsize=(7, 3), layout='constrained')
    build = [sum(found['seconds'][name] for name in STAGES[:3]) for found in results]
    memory = [(found['peak'] - found['begin']) / GIB for found in results]
    for ax, values, label in ((left, build, 'processor time to the first step (s)'), (right, memory, 'memory (GiB)')):
        ax.loglog(n, values, 'ko-', label='measured')
        ax.loglog(n, values[0] * n / n[0], color='0.6', linestyle='--', label='proportional to N')
        ax.set(xlabel='number of magnets N', ylabel=label)
        ax.legend()
    figure.savefig(file, dpi=150)


if __name__ == '__main__':
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('particles', nargs='*', type=int, default=list(PARTICLES), help='by default 1e4, 1e5 and 1e6')
    parser.add_argument('--chart', metavar='FILE.png')
    parser.add_argument('--one', action='store_true', help='measure one number in this process and print it as JSON')
    options = parser.parse_args()
    if options.one:
        print(json.dumps(measure(options.particles[0])))
        sys.exit()
    print('   magnets   patch, us   bonds, us   start, us  step, ns  map, s  kept, B  at most, B  peak, GiB   (each: per magnet)')
    results = []
    for particles in options.particles:
        done = subprocess.run([sys.executable, __file__, '--one', str(particles)], capture_output=True,  # noqa: S603
                              text=True, check=True)
        results.append(json.loads(done.stdout.splitlines()[-1]))
        print(report(results[-1]), flush=True)
    if options.chart:
        draw(results, options.chart)
