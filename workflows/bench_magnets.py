"""Tests lattices of magnets on pillars with numpy alone, in SI: all pairs within a distance, rest positions, responses and Bloch
waves.

It shares no code with the package.  `python -m workflows.bench_magnets demultiplexer.csv` tests the table of a demultiplexer.
"""

import csv
import sys

import numpy as np

MASS, EXPONENT, B = 0.707e-3, 4.5824, 1.6209e-10  # kg, and the force B s_i s_j r^-EXPONENT in N
DAMPING, REACH = 4.0, 0.045  # 1/s, m
SOURCE, PORTS = (-0.04, 0.0), ((0.03, 0.03464), (0.03, -0.03464))
HERTZ = 60.0, 80.0  # that of the first port, that of the second


def read(path):
    """Read a build list: feet in m, strengths, stiffnesses in N/m, and which magnets are held."""
    with open(path, encoding='utf-8', newline='') as file:
        rows = list(csv.DictReader(file))
    columns = {name: np.array([float(row[name]) for row in rows]) for name in rows[0]}
    feet = np.stack([columns['x_m'], columns['y_m']], axis=1)
    return feet, columns['strength'], columns['stiffness_N_per_m'], columns['held'] > 0.5


def pairs(feet, reach=REACH):
    """Pairs of magnets whose feet are within a distance."""
    i, j = np.triu_indices(len(feet), 1)
    near = np.hypot(*(feet[i] - feet[j]).T) < reach
    return i[near], j[near]


def at_rest(feet, strengths, springs, held):
    """Stiffness of the free directions where all forces balance (by Newton's method), and which directions are free."""
    (i, j), n, u = pairs(feet), len(feet), np.zeros_like(feet)
    b, free = B * strengths[i] * strengths[j], np.repeat(~held, 2)
    for _ in range(60):
        R = feet[j] + u[j] - feet[i] - u[i]
        r = np.hypot(*R.T)
        e, f = R / r[:, None], b * r**-EXPONENT
        along = e[:, :, None] * e[:, None]
        bond = (EXPONENT * f / r)[:, None, None] * along - (f / r)[:, None, None] * (np.eye(2) - along)
        force, K = -springs[:, None] * u, np.zeros((n, 2, n, 2))
        np.add.at(force, i, -f[:, None] * e)
        np.add.at(force, j, f[:, None] * e)
        for a, c, sign in ((i, i, 1), (j, j, 1), (i, j, -1), (j, i, -1)):
            np.add.at(K, (a, slice(None), c), sign * bond)
        K = K.reshape(2 * n, 2 * n) + np.diag(np.repeat(springs, 2))
        step = np.zeros(2 * n)
        step[free] = np.linalg.solve(K[np.ix_(free, free)], force.ravel()[free])
        u += step.reshape(n, 2) * min(1, 3e-4 / max(abs(step).max(), 1e-15))
        if abs(step).max() < 1e-13:
            return K[np.ix_(free, free)], free
    raise ValueError('no rest was found')


def decibels(feet, strengths, springs, held):
    """How much louder the right port is at each of the two frequencies, in dB; NaN where the rest is not stable."""
    K, free = at_rest(feet, strengths, springs, held)
    if np.linalg.eigvalsh(K)[0] <= 0:
        return np.full(2, np.nan)
    at = [2 * int(np.hypot(*(feet - place).T).argmin()) for place in (SOURCE, *PORTS)]
    push, found = np.zeros(len(free)), []
    push[at[0]] = 1
    for omega in 2 * np.pi * np.array(HERTZ):
        x = np.zeros(len(free), complex)
        x[free] = np.linalg.solve(K + (1j * omega * DAMPING - omega**2) * MASS * np.eye(free.sum()), push[free])
        found.append(20 * np.log10(abs(x[at[1]] / x[at[2]])))
    return np.array(found) * [1, -1]


def drawn(table, draws, seed, scatter=0.01):
    """The smaller of the two contrasts in dB for random lattices whose strengths and springs scatter, shape (draws,)."""
    feet, strengths, springs, held = table
    rng, found = np.random.default_rng(seed), []
    for _ in range(draws):
        s, k = (one * (1 + scatter * rng.normal(size=len(feet))) for one in (strengths, springs))
        found.append(decibels(feet, s, k, held).min())
    return np.array(found)


def squares(feet, vectors, strengths, springs, masses, q, reach=REACH):
    """Squared angular frequencies of Bloch waves of a cell with magnets that stand at `feet`, shape (wavevectors, branches).

    The feet are positions at rest. `vectors` are those of the cell, and `q` is in fractions of the reciprocal vectors.
    """
    n, found = len(feet), []
    most = int(np.ceil(reach / min(np.linalg.svd(vectors)[1]))) + 1
    cells = [(a, b) for a in range(-most, most + 1) for b in range(-most, most + 1)]
    for phase in q:
        D = np.zeros((n, 2, n, 2), complex)
        for cell in cells:
            R = feet[None] + np.array(cell) @ vectors - feet[:, None]
            r = np.linalg.norm(R, axis=2)
            near = (r > 0) & (r < reach)
            r = np.where(near, r, 1.0)
            e, f = R / r[..., None], near * B * np.outer(strengths, strengths) * r**-EXPONENT
            along = e[..., :, None] * e[..., None, :]
            bond = (EXPONENT * f / r)[..., None, None] * along - (f / r)[..., None, None] * (np.eye(2) - along)
            D -= np.exp(2j * np.pi * np.dot(phase[:2], cell)) * bond.transpose(0, 2, 1, 3)
            D[np.arange(n), :, np.arange(n)] += bond.sum(1)
        D = D.reshape(2 * n, 2 * n) + np.diag(np.repeat(springs, 2))
        root = np.sqrt(np.repeat(masses, 2))
        found.append(np.linalg.eigvalsh(D / np.outer(root, root)))
    return np.array(found)


def judge(path, draws=60, seed=20261123):
    """Test a table: decibels at both ports, how many draws of 1 % scatter keep 30 dB, how many kinds of parts it needs."""
    table = read(path)
    weakest = drawn(table, draws, seed)
    return {'dB': decibels(*table), 'kept': int((weakest > 30).sum()), 'draws': draws, 'tenth': float(np.quantile(weakest, 0.1)),
            'strengths': len(np.unique(table[1].round(6))), 'springs': len(np.unique(table[2].round(4)))}


if __name__ == '__main__':
    print(judge(sys.argv[1]))
