"""`magphonon uncertainty SCENE`: standard deviations of bands and responses from the tolerances in [uncertainty]."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from .. import units
from ..files import write_columns
from .arguments import add_output, add_scene, add_style, answering

HELP = 'how uncertain bands and responses are, given the tolerances of the parts'
SAMPLES = 1000
"""Number of lattices drawn at random to check the linear propagation.  The relative sampling error of their standard deviation is
1/sqrt(2 SAMPLES), 2.2 %."""
SIGNIFICANT_DIFFERENCE = 5 / (2 * SAMPLES) ** 0.5
"""Relative difference of two standard deviations that sampling noise does not explain."""
SECOND_ORDER_RATIO = 0.5
"""Ratio of the second-order to the first-order standard deviation on a peak above which the ribbon is too narrow, by 12 % at this
ratio."""
OWN_SCATTER = ('To first order, independent scatter of the particles broadens the bands of an infinite lattice but does not '
               'shift them. It makes the response of a finite structure uncertain.')
"""Sentence printed below the bands of a lattice whose particles differ."""
LINEAR_RANGE = 0.3  # relative standard deviation of an amplitude above which the flank of a peak is not a straight line


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ' with [uncertainty]', 'tolerances')
    add_output(parser)
    add_style(parser)


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene
    from .neighbours import omission

    scene = read_scene(options.scene).counted()
    tolerances = scene.wanted('uncertainty').tolerances(scene)
    bands = scene.bands is not None or scene.frf is None
    if bands and (scene.single or scene.finite):
        raise ValueError(f'the scene {scene.title!r} has no [frf], so there is no response whose uncertainty could be computed; '
                         'add [frf]')
    with answering(options, scene, 'band_uncertainty.*', 'contributions.*', 'frf_uncertainty.*') as (folder, save, told):
        if bands:
            told += _bands(folder, save, scene, tolerances, options.verbose) if tolerances.changes else []
            told += [OWN_SCATTER] if tolerances.scatter else []
        if scene.frf is not None:
            first, *more = _response(folder, save, scene, tolerances)
            told += [first, *(more if options.verbose else [])]
        told += [] if bands and tolerances.changes else omission(scene, options.verbose)


def _bands(folder, save, scene, tolerances, verbose):
    from ..bands.bands import Bands, path_of
    from ..design.uncertainty import frequency_spread
    from ..plotting.axes import point_name
    from ..plotting.response import plot_band_ribbons, plot_contributions
    from .neighbours import neighbours, too_few

    atoms = scene.perfect_cell()
    path = path_of(atoms, scene.band_path())
    spread = frequency_spread(atoms, path.kpts, tolerances)
    spread.save(folder / 'band_uncertainty.npz')
    names, columns = ['path_rad_per_m', 'q1', 'q2', 'q3'], [path.get_linear_kpoint_axis()[0] * units.m, *path.kpts.T]
    for mode in range(spread.values.shape[1]):
        names += [f'frequency_{mode + 1}_Hz', f'std_{mode + 1}_Hz']
        columns += [units.hertz(values[:, mode]) for values in (spread.values, spread.std)]
    write_columns(folder / 'band_uncertainty.csv', names, columns, missing=names[5::2])  # a frequency of zero has no slope
    ax = plot_band_ribbons(Bands(path, spread.values), spread, label='complete')
    save(ax.figure, 'band_uncertainty')

    few, labels = _special_points(atoms, path, tolerances)
    ax = plot_contributions(few, [f'{point_name(name)}, branch {branch}' for name, branch in labels])
    save(ax.figure, 'contributions')

    unit = 2 * np.pi * units.Hz
    relative = 100 * few.std / few.values
    least, most = relative.argmin(), relative.argmax()
    first = (f'The frequencies at special points have standard deviations of {relative[least]:.2g} % ({labels[least][0]}, branch '
             f'{labels[least][1]}) to {relative[most]:.2g} % ({labels[most][0]}, branch {labels[most][1]}).')
    lines = ['Standard deviation of each frequency in Hz, and the part of it that each parameter alone explains',
             f'{"frequency (Hz)":18}{"":>12}{"std":>10}' + ''.join(f'{name:>{len(name) + 3}}' for name in few.contributions)]
    for row, (name, branch) in enumerate(labels):
        shares = ''.join(f'{std[row] / unit:>{len(group) + 3}.2g}' for group, std in few.contributions.items())
        lines.append(f'  {f"{name}, branch {branch}":16}{few.values[row] / unit:12.6g}{few.std[row] / unit:10.3g}{shares}')
    points = {name: path.special_points[name] for name, _ in labels}
    within = {label: 1.96 * float(std / value) for label, std, value in zip(labels, few.std, few.values, strict=True)}
    agrees, checked = _monte_carlo(scene, path, tolerances, few, labels)
    near = neighbours(scene, points, within=within) if verbose else too_few(scene, points, within)
    return [first, *(lines if verbose else []), *(checked if verbose or not agrees else []), *near]


def _special_points(atoms, path, tolerances):
    from ..bands.bands import points_on
    from ..design.uncertainty import frequency_spread

    points = points_on(path)
    at = frequency_spread(atoms, list(points.values()), tolerances)
    kept = [(k, mode) for k in range(len(points)) for mode, f in enumerate(at.values[k])
            if f > 0 and (mode == 0 or abs(f - at.values[k, mode - 1]) > 1e-6 * f)]
    k, mode = np.array(kept).T
    few = type(at)(at.names, at.covariance, at.values[k, mode], at.slopes[:, k, mode])
    return few, [(list(points)[k], mode + 1) for k, mode in kept]


def _monte_carlo(scene, path, tolerances, few, labels):
    from ..bands.bands import points_on
    from ..design.uncertainty import sampled_frequencies
    from ..scenes.tolerances import varied

    points, cell = points_on(path), scene.perfect_cell()
    drawn = sampled_frequencies(lambda factors: varied(scene, factors).perfect_cell(cell), list(points.values()), tolerances,
                                SAMPLES)
    unstable = np.mean((drawn < -1e-6 * abs(drawn).max()).any(axis=(1, 2)))
    k, mode = np.array([(list(points).index(name), branch - 1) for name, branch in labels]).T
    certain = few.std <= 1e-9 * few.values  # frequencies that depend on no tolerance
    apart = abs(drawn.std(axis=0, ddof=1)[k, mode][~certain] / few.std[~certain] - 1).max(initial=0.0)
    agrees = apart <= SIGNIFICANT_DIFFERENCE and not unstable
    lines = [f'Monte Carlo check ({SAMPLES} samples): standard deviations '
             + (f'agree within {100 * apart:.2g} %; sampling noise is {100 / (2 * SAMPLES) ** 0.5:.1g} % each' if agrees else
                f'differ by up to {100 * apart:.2g} %: the tolerances are too wide for a propagation to first order')]
    if unstable:
        lines.append(f'UNSTABLE: {100 * unstable:.2g} % of the samples buckle')
    return agrees, lines


def _response(folder, save, scene, tolerances):
    from ..design.uncertainty import response_spread
    from ..plotting.response import plot_response_ribbon

    atoms, source, answer = scene.shaken()
    omega = scene.frf.omega
    spread = response_spread(atoms, source.force(len(atoms)), answer, omega, scene.frf.damping, tolerances)
    spread.save(folder / 'frf_uncertainty.npz')
    f, unit = units.hertz(omega), units.m / units.N
    write_columns(folder / 'frf_uncertainty.csv', ['frequency_Hz', 'amplitude_m_per_N', 'std_m_per_N'],
                  [f, spread.values / unit, spread.std / unit])
    ax = plot_response_ribbon(omega, spread, label='complete')
    save(ax.figure, 'frf_uncertainty')
    relative = spread.std / spread.values
    lost = np.mean(relative > LINEAR_RANGE)
    lines = [f'response: the standard deviation of the amplitude has a median of {100 * np.median(relative):.2g} % '
                 f'and a maximum of {100 * relative.max():.2g} %, at {f[relative.argmax()]:.5g} Hz']
    if lost:
        lines.append(f'it is above {100 * LINEAR_RANGE:.0f} % at {100 * lost:.2g} % of the frequencies: there the peaks move by '
                     f'more than their width, and the ribbon only says that the amplitude is unknown')
    return [*lines, *_peaks(f, spread)]


def _peaks(f, spread):
    """Lines on the peaks of the response to second order: at a peak the amplitude has no slope, so it can only fall.

    They are valid for a peak of a single resonance that moves by less than its width, and not between peaks.
    """
    v, std, second = spread.values, spread.std, spread.second_order
    peaks = 1 + np.flatnonzero((v[1:-1] > v[:-2]) & (v[1:-1] > v[2:]))
    narrow = peaks[second[peaks] > SECOND_ORDER_RATIO * std[peaks]]
    told = narrow[second[narrow] <= LINEAR_RANGE * v[narrow]]
    lines = []
    if len(told):
        k = told[(second / v)[told].argmax()]
        share = second[k] / v[k]
        lines.append(f'at {len(told)} of {len(peaks)} peaks the ribbon is too narrow, because the amplitude of a peak hardly '
                     f'changes to first order. To second order its standard deviation is up to {100 * share:.2g} %, at '
                     f'{f[k]:.5g} Hz, and its mean is {100 * share / 2**0.5:.2g} % lower')
    if len(told) < len(narrow):
        lines.append(f'at the top of {len(narrow) - len(told)} of {len(peaks)} peaks the ribbon is meaningless, because these '
                     f'peaks move by a large part of their width')
    return lines
