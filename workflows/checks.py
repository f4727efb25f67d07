"""A number beside its reference, and what a workflow hands back."""

from dataclasses import dataclass, field

from magphonon.files import whole_file

DPI = 150
"""Pixels per inch of the pictures."""


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
        True where the package computed the reference too, by another road: such a row shows that two roads agree, and
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
        bound = f'{"> " if self.control else "<= "}{self.tolerance:.0e}'
        agrees = {'control': 'differs, as it must', 'consistency': 'consistent', 'reproduction': 'pass'}[self.kind]
        verdict = agrees if self.passed else 'FAIL'
        return self.quantity, f'{self.here:.12g}', f'{self.reference:.12g}', f'{self.difference:.1e}', bound, verdict


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
        return self.quantity, f'{self.here:.6g}', '' if self.beside is None else f'{self.beside:.6g}', '', '', 'reported'


@dataclass(frozen=True)
class Outcome:
    """What a workflow found: its checks, and its pictures as (file, caption)."""

    checks: list[Check | Reported]
    pictures: list[tuple] = field(default_factory=list)


def save_picture(figure, path, caption):
    """Write a figure whole; returns the entry for `Outcome.pictures`."""
    with whole_file(path, 'wb') as file:
        figure.savefig(file, format='png', dpi=DPI, bbox_inches='tight')
    return path, caption


def pairs(quantity, here, reference, tolerance, control=False):
    """One check for each entry of two sequences."""
    return [Check(f'{quantity} [{k}]', float(a), float(b), tolerance, control)
            for k, (a, b) in enumerate(zip(here, reference, strict=True))]
