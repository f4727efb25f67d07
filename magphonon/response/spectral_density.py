"""Density of states of a large structure with any disorder, by the kernel polynomial method (`magphonon.response.chebyshev`).

It keeps only a few vectors in memory, and its time is proportional to the number of particles.
"""

from __future__ import annotations

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike
from tqdm import tqdm

from ..bands.density import DensityOfStates, increasing
from ..errors import whole
from ..stiffness.rest import LinearSystem
from ..traits import LIKE, takes
from .chebyshev import COLUMNS, spectrum_of


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
    system, count = LinearSystem.of(atoms).moving(), whole('moments', moments, 2)
    if count % 2:
        raise ValueError(f'moments must be even, not {count}: each product gives two')
    rng_seed, vectors, size = whole('seed', seed, 0), whole('vectors', vectors, 2), system.directions

    def starts():
        rng = np.random.default_rng(rng_seed)
        for first in range(0, vectors, COLUMNS):
            yield rng.choice((-1.0, 1.0), size=(size, min(COLUMNS, vectors - first)))

    with tqdm(total=vectors, desc='start vectors', delay=2, disable=None, leave=False) as progress:
        spectrum = spectrum_of(system, starts, count, progress)
    omega = spectrum.grid if omega is None else increasing(omega, system.calc)
    density = spectrum.density(omega)
    error = density.std(axis=1, ddof=1) / np.sqrt(vectors)
    return DensityOfStates(omega, density.mean(axis=1), float(size), spectrum.width(omega), error)
