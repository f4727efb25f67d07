"""Small motion of a structure about its rest positions: masses, stiffness and free directions, computed once and passed on.

About a rest the equations of motion are linear,

    M u'' + H u = f        u = P v        P^T M P v'' + P^T H P v = P^T f

with the Hessian H, foundation included, and the orthonormal directions P that the constraints leave free.  With the masses
absorbed, y = (P^T M P)^{1/2} v,

    y'' + K y = S^T f      u = S y        S = M^{-1/2} P        K = S^T H S
"""

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy import sparse

from .calculator import MagneticRepulsion
from .constraints import free_directions
from .lowest import none_negative
from .repulsion import masses_of
from .rest import at_rest, nearest_rest, placed


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """The linear equations of motion of a structure about a rest.

    Every linear tool begins with `LinearSystem.of(atoms)`, and accepts such a system in place of the atoms: make it once for
    several questions about one structure.

    Attributes
    ----------
    atoms : ase.Atoms
        A copy of the structure at this rest, from which its calculator measures displacements.
    masses : ndarray, shape (particles,)
        In g.
    free : scipy.sparse.csr_array, shape (particles * dim, free)
        Orthonormal directions P that the constraints leave free, each of one particle.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> from magphonon.stiffness import LinearSystem
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> system = LinearSystem.of(patch)  # computed once, for several questions
    >>> len(modes(system).omega)
    38
    """

    atoms: Atoms
    masses: NDArray[np.float64]
    free: sparse.csr_array

    @classmethod
    def of(cls, atoms: 'Atoms | LinearSystem') -> 'LinearSystem':
        """The system about the present positions, where the forces must balance; a system is returned unchanged.

        Raises
        ------
        ValueError
            As for `magphonon.stiffness.rest.at_rest`: for another calculator, a constraint other than FixAtoms, FixedLine and
            FixedPlane, or if the forces do not balance.
        """
        return atoms if isinstance(atoms, LinearSystem) else cls.about(at_rest(atoms), atoms)

    @classmethod
    def nearest(cls, atoms: 'Atoms | LinearSystem') -> 'LinearSystem':
        """The system about the rest of a moving structure, `magphonon.stiffness.rest.nearest_rest`; forces need not balance."""
        return atoms if isinstance(atoms, LinearSystem) else cls.about(nearest_rest(atoms)[0], atoms)

    @classmethod
    def about(cls, calc: MagneticRepulsion, atoms: Atoms) -> Self:
        """The system about the reference of `calc`, whether or not the forces balance there."""
        atoms = placed(atoms, calc)
        return cls(atoms, masses_of(atoms), free_directions(atoms))

    def __len__(self) -> int:
        return len(self.masses)

    @property
    def calc(self) -> MagneticRepulsion:
        """The calculator, whose reference is the rest."""
        return self.atoms.calc  # pyright: ignore[reportReturnType]  which `about` has attached

    @property
    def dim(self) -> int:
        """Number of components of a displacement."""
        return self.calc.dim

    @cached_property
    def hessian(self) -> sparse.csr_array:
        """Hessian H of all particles in N/mm, of the calculator's `linear_model`."""
        return self.calc.rest_hessian(self.calc.linear_model)

    @cached_property
    def stiffness(self) -> sparse.csr_array:
        """Hessian of the free directions, `P^T H P`, in N/mm."""
        return sparse.csr_array(self.free.T @ self.hessian @ self.free)

    @cached_property
    def shapes(self) -> sparse.csr_array:
        """Displacements S for unit coordinates y, in g^-1/2, shape (particles * dim, free); forces enter as `S^T f`."""
        return sparse.csr_array(sparse.diags_array(1 / np.sqrt(np.repeat(self.masses, self.dim))) @ self.free)

    @cached_property
    def K(self) -> sparse.csr_array:
        """Matrix of squared frequencies, `S^T H S`, in rad^2/ms^2, shape (free, free)."""
        return sparse.csr_array(self.shapes.T @ self.hessian @ self.shapes)

    @cached_property
    def stable(self) -> bool:
        """Whether no mode grows: no squared frequency is negative, apart from round-off."""
        return none_negative(self.K)

    def moving(self) -> Self:
        """The same system, if at least one direction is free.

        Raises
        ------
        ValueError
            Otherwise: a structure that cannot move has no modes and no response.
        """
        if not self.free.shape[1]:
            raise ValueError('the constraints hold every particle; free one')
        return self

    def rows(self, particles: NDArray[np.int_]) -> tuple[NDArray[np.int_], sparse.csr_array]:
        """The free directions of some particles, and the part of `shapes` that belongs to both."""
        own = self.shapes[(particles[:, None] * self.dim + np.arange(self.dim)).ravel()]
        wanted = np.zeros(self.free.shape[1], bool)  # np.unique takes a hundred times as long
        wanted[own.indices] = True
        rows = np.flatnonzero(wanted)
        return rows, own[:, rows]
