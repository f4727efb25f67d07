"""Stiffness including the static forces: the interaction of two particles, Eq. 3, and the matrices assembled from it.

    D0 = phi'' n(x)n                  the conventional model, with fixed directions of the bonds
    D* = (phi'/r) (I - n(x)n)         the effect of the static repulsion (phi' < 0: it softens)

An interaction is a function of the vector R between two particles: energy, gradient, stiffness D0 + D*.  `Central` is the force
along the bond, from a law of the distance: its method `stiffness` is Eq. 3.  If forces depend on more than the distance, as
between upright magnets that leave their plane, the law itself is a function of the vector (`PairInteraction`).  `Mixed` holds
the interactions of bonds that differ. Calling code uses one of these three, and need not know which.

The matrices, the Hessian and the Bloch matrix, are made from arrays: bonds, their stiffness, wavevectors.  A matrix acts on
displacements ordered particle by particle, `dim` components each (2 in the plane, 3 in space).
"""

from __future__ import annotations

from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.linalg import eigh

from ..errors import Diverged, one_of
from ..interactions.bond_laws import Law, Laws, laid, laws_along
from ..lattices.bonds import Bonds
from .sites import Foundation, each_spring

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairInteraction, PairLaw

Model = Literal['complete', 'conventional']
MODELS: tuple[Model, ...] = ('complete', 'conventional')
CONTACT, BROKEN_BOND = 1 / 3, 3.0
"""Ratios of a bond to its rest length outside which its law is not trusted. Below the first its particles have collided: the
repulsion of magnets is a hundred times that at rest. Above the second it is broken: two other particles fit between its ends, and
the repulsion of magnets has fallen below a hundredth."""
STEP = 1e-20  # relative size of a complex step: no difference is taken, so it may be as small as numbers allow
ALONG = 1e-12
"""In the block of two particles in a Hessian, entries below this fraction of the largest are round-off and are set to zero.  They
come from bonds along an axis and from sums that cancel; positions of 1e4 spacings are rounded by as much.  Otherwise the pattern
of nonzero entries would depend on the processor."""
GROWS = 1e-7  # rate of growth, as a fraction of the largest pole, below which it is round-off of a double pole


@dataclass(frozen=True, eq=False)
class Central:
    """The interaction of two particles with a force along the line between them, by phi, phi' and phi''."""

    law: PairLaw

    def forces(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Energy `phi` and its gradient `phi' n`."""
        r = _lengths(R)
        return self.law.phi(r), (self.law.dphi(r) / r * R.T).T

    def stiffness(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Eq. 3 of the paper: `D0 = phi'' n(x)n` and `D* = phi'/r (1 - n(x)n)`.

        The paper prints both with minus signs, because there phi_r is the repulsion f, which here is -phi'.
        """
        r = _lengths(R)
        n = np.ascontiguousarray(R.T) / r  # the bonds last in memory: loops over two or three components take five times as long
        nn = n[:, None] * n
        D0 = self.law.d2phi(r) * nn
        Dstar = self.law.dphi(r) / r * (np.eye(len(n))[..., None] - nn)
        return D0.T, Dstar.T

    def central(self, dim: int) -> PairLaw:
        """The pair law, a function of the distance."""
        return self.law


@dataclass(frozen=True, eq=False)
class Mixed:
    """Interactions that differ from bond to bond: `strength` times one of the `parts`, of the distance over `scale`.

    Attributes
    ----------
    parts : tuple of PairInteraction
    which : ndarray of int, shape (bonds,)
        Index of the part of each bond.
    strength : ndarray, shape (bonds,)
    scale : ndarray, shape (bonds,), or None for the distance itself
    """

    parts: tuple[PairInteraction, ...]
    which: NDArray[np.intp]
    strength: NDArray[np.float64]
    scale: NDArray[np.float64] | None

    def forces(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """Energy and gradient of each bond."""
        return self._each('forces', R)

    def stiffness(self, R: NDArray[Any]) -> tuple[NDArray[Any], NDArray[Any]]:
        """D0 and D* of each bond."""
        return self._each('stiffness', R)

    def central(self, dim: int) -> PairLaw | None:
        """The law of each bond's length (`BondLaws`), if all parts have one."""
        laws = tuple(part.central(dim) for part in self.parts)
        return None if None in laws else laid(laws, self.which, self.strength, self.scale)  # pyright: ignore[reportArgumentType]

    def _each(self, method, R):
        found = []
        for k, part in enumerate(self.parts):
            own = np.flatnonzero(self.which == k)
            answers = getattr(part, method)(R[own])
            found = found or [np.empty((len(R), *answer.shape[1:]), answer.dtype) for answer in answers]
            for every, answer in zip(found, answers, strict=True):
                every[own] = (self.strength[own] * answer.T).T
        return found[0], found[1]


def interaction_of(law: Law, dim: int) -> PairInteraction:
    """The interaction for vectors of `dim` components: `Central` if the force is along the bond, else the law itself."""
    given: Any = law
    found = given.central(dim) if hasattr(given, 'central') else given
    return given if found is None else Central(found)


def _of_radii(each, which, strength, Ri, Rj):
    """The sum of both radii of each bond; strengths become those of laws that know both radii."""
    for k, law in enumerate(each):
        if between := getattr(law, 'between', None):
            strength[which == k] *= between(Ri[which == k], Rj[which == k])
    return Ri + Rj


def interaction_along(laws: Laws, bonds: Bonds, kinds: NDArray[np.intp], strengths: NDArray[np.float64], dim: int,
                      radii: NDArray[np.float64] | None = None) -> PairInteraction:
    """The interaction of all bonds; see `laws_along`."""
    each, which, strength = laws_along(laws, bonds.i, bonds.j, kinds, strengths)
    if radii is None and (rigid := [law for law in each if getattr(law, 'elastic', False)]):
        raise ValueError(f'{rigid[0]!r} is a law of both radii: it needs radii= or a diameter, Overlap.spheres(..., diameter=d)')
    scale = None if radii is None else _of_radii(each, which, strength, radii[bonds.i], radii[bonds.j])
    acting = interaction_of(Mixed(tuple(interaction_of(law, dim) for law in each), which, strength, scale), dim)
    if scale is not None and acting.central(dim) is None:
        raise ValueError('a law of the distance over the sum of both radii acts along the line between two particles; leave out '
                         f'the radii, or take another law than {laws!r}')
    return acting


def bond_stiffness(vectors: NDArray[np.float64], law: Law) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Stiffness of each bond, split as in Eq. 3 of the paper, where the sign of phi is the opposite.

    Parameters
    ----------
    vectors : ndarray, shape (bonds, dim)
        Bond vectors in mm.
    law : PairLaw or PairInteraction
        One law for all bonds, or the interactions of the bonds of a calculator, `calc.interaction`.

    Returns
    -------
    D0, Dstar : ndarray, shape (bonds, dim, dim)
        In N/mm.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.stiffness import bond_stiffness
    >>> D0, Dstar = bond_stiffness(np.array([[1.0, 0.0]]), InversePower(1.0, 4.0))
    >>> D0[0].tolist()  # phi'' along the bond
    [[4.0, 0.0], [0.0, 0.0]]
    >>> (Dstar[0] + 0).tolist()  # phi'/r across it
    [[0.0, 0.0], [0.0, -1.0]]
    """
    return interaction_of(law, vectors.shape[1]).stiffness(vectors)


def model_stiffness(vectors: NDArray[Any], law: Law, model: Model = 'complete') -> NDArray[Any]:
    """Stiffness of each bond in the given model: `D0 + D*`, or `D0` alone; see `bond_stiffness`."""
    D0, Dstar = bond_stiffness(vectors, law)
    return D0 if one_of('model', model, MODELS) == 'conventional' else D0 + Dstar


def stiffness_change(vectors: NDArray[np.float64], change: NDArray[np.float64], law: Law,
                     model: Model = 'complete') -> NDArray[np.float64]:
    """Derivative of the stiffness of bonds along a change of their vectors, by a complex step: exact to round-off.

    Parameters
    ----------
    vectors, change : ndarray, shape (bonds, dim)
        In mm.
    law, model
        As for `model_stiffness`.

    Returns
    -------
    ndarray, shape (bonds, dim, dim)
        In N/mm per unit of the change.
    """
    return np.imag(model_stiffness(vectors + 1j * STEP * change, law, model)) / STEP


def upper_part(vectors: NDArray[np.float64], law: Law, model: Model = 'complete') -> NDArray[np.float64]:
    """Upper bound of the stiffness of each bond in N/mm, shape (bonds, dim, dim): its negative eigenvalues are set to zero."""
    acting = interaction_of(law, vectors.shape[1])
    if not isinstance(acting, Central):
        values, n = np.linalg.eigh(model_stiffness(vectors, acting, model))
        return n * np.maximum(values, 0)[:, None] @ n.swapaxes(1, 2)
    r = _lengths(vectors)
    along, n = np.maximum(acting.law.d2phi(r), 0), vectors.T / r
    across = 0 * r if model == 'conventional' else np.maximum(acting.law.dphi(r) / r, 0)
    K, x = (along - across) * n[:, None] * n, np.arange(len(n))
    K[x, x] += across
    return K.T


def displaced(bonds: Bonds, vectors: NDArray[np.float64], r: NDArray[np.float64], interaction: PairInteraction,
              model: Model) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64] | None]:
    """The bond vectors at which an interaction is evaluated, their lengths, and the directions of its gradient in the
    conventional model.

    In the complete model these are the given vectors and lengths, and the directions are None. In the conventional model the
    vectors are projected on the directions n at rest, and n is returned too.

    Raises Diverged for a bond that is squeezed below CONTACT or stretched beyond BROKEN_BOND times its rest length, unless it
    exerts no force there, as between spheres that have parted.
    """
    n = None
    if model == 'conventional':
        R, r0 = bonds.vectors[:, : vectors.shape[1]], bonds.lengths
        n = (R.T / r0).T
        r = r0 + _product(n, vectors - R)
        vectors = (r / r0)[:, None] * R  # R itself at rest, to the last bit
    nearest = r.min(initial=np.inf)
    if not nearest > 0:
        b = r.argmin()
        raise ValueError(f'particles {bonds.i[b]} and {bonds.j[b]} coincide or have passed through each other '
                         f'(distance {r[b]:g} mm along their bond); start from smaller displacements')
    if not (CONTACT * bonds.longest < nearest and r.max(initial=0.0) < BROKEN_BOND * bonds.shortest):
        _refuse_far(bonds, r, vectors, interaction)  # some bond may be out of range, so look at each
    return vectors, r, n


def _refuse_far(bonds, r, vectors, interaction):
    """Raise Diverged for a bond whose length `r` is out of range and whose interaction acts at the `vectors`."""
    out = (r < CONTACT * bonds.lengths) | (r > BROKEN_BOND * bonds.lengths)
    if not out.any():
        return
    with suppress(ValueError):  # of a law that refuses one of the lengths
        out &= interaction.forces(vectors)[1].any(axis=1)
    for b in np.flatnonzero(out)[:1]:
        raise Diverged(bonds.i[b], None, f'is {r[b]:g} mm from its neighbour {bonds.j[b]} instead of {bonds.lengths[b]:g} mm')


def _product(a: Any, b: Any) -> Any:
    """Scalar products of vectors in rows, summed by columns: this is faster, and rounding does not depend on memory layout."""
    return sum(x * y for x, y in zip(a.T, b.T, strict=True))


def _lengths(R):
    """Lengths of vectors, which may be complex; ValueError if a length is zero or infinite."""
    r = np.sqrt(_product(R, R))
    if not (r.real.min(initial=1.0) > 0 and r.real.max(initial=1.0) < np.inf):
        k = np.argmin((r.real > 0) & (r.real < np.inf))
        raise ValueError(f'bond {k} has the vector {R[k]} mm; a bond joins two particles at a finite distance')
    return r


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
    own = bonds.total(np.where(to_itself, abs(1 - phase) ** 2 / 2, 1) * K) + springs
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
    own, x = bonds.total(K), np.arange(K.shape[1])
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
    A, B, C = _bloch_sum(bonds, K, bonds.total(K)[..., None] * [1, 0, 0], powers, np.arange(len(R)))
    return A, B, C


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
