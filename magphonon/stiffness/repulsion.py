"""`Repulsion`: the protocol of both calculators, and the function that returns the calculator of atoms."""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol, runtime_checkable

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..errors import positive
from ..interactions.pair_laws import PairInteraction, PairLaw
from ..lattices.bonds import Bonds

if TYPE_CHECKING:
    from typing import Any

    from ..interactions.bond_laws import Laws
    from .calculator import MagneticRepulsion
    from .sites import Foundation


@runtime_checkable
class Repulsion(Protocol):
    """Common interface of `MagneticRepulsion` and `AllNeighbours`: particles that repel each other, on a foundation.

    Bands, speeds of sound, phonopy's finite displacements and buckling use only this interface, and accept both calculators.
    Every Bloch matrix already contains the foundation.

    Attributes
    ----------
    reference : ase.Atoms
        The positions from which displacements are measured, without a calculator.
    laws : PairLaw or PairInteraction, or mapping from pairs of kinds to them
        As they were given.
    law : PairLaw
        The law of every bond: it gives one number for each of them.
    interaction : PairInteraction
        Energy, gradient and stiffness of every bond, by its vector.
    bonds : Bonds
        The pairs that repel each other; for an infinite lattice, the nearest ones.
    pairwise : bool
        Whether the listed bonds are the complete repulsion.  Only then is the stiffness known bond by bond: for finite
        structures, at other positions or other spacings.
    dim : int
        Number of components of a displacement: 2 in the plane, 3 in space.
    layer : bool
        Whether the particles of a planar structure may move out of the plane, each on its own support.
    foundation : float or ndarray, shape (particles, dim)
        Stiffness of the spring between each particle and its anchor, N/mm.
    model, linear_model : str
        The model of the forces, and the model of their stiffness at rest.
    bloch_models : tuple of str
        The models that have a Bloch matrix.
    """

    @property
    def reference(self) -> Atoms:
        """Positions from which displacements are measured."""
        ...

    @property
    def laws(self) -> Laws:
        """The pair law, or the laws of pairs of kinds."""
        ...

    @property
    def law(self) -> PairLaw:
        """The pair law of each bond."""
        ...

    @property
    def interaction(self) -> PairInteraction:
        """The interaction of each bond, by its vector."""
        ...

    @property
    def bonds(self) -> Bonds:
        """Pairs that repel each other."""
        ...

    @property
    def pairwise(self) -> bool:
        """Whether the listed bonds are the complete repulsion."""
        ...

    @property
    def dim(self) -> int:
        """Number of components of a displacement."""
        ...

    @property
    def layer(self) -> bool:
        """Whether particles of a plane may move out of it."""
        ...

    @property
    def foundation(self) -> Foundation:
        """Stiffness of the foundation in N/mm."""
        ...

    @property
    def model(self) -> str:
        """Model of the forces."""
        ...

    @property
    def linear_model(self) -> str:
        """Model of the stiffness at rest, 'complete' or 'conventional'."""
        ...

    @property
    def bloch_models(self) -> tuple[str, ...]:
        """Models that have a Bloch matrix."""
        ...

    def on(self, supercell: Atoms) -> Repulsion:
        """The same calculator on a supercell of its reference."""
        ...

    def displacements(self, atoms: Atoms) -> NDArray[np.float64]:
        """Displacements from the reference in mm, shape (particles, dim)."""
        ...

    def bloch_matrix(self, q: NDArray[np.float64], model: str = 'complete') -> NDArray[np.complex128]:
        """Bloch matrix at the reference, foundation included, N/mm; `q` of shape (wavevectors, 3)."""
        ...

    def bloch_series(self, along: NDArray[np.float64], model: str = 'complete') -> tuple[NDArray[np.complex128], ...]:
        """The Bloch matrix without foundation to second order in the wavevector `along`, a unit vector."""
        ...

    def singular(self, along: NDArray[np.float64], model: str = 'complete') -> NDArray[np.float64]:
        """Signs of the terms that exceed the second order in long waves, shape (dim, dim); zero for laws of short range."""
        ...


def repulsion_of(atoms: Atoms) -> MagneticRepulsion:
    """The calculator of `atoms`, whose repulsion is known bond by bond; their masses are checked too.

    Returns
    -------
    MagneticRepulsion

    Raises
    ------
    ValueError
        If there is no such calculator, it is AllNeighbours, or a mass is not a positive number.
    """
    calc: Any = atoms.calc
    if not getattr(calc, 'pairwise', False):
        if not isinstance(calc, Repulsion):
            raise ValueError(f'the atoms carry {calc!r} as calculator; '
                             'attach atoms.calc = MagneticRepulsion(atoms, law, ...)')
        raise ValueError(f'this needs the stiffness of each bond, which {type(calc).__name__} does not have; '
                         'attach atoms.calc = MagneticRepulsion(atoms, law, ...) with a number of shells')
    masses_of(atoms)
    return calc  # pyright: ignore[reportReturnType]  what is pairwise is a MagneticRepulsion or like one


def masses_of(atoms: Atoms) -> NDArray[np.float64]:
    """Masses in g, shape (particles,).

    Raises
    ------
    ValueError
        For a mass that is not a positive number.
    """
    masses = atoms.get_masses()
    for k in np.flatnonzero(~(np.isfinite(masses) & (masses > 0)))[:1]:
        positive(f'mass of particle {k}', masses[k], 'g')
    return masses
