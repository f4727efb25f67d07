"""The chapters of the report, in order: what each workflow reproduces, and whose its references are."""

from dataclasses import dataclass
from importlib import import_module

PARTS = {
    'paper': 'The paper',
    'beyond': 'Beyond the paper',
    'tests': 'Tests of the package itself',
}
"""Parts of the report by their keys; the last is folded."""
FORMULAS = "the paper's formulas, evaluated in 50-digit arithmetic (reference.toml)"


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
        Whose the reference numbers are.
    figures : str
        Those of the paper that it reproduces.
    """

    name: str
    part: str
    references: str
    figures: str = ''

    @property
    def title(self):
        """First line of the docstring of the workflow."""
        return import_module(f'.{self.name}', __package__).__doc__.splitlines()[0].rstrip('.')


CHAPTERS = (
    Chapter('oscillator', 'paper', FORMULAS, 'Fig. 1'),
    Chapter('frf', 'paper', 'the closed form of a damped oscillator with the stiffness of Eq. 4', 'Fig. 2'),
    Chapter('chain', 'paper', 'the closed form of a chain of springs on a foundation'),
    Chapter('ideal_bands', 'paper', FORMULAS, 'Figs. 3 and 4'),
    Chapter('bursts', 'paper', 'the branches of Eq. 18, which the time steps know nothing of; one bin is the resolution of the '
            'measured row', 'Figs. 5 and 6'),
    Chapter('vibrometer', 'paper', 'the branches of Eq. 18, the linear response and the complex wavenumber; the measured data of '
            'the paper are not published', 'Figs. 7 and 8'),
    Chapter('prototype_bands', 'paper', FORMULAS, 'Fig. S4'),
    Chapter('magnets', 'paper', 'published forces (Robertson; Akoun and Yonnet), magpylib, and the law printed in the Supplement',
            'Fig. S3'),
    Chapter('claims', 'paper', "the paper's formulas, and springs without static force in closed form", 'the text'),
    Chapter('neighbours', 'beyond', 'zeta functions and published lattice sums (Golden and Kalman; reference.toml)'),
    Chapter('stability', 'beyond', 'borders in closed form, and runs on both sides of them'),
    Chapter('matter', 'beyond', 'printed numbers (Bonsall and Maradudin; Zahn et al.; Hamaguchi et al.) and phonopy'),
    Chapter('uncertainty', 'beyond', "the paper's formulas for lattices drawn at random"),
    Chapter('nonlinearity', 'beyond', 'perturbation theory in closed form'),
    Chapter('design', 'beyond', "the paper's prototype, and closed forms of the spacing"),
    Chapter('sites', 'beyond', 'closed forms of chains, the theory written out for small supercells, transfer matrices'),
    Chapter('layers', 'beyond', 'lattice sums and closed forms'),
    Chapter('phonopy_comparison', 'tests', 'the analytic stiffness compared with phonopy, which only displaces particles'),
    Chapter('speed_accuracy', 'tests', 'closed forms, higher precision and independent integrators'),
    Chapter('planning', 'tests', 'the exact answers to small questions'),
)
NAMES = tuple(chapter.name for chapter in CHAPTERS)
