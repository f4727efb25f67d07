"""The verdict on a structure before it runs: equilibrium, stability, time step, supports and range of the linear theory.

A verdict on a structure: the numbers that were found, and what they mean in words and SI units.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms

from .. import units as u
from ..bands.bloch import cell_of_free_particles
from ..bands.force_constants import checked_supercell, default_distance
from ..dynamics.cages import CONTACT
from ..dynamics.drives import constant_push
from ..dynamics.engine import highest_frequency
from ..errors import positive
from ..interactions.bond_laws import BondLaws, groups, laws_of, taken
from ..interactions.pair_laws import Hertz, Yukawa, higher_derivatives
from ..stiffness.lowest import DENSE
from ..stiffness.repulsion import Repulsion, repulsion_of
from ..stiffness.rest import LinearSystem, freedom, loaded, nearest_rest, placed
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

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from ase import Atoms
    from numpy.typing import NDArray

LARGE = 0.1
"""Largest amplitude, as a fraction of the spacing, up to which perturbation theory is trusted."""
DERIVATIVE_ERROR = 1e-6
"""Largest relative error of the stiffness up to which a finite-difference displacement is called safe."""


@dataclass(frozen=True)
class OutOfPlane:
    """Stability of a flat layer against motion out of its plane.

    Attributes
    ----------
    support, needed : float
        Stiffness along z of the softest support, and the least that holds the layer flat, N/mm.
    softest : ndarray, shape (3,)
        Wavevector of the softest mode in fractions of the reciprocal vectors; zero for a finite structure.
    growth : float
        Rate of the fastest unstable mode, 1/ms; zero for a layer that remains flat.
    """

    support: float
    needed: float
    softest: np.ndarray
    growth: float

    @property
    def stable(self) -> bool:
        """Whether the supports hold the layer flat."""
        return self.needed <= self.support

    def __str__(self) -> str:
        have, need = _stiffness(self.support), _stiffness(self.needed)
        if self.stable:
            margin = f'{_times(self.support / self.needed)} the {need} that they need' if self.needed else 'more than they need'
            return f'Stable out of the plane: the supports of {have} along z are {margin}.'
        at = f' with the softest mode at q = ({", ".join(f"{x:.4g}" for x in self.softest)})' if self.softest.any() else ''
        return (f'It buckles out of the plane{at}: the motion grows e-fold in {1 / self.growth / u.s:.3g} s. Its supports need '
                f'{need} along z and have {have}.')


@dataclass(frozen=True)
class Verdict:
    """Numbers on a structure before it runs, in mm, g, ms; `str(verdict)` says them in words and SI units.

    Attributes
    ----------
    planar : bool
    model : str
        Model of the calculator.  Stability is always judged by the complete model, because the others do not show buckling.
    spacing, force : float
        Shortest bond in mm and its static repulsion in N.
    residual : float
        Largest static force that nothing balances on a free particle, in N.
    particle, pushed : int
        The particle on which it acts, and how many are not in equilibrium.
    foundation, needed : float
        The present stiffness, and the smallest one that stabilises the structure, N/mm.  If springs differ, both are those of
        the softest one, with the differences between springs kept.
    uneven : bool
        Whether the springs differ.
    softest : ndarray, shape (3,)
        Wavevector of the softest mode in fractions of the reciprocal vectors; zero for a finite structure.
    repeated : bool
        Whether only waves that fit into one or two cells are judged, for periodic cells of more than 200 degrees of freedom.
    growth : float
        Rate of the fastest unstable mode, 1/ms; zero for a stable structure.
    unguided : float or None
        Foundation needed if FixedLine and FixedPlane guided nothing, N/mm; None without them.
    held : float or None
        Shortest bond at which the foundation begins or ceases to stabilise the structure, mm; None if there is none, or it
        is not judged, such as for balls in contact.
    omega_max : float
        Highest angular frequency of the calculator's model, rad/ms.
    timestep : float or None
        The time step to be judged, ms.
    support, alone, central : float or None
        Stiffness that supports must provide out of the plane if the particles are magnets normal to it, for every wave and
        for one that moves alone, and if the force is central, for every wave; N/mm.  None if they are impossible or
        not judged.
    amplitude : float or None
        Displacement at which frequencies are 1 % off the linear ones, mm; None if unstable or not judged, such as when
        the softest wave does not fit into two cells.
    away : float
        Largest present distance of a particle from its rest position, mm.
    closest : float
        The present shortest distance of bonded particles as a fraction of that in the reference.
    safe, leaves : float or None
        Speed of an impact on one particle below which no bond is lost, and speed at which a particle leaves its cage, mm/ms;
        None if not judged, such as for particles that differ in law, strength or foundation, or if not found
        (`magphonon.stability.escapes`).
    unjudged : tuple of str
        The quantities that were not judged because they would take too long for so many particles.
    displacements : tuple of float
        Smallest and largest displacement for accurate finite differences, mm.
    distance : float
        The displacement to be judged, mm.
    supercell : str or None
        Fault of the supercell, in words.
    out_of_plane : OutOfPlane or None
        Result for a flat layer whose particles move out of the plane (a foundation of three components).  All other attributes
        then describe its motion in the plane, except `omega_max`.
    """

    planar: bool
    model: str
    spacing: float
    force: float
    residual: float
    particle: int
    pushed: int
    foundation: float
    needed: float
    uneven: bool
    softest: np.ndarray
    repeated: bool
    growth: float
    unguided: float | None
    held: float | None
    omega_max: float
    timestep: float | None
    support: float | None
    alone: float | None
    central: float | None
    amplitude: float | None
    away: float
    closest: float
    safe: float | None
    leaves: float | None
    unjudged: tuple[str, ...]
    displacements: tuple
    distance: float
    supercell: str | None
    out_of_plane: OutOfPlane | None = None

    @property
    def timestep_limit(self) -> float:
        """2/omega_max in ms; infinite if no mode vibrates."""
        return 2 / self.omega_max if self.omega_max > 0 else np.inf

    @property
    def stable(self) -> bool:
        """Whether the foundation holds the structure."""
        return self._in_plane and (self.out_of_plane is None or self.out_of_plane.stable)

    @property
    def _in_plane(self):
        return self.needed <= self.foundation

    @property
    def fine(self) -> bool:
        """Whether no fault was found."""
        return not self.faults

    @property
    def faults(self) -> tuple[str, ...]:
        """The faults that make a run fail or its result meaningless, each in a sentence or two; a tuple of str."""
        found = []
        if self.residual:
            many = f'; {self.pushed} particles are not in equilibrium' if self.pushed > 1 else ''
            found.append(f'Particle {self.particle} is not in equilibrium: a net static force of {self.residual / u.N:.4g} N '
                         f'acts on it, {self.residual / self.force:.4g} times the force in a bond{many}. '
                         'Hold the edge, add the force that balances it, or relax the structure first (in a scene whose '
                         'particles are in a file: relaxed = true in [lattice]).')
        if not self._in_plane:
            found.append(self._buckling())
        if self.out_of_plane is not None and not self.out_of_plane.stable:
            found.append(str(self.out_of_plane))
        if not self.stable and self.model != 'complete':
            found.append(f"The {self.model} model does not show this, because it leaves out D*. Use model='complete'.")
        if self.timestep is not None and self.timestep > self.timestep_limit:
            found.append(f'The time step of {self.timestep / u.s:.4g} s exceeds the stability limit 2/omega_max = '
                         f'{self.timestep_limit / u.s:.4g} s: the run would diverge. Use a tenth of the limit.')
        if self.away > self.spacing:
            found.append(f'Particles are up to {self.away / u.m:.4g} m away from their rest positions, '
                         f'{self.away / self.spacing:.3g} times the spacing: they have moved away, or are listed in another '
                         'order than in the calculator. Make a calculator for these positions.')
        if self.closest < CONTACT:
            found.append(f'Particles are in contact: two of them are at {self.closest:.3g} times their distance at rest. '
                         'Start with a larger distance.')
        if self.supercell:
            found.append(f'Finite differences would be wrong: {self.supercell}.')
        if not self.displacements[0] <= self.distance <= self.displacements[1]:
            found.append(self._unsafe_distance())
        return tuple(found)

    @property
    def notes(self) -> tuple[str, ...]:
        """Further facts about the structure; a tuple of str."""
        said = []
        if not self.residual:
            said.append('The static forces balance on every free particle.')
        if self._in_plane:
            said.append(self._margin())
        if self.out_of_plane is not None and self.out_of_plane.stable:
            said.append(str(self.out_of_plane))
        if self.repeated:
            said.append('The periodic cell is so large that only waves that fit into one or two cells were judged; another wave '
                        'may be softer. Judge a smaller cell of the same lattice, or another number of repeats.')
        if self.unguided is not None and self.stable and self.unguided > self.foundation:
            said.append('It is stable only because a constraint blocks sideways motion; without the constraint it would need a '
                        f'foundation of {_stiffness(self.unguided)}.')
        if np.isfinite(self.timestep_limit):
            said.append(f'Time steps up to {self.timestep_limit / u.s:.4g} s are stable (2/omega_max, with the highest frequency '
                        f'of {u.hertz(self.omega_max):.4g} Hz); a tenth of that is accurate.')
        if self.central and self.out_of_plane is None:
            said.append('Not modelled: motion out of the plane. Each support needs an out-of-plane stiffness of at least '
                        + (f'{_stiffness(self.central)}.' if self.support is None else
                           f'{_stiffness(self.support)} (upright magnets, all moving), {_stiffness(self.alone)} (upright '
                           f'magnets, one moving) or {_stiffness(self.central)} (central force).'))
        if self.amplitude is not None and np.isfinite(self.amplitude):
            said.append(self._linear())
        said += self._impacts()
        if self.unjudged:
            *others, last = self.unjudged
            named = f'{", ".join(others)} and {last}' if others else last
            said.append(f'Not judged for so many particles: {named}. Judge a cell of the lattice, or a smaller patch of it.')
        return tuple(said)

    @property
    def _where(self):
        return ' in the plane' if self.planar else ''

    def _buckling(self):
        at = f', with the softest mode at q = ({", ".join(f"{x:.4g}" for x in self.softest)})' if self.softest.any() else ''
        room = f' A spacing above {self.held / u.m:.4g} m would also make it stable.' if self.held else ''
        return (f'It buckles{self._where}{at}: the motion grows e-fold in {1 / self.growth / u.s:.3g} s. It needs a foundation '
                f'of {_stiffness(self.needed)} and has {_stiffness(self.foundation)}{self._softest_spring}.{room}')

    @property
    def _softest_spring(self):
        return ' at its softest spring' if self.uneven else ''

    def _margin(self):
        if not self.needed and self.uneven:
            softest = _stiffness(self.foundation)
            return f'Stable{self._where}, and would be with every spring softer by {softest}, the stiffness of the softest one.'
        if not self.needed:
            room = '' if self.held is None else f' It would buckle below a spacing of {self.held / u.m:.4g} m.'
            return f'Stable{self._where}; no foundation needed.{room}'
        room = '' if self.held is None else f' It would be stable down to a spacing of {self.held / u.m:.4g} m.'
        more = _times(self.foundation / self.needed)
        return (f'Stable{self._where}: the foundation of {_stiffness(self.foundation)}{self._softest_spring} is {more} the '
                f'{_stiffness(self.needed)} '
                f'that it needs.{room}')

    def _impacts(self):
        """One speed rounded down, the other one up."""
        if self.safe is not None:
            yield (f'An impact on one particle at a speed below {_three_digits(self.safe, np.floor):g} m/s cannot break any '
                   'bond, because its energy is too low.')
        if self.leaves is not None:
            yield (f'A particle with an initial speed of {_three_digits(self.leaves, np.ceil):g} m/s leaves, in at least '
                   'one direction, the cage of its neighbours, which ends a run.')

    def _linear(self):
        share = self.amplitude / self.spacing
        if share > LARGE:
            return f'Frequencies stay within 1 % of the linear ones up to an amplitude of {100 * LARGE:g} % of the spacing.'
        return (f'The linear theory holds for small motion: its frequencies are 1 % off at an amplitude of '
                f'{self.amplitude / u.m:.2g} m, {100 * share:.2g} % of the spacing.')

    def _unsafe_distance(self):
        least, most = (distance / u.m for distance in self.displacements)
        reason = 'small: round-off' if self.distance < self.displacements[0] else 'large: the curvature of the law'
        return (f'A finite-difference displacement of {self.distance / u.m:.3g} m is too {reason} changes the stiffness by more '
                f'than a fraction of {DERIVATIVE_ERROR:g}. Use {least:.2g} to {most:.2g} m.')

    def __str__(self) -> str:
        count = f'{len(self.faults)} problem{"s" * (len(self.faults) > 1)}'
        head = 'OK' if self.fine else f'NOT OK ({count})' if self.stable else f'UNSTABLE ({count})'
        return '\n'.join([head, *(f'  ! {text}' for text in self.faults), *(f'  - {text}' for text in self.notes)])


def _times(ratio):
    return f'{100 * (ratio - 1):.2g} % more than' if ratio < 1.995 else f'{ratio:.3g} times'


def _three_digits(speed, rounded):
    """A speed in m/s, rounded down or up to three digits."""
    speed = speed / (u.m / u.s)
    digit = 10.0 ** (np.floor(np.log10(speed)) - 2)
    return float(f'{rounded(speed / digit) * digit:.3g}')


def _stiffness(k):
    return f'{k / (u.N / u.m):.4g} N/m'


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
