"""Tolerances: ribbons on the prototype's bands and on the oscillator's response, against 10 000 lattices drawn at random."""


import numpy as np

from magphonon import Bands, read_scene, ready_scene, units
from magphonon.bands.bands import path_of
from magphonon.design.uncertainty import Tolerances, frequency_spread, response_spread
from magphonon.plotting.axes import COLOURS, legend_above, new_axes
from magphonon.plotting.response import plot_band_ribbons, plot_contributions, plot_response_ribbon
from magphonon.scenes.tolerances import Uncertainty

from .rows import Check, Outcome, save_picture

SAMPLES = 10_000  # they know a standard deviation to 1/sqrt(2 SAMPLES) = 0.7 %
TOLERANCE = 0.02
POINTS = {'cut-off': ([0, 0, 0], 0), 'M shear': ([0.5, 0, 0], 0), 'M longitudinal': ([0.5, 0, 0], 1), 'K': ([2 / 3, 1 / 3, 0], 0)}
ONE_PERCENT = {f'{name}_percent': 1.0 for name in ('spacing', 'mass', 'a', 'youngs_modulus', 'radius', 'height')}
FIT = {'b_percent': 21.1, 'correlation_a_b': -0.999}  # as a fit to distances about 10 mm: the force there is known to 1 %
HERTZ = 2 * np.pi * units.Hz  # rad/ms
WIDE = np.geomspace(0.003, 0.3, 9)  # of the spacing


def main(out):
    """Linear propagation against sampling; without the correlation and without D* it fails."""
    scene = read_scene(ready_scene('prototype'))
    tolerances = Uncertainty(**ONE_PERCENT, **FIT).tolerances(scene)
    linear, drawn = at_points(scene, tolerances), closed_form(scene, tolerances)
    sampled = drawn.std(axis=0, ddof=1) / HERTZ
    checks = [Check(f'1 % tolerances: deviation of {name}, linear and of {SAMPLES} lattices (Hz)', std, sample, TOLERANCE,
                    consistency=True)
              for name, std, sample in zip(POINTS, linear.std / HERTZ, sampled, strict=True)]
    uncorrelated = Tolerances(tolerances.changes, np.diag(np.diag(tolerances.covariance)))
    wrong = at_points(scene, uncorrelated).std[1] / HERTZ, at_points(scene, tolerances, 'conventional').std[1] / HERTZ
    checks += [Check('control: deviation of M shear, a and b taken as independent (Hz)', wrong[0], sampled[1], 1, control=True),
               Check('control: deviation of M shear, D0 alone (Hz)', wrong[1], sampled[1], 0.1, control=True)]
    bare = scene.model_copy(update={'foundation': None})
    spacing = at_points(bare, Uncertainty(spacing_percent=1.0).tolerances(bare))
    percent = 100 * spacing.std[1] / spacing.values[1]
    checks.append(Check('1 % in the spacing, no foundation: change of M shear (%), (a + 1)/2', percent, 2.7912, 1e-9))

    response, sampled = oscillator()
    apart = abs(response.std / sampled - 1)
    half_way = response.values < response.values.max() / np.sqrt(2)  # within the peak's width the second order counts
    checks += [Check(f'oscillator: deviation of the amplitude beside the peak, linear / {SAMPLES} random - 1',
                     apart[half_way].max(), 0, TOLERANCE, consistency=True),
               Check('control: deviation on top of the peak, where the slope vanishes', apart.max(), 0, 0.05, control=True)]
    return Outcome(checks, [*draw_bands(out), draw_limit(out, scene), draw_response(out, response, sampled)])


def at_points(scene, tolerances, model='complete'):
    """The Spread of the frequencies at POINTS."""
    wavevectors, branches = zip(*POINTS.values(), strict=True)
    spread = frequency_spread(scene.atoms(), wavevectors, tolerances, model)
    k = np.arange(len(POINTS))
    return type(spread)(spread.names, spread.covariance, spread.values[k, branches], spread.slopes[:, k, branches])


def closed_form(scene, tolerances):
    """Frequencies at POINTS of lattices drawn at random, by the paper's formulas, in rad/ms, shape (SAMPLES, 4)."""
    factor = dict(zip(tolerances.changes, tolerances.samples(SAMPLES).T, strict=True))
    pillar = scene.foundation.pillar
    L, m = scene.lattice.spacing_m * factor['spacing'], scene.lattice.mass_kg * factor.get('mass', 1)
    a, b = scene.law.a * factor.get('a', 1), scene.law.b_N_m_a * factor.get('b', 1)
    pillars = factor.get('youngs_modulus', 1) * factor.get('radius', 1) ** 4 / factor.get('height', 1) ** 3
    k, t = pillar.stiffness_N_per_m * pillars / m, b * L**-a / (L * m)
    squares = np.broadcast_arrays(k, k + (2 * a - 6) * t, k + (6 * a - 2) * t, k + 4.5 * (a - 1) * t)
    return np.sqrt(np.transpose(squares)) / units.s


def oscillator():
    """Spread of the amplitude at 30 degrees (k = 4.5 f/L0) by the formula and over oscillators drawn at random."""
    scene = read_scene(ready_scene('oscillator'))
    tolerances = scene.uncertainty.tolerances(scene)
    atoms, source, answer = scene.shaken()
    omega, gamma = scene.frf.omega[::3], scene.frf.damping
    spread = response_spread(atoms, source.force(len(atoms)), answer, omega, gamma, tolerances)
    spacing, mass = (factor[:, None] for factor in tolerances.samples(SAMPLES).T)
    k, m = 45e3 * units.N / units.m * spacing**-5, 1 * units.kg * mass
    return spread, abs(1 / (k - m * omega**2 + 1j * m * omega * gamma)).std(axis=0, ddof=1)


def draw_bands(out):
    """Draw bands of the ready scene with their ribbons, in both models, and bars for the causes of the uncertainty."""
    scene = read_scene(ready_scene('tolerances'))
    atoms, tolerances = scene.atoms(), scene.uncertainty.tolerances(scene)
    path, ax = path_of(atoms, scene.band_path()), None
    for model, line in (('complete', '-'), ('conventional', '--')):
        spread = frequency_spread(atoms, path.kpts, tolerances, model)
        ax = plot_band_ribbons(Bands(path, spread.values), spread, ax=ax, label=model, linestyle=line)
    bars = plot_contributions(at_points(scene, tolerances), list(POINTS))
    return [save_picture(ax.figure, out / 'uncertainty_bands.png',
                         'The prototype with tolerances of about half a percent (chosen here: the paper gives none): the shear '
                         'branches of the two models lie far outside each other\'s ribbons; the longitudinal ribbons touch.'),
            save_picture(bars.figure, out / 'uncertainty_contributions.png',
                         'The causes of the uncertainty: the spacing contributes most at M, the radius of the pillars '
                         'most to the cut-off. The correlated parameters a and b count as one.')]


def error_of_linear(scene, sigma):
    """Relative error of linear standard deviations at all POINTS but the cut-off, if the spacing has the deviation `sigma`."""
    tolerances = Uncertainty(spacing_percent=100 * sigma).tolerances(scene)
    return abs(closed_form(scene, tolerances).std(axis=0)[1:] / at_points(scene, tolerances).std[1:] - 1)


def draw_limit(out, scene):
    """Draw the error of linear propagation against the tolerance of the spacing."""
    ax = new_axes()
    apart = np.array([error_of_linear(scene, sigma) for sigma in WIDE])
    for name, row, marker, colour in zip(list(POINTS)[1:], apart.T, 'os^', COLOURS, strict=False):
        ax.loglog(100 * WIDE, row, marker, color=colour, fillstyle='none', label=name)
    ax.loglog(100 * WIDE, 0.75 * (2.8 * WIDE) ** 2, '--', color='0.5', label=r'$\propto \sigma^2$')
    ax.axhline(1 / np.sqrt(2 * SAMPLES), color='0.5', linestyle=':', label=f'chance, {SAMPLES} lattices')
    ax.set(xlabel='standard deviation of the spacing (%)', ylabel='linear deviation, relative error', ylim=(1e-4, None))
    legend_above(ax, ncols=2)
    return save_picture(ax.figure, out / 'uncertainty_limit.png',
                        'Linear propagation against lattices drawn at random: below 3 % of spacing it is right within sampling '
                        'noise; beyond, its error grows with the square.')


def draw_response(out, response, sampled):
    """Draw the response with its ribbon, and the standard deviations from sampling."""
    scene = read_scene(ready_scene('oscillator'))
    omega = scene.frf.omega[::3]
    ax = plot_response_ribbon(omega, response, label='linear')
    f, unit = omega / (2 * np.pi) / units.Hz, units.m / units.N
    drawn = {'linestyle': '', 'marker': '.', 'color': 'k', 'markersize': 3}
    ax.plot(f, (response.values + 2 * sampled) / unit, label=rf'$\pm 2\sigma$ of {SAMPLES} oscillators', **drawn)
    ax.plot(f, (response.values - 2 * sampled) / unit, **drawn)
    ax.set_xlim(26, 42)
    ax.set_ylim(3e-5, 6e-4)
    legend_above(ax, ncols=1)
    return save_picture(ax.figure, out / 'uncertainty_response.png',
                        "The oscillator's response at 30 degrees, its spacing known to 0.2 % and its mass to 0.1 %: "
                        'on the flanks of the peak the amplitude is uncertain; at its top, to first order, it is not.')
