"""Rest of a finite lattice whose particles do not stand where their forces balance.

Inside an infinite lattice every particle is in balance by symmetry.  At the rim of a patch it is not, as soon as
particles repel beyond their nearest neighbours: those one row inside the held rim miss their second neighbours.  The
linear theory then belongs to the relaxed positions, where the calculator's Hessian is to be taken.
"""

from dataclasses import dataclass

import numpy as np
from ase import Atoms

from .errors import positive, whole
from .rest import repulsion_of

BALANCED = 1e-9
"""Of the largest bond force: a smaller residual is round-off."""


@dataclass(frozen=True)
class Relaxation:
    """A structure at rest, and how far it was from it.

    Attributes
    ----------
    atoms : ase.Atoms
        At rest, with the calculator that was given: its reference, and with it the anchors of the foundation, stay where
        they were, as pillars do, and their springs carry what the particles do not balance among themselves.
    before, after : float
        Largest force on a free particle in N.
    shift : float
        Largest displacement in mm.
    steps : int
        Of the optimiser; 0 where the structure was in balance.
    """

    atoms: Atoms
    before: float
    after: float
    shift: float
    steps: int

    @property
    def needed(self):
        """Whether the structure was out of balance."""
        return self.steps > 0


def relaxed(atoms, tolerance=BALANCED, steps=1000):
    """Let the free particles of a structure move to where no force is left, by ASE's LBFGS.

    Parameters
    ----------
    atoms : ase.Atoms
        With its MagneticRepulsion; what its constraints hold stays.
    tolerance : float
        Largest force that may be left, as a share of the largest bond force.
    steps : int
        Of the optimiser at most.

    Returns
    -------
    Relaxation

    Raises
    ------
    ValueError
        If forces do not vanish in so many steps, or particles run into each other: the structure buckles.
    """
    from ase.optimize import LBFGS

    calc = repulsion_of(atoms)
    largest = abs(calc.potential.dphi(calc.bonds.lengths)).max()
    rest = atoms.copy()
    rest.calc = calc
    before = _residual(rest)
    if before <= BALANCED * largest:
        return Relaxation(rest, before, before, 0.0, 0)
    # ASE's guesses suit eV and Angstrom: the stiffest direction and a tenth of the shortest bond replace them
    stiffest = abs(calc.get_hessian(rest)).sum(axis=1).max()
    search = LBFGS(rest, logfile=None, alpha=stiffest, maxstep=0.1 * calc.bonds.lengths.min())
    converged = search.run(fmax=positive('tolerance', tolerance) * largest, steps=whole('steps', steps))
    if not converged:
        raise ValueError(f'after {steps} steps {_residual(rest):.3g} N are left on a particle, {before:.3g} N at first: the '
                         'structure buckles or slides; hold its rim or give it a foundation (magphonon.foundation_needed)')
    shift = np.linalg.norm(rest.positions - atoms.positions, axis=1).max()
    return Relaxation(rest, before, _residual(rest), shift, search.nsteps)


def _residual(atoms):
    return np.linalg.norm(atoms.get_forces(), axis=1).max()
