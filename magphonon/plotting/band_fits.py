"""Measured ridges with the branches fitted to them, and the residuals of both models."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..bands.bloch import bloch_modes
from .axes import COLOURS, letter_panels, new_figure

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ase import Atoms
    from matplotlib.figure import Figure

    from .results import FittedBranches, MeasuredBranches

LINES = {'complete': (COLOURS[0], '-', 'o'), 'conventional': (COLOURS[1], '--', 's')}


def plot_band_fits(points: MeasuredBranches, fits: Mapping[str, tuple[Atoms, FittedBranches]]) -> Figure:
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
    from .style import COLUMN_in

    figure = new_figure(COLUMN_in, 1.25 * COLUMN_in)
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 1.4))
    for k in range(len(points.names)):
        here = points.ridge == k
        upper.errorbar(points.xi[here], points.frequencies_Hz[here], units.hertz(points.sigma_omega[here]), points.sigma_xi[here],
                       fmt='o', color='k', markersize=3, markerfacecolor='white', linewidth=0.7, zorder=3,
                       label='measured' if k == 0 else None)
    xi = np.linspace(0, np.pi, 301)
    for model, (atoms, fit) in fits.items():
        colour, line, marker = LINES[model]
        drawn = {(fit.branches[k], *np.round(points.q[here][0] / points.xi[here][0], 6))
                 for k in range(len(points.names)) if (here := points.ridge == k).any()}
        for branch, *direction in sorted(drawn):
            omega = bloch_modes(atoms, xi[:, None] * np.array(direction), model)[0][:, branch]
            upper.plot(xi, units.hertz(omega), line, color=colour)
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
