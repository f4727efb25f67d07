"""Lattice sums over all particles of an infinite lattice by Ewald's method, for every law that is a mixture of Gaussians.

    phi(r) = int_0^inf rho(t) exp(-t r^2) dt        r^-s:   rho = t^(s/2-1)/Gamma(s/2)
                                                    Yukawa: rho = c (pi t)^(-1/2) exp(-kappa^2/4t)

Gaussians narrower than eta^-1 (t > eta^2) are summed over the lattice R, wider ones over its reciprocal G by Poisson's
formula in the d periodic directions, of volume V, with p = G - k and x the offset across them:

    sum_R e^{ik.R} exp(-t |R + r|^2) = (pi/t)^{d/2}/V exp(-t x^2) sum_G e^{ip.r} exp(-p^2/4t)

Both sums converge like a Gaussian whatever s.  In closed form the integrals over the widths, t in 1/mm^2, are the incomplete
gamma functions of the usual Ewald sum; here they are done by quadrature, which also allows offsets across a chain, and every
mixture rho(t).

The stiffness of a bond is a mixture of the same Gaussians and their second derivatives, `int [alpha + beta grad grad]
exp(-t r^2) dt`.  With W = int_0^t t rho dt, from 1/r^2 = int_0^inf exp(-t r^2) dt in the n(x)n of D*,

    D0 + D*    alpha = 0               beta = rho
    D*         alpha = W/t - 2 t rho   beta = W/(2 t^2)

Where the sum over all neighbours diverges (r^-s in d <= s dimensions), a uniform background neutralises it: the term
p = 0 is continued analytically, and omitted at k = 0.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from ..errors import finite, one_of, positive
from ..interactions.pair_laws import GaussianMixture, InversePower

REACH = 42.0  # exponent at which both sums are truncated: e^-42 is 6e-19
_X, _W = np.polynomial.legendre.leggauss(16)
_PANEL = 1.5  # of log t: with 16 nodes the double exponential exp(-x e^v) is integrated to round-off, without a power of t


def lattice_sum(lattice: ArrayLike | Atoms, law: float | GaussianMixture, offset: ArrayLike | None = None,
                q: ArrayLike | None = None, split: float = 1.0) -> float | complex:
    """`sum_R phi(|R + offset|) exp(2 pi i q.R)` over all lattice vectors R, without the one where R + offset = 0.

    Parameters
    ----------
    lattice : array_like, shape (d, dim), or ase.Atoms
        Lattice vectors in rows, d = 1, 2 or 3 of them. Of Atoms only the periodic lattice vectors are used, not the positions.
    law : float or GaussianMixture
        The exponent s > 0 of phi = r^-s, or a law such as Yukawa(c, kappa).  Where s <= d and the wave is uniform (q = 0)
        the sum diverges; its value is then that with a uniform neutralising background, Epstein's zeta function.
    offset : array_like, shape (dim,), optional
        Offset of the particles from the origin, in the unit of the lattice vectors; it may point out of their line or plane.
    q : array_like, shape (d,), optional
        In fractions of the reciprocal vectors.
    split : float
        Parameter that divides the two sums; with 1 they converge equally fast.  The result does not depend on it.

    Returns
    -------
    float, or complex where `q` is given

    Raises
    ------
    ValueError
        For an exponent that is not positive, or equals d in a uniform sum, which no background makes finite.
        For vectors that are not linearly independent.

    Examples
    --------
    >>> from magphonon.stiffness.ewald import lattice_sum
    >>> round(lattice_sum([[1.0, 0], [0.5, 0.75**0.5]], 3.0), 10)  # of r^-3 over the triangular lattice
    11.0341757349
    """
    periods = lattice.cell.array[lattice.pbc] if isinstance(lattice, Atoms) else finite('lattice', lattice)
    law = law if isinstance(law, GaussianMixture) else InversePower(b=positive('s', law), a=law + 1)
    sums = EwaldSums(periods, law, split)
    offset = np.zeros(sums.dim) if offset is None else finite('offset', offset, (sums.dim,))
    total = sums.scalar(np.zeros(sums.d) if q is None else finite('q', q, (sums.d,)), offset)
    return complex(total) if q is not None else float(total.real)


@dataclass(frozen=True)
class EwaldSums:
    """The sums of one law over one Bravais lattice."""

    periods: np.ndarray  # shape (d, dim): lattice vectors in rows, mm
    law: GaussianMixture
    split: float = 1.0  # eta in units of sqrt(pi)/V^(1/d)

    def __post_init__(self) -> None:
        periods = finite('lattice', self.periods)
        if periods.ndim != 2 or not 1 <= len(periods) <= periods.shape[1] or np.linalg.matrix_rank(periods) < len(periods):
            raise ValueError(f'a lattice has one to three independent vectors in rows, not {periods.tolist()}')
        object.__setattr__(self, 'periods', periods)
        positive('split', self.split)

    @property
    def d(self) -> int:
        """Number of periodic directions."""
        return len(self.periods)

    @property
    def dim(self) -> int:
        """Number of components of a vector."""
        return self.periods.shape[1]

    @cached_property
    def volume(self) -> float:
        """Length, area or volume of a cell in mm^d."""
        return np.sqrt(np.linalg.det(self.periods @ self.periods.T))

    @cached_property
    def eta2(self) -> float:
        """The t at which the Gaussians are divided, 1/mm^2."""
        return self.split**2 * np.pi / self.volume ** (2 / self.d)

    @cached_property
    def across(self) -> NDArray[np.float64]:
        """Projector on the directions that are not periodic, shape (dim, dim)."""
        if self.d == self.dim:  # then exactly
            return np.zeros((self.dim, self.dim))
        return np.eye(self.dim) - np.linalg.pinv(self.periods) @ self.periods

    @property
    def radius(self) -> float:
        """Distance in mm beyond which narrow Gaussians contribute nothing."""
        return np.sqrt(REACH / self.eta2)

    @property
    def decay(self) -> float:
        """Exponent s of a law with an algebraic tail, infinite for a screened one."""
        return self.law.decay

    @property
    def splits(self) -> bool:
        """Whether the sums of D0 and D* converge separately, and not only their total."""
        return self.decay + 2 > self.d

    def mixture(self, part: str) -> tuple[Callable[..., Any] | None, Callable[..., Any]]:
        """The functions alpha(t), or None where it is zero, and beta(t) of the stiffness, 'all' of it or 'D0'."""
        rho, W = self.law.gaussians, self.law.gaussian_moment
        if one_of('part', part, ('all', 'D0')) == 'all':
            return None, rho
        if not self.splits:
            raise ValueError(f'with all neighbours of a law r^-{self.decay:g} in {self.d} dimensions D0 and D* diverge '
                             'separately, and only their sum converges; choose the complete model, or a number of shells')
        return lambda t: 2 * t * rho(t) - W(t) / t, lambda t: rho(t) - W(t) / (2 * t**2)

    # --- narrow Gaussians, over the lattice --------------------------------------------------------------------------

    def near_energy(self, r: Any) -> NDArray[np.float64]:
        """Contribution of the narrow Gaussians to phi and in phi'/r at the distances `r` in mm, shape (2, distances)."""
        t, w = self._narrow(r)
        onto = (w * self.law.gaussians(t))[:, None] * np.stack([np.ones_like(t), -2 * t], axis=1)
        few = np.array_split(r, max(1, len(r) // 4096))  # large supercells have many bonds
        return np.concatenate([np.exp(-np.multiply.outer(part**2, t)) @ onto for part in few]).T

    def near_stiffness(self, x: NDArray[np.float64], part: str = 'all') -> NDArray[np.float64]:
        """Contribution of the narrow Gaussians to the stiffness of bonds with the vectors `x`, shape (bonds, dim, dim)."""
        t, w = self._narrow(np.linalg.norm(x, axis=1))
        alpha, beta = (f(t) * w if f else 0 * w for f in self.mixture(part))
        gauss = np.exp(-np.multiply.outer((x**2).sum(axis=1), t))
        xx = x[:, :, None] * x[:, None, :]
        onto_I, onto_xx = gauss @ (alpha - 2 * t * beta), gauss @ (4 * t**2 * beta)
        return onto_I[:, None, None] * np.eye(x.shape[1]) + onto_xx[:, None, None] * xx

    def _narrow(self, r):
        """Nodes and weights of the integral from eta^2 up, for distances `r`; a steep law has a sharp peak at large t."""
        shortest = np.min(r, initial=np.inf)
        late = 2 * (self.decay if np.isfinite(self.decay) else self.law.screening * shortest)
        return nodes(self.eta2, self.eta2 + (REACH + 20 + late) / shortest**2, late)

    # --- wide Gaussians, over the reciprocal lattice -----------------------------------------------------------------

    def waves(self, q: NDArray[np.float64]) -> NDArray[np.float64]:
        """The vectors p = G - k that contribute for each of the wavevectors `q`, shape (wavevectors, G, dim), in rad/mm."""
        reciprocal = 2 * np.pi * np.linalg.pinv(self.periods).T
        k = (q - np.round(q)) @ reciprocal
        reach = 2 * np.sqrt(self.eta2 * REACH) + np.linalg.norm(k, axis=1).max(initial=0)
        return points_within(reciprocal, np.zeros(self.dim), reach) - k[:, None]

    def far_energy(self, offsets: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Contribution of the wide Gaussians to `sum_R phi(R + offset)` and its gradient, shapes (offsets,), (offsets, dim)."""
        p, rho = self.waves(np.zeros((1, self.d)))[0], self.law.gaussians
        phi, gradient = np.empty(len(offsets)), np.empty(offsets.shape)
        for x, these in self._sideways(offsets):
            wide = WideGaussians(self, (p**2).sum(axis=1), x @ x)
            phase = np.exp(1j * p @ offsets[these].T)
            waves = wide.moment(rho, 0)[:, None] * phase
            phi[these], gradient[these] = waves.sum(axis=0).real, -(p.T @ waves.imag).T
            if x.any():
                gradient[these] -= 2 * x * (wide.moment(lambda t: t * rho(t), 1) @ phase).real[:, None]
        return phi, gradient

    def far_stiffness(self, p: NDArray[np.float64], offsets: NDArray[np.float64], part: str = 'all') -> NDArray[np.complex128]:
        """Contribution of the wide Gaussians to `sum_R K(R + offset) e^{ik.R}`, shape (wavevectors, offsets, dim, dim)."""
        alpha, beta = self.mixture(part)
        total = np.empty((len(p), len(offsets), self.dim, self.dim), dtype=complex)
        for x, these in self._sideways(offsets):
            wide = WideGaussians(self, (p**2).sum(axis=-1), x @ x)
            T = -np.einsum('qG,qGa,qGb->qGab', wide.moment(beta, 0, uniform=False), p, p)
            if alpha:
                T = T + wide.moment(alpha, 1)[..., None, None] * np.eye(self.dim)
            if self.d < self.dim:
                b1, b2 = (wide.moment(lambda t, m=m: t**m * beta(t), m)[..., None, None] for m in (1, 2))
                px = p[..., :, None] * x
                T = T - 2 * b1 * (self.across + 1j * (px + px.swapaxes(-1, -2))) + 4 * b2 * np.outer(x, x)
            total[:, these] = np.einsum('qGab,qGo->qoab', T, np.exp(1j * p @ offsets[these].T))
        return total

    def _sideways(self, offsets):
        """The different offsets across the lattice, and where each occurs; all are zero except in chains of some breadth."""
        x, which = np.unique((offsets @ self.across / self.radius).round(14), axis=0, return_inverse=True)
        return [(self.radius * x[k], np.flatnonzero(which.ravel() == k)) for k in range(len(x))]

    # --- both --------------------------------------------------------------------------------------------------------

    def scalar(self, q: NDArray[np.float64], offset: NDArray[np.float64]) -> complex:
        """`sum_R phi(R + offset) e^{2 pi i q.R}` at one wavevector, without R + offset = 0."""
        if abs(self.decay - self.d) < 1e-12 and not (q % 1).any():
            raise ValueError(f'the sum of r^-{self.decay:g} over {self.d} dimensions diverges with the logarithm of the size, '
                             'and a uniform background does not cancel that; choose another exponent, or a number of shells')
        R = points_within(self.periods, -offset, self.radius)
        r = np.linalg.norm(R + offset, axis=1)
        here = r > 1e-12 * self.radius
        phase = np.exp(2j * np.pi * R[here] @ np.linalg.pinv(self.periods) @ q)
        p = self.waves(q[None])[0]
        wide = WideGaussians(self, (p**2).sum(axis=1), offset @ self.across @ offset)
        total = phase @ self.near_energy(r[here])[0] + wide.moment(self.law.gaussians, 0) @ np.exp(1j * p @ offset)
        # the wide Gaussians of the particle at R + offset = 0, if there is one; its phase is e^{ik.R}
        itself = np.exp(2j * np.pi * R[~here] @ np.linalg.pinv(self.periods) @ q).sum()
        return total - itself * self.wide_at_zero()

    def wide_at_zero(self) -> float:
        """Contribution of the wide Gaussians to the energy phi(0) of a particle with itself."""
        if np.isfinite(self.decay):
            return self.eta2 * self.law.gaussians(self.eta2) / (self.decay / 2)
        t, w = nodes(self.law.screening**2 / 4 / (REACH + 20), self.eta2)
        return w @ self.law.gaussians(t)

    def singular(self, along: NDArray[np.float64], part: str = 'all') -> NDArray[np.float64]:
        """Signs of the stiffness that exceeds k^2 in long waves, if the law decays no faster than r^-d.

        There D(k) begins with |k|^(s-d+2) times a tensor with the signs of this one: for polarisations along its eigenvectors the
        speed of sound is infinite.  `along` is a unit vector; the tensor is zero for laws that decay faster.
        """
        if self.decay > self.d:
            return np.zeros((self.dim, self.dim))
        alpha, beta = (f(1.0) if f else 0.0 for f in self.mixture(part))
        # Gamma(g - 1) = Gamma(g)/(g - 1) in the moments of the next order in t, g = (d - s)/2 < 1 where they are wanted
        next_order = 1 / (4 - 2 * (self.d - self.decay)) if alpha or self.d < self.dim else 0.0
        return beta * np.outer(along, along) + next_order * (alpha * np.eye(self.dim) - 2 * beta * self.across)

    def far_series(self, along: NDArray[np.float64], offsets: NDArray[np.float64], part: str = 'all') -> NDArray[np.complex128]:
        """Far stiffness to second order in the wavevector k `along`, with the phase of each particle, e^{ik.(R + offset)}.

        Returns the terms of order 1, k and k^2, shape (3, offsets, dim, dim), without those that exceed k^2 (see `singular`).
        """
        alpha, beta = self.mixture(part)
        G = self.waves(np.zeros((1, self.d)))[0]
        g, P, n, eye = G @ along, self.across, along, np.eye(self.dim)
        series = np.zeros((3, len(offsets), self.dim, self.dim), dtype=complex)
        # exp(-p^2/4t) with p = G - k n is exp(-G^2/4t) [1 + k g/2t + k^2 (g^2/8t^2 - 1/4t)]: order in k, power of t, factor
        gaussian = (0, 0, 1.0), (1, -1, g / 2), (2, -1, -0.25), (2, -2, g**2 / 8)
        for o, offset in enumerate(offsets):
            x = P @ offset
            wide = WideGaussians(self, (G**2).sum(axis=1), x @ x)
            # alpha + beta grad grad, where grad = ip - 2tx and the direction across adds -2t P: order in k, power of t, tensor
            i_G, i_n = 1j * G[:, :, None], -1j * n[:, None]
            terms = [(0, 0, beta, i_G * i_G.swapaxes(1, 2)), (1, 0, beta, _symmetric(i_G * -1j * n)), (2, 0, beta, i_n * i_n.T)]
            if alpha:
                terms.append((0, 1, lambda t: alpha(t) / t, eye))
            if self.d < self.dim:
                terms += [(0, 1, beta, -2 * P - 2 * _symmetric(i_G * x)), (1, 1, beta, -2 * _symmetric(i_n * x)),
                          (0, 2, beta, 4 * np.outer(x, x))]
            for (j, power, factor), (k, m, f, tensor) in product(gaussian, terms):
                if j + k > 2:
                    continue
                exists = (self.decay - self.d) / 2 + m + power > 0  # else the term G = 0 belongs to `singular`
                integral = wide.moment(lambda t, f=f, m=m + power: t**m * f(t), m + power, uniform=exists)
                wave = integral * factor * np.exp(1j * G @ offset)
                series[j + k, o] += np.einsum('G,Gab->ab', wave, np.broadcast_to(tensor, (len(G), *eye.shape)))
        return series


class WideGaussians:
    """Integrals over the wide Gaussians, `int f(t) (pi/t)^{d/2}/V exp(-p^2/4t - t x^2) dt` up to eta^2, one for each p^2."""

    def __init__(self, sums: EwaldSums, p2: NDArray[np.float64], x2: Any) -> None:
        self.sums = sums
        algebraic = np.isfinite(sums.decay)
        # p = 0: below t = 1/x^2 the integrand without the offset across is a power of t, integrated in closed form
        self.uniform = (p2 < 1e-24 * sums.eta2) & algebraic
        self.flat = sums.eta2 / max(1, x2 * sums.eta2) if algebraic else sums.eta2
        low = min(np.where(self.uniform, np.inf, p2).min(initial=np.inf), 4 * sums.eta2)
        low = (low if algebraic else low + sums.law.screening**2) / 4 / (REACH + 20)
        if x2 > 0 and algebraic:
            low = min(low, self.flat * np.exp(-80))
        power = 2 * sums.decay if algebraic else 0
        self.t, w = (np.concatenate(both) for both in zip(nodes(low, self.flat, power), nodes(self.flat, sums.eta2, power),
                                                          strict=True))
        self.w = w * (np.pi / self.t) ** (sums.d / 2) / sums.volume
        self.gauss = np.exp(-p2[..., None] / (4 * self.t)) * np.exp(-self.t * x2)
        self.gauss[self.uniform] = np.where(self.t < self.flat, np.expm1(-self.t * x2), np.exp(-self.t * x2))

    def moment(self, f: Callable[..., Any], m: int, uniform: bool = True) -> NDArray[np.float64]:
        """The integral of a function that behaves as rho t^m near t = 0; without the term p = 0 if not `uniform`."""
        sums = self.sums
        result = self.gauss @ (self.w * f(self.t))
        if not self.uniform.any():
            return result
        if not uniform:
            return np.where(self.uniform, 0.0, result)
        exponent = (sums.decay - sums.d) / 2 + m
        # an exponent of zero gives a logarithm of the size, equal for all particles: the zero of the energy is then arbitrary
        factor = 1 / exponent if abs(exponent) > 1e-12 else np.log(self.flat * sums.volume ** (2 / sums.d))
        closed = self.flat * f(self.flat) * (np.pi / self.flat) ** (sums.d / 2) / sums.volume * factor
        return result + np.where(self.uniform, closed, 0.0)


def nodes(low: float, high: float, power: float = 0) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gauss-Legendre nodes and weights of an integral over t, on panels of equal ratio, narrower for a high power of t."""
    if low >= high:  # the screening is so strong that there are no wide Gaussians
        return np.array([high]), np.zeros(1)
    panels = max(1, int(np.ceil(np.log(high / low) / _PANEL * (1 + power / 32))))
    half = np.log(high / low) / panels / 2
    centre = np.log(low) + half * (2 * np.arange(panels) + 1)
    t = np.exp(centre[:, None] + half * _X)
    return t.ravel(), (half * _W * t).ravel()


def _symmetric(tensor):
    return tensor + tensor.swapaxes(-1, -2)


def points_within(vectors: NDArray[np.float64], centre: NDArray[np.float64], radius: float) -> NDArray[np.float64]:
    """Points of the lattice of `vectors` (rows) closer than `radius` to `centre`, shape (points, dim)."""
    along = np.linalg.pinv(vectors)
    middle = np.round(centre @ along).astype(int)
    reach = np.floor(radius * np.linalg.norm(along, axis=0)).astype(int) + 1
    steps = np.array(list(product(*(range(m - n, m + n + 1) for m, n in zip(middle, reach, strict=True)))))
    points = steps @ vectors
    return points[((points - centre) ** 2).sum(axis=1) < radius**2]
