"""Laws, lattices and oracles that several tests share; no oracle uses magphonon's derivatives or its bonds."""

from itertools import product

import numpy as np
from ase import Atoms

from magphonon import InversePower, lattices, units as u
from magphonon.interactions import Tabulated, Yukawa
from magphonon.interactions.pair_laws import Overlap

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
    'spheres': Overlap(energy=0.01 * 17**2.5, power=2.5, diameter=17.0),
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


def neighbour_vectors(atoms, reach, images=4):
    """Every ordered pair closer than `reach`, by brute force over the images: i, j, cell of j, vector from i to j."""
    cells = np.array(list(product(*(range(-images, images + 1) if periodic else (0,) for periodic in atoms.pbc))))
    shifts = cells @ atoms.cell.array
    near = np.linalg.norm(shifts, axis=1) < reach + np.linalg.norm(np.ptp(atoms.positions, axis=0))
    for cell, shift in zip(map(tuple, cells[near].tolist()), shifts[near], strict=True):
        vectors = atoms.positions + shift - atoms.positions[:, None]
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


def allowed_motion(atoms, dim):
    """Projectors on what FixAtoms, FixCartesian, FixedLine and FixedPlane leave to each particle, shape (particles, dim, dim)."""
    allowed = np.tile(np.eye(dim), (len(atoms), 1, 1))
    for constraint in atoms.constraints:
        d = getattr(constraint, 'dir', np.zeros(3))[:dim]
        along = np.outer(d, d)
        blocked = getattr(constraint, 'mask', np.zeros(3))[:dim]
        own = {'FixAtoms': 0 * along, 'FixedLine': along, 'FixedPlane': np.eye(dim) - along,
               'FixCartesian': np.diag(1.0 - blocked)}[type(constraint).__name__]
        allowed[constraint.index] = own @ allowed[constraint.index]
    return allowed


def free_basis(atoms, dim):
    """Orthonormal columns that span what the constraints allow, shape (particles * dim, free)."""
    allowed = allowed_motion(atoms, dim)
    B = np.zeros((len(atoms), dim, len(atoms), dim))
    B[np.arange(len(atoms)), :, np.arange(len(atoms))] = allowed
    axes, size, _ = np.linalg.svd(B.reshape(len(atoms) * dim, -1))
    return axes[:, size > 0.5]


class OwnLaws:
    """The energy of each pair: `s_i s_j phi(r)`, with the law phi of the kinds of i and j.

    Parameters
    ----------
    laws : dict
        From sets of kinds to laws.
    kinds, strengths : ndarray, shape (particles,)
    i, j : ndarray of int, shape (pairs,)
    """

    def __init__(self, laws, kinds, strengths, i, j):
        own = [laws[frozenset(pair)] for pair in zip(kinds[i].tolist(), kinds[j].tolist(), strict=True)]
        self.strengths = strengths[i] * strengths[j]
        self.each = [(law, np.array([one is law for one in own])) for law in set(own)]

    def of_each(self, name, r):
        """`phi` or `dphi` at distances whose last axis is that of the pairs."""
        found = np.empty_like(r)
        for law, own in self.each:
            found[..., own] = getattr(law, name)(r[..., own])
        return self.strengths * found

    def phi(self, r):
        return self.of_each('phi', r)

    def dphi(self, r):
        return self.of_each('dphi', r)


class Pairs:
    """Forces and stiffness of bonded particles from the energy phi of a bond alone, by Cauchy's formula; also of periodic ones.

    The pairs are found once, by brute force over the images, where the particles stand on their perfect places; afterwards
    they may stand anywhere.

    Attributes
    ----------
    i, j : ndarray of int, shape (2 * bonds,)
        Each bond from both of its ends.
    cell : ndarray of int, shape (2 * bonds, 3)
        Where the other end is.
    own : tuple, optional
        Laws, kinds and strengths of `OwnLaws`, in place of the one `law`.
    """

    def __init__(self, perfect, law, reach, model='complete', own=None, images=4, dim=None):
        self.dim = dim or (3 if perfect.pbc.all() else 2)
        found = list(neighbour_vectors(perfect, reach, images))
        self.i, self.j = np.array([p[:2] for p in found]).T
        self.cell = np.array([p[2] for p in found])
        self.law, self.model, self.periods, self.n = law, model, perfect.cell.array, len(perfect)
        if own:
            self.law = OwnLaws(*own, self.i, self.j)
        self.own = own

    def without(self, bond):
        """The same but for one bond, which is lost from both of its ends."""
        lost = [(self.i[bond], self.j[bond], *self.cell[bond]), (self.j[bond], self.i[bond], *-self.cell[bond])]
        keep = [k for k, pair in enumerate(zip(self.i, self.j, *self.cell.T, strict=True)) if pair not in lost]
        other = object.__new__(Pairs)
        other.__dict__.update(self.__dict__, i=self.i[keep], j=self.j[keep], cell=self.cell[keep])
        if self.own:
            other.law = OwnLaws(*self.own, other.i, other.j)
        return other

    def _derivatives(self, x):
        """Gradient and Hessian of each bond by the displacement of its other end, shapes (bonds, dim) and (bonds, dim, dim)."""
        R = (x[self.j] + self.cell @ self.periods - x[self.i])[:, : self.dim]
        r = np.linalg.norm(R, axis=1)
        n, radius = R / r[:, None], r / 10  # a seventh of the distance to the singularity at r: (1/7)^24 is nothing
        circle = np.exp(2j * np.pi * np.arange(24) / 24)[:, None]

        def along(d, order):
            step = (radius * circle)[..., None] * d
            r1 = length(R + step) if self.model == 'complete' else r + (n * step).sum(axis=-1)
            return (np.mean((self.law.phi(r1) - self.law.phi(r)) * circle**-order, axis=0) / radius**order).real

        axes = np.eye(self.dim)
        gradient = np.stack([along(d, 1) for d in axes], axis=1)
        K = np.empty((len(r), self.dim, self.dim))
        for a in range(self.dim):
            K[:, a, a] = 2 * along(axes[a], 2)
            for b in range(a):
                K[:, a, b] = K[:, b, a] = (along(axes[a] + axes[b], 2) - along(axes[a] - axes[b], 2)) / 2
        return gradient, K

    def forces(self, x):
        """Of the bonds on each particle at the positions x, shape (particles, dim), in N."""
        total = np.zeros((self.n, self.dim))
        np.add.at(total, self.i, self._derivatives(x)[0])  # the bond pulls i where its energy grows with the other end
        return total

    def stiffest(self, x):
        """Largest entry of the stiffness of any bond, in N/mm."""
        return abs(self._derivatives(x)[1]).max()

    def bloch(self, x, q=(0.0, 0.0, 0.0)):
        """Stiffness for waves of the phase e^{2 pi i q.cell}, shape (..., particles * dim, particles * dim), in N/mm."""
        K, phases = self._derivatives(x)[1], np.exp(2j * np.pi * np.asarray(q) @ self.cell.T)
        D = np.zeros((self.n, self.n, self.dim, self.dim, *phases.shape[:-1]), complex)
        np.add.at(D, (self.i, self.i), K.reshape(*K.shape, *(1,) * (phases.ndim - 1)))
        np.add.at(D, (self.i, self.j), -np.einsum('bxy,...b->bxy...', K, phases))
        D = D.swapaxes(1, 2).reshape(self.n * self.dim, self.n * self.dim, *phases.shape[:-1])
        return np.moveaxis(D, (0, 1), (-2, -1))

    def hessian(self, x):
        """Second derivatives of the energy of all bonds at the positions x, in N/mm."""
        return self.bloch(x).real


def verlet(atoms, law, dt, steps, *, bonds, foundation=0.0, model='complete', damping=0.0, drive=None, velocities=None,
           displacements=0.0):
    """Displacements and velocities after velocity Verlet with textbook pair forces: the oracle of every engine.

    One step is half the decay, half the kick of the drive, velocity Verlet, half a kick, half a decay, each spelled out in the
    order of the formula.  FixAtoms holds, FixedLine and FixedPlane take away the velocity that they bar.

    Parameters
    ----------
    atoms : ase.Atoms
        At rest; its positions are the anchors.
    bonds : tuple of i, j and R
        Each pair once, R the vector from i to j at rest, shape (bonds, dim).
    drive : callable, optional
        From the time to forces, shape (particles, dim).
    velocities, displacements : ndarray, shape (particles, dim)
        At the start; displacements from `atoms`, none by default.
    """
    i, j, R = bonds
    r0 = np.linalg.norm(R, axis=1)
    n0 = R / r0[:, None]
    mass = atoms.get_masses()[:, None]
    decay = np.exp(-np.broadcast_to(damping, len(atoms)) * dt / 2)[:, None]
    dim = R.shape[1]
    allowed = allowed_motion(atoms, dim)

    def project(v):
        return np.einsum('ixy,iy->ix', allowed, v)

    def force(u, t):
        bond = R + u[j] - u[i]
        r = np.linalg.norm(bond, axis=1) if model != 'conventional' else r0 + ((u[j] - u[i]) * n0).sum(axis=1)
        pull = -law.dphi(r)[:, None] * (bond / r[:, None] if model == 'complete' else n0)
        f = -foundation * u
        for x in range(dim):
            f[:, x] += np.bincount(j, pull[:, x], len(u)) - np.bincount(i, pull[:, x], len(u))
        return f + (0 if drive is None else drive(t))

    u = np.zeros((len(atoms), dim)) + displacements
    v = project(np.array(velocities, float))
    for step in range(steps):
        v = decay * v + project(dt / 2 * force(u, step * dt) / mass)
        u = u + dt * v
        v = decay * (v + project(dt / 2 * force(u, (step + 1) * dt) / mass))
    return u, v
