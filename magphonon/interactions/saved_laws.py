"""Conversion of pair laws to dictionaries of numbers, for files, and back; the laws of this package are saved by name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING

import numpy as np

from ..errors import one_of
from .magnet_pairs import MagnetLaw, SphereLaw
from .pair_laws import Hertz, InversePower, PairLaw, Yukawa
from .tabulated import Tabulated
from .upright import UprightMagnets

if TYPE_CHECKING:
    from typing import Any

    from .bond_laws import Potential

KNOWN = InversePower, Yukawa, Hertz, Tabulated, MagnetLaw, SphereLaw, UprightMagnets
LAWS: dict[str, Any] = {law.__name__: law for law in KNOWN}
"""Laws that can be saved by name."""


def potential_to_dict(potential: Potential) -> dict[str, Any]:
    """A law, or the laws of pairs of kinds, as a dictionary for files."""
    if isinstance(potential, Mapping):
        return {'pairs': [{'kinds': list(kinds)} | law_to_dict(law) for kinds, law in potential.items()]}
    return law_to_dict(potential)


def potential_from_dict(saved: dict[str, Any]) -> Potential:
    """The potential that `potential_to_dict` wrote, equal to the last bit; errors as in `law_from_dict`."""
    if 'pairs' not in saved:
        return law_from_dict(saved)
    laws = {}
    for pair in saved['pairs']:
        low, high = pair['kinds']
        laws[int(low), int(high)] = law_from_dict({key: value for key, value in pair.items() if key != 'kinds'})
    return laws


def law_to_dict(law: PairLaw) -> dict[str, Any]:
    """The name of a law and its parameters in mm, mJ; for a law that is not of this package, only its name and its `repr`."""
    if LAWS.get(type(law).__name__) is not type(law):
        return {'law': type(law).__qualname__, 'text': repr(law)}
    parameters = {field.name: getattr(law, field.name) for field in fields(law) if field.init}  # pyright: ignore[reportArgumentType]  all are dataclasses
    within = {name: law_to_dict(value) for name, value in parameters.items() if isinstance(value, PairLaw)}
    return {'law': type(law).__name__} | parameters | within


def law_from_dict(saved: dict[str, Any]) -> PairLaw:
    """The law that `law_to_dict` wrote, with the same parameters to the last bit.

    Raises
    ------
    ValueError
        For a law that is not of this package, because its formula is not in the file.
    """
    parameters = dict(saved)
    name = parameters.pop('law')
    if 'text' in parameters:
        raise ValueError(f'the law {parameters["text"]} is not one of {", ".join(LAWS)}, and its formula is not in the file; '
                         'give the law itself, fromdict(parameters, potential=law)')
    arrays = {key: law_from_dict(value) if isinstance(value, dict) else np.array(value) if np.ndim(value) else float(value)
              for key, value in parameters.items()}
    return LAWS[one_of('the law', name, tuple(LAWS))](**arrays)
