"""Branches of the bands along a row, and the distance of a measured ridge from each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..bands.bloch import bloch_modes
from ..errors import finite, one_of
from .spectrum import NORMAL, RESOLVED

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import ArrayLike

    from .spectrum import Ridge

BRANCH_POINTS = 2001
"""Number of samples of a branch; linear interpolation between them is accurate to 1e-6 of its highest frequency."""


@dataclass(frozen=True)
class Branch(units.InHertz):
    """One branch of the bands over the phase per step.

    Attributes
    ----------
    xi : ndarray, shape (points,)
        In rad, ascending.
    omega : ndarray, shape (points,)
        In rad/ms.
    """

    xi: np.ndarray
    omega: np.ndarray


def branch(atoms: Atoms, direction: ArrayLike, mode: int, model: str = 'complete') -> Branch:
    """Branch of the analytic bands for the waves that a row of particles sees.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion.
    direction : array_like, shape (3,)
        Wavevector of xi = 2 pi in fractions of the reciprocal vectors.  In the triangular lattice, along R2:
        (0, 1, 0) for plane waves from a row of sources along R1 (Gamma-M), (1/2, 1, 0) for the waves from a
        point source (Gamma-K).
    mode : int
        Number of the branch from below, from 0; in the triangular lattice shear is 0 and longitudinal 1.
    model : {'complete', 'conventional'}

    Returns
    -------
    Branch
        From xi = 0 to pi.

    Raises
    ------
    ValueError
        For an unknown model or mode.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene, ready_scene, units as u
    >>> from magphonon.waves import branch
    >>> shear = branch(read_scene(ready_scene('prototype')).atoms(), (0, 1, 0), 0)
    >>> round(float(u.hertz(shear.omega[-1])), 3)  # at M
    58.233
    """
    xi = np.linspace(0, np.pi, BRANCH_POINTS)
    omega, _ = bloch_modes(atoms, xi[:, None] / (2 * np.pi) * finite('direction', direction, (3,)), model)
    one_of('mode', mode, range(omega.shape[1]))
    return Branch(xi, omega[:, mode])


@dataclass(frozen=True)
class Misfit:
    """Distance of a ridge from a branch, root mean square over its points.

    Attributes
    ----------
    omega : float
        Along the frequency axis, at the wavenumber of each point, in rad/ms.
    sigma_omega : float
        What the uncertainty of the points alone makes of `omega`.
    bins : float
        Along the wavenumber axis, at the frequency of each point, in bins of the record.
    within : float
        Share of the points that are nearer to it along the frequency axis than 1.96 of their uncertainties.
    points : int
    """

    omega: float
    sigma_omega: float
    bins: float
    within: float
    points: int

    @property
    def agrees(self) -> bool:
        """Whether the ridge may be a wave of this branch.

        At least half of its points are within 1.96 of their uncertainties, and all together within a bin: two waves a bin
        apart are seen as two, however uncertain each is.
        """
        return self.within >= 0.5 and self.bins <= RESOLVED


def compare(ridge: Ridge, branch: Branch) -> Misfit:
    """Distance between a ridge and a branch along either axis.

    A branch that nowhere reaches a frequency is met where it comes nearest: there the wave is evanescent, and the
    real part of its wavenumber stays at that of the band edge.

    Parameters
    ----------
    ridge : Ridge
    branch : Branch

    Returns
    -------
    Misfit

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.waves import Branch, compare, ridge, wavenumber_frequency
    >>> t, x = np.arange(0, 400, 0.5)[:, None], np.arange(24)
    >>> s = t - x / 0.6 - 100
    >>> crest = ridge(wavenumber_frequency(1e-3 * np.exp(-((s / 20) ** 2)) * np.cos(0.5 * s), 0.5))
    >>> xi = np.linspace(0, np.pi, 50)
    >>> bool(compare(crest, Branch(xi, 0.6 * xi)).bins < 0.1 < compare(crest, Branch(xi, 0.8 * xi)).bins)
    True
    """
    own = np.interp(ridge.xi, branch.xi, branch.omega)
    d_omega = ridge.omega - own
    d_xi = ridge.xi - np.array([_nearest_crossing(branch, omega, xi) for omega, xi in zip(ridge.omega, ridge.xi, strict=True)])
    sides = [np.interp(ridge.xi + side * ridge.sigma_xi, branch.xi, branch.omega) - own for side in (1, -1)]
    sigma = np.hypot(ridge.sigma_omega, np.abs(sides).max(axis=0))  # not by the slope, which vanishes at the edge of the zone
    within = float(np.mean(abs(d_omega) <= NORMAL * sigma))
    return Misfit(_rms(d_omega), _rms(sigma), _rms(d_xi) / ridge.bin_xi, within, len(d_xi))


def _nearest_crossing(branch, omega, xi):
    above = branch.omega - omega
    before = np.flatnonzero(above[:-1] * above[1:] <= 0)
    if not len(before):
        return branch.xi[abs(above).argmin()]
    run, rise = branch.xi[before + 1] - branch.xi[before], above[before + 1] - above[before]
    crossings = branch.xi[before] - above[before] * run / np.where(rise == 0, np.inf, rise)
    return crossings[abs(crossings - xi).argmin()]


def _rms(x):
    return float(np.sqrt(np.mean(x**2)))
