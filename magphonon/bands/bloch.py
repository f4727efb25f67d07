"""Squared frequencies and modes at any wavevectors, from the Bloch matrix (Eq. 18)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from ..errors import finite
from ..stiffness.matrices import mass_weighted, signed_root
from ..stiffness.rest import settled

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

    from ..stiffness.repulsion import Repulsion

BATCH_BYTES = 2**26  # of Bloch matrices diagonalised at a time; the whole of a large zone need not fit in memory


def cell_of_free_particles(atoms: Atoms) -> Repulsion:
    """The MagneticRepulsion or AllNeighbours, at rest, of a cell all of whose particles move, as the bands suppose.

    Raises
    ------
    ValueError
        If there is none, the cell holds a constraint, or its particles are not at rest where they are
        (`magphonon.stiffness.rest`).
    """
    if atoms.constraints:
        raise ValueError(f'the cell holds the constraint {atoms.constraints[0]}, but bands are those of free particles; '
                         'remove it with atoms.set_constraint()')
    return settled(atoms).calc  # pyright: ignore[reportReturnType]  of which `settled` has made sure


def bloch_modes(atoms: Atoms, q: ArrayLike, model: str = 'complete',
                vectors: bool = False) -> tuple[NDArray[np.float64], NDArray[np.complex128] | None]:
    """Squared frequencies of a periodic structure at any wavevectors.

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

    Raises
    ------
    ValueError
        For an unknown model, a wavevector that is not finite, or atoms without MagneticRepulsion.
    """
    calc = cell_of_free_particles(atoms)
    q = _wavevectors(q)
    omega, modes = [], []
    parts = np.array_split(q, _batches(len(q), len(atoms) * calc.dim))
    for part in tqdm(parts, desc='wavevectors', delay=2, disable=None if len(parts) > 1 else True, leave=False):
        D = mass_weighted(calc.bloch_matrix(part, model), atoms.get_masses())
        if vectors:
            squares, columns = np.linalg.eigh(D)
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
