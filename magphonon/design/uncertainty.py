"""Uncertainty of bands from the tolerances of parameters, to first order.

With the covariance C of the relative changes dp/p and the slopes S = d omega/d ln p, the variance is `S^T C S`.  The parameters
are those of the lattice as a whole: every spacing, every magnet and every pillar deviates alike. Individual deviations are
treated in `magphonon.design.scatter`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from ..errors import finite
from ..results import Saved
from ..traits import LIKE, takes
from .sensitivities import StiffnessDerivative, frequency_sensitivities

if TYPE_CHECKING:
    from ..stiffness.matrices import Model

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
    """

    changes: dict[str, StiffnessDerivative]
    covariance: np.ndarray

    def __post_init__(self) -> None:
        n = len(self.changes)
        C = finite('covariance', self.covariance, (n, n))
        if not n:
            raise ValueError('no parameter has a tolerance; give at least one')
        if not np.allclose(C, C.T, rtol=1e-9, atol=0) or np.linalg.eigvalsh(C).min(initial=0) < -ROUND_OFF * np.trace(C):
            raise ValueError(f'covariance must be symmetric without negative eigenvalues, with a row for each of the {n} '
                             f'parameters, not {C.tolist()}; check the correlations')
        object.__setattr__(self, 'covariance', C)


@dataclass(frozen=True)
class Spread(Saved, kind='uncertainties', units={
    'names': ('', 'parameters'), 'covariance': ('', 'parameters', 'parameters'),
    'values': ('rad/ms', '...'),
    'slopes': ('rad/ms for each relative change', 'parameters', '...'),
}, missing=('slopes',)):
    """Frequencies, and their uncertainty to first order in the tolerances.

    Attributes
    ----------
    names : tuple of str
        Names of the parameters.
    covariance : ndarray, shape (parameters, parameters)
        Covariance of the relative changes of the parameters.
    values : ndarray, shape (...)
        Frequencies in rad/ms.
    slopes : ndarray, shape (parameters, ...)
        `d omega/d ln p` in rad/ms.
    """

    names: tuple[str, ...]
    covariance: np.ndarray
    values: np.ndarray
    slopes: np.ndarray

    @property
    def std(self) -> NDArray[np.float64]:
        """Standard deviations in rad/ms, shape (...)."""
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


def _std(covariance, slopes):
    return np.sqrt(np.maximum(np.einsum('p...,pr,r...->...', slopes, covariance, slopes), 0.0))


@takes(*{*LIKE} - {'radii'})
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
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.design import StiffnessDerivative, Tolerances, frequency_spread
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> spread = frequency_spread(cell, [[0.5, 0, 0]], Tolerances({'mass': StiffnessDerivative(mass=1.0)}, np.array([[0.01**2]])))
    >>> spread.names
    ('mass',)
    """
    omega, slopes = frequency_sensitivities(atoms, q, tolerances.changes.values(), model)
    return Spread(tuple(tolerances.changes), tolerances.covariance, omega, slopes)
