"""`magphonon fit RIDGES.csv --bands SCENE`: force, exponent and foundation from measured ridges, with D* and without."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import Namespace


def run(options: Namespace) -> None:
    """The part of "magphonon fit" that reads ridges."""
    from ..plotting.fits import plot_band_fits
    from ..scenes.band_fits import fit_bands
    from ..scenes.scene import read_scene
    from ..stiffness.bond import MODELS
    from ..waves.ridge_tables import read_ridges
    from .pictures import drawing
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
    text = report(found, len(points), fixed)
    if options.output is not None:
        with results(options, scene, options.file) as folder, drawing(options, folder, scene.title) as save:
            save(plot_band_fits(found.points, {model: (found.fitted(model).atoms(), fit) for model, fit in found.fits.items()}),
                 'band_fit')
            (folder / 'band_fit.txt').write_text(text + '\n', encoding='utf-8')
    print(text)
    if options.output is not None:
        print(f'\nthe picture and this text are in {options.output}')


def report(found, points: int, fixed: list[str]) -> str:
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
