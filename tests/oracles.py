"""Laws, lattices and oracles that several tests share; no oracle uses magphonon's derivatives or its bonds."""

from itertools import product

import numpy as np
from ase import Atoms

from magphonon import InversePower, Tabulated, Yukawa, lattices
from magphonon import units as u

LATTICES = ('chain', 'square', 'triangular', 'honeycomb', 'kagome', 'fcc', 'bcc')


class Gaussian:
    """A law that magphonon does not know and that inherits nothing: phi = exp(-(r/s)^2/2)."""

    width = 8.0

    def phi(self, r):
        return np.exp(-((r / self.width) ** 2) / 2)

    def dphi(self, r):
        return -r / self.width**2 * self.phi(r)

    def d2phi(self, r):
        return (r**2 / self.width**2 - 1) / self.width**2 * self.phi(r)


TABLE = np.array([3.0, 5.0, 7.5, 14.0, 20.0, 30.0, 45.0])  # the nearest neighbours, at 10, lie well inside an interval
LAWS = {
    'magnets': InversePower(b=6200.0, a=4.5824),
    'logarithm': InversePower(b=3.0, a=1.0),
    'steep': InversePower(b=1e12, a=12.0),
    'dipoles': InversePower.dipoles(moment=500 * u.A * u.mm**2),
    'yukawa': Yukawa(c=20.0, kappa=0.3),
    'table': Tabulated(TABLE, 4000 * TABLE**-4.0 * (1 + 0.3 * np.sin(TABLE / 4))),
    'foreign': Gaussian(),
}


def lattice(name, spacing=10.0, mass=0.7):
    """A cell by name: one of magphonon's planar ones, or a cubic one, which shows the third dimension."""
    if name == 'fcc':
        rows = np.array([[0, 1, 1], [1, 0, 1], [1, 1, 0]]) / np.sqrt(2)
    elif name == 'bcc':
        rows = np.array([[-1, 1, 1], [1, -1, 1], [1, 1, -1]]) / np.sqrt(3)
    else:
        return getattr(lattices, name)(spacing, mass)
    return Atoms('Nd', positions=[[0, 0, 0]], masses=[mass], cell=spacing * rows, pbc=True)


def neighbour_vectors(atoms, reach):
    """Every ordered pair closer than `reach`, by brute force over the images: i, j, cell of j, vector from i to j."""
    cells = [range(-4, 5) if periodic else (0,) for periodic in atoms.pbc]
    for cell in product(*cells):
        vectors = atoms.positions + np.array(cell) @ atoms.cell.array - atoms.positions[:, None]
        for i, j in np.argwhere(np.linalg.norm(vectors, axis=2) < reach):
            if i != j or any(cell):
                yield int(i), int(j), cell, vectors[i, j]


def second_derivatives(energy, x0, radius=0.5):
    """Second derivatives of an analytic `energy(x)` at x0: the complex step carried round a circle.

    By Cauchy's formula E'' along a direction d is 2/(N h^2) sum E(x0 + h e^{it} d) e^{-2it}, and the mixed ones follow
    from E_ij = (E_{i+j} - E_{i-j})/4.  With N = 48 points the error is (2 h/distance to contact)^48: none.  What remains is
    the round-off of E over E'' h^2, about 1e-13, and h need not be small.

    Parameters
    ----------
    energy : callable
        From complex displacements, shape (..., n), to complex energies, shape (...).
    x0 : ndarray, shape (n,)
    radius : float
        h, in mm.

    Returns
    -------
    ndarray, shape (n, n)
    """
    circle = np.exp(2j * np.pi * np.arange(48) / 48)
    n = len(x0)

    def along(d):
        return (2 * np.mean(energy(x0 + radius * circle[:, None] * d) * circle**-2) / radius**2).real

    unit = np.eye(n)
    H = np.empty((n, n))
    for i in range(n):
        H[i, i] = along(unit[i])
        for j in range(i):
            H[i, j] = H[j, i] = (along(unit[i] + unit[j]) - along(unit[i] - unit[j])) / 4
    return H


def small_cluster(seed=1, n=9, spacing=10.0):
    """A loose irregular cluster in the plane, no two particles closer than 0.7 spacings."""
    rng = np.random.default_rng(seed)
    grid = spacing * np.array(list(product(range(3), range(-(-n // 3)))))[:n]
    points = np.zeros((n, 3))
    points[:, :2] = grid + rng.uniform(-0.15, 0.15, (n, 2)) * spacing
    return Atoms(['Nd'] * n, positions=points, masses=rng.uniform(0.5, 1.5, n))
