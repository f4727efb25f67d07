"""Pair laws of a scene: closed forms, tables, and magnets described by their datasheet."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, Self, Union

import numpy as np
from pydantic import BeforeValidator, Field, PrivateAttr, create_model, field_serializer, model_validator

from .. import units as u
from ..errors import one_of, shown, whole
from ..interactions.law_cards import Kind, kinds_of_laws
from ..interactions.magnet_pairs import magnet_law
from ..interactions.magnets import GRADES_T, Cuboid, Ring, grade_remanence
from ..interactions.pair_laws import PairLaw, Tabulated
from .fields import Force, Length, NotNegative, Positive, Pressure, Table, listed, of_known_kind, within

ALL, AUTO = 'all', 'auto'
TOLERANCE = 1e-3
"""Largest relative change of a frequency by neighbours that are left out, for shells = 'auto': spacings and forces of real
lattices are hardly known better."""
MOST_SHELLS = 300
"""Largest number of shells, about 4000 neighbours of each particle; beyond it the sum over all neighbours is used."""


def _shells(value):
    if isinstance(value, str) and value in (ALL, AUTO):
        return value
    try:
        if (shells := whole('', value)) <= MOST_SHELLS:
            return shells
    except ValueError:
        pass
    raise ValueError(f' must be a whole number from 1 to {MOST_SHELLS}, {AUTO!r} or {ALL!r}, not {shown(value)}')


Shells = Annotated[int | Literal['auto', 'all'], BeforeValidator(_shells),
                   Field(description=f"the number of shells of neighbours that interact; '{AUTO}' for as many as are needed to "
                                     f"get each frequency at the special points right to {TOLERANCE:.1%}, '{ALL}' for all",
                         examples=[1])]


class PairLawTable(Table):
    """Base of the laws between pairs: which neighbours interact, and numbers that give a law."""

    if TYPE_CHECKING:
        shells: int | str = AUTO

    _asked: int | str = PrivateAttr(AUTO)  # what the scene says, where `shells` is the number that was chosen
    _reach: float | None = PrivateAttr(None)  # and the distance in spacings behind which the next shell begins

    @model_validator(mode='after')
    def _checked(self):
        self._asked = self.shells
        self.check()
        return self

    def potential(self) -> PairLaw:
        """The law in mm, g and ms."""
        raise NotImplementedError

    def check(self) -> None:
        """Raise ValueError for numbers that give no law, or are too large or too small to compute with."""
        try:
            self.potential()
        except ValueError as error:
            given = ', '.join(f'law.{key} = {value!r}' for key, value in self if isinstance(value, float))
            raise ValueError(f': {error}' + f'; check units and exponents of {given}' * bool(given)) from None

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
    """Ring or disc magnetised along its axis."""

    outer_diameter_m: Length = Field(description='the outer diameter in m')
    inner_diameter_m: Annotated[NotNegative, within(0, 1e6, 'metres')] = Field(
        0.0, description='the inner diameter in m; 0 for a disc, a rod or any other magnet without a hole')
    height_m: Length = Field(description='the height in m, along the magnetisation')

    def magnet(self, remanence: float) -> Ring:
        return Ring(self.outer_diameter_m * u.m, self.inner_diameter_m * u.m, self.height_m * u.m, remanence)


class CuboidShape(Table):
    """Cuboid facing its neighbours squarely; its law neglects that the force is not quite central."""

    length_m: Length = Field(description='the length in m, towards the neighbour', examples=[0.005])
    width_m: Length = Field(description='the width in m', examples=[0.005])
    height_m: Length = Field(description='the height in m, along the magnetisation', examples=[0.003])

    def magnet(self, remanence: float) -> Cuboid:
        return Cuboid(self.length_m * u.m, self.width_m * u.m, self.height_m * u.m, remanence)


QUANTITIES = {'positive': Positive, 'length': Length, 'force': Force, 'pressure': Pressure,
              'ratio': Annotated[Positive, within(0, 0.5, 'shares of the longitudinal strain')]}
"""Which values the parameters of a law may have, as its card says."""


class CardLaw(PairLawTable):
    """A law whose keys are those of its card, `magphonon.interactions.law_cards`."""

    card: ClassVar[Kind]

    def potential(self) -> PairLaw:
        assert self.card.made is not None  # noqa: S101  `_of_card` is for those that have it
        return self.card.made(**{name: getattr(self, one.key) * one.unit for name, one in self.card.parameters.items()})


def _of_card(kind):
    keys = {one.key: (QUANTITIES[one.quantity], Field(description=one.words, examples=list(one.examples) or None))
            for one in kind.parameters.values()}
    table = create_model(kind.name, __base__=CardLaw, __doc__=kind.words, kind=(Literal[kind.name], ...), **keys,  # pyright: ignore
                         shells=(Shells, AUTO))
    table.card = kind
    return table


class TableLaw(PairLawTable):
    """Measured forces, as "magphonon fit" prints them."""

    kind: Literal['table']
    distances_m: Annotated[tuple[Length, ...], listed] = Field(
        description='the distances in m, increasing', examples=[[0.008, 0.01, 0.012, 0.015]])
    forces_N: Annotated[tuple[Force, ...], listed] = Field(
        description='the forces in N at distances_m', examples=[[0.66, 0.24, 0.10, 0.037]])
    shells: Shells = AUTO

    def potential(self) -> PairLaw:
        return Tabulated(np.array(self.distances_m) * u.m, np.array(self.forces_N) * u.N)


class MagnetsLaw(PairLawTable):
    """Uniform magnets, magnetised normal to the plane, by shape and remanence."""

    kind: Literal['magnets']
    ring: RingShape | None = None
    cuboid: CuboidShape | None = None
    grade: Grade | None = Field(None, description='the grade of the datasheet, which gives the remanence', examples=['N42'])
    remanence_T: Annotated[Positive, within(1e-6, 100, 'teslas')] | None = Field(
        None, description='the remanence in T, in place of a grade')
    shells: Shells = AUTO

    def check(self) -> None:
        if (self.ring is None) == (self.cuboid is None):
            raise ValueError(f' has {"no shape" if self.ring is None else "two shapes"}; give one of [law.ring], [law.cuboid]')
        if (self.grade is None) == (self.remanence_T is None):
            raise ValueError(f' has {"neither" if self.grade is None else "both"} of grade and remanence_T; give one of them')
        super().check()

    @property
    def remanence(self) -> float:
        """Remanence in N/(A mm)."""
        return self.remanence_T * u.T if self.grade is None else grade_remanence(self.grade)  # pyright: ignore[reportOptionalOperand]  one is given

    def magnet(self) -> Cuboid | Ring:
        """The magnet, a `Ring` or `Cuboid` in mm."""
        shape: Any = self.ring or self.cuboid
        return shape.magnet(self.remanence)

    def potential(self) -> PairLaw:
        return magnet_law(self.magnet())


class SavedLaw(Table):
    """The law, bonds and foundation of the calculator stored in the file of the lattice, as `write_scene` saves it."""

    shells: ClassVar = 'saved'
    asked: ClassVar = 'saved'

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
    _TABLES = (*(_of_card(kind) for kind in KINDS.values() if kind.made), TableLaw, MagnetsLaw, SavedLaw,
               MembersLaw)
    Law = Annotated[Union[_TABLES], Field(discriminator='kind'), of_known_kind(*_TABLES)]  # noqa: UP007  a number of them
