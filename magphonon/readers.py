"""Readers of instrument files: one for each suffix, here or in another package.

A reader takes a path and returns the contents of the file in one of three forms, which `magphonon.tables` and the functions that
read records understand:

- a text: a table with a header, such as CSV;
- columns by name, a dict of arrays: {'r [mm]': ..., 'f_N': ...}; an array of two dimensions has a column for each point;
- datasets: a list of dicts with the keys of pyuff; type 58 holds records and functions, type 15 holds nodes.

A package adds a reader by an entry point of the group `magphonon.readers`, whose name is the suffix without its dot:

    [project.entry-points."magphonon.readers"]
    svd = "mylab.polytec:read"
"""

from __future__ import annotations

import re
from importlib import import_module
from importlib.metadata import entry_points
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .errors import shown
from .files import refuse_endless

GROUP = 'magphonon.readers'
BOMS = {b'\xff\xfe': 'utf-16', b'\xfe\xff': 'utf-16', b'\xef\xbb\xbf': 'utf-8-sig'}
CONTROL = set(map(chr, {*range(32)} - {*b'\t\n\r\f'}))  # characters that no table of text holds
UNITS = 'unit', 'units', 'unit_string'  # attributes of columns that tell their unit, in small letters


def content(path: str | PathLike[str], most: int) -> Any:
    """The contents of a file of at most `most` bytes: a text, columns by name, or datasets (see `magphonon.readers`).

    Examples
    --------
    >>> import tempfile
    >>> import numpy as np
    >>> from magphonon.readers import content
    >>> file = tempfile.mkdtemp() + '/force.npz'
    >>> np.savez(file, r_mm=[8.0, 9.0], f_N=[0.6, 0.4])
    >>> content(file, 10_000)['f_N'].tolist()
    [0.6, 0.4]
    """
    refuse_endless(path, most)
    suffix = Path(path).suffix.lower()
    reader = READERS.get(suffix)
    for point in entry_points(group=GROUP, name=suffix[1:]) if reader is None and suffix else ():
        reader = point.load()
    if reader is None:
        return text(path)
    try:
        return reader(path)
    except (OSError, MemoryError, Refused):
        raise
    except Exception as error:  # libraries fail on files of other kinds in many ways
        raise ValueError(f'{path} is not a {suffix} file that {reader.__module__.removeprefix("magphonon.")} can read '
                         f'({type(error).__name__}: {shown(str(error))}); export it again, or as CSV') from None


class Refused(ValueError):
    """A file was refused, and the message already says why."""


def text(path: str | PathLike[str]) -> str:
    """The text of a file in UTF-8, UTF-16 or Windows-1252."""
    found = Path(path).read_bytes()
    coding = next((name for mark, name in BOMS.items() if found.startswith(mark)), None)
    if coding is None and len(found) > 3 and found[1::2].count(0) > 0.9 * (len(found) // 2):
        coding = 'utf-16-le'  # without its mark
    for name in (coding,) if coding else ('utf-8', 'cp1252'):
        try:
            words = found.decode(name)
        except UnicodeDecodeError:
            continue
        if '\x00' not in words and (name.startswith('utf') or not CONTROL & set(words)):
            return words
        break
    known = ', '.join(READERS)
    raise Refused(f'{path} is not a text file; export it as CSV, or as one of {known}')


def _universal(path):
    pyuff = _library(path, 'pyuff')
    if len(re.findall(rb'(?m)^    -1 *\r?$', Path(path).read_bytes())) % 2:  # pyuff would leave the last dataset out
        raise Refused(f'{path} ends within a dataset; copy or export it again')
    sets = pyuff.UFF(str(path)).read_sets()
    return [sets] if isinstance(sets, dict) else list(sets)


def _arrays(path):
    with open(path, 'rb') as file:  # np.load leaves it open where it fails
        found = np.load(file, allow_pickle=False)
        if not isinstance(found, np.ndarray):
            return dict(found)
    if found.dtype.names is None:
        raise Refused(f'{path} holds an array without names; save columns by np.savez({shown(str(path))}, r_mm=..., f_N=...)')
    return _named(path, [('', found)])


def _named(path, columns):
    """Columns by name, from pairs of name and values; each field of a structured array becomes a column."""
    found = {}
    for name, values in columns:
        whole = np.asarray(values)
        for own, column in [(field, np.asarray(whole[field].tolist())) for field in whole.dtype.names or ()] or [(name, whole)]:
            if column.size > 1 and own in found and not np.array_equal(found[own], column):
                raise Refused(f'{path} holds {shown(own)} several times, with different numbers; put each group into a file of '
                              'its own, or all groups into the same columns')
            found[own] = column
    return found


def _matlab(path):
    try:
        found = import_module('scipy.io').loadmat(path, squeeze_me=True)
    except NotImplementedError:  # version 7.3, which is HDF5
        return _hdf5(path)
    return _named(path, ((name, values) for name, values in found.items() if not name.startswith('__')))


def _hdf5(path):
    columns = []

    def visit(name, node):
        if hasattr(node, 'shape') and np.dtype(node.dtype).kind in 'iufSUOV':
            values = node.asstr()[()] if np.dtype(node.dtype).kind in 'SO' else node[()]
            columns.append((_with_unit(name.rpartition('/')[2], node.attrs), values))

    with _library(path, 'h5py').File(path, 'r') as file:
        file.visititems(visit)
    return _named(path, columns)


def _workbook(path):
    """The first sheet that is not empty, as a text with tabs."""
    with open(path, 'rb') as file:
        for sheet in _library(path, 'openpyxl').load_workbook(file, read_only=True, data_only=True).worksheets:
            rows = [['' if cell is None else str(cell).replace('\t', ' ').replace('\n', ' ') for cell in row]
                    for row in sheet.iter_rows(values_only=True)]
            used = max((k + 1 for row in rows for k, cell in enumerate(row) if cell), default=0)
            if used:
                return '\n'.join('\t'.join(row[:used]) for row in rows)
    return ''


def _with_unit(name, attributes):
    """The name of a column, followed by the unit from its attributes unless the name already contains one."""
    unit = next((unit for key, unit in attributes.items() if key.lower() in UNITS), '')
    unit = unit.decode() if isinstance(unit, bytes) else str(unit)
    return f'{name} [{unit}]' if unit and '[' not in name else name


def _library(path, name):
    try:
        return import_module(name)
    except ImportError:
        raise Refused(f"{path} is read by {name}; install it with pip install 'magphonon[files]', or export the measurement as "
                      'CSV') from None


READERS = {
    **dict.fromkeys(('.uff', '.unv', '.uf', '.u58', '.bunv'), _universal),
    **dict.fromkeys(('.npz', '.npy'), _arrays),
    **dict.fromkeys(('.h5', '.hdf5', '.nc'), _hdf5),
    **dict.fromkeys(('.xlsx', '.xlsm'), _workbook),
    '.mat': _matlab,
}
"""The reader of each suffix; files with other suffixes are read as texts."""
