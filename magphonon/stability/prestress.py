"""How much more prestress a structure bears: the factor on D* at which `D0 + f D*` becomes singular."""

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from scipy.sparse.linalg import LinearOperator, eigsh

from ..stiffness.factors import inverse
from ..stiffness.lowest import lowest_mode
from ..stiffness.rest import LinearSystem
from ..traits import takes

SINGULAR = 1e-12  # fraction of the largest stiffness below which springs alone do not hold a structure


@dataclass(frozen=True, eq=False)
class PrestressReserve:
    """The factor on D* that makes a structure collapse, and how it then moves.

    Attributes
    ----------
    factor : float
        Above 1 for a stable structure; infinite if static forces only stiffen it.
    mode : ndarray, shape (particles, dim)
        The motion without stiffness at this factor; the largest displacement is 1.
    """

    factor: float
    mode: np.ndarray


@takes('constraints', 'radii')
def prestress_reserve(atoms: Atoms) -> PrestressReserve:
    """The factor f at which a structure with the stiffness `D0 + f D*` collapses; its positions stay.

    The force of every bond is multiplied by f while its spring constant phi'' stays: in a packing or a lattice far from contact
    this is how far the pressure is from buckling the structure.  D0 alone says that there is no such factor.

    Parameters
    ----------
    atoms : ase.Atoms
        A structure that D0 holds, with its PairCalculator.  In a periodic one motion that is equal in all cells counts: repeat a
        small cell.

    Raises
    ------
    ValueError
        If springs alone do not hold the structure, as a net that is rigid by its tension only, or a free body.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stability import prestress_reserve
    >>> row = lattices.chain(1.0, 1.0).repeat((2, 1, 1))
    >>> row.calc = MagneticRepulsion(row, InversePower(1.0, 4.0), foundation=6.0)
    >>> round(prestress_reserve(row).factor, 9)  # zigzag: k/(4 f/L0)
    1.5
    """
    system = LinearSystem.of(atoms)
    calc, free = system.calc, system.free
    if atoms.pbc.any() and not calc.tied and system.mobile.all():
        free = free[:, calc.dim :]  # one particle stands for the lattice as a whole
    springs = free.T @ calc.rest_hessian('conventional') @ free
    turning = springs - free.T @ calc.rest_hessian('complete') @ free  # -D*
    lowest, highest, _ = lowest_mode(springs)
    if lowest < SINGULAR * highest:
        raise ValueError('springs alone, D0, do not hold this structure, so no factor on D* makes it collapse: hold its rim, '
                         'give it a foundation, or look at its modes')
    solve = LinearOperator(springs.shape, inverse(springs))
    share, y = eigsh(turning, 1, springs, Minv=solve, which='LA', v0=np.cos(np.arange(springs.shape[0])))
    mode = (free @ y[:, 0]).reshape(len(system), calc.dim)
    return PrestressReserve(float(1 / share[0]) if share[0] > SINGULAR else np.inf, mode / np.linalg.norm(mode, axis=1).max())
