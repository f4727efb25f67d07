"""Names of modes and branches: shear or transverse, longitudinal, mixed, out of the plane."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .structures import halo

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

    from ..bands.bands import Bands

ALONG_NORMAL = 0.9
"""Share of a mode's motion along the normal of the plane above which it is called out of the plane."""
MOST_NAMED = 3
"""Largest number of branches that are named: more leave no room."""
CLEAR, BESIDE = 0.035, (0.055, 0.09, 0.13)
"""Least distance of a name from all curves, and distances from its own that are tried, in heights of the axes."""
LETTER = 0.019
"""Width of a letter in widths of the axes."""
TRIED, DRAWN = 150, 600
"""Largest number of wavevectors at which a name is tried, and of points of a curve that it avoids: as fine as a picture shows."""


def mode_names(bands: Bands) -> NDArray[np.str_]:
    """Name of each mode, shape (wavevectors, modes): 'shear', 'longitudinal', 'mixed', 'out of the plane', or '' at k = 0.

    Parameters
    ----------
    bands : Bands
        With modes (`vectors=True`).  Transverse modes of a chain and of a lattice in space keep the name 'transverse'.
    """
    names = bands.polarisations.astype(object)
    if np.linalg.matrix_rank(list(bands.path.special_points.values())) == 2:
        names[names == 'transverse'] = 'shear'
        if bands.vectors is not None and bands.vectors.shape[-1] == 3:
            names[(abs(bands.vectors[..., 2]) ** 2).sum(axis=2) > ALONG_NORMAL] = 'out of the plane'
    return names.astype(str)


def name_branches(ax: Axes, bands: Bands) -> None:
    """Write each name beside one branch that has it, where it is farthest from all curves; nothing where there is no room.

    Parameters
    ----------
    ax : matplotlib.axes.Axes
        On which `plot_bands` has drawn these bands, and all others.
    bands : Bands
        With modes (`vectors=True`).
    """
    names, x = mode_names(bands), bands.path.get_linear_kpoint_axis()[0]
    if names.shape[1] > MOST_NAMED:
        return
    used = {'mixed', ''}
    (left, right), (low, high) = ax.get_xlim(), ax.get_ylim()
    curves = [_thinned(np.array(line.get_data(), float), DRAWN) for line in ax.lines if len(line.get_xdata()) > 2]  # pyright: ignore[reportArgumentType]  no scalar
    for f, of_branch in zip(bands.frequencies_Hz.T, names.T, strict=True):
        long = {name: LETTER * (right - left) * len(name) for name in set(of_branch)}
        named = [k for k in _thinned(np.flatnonzero(~np.isin(of_branch, list(used))), TRIED)
                 if left < x[k] - long[of_branch[k]] / 2 and x[k] + long[of_branch[k]] / 2 < right]
        for away in np.outer(BESIDE, (-1, 1)) * (high - low):
            places = [(min(y - low, high - y, _distance(curves, x[k], long[of_branch[k]], y)), k, y)
                      for k in named for y in f[k] + away]
            room, k, y = max(places, default=(0.0, 0, 0.0))
            if room > CLEAR * (high - low):
                ax.text(x[k], y, of_branch[k], ha='center', va='center', path_effects=halo(1.5))
                used.add(of_branch[k])
                curves.append(np.array([x[k] + np.linspace(-0.5, 0.5) * long[of_branch[k]], np.full(50, y)]))
                break


def _distance(curves, x, long, y):
    """Distance of a stretch as `long` about x at the height y from the curves above and below it.

    It is zero for a curve that has points on both sides, however far apart: an unstable branch is steep where it crosses zero.
    """
    near = (heights[abs(at - x) < long / 2] for at, heights in curves)
    return min((max(np.nanmin(h) - y, y - np.nanmax(h), 0.0) for h in near if len(h)), default=np.inf)


def _thinned(values, most):
    """Every n-th of the values along the last axis, so that about as many as `most` are left."""
    return values[..., :: -(-values.shape[-1] // most) or 1]
