"""Frequency responses, and ribbons of uncertainty around bands, drawn in SI."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units
from .axes import COLOURS, in_house_style, label_frequencies, legend_above, new_figure
from .bands import plot_bands

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from ..bands.bands import Bands
    from ..design.uncertainty import Spread
    from ..response.frf import FrequencyResponse
    from ..response.transfer_functions import TransferFunction

HALF_WIDTH = 2  # half width of a ribbon in standard deviations; it contains 95 of 100 lattices
RIBBON = rf'$\pm{HALF_WIDTH}\sigma$'
NATURAL = 'natural frequencies'
MOST_ROWS = 4  # number of transfer functions that are drawn
MOST_BARS = 8  # largest number of natural frequencies drawn as bars of full height, as in the paper; more are ticks at the bottom


@in_house_style
def plot_band_ribbons(bands: Bands, spread: Spread, *, ax: Axes | None = None, label: str | None = None, **line: Any) -> Axes:
    """Draw bands with a ribbon of two standard deviations around each branch; `line` as in `plot_bands`."""
    ax = plot_bands(bands, ax=ax, label=label, **line)
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


@in_house_style
def response_axes(ylabel: str = 'displacement per force (m/N)') -> NDArray[np.object_]:
    """Two axes of a new figure, for amplitude and phase."""
    axes = new_figure(height=3.4).subplots(2, sharex=True, height_ratios=(2, 1))
    axes[0].set(yscale='log', ylabel=ylabel)
    axes[1].set(ylabel='phase (deg)', ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180))
    for ax in axes:
        ax.set_prop_cycle(color=COLOURS)
    return axes


@in_house_style
def plot_response(response: FrequencyResponse, natural: ArrayLike = (), *, axes: NDArray[np.object_] | None = None,
                  label: str | None = None, **line: Any) -> NDArray[np.object_]:
    """Draw amplitude and phase of a response, and the natural frequencies in its range.

    Parameters
    ----------
    response : FrequencyResponse
        Response of one particle, shape (frequencies,).
    natural : array_like
        Natural frequencies in rad/ms; unstable ones, which are negative, are omitted.
    axes : array of two matplotlib.axes.Axes, optional
        Axes from `response_axes`, on which other responses may already be drawn.
    label : str, optional
    **line
        Properties of `matplotlib.lines.Line2D`.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.plotting import plot_response
    >>> from magphonon.response import Dof, receptance
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> up = np.array([0, 1.0, 0])
    >>> axes = plot_response(receptance(patch, Dof(18, up), Dof(12, up), np.linspace(0.5, 2, 40), damping=0.1))
    """
    shaken = response.per_bench
    axes = response_axes(*['displacement / shaker displacement'] * shaken) if axes is None else axes
    f, natural = (np.asarray(w) / (2 * np.pi) / units.Hz for w in (response.omega, natural))
    unit = 1.0 if shaken else units.m / units.N
    (curve,) = axes[0].plot(f, abs(response.response) / unit, label=label, **line)
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


@in_house_style
def plot_transfer(functions: Sequence[TransferFunction], curves: Mapping[str, Sequence[NDArray[np.complex128]]]) -> Figure:
    """Draw measured transfer functions and those computed in both models: amplitude and phase, a row for each function.

    Only the first few functions are drawn.

    Parameters
    ----------
    functions : sequence of TransferFunction
    curves : dict of sequence of ndarray of complex
        For each model, the computed responses at the frequencies of each function.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.plotting import plot_transfer
    >>> from magphonon.response.transfer_functions import TransferFunction
    >>> w = np.linspace(0.1, 1, 50)
    >>> h = 1 / (0.3 - w**2 + 0.02j * w)
    >>> figure = plot_transfer([TransferFunction('a', w, 1.05 * h)], {'complete': [h], 'conventional': [0.9 * h]})
    """
    shown = functions[:MOST_ROWS]
    figure = new_figure(height=0.6 + 1.5 * len(shown))
    axes = figure.subplots(len(shown), 2, sharex=True, squeeze=False)
    for k, (row, one) in enumerate(zip(axes, shown, strict=True)):
        f, unit = units.hertz(one.omega), 1.0 if one.shaken else units.m / units.N
        for ax, part in zip(row, (lambda h, unit=unit: abs(h) / unit, lambda h: np.degrees(np.angle(h))), strict=True):
            ax.plot(f, part(one.response), '.', color='0.35', markersize=2.5, label='measured')
            for (model, own), line, colour in zip(curves.items(), ('-', '--'), COLOURS, strict=False):
                ax.plot(f, part(own[k]), line, color=colour, linewidth=0.9, label=model)
        row[0].set(yscale='log', ylabel='per bench' if one.shaken else 'm/N')
        row[1].set(ylim=(-190, 190), yticks=(-180, -90, 0, 90, 180), ylabel='phase (deg)')
        row[0].text(0.02, 0.04, f'{k + 1}', transform=row[0].transAxes, fontsize='small')
    for ax in axes[-1]:
        label_frequencies(ax.xaxis)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc='outside upper center', ncols=3)
    return figure
