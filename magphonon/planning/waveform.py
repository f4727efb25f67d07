"""The plan for waveforms: does the passage of a burst need D*, and does it need time steps with the nonlinear law?

The effect of D* is the difference of the exact linear solutions with and without it.  The effect of nonlinearity is bounded by
the largest strain s of a bond: the first nonlinear term is (a + 1) s/2 of the linear one, for a force that falls as r^-a.  Where
this bound does not decide, trial runs with long time steps are made, each with two steps: of the full burst, and of a weak burst
with 1e-6 of the amplitude, which is linear.  Their difference is the effect of nonlinearity, without the time-step error; what
half the step changes of it says how well it is known.

The time-step error is proportional to the square of the step: it is what changes of the full burst when the step is doubled,
because the amplitude shifts the frequencies.  That of steps of order four or six is smaller by at least as much as for the
fastest wave, of which it is known in closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..dynamics.cages import Diverged
from ..dynamics.drives import ToneBurst
from ..dynamics.engine import highest_frequency
from ..dynamics.recorder import Recorder
from ..dynamics.splittings import SPLITTINGS
from ..dynamics.verlet import DrivenVerlet
from ..response.propagation import propagate
from ..stiffness.bond import Model
from ..stiffness.repulsion import Repulsion, repulsion_of
from ..stiffness.rest import LinearSystem
from ..traits import STIFF, takes
from .plan import LONGEST_STEP, STEP_ERROR_FRACTION, Method, Plan, percent

FRAMES = 12  # number of times compared and written in each period of the carrier: harmonics up to the fifth are resolved
TIMES = 8  # number of frames whose strains are computed at once, so that the arrays stay in the processor's cache
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
STEP_DOUBT = 0.5
"""Relative uncertainty of the time-step error of a full burst from runs with two steps, as its higher orders are unknown."""
MOST_SQUEEZED = 0.5  # of a bond, in the motion that the linear equations tell
HALVINGS = 3
"""Largest number of times that the trial is repeated with half the step, if its result is too close to the tolerance or its
error is no square of the step: the last run takes eight times as long as the first."""


@takes(*STIFF)
def plan_waveform(atoms: Atoms, drive: ToneBurst, row: NDArray[np.int_], damping: float, duration: float,
                  tolerance: float) -> Plan:
    """Plan for the displacements of a row while a burst passes.

    Parameters
    ----------
    atoms : ase.Atoms
        With PairCalculator.
    drive : ToneBurst
    row : ndarray of int
        Particles measured.
    damping : float
        gamma in 1/ms.
    duration : float
        In ms.
    tolerance : float
        Allowed rms error of the displacements over the row and the record, relative to their rms.

    Returns
    -------
    Plan
    """
    system = LinearSystem.of(atoms)
    calc, dt = system.calc, LONGEST_STEP / highest_frequency(system)  # half the longest, because the step is doubled
    interval = 2 * max(1, int(np.pi / drive.omega / FRAMES / dt))  # even, so that runs with twice the step have the same frames
    steps = int(duration / dt)
    times = dt * np.arange(interval, steps + 1, interval)
    linear = {'complete': propagate(as_model(atoms, 'complete'), times, [drive], damping)}
    linear['conventional'] = propagate(as_model(atoms, 'conventional'), times, [drive], damping, row)
    exact = linear['complete'].displacements
    frozen, strain = difference(linear['conventional'].displacements, exact[:, row]), _strain(calc, exact)
    bound = BOUND_FACTOR * max(1.0, np.sqrt(len(row) / BUILD_UP_STEPS)) * steepness(calc) / 2 * strain
    if tried := bound > tolerance:
        effect = _tried(atoms, drive, row, damping, (dt, interval, steps), tolerance)
    else:
        effect = _Effect(bound, 0.0, np.inf, 2 * dt, (f'bonds stretch and rotate by at most {percent(strain)}, so nonlinearity '
                                                      f'changes the waveform by less than {percent(bound)}',))
    errors: dict[Model, float] = {'conventional': frozen + effect.nonlinear, 'complete': effect.nonlinear}
    methods = [Method(f'{model} linear', f'exact propagation in {linear[model].products} products with the stiffness matrix',
                      error, effect.doubt, model)
               for model, error in errors.items()]
    if tried:
        squeezed = (1 - min(strain, MOST_SQUEEZED)) ** (-steepness(calc) / 2)  # bonds that are shortened are stiffer
        frame = 2 * np.pi / drive.omega / FRAMES
        methods += _steps(effect, dt, squeezed * LONGEST_STEP / dt, frame, duration, tolerance)
    return Plan('Waveform', 'its rms', tolerance, tuple(methods), (f'D* changes the waveform by {percent(frozen)}', *effect.said))


def _steps(effect, dt, top, frame, duration, tolerance):
    """The nonlinear methods: Verlet, and before it the order that takes the fewest evaluations of the forces, if fewer."""
    known = effect.stepping < np.inf
    h = min(dt * np.sqrt(STEP_ERROR_FRACTION * tolerance / effect.stepping), effect.longest) if known else effect.longest / 2
    count = int(np.ceil(duration / h))
    verlet = Method('nonlinear', f'velocity Verlet in {count} steps', float(effect.stepping * (h / dt) ** 2), STEP_DOUBT,
                    dt=float(h))
    if not known:
        return [verlet]
    longest = {p: _longest_step(p, effect, dt, top, frame, tolerance) for p in (4, 6)}
    order = min(longest, key=lambda p: SPLITTINGS[p].stages / longest[p])
    h, stages = float(longest[order]), SPLITTINGS[order].stages
    steps = int(np.ceil(duration / h))
    higher = Method(f'nonlinear, order {order}', f'{steps} steps of order {order}, each of {stages} evaluations of the forces',
                    float(_error_of(order, h, effect, dt, top)), STEP_DOUBT, dt=h, order=order)
    return [higher, verlet] if steps * stages < count else [verlet]


def _error_of(order, h, effect, dt, top):
    """Error of steps h of an order: that of Verlet's, less by at least as much as for the fastest wave."""
    return effect.stepping * (h / dt) ** 2 * SPLITTINGS[order].beside_verlet(top * h)


def _longest_step(order, effect, dt, top, frame, tolerance):
    """The longest step h of an order that keeps its share of the tolerance, has frames between steps, and converges."""
    h = min(frame, effect.longest / 2 * SPLITTINGS[order].limit) * np.geomspace(1e-3, 1, 400)
    with np.errstate(invalid='ignore'):  # no number where a squeezed bond is beyond the limit of stability
        good = _error_of(order, h, effect, dt, top) <= STEP_ERROR_FRACTION * tolerance
    return h[good.nonzero()[0][-1]] if good.any() else h[0]


@dataclass(frozen=True)
class _Effect:
    """What nonlinearity and time steps change, relative to the waveform, and how uncertain that is."""

    nonlinear: float
    doubt: float  # a bound has none
    stepping: float  # the error of the first time step of the trial, infinite where it is not known
    longest: float  # step in ms of a run that is known to converge
    said: tuple[str, ...]  # the evidence


def _tried(atoms, drive, row, damping, clock, tolerance):
    """The effects of nonlinearity and of time steps from trial runs of the full and of a weak burst, each with two steps.

    The step is halved until the change of the motion is small, and the nonlinearity is clear of the tolerance.
    """
    dt, interval, steps = clock

    def run(share, fine):
        burst = replace(drive, amplitude=share * np.asarray(drive.amplitude))
        dyn = DrivenVerlet(as_model(atoms, 'complete'), dt / fine, [burst], damping)
        record = Recorder(dyn, row, int(interval * fine))
        dyn.run(int(steps * fine))
        return record.displacements[1:] / share

    def both(fine):
        return run(1.0, fine), run(WEAK_AMPLITUDE, fine)

    try:
        before = both(0.5)
    except Diverged:  # of a long step
        before = None
    for fine in 2.0 ** np.arange(HALVINGS + 1):
        try:
            full, weak = both(fine)
        except Diverged as error:
            raise ValueError(f'particles collide or leave their cages, so there is nothing to plan: {error}') from None
        found, change, doubt = difference(full, weak), np.inf, 1.0
        if before is not None:
            # an error of the second order is a third of the change when the step is doubled; half of it allows for the next order
            change, doubt = difference(before[0], full), abs(difference(*before) / found - 1) / 2
        before = full, weak
        if change <= LARGEST_CHANGE and abs(found / tolerance - 1) > doubt:
            break
    said = [f'nonlinearity: {percent(found)} (from trial runs of {len(atoms)} particles, of up to {int(steps * fine)} steps)']
    converged = change <= LARGEST_CHANGE
    if not converged:
        said.append('time steps do not converge at this amplitude, so their error is unknown: run the nonlinear model with '
                    'shorter and shorter steps, and compare')
    return _Effect(found, doubt, change / 3 * fine**2 if converged else np.inf, 2 * dt / fine, tuple(said))


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


def as_model(atoms: Atoms, model: Model) -> Atoms:
    """The same structure under another model."""
    other, calc = atoms.copy(), repulsion_of(atoms)
    other.calc = calc.about(calc.reference, model=model)
    return other


def difference(u: NDArray[np.float64], exact: NDArray[np.float64]) -> float:
    """Root mean square of the difference, divided by the root mean square of the exact displacements."""
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))
