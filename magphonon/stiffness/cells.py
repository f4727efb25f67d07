"""Cells that change: energy and stress if the lattice vectors differ from those of the calculator's reference.

Without a foundation the energy depends on the bonds alone.  As the cell changes, the bonds join the same pairs of particles
across the same periods.  A foundation or a dead load is refused, because it is not known whether it follows the cell.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from ase.stress import full_3x3_to_voigt_6_stress

from .bond import refuse_upright
from .positions import from_reference

if TYPE_CHECKING:
    from ase import Atoms
    from numpy.typing import NDArray

    from ..lattices.bonds import Bonds
    from .calculator import MagneticRepulsion

STRETCHED = 3.0
"""Ratio of the length of a bond to its length in the reference above which the particles are no longer neighbours."""
NO_STRESS = ('the stress on a cell is defined by its bonds in the complete model; a foundation or a dead load adds external '
             "forces: use a calculator without them, or magphonon.stiffness.elastic_moduli(atoms).stress for the bonds alone")
ACROSS = 1e-9
"""Relative change of the cell across its periodic directions above which the change is not round-off."""


def measure(atoms: Atoms) -> float:
    """Length, area or volume of a cell: of a chain in mm, of a planar lattice in mm^2, of a crystal in space in mm^3."""
    periods = atoms.cell.array[atoms.pbc]
    return float(np.sqrt(np.linalg.det(periods @ periods.T)))


def same_cell(calc: MagneticRepulsion, atoms: Atoms) -> bool:
    """Whether the atoms are in the cell of the calculator's reference."""
    return np.array_equal(atoms.cell.array, calc.reference.cell.array)


def carried(calc: MagneticRepulsion, atoms: Atoms) -> tuple[Atoms, Bonds]:
    """Reference and bonds of a calculator, strained homogeneously from its cell to that of `atoms`.

    Raises
    ------
    ValueError
        If the particles have a foundation or a load, the model is not the complete one, or neighbours are torn apart.
    """
    reference, cell = calc.reference, atoms.cell
    anchored = not atoms.pbc.any() or np.any(calc.foundation) or calc.load.any()
    if anchored or len(atoms) != len(reference) or not np.array_equal(atoms.pbc, reference.pbc):
        from_reference(calc, atoms)  # says so
    if calc.model != 'complete':
        raise ValueError(f"the cell differs from the reference, where the model {calc.model!r} fixes the directions of bonds; "
                         "use model='complete', or make a calculator for this cell")
    strain = np.linalg.solve(reference.cell.complete().array, cell.complete().array)
    rest = reference.copy()
    rest.set_cell(cell)
    rest.positions = reference.positions @ strain
    bonds = replace(calc.bonds, vectors=calc.bonds.vectors @ strain, cutoff=None)
    for b in np.flatnonzero(bonds.lengths > STRETCHED * calc.bonds.lengths)[:1]:
        raise ValueError(f'the cell has grown until the particles {bonds.i[b]} and {bonds.j[b]} are {bonds.lengths[b]:.4g} mm '
                         f'apart instead of {calc.bonds.lengths[b]:.4g} mm and no longer neighbours: only a pressure holds a '
                         'lattice of repelling particles together; give one, as scalar_pressure= to FrechetCellFilter')
    return rest, bonds


def bond_virial(calc: MagneticRepulsion, u: NDArray[np.float64] | float = 0.0) -> NDArray[np.float64]:
    """Derivative of the energy of the bonds by the strain, `sum phi'/r R(x)R`, in mJ, shape (dim, dim).

    Parameters
    ----------
    calc : MagneticRepulsion
    u : ndarray, shape (particles, dim)
        Displacements from the reference in mm; none by default.
    """
    R = calc.bond_vectors + (calc.bonds.incidence @ u if np.ndim(u) else 0.0)
    refuse_upright(R, calc.law, 'stresses')
    r = np.linalg.norm(R, axis=1)
    return np.einsum('b,bx,by->xy', calc.law.dphi(r) / r, R, R)


def stress_per_volume(calc: MagneticRepulsion, atoms: Atoms) -> NDArray[np.float64]:
    """Stress as defined by ASE, `dE/d strain` divided by the volume of the cell, in N/mm^2, Voigt's order xx, yy, zz, yz, xz, xy.

    It is negative where particles repel each other.  The volume contains the height of a planar cell, which has no physical
    meaning: `magphonon.stiffness.cauchy_stress` is the force per length.

    Raises
    ------
    ValueError
        If nothing is periodic, or the vectors across the periodic directions are missing or differ from those of the reference.
    """
    if not (atoms.pbc.any() and atoms.cell.rank == 3):
        raise ValueError('a stress as defined by ASE is a force per area of a periodic cell with a volume; give the cell three '
                         'vectors (the length of the one across a planar lattice only divides the stress)')
    before, after = (abs(np.linalg.det(at.cell.array)) / measure(at) for at in (calc.reference, atoms))
    if abs(after - before) > ACROSS * before:
        raise ValueError(f'across its periodic directions the cell changes from {before:.6g} to {after:.6g} mm (mm^2 for '
                         'a chain), which has no meaning and would change the stress; keep these vectors: in a filter of ASE '
                         'with mask=(1, 1, 0, 0, 0, 1) for a planar lattice, (1, 0, 0, 0, 0, 0) for a chain along x, and without '
                         'hydrostatic_strain')
    here = calc if same_cell(calc, atoms) else calc.about(atoms)
    stress = np.zeros((3, 3))
    stress[: calc.dim, : calc.dim] = bond_virial(here, here.displacements(atoms)) / atoms.get_volume()
    return full_3x3_to_voigt_6_stress(stress)
