"""Measured forces with fitted laws, and the residual of each law, drawn on matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..interactions.pair_laws import repulsion
from .axes import COLOURS, legend_above, new_figure
from .scales import label, prefix_power

if TYPE_CHECKING:
    from collections.abc import Sequence

    from matplotlib.figure import Figure

    from ..interactions.fits import Fit
    from ..interactions.force_tables import Forces

MOST_POINTS = 200
"""Largest number of points drawn singly; more are averaged, because they would hide each other and the laws."""
LINES = '-', '--', ':', '-.'


def plot_fits(forces: Forces, fits: Sequence[Fit]) -> Figure:
    """Forces and laws on logarithmic axes over the residuals of each law.

    Forces fall by decades, so residuals are drawn in standard uncertainties of their points, between grey lines at one of
    them, or in per cent of the law where no uncertainties are given.

    Parameters
    ----------
    forces : Forces
    fits : sequence of Fit

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.interactions import fit_spline, read_forces
    >>> from magphonon.plotting import plot_fits
    >>> forces = read_forces(files('magphonon.data') / 'synthetic_force.csv')
    >>> figure = plot_fits(forces, [fit_spline(forces, 10.0)])
    """
    from matplotlib.ticker import MaxNLocator, NullLocator

    figure = new_figure(height=4.4)
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    points, _ = forces.binned(MOST_POINTS)
    r, error = points.r / u.m, None if points.sigma is None else points.sigma / u.N
    upper.errorbar(r, points.f / u.N, error, fmt='o', color='k', fillstyle='none', zorder=3,
                   label='measured' if len(r) == len(forces.r) else 'measured, averaged')
    ends = forces.r[0], forces.r[-1]
    line = np.clip(np.geomspace(*ends, 300), *ends)  # geomspace may end a last digit beyond
    for fit, style, colour, shift in zip(fits, LINES, COLOURS, np.linspace(-1, 1, len(fits)), strict=False):
        inside = line[line - fit.offset > 0]
        marker = 'os^D'[fits.index(fit)]
        upper.plot(inside / u.m, repulsion(fit.law, inside - fit.offset) / u.N, style, color=colour)
        upper.plot([], [], style, marker=marker, color=colour, label=fit.name)  # as above and with its residuals
        beside = r * (1 + 0.003 * shift)  # the residuals of a point side by side
        law = repulsion(fit.law, points.r - fit.offset)
        lower.plot(beside, (points.f - law) / (law / 100 if points.sigma is None else points.sigma),
                   marker, linestyle=style, color=colour, linewidth=0.8)
    for ax, name in ((upper, 'working spacing' if points.sigma is None else 'working spacing; below, one sigma'), (lower, None)):
        ax.axvline((fits[0].spacing + fits[0].offset) / u.m, color='0.8', linewidth=0.8, zorder=0, label=name)
    for height in (0,) if points.sigma is None else (-1, 0, 1):
        lower.axhline(height, color='0.6' if height == 0 else '0.8', linewidth=0.8, zorder=0)
    upper.set(xscale='log', yscale='log', ylabel='force (N)')
    lower.set(ylabel=f'measured - fitted ({"%" if points.sigma is None else "sigma"})')
    low, high = line[[0, -1]] / u.m * (1 - 1e-9, 1 + 1e-9)  # ends of the data are ticks
    ticks = [tick for tick in MaxNLocator(8, steps=(1, 2, 5, 10)).tick_values(low, high) if low <= tick <= high]
    lower.set_xticks(ticks)
    label(lower.xaxis, 'distance of the centres', 'm', prefix_power(np.sqrt(low * high)))
    lower.xaxis.set_minor_locator(NullLocator())
    legend_above(upper, ncols=1)
    return figure
