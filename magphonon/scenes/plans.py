"""The tables of a scene that say what to compute, in SI: bands, frequency responses and tone bursts."""

from __future__ import annotations

import warnings
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, model_validator

from .. import units as u
from ..errors import one_of
from ..response.frf import Dof
from ..stiffness.rest import LinearSystem
from ..waves.ridge_tables import DRIVEN
from .fields import (
    Angle,
    Angles,
    AtLeastTwo,
    Counts,
    Duration,
    Force,
    Frequencies,
    Frequency,
    NotNegative,
    Point,
    Positive,
    Rate,
    Table,
    Text,
    within,
)
from .structures import nearest_site

if TYPE_CHECKING:
    from ..waves.wave_source import Burst, BurstRecord, BurstSetup


TOLERANCE = 1e-3  # of a burst, as a fraction of its largest displacement, where a scene gives none


class Damped(Table):
    """Base of the tables with one damping, which the file of the particles may vary from particle to particle."""

    if TYPE_CHECKING:
        damping_per_s: float | None

    def damping_of(self, atoms: Atoms) -> Any:
        """Damping rate gamma in 1/ms: one number, or one for each particle if their file has the column relative_damping."""
        return self.damping_per_s / u.s * atoms.arrays.get('relative_damping', 1.0)  # pyright: ignore[reportOptionalOperand]  it is given


class BandPlan(Damped):
    """The path of the bands, and phonopy's supercell."""

    path: Text | None = Field(None, description="the special points in order, such as 'GMKG'; by default those of ASE")
    points: AtLeastTwo = Field(200, description='the number of wavevectors along the path')
    supercell: Counts | None = Field(None, description="phonopy's supercell, one number for each periodic direction; by "
                                                       'default the smallest in which no bond spans half of it')
    damping_per_s: Rate | None = Field(None, description='the damping force per momentum in 1/s; if given, the bands of '
                                                         'the complete model are computed again, with the decay of each mode',
                                       examples=[4.0])


class Pick(Table):
    """A particle of a patch, given by its position, and a direction in the plane."""

    at_m: Point = Field(description='the position [x, y] in m; the particle nearest to it is taken',
                        examples=[[0.03, 0.035]])
    direction_deg: Angle = Field(description='the direction in degrees from the x axis', examples=[0.0])

    def of(self, patch: Atoms) -> Dof:
        """The Dof in a patch: the particle nearest to the position, and the unit vector of the direction."""
        angle = self.direction_deg * u.deg
        return Dof(nearest_site('.at_m', patch, self.at_m), np.array([np.cos(angle), np.sin(angle), 0]))


class FrfPlan(Damped):
    """Displacement per harmonic force as a function of frequency; in a patch, the places of the force and of the response."""

    from_Hz: Frequency = Field(description='the lowest frequency in Hz')
    to_Hz: Frequency = Field(description='the highest frequency in Hz')
    points: AtLeastTwo = Field(description='the number of frequencies')
    damping_per_s: Rate = Field(description='the damping force per momentum in 1/s, which is the width of a peak in rad/s')
    base_deg: Angle | None = Field(None, description='the direction in degrees from the x axis in which the whole bench '
                                   'is shaken, in place of [frf.force]; the response is then per displacement of the bench, seen '
                                   'from the floor', examples=[90.0])
    force: Pick | None = None
    response: Pick | None = None

    @model_validator(mode='after')
    def _rising(self):
        if not self.from_Hz < self.to_Hz:
            raise ValueError(f'.to_Hz must lie above from_Hz = {self.from_Hz!r}, not {self.to_Hz!r}')
        return self

    @property
    def omega(self) -> NDArray[np.float64]:
        """Angular frequencies in rad/ms."""
        return 2 * np.pi * np.linspace(self.from_Hz, self.to_Hz, self.points) * u.Hz

    @property
    def damping(self) -> float:
        """Damping rate gamma in 1/ms."""
        return self.damping_per_s / u.s


class BurstPlan(Table):
    """Bursts through the patch, one after the other, each from rest."""

    source: Annotated[str, BeforeValidator(partial(one_of, '', choices=DRIVEN))] = Field(
        'point', description="'row' or 'point', for waves that enter at the lower edge of the patch; or 'bench' for a shaken "
                             'bench: force_N is then the mass of the heaviest particle times the acceleration of the bench, and '
                             'motion is relative to it')
    carriers_Hz: Frequencies = Field(description='the carrier frequency of each burst in Hz')
    directions_deg: Angles = Field((), description='the direction of the force of each burst in degrees from the x axis; by '
                                                   'default 90, into the patch')
    cycles: Annotated[Positive, within(0.5, 1e6, 'carrier periods')] = Field(
        5.0, description='the number of carrier periods in a burst')
    force_N: Force = Field(description='the largest force on a particle in N')
    damping_ratio: Annotated[NotNegative, within(0, 1, 'shares of critical damping')] = Field(
        0.01, description='the damping, as a fraction of the critical damping at the carrier frequency')
    duration_s: Duration | None = Field(None, description='the length of the record in s; by default three times the length of '
                                                          'the longest burst')
    tolerance: Annotated[Positive, within(1e-9, 0.1, 'of the largest displacement')] | None = Field(
        None, description='the allowed error of the displacements due to time steps and arithmetic, as a fraction of the '
                          'largest displacement; by default steps are short, of order two and in double precision',
        examples=[1e-3])

    @model_validator(mode='after')
    def _belong_together(self):
        if not self.carriers_Hz:
            raise ValueError('.carriers_Hz names no burst; give at least one carrier')
        longest = self.cycles / min(self.carriers_Hz)
        own: Any = self.__dict__  # it is read-only for everybody else
        own['directions_deg'] = self.directions_deg or (90.0,) * len(self.carriers_Hz)
        own['duration_s'] = self.duration_s or 3 * longest
        if len(self.directions_deg) != len(self.carriers_Hz):
            raise ValueError(f'.directions_deg must hold a direction for each of the {len(self.carriers_Hz)} carriers, '
                             f'not {list(self.directions_deg)}')
        if len(set(self.names)) < len(self.names):
            raise ValueError(f' lists a burst twice, among {", ".join(self.names)}; keep one of them')
        if not self.duration_s > longest:
            raise ValueError(f'.duration_s must be longer than the longest burst, {longest:.6g} s, not {self.duration_s!r}')
        return self

    @property
    def names(self) -> list[str]:
        """Names of the bursts, in messages and file names."""
        return [f'{f:.6g}Hz_{angle:.6g}deg' for f, angle in zip(self.carriers_Hz, self.directions_deg, strict=True)]

    def burst(self, k: int, site: BurstSetup) -> Burst:
        """Burst number k at the particles of a BurstSetup: its drive, damping and duration, as a Burst."""
        from ..waves.wave_source import Burst

        omega, angle = 2 * np.pi * self.carriers_Hz[k] * u.Hz, self.directions_deg[k] * u.deg
        drive = site.burst((np.cos(angle), np.sin(angle)), self.force_N * u.N, omega, self.cycles)
        return Burst(drive, 2 * self.damping_ratio * omega, self.duration_s * u.s)

    def send(self, k: int, cell: Atoms, patch: Atoms, **engine: Any) -> tuple[BurstSetup, BurstRecord]:
        """Send burst number k through a patch; returns its BurstSetup and BurstRecord.

        `engine`, `threads`, `ranks`, `directory` and `film` are those of `magphonon.waves.run_burst`; the engine 'least' is the
        exact linear motion where nonlinear forces change it by less than the tolerance (1e-3 if none is given), and time steps
        where they change it by more, or the patch is unstable.
        """
        from ..waves.spectrum import FEWEST
        from ..waves.wave_source import burst_setup, frame_of, run_burst

        where = burst_setup(cell, patch, self.source)
        if len(where.row) < FEWEST:
            raise ValueError(f'the row along R2 has {len(where.row)} particles inside the rim, and a map of waves needs at least '
                             f'{FEWEST}; make [patch] {FEWEST / max(len(where.row) - 1, 1):.2g} times as large')
        burst, tolerance, change = self.burst(k, where), self.tolerance, np.nan
        if engine.get('engine') == 'least':
            engine, tolerance = engine | {'engine': 'auto'}, tolerance or TOLERANCE
            linear, change = _linear(patch, where, burst, engine.get('film', False))
            if linear is not None and change <= tolerance:
                frame_of(patch, burst.drive, burst.duration)  # refuses what `run_burst` refuses
                return where, linear
        run = run_burst(patch, where, burst.drive, burst.damping, burst.duration, tolerance=tolerance, **engine)
        return where, replace(run, nonlinear=change)


def _linear(patch, where, burst, film):
    """Exact linear motion of a burst, and its change by nonlinear forces in largest displacements; infinite if it is unstable."""
    from ..dynamics.motion import Motion
    from ..response.frf import nonlinear_change
    from ..response.propagation import propagate
    from ..waves.wave_source import SAMPLES, SNAPSHOTS, recorded

    system, frame = LinearSystem.of(patch, 'gyration'), 2 * np.pi / burst.drive.omega / SAMPLES
    if not system.stable:
        return None, np.inf
    times, seen = frame * np.arange(int(burst.duration / frame) + 1), np.union1d(where.row, where.driven)
    few = times[:: 1 if film else max(1, len(times) // SNAPSHOTS)]
    with warnings.catch_warnings():
        warnings.simplefilter('ignore', UserWarning)  # about large motion, which is asked about next
        found = [propagate(patch, at, [burst.drive], burst.damping, particles, 1e-6)
                 for at, particles in ((times, seen), (few, None))]
    run = recorded(where, [Motion(one.times, one.particles, one.displacements) for one in found])
    change = nonlinear_change(system, burst.drive, burst.damping, run.largest)
    return replace(run, nonlinear=change, steps=False), change
