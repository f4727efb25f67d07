"""`magphonon burst SCENE`: tone bursts through the patch of a scene, in both models, compared with the bands.

The exit status is 0 if all bursts ran to their end, even if the lattice buckles; "magphonon check" reports that with status 1.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

import numpy as np

from .. import units
from ..errors import whole
from ..files import write_columns
from .arguments import add_output, add_scene, add_style, answering

FILM = 120  # largest number of frames of a film: ten periods of the carrier, in which the front of a burst crosses a patch
HELP = 'send tone bursts through a patch and see their fronts, with D* and without it'


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ' with [patch] and [burst]')
    add_output(parser)
    add_style(parser)
    parser.add_argument('--engine', choices=('ase', 'compiled', 'lammps'),
                        help="what makes the time steps: ASE's VelocityVerlet, compiled blocks of its steps, or LAMMPS (complete "
                             'model only); by default the exact linear motion where nonlinear forces change it by less than the '
                             'tolerance, and otherwise ASE, or for long runs compiled blocks')
    parser.add_argument('--ranks', metavar='N', type=int, help='MPI ranks of LAMMPS (default: 1)')
    parser.add_argument('--files', metavar='DIR', help="directory for LAMMPS's files, a folder with submit.sh for each burst; "
                                                       'a burst that has already run there, on this machine or on a cluster, is '
                                                       'read and not run again')
    parser.add_argument('--animation', action='store_true',
                        help='also a GIF of each burst crossing the patch, both models side by side')


def run(options: Namespace) -> None:
    from tqdm import tqdm

    from ..scenes.scene import read_scene
    from ..waves.ridge_tables import write_ridges
    from ..waves.wave_analysis import MODELS
    from .neighbours import omission

    engine = _engine(options)
    scene = read_scene(options.scene)
    plan, _, cell = scene.wanted('burst'), scene.wanted('patch'), scene.perfect_cell()
    with answering(options, scene, 'row.csv', 'ridges.*', *(f'{name}_*' for name in plan.names)) as (folder, save, told):
        records, largest, methods, patches = {}, {}, {}, {model: scene.patch_atoms(model) for model in MODELS}
        for k, name in enumerate(tqdm(plan.names, desc='bursts', disable=None)):
            passages = {model: _send(scene, k, cell, patch, engine(name, model)) for model, patch in patches.items()}
            found = {model: _seen(passage.row, cell, plan.source) for model, (*_, passage) in passages.items()}
            _save(folder, name, passages, found, options.animation)
            _draw(save, name, plan.carriers_Hz[k], passages, found)
            records |= {f'{name}_{model}': found[model] for model in MODELS}
            largest |= {f'{name}_{model}': passage.largest for model, (*_, passage) in passages.items()}
            methods |= {f'{name}_{model}': (passage.steps, passage.nonlinear) for model, (*_, passage) in passages.items()}
        patch, site, _ = passages['complete']
        places = patch.calc.reference.positions[site.row, :2].T / units.m
        write_columns(folder / 'row.csv', ['step', 'particle', 'x_m', 'y_m'], [range(len(site.row)), site.row, *places])
        write_ridges(folder / 'ridges.csv', records)
        warnings, everything = _report(scene, cell, records, largest)
        (folder / 'ridges.txt').write_text('\n'.join(everything) + '\n', encoding='utf-8')
        told += [*_conclusion(records), *_methods(methods, plan.tolerance)]
        told += [*(everything if options.verbose else warnings), *omission(scene, options.verbose)]


def _report(scene, cell, records, largest):
    """Lines with warnings, and with all ridges and these warnings."""
    from ..waves.wave_report import report

    unstable, found = _unstable(cell), scene.relaxation()
    quiet, loud = _amplitudes(cell, largest, np.inf if unstable else _linear_range(cell))
    warnings = [*loud, *_decays(scene.burst, cell, records), *unstable]
    return warnings, [scene.title, *([] if found is None else [str(found)]), '', report(records), '', *quiet, *warnings]


def _methods(methods, tolerance):
    """A line that says which bursts are linear motion and which are time steps, and why; none if the user has chosen."""
    from ..scenes.plans import TOLERANCE

    stepped, linear = ([change for steps, change in methods.values() if steps is kind] for kind in (True, False))
    if np.isnan(stepped).any():
        return []
    return [f'{len(linear)} of {len(methods)} bursts are exact linear motion, which nonlinear forces change by less than the '
            f'tolerance of {tolerance or TOLERANCE:g} (by at most {max(linear, default=0.0):.1g})'
            + f'; {len(stepped)} take time steps, as nonlinear forces change them by up to {max(stepped, default=0.0):.1g}'
            * bool(stepped)]


def _engine(options):
    """A function that returns the engine of a burst, as keywords of `send`, for the name of the burst and the model."""
    if options.engine != 'lammps' and (options.ranks is not None or options.files is not None):
        raise ValueError('--ranks and --files apply to LAMMPS only; add --engine lammps')
    ranks = whole('--ranks', 1 if options.ranks is None else options.ranks)

    def of(name, model):
        if options.engine != 'lammps' or model != 'complete':  # LAMMPS has no other model
            return {'engine': options.engine if options.engine in ('ase', 'compiled') else 'least', 'film': options.animation}
        return {'engine': 'lammps', 'ranks': ranks, 'directory': options.files and Path(options.files, name),
                'film': options.animation}

    return of


def _seen(row, cell, source):
    """The waves along the row; on a shaken bench they come from all walls, and count as those of a point source."""
    from ..waves.wave_analysis import waves

    return [replace(wave, source='point') for wave in waves(row, cell, 'row')] if source == 'bench' else waves(row, cell, source)


def _send(scene, k, cell, patch, engine):
    """Patch, source and passage of burst number k."""
    from ..errors import Diverged

    try:
        site, passage = scene.burst.send(k, cell, patch, **engine)
    except Diverged as error:
        what = f'burst {scene.burst.names[k]}, {patch.calc.parameters.model} simulation'
        if unstable := _unstable(cell):
            raise ValueError(f'{what}: at {error.time:g} ms particles leave their sites. ' + ' '.join(unstable)) from error
        raise ValueError(f'{what}: it diverged at {error.time:g} ms (particle {error.particle}); lower burst.force_N') from error
    return patch, site, passage


def _save(folder, name, passages, found, filmed):
    from ..plotting.animation import animate
    from ..waves.scan_tables import write_scan

    for model, (*_, passage) in passages.items():
        write_scan(folder / f'{name}_{model}.csv', passage.row)
        for wave in found[model]:
            wave.spectrum.save(folder / f'{name}_{model}_{wave.motion}.npz')
    if filmed:
        patch, site, passage = passages['complete']
        times, films = passage.field.times[:FILM], {}
        for model, (*_, other) in reversed(passages.items()):  # as in the paper; each model has time steps of its own
            near = abs(other.field.times[:, None] - times).argmin(axis=0)
            films[f'{model} simulation'] = other.field.displacements[near]
        animate(folder / f'{name}_film.gif', patch, films, times, title=name.replace('_', ', '), site=site)


def _draw(save, name, carrier, passages, found):
    from ..plotting.waves import plot_crossing, plot_waves

    motions = list(dict.fromkeys(wave.motion for waves in found.values() for wave in waves))
    order = ('conventional', 'complete')  # as in the paper
    table = [[next((wave for wave in found[model] if wave.motion == motion), None) for model in order] for motion in motions]
    names = [f'{model} simulation, {motion} motion' for motion in motions for model in order]
    save(plot_waves(table, names, [carrier] * len(motions))[0], f'{name}_maps')
    save(plot_crossing({model: passages[model] for model in order}), f'{name}_snapshot')


def _conclusion(records):
    """Lines that say to which branches the ridges belong, and how far they are from the branches of each model."""
    from ..waves.wave_analysis import BRANCHES, MODELS

    lines, astray = [], 0
    for model in MODELS:
        ridges = [wave for record, found in records.items() if record.endswith(f'_{model}') for wave in found if wave.ridge]
        astray += sum(not wave.agrees_with for wave in ridges)
        for name in BRANCHES:
            lines += _following(ridges, model, name)
    lines += ['(one bin is the resolution in wavenumber: 2 pi divided by the number of sites in the row)'] * bool(lines)
    if astray:
        lines.append(f'{astray} of all ridges follow no branch; the report of --verbose lists possible reasons')
    return lines or ['no ridge: the waves decay, or are below the noise']


def _following(ridges, model, name):
    """A line on the ridges of a simulation that follow one branch of its model, if there are any."""
    from ..waves.spectrum import RESOLVED
    from ..waves.wave_analysis import MODELS

    here = [wave.misfits for wave in ridges if (model, name) in wave.agrees_with]
    if not here:
        return []
    (other,) = {*MODELS} - {model}
    near, far = (sorted(misfits[which, name].bins for misfits in here) for which in (model, other))
    away = ' to '.join(dict.fromkeys((f'{far[0]:.2f}', f'{far[-1]:.2f}')))
    return [f'{model} simulation: {len(here)} of its {len(ridges)} ridges follow{"s" * (len(here) == 1)} its {name} branch to '
            f'within {near[-1]:.2f} bins; that branch of the {other} model is {away} bins away'
            + ', too near to tell the models apart' * (far[0] <= RESOLVED)]


def _linear_range(cell):
    """The amplitude in mm up to which frequencies are those of small motion; infinite if it is not known."""
    from ..stability.amplitude_shifts import frequency_shifts
    from ..stability.verdicts import LINEAR_ERROR

    return np.inf if cell.calc.turning else frequency_shifts(cell).amplitude(LINEAR_ERROR)


def _amplitudes(cell, largest, bound):
    """Lines with the largest displacements: those within the linear range, and with a warning those beyond it."""
    from ..stability.verdicts import LINEAR_ERROR

    return ([_amplitude(cell, record, u) for record, u in largest.items() if u <= bound],
            [f'{_amplitude(cell, record, u)}; WARNING: beyond the linear range: at {_metres(bound)} frequencies are already off '
             f'by {LINEAR_ERROR:.0%}; lower force_N' for record, u in largest.items() if u > bound])


def _amplitude(cell, record, u):
    return f'{record}: largest displacement {_metres(u)}, {u / cell.calc.bonds.lengths.min():.2%} of the spacing'


def _metres(u):
    return units.in_words('m', u / units.m, digits=3)


def _decays(plan, cell, records):
    from ..bands.evanescent import complex_bands
    from ..waves.wave_analysis import MODELS
    from ..waves.wave_source import wavevector

    lines = []
    for name, carrier in zip(plan.names, plan.carriers_Hz, strict=True):
        for model in MODELS:
            if not any(wave.ridge for wave in records[f'{name}_{model}']):
                omega = 2 * np.pi * carrier * units.Hz
                reach = complex_bands(cell, wavevector(cell, plan.source), [omega], model).decay_steps[0, 0]
                if np.isfinite(reach):
                    lines.append(f'{name}_{model}: {carrier:g} Hz lies in a band gap along R2; the wave that decays most slowly '
                                 f'falls to 1/e in {reach:.3g} steps of the row')
    return lines


def _unstable(cell):
    """A warning if the infinite lattice buckles; a patch with its rim held may still be stable."""
    from ..stability.verdicts import verdict

    found = verdict(cell).case.inside
    if found.stable or found.verge:
        return [f'The infinite lattice: {found.words("")}'] * found.verge
    return [f'UNSTABLE: the static forces buckle the infinite lattice. {found.words("")} In the complete simulation the growth '
            'may hide the burst; the conventional model does not show it. Lowering force_N does not help: the growth does not '
            'depend on the force.']
