"""Error against cost: which error each method that answers a question reaches at which cost, as a table and a chart.

A candidate is a method at one setting.  Its `run` takes a counter, does all that a user would wait for, and returns
the answer; it adds its cost in operations, which do not depend on the machine, to the counter::

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
from dataclasses import dataclass, field
from importlib.metadata import PackageNotFoundError, version
from itertools import cycle
from pathlib import Path
from statistics import median
from textwrap import fill
from time import perf_counter

import numpy as np
from tqdm import tqdm

from magphonon import __version__
from magphonon.errors import one_of, positive, whole
from magphonon.files import whole_file
from magphonon.plotting.axes import COLOURS, PAGE_in, legend_of_set, letter_panels, new_axes, panels

from .rows import Check, save_picture

COUNTERS = ('force evaluations', 'products', 'eigensolves')
"""What is counted: forces on all particles, matrix-vector products (a linear force is one), solved eigenvalue problems."""
PACKAGES = ('ase', 'phonopy', 'numpy', 'scipy', 'matplotlib', 'numba')
LOOKS = [(colour, marker, line) for marker, line, colour in
         zip('osD^vPX<>*dph', cycle(['-', '--', '-.', ':']), cycle(COLOURS), strict=False)]
"""Colour, marker and line of the methods; in grey the marker alone distinguishes them."""
FLOOR = 1e-17
"""An error of zero is drawn at this value; round-off leaves no other error so small."""


@dataclass(frozen=True)
class Candidate:
    """A method at one setting, with its unit; settings of one method are joined by a line in a chart.

    `run` takes a `collections.Counter` with the names of COUNTERS and returns the answer.  `panel` names the panel
    of the chart, such as the size of the system or the amplitude.
    """

    method: str
    setting: str
    run: Callable
    panel: str = ''


@dataclass(frozen=True)
class Measurement:
    """Error and cost of a candidate: least and median wall time in s, and the number of each of the COUNTERS in one run.

    The error is infinite for a run that diverged.
    """

    panel: str
    method: str
    setting: str
    error: float
    seconds: float
    median: float
    cost: dict


@dataclass(frozen=True)
class Chart:
    """One question, the methods that answer it, and what to conclude.

    Attributes
    ----------
    title : str
    measurements : list of Measurement
    reading : str
        The conclusion in words, computed from the measurements.
    checks : list of Check
        Checks of errors and counts, which are the same on all machines.  Times vary; they belong in the reading.
    error : str
        What the error is.
    """

    title: str
    measurements: list[Measurement]
    reading: str
    checks: list[Check] = field(default_factory=list)
    error: str = 'error'


def measure(candidates, error, repeats=5, patience=1.0):
    """Run every candidate, once for its error and again for its time.

    The first run of each gives the error and the counts, and compiles and fills caches.  It is also the timed run if another
    setting of its method ran before, and one timed run is enough or it takes longer than `patience`.  Other timed runs are
    interleaved, so that a disturbance of the machine affects all methods alike.

    Parameters
    ----------
    candidates : sequence of Candidate
    error : function
        From an answer to its error.
    repeats : int
        Timed runs of each candidate.
    patience : float
        In s.  A candidate that has run for longer is not repeated; each has at least one timed run.

    Returns
    -------
    list of Measurement

    Raises
    ------
    ValueError
        If two candidates have the same name, or one counts something that is not among the COUNTERS.
    """
    repeats, patience = whole('repeats', repeats), positive('patience', patience, 's')
    names = [(c.panel, c.method, c.setting) for c in candidates]
    for name, count in Counter(names).items():
        if count > 1:
            raise ValueError(f'{count} candidates are called {name}; give each a setting of its own')
    errors, costs, times = [], [], []
    for k, candidate in enumerate(tqdm(candidates, desc='errors', leave=False, disable=None)):
        cost, start = Counter(), perf_counter()
        answer = candidate.run(cost)
        seconds = perf_counter() - start
        warm = any(other.method == candidate.method for other in candidates[:k])
        times.append([seconds] if warm and (repeats == 1 or seconds > patience) else [])
        found = float(error(answer))
        errors.append(found if np.isfinite(found) else np.inf)
        for counter in cost:
            one_of('counter', counter, COUNTERS)
        costs.append({counter: int(cost[counter]) for counter in COUNTERS})
    for _ in tqdm(range(repeats), desc='times', leave=False, disable=None):
        for candidate, spent in zip(candidates, times, strict=True):
            if len(spent) < repeats and sum(spent) < patience:
                start = perf_counter()
                candidate.run(Counter())
                spent.append(perf_counter() - start)
    return [Measurement(*name, e, min(t), median(t), c) for name, e, t, c in zip(names, errors, times, costs, strict=True)]


def pareto_front(table):
    """The measurements that no other beats in both error and time, quickest first."""
    front, best = [], np.inf
    for m in sorted(table, key=lambda m: (m.seconds, m.error)):
        if m.error < best:
            front.append(m)
            best = m.error
    return front


def cheapest(table, tolerance):
    """The quickest measurement whose error is within the tolerance, or None."""
    return min((m for m in table if m.error <= tolerance), key=lambda m: m.seconds, default=None)


def panels_of(table):
    """The measurements by panel: {panel: [measurement]}."""
    found = {}
    for m in table:
        found.setdefault(m.panel, []).append(m)
    return found


def machine():
    """Processor, threads and versions, one line each."""
    versions = [f'Python {platform.python_version()}', f'magphonon {__version__}']
    for package in PACKAGES:
        try:
            versions.append(f'{package} {version(package)}')
        except PackageNotFoundError:
            versions.append(f'no {package}')
    try:
        lines = Path('/proc/cpuinfo').read_text().splitlines()
    except OSError:  # not Linux
        lines = []
    models = [line.partition(':')[2].strip() for line in lines if line.startswith('model name')]
    processor = models[0] if models else platform.processor() or platform.machine()
    threads = os.environ.get('OMP_NUM_THREADS', 'not set')
    return [f'{processor}, {os.cpu_count()} cores, OMP_NUM_THREADS {threads}, {platform.system()}', ', '.join(versions)]


def write_table(path, table, notes=()):
    """Write measurements as CSV; at its foot, as comments, the lines of `notes` and of `machine`.

    The column `front` is 1 for those on the Pareto front of their panel.
    """
    front = [m for own in panels_of(table).values() for m in pareto_front(own)]
    with whole_file(path) as file:
        rows = csv.writer(file, lineterminator='\n')
        rows.writerow(['panel', 'method', 'setting', 'error', 'least_s', 'median_s',
                       *(counter.replace(' ', '_') for counter in COUNTERS), 'front'])
        for m in table:
            rows.writerow([m.panel, m.method, m.setting, f'{m.error:.6g}', f'{m.seconds:.6g}', f'{m.median:.6g}',
                           *(m.cost[counter] for counter in COUNTERS), int(any(m is f for f in front))])
        file.writelines(f'# {line}\n' for line in (*notes, *machine()))


def looks_of(table):
    """Colour, marker and line for each method of a table, the same in all panels: {method: (colour, marker, line)}."""
    return dict(zip(dict.fromkeys(m.method for m in table), cycle(LOOKS), strict=False))


def plot_work_precision(table, ax=None, looks=None):
    """Draw error against wall time for the measurements of one panel, with the Pareto front behind them.

    Runs that diverged are omitted.  `looks` come from `looks_of` a larger table.
    """
    def points(own):
        return [m.seconds for m in own], [max(m.error, FLOOR) for m in own]

    ax = new_axes() if ax is None else ax
    ax.plot(*points([m for m in pareto_front(table) if np.isfinite(m.error)]), color='0.85', linewidth=6, marker='o',
            markersize=8, zorder=0, label='Pareto front')
    for method, (colour, marker, line) in (looks_of(table) if looks is None else looks).items():
        own = [m for m in table if m.method == method and np.isfinite(m.error)]
        if own:
            ax.plot(*points(own), color=colour, marker=marker, linestyle=line, fillstyle='none', label=method)
    ax.set(xscale='log', yscale='log', xlabel='wall time (s)', ylabel='error')
    return ax


def work_precision(chart):
    """Figure with axes for each panel and one legend, or with a legend below each panel if no method is in two panels."""
    tables, looks = panels_of(chart.measurements), looks_of(chart.measurements)
    apart = sum(len(looks_of(table)) for table in tables.values()) == len(looks)
    columns = len(tables) if len(tables) < 4 else 2
    figure, axes = panels(-(-len(tables) // columns), columns, width=PAGE_in, height=3.4 if apart else 2.7)
    for ax in axes.flat[len(tables):]:
        ax.remove()
    axes = axes.ravel()[:len(tables)]
    letter_panels(axes, [fill(name, 105 // columns) for name in tables])
    for ax, table in zip(axes, tables.values(), strict=True):
        plot_work_precision(table, ax, looks_of(table) if apart else looks)
        finite = [m for m in (table if apart else chart.measurements) if np.isfinite(m.error)]
        spent, errors = [m.seconds for m in finite], [max(m.error, FLOOR) for m in finite]
        ax.set(ylabel=chart.error, xlim=(0.6 * min(spent), 1.7 * max(spent)), ylim=(0.2 * min(errors), 5 * max(errors)))
        if not apart:
            ax.label_outer()
        if apart:
            ax.legend(loc='upper center', bbox_to_anchor=(0.5, -0.2), ncols=2)
    if not apart:
        legend_of_set(figure, ncols=4)
    return figure


def spoken(number):
    """A number as text with two digits, without an exponent: 360, 0.21, 0.00002."""
    return np.format_float_positional(number, precision=2, fractional=False, trim='-')


def save_chart(chart, out, name):
    """Write `name`.png and `name`.csv into the directory `out`; returns the entry for `Outcome.pictures`."""
    write_table(out / f'{name}.csv', chart.measurements, notes=[chart.title, chart.reading])
    return save_picture(work_precision(chart), out / f'{name}.png', f'{chart.title}; the conclusion is at the end of {name}.csv.')
