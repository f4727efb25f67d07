"""Packings of soft spheres at a given pressure: disordered solids, in which each contact pushes at rest.

The enthalpy `U + p V` of overlapping spheres (`magphonon.interactions.Overlap`) is minimised over their positions and over the
shape of the periodic cell, so that the stress is -p times the unit matrix.  The minimiser is FIRE (Bitzek et al., Phys. Rev.
Lett. 97, 170201, 2006), on a ladder of pressures from dense to loose; the Newton steps of `relaxed` follow.  Spheres that nothing
holds, the rattlers, leave the packing: once all forces balance, those go that have at most as many contacts as dimensions and
feel next to no force, again and again.  Frozen earlier they would be wedges that still push; kept, they would roam.

In a packing D* is a ten-thousandth of D0 in each contact, and takes half of the shear modulus: A. J. Liu and S. R. Nagel, Annu.
Rev. Condens. Matter Phys. 1, 347 (2010), for the physics.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
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
BALANCES = 1e-6, 1e-7
"""Largest forces that are left, as fractions of the pressure: after each the rattlers leave.  Newton's steps need the last."""
IDLE = 0.05  # largest force on a rattler, as a fraction of the pressure
SKIN = 0.15  # distance beyond the contact up to which near pairs are listed, in sums of radii
STEPS = 400_000  # of FIRE for one balance


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
        If an argument is out of range.

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
    if not isinstance(law, Overlap) or law.diameter != 1:
        raise ValueError(f'law must be an Overlap of the distance over the sum of both radii, with diameter 1, not {law!r}')
    positive('the smallest of the radii', radii.min(initial=np.inf), 'mm')
    if radii.ndim != 1 or len(radii) < 2**one_of('dim', dim, (2, 3)) * 4:
        raise ValueError(f'radii must be a list of at least {2**dim * 4} numbers, not of the shape {radii.shape}: a sphere must '
                         'not touch itself')
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
    D, dim, held = 2 * radii.mean(), int(every.pbc.sum()), np.ones(len(radii), bool)
    unit = law.energy * law.between(D / 2, D / 2)  # below, lengths are in mean diameters and energies in those of a contact
    small, law_in_units = every.copy(), replace(law, energy=1 / law.between(0.5, 0.5))
    small.set_cell(every.cell.array / D, scale_atoms=True)
    for pressure in tqdm(pressures, desc='pressures', delay=2, disable=None, leave=False):
        held[:] = True
        for balance in BALANCES:
            idle = held
            while idle.any():
                _descend(small, held, radii / D, law_in_units, pressure * D**dim / unit, balance)
                idle = np.zeros(len(held), bool)
                idle[held] = _idle(small[held], radii[held] / D, law_in_units, IDLE * pressure * D**dim / unit)
                held &= ~idle
    every = small
    every.set_cell(small.cell.array * D, scale_atoms=True)
    atoms = every[held]
    i, j, shift, *_ = near_pairs(atoms, radii[held], law)
    bonds = Bonds(i, j, shift, vectors_between(atoms, i, j, shift), len(atoms))
    atoms.calc = PairCalculator(atoms, law, radii=radii[held], dim=dim, bonds=bonds)
    atoms = relaxed(atoms).atoms  # by Newton's steps, in the cell that was found
    every.positions[held] = atoms.positions
    force = np.linalg.norm(atoms.get_forces(), axis=1).max() / (pressure * D ** (dim - 1))
    return Packing(atoms, float(pressure), float(force), every, radii, held)


def near_pairs(atoms, radii, law, skin=0.0):
    """Spheres nearer than `1 + skin` times the sum of both radii: i, j, the cell of j, this sum, and the strength of the law."""
    i, j, shift, r = pairs_within(atoms, 2 * radii.max() * (1 + skin))
    near = r < (1 + skin) * (radii[i] + radii[j])
    i, j = i[near], j[near]
    return i, j, shift[near], radii[i] + radii[j], law.between(radii[i], radii[j])


def _descend(atoms, held, radii, law, pressure, balance):
    """FIRE until the forces balance to a fraction of the pressure; spheres that are not held follow the cell."""
    dim, cell = int(atoms.pbc.sum()), atoms.cell.array.copy()
    x = np.vstack([atoms.positions[held, :dim], cell[:dim, :dim]])
    v, fire, left, balanced = np.zeros_like(x), np.array([0.05, 0.1, 0.0]), STEPS, False
    while not balanced:
        if left <= 0:
            raise Unstable(f'the spheres did not come to rest within {STEPS} steps at this pressure: take a higher one, or '
                           'approach it by steps, packing(...).at(pressure)')
        i, j, shift, touching, strength = near_pairs(atoms[held], radii[held], law, SKIN)
        done, balanced = descend(x, v, fire, i, j, shift[:, :dim].astype(float), touching, law.energy * strength, law.power,
                                 pressure, balance, left, 0.45 * SKIN * radii[held].min())
        cell[:dim, :dim] = x[-dim:]
        atoms.set_cell(cell, scale_atoms=True)
        atoms.positions[held, :dim] = x[:-dim]
        left -= done


def _idle(atoms, radii, law, most):
    """Spheres that nothing holds: at most as many contacts as dimensions, and forces below `most`; shape (spheres,)."""
    i, j, shift, touching, strength = near_pairs(atoms, radii, law)
    force = -strength * law.dphi(lengths_of(vectors_between(atoms, i, j, shift)) / touching) / touching
    ends, largest = np.concatenate([i, j]), np.zeros(len(atoms))
    np.maximum.at(largest, ends, np.tile(force, 2))
    return (np.bincount(ends, minlength=len(atoms)) <= atoms.pbc.sum()) & (largest < most)


def descend(x, v, fire, i, j, shift, D, energy, power, pressure, balance, steps, roam):
    """Steps of FIRE, until the forces balance or a sphere has moved by `roam` past the cell: their number, and whether they do.

    In mean diameters, energies of a contact and unit masses.  Positions `x` and velocities `v`, whose last rows are the cell and
    its strain rate, change in place; so does `fire`, the time step, the mixing and the number of steps downhill.  Pairs i, j,
    `shift` with the sums D of their radii and their energies act.
    """
    dim = x.shape[1]
    n, one, first, F = len(x) - dim, np.eye(dim), x.copy(), np.zeros_like(x)
    inertia = np.sqrt(n)  # of the cell, which is then about as stiff as a sphere
    for step in range(steps):
        forces(x, i, j, shift, D, energy, power, F)
        F[n:] = ((F[n:] + F[n:].T) / 2 - pressure * abs(np.linalg.det(x[n:])) * one) / inertia
        if np.abs(F).max() < balance * pressure:
            return step, True
        if np.vdot(F, v) > 0:
            v *= 1 - fire[1]
            v += fire[1] / (1 - fire[1]) * np.linalg.norm(v) / np.linalg.norm(F) * F
            fire[2] += 1
            if fire[2] > 5:
                fire[0], fire[1] = min(1.1 * fire[0], 0.4), 0.99 * fire[1]
        else:
            v[:] = 0
            fire[0], fire[1], fire[2] = 0.5 * fire[0], 0.1, 0
        v += fire[0] * F
        strained = one + fire[0] * v[n:] / inertia
        x[:n] += fire[0] * v[:n]
        x[:] = x @ strained
        if step % 5 == 0:
            followed = np.linalg.solve(first[n:], x[n:])
            far = np.sqrt(((x[:n] - first[:n] @ followed) ** 2).sum(axis=1).max())
            if far > roam or np.abs(followed - one).max() > roam / 4:
                return step + 1, False
    return steps, False


@njit(cache=True)
def forces(x, i, j, shift, D, energy, power, F):
    """Forces on the spheres, `energy/D (1 - r/D)^(power - 1)` where r < D, and in the last rows of F their moments, `f R`."""
    dim = x.shape[1]
    n, R = len(x) - dim, np.zeros(dim)
    F[:] = 0
    for b in range(len(i)):
        square = 0.0
        for k in range(dim):
            R[k] = x[j[b], k] - x[i[b], k]
            for m in range(dim):
                R[k] += shift[b, m] * x[n + m, k]
            square += R[k] ** 2
        if square >= D[b] ** 2:
            continue
        r = np.sqrt(square)
        overlap = 1 - r / D[b]
        f = energy[b] * (overlap if power == 2 else overlap ** (power - 1)) / D[b] / r
        for k in range(dim):
            F[j[b], k] += f * R[k]
            F[i[b], k] -= f * R[k]
            for m in range(dim):
                F[n + k, m] += f * R[k] * R[m]


class Following(Calculator):
    """Forces of contacts that open and close, for ASE's own dynamics: near pairs, listed anew once a sphere has moved far enough.

    A PairCalculator keeps the contacts that it was given, which is right for small motion only: later spheres would pass through
    each other.  There is no stiffness here, and no conventional model, which has no meaning for a new contact.

    Parameters
    ----------
    atoms : ase.Atoms
        With the PairCalculator of a packing: its law and its radii.
    skin : float
        Distance of pairs beyond their contact that are listed, as a fraction of the sum of their radii.

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

    def __init__(self, atoms: Atoms, skin: float = SKIN) -> None:
        super().__init__()
        calc: Any = repulsion_of(atoms)
        if not isinstance(calc.laws, Overlap) or calc.laws.diameter != 1 or calc.sites.radii is None:
            raise ValueError('contacts are followed between spheres with the law Overlap, of diameter 1, and radii: give the '
                             f'calculator radii=, or keep it as it is; it is {calc!r}')
        if calc.tied or calc.load.any() or (calc.strengths != 1).any() or np.any(calc.gyration) or calc.model != 'complete':
            raise ValueError('contacts are followed without a foundation, a load, strengths and gyration, in the complete model: '
                             f'keep the calculator as it is, {calc!r}')
        self._law, self._radii, self._skin = calc.laws, calc.sites.radii, positive('skin', skin)
        self._listed: Any = 0, None  # positions, cell and pairs of the last list

    def calculate(self, atoms: Atoms | None = None, properties: Sequence[str] = ('energy',),
                  system_changes: Sequence[str] = tuple(all_changes)) -> None:
        super().calculate(atoms, properties, system_changes)
        here: Any = self.atoms
        if len(here) != len(self._radii):
            raise ValueError(f'there are {len(self._radii)} spheres, and these atoms are {len(here)}')
        x, (at, cell, *pairs) = here.positions, self._listed
        if not np.array_equal(here.cell.array, cell) or (
                2 * np.linalg.norm(x - at, axis=1).max() > self._skin * self._radii.min()):
            pairs = near_pairs(here, self._radii, self._law, self._skin)
            self._listed = x.copy(), here.cell.array.copy(), *pairs
        i, j, shift, touching, strength = pairs
        R = vectors_between(here, i, j, shift)
        r = lengths_of(R)
        pull = (strength * self._law.dphi(r / touching) / touching / r)[:, None] * R
        forces = np.zeros_like(x)
        np.add.at(forces, i, pull)
        np.subtract.at(forces, j, pull)
        self.results = {'energy': float((strength * self._law.phi(r / touching)).sum()), 'forces': forces}
