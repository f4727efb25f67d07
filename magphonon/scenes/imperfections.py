"""The tables [defects] and [disorder] of a scene: vacancies, substitutions, interstitials, and random scatter of the sites."""

from __future__ import annotations

from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from .. import units as u
from ..errors import whole
from ..stiffness.constraints import freedom
from ..stiffness.defects import LARGEST_SCATTER, Scatter, scattered, substituted, with_interstitial, without
from .fields import Allowed, NotNegative, Point, Points, Positive, Table, listed, within

if TYPE_CHECKING:
    from ase import Atoms

Factor = Annotated[Positive, within(1e-6, 1e6, 'multiples of that of its neighbours')]
NotNegativeFactor = Annotated[NotNegative, within(0, 1e6, 'multiples of that of its neighbours')]
Kind = Annotated[int, BeforeValidator(partial(whole, '', least=0)), Allowed('0 or more')]
Percent = Annotated[NotNegative, within(0, 100 * LARGEST_SCATTER, 'percent')]


class Guest(Table):
    """Another particle, by its mass, strength and stiffness relative to the particle with which it is compared."""

    at_m: Point = Field(description='the place [x, y] in m', examples=[[0.0, 0.0]])
    relative_mass: Factor = Field(1.0, description='factor of the mass', examples=[0.5])
    relative_strength: NotNegativeFactor = Field(1.0, description='factor of the strength, for example of its magnetic moment',
                                                 examples=[0.5])
    relative_stiffness: NotNegativeFactor = Field(1.0, description='factor of the stiffness of its foundation', examples=[0.0])

    kind: Kind | None = Field(None, description='its kind, which chooses among [[laws_of_kinds]]', examples=[1])

    @property
    def properties(self) -> dict[str, Any]:
        """The arguments of `magphonon.stiffness.substituted`."""
        return {'mass': self.relative_mass, 'strength': self.relative_strength, 'stiffness': self.relative_stiffness,
                'kind': self.kind}


class Substitution(Guest):
    """A particle that replaces the one nearest to the place."""


class Interstitial(Guest):
    """An additional particle, relative to the nearest one; it repels all particles within the cutoff of the bonds."""


class Defects(Table):
    """Defects of the patch or of the finite structure, which then relaxes; places are those before it relaxes."""

    vacancies_m: Points = Field((), description='places [x, y] in m, at each of which the nearest particle is missing',
                                examples=[[[0.0, 0.0]]])
    substitutions: Annotated[tuple[Substitution, ...], listed] = ()
    interstitials: Annotated[tuple[Interstitial, ...], listed] = ()

    @property
    def guests(self) -> tuple[Guest, ...]:
        """All substitutions and interstitials."""
        return self.substitutions + self.interstitials

    @model_validator(mode='after')
    def _something(self):
        if not (self.vacancies_m or self.substitutions or self.interstitials):
            raise ValueError(' names no defect; give vacancies_m, [[defects.substitutions]] or [[defects.interstitials]], or '
                             'take the table out')
        return self

    def applied(self, atoms: Atoms) -> Atoms:
        """The structure with these defects, not yet at rest.

        Raises
        ------
        ValueError
            Where no free particle stands near a place, or two defects mean the same one, or an interstitial has no room.
        """
        missing = [_site(f'vacancies_m[{k}]', atoms, place) for k, place in enumerate(self.vacancies_m)]
        others = [_site(f'substitutions[{k}].at_m', atoms, guest.at_m) for k, guest in enumerate(self.substitutions)]
        sites = missing + others
        for k in {site for site in sites if sites.count(site) > 1}:
            x, y = atoms.positions[k, :2] / u.m
            raise ValueError(f'defects names the particle at [{x:.6g}, {y:.6g}] twice; keep one of them')
        for guest, site in zip(self.substitutions, others, strict=True):
            atoms = substituted(atoms, site, **guest.properties)
        for k, guest in enumerate(self.interstitials):
            try:
                atoms = with_interstitial(atoms, np.array(guest.at_m) * u.m, **guest.properties)
            except ValueError as error:
                raise ValueError(f'defects.interstitials[{k}].at_m = {list(guest.at_m)}: {error}') from None
        return without(atoms, missing) if missing else atoms


def _site(key: str, atoms: Atoms, place: tuple[float, float]) -> int:
    """The free particle nearest to a place."""
    from ase.geometry import find_mic

    away = atoms.positions - np.array([*place, 0]) * u.m
    away[:, 2] = 0
    distances = find_mic(away, atoms.cell, atoms.pbc)[1]  # pyright: ignore[reportArgumentType]  three pbc
    nearest = int(np.argmin(distances))
    x, y = atoms.positions[nearest, :2] / u.m
    if distances[nearest] > atoms.calc.bonds.lengths.min():
        raise ValueError(f'defects.{key} = {list(place)} is outside the structure; the nearest particle is at [{x:.6g}, {y:.6g}]')
    if not freedom(atoms)[0][nearest]:
        raise ValueError(f'defects.{key} = {list(place)} is nearest to the held particle at [{x:.6g}, {y:.6g}]; '
                         'choose a place further inside')
    return nearest


class Disorder(Table):
    """Normally distributed scatter of the sites of the patch or of the finite structure, which then relaxes."""

    seed: Annotated[int, BeforeValidator(partial(whole, '', least=0)), Allowed('0 or more')] = Field(
        description='the seed of the random numbers; one seed gives one structure on every machine', examples=[1])
    position_m: Annotated[NotNegative, within(0, 1e6, 'metres')] = Field(
        0.0, description='the standard deviation of each coordinate of a particle and of its support in m', examples=[1e-5])
    strength_percent: Percent = Field(0.0, description='the standard deviation of the strengths (for example magnetic moments) '
                                      'in percent', examples=[1.0])
    mass_percent: Percent = Field(0.0, description='the standard deviation of the masses in percent', examples=[1.0])
    stiffness_percent: Percent = Field(0.0, description='the standard deviation of the stiffness of the foundation in percent',
                                       examples=[5.0])

    @model_validator(mode='after')
    def _something(self):
        if not (self.position_m or self.strength_percent or self.mass_percent or self.stiffness_percent):
            raise ValueError(' names nothing that scatters; give position_m, strength_percent, mass_percent or stiffness_percent')
        return self

    def applied(self, atoms: Atoms) -> Atoms:
        """The structure with its sites scattered, not yet at rest.

        Raises
        ------
        ValueError
            If the places scatter by more than a tenth of the shortest bond.
        """
        shortest = atoms.calc.bonds.lengths.min()
        if self.position_m * u.m > shortest / 10:
            raise ValueError(f'disorder.position_m = {self.position_m!r} is more than a tenth of the distance of nearest '
                             f'particles, {shortest / u.m:.4g} m, beyond which neighbours change places; check its '
                             'unit, which is m')
        percent = (self.strength_percent, self.mass_percent, self.stiffness_percent)
        return scattered(atoms, Scatter(self.position_m * u.m, *(value / 100 for value in percent)), self.seed)
