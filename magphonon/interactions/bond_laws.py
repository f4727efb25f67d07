"""The pair law of each bond, for structures whose particles are not all alike.

Particles of different kinds repel by different laws, particles of different strengths s by

    s_i s_j phi(r)

as magnets of the moments s_i and s_j do.  `law_along` finds the law of each bond and returns all of them as one object, which is
itself a pair law: evaluated at the lengths of all bonds it gives one number for each bond.  Code that uses it need not know
that the bonds differ.  If all bonds have the same law, `law_along` returns that law.

Conversion of pair laws to dictionaries of numbers, for files, and back; the laws of this package are saved by name.

Stiffness out of the plane of a pair of magnets whose axes are normal to the plane.

The axes of the magnets of a lattice are normal to its plane, and supports keep them from turning.  If they are round, the energy
U of a pair depends on the distance rho in the plane and on the difference z of heights.  Outside the magnets U obeys Laplace's
equation, therefore

    U_zz = -(phi'' + phi'/rho) = g(rho)    at z = 0,  where U = phi(rho)

and to second order in z

    U(rho, z) = phi(rho) + g(rho) z^2/2

An inverse power phi' = -f, f = b rho^-a, has g = -(a - 1) f/rho: as long as a > 1 the magnets push each other out of the plane,
for dipoles (a = 4) three times as strongly as a force along the line that joins them, which has phi'/rho = -f/rho.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import numpy as np

from ..errors import one_of, shown
from .magnet_pairs import MagnetLaw, SphereLaw
from .pair_laws import Hertz, InversePower, PairLaw, Tabulated, Yukawa, higher_derivatives

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    Potential = PairLaw | Mapping[tuple[int, int], PairLaw]
    """One law, or one for each pair of kinds of particles."""

@dataclass(frozen=True)
class UprightMagnets:
    """The pair law of magnets with axes normal to a plane; for motion in the plane it is `planar`.

    It differs from `planar` only if the particles move out of the plane (`MagneticRepulsion` with `foundation=[[k, k, kz]]`).  A
    law that is not wrapped in it is that of a force along the line that joins two particles, as between charges or grains of
    dust.

    Attributes
    ----------
    planar : PairLaw
        Energy of two magnets at the same height.

    Examples
    --------
    >>> from magphonon import InversePower
    >>> from magphonon.interactions import UprightMagnets
    >>> dipoles = UprightMagnets(InversePower(b=8.0, a=4.0))
    >>> float(dipoles.dphi(2.0)), float(dipoles.vertical(2.0))
    (-0.5, -0.75)
    """

    planar: PairLaw

    def phi(self, r: Any) -> Any:
        """Energy in mJ at equal height."""
        return self.planar.phi(r)

    def dphi(self, r: Any) -> Any:
        """First derivative of the energy at equal height, in N."""
        return self.planar.dphi(r)

    def d2phi(self, r: Any) -> Any:
        """Second derivative of the energy at equal height, in N/mm."""
        return self.planar.d2phi(r)

    def vertical(self, r: Any) -> Any:
        """Stiffness g of a pair out of the plane in N/mm, at the distances `r` in mm."""
        return -(self.planar.d2phi(r) + self.planar.dphi(r) / r)

    def vertical_derivatives(self, r: Any) -> tuple[Any, Any]:
        """First and second derivative of `vertical` with respect to the distance, in N/mm^2 and N/mm^3."""
        p1, p2, (p3, p4) = self.planar.dphi(r), self.planar.d2phi(r), higher_derivatives(self.planar, r)
        return -(p3 + p2 / r - p1 / r**2), -(p4 + p3 / r - 2 * p2 / r**2 + 2 * p1 / r**3)


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


@dataclass(frozen=True, eq=False)
class BondLaws:
    """The pair laws of bonds that differ: `strength * law(r)` for each bond.

    Its methods take distances whose first axis is that of the bonds.

    Attributes
    ----------
    laws : tuple of PairLaw
        The different laws.
    which : ndarray of int, shape (bonds,)
        Index of the law of each bond in `laws`.
    strength : ndarray, shape (bonds,)
        Factor of the law of each bond.
    """

    laws: tuple[PairLaw, ...]
    which: NDArray[np.intp]
    strength: NDArray[np.float64]

    def phi(self, r: Any) -> Any:
        """Energy of each bond in mJ at the distances `r` in mm, shape (bonds, ...)."""
        return self._each('phi', r)

    def dphi(self, r: Any) -> Any:
        """First derivative of the energy of each bond in N."""
        return self._each('dphi', r)

    def d2phi(self, r: Any) -> Any:
        """Second derivative of the energy of each bond in N/mm."""
        return self._each('d2phi', r)

    def _each(self, name, r):
        strength = self.strength.reshape(self.strength.shape + (1,) * (np.ndim(r) - self.strength.ndim))
        if len(self.laws) == 1:
            return strength * getattr(self.laws[0], name)(r)
        found = np.empty(r.shape, r.dtype)
        for law, own in groups(self, len(r)):
            found[own] = getattr(law, name)(r[own])
        return strength * found


def laid(laws: tuple[PairLaw, ...], which: NDArray[np.intp], strength: NDArray[np.float64]) -> PairLaw:
    """`BondLaws` with only the laws that occur; the law itself if all bonds have the same law and the strength 1."""
    used, which = np.unique(which, return_inverse=True)
    laws = tuple(laws[k] for k in used)
    return laws[0] if len(laws) == 1 and (strength == 1).all() else BondLaws(laws, which, strength)


def taken(law: PairLaw, bonds: Any) -> PairLaw:
    """The law of some of the bonds, chosen by their indices or by a mask; the law of a single bond if `bonds` is one number."""
    if isinstance(law, UprightMagnets):
        return UprightMagnets(taken(law.planar, bonds))
    return laid(law.laws, law.which[bonds], law.strength[bonds]) if isinstance(law, BondLaws) else law


def labels(law: PairLaw, bonds: int) -> NDArray[np.intp]:
    """An integer label for each bond, equal for bonds of the same law and strength; shape (bonds,)."""
    law = _in_plane(law)
    if not isinstance(law, BondLaws):
        return np.zeros(bonds, int)
    return np.unique(np.column_stack([law.which, law.strength]), axis=0, return_inverse=True)[1].ravel()


def groups(law: PairLaw, bonds: int) -> list[tuple[PairLaw, NDArray[np.intp]]]:
    """The different laws, without strengths, each with the indices of its bonds; for upright magnets the law in the plane."""
    law = _in_plane(law)
    if not isinstance(law, BondLaws):
        return [(law, np.arange(bonds))]
    return [(one, np.flatnonzero(law.which == k)) for k, one in enumerate(law.laws)]


def _in_plane(law):
    return law.planar if isinstance(law, UprightMagnets) else law


def laws_of(potential: Potential) -> tuple[PairLaw, ...]:
    """All laws of a potential."""
    return tuple(potential.values()) if isinstance(potential, Mapping) else (potential,)


def checked_potential(potential: Potential) -> Potential:
    """The potential, each pair of kinds in ascending order.

    Raises
    ------
    ValueError
        If a law lacks a method, or the pairs are not pairs of kinds, each given once.
    """
    for law in laws_of(potential):
        missing = [name for name in ('phi', 'dphi', 'd2phi') if not callable(getattr(law, name, None))]
        if missing:
            raise ValueError(f'the potential {law!r} lacks the method {missing[0]}(r); see magphonon.interactions.PairLaw')
    if not isinstance(potential, Mapping):
        return potential
    ordered = {}
    for pair, law in potential.items():
        if not (isinstance(pair, tuple) and len(pair) == 2 and all(isinstance(kind, (int, np.integer)) for kind in pair)):
            raise ValueError(f'laws belong to pairs of kinds, the tags of particles, as (0, 1), not to {shown(pair)}')
        low, high = sorted(map(int, pair))
        if ordered.setdefault((low, high), law) is not law:
            raise ValueError(f'the kinds {low} and {high} have two laws, {ordered[low, high]!r} and {law!r}: the order of a pair '
                             'does not matter; give one of them')
    return ordered


def law_along(potential: Potential, i: NDArray[np.intp], j: NDArray[np.intp], kinds: NDArray[np.intp],
              strengths: NDArray[np.float64]) -> PairLaw:
    """The law of each bond between the particles i and j.

    Parameters
    ----------
    potential : PairLaw, or mapping from pairs of kinds to PairLaw
        As `checked_potential` returns it.
    i, j : ndarray of int, shape (bonds,)
    kinds : ndarray of int, shape (particles,)
    strengths : ndarray, shape (particles,)

    Raises
    ------
    ValueError
        If two particles are bonded whose kinds have no law, or some laws are those of upright magnets and some are not.
    """
    upright = [law.planar for law in laws_of(potential) if isinstance(law, UprightMagnets)]
    if upright:
        if len(upright) < len(laws_of(potential)):
            raise ValueError('some laws of the potential are those of UprightMagnets and some are not, but the law out of the '
                             'plane between a magnet and a particle without a moment is unknown: make all of them '
                             'UprightMagnets, or none')
        bare = dict(zip(potential, upright, strict=True)) if isinstance(potential, Mapping) else upright[0]
        return UprightMagnets(law_along(bare, i, j, kinds, strengths))
    strength = strengths[i] * strengths[j]
    if not isinstance(potential, Mapping):
        return laid((potential,), np.zeros(len(i), int), strength)
    pairs = np.sort(np.column_stack([kinds[i], kinds[j]]), axis=1)
    which = np.full(len(i), -1)
    for k, pair in enumerate(potential):
        which[(pairs == pair).all(axis=1)] = k
    for b in np.flatnonzero(which < 0)[:1]:
        low, high = pairs[b].tolist()
        raise ValueError(f'the particles {i[b]} and {j[b]} are bonded, but no law is given for their kinds, {low} and {high}; '
                         f'add ({low}, {high}) to the potential, or give them other tags (the kind of a particle is its tag)')
    return laid(tuple(potential.values()), which, strength)
