"""A strip of a lattice, in which a wave from a whole row of sources is the same as in the lattice."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from ase.constraints import FixAtoms

from ..lattices.bonds import Bonds
from ..lattices.patches import RIM
from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.repulsion import repulsion_of
from ..stiffness.sites import refuse_unlike

if TYPE_CHECKING:
    from ase import Atoms


def strip(cell: Atoms, rows: int) -> Atoms:
    """A strip one cell wide and periodic along R1, with `rows` cells along R2, of which the first and the last are held.

    A motion that is uniform along R1, such as a wave from a whole row of sources, is the same in the strip as in the lattice.

    Parameters
    ----------
    cell : ase.Atoms
        Planar, with its MagneticRepulsion.
    rows : int

    Returns
    -------
    ase.Atoms
        With its MagneticRepulsion.

    Raises
    ------
    ValueError
        If the particles differ in law, strength or foundation.
    """
    calc = repulsion_of(cell)
    refuse_unlike(calc, 'a strip', 'make it as a structure of its own, with its own calculator')
    atoms = cell.repeat((1, rows, 1))
    periodic = calc.on(atoms)
    bonds = periodic.bonds
    inside = bonds.shift[:, 1] == 0  # the other bonds join the last row to the first
    bonds = Bonds(bonds.i[inside], bonds.j[inside], bonds.shift[inside], bonds.vectors[inside], len(atoms))
    atoms.pbc = True, False, False
    row = np.repeat(np.arange(rows), len(cell))
    atoms.set_tags(np.where((row == 0) | (row == rows - 1), RIM, 0))
    atoms.set_constraint(FixAtoms(mask=atoms.get_tags() == RIM))
    atoms.calc = MagneticRepulsion(atoms, calc.law, bonds=bonds, anchors=periodic.anchors, load=periodic.load,
                                   **calc.parameters)
    return atoms
