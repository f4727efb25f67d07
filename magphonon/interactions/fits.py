r"""The law of repulsion from measured forces whose rows share errors: a zero of force, a zero of distance, hysteresis, backlash.

Each row of a table is

    y = e^z f(r + d + s b/2) + F0 + s h + noise        s = -1 on the approach, +1 on the return, 0 where it is not known

and the force is a free smooth curve; if the user names the shape of the magnets, their law g is fitted too. The noise includes
that of the distance of the row, times the slope of the force. Both laws have the form

    ln f = ln f0 + ln g(r)/g(r0) - delta x + 2.5 tau sum_s c_s (x - (1 - e^(-s x))/s)        x = ln(r/r0),  s = 1, 4

The exponent is a at r0 and relaxes to a - 2.5 tau (c_1 + c_4) far away.  The free curve has g = r^-4, delta within 3 and tau = 1;
for a named law both are 0.03.  ln f(r0) and the exponent a(r0)
are parameters themselves, so their covariance is the answer: -f'(r0) = a f/r0, and the bands of neighbours at r0 follow linearly.
Each pair of magnets has its own z: the scatter from pair to pair is estimated from several pairs, or given. A load cell drifts:
slow waves over the rows, in the order in which they were measured, are part of the noise. A table cannot determine everything: F0
looks like the tail of the law, and d like a change of its exponent. There the priors of `SharedErrors` decide, and `Fit.shares`
says how much each of them contributes to the variance.

A least-squares problem is solved for each law, each of three kinds of noise and three sizes of drift; the answers are averaged
by their evidence (Laplace's method).  There is no list of laws to choose from: over 8 to 16 mm a disc, a ring and
an inverse power cannot be distinguished, and an average over such a list is both narrow and wrong.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, stdtrit  # scipy.stats has them too, and takes half a second to import

from .. import units as u
from ..errors import not_negative, positive
from .force_tables import Forces
from .law_cards import LawDerivative
from .pair_laws import PairLaw, Tabulated, local_exponent, repulsion

COVERED, NORMAL = 0.95, 1.959964
"""Probability with which an interval contains the true value, and its half width in standard deviations where these are known."""
RATES, RELAXES = np.array([1.0, 4.0]), 2.5
"""Rates in ln(r/r0) at which an exponent may relax to another one far away, and standard deviation of its change by each."""
ANY_SIZE, EXPONENT, EXPONENT_SPREAD = 3.0, 4.0, 3.0
"""Priors of the free curve: ln f0 is known to +- 3 from the table, and the exponent is 4 +- 3."""
SHAPE_TOLERANCE, SHAPE_WEIGHT = 0.03, 0.1
"""How well a named magnet has its shape, and the prior weight of its law. A law that is nearly right, such as that of dipoles
for a screened law, cannot be recognised over 8 to 16 mm; with a weight of one half it would shift the interval."""
NOISES = None, 0.5, 0.0
"""Kinds of noise: the same everywhere, or proportional to the force above the middle one, or above the smallest one."""
NEAREST = 0.3  # smallest distance at which a law is evaluated, relative to the nearest in the table, for any zero of distance
ROUNDS = 4  # times that noise and force are computed from each other: they settle to parts in a thousand
LEAST_ROWS, MOST_ROWS = 6, 2000
"""Least number of rows that also determine their noise, and largest number that is fitted, every n-th row of a longer table:
more rows do not improve what all rows share."""
FINEST = 1e-4
"""Least standard deviation of a row, as a share of its force: the free curve cannot follow other laws more closely."""
UNLIKELY = 0.01
"""Probability of the scatter of the rows below which their given uncertainty is widened by it."""
CONFLICT = 3.0  # standard deviations from its prior beyond which a zero, or the named shape, is wrong
CURVE = slice(0, 2 + len(RATES))
FORCE_ZERO, DISTANCE_ZERO, HYSTERESIS, BACKLASH = range(CURVE.stop, CURVE.stop + 4)  # places of the parameters
ZEROS = slice(FORCE_ZERO, BACKLASH + 1)  # and the z of each pair after them
LARGEST = 100.0
"""Largest zero of the force, in largest forces."""
DRIFTS, WAVES = (0.0, 1.0, 3.0), 8
"""Sizes of a drift that are tried, in the noise of a row, and the number of slow waves over the table that it is made of."""
ANY_PAIR = 0.3  # standard deviation of ln f from pair to pair before the table is read
SHARED = 'zero of force', 'zero of distance', 'hysteresis', 'backlash'
CAUSES = 'unknown law', *SHARED, 'pairs', 'noise', 'gain'  # of the variance of the slope
POINTS = 24  # of the table of a fitted law; a spline through them follows it to 1e-5


@dataclass(frozen=True)
class SharedErrors:
    """Standard deviations of the errors that all rows of a table share, known before the table is read.

    Attributes
    ----------
    distance : float
        Error of the zero of the distances in mm: contact, glue and tolerances of the magnets contribute 0.1 mm each. It
        dominates the width of the intervals: 9.5 % of the slope for each 0.1 mm at 10 mm.
    zero : float, optional
        Error of the zero of the force in N; by default a tenth of the largest force, and a thousandth on a balance.
    hysteresis : float, optional
        Half the difference between the forces on return and on approach, in N; by default a hundredth of the largest force.
    backlash : float
        Backlash of the drive in mm.
    gain : float
        Error of the gain of the load cell, as a fraction of every force; a table contains no information about it.
    pair : float, optional
        Relative standard deviation of the force from pair to pair, 1.4 times that of single strengths.  By default it is
        estimated if several pairs were measured; for a single pair nothing is added.
    """

    distance: float = 0.2
    zero: float | None = None
    hysteresis: float | None = None
    backlash: float = 0.1
    gain: float = 0.01
    pair: float | None = None

    def __post_init__(self) -> None:
        for name, unit in {'distance': 'mm', 'zero': 'N', 'hysteresis': 'N', 'backlash': 'mm', 'gain': '', 'pair': ''}.items():
            if getattr(self, name) is not None or name not in ('zero', 'hysteresis', 'pair'):
                not_negative(name, getattr(self, name), unit)

    def sizes(self, forces: Forces) -> NDArray[np.float64]:
        """Standard deviations of F0, d, h and b for a table; zero is replaced by a tiny number."""
        largest = abs(forces.f).max()
        zero = largest / (1000 if forces.balance else 10) if self.zero is None else self.zero
        hysteresis = largest / 100 if self.hysteresis is None else self.hysteresis
        return np.maximum([zero, self.distance, hysteresis, self.backlash], 1e-9 * np.array([largest, 1, largest, 1]))


@dataclass(frozen=True)
class Fit:
    """The force of two particles and its exponent at a spacing r0, with their uncertainty.

    Attributes
    ----------
    law : Tabulated
        The fitted curve over the distances of the table and r0, corrected for the zero of the distances; it ends where it no
        longer falls as fast as 1/r.
    spacing : float
        r0 in mm.
    force, exponent : float
        f(r0) in N, and a(r0) = -d ln f/d ln r.
    covariance : ndarray, shape (2, 2)
        Covariance of ln f and a, including the gain of the load cell. Noise that is learned from the table counts as much more as
        Student's distribution is wider than the normal one.
    shares : dict of str to float
        Shares of the variance of the slope by their cause; they add up to one.
    zeros : ndarray, shape (4,)
        The fitted errors of the table: F0 in N, d in mm, h in N and b in mm.
    zero_sigma : float
        Standard uncertainty of F0 in N, which is subtracted from every row.
    weight : float
        Weight of the named shape against the free curve; 0 if no shape is named.
    conflicts : ndarray, shape (4,)
        Distances of `zeros` from their priors, in the standard deviations expected in such tables; beyond CONFLICT the error is
        larger than was stated.
    pair : float
        Standard deviation of ln f from pair to pair, as given or learned; 0 for a single pair without information.
    drift : float
        Probability that the load cell drifts, so that successive rows have similar errors.
    scatter : float
        Factor by which the given uncertainties of the rows were enlarged because the rows scatter more; 1 if they do not.
    residuals, noise : ndarray, shape (rows,)
        Measured minus fitted force and its standard deviation, N.
    """

    law: Tabulated
    spacing: float
    force: float
    exponent: float
    covariance: NDArray[np.float64]
    shares: dict[str, float]
    zeros: NDArray[np.float64]
    zero_sigma: float
    weight: float
    conflicts: NDArray[np.float64]
    pair: float
    drift: float
    scatter: float
    residuals: NDArray[np.float64] = field(repr=False)
    noise: NDArray[np.float64] = field(repr=False)

    @property
    def slope(self) -> float:
        """Slope df/dr of the force at the spacing in N/mm; it is negative."""
        return -self.exponent * self.force / self.spacing

    @property
    def half_widths(self) -> NDArray[np.float64]:
        """Half widths of the 95 % intervals of ln f, ln(-f') and a."""
        turns = np.array([[1, 0], [1, 1 / self.exponent], [0, 1]])
        return NORMAL * np.sqrt(np.einsum('ta,ab,tb->t', turns, self.covariance, turns))

    @property
    def intervals(self) -> NDArray[np.float64]:
        """Ends of the 95 % intervals, shape (3, 2): of f in N, of -df/dr in N/mm and of a."""
        f, slope, a = self.half_widths[:, None] * (-1, 1)
        return np.array([self.force * np.exp(f), -self.slope * np.exp(slope), self.exponent + a])


def fit_forces(forces: Forces, spacing: float, shared: SharedErrors | None = None, shape: PairLaw | None = None) -> Fit:
    """The force and its exponent at a spacing, from a table whose rows share errors.

    Parameters
    ----------
    forces : Forces
        Rows in any order, also repeated ones.  Keep negative forces at large distances: their mean fixes the zero of the force.
    spacing : float
        r0 in mm.
    shared : SharedErrors, optional
    shape : PairLaw, optional
        The law of the magnets, if their shape is known, such as `magnet_law(Ring(...))`; its strength stays free.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import Forces, SharedErrors, fit_forces, repulsion
    >>> r, noise = np.linspace(8, 15, 8), np.random.default_rng(0).normal(scale=1e-3, size=8)
    >>> forces = Forces(r, repulsion(InversePower(2000.0, 4.0), r) + noise, np.full(8, 1e-3))
    >>> fit = fit_forces(forces, 10.0, SharedErrors(distance=0.05))
    >>> bool(abs(fit.exponent - 4) < fit.half_widths[2])
    True
    """
    shared = shared or SharedErrors()
    forces.check_reach(positive('spacing', spacing, 'mm'))
    known = forces.sigma is not None
    if not known and len(forces.r) < LEAST_ROWS:
        raise ValueError(f'{len(forces.r)} rows are too few to determine the law and their noise: '
                         f'measure at least {LEAST_ROWS}, or give the '
                         'standard uncertainty of each force in a column sigma_N')
    forces = forces.thinned(MOST_ROWS)
    _refuse_large(shared, forces)
    shared = _with_pairs(forces, shared, spacing)
    average = _averaged(forces, shared, LawFamily(spacing), shape and LawFamily(spacing, shape))
    (ln_f, a), covariance, best = average.mean, average.covariance, average.best
    if not a > 2 * np.sqrt(covariance[1, 1]):
        raise ValueError(f'within their uncertainties, the forces need not fall with the distance (a = {a:.3g} with a standard '
                         f'uncertainty of {np.sqrt(covariance[1, 1]):.2g}); are the columns exchanged, or is all of it noise?')
    nearest, farthest = forces.r.min() + best.p[DISTANCE_ZERO], forces.r.max() + best.p[DISTANCE_ZERO]
    if nearest <= 0:
        raise ValueError(f'the smallest distance, {forces.r.min() / u.m:g} m, lies within the error of the zero of distances; '
                         'check its unit, or remove the point')
    return Fit(law=average.law(min(nearest, spacing), max(farthest, spacing), spacing), spacing=float(spacing),
               force=float(np.exp(ln_f)), exponent=float(a), covariance=covariance,
               shares=average.shares, zeros=best.p[ZEROS],
               zero_sigma=float(np.sqrt(best.covariance[FORCE_ZERO, FORCE_ZERO])), weight=average.weight(shape),
               conflicts=best.conflicts, pair=shared.pair or 0.0, drift=average.weight_of_drift,
               scatter=float(best.size) if known else 1.0, residuals=best.residuals, noise=best.noise)


def _refuse_large(shared, forces):
    """Raise ValueError for a shared error that is larger than what was measured."""
    largest = abs(forces.f).max()
    zero, distance, hysteresis, backlash = shared.sizes(forces) / np.array([largest, forces.r.min()] * 2)
    if not (max(zero, hysteresis) <= LARGEST and max(distance, backlash, shared.gain) <= 1):
        raise ValueError('a shared error is larger than what was measured: the zero of the distances and the backlash must be '
                         'below the nearest distance, the zero of the force and the hysteresis below a hundred times the largest '
                         'force, the gain below 1; give smaller standard uncertainties')


class LawFamily:
    """All smooth laws, or all laws near that of a magnet of known shape: ln f as a function of p = (ln f0, delta, c_1, c_4).

    Parameters
    ----------
    r0 : float
        The spacing in mm.
    shape : PairLaw, optional
        The law of the magnets, if their shape is known.
    """

    def __init__(self, r0: float, shape: PairLaw | None = None) -> None:
        self.r0, self.shape = r0, shape
        if shape is None:
            self.log_law, self.tau, self.spread = lambda r: (-EXPONENT * np.log(r / r0), -EXPONENT), 1.0, EXPONENT_SPREAD
        else:
            self.log_law, self.tau, self.spread = _log_law(shape, r0), SHAPE_TOLERANCE, SHAPE_TOLERANCE

    def slopes(self, r: Any) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Derivatives of ln f and of d ln f/d ln r by p, shape (distances, 4)."""
        x = np.log(np.asarray(r) / self.r0)[:, None]
        relaxed = -np.expm1(-RATES * x)
        return (np.hstack([x**0, -x, RELAXES * self.tau * (x - relaxed / RATES)]),
                np.hstack([0 * x, -(x**0), RELAXES * self.tau * relaxed]))

    def curve(self, p: Any, r: Any) -> tuple[NDArray[np.float64], ...]:
        """Logarithm of f in N, its derivatives by p, and d ln f/d ln r, at distances in mm."""
        (ln_g, falls), (by_p, bent) = self.log_law(np.asarray(r)), self.slopes(r)
        return ln_g + by_p @ p, by_p, falls + bent @ p

    def change(self, law: PairLaw, v: Any) -> LawDerivative:
        """Derivative of a law of the family along v, a direction of p."""
        def along(r):
            return [np.reshape(one @ v, np.shape(r)) for one in self.slopes(np.ravel(r))]

        return LawDerivative(lambda r: along(r)[0] * law.dphi(r),
                             lambda r: along(r)[0] * law.d2phi(r) + along(r)[1] / r * law.dphi(r))


@dataclass(frozen=True)
class FamilyLaw:
    """The law of a `LawFamily` with the parameters p; its energy is zero at r0."""

    family: LawFamily
    p: Any

    def phi(self, r: Any) -> Any:
        x, weights = np.polynomial.legendre.leggauss(24)
        half = np.log(np.asarray(r) / self.family.r0) / 2
        s = self.family.r0 * np.exp(half[..., None] * (1 + x))
        return half * ((s * self.dphi(s)) @ weights)

    def dphi(self, r: Any) -> Any:
        return -np.exp(self.family.curve(self.p, np.ravel(r))[0]).reshape(np.shape(r))

    def d2phi(self, r: Any) -> Any:
        return self.dphi(r) * self.family.curve(self.p, np.ravel(r))[2].reshape(np.shape(r)) / r


class _Model:
    """Model of a table as a function of p = (ln f0, delta, c_1, c_4, F0, d, h, b), with prior standard deviations of p."""

    def __init__(self, forces, shared, family):
        self.r, self.s, self.sigma_r, self.family = forces.r, forces.direction, forces.sigma_r, family
        self.nearest = NEAREST * forces.r.min()
        near = abs(forces.r - family.r0)
        self.ln_size = np.log(max(forces.f[near == near.min()].mean(), 1e-3 * abs(forces.f).max()))  # from which ln f0 counts
        self.of_pair = (forces.pair[:, None] == np.unique(forces.pair)) * 1.0 if shared.pair else np.zeros((len(forces.r), 0))
        self.prior = np.concatenate([[ANY_SIZE, family.spread], np.ones(len(RATES)), shared.sizes(forces),
                                     np.full(self.of_pair.shape[1], shared.pair)]).astype(float)

    def curve(self, p, r):
        """Logarithm of f at true distances, its derivatives by the parameters of the curve, and d ln f/d ln r."""
        ln_f, by_p, falls = self.family.curve(p[CURVE], r)
        return self.ln_size + ln_f, by_p, falls

    def rows(self, p):
        """The forces in the table, their derivatives by p, and the true forces."""
        away = self.r + p[DISTANCE_ZERO] + self.s * p[BACKLASH] / 2
        r = np.maximum(away, self.nearest)
        ln_f, by_p, falls = self.curve(p, r)
        f = np.exp(np.minimum(ln_f + self.of_pair @ p[ZEROS.stop:], 600.0))  # too long a step of the solver would overflow
        slope = np.where(away > self.nearest, f * falls / r, 0.0)
        derivatives = np.column_stack([by_p * f[:, None], np.ones_like(f), slope, self.s, self.s * slope / 2,
                                       self.of_pair * f[:, None]])
        return f + p[FORCE_ZERO] + self.s * p[HYSTERESIS], derivatives, f


@dataclass(frozen=True)
class _Solution:
    """Parameters of a model, their covariance, the noise of the rows and whether it is known, residuals, and ln evidence."""

    model: _Model
    p: np.ndarray
    C: np.ndarray
    known: bool
    freedom: float
    noise: np.ndarray
    residuals: np.ndarray
    evidence: float
    size: float
    drift: float

    @property
    def answer(self):
        """The estimates of ln f(r0) and a(r0)."""
        return self.model.ln_size + self.p[0], -float(self.model.curve(self.p, np.array([self.model.family.r0]))[2][0])

    @property
    def covariance(self):
        """Covariance of the parameters; only its part by noise is wider where that is learned from a few rows."""
        by_prior = self.C / self.model.prior
        told, student = by_prior @ by_prior.T, 1.0 if self.known else stdtrit(self.freedom, (1 + COVERED) / 2) / NORMAL
        return told + student**2 * (self.C - told)

    @property
    def conflicts(self):
        """Distances of the shared errors from their priors, in the standard deviations of the estimates from table to table."""
        variances = np.diag(self.C)[ZEROS]
        told = np.maximum(self.model.prior[ZEROS] ** 2 - variances, 1e-6 * variances)
        return abs(self.p[ZEROS]) / np.sqrt(told)

    def causes(self, turn):
        """Parts of the variance of turn . (ln f, a) due to the priors of the curve, each shared error, and the noise.

        If the value of prior j changes, the estimate changes by C p_j/prior_j^2. The parts add up to the variance.
        """
        by_prior = (turn @ self.C[:2] / self.model.prior) ** 2
        return np.array([by_prior[CURVE].sum(), *by_prior[ZEROS], by_prior[ZEROS.stop:].sum(),
                         turn @ self.covariance[:2, :2] @ turn - by_prior.sum()])


@dataclass(frozen=True)
class _Average:
    """Solutions for each law, kind of noise and drift, averaged by their evidence, and the error of the gain."""

    found: list[_Solution]
    weights: np.ndarray
    gain: float

    @property
    def best(self) -> _Solution:
        return self.found[int(self.weights.argmax())]

    @property
    def mean(self):
        """The estimates of ln f(r0) and a(r0)."""
        return self.weights @ [one.answer for one in self.found]

    @property
    def apart(self):
        """Covariance of ln f and a because the solutions differ."""
        off = np.array([one.answer for one in self.found]) - self.mean
        return np.einsum('i,ia,ib->ab', self.weights, off, off)

    @property
    def covariance(self):
        """Covariance of ln f and a."""
        own = np.einsum('i,iab->ab', self.weights, [one.covariance[:2, :2] for one in self.found])
        return own + self.apart + np.diag([self.gain**2, 0.0])

    @property
    def shares(self) -> dict[str, float]:
        """Shares of the variance of the slope by their cause."""
        turn = np.array([1, 1 / self.mean[1]])  # from ln f and a to ln(-f') = ln f + ln a - ln r0
        causes = np.append(self.weights @ [one.causes(turn) for one in self.found], self.gain**2)
        causes[0] += turn @ self.apart @ turn
        return dict(zip(CAUSES, (causes / causes.sum()).tolist(), strict=True))

    def weight(self, shape):
        """Weight of the solutions whose law has this shape."""
        return float(sum(self.weights[k] for k, one in enumerate(self.found) if shape and one.model.family.shape is shape))

    @property
    def weight_of_drift(self):
        return float(self.weights @ [one.drift > 0 for one in self.found])

    def law(self, nearest, farthest, spacing):
        """The curve between two distances, until it no longer falls as fast as 1/r."""
        r = np.unique(np.append(np.geomspace(nearest, farthest, POINTS), spacing))
        curve, falls = np.einsum('i,ikr->kr', self.weights, [one.model.curve(one.p, r)[::2] for one in self.found])
        falling = np.cumprod((falls < -1) | (r <= spacing)) > 0  # noise at large distances is no law
        return Tabulated(r[falling], np.exp(curve[falling]))


def _averaged(forces, shared, free, shaped):
    """The average over the free curve and, where the shape of the magnets is known, the laws near theirs."""
    found, prior = [], []
    for family, before in [(free, 1 - SHAPE_WEIGHT), (shaped, SHAPE_WEIGHT)] if shaped else [(free, 1.0)]:
        model = _Model(forces, shared, family)
        for noise in NOISES if forces.sigma is None else (None,):
            steady = _solved(model, forces, noise)
            found += [_solved(model, forces, noise, drift, steady) if drift else steady for drift in DRIFTS]
            prior += [before] * len(DRIFTS)
    evidence = np.array([one.evidence for one in found]) + np.log(prior)
    weights = np.exp(evidence - evidence.max())
    return _Average(found, weights / weights.sum(), shared.gain)


def _with_pairs(forces, shared, spacing):
    """The shared errors with the scatter from pair to pair, which is estimated from several pairs if it is not given."""
    if shared.pair is not None or forces.pairs == 1:
        return shared
    loose = _solved(_Model(forces, replace(shared, pair=ANY_PAIR), LawFamily(spacing)), forces, None)
    own, n = loose.p[ZEROS.stop:], forces.pairs
    away = np.eye(n) - 1 / n  # from their mean, which the force at the spacing takes up
    noise = np.trace(away @ loose.C[ZEROS.stop:, ZEROS.stop:] @ away)
    seen = np.sqrt(max(own @ away @ own - noise, 0.1 * own @ away @ own) / (n - 1))
    return replace(shared, pair=float(max(seen * stdtrit(n - 1, (1 + COVERED) / 2) / NORMAL, FINEST)))


def _slow(rows, sigma, size):
    """Directions and sizes of slow waves over the rows, in units of the noise of each row, from which C^(-1/2) is made."""
    k = np.arange(1, min(WAVES, rows - 1) + 1)
    waves = np.cos(np.pi * k * (np.arange(rows)[:, None] + 0.5) / rows) * np.sqrt(2 / k)  # of equal power in each octave: 1/f
    U, S, _ = np.linalg.svd(size * waves / sigma[:, None], full_matrices=False)
    return U, S


def _solved(model, forces, noise, drift=0.0, near=None):
    """Least-squares solution for one kind of noise, whose size is estimated from the residuals unless the table states it.

    With a drift the noise has the covariance C of `_slow`, and rows divided by their noise are multiplied by C^(-1/2).  A known
    solution `near` this one saves iterations.
    """
    from scipy.optimize import least_squares
    y, prior, known = forces.f, model.prior, forces.sigma is not None
    p = np.zeros(len(prior))
    shape, size = forces.sigma if known else np.ones_like(y), 1.0 if known else np.sqrt(np.mean((y - model.rows(p)[0]) ** 2))
    rounds = 2 + bool(model.sigma_r.any()) if known else ROUNDS + ROUNDS * (noise is not None)
    if near is not None:
        p, size = near.p, near.size
    for k in range(rounds - 2 if near is not None else 0, rounds):
        if noise is not None and k >= ROUNDS:  # when constant noise has shown about where the curve lies
            f = model.rows(p)[2]
            shape = np.sqrt(1 + (f / (max(f.min(), 1e-3 * f.max()) ** (1 - noise) * f.max() ** noise)) ** 2)
        by_distance = model.rows(p)[1][:, DISTANCE_ZERO] * model.sigma_r
        sigma = np.hypot(np.hypot(size * shape, by_distance), FINEST * abs(y) + FINEST**2 * abs(y).max())
        U, S = _slow(len(y), sigma, drift * size * np.median(shape))

        def white(one, U=U, S=S, sigma=sigma) -> Any:
            """Forces or their derivatives in units of the noise, which is then white."""
            one = (one.T / sigma).T
            return one - U @ (((1 - 1 / np.sqrt(1 + S**2)) * (U.T @ one).T).T)

        found = least_squares(lambda p, white=white: np.concatenate([white(y - model.rows(p)[0]), p / prior]), p,
                              lambda p, white=white: np.vstack([-white(model.rows(p)[1]), np.diag(1 / prior)]),  # pyright: ignore[reportArgumentType]
                              x_scale=prior, ftol=1e-12, xtol=1e-12)
        p, J = found.x, found.jac[: len(y)]
        precision = found.jac.T @ found.jac
        C = np.linalg.inv(precision)
        freedom, e = max(len(y) - np.trace(C @ J.T @ J), 1.0), y - model.rows(p)[0]
        scatter = np.sqrt(np.sum(white(e) ** 2) / freedom)
        if not known or chdtrc(freedom, freedom * scatter**2) < UNLIKELY:
            size *= scatter
    evidence = -0.5 * (2 * np.log(sigma).sum() + np.log1p(S**2).sum() + 2 * found.cost + np.linalg.slogdet(precision)[1]
                       + 2 * np.log(prior).sum() + (0.0 if known else np.log(freedom)))
    return _Solution(model, p, C, known, freedom, sigma, e, evidence, size, drift)


def _log_law(law: PairLaw, r0: float) -> Callable:
    """Logarithm of g(r)/g(r0) for a law, and its derivative by ln r; below its range the law is continued as a power."""
    nearest = getattr(law, 'nearest', getattr(law, 'contact', 0.0))
    at_r0 = repulsion(law, max(r0, nearest))

    def logarithm(r):
        known = np.maximum(r, nearest)
        falls = -local_exponent(law, known)
        return np.log(repulsion(law, known) / at_r0) + falls * np.log(r / known), falls

    return logarithm


def scene_entry(fit: Fit) -> str:
    """The tables [law] and [uncertainty] of a scene file, TOML in SI units.

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.interactions import fit_forces, read_forces, scene_entry
    >>> fit = fit_forces(read_forces(files('magphonon.data') / 'synthetic_force.csv'), spacing=10.0)
    >>> scene_entry(fit).splitlines()[0]
    '[law]'
    """
    (f, f_a), (_, a) = fit.covariance
    reach = fit.law.r[-1] / fit.spacing
    return '\n'.join([
        '[law]', f'# a smooth curve through measured forces, for a spacing of {fit.spacing / u.m:g} m',
        'kind = "table"', *(f'{key} = [{", ".join(f"{value:.7g}" for value in column)}]'
                                  for key, column in (('distances_m', fit.law.r / u.m), ('forces_N', fit.law.f / u.N))),
        f'shells = "auto"   # as many as the frequencies need; measured to {reach:.3g} spacings, then as its end or r^-4', '',
        '[uncertainty]   # of the force at the spacing and of its exponent there: meaningful only together',
        f'force_percent = {100 * np.sqrt(f):.6g}', f'exponent = {np.sqrt(a):.6g}',
        f'correlation_force_exponent = {f_a / np.sqrt(f * a):.6g}', ''])
