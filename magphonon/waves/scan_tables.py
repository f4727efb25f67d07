"""Scans as tables of text: one sample a row, quantities and units by the names of the columns."""

from __future__ import annotations

import csv
import re
from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..textfiles import MEGABYTE, refuse_endless, table_text, told_as_table
from .scans import Samples, Scan, assembled
from .vibrometer import MOST_BYTES

if TYPE_CHECKING:
    from os import PathLike

LENGTHS = {'m': u.m, 'mm': u.mm, 'um': 1e-3 * u.mm, 'nm': 1e-6 * u.mm}
TIMES = {'s': u.s, 'ms': u.ms, 'us': 1e-3 * u.ms}
NAMES = ('particle', 'point', 'node')
"""Allowed names of the column that numbers the points."""
LAYOUT = ('a scan has the columns time_s, then particle (or point) or x_m,y_m, then u_x_m, u_y_m or u_m (or v_y_m_per_s and '
          'so on); lengths in m, mm, um or nm and times in s, ms or us, as the header says')


def read_scan(path: str | PathLike[str]) -> Scan:
    r"""Read a scan from a table of text (.csv) or a universal file (.uff, .unv, .u58, as vibrometers write them).

    Parameters
    ----------
    path : path-like
        A table has a column `time_s`; `particle`, `point` or `node` with the names of the points, or `x_m` and `y_m`, or both;
        and `u_x_m`, `u_y_m` for displacements or `v_x_m_per_s`, `v_y_m_per_s` for velocities, one component or both; `u_m` or
        `v_m_per_s` for an unknown direction.  Other units go by the header: `u_y_um`, `v_y_mm_per_s`, `time_ms`, `x_mm`.
        Samples come in any order; blank ones and other columns are passed over.

    Returns
    -------
    Scan
        Equal times, displacements, without dead points; its notes say what was done for that.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is no such file; the message says what, where, and how to mend it.

    Examples
    --------
    >>> import tempfile
    >>> from magphonon.waves import read_scan
    >>> file = tempfile.mkdtemp() + '/scan.csv'
    >>> rows = [f'{t},{x},{t * x}' for t in range(4) for x in (10, 20)]
    >>> with open(file, 'w') as table:
    ...     _ = table.write('\n'.join(['time_ms,x_mm,u_y_um', *rows]))
    >>> scan = read_scan(file)
    >>> scan.places.tolist(), scan.motions['y'].shape
    ([[10.0, 0.0], [20.0, 0.0]], (4, 2))
    """
    from .universal_files import ENDINGS, read_universal

    refuse_endless(path, MOST_BYTES)
    points, velocities = read_universal(path) if str(path).lower().endswith(ENDINGS) else _points(path)
    return assembled(path, points, velocities)


def read_places(path: str | PathLike[str]) -> dict[str, tuple[float, float]]:
    r"""Places of points from a table with the columns particle (or point) and x_m, y_m (or in mm, um): x and y in mm by name.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is no such table.

    Examples
    --------
    >>> import tempfile
    >>> from magphonon.waves import read_places
    >>> file = tempfile.mkdtemp() + '/points.csv'
    >>> with open(file, 'w') as table:
    ...     _ = table.write('point,x_mm,y_mm\nA1,0,0\nA2,10,0\n')
    >>> read_places(file)
    {'A1': (0.0, 0.0), 'A2': (10.0, 0.0)}
    """
    lines = table_text(path, 100 * MEGABYTE).splitlines()
    header, rows = _rows(path, lines)
    columns = _columns(path, header)
    if 'name' not in columns or 'x' not in columns:
        raise ValueError(f'{path} must name each point and its place in the columns particle (or point), x_m and y_m; its header '
                         f'is {",".join(header)!r}')
    found = {}
    for line, row in rows:
        name, (x, y) = row[columns['name'][0]].strip(), _place(path, line, row, header, columns)
        if found.setdefault(name, (x, y)) != (x, y):
            raise ValueError(f'line {line} of {path}: point {name} stands there twice, at different places')
    return found


def _points(path) -> tuple[dict[str, Samples], bool]:
    """Samples of each point of a table, and whether they are velocities."""
    with open(path, encoding='utf-8-sig', newline='') as file, told_as_table(path):
        header, rows = _rows(path, file)
        columns = _columns(path, header)
        parts = _components(path, header, columns)
        samples: dict[str, list[list[float]]] = {}
        places = {}
        for line, row in rows:
            place = _place(path, line, row, header, columns) if 'x' in columns else None
            name = row[columns['name'][0]].strip() if 'name' in columns else '({:g} mm, {:g} mm)'.format(*place or ())
            if places.setdefault(name, place) != place:
                raise ValueError(f'line {line} of {path}: point {name} stands at another place than before; give each '
                                 'point its own name')
            samples.setdefault(name, []).append([_number(path, line, row, header, columns['time']), *(
                _number(path, line, row, header, columns[part], blank=True) for part in parts)])
    if not samples:
        raise ValueError(f'{path} holds no samples below its header')
    points = {}
    for name, found in samples.items():
        time, *motions = np.array(found).T
        points[name] = Samples(time, {part[2:]: motion for part, motion in zip(parts, motions, strict=True)}, places[name])
    return points, parts[0][0] == 'v'


def _rows(path, lines):
    """The header of a table and its rows with the numbers of their lines, without comments and blank lines."""
    kept = ((n, line) for n, line in enumerate(lines, 1) if line.strip() and not line.lstrip().startswith('#'))
    _, first = next(kept, (0, ''))
    if not first.strip():
        raise ValueError(f'{path} is empty; {LAYOUT}')
    comma = next((sign for sign in '\t;' if sign in first), ',')
    header = [name.strip() for name in next(csv.reader([first], delimiter=comma))]

    def each():
        for n, line in kept:
            row = next(csv.reader([line], delimiter=comma))
            if len(row) != len(header):
                raise ValueError(f'line {n} of {path} has {len(row)} values, not {len(header)}; '
                                 'it was cut off or holds a stray comma: complete or delete it')
            yield n, row

    return header, each()


def _columns(path, header: list[str]) -> dict[str, tuple[int, float]]:
    """Number and unit of each column that a scan may have: 'time', 'name', 'x', 'y', 'u_x', 'v_y' and so on."""
    found: dict[str, tuple[int, float]] = {}
    for k, name in enumerate(header):
        key, unit = ('name', 1.0) if name in NAMES else _quantity(name)
        if key is None:
            continue
        if unit is None:
            raise ValueError(f'{path}: the column {name!r} says no unit that is known; write {_example(key)}, with lengths in '
                             f'{", ".join(LENGTHS)} and times in {", ".join(TIMES)}')
        if key in found:
            raise ValueError(f'{path}: the columns {header[found[key][0]]!r} and {name!r} say the same; keep one of them')
        found[key] = k, unit
    return found


def _quantity(name: str) -> tuple[str | None, float | None]:
    """What a column holds and its unit in mm and ms; None for what is not known."""
    match = re.fullmatch(r'(time|x|y|[uv](?:_[xyz])?)(?:_(\w+))?', name)
    if match is None:
        return None, None
    key, unit = match.groups()
    if key == 'time':
        return key, TIMES.get(unit)
    if key[0] == 'v':
        length, _, per = (unit or '').partition('_per_')
        return key, LENGTHS[length] / TIMES[per] if length in LENGTHS and per in TIMES else None
    return key, LENGTHS.get(unit)


def _example(key):
    return {'time': 'time_s', 'v': f'{key}_m_per_s'}.get(key if key == 'time' else key[0], f'{key}_m')


def _components(path, header, columns):
    """The columns of the motion, all displacements or all velocities."""
    parts = [key for key in columns if key[0] in 'uv']
    there = {'time_s': 'time' in columns, 'particle or x_m,y_m': {'name', 'x'} & columns.keys(), 'u_x_m, u_y_m or u_m': parts}
    for lacking in (name for name, found in there.items() if not found):
        raise ValueError(f'{path} lacks the column {lacking} (its header is {",".join(header)!r}); {LAYOUT}')
    if len({(key[0], len(key)) for key in parts}) > 1:
        raise ValueError(f'{path} holds motion of several kinds ({", ".join(header[columns[key][0]] for key in parts)}); keep '
                         'displacements or velocities, with a direction or without')
    return parts


def _place(path, line, row, header, columns):
    return tuple(_number(path, line, row, header, columns[key]) if key in columns else 0.0 for key in 'xy')


def _number(path, line, row, header, column, blank=False):
    """One value in mm and ms; a blank one is NaN where that is allowed."""
    k, unit = column
    try:
        value = float(row[k]) if row[k].strip() or not blank else np.nan
    except ValueError:
        value = np.inf
    if np.isinf(value) or (np.isnan(value) and not blank):
        raise ValueError(f'line {line} of {path}: {header[k]} is {row[k].strip()!r}, not a finite number')
    return value * unit
