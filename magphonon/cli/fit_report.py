"""The reports of `magphonon fit`: the force and its slope, and the lattice fitted to ridges or to transfer functions."""

from __future__ import annotations

from collections import Counter
from typing import Any, NamedTuple

import numpy as np

from .. import units as u
from ..bands.bands import analytic_bands
from ..design.least_squares import DETERMINED, FITS, NORMAL
from ..findings import Findings
from ..interactions.fits import CONFLICT, SHAPE_WEIGHT, SHARED, Fit, SharedErrors, shells_within
from ..interactions.force_tables import Forces
from ..scenes.band_fits import KEYS, NEIGHBOURS, TELLS
from ..scenes.frf_fits import UNITS
from ..tables import in_columns
from ..waves.ridge_tables import SHIFT_bins
from .fitted import SIGMAS, entries_of, in_a_line, interval, unlike_springs, with_unit
from .neighbours import neighbours, omitted

FEW, MANY = 10, 4  # with fewer than FEW points, MANY parameters may be wrong by one misread ridge without any sign of it
SURE = 0.8  # probability of a drift above which it is reported
EXPLAINS = 2.0  # factor by which a cause lowers chi2 per degree of freedom
KEY_OF = {name: key for key, name in KEYS.items()}  # the parameters as --prior and --fix name them


class ForceCase(NamedTuple):
    """A fit of forces: options of the command, the table, the fit, and the errors that all rows share."""

    options: Any
    forces: Forces
    fit: Fit
    shared: SharedErrors


FORCES, RIDGES, RESPONSES = Findings(), Findings(), Findings()


def force_report(*case, verbose: bool = True) -> str:
    """The report of a fit of forces, described by a `ForceCase`: all of it, or only the answer and the warnings."""
    return '\n'.join(FORCES.lines(ForceCase(*case), verbose))


@FORCES.answer
def force_and_exponent(case):
    fit = case.fit
    force, _, exponent = fit.intervals
    return (f'At {u.in_words("m", fit.spacing / u.m)} the force is {fit.force / u.N:.4g} N ({force[0] / u.N:.4g} to '
            f'{force[1] / u.N:.4g}) and the exponent {fit.exponent:.4g} ({exponent[0]:.4g} to {exponent[1]:.4g}), with 95 % '
            'intervals in brackets.')


@FORCES.remark
def table(case):
    r, sigma = case.forces.r, case.forces.sigma
    return (f'{case.options.file}: {len(r)} forces from {r.min() / u.m:g} to {r.max() / u.m:g} m, '
            f'{"without" if sigma is None else "with"} uncertainties')


@FORCES.remark
def force_and_slope(case):
    fit = case.fit
    yield f'\nat {fit.spacing / u.m:g} m, with 95 % intervals:'
    force, slope, exponent = fit.intervals
    for name, value, ends, unit, symbol in (('force f', fit.force, force, u.N, 'N'),
                                            ('slope df/dr', fit.slope, -slope[::-1], u.N / u.m, 'N/m'),
                                            ('exponent', fit.exponent, exponent, 1.0, '')):
        low, high = ends / unit
        yield f'  {name:12} {value / unit:.4g} [{low:.4g}, {high:.4g}] {symbol}'.rstrip()


@FORCES.remark
def known_before(case):
    zero, distance, hysteresis, backlash = case.shared.sizes(abs(case.forces.f).max())
    return (f'\nAssumed beforehand: the zero of the distances is known to {distance / u.mm:.2g} mm, that of the force to '
            f'{zero / u.N:.2g} N,\nhysteresis to {hysteresis / u.N:.2g} N, backlash to {backlash / u.mm:.2g} mm, gain to '
            f'{100 * case.shared.gain:.2g} % (standard deviations).\n'
            'If you know them better, say so: --distance-sigma, --zero-sigma, --hysteresis-sigma, --backlash-sigma, '
            '--gain-sigma.')


@FORCES.remark
def what_makes_the_slope_uncertain(case):
    fit = case.fit
    shares = sorted(fit.shares.items(), key=lambda item: -item[1])
    parts = ', '.join(f'{name} {100 * share:.0f} %' for name, share in shares if share > 0.005)
    yield f'Causes of the uncertainty of the slope, as shares of its variance: {parts}.'


@FORCES.remark
def which_law(case):
    if case.options.magnet is None:
        near, far = case.forces.r.min(), case.forces.r.max()
        return (f'Forces from {near / u.mm:g} to {far / u.mm:g} mm do not determine the kind of law; the intervals hold for any '
                f'smooth law.')
    lost = '; the data contradict it.' if case.fit.weight < SHAPE_WEIGHT / 5 else '.'
    return f'The shape of {case.options.magnet}, rather than a free curve, has the probability {case.fit.weight:.2g}{lost}'


@FORCES.check
def saturation(case):
    if (top := case.forces.saturated).any():
        r = case.forces.r[top] / u.mm
        where = f'from {r.min():g} to {r.max():g}' if np.ptp(r) else f'at {r[0]:g}'
        return (f'{top.sum()} rows {where} mm have the same largest force, {case.forces.f.max() / u.N:g} '
                'N: the load cell was saturated there. Leave these rows out; with them the exponent is too small.')
    return None


@FORCES.check
def drift(case):
    """Whether the errors of successive rows are correlated."""
    return ('The errors of successive rows are correlated (with a probability of '
            f'{100 * case.fit.drift:.0f} %): the load cell drifts, perhaps as it warms up, and the intervals allow for it. '
            'Return to one distance now and then to see the drift.') if case.fit.drift > SURE else None


@FORCES.remark
def pairs(case):
    """How far a single pair may be from the mean of all pairs in the lattice."""
    count, sigma = case.forces.pairs, case.fit.pair
    if sigma:
        told = 'as stated' if case.shared.pair is not None else 'as their scatter says'
        return (f'{count} pair{"s" * (count > 1)}, whose forces scatter about their mean by {100 * sigma:.2g} % (one standard '
                f'deviation, {told}); the intervals are those of the mean.')
    return ('The table holds one pair of magnets. If magnets differ by 2.5 %, the force of one pair is about 3.5 % off the mean '
            'of the lattice. Measure several, numbered in a column "pair", or give --pair-sigma 0.035.') if count == 1 else None


@FORCES.check
def few_rows(case):
    n = len(case.forces.r)
    return f'{n} rows are too few to find the shape of the law: the intervals rest on the assumptions above.' if n < FEW else None


@FORCES.check
def scatter(case):
    return (f'The rows scatter {case.fit.scatter:.2g} times as much as their sigma_N says, and the intervals are widened '
            'accordingly: look for an outlier, or remove this column.') if case.fit.scatter > 1 else None


@FORCES.remark
def reach(case):
    """How many shells of neighbours lie within the range of the table."""
    spacings = case.fit.law.r[-1] / case.fit.spacing
    known = shells_within(spacings)
    return (f'The table reaches to {spacings:.3g} spacings, which is {known} shell{"s" * (known > 1)} of neighbours or more. The '
            'law omits farther neighbours: measure to three spacings or more, or name the scene of the magnets first. "magphonon '
            'check" estimates by how much farther neighbours would shift the frequencies.')


@FORCES.check
def conflicts(case):
    """Errors shared by the whole table whose fitted values are far from what was stated."""
    for name, value, conflict, unit, symbol in zip(SHARED, case.fit.zeros, case.fit.conflicts, (u.N, u.mm, u.N, u.mm),
                                                   ('N', 'mm') * 2, strict=True):
        if conflict > CONFLICT:
            yield (f'The {name} comes out as {value / unit:.2g} {symbol}, {conflict:.1f} standard deviations from what was '
                   'assumed: its error is larger than stated, or the magnets have a different shape.')


def band_report(found, points: int, fixed: list[str], verbose: bool = True) -> str:
    """The parameters in both models with their intervals, what is not determined, the evidence for D*, and shifts by omitted
    neighbours; or only the answer, its entries for a scene, and the warnings.
    """
    if not verbose:
        beside = omitted(found.scene, {'the ridges': found.points.q})
        return '\n'.join([*_answer(found), *RIDGES.lines(found, verbose=False), *([f'\n{beside.words}'] if beside.fault else [])])
    own, fits = found.points, found.fits
    ridges = Counter(fits['complete'].branches[k] for k in set(own.ridge.tolist()))
    on = ', '.join(f'{count} on branch {branch + 1}{_called(found, branch)}' for branch, count in sorted(ridges.items()))
    lines = [*_answer(found), '', found.scene.title, '', f'Fitting {len(own)} of the {points} ridge points (the others are so '
             f'close to these in frequency that they share their noise). Ridges: {on}.', *_known(found, fixed), '']
    values = {model: found.values(model) for model in fits}
    rows = [(with_unit(name, UNITS), *(interval(*values[model][name]) for model in fits)) for name in values['complete']]
    rows += _predicted(found)
    rows.append(('chi2/freedom', *(f'{fit.chi2:.4g}/{fit.freedom}' for fit in fits.values())))
    rows.append(('p-value', *(f'{fit.chance:.2g}' for fit in fits.values())))
    return '\n'.join([*lines, *_table(fits, rows), '',
                      '95 % intervals; force and bond stiffness -df/dr are given at the spacing.', *RIDGES.lines(found)])


def _called(found, branch):
    """The polarisation of a branch in brackets, if it is the same at all measured points; otherwise ''."""
    points, cell = found.points, found.scene.perfect_cell()
    on = np.array(found.fits['complete'].branches)[points.ridge] == branch
    kinds = {*analytic_bands(cell, points.q[on], vectors=True).polarisations[:, branch]}
    if kinds == {'transverse'} and cell.pbc.sum() > 1:
        return ' (shear)'
    return f' ({kinds.pop()})' if len(kinds) == 1 else ''


def _known(found, fixed):
    known = [f'fixed: {", ".join(KEY_OF[name] for name in fixed)}'] if fixed else []
    before = ', '.join(f'{KEY_OF[name]} = {value:.4g} +- {sigma:.2g}' for name, (value, sigma) in found.priors.items())
    known += [f'before: {before}'] if before else []
    shells = found.scene.law.shells
    return ['; '.join(['Known: spacing and mass', *known]) + '.',
            f'Neighbours: {shells} shell{"s" * (shells != 1)}.' + (
                ' Farther neighbours are omitted: a law fitted with one shell is not the pair law of the magnets; shells = '
                '"auto" counts as many shells as matter.' if shells == 1 else '')]


def _predicted(found):
    """Rows of the frequencies of both models at the special points."""
    points = found.scene.special_points
    told = [found.predicted(np.array(list(points.values())), model) for model in found.fits]
    return [(f'{name}, branch {branch + 1} (Hz)',
             *(interval(u.hertz(omega[k, branch]), sigma[k, branch]) for omega, sigma in told))
            for k, name in enumerate(points) for branch in range(told[0][0].shape[1])]


@RIDGES.remark
def allowed(found):
    """The shifts, shared by all ridges of a branch, for which the intervals allow."""
    sources = [found.points.sources[k] if found.points.sources else 'point' for k in found.points.ridge]
    kinds = [(kind, sources.count(kind)) for kind in SHIFT_bins if kind in sources]
    told = ' and '.join(f'{SHIFT_bins[kind]:g} bins for the {count} points of waves from a {kind}' for kind, count in kinds)
    lines = [f'The intervals allow for a common shift of all ridges of a branch in wavenumber: {told}.']
    strayed = found.fits['complete'].strayed
    if strayed:
        lines.append(f'{strayed} of the points from a point source are closer to the other branch than to the branch of their '
                     'own motion.')
    return lines


def _answer(found):
    """The parameters of the better model in one line, if it fits the data."""
    model = found.better.model
    told = f'{model.capitalize()} model: {in_a_line(found.values(model), UNITS)}, with 95 % intervals in brackets.'
    return [told] if found.better.follows else []


def _table(fits, rows):
    """Lines of a table with one column for each model."""
    rows = [('', *(f'{model} ({"D0 + D*" if model == "complete" else "D0 alone"})' for model in fits)), *rows]
    return in_columns(rows, left=1 + len(fits))


@RIDGES.check
def few_points(found):
    n, names = len(found.points), found.names
    if n < FEW and len(names) >= MANY:
        yield (f'{n} points are few for {len(names)} parameters: one misread ridge would change them but hardly raise '
               'chi2. Record longer, or with more carriers.')


@RIDGES.check
def any_law(found):
    """Whether the intervals hold for any smooth law."""
    return ('The intervals hold for any smooth law; the inverse power in the scene was only a first guess. They become several '
            'times narrower if the scene names the shape of the magnets (kind = "magnets" or "table").'
            ) if found.of_any_law else None


@RIDGES.check
def undetermined(found):
    open_ = [KEY_OF[name] for name, sigma in zip(found.names, found.fits['complete'].sigma, strict=False) if sigma > DETERMINED]
    if not open_ or not found.fits['complete'].follows:
        return []
    more = ('the other branch too (a force along the row drives longitudinal waves, one across it shear)'
            if len(set(found.fits['complete'].branches)) == 1 else 'more frequencies of both branches')
    return [f'These ridges do not determine {" and ".join(open_)} of the complete model: several parameters can change together '
            f'without moving the ridges. Measure {more}, or state what is known from elsewhere with --prior; --fix '
            f'{open_[0]} keeps its value in the scene as exact.']


@RIDGES.check
def biased(found):
    lines = []
    if found.biased and found.better.follows:
        more = ' '.join(f'--prior {KEY_OF[name]}=...+-...' for name in found.names if name not in (*found.priors, 'force'))
        lines.append('The values are biased and their intervals wide: the waves come from a point source, or from a source that '
                     'the table does not name. Such ridges are shifted, so the true values lie to one side within the intervals '
                     f'(docs/coverage.md). State what is known from elsewhere with {more}, or drive a row of sources.')
    if not any(found.points.motions):
        lines.append('The table has no column motion: which branch a ridge follows is decided by its distance alone'
                     + (', and all points count as one ridge. Add the columns record and motion (transverse or longitudinal).'
                        if len(found.points.names) == 1 else '.'))
    return lines


@RIDGES.check
def left_out(found):
    fit = found.fits['complete']
    if not found.left_out:
        return []
    return [f'Omitted from the fit: {", ".join(found.left_out)}. With them the points scatter about the fit by '
            f'{fit.scatter:.2g} times their uncertainties, and all intervals are widened accordingly. A fit that is good only '
            'because ridges were left out is no more certain than a fit to all of them.']


@RIDGES.check
def stated(found):
    """The force stated in the scene from an earlier measurement, beside that from the ridges."""
    if found.stated is None or not found.fits['complete'].follows:
        return []
    (before, sigma), (force, share) = found.stated, found.values()['force']
    if not share <= DETERMINED:
        return []
    lines = [f'[uncertainty] says that the exponent of the table of forces is known to {found.scene.uncertainty.exponent:.2g}; '
             'the intervals above include this.'] if found.scene.uncertainty.exponent else []
    apart = abs(force - before) / np.hypot(sigma, force * share)
    doubt = '' if apart < CONFLICT else ' One of the two is wrong, or they are of different magnets.'
    return [*lines,
            f'The scene states a force of {before:.4g} +- {sigma:.2g} N with [uncertainty], and the ridges give {force:.4g} +- '
            f'{force * share:.2g} N: {apart:.1f} standard deviations apart.{doubt}']


@RIDGES.check
def verdict(found):
    if not found.better.follows:
        return [f'No model follows these ridges: the points scatter about D0 + D* by {found.fits["complete"].scatter:.2g} times '
                f'their uncertainties, and about D0 alone by {found.fits["conventional"].scatter:.2g}. The parameters above are '
                f'meaningless, and these data are no evidence for D* or against it. {_causes(found)}']
    sigmas = found.evidence
    difference = abs(found.fits['conventional'].chi2 - found.fits['complete'].chi2)
    if abs(sigmas) < TELLS:
        law = [key for key, name in KEYS.items() if name in found.names and not name.startswith('foundation')]
        known = f' A law that is known from measured forces would decide: --prior, or --fix {",".join(law)}.' if law else ''
        return [f'D*: these data cannot decide between the models. They differ by {difference:.2g} in chi2, {abs(sigmas):.1f} '
                f'sigma, which noise alone may give: with different parameters, both follow the ridges.{known}',
                *_scattered(found)]
    better, worse = ('complete', 'conventional')[:: 1 if sigmas > 0 else -1]
    lines = [f'D*: the {better} model fits better, by {difference:.4g} in chi2, which is evidence of {abs(sigmas):.1f} sigma '
             f'{"for" if sigmas > 0 else "against"} D* ({SIGMAS}).']
    if found.fits[worse].scatter == 1:
        lines.append(f'The {worse} model follows the ridges within their uncertainties, too: the evidence rests on the '
                     'difference alone.')
    return [*lines, *_scattered(found)]


def _scattered(found):
    """A comment if the points scatter about the better model by more than their uncertainties."""
    fit = found.better
    if fit.chance >= FITS:  # also where only ridges that were left out do
        return []
    return [f'The points scatter about the {fit.model} model by {fit.scatter:.2g} times their uncertainties; its intervals are '
            f'enlarged, and the evidence is lowered, by this factor. {_causes(found)}']


def _causes(found):
    """Why points may scatter: the changes that were tried, with the remaining chi2, and the one that explains it."""
    fit = found.better
    tried = [f'{one.chi2:.4g}/{one.freedom} ' + ('with as many neighbours as matter (shells = "auto")' if name == NEIGHBOURS else
                                                 f'without the ridge "{name}"') for name, one in found.causes.items()]
    told = f'Fitted again, with one thing changed, chi2/freedom is {"; ".join(tried)}. ' if tried else ''
    explain = [name for name, one in found.causes.items() if one.chi2 / one.freedom < fit.chi2 / fit.freedom / EXPLAINS]
    best = NEIGHBOURS if NEIGHBOURS in explain else next(iter(explain), None)  # it keeps all measurements
    also = f'{"what --prior says, " if found.priors else ""}mass and spacing of the scene'
    if best is None:
        return f'{told}None of these explains it: look at {also}.' if tried else f'Look at {also}.'
    if best == NEIGHBOURS:
        return f'{told}Use shells = "auto". If that is not enough, look at {also}.'
    return (f'{told}Look at the ridge "{best}" first: did it come from a different motion or source than the table says? Then '
            f'look at {also}. Do not remove ridges until the fit looks good: the answer would be confident and wrong. '
            '--without leaves one out and widens the intervals accordingly.')


@RIDGES.remark
def correlations(found):
    """Correlations of the parameters of the complete model, if all of them are determined."""
    fit, n = found.fits['complete'], len(found.names)  # others are not reported
    if (fit.sigma[:n] > DETERMINED).any() or not fit.follows:
        return None
    R = (fit.covariance / np.outer(fit.sigma, fit.sigma))[:n, :n]
    pairs = [f'{fit.names[i]} and {fit.names[j]} {R[i, j]:.2f}' for i in range(len(R)) for j in range(i)]
    return f'Correlations: {", ".join(pairs)}.' if pairs else None


@RIDGES.check
def entries(found):
    """The entries of the complete model for a scene file, if all of its parameters are determined."""
    fit = found.fits['complete']
    return [] if (fit.sigma[: len(found.names)] > DETERMINED).any() or not fit.follows else entries_of(found.fitted())



@RIDGES.remark
def others(found):
    """Shifts by omitted neighbours at the ridges; a relative shift of frequency is half that of the bond stiffness."""
    sigma = found.values()['bond stiffness'][1]
    within = {('the ridges', k + 1): NORMAL * sigma / 2 for k in set(found.fits['complete'].branches)}
    scene = found.fitted() if found.fits['complete'].follows else found.scene
    return ['', *neighbours(scene, {'the ridges': found.points.q}, within=within)]


def frf_report(found, fixed: list[str], verbose: bool = True) -> str:
    """The parameters in both models with their intervals, what no model of the lattice can fit, and which model fits better; or
    only the answer and the warnings.
    """
    if not verbose:
        return '\n'.join([*_answer(found), *RESPONSES.lines(found, verbose=False)])
    fits, values = found.fits, {model: found.values(model) for model in found.fits}
    points = sum(len(one.omega) for one in found.functions)
    known = ', '.join(['spacing', *(['mass'] if 'mass' not in fits['complete'].names else []), *fixed])
    rows = [(with_unit(name, UNITS), *(interval(*values[model][name]) if fit.follows else f'({values[model][name][0]:.4g})'
                                 for model, fit in fits.items())) for name in values['complete']]
    stated = any(one.sigma is not None for one in found.functions)
    rows.append(('residual / noise' if stated else 'residual (% of the peak)',
                 *(f'{fit.misfit:.4g}' if stated else f'{100 * fit.noise:.3g}' for fit in fits.values())))
    return '\n'.join([
        *_answer(found), '', found.scene.title, '',
        f'{len(found.functions)} transfer functions, {points} points; known: {known}.', '', *_table(fits, rows), '',
        '95 % intervals; a model whose values stand in brackets does not fit the data. Force and '
        'bond stiffness -df/dr are given at the spacing.', *RESPONSES.lines(found)])


@RESPONSES.check
def not_this_lattice(found):
    better = found.better
    strengths = 100 * better.site_scatter[0]
    why = (f'the data would need strengths that scatter by {strengths:.0f} % from site to site' if np.isfinite(strengths) else
           f'the residual is {better.misfit:.3g} times the noise, even if each site has its own strength and springs')
    return None if better.follows else (
        f'The lattice does not follow this model: {why}, so no intervals are given. Check mass, '
        'spacing, shells, units, and the positions and directions of the points.')


@RESPONSES.remark
def residual(found):
    better = found.better
    if not (better.follows and better.site_scatter.any()):
        return
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


@RESPONSES.check
def contradictions(found):
    values = found.values(found.better.model)
    for name, sigmas in found.contradicted.items():
        (value, _), (known, sigma) = values[name], found.priors[name]
        yield (f'The data give {with_unit(name, UNITS)} = {value:.4g}, {sigmas:.1f} sigma from the {known:.4g} +- {sigma:.2g} '
               'that was known: check the calibration, the mass and the units; until they agree, all values are doubtful.')


@RESPONSES.check
def springs(found):
    return unlike_springs(found.better)


@RESPONSES.check
def which_model(found):
    worse = 'conventional' if found.ratio >= 1 else 'complete'
    return f'The residual of the {worse} model is {max(found.ratio, 1 / found.ratio):.3g} times as large: ' + {
        'complete': 'the data speak for D0 + D*.',
        'conventional': 'D0 alone follows the data and D0 + D* does not. The data speak for D0 alone'
                        + (', and the fit of the complete model ends without static forces.' if found.endless else '.'),
        None: 'this cannot decide between the models.'}[found.verdict]
