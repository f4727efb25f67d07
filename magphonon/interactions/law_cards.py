"""The card of a law: what scenes, fits and verdicts must know about a law besides its three methods.

    @dataclass(frozen=True)
    class Exponential:
        strength: float  # mJ
        length: float  # mm

        card: ClassVar = Card(kinds=(Kind('exponential', 'Energy `strength exp(-r/length)`.', {
            'energy': Parameter('energy_J', u.J, 'the energy in J', power=1),
            'decay_length': Parameter('decay_length_m', u.m, 'the length over which it falls in m', quantity='length')},
            lambda energy, decay_length: Exponential(energy, decay_length)),))

If this class is listed in `magphonon/interactions/__init__.pyi`, scenes may use `kind = "exponential"`, and fit its strength or
give it a tolerance.  Two laws may use the same parameter name only with the same key.  A law without a card, such as one defined
in a script, is taken as a force along the line between two particles.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from .. import units


@dataclass(frozen=True)
class LawDerivative:
    """Derivative of a pair law with respect to a parameter, with the methods of a law that stiffness needs."""

    dphi: Callable[..., Any]
    d2phi: Callable[..., Any]


@dataclass(frozen=True)
class Parameter:
    """A number of a law, as scenes, fits and tolerances name it.

    Attributes
    ----------
    key : str
        Its key in a scene, with the unit: 'screening_length_m'.
    unit : float
        The unit of the key in mm, g, ms.
    words : str
        Description of the key, for the list of keys.
    power : int
        Power of the parameter to which the force is proportional; 0 for every other parameter.
    change : callable, optional
        Only for the parameter that says how fast the force falls: `change(law, length)` is the derivative of a law by the
        logarithm of this parameter. The number of its strength, such as b in N m^a, stays constant; `length` is its m in mm.
    quantity : {'positive', 'length', 'force', 'pressure', 'ratio'}
        Which values the parameter may have.
    examples : tuple
    """

    key: str
    unit: float = 1.0
    words: str = ''
    power: int = 0
    change: Callable[[Any, float], LawDerivative] | None = None
    quantity: str = 'positive'
    examples: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Kind:
    """A `law.kind` of scenes: its parameters by their names in fits and tolerances, and `made`, which makes a law of them.

    Kinds without `made` have a table of their own in `magphonon.scenes.laws`.
    """

    name: str
    words: str = ''
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    made: Callable[..., Any] | None = None

    @property
    def strength(self) -> str:
        """Name of the first parameter for which the force is proportional to one of its powers; '' if there is none."""
        return next((name for name, one in self.parameters.items() if one.power), '')

    @property
    def shape(self) -> str:
        """Name of the parameter that says how fast the force falls; '' if there is none."""
        return next((name for name, one in self.parameters.items() if one.change), '')


@dataclass(frozen=True)
class Card:
    """What scenes, fits and verdicts must know about a law besides its methods.

    Attributes
    ----------
    magnets : bool
        Whether it may be the law of magnets with axes normal to the plane. Out of the plane, the forces of such magnets are not
        along the line between them.
    kinds : tuple of Kind
        The kinds under which scenes name the law.
    """

    magnets: bool = False
    kinds: tuple[Kind, ...] = ()


def card_of(law: Any) -> Card:
    """The card of a law; if it has none, the card of a central force."""
    return getattr(law, 'card', Card())


def kinds_of_laws() -> dict[str, Kind]:
    """All kinds of laws that scenes know, by name, from the cards of the laws that `magphonon.interactions` exports."""
    from importlib import import_module

    room = import_module(__name__.rpartition('.')[0])  # of which `bond_laws` and others need no magnets
    cards = [vars(law).get('card') for law in (getattr(room, name) for name in room.__all__) if isinstance(law, type)]
    return {kind.name: kind for card in cards if isinstance(card, Card) for kind in card.kinds}


def exponent_change(law: Any, length: float = units.m) -> LawDerivative:
    """Derivative of an InversePower with respect to ln a, at a constant force at the distance `length`."""
    def x(r):
        return law.a * np.log(r / length)

    return LawDerivative(lambda r: -x(r) * law.dphi(r), lambda r: (1 - x(r)) * law.d2phi(r))


def screening_change(law: Any, _: float = units.m) -> LawDerivative:
    """Derivative of a Yukawa law by the logarithm of its screening length."""
    return LawDerivative(lambda r: law.kappa * (law.phi(r) + r * law.dphi(r)),
                     lambda r: law.kappa * (2 * law.dphi(r) + r * law.d2phi(r)))
