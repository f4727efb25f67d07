"""The tables of a scene that is written from atoms with their calculator."""

from __future__ import annotations

from typing import Any

from ase import Atoms

from ..bands.bands import band_path
from ..bands.force_constants import enough_cells
from ..interactions.bond_laws import laws_from_dict, laws_to_dict
from ..stiffness.repulsion import Repulsion

POINTS = 200
"""Wavevectors along the path of the bands."""


def checked_atoms(atoms: Atoms) -> Atoms:
    """Return the atoms, or raise ValueError if a scene cannot hold them."""
    calc: Any = getattr(atoms, 'calc', None)
    if not isinstance(calc, Repulsion):
        raise ValueError(f'a scene is made of atoms with PairCalculator or AllNeighbours, not with {calc!r}; attach either')
    laws_from_dict(laws_to_dict(calc.laws))
    calc.displacements(atoms)  # refuses atoms that are not those of the calculator
    return atoms


def tables_of(atoms: Atoms, title: str | None, file: str) -> dict[str, Any]:
    """The tables of a scene for the atoms; for periodic atoms it has bands along ASE's path through their zone."""
    held = '' if not atoms.constraints else ', some of them held'
    tables = {'title': title or f'{len(atoms)} particles from Python{held}', 'lattice': {'kind': 'file', 'file': file},
              'law': {'kind': 'saved'}}
    if atoms.pbc.any():
        try:
            path = band_path(atoms, None, POINTS)
        except ValueError:  # ASE knows no path through this zone
            return tables
        calc: Any = atoms.calc
        cells = [int(n) for n, periodic in zip(enough_cells(calc), atoms.pbc, strict=True) if periodic]
        tables['bands'] = {'path': path.path, 'points': POINTS, 'supercell': cells}
    return tables
