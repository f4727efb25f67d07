"""Group velocities, and the speeds of sound in long waves."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from ..errors import finite
from ..stiffness.matrices import bloch_gradient, mass_weighted, signed_root
from ..stiffness.repulsion import repulsion_of
from ..stiffness.sites import each_spring
from .bands import _mean_over_crossings
from .bloch import _wavevectors, bloch_modes, cell_at_rest, cell_of_free_particles, in_batches

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray


def group_velocities(atoms: Atoms, q: ArrayLike, model: str = 'complete') -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Group velocities `dw/dk` by the analytic derivative of the Bloch matrix.

    For a mode v of frequency w, `2 w dw/dk = v^+ (dD/dk) v`.  At degenerate points the velocity depends on the
    direction of approach; there the mean of the crossing branches is returned for each.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion.
    q, model
        As for `bloch_modes`.

    Returns
    -------
    omega : ndarray, shape (wavevectors, modes)
        In rad/ms.
    velocity : ndarray, shape (wavevectors, modes, dim)
        In mm/ms = m/s; NaN where the frequency is zero or imaginary.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, group_velocities, lattices
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=1.0)
    >>> omega, velocity = group_velocities(cell, [[0.1, 0.2, 0.0]])
    >>> omega.shape, velocity.shape
    ((1, 2), (1, 2, 2))
    """
    repulsion_of(atoms)
    calc: Any = cell_at_rest(atoms)[0]  # one whose bonds are known
    K, masses = calc.rest_stiffness(model), atoms.get_masses()
    omegas, slopes = [], []
    for part in in_batches(_wavevectors(q), calc):
        omega, vectors = bloch_modes(atoms, part, model, vectors=True)
        v = vectors.reshape(*omega.shape, -1)
        gradient = mass_weighted(bloch_gradient(calc.bonds, K, part, atoms.cell.array), masses)
        omegas.append(omega)
        slopes.append(np.einsum('qma,xqab,qmb->qmx', v.conj(), gradient, v).real)
    omega = np.concatenate(omegas)
    slope = _mean_over_crossings(omega, np.concatenate(slopes))
    with np.errstate(divide='ignore', invalid='ignore'):
        velocity = slope / (2 * omega[..., None])
    velocity[omega <= 1e-6 * abs(omega).max()] = np.nan  # the root of a square's round-off
    return omega, velocity


def cut_off(atoms: Atoms) -> float | None:
    """The cut-off frequency of a lattice on a foundation or between walls: the lowest one at Gamma, below which long waves do not
    propagate.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion or AllNeighbours.

    Returns
    -------
    float or None
        In rad/ms; None without foundation and held particles, or if the foundation leaves a direction free, because long acoustic
        waves then propagate at any frequency.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene, units as u
    >>> from magphonon.bands import cut_off
    >>> round(u.hertz(cut_off(read_scene(ready_scene('prototype')).atoms())), 3)
    26.551
    """
    supported = each_spring(atoms.calc.foundation, len(atoms), atoms.calc.dim).reshape(len(atoms), -1).any(axis=0)
    if not (supported.all() or atoms.constraints):
        return None
    return float(bloch_modes(atoms, np.zeros((1, 3)))[0].min())


def sound_speeds(atoms: Atoms, direction: ArrayLike | None = None, model: str = 'complete') -> NDArray[np.float64]:
    """Speeds of sound along a direction, from the Bloch matrix to second order in k.

    With a foundation there is no acoustic branch; the speeds returned are those of the lattice without it.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its MagneticRepulsion or AllNeighbours.
    direction : array_like, shape (dim,), optional
        By default along x.
    model : {'complete', 'conventional'}

    Returns
    -------
    ndarray, shape (dim,)
        Ascending, in mm/ms = m/s; an unstable branch is negative, the square root of -c^2 with its sign.  Infinite
        where repulsion reaches so far that w/k grows without bound in long waves, as in Coulomb crystals.  NaN where
        a zero-stiffness mode of the unit cell (a mechanism) couples to the acoustic branch (the conventional kagome lattice).

    Raises
    ------
    ValueError
        For a direction of zero length or of another dimension, or held particles, which leave no uniform motion.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, sound_speeds
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 5.0))
    >>> (sound_speeds(cell) ** 2 * 8 / 3).round(9)  # a - 3 and 3 a - 1, times f L0/m
    array([ 2., 14.])
    """
    calc = cell_of_free_particles(atoms, 'speeds of sound are those')
    along = finite('direction', np.eye(calc.dim)[0] if direction is None else direction, (calc.dim,))
    if not along.any():
        raise ValueError(f'the direction must not be zero, not {along}')
    along = along / np.linalg.norm(along)
    masses = atoms.get_masses()
    dim = calc.dim
    A, B, C = (mass_weighted(term, masses) for term in calc.bloch_series(along, model))

    # the internal modes follow the translations u: second-order perturbation theory
    u = np.kron(np.sqrt(masses)[:, None], np.eye(dim)) / np.sqrt(masses.sum())
    internal = np.linalg.svd(u)[0][:, dim:]
    stiffness, modes = np.linalg.eigh(internal.T @ A @ internal)
    floppy = abs(stiffness) <= 1e-12 * abs(A).max()
    modes = internal @ modes
    follow = -modes[:, ~floppy] / stiffness[~floppy] @ modes[:, ~floppy].conj().T @ B @ u
    squares = u.T @ (C @ u + B @ follow)
    mechanism = modes[:, floppy].conj().T @ (C @ u + B @ follow)
    if abs(mechanism).max(initial=0) > 1e-9 * abs(squares).max():
        return np.full(dim, np.nan)
    endless, axes = np.linalg.eigh(calc.singular(along, model))
    regular = axes[:, abs(endless) <= 1e-12 * abs(endless).max()]
    ends = np.copysign(np.inf, endless[abs(endless) > 1e-12 * abs(endless).max()])
    return np.sort(np.append(signed_root(np.linalg.eigvalsh(regular.T @ squares @ regular)), ends))
