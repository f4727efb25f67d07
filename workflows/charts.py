"""A chart of error against cost, with the sentence that reads it; drawn and tabulated."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from .accuracy import Measurement, write_table
from .accuracy_plots import looks_of, plot_work_precision
from .checks import Check, save_picture


@dataclass(frozen=True)
class Chart:
    """One question, the methods that answer it, and what to conclude.

    Attributes
    ----------
    title : str
    measurements : list of Measurement
    reading : str
        Read off the measurements, never written before them.
    checks : list of Check
        Of what no machine changes: errors and counts.  Times vary; they belong in the reading.
    error : str
        What the error is.
    draw : function, optional
        From the chart to a figure, where the default, error against wall time with a panel each, does not say it.
    """

    title: str
    measurements: list[Measurement]
    reading: str
    checks: list[Check] = field(default_factory=list)
    error: str = 'error'
    draw: Callable | None = None


def panels_of(table):
    """The measurements by panel: {panel: [measurement]}."""
    panels = {}
    for m in table:
        panels.setdefault(m.panel, []).append(m)
    return panels


def work_precision(chart):
    """Figure with one pair of axes for each panel, and one legend."""
    from matplotlib.figure import Figure

    panels, looks = panels_of(chart.measurements), looks_of(chart.measurements)
    columns = len(panels) if len(panels) < 4 else 2
    rows = -(-len(panels) // columns)
    figure = Figure((1.2 + 3.9 * columns, 1.4 + 3.6 * rows), layout='constrained')
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    for ax in axes[len(panels):]:
        ax.remove()
    for ax, (panel, table) in zip(axes, panels.items(), strict=False):
        plot_work_precision(table, ax, looks)
        ax.set(title=panel, ylabel=chart.error)
        ax.label_outer()
    entries = {}
    for ax in figure.axes:
        handles, labels = ax.get_legend_handles_labels()
        entries |= dict(zip(labels, handles, strict=True))
    figure.legend(entries.values(), entries, loc='outside lower center', ncols=2 if len(panels) == 1 else 4, frameon=False,
                  fontsize=9)
    return figure


def spoken(number):
    """A number in two digits, as one would say it: 360, 0.21, 0.00002."""
    return np.format_float_positional(number, precision=2, fractional=False, trim='-')


def save_chart(chart, out, name):
    """Write `name`.png and `name`.csv into the directory `out`; returns the entry for `Outcome.pictures`."""
    write_table(out / f'{name}.csv', chart.measurements, notes=[chart.title, chart.reading])
    figure = (chart.draw or work_precision)(chart)
    return save_picture(figure, out / f'{name}.png', f'{chart.title}. {chart.reading}')
