"""A verdict on a structure: the numbers that were found, and what they mean in words and SI units."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import units as u
from ..dynamics.cages import CONTACT

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
