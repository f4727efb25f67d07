"""Straight rows of measured points: finds the row of the lattice that was measured, and the step at which each point lies."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from math import gcd

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import finite, one_of
from .ridge_tables import SOURCES
from .wave_source import NEAR

FARTHEST = 3  # largest multiple of a lattice vector in a step of a row; rows along others have few particles
TURNED = np.radians(2.0)
"""Angle up to which a row of points may be turned against the row of the lattice: directions of rows are 6 degrees apart."""
STRETCHED = 0.03
"""If the measured step differs from that of the lattice by more than this fraction, the record is of another lattice. Frequencies
of magnets vary with the spacing as r^-2.8, so they would be wrong by 8 %."""
MOST_APART = 50  # number of steps between neighbouring points above which their unit must be wrong


@dataclass(frozen=True)
class Row:
    """Measured points on a row of a lattice, with the step of each."""

    order: np.ndarray  # shape (points,): the points, one after the other along the row
    steps: np.ndarray  # shape (points,): place of each of them in steps from the first; what is missing is skipped
    vector: np.ndarray  # shape (3,): one step, a lattice vector in mm

    @property
    def reversed(self) -> Row:
        """The same row, begun at its other end."""
        return Row(self.order[::-1], self.steps[-1] - self.steps[::-1], -self.vector)

    def wavevector(self, cell: Atoms, source: str) -> NDArray[np.float64]:
        """Wavevector of xi = 2 pi along this row, in fractions of the reciprocal vectors, shape (3,).

        Parameters
        ----------
        cell : ase.Atoms
        source : {'row', 'point'}
            'row' for fronts along R1, 'point' for fronts across the measured row.
        """
        normal = self.vector
        if one_of('source', source, SOURCES) == 'row':
            R1 = cell.cell.array[0]
            normal = self.vector - (self.vector @ R1) / (R1 @ R1) * R1
            if np.linalg.norm(normal) < NEAR * np.linalg.norm(self.vector):
                raise ValueError("the measured row runs along R1, as do the fronts of waves from a row of sources ('row'): "
                                 "all its points move alike; for waves that run along the row choose the source 'point'")
        return cell.cell.array @ normal / (normal @ self.vector) * cell.pbc


def row_of(places: ArrayLike, cell: Atoms) -> Row:
    """The row of a lattice on which measured points lie; `places`, shape (points, 2) in mm, have any origin and any order."""
    places = finite('places', places)
    if places.ndim != 2 or places.shape[1] != 2 or len(places) < 2:
        raise ValueError(f'a row needs the positions of at least two points, shape (points, 2), not {places.shape}')
    spacing = cell.calc.bonds.lengths.min() if cell.calc is not None else min(cell.cell.lengths()[cell.pbc])
    along = _direction(places, spacing)
    vector = _lattice_row(along, cell)
    s = places @ along
    order = np.argsort(s)
    return Row(order, _steps(s[order], float(np.linalg.norm(vector))), vector)


def _direction(places, spacing):
    """Unit vector along the points, upwards or, if horizontal, towards +x; ValueError if they lie on no line."""
    away = places - places.mean(axis=0)
    along, across = np.linalg.svd(away)[2]
    along = along * (1 if (along[1].round(3), along[0]) > (0, 0) else -1)
    off = away @ across
    if np.ptp(off) <= 2 * NEAR * spacing:
        return along
    rows = np.sort(off)
    parts = np.split(rows, np.flatnonzero(np.diff(rows) > NEAR * spacing) + 1)
    if min(map(len, parts)) > 1 and max(map(np.ptp, parts)) <= 2 * NEAR * spacing:
        words = (f'they lie on {len(parts)} rows, about {parts[1].mean() - parts[0].mean():.2g} mm apart; keep the '
                 'points of one of them')
    else:
        k = int(abs(off).argmax())
        words = (f'point {k + 1} at ({_mm(places[k, 0])}, {_mm(places[k, 1])}) is {_mm(abs(off[k]))} off the line through all '
                 'points; omit points that are not on the row')
    raise ValueError(f'the measured points do not lie on one straight row: {words}')


def _lattice_row(along, cell):
    """The shortest lattice vector in the direction of the points."""
    R = cell.cell.array[:2][cell.pbc[:2]]
    vectors = np.array([n for n in product(range(-FARTHEST, FARTHEST + 1), repeat=len(R)) if gcd(*n) == 1]) @ R
    cosines = vectors[:, :2] @ along / np.linalg.norm(vectors, axis=1)
    k = int(cosines.argmax())
    if cosines[k] < np.cos(TURNED):
        own, nearest = (np.degrees(np.arctan2(y, x)) for x, y in (along, vectors[k, :2]))
        raise ValueError(f'the measured row runs at {own:.4g} degrees from the x axis, and no row of the lattice does; the '
                         f'nearest runs at {nearest:.4g} degrees. Give the positions in the frame of the '
                         'scene, whose R1 lies along x')
    return vectors[k]


def _steps(s, step):
    """Number of steps of each point from the first, for ascending distances s; ValueError if they are no whole numbers."""
    apart = np.diff(s) / step
    ratio = np.median(apart)
    hint = ('are the positions in mm, under a header in m?' if ratio > MOST_APART else
            'are the positions in m, under a header in mm?' if ratio < 1 / MOST_APART else
            'check the unit of the positions, and the spacing of the scene')
    each = np.rint(apart).astype(int)  # from each to the next, so that a scale that is a little off does not add up
    if each.min() < 1:
        k = int(each.argmin())
        raise ValueError(f'two of the measured points are {_mm(s[k + 1] - s[k])} apart, and one step along the row of the '
                         f'lattice is {_mm(step)}; {hint}')
    if np.median(each) > MOST_APART:
        raise ValueError(f'the measured points are {_mm(np.median(np.diff(s)))} apart, and one step along the row of the lattice '
                         f'is {_mm(step)}; {hint}')
    n = np.concatenate([[0], np.cumsum(each)])
    own, zero = np.polyfit(n, s, 1)
    if abs(own / step - 1) > STRETCHED:
        raise ValueError(f'a step of the measured row is {_mm(own)}, and of the lattice {_mm(step)}; {hint}')
    off = abs(s - own * n - zero)
    if off.max() > NEAR * step:
        k = int(off.argmax())
        raise ValueError(f'the point {_mm(s[k] - s[0])} along the measured row is {_mm(off[k])} off a whole number of steps of '
                         f'{_mm(own)}; leave it out, or correct its position')
    return n


def _mm(length):
    return f'{length / units.mm:.4g} mm'
