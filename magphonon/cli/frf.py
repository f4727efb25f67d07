"""`magphonon frf SCENE`: displacement per harmonic force over frequency, for the oscillator or a patch."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .arguments import add_output, add_scene

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

HELP = 'frequency response of the oscillator or of a patch'
SHOWN_PEAKS = 12
"""Number of peaks shown on the terminal, the highest ones; the table holds the whole curve."""
MOST_DIRECTIONS = 3000
"""Largest number of free directions for which the natural frequencies are computed, a dense eigenvalue problem of half a
minute."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ' with [frf]')
    add_output(parser)


def run(options: Namespace) -> None:
    import numpy as np

    from ..plotting.response import plot_response
    from ..response.frf import receptance
    from ..response.normal_modes import natural_frequencies
    from ..scenes.scene import read_scene
    from ..stiffness.linear_system import LinearSystem
    from .costs import refuse_costly
    from .results import results

    scene = read_scene(options.scene)
    refuse_costly(scene, 'frf')
    plan, axes, lines = scene.wanted('frf'), None, [scene.title]
    if (relaxation := scene.relaxation()) is not None:
        lines.append(str(relaxation))
    with results(options, scene) as folder:
        responses = {}
        for model, style in (('complete', '-'), ('conventional', '--')):
            atoms, source, answer = scene.shaken(model)
            system = LinearSystem.of(atoms)
            natural = natural_frequencies(system) if system.free.shape[1] <= MOST_DIRECTIONS else np.empty(0)
            responses[model] = receptance(system, source, answer, plan.omega, plan.damping)
            responses[model].save(folder / f'frf_{model}.npz')
            axes = plot_response(responses[model], natural, axes, label=model, linestyle=style)
            lines += _report(model, responses[model], natural)
        _write_table(folder / 'frf.csv', responses)
        axes[0].figure.suptitle(scene.title, fontsize='medium')
        axes[0].figure.savefig(folder / 'frf.png')
    print('\n'.join(lines))
    print(f'picture and data are in {options.output}')


def _write_table(file, responses):
    """One row for each frequency: amplitude and phase by each model."""
    import numpy as np

    from .. import units
    from ..files import write_columns

    names, columns = ['frequency_Hz'], [responses['complete'].omega / (2 * np.pi) / units.Hz]
    for model, result in responses.items():
        names += [f'{model}_amplitude_m_per_N', f'{model}_phase_deg']
        columns += [abs(result.response) / (units.m / units.N), np.degrees(np.angle(result.response))]
    write_columns(file, names, columns)


def _report(model, result, natural):
    """The report on the terminal for one model: natural frequencies and the highest peaks."""
    import numpy as np
    from scipy.signal import find_peaks

    from .. import units

    f, amplitude = units.hertz(result.omega), abs(result.response) / (units.m / units.N)
    lines = ['', model]
    if len(natural):
        of = units.hertz(natural)
        lines.append(f'  natural frequencies: {of[0]:.6g} Hz' if len(of) == 1 else
                     f'  natural frequencies: {len(of)} from {of[0]:.6g} to {of[-1]:.6g} Hz')
    peaks, _ = find_peaks(amplitude)
    highest = np.sort(peaks[np.argsort(amplitude[peaks])[-SHOWN_PEAKS:]])
    lines.append(f'  {len(peaks)} peaks from {f[0]:g} to {f[-1]:g} Hz, in steps of {f[1] - f[0]:.3g} Hz'
                 + (f'; the {SHOWN_PEAKS} highest:' if len(peaks) > SHOWN_PEAKS else ':' if len(peaks) else ''))
    return lines + [f'  {f[k]:14.6g} Hz {amplitude[k]:14.6g} m/N' for k in highest]
