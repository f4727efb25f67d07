"""Reading of text files written by users: of limited size, with or without a byte order mark, and from regular files only."""

from __future__ import annotations

import csv
import errno
import os
from contextlib import contextmanager
from pathlib import Path
from stat import S_ISREG
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

MEGABYTE = 2**20


def text_of(path: str | PathLike[str], most: int) -> str:
    """The text of a file in UTF-8.

    Parameters
    ----------
    path : path-like
    most : int
        Largest number of bytes; a larger file is refused.

    Raises
    ------
    OSError
        If there is no such file, or it cannot be read.
    ValueError
        If it is not a regular file (a pipe or a device may never end), is too large, or is not text in UTF-8.
    """
    refuse_endless(path, most)
    return Path(path).read_text(encoding='utf-8-sig')


@contextmanager
def told_as_table(path: str | PathLike[str]) -> Iterator[None]:
    """Within it a file that is no table of text is refused with a hint how to save it."""
    try:
        yield
    except UnicodeDecodeError:
        raise ValueError(f'{path} is not a text file; export it as CSV') from None
    except csv.Error as error:
        raise ValueError(f'{path} is no table of text ({error}); export it as CSV') from error


def table_text(path: str | PathLike[str], most: int) -> str:
    """The text of a table as by `text_of`; the error for a file that is not text says how to save it."""
    with told_as_table(path):
        return text_of(path, most)


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
