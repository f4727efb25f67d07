"""The chapters of the report and the claims of the paper: what each workflow reproduces, and where its references are from."""

import gc
import os
from dataclasses import dataclass
from importlib import import_module

from magphonon.cli.main import CYCLES
from magphonon.plotting.axes import print_style

from .rows import Check, number

PAPER = ('Weijian Jiao and Stefano Gonella', 'Dynamics of interacting particle systems: Modeling implications of the repulsive '
         'interactions and experiments on magnetic prototypes', 'arXiv:1911.10410')
"""Authors, title and number of the paper, as in CITATION.cff."""
PARTS = {'paper': 'The paper', 'beyond': 'Beyond the paper', 'tests': 'Tests of the package itself'}
"""Parts of the report; the last part is folded."""
FORMULAS = "the paper's formulas, evaluated in 50-digit arithmetic (reference.toml)"
SHORTENED = ('speed_accuracy',)
"""Workflows that are shortened with --quick, and whenever all workflows are run."""


@dataclass(frozen=True)
class Chapter:
    """A workflow in the report.

    Attributes
    ----------
    name : str
        Of its module.
    part : str
        A key of PARTS.
    references : str
        Where the reference numbers come from.
    figures : str
        The figures of the paper that it reproduces.
    """

    name: str
    part: str
    references: str
    figures: str = ''

    @property
    def title(self):
        """The first sentence of the docstring of the workflow."""
        first = import_module(f'.{self.name}', __package__).__doc__.partition('\n\n')[0]
        return ' '.join(first.split()).rstrip('.')


@dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes
    ----------
    words : str
    workflow, quantity : str
        The workflow and its row that test the claim.
    source : str
        Where its reference comes from, in the paper or outside.
    unit : str
        Unit of the number.
    without : str
        The row of the same workflow with the number of a model without D*; empty where there is none.
    verdict : str
        The verdict if the row passes: 'holds', or 'consistent' if the paper's data are unpublished and ours are simulated.
    """

    words: str
    workflow: str
    quantity: str
    source: str
    unit: str = ''
    without: str = ''
    verdict: str = 'holds'

    def judged(self, outcome):
        """The claim as a row of texts: words, number here, reference, number without D*, verdict, source."""
        rows = {row.quantity: row for row in outcome.checks}
        row = rows[self.quantity]
        verdict = (self.verdict if row.passed else 'fails') if isinstance(row, Check) else 'not reproduced'
        without = number(rows[self.without].here, 4) if self.without else ''
        numbers = [f'{text}{"" if self.unit == "°" else " "}{self.unit}'.strip() if text else ''
                   for text in (*row.cells[1:3], without)]
        return self.words, *numbers, verdict, self.source


CHAPTERS = (
    Chapter('oscillator', 'paper', FORMULAS, 'Fig. 1'),
    Chapter('frf', 'paper', 'the closed form of a damped oscillator with the stiffness of Eq. 3', 'Fig. 2'),
    Chapter('chain', 'paper', 'the closed form of a chain of springs on a foundation'),
    Chapter('ideal_bands', 'paper', FORMULAS, 'Figs. 3 and 4'),
    Chapter('bursts', 'paper', 'the branches of Eq. 18, which the time steps do not use; one bin is the resolution of the '
                               'measured row', 'Figs. 5 and 6'),
    Chapter('vibrometer', 'paper', 'the branches of Eq. 18, the linear response and the complex wavenumber; the measured data of '
            'the paper are not published', 'Figs. 7 and 8'),
    Chapter('prototype_bands', 'paper', FORMULAS, 'Figs. S1 and S4'),
    Chapter('magnets', 'paper', 'published forces (Robertson; Akoun and Yonnet) and the law printed in the Supplement',
            'Fig. S3'),
    Chapter('claims', 'paper', "the paper's formulas, and springs without static force in closed form", 'the text'),
    Chapter('neighbours', 'beyond', 'zeta functions and lattice sums in 50 digits (reference.toml)'),
    Chapter('stability', 'beyond', 'borders in closed form, and time steps on both sides of each'),
    Chapter('matter', 'beyond', 'printed numbers (Bonsall and Maradudin; Hamaguchi et al.), closed forms and phonopy'),
    Chapter('other_fields', 'beyond', 'closed forms of other fields, results saved by TsgFEM, tests of IonSim.jl, ASE'),
    Chapter('nonlinearity', 'beyond', 'perturbation theory in closed form'),
    Chapter('sites', 'beyond', 'closed forms of chains, the theory written out for small supercells, transfer matrices'),
    Chapter('layers', 'beyond', 'lattice sums and closed forms'),
    Chapter('losses', 'beyond', 'closed forms of the prototype and of a chain'),
    Chapter('walls', 'beyond', 'closed forms of the prototype, the solitary wave of Toda'),
    Chapter('gyration', 'beyond', 'closed forms, and a small program for gaps and Chern numbers (closed_forms.py)'),
    Chapter('bench', 'beyond', 'a simulated laboratory that shares no code with the package'),
    Chapter('phonopy_comparison', 'tests', 'the analytic stiffness compared with phonopy, which only displaces particles'),
    Chapter('speed_accuracy', 'tests', 'closed forms, higher precision and independent integrators'),
)
NAMES = tuple(chapter.name for chapter in CHAPTERS)

SHEAR_AT_M = 'M shear in time at an amplitude of 1e-10 L0'
CLAIMS = (
    Claim('The static force makes the oscillator unstable above this angle', 'oscillator', 'oscillator critical angle (deg)',
          'Sec. III: cos² θ₀ = 3/(2(a + 1))', '°'),
    Claim('D* lowers the vertical frequency of the oscillator at 0°', 'oscillator', 'oscillator omega_y (rad/s), theta0 = 0 deg',
          'Sec. III, Eq. 3', 'rad/s', 'oscillator omega_y, D0 alone (rad/s), theta0 = 0 deg'),
    Claim('The driven oscillator resonates at this frequency', 'frf', 'frf peak (rad/s), theta0 = 0 deg',
          'Fig. 2: √(D_yy/M)', 'rad/s'),
    Claim('In a chain D* has no longitudinal part (misfit of ω²)', 'chain',
          'chain longitudinal omega^2, D0 alone: misfit / largest value', 'closed form of a chain of springs'),
    Claim('In the triangular lattice D* halves the shear branch at M', 'ideal_bands', 'ideal M, complete (rad/s), shear',
          'Fig. 4: √((2a - 6)f/(L₀M))', 'rad/s', 'ideal M, conventional (rad/s), shear'),
    Claim('D* hardly moves the longitudinal branch at M', 'ideal_bands', 'ideal M, complete (rad/s), longitudinal',
          'Fig. 4: √((6a - 2)f/(L₀M))', 'rad/s', 'ideal M, conventional (rad/s), longitudinal'),
    Claim('Without static forces both models agree (shear at M / that of springs)', 'claims',
          "springs without static force (phi' = 0), M, complete model, shear", 'springs at their natural length: √(2k/M)'),
    Claim('D* acts at any amplitude (shear at M / that of D⁰, at 1e-10 L₀)', 'claims',
          f'{SHEAR_AT_M}, complete / D0 alone', 'Sec. IV: √((2a - 6)/(2a))'),
    Claim('A burst of shear travels on the branch of D⁰ + D* (distance from it, in bins)', 'bursts',
          'transverse burst, complete simulation: distance to its own branch (bins)', 'Fig. 6: Eq. 18', 'bins',
          'control: transverse burst, complete simulation: distance to the conventional branch (bins)'),
    Claim('The pillars of the prototype open a gap below this frequency', 'prototype_bands',
          'prototype cut-off, complete (Hz), shear', 'Supplement: 3EI/H³', 'Hz', 'prototype cut-off, conventional (Hz), shear'),
    Claim('The shear branch of the prototype at M', 'prototype_bands', 'prototype M, complete (Hz), shear',
          'Fig. S4, Supplement', 'Hz', 'prototype M, conventional (Hz), shear'),
    Claim('A vibrometer sees the shear branch of D⁰ + D* (distance from it at 60 Hz, in bins)', 'vibrometer',
          'vibrometer 60 Hz, complete simulation: distance to its own shear branch, Gamma-K (bins)', 'Fig. 8: Eq. 18', 'bins',
          'control: vibrometer 60 Hz, complete simulation: distance to the conventional shear branch (bins)', 'consistent'),
    Claim('D* moves the shear ridge much farther than the longitudinal one (60 Hz, ratio)', 'vibrometer',
          'row of sources, 60 Hz: distance to D0 alone, ratio shear / longitudinal, ridges and branches', 'Fig. 8: Eq. 18',
          verdict='consistent'),
    Claim('A ring of the printed size has the printed mass', 'magnets', 'ring: mass at 7.5 g/cm3 (g)',
          'Sec. IV C, Supplement', 'g'),
    Claim('Such rings repel as the printed law says (force at 10 mm / printed force)', 'magnets',
          'force at 10 mm, computed / fitted: not explained', 'Fig. S3, Supplement'),
)


def cores():
    """Number of processors that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()


def run(name, out, quick):
    """Run one workflow with the style of print for its pictures; returns its outcome."""
    gc.set_threshold(*CYCLES)
    workflow = import_module(f'.{name}', __package__)
    with print_style():
        return workflow.main(out, **({'quick': quick} if name in SHORTENED else {}))
