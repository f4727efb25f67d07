"""Tables of text: a row for each sample, columns named with their units (time_s, x_mm, f_N); messages name file and line.

Every table that a user may write is read here: forces, particles, scans, places of points, ridges.  Which columns such a table
has, and which values they may take, is defined in the module that uses it. Rows may be in any order and repeated.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from io import StringIO
from os import PathLike
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from . import units as u
from .errors import did_you_mean, shown
from .files import MEGABYTE
from .readers import content

GRAVITY = 9.80665 * u.m / u.s**2
GRAM_FORCE = 1e-3 * u.kg * GRAVITY
LENGTH = {'m': u.m, 'mm': u.mm, 'um': 1e-3 * u.mm, 'nm': 1e-6 * u.mm, 'cm': 10 * u.mm, 'in': 25.4 * u.mm}
TIME = {'s': u.s, 'ms': u.ms, 'us': 1e-3 * u.ms}
FORCE = {'N': u.N, 'mN': 1e-3 * u.N, 'uN': 1e-6 * u.N, 'kN': 1e3 * u.N} | {
    name: grams * GRAM_FORCE for name, grams in (('gf', 1.0), ('g', 1.0), ('kgf', 1e3), ('mgf', 1e-3), ('lbf', 453.59237))}
"""Units of forces, including the gram of a balance, which is the weight of a gram."""
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
POINT = '*'  # begins the name of a column that is that of one point
BLOCK = 2**16
"""Number of rows that are held as text at a time."""
COMMENT = '#%'  # begins a line that is a comment
PREAMBLE = 200
"""Number of lines in which the header is sought: instruments write their settings above it."""
SEPARATOR = re.compile(r'"?sep=(.)"?', re.IGNORECASE)  # the line by which Excel is told the separator
BRACKETS = re.compile(r'(?P<name>.*?)\s*(?:\[(?P<a>[^][]*)\]|\((?P<b>[^()]*(?:\([^()]*\)[^()]*)?)\)'
                      r'|\s/\s*(?P<c>\S.*)|/(?P<d>[^][\s]+)|\sin\s(?P<e>\S+))')
"""A name with its unit: r [mm], r (mm), r / mm, r/mm, r in mm."""
DECIBELS = re.compile(r'dB(?:[ _](?:re[ _:.]*)?)?1?[ _]*(?P<unit>.*)', re.IGNORECASE)
WORDS = {
    'r': ('distance', 'abstand', 'd', 'separation', 'spacing', 'weg'), 'gap': ('spalt', 'luftspalt', 'clearance'),
    'f': ('force', 'kraft', 'load', 'last'), 'sigma': ('uncertainty', 'unsicherheit', 'std', 'standard_deviation', 'error'),
    'direction': ('richtung',), 'time': ('t', 'zeit'), 'frequency': ('f', 'freq', 'frequenz'), 'x': ('x_position', 'pos_x'),
    'y': ('y_position', 'pos_y'), 'point': ('punkt', 'index', 'point_index', 'messpunkt'),
    'u': ('displacement', 'weg', 'auslenkung'), 'v': ('velocity', 'geschwindigkeit', 'schnelle'),
    'amplitude': ('magnitude', 'betrag', 'mag'), 'phase': ('winkel',), 're': ('real', 'real_part', 'realteil'),
    'im': ('imag', 'imaginary', 'imaginary_part', 'imaginaerteil', 'imaginärteil'),
    'drive': ('force', 'kraft', 'hammer'), 'mass': ('masse',),
    'answer': ('displacement', 'velocity', 'acceleration', 'response', 'beschleunigung', 'auslenkung', 'schnelle')}
"""Names that instruments give to a quantity, in small letters."""
SPELT = {'hz': 'Hz', 'hertz': 'Hz', 'khz': 'kHz', 'sec': 's', 'sek': 's', 'seconds': 's', 'msec': 'ms', 'newton': 'N',
         '°': 'deg', 'degrees': 'deg', 'grad': 'deg', 'degree': 'deg', 'radians': 'rad', 'micron': 'um', '-': '', '1': '',
         'gf': 'gf', 'lb': 'lbf', 'lbs': 'lbf', 'inch': 'in', 'inches': 'in'}
"""Units as instruments spell them, in small letters."""
ATOM = re.compile(r'([munk]?N|[munc]?m|in|[mu]?s|[km]?gf|lbf)(2?)')


@dataclass(frozen=True)
class Table:
    """Columns of a table by the names of their quantities."""

    path: Any
    header: dict[str, str]  # the name of each column in the file
    spelt: dict[str, str]  # the unit of each column, as 'm_per_s'
    units: dict[str, float]  # and in mm, g, ms; zero for words
    columns: dict[str, NDArray[Any]]  # shape (rows,): numbers in mm, g, ms, or words
    lines: NDArray[np.int_]  # shape (rows,): the line of each row in the file
    points: dict[str, NDArray[Any]] = field(default_factory=dict)  # columns of points, one each, where such are asked for
    notes: tuple[str, ...] = ()  # what was done to read it, in words

    def __contains__(self, quantity: object) -> bool:
        return quantity in self.columns

    def __getitem__(self, quantity: str) -> NDArray[Any]:
        return self.columns[quantity]

    def __len__(self) -> int:
        return len(self.lines)

    def get(self, quantity: str, otherwise: Any) -> NDArray[Any]:
        """A column of the table; if the table lacks it, a column filled with the value `otherwise`."""
        return self.columns.get(quantity, np.full(len(self), otherwise))

    def refuse(self, quantity: str, wrong: NDArray[np.bool_], must: str) -> None:
        """Raise ValueError for the first row of this column, if any, where `wrong` is true; `must` says what it should be."""
        for k in np.flatnonzero(wrong)[:1] if quantity in self else ():
            value = self[quantity][k]
            told = f'{value / self.units[quantity]:g}' if self.units[quantity] else shown(value)
            raise ValueError(f'line {self.lines[k]} of {self.path}: {self.header[quantity]} must {must}, not {told}')


class Heading(NamedTuple):
    """What the header says of one column."""

    name: str  # as it stands in the file
    quantity: str | None = None  # None: none that is asked for
    spelt: str = ''  # its unit
    factor: float = 0.0  # and in mm, g, ms; zero for words
    decibels: bool = False


def read_table(path: str | PathLike[str], columns: Mapping[str, Mapping[str, float]], needed: Collection[str | tuple[str, ...]],
               blank: Collection[str] = (), others: bool = True, layout: str = '', most: int = MOST_BYTES,
               points: Mapping[str, float] | None = None, held: Any = None) -> Table:
    """Read a table of at most `most` bytes: a text, or columns of another format of `magphonon.readers`.

    The header names the columns. It is the first line that names all needed columns, or a comment (# or %) above the rows.
    Columns of a text are separated by commas, semicolons, tabs or spaces. Numbers may have decimal commas if the separator is
    no comma, or if they are quoted.  A unit ends the name (r_mm), stands in brackets (r [mm]) or in a line below the header.

    `columns` are the quantities that the table may hold, with their units: {'x': LENGTH} allows x_m and x [mm].  Each entry of
    `needed` is a required column, or a tuple of which one is required.  An empty cell or nan in a `blank` column gives NaN.
    Other names are refused unless `others`; in a unit of `points`, such a column belongs to one point.  `layout` tells users
    what the table should look like; `held` is the content of the file, if it is already known.
    """
    layout = f'; {layout}' if layout else ''
    needed = [one if isinstance(one, tuple) else (one,) for one in needed]
    found = content(path, most) if held is None else held
    if isinstance(found, list):
        raise ValueError(f'{path} holds records of an instrument and no table{layout}')

    def headings(names, below=()):
        return [_heading(name, below[k] if below else '', columns, points or {}) for k, name in enumerate(names)]

    def is_header(heads):
        known = {head.quantity for head in heads if head.spelt is not None}
        return all(known.intersection(one) for one in needed) and len(known - {None}) >= (1 if needed else 2)

    if isinstance(found, str):
        try:
            heads, separator, rows, notes = _divided(path, found, headings, is_header)
        except csv.Error as error:
            raise ValueError(f'{path} is not a text table ({error}); export it as CSV') from None
        lines = [n for n, _ in rows]
    else:
        found, notes = _stretched(path, found), []
        heads, lines = headings(found), np.arange(1, 1 + max(map(len, found.values()), default=0))
    places = _places(path, heads, columns, others, layout)
    for either in needed:
        if not places.keys() & set(either):
            example = next(f'{either[0]}_{unit}'.rstrip('_') for unit in columns[either[0]] or [''])
            raise ValueError(f'{path} lacks the column {example} (its header is {shown(",".join(head.name for head in heads))})'
                             f'{layout}')
    if not len(lines):
        raise ValueError(f'{path} holds no rows below its header{layout}')
    told = {quantity: heads[k] for quantity, k in places.items()}
    if isinstance(found, str):
        values = _of_text(path, rows, heads, separator, places, blank)
    else:
        values = {quantity: _of_array(path, head.name, found[head.name], head.factor, quantity in blank)
                  for quantity, head in told.items()}
    with np.errstate(over='ignore'):
        values = {quantity: 10 ** (column / 20) * told[quantity].factor if told[quantity].decibels else
                  column * told[quantity].factor if told[quantity].factor else column for quantity, column in values.items()}
    units = {quantity: head.factor for quantity, head in told.items()}
    notes += [f'{head.name}: grams of a balance, {GRAM_FORCE / u.N:g} N each' for head in told.values()
              if head.spelt == 'g' and head.factor == GRAM_FORCE]
    left = [head.name for k, head in enumerate(heads) if k not in places.values()]
    notes += [f'other columns are left out: {shown(", ".join(left))}'] * bool(left)
    table = Table(path, {q: head.name for q, head in told.items()},
                  {q.removeprefix(POINT): head.spelt for q, head in told.items()}, units,
                  {q: column for q, column in values.items() if not q.startswith(POINT)}, np.asarray(lines),
                  {q.removeprefix(POINT): column for q, column in values.items() if q.startswith(POINT)}, tuple(notes))
    for quantity in (quantity for quantity in table.columns if units[quantity]):
        table.refuse(quantity, np.isinf(table[quantity]), 'be a finite number')
    return table


def _places(path, heads, columns, others, layout):
    """Index of the column of each quantity; ValueError if two columns hold the same quantity, or a unit is unknown."""
    places: dict[str, int] = {}
    for k, head in enumerate(heads):
        known = head.quantity and head.spelt is not None
        quantity = head.quantity if known else _passed_over(path, head, columns, others, layout)
        if quantity in places:
            raise ValueError(f'{path}: the columns {shown(heads[places[quantity]].name)} and {shown(head.name)} say the same; '
                             'keep one of them')
        if quantity is not None:
            places[quantity] = k
    return places


def _of_text(path, rows, heads, separator, places, blank):
    """The columns of a text, in the units of the file."""
    parts: dict[str, list[Any]] = {quantity: [] for quantity in places}
    signs: set[str] = set()
    for start, cells in _blocks(path, rows, heads, separator):
        for quantity, k in places.items():
            words = [cell.strip() for cell in cells[k :: len(heads)]]
            may = quantity in blank or quantity.startswith(POINT)
            parts[quantity].append(_numbers(path, rows[start:], heads[k].name, words, may, signs) if heads[k].factor else words)
    return {quantity: np.concatenate(part) for quantity, part in parts.items()}


def _of_array(path, name, values, factor, blank):
    """A column of a file that is not a text: floats if it has a unit, else words; ValueError for other values."""
    if not factor:
        return np.array([str(int(one)) if isinstance(one, (float, np.floating)) and one == int(one) else str(one)
                         for one in values.tolist()])
    try:
        values = np.asarray(values, None if values.dtype.kind in 'cmM' else float)
        if values.dtype.kind != 'f':
            raise TypeError
    except (TypeError, ValueError):
        raise ValueError(f'{path}: {name} holds no real numbers (its type is {values.dtype})') from None
    for k in np.flatnonzero(~np.isfinite(values))[:1] if not blank else ():
        raise ValueError(f'row {k + 1} of {path}: {name} is {values[k]}, not a finite number')
    return values


def _stretched(path, columns):
    """Columns of one length: arrays (frames, points) are flattened one frame after the other, and single numbers are dropped."""
    columns = {str(name): np.squeeze(values) for name, values in columns.items()}
    columns = {name: values for name, values in columns.items() if values.ndim}
    shapes = {values.shape for values in columns.values()}
    flat = {shape for shape in shapes if len(shape) == 1}
    wide = shapes - flat
    if not wide and len(flat) < 2:
        return columns
    if len(wide) != 1 or len(shape := next(iter(wide))) != 2 or shape[0] == shape[1] or not flat <= {shape[:1], shape[1:]}:
        raise ValueError(f'{path} holds arrays of the shapes {", ".join(map(str, sorted(shapes)))}; give columns of one length, '
                         'or arrays (frames, points) with the times of the frames and the positions of the points')
    of_points = [name for name, values in columns.items() if values.shape == shape[1:]]
    if any(_heading(name, '', {'time': TIME}, {}).quantity == 'time' for name in of_points):  # its times are along the rows
        columns, shape = {name: values.T for name, values in columns.items()}, shape[::-1]
    long = {name: (values if values.ndim == 2 else np.broadcast_to(values if len(values) == shape[1] else values[:, None], shape)
                   ).ravel() for name, values in columns.items()}
    return long if any(len(values) == shape[1] for values in columns.values() if values.ndim == 1) else {
        **long, 'point': np.tile(np.arange(1, shape[1] + 1), shape[0])}


def _divided(path, text, headings, is_header):
    """Headings, separator and rows (line number, line) of a text, and notes on the lines that are no rows."""
    lines = [(n, line.strip(' \r\n')) for n, line in enumerate(StringIO(text, newline=None), 1) if line.strip(' \t;,\r\n')]
    given = SEPARATOR.fullmatch(lines[0][1]) if lines else None
    given, lines = (given[1], lines[1:]) if given else (None, lines)
    rows, notes = [(n, line) for n, line in lines if line[0] not in COMMENT], []
    headers = [(n, headings(names), sign) for n, line in lines if line[0] in COMMENT
               for names, sign in [_names(line.lstrip(f'{COMMENT} '), given)] if is_header(headings(names))]
    for k in range(min(len(rows), 1 if headers else PREAMBLE)):
        if (found := _header_at(rows, k, given, headings, is_header)) is None:
            continue
        heads, sign, below = found
        for n, line in rows[:k]:
            if len(cells := _cells(line, sign)) == len(heads) and all(_floats(_ungrouped(cell)) is not None for cell in cells):
                raise ValueError(f'line {n} of {path} holds numbers above the header in line {rows[k][0]}; put the header first')
        notes = [f'{k} lines above the header are left out'] * bool(k) + ['units are in the line below the header'] * below
        headers = sorted([*headers, (rows[k][0], heads, sign)], key=lambda header: header[0])
        rows = rows[k + 1 + below :]
        break
    if rows and not headers:
        names, sign = _names(rows[0][1], given)
        headers, rows = [(rows[0][0], headings(names), sign)], rows[1:]
    if not headers:
        raise ValueError(f'{path} is empty')
    _, heads, sign = headers[0]
    for n, other, _ in headers:
        if other != heads:
            raise ValueError(f'line {n} of {path}: {shown(",".join(head.name for head in other))} names other columns or units '
                             'than the header before it; keep one of them')
    return heads, sign, rows, notes


def _header_at(rows, k, given, headings, is_header):
    """Headings and separator of the header in row k, and whether row k + 1 holds the units; None if row k is no header."""
    try:
        names, sign = _names(rows[k][1], given)
        below = _names(rows[k + 1][1], sign)[0] if k + 1 < len(rows) else []
    except csv.Error:
        if k:  # other code reports lines above the header, and rows
            return None
        names, sign = _names(rows[k][1], given)
        below = []
    numbers = len(below) != len(names) or any(re.match(r'[-+.,]?\d', cell) for cell in below)  # a unit begins with a letter
    for units in ((),) if numbers else (below, ()):
        if is_header(heads := headings(names, units)):
            return heads, sign, bool(units)
    return None


def _heading(name, below, columns, points):
    """The heading that a name in the header stands for; `below` is its entry in the line of units, if there is one."""
    plain = name.strip().replace('µ', 'u').replace('μ', 'u')
    for quantity, units in columns.items():
        for unit, factor in (units or {'': 0.0}).items():
            if plain == f'{quantity}_{unit}'.rstrip('_') and (not below or _spelt(below, units) == unit):
                return Heading(plain, quantity, unit, factor)
    match = BRACKETS.fullmatch(plain)
    base, unit = (match['name'], match[match.lastgroup or 0]) if match else (plain, below)
    if match and below:
        return Heading(plain)  # it has its unit: what stands below is no line of units
    shown_as = f'{plain} [{unit}]' if below and match is None else plain
    word = re.sub(r'\W+', '_', base.strip().lower()).strip('_')
    meant = [quantity for quantity in columns if word == quantity.lower() or word in WORDS.get(quantity, ())]
    for quantity in meant:
        decibels = DECIBELS.fullmatch(unit.strip()) if quantity == 'amplitude' else None
        spelt = _spelt(decibels['unit'] if decibels else unit, columns[quantity])
        if spelt is not None and not (decibels and not spelt):
            return Heading(shown_as, quantity, spelt, columns[quantity].get(spelt, 0.0), bool(decibels))
    spelt = _spelt(unit, points) if unit and not meant else None
    if spelt:
        return Heading(shown_as, f'{POINT}{base.strip()}', spelt, points[spelt])
    return Heading(shown_as, meant[0] if meant and unit else None, None)  # pyright: ignore[reportArgumentType]  of no known unit


def _spelt(unit, units):
    """The name that this package gives to an instrument's unit, m_per_s2_per_N for (m/s²)/N; None if it is not in `units`."""
    plain = unit.strip().strip('[]').replace('µ', 'u').replace('μ', 'u')
    plain = SPELT.get(plain.lower(), plain)
    if plain in units or (not units and not plain):
        return plain
    parts = _parts(plain)
    return next((name for name in units if name and parts is not None and _parts(name) == parts), None)


def unit_of_label(path: Any, dataset: Mapping[str, Any], axis: str, units: Mapping[str, float], otherwise: float) -> float:
    """The unit of an axis of a dataset of type 58, according to its label; `otherwise` if it has no label."""
    label = str(dataset.get(f'{axis}_axis_units_lab') or '').strip()
    if label.upper() in ('', 'NONE'):
        return otherwise
    if (spelt := _spelt(label, units)) is None:
        raise ValueError(f'{path}, node {dataset["rsp_node"]}: {shown(label)} is no known unit of such data; export it '
                         f'in SI, or in {", ".join(name.replace("_per_", "/") for name in [*units][1:5])}')
    return units[spelt]


def _parts(unit):
    """Numerator and sorted denominators of a unit; None if the text is no unit."""
    unit = unit.replace('_per_', '/').replace('sec', 's').replace('²', '2').replace('^', '').replace('(', '').replace(')', '')
    over, *under = re.sub(r'[\s*·.]', '', unit).split('/')
    if not over or any(ATOM.sub('', one) for one in under):
        return None
    return over, sorted(atom for one in under for atom, square in ATOM.findall(one) for _ in range(2 if square else 1))


def _names(line, sign=None):
    sign = sign or next((sign for sign in SEPARATORS if sign in line), ',')
    return [name.strip().replace('µ', 'u').replace('μ', 'u') for name in _cells(line, sign)], sign


def _cells(line, sign):
    return next(csv.reader([line], delimiter=sign, skipinitialspace=True))


def _passed_over(path, head, columns, others, layout):
    """Pass over a column of another name; ValueError if other names are refused, or if only its unit is unknown."""
    begun = (q for q in columns if columns[q] and (head.name == q or head.name.startswith(f'{q}_')))
    meant = head.quantity or max(begun, key=len, default=None)
    if meant is not None:
        allowed = [f'{meant}_{unit}'.rstrip('_') for unit in columns[meant]]
        again = '; for decibels give the reference, as [dB re 1 m/s/N]' if 'dB' in head.name else ''
        raise ValueError(f'{path}: the column {shown(head.name)} has no known unit; write {", ".join(allowed[:4])}'
                         f'{again}')
    if not others:
        known = [f'{q}_{unit}'.rstrip('_') for q, units in columns.items() for unit in units]
        raise ValueError(f'{path}: this kind of table has no column {shown(head.name)}'
                         + (did_you_mean(head.name, known) or layout))


def _blocks(path, rows, heads, separator):
    """Yield the index of the first of up to BLOCK rows, and the cells of these rows, one row after the other."""
    cells, start, first, count = [], 0, rows[0][1], len(heads)
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
    """The numbers in the cells of a column; `signs` collects the decimal signs, because a table may use only one."""
    missing = np.array([blank and cell.lower() in ('', 'nan') for cell in cells])
    text = '\n'.join('0' if lacking else cell for cell, lacking in zip(cells, missing, strict=True))
    values = _floats(text)
    if values is None:
        values = _floats(text := _ungrouped(text))
    if values is None:
        k = next(k for k, cell in enumerate(text.split('\n')) if not NUMBER.fullmatch(cell.replace(',', '.')))
        raise ValueError(f'line {rows[k][0]} of {path}: {name} is {shown(cells[k])}, not a finite number')
    signs |= {sign for sign in '.,' if sign in text}
    if len(signs) > 1:
        k = next(k for k, cell in enumerate(cells) if '.' in cell or ',' in cell)
        raise ValueError(f'line {rows[k][0]} of {path}: {name} is {shown(cells[k])}, but other numbers use the other decimal '
                         'sign; write all with a point, or all with a comma')
    values[missing] = np.nan
    return values


def _floats(text):
    plain = text.replace(',', '.')
    try:
        return np.array(plain.split('\n'), float) if PLAIN.fullmatch(plain) else None
    except ValueError:
        return None


def _ungrouped(text):
    """Numbers without thousands separators, if some number shows which mark that is: 1.234,5 or 1'234.5 or 1,234,567."""
    text = re.sub(r"(?<=\d)['\u2019\u00a0\u202f\u2009 ](?=\d\d\d(?!\d))", '', text)
    for mark, sign in ('.,', ',.'):
        whole = rf'[-+]?\d{{1,3}}(?:\{mark}\d\d\d)+'
        if re.search(rf'^(?:{whole}\{sign}\d+|{whole}\{mark}\d\d\d)$', text, re.MULTILINE):
            grouped = re.compile(rf'^{whole}(?=$|\{sign}\d*$)', re.MULTILINE)
            return grouped.sub(lambda found, mark=mark: found[0].replace(mark, ''), text)
    return text


def in_columns(rows: Sequence[Sequence[str]], left: int) -> list[str]:
    """Lines of a table for display, with its first `left` columns flush left and the others flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ['  '.join(f'{cell:{"<" if k < left else ">"}{widths[k]}}' for k, cell in enumerate(row)).rstrip() for row in rows]
