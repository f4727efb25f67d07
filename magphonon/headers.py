"""Headers of tables: where they are in a text, and which quantity and unit each of their names means."""

from __future__ import annotations

import csv
import re
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

from .errors import did_you_mean, shown
from .quantities import SIGNS, named_unit

NUMBER = re.compile(r'[-+]?(\d+[.,]?\d*|[.,]\d+)([eE][-+]?\d+)?', re.ASCII)
GROUPED = re.compile(r"[-+\d.,eE'\u2019 ]*\d[-+\d.,eE'\u2019 ]*")  # a number, perhaps with marks between thousands
COMMENT = '#%'  # begins a line that is a comment
PREAMBLE = 200
"""Number of lines in which the header is sought: instruments write their settings above it."""
UNIT = re.compile(r'(.*?)\s*(?:\[(.*)\]|\((.*)\)|/(.*)|\bin\s+(\S+))')
"""A name with its unit: r [mm], r (mm), r / mm, r in mm."""
WORDS = {
    'r': ('distance', 'abstand', 'd', 'dist', 'separation', 'spacing'), 'gap': ('spalt', 'luftspalt', 'clearance'),
    'f': ('force', 'kraft', 'load', 'last', 'mean', 'mean_force'), 'direction': ('richtung',), 'time': ('t', 'zeit'),
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


def heading(name: str, below: str, columns: Mapping[str, Mapping[str, float]], points: Mapping[str, float]) -> Heading:
    """What a name in the header means: one of the quantities in `columns`, or a column of one point in a unit of `points`.

    `below` is what stands under the name in a line of units, if there is one.

    Examples
    --------
    >>> from magphonon.headers import heading
    >>> from magphonon.quantities import FORCE, LENGTH
    >>> heading('Kraft [mN]', '', {'r': LENGTH, 'f': FORCE}, {})
    Heading(name='Kraft [mN]', quantity='f', unit='mN')
    """
    match = UNIT.fullmatch(name)
    own, unit = (match[1], next(filter(None, match.groups()[1:]), '')) if match else (name, below)
    if match and below:  # then what stands below is no line of units
        return Heading(name)
    word = re.sub(r'\W+', '_', own.lower()).strip('_')
    for quantity, units in columns.items():
        for known in (quantity, *WORDS.get(quantity, ())):
            spelt = _unit_of(name, known, word, unit, units)
            if spelt is not None:
                return Heading(name, quantity, spelt)
    begun = [q for q, units in columns.items() if word == q or (units and not unit and word.startswith(f'{q}_'))]
    meant = begun or [q for q in columns if unit and word in WORDS.get(q, ())]
    if meant:
        return Heading(name, max(meant, key=len))
    spelt = named_unit(unit, points) if unit else None
    return Heading(name, f'*{own}', spelt) if spelt else Heading(name)


def _unit_of(name, known, word, unit, units):
    """The unit of a column if its quantity has this `known` name, as in r_mm or r [mm]; None for other quantities and units."""
    ending = name[len(known) + 1 :].translate(SIGNS) if name.lower().startswith(f'{known}_') else ''
    if ending and ending in units:
        return ending if not unit or named_unit(unit, units) == ending else None
    return named_unit(unit, units) if word == known else None


def by_quantity(path: Any, heads: Sequence[Heading], columns: Mapping[str, Mapping[str, float]], others: bool,
                layout: str) -> dict[str, Heading]:
    """The heading of each quantity; ValueError if two columns hold the same quantity, or a unit is unknown."""
    told: dict[str, Heading] = {}
    for head in heads:
        if head.quantity and head.unit is None:
            names = ', '.join(f'{head.quantity}_{unit}'.rstrip('_') for unit in [*columns[head.quantity]][:4])
            raise ValueError(f'{path}: the column {shown(head.name)} has no known unit; write {names}')
        if not (head.quantity or others):
            known = [f'{q}_{unit}'.rstrip('_') for q, units in columns.items() for unit in units]
            raise ValueError(f'{path}: this kind of table has no column {shown(head.name)}'
                             f'{did_you_mean(head.name, known) or layout}')
        if head.quantity in told:
            both = ' and '.join(shown(one.name) for one in (told[head.quantity], head))
            raise ValueError(f'{path}: the columns {both} say the same; keep one of them')
        if head.quantity:
            told[head.quantity] = head
    return told


def divided(path: Any, text: str, headings: Callable[..., list[Heading]], complete: Callable[[list[Heading]], bool],
            ) -> tuple[list[Heading], str, list[tuple[int, str]]]:
    """Headings, separator and numbered rows of a text; if no line names all that is needed, likely headings and no rows."""
    lines = [(n, line.strip(' ')) for n, line in enumerate(text.splitlines(), 1) if line.strip(' \t;,')]
    names = [split(line) for _, line in lines[: PREAMBLE + 1]]
    likely = []
    for k in range(min(len(lines), PREAMBLE)):
        below = names[k + 1] if k + 1 < len(names) and not any(map(NUMBER.match, names[k + 1])) else []
        for units in (below, []) if len(below) == len(names[k]) else ([],):
            heads = headings(names[k], units)
            if complete(heads):
                _refuse_rows(path, lines[:k], names, heads)
                rows = [one for one in lines[k + 1 + bool(units) :] if one[1][0] not in COMMENT]
                for n, line in (one for one in lines[k + 1 :] if one[1][0] in COMMENT):
                    if complete(other := headings(split(line))) and other != heads:
                        raise ValueError(f'line {n} of {path}: {shown(line)} names other columns or units than the header; keep '
                                         'one of them')
                return heads, separator(lines[k][1]), rows
            likely.append(((not any(map(NUMBER.match, names[k])), sum(head.quantity is not None for head in heads)), heads))
    if not likely:
        raise ValueError(f'{path} is empty')
    return max(likely, key=lambda one: one[0])[1], '', []


def _refuse_rows(path, lines, names, heads):
    """Raise ValueError for a row of numbers above the header."""
    for (n, _), cells in zip(lines, names, strict=False):
        if len(cells) == len(heads) and all(map(GROUPED.fullmatch, cells)):
            raise ValueError(f'line {n} of {path} holds numbers above the header; put the header first')


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
