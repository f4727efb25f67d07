"""Which rows notice a wrong package: each chapter is run with wrong physics inside, `python -m workflows --mutate`.

weak D*     D* of the analytic stiffness is 2 % too small; forces, and so time steps and phonopy, stay right
weak law    all forces and their derivatives are 10 % too small
no D0       the model of D0 alone is the complete model: every control that puts D0 to the test must fail
"""

from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib import import_module
from multiprocessing import get_context

import numpy as np
from tqdm import tqdm

from .chapters import CHAPTERS, cores, run

WEAK_DSTAR, WEAK_LAW = 0.98, 0.9
MUTATED = tuple(chapter.name for chapter in CHAPTERS if chapter.name not in ('bench', 'speed_accuracy', 'magnets'))
"""The chapters that have a stiffness, but not those of statistics and of time."""


def weak_dstar():
    """Take 2 % of D* out of the stiffness of a bond, and out of the sums over all neighbours."""
    from magphonon.stiffness.all_neighbours import AllNeighbours
    from magphonon.stiffness.matrices import Central

    _patch_stiffness(Central, lambda D0, Dstar: (D0, WEAK_DSTAR * Dstar))

    def mixed(method):
        def weaker(self, where, model=None):
            both = [method(self, where, one) for one in (model or self.model, 'conventional')]
            if not isinstance(both[0], tuple):
                return WEAK_DSTAR * both[0] + (1 - WEAK_DSTAR) * both[1]
            return tuple(WEAK_DSTAR * one + (1 - WEAK_DSTAR) * other for one, other in zip(*both, strict=True))
        return weaker

    for name in ('bloch_matrix', 'bloch_series', 'singular'):
        setattr(AllNeighbours, name, mixed(getattr(AllNeighbours, name)))


def weak_law():
    """Make every bond of every calculator weaker, whatever its law."""
    from magphonon.stiffness import matrices
    from magphonon.stiffness.all_neighbours import AllNeighbours

    right, made = matrices.laws_along, AllNeighbours.__init__

    def weaker(*arguments):
        each, which, strength = right(*arguments)
        return each, which, WEAK_LAW * strength

    def made_weaker(self, reference, law, *, strengths=None, **sites):
        strengths = np.ones(len(reference)) if strengths is None else np.asarray(strengths, float)
        made(self, reference, law, strengths=np.sqrt(WEAK_LAW) * strengths, **sites)

    matrices.laws_along, AllNeighbours.__init__ = weaker, made_weaker


def no_d0():
    """Let the wrong model be the right one, in stiffness, forces and sums."""
    from magphonon.interactions import UprightMagnets
    from magphonon.stiffness import all_neighbours
    from magphonon.stiffness.calculator import PairCalculator
    from magphonon.stiffness.matrices import Central

    for interaction in (Central, UprightMagnets):
        _patch_stiffness(interaction, lambda D0, Dstar: (D0 + Dstar, 0 * Dstar))
    all_neighbours.PART['conventional'] = all_neighbours.PART['complete']
    right = PairCalculator.set
    PairCalculator.set = lambda self, **given: right(self, **given | ({'model': 'complete'} if 'model' in given else {}))


def _patch_stiffness(interaction, changed):
    right = interaction.stiffness
    interaction.stiffness = lambda self, R: changed(*right(self, R))


MUTATIONS = {'weak D*': weak_dstar, 'weak law': weak_law, 'no D0': no_d0}


@dataclass(frozen=True)
class Noticed:
    """How many rows of a chapter fail under a mutation.

    Attributes
    ----------
    rows, outside, controls : tuple of int
        Number that fail, and number of all: of rows that must agree, of those whose reference is from outside the package, and of
        controls with D0. The three are empty if the chapter stopped with an error, which is noticed too.
    """

    rows: tuple = ()
    outside: tuple = ()
    controls: tuple = ()


def noticed(mutation, name, out):
    """Run a chapter under a mutation, in a process of its own; its pictures are of no use, and are not saved."""
    MUTATIONS[mutation]()
    import_module(f'.{name}', __package__).save_picture = lambda *_: None
    try:
        checks = run(name, out, quick=True).checks
    except Exception:  # whatever the wrong physics leads to
        return Noticed()
    rows = [check for check in checks if check.kind not in ('control', 'reported')]

    def failed(some):
        return sum(not check.passed for check in some), len(some)

    return Noticed(failed(rows), failed([row for row in rows if row.kind != 'two methods']),
                   failed([check for check in checks if getattr(check, 'control', '') == 'D0']))


def table(names, out):
    """What each chapter notices of each mutation: {name: {mutation: Noticed}}."""
    jobs = [(mutation, name) for name in names for mutation in MUTATIONS]
    with ProcessPoolExecutor(min(cores(), len(jobs)), get_context('spawn'), max_tasks_per_child=1) as pool:
        futures = {job: pool.submit(noticed, *job, out) for job in jobs}
        found = {job: futures[job].result() for job in tqdm(jobs, desc='mutations', disable=None)}
    return {name: {mutation: found[mutation, name] for mutation in MUTATIONS} for name in names}


def as_markdown(found):
    """The table as it stands in the documentation."""
    def cell(counted, words):
        failed, every = counted or (None, None)
        return 'stops' if every is None else f'{failed} of {every} {words}' if every else ''

    lines = ['| chapter | D\\* x 0.98 | force law x 0.9 | of these, on outside references | D0 + D\\* in place of D0 |',
             f'|{5 * "---|"}']
    for name, by in found.items():
        lines.append(f'| `{name}` | {cell(by["weak D*"].rows, "rows")} | {cell(by["weak law"].rows, "rows")} | '
                     f'{cell(by["weak law"].outside, "rows")} | {cell(by["no D0"].controls, "controls")} |')
    return '\n'.join(lines)
