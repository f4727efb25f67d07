"""Squared frequencies and modes at any wavevectors, from the Bloch matrix (Eq. 18)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from ..errors import finite
from ..stiffness.constraints import free_motion
from ..stiffness.matrices import mass_weighted, signed_root
from ..stiffness.rest import settled

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

    from ..stiffness.repulsion import Repulsion

BATCH_BYTES = 2**26  # of Bloch matrices diagonalised at a time; the whole of a large zone need not fit in memory


def cell_at_rest(atoms: Atoms) -> tuple[Repulsion, NDArray[np.float64]]:
    """The calculator of a cell, at rest, and what its constraints leave free.

    Returns
    -------
    calc : MagneticRepulsion or AllNeighbours
    free : ndarray, shape (particles * dim, free)
        Orthonormal directions P, each of one particle; held particles, such as the walls of a channel, have none.

    Raises
    ------
    ValueError
        If there is no such calculator, the constraints are others than FixAtoms, FixedLine and FixedPlane or hold everything, or
        the forces on what is free do not balance (`magphonon.stiffness.rest`).
    """
    calc: Any = settled(atoms).calc
    return calc, free_motion(atoms).toarray()


def cell_of_free_particles(atoms: Atoms, what: str) -> Repulsion:
    """The calculator of a cell, at rest, all of whose particles move, as `what` supposes.

    Raises
    ------
    ValueError
        As `cell_at_rest`; also if the cell holds a constraint.
    """
    if atoms.constraints:
        raise ValueError(f'the cell holds the constraint {atoms.constraints[0]}, but {what} of free particles; '
                         'remove it with atoms.set_constraint()')
    return cell_at_rest(atoms)[0]


def condensed(D: NDArray[Any], free: NDArray[np.float64]) -> NDArray[Any]:
    """`P^T D P`: matrices of the free directions P alone, shape (..., free, free); what is held stays at rest."""
    return D if free.shape[0] == free.shape[1] else free.T @ D @ free


def bloch_modes(atoms: Atoms, q: ArrayLike, model: str = 'complete',
                vectors: bool = False) -> tuple[NDArray[np.float64], NDArray[np.complex128] | None]:
    """Frequencies of a periodic structure at any wavevectors.

    Held particles, FixAtoms, do not move: a strip between walls or a ribbon with a held edge has one mode for each direction
    that FixAtoms, FixedLine and FixedPlane leave free.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion or AllNeighbours.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    model : {'complete', 'conventional'}
    vectors : bool
        Compute the modes too.

    Returns
    -------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms, unstable modes negative.
    vectors : ndarray of complex, shape (wavevectors, modes, particles, dim), or None
        Normalised to one and weighted with the square root of the mass; zero on held particles.

    Raises
    ------
    ValueError
        For an unknown model, a wavevector that is not finite, or atoms without MagneticRepulsion.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.bands import bloch_modes
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> omega, shapes = bloch_modes(cell, [[0.5, 0, 0], [0.1, 0.2, 0]], vectors=True)
    >>> omega.shape, shapes.shape
    ((2, 2), (2, 2, 1, 2))
    """
    calc, free = cell_at_rest(atoms)
    q = _wavevectors(q)
    omega, modes = [], []
    parts = np.array_split(q, _batches(len(q), len(atoms) * calc.dim))
    for part in tqdm(parts, desc='wavevectors', delay=2, disable=None if len(parts) > 1 else True, leave=False):
        D = condensed(mass_weighted(calc.bloch_matrix(part, model), atoms.get_masses()), free)
        if vectors:
            squares, columns = np.linalg.eigh(D)
            columns = columns if len(columns[0]) == len(free) else free @ columns
            modes.append(columns.swapaxes(1, 2).reshape(*squares.shape, len(atoms), calc.dim))
        else:
            squares = np.linalg.eigvalsh(D)
        omega.append(signed_root(squares))
    return np.concatenate(omega), np.concatenate(modes) if vectors else None


def _wavevectors(q):
    q = finite('q', q)
    if q.shape[-1:] != (3,):
        raise ValueError(f'q must be wavevectors of three fractions, of the shape (wavevectors, 3), not {q.shape}')
    return q.reshape(-1, 3)


def _batches(wavevectors, size):
    return max(1, -(-wavevectors * size**2 * 16 // BATCH_BYTES))
