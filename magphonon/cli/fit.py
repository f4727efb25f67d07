"""`magphonon fit FILE.csv`: the law of repulsion from measured forces.

docs/coverage.md says how often its 95 % intervals contain the true value, for several kinds of law and noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

HELP = 'the law of repulsion from measured forces'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('file', metavar='FILE.csv', help='table with the columns r_m,f_N or r_m,f_N,sigma_N (or r_mm, f_mN, ...)')
    parser.add_argument('--spacing', metavar='M', type=float, help='working spacing in m (default: the middle distance)')
    parser.add_argument('--contact', metavar='M', type=float,
                        help='distance of the centres at contact in m: measurements below it are refused, also if only an '
                             'offset moves them there')
    parser.add_argument('--offset', action='store_true', help='fit the zero of the distance scale too; needs --contact')
    parser.add_argument('-o', '--output', metavar='DIR', help='directory for the picture and the entries for a scene file')


def run(options: Namespace) -> None:
    from .. import units as u
    from ..errors import not_negative, positive
    from ..interactions.fits import scene_entry
    from ..interactions.force_tables import read_forces
    from ..interactions.law_choice import fit_laws

    if options.offset and options.contact is None:
        raise ValueError('--offset needs --contact, the distance of the centres in m at which two particles touch: without it '
                         'the offset could move a measurement to a distance at which the particles overlap; for point '
                         'particles give --contact 0')
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


def _write(options, forces, fits):
    from ..interactions.fits import scene_entry
    from ..plotting.fits import plot_fits
    from .results import results

    with results(options, table=options.file) as out:
        plot_fits(forces, [fit for name, fit in fits.items() if name != 'touch']).savefig(out / 'fit.png')
        for name, fit in fits.items():
            (out / f'law_{name}.toml').write_text(scene_entry(fit), encoding='utf-8')


def _report(file, forces, choice):
    """Force, slope and exponent of each law at the working spacing, and whether an inverse power holds."""
    import numpy as np

    from .. import units as u
    from ..interactions.fits import NORMAL
    from ..interactions.law_choice import LARGEST_BEND

    fits, bend = choice.fits, choice.bend
    some = fits['force']
    known = 'with' if forces.sigma is not None else 'without'
    rows = [(f'at {some.spacing / u.m:g} m, intervals of 95 %', 'f (N)', 'df/dr (N/m)', 'exponent', 'chi2/freedom')]
    for name, fit in fits.items():
        if name == 'touch':  # it has the same numbers as the curve, by construction
            continue
        f, slope = (f'{value / unit:.5g} +- {half / unit:.2g}'
                    for value, half, unit in zip(fit.at_spacing, fit.half_width, (u.N, u.N / u.m), strict=True))
        rows.append((fit.name, f, slope, f'{fit.exponent:.4g} +- {fit.exponent_half_width:.2g}',
                     f'{fit.chi2:.3g}/{fit.freedom:.3g}' if np.isfinite(fit.chi2) else '-'))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = [f'{file}: {len(forces.r)} forces from {forces.r[0] / u.m:g} to {forces.r[-1] / u.m:g} m, {known} uncertainties', '']
    lines += ['  '.join([row[0].ljust(widths[0]), *(cell.rjust(width) for cell, width in zip(row[1:], widths[1:], strict=True))])
              for row in rows]
    lines.append('')
    if some.offset:
        lines += [f'zero of the distances: {some.offset / u.m:.4g} +- {NORMAL * some.offset_sigma / u.m:.2g} m: the first pair '
                  f'was {(forces.r[0] - some.offset) / u.m:.4g} m apart, centre to centre',
                  'An offset changes the curve in the same way as the shape of the magnets does: fit it only if the zero of the '
                  'distances is in doubt.']
    if abs(bend) > LARGEST_BEND:
        lines.append(f'No inverse power holds: the exponent {"rises" if bend > 0 else "falls"} with the distance by '
                     f'{abs(bend):.1f} standard uncertainties.')
    if choice.apart:
        names = ' and '.join('in force' if name == 'force' else 'in log force' for name in choice.apart)
        lines.append('The rows disagree by more than their intervals allow: check the inverse power fitted by least squares '
                     f'{names} in the picture.')
    if np.isnan(bend):
        lines.append('Three points do not show whether an inverse power holds; the intervals assume that it does.')
    elif choice.is_power:
        lines.append(f'These data do not contradict an inverse power: its exponent changes by {abs(bend):.1f} standard '
                     'uncertainties. Use the interval of the smooth curve, which does not assume an inverse power.')
    else:
        lines.append('Use the smooth curve: the intervals of the inverse powers assume a law that does not hold.')
    if not choice.scatter_explained:
        lines.append('The points scatter more than sigma_N says: the intervals of the smooth curve are enlarged by the square '
                     'root of its chi2/freedom. Look for an outlier.')
    return '\n'.join(lines)
