"""Pairs of particles by the cells of a grid, compiled; SciPy's k-d tree finds the same pairs in several times the time."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

WIDER = 1 + 1e-9  # cells are wider than the reach by more than round-off, so that pairs are in cells next to each other
ROOM = 8  # number of pairs of a particle for which there is room at first; a triangular lattice has 3, and 9 to its second shell
EMPTY = 8  # largest number of cells of each point; scattered points leave more of them empty


@njit
def _square(points, p, q):
    """Squared distance of two points."""
    return (points[q, 0] - points[p, 0]) ** 2 + (points[q, 1] - points[p, 1]) ** 2 + (points[q, 2] - points[p, 2]) ** 2


def kept(function):
    """Compile a function, and keep the result on disk if numba finds a folder that it may write to."""
    try:
        return njit(cache=True, error_model='numpy', nogil=True)(function)
    except RuntimeError:
        return njit(error_model='numpy', nogil=True)(function)


@kept
def _in_cells(points, n, reach, low, sides, i, j):
    """Fill i and j with the pairs, as far as there is room, and return their number."""
    own, first = np.empty(len(points), np.int64), np.zeros(sides[0] * sides[1] * sides[2] + 1, np.int64)
    for p in range(len(points)):
        own[p] = 0
        for x in range(3):
            own[p] = own[p] * sides[x] + int((points[p, x] - low[x]) / (WIDER * reach))
        first[own[p] + 1] += 1
    for c in range(1, len(first)):
        first[c] += first[c - 1]
    place, inside = first.copy(), np.empty(len(points), np.int64)
    for p in range(len(points)):  # sorted by cells
        inside[place[own[p]]] = p
        place[own[p]] += 1
    found = 0
    for p in range(n):
        z, row = own[p] % sides[2], own[p] // sides[2]
        y, x = row % sides[1], row // sides[1]
        for a in range(max(x - 1, 0), min(x + 2, sides[0])):
            for b in range(max(y - 1, 0), min(y + 2, sides[1])):
                line = (a * sides[1] + b) * sides[2]  # cells of a line follow each other
                for k in range(first[line + max(z - 1, 0)], first[line + min(z + 2, sides[2])]):
                    q = inside[k]
                    if q > p and _square(points, p, q) <= reach**2:
                        if found < len(i):
                            i[found], j[found] = p, q
                        found += 1
    return found


def pairs_in_cells(points: NDArray[np.float64], n: int, reach: float) -> tuple[NDArray[np.int_], NDArray[np.int_]] | None:
    """Pairs of one of the first n points and a later one within `reach`, each once; None if most cells would be empty."""
    low, extent = np.array([(x.min(), np.ptp(x)) for x in points.T]).T
    with np.errstate(all='ignore'):  # of a reach of zero
        sides = np.floor(extent / (WIDER * reach)) + 1
    if not sides.prod() <= EMPTY * (len(points) + EMPTY):
        return None
    order, room = np.argsort(extent), ROOM * len(points)
    points, low, sides = np.ascontiguousarray(points[:, order]), low[order], sides[order].astype(int)
    while True:
        i, j = np.empty((2, room), int)
        found = _in_cells(points, n, reach, low, sides, i, j)
        if found <= room:
            return i[:found], j[:found]
        room = found
