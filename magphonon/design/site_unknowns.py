"""Transfer functions of a patch whose sites differ: a strength, springs and an anchor of its own for each site, in one fit.

A lattice of equal sites cannot fit such data, because the sites shift peaks by more than their width. So every site has unknowns
z with a normal prior, whose standard deviation is the scatter. They are fitted together with the parameters x of the lattice:

    |h - h(x, z)|^2/noise^2 + |z|^2 + prior of x        dh/dz = -x.(dK/dz) y by bonds, as in `transfer_fits`

The sites are eliminated. With the residuals r, their derivatives J by the parameters and A by the sites, and C = 1 + A A^T,

    information of x = J^T C^-1 J        z = A^T C^-1 (r - J dx)

This describes the lattice of which the patch is one sample. The mean of the sites of this patch, x + M z, is known better: if it
replaces x, J stays and A becomes A - J M. The scatter is found by maximising the evidence, with z and x integrated out.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import linalg, sparse
from scipy.optimize import minimize

from ..response.transfer_functions import TransferFunction
from ..stiffness.rest import LinearSystem
from .least_squares import BLIND, FITS, MOST_FACTOR, Before
from .scatter import Rest
from .sensitivities import force_change
from .site_designs import Structure
from .transfer_fits import (
    MOST_SCATTER,
    ParametricLattice,
    Solved,
    TransferFit,
    measured_responses,
    response_slopes,
    solved,
    split,
    stated,
    weights,
)

FIRST = np.array([0.02, 0.04, 0.012])
"""Prior scatter of strengths and springs, relative, and of anchors, in shortest bonds. Springs scatter most, because the
stiffness of a pillar depends on the fourth power of its radius and the third of its height."""
FAINT = 0.01  # stiffness of a bond, relative to the stiffest, below which a held particle at its end has no unknowns
SURE = 0.7  # standard deviation of the logarithm of each of these scatters
START, LOWER = 1.5, 2.5
"""At first the noise is assumed so large that residuals are START times as large, so that peaks overlap; then it falls by
LOWER."""
FEW, MOST = 4, 40  # steps of a stage, and of the last one
ROUGH, FINE = 1e-3, 1e-4  # share of the sum of squares below which a gain ends a stage, and the last one
SETTLED, ROUNDS = 0.05, 8  # relative change of the scatter that ends its search, and most rounds
DAMPED, LESS, MORE, STUCK = 1e-3, 0.1, 8.0, 1e5
"""Damping of Levenberg and Marquardt: at first, its change after a success and after a failure, and where no step leads down."""
BOUND = np.log(MOST_FACTOR)


@dataclass(frozen=True)
class Sites:
    """The unknowns of the sites of a structure, in standard deviations of their scatter.

    They are the strengths of all `acting` particles, then the springs of the movable ones, then the anchors of all `acting` ones.
    The rest positions follow from them. Because neighbours hold particles back, displacements of long wavelength are larger than
    those of short wavelength.

    Attributes
    ----------
    acting : ndarray of bool, shape (particles,)
        Which particles have unknowns: those that can move, and those joined to one by a bond stiffer than FAINT of the stiffest.
    tied : ndarray of bool, shape (particles, dim)
        Which springs have an unknown.
    spacing : float
        Shortest bond in mm.
    """

    acting: np.ndarray
    tied: np.ndarray
    spacing: float

    @classmethod
    def of(cls, system: LinearSystem) -> Sites:
        calc = system.calc
        tied = (np.broadcast_to(calc.foundation, (len(system), system.dim)) > 0) & system.mobile[:, None]
        acting, stiff = system.mobile.copy(), calc.bond_sizes[1]
        for one, other in ((calc.bonds.i, calc.bonds.j), (calc.bonds.j, calc.bonds.i)):
            acting[one[system.mobile[other] & (stiff > FAINT * stiff.max())]] = True
        return cls(acting, tied, calc.bonds.shortest)

    @property
    def ends(self) -> list[int]:
        """Indices of the unknowns at which the springs and the anchors begin, and the total number."""
        n, dim = self.acting.sum(), self.tied.shape[1]
        return np.cumsum([n, self.tied.sum(), n * dim]).tolist()

    @property
    def kinds(self) -> NDArray[np.intp]:
        """Kind of each unknown: 0 for a strength, 1 for a spring, 2 for an anchor."""
        return np.repeat([0, 1, 2], np.diff([0, *self.ends]))

    @property
    def split(self) -> NDArray[np.float64]:
        """Direction of the unknowns in which all springs grow along x and shrink along y, each by half of ln(kx/ky)."""
        found = np.zeros(self.ends[2])
        found[self.ends[0] : self.ends[1]] = 0.5 - np.nonzero(self.tied)[1]
        return found if self.tied.any(axis=0).sum() == 2 else 0 * found

    def size(self, scatter: NDArray[np.float64]) -> NDArray[np.float64]:
        """Standard deviation of each unknown: relative for strengths and springs, in mm for anchors."""
        return (scatter * [1.0, 1.0, self.spacing])[self.kinds]

    def parts(self, z: NDArray[np.float64], scatter: NDArray[np.float64]) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Logarithms of strengths, shape (particles,), and of springs, and shifts of anchors in mm, shape (particles, dim)."""
        strengths, springs, anchors = np.split(self.size(scatter) * z, self.ends[:2])
        of_particles, each, moved = np.zeros(len(self.tied)), np.zeros(self.tied.shape), np.zeros(self.tied.shape)
        of_particles[self.acting], each[self.tied] = strengths, springs
        moved[self.acting] = anchors.reshape(-1, self.tied.shape[1])
        return of_particles, each, moved

    def means(self, built: ParametricLattice, names: Sequence[str], scatter: NDArray[np.float64]) -> NDArray[np.float64]:
        """Matrix M, shape (names, unknowns): M z is the mean over the sites of this patch of the logarithm of each parameter."""
        M, moving = np.zeros((len(names), self.ends[2])), built.system.mobile
        for row, name in zip(M, names, strict=True):
            change = built.changes.get(name)
            if name == 'force':
                row[: self.ends[0]] = 2 * moving[self.acting] / moving.sum()
            elif change is not None and np.any(change.foundation):
                of = (np.broadcast_to(change.foundation, self.tied.shape) != 0)[self.tied]
                row[self.ends[0] : self.ends[1]] = of / of.sum()
        return M * self.size(scatter)

    def moves(self, system: LinearSystem) -> NDArray[np.float64]:
        """Derivatives of the rest positions by strengths and springs in mm, and by anchors, shape (particles * dim, unknowns)."""
        calc, free, n = system.calc, np.repeat(system.mobile, system.dim), self.tied.size
        kept = np.repeat(self.acting, system.dim)
        if calc.load.any():  # measured positions, which a load balances
            return np.hstack([np.zeros((n, self.ends[1])), np.eye(n)[:, kept]])
        C, H = calc.bonds.incidence, calc.rest_hessian('complete').toarray()
        force = -(calc.law.dphi(calc.bonds.lengths) / calc.bonds.lengths)[:, None] * calc.bond_vectors
        by_strengths = np.stack([(C.T @ sparse.diags_array(f) @ abs(C)).toarray() for f in force.T], axis=1).reshape(n, -1)
        by_springs = np.diag(np.broadcast_to(calc.spring_forces, self.tied.shape).ravel())
        by_anchors = np.where(free, np.diag(np.broadcast_to(calc.foundation, self.tied.shape).ravel()), -H)
        push = np.hstack([by_strengths[:, self.acting], by_springs[:, self.tied.ravel()], by_anchors[:, kept]])
        moved = np.zeros_like(push)
        moved[free] = np.linalg.solve(H[free][:, free], push[free])
        moved[~free, self.ends[1] :] = np.eye(n)[~free][:, kept]
        return moved


def at_sites(built: ParametricLattice, sites: Sites, z: NDArray[np.float64], scatter: NDArray[np.float64]) -> ParametricLattice:
    """The lattice with individual sites, at rest; measured positions, which a load balances, move with their anchors instead.

    Raises ValueError for sites out of all proportion, and if nothing holds them.
    """
    system, calc = built.system, built.system.calc
    strengths, springs, moves = sites.parts(z, scatter)
    if max(abs(strengths).max(initial=0.0), abs(springs).max(initial=0.0)) > BOUND:
        raise ValueError(f'a site is more than {MOST_FACTOR:g} times as strong or stiff as the others, or as weak or soft')
    measured = bool(calc.load.any())
    strengths, springs, moved = np.exp(strengths), np.exp(springs), np.zeros((len(moves), 3))
    moved[:, : system.dim] = moves
    own = replace(calc.sites, strengths=calc.strengths * strengths, anchors=calc.anchors + moved,
                  foundation=calc.foundation * springs)
    reference = calc.reference.copy()
    reference.positions += moved if measured else np.where(system.mobile[:, None], 0.0, moved)
    if not measured:
        sprung = calc.changed(reference, sites=own, model='complete')  # as in all statics
        reference.positions[:, : system.dim] += Structure(LinearSystem.about(sprung, system.atoms).atoms).rest().bent
    system = LinearSystem.about(calc.changed(reference, sites=own), system.atoms)
    pairs, changes = strengths[calc.bonds.i] * strengths[calc.bonds.j], {}
    for name, change in built.changes.items():
        law = change.law and force_change(change.law, pairs)
        changes[name] = replace(change, law=law, foundation=change.foundation * springs if np.any(change.foundation) else 0.0)
    return built._replace(system=system, changes=changes)


def site_slopes(built: ParametricLattice, basis: Any, own: Sequence[Solved], sites: Sites,
                scatter: NDArray[np.float64]) -> NDArray[np.float64]:
    """Derivatives of all responses by the unknowns of the sites, shape (points, unknowns), from the fields of `solved`."""
    rest, (n, dim), moves = Rest.of(built.system), sites.tied.shape, sites.moves(built.system)
    i, j, C = rest.frame.bonds.i, rest.frame.bonds.j, rest.frame.bonds.incidence
    by_strength_and_turns = np.concatenate([rest.K(rest.model)[..., None], rest.turns], axis=-1).reshape(len(i), dim**2, -1)
    found = []
    for one in own:
        x, y = ((basis @ field.T).reshape(n, dim, -1).swapaxes(1, 2) for field in (one.x, one.y))
        stretched = (x[j] - x[i])[..., None] * (y[j] - y[i])[:, :, None]
        bent = stretched.reshape(len(i), -1, dim**2) @ by_strength_and_turns  # of each bond and frequency
        moved = np.moveaxis((C.T @ bent[..., 1:].reshape(len(i), -1)).reshape(n, -1, dim), 1, 2).reshape(n * dim, -1)
        slopes = -moved.T @ moves
        direct = (abs(C).T @ bent[..., 0])[sites.acting].T, (x * y * rest.springs[:, None]).swapaxes(1, 2)[sites.tied].T
        slopes[:, : sites.ends[1]] -= np.hstack(direct)
        found.append(one.omega[:, None] ** 2 * slopes if one.function.shaken else slopes)
    return np.concatenate(found) * sites.size(scatter)


class Linear(NamedTuple):
    """Residuals divided by the noise at given parameters x and unknowns z, and the derivatives J and A of the responses by these,
    divided by it too.
    """

    r: NDArray[np.float64]
    J: NDArray[np.float64]
    A: NDArray[np.float64]


class Eliminated:
    """The inverse C^-1 = (damping + A A^T)^-1, applied by the smaller of its two equivalent forms."""

    def __init__(self, A: NDArray[np.float64], damping: float = 1.0) -> None:
        self.A, self.damping, self.wide = A, damping, A.shape[1] > A.shape[0]
        inner = A @ A.T if self.wide else A.T @ A
        inner[np.diag_indices_from(inner)] += damping
        self.factor: Any = linalg.cho_factor(inner, overwrite_a=True, check_finite=False)

    def __call__(self, v: NDArray[np.float64]) -> NDArray[np.float64]:
        if self.wide:
            return linalg.cho_solve(self.factor, v)
        return (v - self.A @ linalg.cho_solve(self.factor, self.A.T @ v)) / self.damping


def scatter_factors(at: Linear, z: NDArray[np.float64], kinds: NDArray[np.intp], off: NDArray[np.float64],
                    ) -> tuple[NDArray[np.float64], float, float]:
    """Factors of the scatter of each kind of unknowns that maximise the evidence, and two numbers.

    The numbers are how many unknowns the data then determine, and the gain of the logarithm of the evidence over no scatter.

    The prior says that the logarithm of each factor is `off`, with the standard deviation SURE.
    """
    Q = np.linalg.qr(at.J)[0]
    A = at.A - Q @ (Q.T @ at.A)
    G, u, each = A.T @ A, A.T @ (at.r + at.A @ z), np.eye(len(off))[kinds]

    def of(ln):
        t = np.exp(ln)[kinds]
        H = t[:, None] * G * t
        H[np.diag_indices_from(H)] += 1
        L = linalg.cho_factor(H, lower=True, check_finite=False)
        best, width = linalg.cho_solve(L, t * u), np.diag(linalg.cho_solve(L, np.eye(len(t))))
        less = np.log(np.diag(L[0])).sum() - t * u @ best / 2
        return (less + np.sum((ln - off) ** 2) / (2 * SURE**2), (1 - width - best**2) @ each + (ln - off) / SURE**2,
                np.sum(1 - width), -less)

    best = minimize(lambda ln: of(ln)[:2], 0 * off, jac=True, bounds=len(off) * [(-2.0, 2.0)], tol=1e-7).x
    known, evidence = of(best)[2:]
    return np.exp(best), float(known), float(evidence)


class Place(NamedTuple):
    """A point of a fit: parameters x, unknowns z, the responses h of the lattice with these, and what else is known of it."""

    x: NDArray[np.float64]
    z: NDArray[np.float64]
    h: NDArray[np.complex128]
    built: Any


@dataclass(frozen=True)
class ManyUnknowns:
    """Transfer functions fitted by parameters x and many unknowns z: minimises |h - h(x, z)|^2/noise^2 + |z|^2 + prior of x.

    A subclass says what the unknowns are.
    """

    functions: Sequence[TransferFunction]
    before: Before
    noise: float

    def place(self, x: NDArray[np.float64], z: NDArray[np.float64]) -> Place:
        """The point of the fit with these parameters and unknowns; raises ValueError where there is no such lattice."""
        raise NotImplementedError

    def slopes(self, place: Place) -> tuple[NDArray[np.complex128], NDArray[np.complex128]]:
        """Derivatives of the responses by x and by z, shape (points, parameters) and (points, unknowns)."""
        raise NotImplementedError

    def residuals(self, place: Place) -> NDArray[np.float64]:
        """Residuals divided by the noise, shape (2 points,)."""
        return split(weights(self.functions) * (measured_responses(self.functions) - place.h)) / self.noise

    def linear(self, place: Place) -> Linear:
        """The residuals, and their slopes."""
        weight = weights(self.functions)[:, None] / self.noise
        return Linear(self.residuals(place), *(split((weight * slopes).T).T for slopes in self.slopes(place)))

    def sum_of(self, place: Place) -> float:
        """The sum of squares that is minimised."""
        known = self.before.root @ (place.x - self.before.centre)
        return sum(float(one @ one) for one in (self.residuals(place), place.z, known))

    def descended(self, place: Place, steps: int, tolerance: float = 0.0) -> Place:
        """Take steps of Levenberg and Marquardt from a point, until one lowers the sum by less than this share."""
        damping = DAMPED
        for _ in range(steps):
            now, at = self.sum_of(place), self.linear(place)
            while not (there := self._stepped(place, at, damping)) or (then := self.sum_of(there)) >= now:
                damping = max(MORE * damping, DAMPED)
                if damping > STUCK:
                    return place
            place, damping = there, LESS * damping
            if now - then < tolerance * now:
                break
        return place

    def _stepped(self, place, at, damping):
        """The point after one step; None if it is too long: magnets then touch, or nothing holds them."""
        (x, z, *_), known, C = place, self.before.information, Eliminated(at.A, 1 + damping)
        r = at.r + at.A @ z / (1 + damping)
        CJ = C(at.J)
        F = at.J.T @ CJ + known
        dx = np.linalg.lstsq(F + damping * np.diag(np.diag(F)), CJ.T @ r + known @ (self.before.centre - x), BLIND)[0]
        dz = at.A.T @ C(r - at.J @ dx) - z / (1 + damping)
        try:
            return self.place(np.clip(x + dx, -BOUND, BOUND), z + dz)
        except ValueError:
            return None


@dataclass(frozen=True)
class _Problem(ManyUnknowns):
    """What is fitted: lattice, parameters, functions and prior knowledge, with this scatter of the sites."""

    build: Callable[[dict[str, float]], ParametricLattice]
    names: tuple[str, ...]
    sites: Sites
    scatter: NDArray[np.float64]

    def place(self, x, z):
        by_name = dict(zip(self.names, np.exp(x).tolist(), strict=True))
        built = at_sites(self.build(by_name), self.sites, z, self.scatter)
        fields = solved(built, self.functions)
        return Place(x, z, by_name.get('gain', 1.0) * np.concatenate([one.h for one in fields[1]]), (built, fields))

    def slopes(self, place):
        built, (basis, each) = place.built
        gain = np.exp(place.x[self.names.index('gain')]) if 'gain' in self.names else 1.0
        by_names = response_slopes(built, self.functions, self.names, fields=(basis, each))[1].T
        return gain * by_names, gain * site_slopes(built, basis, each, self.sites, self.scatter)

    def of_most_evidence(self, place: Place, known: bool) -> tuple[Place, Linear, NDArray[np.float64], float] | None:
        """The last point, its linearisation, the scatter of most evidence and the noise, which is `known` or follows from what
        is left; None if no scatter has more evidence.
        """
        one = self
        for more in reversed(range(ROUNDS + 1)):
            place = one.descended(place, MOST, FINE)
            at = one.linear(place)
            factors, determined, gained = scatter_factors(at, place.z, one.sites.kinds, np.log(FIRST / one.scatter))
            if gained < 0:
                return None
            left = 1.0 if known else float(np.sqrt(at.r @ at.r / (len(at.r) - len(place.x) - determined)))
            if abs(np.log([*factors, left])).max() < SETTLED or not more:
                break
            place = place._replace(z=place.z / factors[one.sites.kinds])  # the same sites
            one = replace(one, scatter=one.scatter * factors, noise=one.noise * left)
        return place, at, one.scatter, one.noise  # pyright: ignore[reportPossiblyUnbound]  ROUNDS is not zero


def with_site_unknowns(fit: TransferFit, build: Callable[[dict[str, float]], ParametricLattice],
                       functions: Sequence[TransferFunction],
                       priors: Mapping[str, tuple[float, float]] | None = None) -> TransferFit:
    """Repeat the fit with unknowns for each site, if the residuals exceed the noise or the noise is not stated.

    Parameters
    ----------
    fit, build, functions, priors
        The result of `fit_transfer`, and its arguments.

    Returns
    -------
    TransferFit
        The fit of the means of the sites of this patch; without information if the sites would have to scatter by more than
        MOST_SCATTER.
    """
    known = stated(functions)
    if known and fit.chance >= FITS:
        return fit
    built = build(fit.by_name)
    one = _Problem(functions, Before.of(fit.names, priors), fit.noise, build, fit.names, Sites.of(built.system), FIRST)
    measured = abs(weights(functions) * measured_responses(functions))
    half = measured @ measured / 2 if known else np.inf  # more of what was measured must follow the lattice
    place = one.place(np.log(fit.factors), np.zeros(one.sites.ends[2]))
    wide = fit.misfit / START if known else START
    while wide > 1 + 0.2 * known:
        place = replace(one, noise=one.noise * wide).descended(place, FEW, ROUGH)
        wide /= LOWER
    found = one.of_most_evidence(place, known)
    if found is None:
        return fit.refused if fit.square > half else fit
    place, at, scatter, noise = found
    x, z = place.x, place.z
    C = Eliminated(at.A)
    unlike = _unlike(at, C, one.sites.split / scatter[1], z, at.J.T @ C(at.J) + one.before.information)
    if scatter[0] > MOST_SCATTER:
        return replace(fit, information=0 * fit.information, site_scatter=scatter, unlike=unlike)
    if at.r @ at.r * noise**2 > half:
        return fit.refused
    M, before = one.sites.means(built, fit.names, scatter), one.before
    own = at.J.T @ Eliminated(at.A - at.J @ M)(at.J) + before.information
    return replace(fit, factors=np.exp(x + M @ z), information=own, noise=noise, site_scatter=scatter, sites=z,
                   residuals=np.concatenate([at.r, z, before.root @ (before.centre - x)]), unlike=unlike)


def _unlike(at, C, split, z, known):
    """`TransferFit.unlike` of sites z, by one step of a fit with one more parameter: ln(kx/ky), along `split`."""
    a = at.A @ split
    Ca = C(a)
    with_others = at.J.T @ Ca
    information = a @ Ca - with_others @ np.linalg.lstsq(known, with_others, BLIND)[0]
    if information <= BLIND * (a @ Ca):  # there is one spring, or both are fitted
        return 0.0, np.inf
    return float(split @ z / information), float(information**-0.5)
