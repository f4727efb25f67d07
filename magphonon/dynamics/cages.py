"""The cages of bonded particles: whether the list of bonds made at rest is still valid.

Only bonded pairs repel each other. This is a good approximation of the law as long as

    no bond is shorter than CONTACT or longer than BROKEN_BOND times its rest length, and
    no pair without a bond is nearer than the shortest bond at rest.

If the first condition fails, particles have collided, or are so far apart that others fit between them. If the second fails, a
repulsion as large as any at rest would be missing. A particle that leaves its cage violates one of the two.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from ..errors import Diverged
from ..lattices.bonds import Bonds, bonds_within, lengths_of, pairs_within
from ..stiffness.matrices import BROKEN_BOND, CONTACT
from ..stiffness.rest import freedom

HARMLESS = 0.05
"""Displacement, as a fraction of the shortest bond, up to which no pair can come together in any structure, so that nothing is
checked."""
ROOM = 1.4
"""Distance, in shortest bonds, within which all pairs are counted first, which takes a third of the time of a survey: if there
are as many pairs as bonds, all other pairs are farther apart."""
SURVEYED = 2.5
"""Distance, in shortest bonds, up to which pairs are listed; farther pairs must first approach each other by more than a bond
length."""
APART = 1.1
"""Distance at rest, in shortest bonds, below which a pair without a bond is taken as intended, such as two replicas; then no
unbonded distance is checked."""
SHORT_RUN = 16  # number of blocks cut short by fast particles before the clearance is surveyed, which takes as long as these
STRIDE = 0.1  # largest path of the fastest particle between two checks, as a fraction of the shortest bond


class Cages:
    """Checks whether the list of bonds of a structure is still valid; what a check has found makes the next one cheap."""

    def __init__(self, atoms: Atoms) -> None:
        self.calc, bonds = atoms.calc, atoms.calc.bonds
        try:
            self.mobile = freedom(atoms)[0]
        except ValueError:  # a constraint that it does not know
            self.mobile = np.ones(len(atoms), bool)
        self.nearest, self._hurried = bonds.shortest, 0

    @cached_property
    def clearance(self) -> float:
        """Displacement in mm up to which no bond fails and no other pair meets, however the particles are displaced."""
        self._survey(np.zeros((len(self.mobile), self.calc.dim)))
        self._judged = (self._distance >= APART * self.nearest).all()
        return min((1 - CONTACT) / 2 * self.nearest, self._margin.min() if self._judged else np.inf)

    def still(self, largest: float) -> bool:
        """Whether displacements of at most `largest` (mm) need no check; False if `largest` is NaN."""
        return largest <= HARMLESS * self.nearest or largest <= self._space(largest)

    def _space(self, largest):
        """The clearance in mm, or a smaller value that needs no survey, if that is enough for displacements of `largest`."""
        room = (ROOM - 1) / 2 * self.nearest
        return room if 'clearance' not in vars(self) and largest <= room and self.roomy else self.clearance

    @cached_property
    def roomy(self) -> bool:
        """Whether at rest no pair without a bond is nearer than ROOM times the shortest bond."""
        near = ROOM * self.nearest
        return len(pairs_within(self.calc.reference, near)[0]) == (self.calc.bonds.lengths < near).sum()

    def steps_between_looks(self, speed: float, largest: float, dt: float, most: int) -> int:
        """Number of time steps `dt` (ms) between two checks, if the fastest particle moves at `speed` (mm/ms).

        If no particle is displaced by more than `largest` (mm), it may use up the rest of the clearance: to leave its cage and
        return between two checks it would have to double its speed.
        """
        way = STRIDE * self.nearest
        if speed * dt * most <= way:
            return most
        self._hurried += 1
        if (vars(self).keys() & {'clearance', 'roomy'} or self._hurried > SHORT_RUN) and largest < self._space(largest):
            way = max(way, self._space(largest) - largest)
        return max(1, min(most, int(way / (speed * dt))))

    def clear(self, u: NDArray[np.float64]) -> bool:
        """Whether no pair without a bond can meet at the displacements `u` in mm, shape (dim, particles); False if one is NaN.

        The check is quick if no particle has moved far since the last survey, as in most blocks of steps of a large motion.
        """
        step = u - self._origin.T
        return bool((np.einsum('xi,xi->i', step, step) <= self._margin_squared).all())

    def look(self, u: NDArray[np.float64], time: float, bonded: bool = True) -> None:
        """Raise Diverged if the displacements `u` in mm, shape (particles, dim), are not finite or violate a cage.

        Without `bonded` the lengths of the bonds are not checked, because the caller has done that.
        """
        if not np.isfinite(u).all():
            raise Diverged(np.flatnonzero(~np.isfinite(u).all(axis=1))[0], time, 'has no finite position')
        if self.still(np.sqrt(np.einsum('ix,ix->i', u, u).max(initial=0.0))):
            return
        if bonded:
            self._look_at_bonds(u, time)
        if self._judged:
            self._look_at_others(u, time)

    def _look_at_bonds(self, u, time):
        bonds, R = self.calc.bonds, self.calc.bond_vectors
        r0 = lengths_of(R)
        bond = R + u[bonds.j] - u[bonds.i]
        r = lengths_of(bond)
        if self.calc.parameters.model == 'conventional':
            r = np.einsum('bx,bx->b', bond, R) / r0
        for b in np.flatnonzero((r < CONTACT * r0) | (r > BROKEN_BOND * r0))[:1]:
            raise Diverged(bonds.i[b], time, f'is {r[b]:g} mm from its neighbour {bonds.j[b]} instead of {r0[b]:g} mm')

    def _look_at_others(self, u, time):
        """Check the pairs without a bond: d apart at the survey, they can meet only if an end has moved by (d - nearest)/2."""
        step = u - self._origin
        moved = np.sqrt(np.einsum('ix,ix->i', step, step))
        if moved.max() >= (SURVEYED - 1) / 2 * self.nearest:
            self._survey(u)
            moved = np.zeros(len(u))
            distance, i, j = self._distance, self._i, self._j
        else:
            far = np.flatnonzero(moved > self._margin)
            if not len(far):
                return
            pairs = np.concatenate([self._pairs_of[s:e] for s, e in zip(self._first[far], self._first[far + 1], strict=True)])
            i, j = self._i[pairs], self._j[pairs]
            distance = lengths_of(self._vectors[pairs] + step[j] - step[i])
        for b in np.flatnonzero(distance < self.nearest)[:1]:
            raise Diverged(i[b], time, f'is {distance[b]:g} mm from {j[b]}, with which it has no bond, nearer than the '
                                       f'{self.nearest:g} mm at which bonded particles rest: the list of bonds is no longer '
                                       f'valid')

    def _survey(self, u):
        """List the pairs without a bond near the displacements `u`."""
        bonds, atoms = self.calc.bonds, self.calc.reference.copy()
        atoms.positions[:, : self.calc.dim] += u
        self._origin = u.copy(order='F')
        try:
            near = pairs_without_bond(bonds, atoms, SURVEYED * self.nearest)
        except ValueError:  # two particles coincide
            self._i = self._j = np.zeros(1, int)
            self._vectors, self._distance = np.zeros((1, self.calc.dim)), np.zeros(1)
            self._margin = self._margin_squared = np.zeros(len(u))
            self._pairs_of, self._first = np.zeros(len(u), int), np.arange(len(u) + 1)
            return
        other = self.mobile[near.i] | self.mobile[near.j]
        self._i, self._j, self._vectors = near.i[other], near.j[other], near.vectors[other, : self.calc.dim]
        self._distance = lengths_of(self._vectors)
        self._margin = np.full(len(u), (SURVEYED - 1) / 2 * self.nearest)
        for ends in (self._i, self._j):
            np.minimum.at(self._margin, ends, (self._distance - self.nearest) / 2)
        self._margin_squared = np.maximum(self._margin, 0) ** 2
        ends = np.concatenate([self._i, self._j])
        by_end = np.argsort(ends, kind='stable')
        self._pairs_of, self._first = by_end % max(len(self._i), 1), np.searchsorted(ends[by_end], np.arange(len(u) + 1))


def pairs_without_bond(bonds: Bonds, atoms: Atoms, cutoff: float) -> Bonds:
    """Pairs of particles within `cutoff` (mm) that no bond of the list joins; ValueError if two particles coincide."""
    near = bonds_within(atoms, cutoff)
    both = _keys(near, bonds.i, bonds.j, bonds.shift), _keys(near, bonds.j, bonds.i, -bonds.shift)
    known = np.sort(np.concatenate([*both, [-2]]))
    keys = _keys(near, near.i, near.j, near.shift)  # nearly in order, so that they are soon found among others in order
    other = known[np.searchsorted(known, keys, side='right') - 1] != keys
    return replace(near, i=near.i[other], j=near.j[other], shift=near.shift[other], vectors=near.vectors[other])


def _keys(near, i, j, shift):
    """An integer key for each pair and cell; outside the cells of `near` no pair gets the key of a pair in `near`."""
    most, i = abs(near.shift).max(initial=0), i.astype(int)  # products with particles want more than 32 bits
    if not (most or shift.any()):
        return i * near.particles + j
    inside = (abs(shift) <= most).all(axis=1)
    place = np.where(inside[:, None], shift + most, 0) @ (2 * most + 1) ** np.arange(3)
    return np.where(inside, (i * near.particles + j) * (2 * most + 1) ** 3 + place, -1)
