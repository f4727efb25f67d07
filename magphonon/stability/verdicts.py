"""The verdict on a structure before it runs: equilibrium, stability, time step, supports and range of the linear theory."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms

from ..bands.bloch import cell_of_free_particles
from ..bands.force_constants import checked_supercell, default_distance
from ..dynamics.drives import constant_push
from ..dynamics.timestep import highest_frequency
from ..errors import positive
from ..interactions.bond_laws import BondLaws, groups, laws_of, taken
from ..interactions.pair_laws import Hertz, Yukawa, higher_derivatives
from ..stiffness.constraints import freedom
from ..stiffness.linear_system import LinearSystem
from ..stiffness.lowest import DENSE
from ..stiffness.repulsion import Repulsion, repulsion_of
from ..stiffness.rest import loaded, nearest_rest, placed
from .amplitude_shifts import frequency_shifts
from .buckling import (
    common_spring,
    common_support,
    highest_squared,
    softest_of,
    softest_out_of_plane,
    spacing_held,
    support_needed,
)
from .escapes import escape_speeds
from .verdict_text import DERIVATIVE_ERROR, OutOfPlane, Verdict

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from ase import Atoms
    from numpy.typing import NDArray

CENTRAL = Yukawa, Hertz
"""Laws of particles that are not magnets."""
LINEAR_ERROR = 0.01
"""Relative error of a frequency up to which the linear theory is accepted."""
SPACED = 2000
"""Largest number of degrees of freedom of a finite structure for which a stable spacing is searched; it needs about thirty lowest
modes."""
FLAT = 1e-9
"""Largest difference of heights, as a fraction of the shortest bond, up to which a layer is flat."""
ROUND_OFF = 5e-17
"""Measured relative error of the stiffness from finite differences with a displacement of one bond length; the error is inversely
proportional to the displacement."""


def verdict(atoms: Atoms, drives: Sequence[Any] = (), timestep: float | None = None, supercell: Sequence[int] | None = None,
            distance: float | None = None) -> Verdict:
    """Judge a structure before it runs.

    A periodic cell is judged as an infinite lattice, by its whole zone; a cell of more than 200 degrees of freedom only by waves
    that fit into one or two cells along each vector, which its notes say.  A finite structure is judged as given.  Quantities
    that take too long are not judged and listed in `Verdict.unjudged`: impacts above 200 degrees of freedom, the spacing above
    2000, and for a periodic cell above 200 also the supports and the linear amplitude.  With AllNeighbours none of these is
    judged.

    The structure is judged at rest: about the reference of its calculator, or about its present positions if they are another
    rest.  If the forces balance at neither, this is the fault `residual`, and the positions with smaller forces are used.

    Parameters
    ----------
    atoms : ase.Atoms
        With their MagneticRepulsion, or a cell with AllNeighbours.
    drives : sequence of drives
        Drives of the run; `Constant` ones may balance static forces, in addition to the dead load of the calculator.
    timestep : float, optional
        In ms.
    supercell : three ints, optional
        Supercell for phonopy's finite displacements.
    distance : float, optional
        Their displacement in mm; by default that of `finite_displacements`.

    Returns
    -------
    Verdict

    Raises
    ------
    ValueError
        For atoms with another calculator, constraints other than FixAtoms, FixedLine and FixedPlane, or a time step or
        distance that is not positive.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, verdict
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=3.0)
    >>> judged = verdict(cell)
    >>> judged.fine, round(judged.needed, 9)  # it needs 4 f/L0
    (False, 4.0)
    """
    if isinstance(atoms.calc, Repulsion) and atoms.calc.layer and _flat(atoms):
        return _of_layer(atoms, drives, timestep, supercell, distance)
    return _judged(atoms, drives, timestep, supercell, distance, far=True)


def _judged(atoms, drives, timestep, supercell, distance, far):
    """The verdict; if `far`, also on motion that is not small."""
    case = _at_rest(atoms, drives)
    atoms, calc, structure, dense = case.atoms, case.calc, case.structure, case.dense
    bond = calc.bonds.lengths.argmin()
    shortest, k = calc.bonds.lengths[bond], common_spring(structure)
    finite, size = case.pairwise and not atoms.pbc.any(), 0 if dense else structure.free.shape[1]
    small = case.pairwise and dense
    sparse = small or finite  # by a few factorisations
    alike = far and not (isinstance(calc.law, BondLaws) or np.ndim(calc.foundation))
    settled = not case.pushes.any()
    bare = softest_of(structure)
    stable = bare.needed <= k
    touching = any(isinstance(law, Hertz) for law in laws_of(calc.potential))  # at other spacings spheres are not in contact
    stretched = settled and not touching and (small or (finite and size <= SPACED))
    held = spacing_held(structure) if stretched else None
    # whether the softest wave is among those of `frequency_shifts`
    shifted = settled and sparse and far and (not bare.needed or np.allclose(2 * bare.q, np.round(2 * bare.q)))
    escape = escape_speeds(atoms) if settled and stable and small and alike and not touching else None
    wave, alone, central = _supports(structure, calc) if settled and sparse and calc.dim == 2 else (None, None, None)
    return Verdict(
        planar=calc.dim == 2,
        model=calc.model,
        spacing=float(shortest),
        force=float(-taken(calc.law, bond).dphi(shortest)),
        residual=float(case.pushes.max(initial=0.0)),
        particle=int(case.pushes.argmax()),
        pushed=int(np.count_nonzero(case.pushes)),
        foundation=k,
        needed=bare.needed,
        uneven=np.ndim(calc.foundation) > 0,
        softest=bare.q,
        repeated=bool(atoms.pbc.any()) and not dense,
        growth=0.0 if stable else float(np.sqrt(-softest_of(structure, foundation=k, weighted=True).lowest)),
        unguided=_unguided(atoms),
        held=held and float(held * shortest),
        omega_max=_omega_max(structure, zone=dense and atoms.pbc.any()),
        timestep=None if timestep is None else positive('timestep', timestep, 'ms'),
        support=wave,
        alone=alone,
        central=central,
        amplitude=frequency_shifts(structure).amplitude(LINEAR_ERROR) if stable and shifted else None,
        away=case.away,
        closest=case.closest,
        safe=escape.safe if escape else None,
        leaves=escape.leaves if escape else None,
        unjudged=_unjudged(finite, size, far) if settled else (),
        displacements=_safe_displacements(calc),
        distance=default_distance(calc) if distance is None else positive('distance', distance, 'mm'),
        supercell=None if supercell is None else _supercell_fault(calc, supercell),
    )


def _supports(structure, calc):
    """Stiffness out of the plane that supports need: for upright magnets, for one of them alone, and for central forces."""
    magnets = not any(isinstance(law, CENTRAL) for law in laws_of(calc.potential))
    wave, alone = support_needed(structure) if magnets else (None, None)
    return wave, alone, support_needed(structure, magnets=False)[0]


def _unjudged(finite, size, far):
    """The quantities that take too long for a structure of `size` degrees of freedom, zero if it is small."""
    left_out = ('the spacing',) * (size > (SPACED if finite else 0)) + ('impacts',) * (size > 0 and far)
    return left_out if finite or not size else (*left_out, 'the supports', *('the linear amplitude',) * far)


@dataclass(frozen=True)
class _Case:
    """A structure at its rest, or where the forces are nearest to balance, with all that a verdict needs of it.

    Attributes
    ----------
    atoms : ase.Atoms
        The structure at this rest.
    calc : Repulsion
    structure : LinearSystem or ase.Atoms
        Argument for the linear tools.
    dense : bool
        Whether it is small enough for dense matrices.
    pairwise : bool
        Whether the repulsion is a list of bonds, and not a sum over all neighbours.
    pushes : ndarray, shape (particles,)
        Unbalanced static force on each particle, N.
    away, closest : float
        As in Verdict.
    """

    atoms: Atoms
    calc: Any
    structure: Any
    dense: bool
    pairwise: bool
    pushes: NDArray[np.float64]
    away: float = 0.0
    closest: float = 1.0


def _at_rest(atoms, drives):
    if isinstance(atoms.calc, Repulsion) and not atoms.calc.pairwise:  # without an edge
        calc = cell_of_free_particles(atoms, 'with AllNeighbours a verdict is one')
        return _Case(atoms, calc, atoms, dense=True, pairwise=False, pushes=np.zeros(1))
    closest, atoms = _closest(repulsion_of(atoms), atoms), loaded(atoms, constant_push(drives, len(atoms)))
    freedom(atoms)  # refuses constraints that are not supported
    calc, pushes = nearest_rest(atoms)
    away = float(np.linalg.norm(calc.displacements(atoms), axis=1).max())
    atoms = placed(atoms, calc)
    structure = LinearSystem.about(calc, atoms) if pushes.any() else LinearSystem.of(atoms)
    dense = structure.free.shape[1] <= DENSE
    return _Case(atoms, calc, structure, dense, pairwise=True, pushes=pushes, away=away, closest=closest)


def _flat(atoms):
    """Whether a layer is at rest in one plane."""
    places, calc = (atoms.positions, atoms.calc.reference.positions), atoms.calc
    pushed = calc.pairwise and (calc.load[:, 2].any() or calc.slack[:, 2].any())
    return not pushed and max(np.ptp(place[:, 2]) for place in places) <= FLAT * calc.bonds.lengths.min()


def _of_layer(atoms, drives, timestep, supercell, distance):
    """The verdict on the motion in the plane, with that on the motion out of it."""
    calc = atoms.calc
    flat = atoms.copy()
    flat.calc = calc.in_plane()
    judged = _judged(flat, drives, timestep, supercell, distance, far=False)  # at large amplitudes they leave the plane
    above, highest = out_of_plane(atoms)
    return replace(judged, omega_max=max(judged.omega_max, highest), out_of_plane=above)


def out_of_plane(atoms: Atoms) -> tuple[OutOfPlane, float]:
    """Stability of a flat layer against motion out of its plane, and the highest angular frequency of that motion in rad/ms."""
    structure = LinearSystem.nearest(atoms) if atoms.calc.pairwise else atoms
    there = common_support(structure)
    needed = softest_out_of_plane(structure)
    moving = softest_out_of_plane(structure, there, weighted=True)
    growth = 0.0 if needed.needed <= there else float(np.sqrt(-moving.lowest))
    return OutOfPlane(there, needed.needed, needed.q, growth), float(np.sqrt(max(moving.highest, 0.0)))


def _unguided(atoms):
    """Foundation needed with FixAtoms alone; None if there is nothing else."""
    fixed = [constraint for constraint in atoms.constraints if isinstance(constraint, FixAtoms)]
    if len(fixed) == len(atoms.constraints):
        return None
    free = atoms.copy()
    free.calc = atoms.calc
    free.set_constraint(fixed)
    return softest_of(free).needed


def _omega_max(structure, zone):
    """Highest frequency in a run of the structure, or, with `zone`, of all waves in a lattice of which it is the cell."""
    if not zone:
        return float(highest_frequency(structure))
    return float(np.sqrt(max(highest_squared(structure), 0.0)))


def _closest(calc, atoms):
    """Shortest present distance of bonded particles as a fraction of that in the reference."""
    now = calc.bond_vectors + calc.bonds.incidence @ calc.displacements(atoms)
    return float((np.linalg.norm(now, axis=1) / calc.bonds.lengths).min())


def _safe_displacements(calc):
    """The least displacement in mm, by round-off, and the largest, by the curvature of a law: phi'''' d^2/6 of its stiffness."""
    lengths = calc.bonds.lengths
    nearest = [(law, lengths[own].min()) for law, own in groups(calc.law, len(lengths))]
    curvature = max(abs(higher_derivatives(law, np.array([r]))[1][0] / law.d2phi(r)) for law, r in nearest)
    return float(ROUND_OFF / DERIVATIVE_ERROR * lengths.min()), float(np.sqrt(6 * DERIVATIVE_ERROR / curvature))


def _supercell_fault(calc, supercell):
    try:
        checked_supercell(calc, supercell)
    except ValueError as error:
        return str(error)
    return None
