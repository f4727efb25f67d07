"""Headers of tables: where they are in a text, and which quantity and unit each of their names means."""

from __future__ import annotations

import csv
import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

from .errors import did_you_mean, shown
from .quantities import SIGNS, named_unit

NUMBER = re.compile(r'[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?', re.ASCII)
GROUPED = re.compile(r"[-+\d.,eE'\u2019 ]*\d[-+\d.,eE'\u2019 ]*")  # a number, perhaps with marks between thousands
COMMENT = '#%'  # begins a line that is a comment
PREAMBLE = 200
"""Number of lines in which the header is sought: instruments write their settings above it."""
LACKS = 'lacks the column'
"""Words of the error for a table of another kind."""
UNIT = re.compile(r'(.*?)\s*(?:\[(.*)\]|\((.*)\)|/(.*)|\bin\s+(\S+))')
"""A name with its unit: r [mm], r (mm), r / mm, r in mm."""
WORDS = {
    'r': ('distance', 'abstand', 'd', 'dist', 'separation', 'spacing', 'mittenabstand'),
    'gap': ('spalt', 'luftspalt', 'clearance'),
    'f': ('force', 'kraft', 'load', 'last', 'mean', 'mean_force', 'weight'), 'direction': ('richtung',), 'time': ('t', 'zeit'),
    'sigma': ('uncertainty', 'unsicherheit', 'std', 'standard_deviation', 'sd', 'error'), 'mass': ('masse',),
    'stroke': ('extension', 'displacement', 'position', 'travel', 'weg', 'traverse', 'standardweg'),
    'frequency': ('f', 'freq', 'frequenz'), 'x': ('x_position', 'pos_x'), 'y': ('y_position', 'pos_y'),
    'point': ('punkt', 'index', 'point_index', 'messpunkt'), 'u': ('displacement', 'auslenkung'),
    'v': ('velocity', 'geschwindigkeit', 'schnelle'), 'amplitude': ('magnitude', 'betrag', 'mag'), 'phase': ('winkel',),
    're': ('real', 'real_part', 'realteil'), 'im': ('imag', 'imaginary', 'imaginary_part', 'imaginärteil'),
    'drive': ('force', 'kraft', 'hammer'), 'answer': ('response', 'acceleration', 'beschleunigung', 'velocity', 'schnelle')}
"""Names that instruments give to a quantity, in small letters."""


class Heading(NamedTuple):
    """What the header says of one column."""

    name: str  # as it stands in the file
    quantity: str | None = None  # None: none that is asked for; '*name' of a column that belongs to one point
    unit: str | None = None  # None: not known


@dataclass(frozen=True)
class Asked:
    """The columns that a table may have: quantities with their units, such as {'x': LENGTH}; those that are needed, where of a
    tuple one is enough; and units of columns that belong to one point each.

    Examples
    --------
    >>> from magphonon.headers import Asked
    >>> from magphonon.quantities import FORCE, LENGTH
    >>> Asked({'r': LENGTH, 'f': FORCE}, ['r', 'f'], {}).heading('Kraft [mN]')
    Heading(name='Kraft [mN]', quantity='f', unit='mN')
    """

    columns: Mapping[str, Mapping[str, float]]
    needed: Collection[str | tuple[str, ...]]
    points: Mapping[str, float]

    def heading(self, name: str, below: str = '') -> Heading:
        """What a name in the header means; `below` is what stands under it in a line of units."""
        match = UNIT.fullmatch(name)
        if match and below:  # then what stands below is no line of units
            return Heading(name)
        own, unit = (match[1], ''.join(filter(None, match.groups()[1:]))) if match else (name, below)
        word = re.sub(r'\W+', '_', own.lower()).strip('_')
        for quantity, other in self._words():
            if (spelt := _unit_of(name, other, word, unit, self.columns[quantity])) is not None:
                return Heading(name, quantity, spelt)
        return self._unknown(name, own, word, unit)

    def _words(self):
        """Yield the quantities with their names: first their own, then those that instruments give them."""
        yield from ((quantity, quantity) for quantity in self.columns)
        yield from ((quantity, other) for quantity in self.columns for other in WORDS.get(quantity, ()))

    def _unknown(self, name, own, word, unit):
        """The heading of a column in no unit of a quantity: of one point, of a quantity in an unknown unit, or of neither."""
        if not unit:
            begun = [quantity for quantity, units in self.columns.items() if units and f'{word}_'.startswith(f'{quantity}_')]
            return Heading(name, max(begun, key=len, default=None))
        meant, spelt = [quantity for quantity, other in self._words() if word == other], named_unit(unit, self.points)
        return Heading(name, meant[0]) if meant else Heading(name, spelt and f'*{own}', spelt)

    def headings(self, names: Sequence[str], below: Sequence[str] = ()) -> list[Heading]:
        """What each name in the header means."""
        return list(map(self.heading, names, below or [''] * len(names)))

    def lacking(self, heads: Collection[Heading]) -> list[tuple[str, ...]]:
        """What is needed, and is in none of these columns."""
        known = {head.quantity for head in heads if head.unit is not None}
        needed = [one if isinstance(one, tuple) else (one,) for one in self.needed]
        return [one for one in needed if not known.intersection(one)]

    def names(self, quantity: str) -> list[str]:
        """Names of a column that holds this quantity."""
        return [f'{quantity}_{unit}'.rstrip('_') for unit in self.columns[quantity] or ['']]

    def size(self, head: Heading) -> float:
        """The unit of a column in mm, g, ms; zero for words."""
        return (self.columns.get(head.quantity or '') or self.points).get(head.unit or '', 0.0)

    def by_quantity(self, path: Any, heads: Sequence[Heading], others: bool, layout: str) -> dict[str, Heading]:
        """The heading of each quantity; ValueError for a quantity in two columns, and an unknown unit or name."""
        told: dict[str, Heading] = {}
        for either in self.lacking([head._replace(unit='') for head in heads]):  # of an unknown unit is said below
            raise ValueError(f'{path} {LACKS} {self.names(either[0])[0]} (its header is '
                             f'{shown(",".join(head.name for head in heads))}){layout}')
        for head in heads:
            if head.quantity is None:
                if not others:
                    self._refuse_unknown(path, head.name, layout)
                continue
            if head.unit is None:
                names = ', '.join(self.names(head.quantity)[:4])
                raise ValueError(f'{path}: the column {shown(head.name)} has no known unit; write {names}')
            if head.quantity in told:
                raise ValueError(f'{path}: the columns {shown(told[head.quantity].name)} and {shown(head.name)} say the same; '
                                 'keep one of them')
            told[head.quantity] = head
        return told

    def _refuse_unknown(self, path, name, layout):
        """Raise ValueError for a column that is not asked for; one without a name numbers the rows."""
        if name:
            near = did_you_mean(name, [known for quantity in self.columns for known in self.names(quantity)])
            raise ValueError(f'{path}: this kind of table has no column {shown(name)}{near or layout}')



def _unit_of(name, known, word, unit, units):
    """The unit of a column if its quantity has this `known` name, as in r_mm or r [mm]; None for other quantities and units."""
    ending = name[len(known) + 1 :].translate(SIGNS) if name.lower().startswith(f'{known}_') else ''
    if ending and ending in units:
        return ending if not unit or named_unit(unit, units) == ending else None
    return named_unit(unit, units) if word == known else None


def divided(path: Any, text: str, asked: Asked) -> tuple[list[Heading], str, list[tuple[int, str]]]:
    """Headings, separator and numbered rows of a text; if no line names all that is needed, likely headings and no rows."""
    lines = [(n, line.strip(' ')) for n, line in enumerate(text.splitlines(), 1) if line.strip(' \t;,')]
    if not lines:
        raise ValueError(f'{path} is empty')
    names = [split(line) for _, line in lines[: PREAMBLE + 1]]
    for k, (own, below) in enumerate(zip(names, [*names[1:], []], strict=True)):
        may_be_units = len(below) == len(own) and not any(map(NUMBER.match, below))
        for units in (below, []) if may_be_units else ([],):
            heads = asked.headings(own, units)
            if not asked.lacking(heads):
                _refuse_rows(path, lines[:k], names, heads)
                _refuse_other_headers(path, lines[k + 1 :], heads, asked)
                rows = [one for one in lines[k + 1 + bool(units) :] if one[1][0] not in COMMENT]
                return heads, separator(lines[k][1]), rows
    return max(map(asked.headings, names), key=_likeness), '', []


def _likeness(heads):
    """How much the names in a line look like those of a header, for a message: they are no numbers, and some are known."""
    return not any(NUMBER.match(head.name) for head in heads), sum(head.quantity is not None for head in heads), len(heads)


def _refuse_rows(path, lines, names, heads):
    """Raise ValueError for a row of numbers above the header."""
    for (n, _), cells in zip(lines, names, strict=False):
        if len(cells) == len(heads) and all(map(GROUPED.fullmatch, cells)):
            raise ValueError(f'line {n} of {path} holds numbers above the header; put the header first')


def _refuse_other_headers(path, lines, heads, asked):
    """Raise ValueError for a comment below the header that names other columns or units."""
    for n, line in (one for one in lines if one[1][0] in COMMENT):
        other = asked.headings(split(line))
        if other != heads and not asked.lacking(other):
            raise ValueError(f'line {n} of {path}: {shown(line)} names other columns or units than the header; keep one of them')


def split(line: str, sign: str = '') -> list[str]:
    """The cells in a line of a table, by default of its header."""
    line = line.strip(f'{COMMENT} ')
    if not sign and separator(line) == ' ' and '  ' in line:  # columns of fixed width, whose names may have spaces
        return [cell.strip('"') for cell in re.split(' {2,}', line)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=sign or separator(line), skipinitialspace=True))]
    except csv.Error:
        return [line]


def separator(line: str) -> str:
    """What separates the cells of a line of the header."""
    return next((sign for sign in '\t;,' if sign in line), ' ')
