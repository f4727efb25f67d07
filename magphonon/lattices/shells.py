"""Shells of neighbours: which distances are one, where positions are rounded, and where the last shell that is wanted ends."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms

from .pairs import distances_within, pairs_within

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

    from .bonds import Bonds

    Pairs = tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_], NDArray[np.float64]]
    """Particles i and j, the cell of j and the distance of each pair."""

SHELL_WIDTH = 1e-4
"""Distances that follow each other within this fraction belong to one shell of neighbours.

People write lattice constants with three or more digits (8.66 for 5 sqrt(3) moves a distance by 2e-5) and files with eight
decimals; of the usual lattices, two of the first hundred shells are never closer than 1e-3, two of the first thousand 1e-4.
"""
EXACT = 1e-9
"""Relative difference of two distances below which they are equal up to the round-off of the positions, without rounding."""
CLEAR = 4.0
"""Smallest ratio of the narrowest gap between two shells to the widest gap inside a shell, for rounded positions."""
CLOSE, ROUNDED, CONTRAST = 1e-2, 1e-3, 25.0
"""Two shells may be one that rounding split if their gap is narrow and a gap beside it is `CONTRAST` times wider.

Narrow is `CLOSE` after the last shell wanted, where neighbours would be lost, and `ROUNDED` between the shells before it, where
only their number is in doubt; crystals differ more (the two first distances in cobalt and magnesium by 3e-3).  In the usual
lattices, where shells crowd at large distances, the ratio stays below 20 over the first three thousand shells.
"""
DECIMALS = range(2, 8)
"""Numbers of decimals with which positions are written on purpose; fewer are whole numbers of millimetres or their tenths."""
UNITS = 2.0
"""Difference of two distances, in units of the last decimal of positions that have few decimals, below which rounding may have
split one shell: two ends and a lattice vector are each off by half a unit."""
SCATTER = 0.1
"""Relative gap to the next distance below which particles without a bond show that the positions scatter."""


def _held(atoms):
    """Which particles FixAtoms holds, shape (particles,); none of them if it holds all."""
    held = np.zeros(len(atoms), bool)
    for constraint in atoms.constraints:
        if isinstance(constraint, FixAtoms):
            held[constraint.index] = True
    return held & ~held.all()


def in_shells(atoms, i, j, shift, lengths):
    """The pairs without those of two held particles that are shorter or longer than every pair with a free one."""
    held = _held(atoms)
    if not held.any():
        return i, j, shift, lengths
    both = held[i] & held[j]
    shortest, longest = lengths[~both].min(initial=np.inf), lengths[~both].max(initial=0.0)
    kept = ~both | ((lengths >= (1 - SHELL_WIDTH) * shortest) & (lengths <= (1 + SHELL_WIDTH) * longest))
    return i[kept], j[kept], shift[kept], lengths[kept]


def pairs_in_shells(atoms: Atoms, shells: int) -> tuple[Pairs, float]:
    """All pairs i, j, shift, distance within some shells of neighbours, and the distance midway to the next shell."""
    if len(atoms) < 2 and not atoms.pbc.any():
        raise ValueError(f'a structure of {len(atoms)} particles without periodic images has no bonds; add particles')
    others = np.concatenate([atoms.positions[1:] - atoms.positions[0], atoms.cell.array[atoms.pbc]])
    extent = np.linalg.norm(np.ptp(atoms.positions, axis=0))
    reach = 1.8 * np.linalg.norm(others, axis=1).min()  # the two first shells of the common lattices: 1 and sqrt(2) or sqrt(3)
    while True:
        i, j, shift, lengths = pairs = pairs_within(atoms, reach)
        held = _held(atoms)
        distances = np.unique(lengths[~(held[i] & held[j])] if held.any() else lengths)
        gaps = np.diff(distances) / distances[1:]
        last = np.flatnonzero(gaps > SHELL_WIDTH)  # of each shell that another one follows
        complete = reach >= extent and not atoms.pbc.any()
        if len(last) > shells or (complete and len(last) == shells):
            _refuse_unclear_shells(atoms, distances, gaps, last, shells)
            end = distances[last[shells - 1] : last[shells - 1] + 2].mean()
            near = lengths <= end
            return in_shells(atoms, i[near], j[near], shift[near], lengths[near]), end
        if complete:
            if len(last) + 1 == shells:
                return in_shells(atoms, *pairs), reach
            raise ValueError(f'the structure has {len(last) + 1} shells of neighbours, not the {shells} asked for; ask for fewer')
        reach = 1.5 * reach + 1e-6 * extent  # the sum: where particle 0 coincides with another, the reach starts from zero


def _refuse_unclear_shells(atoms, distances, gaps, last, shells):
    """Refuse to end at a shell that rounding may have split, or to count shells that are no clearer than the rounding.

    Parameters
    ----------
    atoms : ase.Atoms
    distances : ndarray, shape (n,)
        Different distances in ascending order.
    gaps : ndarray, shape (n - 1,)
        Between them, over the longer one.
    last : ndarray of int
        The last distance of each shell that another one follows.
    shells : int
        The number of shells that were asked for.
    """
    end = last[shells - 1]
    between = np.concatenate([[1.0], gaps[last[: shells + 1]]])  # before the first shell there is nothing
    beside = np.maximum(between[:-1], np.append(between[2:], 0)[: len(between) - 1])[:shells]
    between = between[1 : shells + 1]
    narrow = np.append(np.full(shells - 1, ROUNDED), CLOSE)
    rounded = between * distances[last[:shells] + 1] < UNITS * _last_decimal(atoms)
    split = ((between < narrow) | rounded) & (CONTRAST * between < beside)
    inside = gaps[:end][(gaps[:end] > EXACT) & (gaps[:end] <= SHELL_WIDTH)].max(initial=0)
    if not split.any() and between.min() >= CLEAR * inside:
        return
    if split.any():
        end = last[split.argmax()]
    raise ValueError(f'the shells of neighbours are not clear: one ends at {distances[end]:.9g} mm, and the next '
                     f'distance is {distances[end + 1]:.9g} mm, {100 * gaps[end]:.2g} % longer; if rounded or measured positions '
                     'split one shell, write them with more digits (5*np.sqrt(3), not 8.66), or say how far to go with cutoff= '
                     f'({_widest_gap(atoms, distances[end]):.4g} mm lies in the widest gap)')


def _last_decimal(atoms: Atoms) -> float:
    """The unit in mm of the last decimal with which the positions are written; zero if they have all their digits."""
    numbers = np.concatenate([atoms.positions - atoms.positions[0], atoms.cell.array[atoms.pbc]]).ravel()
    for unit in 10.0 ** -np.array(DECIMALS):
        if (abs(numbers - unit * np.rint(numbers / unit)) <= EXACT * np.maximum(abs(numbers), unit)).all():
            return float(unit)
    return 0.0


def _widest_gap(atoms, last):
    """A cutoff in the widest gap between the distances up to `2 * last` (mm), where true shells most likely part."""
    distances = np.append(distances_within(atoms, 2 * last), 2 * last)
    gap = np.argmax(np.diff(np.log(distances)))
    return distances[gap : gap + 2].mean()


def refuse_scatter(atoms: Atoms, bonds: Bonds) -> None:
    """Refuse shells that leave particles without a bond although the next distance is hardly longer."""
    alone, last = np.flatnonzero(bonds.coordination == 0), bonds.lengths.max(initial=0)
    assert bonds.cutoff is not None  # noqa: S101, of `find_bonds`
    following = 2 * bonds.cutoff - last  # the cutoff is midway
    if len(alone) and following < (1 + SCATTER) * last:
        raise ValueError(f'the shells of neighbours end at {last:.6g} mm, the next distance is {following:.6g} mm, and '
                         f'{len(alone)} particles such as {alone[0]} have no bond: the positions scatter, so that every distance '
                         'is a shell of its own; give a cutoff= between true shells '
                         f'({_widest_gap(atoms, last):.4g} mm lies in the widest gap)')
