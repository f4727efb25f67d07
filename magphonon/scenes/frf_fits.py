"""The law, the foundation and the damping of a scene from measured transfer functions, in both models."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from tqdm import tqdm

from .. import units as u
from ..design.least_squares import MOST_FACTOR
from ..design.site_unknowns import with_site_unknowns
from ..design.transfer_fits import WIDEST, ParametricLattice, TransferFit, fit_transfer, roughly_left, solved, with_wide_peaks
from ..errors import PhysicsError, not_negative, one_of
from ..response.frf import Dof
from ..stiffness.matrices import MODELS, Model
from ..stiffness.rest import LinearSystem, freedom
from . import band_fits
from .plans import Pick
from .structures import Defects

if TYPE_CHECKING:
    from ..response.transfer_functions import TransferFunction
    from .scene import Scene

UNITS = band_fits.UNITS | {'damping': '1/s', 'mass': 'kg', 'gain': ''}
KEYS = band_fits.KEYS | {'damping_per_s': 'damping', 'mass_kg': 'mass'}
SAME_DIRECTION = 1e-3  # rad: within it two directions in which a bench is shaken are one
GAIN, MASS = 0.01, 0.01
"""Default relative standard uncertainties of the calibration of an instrument, force and motion together, and of the mass."""
REACH = 8.0  # of the table of a law that departs from its inverse power, in spacings; beyond, it goes on as it ends
CONTRADICTS = 3.5  # sigmas above which a prior contradicts the data
CLEARLY = 1.5
"""Ratio of the residuals of the two models from which on one of them is ruled out where sites scatter, chosen by judgement."""
LIKELY, MOST_SITES, EXPLAINS = 4, 100, 2.0
"""Number of places of a missing magnet that are tried in a whole fit, largest number of places, and factor by which the residual
falls without it."""
EVIDENCE = 3.0  # sigmas between the models from which on data with a stated noise decide, where no sites scatter
STRETCHES = 0.88, 0.94, 1.0, 1.06, 1.13  # factors of all frequencies that are tried, as the lattice is not known exactly
CLOSE, BETTER, NEAR = 0.1, 0.5, 1.0
"""A mistake is named only if the data are farther than CLOSE from the response of the lattice, as a fraction of it, and if
undoing the mistake leaves less than the part BETTER of that distance, and less than NEAR."""
SCALES = {f'numbers {factor:g} times too {word}': factor**sign for factor, unit in ((1e3, 'mm'), (1e6, 'um'))
          for sign, word in ((-1, f'large, {unit} under a header in m'), (1, f'small, m under a header in {unit}'))}
WORDS = {-2: 'an acceleration that is called a displacement', -1: 'a velocity that is called a displacement, or an acceleration '
         'that is called a velocity', 1: 'a displacement that is called a velocity, or a velocity that is called an acceleration',
         2: 'a displacement that is called an acceleration'}
SLOW = 'frequencies in rad/s under a header in Hz'


@dataclass(frozen=True)
class FrfFits:
    """A scene fitted to transfer functions with D* and without.

    Attributes
    ----------
    scene : Scene
        The scene at which the fit started; parameters that are not fitted are taken from it.
    functions : list of TransferFunction
    fits : dict of TransferFit
        The fit of each model, 'complete' and 'conventional'.
    priors : dict
        Prior knowledge about parameters and about the gain: value in SI and standard uncertainty.
    """

    scene: Scene
    functions: list[TransferFunction]
    fits: dict[str, TransferFit]
    priors: dict[str, tuple[float, float]]

    @property
    def ratio(self) -> float:
        """Residual without D* divided by that with D*; above 1 the complete model fits the data better."""
        fits = self.fits
        return float(np.sqrt(fits['conventional'].square / fits['complete'].square))

    @property
    def better(self) -> TransferFit:
        """The fit of the model with the smaller residual."""
        return self.fits['complete' if self.ratio >= 1 else 'conventional']

    @property
    def endless(self) -> bool:
        """Whether the fit of the complete model ends at the lowest force allowed, because the data favour no static forces."""
        fit = self.fits['complete']
        return 'force' in fit.names and bool(np.log(fit.factors[fit.names.index('force')]) < -0.99 * np.log(MOST_FACTOR))

    @property
    def verdict(self) -> str | None:
        """The model that the data support; None if they cannot decide, or if neither model fits."""
        better, (complete, conventional) = self.better, (self.fits[model].square for model in MODELS)
        if not better.follows:
            return None
        sure = all(one.sigma is not None for one in self.functions) and not better.site_scatter.any()
        if max(self.ratio, 1 / self.ratio) > CLEARLY or (sure and abs(conventional - complete) > EVIDENCE**2):
            return better.model
        return 'conventional' if self.endless and self.ratio < 1 else None

    @property
    def contradicted(self) -> dict[str, float]:
        """Parameters whose prior contradicts the data by more than CONTRADICTS, with the number of standard deviations."""
        found, values = {}, self.values(self.better.model) if self.better.follows else {}
        for name, (known, sigma) in self.priors.items():
            value, own = values.get(name, (known, 0.0))
            expected = max((sigma / known) ** 2 - own**2, 0.0)  # variance of the shift by which data that agree move a prior
            found[name] = abs(np.log(value / known)) / np.sqrt(expected or np.inf)
        return {name: sigmas for name, sigmas in found.items() if sigmas > CONTRADICTS}

    def fitted(self, model: Model = 'complete') -> Scene:
        """The scene with the parameters of the fit, without the gain, which belongs to the instrument; masses in a file stay."""
        return _with(self.scene, self.fits[one_of('model', model, MODELS)].by_name)[0]

    def values(self, model: Model = 'complete') -> dict[str, tuple[float, float]]:
        """Value in SI and relative standard uncertainty of each parameter, and of the stiffness of a bond, -df/dr."""
        fit = self.fits[one_of('model', model, MODELS)]
        found = {name: (value_of(self.scene, name) * fit.by_name[name], sigma)
                 for name, sigma in zip(fit.names, fit.sigma.tolist(), strict=True) if name not in band_fits.UNTOLD}
        scene = band_fits.with_factors(self.scene, fit.by_name)  # bends change neither force nor slope at the spacing
        if (slopes := band_fits.bond_powers(scene, fit.names)).any():
            found['bond stiffness'] = value_of(scene, 'bond stiffness'), fit.sigma_along(slopes)
        return found

    def curves(self, model: Model = 'complete') -> list[NDArray[np.complex128]]:
        """The fitted response of each function, with the gain."""
        return responses_of(self.scene, model, self.functions, self.fits[one_of('model', model, MODELS)].by_name)


def fit_frf(scene: Scene, functions: Sequence[TransferFunction], fixed: Sequence[str] = (),
            priors: Mapping[str, tuple[float, float]] | None = None, gain_sigma: float = GAIN,
            stated: Collection[Model] = MODELS) -> FrfFits:
    """Force, exponent, foundation and damping of a patch or a finite structure from transfer functions, with D* and without.

    Parameters
    ----------
    scene : Scene
        A scene with [frf]. The fit starts from its damping; its force and response apply to functions that do not name their own.
    functions : sequence of TransferFunction
        The functions that `read_transfer` returns.
    fixed : sequence of str
        Parameters that are known exactly: 'force', 'a' (or 'screening_length'), 'foundation' (or 'foundation_x' and
        'foundation_y'), 'damping', 'mass'.
    priors : dict, optional
        Prior knowledge about parameters: value in SI and standard uncertainty.  The 'mass', common to all particles, is otherwise
        known to a percent (`MASS`).
    gain_sigma : float
        Relative standard uncertainty of the calibration; with zero it counts as exact.
    stated : collection of {'complete', 'conventional'}
        Models whose intervals are wanted. Scatter of the sites is fitted only for these, which may take most of the time.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.response import receptance
    >>> from magphonon.response.transfer_functions import TransferFunction
    >>> from magphonon.scenes import fit_frf
    >>> from magphonon.scenes.plans import FrfPlan
    >>> scene = read_scene('prototype')
    >>> scene = scene.model_copy(update={'patch': scene.patch.model_copy(update={'side_m': 0.05})})
    >>> there = {'at_m': [0.0, 0.02], 'direction_deg': 90.0}
    >>> plan = {'from_Hz': 20.0, 'to_Hz': 160.0, 'points': 90, 'damping_per_s': 20.0, 'force': there, 'response': there}
    >>> scene = scene.model_copy(update={'frf': FrfPlan(**plan)})
    >>> h = receptance(*scene.shaken(), scene.frf.omega, scene.frf.damping)
    >>> fits = fit_frf(scene, [TransferFunction('point', h.omega, 1.1 * h.response, 0.01)], gain_sigma=0.2)
    >>> round(fits.values()['gain'][0], 3)
    1.1
    """
    have, priors = (*band_fits.parameters_in(scene), 'damping', 'mass'), dict(priors or {})
    if scene.cell().has('relative_damping'):
        raise ValueError('lattice.file has the column relative_damping, but a fit of transfer functions supports only one '
                         'damping for all particles; remove the column')
    scene = scene.counted()
    names = band_fits.free_names(have, fixed, priors)
    if 'mass' in names:
        priors.setdefault('mass', (value_of(scene, 'mass'), MASS * value_of(scene, 'mass')))
    if not_negative('gain_sigma', gain_sigma):
        names, priors['gain'] = (*names, 'gain'), (1.0, gain_sigma)
    (names, relative), own = _with_priors(scene, names, priors, fixed), with_dofs(scene, functions)
    band_fits.refuse_copies((one.name, [one.omega, abs(one.response)]) for one in own)
    fits, start = {}, None
    build = {model: partial(_built, scene, model) for model in MODELS}
    for model in MODELS:  # D0 alone starts where the complete model ends
        fits[model] = fit_transfer(build[model], names, own, model, relative, start)
        start = fits[model].factors
    best = min(fit.square for fit in fits.values())
    for model, fit in fits.items():  # a model that is clearly worse needs no interval
        if fit.square > CLEARLY**2 * best:
            fits[model] = fit.refused
        elif model in stated:
            fits[model] = _with_sites(fit, build[model], own, relative)
    return FrfFits(scene, own, fits, priors)


def _with_sites(fit, *problem):
    """The fit with unknowns of the sites, from where the fit without them ended; if that fails, from the scene."""
    found, again = with_site_unknowns(fit, *problem), replace(fit, factors=np.ones_like(fit.factors))
    return found if found.follows else max(found, with_site_unknowns(again, *problem), key=lambda one: one.follows)


def _with_priors(scene, names, priors, fixed=()):
    """All parameters of a fit, and the priors as factors of the present values and relative standard uncertainties."""
    relative = {name: (value, sigma) if name == 'gain' else
                band_fits.relative_prior(name, value_of(scene, name), value, sigma, fixed)
                for name, (value, sigma) in priors.items()}
    far = scene.law.shells != 1 or getattr(scene.lattice, 'cutoff', None) is not None
    return band_fits.of_any_law(scene, names, relative, far)


def missing_magnet(found: FrfFits) -> NDArray[np.float64] | None:
    """The place in m of a magnet without which the better model follows the data clearly better; None if there is none.

    Each free magnet at which nothing is measured is left out in turn, first with wide peaks, and the `LIKELY` ones in a fit.
    """
    scene, better = found.scene, found.better
    atoms, *_ = scene.shaken(better.model, bench=True)
    measured = [dof.particle for one in found.functions for dof in (one.answer, one.drive) if isinstance(dof, Dof)]
    sites = np.setdiff1d(np.flatnonzero(freedom(atoms)[0]), measured).tolist()
    if scene.single or scene.finite or len(sites) > MOST_SITES:
        return None
    relative, left = _with_priors(scene, better.names, found.priors)[1], {}
    places = atoms.calc.reference.positions[:, :2] / u.m
    for k in tqdm(sites, desc='missing magnets', disable=None, leave=False):
        with suppress(PhysicsError):  # nothing holds the others
            left[k] = roughly_left(*_without(found, k, places[k]), relative)
    likely = {k: fit_transfer(*_without(found, k, places[k]), better.model, relative).misfit
              for k in sorted(left, key=left.__getitem__)[:LIKELY]}
    best = min(likely, key=likely.__getitem__, default=None)
    return None if best is None or likely[best] > better.misfit / EXPLAINS else places[best]


def _without(found, k, place):
    """The lattice without particle k, the names of its parameters, and the functions that count its particles."""
    before = found.scene.defects or Defects.model_construct(vacancies_m=())
    own = before.model_copy(update={'vacancies_m': (*before.vacancies_m, place.tolist())})

    def counted(dof):
        return replace(dof, particle=dof.particle - (dof.particle > k)) if isinstance(dof, Dof) else dof

    return (partial(_built, found.scene.model_copy(update={'defects': own}), found.better.model), found.better.names,
            [replace(one, answer=counted(one.answer), drive=counted(one.drive)) for one in found.functions])


def responses_of(scene: Scene, model: Model, functions: Sequence[TransferFunction],
                 factors: Mapping[str, float] | None = None) -> list[NDArray[np.complex128]]:
    """The response of a scene with `factors` of its parameters, at the frequencies of each function; these come `with_dofs`."""
    factors = dict(factors or {})
    return [factors.get('gain', 1.0) * one.h for one in solved(_built(scene, model, factors), functions)[1]]


def suspect_units(scene: Scene, functions: Sequence[TransferFunction]) -> str | None:
    """The most likely mistake in a file of transfer functions: a wrong unit, phase or quantity.

    The peaks of the scene and the measured ones are never at quite the same frequencies, so the curves differ. Therefore the
    peaks of both are widened to a ninth of the range. What then remains of a curve is its size, its phase, and their trend with
    frequency. A wrong unit changes these by far more than an error of ten percent in the lattice.

    Parameters
    ----------
    scene : Scene
        A scene with [frf], known to about ten percent.
    functions : sequence of TransferFunction
        As `with_dofs` returns them.

    Returns
    -------
    str or None
        The mistake in words; None if nothing fits better than what the file says.

    Examples
    --------
    >>> from dataclasses import replace
    >>> from magphonon import read_scene
    >>> from magphonon.response import receptance
    >>> from magphonon.response.transfer_functions import TransferFunction
    >>> from magphonon.scenes import with_dofs, suspect_units
    >>> scene = read_scene('oscillator')
    >>> h = receptance(*scene.shaken(), scene.frf.omega, scene.frf.damping)
    >>> functions = with_dofs(scene, [TransferFunction('point', h.omega, h.response)])
    >>> suspect_units(scene, functions)
    >>> suspect_units(scene, [replace(one, response=one.response.conj()) for one in functions])
    'phases of the opposite sign, e^{-i omega t}'
    """
    built = _built(scene, 'complete', {})
    off = dict.fromkeys(readings := _readings(functions), np.inf)
    wide = {words: np.concatenate([_wide(one) for one in own]) for words, own in readings.items()}
    for stretch in STRETCHES:
        at = {words: _computed(built, readings[words], stretch) for words in (None, SLOW)}
        for words in readings:  # all but one have the frequencies of the first
            computed = at[SLOW if words == SLOW else None]
            size = np.sqrt(np.linalg.norm(wide[words]) * np.linalg.norm(computed))
            off[words] = min(off[words], np.linalg.norm(wide[words] - computed) / size)
    best = min(off, key=lambda words: off[words])
    return best if off[None] > CLOSE and off[best] < min(BETTER * off[None], NEAR) else None


def _readings(functions):
    """The functions as they are, by None, and with each mistake undone, by its words."""
    undone = {'phases of the opposite sign, e^{-i omega t}': lambda w, h: h.conj(),
              'real and imaginary part exchanged': lambda w, h: 1j * h.conj(),
              'phases in rad under a header in degrees': lambda w, h: abs(h) * np.exp(1j * np.angle(h) / u.deg)}
    if not any(one.shaken for one in functions):
        undone |= {words: lambda w, h, factor=factor: factor * h for words, factor in SCALES.items()}
        undone |= {words: lambda w, h, order=order: (1j * w * u.s) ** order * h for order, words in WORDS.items()}
    mended = {words: [replace(one, response=mend(one.omega, one.response)) for one in functions]
              for words, mend in undone.items()}
    return {None: functions} | mended | {SLOW: [replace(one, omega=one.omega / (2 * np.pi)) for one in functions]}


def _computed(built, functions, stretch):
    """Responses, with wide peaks, of a lattice whose frequencies are `stretch` times as high."""
    there = [replace(one, omega=one.omega / stretch) for one in functions]
    found = solved(built, there)[1]
    return np.concatenate([_wide(replace(one, response=own.h / stretch**2)) for one, own in zip(functions, found, strict=True)])


def _wide(one):
    return with_wide_peaks(one, np.ptp(one.omega) / WIDEST).response


def with_dofs(scene: Scene, functions: Sequence[TransferFunction]) -> list[TransferFunction]:
    """The functions, with the particles of the scene at which they are measured and driven.

    Parameters
    ----------
    scene : Scene
        A scene with [frf], whose force and response apply to functions that do not name their own.
    functions : sequence of TransferFunction
        The functions that `read_transfer` returns.

    Raises
    ------
    ValueError
        If a place is outside the patch or on its rim; if two places belong to the same magnet; or if a function is driven by a
        force but the scene by the bench, or vice versa.
    """
    atoms, source, answer = scene.shaken(bench=True)
    found, places = [], {}
    for one in functions:
        seen = _place(atoms, one.answer, f'{one.name}, answer') or answer
        drive = source if one.shaken else _place(atoms, one.drive, f'{one.name}, drive') or source
        _check_bench(scene, one, drive)
        if isinstance(one.answer, np.ndarray) and not scene.single:
            first = places.setdefault(seen.particle, one)
            if tuple(one.answer[:2]) != tuple(first.answer[:2]):
                raise ValueError(f'{one.name} and {first.name} name different places next to the same magnet; correct their '
                                 'unit, or give every measurement of one magnet the same place')
        found.append(replace(one, answer=answer if scene.single else seen, drive=drive))
    return found


def _check_bench(scene, one, drive):
    """Raise ValueError if a function and what drives it are not both of a force, or of a bench shaken in one direction."""
    if one.shaken == isinstance(drive, Dof):
        what, have, give = (('the motion of the bench', '[frf.force]', 'frf.base_deg') if one.shaken else
                            ('a force', 'frf.base_deg', '[frf.force]'))
        raise ValueError(f'{one.name} is a response to {what}, and the scene has {have}; give {give} instead')
    if one.shaken and one.drive is not None and abs(np.exp(1j * one.drive[2]) - complex(*drive[:2])) > SAME_DIRECTION:
        raise ValueError(f'{one.name} is of a bench shaken along {one.drive[2] / u.deg:.4g} degrees, but frf.base_deg is '
                         f'{scene.frf.base_deg:g}; make them equal')


def _place(atoms: Atoms, place: NDArray[np.float64] | Dof | None, name: str) -> Dof | None:
    """The particle nearest to a place and the direction there; a Dof, and None, as they are."""
    if not isinstance(place, np.ndarray):
        return place
    x, y, angle = place
    try:
        return Pick.model_validate({'at_m': [float(x / u.m), float(y / u.m)], 'direction_deg': float(angle / u.deg)}).of(atoms)
    except ValueError as error:
        raise ValueError(f'{name}{error}') from None


def _built(scene, model, factors):
    """The `ParametricLattice` of the scene with its parameters multiplied by factors."""
    there, bends = _with(scene, {name: factor for name, factor in factors.items() if name != 'mass'})
    atoms, *_ = there.shaken(model, bench=True)
    atoms.set_masses(atoms.get_masses() * factors.get('mass', 1.0))
    return ParametricLattice(LinearSystem.of(atoms), there.frf.damping, band_fits.changes_of(there) | bends)


def _with(scene, factors):
    """The scene with its parameters multiplied by factors, and what those change by which its law departs from a power."""
    frf = scene.frf.model_copy(update={'damping_per_s': scene.frf.damping_per_s * factors.get('damping', 1.0)})
    there = band_fits.with_factors(scene, factors).model_copy(update={'frf': frf})
    return band_fits.with_bends(there, factors, REACH * scene.lattice.spacing_m * u.m)


def value_of(scene: Scene, name: str) -> float:
    """A parameter of the scene in SI; the mass is the mean one of the particles."""
    if name in ('damping', 'gain'):
        return float(scene.frf.damping_per_s) if name == 'damping' else 1.0
    return float(scene.lattice.cell().get_masses().mean() / u.kg) if name == 'mass' else band_fits.value_of(scene, name)
