"""A device of magnets on rods as it is built, with numpy alone: all pairs, both motions at each port, rest from the feet."""

from dataclasses import dataclass, replace

import numpy as np

EXPONENT, B = 4.5824, 1.6209e-10  # of the prototype's force in N m^a
SPRING, DIAMETER, HEIGHT, DENSITY = 19.6757, 1.5875, 0.15, 2700.0  # of its rods: N/m, mm, m, kg/m3
MAGNET, RAYLEIGH = 7.07e-4, 33 / 140  # kg; share of a rod's mass that moves
ROD = RAYLEIGH * DENSITY * np.pi * (DIAMETER / 2e3) ** 2 * HEIGHT  # kg, the moving mass
FREQUENCIES, PLACES = np.array([60.0, 80.0]), ([-0.04, 0.0], [0.03, 0.03464], [0.03, -0.03464])  # Hz; source and ports in m
LONGEST = 1e-3  # of Newton's steps in m
STEPS = 4  # in which the force is brought on: from the feet Newton's method alone ends on a saddle
REACH = 0.05  # m, of the pairs in copies; beyond it they repel with 1e-3 of the force of the nearest


def cantilever(x):
    """Stiffness of a cantilever at its tip in static ones, x = 3 m omega^2/k with its mass m; zero at its own resonance, 12.4."""
    z = np.maximum(x, 1e-3) ** 0.25
    return z**3 / 3 * (1 + np.cos(z) * np.cosh(z)) / (np.sin(z) * np.cosh(z) - np.cos(z) * np.sinh(z))


@dataclass(frozen=True)
class Device:
    """Feet X in m, masses m in kg, strengths s, springs k in N/m, and which particles the rim holds; or one built copy."""

    X: np.ndarray
    m: np.ndarray
    s: np.ndarray
    k: np.ndarray
    held: np.ndarray
    force: float = 1.0  # factors of the batch's force and of the source's frequency
    frequency: float = 1.0
    damping: float = 4.0  # 1/s
    reach: float = REACH
    rim: float = np.inf  # stiffness of the beams of the rim, in rods
    waves_in_rods: bool = True  # rods have the stiffness of cantilevers at each frequency, not Rayleigh's mass

    @classmethod
    def read(cls, path):
        """The device of a build list."""
        x, y, m, s, k, held = np.loadtxt(path, delimiter=',', skiprows=1).T
        return cls(np.stack([x, y], axis=1), m, s, k, held > 0.5)

    def copy(self, rng, *, force, frequency, strength, spring, foot, batch=0.0, damping=0.0):
        """A copy with these standard deviations, in percent, of feet along each axis in mm.

        Those of force, frequency, `batch` (all rods) and `damping` (of its logarithm) are common to the copy.
        """
        n = len(self.m)
        strengths, springs, feet, common = rng.normal(size=n), rng.normal(size=n), rng.normal(size=(n, 2)), rng.normal(size=4)
        return replace(self, X=self.X + foot / 1e3 * feet, s=self.s * np.exp(strength / 100 * strengths),
                       k=self.k * np.exp((spring * springs + batch * common[2]) / 100), force=np.exp(force / 100 * common[0]),
                       frequency=np.exp(frequency / 100 * common[1]), damping=self.damping * np.exp(damping * common[3]))

    @property
    def places(self):
        """The source and both ports; feet were designed within 1.5 mm of them."""
        at = np.where(self.held[:, None], np.inf, self.X)
        return [int(np.hypot(*(at - place).T).argmin()) for place in PLACES]

    def pushed(self, x, pairs, share=1.0):
        """Forces on all magnets, shape (n, 2), and their stiffness, shape (2 n, 2 n)."""
        (i, j), n = pairs, len(x)
        R = x[i] - x[j]
        r = np.linalg.norm(R, axis=1)
        f = share * self.force * B * self.s[i] * self.s[j] * r**-EXPONENT
        e = R / r[:, None]
        ee = np.einsum('bx,by->bxy', e, e)
        D = (f / r)[:, None, None] * ((EXPONENT + 1) * ee - np.eye(2))  # D0 + D*
        F, H = np.zeros((n, 2)), np.zeros((n, n, 2, 2))
        for a, c, sign in ((i, j, 1), (j, i, -1)):
            np.add.at(F, a, sign * f[:, None] * e)
            np.add.at(H, (a, a), D)
            H[a, c] = -D
        return F, H.transpose(0, 2, 1, 3).reshape(2 * n, 2 * n)

    def stiffness(self):
        """The static stiffness at rest of what moves, its springs, and which of all coordinates these are."""
        held = self.held & np.isinf(self.rim)
        k = np.where(self.held, self.rim * SPRING if np.isfinite(self.rim) else self.k, self.k)
        free, x = np.flatnonzero(np.repeat(~held, 2)), self.X.copy()
        pairs = np.nonzero(np.triu(np.linalg.norm(self.X[:, None] - self.X, axis=2) < self.reach, 1))
        inside, springs = np.ix_(free, free), np.diag(np.repeat(k, 2)[free])
        for share in np.arange(1, STEPS + 1) / STEPS:
            for _ in range(50):
                F, H = self.pushed(x, pairs, share)
                step = np.linalg.solve(H[inside] + springs, (F - k[:, None] * (x - self.X)).ravel()[free])
                x.ravel()[free] += step * min(1, LONGEST / abs(step).max())
                if abs(step).max() < (1e-13 if share == 1 else 1e-5):
                    break
            else:
                raise ValueError('no rest was found')
        K = self.pushed(x, pairs)[1][inside] + springs
        np.linalg.cholesky(K)  # it is stable
        return K, free

    def moving(self, omega):
        """What the motion at frequencies in rad/s adds to the static stiffness of each coordinate, shape (frequencies, 2 n)."""
        omega, k = np.reshape(omega, (-1, 1)), np.where(self.held, 1.0, self.k)
        m = ROD / RAYLEIGH * (k / SPRING) ** 0.5  # as the cross-section of the rod: k goes with its square
        beside = k * cantilever(3 * m * omega**2 / k) - k + RAYLEIGH * m * omega**2
        return np.repeat((1j * self.damping * omega - omega**2) * self.m + self.waves_in_rods * ~self.held * beside, 2, axis=1)

    def responses(self, hertz):
        """Displacements of both ports in m/N, shape (frequencies, 2 ports, 2 directions), for a force along x at the source."""
        K, free = self.stiffness()
        source, *ports = ([np.searchsorted(free, 2 * place + x) for x in (0, 1)] for place in self.places)
        each = self.moving(2 * np.pi * np.asarray(hertz))[:, free]
        return np.array([np.linalg.solve(K + np.diag(one), np.eye(len(K))[source[0]])[ports] for one in each])

    def decibels(self):
        """How much more energy the wanted port has, at 60 Hz the first and at 80 Hz the second."""
        energy = (abs(self.responses(self.frequency * FREQUENCIES)) ** 2).sum(2)
        return 10 * np.log10(energy[:, 0] / energy[:, 1]) * [1, -1]
