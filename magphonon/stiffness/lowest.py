"""The lowest eigenvalue of a stiffness matrix, or of squared frequencies, and its mode, which decide whether a rest is stable."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy.sparse.linalg import LinearOperator, SuperLU

DENSE = 200
"""Largest size of a matrix that is diagonalised completely."""
ROUGH = 1e-3
"""Relative accuracy of the first estimate of the lowest eigenvalue."""
ROUND_OFF = 1e-12
"""Fraction of the highest eigenvalue below which an eigenvalue is zero."""
SHIFT = 1e-4
"""Shift below the roughly known lowest eigenvalue at which a large matrix is first inverted, as a fraction of the largest
eigenvalue."""


def lowest_mode(D: sparse.csr_array) -> tuple[float, float, NDArray[np.float64]]:
    """The ends of the spectrum of a symmetric matrix, the lower one to round-off.

    Parameters
    ----------
    D : sparse array, shape (n, n)

    Returns
    -------
    lowest, highest : float
        Of a large matrix `highest` is an upper bound; both are zero where nothing is free.
    mode : ndarray, shape (n,)
        Eigenvector of the lowest one, of norm one.
    """
    size = D.shape[0]
    if not size:
        return 0.0, 0.0, np.zeros(0)
    if size <= DENSE:
        values, vectors = np.linalg.eigh(D.toarray())
        return float(values[0]), float(values[-1]), vectors[:, 0]
    highest = float(abs(D).sum(axis=1).max())  # Gershgorin
    if not highest:
        return 0.0, 0.0, np.eye(1, size)[0]
    start = np.random.default_rng(0).normal(size=size)  # the same answer every time
    # Lanczos iterations on D itself stop short, as near the lowest eigenvalue of a patch others crowd; what they find is
    # not below it and close above it
    near = sparse.linalg.eigsh(D, k=1, which='SA', v0=start, tol=ROUGH, return_eigenvectors=False)[0]
    shift, inverse = inverse_below(D, near, SHIFT * highest)
    values, vectors = sparse.linalg.eigsh(D, k=1, sigma=shift, OPinv=inverse, v0=start)
    return float(values[0]), highest, vectors[:, 0]


def inverse_below(D: sparse.csr_array, near: float, below: float) -> tuple[float, LinearOperator]:
    """A shift below all eigenvalues of a symmetric sparse matrix, and the inverse of D - shift.

    The shift is `near - below`, or farther down.  That it is below them the signs of the pivots prove.
    """
    while (factors := _positive_factors(D, below - near)) is None:
        below *= 4
    return near - below, sparse.linalg.LinearOperator(D.shape, factors.solve, dtype=D.dtype)


def none_negative(D: sparse.csr_array) -> bool:
    """Whether a symmetric sparse matrix has no negative eigenvalue, but for round-off: proven by one factorisation."""
    highest = float(abs(D).sum(axis=1).max(initial=0.0))
    return not highest or _positive_factors(D, ROUND_OFF * highest) is not None


def _positive_factors(D: sparse.csr_array, shift: float) -> SuperLU | None:
    """Factors of D + shift if all its eigenvalues are positive, as the pivots prove, whose signs are theirs; otherwise None."""
    shifted = (D + shift * sparse.eye_array(D.shape[0])).tocsc()
    try:
        factors = sparse.linalg.splu(shifted, 'MMD_AT_PLUS_A', diag_pivot_thresh=0.0, options={'SymmetricMode': True})
    except RuntimeError:  # a pivot is zero
        return None
    return factors if (factors.U.diagonal() > 0).all() and np.array_equal(factors.perm_r, factors.perm_c) else None
