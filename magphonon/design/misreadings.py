"""What may be wrong with a file of transfer functions: its unit, the sign of its phase, what was measured.

The peaks of the assumed lattice and the measured ones are never at quite the same frequencies, so the curves differ. Therefore
the peaks of both are widened to a ninth of the range. What then remains of a curve is its size, its phase, and their trend with
frequency. A wrong unit changes these by far more than an error of ten percent in the lattice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from .. import units as u
from ..response.transfer_functions import TransferFunction
from .transfer_fits import WIDEST, ParametricLattice, solved, with_wide_peaks

STRETCHES = 0.88, 0.94, 1.0, 1.06, 1.13  # factors of all frequencies that are tried, as the lattice is not known exactly
CLOSE, BETTER, NEAR = 0.1, 0.5, 1.0
"""A mistake is named only if the data are farther than CLOSE from the response of the lattice, as a fraction of it, and if
undoing the mistake leaves less than the part BETTER of that distance, and less than NEAR."""
SCALES = {f'numbers {factor:g} times too {word}': factor**sign for factor, unit in ((1e3, 'mm'), (1e6, 'um'))
          for sign, word in ((-1, f'large, {unit} under a header in m'), (1, f'small, m under a header in {unit}'))}
WORDS = {-2: 'an acceleration that is called a displacement', -1: 'a velocity that is called a displacement, or an acceleration '
         'that is called a velocity', 1: 'a displacement that is called a velocity, or a velocity that is called an acceleration',
         2: 'a displacement that is called an acceleration'}

SLOW = 'frequencies in rad/s under a header in Hz'


def misreading(built: ParametricLattice, functions: Sequence[TransferFunction]) -> str | None:
    """What transfer functions seem to be, if this is not what their file says; None if no misreading fits better.

    The lattice `built` is known to about ten percent. The functions have their Dofs, and were all read in the same way.
    """
    off = dict.fromkeys(readings := _readings(functions), np.inf)
    wide = {words: np.concatenate([_wide(one) for one in own]) for words, own in readings.items()}
    for stretch in STRETCHES:
        at = {words: _computed(built, readings[words], stretch) for words in (None, SLOW)}
        for words in readings:  # all but one have the frequencies of the first
            computed = at[SLOW if words == SLOW else None]
            size = np.sqrt(np.linalg.norm(wide[words]) * np.linalg.norm(computed))
            off[words] = min(off[words], np.linalg.norm(wide[words] - computed) / size)
    best = min(off, key=lambda words: off[words])
    return best if off[None] > CLOSE and off[best] < min(BETTER * off[None], NEAR) else None


def _readings(functions):
    """The functions as they are, by None, and with each mistake undone, by its words."""
    undone = {'phases of the opposite sign, e^{-i omega t}': lambda w, h: h.conj(),
              'real and imaginary part exchanged': lambda w, h: 1j * h.conj(),
              'phases in rad under a header in degrees': lambda w, h: abs(h) * np.exp(1j * np.angle(h) / u.deg)}
    if not any(one.shaken for one in functions):
        undone |= {words: lambda w, h, factor=factor: factor * h for words, factor in SCALES.items()}
        undone |= {words: lambda w, h, order=order: (1j * w * u.s) ** order * h for order, words in WORDS.items()}
    mended = {words: [replace(one, response=mend(one.omega, one.response)) for one in functions]
              for words, mend in undone.items()}
    return {None: functions} | mended | {SLOW: [replace(one, omega=one.omega / (2 * np.pi)) for one in functions]}


def _computed(built, functions, stretch):
    """Responses, with wide peaks, of a lattice whose frequencies are `stretch` times as high."""
    there = [replace(one, omega=one.omega / stretch) for one in functions]
    found = solved(built, there)[1]
    return np.concatenate([_wide(replace(one, response=own.h / stretch**2)) for one, own in zip(functions, found, strict=True)])


def _wide(one):
    return with_wide_peaks(one, np.ptp(one.omega) / WIDEST).response
