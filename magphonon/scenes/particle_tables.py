"""Tables of particles as text: one row for each, in SI, with the unit in the name of every column."""

from __future__ import annotations

import csv
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from .. import units as u
from ..spelling import did_you_mean
from ..textfiles import MEGABYTE, table_text

if TYPE_CHECKING:
    from pathlib import Path

    from numpy.typing import NDArray

PLACES = 'x_m', 'y_m', 'z_m'
COLUMNS = (*PLACES, 'kind', 'held', 'mass_kg', 'strength', 'stiffness_N_per_m')
"""Allowed names of columns; x_m and y_m are required."""
MOST_BYTES = 100 * MEGABYTE
"""Largest size of a file of particles."""


def read_particles(path: Path) -> Atoms:
    """The particles of a table, without a cell.

    Parameters
    ----------
    path : Path
        Text with a header of `COLUMNS`, separated by commas; lines that begin with # are comments.

    Returns
    -------
    ase.Atoms
        In mm and g, with the kinds as tags, what is held by FixAtoms, and where the table has them the arrays 'strength' and
        'stiffness' (N/mm).

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is no such table; the message says what and where.
    """
    columns = _columns(path)
    n = len(columns['x_m'])
    places = np.stack([columns.get(name, np.zeros(n)) for name in PLACES], axis=1) * u.m
    atoms = Atoms(['Nd'] * n, positions=places)
    if 'mass_kg' in columns:
        atoms.set_masses(columns['mass_kg'] * u.kg)  # pyright: ignore[reportArgumentType]  ASE declares text
    if 'kind' in columns:
        atoms.set_tags(columns['kind'].astype(int))
    if 'held' in columns and columns['held'].any():
        atoms.set_constraint(FixAtoms(mask=columns['held'] == 1))
    if 'strength' in columns:
        atoms.set_array('strength', columns['strength'])
    if 'stiffness_N_per_m' in columns:
        atoms.set_array('stiffness', columns['stiffness_N_per_m'] * u.N / u.m)
    return atoms


def _columns(path: Path) -> dict[str, NDArray[np.float64]]:
    lines = table_text(path, MOST_BYTES).splitlines()
    rows = [(number, [cell.strip() for cell in row]) for number, row in enumerate(csv.reader(lines), 1)
            if row and not row[0].lstrip().startswith('#')]
    if len(rows) < 2:
        raise ValueError(f'{path} holds no particles; it begins with a header such as x_m,y_m,kind,held,mass_kg')
    names = rows[0][1]
    for name in names:
        if name not in COLUMNS:
            raise ValueError(f'{path}: a table of particles has no column {name!r}'
                             + did_you_mean(name, COLUMNS, f'its columns may be {", ".join(COLUMNS)}'))
    if len(set(names)) < len(names) or not {'x_m', 'y_m'} <= set(names):
        raise ValueError(f'{path} needs the columns x_m and y_m, each once, not {", ".join(names)}')
    table = np.array([_numbers(path, number, cells, names) for number, cells in rows[1:]])
    return {name: _checked(path, name, column) for name, column in zip(names, table.T, strict=True)}


def _numbers(path, number, cells, names):
    try:
        row = [float(cell) for cell in cells]
    except ValueError:
        row = []
    if len(row) != len(names) or not all(map(isfinite, row)):
        raise ValueError(f'{path}, line {number}: {",".join(cells)[:60]!r} is not {len(names)} numbers')
    return row


def _checked(path, name, column):
    wrong, must = {
        'kind': (column != np.round(column), 'be a whole number'),
        'held': ((column != 0) & (column != 1), 'be 0 or 1'),
        'mass_kg': (column <= 0, 'be positive'),
        'stiffness_N_per_m': (column < 0, 'not be negative'),
    }.get(name, (np.zeros(len(column), bool), ''))
    for k in np.flatnonzero(wrong)[:1]:
        raise ValueError(f'{path}: {name} of particle {k + 1} must {must}, not {column[k]:g}')
    return column
