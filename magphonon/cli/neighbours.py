"""How the neighbours that a scene omits would change its frequencies, in words, for each branch at given points.

`check`, fits, designs and tolerances list the shifts in full. The other commands print a line with the largest one if it matters.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..bands.bands import points_on, sound_speeds
from ..bands.neighbours import NeighbourShifts, neighbour_shifts, with_all
from ..findings import Finding, Findings
from ..scenes.laws import TOLERANCE, SavedLaw
from ..scenes.scene import MOST_IN_A_CELL, Scene
from ..scenes.sources import ready_scenes
from ..scenes.structures import FileLattice

MOST_SHOWN = 6
"""Number of shifts that are listed one by one, the largest ones."""


@dataclass(frozen=True)
class Case:
    """A scene, and the points and intervals for which shifts by omitted neighbours are reported."""

    scene: Scene
    points: Mapping[str, ArrayLike] | None = None
    given: Atoms | None = None
    within: Mapping[tuple[str, int], float] | None = None
    limit: str = 'the 95 % interval'

    @cached_property
    def atoms(self) -> Any:
        return self.scene.perfect_cell() if self.given is None else self.given

    @cached_property
    def q(self) -> dict[str, NDArray[np.float64]]:
        """The wavevectors of the points, by the names of these."""
        points = special_points(self.scene) if self.points is None else self.points
        return {name: np.reshape(np.asarray(several, dtype=float), (-1, 3)) for name, several in points.items()}

    @property
    def unknown(self) -> str | None:
        """The end of a sentence that says why shifts are not known; None if they are known."""
        lattice: Any = self.scene.lattice
        if self.scene.finite:
            chosen = lattice.cutoff_m is None and not isinstance(self.scene.law.asked, int)
            return '.' if chosen else '. Omit law.shells and lattice.cutoff_m to count all pairs.'
        if not self.atoms.calc.pairwise:
            return '.'
        large = isinstance(lattice, FileLattice) and len(self.atoms) > MOST_IN_A_CELL
        return '; the effect of farther ones is not computed for so large a cell.' if large else None

    @cached_property
    def found(self) -> NeighbourShifts:
        return neighbour_shifts(self.atoms, np.concatenate(list(self.q.values())))

    @property
    def matters(self) -> bool:
        """Whether a frequency shifts by more than the accuracy to which real lattices are known."""
        return self.unknown is None and bool(abs(self.found.relative).max() > TOLERANCE)

    @property
    def end(self) -> str:
        return '' if self.found.known else ', if the forces keep falling as they do at the end of the table'

    @cached_property
    def shifts(self) -> list[tuple[float, str, str, tuple[str, int]]]:
        """The largest relative shift of each branch at each point, its place and size in words, and the point and branch."""
        branch, shifts, first = 'branch in the plane' if self.atoms.calc.layer else 'branch', [], 0
        for name, several in self.q.items():
            here = slice(first, first + len(several))
            first += len(several)
            relative = self.found.relative[here]
            for k, x in enumerate(relative[abs(relative).argmax(axis=0), range(relative.shape[1])]):
                to = f' to {u.hertz(self.found.every[here][0, k]):.4g} Hz' if len(several) == 1 else ''
                words = f'{"" if to else "up to "}{100 * x:+.2g} %{to}'
                shifts.append((x, f'{branch} {k + 1} at {name}', words, (name, k + 1)))
        return shifts

    @cached_property
    def counted(self) -> str:
        """Which neighbours the scene counts, in words."""
        law, lattice = self.scene.law, self.scene.lattice  # a lattice from a file may have a cutoff
        if lattice.cutoff is not None:
            reach = f'Neighbours within {lattice.cutoff / 1e3:.4g} m count'
            return reach if getattr(lattice, 'cutoff_m', None) is not None else f'{reach} (shells = "{law.asked}")'
        if law.shells == 'all':
            return f'All neighbours count (shells = "{law.asked}")'
        number = 'Nearest neighbours only' if law.shells == 1 else f'{law.shells} shells of neighbours'
        asked = law.asked if isinstance(law.asked, int) else f'"{law.asked}"'
        return f'{number} (shells = {asked})'


REPORT = Findings()


@REPORT.remark
def shifts(case: Case) -> str:
    """How many neighbours the scene counts, and the largest shifts by the others, if there are any."""
    if case.unknown is not None:
        return case.counted + case.unknown
    if not case.matters:
        return (f'{case.counted}: farther ones would shift no frequency at {", ".join(case.q)} by more than {100 * TOLERANCE:g} %'
                f'{case.end}.')
    least = sorted((abs(x) for x, *_ in case.shifts), reverse=True)[:MOST_SHOWN][-1]
    shown = [f'{place} by {words}' for x, place, words, _ in case.shifts if abs(x) >= max(least, TOLERANCE)]
    others = max((abs(x) for x, *_ in case.shifts if TOLERANCE < abs(x) < least), default=0.0)
    rest = f'; other branches by up to {100 * others:.2g} %' if others else ''
    return f'{case.counted}: farther ones would shift {"; ".join(shown)}{rest}{case.end}.'


@REPORT.check
def not_enough(case: Case) -> Finding | None:
    """The shifts that exceed half the width of a given interval."""
    exceeding = [place for x, place, _, which in case.shifts if abs(x) > max((case.within or {}).get(which, np.inf), TOLERANCE)
                 ] if case.matters else []
    few = 'Nearest neighbours' if case.scene.law.shells == 1 else 'So few neighbours'
    return Finding(exceeding, f'{few} are not enough here: farther ones shift {" and ".join(exceeding)} by more than '
                   f'{case.limit}.', fault=True) if exceeding else None


@REPORT.remark
def advice(case: Case) -> str | None:
    """Advice for the user if a shift matters."""
    if not case.matters:
        return None
    if not case.found.known:
        return 'Measure the force at larger distances, or give the shape of the magnets.'
    counts = isinstance(case.scene.law.asked, int)
    return 'Omit law.shells, or write shells = "auto", to count as many shells as matter.' if counts else None


def neighbours(scene: Scene, points: Mapping[str, ArrayLike] | None = None, *,
               within: Mapping[tuple[str, int], float] | None = None, brief: bool = False) -> list[str]:
    """Lines that say how many neighbours are counted and how all of them would change the frequencies; no line if a scene cannot
    choose their number.

    If `brief`, it names only the largest shift, if any matters. `points` are wavevectors in fractions of the reciprocal vectors:
    one for each name, or several under one name, for which the largest shift is given; by default the special points of the
    bands. `within` has half widths of 95 % intervals, as fractions of the frequencies, by point and branch (counted from 1).
    Shifts that exceed them are named.
    """
    if scene.single or isinstance(scene.law, SavedLaw):
        return []
    case = Case(scene, points, within=within)
    if not brief:
        return [' '.join(REPORT.lines(case))]
    most = [max(case.shifts, key=lambda shift: abs(shift[0]))] if case.matters else []
    return [f'{case.counted}: farther ones would shift {place} by {words}{case.end}. "magphonon check --verbose" names all '
            'shifts.' for _, place, words, _ in most]


def omitted(scene: Scene, points: Mapping[str, ArrayLike] | None = None) -> Finding:
    """The largest shift by omitted neighbours, as a finding: a fault, except in ready scenes, which state the omission."""
    return Finding(words=''.join(neighbours(scene, points, brief=True)), fault=scene._name not in ready_scenes())


def omission(scene: Scene, verbose: bool) -> list[str]:
    """The line about omitted neighbours that a command prints, if there is one to print."""
    found = omitted(scene)
    return [found.words] if found.words and (found.fault or verbose) else []


def special_points(scene: Scene) -> dict[str, NDArray[np.float64]]:
    """Special points on the path of the scene's bands, or else of its lattice, by name."""
    lattice: Any = scene.lattice
    return points_on(lattice.path(scene.bands.path if scene.bands is not None else None, 0))


def speeds(scene: Scene) -> str | None:
    """How all neighbours would change the speeds of long waves along x, which need many more neighbours than frequencies do."""
    atoms: Any = scene.perfect_cell()
    if isinstance(scene.law, SavedLaw) or Case(scene).unknown is not None or atoms.calc.layer or atoms.constraints:
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
