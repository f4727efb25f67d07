"""Memory layout of particles and bonds: a grid of constant offsets, or slots that look their neighbours up.

In a patch made by `repeat` the bonds fall into a few groups of equal j - i. On such a grid no index needs to be looked up.  A
patch that was cut from a parallelogram is put back onto it (by the array 'site', or by places found from the rest vectors), with
empty slots where particles are missing.  In all other structures the particles are renumbered so that neighbours lie close in
memory.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..lattices.bonds import Bonds, lengths_of

GRID_COST = 6
"""Largest number of bonds that every slot of a grid evaluates, as a multiple of those that it has: a bond that is looked up is
evaluated at both ends, and takes that much longer.  A honeycomb from which a third of the particles is missing has 3.5 times."""
SPREAD = 6  # largest ratio of slots to particles of a grid, most of which lie in gaps that runs skip
FEW = 3000  # bonds from which the base vectors of a grid are estimated, before they are fitted to all
RUN = 512  # slots that are done at a time, so that forces of their bonds stay in the cache
GAP = 64
"""Largest number of holes in a run of slots that are cheaper to fill than to skip; more than two lines, so that runs do not
overlap."""
LINE = 16  # slots to which rows are padded: a cache line of single, two of double precision


def aligned_zeros(shape: tuple[int, ...], dtype: Any = float) -> NDArray[Any]:
    """An array of zeros that starts on a cache line; vector units are a third faster with it than with an array of NumPy."""
    size = int(np.prod(shape))
    memory = np.zeros(size + LINE, dtype)
    start = -memory.ctypes.data // memory.itemsize % LINE
    return memory[start : start + size].reshape(shape)


@dataclass(frozen=True)
class Layout:
    """Slots of particles, and bonds between slots in columns, of which each slot has one bond.

    Attributes
    ----------
    slot : ndarray of int, shape (particles,)
        The slot of each particle.
    length : int
        Number of slots, including the empty ones before the first and behind the last particle to which offsets lead.
    bond : ndarray of int, or slice
        The bonds in the list of bonds; a bond to one's own image never changes, and is left out.
    i, j : ndarray of int, shape (bonds,)
        Slots that each bond joins, on a grid the lower one first.  Where neighbours are looked up, each bond is there twice, from
        either end.
    R : ndarray, shape (bonds, dim)
        Rest vectors from i to j in mm.
    column : ndarray of int, shape (bonds,)
        The column of each bond.
    offset : ndarray of int, shape (columns,), or None
        On a grid, j - i of each column; None if neighbours are looked up.
    """

    slot: np.ndarray
    length: int
    bond: Any
    i: np.ndarray
    j: np.ndarray
    R: np.ndarray
    column: np.ndarray
    offset: np.ndarray | None = None


def arrange(atoms: Atoms, bonds: Bonds, dim: int) -> Layout:
    """The layout of a structure of particles with `dim` components of a displacement."""
    other: Any = np.s_[:] if (bonds.i != bonds.j).all() else np.flatnonzero(bonds.i != bonds.j)
    i, j, R = bonds.i[other], bonds.j[other], bonds.vectors[other, :dim]
    slot = atoms.arrays.get('site', np.arange(len(atoms)))
    found = None
    if len(i):
        found = _grid(slot - slot.min(), other, i, j, R)
        if found is None or np.ptp(found.slot) > 1.2 * len(atoms):
            sites = _sites_found(atoms.positions[:, :dim], i, j, R)
            better = None if sites is None else _grid(sites, other, i, j, R)
            found = better if found is None or (better is not None and better.length < found.length) else found
    return _table(atoms.positions[:, :dim], other, i, j, R) if found is None else found


def _table(X, bond, i, j, R):
    """The layout of particles at X, in rows that are as wide as a bond is long."""
    slot = np.empty(len(X), int)
    rows = np.floor(X[:, 1:] / (lengths_of(R).mean() if len(R) else 1.0))
    slot[np.lexsort([X[:, 0], *rows.T])] = np.arange(len(X))
    near, far = np.concatenate([slot[i], slot[j]]), np.concatenate([slot[j], slot[i]])
    order, column = np.argsort(near, kind='stable'), np.empty(len(near), int)
    column[order] = np.arange(len(near)) - np.searchsorted(near[order], near[order])
    both = np.concatenate([bond, bond]) if isinstance(bond, np.ndarray) else np.tile(np.arange(len(i)), 2)
    return Layout(slot, len(X) + -len(X) % LINE, both, near, far, np.concatenate([R, -R]), column)


def _grid(slot, bond, i, j, R):
    """The layout on a grid; None if two particles have one place, or there are many offsets."""
    if slot.max() >= SPREAD * len(slot) or np.bincount(slot).max() > 1:  # as after two patches were joined
        return None
    i, j = (slot[end].astype(np.int32) for end in (i, j))
    if (backward := j < i).any():
        i, j, R = np.where(backward, j, i), np.where(backward, i, j), np.where(backward[:, None], -R, R)
    offset = np.flatnonzero(np.bincount(j - i))
    if len(offset) * len(slot) > GRID_COST * len(i) or not offset[0]:
        return None
    column = np.cumsum(np.isin(np.arange(offset[-1] + 1), offset))[j - i] - 1
    if np.bincount(column * (slot.max() + 1) + i).max() > 1:
        return None
    ends = int(offset[-1]) + -int(offset[-1]) % LINE
    inside = int(slot.max()) + 1  # runs end on a cache line, and read their neighbours
    return Layout(ends + slot, 2 * ends + inside + -inside % LINE, bond, ends + i, ends + j, R, column, offset)


def _sites_found(X, i, j, R):
    """Places of the particles on a grid, such that bonds span whole numbers of rows; None if there is none."""
    few = R[:: 1 + len(R) // FEW]
    try:
        base, origin = _base_vectors(few), X[0]
        for bonds in (few, few, R):
            steps = np.rint(bonds @ np.linalg.inv(base))
            base = _fitted(steps, bonds)
        for _ in range(3):
            places = np.rint((X - origin) @ np.linalg.inv(base))
            *base, origin = _fitted(np.column_stack([places, np.ones(len(X))]), X)
    except np.linalg.LinAlgError:  # the bonds do not span the plane or space
        return None
    if (places[j] - places[i] != steps).any():
        return None
    places, steps = np.ascontiguousarray(places.T), np.ascontiguousarray(steps.T)  # in long rows, whose maxima are found fast
    return min((_numbered(skew @ places, skew @ steps) for skew in _skews(X.shape[1])), key=lambda sites: sites.max())


def _fitted(whole, X):
    """The vectors of which X are the sums, times these whole numbers, by least squares."""
    squares = whole.T @ whole
    if np.linalg.matrix_rank(squares) < len(squares):
        raise np.linalg.LinAlgError
    return np.linalg.solve(squares, whole.T @ X)


def _skews(dim):
    """Changes of the base vectors, with which a patch may fill its parallelogram better."""
    one = np.eye(dim)
    return [one, *(one + n * np.outer(a, b) for n in (1, -1) for a in one for b in one if a @ b == 0)]


def _base_vectors(R):
    """The shortest of the rest vectors that span the plane or space; fewer if none do."""
    r, left, base = lengths_of(R), R.copy(), []
    for _ in range(R.shape[1]):
        size = lengths_of(left)
        across = size > r.min() / 2
        if across.any():
            b = np.where(across, r, np.inf).argmin()
            base.append(R[b])
            left -= np.outer(left @ left[b] / size[b] ** 2, left[b])
    return np.array(base)


def _numbered(places, steps):
    """Places numbered along the shortest side first, with gaps so that bonds of equal steps have equal differences of numbers."""
    places = (places - places.min(axis=1)[:, None]).astype(int)
    order = np.argsort(places.max(axis=1))
    widths = (places.max(axis=1) + 1 + abs(steps).max(axis=1).astype(int))[order]
    return np.append(1, np.cumprod(widths)[:-1]) @ places[order]


def runs_of(slot: NDArray[np.int_]) -> NDArray[np.int_]:
    """First and last + 1 slot of stretches of particles that do not overlap, shape (runs, 2).

    Holes of up to GAP slots are included.  Runs consist of whole cache lines, and of at most RUN slots.
    """
    occupied = np.sort(slot)
    breaks = np.flatnonzero(np.diff(occupied) > GAP)
    first = occupied[np.append(0, breaks + 1)] // LINE * LINE
    last = -(-(occupied[np.append(breaks, len(occupied) - 1)] + 1) // LINE) * LINE
    return np.array([(s, min(s + RUN, b)) for a, b in zip(first, last, strict=True) for s in range(a, b, RUN)])
