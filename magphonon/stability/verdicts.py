"""The verdict on a structure before it runs: equilibrium, stability, time step, supports and range of the linear theory."""

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

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from ase import Atoms

CENTRAL = Yukawa, Hertz
"""Laws of particles that are not magnets."""
LINEAR_ERROR = 0.01
"""Largest relative error of a frequency up to which the linear theory is called good."""
LARGE = 0.1
"""Largest amplitude, as a fraction of the spacing, up to which perturbation theory is trusted."""
DERIVATIVE_ERROR = 1e-6
"""Largest relative error of the stiffness up to which a finite-difference displacement is called safe."""
FLAT = 1e-9
"""Largest difference of heights, as a fraction of the shortest bond, up to which a layer is flat."""
ROUND_OFF = 5e-17
"""Measured relative error of the stiffness from finite differences with a displacement of one bond length; the error is inversely
proportional to the displacement."""


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
        That of the calculator.  Stability is judged by the complete one, as the others hide it.
    spacing, force : float
        Shortest bond in mm and its static repulsion in N.
    residual : float
        Largest static force that nothing balances on a free particle, in N.
    particle, pushed : int
        The particle on which it acts, and how many are not in equilibrium.
    foundation, needed : float
        The stiffness that is there, and the least that holds the structure, N/mm.  Where springs differ, of the softest one, the
        others being stiffer by as much as they are.
    uneven : bool
        Whether they differ.
    softest : ndarray, shape (3,)
        Wavevector of the softest mode in fractions of the reciprocal vectors; zero for a finite structure.
    repeated : bool
        Whether only waves that fit into one or two cells are judged, as of periodic cells of more than 200 freedoms.
    growth : float
        Rate of the fastest unstable mode, 1/ms; zero for a stable structure.
    unguided : float or None
        Foundation needed if FixedLine and FixedPlane guided nothing, N/mm; None without them.
    held : float or None
        Shortest bond at which the foundation begins or ceases to hold the structure, mm; None if it never does, or is not
        judged, as of balls in contact.
    omega_max : float
        Highest angular frequency of the calculator's model, rad/ms.
    timestep : float or None
        The one to be judged, ms.
    support, alone, central : float or None
        Stiffness that supports must provide out of the plane if the particles are magnets normal to it, for every wave and
        for one that moves alone, and if the force is central, for every wave; N/mm.  None where that cannot be, or is not
        judged.
    amplitude : float or None
        Displacement at which frequencies are 1 % off the linear ones, mm; None if unstable or not judged, as where the
        softest wave fits in no two cells.
    away : float
        Largest present distance of a particle from its place at rest, mm.
    closest : float
        The present shortest distance of bonded particles as a share of that in the reference.
    safe, leaves : float or None
        Speed of an impact on one particle below which no bond is lost, and at which a particle that is shot loses its cage,
        mm/ms; None where that is not judged, as where particles differ in law, strength or foundation, or was not found
        (`magphonon.stability.escapes`).
    displacements : tuple of float
        Between which finite differences are safe, mm.
    distance : float
        The displacement to be judged, mm.
    supercell : str or None
        What is wrong with the supercell.
    out_of_plane : OutOfPlane or None
        Of a flat layer whose particles move out of the plane (a foundation of three components); then all else is said of
        its motion in the plane, but `omega_max`.
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
    displacements: tuple
    distance: float
    supercell: str | None
    out_of_plane: OutOfPlane | None = None

    @property
    def timestep_limit(self) -> float:
        """2/omega_max in ms; infinite where nothing vibrates."""
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
        """What makes a run fail or mean nothing, each a sentence or two; a tuple of str."""
        found = []
        if self.residual:
            many = f'; {self.pushed} particles are not in equilibrium' if self.pushed > 1 else ''
            found.append(f'Particle {self.particle} is not in equilibrium: a net static force of {self.residual / u.N:.4g} N '
                         f'acts on it, {self.residual / self.force:.4g} times the force in a bond{many}. '
                         'Hold the edge, add the force that balances it, or relax the structure first.')
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
        """What is good to know; a tuple of str."""
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


def verdict(atoms: Atoms, drives: Sequence[Any] = (), timestep: float | None = None, supercell: Sequence[int] | None = None,
            distance: float | None = None) -> Verdict:
    """Judge a structure before it runs.

    A periodic cell is judged as the lattice that it stands for, by its whole zone; one of more than 200 freedoms only by
    waves that fit into one or two cells along each vector, which its notes say; a finite structure as it is.  Of more
    than a hundred particles, and with AllNeighbours, the spacing, the supports, the linear amplitude and impacts are not
    judged.

    It is judged at rest: about the reference of its calculator, or about its present positions if it has found another rest
    there; what is at rest nowhere has the fault `residual`, and is judged where less is left.

    Parameters
    ----------
    atoms : ase.Atoms
        With their MagneticRepulsion, or a cell with AllNeighbours.
    drives : sequence of drives
        Of which the `Constant` ones may balance static forces, besides the dead load of the calculator.
    timestep : float, optional
        In ms.
    supercell : three ints, optional
        For phonopy's finite displacements.
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
    near = not isinstance(atoms.calc, Repulsion) or atoms.calc.pairwise
    if near:  # judged where its rest is, or is nearest
        closest, atoms = _closest(repulsion_of(atoms), atoms), loaded(atoms, constant_push(drives, len(atoms)))
        freedom(atoms)  # refuses constraints of which it is not known what they hold
        calc, pushes = nearest_rest(atoms)
        away = np.linalg.norm(calc.displacements(atoms), axis=1).max()
        atoms = placed(atoms, calc)
        structure = LinearSystem.about(calc, atoms) if pushes.any() else LinearSystem.of(atoms)
        dense = structure.free.shape[1] <= DENSE
    else:  # without an edge
        calc, pushes, closest, away = cell_of_free_particles(atoms, 'with AllNeighbours a verdict is one'), np.zeros(1), 1.0, 0.0
        structure, dense = atoms, True
    bond = calc.bonds.lengths.argmin()
    shortest, k = calc.bonds.lengths[bond], common_spring(structure)
    small = near and dense
    alike = far and not (isinstance(calc.law, BondLaws) or np.ndim(calc.foundation))
    settled = not pushes.any()
    bare = softest_of(structure)
    stable = bare.needed <= k
    touching = any(isinstance(law, Hertz) for law in laws_of(calc.potential))  # other spacings are no contacts
    held = spacing_held(structure) if settled and small and not touching else None
    # whether the softest wave is among those of `frequency_shifts`
    shifted = settled and small and far and (not bare.needed or np.allclose(2 * bare.q, np.round(2 * bare.q)))
    escape = escape_speeds(atoms) if settled and stable and small and alike and not touching else None
    apart = settled and small and calc.dim == 2  # out of the plane
    magnets = apart and not any(isinstance(law, CENTRAL) for law in laws_of(calc.potential))
    wave, alone = support_needed(structure) if magnets else (None, None)
    return Verdict(
        planar=calc.dim == 2,
        model=calc.model,
        spacing=float(shortest),
        force=float(-taken(calc.law, bond).dphi(shortest)),
        residual=float(pushes.max(initial=0.0)),
        particle=int(pushes.argmax()),
        pushed=int(np.count_nonzero(pushes)),
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
        central=support_needed(structure, magnets=False)[0] if apart else None,
        amplitude=frequency_shifts(structure).amplitude(LINEAR_ERROR) if stable and shifted else None,
        away=float(away),
        closest=closest,
        safe=escape.safe if escape else None,
        leaves=escape.leaves if escape else None,
        displacements=_safe_displacements(calc),
        distance=default_distance(calc) if distance is None else positive('distance', distance, 'mm'),
        supercell=None if supercell is None else _supercell_fault(calc, supercell),
    )


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
    judged = _judged(flat, drives, timestep, supercell, distance, far=False)  # far from rest they leave the plane
    structure = LinearSystem.nearest(atoms) if calc.pairwise else atoms
    there = common_support(structure)
    needed = softest_out_of_plane(structure)
    moving = softest_out_of_plane(structure, there, weighted=True)
    growth = 0.0 if needed.needed <= there else float(np.sqrt(-moving.lowest))
    return replace(judged, omega_max=max(judged.omega_max, float(np.sqrt(max(moving.highest, 0.0)))),
                   out_of_plane=OutOfPlane(there, needed.needed, needed.q, growth))


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
    """Highest frequency of the structure, of a large cell as it would move in a run, or in the whole zone of a cell."""
    if not zone:
        return float(highest_frequency(structure))
    return float(np.sqrt(max(highest_squared(structure), 0.0)))


def _closest(calc, atoms):
    """Shortest present distance of bonded particles as a share of that in the reference."""
    now = calc.bond_vectors + calc.bonds.incidence @ calc.displacements(atoms)
    return float((np.linalg.norm(now, axis=1) / calc.bonds.lengths).min())


def _safe_displacements(calc):
    """From round-off to where the curvature of a law, one sixth of its fourth derivative times d^2, counts; in mm."""
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
