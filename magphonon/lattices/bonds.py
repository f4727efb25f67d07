"""Bonds: the pairs of particles that repel each other, each pair once, also across the border of a periodic cell.

The calculator, the Hessian and the bands use the same list.  A bond runs from particle i to the image of particle j in the cell
`shift`; with the incidence matrix C(q), whose row for a bond holds -1 at i and e^{2 pi i q.shift} at j,

    forces  -C^T (phi' n)        Hessian  C^T K C        Bloch matrix  C(q)^+ K C(q)

Pairs are found within a distance, or within a number of shells of neighbours. The gaps between successive distances
show which distances belong to one shell in spite of rounded positions, and where the last shell ends.
"""

from __future__ import annotations

import operator
import os
import sys
from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from importlib.util import find_spec
from itertools import product
from typing import Any

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]  its stub hides the name

from ..errors import positive, refuse_memory, whole

Pairs = tuple[NDArray[np.int_], NDArray[np.int_], NDArray[Any], NDArray[np.float64]]
"""Particles i and j, the cell of j and the vector of each pair."""
MOST_PARTICLES = 2**31 - 1
MANY = 100_000  # number of particles from which on compiled code repays loading it, 0.3 s
PAIR_bytes, SHIFT_bytes = 64, 250  # at the peak while pairs are found, for each pair and each periodic cell; measured: 40 to 85
FEW = 2**13  # number of coordinates that are looked at first
SHELL_WIDTH = 1e-4
"""Largest relative difference of successive distances that belong to one shell of neighbours.

Lattice constants are often written with as few as three digits (8.66 for 5 sqrt(3) changes a distance by 2e-5).  Files have
eight decimals.  In the usual lattices the relative distance of two of the first hundred shells is at least 1e-3, of the first
thousand 1e-4.
"""
EXACT = 1e-9  # relative difference below which distances are equal up to the round-off of positions that are not rounded
CLEAR = 4.0  # smallest ratio of the narrowest gap between two shells to the widest gap inside a shell, for rounded positions
CLOSE, ROUNDED, CONTRAST = 1e-2, 1e-3, 25.0
"""Two shells may be one that rounding split if their relative gap is narrow and a neighbouring gap is `CONTRAST` times wider.

A gap is narrow below `CLOSE` after the last wanted shell, where neighbours would be lost, and below `ROUNDED` between the shells
before it, where only their number is in doubt.  Gaps in crystals are wider (3e-3 between the first two distances in cobalt and
magnesium).  In the usual lattices the ratio of neighbouring gaps stays below 20 over the first three thousand shells.
"""
DECIMALS = range(2, 8)  # of positions taken as rounded; those with fewer decimals are exact multiples of 0.1 mm
UNITS = 2.0
"""Difference of two distances, in units of the last decimal of positions that have few decimals, below which rounding may have
split one shell: two ends and a lattice vector are each off by half a unit."""
SCATTER = 0.1  # relative gap to the next distance below which particles without a bond show that the positions are irregular
ON_SHELL = 1e-6  # least relative distance of a cutoff from a shell; finite differences would cross a closer one


def pairs_within(atoms: Atoms, cutoff: float) -> Pairs:
    """All pairs within `cutoff`, each once, in ascending order of i, j and shift; particles may be in any periodic cell.

    They are found in the cells of a grid, or by a k-d tree, over the images near the periodic cell.  The neighbour list of ASE
    3.29 is not used, because it puts all particles of a flat finite structure into one bin, which needs memory for the square of
    their number.
    """
    _refuse_nowhere(atoms)
    periods = atoms.cell.array[atoms.pbc]
    if len(periods) and np.linalg.matrix_rank(periods) < len(periods):  # NumPy before 2.4.5 has no rank of an empty list
        raise ValueError(f'the structure is periodic along vectors that span no lattice, {periods.tolist()} mm; '
                         'set its cell, or its pbc to False')
    _refuse_many(atoms, periods, cutoff)
    n, inverse = len(atoms), np.linalg.pinv(periods)
    if not len(periods):
        i, j = _near(atoms.positions, n, cutoff)
        shift: Any = np.zeros((len(i), 3), np.int8)
        return i, j, shift, vectors_between(atoms, i, j, shift)
    home = np.floor(atoms.positions @ inverse).astype(int)
    fraction = atoms.positions @ inverse - home
    points = atoms.positions - home @ periods

    # Shift zero and half of the others: the other half would find every pair again, from its other end.
    reach = cutoff * np.linalg.norm(inverse, axis=0)
    most = np.floor(reach + 1).astype(int)
    shifts = np.array(list(product(*(range(-k, k + 1) for k in most))), dtype=int)
    shifts = shifts[len(shifts) // 2 :]
    near = [np.flatnonzero(((fraction + s > -reach) & (fraction + s < 1 + reach)).all(axis=1)) for s in shifts]
    particle, cell = np.concatenate(near), np.repeat(shifts, [len(k) for k in near], axis=0)
    i, image = _near(points[particle] + cell @ periods, n, cutoff)

    j, cell = particle[image], cell[image]
    backwards = i > j
    cell[backwards] *= -1
    pair = np.minimum(i, j), np.maximum(i, j)
    sides = n, n, *(2 * most + 1)  # a number for each pair and cell is sorted ten times as fast as a table with these columns
    i, j, *cell = np.unravel_index(np.sort(np.ravel_multi_index((*pair, *(cell + most).T), sides)), sides)
    shift = np.zeros((len(i), 3), int)
    shift[:, atoms.pbc] = np.transpose(cell) - most + home[i] - home[j]
    return i, j, shift, vectors_between(atoms, i, j, shift)


def compiled(particles: int) -> Any:
    """The passes of `magphonon.lattices.cells`, if numba is loaded or that many particles repay loading it, or else None."""
    pays = sys.modules.get('numba') is not None or (particles >= MANY and find_spec('numba') is not None)
    if not pays or os.environ.get('NUMBA_DISABLE_JIT', '0') != '0':
        return None
    from . import cells

    return cells


def _near(images, n, cutoff):
    """Pairs of one of the first n points and a later one within the cutoff, each once; ascending if all points are particles."""
    passes = compiled(n)
    if passes and (found := passes.pairs_in_cells(images, n, cutoff)):
        return found
    # particles of a lattice fill space evenly, where balance and close boxes only take time
    tree = cKDTree(images, balanced_tree=False, compact_nodes=False)
    if len(images) == n:
        i, j = tree.query_pairs(cutoff, output_type='ndarray').T
        return divmod(np.sort(i * n + j), n)
    found = cKDTree(images[:n]).sparse_distance_matrix(tree, cutoff, output_type='ndarray')
    found = found[found['i'] < found['j']]
    return found['i'], found['j']


def _refuse_nowhere(atoms):
    for k in np.argwhere(~np.isfinite(atoms.positions))[:1, 0]:
        raise ValueError(f'particle {k} is at {atoms.positions[k]} mm; every position must be a finite number')


def _refuse_many(atoms, periods, cutoff):
    """Raise ValueError if the pairs would not fit in memory; their number is estimated from the mean density of particles."""
    n, across = len(atoms), np.linalg.svd(periods)[2][len(periods):] if len(periods) else np.eye(3)
    thick = np.array([np.ptp(atoms.positions @ direction) for direction in across])
    thick = thick[thick > 2 * cutoff]
    ball = (1, 2, np.pi, 4 * np.pi / 3)[d := len(periods) + len(thick)] * cutoff**d
    pairs = n**2 / 2 * ball / (np.sqrt(np.linalg.det(periods @ periods.T)) * thick.prod())
    cells = np.prod(2 * cutoff * np.linalg.norm(np.linalg.pinv(periods), axis=0) + 3)
    refuse_memory(f'about {pairs:.2g} pairs of {n} particles within {cutoff:g} mm', PAIR_bytes * pairs + SHIFT_bytes * cells,
                  'take a smaller cutoff or fewer shells')


def vectors_between(atoms: Atoms, i: NDArray[np.int_], j: NDArray[np.int_], shift: NDArray[np.int_]) -> NDArray[np.float64]:
    """Vectors from the particles i to j in the cells `shift`, shape (pairs, 3), with the pairs last in memory.

    Columns of zeros, such as z in a plane, are never written, so that they take no memory.
    """
    vectors, shifted = np.zeros((3, len(i))), shift.any()
    for x, (found, place) in enumerate(zip(vectors, np.ascontiguousarray(atoms.positions.T), strict=True)):
        if shifted:
            np.subtract(place[j] + shift @ atoms.cell.array[:, x], place[i], out=found)
        elif np.ptp(place):
            _stretch(i, j, found[None], place[None])
    return vectors.T


def _stretch(i, j, vectors, u):
    """Add `u_j - u_i` to vectors, shape (rows, pairs), and return their lengths; by NumPy or compiled, the bits are the same."""
    if u.dtype == float and (passes := compiled(u.shape[1])):
        return passes.stretch(*(np.ascontiguousarray(end, np.int32) for end in (i, j)), vectors, np.ascontiguousarray(u))
    vectors += u.take(j, axis=1) - u.take(i, axis=1)
    return lengths_of(vectors.T)


def lengths_of(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    """Lengths of the row vectors, computed column by column: six times as fast as `numpy.linalg.norm` for short rows."""
    return np.sqrt(sum(x * x for x in vectors.T))


def distances_within(atoms: Atoms, cutoff: float) -> NDArray[np.float64]:
    """Different distances of pairs up to `cutoff` (mm), in ascending order."""
    return np.unique(lengths_of(pairs_within(atoms, cutoff)[3]))


def _in_shells(pairs, lengths, both, end):
    """The pairs up to `end`, except those of `both` held particles that are shorter or longer than any with a free particle."""
    kept = lengths <= end
    if (held := kept & both).any():
        free = lengths[kept & ~both]
        shortest, longest = free.min(initial=np.inf), free.max(initial=0.0)
        between = lengths[held]
        kept[held] = (between >= (1 - SHELL_WIDTH) * shortest) & (between <= (1 + SHELL_WIDTH) * longest)
    kept = np.flatnonzero(kept)
    i, j, shift, vectors = pairs
    return i[kept], j[kept], shift[kept], _some(vectors, kept)


def _some(vectors, which):
    """Some of the vectors, with the pairs last in memory again."""
    return np.array([x[which] for x in vectors.T]).T


def pairs_in_shells(atoms: Atoms, shells: int) -> tuple[Pairs, float]:
    """All pairs within a number of shells, and the distance midway to the next shell."""
    if len(atoms) < 2 and not atoms.pbc.any():
        raise ValueError(f'a structure of {len(atoms)} particles without periodic images has no bonds; add particles')
    others = np.concatenate([atoms.positions[1:] - atoms.positions[0], atoms.cell.array[atoms.pbc]])
    extent = np.linalg.norm([np.ptp(x) for x in atoms.positions.T])
    beyond = shells > 1  # one shell is judged by its own gap, more are also compared with the gap after the next shell
    reach = (1.8 + beyond * min(shells, 3) / 2) * lengths_of(others).min()  # of the first shells of the common lattices
    held = _held(atoms)
    while True:
        i, j, _, vectors = pairs = pairs_within(atoms, reach)
        lengths = lengths_of(vectors)
        both = held[i] & held[j] if held.any() else np.zeros(len(i), bool)
        distances = np.unique(lengths[~both] if held.any() else lengths)
        gaps = np.diff(distances) / distances[1:]
        last = np.flatnonzero(gaps > SHELL_WIDTH)  # last distance of each shell before another one
        complete = reach >= extent and not atoms.pbc.any()
        if len(last) >= shells + (beyond and not complete):
            _refuse_unclear(atoms, distances, gaps, last, shells)
            end = distances[last[shells - 1] : last[shells - 1] + 2].mean()
            return _in_shells(pairs, lengths, both, end), end
        if complete:
            if len(last) + 1 == shells:
                return _in_shells(pairs, lengths, both, reach), reach
            raise ValueError(f'the structure has {len(last) + 1} shells of neighbours, not the {shells} wanted; lower the number')
        reach = 1.5 * reach + 1e-6 * extent  # the second term: if particle 0 coincides with another one, the reach starts at zero


def _held(atoms):
    """Which particles FixAtoms holds, unless it holds all of them."""
    held = np.zeros(len(atoms), bool)
    for constraint in atoms.constraints:
        if isinstance(constraint, FixAtoms):
            held[constraint.index] = True
    return held & ~held.all()


def _refuse_unclear(atoms, distances, gaps, last, shells):
    """Raise ValueError if rounding may have split the last shell."""
    if (split := _unclear(atoms, distances, gaps, last, shells)) is not None:
        raise ValueError(
            f'the shells of neighbours are not clear: one ends at {distances[split]:.9g} mm, and the next distance is '
            f'{distances[split + 1]:.9g} mm, {100 * gaps[split]:.2g} % longer; if rounded or measured positions split '
            'one shell, write them with more digits (5*np.sqrt(3), not 8.66), or set the largest distance with cutoff= '
            f'({_widest_gap(atoms, distances[split]):.4g} mm lies in the widest gap)')


def clear_shells(atoms: Atoms, distances: NDArray[np.float64], counts: Iterable[int]) -> list[int]:
    """The `counts` of shells that `find_bonds` accepts; `distances` ascend, without repetition, to beyond the last shell."""
    gaps = np.diff(distances) / distances[1:]
    last = np.flatnonzero(gaps > SHELL_WIDTH)
    return [shells for shells in counts if shells <= len(last) and _unclear(atoms, distances, gaps, last, shells) is None]


def _unclear(atoms, distances, gaps, last, shells):
    """Index of a distance where rounding may have split the last shell, or where gaps are as small as rounding; or None.

    The `gaps` between the distances are divided by the longer one; `last` is the last distance of each shell but the outermost.
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
        return None
    return last[split.argmax()] if split.any() else end


def _last_decimal(atoms: Atoms) -> float:
    """The unit in mm of the last decimal of rounded positions; zero for positions with all digits."""
    numbers = np.concatenate([atoms.positions - atoms.positions[0], atoms.cell.array[atoms.pbc]]).ravel()
    for unit in 10.0 ** -np.array(DECIMALS):
        parts = numbers[:FEW], numbers  # for most lattices the first decides
        if all((abs(x - unit * np.rint(x / unit)) <= EXACT * np.maximum(abs(x), unit)).all() for x in parts):
            return float(unit)
    return 0.0


def _widest_gap(atoms, last):
    """A cutoff in the widest gap between the distances up to `2 * last` (mm), which most likely separates true shells."""
    distances = np.append(distances_within(atoms, 2 * last), 2 * last)
    gap = np.argmax(np.diff(np.log(distances)))
    return distances[gap : gap + 2].mean()


@dataclass(frozen=True)
class Bonds:
    """The bonds of one structure.

    Attributes
    ----------
    i, j : ndarray of int32, shape (bonds,)
        The particles that each bond joins; equal for a bond between a particle and its own periodic image.
        Convert them before multiplying, because products need more bits: `i.astype(int) * particles + j`.
    shift : ndarray of int, shape (bonds, 3)
        The periodic cell that holds j.  If it is zero for all bonds, the array is read-only and takes no memory.
    vectors : ndarray, shape (bonds, 3)
        Bond vectors from i to j at rest, in mm.
    particles : int
        Number of particles in the structure.
    cutoff : float or None
        Distance in mm within which the bonds were found; None for an explicit list.
    """

    i: np.ndarray
    j: np.ndarray
    shift: np.ndarray
    vectors: np.ndarray
    particles: int
    cutoff: float | None = None

    def __post_init__(self) -> None:
        if self.particles > MOST_PARTICLES:
            raise ValueError(f'bonds may join at most {MOST_PARTICLES} particles, not {self.particles}: their indices have 32 '
                             'bits')
        slim = {name: np.ascontiguousarray(getattr(self, name), np.int32) for name in 'ij'}
        slim['vectors'] = np.asfortranarray(self.vectors)  # the bonds last in memory
        if not np.any(self.shift):
            slim['shift'] = np.broadcast_to(np.zeros(3, int), (len(self.i), 3))
        for name, values in slim.items():
            object.__setattr__(self, name, values)

    def __len__(self) -> int:
        return len(self.i)

    @property
    def lengths(self) -> NDArray[np.float64]:
        """Bond lengths at rest in mm, shape (bonds,)."""
        return lengths_of(self.vectors)

    @property
    def coordination(self) -> NDArray[np.int_]:
        """Number of bonds that end at each particle, shape (particles,)."""
        return np.bincount(np.concatenate([self.i, self.j]), minlength=self.particles)

    @cached_property
    def distinct_shifts(self) -> tuple[NDArray[np.int_], NDArray[np.intp]]:
        """The shifts without repetition, shape (shifts, 3), and the index of the shift of each bond, shape (bonds,).

        A large cell of a planar lattice has thousands of bonds, but only five different shifts.
        """
        return np.unique(self.shift, axis=0, return_inverse=True)

    @cached_property
    def shortest(self) -> float:
        """Length of the shortest bond in mm; infinite without bonds."""
        return float(self.lengths.min(initial=np.inf))

    @cached_property
    def longest(self) -> float:
        """Length of the longest bond in mm."""
        return float(self.lengths.max(initial=0.0))

    @cached_property
    def distinct_pairs(self) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.intp]]:
        """The pairs i, j without repetition, shape (pairs,) each, and the index of the pair of each bond, shape (bonds,)."""
        pair, own = np.unique(self.i.astype(int) * self.particles + self.j, return_inverse=True)
        return *divmod(pair, self.particles), own

    def among(self, which: NDArray[Any]) -> Bonds:
        """The bonds selected by an index or a mask."""
        return Bonds(self.i[which], self.j[which], self.shift[which], _some(self.vectors, which), self.particles, self.cutoff)

    def at(self, atoms: Atoms) -> Bonds:
        """The same pairs of particles with the vectors that they have in `atoms`; the particles may be in any periodic image."""
        vectors = vectors_between(atoms, self.i, self.j, self.shift)
        if np.array_equal(vectors, self.vectors):
            return self
        shift, change = self.shift, vectors - self.vectors
        if atoms.pbc.any() and (lengths_of(change) > self.lengths / 2).any():
            from ase.geometry import find_mic

            jump = change - find_mic(change, atoms.cell, atoms.pbc)[0]  # pyright: ignore[reportArgumentType]  three pbc
            shift = shift - np.round(jump @ np.linalg.pinv(atoms.cell.array)).astype(int)
            vectors = vectors_between(atoms, self.i, self.j, shift)
        same = np.allclose(vectors, self.vectors, rtol=0, atol=1e-9 * self.lengths.max(initial=0))
        return Bonds(self.i, self.j, shift, vectors, self.particles, self.cutoff if same else None)

    def fitted(self, atoms: Atoms) -> Bonds:
        """The bonds with the vectors that they have in `atoms`, or ValueError if they were made for another structure."""
        found = self.at(atoms)
        changed = lengths_of(found.vectors - self.vectors)
        for b in np.flatnonzero(changed > self.lengths / 2)[:1]:
            raise ValueError(f'the bond of the particles {self.i[b]} and {self.j[b]} has the length {self.lengths[b]:g} mm, but '
                             f'they are {found.lengths[b]:g} mm apart in the reference: the bond belongs to another structure; '
                             'find the bonds of this structure, or give pairs as (i, j)')
        return found

    def relative(self, u: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacements of the far ends of the bonds relative to the near ones, `C u`, from u of shape (particles, dim)."""
        return self.stretched(np.broadcast_to(np.zeros(1, u.dtype), (len(self), u.shape[1])), u)[0]

    def stretched(self, R: NDArray[np.float64], u: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Vectors `R + C u`, shape (bonds, dim), and their lengths, shape (bonds,)."""
        vectors = np.array(R.T, order='C')
        r = _stretch(self.i, self.j, vectors, u.T)
        return vectors.T, r  # the bonds last in memory, as of their vectors at rest

    def net(self, pull: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums `C^T pull` over the bonds: `pull`, shape (bonds, dim), acts on the far ends, and its negative on the near ones."""
        near, far = self.at_ends(pull.T)
        return np.subtract(far.T, near.T, order='C')

    def total(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Sums of values, shape (bonds, ...), over all bonds of each particle, shape (particles, ...)."""
        near, far = self.at_ends(values.T.reshape(int(np.prod(values.shape[1:])), len(self)))
        return (near + far).reshape(*values.T.shape[:-1], self.particles).T

    def at_ends(self, rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Sums of each row, shape (rows, bonds), over the bonds that begin, and over those that end, at each particle."""
        if passes := compiled(self.particles):
            return passes.at_ends(self.i, self.j, np.ascontiguousarray(rows, float), self.particles)
        near, far = (np.array([np.bincount(end, row, self.particles) for row in rows], float) for end in (self.i, self.j))
        return near, far

    @cached_property
    def incidence(self) -> sparse.csr_array:
        """Incidence matrix C at q = 0, sparse, shape (bonds, particles); a self-image bond has an empty row."""
        b = len(self)
        C = sparse.csr_array((np.tile([-1.0, 1.0], b), np.column_stack([self.i, self.j]).ravel(), 2 * np.arange(b + 1)),
                             shape=(b, self.particles))
        C.sum_duplicates()
        C.eliminate_zeros()
        return C

    def incidence_at(self, q: ArrayLike) -> sparse.csr_array:
        """Incidence matrix C(q) at the wavevector `q` in fractions of the reciprocal vectors; sparse, complex."""
        row = np.arange(len(self))
        phase = np.exp(2j * np.pi * self.shift @ np.asarray(q, dtype=float))
        entries = np.concatenate([-np.ones(len(self)), phase])
        matrix = sparse.csr_array((entries, (np.tile(row, 2), np.concatenate([self.i, self.j]))),
                                  shape=(len(self), self.particles))
        matrix.eliminate_zeros()
        return matrix


def find_bonds(atoms: Atoms, shells: int = 1, cutoff: float | None = None) -> Bonds:
    """Bonds between all particles up to the given shell of neighbours, or within `cutoff`.

    Parameters
    ----------
    atoms : ase.Atoms
        The rest configuration; bonds cross its periodic borders.
    shells : int
        Number of neighbour shells; ignored when `cutoff` is given.  A shell is a group of distances that follow each other
        within `SHELL_WIDTH`, so that rounded lattice constants and coordinates keep their bonds.  Distances
        between two particles held by FixAtoms never change, so they are ignored if any particle is free.  Held particles may be
        closer together than the first shell, or even coincide, as do fixed magnets of the paper's oscillator; such pairs get
        no bond.
    cutoff : float, optional
        Distance in mm.

    Raises
    ------
    ValueError
        If particles coincide, or no two are within reach. If the cutoff equals the distance of a shell of neighbours, because
        the smallest displacement would then make and break bonds.  If shells cannot be distinguished, because two are so close
        that they may be one shell split by rounding, or because the positions are irregular.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices import find_bonds
    >>> cell = lattices.triangular(10.0, 1.0)
    >>> len(find_bonds(cell)), len(find_bonds(cell, shells=2))  # three bonds per particle, then six
    (3, 6)
    """
    if cutoff is None:
        pairs, end = pairs_in_shells(atoms, whole('shells', shells))
        bonds = _bonds(atoms, *pairs, end)
        alone, last = np.flatnonzero(bonds.coordination == 0), bonds.lengths.max(initial=0)
        following = 2 * end - last  # the end is midway
        if len(alone) and following < (1 + SCATTER) * last:
            raise ValueError(f'the shells of neighbours end at {last:.6g} mm, the next distance is {following:.6g} mm, and '
                             f'{len(alone)} particles such as {alone[0]} have no bond: the positions are irregular, so that each '
                             'distance is a shell by itself; give a cutoff= between true shells '
                             f'({_widest_gap(atoms, last):.4g} mm lies in the widest gap)')
        return bonds
    cutoff = positive('cutoff', cutoff, 'mm')
    bonds = _bonds(atoms, *pairs_within(atoms, cutoff * (1 + 2 * ON_SHELL)), cutoff)
    if not len(bonds):
        raise ValueError(f'no two particles are within the cutoff of {cutoff:g} mm; increase it, or check the unit of the '
                         'positions')
    lengths = bonds.lengths
    near = lengths[np.argmin(abs(lengths - cutoff))]
    if abs(near - cutoff) <= ON_SHELL * cutoff:
        raise ValueError(f'the cutoff {cutoff:g} mm falls on a shell of neighbours at {near:.9g} mm; '
                         'move it between two shells, or give shells=')
    return bonds if near < cutoff and bonds.longest < cutoff else bonds.among(lengths < cutoff)


def bonds_within(atoms: Atoms, cutoff: float) -> Bonds:
    """Bonds between all particles closer than `cutoff` (mm), possibly none; unlike `find_bonds` it does not check the cutoff."""
    return _bonds(atoms, *pairs_within(atoms, cutoff), cutoff)


def _bonds(atoms, i, j, shift, vectors, cutoff):
    bonds = Bonds(i, j, shift, vectors, len(atoms), cutoff)
    _refuse_coincident(bonds, cutoff)
    return bonds


def _refuse_coincident(bonds, scale):
    if bonds.shortest <= 1e-12 * scale:
        k = bonds.lengths.argmin()
        raise ValueError(f'particles {bonds.i[k]} and {bonds.j[k]} coincide; move one of them, or list the bonds explicitly '
                         '(bonds=)')


def explicit_bonds(atoms: Atoms, pairs: Iterable[Any]) -> Bonds:
    """Bonds between the listed pairs of particles, for structures that no cutoff describes.

    Parameters
    ----------
    atoms : ase.Atoms
        The rest configuration.
    pairs : sequence of (i, j) or (i, j, shift)
        Particle indices, and the periodic cell of j (three integers, default 0 0 0).

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices.bonds import explicit_bonds
    >>> atoms = lattices.oscillator(0.5, 1.0, 1.0)
    >>> explicit_bonds(atoms, [(0, 3), (1, 3), (2, 3)]).lengths.round(12)
    array([1., 1., 1.])
    """
    _refuse_nowhere(atoms)
    n = len(atoms)
    listed = {}
    for pair in pairs:
        i, j, shift = _bond(pair, n, atoms.pbc)
        reverse = (j, i, tuple(-k for k in shift))
        if (i, j, shift) in listed or reverse in listed:
            raise ValueError(f'bond {tuple(pair)} is listed twice; list each pair once, from either end')
        listed[i, j, shift] = None
    if not listed:
        raise ValueError(f'the list of bonds is empty, {pairs!r}; list at least one pair (i, j)')
    i, j, shift = (np.array(column) for column in zip(*listed, strict=True))
    bonds = Bonds(i, j, shift, vectors_between(atoms, i, j, shift), n)
    _refuse_coincident(bonds, bonds.longest)
    return bonds


def _bond(pair, n, pbc):
    """Particles and shift of a listed bond between two of n particles."""
    try:
        i, j, shift = (*pair, (0, 0, 0)) if len(pair) == 2 else pair
        i, j, *shift = map(operator.index, (i, j, *shift))
        x, y, z = shift
    except (TypeError, ValueError):
        raise ValueError(f'a bond is (i, j) or (i, j, shift) in whole numbers, as (0, 1, (1, 0, 0)), not {pair!r}') from None
    if not (0 <= i < n and 0 <= j < n):
        raise ValueError(f'bond {tuple(pair)} names a particle outside 0 to {n - 1}; particles are counted from 0')
    if i == j and not any(shift):
        raise ValueError(f'bond {tuple(pair)} joins particle {i} to itself; name another particle, or the shift of its image')
    if np.any(np.array(shift)[~np.asarray(pbc)]):
        raise ValueError(f'bond {tuple(pair)} crosses a border that is not periodic; keep its shift 0 there')
    return i, j, (x, y, z)


def bonds_of(atoms: Atoms, bonds: Bonds | Iterable[Any] | None, shells: int, cutoff: float | None) -> Bonds:
    """The bonds of a structure: `bonds` itself, or from a list as in `explicit_bonds`, or else from `find_bonds`."""
    if bonds is None:
        bonds = find_bonds(atoms, shells, cutoff)
    else:
        bonds = bonds if isinstance(bonds, Bonds) else explicit_bonds(atoms, bonds)
        if bonds.particles != len(atoms):
            raise ValueError(f'the bonds join {bonds.particles} particles, but the reference has {len(atoms)}; '
                             'find them in this structure, or use repeat_bonds')
        bonds = bonds.fitted(atoms)
    if not len(bonds):
        raise ValueError(f'no two of the {len(atoms)} particles are bonded, so no force acts between them; keep at least '
                         'one pair of neighbours')
    return bonds


def repeat_bonds(bonds: Bonds, atoms: Atoms, supercell: Atoms) -> Bonds:
    """The same bonds in a supercell of `atoms`, whatever the order of its particles.

    Parameters
    ----------
    bonds : Bonds
        Bonds of `atoms`.
    atoms, supercell : ase.Atoms
        The periodic cell, and a structure of whole cells of it (phonopy's or `repeat`'s).
    """
    origin = image_of(atoms, supercell)
    images = [np.flatnonzero(origin == k) for k in range(len(atoms))]
    counts = [len(images[k]) for k in bonds.i]
    i = np.concatenate([images[k] for k in bonds.i])
    vectors = np.repeat(bonds.vectors, counts, axis=0)
    ends = supercell.positions[i] + vectors
    j = _site_of(ends, supercell)
    shift = np.round((ends - supercell.positions[j]) @ np.linalg.inv(supercell.cell.array)).astype(int)
    return Bonds(i, j, shift, vectors, len(supercell), bonds.cutoff)


def image_of(atoms: Atoms, supercell: Atoms) -> NDArray[np.int_]:
    """For each particle of a supercell, the particle of the periodic cell `atoms` whose image it is, shape (particles,)."""
    return _site_of(supercell.positions, atoms)


def _site_of(points, atoms):
    """For each point, the particle of `atoms` that has an image there."""
    inverse = np.linalg.inv(atoms.cell.array)
    tree = cKDTree(np.mod(atoms.positions @ inverse, 1.0) % 1.0, boxsize=1.0)  # twice: mod of -1e-17 is 1.0
    distance, index = tree.query(np.mod(points @ inverse, 1.0) % 1.0)
    if distance.size and distance.max() > 1e-6:
        raise ValueError('the supercell does not consist of images of the cell; build it with repeat() or phonopy')
    return index
