"""A tone burst sent through a patch at rest, and its record."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..dynamics.lammps_runs import run_lammps
from ..dynamics.recorder import Recorder
from ..dynamics.timestep import highest_frequency
from ..dynamics.verlet import DrivenVerlet
from ..errors import not_negative, positive
from ..stiffness.repulsion import repulsion_of
from .vibrometer import Displacements

if TYPE_CHECKING:
    from os import PathLike

    from ase import Atoms

    from ..dynamics.drives import ToneBurst
    from .wave_source import Site

STEP_FRACTION = 0.1
"""Time step as a fraction of the limit 2/omega_max: frequencies near omega_max are wrong by 0.2 %, lower ones by less."""
SAMPLES = 20
"""Number of recorded frames per period of the carrier; the spectrum of a five-cycle burst ends at 1.4 times its carrier."""
SNAPSHOTS = 24
"""Number of times at which the whole patch is recorded."""


ROUND_OFF = 1e-9
"""Displacement, as a fraction of the shortest bond, below which a particle is at rest."""


@dataclass(frozen=True)
class Passage:
    """Recorded motion of a burst.

    Attributes
    ----------
    row : Displacements
        Displacements of the measured row.
    field : Displacements
        Displacements of all particles at a few moments.
    largest : float
        Displacement in mm that no particle exceeds where it is driven, along the row and at these moments.
    """

    row: Displacements
    field: Displacements
    largest: float


def send(patch: Atoms, site: Site, drive: ToneBurst, damping: float, duration: float, engine: str = 'auto', ranks: int = 1,
         directory: str | PathLike[str] | None = None, threads: int | None = None) -> Passage:
    """Send a burst through a copy of a patch at rest and record it.

    Parameters
    ----------
    patch : ase.Atoms
        At rest in the reference of its MagneticRepulsion; it stays there.
    site : Site
    drive : ToneBurst
        `site.burst(...)`.
    damping : float
        gamma in 1/ms; a wave of the frequency w has the damping ratio gamma/(2 w).
    duration : float
        Length of the record in ms, from the start of the burst.
    engine : str
        Engine as for DrivenVerlet, or 'lammps'.
    ranks : int
        MPI ranks of LAMMPS.
    directory : path-like, optional
        Folder that keeps the files of LAMMPS, see `run_lammps`.
    threads : int, optional
        Number of threads, as for DrivenVerlet.

    Returns
    -------
    Passage

    Raises
    ------
    ValueError
        For a carrier above all frequencies of the patch, a duration that ends before the burst does, or a patch that moves or
        does not stand in its reference.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import MagneticRepulsion, read_scene, ready_scene, units as u
    >>> from magphonon.lattices import half_hexagon
    >>> from magphonon.waves import send, site
    >>> cell = read_scene(ready_scene('prototype')).atoms()
    >>> patch = half_hexagon(cell, side=100.0)
    >>> patch.calc = MagneticRepulsion(patch, cell.calc.potential, foundation=cell.calc.foundation)
    >>> where = site(cell, patch, 'point')
    >>> burst = where.burst((0, 1), 1e-4 * u.N, 2 * np.pi * 60 * u.Hz, 3)
    >>> passage = send(patch, where, burst, damping=0.004, duration=80.0)
    >>> passage.row.displacements.shape[1] == len(where.row)
    True
    """
    not_negative('damping', damping, '1/ms')
    patch = _at_rest(patch)
    top = highest_frequency(patch)
    if drive.omega > top:
        model = patch.calc.parameters.model
        raise ValueError(f'the carrier of {units.hertz(drive.omega):.6g} Hz lies above the highest frequency of the '
                         f'patch in the {model} model, {units.hertz(top):.6g} Hz, where nothing propagates; lower it'
                         + (' (the conventional model reaches higher)' if model == 'complete' else ''))
    dt = STEP_FRACTION * 2 / top
    interval = max(1, int(2 * np.pi / drive.omega / SAMPLES / dt))
    if not positive('duration', duration, 'ms') > drive.end:
        raise ValueError(f'the record of {duration:.6g} ms ends before the burst does, at {drive.end:.6g} ms; record longer')
    steps = int(duration / dt)
    wanted = [(site.row, interval), (site.driven, interval), (None, max(1, steps // SNAPSHOTS))]
    if engine == 'lammps':
        row, source, field = run_lammps(patch, dt, steps, records=wanted, drives=[drive], damping=damping, ranks=ranks,
                                        directory=directory)
    else:
        dyn = DrivenVerlet(patch, dt, [drive], damping, engine, threads=threads)
        row, source, field = (Recorder(dyn, particles, every) for particles, every in wanted)
        dyn.run(steps)
    largest = max(np.linalg.norm(record.displacements, axis=2).max() for record in (row, source, field))
    on_row, everywhere = (Displacements(record.times, record.particles, record.displacements) for record in (row, field))
    return Passage(on_row, everywhere, float(largest))


def _at_rest(patch):
    """A copy of the patch with its calculator."""
    away = np.linalg.norm(repulsion_of(patch).displacements(patch), axis=1)
    for k in np.flatnonzero((away > ROUND_OFF * patch.calc.bonds.lengths.min()) | patch.get_momenta().any(axis=1))[:1]:
        raise ValueError(f'a burst is sent through a patch at rest, but particle {k} stands {away[k]:.3g} mm away from the '
                         'reference of the calculator or moves, as after a run; set atoms.positions = '
                         'atoms.calc.reference.positions and atoms.set_momenta(0 * atoms.positions)')
    copy = patch.copy()
    copy.calc = patch.calc
    return copy
