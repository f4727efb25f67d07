"""How the neighbours that a scene omits would change its frequencies, in words, for each branch at given points.

`check`, fits, designs and tolerances list the shifts in full. The other commands print a line with the largest one if it matters.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..bands.bands import points_on, sound_speeds
from ..bands.neighbours import neighbour_shifts, with_all
from ..scenes.laws import TOLERANCE, SavedLaw
from ..scenes.scene import MOST_IN_A_CELL, Scene
from ..scenes.sources import ready_scenes
from ..scenes.structures import FileLattice

MOST_SHOWN = 6
"""Number of shifts that are listed one by one, the largest ones."""
ASSUMED = ', if the forces keep falling as they do at the end of the table'
"""What is added where the law is not known at all distances that were needed."""


class Shift(NamedTuple):
    """The largest relative shift of a branch at a point by the omitted neighbours, in numbers and in words."""

    relative: float
    point: str
    branch: int  # counted from 1
    place: str
    size: str


def neighbours(scene: Scene, points: Mapping[str, ArrayLike] | None = None, *,
               within: Mapping[tuple[str, int], float] | None = None) -> list[str]:
    """A line that says how many neighbours are counted and how all of them would change the frequencies; no line if a scene
    cannot choose their number.

    `points` are wavevectors in fractions of the reciprocal vectors: one for each name, or several under one name, for which the
    largest shift is given; by default the special points of the bands. `within` has half widths of 95 % intervals, as fractions
    of the frequencies, by point and branch (counted from 1). Shifts that exceed them are named.
    """
    if scene.single or isinstance(scene.law, SavedLaw):
        return []
    counted = _counted(scene)
    if (unknown := _unknown(scene)) is not None:
        return [counted + unknown]
    points = special_points(scene) if points is None else points
    shifts, known = _shifts(scene, points)
    counted, end = f'{counted}: farther ones would shift', '' if known else ASSUMED
    if not shifts:
        return [f'{counted} no frequency at {", ".join(points)} by more than {100 * TOLERANCE:g} %{end}.']
    said = [f'{counted} {_listed(shifts)}{end}.', *_too_few(scene, shifts, within or {})]
    if not known:
        said.append('Measure the force at larger distances, or give the shape of the magnets.')
    elif isinstance(scene.law.asked, int):
        said.append('Omit law.shells, or write shells = "auto", to count as many shells as matter.')
    return [' '.join(said)]


def omission(scene: Scene, verbose: bool, points: Mapping[str, ArrayLike] | None = None) -> list[str]:
    """A line with the largest shift by omitted neighbours, if any matters; of ready scenes, which state the omission themselves,
    only if `verbose`.
    """
    if (scene._name in ready_scenes() and not verbose) or not _comparable(scene):
        return []
    shifts, known = _shifts(scene, special_points(scene) if points is None else points)
    if not shifts:
        return []
    most, end = max(shifts, key=lambda shift: abs(shift.relative)), '' if known else ASSUMED
    return [f'{_counted(scene)}: farther ones would shift {most.place} by {most.size}{end}. "magphonon check --verbose" names '
            'all shifts.']


def too_few(scene: Scene, points: Mapping[str, ArrayLike], within: Mapping[tuple[str, int], float]) -> list[str]:
    """A line that names the shifts by omitted neighbours that exceed the intervals `within` (see `neighbours`), if there are
    any.
    """
    return _too_few(scene, _shifts(scene, points)[0], within) if _comparable(scene) else []


def _comparable(scene):
    """Whether the frequencies with all neighbours can be computed, and the scene can choose how many count."""
    return not scene.single and not isinstance(scene.law, SavedLaw) and _unknown(scene) is None


def _counted(scene):
    """Which neighbours the scene counts, in words."""
    law, lattice = scene.law, scene.lattice  # a lattice from a file may have a cutoff
    if lattice.cutoff is not None:
        reach = f'Neighbours within {lattice.cutoff / 1e3:.4g} m count'
        return reach if getattr(lattice, 'cutoff_m', None) is not None else f'{reach} (shells = "{law.asked}")'
    if law.shells == 'all':
        return f'All neighbours count (shells = "{law.asked}")'
    number = 'Nearest neighbours only' if law.shells == 1 else f'{law.shells} shells of neighbours'
    asked = law.asked if isinstance(law.asked, int) else f'"{law.asked}"'
    return f'{number} (shells = {asked})'


def _unknown(scene):
    """The end of a sentence that says why shifts are not known; None if they are known."""
    lattice = scene.lattice
    if scene.finite:
        chosen = lattice.cutoff_m is None and not isinstance(scene.law.asked, int)
        return '.' if chosen else '. Omit law.shells and lattice.cutoff_m to count all pairs.'
    cell = scene.perfect_cell()
    if not cell.calc.pairwise:
        return '.'
    large = isinstance(lattice, FileLattice) and len(cell) > MOST_IN_A_CELL
    return '; the effect of farther ones is not computed for so large a cell.' if large else None


def _shifts(scene, points):
    """The shifts of branches at points that exceed the accuracy to which real lattices are known, and whether the law is known at
    all distances that were needed.
    """
    cell, shifts, first = scene.perfect_cell(), [], 0
    waves = {name: np.reshape(np.asarray(several, dtype=float), (-1, 3)) for name, several in points.items()}
    found = neighbour_shifts(cell, np.concatenate(list(waves.values())))
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


def _listed(shifts):
    """The largest shifts one by one, and a bound of the others."""
    least = sorted((abs(shift.relative) for shift in shifts), reverse=True)[:MOST_SHOWN][-1]
    shown = [f'{shift.place} by {shift.size}' for shift in shifts if abs(shift.relative) >= least]
    others = max((abs(shift.relative) for shift in shifts if abs(shift.relative) < least), default=0.0)
    return '; '.join([*shown, *([f'other branches by up to {100 * others:.2g} %'] if others else [])])


def _too_few(scene, shifts, within):
    exceeding = [shift.place for shift in shifts if abs(shift.relative) > within.get((shift.point, shift.branch), np.inf)]
    few = 'Nearest neighbours' if scene.law.shells == 1 else 'So few neighbours'
    return [f'{few} are not enough here: farther ones shift {" and ".join(exceeding)} by more than the 95 % interval.'
            ] if exceeding else []


def special_points(scene: Scene) -> dict[str, NDArray[np.float64]]:
    """Special points on the path of the scene's bands, or else of its lattice, by name."""
    lattice: Any = scene.lattice
    return points_on(lattice.path(scene.bands.path if scene.bands is not None else None, 0))


def speeds(scene: Scene) -> str | None:
    """How all neighbours would change the speeds of long waves along x, which need many more neighbours than frequencies do."""
    atoms: Any = scene.perfect_cell()
    if not _comparable(scene) or atoms.calc.layer or atoms.constraints:
        return None
    every, known = with_all(atoms)
    if every is None or not known:
        return None
    few, all_ = sound_speeds(atoms), sound_speeds(every)
    shifts = (all_ - few) / np.where(few == 0, np.nan, abs(few))
    if not (abs(shifts) > TOLERANCE).any():
        return None
    told = ', '.join(f'the speed of branch {k + 1} from {a:.4g} to {c:.4g} m/s'
                     for k, (a, c) in enumerate(zip(few, all_, strict=True)) if np.isfinite(c))
    return ('Long waves feel neighbours much farther away: all neighbours together would change '
            f'{told or "the speeds above without bound"}.')
