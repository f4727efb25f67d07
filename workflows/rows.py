"""A number with its reference, a picture, and the result of a workflow."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import NamedTuple

from magphonon.files import whole_file
from magphonon.plotting.axes import lay_out

DPI = 220
"""Pixels per inch of the pictures: a column of a journal, 3.4 inches, is 750 pixels wide."""
BRANCHES = 'shear', 'longitudinal'
"""Names of the two branches of a planar lattice, by ascending frequency."""
SOURCES = {
    'printed': 'printed in a publication, which is named',
    'open code or data': 'from a code or data of others, which is named with its version',
    'closed form': 'derived for the workflow by other means than those of the package',
    'two methods': 'from another method of the package: two methods agree, which reproduces nothing',
}
"""By whom a reference may be."""
ROUNDING = 1e-9
"""A quantity that should vanish and is smaller than this is zero to rounding: its digits mean nothing."""


def number(value, digits=6):
    """A number as text with so many digits; a number that is zero apart from rounding has one digit.

    Examples
    --------
    >>> number(141.42135623731), number(2.49959963777e-33), number(70000.0)
    ('141.421', '2e-33', '70000')
    """
    value = float(value)
    return f'{value:.1g}' if 0 < abs(value) < ROUNDING else f'{value:.{digits}g}'


def apart_in_words(difference, relative=True):
    """Words for the distance of a number from its reference, relative, or absolute if the reference is zero.

    Examples
    --------
    >>> apart_in_words(0.0), apart_in_words(3e-10), apart_in_words(0.0123), apart_in_words(2e-15, relative=False)
    ('equal', 'equal to 9 digits', '1.2 % off', 'zero to rounding')
    """
    if not math.isfinite(difference):
        return 'not a number'
    if difference == 0:
        return 'equal' if relative else 'zero'
    if not relative:
        return 'zero to rounding' if difference < ROUNDING else f'{difference:.2g} from zero'
    if difference < 1e-3:
        return f'equal to {min(math.floor(-math.log10(difference)), 15)} digits'
    return f'{_percent(difference)} off' if difference < 2 else f'{difference:.2g} times off'


def bound_in_words(tolerance, relative=True):
    """A tolerance as text: `bound_in_words(0.05)` is '5 %', `bound_in_words(1e-9)` is '1e-9'."""
    if relative and tolerance >= 1e-3:
        return _percent(tolerance)
    return f'{tolerance:.2g}' if tolerance >= 1e-3 or not tolerance else f'{tolerance:.0e}'.replace('e-0', 'e-')


def _percent(share):
    return f'{100 * share:.2g} %' if share < 0.995 else f'{100 * share:.0f} %'


@dataclass(frozen=True)
class Check:
    """A quantity as computed here, its reference and the tolerance between them.

    Attributes
    ----------
    quantity : str
        What it is, with its unit.
    here, reference : float
    tolerance : float
        Largest difference allowed, relative to the reference, or absolute where that is zero.
    control : str
        Name of the wrong model that gave `here`, which must differ by more than the tolerance: 'D0', or another. Empty for a
        number that must agree.
    by : str
        By whom the reference is: one of SOURCES, and after a colon where it stands.
    """

    quantity: str
    here: float
    reference: float
    tolerance: float
    control: str = ''
    by: str = 'closed form'

    def __post_init__(self):
        if self.source not in SOURCES:
            raise ValueError(f'{self.quantity}: the reference is by {self.source!r}, which is none of {", ".join(SOURCES)}')

    @property
    def source(self):
        """By whom the reference is: one of SOURCES."""
        return self.by.partition(':')[0]

    @property
    def kind(self):
        """'control', or by whom the reference is."""
        return 'control' if self.control else self.source

    @property
    def difference(self):
        """Distance of the number from the reference, relative unless the reference is zero."""
        return float(abs(self.here - self.reference) / (abs(self.reference) or 1.0))

    @property
    def passed(self):
        """Whether the number agrees with its reference; for a control, whether it clearly differs."""
        apart, bound = self.difference, self.tolerance  # a NaN passes neither comparison
        return bool(apart > bound if self.control else apart <= bound)

    def against(self, wrong, control='D0'):
        """The control of this row: the number that a wrong model gives for it, which must differ from the reference."""
        model = 'D0 alone' if control == 'D0' else control
        return replace(self, quantity=f'control: {model}, {self.quantity}', here=float(wrong), control=control)

    @property
    def cells(self):
        """The row of the table, as texts."""
        relative = self.reference != 0
        bound = bound_in_words(self.tolerance, relative)
        bound = f'more than {bound}' if self.control else f'at most {bound}' if self.tolerance else 'no difference'
        agrees = 'differs, as it must' if self.control else 'pass'
        return (self.quantity, number(self.here, 6 if relative else 3), number(self.reference), self.by,
                apart_in_words(self.difference, relative), bound, agrees if self.passed else 'FAIL')


@dataclass(frozen=True)
class Reported:
    """A quantity without an independent reference, which nothing tests; `beside` is a number to compare it with."""

    quantity: str
    here: float
    beside: float | None = None
    kind = 'reported'
    passed = True

    @property
    def cells(self):
        """The row of the table, as texts."""
        return self.quantity, number(self.here, 4), '' if self.beside is None else number(self.beside), '', '', '', 'reported'


class Picture(NamedTuple):
    """A picture as a file of pixels, with its caption; a PDF for print lies in the same folder."""

    file: Path
    caption: str


@dataclass(frozen=True)
class Outcome:
    """What a workflow found: its rows and its pictures."""

    checks: list[Check | Reported]
    pictures: list[Picture] = field(default_factory=list)


def pairs(quantity, here, reference, tolerance, of, by='closed form'):
    """One check for each pair of entries of two sequences; the checks are named by `of`."""
    return [Check(f'{quantity}, {name}', float(a), float(b), tolerance, by=by)
            for name, a, b in zip(of, here, reference, strict=True)]


def save_picture(figure, path, caption):
    """Write a figure as PNG for screens and as PDF for print, its caption within; returns the entry for `Outcome.pictures`."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.backends.backend_pdf import FigureCanvasPdf

    figure.dpi = DPI
    lay_out(figure)
    with whole_file(path, 'wb') as file:
        FigureCanvasAgg(figure).print_png(file, metadata={'Description': caption}, pil_kwargs={'compress_level': 3})
    with whole_file(path.with_suffix('.pdf'), 'wb') as file:
        FigureCanvasPdf(figure).print_pdf(file, metadata={'Subject': caption, 'CreationDate': None})
    return Picture(path, caption)
