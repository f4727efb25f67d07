"""The law of repulsion from measured forces: an inverse power, or a smooth curve where no power holds.

The correlation of the strength b and the exponent a of `f = b r^-a` is very close to one when the data are far from r = 1,
while the force and its slope at a working spacing r0 are known much better.  Therefore the parameters of the fit are f(r0)
and a, and all other covariances follow from theirs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..errors import one_of, positive
from .pair_laws import InversePower, repulsion

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from .force_tables import Forces
    from .pair_laws import PairLaw

COVERED = 0.95
"""Probability with which an interval contains the true value."""
NORMAL = 1.959964
"""Half width of this interval for a normal distribution, in standard deviations."""
LEAST_EXPONENT = 0.01
"""Smallest exponent of a fit: a force that falls more slowly than r^-0.01 is constant on the scale of a lattice."""
FINEST = 1e-6
"""Smallest relative uncertainty of a force; no balance is more accurate.  Without this limit, forces that were computed instead
of measured would have intervals as small as round-off."""
MOST_EXPONENT = 80.0
"""Largest exponent of a fit: a force that falls faster belongs to a wall or an outlier, and b in N m^a soon overflows."""


@dataclass(frozen=True)
class Fit:
    """A fitted law.

    Attributes
    ----------
    law : InversePower or Tabulated
        As a function of true distances: the measured ones minus `offset`.
    name : str
    spacing : float
        The working spacing r0 in mm, a true distance.
    at_spacing : ndarray, shape (2,)
        Force in N and its slope df/dr in N/mm at r0.
    covariance : ndarray, shape (2, 2)
        Covariance of the two parameters above.
    half_width : ndarray, shape (2,)
        Half the width of their intervals of 95 %.  With few points and unknown noise this is more than 1.96 standard
        uncertainties.
    exponent, exponent_sigma : float
        Local exponent -d ln f/d ln r at r0, and its standard uncertainty.
    residuals : ndarray, shape (n,)
        Measured minus fitted force, N.
    chi2 : float
        Sum of the squared residuals divided by their variances, about `freedom` if the law holds; NaN without given
        uncertainties.
    freedom : float
        Number of points minus number of parameters.
    offset, offset_sigma, offset_half_width : float
        Zero of the distance scale in mm, its standard uncertainty, and half the width of its interval of 95 %; 0 if it was
        not fitted.
    """

    law: PairLaw
    name: str
    spacing: float
    at_spacing: np.ndarray
    covariance: np.ndarray
    half_width: np.ndarray
    exponent: float
    exponent_sigma: float
    residuals: np.ndarray
    chi2: float
    freedom: float
    offset: float = 0.0
    offset_sigma: float = 0.0
    offset_half_width: float = 0.0

    @property
    def sigma(self) -> NDArray[np.float64]:
        """Standard uncertainties of force and slope at the spacing."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def exponent_half_width(self) -> float:
        """Half the width of the interval of 95 % of the exponent, as many standard uncertainties as that of the slope."""
        return NORMAL * self.exponent_sigma * (self.half_width[1] / (NORMAL * self.sigma[1]) if self.sigma[1] > 0 else 1.0)

    @property
    def strength_covariance(self) -> NDArray[np.float64]:
        """Covariance of ln b, with b in N m^a, and a, shape (2, 2): of the inverse power that touches the law at r0.

        Taken as normal, it gives the intervals of 95 % of the fit.
        """
        # ln b = ln f + a ln r0 and a = -r0 f'/f
        f, slope = self.at_spacing
        a = np.array([self.spacing * slope / f**2, -self.spacing / f])
        turn = np.stack([np.array([1 / f, 0]) + a * np.log(self.spacing / u.m), a])
        wider = self.half_width / (NORMAL * self.sigma)
        return turn @ (self.covariance * np.outer(wider, wider)) @ turn.T

    @property
    def touching(self) -> Fit:
        """The fit with the inverse power that has its force and slope at the spacing, and their uncertainties.

        For a lattice whose neighbours are at that spacing both laws give the same results.
        """
        f, slope = self.at_spacing
        a = -self.spacing * slope / f
        return replace(self, law=InversePower(float(f * self.spacing**a), float(a)),
                       name=f'inverse power that touches the {self.name}')


def fit_inverse_power(forces: Forces, spacing: float, space: str = 'force', offset: bool = False, contact: float = 0.0) -> Fit:
    """Least squares of `f = b (r - c)^-a`, with c = 0 unless `offset`.

    Parameters
    ----------
    forces : Forces
    spacing : float
        Working spacing in mm.
    space : {'force', 'log'}
        Residuals in force, for a constant uncertainty of the force; or in log force, for a constant relative uncertainty.
        With uncertainties given, both are weighted by them.
    offset : bool
        Fit the zero c of the distance scale too.
    contact : float
        Distance of the centres at contact in mm; an offset that moves a measurement closer than contact is refused.  Use 0
        for point particles.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        If the points are too few, the spacing lies far outside them, the forces do not fall with the distance, the fit
        does not converge, or its offset reaches contact.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import fit_inverse_power, synthetic_forces
    >>> forces = synthetic_forces(InversePower(2000.0, 4.0), np.linspace(8, 15, 8), sigma=1e-3, seed=0)
    >>> fit = fit_inverse_power(forces, spacing=10.0)
    >>> bool(abs(fit.exponent - 4) < 3 * fit.exponent_sigma)
    True
    """
    from scipy.optimize import curve_fit

    positive('spacing', spacing, 'mm')
    one_of('space', space, ('force', 'log'))
    forces.check_reach(spacing)
    r, f = forces.r, forces.f
    enough(r, 3 + offset, 'an inverse power' + ' with an offset' * offset)

    def model(r, ln_f, a, c=0.0):
        ln = ln_f - a * np.log((r - c) / spacing)
        return np.exp(ln) if space == 'force' else ln

    def jacobian(r, ln_f, a, c=0.0):
        slopes = np.stack([np.ones_like(r), -np.log((r - c) / spacing), a / (r - c)][:2 + offset], axis=-1)
        return slopes * model(r, ln_f, a, c)[:, None] if space == 'force' else slopes

    exponent, ln_f = np.polyfit(np.log(r / spacing), np.log(f), 1)
    most = max(r[0] * (1 - 1e-9) - contact, 0.0)
    bounds = ([-np.inf, -np.inf, -np.inf][:2 + offset], [np.inf, np.inf, most][:2 + offset])
    y, sigma = (f, forces.sigma) if space == 'force' else (np.log(f), None if forces.sigma is None else forces.sigma / f)
    try:
        # too long a step overflows; it is rejected, or the fit fails because a residual is not finite
        with np.errstate(over='ignore'):
            p, covariance = curve_fit(model, r, y, [ln_f, -exponent, 0.0][:2 + offset], sigma, absolute_sigma=sigma is not None,
                                      bounds=bounds, method='trf', jac=jacobian, x_scale='jac', xtol=1e-12)
        relative = jacobian(r, *p) / (model(r, *p)[:, None] if space == 'force' else 1.0)
        covariance = covariance + FINEST**2 * np.linalg.pinv(relative.T @ relative)
    except (RuntimeError, ValueError):
        raise ValueError('the fit does not converge; fit it without the offset, or look for an outlier') from None
    if p[1] > LEAST_EXPONENT and not p[1] > 2 * np.sqrt(covariance[1, 1]):
        mend = 'is all of it noise?' if sigma is None else 'is their column sigma, or its unit, right?'
        raise ValueError('within their uncertainties, the forces need not fall with the distance '
                         f'(a = {p[1]:.3g} with a standard uncertainty of {np.sqrt(covariance[1, 1]):.2g}); {mend}')
    if not p[1] > LEAST_EXPONENT:
        raise ValueError(f'the forces do not fall with the distance (a = {p[1]:.3g}); are the columns exchanged, or is all of it '
                         'noise?')
    if p[1] > MOST_EXPONENT:
        raise ValueError(f'the forces fall as r^-{p[1]:.3g}, but no repulsion falls so steeply or so slowly; look for an outlier')
    if offset and most - p[2] < 1e-6 * r[0]:
        raise at_contact(r[0], contact)
    return _power_fit(forces, spacing, space, p, covariance, y - model(r, *p), sigma)


def _power_fit(forces, spacing, space, p, covariance, residuals, sigma):
    """The fit from its parameters ln f(r0), a and perhaps c."""
    from scipy.stats import t

    a, c = p[1], p[2] if len(p) == 3 else 0.0
    force = np.exp(p[0])
    law = InversePower(float(force * spacing**a), float(a))
    turn = np.array([[force, 0], [-a * force / spacing, -force / spacing]])  # d(f, f')/d(ln f, a)
    freedom = len(forces.r) - len(p)
    local = turn @ covariance[:2, :2] @ turn.T
    wide = NORMAL if sigma is not None else t.ppf((1 + COVERED) / 2, freedom)
    c_sigma = float(np.sqrt(covariance[2, 2])) if len(p) == 3 else 0.0
    return Fit(law, f'inverse power, least squares in {"force" if space == "force" else "log force"}', spacing,
               np.array([force, -a * force / spacing]), local, wide * np.sqrt(np.diag(local)),
               float(a), float(np.sqrt(covariance[1, 1])), forces.f - repulsion(law, forces.r - c),
               float(np.nan if sigma is None else np.sum((residuals / sigma) ** 2)), freedom,
               float(c), c_sigma, float(wide * c_sigma))


def at_contact(first: float, contact: float) -> ValueError:
    """The error of an offset that moves the first distance down to contact, both in mm."""
    return ValueError(f'the fit of the offset moves the first distance, {first / u.m:g} m, down to contact at '
                      f'{contact / u.m:g} m: the zero of the distances is not what bends this law; leave --offset out')


def scene_entry(fit: Fit) -> str:
    """The table [law] of a scene file, TOML in SI units with all digits: b is meaningful only together with a.

    An inverse power comes with the table [uncertainty], in which b, a and their correlation are meaningful only together.

    Examples
    --------
    >>> from importlib.resources import files
    >>> from magphonon.interactions import fit_inverse_power, read_forces, scene_entry
    >>> fit = fit_inverse_power(read_forces(files('magphonon.data') / 'synthetic_force.csv'), spacing=10.0)
    >>> scene_entry(fit).splitlines()[0]
    '[law]'
    """
    f, slope = (f'{value / unit:.6g} +- {half / unit:.2g} {name}' for value, half, unit, name in
                zip(fit.at_spacing, fit.half_width, (u.N, u.N / u.m), ('N', 'N/m'), strict=True))
    lines = ['[law]', f'# {fit.name}: f = {f}, df/dr = {slope} (intervals of 95 %) at {fit.spacing / u.m:g} m']
    if fit.offset:
        lines.append(f'# distances are those measured less {fit.offset / u.m:.4g} +- {fit.offset_half_width / u.m:.2g} m')
    if isinstance(fit.law, InversePower):
        lines += ['# all digits: b is meaningful only together with a', 'kind = "inverse_power"',
                  f'b_N_m_a = {fit.law.b / (u.N * u.m**fit.law.a)!r}', f'a = {fit.law.a!r}']
    else:
        table: Any = fit.law  # the other law of a fit is a table
        lines += ['kind = "table"', f'distances_m = {(table.r / u.m).tolist()}', f'forces_N = {(table.f / u.N).tolist()}']
    lines.append('shells = 1   # the number of shells of neighbours that interact')
    (b, both), (_, a) = fit.strength_covariance if fit.sigma.all() else np.zeros((2, 2))
    if isinstance(fit.law, InversePower) and b * a > both**2:
        lines += ['', '[uncertainty]', f'b_percent = {float(100 * np.sqrt(b))!r}', f'a = {float(np.sqrt(a))!r}',
                  f'correlation_a_b = {float(both / np.sqrt(b * a))!r}']
    return '\n'.join([*lines, ''])


def enough(r: NDArray[np.float64], least: int, what: str) -> None:
    """Raise ValueError unless there are points at `least` distances at least, for `what`."""
    if (count := len(np.unique(r))) < least:
        raise ValueError(f'{what} needs at least {least} distances, not {count}; measure more')


def curvature(forces: Forces) -> float:
    """Change of the local exponent with ln r divided by its uncertainty; beyond about 3 in size, no inverse power holds.

    It is computed from the quadratic term of log f as a function of log r, and negative if the exponent falls.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import curvature, synthetic_forces
    >>> forces = synthetic_forces(InversePower(2000.0, 4.0), np.linspace(8, 15, 8), sigma=1e-3, seed=0)
    >>> bool(abs(curvature(forces)) < 2)  # an inverse power does not bend on logarithmic axes
    True
    """
    enough(forces.r, 4, 'the test for a power law')
    x, y = np.log(forces.r / forces.r[0]), np.log(forces.f)
    weights = None if forces.sigma is None else forces.f / forces.sigma
    p, covariance = np.polyfit(x, y, 2, w=weights, cov='unscaled' if weights is not None else True)
    return float(-p[0] / np.hypot(np.sqrt(covariance[0, 0]), FINEST / x[-1] ** 2))
