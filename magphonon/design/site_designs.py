"""A lattice for a wanted wave: every magnet, pillar, mass and foot is designed by exact gradients, which include the change of
the rest positions.

`optimise` makes an `Objective` as large as possible within bounds.  Rest positions are found by Newton's method, always from the
first positions, so that runs repeat to the last bit; a design whose rest positions are no minimum of the energy is never
returned.  One static solution turns the slopes of the objective into derivatives with respect to all parameters
(`magphonon.design.scatter`). SciPy's L-BFGS-B, or SLSQP if there are constraints, uses them to find the maximum.
"""

from __future__ import annotations

import csv
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import product
from os import PathLike
from typing import Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, sparse
from scipy.optimize import minimize
from tqdm import tqdm

from .. import units
from ..errors import Unstable, finite, indices, not_negative, number, one_of, shown, whole
from ..files import whole_file
from ..interactions.pair_laws import InversePower
from ..stability.buckling import common_spring, softest_of
from ..stiffness.bond import Model, interaction_along, model_stiffness
from ..stiffness.calculator import PairCalculator
from ..stiffness.defects import Scatter, site_normals
from ..stiffness.factors import factorised
from ..stiffness.matrices import hessian
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import LinearSystem
from ..traits import takes
from .objectives import Crossing, Objective, Rest, soft_minimum
from .scatter import FULL, SiteSlopes

SITES = {'strength': 'strength', 'spring': 'spring', 'spring_x': 'spring', 'spring_y': 'spring', 'mass': 'mass', 'foot': 'foot'}
"""What may vary from site to site: factors, and displacements of the foot in mm; each with the slope that it takes."""
LATTICE = 'spacing', 'exponent', 'height'  # factors of the whole lattice
NEWTONS, LONGEST, SETTLED = 40, 0.05, 1e-12  # most steps to rest; the longest one and the last one, in shortest bonds
IN_STEPS = 5  # steps in which far parameters are reached from the first ones
RESTARTS = 3  # of L-BFGS-B, after it met designs that buckle
FIRST = 0.05  # standard deviation of the parameters at a start, of half the width of their bounds
AT_BOUND = 1e-6  # of the width
SAME = 1e-6  # relative difference below which a factor equals that of a part
FAR = 10.0  # a design that buckles counts as worse than the best one by this much
TOLERATED = 1e-6  # amount by which a constraint may be violated
REGULAR = 1e-12  # stiffness added to every direction, as a fraction of the largest, because free translations have none
ROUNDS = 0.3, 0.5, 0.7, 0.85, 0.95, 1.0  # shares of the parameters that are parts, in turn


@dataclass(frozen=True)
class Robust:
    """Scatter that a design must tolerate: its value is a soft minimum over lattices with scatter, which are drawn once.

    Attributes
    ----------
    scatter : magphonon.stiffness.Scatter
        Relative scatter of strengths, springs and masses, and scatter of positions in mm, at all sites including held ones.
    frequency : float
        Relative standard deviation of the frequencies of all sources.
    draws : int
    width : float
        Width of the soft minimum in the unit of the objective: near zero only the worst draw counts, at infinity it is the mean.
    seed : int
    """

    scatter: Scatter
    draws: int = 24
    width: float = 1.0
    frequency: float = 0.0
    seed: int = 0

    def __post_init__(self) -> None:
        whole('draws', self.draws)
        not_negative('frequency', self.frequency)

    def drawn(self, particles: int) -> list[Draw]:
        """The lattices drawn with this scatter, as `Draw` objects."""
        found = []
        for seed in range(self.seed, self.seed + self.draws):
            *xyz, strength, mass, stiffness = site_normals(seed, particles + 1).T  # the last site stands for the sources
            s = self.scatter
            found.append(Draw(1 + s.strength * strength[:-1], 1 + s.stiffness * stiffness[:-1], 1 + s.mass * mass[:-1],
                              s.position * np.transpose(xyz)[:-1], 1 + self.frequency * mass[-1]))
        return found


@dataclass(frozen=True)
class Draw:
    """One random draw: factors of strengths, springs and masses, displacements of feet in mm, and a factor of frequencies."""

    strength: Any = 1.0
    spring: Any = 1.0
    mass: Any = 1.0
    foot: Any = 0.0
    frequency: float = 1.0


class Variables:
    """The variable parameters of a lattice as one vector of numbers between -1 and 1, and the rest positions for each vector.

    A factor within (low, high) is `exp(middle + x half)`, with the middle and half the width of the range of logarithms. Feet and
    their bounds are in mm at the given spacing; if the spacing varies, they scale with it.
    """

    @takes('constraints', 'oblique')
    def __init__(self, atoms: Atoms, over: Mapping[str, tuple[float, float]], sites: ArrayLike | None = None,
                 groups: ArrayLike | None = None) -> None:
        self.atoms, self.calc = atoms, repulsion_of(atoms).about(atoms, model='complete')
        self.system = LinearSystem.about(self.calc, atoms).moving()
        self.springs = np.broadcast_to(self.calc.foundation, (len(atoms), self.calc.dim))
        self.sites = np.flatnonzero(self.system.mobile) if sites is None else np.unique(indices('sites', sites, len(atoms)))
        if not over or not (len(self.sites) or set(over) & set(LATTICE)):
            raise ValueError('nothing can vary: name a parameter in over=, and at least one free site')
        self.groups, group = groups, self.sites if groups is None else finite('groups', groups, (len(atoms),))[self.sites]
        self._group = np.unique(group, return_inverse=True)[1]
        self.over, self._parts, low, high = dict(over), {}, [], []
        count = int(self._group.max(initial=-1)) + 1
        for name, bounds in over.items():
            one_of('parameter of a design', name, (*SITES, *LATTICE))
            least, most = self._bounds(name, bounds)
            size = 1 if name in LATTICE else count * (self.calc.dim if name == 'foot' else 1)
            self._parts[name] = slice(len(low), len(low) + size)
            low, high = low + size * [least], high + size * [most]
        self.low, self.high = np.array(low), np.array(high)
        self.middle, self.half = (self.high + self.low) / 2, (self.high - self.low) / 2
        self.kept = float(self.calc.bonds.lengths.min())

    def _bounds(self, name, bounds):
        low, high = finite(f'bounds of {name}', bounds, (2,))
        if not low < high or (name != 'foot' and not low > 0):
            what = 'numbers in mm' if name == 'foot' else 'positive factors'
            raise ValueError(f'the bounds of {name} must be two increasing {what}, not {low:g} and {high:g}; leave '
                             f'{name} out if it is not to vary')
        if name in ('spring', 'spring_x', 'spring_y', 'height') and not self.springs[self.sites].any():
            raise ValueError(f'{name} varies the springs of a foundation, and there is none; give a foundation, or omit {name}')
        if name == 'exponent' and not isinstance(self.calc.laws, InversePower):
            raise ValueError(f"'exponent' needs one inverse-power law for all particles, not {self.calc.laws!r}; omit 'exponent'")
        return (low, high) if name == 'foot' else (np.log(low), np.log(high))

    def __len__(self) -> int:
        return len(self.low)

    @property
    def present(self) -> NDArray[np.float64]:
        """The parameters x of the given structure, or the nearest ones within the bounds."""
        return np.clip(-self.middle / self.half, -1, 1)

    def slice_of(self, name: str) -> slice:
        """Slice of the vector x that holds the parameters of one kind."""
        return self._parts[name]

    def values(self, x: NDArray[np.float64]) -> dict[str, Any]:
        """Factors of each site, shape (particles,), displacements of feet in mm, (particles, dim), and factors of the lattice."""
        p, n, found = self.middle + self.half * x, len(self.atoms), {}
        for name, part in self._parts.items():
            if name in LATTICE:
                found[name] = float(np.exp(p[part][0]))
            elif name == 'foot':
                found[name] = np.zeros((n, self.calc.dim))
                found[name][self.sites] = p[part].reshape(-1, self.calc.dim)[self._group]
            else:
                found[name] = np.ones(n)
                found[name][self.sites] = np.exp(p[part])[self._group]
        return found

    def gradient(self, x: NDArray[np.float64], slopes: Mapping[str, Any]) -> NDArray[np.float64]:
        """Derivatives with respect to the parameters x, from those with respect to sites and lattice (`SiteSlopes.of`)."""
        found, size = np.empty(len(self)), self.values(x).get('spacing', 1.0)
        for name, part in self._parts.items():
            if name in LATTICE:
                found[part] = slopes[name]
                continue
            own = slopes[SITES[name]][self.sites]
            if SITES[name] == 'spring':
                own = own.sum(1) if name == 'spring' else own[:, 'xy'.index(name[-1])]
            columns = (size if name == 'foot' else 1.0) * own.reshape(len(own), -1).T
            found[part] = np.stack([np.bincount(self._group, column) for column in columns], axis=1).ravel()
        return self.half * found

    def still(self, x: NDArray[np.float64]) -> NDArray[np.float64]:
        """Displacements to the rest positions without scatter, which are close to those of each draw; shape (particles, dim)."""
        return self._rest(x, 'complete', Draw(), None)[1]

    def rest(self, x: NDArray[np.float64], model: Model = 'complete', draw: Draw | None = None,
             near: NDArray[np.float64] | None = None) -> Rest:
        """The structure at rest; raises Unstable if there is no stable equilibrium near the first positions or the given
        displacements.
        """
        draw = draw or Draw()
        try:
            return self._rest(x, model, draw, near)[0]
        except Unstable:
            u = None
            for share in np.linspace(0, 1, IN_STEPS + 1)[1:]:
                found, u = self._rest(self.present + share * (x - self.present), model, draw, u)
            return found  # pyright: ignore[reportPossiblyUnbound]  there are steps

    def _rest(self, x, model, draw, u):
        v, calc, P, n, dim = self.values(x), self.calc, self.system.free, len(self.atoms), self.calc.dim
        size, a = v.get('spacing', 1.0), v.get('exponent', 1.0)
        laws = calc.laws
        if a != 1:
            laws = InversePower(laws.b * self.kept ** ((a - 1) * laws.a), a * laws.a)
        foot = size * (np.broadcast_to(draw.foot, (n, 3))[:, :dim] + v.get('foot', 0.0))
        k = self.springs * (draw.spring * v.get('spring', 1.0) * v.get('height', 1.0) ** -3 * np.ones(n))[:, None]
        for axis, name in enumerate(('spring_x', 'spring_y')):
            k[:, axis] = k[:, axis] * v.get(name, 1.0)
        strengths = calc.strengths * draw.strength * v.get('strength', 1.0)
        acts, C = interaction_along(laws, calc.bonds, calc.reference.get_tags(), strengths, dim), calc.bonds.incidence
        R0, slack, load = size * calc.bond_vectors, size * calc.slack[:, :dim], calc.load[:, :dim]
        u, shortest = foot.copy() if u is None else u, size * self.kept
        for _ in range(NEWTONS):
            R = R0 + C @ u
            pull = P.T @ (C.T @ acts.forces(R)[1] + k * (slack + u - foot) - load).ravel()
            solve, stable = _solved(P.T @ hessian(calc.bonds, model_stiffness(R, acts), k) @ P)
            step = (P @ solve(pull)).reshape(n, dim) / shortest
            u = u - shortest * step * min(1, LONGEST / max(abs(step).max(), SETTLED))
            if not abs(step).max() > SETTLED:
                break
        else:
            raise Unstable('no equilibrium is found near the first positions: the structure buckles or slides')
        if not np.isfinite(u).all() or not stable or not self._waves_hold(acts, R, k):
            raise Unstable('the equilibrium is a saddle: the structure buckles')
        atoms = calc.reference.copy()
        atoms.set_cell(size * atoms.cell.array if size != 1 else atoms.cell, scale_atoms=False)
        anchors = np.array(calc.anchors)
        for place, moved in ((anchors, foot), (atoms.positions, u)):
            place *= size
            place[:, :dim] += moved
        atoms.set_masses(atoms.get_masses() * draw.mass * v.get('mass', 1.0))
        atoms.set_constraint(self.atoms.constraints)
        bonds = replace(calc.bonds, vectors=size * calc.bonds.vectors, cutoff=None)
        bonds.vectors[:, :dim] = R0 + C @ u
        own = PairCalculator(atoms, laws, bonds=bonds, anchors=anchors, foundation=k, strengths=strengths, load=calc.load,
                                model=model)
        return Rest(LinearSystem.about(own, atoms)), u

    def _waves_hold(self, acts, R, k):
        """Whether the waves of a periodic cell with q = 0 or 1/2 along each vector are stable."""
        pbc, P = self.atoms.pbc, self.system.free
        edges = [*product(*((0.0, 0.5) if along else (0.0,) for along in pbc))][1:]
        K = model_stiffness(R, acts)
        return all(_solved(P.T @ hessian(self.calc.bonds, K, k, q) @ P)[1] for q in edges)


def _solved(H):
    """A solver for a real matrix, and whether the matrix is positive definite, by Cholesky or the signs of pivots."""
    H = sparse.csr_array(H + REGULAR * (abs(H).max() or 1.0) * sparse.eye_array(H.shape[0]))
    if H.nnz > FULL * H.shape[0] ** 2:
        H = H.toarray()
        try:
            factors = linalg.cho_factor(H, check_finite=False)
            return lambda b: linalg.cho_solve(factors, b, check_finite=False), True
        except linalg.LinAlgError:
            return lambda b: linalg.solve(H, b, assume_a='sym'), False
    factors = factorised(H, definite=True)
    return factors.solve, factors.negative() == 0


@dataclass(frozen=True, eq=False)
class SiteDesign:
    """A structure designed for an objective.

    Attributes
    ----------
    atoms : ase.Atoms
        The structure at rest, with its calculator.
    objective : Objective
    variables : Variables
        The parameters that varied, and their bounds.
    x : ndarray, shape (parameters,)
        The parameters, -1 and 1 at their bounds.
    model : {'complete', 'conventional'}
        The model of the waves for which it was designed.
    value, before : float
        Value of the objective without scatter, for this structure and for the given one.
    robust : float
        The soft minimum over the draws; without draws, the value itself.
    history : tuple of float
        The best value so far at each evaluation, for the best start.
    starts, given_by_starts : tuple of float
        Promised value of each start, without scatter, and its value in the complete model. They show how much local optima
        differ.
    slopes : dict
        Derivatives of the value with respect to strength, spring, mass and foot of each site (`SiteSlopes.of`).
    buckled : int
        Number of evaluations that found no stable equilibrium.
    conventional : SiteDesign or None
        The design for the same objective made with D0 alone.
    given : float
        The true value, computed in the complete model whatever the model of the design.
    """

    atoms: Atoms
    objective: Objective
    variables: Variables
    x: NDArray[np.float64]
    model: Model
    value: float
    before: float
    robust: float
    history: tuple[float, ...]
    starts: tuple[float, ...]
    given_by_starts: tuple[float, ...]
    slopes: dict[str, Any]
    buckled: int
    given: float
    conventional: SiteDesign | None = None

    @property
    def values(self) -> dict[str, Any]:
        """Factors of strengths, springs, masses and the lattice, and displacements of feet in mm, for the parameters that
        varied.
        """
        return self.variables.values(self.x)

    @property
    def at_bounds(self) -> int:
        """Number of parameters at a bound."""
        return int((1 - abs(self.x) < AT_BOUND).sum())

    def drawn(self, robust: Robust, seed: int) -> NDArray[np.float64]:
        """Values of lattices with scatter, drawn with another seed than that of the design; NaN for a lattice that buckles."""
        found = []
        for draw in replace(robust, seed=seed).drawn(len(self.atoms)):
            try:
                found.append(self.objective.tuned(draw.frequency).value(self.variables.rest(self.x, draw=draw)))
            except Unstable:
                found.append(np.nan)
        return np.array(found)

    def tolerances(self, robust: Robust, drop: float = 1.0) -> dict[str, NDArray[np.float64]]:
        """Deviation of each site alone at which the value falls by `drop`, shape (particles,): relative, or in mm for feet.

        The deviations are computed to first order about lattices with scatter, as a root mean square over their draws. At the
        optimum itself the slopes vanish, but no real lattice is exactly at the optimum.
        """
        squares: dict[str, Any] = {}
        draws = robust.drawn(len(self.atoms))
        for draw in draws:
            rest = self.variables.rest(self.x, draw=draw)
            slopes = SiteSlopes(rest.system).of(self.objective.tuned(draw.frequency).value_and_slope(rest)[1])
            for name in ('strength', 'spring', 'mass', 'foot'):
                own = slopes[name].sum(1) if name == 'spring' else slopes[name]
                squares[name] = squares.get(name, 0.0) + own**2 / len(draws)
        squares['foot'] = squares['foot'].sum(1)
        with np.errstate(divide='ignore'):
            return {name: drop / np.sqrt(square) for name, square in squares.items()}

    @property
    def words(self) -> list[str]:
        """What limits the design, in words."""
        found = []
        if self.at_bounds:
            found.append(f'{self.at_bounds} of {len(self.x)} parameters lie at a bound; wider bounds may give a better design.')
        if len(self.starts) > 1:
            found.append(f'{len(self.starts)} starts reached {min(self.starts):.4g} to {max(self.starts):.4g}: these are local '
                         'optima, and another start may give a better design.')
        if self.buckled:
            found.append(f'{self.buckled} trial designs buckled and were discarded.')
        if self.conventional is not None:
            found.append(f'A design with D0 alone would promise {self.conventional.value:.4g} and in fact give '
                         f'{self.conventional.given:.4g}.')
        return found + self.objective.doubts(Rest(LinearSystem.of(self.atoms)))


def optimise(atoms: Atoms, objective: Objective, over: Mapping[str, tuple[float, float]], *, model: Model = 'complete',
             sites: ArrayLike | None = None, groups: ArrayLike | None = None, robust: Robust | None = None, steps: int = 100,
             starts: int = 1, seed: int = 0, start: ArrayLike | None = None, constraints: Sequence[tuple[Objective, float]] = (),
             compare: bool = False, report: Callable[[NDArray[np.float64], float], Any] | None = None) -> SiteDesign:
    """Maximise an objective of a structure.

    Parameters
    ----------
    atoms : ase.Atoms
        With its PairCalculator; it need not be at rest.
    objective : Objective
    over : dict
        What may vary, and its bounds: factors of the `strength`, `spring` (or `spring_x`, `spring_y`) and `mass` of each site,
        displacements of each `foot` in mm along each axis, and factors of the whole lattice: `spacing`, `exponent` (at
        constant force in the shortest bond), `height` of all pillars.
    model : {'complete', 'conventional'}
        Model of the waves; statics always follow the complete model.
    sites : array_like of int, optional
        The sites that vary; by default all free sites.
    groups : array_like of int, shape (particles,), optional
        Sites with the same number have the same parameters; see `orbits` for groups of sites that are equivalent by symmetry.
    robust : Robust, optional
        Scatter that the design must tolerate.
    steps, starts : int
        Number of iterations of each start, and number of starts. Each starts from the given structure with a small random change.
    seed : int
        Seed of the random changes of the starts.
    start : array_like, shape (parameters,), optional
        Parameters of the first start, such as `SiteDesign.x`.
    constraints : sequence of (Objective, float)
        Objectives whose value must not fall below a number, such as a `Margin` of stability.
    compare : bool
        Whether to make a design with D0 alone too, `SiteDesign.conventional`.
    report : function, optional
        Called at each better design with its parameters and value, for example to save them.

    Raises
    ------
    Unstable
        If no design that was tried has a stable equilibrium.
    ValueError
        If nothing may vary, bounds are not a range, or the objective does not depend on anything that varies.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Level, optimise
    >>> from magphonon.response import Dof
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=4.0)
    >>> source, left, right = (Dof(k, np.array([1.0, 0, 0])) for k in (18, 16, 20))
    >>> contrast = Level(source, left, 3.0, 0.1) - Level(source, right, 3.0, 0.1)
    >>> design = optimise(patch, contrast, {'strength': (0.9, 1.1)}, steps=20)
    >>> abs(round(design.before, 6)), design.value > 20  # in dB: by symmetry both levels are equal at first
    (0.0, True)
    """
    variables = Variables(atoms, over, sites, groups)
    task = _Task(variables, objective, model, [Draw()] if robust is None else robust.drawn(len(atoms)),
                 np.inf if robust is None else robust.width)
    rng, found = np.random.default_rng(seed), []
    whole('steps', steps)
    constraints = [(one, number('the least value of a constraint', least)) for one, least in constraints]
    first = None if start is None else finite('start', start, (len(variables),))
    for k in range(whole('starts', starts)):
        x = variables.present + FIRST * rng.normal(size=len(variables)) if first is None or k else first
        found.append(_Ascent(task, np.clip(x, -1, 1), np.zeros(len(variables), bool), constraints, report).run(steps))
    x, value, history = max(found, key=lambda one: one[1])
    design = _design(task, x, value, history, [one[0] for one in found])
    if not compare or model == 'conventional':
        return design
    alone = optimise(atoms, objective, over, model='conventional', sites=sites, groups=groups, robust=robust, steps=steps,
                     starts=starts, seed=seed, start=start, constraints=constraints)
    return replace(design, conventional=alone)


@dataclass(eq=False)
class _Task:
    """Computes the value of an objective and its gradient by the parameters, in one model, over all draws."""

    variables: Variables
    objective: Objective
    model: Model
    draws: list[Draw]
    width: float
    buckled: int = 0

    def __call__(self, x):
        values, slopes = [], []
        near = self.variables.still(x) if len(self.draws) > 1 else None
        for draw in self.draws:
            value, slope = self.one(self.objective.tuned(draw.frequency), x, draw, near)
            values.append(value)
            slopes.append(slope)
        value, share = soft_minimum(np.array(values), self.width)
        return value, share @ np.array(slopes)

    def holds(self, x):
        """Whether all waves of a periodic cell are stable; True for a finite structure, whose stability follows from its rest."""
        if not self.variables.atoms.pbc.any():
            return True
        system = self.variables.rest(x).system
        return not softest_of(system, 'complete', foundation=common_spring(system)).needed

    def one(self, objective, x, draw=None, near=None):
        v = self.variables
        rest = v.rest(x, self.model, draw, near)
        value, slope = objective.value_and_slope(rest)
        return value, v.gradient(x, SiteSlopes(rest.system).of(slope, v.kept if 'exponent' in v.over else None))


class _Ascent:
    """An ascent from given parameters, of which those that are `fixed` stay, with the best design so far."""

    def __init__(self, task, x, fixed, constraints=(), report=None):
        self.task, self.x, self.free, self.constraints, self.report = task, x, ~fixed, constraints, report
        self.best, self.value, self.history, self._at = x, -np.inf, [], None
        self.progress = tqdm(desc='designs', delay=2, disable=None, leave=False)

    def run(self, steps):
        """The best parameters found, their value, and the best value at each evaluation."""
        y, bounds = self.x[self.free], [(-1, 1)] * int(self.free.sum())
        for _ in range(RESTARTS if len(y) else 0):
            before = self.task.buckled
            if self.constraints:
                minimize(self.down, y, jac=True, method='SLSQP', bounds=bounds, options={'maxiter': steps, 'ftol': 1e-9},
                         constraints={'type': 'ineq', 'fun': lambda y: self.kept(y)[0], 'jac': lambda y: self.kept(y)[1]})
            else:
                minimize(self.down, y, jac=True, method='L-BFGS-B', bounds=bounds,
                         options={'maxiter': steps, 'maxfun': 2 * steps})
            if self.task.buckled == before or not np.isfinite(self.value) or len(self.history) > 2 * steps:
                break
            y = self.best[self.free]  # a trial that buckled has stopped it
        self.progress.close()
        if not len(y):
            self.down(y)
        if not np.isfinite(self.value):
            also = ' and keeps the constraints' if self.constraints else ''
            raise Unstable(f'of {len(self.history) + self.task.buckled} designs that were tried within the bounds, none has a '
                           f'stable equilibrium{also}: the bounds exclude stable structures; widen them, or give stiffer springs')
        return self.best, self.value, tuple(self.history)

    def whole(self, y):
        x = self.x.copy()
        x[self.free] = y
        return x

    def down(self, y):
        """The function that is minimised, and its slope; where the structure buckles, it is very large and flat."""
        x = self.whole(y)
        self.progress.update()
        try:
            value, slope = self.task(x)
            kept = not self.constraints or self.kept(y)[0].min() >= -TOLERATED
        except (Unstable, Crossing):
            return self.buckling(y)
        if not self.history and len(y) and not slope[self.free].any():
            raise ValueError('the objective does not depend on anything that varies: its parts cancel, or nothing that varies '
                             'can influence it; change the targets, or let something else vary')
        if value > self.value and kept:
            if not self.task.holds(x):
                return self.buckling(y)
            self.best, self.value = x, value
            self.progress.set_postfix(value=f'{value:.4g}')
            if self.report is not None:
                self.report(x, value)
        self.history.append(self.value)
        return -value, -slope[self.free]

    def buckling(self, y):
        """The value assigned to a design without a stable rest."""
        self.task.buckled += 1
        known = self.value if np.isfinite(self.value) else 0.0
        return FAR * (1 + abs(known)) - known, np.zeros(len(y))

    def kept(self, y):
        """Margins by which the constraints are satisfied, and their slopes."""
        if self._at is None or not np.array_equal(self._at[0], y):
            found = [self.task.one(one, self.whole(y)) for one, _ in self.constraints]
            above = np.array([value - least for (value, _), (_, least) in zip(found, self.constraints, strict=True)])
            self._at = y.copy(), above, np.array([slope[self.free] for _, slope in found])
        return self._at[1], self._at[2]


def _design(task, x, robust, history, all_starts):
    """The `SiteDesign` for the parameters that were found."""
    v, rest = task.variables, task.variables.rest(x, task.model)
    value, slope = task.objective.value_and_slope(rest)

    def of(x, model):
        try:
            return task.objective.value(v.rest(x, model))
        except Crossing:  # as by symmetry, of the structure as it was given
            return np.nan

    return SiteDesign(v.rest(x).system.atoms, task.objective, v, x, task.model, float(value), of(v.present, task.model),
                      float(robust), history, tuple(of(x, task.model) for x in all_starts),
                      tuple(of(x, 'complete') for x in all_starts), SiteSlopes(rest.system).of(slope), task.buckled,
                      of(x, 'complete'))


def of_parts(design: SiteDesign, parts: Mapping[str, ArrayLike], robust: Robust | None = None, steps: int = 20,
             exchanges: int = 60) -> SiteDesign:
    """Convert a design to parts that can be bought. Parameters closest to an available part are rounded to it, the others are
    optimised again, and this is repeated.

    At the end single parts are exchanged, as suggested by the gradient, as long as the value grows.

    Parameters
    ----------
    design : SiteDesign
    parts : dict
        Available factors of each parameter, such as `{'strength': [0.9, 1.0, 1.1]}`.
    robust : Robust, optional
    steps : int
        Iterations between two rounds.
    exchanges : int
        Largest number of exchanges to try.
    """
    v = design.variables
    allowed = [None] * len(v)
    for name, factors in parts.items():
        if name not in v.over or name == 'foot':
            raise ValueError(f'parts may be given for parameters that varied, {", ".join(v.over)}, not for {name!r}')
        part = v.slice_of(name)
        given = np.atleast_1d(finite(f'parts of {name}', factors))
        if not (given > 0).all():
            raise ValueError(f'the parts of {name} must be positive factors, not {shown(factors)}')
        one = np.sort((np.log(given) - v.middle[part][0]) / v.half[part][0])
        one = one[abs(one) <= 1 + AT_BOUND]
        if not len(one):
            raise ValueError(f'none of the parts {given.tolist()} of {name} lies within its bounds {v.over[name]}')
        allowed[part] = [one] * (part.stop - part.start)
    task = _Task(v, design.objective, design.model, [Draw()] if robust is None else robust.drawn(len(design.atoms)),
                 np.inf if robust is None else robust.width)
    of = np.array([one is not None for one in allowed])
    x, fixed, history = design.x.copy(), np.zeros(len(v), bool), ()
    for share in ROUNDS:
        near = np.array([value if one is None else one[abs(one - value).argmin()] for one, value in zip(allowed, x, strict=True)])
        far = np.where(fixed, -1.0, np.where(of, abs(near - x), np.inf))
        chosen = np.argsort(far, kind='stable')[: round(share * of.sum())]
        x[chosen], fixed[chosen] = near[chosen], True
        x, _, more = _Ascent(task, x, fixed).run(steps)
        history += more
    x, value = _exchanged(task, x, allowed, exchanges)
    return replace(_design(task, x, value, history, [x]), conventional=design.conventional)


def _exchanged(task, x, allowed, most):
    """Exchange parts one by one for neighbouring ones, in order of the gain that the slope predicts, while the value grows."""
    value, slope = task(x)
    tried = set()
    for _ in range(most):
        gains = []
        for k, one in enumerate(allowed):
            if one is not None:
                at = int(abs(one - x[k]).argmin())
                gains += [(slope[k] * (one[b] - x[k]), k, b) for b in (at - 1, at + 1)
                          if 0 <= b < len(one) and (k, b) not in tried]
        gain, k, b = max(gains, default=(0.0, 0, 0))
        if gain <= 0:
            break
        trial = x.copy()
        trial[k] = allowed[k][b]
        try:
            found = task(trial)
        except (Unstable, Crossing):
            found = (-np.inf, slope)
        if found[0] > value and task.holds(trial):
            x, (value, slope), tried = trial, found, set()
        else:
            tried.add((k, b))
    return x, value


def orbits(atoms: Atoms, operations: Sequence[ArrayLike]) -> NDArray[np.int_]:
    """Groups of sites that are equivalent by symmetry, shape (particles,), for `optimise(groups=...)`.

    Parameters
    ----------
    atoms : ase.Atoms
        A finite structure.
    operations : sequence of array_like, shape (2, 2) or (3, 3)
        Rotations and reflections about the middle of the structure.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.design import orbits
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 1.0)
    >>> len(set(orbits(patch, [[[1, 0], [0, -1]]])))  # seven sites, mirrored across x
    5
    """
    X, rows, columns = atoms.positions - atoms.positions.mean(axis=0), [], []
    for operation in operations:
        A = np.eye(3)
        given = finite('operation', operation)
        A[: len(given), : len(given)] = finite('operation', given, (3, 3) if len(given) == 3 else (2, 2))
        distance = np.linalg.norm((X @ A.T)[:, None] - X, axis=2)
        if (distance.min(axis=1) > 1e-6 * np.ptp(X)).any():
            raise ValueError(f'{given.tolist()} does not map the particles onto each other about their centre')
        rows += list(range(len(X)))
        columns += distance.argmin(axis=1).tolist()
    return sparse.csgraph.connected_components(sparse.coo_array((np.ones(len(rows)), (rows, columns)), (len(X), len(X))))[1]


def write_build_list(path: str | PathLike[str], design: SiteDesign, tolerances: Mapping[str, NDArray[np.float64]] | None = None,
                     parts: Mapping[str, ArrayLike] | None = None) -> None:
    """Write the build list as CSV in SI: for each site the position of the foot, strength, stiffness, whether it is held, its
    part and tolerance.

    Strengths are relative to those of the calculator's law, stiffnesses are along x.  Parts are numbered from 1 in the order of
    `parts`, as given to `of_parts`; 0 is none of them.  Tolerances are those of `SiteDesign.tolerances`, as fractions.
    """
    calc: Any = design.atoms.calc
    x, y, _ = ((calc.anchors - design.variables.calc.anchors.mean(axis=0)) / units.m).round(12).T + 0.0  # no zeros of round-off
    held, springs = ~design.variables.system.mobile, np.broadcast_to(calc.foundation, (len(x), calc.dim)) / (units.N / units.m)
    columns = {'x_m': x, 'y_m': y, 'strength': calc.strengths, 'stiffness_N_per_m': springs[:, 0], 'held': held}
    for name, factors in (parts or {}).items():
        same = abs(design.values[name][:, None] / np.asarray(factors, float) - 1) < SAME
        columns[f'part_{name}'] = np.where(same.any(1), 1 + same.argmax(1), 0)
    if tolerances is not None:
        columns |= {f'tolerance_{name}': tolerances[name] for name in ('strength', 'spring')}
    with whole_file(path) as file:
        out = csv.writer(file, lineterminator='\n')
        out.writerow(columns)
        out.writerows([f'{value:.9g}' for value in row] for row in zip(*columns.values(), strict=True))
