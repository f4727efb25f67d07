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
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator, all_changes
from numba import njit
from numpy.typing import ArrayLike
from tqdm import tqdm

from ..errors import Unstable, finite, one_of, positive, whole
from ..interactions.pair_laws import Overlap
from ..lattices.bonds import Bonds, pairs_within, vectors_between
from .calculator import PairCalculator, measure
from .relaxation import relaxed
from .repulsion import repulsion_of

DENSE = {2: 0.9, 3: 0.7}
"""Share of the space that the spheres fill at random at first, by the number of dimensions."""
FIRST, RUNG = 0.1, np.sqrt(10)
"""First pressure of the ladder, in energies of a contact per cube (square) of the mean diameter, and ratio of two of them."""
BALANCES = 1e-6, 1e-7
"""Largest forces that are left, as fractions of the pressure: after each the rattlers leave.  Newton's steps need the last."""
IDLE = 0.05  # largest force on a rattler, as a fraction of the pressure
SKIN = 0.25, 0.12
"""Distance, in sums of radii, up to which near pairs are listed: at first, and when spheres no longer flow."""
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
        return len(self.atoms.calc.bonds)

    @property
    def excess(self) -> int:
        """Contacts beyond the fewest that can hold the spheres and the shape of their cell (isostatic); never negative."""
        dim = self.atoms.calc.dim
        return self.contacts - (dim * (len(self.atoms) - 1) + dim * (dim + 1) // 2)

    @property
    def fraction(self) -> float:
        """Share of the space that all spheres fill, overlaps counted twice."""
        volumes = np.pi * self.radii**2 if self.atoms.calc.dim == 2 else 4 / 3 * np.pi * self.radii**3
        return float(volumes.sum() / measure(self.every))

    def at(self, pressure: float) -> Packing:
        """The packing that this one becomes at another pressure, in the same unit."""
        calc = self.atoms.calc
        return _packed(self.every, self.radii, calc.laws, calc.dim, _ladder(self.pressure, positive('pressure', pressure))[1:])

    def __str__(self) -> str:
        return (f'{len(self.atoms)} spheres with {self.contacts} contacts, {self.excess} more than the fewest, and '
                f'{self.rattlers} rattlers, at the pressure {self.pressure:.4g}; forces balance to {self.residual:.1g} of it')


def packing(radii: ArrayLike, pressure: float, law: Overlap, seed: int = 0, dim: int = 2) -> Packing:
    """Soft spheres, or discs in the plane, packed from random positions.

    Parameters
    ----------
    radii : array_like, shape (spheres,)
        In mm.  Discs of one size crystallise: take two, 1 and 1.4.
    pressure : float
        In N/mm in the plane, N/mm^2 in space.
    law : Overlap
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
    positive('the smallest of the radii', radii.min(initial=np.inf), 'mm')
    if radii.ndim != 1 or len(radii) < 2**one_of('dim', dim, (2, 3)) * 4:
        raise ValueError(f'radii must be a list of at least {2**dim * 4} numbers, not of the shape {radii.shape}: a sphere must '
                         'not touch itself')
    rng, D = np.random.default_rng(whole('seed', seed, least=0)), 2 * radii.mean()
    volumes = np.pi * radii**2 if dim == 2 else 4 / 3 * np.pi * radii**3
    L = (volumes.sum() / DENSE[dim]) ** (1 / dim)
    atoms = Atoms(np.zeros(len(radii)), np.zeros((len(radii), 3)), cell=[L, L, L if dim == 3 else D], pbc=(True, True, dim == 3),
                  masses=np.ones(len(radii)))
    atoms.positions[:, :dim] = L * rng.random((len(radii), dim))
    return _packed(atoms, radii, law, dim, _ladder(max(FIRST * law.energy / D**dim, pressure), pressure))


def _ladder(first, last):
    """Pressures from the first to the last one, in equal ratios of at most `RUNG`."""
    return np.geomspace(first, last, 1 + max(1, round(np.ceil(abs(np.log(last / first)) / np.log(RUNG) - 1e-9))))


def _packed(atoms, radii, law, dim, pressures):
    """The packing at the last of some pressures, which are taken in turn."""
    D, held = 2 * radii.mean(), np.ones(len(radii), bool)
    state = _Spheres(atoms.positions[:, :dim] / D, atoms.cell.array[:dim, :dim] / D, radii / D, law.power)
    for pressure in tqdm(pressures, desc='pressures', delay=2, disable=None, leave=False):
        held[:] = True
        for balance in BALANCES:
            while True:
                state.descend(held, pressure * D**dim / law.energy, balance)
                idle = state.idle(held, IDLE * pressure * D**dim / law.energy)
                if not idle.any():
                    break
                held &= ~idle
    every = atoms.copy()
    every.cell[:dim, :dim] = D * state.cell
    every.positions[:, :dim] = D * state.x
    return _at_rest(every, radii, held, law, dim, float(pressures[-1]))


def _at_rest(every, radii, held, law, dim, pressure):
    """The spheres that hold each other with their contacts, after Newton's steps in the cell that was found."""
    atoms = every[held]
    i, j, shift, r = pairs_within(atoms, 2 * radii.max())
    near = r < radii[held][i] + radii[held][j]
    bonds = Bonds(i, j, shift, vectors_between(atoms, i, j, shift), len(atoms)).among(near)
    atoms.calc = PairCalculator(atoms, law, radii=radii[held], dim=dim, bonds=bonds)
    atoms = relaxed(atoms).atoms
    every.positions[held] = atoms.positions
    force = np.linalg.norm(atoms.get_forces(), axis=1).max() / (pressure * (2 * radii.mean()) ** (dim - 1))
    return Packing(atoms, pressure, float(force), every, radii, held)


class _Spheres:
    """Positions x and cell of spheres, in mean diameters, energies of a contact and unit masses; both move."""

    def __init__(self, x, cell, radii, power):
        self.x, self.cell, self.radii, self.power = x.copy(), cell.copy(), radii, power

    def near(self, held, skin):
        """Near pairs of held spheres: i, j, the cell of j, and the sum of both radii."""
        dim, radii = self.x.shape[1], self.radii[held]
        atoms = Atoms(np.zeros(len(radii)), np.pad(self.x[held], ((0, 0), (0, 3 - dim))), pbc=np.arange(3) < dim,
                      cell=np.pad(self.cell, (0, 3 - dim)) + np.diag(np.arange(3) >= dim).astype(float))
        i, j, shift, r = pairs_within(atoms, 2 * radii.max() * (1 + skin))
        keep = r < (radii[i] + radii[j]) * (1 + skin)
        return i[keep], j[keep], shift[keep, :dim].astype(float), (radii[i] + radii[j])[keep]

    def descend(self, held, pressure, balance):
        """FIRE until the forces balance to a fraction of the pressure; spheres that are not held follow the cell."""
        x, cell = self.x[held], self.cell.copy()
        fire, skin, left, lists = np.array([0.05, 0.1, 0.0]), SKIN[0], STEPS, 0
        moving = np.zeros_like(x), np.zeros_like(cell)
        inertia = np.sqrt(len(x))  # the cell is then about as stiff as a sphere
        while True:
            done, balanced = descend(x, cell, *self.near(held, skin), self.power, pressure, balance, *moving, fire, inertia, left,
                                     0.45 * skin * self.radii.min())
            self.x, self.cell = self.x @ np.linalg.solve(self.cell, cell), cell.copy()
            self.x[held] = x
            left, lists = left - done, lists + 1
            if balanced:
                return
            if left <= 0:
                raise Unstable(f'the spheres did not come to rest within {STEPS} steps at this pressure: take a higher one, or '
                               'approach it by steps, packing(...).at(pressure)')
            if lists > 20:
                skin = SKIN[1]

    def idle(self, held, most):
        """Spheres that nothing holds, shape (all spheres,): at most as many contacts as dimensions, and forces below `most`."""
        i, j, shift, D = self.near(held, 0.0)
        x = self.x[held]
        r = np.linalg.norm(x[j] - x[i] + shift @ self.cell, axis=1)
        force = np.maximum(1 - r / D, 0) ** (self.power - 1) / D
        largest, contacts = np.zeros(len(x)), np.bincount(np.concatenate([i, j]), minlength=len(x))
        for ends in (i, j):
            np.maximum.at(largest, ends, force)
        found = np.zeros(len(held), bool)
        found[held] = (contacts <= x.shape[1]) & (largest < most)
        return found


@njit(cache=True)
def descend(x, cell, i, j, shift, D, power, pressure, balance, v, strain_rate, fire, inertia, steps, roam):
    """Steps of FIRE, until the forces balance or a sphere has moved by `roam` past the cell: their number, and whether they do.

    In mean diameters, energies of a contact and unit masses: positions `x`, velocities `v` and the cell with its strain rate,
    which has the `inertia`, change in place, and so does `fire`, the time step, the mixing and the number of steps downhill.
    Pairs i, j, `shift` with the sums D of their radii act.
    """
    n, dim = x.shape
    one, first, cell0 = np.eye(dim), x.copy(), cell.copy()
    F, W = np.zeros((n, dim)), np.zeros((dim, dim))
    for step in range(steps):
        forces(x, cell, i, j, shift, D, power, F, W)
        V = abs(np.linalg.det(cell))
        G = ((W + W.T) / 2 - pressure * V * one) / inertia
        if max(np.abs(F).max(), np.abs(G).max()) < balance * pressure:
            return step, True
        downhill = (F * v).sum() + (G * strain_rate).sum()
        if downhill > 0:
            turn = fire[1] * np.sqrt(((v**2).sum() + (strain_rate**2).sum()) / ((F**2).sum() + (G**2).sum()))
            v *= 1 - fire[1]
            v += turn * F
            strain_rate *= 1 - fire[1]
            strain_rate += turn * G
            fire[2] += 1
            if fire[2] > 5:
                fire[0], fire[1] = min(1.1 * fire[0], 0.4), 0.99 * fire[1]
        else:
            v[:] = 0
            strain_rate[:] = 0
            fire[0], fire[1], fire[2] = 0.5 * fire[0], 0.1, 0
        v += fire[0] * F
        strain_rate += fire[0] * G
        strained = one + fire[0] * strain_rate / inertia
        x[:] = (x + fire[0] * v) @ strained
        cell[:] = cell @ strained
        if step % 5 == 0:
            followed = np.linalg.solve(cell0, cell)
            far = np.sqrt(((x - first @ followed) ** 2).sum(axis=1).max())
            if far > roam or np.abs(followed - one).max() > roam / 4:
                return step + 1, False
    return steps, False


@njit(cache=True)
def forces(x, cell, i, j, shift, D, power, F, W):
    """Forces on the spheres into F, and the sum of force times distance into W: `f = (1 - r/D)^(power - 1)/D` where r < D."""
    dim = x.shape[1]
    F[:] = 0
    W[:] = 0
    R = np.zeros(dim)
    for b in range(len(i)):
        square = 0.0
        for k in range(dim):
            R[k] = x[j[b], k] - x[i[b], k]
            for m in range(dim):
                R[k] += shift[b, m] * cell[m, k]
            square += R[k] ** 2
        if square >= D[b] ** 2:
            continue
        r = np.sqrt(square)
        overlap = 1 - r / D[b]
        f = (overlap if power == 2 else overlap ** (power - 1)) / D[b] / r
        for k in range(dim):
            F[j[b], k] += f * R[k]
            F[i[b], k] -= f * R[k]
            for m in range(dim):
                W[k, m] += f * R[k] * R[m]


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

    def __init__(self, atoms: Atoms, skin: float = 0.15) -> None:
        super().__init__()
        calc: Any = repulsion_of(atoms)
        if calc.sites.radii is None or calc.tied or calc.load.any():
            raise ValueError('contacts are followed between spheres with radii, without a foundation and a load: give the '
                             'calculator radii=, or keep it as it is')
        self._law, self._radii, self._skin = calc.laws, calc.sites.radii, positive('skin', skin)
        self._listed: Any = 0, None  # positions, cell and pairs of the last list

    def calculate(self, atoms: Atoms | None = None, properties: Sequence[str] = ('energy',),
                  system_changes: Sequence[str] = tuple(all_changes)) -> None:
        super().calculate(atoms, properties, system_changes)
        here: Any = self.atoms
        x, (at, cell, *pairs) = here.positions, self._listed
        if not np.array_equal(here.cell.array, cell) or (
                2 * np.linalg.norm(x - at, axis=1).max() > self._skin * self._radii.min()):
            i, j, shift, r = pairs_within(here, 2 * self._radii.max() * (1 + self._skin))
            near = r < (1 + self._skin) * (self._radii[i] + self._radii[j])
            pairs = i[near], j[near], shift[near]
            self._listed = x.copy(), here.cell.array.copy(), *pairs
        i, j, shift = pairs
        R, D = vectors_between(here, i, j, shift), self._radii[i] + self._radii[j]
        r = np.linalg.norm(R, axis=1)
        pull = (self._law.dphi(r / D) / D / r)[:, None] * R
        forces = np.zeros_like(x)
        np.add.at(forces, i, pull)
        np.subtract.at(forces, j, pull)
        self.results = {'energy': float(self._law.phi(r / D).sum()), 'forces': forces}
