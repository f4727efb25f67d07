"""The rest about which a linear answer is taken: positions where the forces on all that is free balance.

Three places belong to a particle: its anchor, where its foundation spring is slack; the reference of the calculator, from
which displacements are counted; and where it stands now.  In a perfect lattice they are one.  Linear equations of motion hold
about a place where nothing pushes, so every linear answer asks this module for it:

    at_rest             the present positions, if the forces balance there; modes, responses, stability
    rest_of_motion      the reference if the forces balance there, otherwise the present positions; a motion from a given state

Statically all models are alike: the force of a bond is that of its present length, along its present direction.
"""

import numpy as np

from .calculator import MagneticRepulsion, masses_of
from .constraints import free_directions
from .drives import Constant, Drives, in_plane

ROUND_OFF = 1e-11
"""A static force below this fraction of the forces that cancel in it is round-off."""

BALANCED = 1e-6
"""Of the largest bond force: what may be left at rest.  It shifts a linear answer by about the same share."""

ELSEWHERE = 1e-3
"""Of the shortest bond: particles that stand farther from the reference and are in balance have found another rest; nearer
ones may merely be displaced by so little that their forces look balanced."""


def repulsion_of(atoms):
    """The MagneticRepulsion attached to `atoms`, whose masses are looked at too.

    Raises
    ------
    ValueError
        If there is none, or a mass is not a positive number.
    """
    if not isinstance(atoms.calc, MagneticRepulsion):
        raise ValueError(f'the atoms carry {atoms.calc!r} as calculator; '
                         'attach atoms.calc = MagneticRepulsion(atoms, potential, ...)')
    masses_of(atoms)
    return atoms.calc


def static_forces(calc, constant, u=0.0):
    """Forces of bonds, foundation, dead load and constant drives in N, shape (particles, dim); zero where they balance.

    Parameters
    ----------
    calc : MagneticRepulsion
    constant : Drives
        Of Constant ones.
    u : ndarray, shape (particles, dim)
        Displacements from the reference in mm, at which particles are held still; none by default.
    """
    bonds, pushes = calc.bonds, constant.forces(np.zeros(1))[0]
    R = bonds.vectors[:, : calc.dim] + (bonds.incidence @ u if np.ndim(u) else 0.0)
    r = np.linalg.norm(R, axis=1)
    pull = -(calc.potential.dphi(r) / r)[:, None] * R
    total, size = calc.offset - calc.parameters.foundation * u, abs(calc.offset)
    total[constant.particles] += in_plane(pushes) if calc.dim == 2 else pushes
    size = size.max(axis=1) + abs(total).max(axis=1)
    for end, sign in ((bonds.j, 1), (bonds.i, -1)):
        total += sign * np.stack([np.bincount(end, x, bonds.particles) for x in pull.T], axis=1)
        size += np.bincount(end, np.linalg.norm(pull, axis=1), bonds.particles)
    total[abs(total) <= ROUND_OFF * size[:, None]] = 0
    return total


def unbalanced(atoms, u=0.0, drives=()):
    """What is left of the static forces along what is free, in N, shape (particles,); zero if it is less than BALANCED.

    Parameters
    ----------
    atoms : ase.Atoms
    u : ndarray, shape (particles, dim)
        Displacements from the reference at which it is asked.
    drives : sequence of drives
        Of which the Constant ones help to balance.
    """
    calc = atoms.calc
    constant = Drives([drive for drive in drives if isinstance(drive, Constant)], len(atoms))
    P = free_directions(atoms)
    left = np.linalg.norm((P @ (P.T @ static_forces(calc, constant, u).ravel())).reshape(len(atoms), -1), axis=1)
    return left * (left > BALANCED * _largest_force(calc, u))


def _largest_force(calc, u):
    R = calc.bonds.vectors[:, : calc.dim] + (calc.bonds.incidence @ u if np.ndim(u) else 0.0)
    return abs(calc.potential.dphi(np.linalg.norm(R, axis=1))).max(initial=0.0)


def at_rest(atoms, drives=()):
    """The calculator about the present positions, where the forces balance.

    Parameters
    ----------
    atoms : ase.Atoms
        With MagneticRepulsion.
    drives : sequence of drives
        Of which the Constant ones help to balance.

    Returns
    -------
    MagneticRepulsion
        That of the atoms, or one whose reference are their present positions.

    Raises
    ------
    ValueError
        If the forces do not balance: it says by how much, on which particle, and what would mend it.
    """
    calc = repulsion_of(atoms)
    u = calc.displacements(atoms)
    left = unbalanced(atoms, u, drives)
    if left.any():
        _refuse(atoms, u, left, drives)
    return calc.about(atoms) if u.any() else calc


def rest_of_motion(atoms, drives=()):
    """The calculator about the rest that belongs to a moving structure, whose positions and momenta are its state.

    The reference, if the forces balance there; the present positions, if only there or if they are another rest, well away
    from the reference.

    Parameters, Returns and Raises as `at_rest`.
    """
    calc = repulsion_of(atoms)
    u = calc.displacements(atoms)
    settled = not unbalanced(atoms, 0.0, drives).any()
    if settled and abs(u).max(initial=0.0) <= ELSEWHERE * calc.bonds.lengths.min():
        return calc
    left = unbalanced(atoms, u, drives)
    if not left.any():
        return calc.about(atoms)
    if not settled:
        _refuse(atoms, u, left, drives)
    return calc


def rest_or_reference(atoms):
    """As `rest_of_motion`, for what must judge any structure: the reference where no rest is known."""
    try:
        return rest_of_motion(atoms)
    except ValueError:
        return atoms.calc


def _refuse(atoms, u, left, drives):
    calc, k = atoms.calc, left.argmax()
    share = left[k] / (_largest_force(calc, u) or np.inf)
    mend = 'let it relax, magphonon.relaxed(atoms).atoms, or give the calculator the constant force that holds it (load=)'
    if u.any() and not unbalanced(atoms, 0.0, drives).any():
        mend = ('set the positions back to those of atoms.calc.reference, where they balance (up to '
                f'{np.linalg.norm(u, axis=1).max():.3g} mm away), or ' + mend)
    raise ValueError('the structure is not at rest, and a linear answer holds about rest only: nothing balances '
                     f'{left[k]:.4g} N on particle {k}, {share:.3g} times the largest force in a bond, and '
                     f'{np.count_nonzero(left)} of {len(left)} particles are pushed; {mend}')
