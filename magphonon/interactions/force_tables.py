"""Measured forces of repulsion: points (r, f), with or without uncertainties, and the tables that hold them."""

from __future__ import annotations

import re
from dataclasses import dataclass
from math import isfinite
from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..errors import finite
from ..files import MEGABYTE, table_text
from .pair_laws import repulsion

if TYPE_CHECKING:
    from os import PathLike
    from typing import Any

    from numpy.typing import NDArray

    from .pair_laws import PairLaw

LENGTHS = {'m': u.m, 'mm': u.mm, 'um': 1e-3 * u.mm}
FORCES = {'N': u.N, 'mN': 1e-3 * u.N, 'uN': 1e-6 * u.N}
HEADER = 'its header must be r_m,f_N or r_m,f_N,sigma_N (or in mm, um, mN, uN: r_mm,f_mN)'
MOST_BYTES = 100 * MEGABYTE
"""Largest size of a table of forces: two million lines, read in about ten seconds."""
LARGEST_CLOSEST_PAIR = 1.0 * u.m
"""Largest distance of the closest pair in a column r_m; if it is larger, the column almost surely holds mm or um."""
FORCES_N = 1e-30, 1e12
"""Allowed range of forces in N; outside it a unit or an exponent is wrong, and squares and powers soon overflow."""
DISTANCES_m = 1e-12, 1e6
"""Allowed range of distances in m, for the same reason."""
REACH = 1.2
"""Factor by which a law is used beyond the range of its data; farther out, it is not supported by measurement."""


@dataclass(frozen=True)
class Forces:
    """Measured forces of repulsion.

    Attributes
    ----------
    r, f : ndarray, shape (n,)
        Distances in mm, increasing, and forces in N, all positive.
    sigma : ndarray, shape (n,), optional
        Standard uncertainties of the forces, N.

    Raises
    ------
    ValueError
        If an array breaks these conditions; the message counts the points from 1.
    """

    r: np.ndarray
    f: np.ndarray
    sigma: np.ndarray | None = None

    def __post_init__(self) -> None:
        columns = [('distance', 'm', self.r), ('force', 'N', self.f), ('sigma', 'N', self.sigma)]
        for name, unit, column in columns:
            if column is None:
                continue
            values = finite(name, column, np.shape(self.r))
            if not (values > 0).all():
                k = int(np.argmin(values > 0))
                mend = {'distance': 'distances are those of the centres', 'sigma': 'leave the column out if it is not known',
                        'force': 'repulsion is positive: turn the sign, or, if this is noise, drop this point and all '
                                 'farther ones'}[name]
                raise ValueError(f'{name} {k + 1} is {values[k] / getattr(u, unit):g} {unit}; {mend}')
        steps = np.diff(self.r)
        if not (steps > 0).all():
            k = int(np.argmin(steps > 0))
            what = 'occurs twice; average its forces' if steps[k] == 0 else 'comes after a larger one; sort the points'
            raise ValueError(f'distance {k + 2} ({self.r[k + 1] / u.m:g} m) {what}')

    def check_reach(self, spacing: float) -> None:
        """Raise ValueError where the `spacing` (mm) lies more than a factor REACH beyond these distances."""
        least, most = DISTANCES_m
        if not least <= spacing / u.m <= most:
            raise ValueError(f'the spacing {spacing / u.m:.3g} m must lie between {least:g} and {most:g} m; '
                             'check its unit and exponent')
        first, last = self.r[[0, -1]]
        beyond = max(first / spacing, spacing / last)
        if beyond <= REACH:
            return
        message = (f'the spacing {spacing / u.m:g} m lies {beyond:.3g} times beyond the data, {first / u.m:g} to '
                   f'{last / u.m:g} m; a law is not extrapolated by more than a factor {REACH:g}')
        for factor in (1e-3, 1e-6):  # given in mm or um
            if first <= factor * spacing <= last:
                raise ValueError(f'{message}; did you mean {factor * spacing / u.m:g} m?')
        raise ValueError(f'{message}; measure there')

    def binned(self, most: int) -> tuple[Forces, NDArray[Any]]:
        """Averages over at most `most` intervals of equal width in ln r, and the number of points in each.

        Returns
        -------
        Forces, ndarray of shape (bins,)
            If there are at most `most` points, the forces themselves, each counted once.
        """
        if len(self.r) <= most:
            return self, np.ones(len(self.r))
        x = np.log(self.r / self.r[0])
        _, starts, counts = np.unique(np.minimum((x / x[-1] * most).astype(int), most - 1), return_index=True, return_counts=True)
        weights = np.ones_like(x) if self.sigma is None else self.sigma**-2.0
        total = np.add.reduceat(weights, starts)
        r, f = (np.add.reduceat(weights * values, starts) / total for values in (self.r, self.f))
        return Forces(r, f, None if self.sigma is None else total**-0.5), counts


def read_forces(path: str | PathLike[str], contact: float = 0.0) -> Forces:
    """Forces from a table of text with a header such as r_m,f_N or r_mm,f_mN,sigma_mN.

    Columns are separated by commas, semicolons, tabs or spaces.  Lines that begin with # are comments; the header may be
    one of them.

    Parameters
    ----------
    path : path-like
    contact : float
        Distance of the centres at contact in mm, below which no measurement can lie.

    Raises
    ------
    OSError, ValueError
        If the file cannot be read, or is not such a table; the message says what is wrong and where.

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.interactions import read_forces
    >>> forces = read_forces(files('magphonon.data') / 'synthetic_force.csv')
    >>> len(forces.r), float(forces.r[0])  # in mm
    (15, 8.0)
    """
    try:
        text = table_text(path, MOST_BYTES)
    except OSError as error:
        raise type(error)(f'{path} cannot be read ({error.strerror})') from None
    units, columns = _parsed(path, text)
    try:
        forces = Forces(*(column * unit for column, unit in zip(columns, units, strict=True)))
        _refuse_absurd(forces)
        if units[0] == u.m and forces.r[0] >= LARGEST_CLOSEST_PAIR:
            raise ValueError(f'the distances are {forces.r[0] / u.m:g} to {forces.r[-1] / u.m:g} under the header r_m; if they '
                             'are millimetres, head the column r_mm')
        if forces.r[0] < contact:
            raise ValueError(f'distance 1 is {forces.r[0] / u.m:g} m, below contact at {contact / u.m:g} m; give distances '
                             'of the centres, not gaps')
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from None
    return forces


def _refuse_absurd(forces):
    for name, unit, (least, most), column in (('distance', 'm', DISTANCES_m, forces.r), ('force', 'N', FORCES_N, forces.f),
                                              ('sigma', 'N', FORCES_N, forces.sigma)):
        if column is not None:
            values = column / getattr(u, unit)
            for k in np.flatnonzero((values < least) | (values > most))[:1]:
                raise ValueError(f'{name} {k + 1} is {values[k]:.3g} {unit}, and must lie between {least:g} and {most:g} {unit}; '
                                 'check its unit and exponent')


def _parsed(path, text):
    """Units of the columns, and the columns themselves, shape (columns, n)."""
    units, rows = None, []
    for number, line in enumerate(text.splitlines(), 1):
        line = line.strip()
        named = _units(line.lstrip('#')) if 'r_' in line else None
        if named and units and named != units:
            raise ValueError(f'{path}, line {number}: {line[:60]!r} names other units than the header before it; '
                             'keep one of them')
        if named and not rows:
            units = named
        elif line and not line.startswith('#'):
            if units is None:
                raise ValueError(f'{path} begins with {line[:60]!r}; {HEADER}')
            row = _numbers(line)
            if len(row) != len(units):
                raise ValueError(f'{path}, line {number}: {line[:60]!r} is not {len(units)} numbers')
            rows.append(row)
    if units is None:
        raise ValueError(f"{path} begins with ''; {HEADER}")
    if not rows:
        raise ValueError(f'{path} holds no points below its header')
    return units, np.array(rows).T


def _cells(line):
    return [re.sub('^"(.*)"$', r'\1', cell) for cell in re.split(r'\s*[,;\t]\s*|\s+', line.strip())]


def _numbers(line):
    """The numbers of a line, or None if one of its cells is not a finite number."""
    for cells in (line.split(','), _cells(line)):  # most tables have commas, and splitting at commas takes a third of the time
        try:
            row = [float(cell) for cell in cells]
        except ValueError:
            row = []
        else:
            break
    return row if all(map(isfinite, row)) else []


def _units(line):
    """The units that a header names, as r_mm,f_N,sigma_mN does, or None for any other line."""
    match = re.fullmatch('r_(m|mm|um) f_(N|mN|uN)(?: sigma_(N|mN|uN))?', ' '.join(_cells(line)))
    if match is None:
        return None
    r, *forces = (name for name in match.groups() if name is not None)
    return [LENGTHS[r], *(FORCES[name] for name in forces)]


def synthetic_forces(law: PairLaw, r: Any, sigma: float | NDArray[np.float64], seed: int) -> Forces:
    """Forces of a `law` at distances `r` with Gaussian noise `sigma` (N): a synthetic measurement, to test a fit.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import synthetic_forces
    >>> synthetic_forces(InversePower(2000.0, 4.0), np.linspace(8, 15, 8), sigma=1e-3, seed=0).f.shape
    (8,)
    """
    noise = np.random.default_rng(seed).normal(scale=sigma, size=np.shape(r))
    return Forces(r, repulsion(law, r) + noise, np.broadcast_to(sigma, np.shape(r)))
