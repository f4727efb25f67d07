"""Band diagrams and mode shapes, drawn in SI on matplotlib axes.

Every function takes a result and `ax`, and returns the axes.  Without `ax` it makes a figure of its own, which
pyplot never sees: `ax.figure.savefig('bands.png')`.  To show it on a screen, pass `ax=plt.figure().gca()`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .axes import COLOURS, MARKERS, UNSTABLE, legend_above, new_axes, point_name
from .scales import label_frequencies

if TYPE_CHECKING:
    from typing import Any

    from ase.dft.kpoints import BandPath
    from matplotlib.axes import Axes

    from ..bands.bands import Bands

NEGLIGIBLE = 3e-5
"""Frequencies below this fraction of the highest one are zero in a picture, whatever their sign.

Squared frequencies by phonopy are good to 1e-9 of the highest one, and this is the root of it; growth as slow could not be seen.
"""


def plot_bands(bands: Bands, ax: Axes | None = None, label: str | None = None, **line: Any) -> Axes:
    """Frequencies along the path; unstable modes below zero, as -|f|, in a shaded region.

    Parameters
    ----------
    bands : Bands
    ax : matplotlib.axes.Axes, optional
        Axes with other bands along the same path, to draw over them.
    label : str, optional
        One entry in the legend.
    **line
        Properties of `matplotlib.lines.Line2D`.  Markers are thinned unless `markevery` is given.

    Returns
    -------
    matplotlib.axes.Axes

    Raises
    ------
    ValueError
        If the axes show bands along another path.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, plot_bands
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> ax = plot_bands(analytic_bands(cell, cell.cell.bandpath('GMKG', npoints=50, pbc=cell.pbc)))
    >>> ax.get_ylabel()
    'frequency (Hz)'
    """
    from matplotlib.cbook import normalize_kwargs
    from matplotlib.lines import Line2D

    ax = new_axes() if ax is None else ax
    x, ticks, names = bands.path.get_linear_kpoint_axis()
    at, names = _joined(ticks, [point_name(name) for name in names])
    if not ax.lines:
        ax.set_prop_cycle(color=COLOURS)
        label_path(ax, bands.path)
    elif len(ax.get_xticks()) != len(at) or not np.allclose(ax.get_xticks(), at, rtol=1e-6, atol=1e-9 * x[-1]):
        raise ValueError(f'these bands run along another path ({bands.path.path}, {x[-1]:g}/mm long) than those on the axes; '
                         'compute both on the same path')
    x, f = _broken(x, bands.frequencies_Hz, bands.path.kpts)
    look: dict[str, Any] = {'markevery': max(1, len(x) // MARKERS)} | normalize_kwargs(line, Line2D)
    (first,) = ax.plot(x, f[:, 0], label=label, **look)
    others: dict[str, Any] = {'color': first.get_color()} | look
    ax.plot(x, f[:, 1:], **others)  # unlabelled: one entry in the legend
    _from_zero(ax)
    if label is not None:
        legend_above(ax)
    return ax


def label_path(ax: Axes, path: BandPath) -> None:
    """Let the axis of wavevectors run along the path, with the names of its special points."""
    x, ticks, names = path.get_linear_kpoint_axis()
    ax.set_xticks(*_joined(ticks, [point_name(name) for name in names]))
    ax.grid(axis='x', color='0.7', linewidth=0.8)
    ax.tick_params(axis='x', length=0)
    ax.set_xlim(x[0], x[-1])


def _joined(ticks, names):
    """Ticks and names with one tick, 'X,M', where the path jumps."""
    at = np.unique(ticks)
    return at, [','.join(dict.fromkeys(name for tick, name in zip(ticks, names, strict=True) if tick == here)) for here in at]


def _broken(x, f, kpts):
    """Branches with a gap where the path jumps: there ASE's axis stands still and the wavevector does not."""
    jumps = np.flatnonzero((np.diff(x) == 0) & np.diff(kpts, axis=0).any(axis=1)) + 1
    return np.insert(x, jumps, np.nan), np.insert(f, jumps, np.nan, axis=0)


def _from_zero(ax):
    """Let the frequency axis start at zero, or below the lowest unstable mode, with the range under zero shaded."""
    for patch in [patch for patch in ax.patches if patch.get_gid() == 'unstable']:
        patch.remove()
    for text in [text for text in ax.texts if text.get_gid() == 'unstable']:
        text.remove()
    f = np.concatenate([line.get_ydata() for line in ax.lines])
    top, bottom = 1.05 * np.nanmax(f), 0.0
    if np.nanmin(f) < -NEGLIGIBLE * np.nanmax(abs(f)):
        bottom = np.nanmin(f) - 0.05 * (np.nanmax(f) - np.nanmin(f))
        ax.axhspan(bottom, 0, gid='unstable', zorder=0, **UNSTABLE)
        ax.text(1.01, bottom / 2, 'unstable', gid='unstable', rotation=90, va='center', transform=ax.get_yaxis_transform())
    ax.set_ylim(bottom, top)
    label_frequencies(ax.yaxis)
