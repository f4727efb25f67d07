"""The choice of a law for measured forces: an inverse power or a smooth curve, compared at the working spacing."""

from dataclasses import dataclass, replace

import numpy as np

from .fits import Fit, curvature, fit_inverse_power
from .force_tables import Forces
from .offsets import Offset, fit_offset
from .smooth_laws import UNLIKELY, explained, fit_spline

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
        Fit the zero of the distances too; that of the curve is `magphonon.interactions.offsets.fit_offset`, whose uncertainty
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
