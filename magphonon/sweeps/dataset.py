"""Sweeps: a scene or a function asked at every point of a grid, the answers as an xarray Dataset."""

from __future__ import annotations

import inspect
import json
import pickle
from collections.abc import Sequence
from contextlib import ExitStack
from dataclasses import asdict, is_dataclass
from functools import partial
from hashlib import sha256
from typing import TYPE_CHECKING

import numpy as np
from tqdm import tqdm

from .. import __version__
from .evaluation import Answer, one_thread
from .grid import checked_axes, points_of, unit_of
from .journal import fingerprint_of, journal
from .running import completed

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from concurrent.futures import Executor
    from os import PathLike
    from typing import Any

    from numpy.typing import ArrayLike, NDArray
    from xarray import Dataset

    from ..scenes.scene import Scene


def sweep(asked: Scene | Callable[..., Any], over: Mapping[str, ArrayLike], ask: str | Sequence[str] = (),
          executor: Executor | Callable[[], Executor] | None = None, journal_file: str | PathLike[str] | None = None,
          units: Mapping[str, str] | None = None) -> Dataset:
    """Ask a scene, or any function, at every point of a grid.

    The answers have the same bits on every executor, as long as its machines have processors of one kind: every worker
    computes with one thread.

    Parameters
    ----------
    asked : Scene or callable
        A function is called with one number for each axis by its name, and returns a number, an array of numbers, or a dict of
        these.  A ValueError, an ArithmeticError, a MemoryError or Diverged says that a point is bad; another error ends the
        sweep.  Other processes must be able to import the function.
    over : dict of str to array_like
        The axes: keys of the scene, such as 'law.a', or arguments of the function, and the values that they take.
    ask : str or sequence of str
        What is asked of a scene: see `magphonon.sweeps.known_questions()`.
    executor : Executor or callable that makes one, optional
        Any of `concurrent.futures`, Dask's `client.get_executor(pure=False)`, `mpi4py.futures.MPIPoolExecutor`; or
        `magphonon.sweeps.processes(4)`, which is made anew if a process dies.  By default all is computed in this process.
    journal_file : path-like, optional
        A file to which every answer is added as soon as it is known.  If the process is killed, the same sweep with the same
        journal goes on where it stopped.
    units : dict of str to str, optional
        Units of the axes and answers of a function; those of a scene are known.

    Returns
    -------
    xarray.Dataset
        One variable for each answer, NaN at bad points, with the axes as coordinates; `fault` holds the reason why answers are
        missing, or ''.  `units` are among the attributes of each.

    Raises
    ------
    ValueError
        For an axis, a key or a question that is none, or the journal of another sweep.
    ImportError
        Without xarray; `pip install 'magphonon[sweep]'`.
    BrokenExecutor
        If processes die, unless the executor can be made anew.

    Examples
    --------
    >>> from magphonon import read_scene, ready_scene, sweep
    >>> scene = read_scene(ready_scene('ideal'))
    >>> found = sweep(scene, {'law.a': [3.5, 4.0, 5.0]}, 'bands.M.1')
    >>> found['bands.M.1'].values.round(3).tolist()  # in Hz: the root of 2 (a - 3) f/(m L), by 2 pi
    [15.915, 22.508, 31.831]
    """
    try:
        import threadpoolctl  # noqa: F401  before anything is computed
        from xarray import Dataset
    except ImportError as error:
        raise ImportError(f"a sweep needs {error.name}, which is not installed; pip install 'magphonon[sweep]'") from None
    axes = checked_axes(over)
    function, told, about = _function(asked, tuple(axes), (ask,) if isinstance(ask, str) else tuple(ask))
    points, answers = points_of(axes), dict[int, Answer]()
    attributes = {'magphonon': __version__} | about
    with ExitStack() as stack:
        stack.enter_context(one_thread())
        book = None
        if journal_file is not None:
            mark = fingerprint_of([attributes, _identity(function), {key: values.tolist() for key, values in axes.items()}])
            attributes['fingerprint'] = mark
            book = stack.enter_context(journal(journal_file, mark, len(points)))
            answers |= book.known
        progress = stack.enter_context(tqdm(total=len(points), initial=len(answers), desc='points', disable=None))
        for found in completed(function, points, [k for k in range(len(points)) if k not in answers], executor):
            if book is not None:
                book.append(found)
            answers |= dict(found)
            progress.update(len(found))
    told = {key: unit_of(key) for key in axes} | told | dict(units or {})
    ordered = [answers[k] for k in range(len(points))]
    return Dataset(_variables(axes, ordered, told), _coordinates(axes, told), attributes)


def _function(asked, keys, ask):
    """What is evaluated, the units of its answers, and what the Dataset tells about it."""
    from ..scenes.scene import Scene

    if isinstance(asked, Scene):
        from .scene_answers import SceneAnswers

        function = SceneAnswers.of(asked, keys, ask)
        return function, function.units, {'title': asked.title, 'scene': json.dumps(function.tables)}
    if not callable(asked):
        raise ValueError(f'sweep asks a scene or a function, not {type(asked).__name__}; read a scene file with read_scene')
    if ask:
        raise ValueError('ask belongs to a scene; a function is asked what it returns')
    return asked, {}, {'function': getattr(asked, '__qualname__', type(asked).__qualname__)}


def _variables(axes, answers: Sequence[Answer], units: Mapping[str, str]) -> dict[str, Any]:
    """The answers on the grid; an array has more axes of its own."""
    shape = tuple(len(values) for values in axes.values())
    names = dict.fromkeys([*(name for name in units if name not in axes), *(name for found in answers for name in found.values)])
    variables: dict[str, Any] = {}
    for name in names:
        known = {k: np.asarray(found.values[name], dtype=float) for k, found in enumerate(answers) if name in found.values}
        inner = {array.shape for array in known.values()} or {()}
        if len(inner) > 1:
            raise ValueError(f'{name} has the shapes {sorted(inner)} at different points; return arrays of one shape')
        own = inner.pop()
        grid = np.full((len(answers), *own), np.nan)
        for k, array in known.items():
            grid[k] = array
        dimensions = (*axes, *(f'{name}_{n}' for n in range(len(own))))
        variables[name] = (dimensions, grid.reshape(shape + own), {'units': units.get(name, '')})
    faults = np.array([found.fault for found in answers], dtype=object)
    variables['fault'] = (tuple(axes), faults.reshape(shape), {'long_name': 'why answers are missing'})
    return variables


def _coordinates(axes: Mapping[str, NDArray[np.float64]], units: Mapping[str, str]) -> dict[str, Any]:
    return {key: (key, values, {'units': units[key]}) for key, values in axes.items()}


def _identity(function: Any) -> Any:
    """What makes a function this one, in plain Python: its source and the values that it was made with.

    Raises
    ------
    ValueError
        If it cannot be recognised again.
    """
    if isinstance(function, partial):
        return ['partial', _identity(function.func), _digest(function, [function.args, function.keywords])]
    if hasattr(function, 'identity'):  # it knows itself
        return function.identity
    if is_dataclass(function):
        return [type(function).__qualname__, _digest(function, asdict(function))]  # pyright: ignore[reportArgumentType]  no class
    try:
        source = inspect.getsource(function)
    except (OSError, TypeError) as error:
        raise ValueError(f'a journal cannot tell whether it belongs to {function!r} ({error}); take a function that is defined '
                         'in a file, functools.partial of one, or a dataclass that can be called') from None
    held = [function.__defaults__, function.__kwdefaults__, [cell.cell_contents for cell in function.__closure__ or ()]]
    return [function.__module__, function.__qualname__, source, _digest(function, held)]


def _digest(function, values):
    """A checksum; of what JSON does not know, by way of pickle."""
    try:
        text = json.dumps(values, sort_keys=True, default=lambda held: sha256(pickle.dumps(held)).hexdigest())
    except (pickle.PicklingError, AttributeError, TypeError, ValueError) as error:
        raise ValueError(f'a journal cannot tell whether it belongs to {function!r}, which holds what cannot be written down '
                         f'({error}); give it plain numbers and functions of a module') from None
    return sha256(text.encode()).hexdigest()
