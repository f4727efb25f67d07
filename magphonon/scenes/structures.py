"""Structures other than perfect lattices. The table [lattice] of the kind "file" reads your own particles from a file beside the
scene. The table [defects] removes particles from a patch or such a structure.
"""

from __future__ import annotations

import warnings
from copy import deepcopy
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from ase import Atoms
from ase.constraints import FixAtoms
from ase.dft.kpoints import BandPath
from ase.geometry import find_mic
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field, PrivateAttr, ValidationInfo, model_validator

from .. import units as u
from ..bands.bands import band_path
from ..errors import one_of
from ..files import MEGABYTE, refuse_endless
from ..quantities import LENGTH, MASS, PURE, STIFFNESS
from ..stiffness.all_neighbours import nearest_distance
from ..stiffness.defects import with_vacancies
from ..stiffness.relaxation import relaxed
from ..stiffness.repulsion import Repulsion
from ..stiffness.rest import freedom
from ..stiffness.restart import restored
from ..tables import read_table
from .fields import Length, Mass, Points, Table, Text

PIXEL = {'px': 1.0}  # of an image, whose y runs downwards
COLUMNS = {'x': LENGTH | PIXEL, 'y': LENGTH | PIXEL, 'z': LENGTH, 'held': PURE, 'mass': MASS, 'strength': PURE,
           'stiffness': STIFFNESS, 'relative_damping': PURE}
LAYOUT = ('a table of particles has the columns x_m,y_m (or x_mm,y_mm, or of a photo x_px,y_px) and, where wanted, '
          'z_m,held,mass_kg,strength,stiffness_N_per_m,relative_damping')
MOST_BYTES = 100 * MEGABYTE
"""Largest size of a file of particles."""
FARTHEST = 1e6 * u.m  # largest coordinate; what is farther is in another unit
NEAREST_m = 1e-6, 1e6
"""Range of the distance of nearest particles, as of `lattice.spacing_m`; beyond it a unit is wrong."""
OF_ASE = {'held': 'a constraint, move_mask in .extxyz', 'mass_kg': 'masses, in g',
          'stiffness_N_per_m': 'stiffness, in N/mm'}
"""Columns of tables, and what a file that ASE reads has in their place."""


def read_particles(path: Path) -> Atoms:
    """The particles of a table of text, without a cell.

    Held particles get FixAtoms; 'strength', 'stiffness' (N/mm) and 'relative_damping' are arrays if the
    table has these columns.
    """
    table = read_table(path, COLUMNS, ['x', 'y'], others=False, layout=LAYOUT, most=MOST_BYTES)
    if (table.told['x'].unit == 'px') != (table.told['y'].unit == 'px'):
        raise ValueError(f'{path} has the columns {table.named("x", "y")}; give both in pixels or none')
    for name in 'xyz':
        table.refuse(name, abs(table.get(name, 0.0)) > FARTHEST, 'lie within 1e6 m')
    for name, wrong, must in (('held', lambda x: (x != 0) & (x != 1), 'be 0 or 1'), ('mass', lambda x: x <= 0, 'be positive'),
                              ('stiffness', lambda x: x < 0, 'not be negative'),
                              ('relative_damping', lambda x: x < 0, 'not be negative')):
        table.refuse(name, wrong(table.get(name, 1.0)), must)
    atoms = Atoms(['Nd'] * len(table), positions=np.stack([table['x'], table['y'], table.get('z', 0.0)], axis=1))
    if 'mass' in table:
        atoms.set_masses(table['mass'])  # pyright: ignore[reportArgumentType]  ASE declares text
    if table.get('held', 0).any():
        atoms.set_constraint(FixAtoms(mask=table['held'] == 1))
    for name in ('strength', 'stiffness', 'relative_damping'):
        if name in table:
            atoms.set_array(name, table[name])
    atoms.info['pixels'] = table.told['x'].unit == 'px'
    return atoms


class FileLattice(Table):
    """Particles of your own in a file, with their cell if they have one: a lattice, a ribbon, a finite structure."""

    bonds: ClassVar = None
    relative_masses: ClassVar = None

    kind: Literal['file']
    file: Text = Field(description='the file with the particles, beside the scene: a table .csv with the columns x_m,y_m and, '
                       'where wanted, held,mass_kg,strength,stiffness_N_per_m,relative_damping (or x_mm, mass_g and so on; '
                       'x_px,y_px of a photo), or any file that ASE reads, in mm and g',
                       examples=['particles.csv'])
    mass_kg: Mass | None = Field(None, description='the mass of every particle in kg, where the file has none', examples=[0.0007])
    cell_m: Points | None = Field(None, description='the one or two lattice vectors [x, y] of a table .csv in m; without them '
                                  'the table is a finite structure', examples=[[[0.01, 0.0], [0.0, 0.01]]])
    cutoff_m: Length | None = Field(None, description='the distance within which particles interact, in place of shells of '
                                    'neighbours, which irregular positions do not have', examples=[0.012])
    positions: Annotated[Literal['anchors', 'rest'], BeforeValidator(partial(one_of, '', choices=('anchors', 'rest')))] | None = (
        Field(None, description='what the positions are: "anchors", the feet of the pillars, from which the particles first '
                                'move to rest, or "rest", the positions of the particles in a photo: they stay there, and '
                                'constant forces represent the bent pillars', examples=['rest']))
    points_px: Points | None = Field(None, description='for a table with x_px,y_px: two points [x, y] in the photo, far apart, '
                                     'in pixels from its upper left corner', examples=[[[212, 1810], [2840, 1790]]])
    points_m: Points | None = Field(None, description='the positions [x, y] in m of the two points in points_px, which give the '
                                                      'scale and the rotation of the photo', examples=[[[0.0, 0.0], [0.1, 0.0]]])
    _atoms: Any = PrivateAttr(None)
    _cutoff: float | None = PrivateAttr(None)  # in mm, chosen where neither cutoff_m nor the law says it

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
                return self._with_cell(self._from_photo(read_particles(path)))
            for name in ('cell_m', 'points_px', 'points_m'):
                if getattr(self, name) is not None:
                    has = 'a cell' if name == 'cell_m' else 'lengths'
                    raise ValueError(f'{path} has {has} of its own; remove {name}')
            atoms = _read_by_ase(path)
            for name, instead in OF_ASE.items():
                if atoms.has(name):
                    raise ValueError(f'{path} has the column {name}, which only tables .csv may have; in a file of ASE it is '
                                     f'{instead}')
            return atoms
        except OSError as error:
            raise ValueError(f'.file: {path} cannot be read ({error.strerror}); it is looked for beside the scene') from None
        except ValueError as error:
            raise ValueError(f'.file: {error}') from None

    def _from_photo(self, atoms: Atoms) -> Atoms:
        """The particles in mm; if the table is in pixels, two known points give scale, rotation and position of the photo."""
        points = [getattr(self, name) for name in ('points_px', 'points_m')]
        if not atoms.info.pop('pixels'):
            if points != [None, None]:
                raise ValueError('points_px and points_m belong to a table with the columns x_px,y_px; remove them')
            return atoms
        if None in points or any(len(pair) != 2 or pair[0] == pair[1] for pair in points):
            raise ValueError('the columns x_px,y_px are pixels of a photo; give the pixels of two known points, points_px = '
                             '[[x, y], [x, y]], and their positions in metres, points_m = [[x, y], [x, y]]')
        z, (z1, z2) = atoms.positions[:, :2] @ [1, -1j], np.array(points[0]) @ [1, -1j]  # y runs downwards in a photo
        w1, w2 = np.array(points[1]) @ [1, 1j] * u.m
        w = w1 + (w2 - w1) / (z2 - z1) * (z - z1)
        atoms.positions[:, :2] = np.stack([w.real, w.imag], axis=1)
        return atoms

    def _with_cell(self, atoms: Atoms) -> Atoms:
        """The particles of a table with the lattice vectors of the scene; further vectors complete the cell in space."""
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

    def _check(self) -> None:
        atoms = self._atoms
        if not len(atoms):
            raise ValueError('.file holds no particles')
        if atoms.has('masses') == (self.mass_kg is not None):
            raise ValueError('.mass_kg: the file has masses of its own; remove mass_kg' if self.mass_kg is not None else
                             '.mass_kg is missing, and the file has no masses either; give the mass of a particle in kg')
        if not np.isfinite(atoms.positions).all():
            raise ValueError('.file holds a position that is not finite')
        try:
            freedom(atoms)
        except ValueError as error:
            raise ValueError(f'.file: {error}') from None
        if len(atoms) == 1 and not atoms.pbc.any():
            raise ValueError('.file holds one particle without periodic images, so nothing acts on it; give cell_m, or more '
                             'particles')
        least, most = NEAREST_m
        if not least <= self.spacing_m <= most:
            raise ValueError(f'.file: it puts the nearest particles {self.spacing_m:.3g} m apart; this must lie between '
                             f'{least:g} and {most:g} m: check the unit of its lengths, which is mm in files that ASE reads')

    def cell(self) -> Atoms:
        """The particles, `ase.Atoms` in mm and g, with their constraints but without a calculator."""
        atoms = self._atoms.copy()
        if self.mass_kg is not None:
            atoms.set_masses([self.mass_kg * u.kg] * len(atoms))
        return atoms

    def saved(self) -> Atoms:
        """The particles with the calculator in the file."""
        if isinstance(self._atoms.calc, Repulsion):
            atoms = self._atoms.copy()
            atoms.calc = deepcopy(self._atoms.calc)
            return atoms
        try:
            return restored(self._atoms)
        except ValueError as error:
            raise ValueError(f'lattice.file = {self.file!r}: {error}') from None

    def settled(self, atoms: Atoms) -> Atoms:
        """The particles with their calculator, at rest at the positions in the file or moved to rest, as the scene says."""
        if self.positions == 'rest':
            atoms.calc = atoms.calc.balanced(np.flatnonzero(freedom(atoms)[0]))
            return atoms
        return relaxed(atoms).atoms if self.positions == 'anchors' else atoms

    @property
    def cutoff(self) -> float | None:
        """Distance in mm within which particles repel, if it is given or was chosen."""
        return self._cutoff if self.cutoff_m is None else self.cutoff_m * u.m

    @property
    def spacing_given(self) -> str:
        """The key that sets the spacing, and its value, for a message."""
        return f'lattice.file = {self.file!r}, whose nearest particles are {self.spacing_m:.6g} m apart'

    @property
    def finite(self) -> bool:
        """Whether the structure is not periodic in any direction."""
        return not self._atoms.pbc.any()

    @property
    def spacing_m(self) -> float:
        """Distance of nearest particles in m."""
        return nearest_distance(self._atoms) / u.m

    def path(self, points: str | None, npoints: int) -> BandPath:
        """Path through special points, `ase.dft.kpoints.BandPath`."""
        return band_path(self.cell(), points, npoints)


def _read_by_ase(path):
    import ase.io

    try:
        with warnings.catch_warnings():
            warnings.simplefilter('ignore')  # of formats and of what a file lacks
            frames: Any = ase.io.read(path, index=':', do_not_split_by_at_sign=True)
        last = frames[-1]  # there may be none, as in data of LAMMPS in a style that ASE does not know
    except Exception as error:  # ASE's readers may raise anything
        raise ValueError(f'ASE reads no structure in {path} ({type(error).__name__}: {error}); give one in a format of '
                         'ASE, such as .xyz, .cif or POSCAR, or a table .csv of positions') from None
    if len(frames) > 1:
        warnings.warn(f'{path} is a film of {len(frames)} frames; the scene takes the last one', stacklevel=2)
    return last


class Defects(Table):
    """Missing particles of the patch or of the finite structure, which then relaxes; places are those before it relaxes."""

    vacancies_m: Points = Field(description='positions [x, y] in m; the particle nearest to each is removed',
                                examples=[[[0.0, 0.0]]])

    def applied(self, atoms: Atoms) -> Atoms:
        """The structure with these defects, not yet at rest."""
        missing = [nearest_site(f'defects.vacancies_m[{k}]', atoms, place) for k, place in enumerate(self.vacancies_m)]
        for k in {site for site in missing if missing.count(site) > 1}:
            x, y = atoms.positions[k, :2] / u.m
            raise ValueError(f'defects names the particle at [{x:.6g}, {y:.6g}] twice; keep one of them')
        return with_vacancies(atoms, missing)

    def places(self, atoms: Atoms) -> NDArray[np.float64]:
        """Positions of the defects in the perfect structure `atoms` in mm, shape (defects, 2)."""
        return np.array([atoms.positions[nearest_site('', atoms, place), :2] for place in self.vacancies_m])


def nearest_site(key: str, atoms: Atoms, place: tuple[float, float]) -> int:
    """The particle nearest to a place [x, y] in m; ValueError, which names the `key`, if it is held or the place is outside."""
    away = atoms.positions - np.array([*place, 0]) * u.m
    away[:, 2] = 0
    distances = find_mic(away, atoms.cell, atoms.pbc)[1]  # pyright: ignore[reportArgumentType]  three pbc
    nearest = int(np.argmin(distances))
    x, y = atoms.positions[nearest, :2] / u.m
    if distances[nearest] > atoms.calc.bonds.lengths.min():
        raise ValueError(f'{key} = {list(place)} is outside the structure; the nearest particle is at [{x:.6g}, {y:.6g}]')
    if not freedom(atoms)[0][nearest]:
        raise ValueError(f'{key} = {list(place)} is nearest to the held particle at [{x:.6g}, {y:.6g}]; '
                         'choose a place further inside')
    return nearest
