"""Error against cost: what each method that can answer a question pays for its accuracy.

A candidate is a method at one setting.  Its `run` takes a counter, does all that a user would wait for, and returns
the answer; its cost in operations, which no machine changes, it adds to the counter::

    def verlet(dt, cost):
        cost['force evaluations'] += round(END / dt)
        ...
        return displacements

    table = measure([Candidate('Verlet', f'dt = {dt:g} ms', partial(verlet, dt)) for dt in steps],
                    error=lambda u: abs(u - exact).max() / abs(exact).max())
    write_table('transient.csv', table)
"""

import csv
import os
import platform
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from statistics import median
from time import perf_counter

import numpy as np
from tqdm import tqdm

from magphonon.errors import one_of, positive, whole
from magphonon.files import whole_file

COUNTERS = ('force evaluations', 'products', 'eigensolves')
"""What is counted: forces on all particles, matrix-vector products (a linear force is one), solved eigenvalue problems."""
PACKAGES = ('magphonon', 'ase', 'phonopy', 'numpy', 'scipy', 'matplotlib', 'numba')


@dataclass(frozen=True)
class Candidate:
    """A method at one setting.

    Attributes
    ----------
    method : str
        Settings of one method are joined by a line in a chart.
    setting : str
        With its unit.
    run : function
        Of a `collections.Counter` with the names of COUNTERS; returns the answer.
    panel : str
        What is asked, where one chart asks several times: the size of the system, the amplitude.
    """

    method: str
    setting: str
    run: Callable
    panel: str = ''


@dataclass(frozen=True)
class Measurement:
    """Error and cost of a candidate.

    Attributes
    ----------
    panel, method, setting : str
    error : float
        Against the reference, in the measure of the question; infinite for a run that went astray.
    seconds, median : float
        Least and median wall time.
    cost : dict
        The number of each of the COUNTERS in one run.
    """

    panel: str
    method: str
    setting: str
    error: float
    seconds: float
    median: float
    cost: dict


def measure(candidates, error, repeats=5, patience=1.0):
    """Run every candidate for its error and, apart from that, for its time.

    The first run of each gives the error and the counts, and warms up what is cached or compiled.  The timed runs
    are interleaved, so that a disturbance of the machine strikes all methods alike.

    Parameters
    ----------
    candidates : sequence of Candidate
    error : function
        From an answer to its error.
    repeats : int
        Timed runs of each.
    patience : float
        In s.  A candidate that has run for longer is not repeated any more; each has one timed run at least.

    Returns
    -------
    list of Measurement

    Raises
    ------
    ValueError
        If two candidates bear the same name, or one counts what is not among the COUNTERS.
    """
    repeats, patience = whole('repeats', repeats), positive('patience', patience, 's')
    names = [(c.panel, c.method, c.setting) for c in candidates]
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f'{count} candidates are called {name}; give each a setting of its own')
    errors, costs = [], []
    for candidate in tqdm(candidates, desc='errors', leave=False, disable=None):
        cost = Counter()
        found = float(error(candidate.run(cost)))
        errors.append(found if np.isfinite(found) else np.inf)
        for counter in cost:
            one_of('counter', counter, COUNTERS)
        costs.append({counter: int(cost[counter]) for counter in COUNTERS})
    times = [[] for _ in candidates]
    for _ in tqdm(range(repeats), desc='times', leave=False, disable=None):
        for candidate, spent in zip(candidates, times, strict=True):
            if sum(spent) < patience:
                start = perf_counter()
                candidate.run(Counter())
                spent.append(perf_counter() - start)
    return [Measurement(*name, e, min(t), median(t), c) for name, e, t, c in zip(names, errors, times, costs, strict=True)]


def pareto_front(table):
    """The measurements that no other one beats in both error and time, quickest first."""
    front, best = [], np.inf
    for m in sorted(table, key=lambda m: (m.seconds, m.error)):
        if m.error < best:
            front.append(m)
            best = m.error
    return front


def cheapest(table, tolerance):
    """The quickest measurement whose error is within the tolerance, or None."""
    return min((m for m in table if m.error <= tolerance), key=lambda m: m.seconds, default=None)


def machine():
    """Processor, threads and versions, one line each."""
    versions = [f'Python {platform.python_version()}']
    for package in PACKAGES:
        try:
            versions.append(f'{package} {version(package)}')
        except PackageNotFoundError:
            versions.append(f'no {package}')
    threads = os.environ.get('OMP_NUM_THREADS', 'not set')
    return [f'{_processor()}, {os.cpu_count()} cores, OMP_NUM_THREADS {threads}, {platform.system()}', ', '.join(versions)]


def _processor():
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:  # not Linux
        lines = []
    models = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    return models[0] if models else platform.processor() or platform.machine()


def write_table(path, table, notes=()):
    """Write measurements as CSV, whole or not at all; at its foot, as comments, the lines of `notes` and of `machine`.

    The column `front` is 1 for those on the Pareto front of their panel.
    """
    panels = dict.fromkeys(m.panel for m in table)
    front = [m for panel in panels for m in pareto_front([m for m in table if m.panel == panel])]
    with whole_file(path) as file:
        rows = csv.writer(file, lineterminator='\n')
        rows.writerow(['panel', 'method', 'setting', 'error', 'least_s', 'median_s',
                       *(counter.replace(' ', '_') for counter in COUNTERS), 'front'])
        for m in table:
            rows.writerow([m.panel, m.method, m.setting, f'{m.error:.6g}', f'{m.seconds:.6g}', f'{m.median:.6g}',
                           *(m.cost[counter] for counter in COUNTERS), int(any(m is f for f in front))])
        file.writelines(f'# {line}\n' for line in (*notes, *machine()))
