"""Plans tested: do the chosen methods meet the tolerance, and would a simpler method surely have met it?

`python -m workflows.planning` tests hundreds of plans on a grid and two hundred drawn at random, in a few minutes; `python -m
workflows planning` tests a few of each kind.
"""

import sys
from dataclasses import dataclass, replace

import numpy as np
from tqdm import tqdm

from magphonon import InversePower
from magphonon.planning.plan import Method, Plan
from magphonon.plotting.axes import COLOURS, legend_above, letter_panels, panels

from .rows import Check, Outcome, save_picture
from .situations import TOLERANCES, Peak, drawn, situations

MET, NEEDLESS = 0.99, 0.1
DRAWN = 100


@dataclass(frozen=True)
class Verdict:
    """One plan, the true error of its choice, and whether a simpler method would have done.

    Attributes
    ----------
    situation : object with truth(method)
    plan : Plan
    choice : Method
    truth : float
        True error of the choice.
    needless : bool
        Whether a simpler method would have met a tenth of the tolerance.
    """

    situation: object
    plan: Plan
    choice: Method
    truth: float
    needless: bool

    @property
    def met(self):
        return self.truth <= self.plan.tolerance


def judge(found, tolerances=TOLERANCES):
    """Plan every situation for every tolerance and compare with the truth; returns a list of Verdict."""
    return [verdict(s, s.plan(tolerance)) for s in tqdm(found, desc='situations', leave=False, disable=None)
            for tolerance in tolerances]


def judge_drawn(count, seed=0):
    """Plan random situations, each for one tolerance; returns a list of Verdict."""
    return [verdict(s, s.plan(tolerance)) for s, tolerance in tqdm(drawn(count, seed), desc='drawn', leave=False, disable=None)]


def verdict(situation, plan):
    """The method that a plan chooses, its true error, and whether a simpler method would have done."""
    choice, simpler = plan.choice, plan.methods[: plan.methods.index(plan.choice)]
    needless = any(situation.truth(method) <= NEEDLESS * plan.tolerance for method in simpler)
    return Verdict(situation, plan, choice, situation.truth(choice), needless)


def without_dstar(plan):
    """The plan of a user who ignores D*."""
    error = next(method.error for method in plan.methods if method.name == 'complete linear')
    first, *others = plan.methods
    return replace(plan, methods=(replace(first, error=error, doubt=0.0), *others))


def without_amplitude(plan):
    """The plan of a user who takes every motion as small."""
    if all(method.dt is None for method in plan.methods):
        return plan
    shift = next(method.error for method in plan.methods if method.name == 'complete linear')
    return replace(plan, methods=tuple(method if method.dt is not None else
                                       replace(method, error=max(method.error - shift, 0.0)) for method in plan.methods))


def met_by(distort, verdicts):
    """Share of the cases in which the plans changed by `distort` meet the tolerance."""
    plans = [(v.situation, distort(v.plan)) for v in verdicts]
    return float(np.mean([s.truth(plan.choice) <= plan.tolerance for s, plan in plans]))


def statistics(verdicts):
    """The results as lines of text."""
    lines = []
    for kind in dict.fromkeys(type(v.situation).__name__ for v in verdicts):
        own = [v for v in verdicts if type(v.situation).__name__ == kind]
        off = [v.choice.error / v.truth for v in own if v.truth > 1e-12 and v.choice.error > 0]
        lines.append(f'{kind.lower():9} {len(own):4} cases, {sum(v.met for v in own):4} met, '
                     f'{sum(v.needless for v in own):4} needless, '
                     f'estimate/truth {np.min(off):.2g} to {np.max(off):.2g} (median {np.median(off):.2f})')
    met = [v.met for v in verdicts]
    lines.append(f'all       {len(met):4} cases, {sum(met):4} met ({np.mean(met):.1%})')
    return '\n'.join(lines)


def main(out, quick=True):
    """Test the plans of all situations, and as controls plans that ignore D* or the amplitude."""
    verdicts = judge(situations(quick), TOLERANCES[::2] if quick else TOLERANCES)
    missed, needless = np.mean([not v.met for v in verdicts]), np.mean([v.needless for v in verdicts])
    checks = [
        Check(f'planning: share of {len(verdicts)} plans whose method misses the tolerance', missed, 0.0, 1 - MET,
              consistency=True),
        Check('planning: share of plans in which a simpler method errs by less than a tenth of the tolerance',
              needless, 0.0, NEEDLESS,
              consistency=True),
        Check('control: share of plans that meet the tolerance if D* is ignored',
              met_by(without_dstar, verdicts), 1.0, 0.05, control=True),
        Check('control: share of plans that meet the tolerance if the amplitude is ignored',
              met_by(without_amplitude, verdicts), 1.0, 0.05, control=True),
    ]
    return Outcome(checks, [draw(out, verdicts)])


def errors_of_linear(amplitude):
    """The error, with its uncertainty, that a plan for the oscillator at 45 degrees states for both linear methods."""
    methods = Peak(InversePower(1.0, 4.0), 45, amplitude).plan(1e-5).methods
    return {name: method.error * (1 + method.doubt) for name, method in zip(('frozen', 'linear'), methods, strict=False)}


MARKERS = {'Peak': '^', 'Waveform': 's', 'Beam': 'D'}


def draw(out, verdicts):
    """Draw estimated over true errors, and the method chosen for the oscillator over amplitude and tolerance."""
    figure, ((ax, regions),) = panels(1, 2, height=2.7)
    letter_panels((ax, regions), ['', 'oscillator at 45 degrees: the least model'])
    for (kind, marker), colour in zip(MARKERS.items(), COLOURS, strict=False):
        own = [v for v in verdicts if type(v.situation).__name__ == kind and v.truth > 0 and v.choice.error > 0]
        if not own:
            continue
        ax.loglog([v.truth for v in own], [v.choice.error for v in own], marker, color=colour, fillstyle='none', markersize=4,
                  linestyle='', label=kind.lower())
    least = min(min(v.truth, v.choice.error) for v in verdicts if v.truth > 0 and v.choice.error > 0)
    ends = np.array([10 ** np.floor(np.log10(least)), 1.0])
    ax.plot(ends, ends, color='0.4', lw=0.8, label='estimate = truth')
    ax.set(xlabel='true relative error of the method chosen', ylabel='relative error predicted by the plan', xlim=ends, ylim=ends)
    legend_above(ax, ncols=2)

    amplitudes = np.logspace(-3, -0.8, 40)
    bounds = [errors_of_linear(amplitude) for amplitude in amplitudes]
    frozen, linear = (np.array([bound[model] for bound in bounds]) for model in ('frozen', 'linear'))
    for low, high, grey, place, name in ((frozen, 1, '0.97', (4e-3, 0.3), 'conventional linear'),
                                         (linear, frozen, '0.87', (4e-3, 3e-3), 'complete linear'),
                                         (1e-5, linear, '0.72', (7e-2, 5e-5), 'nonlinear')):
        regions.fill_between(amplitudes, low, high, color=grey, edgecolor='0.3')
        regions.text(*place, name, ha='center')
    regions.set(xscale='log', yscale='log', xlim=amplitudes[[0, -1]], ylim=(1e-5, 1),
                xlabel=r'amplitude at the peak / $L_0$', ylabel='tolerance of the peak frequency')
    return save_picture(figure, out / 'planning.png', '(a) The errors that the plans predict, against the true ones. Marks far '
                                                      'above '
                        'the line are upper bounds: the true error was smaller than the plan could know. (b) The simplest '
                        'sufficient model for the resonance of the oscillator.')


if __name__ == '__main__':
    for name, every in (('on a grid', judge(situations('--quick' in sys.argv))), ('drawn at random', judge_drawn(DRAWN))):
        print(f'{name}\n{statistics(every)}')
        print(f'controls  {met_by(without_dstar, every):.1%} met where D* is ignored, '
              f'{met_by(without_amplitude, every):.1%} where the amplitude is\n')
