"""How results are displayed and kept: a summary in one line, files of arrays with their units."""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import fields
from os import PathLike
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from .errors import shown
from .files import refuse_overflow, whole_file
from .units import hertz


class Result:
    """A dataclass of arrays whose `repr` gives their shapes and ranges."""

    __dataclass_fields__: ClassVar[dict[str, Any]]
    _units: ClassVar[Mapping[str, tuple[str, ...]]] = {}  # of each field its unit and the names of its axes, where they are known

    def __init_subclass__(cls, **options: Any) -> None:
        super().__init_subclass__(**options)
        if '__repr__' not in vars(cls):
            cls.__repr__ = Result.__repr__  # else that of the dataclass, with all numbers

    def __repr__(self) -> str:
        values = {field.name: getattr(self, field.name) for field in fields(type(self))}
        held = (f'{name}={_in_words(value, self._units.get(name, ("",))[0])}'
                for name, value in values.items() if value is not None)
        return f'{type(self).__name__}({", ".join(held)})'


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


def _told(names, units):
    return {name: {'unit': units[name][0], 'axes': [*units[name][1:]]} for name in names}


def saved_arrays(path: str | PathLike[str], kind: str, units: Mapping[str, tuple[str, ...]]) -> dict[str, Any]:
    """The arrays of a file that `Saved.save` wrote; ValueError, with the `kind` of file, if it is cut or has other arrays."""
    try:
        with open(path, 'rb') as file, np.load(file) as data:  # numpy leaves a truncated file that it opened itself open
            if any(member.compress_type for member in data.zip.infolist()):
                raise ValueError('save() does not pack, and a small file of packed arrays might fill the memory')
            arrays = dict(data)
        if 'units' not in arrays:
            raise ValueError('it lacks units, as files before 0.4; numpy.load reads it')
        if json.loads(str(arrays.pop('units'))) != _told(arrays, units):
            raise ValueError('its arrays are others, or in other units')
    except FileNotFoundError:
        raise FileNotFoundError(f'there is no file {path}; compute {kind} and save() them there') from None
    except Exception as error:
        raise ValueError(f'{path} is not a complete file of {kind} ({error}); compute them again and save()') from error
    return arrays


class Saved(Result):
    """A frozen dataclass of arrays, numbers and tuples of names that can be kept in a file.

    Parameters
    ----------
    kind : str
        What a file holds, for error messages: `class Spectrum(Saved, kind='spectra')`.
    units : dict of str to tuple of str
        For each field its unit ('' if it has none) and the names of its axes; '...' means any number of further axes.
    missing : tuple of str
        Fields in which NaN means that there is no value.  NaN in other fields and infinity in any field are errors.
    """

    _kind: ClassVar[str]
    _missing: ClassVar[Collection[str]]

    def __init_subclass__(cls, kind, units, missing=(), **options):
        super().__init_subclass__(**options)
        cls._kind, cls._units, cls._missing = kind, units, missing

    def save(self, path: str | PathLike[str]) -> None:
        """Write to a .npz file, whole or not at all; its entry `units` holds the unit and axes of each array, in JSON."""
        arrays = self._arrays()
        refuse_overflow(path, arrays, self._missing)
        with whole_file(path, 'wb') as file:
            np.savez(file, units=json.dumps(_told(arrays, self._units)), **arrays)

    def _arrays(self) -> dict[str, Any]:
        """The fields that are saved, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(type(self))}
        return {name: value for name, value in values.items() if value is not None}

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a result from the file that `save` wrote."""
        data = saved_arrays(path, cls._kind, cls._units)
        return cls(**{field.name: _restored(data[field.name], field.type) for field in fields(cls) if field.name in data})


def _restored(array, kind):
    """The number or tuple that numpy saved as an array, or the array itself."""
    if array.ndim == 0:
        return array.item()
    return tuple(array.tolist()) if 'tuple' in str(kind) else array
