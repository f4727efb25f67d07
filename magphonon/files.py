"""Writing of files that appear only when complete: they are written under a temporary name and then renamed.

Files of users are read only if they are regular files of a limited size.
"""

from __future__ import annotations

import csv
import errno
import json
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import fields
from os import PathLike
from pathlib import Path
from secrets import token_hex
from stat import S_ISREG
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np

from .results import Result

if TYPE_CHECKING:
    from xarray import Dataset

MEGABYTE = 2**20


def text_of(path: str | PathLike[str], most: int) -> str:
    """The text of a file in UTF-8; ValueError if it has more than `most` bytes, or is a pipe or a device."""
    refuse_endless(path, most)
    return Path(path).read_text(encoding='utf-8-sig')


def refuse_endless(path: str | PathLike[str], most: int) -> None:
    """Raise ValueError for a pipe or a device, and for a file of more than `most` bytes."""
    if not str(path):
        raise ValueError("'' names no file")
    if '\0' in str(path):
        raise ValueError(f'{str(path)!r} is not a valid file name, because it contains the character 0')
    found = os.stat(path)
    if os.path.isdir(path):
        raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR), str(path))
    if not S_ISREG(found.st_mode):
        raise ValueError(f'{path} is a pipe or a device and may never end; save it as a file first')
    if found.st_size > most:
        raise ValueError(f'{path} has {found.st_size / MEGABYTE:.3g} MB, more than the {most / MEGABYTE:g} MB that are read; '
                         'it is probably another file')


@contextmanager
def room_for(path: str | PathLike[str]) -> Iterator[None]:
    """If the disk is full while a file is written, raise an OSError that names the file and says what to do."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise OSError(errno.ENOSPC, 'no space left; make room or choose another place', str(path)) from None


@contextmanager
def whole_file(path: str | PathLike[str], mode: str = 'w') -> Iterator[Any]:
    """Open `path` for writing so that it appears, or replaces what is there, only when it is complete.

    The incomplete file is `.NAME.XXXXXXXX.partial` in the same directory.  Only a process that is killed leaves it.

    Raises
    ------
    OSError
        If the directory does not exist or cannot be written, or the disk is full; no incomplete file remains.
    """
    path = Path(path)
    partial = path.with_name(f'.{path.name}.{token_hex(4)}.partial')
    try:
        out = open(partial, mode.replace('w', 'x'))  # noqa: SIM115, who writes it closes it
    except OSError as error:
        raise type(error)(f'{path} cannot be written ({error.strerror}); choose another place') from None
    try:
        with room_for(path):
            with out as file:
                yield file
                file.flush()
                os.fsync(file.fileno())
            os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)


def refuse_overflow(path: str | PathLike[str], arrays: Mapping[str, Any], missing: Collection[str] = ()) -> None:
    """Raise FloatingPointError if results hold NaN or infinity, which must not be written as results.

    In arrays named in `missing` NaN means that there is no value, such as a group velocity at Gamma.
    """
    for name, values in arrays.items():
        values = np.asarray(values)
        if not np.issubdtype(values.dtype, np.inexact):
            continue
        wrong = np.isinf(values) if name in missing else ~np.isfinite(values)
        if wrong.any():
            raise FloatingPointError(f'{name} would be {values[wrong].flat[0]} in {wrong.sum()} of {values.size} entries of '
                                     f'{Path(path).name}, so it is not written: numbers became too large or too small')


def write_columns(path: str | PathLike[str], names: Sequence[str], columns: Sequence[Any], missing: Collection[str] = ()) -> None:
    """Write columns of numbers, or of words, to a CSV file with their names in its first line, whole or not at all.

    NaN and infinity raise FloatingPointError; only the columns named in `missing` may hold NaN (see `refuse_overflow`).
    """
    refuse_overflow(path, dict(zip(names, columns, strict=True)), missing)
    with whole_file(path) as file:
        if any(np.asarray(column).dtype.kind in 'US' for column in columns):
            rows = zip(*(np.asarray(column).tolist() for column in columns), strict=True)
            csv.writer(file, lineterminator='\n').writerows([names, *rows])
            return
        np.savetxt(file, np.transpose(columns), fmt='%.15g', delimiter=',', header=','.join(names), comments='')


def save_arrays(path: str | PathLike[str], arrays: Mapping[str, Any], units: Mapping[str, tuple[str, ...]],
                missing: Collection[str] = ()) -> None:
    """Write arrays to a .npz file, whole or not at all.

    `units` gives the unit of each array and the names of its axes, and is saved as JSON in the entry `units`.  In the arrays
    named in `missing`, NaN means that there is no value.
    """
    refuse_overflow(path, arrays, missing)
    told = json.dumps({name: {'unit': units[name][0], 'axes': units[name][1:]} for name in arrays})
    with whole_file(path, 'wb') as file:
        np.savez(file, units=told, **arrays)


def saved_arrays(path: str | PathLike[str], kind: str, units: Mapping[str, tuple[str, ...]], missing: Collection[str] = (),
                 optional: Collection[str] = ()) -> dict[str, Any]:
    """The arrays of a .npz file that `save_arrays` wrote; those in `optional` may be absent. Errors name the `kind` of file."""
    try:
        with open(path, 'rb') as file, np.load(file) as data:  # numpy leaves a truncated file that it opened itself open
            if any(member.compress_type for member in data.zip.infolist()):  # a small file might fill the memory
                raise ValueError('save() does not compress')
            arrays = dict(data)
            told = json.loads(str(arrays.pop('units', 'null')))
    except FileNotFoundError:
        raise FileNotFoundError(f'there is no file {path}; compute {kind} and save() them there') from None
    except Exception as error:
        raise not_saved(path, kind, 'it cannot be read') from error
    if told is not None and not isinstance(told, dict):
        raise not_saved(path, kind, 'its units are missing')
    needed = {*units} - {*optional} | {*(told or ())}
    for name in sorted(needed - arrays.keys()):
        raise not_saved(path, kind, f'it lacks the array {name}')
    arrays = {name: arrays[name] for name in units if name in arrays}
    fault = _wrong_unit(told, units, arrays) or _wrong_shape(units, arrays) or _wrong_number(units, arrays, missing)
    if fault:
        raise not_saved(path, kind, fault)
    return arrays


def not_saved(path: str | PathLike[str], kind: str, fault: str) -> ValueError:
    """The error for a file that does not hold results of this `kind`."""
    return ValueError(f'{path} is not a complete file of {kind} ({fault}); compute them again and save()')


def _wrong_unit(told, units, arrays):
    for name in arrays if told is not None else ():  # files of earlier versions hold no units
        entry = told.get(name)
        unit = entry.get('unit') if isinstance(entry, dict) else None
        if unit != units[name][0]:
            return f'the unit of {name} is {units[name][0]!r}, and not {unit!r}'
    return None


def _wrong_shape(units, arrays):
    lengths = {}
    for name, array in arrays.items():
        axes = units[name][1:]
        if array.ndim != len(axes) and not ('...' in axes and array.ndim >= len(axes) - 1):
            return f'{name} has {array.ndim} axes'
        for axis, length in zip(axes, array.shape, strict=False):
            if axis == '...':  # the remaining axes are not checked
                break
            first, known = lengths.setdefault(axis, (name, length))
            if known != length and axis not in ('dim', 'vectors'):  # 2 or 3, in a file of a lattice in the plane
                return f'{first} is for {known} {axis}, but {name} for {length}'
    return None


def _wrong_number(units, arrays, missing):
    for name, array in arrays.items():
        if units[name][0] and array.dtype.kind not in 'iufc':
            return f'{name} holds no numbers'
        if array.dtype.kind in 'fc' and (np.isinf(array) if name in missing else ~np.isfinite(array)).any():
            return f'{name} holds NaN or infinity'
    return None


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
        save_arrays(path, self._arrays(), self._units, self._missing)

    def _arrays(self) -> dict[str, Any]:
        """The fields that are saved, by name."""
        values = {field.name: getattr(self, field.name) for field in fields(type(self))}
        return {name: value for name, value in values.items() if value is not None}

    def to_xarray(self) -> Dataset:
        """Convert to an `xarray.Dataset`: each array has its unit in `attrs`, and the axes that `save` names.

        If a one-dimensional array lies along an axis, as `omega` along the frequencies, its name and values label that axis.

        Examples
        --------
        >>> import numpy as np
        >>> from magphonon.dynamics import Motion
        >>> motion = Motion(np.arange(5.0), np.array([3, 4]), np.zeros((5, 2, 2)))
        >>> motion.to_xarray().displacements.sel(times=2.0, particles=4).values
        array([0., 0.])
        """
        from xarray import Dataset

        lengths, called, arrays = {}, {}, {name: np.asarray(value) for name, value in self._arrays().items()}
        for name, array in arrays.items():
            axes = self._units[name][1:]
            if len(axes) == 1 and array.ndim == 1:
                called.setdefault(axes[0], name)
        found = {}
        for name, array in arrays.items():
            unit, *axes = self._units[name]
            if '...' in axes:
                axes = [*axes[:-1], *(f'{name}_{k}' for k in range(len(axes) - 1, array.ndim))]
            axes = [called.get(axis, f'{axis}_axis' if axis in self._units else axis) for axis in axes]
            for k, length in enumerate(array.shape):
                if axes[k] in axes[:k]:  # a matrix
                    axes[k] = f'{axes[k]}_again'
                if lengths.setdefault(axes[k], length) != length:  # two or three components
                    axes[k] = f'{axes[k]}_{length}'
            found[name] = (axes, array, {'units': unit} if unit else {})
        hertz = {'frequencies_Hz': (found['omega'][0], self.frequencies_Hz, {'units': 'Hz'})} if 'omega' in found else {}  # pyright: ignore[reportAttributeAccessIssue]  what has an omega is InHertz
        return Dataset(found, hertz)

    @classmethod
    def load(cls, path: str | PathLike[str]) -> Self:
        """Read a result from the file that `save` wrote."""
        optional = [field.name for field in fields(cls) if field.default is None]
        data = saved_arrays(path, cls._kind, cls._units, cls._missing, optional)
        return cls(**{field.name: _restored(data[field.name], field.type) for field in fields(cls) if field.name in data})


def _restored(array, kind):
    """The number or tuple that numpy saved as an array, or the array itself."""
    if array.ndim == 0:
        return array.item()
    return tuple(array.tolist()) if 'tuple' in str(kind) else array
