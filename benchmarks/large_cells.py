"""What bands cost in large cells and on large meshes: `python benchmarks/large_cells.py [--chart FILE.png]`.

The prototype's magnets in cells of 9 to 1024, whose masses scatter by 10 %: the eight lowest branches at ten wavevectors, the
check that the cell is at rest included.  phonopy displaces every magnet, so that its time is given up to 289.  Then meshes of a
million wavevectors, with the memory of their arrays.  Seconds are those of the processor, on all threads; the least of up to
three rounds in turns counts.
"""

import argparse
import os
import tracemalloc
from functools import partial
from time import process_time

os.environ.setdefault('OMP_NUM_THREADS', '1')

import numpy as np
from matplotlib.ticker import ScalarFormatter

from magphonon import InversePower, MagneticRepulsion, analytic_bands, finite_displacements, lattices, phonopy_bands, units as u
from magphonon.bands import bloch_modes, lattice_density, zone_map

LAW = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
SIDES = 3, 5, 7, 10, 13, 15, 17, 23, 32
BRANCHES, WAVEVECTORS = 8, 10
MOST_DISPLACED = 289
ROUNDS, PATIENCE = 3, 1.0
LOWEST, ALL, PHONOPY = f'{BRANCHES} lowest branches', 'all branches, dense', 'phonopy'
MESH = 1000


def prototype(lattice=lattices.triangular, side=1, scatter=0.0):
    """The paper's magnets and pillars in side x side cells of a lattice; masses scatter by a fraction."""
    cell = lattice(10 * u.mm, 0.707 * u.g).repeat((side, side, 1))
    cell.set_masses(cell.get_masses() * (1 + scatter * np.random.default_rng(side).normal(size=len(cell))))
    cell.calc = MagneticRepulsion(cell, LAW, foundation=19.6757 * u.N / u.m)
    return cell


def least(jobs):
    """Seconds of each job, name -> function, and what it returned."""
    seconds, found = dict.fromkeys(jobs, np.inf), {}
    for _ in range(ROUNDS):
        for name, job in jobs.items():
            if name not in found or seconds[name] < PATIENCE:
                start = process_time()
                found[name] = job()
                seconds[name] = min(seconds[name], process_time() - start)
    return seconds, found


def large_cell(side, phonopy=True):
    """Seconds of each method, and its largest error in units of the highest frequency; the dense matrix is the reference."""
    cell = prototype(side=side, scatter=0.1)
    path = cell.cell.bandpath('GMKG', npoints=WAVEVECTORS, pbc=cell.pbc)
    jobs = {LOWEST: partial(analytic_bands, cell, path, branches=BRANCHES), ALL: partial(analytic_bands, cell, path)}
    if phonopy and len(cell) <= MOST_DISPLACED:
        jobs[PHONOPY] = lambda: phonopy_bands(finite_displacements(cell), path)
    seconds, bands = least(jobs)
    exact = bands[ALL].omega
    errors = {name: abs(found.omega[:, :BRANCHES] - exact[:, :BRANCHES]).max() / exact.max() for name, found in bands.items()}
    return len(cell), seconds, errors


def meshes():
    """Jobs on a million wavevectors and more: name -> (wavevectors, function)."""
    triangular, honeycomb = prototype(), prototype(lattices.honeycomb)
    n = np.arange(MESH) / MESH
    q = np.stack(np.meshgrid(n, n, 0), axis=-1)
    around = zone_map(triangular, 6).q[..., 0].size / 36  # points of a map by those of one period
    return {'frequencies, triangular': (MESH**2, partial(bloch_modes, triangular, q)),
            'frequencies, honeycomb': (MESH**2, partial(bloch_modes, honeycomb, q)),
            'density of states, triangular': (MESH**2, partial(lattice_density, triangular, steps=MESH)),
            'density of states, honeycomb': (MESH**2, partial(lattice_density, honeycomb, steps=MESH)),
            'map with velocities, triangular': (round(around * MESH**2), partial(zone_map, triangular, MESH))}


def draw(rows, file):
    """Time and error against the number of particles; small cells use the dense method, without a difference."""
    from matplotlib import pyplot as plt

    figure, panels = plt.subplots(1, 2, figsize=(8, 3.4), layout='constrained')
    for name, colour, style in ((LOWEST, 'k', 'o-'), (ALL, 'C0', 's--'), (PHONOPY, 'C1', '^:')):
        measured = [(count, seconds[name]) for count, seconds, _ in rows if name in seconds]
        panels[0].loglog(*np.transpose(measured), style, color=colour, label=name)
        apart = [(count, errors[name]) for count, _, errors in rows if errors.get(name)]  # not where the method is the same
        if apart:
            panels[1].loglog(*np.transpose(apart), style, color=colour, label=name)
    panels[0].set_ylabel(f'processor time (s), {WAVEVECTORS} wavevectors')
    panels[1].set_ylabel('largest error / highest frequency')
    panels[1].set_xlim(panels[0].get_xlim())
    for ax in panels:
        ax.set_xlabel('particles in the cell')
        ax.xaxis.set_major_formatter(ScalarFormatter())
        ax.legend()
    figure.savefig(file, dpi=150)


def main():
    """Print the tables; draw the chart."""
    parser = argparse.ArgumentParser(description=__doc__.split('\n')[0])
    parser.add_argument('--chart', metavar='FILE.png')
    options = parser.parse_args()
    rows = []
    for side in SIDES:
        rows.append(large_cell(side))
        count, seconds, errors = rows[-1]
        each = (f'{name} {1e3 * seconds[name] / WAVEVECTORS:8.3f} ms, error {errors[name]:.0e}' for name in seconds)
        print(f'{count:5d} particles, a wavevector:', *each, sep='   ', flush=True)
    for name, (count, job) in meshes().items():
        seconds, _ = least({name: job})
        tracemalloc.start()
        job()
        peak = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        print(f'{name:34s} {count:8d} wavevectors {seconds[name]:6.2f} s   {peak / 2**20:5.0f} MiB', flush=True)
    if options.chart:
        draw(rows, options.chart)


if __name__ == '__main__':
    main()
