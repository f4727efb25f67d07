"""Closed forms of the paper's lattices, written out by hand in SI. It imports nothing of the package: what agrees with it is shown.

A bond along n carries the repulsion f at the distance L, and -df/dr = a f/L for an inverse power r^-a. Its stiffness, Eq. 3 of the
paper with the sign of a repulsion, is `f/L [a n(x)n - (1 - n(x)n)]`: D0 is the first term, D* the second.
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
