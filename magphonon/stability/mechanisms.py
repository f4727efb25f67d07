"""Motions that cost no energy: how many there are, and why nothing resists them.

A motion u costs no energy if `u^T K u = 0`. Sylvester's law of inertia counts them without computing any: they are the
eigenvalues of K below the round-off of the stiffest bond.  Three causes are told apart by counting again with another stiffness:

- with taut members in place of slack ones there are fewer: members are slack;
- with D0 in place of D0 + D* there are fewer: the static forces just cancel what bonds resist, the verge of buckling;
- otherwise it is a mechanism, which bonds do not resist.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from ..stiffness.lowest import DENSE, count_below
from ..stiffness.matrices import bloch_matrix, hessian

if TYPE_CHECKING:
    from ..stiffness.rest import LinearSystem

ZERO = 1e-12
"""Fraction of the stiffest bond or spring below which an eigenvalue costs no energy: a spring of 1e-9 of the bond is a stiffness,
even if 500 particles share it, and round-off, at 1e-15, is none."""
ALIKE = 1e-9  # of the largest singular value, below which a rotation moves nothing, such as that of a rod about itself
WAVES = 6  # wavevectors along each reciprocal vector; multiples of 6 meet M and K of the hexagonal lattices


@dataclass(frozen=True)
class FreeMotions:
    """Motions that cost no energy.

    Attributes
    ----------
    count : int
        Number of them besides rigid motions; of a lattice, at the wavevector that has most.
    rigid : int
        Translations and rotations of a finite structure that nothing resists; zero for a lattice.
    slack : int
        Number of slack members, if there are motions that they would resist if they were taut.
    verge : bool
        Whether bonds resist these motions, but static forces cancel the resistance.
    q : tuple of three floats
        The wavevector in fractions of the reciprocal vectors; zero for a finite structure.
    """

    count: int = 0
    rigid: int = 0
    slack: int = 0
    verge: bool = False
    q: tuple[float, ...] = (0.0, 0.0, 0.0)

    @property
    def whole(self) -> str:
        """The rigid motions, in words; empty if there are none."""
        return f', besides {self.rigid} rigid motion{"s" * (self.rigid > 1)} of the whole' if self.rigid else ''

    def words(self, where: str) -> str:
        """Why the structure is not stable `where` it moves."""
        at = f' at q = ({", ".join(f"{x:.4g}" for x in self.q)})' if any(self.q) else ''
        motions = f'{self.count} motion{"s" * (self.count > 1)}{at} cost{"s" * (self.count == 1)} no energy'
        if self.verge:
            return (f'It is on the verge of buckling{where}: {motions}, because the static forces cancel what bonds resist, so '
                    'that round-off would decide. Give it a foundation.')
        if self.slack:
            return (f'It is slack{where}: {motions}{self.whole}, which {self.slack} slack members would resist. Give them a '
                    'tension, or shorter rest lengths.')
        return f'It is a mechanism{where}: {motions}{self.whole}. Add members, a tension in the members, or a foundation.'


def free_motions(system: LinearSystem, free: sparse.csr_array, softest: NDArray[np.float64]) -> FreeMotions:
    """Motions along the directions `free`, shape (particles * dim, free), that cost no energy in a structure at rest.

    A lattice is examined on a mesh of wavevectors and at the `softest` one; if its cell has more than 200 degrees of freedom,
    only waves that fit into one or two cells.  A structure with negative eigenvalues buckles, and is not for this function.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import lattices
    >>> from magphonon.interactions import Spring
    >>> from magphonon.stability.mechanisms import free_motions
    >>> from magphonon.stiffness import LinearSystem, PairCalculator
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = PairCalculator(cell, Spring(1.0, 1.0))  # springs at their natural length
    >>> system = LinearSystem.of(cell)
    >>> found = free_motions(system, system.free, np.zeros(3))
    >>> found.count, found.q[:2], found.verge  # rows of springs slide along each other
    (1, (0.0, 0.16666666666666666), False)
    """
    calc, K = system.calc, system.calc.rest_stiffness('complete')
    largest = max(abs(K).max(initial=0.0), float(np.max(abs(np.asarray(calc.foundation)))))
    if not largest:
        return FreeMotions(free.shape[1], slack=len(K))
    waves = _waves(system.atoms.pbc, free.shape[1], softest)

    def counted(K, q=waves):
        return _count(calc.bonds, K / largest, calc.foundation / largest, free, q)

    found = counted(K)
    rigid = _rigid(system, free, largest)
    found[~waves.any(axis=1)] -= rigid
    rigid = 0 if system.atoms.pbc.any() else rigid
    most = found.argmax()
    if found[most] <= 0:
        return FreeMotions(rigid=rigid)
    q = waves[most : most + 1]
    slack = np.asarray(~K.any(axis=(1, 2)))
    n = calc.bond_vectors[:, : calc.dim] / calc.bonds.lengths[:, None]
    taut = K + largest * (slack[:, None, None] * n[:, :, None] * n[:, None])
    here = counted(K, q)
    return FreeMotions(int(found[most]), rigid, int(slack.sum()) if counted(taut, q) < here else 0,
                       bool(counted(calc.rest_stiffness('conventional'), q) < here), tuple(waves[most].tolist()))


def self_stresses(system: LinearSystem) -> tuple[int, int]:
    """Number of states of self-stress of the bonds that act, and of floppy modes, motions that stretch none of them.

    By Maxwell and Calladine bonds less states are directions of motion less floppy modes; of a lattice both are those that are
    equal in all cells, and motion as a whole is a floppy mode.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stability.mechanisms import self_stresses
    >>> from magphonon.stiffness import LinearSystem
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> self_stresses(LinearSystem.of(cell))  # two rows, each tight without the other
    (2, 2)
    """
    calc, free = system.calc, system.free
    n = calc.bond_vectors / calc.bonds.lengths[:, None]
    acting = np.asarray(calc.rest_stiffness('complete').any(axis=(1, 2)))
    floppy = int(_count(calc.bonds, acting[:, None, None] * n[:, :, None] * n[:, None], 0.0, free, np.zeros((1, 3)))[0])
    return int(acting.sum()) - free.shape[1] + floppy, floppy


def _waves(pbc, size, softest):
    """The wavevectors at which motions are counted, shape (waves, 3), q = 0 first."""
    along = [np.arange(n) / n for n in np.where(pbc, 2 if size > DENSE else WAVES, 1)]
    q = np.stack(np.meshgrid(*along, indexing='ij'), axis=-1).reshape(-1, 3)
    return q if size > DENSE or not np.any(softest) else np.vstack([q, softest])


def _count(bonds, K, foundation, free, waves):
    """Number of eigenvalues below ZERO at each wavevector, if stiffnesses are fractions of the largest."""
    if free.shape[1] > DENSE:
        return np.array([count_below(free.T @ hessian(bonds, K, foundation, q) @ free, ZERO) for q in waves])
    P = free.toarray()
    return (np.linalg.eigvalsh(P.T @ bloch_matrix(bonds, K, waves, foundation) @ P) < ZERO).sum(axis=1)


def _rigid(system, free, largest):
    """Number of independent translations and rotations within the `free` directions that nothing resists."""
    atoms, calc, dim = system.atoms, system.calc, system.dim
    arms, periods = atoms.positions - atoms.positions.mean(axis=0), atoms.cell.array[atoms.pbc]
    arms /= abs(arms).max() or 1.0
    axes = (np.eye(3), periods, periods[:0], periods[:0])[len(periods)]  # a chain still turns about itself
    axes = axes / np.linalg.norm(axes, axis=1, keepdims=True)
    turns = [np.cross(axis, arms)[..., None] for axis in axes]
    moves = np.concatenate([np.tile(np.eye(3), (len(atoms), 1, 1)), *turns], axis=2)
    basis, size, _ = np.linalg.svd(moves[:, :dim].reshape(len(atoms) * dim, -1), full_matrices=False)
    basis = basis[:, size > ALIKE * size[0]]
    H = hessian(calc.bonds, calc.rest_stiffness('complete') / largest, calc.foundation / largest)
    resisted = np.vstack([basis - free @ (free.T @ basis), H @ basis])
    return basis.shape[1] - int((np.linalg.svd(resisted, compute_uv=False) > ZERO).sum())
