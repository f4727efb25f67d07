"""Measured forces with fitted laws, measured ridges with fitted branches, and the residuals of both."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms

from .. import units as u
from ..bands.bloch import bloch_modes
from ..interactions.fits import NORMAL, Fit
from ..interactions.pair_laws import repulsion
from .axes import COLOURS, COLUMN_in, in_house_style, label, legend_above, letter_panels, new_figure, prefix_power

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..design.dispersion_fits import DispersionFit
    from ..interactions.force_tables import Forces
    from ..stiffness.matrices import Model
    from ..waves.ridge_tables import RidgePoints

MODEL_LINES = {'complete': (COLOURS[0], '-', 'o'), 'conventional': (COLOURS[1], '--', 's')}


@in_house_style
def plot_band_fits(points: RidgePoints, fits: Mapping[Model, tuple[Atoms, DispersionFit]]) -> Figure:
    """Draw measured points with the branches of both models, and below them the residuals in standard uncertainties.

    Parameters
    ----------
    points : RidgePoints
    fits : dict of (ase.Atoms, DispersionFit)
        For each model, the cell with the fitted parameters, and the fit.

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
    upper.errorbar(points.xi, points.frequencies_Hz, u.hertz(points.sigma_omega), next(iter(fits.values()))[1].sigma_xi, fmt='o',
                   color='k', markersize=3, markerfacecolor='white', linewidth=0.7, zorder=3,
                   label=r'measured, $\sigma$ with oblique waves' if points.from_points.any() else 'measured')
    xi = np.linspace(0, np.pi, 301)
    for model, (atoms, fit) in fits.items():
        colour, line, marker = MODEL_LINES[model]
        drawn = {(fit.branches[k], *np.round(points.q[here][0] / points.xi[here][0], 6))
                 for k in range(len(points.names)) if (here := points.ridge == k).any()}
        for branch, *direction in sorted(drawn):
            omega = bloch_modes(atoms, xi[:, None] * np.array(direction), model)[0][:, branch]
            upper.plot(xi, u.hertz(omega), line, color=colour)
        upper.plot([], [], line, marker=marker, color=colour, markersize=3, fillstyle='none', label=model)  # with its residuals
        lower.plot(points.xi, fit.residuals[: len(points)], marker, color=colour, markersize=3, fillstyle='none', linestyle='')
    lower.axhspan(-1.96, 1.96, color='0.9', zorder=0)
    shifts = ', '.join(f'{shift:g}' for shift in np.unique((points.shift / points.bins).round(3)))
    upper.fill_between([], [], [], color='0.9', label='95 %')
    lower.set_title(rf'common shifts removed ($\sigma$ = {shifts} bins)', loc='right', fontsize='medium')
    lower.axhline(0, color='0.6', linewidth=0.8, zorder=0)
    lower.set(xlabel=r'phase per step $\xi = k\cdot R$ (rad)', ylabel=r'residual ($\sigma$)', xlim=(0, np.pi))
    lower.set_xticks(np.pi * np.arange(5) / 4, ['0', 'π/4', 'π/2', '3π/4', 'π'])
    upper.set(ylabel='frequency (Hz)', ylim=(0, None))
    legend_above(upper, ncols=2, bbox_to_anchor=(0.5, 1.06))
    letter_panels([upper, lower])
    return figure


@in_house_style
def plot_fit(forces: Forces, fit: Fit) -> Figure:
    """Draw measured forces and the fitted law on logarithmic axes, and below them the residuals in standard deviations.

    The points are corrected for the zeros of force and distance, hysteresis and backlash that the fit found. Forces that are then
    not positive appear in the lower panel only. The bar is the 95 % interval of the force at the spacing.

    Parameters
    ----------
    forces : Forces
    fit : Fit
        The fit of these forces, from `magphonon.interactions.fit_forces`.

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.interactions import fit_forces, read_forces
    >>> from magphonon.plotting import plot_fit
    >>> forces = read_forces(files('magphonon.data') / 'synthetic_force.csv')
    >>> figure = plot_fit(forces, fit_forces(forces, 10.0))
    """
    from matplotlib.ticker import MaxNLocator, NullLocator

    figure = new_figure(height=4.2)
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 1.6))
    shown = forces.thinned(len(fit.residuals))
    zero, away, hysteresis, backlash = fit.zeros
    r = shown.r + away + shown.direction * backlash / 2
    f = shown.f - zero - shown.direction * hysteresis
    positive = f > 0
    upper.errorbar(r[positive] / u.m, f[positive] / u.N, fit.noise[positive] / u.N, fmt='o', color='k', markersize=3,
                   linewidth=0.7, markerfacecolor='white', label='measured, corrected for zero errors')
    line = np.geomspace(fit.law.r[0], fit.law.r[-1], 300)[1:-1]
    upper.plot(line / u.m, repulsion(fit.law, line) / u.N, color=COLOURS[0], label='smooth curve')
    ends = fit.intervals[0] / u.N
    upper.plot([fit.spacing / u.m] * 2, ends, '_-', color=COLOURS[1], linewidth=2.5, markersize=9, zorder=1.5,
               label='at the spacing, 95 %')
    lower.plot(r / u.m, fit.residuals / fit.noise, 'o', color='k', markersize=3, markerfacecolor='white')
    lower.axhspan(-NORMAL, NORMAL, color='0.9', zorder=0)
    lower.axhline(0, color='0.6', linewidth=0.8, zorder=0)
    upper.set(xscale='log', yscale='log', ylabel='force (N)', ylim=(fit.law.f.min() / u.N / 2, 2 * fit.law.f.max() / u.N))
    most = 1.15 * max(NORMAL, abs(fit.residuals / fit.noise).max())
    lower.set(ylabel=r'residual ($\sigma$)', ylim=(-most, most))
    low, high = np.array([min(r.min(), line[0]), max(r.max(), line[-1])]) / u.m * (0.99, 1.01)
    upper.set_xlim(low, high)
    lower.set_xticks([tick for tick in MaxNLocator(8, steps=(1, 2, 5, 10)).tick_values(low, high) if low <= tick <= high])
    label(lower.xaxis, 'distance of the centres', 'm', prefix_power(np.sqrt(low * high)))
    lower.xaxis.set_minor_locator(NullLocator())
    legend_above(upper, ncols=1)
    letter_panels([upper, lower])
    return figure
