"""One answer from several records, each of which is reduced to a gradient and an information matrix.

With the logarithms x of the parameters that all records share, half the chi2 of record k at a distance d from the joint fit is

    g_k.d + d.I_k.d/2            sum g_k = 0            C = (sum I_k)^-1

Parameters that belong to one record, such as zeros and gains, are eliminated, and prior knowledge is a record too.  If all
records agree, g_k scatters with the covariance M_k = I_k - I_k C I_k. From this follow, without another fit,

    the size of a fault that moves the answer of record k by v  t = -v.g_k/(v.M_k.v), and its pull |v.g_k|/(v.M_k.v)^(1/2)
    whether the record contradicts the others                   g_k.M_k^+.g_k, a chi2
    the covariance after another record                         (sum I_k + I_new)^-1
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

BEFORE, RIDGES, RESPONSES = 'known before', 'ridges', 'transfer functions'  # names of records
SHARED = 0.01
"""A record and the others can contradict each other along a direction only if each determines at least this share of the
variance."""


@dataclass(frozen=True)
class Record:
    """What one record says about the logarithms of the shared parameters.

    Attributes
    ----------
    name : str
    estimate : ndarray, shape (parameters,)
        Parameters at which the gradient is known.
    gradient : ndarray, shape (parameters,)
        Gradient of half the chi2 of the record at the estimate; zero if the estimate is its own best fit.
    information : ndarray, shape (parameters, parameters)
    faults : dict of str to ndarray
        Possible faults of the instrument, in words, and the change of the estimate by each if it has the stated size.
    there : float
        The chi2 of the record at the estimate.
    """

    name: str
    estimate: NDArray[np.float64]
    gradient: NDArray[np.float64]
    information: NDArray[np.float64]
    faults: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    there: float = 0.0

    def at(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Gradient of half the chi2 of the record at other parameters."""
        return self.gradient + self.information @ (x - self.estimate)

    def chi2(self, x: NDArray[np.float64]) -> float:
        """The chi2 of the record at other parameters."""
        d = x - self.estimate
        return float(self.there + 2 * self.gradient @ d + d @ self.information @ d)


def told(records: Sequence[Record]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Root R of the information of several records and a centre c, for which half their chi2 is |R (x - c)|^2/2 + const."""
    information = np.sum([one.information for one in records], axis=0)
    gradient = np.sum([one.at(np.zeros(len(information))) for one in records], axis=0)
    return np.asarray(np.linalg.cholesky(information).T, float), np.asarray(-np.linalg.solve(information, gradient), float)


class Pull(NamedTuple):
    """A possible fault of a record, and the size that would explain the data, in its stated size and in standard deviations."""

    record: str
    fault: str
    shift: float
    sigmas: float


@dataclass(frozen=True)
class Joint:
    """Joint fit of several records: the shared parameters and what each record says about them.

    Attributes
    ----------
    names : tuple of str
        The shared parameters.
    x : ndarray, shape (parameters,)
        Logarithms of the factors of these parameters from the start to the fit.
    records : tuple of Record
        The last one is the prior knowledge, which must contain information about every parameter.

    Examples
    --------
    Two scales, one of which reads too much:

    >>> import numpy as np
    >>> from magphonon.design.joint_fits import Joint, Record, told
    >>> one, none = np.array([[1e4]]), np.zeros(1)
    >>> records = [Record('new scale', none, none, one), Record('old scale', none + 0.06, none, one, {'gain': none + 1})]
    >>> root, centre = told(records)
    >>> records.append(Record("before", none, none, one / 1e8))
    >>> joint = Joint(('mass',), centre, tuple(records))
    >>> float(joint.x[0].round(3)), float(joint.sigma[0].round(4)), round(joint.pulls()[0].sigmas, 2)
    (0.03, 0.0071, 4.24)
    """

    names: tuple[str, ...]
    x: NDArray[np.float64]
    records: tuple[Record, ...]

    @property
    def information(self) -> NDArray[np.float64]:
        """Information matrix of all records together."""
        return np.sum([one.information for one in self.records], axis=0)

    def covariance(self, added: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
        """Covariance of the logarithms of the parameters, with the information `added` to that of the records."""
        information = self.information + added
        size = np.sqrt(np.diag(information))
        return np.linalg.inv(information / np.outer(size, size)) / np.outer(size, size)

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Relative standard uncertainty of each parameter."""
        return np.sqrt(np.diag(self.covariance()))

    def sigma_along(self, direction: NDArray[np.float64], added: NDArray[np.float64] | float = 0.0) -> float:
        """Relative standard uncertainty of the product of the parameters to the powers `direction`."""
        return float(np.sqrt(direction @ self.covariance(added) @ direction))

    def alone(self, name: str) -> Joint:
        """Joint fit of one record and the prior knowledge, linearised at the parameters of the fit of all records."""
        return Joint(self.names, self.x, tuple(one for one in self.records if one.name == name or one is self.records[-1]))

    def pulls(self) -> list[Pull]:
        """Possible faults of the records, each considered alone, sorted so that the fault that would explain most comes first."""
        found, C = [], self.covariance()
        for one in self.records:
            M, g = one.information - one.information @ C @ one.information, one.at(self.x)
            for fault, v in one.faults.items():
                if (seen := v @ M @ v) > SHARED * (v @ one.information @ v):
                    found.append(Pull(one.name, fault, float(-v @ g / seen), float(abs(v @ g) / np.sqrt(seen))))
        return sorted(found, key=lambda pull: -pull.sigmas)

    def contradiction(self, one: str, other: str | None = None) -> float:
        """Number of standard deviations by which a record contradicts another, or all others; NaN if they share nothing."""
        from scipy.stats import chi2, norm

        kept = [r for r in self.records if other is None or r.name in (one, other) or r is self.records[-1]]
        C = Joint(self.names, self.x, tuple(kept)).covariance()
        (record,) = (r for r in kept if r.name == one)
        g = record.at(self.x - C @ np.sum([r.at(self.x) for r in kept], axis=0))
        M = record.information - record.information @ C @ record.information
        L = np.linalg.cholesky(C)
        values, vectors = np.linalg.eigh(L.T @ M @ L)  # products of the share of the record and that of the others, at most 1/4
        seen = values > SHARED
        square = np.sum((vectors.T @ L.T @ g)[seen] ** 2 / values[seen])
        return float(norm.isf(max(chi2.sf(square, seen.sum()), 1e-300) / 2)) if seen.any() else np.nan
