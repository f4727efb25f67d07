"""Lower bound of the stiffness of a patch of a perfect lattice, from Bloch waves, at a cost proportional to its size.

Suppose that every particle that can move has all the bonds that it has in the infinite lattice.  Displacements of the patch,
continued by zero outside, are then displacements of the infinite lattice with the same energy.  By Rayleigh's principle no
eigenvalue of the patch lies below the lowest one of all Bloch matrices; holding or guiding particles cannot lower it either.

    H(q) = k + sum_b (2 - 2 cos q.R_b) K_b        summed over half of the bonds of a particle
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from .lowest import ROUND_OFF
from .matrices import hermitian_eigenvalues

if TYPE_CHECKING:
    from .rest import LinearSystem

SAME_VECTOR = 1e-6  # of a bond: farther apart, two vectors lead to different places
FIRST = {1: 256, 2: 48, 3: 16}  # wavevectors along each axis before the mesh is refined, by the dimension of the lattice
MOST = 5 * 10**5  # wavevectors beyond which the refinement is given up: lattices that are floppy along whole lines of wavevectors
ALONG = np.array([1.0, np.sqrt(2) / 3, np.sqrt(3) / 7])
"""Direction along which no two bonds of a lattice have the same component, so that this component distinguishes them."""
HALVINGS = 24  # of the mesh, until its error is round-off of the stiffness


def proves_stable(system: LinearSystem) -> bool:
    """Whether Bloch waves prove that no eigenvalue of the stiffness of a patch is negative, apart from round-off.

    False if they prove nothing: the structure is unstable, has free rims, or is not cut from a lattice of one particle per cell.
    """
    star = _star(system)
    return star is not None and no_wave_grows(*star)


def no_wave_grows(springs: NDArray[np.float64], c: NDArray[np.float64], K: NDArray[np.float64], error: float) -> bool:
    """Whether `springs + sum_b (2 - 2 cos theta.c_b) K_b` has no eigenvalue below zero at any theta, apart from round-off.

    Shapes: springs (dim, dim), whole numbers c (bonds, axes), K (bonds, dim, dim).  The eigenvalues of the structure for which
    this matrix stands may be lower by `error`.
    """
    size = 2 * np.linalg.norm(K, axis=(1, 2))  # each bond stands for itself and for the one backward
    allowed = -ROUND_OFF * float(np.linalg.norm(springs) + 2 * size.sum()) + error
    curvature = float(size @ (c**2).sum(axis=1))  # of u.H(theta).u along any direction of theta
    r = c.shape[1]
    width = 2 * np.pi / FIRST[r]
    theta = (width * np.indices([FIRST[r]] * r)).reshape(r, -1).T
    corners = np.indices([2] * r).reshape(r, -1).T - 0.5
    for _ in range(HALVINGS):
        H = springs + np.einsum('qb,bxy->qxy', 2 - 2 * np.cos(theta @ c.T), K)
        low = hermitian_eigenvalues(H)[:, 0]
        # at the lowest of all waves the slope of u.H.u is zero: the nearest one of the mesh lies above it by this at most
        above = curvature * r * (width / 2) ** 2 / 2
        if low.min() - above >= allowed:
            return True
        if low.min() < allowed:
            return False
        near = theta[low <= low.min() + above]  # where the lowest one can be
        width /= 2
        theta = (near[:, None] + width * corners).reshape(-1, r)
        if len(theta) > MOST:
            return False
    return False


def _star(system):
    """The bonds that all movable particles have in common, or None if they differ.

    Returns the softest springs, shape (dim, dim); half of the bonds as whole multiples of base vectors, shape (bonds, axes), and
    their stiffness; and by how much the scatter of this stiffness may lower an eigenvalue.
    """
    calc = system.calc
    bonds, stiffness = calc.bonds, calc.rest_stiffness(calc.model)
    mobile, ends = np.flatnonzero(system.mobile), np.append(bonds.i, bonds.j).astype(int)
    own = system.mobile[ends]
    ends, R, K = ends[own], np.concatenate([bonds.vectors, -bonds.vectors])[own], np.concatenate([stiffness, stiffness])[own]
    first = ends == mobile[0]
    star, K_of_star = R[first], K[first]
    if not len(star) or len(ends) != len(mobile) * len(star):
        return None
    order = np.argsort(star @ ALONG)
    star, K_of_star = star[order], K_of_star[order]
    which = np.searchsorted((star[1:] + star[:-1]) @ ALONG / 2, R @ ALONG)
    backward = np.linalg.norm(star + star[:, None], axis=2).argmin(axis=1)
    away = np.concatenate([R - star[which], star + star[backward]])
    each_once = np.bincount(ends * len(star) + which).max() == 1
    c, half = multiples(star), np.arange(len(star)) < backward
    if abs(away).max() > SAME_VECTOR * np.linalg.norm(star, axis=1).min() or not each_once or c is None:
        return None
    scatter = np.concatenate([K - K_of_star[which], K_of_star[backward] - K_of_star])
    springs = np.broadcast_to(calc.foundation, (len(system), calc.dim))[mobile].min(axis=0)
    return np.diag(springs), c[half], K_of_star[half], 2 * len(star) * np.linalg.norm(scatter, axis=(1, 2)).max()


def multiples(vectors: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """Vectors as whole multiples of the shortest independent ones, shape (vectors, axes); None if they are no multiples."""
    base, size = np.zeros((0, vectors.shape[1])), np.linalg.norm(vectors, axis=1)
    for v in vectors[np.argsort(size)]:
        longer = np.vstack([base, v])
        if np.linalg.matrix_rank(longer, tol=SAME_VECTOR * size.max()) > len(base):
            base = longer
    c = vectors @ np.linalg.pinv(base)
    return np.rint(c) if abs(c - np.rint(c)).max() <= SAME_VECTOR else None
