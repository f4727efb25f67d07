"""Scans in universal files: records of dataset 58 and places of dataset 15 or 2411, as vibrometers write them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from .. import units as u
from .scans import Samples

if TYPE_CHECKING:
    from os import PathLike

ENDINGS = '.uff', '.unv', '.uf', '.u58', '.bunv'
TIME_RESPONSES, TIME = (0, 1), (0, 17)
"""Function types and abscissa types of records over time, 0 for unknown."""
ORDINATES = {8: 'displacement', 11: 'velocity'}
LABELS = {'m': u.m, 'mm': u.mm, 'um': 1e-3 * u.mm, 'µm': 1e-3 * u.mm, 'nm': 1e-6 * u.mm, 'm/s': u.m / u.s, 'mm/s': u.mm / u.s,
          'um/s': 1e-3 * u.mm / u.s, 'µm/s': 1e-3 * u.mm / u.s}
AXES = {0: '', 1: 'x', 2: 'y', 3: 'z'}


def read_universal(path: str | PathLike[str]) -> tuple[dict[str, Samples], bool]:
    """Samples of each point of a universal file, by its number, and whether they are velocities.

    A label of the ordinate such as mm/s tells its unit; without one lengths are those of dataset 164, and in m without it.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or holds no displacements or velocities over time.
    """
    sets = _sets(path)
    metre = next((one['length'] for one in sets if one['type'] == 164), 1.0)  # so many units of the file are one metre
    places = {}
    for nodes in (one for one in sets if one['type'] in (15, 2411)):
        numbers = np.atleast_1d(nodes['node_nums']).astype(int)
        places |= {str(n): (x * u.m / metre, y * u.m / metre) for n, x, y in zip(numbers, *(
            np.atleast_1d(nodes[axis]).tolist() for axis in 'xy'), strict=True)}
    records = [one for one in sets if one['type'] == 58]
    over_time = [one for one in records if one['func_type'] in TIME_RESPONSES and one['abscissa_spec_data_type'] in TIME]
    kinds = {ORDINATES.get(one['ordinate_spec_data_type']) for one in over_time}
    if len(kinds) != 1 or None in kinds:
        types = sorted({one['func_type'] for one in records})
        what = (f'its functions are of the types {types}, and records over time are 1' if records and not over_time else
                'its records are of several kinds, or of none of these' if over_time else 'it has no dataset 58')
        raise ValueError(f'{path} holds no displacements or velocities over time ({what}); export time records of one of the two')
    own = u.m / metre / (u.s if kinds == {'velocity'} else 1)
    found: dict[str, dict[str, Any]] = {}
    for one in over_time:
        axis = AXES.get(abs(int(one['rsp_dir'])))
        if axis is None:
            raise ValueError(f'{path}: node {one["rsp_node"]} is measured in the direction {one["rsp_dir"]}, a rotation; export '
                             'translations')
        unit = LABELS.get(str(one.get('ordinate_axis_units_lab', '')).strip(), own)
        point = found.setdefault(str(int(one['rsp_node'])), {})
        if axis in point:
            raise ValueError(f'{path} holds two records of node {one["rsp_node"]} in the direction {one["rsp_dir"]}; keep one')
        point[axis] = np.asarray(one['x'], float) * u.s, np.real(one['data']) * unit * (-1 if one['rsp_dir'] < 0 else 1)
    _refuse_unlike(path, found)
    return {name: Samples(next(iter(point.values()))[0], {axis: values for axis, (_, values) in point.items()}, places.get(name))
            for name, point in found.items()}, kinds == {'velocity'}


def _sets(path):
    """The datasets of a universal file, as dicts of pyuff."""
    try:
        import pyuff
    except ImportError:
        raise ValueError(f"{path} is a universal file, which pyuff reads; install it with pip install 'magphonon[vibrometer]', "
                         'or export the scan as CSV') from None
    try:
        sets = pyuff.UFF(str(path)).read_sets()
    except OSError:
        raise
    except Exception as error:  # pyuff fails on other files in many ways
        raise ValueError(f'{path} is no universal file that pyuff reads ({type(error).__name__}: {error}); export it again, '
                         'or as CSV') from None
    return [sets] if isinstance(sets, dict) else list(sets)


def _refuse_unlike(path, found):
    """Raise ValueError unless all points have the same components, each at the same times."""
    parts = max((tuple(point) for point in found.values()), key=len)
    for name, point in found.items():
        if set(point) != set(parts):
            raise ValueError(f'{path}: node {name} was measured along {", ".join(point)} and others along {", ".join(parts)}; '
                             'export one direction, or the same for each node')
        first, *others = (times for times, _ in point.values())
        if any(len(times) != len(first) or not np.array_equal(times, first) for times in others):
            raise ValueError(f'{path}: the directions of node {name} were recorded at different times; export one direction')
