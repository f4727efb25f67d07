"""Densities of states, drawn in SI on matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .axes import COLOURS, in_house_style, label_frequencies, legend_above, new_axes
from .bands import NEGLIGIBLE

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..bands.density import DensityOfStates

TALL = 6.0  # peaks above this multiple of the ninth decile are cut; a flat branch has a peak that is as high as its bin is narrow


@in_house_style
def plot_density(density: DensityOfStates, *, ax: Axes | None = None, label: str | None = None, **line: Any) -> Axes:
    """Draw the share of all modes per Hz against frequency, so that a lattice and a patch can be compared. The shaded band
    extends two standard errors to either side.

    If the peak of a flat branch would dwarf everything else, it is cut off and its height is written at the top.

    Parameters
    ----------
    density : DensityOfStates
    ax : matplotlib.axes.Axes, optional
    label : str, optional
        Name of the density in the legend.
    **line
        Properties of `matplotlib.lines.Line2D`.
    """
    ax = new_axes() if ax is None else ax
    f, share = density.frequencies_Hz, density.per_Hz
    if not ax.lines:
        ax.set_prop_cycle(color=COLOURS)
    (drawn,) = ax.plot(f, share, label=label, **line)
    if density.error.any():
        error = 2 * density.error * share.max() / density.density.max()
        ax.fill_between(f, share - error, share + error, color=drawn.get_color(), alpha=0.25, linewidth=0)
    at, shares = (np.concatenate(both) for both in zip(*(line.get_data() for line in ax.lines), strict=True))
    lowest = at.min() if at.min() < -NEGLIGIBLE * at.max() else 0
    top = min(1.05 * shares.max(), TALL * np.quantile(shares[shares > 0], 0.9))
    ax.set(ylabel='share of all modes per Hz', xlim=(lowest, 1.02 * at.max()), ylim=(0, top))
    label_frequencies(ax.xaxis)
    _write_cut_peaks(ax, top)
    if label is not None:
        legend_above(ax, ncols=2)
    return ax


def _write_cut_peaks(ax, top):
    for text in [text for text in ax.texts if text.get_gid() == 'cut']:
        text.remove()
    middle = np.mean(ax.get_xlim())
    cut = [line for line in ax.lines if max(line.get_ydata()) > top]
    for row, line in enumerate(cut):  # a row of heights for each curve, as peaks may coincide
        f, share = line.get_data()
        beyond = np.flatnonzero(share > top)
        for peak in np.split(beyond, np.flatnonzero(np.diff(beyond) > 1) + 1):
            at, side = f[peak[share[peak].argmax()]], 1 if f[peak[0]] < middle else -1
            ax.annotate(f'up to {share[peak].max():.2g}', (at, top), (4 * side, -3 - 11 * row), textcoords='offset points',
                        gid='cut', va='top', ha='left' if side > 0 else 'right', color=line.get_color())
