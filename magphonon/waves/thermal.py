"""Stiffness of waves from thermal motion: a wave with the wavevector q has the stiffness k(q) = kT/<|u_q|^2>.

With the window h over the particles, and the modes e and the Bloch matrix D(q) of the linear lattice,

    u_q = sum_j h_j u_j e^{-i k.R_j}/sqrt(sum h^2)       C = <u_q u_q^+> - <u_q><u_q>^+       w^2 = e^+ M^-1/2 kT C^-1 M^-1/2 e

Gyroscopic forces do no work, so <u u> does not depend on them, and these are frequencies without them. By equipartition harmonic
forces have C = kT D^-1 at any temperature; a deviation that grows with kT shows anharmonic forces. Two effects bias the result,
and are subtracted:

- few frames: the inverse of a mean of M frames is too large by a fraction of about n/M.  The frames, in order, are cut into
  segments longer than the memory of the motion; leaving out one segment at a time gives this bias, and the error (jackknife).
- a window: waves of all q' within 1/width of q take part.  The bias follows from the linear stiffness, which is known.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from ..bands.bloch import bloch_modes, wavevectors
from ..errors import PhysicsError, finite, positive
from ..lattices.bonds import image_of
from ..results import InHertz, Saved
from ..stiffness.factors import factorised
from ..stiffness.rest import LinearSystem
from ..traits import LINEAR, takes
from .fields import hull_window

SEGMENTS = 20  # number of segments of a record; their scatter gives the error with the relative accuracy 1/sqrt(2 SEGMENTS)
FITS = 1e-6  # periods by which a wave may miss the supercell
SLACK = 1e-6  # share of the highest frequency below which one is zero
FEWEST = 5  # frames of a segment


@dataclass(frozen=True)
class ThermalBands(InHertz, Saved, kind='thermal bands', units={
    'q': ('reciprocal vectors', 'wavevectors', 'vectors'), 'omega': ('rad/ms', 'wavevectors', 'branches'),
    'error': ('rad/ms', 'wavevectors', 'branches'), 'bias': ('rad/ms', 'wavevectors', 'branches'),
    'linear': ('rad/ms', 'wavevectors', 'branches'),
}):
    """Frequencies of the modes of the linear lattice in thermal motion, from the stiffness of thermal waves.

    Attributes
    ----------
    q : ndarray, shape (wavevectors, 3)
        In fractions of the reciprocal vectors.
    omega : ndarray, shape (wavevectors, branches)
        In rad/ms, after subtracting the bias. They are the frequencies for B = 0, because thermal averages do not depend on
        gyroscopic forces.
    error : ndarray, shape (wavevectors, branches)
        One standard error of omega.
    bias : ndarray, shape (wavevectors, branches)
        The bias that was subtracted, due to few frames and window together.
    linear : ndarray, shape (wavevectors, branches)
        Frequencies of the linear lattice, for comparison.
    """

    q: np.ndarray
    omega: np.ndarray
    error: np.ndarray
    bias: np.ndarray
    linear: np.ndarray


@takes(*LINEAR)
def thermal_bands(atoms: Atoms | LinearSystem, displacements: ArrayLike, temperature_mJ: float, cell: Atoms, q: ArrayLike,
                  particles: ArrayLike | None = None) -> ThermalBands:
    """Frequencies of thermal waves from a record of thermal motion, whose variance gives their stiffness.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        The supercell or the patch that moved, with its PairCalculator; its present positions do not matter.
    displacements : array_like, shape (frames, particles, dim)
        Displacements from rest, in mm, in thermal equilibrium from the first frame.
    temperature_mJ : float
        The thermal energy kT.
    cell : ase.Atoms
        One cell of the lattice, with its PairCalculator.
    q : array_like, shape (wavevectors, 3)
        In fractions of the reciprocal vectors of the cell; in a periodic supercell they must fit into it.
    particles : array_like of int, optional
        The recorded particles; all if not given. For a patch, or if some are missing, a Hann window extends from edge to edge.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.waves import thermal_bands
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=8.0)
    >>> atoms = cell.repeat((4, 4, 1))
    >>> atoms.calc = cell.calc.on(atoms)
    >>> kT, K = 1e-6, atoms.calc.rest_hessian().toarray()
    >>> moved = np.random.default_rng(0).multivariate_normal(np.zeros(32), kT * np.linalg.inv(K), 400)  # in place of a camera
    >>> found = thermal_bands(atoms, moved.reshape(400, 16, 2), kT, cell, [(0.5, 0, 0)])
    >>> bool((abs(found.omega - found.linear) < 4 * found.error).all())
    True
    """
    system, q = LinearSystem.nearest(atoms).balanced(), wavevectors(q)  # a record ends with moved atoms
    particles, u = system.recorded(particles), finite('displacements', displacements)
    if u.shape[1:] != (len(particles), system.dim):
        raise ValueError(f'displacements must have the shape (frames, {len(particles)}, {system.dim}), not {u.shape}')
    if len(u) < FEWEST * SEGMENTS:
        raise ValueError(f'{len(u)} frames are too few to estimate an error; record {FEWEST * SEGMENTS} or more')
    waves, masses = _waves(system, cell, q, particles), np.repeat(cell.get_masses(), system.dim)
    linear, shapes = bloch_modes(LinearSystem.of(cell).without_B(), q, vectors=True)
    for k in np.flatnonzero(linear.min(axis=1) <= SLACK * linear.max())[:1]:
        raise PhysicsError(f'nothing resists a wave at q = ({q[k, 0]:.4g}, {q[k, 1]:.4g}, {q[k, 2]:.4g}), as at Gamma without a '
                           'foundation; leave this wavevector out')
    shapes = shapes.reshape(*linear.shape, -1) / np.sqrt(masses)  # pyright: ignore[reportOptionalMemberAccess]  asked for
    recorded = (particles[:, None] * system.dim + np.arange(system.dim)).ravel()
    kT = positive('temperature_mJ', temperature_mJ, 'mJ')

    def squares(C):
        """Squared frequencies from matrices <u_q u_q^+>, shape (..., wavevectors, rows, rows)."""
        return kT * np.einsum('qbi,...qij,qbj->...qb', shapes.conj(), np.linalg.inv(C), shapes).real

    def of_record(u):
        """Squared frequencies from all frames, and from the record without each segment."""
        parts = np.array_split(np.einsum('qrp,fp->fqr', waves[:, :, recorded].conj(), u.reshape(len(u), -1)), SEGMENTS)
        sums = zip(*((len(z), z.sum(axis=0), np.einsum('fqr,fqs->qrs', z, z.conj())) for z in parts), strict=True)
        n, mean, C = (np.concatenate([x.sum(axis=0)[None], x.sum(axis=0) - x]) for x in map(np.array, sums))
        n = n[:, None, None]
        return squares(C / n[..., None] - (mean / n)[..., None] * (mean / n).conj()[..., None, :])

    found = of_record(u)
    whole, left = found[0], found[1:]
    found = SEGMENTS * whole - (SEGMENTS - 1) * left.mean(axis=0)
    error = np.sqrt((SEGMENTS - 1) * left.var(axis=0))
    seen = linear**2 / squares(kT * waves.conj() @ _compliant(system, waves))
    omega = np.sqrt(np.maximum(found * seen, 0))
    error = error * seen / (2 * np.sqrt(np.maximum(found * seen, error * seen)))
    return ThermalBands(q, omega, error, np.sqrt(whole) - omega, linear)


def fits(q: NDArray[np.float64], repeats: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether each wave is periodic over the vectors of a supercell, given in vectors of the cell, shape (vectors, 3)."""
    across = q @ repeats.T
    return abs(across - np.rint(across)).max(axis=1) < FITS


def _waves(system, cell, q, particles):
    """Matrices that take displacements to u_q^*, shape (wavevectors, rows of the cell, rows of the structure)."""
    atoms, dim = system.atoms, system.dim
    home = image_of(cell, atoms)
    n = (atoms.positions - cell.positions[home]) @ np.linalg.inv(cell.cell.array)
    h = np.zeros(len(atoms))
    if atoms.pbc.any() and len(particles) == len(atoms):
        for k in np.flatnonzero(~fits(q, (atoms.cell.array @ np.linalg.inv(cell.cell.array))[atoms.pbc]))[:1]:
            raise ValueError(f'the wave q = ({q[k, 0]:.4g}, {q[k, 1]:.4g}, {q[k, 2]:.4g}) does not fit into the supercell; '
                             'choose wavevectors whose waves do, or a supercell of other repeats')
        h[:] = 1
    elif dim == 2 and len(particles) > 2:
        h[particles] = hull_window(atoms.positions[particles, :2], system.calc.bonds.lengths.min())[0]
    else:
        raise ValueError('a window needs points of a plane; record all particles of a periodic supercell')
    h = h * system.mobile
    rows = (home == np.arange(len(cell))[:, None]) * h
    rows /= np.linalg.norm(rows, axis=1)[:, None]
    waves = np.einsum('kp,qp->qkp', rows, np.exp(2j * np.pi * q @ n.T))
    return np.einsum('qkp,xy->qkxpy', waves, np.eye(dim)).reshape(len(q), len(cell) * dim, -1)


def _compliant(system, waves):
    """Static displacements under the forces `waves`, shape (wavevectors, rows, rows of the structure), last two axes swapped."""
    P, forces = system.free, waves.reshape(-1, waves.shape[-1]).T
    moved = P @ factorised(system.stiffness, definite=True).solve(P.T @ forces)
    return moved.T.reshape(waves.shape).swapaxes(1, 2)
