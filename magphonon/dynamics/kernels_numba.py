"""The kernel of compiled steps: the structure laid out as `magphonon.dynamics.compiled_steps` takes it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .compiled_steps import EMPTY, FAR, Bonds, Laws, Moving, advance, write, written
from .kernels_numpy import Kernel
from .memory_layout import LINE, aligned_zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .kernels_numpy import Found, State

RUN = 256
"""Number of slots processed at a time."""
GAP = 32
"""Largest number of holes in a run of slots that are cheaper to fill than to skip."""
CACHE = 2**20
"""Bytes that the levels of a chunk should need at a time, half of a second-level cache of today."""
SAME_SHAPE = 1e-14
"""Relative difference of coefficients up to which laws differ by a factor only."""


class CompiledKernel(Kernel):
    """The same as `Kernel`, compiled; its law is given by coefficients of polynomials, or in `Pieces` for each kind.

    Blocks of steps are shared out to `threads`.
    """

    engine = 'compiled'

    def _prepare(self, fitted):
        layout, law, m = self.layout, self.increments, self.motion
        carry, push, forget = (_aligned(x) for x in (self.carry, self.push, self.forget))
        self._slot = layout.slot.astype(np.uint64)
        self._bonds, along = _grid(layout) if layout.offset is not None else _table(layout)
        self._law = _own(layout, law, fitted, along) if layout.own_laws else _shared(layout, law, fitted)
        driven, row, from_driven = _by_run(m.driven, self._bonds.runs, np.arange(len(m.driven)))
        guided, barred, from_guided = _by_run(m.guided, self._bonds.runs, m.barred)
        self._moving = Moving(m.dt, m.foundation, m.static, m.decay, m.mobility, carry, push, forget, driven, row, from_driven,
                              guided, barred, from_guided)
        self._reach = int((self._bonds.needs - np.arange(len(self._bonds.needs))).max())  # runs from a level to the next
        self._rooms, self._pool = [], None

    def advance(self, state: State, forces: NDArray[np.float64], out: State) -> Found:
        return self._shared_out(state, forces, out, first=0)

    def accelerate(self, u: NDArray[np.float64], a: NDArray[np.float64], force: NDArray[np.float64]) -> float:
        nothing = np.zeros_like(u)
        return self._shared_out((u, nothing, a), force[None], (u, nothing, a), first=1)[0]

    def _shared_out(self, state, forces, out, first):
        levels = len(forces) + 1 - first
        threads = min(self.threads, levels)
        size = max(1, min(self._levels_in_cache(), -(-levels // threads)))
        threads = min(threads, -(-levels // size))
        done = np.zeros(FAR * levels, np.int64)
        while len(self._rooms) < threads:
            self._rooms.append(self._room())
        tasks = [(state, out, forces, self._moving, self._bonds, self._law, *self._rooms[thread], done, first, size, thread,
                  threads, np.zeros(size, np.int64), np.zeros(3)) for thread in range(threads)]
        return np.max(self._together(advance, tasks, done), axis=0)

    def _together(self, function, tasks, done=None):
        """Results of one task for each thread, the first of which is this one."""
        if len(tasks) > 1 and self._pool is None:
            self._pool = ThreadPoolExecutor(self.threads - 1)
        try:
            others = [self._pool.submit(function, *task) for task in tasks[1:]]
        except RuntimeError:  # no more threads
            if done is not None:
                done[:] = np.iinfo(done.dtype).max  # so that those which have begun come to an end
            raise
        return [function(*tasks[0]), *(other.result() for other in others)]

    def _levels_in_cache(self):
        """Levels that fit into the cache one behind the other."""
        bonds = 3 if self.layout.offset is None else len(self.layout.offset)
        each = 48 + bonds * (32 + (64 if self._law.g.ndim == 2 else 0))
        return max(1, CACHE // (self._reach * RUN * each))

    def _room(self):
        """Room for the forces of bonds: all that are listed, or a window on those of a grid."""
        bonds = self._bonds
        if bonds.offsets is None:
            return aligned_zeros((2, 2 * len(bonds.i) + 1)), np.uint64(1)
        active = int(bonds.pad) + (self._levels_in_cache() * self._reach + 2) * RUN
        whole = int(bonds.pad) + int(bonds.runs[-1, 1])
        stride = 3 * LINE + min(2 * active, whole + -whole % LINE)
        return aligned_zeros((2, len(bonds.offsets) * stride)), np.uint64(stride)

    def write(self, *arrays: NDArray[np.float64]) -> None:
        self._together(write, self._parts(arrays))

    def written(self, *arrays: NDArray[np.float64]) -> bool:
        return all(self._together(written, self._parts(arrays)))

    def _parts(self, arrays):
        """Particles shared out to threads."""
        ends = np.linspace(0, len(self._slot), self.threads + 1).astype(np.int64)
        return [(self._slot, s, e, *arrays) for s, e in pairwise(ends)]


def _aligned(array):
    copy = aligned_zeros(array.shape)
    copy[:] = array
    return copy


def _by_run(slots, runs, values):
    """Slots in order, their values, and the first of each run."""
    order = np.argsort(slots)
    first = np.searchsorted(slots[order], runs[:, 0].astype(np.int64))
    return slots[order].astype(np.uint64), values[order], np.append(first, len(slots))


def _grid(layout):
    """The grid, and the function that lays values of the bonds along it."""
    runs, behind = [], 0
    for s, e in layout.runs(gap=GAP, longest=RUN):
        runs += [(k, min(k + RUN, s), EMPTY) for k in range(behind, s, RUN)] + [(s, e, 0)]
        behind = e
    runs = np.array(runs)
    pad = layout.offset.max() + -layout.offset.max() % LINE
    needs = np.searchsorted(runs[:, 0], runs[:, 1] + layout.offset.max())
    R = np.moveaxis(layout.on_grid(layout.R.T), 0, 1).copy() if layout.each else layout.kind_R
    return Bonds(runs.astype(np.uint64), needs, R, np.uint64(pad), tuple(np.uint64(o) for o in layout.offset),
                 None if layout.each else layout.strength), layout.on_grid


def _table(layout):
    """Bonds in order of the run of their lower slot, then of kind if laws are shared; and the function that takes that order."""
    upwards = layout.i < layout.j
    i, j = np.where(upwards, layout.i, layout.j), np.where(upwards, layout.j, layout.i)
    R = np.where(upwards[:, None], layout.R, -layout.R)
    group = np.zeros_like(layout.kind) if layout.own_laws else layout.kind
    order = np.lexsort((j, i, group, i // RUN))
    i, j, R, run, group = i[order], j[order], R[order], i[order] // RUN, group[order]
    starts = np.flatnonzero(np.diff(run, prepend=-1) | np.diff(group, prepend=-1))
    segments = np.column_stack([starts, np.append(starts[1:], len(i)), group[starts]])
    s = np.arange(0, layout.length, RUN)
    within = np.searchsorted(run[starts], np.arange(len(s) + 1))
    runs = np.column_stack([s, np.minimum(s + RUN, layout.length), within[:-1], within[1:]])
    needs = np.arange(1, len(s) + 1)
    np.maximum.at(needs, run, j // RUN + 1)
    slots = np.concatenate([j, i])
    by_slot = np.argsort(slots, kind='stable')
    place = np.arange(len(slots)) - np.searchsorted(slots[by_slot], slots[by_slot])  # among the bonds of its slot
    ends = np.full((place.max(initial=-1) + 1, layout.length), len(slots))
    ends[place, slots[by_slot]] = by_slot
    i, j, ends = (x.astype(np.uint32) for x in (i, j, ends))
    return Bonds(runs.astype(np.uint64), needs, R.T.copy(), segments=segments.astype(np.uint64), i=i, j=j, ends=ends,
                 columns=(0,) * len(ends)), lambda values: _aligned(values[..., None, order])


def _shared(layout, law, fitted):
    """Laws of a few kinds, for r0^2 e."""
    r0 = layout.r0
    if isinstance(fitted, np.ndarray):
        c = fitted / r0[:, None] ** (2 + 2 * np.arange(fitted.shape[1]))
        return Laws(law.q, law.t, law.g, r0**2, c, (0.0,) * c.shape[1])
    return Laws(law.q, law.t, law.g, np.ones(len(r0)), _joined(fitted, r0), ())  # what is reached is no length here


def _own(layout, law, fitted, along):
    """Each bond's law: one times a factor where that is all they differ by."""
    kind, r0 = layout.kind, layout.r0
    if isinstance(fitted, np.ndarray):
        pattern = (0.0,) * fitted.shape[1]
        with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
            shapes = fitted / fitted[:, :1]
        alike = (abs(shapes - shapes[0]) <= SAME_SHAPE * abs(shapes[0])).all()
        factors, shape = (fitted[:, 0], shapes[:1]) if alike else (None, np.moveaxis(along(fitted.T[:, kind]), 0, -2).copy())
    else:
        alone, which, strength = law.shapes
        every = len(fitted) == len(alone.r0)  # the pieces are those of all laws at strength 1, or else of the first kind
        factors, which = (strength, which) if every else (law.factors, 0 * which)
        shape, pattern = _joined(fitted, np.ones(len(fitted))), along(which[kind].astype(float)).astype(np.uint64)
    return Laws(law.q, law.t, along(law.g[kind]), along(1 / r0[kind] ** 2), shape, pattern,
                None if factors is None else along(factors[kind]))


def _joined(pieces, r0):
    """The pieces of all kinds, one after the other."""
    ends = np.cumsum([0, *(len(p.child) for p in pieces)])
    numbers = np.array([(p.per_increment / r**2, p.low, p.high) for p, r in zip(pieces, r0, strict=True)])
    places = np.array([(p.first, root) for p, root in zip(pieces, ends, strict=False)])
    c = np.concatenate([p.coefficients / r**2 for p, r in zip(pieces, r0, strict=True)])
    return numbers, places, np.concatenate([p.child for p in pieces]), np.concatenate([p.centre for p in pieces]), c
