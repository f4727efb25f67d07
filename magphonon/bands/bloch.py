"""Squared frequencies and modes at any wavevectors, from the Bloch matrix (Eq. 18)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from tqdm import tqdm

from ..errors import finite, whole
from ..stiffness.lowest import hermitian_eigenvalues, inverse_pays, lowest_eigenpairs
from ..stiffness.matrices import hessian, mass_weighted, signed_root
from ..stiffness.rest import free_motion, settled

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

    from ..stiffness.repulsion import Repulsion

BATCH_BYTES = 2**22
"""Size in bytes of the largest array of the wavevectors that are treated at a time.  A large zone then need not fit in memory,
and arrays that fit in the processor's cache take two thirds of the time (measured with a mesh of the honeycomb)."""
DIVIDE = 400
"""Largest size of complex matrices for which NumPy's algorithm for eigenvectors (divide and conquer) is as fast as SciPy's
(relatively robust representations); at 800 it takes 1.3 times as long, at 1200 2.5 times."""


def cell_at_rest(atoms: Atoms) -> tuple[Repulsion, NDArray[np.float64]]:
    """The calculator of a cell, at rest, and the directions that its constraints leave free.

    Returns
    -------
    calc : MagneticRepulsion or AllNeighbours
    free : ndarray, shape (particles * dim, free)
        Orthonormal directions P, each of one particle; held particles, such as the walls of a channel, have no such direction.

    Raises
    ------
    ValueError
        If there is no such calculator, the constraints are others than FixAtoms, FixedLine and FixedPlane or hold everything, or
        the forces along free directions do not balance (`magphonon.stiffness.rest`).
    """
    calc: Any = settled(atoms).calc
    return calc, free_motion(atoms).toarray() if atoms.constraints else np.eye(len(atoms) * calc.dim)


def cell_of_free_particles(atoms: Atoms, what: str) -> Repulsion:
    """The calculator of a cell, at rest, all of whose particles are free, as `what` supposes.

    Raises
    ------
    ValueError
        As for `cell_at_rest`; also if the cell holds a constraint.
    """
    if atoms.constraints:
        raise ValueError(f'the cell holds the constraint {atoms.constraints[0]}, but {what} of free particles; '
                         'remove it with atoms.set_constraint()')
    return cell_at_rest(atoms)[0]


def condensed(D: NDArray[Any], free: NDArray[np.float64]) -> NDArray[Any]:
    """`P^T D P`: matrices of the free directions P, shape (..., free, free), while held particles stay at rest."""
    return D if free.shape[0] == free.shape[1] else free.T @ D @ free


def bloch_modes(atoms: Atoms, q: ArrayLike, model: str = 'complete', vectors: bool = False,
                branches: int | None = None) -> tuple[NDArray[np.float64], NDArray[np.complex128] | None]:
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
    branches : int, optional
        Number of lowest branches to compute, in cells of hundreds of particles without a full diagonalisation
        (`magphonon.stiffness.lowest_eigenpairs`); all branches if not given.

    Returns
    -------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms, unstable modes negative.
    vectors : ndarray of complex, shape (wavevectors, modes, particles, dim), or None
        Normalised to one and weighted with the square root of the mass; zero on held particles.

    Raises
    ------
    ValueError
        For an unknown model, a wavevector that is not finite, more branches than there are, or atoms without MagneticRepulsion.

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
    every = free.shape[1]
    count = every if branches is None else _at_most(every, branches)
    if len(q) and calc.pairwise and inverse_pays(every, count, real=False):
        parts = _lowest_by_inverse(calc, free, atoms.get_masses(), q, model, count, vectors)
    else:
        parts = _by_lapack(calc, free, atoms.get_masses(), q, model, vectors)
    squares, columns = zip(*parts, strict=True)
    omega = signed_root(np.concatenate(squares)[:, :count])
    if not vectors:
        return omega, None
    modes = np.concatenate([part[..., :count].swapaxes(1, 2) for part in columns])
    return omega, modes.reshape(*omega.shape, len(atoms), calc.dim)


def _by_lapack(calc, free, masses, q, model, vectors):
    """All squared frequencies of batches of wavevectors, shape (batch, modes), and the columns of modes or None."""
    parts = in_batches(q, calc)
    for part in tqdm(parts, desc='wavevectors', delay=2, disable=None, leave=False) if len(parts) > 1 else parts:
        D = condensed(mass_weighted(calc.bloch_matrix(part, model), masses), free)
        if not vectors:
            yield hermitian_eigenvalues(D), None
            continue
        squares, columns = _diagonalised(D)
        yield squares, columns if columns.shape[1] == len(free) else free @ columns


def _diagonalised(D):
    """Eigenvalues and eigenvectors of a stack of matrices."""
    if D.shape[-1] <= DIVIDE or not len(D):
        return np.linalg.eigh(D)
    squares, columns = zip(*(eigh(each) for each in D), strict=True)
    return np.stack(squares), np.stack(columns)


def _lowest_by_inverse(calc, free, masses, q, model, count, vectors):
    """The same for the lowest modes, one wavevector after the other; each result is the first estimate of the next."""
    S = sparse.diags_array(1 / np.sqrt(np.repeat(masses, calc.dim))) @ sparse.csr_array(free)
    K, squares = calc.rest_stiffness(model), None
    for at in tqdm(q, desc='wavevectors', delay=2, disable=None, leave=False):
        D = sparse.csr_array(S.T @ hessian(calc.bonds, K, calc.foundation, at) @ S)
        squares, columns = lowest_eigenpairs(D, count, squares)
        yield squares[None], (free @ columns)[None] if vectors else None


def _at_most(every, branches):
    if whole('branches', branches) > every:
        raise ValueError(f'the cell has {every} branches, not {branches}')
    return branches


def _wavevectors(q):
    q = finite('q', q)
    if q.shape[-1:] != (3,):
        raise ValueError(f'q must be wavevectors of three fractions, of the shape (wavevectors, 3), not {q.shape}')
    return q.reshape(-1, 3)


def in_batches(q: NDArray[np.float64], calc: Repulsion) -> list[NDArray[np.float64]]:
    """The wavevectors in parts for which the largest array, matrices or blocks of all bonds, takes BATCH_BYTES or little more."""
    numbers = max((len(calc.reference) * calc.dim) ** 2, len(calc.bonds) * calc.dim**2)
    parts = min(len(q), -(-len(q) * numbers * 16 // BATCH_BYTES))  # no part is empty
    return np.array_split(q, parts) if parts > 1 else [q]
