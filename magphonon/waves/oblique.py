"""Oblique waves that a point source sends along a row: their energy runs along it, their wavevector does not.

Waves of all directions leave a point.  Along a row of the lattice vector R those arrive whose group velocity points along R.  Let
xi = k.R be the phase per step, and s a shift of the wavevector, in units of the primitive reciprocal vector across R, that leaves
xi as it is.  The velocity has no component away from the row where

    d omega(xi, s) / ds = 0

so that the row shows every extremum of omega over s; by symmetry the wave along the row, s = 0, is one of them.  Two waves nearer
than the main lobe of the Hann window make one peak on a map, somewhere between them.  The ridge is then off at all frequencies in
the same sense, so that neither noise, nor the halves of the row, nor jumps from line to line show it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..bands.bloch import bloch_modes

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

SAMPLES = 96
"""Samples of xi from 0 to pi, and of s over its period, in a cell of one particle; the zone of larger cells is smaller."""
LOBE_bins = 2.0
"""Half width of the main lobe of a Hann window in wavenumber bins: waves that are nearer make one peak."""


def oblique_waves(cell: Atoms, q: ArrayLike, omega: ArrayLike, model: str = 'complete') -> NDArray[np.float64]:
    """Phases per step of waves of which the energy runs along a row, away from the source, and the wavevector does not.

    Parameters
    ----------
    cell : ase.Atoms
        With its MagneticRepulsion.
    q : array_like, shape (3,)
        Wavevector of xi = 2 pi along the row, in fractions of the reciprocal vectors, as `wavevector(cell, 'point')`.
    omega : array_like, shape (frequencies,)
        In rad/ms.
    model : {'complete', 'conventional'}

    Returns
    -------
    ndarray, shape (frequencies, waves)
        In rad; NaN where a wave does not have this frequency.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene, ready_scene, units as u
    >>> from magphonon.waves import oblique_waves, wavevector
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> xi = oblique_waves(cell, wavevector(cell, 'point'), [2 * np.pi * 40 * u.Hz])
    >>> np.unique(xi[np.isfinite(xi)].round(1)).tolist()
    [1.3]
    """
    return _waves(cell, q, omega, model)[1]


def blur(cell: Atoms, q: ArrayLike, xi: NDArray[np.float64], omega: NDArray[np.float64], lobe: float,
         model: str = 'complete') -> NDArray[np.float64]:
    """How far the ridge of a point source may lie from the wave along the row, where oblique waves blend with it.

    Parameters
    ----------
    cell, q, model
        As for `oblique_waves`.
    xi, omega : ndarray, shape (points,)
        The ridge.
    lobe : float
        Distance in xi within which waves make one peak, LOBE_bins bins.

    Returns
    -------
    ndarray, shape (points,)
        Distance in xi from the nearest wave along the row to the farthest oblique wave that is within the lobe about it and about
        the point.
    """
    along, oblique = _waves(cell, q, omega, model)
    away = abs(along - xi[:, None])
    own = np.take_along_axis(along, np.where(np.isnan(away), np.inf, away).argmin(axis=1)[:, None], axis=1)
    beside = (abs(oblique - xi[:, None]) < lobe) & (abs(oblique - own) < lobe)
    return np.nanmax(np.where(beside, abs(oblique - own), 0), axis=1, initial=0)


def _waves(cell, q, omega, model):
    """Phases per step at these frequencies of the waves along the row, and of the oblique ones, each (frequencies, waves)."""
    q = np.asarray(q, float)
    samples = int(np.ceil(SAMPLES / np.sqrt(len(cell))))
    xi, s = np.pi * (np.arange(samples) + 0.5) / samples, np.arange(samples) / samples
    at = xi[:, None, None] / (2 * np.pi) * q + s[:, None] * _across(cell, q)
    field = bloch_modes(cell, at.reshape(-1, 3), model)[0].reshape(samples, samples, -1)
    before, after = np.roll(field, 1, axis=1), np.roll(field, -1, axis=1)
    extreme = (field - before) * (field - after) > 0
    along = np.zeros_like(extreme)
    along[:, 0] = True
    slope = np.gradient(field, xi, axis=0)
    with np.errstate(divide='ignore', invalid='ignore'):
        peak = field - np.where(extreme, (after - before) ** 2 / (8 * (after + before - 2 * field)), 0)

    def crossing(some):
        start, runs = xi[np.nonzero(some)[0]], slope[some]
        with np.errstate(divide='ignore', invalid='ignore'):
            found = start + (np.reshape(omega, (-1, 1)) - peak[some]) / runs
        return np.where((abs(found - start) <= xi[1] - xi[0]) & (runs > 0), found, np.nan)

    return crossing(along), crossing(extreme & ~along)


def _across(cell, q):
    """The primitive reciprocal vector across the row, in fractions; zero in a chain, whose waves have one direction."""
    fractions = np.linalg.pinv(cell.cell.array)
    k = fractions @ q
    R = np.rint(k @ fractions / (k @ k))  # the step of the row, in lattice vectors
    return np.array([-R[1], R[0], 0]) * cell.pbc[:2].all()
