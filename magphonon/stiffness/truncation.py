"""The range of neighbours needed for laws without an exact infinite sum: direct sums with a bound on the remainder.

A term that falls with the distance is smaller than its mean over the cell next to it on the inner side, so the sum
over all particles beyond R is less than an integral that begins one cell diameter D closer,

    sum |phi'' nn + (phi'/r)(I - nn)|  <  n S int_{R-D}^inf (phi'' + |phi'|/r) r^(d-1) dr

with n particles per mm^d and S = 2, 2 pi, 4 pi in d = 1, 2, 3 dimensions.
"""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from ..errors import positive
from ..lattices.bonds import ON_SHELL, bonds_within

if TYPE_CHECKING:
    from ase import Atoms

    from ..interactions.pair_laws import PairLaw

MOST_BONDS = 300_000
"""Largest number of bonds of one cell in a lattice sum."""


def missing_stiffness(atoms: Atoms, potential: PairLaw, cutoff: float) -> float:
    """Bound on the stiffness that neighbours beyond `cutoff` add to a particle.

    Parameters
    ----------
    atoms : ase.Atoms
        One periodic cell.
    potential : PairLaw
        A law whose slope and curvature fall with the distance; it may be zero beyond a finite range.
    cutoff : float
        In mm.

    Returns
    -------
    float
        In N/mm; the bound holds for D0 and D* and in each direction.

    Raises
    ------
    ValueError
        If the law is not known that far (a table), or its range is so long that the sum diverges.
    """
    from scipy.integrate import quad

    periods = atoms.cell.array[atoms.pbc]
    d = len(periods)
    volume = np.sqrt(np.linalg.det(periods @ periods.T))
    start = positive('cutoff', cutoff, 'mm') - np.linalg.norm(periods, axis=1).sum()
    if not start > 0:
        return np.inf

    def term(v):  # integrand over log r
        r = np.exp(v)
        return (potential.d2phi(r) + abs(potential.dphi(r)) / r) * r**d

    ends = np.log(start) + np.array([0.0, 1.0, 3.0, 9.0, 27.0])  # algebraic tails: the last piece is r = 5e11 times as far
    total = sum(quad(term, a, b, epsabs=0, epsrel=1e-6, limit=200)[0] for a, b in pairwise(ends) if term(a))
    if not term(ends[-1]) <= 1e-3 * total:
        raise ValueError(f'the stiffness of all neighbours diverges in {d} dimensions for the law {potential!r}; '
                         'choose AllNeighbours, or a number of shells')
    return len(atoms) / volume * {1: 2, 2: 2 * np.pi, 3: 4 * np.pi}[d] * total


def reach(atoms: Atoms, potential: PairLaw, tolerance: float = 1e-5) -> float:
    """Cutoff beyond which all neighbours together add less than a fraction `tolerance` of the stiffness within.

    Parameters
    ----------
    atoms, potential
        As for `missing_stiffness`.
    tolerance : float

    Returns
    -------
    float
        In mm, between two shells: for `MagneticRepulsion(atoms, potential, cutoff=reach(...))`.

    Raises
    ------
    ValueError
        If too many neighbours would have to be summed.

    Examples
    --------
    >>> from magphonon import InversePower, lattices
    >>> from magphonon.stiffness import reach
    >>> reach(lattices.triangular(1.0, 1.0), InversePower(1.0, 6.0), tolerance=1e-2) < 20
    True
    """
    periods = atoms.cell.array[atoms.pbc]
    cutoff = 2 * np.linalg.norm(periods, axis=1).sum()
    r = bonds_within(atoms, cutoff).lengths
    stiffness = np.sum(potential.d2phi(r)) / len(atoms)
    while missing_stiffness(atoms, potential, cutoff) > positive('tolerance', tolerance) * stiffness:
        cutoff *= 1.2
        pairs = len(atoms) ** 2 * cutoff ** len(periods) / np.sqrt(np.linalg.det(periods @ periods.T))
        if pairs > MOST_BONDS:
            raise ValueError(f'{potential!r} has such a long range that {pairs:.0e} neighbours miss more than {tolerance:g} of '
                             'the stiffness; raise the tolerance, or use AllNeighbours')
    lengths = np.unique(bonds_within(atoms, 1.1 * cutoff).lengths)
    gaps = np.flatnonzero(np.diff(lengths) > 4 * ON_SHELL * lengths[1:])
    last = gaps[lengths[gaps] >= cutoff / 1.05][0]
    return float(lengths[last : last + 2].mean())
