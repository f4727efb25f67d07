"""Finite patches and infinite ribbons cut out of a lattice, with a held rim."""

from __future__ import annotations

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms

from ..errors import positive, refuse_memory, whole
from .bonds import Bonds, find_bonds

RIM = 1
"""Tag of the particles on the rim of a patch; those inside have the tag 0."""
PLACE_bytes = 110  # at the peak while a patch is cut, for each place of the parallelogram around it; measured


def parallelogram(cell: Atoms, n1: int, n2: int) -> Atoms:
    """Patch of `n1 x n2` cells of a planar lattice, its rim held fixed.

    Every patch is centred on the origin, carries the tag `RIM` on the particles that lack a nearest neighbour,
    and holds them with ASE's FixAtoms: inside the rim each particle has all its nearest neighbours and is in equilibrium.
    Deleting the constraint leaves a free edge, which the static forces push outwards.  The array 'site' numbers
    the particles on the parallelogram from which the patch was cut.

    Parameters
    ----------
    cell : ase.Atoms
        Planar unit cell, pbc (1, 1, 0).
    n1, n2 : int
        Number of cells along the two lattice vectors.

    Returns
    -------
    ase.Atoms
        The patch, not periodic.

    Examples
    --------
    >>> from magphonon import lattices
    >>> patch = lattices.parallelogram(lattices.triangular(1.0, 1.0), 5, 6)
    >>> len(patch), bool(patch.pbc.any())
    (30, False)
    """
    return _patch(cell, whole('n1', n1), whole('n2', n2), lambda x, y: np.zeros(x.shape))


def rectangle(cell: Atoms, width: float, height: float) -> Atoms:
    """Patch of the particles within a `width` x `height` (mm) rectangle; with a rim as in `parallelogram`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> len(lattices.rectangle(lattices.square(1.0, 1.0), width=4.0, height=6.0))
    35
    """
    width, height = positive('width', width, 'mm'), positive('height', height, 'mm')
    return _cut(cell, np.hypot(width, height) / 2, lambda x, y: np.maximum(abs(x) - width / 2, abs(y) - height / 2))


def hexagon(cell: Atoms, side: float) -> Atoms:
    """Patch within a regular hexagon of `side` (mm), corners on the x axis; with a rim as in `parallelogram`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> patch = lattices.hexagon(lattices.triangular(1.0, 1.0), side=3.0)
    >>> len(patch), int((patch.get_tags() == lattices.RIM).sum())  # 18 of them are the rim
    (37, 18)
    """
    side = positive('side', side, 'mm')
    return _cut(cell, side, lambda x, y: _beyond_hexagon(x, y, side))


def half_hexagon(cell: Atoms, side: float) -> Atoms:
    """Upper half (y >= 0) of `hexagon`, the shape of the paper's prototype; with a rim as in `parallelogram`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> len(lattices.half_hexagon(lattices.triangular(1.0, 1.0), side=3.0))
    22
    """
    side = positive('side', side, 'mm')
    return _cut(cell, side, lambda x, y: np.maximum(_beyond_hexagon(x, y, side), -y))


def ribbon(cell: Atoms, rows: int) -> Atoms:
    """Ribbon of `rows` cells across a planar lattice, periodic along its first lattice vector, with a rim as in `parallelogram`.

    Deleting the constraint, or the part of it on one side, leaves a free edge.  The tags remain and mark the edges.

    Parameters
    ----------
    cell : ase.Atoms
        Planar unit cell, pbc (1, 1, 0).
    rows : int
        Number of cells along the second lattice vector.

    Returns
    -------
    ase.Atoms
        One cell of the ribbon, pbc (1, 0, 0).
    """
    rows = whole('rows', rows)
    refuse_memory(f'a ribbon of {rows} rows', PLACE_bytes / 2 * rows * len(cell), 'take fewer')
    ribbon, shell = _planar(cell).repeat((1, rows, 1)), find_bonds(cell)
    ribbon.pbc = (True, False, False)
    neighbours = _neighbours(np.ones((1, rows, len(cell)), bool), shell, shell.shift * (0, 1, 0))
    return _with_rim(ribbon, neighbours.ravel() < np.tile(shell.coordination, rows))


def _beyond_hexagon(x, y, side):
    return np.maximum(abs(y), (abs(y) + np.sqrt(3) * abs(x)) / 2) - side * np.sqrt(3) / 2


def _cut(cell, radius, beyond):
    """Patch within a shape that fits in a circle of `radius`; `beyond(x, y)` is the distance outside its border."""
    rows = _planar(cell).cell.reciprocal()[:2]  # their inverse lengths are the distances between lattice rows
    n1, n2 = 2 * np.ceil(radius * np.linalg.norm(rows, axis=1)) + 3
    return _patch(cell, n1, n2, beyond)


def _patch(cell, n1, n2, beyond):
    shell = find_bonds(_planar(cell))
    places = len(cell) * float(n1) * float(n2)
    refuse_memory(f'a patch cut from {n1:.6g} x {n2:.6g} cells', PLACE_bytes * places, 'make it smaller')
    n1, n2 = int(n1), int(n2)
    corner = cell.positions[0] + np.array([n1 - 1, n2 - 1, 0]) @ cell.cell.array / 2
    # as ase.Atoms.repeat, which places the cells one by one and would take most of the time
    rows, columns = (np.arange(n)[:, None] * vector for n, vector in zip((n1, n2), cell.cell.array[:2], strict=True))
    places = (cell.positions + (rows[:, None] + columns)[:, :, None]).reshape(-1, 3)
    places -= corner
    there = beyond(*places[:, :2].T) <= 1e-9 * shell.lengths[0]  # a particle on the border belongs to the patch
    neighbours = _neighbours(there.reshape(n1, n2, -1), shell, shell.shift)
    inside = np.flatnonzero(there)
    image = inside % len(cell)
    patch = cell[image]
    patch.positions = places[inside]
    patch.set_array('site', inside)
    patch.pbc, patch.cell = False, None
    return _with_rim(patch, neighbours.ravel()[inside] < shell.coordination[image])


def _neighbours(there, shell, shifts):
    """Number of bonds from each site to sites that are `there`; both of the shape (rows of cells, cells, particles of a cell)."""
    found = np.zeros(there.shape, np.int16)
    for i, j, (a, b, _) in zip(shell.i, shell.j, shifts, strict=True):
        (here1, to1), (here2, to2) = ((slice(max(0, -s), max(0, n - max(0, s))), slice(max(0, s), max(0, n + min(0, s))))
                                      for s, n in zip((a, b), there.shape, strict=False))
        found[here1, here2, i] += there[to1, to2, j]
        found[to1, to2, j] += there[here1, here2, i]
    return found


def surrounded(patch: Atoms, cell: Atoms, bonds: Bonds) -> Atoms:
    """The patch and held particles around it: those to which its free particles are bonded in the infinite lattice.

    The rim of a patch is as thick as nearest neighbours require. With the added particles every free particle has all of its
    neighbours and is in equilibrium, for bonds of any length. The added ones come last and have the tag `RIM`.

    Examples
    --------
    >>> from magphonon import lattices
    >>> from magphonon.lattices import find_bonds
    >>> from magphonon.lattices.patches import surrounded
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> patch = lattices.hexagon(cell, side=3.0)
    >>> len(patch), len(surrounded(patch, cell, find_bonds(cell))), len(surrounded(patch, cell, find_bonds(cell, shells=3)))
    (37, 37, 61)
    """
    free = np.flatnonzero(patch.get_tags() != RIM)
    image = patch.arrays['site'] % len(cell)
    ends, kinds = [patch.positions], [image]
    for here, there, sign in ((bonds.i, bonds.j, 1), (bonds.j, bonds.i, -1)):
        for k, other, vector in zip(here, there, sign * bonds.vectors, strict=True):
            own = free[image[free] == k]
            ends.append(patch.positions[own] + vector)
            kinds.append(np.full(len(own), other))
    places, kind = np.concatenate(ends), np.concatenate(kinds)
    origins = (places - cell.positions[kind])[:, :2]  # of the cells
    cells = (origins - origins[0]) @ np.linalg.inv(cell.cell.array[:2, :2])
    _, first = np.unique(np.column_stack([kind, np.rint(cells).astype(int)]), axis=0, return_index=True)
    beyond = np.sort(first[first >= len(patch)])
    more = cell[kind[beyond]]
    more.positions = places[beyond]
    more.set_tags(RIM)
    more.pbc, more.cell = False, None
    rim = np.append(patch.get_tags() == RIM, np.ones(len(more), bool))
    whole = patch + more
    del whole.arrays['site']
    whole.set_constraint(FixAtoms(mask=rim))
    return whole


def _planar(cell):
    if tuple(cell.pbc) != (True, True, False):
        raise ValueError(f'a patch is cut from a planar cell with pbc (1, 1, 0), not {tuple(map(int, cell.pbc))}')
    return cell


def _with_rim(patch, rim):
    """The patch with the particles of its `rim`, which have fewer neighbours than in the lattice, tagged and held."""
    if rim.all():
        raise ValueError(f'the patch holds {len(patch)} particles, none of them inside its rim; make it larger')
    patch.set_tags(np.where(rim, RIM, 0))
    patch.set_constraint(FixAtoms(mask=rim))
    return patch
