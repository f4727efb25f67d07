"""The rest about which a structure is linearised: positions where the forces in all free directions balance.

A particle has three positions: its anchor, where its foundation spring is slack; its position in the reference of the
calculator, from which displacements are measured; and its present position.  In a perfect lattice they coincide.  Linear
equations of motion are valid about positions where the forces balance, so all linear tools obtain these from this module:

    at_rest         the present positions, if the forces balance there; modes, responses, stability
    nearest_rest    the reference if the forces balance there, otherwise the present positions; a motion from a given state

Static forces are the same in all models: the force of a bond at its present length, along its present direction.

The directions that the constraints leave free, determined in one place for time steps, modes and limits.

Small motion of a structure about its rest positions: masses, stiffness and free directions, computed once and passed on.

About a rest the equations of motion are linear,

    M u'' + H u = f        u = P v        P^T M P v'' + P^T H P v = P^T f

with the Hessian H, foundation included, and the orthonormal directions P that the constraints leave free.  With the masses
absorbed, y = (P^T M P)^{1/2} v,

    y'' + K y = S^T f      u = S y        S = M^{-1/2} P        K = S^T H S
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Self

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from numpy.typing import NDArray
from scipy import sparse

from ..errors import NotAtRest
from .bond import sizes
from .calculator import MagneticRepulsion, same_cell
from .lowest import none_negative
from .repulsion import Repulsion, masses_of, repulsion_of

if TYPE_CHECKING:
    from typing import Any

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


ROUND_OFF = 1e-11
"""Fraction of the cancelling forces below which their sum is round-off."""
BALANCED = 1e-6
"""Largest force left at rest, as a fraction of the largest bond force.  It changes a linear result by about the same fraction."""
PLACES = 1e-14
"""Relative round-off of the positions, summed over the bonds of a particle.  It acts on springs that are slack at rest."""
ELSEWHERE = 1e-3
"""Distance from the reference, as a fraction of the shortest bond, from which balanced particles are at another rest; closer ones
may be displaced so little that their forces only seem balanced."""


def static_forces(calc: MagneticRepulsion, push: Any = 0.0, u: Any = 0.0) -> NDArray[np.float64]:
    """Forces of bonds, foundation, dead load and a constant push in N, shape (particles, dim); zero where they balance.

    The round-off of forces that cancel is set to zero; a load or push on balanced particles is kept, however small.

    Parameters
    ----------
    calc : MagneticRepulsion
    push : ndarray, shape (particles, 3)
        Constant forces of drives in N; none by default.
    u : ndarray, shape (particles, dim)
        Displacements from the reference in mm, at which particles are held still; none by default.
    """
    bonds, springs = calc.bonds, calc.spring_forces
    total = springs - calc.foundation * u
    size = (abs(springs).max(axis=1) + abs(total).max(axis=1))[:, None]
    if (bonds.i != bonds.j).any():  # its own images push a particle from both sides alike
        push_on_j = _repulsion(calc, u)
        strength = np.linalg.norm(push_on_j, axis=1)
        for end, sign in ((bonds.j, 1), (bonds.i, -1)):
            total += sign * np.array([np.bincount(end, x, bonds.particles) for x in push_on_j.T]).T
            size += np.bincount(end, strength, bonds.particles)[:, None]
    total[abs(total) <= ROUND_OFF * size] = 0
    for given in (calc.load, push) if np.ndim(push) else (calc.load,):
        if not given.any():
            continue
        given = components(given, calc.dim)
        # a load on balanced particles has nothing to cancel
        size = np.where(total, size, 0) + abs(given).max(axis=1, keepdims=True)
        total = total + given
        total[abs(total) <= ROUND_OFF * size] = 0
    return total


def _repulsion(calc, u):
    """Force of each bond on its particle j at the displacements u, in N, shape (bonds, dim)."""
    return -calc.interaction.forces(calc.bond_vectors + (calc.bonds.incidence @ u if np.ndim(u) else 0.0))[1]


def unbalanced(atoms: Atoms, u: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
    """The unbalanced static forces along free directions, in N, shape (particles,); zero if less than BALANCED.

    Parameters
    ----------
    atoms : ase.Atoms
    u : ndarray, shape (particles, dim)
        Displacements from the reference in mm.
    """
    calc: Any = atoms.calc
    forces = static_forces(calc, u=u)
    if not forces.any():
        return np.zeros(len(atoms))
    P = free_directions(atoms)
    left = np.linalg.norm((P @ (P.T @ forces.ravel())).reshape(forces.shape), axis=1)
    return left * (left > max(BALANCED * _largest_force(calc, u), _shaken(calc)))


def _largest_force(calc, u):
    R = calc.bond_vectors + (calc.bonds.incidence @ u if np.ndim(u) else 0.0)
    return sizes(R, calc.interaction)[0].max(initial=0.0)


def _shaken(calc):
    """The change of the force of the stiffest bond by round-off of the positions, in N."""
    lengths = calc.bonds.lengths
    size = max(abs(calc.reference.positions).max(), lengths.max(initial=0.0))
    return PLACES * size * sizes(calc.bond_vectors, calc.interaction)[1].max(initial=0.0)


def components(forces: NDArray[Any], dim: int) -> NDArray[Any]:
    """Components of forces in the dimensions of the structure, shape (..., dim); a force out of its plane is refused."""
    if dim == 2 and forces[..., 2].any():
        raise ValueError('a force pushes along z, but the structure is planar; give it a direction in the plane')
    return forces[..., :dim]


def loaded(atoms: Atoms, push: NDArray[np.float64]) -> Atoms:
    """A copy of the atoms with constant forces, in N, shape (particles, 3), added to the dead load of their calculator."""
    calc = repulsion_of(atoms)
    atoms = atoms.copy()
    atoms.calc = calc.about(calc.reference, calc.load + push)
    return atoms


def at_rest(atoms: Atoms) -> MagneticRepulsion:
    """The calculator about the present positions, where the forces balance.

    Parameters
    ----------
    atoms : ase.Atoms
        With MagneticRepulsion.

    Returns
    -------
    MagneticRepulsion
        The calculator of the atoms, or one whose reference is at their present positions.

    Raises
    ------
    ValueError
        If the forces do not balance: the message says by how much, on which particle, and what to do.  For constraints other
        than FixAtoms, FixedLine and FixedPlane, which are not supported.
    """
    atoms = _in_its_cell(atoms)
    calc: Any = atoms.calc
    freedom(atoms)
    u = calc.displacements(atoms)
    moved = u.any()
    left = unbalanced(atoms, u if moved else 0.0)
    if left.any():
        _refuse(atoms, u, left)
    return calc.about(atoms) if moved else calc


def settled(atoms: Atoms) -> Atoms:
    """The atoms with the calculator about their present positions, where the forces balance; see `at_rest`, also for its errors.

    A cell with AllNeighbours is returned unchanged; it must be in its reference, and the forces must balance.
    """
    if not getattr(atoms.calc, 'pairwise', True) and isinstance(atoms.calc, Repulsion):
        _refuse_unsettled_sums(atoms)
        return atoms
    calc = at_rest(atoms)
    return atoms if calc is atoms.calc else placed(atoms, calc)


def placed(atoms: Atoms, calc: MagneticRepulsion) -> Atoms:
    """A copy of the atoms at the reference of `calc`, with `calc`."""
    atoms = atoms.copy()
    atoms.positions[:, : calc.dim] = calc.reference.positions[:, : calc.dim]
    atoms.calc = calc
    return atoms


def nearest_rest(atoms: Atoms) -> tuple[MagneticRepulsion, NDArray[np.float64]]:
    """The calculator about the rest of a moving structure, whose positions are its state, and the unbalanced forces there.

    The rest is the reference if the forces balance there; the present positions, if the forces are smaller there, or if they
    are another rest, well away from the reference.

    Returns
    -------
    calc : MagneticRepulsion
    left : ndarray, shape (particles,)
        As `unbalanced`: zero at rest.
    """
    atoms = _in_its_cell(atoms)
    calc: Any = atoms.calc
    u, at_reference = calc.displacements(atoms), unbalanced(atoms)
    if not at_reference.any() and abs(u).max(initial=0.0) <= ELSEWHERE * calc.bonds.lengths.min():
        return calc, at_reference
    here = unbalanced(atoms, u)
    if here.max(initial=0.0) <= at_reference.max(initial=0.0):
        return calc.about(atoms), here
    return calc, at_reference


def rest_of_motion(atoms: Atoms, push: NDArray[np.float64]) -> MagneticRepulsion:
    """The calculator of `nearest_rest`; refused as by `at_rest` if the forces do not balance there.

    The constant forces `push` of drives, in N, shape (particles, 3), may be part of the balance.  On a structure that is at rest
    without them they act as a step.
    """
    freedom(atoms)
    calc, left = nearest_rest(atoms)
    if left.any():
        atoms = loaded(atoms, push)
        rest, left = nearest_rest(atoms)
        if left.any():
            _refuse(atoms, atoms.calc.displacements(atoms) * (rest is not atoms.calc), left)
        calc = rest.about(rest.reference, calc.load)
    return calc


def _in_its_cell(atoms):
    """The atoms, or if their cell differs from the reference a copy with a calculator for this cell."""
    calc = repulsion_of(atoms)
    return atoms if same_cell(calc, atoms) else placed(atoms, calc.about(atoms))


def _refuse_unsettled_sums(atoms):
    calc = atoms.calc
    masses_of(atoms)
    shortest = calc.bonds.lengths.min()
    away = np.linalg.norm(calc.displacements(atoms), axis=1).max()
    if away > ROUND_OFF * shortest:
        raise NotAtRest(f'particles are up to {away:.3g} mm away from the reference of AllNeighbours, whose sums hold only '
                         'there; make another one at these positions')
    if len(atoms) > 1:  # a single particle is in equilibrium by symmetry
        P, forces = free_directions(atoms), calc.get_forces(atoms)[:, : calc.dim]
        left = np.linalg.norm((P @ (P.T @ forces.ravel())).reshape(forces.shape), axis=1)
        if left.max() > BALANCED * abs(calc.law.dphi(calc.bonds.lengths)).max():
            raise NotAtRest('the cell is not at rest, and linear theory holds only about rest: a net static force of '
                             f'{left.max():.4g} N acts on particle {left.argmax()}; relax it with an optimiser of ASE, and make '
                             'AllNeighbours at the relaxed positions')


def _refuse(atoms, u, left):
    calc, k = atoms.calc, left.argmax()
    share = left[k] / (_largest_force(calc, u) or np.inf)
    mend = ('relax it, with magphonon.relaxed(atoms).atoms in Python or relaxed = true in the table [lattice] of a scene whose '
            'particles are in a file, or give the calculator the constant force that holds it, load= or '
            'atoms.calc.balanced(particles)')
    if np.any(u) and not unbalanced(atoms).any():
        mend = ('set the positions back to those of atoms.calc.reference, where the forces balance (up to '
                f'{np.linalg.norm(u, axis=1).max():.3g} mm away), or ' + mend)
    raise NotAtRest('the structure is not at rest, and linear theory holds only about rest: a net static force of '
                     f'{left[k]:.4g} N acts on particle {k}, {share:.3g} times the largest force in a bond, and '
                     f'{np.count_nonzero(left)} of {len(left)} particles are not in equilibrium; {mend}')


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
    def of(cls, atoms: Atoms | LinearSystem) -> LinearSystem:
        """The system about the present positions, where the forces must balance; a system is returned unchanged.

        Raises
        ------
        ValueError
            As for `magphonon.stiffness.rest.at_rest`: for another calculator, a constraint other than FixAtoms, FixedLine and
            FixedPlane, or if the forces do not balance.
        """
        return atoms if isinstance(atoms, LinearSystem) else cls.about(at_rest(atoms), atoms)

    @classmethod
    def nearest(cls, atoms: Atoms | LinearSystem) -> LinearSystem:
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
