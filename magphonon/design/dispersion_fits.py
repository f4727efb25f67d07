"""Parameters of a lattice from measured branches: least squares on squares of frequencies, which are linear in the stiffness.

With the logarithms x of the parameters, the residual of a point (q, omega) of one branch is

    r = (omega^2 - lambda(q; x)) / (2 omega sigma)        sigma^2 = sigma_omega^2 + (change of the branch within sigma_q)^2

and `d lambda/dx = 2 omega d omega/dx` is analytic (`magphonon.design.sensitivities`).  A shift that all ridges of a branch share,
such as the one due to a point source, is invisible in the residuals. The covariance of the points of one branch and one kind of
source is therefore

    C = diag(sigma^2) + (tau d) (tau d)^T        d = d omega/d xi, tau = `RidgePoints.shift`

and residuals and derivatives are multiplied by C^(-1/2), the symmetric root, so that each residual still belongs to its own
point.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..bands.bloch import bloch_modes, branch_names
from ..stiffness.bond import Model
from ..waves.ridge_tables import RidgePoints
from ..waves.wave_analysis import LOBE_bins, stationary_waves
from .least_squares import FITS, MOST_FACTOR, Before, ParameterFit
from .sensitivities import StiffnessDerivative, frequency_sensitivities

Build = Callable[[dict[str, float]], tuple[Atoms, Mapping[str, StiffnessDerivative]]]
FOLLOWS = 1.5
"""Scatter up to which a model is taken to fit the points: their uncertainties are estimates, and the simulated ridges of the
prototype have 1.4.  Simulated scans with ridges of other waves had 1.9 or more if they supported the wrong model."""
PASSES, ROBUST = 5, 2
"""Repetitions with the uncertainties and branches of the previous fit; these settle with the second.  With a point source, the
first two repetitions are robust against outliers: points of oblique waves are recognised only when the bands are nearly right."""
LAST = range(PASSES - 1, PASSES)  # passes for a first look at other branches
STEPS = 15  # of one repetition; a fit takes 10, and a model that is far from all points would creep along the bounds
SCOUTS, SCOUTED, TRIED = 7, 3.0, 6
"""For points that do not fit: logarithm to base 2 of the number of parameter sets at which other branches are sought, the largest
factor on each parameter in these sets, and the number of assignments that are then fitted."""
STRAYS = 3.0
"""Waves of a point source move the row both across and along its line. A point is assigned to the next branch if it is at least
this many uncertainties from its own branch, and this many times nearer to the other."""
DIGITS = 5  # of the directions of rows: tables have six of a wavevector
STEP = 1e-4  # step of xi in rad for the slope of a branch
ROUNDS, FARTHEST = 6, 3
"""Number of rounds in which ridges are then moved to the next branches, and number of ridges, the farthest ones, that are
moved."""


@dataclass(frozen=True)
class DispersionFit(ParameterFit):
    """Parameters of a lattice in one model, fitted to measured points of its branches.

    Attributes
    ----------
    branches : tuple of int
        The branch of each ridge, counted from 0 by frequency.
    strayed : int
        Number of points, in ridges of a point source, whose wave belongs to a neighbouring branch instead of that of the ridge.
    sigma_xi : ndarray, shape (points,)
        Standard uncertainties of the phases in rad that the fit used; if an oblique wave is near, they include its distance.
    missed : tuple of float
        Residuals of the ridges that were left out of the fit.

    Residuals belong first to the frequencies of the points, without the common shift of each branch, and then to the priors.
    """

    branches: tuple[int, ...]
    sigma_xi: np.ndarray
    strayed: int = 0
    missed: tuple[float, ...] = ()

    @property
    def scatter(self) -> float:
        """Scatter of the points in units of their uncertainties. It includes ridges that were left out of the fit, because
        leaving them out must not narrow the intervals.
        """
        own = super().scatter
        if not self.missed:
            return own
        return max(own, float(np.sqrt((self.chi2 + np.sum(np.square(self.missed))) / (self.freedom + len(self.missed)))))

    @property
    def follows(self) -> bool:
        """Whether the model fits the points well enough for its parameters to be meaningful."""
        return super().scatter <= FOLLOWS


def fit_dispersion(build: Build, names: tuple[str, ...], points: RidgePoints, model: Model | None = None,
                   priors: Mapping[str, tuple[float, float]] | None = None,
                   near: DispersionFit | None = None) -> DispersionFit:
    """Fit parameters of a lattice to measured points of its branches.

    Parameters
    ----------
    build : callable
        Function that takes a dict from parameter name to factor. It returns the cell with its PairCalculator, and a dict of
        `StiffnessDerivative` that says what each parameter changes.
    names : tuple of str
        The parameters to fit.
    points : RidgePoints
        Points that do not share noise (see `RidgePoints.independent`).
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.
    priors : dict of str to (float, float), optional
        Prior knowledge: factors of parameters and their relative standard uncertainties.
    near : DispersionFit, optional
        An earlier fit of the same ridges to start from. Branches far from those of this fit are then not tried, which saves most
        of the time.

    Examples
    --------
    A fit of the foundation alone, to the shear branch of a lattice whose springs are 20 % stiffer than at the start of the fit:

    >>> import numpy as np
    >>> from magphonon import MagneticRepulsion, read_scene
    >>> from magphonon.bands.bloch import bloch_modes
    >>> from magphonon.design import StiffnessDerivative, fit_dispersion
    >>> from magphonon.waves.ridge_tables import RidgePoints
    >>> start = read_scene('prototype').atoms()
    >>> def build(factors):
    ...     springs = factors['foundation'] * start.calc.foundation
    ...     atoms = start.copy()
    ...     atoms.calc = MagneticRepulsion(atoms, start.calc.laws, foundation=springs)
    ...     return atoms, {'foundation': StiffnessDerivative(foundation=springs)}
    >>> xi = np.linspace(0.6, 2.8, 12)
    >>> q = np.outer(xi / (2 * np.pi), [0, 1, 0])
    >>> omega = bloch_modes(build({'foundation': 1.2})[0], q)[0][:, 0]
    >>> points = RidgePoints(('1',), ('transverse',), 0 * np.arange(12), q, xi, 0 * xi, omega, 1e-3 * omega, 1 + 0 * xi, 0 * xi)
    >>> fit = fit_dispersion(build, ('foundation',), points)
    >>> round(float(fit.factors[0]), 6), fit.branches
    (1.2, (0,))
    """
    known = Before.of(names, priors)
    if len(points) + len(known.root) <= len(names):
        raise ValueError(f'{len(points)} independent points are too few for {len(names)} parameters ({", ".join(names)}); record '
                         'longer or with more carriers, or fix a parameter')
    @lru_cache(maxsize=1)  # residuals and derivatives are wanted at the same place, one after the other
    def cell(*x):
        return build(dict(zip(names, np.exp(x).tolist(), strict=True)))

    start = cell(*np.zeros(len(names)))[0]
    model = model or start.calc.model

    def with_branches(branches, start, passes=range(PASSES)):
        return _settled(cell, names, points, model, known, lambda *_: branches, start, passes)

    def nearest(atoms, points):
        return tuple(_off_branches(atoms, points, model, points.sigma_omega).argmin(axis=1).tolist())

    if near is not None:
        x = np.log([near.by_name.get(name, 1.0) for name in names])
        fit = with_branches(near.branches, x)
        if nearest(cell(*np.log(fit.factors))[0], points) == fit.branches:
            return fit
        return min(fit, _settled(cell, names, points, model, known, nearest, x), key=lambda fit: fit.chi2)
    fit = _settled(cell, names, points, model, known, nearest, np.zeros(len(names)))
    count = bloch_modes(start, points.q[:1], model)[0].shape[1]
    told = _told(points, count)
    if fit.chance < FITS and not all(told):  # a ridge may be assigned to the wrong branch
        others = [with_branches(*other) for other in _assignments(cell, len(names), points, model)]
        fit = min(fit, *others, key=lambda other: other.chi2)
    for _ in range(ROUNDS * (fit.chance < FITS)):  # one repetition of each attempt shows which deserve more
        tries = [with_branches(other, np.log(fit.factors), LAST) for other in _neighbouring(fit, points, count, told)]
        if not tries:
            break
        best = min(tries, key=lambda other: other.chi2)
        nearer = with_branches(best.branches, np.log(best.factors))
        if nearer.chi2 >= fit.chi2:
            break
        fit = nearer
    return fit


def residuals_of(build: Build, fit: DispersionFit, points: RidgePoints) -> tuple[float, ...]:
    """Residuals of points that were not fitted, from the nearest branches of the fitted lattice."""
    atoms, _ = build(fit.by_name)
    points = replace(points, sigma_xi=np.maximum(points.sigma_xi, _oblique(atoms, points, fit.model)))
    modes = _off_branches(atoms, points, fit.model, points.sigma_omega).argmin(axis=1)[points.ridge]
    sigma, slope = uncertainty(atoms, points, modes, fit.model)
    omega = _at(atoms, points, modes, fit.model)
    return tuple((whitening(points, modes, points.shift * slope / sigma) @ ((points.omega - omega) / sigma)).tolist())


def _settled(cell, names, points, model, priors, branches_in, start, passes=range(PASSES)):
    """The fit to the branches that `branches_in` finds for the atoms, repeated until branches and uncertainties converge."""
    n = np.arange(len(points))
    x, before = start, np.zeros(0, int)
    for k in passes:
        atoms, _ = cell(*x)
        least = np.maximum(_oblique(atoms, points, model), points.shift * points.from_points * (k < ROBUST))
        seen = replace(points, sigma_xi=np.maximum(points.sigma_xi, least))
        branches = branches_in(atoms, seen)
        modes = _followed(atoms, seen, np.array(branches)[points.ridge], model)
        sigma, slope = uncertainty(atoms, seen, modes, model)
        scale, white = 2 * points.omega * sigma, whitening(points, modes, points.shift * slope / sigma)

        def residuals(x, modes=modes, scale=scale, white=white) -> Any:
            omega = _at(cell(*x)[0], points, modes, model)
            return np.append(white @ ((points.omega**2 - omega * abs(omega)) / scale), priors.root @ (priors.centre - x))

        def jacobian(x, modes=modes, scale=scale, white=white) -> Any:
            atoms, changes = cell(*x)
            omega, slopes = frequency_sensitivities(atoms, points.q, [changes[name] for name in names], model)
            slopes = np.nan_to_num(slopes[:, n, modes])  # infinite at zero frequency, where the square has a slope of its own
            return -np.vstack([white @ (2 * abs(omega[n, modes]) * slopes / scale).T, priors.root])

        found = least_squares(residuals, x, jac=jacobian, bounds=(-np.log(MOST_FACTOR), np.log(MOST_FACTOR)), x_scale=1.0,  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]  the stubs of scipy know no function as jac
                              loss='cauchy' if k < ROBUST and points.from_points.any() else 'linear',
                              xtol=1e-9, ftol=1e-9, gtol=1e-9, max_nfev=STEPS)
        x, settled = found.x, k > ROBUST and np.array_equal(modes, before)
        before = modes
        if settled:
            break
    J = jacobian(x)  # pyright: ignore[reportPossiblyUnbound]  PASSES is not zero
    strayed = int((modes != np.array(branches)[points.ridge]).sum())
    return DispersionFit(model, names, np.exp(x), J.T @ J, residuals(x), branches, seen.sigma_xi, strayed)  # pyright: ignore[reportPossiblyUnbound, reportUnboundVariable]


def _oblique(atoms, points, model):
    """Possible distance of each point from the wave along the row, if an oblique wave of a point source is near, shape (points,).

    The table contains such distances, but from the bands of the scene with which it was made; they are wrong if these bands are
    a few percent off.
    """
    far = np.zeros(len(points))
    directions, which = np.unique((points.q / points.xi[:, None]).round(DIGITS), axis=0, return_inverse=True)
    for k, direction in enumerate(directions):
        here = (np.ravel(which) == k) & points.from_points
        if here.any():
            along, oblique = stationary_waves(atoms, 2 * np.pi * direction, model)
            xi, own, other = points.xi[here, None], along.phases(points.omega[here]), oblique.phases(points.omega[here])
            own = np.take_along_axis(own, np.where(np.isnan(own), np.inf, abs(own - xi)).argmin(axis=1)[:, None], axis=1)
            near = abs(other - xi) < LOBE_bins * points.bins[here, None]
            apart = np.nan_to_num(abs(other - own), nan=np.pi)  # if no wave along the row has this frequency
            far[here] = np.where(near, apart, 0).max(axis=1, initial=0)
    return far


def _followed(atoms, points, modes, model):
    """The branch of each point: that of its ridge, or the next one if waves of a point source clearly belong to it."""
    for side in (1, -1):
        other = np.clip(modes + side, 0, bloch_modes(atoms, points.q[:1], model)[0].shape[1] - 1)
        own, its = (abs(points.omega - _at(atoms, points, some, model)) / uncertainty(atoms, points, some, model)[0]
                    for some in (modes, other))
        modes = np.where(points.from_points & (own > STRAYS) & (its < own / STRAYS), other, modes)
    return modes


def _at(atoms, points, modes, model, xi=None):
    """Frequencies of these branches at the phases xi, by default those of the points."""
    q = points.q if xi is None else points.q * (xi / points.xi)[:, None]
    return bloch_modes(atoms, q, model)[0][np.arange(len(points)), modes]


def _assignments(cell, parameters, points, model):
    """Assignments of the nearest branches to the ridges, and logarithms of the parameters where they occur, best first.

    A fit from distant parameters stays in the first assignment that it meets.  Near the parameters of a good fit, its branches
    are the nearest ones, in order of frequency. So a net over a wide range of parameters finds them without trying all
    combinations.
    """
    from scipy.stats.qmc import Sobol

    found = {}
    for x in (2 * Sobol(parameters, scramble=False).random_base2(SCOUTS) - 1) * np.log(SCOUTED):
        off = _off_branches(cell(*x)[0], points, model, points.omega)
        branches = tuple(off.argmin(axis=1).tolist())
        found[branches] = min(found.get(branches, (np.inf, ())), (off.min(axis=1).sum(), tuple(x)))
    return [(branches, np.array(x)) for branches, (_, x) in sorted(found.items(), key=lambda item: item[1])[:TRIED]]


def _neighbouring(fit, points, count, told):
    """Other assignments to try: one of the worst ridges is moved to the next branch, unless its motion fixes the branch."""
    off, branches = np.bincount(points.ridge, fit.residuals[: len(points)] ** 2, len(told)), fit.branches
    for k in [k for k in np.argsort(-off).tolist() if not told[k]][:FARTHEST]:
        for other in (branches[k] - 1, branches[k] + 1):
            if 0 <= other < count:
                yield (*branches[:k], other, *branches[k + 1 :])


def _told(points, count):
    return [motion in branch_names(count // 2) for motion in points.motions]


def _off_branches(atoms, points, model, unit):
    """Sum of the squared distances, in `unit`, of each ridge from each branch; infinite for a branch of another motion."""
    off = ((bloch_modes(atoms, points.q, model)[0] - points.omega[:, None]) / unit[:, None]) ** 2
    found = np.array([off[points.ridge == k].sum(axis=0) for k in range(len(points.motions))])
    for k in np.flatnonzero(_told(points, off.shape[1])):
        found[k, np.arange(off.shape[1]) != branch_names(off.shape[1] // 2).index(points.motions[k])] = np.inf
    return found


def uncertainty(atoms: Atoms, points: RidgePoints, modes: NDArray[np.int_],
                model: Model | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard uncertainty of each frequency, including that due to its wavevector, and the slope d omega/d xi."""
    def at(step):
        return _at(atoms, points, modes, model, points.xi + step)

    own = at(0.0)
    beside = np.maximum(*(abs(at(side * points.sigma_xi) - own) for side in (1, -1)))
    return np.hypot(points.sigma_omega, beside), (at(STEP) - at(-STEP)) / (2 * STEP)  # no slope in sigma: it may vanish


def whitening(points: RidgePoints, modes: NDArray[np.int_], shifted: NDArray[np.float64]) -> NDArray[np.float64]:
    """The matrix C^(-1/2) for residuals divided by sigma; `shifted` is tau d/sigma."""
    _, group = np.unique([modes, points.from_points], axis=1, return_inverse=True)
    V = np.where(np.ravel(group) == np.arange(group.max() + 1)[:, None], shifted, 0.0)
    size = np.linalg.norm(V, axis=1)  # the rows have no point in common: C^(-1/2) is 1 beside them, and less along each
    V = V[size > 0] / size[size > 0, None]
    return np.eye(len(points)) - V.T @ ((1 - 1 / np.sqrt(1 + size[size > 0] ** 2))[:, None] * V)
