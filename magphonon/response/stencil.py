"""Products with the matrix of squared frequencies K, without storing K, for structures whose bonds lie on a grid.

On a grid the bonds of a group connect each slot to the slot at a constant offset g (`magphonon.dynamics.memory_layout`), and a
row of K y is a sum over shifted slices,

    (K y)_i = D_i y_i + sum_g (A_g,i y_{i+g} + A_g,i-g y_{i-g})        A = -K_b / sqrt(m_i m_j)

with one A for each group if all its bonds are alike, and otherwise one for each bond.  A product with a sparse matrix reads 264
bytes for each particle; this one reads 40, or 130 if bonds differ, and the recurrence of Chebyshev vectors needs no pass of its
own.  Some products share one pass over the slots, each a run or more behind the one before, while their vectors are in the cache.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from ase.constraints import FixAtoms
from numba import njit
from numba.extending import overload
from numpy.typing import NDArray

from ..dynamics.kernel import OPTIONS, kept, vectorise, written_out
from ..dynamics.memory_layout import RUN, aligned_zeros, arrange, runs_of

if TYPE_CHECKING:
    from ..stiffness.rest import LinearSystem

MOST_GROUPS = 9  # three shells of the triangular lattice; each number of groups is compiled by itself, ever longer
ALIKE = 1e-14
"""Bonds of a group count as equal if their stiffness differs by less than this fraction times the length of the structure in
bonds plus ten. Round-off of positions gives 2e-15 per bond, in patches of up to a million particles."""
CACHE = 2**20  # bytes of the vectors and coefficients that the products which go over the slots together have in hand


@dataclass(frozen=True, eq=False)
class Stencil:
    """A symmetric matrix between slots, both components of each; vectors have the shape (columns, 2, slots).

    Attributes
    ----------
    places : ndarray of int, shape (free,)
        Positions of the coordinates of the free directions in a vector of 2 * slots numbers; all other numbers are zero.
    free : ndarray, shape (slots,)
        1 where a particle can move, 0 elsewhere.
    runs : ndarray of int, shape (runs, 2)
        First and last + 1 slot of each stretch that contains particles.
    lag : int
        Number of runs by which a product must stay behind the one before it.
    offsets : tuple of int
        Offset in slots of each group of bonds.
    row_sum : float
        The largest sum of the moduli in a row, which is an upper bound of the highest eigenvalue.
    D, A : ndarray, shape (3, 1) and (3, groups), or (3, 1, slots) and (3, groups, slots)
        Components xx, xy, yy.
    """

    places: np.ndarray
    free: np.ndarray
    runs: np.ndarray
    lag: int
    offsets: tuple[int, ...]
    row_sum: float
    D: np.ndarray
    A: np.ndarray

    def enter(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vectors of coordinates, shape (free, columns), arranged in slots, shape (columns, 2, slots)."""
        slots = aligned_zeros((s.shape[1], 2, len(self.free)))
        slots.reshape(len(slots), -1)[:, self.places] = s.T
        return slots

    def leave(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vectors of coordinates again, the inverse of `enter`."""
        return x.reshape(len(x), -1)[:, self.places].T

    def scaled(self, factor: float, shift: float) -> Stencil:
        """The stencil of the matrix `factor * (K - shift)`."""
        D = self.D.copy()
        D[::2] -= shift
        return replace(self, D=factor * D, A=factor * self.A, row_sum=abs(factor) * self.row_sum)

    def advance(self, x: NDArray[np.float64], y: NDArray[np.float64], count: int = 1, rows: Any = (),
                taken: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Put K x - y into y, then K y - x into x, and so on, `count` times; returns the sums of each new vector with itself and
        with the one before, shape (2, count, columns).  Some rows of the vector before each product are `taken`, an array of the
        shape (count, columns, rows).
        """
        slots, offsets = len(self.free), tuple(np.array(self.offsets, np.uint64))
        sums, places = np.zeros((2, count, len(x))), self.places[:0] if taken is None else self.places[rows]
        taken = np.empty((count, len(x), 0)) if taken is None else taken
        order = np.argsort(places % slots, kind='stable')
        first = np.append(np.searchsorted(places[order] % slots, self.runs[:, 0]), len(places))
        in_hand = 8 * (5 + (self.D.ndim == 3) * (self.D.size + self.A.size) // slots) * self.lag * RUN
        together = max(2, CACHE // in_hand // 2 * 2)
        for n in range(0, count, together):
            some = np.s_[n : n + together]
            advance(x, y, self.D, self.A, self.free, offsets, self.runs, self.lag, sums[:, some], (places[order], order), first,
                    taken[some])
        return sums


def stencil_of(system: LinearSystem) -> Stencil | None:
    """The stencil of K; None if the bonds lie on no grid, or particles are guided or leave the plane."""
    calc, mobile = system.calc, system.mobile
    if system.dim != 2 or not all(isinstance(constraint, FixAtoms) for constraint in system.atoms.constraints):
        return None
    bonds = calc.bonds
    layout = arrange(calc.reference, bonds, 2)
    if layout.offset is None or len(layout.offset) > MOST_GROUPS:
        return None
    offsets = layout.offset
    slots, slot = layout.length, layout.slot
    stiffness, K = calc.rest_stiffness(calc.model), aligned_zeros((3, len(offsets), slots))
    for part, (x, y) in zip(K, ((0, 0), (0, 1), (1, 1)), strict=True):
        part[layout.column, layout.i] = stiffness[layout.bond, x, y]
    D, weight, free = aligned_zeros((3, 1, slots)), np.zeros(slots), aligned_zeros((slots,))
    D[::2, 0, slot] = np.broadcast_to(calc.foundation, (len(system), 2)).T
    weight[slot], free[slot] = mobile / np.sqrt(system.masses), mobile
    for g, o in enumerate(offsets):
        D[:, 0, o:] += K[:, g, :-o]
        D[:, 0] += K[:, g]
        K[:, g, :-o] *= -weight[:-o] * weight[o:]
    D *= weight**2
    rows = abs(D[:, 0])
    for g, o in enumerate(offsets):
        rows += abs(K[:, g])
        rows[:, o:] += abs(K[:, g, :-o])
    row_sum = max((rows[0] + rows[1]).max(), (rows[1] + rows[2]).max())
    places = np.stack([slot, slots + slot], axis=1)[mobile].ravel()
    extent = abs(calc.reference.positions).max() / bonds.lengths.min()
    shared = _shared(D, K, free, offsets, ALIKE * (10 + extent))
    runs = runs_of(slot)
    above = np.searchsorted(runs[:, 0], runs[:, 1] + offsets.max()) - 1  # the last run that a bond of each one reaches
    lag = int((above - np.arange(len(runs))).max(initial=1))
    return Stencil(places, free, runs.astype(np.uint64), lag, tuple(map(int, offsets)), float(row_sum), *(shared or (D, K)))


def _shared(D, A, free, offsets, error):
    """One D and one A of each group; or None unless all free slots have the same D and A, and all pairs of free slots at the
    offset of a group are bonded.
    """
    every = [D[:, 0, free > 0], *(A[:, g, :-o][:, free[:-o] * free[o:] > 0] for g, o in enumerate(offsets))]
    of_all = np.array([x[:, 0] if x.size else np.zeros(3) for x in every]).T
    alike = max(abs(x - x[:, :1]).max(initial=0.0) for x in every) <= error * abs(of_all).max()
    return (of_all[:, :1], of_all[:, 1:]) if alike else None


def _unrolled(arguments, expression):
    return written_out(f'def unrolled({arguments}):\n    return {expression}', 'unrolled')


def shared(D, A, offsets):
    """The D and A that all slots share; if they are read before the loop they stay in registers."""


@overload(shared)
def _shared_by_all(D, A, offsets):
    if D.ndim == 3:
        return lambda D, A, offsets: 0
    parts = [f'{a}[{k}, {g}]' for a, groups in (('D', 1), ('A', len(offsets))) for g in range(groups) for k in range(3)]
    return _unrolled('D, A, offsets', f'({", ".join(parts)},)')


def component(k, c, D, A, x, i, offsets):
    """Component k of (K x)_i."""


@overload(component, prefer_literal=True)
def _component(k, c, D, A, x, i, offsets):
    k, terms = k.literal_value, []
    for xx, m in ((k, 0), (k + 1, 1)):  # xx, xy or xy, yy
        if D.ndim == 2:
            terms.append(f'c[{xx}] * x[{m}, i]')
            terms += [f'c[{3 * g + 3 + xx}] * (x[{m}, i + offsets[{g}]] + x[{m}, i - offsets[{g}]])' for g in range(len(offsets))]
        else:
            terms.append(f'D[{xx}, 0, i] * x[{m}, i]')
            terms += [f'A[{xx}, {g}, i] * x[{m}, i + offsets[{g}]] + A[{xx}, {g}, i - offsets[{g}]] * x[{m}, i - offsets[{g}]]'
                      for g in range(len(offsets))]
    return _unrolled('k, c, D, A, x, i, offsets', ' + '.join(terms))


@njit(no_cpython_wrapper=True, **OPTIONS | {'fastmath': {'contract', 'reassoc'}})  # pyright: ignore[reportCallIssue]  sums in any order
def row(x, y, D, A, free, offsets, s, e):
    """Put K x - y into y in the slots s to e of one column; returns the sums y.y and y.x there."""
    vectorise()  # pyright: ignore[reportCallIssue]  an intrinsic of numba
    c, squared, crossed = shared(D, A, offsets), 0.0, 0.0
    for i in range(s, e):
        px, py = component(0, c, D, A, x, i, offsets), component(1, c, D, A, x, i, offsets)
        px, py = free[i] * px - y[0, i], free[i] * py - y[1, i]
        y[0, i], y[1, i] = px, py
        squared += px * px + py * py
        crossed += px * x[0, i] + py * x[1, i]
    return squared, crossed


@kept(**OPTIONS)
def advance(x, y, D, A, free, offsets, runs, lag, sums, rows, first, taken):
    """Apply `row` to all columns, in turns from x to y and from y to x. Each product stays `lag` runs behind the one before: it
    reads the results of that product and overwrites its source.
    """
    places, to = rows
    for c in range(len(x)):
        for m in range(len(runs) + (len(taken) - 1) * lag):
            for n in range(len(taken)):
                r = m - n * lag
                if r < 0 or r >= len(runs):
                    continue
                source, target = (x[c], y[c]) if n % 2 == 0 else (y[c], x[c])
                for k in range(first[r], first[r + 1]):
                    taken[n, c, to[k]] = source[places[k] // len(free), places[k] % len(free)]
                squared, crossed = row(source, target, D, A, free, offsets, runs[r, 0], runs[r, 1])  # pyright: ignore
                sums[0, n, c] += squared
                sums[1, n, c] += crossed
