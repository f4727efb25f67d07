"""The zero of measured distances, found from the curvature that an offset c adds to an inverse power.

    f = b (r - c)^-a

The zero is determined only by the assumption of an inverse power: if the law has another shape, c is shifted, and c and its
uncertainty are not valid.  The noise is that of `magphonon.interactions.smooth_laws`: if it is not given, the result is an
average over its size and its growth with the force.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .fits import at_contact
from .smooth_laws import MOST_POINTS, average_fits, explained, half_width, quadratic

if TYPE_CHECKING:
    from .force_tables import Forces

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
