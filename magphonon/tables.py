"""What the tables of a scene file are made of: checked fields, and tables that know their keys.

A check says what is wrong with a value, from its name on; `magphonon.scenes` knows the tables that hold it and puts
the name in front.
"""

from difflib import get_close_matches
from functools import partial
from math import isfinite
from numbers import Real
from typing import Annotated

from pydantic import BaseModel, BeforeValidator, ConfigDict, model_validator

from .errors import not_negative, positive, whole

SPACINGS_m = 1e-6, 1e6
"""Sizes of a lattice: phonopy takes particles closer than 1e-5 mm for one, and writes ten decimals."""


def _text(value):
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f' must be text in quotes, not {value!r}')
    return value


def _list(value):
    if not isinstance(value, list):
        raise ValueError(f' must be a list in brackets, not {value!r}')
    return value


def _number(value):
    if not isinstance(value, Real) or isinstance(value, bool) or not isfinite(value):
        raise ValueError(f' must be a finite number, not {value!r}')
    return float(value)


def _point(value):
    if not isinstance(value, list) or len(value) != 2:
        raise ValueError(f' must be a place [x, y], not {value!r}')
    return tuple(map(_number, value))


def _spacing(value):
    spacing, (least, most) = positive('', value), SPACINGS_m
    if not least <= spacing <= most:
        raise ValueError(f' must lie between {least:g} and {most:g}, not {value!r}; it is in metres')
    return spacing


Positive = Annotated[float, BeforeValidator(partial(positive, ''))]
NotNegative = Annotated[float, BeforeValidator(partial(not_negative, ''))]
Count = Annotated[int, BeforeValidator(partial(whole, ''))]
Number = Annotated[float, BeforeValidator(_number)]
Point = Annotated[tuple[float, float], BeforeValidator(_point)]
AtLeastTwo = Annotated[int, BeforeValidator(partial(whole, '', least=2))]
Spacing = Annotated[float, BeforeValidator(_spacing)]
Text = Annotated[str, BeforeValidator(_text)]
Numbers = Annotated[tuple[Positive, ...], BeforeValidator(_list)]
Counts = Annotated[tuple[Count, ...], BeforeValidator(_list)]
Angles = Annotated[tuple[Number, ...], BeforeValidator(_list)]


class Table(BaseModel):
    """One table of a scene: its keys are the fields, no others, and it does not change once read."""

    model_config = ConfigDict(extra='forbid', frozen=True)

    @model_validator(mode='before')
    @classmethod
    def _keys(cls, table):
        if not isinstance(table, dict):
            raise ValueError(f' must be a table in brackets with the keys {", ".join(cls.model_fields)}, not {table!r}')
        for key in table:
            if key not in cls.model_fields:
                near = get_close_matches(key, cls.model_fields, 1)
                mend = f'did you mean {near[0]!r}?' if near else f'its keys are {", ".join(cls.model_fields)}'
                raise ValueError(f' has no key {key!r}; {mend}')
        for key, field in cls.model_fields.items():
            if field.is_required() and key not in table:
                raise ValueError(f' lacks the key {key!r}; add {field.description}')
        return table
