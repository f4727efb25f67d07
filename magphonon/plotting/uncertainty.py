"""Uncertainty drawn in SI: ribbons around bands and responses, and the contribution of each parameter."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units
from .axes import COLOURS, legend_above, new_axes
from .bands import plot_bands
from .scales import label_frequencies

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from ..bands.bands import Bands
    from .results import Spread

PRINTED = {'youngs_modulus': "Young's modulus", 'a': 'exponent $a$', 'b': 'strength $b$'}
"""Names of parameters that say more than their keys."""
HALF_WIDTH = 2
"""Half width of a ribbon in standard deviations; it contains 95 of 100 lattices."""
RIBBON = rf'$\pm{HALF_WIDTH}\sigma$'
HATCHES = ('', '////', '....', 'xxxx', '----')
"""Hatches by which bars can be distinguished in grey."""


def plot_band_ribbons(bands: Bands, spread: Spread, ax: Axes | None = None, label: str | None = None, **line: Any) -> Axes:
    """Bands with a ribbon of two standard deviations around each branch; `line` as in `plot_bands`."""
    ax = plot_bands(bands, ax, label=label, **line)
    x = bands.path.get_linear_kpoint_axis()[0]
    colour = ax.lines[-1].get_color()
    for k, (f, std) in enumerate(zip(bands.frequencies_Hz.T, units.hertz(spread.std.T), strict=True)):
        ax.fill_between(x, f - HALF_WIDTH * std, f + HALF_WIDTH * std, color=colour, alpha=0.3, linewidth=0,
                        label=None if k else label and RIBBON)
    top = np.nanmax(bands.frequencies_Hz + HALF_WIDTH * units.hertz(spread.std))
    ax.set_ylim(top=max(ax.get_ylim()[1], 1.02 * top))
    if label is not None:
        handles, names = ax.get_legend_handles_labels()
        ribbons = [k for k, name in enumerate(names) if name == RIBBON]  # each after its curve
        legend_above(ax, ncols=2, handles=[(handles[k], handles[k - 1]) for k in ribbons],
                     labels=[f'{names[k - 1]}, {RIBBON}' for k in ribbons])
    return ax


def plot_response_ribbon(omega: NDArray[np.float64], spread: Spread, force: float = 1.0, ax: Axes | None = None,
                         label: str | None = None, **line: Any) -> Axes:
    """Amplitude of a response per `force` (N) over the angular frequencies `omega`, with a ribbon of two standard deviations."""
    if ax is None:
        ax = new_axes()
        ax.set_prop_cycle(color=COLOURS)
        ax.set(ylabel='displacement per force (m/N)', yscale='log')
    f, unit = units.hertz(omega), force * units.m / units.N
    (curve,) = ax.plot(f, spread.values / unit, label=label, **line)
    low, high = spread.values - HALF_WIDTH * spread.std, spread.values + HALF_WIDTH * spread.std
    floor = spread.values.min() / 2  # a ribbon wider than the value it surrounds has no lower edge on a logarithmic axis
    ax.fill_between(f, np.maximum(low, floor) / unit, high / unit, color=curve.get_color(), alpha=0.3, linewidth=0,
                    label=label and RIBBON)
    ax.set_ylim(bottom=floor / unit)
    ax.set_xlim(f[0], f[-1])
    label_frequencies(ax.xaxis)
    if label is not None:
        legend_above(ax)
    return ax


def plot_contributions(spread: Spread, labels: Sequence[str], ax: Axes | None = None) -> Axes:
    """Bars of the standard deviation that each parameter causes alone, correlated ones together, and of all.

    Parameters
    ----------
    spread : Spread
        Spread of frequencies, shape (frequencies,).
    labels : sequence of str
        Names of these frequencies.
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes
    """
    rows: dict[str, NDArray[np.float64]] = {'all together': spread.std}
    rows |= dict(sorted(spread.contributions.items(), key=lambda row: row[1].max()))
    ax = new_axes(height=0.5 + 0.15 * len(labels) + 0.11 * (len(labels) + 1) * len(rows)) if ax is None else ax
    height, y = 0.8 / len(labels), np.arange(len(rows))
    for k, (label, hatch) in enumerate(zip(labels, (HATCHES * len(labels))[: len(labels)], strict=True)):
        share = 100 * np.array([std[k] for std in rows.values()]) / abs(spread.values[k])
        bars = ax.barh(y + 0.4 - (k + 0.5) * height, share, height, color=COLOURS[k % len(COLOURS)], alpha=0.75,
                       hatch=hatch, edgecolor='white', label=f'{label}, {abs(spread.values[k]) / (2 * np.pi) / units.Hz:.4g} Hz')
        ax.bar_label(bars, fmt='%.2g', padding=2, fontsize='small')
    ax.set_yticks(y, [_printed(name) for name in rows])
    ax.tick_params(axis='y', length=0)
    ax.set_xlabel('standard deviation (% of the frequency)')
    ax.margins(x=0.1, y=0.02)
    legend_above(ax, ncols=1)
    return ax


def _printed(name: str) -> str:
    """Names of correlated parameters such as 'youngs_modulus, a' as they are printed."""
    return ', '.join(PRINTED.get(part, part.replace('_', ' ')) for part in name.split(', '))
