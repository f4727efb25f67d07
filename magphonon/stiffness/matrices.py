"""Stiffness including the static forces: `D = D0 + D*` per bond, the Hessian and the Bloch matrix.

    D0 = phi'' n(x)n                  the conventional model, with fixed directions of the bonds
    D* = (phi'/r) (I - n(x)n)         the effect of the static repulsion (phi' < 0: it softens)

All functions take arrays: bonds, their stiffness, wavevectors.  A matrix acts on displacements ordered
particle by particle, `dim` components each (2 in the plane, 3 in space).
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse

from .sites import each_spring

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import ArrayLike, NDArray

    from ..lattices.bonds import Bonds
    from .sites import Foundation


def hessian(bonds: Bonds, K: NDArray[np.float64], foundation: Foundation = 0.0,
            q: ArrayLike = (0.0, 0.0, 0.0)) -> sparse.csr_array:
    """Hessian `C^T K C + k` of a structure, or the Bloch matrix `C(q)^+ K C(q) + k` of one wavevector, as a sparse matrix.

    Parameters
    ----------
    bonds : Bonds
    K : ndarray, shape (bonds, dim, dim)
        Stiffness of each bond in N/mm.
    foundation : float or ndarray, shape (particles, dim)
        Stiffness k of the spring that ties each particle to its anchor, in N/mm.
    q : three numbers
        Wavevector in fractions of the reciprocal vectors, for a periodic structure.

    Returns
    -------
    scipy.sparse.csr_array, shape (particles * dim, particles * dim)
        In N/mm.  It is real where all components of q are multiples of 1/2, and complex elsewhere.
    """
    b, dim, _ = K.shape
    incidence = bonds.incidence_at(q) if np.any(q) else bonds.incidence
    if not np.any(np.mod(2 * np.asarray(q), 1)):  # all phase factors are +1 or -1
        incidence = incidence.real
    C = sparse.kron(incidence, sparse.eye_array(dim), format='csr')
    D = sparse.bsr_array((K, np.arange(b), np.arange(b + 1)), shape=(b * dim, b * dim))
    k = sparse.diags_array(each_spring(foundation, bonds.particles, dim))
    return sparse.csr_array(C.conj().T @ D @ C + k)


def condense(H: sparse.csr_array, free: NDArray[np.bool_]) -> sparse.csr_array:
    """Hessian of the free particles, with the others held at rest.

    Parameters
    ----------
    H : sparse array, shape (particles * dim, particles * dim)
    free : ndarray of bool, shape (particles,)
    """
    keep = np.flatnonzero(np.repeat(free, H.shape[0] // len(free)))
    return H[keep][:, keep]


def bloch_matrix(bonds: Bonds, K: NDArray[np.float64], q: NDArray[np.float64],
                 foundation: Foundation = 0.0) -> NDArray[np.complex128]:
    """Bloch matrix `C(q)^+ K C(q) + k`, Eq. 18 of the paper for any number of particles per cell.

    Parameters
    ----------
    bonds : Bonds
    K : ndarray, shape (bonds, dim, dim)
        Stiffness of each bond in N/mm.
    q : ndarray, shape (wavevectors, 3)
        Wavevectors in fractions of the reciprocal lattice vectors.
    foundation : float
        Foundation stiffness k in N/mm.

    Returns
    -------
    ndarray of complex, shape (wavevectors, particles * dim, particles * dim)
        In N/mm.  The displacement of the cell `shift` carries the phase e^{2 pi i q.shift}.
    """
    own, x = _onsite(bonds, K), np.arange(K.shape[1])
    own[:, x, x] += foundation
    return _hermitian(bonds, _fourier_sum(_by_shift(bonds, K), _phase(bonds, q)), own[..., None])


def bloch_gradient(bonds: Bonds, K: NDArray[np.float64], q: ArrayLike, cell: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Derivative of the Bloch matrix by the Cartesian wavevector, `dD/dk`.

    Parameters
    ----------
    bonds, K, q
        As for `bloch_matrix`.
    cell : ndarray, shape (3, 3)
        Lattice vectors in rows, mm.

    Returns
    -------
    ndarray of complex, shape (dim, wavevectors, particles * dim, particles * dim)
        In N.
    """
    shifts, sums, phase = bonds.distinct_shifts[0], _by_shift(bonds, K), _phase(bonds, q)
    return np.array([_hermitian(bonds, _fourier_sum(sums * R, 1j * phase), 0.0) for R in (shifts @ cell).T[: K.shape[1]]])


def bloch_series(bonds: Bonds, K: NDArray[np.float64],
                 R: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
    """Bloch matrix to second order in the wavevector, `D(k) = A + k B + k^2 C`.

    Parameters
    ----------
    bonds, K
        As for `bloch_matrix`.
    R : ndarray, shape (bonds,)
        Component along k of the lattice vector to the cell of j, mm.

    Returns
    -------
    A, B, C : ndarray of complex, shape (particles * dim, particles * dim)
        In N/mm, N and N mm.
    """
    i, _, pair = bonds.distinct_pairs
    powers = np.stack([_sums(R[:, None, None] ** m * K, pair, len(i)) for m in range(3)], axis=-1)
    coupling, own = powers * [1, 1j, -1 / 2], _onsite(bonds, K)[..., None] * [1, 0, 0]  # e^{ikR} = 1 + ikR - (kR)^2/2
    A, B, C = _hermitian(bonds, coupling, own)
    return A, B, C


def _phase(bonds, q):
    """Phases e^{2 pi i q.shift} of the distinct shifts, shape (shifts, wavevectors)."""
    return np.exp(2j * np.pi * (bonds.distinct_shifts[0] @ np.transpose(q)))


def _sums(K, group, groups):
    """Sum of the stiffness of the bonds in each group, shape (groups, dim, dim)."""
    size = K[0].size
    component = group[:, None] * size + np.arange(size)
    return np.bincount(component.ravel(), K.ravel(), groups * size).reshape(groups, *K.shape[1:])


def _onsite(bonds, K):
    """Sum of the stiffness of the bonds of each particle, shape (particles, dim, dim)."""
    return _sums(np.concatenate([K, K]), np.concatenate([bonds.i, bonds.j]), bonds.particles)


def _by_shift(bonds, K):
    """Stiffness between two particles, summed over their bonds of the same shift, shape (pairs, dim, dim, shifts)."""
    (shifts, shift), (i, _, pair) = bonds.distinct_shifts, bonds.distinct_pairs
    sums = _sums(K, pair * len(shifts) + shift, len(i) * len(shifts))
    return sums.reshape(len(i), len(shifts), *K.shape[1:]).transpose(0, 2, 3, 1)


def _fourier_sum(sums, phase):
    """Sum over the shifts of `sums phase`, shape (pairs, dim, dim, wavevectors)."""
    parts = sums.reshape(-1, len(phase)) @ phase.view(float)  # with complex phases NumPy would copy the sums to complex numbers
    return parts.view(complex).reshape(*sums.shape[:3], -1)


def _hermitian(bonds, coupling, own):
    """Matrices of `-coupling` between i and j, of its adjoint between j and i, and of `own` on each particle.

    The stiffness of a bond is symmetric, and so the adjoint is the complex conjugate.

    Parameters
    ----------
    coupling : ndarray, shape (pairs, dim, dim, any)
    own : float or ndarray, shape (particles, dim, dim, any)

    Returns
    -------
    ndarray of complex, shape (any, particles * dim, particles * dim)
    """
    n, dim, each = bonds.particles, coupling.shape[1], np.arange(bonds.particles)
    i, j, _ = bonds.distinct_pairs
    D = np.zeros((coupling.shape[-1], n, dim, n, dim), dtype=complex)
    block = D.transpose(1, 3, 2, 4, 0)
    block[i, j] = -coupling
    block[j, i] -= coupling.conj()  # after the line above: bonds of a particle with its own images have i = j
    block[each, each] += own
    return D.reshape(-1, n * dim, n * dim)


def mass_weighted(D: NDArray[Any], masses: NDArray[np.float64]) -> NDArray[Any]:
    """`M^-1/2 D M^-1/2` with one mass (g) per particle; the last two axes of `D` are matrix axes."""
    root = np.repeat(1 / np.sqrt(masses), D.shape[-1] // len(masses))
    return D * (root[:, None] * root)


def signed_root(squares: NDArray[Any]) -> NDArray[np.float64]:
    """Frequencies from their squares; an unstable mode, with a negative square, appears as a negative frequency.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.stiffness import signed_root
    >>> signed_root(np.array([4.0, -9.0])).tolist()
    [2.0, -3.0]
    """
    return np.sign(squares) * np.sqrt(np.abs(squares))
