"""Sparse factors of matrices of symmetric pattern: by CHOLMOD if definite, where cvxopt is installed, or by SuperLU."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.sparse.linalg import LinearOperator, SuperLU

LARGE = 2500  # rows from which CHOLMOD saves more time than it takes to load it
BACKWARD = 1e-13  # residual by |A| |x| + |b| above which diagonal pivots are given up; it is 1e-16 where they are sound


@dataclass(frozen=True, eq=False)
class Factors:
    """Factors of a matrix A, whose columns are eliminated in the same order as its rows; they solve A x = b.

    Attributes
    ----------
    rows : int
    by : callable
        Function that returns x for b; b must be real if A is `real`, and may be complex otherwise.
    real : bool
    lu : SuperLU or None
        None if CHOLMOD has proved that the matrix is definite.
    order : ndarray of int, shape (rows,), or None
        The order of elimination, for matrices of the same pattern.
    """

    rows: int
    by: Callable[[NDArray[Any]], NDArray[Any]]
    real: bool
    lu: SuperLU | None = None
    order: NDArray[np.int_] | None = None

    def solve(self, b: NDArray[Any]) -> NDArray[Any]:
        """The solution x of A x = b, for one right side b or for several in columns."""
        if self.real and np.iscomplexobj(b):
            return self.by(np.real(b)) + 1j * self.by(np.imag(b))
        return self.by(b)

    @property
    def operator(self) -> LinearOperator:
        """The inverse of the matrix, for iterations."""
        return sparse.linalg.LinearOperator((self.rows, self.rows), self.solve, dtype=float if self.real else complex)

    def negative(self) -> int | None:
        """Number of negative eigenvalues of a Hermitian matrix, which is that of negative pivots (Sylvester); None if a pivot on
        the diagonal was zero.
        """
        if self.lu is None:
            return 0
        return int((~(self.lu.U.diagonal().real > 0)).sum()) if np.array_equal(self.lu.perm_r, self.lu.perm_c) else None


def factorised(A: sparse.csr_array, order: NDArray[np.int_] | None = None, definite: bool = False) -> Factors:
    """Factors of a matrix of symmetric pattern with pivots on its diagonal; `order` reuses that of factors of the same pattern.

    Pivots off the diagonal would fill the factors and hide the signs of eigenvalues.  With `definite`, a Cholesky factorisation
    is tried first, which succeeds only for definite matrices.  RuntimeError if the matrix is singular.
    """
    A, rows, real = sparse.csr_array(A), A.shape[0], not np.iscomplexobj(A)
    by = _cholesky(A) if definite and real and rows > LARGE else None
    if by is not None:
        return Factors(rows, by, real)
    permuted, method = (A, 'MMD_AT_PLUS_A') if order is None else (A[order][:, order], 'NATURAL')
    lu = sparse.linalg.splu(sparse.csc_array(permuted), method, diag_pivot_thresh=0.0, options={'SymmetricMode': True})
    if order is None:
        return Factors(rows, lu.solve, real, lu, np.argsort(lu.perm_c))
    back = np.argsort(order)
    return Factors(rows, lambda b: lu.solve(b[order])[back], real, lu, order)


def _cholesky(A):
    """The function b -> x by CHOLMOD; None if it is not installed, or if the matrix is not definite."""
    try:
        from cvxopt import cholmod, matrix, spmatrix  # pyright: ignore[reportAttributeAccessIssue]  compiled, without a stub
    except ImportError:
        return None
    lower = sparse.tril(A, format='coo')
    kept = spmatrix(*(matrix(x) for x in (lower.data, lower.row.astype(np.int64), lower.col.astype(np.int64))), A.shape)
    del lower  # factors are largest where they are made
    factor = cholmod.symbolic(kept, uplo='L')
    try:
        cholmod.numeric(kept, factor)
    except ArithmeticError:
        return None

    def solve(b):
        x = matrix(np.asarray(b, float))
        cholmod.solve(factor, x)
        return np.array(x).reshape(b.shape)

    return solve


@dataclass(frozen=True, eq=False)
class Inverse:
    """The function b -> x that solves A x = b, with one step of iterative refinement."""

    A: sparse.csr_array
    factors: Factors

    def __call__(self, b: NDArray[Any]) -> NDArray[Any]:
        A, largest = self.A, abs(self.A).sum(axis=1).max(initial=0.0)
        x = self.factors.solve(b)
        x = x + self.factors.solve(b - A @ x)
        if abs(b - A @ x).max(initial=0.0) <= BACKWARD * (largest * abs(x).max(initial=0.0) + abs(b).max(initial=0.0)):
            return x
        return Factors(len(b), sparse.linalg.splu(sparse.csc_array(A)).solve, self.factors.real).solve(b)


def inverse(A: sparse.csr_array, order: NDArray[np.int_] | None = None) -> Inverse:
    """The inverse of a matrix of symmetric pattern, definite or not; `order` reuses that of factors of the same pattern.

    One step of refinement recovers the digits lost by diagonal pivots; if it fails, other pivots are used.  RuntimeError if the
    matrix is singular.
    """
    return Inverse(A, factorised(A, order, definite=True))
