"""Work-precision charts: error against wall time, a line for each method, the Pareto front behind them."""

from itertools import cycle

import numpy as np

from magphonon.plotting.axes import COLOURS, new_axes

from .accuracy import pareto_front

LOOKS = [(colour, marker, line) for marker, line, colour in
         zip('osD^vPX<>*dph', cycle(['-', '--', '-.', ':']), cycle(COLOURS), strict=False)]
"""Colour, marker and line of the methods: the marker alone tells them apart in grey."""
FLOOR = 1e-17
"""What an error of zero is drawn as; round-off leaves no other one so small."""


def looks_of(table):
    """The look of each method of a table, so that all panels of a chart agree: {method: (colour, marker, line)}."""
    return dict(zip(dict.fromkeys(m.method for m in table), cycle(LOOKS), strict=False))


def plot_work_precision(table, ax=None, looks=None):
    """Error against wall time; runs that went astray are left out.

    Parameters
    ----------
    table : sequence of Measurement
        Of one panel.
    ax : matplotlib.axes.Axes, optional
    looks : dict, optional
        From `looks_of` a larger table.

    Returns
    -------
    matplotlib.axes.Axes
    """
    ax = new_axes() if ax is None else ax
    looks = looks_of(table) if looks is None else looks
    front = [m for m in pareto_front(table) if np.isfinite(m.error)]
    ax.plot(*_points(front), color='0.85', linewidth=6, marker='o', markersize=8, zorder=0, label='Pareto front')
    for method, (colour, marker, line) in looks.items():
        own = [m for m in table if m.method == method and np.isfinite(m.error)]
        if own:
            ax.plot(*_points(own), color=colour, marker=marker, linestyle=line, fillstyle='none', label=method)
    ax.set(xscale='log', yscale='log', xlabel='wall time (s)', ylabel='error')
    return ax


def _points(table):
    return [m.seconds for m in table], [max(m.error, FLOOR) for m in table]
