"""The journal of a sweep: every answer is appended and on the disk before it counts, so that a killed sweep loses none.

The first line says to which sweep it belongs; each further line holds one answer.  A line that was cut off when the process or
the machine died is removed when the journal is opened again.
"""

from __future__ import annotations

import json
import os
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from ..files import lock, room_for
from .evaluation import Answer

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator
    from os import PathLike
    from typing import Any, BinaryIO


@dataclass
class Journal:
    """An open journal.

    Attributes
    ----------
    path : pathlib.Path
    known : dict of int to Answer
        The answers that it held when it was opened, by the number of the point.
    """

    path: Path
    known: dict[int, Answer]
    _file: BinaryIO

    def append(self, answers: Iterable[tuple[int, Answer]]) -> None:
        """Add answers; when this returns they are on the disk.

        Raises
        ------
        OSError
            If the disk is full.
        """
        lines = ''.join(json.dumps([k, found.values, found.fault]) + '\n' for k, found in answers)
        with room_for(self.path):
            self._file.write(lines.encode())
            self._file.flush()
            os.fsync(self._file.fileno())


@contextmanager
def journal(path: str | PathLike[str], fingerprint: str, points: int) -> Iterator[Journal]:
    """Open the journal of a sweep, or begin it.

    Parameters
    ----------
    path : path-like
    fingerprint : str
        Of the sweep, from `fingerprint_of`.
    points : int

    Raises
    ------
    ValueError
        If the file is the journal of another sweep or none, or another process writes to it.
    """
    path = Path(path)
    try:
        file = open(path, 'r+b' if path.exists() else 'x+b')  # noqa: SIM115  closed below
    except OSError as error:
        raise type(error)(f'{path} cannot be written ({error.strerror}); choose another place for the journal') from None
    with file:
        if not lock(file) and _locks(path):
            raise ValueError(f'{path} is written by another sweep; wait until that ends, or choose another place')
        known, end = _read(path, file.read(), {'sweep': fingerprint, 'points': points})
        file.truncate(end)
        file.seek(end)
        opened = Journal(path, known, file)
        if not end:
            file.write(json.dumps({'sweep': fingerprint, 'points': points}).encode() + b'\n')
            opened.append(())
            _sync_directory(path.parent)
        yield opened


def fingerprint_of(parts: Any) -> str:
    """A checksum of everything that answers depend on, given in plain Python."""
    return sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()


def _read(path, text, head):
    """The answers in a journal, and the length of what is whole."""
    end = text.rfind(b'\n') + 1
    if not end and not json.dumps(head).encode().startswith(text):
        raise ValueError(f'{path} is no journal of a sweep; name another place for it')
    known = {}
    for number, line in enumerate(text[:end].splitlines(), 1):
        try:
            found = json.loads(line)
            if number > 1:
                k, values, fault = found
                known[k] = Answer(values, fault)
        except ValueError:
            raise ValueError(f'{path} is damaged in line {number}; remove it, and the sweep begins anew') from None
        if number == 1 and found != head:
            raise ValueError(f'{path} is the journal of another sweep: of another scene, other axes or questions, or by another '
                             'version; name another place, or remove it')
    return known, end


def _locks(path):
    """Whether the file system knows locks at all, tried on the directory."""
    try:
        handle = os.open(path.parent, os.O_RDONLY)
    except OSError:
        return False
    try:
        return lock(handle)
    finally:
        os.close(handle)


def _sync_directory(folder):
    """A new file is only safe when its name is on the disk as well."""
    if os.name != 'posix':
        return
    handle = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
