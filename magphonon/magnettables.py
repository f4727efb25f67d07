"""Magnets by their datasheet, as tables of a scene file, in SI."""

from functools import partial
from typing import Annotated, ClassVar

from pydantic import BeforeValidator, Field, model_validator

from . import units as u
from .errors import one_of
from .magnets import GRADES_T, Cuboid, Ring, Sphere, calibrated, grade_remanence, magnet_law
from .tables import Force, Length, Positive, Table, within

Grade = Annotated[str, BeforeValidator(partial(one_of, '', choices=tuple(GRADES_T)))]


class RingShape(Table):
    """Ring magnetised along its axis."""

    outer_diameter_m: Length = Field(description='the outer diameter in m')
    inner_diameter_m: Length = Field(description='the inner diameter in m')
    height_m: Length = Field(description='the height in m, along the magnetisation')

    def magnet(self, remanence):
        return Ring(self.outer_diameter_m * u.m, self.inner_diameter_m * u.m, self.height_m * u.m, remanence)


class DiscShape(Table):
    """Disc or rod magnetised along its axis."""

    diameter_m: Length = Field(description='the diameter in m')
    height_m: Length = Field(description='the height in m, along the magnetisation')

    def magnet(self, remanence):
        return Ring(self.diameter_m * u.m, 0.0, self.height_m * u.m, remanence)


class SphereShape(Table):
    """Sphere."""

    diameter_m: Length = Field(description='the diameter in m')

    def magnet(self, remanence):
        return Sphere(self.diameter_m * u.m, remanence)


class CuboidShape(Table):
    """Cuboid facing its neighbours squarely; its law neglects that the force is not quite central."""

    length_m: Length = Field(description='the length in m, towards the neighbour')
    width_m: Length = Field(description='the width in m')
    height_m: Length = Field(description='the height in m, along the magnetisation')

    def magnet(self, remanence):
        return Cuboid(self.length_m * u.m, self.width_m * u.m, self.height_m * u.m, remanence)


class Calibration(Table):
    """A measured force, which sets the remanence in place of the datasheet."""

    distance_m: Length = Field(description='the distance of the centres in m')
    force_N: Force = Field(description='the measured force at this distance in N')


class Datasheet(Table):
    """Shape and remanence of the magnets, and what calibrates them."""

    SHAPES: ClassVar = ('ring', 'disc', 'sphere', 'cuboid')

    ring: RingShape | None = None
    disc: DiscShape | None = None
    sphere: SphereShape | None = None
    cuboid: CuboidShape | None = None
    grade: Grade | None = None
    remanence_T: Annotated[Positive, within(1e-6, 100, 'teslas')] | None = None
    calibration: Calibration | None = None

    @model_validator(mode='after')
    def _one_of_each(self):
        for names, what in ((self.SHAPES, 'one of ' + ', '.join(f'[law.{name}]' for name in self.SHAPES)),
                            (('grade', 'remanence_T'), 'grade or remanence_T')):
            given = [name for name in names if getattr(self, name) is not None]
            if len(given) != 1:
                raise ValueError(f' has {" and ".join(given) or "neither"}; give {what}')
        try:
            self.potential()
        except ValueError as error:
            raise ValueError(f': {error}') from None
        return self

    def magnet(self):
        """The magnet, a `Ring`, `Cuboid` or `Sphere` in mm."""
        (shape,) = (shape for name in self.SHAPES if (shape := getattr(self, name)) is not None)
        magnet = shape.magnet(grade_remanence(self.grade) if self.remanence_T is None else self.remanence_T * u.T)
        if self.calibration is None:
            return magnet
        return calibrated(magnet, self.calibration.distance_m * u.m, self.calibration.force_N * u.N)

    def potential(self):
        return magnet_law(self.magnet())
