"""Measured forces with fitted laws, and what the laws leave, drawn in SI on matplotlib axes."""

import numpy as np

from .. import units as u
from ..interactions.pair_laws import repulsion
from .axes import COLOURS, legend_above

MOST_POINTS = 200
"""More points than this are averaged for the picture: they would hide each other and the laws."""
LINES = '-', '--', ':', '-.'


def plot_fits(forces, fits):
    """Forces and laws on logarithmic axes over the residuals of each law.

    Parameters
    ----------
    forces : Forces
    fits : sequence of Fit

    Returns
    -------
    matplotlib.figure.Figure
    """
    from matplotlib.figure import Figure
    from matplotlib.ticker import MaxNLocator, NullFormatter

    figure = Figure((5.6, 6.4), dpi=200, layout='constrained')
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    points, _ = forces.binned(MOST_POINTS)
    r, error = points.r / u.m, None if points.sigma is None else points.sigma / u.N
    upper.errorbar(r, points.f / u.N, error, fmt='o', color='k', markersize=4, fillstyle='none', label='measured', zorder=3)
    line = np.geomspace(*forces.r[[0, -1]], 300)
    for fit, style, colour, shift in zip(fits, LINES, COLOURS, np.linspace(-1, 1, len(fits)), strict=False):
        inside = line[line - fit.offset > 0]
        upper.plot(inside / u.m, repulsion(fit.law, inside - fit.offset) / u.N, style, color=colour, label=fit.name)
        beside = r * (1 + 0.003 * shift)  # the residuals of a point side by side
        left = (points.f - repulsion(fit.law, points.r - fit.offset)) / u.N
        lower.errorbar(beside, left, error, fmt='os^D'[fits.index(fit)], linestyle=style, color=colour,
                       markersize=4, linewidth=0.8, elinewidth=0.6)
    for ax in (upper, lower):
        ax.axvline((fits[0].spacing + fits[0].offset) / u.m, color='0.8', linewidth=0.8, zorder=0)  # the working spacing
    lower.axhline(0, color='0.6', linewidth=0.8, zorder=0)
    upper.set(xscale='log', yscale='log', ylabel='force (N)')
    lower.set(xlabel='distance of the centres (m)', ylabel='measured - fitted (N)')
    ticks = [tick for tick in MaxNLocator(7).tick_values(*r[[0, -1]]) if r[0] <= tick <= r[-1]]
    lower.set_xticks(ticks, [f'{tick:g}' for tick in ticks])
    lower.xaxis.set_minor_formatter(NullFormatter())
    legend_above(upper, ncols=1, fontsize=8)
    return figure
