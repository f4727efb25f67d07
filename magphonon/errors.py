"""Checks at the border: each error says what is wrong, with which value, and how to mend it."""

from numbers import Real

import numpy as np


def positive(name, value, unit=''):
    """Return `value` as a float, or raise ValueError unless it is a finite number above zero."""
    return _number(name, value, unit, 'positive', lambda x: x > 0)


def not_negative(name, value, unit=''):
    """Return `value` as a float, or raise ValueError unless it is a finite number, zero or above."""
    return _number(name, value, unit, 'zero or positive', lambda x: x >= 0)


def _number(name, value, unit, kind, holds):
    if not isinstance(value, Real) or isinstance(value, bool) or not np.isfinite(value) or not holds(value):
        raise ValueError(f'{name} must be a {kind} number{f" in {unit}" if unit else ""}, not {value!r}')
    return float(value)


def whole(name, value, least=1):
    """Return `value` as an int, or raise ValueError unless it is a whole number of at least `least`."""
    if not isinstance(value, Real) or isinstance(value, bool) or not np.isfinite(value) or value != int(value) or value < least:
        raise ValueError(f'{name} must be a whole number of at least {least}, not {value!r}')
    return int(value)


def one_of(name, value, choices):
    """Return `value`, or raise ValueError unless it is one of `choices`."""
    if value not in choices:
        raise ValueError(f'{name} must be one of {", ".join(map(repr, choices))}, not {value!r}')
    return value


def finite(name, values, shape=None):
    """Return `values` as a float array, or raise ValueError if an entry is NaN or infinite or the shape is another."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError):
        raise ValueError(f'{name} must hold numbers in rows of equal length, not {values!r}') from None
    if shape is not None and array.shape != shape:
        raise ValueError(f'{name} must have the shape {shape}, not {array.shape}')
    if not np.isfinite(array).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f'{name}{list(where)} is {array[where]}; every entry must be a finite number')
    return array
