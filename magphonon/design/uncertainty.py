"""Uncertainty of frequencies and responses from the tolerances of parameters: to first order, and by Monte Carlo sampling.

With the covariance C of the relative changes dp/p and the slopes S = d value/d ln p, the variance is `S^T C S`.  The parameters
are those of the lattice as a whole: every spacing, every magnet and every pillar deviates alike. Individual deviations are
treated in `magphonon.design.scatter`; for the response of a structure their squares are summed and added to the variance.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import block_diag
from tqdm import tqdm

from ..bands.bloch import bloch_modes
from ..errors import finite, whole
from ..response.frf import Dof
from ..results import Saved
from ..stiffness.bond import Model
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .scatter import ALIKE, NO_SCATTER, ROWS, SiteScatter, response_scatter
from .sensitivities import StiffnessDerivative, frequency_sensitivities, response_sensitivities

ROUND_OFF = 1e-12


@dataclass(frozen=True)
class Tolerances:
    """Standard deviations and correlations of the parameters of a lattice.

    Attributes
    ----------
    changes : dict of str to StiffnessDerivative
        Each parameter by name, and what it changes (`magphonon.design.sensitivities`).
    covariance : ndarray, shape (parameters, parameters)
        Covariance of the relative changes dp/p; its diagonal holds the squares of the relative standard deviations.
    scatter : SiteScatter
        Additional independent deviations of each site; none by default.
    """

    changes: dict[str, StiffnessDerivative]
    covariance: np.ndarray
    scatter: SiteScatter = NO_SCATTER

    def __post_init__(self) -> None:
        n = len(self.changes)
        C = finite('covariance', self.covariance, (n, n))
        if not (n or self.scatter):
            raise ValueError('neither parameters nor sites have a tolerance; give at least one tolerance')
        if not np.allclose(C, C.T, rtol=1e-9, atol=0) or np.linalg.eigvalsh(C).min(initial=0) < -ROUND_OFF * np.trace(C):
            raise ValueError(f'covariance must be symmetric without negative eigenvalues, with a row for each of the {n} '
                             f'parameters, not {C.tolist()}; check the correlations')
        object.__setattr__(self, 'covariance', C)

    def samples(self, count: int, seed: int = 0) -> NDArray[np.float64]:
        """Random factors of the parameters, log-normal because they are positive, shape (count, parameters)."""
        rng = np.random.default_rng(seed)
        return np.exp(rng.multivariate_normal(np.zeros(len(self.changes)), self.covariance, whole('count', count)))


@dataclass(frozen=True)
class Spread(Saved, kind='uncertainties', units={
    'names': ('', 'parameters'), 'covariance': ('', 'parameters', 'parameters'),
    'values': ('rad/ms for frequencies, mm for amplitudes', '...'),
    'slopes': ('that of the values, for each relative change', 'parameters', '...'),
}, missing=('slopes',)):
    """Frequencies or amplitudes, and their uncertainty to first order in the tolerances.

    Attributes
    ----------
    names : tuple of str
        Names of the parameters.
    covariance : ndarray, shape (parameters, parameters)
        Covariance of the relative changes of the parameters.
    values : ndarray, shape (...)
        Frequencies in rad/ms, or amplitudes in mm.
    slopes : ndarray, shape (parameters, ...)
        `d value/d ln p` in the unit of the values.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    values: np.ndarray
    slopes: np.ndarray

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviations in the unit of the values, shape (...)."""
        return _std(self.covariance, self.slopes)

    @property
    def contributions(self) -> dict[str, NDArray[np.float64]]:
        """Standard deviations that each parameter alone causes, by its name; correlated parameters count as one, such as 'b, a'.

        The sum of their squares is the square of `std`.
        """
        from scipy.sparse.csgraph import connected_components

        _, group = connected_components(self.covariance != 0)
        members = [np.flatnonzero(group == g) for g in dict.fromkeys(group)]
        return {', '.join(self.names[p] for p in who): _std(self.covariance[np.ix_(who, who)], self.slopes[who])
                for who in members}


@dataclass(frozen=True)
class ResponseSpread(Spread, kind='uncertainties of a response', units={
    'names': ('', 'parameters'), 'covariance': ('', 'parameters', 'parameters'), 'values': ('mm', 'frequencies'),
    'slopes': ('mm for each relative change', 'parameters', 'frequencies'),
    'turns': ('rad for each relative change', 'parameters', 'frequencies'),
}):
    """Amplitudes of a response, and their uncertainty.

    Attributes
    ----------
    turns : ndarray, shape (parameters, frequencies)
        Slopes of the phase, `d arg(u)/d ln p` in radians.
    """

    turns: np.ndarray

    @property
    def second_order(self) -> NDArray[np.float64]:
        """Standard deviation that the second order adds to the amplitude, shape (frequencies,), in mm.

        Near a resonance u = u0/(1 + z) with a small complex z, linear in the parameters.  At the peak z is imaginary, and the
        amplitude |u0| (1 - |z|^2/2) has no slope.  If z is normal with the variance s^2, the mean is lower by s^2/2 and the
        standard deviation is s^2/sqrt(2), relative to |u0|.
        """
        square = (self.std / self.values) ** 2 + _std(self.covariance, self.turns) ** 2
        return self.values * square / np.sqrt(2)


def _std(covariance, slopes):
    return np.sqrt(np.maximum(np.einsum('p...,pr,r...->...', slopes, covariance, slopes), 0.0))


@takes(*LIKE)
def frequency_spread(atoms: Atoms, q: ArrayLike, tolerances: Tolerances, model: Model | None = None) -> Spread:
    """Frequencies and their uncertainty at any wavevectors.

    Where branches cross, each keeps its own spread.
    `magphonon.design.sensitivities.frequency_sensitivities` says where values are NaN.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator.
    q : array_like, shape (wavevectors, 3)
    tolerances : Tolerances
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Returns
    -------
    Spread
        Its arrays have the shape (wavevectors, modes).

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.design import StiffnessDerivative, Tolerances, frequency_spread
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> spread = frequency_spread(cell, [[0.5, 0, 0]], Tolerances({'mass': StiffnessDerivative(mass=1.0)}, np.array([[0.01**2]])))
    >>> spread.names
    ('mass',)
    """
    omega, slopes = frequency_sensitivities(atoms, q, tolerances.changes.values(), model)
    return Spread(tuple(tolerances.changes), tolerances.covariance, omega, slopes)


@takes(*LIKE)
def response_spread(atoms: Atoms | LinearSystem, force: ArrayLike, answer: Dof, omega: NDArray[np.float64], damping: ArrayLike,
                    tolerances: Tolerances) -> ResponseSpread:
    """Amplitude of a frequency response and its uncertainty.

    Parameters
    ----------
    atoms, force, omega, damping
        As for `magphonon.response.frf.harmonic_response`.
    answer : Dof
        Where the response is seen.
    tolerances : Tolerances

    Returns
    -------
    ResponseSpread
        Spread of |u|, shape (frequencies,), in mm. Each quantity that scatters from site to site counts as one more parameter,
        'each mass' and so on, whose slope is the root of the sum of squares over the sites.
    """
    u, du = response_sensitivities(atoms, force, omega, damping, tolerances.changes.values())
    u, du = answer.seen(u), answer.seen(du)
    slopes, turns = np.real(u.conj() * du) / abs(u), np.imag(du / u)
    names, C, scatter = tuple(tolerances.changes), tolerances.covariance, tolerances.scatter
    own_std = {name: getattr(scatter, name) for name in ROWS if getattr(scatter, name)}
    if scatter:
        own = response_scatter(atoms, force, answer, omega, damping, scatter.at_rest)
        common = [ALIKE.index(name) for name in scatter.alike]
        sites = [np.stack([*(np.linalg.norm(each[ROWS[name]], axis=(0, 1)) for name in own_std), *alike[common]])
                 for each, alike in ([np.real(u.conj() * part) / abs(u) for part in own], [np.imag(part / u) for part in own])]
        slopes, turns = (np.concatenate(pair) for pair in zip((slopes, turns), sites, strict=True))
        names = (*names, *(f'each {name}' for name in own_std), *scatter.alike)
        C = np.asarray(block_diag(C, np.diag(np.square([*own_std.values(), *scatter.alike.values()]))))
    return ResponseSpread(names, C, abs(u), slopes, turns)


def sampled_frequencies(build: Callable[[dict[str, float]], Atoms], q: ArrayLike, tolerances: Tolerances, count: int,
                        seed: int = 0) -> NDArray[np.float64]:
    """Frequencies of `count` lattices whose parameters are drawn at random, to check the linear propagation.

    `build` takes a dict from parameter name to factor and returns the cell with its PairCalculator.  The result has the shape
    (count, wavevectors, modes) and is in rad/ms.
    """
    draws = tqdm(tolerances.samples(count, seed), desc='samples', delay=2, disable=None)
    return np.array([bloch_modes(build(dict(zip(tolerances.changes, factors, strict=True))), q)[0] for factors in draws])
