"""Defects and disorder: vacancies, substitutions, and sites with random scatter.

Each function takes atoms with their PairCalculator and returns new atoms with a new calculator.  The bonds are those
of the perfect structure, except at the particles that were removed.  The result is in general not at rest: relax it
first with `magphonon.relaxed`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from scipy.special import ndtri

from ..errors import finite, indices, not_negative, positive, whole
from ..lattices.bonds import Bonds
from .repulsion import repulsion_of

if TYPE_CHECKING:
    from .calculator import PairCalculator

LARGEST_SCATTER = 0.2  # relative: fewer than one of 3 million sites is expected to become negative
QUANTITIES = 'x', 'y', 'z', 'strength', 'mass', 'stiffness'
"""The quantities that scatter, in the order of the random numbers of a site.  Each uses its own random number, so the scatter of
one does not depend on whether another one scatters too."""


def with_vacancies(atoms: Atoms, particles: ArrayLike) -> Atoms:
    """The structure with vacancies: these particles are removed, with their bonds and their springs."""
    calc = repulsion_of(atoms)
    kept = np.delete(np.arange(len(atoms)), indices('vacancies', particles, len(atoms)))
    number = np.full(len(atoms), -1)
    number[kept] = np.arange(len(kept))
    old = calc.bonds
    both = (number[old.i] >= 0) & (number[old.j] >= 0)
    bonds = Bonds(number[old.i[both]], number[old.j[both]], old.shift[both], old.vectors[both], len(kept), old.cutoff)
    return _with(atoms[kept], calc.changed(calc.reference[kept], bonds, calc.sites[kept]))


def substituted(atoms: Atoms, particle: int, *, mass: float = 1.0, strength: float = 1.0, stiffness: float = 1.0) -> Atoms:
    """The structure with one particle replaced by another.

    Parameters
    ----------
    atoms : ase.Atoms
    particle : int
    mass, strength, stiffness : float
        Mass, strength and stiffness of the foundation of the new particle, as factors of those of the replaced one.
    """
    indices('the particle that is replaced', particle, len(atoms))
    factors = {name: np.ones(len(atoms)) for name in ('mass', 'strength', 'stiffness')}
    factors['mass'][particle] = positive('mass', mass)
    factors['strength'][particle] = finite('strength', strength, ())
    factors['stiffness'][particle] = not_negative('stiffness', stiffness)
    return varied_sites(atoms, **factors)


@dataclass(frozen=True)
class Scatter:
    """Standard deviations of the properties of sites, which scatter independently with normal distributions.

    Attributes
    ----------
    position : float
        Standard deviation of each coordinate in mm, in the plane of a planar structure or a layer; the anchors move with the
        particles, like misplaced pillars.
    strength, mass, stiffness : float
        Relative standard deviations of the strengths, the masses and the springs of the foundation.
    """

    position: float = 0.0
    strength: float = 0.0
    mass: float = 0.0
    stiffness: float = 0.0

    def __post_init__(self) -> None:
        not_negative('position', self.position, 'mm')
        for name in ('strength', 'mass', 'stiffness'):
            if not_negative(name, getattr(self, name)) > LARGEST_SCATTER:
                raise ValueError(f'the scatter of {name} must be at most {LARGEST_SCATTER:g}, not {getattr(self, name):g}; '
                                 'with a larger one some masses, strengths or springs would become negative')


def scattered(atoms: Atoms, scatter: Scatter, seed: int) -> Atoms:
    """The structure with random scatter at all sites, held ones too; a seed gives the same structure on every machine."""
    normal: dict[str, Any] = dict(zip(QUANTITIES, site_normals(seed, len(atoms)).T, strict=True))
    moved = np.stack([normal[axis] for axis in 'xyz'], axis=1) * scatter.position
    if repulsion_of(atoms).dim == 2 or atoms.calc.layer:  # pyright: ignore[reportOptionalMemberAccess]
        moved[:, 2] = 0
    factors = {name: 1 + getattr(scatter, name) * normal[name] for name in ('mass', 'strength', 'stiffness')}
    return varied_sites(atoms, moved=moved, **factors)


def site_normals(seed: int, sites: int) -> NDArray[np.float64]:
    """Normal random numbers of each site, shape (sites, 6), of mean 0 and variance 1.

    They come from the raw bits of PCG64, which do not change between versions of NumPy, and the inverse normal distribution.
    """
    raw = np.random.PCG64(whole('seed', seed, least=0)).random_raw(sites * len(QUANTITIES))
    return ndtri(((raw >> np.uint64(11)) + 0.5) * 2.0**-53).reshape(sites, len(QUANTITIES))


def varied_sites(atoms: Atoms, *, mass: Any, strength: Any, stiffness: Any, moved: Any = None) -> Atoms:
    """The structure with a factor of mass, strength and stiffness for each site, and with moved sites."""
    calc = repulsion_of(atoms)
    moved = np.zeros((len(atoms), 3)) if moved is None else moved
    varied, reference = atoms.copy(), calc.reference.copy()
    for one in varied, reference:
        one.positions += moved
        one.set_masses(atoms.get_masses() * mass)  # pyright: ignore[reportArgumentType]  ASE declares text
    sites = replace(calc.sites, strengths=calc.strengths * strength, anchors=calc.anchors + moved,
                    foundation=stiffness[:, None] * calc.foundation)
    return _with(varied, calc.changed(reference, sites=sites))


def _with(atoms: Atoms, calc: PairCalculator) -> Atoms:
    """The atoms with this calculator."""
    atoms.calc = calc
    return atoms
