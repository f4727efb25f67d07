"""Pairs of particles within a distance of each other, also across the border of a periodic cell."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

PIECE = 2**16
"""Number of pairs whose vectors are computed at once."""


def pairs_within(atoms: Atoms, cutoff: float) -> tuple[NDArray[np.int_], NDArray[np.int_], NDArray[np.int_], NDArray[np.float64]]:
    """All pairs i, j, shift, distance within `cutoff`, each once; the particles may be in any periodic cell.

    They are found by a k-d tree over the images near the cell.  The neighbour list of ASE 3.29 is not used, because it puts all
    particles of a flat finite structure into one bin, which needs memory for the square of their number.
    """
    from scipy.spatial import cKDTree  # pyright: ignore[reportAttributeAccessIssue]  its stub hides the name

    if not np.isfinite(atoms.positions).all():
        k = np.argwhere(~np.isfinite(atoms.positions))[0, 0]
        raise ValueError(f'particle {k} is at {atoms.positions[k]} mm; every position must be a finite number')
    periods = atoms.cell.array[atoms.pbc]
    if not len(periods):
        i, j = cKDTree(atoms.positions).query_pairs(cutoff, output_type='ndarray').T
        return i, j, np.zeros((len(i), 3), dtype=int), distances_between(atoms.positions, i, j)
    if np.linalg.matrix_rank(periods) < len(periods):  # NumPy before 2.4.5 has no rank of an empty list
        raise ValueError(f'the structure is periodic along vectors that span no lattice, {periods.tolist()} mm; '
                         'set its cell, or its pbc to False')
    inverse = np.linalg.pinv(periods)
    home = np.floor(atoms.positions @ inverse).astype(int)
    fraction = atoms.positions @ inverse - home
    points = atoms.positions - home @ periods

    # Shift zero and half of the others: the other half would find every pair again, from its other end.
    reach = cutoff * np.linalg.norm(inverse, axis=0)
    shifts = np.array(list(product(*(range(-k, k + 1) for k in np.floor(reach + 1).astype(int)))), dtype=int)
    shifts = shifts[len(shifts) // 2 :]
    near = [np.flatnonzero(((fraction + s > -reach) & (fraction + s < 1 + reach)).all(axis=1)) for s in shifts]
    particle, cell = np.concatenate(near), np.repeat(shifts, [len(k) for k in near], axis=0)

    images = cKDTree(points[particle] + cell @ periods)
    found = cKDTree(points).sparse_distance_matrix(images, cutoff, output_type='ndarray')
    found = found[(found['i'] < found['j']) | (found['j'] >= len(atoms))]
    i, j = found['i'], particle[found['j']]
    shift = np.zeros((len(found), 3), dtype=int)
    shift[:, atoms.pbc] = cell[found['j']] + home[i] - home[j]
    return i, j, shift, found['v']


def distances_between(points: NDArray[np.float64], i: NDArray[np.int_], j: NDArray[np.int_]) -> NDArray[np.float64]:
    """Distances of the pairs i, j of points, shape (pairs,); in pieces, so that no other array is as long as the pairs."""
    found = np.empty(len(i))
    for k in range(0, len(i), PIECE):
        some = np.s_[k : k + PIECE]
        found[some] = np.linalg.norm(points[j[some]] - points[i[some]], axis=1)
    return found


def distances_within(atoms: Atoms, cutoff: float) -> NDArray[np.float64]:
    """Different distances of pairs up to `cutoff` (mm), in ascending order.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices import distances_within
    >>> sorted(set(distances_within(lattices.square(1.0, 1.0), 1.5).round(6).tolist()))
    [1.0, 1.414214]
    """
    return np.unique(pairs_within(atoms, cutoff)[3])
