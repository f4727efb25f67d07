"""`magphonon fit FILE.csv`: the law of repulsion from measured forces, or the lattice from measured ridges.

With `--bands SCENE` the table is one of ridge points, as `magphonon spectrum` writes it: force, exponent and foundation of the
scene are fitted to it with D* and without, and the evidence for D* is stated.

docs/coverage.md says how often its 95 % intervals contain the true value, for several kinds of law and noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from . import fit_bands
from .pictures import add_pictures, drawing

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

HELP = 'the law of repulsion from measured forces, or the lattice from measured ridges'
RESULTS = 'fit.*', 'law_*.toml', 'band_fit.*'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('file', metavar='FILE.csv', help='table with the columns r_m,f_N or r_m,f_N,sigma_N (or r_mm, f_mN, '
                                                         '...); with --bands the table of ridges that "magphonon spectrum" '
                                                         'writes, spectrum_SCAN_ridges.csv')
    parser.add_argument('--bands', metavar='SCENE', dest='scene',
                        help='fit this scene, which gives spacing and mass, to a table of measured ridges')
    parser.add_argument('--fix', metavar='NAMES',
                        help='with --bands: parameters that are known from the scene, as --fix a,foundation')
    parser.add_argument('--spacing', metavar='M', type=float, help='working spacing in m (default: the middle distance)')
    parser.add_argument('--contact', metavar='M', type=float,
                        help='distance of the centres at contact in m: measurements below it are refused, also if only an '
                             'offset moves them there')
    parser.add_argument('--offset', action='store_true', help='fit the zero of the distance scale too; needs --contact')
    parser.add_argument('-o', '--output', metavar='DIR',
                        help='directory for the picture and the entries for a scene file (default: none, the advised entry '
                             'is printed)')
    add_pictures(parser, frequencies=False)


def run(options: Namespace) -> None:
    if options.scene is not None:
        _refuse_options_of_forces(options)
        fit_bands.run(options)
        return
    from .. import units as u
    from ..errors import not_negative, positive
    from ..interactions.fits import scene_entry
    from ..interactions.force_tables import read_forces
    from ..interactions.law_choice import fit_laws

    if options.fix is not None:
        raise ValueError('--fix belongs to a fit of ridges; name the scene with --bands SCENE')

    if options.offset and options.contact is None:
        raise ValueError('--offset needs --contact, the distance of the centres in m at which two particles touch: without it '
                         'the offset could move a measurement to a distance at which the particles overlap; for point '
                         'particles give --contact 0')
    if options.output is None and (options.pdf or options.title is not None or options.style is not None):
        raise ValueError('--pdf, --title and --style apply to the picture; name with -o DIR the directory to write it to')
    contact = not_negative('--contact', options.contact or 0.0, 'm') * u.m
    forces = read_forces(options.file, contact)  # its messages name the file
    middle = forces.r[len(forces.r) // 2]
    spacing = middle if options.spacing is None else positive('--spacing', options.spacing, 'm') * u.m
    try:
        choice = fit_laws(forces, spacing, options.offset, contact)
    except ValueError as error:
        raise ValueError(f'{options.file}: {error}') from None
    if options.output is not None:
        _write(options, forces, choice.fits)
    print(_report(options.file, forces, choice))
    advised = choice.fits[choice.advised]
    print(f'\nfor a scene file, {advised.name}:\n\n{scene_entry(advised)}', end='')
    if options.output is not None:
        print(f'\nthe picture and all entries are in {options.output}')


def _refuse_options_of_forces(options):
    for name in ('spacing', 'contact', 'offset'):
        if getattr(options, name) not in (None, False):
            raise ValueError(f'--{name} belongs to a fit of forces; leave it or --bands out')


def _write(options, forces, fits):
    from ..interactions.fits import scene_entry
    from ..plotting.fits import plot_fits
    from .results import results

    with results(options, table=options.file) as out, drawing(options, out) as save:
        save(plot_fits(forces, [fit for name, fit in fits.items() if name != 'touch']), 'fit')
        for name, fit in fits.items():
            (out / f'law_{name}.toml').write_text(scene_entry(fit), encoding='utf-8')


def _report(file, forces, choice):
    """Force, slope and exponent of each law at the working spacing, and whether an inverse power holds."""
    from .. import units as u

    known = 'with' if forces.sigma is not None else 'without'
    zero = choice.fits.get('curve', choice.fits['force'])
    return '\n'.join([
        f'{file}: {len(forces.r)} forces from {forces.r[0] / u.m:g} to {forces.r[-1] / u.m:g} m, {known} uncertainties', '',
        *_table(choice.fits), '', *(_zero_of_distances(forces, zero) if zero.offset else ()),
        *_inverse_power(choice, zero.offset), *_scatter(choice)])


def _table(fits):
    """Lines with the force, its slope and the exponent of each law, and chi2."""
    import numpy as np

    from .. import units as u

    rows = [(f'at {fits["force"].spacing / u.m:g} m, intervals of 95 %', 'f (N)', 'df/dr (N/m)', 'exponent', 'chi2/freedom')]
    for name, fit in fits.items():
        if name == 'touch':  # it has the same numbers as the curve, by construction
            continue
        f, slope = (f'{value / unit:.5g} +- {half / unit:.2g}'
                    for value, half, unit in zip(fit.at_spacing, fit.half_width, (u.N, u.N / u.m), strict=True))
        rows.append((fit.name, f, slope, f'{fit.exponent:.4g} +- {fit.exponent_half_width:.2g}',
                     f'{fit.chi2:.3g}/{fit.freedom:.3g}' if np.isfinite(fit.chi2) else '-'))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return ['  '.join([row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))])
            for row in rows]


def _zero_of_distances(forces, zero):
    """Lines about the fitted zero of the distance scale."""
    from .. import units as u
    from ..interactions.law_choice import WIDE

    lines = [f'zero of the distances: {zero.offset / u.m:.4g} +- {zero.offset_half_width / u.m:.2g} m: the first pair '
             f'was {(forces.r[0] - zero.offset) / u.m:.4g} m apart, centre to centre',
             'The intervals of all rows include the uncertainty of this zero. It is found from the inverse power that the '
             'points follow best.',
             'An offset changes the curve in the same way as the shape of the magnets does: fit it only if the zero of the '
             'distances is in doubt.']
    if forces.r[-1] < WIDE * forces.r[0]:
        lines.append(f'The farthest distance is less than {WIDE:g} times the nearest: in this range another zero looks like '
                     'another exponent. With a noise of some percent, the intervals of 95 % with this offset contain the truth '
                     'less often (docs/coverage.md). Measure over a wider range, or leave --offset out.')
    return lines


def _inverse_power(choice, offset):
    """Lines that say whether an inverse power holds, and which row to use."""
    import numpy as np

    from ..interactions.law_choice import LARGEST_BEND

    bend, lines = choice.bend, []
    if abs(bend) > LARGEST_BEND:
        lines.append(f'No inverse power holds: the exponent {"rises" if bend > 0 else "falls"} with the distance by '
                     f'{abs(bend):.1f} standard uncertainties.')
    if choice.apart:
        names = ' and '.join('in force' if name == 'force' else 'in log force' for name in choice.apart)
        lines.append('The rows disagree by more than their intervals allow: check the inverse power fitted by least squares '
                     f'{names} in the picture.')
    assumed = 'assumes an inverse power only for the zero of the distances' if offset else 'does not assume an inverse power'
    if np.isnan(bend):
        lines.append('Three points do not show whether an inverse power holds; the intervals assume that it does.')
    elif choice.is_power:
        lines.append(f'These data do not contradict an inverse power: its exponent changes by {abs(bend):.1f} standard '
                     f'uncertainties. Use the interval of the smooth curve, which {assumed}.')
    else:
        lines.append('Use the smooth curve: the intervals of the inverse powers assume a law that does not hold.')
    return lines


def _scatter(choice):
    """A line about sigma_N, if the points scatter more than it says, or if they cannot test it."""
    import numpy as np

    from ..interactions.law_choice import RARELY

    if not choice.scatter_explained:
        larger = ('are not enlarged, as three points do not say by how much' if np.isnan(choice.bend) else
                  'of the smooth curve are enlarged by the square root of its chi2/freedom')
        return [f'The points scatter more than sigma_N says: the intervals {larger}. Look for an outlier.']
    if choice.notices_twice < RARELY:
        return [f'So few points hardly test sigma_N, on which the intervals depend: if it were half of the true noise, chi2 '
                f'would show that in {100 * choice.notices_twice:.0f} of 100 measurements. Measure more points, or leave '
                'sigma_N out if you doubt it.']
    return []
