"""Does a design keep its promise? It is tested with all neighbours, in time steps and with scatter, and compared with the
promise of D0 alone.

The time steps do not use linear theory: particles at rest are driven, in the complete model with its nonlinear forces, until the
motion is steady or the burst is over. The wanted value is then computed from their displacements.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..dynamics.drives import Harmonic, ToneBurst
from ..dynamics.engine import highest_frequency
from ..dynamics.recorder import Recorder
from ..dynamics.verlet import DrivenVerlet
from ..lattices.bonds import find_bonds
from ..stiffness.rest import LinearSystem
from .objectives import DECIBEL, BurstEnergy, Level, Objective, Rest, Sum, Target, Worst, soft_minimum
from .site_designs import Robust, SiteDesign, Variables

NEAREST, ALL = 1.3, 8.1  # distance within which particles repel, in shortest bonds: nearest neighbours, and as good as all
SETTLED = 24.0  # time until the motion is steady, in 1/gamma: a transient has then decayed to e^-12
READ = 20  # periods of the lowest frequency over which it is read
ORDER, STEP = 4, 0.3  # of the time steps; each as a fraction of the limit of Verlet
SMALL = 1e-6  # largest static deflection by a force of the runs, in shortest bonds


@dataclass(frozen=True)
class Verification:
    """What a design promises and what it achieves, in the unit of its objective.

    Attributes
    ----------
    before : float
        Value of the structure as it was given.
    promised_by_D0, given_by_D0 : tuple of float
        Promised value of each start of the design with D0 alone, and its value in the complete model; empty if the design was
        made without `compare=True`.
    promised : tuple of float
        Promised value of each start of this design.
    nearest, value, neighbours : float
        Values of this design with nearest neighbours alone, with the neighbours for which it was designed, and with all
        neighbours within eight bonds; NaN if it buckles.
    time_steps : float
        Value from time steps; NaN for objectives that are not a motion from rest: bands, modes, margins, and responses without
        damping.
    scattered : ndarray, shape (draws,)
        Values of lattices with scatter, drawn with another seed than the design; NaN for a lattice that buckles.
    """

    before: float
    promised_by_D0: tuple[float, ...]
    given_by_D0: tuple[float, ...]
    promised: tuple[float, ...]
    nearest: float
    value: float
    neighbours: float
    time_steps: float
    scattered: NDArray[np.float64]

    def table(self, unit: str = '', per: float = 1.0, goal: float | None = None) -> str:
        """A table of these values divided by `per`; with a `goal`, it says how many lattices with scatter reach this goal.

        Examples
        --------
        >>> import numpy as np
        >>> from magphonon.design import Verification
        >>> found = Verification(0.0, (20.0, 24.0), (-3.0, 1.0), (50.0, 58.0), 4.0, 58.0, 57.0, np.nan, np.array([40.0, 30.0]))
        >>> print(found.table('dB', goal=35.0))
        before                                            0 dB
        a design with D0 alone promises                   20 to 24 dB
          and gives                                       -3 to 1 dB
        this design, from each start                      50 to 58 dB
          chosen                                          58 dB
          with nearest neighbours alone                   4 dB
          with all neighbours                             57 dB
          by time steps                                   not of this objective
          with scatter, median and worst tenth            35 and 31 dB
          copies out of 2 that reach 35 dB                1
        """
        def told(*values):
            known = np.array(values, float) / per
            if np.isnan(known).all():
                return 'not of this objective'
            known[abs(known) < 1e-12 * abs(self.value) / per] = 0.0  # equal ports, whose levels differ by round-off
            ends = f'{np.nanmin(known):.3g}', f'{np.nanmax(known):.3g}'
            return f'{" to ".join(dict.fromkeys(ends))} {unit}'.strip()

        rows = [('before', told(self.before))]
        if self.promised_by_D0:
            rows += [('a design with D0 alone promises', told(*self.promised_by_D0)), ('  and gives', told(*self.given_by_D0))]
        rows += [('this design, from each start', told(*self.promised)), ('  chosen', told(self.value)),
                 ('  with nearest neighbours alone', told(self.nearest)), ('  with all neighbours', told(self.neighbours)),
                 ('  by time steps', told(self.time_steps))]
        if len(self.scattered):
            drawn = np.nan_to_num(self.scattered / per, nan=-np.inf)
            middle, low = np.quantile(drawn, [0.5, 0.1])
            rows.append(('  with scatter, median and worst tenth', f'{middle:.3g} and {low:.3g} {unit}'.strip()))
            if goal is not None:
                rows.append((f'  copies out of {len(drawn)} that reach {goal:.4g} {unit}'.rstrip(), f'{(drawn >= goal).sum()}'))
        return '\n'.join(f'{name:49} {text}' for name, text in rows)


def verify(design: SiteDesign, robust: Robust | None = None, seed: int = 1, steps: bool = True) -> Verification:
    """Test a design by methods and random draws that were not used to make it.

    Parameters
    ----------
    design : SiteDesign
    robust : Robust, optional
        Scatter for the test, drawn from `seed`, which must not be that of the design.
    steps : bool
        Whether to take time steps, which cost most.
    """
    v, calc = design.variables, design.variables.calc

    def within(reach):
        atoms = v.atoms.copy()
        atoms.calc = calc.changed(bonds=find_bonds(calc.reference, cutoff=reach * v.kept))
        try:
            return design.objective.value(Variables(atoms, v.over, v.sites, v.groups).rest(design.x))
        except ValueError:  # Unstable, or a cutoff that no shell keeps
            return np.nan

    other = design.conventional
    return Verification(
        design.before, *((), ()) if other is None else (other.starts, other.given_by_starts), design.starts, within(NEAREST),
        design.given, within(ALL), by_time_steps(design.objective, design.atoms) if steps else np.nan,
        np.empty(0) if robust is None else design.drawn(robust, seed))


def by_time_steps(objective: Objective, atoms: Atoms) -> float:
    """The value of an objective from time steps; NaN if the objective is not a motion.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Level, by_time_steps
    >>> from magphonon.response import Dof
    >>> from magphonon.stiffness import LinearSystem
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 2.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=4.0)
    >>> level = Level(Dof(9, np.array([1.0, 0, 0])), Dof(10, np.array([1.0, 0, 0])), 3.0, 0.2)
    >>> round(by_time_steps(level, patch), 2), round(level.value(LinearSystem.of(patch)), 2)  # dB above 1 mm/N
    (-16.1, -16.1)
    """
    rest = Rest(LinearSystem.of(atoms))
    levels = [one for one in _leaves(objective) if isinstance(one, Level)]

    def value(one):
        if isinstance(one, Sum):
            return sum(c * value(part) for c, part in one.parts)
        if isinstance(one, Target):
            return -(((value(one.of) - one.wanted) / one.width) ** 2)
        if isinstance(one, Worst):
            return soft_minimum(np.array([value(part) for part in one.of]), one.width)[0]
        if isinstance(one, Level) and one.damping:
            alike = [other for other in levels if (other.source.particle, other.damping) == (one.source.particle, one.damping)]
            motion = rest.once(('steps', one.source.particle, tuple(one.source.direction), one.damping),
                               lambda: _steady(atoms, one, sorted({other.omega for other in alike})))
            return DECIBEL * np.log(abs(one.seen.seen(motion[one.omega])) ** 2 + one.floor**2)
        if isinstance(one, BurstEnergy):
            square = rest.once(('steps', replace(one, region=())), lambda: _burst(atoms, one))
            return DECIBEL * np.log(square[list(one.region)].sum())
        return np.nan

    return float(value(objective))


def _leaves(objective) -> list[Any]:
    inside = {Sum: lambda one: [part for _, part in one.parts], Target: lambda one: [one.of], Worst: lambda one: one.of}
    parts: Callable[[Any], Any] | None = inside.get(type(objective))
    return [objective] if parts is None else [leaf for part in parts(objective) for leaf in _leaves(part)]


def _runner(atoms, drives, damping, largest=None):
    moving = atoms.copy()
    moving.calc = atoms.calc.changed()
    dt = STEP * 2 / highest_frequency(moving)
    return DrivenVerlet(moving, dt if largest is None else min(dt, largest), drives, damping=damping, order=ORDER)


def _steady(atoms, level, frequencies):
    """Displacements per unit force at each frequency, from a run in which all frequencies are driven until motion is steady."""
    calc, source = atoms.calc, level.source
    push = SMALL * calc.bonds.lengths.min() * abs(calc.rest_hessian('complete').diagonal()).min()
    dyn = _runner(atoms, [Harmonic(source.particle, source.direction, push, omega) for omega in frequencies], level.damping,
                  2 * STEP / max(frequencies))  # which counts where they lie above those of the structure
    reading = READ * 2 * np.pi / min(frequencies)
    dyn.run(int(SETTLED / level.damping / dyn.dt))
    recorder = Recorder(dyn, interval=max(1, int(0.2 / max(frequencies) / dyn.dt)))
    dyn.run(int(reading / dyn.dt))
    waves = np.array([f(omega * recorder.times) for omega in frequencies for f in (np.sin, np.cos)]).T
    u = recorder.displacements
    found = np.linalg.lstsq(waves, u.reshape(len(u), -1), rcond=None)[0].reshape(len(frequencies), 2, *u.shape[1:])
    size = np.linalg.norm(source.direction) / push
    return {omega: size * (s + 1j * c) for omega, (s, c) in zip(frequencies, found, strict=True)}


def _burst(atoms, burst):
    """Kinetic energy of each particle, summed over the window, for a unit force or the given amplitude."""
    unit = burst.amplitude or SMALL * atoms.calc.bonds.lengths.min() * abs(atoms.calc.rest_hessian('complete').diagonal()).min()
    size = np.linalg.norm(burst.source.direction)
    dyn = _runner(atoms, [ToneBurst(burst.source.particle, burst.source.direction, unit * size, burst.omega, burst.cycles)],
                  burst.damping, burst.dt)
    recorder = Recorder(dyn, interval=1)
    dyn.run(int(np.ceil(burst.window[1] / dyn.dt)))
    t, v = recorder.times[:-1] + dyn.dt / 2, np.diff(recorder.displacements, axis=0) / dyn.dt
    inside = (t > burst.window[0]) & (t < burst.window[1])
    energy = 0.5 * dyn.dt * dyn.atoms.get_masses() * (v[inside] ** 2).sum((0, 2))
    return energy / (1.0 if burst.amplitude else unit**2)
