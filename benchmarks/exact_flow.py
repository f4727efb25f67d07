"""Nonlinear motion by the exact flow of its linear part and kicks by the rest, for the chart of `speed.py`.

The forces per mass are `-K u + g`.  The exact flow of `u'' + K u = 0` over a step h and kicks by h g in turns are the impulse
method of Deuflhard (Z. angew. Math. Phys. 30, 177 (1979)).  Its displacements move by D from one step to the next,

    D <- D + h s a + (2 c - 2 + h s K) u        c = cos(h sqrt(K))        s = sin(h sqrt(K))/sqrt(K)        a = g - K u

and by half of that in the first step from rest: one evaluation of the forces and one series of products with K.
"""

import numpy as np
from numba import njit
from numpy.polynomial.chebyshev import chebinterpolate

from magphonon.dynamics.kernels_numba import OPTIONS, vectorise
from magphonon.dynamics.kernels_numpy import largest
from magphonon.dynamics.memory_layout import aligned_zeros
from magphonon.response.stencil import row, stencil_of
from magphonon.stiffness import LinearSystem

TAIL = 1e-6
"""What is left out of the series, as a share of a displacement in one step."""


def flow_exactly(dyn):
    """Let the blocks of a DrivenVerlet move so: compiled, at rest, without losses and drives, equal masses on a grid.

    Looks, observers and refits stay; velocities are D/h.
    """
    blocks, h, stencil = dyn._blocks, dyn.dt, stencil_of(LinearSystem.about(dyn.atoms.calc, dyn.atoms))
    top, margin = stencil.row_sum, len(stencil.free) - blocks.layout.length
    X2, coefficients = stencil.scaled(4 / top, top / 2), functions(h, top)
    D, room = np.zeros_like(blocks._state[0]), aligned_zeros((4, 2, len(X2.free)))
    given = room, room[:, :, margin:], X2.D, X2.A, X2.free, tuple(np.array(X2.offsets, np.uint64)), X2.runs

    def advance(forces, times, noise):
        kernel, out = blocks._kernel, blocks._spare
        beyond = blocks._stale and kernel.accelerate(blocks._state, forces[0], times[0])
        blocks._stale, out[:] = False, blocks._state
        np.multiply(h, out[1], out=D)
        for time in times[:-1]:
            move(out[0], D, coefficients if time else coefficients / 2, out[2], *given)
            beyond |= kernel.accelerate(out, forces[0], time)
        np.divide(D, h, out=out[1])
        return beyond, largest(out[0]), largest(out[1])

    blocks._try = advance


def functions(h, top):
    """Coefficients in Chebyshev polynomials of the second kind of what multiplies a and u, shape (terms, 2)."""
    def values(x):
        K = top * (x + 1) / 2
        s = h * np.sinc(h * np.sqrt(K) / np.pi)
        return np.stack([h * s, 2 * np.cos(h * np.sqrt(K)) - 2 + h * s * K], axis=-1)

    c = chebinterpolate(values, 40)
    terms = (np.cumsum(abs(c[::-1]), axis=0)[::-1] > TAIL * np.array([h**2, 1])).any(axis=1).nonzero()[0][-1] + 1
    c[0] *= 2
    return (c - np.concatenate([c[2:], 0 * c[:2]]))[:terms] / 2  # T_n = (U_n - U_n-2)/2


@njit(no_cpython_wrapper=True, **OPTIONS)
def combine(y, p, x, q, z, w, s, e):
    """Put p x + q z + w y into y in the slots s to e."""
    vectorise()
    for m in range(2):
        for i in range(s, e):
            y[m, i] = p * x[m, i] + q * z[m, i] + w * y[m, i]


@njit(**OPTIONS)
def move(u, D, coefficients, a, room, inner, K, A, free, offsets, runs):
    """The change of D, by Clenshaw's recurrence in turns in the first two arrays of the room, and D in u."""
    zero, slots = np.uint64(0), np.uint64(u.shape[1])
    combine(inner[2], 1.0, a, 0.0, a, 0.0, zero, slots)
    combine(inner[3], 1.0, u, 0.0, u, 0.0, zero, slots)
    room[:2] = 0.0
    for n in range(len(coefficients) - 1, -1, -1):
        now, before = room[n % 2], room[1 - n % 2]
        for r in range(len(runs)):
            if n < len(coefficients) - 1:
                row(before, now, K, A, free, offsets, runs[r, 0], runs[r, 1])
            combine(now, coefficients[n, 0], room[2], coefficients[n, 1], room[3], 1.0, runs[r, 0], runs[r, 1])
    combine(D, 1.0, inner[0], 0.0, inner[0], 1.0, zero, slots)
    combine(u, 1.0, D, 0.0, D, 1.0, zero, slots)
