"""The law and the foundation of a scene from measured branches of its lattice, in both models.

Whether farther neighbours act is seldom decided by the points alone.  So a law that the scene only guesses is fitted twice: as an
inverse power between nearest neighbours, and between all neighbours with an exponent that relaxes to another one far away.  Each
fit has the weight of its evidence (Laplace's method), and an interval is that of the weighted sum of both answers, the same from
whatever number of shells or start the scene names.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import combinations, product
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.special import softmax

from .. import units as u
from ..bands.bloch import wavevectors
from ..bands.neighbours import REACHES
from ..design.dispersion_fits import Bands, DispersionFit, Shells, fit_dispersion, residuals_of
from ..design.least_squares import mixed_interval
from ..design.sensitivities import LawDerivative, StiffnessDerivative, force_change
from ..errors import one_of
from ..interactions.fits import EXPONENT as CENTRE, RATES, FamilyLaw, LawFamily
from ..interactions.pair_laws import repulsion
from ..lattices.bonds import bonds_within
from ..stiffness.matrices import MODELS, Model
from .fields import unit_of
from .laws import KINDS, TableLaw
from .structures import FileLattice
from .tolerances import LARGEST_TOLERANCE, exponent_at

if TYPE_CHECKING:
    from ..waves.ridge_tables import RidgePoints
    from .scene import Scene

PLACES = {
    'mass': ('lattice', 'mass_kg'),
    **{name: ('law', one.key) for kind in KINDS.values() for name, one in kind.parameters.items() if one.power or one.change},
    'stiffness': ('foundation', 'stiffness_N_per_m'), 'stiffness_y': ('foundation', 'stiffness_y_N_per_m'),
    'youngs_modulus': ('foundation', 'pillar', 'youngs_modulus_Pa')}
"""Place in a scene of each parameter that a fit may vary."""
FITTED = {name: kind for name, kind in KINDS.items() if kind.strength in PLACES}
"""The kinds of laws whose strength, and shape if they have one, may be fitted."""
SPRINGS = {'foundation': 'stiffness', 'foundation_x': 'stiffness', 'foundation_y': 'stiffness_y'}
"""What each fitted spring is called in `Foundation.changes`."""
UNITS = {'force': 'N', **{kind.shape: unit_of(kind.parameters[kind.shape].key) for kind in FITTED.values() if kind.shape},
         **dict.fromkeys((*SPRINGS, 'bond stiffness'), 'N/m')}  # of the values
KEYS = {'_'.join([name, *filter(None, [unit.replace('/', '_per_')])]): name for name, unit in UNITS.items() if ' ' not in name}
"""The parameters by their name with a unit, as a prior names them: force_N, a, foundation_N_per_m and so on."""
NEAREST, ALL = 'nearest neighbours alone', 'all neighbours'
"""Which neighbours act in each of the fits that are weighed against each other."""
ANY_EXPONENT = 4.5, 3.0
"""Exponent of an inverse power before anything is measured, and its standard deviation."""
SAME = 1e-9  # relative difference of numbers that were only written in other units
EXPONENT = 'exponent'  # of a table of forces: a parameter of a fit that is not reported
BENDS = tuple(f'bend {k + 1}' for k in range(len(RATES)))  # nor are those by which a law departs from an inverse power
UNTOLD = EXPONENT, *BENDS
FROM, KNOTS, DECADES = 0.5, 48, 11  # of the table of such a law: first distance in spacings, number, and range of forces
TELLS = 3.0
"""Difference of the models in sigmas below which the data cannot distinguish them."""
DOUBT = 0.05
"""Weight of another number of neighbours from which its answer is told, too."""


@dataclass(frozen=True)
class BandFits:
    """A scene fitted to measured branches with D* and without.

    Attributes
    ----------
    scene : Scene
        The scene at which the fit started; it provides spacing, masses and all fixed parameters.
    points : RidgePoints
        The points that were fitted, which share no noise.
    parts : dict of dict of DispersionFit
        For each model, 'complete' and 'conventional', the fits by their neighbours: NEAREST and ALL.
    lattices : dict of Shells
        The lattice of each of these fits.
    priors : dict
        Prior knowledge about parameters: value in SI and standard uncertainty.
    left_out : tuple of str
        Ridges that were left out of the fit; their distance from the fitted branches widens the intervals.
    """

    scene: Scene
    points: RidgePoints
    parts: dict[Model, dict[str, DispersionFit]]
    lattices: dict[str, Shells] = field(repr=False)
    priors: dict[str, tuple[float, float]]
    left_out: tuple[str, ...] = ()

    @property
    def fits(self) -> dict[Model, DispersionFit]:
        """The fit of each model that has the largest weight."""
        return {model: parts[max(parts, key=self.weights(model).__getitem__)] for model, parts in self.parts.items()}

    def weights(self, model: Model = 'complete') -> dict[str, float]:
        """Weight of each of the fits of a model, which add up to one."""
        parts = self.parts[one_of('model', model, MODELS)]
        scale = min(fit.scatter for fit in parts.values())
        return dict(zip(parts, softmax([fit.log_evidence(scale) for fit in parts.values()]).tolist(), strict=True))

    @property
    def names(self) -> tuple[str, ...]:
        """The fitted parameters: 'force' (at the spacing), 'a' or 'screening_length', 'foundation' or its parts along x and y."""
        return tuple(name for name in self.fits['complete'].names if name not in UNTOLD)

    @property
    def of_any_law(self) -> bool:
        """Whether the intervals hold for any smooth law near an inverse power."""
        return BENDS[0] in self.parts['complete'][ALL].names

    @property
    def open(self) -> tuple[str, ...]:
        """The numbers of neighbours, NEAREST and ALL, between which the points do not decide; empty if they do."""
        near = self.weights().get(NEAREST, 0.0)
        return (NEAREST, ALL) if DOUBT < near < 1 - DOUBT else ()

    @property
    def evidence(self) -> float:
        """Evidence for D* in sigmas, negative if D0 alone explains the points better.

        It is the root of twice the logarithm of the ratio of the evidences of both models, each summed over its fits.  If the
        points scatter by more than their uncertainties, chi2 counts in units of that scatter.  If not even the better model
        fits the points (`DispersionFit.follows`), the evidence is meaningless.
        """
        scale = min(fit.scatter for parts in self.parts.values() for fit in parts.values())
        complete, conventional = (np.logaddexp.reduce([fit.log_evidence(scale) for fit in self.parts[model].values()])
                                  for model in MODELS)
        return float(np.sign(complete - conventional) * np.sqrt(2 * abs(complete - conventional)))

    @property
    def better(self) -> DispersionFit:
        """The fit of the model that has the smaller chi2."""
        return min(self.fits.values(), key=lambda fit: fit.chi2)

    @property
    def biased(self) -> bool:
        """Whether ridges of a point source are fitted without prior knowledge of the exponent or of the foundation.

        The intervals then contain the true values, but the fitted values all err in the same direction.
        """
        alone = [name for name in self.names if name not in (*self.priors, 'force')]
        return bool(self.points.from_points.any() and alone)

    @property
    def stated(self) -> tuple[float, float] | None:
        """The force at the spacing in N with its standard deviation, as stated in [uncertainty] of the scene; None if not
        stated.
        """
        if self.scene.uncertainty is None or 'force' not in self.names or 'force' in self.priors:
            return None
        percent, value = self.scene.uncertainty.force_percent, value_of(self.scene, 'force')
        return None if percent is None else (value, value * percent / 100)

    def fitted(self, model: Model = 'complete') -> Scene:
        """The scene with the parameters and the neighbours of the fit that has the largest weight.

        A law that relaxes to another exponent is a table, which covers all neighbours that were counted.
        """
        fit = self.fits[one_of('model', model, MODELS)]
        part = next(part for part, one in self.parts[model].items() if one is fit)
        scene = with_bends(with_factors(self.scene, fit.by_name), fit.by_name, self.lattices[ALL].r[-1])[0]
        return scene.with_shells(1 if part == NEAREST else 'auto')

    def values(self, model: Model = 'complete', part: str | None = None) -> dict[str, tuple[float, float]]:
        """Each parameter in SI and its relative standard uncertainty, and the stiffness of a bond, -df/dr at the spacing.

        A value is the middle of its 95 % interval, on a logarithmic scale, and the uncertainty half its width divided by 1.96.
        With an uncertainty of more than a quarter a parameter is not determined, and its value means little.

        Parameters
        ----------
        model : {'complete', 'conventional'}
        part : {NEAREST, ALL}, optional
            Answer of a single fit in place of the weighted sum.
        """
        found = []
        for fit in self._fits(model, part).values():
            scene = with_factors(self.scene, fit.by_name)  # bends change neither force nor slope at the spacing
            own = {name: (value_of(scene, name), sigma) for name, sigma in zip(self.names, fit.sigma.tolist(), strict=False)}
            found.append(own | {'bond stiffness': (value_of(scene, 'bond stiffness'),
                                                   fit.sigma_along(bond_powers(scene, fit.names)))})
        each = np.array([[*one.values()] for one in found])
        values, sigma = mixed_interval(each[..., 0], each[..., 1], self._share(model, part))
        return {name: (float(value), float(s)) for name, value, s in zip(found[0], values, sigma, strict=True)}

    def predicted(self, q: ArrayLike, model: Model = 'complete',
                  part: str | None = None) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Frequencies of the fitted lattice, and their relative standard uncertainties, as in `values`.

        Parameters
        ----------
        q : array_like, shape (wavevectors, 3)
            In fractions of the reciprocal vectors.
        model : {'complete', 'conventional'}
        part : {NEAREST, ALL}, optional

        Returns
        -------
        omega, sigma : ndarray, shape (wavevectors, branches)
            `omega` is in rad/ms; `sigma` is a fraction of it, infinite if the points do not determine the frequency.
        """
        q, found = wavevectors(q), []
        for name, fit in self._fits(model, part).items():
            bands = Bands(self.lattices[name], model, *_built(self.scene, fit.by_name))
            omega = bands.omega(q)
            steep = np.stack([bands.slopes(q, fit.names, at)[1][..., k] for k, at in enumerate(omega.T)], axis=-1)
            relative = np.divide(steep, 2 * omega**2, out=np.zeros_like(steep), where=steep != 0)
            found.append((omega, np.apply_along_axis(fit.sigma_along, 0, relative)))
        omega, sigma = (np.array(each) for each in zip(*found, strict=True))
        return mixed_interval(omega, sigma, self._share(model, part))

    def _fits(self, model, part):
        return {name: fit for name, fit in self.parts[one_of('model', model, MODELS)].items() if part in (None, name)}

    def _share(self, model, part):
        return np.array([*self.weights(model).values()]) if part is None else np.ones(1)


def parameters_of(scene: Scene) -> tuple[str, ...]:
    """The parameters of a scene that bands depend on and a fit may vary; mass and spacing are known."""
    if isinstance(scene.lattice, FileLattice) or scene.single:
        raise ValueError(f'lattice.kind = {scene.lattice.kind!r}: a fit needs a lattice that the scene describes by its kind and '
                         'spacing')
    return parameters_in(scene)


def parameters_in(scene: Scene) -> tuple[str, ...]:
    """The parameters of any scene, also of a finite structure or the oscillator, that a fit may vary."""
    shape = FITTED[one_of('law.kind', scene.law.kind, tuple(FITTED))].shape
    if scene.foundation and scene.foundation.out_of_plane:
        raise ValueError('foundation.out_of_plane: a fit uses waves in the plane; remove this table')
    springs = scene.foundation.changes if scene.foundation and scene.foundation.stiffness else {}
    names = ('foundation',) if len(springs) == 1 else ('foundation_x', 'foundation_y')[: len(springs)]
    return ('force', *([shape] if shape else []), *names)


def free_names(have: Sequence[str], fixed: Sequence[str], priors: Collection[str]) -> tuple[str, ...]:
    """The parameters of `have` that are not fixed; ValueError for any other name."""
    for name in fixed:
        one_of('the fixed parameter', name, have)
    for name in priors:
        one_of('the parameter of a prior', name, have)
    return tuple(name for name in have if name not in fixed)


def fit_bands(scene: Scene, points: RidgePoints, fixed: Sequence[str] = (),
              priors: Mapping[str, tuple[float, float]] | None = None, without: Sequence[str] = ()) -> BandFits:
    """Force, exponent and foundation of a lattice from measured points of its bands, with D* and without.

    Mass and spacing are taken from the scene; its other parameters are the start of the fit.  The uncertainties show which
    parameters the points determine: points of one branch, for example, cannot separate the exponent from the force.  A law
    of magnets or a table of forces keeps its shape, acts between all neighbours, and only its strength is fitted; the intervals
    include the tolerance `exponent` of [uncertainty].  An inverse power stands for any smooth law with the same exponent at the
    spacing, between nearest neighbours or all, and the intervals hold for all of these; if the exponent is fixed, the inverse
    power counts as exact.

    Parameters
    ----------
    scene : Scene
    points : RidgePoints
        Points of any number of ridges; of points that share noise only the strongest is used.
    fixed : sequence of str
        Parameters that are known exactly: 'force', 'a' (or 'screening_length'), 'foundation', or, if the scene has two springs,
        'foundation_x' and 'foundation_y'.
    priors : dict, optional
        Prior knowledge about parameters: value in SI and standard uncertainty, such as {'force': (0.288, 0.01)}.
    without : sequence of str
        Names of ridges that are not fitted; the more the fit misses them, the more all intervals are widened.

    Raises
    ------
    ValueError
        If two springs are to be fitted to ridges of a point source without priors, because the result could be 80 % off.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands.bloch import bloch_modes
    >>> from magphonon.scenes import fit_bands
    >>> from magphonon.waves.ridge_tables import RidgePoints
    >>> scene = read_scene(ready_scene('prototype'))
    >>> xi = np.tile(np.linspace(0.6, 2.8, 12), 2)
    >>> q, ridge = np.outer(xi / (2 * np.pi), [0, 1, 0]), np.repeat([0, 1], 12)
    >>> omega = bloch_modes(scene.atoms(), q)[0][range(24), ridge]
    >>> one = np.ones(24)
    >>> points = RidgePoints(('1', '2'), ('transverse', 'longitudinal'), ridge, q, xi, 0 * xi, omega, 1e-3 * omega, one, 0 * xi)
    >>> fits = fit_bands(scene, points)
    >>> round(fits.values()['a'][0], 2), fits.evidence > 10
    (4.55, True)
    """
    have, priors = parameters_of(scene), dict(priors or {})
    names = free_names(have, fixed, priors)
    if not names:
        raise ValueError('all parameters are fixed; leave one of them free')
    refuse_copies((name, np.array([points.xi, points.sigma_xi, points.omega, points.sigma_omega])[:, points.ridge == k])
                  for k, name in enumerate(points.names) if name not in without)
    own, _ = _divided(points, without)
    _refuse_two_springs(own, [name for name in names if name not in priors])
    near = scene.with_shells(1).perfect_cell()
    lattices = {}
    if KINDS[scene.law.kind].shape:
        lattices[NEAREST] = Shells(near)
    else:
        scene.with_shells('all').counted()  # refuses forces that reach too far
    lattices[ALL] = _all_neighbours(near)
    parts: dict[Any, dict[str, DispersionFit]] = {model: {} for model in MODELS}
    for model, part in product(MODELS, lattices):
        parts[model][part] = _fit(scene, lattices, part, points, names, priors, without, model)
    return BandFits(scene, own, parts, lattices, priors, tuple(without))


def _fit(scene: Scene, lattices: Mapping[str, Shells], part: str, points: RidgePoints, names: tuple[str, ...],
         priors: Mapping[str, tuple[float, float]], without: Sequence[str], model: Model) -> DispersionFit:
    """The fit of one model with some neighbours, with the residuals of the ridges that are left out."""
    own, left_out = _divided(points, without)
    fixed = [name for name in parameters_of(scene) if name not in names]
    relative = {name: relative_prior(name, value_of(scene, name), *priors[name], fixed) for name in priors}
    names, relative = of_any_law(scene, names, relative, part == ALL)
    build = partial(_built, scene)
    fit = fit_dispersion(lattices[part], build, names, own, model, relative)
    bands = Bands(lattices[part], model, *build(fit.by_name))
    return replace(fit, missed=residuals_of(bands, left_out)) if len(left_out) else fit


def of_any_law(scene: Scene, names: tuple[str, ...], priors: Mapping[str, tuple[float, float]],
               far: bool) -> tuple[tuple[str, ...], dict[str, tuple[float, float]]]:
    """Names and priors with those of the parameters by which a law departs from that of the scene.

    An error of the exponent of a table is one more parameter, whose prior is the tolerance in [uncertainty]. An inverse power
    that stands for any smooth law, also between `far` neighbours, has two more, by which it relaxes to another exponent.
    """
    own = dict(priors)
    if 'a' in names and scene.law.kind == 'inverse_power':
        a, sigma = ANY_EXPONENT
        own = {'a': (a / scene.law.a, sigma / a)} | own | dict.fromkeys(BENDS * far, (1.0, 1.0))
    if 'force' in names and scene.law.kind == 'table' and scene.uncertainty and scene.uncertainty.exponent:
        own[EXPONENT] = 1.0, scene.uncertainty.exponent
    return (*names, *(name for name in own if name in UNTOLD)), own


def _all_neighbours(cell):
    """The lattice of a cell whose particles interact with all others, whatever their law."""
    atoms, calc = cell.copy(), cell.calc
    reach = REACHES[int(cell.pbc.sum())][0] * calc.bonds.lengths.min()
    atoms.calc = calc.changed(bonds=bonds_within(calc.reference, reach))
    return Shells(atoms, reach)


def _built(scene, factors) -> tuple[Any, ...]:
    """Law and springs of a scene with its parameters multiplied by `factors`, and the change of stiffness by each of them."""
    there = with_factors(scene, factors)
    law, changes = _bent(there, factors) if BENDS[0] in factors else (there.law.potential(), {})
    feet = there.foundation
    return law, feet.springs(feet.stiffness) if feet else 0.0, changes_of(there) | changes, feet.beams if feet else None


def _bent(scene, factors):
    """The inverse power of a scene, bent by the `factors`, and its derivatives by force, exponent and bends."""
    family, names, a = LawFamily(scene.lattice.spacing_m * u.m), ('force', 'a', *BENDS), scene.law.a
    p = [np.log(repulsion(scene.law.potential(), family.r0)), a - CENTRE, *np.log([factors[name] for name in BENDS])]
    law, along = FamilyLaw(family, np.array(p)), np.diag([1.0, a, *np.ones(len(BENDS))])
    return law, {name: StiffnessDerivative(law=family.change(law, v)) for name, v in zip(names, along, strict=True)}


def with_bends(scene: Scene, factors: Mapping[str, float], reach: float) -> tuple[Scene, dict[str, StiffnessDerivative]]:
    """The scene with a table, to a distance `reach` in mm, of its inverse power bent by the `factors`, and what these change."""
    if BENDS[0] not in factors:
        return scene, {}
    law, changes = _bent(scene, factors)
    r = np.geomspace(FROM * scene.lattice.spacing_m * u.m, reach, KNOTS)
    r = r[abs(np.log10(law.dphi(r) / law.dphi(scene.lattice.spacing_m * u.m))) < DECADES]
    own, columns = scene.law, {'distances_m': (r / u.m).tolist(), 'forces_N': (-law.dphi(r) / u.N).tolist()}
    table = TableLaw.model_validate({'kind': 'table', 'shells': own.asked, **columns})
    return scene.model_copy(update={'law': table.with_shells(own.shells, own.reach)}), changes


def _divided(points, without):
    """The points to fit and the points of the ridges left out, in both cases only points that share no noise."""
    for name in without:
        one_of('the ridge to be omitted', name, points.names)
    out = np.isin(np.array(points.names)[points.ridge], list(without))
    if out.all():
        raise ValueError('all ridges are omitted; keep some of them')
    return points[~out].independent, points[out].independent


def refuse_copies(records: Iterable[tuple[str, ArrayLike]]) -> None:
    """Raise ValueError if two records, each of a name and its numbers, are one in another order or in other units."""
    ordered = [(name, np.sort(numbers, axis=None)) for name, numbers in records]
    for (first, one), (name, other) in combinations(ordered, 2):
        if 0 < one.size == other.size and np.allclose(one, other, SAME, 0.0):
            raise ValueError(f'{first} and {name} hold the same numbers, whose noise would count as independent; give only one '
                             'of them')


def _refuse_two_springs(points, free):
    if {'foundation_x', 'foundation_y'} <= {*free} and points.from_points.all():
        raise ValueError('ridges of a point source are shifted and cannot determine two springs, along x and along y; state what '
                         'is known of them (--prior foundation_x_N_per_m=20+-2), fix one of the springs, remove '
                         'foundation.stiffness_y_N_per_m, or drive a row of sources')


def relative_prior(name: str, present: float, value: float, sigma: float, fixed: Sequence[str]) -> tuple[float, float]:
    """Prior of a parameter, as a factor of its present value and a relative standard uncertainty."""
    if name in fixed:
        raise ValueError(f'{name} is fixed and has a prior; keep one of them')
    if not 0 < sigma <= LARGEST_TOLERANCE * value:
        raise ValueError(f'the prior of {name}, {value:g} +- {sigma:g}, must be positive and known to '
                         f'{100 * LARGEST_TOLERANCE:.0f} % or better; omit a prior that is known less well')
    return value / present, sigma / value


def value_of(scene: Scene, name: str) -> float:
    """A parameter of the scene in SI."""
    if name in SPRINGS:
        return float(np.max(scene.foundation.changes[SPRINGS[name]]) / (u.N / u.m))
    if name == 'bond stiffness':
        return float(scene.law.potential().d2phi(scene.lattice.spacing_m * u.m) / (u.N / u.m))
    return float(repulsion(scene.law.potential(), scene.lattice.spacing_m * u.m) / u.N if name == 'force'
                 else getattr(scene.law, PLACES[name][-1]))


def _of_remanence(scene):
    """The scene with the remanence of its magnets in teslas instead of their grade, because a fit varies it."""
    if scene.law.kind != 'magnets' or not scene.law.grade:
        return scene
    strength = {'grade': None, 'remanence_T': scene.law.remanence / u.T}
    return scene.model_copy(update={'law': scene.law.model_copy(update=strength)})


def changes_of(scene: Scene) -> dict[str, StiffnessDerivative]:
    """The change of stiffness by each parameter; those of the shape of the law keep the force at the spacing constant."""
    law, L = scene.law.potential(), scene.lattice.spacing_m * u.m
    changes = {'force': StiffnessDerivative(law=force_change(law))}
    kind = KINDS[scene.law.kind]
    if (name := kind.shape) and (change := kind.parameters[name].change):
        shape = change(law, L)
        share = shape.dphi(L) / law.dphi(L)
        changes[name] = StiffnessDerivative(law=LawDerivative(lambda r: shape.dphi(r) - share * law.dphi(r),
                                             lambda r: shape.d2phi(r) - share * law.d2phi(r)))
    if scene.law.kind == 'table':
        changes[EXPONENT] = StiffnessDerivative(law=exponent_at(law, L))
    if scene.foundation:
        changes |= {name: StiffnessDerivative(foundation=scene.foundation.changes[spring]) for name, spring in SPRINGS.items()
                    if spring in scene.foundation.changes}
    return changes


def bond_powers(scene: Scene, names: Sequence[str]) -> NDArray[np.float64]:
    """Powers of the parameters whose product is the stiffness of a bond at the spacing, shape (parameters,)."""
    law, changes, L = scene.law.potential(), changes_of(scene), scene.lattice.spacing_m * u.m
    laws = [changes[name].law if name in changes else None for name in names]
    return np.array([0.0 if one is None else one.d2phi(L) / law.d2phi(L) for one in laws])


def with_factors(scene: Scene, factors: dict[str, float]) -> Scene:
    """The scene with its force at the spacing, its shape and its foundation multiplied by `factors`."""
    scene = _of_remanence(scene)
    L = scene.lattice.spacing_m * u.m
    strength = FITTED[scene.law.kind].strength
    power = FITTED[scene.law.kind].parameters[strength].power
    wanted = repulsion(scene.law.potential(), L) * factors.get('force', 1.0)
    scene = varied(scene, {name: factor for name, factor in factors.items() if name in {EXPONENT, *PLACES}})
    scene = varied(scene, {strength: (wanted / repulsion(scene.law.potential(), L)) ** (1 / power)})
    springs = {SPRINGS[name]: factor for name, factor in factors.items() if name in SPRINGS}
    if springs and scene.foundation and scene.foundation.pillar:
        springs = {'youngs_modulus': springs['stiffness']}
    return varied(scene, springs)


def varied(scene: Scene, factors: Mapping[str, float]) -> Scene:
    """The scene with parameters multiplied by `factors`, a dict of their names; 1 + delta changes an exponent by delta."""
    for name, factor in factors.items():
        if name == EXPONENT:
            law: Any = scene.law  # a table
            factor, name = (np.array(law.distances_m) / scene.lattice.spacing_m) ** (1 - factor), 'forces'
        scene = _multiplied(scene, PLACES[name], factor)
    return scene


def _multiplied(table, place, factor):
    key, *rest = place
    value = getattr(table, key)
    if rest:
        value = _multiplied(value, rest, factor)
    else:
        value = tuple((factor * np.array(value)).tolist()) if isinstance(value, tuple) else value and factor * value
    return table.model_copy(update={key: value})
