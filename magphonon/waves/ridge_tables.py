"""Tables of ridge points: what `spectrum` and `burst` write, and what a fit of the lattice reads."""

from __future__ import annotations

import csv
from dataclasses import dataclass, fields
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..files import MEGABYTE, refuse_overflow, table_text, whole_file

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence
    from os import PathLike

    from .wave_analysis import Wave

RIDGE_COLUMNS = ('record', 'motion', 'xi_rad', 'sigma_xi_rad', 'frequency_Hz', 'sigma_frequency_Hz', 'power_m2', 'agrees_with',
                 'q1', 'q2', 'q3', 'bin_Hz')
NUMBERS = tuple(name for name in RIDGE_COLUMNS if name not in ('record', 'motion', 'agrees_with'))
NEEDED = ('xi_rad', 'sigma_xi_rad', 'frequency_Hz', 'sigma_frequency_Hz', 'q1', 'q2')
APART = 2.5
"""Distance in frequency lines from which points share no noise: through a Hann window it reaches over two lines, and a centre of
gravity lies up to half a line from its own."""
RANGE_Hz, MOST_q = (1e-12, 1e12), 10.0
"""Frequencies, and the largest component of a wavevector, of a table; others are in another unit."""
MOST_BYTES = 100 * MEGABYTE


@dataclass(frozen=True)
class RidgePoints(units.InHertz):
    """Points of one or more measured branches.

    Attributes
    ----------
    names, motions : tuple of str
        Record and motion of each ridge, and its motion alone: 'transverse', 'longitudinal', or another word where it is neither.
    ridge : ndarray of int, shape (points,)
        The ridge of each point.
    q : ndarray, shape (points, 3)
        Wavevectors in fractions of the reciprocal vectors.
    xi, sigma_xi : ndarray, shape (points,)
        Phase per step along the row and its standard uncertainty, in rad; q goes in proportion.
    omega, sigma_omega : ndarray, shape (points,)
        Angular frequencies and their standard uncertainties in rad/ms.
    power : ndarray, shape (points,)
        Relative weight of the points, in any unit.
    line : ndarray, shape (points,)
        Distance of the frequency lines of the record in rad/ms; zero where points share no noise.
    """

    names: tuple[str, ...]
    motions: tuple[str, ...]
    ridge: np.ndarray
    q: np.ndarray
    xi: np.ndarray
    sigma_xi: np.ndarray
    omega: np.ndarray
    sigma_omega: np.ndarray
    power: np.ndarray
    line: np.ndarray

    def __len__(self) -> int:
        return len(self.omega)

    def __getitem__(self, kept: np.ndarray) -> RidgePoints:
        texts, columns = (self.names, self.motions), [field.name for field in fields(self)][2:]
        return RidgePoints(*texts, *(getattr(self, name)[kept] for name in columns))

    @property
    def independent(self) -> RidgePoints:
        """Those that share no noise: of each ridge the strongest points first, each 2.5 lines from all before.

        Neighbouring lines share two thirds of an error through the Hann window: as if independent, they would make intervals
        1.6 times too narrow.  A third of the points, far apart, tells all but a tenth of what all of them do.
        """
        kept: list[int] = []
        for k in np.argsort(-self.power, kind='stable'):
            beside = [other for other in kept if self.ridge[other] == self.ridge[k]]
            if all(abs(self.omega[k] - self.omega[beside]) >= APART * self.line[k]):
                kept.append(int(k))
        return self[np.sort(kept)]


def write_ridges(path: str | PathLike[str], records: Mapping[str, Sequence[Wave]]) -> None:
    """Table of ridge points in SI, with the branches that the ridge agrees with or 'none'; written completely or not at all.

    The columns q1, q2 and q3 are the wavevector of a point in fractions of the reciprocal vectors, and bin_Hz is the distance of
    the frequency lines of the record.

    Parameters
    ----------
    path : path
    records : dict
        From the name of a record to its waves.
    """
    with whole_file(path) as file:
        print(*RIDGE_COLUMNS, sep=',', file=file)
        for name, found in records.items():
            for wave in found:
                if wave.ridge:
                    r, on = wave.ridge, '; '.join(map(' '.join, wave.agrees_with)) or 'none'
                    columns = r.xi, wave.sigma_xi, units.hertz(r.omega), units.hertz(r.sigma_omega), r.power / units.m**2
                    refuse_overflow(path, {f'the ridge of {name}, {wave.motion} motion,': columns})
                    q = r.xi[:, None] / (2 * np.pi) * wave.wavevector
                    for point, at in zip(np.transpose(columns).tolist(), q.tolist(), strict=True):
                        print(name, wave.motion, *point, on, *at, float(units.hertz(r.bin_omega)), sep=',', file=file)


def read_ridges(path: str | PathLike[str]) -> RidgePoints:
    r"""Read a table of ridge points, as `write_ridges` writes it.

    Parameters
    ----------
    path : path-like
        Text with the columns xi_rad, sigma_xi_rad, frequency_Hz, sigma_frequency_Hz, q1 and q2.  A table by hand may leave out
        the others: record and motion, which tell ridges apart; power_m2 and bin_Hz, without which all points are independent.

    Returns
    -------
    RidgePoints

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is no such table; the message says what and where.

    Examples
    --------
    >>> import tempfile
    >>> from magphonon.waves import read_ridges
    >>> file = tempfile.mkdtemp() + '/ridges.csv'
    >>> with open(file, 'w') as table:
    ...     _ = table.write('xi_rad,sigma_xi_rad,frequency_Hz,sigma_frequency_Hz,q1,q2\n1.0,0.01,40,0.1,0,0.159\n')
    >>> read_ridges(file).frequencies_Hz.round(9).tolist()
    [40.0]
    """
    lines = table_text(path, MOST_BYTES).splitlines()
    rows = [(n, row) for n, row in enumerate(csv.reader(lines), 1) if row and not row[0].lstrip().startswith('#')]
    header = [name.strip() for name in rows[0][1]] if rows else []
    for name in NEEDED:
        if name not in header:
            raise ValueError(f'{path} lacks the column {name}; a table of ridge points, as "magphonon spectrum" and "magphonon '
                             f'burst" write it, has {", ".join(RIDGE_COLUMNS)}')
    if len(rows) < 2:
        raise ValueError(f'{path} holds no ridge points below its header')
    table = [dict(zip(header, row, strict=False)) for _, row in rows[1:]]
    ridges = [(row.get('record', '').strip(), row.get('motion', '').strip()) for row in table]
    each = list(dict.fromkeys(ridges))
    columns = {name: np.array([_number(path, n, row, name) for (n, _), row in zip(rows[1:], table, strict=True)])
               for name in NUMBERS if name in header}
    _refuse_impossible(path, columns, [number for number, _ in rows[1:]])
    n = len(table)
    q = np.stack([columns['q1'], columns['q2'], columns.get('q3', np.zeros(n))], axis=1)
    to_omega = 2 * np.pi * units.Hz
    return RidgePoints(tuple(', '.join(filter(None, one)) for one in each), tuple(motion for _, motion in each),
                       np.array([each.index(one) for one in ridges]), q, columns['xi_rad'], columns['sigma_xi_rad'],
                       columns['frequency_Hz'] * to_omega, columns['sigma_frequency_Hz'] * to_omega,
                       columns.get('power_m2', np.ones(n)), columns.get('bin_Hz', np.zeros(n)) * to_omega)


def _refuse_impossible(path, columns, lines):
    """Raise ValueError for what no measured wave has; `lines` are the numbers of the lines."""
    for name, least, most in (('xi_rad', 1e-9, 2 * np.pi), ('frequency_Hz', *RANGE_Hz), ('sigma_frequency_Hz', *RANGE_Hz)):
        values = columns[name]
        for k in np.flatnonzero((values < least) | (values > most))[:1]:
            what = 'positive' if values[k] <= 0 else f'between {least:.3g} and {most:.3g}, in the unit of its name'
            raise ValueError(f'line {lines[k]} of {path}: {name} must be {what}, not {values[k]:g}')
    for k in np.flatnonzero((columns['sigma_xi_rad'] < 0) | (columns['sigma_xi_rad'] > 2 * np.pi))[:1]:
        raise ValueError(f'line {lines[k]} of {path}: sigma_xi_rad must lie between 0 and 2 pi, not '
                         f'{columns["sigma_xi_rad"][k]:g}')
    for name in ('q1', 'q2', 'q3'):
        for k in np.flatnonzero(abs(columns.get(name, np.zeros(0))) > MOST_q)[:1]:
            raise ValueError(f'line {lines[k]} of {path}: {name} is {columns[name][k]:g}; wavevectors are fractions of the '
                             f'reciprocal vectors, of a size up to {MOST_q:g}')


def _number(path, line, row, name):
    try:
        value = float(row[name])
    except (KeyError, ValueError):
        value = np.nan
    if not isfinite(value):
        raise ValueError(f'line {line} of {path}: {name} is {row.get(name, "").strip()!r}, not a finite number')
    return value
