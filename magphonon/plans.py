"""What is wanted from a lattice, as tables of a scene file, in SI."""

import numpy as np
from pydantic import Field, model_validator

from . import units as u
from .lattices import RIM
from .tables import Angle, AtLeastTwo, Count, Counts, Force, Frequency, Point, Rate, Table, Text


class BandPlan(Table):
    """What the bands are computed along, and phonopy's supercell."""

    path: Text = Field(description="the special points in order, such as 'GMKG'")
    points: AtLeastTwo = Field(description='the number of wavevectors along the path')
    supercell: Counts = Field(description="phonopy's supercell, one number for each periodic direction")


class Pick(Table):
    """A particle of a patch, by where it is, and a direction in the plane."""

    at_m: Point = Field(description='the place [x, y] of the particle in m; the nearest one is taken')
    direction_deg: Angle = Field(description='the direction in degrees from the x axis')

    def of(self, patch):
        """Index of the particle of a patch, and the unit vector of the direction, shape (3,).

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
        if patch.get_tags()[particle] == RIM:
            raise ValueError(f'.at_m = {list(self.at_m)} is on the held rim, nearest to [{x:.6g}, {y:.6g}]; go inside')
        return particle, np.array([np.cos(angle), np.sin(angle), 0])


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
    def omega(self):
        """Angular frequencies in rad/ms."""
        return 2 * np.pi * np.linspace(self.from_Hz, self.to_Hz, self.points) * u.Hz

    @property
    def damping(self):
        """In 1/ms."""
        return self.damping_per_s / u.s


class LadderPlan(Table):
    """What a plan of the least model needs to know beyond the other tables."""

    edge: Text | None = None
    branch: Count = 1
    force_N: Force | None = None
