"""Sweeps: questions about a scene, or a function, evaluated at every point of a grid; the answers are an xarray Dataset.

The journal of a sweep is a text file. Its first line says what was asked, and each further line is the answer at one point.  Each
line begins with its checksum; if the checksum is wrong, the line is ignored and its point computed again.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager, nullcontext
from functools import partial
from hashlib import sha256
from io import RawIOBase
from itertools import product
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any
from warnings import warn

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import __version__
from ..errors import finite, shown
from ..files import MEGABYTE, refuse_endless
from .questions import REFUSALS, SceneAnswers

if TYPE_CHECKING:
    from xarray import Dataset

    from ..scenes.scene import Scene

MOST_POINTS = 10**8  # largest number of points; the answers to more do not fit into memory
MOST_BYTES = 10**5 * MEGABYTE  # largest size of a journal
_limited = False  # whether linear algebra in this process is limited to one thread


def sweep(asked: Scene | Callable[..., Any], over: Mapping[str, ArrayLike], ask: str | Sequence[str] = (), *,
          workers: int | None = None, executor: Executor | None = None, journal: str | PathLike[str] | RawIOBase | None = None,
          name: str | None = None, units: Mapping[str, str] | None = None) -> Dataset:
    """Evaluate questions about a scene, or any function, at every point of a grid.

    On processors of one kind the answers are the same to the last bit wherever they are computed, because linear algebra uses
    one thread.

    Parameters
    ----------
    asked : Scene or callable
        A scene, or a function that takes one number for each axis as a keyword and returns a number, an array of numbers, or a
        dict of these. If it raises a ValueError, an ArithmeticError or a MemoryError the point is marked as bad; any other error
        ends the sweep.
    over : dict of str to array_like
        The axes: keys of the scene, such as 'law.a', or arguments of the function, and the values that they take.
    ask : str or sequence of str
        The questions about a scene: see `magphonon.sweeps.observables()`.
    workers : int, optional
        Number of processes on this machine, -1 for one on each core. By default all is computed in this process, unless
        `joblib.parallel_config` says otherwise, such as ``with joblib.parallel_config(backend='dask')``.
    executor : Executor, optional
        Any executor of `concurrent.futures` to use in place of workers, such as `mpi4py.futures.MPIPoolExecutor`.
    journal : path-like or file, optional
        A file to which every answer is added as soon as it is known.  If the process is killed, the same sweep with the same
        journal continues where it stopped; the file is never replaced or deleted. A new file may also be given already open, from
        `open(path, 'xb', buffering=0)`.
    name : str, optional
        A name for what a function computes; required with a journal. A sweep continues from a journal with the same name, the
        same axes and the same version of magphonon. Choose a new name whenever the function changes, because the journal cannot
        notice that by itself.
    units : dict of str to str, optional
        Units of the axes and answers of a function; those of a scene are known.

    Returns
    -------
    xarray.Dataset
        One variable for each answer, NaN at bad points, with the axes as coordinates; `fault` holds the reason why answers are
        missing, or ''.  Each variable has its `units` as an attribute.

    Raises
    ------
    ValueError
        For an invalid axis, an unknown key or question, or a journal of another sweep.
    ImportError
        Without joblib, threadpoolctl or xarray; `pip install 'magphonon[sweep]'`.
    RuntimeError
        If a process dies, usually because memory runs out.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene, sweep
    >>> scene = read_scene(ready_scene('ideal'))
    >>> found = sweep(scene, {'lattice.mass_kg': [0.5, 1.0, 2.0]}, 'bands.M.1')
    >>> found['bands.M.1'].values.round(3).tolist()  # in Hz: the root of 2 (a - 3) f/(m L), by 2 pi
    [31.831, 22.508, 15.915]
    """
    try:
        import joblib  # noqa: F401  before anything is computed
        import threadpoolctl  # noqa: F401
        from tqdm import tqdm
        from xarray import Dataset
    except ImportError as error:
        raise ImportError(f"a sweep needs {error.name}, which is not installed; pip install 'magphonon[sweep]'") from None
    axes = _checked(over)
    answers, about, told = _question(asked, axes, (ask,) if isinstance(ask, str) else tuple(ask))
    about = {'magphonon': __version__} | about | ({} if name is None else {'name': name})
    if journal is not None and callable(asked) and name is None:
        raise ValueError('a journal cannot tell functions apart; give a name=, and a new one whenever the results of the '
                         'function change')
    head = about | {'over': {key: values.tolist() for key, values in axes.items()}}
    points = [dict(zip(axes, values, strict=True)) for values in product(*(values.tolist() for values in axes.values()))]
    with (nullcontext(({}, None)) if journal is None else _journal(journal, head, len(points)) as (known, file),
          _one_thread(), tqdm(total=len(points), initial=len(known), desc='points', disable=None) as progress):
        tasks = (partial(_answer, answers, k, point) for k, point in enumerate(points) if k not in known)
        for k, values, fault in _computed(tasks, workers, executor):
            known[k] = values, fault
            if file is not None:
                file.write(_line([k, values, fault]))
            progress.update()
    attributes = {key: value if isinstance(value, str) else json.dumps(value) for key, value in about.items()}
    told |= {key: {'units': unit} for key, unit in (units or {}).items()}
    coordinates = {key: (key, values, told.get(key, {'units': ''})) for key, values in axes.items()}
    return Dataset(_variables(axes, [known[k] for k in range(len(points))], told), coordinates, attributes)


def _checked(over):
    if not over:
        raise ValueError("over names no axis; give at least one, such as over={'law.a': np.linspace(3, 6, 50)}")
    axes = {key: np.atleast_1d(finite(key, values)) for key, values in over.items()}
    for key, values in axes.items():
        if values.ndim != 1 or not len(values) or len(np.unique(values)) < len(values):
            raise ValueError(f'{key} must be a list of different numbers, not {shown(values.tolist())}')
    points = np.prod([len(values) for values in axes.values()], dtype=float)
    if points > MOST_POINTS:
        raise ValueError(f'over asks for {points:.3g} points, but at most {MOST_POINTS:g} are computed; give fewer values')
    return axes


def _question(asked, axes, ask):
    from ..scenes.scene import Scene

    if isinstance(asked, Scene):
        answers = SceneAnswers.of(asked, axes, ask)
        return answers, answers.about, answers.attributes(axes)
    if not callable(asked):
        raise ValueError(f'sweep needs a scene or a function, not {type(asked).__name__}; read a scene file with read_scene')
    if ask:
        raise ValueError('ask= is for scenes; the answers of a function are what it returns')
    return partial(_called, asked), {'function': getattr(asked, '__qualname__', type(asked).__qualname__)}, {}


def _called(function, point):
    found = function(**point)
    return found if isinstance(found, dict) else {'value': found}, ''


def _answer(answers: Callable[..., Any], k: int, point: Mapping[str, float]) -> tuple[int, dict[str, Any], str]:
    global _limited
    if not _limited:  # in a worker: the first process has seen to itself
        _limits()
        _limited = True
    try:
        found, fault = answers(point)
    except REFUSALS as error:
        return k, {}, str(error) or type(error).__name__
    values, faults = {}, [fault] * bool(fault)
    for name, value in found.items():
        if name == 'fault' or name in point:
            raise TypeError(f'the function returns an answer called {name!r}, which is the name of '
                            f'{"an axis" if name in point else "the reasons why answers are missing"}; rename it')
        array = np.asarray(value)
        if array.dtype.kind not in 'biuf':
            raise TypeError(f'{name} is {value!r}; a function in a sweep must return real numbers, arrays of them, or a dict '
                            'of these')
        if np.isfinite(array).all():
            values[name] = array.astype(float).tolist()
        else:
            faults.append(f'{name} is {array[~np.isfinite(array)].flat[0]}')
    return k, values, '; '.join(faults)


def _computed(tasks: Iterable[Callable[[], Any]], workers: int | None, executor: Executor | None) -> Iterator[Any]:
    if executor is None:
        from joblib import Parallel

        here = {} if workers is None else {'backend': 'loky', 'n_jobs': workers}
        yield from Parallel(return_as='generator_unordered', **here)((task, (), {}) for task in tasks)
        return
    futures = [executor.submit(task) for task in tasks]
    try:
        yield from (future.result() for future in as_completed(futures))
    finally:
        for future in futures:
            future.cancel()


@contextmanager
def _one_thread() -> Iterator[None]:
    """Context in which linear algebra uses one thread, as in workers: sums in another order would differ in their last bits."""
    global _limited
    before = _limited
    with _limits():
        _limited = True
        try:
            yield
        finally:
            _limited = before


def _limits():
    import scipy.linalg  # noqa: F401  only libraries that are loaded already can be limited
    from threadpoolctl import threadpool_limits

    return threadpool_limits(1)


def _line(entry: Any) -> bytes:
    text = json.dumps(entry)
    return f'{_checksum(text.encode())} {text}\n'.encode()


def _checksum(text: bytes) -> str:
    return sha256(text).hexdigest()[:16]


@contextmanager
def _journal(journal: Any, head: Any, points: int) -> Iterator[tuple[dict[int, tuple[dict[str, Any], str]], Any]]:
    """Context with the answers that a journal holds, and the open file to which more are added."""
    if hasattr(journal, 'write'):
        journal.write(_line(head))
        yield {}, journal
        return
    path = Path(journal)
    known, new, whole = {}, not os.path.lexists(path), True
    if not new:
        if path.is_symlink():
            raise ValueError(f'{path} is a link, into which no journal is written; name another place')
        refuse_endless(path, MOST_BYTES)
        text = path.read_bytes()
        known, whole = _read(path, text, _line(head), points), text.endswith(b'\n')
    flags = getattr(os, 'O_NOFOLLOW', 0)
    try:
        with open(path, 'xb' if new else 'ab', buffering=0, opener=lambda name, mode: os.open(name, mode | flags, 0o666)) as file:
            file.write(_line(head) if new else b'' if whole else b'\n')
            yield known, file
    except OSError as error:
        if error.filename is None or Path(error.filename) != path:
            raise
        raise type(error)(f'{path} cannot be written ({error.strerror}); choose another place for the journal') from None


def _read(path, text, head, points):
    first, *lines = text.splitlines(keepends=True) or [b'']
    if first != head:
        another = first[:16].decode(errors='replace') == _checksum(first[17:].rstrip(b'\n'))
        raise ValueError(f'{path} is the journal of a different sweep: its scene or function, axes, questions or version differ; '
                         'repeat that sweep, or name another place' if another else
                         f'{path} is not the journal of a sweep; name another place for the journal')
    known, damaged = {}, 0
    for line in lines:
        try:
            if line[:17].decode() != f'{_checksum(line[17:-1])} ':
                raise ValueError
            k, values, fault = json.loads(line[17:])
        except (ValueError, TypeError, RecursionError):
            damaged += line.endswith(b'\n')
            continue
        if isinstance(k, int) and 0 <= k < points and isinstance(values, dict) and isinstance(fault, str):
            known[k] = values, fault
    if damaged:
        warn(f'{path} has {damaged} damaged lines; their points are computed again', stacklevel=5)
    return known


def _variables(axes: Mapping[str, NDArray[np.float64]], answers: Sequence[tuple[dict[str, Any], str]],
               told: Mapping[str, Mapping[str, str]]) -> dict[str, Any]:
    """The answers arranged on the grid, as variables of a Dataset; an answer that is an array has further axes of its own."""
    shape = tuple(len(values) for values in axes.values())
    asked = [name for name in told if name not in axes]
    variables: dict[str, Any] = {}
    for name in dict.fromkeys([*asked, *(name for values, _ in answers for name in values)]):
        known = {k: np.asarray(values[name], dtype=float) for k, (values, _) in enumerate(answers) if name in values}
        inner = {array.shape for array in known.values()} or {()}
        if len(inner) > 1:
            raise ValueError(f'{name} has the shapes {sorted(inner)} at different points; return arrays of one shape')
        own = inner.pop()
        grid = np.full((len(answers), *own), np.nan)
        for k, array in known.items():
            grid[k] = array
        dimensions = (*axes, *(f'{name}_{n}' for n in range(len(own))))
        variables[name] = (dimensions, grid.reshape(shape + own), told.get(name, {'units': ''}))
    faults = np.array([fault for _, fault in answers], dtype=object)
    variables['fault'] = (tuple(axes), faults.reshape(shape), {'long_name': 'why answers are missing'})
    return variables
