"""The table [uncertainty] of a scene: standard deviations of its parameters, and lattices drawn from them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated, Any

import numpy as np
from pydantic import BeforeValidator, Field, create_model

from .. import units as u
from ..design.scatter import ALIKE, SITES, SiteScatter
from ..design.sensitivities import LawDerivative, StiffnessDerivative, force_change, spacing_change
from ..design.uncertainty import Tolerances
from .fields import Number, Positive, Table
from .laws import KINDS
from .structures import FileLattice

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairLaw
    from .scene import Scene

PLACES = {
    'spacing': ('lattice', 'spacing_m'),
    'mass': ('lattice', 'mass_kg'),
    **{name: ('law', one.key) for kind in KINDS.values() for name, one in kind.parameters.items() if one.power or one.change},
    'stiffness': ('foundation', 'stiffness_N_per_m'),
    'stiffness_y': ('foundation', 'stiffness_y_N_per_m'),
    'youngs_modulus': ('foundation', 'pillar', 'youngs_modulus_Pa'),
    'radius': ('foundation', 'pillar', 'radius_m'),
    'height': ('foundation', 'pillar', 'height_m'),
}
"""Place of each parameter in a scene.  The key there is that of the absolute tolerance; NAME_percent is that of the relative
one."""
PILLAR_POWERS = {'youngs_modulus': 1, 'radius': 4, 'height': -3}  # powers of the parameters in k = 3 E (pi R^4/4)/H^3
LARGEST_TOLERANCE = 0.5
"""Largest relative standard deviation: with twice this value random exponents overflow, and a change by half is no small
change."""


def _correlation(value):
    if not isinstance(value, float | int) or not -1 < value < 1:
        raise ValueError(f' must lie between -1 and 1, not {value!r}')
    return float(value)


Correlation = Annotated[Number, BeforeValidator(_correlation)]


class _Uncertainty(Table):
    """Standard deviations of the parameters, absolute in the unit of the key or in percent; what is not named is exact.

    Those named `each_...` belong to each magnet or pillar by itself, the others to all of them alike.
    """

    correlation_a_b: Correlation | None = Field(None, description='the correlation of a and b')
    exponent: Positive | None = Field(
        None, description='for a table of forces: the standard deviation of its exponent, -d ln f/d ln r at the spacing')
    each_position_m: Positive | None = Field(
        None, description='the standard deviation of each coordinate of the feet of pillars and of held particles, from site to '
        'site; with lattice.positions = "rest", of each position measured in a photo', examples=[1e-4])
    scale_percent: Positive | None = Field(
        None, description='for particles from a file: the standard deviation of the scale of all lengths, in percent')
    correlation_forces_exponent: Correlation | None = Field(
        None, description='the correlation of forces and exponent, as "magphonon fit" prints it')

    def tolerances(self, scene: Scene) -> Tolerances:
        changes = _changes(scene)
        sigma = self._sigma(scene, changes)
        scatter = self._scatter(scene)
        if not sigma and not scatter:
            raise ValueError('uncertainty names no tolerance; add one, such as spacing_percent = 1.0')
        C, names = np.diag(np.square(list(sigma.values()))).reshape(len(sigma), len(sigma)), list(sigma)
        for one, other in (('a', 'b'), ('forces', 'exponent')):
            key = f'correlation_{one}_{other}'
            if getattr(self, key) is None:
                continue
            if not {one, other} <= sigma.keys():
                raise ValueError(f'uncertainty.{key} is a correlation and needs the tolerances of both {one} and {other}; add '
                                 f'them')
            i, j = names.index(one), names.index(other)
            C[i, j] = C[j, i] = getattr(self, key) * sigma[one] * sigma[other]
        return Tolerances({name: changes[name] for name in sigma}, C, scatter)

    def of_structure(self, scene: Scene) -> tuple[SiteScatter, list[str]]:
        """The scatter of the sites of a structure, including deviations that all sites share; and the unused tolerances.

        A relative change of the force equals half that change of all strengths, a change of the spacing is one of all lengths,
        and a change of a pillar is one of its spring.  Changes of the law alone, such as of its exponent, and parameters
        correlated with them have no such equivalent and are unused.
        """
        known, alike, unused = self.tolerances(scene), {}, []
        kinds = KINDS[scene.law.kind].parameters if scene.law.kind in KINDS else {}
        springs = scene.foundation.changes if scene.foundation else {}
        powers = {'spacing': ('scale', 1.0), 'mass': ('mass', 1.0),
                  **({'stiffness': ('stiffness', 1.0)} if len(springs) == 1 else {}),
                  **{name: ('strength', one.power / 2) for name, one in kinds.items() if one.power and not one.change},
                  **{name: ('stiffness', float(power)) for name, power in PILLAR_POWERS.items()}}
        for row, name in zip(known.covariance, known.changes, strict=True):
            if name not in powers or np.count_nonzero(row) != 1:
                unused.append(name)
                continue
            what, power = powers[name]
            alike[what] = float(np.hypot(alike.get(what, 0.0), power * np.sqrt(row.max())))
        return replace(known.scatter, alike={**known.scatter.alike, **alike}), unused

    def _sigma(self, scene, changes):
        sigma = {}
        for name in PLACES:
            place = _place(scene, name)
            given = {f'{name}_percent': getattr(self, f'{name}_percent'), place[-1]: getattr(self, place[-1], None)}
            given = {key: value for key, value in given.items() if value is not None}
            if not given or (not changes and [*given] == [f'{name}_percent'] and name in ALIKE):  # of all sites, in `_scatter`
                continue
            if not changes:
                raise ValueError(f'uncertainty.{next(iter(given))}: for particles from a file only these are propagated: '
                                 + ', '.join(f'{name}_percent' for name in (*(f'each_{site}' for site in SITES), *ALIKE))
                                 + ' and each_position_m')
            if name not in changes:
                raise ValueError(f'uncertainty: {name} is no parameter of this scene; its parameters are {", ".join(changes)}')
            if len(given) > 1:
                raise ValueError(f'uncertainty has both {place[-1]} and {name}_percent; keep one of them')
            ((key, value),) = given.items()
            sigma[name] = value / 100 if key.endswith('_percent') else value / _at(scene, place)
            if sigma[name] > LARGEST_TOLERANCE:
                raise ValueError(f'uncertainty.{key} = {value!r} is {100 * sigma[name]:.4g} % of {name}, more than the '
                                 f'{100 * LARGEST_TOLERANCE:g} % up to which linear propagation holds; measure it better, or '
                                 'leave it out')
        if self.exponent is not None:
            if 'exponent' not in changes:
                raise ValueError('uncertainty.exponent belongs to a law that is a table of forces; leave it out')
            sigma['exponent'] = self.exponent
        return sigma

    def _scatter(self, scene):
        of_file = isinstance(scene.lattice, FileLattice)
        percent = {name: value for name in (*(f'each_{site}' for site in SITES), *ALIKE)
                   if (value := getattr(self, f'{name}_percent')) and (of_file or name not in SITES)}
        for name, value in percent.items():
            if not of_file and name == 'scale':
                raise ValueError('uncertainty.scale_percent belongs to particles from a file; write spacing_percent instead')
            if 'stiffness' in name and not np.any(scene.perfect_cell().calc.foundation):
                raise ValueError(f'uncertainty.{name}_percent belongs to a foundation, but the scene has none; leave it out')
            if value > 100 * LARGEST_TOLERANCE:
                raise ValueError(f'uncertainty.{name}_percent = {value!r} is more than the {100 * LARGEST_TOLERANCE:g} % '
                                 'up to which linear propagation holds; measure it better, or leave it out')
        each = {site: percent.get(f'each_{site}', 0.0) / 100 for site in SITES}
        return SiteScatter(**each, position=(self.each_position_m or 0.0) * u.m,
                           at_rest=getattr(scene.lattice, 'positions', None) == 'rest',
                           alike={name: percent[name] / 100 for name in ALIKE if name in percent})


_ABSOLUTE = [place[-1] for name, place in PLACES.items() if name != 'forces']  # of a table of forces: one factor for all
_KEYS = {key: Field(None, description=f'the standard deviation of {key}, in its unit') for key in _ABSOLUTE} | {
    f'{name}_percent': Field(None, description=f'the standard deviation of {name} in percent', examples=[1.0]) for name in PLACES
    } | {f'each_{name}_percent': Field(None, description=f'the standard deviation of {name} from site to site in percent',
                                       examples=[1.0]) for name in SITES}
if TYPE_CHECKING:
    Uncertainty = _Uncertainty  # with more keys
else:
    Uncertainty = create_model('Uncertainty', __base__=_Uncertainty, __doc__=_Uncertainty.__doc__,
                               **{key: (Positive | None, _KEYS[key]) for key in sorted(_KEYS)})


def _changes(scene):
    if isinstance(scene.lattice, FileLattice):
        return {}
    law, k = scene.law.potential(), scene.foundation.stiffness if scene.foundation else 0.0
    held = scene.lattice.spacing_m * u.m if getattr(scene.law, 'force_N', None) else u.m  # where `a` leaves the force as it is
    changes = {'spacing': StiffnessDerivative(law=spacing_change(law)), 'mass': StiffnessDerivative(mass=1.0)}
    for name, one in KINDS[scene.law.kind].parameters.items() if scene.law.kind in KINDS else ():
        if not (one.power or one.change) or _at(scene, _place(scene, name)) is None:
            continue
        if not (name == 'remanence' and scene.law.calibration):
            changes[name] = StiffnessDerivative(law=one.change(law, held) if one.change else force_change(law, one.power))
    if scene.law.kind == 'table':
        changes['exponent'] = StiffnessDerivative(law=exponent_at(law, scene.lattice.spacing_m * u.m))
    if k and scene.foundation.pillar:
        changes |= {name: StiffnessDerivative(foundation=power * k) for name, power in PILLAR_POWERS.items()}
    elif k:
        changes |= {name: StiffnessDerivative(foundation=change) for name, change in scene.foundation.changes.items()}
    return changes


def exponent_at(law: PairLaw, spacing: float) -> LawDerivative:
    """Derivative of a law by its exponent at constant force at the spacing (mm): that of f (r/spacing)^-delta by delta."""
    return LawDerivative(lambda r: -np.log(r / spacing) * law.dphi(r),
                     lambda r: -np.log(r / spacing) * law.d2phi(r) - law.dphi(r) / r)


def _place(scene, name):
    """The place of a parameter in the tables; the force of magnets is in a table of its own, their calibration."""
    return ('law', 'calibration', 'force_N') if name == 'force' and scene.law.kind == 'magnets' else PLACES[name]


def _at(table, place):
    for key in place:
        table = getattr(table, key, None)
    return table


def varied(scene: Scene, factors: Mapping[str, float]) -> Scene:
    """The scene with parameters multiplied by `factors`, a dict of their names; 1 + delta changes an exponent by delta."""
    for name, factor in factors.items():
        if name == 'exponent':
            law: Any = scene.law  # a table
            factor, name = (np.array(law.distances_m) / scene.lattice.spacing_m) ** (1 - factor), 'forces'
        scene = _multiplied(scene, _place(scene, name), factor)
    return scene


def _multiplied(table, place, factor):
    key, *rest = place
    value = getattr(table, key)
    if rest:
        value = _multiplied(value, rest, factor)
    else:
        value = tuple((factor * np.array(value)).tolist()) if isinstance(value, tuple) else factor * value
    return table.model_copy(update={key: value})
