"""Which law each bond has, in structures whose particles are not all alike; and laws as dictionaries of numbers, for files.

Particles of different kinds repel by different laws. Particles of different strengths s have the energy

    s_i s_j phi(r)

like magnets with the moments s_i and s_j.  Particles with radii R repel as a function of `r/(R_i + R_j)`, like soft spheres, and
a law with a method `between(R_i, R_j)` is multiplied by what it returns (`Overlap`).  `laws_along` finds the law and the strength
of each bond.  `BondLaws` holds those of all bonds as one object, which is itself a pair law: for the lengths of
all bonds it returns one number for each.  Code that uses it need not know that the bonds differ.  If all bonds have the same law,
`laid` returns that law.
"""

from __future__ import annotations

import sys
from collections.abc import Mapping
from dataclasses import dataclass, fields, is_dataclass
from importlib import import_module
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..errors import finite, one_of, shown, whole
from .pair_laws import Composed, PairInteraction, PairLaw

Law = PairLaw | PairInteraction
"""A law of the distance, or an interaction that depends on the vector."""
Laws = Law | Mapping[tuple[int, int], Law]
"""One law, or one for each pair of kinds of particles."""
DERIVATIVES = 'phi', 'dphi', 'd2phi'
"""The methods of a law of the distance: itself and its derivatives."""
NEEDED = {'central': ('forces', 'stiffness', 'central'), 'phi': DERIVATIVES}
"""The methods of an interaction, which is recognised by its `central`, and those of a law of the distance."""


def laws_of(laws: Laws) -> tuple[Law, ...]:
    """All laws in `laws`, which may be a single law or a mapping from pairs of kinds."""
    return tuple(laws.values()) if isinstance(laws, Mapping) else (laws,)


def checked_laws(laws: Laws) -> Laws:
    """The laws after a check, with each pair of kinds in ascending order."""
    for law in laws_of(laws):
        methods = NEEDED['central' if hasattr(law, 'central') else 'phi']
        for missing in [name for name in methods if not callable(getattr(law, name, None))][:1]:
            raise ValueError(f'the law {law!r} lacks the method {missing}; see magphonon.interactions.PairLaw, and '
                             'PairInteraction for forces that are not along the line between two particles')
    return _by_kinds(laws) if isinstance(laws, Mapping) else laws


def _by_kinds(laws):
    """The laws with each pair of kinds in ascending order."""
    ordered = {}
    for pair, law in laws.items():
        if not (isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(kind, (int, np.integer)) for kind in pair)):
            raise ValueError(f'laws belong to pairs of kinds, the tags of particles, as (0, 1), not to {shown(pair)}')
        low, high = sorted(map(int, pair))
        if ordered.setdefault((low, high), law) is not law:
            raise ValueError(f'the kinds {low} and {high} have two laws, {ordered[low, high]!r} and {law!r}: the order of a pair '
                             'does not matter; give only one of the laws')
    return ordered


def laws_along(laws: Laws, i: NDArray[np.intp], j: NDArray[np.intp], kinds: NDArray[np.intp],
               strengths: NDArray[np.float64]) -> tuple[tuple[Law, ...], NDArray[np.intp], NDArray[np.float64]]:
    """The `checked_laws` that occur, the index of the law of each bond between particles i and j, and its strength."""
    strength = strengths[i] * strengths[j]
    if not isinstance(laws, Mapping):
        return (laws,), np.zeros(len(i), int), strength
    pairs = np.sort(np.column_stack([kinds[i], kinds[j]]), axis=1)
    which = np.full(len(i), -1)
    for k, pair in enumerate(laws):
        which[(pairs == pair).all(axis=1)] = k
    for b in np.flatnonzero(which < 0)[:1]:
        low, high = pairs[b].tolist()
        raise ValueError(f'the particles {i[b]} and {j[b]} are bonded, but no law is given for their kinds, {low} and {high}; '
                         f'add ({low}, {high}) to the laws, or give them other tags (the kind of a particle is its tag)')
    used, which = np.unique(which, return_inverse=True)
    each = laws_of(laws)
    return tuple(each[k] for k in used), which, strength


@dataclass(frozen=True, eq=False)
class BondLaws(Composed):
    """The pair laws of bonds that differ: `strength * law(r/scale)` for each bond.

    Its methods take distances whose first axis is that of the bonds.
    """

    laws: tuple[PairLaw, ...]  # the different laws
    which: NDArray[np.intp]  # shape (bonds,): index of the law of each bond in `laws`
    strength: NDArray[np.float64]  # shape (bonds,): factor of the law of each bond
    scale: NDArray[np.float64]  # shape (bonds,): the sum of both radii, or 1 where the law is one of the distance itself

    def _part(self, name, r):
        strength, scale = (each.reshape(each.shape + (1,) * (np.ndim(r) - each.ndim)) for each in (self.strength, self.scale))
        strength, r = strength / scale ** DERIVATIVES.index(name), r / scale
        if len(self.laws) == 1:
            return strength * getattr(self.laws[0], name)(r)
        found = np.empty(r.shape, r.dtype)
        for law, own in groups(self, len(r)):
            found[own] = getattr(law, name)(r[own])
        return strength * found


def laid(laws: tuple[PairLaw, ...], which: NDArray[np.intp], strength: NDArray[np.float64],
         scale: NDArray[np.float64] | None = None) -> PairLaw:
    """`BondLaws` with only the laws that occur; the law itself if all bonds have the same law, the strength 1 and the scale 1."""
    scale = np.ones(len(strength)) if scale is None else scale
    if len(laws) > 1:
        used, which = np.unique(which, return_inverse=True)
        laws = tuple(laws[k] for k in used)
    return laws[0] if len(laws) == 1 and (strength == 1).all() and (scale == 1).all() else BondLaws(laws, which, strength, scale)


def taken(law: PairLaw, bonds: Any) -> PairLaw:
    """The law of some of the bonds, chosen by their indices or by a mask; the law of a single bond if `bonds` is one number."""
    if not isinstance(law, BondLaws):
        return law
    return laid(law.laws, law.which[bonds], law.strength[bonds], law.scale[bonds])


def labels(law: PairLaw, bonds: int) -> NDArray[np.intp]:
    """An integer label for each bond, equal for bonds of the same law, strength and scale; shape (bonds,)."""
    if not isinstance(law, BondLaws):
        return np.zeros(bonds, int)
    return np.unique(np.column_stack([law.which, law.strength, law.scale]), axis=0, return_inverse=True)[1].ravel()


def groups(law: PairLaw, bonds: int) -> list[tuple[PairLaw, NDArray[np.intp]]]:
    """The different laws, without strengths, each with the indices of its bonds."""
    if not isinstance(law, BondLaws):
        return [(law, np.arange(bonds))]
    return [(one, np.flatnonzero(law.which == k)) for k, one in enumerate(law.laws)]


def laws_to_dict(laws: Laws) -> dict[str, Any]:
    """A law, or the laws of pairs of kinds, as a dictionary for files."""
    if isinstance(laws, Mapping):
        return {'pairs': [{'kinds': list(kinds)} | law_to_dict(law) for kinds, law in laws.items()]}
    return law_to_dict(laws)


def laws_from_dict(saved: dict[str, Any]) -> Laws:
    """The laws that `laws_to_dict` wrote, equal to the last bit; errors as in `law_from_dict`."""
    if not isinstance(saved, dict) or 'pairs' not in saved:
        return law_from_dict(saved)
    laws = {}
    for pair in saved['pairs'] if isinstance(saved['pairs'], list | tuple) else [None]:
        if not isinstance(pair, dict) or not isinstance(pair.get('kinds'), list | tuple) or len(pair['kinds']) != 2:
            raise ValueError(f'each of the saved pairs must have two kinds and their law, not {shown(pair)}')
        low, high = (whole('the kind of a saved pair', kind, least=0) for kind in pair['kinds'])
        laws[low, high] = law_from_dict({key: value for key, value in pair.items() if key != 'kinds'})
    return laws


def saved_by_name(law: Law) -> bool:
    """Whether a file can hold the law: a dataclass of numbers, arrays and laws that can be imported from its module by name."""
    kind = type(law)
    try:
        found = _named(_name(kind)) is kind and is_dataclass(kind)
        return found and all(saved_by_name(value) if _is_law(value) else bool(np.isfinite(np.asarray(value, float)).all())
                             for value in _parameters(law).values())
    except (TypeError, ValueError):
        return False


def law_to_dict(law: Law) -> dict[str, Any]:
    """The name of a law and its parameters in mm, mJ; only the name and the `repr` of a law that is no dataclass of numbers.

    A law of a script is named with its module, as 'mylab.laws:Exponential'.
    """
    if not saved_by_name(law):
        return {'law': type(law).__qualname__, 'text': repr(law)}
    return {'law': _name(type(law))} | {key: law_to_dict(value) if _is_law(value) else value
                                        for key, value in _parameters(law).items()}


def law_from_dict(saved: dict[str, Any]) -> Law:
    """The law that `law_to_dict` wrote, with the same parameters to the last bit.

    Raises
    ------
    ValueError
        For a law whose formula is not in the file and not in a module that is imported already: reading a file runs no code.
    """
    if not isinstance(saved, dict) or 'law' not in saved:
        raise ValueError(f"a saved law must be a dict with 'law', the name of the law, and its parameters, not {shown(saved)}")
    parameters = dict(saved)
    name = parameters.pop('law')
    kind = _kind_of(name, parameters)
    needed = [field.name for field in fields(kind) if field.init]
    if set(parameters) != set(needed):
        raise ValueError(f'a saved {name} must have {" and ".join(needed)}, not {", ".join(map(str, parameters)) or "nothing"}')
    return kind(**{key: law_from_dict(value) if isinstance(value, dict) else _numbers(f'{name}.{key}', value)
                   for key, value in parameters.items()})


def _kind_of(name, parameters) -> Any:
    """The class of a saved law."""
    if 'text' in parameters:
        raise ValueError(f'the law {parameters["text"]} is not one of {", ".join(_own())}, nor a dataclass of numbers in a '
                         'module, and its formula is not in the file; give the law itself, fromdict(parameters, laws=law)')
    kind = _named(name if isinstance(name, str) and ':' in name else one_of('the law', name, _own()))
    if kind is None:
        raise ValueError(f'the law {shown(name)} is in no module that is imported; import its module first, or give the law '
                         'itself, fromdict(parameters, laws=law)')
    return kind


def _is_law(value):
    return any(callable(getattr(value, methods[0], None)) for methods in NEEDED.values())


def _parameters(law):
    return {field.name: getattr(law, field.name) for field in fields(law) if field.init}


def _own():
    """The names of the laws of this package: the classes in `magphonon.interactions` that have the methods of a law."""
    room = import_module(__name__.rpartition('.')[0])  # this also imports the magnets, which this file does not need
    return tuple(name for name in room.__all__ if _named(name))


def _name(kind):
    inside = kind.__module__.startswith(f'{__package__}.')
    return kind.__name__ if inside else f'{kind.__module__}:{kind.__qualname__}'


def _named(name):
    """The class of this name in `magphonon.interactions` or in a module that is already imported; None if it is no law."""
    module, _, name = name.rpartition(':')
    room = sys.modules.get(module) if module else import_module(__name__.rpartition('.')[0])
    found = getattr(room, name, None)
    law = isinstance(found, type) and is_dataclass(found) and any(
        all(callable(getattr(found, method, None)) for method in methods) for methods in NEEDED.values())
    return found if law else None


def _numbers(name, value):
    if isinstance(value, bool):  # a choice, as whether contacts are elastic
        return value
    found = finite(name, value)
    return found if found.ndim else float(found)
