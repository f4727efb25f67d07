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
    D = _scatter(bonds, K, _phase(bonds, q), onsite=1.0)
    onsite = np.arange(D.shape[1])
    D[:, onsite, onsite] += each_spring(foundation, bonds.particles, K.shape[1])
    return D


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
    R = bonds.shift @ cell
    phase = _phase(bonds, q)
    return np.array([_scatter(bonds, K, 1j * R[:, axis] * phase, onsite=0.0) for axis in range(K.shape[1])])


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
    orders = (np.ones_like(R), 1.0), (1j * R, 0.0), (-(R**2) / 2, 0.0)
    return tuple(_scatter(bonds, K, phase[None], onsite)[0] for phase, onsite in orders)


def _phase(bonds, q):
    """Phase e^{2 pi i q.shift} of each bond, shape (wavevectors, bonds)."""
    shifts, own = bonds.distinct_shifts
    return np.exp(2j * np.pi * (q @ shifts.T))[:, own]


def _scatter(bonds, K, phase, onsite):
    """Sum over bonds of `-K phase` between i and j with its adjoint between j and i, and of `onsite K` on i and j."""
    n, dim = bonds.particles, K.shape[1]
    pair = bonds.i * n + bonds.j
    order = np.argsort(pair, kind='stable')  # bonds of the same two particles become neighbours in the list
    i, j, K = bonds.i[order], bonds.j[order], K[order]
    first = np.flatnonzero(np.diff(pair[order], prepend=-1))
    coupling = np.add.reduceat(phase.T[order, :, None, None] * K[:, None], first, axis=0)
    own = np.zeros((n, dim, dim))
    np.add.at(own, i, onsite * K)
    np.add.at(own, j, onsite * K)
    D = np.zeros((len(phase), n, dim, n, dim), dtype=complex)
    D[:, i[first], :, j[first]] -= coupling
    D[:, j[first], :, i[first]] -= coupling.conj()
    D[:, np.arange(n), :, np.arange(n)] += own[:, None]
    return D.reshape(len(phase), n * dim, n * dim)


def mass_weighted(D: NDArray[Any], masses: NDArray[np.float64]) -> NDArray[Any]:
    """`M^-1/2 D M^-1/2` with one mass (g) per particle; the last two axes of `D` are matrix axes."""
    root = np.repeat(np.sqrt(masses), D.shape[-1] // len(masses))
    return D / (root[:, None] * root)


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
