"""Readers of instrument files: one for each suffix, here, in `universal` or in another package.

A reader takes a path and returns a text, which is a table with a header; or columns by name, {'r [mm]': ..., 'f_N': ...}; or
datasets, a list of dicts with the keys of pyuff.  A package adds a reader by an entry point of the group `magphonon.readers`,
whose name is the suffix without its dot: `svd = "mylab.polytec:read"`.
"""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Mapping
from importlib.metadata import entry_points
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .errors import shown
from .files import refuse_endless
from .headers import Asked
from .quantities import TIME
from .universal import read_datasets

MARKS = {b'\xff\xfe': 'utf-16', b'\xfe\xff': 'utf-16', b'\xef\xbb\xbf': 'utf-8-sig'}
REFUSED = {*map(chr, {*range(32)} - {*b'\t\n\r\f'}), '\ufffd'}  # characters that no table of text holds
TIMES = Asked({'time': TIME}, [], {})
MOST_NUMBERS = 10_000_000  # of all arrays of a file, which have 0.2 GB as text
UNITS = 'unit', 'units'  # attributes of arrays that tell their unit, in small letters


def content(path: str | PathLike[str], most: int) -> str | list[dict[str, Any]]:
    """The contents of a file of at most `most` bytes: a text, which is a table with a header, or a list of datasets."""
    refuse_endless(path, most)
    suffix = Path(path).suffix.lower()
    others = (point.load() for point in entry_points(group='magphonon.readers', name=suffix[1:] or 'txt'))
    reader = READERS.get(suffix) or next(others, text)
    try:
        found = reader(path)
        return as_text(path, found) if isinstance(found, dict) else found
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

    _refuse_packed(path)
    with open(path, 'rb') as file:
        sheets = [[['' if cell is None else ' '.join(str(cell).split()) for cell in row]
                   for row in sheet.iter_rows(values_only=True)] for sheet in openpyxl.load_workbook(
                       file, read_only=True, data_only=True).worksheets]
    filled = [rows for rows in sheets if any(map(any, rows))]
    if len(filled) != 1:
        raise ValueError(f'{path} has {len(filled)} sheets that are not empty; export the one with the measurement as CSV')
    return '\n'.join(map('\t'.join, filled[0]))


def _refuse_many(path, count):
    """Raise ValueError for arrays that would fill the memory, before they are unpacked: a file of 3 MB may hold 3 GB of zeros."""
    if count > MOST_NUMBERS:
        raise ValueError(f'{path} holds {count / 1e6:.3g} million numbers, more than the {MOST_NUMBERS / 1e6:g} million that are '
                         'read; export the columns of the measurement alone')


def _refuse_packed(path):
    """Raise ValueError for a file of packed members that are too large, at 8 bytes a number."""
    with zipfile.ZipFile(path) as packed:
        _refuse_many(path, sum(one.file_size for one in packed.infolist()) // 8)


def numpy_file(path: str | PathLike[str]) -> dict[str, Any]:
    """The arrays of a .npz file."""
    _refuse_packed(path)
    with open(path, 'rb') as file:  # np.load leaves it open where it fails
        return dict(np.load(file, allow_pickle=False).items())


def matlab_file(path: str | PathLike[str]) -> dict[str, Any]:
    """The variables of a .mat file; the fields of a structure are columns."""
    from scipy.io import loadmat, whosmat

    try:
        _refuse_many(path, sum(prod(shape) for _, shape, _ in whosmat(path)))
        found = loadmat(path, squeeze_me=True)
    except NotImplementedError:  # version 7.3, which is HDF5
        return hdf5_file(path)
    return _columns(path, ((name, values) for name, values in found.items() if not name.startswith('__')))


def hdf5_file(path: str | PathLike[str]) -> dict[str, Any]:
    """The arrays in all groups of an HDF5 file, each with the unit that its attribute tells."""
    import h5py

    found = []

    def visit(name, node):
        if isinstance(node, h5py.Dataset) and node.dtype.kind in 'iufSUOV':
            _refuse_many(path, node.size)
            unit = next((unit for key, unit in node.attrs.items() if key.lower() in UNITS), '')
            values = node.asstr()[()] if node.dtype.kind in 'SO' else node[()]
            found.append((f'{Path(name).name} [{unit}]' if unit else Path(name).name, values))

    with h5py.File(path, 'r') as file:
        file.visititems(visit)
    return _columns(path, found)


def _columns(path, named):
    """Arrays by name, from pairs of name and values; each field of a structured array becomes a column."""
    found = {}
    for name, values in named:
        whole = np.squeeze(values)
        for own, column in [(field, np.array(whole[field].tolist())) for field in whole.dtype.names or ()] or [(name, whole)]:
            if own in found and column.ndim and not np.array_equal(found[own], column):
                raise ValueError(f'{path} holds {shown(own)} several times, with different numbers; put each group into a file '
                                 'of its own, or all groups into the same columns')
            found[own] = column
    return found


def as_text(path: Any, arrays: Mapping[str, Any]) -> str:
    """Arrays of one length as the text of a table, to the last digit, without single numbers.

    Arrays over frames and points are written one frame after the other, with the times of the frames and what is known of the
    points; points of which nothing is known are numbered.
    """
    columns = {str(name): np.squeeze(values) for name, values in arrays.items() if np.size(values) > 1}
    columns = _long(columns)
    shapes = {values.shape for values in columns.values()}
    if len(shapes) > 1 or any(len(shape) > 1 for shape in shapes):
        raise ValueError(f'{path} holds arrays of the shapes {", ".join(map(str, sorted(shapes)))}; give columns of one length, '
                         'or arrays (frames, points), not square, with the times of the frames and the positions of the points')
    out = io.StringIO()
    csv.writer(out).writerows([[*columns], *zip(*(_listed(path, *one) for one in columns.items()), strict=True)])
    return out.getvalue()


def _listed(path, name, values):
    """The entries of a column, whole numbers without a decimal point, as the numbers of points are."""
    if values.dtype.kind not in 'iufbSUO':
        raise ValueError(f'{path}: {name} holds no real numbers (its type is {values.dtype})')
    whole = values.dtype.kind in 'bf' and (abs(values) < 2**53).all() and (values == np.round(values)).all()
    return (values.astype(int) if whole else values).tolist()


def _long(columns):
    """Arrays over frames and points as columns of one length; unchanged if it is not certain which axis is which."""
    times = [len(values) for name, values in columns.items() if TIMES.heading(name).unit]
    points = {length for values in columns.values() for length in values.shape}.difference(times)
    if len(times) != 1 or len(points) != 1:
        return columns
    shape = *times, *points
    long = {name: np.broadcast_to(values[:, None] if values.shape == shape[:1] else
                                  values.T if values.shape == shape[::-1] else values, shape).ravel()
            for name, values in columns.items()}
    numbered = all(values.shape != shape[1:] for values in columns.values())
    return long | ({'point': np.tile(np.arange(1, shape[1] + 1), shape[0])} if numbered else {})


READERS = {
    **dict.fromkeys(('.uff', '.unv', '.uf', '.u58', '.bunv'), read_datasets),
    **dict.fromkeys(('.h5', '.hdf5', '.nc'), hdf5_file),
    **dict.fromkeys(('.xlsx', '.xlsm'), _workbook),
    '.npz': numpy_file, '.mat': matlab_file,
}
"""The reader of each suffix; files with other suffixes are read as texts."""
