"""What there is, as tables of a scene file: the lattice, the law of repulsion, the foundation.

This is the border: fields are in SI, what the methods return is in mm, g and ms.
"""

from typing import Annotated, ClassVar, Literal

import numpy as np
from ase.constraints import FixedLine
from pydantic import BeforeValidator, Field, ValidationInfo, model_validator

from . import lattices
from . import units as u
from .bands import band_path
from .errors import MOST, not_negative, one_of, positive, shown, whole
from .forcetables import read_forces
from .magnettables import Datasheet
from .potentials import Hertz, InversePower, Tabulated, Yukawa
from .tables import Force, Length, Mass, NotNegative, Positive, Pressure, Spacing, Table, Text, listed, within

LATTICES = ('chain', 'square', 'triangular', 'honeycomb', 'kagome', 'fcc', 'bcc')
KINDS = (*LATTICES, 'oscillator')

ALL = 'all'


def _shells(value):
    if isinstance(value, str) and value == ALL:
        return value
    try:
        return whole('', value)
    except ValueError:
        raise ValueError(f' must be a whole number from 1 to {MOST}, or {ALL!r}, not {shown(value)}') from None


Shells = Annotated[int | Literal[ALL], BeforeValidator(_shells),
                   Field(description=f"the number of shells of neighbours that interact, or '{ALL}'")]


class Lattice(Table):
    """Geometry and masses, nearest neighbours at the distance `spacing_m`."""

    bonds: ClassVar = None  # found by the shells of the law

    kind: Literal[LATTICES] = Field(description='one of ' + ', '.join(KINDS))
    spacing_m: Spacing = Field(description='the distance between nearest neighbours in m')
    mass_kg: Mass = Field(description='the mass of a particle in kg')
    relative_masses: Annotated[tuple[Annotated[Positive, within(1e-6, 1e6, 'multiples of mass_kg')], ...], listed] | None = None

    @model_validator(mode='after')
    def _one_mass_each(self):
        particles = len(self.cell())
        if self.relative_masses is not None and len(self.relative_masses) != particles:
            raise ValueError(f'.relative_masses must hold {particles} numbers, one for each particle of the {self.kind} cell, '
                             f'not {list(self.relative_masses)}; they multiply mass_kg')
        return self

    def cell(self):
        """The unit cell, `ase.Atoms` in mm and g."""
        atoms = getattr(lattices, self.kind)(self.spacing_m * u.m, self.mass_kg * u.kg)
        if self.relative_masses is not None and len(self.relative_masses) == len(atoms):
            atoms.set_masses(self.mass_kg * u.kg * np.array(self.relative_masses))
        return atoms

    def path(self, points, npoints):
        """Path through special points, `ase.dft.kpoints.BandPath`."""
        return band_path(self.cell(), points, npoints)


def _right_angle(value):
    degrees = not_negative('', value)
    if degrees > 90:
        raise ValueError(f' must lie between 0 and 90 degrees, not {value!r}')
    return degrees


class Oscillator(Table):
    """The free magnet of Sec. III on three fixed ones, all bonds of the length `spacing_m`, guided along its vertical line."""

    bonds: ClassVar = lattices.OSCILLATOR_BONDS
    free: ClassVar = 3  # the index of the free magnet

    kind: Literal['oscillator']
    theta0_deg: Annotated[float, BeforeValidator(_right_angle)] = Field(
        description='the angle in degrees, 0 to 90, of the two outer magnets below the horizontal')
    spacing_m: Spacing = Field(description='the length of its three bonds in m')
    mass_kg: Mass = Field(description='the mass of the free particle in kg')

    def cell(self):
        """All of it, `ase.Atoms` in mm and g."""
        atoms = lattices.oscillator(self.theta0_deg * u.deg, self.spacing_m * u.m, self.mass_kg * u.kg)
        atoms.set_constraint([*atoms.constraints, FixedLine(self.free, (0, 1, 0))])
        return atoms


def _known_lattice(table):
    if not isinstance(table, dict) or 'kind' not in table:
        return Lattice.model_validate(table)  # which says what is missing
    one_of('.kind', table['kind'], KINDS)
    return table


AnyLattice = Annotated[Lattice | Oscillator, Field(discriminator='kind'), BeforeValidator(_known_lattice)]


def _poisson_ratio(value):
    ratio = positive('', value)
    if ratio > 0.5:
        raise ValueError(f' must not exceed 0.5, not be {value!r}')
    return ratio


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


class CoulombLaw(Table):
    """Equal point charges."""

    kind: Literal['coulomb']
    charge_C: Positive = Field(description='the charge of a particle in C')
    shells: Shells

    def potential(self):
        return InversePower.coulomb(self.charge_C * u.A * u.s)


class YukawaLaw(Table):
    """Energy `strength/r exp(-r/screening length)`."""

    kind: Literal['yukawa']
    strength_J_m: Positive = Field(description='the strength c of the energy c/r exp(-r/l) in J m')
    screening_length_m: Length = Field(description='the screening length l of the energy c/r exp(-r/l) in m')
    shells: Shells

    def potential(self):
        return Yukawa(self.strength_J_m * u.J * u.m, 1 / (self.screening_length_m * u.m))


class HertzLaw(Table):
    """Contacts of elastic spheres, compressed where the spacing of the lattice is less than their diameter."""

    kind: Literal['hertz']
    diameter_m: Length = Field(description='the diameter of the spheres in m')
    youngs_modulus_Pa: Pressure = Field(description="Young's modulus of the spheres in Pa")
    poisson_ratio: Annotated[float, BeforeValidator(_poisson_ratio)] = Field(description="Poisson's ratio of the spheres")
    shells: Shells

    def potential(self):
        return Hertz.spheres(self.diameter_m * u.m, self.youngs_modulus_Pa * u.Pa, self.poisson_ratio)


class TableLaw(Table):
    """Measured forces, in the scene or in a `file` beside it."""

    kind: Literal['table']
    distances_m: Annotated[tuple[Length, ...], listed] = Field(
        description="the distances in m, increasing, or file = 'law.csv' with the columns r_m,f_N")
    forces_N: Annotated[tuple[Force, ...], listed] = Field(description='the forces in N at these distances')
    file: Text | None = None
    shells: Shells

    @model_validator(mode='before')
    @classmethod
    def _columns(cls, table, info: ValidationInfo):
        if not isinstance(table, dict) or 'file' not in table:
            return table
        if not isinstance(table['file'], str) or '\0' in table['file']:
            raise ValueError(f'.file must be the name of a file in quotes, not {shown(table["file"])}')
        for key in table.keys() & {'distances_m', 'forces_N'}:
            raise ValueError(f' has both file and {key}; keep one of them')
        return table | _read_columns(info.context['folder'] / table['file'])

    @model_validator(mode='after')
    def _smooth(self):
        try:
            self.potential()
        except ValueError as error:
            raise ValueError(f': {error}') from None
        return self

    def potential(self):
        return Tabulated(np.array(self.distances_m) * u.m, np.array(self.forces_N) * u.N)


class MagnetsLaw(Datasheet):
    """Uniform magnets, magnetised normal to the plane, by shape and remanence."""

    kind: Literal['magnets']
    shells: Shells


def _read_columns(file):
    """Distances and forces from a table of the kind that "magphonon fit" takes."""
    try:
        forces = read_forces(file)
    except (OSError, ValueError) as error:
        raise ValueError(f'.file: {error}') from None
    return {'distances_m': list(forces.r / u.m), 'forces_N': list(forces.f / u.N)}


LAWS = {'inverse_power': InversePowerLaw, 'dipoles': DipoleLaw, 'coulomb': CoulombLaw, 'yukawa': YukawaLaw, 'hertz': HertzLaw,
        'table': TableLaw, 'magnets': MagnetsLaw}


def _known_law(table):
    if not isinstance(table, dict) or 'kind' not in table:
        raise ValueError(f" must be a table [law] with a kind, one of {', '.join(LAWS)}, not {shown(table)}")
    one_of('.kind', table['kind'], tuple(LAWS))
    return table


Law = Annotated[InversePowerLaw | DipoleLaw | CoulombLaw | YukawaLaw | HertzLaw | TableLaw | MagnetsLaw,
                Field(discriminator='kind'), BeforeValidator(_known_law)]


class Pillar(Table):
    """Round cantilever under each particle."""

    youngs_modulus_Pa: Pressure = Field(description="Young's modulus in Pa")
    radius_m: Length = Field(description='the radius in m')
    height_m: Length = Field(description='the height in m')
    density_kg_per_m3: Annotated[Positive, within(1e-3, 1e6, 'kg/m3')] | None = None

    @property
    def stiffness_N_per_m(self):
        """`k = 3 E I/H^3` with `I = pi R^4/4`."""
        return 3 * self.youngs_modulus_Pa * (np.pi * self.radius_m**4 / 4) / self.height_m**3

    @property
    def moving_mass_kg(self):
        """Rayleigh's 33/140 of its mass, which moves with the tip; zero for a pillar of unknown density."""
        return 33 / 140 * (self.density_kg_per_m3 or 0.0) * np.pi * self.radius_m**2 * self.height_m


class Foundation(Table):
    """Springs that tie each particle to its place, by their stiffness or as pillars."""

    stiffness_N_per_m: Annotated[NotNegative, within(0, 1e15, 'N/m')] | None = None
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

    @property
    def moving_mass(self):
        """Mass that each particle drags along in g."""
        return self.pillar.moving_mass_kg * u.kg if self.pillar else 0.0
