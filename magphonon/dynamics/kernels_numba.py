"""The kernel of compiled steps: the structure laid out as `magphonon.dynamics.compiled_steps` takes it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .compiled_steps import EMPTY, advance_grid, advance_table, steps_grid, steps_table, write, written
from .kernels_numpy import Kernel
from .memory_layout import LINE, aligned_zeros

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from .kernels_numpy import State

RUN = 256
"""Number of slots processed at a time."""
GAP = 32
"""Largest number of holes in a run of slots that are cheaper to fill than to skip."""
WINDOW = 4096
"""Number of slots whose bonds are kept; together with one more offset they should fit in the second-level cache."""


class CompiledKernel(Kernel):
    """The same as `Kernel`, compiled; its law is given by coefficients of polynomials, or in `Pieces` for each kind."""

    engine = 'compiled'

    def _prepare(self, fitted):
        layout, law, m = self.layout, self.increments, self.motion
        self.carry, self.push, self.forget = (_aligned(x) for x in (self.carry, self.push, self.forget))
        law = law.q, law.t, law.g, *(_quads if isinstance(fitted, np.ndarray) else _joined)(fitted, layout.r0)
        self._slot = layout.slot.astype(np.uint64)
        self._corrected = m.driven.astype(np.uint64), m.guided.astype(np.uint64), m.barred
        if layout.offset is not None:
            self._compiled_steps, self._advance, self._bonds = steps_grid, advance_grid, (*_grid(layout), *law)
        else:
            self._compiled_steps, self._advance, self._bonds = steps_table, advance_table, (*_table(layout), *law)

    def advance(self, state: State, forces: NDArray[np.float64], out: State) -> float:
        m = self.motion
        return self._advance(state, out, forces, (self.carry, self.push, m.dt, m.foundation), m.decay, m.mobility, self.forget,
                             self._corrected, self._bonds)

    def accelerate(self, u: NDArray[np.float64], a: NDArray[np.float64], force: NDArray[np.float64]) -> float:
        a[:] = 0
        m = self.motion
        return self._compiled_steps(u, a, force[None], self.forget, m.mobility, 0.0, m.foundation, self._corrected, self._bonds)

    def write(self, *arrays: NDArray[np.float64]) -> None:
        write(self._slot, *arrays)

    def written(self, *arrays: NDArray[np.float64]) -> bool:
        return written(self._slot, *arrays)


def _quads(coefficients, r0):
    """Square of the lengths, coefficients for r0^2 e instead of e, and a tuple of as many fours."""
    c = np.pad(coefficients, ((0, 0), (0, -coefficients.shape[1] % 4)))
    return r0**2, c / r0[:, None] ** (2 + 2 * np.arange(c.shape[1])), ((0.0,) * 4,) * (c.shape[1] // 4)


def _joined(pieces, r0):
    """What is reached is no length here; the pieces of all kinds, one after the other; and no pattern."""
    ends = np.cumsum([0, *(len(p.child) for p in pieces)])
    numbers = np.array([(p.per_increment / r**2, p.low, p.high) for p, r in zip(pieces, r0, strict=True)])
    places = np.array([(p.first, root) for p, root in zip(pieces, ends, strict=False)])
    c = np.concatenate([p.coefficients / r**2 for p, r in zip(pieces, r0, strict=True)])
    return np.ones(len(r0)), (numbers, places, np.concatenate([p.child for p in pieces]),
                              np.concatenate([p.centre for p in pieces]), c), ()


def _aligned(array):
    copy = aligned_zeros(array.shape)
    copy[:] = array
    return copy


def _grid(layout):
    """Window of bonds, its lead over the slots, runs of slots with or without particles, offsets, rest vectors, strength."""
    runs, behind = [], 0
    for s, e in layout.runs(gap=GAP, longest=RUN):
        runs += [(k, min(k + RUN, s), EMPTY) for k in range(behind, s, RUN)] + [(s, e, 0)]
        behind = e
    pad = layout.offset.max() + -layout.offset.max() % LINE
    b = aligned_zeros((2, len(layout.offset), pad + max(WINDOW, pad + RUN)))
    offsets = tuple(np.uint64(o) for o in layout.offset)
    return b, np.uint64(pad), np.array(runs, np.uint64), offsets, layout.kind_R, layout.strength


def _table(layout):
    """Bonds in order of the run of their lower slot, then of their kind; and where each slot finds its forces."""
    upwards = layout.i < layout.j
    i, j = np.where(upwards, layout.i, layout.j), np.where(upwards, layout.j, layout.i)
    R = np.where(upwards[:, None], layout.R, -layout.R)
    order = np.lexsort((j, i, layout.kind, i // RUN))
    i, j, R, run, kind = i[order], j[order], R[order], i[order] // RUN, layout.kind[order]
    starts = np.flatnonzero(np.diff(run, prepend=-1) | np.diff(kind, prepend=-1))
    segments = np.column_stack([starts, np.append(starts[1:], len(i)), kind[starts]])
    s = np.arange(0, layout.length, RUN)
    within = np.searchsorted(run[starts], np.arange(len(s) + 1))
    runs = np.column_stack([s, np.minimum(s + RUN, layout.length), within[:-1], within[1:]])
    slots = np.concatenate([j, i])
    order = np.argsort(slots, kind='stable')
    place = np.arange(len(slots)) - np.searchsorted(slots[order], slots[order])  # among the bonds of its slot
    ends = np.full((place.max() + 1, layout.length), len(slots))
    ends[place, slots[order]] = order
    runs, segments = runs.astype(np.uint64), segments.astype(np.uint64)
    i, j, ends = (x.astype(np.uint32) for x in (i, j, ends))
    return aligned_zeros((2, len(slots) + 1)), runs, segments, i, j, *R.T.copy(), ends, (0,) * len(ends)
