"""A smooth law through measured forces that need not be an inverse power, with intervals that contain the true value.

The law is an inverse power times a smooth correction,

    ln f = ln f0 - a ln(r/r0) + w(ln r),     <w(x) w(x')> = tau^2 exp(-(x - x')^2/2)

where w is a Gaussian process: the exponent changes by about tau where the distance changes by a factor e.  The prior of f0 and a
is uniform.  If the force does not follow an inverse power, w differs from zero, so the deviation from an inverse power is part of
the uncertainty.  The size tau of the deviation is unknown.  Without `sigma_N` the size s of the noise is unknown too, and the
force c at which it begins to grow,

    sigma = s (f + c)

with c large for the resolution of a load cell alone, c = 0 for errors of the distance alone; these two cases and
their combination have equal prior probabilities.  The result is an average over all these values, weighted with their posterior
probabilities.  This average is a mixture of normal distributions, which gives the interval of 95 %.  With few points the
likelihood of c varies too strongly by chance: its square root is used, and half a degree of freedom is subtracted for s.
docs/coverage.md says how often the intervals contain the true value.
"""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

from ..errors import positive
from .fits import COVERED, FINEST, Fit, enough
from .pair_laws import Tabulated

if TYPE_CHECKING:
    from typing import Any

    from .force_tables import Forces

BENDS = 0.5, 1.0, 2.0, 4.0
"""Values of tau: from an inverse power within the noise to the tail of a screened force (4, at 5 screening lengths)."""
CROSSINGS = np.array([0.75, 0.5, 0.25])
"""Values of c between the limits, on a logarithmic scale from the smallest force (0) to the largest (1)."""
PRIOR = np.array([len(CROSSINGS), *np.ones_like(CROSSINGS), len(CROSSINGS)]) / (3 * len(CROSSINGS))
"""Prior probabilities of c = infinity, of the values of c above, and of c = 0: a third for each kind of noise."""
SCALES = np.exp(np.arange(-1.0, 3.3, 0.3))
"""Values of s, in units of the residual of a quadratic through the logarithms; with two degrees of freedom the tail is long."""
NODES = 12
"""Number of nodes of the spline that represents w."""
MOST_POINTS = 500
"""Largest number of points that are not averaged.  More points are averaged in intervals of ln r, which changes the force by
a relative 1e-5."""
ROUND_OFF = 1e-6
"""Smallest number of degrees of freedom: if a curve passes through all points, the remainder is round-off of either sign."""
UNLIKELY = 0.01
"""Probability of chi2 below which the given uncertainties are judged too small and are enlarged."""


def fit_spline(forces: Forces, spacing: float) -> Fit:
    """Smooth law through the data: an inverse power with a smooth correction, as a cubic spline of `log f` over `log r`.

    Parameters
    ----------
    forces : Forces
    spacing : float
        Working spacing in mm.

    Returns
    -------
    Fit
        Its law is a `Tabulated` through the nodes of the spline.  Its covariance and intervals do not assume an
        inverse power.  If the given uncertainties explain the scatter only with a probability below UNLIKELY, both are
        enlarged by the square root of chi2/freedom.

    Raises
    ------
    ValueError
        If there are fewer than 4 points, the spacing is far outside them, or the curve does not fall everywhere.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import fit_spline, synthetic_forces
    >>> forces = synthetic_forces(InversePower(2000.0, 4.0), np.linspace(8, 15, 8), sigma=1e-3, seed=0)
    >>> fit = fit_spline(forces, spacing=10.0)
    >>> bool(abs(fit.at_spacing[0] - 0.2) < fit.half_width[0])  # the true force is 0.2 N
    True
    """
    from scipy.interpolate import CubicSpline

    positive('spacing', spacing, 'mm')
    enough(forces.r, 4, 'a smooth curve')
    forces.check_reach(spacing)
    points, counts = forces.binned(MOST_POINTS)
    x, ends = np.log(points.r / spacing), np.log(forces.r[[0, -1]] / spacing)
    nodes = np.linspace(min(ends[0], 0.0), max(ends[1], 0.0), NODES)
    departures, sizes = np.linalg.svd(np.exp(-(np.subtract.outer(nodes, nodes) ** 2) / 2))[:2]
    many = sizes > 1e-9 * sizes[0]
    # contributions to ln f at the nodes
    values = np.column_stack([np.ones(NODES), nodes, departures[:, many] * np.sqrt(sizes[many])])
    basis = CubicSpline(nodes, values)
    design, at = basis(x), np.stack([basis(0.0), basis(0.0, 1)])

    start = quadratic(x, points, counts)
    p, hessian, probability, sigma = average_fits(points, counts, design, start, BENDS)
    mean = probability @ p
    fitted = np.exp(design @ mean)
    r = spacing * np.exp(nodes)
    r[[0, -1]] = min(spacing, forces.r[0]), max(spacing, forces.r[-1])  # taking the logarithm and back changes the last digit
    law = Tabulated(r, np.exp(values @ mean))
    if (np.diff(law.f) >= 0).any():
        raise ValueError('the curve through the points does not fall everywhere; look for an outlier, and drop the far points '
                         'that are noise')

    force, a = np.exp(p @ at[0]), -p @ at[1]
    within = at @ np.linalg.inv(hessian) @ at.T  # covariance of ln f and d ln f/d ln r, in each part of the mixture
    turn = np.zeros((len(p), 2, 2))
    turn[:, 0, 0], turn[:, 1, 0], turn[:, 1, 1] = force, -a * force / spacing, force / spacing
    within_f = turn @ within @ turn.transpose(0, 2, 1)
    parts = np.stack([force, -a * force / spacing], axis=1)
    here = np.exp(at[0] @ mean) * np.array([1, at[1] @ mean / spacing])
    off = parts - here
    covariance = np.einsum('c,cij->ij', probability, within_f + off[:, :, None] * off[:, None, :])
    half = np.array([half_width(probability, off[:, k], np.sqrt(within_f[:, k, k])) for k in range(2)])
    exponent = float(-at[1] @ mean)
    spread = float(np.sqrt(probability @ (within[:, 1, 1] + (a - exponent) ** 2)))

    chi2, freedom = np.nan, float(len(x) - 2)
    if points.sigma is not None:
        hat = np.einsum('cn,ni,cij,nj->c', (fitted / sigma) ** 2, design, np.linalg.inv(hessian), design)
        chi2, freedom = float(np.sum(((points.f - fitted) / sigma[0]) ** 2)), float(max(len(x) - probability @ hat, ROUND_OFF))
        if not explained(chi2, freedom):
            larger = np.sqrt(chi2 / freedom)
            covariance, half, spread = covariance * larger**2, half * larger, spread * larger
    return Fit(law, 'smooth curve', spacing, here, covariance, half, exponent, spread,
               forces.f - np.exp(CubicSpline(nodes, values @ mean)(np.log(forces.r / spacing))), chi2, freedom)


def quadratic(x, points, counts):
    """Forces of a parabola fitted to the logarithms, shape (n,): start of the search, and estimate of the noise."""
    weights = np.sqrt(counts * points.f) if points.sigma is None else points.f / points.sigma
    return np.exp(np.polyval(np.polyfit(x, np.log(points.f), min(2, len(x) - 3), w=weights), x))


def average_fits(points, counts, design, start, bends):
    """Least squares of `ln f = design p` for all noises and bends: the parts of a mixture of normal distributions.

    Parameters
    ----------
    points : Forces
    counts : ndarray, shape (n,)
        Number of measurements that each point averages.
    design : ndarray, shape (n, k)
    start : ndarray, shape (n,)
        Forces from which the search starts, N.
    bends : tuple of float or None
        Values of tau, the prior standard deviation of the parameters from the third on; None where all of them are free.

    Returns
    -------
    p : ndarray, shape (fits, k)
    hessian : ndarray, shape (fits, k, k)
        Inverse of the covariance of each part.
    probability : ndarray, shape (fits,)
    sigma : ndarray, shape (fits, n)
        The noise of each part, N.
    """
    free = design.shape[1] if bends is None else 2
    bends = np.array(bends or [np.inf])
    if points.sigma is not None:
        return _fitted(points.f, np.tile(points.sigma, (len(bends), 1)), bends, design, start, free)
    kinds = range(len(CROSSINGS) + 2)
    kind, scale, bend = (np.array(column) for column in zip(*product(kinds, SCALES, bends), strict=True))
    smooth = start
    for _ in range(2):  # the noise depends on the smooth force; the measured force is itself noisy
        shape = _noises(smooth)[kind] / np.sqrt(counts)
        left = (points.f - start) / shape
        freedom = max(len(start) - 3, 1)
        s = scale * np.maximum(np.sqrt(np.sum(left**2, axis=1) / freedom), 1e-9 * points.f.max())
        p, hessian, probability, sigma = _fitted(points.f, s[:, None] * shape, bend, design, start, free, prior=np.sqrt(scale))
        share = np.array([probability[kind == one].sum() for one in kinds])
        probability *= (PRIOR / np.sqrt(np.maximum(share, 1e-300)))[kind]
        probability /= probability.sum()
        smooth = np.exp(design @ (probability @ p))
    return p, hessian, probability, sigma


def _noises(f):
    """Possible growths of the noise with the force: constant, f + c, and f, each of geometric mean 1, shape (kinds, n)."""
    sums = [f + f.min() ** (1 - q) * f.max() ** q for q in CROSSINGS]
    shapes = np.stack([np.ones_like(f), *sums, f])
    return shapes / np.exp(np.log(shapes).mean(axis=1, keepdims=True))


def _fitted(f, sigma, bend, design, start, free, prior: Any = 1.0):
    """Gauss-Newton least squares with the prior of the parameters from `free` on, for all `sigma` (fits, n) and `bend`."""
    sigma = np.maximum(sigma, FINEST * f)
    k = design.shape[1]
    precision = np.append(np.zeros(free), np.ones(k - free)) / bend[:, None] ** 2
    products = (design[:, :, None] * design[:, None, :]).reshape(len(f), k * k)
    first = np.linalg.solve(design.T @ design + 1e-6 * np.diag(precision[-1] > 0), design.T @ np.log(start))
    p = np.tile(first, (len(sigma), 1))
    for _ in range(50):
        model = np.exp(p @ design.T)
        hessian = ((model / sigma) ** 2 @ products).reshape(-1, k, k) + precision[:, :, None] * np.eye(k)
        step = np.linalg.solve(hessian, (((f - model) * model / sigma**2) @ design - precision * p)[:, :, None])[:, :, 0]
        change = abs(step @ design.T).max(axis=1)
        p = p + step * np.minimum(1, 0.5 / np.maximum(change, 0.5))[:, None]  # ln f changes by 1/2 at most
        if change.max() < 1e-6:  # Gauss-Newton steps converge fast: the remaining error is far below the noise
            break
    evidence = (-np.sum(((f - np.exp(p @ design.T)) / sigma) ** 2, axis=1) / 2 - np.sum(np.log(sigma), axis=1)
                - np.sum(precision * p**2, axis=1) / 2
                - (np.log(bend) * (k - free) if k > free else 0.0) - np.linalg.slogdet(hessian)[1] / 2)
    probability = np.exp(evidence - evidence.max()) * prior
    return p, hessian, probability / probability.sum(), sigma


def half_width(probability, off, sigma) -> float:
    """Distance from zero within which a mixture of normal distributions has the probability COVERED."""
    from scipy.optimize import brentq
    from scipy.special import ndtr

    def beyond(h):
        return probability @ (ndtr((h - off) / sigma) - ndtr((-h - off) / sigma)) - COVERED

    width: Any = brentq(beyond, 0.0, np.max(abs(off) + 10 * sigma))
    return width


def explained(chi2: float, freedom: float) -> bool:
    """Whether chance explains a chi2 as large as this; always true for a chi2 below its degrees of freedom.

    Examples
    --------
    >>> from magphonon.interactions import explained
    >>> explained(chi2=9.0, freedom=10), explained(chi2=60.0, freedom=10)
    (True, False)
    """
    from scipy.stats import chi2 as chi_squared

    return bool(chi2 <= freedom or chi_squared.sf(chi2, freedom) >= UNLIKELY)
