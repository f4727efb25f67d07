"""The reports of `magphonon fit`: the force and its slope, and the lattice fitted to ridges or to transfer functions.

Each begins with the answer in one line; warnings follow. A `verbose` report has all that was found in between.
"""

from __future__ import annotations

from collections import Counter
from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..design.least_squares import DETERMINED, FITS, NORMAL
from ..interactions.fits import CONFLICT, SHAPE_WEIGHT, SHARED, Fit, SharedErrors
from ..interactions.pair_laws import local_exponent
from ..scenes.band_fits import ALL, KEYS, NEAREST, TELLS, BandFits
from ..scenes.frf_fits import UNITS, FrfFits, missing_magnet
from ..scenes.scene import Scene, toml
from ..scenes.tolerances import LARGEST_TOLERANCE
from ..tables import in_columns
from ..waves.ridge_tables import SHIFT_bins

if TYPE_CHECKING:
    from ..interactions.force_tables import Forces

FEW, MANY = 10, 4  # with fewer than FEW points, MANY parameters may be wrong by one misread ridge without any sign of it
TOO_SMALL = 0.5  # root of chi2 per degree of freedom below which the uncertainties look too large
TOLD_ZERO = 0.01  # share of the force at the spacing above which the zero that was found is reported
SURE = 0.8  # probability of a drift above which it is reported
STANDS_OUT = 2.0  # ratio of the distance of the worst ridge from its branch to that of the others, from which it is named
UNLIKE = 3.0  # the ratio of springs along x and y is reported if it misses the fitted one by these sigmas
SIGMAS = 'as a guide, noise alone gives 2 sigma in one fit of 20, and 5 sigma in one of two million'
"""How to read a number of standard deviations."""
KEY_OF = {name: key for key, name in KEYS.items()}  # the parameters as --prior and --fix name them


def force_report(file: str, magnet: str | None, forces: Forces, fit: Fit, shared: SharedErrors, verbose: bool = True) -> str:
    """The force at the spacing, its slope and exponent; `magnet` is the scene whose magnets gave the law a shape."""
    force, slope, exponent = fit.intervals
    lines = [f'At {u.in_words("m", fit.spacing / u.m)} the force is {fit.force / u.N:.4g} N ({force[0] / u.N:.4g} to '
             f'{force[1] / u.N:.4g}) and the exponent {fit.exponent:.4g} ({exponent[0]:.4g} to {exponent[1]:.4g}), with 95 % '
             'intervals in brackets.']
    if verbose:
        r, stated = forces.r, 'without' if forces.sigma is None else 'with'
        low, high = -slope[::-1] / (u.N / u.m)
        lines += [f'Its slope df/dr is {fit.slope / (u.N / u.m):.4g} N/m ({low:.4g} to {high:.4g}).', '',
                  f'{file}: {len(r)} forces from {r.min() / u.m:g} to {r.max() / u.m:g} m, {stated} uncertainties', '',
                  *_assumptions(magnet, forces, fit, shared)]
    return '\n'.join([*lines, *_doubts_of_forces(forces, fit), *_zeros(fit), *too_wide(fit)])


def too_wide(fit: Fit) -> list[str]:
    """A line with what to measure, if the force is known less well than [uncertainty] of a scene may say."""
    if (sigma := np.sqrt(fit.covariance[0, 0])) <= LARGEST_TOLERANCE:
        return []
    return [f'The force has a standard deviation of {100 * sigma:.0f} %, and a scene takes at most {100 * LARGEST_TOLERANCE:g} '
            f'%: most of it comes from: {max(fit.shares, key=lambda cause: fit.shares[cause])}. Measure more rows around the '
            'spacing, or say with --sigma what is known better.']


def _assumptions(magnet, forces, fit, shared):
    """What the intervals of a fit of forces rest on: errors that all rows share, the kind of law, pairs, and reach."""
    zero, distance, hysteresis, backlash = shared.sizes(forces)
    yield (f'Assumed beforehand: the zero of the distances is known to {distance / u.mm:.2g} mm, that of the force to '
           f'{zero / u.N:.2g} N, hysteresis to {hysteresis / u.N:.2g} N, backlash to {backlash / u.mm:.2g} mm, gain to '
           f'{100 * shared.gain:.2g} % (standard deviations). If you know them better, say so with --sigma.')
    parts = [f'{name} {100 * share:.0f} %' for name, share in sorted(fit.shares.items(), key=lambda item: -item[1])
             if share > 0.005]
    yield f'Causes of the uncertainty of the slope, as shares of its variance: {", ".join(parts)}.'
    if magnet is None:
        yield (f'Forces from {forces.r.min() / u.mm:g} to {forces.r.max() / u.mm:g} mm do not determine the kind of law; the '
               'intervals hold for any smooth law.')
    else:
        lost = '; the data contradict it.' if fit.weight < SHAPE_WEIGHT / 5 else '.'
        yield f'The shape of {magnet}, rather than a free curve, has the probability {fit.weight:.2g}{lost}'
    if fit.pair:
        yield (f'{forces.pairs} pair{"s" * (forces.pairs > 1)}, whose forces scatter about their mean by {100 * fit.pair:.2g} % '
               f'(one standard deviation, {"as their scatter says" if shared.pair is None else "as stated"}); the intervals are '
               'those of the mean.')
    elif forces.pairs == 1:
        yield ('The table holds one pair of magnets. If magnets differ by 2.5 %, the force of one pair is about 3.5 % off the '
               'mean of the lattice. Measure several, numbered in a column "pair", or give --sigma pair=0.035.')
    spacings = fit.law.r[-1] / fit.spacing
    yield (f'The table reaches to {spacings:.3g} spacings, and the law goes on as it ends there, or as that of dipoles if it '
           'ends less steeply. Measure farther to know the forces of farther neighbours better, or name the scene of the magnets '
           'first.')


def _doubts_of_forces(forces, fit):
    """Warnings that rows are saturated, drift, are few, or scatter."""
    top, n = forces.saturated, len(forces.r)
    if top.any():
        r = forces.r[top] / u.mm
        where = f'from {r.min():g} to {r.max():g}' if np.ptp(r) else f'at {r[0]:g}'
        yield (f'{top.sum()} rows {where} mm have the same largest force, {forces.f.max() / u.N:g} N: the load cell was '
               'saturated there. Leave these rows out; with them the exponent is too small.')
    if fit.drift > SURE:
        yield (f'The errors of successive rows are correlated (with a probability of {100 * fit.drift:.0f} %): the load cell '
               'drifts, perhaps as it warms up, and the intervals allow for it. Return to one distance now and then to see the '
               'drift.')
    exponent = local_exponent(fit.law, fit.law.r)
    if (exponent < 0).any():
        yield (f'At {fit.law.r[exponent < 0][-1] / u.mm:.3g} mm and nearer the fitted force falls towards contact, which no '
               'law of magnets does. Leave the rows out where the magnets tilt or touch, or where the load cell reaches its end.')
    if n < FEW:
        yield f'{n} rows are too few to find the shape of the law: the intervals rest on what was assumed beforehand.'
    if fit.scatter > 1:
        yield (f'The rows scatter {fit.scatter:.2g} times as much as their sigma_N says, and the intervals are widened '
               'accordingly: look for an outlier, or remove this column.')


def _zeros(fit):
    """The zero of the force that is subtracted, and warnings of errors that contradict what is known of them."""
    if abs(fit.zeros[0]) > TOLD_ZERO * fit.force:
        yield (f'A zero of the force of {fit.zeros[0] / u.N:.2g} +- {fit.zero_sigma / u.N:.2g} N is subtracted from every row '
               '(the error is one standard deviation). If you know the zero better, say so with --sigma zero=0.001N.')
    units = ((u.N, 'N'), (u.mm, 'mm')) * 2
    for name, value, conflict, (unit, symbol) in zip(SHARED, fit.zeros, fit.conflicts, units, strict=True):
        if conflict > CONFLICT:
            yield (f'The {name} comes out as {value / unit:.2g} {symbol}, {conflict:.1f} standard deviations from what was '
                   'assumed: its error is larger than stated, or the magnets have a different shape.')


def band_report(found: BandFits, points: int, fixed: list[str], verbose: bool = True) -> str:
    """The lattice fitted to some of `points` ridge points in both models, the evidence for D*, and entries for a scene."""
    fit, n = found.fits['complete'], len(found.names)  # others are not reported
    usable = fit.follows and not any(sigma > DETERMINED for _, sigma in found.values().values())
    lines = _answer(found)
    if verbose:
        lines += ['', found.scene.title, '', *_ridges(found, points, fixed), '', *_ridge_table(found), *_shifts(found)]
    lines += [*_doubts_of_ridges(found), *_doubts_of_values(found), *_stated(found), *_verdict(found)]
    lines += _correlations(fit, n) if verbose and usable else []
    return '\n'.join([*lines, *(_entries(found.fitted()) if usable else [])])


def _correlations(fit, n):
    """A line with the correlations of the first n parameters."""
    R = fit.covariance / np.outer(fit.sigma, fit.sigma)
    pairs = [f'{fit.names[i]} and {fit.names[j]} {R[i, j]:.2f}' for i in range(n) for j in range(i)]
    return [f'Correlations: {", ".join(pairs)}.'] if pairs else []


def _ridges(found, points, fixed):
    """Lines that say which points are fitted on which branches, what is known, and how many neighbours count."""
    branches = found.fits['complete'].branches
    counts = Counter(branches[k] for k in set(found.points.ridge.tolist()))
    on = ', '.join(f'{count} on branch {branch + 1}' for branch, count in sorted(counts.items()))
    yield (f'Fitting {len(found.points)} of the {points} ridge points (the others are so close to these in frequency that they '
           f'share their noise). Ridges: {on}.')
    before = ', '.join(f'{KEY_OF[name]} = {value:.4g} +- {sigma:.2g}' for name, (value, sigma) in found.priors.items())
    yield ('Known: spacing and mass' + f'; fixed: {", ".join(KEY_OF[name] for name in fixed)}' * bool(fixed)
           + f'; before: {before}' * bool(before) + '.')
    weights = ', '.join(f'{part} {weight:.2g}' for part, weight in found.weights().items())
    yield f'Neighbours that act, with the weight that the points give them: {weights}.'


def _ridge_table(found):
    """A table of the parameters, of the frequencies at the special points, and of chi2, with a column for each model."""
    fits, points = found.fits, found.scene.special_points
    told = [found.predicted(np.array([*points.values()]), model) for model in fits]
    rows = _parameters(found)
    for k, name in enumerate(points):
        rows += [(f'{name}, branch {branch + 1} (Hz)', *(_interval(u.hertz(omega[k, branch]), sigma[k, branch])
                                                         for omega, sigma in told)) for branch in range(told[0][0].shape[1])]
    return _table(fits, [*rows, ('chi2/freedom', *(f'{fit.chi2:.4g}/{fit.freedom}' for fit in fits.values())),
                         ('p-value', *(f'{fit.chance:.2g}' for fit in fits.values()))])


def _shifts(found):
    """The shifts, shared by all ridges of a branch, for which the intervals allow."""
    sources = [found.points.sources[k] if found.points.sources else 'point' for k in found.points.ridge]
    told = [f'{bins:g} bins for the {sources.count(kind)} points of waves from a {kind}' for kind, bins in SHIFT_bins.items()
            if kind in sources]
    yield f'The intervals allow for a common shift of all ridges of a branch in wavenumber: {" and ".join(told)}.'


def _doubts_of_ridges(found):
    """Warnings that points are few, their uncertainties too large, motions not named, or ridges left out."""
    points, names, fit = found.points, found.names, found.fits['complete']
    if len(points) < FEW and len(names) >= MANY:
        yield (f'{len(points)} points are few for {len(names)} parameters: one misread ridge would change them but hardly raise '
               'chi2. Record longer, or with more carriers.')
    scatter = np.sqrt(fit.chi2 / max(fit.freedom, 1))
    if scatter < TOO_SMALL and fit.freedom >= FEW:
        yield (f'Your uncertainties look {1 / scatter:.2g} times too large: chi2 is {fit.chi2:.2g} with {fit.freedom} degrees of '
               'freedom, and the intervals are too wide by about as much.')
    if not any(points.motions):
        yield ('The table has no column motion: which branch a ridge follows is decided by its distance alone. Add the columns '
               'record and motion (transverse or longitudinal); without them all points count as one ridge.')
    if found.left_out:
        yield (f'Omitted from the fit: {", ".join(found.left_out)}. With them the points scatter about the fit by '
               f'{fit.scatter:.2g} times their uncertainties, and all intervals are widened accordingly. A fit that is good only '
               'because ridges were left out is no more certain than a fit to all of them.')


def _doubts_of_values(found):
    """Warnings that both numbers of neighbours are possible, the law is free, or parameters are undetermined or biased."""
    follows = found.fits['complete'].follows
    if found.open and follows:
        yield _both_answers(found)
    if found.of_any_law:
        yield ('The intervals hold for any smooth law; the inverse power in the scene was only a first guess. They become '
               'several times narrower if the scene names the shape of the magnets (kind = "magnets" or "table").')
    values = found.values()
    if follows and (unknown := [KEY_OF[name] for name in found.names if values[name][1] > DETERMINED]):
        yield (f'These ridges do not determine {" and ".join(unknown)} of the complete model: several parameters can change '
               'together without moving the ridges. Measure more frequencies of both branches (a force along the row drives '
               'longitudinal waves, one across it shear), or state what is known from elsewhere with --prior; --fix '
               f'{unknown[0]} keeps its value in the scene as exact.')
    if found.biased and found.better.follows:
        yield ('The values are biased and their intervals wide: the waves come from a point source, or from a source that the '
               'table does not name. Such ridges are shifted, so the true values lie to one side within the intervals '
               '(docs/coverage.md). State what is known from elsewhere with --prior, or drive a row of sources.')


def _both_answers(found):
    """The answers with and without farther neighbours, where the points leave both, and what to measure."""
    told = []
    for part, words in ((NEAREST, 'without'), (ALL, 'with')):
        shown = [f'{"exponent" if key == "a" else key} {_interval(*found.values(part=part)[key])}' for key in found.names[:2]]
        told.append(f'{", ".join(shown)} {words} them (weight {found.weights()[part]:.2g})')
    return (f'The points cannot decide whether farther neighbours act: {"; ".join(told)}. The intervals cover both. Measure '
            'more points of both branches, or the force at 1.73 spacings; a law that is a table of forces acts between all.')


def _stated(found):
    """The force that the scene states from an earlier measurement, beside that from the ridges."""
    force, share = found.values().get('force', (0.0, np.inf))
    if found.stated is None or not found.fits['complete'].follows or not share <= DETERMINED:
        return
    before, sigma = found.stated
    if found.scene.uncertainty.exponent:
        yield (f'[uncertainty] says that the exponent of the table of forces is known to {found.scene.uncertainty.exponent:.2g}; '
               'the intervals above include this.')
    apart = abs(force - before) / np.hypot(sigma, force * share)
    doubt = '' if apart < CONFLICT else ' One of the two is wrong, or they are of different magnets.'
    yield (f'The scene states a force of {before:.4g} +- {sigma:.2g} N with [uncertainty], and the ridges give {force:.4g} +- '
           f'{force * share:.2g} N: {apart:.1f} standard deviations apart.{doubt}')


def _verdict(found):
    """Which model the ridges support, and what may make the points scatter about it."""
    complete, conventional, fit, sigmas = found.fits['complete'], found.fits['conventional'], found.better, found.evidence
    difference = abs(conventional.chi2 - complete.chi2)
    if not fit.follows:
        yield (f'No model follows these ridges: the points scatter about D0 + D* by {complete.scatter:.2g} times their '
               f'uncertainties, and about D0 alone by {conventional.scatter:.2g}. The fitted parameters are meaningless, and '
               f'these data are no evidence for D* or against it. {_causes(found)}')
        return
    if abs(sigmas) < TELLS:
        yield (f'D*: these data cannot decide between the models. They differ by {difference:.2g} in chi2, {abs(sigmas):.1f} '
               'sigma, which noise alone may give: with different parameters, both follow the ridges. A law that is known from '
               'measured forces would decide, by --prior or --fix.')
    else:
        yield (f'D*: the {fit.model} model fits better, by {difference:.4g} in chi2, which is evidence of {abs(sigmas):.1f} '
               f'sigma {"for" if sigmas > 0 else "against"} D* ({SIGMAS}).')
        if (conventional if sigmas > 0 else complete).scatter == 1:
            yield ('The other model follows the ridges within their uncertainties, too: the evidence rests on the difference '
                   'alone.')
    if fit.chance < FITS:  # not where only ridges that were left out scatter
        yield (f'The points scatter about the {fit.model} model by {fit.scatter:.2g} times their uncertainties; its intervals '
               f'are enlarged, and the evidence is lowered, by this factor. {_causes(found)}')


def _causes(found):
    """Why points may scatter: the ridge that lies farthest from its branch, if it stands out."""
    points, also = found.points, f'{"what --prior says, " if found.priors else ""}mass and spacing of the scene'
    squares = found.better.residuals[: len(points)] ** 2
    off = np.sqrt(np.bincount(points.ridge, squares) / np.maximum(np.bincount(points.ridge), 1))
    worst = off.argmax()
    rest = np.median(np.delete(off, worst)) if len(off) > 1 else np.inf
    if off[worst] < STANDS_OUT * rest:
        return f'No ridge stands out: look at {also}.'
    return (f'Look at the ridge "{points.names[worst]}" first, which misses by {off[worst]:.2g} uncertainties, and the others by '
            f'{rest:.2g}: did it come from a different motion or source than the table says? Then look at {also}. Do not remove '
            'ridges until the fit looks good: the answer would be confident and wrong. --without leaves one out and widens the '
            'intervals accordingly.')


def frf_report(found: FrfFits, fixed: list[str], verbose: bool = True) -> str:
    """The patch or structure fitted to transfer functions in both models, and which of these fits better."""
    better, lines = found.better, _answer(found)
    if verbose:
        lines += ['', found.scene.title, '', *_responses(found, fixed)]
        lines += _of_sites(found) if better.follows and better.site_scatter.any() else []
    lines += _doubts_of_responses(found) if better.follows else [_not_followed(found)]
    values = found.values(better.model)
    for name, sigmas in found.contradicted.items():
        (value, _), (known, sigma) = values[name], found.priors[name]
        lines.append(f'The data give {_with_unit(name)} = {value:.4g}, {sigmas:.1f} sigma from the {known:.4g} +- {sigma:.2g} '
                     'that was known: check the calibration, the mass and the units; until they agree, all values are doubtful.')
    if feet := found.scene.foundation:
        lines += feet.doubts(max(one.omega[-1] for one in found.functions), beams=False)
    ratio, sigma = better.unlike
    if abs(ratio) >= UNLIKE * sigma:
        stiff, soft = 'xy' if ratio > 0 else 'yx'
        lines.append(f'Compared with their stiffness along {soft}, the pillars are stiffer along {stiff} than this fit assumes, '
                     f'by {100 * np.expm1(abs(ratio)):.2g} +- {100 * np.exp(abs(ratio)) * sigma:.2g} %. Give [foundation] a '
                     'stiffness_N_per_m for x and a stiffness_y_N_per_m, and fit both.')
    worse = 'conventional' if found.ratio >= 1 else 'complete'
    decision = {'complete': 'the data speak for D0 + D*.', None: 'this cannot decide between the models.', 'conventional':
                'D0 alone follows the data and D0 + D* does not. The data speak for D0 alone'
                + (', and the fit of the complete model ends without static forces.' if found.endless else '.')}[found.verdict]
    return '\n'.join([*lines, f'The residual of the {worse} model is {max(found.ratio, 1 / found.ratio):.3g} times as large: '
                              f'{decision}'])


def _not_followed(found):
    """Why a lattice has no intervals, and where a magnet may be missing."""
    better, hole = found.better, missing_magnet(found)
    strengths = 100 * better.site_scatter[0]
    why = (f'the data would need strengths that scatter by {strengths:.0f} % from site to site' if np.isfinite(strengths) else
           f'the residual is {better.misfit:.3g} times the noise, even if each site has its own strength and springs')
    look = ('Check mass, spacing, shells, units, and the positions and directions of the points.' if hole is None else
            f'It follows far better if a magnet is missing at [{hole[0]:.4g}, {hole[1]:.4g}] m: look there, and give [defects] '
            'vacancies_m.')
    return f'The lattice does not follow this model: {why}, so no intervals are given. {look}'


def _doubts_of_responses(found):
    """A warning that points are farther apart than peaks are wide."""
    apart = u.hertz(max(np.median(np.diff(one.omega)) for one in found.functions))
    wide = found.fitted(found.better.model).frf.damping_per_s / (2 * np.pi)
    if apart > wide:
        yield (f'The points are {apart:.2g} Hz apart, farther than the peaks are wide ({wide:.2g} Hz at half of their energy), '
               'so most peaks are seen by their flanks only. Measure more densely around the peaks.')


def _responses(found, fixed):
    """What is fitted, and a table of the parameters and the residual with a column for each model."""
    fits, rows = found.fits, _parameters(found)
    before = ', '.join(f'{_with_unit(name)} {value:.4g} +- {sigma:.2g}' for name, (value, sigma) in found.priors.items())
    if any(one.sigma is not None for one in found.functions):
        rows.append(('residual / noise', *(f'{fit.misfit:.4g}' for fit in fits.values())))
    else:
        rows.append(('residual (% of the peak)', *(f'{100 * fit.noise:.3g}' for fit in fits.values())))
    return [f'{len(found.functions)} transfer functions, {sum(len(one.omega) for one in found.functions)} points; '
            f'known: {", ".join(["spacing", *fixed])}' + f'; before: {before}' * bool(before) + '.', '', *_table(fits, rows)]


def _of_sites(found):
    """How far the sites scatter in the fit, each with a strength, springs and an anchor of its own."""
    better = found.better
    strengths, springs, anchors = 100 * better.site_scatter
    if any(one.sigma is not None for one in found.functions):
        yield f'The residual of a lattice without scatter is {better.misfit:.3g} times the noise.'
    else:
        yield f'The data state no uncertainties (a column sigma_...); the fitted noise is {100 * better.noise:.2g} % of the peak.'
    yield ('Each site therefore has a strength, springs and an anchor of its own in the fit. Strengths scatter by '
           f'{strengths:.2g} %, springs by {springs:.2g} %, anchors by {anchors:.2g} % of the spacing. The values above are the '
           'means of the sites of this patch.')
    if better.scatter > 1:
        yield (f'Even so the residual is {better.scatter:.3g} times the noise: the lattice does not quite follow this model, and '
               'the intervals are widened by this factor.')


def _answer(found):
    """The determined parameters of the better model in one line, if it fits the data."""
    if not found.better.follows:
        return []
    values = found.values(found.better.model)
    told = [f'{"exponent " * (name == "a")}{name.replace("_", " along ")} {f"{value:.4g} {UNITS[name]}".rstrip()} '
            f'({_ends(value, sigma)})' for name, (value, sigma) in values.items() if sigma <= DETERMINED]
    return [f'{found.better.model.capitalize()} model: {", ".join(told)}, with 95 % intervals in brackets.']


def _parameters(found):
    """Rows of a table with the parameters in each model, in brackets if it does not fit the data."""
    values = {model: found.values(model) for model in found.fits}
    return [(_with_unit(name), *(_interval(*values[model][name]) if fit.follows else f'({values[model][name][0]:.4g})'
                                 for model, fit in found.fits.items())) for name in values['complete']]


def _table(fits, rows):
    """Lines of a table with one column for each model, and how to read it."""
    head = ('', *(f'{model} ({"D0 + D*" if model == "complete" else "D0 alone"})' for model in fits))
    return [*in_columns([head, *rows], left=1 + len(fits)), '', '95 % intervals; a model whose values stand in brackets does not '
            'fit the data. Force and bond stiffness -df/dr are given at the spacing.']


def _with_unit(name):
    return f'{name} ({UNITS[name]})' if UNITS[name] else name


def _interval(value, sigma):
    """A value with its interval from the relative standard uncertainty `sigma`, if it is determined."""
    return f'{value:.4g}, {_ends(value, sigma)}' if sigma <= DETERMINED else 'not determined'  # sigma may be no number


def _ends(value, sigma):
    return f'{value * np.exp(-NORMAL * sigma):.4g} to {value * np.exp(NORMAL * sigma):.4g}'


def _entries(scene: Scene) -> list[str]:
    """Lines with the law and the springs of a fitted scene, to replace those in its file."""
    tables = {'law': scene.law.model_dump(exclude_none=True) | {'shells': scene.law.shells if scene.law.shells == 1 else 'auto'}}
    if scene.foundation:
        tables['foundation'] = {f'{name}_N_per_m': np.max(k) / (u.N / u.m) for name, k in scene.foundation.changes.items()}
    return ['', 'for a scene file, in place of its [law] and [foundation]:', toml(_rounded(tables)).rstrip()]


def _rounded(value):
    """A table, a list or a number of a scene with eight digits."""
    if isinstance(value, dict):
        return {key: _rounded(inner) for key, inner in value.items()}
    if isinstance(value, tuple):
        return [*map(_rounded, value)]
    return float(f'{value:.8g}') if isinstance(value, float) else value
