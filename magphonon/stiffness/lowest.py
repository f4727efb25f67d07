"""Eigenvalues of a stiffness matrix, or squared frequencies: the lowest ones, which decide on stability, and those in a gap."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy import sparse
from scipy.linalg import eigh

from ..errors import refuse_memory
from .factors import Factors, factorised
from .matrices import hermitian_eigenvalues

if TYPE_CHECKING:
    from .rest import LinearSystem

DENSE = 200  # largest size of a matrix that is diagonalised completely
INVERSE = 800
"""Size of a real matrix above which an inverse finds the lowest eigenvalues sooner than LAPACK; half of it for a complex matrix,
for which LAPACK takes four times as long.  For 8 eigenvalues both methods took the same time at the following sizes.  Complex
matrices: 240 (nearest neighbours in the plane), 400 (three shells), 460 (fcc), 750 (five shells); real matrices: 600 (nearest
neighbours in the plane), 1500 (fcc)."""
FEW = 20
"""Smallest ratio of the matrix size to the number of wanted eigenvalues for which the inverse is faster.  Both methods took the
same time at the ratio 14 for size 600 and at 20 for size 860."""
LARGEST = 5000
"""Largest size of a matrix that is diagonalised where iterations fail; it takes half a minute.  Above it, iterations are faster
for a quarter of the eigenvalues."""
MATRICES = 4  # of this size that are in memory while one is diagonalised
RESTARTS = 50
"""Number of restarts after which Lanczos iterations are given up, as for hundreds of degenerate eigenvalues in flat bands;
usually fewer than ten suffice."""
FEW_RESTARTS = 10  # the same for a single eigenvalue; three suffice unless eigenvalues are crowded, and a closer shift helps
ROUGH = 1e-3  # accuracy of the first estimate of the lowest eigenvalue, as a fraction of its distance from the first shift
EDGE = 1e-6  # fraction of a range of eigenvalues at each end that is excluded from it
ROUND_OFF = 1e-12  # fraction of the highest eigenvalue below which an eigenvalue is zero
CERTAIN = 1e-10
"""Accuracy, as a fraction of the highest eigenvalue, to which the lowest few are proven to be the lowest.  Of 1200 counts at
random shifts, as near as 1e-12 to an eigenvalue, none was wrong by round-off."""
BELOW = 0.2  # distance of a shift from the lowest eigenvalue of a neighbouring matrix, in ranges of its lowest few
SHIFT = 1e-4
"""Smallest distance of a shift from such an estimate, or from the lowest of Gershgorin's discs, as a fraction of the largest
eigenvalue."""
SAME_VECTOR = 1e-6  # of a bond: farther apart, two vectors lead to different places
FIRST = {1: 256, 2: 48, 3: 16}  # wavevectors along each axis before the mesh is refined, by the dimension of the lattice
MOST = 5 * 10**5  # wavevectors beyond which the refinement is given up: lattices that are floppy along whole lines of wavevectors
ALONG = np.array([1.0, np.sqrt(2) / 3, np.sqrt(3) / 7])
"""Direction along which no two bonds of a lattice have the same component, so that this component distinguishes them."""
HALVINGS = 24  # of the mesh, until its error is round-off of the stiffness


def lowest_mode(D: sparse.csr_array) -> tuple[float, float, NDArray[np.float64]]:
    """Lowest and highest eigenvalue of a symmetric matrix, and the eigenvector of the lowest, of norm one.

    The lowest is exact to round-off. For a large matrix an upper bound replaces the highest. Both are zero for size zero.
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
    shift, factors = _factors_close_below(D, highest)
    tolerance = 0.0
    while True:
        try:
            values, vectors = sparse.linalg.eigsh(D, k=1, sigma=shift, OPinv=factors.operator, v0=_start(size),
                                                  maxiter=FEW_RESTARTS, tol=tolerance)
            return float(values[0]), highest, vectors[:, 0]
        except sparse.linalg.ArpackNoConvergence:
            # Eigenvalues are crowded here, as in a flat band.  A closer shift separates them, and its distance is accurate
            # enough.
            shift, factors, distance = _closer(D, shift, factors, highest)
            tolerance = ROUGH if distance <= ROUND_OFF * highest else 0.0


def lowest_eigenpairs(D: sparse.csr_array, count: int,
                      near: NDArray[np.float64] | None = None) -> tuple[NDArray[np.float64], NDArray[Any]]:
    """The lowest eigenvalues of a symmetric or Hermitian sparse matrix, and their eigenvectors.

    Lanczos iterations on an inverse find them, but may miss copies of a degenerate eigenvalue.  Sylvester's law of inertia
    detects this: the number of eigenvalues below a value equals the number of negative pivots of D minus this value.  If some
    are missed, or if it is faster, the matrix is diagonalised by LAPACK.

    Parameters
    ----------
    D : sparse array, shape (n, n)
    count : int
        From 1 to n.
    near : ndarray, optional
        The same eigenvalues of a similar matrix, such as that of a neighbouring wavevector, as a first estimate.

    Returns
    -------
    values : ndarray, shape (count,)
        Ascending.
    vectors : ndarray, shape (n, count)

    Raises
    ------
    ValueError
        If iterations fail for a matrix of more than LARGEST rows.
    """
    highest = float(abs(D).sum(axis=1).max())  # Gershgorin
    size = D.shape[0]
    if highest and inverse_pays(size, count, not np.iscomplexobj(D)):
        if near is None:
            shift, factors = _factors_close_below(D, highest)
        else:
            shift, factors = factors_below(D, near[0], max(BELOW * (near[-1] - near[0]), SHIFT * highest))
        found = _by_lanczos(D, count, shift, factors)
        if found is not None and _none_missed(D, *found, CERTAIN * highest, factors.order):
            return found
        if size > LARGEST:
            raise ValueError(f'iterations do not separate the lowest {count} of {size} modes, as in a flat band, and {size} '
                             f'are too many for a complete diagonalisation (at most {LARGEST}); ask for another number of modes, '
                             'or use a smaller structure')
    refuse_memory(f'the lowest {count} of {size} modes', MATRICES * 8 * size**2, 'ask for fewer')
    return eigh(D.toarray(), subset_by_index=(0, count - 1))


def inverse_pays(size: int, count: int, real: bool) -> bool:
    """Whether an inverse finds the lowest eigenvalues of a sparse matrix sooner than LAPACK."""
    return size > (INVERSE if real else INVERSE // 2) and count <= size // (FEW if size <= LARGEST else FEW // 5)


def _factors_close_below(D, highest):
    """`factors_below` with a shift close below the lowest eigenvalue."""
    # Lanczos iterations on D itself fail if stiffnesses differ by 1e4, because eigenvalues are crowded near the lowest one.
    # Those on an inverse converge.  The first shift is below all discs of Gershgorin, so that no sign of a pivot needs to be
    # seen, the second close below the first estimate, which is not below the eigenvalue.
    far = float((2 * D.diagonal().real - abs(D).sum(axis=1)).min()) - SHIFT * highest
    return _closer(D, far, factorised(_shifted(D, -far), definite=True), highest)[:2]


def _closer(D, far, factors, highest):
    """A shift below the lowest eigenvalue, a thousand times closer than `far`, with the factors there and its distance."""
    near = sparse.linalg.eigsh(D, k=1, sigma=far, OPinv=factors.operator, v0=_start(D.shape[0]), tol=ROUGH,
                               return_eigenvectors=False)[0]
    distance, order = max(ROUGH * (near - far), ROUND_OFF * highest), factors.order
    del factors  # the next ones take their memory
    return *factors_below(D, near, distance, order), distance


def _start(size):
    """A start vector for Lanczos iterations, always the same."""
    return np.random.default_rng(0).normal(size=size)


def _by_lanczos(D, count, shift, factors):
    """Lowest eigenvalues, by a shift below all of them, ascending, with their eigenvectors; None without convergence."""
    try:
        _, vectors = sparse.linalg.eigsh(D, k=count, sigma=shift, OPinv=factors.operator, v0=_start(D.shape[0]), maxiter=RESTARTS)
    except sparse.linalg.ArpackNoConvergence:
        return None
    # SciPy's iterations for complex matrices do not use that D is Hermitian: eigenvectors of equal eigenvalues are not
    # orthogonal.
    basis = np.linalg.qr(vectors)[0]
    values, turn = np.linalg.eigh(basis.conj().T @ (D @ basis))
    return values, basis @ turn


def _none_missed(D, values, vectors, error, order):
    """Whether these are eigenvalues, and include all that lie below the last one by more than `error`."""
    residuals = np.linalg.norm(D @ vectors - vectors * values, axis=0)
    below = values[-1] - error
    return residuals.max() <= error and count_below(D, below, order) == (values < below).sum()


def factors_below(D: sparse.csr_array, near: float, below: float,
                  order: NDArray[np.int_] | None = None) -> tuple[float, Factors]:
    """A shift below all eigenvalues of a symmetric sparse matrix, and the factors of D - shift.

    The shift is `near - below`, or lower; the signs of the pivots prove that it is below all eigenvalues.
    """
    while (factors := _positive_factors(D, below - near, order)) is None:
        below *= 4
    return near - below, factors


def none_negative(D: sparse.csr_array) -> bool:
    """Whether a symmetric sparse matrix has no negative eigenvalue, apart from round-off; one factorisation proves it."""
    highest = float(abs(D).sum(axis=1).max(initial=0.0))
    return not highest or _positive_factors(D, ROUND_OFF * highest) is not None


def eigenpairs_between(D: sparse.csr_array, low: float, high: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """All eigenvalues of a symmetric sparse matrix between two numbers, and their eigenvectors.

    Two factorisations count them by the signs of pivots; Lanczos iterations with an inverse at the middle then find them.
    Eigenvalues at an end, within EDGE of the range, are excluded: they belong to waves at the gap edge.
    """
    size, span = D.shape[0], high - low
    # so that no eigenvalue is at the middle
    low, high, middle = low + EDGE * span, high - EDGE * span, low + (0.5 + EDGE / 10) * span
    if size > DENSE:
        count = count_below(D, high) - count_below(D, low)
        if not count:
            return np.zeros(0), np.zeros((size, 0))
        if count < size // 2:
            inverse = factorised(_shifted(D, -middle)).operator
            values, vectors = sparse.linalg.eigsh(D, k=count, sigma=middle, OPinv=inverse, v0=_start(size))
            order = np.argsort(values)
            if not ((low <= values) & (values <= high)).all():
                raise ArithmeticError(f'{count} eigenvalues were counted between {low:g} and {high:g}, but the eigenvalues found '
                                      'do not match; move the ends of the range')
            return values[order], vectors[:, order]
    values, vectors = np.linalg.eigh(D.toarray())
    within = (low <= values) & (values <= high)
    return values[within], vectors[:, within]


def count_below(D: sparse.csr_array, value: float, order: NDArray[np.int_] | None = None) -> int:
    """Number of eigenvalues of a symmetric or Hermitian sparse matrix below a number.

    It equals the number of negative pivots of D - value (Sylvester).  An eigenvalue equal to it within round-off counts as above.
    `order` reuses that of factors of the same pattern.
    """
    highest = float(abs(D).sum(axis=1).max(initial=0.0))
    while True:
        try:
            count = factorised(_shifted(D, -value), order).negative()
            if count is not None:
                return count
        except RuntimeError:  # a pivot is zero
            pass
        value -= ROUND_OFF * max(highest, 1.0)


def _shifted(D, shift):
    return D + shift * sparse.eye_array(D.shape[0], format='csr')


def _positive_factors(D, shift, order=None):
    """Factors of D + shift if all its eigenvalues are positive, which the signs of the pivots prove; otherwise None."""
    try:
        factors = factorised(_shifted(D, shift), order, definite=True)
    except RuntimeError:  # a pivot is zero
        return None
    return factors if factors.negative() == 0 else None


def proves_stable(system: LinearSystem) -> bool:
    """Whether Bloch waves prove that no eigenvalue of the stiffness of a patch is negative, apart from round-off.

    Suppose that every particle that can move has all the bonds that it has in the infinite lattice.  Displacements of the patch,
    continued by zero outside, are then displacements of the infinite lattice with the same energy.  By Rayleigh's principle no
    eigenvalue of the patch lies below the lowest one of all Bloch matrices; holding or guiding particles cannot lower it either.

        H(q) = k + sum_b (2 - 2 cos q.R_b) K_b        summed over half of the bonds of a particle

    The cost is proportional to the size of the patch.  False if waves prove nothing: the structure is unstable, has free rims, or
    is not cut from a lattice of one particle per cell.
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
