"""Parameters of a lattice from measured transfer functions: least squares on complex responses, with exact gradients.

With the displacements x = G e under a unit force where the response is seen, and y = G F under the drive, by reciprocity

    h = e.y                  dh/dp = -x.(dH/dp + d(inertia M)/dp) y          G = (H - w^2 M + i w gamma M)^-1

so that one solution for each place serves all parameters.  A shaken bench is the drive F = w^2 M d (`magphonon.response.frf`).

Real magnets and their places scatter, and the mean lattice cannot follow that.  Where the residuals exceed the noise, lattices
are drawn whose sites scatter by as much as makes such residuals, and what one step of the fit answers to each of them is the
covariance, and the bias, that the scatter gives to the parameters.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from tqdm import tqdm

from ..response.frf import Place, base_force, frequency_response
from ..stiffness.defects import Scatter, scattered
from ..stiffness.relaxation import relaxed
from ..stiffness.rest import LinearSystem
from .least_squares import FITS, MOST_FACTOR, ParameterFit
from .sensitivities import hessian_changes

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from numpy.typing import NDArray

    from ..response.transfer_functions import TransferFunction
    from .sensitivities import Change

WIDENED = (8.0, 4.0, 2.0, 1.0, 0.5, 0.25)
"""Rates by which a fit from afar damps data and lattice, in steps of the frequencies: peaks must overlap to find each other."""
ROUGH = 1e-3  # tolerance of these fits
FAR = 2.0  # mean squared residual, in the noise, above which a fit from afar is tried
FIRST, MOST_SCATTER = 0.02, 0.1
"""Scatter of the sites with which the draws begin, and the largest: a lattice that needs more is not this model."""
PLACES, SPRINGS = 0.5, 2.0
"""Scatter of places, in spacings, and of springs, in shares of that of strengths: the stiffness of a pillar goes with the fourth
power of its radius and the third of its height."""
DRAWS, ROUNDS = 24, 2  # lattices that are drawn, and how often with a better scatter


class Built(NamedTuple):
    """A lattice with some parameters: about its rest, its damping in 1/ms, and what each parameter of its stiffness changes."""

    system: LinearSystem
    damping: float
    changes: Mapping[str, Change]


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
        What this scatter adds to the logarithms of the parameters; it is taken out of the `factors`, and half of it counts as
        an uncertainty.
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


def transfer_model(built: Built, functions: Sequence[TransferFunction], names: Sequence[str] = (),
                   widened: float = 0.0) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
    """Responses of a lattice, and their slopes by the logarithms of parameters.

    Parameters
    ----------
    built : Built
    functions : sequence of TransferFunction
        Each with the Place where it is seen, and the Place of its force or the direction in which the bench is shaken.
    names : sequence of str
        'damping', 'mass', 'gain' (of all responses) or names among the `built.changes`.
    widened : float
        Damping in 1/ms on top.

    Returns
    -------
    h : ndarray of complex, shape (points,)
        Of all functions, one after the other; in mm/N, or per displacement of the bench.
    slopes : ndarray of complex, shape (parameters, points)
    """
    system, dim = built.system, built.system.dim
    omega, where = np.unique(np.concatenate([one.omega for one in functions]), return_inverse=True)
    damping, mass = built.damping + widened, np.repeat(system.masses, dim)
    bent = [name for name in names if name in built.changes]
    stiff = dict(zip(bent, hessian_changes(system, [built.changes[name] for name in bent]), strict=True))

    @lru_cache
    def under(force):
        found = frequency_response(system, np.frombuffer(force).reshape(-1, 3), omega, damping).response
        return found[..., :dim].reshape(len(omega), -1)

    h, slopes, first = [], [], 0
    for one in functions:
        k, w = where[first : first + len(one.omega)], one.omega
        first, drive, shaken = first + len(k), one.drive, not isinstance(one.drive, Place)
        place: Any = one.answer
        x = under(place.force(len(system)).tobytes())[k]
        if isinstance(drive, Place):
            y = under(drive.force(len(system)).tobytes())[k]
        else:
            y = w[:, None] ** 2 * under(base_force(system, drive).tobytes())[k]
        inertia, weight = -(w**2) + 1j * w * damping, (x * mass * y).sum(axis=1)
        seen = place.seen(y.reshape(len(w), -1, dim))
        h.append(seen + place.direction @ drive if shaken else seen)
        of = {name: -(x * (dH @ y.T).T).sum(axis=1) for name, dH in stiff.items()}
        of |= {'gain': h[-1], 'damping': -1j * w * built.damping * weight, 'mass': shaken * seen - inertia * weight}
        slopes.append(np.reshape([of[name] for name in names], (len(names), len(w))))
    return np.concatenate(h), np.concatenate(slopes, axis=1)


def fit_transfer(build: Callable[[dict[str, float]], Built], names: tuple[str, ...], functions: Sequence[TransferFunction],
                 model: str = 'complete', priors: Mapping[str, tuple[float, float]] | None = None) -> TransferFit:
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
    priors : dict of str to (float, float), optional
        What is known of a parameter beforehand: its factor, and relative standard uncertainty.

    Examples
    --------
    A foundation that is 20 % stiffer than where the fit starts:

    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Built, Change, fit_transfer
    >>> from magphonon.response import Place, TransferFunction, receptance
    >>> from magphonon.stiffness import LinearSystem
    >>> patch, law = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0), InversePower(1.0, 4.0)
    >>> def build(factors):
    ...     k = factors.get('foundation', 1.0)
    ...     patch.calc = MagneticRepulsion(patch, law, foundation=k)
    ...     return Built(LinearSystem.of(patch), 0.1, {'foundation': Change(foundation=k)})
    >>> source, answer = Place(18, (0, 1, 0)), Place(12, (0, 1, 0))
    >>> h = receptance(build({'foundation': 1.2}).system, source, answer, np.linspace(0.5, 4, 60), 0.1)
    >>> measured = TransferFunction('12', h.omega, h.response, 1e-3, 0, answer, source)
    >>> round(float(fit_transfer(build, ('foundation',), [measured]).factors[0]), 6)
    1.2
    """
    from scipy.optimize import least_squares

    weight, known = _weights(functions)
    measured = np.concatenate([one.response for one in functions])
    centre, spread = np.array([(priors or {}).get(name, (1.0, np.inf)) for name in names]).T
    rows, free = 2 * len(measured), 2 * len(measured) - len(names)
    if free <= 0:
        raise ValueError(f'{rows} measured numbers are too few for {len(names)} parameters ({", ".join(names)})')

    progress = tqdm(desc='lattices tried', delay=2, disable=None, leave=False)

    @lru_cache(maxsize=2)  # residuals and derivatives are wanted at the same place, one after the other
    def at(x, widened):
        progress.update()
        factors = dict(zip(names, np.exp(x).tolist(), strict=True))
        h, slopes = transfer_model(build(factors), functions, names, widened)
        return factors.get('gain', 1.0) * h, factors.get('gain', 1.0) * slopes

    def solved(x, data=measured, widened=0.0, tolerance=1e-10):
        def residuals(x):
            return np.append(_split(weight * (data - at(tuple(x), widened)[0])), (np.log(centre) - x) / spread)

        def jacobian(x):
            return np.vstack([-_split(weight * at(tuple(x), widened)[1]).T, -np.diag(1 / spread)])

        bound = np.log(MOST_FACTOR)
        x = least_squares(residuals, x, jac=jacobian, bounds=(-bound, bound), x_scale='jac', xtol=tolerance, ftol=tolerance,  # pyright: ignore[reportArgumentType]  the stubs of scipy know no function as jac
                          gtol=tolerance).x
        return x, jacobian(x), residuals(x)

    x, J, r = solved(np.zeros(len(names)))
    if not known or r @ r > FAR * len(r):
        far = np.zeros(len(names))
        for width in WIDENED:
            data, rate = _widened(functions, width)
            far = solved(far, data, 2 * rate, ROUGH)[0]
        x, J, r = min((x, J, r), solved(far), key=lambda found: found[2] @ found[2])
    progress.close()
    misfit = float(np.sqrt(r[:rows] @ r[:rows] / free))
    noise = 1.0 if known else misfit
    J[:rows], r[:rows] = J[:rows] / noise, r[:rows] / noise
    found = TransferFit(model, names, np.exp(x), J.T @ J, r, noise, misfit / noise, 0.0, np.zeros(len(names)))
    if known and found.chance >= FITS:
        return found
    if found.rank < len(names):  # D0 alone does not tell the force: which steps it would take is not known
        return replace(found, site_scatter=np.inf)
    atoms = build(dict(zip(names, found.factors.tolist(), strict=True)))
    h, to_parameters = transfer_model(atoms, functions)[0], np.linalg.pinv(J)
    above, tau = r[:rows] @ r[:rows] - known * free, FIRST
    for _ in range(ROUNDS):  # the residuals grow as the scatter
        off = _split(weight / noise * (_drawn(atoms, functions, tau) - h))
        moved = off @ to_parameters[:, :rows].T
        left = np.sum((off - moved @ J[:rows].T) ** 2) / DRAWS
        before, tau = tau, tau * np.sqrt(above / left)
        if tau > MOST_SCATTER:
            return replace(found, information=0 * found.information, site_scatter=float(tau))
    steps = -moved * tau / before  # pyright: ignore[reportPossiblyUnbound, reportOperatorIssue]  ROUNDS is not zero
    bias = steps.mean(axis=0) * tau / before
    covariance = np.linalg.inv(J.T @ J) + np.cov(steps.T).reshape(2 * (len(names),)) + np.diag((bias / 2) ** 2)
    return replace(found, factors=np.exp(x - bias), information=np.linalg.inv(covariance), site_scatter=float(tau), bias=bias)


def _split(z):
    return np.concatenate([z.real, z.imag], axis=-1)


def _weights(functions):
    """One over the uncertainty of each point, and whether that is stated; else it is a share of the peak of what was measured."""
    if all(one.sigma is not None for one in functions):
        return 1 / np.concatenate([np.broadcast_to(one.sigma, one.omega.shape) for one in functions]), True
    return np.concatenate([one.omega**one.order / abs(one.omega**one.order * one.response).max() for one in functions]), False


def _widened(functions, width):
    """The responses with more damping: `H(w - i eta)` is the mean of H under a Lorentzian of the half width eta."""
    rate = width * np.median([np.median(np.diff(one.omega)) for one in functions])
    data = []
    for one in functions:
        kernel = rate / ((one.omega[:, None] - one.omega) ** 2 + rate**2) * np.gradient(one.omega)
        data.append(kernel @ one.response / kernel.sum(axis=1))
    return np.concatenate(data), rate


def _drawn(built, functions, tau):
    """Responses of lattices whose sites scatter, shape (draws, points)."""
    scatter, found = Scatter(PLACES * tau * built.system.calc.bonds.lengths.min(), tau, 0.0, SPRINGS * tau), []
    for seed in range(DRAWS):
        atoms = scattered(built.system.atoms, scatter, seed)
        if not built.system.atoms.calc.load.any():
            atoms = relaxed(atoms).atoms
        else:
            atoms.calc = atoms.calc.balanced(np.flatnonzero(built.system.atoms.calc.load.any(axis=1)))
        found.append(transfer_model(built._replace(system=LinearSystem.of(atoms)), functions)[0])
    return np.array(found)
