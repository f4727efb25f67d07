"""The demultiplexer that comes with the package, checked by a solver of its own: all pairs, and a Hessian by complex steps."""

import csv
from importlib.resources import files

import numpy as np
import pytest

MASS, A, B, GAMMA = 0.707e-3, 4.5824, 1.6209e-10, 4.0
H = 1e-30  # complex step: a derivative without a difference


def table():
    with files('magphonon.data').joinpath('demultiplexer.csv').open(encoding='utf-8', newline='') as file:
        header, *rows = csv.reader(file)
    assert header == ['x_m', 'y_m', 'strength', 'stiffness_N_per_m', 'held']
    return np.array(rows, float).T


def forces(u, X, s, k, pairs):
    """On all magnets that are displaced by u, shape (n, 2)."""
    i, j = pairs
    R = (X + u)[j] - (X + u)[i]
    pull = (B * s[i] * s[j] * ((R**2).sum(1)) ** (-(A + 1) / 2))[:, None] * R
    found = -k[:, None] * u
    np.add.at(found, j, pull)
    np.add.at(found, i, -pull)
    return found


def decibels(X, s, k, held, reach=0.045):
    """How much louder the right port is at 60 and at 80 Hz, of all pairs whose feet are within `reach`."""
    free = np.flatnonzero(held < 0.5)
    pairs = np.nonzero(np.triu(np.linalg.norm(X[:, None] - X, axis=2) < reach, 1))

    def on(v):
        u = np.zeros(X.shape, v.dtype)
        u[free] = v.reshape(-1, 2)
        return forces(u, X, s, k, pairs)[free].ravel()

    rest, first = np.zeros(2 * len(free)), np.linalg.inv(stiffness(on, np.zeros(2 * len(free))))
    for _ in range(200):  # Newton's method with the first stiffness
        step = first @ on(rest)
        rest += step
        if abs(step).max() < 1e-12:
            break
    else:
        raise ValueError('no rest was found')
    K = stiffness(on, rest)
    np.linalg.cholesky(K)  # it is stable
    at = [2 * int(np.hypot(*(X[free] - place).T).argmin()) for place in ([-0.04, 0], [0.03, 0.03464], [0.03, -0.03464])]
    found = []
    for omega in 2 * np.pi * np.array([60, 80]):
        x = np.linalg.solve(K + (1j * GAMMA * omega - omega**2) * MASS * np.eye(len(K)), np.eye(len(K))[at[0]])
        found.append(20 * np.log10(abs(x[at[1]] / x[at[2]])))
    return np.array(found) * [1, -1]


def stiffness(on, v):
    return -np.stack([on(v + 1j * H * e).imag / H for e in np.eye(len(v))], axis=1)


def test_it_keeps_thirty_decibels_each_way():
    x, y, s, k, held = table()
    X = np.stack([x, y], axis=1)
    assert decibels(X, s, k, held).min() > 40
    assert decibels(X, np.ones(len(X)), k, held).min() < 10  # the control: without its strengths it is none


def test_it_is_built_from_a_list():
    x, y, s, k, held = table()
    assert len(x) == 127
    assert np.hypot(x, y).max() == pytest.approx(0.06)
    assert len(np.unique(s)) <= 5
    assert len(np.unique(k)) <= 4
    assert abs(s - 1).max() < 0.15
    assert abs(k / 19.6757 - 1).max() < 0.25
    on_the_rim = np.isclose(np.abs(np.stack([y, x * 3**0.5 / 2 + y / 2, x * 3**0.5 / 2 - y / 2])).max(0), 0.06 * 3**0.5 / 2)
    np.testing.assert_array_equal(held, on_the_rim)


@pytest.mark.slow
def test_it_keeps_them_in_nine_of_ten_lattices_that_scatter():
    x, y, s, k, held = table()
    X, rng = np.stack([x, y], axis=1), np.random.default_rng(31)
    weakest = [decibels(X, *(one * (1 + 0.01 * rng.normal(size=len(X))) for one in (s, k)), held).min() for _ in range(40)]
    assert np.mean(np.array(weakest) > 30) >= 0.9
