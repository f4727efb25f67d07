"""Stiffness including the static forces: `D = D0 + D*` per bond, the Hessian and the Bloch matrix.

    D0 = phi'' n(x)n                  the conventional model, with fixed directions of the bonds
    D* = (phi'/r) (I - n(x)n)         the effect of the static repulsion (phi' < 0: it softens)

All functions take arrays: bonds, their stiffness, wavevectors.  A matrix acts on displacements ordered
particle by particle, `dim` components each (2 in the plane, 3 in space).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.linalg import eigh

from ..lattices.bonds import Bonds
from .sites import Foundation, each_spring

ALONG = 1e-12
"""In the block of two particles in a Hessian, entries below this fraction of the largest are round-off and are set to zero.  They
come from bonds along an axis and from sums that cancel; positions of 1e4 spacings are rounded by as much.  Otherwise the pattern
of nonzero entries would depend on the processor."""
GROWS = 1e-7  # rate of growth, as a fraction of the largest pole, below which it is round-off of a double pole


def hessian(bonds: Bonds, K: NDArray[np.float64], foundation: Foundation = 0.0,
            q: ArrayLike = (0.0, 0.0, 0.0)) -> sparse.csr_array:
    """Hessian `C^T K C + k` of a structure, or the Bloch matrix `C(q)^+ K C(q) + k` of one wavevector, as a sparse matrix.

    K, in N/mm, has the shape (bonds, dim, dim).  The springs k that tie the particles to their anchors, in N/mm, are a number
    or have the shape (particles, dim).  q is in fractions of the reciprocal vectors.  The matrix is
    real if all components of q are multiples of 1/2, otherwise complex.
    """
    dim, n, i, j = K.shape[1], bonds.particles, bonds.i, bonds.j
    phase: Any = np.exp(2j * np.pi * (bonds.shift @ np.asarray(q, float)))[:, None, None] if np.any(q) else 1.0
    if not np.any(np.mod(2 * np.asarray(q), 1)):  # all phase factors are +1 or -1
        phase = np.real(phase)
    to_itself = (i == j)[:, None, None]  # |1 - phase|^2 K: exactly nothing where all particles move alike
    springs = each_spring(foundation, n, dim).reshape(n, dim, 1) * np.eye(dim)
    own = own_stiffness(bonds, np.where(to_itself, abs(1 - phase) ** 2 / 2, 1) * K) + springs
    K = np.where(to_itself, 0.0, K)
    blocks, each = np.concatenate([own, -K * phase, -K * np.conj(phase)]), np.arange(n, dtype=i.dtype)
    ends = np.concatenate([each, i, j]), np.concatenate([each, j, i])
    components = [sparse.coo_array((x, ends), shape=(n, n)).tocsr() for x in blocks.reshape(-1, dim**2).T]
    data = np.stack([x.data for x in components])
    size = abs(data)
    data[size < ALONG * size.max(axis=0)] = 0
    H = sparse.bsr_array((data.T.reshape(-1, dim, dim), components[0].indices, components[0].indptr),
                         shape=(n * dim, n * dim)).tocsr()
    H.eliminate_zeros()
    return H


def bloch_matrix(bonds: Bonds, K: NDArray[np.float64], q: NDArray[np.float64],
                 foundation: Foundation = 0.0) -> NDArray[np.complex128]:
    """Bloch matrix `C(q)^+ K C(q) + k`, Eq. 18 of the paper for any number of particles per cell.

        D_ii = sum_b K_b + k        D_ij = -sum_b K_b e^{2 pi i q.R_b}

    over the bonds b of particle i, and those from i to j in the cell R_b.

    Parameters
    ----------
    bonds : Bonds
    K : ndarray, shape (bonds, dim, dim)
        Stiffness of each bond in N/mm.
    q : ndarray, shape (wavevectors, 3)
        Wavevectors in fractions of the reciprocal lattice vectors.
    foundation : float or ndarray, shape (particles, dim)
        Foundation stiffness k in N/mm.

    Returns
    -------
    ndarray of complex, shape (wavevectors, particles * dim, particles * dim)
        In N/mm.
    """
    shifts, shift = bonds.distinct_shifts
    phase = np.exp(2j * np.pi * (shifts @ np.transpose(q)))
    own, x = own_stiffness(bonds, K), np.arange(K.shape[1])
    own[:, x, x] += foundation
    return _bloch_sum(bonds, K, own[..., None], phase, shift)


def bloch_gradient(bonds: Bonds, K: NDArray[np.float64], q: ArrayLike, cell: NDArray[np.float64]) -> NDArray[np.complex128]:
    """Derivative of the `bloch_matrix` by the Cartesian wavevector, `dD/dk` in N.

    Shape (dim, wavevectors, particles * dim, particles * dim).
    """
    shifts, shift = bonds.distinct_shifts
    phase, R = np.exp(2j * np.pi * (shifts @ np.transpose(q))), shifts @ cell
    return np.array([_bloch_sum(bonds, K, 0.0, 1j * R[:, [x]] * phase, shift) for x in range(K.shape[1])])


def bloch_series(bonds: Bonds, K: NDArray[np.float64],
                 R: NDArray[np.float64]) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
    """Bloch matrix to second order in the wavevector, `D(k) = A + k B + k^2 C`: A, B, C in N/mm, N and N mm.

    R, shape (bonds,), is the component in mm, along k, of the lattice vector that leads to the cell of particle j.
    """
    powers = np.stack([np.ones_like(R), 1j * R, -(R**2) / 2], axis=1)  # e^{ikR} = 1 + ikR - (kR)^2/2
    A, B, C = _bloch_sum(bonds, K, own_stiffness(bonds, K)[..., None] * [1, 0, 0], powers, np.arange(len(R)))
    return A, B, C


def own_stiffness(bonds: Bonds, K: NDArray[np.float64]) -> NDArray[np.float64]:
    """Sum of the stiffness of the bonds of each particle, shape (particles, dim, dim)."""
    ends, each = np.concatenate([bonds.i, bonds.j]), K.reshape(len(K), -1).T
    sums = [np.bincount(ends, np.append(x, x), bonds.particles) for x in each]
    return np.asarray(np.stack(sums, axis=-1).reshape(-1, *K.shape[1:]), float)


def _bloch_sum(bonds, K, own, factors, which):
    """`H + H^+`, where H is half of `own` on each particle, and -K_b times the factor of bond b, summed from i to j.

    `own` is a number or has the shape (particles, dim, dim, 1 or matrices), `factors` (factors, matrices).
    """
    n, dim, each = bonds.particles, K.shape[1], np.arange(bonds.particles)
    i, j, pair = bonds.distinct_pairs
    # bonds that join the same two and share a factor are added first
    entry = (pair[:, None] * dim**2 + np.arange(dim**2)) * len(factors) + which[:, None]
    sums = np.bincount(entry.ravel(), -K.ravel(), len(i) * dim**2 * len(factors)).reshape(-1, len(factors))
    H = np.zeros((n, dim, n, dim, factors.shape[1]), dtype=complex)
    H[i, :, j] = (sums @ factors.view(float)).view(complex).reshape(len(i), dim, dim, -1)  # a product of real numbers
    H[each, :, each] += own / 2
    H = H.reshape(n * dim, n * dim, -1)
    H += H.conj().swapaxes(0, 1)
    return H.transpose(2, 0, 1)


def mass_weighted(D: NDArray[Any], masses: NDArray[np.float64]) -> NDArray[Any]:
    """`M^-1/2 D M^-1/2` with one mass (g) per particle; the last two axes of `D` are matrix axes."""
    root = np.repeat(1 / np.sqrt(masses), D.shape[-1] // len(masses))
    return D * (root[:, None] * root)


def hermitian_eigenvalues(D: NDArray[Any]) -> NDArray[np.float64]:
    """Eigenvalues of a stack of Hermitian matrices, ascending.

    Matrices of 2 x 2 are solved in closed form, all at once, in a quarter of LAPACK's time.  The formula is that of LAPACK's own
    DLAE2: the eigenvalue of smaller modulus is the determinant divided by the other one. So a soft mode beside a stiff one keeps
    its digits, which would be lost as the mean minus half of the distance.
    """
    if D.shape[-1] != 2:
        return np.linalg.eigvalsh(D)
    return eigenvalues_of_two(np.real(D[..., 0, 0]), abs(D[..., 1, 0]), np.real(D[..., 1, 1]))


def eigenvalues_of_two(a: NDArray[Any], b: NDArray[Any], c: NDArray[Any]) -> NDArray[np.float64]:
    """Eigenvalues of the real matrices [[a, b], [b, c]], ascending, shape (..., 2)."""
    far = (a + c + np.copysign(np.hypot(a - c, 2 * b), a + c)) / 2
    divisor = np.where(far == 0, 1.0, far)  # only D = 0 has no eigenvalue other than zero
    near = a / divisor * c - b / divisor * b
    found = np.empty((*np.shape(near), 2))
    np.minimum(near, far, out=found[..., 0])
    np.maximum(near, far, out=found[..., 1])
    return found


def poles(B: NDArray[Any], K: NDArray[Any]) -> NDArray[np.complex128]:
    """All roots s of det(s^2 + s B + K) = 0, the rates of motion e^{st} of `y'' + B y' + K y = 0`; shape (..., 2 n), unordered.

    They are the eigenvalues of the companion matrix, whose size is twice that of K; B and K are dense, broadcast, and in
    coordinates that absorb the masses.
    """
    return np.linalg.eigvals(companion(B, K)).astype(complex)


def growth(B: NDArray[Any], K: NDArray[Any]) -> NDArray[np.float64]:
    """Rate in 1/ms at which the fastest of the `poles` grows, shape (...); zero where none does, apart from round-off."""
    s = poles(B, K)
    rate = s.real.max(axis=-1)
    return np.where(rate > GROWS * abs(s).max(axis=-1), rate, 0.0)


def companion(B: NDArray[Any], K: NDArray[Any]) -> NDArray[Any]:
    """The matrix of (y, y') whose eigenvalues are the `poles`; the upper halves of its eigenvectors are the shapes y."""
    n = K.shape[-1]
    A = np.zeros((*np.broadcast_shapes(B.shape[:-2], K.shape[:-2]), 2 * n, 2 * n), np.result_type(B, K))
    A[..., :n, n:], A[..., n:, :n], A[..., n:, n:] = np.eye(n), -K, -B
    return A


def first_order(B: NDArray[Any], K: NDArray[Any]) -> NDArray[np.complex128]:
    """The Hermitian H for which (L^+ y, y') ~ e^{-iHt} solves `y'' + B y' + K y = 0`, with K = L L^+ and antisymmetric real B.

    LinAlgError if K is not positive.
    """
    L, n = np.linalg.cholesky(K), K.shape[-1]
    H = np.zeros((*K.shape[:-2], 2 * n, 2 * n), complex)
    H[..., :n, n:], H[..., n:, :n], H[..., n:, n:] = 1j * L.conj().swapaxes(-1, -2), -1j * L, -1j * B
    return H


def lossless_modes(B: NDArray[Any], K: NDArray[Any]) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
    """Frequencies and modes e^{-iwt} of `y'' + B y' + K y = 0` without losses: K Hermitian, B real and antisymmetric.

    The modes are the lower halves, the velocities, of the eigenvectors of `first_order`.  If K is not positive, so that only
    B can hold the particles, they are computed from the `poles`, and a mode that grows has minus its rate as frequency.
    Of each pair of opposite frequencies one is returned, ascending; modes, in columns of norm one, are not orthogonal.
    """
    n = K.shape[-1]
    try:
        H = first_order(B, K)
        omega, z = np.linalg.eigh(H) if K.ndim > 2 else eigh(H, subset_by_index=(n, 2 * n - 1))  # of one alone half is cheaper
    except np.linalg.LinAlgError:
        if K.ndim > 2:
            found = [lossless_modes(B, one) for one in K.reshape(-1, n, n)]
            omega, modes = (np.array(part) for part in zip(*found, strict=True))
            return omega.reshape(K.shape[:-1]), modes.reshape(K.shape)
        s, z = np.linalg.eig(companion(B, K))
        rate, turn, round_off = np.real(s), np.imag(s), GROWS * abs(s).max()
        first = np.lexsort((-rate, np.rint(turn / round_off)))[:n]  # e^{-iwt}, w > 0; what grows before its mirror, which decays
        omega, modes = np.where(rate > round_off, -rate, abs(turn))[first], z[:n, first]
        order = np.argsort(omega)
        return omega[order], modes[:, order] / np.linalg.norm(modes[:, order], axis=0)
    modes = z[..., n:, -n:]
    return omega[..., -n:], modes / np.linalg.norm(modes, axis=-2, keepdims=True)


def signed_root(squares: NDArray[Any]) -> NDArray[np.float64]:
    """Frequencies from their squares; an unstable mode, with a negative square, appears as a negative frequency."""
    return np.sign(squares) * np.sqrt(np.abs(squares))
