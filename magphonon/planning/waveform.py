"""The plan for waveforms: does the passage of a burst need D*, and does it need time steps with the nonlinear law?

The exact linear answers tell what D* does, and the largest strain s of a bond bounds what the linear law leaves out:
its next term is (a + 1) s/2 of it, for a force that falls as r^-a.  Only where this bound does not decide, a pilot runs with
long time steps: the burst in full and as a whisper, 1e-6 of it, which is linear.  Their difference is what nonlinearity
does, freed of what the steps do, which is the difference of the whisper from the exact linear answer and falls with the
square of the step.

Where a whole row of particles is driven all this happens in a strip one cell wide.
"""

from dataclasses import replace

import numpy as np
from ase.constraints import FixAtoms

from ..dynamics.cages import Diverged
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
from .plan import Method, Plan, Settings, force_cost, percent

PILOT_STEP = 0.25
"""Time step of the pilot as a share of the limit 2/omega_max."""
LINEAR = 1e-7
"""Tolerance of the exact linear answers."""
LONGEST_STEP = 0.5
"""The same for runs; beyond it the error grows faster than its square."""
WHISPER = 1e-6
"""Of the burst: linear to six digits, and far above round-off."""
CAUTION, ALONG = 5, 30
"""Factor of the bound, and the steps of a row after which it grows as their root: harmonics build up on the way.  The most
that was seen, without foundation, is a factor of 3 along 20 steps and 3.9 along 60."""
LOUD = 0.5
"""Nonlinearity beyond which the error of time steps is not that of a whisper."""
SHARE = 0.6
"""Of the tolerance that time steps may use up."""
FRAMES = 12
"""Moments compared in each period of the carrier."""
IN_A_PATCH = 0.1
"""Doubt about what a strip says of D* and of time steps in a patch."""
OVERSTATED = 2.5
"""At most, the nonlinearity of a patch by a strip: the beam is weaker beside its middle, 2.4 was seen.  There is no such
factor the other way: without foundation the sides of a shear beam add up to nine times what a strip shows."""
SIDES = 0.1
"""What D* may do at the sides of a beam, where bonds turn even if none does in a strip; 4 % was seen."""
DOUBT = 0.12
"""Relative uncertainty of the pilot for its own structure: what long steps do to a nonlinear difference, 10 % at most in the
bursts tried; a quarter with half the step."""
HALVINGS = 3
"""Most repetitions of the pilot with half the step, where tolerance and estimate are too close to call."""


def strip(cell, rows):
    """A strip one cell wide and periodic along R1, `rows` cells along R2; the first and the last are held.

    What moves alike along R1, as a wave from a whole row of sources, moves here as in the lattice.

    Parameters
    ----------
    cell : ase.Atoms
        Planar, with its MagneticRepulsion.
    rows : int

    Returns
    -------
    ase.Atoms
        With its MagneticRepulsion.
    """
    calc = repulsion_of(cell)
    atoms = cell.repeat((1, rows, 1))
    periodic = calc.on(atoms)
    bonds = periodic.bonds
    inside = bonds.shift[:, 1] == 0  # the others lead from the last row to the first
    bonds = Bonds(bonds.i[inside], bonds.j[inside], bonds.shift[inside], bonds.vectors[inside], len(atoms))
    atoms.pbc = True, False, False
    row = np.repeat(np.arange(rows), len(cell))
    atoms.set_tags(np.where((row == 0) | (row == rows - 1), RIM, 0))
    atoms.set_constraint(FixAtoms(mask=atoms.get_tags() == RIM))
    atoms.calc = MagneticRepulsion(atoms, calc.potential, bonds=bonds, anchors=periodic.anchors, load=periodic.load,
                                   **calc.parameters)
    return atoms


def plan_beam(cell, patch, where, drive, damping, duration, tolerance):
    """Plan for a burst from a whole row of a patch, by way of a strip of it; of all of it, where the strip cannot tell.

    Parameters
    ----------
    cell, patch : ase.Atoms
        With their MagneticRepulsion.
    where : Site
        Of a source that is a row, see `magphonon.waves.wave_source`.
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
    beam = replace(drive, particles=lowest, amplitude=abs(drive.amplitude).max())
    plan = plan_waveform(pilot, beam, inside[:: len(cell)], damping, duration, tolerance, copies, IN_A_PATCH, SIDES)
    linear = plan.methods[1]
    by_bound = linear.doubt == IN_A_PATCH  # without a pilot
    if by_bound or linear.error > OVERSTATED * tolerance:
        return plan
    closer = plan_waveform(patch, drive, where.row, damping, duration, tolerance)
    return replace(closer, cost=plan.cost + closer.cost)


def plan_waveform(atoms, drive, row, damping, duration, tolerance, copies=1.0, doubt=0.0, sides=0.0):
    """Plan for the displacements that a burst leaves along a row.

    Parameters
    ----------
    atoms : ase.Atoms
        The pilot: what is to be run, or a `strip` of it; with MagneticRepulsion.
    drive : ToneBurst
    row : ndarray of int
        Particles measured.
    damping : float
        gamma in 1/ms.
    duration : float
        In ms.
    tolerance : float
        Of the displacements, rms over the row and the record, relative to their rms.
    copies : float
        How many times larger than the pilot the scene is.
    doubt : float
        Of what the pilot says about the scene, where they differ.
    sides : float
        What D* may do to the waveform in the scene besides.

    Returns
    -------
    Plan
        The settings of its methods are `model` and, where time is stepped, `dt` in ms.

    Raises
    ------
    ValueError
        If the burst throws particles into each other.
    """
    system = LinearSystem.of(atoms)
    calc, top = system.calc, highest_frequency(system)
    dt = PILOT_STEP * 2 / top
    interval = max(1, int(2 * np.pi / drive.omega / FRAMES / dt))
    steps = int(duration / dt)
    times = dt * np.arange(interval, steps + 1, interval)
    linear = {model: propagate(as_model(atoms, model), times, [drive], damping, tolerance=LINEAR) for model in MODELS}
    exact = linear['complete'].displacements
    frozen = difference(linear['conventional'].displacements[:, row], exact[:, row])
    strain = _strain(calc, exact)
    nonlinear = CAUTION * max(1.0, np.sqrt(len(row) / ALONG)) * steepness(calc) / 2 * strain
    stepping = drive.omega**3 * dt**2 * duration / 24  # the frequency w of a wave is wrong by w (w dt)^2/24
    force = len(calc.bonds) * force_cost(calc.dim)
    evidence = [f'D* changes it by {percent(frozen)}'
                + (f', and by up to {percent(sides)} at the sides of the beam' if sides else ''),
                f'bonds stretch and turn by {percent(strain)} at most, so nonlinearity changes it by less than '
                f'{percent(nonlinear)}']
    cost = sum(answer.products for answer in linear.values()) * system.K.nnz
    own_doubt = 0.0  # of a bound
    if nonlinear * (1 + doubt) > tolerance:
        for halvings in range(HALVINGS + 1):
            fine, own_doubt = 2**halvings, DOUBT / 4**halvings
            loud, soft = (_stepped(atoms, replace(drive, amplitude=share * drive.amplitude), row, damping, dt / fine,
                                   interval * fine, steps * fine) / share for share in (1, WHISPER))
            nonlinear, stepping = difference(loud, soft), difference(soft, exact[:, row]) * fine**2
            cost += 2 * steps * fine * force
            if doubt or abs(nonlinear / tolerance - 1) > 2 * own_doubt:
                break
        evidence[1] = (f'nonlinearity changes it by {percent(nonlinear)}, as a pilot of {len(atoms)} particles and '
                       f'{steps * fine} steps shows, whose long steps alone change it by {percent(stepping / fine**2)}')
        if nonlinear > LOUD:
            evidence.append('at such a strength nothing tells how long the time step may be: halve it, and compare')
    doubt += own_doubt

    methods = []
    for model, error in (('conventional', frozen + sides + nonlinear), ('complete', nonlinear)):
        products, entries = linear[model].products, LinearSystem.of(as_model(atoms, model)).K.nnz
        methods.append(Method(f'{model} linear', f'exact propagation in {products} products with the stiffness',
                              copies * products * entries, error, doubt, Settings(model)))
    dt_run = min(dt * np.sqrt(SHARE * tolerance / stepping), LONGEST_STEP * 2 / top)
    count = int(np.ceil(duration / dt_run))
    methods.append(Method('nonlinear', f'velocity Verlet in {count} steps', copies * count * force,
                          float(stepping * (dt_run / dt) ** 2), doubt, Settings('complete', dt=float(dt_run))))
    return Plan('Waveform', 'its rms', tolerance, tuple(methods), tuple(evidence), cost)


def steepness(calc):
    """How fast the stiffness of a nearest neighbour falls, -d log phi''/d log r: a + 1 for a force r^-a."""
    r = calc.bonds.lengths.min()
    near, far = calc.potential.d2phi(np.array([1 - 1e-4, 1 + 1e-4]) * r)
    return float(np.log(near / far) / 2e-4)


def _strain(calc, u):
    """Largest stretch or turn of a bond, relative to its length; `u` of shape (times, particles, dim)."""
    bonds = calc.bonds
    return float((np.linalg.norm(u[:, bonds.j] - u[:, bonds.i], axis=2) / bonds.lengths).max())


def as_model(atoms, model):
    """The same structure under another model."""
    other, calc = atoms.copy(), repulsion_of(atoms)
    other.calc = calc.about(calc.reference, model=model)
    return other


def _stepped(atoms, drive, row, damping, dt, interval, steps):
    """Displacements of a row, every `interval` steps from rest."""
    dyn = DrivenVerlet(as_model(atoms, 'complete'), dt, [drive], damping, engine='numpy')
    record = Recorder(dyn, row, interval)
    try:
        dyn.run(steps)
    except Diverged as error:
        raise ValueError(f'this burst throws particles into each other or away, so there is nothing to plan: {error}') from None
    return record.displacements[1:]


def difference(u, exact):
    """Root mean square of the difference over that of the exact displacements."""
    return float(np.linalg.norm(u - exact) / np.linalg.norm(exact))
