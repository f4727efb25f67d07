"""Memory layout of particles and bonds for blocks of time steps: a grid of constant offsets, or a table.

In a patch made by `repeat` the bonds fall into a few groups of equal j - i and equal rest vector.  Such a group is
a pair of shifted slices, and no index needs to be looked up.  A patch that was cut from a parallelogram is put back onto it (by
the array 'site', or by places found from the rest vectors), with empty slots where particles are missing. If rest vectors
scatter, the bonds of a group share only j - i, and each has its own rest vector.  All other structures use a table of bonds, with
the particles renumbered so that neighbours lie close in memory.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from itertools import chain
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..lattices.bonds import Bonds, lengths_of, stretches

GRID_COST = 6  # ratio of evaluations to bonds up to which a grid pays, although every particle evaluates every group there
KINDS_OF_OFFSET = 1.5
"""Number of kinds of bonds per offset above which each bond carries its own law. This takes 1.4 times as long as a shared law,
but otherwise every kind is evaluated for every slot."""
GRID_COST_EACH = 3  # the same where each bond has its own rest vector and law, which must be read
FEW_KINDS = 16  # number of kinds of bonds up to which a table is sorted by kind; with more, each bond carries a law of its own
SPREAD = 4  # largest ratio of slots to particles of a grid
OFF_PLACE = 0.3
"""Largest difference, in shortest bonds, between a rest vector and a sum of two others times whole numbers, on a grid."""
SKEWS = tuple(np.array(skew).reshape(2, 2) for skew in
              ((1, 0, 0, 1), (1, 1, 0, 1), (1, -1, 0, 1), (1, 0, 1, 1), (1, 0, -1, 1), (0, 1, 1, 1), (0, 1, 1, -1)))
"""Other choices of base vectors of a lattice: with some of them a patch fills its parallelogram better."""
MANY = 1000  # values that are sorted first
LINE = 16  # slots to which rows are padded: a cache line of single, two of double precision
SAME_VECTOR = 1e-10
"""Relative difference of rest vectors below which they form one group: far above the round-off of positions, and so small that
one law serves all of them (relaxed patches differ by any amount; a limit ten times as large costs 2e-9 of a motion)."""


def aligned_zeros(shape: tuple[int, ...], dtype: Any = float) -> NDArray[Any]:
    """An array of zeros that starts on a cache line; vector units are a third faster with it than with an array of NumPy."""
    size = int(np.prod(shape))
    memory = np.zeros(size + LINE, dtype)
    start = -memory.ctypes.data // memory.itemsize % LINE
    return memory[start : start + size].reshape(shape)


def same(x: NDArray[Any], dtype: Any) -> NDArray[Any]:
    """A copy of the array that starts on a cache line, in the given precision."""
    copy = aligned_zeros(x.shape, dtype)
    copy[...] = x
    return copy


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
    R : ndarray, shape (bonds, 2), or (kinds, 2) on a grid whose bonds of a kind are alike
        Rest vectors in mm.
    kind : ndarray of int, shape (bonds,)
        The increment law of each bond.
    r0 : ndarray, shape (kinds,)
        Rest length of each kind in mm.
    example : ndarray of int, shape (kinds,)
        A bond of each kind, by its number in the list of bonds.
    offset : ndarray of int, shape (groups,), or None
        On a grid, j - i of each group; None for a table.
    strength : ndarray of bool, shape (groups, length), or None
        On a grid, 1 where slot i starts a bond and 0 elsewhere; None if this does not matter because every missing bond would
        join two held particles, as at a fixed rim.
    group : ndarray of int, shape (bonds,), or None
        On a grid, the group of each bond; it equals `kind` unless each bond has its own rest vector.
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
    group: np.ndarray | None = None

    @property
    def each(self) -> bool:
        """Whether bonds of one group differ on a grid."""
        return self.group is not None and self.group is not self.kind

    @property
    def own_laws(self) -> bool:
        """Whether each bond carries a law of its own."""
        return self.each if self.offset is not None else len(self.r0) > FEW_KINDS

    def on_grid(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the bonds, shape (..., bonds), arranged by group and lower slot, shape (..., groups, length), else zero."""
        grid = aligned_zeros((*values.shape[:-1], len(self.offset), self.length))  # pyright: ignore[reportArgumentType]
        grid[..., self.group, self.i] = values
        return grid

    def vectors(self, some: Any = np.s_[:]) -> NDArray[np.float64]:
        """Rest vectors of all or some bonds, shape (bonds, 2)."""
        return self.R[some] if self.offset is None or self.each else self.R[self.kind[some]]

    def runs(self, gap: int, longest: int) -> NDArray[np.int_]:
        """First and last + 1 slot of runs, stretches of particles that do not overlap, shape (runs, 2).

        Holes of up to `gap` slots, at least a cache line, are included.  Runs start on a cache line. They have at most `longest`
        slots, a whole number of cache lines, so that the next run starts on one too.
        """
        occupied = np.sort(self.slot)
        breaks = np.flatnonzero(np.diff(occupied) > gap)
        first = occupied[np.append(0, breaks + 1)]
        first -= first % LINE
        last = occupied[np.append(breaks, len(occupied) - 1)] + 1
        return np.array([(s, min(s + longest, b)) for a, b in zip(first, last, strict=True) for s in range(a, b, longest)])

    def gather(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the particles, shape (2, particles), from those of the slots, shape (2, length)."""
        return values[:, : len(self.slot)] if self.whole else values[:, self.slot]

    @cached_property
    def whole(self) -> bool:
        """Whether the particles fill the slots in their own order."""
        return np.array_equal(self.slot, np.arange(len(self.slot)))

    def scatter(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values of the slots, shape (..., length), zero in empty ones, from those of the particles, shape (particles, ...)."""
        slots = aligned_zeros((*values.shape[1:], self.length))
        slots[..., self.slot] = np.moveaxis(values, 0, -1)
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
        Equal numbers for bonds of the same law (`magphonon.interactions.bond_laws.labels`); by default all have the same law.
    """
    other: Any = np.s_[:] if (bonds.i != bonds.j).all() else bonds.i != bonds.j  # a bond to one's own image never changes
    i, j, R, labels = bonds.i[other], bonds.j[other], bonds.vectors[other, :2], np.broadcast_to(labels, len(bonds))[other]
    layout, slot = None, atoms.arrays.get('site', np.arange(len(atoms)))
    if len(i) and np.bincount(slot - slot.min()).max() == 1:  # not true after two patches were joined
        layout = _grid(slot - slot.min(), i, j, R, mobile, labels)
    if len(i) and layout is None and (slot := _sites_found(atoms, i, j, R)) is not None:
        layout = _grid(slot - slot.min(), i, j, R, mobile, labels)
    layout = layout or _table(len(atoms), i, j, R, labels)
    return replace(layout, example=np.arange(len(bonds))[other][layout.example])


def _sites_found(atoms, i, j, R):
    """Places of the particles on a parallelogram, such that bonds span whole numbers of rows and columns; None if impossible."""
    X, r = atoms.positions[:, :2], lengths_of(R)
    first = R[r.argmin()]
    across = abs(first[0] * R[:, 1] - first[1] * R[:, 0]) > r * r.min() / 2
    if not across.any():
        return None
    base = np.stack([first, R[np.where(across, r, np.inf).argmin()]])
    for _ in range(3):
        steps = np.rint(R @ np.linalg.inv(base))
        if np.linalg.matrix_rank(steps.T @ steps) < 2:
            return None
        base = np.linalg.lstsq(steps, R, rcond=None)[0]
    if (lengths_of(R - steps @ base) > OFF_PLACE * r.min()).any():
        return None
    places = np.rint((X - X[0]) @ np.linalg.inv(base))
    for _ in range(2):
        fit = np.linalg.lstsq(np.column_stack([places, np.ones(len(X))]), X, rcond=None)[0]
        if np.linalg.matrix_rank(fit[:2]) < 2:
            return None
        places = np.rint((X - fit[2]) @ np.linalg.inv(fit[:2]))
    if (places[j] - places[i] != steps).any():
        return None
    sites = min((_numbered(places @ skew, steps @ skew) for skew in SKEWS), key=lambda sites: sites.max())
    few = sites.max() < SPREAD * len(sites) and len(np.unique(sites)) == len(sites)
    return sites if few else None


def _numbered(places, steps):
    """Places numbered along the shorter side, with gaps so that bonds of equal steps have equal differences of numbers."""
    places = (places - places.min(axis=0)).astype(int)
    along = places.max(axis=0).argmin()
    width = places[:, along].max() + 1 + int(abs(steps[:, along]).max())
    return places[:, 1 - along] * width + places[:, along]


def _grid(slot, i, j, R, mobile, labels):
    if not np.array_equal(slot, np.arange(len(slot))):
        i, j = (slot.astype(np.int32)[end] for end in (i, j))
    if (backward := j < i).any():
        i, j, R = np.where(backward, j, i), np.where(backward, i, j), np.where(backward[:, None], -R, R)
    unit = SAME_VECTOR * lengths_of(R).min()
    first, kind = _alike(len(i), chain([j - i], (np.round(x / unit) for x in R.T), [labels]))
    group, offset, R_of = kind, j[first].astype(int) - i[first], R[first]
    offsets, by_offset = np.unique(offset, return_inverse=True)
    dear = len(first) * len(slot) > GRID_COST * len(i)
    if dear or len(first) > KINDS_OF_OFFSET * len(offsets):
        pairs = by_offset[kind] * (slot.max() + 1) + i
        if len(offsets) * len(slot) <= GRID_COST_EACH * len(i) and len(np.unique(pairs)) == len(pairs):
            offset, group, R_of = offsets, by_offset[kind], R
            first, kind = _kinds(lengths_of(R), labels)
        elif dear:
            return None
    slots = slot.max() + 1
    length = slots + offset.max()
    length += -length % LINE
    free = np.zeros(length, bool)
    free[slot] = mobile
    bonded = np.zeros((len(offset), length), bool)
    bonded[group, i] = True
    matters = [(free[:slots] | free[o : o + slots]) & ~b[:slots] for o, b in zip(offset, bonded, strict=True)]
    return Layout(slot, length, i, j, R_of, kind, lengths_of(R[first]), first, offset, bonded if np.any(matters) else None, group)


def _kinds(r0, labels):
    """One bond of each kind, and the kind of each bond; kinds differ in length or law."""
    return _alike(len(r0), [np.round(np.log(r0) / SAME_VECTOR), labels])


def _alike(count, columns):
    """First row of each kind of equal rows, sorted, and the kind of each row: like `np.unique(axis=0)`, without sorting rows."""
    kind, first = np.zeros(count, np.int32), np.zeros(1, int)
    for column in columns:
        if not count or (column == column[first][kind]).all():
            continue
        values = _distinct(column)
        code = np.searchsorted(values, column)
        code += np.multiply(kind, len(values), dtype=int)
        kind = np.searchsorted(_distinct(code), code).astype(np.int32)
        first = np.empty(kind.max() + 1, int)
        for some in reversed(stretches(count)):  # the last one that is written is the first row
            first[kind[some][::-1]] = some.start + np.arange(len(kind[some]))[::-1]
    return first[: len(kind)], kind


def _distinct(values):
    """`np.unique` for many values that are mostly alike: a few are sorted first, then only those not among them."""
    found = np.unique(values[:: 1 + len(values) // MANY])
    others = (x[found[np.searchsorted(found[:-1], x)] != x] for x in (values[some] for some in stretches(len(values))))
    return np.unique(np.concatenate([found, *others]))


def _table(count, i, j, R, labels):
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import reverse_cuthill_mckee

    graph = csr_array((np.ones(2 * len(i)), (np.append(i, j), np.append(j, i))), shape=(count, count))
    slot = np.empty(count, int)
    slot[reverse_cuthill_mckee(graph, symmetric_mode=True)] = np.arange(count)
    i, j = slot[i], slot[j]
    r0 = lengths_of(R)
    first, kind = _kinds(r0, labels)
    order = np.lexsort([np.maximum(i, j), np.minimum(i, j), kind])
    return Layout(slot, count + -count % LINE, i[order], j[order], R[order], kind[order], r0[first], first)
