"""The kernel of compiled steps: the structure laid out as `compiled_steps` and `compiled_bonds` take it."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cached_property
from itertools import chain, pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .bond_increments import RANGES
from .compiled_bonds import grid_pull, law_in_reach, table_pull
from .compiled_steps import FAR, advance, grid_move, table_move, write, written
from .kernels_numpy import Kernel
from .memory_layout import LINE, aligned_zeros

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from numpy.typing import NDArray

    from .kernels_numpy import Found, State
    from .machine_code import Compiled

RUN = 256
"""Number of slots processed at a time."""
GAP = 32
"""Largest number of holes in a run of slots that are cheaper to fill than to skip."""
CACHE = 2**20
"""Bytes that the levels of a chunk should need at a time, half of a second-level cache of today."""
SAME_SHAPE = 1e-14
"""Relative difference of coefficients up to which laws differ by a factor only."""
REACHES = RANGES[2], RANGES[-1]
"""Largest increments |e| in a run of slots whose bonds take a polynomial although others need the pieces; to find that they do
not costs the time of one group of bonds."""


FEW = 4
"""Number of tables of addresses that are kept for states and atoms: those of two states that take turns."""


class Addresses:
    """A table of addresses of arrays, functions and other tables, which it keeps; zero of what does not exist."""

    def __init__(self, *things: np.ndarray | Compiled | Addresses | None) -> None:
        self.things = [np.ascontiguousarray(x) if isinstance(x, np.ndarray) else x for x in things]
        self.table = np.array([_address(x) for x in self.things])
        self.address = _address(self.table)


def _address(thing):
    if thing is None:
        return 0
    return thing.ctypes.data if isinstance(thing, np.ndarray) else thing.address


@dataclass(frozen=True)
class Bonds:
    """Bonds between slots, on a grid or in a table; what belongs to the other one is None.

    Attributes
    ----------
    runs : ndarray of int, shape (runs, 4)
        First and last + 1 slot of each run, first and last + 1 of its groups (none if all its slots are empty) or segments.
    needs : ndarray of int, shape (runs,)
        For each run the number of runs of which all slots must have moved in the level before.
    places : ndarray of int
        On a grid, j - i of each group; in a table, places of the forces on each slot, shape (columns, slots).
    R : ndarray, shape (2, kinds) or (2, bonds)
        Rest vectors.
    along : callable
        Lays values of the bonds, shape (..., bonds), out in the order in which they are evaluated.
    pad : int
        On a grid, bonds of slot i stand so many places later.
    segments : ndarray of int, shape (segments, 3), or None
        First and last + 1 bond and kind of each segment.
    i, j : ndarray of int, or None
        Lower and upper slots.
    listed : int
        Number of bonds in a table.
    """

    runs: np.ndarray
    needs: np.ndarray
    places: np.ndarray
    R: np.ndarray
    along: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    pad: int = -1
    segments: np.ndarray | None = None
    i: np.ndarray | None = None
    j: np.ndarray | None = None
    listed: int = 0

    @property
    def windows(self) -> int:
        """Number of windows on forces: one on each group, or one for each end of a listed bond and one for a bond of no force."""
        return len(self.places) if self.pad >= 0 else 2 * self.listed + 1


class Law(NamedTuple):
    """A law of bonds or kinds as `compiled_bonds` takes it: its name there, number of coefficients, and arrays."""

    name: str
    count: int
    g: NDArray[np.float64]
    unit: NDArray[np.float64]
    arrays: Sequence[np.ndarray]
    factors: NDArray[np.float64] | None = None
    which: NDArray[np.int_] | None = None


class CompiledKernel(Kernel):
    """The same as `Kernel`, compiled; its law is given by coefficients of polynomials, or in `Pieces` for each kind.

    Blocks of steps are shared out to `threads`.
    """

    engine = 'compiled'

    def _prepare(self, fitted):
        layout, m = self.layout, self.motion
        self._grid = layout.offset is not None
        bonds = self._bonds = (_grid if self._grid else _table)(layout)
        pull, pulled = self._pull(fitted)
        springs, loaded = np.ndim(m.foundation) > 0, m.static is not None
        move = (grid_move if self._grid else table_move)(len(bonds.places), springs, loaded)
        k = np.ascontiguousarray(m.foundation, float)
        moved = Addresses(np.array([layout.length]), k, m.static, bonds.places)
        driven, row, from_driven = _by_run(m.driven, bonds.runs, np.arange(len(m.driven)))
        guided, barred, from_guided = _by_run(m.guided, bonds.runs, m.barred)
        sizes = np.array([len(bonds.runs), layout.length, len(driven), bonds.windows, bonds.pad])
        carry, push, forget = (_aligned(x) for x in (self.carry, self.push, self.forget))
        self._advance = advance()
        self._given = Addresses(bonds.runs, bonds.needs, m.decay, carry, push, forget, m.mobility, driven, row, from_driven,
                                guided, from_guided, barred, np.array([m.dt]), sizes, pull, pulled, move, moved)
        self._reach = int((bonds.needs - np.arange(len(bonds.needs))).max())  # runs from a level to the next
        self._rooms, self._pool, self._known = [], None, {}

    def _pull(self, fitted):
        """The function of the forces of bonds, and what is given to it."""
        if isinstance(fitted, np.ndarray):
            return self._by_law(fitted, np.inf)
        fits = {reach: self.increments.polynomial(reach) for reach in REACHES}
        laws = [*(self._by_law(fit[0], reach) for reach, fit in fits.items() if fit), self._by_law(fitted, 1.0)]
        return law_in_reach(), Addresses(np.array([len(laws)]), *chain(*laws))

    def _by_law(self, fitted, reach):
        """The same by a single law."""
        layout, law, bonds, own = self.layout, self.increments, self._bonds, self.layout.own_laws
        of = (_own if own else _shared)(layout, law, fitted, bonds.along)
        strength = None if layout.each else layout.strength
        function = (grid_pull(of.name, of.count, own, strength is not None) if self._grid
                    else table_pull(of.name, of.count, own))
        sizes = np.array([layout.length if self._grid else bonds.listed, of.g.size])
        return function, Addresses(np.array([law.q, law.t, reach]), sizes, bonds.R, of.g, of.unit, bonds.places, strength,
                                   bonds.segments, bonds.i, bonds.j, of.factors, of.which, *of.arrays)

    def advance(self, state: State, forces: NDArray[np.float64], out: State) -> Found:
        return self._shared_out(state, forces, out, first=0)

    def accelerate(self, u: NDArray[np.float64], a: NDArray[np.float64], force: NDArray[np.float64]) -> float:
        nothing = np.zeros_like(u)
        return self._shared_out((u, nothing, a), force[None], (u, nothing, a), first=1)[0]

    def _shared_out(self, state, forces, out, first):
        steps = len(forces)
        levels = steps + 1 - first
        threads = min(self.threads, levels)
        size = max(1, min(self._levels_in_cache, -(-levels // threads)))
        threads = min(threads, -(-levels // size))
        while len(self._rooms) < threads:
            self._rooms.append(self._room())
        counters, found = np.zeros(FAR * levels + threads * size, np.int64), np.zeros((threads, FAR))
        ends, forces = self._addresses(*state, *out), np.ascontiguousarray(forces)
        block = self._given.address, ends, _address(forces), steps, first, size, threads, _address(counters), _address(found)
        tasks = [(*block, thread, room, stride) for thread, (_, room, stride) in enumerate(self._rooms[:threads])]
        self._together(self._advance.call, tasks, done=counters[: FAR * levels])
        return tuple((found[0] if threads == 1 else found.max(axis=0))[:3].tolist())

    def _addresses(self, *arrays):
        """The address of the table of their addresses; asking NumPy for each takes as long as a step of a hundred particles."""
        key = tuple(map(id, arrays))
        if key not in self._known:
            self._known = dict([*self._known.items()][-FEW:])
            self._known[key] = Addresses(*arrays)
        return self._known[key].address

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

    @cached_property
    def _levels_in_cache(self):
        """Levels that fit into the cache one behind the other."""
        groups = len(self._bonds.places) if self._grid else 3
        each = 48 + groups * (32 + (64 if self.layout.own_laws else 0))
        return max(1, CACHE // (self._reach * RUN * each))

    def _room(self):
        """Room for the forces of bonds, all that are listed, or a window on those of a grid; its address and that length."""
        bonds, stride = self._bonds, 1
        if self._grid:
            active = bonds.pad + (self._levels_in_cache * self._reach + 2) * RUN
            whole = bonds.pad + int(bonds.runs[-1, 1])
            stride = 3 * LINE + min(2 * active, whole + -whole % LINE)
        room = aligned_zeros((2, bonds.windows * stride))
        return room, _address(room), stride

    def write(self, *arrays: NDArray[np.float64]) -> None:
        if self._addressable(*arrays):
            self._together(write(self.layout.whole).call, self._parts(arrays))
        else:
            super().write(*arrays)

    def written(self, *arrays: NDArray[np.float64]) -> bool:
        if self._addressable(*arrays):
            return all(self._together(written(self.layout.whole).call, self._parts(arrays)))
        return super().written(*arrays)

    def _addressable(self, u, v, anchors, masses, positions, momenta):
        """Whether the atoms hold their arrays as ASE makes them: a user may have put others in their place."""
        return all(x.flags.c_contiguous and x.dtype == float and len(x) == len(masses) for x in (positions, momenta))

    def _parts(self, arrays):
        """Particles shared out to threads."""
        count, length, given = len(self.layout.slot), self.layout.length, self._addresses(self.layout.slot, *arrays)
        ends = [count * n // self.threads for n in range(self.threads + 1)]
        return [(given, s, e, count, length) for s, e in pairwise(ends)]


def _aligned(array):
    copy = aligned_zeros(array.shape)
    copy[:] = array
    return copy


def _by_run(slots, runs, values):
    """Slots in order, their values, and the first of each run."""
    order = np.argsort(slots)
    first = np.searchsorted(slots[order], runs[:, 0])
    return slots[order], values[order], np.append(first, len(slots))


def _grid(layout):
    runs, behind, groups = [], 0, len(layout.offset)
    for s, e in layout.runs(gap=GAP, longest=RUN):
        runs += [(k, min(k + RUN, s), 0, 0) for k in range(behind, s, RUN)] + [(s, e, 0, groups)]
        behind = e
    runs = np.array(runs)
    pad = int(layout.offset.max() + -layout.offset.max() % LINE)
    needs = np.searchsorted(runs[:, 0], runs[:, 1] + layout.offset.max())
    R = layout.on_grid(layout.R.T) if layout.each else np.ascontiguousarray(layout.kind_R.T)
    return Bonds(runs, needs, layout.offset, R, layout.on_grid, pad)


def _table(layout):
    """Bonds in order of the run of their lower slot, then of kind if laws are shared."""
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
    return Bonds(runs, needs, ends, R.T.copy(), lambda values: _aligned(values[..., order]), segments=segments, i=i, j=j,
                 listed=len(i))


def _shared(layout, law, fitted, along):
    """Laws of a few kinds, for r0^2 e."""
    r0 = layout.r0
    if isinstance(fitted, np.ndarray):
        c = fitted / r0[:, None] ** (2 + 2 * np.arange(fitted.shape[1]))
        return Law('polynomial', c.shape[1], law.g, 1 / r0**2, [c])
    return Law(_name(fitted), 0, law.g, np.ones(len(r0)), _joined(fitted, r0))  # what is reached is no length here


def _own(layout, law, fitted, along):
    """Each bond's law: one times a factor where that is all they differ by."""
    kind, r0 = layout.kind, layout.r0
    g, unit = along(law.g[kind]), along(1 / r0[kind] ** 2)
    if isinstance(fitted, np.ndarray):
        with np.errstate(divide='ignore', invalid='ignore'):  # of a law that is zero there, as far as numbers go
            shapes = fitted / fitted[:, :1]
        if (abs(shapes - shapes[0]) <= SAME_SHAPE * abs(shapes[0])).all():
            return Law('common polynomial', fitted.shape[1], g, unit, [shapes[:1]], along(fitted[kind, 0]))
        return Law('own polynomial', fitted.shape[1], g, unit, [along(fitted.T[:, kind])])
    alone, which, strength = law.shapes
    every = len(fitted) == len(alone.r0)  # the pieces are those of all laws at strength 1, or else of the first kind
    factors, which = (strength, which) if every else (law.factors, 0 * which)
    return Law('own ' + _name(fitted), 0, g, unit, _joined(fitted, np.ones(len(fitted))), along(factors[kind]),
               along(which[kind].astype(float)).astype(int))


def _name(pieces):
    return 'halved pieces' if any((p.child >= 0).any() for p in pieces) else 'pieces'


def _joined(pieces, r0):
    """The pieces of all kinds, one after the other."""
    ends = np.cumsum([0, *(len(p.child) for p in pieces)])
    numbers = np.array([(p.per_increment / r**2, p.low, np.nextafter(p.high, 0)) for p, r in zip(pieces, r0, strict=True)])
    places = np.array([(p.first, root) for p, root in zip(pieces, ends, strict=False)])
    c = np.concatenate([p.coefficients / r**2 for p, r in zip(pieces, r0, strict=True)])
    return numbers, places, c, np.concatenate([p.child for p in pieces]), np.concatenate([p.centre for p in pieces])
