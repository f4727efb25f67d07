"""Waves that grow because the foundation is modulated: finds the fastest one in the whole zone.

Two waves grow together near w_a(q) + w_b(n kap - q) = n W. A shallow modulation makes these bands of wavevectors so narrow that a
mesh would miss them.  So the condition is solved for the waves of the mean lattice along the lines of a mesh, and the growth rate
of Floquet theory is maximised from each solution.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike
from scipy.optimize import minimize

from ..bands.floquet import Hill
from ..stiffness.bond import Model
from ..stiffness.matrices import poles
from ..traits import SPRUNG, takes

LINES = {1: 400, 2: 24, 3: 8}  # points of the mesh along each period, by the number of periods
ORDERS = 3  # largest n; growth goes as eps^n, and what is damped at all is damped more than by eps^4
SECANTS = 3  # steps to a zero between two points of the mesh, where frequencies are nearly straight
CLIMBED = 6  # number of places from which the growth is climbed
SETTLED, MOST = 1e-7, 20  # change of the growth, in W, at which no harmonic is added, and how many there are at most
SMALL = 60  # largest number of free directions of a finite structure whose growth is computed


@dataclass(frozen=True)
class ParametricGrowth:
    """Growth rate and wavevector of the wave that grows fastest on a modulated foundation.

    Attributes
    ----------
    rate : float
        Growth rate in 1/ms; negative or zero, up to round-off, if no wave grows.
    q : ndarray, shape (3,)
        Wavevector of this wave in fractions of the reciprocal vectors.
    """

    rate: float
    q: np.ndarray


@takes('modulation', *SPRUNG)
def parametric_growth(atoms: Atoms, model: Model | None = None, damping: ArrayLike = 0.0) -> ParametricGrowth | None:
    """The wave that grows fastest on a `Travelling` foundation; None for a finite structure of too many particles.

    Parameters
    ----------
    atoms, model, damping
        As for `magphonon.floquet_bands`; a finite structure of up to about thirty particles is accepted, too.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, Travelling, lattices
    >>> from magphonon.stability import parametric_growth
    >>> cell = lattices.chain(1.0, 1.0)
    >>> k = Travelling(5.0, 0.1, W=4.0, kap=(0, 0))  # twice the frequency of a wave
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=k)
    >>> parametric_growth(cell).rate > 0.05, parametric_growth(cell, damping=0.2).rate > 0
    (True, False)
    """
    hill = Hill(atoms, model, damping)
    periodic = np.flatnonzero(atoms.pbc)
    if not len(periodic):
        return ParametricGrowth(_settled(hill, np.zeros(3), ORDERS), np.zeros(3)) if hill.modes <= SMALL else None
    places = _resonances(hill, periodic)
    rates = hill.growth(places, ORDERS)

    def slower(x):
        q = np.zeros(3)
        q[periodic] = x
        return -hill.growth(q[None], ORDERS)[0]

    top = ParametricGrowth(-np.inf, np.zeros(3))
    for start in places[np.argsort(-rates)[:CLIMBED], :][:, periodic]:
        step = np.vstack([start, start + 1e-3 * np.eye(len(start))])
        found = minimize(slower, start, method='Nelder-Mead', options={'initial_simplex': step, 'xatol': 1e-9, 'fatol': 1e-12,
                                                                     'maxfev': 60 * len(start)})
        if -found.fun > top.rate:
            q = np.zeros(3)
            q[periodic] = found.x
            top = ParametricGrowth(float(-found.fun), q)
    return ParametricGrowth(_settled(hill, top.q, ORDERS), top.q)


def _settled(hill, q, harmonics):
    """The growth rate at a wavevector, with as many harmonics as it needs to converge."""
    rate, before = hill.growth(q[None], harmonics)[0], np.inf
    while abs(rate - before) > SETTLED * hill.W and harmonics < MOST:
        harmonics += 1
        rate, before = hill.growth(q[None], harmonics)[0], rate
    return float(rate)


def _resonances(hill, periodic):
    """Wavevectors at which two waves of the mean lattice meet through the modulation, and the corners of the zone."""
    lines = LINES[len(periodic)]
    grid = np.zeros((*(lines,) * len(periodic), 3))
    grid[..., periodic] = np.stack(np.meshgrid(*[np.arange(lines) / lines - 0.5] * len(periodic), indexing='ij'), axis=-1)
    found: list[Any] = [np.array([*product((0, 0.5), repeat=3)]) * np.isin(range(3), periodic)]

    def frequencies(q):
        found = np.sort(poles(hill.B, hill.system.bloch(q.reshape(-1, 3), hill.model)).imag, axis=1)[:, hill.modes :]
        return found.reshape(*q.shape[:-1], hill.modes)

    def detuning(q, a, b, n):
        pairs = frequencies(q), frequencies(q - n * hill.kap)
        return np.take_along_axis(pairs[0], a, -1) + np.take_along_axis(pairs[1], b, -1) - n * hill.W

    here = frequencies(grid)
    for n in range(1, ORDERS + 1):
        there = frequencies(grid - n * hill.kap)
        off = here[..., :, None] + there[..., None, :] - n * hill.W
        for axis, along in enumerate(periodic):
            low, high = off, np.roll(off, -1, axis)
            *at, a, b = np.nonzero((low <= 0) != (high <= 0))
            if not len(a):
                continue
            step = np.eye(3)[along] / lines
            q, f = grid[tuple(at)], [x[(*at, a, b)] for x in (low, high)]
            s = [np.zeros(len(q)), np.ones(len(q))]
            for _ in range(SECANTS):
                new = np.clip(s[0] - f[0] * (s[1] - s[0]) / (f[1] - f[0]), s[0], s[1])
                value = detuning(q + new[:, None] * step, a[:, None], b[:, None], n)[:, 0]
                left = (value <= 0) == (f[0] <= 0)
                s, f = [[np.where(side, v, old) for side, old in ((left, pair[0]), (~left, pair[1]))]
                        for v, pair in ((new, s), (value, f))]
            found.append(q + new[:, None] * step)
    return np.concatenate(found)
