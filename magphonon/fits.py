"""The law of repulsion from measured forces: an inverse power, or a smooth curve where no power holds.

The strength b and the exponent a of `f = b r^-a` are correlated to within a hair of one when the data lie far from r = 1;
what they say together, the force and its slope at a working spacing r0, is known much better.  So the fit's own
parameters are f(r0) and a, and the covariance of anything else follows from theirs.
"""

import csv
from dataclasses import dataclass

import numpy as np

from . import units as u
from .errors import finite, one_of, positive
from .potentials import InversePower, Tabulated, repulsion
from .textfiles import MEGABYTE, refuse_endless

COLUMNS = 'r_m', 'f_N', 'sigma_N'
MOST_NODES = 12
MOST_BYTES = 10 * MEGABYTE
SMOOTHING = np.logspace(-8, 8, 65)


@dataclass(frozen=True)
class Forces:
    """Measured forces of repulsion.

    Attributes
    ----------
    r, f : ndarray, shape (n,)
        Distances in mm, increasing, and forces in N, all positive.
    sigma : ndarray, shape (n,), optional
        Standard uncertainties of the forces, N.

    Raises
    ------
    ValueError
        For anything else; the message counts the points from 1.
    """

    r: np.ndarray
    f: np.ndarray
    sigma: np.ndarray | None = None

    def __post_init__(self):
        columns = [('distance', 'm', self.r), ('force', 'N', self.f), ('sigma', 'N', self.sigma)]
        for name, unit, column in columns:
            if column is None:
                continue
            values = finite(name, column, np.shape(self.r))
            if not (values > 0).all():
                k = int(np.argmin(values > 0))
                mend = {'distance': 'distances are those of the centres', 'sigma': 'leave the column out where it is not known',
                        'force': 'repulsion is positive: turn the sign, or drop the points at the noise floor'}[name]
                raise ValueError(f'{name} {k + 1} is {values[k] / getattr(u, unit):g} {unit}; {mend}')
        steps = np.diff(self.r)
        if not (steps > 0).all():
            k = int(np.argmin(steps > 0))
            what = 'stands there twice; average its forces' if steps[k] == 0 else 'comes after a larger one; sort the points'
            raise ValueError(f'distance {k + 2} ({self.r[k + 1] / u.m:g} m) {what}')


def read_forces(path, contact=0.0):
    """Forces from a CSV file with the header r_m,f_N or r_m,f_N,sigma_N; lines that begin with # are comments.

    Parameters
    ----------
    path : path-like
    contact : float
        Distance of the centres at contact in mm, below which no measurement can lie.

    Raises
    ------
    OSError, ValueError
        If it cannot be read, or is no such table; the message says what and where.
    """
    try:
        refuse_endless(path, MOST_BYTES)
        with open(path, newline='', encoding='utf-8-sig') as file:
            lines = [(number, line) for number, line in enumerate(file, 1) if line.strip() and not line.startswith('#')]
    except OSError as error:
        raise type(error)(f'{path} cannot be read ({error.strerror})') from None
    except UnicodeDecodeError:
        raise ValueError(f'{path} is not a text file; save the table as CSV') from None
    numbers, rows = [number for number, _ in lines], list(csv.reader(line for _, line in lines))
    header = [title.strip() for title in rows[0]] if rows else []
    if header not in (list(COLUMNS[:2]), list(COLUMNS)):
        raise ValueError(f'{path} begins with {",".join(header)[:60]!r}; its header must be r_m,f_N or r_m,f_N,sigma_N')
    for number, row in zip(numbers[1:], rows[1:], strict=True):
        try:
            good = len(row) == len(header) and np.isfinite([float(cell) for cell in row]).all()
        except ValueError:
            good = False
        if not good:
            raise ValueError(f'{path}, line {number}: {",".join(row)[:60]!r} is not {len(header)} numbers')
    if len(rows) == 1:
        raise ValueError(f'{path} holds no points below its header')
    columns = np.array(rows[1:], dtype=float).T
    try:
        forces = Forces(*(column * unit for column, unit in zip(columns, (u.m, u.N, u.N), strict=False)))
        if forces.r[0] < contact:
            raise ValueError(f'distance 1 is {forces.r[0] / u.m:g} m, below contact at {contact / u.m:g} m; give distances '
                             'of the centres, not gaps')
    except ValueError as error:
        raise ValueError(f'{path}: {error}') from None
    return forces


def synthetic_forces(law, r, sigma, seed):
    """Forces of a `law` at distances `r` with Gaussian noise `sigma` (N): an invented measurement, to try a fit on."""
    noise = np.random.default_rng(seed).normal(scale=sigma, size=np.shape(r))
    return Forces(r, repulsion(law, r) + noise, np.broadcast_to(sigma, np.shape(r)))


@dataclass(frozen=True)
class Fit:
    """A fitted law.

    Attributes
    ----------
    law : InversePower or Tabulated
        In true distances, which are the measured ones less `offset`.
    name : str
    spacing : float
        The working spacing r0 in mm, a true distance.
    at_spacing : ndarray, shape (2,)
        Force in N and its slope df/dr in N/mm at r0.
    covariance : ndarray, shape (2, 2)
        Of these two.
    exponent, exponent_sigma : float
        Local exponent -d ln f/d ln r at r0, and its standard uncertainty.
    residuals : ndarray, shape (n,)
        Measured less fitted force, N.
    chi2 : float
        Sum of squared residuals over their uncertainties, about `freedom` if the law holds; NaN where none were given.
    freedom : float
        Points less parameters.
    offset, offset_sigma : float
        Zero of the distance scale in mm, 0 where it was not fitted.
    """

    law: object
    name: str
    spacing: float
    at_spacing: np.ndarray
    covariance: np.ndarray
    exponent: float
    exponent_sigma: float
    residuals: np.ndarray
    chi2: float
    freedom: float
    offset: float = 0.0
    offset_sigma: float = 0.0

    @property
    def sigma(self):
        """Standard uncertainties of force and slope at the spacing."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def strength_covariance(self):
        """Covariance of ln b, with b in N m^a, and a, shape (2, 2): of the inverse power that touches the law at r0."""
        # ln b = ln f + a ln r0 and a = -r0 f'/f
        f, slope = self.at_spacing
        a = np.array([self.spacing * slope / f**2, -self.spacing / f])
        turn = np.stack([np.array([1 / f, 0]) + a * np.log(self.spacing / u.m), a])
        return turn @ self.covariance @ turn.T


def fit_inverse_power(forces, spacing, space='force', offset=False):
    """Least squares of `f = b (r - c)^-a`, with c = 0 unless `offset`.

    Parameters
    ----------
    forces : Forces
    spacing : float
        Working spacing in mm.
    space : {'force', 'log'}
        Residuals in force, right for a constant uncertainty of the force; or in log force, for a constant relative one.
        With uncertainties given, both are weighted by them.
    offset : bool
        Fit the zero c of the distance scale too.

    Returns
    -------
    Fit

    Raises
    ------
    ValueError
        If the points are too few, or the fit does not converge.
    """
    from scipy.optimize import curve_fit

    positive('spacing', spacing, 'mm')
    one_of('space', space, ('force', 'log'))
    r, f = forces.r, forces.f
    _enough(r, 3 + offset, 'an inverse power' + ' with an offset' * offset)

    def model(r, ln_f, a, c=0.0):
        ln = ln_f - a * np.log((r - c) / spacing)
        return np.exp(ln) if space == 'force' else ln

    def jacobian(r, ln_f, a, c=0.0):
        slopes = np.stack([np.ones_like(r), -np.log((r - c) / spacing), a / (r - c)][:2 + offset], axis=-1)
        return slopes * model(r, ln_f, a, c)[:, None] if space == 'force' else slopes

    exponent, ln_f = np.polyfit(np.log(r / spacing), np.log(f), 1)
    bounds = ([-np.inf, -np.inf, -np.inf][:2 + offset], [np.inf, np.inf, r[0] * (1 - 1e-9)][:2 + offset])
    y, sigma = (f, forces.sigma) if space == 'force' else (np.log(f), None if forces.sigma is None else forces.sigma / f)
    try:
        with np.errstate(over='ignore'):  # a step too far, which is taken back or ends in a residual that is not finite
            p, covariance = curve_fit(model, r, y, [ln_f, -exponent, 0.0][:2 + offset], sigma, absolute_sigma=sigma is not None,
                                      bounds=bounds, method='trf', jac=jacobian, x_scale='jac', xtol=1e-12)
    except (RuntimeError, ValueError) as error:
        raise ValueError(f'the fit does not converge ({error}); fit it without the offset, or look for an outlier') from None
    if not p[1] > 0:
        raise ValueError(f'the forces do not fall with the distance (a = {p[1]:.3g}); are the columns exchanged?')
    return _power_fit(forces, spacing, space, p, covariance, y - model(r, *p), sigma)


def _power_fit(forces, spacing, space, p, covariance, residuals, sigma):
    """The fit from its parameters ln f(r0), a and perhaps c."""
    a, c = p[1], p[2] if len(p) == 3 else 0.0
    force = np.exp(p[0])
    law = InversePower(float(force * spacing**a), float(a))
    turn = np.array([[force, 0], [-a * force / spacing, -force / spacing]])  # d(f, f')/d(ln f, a)
    freedom = len(forces.r) - len(p)
    return Fit(law, f'inverse power, least squares in {"force" if space == "force" else "log force"}', spacing,
               np.array([force, -a * force / spacing]), turn @ covariance[:2, :2] @ turn.T,
               float(a), float(np.sqrt(covariance[1, 1])), forces.f - repulsion(law, forces.r - c),
               float(np.nan if sigma is None else np.sum((residuals / sigma) ** 2)), freedom,
               float(c), float(np.sqrt(covariance[2, 2])) if len(p) == 3 else 0.0)


def fit_spline(forces, spacing):
    """Smooth decreasing law through the data: a penalised cubic spline of `log f` over `log r`.

    Bends are held small by as much as generalised cross-validation asks for; if that is infinitely much, the law is the
    inverse power of the fit in log force.  The coefficients of the B-splines decrease, and with them the force.  The knots
    are those of the `Tabulated` through its values at the nodes, which therefore is the same curve.

    Parameters
    ----------
    forces : Forces
    spacing : float
        Working spacing in mm, within the data.

    Returns
    -------
    Fit
        Its covariance treats the smoothness as prior knowledge, and leaves out what the smoothing itself changes.

    Raises
    ------
    ValueError
        If the points are fewer than 6, or the spacing lies outside them.
    """
    from scipy.interpolate import BSpline
    from scipy.optimize import lsq_linear

    positive('spacing', spacing, 'mm')
    r, f = forces.r, forces.f
    _enough(r, 6, 'a smooth curve')
    if not r[0] <= spacing <= r[-1]:
        raise ValueError(f'the spacing {spacing / u.m:g} m lies outside the data, {r[0] / u.m:g} to {r[-1] / u.m:g} m, '
                         'and a curve is not extrapolated; measure there')
    x, weights = np.log(r), np.ones_like(r) if forces.sigma is None else f / forces.sigma
    nodes = np.linspace(x[0], x[-1], min(MOST_NODES, len(r) - 1))
    knots = np.concatenate([[x[0]] * 4, nodes[2:-2], [x[-1]] * 4])
    design = BSpline.design_matrix(x, knots, 3).toarray() * weights[:, None]
    bends, target = _bends(knots, len(nodes)), np.log(f) * weights
    normal = design.T @ design + _smoothing(design, target, bends) * bends.T @ bends

    # the minimum of c.normal.c - 2 c.design.target over decreasing c = c_0 - (sums of steps >= 0)
    steps = -np.tril(np.ones_like(normal))
    root = np.linalg.cholesky(normal).T
    lower = np.append(-np.inf, np.zeros(len(nodes) - 1))
    c = steps @ lsq_linear(root @ steps, np.linalg.solve(root.T, design.T @ target), (lower, np.inf), tol=1e-14).x
    law = Tabulated(np.concatenate([r[:1], np.exp(nodes[1:-1]), r[-1:]]), np.exp(BSpline(knots, c, 3)(nodes)))

    freedom = len(r) - np.trace(np.linalg.solve(normal, design.T @ design))
    chi2 = np.sum((target - design @ c) ** 2)
    covariance = np.linalg.inv(normal) * (1 if forces.sigma is not None else chi2 / freedom)
    values = BSpline(knots, np.eye(len(nodes)), 3)
    at = np.stack([values(np.log(spacing), derivative) for derivative in (0, 1)])  # ln f and d ln f/d ln r from c
    force, a = repulsion(law, spacing), float(-at[1] @ c)
    turn = force * np.array([[1, 0], [-a / spacing, 1 / spacing]]) @ at
    return Fit(law, 'smooth curve in log force', spacing, np.array([force, -a * force / spacing]), turn @ covariance @ turn.T,
               a, float(np.sqrt(at[1] @ covariance @ at[1])), f - repulsion(law, r),
               float(chi2 if forces.sigma is not None else np.nan), float(freedom))


def _bends(knots, n):
    """Matrix from the `n` coefficients of a cubic spline to their second divided differences, zero for a straight line."""
    centres = np.array([knots[k + 1:k + 4].mean() for k in range(n)])  # where a straight line has its coefficients
    return np.diff(np.diff(np.eye(n), axis=0) / np.diff(centres)[:, None], axis=0) * np.ptp(centres)


def _smoothing(design, target, bends):
    """Weight of the `bends` that generalised cross-validation chooses."""
    def score(weight):
        hat = design @ np.linalg.solve(design.T @ design + weight * bends.T @ bends, design.T)
        return np.sum((target - hat @ target) ** 2) / (len(target) - np.trace(hat)) ** 2

    return min(SMOOTHING * np.sum(design**2) / np.sum(bends**2), key=score)


def scene_entry(fit):
    """The table [law] of a scene file, TOML in SI units with all digits: b makes sense only with the a beside it.

    An inverse power comes with the table [uncertainty], in which b, a and their correlation make sense only together.
    """
    lines = ['[law]', f'# {fit.name}: f = {fit.at_spacing[0] / u.N:.6g} +- {fit.sigma[0] / u.N:.1g} N, df/dr = '
             f'{fit.at_spacing[1] / (u.N / u.m):.6g} +- {fit.sigma[1] / (u.N / u.m):.1g} N/m at {fit.spacing / u.m:g} m']
    if fit.offset:
        lines.append(f'# distances are those measured less {fit.offset / u.m:.4g} +- {fit.offset_sigma / u.m:.1g} m')
    if isinstance(fit.law, InversePower):
        lines += ['kind = "inverse_power"', f'b_N_m_a = {fit.law.b / (u.N * u.m**fit.law.a)!r}', f'a = {fit.law.a!r}']
    else:
        lines += ['kind = "table"', f'distances_m = {(fit.law.r / u.m).tolist()}', f'forces_N = {(fit.law.f / u.N).tolist()}']
    lines.append('shells = 1   # the number of shells of neighbours that interact')
    (b, both), (_, a) = fit.strength_covariance
    if isinstance(fit.law, InversePower) and b * a > both**2:
        lines += ['', '[uncertainty]', f'b_percent = {float(100 * np.sqrt(b))!r}', f'a = {float(np.sqrt(a))!r}',
                  f'correlation_a_b = {float(both / np.sqrt(b * a))!r}']
    return '\n'.join([*lines, ''])


def _enough(r, least, what):
    if len(r) < least:
        raise ValueError(f'{what} takes at least {least} points, not {len(r)}; measure more')


def curvature(forces):
    """Change of the local exponent with ln r over its uncertainty: beyond some 3 in size, no inverse power holds.

    From the quadratic term of log f over log r.  Its sign is that of the change: negative when the exponent falls.
    """
    _enough(forces.r, 4, 'the test for a power law')
    x, y = np.log(forces.r / forces.r[0]), np.log(forces.f)
    weights = None if forces.sigma is None else forces.f / forces.sigma
    p, covariance = np.polyfit(x, y, 2, w=weights, cov='unscaled' if weights is not None else True)
    return float(-p[0] / np.sqrt(covariance[0, 0]))
