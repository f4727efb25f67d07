"""The exact linear transient with any matrix B of losses and Coriolis-like forces, for which motion is no function of K alone.

    y'' + B y' + K y = g        z' = A z + (0, g/R)        z = (y, y'/R)        A = R X        X = [[0, 1], [-K/R^2, -B/R]]

    exp(A t) = J_0(R t) + 2 sum_n J_n(R t) F_n        F_{n+1} = 2 X F_n + F_{n-1}        F_1 = X        F_0 = 1

is the Chebyshev series of e^{i lambda R t} at lambda = X/i, with F_n = i^n T_n(X/i): all numbers are real, and no root of K is
needed. All frequencies are below R = g/2 + sqrt(g^2/4 + k) for a bound k of K and the largest gyroscopic rate g. Damping c
moves eigenvalues off the interval, so that F_n, and the round-off of the series, grow as e^{c n/R}. The motion is therefore
computed in parts with c t < 5, and R is at least 10 c. Forces have coefficients of their own: integrals of
e^{i lambda R (t - t')} times the force at t', by Gauss's rule on the panels of `propagation`.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from .chebyshev import BLOCK, Interval, coefficients

NODES = 16  # number of Gauss points on a panel; they integrate polynomials of degree 31 exactly
POINTS, WEIGHTS = (np.polynomial.legendre.leggauss(NODES) + np.array([[1.0], [0.0]])) / 2
FADED = 5.0
"""Largest exponent by which losses make round-off grow within a part: by e^5."""
LARGEST = 2**23  # about the largest number of coefficients at a time
SLENDER = 10.0  # smallest ratio of R to losses and growth; about 36 terms follow those of the motion, and grow by e^3.6
EPS = np.finfo(float).eps


class FirstOrder:
    """Motion of a structure with any matrix B, computed part by part.

    The interval contains the eigenvalues of K, from zero or its lowest eigenvalue, if negative, to a bound of the highest.
    `loss` (1/ms) and `turning` (rad/ms) are the largest damping and gyroscopic rate of any site.
    """

    def __init__(self, K: sparse.csr_array, B: sparse.csr_array, interval: Interval, loss: float, turning: float) -> None:
        off_axis = loss + np.sqrt(-interval.lowest)
        self.rate = max(turning / 2 + np.sqrt(turning**2 / 4 + interval.highest), SLENDER * off_axis)
        self.longest = FADED / off_axis if off_axis else np.inf
        self._X = sparse.csr_array(sparse.block_array([[None, sparse.eye_array(K.shape[0])],
                                                       [K / -(self.rate**2), B / -self.rate]]))

    def moved(self, state: NDArray[np.float64], panels: Any, outputs: NDArray[np.int_],
              rows: NDArray[np.int_]) -> tuple[Any, ...]:
        """The motion over some panels, and the state at their end.

        Parameters
        ----------
        state : ndarray, shape (free, 2)
            y and y' at the first edge.
        panels : tuple
            Edges, courses (panels, points, terms) and patterns (free, terms) of the forces.
        outputs : ndarray of int
            Edges at which the motion is wanted; the last one is the end.
        rows : ndarray of int

        Returns
        -------
        y : ndarray, shape (outputs, 2, rows)
        state : ndarray, shape (free, 2)
            At the last edge.
        round_off, products : float, int
        """
        R, (edges, courses, patterns) = self.rate, panels
        n, z, wide = len(state), R * (edges[-1] - edges[0]), patterns.shape[1]
        if wide * len(outputs) * z > LARGEST and wide > 1:  # in two parts, of which the first has the state
            both = [(own, (edges, courses[..., part], patterns[:, part]))
                    for own, part in ((state, np.s_[: wide // 2]), (0 * state, np.s_[wide // 2 :]))]
            return tuple(map(sum, zip(*(self.moved(own, part, outputs, rows) for own, part in both), strict=True)))
        now = np.concatenate([np.column_stack([state[:, 0], 0 * patterns]), np.column_stack([state[:, 1], patterns]) / R])
        c = self._coefficients(edges, courses, outputs, int(z + 6 * np.cbrt(z)) + 30)
        wanted = np.concatenate([rows, n + rows])
        y, end, before, size = np.zeros((len(outputs), len(wanted))), np.zeros(2 * n), now, 0.0
        for first in range(0, c.shape[2], BLOCK):
            own, block = c[:, :, first : first + BLOCK], []
            for k in range(own.shape[2]):
                if first + k:
                    before, now = now, self._X @ now * (1 if first + k == 1 else 2) + before * (first + k > 1)
                block.append(now[wanted])
                end += now @ own[-1, :, k]
                size += (abs(own[:, :, k]).max(axis=0) * abs(now).max(axis=0)).sum()
            y += np.einsum('tck,kxc->tx', own, np.array(block), optimize=True)
        y = y.reshape(len(outputs), 2, len(rows)) * np.array([1, R])[:, None]
        return y, end.reshape(2, n).T * [1, R], EPS * size, c.shape[2] * now.shape[1]

    def _coefficients(self, edges, courses, outputs, terms):
        """Coefficients of F_n at the outputs, shape (outputs, 1 + courses, terms): for free motion, then for each course."""
        turn = 1j * self.rate * Interval(-1.0, 1.0).nodes(terms)
        wanted = np.zeros(len(edges), bool)
        wanted[outputs] = True
        a = np.zeros((1 + courses.shape[2], terms), complex)
        a[0], found = 1.0, []
        for k, h in enumerate(np.append(np.diff(edges), 0.0)):
            if wanted[k]:
                found.append(a)
            if k < len(courses):
                a = np.exp(turn * h) * a
                a[1:] += h * (courses[k].T * WEIGHTS) @ np.exp(np.outer(1 - POINTS, turn) * h)
        i_n = np.tile([1, 1j, -1, -1j], terms // 4 + 1)[:terms]
        parts = coefficients(np.array([np.real(found), np.imag(found)]))
        return ((parts[0] + 1j * parts[1]) / i_n).real
