"""Compiled passes over pairs of particles: they are found by the cells of a grid, and summed over.

SciPy's k-d tree finds the same pairs, and NumPy the same sums to the last bit, in several times the time.
"""

from __future__ import annotations

import numpy as np
from numba import njit, types
from numpy.typing import NDArray

WIDER = 1 + 1e-9  # cells are wider than the reach by more than round-off, so that pairs are in cells next to each other
ROOM = 8  # number of pairs of a particle for which there is room at first; a triangular lattice has 3, and 9 to its second shell
EMPTY = 8  # largest number of cells of each point; scattered points leave more of them empty
INDICES, ROWS = types.Array(types.int32, 1, 'C', readonly=True), types.Array(types.float64, 2, 'C', readonly=True)


def kept(*signature, **options):
    """Compile a function, and keep the result on disk if numba finds a folder that it may write to."""
    options = {'error_model': 'numpy', 'nogil': True} | options

    def compiled(function):
        try:
            return njit(*signature, cache=True, **options)(function)
        except RuntimeError:
            return njit(*signature, **options)(function)

    return compiled


@njit
def _square(points, p, q):
    """Squared distance of two points."""
    return (points[q, 0] - points[p, 0]) ** 2 + (points[q, 1] - points[p, 1]) ** 2 + (points[q, 2] - points[p, 2]) ** 2


@njit
def _by_cells(points, reach, low, sides):
    """The cell of each point, the first of the points in each cell, and the points sorted by cells."""
    own, first = np.empty(len(points), np.int64), np.zeros(sides[0] * sides[1] * sides[2] + 1, np.int64)
    for p in range(len(points)):
        own[p] = 0
        for x in range(3):
            own[p] = own[p] * sides[x] + int((points[p, x] - low[x]) / (WIDER * reach))
        first[own[p] + 1] += 1
    for c in range(1, len(first)):
        first[c] += first[c - 1]
    place, inside = first.copy(), np.empty(len(points), np.int64)
    for p in range(len(points)):
        inside[place[own[p]]] = p
        place[own[p]] += 1
    return own, first, inside


@kept()
def _in_cells(points, n, reach, low, sides, i, j):
    """Fill i and j with the pairs, ascending, as far as there is room, and return their number."""
    (own, first, inside), found = _by_cells(points, reach, low, sides), 0
    for p in range(n):
        start, z, row = found, own[p] % sides[2], own[p] // sides[2]
        y, x = row % sides[1], row // sides[1]
        for a in range(max(x - 1, 0), min(x + 2, sides[0])):
            for b in range(max(y - 1, 0), min(y + 2, sides[1])):
                line = (a * sides[1] + b) * sides[2]  # cells of a line follow each other
                for k in range(first[line + max(z - 1, 0)], first[line + min(z + 2, sides[2])]):
                    q = inside[k]
                    if q > p and _square(points, p, q) <= reach**2:
                        if found < len(i):
                            m = found
                            while m > start and j[m - 1] > q:  # the few of p are sorted
                                j[m] = j[m - 1]
                                m -= 1
                            i[found], j[m] = p, q
                        found += 1
    return found


@kept(types.float64[::1](INDICES, INDICES, types.float64[:, ::1], ROWS), boundscheck=True)
def stretch(i, j, vectors, u):
    """Add `u_j - u_i` to vectors of pairs, shape (rows, pairs), from u of shape (rows, particles); returns their lengths."""
    r = np.zeros(len(i))
    for x in range(len(u)):
        for b in range(max(len(i), vectors.shape[1])):  # IndexError if they differ, as of other particles
            vectors[x, b] += u[x, j[b]] - u[x, i[b]]
            r[b] += vectors[x, b] ** 2
    for b in range(len(i)):
        r[b] = np.sqrt(r[b])
    return r


@kept(types.UniTuple(types.float64[:, ::1], 2)(INDICES, INDICES, ROWS, types.intp), boundscheck=True)
def at_ends(i, j, values, particles):
    """Sums of values, shape (rows, pairs), at the particles i, and at the particles j, both of shape (rows, particles)."""
    near, far = np.zeros((len(values), particles)), np.zeros((len(values), particles))
    for x in range(len(values)):
        for b in range(max(len(i), values.shape[1])):
            near[x, i[b]] += values[x, b]
            far[x, j[b]] += values[x, b]
    return near, far


def pairs_in_cells(points: NDArray[np.float64], n: int, reach: float) -> tuple[NDArray[np.int32], NDArray[np.int32]] | None:
    """Pairs of one of the first n points and a later one within `reach`, ascending; None if most cells would be empty."""
    low, extent = np.array([(x.min(), np.ptp(x)) for x in points.T]).T
    with np.errstate(all='ignore'):  # of a reach of zero
        sides = np.floor(extent / (WIDER * reach)) + 1
    if not sides.prod() <= EMPTY * (len(points) + EMPTY):
        return None
    order, room = np.argsort(extent), ROOM * len(points)
    points, low, sides = np.ascontiguousarray(points[:, order]), low[order], sides[order].astype(int)
    while True:
        i, j = np.empty((2, room), np.int32)
        found = _in_cells(points, n, reach, low, sides, i, j)
        if found <= room:
            return i[:found], j[:found]
        room = found
