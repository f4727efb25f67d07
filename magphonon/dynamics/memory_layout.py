"""Memory layout of particles and bonds for blocks of time steps: a grid of constant offsets, or a table.

In a patch made by `repeat` the bonds fall into a few groups of equal j - i and equal rest vector.  Such a group is
a pair of shifted slices, and no index needs to be looked up.  A patch that was cut from a parallelogram is put back
onto it (the array 'site'), with empty slots where particles are missing.  Everything else goes into a table of bonds,
with the particles renumbered so that neighbours lie close in memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

    from ..lattices.bonds import Bonds

GRID_COST = 6
"""Ratio of evaluations to bonds up to which a grid pays, although every particle evaluates every group there."""
LINE = 8
"""Number of floating-point numbers in a cache line."""
SAME_VECTOR = 1e-10
"""Relative difference of rest vectors below which they form one group: far above the round-off of positions, and so small that
one law serves all of them (relaxed patches differ by any amount; a limit ten times as large costs 2e-9 of a motion)."""


def aligned_zeros(shape: tuple[int, ...]) -> NDArray[np.float64]:
    """Zeros that start on a cache line, as vector units like it; a third faster than where NumPy happens to put them."""
    size = int(np.prod(shape))
    memory = np.zeros(size + LINE)
    start = -memory.ctypes.data // memory.itemsize % LINE
    return memory[start : start + size].reshape(shape)


@dataclass(frozen=True)
class Layout:
    """Slots of particles, and bonds between slots.

    Attributes
    ----------
    slot : ndarray of int, shape (particles,)
        The slot of each particle.
    length : int
        Number of slots, including the empty ones behind the last particle that shifted slices reach.
    i, j : ndarray of int, shape (bonds,)
        Slots that each bond joins.
    R : ndarray, shape (bonds, 2)
        Rest vectors in mm.
    kind : ndarray of int, shape (bonds,)
        The increment law of each bond; ascending in a table.
    r0 : ndarray, shape (kinds,)
        Rest length of each kind in mm.
    example : ndarray of int, shape (kinds,)
        A bond of each kind, by its number in the list of bonds.
    offset : ndarray of int, shape (kinds,), or None
        On a grid, j - i of each kind; None for a table.
    strength : ndarray, shape (kinds, length), or None
        On a grid, 1 where slot i starts a bond and 0 elsewhere; None if this never matters because both its ends
        are held, as at a fixed rim.
    """

    slot: np.ndarray
    length: int
    i: np.ndarray
    j: np.ndarray
    R: np.ndarray
    kind: np.ndarray
    r0: np.ndarray
    example: np.ndarray
    offset: np.ndarray | None = None
    strength: np.ndarray | None = None

    @property
    def kind_R(self) -> NDArray[np.float64]:
        """Rest vector of each kind on a grid, shape (kinds, 2)."""
        return self.R[np.unique(self.kind, return_index=True)[1]]

    def runs(self, gap: int, longest: int) -> NDArray[np.int_]:
        """First and last + 1 slot of stretches of particles, shape (runs, 2); none overlaps another.

        Holes up to `gap` slots, at least a cache line, are included.  Stretches start on a cache line and are cut into
        pieces of at most `longest` slots, a whole number of cache lines, so that every piece starts on one.
        """
        occupied = np.sort(self.slot)
        breaks = np.flatnonzero(np.diff(occupied) > gap)
        first = occupied[np.append(0, breaks + 1)]
        first -= first % LINE
        last = occupied[np.append(breaks, len(occupied) - 1)] + 1
        return np.array([(s, min(s + longest, b)) for a, b in zip(first, last, strict=True) for s in range(a, b, longest)])

    def gather(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the particles, shape (2, particles), from those of the slots, shape (2, length)."""
        return values[:, : len(self.slot)] if self._whole else values[:, self.slot]

    @cached_property
    def _whole(self):
        """Whether the particles fill the slots in their own order."""
        return np.array_equal(self.slot, np.arange(len(self.slot)))

    def scatter(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the slots, shape (..., length), zero in empty ones, from those of the particles, shape (particles, ...)."""
        slots = aligned_zeros((*values.shape[1:], self.length))
        slots[..., self.slot] = values.T
        return slots


def arrange(atoms: Atoms, bonds: Bonds, mobile: NDArray[np.bool_], labels: NDArray[np.intp] | int = 0) -> Layout:
    """The layout of a planar structure.

    Parameters
    ----------
    atoms : ase.Atoms
    bonds : Bonds
    mobile : ndarray of bool, shape (particles,)
        Particles that are not held.
    labels : ndarray of int, shape (bonds,)
        The same for bonds of the same law, `magphonon.interactions.labels`; by default all have the same.
    """
    other = np.flatnonzero(bonds.i != bonds.j)  # a bond to one's own image never changes
    i, j, R, labels = bonds.i[other], bonds.j[other], bonds.vectors[other, :2], np.broadcast_to(labels, len(bonds))[other]
    layout = _grid(atoms, i, j, R, mobile, labels) or _table(len(atoms), i, j, R, labels)
    return replace(layout, example=other[layout.example])


def _grid(atoms, i, j, R, mobile, labels):
    slot = atoms.arrays.get('site', np.arange(len(atoms)))
    if len(np.unique(slot)) < len(slot) or not len(i):  # as after joining two patches
        return None
    slot = slot - slot.min()
    i, j = slot[i], slot[j]
    backward = j < i
    i, j = np.where(backward, j, i), np.where(backward, i, j)
    R = np.where(backward[:, None], -R, R)
    r0 = np.linalg.norm(R, axis=1)
    groups, first, kind = np.unique(np.column_stack([j - i, np.round(R / (SAME_VECTOR * r0.min())), labels]),
                                    axis=0, return_index=True, return_inverse=True)
    slots = slot.max() + 1
    if len(groups) * len(slot) > GRID_COST * len(i):
        return None
    kind = kind.ravel()
    offset = groups[:, 0].astype(int)
    length = slots + offset.max()
    length += -length % LINE
    free = np.zeros(length, bool)
    free[slot] = mobile
    bonded = np.zeros((len(groups), length))
    bonded[kind, i] = 1
    matters = [(free[:slots] | free[o : o + slots]) & (b[:slots] == 0) for o, b in zip(offset, bonded, strict=True)]
    return Layout(slot, length, i, j, R[first][kind], kind, r0[first], first, offset, bonded if np.any(matters) else None)


def _table(count, i, j, R, labels):
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    graph = csr_array((np.ones(2 * len(i)), (np.append(i, j), np.append(j, i))), shape=(count, count))
    slot = np.empty(count, int)
    slot[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(count)
    i, j = slot[i], slot[j]
    r0 = np.linalg.norm(R, axis=1)
    _, first, kind = np.unique(np.column_stack([np.round(np.log(r0) / SAME_VECTOR), labels]), axis=0, return_index=True,
                               return_inverse=True)
    kind = kind.ravel()
    order = np.lexsort([np.maximum(i, j), np.minimum(i, j), kind])
    return Layout(slot, count + -count % LINE, i[order], j[order], R[order], kind[order], r0[first], first)
