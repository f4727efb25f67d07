"""Which law to take from measured forces: an inverse power or a smooth curve, judged at the working spacing."""

from dataclasses import dataclass, replace

import numpy as np

from .fits import NORMAL, Fit, curvature, fit_inverse_power
from .force_tables import Forces
from .smooth_laws import explained, fit_spline

LARGEST_BEND = 3.0
"""Change of the exponent, in standard uncertainties, above which an inverse power is called wrong."""


@dataclass(frozen=True)
class LawChoice:
    """Laws fitted to the same forces and what they say of each other.

    Attributes
    ----------
    fits : dict of str to Fit
        'force' and 'log', inverse powers by least squares in force and in log force; with four points or more also 'curve'
        and 'touch', the smooth curve and the inverse power that touches it at the spacing.
    bend : float
        Of `magphonon.interactions.fits.curvature`; NaN with three points.
    apart : tuple of str
        The inverse powers whose force, slope or exponent lies farther from that of the curve, or of each other, than the
        intervals of both allow.
    """

    fits: dict[str, Fit]
    bend: float
    apart: tuple[str, ...]

    @property
    def is_power(self) -> bool:
        """Whether the data leave an inverse power possible."""
        return not (abs(self.bend) > LARGEST_BEND or self.apart)

    @property
    def advised(self) -> str:
        """Name of the fit to take: it follows the points at the spacing, and its interval holds the truth of any smooth law."""
        return 'force' if 'curve' not in self.fits else 'touch' if self.is_power else 'curve'

    @property
    def scatter_explained(self) -> bool:
        """Whether the given uncertainties explain how the points scatter about the curve."""
        return 'curve' not in self.fits or explained(self.fits['curve'])


def fit_laws(forces: Forces, spacing: float, offset: bool = False, contact: float = 0.0) -> LawChoice:
    """All laws for the forces.

    Parameters
    ----------
    forces : Forces
    spacing : float
        Working spacing in mm, a true distance: all laws are compared there.
    offset : bool
        Fit the zero of the distances too; the curve is then that of the distances of the inverse power, with the
        uncertainty of their zero.
    contact : float
        As for `fit_inverse_power`.

    Returns
    -------
    LawChoice

    Raises
    ------
    ValueError
        As `fit_inverse_power` and `fit_spline`.
    """
    fits: dict[str, Fit] = {space: fit_inverse_power(forces, spacing, space, offset, contact) for space in ('force', 'log')}
    if len(forces.r) < 4:
        return LawChoice(fits, np.nan, ())
    power = fits['force']
    true = Forces(forces.r - power.offset, forces.f, forces.sigma)
    curve = fit_spline(true, spacing)
    fits['curve'] = _with_offset(curve, power.offset, power.offset_sigma) if offset else curve
    fits['touch'] = fits['curve'].touching
    apart = tuple(name for name, other in (('force', 'log'), ('log', 'force'))
                  if _apart(fits[name], fits['curve']) or _apart(fits[name], fits[other]))
    return LawChoice(fits, curvature(true), apart)


def _apart(one, other):
    return any(abs(a - b) > np.hypot(wa, wb) for (a, wa), (b, wb) in zip(_intervals(one), _intervals(other), strict=True))


def _intervals(fit):
    yield from zip(fit.at_spacing, fit.half_width, strict=True)
    yield fit.exponent, fit.exponent_half_width


def _with_offset(fit: Fit, offset, sigma):
    """The fit with the uncertainty that the zero of the distances adds."""
    f, slope = fit.at_spacing
    moved = sigma * np.array([slope, slope**2 / f - slope / fit.spacing])  # of an inverse power: f'' = f'^2/f - f'/r
    return replace(fit, offset=offset, offset_sigma=sigma, covariance=fit.covariance + np.outer(moved, moved),
                   half_width=np.hypot(fit.half_width, NORMAL * moved))
