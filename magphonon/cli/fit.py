"""`magphonon fit FILE.csv`: the force between two particles and its slope from a table, or the lattice from measured ridges.

Forces: some errors are shared by all rows of a table, namely the zeros of the distance and of the force, hysteresis, backlash,
and the gain of the load cell. The intervals allow for them; --sigma says how well you know each.

Waves: with `--bands SCENE` the tables hold ridge points, from `magphonon spectrum` or any other analysis. Force, exponent and
foundation of the scene are fitted to them with D* and without, and the evidence for D* is stated.  The table says which kind of
source sent the waves; the intervals allow for the shift that such a source gives to all ridges of a branch.

Responses: with `--frf SCENE` the files hold measured transfer functions, as tables or universal files. Force, exponent,
foundation, damping and mass (known to 1 %) of the patch or the structure of the scene are fitted to them, with D* and without.

If a scene is named first, `magphonon fit mine.toml ridges.csv`, the other files are recognised by their contents.  Records of
different kinds are fitted one after the other: give what one fit finds to the next by --prior.

docs/coverage.md says how often the 95 % intervals contain the true value.
"""

from __future__ import annotations

import os
import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from dataclasses import replace
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np

from .. import units as u
from ..errors import not_negative, one_of, positive
from ..files import whole_file
from ..headers import LACKS
from ..readers import content
from ..tables import MOST_BYTES
from ..universal import NO_FUNCTIONS
from .arguments import add_force, add_style, add_verbose, drawing, force, length, ready_table, share

HELP = 'the force between two particles, or the lattice, from measurements'
KINDS = {'forces': ('interactions.force_tables', 'read_forces'), 'ridges': ('waves.ridge_tables', 'read_ridges'),
         'transfer functions': ('response.transfer_functions', 'read_transfer'), 'a scan': ('waves.scan_tables', 'read_scan')}
"""The kinds of records that a file may hold, and the function that reads each."""
OWN = re.compile(r'(?ms)^\[(law|uncertainty)[].].*?(?=^(#[^\n]*\n)*\[(?!(law|uncertainty)[].])|\Z)')
"""The tables [law] and [uncertainty] in the text of a scene, without comments on the next table."""
ERRORS = {'distance': length, 'zero': force, 'hysteresis': force, 'backlash': length, 'gain': share, 'pair': share}
"""Errors that --sigma names, and the function that reads the value of each."""


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('files', metavar='FILE', nargs='+',
                        help='one table of forces with the columns r_mm (distance of the centres), f_N and perhaps sigma_N and '
                             'direction (approach, return); or a scene and measurements of its lattice, recognised by '
                             'their contents; or with --bands the ridges that "magphonon spectrum" writes. The tables '
                             'prototype_force, prototype_ridges and synthetic_force come with the package')
    parser.add_argument('--bands', metavar='SCENE', dest='scene',
                        help='fit this scene, which gives spacing and mass, to a table of measured ridges')
    parser.add_argument('--frf', metavar='SCENE', help='fit this scene, with [frf], to measured transfer functions: tables with '
                        'frequency_Hz and re_m_per_N,im_m_per_N or amplitude_m_per_N,phase_deg, or universal files .uff')
    parser.add_argument('--fix', metavar='NAMES',
                        help='with --bands or --frf: parameters that keep the values of the scene, named as in --prior, '
                             'such as --fix a,foundation_N_per_m')
    parser.add_argument('--prior', metavar='NAME=VALUE+-SIGMA', action='append', default=[], dest='priors',
                        help='with --bands or --frf: what is already known about a parameter, in SI, such as force_N=0.288+-0.01 '
                             'or a=3.8+-10%%; units may be left out of names; may be given several times')
    parser.add_argument('--without', metavar='RIDGE', action='append', default=[],
                        help='with --bands: omit a ridge, such as --without "60Hz, longitudinal"; the intervals are widened '
                             'according to how far the fit misses this ridge')
    parser.add_argument('--spacing', metavar='R', type=length, help='working spacing, such as 10mm (default: the middle of the '
                                                                    'measured distances)')
    parser.add_argument('--sigma', metavar='NAME=VALUE', type=_sigma, action='append', default=[], dest='sigmas',
                        help='standard uncertainty of an error that all rows of a table share, such as --sigma distance=0.05mm: '
                             'distance, of the zero of the distances, which matters most (default: 0.2mm); zero, of the force (a '
                             'tenth of the largest force, a thousandth on a balance); hysteresis, half the difference between '
                             'return and approach (a hundredth of the largest force); backlash of the drive (0.1mm); gain of the '
                             'load cell (1%%); pair, the standard deviation from one pair to the next (the scatter of several '
                             'pairs in one table, else 0); may be given several times')
    parser.add_argument('--contact', metavar='R', type=length,
                        help='distance of the centres at contact; a table with a smaller one is refused (default: that of a '
                             'scene of magnets)')
    parser.add_argument('--dry-run', action='store_true', help='only say how each file is understood')
    parser.add_argument('-o', '--output', metavar='OUT',
                        help='for forces FILE.toml: the scene that is named first, with the fitted law in place of its own; '
                             'or a directory for the picture and the fitted tables (default: none; tables are printed)')
    add_force(parser)
    add_verbose(parser)
    add_style(parser)
    parser.set_defaults(magnet=None, first=None)


def _sigma(text):
    """Name and value of an error from words such as 'distance=0.05mm'."""
    name, _, value = text.partition('=')
    if name not in ERRORS:
        raise ArgumentTypeError(f'{text!r} must be one of {", ".join(ERRORS)} with its value, such as distance=0.05mm')
    return name, ERRORS[name](value)


def run(options: Namespace) -> None:
    from ..scenes.sources import ready_scenes

    if options.dry_run:
        for name in options.files:
            print(*_understood(ready_table(name), options.contact or 0.0), sep='\n')
        return
    first = options.files[0]
    ready = () if os.path.lexists(first) else ready_scenes()  # a file hides those of its name
    if options.frf is None and options.scene is None and (first.endswith('.toml') or first in ready):
        _recognise(options)
    options.files = [ready_table(name) for name in options.files]
    if options.frf is not None:
        _fit_frf(options)
    elif options.scene is not None:
        _fit_bands(options)
    else:
        _fit_forces(options)


def held(file: str, contact: float = 0.0) -> tuple[str, Any]:
    """The kind of records in a file, and these records; `contact` in mm is needed if a table of forces gives gaps."""
    if file.endswith('.toml'):
        raise ValueError(f'{file} is a scene and holds no measurements')
    table, faults = isinstance(content(file, MOST_BYTES), str), []  # what cannot be read at all has one cause
    for kind, (module, reader) in [*KINDS.items()][0 if table else 2 :]:  # no instrument records forces over distances
        try:
            given = {'contact': contact} if kind == 'forces' else {}
            return kind, getattr(import_module(f'magphonon.{module}'), reader)(file, **given)
        except ValueError as error:
            faults.append(str(error))
    for fault in faults:
        if LACKS not in fault and NO_FUNCTIONS not in fault:  # the columns, or the functions, are those of this kind
            raise ValueError(fault)
    header = faults[0].partition('(its header is ')[2].partition('); a table')[0]
    raise ValueError(f'{file} holds no columns that are known' + f': its header is {header}' * bool(header) + '; name those of '
                     'forces r_mm,f_N, of ridges as spectrum writes them, of transfer functions frequency_Hz,re_m_per_N, '
                     'im_m_per_N, of a scan of several points time_s,point,u_x_m')


def _columns(kind, record):
    """The numbers of a record in SI, by quantity and unit."""
    if kind == 'forces':
        return {'distance of the centres (m)': record.r / u.m, 'force (N)': record.f / u.N}
    if kind == 'ridges':
        return {'frequency (Hz)': record.frequencies_Hz, 'phase per step (rad)': record.xi}
    if kind == 'a scan':
        return {'time (s)': record.times / u.s} | {f'{part} (m)'.strip(): moved.ravel() / u.m
                                                   for part, moved in record.motions.items()}
    per, unit = ('', 1.0) if record[0].shaken else (' (m/N)', u.m / u.N)
    return {'frequency (Hz)': np.concatenate([u.hertz(one.omega) for one in record]),
            f'amplitude{per}': np.concatenate([abs(one.response) / unit for one in record])}


def _understood(file, contact):
    """Lines that say what a file holds and over which ranges, so that a wrong unit is seen."""
    kind, record = held(file, contact)
    yield f'{file} holds {kind}.'
    for name, values in _columns(kind, record).items():
        yield f'  {name}: {len(values)} values from {values.min():.6g} to {values.max():.6g}'
    yield from (f'  {note}' for note in getattr(record, 'notes', ()))


def _recognise(options):
    """Set the options for a scene that is followed by files of one kind of record, which is recognised by their contents."""
    from ..scenes.scene import read_scene
    from ..scenes.sources import source_of

    scene, *names = options.files
    if not names:
        raise ValueError(f'{scene} is a scene; name after it what was measured: magphonon fit {scene} ridges.csv')
    known = read_scene(source_of(scene))
    magnets = known.law.kind == 'magnets'
    contact = not_negative('--contact', options.contact or 0.0, 'mm') or (known.law.magnet().contact if magnets else 0.0)
    kind, options.files = _kind_of_all(scene, names, contact), names
    if kind == 'forces':
        options.spacing = options.spacing or known.lattice.spacing_m * u.m
        options.magnet, options.contact, options.first = scene if magnets else None, contact, source_of(scene)
    else:
        setattr(options, 'scene' if kind == 'ridges' else 'frf', scene)


def _kind_of_all(scene, names, contact):
    """The kind of records that files hold; ValueError if one fit cannot take them all."""
    kinds = {name: held(ready_table(name), contact)[0] for name in names}
    for name in names:
        if kinds[name] == 'a scan':
            raise ValueError(f'{name} holds a scan; "magphonon spectrum {name} {scene}" finds its ridges, which can be fitted')
    kind, *others = {*kinds.values()}
    if others or (kind == 'forces' and len(names) > 1):
        found = ', '.join(f'{name} holds {kind}' for name, kind in kinds.items())
        raise ValueError(f'{found}: one fit takes one kind of record, and one table of forces. Fit them one after the other, and '
                         'give what one fit finds to the next by --prior, such as --prior force_N=0.288+-0.01')
    return kind


def _refuse(options, flags, why):
    """Raise ValueError if one of these options, which belong to another fit, is given."""
    for flag, name in flags.items():
        if getattr(options, name):
            raise ValueError(f'--{flag} belongs to {why}')


def _forces(file, contact):
    """The table of forces in a file; ValueError for any other record, whose fit needs a scene."""
    from ..interactions.force_tables import read_forces

    try:
        kind, forces = held(file, contact)
    except ValueError:
        return read_forces(file, contact)  # which says what a table of forces lacks
    if kind != 'forces':
        raise ValueError(f'{file} holds {kind}; name the scene of their lattice first: magphonon fit SCENE.toml {file}')
    return forces


def _fit_forces(options):
    from ..interactions.fits import SharedErrors, fit_forces, scene_entry
    from ..scenes.scene import read_scene
    from .fit_report import force_report, too_wide
    from .results import results

    _refuse(options, {'fix': 'fix', 'prior': 'priors', 'without': 'without'},
            'a fit of ridges; name the scene with --bands SCENE')
    file, *more = options.files
    if more:
        raise ValueError(f'a fit of forces takes one table, not {len(options.files)}; put repeated measurements into one table, '
                         'in any order; if these are ridges, name their scene with --bands')
    if options.output is None and options.style is not None:
        raise ValueError('--style applies to the picture; say with -o DIR where to write it')
    shared = SharedErrors(**dict(options.sigmas))
    forces = _forces(file, not_negative('--contact', options.contact or 0.0, 'mm'))  # its messages name the file
    spacing = forces.middle if options.spacing is None else positive('--spacing', options.spacing, 'mm')
    try:
        fit = fit_forces(forces, spacing, shared, options.magnet and read_scene(options.magnet).law.potential())
    except ValueError as error:
        raise ValueError(f'{file}: {error}') from None
    entry, said = scene_entry(fit), force_report(file, options.magnet, forces, fit, shared, options.verbose)
    if (options.output or '').endswith('.toml'):
        _write_scene(options, entry, too_wide(fit))
        print(said, f'{options.output} is the scene with this law', sep='\n')
        return
    if options.output is not None:
        from ..plotting.fits import plot_fit

        with results(options, 'fit.*', 'law.toml') as out, drawing(options, out) as save:
            save(plot_fit(forces, fit), 'fit')
            (out / 'law.toml').write_text(entry, encoding='utf-8')
    print(said)
    print(f'\nfor a scene file, in place of its [law] and, if it has one, its [uncertainty]:\n\n{entry}', end='')
    if options.output is not None:
        print(f'\nthe picture and the entry are in {options.output}')


def _write_scene(options, entry, wide):
    """Write the scene that was named first with an entry in place of its [law] and [uncertainty], unless it is too `wide`."""
    from ..scenes.scene import read_scene
    from .results import refuse_existing

    file, first = Path(options.output), options.first
    if first is None:
        raise ValueError(f'-o {file} is a scene with the fitted law; name first the scene that it is made of: magphonon fit '
                         f'SCENE.toml {options.files[0]} -o {file}')
    if wide:
        raise ValueError(f'{options.files[0]}: {wide[0]}')
    refuse_existing(options, [file])
    if not (tables := OWN.search(first.text)):
        raise ValueError(f'{first} has no line [law], below which its law stands; write its law as such a table')
    text = f'{first.text[: tables.start()]}{entry}\n{OWN.sub("", first.text[tables.end() :])}'
    read_scene(replace(first, content=text.encode(), folder=file.parent))  # with all its checks
    with whole_file(file) as out:
        out.write(text)
    options.written = file


def _fit_bands(options):
    from ..plotting.fits import plot_band_fits
    from ..scenes.band_fits import KEYS, fit_bands
    from ..scenes.scene import read_scene
    from ..stiffness.matrices import MODELS
    from ..waves.ridge_tables import read_ridges
    from .fit_report import band_report

    _refuse(options, {'spacing': 'spacing', 'contact': 'contact', 'sigma': 'sigmas'}, 'a fit of forces; omit it or --bands')
    scene, points = read_scene(options.scene), read_ridges(*options.files)
    if all(any(model in name for name in points.names) for model in MODELS):
        raise ValueError(f'{options.files[0]} holds ridges of both models, such as {points.names[0]!r}, as "magphonon burst" '
                         'writes them; no lattice fits both: keep the lines of one model')
    fixed, priors = _known(options, KEYS)
    try:
        found = fit_bands(scene, points, fixed, priors, options.without)
    except ValueError as error:
        raise ValueError(f'{", ".join(options.files)}: {error}') from None
    _told(options, scene, 'band_fit', lambda verbose: band_report(found, len(points), fixed, verbose), lambda: plot_band_fits(
        found.points, {model: (found.fitted(model).perfect_cell(), found.fits[model]) for model in MODELS}))


def _fit_frf(options):
    from ..plotting.response import plot_transfer
    from ..response.transfer_functions import read_transfer
    from ..scenes.frf_fits import GAIN, KEYS, fit_frf, suspect_units, with_dofs
    from ..scenes.scene import read_scene
    from ..scenes.sources import source_of
    from ..stiffness.matrices import MODELS
    from .fit_report import frf_report

    _refuse(options, {'bands': 'scene', 'without': 'without', 'spacing': 'spacing', 'contact': 'contact'},
            'other fits; omit it or --frf')
    sigmas = {'gain': GAIN} | dict(options.sigmas)
    if len(sigmas) > 1:
        raise ValueError(f'--sigma {[*sigmas][1]} belongs to a fit of forces; a fit of responses knows only gain')
    options.scene = source_of(options.frf)
    scene = read_scene(options.scene)
    functions = [one for file in options.files for one in read_transfer(file)]
    fixed, priors = _known(options, KEYS)
    if (doubt := suspect_units(scene, with_dofs(scene, functions))) is not None:
        print(f'The measurements look like {doubt}: correct that before believing what follows.\n')
    found = fit_frf(scene, functions, fixed, priors, sigmas['gain'])
    _told(options, scene, 'frf_fit', lambda verbose: frf_report(found, fixed, verbose),
          lambda: plot_transfer(found.functions, {model: found.curves(model) for model in MODELS}))


def _told(options, scene, name, report, figure):
    """Print a report; if there is a folder of results, write the full report and its picture into it."""
    from .results import results

    if options.output is not None:
        with results(options, f'{name}.*') as folder, drawing(options, folder, scene.title) as save:
            save(figure(), name)
            (folder / f'{name}.txt').write_text(report(True) + '\n', encoding='utf-8')
    print(report(options.verbose))
    if options.output is not None:
        print(f'\npicture and full report are in {options.output}')


def _known(options, keys) -> tuple[list[str], dict[str, Any]]:
    """The parameters that --fix names, with or without their unit, and value and standard uncertainty of those of --prior."""
    fixed = [keys.get(name.strip(), name.strip()) for name in options.fix.split(',')] if options.fix else []
    told = [_prior(text, keys) for text in options.priors]
    if len(dict(told)) < len(told):
        raise ValueError('--prior names a parameter twice; keep one of them, or combine them')
    return fixed, dict(told)


def _prior(text, keys):
    """Name, value and standard uncertainty of a parameter from words such as 'force_N=0.288+-0.01' or 'a=3.8+-10%'."""
    match = re.fullmatch(r'\s*(\w+)\s*=\s*([-+.\deE]*[\d.])\s*(?:\+-|\+/-|±)\s*([-+.\deE]*[\d.])\s*(%?)\s*', text)
    try:
        key, value, sigma, percent = match.groups()
        value, sigma = float(value), float(sigma)
    except (AttributeError, ValueError):
        raise ValueError(f'--prior {text!r} is not a parameter with its value and standard uncertainty, such as '
                         'force_N=0.288+-0.01 or a=3.8+-10%') from None
    key = next((full for full, name in keys.items() if name == key), key)
    return keys[one_of('the parameter of --prior', key, tuple(keys))], (value, value * sigma / 100 if percent else sigma)
