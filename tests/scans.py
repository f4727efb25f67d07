"""Scans drawn at random, of plane waves on branches written out by hand: what a vibrometer would record, and its truth."""

import numpy as np


def triangular_branches(xi, direction, spacing, mass, tension, stiffness, foundation):
    """Angular frequencies (points, 2), rising, of plane waves along `direction` (degrees) with the phase xi per spacing.

    Each of the three bonds n adds 2 (1 - cos k.n) (stiffness n n - tension (1 - n n)); tension is force/spacing, and zero in the
    conventional model.  Any consistent units.
    """
    k = np.asarray(xi)[:, None] * [np.cos(np.radians(direction)), np.sin(np.radians(direction))]  # times the spacing
    D = np.zeros((len(k), 2, 2)) + foundation * np.eye(2)
    for angle in (0, 60, 120):
        n = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        nn = np.outer(n, n)
        D += 2 * (1 - np.cos(k @ n))[:, None, None] * (stiffness * nn - tension * (np.eye(2) - nn))
    return np.sqrt(np.linalg.eigvalsh(D) / mass)


def packet(t, n, xi, omega, carrier, width, start):
    """A burst along a row: plane waves cos(omega t - xi n) on the branch omega(xi), a Gaussian of `width` about the carrier.

    It leaves n = 0 at the time `start`; shape (times, points).
    """
    within = np.linspace(max(carrier - 3 * width, omega[0]), min(carrier + 3 * width, omega[-1]), 200)[1:-1]
    weights = np.exp(-(((within - carrier) / width) ** 2) / 2)
    phases = np.interp(within, omega, xi)
    waves = np.exp(1j * np.multiply.outer(t - start, within)) * weights
    return (waves @ np.exp(-1j * np.multiply.outer(phases, n))).real / weights.sum()


def scene_text(spacing, mass, b, a, foundation):
    """A scene of the triangular lattice in SI with nothing but a lattice, a law and springs."""
    spacing, mass, b, a, foundation = map(float, (spacing, mass, b, a, foundation))
    return (f'title = "drawn"\n[lattice]\nkind = "triangular"\nspacing_m = {spacing!r}\nmass_kg = {mass!r}\n[law]\n'
            f'kind = "inverse_power"\nb_N_m_a = {b!r}\na = {a!r}\nshells = 1\n[foundation]\nstiffness_N_per_m = {foundation!r}\n')


class Experiment:
    """A lattice like the prototype, and a scan of a burst of each branch along one of its close-packed rows; in mm, g, ms and N.

    It is drawn by `seed`; the noise is a tenth of the largest displacement.
    """

    def __init__(self, seed):
        rng = self.rng = np.random.default_rng(seed)
        self.L, self.m, self.angle = rng.uniform(8, 14), rng.uniform(0.5, 1), rng.choice([0, 60, 120])
        f, a, k = rng.uniform(0.15, 0.4), rng.uniform(3, 5), rng.uniform(0.015, 0.03)
        self.truth = {'force': f, 'a': a, 'foundation': 1e3 * k, 'bond stiffness': 1e3 * a * f / self.L}
        self.xi = np.linspace(0, np.pi, 3001)
        self.omega = triangular_branches(self.xi, self.angle, self.L, self.m, f / self.L, a * f / self.L, k)

    def scene(self, folder, mass=1.0):
        """Where a fit starts: force, exponent and springs some 10 % off."""
        f, a, k = (self.truth[name] * np.exp(0.1 * self.rng.normal()) for name in ('force', 'a', 'foundation'))
        (folder / 'my.toml').write_text(scene_text(1e-3 * self.L, 1e-3 * self.m * mass, f * (1e-3 * self.L) ** a, a, k))
        return folder / 'my.toml'

    def scans(self, points=30, missing=4):
        """Name, times, places and displacements along x and y of each burst; some points are missing."""
        t, n = np.arange(0, 800, 2.0), np.sort(self.rng.permutation(points)[missing:])
        row = np.array([np.cos(np.radians(self.angle)), np.sin(np.radians(self.angle))])
        for mode, (x, y) in enumerate(((-row[1], row[0]), row)):
            omega = self.omega[:, mode]
            carrier = np.interp(self.rng.uniform(0.5, 2.4), self.xi, omega)
            u = packet(t, n, self.xi, omega, carrier, 0.1 * carrier, 150)
            u = 1e-3 * (u / abs(u).max() + 0.1 * self.rng.normal(size=u.shape))
            yield f'0{mode}', t, self.L * n[:, None] * row, u * x, u * y
