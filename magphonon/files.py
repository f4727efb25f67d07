"""Writing of files that appear only when complete: they are written under a temporary name and then renamed.

Files of users are read only if they are regular files of a limited size.
"""

from __future__ import annotations

import csv
import errno
import os
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from stat import S_ISREG
from typing import Any

import numpy as np

MEGABYTE = 2**20


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
        if error.errno != errno.ENOSPC or error.filename is not None:
            raise
        raise OSError(f'{path} cannot be written: no space left; make room or choose another place') from None


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
    partial = path.with_name(f'.{path.name}.{os.urandom(4).hex()}.partial')
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
