"""The report of `magphonon fit` on several records of one lattice: the answer, which records contradict each other, what to
measure next.
"""

from __future__ import annotations

import numpy as np

from .. import units as u
from ..design.joint_fits import RESPONSES
from ..design.least_squares import DETERMINED, NORMAL
from ..findings import Findings, next_lines
from ..interactions.fits import SHAPE_WEIGHT
from ..scenes.band_fits import TELLS
from ..scenes.frf_fits import UNITS
from ..tables import in_columns
from .fitted import SIGMAS, entries_of, in_a_line, interval, unlike_springs, with_unit

PULL = 2.7
"""Pull in standard deviations above which a fault is named: a fault with a pull of 4 is then named in 9 of 10 cases, a false one
in 1 of 100."""

JOINT = Findings()


def joint_report(found, verbose: bool = True) -> str:
    """The parameters from all records with their intervals, and how well each record alone determines them; or only the answer
    and the warnings.
    """
    joint, values = found.joints['complete'], found.values()
    first = f'{in_a_line(values, UNITS)}, with 95 % intervals in brackets.'
    if not verbose:
        return '\n'.join([first, *JOINT.lines(found, verbose=False)])
    alone = {name: [joint.alone(name).sigma_along(v) for v in found.along().values()] for name in found.records}
    rows = [('', 'all together', *found.records)]
    for k, (name, value) in enumerate(values.items()):
        rows.append((with_unit(name, UNITS), interval(*value),
                     *(f'{100 * NORMAL * one[k]:.2g} %' if one[k] <= DETERMINED else 'not determined'
                       for one in alone.values())))
    points = found.specimen.scene.special_points
    omega, sigma = found.predicted(np.array(list(points.values())))
    for k, name in enumerate(points):
        for branch in range(omega.shape[1]):
            rows.append((f'{name}, branch {branch + 1} (Hz)', interval(u.hertz(omega[k, branch]), sigma[k, branch])))
    rows = [(*row, *[''] * (len(rows[0]) - len(row))) for row in rows]
    return '\n'.join([first, '', found.specimen.scene.title, '', *in_columns(rows, left=2), '',
                      '95 % intervals; then, for each record alone, the half width of its interval.', *JOINT.lines(found)])


@JOINT.remark
def contradictions(found):
    joint, names = found.joints['complete'], found.records
    yield '\nContradictions, in standard deviations:'
    for k, name in enumerate(names):
        others = [(other, joint.contradiction(name, other)) for other in names[k + 1:]] if len(names) > 2 else []
        told = [f'{"all others" if other is None else other} {sigmas:.1f}' for other, sigmas in
                [(None, joint.contradiction(name)), *others] if np.isfinite(sigmas)]
        yield f'  {name} against {", ".join(told) or "none: the other records determine nothing that this one does"}'


@JOINT.check
def faults(found):
    """The fault that explains most, if one does."""
    pulls = found.joints['complete'].pulls()
    if not pulls or pulls[0].sigmas < PULL:
        yield 'The records agree: no single fault of an instrument improves the fit by more than chance.'
        return
    for pull in pulls[:3]:
        if pull.sigmas >= PULL:
            yield (f'{pull.record}: {pull.fault} would have to be off by {abs(pull.shift):.1f} times its stated '
                   f'uncertainty; the evidence for this is {pull.sigmas:.1f} sigma.')
    yield 'Begin with the first one: when it is corrected, the others may vanish.'


@JOINT.check
def dstar(found):
    evidence = found.evidence
    if abs(evidence) < TELLS:
        return f'D*: these records cannot decide between the models ({abs(evidence):.1f} sigma).'
    return (f'D*: all records together are evidence of {abs(evidence):.1f} sigma {"for" if evidence > 0 else "against"} D* '
            f'({SIGMAS}).')


@JOINT.check
def responses(found):
    if not found.responses:
        return
    complete, alone = (found.responses[model].square for model in ('complete', 'conventional'))
    yield f'Transfer functions: the residual without D* is {np.sqrt(alone / complete):.2g} times that with it.'
    if (told := unlike_springs(found.responses['complete'])) is not None:
        yield told
    if not found.joints['complete'].alone(RESPONSES).records[0].information.any():
        yield ('The transfer functions are given no weight, because even a scatter of 10 % from site to site would not explain '
               'them: use "magphonon fit --frf" to check whether positions, units or neighbours are wrong.')


@JOINT.check
def laws(found):
    yield f'Probability of each kind of law: {", ".join(f"{words} {weight:.2g}" for words, weight in found.laws.items())}.'
    if found.specimen.family.tau < 1 and found.laws['the shape in the scene'] < SHAPE_WEIGHT / 5:
        yield ('The records contradict the shape of the law in the scene, and the values above depend on it. Repeat the fit '
               'with kind = "inverse_power", which allows any smooth law.')


@JOINT.check
def springs(found):
    weight = found.one_spring
    return None if weight is None else f'The probability that one spring constant holds for both directions is {weight:.2g}.'


@JOINT.check
def what_next(found):
    return next_lines(found.proposals)


@JOINT.check
def entries(found):
    """The law and the springs of the complete model, if all of them are determined."""
    return entries_of(found.fitted()) if all(sigma <= DETERMINED for _, sigma in found.values().values()) else None
