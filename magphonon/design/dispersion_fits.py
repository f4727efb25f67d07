"""Parameters of a lattice from measured branches: least squares on squares of frequencies, which are linear in the stiffness.

Whatever the law of the particles, the Bloch matrix is a sum over the distances r between them,

    D(q) = k + sum_r phi''(r) A_r(q) + phi'(r)/r B_r(q)        A: n(x)n, B: 1 - n(x)n, times 1 - cos q.R

so A and B are computed once for a fit (`Shells`), and a law is two rows of numbers.  With the logarithms x of the parameters, the
residual of a point (q, omega) of one branch is

    r = (omega^2 - lambda(q; x)) / (2 omega sigma)        sigma^2 = sigma_omega^2 + (change of the branch within sigma_q)^2

and `d lambda/dx = v^+ (dD/dx) v` is analytic.  A shift that all ridges of a branch share, such as the one due to a point source,
is invisible in the residuals. The covariance of the points of one branch and one kind of source is therefore

    C = diag(sigma^2) + (tau d) (tau d)^T        d = d omega/d xi, tau = `RidgePoints.shift`

and residuals and derivatives are multiplied by C^(-1/2), the symmetric root, so that each residual still belongs to its own
point.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy.optimize import least_squares

from ..bands.bloch import branch_names
from ..lattices.bonds import SHELL_WIDTH
from ..stiffness.matrices import Model, hermitian_eigenvalues, mass_weighted, signed_root
from ..stiffness.rest import LinearSystem
from ..stiffness.sites import Foundation, each_spring
from ..traits import takes
from ..waves.wave_analysis import LOBE_bins, stationary_waves
from .least_squares import FITS, MOST_FACTOR, Before, ParameterFit

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairLaw
    from ..waves.ridge_tables import RidgePoints
    from .sensitivities import LawDerivative, StiffnessDerivative

Build = Callable[[dict[str, float]], tuple[Any, ...]]
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
OBLIQUE = 2.8
"""Reach in spacings of the neighbours that count for oblique waves, which need to be known to a tenth of a bin only."""
DIGITS = 5  # of the directions of rows: tables have six of a wavevector
STEP = 1e-4  # step of xi in rad for the slope of a branch
ROUNDS, FARTHEST = 6, 3
"""Number of rounds in which ridges are then moved to the next branches, and number of ridges, the farthest ones, that are
moved."""


class Shells:
    """A lattice as a sum over the distances between its particles, for any law: D(q) = k + sum_r phi'' A_r(q) + phi'/r B_r(q).

    Parameters
    ----------
    cell : ase.Atoms
        One cell at rest; the bonds of its PairCalculator say which pairs interact.
    reach : float, optional
        Distance in mm behind which all others of a planar lattice interact too, as a continuum that does not follow the wave:
        their stiffness is `density pi reach f(reach)` on each particle.

    Attributes
    ----------
    r : ndarray, shape (shells,)
        Distances in mm, increasing.
    """

    @takes('conventional')
    def __init__(self, cell: Atoms, reach: float = 0.0) -> None:
        system = LinearSystem.of(cell)
        calc, self.cell, self.masses = system.calc, cell, system.masses
        self.bonds, self.dim = calc.bonds, calc.dim
        order = np.argsort(self.bonds.lengths)
        first = np.append(True, np.diff(self.bonds.lengths[order]) > SHELL_WIDTH * self.bonds.lengths.min())
        self.r = self.bonds.lengths[order][first]
        n = self.bonds.vectors[:, : self.dim] / self.bonds.lengths[:, None]
        nn = n[:, :, None] * n[:, None] * (calc.strengths[self.bonds.i] * calc.strengths[self.bonds.j])[:, None, None]
        self._parts = np.stack([nn, np.eye(self.dim) * np.trace(nn, axis1=1, axis2=2)[:, None, None] - nn])
        self._member = np.zeros((len(self.r), len(order)))
        self._member[np.cumsum(first) - 1, order] = 1.0
        planar = reach and self.dim == int(cell.pbc.sum()) == 2
        self._edge = reach, np.pi * reach * len(cell) / np.linalg.norm(np.cross(*cell.cell.array[:2])) if planar else 0.0
        self._kept = lru_cache(maxsize=8)(self._summed)

    def sums(self, q: NDArray[np.float64]) -> NDArray[np.complex128]:
        """A and B divided by the masses, shape (2, shells, wavevectors, particles * dim, particles * dim)."""
        return self._kept(np.ascontiguousarray(q, float).tobytes())

    def _summed(self, q):
        phase = np.exp(2j * np.pi * (self.bonds.shift @ np.frombuffer(q).reshape(-1, 3).T))
        n, dim, ends = len(self.masses), self.dim, np.stack([self.bonds.i, self.bonds.j])
        D = np.zeros((2, len(self.r), n, dim, n, dim, phase.shape[1]), complex)
        for i, j in np.unique(ends, axis=1).T:
            here = (ends == [[i], [j]]).all(axis=0)
            K = np.einsum('rb,pbxy->prxyb', self._member[:, here], self._parts[:, here])
            moved = (K @ phase[here].view(float)).view(complex)
            D[:, :, i, :, i] += K.sum(axis=-1, keepdims=True)
            D[:, :, j, :, j] += K.sum(axis=-1, keepdims=True)
            D[:, :, i, :, j] -= moved
            D[:, :, j, :, i] -= moved.conj()
        return mass_weighted(np.moveaxis(D.reshape(2, len(self.r), n * dim, n * dim, -1), -1, 2), self.masses)

    def matrices(self, q: NDArray[np.float64], model: Model, law: PairLaw | LawDerivative | None,
                 foundation: Foundation) -> NDArray[np.complex128]:
        """Bloch matrices divided by the masses, shape (wavevectors, particles * dim, particles * dim), for a law and springs."""
        (A, B), (edge, around) = self.sums(q), self._edge
        each = each_spring(foundation, len(self.masses), self.dim)
        if around and law is not None:
            each = each - around * law.dphi(edge)
        D: Any = (each / np.repeat(self.masses, self.dim))[..., None] * np.eye(A.shape[-1], dtype=complex)
        if law is None:
            return np.broadcast_to(D, A.shape[1:])
        D = D + np.tensordot(law.d2phi(self.r), A, 1)
        return D + np.tensordot(law.dphi(self.r) / self.r, B, 1) if model == 'complete' else D


@dataclass(frozen=True)
class Bands:
    """The bands of `Shells` with a law and springs, and their slopes by parameters.

    A heavy `pillar` under each particle has a stiffness that depends on the frequency: its `excess(omega)` is the difference from
    the foundation in N/mm and the slope of that by the logarithm of the foundation; `slowed(omega, mass)` are the frequencies.
    All particles then have the same mass.
    """

    shells: Shells
    model: Model
    law: PairLaw
    foundation: Foundation
    changes: Mapping[str, StiffnessDerivative]
    pillar: Any = None

    def omega(self, q: NDArray[np.float64], at: NDArray[np.float64] | None = None) -> NDArray[np.float64]:
        """Frequencies in rad/ms, shape (wavevectors, branches); negative for unstable modes.

        Heavy pillars have their stiffness at the frequencies `at`, shape (wavevectors,), by default at that of each branch.
        """
        squares = hermitian_eigenvalues(self.shells.matrices(q, self.model, self.law, self.foundation))
        if self.pillar is not None and at is None:
            return self.pillar.slowed(signed_root(squares), self.shells.masses[0])
        return signed_root(squares + self._excess(at)[0])

    def _excess(self, at):
        """The excess of the pillars at frequencies, divided by the mass, and its slope, each of shape (wavevectors, 1)."""
        if self.pillar is None or at is None:
            return 0.0, 0.0
        return np.array(self.pillar.excess(at))[..., None] / self.shells.masses[0]

    def slopes(self, q: NDArray[np.float64], names: Sequence[str],
               at: NDArray[np.float64] | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Squares of the frequencies and their derivatives by ln p, shape (parameters, wavevectors, branches).

        Between branches that cross, the derivative is one of any mixture of their modes; only points exactly there feel it.
        """
        more, steeper = self._excess(at)
        squares, v = np.linalg.eigh(self.shells.matrices(q, self.model, self.law, self.foundation))
        dD = [self.shells.matrices(q, self.model, self.changes[name].law, self.changes[name].foundation) for name in names]
        slopes = np.einsum('qai,pqab,qbi->pqi', v.conj(), dD, v, optimize=True).real
        return squares + more, slopes + np.reshape([name == 'foundation' for name in names], (-1, 1, 1)) * steeper

    @property
    def near(self) -> Atoms:
        """The cell with this law between the neighbours within `OBLIQUE` spacings."""
        atoms, calc = self.shells.cell.copy(), self.shells.cell.calc
        bonds = calc.bonds.among(calc.bonds.lengths < OBLIQUE * calc.bonds.lengths.min())
        atoms.calc = calc.changed(laws=self.law, bonds=bonds, sites=replace(calc.sites, foundation=self.foundation))
        return atoms


@dataclass(frozen=True)
class DispersionFit(ParameterFit):
    """Parameters of a lattice in one model, fitted to measured points of its branches.

    Attributes
    ----------
    branches : tuple of int
        The branch of each ridge, counted from 0 by frequency.
    sigma_xi : ndarray, shape (points,)
        Standard uncertainties of the phases in rad that the fit used; if an oblique wave is near, they include its distance.
    missed : tuple of float
        Residuals of the ridges that were left out of the fit.

    Residuals belong first to the frequencies of the points, without the common shift of each branch, and then to the priors.
    """

    branches: tuple[int, ...]
    sigma_xi: np.ndarray
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


def fit_dispersion(shells: Shells, build: Build, names: tuple[str, ...], points: RidgePoints, model: Model | None = None,
                   priors: Mapping[str, tuple[float, float]] | None = None) -> DispersionFit:
    """Fit parameters of a lattice to measured points of its branches.

    Parameters
    ----------
    shells : Shells
        The lattice, whose bonds say which neighbours count.
    build : callable
        Function that takes a dict from parameter name to factor. It returns the law, the foundation in N/mm, a dict of
        `StiffnessDerivative` that says what each parameter changes, and the heavy `pillar` of `Bands` if there is one.
    names : tuple of str
        The parameters to fit.
    points : RidgePoints
        Points that do not share noise (see `RidgePoints.independent`).
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.
    priors : dict of str to (float, float), optional
        Prior knowledge: factors of parameters and their relative standard uncertainties.

    Examples
    --------
    A fit of the foundation alone, to the shear branch of a lattice whose springs are 20 % stiffer than at the start of the fit:

    >>> import numpy as np
    >>> from magphonon import read_scene
    >>> from magphonon.bands.bloch import bloch_modes
    >>> from magphonon.design import Shells, StiffnessDerivative, fit_dispersion
    >>> from magphonon.waves.ridge_tables import RidgePoints
    >>> start = read_scene('prototype').atoms()
    >>> def build(factors):
    ...     springs = factors['foundation'] * start.calc.foundation
    ...     return start.calc.laws, springs, {'foundation': StiffnessDerivative(foundation=springs)}
    >>> xi = np.linspace(0.6, 2.8, 12)
    >>> q = np.outer(xi / (2 * np.pi), [0, 1, 0])
    >>> stiffer = start.copy()
    >>> stiffer.calc = start.calc.about(start, foundation=1.2 * start.calc.foundation)
    >>> omega = bloch_modes(stiffer, q)[0][:, 0]
    >>> points = RidgePoints(('1',), ('transverse',), 0 * np.arange(12), q, xi, 0 * xi, omega, 1e-3 * omega, 1 + 0 * xi, 0 * xi)
    >>> fit = fit_dispersion(Shells(start), build, ('foundation',), points)
    >>> round(float(fit.factors[0]), 6), fit.branches
    (1.2, (0,))
    """
    known, model = Before.of(names, priors), model or shells.cell.calc.model
    if len(points) + len(known.root) <= len(names):
        raise ValueError(f'{len(points)} independent points are too few for {len(names)} parameters ({", ".join(names)}); record '
                         'longer or with more carriers, or fix a parameter')

    @lru_cache(maxsize=1)  # residuals and derivatives are wanted at the same place, one after the other
    def bands(*x):
        return Bands(shells, model, *build(dict(zip(names, np.exp(x).tolist(), strict=True))))

    def with_branches(branches, start, passes=range(PASSES)):
        return _settled(bands, names, points, known, lambda *_: branches, start, passes)

    def nearest(there, points):
        return tuple(_off_branches(there, points, points.sigma_omega).argmin(axis=1).tolist())

    fit = _settled(bands, names, points, known, nearest, np.zeros(len(names)))
    count = len(shells.masses) * shells.dim
    told = _told(points, count)
    if fit.chance < FITS and not all(told):  # a ridge may be assigned to the wrong branch
        others = [with_branches(*other) for other in _assignments(bands, len(names), points)]
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


def residuals_of(bands: Bands, points: RidgePoints) -> tuple[float, ...]:
    """Residuals of points that were not fitted, from the nearest branches of the fitted lattice."""
    points = replace(points, sigma_xi=np.maximum(points.sigma_xi, _oblique(bands, points)))
    modes = _off_branches(bands, points, points.sigma_omega).argmin(axis=1)[points.ridge]
    sigma, slope = uncertainty(bands, points, modes)
    return tuple((whitening(points, modes, points.shift * slope / sigma)
                  @ ((points.omega - _at(bands, points, modes)) / sigma)).tolist())


def _settled(bands, names, points, priors, branches_in, start, passes=range(PASSES)):
    """The fit to the branches that `branches_in` finds for the bands, repeated until branches and uncertainties converge."""
    n = np.arange(len(points))
    x, before = start, np.zeros(0, int)
    for k in passes:
        there = bands(*x)
        least = np.maximum(_oblique(there, points), points.shift * points.from_points * (k < ROBUST))
        seen = replace(points, sigma_xi=np.maximum(points.sigma_xi, least))
        branches = branches_in(there, seen)
        modes = _followed(there, seen, np.array(branches)[points.ridge])
        sigma, slope = uncertainty(there, seen, modes)
        scale, white = 2 * points.omega * sigma, whitening(points, modes, points.shift * slope / sigma)

        def residuals(x, modes=modes, scale=scale, white=white) -> Any:
            omega = _at(bands(*x), points, modes)
            return np.append(white @ ((points.omega**2 - omega * abs(omega)) / scale), priors.root @ (priors.centre - x))

        def jacobian(x, modes=modes, scale=scale, white=white) -> Any:
            slopes = bands(*x).slopes(points.q, names, points.omega)[1][:, n, modes]
            return -np.vstack([white @ (slopes / scale).T, priors.root])

        found = least_squares(residuals, x, jac=jacobian, bounds=(-np.log(MOST_FACTOR), np.log(MOST_FACTOR)), x_scale=1.0,  # pyright: ignore[reportArgumentType, reportGeneralTypeIssues]  the stubs of scipy know no function as jac
                              loss='cauchy' if k < ROBUST and points.from_points.any() else 'linear',
                              xtol=1e-9, ftol=1e-9, gtol=1e-9, max_nfev=STEPS)
        x, settled = found.x, k > ROBUST and np.array_equal(modes, before)
        before = modes
        if settled:
            break
    J = jacobian(x)  # pyright: ignore[reportPossiblyUnbound]  PASSES is not zero
    return DispersionFit(there.model, names, np.exp(x), J.T @ J, residuals(x), branches, seen.sigma_xi)  # pyright: ignore[reportPossiblyUnbound, reportUnboundVariable]


def _oblique(bands, points):
    """Possible distance of each point from the wave along the row, if an oblique wave of a point source is near, shape (points,).

    The table contains such distances, but from the bands of the scene with which it was made; they are wrong if these bands are
    a few percent off.
    """
    far = np.zeros(len(points))
    directions, which = np.unique((points.q / points.xi[:, None]).round(DIGITS), axis=0, return_inverse=True)
    for k, direction in enumerate(directions):
        here = (np.ravel(which) == k) & points.from_points
        if here.any():
            along, oblique = stationary_waves(bands.near, 2 * np.pi * direction, bands.model)
            xi, own, other = points.xi[here, None], along.phases(points.omega[here]), oblique.phases(points.omega[here])
            own = np.take_along_axis(own, np.where(np.isnan(own), np.inf, abs(own - xi)).argmin(axis=1)[:, None], axis=1)
            near = abs(other - xi) < LOBE_bins * points.bins[here, None]
            apart = np.nan_to_num(abs(other - own), nan=np.pi)  # if no wave along the row has this frequency
            far[here] = np.where(near, apart, 0).max(axis=1, initial=0)
    return far


def _followed(bands, points, modes):
    """The branch of each point: that of its ridge, or the next one if waves of a point source clearly belong to it."""
    if not points.from_points.any():
        return modes
    for side in (1, -1):
        other = np.clip(modes + side, 0, len(bands.shells.masses) * bands.shells.dim - 1)
        own, its = (abs(points.omega - _at(bands, points, some)) / uncertainty(bands, points, some)[0] for some in (modes, other))
        modes = np.where(points.from_points & (own > STRAYS) & (its < own / STRAYS), other, modes)
    return modes


def _at(bands, points, modes, xi=None):
    """Frequencies of these branches at the phases xi, by default those of the points."""
    q = points.q if xi is None else points.q * (xi / points.xi)[:, None]
    return bands.omega(q, points.omega)[np.arange(len(points)), modes]


def _assignments(bands, parameters, points):
    """Assignments of the nearest branches to the ridges, and logarithms of the parameters where they occur, best first.

    A fit from distant parameters stays in the first assignment that it meets.  Near the parameters of a good fit, its branches
    are the nearest ones, in order of frequency. So a net over a wide range of parameters finds them without trying all
    combinations.
    """
    from scipy.stats.qmc import Sobol

    found = {}
    for x in (2 * Sobol(parameters, scramble=False).random_base2(SCOUTS) - 1) * np.log(SCOUTED):
        off = _off_branches(bands(*x), points, points.omega)
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


def _off_branches(bands, points, unit):
    """Sum of the squared distances, in `unit`, of each ridge from each branch; infinite for a branch of another motion."""
    off = ((bands.omega(points.q, points.omega) - points.omega[:, None]) / unit[:, None]) ** 2
    found = np.array([off[points.ridge == k].sum(axis=0) for k in range(len(points.motions))])
    for k in np.flatnonzero(_told(points, off.shape[1])):
        found[k, np.arange(off.shape[1]) != branch_names(off.shape[1] // 2).index(points.motions[k])] = np.inf
    return found


def uncertainty(bands: Bands, points: RidgePoints, modes: NDArray[np.int_]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Standard uncertainty of each frequency, including that due to its wavevector, and the slope d omega/d xi."""
    def at(step):
        return _at(bands, points, modes, points.xi + step)

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
