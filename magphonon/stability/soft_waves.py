"""The softest wave of a lattice: the lowest eigenvalue of the Bloch matrix over the whole Brillouin zone.

A mesh over the zone alone can miss it.  Translations have no stiffness, so the lowest eigenvalue is zero at k = 0 and begins with
c(n) k^2 along a direction n.  If c is slightly negative, the eigenvalue is negative in a pocket around k = 0 that may be much
narrower than a step of the mesh.  Elsewhere too a minimum may be lower than the mesh points beside it.  Therefore

- long waves are examined on a ring of directions at one small wavenumber, and outwards from its softest directions;
- every local minimum of the mesh that may contain the lowest value is refined.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from itertools import product
from typing import Any

import numpy as np
from numpy.typing import NDArray

LONG = 2.0**-11
"""Wavenumber of the ring, as a fraction of the shortest reciprocal vector: terms in k^4 are about 1e-5 of those in k^2 there, and
round-off is 1e-9 of them."""
DIRECTIONS = {1: 1, 2: 36, 3: 100}
"""Number of points of the ring, by the number of periodic directions.  The ring is half a circle or half a sphere, because -k is
equivalent to k."""
FOLLOWED = 8  # largest number of minima that are refined, the lowest first
MARGIN = 1 / 2
"""Fraction of the second differences of the mesh by which a minimum may lie below the lowest mesh point; for a parabola it is at
most 1/16."""
ROUNDS = 200  # largest number of iterations of a descent
NARROW = 2.0**-10
"""Half width of the narrowest stencil.  Beside a saddle, a minimum within it is about its fourth power deep, 1e-12 of the largest
eigenvalue."""
FLAT = 1e-13  # expected gain, as a fraction of the largest eigenvalue, at which a descent has converged


def softest_wave(matrix: Callable[[Any], NDArray[Any]], cell: NDArray[np.float64], pbc: Sequence[bool] | NDArray[np.bool_],
                 steps: int) -> tuple[float, float, NDArray[np.float64]]:
    """Lowest and highest eigenvalue of `matrix(q)` over the zone, and the wavevector of the lowest.

    `matrix` takes wavevectors of the shape (wavevectors, 3), in fractions of the reciprocal vectors, and returns Hermitian
    matrices.  `steps` is the number of mesh points along each reciprocal vector.  The highest eigenvalue is that on the mesh;
    the lowest is that of a mesh point, unless a lower one was found near it.
    """
    axes = np.eye(3)[np.asarray(pbc)]
    x, lowest, highest = _mesh(lambda x: np.linalg.eigvalsh(matrix(x @ axes)), len(axes), steps)
    flat = FLAT * max(abs(lowest).max(), abs(highest))

    def at(x):
        return np.linalg.eigvalsh(matrix(x.reshape(-1, len(axes)) @ axes))[:, 0].reshape(x.shape[:-1])

    mesh = _minima_of_mesh(lowest, flat)
    pockets = _pockets(at, axes @ cell, 1 / steps, lowest.flat[0], lowest.min(), flat)
    starts = np.concatenate([x[mesh], pockets])
    widths = np.concatenate([np.full(len(mesh), 1 / steps), abs(pockets).max(axis=1, initial=0) / 2])
    best = lowest.argmin()
    found, q = lowest.flat[best], x[best]
    if len(starts):
        ends, values = _descend(at, starts, widths, flat)
        if values.min() < found:
            found, q = values.min(), ends[values.argmin()]
    return float(found), float(highest), q @ axes


def _mesh(spectrum, dim, steps):
    """Points of the mesh, shape (points, dim), the lowest eigenvalue at each, shape (steps, ...), and the highest of all."""
    index = np.stack(np.unravel_index(np.arange(steps**dim), (steps,) * dim), axis=-1)
    opposite: Any = np.ravel_multi_index(tuple((-index % steps).T), (steps,) * dim)
    half = np.flatnonzero(np.arange(steps**dim) <= opposite)
    values = spectrum(index[half] / steps)
    lowest = np.empty(steps**dim)
    lowest[half] = lowest[opposite[half]] = values[:, 0]
    return index / steps, lowest.reshape((steps,) * dim), values.max()


def _minima_of_mesh(lowest, flat):
    """Flat indices of the local minima that may fall below the lowest mesh point when refined, one of each pair q and -q."""
    dims = range(lowest.ndim)
    shifts = [shift for shift in product((-1, 0, 1), repeat=lowest.ndim) if any(shift)]
    minimum = np.all([lowest <= np.roll(lowest, shift, dims) + flat for shift in shifts], axis=0)
    curvature = sum(np.roll(lowest, 1, axis) + np.roll(lowest, -1, axis) - 2 * lowest for axis in dims)
    hidden = lowest - MARGIN * curvature < lowest.min() - flat
    index = np.stack(np.unravel_index(np.arange(lowest.size), lowest.shape), axis=-1)
    opposite = np.ravel_multi_index(tuple((-index % lowest.shape).T), lowest.shape)
    at = np.flatnonzero((minimum & hidden).ravel() & (np.arange(lowest.size) <= opposite))
    at = at[at > 0]  # k = 0 is stationary, as all points with integer 2 q, and examined by the ring
    return at[np.argsort(lowest.flat[at], kind='stable')[:FOLLOWED]]


def _pockets(at, vectors, step, middle, lowest, flat):
    """Wavevectors near the minima of the pockets around k = 0 that are below the `lowest` value of the mesh."""
    dim = len(vectors)
    reciprocal = 2 * np.pi * np.linalg.pinv(vectors)  # in columns
    shortest = np.linalg.norm(reciprocal, axis=0).min()
    basis = np.linalg.qr(reciprocal)[0]

    def waves(n, radius=LONG):
        k = n / np.linalg.norm(n, axis=-1, keepdims=True) * (radius * shortest)
        return k @ (vectors @ basis).T / (2 * np.pi)

    n = _soft_directions(lambda n: at(waves(n)), dim, flat)
    radii = LONG * np.sqrt(2) ** np.arange(1 + max(0, np.floor(2 * np.log2(step / LONG))))
    x = waves(n[:, None], radii[:, None])
    values = at(x)
    deepest = values.argmin(axis=1)[:, None]
    bottom = np.take_along_axis(values, deepest, axis=1)[:, 0]
    x = np.take_along_axis(x, deepest[..., None], axis=1)[:, 0]
    # the minimum of k^4 - k^2 is at most a fifth deeper than the better of two such radii
    return x[1.5 * (bottom - middle) < min(lowest - middle, -flat)]


def _soft_directions(ring, dim, flat):
    """Directions of the local minima of `ring(n)`, shape (minima, dim)."""
    if dim == 1:
        return np.ones((1, 1))
    n, spacing = _half_sphere(dim)
    values = ring(n)
    beside = abs(n @ n.T) > np.cos(1.6 * spacing)
    minima = np.flatnonzero(values <= np.where(beside, values, np.inf).min(axis=1) + flat)
    n = n[minima[np.argsort(values[minima], kind='stable')[:FOLLOWED]]]
    tangents = np.linalg.svd(n[:, None])[2][:, 1:]

    def tilted(y):
        return n.reshape(-1, *(1,) * (y.ndim - 2), dim) + np.einsum('s...t,stx->s...x', y, tangents)

    y, _ = _descend(lambda y: ring(tilted(y)), np.zeros((len(n), dim - 1)), np.full(len(n), spacing), flat)
    return tilted(y)


def _half_sphere(dim):
    """Directions n spread evenly, one of each pair n and -n, shape (directions, dim), and the angle between neighbours."""
    count = DIRECTIONS[dim]
    if dim == 2:
        angle = np.pi * np.arange(count) / count
        return np.stack([np.cos(angle), np.sin(angle)], axis=1), np.pi / count
    z = (np.arange(count) + 0.5) / count
    turn = np.pi * (3 - np.sqrt(5)) * np.arange(count)  # the golden angle
    across = np.sqrt(1 - z**2)
    return np.stack([across * np.cos(turn), across * np.sin(turn), z], axis=1), np.sqrt(2 * np.pi / count)


def _descend(f, x, step, flat):
    """Refine each start x, shape (starts, dim): move to the vertex of the parabola through a stencil, or to its lowest point, and
    halve the stencil, which begins with the half width `step`.  f is called with the shape (starts, points, dim).
    """
    dim, every = x.shape[1], np.arange(len(x))
    unit, pairs = np.eye(dim), np.triu_indices(dim, 1)
    diagonal = unit[pairs[0]] + unit[pairs[1]]
    stencil = np.concatenate([np.zeros((1, dim)), unit, -unit, diagonal, -diagonal])
    idle = 0
    for _ in range(ROUNDS):
        values = f(x[:, None] + step[:, None, None] * stencil)
        vertex, promised = _vertex(values, dim, pairs, flat)
        tried = np.concatenate([np.broadcast_to(stencil, (len(x), *stencil.shape)), vertex[:, None]], axis=1)
        values = np.append(values, f(x[:, None] + (step[:, None] * vertex)[:, None]), axis=1)
        lowest = values.argmin(axis=1)
        gains = values[:, 0] - values[every, lowest] > flat
        moved = np.where(gains[:, None], tried[every, lowest], 0.0)
        x = x + step[:, None] * moved
        found = np.where(gains, values[every, lowest], values[:, 0])
        # around a saddle a wide stencil may look like a minimum
        idle = 0 if (gains | (promised > flat) | (step > NARROW)).any() else idle + 1
        if idle == 2:  # two stencils, one half as wide as the other, show no gain
            break
        step = np.where(np.linalg.norm(moved, axis=1) < 0.99, step / 2, step)  # a start that left its stencil keeps the step
    return x, found


def _vertex(values, dim, pairs, flat):
    """Lowest points, within the stencils, of the parabolas through the values on stencils, in steps; and the expected gain."""
    here, ahead, behind = values[:, :1], values[:, 1 : dim + 1], values[:, dim + 1 : 2 * dim + 1]
    diagonal = values[:, 2 * dim + 1 :].reshape(len(values), 2, -1).sum(axis=1)
    second = ahead + behind - 2 * here
    curvature = second[:, :, None] * np.eye(dim)
    curvature[:, *pairs] = curvature[:, *pairs[::-1]] = (diagonal - 2 * here - second[:, pairs[0]] - second[:, pairs[1]]) / 2
    w, axes = np.linalg.eigh(curvature)
    slope = np.einsum('sxa,sx->sa', axes, (ahead - behind) / 2)
    # without upward curvature there is no vertex: take a whole step downwards; from a saddle, to either side
    down = np.where(slope > 0, -1.0, 1.0)
    along = np.where(w > flat, -slope / np.where(w > flat, w, 1), down).clip(-1, 1)
    return np.einsum('sxa,sa->sx', axes, along), -(slope * along + w * along**2 / 2).sum(axis=1)
