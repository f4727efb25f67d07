"""Scene files of structures built in Python: the tables in TOML, the particles with their calculator in a .traj file."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import ase.io

from ..bands.bands import band_path
from ..bands.force_constants import enough_cells
from ..files import whole_file
from ..interactions.saved_laws import potential_from_dict, potential_to_dict
from ..stiffness.repulsion import Repulsion

if TYPE_CHECKING:
    from os import PathLike
    from typing import Any

    from ase import Atoms

POINTS = 200
"""Wavevectors along the path of the bands."""


def write_scene(atoms: Atoms, path: str | PathLike[str], title: str | None = None) -> None:
    """Write atoms with their calculator as a scene, on which every command computes to the same bits as Python does.

    Beside `path`, NAME.toml, the particles go into NAME.traj, a file of ASE, with law, bonds, foundation and anchors.

    Parameters
    ----------
    atoms : ase.Atoms
        With MagneticRepulsion or AllNeighbours.
    path : path-like
        Path of the scene file; its name ends in .toml.
    title : str, optional
        A line that says what it is.

    Raises
    ------
    ValueError
        If the atoms carry no calculator of this package, or one whose law a file cannot tell; the name ends otherwise.
    OSError
        If a file cannot be written; then none is.

    Examples
    --------
    >>> import tempfile
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, read_scene, write_scene
    >>> cell = lattices.triangular(10.0, 0.7)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1e4, 4.6), foundation=0.02)
    >>> file = tempfile.mkdtemp() + '/mine.toml'
    >>> write_scene(cell, file)
    >>> read_scene(file).lattice.kind
    'file'
    """
    path = Path(path)
    if path.suffix != '.toml':
        raise ValueError(f'a scene is a file NAME.toml, not {path.name}; the particles go into NAME.traj beside it')
    tables = tables_of(checked_atoms(atoms), title, path.with_suffix('.traj').name)
    with whole_file(path.with_suffix('.traj'), 'wb') as particles, whole_file(path) as scene:
        ase.io.write(particles, atoms, format='traj')
        scene.write(_toml(tables, f'The particles, their law, bonds and foundation are in {tables["lattice"]["file"]}, to the '
                                  f'last bit: {atoms.calc!r}'))


def checked_atoms(atoms: Atoms) -> Atoms:
    """The atoms, if a scene can hold them.

    Raises
    ------
    ValueError
        If they carry no calculator of this package, or one whose law a file cannot tell.
    """
    calc: Any = atoms.calc
    if not isinstance(calc, Repulsion):
        raise ValueError(f'a scene is made of atoms with MagneticRepulsion or AllNeighbours, not with {calc!r}; attach one')
    potential_from_dict(potential_to_dict(calc.potential))
    calc.displacements(atoms)  # refuses atoms that are not those of the calculator
    return atoms


def tables_of(atoms: Atoms, title: str | None, file: str) -> dict[str, Any]:
    """The tables of the scene of some atoms; periodic ones have bands along ASE's path through their zone."""
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


def _toml(tables, comment):
    lines = [f'# {line}' for line in comment.splitlines()]
    lines += [f'{key} = {json.dumps(value)}' for key, value in tables.items() if not isinstance(value, dict)]
    for name, table in tables.items():
        if isinstance(table, dict):
            lines += ['', f'[{name}]', *(f'{key} = {json.dumps(value)}' for key, value in table.items())]
    return '\n'.join(lines) + '\n'
