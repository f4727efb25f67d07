"""The work of a worker: it computes a batch of points with one thread, and reports the points that it had to refuse."""

from __future__ import annotations

import os
from contextlib import contextmanager
from dataclasses import dataclass, field
from time import perf_counter
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from typing import Any

THREADS = 'OMP_NUM_THREADS', 'OPENBLAS_NUM_THREADS', 'MKL_NUM_THREADS', 'NUMBA_NUM_THREADS'
"""Variables that libraries read when they are loaded."""
_pinned = False  # in this process


@dataclass(frozen=True)
class Answer:
    """The result at one point.

    Attributes
    ----------
    values : dict of str to float or list
        Numbers, or nested lists of them, by their names.
    fault : str
        Why some or all are missing; '' if none is.
    """

    values: dict[str, Any] = field(default_factory=dict)
    fault: str = ''


def refusals() -> tuple[type[Exception], ...]:
    """Errors that say that a point has no answer; others are mistakes in a program, and end the sweep."""
    from ..dynamics.cages import Diverged

    return ValueError, ArithmeticError, MemoryError, Diverged


def evaluated(function: Callable[..., Any], points: Sequence[Mapping[str, float]]) -> tuple[list[Answer], float]:
    """The answers of `function` at some points, and the seconds that this took."""
    if not _pinned:
        _pin()
    start = perf_counter()
    return [answer(function, point) for point in points], perf_counter() - start


def answer(function: Callable[..., Any], point: Mapping[str, float]) -> Answer:
    """The answer of `function` at one point, or why there is none.

    Raises
    ------
    TypeError
        If the function returns something other than a number, an array of numbers, a dict of these, or an Answer.
    """
    try:
        found = function(**point)
    except refusals() as error:
        return Answer(fault=str(error) or type(error).__name__)
    if not isinstance(found, Answer):
        found = Answer(found if isinstance(found, dict) else {'value': found})
    values, faults = {}, [found.fault] * bool(found.fault)
    for name, value in found.values.items():
        array = np.asarray(value)
        if array.dtype.kind not in 'biuf':
            raise TypeError(f'{name} is {value!r}; a function to be swept over returns real numbers, arrays of them, or a dict '
                            'of these')
        if np.isfinite(array).all():
            values[name] = array.astype(float).tolist()
        else:
            faults.append(f'{name} is {array[~np.isfinite(array)].flat[0]}')
    return Answer(values, '; '.join(faults))


@contextmanager
def one_thread() -> Iterator[None]:
    """The master computes with one thread meanwhile, as workers do: sums in another order differ in their last bits."""
    global _pinned
    before, pinned = {name: os.environ.get(name) for name in THREADS}, _pinned
    limits = _pin()
    try:
        yield
    finally:
        _pinned = pinned
        limits.restore_original_limits()
        for name, value in before.items():
            os.environ.pop(name, None)
            if value is not None:
                os.environ[name] = value


def _pin():
    """Limit libraries that are loaded already, and those that will be."""
    global _pinned
    from threadpoolctl import ThreadpoolController

    os.environ.update(dict.fromkeys(THREADS, '1'))
    _pinned = True
    return ThreadpoolController().limit(limits=1)
