"""Velocity Verlet with external forces and linear damping, built on ASE's own integrator; and splittings of higher order.

Short runs go through ASE's own loop, `VelocityVerlet.step`.  Runs that are long enough to repay loading compiled code go through
the blocks of steps of `magphonon.dynamics.engine`, if that can integrate the structure.

With the damping gamma, the gyration g of the calculator and the external force f(t), the equation of motion
`m u'' = F(u) - m gamma u' + m g J u' + f(t)` is split symmetrically around ASE's step. So it is of second order in dt, and the
limit omega dt < 2 remains: rotations, too, conserve the quadratic form of positions and speeds that Verlet steps conserve.

    v <- E v                     half the decay and the rotation, exact: E = exp(-(gamma + i g) dt/2) on v_x + i v_y
    v <- v + dt/2 f(t)/m         half the kick
    ASE's VelocityVerlet         F
    v <- v + dt/2 f(t + dt)/m
    v <- E v

Without damping, gyration and drives short runs are ASE's VelocityVerlet bit for bit, and compiled blocks are up to round-off.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from copy import copy
from pathlib import Path
from typing import IO, Any

import numpy as np
from ase import Atoms
from ase.md.logger import MDLogger
from ase.md.md import MolecularDynamics
from ase.md.verlet import VelocityVerlet
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from ..errors import one_of, positive, whole
from ..lattices.bonds import lengths_of
from ..stiffness.calculator import PairCalculator
from ..stiffness.plausibility import site_damping, warn_of_speed, warn_of_times
from ..stiffness.repulsion import masses_of
from ..stiffness.rest import LinearSystem, freedom
from ..traits import LINEAR, all_but, refuse, takes
from .cages import HARMLESS, Cages, Diverged
from .drives import check_drives, forces_and_walls
from .engine import (
    Blocks,
    fastest,
    half_step,
    highest_frequency,
    particle_bound,
    refusal,
    refuse_long_decay,
    refuse_long_step,
)
from .splittings import SPLITTINGS, StepsTooLong

ENGINES = ('auto', 'ase', 'compiled')
ENOUGH = 100_000  # number of particles of a thread from which on another one pays
COMPILING_PAYS, BESIDE = 2e6, 1000
"""An evaluation of the forces takes ASE's loop 0.15 us for each particle and for BESIDE more.  COMPILING_PAYS of these take as
long as loading compiled steps, 0.3 s; the seconds that these take to be compiled, once on a machine, are saved in ten runs."""
ROUNDED = 0.2  # phase in rad that errs as much as slow motion does by rounding its displacements in a stage, in single precision
SUMMED = 1e-9  # round-off of the errors of all steps
HEADROOM = 0.6  # share of a tolerance that steps use up which are told along a run, as strains may still grow
BLOCK = 32  # largest number of steps between two checks whether particles have collided or left
SHOWN = 8 * BLOCK  # largest number of steps after which blocks update the atoms, for users who iterate


class DrivenVerlet(VelocityVerlet):
    """ASE's VelocityVerlet with drives and damping; observers, trajectories and logs work as in any ASE dynamics.

    Both engines give observers the same states up to round-off; bit by bit, only runs with the same observers agree, because
    their calls divide the run into blocks.  'ase' is ASE's own loop, for any calculator.  'compiled' moves planar structures with
    PairCalculator by blocks of steps between two observer calls. It carries displacements from rest instead of positions, so
    that small displacements keep their digits until a setting changes; blocks in which bonds leave the range of its fitted law
    are done by ASE's loop.  With PairCalculator a run that diverges stops with Diverged; with other calculators this is not
    noticed.

    Between two runs, in observers, and between the steps of `irun`, positions, momenta, masses, constraints, the calculator, its
    parameters, the damping and the drives may be changed: every engine continues with the new values.

    A run that was killed can be continued from its `trajectory`: make a new DrivenVerlet with `stiffness.restored` of the last
    frame, and set its `nsteps` to the step of that frame, so that drives continue at the right time.  Frames hold absolute
    positions: displacements come back with an error of 1e-16 of the size of the structure.

    Parameters
    ----------
    atoms : ase.Atoms
        With its calculator.
    timestep : float
        In ms.
    drives : sequence of drives
        See `magphonon.dynamics.drives`; a plain function of the time returns the forces on all particles, shape (particles, 3).
    damping : float or array_like, shape (particles,)
        gamma in 1/ms.
    engine : {'auto', 'ase', 'compiled'}
        'auto' uses compiled blocks if these are possible, and the run is long enough to be worth the time of loading them.
    order : {2, 4, 6}, optional
        Order of the error in the time step. A step of order 4 or 6 evaluates the forces 6 or 11 times, but is so much longer that
        a run with a small error needs fewer evaluations in total (`magphonon.dynamics.splittings`). The damping must then be one
        number, and no particle may gyrate. By default 2, or with a `tolerance` the lowest order that meets it.
    tolerance : float, optional
        Allowed error of the displacements at the end of a run, as a fraction of the largest displacement in the run. Blocks then
        compute the bond forces with as few coefficients as this error allows, and compiled blocks use single precision if it is
        sufficient; this takes a half to a quarter of the time.  If no `order` is given, the error of the time steps is kept
        within the tolerance too, or StepsTooLong, a ValueError, gives the step that takes the fewest evaluations: at the
        beginning, or as soon as strains make waves too fast. Two kinds of motion may miss the tolerance: chaotic motion, by half
        a spacing and hardly damped; and close to buckling, by a factor of five, modes slower than a hundredth of the fastest.
    allow_unstable : bool
        Run even if the time step is over the limit of stability, or too long for the damping.
    logfile : path or file, optional
        For times in ms and energies in mJ, see `magphonon.dynamics.verlet`; '-' is the terminal.
    loginterval : int
        Steps between two lines of the log, and between two frames of the trajectory.
    threads : int, optional
        Number of threads of compiled blocks; results do not depend on it. By default one for each 100 000 particles, limited by
        OMP_NUM_THREADS if it is set, or else by the number of idle cores.
    **kwargs
        `trajectory` and other arguments of ASE's MolecularDynamics.

    Attributes
    ----------
    engine : str
        The engine in use.

    Examples
    --------
    >>> from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, ToneBurst, lattices
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 4.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> dyn = DrivenVerlet(patch, 0.05, [ToneBurst(len(patch) // 2, (0, 1), 1e-3, omega=2.0)], damping=0.1)
    >>> dyn.run(200)
    True
    >>> round(dyn.get_time(), 6)  # ms
    10.0
    """

    @takes('all neighbours', *LINEAR)
    def __init__(self, atoms: Atoms, timestep: float, drives: Sequence[Any] = (), damping: ArrayLike = 0.0, engine: str = 'auto',
                 order: int | None = None, allow_unstable: bool = False, logfile: str | Path | IO[str] | None = None,
                 loginterval: int = 1, threads: int | None = None, tolerance: float | None = None, **kwargs: Any) -> None:
        self.threads = threads_for(len(atoms)) if threads is None else whole('threads', threads)
        self.asked_engine = one_of('engine', engine, ENGINES)
        self.splitting = SPLITTINGS[2 if order is None else one_of('order', order, tuple(SPLITTINGS))]
        self.asked_order, self.tolerance = order, 0.0 if tolerance is None else positive('tolerance', tolerance)
        if tolerance and not isinstance(atoms.calc, PairCalculator):
            raise ValueError('a tolerance needs PairCalculator, whose highest frequency is known; leave the tolerance out')
        self._drives = tuple(drives)
        self._sum_of_drives, self._walls = forces_and_walls(self._drives, len(atoms))
        self._damping = _damping_of(damping, atoms, self.splitting)
        if atoms.calc is None:
            raise ValueError('the atoms have no calculator; attach atoms.calc = PairCalculator(atoms, law, ...)')
        if isinstance(atoms.calc, PairCalculator):
            masses_of(atoms)  # before ASE warns of one that is zero
        check_drives(self._drives, atoms)
        self.engine = _engine_for(atoms, engine)
        self.allow_unstable = allow_unstable
        super().__init__(atoms, positive('timestep', timestep, 'ms'), loginterval=loginterval, **kwargs)
        self._omega = self._refuse_steps()
        warn_of_times(atoms.calc, timestep, timestep=True)
        warn_of_speed(atoms.calc, atoms.get_velocities())
        if logfile:
            self.attach(self.closelater(EnergyLog(self, atoms, logfile, self.comm)), loginterval)
        self.recorders = []
        self._start = atoms.get_positions()
        self._blocks: Any = None
        self._cages, self._unseen, self._good = None, 0.0, None
        self._prepared = self._setting(), None, 0.0
        self._counted, self._error = 0, 0.0  # steps whose error has been added up, and their error

    @property
    def damping(self) -> NDArray[np.float64]:
        """Damping rate in 1/ms, shape (particles,); may be set at any time, to one number or one for each particle."""
        return self._damping

    @damping.setter
    def damping(self, damping: ArrayLike) -> None:
        self._damping = _damping_of(damping, self.atoms, SPLITTINGS[self.asked_order or 2])

    @property
    def drives(self) -> tuple[Any, ...]:
        """The drives, which may be replaced at any time by another sequence, as the damping may."""
        return self._drives

    @drives.setter
    def drives(self, drives: Sequence[Any]) -> None:
        drives = tuple(drives)
        check_drives(drives, self.atoms)
        self._drives = drives
        self._sum_of_drives, self._walls = forces_and_walls(drives, len(self.atoms))

    @property
    def displacements(self) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (particles, dim); exact in the block engines.

        With a calculator other than PairCalculator they are measured from the positions at the start.
        """
        if self._exact:
            return self._blocks.displacements
        if isinstance(self.atoms.calc, PairCalculator):
            return self.atoms.calc.displacements(self.atoms)
        return self.atoms.positions - self._start

    @property
    def velocities(self) -> NDArray[np.float64]:
        """Velocities in mm/ms, shape (particles, dim); exact in the block engines."""
        if self._exact:
            return self._blocks.velocities
        return self.atoms.get_velocities()[:, : getattr(self.atoms.calc, 'dim', 3)]

    @property
    def _exact(self):
        """Whether the blocks hold the present state of the atoms, which an observer may have changed."""
        return self._blocks is not None and self._blocks.calc is self.atoms.calc and self._blocks.current

    def step(self, forces: Any = None) -> NDArray[np.float64]:
        t, t_next = self.nsteps * self.dt, (self.nsteps + 1) * self.dt
        try:
            if self.splitting.stages > 1:
                return self._in_stages(t, forces)
            E = self._half_step()
            self._decay(E)
            self._kick(t)
            if self._walls:
                forces = self.atoms.get_forces(md=True) if forces is None else forces
                self._move_walls(t_next)
            forces = super().step(forces)
        except ValueError as error:
            self._inspect(t_next)  # the calculator raises for particles that coincide or are too far apart
            raise (Diverged(error.particle, t_next, error.what) if isinstance(error, Diverged) else error) from None
        self._kick(t_next)
        self._decay(E)
        return forces

    def _in_stages(self, t, forces):
        atoms, dt, masses = self.atoms, self.dt, self.atoms.get_masses()[:, None]
        drifts, damped = self.splitting.flow(dt, self.damping.max())
        forces = atoms.get_forces(md=True) if forces is None else forces
        for k, kick in enumerate(self.splitting.kicks):
            atoms.set_momenta(atoms.get_momenta() + kick * dt * forces)
            self._kick(t + dt * (0.0 if k == 0 else self.splitting.times[k - 1]), 2 * kick)
            if k < len(drifts):
                atoms.set_positions(atoms.get_positions() + drifts[k] * atoms.get_momenta() / masses)
                atoms.set_momenta(damped[k] * atoms.get_momenta())
                self._move_walls(t + dt * self.splitting.times[k])
                forces = atoms.get_forces(md=True)
        return forces

    def _half_step(self):
        """Factor by which damping and gyration change velocities in half a step; None if there are neither."""
        rate = getattr(self.atoms.calc, 'rate', 0.0)
        if not (self.damping.any() or np.any(rate)):
            return None
        guided, barred = freedom(self.atoms)[1:] if np.any(rate) else (np.zeros(0, int), np.zeros((0, 3, 3)))
        return half_step(self.damping, rate, guided, barred, self.dt)

    def _decay(self, E):
        """Apply damping and gyration, the factor E of velocities in half a step."""
        if E is None:
            return
        p = self.atoms.get_momenta()
        if E.ndim == 3:
            p = np.einsum('ixy,iy->ix', E, p)
        else:
            turned = E * (p[:, 0] + 1j * p[:, 1])
            p = np.column_stack([turned.real, turned.imag, abs(E) * p[:, 2]])
        self.atoms.set_momenta(p)

    def _move_walls(self, t):
        if self._walls:
            moved = self._walls.particles
            self.atoms.positions[moved] = self._at_rest[moved] + self._walls.forces(np.array([t]))[0]

    def _kick(self, t, share=1.0):
        if self._sum_of_drives:
            momenta = self.atoms.get_momenta()
            momenta[self._sum_of_drives.particles] += share * self.dt / 2 * self._sum_of_drives.forces(np.array([t]))[0]
            self.atoms.set_momenta(momenta)

    def irun(self, steps: int = 50) -> Iterator[bool]:
        """Run for `steps` more steps as an iterator, which yields at observer calls and at least every few hundred steps.

        ASE's own iterator yields at every step. If you need each step, attach an observer, use a `Recorder`, or engine='ase'.
        """
        self.max_steps, self._counted = self.nsteps + steps, self.nsteps
        self._prepare(steps)
        if self.nsteps == 0:
            self.log()
            self.call_observers()
        yield self.nsteps == self.max_steps
        while self.nsteps < self.max_steps:
            self._prepare(steps)  # observers, and who iterates, may have changed any setting
            try:
                if self._blocks is None:
                    self._one_step()
                else:
                    self._advance_to(self._next_call())
            except Diverged as error:
                error.atoms, error.last_good = self.atoms, self.get_time()
                raise
            self.log()
            self.call_observers()
            yield self.nsteps == self.max_steps

    def _next_call(self):
        """The step at which an observer, or who iterates, looks at the atoms next."""
        intervals = [interval for _, interval, *_ in self.observers]
        stops = [self.nsteps + SHOWN, self.max_steps, *(-k for k in intervals if -k > self.nsteps)]
        return min(stops + [self.nsteps + k - self.nsteps % k for k in intervals if k > 0])

    def _refuse_steps(self):
        """Raise ValueError for an unstable time step; else return a bound of the highest frequency, rad/ms, 0 if unknown."""
        if self.splitting.stages > 1:  # forces may depend on positions only
            refuse(self.atoms, all_but('a step of order 4 or 6', 'gyration'))
        limit = max(one.limit for one in SPLITTINGS.values()) if self._chooses else self.splitting.limit
        limit, omega = np.inf if self.allow_unstable else limit, 0.0
        if self.tolerance or not self.allow_unstable:
            omega = refuse_long_step(self.atoms, self.dt, limit)
        if not self.allow_unstable:
            refuse_long_decay(self.damping, self.dt, self.splitting)
        return max(fastest(omega**2, getattr(self.atoms.calc, 'turning', 0.0)), self._driven)

    @property
    def _driven(self):
        """The highest frequency of the drives and of the courses of walls, rad/ms; plain functions count as zero."""
        courses = [getattr(drive, 'course', drive) for drive in self._drives]
        return max([0.0, *(float(np.max(getattr(one, 'omega', 0.0))) for one in courses)])

    @property
    def _chooses(self):
        """Whether the tolerance decides on the order of the steps."""
        only = np.ptp(self._damping) or np.any(getattr(self.atoms.calc, 'rate', 0.0))
        return bool(self.tolerance and self.asked_order is None and not only)

    def _longest(self, share=1.0):
        """The longest step in ms that meets this share of the tolerance to the end of the run, of each order."""
        omega = self._omega or 1e-300  # where nothing vibrates, any step will do
        return {order: SPLITTINGS[order].longest(omega * self.max_steps * self.dt, share * self.tolerance) / omega
                for order in (SPLITTINGS if self._chooses else (2,))}

    def _order(self):
        """The lowest order whose steps meet the tolerance to the end of the run."""
        for sharp in (False, True):  # a bound of the highest frequency first
            if sharp:
                omega = highest_frequency(self.atoms)
                self._omega = max(fastest(omega**2, self.atoms.calc.turning), self._driven)
            longest = self._longest()
            for order in longest:
                if self.dt <= longest[order]:
                    return order
        cheapest = min(longest, key=lambda order: SPLITTINGS[order].stages / longest[order])
        raise self._too_long(longest[cheapest])

    def _too_long(self, longest, why=''):
        return StepsTooLong(f'time steps of {self.dt:.6g} ms are too long for an error of {self.tolerance:g} after '
                            f'{self.max_steps * self.dt:.6g} ms{why}', longest)

    def _add_error(self, u):
        """Add the error of the steps since the last time, at the frequency that waves have at the displacements `u`."""
        if not self.tolerance or self.asked_order is not None:
            return
        steps, self._counted, faster = self.nsteps - self._counted, self.nsteps, 1.0
        if lengths_of(u).max(initial=0.0) > HARMLESS * self.atoms.calc.bonds.shortest:
            about = LinearSystem.about(self.atoms.calc, self.atoms)  # pyright: ignore[reportArgumentType]  there are bonds
            faster = max(particle_bound(about, u) / particle_bound(about, 0 * u), 1.0)
        x = faster * self._omega * self.dt
        now, at_once = self.splitting.error(x, np.array([x * steps, 0.0]))
        self._error += now - at_once
        if not self._error + at_once <= (1 + SUMMED) * self.tolerance:
            self._omega *= faster
            longest = self._longest(HEADROOM)[self.splitting.order]
            raise self._too_long(longest, f', as strains make waves {faster:.3g} times faster at {self.get_time():.6g} ms')

    def _one_step(self):
        """Do a step of ASE's loop; if the bonds are no longer valid, go back to the last state in which they were, and raise."""
        if self._good is None:
            self._good = self._state()
        try:
            self.step()
            self.nsteps += 1
            if self._time_to_look() or self.nsteps == self.max_steps:
                self._inspect(self.get_time())
                self._good = self._state()
                self._add_error(self.displacements)
        except Diverged:
            self.nsteps, self.atoms.arrays['positions'][:], self.atoms.arrays['momenta'][:] = self._good
            for recorder in self.recorders:
                recorder.forget_after(self.get_time())
            raise

    def _advance_to(self, stop):
        """Move on to the step `stop` by blocks, after each of which the bonds are checked; then update the atoms."""
        self._blocks.follow()
        try:
            while self.nsteps < stop:
                steps = min(self._blocks.steps_to_next_look(BLOCK), stop - self.nsteps)
                if self._blocks.advance(self.nsteps, steps):
                    self.nsteps, self.engine = self.nsteps + steps, 'compiled'
                    self._add_error(self._blocks.displacements)
                else:
                    self._by_ase(steps)
        finally:
            self._blocks.write()

    def _by_ase(self, steps):
        """Do steps in ASE's loop, of motion beyond the law of the blocks."""
        self._blocks.write()
        self._cages, self._good, self.engine = self._blocks.cages, None, 'ase'
        try:
            for step in range(steps):
                self._unseen += step == steps - 1  # after the last one the bonds are looked at, as after a block
                self._one_step()
        finally:
            self._blocks.follow()

    def _repays(self, steps):
        """Whether a run of so many steps, of the present order, is worth loading compiled code, or that is loaded already."""
        work = (len(self.atoms) + BESIDE) * steps * self.splitting.stages
        return self._blocks is not None or work >= COMPILING_PAYS

    def _prepare(self, steps):
        """If any setting has changed, choose the order and engine of a run of `steps`, and refuse an unstable step."""
        now, (before, *was), rough, long = self._setting(), self._prepared, self._roughness, self._repays(steps)
        if now == before and [long, rough] == was:
            return
        if now != before:
            self._refuse_changed_step(before[1])
            self.splitting = SPLITTINGS[self.asked_order or 2]  # until the tolerance chooses again
            self._omega = self._refuse_steps()
        if rough and self.asked_order is None:
            self.splitting = SPLITTINGS[self._order()]
            now, long = self._setting(), self._repays(steps)
        self.engine = _engine_for(self.atoms, self.asked_engine, long)
        if now == before and self._blocks is not None and self.engine != 'ase':
            self._blocks.use(rough)  # all that changes is the kernel
        else:
            self._begin(rough)
        self._prepared = now, long, rough  # last: what raised above raises again

    def _begin(self, rough):
        """Make the blocks of compiled steps, or the cages that ASE's loop looks at; walls go to where they are now."""
        blocks = None
        if self.engine != 'ase':
            blocks = Blocks(self.atoms, self.dt, self._drives, self.damping, self.splitting, self.threads)
            blocks.use(rough)
        self._cages = Cages(self.atoms) if blocks is None and isinstance(self.atoms.calc, PairCalculator) else None
        self._blocks, self._good = blocks, None
        if self._walls:
            self._place_walls()

    @property
    def _roughness(self):
        """Relative error of stiffness that the tolerance allows; 0 without a tolerance.

        An error e is e/2 of a phase.  It is a power of two, so that it seldom changes as a run gets longer.
        """
        stages = SPLITTINGS[self.asked_order or 6].stages
        phase = self.max_steps * max(self._omega * self.dt, ROUNDED * stages)
        return 2.0 ** np.floor(np.log2(self.tolerance / max(phase, 1.0))) if self.tolerance and self.max_steps else 0.0

    def _refuse_changed_step(self, dt):
        if self.dt != dt and self.nsteps and (self._drives or self.recorders):
            raise ValueError(f'the time step was {dt:g} ms for {self.nsteps} steps and is {self.dt:g} ms now, which would '
                             'change the time of drives and records; set it back, or continue with a new '
                             'DrivenVerlet(atoms, ...), whose time begins at zero')

    def _place_walls(self):
        """Move the walls to where they are at the present time, from their places at rest."""
        self._at_rest = self._start
        if isinstance(self.atoms.calc, PairCalculator):
            self._at_rest = self.atoms.get_positions()
            self._at_rest[:, : self.atoms.calc.dim] -= self.atoms.calc.displacements(self.atoms)
        if self._blocks is not None:
            self._blocks.place_walls(self.get_time())
        else:
            self._move_walls(self.get_time())

    def _setting(self):
        """All that forces and motion depend on, except the state itself."""
        atoms, calc = self.atoms, self.atoms.calc
        changeable = getattr(calc, 'model', None), getattr(calc, 'sites', None)  # frozen: `set` makes others
        damping = self.damping[:1] if self.damping.strides == (0,) else self.damping  # of all, where it is one number
        return (calc, self.dt, self.splitting, self._sum_of_drives, changeable,
                [constraint.todict() for constraint in atoms.constraints],
                *(array.tobytes() for array in (atoms.get_masses(), atoms.cell.array, atoms.pbc, damping)))

    def _time_to_look(self):
        """Whether a check of the bonds is due: the fastest particle may have moved far, or many steps have passed."""
        if self._cages is None:
            return self.nsteps % BLOCK == 0
        speed = np.linalg.norm(self.atoms.get_velocities(), axis=1).max(initial=0.0)
        self._unseen += 1 / self._cages.steps_between_looks(speed, np.inf, self.dt, BLOCK) if np.isfinite(speed) else 1
        if self._unseen < 1 - 1e-9:  # 32 times 1/32
            return False
        self._unseen = 0.0
        return True

    def _state(self):
        return self.nsteps, self.atoms.get_positions(), self.atoms.get_momenta()

    def _inspect(self, time):
        if self._cages is not None:
            calc = self.atoms.calc
            u = self.atoms.positions - calc.reference.positions
            self._cages.look(calc.displacements(self.atoms) if np.isfinite(u).all() else u[:, : calc.dim], time)

    def run(self, steps: int = 50) -> bool:
        """Run for `steps` more steps, and return True at the end as ASE does.  Raises Diverged if particles collide or leave."""
        target = self.nsteps + whole('steps', steps, 0)
        with tqdm(total=target, initial=self.nsteps, unit='step', delay=2, disable=None) as progress:
            for _ in self.irun(steps):
                progress.update(self.nsteps - progress.n)
        return True

    def _traj_write_image(self, description):
        self._refresh_properties()  # blocks of steps leave no forces behind
        super()._traj_write_image(description)


def _engine_for(atoms, asked, long=False):
    """The engine for `atoms` if the user asked for `asked`; ValueError if that engine cannot integrate them."""
    if asked == 'ase' or (asked == 'auto' and not long):
        return 'ase'
    reason = refusal(atoms)
    if reason and asked == 'compiled':
        raise ValueError(f"engine='compiled' cannot integrate these atoms: {reason}; use engine='ase'")
    return 'ase' if reason else 'compiled'


def threads_for(particles: int) -> int:
    """Default number of threads of compiled blocks: one for each ENOUGH particles, but no more than there are idle cores.

    A thread that waits for its core holds up the others, so beside other load several threads are slower than one.
    """
    allowed = os.environ.get('OMP_NUM_THREADS', '')  # also what a batch system or a pool of processes sets
    if not allowed.isdigit() and particles >= 2 * ENOUGH and hasattr(os, 'sched_getaffinity'):  # where there is a load to ask for
        allowed = round(len(os.sched_getaffinity(0)) - os.getloadavg()[0])
    return max(1, min(int(allowed or 1), particles // ENOUGH))


def _damping_of(damping, atoms, splitting):
    """The damping of each particle, as a read-only copy."""
    rates = site_damping(copy(damping), len(atoms), atoms.calc)
    if splitting.stages > 1 and np.ptp(rates):
        raise ValueError('steps of order 4 and 6 need one damping for all particles, not one for each; use order=2')
    return rates


class EnergyLog(MDLogger):
    """ASE's MDLogger with times in ms and energies in mJ instead of ps, eV and K.

    The total energy is that of the particles, bonds, springs and dead loads; drives and damping change it.
    """

    def __init__(self, dyn: MolecularDynamics, atoms: Atoms, logfile: str | Path | IO[str], comm: Any) -> None:
        super().__init__(dyn, atoms, logfile, header=False, comm=comm)  # pyright: ignore[reportArgumentType]  Path too
        self.hdr = f'{"Time[ms]":<16}' + ''.join(f'{name:>20}' for name in ('Etot[mJ]', 'Epot[mJ]', 'Ekin[mJ]'))
        self.logfile.write(self.hdr + '\n')

    def __call__(self) -> None:
        potential, kinetic = self._potential_energy(), self.atoms.get_kinetic_energy()
        energies = ''.join(f'{energy:20.11e}' for energy in (potential + kinetic, potential, kinetic))
        self.logfile.write(f'{self.dyn.get_time():<16.10g}{energies}\n')
        self.logfile.flush()
