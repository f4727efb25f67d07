"""The law of real magnets: from the datasheet against the paper's fit, what accuracy costs, and a law fitted to data."""

from importlib.resources import files

import numpy as np
from scipy.optimize import curve_fit

from magphonon import read_scene, ready_scene
from magphonon import units as u
from magphonon.fitplots import plot_fits
from magphonon.fits import fit_inverse_power, fit_spline, read_forces
from magphonon.magnets import (
    Cuboid,
    Ring,
    Sphere,
    calibrated,
    local_exponent,
    magnet_law,
    out_of_plane_stiffness,
    pair_force,
)
from magphonon.plotting import COLOURS
from magphonon.potentials import repulsion
from magphonon.scenes import reference

from . import magnet_cost
from .charts import save_chart
from .checks import Check, Outcome, save_picture

FITTED = 8 * u.mm, 15 * u.mm    # assumed for the paper's measurement, which it does not print
COAXIAL = [((40, 40), (40, 40), 265.537), ((40, 40), (30, 30), 111.490), ((40, 20), (40, 10), 18.953)]
"""Two cylinders, (diameter, height) in mm, their centres 50 mm apart, 1.3 T, and their force in N: from the tests of
W. Robertson's magcode, after Robertson, Cazzolato and Zander, IEEE Trans. Magn. 47, 2045 (2011)."""
OBLIQUE = [(-4, (0.60, 0.60, -1.76)), (4, (-0.60, 0.60, -1.76)), (10, (-1.10, 0.31, -0.64)), (18, (-0.25, 0.02, 0.43))]
"""Force in N on a cuboid of 12 x 20 x 6 mm, 0.38 T, at (x, -4, 8) mm from one of 20 x 12 x 6 mm: read off the figure of
Akoun and Yonnet, IEEE Trans. Magn. 20, 1962 (1984)."""


def main(out):
    """Forces against published ones, the paper's exponent explained and its force not, and the synthetic measurement fitted."""
    paper = reference()['prototype']
    scene = read_scene(ready_scene('rings'))
    ring, law, L0 = scene.law.magnet(), scene.law.potential(), scene.lattice.spacing_m * u.m
    chart = magnet_cost.chart(ring)
    fits, fit_checks = fitted(law, L0)
    return Outcome(
        [*published(), *spheres(), *explained(ring, law, L0, paper), *chart.checks, *fit_checks],
        [draw_law(out, ring, law, L0, paper), save_chart(chart, out, 'magnet_cost'), draw_fit(out, fits)])


def published():
    """Forces that others printed."""
    checks = []
    for one, other, force in COAXIAL:
        first, second = (Ring(diameter, 0, height, 1.3 * u.T) for diameter, height in (one, other))
        here = abs(pair_force(first, second, (0, 0, 50 * u.mm))[2]) / u.N
        checks.append(Check(f'coaxial cylinders {one} and {other} mm (N)', here, force, 6e-4 / force))  # printed to 1e-3
    lower, upper = Cuboid(20, 12, 6, 0.38 * u.T), Cuboid(12, 20, 6, 0.38 * u.T)
    off = [pair_force(lower, upper, (x, -4, 8)) - force for x, force in OBLIQUE]
    checks.append(Check('oblique cuboids: largest distance from the published figure (N)', np.abs(off).max(), 0, 0.035))
    return checks


def spheres(n=24):
    """Two spheres by their surface charges, against the point dipoles that stand for them."""
    sphere, r = Sphere(5 * u.mm, 1.2 * u.T), 10 * u.mm
    x, weight = np.polynomial.legendre.leggauss(n)
    angle = np.pi * np.arange(2 * n) / n
    rho, radius = np.sqrt(1 - x**2)[:, None], sphere.diameter / 2
    points = radius * np.stack(np.broadcast_arrays(rho * np.cos(angle), rho * np.sin(angle), x[:, None]), -1).reshape(-1, 3)
    charge = np.repeat(sphere.remanence / u.mu0 * x * weight * radius**2 * np.pi / n, 2 * n)  # M cos(theta) dA
    force = 0.0
    for here, q in zip(points, charge, strict=True):
        d = points + (r, 0, 0) - here  # noqa: RUF005, a sum of arrays
        force += u.mu0 / (4 * np.pi) * q * np.sum(charge * d[:, 0] / np.sum(d**2, axis=1) ** 1.5)
    return [Check('two spheres by their charges, force at 2 diameters / that of point dipoles',
                  force / repulsion(magnet_law(sphere), r), 1, 1e-9)]


def explained(ring, law, L0, paper):
    """The paper's fit beside the computed law; stability out of the plane."""
    f, a, lift = repulsion(law, L0), local_exponent(law, L0), 1e-3 * u.mm
    stiffness = -pair_force(ring, ring, (L0, 0, lift))[2] / lift
    weaker = calibrated(ring, L0, paper['f_at_spacing'] * u.N)
    return [
        Check('ring: mass at 7.5 g/cm3 / mass of the paper', 7.5e-3 * ring.volume, paper['mass'] * u.kg, 1e-3),
        Check('exponent of the ring law fitted from 8 to 15 mm', fitted_exponent(law), paper['a'], 5e-3),
        Check('control: the exponent of dipoles', 4.0, paper['a'], 5e-3, control=True),
        Check('computed force at 10 mm / fitted force: 59 % more, unexplained', f / (paper['f_at_spacing'] * u.N), 1.59, 2e-3),
        Check('the same after calibration to the fitted force', repulsion(magnet_law(weaker), L0) / (paper['f_at_spacing'] * u.N),
              1, 1e-12),
        Check('out-of-plane stiffness of a bond / -(a_loc - 1) f/r', stiffness / (-(a - 1) * f / L0), 1, 1e-6),
        Check('control: the same / -f/r of a central law', stiffness / (-f / L0), 1, 1, control=True),
    ]


def fitted_exponent(law):
    """Of an inverse power by least squares in force, over the distances of the paper."""
    r = np.linspace(*FITTED, 71)
    return curve_fit(lambda r, f, a: f * (r / FITTED[0]) ** -a, r, repulsion(law, r), p0=(1, 4))[0][1]


def draw_law(out, ring, law, L0, paper):
    """Force against distance, computed and fitted, and the local exponent."""
    from matplotlib.figure import Figure
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    r = np.geomspace(law.nearest, 40 * u.mm, 300)
    inside = (r >= FITTED[0]) & (r <= FITTED[1])
    weaker, strong = calibrated(ring, L0, paper['f_at_spacing'] * u.N), magnet_law(ring)
    fit = paper['b'] * u.N * u.m ** paper['a'] * r ** -paper['a']
    figure = Figure((5.6, 6.6), layout='constrained')
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    for ax in (upper, lower):
        ax.axvspan(FITTED[0] / u.m, FITTED[1] / u.m, color='0.92', zorder=0)
        ax.axvline(L0 / u.m, color='0.6', linewidth=0.8, zorder=1)
    upper.loglog(r / u.m, repulsion(strong, r) / u.N, color=COLOURS[0], label='N42 rings, 1.30 T, computed')
    upper.plot(r / u.m, repulsion(magnet_law(weaker), r) / u.N, '-.', color=COLOURS[3],
               label=f'the same, calibrated at 10 mm ({weaker.remanence / u.T:.2f} T)')
    upper.plot(r[inside] / u.m, fit[inside] / u.N, '--', color=COLOURS[1], linewidth=2.5, label="the paper's fit, $a$ = 4.5824")
    upper.plot(r / u.m, strong.strength * 3 / r**4 / u.N, ':', color='k', label='point dipoles of the same moment')
    lower.semilogx(r / u.m, local_exponent(strong, r), color=COLOURS[0])
    lower.plot(r[inside] / u.m, np.full(inside.sum(), paper['a']), '--', color=COLOURS[1], linewidth=2.5)
    lower.axhline(4, linestyle=':', color='k')
    k = -out_of_plane_stiffness(strong, L0) / (u.N / u.m)
    lower.text(0.98, 0.9, f'at 10 mm: $a$ = {local_exponent(strong, L0):.3f}, pull out of the plane\n'
               f'$(a-1)f/r$ = {k:.0f} N/m per bond', ha='right', va='top', transform=lower.transAxes, fontsize=9)
    upper.set(ylabel='force (N)', ylim=(1e-4, 5))
    lower.set(xlabel='distance of the centres (m)', ylabel='local exponent $-d\\ln f/d\\ln r$', ylim=(3.9, 5.2))
    lower.xaxis.set_minor_formatter(NullFormatter())
    lower.xaxis.set_major_formatter(ScalarFormatter())
    lower.set_xticks([0.008, 0.01, 0.015, 0.02, 0.03, 0.04])
    upper.legend(fontsize=8, loc='lower left')
    return save_picture(figure, out / 'magnet_law.png', (
        "Force between the rings from their datasheet. Over 8 to 15 mm (grey, assumed for the paper's measurement) its exponent "
        f"is {fitted_exponent(law):.2f}: the shape explains the paper's 4.58, which no dipole has. The amplitude stays "
        'unexplained: the computed force at 10 mm is 59 % above the fitted one.'))


def fitted(law, L0):
    """Laws fitted to the synthetic measurement, and how far they are from what it was made of."""
    forces = read_forces(files('magphonon.data') / 'synthetic_force.csv')
    fits = [fit_inverse_power(forces, L0), fit_inverse_power(forces, L0, 'log'), fit_spline(forces, L0)]
    f = repulsion(law, L0)
    power, curve = ((fit.at_spacing[0] - f) / fit.sigma[0] for fit in (fits[0], fits[2]))
    return (forces, fits), [
        Check('synthetic set: force of the smooth curve at 10 mm - true (sigma)', curve, 0, 3),
        Check('control: that of the inverse power (sigma)', power, 0, 3, control=True),
        Check('control: chi2/freedom of the inverse power', fits[0].chi2 / fits[0].freedom, 1, 1, control=True),
    ]


def draw_fit(out, fits):
    """The synthetic measurement with its laws and their residuals."""
    figure = plot_fits(*fits)
    figure.axes[0].get_legend().get_texts()[-1].set_text('synthetic forces of rings, noise 2 mN')
    return save_picture(figure, out / 'magnet_fit.png', 'Laws fitted to synthetic forces (computed, not measured: '
                        'data/synthetic_force.csv). The residuals of the inverse powers bend, those of the smooth curve do not.')
