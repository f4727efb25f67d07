"""The directions that the constraints leave free, determined in one place for time steps, modes and limits."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from scipy import sparse

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import NDArray

TILT = 1e-12
"""Relative component of a direction below which it is round-off, as after a rotation in the plane or about the normal."""
HELD = 1e-12
"""Relative component of a blocked force below which it is round-off of the direction."""


def freedom(atoms: Atoms) -> tuple[NDArray[np.bool_], NDArray[np.int_], NDArray[np.float64]]:
    """The directions that the constraints leave free in the plane.

    Returns
    -------
    mobile : ndarray of bool, shape (particles,)
        False where FixAtoms holds the particle.
    guided : ndarray of int
        Particles that FixedLine or FixedPlane guides.
    barred : ndarray, shape (guided, 2, 2)
        For each of them, projector on the direction that is blocked.

    Raises
    ------
    ValueError
        For other constraints.
    """
    mobile = np.ones(len(atoms), bool)
    barred = {}
    for constraint in atoms.constraints:
        if type(constraint) not in (FixAtoms, FixedLine, FixedPlane):
            raise ValueError(f'only FixAtoms, FixedLine and FixedPlane are supported, not {constraint!r}')
        if isinstance(constraint, FixAtoms):
            mobile[constraint.index] = False
            continue
        if getattr(atoms.calc, 'dim', 2) == 3:
            raise ValueError(f'{constraint!r} guides a particle of a lattice in three dimensions, where only FixAtoms is '
                             'supported')
        d = np.where(abs(constraint.dir) > TILT, constraint.dir, 0.0)
        if not d[:2].any():  # it blocks no direction in the plane, or all of them
            if isinstance(constraint, FixedLine):
                mobile[constraint.index] = False
            continue
        if d[2] or set(constraint.index) & set(barred):
            raise ValueError(f'{constraint!r} guides a particle out of the plane, or one that is guided already')
        d = d[:2]
        dd = np.outer(d, d)
        barred |= dict.fromkeys(constraint.index.tolist(), np.eye(2) - dd if isinstance(constraint, FixedLine) else dd)
    guided = np.array([k for k in sorted(barred) if mobile[k] and barred[k].any()], int)
    return mobile, guided, np.array([barred[k] for k in guided]).reshape(-1, 2, 2)


def free_directions(atoms: Atoms) -> sparse.csr_array:
    """Orthonormal directions in which the constraints let particles move.

    Returns
    -------
    scipy.sparse.csr_array, shape (particles * dim, free)
        One direction of one particle in each column.  Directions held by constraints other than FixAtoms, FixedLine
        and FixedPlane count as free.
    """
    dim = atoms.calc.dim
    if not atoms.constraints:
        size = len(atoms) * dim
        return sparse.csr_array((np.ones(size), np.arange(size), np.arange(size + 1)))
    try:
        mobile, guided, barred = freedom(atoms)
    except ValueError:
        mobile, guided, barred = np.ones(len(atoms), bool), [], []
    blocks = np.zeros((len(atoms), dim, dim))
    blocks[mobile] = np.eye(dim)
    for particle, projector in zip(guided, barred, strict=True):
        along = np.linalg.eigh(projector)[1][:, 0]  # the direction that is not blocked
        blocks[particle] = [[along[0], 0], [along[1], 0]]
    free = sparse.csr_array(sparse.bsr_array((blocks, np.arange(len(atoms)), np.arange(len(atoms) + 1))))
    return free[:, np.flatnonzero(abs(free).sum(axis=0))]


def free_motion(atoms: Atoms) -> sparse.csr_array:
    """The `free_directions`, if all constraints are supported and at least one direction is free.

    Raises
    ------
    ValueError
        Otherwise.
    """
    freedom(atoms)  # refuses other constraints
    B = free_directions(atoms)
    if not B.shape[1]:
        raise ValueError('the constraints hold every particle; free one')
    return B


def refuse_held(forces: NDArray[Any], atoms: Atoms, what: str) -> None:
    """Refuse forces on particles, shape (particles, 3), that FixAtoms, FixedLine and FixedPlane block completely.

    A force that is blocked in part is accepted, such as a push on the rim too; only one without any effect is a mistake.

    Raises
    ------
    ValueError
        The message names `what` pushes, and the particles.
    """
    left = np.array(forces)
    for constraint in atoms.constraints:
        if isinstance(constraint, FixAtoms | FixedLine | FixedPlane):
            constraint.adjust_forces(atoms, left)
    largest = abs(forces).max(initial=0)
    if largest and abs(left).max() <= HELD * largest:
        pushed = np.flatnonzero(abs(forces).max(axis=1))
        raise ValueError(f'{what} pushes {f"particle {pushed[0]}" if len(pushed) == 1 else f"particles {pushed.tolist()}"} only '
                         'where constraints hold (FixAtoms, or FixedLine and FixedPlane across their free direction) and would '
                         'do nothing; push a particle that is free, or along its free direction')
