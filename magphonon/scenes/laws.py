"""Pair laws of a scene: closed forms, tables, and magnets described by their datasheet."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, Union

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, create_model, field_serializer, model_validator

from .. import units as u
from ..errors import MOST, one_of, positive, shown, whole
from ..interactions.bond_laws import Laws
from ..interactions.force_tables import read_forces
from ..interactions.law_cards import Kind, kinds_of_laws
from ..interactions.magnet_pairs import calibrated, magnet_law
from ..interactions.magnets import GRADES_T, Cuboid, Ring, Sphere, grade_remanence
from ..interactions.pair_laws import Attraction, InversePower, PairLaw, Tabulated
from .fields import Flag, Force, Length, Positive, Pressure, Table, Text, listed, of_known_kind, within

ALL, AUTO = 'all', 'auto'
TOLERANCE = 1e-3
"""Largest relative change of a frequency by neighbours that are left out, for shells = 'auto': spacings and forces of real
lattices are hardly known better."""


def _shells(value):
    if isinstance(value, str) and value in (ALL, AUTO):
        return value
    try:
        return whole('', value)
    except ValueError:
        raise ValueError(f' must be a whole number from 1 to {MOST}, {AUTO!r} or {ALL!r}, not {shown(value)}') from None


Shells = Annotated[int | Literal['auto', 'all'], BeforeValidator(_shells),
                   Field(description=f"the number of shells of neighbours that interact; '{AUTO}' for as many as are needed to "
                                     f"get each frequency at the special points right to {TOLERANCE:.1%}, '{ALL}' for all",
                         examples=[1])]


class Neighbours(Table):
    """Base of the laws: which neighbours interact."""

    if TYPE_CHECKING:
        shells: int | str = AUTO

    _asked: int | str = PrivateAttr(AUTO)  # what the scene says, where `shells` is the number that was chosen
    _reach: float | None = PrivateAttr(None)  # and the distance in spacings behind which the next shell begins

    @model_validator(mode='after')
    def _as_asked(self):
        self._asked = self.shells
        return self

    @field_serializer('shells', check_fields=False)
    def _told(self, shells):
        return self._asked

    @property
    def asked(self) -> int | str:
        """The value of the key `shells` in the scene."""
        return self._asked

    @property
    def reach(self) -> float | None:
        """A distance in spacings just beyond the last chosen shell, by which neighbours are found faster than by shells."""
        return self._reach

    def with_shells(self, shells: int | str, reach: float | None = None) -> Self:
        """The same law with the number of shells, and their reach, that were chosen for it."""
        law = self.model_copy(update={'shells': shells})
        law._reach = reach
        return law


Grade = Annotated[str, BeforeValidator(partial(one_of, '', choices=tuple(GRADES_T)))]


class RingShape(Table):
    """Ring magnetised along its axis."""

    outer_diameter_m: Length = Field(description='the outer diameter in m')
    inner_diameter_m: Length = Field(description='the inner diameter in m')
    height_m: Length = Field(description='the height in m, along the magnetisation')

    def magnet(self, remanence: float) -> Ring:
        return Ring(self.outer_diameter_m * u.m, self.inner_diameter_m * u.m, self.height_m * u.m, remanence)


class DiscShape(Table):
    """Disc or rod magnetised along its axis."""

    diameter_m: Length = Field(description='the diameter in m')
    height_m: Length = Field(description='the height in m, along the magnetisation')

    def magnet(self, remanence: float) -> Ring:
        return Ring(self.diameter_m * u.m, 0.0, self.height_m * u.m, remanence)


class SphereShape(Table):
    """Sphere."""

    diameter_m: Length = Field(description='the diameter in m', examples=[0.005])

    def magnet(self, remanence: float) -> Sphere:
        return Sphere(self.diameter_m * u.m, remanence)


class CuboidShape(Table):
    """Cuboid facing its neighbours squarely; its law neglects that the force is not quite central."""

    length_m: Length = Field(description='the length in m, towards the neighbour', examples=[0.005])
    width_m: Length = Field(description='the width in m', examples=[0.005])
    height_m: Length = Field(description='the height in m, along the magnetisation', examples=[0.003])

    def magnet(self, remanence: float) -> Cuboid:
        return Cuboid(self.length_m * u.m, self.width_m * u.m, self.height_m * u.m, remanence)


class Calibration(Table):
    """A measured force, which sets the remanence in place of the datasheet."""

    distance_m: Length = Field(description='the distance of the centres of two magnets in m', examples=[0.01])
    force_N: Force = Field(description='the force in N measured at distance_m', examples=[0.2369])


class Datasheet(Table):
    """Shape and remanence of the magnets, and what calibrates them."""

    SHAPES: ClassVar = ('ring', 'disc', 'sphere', 'cuboid')

    ring: RingShape | None = None
    disc: DiscShape | None = None
    sphere: SphereShape | None = None
    cuboid: CuboidShape | None = None
    grade: Grade | None = Field(None, description='the grade of the datasheet, which gives the remanence', examples=['N42'])
    remanence_T: Annotated[Positive, within(1e-6, 100, 'teslas')] | None = Field(
        None, description='the remanence in T, in place of a grade')
    calibration: Calibration | None = None

    @model_validator(mode='after')
    def _one_of_each(self):
        shapes, told = ([name for name in names if getattr(self, name) is not None]
                        for names in (self.SHAPES, ('grade', 'remanence_T')))
        if len(shapes) != 1:
            raise ValueError(f' has {" and ".join(shapes) or "no shape"}; give one of '
                             + ', '.join(f'[law.{name}]' for name in self.SHAPES))
        if len(told) > 1 or not (told or self.calibration):
            raise ValueError(f' has {" and ".join(told) or "no strength"}; give grade, remanence_T or [law.calibration]')
        try:
            self.potential()
        except ValueError as error:
            raise ValueError(f': {error}') from None
        return self

    def magnet(self) -> Cuboid | Ring | Sphere:
        """The magnet, a `Ring`, `Cuboid` or `Sphere` in mm."""
        (shape,) = (shape for name in self.SHAPES if (shape := getattr(self, name)) is not None)
        if self.calibration is None:
            return shape.magnet(self.remanence_T * u.T if self.grade is None else grade_remanence(self.grade))  # pyright: ignore[reportOptionalOperand]  one is given
        magnet = shape.magnet(u.T)  # of any remanence: the force sets it
        return calibrated(magnet, self.calibration.distance_m * u.m, self.calibration.force_N * u.N)

    def potential(self) -> PairLaw:
        return magnet_law(self.magnet())


class ClosedForm(Neighbours):
    """A law given by a few numbers."""

    def potential(self) -> PairLaw:
        """The law in mm, g and ms."""
        raise NotImplementedError

    @model_validator(mode='after')
    def _within_range(self):
        self.refuse_overflow()
        return self

    def refuse_overflow(self) -> None:
        """Raise ValueError for numbers that are too large or too small to compute with."""
        try:
            self.potential()
        except ValueError as error:
            given = ', '.join(f'law.{key} = {value!r}' for key, value in self if isinstance(value, float))
            raise ValueError(f': {error}; check units and exponents of {given}') from None


class InversePowerLaw(ClosedForm):
    """Force `b r^-a`, given by b or by the force between nearest neighbours."""

    kind: Literal['inverse_power']
    b_N_m_a: Positive | None = Field(None, description='b of the force b r^-a in N m^a')
    force_N: Force | None = Field(None, description='the force in N between nearest neighbours, from which b follows, in place '
                                  'of b_N_m_a', examples=[0.2369])
    a: Positive = Field(description='the exponent a of the force b r^-a')
    shells: Shells = AUTO

    _spacing_m: float = PrivateAttr(1.0)  # where the force is force_N: that of the lattice, once the scene knows it

    @model_validator(mode='after')
    def _within_range(self):
        if (self.b_N_m_a is None) == (self.force_N is None):
            has = 'neither' if self.force_N is None else 'both'
            raise ValueError(f' has {has} of b_N_m_a and force_N; give one of them')
        self.refuse_overflow()
        return self

    def placed(self, spacing_m: float) -> InversePowerLaw:
        """The same law, with force_N taken as the force at this distance."""
        law = self.model_copy()
        law._spacing_m = spacing_m
        law.refuse_overflow()
        return law

    @property
    def b(self) -> float:
        """The factor b in N m^a."""
        return self.b_N_m_a if self.force_N is None else self.force_N * self._spacing_m**self.a  # pyright: ignore[reportReturnType]

    def potential(self) -> PairLaw:
        return InversePower(self.b * u.N * u.m**self.a, self.a)


def _poisson_ratio(value):
    ratio = positive('', value)
    if ratio > 0.5:
        raise ValueError(f' must be at most 0.5, not {value!r}')
    return ratio


Ratio = Annotated[float, BeforeValidator(_poisson_ratio)]
QUANTITIES = {'positive': Positive, 'length': Length, 'force': Force, 'pressure': Pressure, 'ratio': Ratio}
"""Which values the parameters of a law may have, as its card says."""


class CardLaw(ClosedForm):
    """A law whose keys are those of its card, `magphonon.interactions.law_cards`."""

    card: ClassVar[Kind]

    def potential(self) -> PairLaw:
        assert self.card.made is not None  # noqa: S101  `_of_card` is for those that have it
        return self.card.made(**{name: getattr(self, one.key) * one.unit for name, one in self.card.parameters.items()})


def _of_card(kind):
    keys = {one.key: (QUANTITIES[one.quantity], Field(description=one.words, examples=list(one.examples) or None))
            for one in kind.parameters.values()}
    table = create_model(kind.name, __base__=CardLaw, __doc__=kind.words, kind=(Literal[kind.name], ...), **keys,  # pyright: ignore
                         shells=(Shells, kind.shells))
    table.card = kind
    return table


class TableLaw(Neighbours):
    """Measured forces, in the scene or in a `file` beside it."""

    kind: Literal['table']
    distances_m: Annotated[tuple[Length, ...], listed] = Field(
        description="the distances in m, increasing, or file = 'law.csv' with the columns r_m,f_N",
        examples=[[0.008, 0.01, 0.012, 0.015]])
    forces_N: Annotated[tuple[Force, ...], listed] = Field(
        description='the forces in N at distances_m', examples=[[0.66, 0.24, 0.10, 0.037]])
    file: Text | None = Field(
        None, description='a table of forces beside the scene with the columns r_m,f_N, in place of distances_m and forces_N',
        examples=['law.csv'])
    shells: Shells = AUTO

    @model_validator(mode='before')
    @classmethod
    def _columns(cls, table, info: ValidationInfo):
        if not isinstance(table, dict) or 'file' not in table:
            return table
        if not isinstance(table['file'], str) or '\0' in table['file']:
            raise ValueError(f'.file must be the name of a file in quotes, not {shown(table["file"])}')
        for key in table.keys() & {'distances_m', 'forces_N'}:
            raise ValueError(f' has both file and {key}; keep one of them')
        return table | _read_columns(info.context['folder'] / table['file'])

    @model_validator(mode='after')
    def _smooth(self):
        try:
            self.potential()
        except ValueError as error:
            raise ValueError(f': {error}') from None
        return self

    def potential(self) -> PairLaw:
        return Tabulated(np.array(self.distances_m) * u.m, np.array(self.forces_N) * u.N)


class MagnetsLaw(Datasheet, Neighbours):
    """Uniform magnets, magnetised normal to the plane, by shape and remanence."""

    kind: Literal['magnets']
    shells: Shells = AUTO


def _read_columns(file):
    try:
        forces = read_forces(file)
    except OSError as error:
        raise ValueError(f'.file: {file} cannot be read ({error.strerror})') from None
    except ValueError as error:
        raise ValueError(f'.file: {error}') from None
    order = np.argsort(forces.r)
    r, f = forces.r[order], forces.f[order]
    for k in np.flatnonzero(np.diff(r) == 0)[:1]:
        raise ValueError(f'.file: {file} holds the distance {r[k] / u.m:g} m more than once, but a law has one force at each '
                         f'distance; '
                         f'"magphonon fit {file}" makes a law of repeated measurements')
    for k in np.flatnonzero(f <= 0)[:1]:
        raise ValueError(f'.file: {file} holds the force {f[k] / u.N:g} N at {r[k] / u.m:g} m, but a repulsive force is '
                         f'positive; '
                         f'"magphonon fit {file}" makes a law of measurements with noise')
    return {'distances_m': list(r / u.m), 'forces_N': list(f / u.N)}


class SavedLaw(Table):
    """The law, bonds and foundation of the calculator stored in the file of the lattice, as `write_scene` saves it."""

    shells: ClassVar = 'saved'

    kind: Literal['saved']

    def potential(self) -> PairLaw:
        raise ValueError('law.kind = "saved": the law is in the file of the lattice, but this needs a law that is written in '
                         'the scene, such as kind = "inverse_power"')


class MembersLaw(SavedLaw):
    """Each member has a law of its own, in [[members]]."""

    kind: Literal['members']  # pyright: ignore[reportIncompatibleVariableOverride]

    def potential(self) -> PairLaw:
        raise ValueError('law.kind = "members": each member has a law of its own, but this needs one law for all particles, '
                         'such as kind = "inverse_power"')


KINDS = kinds_of_laws()
if TYPE_CHECKING:
    Law = Any  # one of the tables below
else:
    _TABLES = (InversePowerLaw, *(_of_card(kind) for kind in KINDS.values() if kind.made), TableLaw, MagnetsLaw, SavedLaw,
               MembersLaw)
    Law = Annotated[Union[_TABLES], Field(discriminator='kind'), of_known_kind(*_TABLES)]  # noqa: UP007  a number of them


def _two_kinds(value):
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f' must be two kinds of particles, as [0, 1], not {shown(value)}')
    return tuple(sorted(whole(f'[{k}]', kind, least=0) for k, kind in enumerate(value)))


class LawOfKinds(Table):
    """The law between particles of two kinds, in place of [law]."""

    kinds: Annotated[tuple[int, int], BeforeValidator(_two_kinds)] = Field(
        description='the two kinds, in either order; a particle has the kind that its file or [[defects.substitutions]] gives, '
        'or 0', examples=[[0, 1]])
    law: Law = Field(description='the law between particles of the two kinds, as a table like [law]')
    attracts: Flag = Field(False, description='whether particles of these two kinds attract each other by this law',
                           examples=[True])


def laws_of_kinds(law: PairLaw, others: tuple[LawOfKinds, ...], kinds: Iterable[int]) -> Laws:
    """One law, or a law for each pair of kinds, from `kinds` and from those that `others` name."""
    if not others:
        return law
    named = sorted({int(kind) for kind in kinds}.union(*(other.kinds for other in others)))
    laws: dict[tuple[int, int], PairLaw] = {(a, b): law for a in named for b in named if a <= b}
    return laws | {other.kinds: Attraction(law) if other.attracts else law
                   for other in others for law in [other.law.potential()]}
