"""Density of states of a lattice, the number of modes per frequency, by an integral over the Brillouin zone.

A mesh divides the zone into simplices: lines, triangles or tetrahedra.  In each of them the squared frequency is interpolated
linearly in the wavevector. The share of the simplex in which it is below E is the distribution function

    F[e0 .. ed](E) = ((E - e0) F[e0 .. ed-1](E) + (ed - E) F[e1 .. ed](E)) / (ed - e0)

of the values e0 <= ... <= ed at its corners, with F[e](E) = 1 for E >= e. The difference of F between two frequencies gives the
mean density between them, which stays finite where the density itself is infinite.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import permutations, product
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import whole
from ..results import InHertz, Saved
from ..stiffness.plausibility import asked_frequencies
from ..stiffness.rest import LinearSystem
from ..traits import LINEAR, takes
from .bloch import bloch_modes

if TYPE_CHECKING:
    from ..stiffness.matrices import Model
    from ..stiffness.repulsion import Repulsion

POINTS = 400  # number of frequencies where the caller gives none
STEPS = {1: 1998, 2: 180, 3: 30}
"""Mesh steps along each reciprocal vector, by the number of periodic directions; multiples of 6, so that M and K of hexagonal
lattices are on the mesh."""

BLOCK = 2**15  # number of simplices taken at a time, so that those of a large mesh fit in memory, and in the processor's cache
GAP = 1e-6  # width of a gap, as a fraction of the highest frequency, below which two branches touch
STEEP = 0.6
"""Two branches may cross between mesh points if their distance is at most this multiple of its change to the next mesh point; it
is a half if the distance changes linearly."""
STARTS, HALVINGS = 8, 30
"""Number of places where a crossing is looked for, the nearest ones, and of halvings of the step of the mesh."""


@dataclass(frozen=True)
class DensityOfStates(InHertz, Saved, kind='densities of states', units={
    'omega': ('rad/ms', 'frequencies'), 'density': ('ms/rad', 'frequencies'), 'modes': ('',), 'width': ('rad/ms', 'frequencies'),
    'error': ('ms/rad', 'frequencies'),
}):
    """Number of modes per angular frequency.

    Attributes
    ----------
    omega : ndarray, shape (frequencies,)
        Angular frequencies in rad/ms, ascending; unstable modes count at negative frequencies, as in `Bands`.
    density : ndarray, shape (frequencies,)
        In ms/rad.
    modes : float
        Integral of the density over all frequencies: the number of branches of a lattice, of free directions of a patch, or 1 for
        one direction of one particle.
    width : ndarray, shape (frequencies,)
        Resolution in rad/ms: the standard deviation of the peak that one mode makes, or half the width of a bin.
    error : ndarray, shape (frequencies,)
        Standard error of the density due to random sampling, in ms/rad; zero if nothing was sampled at random.
    """

    omega: np.ndarray
    density: np.ndarray
    modes: float
    width: np.ndarray
    error: np.ndarray

    @property
    def per_Hz(self) -> NDArray[np.float64]:
        """Share of all modes per Hz, shape (frequencies,): it is the same for a lattice and for a large patch of it."""
        return self.density / self.modes * 2 * np.pi * units.Hz


@takes(*LINEAR, 'all neighbours')
def lattice_density(atoms: Atoms, omega: ArrayLike | None = None, steps: int | None = None,
                    model: Model | None = None) -> DensityOfStates:
    """Density of states of an infinite lattice, by linear interpolation between the points of a mesh over its zone.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator or AllNeighbours, periodic in one, two or three directions.
    omega : array_like, shape (frequencies,), optional
        Increasing, in rad/ms: the middles of the bins over which the density is averaged; by default 400 bins over all branches.
    steps : int, optional
        Mesh steps along each reciprocal vector; if not given, 1998 for a chain, 180 in the plane, 30 in space, and fewer for
        cells of more than six particles.
    model : {'complete', 'conventional'}, optional
        D0 + D*, or D0 alone; by default the model of the calculator.

    Returns
    -------
    DensityOfStates
        The density, with as many `modes` as the lattice has branches.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import lattice_density
    >>> found = lattice_density(read_scene(ready_scene('ideal')).atoms(), steps=24)
    >>> found.modes  # branches
    2.0
    """
    frequencies = _on_mesh(atoms, steps, model)
    branches = frequencies.shape[-1]
    middles = _middles(frequencies) if omega is None else increasing(omega, atoms.calc)  # pyright: ignore[reportArgumentType]  a Repulsion has bands
    between = (middles[1:] + middles[:-1]) / 2
    edges = np.concatenate([[2 * middles[0] - between[0]], between, [2 * middles[-1] - between[-1]]])
    squares, levels = np.sign(frequencies) * frequencies**2, np.sign(edges) * edges**2
    below, count = np.zeros(len(edges)), 0
    for corners in simplices(squares):
        below += _below(corners, levels)
        count += len(corners)
    counted = branches * np.diff(below) / count
    return DensityOfStates(middles, counted / np.diff(edges), float(branches), np.diff(edges) / 2, np.zeros(len(middles)))


@takes(*LINEAR, 'all neighbours')
def band_ranges(atoms: Atoms, steps: int | None = None, model: Model | None = None) -> NDArray[np.float64]:
    """Ranges of frequency in which an infinite lattice has modes; overlapping branches make one range.

    Parameters
    ----------
    atoms, steps, model
        As for `lattice_density`.  Between points of the mesh a branch may reach a little farther.

    Returns
    -------
    ndarray, shape (bands, 2)
        Lower and upper end of each range, ascending, in rad/ms.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import band_gaps
    >>> band_gaps(read_scene(ready_scene('vacancy')).perfect_cell()).shape  # from, to
    (1, 2)
    """
    system, frequencies = LinearSystem.of(atoms), _on_mesh(atoms, steps, model)
    every = frequencies.reshape(-1, frequencies.shape[-1])
    tops, bottoms, touching = every.max(axis=0), every.min(axis=0), GAP * abs(every).max()
    for below in np.flatnonzero(bottoms[1:] - tops[:-1] > touching):  # two branches may cross between the points of the mesh
        met = _nearest_approach(system, frequencies, below, model)
        tops[below], bottoms[below + 1] = max(tops[below], met[0]), min(bottoms[below + 1], met[1])
    apart = bottoms[1:] - tops[:-1] > touching  # ascending at every wavevector, so are their ends
    return np.stack([bottoms[np.append(True, apart)], tops[np.append(apart, True)]], axis=1)


def _nearest_approach(system, frequencies, below, model):
    """Highest frequency of branch `below` and lowest of the next, where they come nearest to each other between mesh points.

    The search starts at mesh points where the distance between the branches is small compared with its change to neighbouring
    points, so that it may vanish in between. The steps along all axes are halved again and again.
    """
    pbc, steps = system.atoms.pbc, np.array(frequencies.shape[:-1])
    distance = frequencies[..., below + 1] - frequencies[..., below]
    beside = [[np.roll(distance, sign, axis) for sign in (1, -1)] for axis in range(distance.ndim)]
    lowest = (distance <= np.min(beside, axis=(0, 1))) & (distance <= STEEP * (np.max(beside, axis=(0, 1)) - distance))
    starts = np.argwhere(lowest)[np.argsort(distance[lowest])[:STARTS]]
    q, step = np.zeros((len(starts), 3)), np.zeros(3)
    q[:, pbc], step[pbc] = starts / steps, 1 / steps
    around = np.array([moves for moves in product((-1, 0, 1), repeat=3) if not np.any(moves, where=~pbc)])
    ends = -np.inf, np.inf
    for _ in range(HALVINGS if len(q) else 0):
        step = step / 2
        tried = q[:, None] + around * step
        omega = bloch_modes(system, tried.reshape(-1, 3), model)[0].reshape(*tried.shape[:2], -1)[..., below : below + 2]
        q = tried[np.arange(len(q)), np.diff(omega)[..., 0].argmin(axis=1)]
        ends = max(ends[0], omega[..., 0].max()), min(ends[1], omega[..., 1].min())
    return ends


@takes(*LINEAR, 'all neighbours')
def band_gaps(atoms: Atoms, steps: int | None = None, model: Model | None = None) -> NDArray[np.float64]:
    """Gaps between the bands of an infinite lattice, shape (gaps, 2); see `band_ranges`."""
    ranges = band_ranges(atoms, steps, model)
    return np.stack([ranges[:-1, 1], ranges[1:, 0]], axis=1)


def increasing(omega: ArrayLike, calc: Repulsion) -> NDArray[np.float64]:
    """The angular frequencies as an array, shape (frequencies,); ValueError unless there are two or more, increasing."""
    omega = asked_frequencies(calc, omega)
    if omega.ndim != 1 or len(omega) < 2 or (np.diff(omega) <= 0).any():
        raise ValueError(f'omega must be two or more increasing frequencies in rad/ms, not an array of the shape {omega.shape}')
    return omega


def _on_mesh(atoms, steps, model):
    """Frequencies in rad/ms on a mesh over the zone, shape (steps for each periodic direction, branches)."""
    periodic = int(atoms.pbc.sum())
    if not periodic:
        raise ValueError('the structure is not periodic and has no zone; magphonon.response.density_of_states is for patches')
    if steps is None:  # the zone of a large cell is smaller and needs fewer wavevectors
        steps = 6 * int(np.ceil(STEPS[periodic] / 6 / max(1.0, len(atoms) / 6) ** (1 / periodic)))
    steps = whole('steps', steps)
    n = [np.arange(steps) if along else np.zeros(1) for along in atoms.pbc]
    turned = LinearSystem.of(atoms).atoms.calc.turning > 0  # AllNeighbours too
    if not turned:
        n[atoms.pbc.argmax()] = np.arange(steps // 2 + 1)  # the frequencies at -q are the same
    frequencies, _ = bloch_modes(atoms, np.stack(np.meshgrid(*n, indexing='ij'), axis=-1) / steps, model)
    half = frequencies.reshape(-1, *(steps,) * (periodic - 1), frequencies.shape[-1])
    if turned:
        return half
    others = tuple(range(1, periodic))
    mirrored = np.roll(np.flip(half[1 : (steps + 1) // 2], (0, *others)), 1, others)
    return np.concatenate([half, mirrored])


def _middles(frequencies):
    """Middles of equal bins that hold all frequencies."""
    low, high = frequencies.min(), frequencies.max()
    room, zero = 1e-9 * max(abs(low), abs(high)) + (high - low) / POINTS, GAP * abs(high)
    # no bin lies below zero where no mode does
    edges = np.linspace(low - room if low < -zero else max(low - room, -zero), high + room, POINTS + 1)
    return (edges[1:] + edges[:-1]) / 2


def simplices(values: NDArray[np.float64]) -> Iterator[NDArray[np.float64]]:
    """Yield the values of a function with f(-q) = f(q) at the corners of the simplices of a periodic mesh, ascending.

    Steps from a mesh point along all axes, one after the other, pass through the corners of one simplex for each order of the
    axes.  The opposite order gives mirror images, whose corner values are the same, so these are left out.  From values of the
    shape (n1, ..., nd, branches) it yields arrays of the shape (up to BLOCK, d + 1).
    """
    for branch in np.moveaxis(values, -1, 0):
        for order in permutations(range(branch.ndim)):
            if order > order[::-1]:
                continue
            corners = [branch]
            for axis in order:
                corners.append(np.roll(corners[-1], -1, axis))
            flat = [corner.ravel() for corner in corners]
            for first in range(0, branch.size, BLOCK):
                yield np.sort(np.stack([corner[first : first + BLOCK] for corner in flat], axis=-1), axis=-1)


def _below(corners, levels):
    """Number of simplices below each level, ascending, by linear interpolation; a simplex that is cut counts by its share."""
    first, last = (np.searchsorted(levels, corners[:, k]) for k in (0, -1))
    crossed = last - first  # levels that cut a simplex
    which = np.repeat(np.arange(len(corners)), crossed)
    level = np.arange(len(which)) - np.repeat(np.cumsum(crossed) - crossed, crossed) + first[which]
    partly = np.bincount(level, _distribution(corners[which], levels[level]), minlength=len(levels))
    wholly = np.cumsum(np.bincount(last, minlength=len(levels) + 1)[:-1])
    return wholly + partly


def _distribution(e, E):
    """The recursion for F in the docstring of this module; e of shape (simplices, corners), E of shape (simplices,)."""
    E = E[:, None]
    F = (e <= E).astype(float)
    for d in range(1, e.shape[1]):
        span, above = e[:, d:] - e[:, :-d], E - e[:, :-d]
        share = np.divide(above, span, out=(above >= 0).astype(float), where=span > 0).clip(0, 1)
        F = share * F[:, :-1] + (1 - share) * F[:, 1:]
    return F[:, 0]
