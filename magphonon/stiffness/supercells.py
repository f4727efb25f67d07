"""Supercells made by other tools: finds the lattice site of each particle, whatever their order, displaced or wrapped or not.

Phonon programs attach the calculator of a cell to displaced supercells whose particles are in an order of their own, without
masses, tags and constraints.  A cell that is a whole multiple T of the reference, with the same multiple of its particles, is
such a supercell: each particle is matched to the site nearest to it, one to one.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from numpy.typing import NDArray
from scipy.spatial import KDTree

from ..traits import LIKE, Tool, refuse_of

if TYPE_CHECKING:
    from .repulsion import Repulsion

STRAIN = 0.2  # largest distance of a multiple of the lattice vectors from whole numbers; the rest is a strain of the cell
NEAR = 0.5  # largest displacement as a fraction of the shortest bond: beyond it, the nearest site may be another one's
AT_SITE = 0.5  # of that: particles that are no farther from the sites of others are in another order, not in violent motion
KEPT = 4  # supercells for which a calculator is kept: tools have one or two


def whole_multiple(reference: Atoms, atoms: Atoms) -> NDArray[np.int_] | None:
    """The integer matrix T with `cell = T reference.cell` up to a strain, or None if there is none.

    The number of particles must be the same multiple. Directions that are not periodic are not repeated.
    """
    if reference.cell.rank < 3 or atoms.cell.rank < 3:
        return None
    T = atoms.cell.array @ np.linalg.inv(reference.cell.array)
    whole = np.rint(T).astype(int)
    across = np.ix_(~reference.pbc, ~reference.pbc)
    fits = abs(T - whole).max() <= STRAIN and round(abs(np.linalg.det(whole))) * len(reference) == len(atoms)
    return whole if fits and (whole[across] == np.eye(3, dtype=int)[across]).all() else None


def sites_of(calc: Repulsion, atoms: Atoms) -> Atoms:
    """The sites of the calculator's lattice in the order of `atoms`, unstrained, each in the image nearest to its particle."""
    reference, n = calc.reference, len(calc.reference)
    T = whole_multiple(reference, atoms)
    if T is None:
        raise ValueError(f'the calculator was made for {n} particles, not {len(atoms)} in a cell that is no whole multiple of '
                         'its own along its periodic directions; make one for this structure')
    cell = reference.cell.array
    inverse = np.linalg.inv(cell)
    at = atoms.cell.scaled_positions(atoms.positions) @ T  # in the vectors of the reference, without strain
    home = np.floor(reference.positions @ inverse)  # the sites may lie outside the cell
    sites = reference.positions - home @ cell
    images = np.indices((3, 3, 3)).reshape(3, -1).T - 1
    inside = np.floor(at).astype(int)
    away, found = KDTree((sites + (images @ cell)[:, None]).reshape(-1, 3)).query((at - inside) @ cell)
    bond = calc.bonds.shortest
    for k in np.flatnonzero(~(away <= NEAR * bond))[:1]:
        raise ValueError(f'particle {k} is {away[k]:.4g} mm from the nearest site of the lattice, more than half the shortest '
                         f'bond of {bond:.4g} mm, so its site is ambiguous; use calculator.on(supercell) with the '
                         'particles in their places')
    site, period = found % n, inside + images[found // n]
    within = period - np.floor(period @ np.linalg.inv(T) + 1e-9).astype(int) @ T  # of the supercell
    one, which, count = np.unique(np.column_stack([site, within]), axis=0, return_inverse=True, return_counts=True)
    if len(one) < len(atoms):
        first, second = np.flatnonzero(which.ravel() == count.argmax())[:2]
        raise ValueError(f'the particles {first} and {second} are at one site of the lattice, and another site is empty; a '
                         'supercell has one particle at each')
    placed = atoms.copy()
    placed.set_constraint()
    placed.set_cell(T @ cell)
    placed.pbc = reference.pbc
    placed.positions = sites[site] + period @ cell
    return placed


def strayed(calc: Repulsion, atoms: Atoms) -> bool:
    """Whether some particle, apart from a strain, is too far from the site of the same index to belong to it."""
    return bool(np.linalg.norm(calc.displacements(own_cell(calc, atoms)), axis=1).max(initial=0.0) > calc.near)


def own_cell(calc: Repulsion, atoms: Atoms) -> Atoms:
    """A copy of the atoms, scaled to the cell of the calculator's reference."""
    here = atoms.copy()
    here.set_cell(calc.reference.cell, scale_atoms=True)
    return here


OTHERS = Tool('a tool that displaces particles of its own supercells', __name__, frozenset(('all neighbours', *LIKE)))


def fitted(calc: Repulsion, atoms: Atoms) -> tuple[Repulsion, Atoms]:
    """The calculator for `atoms`, which is `calc` or its copy on this supercell; and the atoms with its periodicity."""
    own = calc.reference
    if len(atoms) == len(own) or not (atoms.pbc >= own.pbc).all():  # this runs at every step, so cheap checks come first
        return calc, atoms  # the calculator refuses other atoms
    T = whole_multiple(own, atoms)
    if T is None:
        return calc, atoms
    refuse_of(own, calc, OTHERS)
    atoms = atoms.copy()
    atoms.pbc = own.pbc
    for on in calc.supercells:
        if np.array_equal(on.reference.cell.array, T @ own.cell.array) and not strayed(on, atoms):
            return on, atoms
    calc.supercells.insert(0, calc.on(sites_of(calc, atoms)))
    del calc.supercells[KEPT:]
    return calc.supercells[0], atoms


def jumped(calc: Repulsion, atoms: Atoms) -> bool:
    """Whether a particle is farther from where the last call saw it than particles move between calls."""
    own, before = calc.reference, calc.seen
    if before is None or len(before) != len(own):
        before = own.positions
    if len(atoms) != len(own) or not abs(atoms.positions - before).max(initial=0.0) > calc.near:  # asked at each call
        return False
    # motion may lead to the sites of others
    return calc.seen is None or not (atoms.has('momenta') and atoms.get_momenta().any())


def refuse_another_order(calc: Repulsion, atoms: Atoms) -> None:
    """Raise ValueError if the particles are in another order than in the reference, such as sorted by symbol.

    Particles may change places over many calls. But if all are at sites of the lattice, some at those of others, from one call
    to the next, they were reordered, unless all moved together.
    """
    own = calc.reference
    if atoms.cell.rank != own.cell.rank or (atoms.pbc != own.pbc).any() or not strayed(calc, atoms):
        return

    def places(of):
        found = np.linalg.solve(of.cell.complete().array.T, of.positions.T).T
        return np.where(own.pbc, found % 1.0 % 1.0, found)  # twice: -1e-17 % 1 is 1

    here, sites = places(atoms), places(own)
    site = np.asarray(KDTree(sites, boxsize=own.pbc.astype(float)).query(here)[1])
    back = here - sites[site]
    away = np.linalg.norm((back - np.rint(back) * own.pbc) @ own.cell.complete().array, axis=1)
    u = calc.displacements(own_cell(calc, atoms))
    together = np.linalg.norm(u - u[0], axis=1).max() <= calc.near
    others = np.flatnonzero(site != np.arange(len(own)))
    if len(others) and not together and away.max() <= AT_SITE * calc.near and len(np.unique(site)) == len(own):
        k = others[0]
        raise ValueError(f'the particles are in another order than in the calculator: particle {k} is at the site of particle '
                         f'{site[k]}; put the particles into the order of the calculator, or make a calculator for these '
                         'positions, PairCalculator(atoms, law, ...), or for a periodic cell atoms.calc.on(atoms)')
