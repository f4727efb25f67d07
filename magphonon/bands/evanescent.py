"""Complex bands: the complex wavenumbers at a given frequency, also inside band gaps.

Along a direction the Bloch matrix is a Laurent polynomial in mu = e^{i s xi}, with a term for each distance that
bonds bridge, all of which are multiples of s.  At the frequency omega its mass-weighted modes v obey

    sum_p D_p mu^p v = (omega^2 + i omega B) v        B = gamma - g (x) J        p = -P ... P

This is a polynomial eigenproblem of degree 2 P for the motion e^{-i omega t}, with the damping gamma and the gyroscopic rate g
of each particle (`LinearSystem.B`). Without damping, the bands are the real xi. Complex xi belong to waves that decay as
e^{-Im xi} per step: below the cut-off of a foundation, above the bands and between them. With damping every wave decays.

The longest bonds couple only some components of v, so D_P is singular, and of the 2 P n roots some lie at infinity and as many
at zero, in Jordan chains.  Round-off eps would split a chain of k roots into a ring of the radius eps^(1/k): false waves, which
decay by 36/k per step.  So the chains are split off the linearised eigenproblem, link by link, by rotations that leave all
other roots where they are; the roots that remain are then polished by Newton's method.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from math import gcd, lcm
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy import linalg

from ..errors import finite
from ..results import InHertz
from ..stiffness.plausibility import asked_frequencies, site_damping
from ..stiffness.rest import LinearSystem
from ..stiffness.sites import each_spring
from ..traits import LINEAR, takes

if TYPE_CHECKING:
    from ..stiffness.matrices import Model

LINK = 1e-11
"""Fraction of the largest coefficient below which a singular value belongs to a link of a chain.  In 150 random cells of up to
eight particles, at three frequencies each, those of links were at most 2e-12, all others at least 4e-11."""
POLISHES = 3
LONGEST_STEP = 0.1  # longest Newton step in log mu; a longer one leads to another root
SINGULAR_FRACTION = 1e-14  # of the largest singular value: below is round-off, as where two roots coincide
LARGEST_DENOMINATOR = 6  # of exponents; the pencil grows with it, and symmetry directions need 1, 2 or 3
LEAST_DECAY = 1e-6  # per step; below is round-off: at a band edge, a double root, round-off changes xi by its square root
LEAST_LOSS = 1e-12  # the same with damping, with which no two roots meet at a band edge
INFINITE_DECAY = 16  # decay per step above which a wave counts as infinitely evanescent (e^-16 = 1e-7)


def laurent_roots(A: NDArray[Any]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Roots mu of `sum_p A_p mu^p v = 0` that are finite and not zero; they come in pairs mu and 1/mu, up to round-off.

    `A`, shape (2 P + 1, n, n), has the coefficients A_-P ... A_P, where A_-p is the transpose of A_p. If A_0 is Hermitian and not
    symmetric, the pairs are mu and 1/mu*. Entries between uncoupled components must be exactly zero.  The vectors v, shape
    (roots, n), are of norm one.
    """
    powers, n = len(A) - 1, A.shape[1]
    A = A / abs(A).max()
    # A_P mu^2P v + ... + A_-P v = 0 with the blocks v, mu v, ..., mu^(2P-1) v
    L, R = np.eye(powers * n, k=n, dtype=A.dtype), np.eye(powers * n, dtype=A.dtype)
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
    """One link of the chains of infinite roots of L x = mu R x: the null space of R, and its coupling to the other roots."""

    def __init__(self, L, R, rank):
        axes = np.linalg.svd(R)[2].conj().T
        self.keep, self.null, self.lost = axes[:, :rank], axes[:, rank:], len(R) - rank
        factors: Any = linalg.qr(L @ self.null)
        Q, triangle = factors
        self.triangle = triangle[: self.lost]
        L, R = Q.conj().T @ L @ self.keep, Q.conj().T @ R @ self.keep
        self.L, self.R, self.pencil = L[: self.lost], R[: self.lost], (L[self.lost :], R[self.lost :])

    def restored(self, z, alpha, beta):
        """Eigenvectors of the pencil with this link, in columns, from those without it, `z`; alpha/beta are the roots."""
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


def polished(A: NDArray[Any], mu: NDArray[np.complex128],
             v: NDArray[np.complex128]) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Roots and vectors after Newton steps on `A(mu) v = 0` and `v0^+ v = 1` in log mu, as long as the residual falls."""
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
    """A(mu), its derivative by log mu and A(mu) v, divided by the largest |mu^p|; and the residual relative to its terms."""
    terms = np.exp(powers * log[:, None])
    terms /= abs(terms).max(axis=1)[:, None]
    matrix, slope = np.einsum('rp,pab->rab', terms, A), np.einsum('rp,pab->rab', powers * terms, A)
    rest = np.einsum('rab,rb->ra', matrix, v)
    return matrix, slope, rest, abs(rest).max(axis=1) / np.einsum('rp,pab->rab', abs(terms), abs(A)).max(axis=(1, 2))


@dataclass(frozen=True)
class ComplexBands(InHertz):
    """Waves along a direction at given frequencies, the slowest decay first.

    Attributes
    ----------
    omega : ndarray, shape (frequencies,)
        In rad/ms.
    xi : ndarray of complex, shape (frequencies, waves)
        Phase and decay per step, `e^{i xi}`; the imaginary part is zero or positive. Without damping the real part is not
        negative either, and each value stands for four waves: xi, -xi and their conjugates. With damping it stands for xi and
        -xi; the real part is negative if the crests of a wave run against its energy. For gyroscopes only waves whose energy
        runs forwards are given. The imaginary part is infinite where a motion does not reach the next step.
    vectors : ndarray of complex, shape (frequencies, waves, particles, dim)
        Modes, normalised to one and weighted with the square root of the mass: displacements are `vectors / sqrt(m)`.  Zero
        where the decay is infinite.
    """

    omega: np.ndarray
    xi: np.ndarray
    vectors: np.ndarray

    @property
    def decay_steps(self) -> NDArray[np.float64]:
        """Number of steps over which each wave falls to 1/e, shape (frequencies, waves); infinite where it propagates."""
        with np.errstate(divide='ignore'):
            return 1 / np.imag(self.xi)


@takes(*LINEAR)
def complex_bands(atoms: Atoms, direction: ArrayLike, omega: ArrayLike, model: Model | None = None,
                  damping: ArrayLike = 0.0) -> ComplexBands:
    """All waves along a direction at given frequencies, propagating and evanescent.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator; held particles, such as the walls of a channel, do not move.
    direction : array_like, shape (3,)
        The wavevector at which xi = 2 pi, in fractions of the reciprocal vectors, as for `waves.branch`: in the triangular
        lattice along R2, (0, 1, 0) for a row of sources along R1 and (1/2, 1, 0) for a point source.
    omega : array_like, shape (frequencies,)
        In rad/ms; a negative value -w stands for an imaginary frequency, omega^2 = -w^2, as in `Bands`.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.
    damping : float or array_like, shape (particles,)
        Damping rate gamma in 1/ms, force divided by momentum; weak damping adds the decay gamma/(2 v) at the group velocity v.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.bands import complex_bands
    >>> cell = lattices.chain(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=10.0)
    >>> below = complex_bands(cell, (1, 0, 0), [1.0])  # the cut-off is the root of 10
    >>> below.xi.real.tolist(), bool((below.xi.imag > 0).all())  # in phase, and decaying
    ([[0.0, 3.141592653589793]], True)
    >>> inside = complex_bands(cell, (1, 0, 0), [4.0], damping=0.1)  # cos(1.318) = 1/4
    >>> complex(inside.xi[0, 0].round(3))
    (1.318+0.052j)
    """
    system = LinearSystem.of(atoms).moving()
    free = system.free.toarray()
    direction = finite('direction', direction, (3,))
    omega, bonds = asked_frequencies(system.calc, omega), system.calc.bonds
    moves: Any = np.diff(system.free.indptr).reshape(len(system), -1).any(axis=1)
    # a bond to a held particle carries no wave
    exponents, unit = _exponents(bonds.shift * (moves[bonds.i] & moves[bonds.j])[:, None] @ direction)
    D = system.reduced(_laurent(system.calc, model, exponents))
    xi = np.array([0.7, 1.9, 2.6])  # far from symmetry: only a flat band has one frequency at all of them
    bands = system.bloch(xi[:, None] / (2 * np.pi) * direction, model)
    waves = []
    for w, dynamic in zip(omega, _dynamic(system, omega, damping), strict=True):
        if (np.linalg.svd(bands - dynamic, compute_uv=False)[:, -1] < 1e-10 * abs(bands).max()).all():
            raise ValueError(f'at omega = {w:.9g} rad/ms a band is flat, so every wavenumber is a solution; choose another '
                             f'frequency')
        waves.append(_waves(D, dynamic, unit, np.any(damping)))
    xi, v = (np.array(part) for part in zip(*waves, strict=True))
    return ComplexBands(omega, xi, (v @ free.T).reshape(*xi.shape, len(system), system.dim))


def _dynamic(system, omega, damping):
    """The matrices omega^2 + i omega B, with damping and gyroscopic forces in B; real if there is neither."""
    gamma, one = site_damping(damping, len(system), system.calc), np.eye(system.directions)
    if not (gamma.any() or system.turning):
        return (omega * abs(omega))[:, None, None] * one
    for w in omega[omega < 0][:1]:
        raise ValueError(f'where forces depend on the velocity, omega must be zero or positive, not {w:.9g} rad/ms')
    return (omega**2)[:, None, None] * one + 1j * omega[:, None, None] * system.B(gamma).toarray()


def _exponents(steps):
    """The steps that bonds bridge as whole multiples of the largest possible unit, and that unit."""
    fractions = [Fraction(float(step)).limit_denominator(LARGEST_DENOMINATOR) for step in steps]
    for step, fraction in zip(steps, fractions, strict=True):
        if abs(step - fraction) > 1e-9:
            raise ValueError(f'along this direction a bond spans {step:.6g} lattice steps, which '
                             'is no fraction with a denominator of at most '
                             f'{LARGEST_DENOMINATOR}; choose a direction of symmetry, such as (0, 1, 0) or (1/2, 1, 0)')
    if not any(fractions):
        raise ValueError('no bond has a component along the direction; give the direction in fractions of the reciprocal vectors '
                         'of the periodic directions')
    d = lcm(*(fraction.denominator for fraction in fractions))
    exponents = np.array([int(d * fraction) for fraction in fractions])
    common = gcd(*exponents.tolist())
    return exponents // common, common / d


def _laurent(calc, model, exponents):
    """Coefficients D_p, p = -P ... P, of the Bloch matrix by powers of mu; entries that no bond couples are exactly zero."""
    K, i, j = calc.rest_stiffness(model), calc.bonds.i, calc.bonds.j
    n, P = calc.bonds.particles, abs(exponents).max()
    D = np.zeros((2 * P + 1, n, n, calc.dim, calc.dim))
    for end in (i, j):
        np.add.at(D, (P, end, end), K)
    np.subtract.at(D, (P + exponents, i, j), K)
    np.subtract.at(D, (P - exponents, j, i), K)
    D = D.swapaxes(2, 3).reshape(2 * P + 1, n * calc.dim, -1)
    D[P] += np.diag(each_spring(calc.foundation, n, calc.dim))
    return D


def _waves(D, dynamic, unit, lossy):
    """The xi of all waves at one frequency, one for each family of equivalent waves, and their modes."""
    n, P = D.shape[1], len(D) // 2
    A = D.astype(dynamic.dtype)
    A[P] -= dynamic
    one_way, least = np.iscomplexobj(A), LEAST_LOSS if lossy else LEAST_DECAY
    mu, v = laurent_roots(A)
    decay, phase = -np.log(abs(mu)), np.angle(mu)
    decay[abs(decay) < least * unit] = 0
    # xi and its conjugate, or xi and -xi if real: keep the half that decays or runs forwards
    forwards = phase
    if one_way and not lossy:  # by d omega/d xi, of which v^+ dA/d xi v has the sign
        slope = _at(A, np.arange(-P, P + 1), np.log(mu), v)[1]
        forwards = -np.einsum('ra,rab,rb->r', v.conj(), slope, v).imag
    half = np.lexsort((-forwards, -decay))[: len(mu) // 2]
    mu, v = polished(A, mu[half], v[half])
    decay, phase = -np.log(abs(mu)) / unit, np.angle(mu) / unit
    decay[abs(decay) < least] = 0
    order = np.lexsort((abs(phase), decay))
    order = order[decay[order] < INFINITE_DECAY]
    xi, modes = np.zeros(P * n, complex), np.zeros((P * n, n), complex)
    xi.imag = np.inf
    xi[: len(order)] = (phase[order] if one_way else abs(phase[order])) + 1j * decay[order]
    modes[: len(order)] = v[order] if one_way else np.where(phase[order, None] < 0, v[order].conj(), v[order])
    return xi, modes
