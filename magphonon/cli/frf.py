"""`magphonon frf SCENE`: displacement per harmonic force as a function of frequency, for the oscillator or a patch."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from .. import units
from ..files import write_columns
from .arguments import add_output, add_scene, add_style, answering

HELP = 'frequency response to a force or a shaken bench, compared with measurements if you have any'
SHOWN_PEAKS = 12  # number of peaks shown on the terminal, the highest ones; the table holds the whole curve


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ' with [frf]')
    parser.add_argument('--measured', metavar='FILE', help='draw measured transfer functions over the computed ones, at the '
                        'points and drives that the file names: a table (frequency_Hz, amplitude_m_per_N, phase_deg or re_..., '
                        'im_...), a '
                        'universal file .uff, or raw records (time_s, drive_N, answer_m)')
    add_output(parser)
    add_style(parser)


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene
    from .neighbours import omission

    scene = read_scene(options.scene)
    plan, measured, relaxation = scene.wanted('frf'), _measured(scene, options), scene.relaxation()
    with answering(options, scene, 'frf.*', 'frf_*.npz', 'frf_measured.*') as (folder, save, told):
        first, lines = _responses(scene, plan, folder, save)
        lines = [scene.title, *([] if relaxation is None else [str(relaxation)]), *lines]
        told += [first, *(lines if options.verbose else []), *_beside(scene, measured, save),
                 *omission(scene, options.verbose),
                 *(scene.foundation.doubts(plan.omega, plan.base_deg is None) if scene.foundation else [])]


def _measured(scene, options):
    """The transfer functions of --measured, at the points and drives that their file names; none without it."""
    if options.measured is None:
        return []
    from ..response.transfer_functions import read_transfer
    from ..scenes.frf_fits import with_dofs  # which loads time steps

    return with_dofs(scene, read_transfer(options.measured))


def _responses(scene, plan, folder, save):
    """Write and draw the responses of both models; return a line with their highest peaks, and lines with further peaks."""
    from ..plotting.response import plot_response
    from ..response.frf import receptance
    from ..stiffness.rest import LinearSystem
    from ..traits import LINEAR

    axes, lines, highest = None, [], []
    pushed, feet = plan.base_deg is None, scene.foundation
    stiffer = feet.beams.excess(plan.omega)[0] if pushed and feet and feet.beams else None
    unit = units.m / units.N if pushed else 1.0
    names, columns = ['frequency_Hz'], [units.hertz(plan.omega)]
    for model, style in (('complete', '-'), ('conventional', '--')):
        atoms, source, answer = scene.shaken(model, bench=True)
        system = LinearSystem.of(atoms, *LINEAR)
        result = receptance(system, source, answer, plan.omega, plan.damping_of(atoms), stiffer=stiffer)
        result.save(folder / f'frf_{model}.npz')
        names += [f'{model}_amplitude' + '_m_per_N' * pushed, f'{model}_phase_deg']
        columns += [abs(result.response) / unit, np.degrees(np.angle(result.response))]
        k = abs(result.response).argmax()
        highest.append(f'{units.hertz(plan.omega[k]):.4g} Hz ({abs(result.response[k]) / unit:.3g}{" m/N" * pushed})')
        natural, told = _natural(system, plan.omega, feet if pushed else None)
        axes = plot_response(result, natural, axes=axes, label=model, linestyle=style)
        lines += ['', model, *told, *_peaks(result, unit)]
    write_columns(folder / 'frf.csv', names, columns)
    save(axes[0].figure, 'frf')
    return f'The response is highest at {highest[0]} with D*, at {highest[1]} without it.', lines


def _beside(scene, measured, save):
    """Draw the measured responses over the computed ones, and return lines that say how much they differ."""
    if not measured:
        return []
    from ..plotting.response import plot_transfer
    from ..scenes.frf_fits import responses_of, suspect_units

    curves = {model: responses_of(scene, model, measured) for model in ('complete', 'conventional')}
    save(plot_transfer(measured, curves), 'frf_measured')
    lines, doubt = ['', *_compared(measured, curves)], suspect_units(scene, measured)
    return lines if doubt is None else [*lines[:-1], f'The measurements look like {doubt}: correct the table, or the name '
                                                     'of its column, first.']


def _compared(functions, curves):
    """Lines that say how much the computed responses differ from each measured one."""
    lines = ['root mean square difference from the measurement, as a fraction of its peak:']
    for k, one in enumerate(functions):
        peak = abs(one.response).max()
        off = {model: np.sqrt(np.mean(abs(one.response - own[k]) ** 2)) / peak for model, own in curves.items()}
        lines.append('  ' + ', '.join(f'{model} {share:.3g}' for model, share in off.items()) + f'  ({one.name})')
        if one.coherence is not None:
            lines.append(f'  its median coherence is {np.median(one.coherence):.3f}, the lowest {one.coherence.min():.3f}')
    return [*lines, '"magphonon fit --frf" fits the lattice to the measurement.']


def _natural(system, omega, feet):
    """The natural frequencies to be drawn, and a line about all of them; those of a large structure are not computed."""
    from ..response.normal_modes import SMALL, natural_frequencies

    size = system.free.shape[1]
    if size > SMALL:
        return np.empty(0), [f'  natural frequencies: {size}']
    natural = natural_frequencies(system)
    if feet and not system.turning:
        natural = feet.slowed(natural, system.masses)
    low, high = units.hertz(natural[[0, -1]])
    if size == 1:
        return natural, [f'  natural frequencies: {low:.6g} Hz']
    inside, f = (natural >= omega[0]) & (natural <= omega[-1]), units.hertz(omega[[0, -1]])
    return natural, [f'  natural frequencies: {size} from {low:.6g} to {high:.6g} Hz, {inside.sum()} of them from {f[0]:g} to '
                     f'{f[1]:g} Hz']


def _peaks(result, unit):
    f, amplitude = units.hertz(result.omega), abs(result.response) / unit
    turns = np.flatnonzero(np.diff(amplitude))  # without equal values that follow each other
    rises = np.diff(amplitude)[turns] > 0
    peaks = turns[1:][rises[:-1] & ~rises[1:]]
    highest = np.sort(peaks[np.argsort(amplitude[peaks])[-SHOWN_PEAKS:]])
    return [f'  {len(peaks)} peak{"s" * (len(peaks) != 1)} from {f[0]:g} to {f[-1]:g} Hz, in steps of {f[1] - f[0]:.3g} Hz'
            + (f'; the {SHOWN_PEAKS} highest:' if len(peaks) > SHOWN_PEAKS else ':' if len(peaks) else ''),
            *(f'  {f[k]:14.6g} Hz {amplitude[k]:14.6g}{" m/N" * (unit != 1)}' for k in highest)]
