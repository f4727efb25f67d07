"""The plan for waveforms: does the passage of a burst need D*, and does it need time steps with the nonlinear law?

The effect of D* is the difference of the exact linear solutions with and without it.  The effect of nonlinearity is bounded by
the largest strain s of a bond: the first nonlinear term is (a + 1) s/2 of the linear one, for a force that falls as r^-a.  Only
if this bound does not decide, trial runs with long time steps are made: one of the full burst, and one of a weak burst with 1e-6
of the amplitude, which is linear.  Their difference is the effect of nonlinearity, without the time-step error.

The time-step error is proportional to the square of the step.  Without a trial run it is bounded by the third derivative of the
exact linear solution, because a lattice also vibrates at its own frequencies, not only at that of the carrier.  With a trial run
it is the change of the full burst when the step is doubled, because the amplitude shifts the frequencies.

If a whole row of particles is driven, the trial runs use a strip one cell wide.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms

from ..dynamics.cages import Diverged
from ..dynamics.drives import Drives
from ..dynamics.recorder import Recorder
from ..dynamics.timestep import highest_frequency
from ..dynamics.verlet import DrivenVerlet
from ..lattices.bonds import Bonds
from ..lattices.patches import RIM
from ..response.propagation import propagate
from ..stiffness.bond import MODELS
from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.linear_system import LinearSystem
from ..stiffness.repulsion import repulsion_of
from ..stiffness.sites import refuse_unlike
from .plan import LONGEST_STEP, STEP_ERROR_FRACTION, Method, Plan, Settings, force_cost, percent

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

    from ..dynamics.drives import ToneBurst
    from ..response.propagation import Transient
    from ..stiffness.repulsion import Repulsion
    from ..waves.wave_source import Site

WEAK_AMPLITUDE = 1e-6
"""Amplitude of the weak burst, as a fraction of the full one: linear to six digits, and far above round-off.  A thousand times as
much or as little gives the same motion to four digits."""
BOUND_FACTOR, BUILD_UP_STEPS = 5, 30
"""Safety factor of the bound of nonlinearity, and the number of steps along a row beyond which the factor grows with the square
root of their number, because harmonics build up on the way.  The largest ratios measured, without foundation, are 3 along 20
steps and 5.1 along 60."""
LARGEST_CHANGE = 0.2
"""Largest relative change of the motion, when the step is doubled, from which the error is taken to be a third of the change.  In
the bursts of tests/planning/test_step_plans.py the errors then are between one half and all of what is told."""
CANCELLATION = 1.5
"""Safety factor of the time-step error without a trial run, for parts of the third derivative that cancel at one time while
their errors do not.  Of 70 bursts tried the true error was at most 0.7 of the bound with it."""
STEP_DOUBT = 0.5
"""Relative uncertainty of the time-step error of a full burst from runs with two steps, as its higher orders are unknown: with it
no step of the bursts in tests/planning/test_step_plans.py misses its tolerance."""
FRAMES = 12
"""Number of times compared and written in each period of the carrier: harmonics up to the fifth are resolved."""
DOUBT_IN_A_PATCH = 0.1
"""Relative uncertainty of the effects of D* and of time steps in a patch, if they are estimated in a strip: in five beams D*
changed the patch by 1 to 14 % less than the strip."""
STRIP_RATIO = 2.5
"""Largest ratio of the nonlinearity in a strip to that in the patch: a beam is weaker away from its middle; 2.4 was measured.
The inverse ratio has no such bound: without foundation the sides of a shear beam gave nine times the nonlinearity of a strip."""
SIDE_EFFECT = 0.1
"""Largest relative effect of D* at the sides of a beam, where bonds rotate even if none does in a strip; 7 % was measured."""
DOUBT = 0.12
"""Relative uncertainty of the nonlinearity from a trial run of the structure itself, because of its long steps: in four
bursts it was 0.2 to 13 % too large, and a quarter of that with half the step."""
HALVINGS = 3
"""Largest number of times that a trial run is repeated with half the step, if its result is too close to the tolerance or its
error is no square of the step: the last run takes eight times as long as the first."""


@dataclass(frozen=True)
class StandIn:
    """How the structure of the trial runs differs from that of the scene, for which it stands.

    Attributes
    ----------
    copies : float
        Ratio of the size of the scene to that of the structure.
    doubt : float
        Relative uncertainty of the estimates, because the structures differ.
    sides : float
        Additional relative effect of D* on the waveform of the scene.
    """

    copies: float = 1.0
    doubt: float = 0.0
    sides: float = 0.0


def strip(cell: Atoms, rows: int) -> Atoms:
    """A strip one cell wide and periodic along R1, with `rows` cells along R2, of which the first and the last are held.

    A motion that is uniform along R1, such as a wave from a whole row of sources, is the same in the strip as in the lattice.

    Parameters
    ----------
    cell : ase.Atoms
        Planar, with its MagneticRepulsion.
    rows : int

    Returns
    -------
    ase.Atoms
        With its MagneticRepulsion.

    Raises
    ------
    ValueError
        If the particles differ in law, strength or foundation.
    """
    calc = repulsion_of(cell)
    refuse_unlike(calc, 'a strip', 'make it as a structure of its own, with its own calculator')
    atoms = cell.repeat((1, rows, 1))
    periodic = calc.on(atoms)
    bonds = periodic.bonds
    inside = bonds.shift[:, 1] == 0  # the other bonds join the last row to the first
    bonds = Bonds(bonds.i[inside], bonds.j[inside], bonds.shift[inside], bonds.vectors[inside], len(atoms))
    atoms.pbc = True, False, False
    row = np.repeat(np.arange(rows), len(cell))
    atoms.set_tags(np.where((row == 0) | (row == rows - 1), RIM, 0))
    atoms.set_constraint(FixAtoms(mask=atoms.get_tags() == RIM))
    atoms.calc = MagneticRepulsion(atoms, calc.law, bonds=bonds, anchors=periodic.anchors, load=periodic.load,
                                   **calc.parameters)
    return atoms


def plan_beam(cell: Atoms, patch: Atoms, where: Site, drive: ToneBurst, damping: float, duration: float,
              tolerance: float) -> Plan:
    """Plan for a burst from a whole row of a patch, from trial runs of a strip, or of the whole patch if the strip does not
    decide.

    Parameters
    ----------
    cell, patch : ase.Atoms
        With their MagneticRepulsion.
    where : Site
        Site of a source that is a row, see `magphonon.waves.wave_source`.
    drive : ToneBurst
        `where.burst(...)`.
    damping, duration, tolerance
        As for `plan_waveform`.
    """
    pilot = strip(cell, len(where.row) + 2)
    inside = np.flatnonzero(pilot.get_tags() != RIM)
    y = pilot.positions[inside, 1]
    lowest = inside[y < y.min() + 1e-6 * cell.cell.lengths()[0]]
    copies = np.sum(patch.get_tags() != RIM) / len(inside)
    beam = replace(drive, particles=lowest, amplitude=np.abs(drive.amplitude).max())
    plan = plan_waveform(pilot, beam, inside[:: len(cell)], damping, duration, tolerance,
                         StandIn(copies, DOUBT_IN_A_PATCH, SIDE_EFFECT))
    linear = plan.methods[1]
    by_bound = linear.doubt == DOUBT_IN_A_PATCH  # without a trial run
    if by_bound or linear.error > STRIP_RATIO * tolerance:
        return plan
    closer = plan_waveform(patch, drive, where.row, damping, duration, tolerance)
    return replace(closer, cost=plan.cost + closer.cost)


def plan_waveform(atoms: Atoms, drive: ToneBurst, row: NDArray[np.int_], damping: float, duration: float, tolerance: float,
                  stand_in: StandIn = StandIn()) -> Plan:
    """Plan for the displacements of a row while a burst passes.

    Parameters
    ----------
    atoms : ase.Atoms
        The structure of the trial runs, with MagneticRepulsion: the structure of the scene or a `strip` of it.
    drive : ToneBurst
    row : ndarray of int
        Particles measured.
    damping : float
        gamma in 1/ms.
    duration : float
        In ms.
    tolerance : float
        Allowed rms error of the displacements over the row and the record, relative to their rms.
    stand_in : StandIn, optional
        If `atoms` is not the structure of the scene.

    Returns
    -------
    Plan
        The settings of its methods are `model` and, where time is stepped, `dt` in ms.

    Raises
    ------
    ValueError
        If particles collide or leave their cages.
    """
    system = LinearSystem.of(atoms)
    calc, top, doubt, sides = system.calc, highest_frequency(system), stand_in.doubt, stand_in.sides
    dt = LONGEST_STEP / top  # of a trial run: half the longest step, because the step is doubled to find its error
    interval = 2 * max(1, int(np.pi / drive.omega / FRAMES / dt))  # even, so that runs with twice the step have the same frames
    steps = int(duration / dt)
    times = dt * np.arange(interval, steps + 1, interval)
    linear = {model: propagate(as_model(atoms, model), times, [drive], damping) for model in MODELS}
    exact = linear['complete'].displacements
    frozen = difference(linear['conventional'].displacements[:, row], exact[:, row])
    strain = _strain(calc, exact)
    nonlinear = BOUND_FACTOR * max(1.0, np.sqrt(len(row) / BUILD_UP_STEPS)) * steepness(calc) / 2 * strain
    stepping, step_doubt = linear_step_error(system, linear['complete'], drive, damping, row, dt), 0.0
    force = len(calc.bonds) * force_cost(calc.dim)
    evidence = [f'D* changes the waveform by {percent(frozen)}'
                + (f', and by up to {percent(sides)} at the sides of the beam' if sides else ''),
                f'bonds stretch and rotate by at most {percent(strain)}, so nonlinearity changes the waveform by less than '
                f'{percent(nonlinear)}']
    cost = sum(answer.products for answer in linear.values()) * system.K.nnz
    own_doubt, longest = 0.0, LONGEST_STEP * 2 / top  # the bound has no uncertainty
    if nonlinear * (1 + doubt) > tolerance:
        full, weak = (_Trial(atoms, drive, row, damping, (dt, interval, steps), share) for share in (1, WEAK_AMPLITUDE))
        for halvings in range(HALVINGS + 1):
            fine, own_doubt = 2**halvings, DOUBT / 4**halvings
            nonlinear = difference(full(fine), weak(fine))
            if doubt or abs(nonlinear / tolerance - 1) > 2 * own_doubt:
                break
        evidence[1] = (f'nonlinearity: {percent(nonlinear)} (from a trial run of {len(atoms)} particles and {steps * fine} '
                       f'steps; its own time-step error is {percent(difference(weak(fine), exact[:, row]))} at small amplitude)')
        stepping, step_doubt, longest = full.step_error(fine), STEP_DOUBT, full.longest
        cost += (full.steps + weak.steps) * force
        if stepping == np.inf:
            evidence.append('time steps do not converge at this amplitude, so their error is unknown: run the nonlinear model '
                            'with shorter and shorter steps, and compare')

    methods = []
    for model, error in (('conventional', frozen + sides + nonlinear), ('complete', nonlinear)):
        products, entries = linear[model].products, LinearSystem.of(as_model(atoms, model)).K.nnz
        methods.append(Method(f'{model} linear', f'exact propagation in {products} products with the stiffness matrix',
                              stand_in.copies * products * entries, error, doubt + own_doubt, Settings(model)))
    known = stepping < np.inf
    dt_run = min(dt * np.sqrt(STEP_ERROR_FRACTION * tolerance / stepping), longest) if known else longest / 2
    count = int(np.ceil(duration / dt_run))
    methods.append(Method('nonlinear', f'velocity Verlet in {count} steps', stand_in.copies * count * force,
                          float(stepping * (dt_run / dt) ** 2), doubt + step_doubt, Settings('complete', dt=float(dt_run))))
    return Plan('Waveform', 'its rms', tolerance, tuple(methods), tuple(evidence), cost)


def steepness(calc: Repulsion) -> float:
    """Exponent -d log phi''/d log r with which the stiffness of a nearest neighbour falls: a + 1 for a force r^-a."""
    r = calc.bonds.lengths.min()
    near, far = calc.law.d2phi(np.array([1 - 1e-4, 1 + 1e-4]) * r)
    return float(np.log(near / far) / 2e-4)


def _strain(calc, u):
    """Largest relative displacement of the ends of a bond over its length; `u` has the shape (times, particles, dim)."""
    bonds = calc.bonds
    return float((np.linalg.norm(u[:, bonds.j] - u[:, bonds.i], axis=2) / bonds.lengths).max())


def as_model(atoms: Atoms, model: str) -> Atoms:
    """The same structure under another model."""
    other, calc = atoms.copy(), repulsion_of(atoms)
    other.calc = calc.about(calc.reference, model=model)
    return other


def linear_step_error(system: LinearSystem, motion: Transient, drive: ToneBurst, damping: float, row: NDArray[np.int_],
                      dt: float) -> float:
    """Upper bound of the relative error of time steps in a row, from the exact linear motion of all particles.

    A time step dt raises each frequency w by w (w dt)^2/24, which changes what was sent at t = 0 by t dt^2/24 of its third
    derivative j, and what was sent later by less; the factor `CANCELLATION` is for parts of j that cancel.  Amplitudes change by
    dt^2/12 of the acceleration a.  Each damping step adds terms with gamma in place of w.  The derivatives contain every
    frequency in the motion with its own weight.
    """
    h = 1e-4 / drive.omega  # of a central difference, with a relative error of 1e-8
    m, pushes = np.repeat(system.masses, system.dim), Drives([drive], len(system.masses))

    def force(times):
        f = np.zeros((len(times), len(system.masses), system.dim))
        f[:, pushes.particles] = pushes.forces(times)[..., : system.dim]
        return system.shapes.T @ f.reshape(len(times), -1).T

    def reduced(u):
        return system.shapes.T @ (m * u.reshape(len(u), -1)).T

    v = reduced(motion.velocities)
    a = force(motion.times) - system.K @ reduced(motion.displacements) - damping * v
    j = (force(motion.times + h) - force(motion.times - h)) / (2 * h) - system.K @ v - damping * a

    def size(y):
        return np.linalg.norm((system.shapes @ y).T.reshape(motion.displacements.shape)[:, row])

    t = CANCELLATION * motion.times
    error = (size(t * j) + damping * size(t * a) + damping**2 * size(t * v)) / 24 + size(a) / 12
    return float(dt**2 * error / np.linalg.norm(motion.displacements[:, row]))


class _Trial:
    """Trial runs of one burst from rest, each made once: the displacements of a row, divided by the share of the amplitude.

    Parameters
    ----------
    atoms, drive, row, damping
        As for `plan_waveform`.
    clock : tuple of (float, int, int)
        Time step, number of steps between two frames, and number of steps of the run with fine = 1.
    share : float
        The amplitude of the trial runs, as a fraction of that of the burst.

    Attributes
    ----------
    steps : float
        Number of steps made in all runs.
    longest : float
        Longest step in ms of a run that is known to converge.
    """

    def __init__(self, atoms, drive, row, damping, clock, share):
        self._atoms, self._row, self._damping, self._share = atoms, row, damping, share
        self._drive = replace(drive, amplitude=share * np.asarray(drive.amplitude))
        self._dt, self._interval, self._length = clock
        self._runs, self.steps, self.longest = {}, 0.0, self._dt

    def __call__(self, fine):
        """With the step dt/fine, where 1/2 is the smallest fine."""
        if fine not in self._runs:
            steps = int(self._length * fine)
            dyn = DrivenVerlet(as_model(self._atoms, 'complete'), self._dt / fine, [self._drive], self._damping, engine='numpy')
            record = Recorder(dyn, self._row, int(self._interval * fine))
            try:
                dyn.run(steps)
            except Diverged as error:
                raise ValueError(f'particles collide or leave their cages, so there is nothing to plan: {error}') from None
            self._runs[fine], self.steps = record.displacements[1:] / self._share, self.steps + steps
        return self._runs[fine]

    def change(self, fine):
        """Relative change of the motion if the step dt/fine is doubled; infinite if it then leaves its cages."""
        exact = self(fine)
        try:
            return difference(self(fine / 2), exact)
        except ValueError:
            return np.inf

    def step_error(self, fine):
        """Relative error of the step dt, from the change of the motion when a step, dt/fine or finer, is doubled.

        An error that grows with the square of the step changes by three times itself.  It is infinite if the change does not
        become small with `HALVINGS` more halvings of the step.
        """
        for finer in fine * 2.0 ** np.arange(HALVINGS + 1):
            change, self.longest = self.change(finer), 2 * self._dt / finer
            if change <= LARGEST_CHANGE:
                return change / 3 * finer**2
        return np.inf


def difference(u: NDArray[np.float64], exact: NDArray[np.float64]) -> float:
    """Root mean square of the difference, divided by the root mean square of the exact displacements."""
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))
