"""What the neighbours that a scene omits would change, in words, per branch at the points asked.

In full where one looks for it (`check`, fits, designs, tolerances); the other commands say only that some shift matters, in a
line that names the largest one.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..bands.bands import points_on, sound_speeds
from ..bands.neighbours import neighbour_shifts, with_all
from ..scenes.laws import KINDS, TOLERANCE, SavedLaw
from ..scenes.scene import MOST_IN_A_CELL, Scene
from ..scenes.structures import FileLattice

MOST_SHOWN = 6
"""Number of shifts that are listed one by one, the largest ones."""


def neighbours(scene: Scene, points: Mapping[str, ArrayLike] | None = None, *, atoms: Atoms | None = None,
               within: Mapping[tuple[str, int], float] | None = None, speeds: bool = False,
               limit: str = 'the 95 % interval', brief: bool = False) -> list[str]:
    """A line that says how many neighbours count and what all of them would change; none for a scene without choice.

    In `brief` it names the largest shift only, if any matters.  `points` are the wavevectors asked, in fractions of the
    reciprocal vectors: one for each name, or several for a name of them all, of which the largest shift is named; by default the
    special points of the bands.  `within` has half widths of 95 % intervals, as fractions of the frequencies, by point and
    branch from 1: shifts that exceed them are named, and `limit` says what these widths are.  With `speeds`, a second line names
    the shift of long waves along x: they need many more neighbours.
    """
    if scene.single or isinstance(scene.law, SavedLaw) or KINDS[scene.law.kind].shells == 1 or (brief and scene.finite):
        return []
    told = _counted(scene)
    if scene.finite:
        lattice: Any = scene.lattice
        chosen = lattice.cutoff_m is None and not isinstance(scene.law.asked, int)
        return [f'{told}.' + ('' if chosen else ' Leave law.shells and lattice.cutoff_m out to count all pairs.')]
    atoms = scene.with_lean(False).perfect_cell() if atoms is None else atoms
    if not atoms.calc.pairwise:
        return [] if brief else ['All neighbours count (shells = "all").' if scene.law.asked == 'all' else f'{told}.']
    if isinstance(scene.lattice, FileLattice) and len(atoms) > MOST_IN_A_CELL:
        return [f'{told}; what the others would change is not computed for so large a cell.']
    if points is None:
        points = special_points(scene)
    told = _shifts(scene, told, atoms, points, within or {}, limit, brief)
    return [*filter(None, [told]), *(_speeds(atoms) if speeds and not atoms.constraints else [])]


def special_points(scene: Scene) -> dict[str, NDArray[np.float64]]:
    """Those on the path of the scene's bands, or on that of its lattice, by name."""
    lattice: Any = scene.lattice
    return points_on(lattice.path(scene.bands.path if scene.bands is not None else None, 0))


def _counted(scene):
    """Which neighbours count, in words."""
    law, lattice = scene.law, scene.lattice
    if lattice.cutoff is not None:
        reach = f'Neighbours within {lattice.cutoff / 1e3:.4g} m count'
        return reach if lattice.cutoff_m is not None else f'{reach} (shells = "{law.asked}")'
    if law.shells == 'all':
        return f'All neighbours count (shells = "{law.asked}")'
    number = 'Nearest neighbours only' if law.shells == 1 else f'{law.shells} shells of neighbours'
    asked = law.asked if isinstance(law.asked, int) else f'"{law.asked}"'
    return f'{number} (shells = {asked})'


def _shifts(scene, told, atoms, points, within, limit, brief):
    q = {name: np.reshape(np.asarray(several, dtype=float), (-1, 3)) for name, several in points.items()}
    found = neighbour_shifts(atoms, np.concatenate(list(q.values())))
    end = '' if found.known else ', if the forces go on falling as at the end of their table'
    largest = abs(found.relative).max()
    if largest <= TOLERANCE:
        where = '' if brief else ", ".join(q)
        return where and f'{told}: the others would shift no frequency at {where} by more than {100 * TOLERANCE:g} %{end}.'
    branch, shifts, first = 'branch in the plane' if atoms.calc.layer else 'branch', [], 0
    for name, several in q.items():
        here = slice(first, first + len(several))
        first += len(several)
        worst = found.relative[here][abs(found.relative[here]).argmax(axis=0), range(found.relative.shape[1])]
        for k, x in enumerate(worst):
            to = f' to {u.hertz(found.every[here][0, k]):.4g} Hz' if len(several) == 1 else ''
            shifts.append((x, f'{name}, {branch} {k + 1}', f'{"" if to else "up to "}{100 * x:+.2g} %{to}', (name, k + 1)))
    if brief:
        _, place, words, _ = max(shifts, key=lambda shift: abs(shift[0]))
        return f'{told}: the others would shift {place} by {words}{end}. "magphonon check" names the other shifts.'
    least = sorted((abs(x) for x, *_ in shifts), reverse=True)[:MOST_SHOWN][-1]
    shown = [f'{place} by {words}' for x, place, words, _ in shifts if abs(x) >= max(least, TOLERANCE)]
    others = max((abs(x) for x, *_ in shifts if TOLERANCE < abs(x) < least), default=0.0)
    line = f'{told}: the others would shift {"; ".join(shown)}{f"; others by up to {100 * others:.2g} %" if others else ""}{end}.'
    exceeding = [place for x, place, _, which in shifts if abs(x) > within.get(which, np.inf)]
    if exceeding:
        few = 'Nearest neighbours' if scene.law.shells == 1 else 'So few neighbours'
        line += f' {few} are not enough here: the others shift {"; ".join(exceeding)} by more than {limit}.'
    if not found.known:
        return line + ' Measure the force farther away, or give the shape of the magnets.'
    advice = ' Omit law.shells, or write shells = "auto", to count as many as matter.'
    return line + advice * isinstance(scene.law.asked, int)


def _speeds(atoms):
    every, known = with_all(atoms) if not atoms.calc.layer else (None, False)
    if every is None or not known:
        return []
    few, all_ = sound_speeds(atoms), sound_speeds(every)
    shifts = (all_ - few) / np.where(few == 0, np.nan, abs(few))
    if not (abs(shifts) > TOLERANCE).any():
        return []
    told = ', '.join(f'that of branch {k + 1} by {100 * x:+.2g} % to {c:.4g} m/s'
                     for k, (x, c) in enumerate(zip(shifts, all_, strict=True)) if np.isfinite(c))
    return [f'Long waves feel neighbours much farther away: the others would shift the speeds above, {told or "without bound"}.']
