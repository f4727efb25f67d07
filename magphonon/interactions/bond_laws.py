"""The pair law of each bond, for structures whose particles are not all alike.

Particles of different kinds repel by different laws, particles of different strengths s by

    s_i s_j phi(r)

as magnets of the moments s_i and s_j do.  `law_along` finds the law of each bond and returns all of them as one object, which is
itself a pair law: evaluated at the lengths of all bonds it gives one number for each bond.  Code that uses it need not know
that the bonds differ.  If all bonds have the same law, `law_along` returns that law.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..errors import shown
from .upright import UprightMagnets

if TYPE_CHECKING:
    from typing import Any

    from numpy.typing import NDArray

    from .pair_laws import PairLaw

    Potential = PairLaw | Mapping[tuple[int, int], PairLaw]
    """One law, or one for each pair of kinds of particles."""


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
