"""The table [foundation] of a scene: springs or pillars that support the particles."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import Field, model_validator

from .. import units as u
from ..errors import positive
from ..interactions.upright import UprightMagnets
from .fields import Flag, Length, NotNegative, Positive, Pressure, Table, within

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairLaw


def _poisson_ratio(value):
    ratio = positive('', value)
    if ratio > 0.5:
        raise ValueError(f' must not exceed 0.5, not be {value!r}')
    return ratio


class Pillar(Table):
    """Round cantilever under each particle."""

    youngs_modulus_Pa: Pressure = Field(description="Young's modulus in Pa")
    radius_m: Length = Field(description='the radius in m')
    height_m: Length = Field(description='the height in m')
    density_kg_per_m3: Annotated[Positive, within(1e-3, 1e6, 'kg/m3')] | None = Field(
        None, description='the density in kg/m3; with it 33/140 of the mass of a pillar moves with its particle')

    @property
    def stiffness_N_per_m(self) -> float:
        """`k = 3 E I/H^3` with `I = pi R^4/4`."""
        return 3 * self.youngs_modulus_Pa * (np.pi * self.radius_m**4 / 4) / self.height_m**3

    @property
    def moving_mass_kg(self) -> float:
        """Rayleigh's 33/140 of its mass, which moves with the tip; zero for a pillar of unknown density."""
        return 33 / 140 * (self.density_kg_per_m3 or 0.0) * np.pi * self.radius_m**2 * self.height_m


class OutOfPlane(Table):
    """Supports along z; with this table the particles of a planar lattice move out of its plane, too."""

    stiffness_N_per_m: Annotated[NotNegative, within(0, 1e15, 'N/m')] = Field(
        description='the stiffness in N/m of the support of each particle along z', examples=[800.0])
    upright_magnets: Flag = Field(description='true for magnets that stand upright on the plane, whose energy obeys '
                                              "Laplace's equation; false for a force along the line between two particles")


class Foundation(Table):
    """Springs that tie each particle to its place, by their stiffness or as pillars."""

    stiffness_N_per_m: Annotated[NotNegative, within(0, 1e15, 'N/m')] | None = Field(
        None, description='the stiffness in N/m of the spring that ties each particle to its place')
    pillar: Pillar | None = None
    out_of_plane: OutOfPlane | None = None

    @model_validator(mode='after')
    def _one(self):
        if (self.stiffness_N_per_m is None) == (self.pillar is None):
            has = 'neither' if self.pillar is None else 'both'
            raise ValueError(f' has {has} of stiffness_N_per_m and [foundation.pillar]; give one, or leave [foundation] out')
        return self

    @property
    def stiffness(self) -> float:
        """Stiffness in N/mm."""
        return (self.stiffness_N_per_m if self.pillar is None else self.pillar.stiffness_N_per_m) * u.N / u.m

    def springs(self, in_plane: Any) -> Any:
        """The foundation as the calculators take it; `in_plane` is its stiffness in N/mm, one number or one per particle."""
        if self.out_of_plane is None:
            return in_plane
        kz = self.out_of_plane.stiffness_N_per_m * u.N / u.m
        return np.atleast_2d(np.stack(np.broadcast_arrays(in_plane, in_plane, kz), axis=-1))

    def law(self, in_plane: PairLaw) -> PairLaw:
        """The pair law of the particles, `in_plane` at equal height."""
        return UprightMagnets(in_plane) if self.out_of_plane and self.out_of_plane.upright_magnets else in_plane

    @property
    def moving_mass(self) -> float:
        """Mass of the pillar that moves with each particle, in g."""
        return self.pillar.moving_mass_kg * u.kg if self.pillar else 0.0
