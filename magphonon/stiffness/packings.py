"""Packings of soft spheres at a given pressure: disordered solids, in which each contact pushes at rest.

The enthalpy `U + p V` of overlapping spheres (`magphonon.interactions.Overlap`) is minimised over their positions and over the
shape of the periodic cell, so that the stress is -p times the unit matrix.  The minimiser is FIRE (Bitzek et al., Phys. Rev.
Lett. 97, 170201, 2006), on a ladder of pressures from dense to loose; the Newton steps of `relaxed` follow.  Spheres that nothing
holds, the rattlers, leave once all forces balance: those with at most as many contacts as dimensions that feel next to no force,
again and again.  Frozen earlier they would be wedges that still push.

In a packing D* is a ten-thousandth of D0 in each contact, and takes half of the shear modulus: A. J. Liu and S. R. Nagel, Annu.
Rev. Condens. Matter Phys. 1, 347 (2010), for the physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator, all_changes
from numba import njit
from numpy.typing import ArrayLike
from tqdm import tqdm

from ..errors import Unstable, finite, one_of, positive, whole
from ..interactions.pair_laws import Overlap
from ..lattices.bonds import Bonds, lengths_of, pairs_within, vectors_between
from .calculator import PairCalculator, measure
from .elastic import internal_strain
from .relaxation import relaxed
from .repulsion import repulsion_of

BALL = {2: np.pi, 3: 4 / 3 * np.pi}  # of radius 1
DENSE = {2: 0.9, 3: 0.7}
"""Share of the space that the spheres fill at random at first, by the number of dimensions."""
FIRST, RUNG = 0.1, np.sqrt(10)
"""First pressure of the ladder, in energies of a contact per cube (square) of the mean diameter, and ratio of two of them."""
BALANCE, PASSING = 1e-7, 1e-2
"""Largest forces that are left, as fractions of the pressure: where Newton's steps take over, and at pressures on the way."""
IDLE = 0.05  # largest force on a rattler, as a fraction of the pressure
STEP = 1.0  # longest of FIRE; the limit is the root of two
LONE = 0.1  # least mass of a sphere without neighbours, as a fraction of the mean
SKIN = 0.15  # distance beyond the contact up to which near pairs are listed, in sums of radii
STEPS = 400_000  # most steps of FIRE for one balance


@dataclass(frozen=True, eq=False)
class Packing:
    """A packing at rest.

    Attributes
    ----------
    atoms : ase.Atoms
        The spheres that hold each other, with a PairCalculator of their contacts.
    pressure : float
        In N/mm in the plane, N/mm^2 in space.
    residual : float
        Largest force on a sphere, as a fraction of the pressure times the mean diameter (times its square in space). Rounded
        positions leave about forty of their spacings times the stiffness of a contact.
    every : ase.Atoms
        All spheres, rattlers too.
    radii : ndarray, shape (all spheres,)
        In mm.
    held : ndarray of bool, shape (all spheres,)
        Which are in `atoms`.
    """

    atoms: Atoms
    pressure: float
    residual: float
    every: Atoms
    radii: np.ndarray
    held: np.ndarray

    @property
    def rattlers(self) -> int:
        """Number of spheres that nothing holds."""
        return int((~self.held).sum())

    @property
    def contacts(self) -> int:
        """Number of contacts that push."""
        return int(np.count_nonzero(self.atoms.calc.law.dphi(self.atoms.calc.bonds.lengths)))

    @property
    def excess(self) -> int:
        """Contacts beyond the fewest that can hold the spheres and the shape of their cell (isostatic); never negative."""
        dim = self.atoms.calc.dim
        return self.contacts - (dim * (len(self.atoms) - 1) + dim * (dim + 1) // 2)

    @property
    def fraction(self) -> float:
        """Share of the space that all spheres fill, overlaps counted twice."""
        dim = self.atoms.calc.dim
        return float(BALL[dim] * (self.radii**dim).sum() / measure(self.every))

    @cached_property
    def linear_strain(self) -> float:
        """Shear strain in the x-y plane, of either sign, up to which no contact opens or closes, as far as linear motion tells.

        Moduli, modes and responses are those of the contacts at rest, and hold only up to there.
        """
        atoms, calc = self.atoms, self.atoms.calc
        shear = np.zeros((calc.dim, calc.dim))
        shear[0, 1] = shear[1, 0] = 0.5
        i, j, shift, touching, _ = near_pairs(atoms, self.radii[self.held], calc.laws, SKIN)
        R = vectors_between(atoms, i, j, shift)[:, : calc.dim]
        r, u = lengths_of(R), internal_strain(atoms) @ shear.ravel()
        rate = ((R @ shear + u[j] - u[i]) * R).sum(axis=1) / r
        return float((abs(r - touching) / abs(rate)).min())

    def at(self, pressure: float) -> Packing:
        """The packing that this one becomes at another pressure, in the same unit."""
        return _packed(self.every, self.radii, self.atoms.calc.laws,
                       _ladder(self.pressure, positive('pressure', pressure))[1:])

    def __str__(self) -> str:
        return (f'{len(self.atoms)} spheres with {self.contacts} contacts, {self.excess} more than the fewest, and '
                f'{self.rattlers} rattlers, at the pressure {self.pressure:.4g}; forces balance to {self.residual:.1g} of '
                f'it, and the first contact opens or closes at a shear strain of {self.linear_strain:.1g}')


def packing(radii: ArrayLike, pressure: float, law: Overlap, seed: int = 0, dim: int = 2) -> Packing:
    """Soft spheres, or discs in the plane, packed from random positions.

    Parameters
    ----------
    radii : array_like, shape (spheres,)
        In mm.  Discs of one size crystallise: take two, 1 and 1.4.
    pressure : float
        In N/mm in the plane, N/mm^2 in space.
    law : Overlap
        With elastic=True the energy of a contact depends on both radii.
    seed : int
        Of the random positions.
    dim : {2, 3}

    Returns
    -------
    Packing
        Its atoms have unit masses, symbols X and the calculator.

    Raises
    ------
    Unstable
        If the forces do not balance within `STEPS` steps, as at pressures below 1e-7 of an energy per diameter squared.
    ValueError
        If an argument is out of range, or a sphere is so large that it touches its own image.

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon.interactions import Overlap
    >>> from magphonon.stiffness import packing
    >>> discs = packing(np.where(np.arange(64) % 2, 0.5, 0.7), 1e-2, Overlap(1.0), seed=1)
    >>> discs.excess >= 0, bool(discs.residual < 1e-10)
    (True, True)
    """
    radii, pressure = finite('radii', radii), positive('pressure', pressure)
    if not isinstance(law, Overlap) or law.diameter != 1 or law.power < 2:
        raise ValueError('law must be an Overlap of the distance over the sum of both radii, with diameter 1 and a power of at '
                         f'least 2, below which a contact that opens is infinitely stiff, not {law!r}')
    positive('the smallest of the radii', radii.min(initial=np.inf), 'mm')
    if radii.ndim != 1 or len(radii) < 2**one_of('dim', dim, (2, 3)) * 4:
        raise ValueError(f'radii must be a list of at least {2**dim * 4} numbers, not of the shape {radii.shape}')
    rng, D = np.random.default_rng(whole('seed', seed, least=0)), 2 * radii.mean()
    L = (BALL[dim] * (radii**dim).sum() / DENSE[dim]) ** (1 / dim)
    atoms = Atoms(np.zeros(len(radii)), np.zeros((len(radii), 3)), cell=[L, L, L if dim == 3 else D], pbc=(True, True, dim == 3),
                  masses=np.ones(len(radii)))
    atoms.positions[:, :dim] = L * rng.random((len(radii), dim))
    first = FIRST * law.energy * law.between(D / 2, D / 2) / D**dim
    return _packed(atoms, radii, law, _ladder(max(first, pressure), pressure))


def _ladder(first, last):
    """Pressures from the first to the last one, in equal ratios of at most `RUNG`."""
    return np.geomspace(first, last, 1 + max(1, round(np.ceil(abs(np.log(last / first)) / np.log(RUNG) - 1e-9))))


def _packed(every, radii, law, pressures):
    """The packing at the last of some pressures, which are taken in turn, from the positions and the cell of `every`."""
    every, held, idle = every.copy(), np.ones(len(radii), bool), np.ones(len(radii), bool)
    for pressure in tqdm(pressures, desc='pressures', delay=2, disable=None, leave=False):
        _balance(every, held, radii, law, pressure, PASSING)
    dim = int(every.pbc.sum())
    push = pressure * (2 * radii.mean()) ** (dim - 1)
    while idle.any():
        _balance(every, held, radii, law, pressure, BALANCE)
        idle = np.zeros(len(held), bool)
        idle[held] = _idle(every[held], radii[held], law, IDLE * push)
        held &= ~idle
    atoms = every[held]
    i, j, shift, *_ = near_pairs(atoms, radii[held], law)
    if (i == j).any():
        raise ValueError(f'the sphere with a radius of {radii[held][i[i == j]].max():g} mm touches its own image: add spheres, '
                         'make it smaller, or lower the pressure')
    bonds = Bonds(i, j, shift, vectors_between(atoms, i, j, shift), len(atoms))
    atoms.calc = PairCalculator(atoms, law, radii=radii[held], dim=dim, bonds=bonds)
    atoms = relaxed(atoms).atoms  # by Newton's steps, in the cell that was found
    every.positions[held] = atoms.positions
    return Packing(atoms, float(pressure), float(lengths_of(atoms.get_forces()).max() / push), every, radii, held)


def near_pairs(atoms, radii, law, skin=0.0):
    """Spheres nearer than `1 + skin` times the sum of both radii: i, j, the cell of j, this sum, and the strength of the law."""
    i, j, shift, R = pairs_within(atoms, 2 * radii.max() * (1 + skin))
    near = lengths_of(R) < (1 + skin) * (radii[i] + radii[j])
    i, j = i[near], j[near]
    return i, j, shift[near], radii[i] + radii[j], law.between(radii[i], radii[j])


def _balance(atoms, held, radii, law, pressure, least):
    """Move the spheres by FIRE until the forces are below a fraction of the pressure; those that are not held follow the cell."""
    some, radii, flat = atoms[held], radii[held], np.diag(atoms.pbc.astype(float))
    n, push, wall = len(some), pressure * (2 * radii.mean()) ** (flat.trace() - 1), measure(some) / some.get_volume() * flat
    x = first = np.vstack([some.positions, some.cell.array])
    v, F, dt, mixed, downhill = np.zeros_like(x), np.zeros_like(x), STEP / 8, 0.1, 0
    for step in range(STEPS):
        if not step or (step % 5 == 0 and _strayed(x, first, radii.min()) > 0.45 * SKIN):
            some.set_cell(x[n:])
            some.positions, first = x[:n], x
            (i, j, touching, energies), shift, root = _near(some, radii, law, pressure)
        forces(x, shift @ x[n:], i, j, touching, energies, law.power, F)
        F[n:] -= pressure * abs(np.linalg.det(x[n:])) * wall
        F /= root
        if np.abs(F).max() < least * push / np.sqrt((root[:n] ** 2).mean()):
            break
        if np.vdot(F, v) > 0:
            v += mixed * (np.linalg.norm(v) / np.linalg.norm(F) * F - v)
            downhill += 1
            if downhill > 5:
                dt, mixed = min(1.1 * dt, STEP), 0.99 * mixed
        else:
            v[:] = 0
            dt, mixed, downhill = 0.5 * dt, 0.1, 0
        v += dt * F
        moved = dt * v / root
        x = np.vstack([x[:n] + moved[:n], x[n:]]) @ (np.eye(3) + moved[n:])
    else:
        raise Unstable(f'the spheres did not come to rest within {STEPS} steps at this pressure: take a higher one, or '
                       'approach it by steps, packing(...).at(pressure)')
    atoms.set_cell(x[n:], scale_atoms=True)
    atoms.positions[held] = x[:n]


def _near(atoms, radii, law, pressure):
    """Near pairs for `forces`, the cells of j, and the root of the masses, shape (spheres + 3, 1), the last of them of the cell.

    A mass is the stiffness of all near pairs of a sphere, by the overlap that the pressure makes.  Then no frequency of springs
    is above the root of two (Gershgorin), however large a sphere and however many its contacts.
    """
    n, D, dim = len(radii), 2 * radii.mean(), atoms.pbc.sum()
    i, j, shift, touching, strength = near_pairs(atoms, radii, law, SKIN)
    overlap = (pressure * D**dim / law.energy / law.between(D / 2, D / 2)) ** (1 / (law.power - 1))
    k = (law.power - 1) * law.energy * strength * overlap ** (law.power - 2) / touching**2
    masses = np.bincount(i, k, n) + np.bincount(j, k, n)
    masses = np.append(np.maximum(masses, LONE * masses.mean()), 3 * [n * D**2 * masses.mean()])
    pairs = i.astype(np.uint32), j.astype(np.uint32), touching, law.energy * strength  # indices that are never negative are fast
    return pairs, shift.astype(float), np.sqrt(masses)[:, None]


def _strayed(x, first, radius):
    """How far the spheres have moved past the cell since `first`, over a radius, or how far the cell is strained."""
    followed = np.linalg.solve(first[-3:], x[-3:])
    return max(lengths_of(x[:-3] - first[:-3] @ followed).max() / radius, np.linalg.norm(followed - np.eye(3)))


def _idle(atoms, radii, law, most):
    """Spheres that nothing holds: at most as many contacts as dimensions, and forces below `most`; shape (spheres,)."""
    i, j, shift, touching, strength = near_pairs(atoms, radii, law)
    force = -strength * law.dphi(lengths_of(vectors_between(atoms, i, j, shift)) / touching) / touching
    ends, largest = np.concatenate([i, j]), np.zeros(len(atoms))
    np.maximum.at(largest, ends, np.tile(force, 2))
    return (np.bincount(ends, minlength=len(atoms)) <= atoms.pbc.sum()) & (largest < most)


@njit(cache=True, error_model='numpy')
def forces(x, across, i, j, D, energy, power, F):
    """Forces on the spheres, `energy/D (1 - r/D)^(power - 1)` where r < D, and in the last rows of F their moments, `f R`; a
    pair is joined by the vector `x_j + across - x_i`.
    """
    F[:] = 0
    place, force, moment = x[:-3], F[:-3], F[-3:]
    for b in range(len(i)):
        at, to, cell = place[i[b]], place[j[b]], across[b]
        R = to[0] + cell[0] - at[0], to[1] + cell[1] - at[1], to[2] + cell[2] - at[2]
        square = R[0] ** 2 + R[1] ** 2 + R[2] ** 2
        if square < D[b] ** 2:
            r = np.sqrt(square)
            overlap = 1 - r / D[b]
            f = energy[b] * (overlap if power == 2 else overlap ** (power - 1)) / D[b] / r
            for k in range(3):
                force[j[b], k] += f * R[k]
                force[i[b], k] -= f * R[k]
                for m in range(3):
                    moment[k, m] += f * R[k] * R[m]


class Following(Calculator):
    """Forces of contacts that open and close, for ASE's own dynamics: near pairs, listed anew once a sphere has moved far enough.

    A PairCalculator keeps the contacts that it was given, which is right for small motion only: later spheres would pass through
    each other.  There is no stiffness here, and no conventional model, which has no meaning for a new contact.

    Parameters
    ----------
    atoms : ase.Atoms
        With the PairCalculator of a packing: its law and its radii.

    Examples
    --------
    >>> from ase.md.verlet import VelocityVerlet
    >>> from magphonon.interactions import Overlap
    >>> from magphonon.stiffness import Following, packing
    >>> atoms = packing([0.5, 0.7] * 16, 1e-2, Overlap(1.0)).atoms
    >>> atoms.calc = Following(atoms)
    >>> atoms.positions[0, 0] += 0.1
    >>> energy = atoms.get_total_energy()
    >>> done = VelocityVerlet(atoms, 0.05).run(200)
    >>> bool(abs(atoms.get_total_energy() - energy) < 1e-3 * energy)
    True
    """

    implemented_properties: ClassVar[list[str]] = ['energy', 'forces']

    def __init__(self, atoms: Atoms) -> None:
        super().__init__()
        calc: Any = repulsion_of(atoms)
        if not isinstance(calc.laws, Overlap) or calc.laws.diameter != 1 or calc.sites.radii is None:
            raise ValueError('contacts are followed between spheres with the law Overlap, of diameter 1, and radii: give the '
                             f'calculator radii=, or keep it as it is; it is {calc!r}')
        if calc.tied or calc.load.any() or (calc.strengths != 1).any() or np.any(calc.gyration) or calc.model != 'complete':
            raise ValueError('contacts are followed without a foundation, a load, strengths and gyration, in the complete model: '
                             f'keep the calculator as it is, {calc!r}')
        self._law, self._radii = calc.laws, calc.sites.radii
        self._listed: Any = 0, None  # positions, cell and pairs of the last list

    def calculate(self, atoms: Atoms | None = None, properties: Sequence[str] = ('energy',),
                  system_changes: Sequence[str] = tuple(all_changes)) -> None:
        super().calculate(atoms, properties, system_changes)
        here: Any = self.atoms
        if len(here) != len(self._radii):
            raise ValueError(f'there are {len(self._radii)} spheres, and these atoms are {len(here)}')
        x, (at, cell, *pairs) = here.positions, self._listed
        if not np.array_equal(here.cell.array, cell) or (
                2 * lengths_of(x - at).max() > SKIN * self._radii.min()):
            pairs = near_pairs(here, self._radii, self._law, SKIN)
            self._listed = x.copy(), here.cell.array.copy(), *pairs
        i, j, shift, touching, strength = pairs
        R = vectors_between(here, i, j, shift)
        r = lengths_of(R)
        pull = (strength * self._law.dphi(r / touching) / touching / r)[:, None] * R
        forces = np.zeros_like(x)
        np.add.at(forces, i, pull)
        np.subtract.at(forces, j, pull)
        self.results = {'energy': float((strength * self._law.phi(r / touching)).sum()), 'forces': forces}
