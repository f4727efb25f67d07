"""Measured forces of repulsion: points (r, f), with or without uncertainties, and the tables that hold them."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np
from numpy.typing import NDArray

from .. import units as u
from ..errors import finite, not_negative
from ..quantities import FORCE, LENGTH, TEXT
from ..tables import read_table

COLUMNS = {'r': LENGTH, 'gap': LENGTH, 'stroke': LENGTH, 'f': FORCE, 'sigma': FORCE, 'sigma_r': LENGTH, 'direction': TEXT,
           'pair': TEXT}
LAYOUT = ('a table of forces has the columns r_m,f_N (or in mm, um, mN, uN; also as r [mm]; or gap_mm and the size of a magnet),'
          ' and perhaps sigma_N, sigma_r_mm, direction and pair')
ASKED = {'columns': COLUMNS, 'needed': [('r', 'gap', 'stroke'), 'f'], 'layout': LAYOUT}
DIRECTIONS = {'approach': -1.0, '-1': -1.0, 'return': 1.0, '1': 1.0, '+1': 1.0, '': 0.0, '0': 0.0}
"""Words of the column `direction`."""
MOST_NAMED = 5  # number of lines that a message lists
LARGEST_CLOSEST_PAIR = 1.0 * u.m
"""Largest distance of the closest pair in a column r_m; if it is larger, the column almost surely holds mm or um."""
FORCES_N = 1e-30, 1e12  # allowed range; outside it a unit or an exponent is wrong, and squares and powers soon overflow
DISTANCES_m = 1e-12, 1e6  # allowed range of distances in m, for the same reason
MOST_STEPS = 10.0  # steps of a load cell of few digits, above which two forces cannot be equal by chance
BALANCES = 'gf', 'mgf', 'kgf'  # units of a balance
REACH = 1.5  # factor by which a law is used beyond the range of its data; farther out, it is not supported by measurement


@dataclass(frozen=True)
class Forces:
    """Measured forces of repulsion.

    Attributes
    ----------
    r, f : ndarray, shape (n,)
        Distances in mm, in any order and possibly repeated, and forces in N, which are negative where noise or a wrong zero
        exceeds them.
    sigma : ndarray, shape (n,), optional
        Standard uncertainties of the forces, N.
    direction : ndarray, shape (n,), optional
        -1 on the approach, +1 on the return, 0 (the default) where it is not known.
    pair : ndarray of str, shape (n,), optional
        Name of the pair of magnets in each row; by default there is one pair.
    sigma_r : ndarray, shape (n,)
        Standard uncertainty of the distance of each row in mm, by its own and not shared; zero by default.  A scale that is read
        to 0.5 mm has 0.5/sqrt(12) = 0.14 mm.
    balance : bool
        Whether the forces are weights on a balance, which is set to zero before.
    """

    r: np.ndarray
    f: np.ndarray
    sigma: np.ndarray | None = None
    direction: np.ndarray = None  # pyright: ignore[reportAssignmentType]  zeros, by __post_init__
    pair: np.ndarray = None  # pyright: ignore[reportAssignmentType]  one name, by __post_init__
    sigma_r: np.ndarray = 0.0  # pyright: ignore[reportAssignmentType]  one for each row, by __post_init__
    balance: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, 'r', finite('r', self.r))
        for name in ('f', 'sigma', 'direction'):
            if (column := getattr(self, name)) is not None:
                object.__setattr__(self, name, finite(name, column, self.r.shape))
        if not self.r.size:
            raise ValueError('a table of forces needs rows')
        for name, column in (('distances', self.r), ('sigma', self.sigma)):
            if column is not None and not (np.asarray(column) > 0).all():
                raise ValueError(f'{name} must be positive, but the smallest is {np.min(column):g}')
        if self.direction is None:
            object.__setattr__(self, 'direction', np.zeros(np.shape(self.r)))
        object.__setattr__(self, 'pair', np.broadcast_to('' if self.pair is None else self.pair, np.shape(self.r)))
        object.__setattr__(self, 'sigma_r', np.broadcast_to(finite('sigma_r', self.sigma_r), np.shape(self.r)))
        not_negative('sigma_r', float(self.sigma_r.min()), 'mm')

    def __getitem__(self, kept: NDArray[np.int_]) -> Forces:
        sigma = None if self.sigma is None else self.sigma[kept]
        return Forces(self.r[kept], self.f[kept], sigma, self.direction[kept], self.pair[kept], self.sigma_r[kept], self.balance)

    @property
    def pairs(self) -> int:
        """Number of different pairs that were measured."""
        return len(np.unique(self.pair))

    @property
    def middle(self) -> float:
        """Median of the distances in mm."""
        return float(np.sort(self.r)[len(self.r) // 2])

    @property
    def saturated(self) -> NDArray[np.bool_]:
        """Rows that share one largest force although their distances or noise should make them differ: the load cell was
        saturated.
        """
        top = self.f == self.f.max()
        steps = np.diff(np.unique(self.f)).min(initial=np.inf)
        grows = self.f.max() * np.ptp(self.r[top]) / self.r[top].min()  # at least, of forces that fall as 1/r
        order = np.lexsort((self.f, self.r))
        again = np.diff(self.f[order])[np.diff(self.r[order]) == 0]  # of distances that were measured again
        # of 30 steps: equal by chance in one table of a hundred
        differs = np.median(again) / 3 if len(again) and top.sum() > 1 else 0.0
        return top & (max(grows, differs) > MOST_STEPS * steps)

    def thinned(self, most: int) -> Forces:
        """Every n-th row in order of distance, so that at most `most` rows are left; the forces themselves if they are fewer."""
        if len(self.r) <= most:
            return self
        return self[np.sort(np.argsort(self.r, kind='stable')[:: -(-len(self.r) // most)])]  # in the order of time

    def check_reach(self, spacing: float) -> None:
        """Raise ValueError if the `spacing` (mm) is outside the range of distances by more than the factor REACH."""
        least, most = DISTANCES_m
        if not least <= spacing / u.m <= most:
            raise ValueError(f'the spacing {spacing / u.m:.3g} m must lie between {least:g} and {most:g} m; '
                             'check its unit and its power of ten')
        first, last = self.r.min(), self.r.max()
        beyond = max(first / spacing, spacing / last)
        if beyond <= REACH:
            return
        message = (f'the spacing {spacing / u.m:g} m is a factor {beyond:.3g} beyond the data, {first / u.m:g} to '
                   f'{last / u.m:g} m; a law is not extrapolated by more than a factor {REACH:g}')
        for factor in (1e-3, 1e-6):  # given in mm or um
            if first <= factor * spacing <= last:
                raise ValueError(f'{message}; did you mean {factor * spacing / u.m:g} m?')
        raise ValueError(f'{message}; measure there')


def read_forces(path: str | PathLike[str], contact: float = 0.0) -> Forces:
    """Forces from a table with a header such as r_m,f_N or r_mm,f_mN,sigma_mN; see `magphonon.tables`.

    Rows may be in any order, and distances may repeat, as on approach and return.

    Parameters
    ----------
    path : path-like
    contact : float
        Distance of the centres at contact in mm, below which no measurement can lie; needed for a column of gaps.

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.interactions import read_forces
    >>> forces = read_forces(files('magphonon.data') / 'synthetic_force.csv')
    >>> len(forces.r), float(forces.r[0])  # in mm
    (15, 8.0)
    """
    table = read_table(path, **ASKED)
    if 'r' in table and 'gap' in table:
        raise ValueError(f'{path}: the columns {table.named("r", "gap")} say the same; keep one of them')
    r = table['r'] if 'r' in table else _distances(table, contact)
    way = table.get('direction', '')
    table.refuse('direction', np.array([word not in DIRECTIONS for word in way]), 'be approach or return')
    _refuse_impossible(table, r, contact)
    return Forces(r, table['f'], table.columns.get('sigma'), np.array([DIRECTIONS[word] for word in way]),
                  np.asarray(table.get('pair', ''), str), table.get('sigma_r', 0.0),
                  table.units['f'] in [FORCE[name] for name in BALANCES])


def _refuse_impossible(table, r, contact):
    """Raise ValueError that says all that is wrong with the sizes of distances, forces and uncertainties."""
    least = max(DISTANCES_m[0], contact / u.m)
    faults = [
        _fault(table, 'r' if 'r' in table else 'gap', r / u.m, 'm', (least, DISTANCES_m[1]),
               f'the particles touch at {contact / u.m:g} m; give distances of the centres, not gaps' if contact else
               'distances are those of the centres; check the unit'),
        _fault(table, 'f', table['f'] / u.N, 'N', (-FORCES_N[1], FORCES_N[1]), 'check the unit'),
        _fault(table, 'sigma', table.get('sigma', u.N) / u.N, 'N', FORCES_N,
               'leave the column out if the uncertainty is not known, and check its unit')]
    if 'r' in table and table.units['r'] == u.m and r.min() >= LARGEST_CLOSEST_PAIR:
        faults.append(f'the distances are {r.min() / u.m:g} to {r.max() / u.m:g} under the header {table.named("r")}; if '
                      'they are millimetres, head the column r_mm')
    if any(faults):
        raise ValueError(f'{table.path}: {"; also: ".join(filter(None, faults))}')
    if not np.sum(table['f'] / r) > 0:  # the near ones count most
        raise ValueError(f'{table.path}: the forces are negative, but repulsion counts as positive: change their sign')


def _distances(table, contact):
    """Distances of the centres: the gap of each row plus the distance at contact; ValueError for the stroke of a machine."""
    if 'gap' not in table:
        raise ValueError(f'{table.path}: {table.named("stroke")} counts from any zero, but a law needs distances; call the '
                         'column r_mm if it is the distance of the centres, gap_mm if it is zero at contact')
    if not contact:
        raise ValueError(f'{table.path}: {table.named("gap")} holds gaps, but a law needs distances of the centres; give the '
                         'size of a magnet along the line between them, as in "magphonon fit --contact 6.35mm" or '
                         'read_forces(path, contact=6.35); or add it to the gaps and call the column r_mm')
    table.refuse('gap', table['gap'] < 0, 'not be negative')
    return table['gap'] + contact


def _fault(table, name, values, unit, allowed, mend):
    """A message that says which lines of a column are out of the `allowed` range; '' if none is."""
    wrong = np.flatnonzero((values < allowed[0]) | (values > allowed[1]))
    if not len(wrong):
        return ''
    lines = ', '.join(f'{values[k]:.6g} {unit} in line {table.lines[k]}' for k in wrong[:MOST_NAMED])
    more = f' and {len(wrong) - MOST_NAMED} more' if len(wrong) > MOST_NAMED else ''
    return f'{table.named(name)} must lie between {allowed[0]:g} and {allowed[1]:g} {unit}, but is {lines}{more}: {mend}'
