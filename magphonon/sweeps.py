"""Sweeps: a function at every point of a grid, by joblib on cores or a Dask cluster; the answers are an xarray Dataset."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from functools import cache
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from .errors import shown

if TYPE_CHECKING:
    from xarray import Dataset


def sweep(f: Callable[..., Any], grid: Mapping[str, ArrayLike], *, workers: int | None = None,
          units: Mapping[str, str] | None = None) -> Dataset:
    """Evaluate a function at every point of a grid.

    Linear algebra uses one thread at each point, so that processors of one kind give the same bits wherever a point is computed.

    Parameters
    ----------
    f : callable
        Takes one value for each axis as a keyword, and returns a number, an array, or a dict of these.
    grid : dict of str to array_like
        The values of each keyword of `f`; the last one varies fastest.
    workers : int, optional
        Number of processes on this machine, -1 for one on each core. By default all is computed in this process, unless
        `joblib.parallel_config` says otherwise, such as ``with joblib.parallel_config(backend='dask')``.
    units : dict of str to str, optional
        Units of axes and answers, which become the attribute `units` of each.

    Returns
    -------
    xarray.Dataset
        One variable for each answer, `value` if `f` returns a single one, with the axes as coordinates. An answer that is an
        array has further dimensions.

    Raises
    ------
    ValueError
        If the grid has no point, or an answer has different shapes at different points. An error of `f` ends the sweep, with a
        note that names the point.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import sweep
    >>> def period(length, gravity):
    ...     return 2 * np.pi * np.sqrt(length / gravity)
    >>> found = sweep(period, {'length': [0.5, 1.0], 'gravity': [1.62, 9.81]}, units={'length': 'm', 'value': 's'})
    >>> found.value.sel(length=1.0).values.round(3).tolist()
    [4.937, 2.006]
    """
    try:
        from joblib import Parallel
        from tqdm import tqdm
        from xarray import Dataset
    except ImportError as error:
        raise ImportError(f"a sweep needs {error.name}, which is not installed; pip install 'magphonon[sweep]'") from None
    axes = {name: _axis(name, values) for name, values in grid.items()}
    if not axes:
        raise ValueError("the grid has no axis; give at least one, such as {'a': np.linspace(3, 6, 50)}")
    points = [dict(zip(axes, values, strict=True)) for values in product(*(axis.tolist() for axis in axes.values()))]
    computed = Parallel(n_jobs=workers, return_as='generator')((_answers, (f, point), {}) for point in points)
    answers = list(tqdm(computed, total=len(points), desc='points', disable=None))
    shape, units = tuple(map(len, axes.values())), units or {}
    variables = {name: _variable(name, [found[name] for found in answers], axes, shape, units) for name in answers[0]}
    return Dataset(variables, {name: (name, axis, _unit(name, units)) for name, axis in axes.items()})


def _axis(name, values):
    axis = np.atleast_1d(np.asarray(values))
    if axis.ndim != 1 or not len(axis) or len(np.unique(axis)) < len(axis):
        raise ValueError(f'{name} must be a list of different values, not {shown(axis.tolist())}')
    return axis


def _answers(f: Callable[..., Any], point: Mapping[str, Any]) -> dict[str, Any]:
    """What `f` returns at one point, as arrays by name."""
    try:
        with _libraries().limit(limits=1):
            found = f(**point)
        answers = {name: np.asarray(value) for name, value in (found if isinstance(found, dict) else {'value': found}).items()}
        for name, value in answers.items():
            if value.dtype == object or name in point:
                raise TypeError(f'the answer {name} is {shown(found)}; a function in a sweep returns a number, an array, or a '
                                'dict of these by names that are not those of the axes')
    except Exception as error:
        error.add_note(f'at {", ".join(f"{name} = {value!r}" for name, value in point.items())}')
        raise
    return answers


@cache
def _libraries() -> Any:
    """The libraries of linear algebra in this process: sums in another order, by several threads, would differ in their bits."""
    import scipy.linalg  # noqa: F401  only libraries that are loaded already can be limited
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


def _variable(name: str, values: Sequence[Any], axes: Mapping[str, Any], shape: tuple[int, ...],
              units: Mapping[str, str]) -> tuple[Any, ...]:
    """One answer arranged on the grid, with its dimensions and its unit."""
    shapes = {value.shape for value in values}
    if len(shapes) > 1:
        raise ValueError(f'{name} has the shapes {sorted(shapes)} at different points; return arrays of one shape')
    (own,) = shapes
    return (*axes, *(f'{name}_{k}' for k in range(len(own)))), np.reshape(values, shape + own), _unit(name, units)


def _unit(name, units):
    return {'units': units[name]} if name in units else {}
