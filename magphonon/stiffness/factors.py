"""Sparse factors of matrices of symmetric pattern, whose rows are eliminated in the order of a nested dissection."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from numpy.typing import NDArray
    from scipy.sparse.linalg import LinearOperator, SuperLU

LARGE = 2500  # rows from which the dissection saves more time than it takes
LANDMARKS = 6
"""Rows from which hops are counted.  Three would do for a patch; around a torus distances fold, and four leave squares on it with
three times the fill."""
LEAF = 16  # rows, about, that are not divided any more; from 4 to 32 the fill is the same within 2 %
BACKWARD = 1e-13  # residual by |A| |x| + |b| above which diagonal pivots are given up; it is 1e-16 where they are sound


@dataclass(frozen=True, eq=False)
class Factors:
    """L and U of a matrix whose columns are eliminated in the same order as its rows."""

    order: NDArray[np.int_]
    lu: SuperLU
    real: bool

    def solve(self, b: NDArray[Any]) -> NDArray[Any]:
        """The x of A x = b, for one right side or for columns of them."""
        if self.real and np.iscomplexobj(b):
            return self.solve(np.real(b)) + 1j * self.solve(np.imag(b))
        found = self.lu.solve(b[self.order])
        x = np.empty_like(found)
        x[self.order] = found
        return x

    @property
    def operator(self) -> LinearOperator:
        """The inverse of the matrix, for iterations."""
        return sparse.linalg.LinearOperator(2 * self.order.shape, self.solve, dtype=float if self.real else complex)

    def negative(self) -> int | None:
        """Number of negative eigenvalues of a Hermitian matrix, that of negative pivots (Sylvester); None where a pivot on the
        diagonal was zero.
        """
        return int((~(self.lu.U.diagonal().real > 0)).sum()) if np.array_equal(self.lu.perm_r, self.lu.perm_c) else None


def factorised(A: sparse.csr_array, order: NDArray[np.int_] | None = None) -> Factors:
    """Factors of a matrix of symmetric pattern with its diagonal as pivots; `order` is that of factors of the same pattern.

    Pivots off the diagonal would fill the factors and hide the signs of eigenvalues; a definite matrix needs none.  RuntimeError
    if the matrix is singular.
    """
    A, large = sparse.csr_array(A), A.shape[0] > LARGE
    if order is None:
        order = elimination_order(A) if large else np.arange(A.shape[0])
    lu = sparse.linalg.splu(sparse.csc_array(A[order][:, order] if large else A), 'NATURAL' if large else 'MMD_AT_PLUS_A',
                            diag_pivot_thresh=0.0, options={'SymmetricMode': True})
    return Factors(order, lu, not np.iscomplexobj(A))


def inverse(A: sparse.csr_array) -> Callable[[NDArray[Any]], NDArray[Any]]:
    """The function b -> x of A x = b, for a matrix of symmetric pattern that need not be definite.

    One step of refinement recovers the digits that diagonal pivots cost; where it fails, others are taken.  RuntimeError if the
    matrix is singular.
    """
    factors, largest = factorised(A), abs(A).sum(axis=1).max(initial=0.0)

    def solve(b):
        x = factors.solve(b)
        x = x + factors.solve(b - A @ x)
        if abs(b - A @ x).max(initial=0.0) <= BACKWARD * (largest * abs(x).max(initial=0.0) + abs(b).max(initial=0.0)):
            return x
        return Factors(np.arange(len(b)), sparse.linalg.splu(sparse.csc_array(A)), factors.real).solve(b)

    return solve


def elimination_order(A: sparse.csr_array) -> NDArray[np.int_]:
    """The order of rows by nested dissection (George, SIAM J. Numer. Anal. 10, 345, 1973), shape (rows,).

    Rows are parted into halves, and each half again; those of the first half that touch the second come after both.  Coordinates
    are hops in the graph of the entries: so it holds for any matrix, and a cut between two numbers of hops is one row wide.
    """
    size, along = A.shape[0], _hops_from_landmarks(A)
    squares = along**2
    levels = max(0, int(np.ceil(np.log2(max(size, 1) / LEAF))))
    box, every = np.zeros(size, int), np.arange(size)
    for boxes in 2 ** np.arange(levels):
        count = np.maximum(np.bincount(box, minlength=boxes), 1)
        mean, square = (np.array([np.bincount(box, x, boxes) for x in of]) / count for of in (along, squares))
        axis = (square - mean**2).argmax(axis=0)
        box = 2 * box + (along[axis[box], every] > mean[axis, np.arange(boxes)][box])
    i, j = np.repeat(every, np.diff(A.indptr)), A.indices
    i, j = (end[box[i] < box[j]] for end in (i, j))
    parted = np.frexp(box[i] ^ box[j])[1]  # levels above the leaves of the cut that parts i from j
    height = np.zeros(size, int)
    downwards = np.argsort(-parted.astype(np.int8), kind='stable')
    for pairs in np.split(downwards, np.flatnonzero(np.diff(parted[downwards])) + 1):
        a, b = i[pairs], j[pairs]
        height[a[(height[a] == 0) & (height[b] == 0)]] = parted[pairs[0]] if len(pairs) else 0
    return np.lexsort((height, box | ((1 << height) - 1)))


def _hops_from_landmarks(A):
    """Numbers of hops to each row from a few that are far apart, shape (LANDMARKS, rows)."""
    graph = sparse.csr_array((np.ones(A.nnz), A.indices, A.indptr), A.shape)
    first = np.unique(sparse.csgraph.connected_components(graph)[1], return_index=True)[1]
    if len(first) > 1:  # pieces are made a chain
        links = sparse.csr_array((np.ones(len(first) - 1), (first[:-1], first[1:])), A.shape)
        graph = sparse.csr_array(graph + links + links.T)
    found = [_hops(graph, _hops(graph, 0).argmax())]
    while len(found) < LANDMARKS:
        found.append(_hops(graph, np.min(found, axis=0).argmax()))
    return np.array(found)


def _hops(graph, start):
    """From a row to each, by a search in breadth that says only from where each row was reached."""
    _, up = sparse.csgraph.breadth_first_order(graph, start)
    hops, up = (up >= 0).astype(float), np.where(up < 0, start, up)
    while (further := hops[up]).any():
        hops += further
        up = up[up]
    return hops
