"""Modes of a structure that is its own mirror image. Reflection keeps or changes the sign of each mode, so half of the matrix, or
with two mirrors a quarter, is diagonalised at a time, in a quarter or a sixteenth of the time.

Mirrors across x, y and z through the middle of the structure are tried.  Whether a mirror leaves the structure unchanged is
tested on the matrix itself, so masses, strengths, springs and constraints need no tests of their own.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.spatial import KDTree

if TYPE_CHECKING:
    from .rest import LinearSystem

SMALLEST = 500  # number of free directions from which halves save more than it takes to find them
UNCHANGED = 1e-13  # change of the matrix, as a fraction of its largest entry, that is round-off
NEAR = 1e-6  # distance of a particle from its image, as a fraction of the size of the structure, that is round-off


def symmetric_parts(system: LinearSystem) -> list[sparse.csr_array]:
    """Orthonormal bases of the motions that the mirrors of a structure keep or reverse, shape (free, some) each.

    Together they span all motions, and K does not couple one basis to another.
    """
    one: sparse.csr_array = sparse.eye_array(system.K.shape[0], format='csr')  # pyright: ignore[reportAssignmentType]
    mirrors = list(_mirrors(system)) if one.shape[0] >= SMALLEST else []
    parts = []
    for signs in product((1, -1), repeat=len(mirrors)):
        S = one  # projects a motion on those with these signs, apart from a factor
        for sign, P in zip(signs, mirrors, strict=True):
            S = S @ (one + sign * P)
        length = np.sqrt(np.asarray((S * S).sum(axis=0)))
        first = abs(S).argmax(axis=0) == np.arange(len(length))  # a direction and its images give one motion
        kept = np.flatnonzero(first & (length > 0))
        parts.append(sparse.csr_array(S[:, kept] / length[kept]))
    return parts


def _mirrors(system) -> Iterator[sparse.csr_array]:
    """Permutations with signs of the free directions that leave K as it is."""
    positions, K, n, dim = system.atoms.positions, system.K, len(system), system.dim
    tree, size = KDTree(positions), np.ptp(positions, axis=0).max()
    for axis in range(dim):
        image, sign = positions.copy(), np.ones(dim)
        image[:, axis] = positions[:, axis].min() + positions[:, axis].max() - positions[:, axis]
        away, to = tree.query(image)
        sign[axis] = -1
        if np.max(away) > NEAR * size or len(np.unique(to)) < n:
            continue
        moved = sparse.coo_array((np.ones(n), (to, np.arange(n))), shape=(n, n))
        P = sparse.csr_array(system.free.T @ sparse.kron(moved, sparse.diags_array(sign)) @ system.free)
        alone = P.nnz == P.shape[0] and (abs(P.data) == 1).all()  # not where constraints lead along a slope
        if alone and abs(P @ K @ P.T - K).max() <= UNCHANGED * abs(K).max():
            yield P


def eigenpairs_of(system: LinearSystem) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All eigenvalues of K, ascending, and its eigenvectors in columns."""
    parts = symmetric_parts(system)
    found = [np.linalg.eigh((B.T @ system.K @ B).toarray()) for B in parts]
    squares = np.concatenate([values for values, _ in found])
    order = squares.argsort(kind='stable')
    return squares[order], np.hstack([B @ vectors for B, (_, vectors) in zip(parts, found, strict=True)])[:, order]


def eigenvalues_of(system: LinearSystem) -> NDArray[np.float64]:
    """All eigenvalues of K, ascending."""
    found = [np.linalg.eigvalsh((B.T @ system.K @ B).toarray()) for B in symmetric_parts(system)]
    return np.sort(np.asarray(np.concatenate(found), float))
