"""The quantities that a sweep can compute of a scene: each has a name, a unit and a function of the scene.

Frequencies are computed for stable lattices only, because a lattice that buckles leaves the positions about which it would
vibrate.  Quantities that show where it buckles are computed on both sides of the border.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from .. import units as u
from ..bands.bloch import bloch_modes
from ..errors import did_you_mean, one_of, whole
from ..response.frf import receptance
from ..stability.amplitude_shifts import frequency_shifts
from ..stability.buckling import common_spring, foundation_needed, softest_of, spacing_held
from ..stability.verdicts import LINEAR_ERROR, verdict
from ..stiffness.rest import LinearSystem

if TYPE_CHECKING:
    from collections.abc import Callable

    from ase import Atoms
    from numpy.typing import NDArray

    from ..scenes.scene import Scene

BORDER = 1e-9
"""Fraction of the needed foundation within which a lattice is on the border of buckling, its softest frequency round-off."""


@dataclass(frozen=True)
class Situation:
    """A scene, with intermediate results that several questions share."""

    scene: Scene

    @cached_property
    def atoms(self) -> Atoms:
        """The cell, or the finite structure at rest with its defects."""
        relaxation = self.scene.relaxation() if self.scene.finite else None
        return self.scene.atoms() if relaxation is None else relaxation.atoms

    @cached_property
    def needed(self) -> float:
        """Foundation that the lattice needs, N/mm."""
        return foundation_needed(self.atoms)[0]

    @property
    def margin(self) -> float:
        """Excess of the foundation over the stiffness that the lattice needs, N/mm."""
        return common_spring(self.atoms) - self.needed

    @cached_property
    def along_path(self) -> NDArray[np.float64]:
        """Frequencies along the path of [bands] in Hz, shape (wavevectors, branches)."""
        self.refuse_finite()
        self.refuse_buckling()
        return u.hertz(bloch_modes(self.atoms, self.scene.band_path().kpts)[0])

    @cached_property
    def peak(self) -> tuple[float, float]:
        """Frequency in Hz and amplitude in m/N of the highest response of [frf], among its frequencies."""
        plan = self.scene.wanted('frf')
        atoms, source, answer = self.scene.shaken()
        found = receptance(LinearSystem.of(atoms), source, answer, plan.omega, plan.damping)
        amplitude = abs(found.response)
        return float(u.hertz(found.omega[amplitude.argmax()])), float(amplitude.max() / (u.m / u.N))

    def refuse_finite(self) -> None:
        """Raise ValueError if the scene has no lattice."""
        if not self.atoms.pbc.any():
            raise ValueError('the structure is finite and has no bands; ask for frf.peak_Hz')

    def refuse_buckling(self) -> None:
        """Raise ValueError if the lattice buckles."""
        if self.margin < -BORDER * self.needed:
            needed, given = (k / (u.N / u.m) for k in (self.needed, common_spring(self.atoms)))
            raise ValueError(f'the lattice buckles: it needs a foundation of {needed:.4g} N/m and has {given:.4g} N/m')


def band_frequency(situation: Situation, point: str, branch: str) -> float:
    """Frequency of a branch at a special point, Hz."""
    situation.refuse_finite()
    points = situation.scene.special_points
    situation.refuse_buckling()
    omega = bloch_modes(situation.atoms, points[one_of('the point', point, tuple(points))][None])[0][0]
    return float(u.hertz(omega[_branch(branch, len(omega))]))


def band_gap(situation: Situation, branch: str) -> float:
    """From the top of a branch to the bottom of the next one along the path of [bands], Hz; negative where they overlap."""
    f = situation.along_path
    n = _branch(branch, f.shape[1] - 1)
    return float(f[:, n + 1].min() - f[:, n].max())


def _branch(text, count):
    n = whole('the branch', float(text) if text.isdecimal() else text)
    if n > count:
        raise ValueError(f'the branch must be at most {count}, not {n}')
    return n - 1


def _needed(situation: Situation) -> float:
    return situation.needed / (u.N / u.m)


def _margin(situation: Situation) -> float:
    return situation.margin / (u.N / u.m)


def _growth(situation: Situation) -> float:
    if situation.margin >= -BORDER * situation.needed:
        return 0.0
    atoms = situation.atoms
    lowest = softest_of(atoms, foundation=common_spring(atoms), weighted=True).lowest
    return float(np.sqrt(max(-lowest, 0.0)) * u.s)


def _spacing(situation: Situation) -> float:
    scale = spacing_held(situation.atoms)
    if scale is None:
        raise ValueError('no spacing from a tenth to ten times the present one is the border of buckling')
    return float(scale * situation.atoms.calc.bonds.lengths.min() / u.m)


def _amplitude(situation: Situation) -> float:
    situation.refuse_buckling()
    return float(frequency_shifts(situation.atoms).amplitude(LINEAR_ERROR) / u.m)


def _faults(situation: Situation) -> float:
    return float(len(verdict(situation.atoms).faults))


def _timestep(situation: Situation) -> float:
    return verdict(situation.atoms).timestep_limit / u.s


class Question(NamedTuple):
    """A question of the list.

    Attributes
    ----------
    unit : str
    meaning : str
    answer : callable
        From a Situation, and the words that stand for the capitals in its name, to a number in that unit.
    """

    unit: str
    meaning: str
    answer: Callable[..., float]


QUESTIONS = {
    'bands.gap.BRANCH': Question('Hz', 'gap above a branch along the path of [bands], negative where branches overlap', band_gap),
    'bands.POINT.BRANCH': Question('Hz', 'frequency of a branch at a special point, counted from 1', band_frequency),
    'stability.needed': Question('N/m', 'foundation that the lattice needs', _needed),
    'stability.margin': Question('N/m', 'foundation less what the lattice needs; negative where it buckles', _margin),
    'stability.growth': Question('1/s', 'rate of the fastest growing motion, zero where it is stable', _growth),
    'stability.spacing': Question('m', 'spacing at which it begins or ceases to buckle', _spacing),
    'linear.amplitude': Question('m', 'amplitude at which frequencies are 1 % off the linear ones', _amplitude),
    'timestep.limit': Question('s', 'longest stable time step', _timestep),
    'verdict.faults': Question('1', 'number of faults that "magphonon check" finds in the lattice', _faults),
    'frf.peak_Hz': Question('Hz', 'frequency of the highest response of [frf]', lambda situation: situation.peak[0]),
    'frf.peak_m_per_N': Question('m/N', 'the highest response of [frf]', lambda situation: situation.peak[1]),
}
"""Words in capitals stand for any word; what comes first in the list counts."""


def known_questions() -> dict[str, str]:
    """Every question with its unit and meaning, in words."""
    return {name: f'{question.meaning} ({question.unit})' for name, question in QUESTIONS.items()}


def question(name: str) -> tuple[Question, tuple[str, ...]]:
    """The question of a name such as 'bands.M.1', and the words in it, here 'M' and '1'.

    Raises
    ------
    ValueError
        If there is none of this name.
    """
    words = name.split('.')
    for pattern, known in QUESTIONS.items():
        places = pattern.split('.')
        if len(places) == len(words) and all(place.isupper() or place == word for place, word in zip(places, words, strict=True)):
            return known, tuple(word for place, word in zip(places, words, strict=True) if place.isupper())
    raise ValueError(f'{name} is no question' + did_you_mean(name, QUESTIONS, f'the questions are {", ".join(QUESTIONS)}'))
