"""Universal files: datasets as pyuff reads them, refused where the directions or the ends of their records are not certain."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from contextlib import redirect_stdout
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from . import units as u
from .errors import shown
from .quantities import named_unit

END = re.compile(rb'    -1 *\r?(?:\n|$)')  # begins and ends a dataset; behind binary numbers it does not begin a line
NODES, UNITS, FUNCTION = (15, 2411), 164, 58  # types of datasets
NO_FUNCTIONS = 'holds no transfer functions'  # words of the error for a file of records over time
AXES = 18, 2420  # of nodes whose directions are their own


def read_datasets(path: str | PathLike[str]) -> list[dict[str, Any]]:
    """The datasets of a universal file; ValueError if the file was cut off, or a node has axes of its own."""
    import pyuff

    if len(END.findall(Path(path).read_bytes())) % 2:  # pyuff would leave the last dataset out
        raise ValueError(f'{path} ends within a dataset; copy or export it again')
    with redirect_stdout(StringIO()):  # pyuff prints what it does not expect
        file = pyuff.UFF(str(path))
        sets: list[Any] = [file.read_sets(k) for k in range(file.get_n_sets())]
    for one in sets:
        if one['type'] == FUNCTION and len(one['data']) != one['num_pts']:
            raise ValueError(f'{path}: the function of node {one["rsp_node"]} has {len(one["data"])} of its {one["num_pts"]} '
                             'values; export it again')
    _refuse_turned(path, sets)
    return sets


def _refuse_turned(path, sets):
    """Raise ValueError if nodes measure along axes of their own."""
    systems = np.unique([number for one in sets if one['type'] in NODES for number in np.atleast_1d(one['disp_cs'])] or [0])
    if len(systems) > 1 or (systems[0] and {one['type'] for one in sets}.intersection(AXES)):
        raise ValueError(f'{path} gives nodes axes of their own (dataset 18); export it with the axes of the whole structure')


def node_places(path: Any, sets: Sequence[Mapping[str, Any]]) -> tuple[float, dict[int, tuple[float, float]]]:
    """How many units of length of a file are one metre, and x and y of its nodes in mm."""
    metre = next((one['length'] for one in sets if one['type'] == UNITS), 1.0)
    places = {}
    for one in (one for one in sets if one['type'] in NODES):
        numbers, x, y = (np.atleast_1d(one[name]) for name in ('node_nums', 'x', 'y'))
        if not (len(numbers) == len(x) == len(y) and 1e-9 < metre < 1e12 and (abs(np.r_[x, y]) < 1e6 * metre).all()):
            raise ValueError(f'{path}: positions and units of its nodes (datasets {one["type"]} and 164) contradict each other; '
                             'export it again')
        places |= {int(n): (a * u.m / metre, b * u.m / metre)
                   for n, a, b in zip(numbers, x.tolist(), y.tolist(), strict=True)}
    return metre, places


def unit_of_label(path: Any, dataset: Mapping[str, Any], axis: str, units: Mapping[str, float], otherwise: float) -> float:
    """The unit of an axis of a function, according to its label; `otherwise` if it has no label."""
    label = str(dataset.get(f'{axis}_axis_units_lab') or '').strip()
    if label.upper() in ('', 'NONE'):
        return otherwise
    if (name := named_unit(label, units)) is None:
        known = ', '.join(name.replace('_per_', '/') for name in [*units][1:5])
        raise ValueError(f'{path}, node {dataset["rsp_node"]}: {shown(label)} is no known unit of such data; export it in SI, or '
                         f'in {known}')
    return units[name]
