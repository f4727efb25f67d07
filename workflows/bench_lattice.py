"""A simulated laboratory that shares no code with the package: all pairs of magnets, pillars, scatter, a vibrometer with faults.

It tests statements about measured lattices, so it imports nothing from magphonon.  It has forces of any law from a table, all
pairs within a distance, leapfrog steps, and the exact second derivatives of the same table for modes, responses and Bloch waves.
Everything is in SI: m, kg, s, N; angular frequencies in rad/s.

    law = tabulated(disc_force(2.5e-3, 5e-3, 1.32), 8e-3, 50e-3)
    lab = built(sites(triangular(10e-3), 0.3, 0.26), law, 45e-3, np.random.default_rng(1))
    t, u = motion(lab, [(pushed(lab, source, (0, 1e-3)), burst(60.0, 5))], 0.3, row)
"""

from dataclasses import dataclass, replace

import numpy as np
from numba import njit
from scipy import sparse
from scipy.interpolate import CubicSpline
from scipy.sparse.linalg import eigsh, spsolve
from scipy.spatial import cKDTree

MU0 = 4e-7 * np.pi  # N/A^2
KNOTS = 20_000  # of a law, so near each other that the cubics between them are exact to 1e-10
STEPS = 30  # in a period of the highest frequency: leapfrog is 0.2 % off there, and less as the square of the frequency below


@dataclass(frozen=True)
class Law:
    """A pair law as a table: repulsive force in N and its derivative in N/m, at distances from `first` in steps of `step` (m)."""

    first: float
    step: float
    force: np.ndarray
    slope: np.ndarray

    def __call__(self, r):
        """Force and its derivative at the distances r."""
        return _at(np.asarray(r, float), *vars(self).values())


def tabulated(force, nearest, farthest):
    """The law of a function force(r) between two distances; ln force must be smooth in ln r."""
    r = np.linspace(nearest, farthest, KNOTS)
    f = force(r)
    return Law(nearest, r[1] - r[0], f, CubicSpline(r, f)(r, 1))


def power_law(force, a, spacing):
    """Force (spacing/r)^a in N; two point dipoles have a = 4."""
    return lambda r: force * (spacing / r) ** a


def disc_force(radius, height, remanence, rings=8, spokes=20, distances=160):
    """Lateral force in N between two upright discs side by side, from the magnetic charges on both faces of each disc."""
    x, weight = np.polynomial.legendre.leggauss(rings)
    rho, angle = radius * (x + 1) / 2, 2 * np.pi * (np.arange(spokes) + 0.5) / spokes
    points = rho[:, None, None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    area = np.repeat(weight * rho * radius / 2 * 2 * np.pi / spokes, spokes)
    apart = (points.reshape(-1, 1, 2) - points.reshape(-1, 2)).reshape(-1, 2)
    charge = (remanence / MU0) ** 2 * MU0 / (4 * np.pi) * np.outer(area, area).ravel()

    def at(r):
        dx, dy2 = apart[:, 0] + r, apart[:, 1] ** 2
        return 2 * charge @ (dx * ((dx**2 + dy2) ** -1.5 - (dx**2 + dy2 + height**2) ** -1.5))

    def force(r):
        knots = np.geomspace(np.min(r), np.max(r), distances)
        return np.exp(CubicSpline(np.log(knots), np.log([at(one) for one in knots]))(np.log(r)))

    return force


@dataclass(frozen=True)
class Lab:
    """A patch as built. Each array has a row for each magnet, or for each pair (i, j)."""

    law: Law
    anchors: np.ndarray     # m, feet of the pillars
    rest: np.ndarray        # m, where all forces balance
    strengths: np.ndarray   # of each magnet: a pair has their product times the law
    springs: np.ndarray     # N/m, along x and y
    masses: np.ndarray      # kg
    held: np.ndarray        # of the rim, which does not move
    i: np.ndarray
    j: np.ndarray
    damping: float          # 1/s, of the velocity
    slack: np.ndarray       # m, length of each pair at which it is a slack spring, without static force; empty for magnets


def triangular(spacing):
    """The two lattice vectors of a triangular lattice."""
    return spacing * np.array([[1, 0], [0.5, np.sqrt(0.75)]])


def sites(vectors, width, height):
    """Sites of a lattice within a rectangle about the origin, which is one of the sites."""
    most = int(np.ceil(2 * np.hypot(width, height) / np.linalg.norm(vectors, axis=1).min()))
    n = np.stack(np.meshgrid(*2 * [np.arange(-most, most + 1)], indexing='ij'), axis=-1).reshape(-1, 2)
    x = n @ vectors
    return x[(abs(x) <= np.array([width, height]) / 2 + 1e-9).all(axis=1)]


def built(places, law, reach, rng, *, mass=8e-4, springs=(20.0, 22.0), damping=6.0,
          scatter=(0.025, 1.5e-4, 0.05, 0.005), static=True, missing=(), held=None):
    """A patch with `scatter` of strengths (relative), positions (m), springs and masses (relative).

    `static=False` puts springs of the same stiffness, slack at rest, in place of the magnets: a lattice without D*.
    The `missing` sites have no magnet.  The `held` magnets do not move; by default these are the rim.
    """
    strength, place, spring, weight = scatter
    near = cKDTree(places).query(places, 2)[0][:, 1].min()
    count = np.array([len(one) for one in cKDTree(places).query_ball_point(places, 1.2 * near)])
    held, places = (np.delete(one, missing, axis=0) for one in (count < count.max() if held is None else held, places))
    n = len(places)
    anchors = places + place * rng.standard_normal((n, 2))
    i, j = cKDTree(anchors).query_pairs(reach, output_type='ndarray').T.copy()
    slack = np.zeros(0) if static else np.linalg.norm(anchors[i] - anchors[j], axis=1)
    lab = Lab(law, anchors, anchors, 1 + strength * rng.standard_normal(n),
              np.array(springs) * (1 + spring * rng.standard_normal((n, 1))), mass * (1 + weight * rng.standard_normal(n)),
              held, i, j, damping, slack)
    free = np.repeat(~lab.held, 2)
    for _ in range(30):  # Newton's method for the rest state
        step = np.zeros(2 * n)
        step[free] = spsolve(stiffness(lab)[free][:, free].tocsc(), _forces(lab).ravel()[free])
        lab = replace(lab, rest=lab.rest + step.reshape(-1, 2))
        if abs(step).max() < 1e-13:
            return lab
    raise RuntimeError('no rest state')


def _forces(lab):
    """Static forces in N on each magnet at rest."""
    out = -lab.springs * (lab.rest - lab.anchors)
    _push(out, lab.rest, lab.i, lab.j, lab.strengths, lab.slack, *vars(lab.law).values())
    return out


def stiffness(lab):
    """Second derivatives of the energy at rest in N/m, a sparse matrix over (magnet, direction)."""
    d = lab.rest[lab.i] - lab.rest[lab.j]
    r = np.linalg.norm(d, axis=1)
    nn = d[:, :, None] * d[:, None, :] / (r**2)[:, None, None]
    f, slope = lab.law(lab.slack if lab.slack.size else r)
    f = f if not lab.slack.size else -slope * (lab.slack - r)
    product = (lab.strengths[lab.i] * lab.strengths[lab.j])[:, None, None]
    K = product * (-slope[:, None, None] * nn - (f / r)[:, None, None] * (np.eye(2) - nn))
    blocks = np.concatenate([K, K, -K, -K])
    row, column = np.r_[lab.i, lab.j, lab.i, lab.j], np.r_[lab.i, lab.j, lab.j, lab.i]
    x, y = np.array([0, 0, 1, 1]), np.array([0, 1, 0, 1])
    pairs = sparse.coo_array((blocks.reshape(-1), ((2 * row[:, None] + x).ravel(), (2 * column[:, None] + y).ravel())))
    return sparse.csr_array(pairs) + sparse.diags_array(lab.springs.ravel())


def modes(lab):
    """All frequencies in rad/s and shapes (magnets, 2, modes) of the free magnets, of unit modal mass."""
    free, m = np.repeat(~lab.held, 2), np.repeat(lab.masses, 2)
    root = 1 / np.sqrt(m[free])
    values, vectors = np.linalg.eigh(root[:, None] * stiffness(lab)[free][:, free].toarray() * root)
    shapes = np.zeros((2 * len(lab.masses), len(values)))
    shapes[free] = root[:, None] * vectors
    return np.sqrt(values), shapes.reshape(-1, 2, len(values))


def response(lab, push, omega):
    """Steady displacements in m of all magnets under push e^{i omega t}, push of the shape (magnets, 2) in N."""
    free, m = np.repeat(~lab.held, 2), np.repeat(lab.masses, 2)
    K, M = stiffness(lab)[free][:, free], sparse.diags_array(m[free])
    u = np.zeros((len(omega), len(free)), complex)
    for k, w in enumerate(omega):
        u[k, free] = spsolve((K + (1j * w * lab.damping - w**2) * M).tocsc(), np.asarray(push, complex).ravel()[free])
    return u.reshape(len(omega), -1, 2)


def mean_vectors(lab, vectors, depth):
    """Mean lattice vectors of the specimen at rest, in its inner part, at least `depth` from the rim."""
    centre = lab.anchors.mean(axis=0)
    inner = (abs(lab.anchors - centre) < np.ptp(lab.anchors, axis=0) / 2 - depth).all(axis=1)
    stretch = np.linalg.lstsq(lab.anchors[inner] - lab.anchors[inner].mean(axis=0),
                              lab.rest[inner] - lab.rest[inner].mean(axis=0))[0]
    return vectors @ stretch


def bloch(law, vectors, reach, k, mass=8e-4, springs=(20.0, 22.0), static=True):
    """Frequencies in rad/s of both branches at the wavevectors k (1/m), with all neighbours within a distance `reach`."""
    R = sites(vectors, 2 * reach, 2 * reach)
    R = R[(np.linalg.norm(R, axis=1) < reach) & R.any(axis=1)]
    r = np.linalg.norm(R, axis=1)
    f, slope = law(r)
    nn = R[:, :, None] * R[:, None, :] / (r**2)[:, None, None]
    K = -slope[:, None, None] * nn - (f / r * static)[:, None, None] * (np.eye(2) - nn)
    D = np.einsum('qr,rxy->qxy', 1 - np.cos(np.atleast_2d(k) @ R.T), K) + np.diag(springs)
    return np.sqrt(np.linalg.eigvalsh(D / mass))


def pushed(lab, magnets, force):
    """Pattern of a force (N) on these magnets alone. For a shaken base the pattern is -masses times its acceleration."""
    pattern = np.zeros_like(lab.rest)
    pattern[magnets] = force
    return pattern


def burst(carrier_Hz, cycles):
    """A burst with a given number of cycles in a Hann window, as a function of time in s."""
    return lambda t: np.where(t < cycles / carrier_Hz, np.sin(np.pi * carrier_Hz * t / cycles) ** 2
                              * np.sin(2 * np.pi * carrier_Hz * t), 0.0)


def motion(lab, drives, duration, points, rate=1000.0):
    """Times in s and displacements in m from rest, shape (frames, points, 2), under drives (pattern in N, function of time)."""
    free = np.repeat(~lab.held, 2)
    root = sparse.diags_array(1 / np.sqrt(np.repeat(lab.masses, 2)[free]))
    top = np.sqrt(eigsh(root @ stiffness(lab)[free][:, free] @ root, k=1, return_eigenvectors=False)[0])
    every = int(np.ceil(STEPS * top / (2 * np.pi) / rate))
    dt = 1 / (rate * every)
    frames = int(duration * rate)
    t = dt * np.arange(frames * every)
    values = np.stack([np.broadcast_to(wave(t), t.shape) for _, wave in drives], axis=1)
    u = _leap(lab.rest, lab.anchors, lab.springs, lab.masses, lab.held, lab.damping, lab.i, lab.j, lab.strengths, lab.slack,
              np.stack([pattern for pattern, _ in drives]), values, dt, every, np.asarray(points), *vars(lab.law).values())
    return np.arange(frames) / rate, u


def small_motion(lab, drives, duration, points, shapes, rate=1000.0, quiet=4.0):
    """The same motion from the modes of the patch (`modes`), quick for many drives; free motion has died after `quiet` s."""
    omega, phi = shapes
    t = np.arange(int(quiet * rate)) / rate
    w = 2 * np.pi * np.fft.rfftfreq(len(t), 1 / rate)
    modal = sum((np.einsum('nxm,nx->m', phi, pattern)[:, None] * np.fft.rfft(wave(t)) for pattern, wave in drives),
                np.zeros((len(omega), len(w)), complex))
    modal /= omega[:, None] ** 2 + 1j * lab.damping * w - w**2
    frames, seen = int(duration * rate), phi[points]
    u = np.fft.irfft(seen.reshape(-1, len(omega)) @ modal, len(t), axis=1)[:, :frames]
    return t[:frames], u.T.reshape(frames, -1, 2)


def measured(u, rate, rng, *, noise=0.01, jitter=2e-4, drift=0.01, dead=0):
    """A motion as a vibrometer shows it, point by point: each shot is late by its own jitter (s), and `dead` points are dead.

    Noise and drift are fractions of the largest displacement.
    """
    frames, points = u.shape[:2]
    each, top = (1, points) + (1,) * (u.ndim - 2), abs(u).max()
    late = np.exp(-2j * np.pi * np.fft.rfftfreq(2 * frames, 1 / rate).reshape(-1, *(u.ndim - 1) * (1,))
                  * jitter * rng.standard_normal(each))
    shown = np.fft.irfft(np.fft.rfft(u, 2 * frames, axis=0) * late, axis=0)[:frames]
    shown[:, rng.choice(points, dead, replace=False)] = 0
    t = np.linspace(0, 1, frames).reshape(-1, *(u.ndim - 1) * (1,))
    return shown + top * (drift * (rng.standard_normal(each) + t * rng.standard_normal(each))
                          + noise * rng.standard_normal(u.shape))


@njit(cache=True)
def _one(r, first, step, force, slope):
    k = min(max(int((r - first) / step), 0), len(force) - 2)
    s = (r - first) / step - k
    a, b, c, d = force[k], step * slope[k], force[k + 1], step * slope[k + 1]
    p, q = 3 * (c - a) - 2 * b - d, 2 * (a - c) + b + d
    return a + s * (b + s * (p + s * q)), (b + s * (2 * p + 3 * s * q)) / step


@njit(cache=True)
def _at(r, first, step, force, slope):
    f, df = np.empty_like(r), np.empty_like(r)
    for k in range(r.size):
        f.flat[k], df.flat[k] = _one(r.flat[k], first, step, force, slope)
    return f, df


@njit(cache=True)
def _push(out, x, i, j, strengths, slack, first, step, force, slope):
    """Add the forces of all pairs, at the positions x."""
    for k in range(len(i)):
        a, b = i[k], j[k]
        dx, dy = x[a, 0] - x[b, 0], x[a, 1] - x[b, 1]
        r = np.sqrt(dx * dx + dy * dy)
        if len(slack):
            f = -_one(slack[k], first, step, force, slope)[1] * (slack[k] - r)
        else:
            f = _one(r, first, step, force, slope)[0]
        f *= strengths[a] * strengths[b] / r
        out[a, 0] += f * dx
        out[a, 1] += f * dy
        out[b, 0] -= f * dx
        out[b, 1] -= f * dy


@njit(cache=True)
def _leap(rest, anchors, springs, masses, held, damping, i, j, strengths, slack, patterns, values, dt, every, points,
          first, step, force, slope):
    x, v = rest.copy(), np.zeros_like(rest)
    record = np.empty((len(values) // every, len(points), 2))
    for n in range(len(values)):
        if n % every == 0:
            for k in range(len(points)):
                record[n // every, k] = x[points[k]] - rest[points[k]]
        F = -springs * (x - anchors)
        for k in range(len(patterns)):
            F += values[n, k] * patterns[k]
        _push(F, x, i, j, strengths, slack, first, step, force, slope)
        for k in range(len(x)):
            if not held[k]:
                for c in range(2):
                    v[k, c] = (v[k, c] * (1 - damping * dt / 2) + dt * F[k, c] / masses[k]) / (1 + damping * dt / 2)
                    x[k, c] += dt * v[k, c]
    return record
