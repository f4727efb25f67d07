"""The grid of a sweep: keys of a scene with the values that they take, and the points where the axes cross."""

from __future__ import annotations

import re
from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from ..errors import finite, shown, whole

if TYPE_CHECKING:
    from collections.abc import Mapping

    from numpy.typing import ArrayLike, NDArray

MOST_POINTS = 10**8
"""Largest number of points; the answers to more do not fit into memory."""
UNITS = {
    '_N_per_m': 'N/m', '_kg_per_m3': 'kg/m3', '_N_m_a': 'N m^a', '_A_m2': 'A m2', '_J_m': 'J m', '_per_s': '1/s', '_Pa': 'Pa',
    '_kg': 'kg', '_Hz': 'Hz', '_deg': 'degree', '_T': 'T', '_C': 'C', '_N': 'N', '_m': 'm', '_s': 's',
}
"""Units by the ends of the keys of a scene, the longer ones first."""


def axis_of(text: str) -> tuple[str, NDArray[np.float64]]:
    """Key and values of an axis as the shell gives it.

    Parameters
    ----------
    text : str
        `KEY=FROM:TO:COUNT`, in equal steps; `KEY=FROM:TO:COUNT:log`, in equal factors; or `KEY=A,B,C`.

    Returns
    -------
    key : str
    values : ndarray, shape (count,)

    Raises
    ------
    ValueError
        If it has another form.
    """
    key, equals, given = text.partition('=')
    if not (key and equals and given):
        raise ValueError(f'--over {text} must be KEY=FROM:TO:COUNT, KEY=FROM:TO:COUNT:log or KEY=A,B,C, as in law.a=3:6:50')
    try:
        if ':' not in given:
            return key, finite(f'--over {key}', [float(value) for value in given.split(',')])
        first, last, count, *logarithmic = given.split(':')
        first, last = finite(f'--over {key}', [float(first), float(last)])
        number = whole(f'the count of --over {key}', float(count))
    except (ValueError, OverflowError) as error:
        raise ValueError(f'--over {text} is no range of numbers ({error}); write it as law.a=3:6:50 or law.a=3,4,6') from None
    if logarithmic not in ([], ['log']):
        raise ValueError(f"--over {text}: after the count only 'log' may follow, not {shown(':'.join(logarithmic))}")
    if not logarithmic:
        return key, np.linspace(first, last, number)
    if min(first, last) <= 0:
        raise ValueError(f'--over {text}: equal factors need two positive ends')
    return key, np.geomspace(first, last, number)


def checked_axes(over: Mapping[str, ArrayLike]) -> dict[str, NDArray[np.float64]]:
    """The axes as arrays.

    Raises
    ------
    ValueError
        If there is none, or one that is no list of different numbers, or there are more than 1e8 points.
    """
    if not over:
        raise ValueError("over names no axis; give at least one, such as over={'law.a': np.linspace(3, 6, 50)}")
    axes = {key: np.atleast_1d(finite(key, values)) for key, values in over.items()}
    for key, values in axes.items():
        if values.ndim != 1 or not len(values) or len(np.unique(values)) < len(values):
            raise ValueError(f'{key} must be a list of different numbers, not {shown(values.tolist())}')
    points = np.prod([len(values) for values in axes.values()], dtype=float)
    if points > MOST_POINTS:
        raise ValueError(f'over asks for {points:.3g} points, and at most {MOST_POINTS:g} are computed; take fewer values')
    return axes


def points_of(axes: Mapping[str, NDArray[np.float64]]) -> list[dict[str, float]]:
    """Every point of the grid, the last axis running fastest, as a dict from key to value."""
    return [dict(zip(axes, values, strict=True)) for values in product(*(values.tolist() for values in axes.values()))]


def unit_of(key: str) -> str:
    """The unit that the end of a scene's key tells, as 'N/m' of foundation.stiffness_N_per_m; '' if it tells none."""
    return next((unit for end, unit in UNITS.items() if re.search(f'{end}$', key)), '')
