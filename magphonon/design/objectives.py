"""Objectives of a design: numbers to be made large, each with its exact gradient.

An objective only says how its value changes with the stiffness of each bond, the spring of each site and the mass of each site
(`Slope`).  A wave with the displacements x and y, and e = C(q) x in the bonds, contributes

    dJ/dK_b = Re(e^x* (x) e^y)        dJ/dk_i = Re(x_i* y_i)        dJ/dm_i = Re(z x_i*.y_i)

with the inertia z = -omega^2 + i omega gamma.  For a response, x is due to a unit force where the response is seen, and y to
the drive; for a Bloch mode both are the mode; for a burst x is the adjoint motion. The effect of strengths, pillars and feet on
the stiffness is the same for all objectives, and is computed in `magphonon.design.site_designs`.

Branches enter by sums over all of them, which stay smooth where branches cross. Objectives that need one single mode
(`GroupVelocity`, `LocalMode`) refuse a mode that has nearly the same frequency as another one.

Objectives are added, subtracted and multiplied by numbers:

>>> import numpy as np
>>> from magphonon.design import Level
>>> from magphonon.response import Dof
>>> source, port, other = (Dof(k, np.array([1.0, 0, 0])) for k in (3, 8, 12))
>>> contrast = Level(source, port, 0.4, 0.004) - Level(source, other, 0.4, 0.004)  # in dB
>>> len(contrast.parts)
2
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import linalg, sparse

from .. import units
from ..errors import Unstable, finite, not_negative, number, one_of, positive, shown, whole
from ..response.frf import Dof
from ..stiffness.bond import model_stiffness
from ..stiffness.factors import inverse
from ..stiffness.matrices import bloch_gradient
from ..stiffness.rest import LinearSystem
from .scatter import Slope, elongations, form, full_or_sparse

DECIBEL = 10 / np.log(10)
HARD = 1e-10  # width, as a fraction of the highest frequency, within which the extremes of a hard edge are equal
MEETING = 1e-6  # distance of a mode from the next, as a fraction of the largest squared frequency, below which they meet
CONTRARY = 0.999  # cosine between the slopes of two targets from which what raises one lowers the other
NEAR = 1e-6  # relative difference of squared frequencies below which a divided difference is a derivative
STEP = 1e-3  # of squared frequencies, relative, over which that derivative is taken, to fourth order


class Rest:
    """A structure at rest that stores the solutions which several objectives need, so that each is computed only once."""

    def __init__(self, system: LinearSystem) -> None:
        self.system = system.moving()
        self._known: dict[Any, Any] = {}

    def once(self, key: Any, compute: Callable[[], Any]) -> Any:
        """The stored result for `key`; `compute` runs only the first time."""
        if key not in self._known:
            self._known[key] = compute()
        return self._known[key]

    @cached_property
    def stiffness(self) -> Any:
        """Hessian of the free directions, stored as a dense matrix if it has few zeros."""
        return full_or_sparse(self.system.stiffness)

    @cached_property
    def masses(self) -> NDArray[np.float64]:
        """Mass along each free direction in g."""
        return self.system.free.power(2).T @ np.repeat(self.system.masses, self.system.dim)

    @cached_property
    def spectrum(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Squared frequencies, and the modes x in columns, shape (free, modes), normalised to x.M x = 1."""
        squares, v = self.system.spectrum
        return squares, v / np.sqrt(self.masses)[:, None]

    def response(self, place: Dof, omega: float, damping: float) -> NDArray[np.complex128]:
        """Displacements for a unit force at a place, shape (particles, dim), in mm/N."""
        def solver():
            z, m = 1j * omega * damping - omega**2, self.masses
            if sparse.issparse(self.stiffness):
                return inverse(sparse.csr_array(self.stiffness + sparse.diags_array(z * m)))
            factors = linalg.lu_factor(self.stiffness + np.diag(z * m), check_finite=False)
            return lambda F: linalg.lu_solve(factors, F, check_finite=False)

        def displacements():
            system = self.system
            force = system.free.T @ place.force(len(system))[:, : system.dim].ravel()
            if not force.any():
                raise ValueError(f'particle {place.particle} is held, or held along the direction in which it is driven or seen; '
                                 'choose a particle that can move')
            return (system.free @ self.once((omega, damping), solver)(force + 0j)).reshape(-1, system.dim)

        return self.once((place.particle, *place.direction, omega, damping), displacements)

    def waves(self, q: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.complex128]]:
        """Squared frequencies of Bloch waves, shape (wavevectors, branches), and the modes x in columns, with x.M x = 1."""
        if not self.system.atoms.pbc.any():
            raise ValueError('only a periodic cell has bands, but this structure is finite; set atoms.pbc, or choose an '
                             'objective of a finite structure, such as Level')

        def modes():
            squares, v = np.linalg.eigh(self.system.bloch(q, self.system.calc.model))
            return squares, np.asarray(self.system.shapes.todense()) @ v

        return self.once(q.tobytes(), modes)


class Objective:
    """Base class of quantities that a design maximises: `value_and_slope(rest)` returns the value and its `Slope`."""

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        """The value of the objective and its `Slope`, for a structure at rest."""
        raise NotImplementedError

    def value(self, rest: Rest | LinearSystem) -> float:
        """The value of the objective for a structure at rest."""
        return float(self.value_and_slope(rest if isinstance(rest, Rest) else Rest(rest))[0])

    def tuned(self, factor: float) -> Objective:
        """The same objective with all source frequencies multiplied by `factor`, for sources that are off their frequency."""
        return self

    @property
    def frequencies(self) -> set[float]:
        """Frequencies of the sources, in rad/ms."""
        return set()

    def doubts(self, rest: Rest) -> list[str]:
        """Reasons in words why this objective may not be reachable."""
        modes = np.sqrt(abs(rest.spectrum[0][[0, -1]]))
        low, high = modes / (2 * np.pi * units.Hz)
        return [f'{omega / (2 * np.pi * units.Hz):.4g} Hz lies outside the natural frequencies of the structure, {low:.4g} to '
                f'{high:.4g} Hz: no wave carries it, and the motion dies out around its source.'
                for omega in sorted(self.frequencies) if not modes[0] <= omega <= modes[1]]

    def near(self, wanted: float, width: float) -> Target:
        """An objective that is largest where this one has the wanted value: `-((value - wanted)/width)^2`."""
        return Target(self, wanted, width)

    def __add__(self, other: Objective) -> Sum:
        return Sum(((1.0, self), (1.0, other)))

    def __sub__(self, other: Objective) -> Sum:
        return Sum(((1.0, self), (-1.0, other)))

    def __rmul__(self, c: float) -> Sum:
        return Sum(((number('the factor of an objective', c), self),))


@dataclass(frozen=True)
class Sum(Objective):
    """Sum of objectives, each multiplied by a number."""

    parts: tuple[tuple[float, Objective], ...]

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        found = [(c, *part.value_and_slope(rest)) for c, part in self.parts]
        return sum(c * value for c, value, _ in found), sum((c * slope for c, _, slope in found), Slope())

    def tuned(self, factor: float) -> Objective:
        return Sum(tuple((c, part.tuned(factor)) for c, part in self.parts))

    @property
    def frequencies(self) -> set[float]:
        return set().union(*(part.frequencies for _, part in self.parts))


@dataclass(frozen=True)
class Target(Objective):
    """Objective `-((value - wanted)/width)^2`, which is largest where another one has the wanted value."""

    of: Objective
    wanted: float
    width: float

    def __post_init__(self) -> None:
        number('wanted', self.wanted)
        positive('width', self.width)

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        value, slope = self.of.value_and_slope(rest)
        off = (value - self.wanted) / self.width
        return -(off**2), -2 * off / self.width * slope

    def tuned(self, factor: float) -> Objective:
        return replace(self, of=self.of.tuned(factor))

    @property
    def frequencies(self) -> set[float]:
        return self.of.frequencies


@dataclass(frozen=True)
class Worst(Objective):
    """Soft minimum of several objectives, `-w ln mean exp(-J/w)`: the worst one, and all within w of it, count most.

    Attributes
    ----------
    of : tuple of Objective
    width : float
        The w, in the unit of the objectives.
    """

    of: tuple[Objective, ...]
    width: float = 1.0

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        values, slopes = zip(*(one.value_and_slope(rest) for one in self.of), strict=True) if self.of else ((), ())
        value, share = soft_minimum(np.array(values), self.width)
        return value, sum((c * slope for c, slope in zip(share, slopes, strict=True)), Slope())

    def tuned(self, factor: float) -> Objective:
        return replace(self, of=tuple(one.tuned(factor) for one in self.of))

    @property
    def frequencies(self) -> set[float]:
        return set().union(*(one.frequencies for one in self.of))

    def doubts(self, rest: Rest) -> list[str]:
        slopes = [np.concatenate([np.ravel(part) for part in (slope.bonds, slope.springs, slope.masses)])
                  for slope in (one.value_and_slope(rest)[1] for one in self.of)]
        return super().doubts(rest) + [
            f'targets {k + 1} and {m + 1} contradict each other: whatever raises one lowers the other.'
            for k, m in combinations(range(len(slopes)), 2)
            if slopes[k] @ slopes[m] < -CONTRARY * np.linalg.norm(slopes[k]) * np.linalg.norm(slopes[m])]


def soft_minimum(values: NDArray[np.float64], width: float) -> tuple[float, NDArray[np.float64]]:
    """The soft minimum of values, and its derivative by each value; for an infinite width it is their mean."""
    if not len(values) or not width > 0:
        raise ValueError(f'a soft minimum takes one or more numbers and a positive width (infinite for their mean), not '
                         f'{len(values)} numbers with the width {width!r}')
    if np.isinf(width):
        return float(values.mean()), np.full(len(values), 1 / len(values))
    e = np.exp(-(values - values.min()) / width)
    return float(values.min() - width * np.log(e.mean())), e / e.sum()


@dataclass(frozen=True, eq=False)
class Level(Objective):
    """Level of a frequency response in dB above 1 mm/N: `10 lg(|h|^2 + floor^2)`.

    Attributes
    ----------
    source, seen : Dof
        Where the force acts, and where the displacement is seen.
    omega : float
        In rad/ms.
    damping : float
        Damping rate in 1/ms, the force divided by the momentum.
    floor : float
        Amplitude in mm/N below which the response hardly changes the level. It keeps a design from relying on a zero so
        deep that no real lattice has it.
    """

    source: Dof
    seen: Dof
    omega: float
    damping: float
    floor: float = 0.0

    def __post_init__(self) -> None:
        positive('omega', self.omega, 'rad/ms')
        not_negative('damping', self.damping, '1/ms')
        not_negative('floor', self.floor, 'mm/N')

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        x, y = (rest.response(place, self.omega, self.damping) for place in (self.seen, self.source))
        h = complex(self.seen.seen(y))
        power = abs(h) ** 2 + self.floor**2
        if not power:
            raise ValueError(f'particle {self.seen.particle} does not move along {self.seen.direction} for a force on particle '
                             f'{self.source.particle} along {self.source.direction}, so its level is no number: choose another '
                             'place or direction, or a floor')
        c = -2 * DECIBEL * h.conjugate() / power
        z = 1j * self.omega * self.damping - self.omega**2
        return DECIBEL * np.log(power), form(rest.system.calc.bonds, (c * x)[..., None], y[..., None], z).real

    def tuned(self, factor: float) -> Objective:
        return replace(self, omega=factor * self.omega)

    @property
    def frequencies(self) -> set[float]:
        return {self.omega}


@dataclass(frozen=True, eq=False)
class BandEdge(Objective):
    """Frequency of a band edge in rad/ms, for a cell of any number of magnets: a soft extreme over wavevectors and branches.

    `exp(sharp omega)` is summed over all wavevectors and all branches on one side of the gap. The sum is smooth even where these
    branches cross; it is not smooth where the two sides of the gap touch.  The soft edge lies inside the gap by up to
    ln(terms)/sharp.

    Attributes
    ----------
    q : ndarray, shape (wavevectors, 3)
    below : int
        Number of branches below the gap.
    side : {'top', 'bottom'}
        Top of the branches below the gap, or bottom of those above it.
    sharp : float
        Sharpness in ms. If it is infinite the edge is the true one, which is smooth in parameters that all particles share.
    """

    q: np.ndarray
    below: int
    side: str = 'top'
    sharp: float = 100.0

    def __post_init__(self) -> None:
        q = np.atleast_2d(finite('q', self.q))
        object.__setattr__(self, 'q', finite('q', q, (len(q), 3)))
        whole('below', self.below, 0)
        one_of('side', self.side, ('top', 'bottom'))
        positive('sharp', min(self.sharp, 1e300), 'ms')

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        squares, x = rest.waves(self.q)
        branches, sign = (np.s_[: self.below], 1) if self.side == 'top' else (np.s_[self.below :], -1)
        squares, x = squares[:, branches], x[..., branches]
        if not squares.size or (sign > 0 and squares.shape[1] < self.below):
            raise ValueError(f'the cell has {rest.system.directions} branches, so a gap above {self.below} branches has branches '
                             'on one side only; choose another number of branches below the gap')
        omega = np.sign(squares) * np.sqrt(abs(squares))
        soft, share = soft_minimum(-sign * omega.ravel(), max(1 / self.sharp, HARD * abs(omega).max()))
        c = share.reshape(omega.shape) / (2 * np.maximum(abs(omega), np.finfo(float).tiny ** 0.5))
        edge = -sign * (soft - np.log(omega.size) / self.sharp) if np.isfinite(self.sharp) else sign * (sign * omega).max()
        bonds, n, dim = rest.system.calc.bonds, len(rest.system), rest.system.dim
        each = [form(bonds, (w * v.conj()).reshape(n, dim, -1), v.reshape(n, dim, -1), -s, q)
                for w, v, s, q in zip(c, x, squares, self.q, strict=True) if w.any()]
        return float(edge), sum(each, Slope()).real


def band_gap(q: ArrayLike, below: int, sharp: float = 100.0) -> Sum:
    """Width in rad/ms of the gap above the lowest `below` branches, between soft edges; negative where it is closed.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Rest, band_gap
    >>> from magphonon.stiffness import LinearSystem
    >>> cell = lattices.triangular(1.0, 1.0).repeat((2, 1, 1))
    >>> cell.set_masses([1.0, 3.0])
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=20.0)
    >>> half = [(a / 4, b / 4, 0) for a in range(4) for b in range(3)]
    >>> round(band_gap(half, 2, sharp=1000.0).value(LinearSystem.of(cell)), 2)  # rad/ms, between light and heavy magnets
    1.07
    """
    edges = [BandEdge(np.asarray(q), below, side, sharp) for side in ('bottom', 'top')]
    return edges[0] - edges[1]


def _slope_of_mode(rest, squares, x, at, own, pull, q=None):
    """Slope of a number J that depends on one mode x and its omega^2: own = dJ/d(omega^2), pull = dJ/dx*, to first order.

    With y = sum_n x_n (x_n*.pull)/(lambda - lambda_n) it is `Re (own x + 2 y)*.(dK - lambda dM) x - Re(pull*.x) x*.dM x`.
    """
    away, n, dim = squares[at] - squares, len(rest.system), rest.system.dim
    away[at] = np.inf
    if abs(away).min() < MEETING * abs(squares).max():
        raise Crossing(f'the mode at {np.sqrt(abs(squares[at])):.6g} rad/ms has the same frequency as another one, so neither '
                       f'is a mode by itself; break the symmetry that makes them equal, or choose another wavevector or place')
    mode = x[:, at]
    y = x @ ((x.conj().T @ pull) / away)
    both = (own * mode + 2 * y).conj().reshape(n, dim, 1), mode.reshape(n, dim, 1)
    slope = form(rest.system.calc.bonds, *both, -squares[at], q).real
    drop = (pull.conj() @ mode).real * (abs(both[1]) ** 2).sum((1, 2))
    return slope + Slope(masses=-drop)


def _frequency(square):
    if not square > 0:
        raise Unstable('the wave whose frequency is wanted grows instead of vibrating, in the model chosen for the waves')
    return float(np.sqrt(square))


class Crossing(ValueError):
    """Two modes have nearly the same frequency, so that neither has a derivative of its own."""


@dataclass(frozen=True, eq=False)
class GroupVelocity(Objective):
    """Group velocity `d omega/dk` of a wave along a direction, in mm/ms.

    Attributes
    ----------
    q : ndarray, shape (3,)
        In fractions of the reciprocal vectors.
    branch : int
        Counted from 0 by frequency.
    direction : ndarray, shape (dim,)
        A vector of any length.
    """

    q: np.ndarray
    branch: int
    direction: np.ndarray

    def __post_init__(self) -> None:
        along = finite('direction', self.direction)
        object.__setattr__(self, 'q', finite('q', self.q, (3,)))
        object.__setattr__(self, 'direction', along / positive('the length of direction', np.linalg.norm(along)))
        whole('branch', self.branch, 0)

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        calc, q = rest.system.calc, self.q
        squares, x = (part[0] for part in rest.waves(q[None]))
        if self.branch >= len(squares):
            raise ValueError(f'branch must be 0 to {len(squares) - 1}, not {self.branch}')
        mode, omega, n = x[:, self.branch], _frequency(squares[self.branch]), len(rest.system)
        towards, cell = self.direction[: calc.dim], calc.reference.cell.array[:, : calc.dim]
        gradient = bloch_gradient(calc.bonds, calc.rest_stiffness(calc.model), q[None], cell)[:, 0]
        pull = np.tensordot(towards, gradient, 1) @ mode / (2 * omega)
        value = float((mode.conj() @ pull).real)
        slope = _slope_of_mode(rest, squares, x, self.branch, -value / (2 * squares[self.branch]), pull, q)
        here = mode.reshape(n, -1, 1)
        turning = np.exp(2j * np.pi * calc.bonds.shift @ q) * 1j * (calc.bonds.shift @ cell @ towards)
        turned = turning[:, None, None] * here[calc.bonds.j]  # dC/dk x
        own = Slope((turned.conj() @ elongations(calc.bonds, here, q).swapaxes(1, 2)).real / omega)
        return value, slope + own + Slope(lengths=value)


@dataclass(frozen=True, eq=False)
class LocalMode(Objective):
    """Frequency or extent of the natural mode that moves one site of a structure most.

    Attributes
    ----------
    site : int
    quantity : {'frequency', 'extent'}
        The frequency in rad/ms, or the number of particles that take part in the mode, `1/sum_i (m_i |x_i|^2)^2`.
    """

    site: int
    quantity: str = 'frequency'

    def __post_init__(self) -> None:
        one_of('quantity', self.quantity, ('frequency', 'extent'))

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        system = rest.system
        squares, v = rest.spectrum
        x, m = np.asarray(system.free @ v), system.masses
        share = m[:, None] * (x.reshape(len(m), system.dim, -1) ** 2).sum(1)  # of each particle in the energy of each mode
        if not 0 <= self.site < len(m) or not system.mobile[self.site]:
            raise ValueError(f'particle {self.site} moves in no mode: choose a free one of the {len(m)}, counted from 0')
        at = int(share[self.site].argmax())
        if self.quantity == 'frequency':
            omega = _frequency(squares[at])
            return omega, _slope_of_mode(rest, squares, x, at, 1 / (2 * omega), 0 * x[:, at])
        own = share[:, at]
        value = float(1 / (own**2).sum())
        pull = -2 * value**2 * np.repeat(own * m, system.dim) * x[:, at]  # half of the derivative, as of a complex mode
        slope = _slope_of_mode(rest, squares, x, at, 0.0, pull)
        return value, slope + Slope(masses=-2 * value**2 * own**2 / m)


@dataclass(frozen=True)
class Margin(Objective):
    """Distance of a structure from buckling: soft minimum of the eigenvalues of its static stiffness over mass, in rad^2/ms^2.

    It is computed in the complete model, whatever the model of the waves; in a periodic cell it counts only motion that is equal
    in all cells, q = 0. As a constraint of `optimise` it keeps designs away from buckling.

    Attributes
    ----------
    sharp : float
        Sharpness of the soft minimum, in ms^2.
    """

    sharp: float = 1000.0

    def __post_init__(self) -> None:
        positive('sharp', self.sharp, 'ms^2')

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        system, m = rest.system, np.sqrt(rest.masses)
        K = system.free.T @ system.calc.rest_hessian('complete') @ system.free
        squares, v = np.linalg.eigh(K.toarray() / np.outer(m, m))
        soft, share = soft_minimum(squares, 1 / self.sharp)
        x = np.asarray(system.free @ (v / m[:, None])).reshape(len(system), system.dim, -1)
        slope = form(system.calc.bonds, share * x, x, -squares)
        return soft - np.log(len(squares)) / self.sharp, replace(slope, bonds=0.0, statics=slope.bonds)


@dataclass(frozen=True, eq=False)
class BurstEnergy(Objective):
    """Kinetic energy of a burst in a region, summed over a window of time, in dB above 1 mJ ms.

    A source pushes with `A sin(omega t) sin^2(pi t/T)` for a number of cycles.  For small motion the transient is exact, a sum
    over all modes, and its slope comes from divided differences (Daleckii and Krein): with the velocity g(lambda, t) of one
    oscillator

        dE = sum_nm A_nm (x_n.dK x_m)        A_nm = (x_m.F) sum_t b_n(t) (g_n - g_m)/(lambda_n - lambda_m)

    For large motion, if `amplitude` is given, damped Verlet steps are taken, and the exact slope of these steps is computed by
    the same steps backwards: with c, d = 1 +- gamma dt/2,

        c u_(k+1) = 2 u_k - d u_(k-1) + dt^2 (f_k - F(u_k))/m
        c z_(k-1) = 2 z_k - d z_(k+1) - (dt^2 K(u_k) z_k + dJ/du_k)/m

    The difference of two such energies, in a region and in the whole structure, is the share of the energy in the region in dB.

    Attributes
    ----------
    source : Dof
    region : tuple of int
        The particles whose energy counts.
    window : (float, float)
        Start and end in ms.
    omega : float
        In rad/ms.
    cycles : int
    damping : float
        In 1/ms.
    dt : float
        In ms: step between the times of the window, and time step of large motion.
    amplitude : float
        Amplitude of the force in N; zero for small motion under a unit force.
    """

    source: Dof
    region: tuple[int, ...]
    window: tuple[float, float]
    omega: float
    cycles: int
    damping: float
    dt: float = 0.25
    amplitude: float = 0.0

    def __post_init__(self) -> None:
        for name, unit in (('omega', 'rad/ms'), ('cycles', ''), ('dt', 'ms')):
            positive(name, getattr(self, name), unit)
        not_negative('damping', self.damping, '1/ms')
        not_negative('amplitude', self.amplitude, 'N')
        start, end = finite('window', self.window, (2,))
        if not max(start, 0) + self.dt <= end:
            raise ValueError(f'the window in ms must end at least one step dt = {self.dt:g} after its start and after t = 0, '
                             f'not go from {start:g} to {end:g}')
        if not self.omega * self.dt < np.pi:
            raise ValueError(f'dt = {self.dt:g} ms is longer than half a period of the burst, {np.pi / self.omega:g} ms; take a '
                             'shorter one')

    def tuned(self, factor: float) -> Objective:
        return replace(self, omega=factor * self.omega)

    @property
    def frequencies(self) -> set[float]:
        return {self.omega}

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        system = rest.system
        push = system.free.T @ self.source.force(len(system))[:, : system.dim].ravel()
        if not push.any():
            raise ValueError(f'the source drives particle {self.source.particle}, which is held; choose a particle that can move')
        counted = system.free.power(2).T @ np.repeat(np.isin(np.arange(len(system)), self.region) / 2, system.dim) * rest.masses
        if not counted.any() or not np.isin(self.region, np.arange(len(system))).all():
            raise ValueError(f'the region {shown(self.region)} must consist of some of the {len(system)} particles, counted '
                             f'from 0, at least one of them free to move; choose another region')
        energy, slope = (self._stepped if self.amplitude else self._exact)(rest, push, counted)
        return DECIBEL * np.log(energy), DECIBEL / energy * slope

    @property
    def _period(self):
        return 2 * np.pi * self.cycles / self.omega

    def _oscillators(self, squares, t):
        """Velocities g of oscillators of unit mass, shape (times, oscillators), in closed form, with poles p and waves nu."""
        half, T = self.damping / 2, self._period
        root = np.sqrt(half**2 - squares + 0j)
        until, found = np.minimum(t, T)[:, None], 0.0
        for nu, a in ((self.omega, 0.5), (self.omega + 2 * np.pi / T, -0.25), (self.omega - 2 * np.pi / T, -0.25)):
            for p in (root - half, -root - half):
                done = np.exp(1j * nu * until + p * (t[:, None] - until)) - np.exp(p * t[:, None])
                found = found + a * p * done / ((1j * nu - p) * (2 * p + 2 * half))
        return found.imag

    def _exact(self, rest, push, counted):
        system, bonds, (squares, X) = rest.system, rest.system.calc.bonds, rest.spectrum

        def motion():
            t = self.dt * (np.arange(int(self.window[1] / self.dt)) + 0.5)
            t, h = t[t > self.window[0]], STEP * abs(squares).mean() * np.array([1.0, -1.0, 2.0, -2.0])[:, None]
            g, around = self._oscillators(squares, t), [self._oscillators(squares + one, t) for one in h]
            return g, (8 * (around[0] - around[1]) - around[2] + around[3]) / (12 * h[0])

        g, dg = rest.once(('burst', replace(self, region=())), motion)
        s = X.T @ push
        v = (g * s) @ X.T
        b = 2 * self.dt * counted * v
        energy, beta = 0.5 * float((b * v).sum()), b @ X
        P, apart = beta.T @ g, squares[:, None] - squares
        own = P.diagonal()
        close = abs(apart) < NEAR * abs(squares).max()
        A = s * np.where(close, beta.T @ dg, (own[:, None] - P) / np.where(close, 1, apart))
        B = X @ A @ X.T
        B = (B + B.T) / 2
        by_mass = -(rest.system.stiffness @ B).diagonal() - push * (X @ own) / 2
        n, dim, F = len(system), system.dim, system.free
        full = (F @ (F @ B).T).reshape(n, dim, n, dim)
        i, j, each = bonds.i, bonds.j, np.arange(n)
        G = full[i, :, i] + full[j, :, j] - full[i, :, j] - full[j, :, i]
        springs = np.einsum('ixx->ix', full[each, :, each])
        return energy, Slope(G, springs, (F.power(2) @ by_mass).reshape(n, dim).sum(1) / system.masses)

    def _stepped(self, rest, push, counted):
        system, m, calc, P = rest.system, rest.masses, rest.system.calc, rest.system.free
        if calc.model != 'complete':
            raise ValueError('large motion is computed in the complete model only; leave out the amplitude for the conventional '
                             'model')
        n, dim, bonds, R = len(system), system.dim, calc.bonds, calc.bond_vectors
        C = sparse.csr_array(sparse.kron(bonds.incidence, sparse.eye_array(dim)) @ P)
        k, acts, dt = P.T @ np.broadcast_to(calc.foundation, (n, dim)).ravel(), calc.interaction, self.dt
        c = 1 + self.damping * dt / 2
        still, K0 = acts.forces(R)[1], model_stiffness(R, acts)
        t = dt * np.arange(int(self.window[1] / dt) + 1)
        f = np.where(t < self._period, self.amplitude * np.sin(self.omega * t) * np.sin(np.pi * t / self._period) ** 2, 0.0)
        U = np.zeros((len(t), len(m)))
        for a in range(1, len(t) - 1):
            pull = C.T @ (acts.forces(R + (C @ U[a]).reshape(R.shape))[1] - still).ravel() + k * U[a]
            U[a + 1] = (2 * U[a] - (2 - c) * U[a - 1] + dt**2 * (f[a] * push - pull) / m) / c
        if not abs(U).max() < np.linalg.norm(R, axis=1).min():
            raise ValueError(f'the motion grows beyond the spacing at the amplitude {self.amplitude:g} N and the time step '
                             f'{dt:g} ms; reduce either')
        on = (t[:-1] + dt / 2 > self.window[0]) * dt
        velocity = np.diff(U, axis=0) / dt
        each = on[:, None] * counted * velocity**2
        pulled = 2 * on[:, None] * counted * velocity / dt
        dU, Z = np.zeros_like(U), np.zeros_like(U)
        dU[1:] += pulled
        dU[:-1] -= pulled
        strengths, vectors = np.zeros(len(R)), np.zeros(R.shape)
        for a in range(len(U) - 1, 1, -1):
            K, e = model_stiffness(R + (C @ U[a]).reshape(R.shape), acts), (C @ Z[a]).reshape(R.shape)
            after = (2 - c) * Z[a + 1] if a + 1 < len(U) else 0.0
            bent = C.T @ np.einsum('bxy,by->bx', K, e).ravel() + k * Z[a]
            Z[a - 1] = (2 * Z[a] - after - (dt**2 * bent + dU[a]) / m) / c
        for a in range(1, len(U) - 1):
            there, e = R + (C @ U[a]).reshape(R.shape), (C @ Z[a]).reshape(R.shape)
            strengths += (e * (acts.forces(there)[1] - still)).sum(1)
            vectors += np.einsum('bxy,by->bx', model_stiffness(there, acts) - K0, e)
        inertia = c * U[2:] - 2 * U[1:-1] + (2 - c) * U[:-2]
        masses = (P.power(2) @ ((Z[1:-1] * inertia).sum(0) + each.sum(0) / m)).reshape(n, dim).sum(1)
        springs = (P.power(2) @ (U * Z).sum(0)).reshape(n, dim)
        return float(each.sum()), Slope(0.0, dt**2 * springs, masses, dt**2 * strengths, dt**2 * vectors)
