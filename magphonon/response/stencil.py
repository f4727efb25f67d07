"""Products with the matrix of squared frequencies without the matrix, where the bonds lie on a grid.

There the bonds fall into groups that lead from each slot to one a constant offset away (`magphonon.dynamics.memory_layout`), and
a row of K y is a sum over shifted slices,

    (K y)_i = D_i y_i + sum_g (A_g,i y_{i+g} + A_g,i-g y_{i-g})        A = -K_b / sqrt(m_i m_j)

with one A for each group where all its bonds are alike, and one for each bond elsewhere.  A sparse matrix reads 264 bytes of each
particle; this reads 40, or 130, and the recurrence of Chebyshev vectors needs no pass of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms
from numba import njit
from numba.extending import overload

from ..dynamics.kernels_numba import GAP, OPTIONS, RUN, kept, part, unrolled, vectorise
from ..dynamics.memory_layout import LINE, aligned_zeros, arrange

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from ..stiffness.rest import LinearSystem

MOST_GROUPS = 9  # three shells of the triangular lattice; each number of groups is compiled by itself, ever longer
ALIKE = 1e-13  # relative difference of stiffness below which the bonds of a group are one


@dataclass(frozen=True, eq=False)
class Stencil:
    """A symmetric matrix between slots, both components of each; vectors have the shape (columns, 2, slots).

    Attributes
    ----------
    places : ndarray of int, shape (free,)
        Where the coordinates of the free directions are in a vector, of 2 slots numbers; all others are zero.
    free : ndarray, shape (slots,)
        1 where a particle can move, 0 elsewhere.
    runs : ndarray of int, shape (runs, 2)
        First slots and last + 1 of stretches with particles.
    offsets : tuple of int
        Of each group of bonds.
    D, A : ndarray, shape (3, 1) and (3, groups), or (3, 1, slots) and (3, groups, slots)
        Components xx, xy, yy.
    row_sum : float
        The largest sum of moduli of a row, which bounds the highest eigenvalue.
    """

    places: np.ndarray
    free: np.ndarray
    runs: np.ndarray
    offsets: tuple[int, ...]
    D: np.ndarray
    A: np.ndarray
    row_sum: float

    def enter(self, s: NDArray[np.float64]) -> NDArray[np.float64]:
        """Vectors of coordinates, shape (free, columns), in slots."""
        slots = aligned_zeros((s.shape[1], 2, len(self.free)))
        slots.reshape(len(slots), -1)[:, self.places] = s.T
        return slots

    def taken(self, x: NDArray[np.float64], rows: Any) -> NDArray[np.float64]:
        """Some rows of vectors, shape (rows, columns)."""
        return x.reshape(len(x), -1)[:, self.places[rows]].T

    def scaled(self, factor: float, shift: float) -> Stencil:
        """The same of factor (K - shift)."""
        D = self.D.copy()
        D[::2] -= shift
        return replace(self, D=factor * D, A=factor * self.A, row_sum=abs(factor) * self.row_sum)

    def advance(self, x: NDArray[np.float64], y: NDArray[np.float64]) -> NDArray[np.float64]:
        """Put K x - y into y; returns the sums y.y and y.x of each column, shape (2, columns)."""
        sums = np.zeros((2, len(x)))
        offsets = tuple(np.array(self.offsets, np.uint64))
        advance(x, y, self.D, self.A, self.free, offsets, self.runs, sums)
        return sums


def stencil_of(system: LinearSystem) -> Stencil | None:
    """The stencil of K, or None where the bonds lie on no grid, particles are guided, or leave the plane."""
    calc, mobile, n = system.calc, system.mobile, len(system)
    if system.dim != 2 or not all(isinstance(constraint, FixAtoms) for constraint in system.atoms.constraints):
        return None
    bonds = calc.bonds
    layout = arrange(calc.reference, bonds, mobile)
    if layout.offset is None or len(layout.offset) > MOST_GROUPS or np.ndim(calc.site_stiffness) == 3:
        return None
    weight = mobile / np.sqrt(system.masses)
    other = bonds.i != bonds.j  # a bond to one's own image never changes
    K, i, j = calc.rest_stiffness(calc.model)[other], bonds.i[other], bonds.j[other]
    K = np.stack([K[:, 0, 0], K[:, 0, 1], K[:, 1, 1]])
    own = np.stack([np.bincount(i, k, n) + np.bincount(j, k, n) for k in K])
    own[::2] += np.broadcast_to(calc.site_stiffness, (n, 2)).T
    own *= weight**2
    K = -weight[i] * weight[j] * K
    margin = int(layout.offset.max()) + -int(layout.offset.max()) % LINE
    slots = layout.length + margin
    slot = margin + layout.slot
    D, A = aligned_zeros((3, 1, slots)), aligned_zeros((3, len(layout.offset), slots))
    D[:, 0, slot], A[:, layout.group, margin + layout.i] = own, K
    places = np.stack([slot, slots + slot], axis=1)[mobile].ravel()
    rows = abs(D)[:, 0, slot]
    for k, at in ((abs(K), i), (abs(K), j)):
        rows = rows + np.stack([np.bincount(at, part, n) for part in k])
    row_sum = max((rows[0] + rows[1])[mobile].max(), (rows[1] + rows[2])[mobile].max())
    free = aligned_zeros((slots,))
    free[slot] = mobile
    shared = _shared(D, A, free, layout.offset)
    runs = (margin + layout.runs(GAP, RUN)).astype(np.uint64)
    return Stencil(places, free, runs, tuple(map(int, layout.offset)), *(shared or (D, A)), float(row_sum))


def _shared(D, A, free, offsets):
    """One D and one A of each group, if all free slots have the same, and every two free slots that far apart are bonded."""
    first = D[..., free > 0]
    alike = abs(first - first[..., :1]).max() <= ALIKE * abs(first).max()
    of_group = []
    for g, offset in enumerate(offsets):
        both = np.flatnonzero(free[:-offset] * free[offset:])
        if not len(both):
            of_group.append(np.zeros(3))
            continue
        own = A[:, g, both]
        alike &= abs(own - own[:, :1]).max() <= ALIKE * abs(first).max()
        of_group.append(own[:, 0])
    return (first[..., 0], np.array(of_group).T) if alike else None


def shared(D, A, offsets):
    """What all slots share, D and A of each group; read before the loop it stays in registers."""


@overload(shared)
def _shared_by_all(D, A, offsets):
    if D.ndim == 3:
        return lambda D, A, offsets: 0
    parts = [f'{a}[{k}, {g}]' for a, groups in (('D', 1), ('A', len(offsets))) for g in range(groups) for k in range(3)]
    return unrolled('D, A, offsets', f'({", ".join(parts)},)')


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
    return unrolled('k, c, D, A, x, i, offsets', ' + '.join(terms))


@part
def row(x, y, D, A, free, offsets, s, e):
    """Put K x - y into y in the slots s to e of one column."""
    vectorise()  # pyright: ignore[reportCallIssue]  an intrinsic of numba
    c = shared(D, A, offsets)
    for i in range(s, e):
        px, py = component(0, c, D, A, x, i, offsets), component(1, c, D, A, x, i, offsets)
        y[0, i], y[1, i] = free[i] * px - y[0, i], free[i] * py - y[1, i]


@njit(no_cpython_wrapper=True, **OPTIONS | {'fastmath': {'contract', 'reassoc'}})  # pyright: ignore[reportCallIssue]  sums in any order
def products(x, y, s, e):
    """Sums y.y and y.x over the slots s to e of one column."""
    squared = crossed = 0.0
    for k in range(2):
        for i in range(s, e):
            squared += y[k, i] * y[k, i]
            crossed += y[k, i] * x[k, i]
    return squared, crossed


@kept
def advance(x, y, D, A, free, offsets, runs, sums):
    """`row` for all columns, run by run, and the `products`."""
    for start, end in runs:
        for c in range(len(x)):
            row(x[c], y[c], D, A, free, offsets, start, end)
            squared, crossed = products(x[c], y[c], start, end)
            sums[0, c] += squared
            sums[1, c] += crossed
