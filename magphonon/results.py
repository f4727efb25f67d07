"""How results are displayed: a summary in one line, or a table in a notebook, instead of all their numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from html import escape
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from .errors import shown
from .units import hertz


class Result:
    """A dataclass of arrays whose `repr` gives their shapes and ranges."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    _units: ClassVar[Mapping[str, tuple[str, ...]]] = {}  # of each field its unit and the names of its axes, where they are known

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if '__repr__' not in vars(cls):
            cls.__repr__ = Result.__repr__  # else that of the dataclass, with all numbers

    def _held(self) -> dict[str, str]:
        """What each field holds, in words."""
        values = {field.name: getattr(self, field.name) for field in fields(type(self))}
        return {name: _in_words(value, self._units.get(name, ('',))[0]) for name, value in values.items() if value is not None}

    def __repr__(self) -> str:
        return f'{type(self).__name__}({", ".join(f"{name}={words}" for name, words in self._held().items())})'

    def _repr_html_(self) -> str:
        rows = ''.join(f'<tr><td>{name}</td><td>{escape(words)}</td></tr>' for name, words in self._held().items())
        return f'<table><caption>{type(self).__name__}</caption>{rows}</table>'


def _in_words(value: Any, unit: str) -> str:
    if not isinstance(value, np.ndarray) or value.size < 2:
        return shown(value)
    found = f'<{" x ".join(map(str, value.shape))}'
    if value.dtype.kind == 'c':
        return f'{found}, complex{f", {unit}" if unit else ""}>'
    known = value[np.isfinite(value)] if value.dtype.kind in 'iuf' else value[:0]
    return f'{found}{f", {known.min():.4g} to {known.max():.4g} {unit}".rstrip() if known.size else ""}>'


class InHertz(Result):
    """Base class of results with angular frequencies `omega`; it adds the same frequencies in Hz."""

    omega: Any

    @property
    def frequencies_Hz(self) -> NDArray[np.float64]:
        """Frequencies in Hz, in the shape of `omega`."""
        return hertz(self.omega)
