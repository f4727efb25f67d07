"""The effect of a slight nonlinearity on a motion, by perturbation theory.

The linear motion u1 leaves a force N(u1) over, that of the law beyond its linear part, and this force drives a correction u2:

    u1'' + gamma u1' + K u1 = f        u2'' + gamma u2' + K u2 = N(u1)

With the energy psi(s) of a bond over the square s of its length, s = s0 + delta, its force is 2 psi'(s) (R + d), where psi' is
taken to third order in delta.  What u2 itself changes is smaller than u2 by about as much as u2 is smaller than u1.

Both motions are stepped in time by velocity Verlet with the same step, as a trial run with the law would be, so that their ratio
has the time-step error of such a run.  The force N is computed at many times at once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from ..dynamics.drives import Drives
from ..stability.amplitude_shifts import law_derivatives

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from ..dynamics.drives import ToneBurst
    from ..stiffness.linear_system import LinearSystem

TIMES = 8
"""Number of steps whose forces are computed at once, so that the arrays stay in the processor's cache."""


def relative_correction(system: LinearSystem, drive: ToneBurst, damping: float, row: NDArray[np.int_],
                        clock: tuple[float, int, int]) -> float:
    """Root mean square of the correction u2 of a burst from rest, over that of the linear motion u1, in a row.

    Parameters
    ----------
    system : LinearSystem
        At rest, planar.
    drive : ToneBurst
    damping : float
        gamma in 1/ms.
    row : ndarray of int
    clock : tuple of (float, int, int)
        Time step in ms, number of steps between two frames, and number of steps.
    """
    dt, interval, steps = clock
    rows, shapes = system.rows(row)
    force, linear, second = _Beyond(system), _Verlet(system, damping, dt), _Verlet(system, damping, dt)
    pushes = Drives([drive], len(system))
    driven = system.shapes[(pushes.particles[:, None] * system.dim + np.arange(system.dim)).ravel()].T
    frames = np.arange(interval, steps + 1, interval)
    size = np.zeros(2)
    for first in range(0, steps, TIMES):
        beginnings = np.arange(first, min(first + TIMES, steps))
        times = (dt * beginnings).astype(float)
        external = driven @ pushes.forces(times)[..., : system.dim].reshape(len(times), -1).T
        before = linear.y
        one = linear.moved(external.T)
        two = second.moved(force(np.vstack([before, one[:-1]])))
        seen = np.isin(beginnings + 1, frames)
        size += [np.sum((y[seen][:, rows] @ shapes.T) ** 2) for y in (one, two)]
    return float(np.sqrt(size[1] / size[0]))


class _Verlet:
    """Damped velocity Verlet steps of y'' + gamma y' + K y = g from rest, as those of `magphonon.dynamics.kernels_numpy`."""

    def __init__(self, system, damping, dt):
        self.K, self.dt, self.decay = system.K, dt, np.exp(-damping * dt)
        self.y = np.zeros(self.K.shape[0])
        self._v = np.zeros_like(self.y)  # half a step behind

    def moved(self, g):
        """The motion y after each of several steps, shape (steps, free), under the forces at their beginnings."""
        found, kick = np.empty_like(g), (1 + self.decay) * self.dt / 2
        for step, force in enumerate(g):
            self._v *= self.decay
            self._v += kick * (force - self.K @ self.y)
            self.y = self.y + self.dt * self._v
            found[step] = self.y
        return found


class _Beyond:
    """The force of the law beyond its linear part, from y to g, both of the shape (times, free)."""

    def __init__(self, system):
        calc, dim = system.calc, system.dim
        self.R = calc.bond_vectors.T[..., None]
        self.slopes = [2 * psi[:, None] for psi in law_derivatives(calc.law, calc.bonds.lengths)]
        self.stretch = sparse.vstack([calc.bonds.incidence @ system.shapes[x::dim] for x in range(dim)], format='csr')
        self.gather = sparse.csr_array(self.stretch.T)

    def __call__(self, y):
        psi2, psi3, psi4 = self.slopes
        d = (self.stretch @ y.T).reshape(len(self.R), -1, len(y))
        beyond = np.einsum('xbt,xbt->bt', d, d)
        delta = beyond + sum(2 * R * x for R, x in zip(self.R, d, strict=True))
        third = delta * delta * (psi3 / 2 + psi4 / 6 * delta)
        d *= psi2 * delta + third
        d += self.R * (psi2 * beyond + third)
        return -(self.gather @ d.reshape(-1, len(y))).T
