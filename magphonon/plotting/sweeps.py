"""Pictures of the answers of a sweep over one or two of its axes, with bad points hatched."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .axes import COLOURS, UNSTABLE, in_house_style, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from xarray import DataArray, Dataset

BAD = {'facecolor': '0.93', 'edgecolor': '0.6', 'hatch': '///', 'linewidth': 0.0}

SMALL = 0.1  # values below this many m or s are drawn in mm or ms
WIDE = 30.0  # answers that are positive, the largest more than this multiple of the smallest, are drawn on a logarithmic scale


@in_house_style
def plot_sweep(answers: Dataset, name: str, *, ax: Axes | None = None) -> Axes:
    """Draw one answer of a sweep: over one axis as a line, over two as a map.

    Axes with one value, and all axes after the first two, are fixed at their first value, which the title states. Bad points are
    hatched. If the answer changes its sign, a line marks the zero.

    Parameters
    ----------
    answers : xarray.Dataset
        Answers from `magphonon.sweeps.sweep`.
    name : str
        One of the variables of `answers`, a number at every point.
    ax : matplotlib Axes, optional
    """
    shown = _in_small_units(answers[name])
    wide = sorted(shown.dims, key=lambda axis: shown.sizes[axis] == 1)  # axes of several values first, else in their order
    further = dict.fromkeys(wide[2:], 0) | dict.fromkeys([axis for axis in wide[1:2] if shown.sizes[axis] == 1], 0)
    at = [_value(shown[axis]) for axis in shown.dims if axis in further]
    shown = shown.isel(further)
    ax = new_axes() if ax is None else ax
    if shown.ndim == 1:
        _draw_line(shown, ax)
    else:
        _draw_map(shown, ax)
    if at:
        ax.set_title(', '.join(at), fontsize='medium')
    return ax


def _draw_line(values: DataArray, ax: Axes) -> None:
    x, y = values[values.dims[0]], values.to_numpy()
    ax.plot(x, y, '.-', color=COLOURS[0], markersize=4)
    edges = _edges(x.to_numpy())
    for k in np.flatnonzero(np.isnan(y)):
        ax.axvspan(*sorted(edges[k:k + 2]), **UNSTABLE)
    if np.nanmin(y, initial=0) < 0 < np.nanmax(y, initial=0):
        ax.axhline(0, color='0.4', linewidth=0.8)
    ax.set(xlabel=_label(x), ylabel=_label(values), xlim=sorted(edges[[0, -1]]))
    if _in_equal_factors(x.to_numpy()):
        ax.set_xscale('log')
    if _is_wide(y):
        ax.set_yscale('log')


def _draw_map(values: DataArray, ax: Axes) -> None:
    from matplotlib.colors import ListedColormap, LogNorm

    y, x = (values[axis] for axis in values.dims)
    table = np.ma.masked_invalid(values.to_numpy())
    mesh = _edges(x.to_numpy()), _edges(y.to_numpy())
    bad = np.ma.masked_array(np.zeros(table.shape), ~np.ma.getmaskarray(table))
    ax.pcolor(*mesh, bad, cmap=ListedColormap([BAD['facecolor']]), hatch=BAD['hatch'], edgecolor=BAD['edgecolor'], linewidth=0)
    if table.count():
        shades = ax.pcolormesh(*mesh, table, cmap='cividis', norm=LogNorm() if _is_wide(table.compressed()) else None)
        ax.figure.colorbar(shades, ax=ax, label=_label(values))
        if table.min() < 0 < table.max() and min(table.shape) > 1:
            ax.contour(x, y, table, levels=[0], colors='white', linewidths=1.2)
    ax.set(xlabel=_label(x), ylabel=_label(y))
    for axis, scale in ((x, ax.set_xscale), (y, ax.set_yscale)):
        if _in_equal_factors(axis.to_numpy()):
            scale('log')


def _named(array: DataArray) -> tuple[str, str]:
    """Name and unit of an array; the unit is empty for plain numbers."""
    unit = array.attrs.get('units', '')
    return str(array.attrs.get('long_name', array.name)), '' if unit == '1' else unit


def _label(array: DataArray) -> str:
    name, unit = _named(array)
    return f'{name} ({unit})' if unit else name


def _value(axis: DataArray) -> str:
    name, unit = _named(axis)
    return f'{name} = {float(axis[0]):.4g} {unit}'.rstrip()


def _in_small_units(array: DataArray) -> DataArray:
    """The answers and axes, converted to mm and ms if all their values are small."""
    small = {'m': 'mm', 's': 'ms'}

    def smaller(values):
        unit, least = values.attrs.get('units'), abs(values).max() < SMALL
        return (1e3 * values).assign_attrs(values.attrs | {'units': small[unit]}) if unit in small and least else values

    return smaller(array).assign_coords({axis: smaller(array[axis]) for axis in array.dims})


def _is_wide(values: np.ndarray) -> bool:
    low, high = np.nanmin(values, initial=np.inf), np.nanmax(values, initial=0)
    return bool(0 < WIDE * low < high)


def _in_equal_factors(values: np.ndarray) -> bool:
    """Whether the values are equal factors apart and cover so wide a range that a logarithmic axis shows them better."""
    if len(values) < 3 or values.min() <= 0 or values.max() < 3 * values.min():
        return False
    steps = np.diff(np.log(values))
    return bool(np.allclose(steps, steps[0], rtol=1e-6))


def _edges(values: np.ndarray) -> np.ndarray:
    """Borders of the cells around the values of one axis, halfway between them, shape (len(values) + 1,)."""
    if len(values) == 1:
        return values + np.array([-0.5, 0.5]) * (abs(values) if values[0] else 1.0)
    logarithmic = _in_equal_factors(values)
    place = np.log(values) if logarithmic else values
    middle = (place[1:] + place[:-1]) / 2
    edges = np.concatenate([[2 * place[0] - middle[0]], middle, [2 * place[-1] - middle[-1]]])
    return np.exp(edges) if logarithmic else edges
