"""The plan for waveforms: does the passage of a burst need D*, and does it need time steps with the nonlinear law?

The effect of D* is the difference of the exact linear solutions with and without it.  The effect of nonlinearity is bounded by
the largest strain s of a bond: the first nonlinear term is (a + 1) s/2 of the linear one, for a force that falls as r^-a.  Where
this bound does not decide, the burst is run in time steps: the difference from the exact linear solution is the effect of
nonlinearity plus the error of the steps.  `magphonon.dynamics.splittings` chooses their length and order for the tolerance.
"""

from __future__ import annotations

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..dynamics.cages import Diverged
from ..dynamics.drives import ToneBurst
from ..dynamics.engine import highest_frequency
from ..dynamics.recorder import Recorder
from ..dynamics.splittings import SPLITTINGS, STEPS_SHARE, step_within
from ..dynamics.verlet import DrivenVerlet
from ..response.propagation import propagate
from ..stiffness.bond import MODELS, Model
from ..stiffness.repulsion import Repulsion, repulsion_of
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .plan import Method, Plan, percent

FRAMES = 12  # number of times compared and written in each period of the carrier: harmonics up to the fifth are resolved
TIMES = 8  # number of frames whose strains are computed at once, so that the arrays stay in the processor's cache
BOUND_FACTOR, BUILD_UP_STEPS = 5, 30
"""Safety factor of the bound of nonlinearity, and the number of steps along a row beyond which the factor grows with the square
root of their number, because harmonics build up on the way.  The largest ratios measured, without foundation, are 3 along 20
steps and 5.1 along 60."""
MOST_SQUEEZED = 0.5  # of a bond, in the motion that the linear equations tell


@takes(*LIKE)
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
    calc, frame = system.calc, 2 * np.pi / drive.omega / FRAMES
    times = frame * np.arange(1, int(duration / frame) + 1)
    linear = {'complete': propagate(as_model(atoms, 'complete'), times, [drive], damping)}
    linear['conventional'] = propagate(as_model(atoms, 'conventional'), times, [drive], damping, row)
    exact = linear['complete'].displacements
    frozen, strain = difference(linear['conventional'].displacements, exact[:, row]), _strain(calc, exact)
    nonlinear = BOUND_FACTOR * max(1.0, np.sqrt(len(row) / BUILD_UP_STEPS)) * steepness(calc) / 2 * strain
    doubt, steps = 0.0, []
    said = (f'bonds stretch and rotate by at most {percent(strain)}, so nonlinearity changes the waveform by less than '
            f'{percent(nonlinear)}')
    if nonlinear > tolerance:
        squeezed = (1 - min(strain, MOST_SQUEEZED)) ** (-steepness(calc) / 2)  # bonds that are shortened are stiffer
        dt, order = step_within(tolerance, squeezed * highest_frequency(system), duration, frame)
        nonlinear = difference(_run(atoms, drive, row, damping, times, dt, order), exact[:, row])
        doubt = STEPS_SHARE * tolerance / nonlinear
        count, stages = round(frame / dt) * len(times), SPLITTINGS[order].stages
        said = f'nonlinearity: {percent(nonlinear)} (from a run of {len(atoms)} particles in {count} steps of order {order})'
        algorithm = f'{count} steps of order {order}, each of {stages} evaluation{"s" * (stages > 1)} of the forces'
        steps = [Method('nonlinear', algorithm, STEPS_SHARE * tolerance, 1.0, dt=dt, order=order)]
    methods = [Method(f'{model} linear', f'exact propagation in {linear[model].products} products with the stiffness matrix',
                      error, doubt * nonlinear / error if error else 0.0, model)
               for model, error in zip(reversed(MODELS), (frozen + nonlinear, nonlinear), strict=True)]
    return Plan('Waveform', 'its rms', tolerance, (*methods, *steps), (f'D* changes the waveform by {percent(frozen)}', said))


def _run(atoms, drive, row, damping, times, dt, order):
    """Displacements of the row at the `times`, from time steps with the nonlinear law."""
    dyn = DrivenVerlet(as_model(atoms, 'complete'), dt, [drive], damping, order=order)
    record = Recorder(dyn, row, round(times[0] / dt))
    try:
        dyn.run(round(times[-1] / dt))
    except Diverged as error:
        raise ValueError(f'particles collide or leave their sites, so there is nothing to plan: {error}') from None
    return record.displacements[1:]


def steepness(calc: Repulsion) -> float:
    """Largest exponent -d log phi''/d log r with which the stiffness of a bond falls: a + 1 for a force r^-a."""
    near, far = (calc.law.d2phi(factor * calc.bonds.lengths) for factor in (1 - 1e-4, 1 + 1e-4))
    return float(abs(np.log(near / far)).max() / 2e-4)


def _strain(calc, u):
    """Largest relative displacement of the ends of a bond, divided by its length; `u` has the shape (times, particles, dim)."""
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
