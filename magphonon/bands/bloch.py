"""Squared frequencies and modes at any wavevectors, from the Bloch matrix (Eq. 18)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy import sparse
from scipy.linalg import eigh
from tqdm import tqdm

from ..errors import finite, whole
from ..stiffness.lowest import inverse_pays, lowest_eigenpairs
from ..stiffness.matrices import gyrating_modes, hermitian_eigenvalues, hessian, signed_root
from ..stiffness.rest import LinearSystem

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


def bloch_modes(atoms: Atoms | LinearSystem, q: ArrayLike, model: str = 'complete', vectors: bool = False,
                branches: int | None = None) -> tuple[NDArray[np.float64], NDArray[np.complex128] | None]:
    """Frequencies of a periodic structure at any wavevectors, of waves `e^{i(k.R - omega t)}`.

    Held particles, FixAtoms, do not move: a strip between walls or a ribbon with a held edge has one mode for each direction
    that FixAtoms, FixedLine and FixedPlane leave free.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        One cell with its MagneticRepulsion or AllNeighbours.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    model : {'complete', 'conventional'}
    vectors : bool
        Compute the modes too.
    branches : int, optional
        Number of lowest branches to compute, in cells of hundreds of particles without a full diagonalisation
        (`magphonon.stiffness.lowest`); all branches if not given.

    Returns
    -------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms, unstable modes negative.  Of particles that gyrate those at -q are others.
    vectors : ndarray of complex, shape (wavevectors, modes, particles, dim), or None
        Normalised to one and weighted with the square root of the mass; zero on held particles.  Of particles that gyrate they
        are not orthogonal.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.bands import bloch_modes
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> omega, shapes = bloch_modes(cell, [[0.5, 0, 0], [0.1, 0.2, 0]], vectors=True)
    >>> omega.shape, shapes.shape
    ((2, 2), (2, 2, 1, 2))
    """
    system, q = LinearSystem.of(atoms, gyrating=True).moving(), wavevectors(q)
    calc: Any = system.atoms.calc
    count = every = system.directions
    parts = _by_lapack(system, q, model, vectors)
    if branches is not None:
        count = whole('branches', branches)
        if count > every:
            raise ValueError(f'the cell has {every} branches, not {count}')
        if len(q) and calc.pairwise and not system.gyration.any() and inverse_pays(every, count, real=False):
            parts = _lowest_by_inverse(system, q, model, count, vectors)
    squares, columns = zip(*parts, strict=True)
    omega = signed_root(np.concatenate(squares)[:, :count])
    if not vectors:
        return omega, None
    modes = np.concatenate([part[..., :count].swapaxes(1, 2) for part in columns])
    return omega, modes.reshape(*omega.shape, len(system), system.dim)


def _by_lapack(system, q, model, vectors):
    """All squared frequencies of batches of wavevectors, shape (batch, modes), and the columns of modes or None."""
    parts, B = in_batches(q, system.atoms.calc), system.B().toarray() if system.gyration.any() else None
    for part in tqdm(parts, desc='wavevectors', delay=2, disable=None, leave=False) if len(parts) > 1 else parts:
        K = system.bloch(part, model)
        if B is not None:
            omega, columns = gyrating_modes(B, K)
            yield omega * abs(omega), system.free.toarray() @ columns
            continue
        if not vectors:
            yield hermitian_eigenvalues(K), None
            continue
        if K.shape[-1] <= DIVIDE or not len(K):
            squares, columns = np.linalg.eigh(K)
        else:
            squares, columns = map(np.stack, zip(*map(eigh, K), strict=True))
        yield squares, system.free.toarray() @ columns if system.atoms.constraints else columns


def _lowest_by_inverse(system, q, model, count, vectors):
    """The same for the lowest modes, one wavevector after the other; each result is the first estimate of the next."""
    calc, S, squares = system.calc, system.shapes, None
    K = calc.rest_stiffness(model)
    for at in tqdm(q, desc='wavevectors', delay=2, disable=None, leave=False):
        D = sparse.csr_array(S.T @ hessian(calc.bonds, K, calc.foundation, at) @ S)
        squares, columns = lowest_eigenpairs(D, count, squares)
        yield squares[None], (system.free @ columns)[None] if vectors else None


def wavevectors(q: ArrayLike) -> NDArray[np.float64]:
    """The wavevectors as an array, shape (wavevectors, 3), or ValueError unless they are finite and of three fractions each."""
    q = finite('q', q)
    if q.shape[-1:] != (3,):
        raise ValueError(f'q must be wavevectors of three fractions, of the shape (wavevectors, 3), not {q.shape}')
    return q.reshape(-1, 3)


def in_batches(q: NDArray[np.float64], calc: Repulsion) -> list[NDArray[np.float64]]:
    """The wavevectors in parts for which the largest array, matrices or phases of bonds, takes BATCH_BYTES or little more."""
    numbers = max((len(calc.reference) * calc.dim) ** 2, calc.bonds.i.size)
    parts = min(len(q), -(-len(q) * numbers * 16 // BATCH_BYTES))  # no part is empty
    return np.array_split(q, parts) if parts > 1 else [q]
