"""Error against cost, a panel for each of four questions: `python benchmarks/charts.py [-o docs]` writes charts.png, its panel
of a burst as chart.png, charts.csv, and what to conclude as reference/charts_found.md.

The panels of bands, bursts and responses are those of `python -m workflows speed_accuracy`; that of large motion is of
`benchmarks/speed.py`, with LAMMPS and JAX beside it where they are installed.  The cost is CPU time, which other load on the
machine stretches less than the time on the wall; on two machines the order of the methods is the same, the times are not.
"""

import argparse
import os
from dataclasses import replace
from pathlib import Path
from time import process_time

os.environ['OMP_NUM_THREADS'] = '1'  # before numpy is loaded: all methods on one core

import numpy as np
from speed import time_to_error

from magphonon.plotting.axes import PAGE_in, letter_panels, panels, print_style
from workflows import accuracy, accuracy_bands, accuracy_frf, accuracy_transient
from workflows.accuracy import Measurement, cheapest, looks_of, machine, panels_of, spoken, write_table
from workflows.rows import save_picture

accuracy.perf_counter = process_time
TITLES = {'one magnet, 300 wavevectors': 'Bands of one magnet, over the highest frequency',
          'N = 1024': 'A tone burst in 1024 magnets, after 200 ms',
          'N = 1024, 400 frequencies': 'The response of 1024 magnets at 400 frequencies'}
"""What the panels of the workflows are called here; others of theirs are left out."""
BURST, STRAIN = TITLES['N = 1024'], 1e-2
MOTION = f'100 ms of 10 000 magnets with strains up to {STRAIN:g}, the steps alone'


def main():
    """Measure all, draw, write."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument('-o', '--out', type=Path, default=Path('docs'), help='folder of charts.png and charts.csv')
    out = parser.parse_args().out
    table = [m for question in (accuracy_bands, accuracy_transient, accuracy_frf) for m in question.chart(True).measurements]
    table = [replace(m, panel=TITLES[m.panel]) for m in table if m.panel in TITLES] + motion()
    found = [f'{panel}: {reading(own)}' for panel, own in panels_of(table).items()]
    print(*found, sep='\n')
    write_table(out / 'charts.csv', table, ['CPU time in s; drawn by benchmarks/charts.py', *found])
    words = [f'- **{panel}**: {reading(own)}.' for panel, own in panels_of(table).items()]
    (out / 'reference' / 'charts_found.md').write_text('\n'.join([*words, '', f'Measured with {"; ".join(machine())}.', '']),
                                                       encoding='utf-8')
    with print_style():
        save_picture(drawn(table), out / 'charts.png', 'Error against CPU time of each method that answers a question.')
        save_picture(drawn([m for m in table if m.panel == BURST], ''), out / 'chart.png', 'The panel of a burst.')


def motion():
    """Large motion, which only time steps can follow: each method with shorter and shorter steps."""
    none = dict.fromkeys(accuracy.COUNTERS, 0)
    return [Measurement(MOTION, method, '', error, seconds, seconds, none)
            for method, runs in time_to_error(STRAIN).items() for seconds, error in runs]


def drawn(table, letters='abcd'):
    """A panel as wide as the page for each question; a method is named beside the end of its line."""
    tables = panels_of(table)
    figure, axes = panels(len(tables), 1, width=PAGE_in, height=3.0)
    if letters:
        letter_panels(axes, list(tables))
    for ax, own in zip(axes.ravel(), tables.values(), strict=True):
        ends = []
        for method, (colour, marker, line) in looks_of(own).items():
            runs = sorted((m.error, m.seconds) for m in own if m.method == method and np.isfinite(m.error))
            ax.loglog(*np.array(runs).T[::-1], color=colour, marker=marker, linestyle=line, fillstyle='none')
            ends.append((*runs[0], method, colour))
        ax.set(xlabel='CPU time (s)', ylabel='error')
        name_lines(ax, sorted(ends))
    return figure


def name_lines(ax, ends, apart=0.085):
    """Write names to the right of the axes, in the order of the errors at the ends of their lines, with a thin line to each."""
    low, high = np.log(ax.get_ylim())
    wanted = np.array([(np.log(error) - low) / (high - low) for error, *_ in ends])
    steps = apart * np.arange(len(ends))
    places = np.maximum.accumulate(wanted - steps) + steps   # none nearer than `apart` to the one below
    places -= max(0, places[-1] - 1)
    places = np.minimum(places, places[-1] - steps[::-1])
    for (error, seconds, method, colour), y in zip(ends, places, strict=True):
        ax.annotate(method, (seconds, error), (1.02, y), textcoords='axes fraction', color=colour, va='center',
                    arrowprops={'arrowstyle': '-', 'color': '0.8', 'linewidth': 0.6, 'zorder': 0})


def reading(table):
    """The quickest methods to errors of 1e-2, 1e-5 and 1e-8, and how much longer the next one of another kind takes."""
    said = {}
    for tolerance in (1e-2, 1e-5, 1e-8):
        if best := cheapest(table, tolerance):
            kind = best.method.split(',')[0]
            other = cheapest([m for m in table if m.method.split(',')[0] != kind], tolerance)
            beside = f' ({other.method} takes {spoken(other.seconds / best.seconds)} times as long)' if other else ' alone'
            said.setdefault(f'{best.method}{beside}', []).append(f'{tolerance:g}')
    return '; '.join(f'to errors of {" and ".join(errors)}: {words}' for words, errors in said.items()) or 'none reaches 0.01'


if __name__ == '__main__':
    main()
