"""Arrays by name in files of NumPy, MATLAB and HDF5, made into the text of a table."""

from __future__ import annotations

import csv
import io
import zipfile
from collections.abc import Mapping
from math import prod
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from .errors import shown
from .headers import Asked
from .quantities import TIME

TIMES = Asked({'time': TIME}, [], {})
MOST_NUMBERS = 10_000_000  # of all arrays of a file, which have 0.2 GB as text
UNITS = 'unit', 'units'  # attributes of arrays that tell their unit, in small letters


def _refuse_many(path, count):
    """Raise ValueError for arrays that would fill the memory, before they are unpacked: a file of 3 MB may hold 3 GB of zeros."""
    if count > MOST_NUMBERS:
        raise ValueError(f'{path} holds {count / 1e6:.3g} million numbers, more than the {MOST_NUMBERS / 1e6:g} million that are '
                         'read; export the columns of the measurement alone')


def numpy_file(path: str | PathLike[str]) -> dict[str, Any]:
    """The arrays of a .npz file."""
    with zipfile.ZipFile(path) as packed:
        _refuse_many(path, sum(one.file_size for one in packed.infolist()) // 8)
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
                         'or arrays (frames, points) with the times of the frames and the positions of the points')
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
