"""A scene as a function of some of its keys, which can be sent to other processes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import did_you_mean, shown
from ..scenes.scene import parts_of, scene_of
from .evaluation import Answer, refusals
from .questions import Situation, question

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Any

    from ase import Atoms

    from ..scenes.scene import Scene


@dataclass(frozen=True)
class SceneAnswers:
    """The answers to some questions about a scene, as a function of some of its keys.

    Attributes
    ----------
    tables : dict
        The scene as its file has it, in plain Python.
    asked : tuple of str
        Names of questions.
    particles : ase.Atoms, optional
        Particles of the scene, if its lattice is a file.
    contents : str
        The checksum of that file.
    """

    tables: dict[str, Any]
    asked: tuple[str, ...]
    particles: Atoms | None = None
    contents: str = ''

    @classmethod
    def of(cls, scene: Scene, over: Iterable[str], asked: Sequence[str]) -> SceneAnswers:
        """The function for a scene.

        Raises
        ------
        ValueError
            For a key that the scene does not have or whose value is no number, or a question that is not known.
        """
        if not asked:
            raise ValueError("ask names no question; give at least one, such as ask=['bands.M.1']")
        for name in asked:
            question(name)
        tables = scene.model_dump(mode='json')
        for key in over:
            _refuse_unknown(tables, key)
        plain, particles = parts_of(scene)
        return cls(plain, tuple(asked), particles, str(tables['lattice'].get('contents', '')))

    @property
    def identity(self) -> list[Any]:
        """All that the answers depend on, as plain Python objects; its checksum identifies the sweep."""
        return [self.tables, self.contents, list(self.asked)]

    @property
    def units(self) -> dict[str, str]:
        """The unit of each answer."""
        return {name: question(name)[0].unit for name in self.asked}

    def __call__(self, **point: float) -> Answer:
        """The answers at one point, by the dotted keys of the scene.

        Raises
        ------
        ValueError
            If there is no such scene, as with a law that decays too slowly for its shells.
        """
        situation = Situation(scene_of(_replaced(self.tables, point), self.particles))
        values, faults = {}, []
        for name in self.asked:
            known, words = question(name)
            try:
                with np.errstate(over='raise', divide='raise', invalid='raise'):
                    values[name] = known.answer(situation, *words)
            except refusals() as error:
                faults.append(f'{name}: {error}' if len(self.asked) > 1 else str(error))
        return Answer(values, '; '.join(dict.fromkeys(faults)))


def _replaced(tables, point):
    """The tables with the values of a point in their places; the rest is shared."""
    made = dict(tables)
    for key, value in point.items():
        inner, (*outer, last) = made, key.split('.')
        for name in outer:
            inner[name] = dict(inner.get(name, {}))
            inner = inner[name]
        inner[last] = value
    return made


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
