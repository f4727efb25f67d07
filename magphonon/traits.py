"""Traits: features of a structure beyond masses, bonds and springs, and which tools accept them.

    @takes('gyration', 'constraints')
    def tool(atoms, ...):

A tool accepts the traits that it declares and refuses all others, so a new trait is refused everywhere at first. All linear
theory goes through `LinearSystem.of` and `LinearSystem.nearest`. They check the traits again for the tool that is running, and
refuse a new trait for tools that declare nothing.  The tables of the documentation and the test of every tool with every trait
read `TRAITS` and `TOOLS`.
"""

from __future__ import annotations

import inspect
from collections.abc import Callable
from contextvars import ContextVar
from dataclasses import dataclass
from functools import cache, wraps
from typing import Any, ParamSpec, TypeVar

import numpy as np
from ase.constraints import FixedPlane

P = ParamSpec('P')
R = TypeVar('R')
HOLDERS = 'atoms', 'cell', 'strip', 'system', 'built'  # arguments that hold a structure
NAMED = 4  # number of other tools that a refusal names


@dataclass(frozen=True)
class Trait:
    """A feature that a structure may have, with the words that describe it to users.

    Attributes
    ----------
    name : str
    has : callable
        Function of the atoms and their calculator that says whether they have the trait.
    words : str
        Completes "... does not support".
    mend : callable
        Function of the calculator that says what to do instead.
    """

    name: str
    has: Callable[[Any, Any], bool]
    words: str
    mend: Callable[[Any], str]


@dataclass(frozen=True)
class Tool:
    """A function or class that declares the traits it accepts: its name, its module and the names of these traits."""

    name: str
    module: str
    takes: frozenset[str]


TRAITS: dict[str, Trait] = {}
TOOLS: dict[str, Tool] = {}
_running: ContextVar[Tool | None] = ContextVar('the declared tool that runs', default=None)


def takes(*names: str) -> Callable[[Callable[P, R]], Callable[P, R]]:
    """Declare that a tool accepts structures with these traits, and no others; the first argument named in HOLDERS is checked."""
    taken = frozenset(names)

    def declared(tool: Callable[P, R]) -> Callable[P, R]:
        arguments = [*inspect.signature(tool).parameters]
        own = tool.__qualname__.removesuffix('.__init__')
        given = next(name for name in arguments if name in HOLDERS)
        place = arguments.index(given)
        one = TOOLS[own] = Tool(own, tool.__module__, taken)

        @wraps(tool)
        def run(*args: P.args, **kwargs: P.kwargs) -> R:
            refuse(args[place] if len(args) > place else kwargs.get(given), one)
            before = _running.set(one)
            try:
                return tool(*args, **kwargs)
            finally:
                _running.reset(before)

        return run
    return declared


def refuse(given: Any, tool: Tool) -> None:
    """Raise ValueError if `given` has a trait that the tool does not support: atoms, a linear system, or an object with one."""
    given = getattr(given, 'system', given)
    atoms = getattr(given, 'atoms', given)
    calc = getattr(atoms, 'calc', None)
    if hasattr(calc, 'sites'):  # without a calculator of this package the tool itself raises an error
        refuse_of(atoms, calc, tool)


def all_but(what: str, *names: str) -> Tool:
    """A `Tool` for a special case named `what`, in which all traits are supported except those in `names`."""
    return Tool(what, __name__, frozenset(TRAITS) - frozenset(names))


def refuse_of(atoms: Any, calc: Any, tool: Tool) -> None:
    """Raise ValueError if atoms with the calculator `calc`, attached or not, have a trait that the tool does not support."""
    if 'constraints' not in tool.takes and atoms.constraints and _held(atoms):
        raise ValueError(refusal(calc, tool, TRAITS['constraints']))
    count, answers = vars(calc).get('_asked', (0, {}))  # copies of the calculator do not keep this, and `set` clears it
    if count != len(TRAITS):
        count, answers = calc._asked = len(TRAITS), {}
    if tool.takes not in answers:
        others = (one for one in TRAITS.values() if one.name not in tool.takes and one.name != 'constraints')
        answers[tool.takes] = next((one for one in others if one.has(atoms, calc)), None)
    if (found := answers[tool.takes]) is not None:
        raise ValueError(refusal(calc, tool, found))


def refusal(calc: Any, tool: Tool, trait: Trait) -> str:
    """The message with which a tool refuses a trait; it names related tools that accept the trait."""
    def apart(other):
        """Sort key: tools of the same file come first, then those of the same subpackage."""
        return other.module != tool.module, other.module.split('.')[1] != tool.module.split('.')[1], other.name

    others = [other.name for other in sorted(TOOLS.values(), key=apart) if trait.name in other.takes]
    instead = f' ({", ".join(others[:NAMED])} do)' if others else ''
    return f'{tool.name} does not support {trait.words}{instead}; {trait.mend(calc)}'


@cache
def caller(*also: str) -> Tool:
    """The `Tool` for callers that declare nothing: it accepts what masses and stiffness describe, and the traits in `also`."""
    return Tool('a tool without a declaration', __name__, frozenset(('all neighbours', *LIKE, *also)))


def running(*also: str) -> Tool:
    """The declared tool that is running; if there is none, the result of `caller`."""
    return _running.get() or caller(*also)


def trait(name: str, words: str, mend: str | Callable[[Any], str]) -> Callable[[Callable[[Any, Any], Any]], Trait]:
    """Decorator that declares a trait by a function of atoms and calculator, which says whether they have it."""
    def declared(has):
        told = mend if callable(mend) else lambda calc: str(mend)
        TRAITS[name] = Trait(name, lambda atoms, calc: bool(has(atoms, calc)), words, told)
        return TRAITS[name]
    return declared


def _held(atoms):
    """Whether constraints do more than keep planar particles in their plane."""
    return any(not isinstance(one, FixedPlane) or one.dir[:2].any() for one in atoms.constraints)


def _gyrating(calc):
    return (f'they gyrate at up to {1e3 * np.max(abs(np.asarray(calc.gyration))):.4g} rad/s; to ignore this, set atoms.calc.set('
            'gyration=0), or remove gyration_rad_per_s from the scene')


trait('all neighbours', 'the sum over all neighbours (AllNeighbours), in which bonds are not known one by one',
      'attach atoms.calc = PairCalculator(atoms, law, ...) with a number of shells; in a scene give shells a number')(
    lambda atoms, calc: not calc.pairwise)
trait('gyration', 'particles that gyrate', _gyrating)(lambda atoms, calc: np.any(calc.gyration))
trait('constraints', 'particles that are held or guided', 'remove the constraints with atoms.set_constraint()')(
    lambda atoms, calc: _held(atoms))
trait('conventional', "a calculator with model='conventional'", "set model='complete', as in atoms.calc.set(model='complete')")(
    lambda atoms, calc: calc.model != 'complete')
trait('oblique', 'forces that are not along the line between two particles',
      'if they are UprightMagnets, keep to motion in the plane with atoms.calc = atoms.calc.in_plane()')(
    lambda atoms, calc: calc.interaction.central(calc.dim) is None)

trait('radii', 'laws of the distance over the sum of both radii', 'leave out the radii, and give a law of the distance')(
    lambda atoms, calc: calc.sites.radii is not None)

LIKE = 'constraints', 'conventional', 'oblique', 'radii'
"""Traits accepted by tools that use only masses and the stiffness K."""
LINEAR = 'gyration', *LIKE
"""Traits accepted by tools that use M, B and K."""
