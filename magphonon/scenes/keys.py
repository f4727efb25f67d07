"""Every key of a scene, read from the models that check it: type, unit, default, allowed values, meaning, an example."""

from __future__ import annotations

import json
import tomllib
import types
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic.fields import FieldInfo

from ..errors import did_you_mean, one_of
from .fields import Allowed, Table, between, unit_of
from .scene import Scene, ready_scenes

TYPES = {float: 'number', int: 'whole number', str: 'text', bool: 'true or false'}


@dataclass(frozen=True)
class Key:
    """One key of a table of a scene.

    Attributes
    ----------
    table : str
        Dotted name of its table, such as 'law.disc'; empty for the scene itself.
    kinds : tuple of str
        The kinds of the table that have this key; empty if all have it.
    name : str
    type : str
        Type of the value in words, such as 'list of numbers'.
    unit : str
        Unit of a number; empty for numbers without a unit and for other types.
    default : str
        'required', 'none' for a key that may be left out, or the default value; 'required; 1 for supercell' if the kinds of the
        table differ.
    allowed : str
        Range or choices, in words.
    description : str
    example : str
        A line of a scene, such as `a = 4.5824`; empty for a table.
    """

    table: str
    kinds: tuple[str, ...]
    name: str
    type: str
    unit: str
    default: str
    allowed: str
    description: str
    example: str

    @property
    def place(self) -> str:
        """Dotted name with the table, as in messages: 'law.a'."""
        return f'{self.table}.{self.name}' if self.table else self.name


def scene_keys(name: str | None = None) -> list[Key]:
    """The keys of a scene, table by table: all of them, those of one table and the tables in it, or all keys of one name.

    Parameters
    ----------
    name : str, optional
        Name of a table, such as 'law' or 'law.disc', or of a key, such as 'spacing_m' or 'lattice.spacing_m'.

    Examples
    --------
    >>> from magphonon.scenes import scene_keys
    >>> key = scene_keys('foundation.pillar')[1]
    >>> key.place, key.unit, key.default
    ('foundation.pillar.radius_m', 'm', 'required')
    """
    found = list(_keys_of('', (Scene,), _examples()))
    if name is None:
        return found
    tables = dict.fromkeys(key.table for key in found if key.table)
    if name in tables:
        return [key for key in found if f'{key.table}.'.startswith(f'{name}.')]
    named = [key for key in found if name in (key.name, key.place)]
    if not named:
        meant = did_you_mean(name, [*tables, *(key.name for key in found)], f'the tables are {", ".join(tables)}')
        raise ValueError(f'a scene has neither a table nor a key {name!r}{meant}')
    return named


def _keys_of(table: str, models: tuple[type[Table], ...], examples: dict[tuple[str, str, str], Any]) -> Iterator[Key]:
    """The keys of one table, which has one model for each of its kinds, then the keys of the tables in it."""
    fields: dict[str, list[tuple[tuple[str, ...], FieldInfo]]] = {}
    for model in models:
        for name, field in model.model_fields.items():
            fields.setdefault(name, []).append((_kinds(model), field))
    inner = []
    for name, alike in fields.items():
        tables = tuple(dict.fromkeys(part for _, field in alike for part in _tables(field.annotation)))
        kinds = tuple(kind for some, _ in alike for kind in some) if len(alike) < len(models) else ()
        key = _key(table, kinds, name, alike, tables, examples)
        yield replace(key, description='; '.join(map(_told, models))) if name == 'kind' and len(models) > 1 else key
        if tables:
            inner.append((f'{table}.{name}' if table else name, tables))
    for place, tables in inner:
        yield from _keys_of(place, tables, examples)


def _key(table: str, kinds: tuple[str, ...], name: str, alike: list[tuple[tuple[str, ...], FieldInfo]],
         tables: tuple[type[Table], ...], examples: dict[tuple[str, str, str], Any]) -> Key:
    fields = [field for _, field in alike]
    field, whole = fields[0], f'{table}.{name}' if table else name
    described = dict.fromkeys(field.description for field in fields if field.description)
    if tables:
        described = dict.fromkeys(filter(None, map(_told, tables)))
    allowed = [dict.fromkeys(_allowed([field.annotation, *field.metadata])) for field in fields]
    kind = kinds[0] if kinds else ''
    similar = table, table.partition('.')[2]  # a law in [[laws_of_kinds]] is like [law]
    found = [examples.get((place, of, name)) for place in similar for of in (kind, '')] + list(field.examples or ())
    value = next((one for one in found if one is not None), None)
    example = f'{name} = {_toml(value)}' if value is not None and not tables else ''
    unit = unit_of(name) if not tables else ''
    several = any(get_origin(part) is tuple for part in (field.annotation, *get_args(field.annotation)))
    of_tables = f'tables [[{whole}]]' if several else f'table [{whole}]'
    written = of_tables if tables else ' or '.join(dict.fromkeys(_types(field.annotation)))
    either = ', ' if name == 'kind' else '; or '  # the choices of one table, or what its kinds ask for
    ranges = either.join(dict.fromkeys(', '.join(words) for words in allowed if words))
    return Key(table, kinds, name, written, unit, _default(alike), ranges, '; or '.join(described), example)


def _default(alike: list[tuple[tuple[str, ...], FieldInfo]]) -> str:
    kinds: dict[str, list[str]] = {}
    for some, field in alike:
        word = 'required' if field.is_required() else 'none' if field.default is None else _toml(field.default)
        kinds.setdefault(word, []).extend(some)
    first, *others = kinds
    return '; '.join([first, *(f'{word} for {" or ".join(kinds[word])}' for word in others)])


def _told(model: type[Table]) -> str:
    """The description of a table: its kinds, and the first line of the docstring of its model."""
    first = (model.__doc__ or '').strip().partition('\n')[0].rstrip('.')  # python -OO leaves out docstrings
    return f'{" or ".join(_kinds(model))}: {first}' if first and _kinds(model) else first


def _kinds(model: type[Table]) -> tuple[str, ...]:
    kind = model.model_fields.get('kind')
    return tuple(get_args(kind.annotation)) if kind is not None and get_origin(kind.annotation) is Literal else ()


def _tables(annotation: Any) -> Iterator[type[Table]]:
    if isinstance(annotation, type) and issubclass(annotation, Table):
        yield annotation
    for part in get_args(annotation) if get_origin(annotation) in (Annotated, Union, types.UnionType, tuple) else ():
        yield from _tables(part)


def _types(annotation: Any) -> Iterator[str]:
    origin, parts = get_origin(annotation), get_args(annotation)
    if origin is Literal:
        yield 'text'
    elif origin is tuple:
        yield (f'list of {next(_types(parts[0]))}s'.replace(']s', ']').replace('of place', 'of places') if parts[-1] is Ellipsis
               else 'two whole numbers' if parts == (int, int) else 'nodes [i, j]' if parts[:2] == (int, int) else 'place [x, y]')
    elif annotation in TYPES:
        yield TYPES[annotation]
    elif origin in (Annotated, Union, types.UnionType):
        for part in parts if origin is not Annotated else parts[:1]:
            yield from _types(part)


def _allowed(parts: Any) -> Iterator[str]:
    """Range and choices found in annotations and their checks, in words; a range replaces the word 'positive'."""
    ranged = any(_is_range(part) for part in parts)
    for part in parts:
        if ranged and not _is_range(part):
            continue
        if isinstance(part, Allowed):
            yield str(part)
        elif get_origin(part) is Literal:
            yield ', '.join(map(_toml, get_args(part)))
        elif _is_range(part):
            yield f'{part.func.args[0]:g} to {part.func.args[1]:g}'
        elif isinstance(check := getattr(part, 'func', None), partial) and check.func is one_of:
            yield ', '.join(map(_toml, check.keywords['choices']))
        elif not (isinstance(part, type) and issubclass(part, Table)):
            yield from _allowed(get_args(part))


def _is_range(part: Any) -> bool:
    check = getattr(part, 'func', None)
    return isinstance(check, partial) and check.func is between


def _toml(value: Any) -> str:
    if isinstance(value, list | tuple):
        shown = [_toml(entry) for entry in value]
        return f'[{", ".join(shown[:4])}{", ..." * (len(shown) > 4)}]'
    return json.dumps(value, ensure_ascii=False) if isinstance(value, str | bool) else f'{value:.12g}'


def _examples() -> dict[tuple[str, str, str], Any]:
    """Example values of keys from the ready scenes, by table, kind of the table ('' for any) and name; the prototype's value is
    preferred, else the first one.
    """
    found: dict[tuple[str, str, str], Any] = {}

    def visit(place: str, table: dict[str, Any]) -> None:
        for name, value in table.items():
            if isinstance(value, dict):
                visit(f'{place}.{name}' if place else name, value)
            else:
                for kind in (str(table.get('kind', '')), ''):
                    found.setdefault((place, kind, name), value)

    ready = ready_scenes()
    for file in dict.fromkeys([ready['prototype'], *ready.values()]):
        visit('', tomllib.loads(file.read_text(encoding='utf-8')))
    return found
