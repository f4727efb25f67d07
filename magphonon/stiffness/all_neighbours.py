"""ASE calculator of an infinite lattice in which every particle repels every other one.

Some laws, such as that of discs, are not mixtures of Gaussians. Beyond `TAIL` spacings such a law is replaced by the inverse
power with the same force and slope there. The power is summed over all particles, and the difference between law and power over
the nearer ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from ase import Atoms
from ase.geometry import find_mic
from numpy.typing import ArrayLike, NDArray

from ..errors import one_of
from ..interactions.bond_laws import laid
from ..interactions.pair_laws import Composed, GaussianMixture, InversePower, PairLaw, local_exponent
from ..lattices.bonds import Bonds, bonds_within, distances_within, image_of
from .ewald import EwaldSums
from .matrices import MODELS, Central, Model, bloch_matrix, bloch_series, bond_stiffness
from .plausibility import warn_of_units
from .repulsion import Repulsion
from .sites import Foundation, Sites, displacement_components, from_reference, range_of, refuse_motion_out_of_the_plane

TAIL = 12.3
"""Distance in spacings from which a law counts as an inverse power: the bands of discs, whose law approaches that of dipoles,
then change by less than 1e-6 (tests/bands/test_neighbours.py)."""
STEEPEST_TAIL = 10.0
"""Exponent of the force beyond which a law has no tail: of the stiffness of a particle less than 1e-8 lies beyond `TAIL`."""
STEP = 2e-3
"""Step of the wavevector in rad per shortest bond for the derivative of a Bloch matrix, right to 1e-10 of the largest entry."""
MOST_BONDS = 300_000  # largest number of bonds of one cell in a lattice sum
PART = dict(zip(MODELS, ('all', 'D0'), strict=True))


class AllNeighbours(Repulsion):
    """Repulsion of all particles of an infinite lattice, whatever their distance, with foundation springs.

    It replaces `PairCalculator` for periodic cells and long-range laws, with the sums of `magphonon.stiffness.ewald`: bands,
    speeds of sound and phonopy's finite displacements work with both calculators.  The energy is the absolute energy of one
    cell.  If the sum over all neighbours diverges (r^-s with s <= d in d dimensions, such as Coulomb's), it includes a uniform
    neutralising background; for s = d the zero of the energy is arbitrary.

    Parameters
    ----------
    reference : ase.Atoms
        One cell, periodic in one to three directions; its positions are the anchors of the foundation.
    law : PairLaw
        InversePower with a > 1, Yukawa, or another law with a Gaussian expansion; or a law that is an inverse power far away,
        such as that of magnets.
    foundation : float or array_like, shape (particles,), (1, dim) or (particles, dim)
        Stiffness of the spring between each particle and its rest position, N/mm; with three components the particles of a
        plane can also move out of it.
    strengths : array_like, shape (particles,), optional
        Strength s of each particle, by default 1: two particles repel by `s_i s_j phi(r)`.
    split : float
        Parameter that divides the sums between lattice and reciprocal lattice; the results do not depend on it.

    Examples
    --------
    >>> from magphonon import InversePower, lattices
    >>> from magphonon.bands import sound_speeds
    >>> from magphonon.stiffness import AllNeighbours
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = AllNeighbours(cell, InversePower(1.0, 4.0))  # dipoles
    >>> shear, longitudinal = sound_speeds(cell)
    >>> round(float(longitudinal / shear), 10)  # the root of 11
    3.3166247904
    """

    implemented_properties: ClassVar[list[str]] = ['energy', 'free_energy', 'forces']
    default_parameters: ClassVar = {'foundation': 0.0}
    saved: ClassVar[tuple[str, ...]] = ('foundation', 'strengths', 'split')
    seldom: ClassVar[tuple[str, ...]] = ('dim',)
    pairwise = False
    atoms: Any  # of ASE, which declares them as None
    parameters: Any
    model = 'complete'

    def __init__(self, reference: Atoms, law: PairLaw, *, foundation: Foundation | ArrayLike = 0.0,
                 strengths: ArrayLike | None = None, split: float = 1.0, dim: int | None = None) -> None:
        if not reference.pbc.any():
            raise ValueError('the structure is not periodic, so its neighbours are finite in number; use PairCalculator')
        tail = tail_of(law, reference)
        if tail is None:
            raise ValueError('the sum over all neighbours is known for inverse powers, Yukawa repulsion and laws that become an '
                             f'inverse power, not for {type(law).__name__}; choose a number of shells')
        if tail.decay <= 0:
            raise ValueError(f'the force r^-{tail.decay + 1:g} has no energy r^-s with s = a - 1 > 0 to sum over all '
                             'neighbours; choose a > 1, or a number of shells')
        self.reference = reference.copy()
        self.reference.calc = None
        self._laws = law
        self.dim = displacement_components(reference, foundation, dim)
        self._sites = Sites(strengths, foundation=foundation).checked(self.reference, self.dim)
        for k in np.flatnonzero(self.strengths < 0)[:1]:
            raise ValueError(f'strengths[{k}] = {self.strengths[k]:g}: the sum over all neighbours supports repulsion only; '
                             'choose a number of shells for particles of both signs')
        z = np.append(reference.positions[:, 2] - reference.positions[0, 2], reference.cell.array[reference.pbc, 2])
        if self.dim == 2 and z.any():
            raise ValueError(f'planar particles must share one z, not differ by {abs(z).max():g} mm, periodic images included; '
                             'a structure in space is periodic along three vectors')
        super().__init__()
        self.parameters.foundation = self._sites.foundation
        self.sums = EwaldSums(reference.cell.array[reference.pbc][:, : self.dim], tail, split)
        self._nearer = None if tail is law else LawDifference(law, tail, TAIL * nearest_distance(reference))
        self._radius = self.sums.radius if self._nearer is None else max(self.sums.radius, self._nearer.end)
        self.bonds = bonds_within(self.reference, self._radius)
        i, j = self.bonds.i, self.bonds.j
        self.interaction = Central(laid((law,), np.zeros(len(i), int), self.strengths[i] * self.strengths[j]))
        warn_of_units(self)

    @property
    def bloch_models(self) -> tuple[str, ...]:
        """Models that have a Bloch matrix; in three-dimensional Coulomb crystals the separate sums of D0 and D* diverge."""
        return MODELS if self.sums.splits else MODELS[:1]

    @property
    def split(self) -> float:
        """The parameter that divides the sums between lattice and reciprocal lattice."""
        return self.sums.split

    def __repr__(self) -> str:
        return (f'{type(self).__name__}({self.laws!r}, foundation={range_of(self.foundation)}) of {len(self.reference)} '
                'particles per cell')

    def changed(self, reference: Atoms | None = None, bonds: Bonds | None = None, sites: Sites | None = None, *,
                laws: Any = None, model: Model | None = None, dim: int | None = None) -> AllNeighbours:
        """A calculator with another reference, other sites or another law, from which its bonds follow."""
        own = self.sites if sites is None else sites
        return AllNeighbours(self.reference if reference is None else reference, self.laws if laws is None else laws,
                             foundation=own.foundation, strengths=own.strengths, split=self.split, dim=dim or self.dim)

    def on(self, supercell: Atoms) -> AllNeighbours:
        """The same calculator on a supercell of its reference."""
        alike = np.ndim(self.foundation) == 0 and not np.ptp(self.strengths)
        return self.changed(supercell, sites=self.sites[np.zeros(len(supercell), int) if alike else
                                                        image_of(self.reference, supercell)])

    def displacements(self, atoms: Atoms) -> NDArray[np.float64]:
        """Displacements from rest in mm, shape (particles, dim), by minimum image."""
        u = find_mic(from_reference(self, atoms), atoms.cell, atoms.pbc)[0]  # pyright: ignore[reportArgumentType]  three pbc
        return u[:, : self.dim]

    def answers(self, atoms: Atoms, properties: Any) -> dict[str, Any]:
        k, u, n = self.foundation, self.displacements(atoms), len(atoms)
        if self.dim == 2:
            refuse_motion_out_of_the_plane(self, atoms)
        flat = atoms.copy()
        flat.positions[:, self.dim :] = self.reference.positions[:, self.dim :]  # no force acts along z
        bonds = bonds_within(flat, self._radius)
        x = bonds.vectors[:, : self.dim]
        s = self.strengths
        phi, slope = self.sums.near_energy(bonds.lengths)
        if self._nearer is not None:
            phi, slope = phi + self._nearer.phi(bonds.lengths), slope + self._nearer.dphi(bonds.lengths) / bonds.lengths
        phi, slope = s[bonds.i] * s[bonds.j] * phi, s[bonds.i] * s[bonds.j] * slope
        pull = slope[:, None] * x  # grad phi, the force on i, and its opposite on j
        i, j = np.triu_indices(n)
        far, gradient = self.sums.far_energy((atoms.positions[j] - atoms.positions[i])[:, : self.dim])
        far, gradient = s[i] * s[j] * far, (s[i] * s[j])[:, None] * gradient
        energy = (phi.sum() + far @ np.where(i == j, 0.5, 1.0)
                  - (s**2).sum() / 2 * self.sums.wide_at_zero() + (k * u**2).sum() / 2)
        forces = np.zeros((n, 3))
        forces[:, : self.dim] -= k * u
        for ends, pulls in (((bonds.i, bonds.j), pull), ((i, j), gradient)):
            np.add.at(forces[:, : self.dim], ends[0], pulls)
            np.add.at(forces[:, : self.dim], ends[1], -pulls)
        return {'energy': energy, 'free_energy': energy, 'forces': forces}

    def _offsets(self):
        """Vectors from particle i to j in the cell, shape (particles * particles, dim)."""
        r = self.reference.positions[:, : self.dim]
        return (r - r[:, None]).reshape(-1, self.dim)

    def _near(self, part):
        """Stiffness of the nearest pairs, shape (bonds, dim, dim)."""
        strength, x = self.strengths[self.bonds.i] * self.strengths[self.bonds.j], self.bonds.vectors[:, : self.dim]
        K = self.sums.near_stiffness(x, part)
        if self._nearer is not None:
            D0, Dstar = bond_stiffness(x, self._nearer)
            K = K + (D0 if part == 'D0' else D0 + Dstar)
        return strength[:, None, None] * K

    def _weighted(self, T):
        """Far stiffness between particles i and j times their strengths, shape (..., particles * particles, dim, dim)."""
        return np.outer(self.strengths, self.strengths).reshape(-1, 1, 1) * T

    def _assembled(self, T, onsite):
        """Matrix with the blocks -T between i and j, and `onsite` on i."""
        n = len(self.reference)
        D = -T.reshape(-1, n, n, self.dim, self.dim).swapaxes(2, 3)
        D[:, np.arange(n), :, np.arange(n)] += onsite[:, None]
        return D.reshape(-1, n * self.dim, n * self.dim)

    def _far_onsite(self, part):
        at_zero = self.sums.far_stiffness(self.sums.waves(np.zeros((1, self.sums.d))), self._offsets(), part)
        return self._weighted(at_zero).reshape(len(self.reference), -1, self.dim, self.dim).sum(axis=1)

    def bloch_matrix(self, q: NDArray[np.float64], model: Model | None = None) -> NDArray[np.complex128]:
        """Bloch matrix with the foundation, as `matrices.bloch_matrix`: shape (wavevectors, particles * dim, particles * dim).

        At k = 0 the lattice moves together with its neutralising background.
        """
        part = PART[one_of('model', model or self.model, MODELS)]
        D = bloch_matrix(self.bonds, self._near(part), q, self.foundation)
        onsite, offsets = self._far_onsite(part), self._offsets()
        for few in np.array_split(np.arange(len(q)), -(-len(q) // 32)):
            T = self.sums.far_stiffness(self.sums.waves(q[few][:, self.reference.pbc]), offsets, part)
            D[few] += self._assembled(self._weighted(T), onsite)
        return D

    def bloch_gradient(self, q: NDArray[np.float64], model: Model | None = None) -> NDArray[np.complex128]:
        """The derivative of the Bloch matrix with respect to the wavevector, from differences of fourth order."""
        h = STEP / self.bonds.shortest
        steps = h / (2 * np.pi) * (self.reference.cell.array.T * self.reference.pbc)[: self.dim]  # one along each axis
        near, far = (np.array([self.bloch_matrix(q + n * k, model) - self.bloch_matrix(q - n * k, model) for k in steps])
                     for n in (1, 2))
        return (8 * near - far) / (12 * h)

    def bloch_series(self, along: NDArray[np.float64],
                     model: Model | None = None) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
        """Bloch matrix to second order in k `along`, as `stiffness.bloch_series`, without the terms given by `singular`."""
        part, x = PART[one_of('model', model or self.model, MODELS)], self.bonds.vectors[:, : self.dim]
        near = bloch_series(self.bonds, self._near(part), x @ along)
        onsite = self._far_onsite(part)
        far = self._weighted(self.sums.far_series(along, self._offsets(), part))
        return tuple(near[k] + self._assembled(far[k], onsite * (k == 0))[0] for k in range(3))

    def singular(self, along: NDArray[np.float64], model: Model | None = None) -> NDArray[np.float64]:
        """The part of the Bloch matrix that exceeds k^2 in long waves; see `EwaldSums.singular`."""
        return self.sums.singular(along, PART[one_of('model', model or self.model, MODELS)])


@dataclass(frozen=True)
class LawDifference(Composed):
    """A law minus its tail, up to the distance `end` in mm, where both have the same force and slope; zero beyond."""

    law: PairLaw
    tail: PairLaw
    end: float

    def _part(self, name, r):
        law, tail = getattr(self.law, name), getattr(self.tail, name)
        at_end = law(self.end) - tail(self.end) if name == 'phi' else 0.0
        return np.where(r < self.end, law(r) - tail(r) - at_end, 0.0)


def nearest_distance(atoms: Atoms) -> float:
    """Distance in mm between the two nearest particles of a structure."""
    own = np.concatenate([atoms.positions[1:] - atoms.positions[0], atoms.cell.array[atoms.pbc]])
    return float(distances_within(atoms, np.linalg.norm(own, axis=1).min() * (1 + 1e-9)).min())


def tail_of(law: PairLaw, atoms: Atoms) -> GaussianMixture | None:
    """The law itself if it is a mixture of Gaussians, or the inverse power with its force and slope at `TAIL` spacings.

    None if the law is not known at that distance, or if its repulsion there is zero or negligible, so that no tail is needed.
    """
    if isinstance(law, GaussianMixture):
        return law
    r = TAIL * nearest_distance(atoms)
    try:
        force, a = -float(law.dphi(r)), float(local_exponent(law, r)) if law.dphi(r) else np.inf
    except (AttributeError, ValueError):
        return None
    return InversePower(force * r**a, a) if force > 0 and a < STEEPEST_TAIL else None
