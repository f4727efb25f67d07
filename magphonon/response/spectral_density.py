"""Densities of states of a large structure with any disorder: total, local, and resolved by wavevector.

They are computed by the kernel polynomial method (`magphonon.response.chebyshev`).  It keeps only a few vectors in
memory, and its time is proportional to the number of particles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray
from tqdm import tqdm

from ..bands.density import DensityOfStates, increasing
from ..errors import finite, whole
from ..files import Saved
from ..results import InHertz
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .chebyshev import COLUMNS, spectrum_of

ASTRAY = 0.3
"""Distance from the nearest lattice site, in shortest distances between sites, beyond which a particle belongs to no site."""


@takes(*LIKE)
def density_of_states(atoms: Atoms | LinearSystem, omega: ArrayLike | None = None, moments: int = 512, vectors: int = COLUMNS,
                      seed: int = 0) -> DensityOfStates:
    """Density of states of a finite or periodic structure with any disorder, from random start vectors.

    The mean over start vectors with random signs estimates the trace. With R vectors its relative error is about sqrt(2/(R m)),
    where m is the number of modes within a resolved width.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with PairCalculator.
    omega : array_like, shape (frequencies,), optional
        Increasing, in rad/ms; by default all frequencies in steps of half the resolved width.
    moments : int
        An even number.  The width of a resolved peak is `pi/(2 moments)` of the highest frequency, or less.
    vectors : int
        Number of random vectors, at least 2.
    seed : int
        Seed of the random signs.

    Returns
    -------
    DensityOfStates
        Its `modes` are the number of free directions, and its `error` is the standard error of the mean over the vectors.

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.response import density_of_states
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), 4.0)
    >>> patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=1.0)
    >>> density_of_states(patch, moments=64, vectors=2).density.ndim
    1
    """
    system, count = LinearSystem.of(atoms).moving(), _even(moments)
    rng_seed, vectors, size = whole('seed', seed, 0), whole('vectors', vectors, 2), system.directions

    def starts():
        rng = np.random.default_rng(rng_seed)
        for first in range(0, vectors, COLUMNS):
            yield rng.choice((-1.0, 1.0), size=(size, min(COLUMNS, vectors - first)))

    with _bar(vectors) as progress:
        spectrum = spectrum_of(system, starts, count, progress)
    omega = spectrum.grid if omega is None else increasing(omega, system.calc)
    density = spectrum.density(omega)
    error = density.std(axis=1, ddof=1) / np.sqrt(vectors)
    return DensityOfStates(omega, density.mean(axis=1), float(size), spectrum.width(omega), error)


@dataclass(frozen=True)
class SpectralFunction(InHertz, Saved, kind='spectral functions', units={
    'q': ('reciprocal vectors', 'wavevectors', 'vectors'), 'omega': ('rad/ms', 'frequencies'),
    'density': ('ms/rad', 'wavevectors', 'frequencies'), 'modes': ('',), 'width': ('rad/ms', 'frequencies'),
}):
    """Unfolded bands: how the plane waves of a perfect lattice are distributed over the modes of a disordered one.

    Attributes
    ----------
    q : ndarray, shape (wavevectors, 3)
        In fractions of the reciprocal vectors of the primitive cell.
    omega : ndarray, shape (frequencies,)
        Angular frequencies in rad/ms, ascending; negative values stand for imaginary frequencies.
    density : ndarray, shape (wavevectors, frequencies)
        A(k, omega) in ms/rad, summed over the branches.
    modes : float
        Integral over the frequency at each wavevector: the number of branches. Sites and directions held in every cell do not
        count.
    width : ndarray, shape (frequencies,)
        Resolution in rad/ms: the standard deviation of the peak that one undisturbed wave makes.
    """

    q: np.ndarray
    omega: np.ndarray
    density: np.ndarray
    modes: float
    width: np.ndarray


@takes(*LIKE)
def spectral_function(atoms: Atoms | LinearSystem, cell: Atoms, q: ArrayLike, omega: ArrayLike | None = None,
                      moments: int = 256) -> SpectralFunction:
    """Spectral function A(k, omega) of a patch of a lattice with defects or disorder.

    The start vectors are plane waves in mass-weighted displacements, one for each particle of the primitive cell and each
    direction,

        e^{i k.R} / sqrt(sites)    on the free sites of one particle of the cell, along one direction

    where R are the positions of the anchors. In a perfect lattice these vectors combine to its Bloch waves. In a patch of length
    l, a wave has a width of at least about 2 pi/l in wavevector. In a periodic structure use wavevectors that fit its period.

    Parameters
    ----------
    atoms : ase.Atoms or LinearSystem
        At rest, with PairCalculator.
    cell : ase.Atoms
        The primitive cell of the perfect lattice, in the same orientation; its calculator is not needed.
    q : array_like, shape (wavevectors, 3)
        Wavevectors in fractions of the reciprocal vectors of `cell`, such as `path.kpts` of a path through its zone.
    omega, moments
        As for `density_of_states`.
    """
    system, count = LinearSystem.of(atoms).moving(), _even(moments)
    q = finite('q', q)
    if q.ndim != 2 or q.shape[1] != 3:
        raise ValueError(f'q must be wavevectors of three fractions, of the shape (wavevectors, 3), not {q.shape}')
    waves = _Waves(system, cell, q)
    with _bar(waves.count) as progress:
        spectrum = spectrum_of(system, waves.starts, count, progress)
    omega = spectrum.grid if omega is None else increasing(omega, system.calc)
    # cosine and sine of a wave, and all of its polarisations, add up
    density = spectrum.density(omega).T.reshape(len(q), -1, len(omega)).sum(axis=1)
    return SpectralFunction(q, omega, density, float(len(waves.lengths)), spectrum.width(omega))


class _Waves:
    """Plane waves on the free sites as real columns: for each wavevector the cosines, then the sines, of all polarisations."""

    def __init__(self, system, cell, q):
        self.places = system.calc.anchors
        self.own, self.dim = sites_of(self.places, cell), system.dim
        self.k = 2 * np.pi * q @ cell.cell.reciprocal().array
        self.free = system.free.T.tocsr()
        lengths = {which: np.linalg.norm(self._free(np.ones(len(system)), *which)) for which in np.ndindex(len(cell), self.dim)}
        self.lengths = {which: length for which, length in lengths.items() if length}  # of what is not held
        self.count = 2 * len(q) * len(self.lengths)

    def _free(self, wave, site, along):
        full = np.zeros((len(wave), self.dim))
        full[:, along] = np.where(self.own == site, wave, 0.0)
        return self.free @ full.ravel()

    def starts(self):
        columns = []
        for k in self.k:
            phase = self.places @ k
            for part in np.cos, np.sin:
                wave = part(phase)
                for which, length in self.lengths.items():
                    columns.append(self._free(wave, *which) / length)
                    if len(columns) == COLUMNS:
                        yield np.stack(columns, axis=1)
                        columns = []
        if columns:
            yield np.stack(columns, axis=1)


def sites_of(places: NDArray[np.float64], cell: Atoms) -> NDArray[np.int_]:
    """Index of the particle of the primitive cell to which each particle of a patch belongs, from the site next to its place."""
    def away(first):
        """Distances of particles to the nearest site of each sort, shape (sorts, particles), if particle 0 has sort `first`."""
        from_site = places - places[0] + cell.positions[first] - cell.positions[:, None]
        cells = cell.cell.scaled_positions(from_site.reshape(-1, 3))
        cells -= np.where(cell.pbc, cells.round(), 0)
        return np.linalg.norm(cells @ cell.cell.array, axis=1).reshape(len(cell), -1)

    distances = min((away(first) for first in range(len(cell))), key=lambda distance: distance.min(axis=0).max())
    nearest = distances.min(axis=0)
    neighbours = cell.repeat(np.where(cell.pbc, 2, 1))
    shortest = min(np.linalg.norm(neighbours.positions[1:] - neighbours.positions[0], axis=1).min(initial=np.inf),
                   cell.cell.lengths()[cell.pbc].min())
    if nearest.max() > ASTRAY * shortest:
        raise ValueError(f'particle {nearest.argmax()} is {nearest.max():.3g} mm away from every site of the lattice of the '
                         'cell; give the primitive cell from which the patch was cut, in the same orientation')
    return distances.argmin(axis=0)


def _even(count):
    count = whole('moments', count, 2)
    if count % 2:
        raise ValueError(f'moments must be even, not {count}: each product gives two')
    return count


def _bar(vectors):
    return tqdm(total=vectors, desc='start vectors', delay=2, disable=None, leave=False)
