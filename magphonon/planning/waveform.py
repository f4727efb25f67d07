"""The plan for waveforms: does the passage of a burst need D*, and does it need time steps with the nonlinear law?

The effect of D* is the difference of the exact linear solutions with and without it.  The effect of nonlinearity is bounded by
the largest strain s of a bond: the first nonlinear term is (a + 1) s/2 of the linear one, for a force that falls as r^-a.  Only
if this bound does not decide, perturbation theory computes the effect (`magphonon.planning.waveform`).  Where that is
not slight, trial runs with long time steps are made: one of the full burst, and one of a weak burst with 1e-6 of the amplitude,
which is linear.  Their difference is the effect of nonlinearity, without the time-step error.

The time-step error is proportional to the square of the step.  Without a trial run it is bounded by the third derivative of the
exact linear solution, because a lattice also vibrates at its own frequencies, not only at that of the carrier.  With a trial run
it is the change of the full burst when the step is doubled, because the amplitude shifts the frequencies.

If a whole row of particles is driven, the trial runs use a strip one cell wide.

The effect of a slight nonlinearity on a motion, by perturbation theory.

The linear motion u1 leaves a force N(u1) over, that of the law beyond its linear part, and this force drives a correction u2:

    u1'' + gamma u1' + K u1 = f        u2'' + gamma u2' + K u2 = N(u1)

With the energy psi(s) of a bond over the square s of its length, s = s0 + delta, its force is 2 psi'(s) (R + d), where psi' is
taken to third order in delta.  What u2 itself changes is smaller than u2 by about as much as u2 is smaller than u1.

Both motions are stepped in time by velocity Verlet with the same step, as a trial run with the law would be, so that their ratio
has the time-step error of such a run.  The force N is computed at many times at once.

A strip of a lattice, in which a wave from a whole row of sources is the same as in the lattice.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms
from scipy import sparse

from ..dynamics.cages import Diverged
from ..dynamics.drives import Drives
from ..dynamics.engine import highest_frequency
from ..dynamics.recorder import Recorder
from ..dynamics.verlet import DrivenVerlet
from ..lattices.bonds import Bonds
from ..lattices.patches import RIM
from ..response.propagation import propagate
from ..stability.amplitude_shifts import law_derivatives
from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import LinearSystem
from ..stiffness.sites import refuse_unlike
from .plan import LONGEST_STEP, STEP_ERROR_FRACTION, Method, Plan, Settings, force_cost, percent

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

    from ..dynamics.drives import ToneBurst
    from ..response.propagation import Transient
    from ..stiffness.repulsion import Repulsion
    from ..waves.wave_source import Site

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
    atoms.calc = MagneticRepulsion(atoms, calc.interaction, bonds=bonds, anchors=periodic.anchors, load=periodic.load,
                                   **calc.parameters)
    return atoms


TIMES = 8
"""Number of steps whose forces are computed at once, so that the arrays stay in the processor's cache."""


def relative_correction(system: LinearSystem, drive: ToneBurst, damping: float, row: NDArray[np.int_],
                        clock: tuple[float, int, int]) -> float:
    """Root mean square of the correction u2 of a burst from rest, over that of the linear motion u1, in a row.

    Parameters
    ----------
    system : LinearSystem
        At rest, planar.
    drive : ToneBurst
    damping : float
        gamma in 1/ms.
    row : ndarray of int
    clock : tuple of (float, int, int)
        Time step in ms, number of steps between two frames, and number of steps.
    """
    dt, interval, steps = clock
    rows, shapes = system.rows(row)
    force, linear, second = _Beyond(system), _Verlet(system, damping, dt), _Verlet(system, damping, dt)
    pushes = Drives([drive], len(system))
    driven = system.shapes[(pushes.particles[:, None] * system.dim + np.arange(system.dim)).ravel()].T
    frames = np.arange(interval, steps + 1, interval)
    size = np.zeros(2)
    for first in range(0, steps, TIMES):
        beginnings = np.arange(first, min(first + TIMES, steps))
        times = (dt * beginnings).astype(float)
        external = driven @ pushes.forces(times)[..., : system.dim].reshape(len(times), -1).T
        before = linear.y
        one = linear.moved(external.T)
        two = second.moved(force(np.vstack([before, one[:-1]])))
        seen = np.isin(beginnings + 1, frames)
        size += [np.sum((y[seen][:, rows] @ shapes.T) ** 2) for y in (one, two)]
    return float(np.sqrt(size[1] / size[0]))


class _Verlet:
    """Damped velocity Verlet steps of y'' + gamma y' + K y = g from rest, as those of `magphonon.dynamics.kernels_numpy`."""

    def __init__(self, system, damping, dt):
        self.K, self.dt, self.decay = system.K, dt, np.exp(-damping * dt)
        self.y = np.zeros(self.K.shape[0])
        self._v = np.zeros_like(self.y)  # half a step behind

    def moved(self, g):
        """The motion y after each of several steps, shape (steps, free), under the forces at their beginnings."""
        found, kick = np.empty_like(g), (1 + self.decay) * self.dt / 2
        for step, force in enumerate(g):
            self._v *= self.decay
            self._v += kick * (force - self.K @ self.y)
            self.y = self.y + self.dt * self._v
            found[step] = self.y
        return found


class _Beyond:
    """The force of the law beyond its linear part, from y to g, both of the shape (times, free)."""

    def __init__(self, system):
        calc, dim = system.calc, system.dim
        self.R = calc.bond_vectors.T[..., None]
        self.slopes = [2 * psi[:, None] for psi in law_derivatives(calc.law, calc.bonds.lengths)]
        self.stretch = sparse.vstack([calc.bonds.incidence @ system.shapes[x::dim] for x in range(dim)], format='csr')
        self.gather = sparse.csr_array(self.stretch.T)

    def __call__(self, y):
        psi2, psi3, psi4 = self.slopes
        d = (self.stretch @ y.T).reshape(len(self.R), -1, len(y))
        beyond = np.einsum('xbt,xbt->bt', d, d)
        delta = beyond + sum(2 * R * x for R, x in zip(self.R, d, strict=True))
        third = delta * delta * (psi3 / 2 + psi4 / 6 * delta)
        d *= psi2 * delta + third
        d += self.R * (psi2 * beyond + third)
        return -(self.gather @ d.reshape(-1, len(y))).T


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
SLIGHT, NEXT_ORDER = 0.03, 20
"""Largest effect of nonlinearity for which perturbation theory is used, and its relative uncertainty as a multiple of the effect:
of 69 bursts with carriers above the cut-off, an effect told as 3 % was wrong by 44 % of it or less, and of 24 one told as 1 % by
17 % or less.  Below the cut-off, 40 effects of 3 % were wrong by 7 % or less."""
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
    clock = dt, interval, int(duration / dt)
    times = dt * np.arange(interval, clock[2] + 1, interval)
    linear = {'complete': propagate(as_model(atoms, 'complete'), times, [drive], damping)}
    linear['conventional'] = propagate(as_model(atoms, 'conventional'), times, [drive], damping, row)
    exact = linear['complete'].displacements
    frozen = difference(linear['conventional'].displacements, exact[:, row])
    strain = _strain(calc, exact)
    bound = BOUND_FACTOR * max(1.0, np.sqrt(len(row) / BUILD_UP_STEPS)) * steepness(calc) / 2 * strain
    effect = _Effect(bound, linear_step_error(system, linear['complete'], drive, damping, row, dt), 2 * LONGEST_STEP / top)
    evidence = [f'D* changes the waveform by {percent(frozen)}'
                + (f', and by up to {percent(sides)} at the sides of the beam' if sides else ''),
                f'bonds stretch and rotate by at most {percent(strain)}, so nonlinearity changes the waveform by less than '
                f'{percent(bound)}']
    if bound * (1 + doubt) > tolerance:
        correction = partial(relative_correction, system, drive, damping, row)
        effect, evidence[1:] = _perturbed(effect, system, correction, clock, tolerance, doubt)
        if effect.nonlinear > SLIGHT:
            trials = [_Trial(atoms, drive, row, damping, clock, share) for share in (1, WEAK_AMPLITUDE)]
            effect, evidence[1:] = _tried(trials, exact[:, row], len(atoms), effect.cost, tolerance, doubt)

    own, methods, force = effect.nonlinear_doubt, [], len(calc.bonds) * force_cost(calc.dim)
    for model, error in (('conventional', frozen + sides + effect.nonlinear), ('complete', effect.nonlinear)):
        products, entries = linear[model].products, LinearSystem.of(as_model(atoms, model)).K.nnz
        methods.append(Method(f'{model} linear', f'exact propagation in {products} products with the stiffness matrix',
                              stand_in.copies * products * entries, error, doubt + own, Settings(model)))
    known = effect.stepping < np.inf
    dt_run = (min(dt * np.sqrt(STEP_ERROR_FRACTION * tolerance / effect.stepping), effect.longest) if known else
              effect.longest / 2)
    count = int(np.ceil(duration / dt_run))
    methods.append(Method('nonlinear', f'velocity Verlet in {count} steps', stand_in.copies * count * force,
                          float(effect.stepping * (dt_run / dt) ** 2), doubt + effect.step_doubt,
                          Settings('complete', dt=float(dt_run))))
    cost = effect.cost + sum(answer.products for answer in linear.values()) * system.K.nnz
    return Plan('Waveform', 'its rms', tolerance, tuple(methods), tuple(evidence), cost)


@dataclass(frozen=True)
class _Effect:
    """What nonlinearity and time steps change, relative to the waveform.

    Attributes
    ----------
    nonlinear : float
    stepping : float
        By the time step of the trial runs; infinite where it is not known.
    longest : float
        Longest step in ms of a run that is known to converge.
    nonlinear_doubt, step_doubt : float
        Relative uncertainties of both; a bound has none.
    cost : float
        Multiplications that it took to know them.
    """

    nonlinear: float
    stepping: float
    longest: float
    nonlinear_doubt: float = 0.0
    step_doubt: float = 0.0
    cost: float = 0.0


def _refined(nonlinearity, tolerance, doubt):
    """Nonlinearity from shorter and shorter steps until it is clear of the tolerance, its doubt by the step, and into how many
    parts the first step was divided.
    """
    for halvings in range(HALVINGS + 1):
        fine, own_doubt = 2**halvings, DOUBT / 4**halvings
        found = nonlinearity(fine)
        if doubt or found > SLIGHT or abs(found / tolerance - 1) > 2 * own_doubt:
            break
    return found, own_doubt, fine


def _perturbed(bounds, system, correction, clock, tolerance, doubt):
    """The effect of nonlinearity by perturbation theory, with the bound of the time-step error, and the evidence."""
    (dt, interval, steps), calc = clock, system.calc
    found, own_doubt, fine = _refined(lambda fine: correction((dt / fine, interval * fine, steps * fine)), tolerance, doubt)
    cost = (2 * fine - 1) * steps * (2 * system.K.nnz + len(calc.bonds) * force_cost(calc.dim))
    said = f'nonlinearity: {percent(found)} (by perturbation theory, for {len(system)} particles and {steps * fine} steps)'
    return replace(bounds, nonlinear=found, nonlinear_doubt=own_doubt + NEXT_ORDER * found, cost=cost), [said]


def _tried(trials, exact, particles, cost, tolerance, doubt):
    """The effects of nonlinearity and of time steps from trial runs of the full and of a weak burst, and the evidence."""
    full, weak = trials
    found, own_doubt, fine = _refined(lambda fine: difference(full(fine), weak(fine)), tolerance, doubt)
    said = [f'nonlinearity: {percent(found)} (from a trial run of {particles} particles and {full.length * fine} '
            f'steps; its own time-step error is {percent(difference(weak(fine), exact))} at small amplitude)']
    stepping = full.step_error(fine)
    if stepping == np.inf:
        said.append('time steps do not converge at this amplitude, so their error is unknown: run the nonlinear model with '
                    'shorter and shorter steps, and compare')
    return _Effect(found, stepping, full.longest, own_doubt, STEP_DOUBT, cost + (full.steps + weak.steps) * full.force), said


def steepness(calc: Repulsion) -> float:
    """Largest exponent -d log phi''/d log r with which the stiffness of a bond falls: a + 1 for a force r^-a."""
    near, far = (calc.law.d2phi(factor * calc.bonds.lengths) for factor in (1 - 1e-4, 1 + 1e-4))
    return float(abs(np.log(near / far)).max() / 2e-4)


def _strain(calc, u):
    """Largest relative displacement of the ends of a bond over its length; `u` has the shape (times, particles, dim)."""
    bonds, largest = calc.bonds, 0.0
    for some in np.array_split(u, max(1, len(u) // TIMES)):
        apart = (bonds.incidence @ some.transpose(1, 2, 0).reshape(u.shape[1], -1)).reshape(len(bonds), u.shape[2], -1)
        largest = max(largest, ((apart**2).sum(axis=1).max(axis=1, initial=0.0) / bonds.lengths**2).max())
    return float(np.sqrt(largest))


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
    pushes, dim = Drives([drive], len(system)), system.dim
    rows, shapes = system.rows(row)
    driven = system.shapes[(pushes.particles[:, None] * dim + np.arange(dim)).ravel()][:, rows].T
    inverse, K = system.free.T @ sparse.diags_array(np.sqrt(np.repeat(system.masses, dim))), system.K[rows]

    def force(times):
        return driven @ pushes.forces(times)[..., :dim].reshape(len(times), -1).T

    def reduced(u):
        return inverse @ u.reshape(len(u), -1).T

    every = reduced(motion.velocities)
    v = every[rows]
    a = force(motion.times) - K @ reduced(motion.displacements) - damping * v
    j = (force(motion.times + h) - force(motion.times - h)) / (2 * h) - K @ every - damping * a

    def size(y):
        return np.linalg.norm(shapes @ y)

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
    length : int
        Number of steps of the run with fine = 1.
    force : float
        Multiplications of one step.
    steps : float
        Number of steps made in all runs.
    longest : float
        Longest step in ms of a run that is known to converge.
    """

    def __init__(self, atoms, drive, row, damping, clock, share):
        self._atoms, self._row, self._damping, self._share = atoms, row, damping, share
        self._drive = replace(drive, amplitude=share * np.asarray(drive.amplitude))
        self._dt, self._interval, self.length = clock
        self.force = len(atoms.calc.bonds) * force_cost(atoms.calc.dim)
        self._runs, self.steps, self.longest = {}, 0.0, self._dt

    def __call__(self, fine):
        """With the step dt/fine, where 1/2 is the smallest fine."""
        if fine not in self._runs:
            steps = int(self.length * fine)
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
