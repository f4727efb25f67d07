"""Tables of text: a row for each sample, columns named with their units (time_s, x_mm, f_N); messages name file and line.

Every table that a user may write is read here: forces, particles, scans, places of points, ridges.  Which columns such a table
has, and which values they may take, stands beside its user.  Rows are taken as they are, in any order and repeated.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from os import PathLike
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import units as u
from .errors import did_you_mean, shown
from .files import MEGABYTE, refuse_endless

LENGTH = {'m': u.m, 'mm': u.mm, 'um': 1e-3 * u.mm, 'nm': 1e-6 * u.mm}
TIME = {'s': u.s, 'ms': u.ms, 'us': 1e-3 * u.ms}
FORCE = {'N': u.N, 'mN': 1e-3 * u.N, 'uN': 1e-6 * u.N}
MASS = {'kg': u.kg, 'g': u.g, 'mg': 1e-3 * u.g}
SPEED = {f'{length}_per_{time}': x / t for length, x in LENGTH.items() for time, t in TIME.items()}
STIFFNESS = {f'{force}_per_{length}': f / x for force, f in FORCE.items() for length, x in LENGTH.items()}
FREQUENCY = {'Hz': 2 * np.pi * u.Hz, 'kHz': 2 * np.pi * u.kHz}  # an angular frequency in rad/ms
AREA = {'m2': u.m**2, 'mm2': u.mm**2}
ANGLE = {'rad': 1.0}
PURE = {'': 1.0}
TEXT: dict[str, float] = {}
"""Units of a column of words."""
MOST_BYTES = 100 * MEGABYTE
"""Largest size of a table: two million lines, read in about ten seconds."""
SEPARATORS = '\t;, '  # between cells; beside another one, commas are decimal commas
NUMBER = re.compile(r'[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?', re.ASCII)
PLAIN = re.compile(r'[-+0-9.eE\n]*')  # letters of numbers: what `float` reads besides, such as 1_0, is no number of an instrument
BLOCK = 2**16
"""Number of rows that are held as text at a time."""


@dataclass(frozen=True)
class Table:
    """Columns of a table by the names of their quantities."""

    path: Any
    header: dict[str, str]  # the name of each column in the file
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
        """A column, or where the table lacks it a column of one value."""
        return self.columns.get(quantity, np.full(len(self), otherwise))

    def refuse(self, quantity: str, wrong: NDArray[np.bool_], must: str) -> None:
        """Raise ValueError for the first row of this column, if the table has it, where `wrong`: it `must` be otherwise."""
        for k in np.flatnonzero(wrong)[:1] if quantity in self else ():
            value = self[quantity][k]
            told = f'{value / self.units[quantity]:g}' if self.units[quantity] else shown(value)
            raise ValueError(f'line {self.lines[k]} of {self.path}: {self.header[quantity]} must {must}, not {told}')


def read_table(path: str | PathLike[str], columns: Mapping[str, Mapping[str, float]], needed: Collection[str],
               blank: Collection[str] = (), others: bool = True, layout: str = '', most: int = MOST_BYTES) -> Table:
    """Read a table of text, of at most `most` bytes.

    Its header names the columns; it is the first line, or the comment (#) above the rows.  Columns are separated by commas,
    semicolons, tabs or spaces; beside another separator, or in quotation marks, numbers may have decimal commas.

    `columns` are the quantities that such a table may hold, with the units that may end their names: {'x': LENGTH} allows x_m and
    x_mm.  It must hold those that are `needed`; in those that may be `blank` an empty cell or nan gives NaN; without `others`
    columns of other names are refused.  `layout` says in messages what such a table looks like.
    """
    refuse_endless(path, most)
    layout = f'; {layout}' if layout else ''
    named = {f'{quantity}_{unit}'.rstrip('_'): (quantity, factor) for quantity, units in columns.items()
             for unit, factor in (units or {'': 0.0}).items()}
    try:
        with open(path, encoding='utf-8-sig') as file:
            lines = [(n, line.strip(' \r\n')) for n, line in enumerate(file, 1) if line.strip(' \t;,\r\n')]
        names, separator, rows = _divided(path, lines, lambda names: {*needed} <= {named.get(name, ('',))[0] for name in names})
    except UnicodeDecodeError:
        raise ValueError(f'{path} is not a text file; export it as CSV') from None
    except csv.Error as error:
        raise ValueError(f'{path} is no table of text ({error}); export it as CSV') from None
    places: dict[str, int] = {}
    for k, name in enumerate(names):
        quantity = named[name][0] if name in named else _passed_over(path, name, columns, others, layout)
        if quantity in places:
            raise ValueError(f'{path}: the columns {shown(names[places[quantity]])} and {shown(name)} say the same; keep one of '
                             'them')
        if quantity is not None:
            places[quantity] = k
    for quantity in needed:
        if quantity not in places:
            example = next(name for name, (one, _) in named.items() if one == quantity)
            raise ValueError(f'{path} lacks the column {example} (its header is {shown(",".join(names))}){layout}')
    if not rows:
        raise ValueError(f'{path} holds no rows below its header{layout}')
    header = {quantity: names[k] for quantity, k in places.items()}
    units = {quantity: named[name][1] for quantity, name in header.items()}
    parts: dict[str, list[Any]] = {quantity: [] for quantity in places}
    signs: set[str] = set()
    for start, cells in _blocks(path, rows, names, separator):
        for quantity, k in places.items():
            words = [cell.strip() for cell in cells[k :: len(names)]]
            parts[quantity].append(_numbers(path, rows[start:], header[quantity], words, quantity in blank, signs)
                                   if units[quantity] else words)
    with np.errstate(over='ignore'):
        values = {quantity: np.concatenate(part) * units[quantity] if units[quantity] else np.concatenate(part)
                  for quantity, part in parts.items()}
    table = Table(path, header, units, values, np.array([n for n, _ in rows]))
    for quantity in (quantity for quantity in places if units[quantity]):
        table.refuse(quantity, np.isinf(table[quantity]), 'be a number of a size that can be')
    return table


def _divided(path, lines, is_header):
    rows = [(n, line) for n, line in lines if not line.startswith('#')]
    headers = [(n, _names(line.lstrip('# '))) for n, line in lines if line.startswith('#')]
    headers = [(n, names) for n, names in headers if is_header(names[0])]
    if rows and (not headers or is_header(_names(rows[0][1])[0])):
        n, line = rows.pop(0)
        headers = sorted([*headers, (n, _names(line))])
    for n, (names, _) in headers:
        if names != headers[0][1][0]:
            raise ValueError(f'line {n} of {path}: {shown(",".join(names))} names other columns or units than the header before '
                             'it; keep one of them')
    if not headers:
        raise ValueError(f'{path} is empty')
    return *headers[0][1], rows


def _names(line):
    sign = next((sign for sign in SEPARATORS if sign in line), ',')
    return [name.strip().replace('µ', 'u').replace('μ', 'u') for name in _cells(line, sign)], sign


def _cells(line, sign):
    return next(csv.reader([line], delimiter=sign, skipinitialspace=True))


def _passed_over(path, name, columns, others, layout):
    """None for a column of another name; ValueError where such are not wanted, or where it only says no unit that is known."""
    meant = max((q for q in columns if columns[q] and (name == q or name.startswith(f'{q}_'))), key=len, default=None)
    if meant is not None:
        allowed = [f'{meant}_{unit}'.rstrip('_') for unit in columns[meant]]
        raise ValueError(f'{path}: the column {shown(name)} says no unit that is known; write {", ".join(allowed[:4])}')
    if not others:
        known = [f'{q}_{unit}'.rstrip('_') for q, units in columns.items() for unit in units]
        raise ValueError(f'{path}: such a table has no column {shown(name)}' + (did_you_mean(name, known) or layout))


def _blocks(path, rows, names, separator):
    """The cells of up to BLOCK rows at a time, one row after the other, and the place of the first."""
    cells, start, first, count = [], 0, rows[0][1], len(names)
    try:
        sign = next((sign for sign in separator + SEPARATORS if sign in first and len(_cells(first, sign)) == count), separator)
        reader = csv.reader((line for _, line in rows), delimiter=sign, skipinitialspace=True, strict=True)
        for done, row in enumerate(reader, 1):
            if reader.line_num != done:
                raise csv.Error('a quotation mark is not closed')
            if len(row) != count:
                why = '; decimal commas need semicolons between the cells' if sign == ',' and len(row) > count else ''
                raise csv.Error(f'it has {len(row)} values, not {count}: it was cut off or holds a stray separator{why}')
            cells += row
            if done == len(rows) or not done % BLOCK:
                yield start, cells
                cells, start = [], done
    except csv.Error as error:
        raise ValueError(f'line {rows[start + len(cells) // count][0]} of {path}: {error}; complete or delete it') from None


def _numbers(path, rows, name, cells, blank, signs):
    """The numbers in the cells of a column; `signs` collects decimal signs, of which a table has one."""
    missing = np.array([blank and cell.lower() in ('', 'nan') for cell in cells])
    text = '\n'.join('0' if lacking else cell for cell, lacking in zip(cells, missing, strict=True))
    signs |= {sign for sign in '.,' if sign in text}
    plain = text.replace(',', '.')
    try:
        if not PLAIN.fullmatch(plain):
            raise ValueError
        values = np.array(plain.split('\n'), float)
    except ValueError:
        k = next(k for k, cell in enumerate(cells) if not missing[k] and not NUMBER.fullmatch(cell.replace(',', '.')))
        raise ValueError(f'line {rows[k][0]} of {path}: {name} is {shown(cells[k])}, not a finite number') from None
    if len(signs) > 1:
        k = next(k for k, cell in enumerate(cells) if '.' in cell or ',' in cell)
        raise ValueError(f'line {rows[k][0]} of {path}: {name} is {shown(cells[k])}, and other numbers have the other decimal '
                         'sign; write all with a point, or all with a comma')
    values[missing] = np.nan
    return values


def in_columns(rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """Lines of a table to be read, the first `left` of its columns flush left, the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ['  '.join(f'{cell:{"<" if k < left else ">"}{widths[k]}}' for k, cell in enumerate(row)).rstrip() for row in rows]
