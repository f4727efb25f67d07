"""Pictures of records as they were read, in which a wrong unit, a stray point or a clipped signal is seen at once."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from .axes import in_house_style, label, label_frequencies, legend_above, new_axes, new_figure, prefix_power

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..interactions.force_tables import Forces
    from ..waves.ridge_tables import RidgePoints
    from ..waves.scans import Scan

WAYS = {-1.0: ('v', 'approach'), 0.0: ('o', 'measured'), 1.0: ('^', 'return')}


@in_house_style
def plot_forces(forces: Forces) -> Axes:
    """Draw forces against distances, with separate marks for approach and return.

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.interactions import read_forces
    >>> from magphonon.plotting import plot_forces
    >>> ax = plot_forces(read_forces(files('magphonon.data') / 'synthetic_force.csv'))
    """
    ax, sigma = new_axes(), np.zeros(len(forces.r)) if forces.sigma is None else forces.sigma
    for way, (marker, name) in WAYS.items():
        if (own := forces.direction == way).any():
            ax.errorbar(forces.r[own] / u.m, forces.f[own] / u.N, sigma[own] / u.N, fmt=marker, markersize=3, linewidth=0.7,
                        label=name)
    ax.set_ylabel('force (N)')
    label(ax.xaxis, 'distance of the centres', 'm', prefix_power(float(np.median(forces.r)) / u.m))
    legend_above(ax)
    return ax


@in_house_style
def plot_ridges(points: RidgePoints) -> Axes:
    """Draw the frequencies of ridge points against their phases per step.

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.plotting import plot_ridges
    >>> from magphonon.waves import read_ridges
    >>> ax = plot_ridges(read_ridges(files('magphonon.data') / 'prototype_ridges.csv'))
    """
    ax = new_axes()
    for k, name in enumerate(points.names):
        own = points[points.ridge == k]
        ax.errorbar(own.xi, own.frequencies_Hz, u.hertz(own.sigma_omega), own.sigma_xi, fmt='.', linewidth=0.7, label=name)
    ax.set_xlabel(r'phase per step $\xi$ (rad)')
    label_frequencies(ax.yaxis)
    legend_above(ax)
    return ax


@in_house_style
def plot_scan(scan: Scan) -> Figure:
    """Draw the motion of each point against time, one panel for each component, scaled to its largest value.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.plotting import plot_scan
    >>> from magphonon.waves import Scan
    >>> figure = plot_scan(Scan(np.arange(9.0), ('1', '2'), None, {'y': np.random.default_rng(0).normal(size=(9, 2))}))
    """
    figure = new_figure(height=0.6 + 2.0 * len(scan.motions))
    axes = figure.subplots(len(scan.motions), 1, squeeze=False)
    for ax, (part, moved) in zip(np.ravel(axes), scan.motions.items(), strict=True):
        most = abs(moved).max() or 1.0
        ax.pcolormesh(scan.times / u.s, np.arange(1, 1 + moved.shape[1]), moved.T, cmap='RdBu_r', vmin=-most, vmax=most,
                      shading='nearest', rasterized=True)
        ax.set(ylabel='point', title=f'{part} up to {most / u.m:.3g} m'.strip())
        label(ax.xaxis, 'time', 's', prefix_power(float(np.ptp(scan.times)) / u.s))
    return figure
