"""A chart of error against cost, with the sentence that reads it; drawn and tabulated."""

from collections.abc import Callable
from dataclasses import dataclass, field
from textwrap import fill

import numpy as np

from magphonon.plotting.axes import PAGE_in, legend_of_set, letter_panels, panels

from .accuracy import Measurement, write_table
from .accuracy_plots import FLOOR, looks_of, plot_work_precision
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
    """Figure with one pair of axes for each panel, and one legend, or one below each panel if no method stands in two."""
    tables, looks = panels_of(chart.measurements), looks_of(chart.measurements)
    apart = sum(len(looks_of(table)) for table in tables.values()) == len(looks)
    columns = len(tables) if len(tables) < 4 else 2
    figure, axes = panels(-(-len(tables) // columns), columns, width=PAGE_in, height=3.4 if apart else 2.7)
    for ax in axes.flat[len(tables):]:
        ax.remove()
    axes = axes.ravel()[:len(tables)]
    letter_panels(axes, [fill(name, 105 // columns) for name in tables])
    spent = [m.seconds for m in chart.measurements if np.isfinite(m.error)]
    errors = [max(m.error, FLOOR) for m in chart.measurements if np.isfinite(m.error)]
    for ax, table in zip(axes, tables.values(), strict=True):
        plot_work_precision(table, ax, looks_of(table) if apart else looks)
        ax.set(ylabel=chart.error, xlim=(0.6 * min(spent), 1.7 * max(spent)), ylim=(0.2 * min(errors), 5 * max(errors)))
        ax.label_outer()
        if apart:
            ax.legend(loc='upper center', bbox_to_anchor=(0.5, -0.2), ncols=2)
    if not apart:
        legend_of_set(figure, ncols=4)
    return figure


def spoken(number):
    """A number in two digits, as one would say it: 360, 0.21, 0.00002."""
    return np.format_float_positional(number, precision=2, fractional=False, trim='-')


def save_chart(chart, out, name):
    """Write `name`.png and `name`.csv into the directory `out`; returns the entry for `Outcome.pictures`."""
    write_table(out / f'{name}.csv', chart.measurements, notes=[chart.title, chart.reading])
    figure = (chart.draw or work_precision)(chart)
    return save_picture(figure, out / f'{name}.png', f'{chart.title}. {chart.reading}')
