"""Checks of input values: each error says what is wrong, with which value, and how to correct it.

For a misspelt key, kind or command, the error suggests the entry that was probably meant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from difflib import get_close_matches
from math import inf, isfinite, nan
from numbers import Real
from typing import TYPE_CHECKING, Any, SupportsInt

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from ase import Atoms

MOST = 2**53
"""Largest whole number accepted as a count; floating-point numbers do not distinguish larger ones."""
LONGEST = 200
"""Largest number of characters of a value that a message shows."""
SMALL = 2**28  # bytes below which memory is not checked, because every machine has them


class PhysicsError(ValueError):
    """The physics of a structure forbids the computation: it buckles, is not at rest, or a run diverged.

    Its subclasses are `Unstable`, `NotAtRest` and `Diverged`.  All are ValueErrors, like the errors for wrong arguments.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes
    >>> from magphonon.errors import PhysicsError
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> del patch[18]
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> try:
    ...     modes(patch)
    ... except PhysicsError as error:
    ...     print(type(error).__name__)
    NotAtRest
    """


class Unstable(PhysicsError):
    """A structure buckles or slides, so it has no stable equilibrium and no steady response.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.errors import Unstable
    >>> from magphonon.response import Dof, receptance
    >>> cell = lattices.square(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=2.0)  # it needs 4 f/L
    >>> patch = cell.repeat((4, 4, 1))
    >>> patch.calc = cell.calc.on(patch)
    >>> try:
    ...     receptance(patch, Dof(5, (0, 1, 0)), Dof(5, (0, 1, 0)), [1.0], damping=0.1)
    ... except Unstable:
    ...     print('it needs a stiffer foundation')
    it needs a stiffer foundation
    """


class NotAtRest(PhysicsError):
    """The static forces do not balance at the positions about which a structure is linearised; `relaxed` finds a balance.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, modes, relaxed
    >>> from magphonon.errors import NotAtRest
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> del patch[18]  # a vacancy
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=4.0)
    >>> try:
    ...     found = modes(patch)
    ... except NotAtRest:
    ...     found = modes(relaxed(patch).atoms)
    >>> len(found.omega)
    36
    """


class Diverged(PhysicsError):
    """A run went wrong: particles collided or lost their neighbours, so that the law of their bonds says nothing any more.

    The calculator raises it for a bond out of the range of its law, whoever moves the particles. `DrivenVerlet` adds the time and
    leaves the atoms in the last good state.

    Attributes
    ----------
    particle : int
        The particle concerned.
    time : float or None
        When the fault was noticed, in ms; None if the calculator noticed it, which knows no time.
    what : str
        What is wrong with the particle, in words.
    atoms : ase.Atoms or None
        The last good state of a `DrivenVerlet`, at `last_good` ms.
    last_good : float or None

    Examples
    --------
    >>> from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
    >>> from magphonon.dynamics import Diverged
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> patch.set_momenta([[6.0, 0.0, 0.0] if k == len(patch) // 2 else [0.0, 0.0, 0.0] for k in range(len(patch))])
    >>> try:
    ...     DrivenVerlet(patch, 0.01).run(100)
    ... except Diverged as error:
    ...     print('particle', error.particle)
    particle 18
    """

    def __init__(self, particle: SupportsInt, time: float | None, what: str) -> None:
        when = '' if time is None else f'the simulation diverged at {time:g} ms: '
        then = ('. The atoms keep the last good state. Use a shorter time step, a weaker drive, or a start closer to rest' if when
                else ', out of the range of their law. If this is a run, use a shorter time step; start closer to rest')
        super().__init__(f'{when}particle {particle} {what}{then}')
        self.particle, self.time, self.what = int(particle), time, what
        self.atoms: Atoms | None = None
        self.last_good: float | None = None


def nearest(word: object, choices: Iterable[Any], likeness: float = 0.6) -> str | None:
    """The choice that was probably meant, or None: one that begins with `word` ('b_N_m_a' for 'b'), or a similar one.

    `likeness` is the least ratio of `difflib.SequenceMatcher`.
    """
    choices = [choice for choice in choices if isinstance(choice, str)]
    if not isinstance(word, str):
        return None
    begun = [choice for choice in choices if choice.lower().startswith(f'{word.lower()}_')]
    near = get_close_matches(word.lower(), [choice.lower() for choice in choices], 1, likeness)
    return begun[0] if begun else next((choice for choice in choices if choice.lower() in near), None)


def did_you_mean(word: object, choices: Iterable[Any], otherwise: str = '') -> str:
    """The end of a message: "; did you mean 'bands'?" or, if no choice is similar, "; " and `otherwise`."""
    near = nearest(word, choices)
    return f'; did you mean {near!r}?' if near else f'; {otherwise}' if otherwise else ''


def shown(value: object) -> str:
    """`repr(value)` for a message, shortened to LONGEST characters."""
    try:
        text = repr(value.item() if isinstance(value, np.generic) else value)
    except ValueError:  # Python does not print whole numbers of more than 4300 digits
        return 'a number of thousands of digits'
    return text if len(text) <= LONGEST else f'{text[:LONGEST]}... ({len(text)} characters)'


def number(name: str, value: object, unit: str = '', kind: str = 'finite', holds: Callable[[float], bool] = isfinite) -> float:
    """Return `value` as a float, or raise ValueError unless it is finite and passes the test `holds`, which `kind` describes."""
    try:
        found = float(value) if isinstance(value, Real) and not isinstance(value, bool) else nan
    except OverflowError:  # a whole number or a fraction beyond 1.8e308
        found = inf
    if not isfinite(found) or not holds(found):
        raise ValueError(f'{name} must be a {kind} number{f" in {unit}" if unit else ""}, not {shown(value)}')
    return found


def positive(name: str, value: object, unit: str = '') -> float:
    """Return `value` as a float, or raise ValueError unless it is a finite number above zero."""
    return number(name, value, unit, 'positive', lambda x: x > 0)


def not_negative(name: str, value: object, unit: str = '') -> float:
    """Return `value` as a float, or raise ValueError unless it is a finite number, zero or above."""
    return number(name, value, unit, 'zero or positive', lambda x: x >= 0)


def whole(name: str, value: object, least: int = 1) -> int:
    """Return `value` as an int, or raise ValueError unless it is a whole number from `least` to 2**53."""
    try:
        found = number(name, value)
    except ValueError:
        found = nan
    if not least <= found <= MOST or found != int(found):
        most = f' and at most {MOST}' if found > MOST else ''
        raise ValueError(f'{name} must be a whole number of at least {least}{most}, not {shown(value)}')
    return int(found)


def refuse_memory(what: str, needed: float, mend: str) -> None:
    """Raise ValueError, before allocating, if `what` needs more memory than is free; `mend` says what to do instead."""
    if needed < SMALL:
        return
    from psutil import virtual_memory

    if needed > (free := virtual_memory().available):
        raise ValueError(f'{what} would take about {needed / 1e9:.3g} GB of memory, and {free / 1e9:.3g} GB are free; {mend}')


def one_of(name: str, value: object, choices: Sequence[Any]) -> Any:
    """Return `value`, or raise ValueError unless it is one of `choices`."""
    if value not in choices:
        raise ValueError(f'{name} must be one of {", ".join(map(repr, choices))}, not {shown(value)}'
                         f'{did_you_mean(value, choices)}')
    return value


def finite(name: str, values: object, shape: tuple[int, ...] | None = None) -> NDArray[np.float64]:
    """Return `values` as a float array, or raise ValueError if an entry is NaN or infinite, or if the shape is not `shape`."""
    try:
        array = np.asarray(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f'{name} must hold numbers in rows of equal length, not {shown(values)}') from None
    if shape is not None and array.shape != shape:
        raise ValueError(f'{name} must have the shape {shape}, not {array.shape}')
    if not np.isfinite(array).all():
        where = tuple(int(k) for k in np.argwhere(~np.isfinite(array))[0])
        raise ValueError(f'{name}{list(where)} is {array[where]}; every entry must be a finite number')
    return array


def indices(name: str, values: object, count: int) -> NDArray[np.intp]:
    """Return `values` as an array of indices, or raise ValueError unless they are whole numbers from 0 to `count` - 1."""
    found = np.atleast_1d(np.asarray(values))
    whole_numbers = np.issubdtype(found.dtype, np.integer) or not found.size
    if found.ndim != 1 or not whole_numbers or found.min(initial=0) < 0 or found.max(initial=-1) >= count:
        raise ValueError(f'{name} must be indices from 0 to {count - 1}, not {shown(values)}'
                         + '; give np.flatnonzero of a mask' * (found.dtype == bool))
    return found.astype(int)
