"""Scene files: somebody's lattice in TOML, SI units in the keys, read, checked and built as ASE Atoms.

This is the border: fields are in SI, what the methods return is in mm, g and ms.  Every table of a scene is a frozen
model; a new table is a new class and one line in `Scene`.
"""

import csv
import tomllib
from difflib import get_close_matches
from functools import partial
from importlib.resources import files
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from ase.dft.kpoints import BandPath, parse_path_string
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, ValidationInfo, model_validator

from . import lattices
from . import units as u
from .calculator import MagneticRepulsion
from .errors import not_negative, one_of, positive, whole
from .potentials import InversePower, Tabulated, Yukawa

LATTICES = ('chain', 'square', 'triangular', 'honeycomb', 'kagome')
SPACINGS_m = 1e-6, 1e6
"""Sizes of a lattice: phonopy takes particles closer than 1e-5 mm for one, and writes ten decimals."""
FREQUENCIES_Hz = 1e-9, 1e12
"""Beyond these a unit or an exponent is wrong, and squares and powers soon leave the range of numbers."""


# A check says what is wrong with a value, from its name on; `_fault` knows the tables that hold it and puts the name in front.
def _text(value):
    if not isinstance(value, str) or not value.strip():
        raise ValueError(f' must be text in quotes, not {value!r}')
    return value


def _list(value):
    if not isinstance(value, list):
        raise ValueError(f' must be a list in brackets, not {value!r}')
    return value


def _spacing(value):
    spacing, (least, most) = positive('', value), SPACINGS_m
    if not least <= spacing <= most:
        raise ValueError(f' must lie between {least:g} and {most:g}, not {value!r}; it is in metres')
    return spacing


Positive = Annotated[float, BeforeValidator(partial(positive, ''))]
NotNegative = Annotated[float, BeforeValidator(partial(not_negative, ''))]
Count = Annotated[int, BeforeValidator(partial(whole, ''))]
AtLeastTwo = Annotated[int, BeforeValidator(partial(whole, '', least=2))]
Spacing = Annotated[float, BeforeValidator(_spacing)]
Text = Annotated[str, BeforeValidator(_text)]
Numbers = Annotated[tuple[Positive, ...], BeforeValidator(_list)]
Counts = Annotated[tuple[Count, ...], BeforeValidator(_list)]
LatticeKind = Annotated[str, BeforeValidator(partial(one_of, '', choices=LATTICES))]
Shells = Annotated[Count, Field(description='the number of shells of neighbours that interact')]


class Table(BaseModel):
    """One table of a scene: its keys are the fields, no others, and it does not change once read."""

    model_config = ConfigDict(extra='forbid', frozen=True)

    @model_validator(mode='before')
    @classmethod
    def _keys(cls, table):
        if not isinstance(table, dict):
            raise ValueError(f' must be a table in brackets with the keys {", ".join(cls.model_fields)}, not {table!r}')
        for key in table:
            if key not in cls.model_fields:
                near = get_close_matches(key, cls.model_fields, 1)
                mend = f'did you mean {near[0]!r}?' if near else f'its keys are {", ".join(cls.model_fields)}'
                raise ValueError(f' has no key {key!r}; {mend}')
        for key, field in cls.model_fields.items():
            if field.is_required() and key not in table:
                raise ValueError(f' lacks the key {key!r}; add {field.description}')
        return table


class Lattice(Table):
    """Geometry and mass, equal particles at the nearest-neighbour distance `spacing_m`."""

    kind: LatticeKind = Field(description='one of ' + ', '.join(LATTICES))
    spacing_m: Spacing = Field(description='the distance between nearest neighbours in m')
    mass_kg: Positive = Field(description='the mass of a particle in kg')

    def cell(self):
        """The unit cell, `ase.Atoms` in mm and g."""
        return getattr(lattices, self.kind)(self.spacing_m * u.m, self.mass_kg * u.kg)

    def path(self, points, npoints):
        """Path through special points, `ase.dft.kpoints.BandPath`."""
        # drawn on a cell of 1 mm, where fractions are the same: ASE 3.29 recognises no lattice below some 0.01 of its units
        like = getattr(lattices, self.kind)(1.0, 1.0)
        path = like.cell.bandpath(points, npoints=npoints, pbc=like.pbc)
        return BandPath(self.cell().cell, path.kpts, path.special_points, path.path)


class InversePowerLaw(Table):
    """Force `b r^-a`."""

    kind: Literal['inverse_power']
    b_N_m_a: Positive = Field(description='b of the force b r^-a in N m^a')
    a: Positive = Field(description='the exponent a of the force b r^-a')
    shells: Shells

    def potential(self):
        return InversePower(self.b_N_m_a * u.N * u.m**self.a, self.a)


class DipoleLaw(Table):
    """Point dipoles normal to the plane."""

    kind: Literal['dipoles']
    moment_A_m2: Positive = Field(description='the magnetic moment of a particle in A m^2')
    shells: Shells

    def potential(self):
        return InversePower.dipoles(self.moment_A_m2 * u.A * u.m**2)


class YukawaLaw(Table):
    """Energy `strength/r exp(-r/screening length)`."""

    kind: Literal['yukawa']
    strength_J_m: Positive = Field(description='the strength c of the energy c/r exp(-r/l) in J m')
    screening_length_m: Positive = Field(description='the screening length l of the energy c/r exp(-r/l) in m')
    shells: Shells

    def potential(self):
        return Yukawa(self.strength_J_m * u.J * u.m, 1 / (self.screening_length_m * u.m))


class TableLaw(Table):
    """Measured forces, in the scene or in a `file` beside it."""

    kind: Literal['table']
    distances_m: Numbers = Field(description="the distances in m, increasing, or file = 'law.csv' with the columns r_m,f_N")
    forces_N: Numbers = Field(description='the forces in N at these distances')
    file: Text | None = None
    shells: Shells

    @model_validator(mode='before')
    @classmethod
    def _columns(cls, table, info: ValidationInfo):
        if not isinstance(table, dict) or 'file' not in table:
            return table
        if not isinstance(table['file'], str):
            raise ValueError(f'.file must be the name of a file in quotes, not {table["file"]!r}')
        for key in table.keys() & {'distances_m', 'forces_N'}:
            raise ValueError(f' has both file and {key}; keep one of them')
        return table | _read_columns(info.context['folder'], table['file'])

    @model_validator(mode='after')
    def _smooth(self):
        try:
            self.potential()
        except ValueError as error:
            raise ValueError(f': {error}') from None
        return self

    def potential(self):
        return Tabulated(np.array(self.distances_m) * u.m, np.array(self.forces_N) * u.N)


def _read_columns(folder, name):
    """Distances and forces from a CSV file with the header r_m,f_N."""
    try:
        with open(folder / name, newline='') as file:
            header, *rows = list(csv.reader(file)) or [[]]
        if [title.strip() for title in header] != ['r_m', 'f_N']:
            raise ValueError(f'its header is {",".join(header)!r}')
        return {'distances_m': [float(r) for r, _ in rows], 'forces_N': [float(f) for _, f in rows]}
    except OSError as error:
        reason = error.strerror
    except ValueError as error:
        reason = error
    raise ValueError(f'.file = {name!r} cannot be used ({reason}); '
                     'it needs the header r_m,f_N and two columns of numbers, beside the scene')


LAWS = {'inverse_power': InversePowerLaw, 'dipoles': DipoleLaw, 'yukawa': YukawaLaw, 'table': TableLaw}


def _known_law(table):
    if not isinstance(table, dict) or 'kind' not in table:
        raise ValueError(f" must be a table [law] with a kind, one of {', '.join(LAWS)}, not {table!r}")
    one_of('.kind', table['kind'], tuple(LAWS))
    return table


class Pillar(Table):
    """Round cantilever under each particle."""

    youngs_modulus_Pa: Positive = Field(description="Young's modulus in Pa")
    radius_m: Positive = Field(description='the radius in m')
    height_m: Positive = Field(description='the height in m')

    @property
    def stiffness_N_per_m(self):
        """`k = 3 E I/H^3` with `I = pi R^4/4`."""
        return 3 * self.youngs_modulus_Pa * (np.pi * self.radius_m**4 / 4) / self.height_m**3


class Foundation(Table):
    """Springs that tie each particle to its place, by their stiffness or as pillars."""

    stiffness_N_per_m: NotNegative | None = None
    pillar: Pillar | None = None

    @model_validator(mode='after')
    def _one(self):
        if (self.stiffness_N_per_m is None) == (self.pillar is None):
            has = 'neither' if self.pillar is None else 'both'
            raise ValueError(f' has {has} of stiffness_N_per_m and [foundation.pillar]; give one, or leave [foundation] out')
        return self

    @property
    def k(self):
        """Stiffness in N/mm."""
        return (self.stiffness_N_per_m if self.pillar is None else self.pillar.stiffness_N_per_m) * u.N / u.m


class BandPlan(Table):
    """What the bands are computed along, and phonopy's supercell."""

    path: Text = Field(description="the special points in order, such as 'GMKG'")
    points: AtLeastTwo = Field(description='the number of wavevectors along the path')
    supercell: Counts = Field(description="phonopy's supercell, one number for each periodic direction")


class Scene(Table):
    """A lattice, its law of repulsion and foundation, and what is wanted from them.

    The fields are the tables of the file, in SI units.  `atoms` and `band_path` are in those of the package.
    """

    title: Text = Field(description='a line that says what it is')
    lattice: Lattice = Field(description='a table [lattice]')
    law: Annotated[InversePowerLaw | DipoleLaw | YukawaLaw | TableLaw, Field(discriminator='kind'),
                   BeforeValidator(_known_law)] = Field(description='a table [law]')
    foundation: Foundation | None = None
    bands: BandPlan = Field(description='a table [bands]')

    @model_validator(mode='after')
    def _consistent(self):
        atoms, kind = self.atoms(), self.lattice.kind
        self._check_scale(atoms)
        wanted, periodic = list(self.bands.supercell), int(atoms.pbc.sum())
        if len(wanted) != periodic:
            raise ValueError(f'bands.supercell of the {kind} lattice must hold {periodic} whole numbers, not {wanted}')
        known = self.lattice.path(None, npoints=0).special_points
        legs = parse_path_string(self.bands.path)
        if not all(len(leg) > 1 and set(leg) <= set(known) for leg in legs):
            raise ValueError(f'bands.path of the {kind} lattice must join points out of {", ".join(known)}, '
                             f'not {self.bands.path!r}')
        return self

    def _check_scale(self, atoms):
        calc = atoms.calc
        stiffness = abs(calc.potential.d2phi(calc.bonds.lengths)).max() + calc.parameters.foundation
        f = np.sqrt(stiffness / atoms.get_masses()[0]) / (2 * np.pi) / u.Hz
        if not FREQUENCIES_Hz[0] <= f <= FREQUENCIES_Hz[1]:
            raise ValueError(f'law, foundation and lattice.mass_kg give frequencies of some {f:.1g} Hz; '
                             f'check their units and exponents')

    def atoms(self):
        """One unit cell with its MagneticRepulsion, `ase.Atoms` in mm, g and ms."""
        atoms = self.lattice.cell()
        foundation = self.foundation.k if self.foundation else 0.0
        atoms.calc = MagneticRepulsion(atoms, self.law.potential(), foundation=foundation, shells=self.law.shells)
        return atoms

    def band_path(self):
        """The path of [bands], `ase.dft.kpoints.BandPath`."""
        return self.lattice.path(self.bands.path, self.bands.points)

    def supercell(self):
        """Phonopy's supercell in three dimensions."""
        return self.bands.supercell + (1,) * (3 - len(self.bands.supercell))


def read_scene(path):
    """Read a scene file.

    Parameters
    ----------
    path : path-like
        A TOML file; `magphonon scene NAME` prints one to start from.

    Returns
    -------
    Scene

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not TOML or not a scene; the message names each key, its value and the mend.
    """
    path = Path(path)
    try:
        data = tomllib.loads(path.read_text(encoding='utf-8'))
    except OSError as error:
        raise type(error)(f'{path} cannot be read ({error.strerror}); "magphonon scene" lists scenes to start from') from None
    except ValueError as error:  # also bytes that are not UTF-8
        raise ValueError(f'{path} is not TOML ({error}); "magphonon scene prototype" prints a scene to start from') from None
    try:
        with np.errstate(over='raise', divide='raise', invalid='raise'):
            return Scene.model_validate(data, context={'folder': path.parent})
    except ArithmeticError as error:
        raise ValueError(f'{path}: its numbers are too large or too small to compute with ({error.args[-1]}); '
                         'check their units and exponents') from None
    except ValidationError as error:
        faults = [_fault(fault['loc'], fault['ctx']['error'], data) for fault in error.errors()]
        raise ValueError('\n'.join(f'{path}: {fault}' for fault in faults)) from None


def _fault(loc, error, data):
    """The error with the dotted key in front, as `law.a must be ...`; `loc` also holds the kind of law, which is no key."""
    name = ''
    for step in loc:
        if isinstance(data, dict) and step == data.get('kind'):
            continue
        name += f'[{step}]' if isinstance(step, int) else f'.{step}'
        data = data[step]
    text = str(error)
    return (name[1:] or 'the scene') + text if text[0] in ' .:' else text


def ready_scenes():
    """The scenes that come with the package: a dict from name to file."""
    found = (file for file in files('magphonon.data').iterdir() if file.name.endswith('.toml'))
    return {file.name.removesuffix('.toml'): file for file in sorted(found) if file.name != 'reference.toml'}


def ready_scene(name):
    """The file of one of the `ready_scenes`.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    scenes = ready_scenes()
    return scenes[one_of('the scene', name, tuple(scenes))]


def reference():
    """Numbers to check against, in SI units: the tables of `data/reference.toml`, where each has its source."""
    return tomllib.loads((files('magphonon.data') / 'reference.toml').read_text(encoding='utf-8'))
