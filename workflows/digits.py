"""Numbers as one reads them: with the digits that mean something, and differences in words."""

import math

ROUNDING = 1e-9
"""A quantity that should vanish, and is smaller than this, is zero to rounding: the digits left of it mean nothing."""


def number(value, digits=6):
    """A number with as many digits as one reads; what rounding left of zero has one.

    Examples
    --------
    >>> number(141.42135623731), number(2.49959963777e-33), number(70000.0)
    ('141.421', '2e-33', '70000')
    """
    value = float(value)
    return f'{value:.1g}' if 0 < abs(value) < ROUNDING else f'{value:.{digits}g}'


def apart_in_words(difference, relative=True):
    """How far a number is from its reference, in words.

    Parameters
    ----------
    difference : float
        Relative to the reference, or absolute where that is zero.
    relative : bool

    Examples
    --------
    >>> apart_in_words(0.0), apart_in_words(3e-10), apart_in_words(0.0123), apart_in_words(2e-15, relative=False)
    ('equal', 'equal to 9 digits', '1.2 % off', 'zero to rounding')
    """
    if not math.isfinite(difference):
        return 'not a number'
    if difference == 0:
        return 'equal' if relative else 'zero'
    if not relative:
        return 'zero to rounding' if difference < ROUNDING else f'{difference:.2g} from zero'
    if difference < 1e-3:
        return f'equal to {min(math.floor(-math.log10(difference)), 15)} digits'
    return f'{_percent(difference)} off' if difference < 2 else f'{difference:.2g} times off'


def bound_in_words(tolerance, relative=True):
    """A tolerance in words.

    Examples
    --------
    >>> bound_in_words(0.05), bound_in_words(1e-9), bound_in_words(1e-9, relative=False), bound_in_words(0.0)
    ('5 %', '1e-9', '1e-9', '0')
    """
    if tolerance == 0:
        return '0'
    if relative and tolerance >= 1e-3:
        return _percent(tolerance)
    return f'{tolerance:.2g}' if tolerance >= 1e-3 else f'{tolerance:.0e}'.replace('e-0', 'e-')


def _percent(share):
    return f'{100 * share:.2g} %' if share < 0.995 else f'{100 * share:.0f} %'
