"""Parameters of a lattice from measured transfer functions: least squares on complex responses, with exact gradients.

With the displacements x = G e under a unit force where the response is seen, and y = G F under the drive, by reciprocity

    h = e.y                  dh/dp = -x.(dH/dp + d(inertia M)/dp) y          G = (H - w^2 M + i w gamma M)^-1

so that one solution for each place serves all parameters.  A shaken bench is the drive F = w^2 M d (`magphonon.response.frf`).

Real magnets and their places scatter, and the mean lattice cannot follow that.  Where the residuals exceed the noise, lattices
are drawn whose sites scatter by as much as makes such residuals, and each is fitted in turn: what comes out, less the mean of its
own sites, is the covariance, and the bias, that the scatter gives to the parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from tqdm import tqdm

from ..response.frf import Dof, base_force, frequency_response, resolvents
from ..response.normal_modes import refuse_unstable
from ..response.transfer_functions import TransferFunction
from ..stiffness.bond import Model
from ..stiffness.defects import Scatter, scattered
from ..stiffness.relaxation import relaxed
from ..stiffness.rest import LinearSystem
from ..traits import STIFF, takes
from .least_squares import BLIND, FITS, MOST_FACTOR, Before, ParameterFit
from .sensitivities import StiffnessDerivative, hessian_changes

WIDEST = 9.0
"""Part of the measured range, one over this, by which a fit from afar first widens the peaks of data and lattice, since they must
overlap to find each other; then half of it, and so on."""
FEWEST, FIRST_FEW = 16, 60  # frequencies of each function that are kept where peaks are widened, and those that are fitted first
ROUGH, FINE = 1e-2, 1e-5
"""Share of chi2 below which a gain ends a fit, at first and at last: of 1000 points that fit, the latter is 0.1 sigma
before the last step."""
HOPELESS = 0.1  # share of the data that is left, in squares, from which on a fit stays rough
FAR = 2.0  # mean squared residual, in the noise, above which a fit from afar is tried
FIRST, MOST_SCATTER = 0.02, 0.1
"""Scatter of the sites with which the draws begin, and the largest: a lattice that needs more is not this model."""
PLACES, SPRINGS = 0.5, 2.0
"""Scatter of places, in spacings, and of springs, in shares of that of strengths: the stiffness of a pillar goes with the fourth
power of its radius and the third of its height."""
SIZED, ROUNDS, DRAWS = 8, 2, 20
"""Lattices that are drawn to find the scatter, how often with a better one, and how many are fitted with the last one."""
REFITTED, MOST_TRIES = 1e-3, 200  # share of chi2 below which a gain ends the fit of a drawn lattice, and steps of any fit
DENSE = 1500  # free directions up to which all modes cost less than factors at each of some hundred frequencies
ACCURATE = 1e-6  # tolerance of responses, in the largest of them; noise is a thousand times as large


class ParametricLattice(NamedTuple):
    """A lattice at rest, its damping in 1/ms, and the change of its stiffness by each parameter."""

    system: LinearSystem
    damping: float
    changes: Mapping[str, StiffnessDerivative]


@dataclass(frozen=True)
class TransferFit(ParameterFit):
    """Parameters of a lattice in one model, fitted to transfer functions; its residuals are real parts, then imaginary ones.

    Attributes
    ----------
    noise : float
        Standard deviation of the noise: 1 in the stated uncertainties; where these are not stated, the residual in shares of
        the peaks.
    misfit : float
        Root mean square residual over the stated uncertainties; 1 where these are not stated.
    site_scatter : float
        Scatter of the strengths from site to site (relative) that the residuals ask for, with that of springs (twice) and places
        (half, in spacings); zero where the lattice follows the data to within the noise.
    bias : ndarray, shape (parameters,)
        What this scatter adds to the logarithms of the parameters; it is taken out of the `factors`, and it is as uncertain as
        the scatter that one lattice shows.
    """

    noise: float
    misfit: float
    site_scatter: float
    bias: np.ndarray

    @property
    def square(self) -> float:
        """Sum of the squared residuals before the scatter of sites and unstated noise are taken out."""
        return self.chi2 * self.noise**2

    @property
    def follows(self) -> bool:
        """Whether the lattice, with sites that scatter by up to 10 %, follows the data; else its parameters mean little."""
        return self.site_scatter <= MOST_SCATTER

    @property
    def scatter(self) -> float:
        """1: what the residuals have above the noise is in the information."""
        return 1.0


def responses(built: ParametricLattice, functions: Sequence[TransferFunction], widened: float = 0.0) -> NDArray[np.complex128]:
    """Responses of a lattice, of all functions, one after the other: in mm/N, or per displacement of the bench.

    Each function has the Dof where it is seen, and the Dof of its force or the direction in which the bench is shaken;
    `widened` is a damping in 1/ms on top.
    """
    omega, where = _frequencies(functions)
    seen = np.unique([_place(one).particle for one in functions])

    @lru_cache
    def under(push):
        return frequency_response(built.system, np.frombuffer(push).reshape(-1, 3), omega, built.damping + widened, seen,
                                  ACCURATE).response

    found = []
    for one, k in zip(functions, where, strict=True):
        y = under(_push(built.system, one.drive).tobytes())[k, np.searchsorted(seen, _place(one).particle)]
        found.append(_relative_to_drive(one, y @ _place(one).direction))
    return np.concatenate(found)


@takes(*STIFF)
def response_slopes(built: ParametricLattice, functions: Sequence[TransferFunction], names: Sequence[str],
                    widened: float = 0.0) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """The same, shape (points,), with their slopes by the logarithms of parameters, shape (parameters, points).

    The `names` are 'damping', 'mass', 'gain' (of all responses) or among the `built.changes`.
    """
    system, dim = built.system, built.system.dim
    omega, where = _frequencies(functions)
    damping, mass = built.damping + widened, sparse.diags_array(np.repeat(system.masses, dim))
    bent = [name for name in names if name in built.changes]
    ends = [(_place(one).force(len(system)), _push(system, one.drive)) for one in functions]
    forces = {force.tobytes(): force for both in ends for force in both}
    basis, found = _fields(system, [*forces.values()], omega, damping)
    fields, M = dict(zip(forces, found, strict=True)), basis.T @ (mass @ basis)
    stiff = {name: basis.T @ (dH @ basis) for name, dH in zip(
        bent, hessian_changes(system, [built.changes[name] for name in bent]), strict=True)}
    h, slopes = [], []
    for one, k, (back, push) in zip(functions, where, ends, strict=True):
        w, x, y = omega[k], fields[back.tobytes()][k], fields[push.tobytes()][k]
        seen = y @ (basis.T @ back[:, :dim].ravel())
        h.append(_relative_to_drive(one, seen))
        inertia, weight = -(w**2) + 1j * w * damping, (x * (M @ y.T).T).sum(axis=1)
        of = {name: -(x * (dH @ y.T).T).sum(axis=1) for name, dH in stiff.items()}
        of |= {'damping': -1j * w * built.damping * weight, 'mass': -inertia * weight}
        if not isinstance(one.drive, Dof):  # shaken: the force goes with the mass, and w^2
            of['mass'] = of['mass'] + seen
            of = {name: w**2 * slope for name, slope in of.items()}
        slopes.append(np.reshape([h[-1] if name == 'gain' else of[name] for name in names], (len(names), len(w))))
    return np.concatenate(h), np.concatenate(slopes, axis=1)


def _frequencies(functions):
    """All frequencies, and where among them those of each function are."""
    omega, where = np.unique(np.concatenate([one.omega for one in functions]), return_inverse=True)
    return omega, np.split(where, np.cumsum([len(one.omega) for one in functions])[:-1])


def _place(function) -> Dof:
    return function.answer


def _push(system, drive):
    """Force on each particle, by a unit force or by a bench shaken with a unit acceleration."""
    return drive.force(len(system)) if isinstance(drive, Dof) else base_force(system, drive)


def _relative_to_drive(function, seen):
    if isinstance(function.drive, Dof):
        return seen
    return function.answer.direction @ function.drive + function.omega**2 * seen


def _fields(system, forces, omega, damping):
    """A basis of the displacements, shape (particles * dim, n), and those under each force in it, (forces, frequencies, n)."""
    dim = system.dim
    if system.directions > DENSE:
        columns = np.stack([force.ravel() for force in forces], axis=1)
        found = np.array([G(columns).reshape(len(system), 3, -1)[:, :dim].reshape(-1, len(forces)).T
                          for G in resolvents(system, omega, damping)]).swapaxes(0, 1)
        return sparse.eye_array(dim * len(system), format='csr'), found
    refuse_unstable(system)
    squares, vectors = system.spectrum
    shapes = system.shapes @ vectors
    modal = np.array([force[:, :dim].ravel() for force in forces]) @ shapes
    return shapes, modal[:, None] / (squares - omega[:, None] ** 2 + 1j * damping * omega[:, None])


def fit_transfer(build: Callable[[dict[str, float]], ParametricLattice], names: tuple[str, ...],
                 functions: Sequence[TransferFunction],
                 model: Model = 'complete', priors: Mapping[str, tuple[float, float]] | Before | None = None,
                 start: ArrayLike | None = None) -> TransferFit:
    """Fit parameters of a lattice to measured transfer functions.

    Parameters
    ----------
    build : callable
        Takes a dict of parameter name to factor; returns the lattice.
    names : tuple of str
        The parameters to fit, as for `transfer_model`.
    functions : sequence of TransferFunction
    model : {'complete', 'conventional'}
        The model of the lattices that `build` returns.
    priors : dict of str to (float, float) or Before, optional
        What is known of a parameter beforehand: its factor, and relative standard uncertainty; or of all together.
    start : array_like, shape (parameters,), optional
        Factors at which the fit starts.

    Examples
    --------
    A foundation that is 20 % stiffer than where the fit starts:

    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import ParametricLattice, StiffnessDerivative, fit_transfer
    >>> from magphonon.response import Dof, TransferFunction, receptance
    >>> from magphonon.stiffness import LinearSystem
    >>> patch, law = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0), InversePower(1.0, 4.0)
    >>> def build(factors):
    ...     k = factors.get('foundation', 1.0)
    ...     patch.calc = MagneticRepulsion(patch, law, foundation=k)
    ...     return ParametricLattice(LinearSystem.of(patch), 0.1, {'foundation': StiffnessDerivative(foundation=k)})
    >>> source, answer = Dof(18, (0, 1, 0)), Dof(12, (0, 1, 0))
    >>> h = receptance(build({'foundation': 1.2}).system, source, answer, np.linspace(0.5, 4, 60), 0.1)
    >>> measured = TransferFunction('12', h.omega, h.response, 1e-3, 0, answer, source)
    >>> round(float(fit_transfer(build, ('foundation',), [measured]).factors[0]), 6)
    1.2
    """
    known = all(one.sigma is not None for one in functions)
    points = sum(len(one.omega) for one in functions)
    free = 2 * points - len(names)
    if free <= 0:
        raise ValueError(f'{2 * points} measured numbers are too few for {len(names)} parameters ({", ".join(names)})')
    solved = partial(_solved, build, names, before=Before.of(names, priors))
    few = [_every(len(one.omega) // FIRST_FEW, one) for one in functions]
    begin = np.zeros(len(names)) if start is None else np.log(start)
    found = solved(few, begin, ROUGH)
    if not known or 2 * found.cost > FAR * len(found.fun):
        for rate in _rates(functions, build(dict(zip(names, np.exp(begin).tolist(), strict=True))).damping):
            begin = solved([with_wide_peaks(one, rate) for one in few], begin, ROUGH, widened=2 * rate).x
        found = min(found, solved(few, begin, ROUGH), key=lambda one: one.cost)
    hopeless = 2 * found.cost > HOPELESS * np.sum(abs(_weights(few) * np.concatenate([one.response for one in few])) ** 2)
    found = solved(functions, found.x, ROUGH if hopeless else FINE)
    r, J = found.fun, found.jac
    misfit = float(np.sqrt(r[: 2 * points] @ r[: 2 * points] / free))
    noise = 1.0 if known else misfit
    J[: 2 * points], r[: 2 * points] = J[: 2 * points] / noise, r[: 2 * points] / noise
    return TransferFit(model, names, np.exp(found.x), J.T @ J, r, noise, misfit / noise, 0.0, np.zeros(len(names)))


def _solved(build, names, functions, start, tolerance, *, before, noise=1.0, widened=0.0, at_start=None):
    """Least squares from the logarithms `start` on; rows of what is known `before` come after those of the data.

    `at_start` are `response_slopes` there, if they are known.
    """
    from scipy.optimize import least_squares

    weight, measured = _weights(functions) / noise, np.concatenate([one.response for one in functions])

    @lru_cache(maxsize=2)  # residuals and derivatives are wanted at the same place, one after the other
    def at(x):
        factors = dict(zip(names, np.exp(x).tolist(), strict=True))
        if at_start is not None and np.array_equal(x, start):
            h, slopes = at_start
        else:
            h, slopes = response_slopes(build(factors), functions, names, widened)
        return factors.get('gain', 1.0) * h, factors.get('gain', 1.0) * slopes

    def residuals(x):
        return np.append(_split(weight * (measured - at(tuple(x))[0])), before.root @ (before.centre - x))

    def jacobian(x):
        return np.vstack([-_split(weight * at(tuple(x))[1]).T, -before.root])

    bound = np.log(MOST_FACTOR)
    return least_squares(residuals, start, jac=jacobian, bounds=(-bound, bound), x_scale='jac', ftol=tolerance, xtol=tolerance,  # pyright: ignore[reportArgumentType]  the stubs of scipy know no function as jac
                         gtol=None, max_nfev=MOST_TRIES)  # pyright: ignore[reportArgumentType]


class SiteMoves(NamedTuple):
    """What the scatter of sites does to a fit: the scatter that the residuals ask for, how uncertain it is, and the moves.

    The moves of the logarithms of the parameters have the shape (DRAWS, parameters); there are none of a lattice that needs no
    scatter, or too much.
    """

    scatter: float
    unsure: float = 0.0
    moves: NDArray[np.float64] | None = None


def site_moves(fit: TransferFit, build: Callable[[dict[str, float]], ParametricLattice], functions: Sequence[TransferFunction],
               priors: Mapping[str, tuple[float, float]] | Before | None = None) -> SiteMoves:
    """Lattices drawn as the residuals of a fit ask for, and how far the fit of each is from the mean of its own sites.

    The arguments are those of `with_site_scatter`.
    """
    known = all(one.sigma is not None for one in functions)
    if known and fit.chance >= FITS:
        return SiteMoves(0.0)
    built, gain, x = build(fit.by_name), fit.by_name.get('gain', 1.0), np.log(fit.factors)
    h, slopes = response_slopes(built, functions, fit.names)
    weight, rows = gain * _weights(functions) / fit.noise, 2 * len(h)
    J = -_split(weight * slopes).T
    values, told = seen_directions(fit.information)  # D0 alone tells no force
    above, tau = fit.residuals[:rows] @ fit.residuals[:rows] - known * (rows - len(values)), FIRST
    for _ in range(ROUNDS):  # the residuals grow as the scatter
        off = _split(weight * (np.array([responses(drawn, functions) for drawn in _drawn(built, tau, SIZED)]) - h))
        left = np.sum((off - off @ J @ told / values @ told.T @ J.T) ** 2, axis=1)
        tau *= float(np.sqrt(above / left.mean()))
        if tau > MOST_SCATTER:
            return SiteMoves(tau)
    before, ends, moved = Before(x, Before.of(fit.names, priors).root), np.cumsum([len(one.omega) for one in functions])[:-1], []
    for drawn in _drawn(built, tau, DRAWS):
        theirs = np.split(gain * responses(drawn, functions), ends)
        seen = [replace(one, response=response) for one, response in zip(functions, theirs, strict=True)]
        again = _solved(build, fit.names, seen, x, REFITTED, before=before, noise=fit.noise, at_start=(h, slopes))
        moved.append(again.x - x - _own_means(built, drawn, fit.names))
    return SiteMoves(tau, float(np.std(left) / left.mean()), np.array(moved))  # pyright: ignore[reportPossiblyUnbound]  ROUNDS is not zero


def seen_directions(information: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Eigenvalues of an information matrix and eigenvectors in columns, of what the data determine."""
    values, told = np.linalg.eigh(information)
    return values[values > BLIND * values[-1]], told[:, values > BLIND * values[-1]]


def own_information(fit: TransferFit, moved: SiteMoves, before: Before) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Gradient at the fit, and information, that the functions alone give, without what was known `before` it.

    With F of the noise, and g of drawn lattices whose sites scatter, the estimate of the functions alone has the covariance
    F^-1 + F^-1 cov(g) F^-1, and the bias F^-1 mean(g).
    """
    known = before.information
    gradient = known @ (before.centre - np.log(fit.factors))  # that of what was known, which the functions balance
    if moved.moves is None:
        return gradient, (fit.information - known) * (moved.scatter <= MOST_SCATTER)
    F, told = seen_directions(fit.information - known)
    g = moved.moves @ fit.information @ told
    mean, S = g.mean(axis=0), (1 + 1 / len(g)) * np.cov(g.T)
    share = F[:, None] * np.linalg.inv(np.diag(F) + S + moved.unsure**2 * np.outer(mean, mean))
    return told @ share @ (told.T @ gradient + mean), told @ (share * F) @ told.T


def with_site_scatter(fit: TransferFit, build: Callable[[dict[str, float]], ParametricLattice],
                      functions: Sequence[TransferFunction],
                      priors: Mapping[str, tuple[float, float]] | Before | None = None) -> TransferFit:
    """The fit, with the scatter of sites that its residuals ask for where they exceed the noise, or where that is not stated.

    Peaks are narrower than the shifts that such scatter gives them, so that no derivative tells what it does to a fit: lattices
    are drawn, each is fitted as the measurement was, and what comes out is compared with the mean of its own sites.

    Parameters
    ----------
    fit, build, functions, priors
        What `fit_transfer` returned, and took.
    """
    found = site_moves(fit, build, functions, priors)
    if found.moves is None:
        return replace(fit, information=(found.scatter == 0) * fit.information, site_scatter=found.scatter)
    values, told = seen_directions(fit.information)
    moved = found.moves @ told
    bias = np.mean(moved, axis=0)
    covariance = np.diag(1 / values) + (1 + 1 / DRAWS) * np.cov(moved.T).reshape(2 * (len(values),))
    covariance += found.unsure**2 * np.outer(bias, bias)
    return replace(fit, factors=fit.factors * np.exp(-told @ bias), information=told @ np.linalg.inv(covariance) @ told.T,
                   site_scatter=found.scatter, bias=told @ bias)


def _split(z):
    return np.concatenate([z.real, z.imag], axis=-1)


def _weights(functions):
    """One over the uncertainty of each point; where that is not stated for all, over the peak of what was measured."""
    if all(one.sigma is not None for one in functions):
        return 1 / np.concatenate([np.broadcast_to(one.sigma, one.omega.shape) for one in functions])
    return np.concatenate([one.omega**one.order / abs(one.omega**one.order * one.response).max() for one in functions])


def _every(step, one):
    """A function at each of so many frequencies."""
    kept = np.s_[:: max(int(step), 1)]
    sigma = one.sigma if np.ndim(one.sigma) == 0 else one.sigma[kept]
    return replace(one, omega=one.omega[kept], response=one.response[kept], sigma=sigma)


def _rates(functions, damping):
    """Half widths in rad/ms by which peaks are widened in turn, down to their own."""
    rate = max(np.ptp(one.omega) for one in functions) / WIDEST
    while rate > damping / 2:
        yield rate
        rate /= 2


def with_wide_peaks(one: TransferFunction, rate: float) -> TransferFunction:
    """A function with more damping: `H(w - i eta)` is the mean of H under a Lorentzian of the half width eta."""
    kernel = rate / ((one.omega[:, None] - one.omega) ** 2 + rate**2) * np.gradient(one.omega)
    step = min(rate / np.median(np.diff(one.omega)), len(one.omega) / FEWEST)
    return _every(step, replace(one, response=kernel @ one.response / kernel.sum(axis=1)))


def _drawn(built, tau, count):
    """Lattices whose sites scatter."""
    scatter = Scatter(PLACES * tau * built.system.calc.bonds.lengths.min(), tau, 0.0, SPRINGS * tau)
    for seed in tqdm(range(count), desc='lattices drawn', delay=2, disable=None, leave=False):
        atoms = scattered(built.system.atoms, scatter, seed)
        if not built.system.atoms.calc.load.any():
            atoms = relaxed(atoms).atoms
        else:
            atoms.calc = atoms.calc.balanced(np.flatnonzero(built.system.atoms.calc.load.any(axis=1)))
        yield built._replace(system=LinearSystem.of(atoms))


def _own_means(built, drawn, names):
    """By what the logarithms of the parameters of a drawn lattice differ, in the mean of its sites that move."""
    calc, moving, own = drawn.system.calc, drawn.system.mobile, np.zeros(len(names))
    strength = 2 * np.log(calc.strengths / built.system.calc.strengths)[moving].mean()
    for k, name in enumerate(names):
        change = built.changes.get(name)
        if name == 'force':
            own[k] = strength
        elif change is not None and np.any(change.foundation):
            of = np.broadcast_to(np.asarray(change.foundation) != 0, (len(moving), calc.dim)) & moving[:, None]
            springs, before = (np.broadcast_to(one.foundation, of.shape)[of] for one in (calc.sites, built.system.calc.sites))
            own[k] = np.log(springs / before).mean()
    return own
