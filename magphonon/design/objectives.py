"""Objectives of a design: numbers to be made large, each with its exact gradient.

An objective only says how its value changes with the stiffness of each bond, the spring of each site and the mass of each site
(`Slope`).  A wave with the displacements x and y, and e = C(q) x in the bonds, contributes

    dJ/dK_b = Re(e^x* (x) e^y)        dJ/dk_i = Re(x_i* y_i)        dJ/dm_i = Re(z x_i*.y_i)

with the inertia z = -omega^2 + i omega gamma.  For a response, y is due to the drive, and x to the derivative of the objective by
y; for a Bloch mode both are the mode. The effect of strengths, pillars and feet on the stiffness is the same for all objectives
(`magphonon.design.scatter.site_slopes`).

Branches enter by sums over all of them, which stay smooth where branches cross. Objectives are added, subtracted and multiplied
by numbers, so that `-1.0 * edge` lowers a band edge.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import finite, indices, not_negative, number, one_of, positive, whole
from ..response.frf import Dof
from ..stiffness.matrices import bloch_matrix
from .scatter import Rest, Slope, form

DECIBEL = 10 / np.log(10)
SOFTER = 0.005  # difference of the stiffness of rods from that of springs, in static ones, from which on it is mentioned
UNHEARD = 1e-12  # amplitude, in the largest one, below which motion is round-off

Places = Dof | Sequence[Dof] | Sequence[int] | NDArray[np.intp]
"""Where a structure is driven or seen: along the directions of one or more `Dof`, or all motion of some particles."""


class Objective:
    """Base class of quantities that a design maximises: `value_and_slope(rest)` returns the value and its `Slope`."""

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        """The value of the objective and its `Slope`, for a structure at rest."""
        raise NotImplementedError

    def value(self, atoms: Any) -> float:
        """The value of the objective for a structure at rest: atoms, a LinearSystem or a `Rest`."""
        return float(self.value_and_slope(atoms if isinstance(atoms, Rest) else Rest.of(atoms))[0])

    def tuned(self, frequency: float, damping: float = 1.0) -> Objective:
        """The same objective with the frequencies of all sources and the damping rates multiplied by these factors."""
        return self

    def doubts(self, rest: Rest) -> list[str]:
        """Reasons in words why this objective may not be reachable."""
        return []

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

    def tuned(self, frequency: float, damping: float = 1.0) -> Objective:
        return Sum(tuple((c, part.tuned(frequency, damping)) for c, part in self.parts))

    def doubts(self, rest: Rest) -> list[str]:
        return [words for _, part in self.parts for words in part.doubts(rest)]


def targets_of(objective: Objective | Sequence[Objective]) -> tuple[Objective, ...]:
    """One objective or several as a tuple, which is not empty."""
    targets = (objective,) if isinstance(objective, Objective) else tuple(objective)
    if not targets:
        raise ValueError('nothing is to be made large: give one objective or more')
    return targets


def soft_minimum(values: NDArray[np.float64], width: float) -> tuple[float, NDArray[np.float64]]:
    """The soft minimum `-w ln mean exp(-J/w)` of values, and its derivative by each value."""
    e = np.exp(-(values - values.min()) / positive('width of a soft minimum', width))
    return float(values.min() - width * np.log(e.mean())), e / e.sum()


@dataclass(frozen=True, eq=False)
class Contrast(Objective):
    """How much more energy some places have than others, for a harmonic force: `10 lg(sum |u_loud|^2/sum |u_quiet|^2)` in dB.

    Without quiet places, it is the level of the loud ones in dB above 1 mm/N.

    Attributes
    ----------
    source : Dof or sequence of Dof
        Where unit forces act, in phase.
    loud, quiet : Dof, sequence of Dof, or sequence of int
        Displacements along given directions, or all motion of some particles: a port, a row, a region.
    omega, damping : float
        In rad/ms, and the damping rate in 1/ms, the force divided by the momentum.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import Contrast
    >>> from magphonon.response import Dof
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 3.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=4.0)
    >>> left, right = Contrast(Dof(18, (1, 0, 0)), [16], [20], 3.0, 0.1), Contrast(Dof(17, (1, 0, 0)), [16], [20], 3.0, 0.1)
    >>> bool(abs(left.value(patch)) < 1e-9), right.value(patch) > 1  # from the middle, and from a place nearer to the left
    (True, True)
    """

    source: Dof | Sequence[Dof]
    loud: Places
    quiet: Places
    omega: float
    damping: float

    def __post_init__(self) -> None:
        positive('omega', self.omega, 'rad/ms')
        not_negative('damping', self.damping, '1/ms')

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        # with G the response, dJ = -2 Re sum c (u* d) G dH y, where c = sign 10/ln 10/energy
        (n, dim), driven = rest.springs.shape, _dofs(self.source)
        if not all(isinstance(one, Dof) for one in driven):
            raise ValueError(f'the source must be Dof, each a particle and a direction, not {driven}')
        force = np.sum([one.force(n)[:, :dim] for one in driven], axis=0)
        at = f'a force on particle {", ".join(str(one.particle) for one in driven)}'
        if not rest.frame.along(force).any():
            raise ValueError(f'{at} moves nothing: it is held, or held along that direction; drive a particle that can move')
        y = rest.response(force, self.omega, self.damping)
        value, pull = 0.0, np.zeros((n, dim), complex)
        for sign, places in [(1, self.loud), (-1, self.quiet)][: 2 if np.asarray(self.quiet, object).size else 1]:
            particles, directions = _seen(places, n, dim)
            u = (y[particles] * directions).sum(1)
            energy = float((abs(u) ** 2).sum())
            if energy <= (UNHEARD * abs(y).max()) ** 2:
                which = ', '.join(map(str, dict.fromkeys(particles)))
                raise ValueError(f'particle {which} does not move along {directions[0].tolist()} for {at}: it is held, or by '
                                 'symmetry no wave reaches it, so its level is no number; choose another place or direction')
            value += sign * DECIBEL * np.log(energy)
            np.add.at(pull, particles, sign * 2 * DECIBEL / energy * u.conj()[:, None] * directions)
        x = rest.response(pull, self.omega, self.damping)
        return value, rest.harmonic(x, y, self.omega, self.damping).real

    def tuned(self, frequency: float, damping: float = 1.0) -> Objective:
        return replace(self, omega=frequency * self.omega, damping=damping * self.damping)

    def doubts(self, rest: Rest) -> list[str]:
        low, high = np.sqrt(abs(rest.spectrum[0][[0, -1]]))
        if low <= self.omega <= high:
            return []
        return [f'{units.hertz(self.omega):.4g} Hz lies outside the natural frequencies of the structure, {units.hertz(low):.4g} '
                f'to {units.hertz(high):.4g} Hz: no wave carries it, and the motion dies out around its source.']


def _dofs(places):
    each = list(np.atleast_1d(np.asarray(places, object)))
    if not each:
        raise ValueError('an objective has no source, or no place where it is seen; give a particle or more')
    return each


def _seen(places, n, dim):
    """The particle of each displacement that is seen, and its direction, shape (seen, dim)."""
    each = _dofs(places)
    if all(isinstance(one, Dof) for one in each) and each:
        for one in each:
            one.force(n)  # refuses a particle that does not exist
        return np.array([one.particle for one in each]), np.array([one.direction[:dim] for one in each])
    particles = indices('the particles that are seen', each, n)
    return np.repeat(particles, dim), np.tile(np.eye(dim), (len(particles), 1))


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
        Sharpness in ms.
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
        positive('sharp', self.sharp, 'ms')

    def value_and_slope(self, rest: Rest) -> tuple[float, Slope]:
        squares, x = self._waves(rest)
        branches, sign = (np.s_[: self.below], 1) if self.side == 'top' else (np.s_[self.below :], -1)
        squares, x = squares[:, branches], x[..., branches]
        if not squares.size or (sign > 0 and squares.shape[1] < self.below):
            raise ValueError(f'the cell has {rest.frame.free.shape[1]} branches, so a gap above {self.below} branches has '
                             'branches on one side only; choose another number of branches below the gap')
        omega = np.sign(squares) * np.sqrt(abs(squares))
        soft, share = soft_minimum(-sign * omega.ravel(), 1 / self.sharp)
        c = share.reshape(omega.shape) / (2 * np.maximum(abs(omega), np.finfo(float).tiny ** 0.5))
        edge = -sign * (soft - np.log(omega.size) / self.sharp)
        bonds, (n, dim) = rest.frame.bonds, rest.springs.shape
        each = [form(bonds, (w * v.conj()).reshape(n, dim, -1), v.reshape(n, dim, -1), -s, q)
                for w, v, s, q in zip(c, x, squares, self.q, strict=True) if w.any()]
        return float(edge), sum(each, Slope()).real

    def doubts(self, rest: Rest) -> list[str]:
        edge = self.value(rest)
        softer = -rest.excess(edge)[0].min()
        return [f'In waves of a cell rods count as springs with 33/140 of their mass, but at {units.hertz(edge):.4g} Hz they are '
                f'softer by up to {100 * softer:.2g} % of their static stiffness: this edge lies lower.'] * bool(softer > SOFTER)

    def _waves(self, rest):
        """Squared frequencies of Bloch waves, shape (wavevectors, branches), and the modes x in columns, with x.M x = 1."""
        if not rest.frame.bonds.shift.any():
            raise ValueError('only a periodic cell has bands, but this structure is finite; set atoms.pbc, or choose an '
                             'objective of a finite structure, such as Contrast')

        def modes():
            S = rest.frame.free.toarray() / np.sqrt(np.repeat(rest.masses, rest.springs.shape[1]))[:, None]
            squares, v = np.linalg.eigh(S.T @ bloch_matrix(rest.frame.bonds, rest.K(rest.model), self.q, rest.springs) @ S)
            return squares, S @ v

        return rest.once(self.q.tobytes(), modes)


def band_gap(q: ArrayLike, below: int, sharp: float = 100.0) -> Sum:
    """Width in rad/ms of the gap above the lowest `below` branches, between soft edges; negative where it is closed.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.design import band_gap
    >>> cell = lattices.triangular(1.0, 1.0).repeat((2, 1, 1))
    >>> cell.set_masses([1.0, 3.0])
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=20.0)
    >>> half = [(a / 4, b / 4, 0) for a in range(4) for b in range(3)]
    >>> round(band_gap(half, 2, sharp=1000.0).value(cell), 2)  # rad/ms, between light and heavy magnets
    1.07
    """
    edges = [BandEdge(np.asarray(q), below, side, sharp) for side in ('bottom', 'top')]
    return edges[0] - edges[1]
