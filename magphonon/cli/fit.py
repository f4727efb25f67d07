"""`magphonon fit FILE.csv`: the law of repulsion from measured forces, or the lattice from measured ridges.

With `--bands SCENE` the table is one of ridge points, as `magphonon spectrum` writes it: force, exponent and foundation of the
scene are fitted to it with D* and without, and the evidence for D* is stated.

docs/coverage.md says how often its 95 % intervals contain the true value, for several kinds of law and noise.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .arguments import add_pictures, drawing

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
        _fit_bands(options)
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


def _fit_bands(options):
    from ..plotting.fits import plot_band_fits
    from ..scenes.band_fits import fit_bands
    from ..scenes.scene import read_scene
    from ..stiffness.bond import MODELS
    from ..waves.ridge_tables import read_ridges
    from .results import results

    scene, points = read_scene(options.scene), read_ridges(options.file)
    if all(any(model in name for name in points.names) for model in MODELS):
        raise ValueError(f'{options.file} holds ridges of both models, such as {points.names[0]!r}, as "magphonon burst" writes '
                         'them; no lattice fits both: keep the lines of one model')
    fixed = [name.strip() for name in options.fix.split(',')] if options.fix else []
    try:
        found = fit_bands(scene, points, fixed)
    except ValueError as error:
        raise ValueError(f'{options.file}: {error}') from None
    text = band_report(found, len(points), fixed)
    if options.output is not None:
        with results(options, scene, options.file) as folder, drawing(options, folder, scene.title) as save:
            save(plot_band_fits(found.points, {model: (found.fitted(model).atoms(), fit) for model, fit in found.fits.items()}),
                 'band_fit')
            (folder / 'band_fit.txt').write_text(text + '\n', encoding='utf-8')
    print(text)
    if options.output is not None:
        print(f'\nthe picture and this text are in {options.output}')


def band_report(found, points: int, fixed: list[str]) -> str:
    """The parameters in both models with their intervals, what is not determined, and the evidence for D*."""
    from collections import Counter

    own, fits = found.points, found.fits
    on = ', '.join(f'{count} ridge{"s" * (count > 1)} on branch {branch + 1}'
                   for branch, count in sorted(Counter(fits['complete'].branches).items()))
    lines = [found.scene.title, '', f'{len(own)} of {points} ridge points share no noise and are fitted: {on}, from below.',
             'Known: spacing and mass' + (f', fixed: {", ".join(fixed)}' if fixed else '') + '.', '']
    rows = [('', *(f'{model} ({"D0 + D*" if model == "complete" else "D0 alone"})' for model in fits))]
    values = {model: found.values(model) for model in fits}
    rows += [(_named(name), *(_interval(*values[model][name]) for model in fits)) for name in values['complete']]
    rows.append(('chi2/freedom', *(f'{fit.chi2:.4g}/{fit.freedom}' for fit in fits.values())))
    rows.append(('p-value', *(f'{fit.chance:.2g}' for fit in fits.values())))
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines += ['  '.join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]
    return '\n'.join([*lines, '', 'Intervals of 95 %; force and bond stiffness -df/dr are those at the spacing.',
                      *_undetermined(found), *_biased(found), *_verdict(found), *_entries(found)])


def _named(name):
    from ..scenes.band_fits import UNITS

    return f'{name} ({UNITS[name]})' if UNITS[name] else name


def _interval(value, sigma):
    import numpy as np

    from ..design.dispersion_fits import DETERMINED, NORMAL

    if sigma > DETERMINED:
        return 'not determined'
    low, high = value * np.exp(-NORMAL * sigma), value * np.exp(NORMAL * sigma)
    return f'{value:.4g}, {low:.4g} to {high:.4g}'


def _undetermined(found):
    """What the data leave open in the complete model, and what would mend it."""
    from ..design.dispersion_fits import DETERMINED

    open_ = [name for name, sigma in zip(found.names, found.fits['complete'].sigma, strict=True) if sigma > DETERMINED]
    if not open_ or not found.fits['complete'].follows:
        return []
    more = ('the other branch too (a force along the row drives longitudinal waves, one across it shear)'
            if len(set(found.fits['complete'].branches)) == 1 else 'more frequencies of both branches')
    return [f'These ridges do not determine {" and ".join(open_)} of the complete model: several parameters may change together '
            f'and leave them where they are. Measure {more}, or fix what is known from elsewhere: --fix {open_[0]} takes its '
            'value from the scene.']


def _entries(found):
    """Correlations of the parameters of the complete model, and its entries for a scene file, if all of them are determined."""
    import numpy as np

    from .. import units as u
    from ..design.dispersion_fits import DETERMINED

    fit, scene = found.fits['complete'], found.fitted()
    if (fit.sigma > DETERMINED).any() or not fit.follows:
        return []
    R = fit.covariance / np.outer(fit.sigma, fit.sigma)
    pairs = [f'{fit.names[i]} and {fit.names[j]} {R[i, j]:.2f}' for i in range(len(R)) for j in range(i)]
    law = [f'{key} = {value:.8g}' for key, value in scene.law if isinstance(value, float)]
    law += [f'{key} = {[float(f"{x:.8g}") for x in value]}' for key, value in scene.law if isinstance(value, tuple)]
    springs = ['[foundation]', f'stiffness_N_per_m = {scene.foundation.stiffness / (u.N / u.m):.8g}'] if scene.foundation else []
    return [*([f'Correlations: {", ".join(pairs)}.'] if pairs else []), '', 'for a scene file, complete:', '',
            '[law]', f'kind = "{scene.law.kind}"', *law, f'shells = {scene.law.shells}', *springs]


def _biased(found):
    """What the table makes of the fit before its numbers are looked at: ridges that are no branch, or that name no motion."""
    points, lines = found.points, []
    if points.biased and found.better.follows:
        lines.append(f'Biased: {len(points.biased)} of the ridges ({", ".join(points.biased)}) are longitudinal ones of a point '
                     'source, or of a source that the table does not name. Such a ridge is often off the longitudinal branch by '
                     'more than its uncertainty, so force, exponent and foundation may be wrong by several times their intervals '
                     'although the fit is accepted (docs/coverage.md). Leave these ridges out, or drive a row of sources.')
    if not any(points.motions):
        lines.append('The table has no column motion: which branch a ridge follows is told by its distance alone'
                     + (', and all points are taken for one ridge. Name record and motion (transverse or longitudinal) of each.'
                        if len(points.names) == 1 else '.'))
    return lines


def _verdict(found):
    """Which model the data want, in words."""
    from ..scenes.band_fits import TELLS

    if not found.better.follows:
        return _nothing_follows(found)
    sigmas = found.evidence
    difference = abs(found.fits['conventional'].chi2 - found.fits['complete'].chi2)
    if abs(sigmas) < TELLS:
        law = [name for name in found.names if name != 'foundation']
        known = f' A law that is known from measured forces would decide: --fix {",".join(law)}.' if law else ''
        return [f'D*: these data cannot decide between the models. They differ by {difference:.2g} in chi2, {abs(sigmas):.1f} '
                f'sigma: with other parameters each follows the ridges as well.{known}', *_scattered(found)]
    better, worse = ('complete', 'conventional')[:: 1 if sigmas > 0 else -1]
    lines = [f'D*: the {better} model fits better, by {difference:.4g} in chi2, which is evidence of {abs(sigmas):.1f} sigma '
             f'{"for" if sigmas > 0 else "against"} D*.']
    if found.fits[worse].scatter == 1:
        lines.append(f'The {worse} model follows the ridges within their uncertainties, too: the evidence rests on the '
                     'difference alone.')
    return [*lines, *_scattered(found)]


def _nothing_follows(found):
    """What to say where both models leave the ridges."""
    fits = found.fits
    return [f'No model follows these ridges: the points scatter about D0 + D* by {fits["complete"].scatter:.2g} of their '
            f'uncertainties, and about D0 alone by {fits["conventional"].scatter:.2g}. The parameters above mean nothing, and '
            'these data are no evidence for D* or against it. The ridge that contributes most to chi2 is the ridge '
            f'"{_worst(found)}": take it out of the table if it may be that of several waves or of another branch. A point '
            'source sends several waves along a row: keep its transverse ridges, or drive a row of sources. Otherwise mass, '
            'spacing or the number of shells of the scene may be wrong.']


def _worst(found):
    """The name of the ridge that the better model leaves farthest."""
    import numpy as np

    points, residuals = found.points, found.better.residuals
    return points.names[max(range(len(points.names)), key=lambda k: np.sum(residuals[points.ridge == k] ** 2))]


def _scattered(found):
    """What to think of points that scatter about the better model by more than their uncertainties say."""
    fit = found.better
    if fit.scatter == 1:
        return []
    return [f'The points scatter about the {fit.model} model by {fit.scatter:.2g} of their uncertainties; its intervals are '
            f'enlarged, and the evidence is lowered, by this factor. Most of it comes from the ridge "{_worst(found)}". It '
            'may be that of several waves, of an oblique wave or of another branch (take it out of the table), or mass, spacing '
            'or the number of shells of the scene may be wrong.']
