"""A tone burst in a patch at rest: where it enters, the row along which it is measured, and the run itself.

It enters at the lowest row inside the held rim, along all of that row or at its middle, and is measured along the
lattice vector R2.  A row of sources makes plane waves, whose fronts run along R1.  Waves from a point spread; if the
measured row is a direction of symmetry, the waves seen there run along it.
"""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..dynamics.drives import ToneBurst
from ..dynamics.engine import fastest, highest_frequency
from ..dynamics.lammps import run_lammps
from ..dynamics.motion import Motion
from ..dynamics.recorder import Recorder
from ..dynamics.splittings import SPLITTINGS, StepsTooLong
from ..dynamics.verlet import DrivenVerlet
from ..errors import not_negative, one_of, positive
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import freedom
from .ridge_tables import DRIVEN

if TYPE_CHECKING:
    from collections.abc import Sequence

NEAR = 0.1
"""Distance, in lattice constants, up to which a particle belongs to a site, also in a patch that a burst has left in motion."""
STRAIGHT = 1e-6  # largest component of R1 along y, as a fraction of R1
STEP_FRACTION = 0.1
"""Time step as a fraction of the limit 2/omega_max: frequencies near omega_max are wrong by 0.2 %, lower ones by less."""
SAMPLES = 12
"""Number of recorded frames per period of the carrier.  The spectrum of a five-cycle burst ends at 1.4 times its carrier, and
these resolve harmonics up to the fifth; in a film with fewer frames, crests seem to run backwards."""
SNAPSHOTS = 24  # number of times at which the whole patch is recorded
ROUND_OFF = 1e-9  # displacement, as a fraction of the shortest bond, below which a particle is at rest
ROUND_OFF_PER_RADIAN = 1e-13  # error by round-off in a radian of the fastest wave


def wavevector(cell: Atoms, source: str) -> NDArray[np.float64]:
    """Wavevector of xi = 2 pi along R2, in fractions of the reciprocal vectors, for `branch` and `complex_bands`.

    Parameters
    ----------
    cell : ase.Atoms
    source : {'row', 'point', 'bench'}
        'row' for fronts along R1, 'point' for fronts across R2; a shaken bench sends waves from the lowest row, like 'row'.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.waves import wavevector
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> wavevector(cell, 'row').tolist(), wavevector(cell, 'point').tolist()
    ([0.0, 1.0, 0.0], [0.5000000000000001, 1.0, 0.0])
    """
    R1, R2 = cell.cell.array[:2]
    return np.array([R1 @ R2 / (R2 @ R2) if one_of('source', source, DRIVEN) == 'point' else 0.0, 1.0, 0.0])


def polarisations(cell: Atoms, source: str) -> dict[str, NDArray[np.float64]]:
    """Unit vectors across and along the wavevector: a dict of 'transverse' and 'longitudinal', each of shape (2,).

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.waves import polarisations
    >>> list(polarisations(read_scene(ready_scene('prototype')).atoms(), 'row'))
    ['transverse', 'longitudinal']
    """
    return across_and_along(cell, wavevector(cell, source))


def across_and_along(cell: Atoms, q: NDArray[np.float64]) -> dict[str, NDArray[np.float64]]:
    """Unit vectors across and along the wavevector q, given in fractions of the reciprocal vectors."""
    k = (q @ cell.cell.reciprocal().array)[:2]
    along = k / np.linalg.norm(k)
    return {'transverse': np.array([along[1], -along[0]]), 'longitudinal': along}


@dataclass(frozen=True)
class BurstSetup:
    """The particles at which a burst enters a patch, and the row along which it is measured.

    Attributes
    ----------
    driven : ndarray of int, shape (driven,)
    weights : ndarray, shape (driven,)
        Share of the force on each driven particle, at most one.
    row : ndarray of int, shape (points,)
        Particles measured, in equal steps of R2 away from the source.
    """

    driven: np.ndarray
    weights: np.ndarray
    row: np.ndarray

    def burst(self, direction: ArrayLike, force: ArrayLike, omega: float, cycles: float = 5) -> ToneBurst:
        """A ToneBurst on the driven particles; `direction` in the plane, `force` in N, `omega` in rad/ms."""
        return ToneBurst(self.driven, direction, force * self.weights, omega, cycles)


def burst_setup(cell: Atoms, patch: Atoms, source: str) -> BurstSetup:
    """Choose the particles at which a burst drives a patch, and the row along which it is measured.

    The ends of a row of sources send waves of their own, which would move the ridge by more than a wavenumber bin. Therefore
    the force falls off as cos^2 towards the ends, and the measured row crosses the middle of the beam half way up.

    Parameters
    ----------
    cell : ase.Atoms
    patch : ase.Atoms
        Patch cut from that cell (see `magphonon.lattices`).
    source : {'row', 'point', 'bench'}
        With 'bench' the whole patch is shaken, with walls and feet of pillars: seen from the bench, a force acts on every
        particle in proportion to its mass.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.lattices import half_hexagon
    >>> from magphonon.waves import burst_setup
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> where = burst_setup(cell, half_hexagon(cell, side=100.0), 'point')
    >>> len(where.driven), len(where.row)
    (1, 9)
    """
    one_of('source', source, DRIVEN)
    _refuse_turned(cell)
    x, y = patch.positions[:, :2].T
    inside = np.flatnonzero(freedom(patch)[0])  # not by tags, which may be kinds of magnets
    row = inside[y[inside] < y[inside].min() + NEAR * cell.cell.lengths()[0]]
    R2 = cell.cell.array[1, :2]
    middle = (x[row].min() + x[row].max()) / 2
    if source == 'point':
        driven = row[[abs(x[row] - middle).argmin()]]
        return BurstSetup(driven, np.ones(1), _row(patch, inside, driven[0], R2))
    across = (x[row] - middle) / (np.ptp(x[row]) + 2 * cell.cell.lengths()[0])
    below = middle - np.ptp(y[inside]) / 2 * R2[0] / R2[1]
    measured = _row(patch, inside, row[abs(x[row] - below).argmin()], R2)
    if source == 'bench':
        masses = patch.get_masses()[inside]
        return BurstSetup(inside, masses / masses.max(), measured)
    return BurstSetup(row, np.cos(np.pi * across) ** 2, measured)


def _refuse_turned(cell):
    (x, y, _), R2 = cell.cell.array[:2]
    if abs(y) > STRAIGHT * abs(x) or R2[1] <= 0:
        mirrored = x * R2[1] - y * R2[0] < 0
        turn = 180 * mirrored - np.degrees(np.arctan2(y, x))
        raise ValueError('a burst enters along R1, at the lowest row, and is measured upwards along R2, but these are '
                         f'({x:.6g}, {y:.6g}) and ({R2[0]:.6g}, {R2[1]:.6g}) mm; turn the cell with '
                         f'cell.rotate({turn:.9g}, "z", rotate_cell=True), and cut the patch from it')


def _row(patch, inside, start, R2):
    """The particles among `inside` that lie at whole steps of R2 from `start`, in order."""
    away = patch.positions[inside, :2] - patch.positions[start, :2]
    n = np.rint(away @ R2 / (R2 @ R2))
    on = (n >= 0) & (np.linalg.norm(away - n[:, None] * R2, axis=1) < NEAR * np.linalg.norm(R2))
    return inside[on][np.argsort(n[on])]


@dataclass(frozen=True)
class Burst:
    """A tone burst, the damping of the patch that it crosses, and how long it is recorded."""

    drive: ToneBurst
    damping: float  # gamma in 1/ms
    duration: float  # in ms, from the start of the burst


@dataclass(frozen=True)
class BurstRecord:
    """Recorded motion of a burst, along the row and in the whole patch."""

    row: Motion  # that of the measured row
    field: Motion  # that of all particles at a few moments
    largest: float  # displacement in mm that no particle exceeds where it is driven, along the row and at these moments
    nonlinear: float = np.nan  # change of the motion by nonlinear forces, of `largest`, where it decided on the method
    steps: bool = True  # whether time steps were taken; else this is the exact linear motion


def run_burst(patch: Atoms, site: BurstSetup, drive: ToneBurst, damping: float, duration: float, engine: str = 'auto',
              ranks: int = 1, directory: str | PathLike[str] | None = None, threads: int | None = None, film: bool = False,
              tolerance: float | None = None) -> BurstRecord:
    """Send a burst through a copy of a patch at rest and record it.

    Parameters
    ----------
    patch : ase.Atoms
        At rest in the reference of its PairCalculator; it stays there.
    site : BurstSetup
    drive : ToneBurst
        `site.burst(...)`.
    damping : float
        gamma in 1/ms; a wave of the frequency w has the damping ratio gamma/(2 w).
    duration : float
        Length of the record in ms, from the start of the burst.
    engine : str
        Engine as for DrivenVerlet, or 'lammps'.
    ranks : int
        Number of MPI ranks of LAMMPS.
    directory : path-like, optional
        Folder that keeps the files of LAMMPS, see `run_lammps`.
    threads : int, optional
        Number of threads, as for DrivenVerlet.
    film : bool
        Record the whole patch 12 times per period of the carrier, as a film needs it, instead of 24 times in all.
    tolerance : float, optional
        Error of the displacements, as a fraction of the largest one, as for DrivenVerlet; steps are then as long as it allows.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import MagneticRepulsion, read_scene, units as u
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.lattices import half_hexagon
    >>> from magphonon.waves import run_burst, burst_setup
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> patch = half_hexagon(cell, side=100.0)
    >>> patch.calc = MagneticRepulsion(patch, cell.calc.laws, foundation=cell.calc.foundation)
    >>> where = burst_setup(cell, patch, 'point')
    >>> burst = where.burst((0, 1), 1e-4 * u.N, 2 * np.pi * 60 * u.Hz, 3)
    >>> passage = run_burst(patch, where, burst, damping=0.004, duration=80.0)
    >>> passage.row.displacements.shape[1] == len(where.row)
    True
    """
    not_negative('damping', damping, '1/ms')
    patch = _at_rest(patch)
    frame, top = frame_of(patch, drive, duration)
    dt = STEP_FRACTION * 2 / top
    seen = np.union1d(site.row, site.driven)
    if tolerance is not None:
        only = engine == 'lammps' or patch.calc.turning
        dt = _step_within(tolerance, fastest(top**2, patch.calc.turning), duration, frame, (2,) if only else SPLITTINGS)

    def moved(dt):
        """Motion of the row and of the whole patch in time steps of `dt`."""
        interval, steps = max(1, int(frame / dt + 1e-9)), int(duration / dt)
        wanted = [(seen, interval), (None, interval if film else max(1, steps // SNAPSHOTS))]
        if engine == 'lammps':
            return run_lammps(patch, dt, steps, records=wanted, drives=[drive], damping=damping, ranks=ranks, directory=directory)
        dyn = DrivenVerlet(_at_rest(patch), dt, [drive], damping, engine, threads=threads, tolerance=tolerance)
        recorders = [Recorder(dyn, particles, every) for particles, every in wanted]
        dyn.run(steps)
        return [recorder.motion for recorder in recorders]

    while True:
        try:
            return recorded(site, moved(dt))
        except StepsTooLong as error:  # strains make waves faster than they are at rest
            dt = frame / np.ceil(frame / error.longest)


def recorded(site: BurstSetup, motions: Sequence[Motion]) -> BurstRecord:
    """The record of a burst, from the motion of driven particles and of those of the row, in ascending order, and of all."""
    near, field = motions
    largest = max(np.linalg.norm(frame, axis=1).max() for motion in motions for frame in motion.displacements)
    row = Motion(near.times, site.row, near.displacements[:, np.searchsorted(near.particles, site.row)])
    return BurstRecord(row, field, float(largest))


def frame_of(patch: Atoms, drive: ToneBurst, duration: float) -> tuple[float, float]:
    """Time in ms between two frames of the record of a burst, and the highest frequency of its patch in rad/ms; ValueError if
    no wave has its carrier, or the record is short.
    """
    top = highest_frequency(patch)
    _refuse_above(drive.omega, fastest(top**2, patch.calc.turning), patch.calc.parameters.model)
    if not positive('duration', duration, 'ms') > drive.end:
        raise ValueError(f'the record of {duration:.6g} ms ends before the burst does, at {drive.end:.6g} ms; record longer')
    return 2 * np.pi / drive.omega / SAMPLES, top


def _refuse_above(carrier, highest, model):
    """Raise ValueError for a carrier above the highest frequency of a patch."""
    if carrier > highest:
        raise ValueError(f'the carrier of {units.hertz(carrier):.6g} Hz lies above the highest frequency of the '
                         f'patch in the {model} model, {units.hertz(highest):.6g} Hz, where nothing propagates; lower it'
                         + (' (the conventional model reaches higher)' if model == 'complete' else ''))


def _step_within(tolerance, omega, duration, frame, orders):
    """The time step in ms that meets a tolerance with the fewest evaluations of forces; a whole number of them makes a frame."""
    if tolerance < ROUND_OFF_PER_RADIAN * omega * duration:
        raise ValueError(f'a tolerance of {tolerance:g} is below the round-off of {duration:.6g} ms of motion; take a larger one')
    counts = {order: int(np.ceil(omega * frame / SPLITTINGS[order].longest(omega * duration, tolerance))) for order in orders}
    return frame / counts[min(counts, key=lambda order: SPLITTINGS[order].stages * counts[order])]


def _at_rest(patch):
    """A copy of the patch with its calculator."""
    away = np.linalg.norm(repulsion_of(patch).displacements(patch), axis=1)
    for k in np.flatnonzero((away > ROUND_OFF * patch.calc.bonds.lengths.min()) | patch.get_momenta().any(axis=1))[:1]:
        raise ValueError(f'a burst starts in a patch at rest, but particle {k} is displaced by {away[k]:.3g} mm from the '
                         'reference of the calculator, or has a velocity, as after a run; set atoms.positions = '
                         'atoms.calc.reference.positions and atoms.set_momenta(0 * atoms.positions)')
    copy = patch.copy()
    copy.calc = patch.calc
    return copy
