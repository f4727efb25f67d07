"""Lattices that nobody has seen: magnets of drawn shape on drawn lattices, their springs, and the faults of their records.

All of it is made by `workflows/bench_lattice.py`, which shares nothing with the package.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from magphonon.bands.bloch import branch_names
from workflows import bench_lattice as bench

L, MASS, REACH = 10e-3, 8e-4, 45e-3  # m, kg, m
VECTORS = {'triangular': bench.triangular(L), 'square': L * np.eye(2),
           'honeycomb': L * np.array([[np.sqrt(3), 0], [np.sqrt(3) / 2, 1.5]])}
BASIS = {'triangular': np.zeros((1, 2)), 'square': np.zeros((1, 2)), 'honeycomb': L * np.array([[0, 0], [np.sqrt(3) / 2, 0.5]])}
FAULTS = 'none', 'clipped', '1/f', 'hum', 'tilt', 'gain'
WIDE = 1.959964


def faces(points, areas, height):
    """The lateral force in N of two equal upright magnets of 1 T of charged faces, each face as points with areas (m and m^2)."""
    apart = (points[:, None] - points).reshape(-1, 2)
    charge, knots = np.outer(areas, areas).ravel() / (2 * np.pi * bench.MU0), np.geomspace(0.64 * L, 0.4, 120)

    def at(r):
        dx, dy2 = apart[:, 0] + r, apart[:, 1] ** 2
        return charge @ (dx * ((dx**2 + dy2) ** -1.5 - (dx**2 + dy2 + height**2) ** -1.5))

    known = CubicSpline(np.log(knots), np.log([at(r) for r in knots]))
    return lambda r: np.exp(known(np.log(r)))


def ring(outer, inner, height, rings=6, spokes=16):
    """Of radii and a height in m."""
    x, weight = np.polynomial.legendre.leggauss(rings)
    rho, angle = inner + (outer - inner) * (x + 1) / 2, 2 * np.pi * (np.arange(spokes) + 0.5) / spokes
    points = rho[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    return faces(points.reshape(-1, 2), np.repeat(weight * rho, spokes) * np.pi * (outer - inner) / spokes, height)


def cube(side, count=8):
    x, weight = np.polynomial.legendre.leggauss(count)
    points = side / 2 * np.stack(np.meshgrid(x, x), axis=-1).reshape(-1, 2)
    return faces(points, np.outer(weight, weight).ravel() * side**2 / 4, side)


def drawn_force(kind, rng):
    """A force of some size as a function of r (m), and the keys of [law] in a scene that say its shape, '' if it has no name."""
    n = rng.uniform
    if kind in ('two powers', 'screened'):
        share, low, high = n(0.5, 0.8), n(3, 3.6), n(5.5, 7)
        if kind == 'two powers':
            return lambda r: share * (L / r) ** low + (1 - share) * (L / r) ** high, ''
        return lambda r: (L / r) ** (low + 0.5) * np.exp(-(r / L - 1) * (high - 5) / 3), ''
    if kind == 'cube':
        side = n(3.5e-3, 5e-3)
        return cube(side), f'[law.cuboid]\nlength_m = {side}\nwidth_m = {side}\nheight_m = {side}\n'
    outer, inner, height = n(2.6e-3, 3.1e-3), n(0.5e-3, 1.6e-3), n(2e-3, 5e-3)
    if kind == 'disc':
        return ring(outer, 0, height), f'[law.ring]\nouter_diameter_m = {2 * outer}\nheight_m = {height}\n'
    return ring(outer, inner, height), (f'[law.ring]\nouter_diameter_m = {2 * outer}\ninner_diameter_m = {2 * inner}\n'
                                        f'height_m = {height}\n')


def drawn_magnets(kind, rng):
    """A law of 0.2 to 0.32 N at the spacing, and the table [law] of a scene that knows it exactly, but for its neighbours."""
    force, shape = drawn_force(kind, rng)
    size = rng.uniform(0.2, 0.32) / force(L)
    law = bench.tabulated(lambda r: size * force(r), 6.5e-3, 0.3)
    if shape:
        return law, f'kind = "magnets"\nremanence_T = {np.sqrt(size)}\n', shape
    r = np.geomspace(0.68 * L, 0.29, 80)
    return law, f'kind = "table"\ndistances_m = {r.tolist()}\nforces_N = {law(r)[0].tolist()}\n', ''


def drawn_law(kind, rng):
    """A law of 0.2 to 0.32 N at the spacing."""
    if kind != 'two powers':  # as those of the coverage of waves were drawn
        rng.uniform(size=3)
    return drawn_magnets(kind, rng)[0]


def bloch(law, lattice, k, springs, reach=REACH, stretch=1.0, static=True, mass=MASS):
    """Frequencies in rad/s of a lattice of any number of magnets to the cell at the wavevectors k (1/m)."""
    vectors, basis = stretch * VECTORS[lattice], stretch * BASIS[lattice]
    cells, n = bench.sites(vectors, 2 * reach + 4 * L, 2 * reach + 4 * L), len(basis)
    D = np.zeros((len(k), n, 2, n, 2), complex)
    for i in range(n):
        D[:, i, :, i] += np.diag(springs)
        for j in range(n):
            R = cells + basis[j] - basis[i]
            r = np.linalg.norm(R, axis=1)
            R, r = R[(r > 0) & (r < reach)], r[(r > 0) & (r < reach)]
            f, slope = law(r)
            nn = R[:, :, None] * R[:, None] / (r**2)[:, None, None]
            K = -slope[:, None, None] * nn - (f / r * static)[:, None, None] * (np.eye(2) - nn)
            D[:, i, :, i] += K.sum(axis=0)
            D[:, i, :, j] -= np.einsum('qr,rxy->qxy', np.exp(1j * np.asarray(k) @ R.T), K)
    root = np.repeat(np.sqrt(np.broadcast_to(mass, n)), 2)
    squares = np.linalg.eigvalsh(D.reshape(len(k), 2 * n, 2 * n) / np.outer(root, root))
    return np.sign(squares) * np.sqrt(abs(squares))


def needed(law, lattice, stretch=1.0):
    """The stiffness in N/m of the springs that hold a lattice, which its static forces alone would not; 0 if they do."""
    q = np.stack(np.meshgrid(*2 * [np.arange(12) / 12]), axis=-1).reshape(-1, 2)
    least = bloch(law, lattice, 2 * np.pi * q @ np.linalg.inv(stretch * VECTORS[lattice]).T, (0, 0), stretch=stretch).min()
    return MASS * least**2 if least < 0 else 0.0


@dataclass(frozen=True)
class Specimen:
    """A patch, its modes, what it is made of, and the truth that intervals should hold."""

    name: str
    lattice: str
    law: bench.Law
    lab: bench.Lab
    modes: tuple
    springs: tuple
    stretch: float
    truth: dict
    static: bool


def specimen(seed, width, lattices=('triangular', 'square'), static=True, relative=(1.0, 1.0)):
    """A patch drawn by its seed: magnets, lattice, springs that hold it, damping, and the scatter of all sites.

    The particles of a cell have the masses MASS times `relative`.
    """
    rng = np.random.default_rng([seed, 36])
    kind, lattice = ('ring', 'cube', 'two powers')[seed % 3], lattices[seed % len(lattices)]
    law = drawn_law(kind, rng)
    vectors, basis = VECTORS[lattice], BASIS[lattice]
    soft = needed(law, lattice)
    springs = tuple((max(18, 1.25 * soft + 8) * rng.uniform([0.9, 1.0], [1.1, 1.3])).tolist())
    places = np.concatenate([bench.sites(vectors, width + 4 * L, width + 4 * L) + one for one in basis])
    mass = MASS * np.repeat(np.array(relative)[: len(basis)], len(places) // len(basis))
    inside = (abs(places) <= width / 2 + 1e-9).all(axis=1)
    places, mass = places[inside], mass[inside]
    lab = bench.built(places, law, REACH, rng, mass=mass, springs=springs, damping=rng.uniform(3, 12), static=static)
    inner = (abs(lab.anchors) < width / 2 - 3 * L).all(axis=1)
    before, after = (one[inner] - one[inner].mean(axis=0) for one in (lab.anchors, lab.rest))
    moved = np.linalg.lstsq(before, after)[0]
    stretch, free = float(np.sqrt(np.linalg.det(moved))), ~lab.held
    f, slope = (float(one) * lab.strengths[free].mean() ** 2 for one in law(stretch * L))
    mean = lab.springs[free].mean(axis=0)
    return Specimen(f'{kind}, {lattice}', lattice, law, lab, bench.modes(lab), tuple(mean), stretch,
                    {'force': f, 'a': -slope * stretch * L / f, 'foundation_x': mean[0], 'foundation_y': mean[1],
                     'bond stiffness': -slope}, static)


def spoilt(u, fault, rng, rate=1000.0):
    """A record (frames, points, 2) with one fault, in its largest displacement."""
    top, t = abs(u).max(), np.arange(len(u)) / rate
    if fault == 'clipped':
        return np.clip(u, -0.8 * top, 0.8 * top)
    if fault == '1/f':
        walk = np.cumsum(rng.standard_normal(u.shape), axis=0)
        return u + 0.03 * top * walk / np.sqrt(np.mean(walk**2))
    if fault == 'hum':
        return u + 0.03 * top * np.sin(2 * np.pi * (50 * t[:, None, None] + rng.random((1, u.shape[1], 1))))
    if fault == 'tilt':
        c, s = np.cos(np.radians(3)), np.sin(np.radians(3))
        return u @ np.array([[c, s], [-s, c]])
    return u * (1 + 0.03 * rng.standard_normal((1, u.shape[1], 1))) if fault == 'gain' else u


def plain_fit(one, points):
    """Force and springs by least squares of the true shape of the law alone: {name: (value, half width)}, no common shift."""
    names = branch_names(len(BASIS[one.lattice]))
    branch = np.array([names.index(motion) for motion in points.motions])[points.ridge]
    vectors = VECTORS[one.lattice]
    k = 2 * np.pi * points.q[:, :2] @ np.linalg.inv(vectors).T / one.stretch

    def off(x):
        law = replace(one.law, force=np.exp(x[0]) * one.law.force, slope=np.exp(x[0]) * one.law.slope)

        def at(k):
            return 1e-3 * bloch(law, one.lattice, k, np.exp(x[1:]), REACH, one.stretch, one.static)[np.arange(len(k)), branch]

        omega = at(k)
        sigma = np.hypot(points.sigma_omega, at(k * (1 + points.sigma_xi / points.xi)[:, None]) - omega) if x is start else spread
        return (points.omega - omega) / sigma, sigma

    start = np.log([1.0, *one.springs])
    spread = off(start)[1]
    found = least_squares(lambda x: off(x)[0], start)
    C = np.linalg.pinv(found.jac.T @ found.jac) * max(1, 2 * found.cost / max(len(points) - 3, 1))
    f = one.truth['force'] / one.lab.strengths[~one.lab.held].mean() ** 2
    return {name: (value * np.exp(x), WIDE * sigma) for name, value, x, sigma in zip(
        ('force', 'foundation_x', 'foundation_y'), (f, 1, 1), found.x, np.sqrt(np.diag(C)), strict=True)}


class Tally:
    """Held intervals, their half widths and errors, printed as they come: `told` makes the line of a specimen."""

    def __init__(self, path):
        self.path, self.rows, self.own, self.evidence, self.refused = path, [], [], [], 0

    def add(self, one, words, values, plain, evidence):
        """Of a specimen: {name: (value, relative sigma)} of a fit, {name: (value, half width)} of the plain one."""
        row = {name: (np.log(values[name][0] / true), WIDE * values[name][1]) for name, true in one.truth.items()
               if name in values}
        self.rows.append(row)
        self.own.append({name: (np.log(value / one.truth[name]), half) for name, (value, half) in plain.items()})
        self.evidence.append(evidence)
        held = ' '.join(f'{name} {100 * off:+.1f}({100 * half:.1f}){"" if abs(off) <= half else "!"}'
                        for name, (off, half) in row.items())
        own = ' '.join(f'{name} {100 * off:+.1f}({100 * half:.1f})' for name, (off, half) in self.own[-1].items())
        print(f'{self.path}: {one.name}, {words}: {held}; plain: {own}; D* {evidence:+.1f}', flush=True)

    def refusal(self, one, words, error):
        self.refused += 1
        print(f'{self.path}: {one.name}, {words}: REFUSED {str(error)[:150]}', flush=True)

    @property
    def share(self):
        return np.mean([abs(off) <= half for row in self.rows for off, half in row.values()])

    def summary(self):
        """Of each quantity: held, median half width, 1.96 rms error, and the same of the plain fit; all in %."""
        lines = [f'{self.path}: {len(self.rows)} specimens, {self.refused} refused, {self.share:.3f} of '
                 f'{sum(map(len, self.rows))} intervals hold; D* from {min(self.evidence):+.1f} to {max(self.evidence):+.1f}']
        for rows, kind in ((self.rows, 'fit'), (self.own, 'plain')):
            for name in dict.fromkeys(name for row in rows for name in row):
                off, half = np.array([row[name] for row in rows if name in row]).T
                lines.append(f'  {kind} {name}: held {np.sum(abs(off) <= half)} of {len(off)}, half width '
                             f'{100 * np.median(half):.1f}, 1.96 rms error {196 * np.sqrt(np.mean(off**2)):.1f}, '
                             f'mean error {100 * off.mean():+.1f}')
        return '\n'.join(lines)
