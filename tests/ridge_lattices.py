"""Lattices whose ridges are drawn and summed here, without the package: laws of magnets, all neighbours, pillars, noise.

Lengths are in spacings L = 10 mm, stiffness in N/mm, masses in g, angular frequencies in rad/ms.
"""

from dataclasses import dataclass

import numpy as np

L, REACH = 10.0, 30.0
VECTORS = {'triangular': np.array([[1, 0], [0.5, np.sqrt(0.75)]]), 'square': np.eye(2)}
DIRECTIONS = {'triangular': ([0, 1, 0], [1, 0.5, 0]), 'square': ([0, 1, 0], [1, 1, 0])}
POINTS = {'triangular': ([0.5, 0, 0], [2 / 3, 1 / 3, 0]), 'square': ([0.5, 0, 0], [0.5, 0.5, 0])}


def charges(rng, kind):
    """Force of two magnets side by side, from charges on their faces (up to a factor), at complex distances too."""
    size, height = rng.uniform(0.15, 0.42), rng.uniform(0.2, 0.8)
    x, y = size * rng.uniform(-1, 1, (2, 400))
    keep = {'discs': x**2 + y**2 < size**2, 'rings': abs(x**2 + y**2 - 0.7 * size**2) < 0.3 * size**2, 'cubes': x < 2}[kind]
    x, y = x[keep][:70], y[keep][:70]
    dx, dy2 = (x - x[:, None]).ravel(), ((y - y[:, None]) ** 2).ravel()

    def force(r):
        along = r[:, None] + dx
        square = along**2 + dy2
        return (along * (square**-1.5 - (square + height**2) ** -1.5)).sum(axis=1)
    return force


def drawn_law(rng, kind):
    """A force with analytic continuation: of magnets, of powers, or screened."""
    if kind in ('discs', 'rings', 'cubes'):
        return charges(rng, kind)
    a, b, share, decay = rng.uniform(3.2, 6.5), rng.uniform(3.0, 7.0), rng.uniform(0.2, 0.8), 1 / rng.uniform(0.18, 0.45)
    return {'power': lambda r: r**-a, 'two powers': lambda r: share * r**-a + (1 - share) * r**-b,
            'screened': lambda r: (r**-2 + decay / r) * np.exp(-decay * (r - 1))}[kind]


def cantilever(x):
    """Stiffness at the tip of a beam that vibrates, in static ones, from w = w' = 0 and w'' = 0, w = 1 at its ends."""
    z = np.asarray(x, float) ** 0.25
    c, s, C, S, one, none = np.cos(z), np.sin(z), np.cosh(z), np.sinh(z), 1 + 0 * z, 0 * z
    clamped, free = [[one, none, one, none], [none, one, none, one]], [[-c, -s, C, S], [c, s, C, S]]
    shape = np.linalg.solve(np.moveaxis(np.array([*clamped, *free]), (0, 1), (-2, -1)), np.array([0.0, 0, 0, 1])[:, None])[..., 0]
    return -(z**3) / 3 * (s * shape[..., 0] - c * shape[..., 1] + S * shape[..., 2] + C * shape[..., 3])


def shaken_on_rods(atoms, force, omega, damping, rods):
    """Displacements in mm, shape (particles, 2), for a force: rods with these moving masses in g are such cantilevers."""
    n, free = len(atoms), np.setdiff1d(np.arange(len(atoms)), atoms.constraints[0].index)
    free = np.sort([*2 * free, *2 * free + 1])
    H = np.reshape(atoms.calc.get_hessian(atoms).toarray(), (n, 3, n, 3))[:, :2, :, :2].reshape(2 * n, 2 * n)
    k = np.broadcast_to(atoms.calc.foundation, (n, 2))
    x = 3 * 140 / 33 * rods[:, None] * omega**2 / k
    G = H + np.diag((k * (cantilever(x) - 1 + 33 / 420 * x)
                     + (1j * omega * damping - omega**2) * atoms.get_masses()[:, None]).ravel())
    u = np.zeros(2 * n, complex)
    u[free] = np.linalg.solve(G[np.ix_(free, free)], force[:, :2].ravel()[free])
    return u.reshape(n, 2)


@dataclass
class Drawn:
    """A lattice, and the ridges that a bench would find."""

    kind: str
    force: float
    a: float
    k: float
    mass: float
    R: np.ndarray
    shifts: np.ndarray
    stiffness: np.ndarray
    tension: np.ndarray
    pillar: float = 0.0

    @classmethod
    def with_law(cls, kind, law, force, foundation, reach=REACH, mass=0.7):
        """The lattice of a law f(r) that is scaled to a force in N at r = 1; its foundation is in bond stiffnesses."""
        shifts = np.stack(np.meshgrid(*[np.arange(-36, 37)] * 2), axis=-1).reshape(-1, 2)
        r = np.linalg.norm(shifts @ VECTORS[kind], axis=1)
        near = (r > 0) & (r < reach + 1e-6)
        distances, which = np.unique(r[near].round(9), return_inverse=True)
        value = law(np.append(distances, 1.0) + 1e-20j)
        f, slope = force * value.real / value[-1].real, force * value.imag / 1e-20 / value[-1].real
        return cls(kind, force, -slope[-1] / force, -foundation * slope[-1] / L, mass, shifts[near] @ VECTORS[kind], shifts[near],
                   -slope[which] / L, f[which] / r[near] / L)

    @classmethod
    def of(cls, seed, laws=('discs', 'rings', 'cubes', 'power', 'two powers'), reach=REACH, heavy=False):
        """One that is stable, with its law drawn among `laws`, and the generator of its noise; `heavy` pillars have a mass."""
        rng = np.random.default_rng(seed)
        while True:
            kind, law = str(rng.choice([*VECTORS])), drawn_law(rng, str(rng.choice(laws)))
            one = cls.with_law(kind, law, rng.uniform(0.1, 0.4), np.exp(rng.uniform(np.log(0.03), 0)), reach)
            one.pillar = rng.uniform(0.2, 1.5) * one.mass if heavy else 0.0
            ends = one.omega(rng.uniform(0, 1, (200, 3)) * [1, 1, 0])
            if 2.8 < one.a < 7 and ends.min() > 0.05 * np.sqrt(one.k / 0.7) and 3 * one.pillar * ends.max() ** 2 < 150 * one.k:
                return one, rng

    def squares(self, q, springs=(0.0, 0.0)):
        """Eigenvalues of the stiffness of magnets in N/mm, shape (wavevectors, 2), with springs along x and y for pillars."""
        n = self.R / np.linalg.norm(self.R, axis=1)[:, None]
        nn = n[:, :, None] * n[:, None]
        K = self.stiffness[:, None, None] * nn - self.tension[:, None, None] * (np.eye(2) - nn)
        D = np.einsum('bq,bxy->qxy', 1 - np.cos(2 * np.pi * self.shifts @ np.transpose(q)[:2]), K)
        return np.linalg.eigvalsh(D + np.diag(springs))

    def omega(self, q):
        """Frequencies, shape (wavevectors, 2); negative where the lattice is unstable."""
        own = self.squares(np.asarray(q, float))
        if not self.pillar:
            return np.sign(self.k + own) * np.sqrt(abs(self.k + own) / self.mass)
        low, high = np.zeros(own.shape), np.full(own.shape, np.sqrt(200 * self.k / (3 * self.pillar)))
        for _ in range(48):  # mass omega^2 - k(omega) rises with omega
            middle = (low + high) / 2
            soft = self.mass * middle**2 - self.k * cantilever(3 * self.pillar * middle**2 / self.k) < own
            low, high = np.where(soft, middle, low), np.where(soft, high, middle)
        return low

    def ridges(self, rng, modes=(0, 1)):
        """Measured points: columns xi, sigma_xi, q, ridge, omega and sigma_omega, with noise of what they state or less."""
        n, over = rng.integers(10, 41) // len(modes), rng.choice([1.0, 1.0, 2.0, 5.0])
        xi, ridge = rng.uniform(0.4, 2.9, n * len(modes)), np.repeat(np.arange(len(modes)), n)
        q = xi[:, None] / (2 * np.pi) * np.array(DIRECTIONS[self.kind])[rng.integers(0, rng.integers(1, 3), len(xi))]
        sigma_xi = np.exp(rng.uniform(np.log(0.006), np.log(0.04)))
        there = q * (1 + sigma_xi * rng.normal(size=len(xi)) / xi)[:, None]
        omega = self.omega(there)[np.arange(len(xi)), np.array(modes)[ridge]]
        sigma = np.exp(rng.uniform(np.log(2e-4), np.log(3e-3))) * omega
        return xi, over * sigma_xi + 0 * xi, q, ridge, omega + sigma * rng.normal(size=len(xi)), over * sigma
