"""How the neighbours that a scene omits would change its frequencies, in a line with the largest shift."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..bands.bands import points_on
from ..bands.neighbours import NeighbourShifts, neighbour_shifts
from ..scenes.laws import TOLERANCE, SavedLaw
from ..scenes.scene import MOST_IN_A_CELL, Scene
from ..scenes.sources import ready_scenes
from ..scenes.structures import FileLattice

ASSUMED = ', if the forces keep falling as they do at the end of the table'
"""What is added where the law is not known at all distances that were needed."""


class Shift(NamedTuple):
    """The largest relative shift of a branch at a point by the omitted neighbours, in numbers and in words."""

    relative: float
    point: str
    branch: int  # counted from 1
    place: str
    size: str


def omission(scene: Scene, verbose: bool, points: Mapping[str, ArrayLike] | None = None) -> list[str]:
    """A line with the largest shift by omitted neighbours, if any matters; of ready scenes, which state the omission themselves,
    only if `verbose`.

    `points` are wavevectors in fractions of the reciprocal vectors: one for each name, or several under one name, for which the
    largest shift is given; by default the special points of the bands.
    """
    if (scene._name in ready_scenes() and not verbose) or not _comparable(scene):
        return []
    shifts, known = _shifts(scene, special_points(scene) if points is None else points)
    if not shifts:
        return []
    most = max(shifts, key=lambda shift: abs(shift.relative))
    advice = (' Measure the force at larger distances, or give the shape of the magnets.' if not known else
              ' Omit law.shells to count as many shells as matter.' if isinstance(scene.law.asked, int) else '')
    return [f'{_counted(scene)}: farther ones would shift {most.place} by {most.size}{"" if known else ASSUMED}.{advice}']


def chosen(scene: Scene) -> str:
    """How many neighbours count, as a sentence with a space before it; empty if the scene says the number itself."""
    return f' {_counted(scene)}.' if not isinstance(scene.law.asked, int) and _comparable(scene) else ''


def too_few(scene: Scene, points: Mapping[str, ArrayLike], within: Mapping[tuple[str, int], float]) -> list[str]:
    """A line that names the shifts by omitted neighbours that exceed `within`, if there are any.

    `within` has half widths of 95 % intervals, as fractions of the frequencies, by point and branch (counted from 1).
    """
    shifts = _shifts(scene, points)[0] if _comparable(scene) else []
    exceeding = [shift.place for shift in shifts if abs(shift.relative) > within.get((shift.point, shift.branch), np.inf)]
    few = 'Nearest neighbours' if scene.law.shells == 1 else 'So few neighbours'
    return [f'{few} are not enough here: farther ones shift {" and ".join(exceeding)} by more than the 95 % interval.'
            ] if exceeding else []


def _comparable(scene):
    """Whether the frequencies with all neighbours can be computed, and the scene can choose how many count."""
    lattice = scene.lattice
    if scene.single or scene.finite or isinstance(scene.law, SavedLaw):
        return False
    cell = scene.perfect_cell()
    return cell.calc.pairwise and not (isinstance(lattice, FileLattice) and len(cell) > MOST_IN_A_CELL)


def _counted(scene):
    """Which neighbours the scene counts, in words."""
    law, lattice = scene.law, scene.lattice  # a lattice from a file may have a cutoff
    if lattice.cutoff is not None:
        reach = f'Neighbours within {lattice.cutoff / 1e3:.4g} m count'
        return reach if getattr(lattice, 'cutoff_m', None) is not None else f'{reach} (shells = "{law.asked}")'
    number = 'Nearest neighbours only' if law.shells == 1 else f'{law.shells} shells of neighbours'
    asked = law.asked if isinstance(law.asked, int) else f'"{law.asked}"'
    return f'{number} (shells = {asked})'


def _shifts(scene, points):
    """The shifts of branches at points that exceed the accuracy to which real lattices are known, and whether the law is known at
    all distances that were needed.
    """
    cell, shifts, first = scene.perfect_cell(), [], 0
    waves = {name: np.reshape(np.asarray(several, dtype=float), (-1, 3)) for name, several in points.items()}
    found = neighbour_shifts(cell, np.concatenate(list(waves.values())))
    if scene.foundation is not None:  # heavy pillars lower both
        omega, every = (scene.foundation.slowed(each, cell.get_masses()) for each in (found.omega, found.every))
        found = NeighbourShifts(omega, every, found.known)
    branch = 'branch in the plane' if cell.calc.layer else 'branch'
    for name, several in waves.items():
        here = slice(first, first + len(several))
        first += len(several)
        relative = found.relative[here]
        for k, x in enumerate(relative[abs(relative).argmax(axis=0), range(relative.shape[1])]):
            if abs(x) > TOLERANCE:
                size = (f'{100 * x:+.2g} % to {u.hertz(found.every[here][0, k]):.4g} Hz' if len(several) == 1 else
                        f'up to {100 * x:+.2g} %')
                shifts.append(Shift(x, name, k + 1, f'{branch} {k + 1} at {name}', size))
    return shifts, found.known


def special_points(scene: Scene) -> dict[str, NDArray[np.float64]]:
    """Special points on the path of the scene's bands, or else of its lattice, by name."""
    lattice: Any = scene.lattice
    return points_on(lattice.path(scene.bands.path if scene.bands is not None else None, 0))
