"""The first Brillouin zone, drawn in SI on matplotlib axes; see `magphonon.plotting.bands`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

import numpy as np
from ase.cell import Cell
from ase.dft.kpoints import BandPath, resolve_kpt_path_string
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import ConvexHull

from .. import units
from ..bands.bloch import first_zone
from .axes import COLOURS, in_house_style, label_wavevectors, new_axes, point_name
from .structures import draw_arrow, halo

if TYPE_CHECKING:
    from matplotlib.axes import Axes


TURN = np.radians(40)
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
    ax = new_axes(height=3.2) if ax is None else ax
    _draw_border(ax, path.cell)
    sign = upwards(path.special_points, path.cell)
    special = {name: sign * np.asarray(q) for name, q in path.special_points.items()}
    part = irreducible_zone(special, path.cell) * units.m
    ax.add_collection(PolyCollection([part], facecolor=COLOURS[6], alpha=0.35, linewidth=0))
    _draw_phases(ax, path.cell)
    names, points = resolve_kpt_path_string(path.path, special)
    for stretch in points:
        ax.plot(*_cartesian(path.cell, stretch).T, color=COLOURS[0], linewidth=1.8, solid_joinstyle='round', zorder=5.5)
    _mark_points(ax, path.cell, {name: special[name] for stretch in names for name in stretch})
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


def _draw_phases(ax, cell):
    axes = 0.62 * _cartesian(cell, np.eye(3)[:2])
    for number, b in enumerate(axes, start=1):
        draw_arrow(ax, (0, 0), b, rf'$\xi_{number}$', '0.35')
    half_x, half_y = np.maximum(abs(axes).max(axis=0) * 1.3, [ax.get_xlim()[1], ax.get_ylim()[1]])
    ax.set(xlim=(-half_x, half_x), ylim=(-half_y, half_y))


def _draw_border(ax, cell):
    corners = first_zone(cell) * units.m
    ax.fill(*corners.T, facecolor='none', edgecolor='black', linewidth=1.2, zorder=4)
    half_x, half_y = 1.25 * abs(corners).max(axis=0)
    ax.set(xlim=(-half_x, half_x), ylim=(-half_y, half_y), aspect='equal')
    label_wavevectors(ax, np.linalg.norm(np.asarray(cell)[:2], axis=1).min() / units.m)


def _cartesian(cell, q):
    return 2 * np.pi * (np.asarray(q) @ Cell(cell).reciprocal().array)[..., :2] * units.m


def _mark_points(ax, cell, points):
    """Draw dots and names at special points; names are pushed away from Gamma, in a direction turned right by TURN."""
    right = np.array([[np.cos(TURN), -np.sin(TURN)], [np.sin(TURN), np.cos(TURN)]])  # multiplied from the left
    for name, q in points.items():
        k = _cartesian(cell, q)
        away = k / np.linalg.norm(k) @ right if k.any() else np.array([-1, -1]) / np.sqrt(2)
        ax.plot(*k, 'o', color='black', markersize=4, zorder=6)
        ax.annotate(point_name(name), k, xytext=10 * away, textcoords='offset points', ha='center', va='center',
                    path_effects=halo(2.5), zorder=6)
