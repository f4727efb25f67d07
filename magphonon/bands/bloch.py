"""Squared frequencies and modes at any wavevectors, from the Bloch matrix (Eq. 18); the first Brillouin zone."""

from __future__ import annotations

from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from ase.cell import Cell
from ase.geometry import minkowski_reduce
from numpy.typing import ArrayLike, NDArray
from scipy import sparse
from scipy.linalg import eigh
from scipy.spatial import Voronoi
from tqdm import tqdm

from ..errors import finite, whole
from ..stiffness.matrices import Model, companion, eigenvalues_of_two, hermitian_eigenvalues, hessian, lossless_modes, signed_root
from ..stiffness.plausibility import site_damping
from ..stiffness.rest import LinearSystem
from ..traits import LINEAR, takes

if TYPE_CHECKING:
    from ..stiffness.repulsion import Repulsion

PLANAR = (True, True, False)
BATCH_BYTES = 2**22
"""Size in bytes of the largest array of the wavevectors that are treated at a time.  A large zone then need not fit in memory,
and arrays that fit in the processor's cache take two thirds of the time (measured with a mesh of the honeycomb)."""
ROUND_OFF = 1e-7  # fraction of the fastest rate below which one is zero: poles that nearly meet are known to its root
EPS = np.finfo(float).eps
MOTIONS = 'transverse', 'longitudinal'  # of the lower and the higher branch of one particle to the cell
DIVIDE = 400
"""Largest size of complex matrices for which NumPy's algorithm for eigenvectors (divide and conquer) is as fast as SciPy's
(relatively robust representations); at 800 it takes 1.3 times as long, at 1200 2.5 times."""


@takes(*LINEAR, 'all neighbours')
def bloch_modes(atoms: Atoms | LinearSystem, q: ArrayLike, model: Model | None = None, vectors: bool = False,
                branches: int | None = None) -> tuple[NDArray[np.float64], NDArray[np.complex128] | None]:
    """Frequencies of a periodic structure at any wavevectors, of waves `e^{i(k.R - omega t)}`.

    Particles held by FixAtoms do not move: a strip between walls or a ribbon with a held edge has one mode for each direction
    that FixAtoms, FixCartesian, FixedLine and FixedPlane leave free.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        One cell with its PairCalculator or AllNeighbours.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.
    vectors : bool
        Compute the modes too.
    branches : int, optional
        Number of lowest branches to compute; all if not given. Large cells then need no full diagonalisation
        (`magphonon.stiffness.lowest`).

    Returns
    -------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms; negative for unstable modes. If forces depend on velocity (`LinearSystem.B`), frequencies at q and -q differ.
    vectors : ndarray of complex, shape (wavevectors, modes, particles, dim), or None
        Normalised to one and weighted with the square root of the mass; zero on held particles.  They are orthogonal where B = 0.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import bloch_modes
    >>> cell = read_scene(ready_scene('ideal')).atoms()
    >>> omega, shapes = bloch_modes(cell, [[0.5, 0, 0], [0.1, 0.2, 0]], vectors=True)
    >>> omega.shape, shapes.shape
    ((2, 2), (2, 2, 1, 2))
    """
    system, q = LinearSystem.of(atoms).moving(), wavevectors(q)
    count = system.directions if branches is None else whole('branches', branches)
    if count > system.directions:
        raise ValueError(f'the cell has only {system.directions} branches, not {count}; ask for fewer')
    squares, columns = zip(*_solved(system, q, model, count, vectors), strict=True)
    omega = signed_root(np.concatenate(squares)[:, :count])
    if not vectors:
        return omega, None
    modes = np.concatenate([part[..., :count].swapaxes(1, 2) for part in columns])
    return omega, modes.reshape(*omega.shape, len(system), system.dim)


def _solved(system, q, model, count, vectors):
    """Yield squares of frequencies and modes, of all branches or of `count` of them, by the method that is fastest."""
    plain = system.atoms.calc.pairwise and not system.turning
    if plain and len(q) and count < system.directions and _inverse_pays(system.directions, count):
        return _lowest_by_inverse(system, q, model, count, vectors)
    if plain and not vectors and len(system) == 1 and system.directions == 2 == system.dim:
        return _of_one_particle(system, q, model)
    return _by_lapack(system, q, model, vectors)


def branch_names(particles: int) -> tuple[str, ...]:
    """Names of the branches of a planar lattice in tables of ridges, the lowest first; `particles` is their number in a cell."""
    return MOTIONS if particles == 1 else tuple(f'branch {k + 1}' for k in range(2 * particles))


@takes(*LINEAR, 'all neighbours')
def damped_modes(atoms: Atoms, q: ArrayLike, damping: ArrayLike, model: Model | None = None,
                 vectors: bool = False) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.complex128] | None]:
    """Frequencies and decays of a periodic structure with losses, whose modes move as `e^{-(decay + i omega) t}`.

    The arguments are those of `bloch_modes`, and the `damping`, a force per momentum in 1/ms, for all particles or of shape
    (particles,). It returns omega in rad/ms and decay in 1/ms, both of shape (wavevectors, modes), and the vectors of
    `bloch_modes`. omega ascends; it is zero for an overdamped mode, and minus the rate of growth for a mode that grows. Of the
    two decays of an overdamped mode, the slower one is returned.
    """
    system, q = LinearSystem.of(atoms).moving(), wavevectors(q)
    calc: Any = system.atoms.calc
    gamma = site_damping(damping, len(system), calc)
    if not (np.ptp(gamma) or system.turning):  # all modes have the same damping
        omega, modes = bloch_modes(system, q, model, vectors)
        squares, half = np.sign(omega) * omega**2, gamma[0] / 2
        under = np.sqrt(abs(squares - half**2))
        slow = np.divide(squares, half + under, out=np.zeros_like(omega), where=half + under > 0)  # half - under, uncancelled
        swings = squares > half**2
        return np.where(swings, under, slow.clip(max=0)), np.where(swings, half, slow), modes
    B, n, found = system.B(gamma).toarray(), system.directions, []
    for K in (system.bloch(part, model) for part in in_batches(q, calc)):
        s, z = np.linalg.eig(companion(B, K))
        z = z[:, :n] / np.linalg.norm(z[:, :n], axis=1, keepdims=True)
        rate, turn = np.real(s), -np.imag(s)  # of waves e^{i(k.R - omega t)}
        real = abs(turn) < ROUND_OFF * abs(s).max()
        best = np.lexsort((-rate, -np.where(real, 0, turn)), axis=-1)[:, :n]  # one of each pair; of real ones the slow half
        rate, turn, real = (np.take_along_axis(part, best, axis=1) for part in (rate, turn, real))
        omega = np.where(real, 0.0 - rate.clip(min=0), turn)
        decay = np.where(abs(rate) > EPS * abs(s).max() * n, -rate, 0.0)
        order = np.lexsort((decay, omega), axis=-1)
        shapes = np.take_along_axis(np.take_along_axis(z, best[:, None], axis=2), order[:, None], axis=2)
        found.append((np.take_along_axis(omega, order, axis=1), np.take_along_axis(decay, order, axis=1), shapes))
    omega, decay, shapes = (np.concatenate(parts) for parts in zip(*found, strict=True))
    modes = (system.free.toarray() @ shapes).swapaxes(1, 2).reshape(*omega.shape, len(system), system.dim)
    return omega, decay, modes if vectors else None


def _by_lapack(system, q, model, vectors):
    """All squared frequencies of batches of wavevectors, shape (batch, modes), and the columns of modes or None."""
    parts, B = in_batches(q, system.atoms.calc), system.B().toarray() if system.turning else None
    for part in tqdm(parts, desc='wavevectors', delay=2, disable=None, leave=False) if len(parts) > 1 else parts:
        K = system.bloch(part, model)
        if B is not None:
            omega, columns = lossless_modes(B, K)
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


def _of_one_particle(system, q, model):
    """Squared frequencies of a cell of one particle, for batches of wavevectors: K = k + sum_b (2 - 2 cos q.R_b) K_b."""
    calc, m = system.calc, system.masses[0]
    K = calc.rest_stiffness(model).reshape(-1, 4)[:, [0, 1, 3]] * (2 / m)
    kx, ky = (calc.foundation * np.ones((1, 2)))[0] / m
    own = K.sum(axis=0) + np.array([kx, 0, ky])
    lead = 2 * np.pi * calc.bonds.shift.T
    for part in in_batches(q, calc):
        a, b, c = own[:, None] - K.T @ np.cos(part @ lead).T
        yield eigenvalues_of_two(a, b, c), None


def _inverse_pays(size, count):
    from ..stiffness.lowest import inverse_pays  # imported late, because it is seldom used

    return inverse_pays(size, count, real=False)


def _lowest_by_inverse(system, q, model, count, vectors):
    """Lowest modes at one wavevector after the other; each result is the first estimate of the next."""
    from ..stiffness.lowest import lowest_eigenpairs

    calc, S, squares = system.calc, system.shapes, None
    K = calc.rest_stiffness(model)
    for at in tqdm(q, desc='wavevectors', delay=2, disable=None, leave=False):
        D = sparse.csr_array(S.T @ hessian(calc.bonds, K, calc.foundation, at) @ S)
        squares, columns = lowest_eigenpairs(D, count, squares)
        yield squares[None], (system.free @ columns)[None] if vectors else None


def first_zone(cell: ArrayLike) -> NDArray[np.float64]:
    """Corners of the first Brillouin zone, the Wigner-Seitz cell of the reciprocal lattice.

    Parameters
    ----------
    cell : array_like, shape (3, 3)
        Lattice vectors in rows, mm; the first two are those of the planar lattice.

    Returns
    -------
    ndarray, shape (corners, 2)
        Anticlockwise, in rad/mm.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.bands.bloch import first_zone
    >>> first_zone(lattices.triangular(1.0, 1.0).cell).shape  # six corners
    (6, 2)
    """
    b = 2 * np.pi * Cell(np.asarray(cell, dtype=float)).reciprocal().array
    reduced = minkowski_reduce(b, pbc=PLANAR)[0]  # pyright: ignore[reportArgumentType]  three pbc
    b = np.asarray(reduced)[:2, :2]  # of a reduced basis the eight nearest G bound the zone
    G = np.array(list(product((0, 1, -1), repeat=2))) @ b
    diagram = Voronoi(G)
    corners = diagram.vertices[diagram.regions[diagram.point_region[0]]]
    return corners[np.argsort(np.arctan2(corners[:, 1], corners[:, 0]))]


def wavevectors(q: ArrayLike) -> NDArray[np.float64]:
    """The wavevectors as an array, shape (wavevectors, 3); ValueError unless they are finite and have three fractions each."""
    q = finite('q', q)
    if q.shape[-1:] != (3,):
        raise ValueError(f'q must hold wavevectors of three fractions each, in the shape (wavevectors, 3), not {q.shape}')
    return q.reshape(-1, 3)


def in_batches(q: NDArray[np.float64], calc: Repulsion) -> list[NDArray[np.float64]]:
    """The wavevectors in batches, so that the largest array (matrices or phases of bonds) takes about BATCH_BYTES at most."""
    numbers = max((len(calc.reference) * calc.dim) ** 2, calc.bonds.i.size)
    parts = min(len(q), -(-len(q) * numbers * 16 // BATCH_BYTES))  # no part is empty
    return np.array_split(q, parts) if parts > 1 else [q]
