"""The table [lattice] of the kind "file": particles of your own, from a file beside the scene."""

from __future__ import annotations

import warnings
from copy import deepcopy
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, PrivateAttr, ValidationInfo, computed_field, model_validator

from .. import units as u
from ..bands.bands import band_path
from ..dynamics.fingerprints import fingerprint
from ..lattices.pairs import distances_within
from ..stiffness.constraints import freedom
from ..stiffness.repulsion import Repulsion
from ..stiffness.restart import restored
from ..stiffness.restartable import Restartable
from ..textfiles import refuse_endless
from .fields import Flag, Length, Mass, Points, Positive, Table, Text, within
from .particle_tables import MOST_BYTES, read_particles

if TYPE_CHECKING:
    from ase import Atoms
    from ase.dft.kpoints import BandPath

NEAREST_m = 1e-6, 1e6
"""Range of the distance of nearest particles, as of `lattice.spacing_m`; beyond it a unit is wrong."""
OF_ASE = {'kind': 'tags', 'held': 'a constraint, move_mask in .extxyz', 'mass_kg': 'masses, in g',
          'stiffness_N_per_m': 'stiffness, in N/mm'}
"""Columns of tables, and what a file that ASE reads has in their place."""
PACKAGE_UNIT_m = 1e-3
"""The unit of length of this package's own Atoms, mm."""


class FileLattice(Table):
    """Particles of your own in a file, with their cell if they have one: a lattice, a ribbon, a finite structure."""

    bonds: ClassVar = None
    relative_masses: ClassVar = None

    kind: Literal['file']
    file: Text = Field(description='the file with the particles, beside the scene: a table .csv with the columns x_m,y_m and, '
                       'where wanted, kind,held,mass_kg,strength,stiffness_N_per_m, or any file that ASE reads',
                       examples=['particles.csv'])
    length_unit_m: Annotated[Positive, within(1e-12, 1e6, 'metres')] = Field(
        PACKAGE_UNIT_m, description='what one unit of length in an ASE file is, in m; files that Python wrote with this package '
        'are in mm, and masses in them in g', examples=[0.001])
    mass_kg: Mass | None = Field(None, description='the mass of every particle in kg, where the file has none', examples=[0.0007])
    cell_m: Points | None = Field(None, description='the one or two lattice vectors [x, y] of a table .csv in m; without them it '
                                  'is a finite structure', examples=[[[0.01, 0.0], [0.0, 0.01]]])
    planar: Flag = Field(False, description='whether the third vector of an ASE file is no period, as of a layer in a .cif',
                         examples=[True])
    cutoff_m: Length | None = Field(None, description='the distance within which particles repel, in place of the shells of '
                                    'the law, which scattered positions do not have', examples=[0.012])
    relaxed: Flag = Field(False, description='whether the particles move to where their forces balance before all else',
                          examples=[True])

    _atoms: Any = PrivateAttr(None)

    @model_validator(mode='after')
    def _read(self, info: ValidationInfo):
        context = info.context or {}
        self._atoms = context['structure'] if 'structure' in context else self._structure(context.get('folder', Path()))
        self._check()
        return self

    def _structure(self, folder: Path) -> Atoms:
        path = folder / self.file
        try:
            refuse_endless(path, MOST_BYTES)
            if path.suffix.lower() == '.csv':
                return self._with_cell(read_particles(path))
            for key in ('cell_m',):
                if getattr(self, key) is not None:
                    raise ValueError(f'{path} has a cell of its own; take {key} out')
            return self._in_mm(_without_columns_of_tables(_read_by_ase(path), path))
        except OSError as error:
            raise ValueError(f'.file: {path} cannot be read ({error.strerror}); it is sought beside the scene') from None
        except ValueError as error:
            raise ValueError(f'.file: {error}') from None

    def _with_cell(self, atoms: Atoms) -> Atoms:
        """A table's particles with the lattice vectors of the scene; the vectors that are no period make a cell in space."""
        if self.planar or self.length_unit_m != PACKAGE_UNIT_m:
            raise ValueError('a table .csv is in metres and in the plane; take length_unit_m and planar out')
        extent = float(np.linalg.norm(np.ptp(atoms.positions, axis=0))) or u.m
        vectors = np.array(self.cell_m or np.zeros((0, 2))) * u.m
        if len(vectors) > 2:
            raise ValueError(f'cell_m must hold one or two vectors [x, y], not {len(vectors)}')
        if not len(vectors):
            return atoms
        cell = np.zeros((3, 3))
        cell[: len(vectors), :2] = vectors
        if len(vectors) == 1:
            cell[1, :2] = np.array([-vectors[0, 1], vectors[0, 0]]) / np.linalg.norm(vectors[0]) * 2 * extent
        cell[2, 2] = 2 * np.linalg.norm(cell[0])  # phonopy wants three vectors
        atoms.set_cell(cell)
        atoms.pbc = [True, len(vectors) == 2, False]
        return atoms

    def _in_mm(self, atoms: Atoms) -> Atoms:
        factor = self.length_unit_m * u.m  # one, to the last bit, for mm
        if factor != 1:
            atoms.calc = None  # of other units
            atoms.positions *= factor
            atoms.set_cell(atoms.cell.array * factor)
        if self.planar:
            atoms.pbc[2] = False
        return atoms

    def _check(self) -> None:
        atoms = self._atoms
        if not len(atoms):
            raise ValueError('.file holds no particles')
        if atoms.has('masses') == (self.mass_kg is not None):
            raise ValueError('.mass_kg: the file has masses of its own; take it out' if self.mass_kg is not None else
                             '.mass_kg is missing, and the file has no masses either; give the mass of a particle in kg')
        if not np.isfinite(atoms.positions).all():
            raise ValueError('.file holds a position that is not finite')
        try:
            freedom(atoms)
        except ValueError as error:
            raise ValueError(f'.file: {error}') from None
        if len(atoms) == 1 and not atoms.pbc.any():
            raise ValueError('.file holds one particle without periodic images, and nothing repels it; give cell_m, or more '
                             'particles')
        least, most = NEAREST_m
        if not least <= self.spacing_m <= most:
            unit = '' if Path(self.file).suffix.lower() == '.csv' else f'length_unit_m = {self.length_unit_m!r} makes '
            raise ValueError(f'.file: {unit}the nearest particles {self.spacing_m:.3g} m apart; this must lie between {least:g} '
                             f'and {most:g} m: check the unit of its lengths')

    def cell(self) -> Atoms:
        """The particles, `ase.Atoms` in mm and g, with what holds them but without a calculator."""
        atoms = self._atoms.copy()
        if self.mass_kg is not None:
            atoms.set_masses([self.mass_kg * u.kg] * len(atoms))
        return atoms

    def saved(self) -> Atoms:
        """The particles with the calculator in the file.

        Raises
        ------
        ValueError
            If there is none.
        """
        if isinstance(self._atoms.calc, Repulsion):
            atoms = self._atoms.copy()
            atoms.calc = deepcopy(self._atoms.calc)
            return atoms
        return restored(self._atoms)

    @property
    def cutoff(self) -> float | None:
        """Distance in mm within which particles repel, if it is given."""
        return None if self.cutoff_m is None else self.cutoff_m * u.m

    @property
    def spacing_given(self) -> str:
        """Where the spacing stands and its value, for a message."""
        return f'lattice.file = {self.file!r}, whose nearest particles are {self.spacing_m:.6g} m apart'

    @property
    def least_mass_kg(self) -> float:
        """Mass of the lightest particle in kg."""
        return float(self.cell().get_masses().min()) / u.kg

    @property
    def finite(self) -> bool:
        """Whether it has no period."""
        return not self._atoms.pbc.any()

    @property
    def spacing_m(self) -> float:
        """Distance of nearest particles in m."""
        atoms = self._atoms
        own = np.concatenate([atoms.positions[1:] - atoms.positions[0], atoms.cell.array[atoms.pbc]])
        return float(distances_within(atoms, np.linalg.norm(own, axis=1).min() * (1 + 1e-9)).min()) / u.m

    @computed_field
    @property
    def contents(self) -> str:
        """Fingerprint of all that the file says, by which results know of which structure they are."""
        atoms, calc = self._atoms, self._atoms.calc
        calculator = calc.todict() if isinstance(calc, Restartable) else getattr(calc, 'parameters', None)
        return fingerprint([atoms.cell.array, atoms.pbc, atoms.arrays, [held.todict() for held in atoms.constraints], calculator])

    def path(self, points: str | None, npoints: int) -> BandPath:
        """Path through special points, `ase.dft.kpoints.BandPath`."""
        return band_path(self.cell(), points, npoints)


def _without_columns_of_tables(atoms, path):
    """The particles, if none of their arrays has the name of a column of tables .csv that in a file of ASE means nothing."""
    for name, instead in OF_ASE.items():
        if atoms.has(name):
            raise ValueError(f'{path} has the column {name}, which is one of tables .csv; in a file of ASE it is '
                             f'{instead}')
    return atoms


def _read_by_ase(path):
    import ase.io

    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of formats and of what a file lacks
            found: Any = ase.io.read(path, index=-1)
    except Exception as error:  # ASE's readers raise what they will
        raise ValueError(f'ASE reads no structure in {path} ({type(error).__name__}: {error}); it may be a table .csv of '
                         'positions in metres instead') from None
    return found
