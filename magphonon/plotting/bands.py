"""Band diagrams and densities of states, drawn in SI on matplotlib axes.

Every function takes a result and `ax`, and returns the axes.  Without `ax` it makes a figure of its own, unknown to pyplot: save
it with `ax.figure.savefig('bands.png')`.  To show it on a screen, pass `ax=plt.figure().gca()`.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from ase.dft.kpoints import BandPath
from numpy.typing import NDArray

from .axes import COLOURS, MARKERS, UNSTABLE, in_house_style, label_frequencies, legend_above, new_axes, point_name
from .structures import halo

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..bands.bands import Bands
    from ..bands.density import DensityOfStates

NEGLIGIBLE = 3e-5
"""Frequencies below this fraction of the highest one are zero in a picture, whatever their sign.

Squared frequencies by phonopy are good to 1e-9 of the highest one, and this is the root of it; growth as slow could not be seen.
"""
ALONG_NORMAL = 0.9  # share of a mode's motion along the normal of the plane above which it is called out of the plane
MOST_NAMED = 3  # largest number of branches that are named: more leave no room
CLEAR, BESIDE = 0.035, (0.055, 0.09, 0.13)
"""Least distance of a name from all curves, and distances from its own that are tried, in heights of the axes."""
LETTER = 0.019  # width of a letter in widths of the axes
TRIED, DRAWN = 150, 600
"""Largest number of wavevectors at which a name is tried, and of points of a curve that it avoids: as fine as a picture shows."""
TALL = 6.0  # peaks above this multiple of the ninth decile are cut; a flat branch has a peak that is as high as its bin is narrow


@in_house_style
def plot_bands(bands: Bands, *, ax: Axes | None = None, label: str | None = None, **line: Any) -> Axes:
    """Draw frequencies along the path of bands; unstable modes are below zero, as -|f|, in a shaded region.

    Parameters
    ----------
    bands : Bands
    ax : matplotlib.axes.Axes, optional
        Axes on which other bands along the same path may already be drawn.
    label : str, optional
        Name of these bands in the legend.
    **line
        Properties of `matplotlib.lines.Line2D`.  Markers are thinned unless `markevery` is given.

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
    # a gap where the path jumps: there ASE's axis stands still and the wavevector does not
    jumps = np.flatnonzero((np.diff(x) == 0) & np.diff(bands.path.kpts, axis=0).any(axis=1)) + 1
    x, f = np.insert(x, jumps, np.nan), np.insert(bands.frequencies_Hz, jumps, np.nan, axis=0)
    look: dict[str, Any] = {'markevery': max(1, len(x) // MARKERS)} | normalize_kwargs(line, Line2D)
    (first,) = ax.plot(x, f[:, 0], label=label, **look)
    others: dict[str, Any] = {'color': first.get_color()} | look
    ax.plot(x, f[:, 1:], **others)  # unlabelled: one entry in the legend
    _from_zero(ax)
    if label is not None:
        legend_above(ax)
    return ax


def plot_edge_bands(bands: Bands, weights: NDArray[np.float64], *, ax: Axes | None = None) -> Axes:
    """Draw the bands of a strip; waves along the edges are marked by arrows, with one colour for each edge.

    Parameters
    ----------
    bands : Bands
        Bands of a strip, with modes (`vectors=True`).
    weights : ndarray, shape (wavevectors, modes, 2)
        `magphonon.bands.edge_weights(strip, bands)`; waves with more than half of their motion at an edge are marked.
    ax : matplotlib.axes.Axes, optional

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices
    >>> from magphonon.bands import edge_weights
    >>> from magphonon.plotting import plot_edge_bands
    >>> strip = lattices.ribbon(lattices.honeycomb(1.0, 1.0), 6)
    >>> strip.calc = MagneticRepulsion(strip, InversePower(1.0, 4.0), foundation=6.0)
    >>> path = strip.cell.bandpath([[-0.5, 0, 0], [0.5, 0, 0]], npoints=20, pbc=strip.pbc)
    >>> bands = analytic_bands(strip, path, 'conventional', vectors=True)
    >>> ax = plot_edge_bands(bands, edge_weights(strip, bands))
    """
    ax = new_axes() if ax is None else ax
    x, f = np.broadcast_arrays(bands.path.get_linear_kpoint_axis()[0][:, None], bands.frequencies_Hz)
    ax.plot(x[:, 0], f, color='0.7', linewidth=0.5)
    for edge, (name, marker) in enumerate((('right edge', '>'), ('left edge', '<'))):
        own = weights[..., edge] > 0.5
        ax.scatter(x[own], f[own], s=9, marker=marker, color=COLOURS[edge], linewidths=0, zorder=3, label=name)
    label_path(ax, bands.path)
    label_frequencies(ax.yaxis)
    legend_above(ax, ncols=2)
    return ax


def label_path(ax: Axes, path: BandPath) -> None:
    """Set the axis of wavevectors to the length of the path, and label its special points."""
    x, ticks, names = path.get_linear_kpoint_axis()
    ax.set_xticks(*_joined(ticks, [point_name(name) for name in names]))
    ax.grid(axis='x', color='0.7', linewidth=0.8)
    ax.tick_params(axis='x', length=0)
    ax.set_xlim(x[0], x[-1])


def _joined(ticks, names):
    """Ticks and their names; where the path jumps, the two ends share one tick, such as 'X,M'."""
    at = np.unique(ticks)
    return at, [','.join(dict.fromkeys(name for tick, name in zip(ticks, names, strict=True) if tick == here)) for here in at]


def _from_zero(ax):
    """Let the frequency axis start at zero, or below the lowest unstable mode with the range under zero shaded."""
    for artist in (*ax.patches, *ax.texts):
        if artist.get_gid() == 'unstable':
            artist.remove()
    f = np.concatenate([line.get_ydata() for line in ax.lines])
    top, bottom = 1.05 * np.nanmax(f), 0.0
    if np.nanmin(f) < -NEGLIGIBLE * np.nanmax(abs(f)):
        bottom = np.nanmin(f) - 0.05 * (np.nanmax(f) - np.nanmin(f))
        ax.axhspan(bottom, 0, gid='unstable', zorder=0, **UNSTABLE)
        ax.text(1.01, bottom / 2, 'unstable', gid='unstable', rotation=90, va='center', transform=ax.get_yaxis_transform())
    ax.set_ylim(bottom, top)
    label_frequencies(ax.yaxis)


def mode_names(bands: Bands) -> NDArray[np.str_]:
    """Name of each mode, shape (wavevectors, modes): 'shear', 'longitudinal', 'mixed', 'out of the plane', or '' at k = 0.

    Parameters
    ----------
    bands : Bands
        Bands with modes (`vectors=True`).  Transverse modes of a chain and of a lattice in space keep the name 'transverse'.
    """
    names = bands.polarisations.astype(object)
    if np.linalg.matrix_rank(list(bands.path.special_points.values())) == 2:
        names[names == 'transverse'] = 'shear'
        if bands.vectors is not None and bands.vectors.shape[-1] == 3:
            names[(abs(bands.vectors[..., 2]) ** 2).sum(axis=2) > ALONG_NORMAL] = 'out of the plane'
    return names.astype(str)


@in_house_style
def name_branches(ax: Axes, bands: Bands) -> None:
    """Write each name of modes once beside a branch that has it, where it is farthest from all curves, if there is room.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        Axes on which `plot_bands` has already drawn these and all other bands.
    bands : Bands
        Bands with modes (`vectors=True`).
    """
    names, x = mode_names(bands), bands.path.get_linear_kpoint_axis()[0]
    if names.shape[1] > MOST_NAMED:
        return
    used = {'mixed', ''}
    curves = [_thinned(np.array(line.get_data(), float), DRAWN) for line in ax.lines if len(line.get_xdata()) > 2]  # pyright: ignore[reportArgumentType]  no scalar
    for f, of_branch in zip(bands.frequencies_Hz.T, names.T, strict=True):
        place = _place_beside(ax, curves, x, f, np.where(np.isin(of_branch, list(used)), '', of_branch))
        if place is not None:
            k, y, long = place
            ax.text(x[k], y, of_branch[k], ha='center', va='center', path_effects=halo(1.5))
            used.add(of_branch[k])
            curves.append(np.array([x[k] + np.linspace(-0.5, 0.5) * long, np.full(50, y)]))


def _place_beside(ax, curves, x, f, names):
    """Index of the point of a branch f(x) to be named, height and length of its name; None if no name has room.

    It is as near to the branch as the curves allow, and there as far from them as possible.
    """
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    long = LETTER * (right - left) * np.char.str_len(names.astype(str))
    inside = (left < x - long / 2) & (x + long / 2 < right)
    named = _thinned(np.flatnonzero(names != ''), TRIED)
    spans = {k: _spans(curves, x[k], long[k], low, high) for k in named[inside[named]]}
    for away in np.outer(BESIDE, (-1, 1)) * (high - low):
        room, k, y = max(((np.maximum(bottom - y, y - top).min(), k, y) for k, (bottom, top) in spans.items()
                          for y in f[k] + away), default=(0.0, 0, 0.0))
        if room > CLEAR * (high - low):
            return k, y, long[k]
    return None


def _spans(curves, x, long, low, high):
    """Lowest and highest point of each curve, and of all beyond the axes, in a stretch of length `long` about x: shape (2, any).

    No name fits between them, however far apart they are: an unstable branch is steep where it crosses zero.
    """
    near = (heights[abs(at - x) < long / 2] for at, heights in curves)
    return np.array([(-np.inf, low), (high, np.inf), *((np.nanmin(h), np.nanmax(h)) for h in near if len(h))]).T


def _thinned(values, most):
    return values[..., :: -(-values.shape[-1] // most) or 1]


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
