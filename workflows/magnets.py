"""The law of real magnets, computed from the printed shape and compared with the paper's fit, and a law fitted to forces."""

from dataclasses import replace
from importlib.resources import files

import numpy as np
from scipy.optimize import curve_fit

from magphonon import InversePower, read_scene, units as u
from magphonon.interactions.fits import SharedErrors, fit_forces
from magphonon.interactions.force_tables import read_forces
from magphonon.interactions.magnet_pairs import calibrated, magnet_law, pair_force
from magphonon.interactions.magnets import Cuboid, Ring
from magphonon.interactions.pair_laws import local_exponent, repulsion
from magphonon.plotting.axes import COLOURS, letter_panels, new_figure
from magphonon.plotting.fits import plot_fit
from magphonon.scenes import ready_scene, reference

from .rows import Check, Outcome, Reported, save_picture

WINDOWS = ((7, 12), (7, 15), (8, 15), (8, 20), (9, 20))
"""Distances in mm over which the paper may have measured; it prints none, and the fitted exponent depends on them."""
DENSITY = 7.5e-3                # g/mm^3, with which the printed ring weighs what the paper prints
PLATING = 20e-3                 # mm of nickel on every face, which is no magnet: usual, not printed
RECOIL = 1.05                   # relative permeability of sintered NdFeB
COAXIAL = [((40, 40), (40, 40), 265.537), ((40, 40), (30, 30), 111.490), ((40, 20), (40, 10), 18.953)]
"""Two cylinders, (diameter, height) in mm, their centres 50 mm apart, 1.3 T, and their force in N: from the tests of
W. Robertson's magcode, after Robertson, Cazzolato and Zander, IEEE Trans. Magn. 47, 2045 (2011)."""
OBLIQUE = [(-4, (0.60, 0.60, -1.76)), (4, (-0.60, 0.60, -1.76)), (10, (-1.10, 0.31, -0.64)), (18, (-0.25, 0.02, 0.43))]
"""Force in N on a cuboid of 12 x 20 x 6 mm, 0.38 T, at (x, -4, 8) mm from one of 20 x 12 x 6 mm: read off the figure of
Akoun and Yonnet, IEEE Trans. Magn. 20, 1962 (1984)."""

MAGNETS = {'ring': {'diameter_m': 6.35e-3, 'bore_m': 1.5875e-3, 'height_m': 3.175e-3, 'remanence_T': 1.3},
           'disc': {'diameter_m': 5e-3, 'bore_m': 0.0, 'height_m': 5e-3, 'remanence_T': 1.32},
           'cuboid': {'sides_m': (5e-3, 4e-3, 3e-3), 'remanence_T': 1.2}}
DIPOLES = 'point dipoles'
MAGPYLIB = 'open code or data: magpylib 6.3.0'
BY_MAGPYLIB = {'ring': {7: 2.05538210050956, 10: 0.37700955640567, 15: 0.06380700478424},
               'disc': {7: 1.06356952042677, 10: 0.28829449128715, 15: 0.06054512872955},
               'cuboid': {7: 0.61182658080476, 10: 0.12286804497387, 15: 0.02156541194525}}
"""Force in N between two of them side by side, at distances in mm, by the field of magpylib 6.3.0 on the charges of the faces."""


def main(out):
    """Forces against published ones, the paper's fit beside the computed law, and the synthetic measurement fitted."""
    paper = reference()['prototype']
    scene = read_scene(ready_scene('rings'))
    ring, law, L0 = scene.law.magnet(), scene.law.potential(), scene.lattice.spacing_m * u.m
    fits, fit_checks = fitted(law, L0)
    return Outcome(
        [*published(), *side_by_side(), *spheres(), *beside_the_fit(ring, law, L0, paper), *fit_checks],
        [draw_law(out, ring, law, L0, paper), draw_fit(out, fits)])


def published():
    """Computed forces against forces that others have published."""
    checks = []
    for one, other, force in COAXIAL:
        first, second = (Ring(diameter, 0, height, 1.3 * u.T) for diameter, height in (one, other))
        here = abs(pair_force(first, second, (0, 0, 50 * u.mm))[2]) / u.N
        row = Check(f'coaxial cylinders {one} and {other} mm (N)', here, force, 6e-4 / force,  # printed to 1e-3
                    by='open code or data: tests of magcode (Robertson)')
        moments = np.sqrt(np.prod([magnet.remanence / u.mu0 * magnet.volume for magnet in (first, second)]))
        checks += [row, row.against(2 * repulsion(InversePower.dipoles(moments), 50 * u.mm) / u.N, DIPOLES)]
    lower, upper = Cuboid(20, 12, 6, 0.38 * u.T), Cuboid(12, 20, 6, 0.38 * u.T)
    off = [pair_force(lower, upper, (x, -4, 8)) - force for x, force in OBLIQUE]
    checks.append(Check('oblique cuboids: largest distance from the published figure (N)', np.abs(off).max(), 0, 0.035,
                        by='printed: Akoun and Yonnet, IEEE Trans. Magn. 20, 1962, figure'))
    return checks


def side_by_side():
    """Forces of three kinds of magnets against those by magpylib; the control takes them for point dipoles."""
    checks = []
    for name, forces in BY_MAGPYLIB.items():
        given = MAGNETS[name]
        if 'sides_m' in given:
            magnet = Cuboid(*(side * u.m for side in given['sides_m']), given['remanence_T'] * u.T)
        else:
            magnet = Ring(*(given[f'{what}_m'] * u.m for what in ('diameter', 'bore', 'height')), given['remanence_T'] * u.T)
        dipoles = InversePower.dipoles(magnet.remanence / u.mu0 * magnet.volume)
        for r, force in forces.items():
            here = pair_force(magnet, magnet, (r * u.mm, 0, 0))[0] / u.N
            row = Check(f'two magnets {r} mm apart, {name} (N)', here, force, 1e-8, by=MAGPYLIB)
            checks += [row, row.against(repulsion(dipoles, r * u.mm) / u.N, DIPOLES)]
    return checks


def spheres(n=24):
    """The force between two spheres from their surface charges, against that of two point dipoles."""
    diameter, remanence, r = 5 * u.mm, 1.2 * u.T, 10 * u.mm
    dipoles = InversePower.dipoles(remanence / u.mu0 * np.pi * diameter**3 / 6)
    x, weight = np.polynomial.legendre.leggauss(n)
    angle = np.pi * np.arange(2 * n) / n
    rho, radius = np.sqrt(1 - x**2)[:, None], diameter / 2
    points = radius * np.stack(np.broadcast_arrays(rho * np.cos(angle), rho * np.sin(angle), x[:, None]), -1).reshape(-1, 3)
    charge = np.repeat(remanence / u.mu0 * x * weight * radius**2 * np.pi / n, 2 * n)  # M cos(theta) dA
    force = 0.0
    for here, q in zip(points, charge, strict=True):
        d = points + (r, 0, 0) - here  # noqa: RUF005, a sum of arrays
        force += u.mu0 / (4 * np.pi) * q * np.sum(charge * d[:, 0] / np.sum(d**2, axis=1) ** 1.5)
    return [Check('two spheres by their charges, force at 2 diameters / that of point dipoles',
                  force / repulsion(dipoles, r), 1, 1e-9)]


def beside_the_fit(ring, law, L0, paper):
    """The computed law beside the paper's fit, possible causes of their difference, and the stiffness out of the plane."""
    f, a, lift = repulsion(law, L0), local_exponent(law, L0), 1e-3 * u.mm
    stiffness = -pair_force(ring, ring, (L0, 0, lift))[2] / lift
    fit = paper['f_at_spacing'] * u.N
    return [
        Check('ring: mass at 7.5 g/cm3 (g)', DENSITY * ring.volume, paper['mass'] * u.kg, 1e-3,
              by='printed: arXiv:1911.10410, Supplement'),
        *(Reported(f'exponent of the ring law fitted from {near} to {far} mm, and in the paper',
                   fitted_exponent(law, near, far), paper['a']) for near, far in WINDOWS),
        Reported('force at 10 mm, computed / fitted: not explained', f / fit, 1),
        *(Reported(f'force at 10 mm, computed / fitted: {what}', force / fit, 1) for what, force in candidates(ring, L0).items()),
        *(Reported(f'mass at 7.5 g/cm3 {what} (kg), and in the paper', DENSITY * other.volume / u.kg, paper['mass'])
          for what, other in other_shapes(ring).items()),
        Check('out-of-plane stiffness of a bond / -(a_loc - 1) f/r', stiffness / (-(a - 1) * f / L0), 1, 1e-6),
        Check('control: out-of-plane stiffness of a bond / -f/r of a central law', stiffness / (-f / L0), 1, 1,
              control='a force along the bond'),
    ]


def candidates(ring, L0):
    """Force at L0 in N for magnets that differ from the datasheet, by the name of the difference.

    Demagnetisation: the field that a magnet makes in itself lowers its magnetisation by (mu_r - 1) N, to first order, with the
    demagnetising factor N of a cylinder of the same shape along its axis (Sato and Ishii, J. Appl. Phys. 66, 983 (1989)).
    """
    aspect = ring.height / ring.outer
    demagnetised = 1 - (RECOIL - 1) / (2 * aspect * 2 / np.sqrt(np.pi) + 1)
    plated = Ring(ring.outer - 2 * PLATING, ring.inner + 2 * PLATING, ring.height - 2 * PLATING, ring.remanence)
    weak = replace(plated, remanence=1.28 * u.T * demagnetised)
    magnets = {'with 1.28 T': replace(ring, remanence=1.28 * u.T), 'with 20 um of plating': plated,
               'with demagnetisation at mu_r = 1.05': replace(ring, remanence=ring.remanence * demagnetised),
               'with all three': weak} | other_shapes(ring)
    return {what: repulsion(magnet_law(magnet), L0) for what, magnet in magnets.items()}


def other_shapes(ring):
    """Rings that contradict the printed shape and mass: the metric one has the fitted force, the other is 10 % above it."""
    inch = 25.4 * u.mm
    return {'for a ring with a bore of 1/8 inch': Ring(inch / 4, inch / 8, inch / 8, ring.remanence),
            'for a metric ring, 6 x 2 x 3 mm': Ring(6 * u.mm, 2 * u.mm, 3 * u.mm, ring.remanence)}


def fitted_exponent(law, near, far):
    """Exponent of an inverse power fitted by least squares in the force, over distances in mm."""
    r = np.linspace(near * u.mm, far * u.mm, 71)
    return curve_fit(lambda r, f, a: f * (r / r[0]) ** -a, r, repulsion(law, r), p0=(1, 4))[0][1]


def draw_law(out, ring, law, L0, paper):
    """Draw the force against distance, computed and fitted, and the local exponent."""
    from matplotlib.ticker import NullFormatter, ScalarFormatter

    r = np.geomspace(law.nearest, 40 * u.mm, 300)
    weaker, strong = calibrated(ring, L0, paper['f_at_spacing'] * u.N), magnet_law(ring)
    fit = paper['b'] * u.N * u.m ** paper['a'] * r ** -paper['a']
    figure = new_figure(height=4.4)
    upper, lower = figure.subplots(2, sharex=True, height_ratios=(3, 2))
    letter_panels((upper, lower))
    for ax in (upper, lower):
        ax.axvline(L0 / u.mm, color='0.6', linewidth=0.8, zorder=1)
    upper.loglog(r / u.mm, repulsion(strong, r) / u.N, color=COLOURS[0], label='rings, 1.30 T, computed')
    upper.plot(r / u.mm, repulsion(magnet_law(weaker), r) / u.N, '-.', color=COLOURS[3],
               label=f'{weaker.remanence / u.T:.2f} T: calibrated at 10 mm')
    upper.plot(r / u.mm, fit / u.N, '--', color=COLOURS[1], linewidth=1.8, label="the paper's fit, $a$ = 4.5824")
    upper.plot(r / u.mm, strong.strength * 3 / r**4 / u.N, ':', color='k', label='point dipoles')
    lower.semilogx(r / u.mm, local_exponent(strong, r), color=COLOURS[0], label='local exponent')
    for k, (near, far) in enumerate(WINDOWS):
        lower.plot((near, far), 2 * [fitted_exponent(law, near, far)], 'k|-', linewidth=0.8, markersize=5,
                   label='' if k else 'fitted over such a window')
    lower.axhline(paper['a'], linestyle='--', color=COLOURS[1], linewidth=1.8)
    lower.axhline(4, linestyle=':', color='k')
    lower.legend(loc='upper right')
    upper.set(ylabel='force (N)', ylim=(1e-4, 5))
    lower.set(xlabel='distance of the centres (mm)', ylabel='local exponent', ylim=(3.9, 5.4))
    lower.xaxis.set_minor_formatter(NullFormatter())
    lower.xaxis.set_major_formatter(ScalarFormatter())
    lower.set_xticks([7, 8, 10, 12, 15, 20, 30, 40])
    upper.legend(loc='lower left', frameon=True, framealpha=1, edgecolor='none')  # over the line at 10 mm
    low, high = (f(fitted_exponent(law, *window) for window in WINDOWS) for f in (min, max))
    return save_picture(figure, out / 'magnet_law.png', (
        'Fig. S3 of the paper: (a) force between the rings, computed from the printed shape and grade, and (b) the exponent '
        f"-d ln f/d ln r, {local_exponent(strong, L0):.3f} at 10 mm; fits of an inverse power give {low:.2f} to {high:.2f}, "
        "the paper 4.58."))


def fitted(law, L0):
    """The synthetic measurement fitted, with distances and zero of force taken as exact: how far the fit is from the truth."""
    forces = read_forces(files('magphonon.data') / 'synthetic_force.csv')
    fit = fit_forces(forces, L0, SharedErrors(distance=0.0, zero=0.0, hysteresis=0.0, backlash=0.0, gain=0.0))
    (f, a), covariance = curve_fit(lambda r, f, a: f * (r / L0) ** -a, forces.r, forces.f, p0=(1, 4), sigma=forces.sigma,
                                   absolute_sigma=True)
    true, sigma = repulsion(law, L0), fit.half_widths[0] / 1.96
    left = (forces.f - f * (forces.r / L0) ** -a) / forces.sigma
    return (forces, fit), [
        Check('synthetic set: ln of the force at 10 mm minus the true one (sigma)', np.log(fit.force / true) / sigma, 0, 3),
        Check('synthetic set: exponent at 10 mm minus the true one (sigma)',
              (fit.exponent - local_exponent(law, L0)) / (fit.half_widths[2] / 1.96), 0, 3),
        Check('control: force of an inverse power (sigma)', (f - true) / np.sqrt(covariance[0, 0]), 0, 3,
              control='an inverse power'),
        Check('control: chi2/freedom of the inverse power', left @ left / (len(left) - 2), 1, 1, control='an inverse power'),
    ]


def draw_fit(out, fits):
    """Draw the synthetic measurement with the fitted curve and the residuals."""
    return save_picture(plot_fit(*fits), out / 'magnet_fit.png', 'The force between two rings from synthetic measurements '
                        '(computed, not measured: data/synthetic_force.csv), with the interval of 95 % at the spacing.')
