"""The rest about which a structure is linearised: positions where the forces in all free directions balance.

A particle has three positions: its anchor, where its foundation spring is slack; its position in the reference of the
calculator, from which displacements are measured; and its present position.  In a perfect lattice they coincide.  Linear
equations of motion are valid about positions where the forces balance, so all linear tools obtain these from this module:

    at_rest         the present positions, if the forces balance there; modes, responses, stability
    nearest_rest    the reference if the forces balance there, otherwise the present positions; a motion from a given state

Static forces are the same in all models: the force of a bond at its present length, along its present direction.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .bond import leaves_the_plane, upright_forces
from .cells import same_cell
from .constraints import free_directions, freedom
from .repulsion import Repulsion, masses_of, repulsion_of

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import NDArray

    from .calculator import MagneticRepulsion

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
    R, law = calc.bond_vectors + (calc.bonds.incidence @ u if np.ndim(u) else 0.0), calc.law
    if leaves_the_plane(law, R):
        return -upright_forces(R, law)[1]
    r = np.linalg.norm(R, axis=1)
    return -(law.dphi(r) / r)[:, None] * R


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
    return abs(calc.law.dphi(np.linalg.norm(R, axis=1))).max(initial=0.0)


def _shaken(calc):
    """The change of the force of the stiffest bond by round-off of the positions, in N."""
    lengths = calc.bonds.lengths
    size = max(abs(calc.reference.positions).max(), lengths.max(initial=0.0))
    return PLACES * size * abs(calc.law.d2phi(lengths)).max(initial=0.0)


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
        raise ValueError(f'particles are up to {away:.3g} mm away from the reference of AllNeighbours, whose sums hold only '
                         'there; make another one at these positions')
    if len(atoms) > 1:  # a single particle is in equilibrium by symmetry
        P, forces = free_directions(atoms), calc.get_forces(atoms)[:, : calc.dim]
        left = np.linalg.norm((P @ (P.T @ forces.ravel())).reshape(forces.shape), axis=1)
        if left.max() > BALANCED * abs(calc.law.dphi(calc.bonds.lengths)).max():
            raise ValueError('the cell is not at rest, and linear theory holds only about rest: a net static force of '
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
    raise ValueError('the structure is not at rest, and linear theory holds only about rest: a net static force of '
                     f'{left[k]:.4g} N acts on particle {k}, {share:.3g} times the largest force in a bond, and '
                     f'{np.count_nonzero(left)} of {len(left)} particles are not in equilibrium; {mend}')
