"""Nonlinear modes: periodic free vibrations of a finite structure at growing amplitude, and whether they are stable.

With the coordinates u = S y of the linear system and the vibration ``y = sum_h c_h cos(h W t)``, whose velocity is zero at t = 0,
the equations ``y'' = f(y)`` become

    R_h = (h W)^2 c_h + f_h(c) = 0          dR_h/dc_k = (h W)^2 delta_hk - K_hk          K_hk = <2 cos(h W t) K(y(t)) cos(k W t)>

(the mean over a period, without the factor 2 for h = 0), which Newton's method solves along the arc of the solutions, so that it
goes round folds of amplitude or frequency.  The growth of a small disturbance over a period, ``x'' = -K(y(t)) x``, is given by
Floquet's multipliers. They come in fours, mu, 1/mu and their conjugates, and the vibration is stable if all lie on the unit
circle. A multiplier that leaves the circle at +1 starts a mode of lower symmetry, one that leaves at -1 a mode of twice the
period; a pair that leaves it elsewhere starts a beat.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..dynamics.splittings import SPLITTINGS
from ..errors import PhysicsError, positive, whole
from ..results import InHertz
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .amplitude_shifts import forces_at

HARMONICS = 6
MOST = 3000  # number of unknowns, HARMONICS + 1 for each free direction, whose matrix is still dense: 70 MB
CONVERGED, NEWTON = 1e-9, 8  # residual relative to the forces of the mode, and most iterations
TAIL = 4e-3  # share of the last two harmonics, as one may be zero by symmetry, from which more of them would be needed
HALVINGS = 6  # of the step along the arc
STILL = 1e-6  # size of a solution, as a share of its guess, below which it is rest, which has every frequency
LASTS = 1e-3  # distance of a multiplier from the unit circle that missing harmonics may make where two of them meet
STEP = 1.0  # time step of disturbances, of order 6, in 1/w_max


@dataclass(frozen=True)
class NonlinearModes(InHertz):
    """A family of periodic vibrations of a nonlinear structure, at growing amplitude.

    Attributes
    ----------
    omega : ndarray, shape (points,)
        Angular frequencies in rad/ms.
    amplitude : ndarray, shape (points,)
        Largest displacement of a particle at the turning point, mm.
    harmonics : ndarray, shape (points, HARMONICS + 1, particles, dim)
        Displacements ``sum_h harmonics[h] cos(h omega t)``, mm; the first is the shift of the mean position.
    multipliers : ndarray of complex, shape (points, 2 * free directions)
        Floquet's multipliers, the largest first; the two at +1 that every vibration has, due to its phase and its energy, come
        last.
    """

    omega: np.ndarray
    amplitude: np.ndarray
    harmonics: np.ndarray
    multipliers: np.ndarray

    @property
    def growth(self) -> NDArray[np.float64]:
        """Rate in 1/ms at which a disturbance grows, shape (points,); zero if the vibration is stable."""
        size = abs(self.multipliers[:, :-2]).max(axis=1, initial=1.0)
        return np.where(size > 1 + LASTS, np.log(size) * self.omega / (2 * np.pi), 0.0)

    @property
    def stable(self) -> NDArray[np.bool_]:
        """Whether each vibration is stable, shape (points,)."""
        return self.growth == 0


@takes(*LIKE)
def nonlinear_modes(atoms: Atoms | LinearSystem, mode: int, amplitude: float, points: int = 20) -> NonlinearModes:
    """Follow one mode of a finite structure, or of a supercell, from a small to a large amplitude.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with PairCalculator.
    mode : int
        Number of the mode in `magphonon.modes`, counted from zero.
    amplitude : float
        Largest displacement in mm at which to stop.
    points : int
        Number of points up to this amplitude; up to three times as many if the family turns back.

    Raises
    ------
    PhysicsError
        A ValueError: the family ends before this amplitude, because particles come too close to each other.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stability import nonlinear_modes
    >>> row = lattices.chain(1.0, 1.0).repeat((6, 1, 1))
    >>> row.calc = MagneticRepulsion(row, InversePower(1.0, 4.0), foundation=6.0)
    >>> family = nonlinear_modes(row, 11, 0.05, points=5)
    >>> len(family.omega), bool(family.omega[-1] > family.omega[0])
    (5, True)
    """
    system = LinearSystem.of(atoms).moving()
    n, amplitude = system.directions, positive('amplitude', amplitude, 'mm')
    mode, points = whole('mode', mode, 0), whole('points', points)
    if n * (HARMONICS + 1) > MOST:
        raise ValueError(f'{n} free directions are too many for nonlinear modes ({MOST // (HARMONICS + 1)} at most); use a '
                         'smaller patch, whose rim does not affect local modes')
    squares, vectors = system.spectrum
    if not (mode < n and squares[mode] > 0):
        raise ValueError(f'mode must be the number of a mode that vibrates, from 0 to {n - 1}, not {mode}')
    largest = np.linalg.norm((system.shapes @ vectors[:, mode]).reshape(len(system), -1), axis=1).max()
    balance = _Balance(system, float(np.sqrt(squares[mode])), amplitude / largest)
    z, tangent = np.append(np.zeros(n * (HARMONICS + 1)), 1.0), np.zeros(n * (HARMONICS + 1) + 1)
    tangent[n : 2 * n] = vectors[:, mode]
    full = step = 1 / points
    found = []
    while not found or (found[-1][1] < amplitude * (1 - 1e-9) and len(found) < 3 * points):
        solved = balance.corrected(z + step * tangent, tangent)
        if solved is None or abs(solved[0][:-1]).max() < STILL * abs(z + step * tangent)[:-1].max():
            step /= 2
            if step < full / 2**HALVINGS:
                reached = found[-1][1] if found else 0.0
                raise PhysicsError(f'the family of vibrations of mode {mode} was lost at an amplitude of {reached:.4g} mm, where '
                                   f'the motion has more than {HARMONICS} harmonics; ask for a smaller amplitude')
            continue
        z, tangent = solved
        c, W = balance.parts(z)
        u = (system.shapes @ c.T).T.reshape(HARMONICS + 1, len(system), -1)
        found.append((W, np.linalg.norm(u.sum(axis=0), axis=1).max(), u, balance.multipliers(c, W, squares[-1])))
        step = min(full, 2 * step)
    return NonlinearModes(*map(np.array, zip(*found, strict=True)))


class _Balance:
    """The equations of the harmonics; unknowns z are c in units of `size` and W in units of w."""

    def __init__(self, system, w, size):
        self.system, self.w, self.size, h = system, w, size, np.arange(HARMONICS + 1)
        theta = np.pi * (np.arange(2 * HARMONICS + 2) + 0.5) / (2 * HARMONICS + 2)  # half a period; the other is its mirror image
        self.cosines, self.norm = np.cos(np.outer(h, theta)), np.where(h > 0, 2, 1)[:, None] / len(theta)
        self.h2 = h[:, None] ** 2

    def stiffness(self, y):
        """K(y) of free directions, rad^2/ms^2."""
        u = (self.system.shapes @ y).reshape(len(self.system), -1)
        return self.system.shapes.T @ self.system.calc.hessian_at(u) @ self.system.shapes

    def residual(self, c, W):
        """The residuals R_h of all harmonics, as one vector."""
        y = self.cosines.T @ c
        u = (self.system.shapes @ y.T).T.reshape(len(y), len(self.system), -1)
        f = (self.system.shapes.T @ forces_at(self.system.calc, u).reshape(len(y), -1).T).T
        return (self.h2 * W**2 * c + self.norm * (self.cosines @ f)).ravel()

    def parts(self, z):
        """The harmonics c and the frequency W."""
        return self.size * z[:-1].reshape(HARMONICS + 1, -1), z[-1] * self.w

    def corrected(self, z, tangent):
        """The solution in the plane through z normal to the tangent, and its own tangent; None if Newton's method fails."""
        n, plane = self.system.directions, tangent @ z
        for _ in range(NEWTON):
            c, W = self.parts(z)
            R = self.residual(c, W) / self.size
            if not np.isfinite(R).all() or W <= 0:
                return None
            A = np.empty((len(z), len(z)))
            K = np.array([self.stiffness(y).toarray() for y in self.cosines.T @ c])
            waves = self.norm * self.cosines
            A[:-1, :-1] = -np.einsum('ht,kt,tij->hikj', waves, self.cosines, K, optimize=True).reshape(R.size, -1)
            A[np.arange(R.size), np.arange(R.size)] += np.repeat(self.h2 * W**2, n)
            A[:-1, -1] = (2 * self.h2 * W * self.w * c).ravel() / self.size
            A[-1] = tangent
            if abs(R).max() < CONVERGED * self.w**2 and abs(tangent @ z - plane) < CONVERGED:
                if np.linalg.norm(c[-2:]) > TAIL * np.linalg.norm(c):
                    return None
                ahead = np.linalg.solve(A, np.append(np.zeros(R.size), 1.0))
                return z, ahead / np.linalg.norm(ahead)
            z = z - np.linalg.solve(A, np.append(R, tangent @ z - plane))
        return None

    def multipliers(self, c, W, highest):
        """Floquet's multipliers of the vibration, the largest first, the two at +1 last."""
        method, period, n = SPLITTINGS[6], 2 * np.pi / W, c.shape[1]
        steps = int(np.ceil(period * np.sqrt(highest) / STEP))
        dt, h = period / steps, np.arange(HARMONICS + 1)
        x, v = np.eye(n, 2 * n), np.eye(n, 2 * n, n) * W
        for k in range(steps):
            for kick, drift, at in zip(method.kicks, (*method.drifts, 0.0), (0.0, *method.times), strict=True):
                v -= kick * dt * (self.stiffness(np.cos(h * W * (k + at) * dt) @ c) @ x)
                x += drift * dt * v
        mu = np.linalg.eigvals(np.concatenate([x, v / W]))
        mu = mu[np.argsort(-abs(mu - 1))]
        return np.concatenate([mu[:-2][np.argsort(-abs(mu[:-2]))], mu[-2:]])
