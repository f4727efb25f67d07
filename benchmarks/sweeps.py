"""What a sweep costs beside its points: `python benchmarks/sweeps.py [PICTURE]`, a table and a chart.

Points that only wait, 10 000 of a millisecond and 40 of a quarter of a second, on every executor with two workers, each with a
journal.  The overhead is the time of the workers that no point used, for each point; starting the workers is timed apart.
MPI joins in under `mpiexec -n 3 python benchmarks/sweeps.py`, whose first rank leads.
"""

import sys
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from pathlib import Path
from tempfile import TemporaryDirectory
from time import perf_counter, sleep

import numpy as np

from magphonon.sweeps import dask_workers, mpi_ranks, processes, sweep

WORKERS = 2
SIZES = (10_000, 1e-3), (40, 0.25)  # points, seconds of each


def waiting(point, seconds):
    """How long the point really took."""
    start = perf_counter()
    sleep(seconds)
    return perf_counter() - start


def measured(executor, workers):
    """Start of the workers in s, then of each size overhead per point in ms and speed against one worker without any."""
    start = perf_counter()
    sweep(waiting, {'point': np.arange(2.0 * workers), 'seconds': [0.01]}, executor=executor)
    row = [perf_counter() - start]
    for points, seconds in SIZES:
        with TemporaryDirectory() as folder:
            start = perf_counter()
            found = sweep(waiting, {'point': np.arange(float(points)), 'seconds': [seconds]}, executor=executor,
                          journal_file=Path(folder, 'journal'))
            wall = perf_counter() - start
        busy = float(found.value.sum())
        row += [1e3 * (wall * workers - busy) / points, busy / wall]
    return row


def executors():
    """Name, workers and context of each."""
    yield 'this process', 1, nullcontext()
    yield 'threads', WORKERS, ThreadPoolExecutor(WORKERS)
    yield 'processes', WORKERS, processes(WORKERS)()
    yield 'Dask', WORKERS, dask_workers(workers=WORKERS)


def draw(rows, path):
    """Overhead of each executor."""
    from matplotlib.figure import Figure

    ax = Figure((5.2, 3.4), layout='constrained').add_subplot()
    for k, ((points, seconds), shift) in enumerate(zip(SIZES, (-0.2, 0.2), strict=True)):
        bars = ax.bar(np.arange(len(rows)) + shift, [row[1 + 2 * k] for row in rows.values()], 0.38,
                      label=f'{points} points of {1e3 * seconds:g} ms')
        ax.bar_label(bars, [f'{row[1 + 2 * k]:.2g}' for row in rows.values()], fontsize=8)
    ax.set(yscale='log', ylabel='overhead per point (ms of a worker)', xticks=np.arange(len(rows)), xticklabels=list(rows))
    ax.legend(frameon=False)
    ax.figure.savefig(path, dpi=150)


def main(picture=None):
    """Print the table; under `mpiexec` that of MPI alone."""
    from mpi4py import MPI

    rows = {}
    if MPI.COMM_WORLD.size > 1:
        with mpi_ranks() as executor:
            if executor is None:
                return
            rows['MPI'] = measured(executor, MPI.COMM_WORLD.size - 1)
    else:
        for name, workers, context in executors():
            with context as executor:
                rows[name] = measured(executor, workers)
    print(f'{"":14}{"start":>8}' + ''.join(f'{f"{n} of {1e3 * s:g} ms":>20}{"speed":>8}' for n, s in SIZES))
    for name, row in rows.items():
        print(f'{name:14}{row[0]:6.2f} s' + ''.join(f'{a:17.3f} ms{b:8.2f}' for a, b in zip(row[1::2], row[2::2], strict=True)))
    if picture is not None:
        draw(rows, picture)


if __name__ == '__main__':
    main(*sys.argv[1:])
