"""Shells of neighbours: which distances belong to one shell despite rounded positions, and where the last wanted shell ends."""

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
"""Largest relative difference of successive distances that belong to one shell of neighbours.

Lattice constants are often written with three or more digits (8.66 for 5 sqrt(3) changes a distance by 2e-5), files with eight
decimals.  In the usual lattices the relative distance of two of the first hundred shells is at least 1e-3, of the first thousand
1e-4.
"""
EXACT = 1e-9
"""Relative difference of two distances below which they are equal up to the round-off of the positions, without rounding."""
CLEAR = 4.0
"""Smallest ratio of the narrowest gap between two shells to the widest gap inside a shell, for rounded positions."""
CLOSE, ROUNDED, CONTRAST = 1e-2, 1e-3, 25.0
"""Two shells may be one that rounding split if their relative gap is narrow and a neighbouring gap is `CONTRAST` times wider.

A gap is narrow below `CLOSE` after the last wanted shell, where neighbours would be lost, and below `ROUNDED` between the shells
before it, where only their number is in doubt.  Gaps in crystals are wider (3e-3 between the first two distances in cobalt and
magnesium).  In the usual lattices the ratio of neighbouring gaps stays below 20 over the first three thousand shells.
"""
DECIMALS = range(2, 8)
"""Numbers of decimals of positions that are taken as rounded; positions with fewer decimals are exact multiples of 0.1 mm."""
UNITS = 2.0
"""Difference of two distances, in units of the last decimal of positions that have few decimals, below which rounding may have
split one shell: two ends and a lattice vector are each off by half a unit."""
SCATTER = 0.1
"""Relative gap to the next distance below which particles without a bond show that the positions are irregular."""


def _held(atoms):
    """Mask of the particles that FixAtoms holds, shape (particles,); all False if it holds every particle."""
    held = np.zeros(len(atoms), bool)
    for constraint in atoms.constraints:
        if isinstance(constraint, FixAtoms):
            held[constraint.index] = True
    return held & ~held.all()


def in_shells(atoms, i, j, shift, lengths):
    """The pairs, except those of two held particles at distances shorter or longer than any pair with a free particle."""
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
        last = np.flatnonzero(gaps > SHELL_WIDTH)  # last distance of each shell before another one
        complete = reach >= extent and not atoms.pbc.any()
        if len(last) > shells or (complete and len(last) == shells):
            _refuse_unclear_shells(atoms, distances, gaps, last, shells)
            end = distances[last[shells - 1] : last[shells - 1] + 2].mean()
            near = lengths <= end
            return in_shells(atoms, i[near], j[near], shift[near], lengths[near]), end
        if complete:
            if len(last) + 1 == shells:
                return in_shells(atoms, *pairs), reach
            raise ValueError(f'the structure has {len(last) + 1} shells of neighbours, not the {shells} wanted; lower the number')
        reach = 1.5 * reach + 1e-6 * extent  # the second term: if particle 0 coincides with another one, the reach starts at zero


def _refuse_unclear_shells(atoms, distances, gaps, last, shells):
    """Refuse a last shell that rounding may have split, or shells whose gaps are no wider than the rounding.

    Parameters
    ----------
    atoms : ase.Atoms
    distances : ndarray, shape (n,)
        Different distances in ascending order.
    gaps : ndarray, shape (n - 1,)
        Relative gaps between them, divided by the longer distance.
    last : ndarray of int
        Index of the last distance of each shell except the outermost.
    shells : int
        The number of shells wanted.
    """
    end = last[shells - 1]
    between = np.concatenate([[1.0], gaps[last[: shells + 1]]])  # no gap before the first shell
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
    """The unit in mm of the last decimal of rounded positions; zero for positions with all digits."""
    numbers = np.concatenate([atoms.positions - atoms.positions[0], atoms.cell.array[atoms.pbc]]).ravel()
    for unit in 10.0 ** -np.array(DECIMALS):
        if (abs(numbers - unit * np.rint(numbers / unit)) <= EXACT * np.maximum(abs(numbers), unit)).all():
            return float(unit)
    return 0.0


def _widest_gap(atoms, last):
    """A cutoff in the widest gap between the distances up to `2 * last` (mm), which most likely separates true shells."""
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
                         f'{len(alone)} particles such as {alone[0]} have no bond: the positions are irregular, so that each '
                         'distance is a shell by itself; give a cutoff= between true shells '
                         f'({_widest_gap(atoms, last):.4g} mm lies in the widest gap)')
