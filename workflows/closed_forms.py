"""Closed forms of the paper's lattices, written out by hand in SI. It imports nothing of the package.

A bond along n carries the repulsion f at the distance L, and -df/dr = a f/L for an inverse power r^-a. Its stiffness, Eq. 3 of
the paper with the sign of a repulsion, is `f/L [a n(x)n - (1 - n(x)n)]`: D0 is the first term, D* the second.
"""

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Magnets:
    """What the paper prints: the constants of f = b r^-a, spacing, mass, and the stiffness of the ground in N/m."""

    b: float
    a: float
    L: float
    mass: float
    ground: float = 0.0

    @property
    def slope(self):
        """The unit of stiffness f/L in N/m."""
        return self.b * self.L ** (-self.a - 1)


IDEAL = Magnets(b=1e4, a=4.0, L=1.0, mass=1.0)  # Secs. III and IV
PILLAR = 3 * 71e9 * (np.pi / 4 * 7.9375e-4**4) / 0.15**3  # 3 E I/H^3 of the Supplement
PROTOTYPE = Magnets(b=1.6209e-10, a=4.5824, L=0.01, mass=7.07e-4, ground=PILLAR)


def bond(magnets, angle, dstar=True):
    """Stiffness in N/m of a bond at an angle to x, shape (2, 2), with D* or without."""
    n = np.array([np.cos(angle), np.sin(angle)])
    nn = np.outer(n, n)
    return magnets.slope * (magnets.a * nn - dstar * (np.eye(2) - nn))


def oscillator(theta0, dstar=True, magnets=IDEAL):
    """Stiffness of the magnet above three others, at the angles theta0, 90 degrees and 180 degrees - theta0 below it."""
    return sum(bond(magnets, angle, dstar) for angle in (-theta0, -np.pi / 2, np.pi + theta0))


def receptance(theta0, omega, damping, dstar=True, magnets=IDEAL):
    """Vertical displacement per force in m/N at frequencies in rad/s; damping in 1/s."""
    return 1 / (oscillator(theta0, dstar, magnets)[1, 1] + magnets.mass * (1j * damping * omega - omega**2))


def triangular(magnets, k1, k2, dstar=True):
    """Squared frequencies in rad^2/s^2, ascending along the last axis, at the phases k1 along R1 and k2 along R2."""
    k1, k2 = np.broadcast_arrays(k1, k2)
    D = magnets.ground * np.eye(2)
    for phase, angle in ((k1, 0.0), (k2, np.pi / 3), (k2 - k1, 2 * np.pi / 3)):
        D = D + 2 * (1 - np.cos(phase))[..., None, None] * bond(magnets, angle, dstar)
    return np.linalg.eigvalsh(D) / magnets.mass


LINES = {'row': (0.0, 1.0), 'point': (0.5, 1.0)}
"""Phases along R1 and R2, in xi, of waves along the measured row: Gamma-M behind a row of sources, Gamma-K from a point."""


def along_the_row(magnets, source, xi, dstar=True):
    """Frequencies in rad/s of shear and longitudinal waves that a row of magnets sees with the phase xi from step to step."""
    c1, c2 = LINES[source]
    return np.sqrt(triangular(magnets, c1 * xi, c2 * xi, dstar))


def decay_below_cutoff(magnets, omega, dstar=True):
    """Decay from row to row of shear waves of Gamma-M, whose square is `k + 2 (a - 3) f/L sin^2(xi/2)`; D0 has 2 a f/L."""
    bend = 2 * (magnets.a - 3 * dstar) * magnets.slope
    return 2 * np.arcsinh(np.sqrt((magnets.ground - magnets.mass * omega**2) / bend))


# ------------------------------------------------------------------------------- small programs, where there is no closed form
def gyrating_honeycomb(a, k, g, q, dstar=True):
    """Hermitian matrices with the frequencies of a honeycomb of gyrating magnets, in units of f, L and m, shape (..., 8, 8).

    `u'' = -D u + g J u'` with a quarter turn J is `i (S u, u')' = H (S u, u')` with S^2 = D. The four upper eigenvalues are the
    frequencies at the wavevector q, given in fractions of the reciprocal vectors.
    """
    unit = Magnets(b=1.0, a=a, L=1.0, mass=1.0)
    bonds = np.array([bond(unit, angle, dstar) for angle in np.deg2rad((30, 150, 270))])  # the last two lead to other cells
    phases = np.exp(-2j * np.pi * np.insert(q, 0, 0.0, axis=-1))
    D = np.kron(np.eye(2), bonds.sum(axis=0) + k * np.eye(2)) + np.zeros((*q.shape[:-1], 1, 1), complex)
    D[..., :2, 2:] = -np.einsum('...b,bxy->...xy', phases, bonds)
    D[..., 2:, :2] = D[..., :2, 2:].conj().swapaxes(-1, -2)
    squares, shapes = np.linalg.eigh(D)
    S = shapes * np.sqrt(squares)[..., None, :] @ shapes.conj().swapaxes(-1, -2)
    H = np.zeros((*q.shape[:-1], 8, 8), complex)
    H[..., :4, 4:], H[..., 4:, :4] = 1j * S, -1j * S
    H[..., 4:, 4:] = 1j * g * np.kron(np.eye(2), [[0, 1], [-1, 0]])
    return H


def mesh(n):
    """Wavevectors of the whole zone, shape (n, n, 2)."""
    return np.stack(np.meshgrid(np.arange(n) / n, np.arange(n) / n, indexing='ij'), axis=-1)


def middle_gap(a, k, g, dstar=True, n=60):
    """Ends of the gap between the second and the third band of the gyrating honeycomb."""
    omega = np.linalg.eigvalsh(gyrating_honeycomb(a, k, g, mesh(n), dstar))[..., 4:]
    return omega[..., 1].max(), omega[..., 2].min()


def chern(a, k, g, dstar=True, n=24):
    """Chern numbers of its four bands, by the phases around the plaquettes of a mesh (Fukui, Hatsugai and Suzuki)."""
    v = np.linalg.eigh(gyrating_honeycomb(a, k, g, mesh(n), dstar))[1][..., 4:]
    one, two = ((v.conj() * np.roll(v, -1, axis)).sum(axis=2) for axis in (0, 1))
    around = np.angle(one * np.roll(two, -1, 0) * np.roll(one, -1, 1).conj() * two.conj())
    return around.sum(axis=(0, 1)) / (2 * np.pi)


def plasma_layer(kappa, q, reach=40):
    """Squared longitudinal frequency of a triangular Yukawa crystal, and drop of that out of the plane, by lattice sums.

    The unit is Q^2/(4 pi eps0 m a^3); wavevectors are fractions of the reciprocal vectors.
    """
    n = mesh(2 * reach + 1).reshape(-1, 2) * (2 * reach + 1) - reach
    n = n[(n != 0).any(axis=1)]
    R = n @ [[1, 0], [0.5, np.sqrt(0.75)]]
    r = np.linalg.norm(R, axis=1)
    force, stiff = (np.exp(-kappa * r) * part for part in ((1 + kappa * r) / r**2, (2 + 2 * kappa * r + (kappa * r) ** 2) / r**3))
    nn = R[:, :, None] * R[:, None] / r[:, None, None] ** 2
    bonds = stiff[:, None, None] * nn - (force / r)[:, None, None] * (np.eye(2) - nn)
    moved = 1 - np.cos(2 * np.pi * np.asarray(q) @ n.T)
    return np.linalg.eigvalsh(np.tensordot(moved, bonds, axes=1))[..., 1], moved @ (force / r)


def hole_in_honeycomb(magnets, ground, relative=(1.0, 1.5), cells=10):
    """Frequencies in Hz of a periodic honeycomb patch of two masses with a light magnet missing, all others at rest again.

    Bonds are those of the perfect lattice; each magnet has a spring of the stiffness `ground` at its place there.
    """
    A = magnets.L * np.array([[np.sqrt(3), 0], [np.sqrt(3) / 2, 1.5]])
    cell = np.array([(i, j) for i in range(cells) for j in range(cells)])
    x = (cell @ A)[:, None] + magnets.L * np.array([[0, 0], [np.sqrt(3) / 2, 0.5]])
    mass = np.delete(np.tile(relative, len(x)), 0) * magnets.mass
    x = np.delete(x.reshape(-1, 2), 0, axis=0)
    i, j = np.triu_indices(len(x), 1)
    apart = (x[j] - x[i]) @ np.linalg.inv(cells * A)
    R = (apart - np.round(apart)) @ (cells * A)
    near = np.linalg.norm(R, axis=1) < 1.1 * magnets.L
    i, j, R, u = i[near], j[near], R[near], np.zeros_like(x)
    for _ in range(8):  # Newton's method for the rest
        bent = R + u[j] - u[i]
        r = np.linalg.norm(bent, axis=1)
        force, nn = magnets.b * r**-magnets.a, bent[:, :, None] * bent[:, None] / r[:, None, None] ** 2
        K = np.zeros((len(x), 2, len(x), 2))
        bonds = (force / r)[:, None, None] * (magnets.a * nn - (np.eye(2) - nn))
        push = -ground * u
        for a, b, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            np.add.at(K, (a, slice(None), b), sign * bonds)
        np.add.at(push, j, (force / r)[:, None] * bent)
        np.add.at(push, i, -(force / r)[:, None] * bent)
        K = K.reshape(push.size, push.size) + ground * np.eye(push.size)
        u = u + np.linalg.solve(K, push.ravel()).reshape(u.shape)
    root = np.repeat(np.sqrt(mass), 2)
    return np.sqrt(np.linalg.eigvalsh(K / np.outer(root, root))) / (2 * np.pi)
