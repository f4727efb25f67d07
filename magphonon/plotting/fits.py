"""Measured forces with fitted laws, measured ridges with fitted branches, and the residuals of both."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..bands.bloch import bloch_modes
from ..interactions.pair_laws import repulsion
from .axes import COLOURS, COLUMN_in, label, legend_above, letter_panels, new_figure, prefix_power

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ase import Atoms
    from matplotlib.figure import Figure

    from ..design.dispersion_fits import DispersionFit
    from ..interactions.fits import Fit
    from ..interactions.force_tables import Forces
    from ..waves.ridge_tables import RidgePoints

MOST_POINTS = 200
"""Largest number of points drawn singly; more are averaged, because they would hide each other and the laws."""
LINES = '-', '--', ':', '-.'
MODEL_LINES = {'complete': (COLOURS[0], '-', 'o'), 'conventional': (COLOURS[1], '--', 's')}


def plot_band_fits(points: RidgePoints, fits: Mapping[str, tuple[Atoms, DispersionFit]]) -> Figure:
    """Measured points with the branches of both models, over the residuals in standard uncertainties.

    Parameters
    ----------
    points : RidgePoints
    fits : dict of (ase.Atoms, DispersionFit)
        By model: the cell with the parameters of the fit, and the fit.

    Returns
    -------
    matplotlib.figure.Figure

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon import read_scene
    >>> from magphonon.plotting import plot_band_fits
    >>> from magphonon.scenes import fit_bands
    >>> from magphonon.waves import read_ridges
    >>> found = fit_bands(read_scene('prototype'), read_ridges(files('magphonon.data') / 'prototype_ridges.csv'))
    >>> figure = plot_band_fits(found.points, {model: (found.fitted(model).atoms(), fit) for model, fit in found.fits.items()})
    """
    figure = new_figure(COLUMN_in, 1.25 * COLUMN_in)
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 1.4))
    for k in range(len(points.names)):
        here = points.ridge == k
        upper.errorbar(points.xi[here], points.frequencies_Hz[here], u.hertz(points.sigma_omega[here]), points.sigma_xi[here],
                       fmt='o', color='k', markersize=3, markerfacecolor='white', linewidth=0.7, zorder=3,
                       label='measured' if k == 0 else None)
    xi = np.linspace(0, np.pi, 301)
    for model, (atoms, fit) in fits.items():
        colour, line, marker = MODEL_LINES[model]
        drawn = {(fit.branches[k], *np.round(points.q[here][0] / points.xi[here][0], 6))
                 for k in range(len(points.names)) if (here := points.ridge == k).any()}
        for branch, *direction in sorted(drawn):
            omega = bloch_modes(atoms, xi[:, None] * np.array(direction), model)[0][:, branch]
            upper.plot(xi, u.hertz(omega), line, color=colour)
        upper.plot([], [], line, marker=marker, color=colour, markersize=3, fillstyle='none', label=model)  # with its residuals
        lower.plot(points.xi, fit.residuals, marker, color=colour, markersize=3, fillstyle='none', linestyle='')
    lower.axhspan(-1.96, 1.96, color='0.9', zorder=0)
    upper.fill_between([], [], [], color='0.9', label='95 %, below')
    lower.axhline(0, color='0.6', linewidth=0.8, zorder=0)
    lower.set(xlabel=r'phase per step $\xi = k\cdot R$ (rad)', ylabel=r'residual ($\sigma$)', xlim=(0, np.pi))
    lower.set_xticks(np.pi * np.arange(5) / 4, ['0', 'π/4', 'π/2', '3π/4', 'π'])
    upper.set(ylabel='frequency (Hz)', ylim=(0, None))
    upper.legend(loc='lower right', frameon=False)
    letter_panels([upper, lower])
    return figure


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
