"""Laws, lattices and oracles that several tests share; no oracle uses magphonon's derivatives or its bonds."""

from itertools import product

import numpy as np
from ase import Atoms

from magphonon import InversePower, Tabulated, Yukawa, lattices
from magphonon import units as u
from magphonon.potentials import Hertz

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
    'spheres': Hertz(stiffness=0.01, diameter=60.0),
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


def gradient(energy, x0, radius=0.5):
    """First derivatives of an analytic `energy(x)` at x0, likewise: E' = sum E(x0 + h e^{it} d) e^{-it}/(N h)."""
    circle = np.exp(2j * np.pi * np.arange(48) / 48)
    return np.array([(np.mean(energy(x0 + radius * circle[:, None] * d) / circle) / radius).real for d in np.eye(len(x0))])


def length(d):
    """|d| of complex vectors, analytic: no absolute values."""
    return np.sqrt((d * d).sum(axis=-1))


class Energy:
    """Energy of a structure from brute-force neighbours, analytic in the displacements u, shape (..., particles * dim)."""

    def __init__(self, atoms, law, reach=10.1, k=0.0):
        self.dim = 3 if atoms.pbc.all() else 2
        pairs = [(i, j, v) for i, j, _, v in neighbour_vectors(atoms, reach)]  # each bond twice, from both ends
        self.i, self.j = np.array([p[:2] for p in pairs]).T
        self.R = np.array([p[2][: self.dim] for p in pairs])
        self.law, self.k, self.shape = law, k, (len(atoms), self.dim)

    def _bonds(self, u):
        u = u.reshape(*u.shape[:-1], *self.shape)
        return u[..., self.j, :] - u[..., self.i, :]

    def _foundation(self, u):
        return self.k * (u * u).sum(axis=-1) / 2

    def complete(self, u):
        r0 = np.linalg.norm(self.R, axis=1)
        phi = self.law.phi(length(self.R + self._bonds(u))) - self.law.phi(r0)
        return phi.sum(axis=-1) / 2 + self._foundation(u)

    def frozen(self, u, about):
        """With bond directions frozen as they are at the displacement `about`."""
        R = self.R + self._bonds(about)
        r = np.linalg.norm(R, axis=1)
        elongation = ((R / r[:, None]) * self._bonds(u - about)).sum(axis=-1)
        return (self.law.phi(r + elongation) - self.law.phi(r)).sum(axis=-1) / 2

    def constant_force(self, u, about):
        """With bond forces frozen as they are at the displacement `about`."""
        R = self.R + self._bonds(about)
        r = np.linalg.norm(R, axis=1)
        return (self.law.dphi(r) * (length(R + self._bonds(u - about)) - r)).sum(axis=-1) / 2


def displaced(name, seed=3, amplitude=0.3):
    """A small supercell and displacements of 3 % of the spacing from its rest positions, in the plane if it is planar."""
    cell = lattice(name)
    rest = cell.repeat(np.where(cell.pbc, 2, 1))
    u = np.random.default_rng(seed).uniform(-amplitude, amplitude, (len(rest), 3 if cell.pbc.all() else 2))
    atoms = rest.copy()
    atoms.positions[:, : u.shape[1]] += u
    return rest, atoms, u.ravel()


def in_plane(H, dim):
    """The entries of a Hessian of 3 components per particle that belong to the first `dim`."""
    keep = np.flatnonzero(np.tile(np.arange(3) < dim, H.shape[0] // 3))
    return H.toarray()[np.ix_(keep, keep)]


def small_cluster(seed=1, n=9, spacing=10.0):
    """A loose irregular cluster in the plane, no two particles closer than 0.7 spacings."""
    rng = np.random.default_rng(seed)
    grid = spacing * np.array(list(product(range(3), range(-(-n // 3)))))[:n]
    points = np.zeros((n, 3))
    points[:, :2] = grid + rng.uniform(-0.15, 0.15, (n, 2)) * spacing
    return Atoms(['Nd'] * n, positions=points, masses=rng.uniform(0.5, 1.5, n))


def verlet(atoms, law, dt, steps, *, bonds, foundation=0.0, model='complete', damping=0.0, drive=None, velocities=None):
    """Displacements and velocities after velocity Verlet with textbook pair forces: the oracle of every engine.

    One step is half the decay, half the kick of the drive, velocity Verlet, half a kick, half a decay, each spelled out in the
    order of the formula.  FixAtoms holds, FixedLine and FixedPlane take away the velocity that they bar.

    Parameters
    ----------
    atoms : ase.Atoms
        At rest; its positions are the anchors.
    bonds : tuple of i, j and R
        Each pair once, R the vector from i to j at rest, shape (bonds, 2).
    drive : callable, optional
        From the time to forces, shape (particles, 2).
    velocities : ndarray, shape (particles, 2)
    """
    i, j, R = bonds
    r0 = np.linalg.norm(R, axis=1)
    n0 = R / r0[:, None]
    mass = atoms.get_masses()[:, None]
    decay = np.exp(-np.broadcast_to(damping, len(atoms)) * dt / 2)[:, None]
    allowed = np.tile(np.eye(2), (len(atoms), 1, 1))
    for constraint in atoms.constraints:
        d = getattr(constraint, 'dir', np.zeros(3))[:2]
        along = np.outer(d, d)
        allowed[constraint.index] = {'FixAtoms': 0 * along, 'FixedLine': along, 'FixedPlane': np.eye(2) - along}[
            type(constraint).__name__]

    def project(v):
        return np.einsum('ixy,iy->ix', allowed, v)

    def force(u, t):
        bond = R + u[j] - u[i]
        r = np.linalg.norm(bond, axis=1) if model != 'conventional' else r0 + ((u[j] - u[i]) * n0).sum(axis=1)
        pull = -law.dphi(r)[:, None] * (bond / r[:, None] if model == 'complete' else n0)
        f = -foundation * u
        for x in range(2):
            f[:, x] += np.bincount(j, pull[:, x], len(u)) - np.bincount(i, pull[:, x], len(u))
        return f + (0 if drive is None else drive(t))

    u = np.zeros((len(atoms), 2))
    v = project(np.array(velocities, float))
    for step in range(steps):
        v = decay * v + project(dt / 2 * force(u, step * dt) / mass)
        u = u + dt * v
        v = decay * (v + project(dt / 2 * force(u, (step + 1) * dt) / mass))
    return u, v
