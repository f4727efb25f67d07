"""Checked fields for the tables of a scene file, and the base class of these tables.

The message of a check begins after the name of the field; `magphonon.scenes.scene` knows the name, such as law.a, and puts it in
front.
"""

from __future__ import annotations

from functools import partial
from typing import Annotated, Any, Self, get_args

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, ValidationError, model_validator
from pydantic.functional_validators import ModelWrapValidatorHandler
from pydantic_core import ErrorDetails, InitErrorDetails

from ..errors import did_you_mean, nearest, not_negative, number, positive, shown, whole

LONGEST_TEXT = 200
"""Largest number of characters of a text; a title is printed above a picture."""
LONGEST_LIST = 10_000
"""Largest number of entries of a list; a longer table of forces belongs in a file."""
UNITS = {'_N_m_a': 'N m^a', '_kg_per_m3': 'kg/m^3', '_N_per_m': 'N/m', '_A_m2': 'A m^2', '_J_m': 'J m', '_per_s': '1/s',
         '_percent': '%', '_Hz': 'Hz', '_kg': 'kg', '_Pa': 'Pa', '_deg': 'degrees', '_m': 'm', '_N': 'N', '_T': 'T', '_C': 'C',
         '_s': 's', '_px': 'pixels'}
"""Unit of a key by the end of its name, the longest ends first."""


def unit_of(key: str) -> str:
    """The unit at the end of a key, such as 'N/m' in foundation.stiffness_N_per_m; '' if there is none."""
    return next((unit for end, unit in UNITS.items() if key.endswith(end)), '')


def _text(value):
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f' must be text in quotes, not {shown(value)}')
    if len(value) > LONGEST_TEXT or not value.isprintable():
        raise ValueError(f' must be one line of at most {LONGEST_TEXT} printable characters, not {shown(value)}')
    return value


def _drawn(title):
    """A title that can be drawn: a formula between $ must be one that matplotlib understands."""
    if title.count('$') < 2:
        return title
    from matplotlib.mathtext import MathTextParser  # late: it takes half a second

    try:
        MathTextParser('path').parse(title)
    except ValueError as error:
        fault = str(error).splitlines()[-1].partition(': ')[2]  # behind the name of matplotlib's exception
        raise ValueError(f' holds a formula that cannot be drawn: {fault}; correct the text between the $, or write \\$ for a '
                         'dollar sign') from None
    return title


def _list(value):
    if not isinstance(value, list):
        raise ValueError(f' must be a list in brackets, not {shown(value)}')
    if len(value) > LONGEST_LIST:
        raise ValueError(f' must hold at most {LONGEST_LIST} numbers, not {len(value)}')
    return value


def _point(value):
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f' must be a place [x, y], not {shown(value)}')
    return tuple(between(-1e6, 1e6, 'metres', number(f'[{k}]', x)) for k, x in enumerate(value))


def _flag(value):
    if not isinstance(value, bool):
        raise ValueError(f' must be true or false, not {shown(value)}')
    return value


def between(least: float, most: float, unit: str, value: float) -> float:
    """Return `value`, or raise ValueError if it is so large or so small that its unit or exponent must be wrong."""
    if not least <= value <= most:
        raise ValueError(f' must lie between {least:g} and {most:g}, not {shown(value)}; it is in {unit}')
    return value


def within(least: float, most: float, unit: str) -> AfterValidator:
    """A validator for the annotation of a field: the number must lie in this range."""
    return AfterValidator(partial(between, least, most, unit))


listed = BeforeValidator(_list)
Positive = Annotated[float, BeforeValidator(partial(positive, ''))]
NotNegative = Annotated[float, BeforeValidator(partial(not_negative, ''))]
Count = Annotated[int, BeforeValidator(partial(whole, ''))]
Number = Annotated[float, BeforeValidator(partial(number, ''))]
Point = Annotated[tuple[float, float], BeforeValidator(_point)]
Points = Annotated[tuple[Point, ...], listed]
Flag = Annotated[bool, BeforeValidator(_flag)]
AtLeastTwo = Annotated[int, BeforeValidator(partial(whole, '', least=2)), within(2, 1e6, 'points')]
Text = Annotated[str, BeforeValidator(_text)]
Title = Annotated[Text, AfterValidator(_drawn)]
Counts = Annotated[tuple[Count, ...], listed]
# Beyond these ranges a unit or an exponent is wrong, and squares and powers soon leave the range of numbers.
Spacing = Annotated[Positive, within(1e-6, 1e6, 'metres')]  # phonopy takes particles closer than 1e-5 mm for one
Length = Annotated[Positive, within(1e-12, 1e6, 'metres')]
Mass = Annotated[Positive, within(1e-33, 1e9, 'kilograms')]
Frequency = Annotated[Positive, within(1e-9, 1e12, 'hertz')]
Frequencies = Annotated[tuple[Frequency, ...], listed]
Rate = Annotated[Positive, within(1e-9, 1e12, '1/s')]
Duration = Annotated[Positive, within(1e-12, 1e9, 'seconds')]
Pressure = Annotated[Positive, within(1e-3, 1e15, 'pascals')]
Force = Annotated[Positive, within(1e-30, 1e12, 'newtons')]
Angle = Annotated[Number, within(-360, 360, 'degrees')]
Angles = Annotated[tuple[Angle, ...], listed]


class Table(BaseModel):
    """One table of a scene: only its fields are allowed as keys, and it is read-only."""

    model_config = ConfigDict(extra='forbid', frozen=True, defer_build=True)

    @model_validator(mode='wrap')
    @classmethod
    def _every_fault(cls, table: Any, check: ModelWrapValidatorHandler[Self]) -> Self:
        if not isinstance(table, dict):
            raise ValueError(f' must be a table in brackets with the keys {", ".join(cls.model_fields)}, not {shown(table)}')
        unknown = [key for key in table if key not in cls.model_fields]
        keys = f'its keys are {", ".join(cls.model_fields)}'
        faults = [fault(table, ValueError(f' has no key {shown(key)}{did_you_mean(key, cls.model_fields, keys)}'))
                  for key in unknown]
        made: Any = None  # faults say why
        try:
            made = check({key: value for key, value in table.items() if key in cls.model_fields})
        except ValidationError as error:
            faults += cls._found(table, error, {nearest(key, cls.model_fields) for key in unknown})
        raise_all(faults)
        return made

    @classmethod
    def _found(cls, table, error, meant):
        """The faults that pydantic found, without those that follow from a key that was misspelt and `meant`."""
        for found in error.errors():
            if found['type'] == 'missing':
                if (key := str(found['loc'][0])) not in meant:
                    yield fault(table, ValueError(f' lacks the key {key!r}; add {cls.model_fields[key].description}'))
            elif found['loc'] or not any(meant):  # without a place it is about keys together
                yield fault(found['input'], reason(found), found['loc'])


def of_known_kind(*models: type[Table]) -> BeforeValidator:
    """A check that a table has one of the kinds of `models`."""
    of = {kind: model for model in models for kind in get_args(model.model_fields['kind'].annotation)}

    def check(table: Any) -> Any:
        kinds = ', '.join(map(repr, of))
        if not isinstance(table, dict):
            raise ValueError(f' must be a table in brackets with a kind, one of {kinds}, not {shown(table)}')
        given = table.get('kind')
        if given not in tuple(of):
            raise ValueError(f'.kind must be one of {kinds}, not {shown(given)}{did_you_mean(given, of)}' if 'kind' in table else
                             f" lacks the key 'kind'; add one of {kinds}")
        return table

    return BeforeValidator(check)


def reason(found: ErrorDetails) -> ValueError:
    """The ValueError of our own check behind an error reported by pydantic."""
    return found['ctx']['error']  # pyright: ignore[reportTypedDictNotRequiredAccess]  which has one therefore


def fault(value: object, error: ValueError, place: tuple[Any, ...] = ()) -> InitErrorDetails:
    """An error in the form that `raise_all` collects."""
    return InitErrorDetails(type='value_error', loc=place, input=value, ctx={'error': error})


def raise_all(faults: list[InitErrorDetails]) -> None:
    """Raise pydantic's ValidationError with all faults of one table, if there are any."""
    if faults:
        raise ValidationError.from_exception_data('scene', faults)
