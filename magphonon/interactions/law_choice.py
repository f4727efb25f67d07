"""The choice of a law for measured forces: an inverse power or a smooth curve, compared at the working spacing.

The zero of measured distances, found from the curvature that an offset c adds to an inverse power.

    f = b (r - c)^-a

The zero is determined only by the assumption of an inverse power: if the law has another shape, c is shifted, and c and its
uncertainty are not valid.  The noise is that of `magphonon.interactions.smooth_laws`: if it is not given, the result is an
average over its size and its growth with the force.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .fits import Fit, at_contact, curvature, fit_inverse_power
from .force_tables import Forces
from .smooth_laws import MOST_POINTS, UNLIKELY, average_fits, explained, fit_spline, half_width, quadratic

WIDE = 3.0
"""Smallest ratio of the farthest to the nearest distance for which the intervals contain the true value as often as stated, with
a noise of 3 % (docs/coverage.md).  Over a smaller range, another zero looks like another exponent, and its uncertainty is so
large that linear propagation of errors fails."""
NEAR = 1e-3
"""The search ends when a step of c is smaller than this fraction of its uncertainty."""
MOST_STEPS = 50
"""Largest number of steps of the search."""


@dataclass(frozen=True)
class Offset:
    """The zero c of the distances, mm: its value, standard uncertainty and half the width of its interval of 95 %."""

    value: float
    sigma: float
    half_width: float


def fit_offset(forces: Forces, spacing: float, start: float, contact: float = 0.0) -> Offset:
    """The zero of the distances if the law is an inverse power, and its uncertainty with that of b, a and the noise.

    Parameters
    ----------
    forces : Forces
    spacing : float
        Working spacing in mm.
    start : float
        A first value of the offset in mm.
    contact : float
        As for `magphonon.interactions.fits.fit_inverse_power`.

    Returns
    -------
    Offset
        If the given uncertainties do not explain the scatter of the points about the inverse power, the uncertainty is
        enlarged by the square root of chi2/freedom.

    Raises
    ------
    ValueError
        If the search does not converge, or ends at contact.
    """
    points, counts = forces.binned(MOST_POINTS)
    c = start
    for _ in range(MOST_STEPS):
        true = points.r - c
        # ln f = ln f0 - a ln((r - c)/r0) changes by a dc/(r - c) if c changes by dc
        x = np.log(true / spacing)
        design = np.stack([np.ones_like(x), x, 1 / true], axis=1)
        p, hessian, probability, sigma = average_fits(points, counts, design, quadratic(x, points, counts), bends=None)
        mean, within = probability @ p, np.sqrt(np.linalg.inv(hessian)[:, 2, 2])
        step, least = mean[2] / -mean[1], (forces.r[0] - contact - c) / 2
        if abs(mean[2]) < NEAR * np.sqrt(probability @ within**2):
            break
        if least < 1e-6 * forces.r[0]:
            raise at_contact(forces.r[0], contact)
        c += float(np.clip(step, -spacing / 2, least))
    else:
        raise ValueError('the fit of the offset does not converge; fit it without the offset, or look for an outlier')
    off, within = (p[:, 2] - mean[2]) / -mean[1], within / -mean[1]
    larger = 1.0
    if points.sigma is not None:
        chi2, freedom = float(np.sum(((points.f - np.exp(design @ mean)) / sigma[0]) ** 2)), len(true) - 3
        larger = 1.0 if explained(chi2, freedom) else np.sqrt(chi2 / freedom)
    return Offset(c, float(larger * np.sqrt(probability @ (within**2 + off**2))),
                  float(larger * half_width(probability, off, within)))


LARGEST_BEND = 3.0
"""Change of the exponent, in standard uncertainties, above which an inverse power is rejected."""
RARELY = 0.5
"""Probability of `LawChoice.notices_twice` below which the report says that the given uncertainties are hardly tested."""


@dataclass(frozen=True)
class LawChoice:
    """Laws fitted to the same forces, and their comparison.

    Attributes
    ----------
    fits : dict of str to Fit
        'force' and 'log', inverse powers by least squares in force and in log force; with four points or more also 'curve'
        and 'touch', the smooth curve and the inverse power that touches it at the spacing.
    bend : float
        Value of `magphonon.interactions.fits.curvature`; NaN with three points.
    apart : tuple of str
        The inverse powers whose force, slope or exponent differs from that of the curve, or of each other, by more than
        both intervals allow.
    """

    fits: dict[str, Fit]
    bend: float
    apart: tuple[str, ...]

    @property
    def is_power(self) -> bool:
        """Whether the data are compatible with an inverse power."""
        return not (abs(self.bend) > LARGEST_BEND or self.apart)

    @property
    def advised(self) -> str:
        """Name of the fit to use: the one that follows the points at the spacing, with an interval valid for any smooth law."""
        return 'force' if 'curve' not in self.fits else 'touch' if self.is_power else 'curve'

    @property
    def scatter_explained(self) -> bool:
        """Whether the given uncertainties explain how the points scatter about the curve."""
        tested = self.fits['curve' if 'curve' in self.fits else 'force']
        return bool(np.isnan(tested.chi2)) or explained(tested.chi2, tested.freedom)

    @property
    def notices_twice(self) -> float:
        """Probability that chi2 reveals given uncertainties of half the true size; NaN without given uncertainties."""
        from scipy.stats import chi2

        tested = self.fits['curve' if 'curve' in self.fits else 'force']
        if np.isnan(tested.chi2):
            return np.nan
        limit = max(chi2.isf(UNLIKELY, tested.freedom), tested.freedom)  # as in `explained`
        return float(chi2.sf(limit / 2**2, tested.freedom))


def fit_laws(forces: Forces, spacing: float, offset: bool = False, contact: float = 0.0) -> LawChoice:
    """All laws for the forces.

    Parameters
    ----------
    forces : Forces
    spacing : float
        Working spacing in mm, a true distance: all laws are compared there.
    offset : bool
        Fit the zero of the distances too; that of the curve is `magphonon.interactions.law_choice.fit_offset`, whose uncertainty
        is a part of the curve's.
    contact : float
        As for `fit_inverse_power`.

    Returns
    -------
    LawChoice

    Raises
    ------
    ValueError
        As for `fit_inverse_power` and `fit_spline`.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import fit_laws, synthetic_forces
    >>> forces = synthetic_forces(InversePower(2000.0, 4.0), np.linspace(8, 15, 8), sigma=1e-3, seed=0)
    >>> choice = fit_laws(forces, spacing=10.0)
    >>> list(choice.fits), choice.apart
    (['force', 'log', 'curve', 'touch'], ())
    """
    fits: dict[str, Fit] = {space: fit_inverse_power(forces, spacing, space, offset, contact) for space in ('force', 'log')}
    if len(forces.r) < 4:
        return LawChoice(fits, np.nan, ())
    zero = fit_offset(forces, spacing, fits['force'].offset, contact) if offset else Offset(0.0, 0.0, 0.0)
    true = Forces(forces.r - zero.value, forces.f, forces.sigma)
    fits['curve'] = _with_offset(fit_spline(true, spacing), zero)
    fits['touch'] = fits['curve'].touching
    apart = tuple(name for name, other in (('force', 'log'), ('log', 'force'))
                  if _apart(fits[name], fits['curve']) or _apart(fits[name], fits[other]))
    return LawChoice(fits, curvature(true), apart)


def _apart(one, other):
    return any(abs(a - b) > np.hypot(wa, wb) for (a, wa), (b, wb) in zip(_intervals(one), _intervals(other), strict=True))


def _intervals(fit):
    yield from zip(fit.at_spacing, fit.half_width, strict=True)
    yield fit.exponent, fit.exponent_half_width


def _with_offset(fit: Fit, zero: Offset):
    """The fit with its uncertainties enlarged by that of the zero of the distances.

    At the true distance r0 the force is that measured at r0 + c, so the derivatives of f, f' and -r0 f'/f with respect to
    c are f', f'' and f'/f, of an inverse power, because c is also determined by an inverse power.  The fit holds for a given c,
    therefore the variances add.
    """
    f, slope = fit.at_spacing
    by_offset = np.array([slope, slope**2 / f - slope / fit.spacing])  # f'' = f'^2/f - f'/r
    return replace(fit, offset=zero.value, offset_sigma=zero.sigma, offset_half_width=zero.half_width,
                   covariance=fit.covariance + zero.sigma**2 * np.outer(by_offset, by_offset),
                   half_width=np.hypot(fit.half_width, zero.half_width * by_offset),
                   exponent_sigma=float(np.hypot(fit.exponent_sigma, zero.sigma * slope / f)))
