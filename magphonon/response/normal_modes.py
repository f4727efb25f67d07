"""Normal modes of a structure about its rest, and the reduced problem from which all linear answers start.

About rest, with what the constraints hold left out and masses absorbed, the motion of a structure is

    y'' + gamma y' + K y = g(t)        y = B^T M^{1/2} u        K = B^T M^{-1/2} H M^{-1/2} B

with the orthonormal directions B in which particles are free.  Each answer is a function of the matrix K: of a small one
by its modes, of a large one by a Chebyshev series (`magphonon.response.chebyshev`), whose products with K serve all times and all
frequencies at once.
"""

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from ..errors import whole
from ..files import Saved
from ..stiffness.constraints import free_motion
from ..stiffness.matrices import signed_root
from ..stiffness.rest import at_rest
from .chebyshev import whole_interval

SMALL = 300
"""Degrees of freedom up to which a structure is diagonalised; above, products with its matrix are cheaper."""
ROUND_OFF = 1e-12
"""Of the highest squared frequency: what is left of one that is zero."""


@dataclass(frozen=True)
class Modes(Saved, kind='modes', units={
    'omega': ('rad/ms', 'modes'), 'shapes': ('g^-1/2', 'modes', 'particles', 'dim'),
}):
    """Natural frequencies and mode shapes of a structure.

    Attributes
    ----------
    omega : ndarray, shape (modes,)
        Ascending, in rad/ms; that of an unstable mode is minus its growth rate.
    shapes : ndarray, shape (modes, particles, dim)
        Displacements in g^-1/2, normalised so that `sum m u^2 = 1`.
    """

    omega: np.ndarray
    shapes: np.ndarray


@dataclass(frozen=True)
class Reduced:
    """A structure about rest, without what is held.

    Attributes
    ----------
    K : scipy.sparse.csr_array, shape (free, free)
        In rad^2/ms^2.
    shapes : scipy.sparse.csr_array, shape (particles * dim, free)
        M^{-1/2} B: displacements `u = shapes y`; forces enter as `shapes^T f`.
    dim : int
    """

    K: sparse.csr_array
    shapes: sparse.csr_array
    dim: int

    def rows(self, particles):
        """The free directions of some particles, and the part of `shapes` that belongs to both."""
        own = self.shapes[(particles[:, None] * self.dim + np.arange(self.dim)).ravel()]
        rows = np.unique(own.indices)
        return rows, own[:, rows]


def reduced(atoms):
    """Linearise a structure about its present positions, where the forces must balance.

    Parameters
    ----------
    atoms : ase.Atoms

    Returns
    -------
    Reduced

    Raises
    ------
    ValueError
        If there is another calculator, a constraint other than FixAtoms, FixedLine and FixedPlane, nothing is free, or the
        structure is not at rest.
    """
    return reduced_about(at_rest(atoms), atoms)


def reduced_about(calc, atoms):
    """The same about the reference of `calc`, whether or not the forces balance there."""
    B = free_motion(atoms)
    H = calc.rest_hessian(calc.linear_model)
    shapes = sparse.csr_array(sparse.diags_array(1 / np.sqrt(np.repeat(atoms.get_masses(), calc.dim))) @ B)
    return Reduced(sparse.csr_array(shapes.T @ H @ shapes), shapes, calc.dim)


def modes(atoms, count=None):
    """Natural frequencies and mode shapes about rest, within the constraints.

    Parameters
    ----------
    atoms : ase.Atoms
        With MagneticRepulsion.
    count : int, optional
        The lowest ones only, which a large structure finds without being diagonalised; all of them if not given.

    Returns
    -------
    Modes

    Raises
    ------
    ValueError
        If there are not as many modes, or the structure is not at rest.
    """
    scene = reduced(atoms)
    size = scene.K.shape[0]
    count = size if count is None else whole('count', count)
    if count > size:
        raise ValueError(f'the structure has {size} modes, not {count}')
    if size <= SMALL or count > size // 10:
        squares, vectors = np.linalg.eigh(scene.K.toarray())
    else:
        below = whole_interval(scene.K)
        squares, vectors = sparse.linalg.eigsh(scene.K, k=count, sigma=below.lowest - 1e-6 * below.highest,
                                               v0=np.random.default_rng(0).normal(size=size))
    order = np.argsort(squares)[:count]
    shapes = (scene.shapes @ vectors[:, order]).T.reshape(count, len(atoms), scene.dim)
    return Modes(signed_root(squares[order]), shapes)


def natural_frequencies(atoms):
    """Frequencies of all `modes` without their shapes, in a third of the time; ascending, in rad/ms, shape (modes,)."""
    return signed_root(np.linalg.eigvalsh(reduced(atoms).K.toarray()))


def sizes(shapes):
    """Displacement that one unit of each coordinate is, g^-1/2."""
    return np.sqrt(shapes.power(2).sum(axis=0))


def recorded(particles, count):
    """The particles wanted, as an array of indices."""
    if particles is None:
        return np.arange(count)
    particles = np.atleast_1d(particles)
    if not (np.issubdtype(particles.dtype, np.integer) and particles.min(initial=0) >= 0 and particles.max(initial=0) < count):
        raise ValueError(f'particles must be indices from 0 to {count - 1}, not {particles!r}')
    return particles
