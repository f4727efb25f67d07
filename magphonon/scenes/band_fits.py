"""The law and the foundation of a scene from measured branches of its lattice, in both models."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import units as u
from ..design.dispersion_fits import DispersionFit, fit_dispersion
from ..design.sensitivities import Change, LawChange, exponent_change, force_change, screening_change
from ..errors import one_of
from ..interactions.pair_laws import repulsion
from ..stiffness.calculator import MagneticRepulsion
from .structures import FileLattice
from .tolerances import PLACES, varied

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ..waves.ridge_tables import RidgePoints
    from .scene import Scene

MODELS = ('complete', 'conventional')
STRENGTHS = {'inverse_power': ('b', 1), 'dipoles': ('moment', 2), 'coulomb': ('charge', 2), 'yukawa': ('strength', 1),
             'table': ('forces', 1)}
"""The parameter of each kind of law in proportion to which the force goes, and to which power."""
SHAPES = {'inverse_power': ('a', exponent_change), 'yukawa': ('screening_length', screening_change)}
"""The parameter that tells how fast it falls, where there is one, and what it changes."""
TELLS = 2.0
"""Difference of the models in sigmas below which the data do not tell them apart."""


@dataclass(frozen=True)
class BandFits:
    """A scene fitted to measured branches with D* and without.

    Attributes
    ----------
    scene : Scene
        Where the fit started: spacing, masses and what is fixed are known from it.
    points : RidgePoints
        Those that share no noise.
    fits : dict of DispersionFit
        By model, 'complete' and 'conventional'.
    """

    scene: Scene
    points: RidgePoints
    fits: dict[str, DispersionFit]

    @property
    def names(self) -> tuple[str, ...]:
        """The fitted parameters: 'force' (at the spacing), 'a' or 'screening_length', 'foundation'."""
        return self.fits['complete'].names

    @property
    def evidence(self) -> float:
        """How surely the data need D*, in sigmas: the root of the difference of chi2, negative if D0 alone fits better.

        Without D* the static forces vanish while the stiffness stays free: for an inverse power that is one parameter less, and
        by Wilks' theorem the difference is a chi2 of one degree of freedom if the smaller model holds.  Where the points scatter
        more than their uncertainties say, it is counted in that scatter.  Where not even the better model follows the points
        (`DispersionFit.follows`) it means nothing.
        """
        difference = self.fits['conventional'].chi2 - self.fits['complete'].chi2
        return float(np.sign(difference) * np.sqrt(abs(difference)) / self.better.scatter)

    @property
    def better(self) -> DispersionFit:
        """The fit of the model that has the smaller chi2."""
        return min(self.fits.values(), key=lambda fit: fit.chi2)

    def fitted(self, model: str = 'complete') -> Scene:
        """The scene with the parameters of the fit."""
        fit = self.fits[one_of('model', model, MODELS)]
        return with_factors(self.scene, dict(zip(fit.names, fit.factors, strict=True)))

    def values(self, model: str = 'complete') -> dict[str, tuple[float, float]]:
        """Value in SI and relative standard uncertainty of each parameter, and of the stiffness of a bond, -df/dr at the spacing.

        A parameter with an uncertainty of more than a half is not determined, and its value means little.
        """
        fit, scene = self.fits[one_of('model', model, MODELS)], self.fitted(model)
        L, law, changes = scene.lattice.spacing_m * u.m, scene.law.potential(), _changes(scene)
        found = {}
        for name, sigma in zip(fit.names, fit.sigma.tolist(), strict=True):
            if name == 'foundation':
                found[name] = float(scene.foundation.stiffness / (u.N / u.m)), sigma  # pyright: ignore[reportOptionalMemberAccess]  it has one
            else:
                found[name] = float(repulsion(law, L) / u.N if name == 'force' else getattr(scene.law, PLACES[name][-1])), sigma
        slopes = [0.0 if changes[name].law is None else changes[name].law.d2phi(L) / law.d2phi(L) for name in fit.names]
        found['bond stiffness'] = float(law.d2phi(L) / (u.N / u.m)), fit.sigma_along(np.array(slopes))
        return found


UNITS = {'force': 'N', 'a': '', 'screening_length': 'm', 'foundation': 'N/m', 'bond stiffness': 'N/m'}  # units of the values


def parameters_of(scene: Scene) -> tuple[str, ...]:
    """The parameters of a scene that bands depend on and a fit may vary; mass and spacing are known."""
    one_of('law.kind', scene.law.kind, tuple(STRENGTHS))
    if isinstance(scene.lattice, FileLattice) or scene.single:
        raise ValueError(f'lattice.kind = {scene.lattice.kind!r}: a fit takes a lattice that the scene describes by kind '
                         'and spacing')
    if scene.laws_of_kinds:
        raise ValueError('laws_of_kinds: a fit varies one law for all pairs; take a lattice of one kind')
    if scene.foundation and scene.foundation.out_of_plane:
        raise ValueError('foundation.out_of_plane: a fit takes waves in the plane; leave this table out')
    shape = SHAPES.get(scene.law.kind, ())[:1]
    return ('force', *shape, *(('foundation',) if scene.foundation and scene.foundation.stiffness else ()))


def fit_bands(scene: Scene, points: RidgePoints, fixed: Sequence[str] = ()) -> BandFits:
    """Force, exponent and foundation of a lattice from measured points of its bands, with D* and without.

    Mass and spacing are those of the scene, whose other parameters are where the fit starts.  Which parameters the points
    determine, the uncertainties tell: those of one branch, for example, never tell the exponent from the force.

    Parameters
    ----------
    scene : Scene
    points : RidgePoints
        Of any number of ridges; those that share noise are left out.
    fixed : sequence of str
        Parameters that are known from elsewhere: 'force', 'a' (or 'screening_length'), 'foundation'.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene, ready_scene
    >>> from magphonon.bands.bloch import bloch_modes
    >>> from magphonon.scenes import fit_bands
    >>> from magphonon.waves import RidgePoints
    >>> scene = read_scene(ready_scene('prototype'))
    >>> xi = np.tile(np.linspace(0.6, 2.8, 12), 2)
    >>> q, ridge = np.outer(xi / (2 * np.pi), [0, 1, 0]), np.repeat([0, 1], 12)
    >>> omega = bloch_modes(scene.atoms(), q)[0][range(24), ridge]
    >>> one = np.ones(24)
    >>> points = RidgePoints(('1', '2'), ('transverse', 'longitudinal'), ridge, q, xi, 0 * xi, omega, 1e-3 * omega, one, 0 * xi)
    >>> fits = fit_bands(scene, points)
    >>> round(fits.values()['a'][0], 4), fits.evidence > 10
    (4.5824, True)
    """
    scene, have = scene.counted(), parameters_of(scene)
    for name in fixed:
        one_of('the fixed parameter', name, have)
    names = tuple(name for name in have if name not in fixed)
    if not names:
        raise ValueError('all parameters are fixed; leave one of them free')
    own = points.independent

    cell = scene.perfect_cell()

    def build(factors):
        there, atoms = with_factors(scene, factors), cell.copy()
        springs = there.foundation.stiffness if there.foundation else 0.0
        atoms.calc = MagneticRepulsion(atoms, there.law.potential(), bonds=cell.calc.bonds, foundation=springs)
        return atoms, _changes(there)

    return BandFits(scene, own, {model: fit_dispersion(build, names, own, model) for model in MODELS})


def _changes(scene):
    """What each parameter changes: the shape of the law at the same force at the spacing."""
    law, L = scene.law.potential(), scene.lattice.spacing_m * u.m
    changes = {'force': Change(law=force_change(law))}
    if scene.law.kind in SHAPES:
        name, change = SHAPES[scene.law.kind]
        shape = change(law)
        share = shape.dphi(L) / law.dphi(L)
        changes[name] = Change(law=LawChange(lambda r: shape.dphi(r) - share * law.dphi(r),
                                             lambda r: shape.d2phi(r) - share * law.d2phi(r)))
    if scene.foundation:
        changes['foundation'] = Change(foundation=scene.foundation.stiffness)
    return changes


def with_factors(scene: Scene, factors: dict[str, float]) -> Scene:
    """The scene with its force at the spacing, its shape and its foundation multiplied by `factors`."""
    L = scene.lattice.spacing_m * u.m
    strength, power = STRENGTHS[scene.law.kind] if getattr(scene.law, 'force_N', None) is None else ('force', 1)
    wanted = repulsion(scene.law.potential(), L) * factors.get('force', 1.0)
    scene = varied(scene, {name: factor for name, factor in factors.items() if name in PLACES and name != 'force'})
    scene = varied(scene, {strength: (wanted / repulsion(scene.law.potential(), L)) ** (1 / power)})
    if 'foundation' in factors:
        spring = 'youngs_modulus' if scene.foundation and scene.foundation.pillar else 'stiffness'
        scene = varied(scene, {spring: factors['foundation']})
    return scene
