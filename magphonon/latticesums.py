"""Sums over all the particles of an infinite lattice, after Ewald, for every law that is a mixture of Gaussians.

    phi(r) = int_0^inf rho(t) exp(-t r^2) dt        r^-s:   rho = t^(s/2-1)/Gamma(s/2)
                                                    Yukawa: rho = c (pi t)^(-1/2) exp(-kappa^2/4t)

Gaussians narrower than eta^-1 (t > eta^2) are summed over the lattice R, wider ones over its reciprocal G by Poisson's
formula in the d periodic directions, of volume V, with p = G - k and x the offset across them:

    sum_R e^{ik.R} exp(-t |R + r|^2) = (pi/t)^{d/2}/V exp(-t x^2) sum_G e^{ip.r} exp(-p^2/4t)

Both sums converge like a Gaussian whatever s.  (Done in closed form the integrals over t are the incomplete gamma
functions of the usual Ewald sum; done by quadrature they also allow offsets across a chain, and every rho.)

The stiffness of a bond is a mixture of the same Gaussians and their second derivatives, `int [alpha + beta grad grad]
exp(-t r^2) dt`.  With W = int_0^t t rho dt, from 1/r^2 = int_0^inf exp(-t r^2) dt in the n(x)n of D*,

    D0 + D*    alpha = 0               beta = rho
    D*         alpha = W/t - 2 t rho   beta = W/(2 t^2)

Where the sum over all neighbours diverges (r^-s in d <= s dimensions), a uniform background neutralises it: the term
p = 0 is continued analytically, and left out at k = 0.
"""

from dataclasses import dataclass
from functools import cached_property
from itertools import product

import numpy as np
from ase import Atoms

from .errors import finite, one_of, positive
from .potentials import InversePower

PARTS = ('all', 'D0', 'Dstar')
REACH = 42.0
"""Exponent where both sums are cut: e^-42 is 6e-19."""

_X, _W = np.polynomial.legendre.leggauss(16)
_PANEL = 1.5  # of log t: with 16 nodes the double exponential exp(-x e^v) is integrated to round-off, without a power of t


def lattice_sum(lattice, s, offset=None, q=None, split=1.0):
    """`sum_R |R + offset|^-s exp(2 pi i q.R)` over all lattice vectors R, without the one where R + offset = 0.

    Parameters
    ----------
    lattice : array_like, shape (d, dim), or ase.Atoms
        Lattice vectors in rows, d = 1, 2 or 3 of them; of Atoms, those along which they are periodic (their positions
        do not enter: `particle_sums` adds up those).
    s : float
        Exponent, positive.  Where s <= d and the wave is uniform (q = 0) the sum diverges; its value is then that
        with a uniform neutralising background, Epstein's zeta function.
    offset : array_like, shape (dim,), optional
        Of the particles from the origin, in the unit of the lattice vectors; also across the lattice.
    q : array_like, shape (d,), optional
        In fractions of the reciprocal vectors.
    split : float
        Where the two sums are divided, 1 where they converge equally fast; the result does not depend on it.

    Returns
    -------
    float, or complex where `q` is given

    Raises
    ------
    ValueError
        For an exponent that is not positive, or equals d in a uniform sum: no background makes that one finite.
        For vectors that span no lattice.
    """
    s = positive('s', s)
    periods = lattice.cell.array[lattice.pbc] if isinstance(lattice, Atoms) else finite('lattice', lattice)
    law = InversePower(b=s, a=s + 1)
    sums = EwaldSums(periods, law, split)
    offset = np.zeros(sums.dim) if offset is None else finite('offset', offset, (sums.dim,))
    total = sums.scalar(np.zeros(sums.d) if q is None else finite('q', q, (sums.d,)), offset)
    return complex(total) if q is not None else float(total.real)


def particle_sums(atoms, s, split=1.0):
    """`sum |r|^-s` over all other particles of an infinite structure, as seen from each; shape (particles,).

    Parameters and errors as in `lattice_sum`, from which it differs by the sum over the particles of the cell.
    """
    sums = EwaldSums(atoms.cell.array[atoms.pbc], InversePower(b=positive('s', s), a=s + 1), split)
    q = np.zeros(sums.d)
    return np.array([sum(sums.scalar(q, end - start).real for end in atoms.positions) for start in atoms.positions])


@dataclass(frozen=True)
class EwaldSums:
    """The sums of one law over one Bravais lattice.

    Attributes
    ----------
    periods : ndarray, shape (d, dim)
        Lattice vectors in rows, mm.
    law : object with gaussians and gaussian_moment
    split : float
        eta in units of sqrt(pi)/V^(1/d).
    """

    periods: np.ndarray
    law: object
    split: float = 1.0

    def __post_init__(self):
        periods = finite('lattice', self.periods)
        if periods.ndim != 2 or not 1 <= len(periods) <= periods.shape[1] or np.linalg.matrix_rank(periods) < len(periods):
            raise ValueError(f'a lattice has one to three independent vectors in rows, not {periods.tolist()}')
        object.__setattr__(self, 'periods', periods)
        positive('split', self.split)

    @property
    def d(self):
        """Number of periodic directions."""
        return len(self.periods)

    @property
    def dim(self):
        """Number of components of a vector."""
        return self.periods.shape[1]

    @cached_property
    def volume(self):
        """Length, area or volume of a cell in mm^d."""
        return np.sqrt(np.linalg.det(self.periods @ self.periods.T))

    @cached_property
    def eta2(self):
        """The t at which the Gaussians are divided, 1/mm^2."""
        return self.split**2 * np.pi / self.volume ** (2 / self.d)

    @cached_property
    def across(self):
        """Projector on the directions that are not periodic, shape (dim, dim)."""
        along = np.linalg.pinv(self.periods) @ self.periods
        return np.eye(self.dim) - along

    @property
    def radius(self):
        """Distance in mm beyond which narrow Gaussians contribute nothing."""
        return np.sqrt(REACH / self.eta2)

    @property
    def decay(self):
        """Exponent s of a law with an algebraic tail, infinite for a screened one."""
        return np.inf if hasattr(self.law, 'kappa') else self.law.a - 1

    def mixture(self, part):
        """The functions alpha(t) and beta(t) of a part of the stiffness."""
        rho, W = self.law.gaussians, self.law.gaussian_moment
        alpha, beta = {
            'all': (lambda t: 0 * t, rho),
            'Dstar': (lambda t: W(t) / t - 2 * t * rho(t), lambda t: W(t) / (2 * t**2)),
            'D0': (lambda t: 2 * t * rho(t) - W(t) / t, lambda t: rho(t) - W(t) / (2 * t**2)),
        }[one_of('part', part, PARTS)]
        if part != 'all' and self.decay + 2 <= self.d:
            raise ValueError(f'with all neighbours of a law r^-{self.decay:g} in {self.d} dimensions D0 and D* diverge each by '
                             'itself, only their sum exists; choose the complete model, or a number of shells')
        return alpha, beta

    # --- narrow Gaussians, over the lattice --------------------------------------------------------------------------

    def near_phi(self, r):
        """What the narrow Gaussians leave of phi at the distances `r` in mm, shape as `r`."""
        t, w = self._narrow(r)
        return np.exp(-np.multiply.outer(r**2, t)) @ (w * self.law.gaussians(t))

    def near_slope(self, r):
        """What they leave of phi'/r, shape as `r`."""
        t, w = self._narrow(r)
        return np.exp(-np.multiply.outer(r**2, t)) @ (-2 * t * w * self.law.gaussians(t))

    def near_stiffness(self, x, part='all'):
        """What they leave of the stiffness of bonds with the vectors `x`, shape (bonds, dim, dim)."""
        t, w = self._narrow(np.linalg.norm(x, axis=1))
        alpha, beta = (f(t) * w for f in self.mixture(part))
        gauss = np.exp(-np.multiply.outer((x**2).sum(axis=1), t))
        xx = x[:, :, None] * x[:, None, :]
        onto_I, onto_xx = gauss @ (alpha - 2 * t * beta), gauss @ (4 * t**2 * beta)
        return onto_I[:, None, None] * np.eye(x.shape[1]) + onto_xx[:, None, None] * xx

    def _narrow(self, r):
        """Nodes and weights of the integral from eta^2 up, for distances `r`; a large exponent s peaks late."""
        late = 0 if np.isinf(self.decay) else 2 * self.decay
        return _nodes(self.eta2, self.eta2 + (REACH + 20 + late) / np.min(r, initial=np.inf) ** 2, late)

    # --- wide Gaussians, over the reciprocal lattice -----------------------------------------------------------------

    def waves(self, q):
        """The vectors p = G - k that matter for each of the wavevectors `q`, shape (wavevectors, G, dim), in rad/mm."""
        reciprocal = 2 * np.pi * np.linalg.pinv(self.periods).T
        k = (q - np.round(q)) @ reciprocal
        reach = 2 * np.sqrt(self.eta2 * REACH) + np.linalg.norm(k, axis=1).max(initial=0)
        return points_within(reciprocal, np.zeros(self.dim), reach) - k[:, None]

    def far_scalar(self, p, offset):
        """Their part of `sum_R phi(R + offset) e^{ik.R}`, shape (wavevectors,)."""
        wide = _Wide(self, (p**2).sum(axis=-1), offset @ self.across @ offset)
        return (wide.moment(self.law.gaussians, 0) * np.exp(1j * p @ offset)).sum(axis=1)

    def far_gradient(self, offset):
        """Their part of the gradient of `sum_R phi(R + offset)`, shape (dim,)."""
        p, x = self.waves(np.zeros((1, self.d)))[0], self.across @ offset
        wide, rho = _Wide(self, (p**2).sum(axis=-1), x @ x), self.law.gaussians
        m0, m1 = wide.moment(rho, 0, uniform=False), wide.moment(lambda t: t * rho(t), 1)
        return (((1j * p * m0[:, None]) - 2 * x * m1[:, None]) * np.exp(1j * p @ offset)[:, None]).sum(axis=0).real

    def far_stiffness(self, p, offsets, part='all'):
        """Their part of `sum_R K(R + offset) e^{ik.R}`, shape (wavevectors, offsets, dim, dim)."""
        alpha, beta = self.mixture(part)
        P, p2 = self.across, (p**2).sum(axis=-1)
        total = np.empty((len(p), len(offsets), self.dim, self.dim), dtype=complex)
        sideways = offsets @ P
        for x in np.unique(sideways.round(12), axis=0):  # one, zero, unless a chain is broad
            these = abs(sideways - x).max(axis=1) < 1e-9 * self.radius
            wide = _Wide(self, p2, x @ x)
            a = wide.moment(alpha, 1)
            b0, b1 = wide.moment(beta, 0, uniform=False), wide.moment(lambda t: t * beta(t), 1)
            T = np.einsum('qG,ab->qGab', a, np.eye(self.dim)) - np.einsum('qG,qGa,qGb->qGab', b0, p, p)
            T = T - 2 * b1[..., None, None] * P
            if x.any():
                b2 = wide.moment(lambda t: t**2 * beta(t), 2)
                px = p[..., :, None] * x
                T = T - 2j * b1[..., None, None] * (px + px.swapaxes(-1, -2)) + 4 * b2[..., None, None] * np.outer(x, x)
            total[:, these] = np.einsum('qGab,qGo->qoab', T, np.exp(1j * p @ offsets[these].T))
        return total

    # --- both --------------------------------------------------------------------------------------------------------

    def scalar(self, q, offset):
        """`sum_R phi(R + offset) e^{2 pi i q.R}` at one wavevector, without R + offset = 0."""
        R = points_within(self.periods, -offset, self.radius)
        r = np.linalg.norm(R + offset, axis=1)
        here = r > 1e-12 * self.radius
        phase = np.exp(2j * np.pi * R[here] @ np.linalg.pinv(self.periods) @ q)
        total = phase @ self.near_phi(r[here]) + self.far_scalar(self.waves(q[None]), offset)[0]
        # the wide Gaussians of the particle at R + offset = 0, if there is one; its phase is e^{ik.R}
        itself = np.exp(2j * np.pi * R[~here] @ np.linalg.pinv(self.periods) @ q).sum()
        return total - itself * self.wide_at_zero()

    def wide_at_zero(self):
        """What the wide Gaussians make of phi(0), the interaction of a particle with itself."""
        rho = self.law.gaussians
        if np.isfinite(self.decay):
            return self.eta2 * rho(self.eta2) / (self.decay / 2)
        t, w = _nodes(self.law.kappa**2 / 4 / REACH, self.eta2)
        return w @ rho(t)

    def singular(self, along, part='all'):
        """Signs of the stiffness that outgrows k^2 in long waves, ascending, where the law decays no faster than r^-d.

        There D(k) begins with |k|^(s-d+2), and a speed of sound is infinite where this tensor has a positive
        eigenvalue, imaginary and infinite where a negative one.

        Parameters
        ----------
        along : ndarray, shape (dim,)
            Direction of the wave, a unit vector.
        part : {'all', 'D0', 'Dstar'}

        Returns
        -------
        ndarray, shape (dim, dim)
            Zero for laws that decay faster.
        """
        if self.decay > self.d:
            return np.zeros((self.dim, self.dim))
        alpha, beta = (f(1.0) for f in self.mixture(part))
        late = 1 / (4 - 2 * (self.d - self.decay)) if self.decay > self.d - 2 else 0.0
        return beta * np.outer(along, along) + late * (alpha * np.eye(self.dim) - 2 * beta * self.across)

    def far_series(self, along, offsets, part='all'):
        """Far stiffness to second order in k = k `along`, each with the phase of its particle, e^{ik.offset}.

        Terms that outgrow k^2 (see `singular`) are left out.

        Returns
        -------
        T : ndarray of complex, shape (3, offsets, dim, dim)
            Of the orders 1, k and k^2.
        """
        alpha, beta = self.mixture(part)
        G = self.waves(np.zeros((1, self.d)))[0]
        g, G2, P, n = G @ along, (G**2).sum(axis=1), self.across, along
        total = np.zeros((3, len(offsets), self.dim, self.dim), dtype=complex)
        for o, offset in enumerate(offsets):
            x = P @ offset
            wide = _Wide(self, G2, x @ x)
            # exp(-p^2/4t) = exp(-G^2/4t) [1 + k g/2t + k^2 (g^2/8t^2 - 1/4t)], and p = G - k n in the gradients
            for order, factors in enumerate((((0, 1.0),), ((-1, g / 2),), ((-1, -0.25), (-2, g**2 / 8)))):
                for power, factor in factors:
                    self._collect(total, o, order, wide, (alpha, beta), power, factor, (G, P, n, x), offset)
        return total

    def _collect(self, total, o, order, wide, mixture, power, factor, geometry, offset):
        """Add `factor t^power k^order` times the polynomial of the gradients, in the orders up to k^2."""
        alpha, beta = mixture
        G, P, n, x = geometry
        phase = np.exp(1j * G @ offset) * factor

        def m(f, extra):  # the term p = 0 only where its integral exists; the others belong to `singular`
            exists = (self.decay - self.d) / 2 + extra + power > 0
            return wide.moment(lambda t: t ** (power + extra) * f(t), power + extra, uniform=exists)

        a, b0 = m(lambda t: alpha(t) / t, 1) * phase, m(beta, 0) * phase
        b1, b2 = m(beta, 1) * phase, m(beta, 2) * phase
        GG, nn, xx = G[:, :, None] * G[:, None], np.outer(n, n), np.outer(x, x)
        Gn, Gx, nx = (A + A.swapaxes(-1, -2) for A in (G[:, :, None] * n, G[:, :, None] * x, np.outer(n, x)))
        zeroth = (a.sum() * np.eye(self.dim) - np.tensordot(b0, GG, 1) - 2 * b1.sum() * P
                  - 2j * np.tensordot(b1, Gx, 1) + 4 * b2.sum() * xx)
        for k, term in enumerate((zeroth, np.tensordot(b0, Gn, 1) + 2j * b1.sum() * nx, -b0.sum() * nn)):
            if order + k <= 2:
                total[order + k, o] += term


class _Wide:
    """Integrals over the wide Gaussians, t from 0 to eta^2, one for each p^2: `int f(t) (pi/t)^{d/2}/V exp(-p^2/4t - t x^2) dt`."""

    def __init__(self, sums, p2, x2):
        self.sums, self.x2 = sums, x2
        algebraic = np.isfinite(sums.decay)
        self.uniform = (p2 < 1e-24 * sums.eta2) & algebraic  # there the integral is algebraic, and done in closed form
        softest = min(np.where(self.uniform, np.inf, p2).min(initial=np.inf), 4 * sums.eta2)
        low = softest if algebraic else softest + sums.law.kappa**2
        low = low / 4 / (REACH + 20)
        if x2 > 0 and algebraic:
            low = min(low, sums.eta2 * np.exp(-80))  # for the rest, algebraic too, that a shift across leaves of the uniform term
        self.t, w = _nodes(low, sums.eta2, 2 * sums.decay if algebraic else 0)
        self.w = w * (np.pi / self.t) ** (sums.d / 2) / sums.volume
        self.gauss = np.exp(-p2[..., None] / (4 * self.t)) * np.exp(-self.t * x2)
        self.gauss[self.uniform] = np.expm1(-self.t * x2)

    def moment(self, f, m, uniform=True):
        """The integral of a function that falls like rho t^m towards t = 0; without the term p = 0 if not `uniform`."""
        sums = self.sums
        result = self.gauss @ (self.w * f(self.t))
        if not self.uniform.any():
            return result
        if not uniform:
            return np.where(self.uniform, 0.0, result)
        exponent = (sums.decay - sums.d) / 2 + m
        if abs(exponent) < 1e-12:
            raise ValueError(f'the sum of r^-{sums.decay:g} over {sums.d} dimensions diverges with the logarithm of the size, '
                             'and no background mends it; choose another exponent, or a number of shells')
        closed = sums.eta2 * f(sums.eta2) * (np.pi / sums.eta2) ** (sums.d / 2) / sums.volume / exponent
        return result + np.where(self.uniform, closed, 0.0)


def _nodes(low, high, power=0):
    """Gauss-Legendre nodes and weights of an integral over t, on panels of equal ratio, narrower for a high power of t."""
    panels = max(1, int(np.ceil(np.log(high / low) / _PANEL * (1 + power / 32))))
    half = np.log(high / low) / panels / 2
    centre = np.log(low) + half * (2 * np.arange(panels) + 1)
    t = np.exp(centre[:, None] + half * _X)
    return t.ravel(), (half * _W * t).ravel()


def points_within(vectors, centre, radius):
    """Points of the lattice of `vectors` (rows) closer than `radius` to `centre`, shape (points, dim)."""
    along = np.linalg.pinv(vectors)
    middle = np.round(centre @ along).astype(int)
    reach = np.floor(radius * np.linalg.norm(along, axis=0)).astype(int) + 1
    steps = np.array(list(product(*(range(m - n, m + n + 1) for m, n in zip(middle, reach, strict=True)))))
    points = steps @ vectors
    return points[((points - centre) ** 2).sum(axis=1) < radius**2]
