"""What the paper claims, and the rows of the workflows that judge it."""

from dataclasses import dataclass
from typing import NamedTuple

from .checks import Check
from .digits import number


@dataclass(frozen=True)
class Claim:
    """A claim of the paper.

    Attributes
    ----------
    words : str
    workflow, quantity : str
        The row that judges it.
    source : str
        Of its reference, in the paper or outside.
    unit : str
        Of the number.
    without : str
        The row in the same workflow that tells what a model without D* says; empty where there is none.
    """

    words: str
    workflow: str
    quantity: str
    source: str
    unit: str = ''
    without: str = ''


class Judged(NamedTuple):
    """A claim as a row of texts."""

    words: str
    here: str
    reference: str
    without: str
    verdict: str
    source: str


SHEAR_AT_M = 'M shear in time at an amplitude of 1e-10 L0'
CLAIMS = (
    Claim('The static force makes the oscillator unstable above an angle', 'oscillator', 'oscillator critical angle (deg)',
          'Sec. III: cos² θ₀ = 3/(2(a + 1))', '°'),
    Claim('D* lowers its vertical frequency at 0°', 'oscillator', 'oscillator omega_y (rad/s), theta0 = 0 deg',
          'Sec. III, Eq. 4', 'rad/s', 'oscillator omega_y, D0 alone (rad/s), theta0 = 0 deg'),
    Claim('Driven, it resonates there', 'frf', 'frf peak (rad/s), theta0 = 0 deg', 'Fig. 2: √(D_yy/M)', 'rad/s'),
    Claim('In a chain D* has no longitudinal part (misfit of ω²)', 'chain',
          'chain longitudinal omega^2, D0 alone, largest misfit / top', 'closed form of a chain of springs'),
    Claim('In the triangular lattice D* halves the shear branch at M', 'ideal_bands', 'ideal M, complete (rad/s), shear',
          'Fig. 4: √((2a - 6)f/(L₀M))', 'rad/s', 'ideal M, conventional (rad/s), shear'),
    Claim('and hardly moves the longitudinal one', 'ideal_bands', 'ideal M, complete (rad/s), longitudinal',
          'Fig. 4: √((6a - 2)f/(L₀M))', 'rad/s', 'ideal M, conventional (rad/s), longitudinal'),
    Claim('Without static force both models are one (shear at M over that of springs)', 'claims',
          "springs without static force (phi' = 0), M, complete model, shear", 'springs of their own length: √(2k/M)'),
    Claim('It is no matter of amplitude: shear at M over that of D⁰, at 1e-10 L₀', 'claims',
          f'{SHEAR_AT_M}, complete / D0 alone', 'Sec. IV: √((2a - 6)/(2a))'),
    Claim('A burst of shear travels on the branch of D⁰ + D* (bins off it)', 'bursts',
          'transverse burst, complete simulation: ridge off its own branch (bins)', 'Fig. 6: Eq. 18', 'bins',
          'control: transverse burst, complete simulation: ridge off the conventional branch (bins)'),
    Claim('The pillars of the prototype open a gap below', 'prototype_bands', 'prototype cut-off, complete (Hz), shear',
          'Supplement: 3EI/H³', 'Hz', 'prototype cut-off, conventional (Hz), shear'),
    Claim('Its shear branch at M', 'prototype_bands', 'prototype M, complete (Hz), shear', 'Fig. S4, Supplement', 'Hz',
          'prototype M, conventional (Hz), shear'),
    Claim('A vibrometer sees the shear branch of D⁰ + D* (60 Hz, bins off it)', 'vibrometer',
          'vibrometer 60 Hz, complete simulation: ridge off its own shear branch, Gamma-K (bins)', 'Fig. 8: Eq. 18', 'bins',
          'control: vibrometer 60 Hz, complete simulation: ridge off the conventional shear branch (bins)'),
    Claim('The printed ring weighs what is printed', 'magnets', 'ring: mass at 7.5 g/cm3 (g)', 'Sec. IV C, Supplement', 'g'),
    Claim('and repels as the printed law says (force at 10 mm over the printed one)', 'magnets',
          'force at 10 mm, computed / fitted: not explained', 'Fig. S3, Supplement'),
)


def judged(outcomes):
    """The claims that these outcomes judge, a list of Judged.

    Raises
    ------
    KeyError
        If a workflow ran and has no such row.
    """
    return [_judged(claim, {row.quantity: row for row in outcomes[claim.workflow].checks})
            for claim in CLAIMS if claim.workflow in outcomes]


def _judged(claim, rows):
    row = rows[claim.quantity]
    _, here, reference, *_ = row.cells
    verdict = ('holds' if row.passed else 'fails') if isinstance(row, Check) else 'not reproduced'
    without = number(rows[claim.without].here, 4) if claim.without else ''
    here, reference, without = (f'{text}{"" if claim.unit == "°" else " "}{claim.unit}'.strip() if text else ''
                                for text in (here, reference, without))
    return Judged(claim.words, here, reference, without, verdict, claim.source)
