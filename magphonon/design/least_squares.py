"""What a least-squares fit says about its parameters: covariance, chi2, and what the data do not determine.

Let J be the Jacobian of the residuals in the logarithms of the parameters. The covariance of these logarithms is (J^T J)^-1.  An
eigenvector of J^T J whose eigenvalue is nearly zero is a change of parameters that changes no data.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.special import chdtrc, ndtr  # scipy.stats has it too, and takes most of a second to import

if TYPE_CHECKING:
    from ..stiffness.matrices import Model

NORMAL = 1.96
"""Half width of a 95 % interval in standard deviations of a normal distribution."""
DETERMINED = 0.5 / NORMAL
"""Relative standard uncertainty of a parameter above which it counts as not determined: its interval reaches beyond +-50 %."""
MOST_FACTOR = 10.0
"""Largest factor by which a parameter is changed: where nothing determines it, it must stop somewhere.  A parameter that reaches
this limit is not determined. For example, data without static forces drive the complete model towards zero force and an infinite
exponent."""
FITS = 0.01
"""Probability of chi2 below which the data are taken to scatter about a model by more than their uncertainties."""
BLIND = 1e-10
"""Fraction of the largest eigenvalue of J^T J below which an eigenvalue is zero within round-off."""
BISECTIONS = 48  # of the ends of an interval
FAINT = 1e-5
"""Component of a direction along such an eigenvector above which the direction is not determined: the root of BLIND."""


class Before(NamedTuple):
    """Prior knowledge about the logarithms x of all parameters together: it adds |root (x - centre)|^2/2 to half of chi2."""

    centre: NDArray[np.float64]
    root: NDArray[np.float64]

    @classmethod
    def of(cls, names: tuple[str, ...], priors: Mapping[str, tuple[float, float]] | None) -> Before:
        """The prior knowledge from factors of parameters and their relative standard uncertainties."""
        known = [names.index(name) for name in priors or {}]
        wanted, surely = np.reshape([*(priors or {}).values()], (-1, 2)).T
        before = cls(np.zeros(len(names)), np.eye(len(names))[known] / surely[:, None])
        before.centre[known] = np.log(wanted)
        return before

    @property
    def information(self) -> NDArray[np.float64]:
        """Information matrix of the logarithms of the parameters."""
        return self.root.T @ self.root


@dataclass(frozen=True)
class ParameterFit:
    """Parameters of a lattice fitted to measurements.

    Attributes
    ----------
    model : {'complete', 'conventional'}
    names : tuple of str
        The fitted parameters.
    factors : ndarray, shape (parameters,)
        Factors by which the parameters differ from those at the start.
    information : ndarray, shape (parameters, parameters)
        J^T J for the logarithms of the parameters, the inverse of their covariance.
    residuals : ndarray, shape (points,)
        Measured minus fitted values, divided by their uncertainties.
    """

    model: Model
    names: tuple[str, ...]
    factors: np.ndarray
    information: np.ndarray
    residuals: np.ndarray

    @property
    def by_name(self) -> dict[str, float]:
        """The factors of the parameters, by name."""
        return dict(zip(self.names, self.factors.tolist(), strict=True))

    @property
    def chi2(self) -> float:
        """Sum of the squared residuals."""
        return float(self.residuals @ self.residuals)

    @property
    def rank(self) -> int:
        """Number of combinations of parameters that the points determine."""
        values = np.linalg.eigvalsh(self.information)
        return int((values > BLIND * max(values.max(initial=0.0), 1e-300)).sum())

    @property
    def freedom(self) -> int:
        """Degrees of freedom of chi2."""
        return len(self.residuals) - self.rank

    @property
    def chance(self) -> float:
        """Probability of a chi2 at least as large if the model is true; 1 without degrees of freedom."""
        return float(chdtrc(self.freedom, self.chi2)) if self.freedom else 1.0

    @property
    def scatter(self) -> float:
        """Scatter of the points in units of their uncertainties, by which intervals are enlarged; 1 if chance explains it."""
        return float(np.sqrt(self.chi2 / self.freedom)) if self.chance < FITS else 1.0

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Relative standard uncertainty of each parameter if the others are unknown too; infinite if it is not determined."""
        sigma = np.array([self.sigma_along(one) for one in np.eye(len(self.names))])
        return np.where(abs(np.log(self.factors)) > 0.999 * np.log(MOST_FACTOR), np.inf, sigma)

    def sigma_along(self, direction: NDArray[np.float64]) -> float:
        """Relative standard uncertainty of the product of the parameters to the powers `direction`."""
        values, vectors = np.linalg.eigh(self.information)
        parts = vectors.T @ direction
        blind = values <= BLIND * max(values.max(initial=0.0), 1e-300)
        if (abs(parts[blind]) > FAINT * np.linalg.norm(direction)).any():
            return np.inf
        return self.scatter * float(np.sqrt(np.sum(parts[~blind] ** 2 / values[~blind])))

    def log_evidence(self, scale: float = 1.0) -> float:
        """Logarithm of the evidence by Laplace's method, for uncertainties of the points that are `scale` times those stated.

        A parameter about which nothing else is known may lie within a factor of MOST_FACTOR.
        """
        known = self.information + np.eye(len(self.names)) / np.log(MOST_FACTOR) ** 2
        return -0.5 * (self.chi2 / scale**2 + float(np.linalg.slogdet(known)[1]))

    @property
    def covariance(self) -> NDArray[np.float64]:
        """Covariance of the logarithms of the parameters, shape (parameters, parameters)."""
        if self.rank < len(self.names):
            raise ValueError(f'the points determine only {self.rank} combinations of the {len(self.names)} parameters '
                             f'({", ".join(self.names)}), so these have no covariance; measure another branch, or fix '
                             'a parameter')
        return self.scatter**2 * np.linalg.inv(self.information)


def mixed_interval(values: NDArray[np.float64], sigma: NDArray[np.float64],
                   weights: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """The 95 % interval of a weighted sum of answers, each normal in the logarithm of its value.

    Parameters
    ----------
    values, sigma : ndarray, shape (answers, ...)
        Values of one sign and their relative standard uncertainties.
    weights : ndarray, shape (answers,)

    Returns
    -------
    values, sigma : ndarray
        Middle of the interval, and half its width divided by `NORMAL`, on a logarithmic scale; infinite above ln MOST_FACTOR.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.design.least_squares import mixed_interval
    >>> value, sigma = mixed_interval(np.array([1.0, 1.2]), np.array([0.01, 0.01]), np.array([0.999, 0.001]))
    >>> round(float(value), 3), round(float(sigma), 5)
    (1.0, 0.01004)
    """
    mean, widest = np.log(np.maximum(abs(values), 1e-300)), 4 * np.log(MOST_FACTOR)
    sigma = np.minimum(np.nan_to_num(sigma, nan=widest), widest)
    at = np.reshape([-NORMAL, NORMAL], (2, *[1] * mean.ndim))  # both ends
    low, high = (mean - 2 * abs(at) * sigma).min(axis=1), (mean + 2 * abs(at) * sigma).max(axis=1)
    for _ in range(BISECTIONS):
        ends = (low + high) / 2
        with np.errstate(divide='ignore', invalid='ignore'):
            below = np.tensordot(weights, ndtr(np.nan_to_num((ends[:, None] - mean) / sigma)), (0, 1))
        low, high = np.where(below < ndtr(at[:, 0]), ends, low), np.where(below < ndtr(at[:, 0]), high, ends)
    ends = (low + high) / 2
    middle, half = (ends[0] + ends[1]) / 2, (ends[1] - ends[0]) / (2 * NORMAL)
    return np.sign(values[np.argmax(weights)]) * np.exp(middle), np.where(half > np.log(MOST_FACTOR), np.inf, half)
