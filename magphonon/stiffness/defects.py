"""Defects and disorder: structures without some of their particles, with others in their place, or with sites that scatter.

Each function takes atoms with their MagneticRepulsion and returns others, whose calculator keeps the bonds of the perfect
structure but for the particles that are gone or new.  What comes out is in general not at rest: `magphonon.relaxed` it before all
else.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from ase import Atom

from ..errors import finite, not_negative, positive, whole
from ..lattices.bonds import Bonds, bonds_within
from .calculator import MagneticRepulsion
from .repulsion import repulsion_of
from .sites import each_spring, of_sites

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms
    from numpy.typing import ArrayLike, NDArray

LARGEST_SCATTER = 0.2
"""Largest relative standard deviation: of 3 million sites none is then expected to lose its sign."""
QUANTITIES = 'x', 'y', 'z', 'strength', 'mass', 'stiffness'
"""What scatters, in the order of the random numbers of a site; each has its own, whatever else scatters."""


def without(atoms: Atoms, particles: ArrayLike) -> Atoms:
    """The structure with vacancies: without these particles, their bonds and their springs."""
    calc = repulsion_of(atoms)
    kept = np.delete(np.arange(len(atoms)), np.atleast_1d(np.asarray(particles, int)))
    number = np.full(len(atoms), -1)
    number[kept] = np.arange(len(kept))
    old = calc.bonds
    both = (number[old.i] >= 0) & (number[old.j] >= 0)
    bonds = Bonds(number[old.i[both]], number[old.j[both]], old.shift[both], old.vectors[both], len(kept), old.cutoff)
    return _carrying(atoms[kept], calc, calc.reference[kept], bonds=bonds, foundation=of_sites(calc.foundation, kept),
                     strengths=calc.strengths[kept], anchors=calc.anchors[kept], load=calc.load[kept])


def substituted(atoms: Atoms, particle: int, *, mass: float = 1.0, strength: float = 1.0, stiffness: float = 1.0,
                kind: int | None = None) -> Atoms:
    """The structure with another particle in the place of one.

    Parameters
    ----------
    atoms : ase.Atoms
    particle : int
    mass, strength, stiffness : float
        Factors of the mass, of the strength and of the stiffness of the spring of the particle that stood there.
    kind : int, optional
        Its kind, by which its law is chosen; that of the particle that stood there if not given.
    """
    factors = {name: np.ones(len(atoms)) for name in ('mass', 'strength', 'stiffness')}
    factors['mass'][particle] = positive('mass', mass)
    factors['strength'][particle] = not_negative('strength', strength)
    factors['stiffness'][particle] = not_negative('stiffness', stiffness)
    return _varied(atoms, **factors, kinds={} if kind is None else {particle: kind})


def with_interstitial(atoms: Atoms, place: ArrayLike, *, mass: float = 1.0, strength: float = 1.0, stiffness: float = 1.0,
                      kind: int | None = None) -> Atoms:
    """The structure with a particle more, which repels all others within the reach of the longest bond.

    Parameters
    ----------
    atoms : ase.Atoms
    place : array_like, shape (2,) or (3,)
        Where it stands and where its spring is slack, mm.
    mass, strength, stiffness, kind
        As of `substituted`, with the particle that is nearest for comparison.

    Raises
    ------
    ValueError
        If nothing is within reach, or another particle stands there.
    """
    calc = repulsion_of(atoms)
    place = np.append(finite('place', place), atoms.positions[0, 2:])[:3]
    grown = atoms.copy()
    grown.append(Atom(atoms.get_chemical_symbols()[0], place))
    reach = calc.bonds.cutoff or calc.bonds.lengths.max() * (1 + 1e-9)
    near = bonds_within(grown, reach)
    own = (near.i == len(atoms)) | (near.j == len(atoms))
    if not own.any():
        raise ValueError(f'the interstitial at {place[:2].tolist()} mm has no neighbour within {reach:.4g} mm; put it among the '
                         'particles')
    distances = grown.get_distances(len(atoms), np.arange(len(atoms)), mic=True)
    like = int(np.argmin(distances))
    site = np.append(np.arange(len(atoms)), like)
    masses, tags = atoms.get_masses()[site], calc.reference.get_tags()[site]
    grown.set_masses(masses)  # pyright: ignore[reportArgumentType]  ASE declares text
    grown.set_tags(tags)
    reference = grown.copy()
    reference.positions[:-1] = calc.reference.positions
    old = calc.bonds
    bonds = Bonds(*(np.concatenate([getattr(old, name), getattr(near, name)[own]]) for name in ('i', 'j', 'shift', 'vectors')),
                  particles=len(grown), cutoff=None)
    grown = _carrying(grown, calc, reference, bonds=bonds, foundation=of_sites(calc.foundation, site),
                      strengths=calc.strengths[site], anchors=np.vstack([calc.anchors, place]),
                      load=np.vstack([calc.load, np.zeros(3)]))
    return substituted(grown, len(atoms), mass=mass, strength=strength, stiffness=stiffness, kind=kind)


@dataclass(frozen=True)
class Scatter:
    """Standard deviations of what scatters from site to site, normally distributed and independent.

    Attributes
    ----------
    position : float
        Of each coordinate in mm; anchors move with the particles, as misplaced pillars do.
    strength, mass, stiffness : float
        Relative, of the strengths, the masses and the springs of the foundation.

    Raises
    ------
    ValueError
        For one that is negative, or relative and above `LARGEST_SCATTER`.
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
                                 'larger ones leave sites without sense')


def scattered(atoms: Atoms, scatter: Scatter, seed: int) -> Atoms:
    """The structure with sites that scatter, held ones too; one seed gives one structure on every machine."""
    normal: dict[str, Any] = dict(zip(QUANTITIES, site_normals(seed, len(atoms)).T, strict=True))
    moved = np.stack([normal[axis] for axis in 'xyz'], axis=1) * scatter.position
    moved[:, repulsion_of(atoms).dim :] = 0
    factors = {name: 1 + getattr(scatter, name) * normal[name] for name in ('mass', 'strength', 'stiffness')}
    return _varied(atoms, moved=moved, **factors)


def site_normals(seed: int, sites: int) -> NDArray[np.float64]:
    """Normal random numbers of each site, shape (sites, 6), of mean 0 and variance 1.

    From the raw bits of PCG64, which NumPy never changes, through the inverse of the normal distribution.
    """
    from scipy.special import ndtri

    raw = np.random.PCG64(whole('seed', seed, least=0)).random_raw(sites * len(QUANTITIES))
    return ndtri(((raw >> np.uint64(11)) + 0.5) * 2.0**-53).reshape(sites, len(QUANTITIES))


def _varied(atoms: Atoms, *, mass: Any, strength: Any, stiffness: Any, moved: Any = None, kinds: Any = None) -> Atoms:
    """The structure with factors for each of its sites, moved sites, and other kinds."""
    calc = repulsion_of(atoms)
    moved = np.zeros((len(atoms), 3)) if moved is None else moved
    varied, reference = atoms.copy(), calc.reference.copy()
    for one in varied, reference:
        one.positions += moved
        one.set_masses(atoms.get_masses() * mass)  # pyright: ignore[reportArgumentType]  ASE declares text
        for particle, kind in (kinds or {}).items():
            one.arrays.setdefault('tags', np.zeros(len(atoms), int))[particle] = kind
    springs = calc.foundation
    if (stiffness != 1).any():
        springs = each_spring(springs, len(atoms), calc.dim).reshape(len(atoms), -1) * stiffness[:, None]
    return _carrying(varied, calc, reference, bonds=calc.bonds.at(reference), foundation=springs,
                     strengths=calc.strengths * strength, anchors=calc.anchors + moved, load=calc.load)


def _carrying(atoms: Atoms, calc: MagneticRepulsion, reference: Atoms, **given: Any) -> Atoms:
    """The atoms with a calculator of the same laws and model."""
    atoms.calc = MagneticRepulsion(reference, calc.potential, model=calc.model, **given)
    return atoms
