"""One law, one foundation and one mass from several records of a lattice: forces, ridges of waves, transfer functions.

All records share a law of a `LawFamily`: any smooth law, or one near that of the magnets in the scene. Its parameters are force
and exponent at the spacing and five bends (deviations from a power). Every record of a lattice depends on all of them, because
each neighbour tests another part of the law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from warnings import catch_warnings, simplefilter

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units as u
from ..design.dispersion_fits import DispersionFit, fit_dispersion
from ..design.joint_fits import BEFORE, RESPONSES, RIDGES, Joint, Record, told
from ..design.least_squares import Before, best
from ..design.sensitivities import StiffnessDerivative, frequency_sensitivities
from ..design.site_unknowns import with_site_unknowns
from ..design.transfer_fits import ParametricLattice, TransferFit, fit_transfer
from ..errors import one_of
from ..findings import Proposal
from ..interactions.fits import ANY_SIZE, BENDS, SHAPE_WEIGHT, LawFamily, SharedErrors, curve_record
from ..interactions.force_tables import Forces
from ..interactions.pair_laws import PairLaw, Tabulated, local_exponent, repulsion
from ..response.transfer_functions import TransferFunction
from ..stiffness.bond import MODELS, Model
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import LinearSystem
from ..waves.ridge_tables import RidgePoints
from . import band_fits, frf_fits
from .scene import Scene

LAW = ('force', 'a', *band_fits.BENT)
CLOCK = 1e-3  # relative standard deviation of a clock
NEAREST_MEASURED = 0.8  # spacings from which on shapes are compared
NOTHING, HUGE = 1e-20, 1e9  # N: forces of trials of a fit are kept between them, the former at the spacing
ROUNDS = 2  # number of times that the records of tables are recomputed near the joint fit


@dataclass(frozen=True)
class Specimen:
    """A scene whose law belongs to a family; its methods are the counterparts of those of `band_fits` for these parameters.

    Attributes
    ----------
    scene : Scene
    family : LawFamily
    cell : ase.Atoms
        One cell of the lattice, with all neighbours that count.
    known : dict
        Factors of parameters that are known from elsewhere, and their relative standard uncertainties.
    """

    scene: Scene
    family: LawFamily
    cell: Atoms
    known: Mapping[str, tuple[float, float]]

    @classmethod
    def of(cls, scene: Scene, priors: Mapping[str, tuple[float, float]] | None = None) -> Specimen:
        """The specimen for a scene, with `priors` in SI; a tolerance of the mass in [uncertainty] is a prior too."""
        have = ('force', 'a', *(name for name in band_fits.parameters_of(scene) if name in band_fits.SPRINGS), 'mass')
        scene = band_fits.of_remanence(scene.counted())
        shape = scene.law.potential() if scene.law.kind == 'magnets' else None
        made = cls(scene, LawFamily(scene.lattice.spacing_m * u.m, shape), scene.perfect_cell(), {})
        present = dict(zip(LAW, made.start, strict=False))
        known = {name: band_fits.relative_prior(name, present.get(name) or frf_fits.value_of(scene, name), *prior, ())
                 for name, prior in (priors or {}).items() if one_of('the parameter of a prior', name, have)}
        told = scene.uncertainty and scene.uncertainty.tolerances(scene)
        if told and 'mass' in told.changes and 'mass' not in known:
            k = [*told.changes].index('mass')
            known['mass'] = 1.0, float(np.sqrt(told.covariance[k, k]))
        return replace(made, known=known)

    @property
    def springs(self) -> tuple[str, ...]:
        return tuple(name for name in band_fits.parameters_of(self.scene) if name in band_fits.SPRINGS)

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the parameters that all records share."""
        return (*LAW, *self.springs, *(['mass'] if 'mass' in self.known else []))

    @property
    def start(self) -> tuple[float, float]:
        """Force in N and exponent of the scene's law at the spacing."""
        law = self.scene.law.potential()
        return float(repulsion(law, self.family.r0)), float(local_exponent(law, self.family.r0))

    def p(self, factors: Mapping[str, float]) -> NDArray[np.float64]:
        """The parameters p of the family, from factors of force, exponent and bends."""
        (force, a), (_, _, (falls,)) = self.start, self.family.curve(np.zeros(len(LAW)), [self.family.r0])
        x = [np.log(factors.get(name, 1.0)) for name in LAW]
        return np.array([np.log(force) + x[0], a * np.exp(x[1]) + falls, *x[2:]])

    def x(self, p: NDArray[np.float64]) -> NDArray[np.float64]:
        """Logarithms of the factors of force, exponent and bends, from the parameters p of the family."""
        (force, a), (_, _, (falls,)) = self.start, self.family.curve(p, [self.family.r0])
        return np.array([p[0] - np.log(force), np.log(-falls / a), *p[2:]])

    def law(self, factors: Mapping[str, float]) -> Tabulated:
        """The law with these factors, as a table that covers all distances in the lattice."""
        r = band_fits.knots(self.cell, self.family.r0)
        ln_f, least = self.family.curve(self.p(factors), r)[0], np.log(NOTHING) - 4 * np.log(r / self.family.r0)
        with catch_warnings():
            simplefilter('ignore', UserWarning)  # of readings too far apart: these are no readings
            return Tabulated(r, np.exp(-np.logaddexp(-np.logaddexp(ln_f, least), -np.log(HUGE))))

    def on_springs(self, factors: Mapping[str, float]) -> Scene:
        """The scene with its springs multiplied by these factors, and its own law."""
        return band_fits.with_factors(self.scene, {name: factors[name] for name in self.springs if name in factors})

    def with_factors(self, factors: Mapping[str, float]) -> Scene:
        """The scene with law and springs multiplied by these factors; the law is a table."""
        law = self.law(factors)
        return band_fits.with_table(self.on_springs(factors), law.r, law.f)

    def changes_of(self, scene: Scene, law: PairLaw, factors: Mapping[str, float]) -> dict[str, StiffnessDerivative]:
        """The change of stiffness by each parameter, for a scene and a law that belong to these factors."""
        along = np.diag([1.0, self.start[1] * factors.get('a', 1.0), *np.ones(len(BENDS))])  # of delta by ln a
        of_law = {name: StiffnessDerivative(law=self.family.change(law, v)) for name, v in zip(LAW, along, strict=True)}
        springs = {name: one for name, one in band_fits.changes_of(scene).items() if name in self.springs}
        return of_law | springs | {'mass': StiffnessDerivative(mass=1.0)}

    @property
    def before(self) -> Record:
        """The prior knowledge as a record: the spread of the family, the priors, and force and springs to a factor of 20."""
        C = np.full(len(self.names), ANY_SIZE)
        C[1], C[2 : len(LAW)] = self.family.spread / self.start[1], 1.0
        x = np.zeros(len(self.names))
        x[1] = self.x(np.zeros(len(LAW)))[1]
        for name, (factor, sigma) in self.known.items():
            x[self.names.index(name)], C[self.names.index(name)] = np.log(factor), sigma
        return Record(BEFORE, x, 0 * x, np.diag(C**-2.0))

    @property
    def late(self) -> NDArray[np.float64]:
        """Apparent relative growth of all stiffness, at the same mass, if a clock runs slow by the fraction CLOCK."""
        return 2 * CLOCK * np.array([name == 'force' or name in self.springs for name in self.names], float)


@dataclass(frozen=True)
class JointFits:
    """A scene fitted to all records of a lattice.

    Attributes
    ----------
    specimen : Specimen
        The start of the fit, and the family of laws.
    joints : dict of Joint
        The joint fits by model.
    ridges : dict of DispersionFit
        Fits of the ridges by model; empty without ridges.
    responses : dict of TransferFit
        Fits of the transfer functions by model; empty without transfer functions.
    """

    specimen: Specimen
    joints: dict[str, Joint]
    ridges: dict[str, DispersionFit]
    responses: dict[str, TransferFit]

    @property
    def records(self) -> tuple[str, ...]:
        """Names of the records."""
        return tuple(one.name for one in self.joints['complete'].records[:-1])

    def factors(self, model: Model = 'complete') -> dict[str, float]:
        """The factors of the parameters at the joint fit."""
        joint = self.joints[one_of('model', model, tuple(self.joints))]
        return dict(zip(joint.names, np.exp(joint.x).tolist(), strict=True))

    def fitted(self, model: Model = 'complete') -> Scene:
        """The scene with the fitted law, as a table, and the fitted springs."""
        return self.specimen.with_factors(self.factors(model))

    def along(self) -> dict[str, NDArray[np.float64]]:
        """For force, exponent, bond stiffness, springs and mass: the powers of the parameters of which each is the product."""
        of = dict(zip(self.specimen.names, np.eye(len(self.specimen.names)), strict=True))
        return {'force': of['force'], 'a': of['a'], 'bond stiffness': of['force'] + of['a']} | {
            name: of[name] for name in self.specimen.names[len(LAW):]}

    def values(self, model: Model = 'complete') -> dict[str, tuple[float, float]]:
        """Value in SI and relative standard uncertainty of force, exponent, bond stiffness, springs and mass."""
        factors, joint, (force, a) = self.factors(model), self.joints[model], self.specimen.start
        present = {'force': force / u.N, 'a': a, 'bond stiffness': force * a / self.specimen.family.r0 / (u.N / u.m),
                   'mass': getattr(self.specimen.scene.lattice, 'mass_kg', 0.0)}
        return {name: (float((present[name] if name in present else band_fits.value_of(self.specimen.scene, name))
                             * np.prod([factors[one] ** power for one, power in zip(factors, v, strict=True)])),
                       joint.sigma_along(v)) for name, v in self.along().items()}

    def predicted(self, q: ArrayLike, model: Model = 'complete') -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Frequencies of the fitted lattice in rad/ms, and their relative standard uncertainties, by wavevector and branch."""
        factors = self.factors(model)
        cell, changes = _cell(self.specimen, factors)
        omega, slopes = frequency_sensitivities(cell, q, [changes[name] for name in factors], model)
        relative = slopes / abs(omega)
        return omega, np.sqrt(np.einsum('pqb,pr,rqb->qb', relative, self.joints[model].covariance(), relative))

    @property
    def evidence(self) -> float:
        """Evidence of all records for D*, in sigmas; transfer functions do not count, because their sites scatter."""
        more = 0.0
        for model, joint in self.joints.items():
            chi2 = sum(record.chi2(joint.x) for record in joint.records if record.name not in (RIDGES, RESPONSES))
            if self.ridges:
                chi2 += np.sum(self.ridges[model].residuals[: len(self.ridges[model].sigma_xi)] ** 2)
            more = chi2 - more
        return float(np.sign(more) * np.sqrt(abs(more)))

    @property
    def proposals(self) -> list[Proposal]:
        """Proposals for the next measurement: repeat a record with a new set-up, or measure a parameter by other means."""
        joint = self.joints['complete']
        return best(joint.sigma_along, 1.0, self.along(), {f'measure "{one.name}" again with a new set-up': one.information
                                                           for one in joint.records[:-1]})

    @property
    def laws(self) -> dict[str, float]:
        """Weights of three laws, from all records: any smooth law, an inverse power, and the shape that the scene names."""
        joint, family, scene = self.joints['complete'], self.specimen.family, self.specimen.scene
        shaped, a0, before = slice(1, len(LAW)), self.specimen.start[1], self.specimen.before
        known = np.diag(before.information)[shaped] * ([name not in self.specimen.known for name in LAW[shaped]])
        precision = np.linalg.inv(joint.covariance()[shaped, shaped])
        L, b = precision - np.diag(known), precision @ joint.x[shaped] - known * before.estimate[shaped]  # of the records alone
        tried = {'any smooth law': LawFamily(family.r0), 'an inverse power': LawFamily(family.r0)}
        if scene.law.kind in ('magnets', 'table'):
            tried['the shape in the scene'] = LawFamily(family.r0, scene.law.potential())
        r = np.geomspace(NEAREST_MEASURED * family.r0, repulsion_of(self.specimen.cell).bonds.lengths.max(), band_fits.KNOTS)
        ln = {words: np.log(SHAPE_WEIGHT) for words in tried}
        ln['any smooth law'] = np.log(1 - SHAPE_WEIGHT * (len(tried) - 1))
        for words, one in tried.items():
            a, bends = family.coordinates(one, r)
            size = np.append(one.spread / a0, np.full(len(BENDS), one.tau / family.tau * (words != 'an inverse power')))
            ln[words] += _evidence(L, b, np.append(np.log(a / a0), bends), np.diag(size**2))
        weights = np.exp(np.array([*ln.values()]) - max(ln.values()))
        return dict(zip(ln, (weights / weights.sum()).tolist(), strict=True))

    @property
    def one_spring(self) -> float | None:
        """Weight of one spring for both directions against two that differ by about 20 % (Savage and Dickey); None if the fit
        has only one.
        """
        from scipy.stats import norm

        if len(self.specimen.springs) < 2:
            return None
        joint = self.joints['complete']
        turn = np.array([(name == 'foundation_x') * 1.0 - (name == 'foundation_y') for name in joint.names])
        x, y = (band_fits.value_of(self.specimen.scene, name) for name in self.specimen.springs)
        found = turn @ joint.x + np.log(x / y)
        odds = norm.logpdf(found, scale=joint.sigma_along(turn)) - norm.logpdf(0.0, scale=SPRINGS_DIFFER)
        return float(1 / (1 + np.exp(-np.clip(odds, -50, 50))))


def _evidence(L, b, mean, C):
    """Logarithm of the mean of a likelihood e^(b.x - x.L.x/2) over a normal distribution."""
    g, turned = b - L @ mean, np.eye(len(b)) + C @ L
    return b @ mean - mean @ L @ mean / 2 + g @ np.linalg.solve(turned, C @ g) / 2 - np.linalg.slogdet(turned)[1] / 2


SPRINGS_DIFFER = 0.2  # standard deviation of the logarithm of the ratio of two springs, before anything is measured


def fit_records(scene: Scene, forces: Mapping[str, Forces] | None = None, ridges: RidgePoints | None = None,
                shared: SharedErrors | None = None, pair_sigma: float = 0.0,
                priors: Mapping[str, tuple[float, float]] | None = None, functions: Sequence[TransferFunction] = (),
                gain_sigma: float = frf_fits.GAIN) -> JointFits:
    """Fit one law and one foundation to forces, ridges and transfer functions of the same lattice, with D* and without.

    Parameters
    ----------
    scene : Scene
        Spacing and mass are taken from it; its force, exponent and springs are the start of the fit.  The law may be any smooth
        law; if the scene names the shape of the magnets, it is near their law, with a tolerance of 3 %.  A tolerance of the mass
        in [uncertainty] is included.
    forces : dict of Forces, optional
        Tables of forces by name; each has its own shared errors.
    ridges : RidgePoints, optional
        All measured ridges. They share the shift of their specimen, so they are one record.
    shared : SharedErrors, optional
        Shared errors of each table of forces.
    pair_sigma : float
        Relative standard deviation of the force of a pair from the mean of the lattice; for strengths that scatter by s it is
        sqrt(2) s.
    priors : dict, optional
        Prior knowledge about 'force', 'a', the springs or 'mass': value in SI and standard uncertainty.
    functions : sequence of TransferFunction
        Transfer functions of a patch of these magnets. Its sites scatter, so the mean of the patch differs from that of the
        lattice.
    gain_sigma : float
        Relative standard uncertainty of the calibration of the transfer functions.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import read_scene
    >>> from magphonon.interactions.force_tables import synthetic_forces
    >>> from magphonon.interactions.fits import SharedErrors
    >>> from magphonon.scenes.joint_fits import fit_records
    >>> scene = read_scene('prototype')
    >>> r = np.linspace(8, 20, 25)
    >>> tables = {name: synthetic_forces(scene.law.potential(), r, 1e-3, seed) for seed, name in enumerate(['near', 'far'])}
    >>> fits = fit_records(scene, tables, shared=SharedErrors(distance=0.02))
    >>> force, sigma = fits.values()['force']
    >>> bool(abs(np.log(force / 0.2369)) < 2 * sigma), bool(sigma < fits.joints['complete'].alone('near').sigma[0])
    (True, True)
    """
    specimen, shared = Specimen.of(scene, priors), shared or SharedErrors()
    shared = replace(shared, gain=float(np.hypot(shared.gain, pair_sigma)))
    points, fits, at, seen = None if ridges is None else ridges.independent, {}, {}, {}
    for k in range(ROUNDS):  # tables are not linear in their zeros
        records = {model: [*(_of_forces(specimen, name, one, shared, at.get(model)) for name, one in (forces or {}).items()),
                           *([seen[model][0]] if seen else []), specimen.before] for model in MODELS}
        at = {model: told(own)[1] for model, own in records.items()}
        if points is not None:
            points, fits = _ridges(specimen, points, records, fits)
            at = {model: np.log(fit.factors) for model, fit in fits.items()}
        if functions and not k:
            for model, own in records.items():
                seen[model] = _of_responses(specimen, frf_fits.with_dofs(scene, functions), model, gain_sigma, own,
                                            seen['complete'][1] if seen else None)
            at = {model: told([seen[model][0], *own])[1] for model, own in records.items()}
    joints = {model: Joint(specimen.names, at[model], tuple(own)) for model, own in records.items()}
    return JointFits(specimen, joints, fits, {model: fit for model, (_, fit) in seen.items()})


def _of_responses(specimen, functions, model, gain_sigma, others, better=None):
    """The record of transfer functions of a patch, and their fit near the other records; no fit if `better` is clearly better."""
    n, (root, centre) = len(specimen.names), told(others)
    before = Before(np.append(centre, [0.0, 0.0]), np.zeros((n + 1, n + 2)))
    before.root[:n, :n], before.root[n, n + 1] = root, 1 / gain_sigma
    build, names = partial(_patch, specimen, model), (*specimen.names, 'damping', 'gain')
    fit = fit_transfer(build, names, functions, model, before, np.exp(before.centre) if better is None else better.factors)
    worse = better is not None and fit.square > frf_fits.CLEARLY**2 * better.square
    fit = fit.refused if worse else with_site_unknowns(fit, build, functions, before)
    x, F = fit.of_batch
    record = Record(RESPONSES, x[:n], np.zeros(n), np.zeros((n, n)), {'the clock': specimen.late})
    if not fit.follows:
        return record, fit
    g, F = before.information @ (before.centre - x), F - before.information  # the data balance the prior
    g, F = g / fit.scatter**2, F / fit.scatter**2
    g[-1], F[-1, -1] = g[-1] + x[-1] / gain_sigma**2, F[-1, -1] + gain_sigma**-2  # the gain is its own
    away = F[:n, n:] @ np.linalg.inv(F[n:, n:])
    return replace(record, gradient=g[:n] - away @ g[n:], information=F[:n, :n] - away @ F[n:, :n]), fit


def _patch(specimen, model, factors):
    """The patch of the scene with these factors, and the change of stiffness by each."""
    with catch_warnings():
        simplefilter('ignore', UserWarning)  # of readings too far apart, as in `Specimen.law`
        there = specimen.with_factors(factors)
        atoms, *_ = there.shaken(model, bench=True)
        atoms.set_masses(atoms.get_masses() * factors.get('mass', 1.0))
        return ParametricLattice(LinearSystem.of(atoms), there.frf.damping * factors['damping'],
                                 specimen.changes_of(there, specimen.law(factors), factors))


def _ridges(specimen, points, records, near):
    """The points, with uncertainties enlarged to the scatter about the better model, and their fits; adds these to `records`."""
    others, build = {model: Before(*told(own)[::-1]) for model, own in records.items()}, partial(_cell, specimen)
    fits = {model: fit_dispersion(build, specimen.names, points, model, known, near.get(model))
            for model, known in others.items()}
    scatter = min(fit.scatter for fit in fits.values())
    if scatter > 1:
        points = replace(points, sigma_omega=scatter * points.sigma_omega, sigma_xi=scatter * points.sigma_xi)
        fits = {model: fit_dispersion(build, specimen.names, points, model, others[model], fit) for model, fit in fits.items()}
    for model, fit in fits.items():
        x, known = np.log(fit.factors), others[model].root.T @ others[model].root
        gradient = known @ (others[model].centre - x)  # that of the others, which the ridges balance
        records[model].insert(-1, Record(RIDGES, x, gradient, fit.information - known, {'the clock': specimen.late}))
    return points, fits


def _cell(specimen, factors):
    """One cell of the lattice with these factors, and the change of stiffness by each."""
    there, law, calc = specimen.on_springs(factors), specimen.law(factors), repulsion_of(specimen.cell)
    atoms = specimen.cell.copy()
    springs = there.foundation.springs(there.foundation.stiffness) if there.foundation else 0.0
    atoms.set_masses(atoms.get_masses() * factors.get('mass', 1.0))
    atoms.calc = calc.changed(laws=law, sites=replace(calc.sites, foundation=springs))
    return atoms, specimen.changes_of(there, law, factors)


def _of_forces(specimen, name, forces, shared, near=None):
    """The record of a table of forces, near given logarithms of the parameters or its own best ones."""
    n = len(LAW)
    curve = curve_record(forces, specimen.family, shared, None if near is None else
                         specimen.p(dict(zip(LAW, np.exp(near[:n]).tolist(), strict=True))))
    turn = np.zeros((n, len(specimen.names)))  # from logarithms to the parameters of the family
    turn[:, :n] = np.diag([1.0, -specimen.family.curve(curve.p, [specimen.family.r0])[2][0], *np.ones(len(BENDS))])
    x, by_distance = np.zeros((2, len(specimen.names)))
    x[:n], by_distance[:n] = specimen.x(curve.p), curve.by_distance / np.diag(turn)
    faults = {'the gain (or the strength of the pair)': shared.gain * np.eye(len(x))[0], 'the zero of the distances': by_distance}
    return Record(name, x, turn.T @ curve.gradient, turn.T @ curve.information @ turn, faults, curve.chi2)
