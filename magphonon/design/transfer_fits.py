"""Parameters of a lattice from measured transfer functions: least squares on complex responses, with exact gradients.

With the displacements x = G e under a unit force where the response is seen, and y = G F under the drive, by reciprocity

    h = e.y                  dh/dp = -x.(dH/dp + d(inertia M)/dp) y          G = (H - w^2 M + i w gamma M)^-1

so that one solution for each place serves all parameters.  A shaken bench is the drive F = w^2 M d (`magphonon.response.frf`).

Real magnets and their positions scatter, and a lattice of equal sites cannot fit that: `site_unknowns` gives every site its own
parameters.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import lru_cache, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.optimize import least_squares

from ..response.frf import Dof, base_force, resolvents
from ..response.normal_modes import refuse_unstable
from ..traits import LIKE, takes
from .least_squares import MOST_FACTOR, Before, ParameterFit
from .sensitivities import StiffnessDerivative, hessian_changes

if TYPE_CHECKING:
    from ..response.transfer_functions import TransferFunction
    from ..stiffness.matrices import Model
    from ..stiffness.rest import LinearSystem

WIDEST = 9.0
"""A fit from distant parameters first widens the peaks of data and lattice by 1/WIDEST of the measured range, because they must
overlap to find each other; then by half of that, and so on."""
FEWEST, FIRST_FEW = 16, 60  # frequencies of each function that are kept where peaks are widened, and those that are fitted first
ROUGH, FINE = 1e-2, 1e-5
"""A fit ends when a step lowers chi2 by less than this share, at first and at last; for 1000 points that fit, the latter means
that the last step is 0.1 sigma."""
HOPELESS = 0.1  # share of the squares of the data that is left over, above which a fit is not refined
FAR = 2.0  # mean squared residual, in units of the noise, above which a fit with widened peaks is tried
MOST_SCATTER = 0.1  # largest scatter of strengths: a lattice that needs more is not this model
MOST_TRIES = 200  # steps of any fit
DENSE = 1500  # free directions up to which all modes cost less than factors at each of some hundred frequencies


class ParametricLattice(NamedTuple):
    """A lattice at rest, its damping in 1/ms, and the change of its stiffness due to each parameter."""

    system: LinearSystem
    damping: float
    changes: Mapping[str, StiffnessDerivative]


@dataclass(frozen=True)
class TransferFit(ParameterFit):
    """Parameters of a lattice in one model, fitted to transfer functions; its residuals are real parts, then imaginary ones.

    If the sites have unknowns of their own, the parameters are the means over the sites of this patch.

    Attributes
    ----------
    noise : float
        Standard deviation of the noise: 1 if uncertainties are stated, because they are then the unit; otherwise the residual as
        a fraction of the peaks.
    misfit : float
        Root mean square residual of a lattice without scatter, divided by the noise.
    square : float
        Sum of the squared residuals of a lattice without scatter, in stated uncertainties or in fractions of the peaks.
    site_scatter : ndarray, shape (3,)
        Scatter from site to site of strengths and of springs, both relative, and of anchors, in shortest bonds; zero if a
        lattice without scatter fits the data to within the noise.
    sites : ndarray, shape (unknowns,)
        The unknowns of the sites, in standard deviations of the scatter.
    unlike : (float, float)
        By how much ln(kx/ky) of the springs at the sites exceeds the fitted one, and its standard deviation: infinite
        without unknowns of sites with springs along both x and y.
    """

    noise: float
    misfit: float
    square: float
    site_scatter: np.ndarray = field(default_factory=lambda: np.zeros(3))
    sites: np.ndarray = field(default_factory=lambda: np.zeros(0))
    unlike: tuple[float, float] = (0.0, np.inf)

    @property
    def follows(self) -> bool:
        """Whether the lattice, with strengths that scatter by up to 10 %, fits the data; otherwise its parameters mean little."""
        return bool(self.site_scatter[0] <= MOST_SCATTER)

    @property
    def refused(self) -> TransferFit:
        """A copy of this fit, marked as unable to fit the data whatever the scatter of the sites."""
        return replace(self, site_scatter=np.full(3, np.inf))

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi2. The unknowns of the sites do not reduce it, because each has a prior."""
        return super().freedom - len(self.sites)


class Solved(NamedTuple):
    """One computed transfer function: frequencies, h without gain, and displacements in a basis, shape (frequencies, basis).

    A unit force at the point of the response causes the displacements x, the drive causes y.
    """

    function: TransferFunction
    omega: NDArray[np.float64]
    h: NDArray[np.complex128]
    x: NDArray[np.complex128]
    y: NDArray[np.complex128]


def solved(built: ParametricLattice, functions: Sequence[TransferFunction], widened: float = 0.0) -> tuple[Any, list[Solved]]:
    """A basis of displacements, shape (particles * dim, basis), and each function in it, with `widened` more damping in 1/ms.

    Each function has the Dof where it is seen, and the Dof of its force or the direction in which the bench is shaken.
    """
    system, dim = built.system, built.system.dim
    omega, where = np.unique(np.concatenate([one.omega for one in functions]), return_inverse=True)
    where = np.split(where, np.cumsum([len(one.omega) for one in functions])[:-1])
    ends = [(one.answer.force(len(system)), _push(system, one.drive)) for one in functions]  # pyright: ignore  each has its Dof
    forces = {force.tobytes(): force for both in ends for force in both}
    basis, found = _fields(system, [*forces.values()], omega, built.damping + widened)
    fields, own = dict(zip(forces, found, strict=True)), []
    for one, k, (back, push) in zip(functions, where, ends, strict=True):
        y = fields[push.tobytes()][k]
        own.append(Solved(one, omega[k], _relative_to_drive(one, y @ (basis.T @ back[:, :dim].ravel())),
                          fields[back.tobytes()][k], y))
    return basis, own


@takes(*{*LIKE} - {'radii'})
def response_slopes(built: ParametricLattice, functions: Sequence[TransferFunction], names: Sequence[str],
                    widened: float = 0.0, fields: tuple[Any, list[Solved]] | None = None,
                    ) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Responses, shape (points,), and their derivatives with respect to the logarithms of parameters, shape (parameters, points).

    The `names` are 'damping', 'mass', 'gain' (of all responses) or names in `built.changes`; `fields` is the result of `solved`,
    if it is known.
    """
    system, bent = built.system, [name for name in names if name in built.changes]
    basis, own = solved(built, functions, widened) if fields is None else fields
    measured = bool(system.calc.load.any())  # in a scene a load is what balances the positions of its file
    changes = hessian_changes(system, [built.changes[name] for name in bent], measured=measured)
    masses = sparse.diags_array(np.repeat(system.masses, system.dim))
    M, *stiff = (basis.T @ (matrix @ basis) for matrix in (masses, *changes))
    slopes = [_slopes(one, names, M, dict(zip(bent, stiff, strict=True)), built.damping, widened) for one in own]
    return np.concatenate([one.h for one in own]), np.concatenate(slopes, axis=1)


def _slopes(solved, names, M, stiff, damping, widened):
    """Derivatives of one function by the logarithms of parameters, from the changes `stiff` of the stiffness in its basis."""
    one, w, h, x, y = solved
    inertia, weight = -(w**2) + 1j * w * (damping + widened), (x * (M @ y.T).T).sum(axis=1)
    of = {name: -(x * (dH @ y.T).T).sum(axis=1) for name, dH in stiff.items()}
    of |= {'damping': -1j * w * damping * weight, 'mass': -inertia * weight}
    if not isinstance(one.drive, Dof):  # shaken: the force goes with the mass, and w^2
        of['mass'] = of['mass'] + (h - one.answer.direction @ one.drive) / w**2
        of = {name: w**2 * slope for name, slope in of.items()}
    of['gain'] = h
    return np.reshape([of[name] for name in names], (len(names), len(w)))


def _push(system, drive):
    """Force on each particle, due to a unit force or to a bench shaken with unit acceleration."""
    return drive.force(len(system)) if isinstance(drive, Dof) else base_force(system, drive)


def _relative_to_drive(function, seen):
    if isinstance(function.drive, Dof):
        return seen
    return function.answer.direction @ function.drive + function.omega**2 * seen


def _fields(system, forces, omega, damping):
    """A basis of displacements, shape (particles * dim, n), and the response to each force in it, (forces, frequencies, n)."""
    dim = system.dim
    if system.directions > DENSE:
        columns = np.stack([force.ravel() for force in forces], axis=1)
        found = np.array([G(columns).reshape(len(system), 3, -1)[:, :dim].reshape(-1, len(forces)).T
                          for G in resolvents(system, omega, damping)]).swapaxes(0, 1)
        return sparse.eye_array(dim * len(system), format='csr'), found
    squares, vectors = system.spectrum
    if (squares < 0).any():
        refuse_unstable(system)
    shapes = system.shapes @ vectors
    modal = np.array([force[:, :dim].ravel() for force in forces]) @ shapes
    return shapes, modal[:, None] / (squares - omega[:, None] ** 2 + 1j * damping * omega[:, None])


def fit_transfer(build: Callable[[dict[str, float]], ParametricLattice], names: tuple[str, ...],
                 functions: Sequence[TransferFunction],
                 model: Model = 'complete', priors: Mapping[str, tuple[float, float]] | None = None,
                 start: ArrayLike | None = None) -> TransferFit:
    """Fit parameters of a lattice to measured transfer functions.

    Parameters
    ----------
    build : callable
        Function that takes a dict from parameter name to factor and returns the lattice.
    names : tuple of str
        The parameters to fit, as for `response_slopes`.
    functions : sequence of TransferFunction
    model : {'complete', 'conventional'}
        The model of the lattices that `build` returns.
    priors : dict of str to (float, float), optional
        Prior knowledge: factors of parameters and their relative standard uncertainties.
    start : array_like, shape (parameters,), optional
        Factors at which the fit starts.

    Examples
    --------
    A fit to data of a foundation that is 20 % stiffer than at the start of the fit:

    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import ParametricLattice, StiffnessDerivative, fit_transfer
    >>> from magphonon.response import Dof, receptance
    >>> from magphonon.response.transfer_functions import TransferFunction
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
    known = stated(functions)
    points = len(measured_responses(functions))
    free = 2 * points - len(names)
    if free <= 0:
        raise ValueError(f'{2 * points} measured numbers are too few for {len(names)} parameters ({", ".join(names)})')
    fitted = partial(_solved, build, names, before=Before.of(names, priors))
    few = [_every(len(one.omega) // FIRST_FEW, one) for one in functions]
    begin = np.zeros(len(names)) if start is None else np.log(start)
    found = fitted(few, begin, ROUGH)
    if not known or 2 * found.cost > FAR * len(found.fun):
        for rate in _rates(functions, build(dict(zip(names, np.exp(begin).tolist(), strict=True))).damping):
            begin = fitted([with_wide_peaks(one, rate) for one in few], begin, ROUGH, widened=2 * rate).x
        found = min(found, fitted(few, begin, ROUGH), key=lambda one: one.cost)
    hopeless = 2 * found.cost > HOPELESS * np.sum(abs(weights(few) * measured_responses(few)) ** 2)
    found = fitted(functions, found.x, ROUGH if hopeless else FINE)
    r, J = found.fun, found.jac
    square = float(r[: 2 * points] @ r[: 2 * points])
    noise = 1.0 if known else float(np.sqrt(square / free))
    J[: 2 * points], r[: 2 * points] = J[: 2 * points] / noise, r[: 2 * points] / noise
    return TransferFit(model, names, np.exp(found.x), J.T @ J, r, noise, float(np.sqrt(square / free)) / noise, square)


def roughly_left(build: Callable[[dict[str, float]], ParametricLattice], names: tuple[str, ...],
                 functions: Sequence[TransferFunction], priors: Mapping[str, tuple[float, float]] | None = None) -> float:
    """What a fit leaves of the functions with peaks so wide that they overlap: says which of some lattices is the most likely.

    The arguments are those of `fit_transfer`.
    """
    rate = max(np.ptp(one.omega) for one in functions) / WIDEST
    wide = [with_wide_peaks(one, rate) for one in functions]
    return _solved(build, names, wide, np.zeros(len(names)), ROUGH, before=Before.of(names, priors), widened=2 * rate).cost


def _solved(build, names, functions, start, tolerance, *, before, widened=0.0):
    """Least-squares solution, starting at the logarithms `start`; rows of the prior `before` come after those of the data."""
    weight, measured = weights(functions), measured_responses(functions)

    @lru_cache(maxsize=2)  # residuals and derivatives are wanted at the same place, one after the other
    def at(x):
        factors = dict(zip(names, np.exp(x).tolist(), strict=True))
        h, slopes = response_slopes(build(factors), functions, names, widened)
        return factors.get('gain', 1.0) * h, factors.get('gain', 1.0) * slopes

    def residuals(x):
        try:
            return np.append(split(weight * (measured - at(tuple(x))[0])), before.root @ (before.centre - x))
        except ValueError:  # no such law, or nothing holds the lattice
            if np.array_equal(x, start):
                raise
            return np.full(2 * len(measured) + len(before.root), np.inf)  # from which a step of the trust region is shortened

    def jacobian(x):
        return np.vstack([-split(weight * at(tuple(x))[1]).T, -before.root])

    bound = np.log(MOST_FACTOR)
    return least_squares(residuals, start, jac=jacobian, bounds=(-bound, bound), x_scale='jac', ftol=tolerance, xtol=tolerance,  # pyright: ignore[reportArgumentType]  the stubs of scipy know no function as jac
                         gtol=None, max_nfev=MOST_TRIES)  # pyright: ignore[reportArgumentType]


def split(z: NDArray[np.complex128]) -> NDArray[np.float64]:
    """The real parts followed by the imaginary parts, along the last axis."""
    return np.concatenate([z.real, z.imag], axis=-1)


def stated(functions: Sequence[TransferFunction]) -> bool:
    """Whether all uncertainties are stated."""
    return all(one.sigma is not None for one in functions)


def measured_responses(functions: Sequence[TransferFunction]) -> NDArray[np.complex128]:
    """The measured responses of all functions, one after the other, shape (points,)."""
    return np.concatenate([one.response for one in functions])


def weights(functions: Sequence[TransferFunction]) -> NDArray[np.float64]:
    """Weight of each point: 1/uncertainty, or if not all are stated, 1/peak of the measured quantity."""
    if stated(functions):
        return 1 / np.concatenate([np.broadcast_to(one.sigma, one.omega.shape) for one in functions])
    return np.concatenate([one.omega**one.order / abs(one.omega**one.order * one.response).max() for one in functions])


def _every(step, one):
    """A transfer function at every `step`-th of its frequencies."""
    kept = np.s_[:: max(int(step), 1)]
    sigma = one.sigma if np.ndim(one.sigma) == 0 else one.sigma[kept]
    return replace(one, omega=one.omega[kept], response=one.response[kept], sigma=sigma)


def _rates(functions, damping):
    """Yield half widths in rad/ms by which peaks are widened, from large ones down to their natural width."""
    rate = max(np.ptp(one.omega) for one in functions) / WIDEST
    while rate > damping / 2:
        yield rate
        rate /= 2


def with_wide_peaks(one: TransferFunction, rate: float) -> TransferFunction:
    """A function with more damping: `H(w - i eta)` is the mean of H under a Lorentzian of the half width eta."""
    kernel = rate / ((one.omega[:, None] - one.omega) ** 2 + rate**2) * np.gradient(one.omega)
    step = min(rate / np.median(np.diff(one.omega)), len(one.omega) / FEWEST)
    return _every(step, replace(one, response=kernel @ one.response / kernel.sum(axis=1)))
