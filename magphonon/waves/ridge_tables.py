"""Tables of ridge points, which `spectrum` and `burst` write and a fit of the lattice reads."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from .. import units
from ..files import refuse_overflow, whole_file, write_columns
from ..quantities import ANGLE, AREA, FREQUENCY, PURE, TEXT
from ..results import InHertz
from ..tables import read_table

if TYPE_CHECKING:
    from .wave_analysis import Wave

COLUMNS = {'record': TEXT, 'motion': TEXT, 'xi': ANGLE, 'sigma_xi': ANGLE, 'frequency': FREQUENCY, 'sigma_frequency': FREQUENCY,
           'power': AREA, 'agrees_with': TEXT, 'q1': PURE, 'q2': PURE, 'q3': PURE, 'bin': FREQUENCY, 'bin_xi': ANGLE,
           'source': TEXT}
NEEDED = 'xi', 'sigma_xi', 'frequency', 'sigma_frequency', 'q1', 'q2'
HEADER = ('record', 'motion', 'xi_rad', 'sigma_xi_rad', 'frequency_Hz', 'sigma_frequency_Hz', 'power_m2', 'agrees_with',
          'q1', 'q2', 'q3', 'bin_Hz', 'bin_xi_rad', 'source')
LAYOUT = f'a table of ridge points, as "magphonon spectrum" and "magphonon burst" write it, has {", ".join(HEADER)}'
ASKED = {'columns': COLUMNS, 'needed': NEEDED, 'layout': LAYOUT}
SOURCES = 'row', 'point'  # of a wave
DRIVEN = *SOURCES, 'bench'  # where a burst enters
FIELD = 'field'  # in place of a source, where all directions of the plane are resolved
APART = 2.5
"""Distance in frequency lines from which points share no noise: through a Hann window it reaches over two lines, and a centre of
gravity lies up to half a line from its own."""
SHIFT_bins = {'row': 0.05, FIELD: 0.1, 'point': 0.2}
"""Standard deviation of the shift that all ridges of a branch share, in wavenumber bins, for each kind of source.  The shift is
the same in each specimen, so that scatter does not reveal it.  For a point source it is what remains besides the distance of
oblique waves: with 0.2 the errors of fits of 16 drawn lattices, in units of the stated uncertainties, have a root mean square of
0.6 to 1; with 0.1 up to 1.2.  For noise over the plane it is the difference between the middle of a specimen and the rest."""
BIN_rad = 0.2  # a bin of a row of 30 points, for tables that do not tell theirs
RANGE_Hz, MOST_q = (1e-12, 1e12), 10.0
"""Range of frequencies, and largest component of a wavevector, in a table; values beyond them are in another unit."""


@dataclass(frozen=True)
class RidgePoints(InHertz):
    """Points of measured ridges, with their uncertainties and sources.

    Attributes
    ----------
    names, motions : tuple of str
        `names` says the record and the motion of each ridge, `motions` only the motion: 'transverse', 'longitudinal', or another
        word if it is neither.
    ridge : ndarray of int, shape (points,)
        Index of the ridge of each point.
    q : ndarray, shape (points, 3)
        Wavevectors in fractions of the reciprocal vectors.
    xi, sigma_xi : ndarray, shape (points,)
        Phase per step along the row and its standard uncertainty, in rad; q is proportional to xi.
    omega, sigma_omega : ndarray, shape (points,)
        Angular frequencies and their standard uncertainties in rad/ms.
    power : ndarray, shape (points,)
        Relative weight of the points, in any unit.
    line : ndarray, shape (points,)
        Distance of the frequency lines of the record in rad/ms; zero where points share no noise.
    sources : tuple of str, optional
        The source of each ridge, 'row' or 'point'; an unknown source counts as 'point'.
    bin_xi : ndarray, shape (points,), optional
        Resolution of the row in rad, 2 pi divided by its number of points, missing ones included; by default that of 30 points.
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
    sources: tuple[str, ...] = ()
    bin_xi: np.ndarray | None = None

    def __len__(self) -> int:
        return len(self.omega)

    def __getitem__(self, kept: np.ndarray) -> RidgePoints:
        return replace(self, **{name: column[kept] for name, column in vars(self).items() if isinstance(column, np.ndarray)})

    @property
    def from_points(self) -> np.ndarray:
        """Whether each point belongs to waves from a point source, or from a source that the table does not name, shape
        (points,).
        """
        return np.array([source == 'point' for source in self.sources or ('point',) * len(self.names)])[self.ridge]

    @property
    def bins(self) -> np.ndarray:
        """The resolution of the row in rad, shape (points,)."""
        return np.full(len(self), BIN_rad) if self.bin_xi is None else self.bin_xi

    @property
    def shift(self) -> np.ndarray:
        """Standard deviation in rad of the shift that all points of the same branch and kind of source share."""
        return np.array([SHIFT_bins[source] for source in self.sources or ('point',) * len(self.names)])[self.ridge] * self.bins

    @property
    def independent(self) -> RidgePoints:
        """The points that share no noise: the strongest of each ridge first, each at least 2.5 lines from all those before.

        Because of the Hann window neighbouring lines share two thirds of their error: treated as independent, they would make
        intervals 1.6 times too narrow. A third of the points, far apart, contains nine tenths of the information.
        """
        kept: list[int] = []
        for k in np.argsort(-self.power, kind='stable'):
            beside = [other for other in kept if self.ridge[other] == self.ridge[k]]
            if all(abs(self.omega[k] - self.omega[beside]) >= APART * self.line[k]):
                kept.append(int(k))
        return self[np.sort(np.array(kept, int))]


def write_ridges(path: str | PathLike[str], records: Mapping[str, Sequence[Wave]]) -> None:
    """Write a table of ridge points in SI, with the branches that each ridge agrees with, or 'none'; whole or not at all.

    The columns q1, q2 and q3 are the wavevector of a point in fractions of the reciprocal vectors. bin_Hz is the distance of the
    frequency lines of the record, and bin_xi_rad is 2 pi divided by the number of points of the row, missing ones included.
    source ('row' or 'point') is the source of the wave.

    Parameters
    ----------
    path : path
    records : dict
        Waves of each record, by its name.
    """
    with whole_file(path) as file:
        print(*HEADER, sep=',', file=file)
        for name, found in records.items():
            for wave in found:
                if wave.ridge:
                    r, on = wave.ridge, '; '.join(map(' '.join, wave.agrees_with)) or 'none'
                    columns = r.xi, wave.sigma_xi, units.hertz(r.omega), units.hertz(r.sigma_omega), r.power / units.m**2
                    refuse_overflow(path, {f'the ridge of {name}, {wave.motion} motion,': columns})
                    q = r.xi[:, None] / (2 * np.pi) * wave.wavevector
                    for point, at in zip(np.transpose(columns).tolist(), q.tolist(), strict=True):
                        print(name, wave.motion, *point, on, *at, float(units.hertz(r.bin_omega)), r.bin_xi, wave.source,
                              sep=',', file=file)


def write_points(path: str | PathLike[str], points: RidgePoints) -> None:
    """Write a table of ridge points that were read from a table, or found in a field."""
    columns = columns_of(points)
    write_columns(path, [*columns], [*columns.values()])


def columns_of(points: RidgePoints) -> dict[str, Any]:
    """The columns of a table of ridge points in SI, by their names."""
    records = [name.removesuffix(f', {motion}') for name, motion in zip(points.names, points.motions, strict=True)]
    words = (np.array(each)[points.ridge] for each in (records, points.motions, points.sources or ('point',) * len(records)))
    record, motion, source = words
    return dict(zip(HEADER, (record, motion, points.xi, points.sigma_xi, points.frequencies_Hz, units.hertz(points.sigma_omega),
                             points.power / units.m**2, np.full(len(points), ''), *points.q.T, units.hertz(points.line),
                             points.bins, source), strict=True))


def read_ridges(*paths: str | PathLike[str]) -> RidgePoints:
    r"""Read tables of ridge points that `write_ridges` or any other program wrote.

    Parameters
    ----------
    *paths : path-like
        Texts with the columns xi_rad, sigma_xi_rad, frequency_Hz, sigma_frequency_Hz, q1 and q2.  A table written by hand may
        omit the others: record and motion, which distinguish ridges; power_m2 and bin_Hz, without which all points count as
        independent; source, which is then assumed to be a point; bin_xi_rad, which is then assumed to be that of 30 points.

    Returns
    -------
    RidgePoints
        The points of all tables; ridges with the same name in two tables stay separate.

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
    tables = [_read(path) for path in paths]
    again = Counter(name for table in tables for name in table.names)
    for k, (path, table) in enumerate(zip(paths, tables, strict=True)):
        names = tuple(f'{Path(path).stem}: {name}' if again[name] > 1 else name for name in table.names)
        tables[k] = replace(table, names=names, ridge=table.ridge + sum(len(one.names) for one in tables[:k]))
    return _joined(tables)


def _joined(tables):
    """One table of the ridges of several."""
    arrays = {key for key, column in vars(tables[0]).items() if isinstance(column, np.ndarray)}
    columns: dict[str, Any] = {key: np.concatenate([getattr(table, key) for table in tables]) if key in arrays else
                               sum((getattr(table, key) for table in tables), ()) for key in vars(tables[0])}
    return RidgePoints(**columns)


def _read(path):
    table = read_table(path, **ASKED)
    _refuse_impossible(table)
    ridges = list(zip(*(table.get(name, '').tolist() for name in ('record', 'motion', 'source')), strict=True))
    each = list(dict.fromkeys(ridges))
    names = tuple(', '.join(filter(None, (record, motion))) or 'of the whole table' for record, motion, _ in each)
    motions, sources = tuple(motion for _, motion, _ in each), tuple(source or 'point' for *_, source in each)
    ridge, q = np.array([each.index(one) for one in ridges]), np.stack([table['q1'], table['q2'], table.get('q3', 0.0)], axis=1)
    return RidgePoints(names, motions, ridge, q, table['xi'], table['sigma_xi'], table['frequency'], table['sigma_frequency'],
                       table.get('power', 1.0), table.get('bin', 0.0), sources, table.get('bin_xi', BIN_rad))


def _refuse_impossible(table):
    """Raise ValueError for values that no measured wave can have."""
    least, most = (value * FREQUENCY['Hz'] for value in RANGE_Hz)
    frequency = table['frequency']
    for name in ('frequency', 'sigma_frequency'):
        table.refuse(name, table[name] <= 0, 'be positive')
        table.refuse(name, (table[name] < least) | (table[name] > most), f'lie between {RANGE_Hz[0]:g} and {RANGE_Hz[1]:g} Hz')
    table.refuse('xi', (table['xi'] < 1e-9) | (table['xi'] > 2 * np.pi), 'be a positive phase per step, up to 2 pi')
    table.refuse('bin_xi', (table.get('bin_xi', BIN_rad) <= 0) | (table.get('bin_xi', BIN_rad) > 2 * np.pi),
                 'be 2 pi divided by the number of places in the row')
    table.refuse('sigma_xi', (table['sigma_xi'] < 0) | (table['sigma_xi'] > 2 * np.pi), 'lie between 0 and 2 pi')
    for name in ('sigma_frequency', 'bin'):
        table.refuse(name, table.get(name, 0.0) > frequency, 'be less than the frequency (are columns exchanged?)')
    table.refuse('bin', table.get('bin', 0.0) < 0, 'not be negative')
    for name in ('q1', 'q2', 'q3'):
        table.refuse(name, abs(table.get(name, 0.0)) > MOST_q,
                     f'be a component in reciprocal vectors, at most {MOST_q:g} in size')
    table.refuse('source', ~np.isin(table.get('source', 'row'), (*SOURCES, FIELD, '')), 'be row, point or field')
