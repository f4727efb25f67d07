"""Readers of instrument files: one for each suffix, here or in another package.

A reader takes a path and returns a text, which is a table with a header; or columns by name, {'r [mm]': ..., 'f_N': ...}; or
datasets, a list of dicts with the keys of pyuff.  A package adds a reader by an entry point of the group `magphonon.readers`,
whose name is the suffix without its dot: `svd = "mylab.polytec:read"`.
"""

from __future__ import annotations

from importlib.metadata import entry_points
from os import PathLike
from pathlib import Path
from typing import Any

from . import array_files
from .errors import shown
from .files import refuse_endless
from .universal import read_datasets

MARKS = {b'\xff\xfe': 'utf-16', b'\xfe\xff': 'utf-16', b'\xef\xbb\xbf': 'utf-8-sig'}
REFUSED = {*map(chr, {*range(32)} - {*b'\t\n\r\f'}), '\ufffd'}  # characters that no table of text holds


def content(path: str | PathLike[str], most: int) -> str | list[dict[str, Any]]:
    """The contents of a file of at most `most` bytes: a text, which is a table with a header, or a list of datasets."""
    refuse_endless(path, most)
    suffix = Path(path).suffix.lower()
    others = (point.load() for point in entry_points(group='magphonon.readers', name=suffix[1:] or 'txt'))
    reader = READERS.get(suffix) or next(others, text)
    try:
        found = reader(path)
        return array_files.as_text(path, found) if isinstance(found, dict) else found
    except (PermissionError, MemoryError):
        raise
    except ImportError as error:
        raise ValueError(f"{path} is read by {error.name}; pip install 'magphonon[files]', or export it as CSV") from None
    except Exception as error:  # libraries fail on files of other kinds in many ways
        if str(error).startswith(str(path)):  # it says what to do
            raise
        raise ValueError(f'{path} is not a {suffix} file that can be read ({type(error).__name__}: {shown(str(error))}); export '
                         'it again, or as CSV') from None


def text(path: str | PathLike[str]) -> str:
    """The text of a file in UTF-8, UTF-16 or Windows-1252."""
    found = Path(path).read_bytes()
    try:
        words = found.decode(next((name for mark, name in MARKS.items() if found.startswith(mark)), 'utf-8'))
    except UnicodeDecodeError:
        words = found.decode('cp1252', 'replace')
    if REFUSED & set(words):
        raise ValueError(f'{path} is not a text file; export it as CSV, or as one of {", ".join(READERS)}')
    return words


def _workbook(path):
    """The one sheet that is not empty, as a text with tabs."""
    import openpyxl

    with open(path, 'rb') as file:
        sheets = [[['' if cell is None else ' '.join(str(cell).split()) for cell in row]
                   for row in sheet.iter_rows(values_only=True)] for sheet in openpyxl.load_workbook(
                       file, read_only=True, data_only=True).worksheets]
    filled = [rows for rows in sheets if any(map(any, rows))]
    if len(filled) != 1:
        raise ValueError(f'{path} has {len(filled)} sheets that are not empty; export the one with the measurement as CSV')
    return '\n'.join(map('\t'.join, filled[0]))


READERS = {
    **dict.fromkeys(('.uff', '.unv', '.uf', '.u58', '.bunv'), read_datasets),
    **dict.fromkeys(('.h5', '.hdf5', '.nc'), array_files.hdf5_file),
    **dict.fromkeys(('.xlsx', '.xlsm'), _workbook),
    '.npz': array_files.numpy_file, '.mat': array_files.matlab_file,
}
"""The reader of each suffix; files with other suffixes are read as texts."""
