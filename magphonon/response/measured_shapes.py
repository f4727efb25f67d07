"""Measured mode shapes against computed ones, by the modal assurance criterion (Allemang and Brown, IMAC 1982, p. 110).

    MAC = |a*.b|^2 / (|a|^2 |b|^2)      over the places and directions that were measured

The MAC is 1 for equal shapes, whatever their amplitude and phase. If all directions are measured, only one of the orthogonal
computed shapes can have a MAC above one half. With few measured directions shapes may agree by chance: for n random real numbers
the MAC has the distribution Beta(1/2, (n - 1)/2).
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy.special import betaincinv

from .. import units as u
from ..quantities import FREQUENCY, LENGTH, PURE, SPEED, TEXT
from ..tables import read_table
from .normal_modes import Modes

ANY = PURE | LENGTH | SPEED  # of amplitudes, whose unit does not matter
COLUMNS = {'mode': TEXT, 'frequency': FREQUENCY, 'x': LENGTH, 'y': LENGTH} | {
    f'{name}{part}': ANY for name in ('u_x', 'u_y') for part in ('', '_im')}
LAYOUT = ('a table of measured shapes has the columns mode,x_m,y_m and u_x or u_y or both, a row for each mode and particle, and '
          'where known frequency_Hz and the imaginary parts u_x_im, u_y_im, of motion Re u e^{-i omega t}')
NEAR = 0.25  # of the spacing: the farthest that a measured point may be from its particle
ALIKE = 0.5
"""MAC above which no other computed shape can be as similar to a measured one, if all directions were measured."""
CHANCE = 0.01
"""Probability with which the best of all computed shapes may have the MAC of a match by chance."""
FAR = 0.25  # relative distance in frequency beyond which shapes alike are no match; a law known to 10 % gives a fifth


@dataclass(frozen=True)
class Comparison:
    """Similarity of measured mode shapes to all computed ones.

    Attributes
    ----------
    names : tuple of str
        Names of the measured shapes.
    omega : ndarray, shape (measured,)
        Angular frequencies of the measured shapes in rad/ms; NaN where not known.
    mac : ndarray, shape (measured, modes)
        Modal assurance criterion with each computed mode.
    least : ndarray, shape (measured,)
        The MAC that a match needs: more than `ALIKE`, and more than chance gives with this number of measured directions; 1 for a
        single direction.
    best : ndarray of int, shape (measured,)
        The most similar computed mode for each measured shape, among those within `FAR` of the measured frequency if one of them
        matches, otherwise among all.
    """

    names: tuple[str, ...]
    omega: NDArray[np.float64]
    mac: NDArray[np.float64]
    least: NDArray[np.float64]
    best: NDArray[np.int_]


def compared(path: str | PathLike[str], atoms: Atoms, found: Modes) -> Comparison:
    r"""Compare a table of measured shapes with the modes of a structure.

    Parameters
    ----------
    path : path-like
        A row for each mode and measured particle, with its place at rest; amplitudes in any unit.
    atoms : ase.Atoms
        The structure, in the frame of the measured places.
    found : Modes
        Modes of this structure.

    Raises
    ------
    ValueError
        For a frequency that is not positive, a place farther than a quarter of the spacing from every particle, or a place that
        appears twice in a mode.

    Examples
    --------
    >>> import tempfile
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> from magphonon.response import compared
    >>> patch = lattices.hexagon(lattices.triangular(10.0, 1.0), 20.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1e4, 4.0), foundation=1.0)
    >>> found = modes(patch)
    >>> rows = [f'1,{x},{y},{ux},{uy}' for (x, y, _), (ux, uy) in zip(patch.positions, found.shapes[3])]
    >>> file = tempfile.mkdtemp() + '/shapes.csv'
    >>> with open(file, 'w') as table:
    ...     _ = table.write('\n'.join(['mode,x_mm,y_mm,u_x,u_y', *rows]))
    >>> compared(file, patch, found).mac[0].argmax()
    np.int64(3)
    """
    table = read_table(path, COLUMNS, ['mode', 'x', 'y'], others=False, layout=LAYOUT)
    axes = [k for k, name in enumerate(('u_x', 'u_y')) if name in table]
    if not axes:
        raise ValueError(f'{path} has neither u_x nor u_y; {LAYOUT}')
    table.refuse('frequency', table.get('frequency', 1.0) <= 0, 'be positive; leave the column out if it is unknown')
    away = np.linalg.norm(atoms.positions[:, None, :2] - np.stack([table['x'], table['y']], axis=1), axis=2)
    particle, spacing = away.argmin(axis=0), atoms.calc.bonds.lengths.min()  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]
    for row in np.flatnonzero(away.min(axis=0) > NEAR * spacing)[:1]:
        raise ValueError(f'line {table.lines[row]} of {path}: the nearest particle is {away[:, row].min() / u.mm:.3g} mm from '
                         f'{table.named("x", "y")}; give positions at rest, in the frame of the scene')
    shape = np.stack([table[name] + 1j * table.get(f'{name}_im', 0.0) for name in ('u_x', 'u_y') if name in table], axis=1)
    names = tuple(dict.fromkeys(map(str, table['mode'])))
    mac, omega, least = np.empty((len(names), len(found.omega))), np.full(len(names), np.nan), np.ones(len(names))
    for k, name in enumerate(names):
        rows = np.flatnonzero(table['mode'] == name)
        at, a = particle[rows], shape[rows].ravel()
        if len(np.unique(at)) < len(at):
            raise ValueError(f'{path}: the mode {name} has two rows for one particle; give each particle one row')
        if not a.any():
            raise ValueError(f'{path}: nothing moves in the mode {name}; leave it out')
        b = found.shapes[:, at][..., axes].reshape(len(found.omega), -1)
        square = (abs(b) ** 2).sum(axis=1)
        mac[k] = np.minimum(abs(b.conj() @ a) ** 2 / np.where(square > 0, square, np.inf) / (abs(a) ** 2).sum(), 1)  # round-off
        omega[k] = table['frequency'][rows[0]] if 'frequency' in table else np.nan
        if len(a) > 1:
            by_chance = betaincinv(0.5, (len(a) - 1) / 2, (1 - CHANCE) ** (1 / len(found.omega)))
            least[k] = max(ALIKE, by_chance)
    near = np.where(abs(found.omega - omega[:, None]) <= FAR * omega[:, None], mac, 0.0)  # nothing is near an unknown frequency
    best = np.where(near.max(axis=1) > least, near.argmax(axis=1), mac.argmax(axis=1))
    return Comparison(names, omega, mac, least, best)
