"""Tables: a row for each sample, columns named with their units (time_s, x [mm], Kraft in N); messages name file and line.

Every table that a user may write is read here: forces, particles, scans, places of points, ridges.  Which columns such a table
has, and which values they may take, is defined in the module that uses it. Rows may be in any order and repeated.
"""

from __future__ import annotations

import csv
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .errors import shown
from .files import MEGABYTE
from .headers import NUMBER, Asked, Heading, divided, split
from .readers import content

MOST_BYTES = 100 * MEGABYTE
"""Largest size of a table: two million lines."""


@dataclass(frozen=True)
class Table:
    """Columns of a table by the names of their quantities; those of single points have names that begin with '*'."""

    path: Any
    told: dict[str, Heading]  # what the header says of each column
    units: dict[str, float]  # the unit of each column in mm, g, ms; zero for words
    columns: dict[str, NDArray[Any]]  # shape (rows,): numbers in mm, g, ms, or words
    lines: NDArray[np.int_]  # shape (rows,): the line of each row in the file

    def __contains__(self, quantity: object) -> bool:
        return quantity in self.columns

    def __getitem__(self, quantity: str) -> NDArray[Any]:
        return self.columns[quantity]

    def __len__(self) -> int:
        return len(self.lines)

    def get(self, quantity: str, otherwise: Any) -> NDArray[Any]:
        """A column of the table; if the table lacks it, a column filled with the value `otherwise`."""
        return self.columns.get(quantity, np.full(len(self), otherwise))

    def named(self, *quantities: str) -> str:
        """The names of columns in the file, for messages."""
        return ', '.join(self.told[quantity].name for quantity in quantities)

    def refuse(self, quantity: str, wrong: NDArray[np.bool_], must: str) -> None:
        """Raise ValueError for the first row of this column, if any, where `wrong` is true; `must` says what it should be."""
        for k in np.flatnonzero(wrong)[:1] if quantity in self else ():
            value = self[quantity][k]
            told = f'{value / self.units[quantity]:g}' if self.units[quantity] else shown(value)
            raise ValueError(f'line {self.lines[k]} of {self.path}: {self.named(quantity)} must {must}, not {told}')


def read_table(path: str | PathLike[str], columns: Mapping[str, Mapping[str, float]], needed: Collection[str | tuple[str, ...]],
               blank: Collection[str] = (), others: bool = True, layout: str = '', most: int = MOST_BYTES,
               points: Mapping[str, float] | None = None, held: Any = None) -> Table:
    """Read a table of at most `most` bytes.

    `columns` are the quantities that the table may hold, with their units: {'x': LENGTH} allows x_m and x [mm].  Each entry of
    `needed` is a required column, or a tuple of which one is required.  An empty cell or nan in a `blank` column gives NaN.
    Other names are refused unless `others`; in a unit of `points`, such a column belongs to one point and is called '*name'.
    `layout` tells users what the table should look like; `held` is the content of the file, if it is already known.
    """
    layout = layout and f'; {layout}'
    asked = Asked(columns, needed, points or {})
    text = content(path, most) if held is None else held
    if not isinstance(text, str):
        raise ValueError(f'{path} holds records of an instrument and no table{layout}')
    heads, sign, rows = divided(path, text, asked)
    told = asked.by_quantity(path, heads, others, layout)
    if not rows:
        raise ValueError(f'{path} holds no rows below its header{layout}')
    units, cells = {q: asked.size(head) for q, head in told.items()}, _cells(path, rows, sign, heads, told)
    values, signs = {}, set()
    for q, unit in units.items():
        may = q in blank or q.startswith('*')
        with np.errstate(over='ignore'):
            values[q] = _numbers(path, told[q].name, cells[q], rows, may, signs) * unit if unit else np.array(cells[q])
    table = Table(path, told, units, values, np.array([n for n, _ in rows]))
    for q in filter(units.get, units):
        table.refuse(q, np.isinf(values[q]), 'be a finite number')
    return table


def _cells(path, rows, sign, heads, told):
    """The words in the column of each quantity."""
    places, kept = {q: heads.index(head) for q, head in told.items()}, []
    reader = csv.reader((line for _, line in rows), delimiter=_separator(rows[0][1], sign, len(heads)), skipinitialspace=True,
                        strict=True)
    try:
        for row in reader:
            if reader.line_num > len(kept) + 1:
                raise csv.Error('a quotation mark is not closed')
            if len(row) <= max(places.values()) or any(row[len(heads) :]):
                raise csv.Error(f'it has {len(row)} values, not {len(heads)}: it was cut off, or holds a stray separator or '
                                'decimal comma')
            kept.append(row)
    except csv.Error as error:
        raise ValueError(f'line {rows[len(kept)][0]} of {path}: {error}; complete or delete it') from None
    return {q: [row[k].strip() for row in kept] for q, k in places.items()}


def _separator(first, sign, count):
    """What separates the cells of the rows: that of the header, or another that gives so many cells in the `first` row."""
    signs = [one for one in (sign, *'\t;, ') if one in first]
    return next((one for one in signs if len(split(first, one)) == count), [*signs, ','][0])


def _numbers(path, name, cells, rows, blank, signs):
    """The numbers in a column; `signs` collects the decimal signs, because a table may use only one."""
    for cell, (n, _) in zip(cells, rows, strict=True):
        if not NUMBER.fullmatch(cell) and not (blank and cell.lower() in ('', 'nan')):
            raise ValueError(f'line {n} of {path}: {name} is {shown(cell)}, not a finite number')
    signs |= {sign for sign in '.,' if any(sign in cell for cell in cells)}
    if len(signs) > 1:
        raise ValueError(f'{path}: {name} and the columns before it have decimal points and decimal commas; write all numbers '
                         'with a point, or all with a comma')
    return np.array([float(cell.replace(',', '.') or 'nan') for cell in cells])


def in_columns(rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """Lines of a table for display, with its first `left` columns flush left and the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ['  '.join(f'{cell:{"<" if k < left else ">"}{widths[k]}}' for k, cell in enumerate(row)).rstrip() for row in rows]
