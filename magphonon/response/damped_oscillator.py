"""Exact response of damped oscillators to a force: `y'' + gamma y' + w2 y = f(t)`, exactly, for many w2 at once.

With W^2 = w2 - gamma^2/4, the free motion over a time t is made of

    c = e^{-gamma t/2} cos(W t)        s = e^{-gamma t/2} sin(W t)/W

    y(t) = (c + gamma/2 s) y(0) + s y'(0) + int_0^t s(t - t') f(t') dt'

which are smooth in w2 through critical damping (W = 0), overdamped and unstable oscillators (W imaginary).  The integral
is Gauss's, on panels short enough for the fastest oscillator and for the force.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import Any

    from numpy.typing import NDArray

NODES = 16
"""Number of Gauss points on a panel; they integrate polynomials of degree 31 exactly."""
TURN = 8.0
"""Longest panel in rad of the fastest oscillation, whose motion there is a polynomial of degree 16 up to round-off."""
PANELS = 20_000
"""Largest number of panels; a force that needs more is not a smooth function of time."""
_x, _w = np.polynomial.legendre.leggauss(NODES)
POINTS, WEIGHTS = (1 + _x) / 2, _w / 2
_TOP = (np.polynomial.legendre.legvander(_x, NODES - 1) * _w[:, None] * (np.arange(NODES) + 0.5))[:, -2:].T
"""The last two Legendre coefficients of a function on a panel, from its values at the points."""


def free_motion(w2: NDArray[np.float64], gamma: float, t: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The functions c and s above; `w2` (rad^2/ms^2) and `t` (ms) broadcast, `gamma` is in 1/ms."""
    W2 = w2 - gamma**2 / 4
    W, decay = np.sqrt(abs(W2)), np.exp(-gamma * t / 2)
    c, s = decay * np.cos(W * t), decay * t * np.sinc(W * t / np.pi)
    if (W2 < 0).any():
        W = np.where(W2 < 0, W, 1.0)
        slow = np.exp(np.where(W2 < 0, -w2 / (W + gamma / 2), 0) * t)  # W - gamma/2 without its cancellation
        c = np.where(W2 < 0, slow * (1 + np.exp(-2 * W * t)) / 2, c)
        s = np.where(W2 < 0, slow * -np.expm1(-2 * W * t) / (2 * W), s)
    return c, s


def free_response(w2: NDArray[np.float64], gamma: float, t: Any) -> NDArray[np.float64]:
    """Matrix from (y, y') at zero to (y, y') at t, shape (2, 2, ...)."""
    c, s = free_motion(w2, gamma, t)
    return np.array([[c + gamma / 2 * s, s], [-w2 * s, c - gamma / 2 * s]])


def sampled(force: Callable[..., Any], edges: NDArray[np.float64], rate: float,
            tolerance: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Split the time between the first and last of the `edges` into panels that resolve oscillators and force.

    Parameters
    ----------
    force : function
        From times, shape (times,), to forces, shape (times, components).
    edges : ndarray
        Increasing times in ms at which panels must end.
    rate : float
        Angular frequency of the fastest oscillator in rad/ms.
    tolerance : float
        Share of the impulse that may be missed at a kink of the force.

    Returns
    -------
    edges : ndarray, shape (panels + 1,)
    values : ndarray, shape (panels, NODES, components)

    Raises
    ------
    ValueError
        If the force cannot be resolved.
    """
    pieces = np.ceil(np.diff(edges) * rate / TURN).astype(int)
    if pieces.sum() > PANELS:
        raise ValueError(f'in {edges[-1] - edges[0]:g} ms the fastest motion, at {rate:g} rad/ms, needs {pieces.sum()} panels, '
                         f'over {PANELS}; ask for a shorter time or less damping')
    if len(edges) == 1:
        return edges, np.repeat(force(edges[:0])[:, None], NODES, axis=1)
    starts = np.concatenate([np.linspace(a, b, n, endpoint=False) for a, b, n in zip(edges[:-1], edges[1:], pieces, strict=True)])
    pending, kept, impulse = np.stack([starts, np.append(starts[1:], edges[-1])]), [], None
    while pending.shape[1]:
        a, h = pending[0], np.diff(pending, axis=0)[0]
        values = force((a[:, None] + h[:, None] * POINTS).ravel())
        values = values.reshape(len(a), NODES, values.shape[1])
        if impulse is None:
            impulse = (h[:, None] * abs(values).max(axis=2, initial=0.0) * WEIGHTS).sum()
        left = h * abs(np.tensordot(_TOP, values, (1, 1))).max(axis=(0, 2), initial=0.0)
        rough = left > tolerance * impulse
        kept.append((a[~rough], pending[1][~rough], values[~rough]))
        middle = pending.mean(axis=0)[rough]
        pending = np.stack([np.append(a[rough], middle), np.append(middle, pending[1][rough])])
        if sum(len(k[0]) for k in kept) + pending.shape[1] > PANELS:
            raise ValueError(f'the drive cannot be resolved near {middle[0]:.9g} ms; it must be a function of the time that is '
                             'smooth but for a few kinks and steps')
    a, b, values = (np.concatenate(parts) for parts in zip(*kept, strict=True))
    order = np.argsort(a)
    return np.append(a[order], b[order[-1]]), values[order]


def separated(values: NDArray[np.float64], tolerance: float = 1e-15) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Forces as a sum of products of a time course and a pattern, `values = sum_r course_r pattern_r`.

    Cross approximation with full pivots: exact after as many terms as there are independent time courses.

    Parameters
    ----------
    values : ndarray, shape (times, components)

    Returns
    -------
    courses : ndarray, shape (times, terms)
    patterns : ndarray, shape (terms, components)
    """
    rest, courses, patterns = values.copy(), [], []
    largest = abs(values).max(initial=0.0)
    while rest.size and len(courses) < min(values.shape):
        t, x = np.unravel_index(abs(rest).argmax(), rest.shape)
        if abs(rest[t, x]) <= tolerance * len(values) ** 0.5 * largest:
            break
        courses.append(rest[:, x] / rest[t, x])
        patterns.append(rest[t].copy())
        rest -= np.outer(courses[-1], patterns[-1])
    return np.array(courses).reshape(len(courses), len(values)).T, np.array(patterns).reshape(len(patterns), values.shape[1])


def forced_response(w2: NDArray[np.float64], gamma: float, edges: NDArray[np.float64], courses: NDArray[np.float64],
                    outputs: NDArray[np.int_]) -> NDArray[np.float64]:
    """Motion from rest at the first edge under forces given at the points of the panels.

    Parameters
    ----------
    w2 : ndarray, shape (oscillators,)
    gamma : float
    edges : ndarray, shape (panels + 1,)
    courses : ndarray, shape (panels, NODES, terms)
    outputs : ndarray of int
        Increasing indices of the edges at which the motion is wanted.

    Returns
    -------
    ndarray, shape (outputs, 2, terms, oscillators)
        y and y'.
    """
    lengths = np.diff(edges)
    kind = np.unique(np.round(lengths / (64 * np.finfo(float).eps * edges[-1])), return_inverse=True)[1]
    lengths = np.bincount(kind, lengths) / np.bincount(kind)  # those that differ by round-off share their tables
    tables = []
    for h in lengths:
        c, s = free_motion(w2, gamma, h * (1 - POINTS)[:, None])
        tables.append((free_response(w2, gamma, h), h * np.stack([s, c - gamma / 2 * s]) * WEIGHTS[:, None]))
    wanted = np.zeros(len(edges), bool)
    wanted[outputs] = True
    y, found = np.zeros((2, courses.shape[2], len(w2))), []
    for k in range(len(edges)):
        if wanted[k]:
            found.append(y)
        if k < len(kind):
            flow, push = tables[kind[k]]
            y = (flow[:, :, None] * y).sum(axis=1) + courses[k].T @ push
    return np.array(found)
