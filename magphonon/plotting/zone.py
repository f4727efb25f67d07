"""Maps over the first Brillouin zone, drawn in SI on matplotlib axes; see `magphonon.plotting.bands`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from ase.cell import Cell
from ase.dft.kpoints import BandPath, resolve_kpt_path_string
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from .. import units
from ..bands.bands import band_path
from ..bands.zone import PLANAR, ROUND_OFF, ZoneMap, first_zone, frequency_ratio
from .axes import COLOURS, UNSTABLE, in_house_style, label_wavevectors, legend_above, new_axes, point_name
from .structures import draw_arrow, halo

if TYPE_CHECKING:
    from matplotlib.axes import Axes


ROUND = (1, 2, 5, 10)  # contours at round numbers
SHADES = 10  # shades of a map of ratios from one contour to the next
BESIDE_AXES = np.radians(40)
"""Angle by which names of special points are turned about their points, beside the axes of the phases."""


@in_house_style
def plot_zone(path: BandPath, *, ax: Axes | None = None) -> Axes:
    """Draw the first Brillouin zone with its irreducible part, the path of a band diagram and its special points.

    Points k and -k have the same frequencies, so a path in the lower half of the zone is drawn reversed, in the upper half.
    The arrows are the axes of the phases per step xi_1 = k.R_1 and xi_2 = k.R_2: along each the other phase is zero.

    Parameters
    ----------
    path : ase.dft.kpoints.BandPath
        Path through the zone of a planar lattice, such as `bands.path`.
    ax : matplotlib.axes.Axes, optional

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.plotting import plot_zone
    >>> ax = plot_zone(read_scene(ready_scene('prototype')).band_path())
    """
    from matplotlib.collections import PolyCollection

    if np.linalg.matrix_rank(list(path.special_points.values())) != 2:
        raise ValueError(f'the zone is drawn for planar lattices, but the special points of the path {path.path} span no plane')
    ax, _ = _zone_axes(ax, path.cell)
    special = _upright(path.special_points, path.cell)
    part = irreducible_zone(special, path.cell) * units.m
    ax.add_collection(PolyCollection([part], facecolor=COLOURS[6], alpha=0.35, linewidth=0))
    _draw_phases(ax, path.cell)
    names, points = resolve_kpt_path_string(path.path, special)
    for stretch in points:
        ax.plot(*_cartesian(path.cell, stretch).T, color=COLOURS[0], linewidth=1.8, solid_joinstyle='round', zorder=5.5)
    _mark_points(ax, path.cell, {name: special[name] for stretch in names for name in stretch}, turn=BESIDE_AXES)
    return ax


@in_house_style
def plot_ratio(complete: ZoneMap, conventional: ZoneMap, branch: int, *, ax: Axes | None = None) -> Axes:
    """Draw a map of `omega_complete/omega_conventional` of one branch over the zone.

    Parameters
    ----------
    complete, conventional : ZoneMap
        Maps of both models, for the same lattice on the same mesh.
    branch : int
        Number of the branch by ascending frequency, counted from 0 here and from 1 in the picture.
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes
        The map is blank where the ratio is 0/0 (at Gamma without a foundation), and hatched where the complete model is unstable.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import zone_map
    >>> from magphonon.plotting import plot_ratio
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> ax = plot_ratio(zone_map(cell, 12), zone_map(cell, 12, 'conventional'), 0)
    """
    from matplotlib.ticker import MaxNLocator

    _check_branch(complete, branch)
    ratio = frequency_ratio(complete, conventional)[..., branch]
    if not (ratio > 0).any():
        raise ValueError(f'at no wavevector is {_branch_name(complete, branch)} stable in both models, so there is no ratio to '
                         'draw; add a foundation')
    ax, zone = _zone_axes(ax, complete.cell)
    levels = MaxNLocator(8, steps=ROUND).tick_values(max(np.nanmin(ratio), 0), np.nanmax(ratio))
    shades = np.linspace(levels[0], levels[-1], SHADES * (len(levels) - 1) + 1)
    filled = ax.contourf(*_mesh(complete), ratio, levels=shades, cmap='cividis')
    lines = ax.contour(*_mesh(complete), ratio, levels=levels[1:-1], colors='black', linewidths=0.5)
    for contours in (filled, lines):
        contours.set_clip_path(zone)
    label = r'$\omega_\mathrm{complete}/\omega_\mathrm{conventional}$, ' + _branch_name(complete, branch)
    ax.figure.colorbar(filled, ax=ax, pad=0.03, label=label, ticks=levels).add_lines(lines)
    handles = _hatch_unstable(ax, complete, branch, zone)
    if handles:
        legend_above(ax, handles=handles)
    _mark_points(ax, complete.cell, _special_points(complete.cell))
    return ax


def irreducible_zone(points: Mapping[str, NDArray[np.float64]], cell: ArrayLike) -> NDArray[np.float64]:
    """Corners in rad/mm, shape (corners, 2), of the irreducible part of the zone, from which symmetry generates all others.

    They are the special points of the planar lattice, given in fractions of its reciprocal vectors.
    """
    k = np.array([_cartesian(cell, q) for q in points.values()]) / units.m
    return k[ConvexHull(k).vertices]


def upwards(points: Mapping[str, NDArray[np.float64]], cell: Cell) -> float:
    """Sign of k that brings a path into the upper half of the zone: -1 if most special points lie in the lower half, else 1."""
    return -1.0 if sum(_cartesian(cell, q)[1] for q in points.values()) < 0 else 1.0


def _upright(points, cell):
    sign = upwards(points, cell)
    return {name: sign * np.asarray(q) for name, q in points.items()}


def _draw_phases(ax, cell):
    axes = 0.62 * _cartesian(cell, np.eye(3)[:2])
    for number, b in enumerate(axes, start=1):
        draw_arrow(ax, (0, 0), b, rf'$\xi_{number}$', '0.35')
    half_x, half_y = np.maximum(abs(axes).max(axis=0) * 1.3, [ax.get_xlim()[1], ax.get_ylim()[1]])
    ax.set(xlim=(-half_x, half_x), ylim=(-half_y, half_y))


def _check_branch(zone_map, branch):
    if not 0 <= branch < zone_map.omega.shape[-1]:
        raise ValueError(f'branch must be 0 to {zone_map.omega.shape[-1] - 1}, not {branch!r}')


def _branch_name(zone_map, branch):
    return f'branch {branch + 1} of {zone_map.omega.shape[-1]}'


def _zone_axes(ax, cell):
    ax = new_axes(height=3.2) if ax is None else ax
    corners = first_zone(cell) * units.m
    (zone,) = ax.fill(*corners.T, facecolor='none', edgecolor='black', linewidth=1.2, zorder=4)
    half_x, half_y = 1.25 * abs(corners).max(axis=0)
    ax.set(xlim=(-half_x, half_x), ylim=(-half_y, half_y), aspect='equal')
    label_wavevectors(ax, np.linalg.norm(np.asarray(cell)[:2], axis=1).min() / units.m)
    return ax, zone


def _cartesian(cell, q):
    return 2 * np.pi * (np.asarray(q) @ Cell(cell).reciprocal().array)[..., :2] * units.m


def _mesh(zone_map):
    return np.moveaxis(zone_map.wavevectors * units.m, -1, 0)


def _special_points(cell):
    return _upright(band_path(Atoms(cell=cell, pbc=PLANAR), npoints=0).special_points, cell)


def _mark_points(ax, cell, points, turn=0.0):
    """Draw dots and names at special points; names are pushed away from Gamma, in a direction turned right by `turn`."""
    right = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])  # multiplied from the left
    for name, q in points.items():
        k = _cartesian(cell, q)
        away = k / np.linalg.norm(k) @ right if k.any() else np.array([-1, -1]) / np.sqrt(2)
        ax.plot(*k, 'o', color='black', markersize=4, zorder=6)
        ax.annotate(point_name(name), k, xytext=10 * away, textcoords='offset points', ha='center', va='center',
                    path_effects=halo(2.5), zorder=6)


def _hatch_unstable(ax, zone_map, branch, zone):
    """Hatch the unstable part of the zone; return its entry for the legend, if there is any."""
    from matplotlib.patches import Patch

    omega = zone_map.omega[..., branch]
    if omega.min() >= -ROUND_OFF * abs(zone_map.omega).max():
        return []
    region = ax.contourf(*_mesh(zone_map), omega, levels=[omega.min(), 0], colors=UNSTABLE['facecolor'],
                         hatches=[UNSTABLE['hatch']])
    region.set(edgecolor=UNSTABLE['edgecolor'], linewidth=UNSTABLE['linewidth'])
    region.set_clip_path(zone)
    return [Patch(label='unstable', **UNSTABLE)]
