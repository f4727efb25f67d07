"""Frequency responses drawn in SI: amplitude and phase over frequency, with the natural frequencies."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units
from .axes import COLOURS, legend_above, new_figure
from .scales import label_frequencies

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike, NDArray

    from .results import Response

NATURAL = 'natural frequencies'
MOST_BARS = 8
"""Largest number of natural frequencies drawn as bars of full height, as in the paper; more are ticks at the bottom."""


def response_axes() -> NDArray[np.object_]:
    """Two axes of a figure of its own, for amplitude and phase."""
    axes = new_figure(height=3.4).subplots(2, sharex=True, height_ratios=(2, 1))
    axes[0].set(yscale='log', ylabel='displacement per force (m/N)')
    axes[1].set(ylabel='phase (deg)', ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    for ax in axes:
        ax.set_prop_cycle(color=COLOURS)
    return axes


def plot_response(response: Response, natural: ArrayLike = (), axes: NDArray[np.object_] | None = None, label: str | None = None,
                  **line: Any) -> NDArray[np.object_]:
    """Amplitude and phase of a response, and the natural frequencies in its range.

    Parameters
    ----------
    response : FrequencyResponse
        Response of one particle, shape (frequencies,).
    natural : array_like
        Natural frequencies in rad/ms; unstable ones, which are negative, are left out.
    axes : array of two matplotlib.axes.Axes, optional
        From `response_axes`, with other responses to draw over.
    label : str, optional
    **line
        Properties of `matplotlib.lines.Line2D`.

    Returns
    -------
    array of two matplotlib.axes.Axes

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.plotting import plot_response
    >>> from magphonon.response import Place, receptance
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> up = np.array([0, 1.0, 0])
    >>> axes = plot_response(receptance(patch, Place(18, up), Place(12, up), np.linspace(0.5, 2, 40), damping=0.1))
    """
    axes = response_axes() if axes is None else axes
    f, natural = (np.asarray(w) / (2 * np.pi) / units.Hz for w in (response.omega, natural))
    (curve,) = axes[0].plot(f, abs(response.response) / (units.m / units.N), label=label, **line)
    look = {'color': curve.get_color(), 'linestyle': curve.get_linestyle()}
    axes[1].plot(f, np.degrees(np.angle(response.response)), **look)
    inside = natural[(natural >= f[0]) & (natural <= f[-1])]
    rows = len(axes[0].collections)  # of ticks, one above the other
    low, high = (0, 1) if len(inside) <= MOST_BARS else (0.03 * rows, 0.03 * rows + 0.025)
    named = any(len(ticks.get_segments()) for ticks in axes[0].collections)
    name = None if named or not label or not len(inside) else NATURAL  # once: the lines tell of which model
    axes[0].vlines(inside, low, high, transform=axes[0].get_xaxis_transform(), linewidth=0.7, label=name, colors=look['color'],
                   linestyles=look['linestyle'])
    axes[0].set_xlim(f[0], f[-1])
    label_frequencies(axes[1].xaxis)
    if label:
        handles = axes[0].get_legend_handles_labels()[0]
        legend_above(axes[0], handles=sorted(handles, key=lambda handle: handle.get_label() == NATURAL))  # the curves first
    return axes
