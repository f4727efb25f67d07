"""Plane waves of lattices summed pair by pair, and where they first buckle: an oracle without the package's bonds or matrices."""

from functools import cache

import numpy as np


class PlaneWaves:
    """Stiffness of plane waves among particles that repel by f = r^-a, summed pair by pair.

    Parameters
    ----------
    periods : ndarray, shape (periodic, dim)
        Lattice vectors in rows.
    sites : ndarray, shape (particles, dim)
    a : float
    cutoff : float, optional
        Without it every pair counts, of one particle per cell in the plane: a sum up to a soft edge and an integral beyond.
    """

    def __init__(self, periods, sites, a, cutoff=None):
        self.periods, self.n, self.a = np.array(periods), len(sites), a
        self.everything = cutoff is None
        reach = 15.0 if self.everything else cutoff
        along = np.linalg.norm(np.linalg.pinv(self.periods), axis=0)
        images = [np.arange(-m, m + 1) for m in np.ceil((reach + 3) * along).astype(int)]
        R = np.stack(np.meshgrid(*images, indexing='ij'), axis=-1).reshape(-1, len(self.periods)) @ self.periods
        x = R[:, None, None] + sites - sites[:, None]
        r = np.linalg.norm(x, axis=-1)
        cell, self.i, self.j = np.nonzero((r < reach) & (r > 1e-9))
        self.x = x[cell, self.i, self.j]
        r = np.linalg.norm(self.x, axis=1)[:, None, None]
        nn = self.x[:, :, None] * self.x[:, None, :] / r**2
        self.K = r ** (-a - 1) * ((a + 1) * nn - np.eye(self.x.shape[1])) * (self._edge(r) if self.everything else 1)

    @staticmethod
    def _edge(r):
        """From 1 to 0 round r = 8, 1.6 wide: its waves shorter than a spacing are e^-(1.6 pi)^2 = 1e-11."""
        from scipy.special import erfc

        return erfc((r - 8) / 1.6) / 2

    def matrices(self, k):
        """At Cartesian wavevectors k, shape (..., dim), matrices of the shape (..., particles * dim, particles * dim)."""
        dim = self.x.shape[1]
        D = np.zeros((*k.shape[:-1], self.n, dim, self.n, dim), dtype=complex)
        phase = np.exp(1j * k @ self.x.T)
        for i, j in np.ndindex(self.n, self.n):
            here = (self.i == i) & (self.j == j)
            D[..., i, :, i, :] += self.K[here].sum(axis=0)
            D[..., i, :, j, :] -= np.tensordot(phase[..., here], self.K[here], axes=1)
        D = D.reshape(*k.shape[:-1], self.n * dim, self.n * dim)
        return D + self._beyond(k) if self.everything else D

    def _beyond(self, k):
        """What the edge leaves out, an integral over the plane: e^{ik.r} has the mean J0, n n e^{ik.r} J0/2 - J2 (k k - 1/2)."""
        size = np.linalg.norm(k, axis=-1)[..., None, None]
        flat, turned = np.moveaxis(_beyond_the_edge(self.a)(np.log(size)), -1, 0) * size**2
        axis = 2 * k[..., :, None] * k[..., None, :] / size**2 - np.eye(2)
        total = (self.a - 1) / 2 * flat * np.eye(2) + (self.a + 1) / 2 * turned * axis
        return 2 * np.pi / abs(np.linalg.det(self.periods)) * total


@cache
def _beyond_the_edge(a):
    """Integrals of r^-a times 1 - J0(kr) and J2(kr) beyond the edge, over k^2, as a spline over log k."""
    from scipy.interpolate import CubicSpline
    from scipy.special import j0, jv

    k = np.geomspace(1e-4, 30, 3000)
    x, w = np.polynomial.legendre.leggauss(300)
    r = 8 + 7 * x  # from 1 to 15, where the edge is over
    w = 7 * w * (1 - PlaneWaves._edge(r)) * r**-a
    soft = np.stack([(1 - j0(k[:, None] * r)) @ w, jv(2, k[:, None] * r) @ w], axis=1)
    # and from there on, k^(a - 1) times the integral of u^-a (1 - J0(u)), of u^-a J2(u) from u = 15 k to infinity
    edges = np.append(15 * k, np.arange(15 * k[-1], 1500, 0.5)[1:])
    x, w = np.polynomial.legendre.leggauss(8)
    half = np.diff(edges)[:, None] / 2
    u = edges[:-1, None] + half * (1 + x)
    panels = np.stack([1 - j0(u), jv(2, u)]) * u**-a @ w * half[:, 0]
    beyond = np.cumsum(panels[:, ::-1], axis=1)[:, ::-1].T[: len(k)]
    beyond[:, 0] += edges[-1] ** (1 - a) / (a - 1)
    return CubicSpline(np.log(k), (soft + k[:, None] ** (a - 1) * beyond) / k[:, None] ** 2)


def margin(waves, at=None, polish=True):
    """The least `D(k)/s(k)` of a lattice, negative if any wave is unstable, and the wavevector there; or that of one wave.

    s = sum over the lattice vectors a_i of (2 - 2 cos k.a_i)/a_i^2 vanishes as k^2 where translations make D vanish, so that
    a shallow pocket around k = 0 is as visible as any other.
    """
    periods, dim = waves.periods, len(waves.periods)

    least = 3e-4 * np.linalg.norm(2 * np.pi * np.linalg.pinv(periods), axis=0).min()

    def ratio(k):
        k = k * np.maximum(1, least / np.linalg.norm(k, axis=-1, keepdims=True))  # constant from there to k = 0
        s = ((2 - 2 * np.cos(k @ periods.T)) / (periods**2).sum(axis=1)).sum(axis=-1)
        # at other reciprocal vectors both vanish: no wave is there that is not at k = 0
        return np.where(s > 0.1 * least**2, np.linalg.eigvalsh(waves.matrices(k))[..., 0] / np.maximum(s, 1e-300), 1e3)

    if at is not None:
        return ratio(at[None])[0], at
    reciprocal = 2 * np.pi * np.linalg.pinv(periods).T
    n = np.random.default_rng(0).normal(size=({1: 1, 2: 120, 3: 300}[dim], dim)) @ np.linalg.qr(reciprocal.T)[0].T
    n /= np.linalg.norm(n, axis=1, keepdims=True)
    radii = np.geomspace(1e-3, 0.1, 5) * np.linalg.norm(reciprocal, axis=1).min()
    k = np.concatenate([_mesh(periods), (radii[:, None, None] * n).reshape(-1, n.shape[1])])
    if polish:
        return polished(ratio, k, periods)
    values = ratio(k)
    return values.min(), k[values.argmin()]


def _mesh(periods):
    """Wavevectors all over the zone but 0."""
    dim = len(periods)
    q = np.stack(np.meshgrid(*[np.linspace(0, 1, {1: 100, 2: 24, 3: 10}[dim], endpoint=False)] * dim, indexing='ij'), axis=-1)
    return q.reshape(-1, dim)[1:] @ (2 * np.pi * np.linalg.pinv(periods).T)


def depth(waves, near):
    """Minus the lowest eigenvalue of any wave: the lowest of a mesh and of the line through k = 0 and `near`, polished."""
    outwards = near * np.geomspace(1, 300, 40)[:, None]
    return -polished(lambda k: np.linalg.eigvalsh(waves.matrices(k))[..., 0], np.concatenate([_mesh(waves.periods), outwards]),
                     waves.periods)[0]


def polished(f, k, periods, best=3):
    """The least value of f, from the lowest of the points k, and where."""
    from scipy.optimize import minimize

    axes = np.linalg.qr(periods.T)[0].T
    values = f(k)
    found = []
    for start in k[np.argsort(values)[:best]]:
        x = start @ axes.T
        simplex = np.concatenate([[x], x + 0.1 * np.linalg.norm(x) * np.eye(len(x))])
        end = minimize(lambda x: f(x[None] @ axes)[0], x, method='Nelder-Mead',
                       options={'initial_simplex': simplex, 'xatol': 1e-6, 'fatol': 1e-13, 'maxiter': 400})
        found.append((end.fun, end.x @ axes))
    return min(found, key=lambda pair: pair[0])
