"""The table [uncertainty] of a scene: how well the spacing, the masses, the law and the springs of a lattice are known."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import numpy as np
from pydantic import BeforeValidator, Field

from .. import units as u
from ..design.sensitivities import LawDerivative, StiffnessDerivative, force_change, spacing_change
from ..design.uncertainty import Tolerances
from .fields import Number, Positive, Table, within
from .structures import FileLattice

if TYPE_CHECKING:
    from ..interactions.pair_laws import PairLaw
    from .scene import Scene

LARGEST_TOLERANCE = 0.5
"""Largest relative standard deviation; a change by half is no small change, as propagation to first order assumes."""


def _correlation(value):
    if not isinstance(value, float | int) or not -1 < value < 1:
        raise ValueError(f' must lie between -1 and 1, not {value!r}')
    return float(value)


Correlation = Annotated[Number, BeforeValidator(_correlation)]
Percent = Annotated[Positive, within(0, 100 * LARGEST_TOLERANCE, 'percent')]


class Uncertainty(Table):
    """Standard deviations of what all particles share; what is not named is exact."""

    spacing_percent: Percent | None = Field(None, description='the standard deviation of the spacing in percent', examples=[1.0])
    mass_percent: Percent | None = Field(None, description='the standard deviation of the mass in percent', examples=[1.0])
    force_percent: Percent | None = Field(None, description='the standard deviation of the force at the spacing in percent',
                                          examples=[1.0])
    exponent: Positive | None = Field(
        None, description='the standard deviation of the exponent of the law, -d ln f/d ln r at the spacing', examples=[0.05])
    correlation_force_exponent: Correlation | None = Field(
        None, description='the correlation of force and exponent, as "magphonon fit" prints it')
    stiffness_percent: Percent | None = Field(
        None, description='the standard deviation of the springs of the foundation in percent; that of a pillar goes with the '
        'fourth power of its radius and the third of its height', examples=[3.0])
    stiffness_y_percent: Percent | None = Field(None, description='that of stiffness_y_N_per_m, if the foundation has it',
                                                examples=[3.0])

    def tolerances(self, scene: Scene) -> Tolerances:
        """The parameters that have a standard deviation, what each changes in the lattice, and their covariance."""
        if scene.single or isinstance(scene.lattice, FileLattice):
            raise ValueError('uncertainty: tolerances are those of the bands of a lattice that the scene describes by its kind '
                             'and spacing; remove [uncertainty]')
        given = {name: getattr(self, f'{name}_percent') for name in ('spacing', 'mass', 'force', 'stiffness', 'stiffness_y')}
        sigma = {name: value / 100 for name, value in given.items() if value is not None}
        sigma |= {} if self.exponent is None else {'exponent': self.exponent}
        changes = _changes(scene)
        for name in sigma.keys() - changes.keys():
            raise ValueError(f'uncertainty.{name}_percent belongs to a spring that the scene does not have; remove it')
        if not sigma:
            raise ValueError('uncertainty names no tolerance; add one, such as spacing_percent = 1.0')
        C, names = np.diag(np.square([*sigma.values()])), [*sigma]
        if self.correlation_force_exponent is not None:
            if not {'force', 'exponent'} <= sigma.keys():
                raise ValueError('uncertainty.correlation_force_exponent needs both force_percent and exponent; add them')
            i, j = names.index('force'), names.index('exponent')
            C[i, j] = C[j, i] = self.correlation_force_exponent * sigma['force'] * sigma['exponent']
        return Tolerances({name: changes[name] for name in sigma}, C)


def _changes(scene):
    law = scene.law.potential()
    found = {'spacing': StiffnessDerivative(law=spacing_change(law)), 'mass': StiffnessDerivative(mass=1.0),
             'force': StiffnessDerivative(law=force_change(law)),
             'exponent': StiffnessDerivative(law=exponent_at(law, scene.lattice.spacing_m * u.m))}
    springs = scene.foundation.changes if scene.foundation and scene.foundation.stiffness else {}
    return found | {name: StiffnessDerivative(foundation=change) for name, change in springs.items()}


def exponent_at(law: PairLaw, spacing: float) -> LawDerivative:
    """Derivative of a law by its exponent at constant force at the spacing (mm): that of f (r/spacing)^-delta by delta."""
    return LawDerivative(lambda r: -np.log(r / spacing) * law.dphi(r),
                     lambda r: -np.log(r / spacing) * law.d2phi(r) - law.dphi(r) / r)
