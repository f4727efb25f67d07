"""A lattice for a wanted wave: every magnet, rod and foot is designed by exact gradients, which include the change of the rest
positions, so that copies built with the errors of a workshop keep what the design promises.

`optimise` maximises an `Objective` within bounds.  With errors it maximises the soft minimum `-tau ln mean exp(-c/tau)` of the
values c of all targets and of a few copies, which are drawn afresh at each step: a design for copies that are drawn once fits
these copies and no others.  Adam's steps need no more than the mean direction of noisy slopes; meanwhile parts that can be bought
are frozen one by one.  Without errors SciPy's L-BFGS-B finds the maximum.  `verify` judges any structure on unseen copies.
"""

from __future__ import annotations

import csv
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from itertools import product
from os import PathLike
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack
from scipy.optimize import minimize
from tqdm import tqdm

from .. import units
from ..errors import Unstable, finite, not_negative, one_of, positive, shown, whole
from ..files import whole_file
from ..lattices.bonds import lengths_of, pairs_within
from ..stability.buckling import common_spring, softest_of
from ..stiffness.matrices import MODELS, Central, Model, hessian
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import LinearSystem
from ..traits import takes
from .objectives import Objective, soft_minimum, targets_of
from .scatter import REGULAR, RODS, Rest, Slope, site_slopes
from .sensitivities import force_change, steeper

KINDS = 'strength', 'magnet', 'spring', 'rod', 'mass', 'foot'
"""What may vary from site to site: factors of the strength of a magnet; of strength and mass of a thicker magnet; of the
stiffness of a spring; of the diameter of a rod, whose stiffness goes with its fourth and whose moving mass with its second power;
of the mass; and displacements of the foot in mm."""
ADDED = 'foot', 'exponent'  # fields of Parts that add up; all others are factors
COMMON = 6  # errors of a whole copy
NEWTONS, LONGEST = 40, 0.05  # most steps to rest, and the longest one, in shortest bonds
SETTLED = 1e-12  # what the last of Newton's steps to rest leaves at most, in shortest bonds: steps shrink by more each time
CHORDS, CLOSE = 12, 1e-8  # most steps with the factors of a rest nearby, and what the last of these leaves
IN_STEPS = 4  # steps in which the parts are brought on where Newton's method alone finds no stable rest
RESTARTS = 3  # of L-BFGS-B, after it met designs that buckle
FIRST = 0.05  # standard deviation of the parameters at a start, of half the width of their bounds
AT_BOUND = 1e-6  # of the width
FAR = 10.0  # a design that buckles counts as worse than the best one by this much
RATE, FALLS, FALL = 0.05, 0.3, 0.7  # Adam's step in half widths; from which share of the steps on it falls, and by which power
GROW, LEAST = 0.15, 0.02  # share of the steps in which the errors grow to their full size, and with which part they begin
FREEZE = 0.35, 0.85  # shares of the steps between which parts are frozen to grades
MEMORY, LONG_MEMORY = 0.9, 0.99  # of Adam, for the slopes and for their squares
NEAR = 1.25  # times the shortest bond: a pair that comes as near without a bond is missed by more than a third of its force
BACK = 0.97  # parameters of a design that buckles shrink by this factor


@dataclass(frozen=True)
class Parts:
    """Factors of the parts of a structure: as they are designed, or as they deviate in one copy.

    Attributes
    ----------
    strength, spring, mass : float or ndarray, shape (particles,)
    foot : float or ndarray, shape (particles, dim)
        Displacements in mm.
    force, frequency, spacing : float
        Factors of all forces between particles, as of a batch of magnets, of the frequencies of all sources, and of all
        distances between feet.
    exponent : float
        Added to the exponent of the law, -d ln f/d ln r, while the force at the shortest distance stays.
    """

    strength: Any = 1.0
    spring: Any = 1.0
    mass: Any = 1.0
    foot: Any = 0.0
    force: float = 1.0
    frequency: float = 1.0
    spacing: float = 1.0
    exponent: float = 0.0

    def __mul__(self, other: Parts) -> Parts:
        return Parts(*(a + b if f.name in ADDED else a * b for f in fields(self)
                       for a, b in [(getattr(self, f.name), getattr(other, f.name))]))

    def __pow__(self, share: float) -> Parts:
        return Parts(*(share * one if f.name in ADDED else one**share for f in fields(self) for one in [getattr(self, f.name)]))


@dataclass(frozen=True)
class Errors:
    """Standard deviations of what is built, about what was designed; what is not named is exact.

    Errors of a batch, common to all parts of a copy, have the names of the keys of [uncertainty] in a scene; those of each single
    part begin with `each`.

    Attributes
    ----------
    force_percent, mass_percent, stiffness_percent, frequency_percent, spacing_percent : float
        Common to all magnets, particles, springs, sources, and to all distances between feet.
    exponent : float
        Of the law, -d ln f/d ln r at the shortest distance.
    each_strength_percent, each_mass_percent, each_stiffness_percent : float
        Of every magnet, particle and spring by itself.
    each_foot_mm : float
        Of every foot along each axis.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.design import Errors
    >>> errors = Errors(force_percent=2.0, each_foot_mm=0.1)
    >>> errors.names
    ('force_percent', 'each_foot_mm')
    >>> errors.draw(np.random.default_rng(0), particles=5, dim=2).foot.shape
    (5, 2)
    """

    force_percent: float = 0.0
    mass_percent: float = 0.0
    stiffness_percent: float = 0.0
    frequency_percent: float = 0.0
    spacing_percent: float = 0.0
    exponent: float = 0.0
    each_strength_percent: float = 0.0
    each_mass_percent: float = 0.0
    each_stiffness_percent: float = 0.0
    each_foot_mm: float = 0.0

    def __post_init__(self) -> None:
        for f in fields(self):
            not_negative(f.name, getattr(self, f.name), f.name.rpartition('_')[2])

    @property
    def names(self) -> tuple[str, ...]:
        """The errors that are not zero."""
        return tuple(f.name for f in fields(self) if getattr(self, f.name))

    def draw(self, rng: np.random.Generator, particles: int, dim: int, scale: float = 1.0) -> Parts:
        """The deviations of one copy, drawn from Gaussians (of logarithms, for factors) of `scale` times the errors.

        All deviations use their own random numbers, so that copies with fewer errors are otherwise the same copies.
        """
        return self.parts(scale * rng.normal(size=COMMON + (3 + dim) * particles), particles, dim)

    def parts(self, z: NDArray[np.float64], particles: int, dim: int) -> Parts:
        """The deviations of z standard deviations: six common ones, then those of strengths, masses, springs and feet."""
        force, mass, spring, frequency, spacing, exponent = z[:COMMON]
        strength, masses, springs, *feet = z[COMMON:].reshape(-1, particles)
        return Parts(np.exp(self.each_strength_percent / 100 * strength),
                     np.exp((self.each_stiffness_percent * springs + self.stiffness_percent * spring) / 100),
                     np.exp((self.each_mass_percent * masses + self.mass_percent * mass) / 100),
                     self.each_foot_mm * np.reshape(feet, (particles, dim)),
                     *(float(np.exp(percent / 100 * one)) for percent, one in (
                         (self.force_percent, force), (self.frequency_percent, frequency), (self.spacing_percent, spacing))),
                     float(self.exponent * exponent))  # pyright: ignore[reportCallIssue]  after three

    def slopes(self, rest: Rest, by_sites: Mapping[str, Any], feet: NDArray[np.float64]) -> NDArray[Any]:
        """Derivatives by the numbers z of `parts`, from those by sites (`site_slopes`) of a structure on these feet.

        Those by the frequency, which shifts no part, and by the exponent are left at zero.
        """
        strength, spring, mass = by_sites['strength'], by_sites['spring'].sum(1), rest.masses * by_sites['mass']
        common = (self.force_percent * strength.sum() / 2, self.mass_percent * mass.sum(), self.stiffness_percent * spring.sum(),
                  0.0, self.spacing_percent * (feet * by_sites['foot']).sum(), 0.0)
        each = (self.each_strength_percent * strength, self.each_mass_percent * mass, self.each_stiffness_percent * spring)
        return np.concatenate([np.divide(common, 100), *np.divide(each, 100), self.each_foot_mm * by_sites['foot'].ravel()])


class Structure:
    """A structure as it was given, which finds its rest again if its parts are others."""

    @takes('constraints', 'oblique')
    def __init__(self, atoms: Atoms, rod_mass: float | None = None) -> None:
        self.atoms, self.calc = atoms, repulsion_of(atoms).about(atoms, model='complete')
        self.system = LinearSystem.about(self.calc, atoms).moving()
        calc, given = self.calc, Rest.of(self.system)
        self.shape, self.springs, self.masses, self.frame = given.springs.shape, given.springs, given.masses, given.frame
        self.rods = (given.rods if rod_mass is None else not_negative('rod_mass', rod_mass, 'g')) + 0.0 * self.masses
        law = given.interaction.central(calc.dim)
        if law is None:
            raise ValueError('a design needs forces along the bonds between particles; upright magnets that leave their plane '
                             'have others: hold them in the plane')
        self.law, self.feet, self.strengths = law, calc.anchors[:, : calc.dim], np.broadcast_to(calc.strengths, len(atoms))
        self.spans = calc.bond_vectors - self.frame.stretch(calc.slack[:, : calc.dim])  # of the feet
        self.kept, self.load = float(calc.bonds.lengths.min()), calc.load[:, : calc.dim]

    def rest(self, parts: Parts | None = None, near: Rest | None = None, model: Model = 'complete') -> Rest:
        """The structure at rest with other parts; from another rest `near` this one, by chord steps with its factors.

        Raises Unstable if there is no stable equilibrium near the feet.
        """
        parts = parts or Parts()
        try:
            return self._rest(parts, near, model)
        except Unstable:
            near = None
            for share in np.linspace(0, 1, IN_STEPS + 1)[1:]:
                near = replace(self._rest(parts**share, near, model), solve=None)
            return self._rest(parts, near, model)

    def _rest(self, parts, near, model):
        frame, at = self.frame, self._with(parts, model)
        rest, chord = (at(np.zeros(self.shape)), None) if near is None else (at(near.bent), near.solve)
        size = SETTLED
        for steps in range(NEWTONS):
            force = frame.along(frame.gather(rest.pull) - rest.spring_forces - self.load)
            solve = chord if chord and steps < CHORDS else _newton(rest)
            step = frame.spread(solve(force))
            last, size = size, abs(step).max() / self.kept
            rest = at(rest.bent - step * min(1, LONGEST / max(size, SETTLED)))
            if not size * min(1, size / last) > (CLOSE if solve is chord else SETTLED):
                break
        else:
            raise Unstable('no equilibrium is found near the first positions: the structure buckles or slides')
        H = frame.hessian(rest.K('complete'), rest.springs)
        rest.solve = _cholesky(H)
        if not np.isfinite(rest.bent).all() or rest.solve is None or not self._waves_hold(rest):
            raise Unstable('the equilibrium is a saddle: the structure buckles')
        if model == 'complete':
            rest.stiffness = H
        return rest

    def _with(self, parts, model):
        """The structure with other parts, as a function of how far its particles have moved from their feet."""
        calc, frame, (n, dim) = self.calc, self.frame, self.shape
        i, j, strength = calc.bonds.i, calc.bonds.j, np.broadcast_to(parts.strength, n)
        law: Any = steeper(force_change(self.law, parts.force * strength[i] * strength[j]), parts.exponent, self.kept)
        unbent = calc.bond_vectors + (parts.spacing - 1) * self.spans + frame.stretch(np.broadcast_to(parts.foot, self.shape))
        k, masses = self.springs * np.broadcast_to(parts.spring, n)[:, None], self.masses * parts.mass
        rods = self.rods * np.sqrt(parts.spring)  # both go with the diameter
        return lambda bent: Rest(frame, unbent + frame.stretch(bent), Central(law), k, -k * (calc.slack[:, :dim] + bent), masses,
                                 model, None, bent, rods)

    def _waves_hold(self, rest):
        """Whether the waves of a periodic cell with q = 0 or 1/2 along each vector are stable."""
        edges = [*product(*((0.0, 0.5) if along else (0.0,) for along in self.atoms.pbc))][1:]
        matrices = (hessian(rest.frame.bonds, rest.K('complete'), rest.springs, q) for q in edges)
        return all(_cholesky((self.frame.free.T @ H @ self.frame.free).toarray()) for H in matrices)

    def refuse_strangers(self, rest: Rest, parts: Parts) -> None:
        """Raise ValueError if a copy brings particles as near as neighbours that have no bond."""
        n, atoms, bonds, mobile = np.int64(len(self.atoms)), self.calc.reference.copy(), self.calc.bonds, self.system.mobile
        known = [bonds.i * n + bonds.j, *(a * n + b for a, b, *_ in [pairs_within(atoms, NEAR * self.kept)])]
        atoms.positions[:, : self.shape[1]] += parts.foot + rest.bent
        i, j, _, R = pairs_within(atoms, NEAR * self.kept)
        strange = ~np.isin([i * n + j, j * n + i], np.concatenate(known)).any(0) & (mobile[i] | mobile[j])
        if strange.any():
            r = lengths_of(R)
            k = np.where(strange, r, np.inf).argmin()
            raise ValueError(f'errors bring particles {i[k]} and {j[k]}, which have no bond, to within {r[k]:.3g} mm; the '
                             f'shortest bond is {self.kept:.3g} mm long, so their repulsion would be missed: give the structure '
                             'a larger cutoff, or smaller errors')

    def at(self, rest: Rest, parts: Parts) -> Atoms:
        """The structure as atoms at rest, with their calculator."""
        calc, dim = self.calc, self.calc.dim
        foot = np.broadcast_to(parts.foot, self.shape)
        atoms, anchors = calc.reference.copy(), np.array(calc.anchors)
        anchors[:, :dim] += foot
        atoms.positions[:, :dim] += foot + rest.bent
        atoms.set_masses(rest.masses)  # pyright: ignore[reportArgumentType]  ASE declares its default
        atoms.set_constraint(self.atoms.constraints)
        atoms.calc = calc.about(atoms, anchors=anchors, foundation=rest.springs,
                                strengths=calc.strengths * parts.strength * np.sqrt(parts.force))
        for one in (atoms, atoms.calc.reference):  # which files of ASE keep
            one.set_array(RODS, rest.rods)
        return atoms


def _newton(rest):
    """Solution with the static stiffness, or with D0 where that is not positive definite: away from rest."""
    for model in MODELS:
        solve = _cholesky(rest.frame.hessian(rest.K(model), rest.springs))
        if solve:
            return solve
    raise Unstable('no equilibrium is found: not even the springs hold the structure')


def _cholesky(H):
    """Solution with a positive definite matrix, or None if it has another eigenvalue."""
    H = np.array(H.T, order='F')  # symmetric: as LAPACK has it in memory
    H[np.diag_indices(len(H))] += REGULAR * (abs(H.diagonal()).max() or 1.0)
    factor, bad = lapack.dpotrf(H, lower=True, clean=False, overwrite_a=True)  # pyright: ignore[reportAttributeAccessIssue]  not in stubs
    return None if bad else lambda b: lapack.dpotrs(factor, b, lower=True)[0]  # pyright: ignore[reportAttributeAccessIssue]


class Variables:
    """The variable parts of a structure as one vector of numbers between -1 and 1.

    A factor within (low, high) is `exp(middle + x half)`, with the middle and half the width of the range of logarithms; a foot
    in mm is `middle + x half`.
    """

    def __init__(self, structure: Structure, over: Mapping[str, tuple[float, float]],
                 parts: Mapping[str, ArrayLike] | None = None) -> None:
        self.structure, self.over, dim = structure, dict(over), structure.shape[1]
        self.sites = np.flatnonzero(structure.system.mobile)
        if not over or not len(self.sites):
            raise ValueError('nothing can vary: name a parameter in over=, and leave a particle free to move')
        if (structure.masses <= structure.rods)[self.sites].any():
            raise ValueError(f'rod_mass is the moving mass of a rod, {structure.rods.max():g} g; the masses of sites include it, '
                             f'the lightest with {structure.masses[self.sites].min():g} g; give each site the mass of both')
        sizes = [len(self.sites) * (dim if name == 'foot' else 1) for name in over]
        bounds = np.repeat([self._bounds(*one) for one in over.items()], sizes, axis=0)
        self.middle, self.half = bounds.mean(axis=1), np.ptp(bounds, axis=1) / 2
        self._slices = {name: slice(end - size, end) for name, size, end in zip(over, sizes, np.cumsum(sizes), strict=True)}
        self.grades = {name: self._graded(name, factors) for name, factors in (parts or {}).items()}

    def _bounds(self, name, bounds):
        one_of('parameter of a design', name, KINDS)
        low, high = finite(f'bounds of {name}', bounds, (2,))
        if not low < high or (name != 'foot' and not low > 0):
            what = 'numbers in mm' if name == 'foot' else 'positive factors'
            raise ValueError(f'the bounds of {name} must be two increasing {what}, not {low:g} and {high:g}; leave '
                             f'{name} out if it is not to vary')
        if name in ('spring', 'rod') and not self.structure.springs[self.sites].any():
            raise ValueError(f'{name} varies the springs of a foundation, and there is none; give a foundation, or omit {name}')
        return (low, high) if name == 'foot' else (np.log(low), np.log(high))

    def _graded(self, name, factors):
        """The values of x of parts that can be bought."""
        if name not in self.over or name == 'foot':
            raise ValueError(f'parts may be given for parameters that vary, {", ".join(self.over)}, not for {name!r}')
        given = np.atleast_1d(finite(f'parts of {name}', factors))
        if not (given > 0).all():
            raise ValueError(f'the parts of {name} must be positive factors, not {shown(factors)}')
        x = (np.sort(np.log(given)) - self.middle[self._slices[name]][0]) / self.half[self._slices[name]][0]
        if not (abs(x) <= 1 + AT_BOUND).any():
            raise ValueError(f'none of the parts {given.tolist()} of {name} lies within its bounds {self.over[name]}')
        return np.clip(x[abs(x) <= 1 + AT_BOUND], -1, 1)

    def __len__(self) -> int:
        return len(self.middle)

    @property
    def present(self) -> NDArray[np.float64]:
        """The parameters x of the given structure, or the nearest ones within the bounds."""
        return np.clip(-self.middle / self.half, -1, 1)

    def values(self, x: NDArray[np.float64]) -> dict[str, Any]:
        """Factors of each site, shape (particles,), and displacements of feet in mm, shape (particles, dim)."""
        p, (n, dim), found = self.middle + self.half * x, self.structure.shape, {}
        for name, part in self._slices.items():
            found[name] = np.zeros((n, dim)) if name == 'foot' else np.ones(n)
            found[name][self.sites] = p[part].reshape(-1, dim) if name == 'foot' else np.exp(p[part])
        return found

    def parts(self, x: NDArray[np.float64]) -> Parts:
        """The parts for these parameters: springs and masses follow rods and magnets."""
        v: Any = {'strength': 1.0, 'magnet': 1.0, 'spring': 1.0, 'rod': 1.0, 'mass': 1.0, 'foot': 0.0} | self.values(x)
        magnet, rod = self._masses(v['magnet'], v['rod'])
        return Parts(v['strength'] * v['magnet'], v['spring'] * v['rod'] ** 4,
                     v['mass'] * (magnet + rod) / self.structure.masses, v['foot'])

    def _masses(self, magnet, rod):
        """Masses of the magnets and moving masses of the rods in g."""
        return (self.structure.masses - self.structure.rods) * magnet, self.structure.rods * rod**2

    def gradient(self, x: NDArray[np.float64], slopes: Mapping[str, Any], masses: NDArray[np.float64]) -> NDArray[np.float64]:
        """Derivatives by the parameters x, from those by sites with these masses (`site_slopes`)."""
        v, by_mass, by_spring = self.values(x), masses * slopes['mass'], slopes['spring'].sum(1)
        magnet, rod = self._masses(v.get('magnet', 1.0), v.get('rod', 1.0))
        share = rod / (magnet + rod)
        by = {'strength': slopes['strength'], 'magnet': slopes['strength'] + (1 - share) * by_mass, 'spring': by_spring,
              'rod': 4 * by_spring + 2 * share * by_mass, 'mass': by_mass, 'foot': slopes['foot']}
        return self.half * np.concatenate([by[name][self.sites].ravel() for name in self.over])

    def freeze(self, x: NDArray[np.float64], frozen: NDArray[np.bool_], share: float) -> NDArray[np.float64]:
        """Round the parameters nearest to their grades, in place, until this share of all graded ones is `frozen`."""
        near, graded = x.copy(), np.zeros(len(x), bool)
        for name, grades in self.grades.items():
            part = self._slices[name]
            graded[part], near[part] = True, grades[abs(x[part][:, None] - grades).argmin(1)]
        waiting = np.flatnonzero(graded & ~frozen)
        away = (self.half * abs(near - x))[waiting]
        chosen = waiting[np.argsort(away, kind='stable')[: max(0, round(share * graded.sum()) - int((graded & frozen).sum()))]]
        x[chosen], frozen[chosen] = near[chosen], True
        return x


@dataclass(frozen=True, eq=False)
class SiteDesign:
    """A structure designed for some targets.

    Attributes
    ----------
    atoms : ase.Atoms
        The structure at rest, with its calculator.
    targets : tuple of Objective
    variables : Variables
        The parameters that varied, and their bounds.
    x : ndarray, shape (parameters,)
        The parameters, -1 and 1 at their bounds.
    promised, given : ndarray, shape (targets,)
        Values of the targets without errors, in the model of the design and in the complete model.
    buckled : int
        Number of evaluations that found no stable equilibrium.
    """

    atoms: Atoms
    targets: tuple[Objective, ...]
    variables: Variables
    x: NDArray[np.float64]
    promised: NDArray[np.float64]
    given: NDArray[np.float64]
    buckled: int

    @property
    def value(self) -> float:
        """The smallest value of a target, in the complete model."""
        return float(self.given.min())

    @property
    def values(self) -> dict[str, Any]:
        """Factors of the parameters that varied for each site, and displacements of feet in mm."""
        return self.variables.values(self.x)

    @property
    def words(self) -> list[str]:
        """What limits the design, in words."""
        rest = Rest.of(self.atoms)
        return [f'{self.buckled} trial designs buckled and were discarded.'] * bool(self.buckled) + [
            words for target in self.targets for words in target.doubts(rest)]


def optimise(atoms: Atoms, objective: Objective | Sequence[Objective], over: Mapping[str, tuple[float, float]], *,
             parts: Mapping[str, ArrayLike] | None = None, errors: Errors | None = None, model: Model = 'complete',
             rod_mass: float | None = None, steps: int = 100, draws: int = 8, tau: float = 4.0, seed: int = 0) -> SiteDesign:
    """Maximise an objective of a structure, or the worst of several.

    Parameters
    ----------
    atoms : ase.Atoms
        With its PairCalculator; it need not be at rest.
    objective : Objective or sequence of Objective
        One target or several, such as the contrasts at several frequencies.
    over : dict
        What may vary, and its bounds: factors of the `strength` of each site, of the strength and mass of its `magnet`, of its
        `spring`, of the diameter of its `rod`, of its `mass`; displacements of each `foot` in mm along each axis.
    parts : dict, optional
        Factors that can be bought, such as `{'strength': [0.9, 1.0, 1.1]}`.
    errors : Errors, optional
        Errors of copies that the design must tolerate.
    model : {'complete', 'conventional'}
        Model of the waves; statics always follow the complete model.
    rod_mass : float, optional
        Moving mass of one rod in g, 33/140 of the whole, which the masses of the atoms include: it goes with the square of the
        diameter.  Responses to a force then take each rod as a cantilever, whose stiffness depends on the frequency, and so do
        `verify` and `trim`, which find these masses in `atoms.arrays['rod_masses']`.  By default, they are taken from there.
    steps : int
        Iterations. With errors or parts a few hundred are a beginning, and 2000 are a design.
    draws : int
        Copies at each step, drawn afresh.
    tau : float
        Width of the soft minimum over targets and copies, in the unit of the objective.
    seed : int
        Seed of the copies and of the small random change from which the search starts.

    Raises
    ------
    Unstable
        If no design that was tried has a stable equilibrium.
    ValueError
        If nothing may vary, bounds are not a range, or the objective does not depend on anything that varies.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Contrast, optimise
    >>> from magphonon.response import Dof
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=4.0)
    >>> left = Contrast(Dof(18, (1.0, 0, 0)), loud=[16], quiet=[20], omega=3.0, damping=0.1)
    >>> design = optimise(patch, left, {'strength': (0.9, 1.1)}, steps=20)
    >>> abs(round(left.value(patch), 6)), design.value > 5  # in dB: by symmetry both levels are equal at first
    (0.0, True)
    """
    targets = targets_of(objective)
    variables = Variables(Structure(atoms, rod_mass), over, parts)
    task = _Task(variables, targets, model, positive('tau', tau))
    rng, whole_steps = np.random.default_rng(whole('seed', seed, 0)), whole('steps', steps)
    x = np.clip(variables.present + FIRST * rng.normal(size=len(variables)), -1, 1)
    if errors is None and not variables.grades:
        x = _ascended(task, x, whole_steps)
    else:
        x = _drifted(task, x, errors, rng, whole_steps, whole('draws', draws) if errors else 1)
    chosen = variables.parts(x)
    rests = [variables.structure.rest(chosen, model=one) for one in (model, 'complete')]
    promised, given = (np.array([target.value(rest) for target in targets]) for rest in rests)
    return SiteDesign(variables.structure.at(rests[1], chosen), targets, variables, x, promised, given, task.buckled)


@dataclass(eq=False)
class _Task:
    """The soft minimum of all targets and its gradient by the parameters."""

    variables: Variables
    targets: tuple[Objective, ...]
    model: Model
    tau: float
    buckled: int = 0
    near: Rest | None = None

    def __call__(self, x, draw=None, near=None):
        v, draw = self.variables, draw or Parts()
        rest = v.structure.rest(v.parts(x) * draw, near, self.model)
        found = [target.tuned(draw.frequency).value_and_slope(rest) for target in self.targets]
        value, share = soft_minimum(np.array([value for value, _ in found]), self.tau)
        slope = sum((c * slope for c, (_, slope) in zip(share, found, strict=True)), Slope())
        return value, v.gradient(x, site_slopes(rest, slope), rest.masses)

    def copies(self, x, errors, rng, draws, scale):
        """The gradient of the soft minimum over copies with errors; copies that buckle are left out."""
        v = self.variables
        self.near, found = v.structure.rest(v.parts(x), self.near, self.model), []
        for _ in range(draws):
            try:
                found.append(self(x, errors.draw(rng, *v.structure.shape, scale), self.near))
            except Unstable:
                self.buckled += 1
        if not found:
            raise Unstable('every copy buckles')
        values, slopes = map(np.array, zip(*found, strict=True))
        return soft_minimum(values, self.tau)[1] @ slopes

    def holds(self, x):
        """Whether all waves of a periodic cell are stable; True for a finite structure, whose stability follows from its rest."""
        structure = self.variables.structure
        if not structure.atoms.pbc.any():
            return True
        parts = self.variables.parts(x)
        system = LinearSystem.of(structure.at(structure.rest(parts), parts))
        return not softest_of(system, 'complete', foundation=common_spring(system)).needed


def _refuse_flat(slope):
    if not slope.any():
        raise ValueError('the objective does not depend on anything that varies: its parts cancel, or nothing that varies can '
                         'influence it; change the targets, or let something else vary')


def _drifted(task, x, errors, rng, steps, draws):
    """Adam's steps up the mean slope of copies that are drawn afresh, while parts are frozen; the parameters.

    Errors grow from LEAST to their full size.
    """
    v, frozen = task.variables, np.zeros(len(x), bool)
    errors, mean, square, n = errors or Errors(), 0 * x, 0 * x, 0
    for step in tqdm(range(steps), 'designs', delay=2, disable=None, leave=False):
        done = step / steps
        if v.grades:
            x = v.freeze(x, frozen, min(1.0, max(0.0, (done - FREEZE[0]) / (FREEZE[1] - FREEZE[0]))))
        try:
            slope = task.copies(x, errors, rng, draws, min(1.0, max(LEAST, done / GROW)))
        except Unstable:
            x = np.where(frozen, x, BACK * x)
            continue
        if not n:
            _refuse_flat(slope)
        slope[frozen] = 0.0
        mean, square = (MEMORY * mean + (1 - MEMORY) * slope, LONG_MEMORY * square + (1 - LONG_MEMORY) * slope**2)
        mean[frozen] = 0.0
        n, rate = n + 1, RATE * ((1 - done) ** FALL if done > FALLS else 1.0)
        up = mean / (1 - MEMORY**n) / np.maximum(np.sqrt(square / (1 - LONG_MEMORY**n)), np.finfo(float).tiny)
        x = np.clip(x + rate * up, -1, 1)
    if v.grades:
        x = v.freeze(x, frozen, 1.0)
    if not n or not task.holds(x):
        raise Unstable('no design with a stable equilibrium was found: begin with a structure that is stable, such as one with '
                       'stiffer springs; widen the bounds if they exclude it')
    return x


def _ascended(task, x, steps):
    """The best parameters that L-BFGS-B finds."""
    best, value, stable = x, -np.inf, 0

    def down(x):  # where the structure buckles, it is very large and flat
        nonlocal best, value, stable
        try:
            found, slope = task(x)
            if found > value and not task.holds(x):
                raise Unstable('waves of the cell grow')
        except Unstable:
            task.buckled += 1
            known = value if stable else 0.0
            return FAR * (1 + abs(known)) - known, np.zeros(len(x))
        if not stable:
            _refuse_flat(slope)
        if found > value:
            best, value = x.copy(), found
        stable += 1
        return -found, -slope

    for _ in range(RESTARTS):
        before, limits = task.buckled, {'maxiter': steps, 'maxfun': 2 * steps}
        minimize(down, best, jac=True, method='L-BFGS-B', bounds=[(-1, 1)] * len(x), options=limits)
        if task.buckled == before or not stable or stable > 2 * steps:
            break  # else a trial that buckled has stopped it
    if not stable:
        raise Unstable(f'of {task.buckled} designs that were tried within the bounds, none has a stable equilibrium: begin with '
                       'a structure that is stable, such as one with stiffer springs; widen the bounds if they exclude it')
    return best


@dataclass(frozen=True, eq=False)
class Verification:
    """Copies of a structure with the errors of a workshop.

    Attributes
    ----------
    values : ndarray, shape (copies, targets)
        NaN for a copy that buckles.
    alone, without : dict of str to ndarray, shape (copies, targets)
        The same with one of the errors only, and with all but that one.
    """

    values: NDArray[np.float64]
    alone: dict[str, NDArray[np.float64]]
    without: dict[str, NDArray[np.float64]]

    def reached(self, percent: float = 80.0) -> float:
        """Value that the worst target reaches in this percentage of the copies; -inf if so many do not hold."""
        return _reached(self.values, percent)

    def table(self, percent: float = 80.0) -> dict[str, tuple[float, float]]:
        """For each error what this percentage of the copies reaches with it alone, and without it; the dominant one first."""
        rows = {name: (_reached(self.alone[name], percent), _reached(self.without[name], percent)) for name in self.alone}
        return dict(sorted(rows.items(), key=lambda row: row[1][0]))


def _reached(values, percent):
    if not_negative('percent', percent) > 100:
        raise ValueError(f'percent must be a number from 0 to 100, not {percent}')
    below = int(len(values) * (1 - percent / 100) + 1e-9)  # copies that may be worse; 80 % of 5 are not 3.999
    return float(np.sort(np.where(np.isnan(values), -np.inf, values).min(1))[min(below, len(values) - 1)])


def verify(atoms: Atoms, objective: Objective | Sequence[Objective], errors: Errors, copies: int = 100,
           seed: int = 1) -> Verification:
    """Judge a structure on copies with errors, with all of them, each alone, and all but each.

    Copies keep the bonds of the structure. If its cutoff omits no pair that matters, neither do those that errors bring across
    it: 0.1 dB for the demultiplexer, with all pairs within 45 mm; 2 dB with those within 22.5 mm.

    Raises
    ------
    ValueError
        If errors bring particles without a bond as near as neighbours.

    Parameters
    ----------
    atoms : ase.Atoms
        Such as `SiteDesign.atoms`, or of a scene.  Its array 'rod_masses' makes rods cantilevers; a scene has none, and without
        it they are springs.
    objective : Objective or sequence of Objective
    errors : Errors
    copies : int
    seed : int
        Another one than that of the design.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Contrast, Errors, verify
    >>> from magphonon.response import Dof
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=4.0)
    >>> left = Contrast(Dof(17, (1.0, 0, 0)), loud=[16], quiet=[20], omega=3.0, damping=0.1)
    >>> errors = Errors(force_percent=2.0, each_foot_mm=0.01)
    >>> found = verify(patch, left, errors, copies=5)
    >>> found.values.shape, sorted(found.table())
    ((5, 1), ['each_foot_mm', 'force_percent'])
    """
    structure, targets = Structure(atoms), targets_of(objective)
    nearby = structure.rest()

    def of(errors):
        rng, values = np.random.default_rng(whole('seed', seed, 0)), np.full((whole('copies', copies), len(targets)), np.nan)
        for row in values:
            draw = errors.draw(rng, *structure.shape)
            try:
                rest = structure.rest(draw, nearby)
            except Unstable:
                continue
            structure.refuse_strangers(rest, draw)
            row[:] = [target.tuned(draw.frequency).value(rest) for target in targets]
        return values

    alone = {name: of(Errors(**{name: getattr(errors, name)})) for name in errors.names}
    return Verification(of(errors), alone, {name: of(replace(errors, **{name: 0.0})) for name in errors.names})


def write_build_list(path: str | PathLike[str], atoms: Atoms) -> None:
    """Write the build list of a structure as CSV in SI: position of the foot, mass, strength, stiffness and whether it is held.

    Strengths are relative to those of the calculator's law.  A scene reads the list as its particles.  ValueError if the list has
    no place for what the structure is: periodic, not planar, on springs that differ along x and y, or under loads.
    """
    calc: Any = atoms.calc
    if atoms.pbc.any() or calc.dim != 2 or np.ptp(np.atleast_2d(calc.foundation), axis=-1).any() or calc.load.any():
        raise ValueError('a build list is that of a finite planar structure with round rods and no loads: it has no place for a '
                         'cell, for heights, for springs that differ along x and y, and for loads')
    middle = (calc.anchors.min(axis=0) + calc.anchors.max(axis=0)) / 2
    x, y, _ = ((calc.anchors - middle) / units.m).round(12).T + 0.0  # no zeros of round-off
    held = ~LinearSystem.of(atoms).mobile
    springs = np.broadcast_to(calc.foundation, (len(x), calc.dim)) / (units.N / units.m)
    columns = {'x_m': x, 'y_m': y, 'mass_kg': atoms.get_masses() / units.kg, 'strength': calc.strengths,
               'stiffness_N_per_m': springs[:, 0], 'held': held}
    with whole_file(path) as file:
        out = csv.writer(file, lineterminator='\n')
        out.writerow(columns)
        out.writerows([f'{value:.9g}' for value in row] for row in zip(*columns.values(), strict=True))
