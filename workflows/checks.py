"""A number beside its reference, and what a workflow hands back."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import NamedTuple

from magphonon.files import whole_file

from .digits import apart_in_words, bound_in_words, number

DPI = 220
"""Pixels per inch of the pictures: a column of a journal, 3.4 inches, is 750 pixels wide."""

BRANCHES = 'shear', 'longitudinal'
"""Names of the two branches of a planar lattice, by ascending frequency."""


@dataclass(frozen=True)
class Check:
    """A quantity here, its reference and the tolerance between them.

    Attributes
    ----------
    quantity : str
        What it is, with its unit.
    here, reference : float
    tolerance : float
        Largest difference allowed, relative to the reference, or absolute where that is zero.
    control : bool
        True for a wrong model, which must differ by more than the tolerance.
    consistency : bool
        True where the package computed the reference too, by another method: such a row shows that two methods agree, and
        reproduces nothing.
    """

    quantity: str
    here: float
    reference: float
    tolerance: float
    control: bool = False
    consistency: bool = False

    @property
    def kind(self):
        """What the row shows: 'reproduction', 'consistency' or 'control'."""
        return 'control' if self.control else 'consistency' if self.consistency else 'reproduction'

    @property
    def difference(self):
        """Distance from the reference, relative to it unless it is zero."""
        return float(abs(self.here - self.reference) / (abs(self.reference) or 1.0))

    @property
    def passed(self):
        """Whether the number agrees, or, for a control, visibly does not."""
        apart, bound = self.difference, self.tolerance  # a NaN passes neither comparison
        return bool(apart > bound if self.control else apart <= bound)

    @property
    def cells(self):
        """The row of the table, as texts."""
        relative = self.reference != 0
        bound = bound_in_words(self.tolerance, relative)
        bound = f'more than {bound}' if self.control else f'at most {bound}' if self.tolerance else 'no difference'
        agrees = {'control': 'differs, as it must', 'consistency': 'consistent', 'reproduction': 'pass'}[self.kind]
        return (self.quantity, number(self.here, 6 if relative else 3), number(self.reference),
                apart_in_words(self.difference, relative), bound, agrees if self.passed else 'FAIL')


@dataclass(frozen=True)
class Reported:
    """A quantity that nothing judges: no reference is known, or none is independent.

    Attributes
    ----------
    quantity : str
        What it is, with its unit.
    here : float
    beside : float, optional
        A number to read it against.
    """

    quantity: str
    here: float
    beside: float | None = None
    kind = 'reported'
    passed = True

    @property
    def cells(self):
        """The row of the table, as texts."""
        return self.quantity, number(self.here, 4), '' if self.beside is None else number(self.beside), '', '', 'reported'


class Picture(NamedTuple):
    """A picture as a file of pixels, with its caption; the same for print, a PDF, lies beside it."""

    file: Path
    caption: str


@dataclass(frozen=True)
class Outcome:
    """What a workflow found: its checks, and its pictures."""

    checks: list[Check | Reported]
    pictures: list[Picture] = field(default_factory=list)


def save_picture(figure, path, caption):
    """Write a figure whole, as PNG for screens and as PDF for print; returns the entry for `Outcome.pictures`.

    The caption is in the files too, so that it stays with a picture that is sent around.  Each canvas draws once; `savefig` would
    draw twice, as it lays the figure out first, which the drawing does by itself.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    figure.dpi = DPI
    with whole_file(path, 'wb') as file:
        FigureCanvasAgg(figure).print_png(file, metadata={'Description': caption}, pil_kwargs={'compress_level': 3})
    figure.set_layout_engine('none')  # it is laid out: the PDF is the same picture
    with whole_file(path.with_suffix('.pdf'), 'wb') as file:
        FigureCanvasPdf(figure).print_pdf(file, metadata={'Subject': caption, 'CreationDate': None})
    return Picture(path, caption)


def pairs(quantity, here, reference, tolerance, of, control=False):
    """One check for each entry of two sequences, called by the names `of`."""
    return [Check(f'{quantity}, {name}', float(a), float(b), tolerance, control)
            for name, a, b in zip(of, here, reference, strict=True)]
