"""The quantities that a sweep can compute for a scene: each has a name, a unit and a function of the scene.

Frequencies are computed for stable lattices only, because a lattice that buckles leaves the positions about which it would
vibrate.  Quantities that show where a lattice buckles are computed for unstable lattices too.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple
from warnings import warn

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..bands.bloch import bloch_modes
from ..errors import PhysicsError, did_you_mean, one_of, shown, whole
from ..response.frf import receptance
from ..scenes.fields import UNITS, unit_of
from ..scenes.scene import Scene, parts_of, scene_of
from ..stability.amplitude_shifts import frequency_shifts
from ..stability.buckling import common_spring, critical_foundation, critical_spacing, softest_of
from ..stability.verdicts import LINEAR_ERROR, Verdict, verdict

BORDER = 1e-9
"""Fraction of the needed foundation within which a lattice is on the border of buckling, its softest frequency round-off."""

REFUSALS = ValueError, ArithmeticError, MemoryError
"""Errors that mean that a point has no answer; any other error is a mistake in a program, and ends the sweep."""
INSTEAD = {'force_N': 'b_N_m_a', 'b_N_m_a': 'force_N'}
"""Keys of a law that replace each other: an axis of one takes the place of the other in the scene."""
FORCES_ALIKE = 1.01
"""Largest ratio of two forces in a sweep over the exponent."""


@dataclass(frozen=True)
class Situation:
    """A scene, with intermediate results that several questions share."""

    scene: Scene

    @cached_property
    def atoms(self) -> Atoms:
        """The cell, or the finite structure at rest with its defects."""
        return self.scene.atoms() if self.scene.finite else self.scene.perfect_cell()

    @cached_property
    def needed(self) -> float:
        """Smallest foundation stiffness with which the lattice is stable, N/mm."""
        return critical_foundation(self.atoms, 'complete')[0]

    @property
    def margin(self) -> float:
        """Excess of the foundation over the stiffness that the lattice needs, N/mm."""
        return common_spring(self.atoms) - self.needed

    @cached_property
    def judged(self) -> tuple[Verdict, ...]:
        """The verdicts of `magphonon check` on the lattice, and on the patch if it has defects or disorder."""
        imperfect = not self.scene.finite and self.scene.relaxation()
        return tuple(map(verdict, (self.atoms, *((imperfect.atoms,) if imperfect else ()))))

    def bands(self, q: ArrayLike) -> NDArray[np.float64]:
        """Frequencies of the perfect lattice at wavevectors in Hz, shape (wavevectors, branches)."""
        if beyond := self.scene.wanted('bands').beyond:
            raise ValueError(f'{beyond}: sweeps compute bands without damping or temperature; remove it')
        self.refuse_buckling()
        return u.hertz(bloch_modes(self.atoms, q)[0])

    @cached_property
    def along_path(self) -> NDArray[np.float64]:
        """Frequencies along the path of [bands] in Hz, shape (wavevectors, branches)."""
        return self.bands(self.scene.band_path().kpts)

    @cached_property
    def peak(self) -> tuple[float, float]:
        """Frequency in Hz and amplitude in m/N of the highest response of [frf], among its frequencies."""
        plan = self.scene.wanted('frf')
        atoms, source, answer = self.scene.shaken()
        found = receptance(atoms, source, answer, plan.omega, plan.damping_of(atoms))
        amplitude = abs(found.response)
        return float(u.hertz(found.omega[amplitude.argmax()])), float(amplitude.max() / (u.m / u.N))

    def refuse_buckling(self) -> None:
        """Raise ValueError if the lattice buckles; with velocity-dependent forces, the verdict decides."""
        if np.any(self.atoms.calc.rate):  # pyright: ignore[reportOptionalMemberAccess, reportAttributeAccessIssue]  scenes attach one
            if not self.judged[0].stable:
                raise ValueError(f'the lattice buckles: {self.judged[0].finding("buckling").words}')
            return
        if self.margin < -BORDER * self.needed:
            needed, given = (k / (u.N / u.m) for k in (self.needed, common_spring(self.atoms)))
            raise ValueError(f'the lattice buckles: it needs a foundation of {needed:.4g} N/m and has {given:.4g} N/m')


def _frequency(situation: Situation, point: str, branch: str) -> float:
    return float(situation.bands(situation.scene.special_points[point][None])[0, int(branch) - 1])


def _gap(situation: Situation, branch: str) -> float:
    f, n = situation.along_path, int(branch)
    return float(f[:, n].min() - f[:, n - 1].max())


def _growth(situation: Situation) -> float:
    if situation.margin >= -BORDER * situation.needed:
        situation.scene.relaxation()  # refuses a patch that buckles by its defects: the rest about which it would grow is unknown
        return 0.0
    atoms = situation.atoms
    lowest = softest_of(atoms, 'complete', foundation=common_spring(atoms), weighted=True).lowest
    return float(np.sqrt(max(-lowest, 0.0)) * u.s)


def _faults(situation: Situation) -> float:
    try:
        return float(sum(len(each.faults) for each in situation.judged))
    except PhysicsError:  # the patch does not come to rest with its defects
        return 1.0


def _spacing(situation: Situation) -> float:
    scale = critical_spacing(situation.atoms, 'complete')
    if scale is None:
        raise ValueError('between a tenth and ten times the present spacing, the lattice neither begins nor ceases to buckle')
    return float(scale * situation.atoms.calc.bonds.lengths.min() / u.m)


def _amplitude(situation: Situation) -> float:
    situation.refuse_buckling()
    return float(frequency_shifts(situation.atoms).amplitude(LINEAR_ERROR) / u.m)


def _point_and_branch(scene: Scene, point: str, branch: str) -> None:
    _refuse_no_bands(scene)
    one_of('the point', point, tuple(scene.special_points))
    _branch(scene, branch, 0)


def _branch_below(scene: Scene, branch: str) -> None:
    _refuse_no_bands(scene)
    _branch(scene, branch, 1)


def _refuse_no_bands(scene):
    if scene.single or scene.finite:
        raise ValueError(f'{"the oscillator" if scene.single else "a finite structure"} has no bands; ask for frf.peak_Hz')


def _branch(scene, text, above):
    atoms = scene.perfect_cell()
    most = len(atoms) * atoms.calc.dim - above
    if whole('the branch', float(text) if text.isdecimal() else text) > most:
        raise ValueError(f'the branch must be at most {most}, not {text}')


class Question(NamedTuple):
    """A quantity that a sweep can compute: its unit, its meaning and its function of the scene."""

    unit: str
    meaning: str
    # from a Situation, and the words that stand for the capitals in its name, to a number in that unit
    answer: Callable[..., float]
    label: str  # for the axis of a picture, with {} for each of these words
    # from a Scene and these words; ValueError if no values of its numbers could give an answer
    check: Callable[..., None] = lambda scene, *words: None


QUESTIONS = {
    'bands.gap.BRANCH': Question('Hz', 'gap above a branch along the path of [bands], negative where branches overlap', _gap,
                                 'gap above branch {}', _branch_below),
    'bands.POINT.BRANCH': Question('Hz', 'frequency of a branch, counted from 1, at a special point', _frequency,
                                   'frequency at {}, branch {}', _point_and_branch),
    'stability.needed': Question('N/m', 'foundation that the perfect lattice needs',
                                 lambda situation: situation.needed / (u.N / u.m),
                                 'foundation needed'),
    'stability.margin': Question('N/m', 'foundation minus what the perfect lattice needs; negative where it buckles',
                                 lambda situation: situation.margin / (u.N / u.m), 'foundation minus what is needed'),
    'stability.growth': Question('1/s', 'rate of the fastest growing motion of the perfect lattice, zero where it and its '
                                 'defects are stable', _growth, 'growth rate'),
    'stability.spacing': Question('m', 'spacing at which the lattice just buckles', _spacing, 'spacing at buckling'),
    'linear.amplitude': Question('m', 'amplitude at which frequencies are 1 % off the linear ones', _amplitude,
                                 'amplitude for an error of 1 %'),
    'timestep.limit': Question('s', 'longest stable time step',
                               lambda situation: min(each.timestep_limit for each in situation.judged) / u.s,
                               'longest time step'),
    'verdict.faults': Question('1', 'number of faults that "magphonon check" finds, of the lattice and of its defects', _faults,
                               'faults'),
    'frf.peak_Hz': Question('Hz', 'frequency of the highest response of [frf]', lambda situation: situation.peak[0],
                            'frequency of the peak', lambda scene: scene.wanted('frf')),
    'frf.peak_m_per_N': Question('m/N', 'the highest response of [frf]', lambda situation: situation.peak[1], 'peak',
                                 lambda scene: scene.wanted('frf')),
}
"""Words in capitals stand for any word; the first matching question is used."""


def observables() -> dict[str, str]:
    """Every question with its unit and meaning, in words."""
    return {name: f'{question.meaning} ({question.unit})' for name, question in QUESTIONS.items()}


def question(name: str) -> tuple[Question, tuple[str, ...]]:
    """The question for a name such as 'bands.M.1', and its arguments, here 'M' and '1'."""
    words = name.split('.')
    for pattern, known in QUESTIONS.items():
        places = pattern.split('.')
        if len(places) == len(words) and all(place.isupper() or place == word for place, word in zip(places, words, strict=True)):
            return known, tuple(word for place, word in zip(places, words, strict=True) if place.isupper())
    raise ValueError(f'{name} is no question' + did_you_mean(name, QUESTIONS, f'the questions are {", ".join(QUESTIONS)}'))


@dataclass(frozen=True)
class SceneAnswers:
    """The answers to some questions about a scene, as a function of some of its keys; it can be sent to other processes.

    `tables` are the tables of the scene file. If the lattice comes from a file, `particles` are its particles, and `contents` is
    its checksum.
    """

    tables: dict[str, Any]
    asked: tuple[str, ...]
    particles: Atoms | None = None
    contents: str = ''

    @classmethod
    def of(cls, scene: Scene, over: Mapping[str, NDArray[np.float64]], asked: Sequence[str]) -> SceneAnswers:
        """The answers to the questions `asked` about a scene, as a function of the keys in `over`."""
        if not asked:
            raise ValueError("ask names no question; give at least one, such as ask=['bands.M.1']")
        tables = scene.model_dump(mode='json')
        for key in over:
            _refuse_unknown(tables, key)
        _warn_of_force(scene, over)
        for name in asked:
            known, words = question(name)
            try:
                known.check(scene, *words)
            except ValueError as error:
                raise ValueError(f'{name}: {error}') from None
        plain, particles = parts_of(scene)
        return cls(plain, tuple(asked), particles, str(tables['lattice'].get('contents', '')))

    @property
    def about(self) -> dict[str, Any]:
        """All that the answers depend on, as plain Python objects."""
        return {'title': self.tables['title'], 'scene': self.tables, 'particles': self.contents, 'ask': list(self.asked)}

    def attributes(self, over: Mapping[str, Any]) -> dict[str, dict[str, str]]:
        """Unit and label of each axis and each answer."""
        told = {key: {'units': unit_of(key), 'long_name': _label(key)} for key in over}
        for name in self.asked:
            known, words = question(name)
            told[name] = {'units': known.unit, 'long_name': known.label.format(*words)}
        return told

    def __call__(self, point: Mapping[str, float]) -> tuple[dict[str, float], str]:
        situation = Situation(scene_of(_replaced(self.tables, point), self.particles))
        values, faults = {}, []
        for name in self.asked:
            known, words = question(name)
            try:
                with np.errstate(over='raise', divide='raise', invalid='raise'):
                    values[name] = known.answer(situation, *words)
            except REFUSALS as error:
                faults.append(f'{name}: {error}' if len(self.asked) > 1 else str(error))
        return values, '; '.join(dict.fromkeys(faults))


LABELS = {'law.a': 'exponent a', 'law.force_N': 'force between neighbours', 'law.b_N_m_a': 'b'}


def _label(key):
    """The label of a key, such as 'pillar height' for foundation.pillar.height_m."""
    if key in LABELS:
        return LABELS[key]
    *_, table, name = ['', *key.split('.')]
    ends = [end for end in UNITS if name.endswith(end)]
    return f'{table} {name.removesuffix(ends[0]) if ends else name}'.replace('_', ' ').strip()


def _replaced(tables, point):
    made = dict(tables)
    for key, value in point.items():
        inner, (*outer, last) = made, key.split('.')
        for name in outer:
            inner[name] = dict(inner.get(name, {}))
            inner = inner[name]
        if last in INSTEAD and inner.get(last) is None:
            inner.pop(INSTEAD[last], None)
        inner[last] = value
    return made


def _warn_of_force(scene, over):
    """Warn if the exponent varies at constant b, because the forces then span decades, which is hardly intended."""
    law, spacing = scene.law, scene.lattice.spacing_m
    if 'law.a' not in over or {'law.b_N_m_a', 'law.force_N'} & over.keys() or getattr(law, 'b_N_m_a', None) is None:
        return
    forces = law.b_N_m_a * spacing ** -over['law.a']
    if forces.max() > FORCES_ALIKE * forces.min():
        warn(f'law.a varies at constant law.b_N_m_a, so the force between neighbours varies from {forces.min():.3g} to '
             f'{forces.max():.3g} N; to keep it constant, give law.force_N one value beside law.a, such as '
             f'law.force_N={law.b_N_m_a * spacing ** -law.a:.4g}, or in the scene in place of b_N_m_a', stacklevel=4)


def _refuse_unknown(tables, key):
    inner = tables
    for name in key.split('.'):
        if inner is None:  # an optional table that the scene does not have; the scene itself judges its keys
            return
        if not isinstance(inner, dict) or name not in inner:
            raise ValueError(f'the scene has no number {key}'
                             + did_you_mean(key, _numbers(tables), f'its numbers are {", ".join(_numbers(tables))}'))
        inner = inner[name]
    if inner is not None and (isinstance(inner, bool) or not isinstance(inner, int | float)):
        raise ValueError(f'{key} is {shown(inner)} in the scene; only single numbers can be swept over')


def _numbers(tables, before=''):
    found = []
    for name, value in tables.items():
        if isinstance(value, dict):
            found += _numbers(value, f'{before}{name}.')
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found.append(before + name)
    return found
