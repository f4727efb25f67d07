"""Compiled steps of FIRE for the spheres of a packing and the shape of their cell."""

import numpy as np
from numba import njit


@njit(cache=True)
def descend(x, cell, i, j, shift, D, power, pressure, balance, v, strain_rate, fire, inertia, steps, roam):
    """Steps of FIRE, until the forces balance or a sphere has moved by `roam` past the cell: their number, and whether they do.

    In mean diameters, energies of a contact and unit masses: positions `x`, velocities `v` and the cell with its strain rate,
    which has the `inertia`, change in place, and so does `fire`, the time step, the mixing and the number of steps downhill.
    Pairs i, j, `shift` with the sums D of their radii act.
    """
    n, dim = x.shape
    one, first, cell0 = np.eye(dim), x.copy(), cell.copy()
    F, W = np.zeros((n, dim)), np.zeros((dim, dim))
    for step in range(steps):
        forces(x, cell, i, j, shift, D, power, F, W)
        V = abs(np.linalg.det(cell))
        G = ((W + W.T) / 2 - pressure * V * one) / inertia
        if max(np.abs(F).max(), np.abs(G).max()) < balance * pressure:
            return step, True
        downhill = (F * v).sum() + (G * strain_rate).sum()
        if downhill > 0:
            turn = fire[1] * np.sqrt(((v**2).sum() + (strain_rate**2).sum()) / ((F**2).sum() + (G**2).sum()))
            v *= 1 - fire[1]
            v += turn * F
            strain_rate *= 1 - fire[1]
            strain_rate += turn * G
            fire[2] += 1
            if fire[2] > 5:
                fire[0], fire[1] = min(1.1 * fire[0], 0.4), 0.99 * fire[1]
        else:
            v[:] = 0
            strain_rate[:] = 0
            fire[0], fire[1], fire[2] = 0.5 * fire[0], 0.1, 0
        v += fire[0] * F
        strain_rate += fire[0] * G
        strained = one + fire[0] * strain_rate / inertia
        x[:] = (x + fire[0] * v) @ strained
        cell[:] = cell @ strained
        if step % 5 == 0:
            followed = np.linalg.solve(cell0, cell)
            far = np.sqrt(((x - first @ followed) ** 2).sum(axis=1).max())
            if far > roam or np.abs(followed - one).max() > roam / 4:
                return step + 1, False
    return steps, False


@njit(cache=True)
def forces(x, cell, i, j, shift, D, power, F, W):
    """Forces on the spheres into F, and the sum of force times distance into W: `f = (1 - r/D)^(power - 1)/D` where r < D."""
    dim = x.shape[1]
    F[:] = 0
    W[:] = 0
    R = np.zeros(dim)
    for b in range(len(i)):
        square = 0.0
        for k in range(dim):
            R[k] = x[j[b], k] - x[i[b], k]
            for m in range(dim):
                R[k] += shift[b, m] * cell[m, k]
            square += R[k] ** 2
        if square >= D[b] ** 2:
            continue
        r = np.sqrt(square)
        overlap = 1 - r / D[b]
        f = (overlap if power == 2 else overlap ** (power - 1)) / D[b] / r
        for k in range(dim):
            F[j[b], k] += f * R[k]
            F[i[b], k] -= f * R[k]
            for m in range(dim):
                W[k, m] += f * R[k] * R[m]
