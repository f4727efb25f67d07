"""Scans as files: tables of text, one sample a row, and universal files, as vibrometers write them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from os import PathLike
from typing import Any

import numpy as np

from .. import units as u
from ..dynamics.motion import Motion
from ..errors import shown
from ..files import MEGABYTE, refuse_overflow, whole_file
from ..quantities import FORCE, LENGTH, SPEED, TEXT, TIME
from ..readers import content
from ..tables import Table, read_table
from ..universal import node_places, unit_of_label
from .scans import Samples, Scan, assembled

MOST_BYTES = 500 * MEGABYTE  # largest size of a scan; a row of 100 particles over 10 000 frames has 50 MB
NAMES = dict.fromkeys(('particle', 'point', 'node'), TEXT)  # allowed names of the column that numbers the points
MOTIONS = {f'{kind}{axis}': unit for kind, unit in (('u', LENGTH), ('v', SPEED)) for axis in ('', '_x', '_y', '_z')}
LAYOUT = ('a scan has the columns time_s, then particle (or point) or x_m,y_m, then u_x_m, u_y_m or u_m (or v_y_m_per_s and '
          'so on), or time_s and a column for each point with its unit, as Point 17 [mm/s]; '
          'lengths in m, mm, um or nm and times in s, ms or us, as in the header')
ASKED = {'columns': {'time': TIME, 'x': LENGTH, 'y': LENGTH, 'f': FORCE} | NAMES | MOTIONS, 'needed': ['time'], 'blank': MOTIONS,
         'layout': LAYOUT, 'points': LENGTH | SPEED}
COLUMN = re.compile(r'(?:(?:[uv]?_?([xyz])|[uv])(?:[ _-]+|(?=\d)))?(.+?)(?:[ _-]([xyz]))?', re.IGNORECASE)
"""The name of a column of one point: its direction before or behind it, as u_y 17, Vy 17, y17, Point 17 Y."""
WORD = re.compile(r'^[^\W\d_]+[ _#.-]*(?=\d)')  # before the number of a point, such as Point
HEADER = 'time_s', 'particle', 'u_x_m', 'u_y_m'
TIME_RESPONSES, ABSCISSAS = (0, 1), (0, 17)  # function types and abscissa types of records over time, 0 for unknown
ORDINATES = {8: 'displacement', 11: 'velocity'}
QUANTITIES = {8: 'displacements', 9: 'forces', 11: 'velocities', 12: 'accelerations', 13: 'forces'}
AXIS = {17: 'time', 18: 'frequency'}  # of a function
AXES = {0: '', 1: 'x', 2: 'y', 3: 'z'}


def read_scan(path: str | PathLike[str]) -> Scan:
    r"""Read a scan from a table of text (.csv) or a universal file (.uff, .unv, .u58, as vibrometers write them).

    Parameters
    ----------
    path : path-like
        A table has a column `time_s`; `particle`, `point` or `node` with the names of the points, or `x_m` and `y_m`, or both;
        and `u_x_m`, `u_y_m` for displacements or `v_x_m_per_s`, `v_y_m_per_s` for velocities, one component or both; `u_m` or
        `v_m_per_s` for an unknown direction.  Other units follow from the header: `u_y_um`, `v_y_mm_per_s`, `time_ms`, `x_mm`.
        Samples may come in any order; blank samples and other columns are ignored.

    Returns
    -------
    Scan
        Displacements at equal times, without dead points; its notes say what was done to the record.

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
    found = content(path, MOST_BYTES)
    points, velocities = _of_records(path, found) if isinstance(found, list) else _points(path, found)
    return assembled(path, points, velocities)


def write_scan(path: str | PathLike[str], motion: Motion) -> None:
    """Write the motion of particles in a plane as a table in SI, to the last digit; whole or not at all.

    Its columns are time_s, particle, u_x_m and u_y_m.

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from magphonon.dynamics import Motion
    >>> from magphonon.waves import read_scan, write_scan
    >>> file = tempfile.mkdtemp() + '/scan.csv'
    >>> motion = Motion(np.arange(5.0), np.array([3, 4]), 1e-3 * np.arange(20.0).reshape(5, 2, 2))
    >>> write_scan(file, motion)
    >>> read_scan(file).names
    ('3', '4')
    """
    t, moved = motion.times / u.s, motion.displacements / u.m
    refuse_overflow(path, {'time_s': t, 'u_x_m and u_y_m': moved})
    with whole_file(path) as file:
        print(*HEADER, sep=',', file=file)
        particles = motion.particles.tolist()
        for time, frame in zip(t.tolist(), moved.tolist(), strict=True):
            file.writelines(f'{time},{particle},{x},{y}\n' for particle, (x, y) in zip(particles, frame, strict=True))


def read_places(path: str | PathLike[str]) -> dict[str, tuple[float, float]]:
    r"""Read x and y of points in mm, by name, from a table with the columns particle (or point) and x_m, y_m (or in mm, um).

    Examples
    --------
    >>> import tempfile
    >>> from magphonon.waves.scan_tables import read_places
    >>> file = tempfile.mkdtemp() + '/points.csv'
    >>> with open(file, 'w') as table:
    ...     _ = table.write('point,x_mm,y_mm\nA1,0,0\nA2,10,0\n')
    >>> read_places(file)
    {'A1': (0.0, 0.0), 'A2': (10.0, 0.0)}
    """
    table = read_table(path, NAMES | {'x': LENGTH, 'y': LENGTH}, ['x'])
    names = _names(table)
    if names is None:
        raise ValueError(f'{path} must have the columns particle (or point), x_m and y_m: name and position of each point')
    found = {}
    for line, name, *place in zip(table.lines, names.tolist(), table['x'].tolist(), table.get('y', 0.0).tolist(), strict=True):
        if found.setdefault(name, tuple(place)) != tuple(place):
            raise ValueError(f'line {line} of {path}: point {name} has two different places')
    return found


def _names(table: Table) -> Any:
    """The column that names the points, if there is one; ValueError for positions and times too large for a laboratory."""
    for name, unit, most in (('x', u.m, '1e6 m'), ('y', u.m, '1e6 m'), ('time', u.s, '1e6 s')):
        table.refuse(name, abs(table.get(name, 0.0)) > 1e6 * unit, f'lie within {most}')
    columns = [name for name in NAMES if name in table]
    if len(columns) > 1:
        raise ValueError(f'{table.path}: the columns {" and ".join(columns)} say the same; keep one of them')
    return table[columns[0]] if columns else None


def _points(path, held) -> tuple[dict[str, Samples], bool]:
    """Samples of each point of a table, and whether they are velocities."""
    table = read_table(path, **ASKED, held=held)
    wide = [name for name in table.columns if name.startswith('*')]
    if 'f' in table:
        raise ValueError(f'{path} holds forces ({table.named("f")}) and is no scan; a table of forces is for "magphonon fit"')
    if len(wide) > 1 and not set(MOTIONS).intersection(table.columns):
        return _of_columns(table, wide)
    parts = _parts(table)
    return _by_point(table, parts), parts[0][0] == 'v'


def _parts(table) -> list[str]:
    """The columns of motion, all of displacements or all of velocities."""
    path, parts = table.path, [part for part in MOTIONS if part in table]
    if not parts:
        raise ValueError(f'{path} lacks the column u_x_m, u_y_m or u_m; {LAYOUT}')
    if len({(part[0], len(part)) for part in parts}) > 1:
        raise ValueError(f'{path} holds motion of several kinds ({table.named(*parts)}); keep displacements or velocities, with '
                         'a direction or without')
    for part in parts:
        if np.isnan(table[part]).all():
            raise ValueError(f'{path}: the column {table.named(part)} holds no number; remove it, or export it again')
    return parts


def _by_point(table, parts) -> dict[str, Samples]:
    """Samples of each point of a table with one sample in each row, in the order in which the points first appear."""
    names, placed = _names(table), 'x' in table or 'y' in table
    places = np.stack([table.get('x', 0.0), table.get('y', 0.0)], axis=1)
    if names is None and not placed:
        raise ValueError(f'{table.path} lacks the column particle or x_m,y_m; {LAYOUT}')
    if names is None:
        names = np.array([f'({x:g} mm, {y:g} mm)' for x, y in places])
    _, of = np.unique(names, return_inverse=True)
    points = {}
    for rows in sorted(np.split(np.argsort(of, kind='stable'), np.cumsum(np.bincount(of))[:-1]), key=lambda rows: rows[0]):
        name = str(names[rows[0]])
        for row in rows[(places[rows] != places[rows[0]]).any(axis=1)][:1]:
            raise ValueError(f'line {table.lines[row]} of {table.path}: point {name} is at a different place than before; give '
                             'each point its own name')
        points[name] = Samples(table['time'][rows], {part[2:]: table[part][rows] for part in parts},
                                    tuple(places[rows[0]].tolist()) if placed else None)
    return points


def _of_columns(table: Table, wide: list[str]) -> tuple[dict[str, Samples], bool]:
    """Samples of a table with one column for each point: v_y 17 [mm/s], or Point 17 [mm/s] if the direction is not stated.

    A point is named by its number alone, unless two points share it, such as A1 and B1.
    """
    parts = [COLUMN.fullmatch(name[1:] or '-').groups(default='') for name in wide]  # pyright: ignore[reportOptionalMemberAccess]
    whole = [((before or behind).lower(), point) for before, point, behind in parts]
    short = [(axis, WORD.sub('', point)) for axis, point in whole]
    found: dict[str, dict[str, Any]] = {}
    for (axis, point), column in zip(short if len({*short}) == len(short) else whole, wide, strict=True):
        if axis in found.setdefault(point, {}):
            raise ValueError(f'{table.path}: {shown(table.named(column))} is a second column of the point {shown(point)}; rename '
                             'one of them')
        found[point][axis] = table['time'], table[column]
    kinds = {table.told[name].unit in SPEED for name in wide}
    if len(kinds) > 1:
        raise ValueError(f'{table.path} has columns of displacements and of velocities; keep those of one kind')
    return _alike(table.path, found, {}), kinds == {True}


def _of_records(path, sets) -> tuple[dict[str, Samples], bool]:
    """Samples of each point of datasets as pyuff reads them, by its number, and whether they are velocities.

    The label of the ordinate, such as mm/s, gives the unit. Without a label the unit of length is that of dataset 164, or else m.
    """
    metre, places = node_places(path, sets)
    records = _over_time(path, [one for one in sets if one['type'] == 58])
    speed = ORDINATES[records[0]['ordinate_spec_data_type']] == 'velocity'
    own, units = (u.m / u.s / metre, SPEED) if speed else (u.m / metre, LENGTH)
    found: dict[str, dict[str, Any]] = {}
    for one in records:
        node, axis = int(one['rsp_node']), AXES.get(abs(int(one['rsp_dir'])))
        if axis is None:
            raise ValueError(f'{path}: node {node} is measured in the direction {one["rsp_dir"]}, a rotation; export '
                             'translations')
        if places and node not in places:
            raise ValueError(f'{path}: node {node} is not in its geometry (datasets 15 and 2411); export it again')
        if axis in found.setdefault(str(node), {}):
            raise ValueError(f'{path} holds two records of node {node} in the direction {one["rsp_dir"]}; keep one')
        times = np.asarray(one['x'], float) * unit_of_label(path, one, 'abscissa', TIME, u.s)
        if not (abs(times) < 1e6 * u.s).all():
            raise ValueError(f'{path}: the times of node {node} reach {abs(times).max() / u.s:.3g} s; export them in s')
        sign = -1 if one['rsp_dir'] < 0 else 1
        found[str(node)][axis] = times, sign * np.real(one['data']) * unit_of_label(path, one, 'ordinate', units, own)
    return _alike(path, found, {str(node): place for node, place in places.items()}), speed


def _over_time(path, functions):
    """The functions that are records over time, all of displacements or all of velocities."""
    found = [one for one in functions if one['func_type'] in TIME_RESPONSES and one['abscissa_spec_data_type'] in ABSCISSAS]
    kinds = {ORDINATES.get(one['ordinate_spec_data_type'], '') for one in found}
    if kinds not in ({'displacement'}, {'velocity'}):
        what = ', '.join(sorted({f'{QUANTITIES.get(one["ordinate_spec_data_type"], "unknown quantities")} over '
                                 f'{AXIS.get(one["abscissa_spec_data_type"], "an unknown axis")} (type {one["func_type"]})'
                                 for one in functions})) or 'none'
        raise ValueError(f'{path} holds no displacements or velocities over time, and no transfer functions (type 4): its '
                         f'functions are {what}; export one of the three')
    return found


def _alike(path, found: Mapping[str, Mapping[str, Any]], places) -> dict[str, Samples]:
    """Samples of the points; ValueError unless all have the same components, each at the same times."""
    parts = max((tuple(point) for point in found.values()), key=len)
    for name, point in found.items():
        if set(point) != set(parts):
            raise ValueError(f'{path}: node {name} was measured along {", ".join(point)} and others along {", ".join(parts)}; '
                             'export one direction, or the same for each node')
        first, *others = (times for times, _ in point.values())
        if any(not np.array_equal(times, first) for times in others):
            raise ValueError(f'{path}: the directions of node {name} were recorded at different times; export one direction')
    return {name: Samples(next(iter(point.values()))[0], {axis: values for axis, (_, values) in point.items()}, places.get(name))
            for name, point in found.items()}
