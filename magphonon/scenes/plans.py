"""The tables of a scene that say what to compute: bands, frequency responses, tone bursts, plans."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from .. import units as u
from ..errors import one_of
from ..response.place import Place
from ..stiffness.constraints import freedom
from ..waves.wave_source import SOURCES
from .fields import (
    Angle,
    Angles,
    AtLeastTwo,
    Count,
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

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from ase import Atoms
    from numpy.typing import NDArray

    from ..waves.tone_burst import Passage
    from ..waves.vibrometer import Displacements
    from ..waves.wave_source import Burst, Site


class BandPlan(Table):
    """The path of the bands, and phonopy's supercell."""

    path: Text = Field(description="the special points in order, such as 'GMKG'")
    points: AtLeastTwo = Field(description='the number of wavevectors along the path')
    supercell: Counts = Field(description="phonopy's supercell, one number for each periodic direction")


class Pick(Table):
    """A particle of a patch, given by its position, and a direction in the plane."""

    at_m: Point = Field(description='the place [x, y] of the particle in m; the nearest one is taken')
    direction_deg: Angle = Field(description='the direction in degrees from the x axis')

    def of(self, patch: Atoms) -> Place:
        """The Place: the particle of a patch that is nearest, and the unit vector of the direction.

        Raises
        ------
        ValueError
            If the nearest particle is farther than a spacing away or belongs to the held rim.
        """
        distance = np.linalg.norm(patch.positions[:, :2] - np.array(self.at_m) * u.m, axis=1)
        particle, angle = distance.argmin(), self.direction_deg * u.deg
        x, y = patch.positions[particle, :2] / u.m
        if distance[particle] > patch.calc.bonds.lengths.min():
            raise ValueError(f'.at_m = {list(self.at_m)} is outside the patch; the nearest particle is at [{x:.6g}, {y:.6g}]')
        if not freedom(patch)[0][particle]:
            raise ValueError(f'.at_m = {list(self.at_m)} is on the held rim, nearest to [{x:.6g}, {y:.6g}]; choose one inside')
        return Place(int(particle), np.array([np.cos(angle), np.sin(angle), 0]))


class FrfPlan(Table):
    """Displacement per harmonic force over frequency; in a patch, where the force acts and where it is answered."""

    from_Hz: Frequency = Field(description='the lowest frequency in Hz')
    to_Hz: Frequency = Field(description='the highest frequency in Hz')
    points: AtLeastTwo = Field(description='the number of frequencies')
    damping_per_s: Rate = Field(description='the damping force per momentum in 1/s, which is the width of a peak in rad/s')
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


class PlanTable(Table):
    """Settings of "magphonon plan" that the other tables do not hold."""

    edge: Text | None = Field(None, description='the special point for whose frequency to plan; without it for all bands')
    branch: Count = Field(1, description='the branch at that point, counted from 1 by frequency')
    force_N: Force | None = Field(None, description='the amplitude in N of the force of [frf]; without it the force vanishes')


SPECTRUM_END = 1.4
"""Upper end of the spectrum of a Hann-windowed burst of five cycles, as a multiple of its carrier."""


class BurstPlan(Table):
    """Bursts through the patch, one after the other, each from rest."""

    source: Annotated[str, BeforeValidator(partial(one_of, '', choices=SOURCES))] = Field(
        description="'row' or 'point', which is where it enters at the lower edge of the patch")
    carriers_Hz: Frequencies = Field(description='the carrier frequency of each burst in Hz')
    directions_deg: Angles = Field(description='the direction of the force of each burst in degrees from the x axis')
    cycles: Annotated[Positive, within(0.5, 1e6, 'carrier periods')] = Field(
        description='the number of carrier periods in a burst')
    force_N: Force = Field(description='the largest force on a particle in N')
    damping_ratio: Annotated[NotNegative, within(0, 1, 'shares of critical damping')] = Field(
        description='the damping, as a share of critical at the carrier')
    duration_s: Duration = Field(description='the length of the record in s')

    @model_validator(mode='after')
    def _belong_together(self):
        if not self.carriers_Hz:
            raise ValueError('.carriers_Hz names no burst; give at least one carrier')
        if len(self.directions_deg) != len(self.carriers_Hz):
            raise ValueError(f'.directions_deg must hold a direction for each of the {len(self.carriers_Hz)} carriers, '
                             f'not {list(self.directions_deg)}')
        if len(set(self.names)) < len(self.names):
            raise ValueError(f' lists a burst twice, among {", ".join(self.names)}; keep one of them')
        longest = self.cycles / min(self.carriers_Hz)
        if not self.duration_s > longest:
            raise ValueError(f'.duration_s must be longer than the longest burst, {longest:.6g} s, not {self.duration_s!r}')
        return self

    @property
    def names(self) -> list[str]:
        """Names of the bursts, in messages and file names."""
        return [f'{f:.6g}Hz_{angle:.6g}deg' for f, angle in zip(self.carriers_Hz, self.directions_deg, strict=True)]

    def burst(self, k: int, site: Site) -> Burst:
        """Burst number k at a Site of a patch: its drive, damping and duration, as Burst."""
        from ..waves.wave_source import Burst

        omega, angle = 2 * np.pi * self.carriers_Hz[k] * u.Hz, self.directions_deg[k] * u.deg
        drive = site.burst((np.cos(angle), np.sin(angle)), self.force_N * u.N, omega, self.cycles)
        return Burst(drive, 2 * self.damping_ratio * omega, self.duration_s * u.s)

    def send(self, k: int, cell: Atoms, patch: Atoms, **engine: Any) -> tuple[Site, Passage]:
        """Send burst number k through a patch; returns its Site and Passage.

        `engine`, `threads`, `ranks` and `directory` are those of `magphonon.waves.tone_burst.send`.
        """
        from ..waves.spectrum import FEWEST
        from ..waves.tone_burst import send
        from ..waves.wave_source import site

        where = site(cell, patch, self.source)
        if len(where.row) < FEWEST:
            raise ValueError(f'the row along R2 has {len(where.row)} particles inside the rim, and a map of waves needs at least '
                             f'{FEWEST}; enlarge [patch]')
        burst = self.burst(k, where)
        return where, send(patch, where, burst.drive, burst.damping, burst.duration, **engine)


class VibrometerPlan(Table):
    """The virtual vibrometer that measures the row."""

    sampling_rate_Hz: Frequency = Field(description='the sampling rate in Hz')
    noise_m: Annotated[NotNegative, within(0, 1e6, 'metres')] = Field(description='the standard deviation of each sample in m')

    def measure(self, row: Displacements, seed: int = 0) -> Displacements:
        """The Displacements of a row as the vibrometer measures them; `seed` is that of its noise."""
        from ..waves.vibrometer import measure

        return measure(row.times, row.displacements, row.particles, self.sampling_rate_Hz * u.Hz, self.noise_m * u.m, seed)

    def refuse_aliasing(self, carriers_Hz: Sequence[float]) -> None:
        """Raise ValueError if the sampling folds the spectrum of a burst."""
        least = 2 * SPECTRUM_END * max(carriers_Hz)
        if self.sampling_rate_Hz < least:
            raise ValueError(f'vibrometer.sampling_rate_Hz must be at least {least:.6g}, twice the end of the spectrum of the '
                             f'highest burst, not {self.sampling_rate_Hz!r}')
