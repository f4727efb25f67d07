"""Writing files whole: under a temporary name first, renamed when complete."""

import errno
import os
import shutil
import tempfile
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

import numpy as np


@contextmanager
def room_for(path):
    """Where the disk turns out to be full: raise OSError with the name of the file and what to do."""
    try:
        yield
    except OSError as error:
        if error.errno != errno.ENOSPC:
            raise
        raise OSError(errno.ENOSPC, 'no space left; make room or choose another place', str(path)) from None


@contextmanager
def whole_file(path, mode='w'):
    """Open `path` for writing so that it appears only when it is complete.

    Raises
    ------
    OSError
        If the directory does not exist or cannot be written, or the disk is full; nothing is left behind.
    """
    path = Path(path)
    partial = path.with_name(f'.{path.name}.{os.getpid()}.partial')
    try:
        out = open(partial, mode)  # noqa: SIM115, the next line closes it
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


def write_columns(path, names, columns):
    """Write columns of numbers to a CSV file with their names in its first line, whole or not at all."""
    with whole_file(path) as file:
        np.savetxt(file, np.transpose(columns), fmt='%.15g', delimiter=',', header=','.join(names), comments='')


@contextmanager
def saved_arrays(path, kind):
    """The arrays of a .npz file of `kind`, such as 'bands', for reading.

    Raises
    ------
    FileNotFoundError
        If there is no such file.
    ValueError
        If it is truncated or holds something else: whatever goes wrong while its arrays are used.
    """
    try:
        with open(path, 'rb') as file, np.load(file) as data:  # numpy leaves a truncated file that it opened itself open
            yield data
    except FileNotFoundError:
        raise FileNotFoundError(f'there is no file {path}; compute {kind} and save() them there') from None
    except Exception as error:
        raise ValueError(f'{path} is no complete file of {kind} ({error}); compute them again and save()') from error


class Saved:
    """A frozen dataclass of arrays, numbers and tuples of names that can be kept in a file.

    Parameters
    ----------
    kind : str
        What a file holds, for its errors: `class Spectrum(Saved, kind='spectra')`.
    """

    def __init_subclass__(cls, kind):
        cls._kind = kind

    def save(self, path):
        """Write to a .npz file, whole or not at all."""
        with whole_file(path, 'wb') as file:
            np.savez(file, **{field.name: getattr(self, field.name) for field in fields(self)})

    @classmethod
    def load(cls, path):
        """Read what `save` wrote.

        Raises
        ------
        FileNotFoundError
            If there is no such file.
        ValueError
            If it is truncated or holds something else.
        """
        with saved_arrays(path, cls._kind) as data:
            return cls(**{field.name: _restored(data[field.name], field.type) for field in fields(cls)})


def _restored(array, kind):
    """The number or the tuple that numpy has made an array of, or the array."""
    if array.ndim == 0:
        return array.item()
    return tuple(array.tolist()) if kind is tuple else array


@contextmanager
def whole_directory(path):
    """A directory to write into, whose files appear in `path` together, when all are complete.

    Parameters
    ----------
    path : path-like
        Made if it does not exist, but its parent must; files of the same names there are replaced.

    Yields
    ------
    pathlib.Path

    Raises
    ------
    OSError
        At once if `path` is no directory, its parent does not exist, or either cannot be written.  Nothing is left
        behind, whatever goes wrong later.
    """
    path = Path(path)
    if os.path.lexists(path) and not path.is_dir():
        raise NotADirectoryError(f'{path} is a file; name a directory for the results')
    home = path if path.is_dir() else path.parent
    if not home.is_dir():
        raise FileNotFoundError(f'{path} cannot be made, as {home} is no directory; make that first, or choose another place')
    try:
        partial = Path(tempfile.mkdtemp(prefix='.partial-', dir=home))
    except OSError as error:
        raise type(error)(f'{home} cannot be written ({error.strerror}); choose another place for the results') from None
    try:
        yield partial
        path.mkdir(exist_ok=True)
        for file in sorted(partial.iterdir()):
            os.replace(file, path / file.name)
    except OSError as error:
        elsewhere = error.filename and not Path(error.filename).is_relative_to(partial)  # such as frames of a long record
        if error.errno != errno.ENOSPC or elsewhere:
            raise
        raise OSError(f'no space left for results in {path}, nothing was written; make room or choose another place') from None
    finally:
        shutil.rmtree(partial)
