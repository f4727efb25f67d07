"""Roots of a Laurent polynomial with matrix coefficients: mu and v with sum_p A_p mu^p v = 0, p = -P ... P, A_-p = A_p^T.

Few components are coupled by what reaches farthest, so A_P is singular, and of the 2 P n roots some lie at infinity and as
many at zero, in chains.  Round-off eps would split a chain of k roots into a ring of the radius eps^(1/k): false waves, which
decay by 36/k per step.  So the chains are taken off the pencil of companion matrices, link by link, by rotations
that leave all other roots where they are; the roots that remain are then polished by Newton's method.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import linalg

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

LINK = 1e-11
"""Fraction of the largest coefficient below which a singular value belongs to a link of a chain.  In 150 random cells of up to
eight particles, at three frequencies each, those of links were at most 2e-12, all others at least 4e-11."""
POLISHES = 3
LONGEST_STEP = 0.1
"""Longest Newton step in log mu; a longer one leads to another root."""
SINGULAR_FRACTION = 1e-14
"""Fraction of the largest singular value below which a singular value of Newton's matrix is round-off, as where two roots
coincide."""


def laurent_roots(A: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Roots that are finite and not zero; they come in pairs mu and 1/mu, up to round-off.

    Parameters
    ----------
    A : ndarray, shape (2 P + 1, n, n)
        Real coefficients A_-P ... A_P; what is not coupled must be exactly zero.

    Returns
    -------
    mu : ndarray of complex, shape (roots,)
    v : ndarray of complex, shape (roots, n)
        Each of norm one.
    """
    powers, n = len(A) - 1, A.shape[1]
    A = A / abs(A).max()
    # A_P mu^2P v + ... + A_-P v = 0 with the blocks v, mu v, ..., mu^(2P-1) v
    L, R = np.eye(powers * n, k=n), np.eye(powers * n)
    L[-n:] = -np.hstack(list(A[:-1]))
    R[-n:, -n:] = A[-1]
    L, R, infinite = _without_chains(L, R)
    R, L, zero = _without_chains(R, L, [link.lost for link in infinite])
    (alpha, beta), z = linalg.eig(L, R, homogeneous_eigvals=True)  # pyright: ignore[reportAssignmentType]  two with a right
    for link in reversed(zero):
        z = link.restored(z, beta, alpha)
    for link in reversed(infinite):
        z = link.restored(z, alpha, beta)
    return alpha / beta, (z[:n] / np.linalg.norm(z[:n], axis=0)).T


class _Link:
    """One link of the chains of infinite roots of L x = mu R x: the null space of R, and what it is to the other roots."""

    def __init__(self, L, R, rank):
        axes = np.linalg.svd(R)[2]
        self.keep, self.null, self.lost = axes[:rank].T, axes[rank:].T, len(R) - rank
        factors: Any = linalg.qr(L @ self.null)
        Q, triangle = factors
        self.triangle = triangle[: self.lost]
        L, R = Q.T @ L @ self.keep, Q.T @ R @ self.keep
        self.L, self.R, self.pencil = L[: self.lost], R[: self.lost], (L[self.lost :], R[self.lost :])

    def restored(self, z, alpha, beta):
        """Vectors of the pencil with this link, in columns, from those `z` without it, at the roots alpha/beta."""
        inside = linalg.solve_triangular(self.triangle, self.R @ z * alpha - self.L @ z * beta)
        x = self.keep @ (z * beta) + self.null @ inside
        return x / np.linalg.norm(x, axis=0)


def _without_chains(L, R, lengths=None):
    """The pencil without its infinite roots, and their links; `lengths` says how many roots each link holds, if known."""
    links = []
    while len(R):
        rank = np.count_nonzero(np.linalg.svd(R, compute_uv=False) > LINK)
        if lengths is not None:
            rank = len(R) - (lengths[len(links)] if len(links) < len(lengths) else 0)
        if rank == len(R):
            break
        links.append(_Link(L, R, rank))
        L, R = links[-1].pencil
    return L, R, links


def polished(A: NDArray[np.float64], mu: NDArray[np.complex128],
             v: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Roots and vectors after Newton's steps on `A(mu) v = 0` and `v0^+ v = 1` in log mu, as long as they lessen what is left.

    Parameters
    ----------
    A : ndarray, shape (2 P + 1, n, n)
    mu : ndarray of complex, shape (roots,)
    v : ndarray of complex, shape (roots, n)

    Returns
    -------
    mu, v
    """
    powers = np.arange(len(A)) - len(A) // 2
    log, (matrix, slope, rest, left) = np.log(mu), _at(A, powers, np.log(mu), v)
    for _ in range(POLISHES if len(mu) else 0):
        n = v.shape[1]
        newton = np.zeros((len(mu), n + 1, n + 1), complex)
        newton[:, :n, :n], newton[:, :n, n], newton[:, n, :n] = matrix, np.einsum('rab,rb->ra', slope, v), v.conj()
        step = np.einsum('rab,rb->ra', np.linalg.pinv(newton, SINGULAR_FRACTION)[:, :, :n], -rest)
        tried = v + step[:, :n]
        tried /= np.linalg.norm(tried, axis=1)[:, None]
        new = _at(A, powers, log + step[:, n], tried)
        better = (new[3] < left) & (abs(step[:, n]) < LONGEST_STEP)
        log, v = np.where(better, log + step[:, n], log), np.where(better[:, None], tried, v)
        matrix, slope, rest, left = (np.where(better.reshape(-1, *(1,) * (now.ndim - 1)), now, old)
                                     for now, old in zip(new, (matrix, slope, rest, left), strict=True))
    return np.exp(log), v


def _at(A, powers, log, v):
    """A(mu), its derivative by log mu and A(mu) v, over the largest |mu^p|, and what is left of it over its terms."""
    terms = np.exp(powers * log[:, None])
    terms /= abs(terms).max(axis=1)[:, None]
    matrix, slope = np.einsum('rp,pab->rab', terms, A), np.einsum('rp,pab->rab', powers * terms, A)
    rest = np.einsum('rab,rb->ra', matrix, v)
    return matrix, slope, rest, abs(rest).max(axis=1) / np.einsum('rp,pab->rab', abs(terms), abs(A)).max(axis=(1, 2))
