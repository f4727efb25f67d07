"""The tables [lattice], [foundation] and [patch] of a scene, in SI: the lattice or the oscillator, the springs or pillars that
support its particles, and the finite patch that waves cross.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal, get_args

import numpy as np
from ase import Atoms
from ase.constraints import FixedLine
from ase.dft.kpoints import BandPath
from pydantic import Field, model_validator

from .. import lattices, units as u
from ..bands.bands import band_path
from ..interactions.upright import UprightMagnets
from ..stiffness.sites import HEAVY, RAYLEIGH, cantilever_excess
from .fields import (
    Count,
    Flag,
    Length,
    Mass,
    NotNegative,
    Number,
    Positive,
    Pressure,
    Spacing,
    Table,
    listed,
    of_known_kind,
    within,
)
from .structures import FileLattice

if TYPE_CHECKING:
    from ..interactions.bond_laws import Law
    from ..interactions.pair_laws import PairLaw

LatticeKind = Literal['chain', 'square', 'triangular', 'honeycomb', 'kagome', 'fcc', 'bcc']
KINDS = (*get_args(LatticeKind), 'oscillator', 'file')
NODE = 237.7  # 3 m omega^2/k of a pillar of mass m whose tip is a node
HALVINGS = 50  # of the interval of a frequency
MOST_CELLS = 10**6
"""Largest number of cells of a patch; more need gigabytes and are probably due to a wrong unit."""


class Lattice(Table):
    """Geometry and masses, nearest neighbours at the distance `spacing_m`."""

    bonds: ClassVar = None  # found by the shells of the law
    cutoff: ClassVar = None
    finite: ClassVar = False

    kind: LatticeKind = Field(description='one of ' + ', '.join(KINDS))
    spacing_m: Spacing = Field(description='the distance between nearest neighbours in m')
    mass_kg: Mass = Field(description='the mass of a particle in kg')
    relative_masses: Annotated[tuple[Annotated[Positive, within(1e-6, 1e6, 'multiples of mass_kg')], ...], listed] | None = Field(
        None, description='a factor of mass_kg for each particle of the cell, in the order of its basis')
    gyration_rad_per_s: Annotated[Number, within(-1e12, 1e12, 'rad/s')] = Field(
        0.0, description='the rate in rad/s at which velocities turn clockwise in the plane: the rate of gyroscopes, twice the '
                         'rate of a bench that rotates anticlockwise, or q B/m of a charge in a field', examples=[15.0])

    @model_validator(mode='after')
    def _one_mass_each(self):
        particles = len(self.cell())
        if self.relative_masses is not None and len(self.relative_masses) != particles:
            raise ValueError(f'.relative_masses must hold {particles} numbers, one for each particle of the {self.kind} cell, '
                             f'not {list(self.relative_masses)}; they multiply mass_kg')
        return self

    @property
    def spacing_given(self) -> str:
        """The key and the value of the spacing, for a message."""
        return f'lattice.spacing_m = {self.spacing_m!r}'

    def cell(self) -> Atoms:
        """The unit cell, `ase.Atoms` in mm and g."""
        atoms = getattr(lattices, self.kind)(self.spacing_m * u.m, self.mass_kg * u.kg)
        if self.relative_masses is not None and len(self.relative_masses) == len(atoms):
            atoms.set_masses(self.mass_kg * u.kg * np.array(self.relative_masses))  # pyright: ignore[reportArgumentType]  ASE declares text
        return atoms

    def path(self, points: str | None, npoints: int) -> BandPath:
        """Path through special points, `ase.dft.kpoints.BandPath`."""
        return band_path(self.cell(), points, npoints)


class Oscillator(Table):
    """The free magnet of Sec. III on three fixed ones, all bonds of the length `spacing_m`, guided along its vertical line."""

    bonds: ClassVar = lattices.OSCILLATOR_BONDS
    cutoff: ClassVar = None
    finite: ClassVar = False  # it is `Scene.single`
    free: ClassVar = 3  # the index of the free magnet

    kind: Literal['oscillator']
    theta0_deg: Annotated[NotNegative, within(0, 90, 'degrees')] = Field(
        description='the angle in degrees below the horizontal at which the free magnet sees the two outer ones')
    spacing_m: Spacing = Field(description='the length in m of the three bonds of the oscillator')
    mass_kg: Mass = Field(description='the mass in kg of the free magnet of the oscillator')

    @property
    def spacing_given(self) -> str:
        """The key and the value of the spacing, for a message."""
        return f'lattice.spacing_m = {self.spacing_m!r}'

    def cell(self) -> Atoms:
        """The oscillator with its fixed magnets, `ase.Atoms` in mm and g."""
        atoms = lattices.oscillator(self.theta0_deg * u.deg, self.spacing_m * u.m, self.mass_kg * u.kg)
        atoms.set_constraint([*atoms.constraints, FixedLine(self.free, (0, 1, 0))])
        return atoms


AnyLattice = Annotated[Lattice | Oscillator | FileLattice, Field(discriminator='kind'),
                       of_known_kind(Lattice, Oscillator, FileLattice)]


class Pillar(Table):
    """Round cantilever under each particle."""

    youngs_modulus_Pa: Pressure = Field(description="Young's modulus in Pa")
    radius_m: Length = Field(description='the radius in m')
    height_m: Length = Field(description='the height in m')
    density_kg_per_m3: Annotated[Positive, within(1e-3, 1e6, 'kg/m3')] | None = Field(
        None, description='the density in kg/m3; with it the mass counts, in bands and FRF at each frequency')

    @property
    def stiffness_N_per_m(self) -> float:
        """Stiffness of the pillar, `k = 3 E I/H^3` with `I = pi R^4/4`."""
        return 3 * self.youngs_modulus_Pa * (np.pi * self.radius_m**4 / 4) / self.height_m**3

    @property
    def along_N_per_m(self) -> float:
        """Stiffness of the pillar along its axis, `E pi R^2/H`."""
        return self.youngs_modulus_Pa * np.pi * self.radius_m**2 / self.height_m

    @property
    def mass_kg(self) -> float:
        """Mass of the whole pillar; zero if the density is unknown."""
        return (self.density_kg_per_m3 or 0.0) * np.pi * self.radius_m**2 * self.height_m

    @property
    def moving_mass_kg(self) -> float:
        """Mass of the pillar that moves with its tip, Rayleigh's 33/140 of the whole."""
        return RAYLEIGH * self.mass_kg

    def excess(self, omega: Any) -> tuple[Any, Any]:
        """By how much its stiffness at frequencies in rad/ms exceeds k - 33/140 m omega^2, in N/mm, and the slope by ln k."""
        k, (excess, slope) = self.stiffness_N_per_m * u.N / u.m, cantilever_excess(self.heaviness(omega))
        return k * excess, k * (excess - slope)

    def slowed(self, omega: Any, mass: float) -> Any:
        """Frequencies in rad/ms, below that of the node, of waves that have `omega` on springs with 33/140 of the pillars' mass.

        Of particles of the same mass in g, with that share, all waves have the same modes on springs of any stiffness, so
        m w^2 - excess(w) = m omega^2.  Unstable modes are returned as they are.
        """
        low, high = np.zeros_like(omega), np.minimum(np.maximum(omega, 0.0), self.node)
        for _ in range(HALVINGS):
            w = (low + high) / 2
            below = w**2 - self.excess(w)[0] / mass < np.square(omega)
            low, high = np.where(below, w, low), np.where(below, high, w)
        return np.where(np.asarray(omega) > 0, high, omega)

    @property
    def node(self) -> float:
        """The frequency in rad/ms at which the pillar alone moves with a node at its tip."""
        return float(np.sqrt(NODE / self.heaviness(1.0)))

    def heaviness(self, omega: Any) -> Any:
        """The number x = 3 m omega^2/k of a pillar of mass m at frequencies in rad/ms; Rayleigh's mass is right below 5."""
        return 3 * self.mass_kg * (1e3 * np.asarray(omega)) ** 2 / self.stiffness_N_per_m


class OutOfPlane(Table):
    """Supports along z; with this table the particles of a planar lattice move out of its plane, too."""

    stiffness_N_per_m: Annotated[NotNegative, within(0, 1e15, 'N/m')] = Field(
        description='the stiffness in N/m of the support of each particle along z', examples=[800.0])
    upright_magnets: Flag = Field(description='true for magnets that stand upright on the plane, whose energy obeys '
                                              "Laplace's equation; false for forces along the line between two particles")


class Foundation(Table):
    """Springs that tie each particle to its place, by their stiffness or as pillars."""

    stiffness_N_per_m: Annotated[NotNegative, within(0, 1e15, 'N/m')] | None = Field(
        None, description='the stiffness in N/m of the spring that ties each particle to its place')
    stiffness_y_N_per_m: Annotated[NotNegative, within(0, 1e15, 'N/m')] | None = Field(
        None, description='the stiffness in N/m along y if the pillars are not round; stiffness_N_per_m is then that along x',
        examples=[22.0])
    pillar: Pillar | None = None
    out_of_plane: OutOfPlane | None = None

    @model_validator(mode='after')
    def _one(self):
        if (self.stiffness_N_per_m is None) == (self.pillar is None):
            has = 'neither' if self.pillar is None else 'both'
            raise ValueError(f' has {has} of stiffness_N_per_m and [foundation.pillar]; give one, or remove [foundation]')
        if self.stiffness_y_N_per_m is not None and not self.stiffness_N_per_m:
            raise ValueError('.stiffness_y_N_per_m, along y, needs a positive stiffness_N_per_m, along x; give both')
        return self

    @property
    def stiffness(self) -> float:
        """Stiffness in N/mm."""
        return (self.stiffness_N_per_m if self.pillar is None else self.pillar.stiffness_N_per_m) * u.N / u.m

    def springs(self, in_plane: Any) -> Any:
        """The foundation as an argument of the calculators; `in_plane` is its stiffness in N/mm, for all particles or each."""
        if self.out_of_plane is None and self.stiffness_y_N_per_m is None:
            return in_plane
        ratio = 1.0 if self.stiffness_y_N_per_m is None else self.stiffness_y_N_per_m / (self.stiffness / (u.N / u.m))
        parts = [in_plane, ratio * in_plane]
        if self.out_of_plane is not None:
            parts.append(self.out_of_plane.stiffness_N_per_m * u.N / u.m)
        return np.atleast_2d(np.stack(np.broadcast_arrays(*parts), axis=-1))

    @property
    def changes(self) -> dict[str, Any]:
        """Contributions in N/mm to the foundation of the stiffness along x, and of that along y if the scene gives one."""
        if self.stiffness_y_N_per_m is None:
            return {'stiffness': self.stiffness}
        z = () if self.out_of_plane is None else (0.0,)
        return {'stiffness': np.array([[self.stiffness, 0.0, *z]]),
                'stiffness_y': np.array([[0.0, self.stiffness_y_N_per_m * u.N / u.m, *z]])}

    def law(self, in_plane: PairLaw) -> Law:
        """The pair law of the particles, which is `in_plane` for particles at equal height."""
        return UprightMagnets(in_plane) if self.out_of_plane and self.out_of_plane.upright_magnets else in_plane

    def slowed(self, omega: Any, masses: Any) -> Any:
        """Frequencies as by `Pillar.slowed`, or as they are if pillars count as springs or particles differ."""
        return omega if self.beams is None or np.ptp(masses) else self.beams.slowed(omega, masses[0])

    def doubts(self, omega: Any, beams: bool = True) -> list[str]:
        """A line that says up to which of some frequencies in rad/ms pillars act as springs, if they do not at all of them;
        `beams` says whether they need not.
        """
        if self.pillar is None or (x := np.max(self.pillar.heaviness(omega))) <= HEAVY:
            return []
        limit = u.hertz(np.max(omega) * np.sqrt(HEAVY / x))
        return [f'Above {limit:.3g} Hz the pillars are too heavy for springs with 33/140 of their mass: at '
                f'{u.hertz(np.max(omega)):.4g} Hz 3 m omega^2/k is {x:.3g}. '
                + ('Their stiffness is that of beams at each frequency; further waves, in which they bend, begin at '
                   f'{u.hertz(self.pillar.node):.3g} Hz and are left out.' if beams and self.beams else
                   'As springs they count here, so true frequencies are lower.')]

    @property
    def beams(self) -> Pillar | None:
        """The pillars, if their mass is known and particles move in the plane: their stiffness then depends on the frequency."""
        return self.pillar if self.pillar and self.pillar.mass_kg and self.out_of_plane is None else None

    @property
    def moving_mass(self) -> float:
        """Mass of the pillar that moves with each particle, in g."""
        return self.pillar.moving_mass_kg * u.kg if self.pillar else 0.0


class PatchTable(Table):
    """Base of the shapes of patches."""

    @property
    def sizes(self) -> str:
        """The keys and values of the size, for a message."""
        return ', '.join(f'patch.{key} = {value!r}' for key, value in self if key != 'kind')

    def cells(self, cell: Atoms) -> float:
        """Approximate number of cells; zero for a lattice that is not planar."""
        return self.area / float(np.linalg.norm(np.cross(*cell.cell.array[:2]))) if cell.pbc[1] else 0

    @property
    def area(self) -> float:
        """Area of the patch in mm^2."""
        raise NotImplementedError

    def shape(self, cell: Atoms) -> Atoms:
        """The patch itself, without a check of its size."""
        raise NotImplementedError

    def cut(self, cell: Atoms) -> Atoms:
        """The patch, `ase.Atoms` without calculator."""
        cells = self.cells(cell)
        if cells > MOST_CELLS:
            raise ValueError(f'the patch of {cells:.2g} cells is too large (at most {MOST_CELLS:g}); make it smaller, '
                             'and check its unit and that of lattice.spacing_m')
        return self.shape(cell)


class Parallelogram(PatchTable):
    """Whole cells along both lattice vectors."""

    kind: Literal['parallelogram']
    cells_1: Count = Field(description='the number of cells along the first lattice vector')
    cells_2: Count = Field(description='the number of cells along the second lattice vector')

    def cells(self, cell: Atoms) -> float:
        return self.cells_1 * self.cells_2

    def shape(self, cell: Atoms) -> Atoms:
        return lattices.parallelogram(cell, self.cells_1, self.cells_2)


class Rectangle(PatchTable):
    """Upright rectangle."""

    kind: Literal['rectangle']
    width_m: Length = Field(description='the width in m, along x')
    height_m: Length = Field(description='the height in m, along y')

    @property
    def area(self) -> float:
        return self.width_m * u.m * self.height_m * u.m

    def shape(self, cell: Atoms) -> Atoms:
        return lattices.rectangle(cell, self.width_m * u.m, self.height_m * u.m)


class Hexagon(PatchTable):
    """Regular hexagon with corners on the x axis, or its upper half, as in the paper's experiment."""

    kind: Literal['hexagon', 'half_hexagon']
    side_m: Length = Field(description='the side of the hexagon in m')

    @property
    def area(self) -> float:
        return 1.5 * np.sqrt(3) * (self.side_m * u.m) ** 2 * (1 if self.kind == 'hexagon' else 1 / 2)

    def shape(self, cell: Atoms) -> Atoms:
        return getattr(lattices, self.kind)(cell, self.side_m * u.m)


class Supercell(Parallelogram):
    """Whole cells that repeat periodically, without a rim: where defects and disorder stand in an endless lattice."""

    kind: Literal['supercell']  # pyright: ignore[reportIncompatibleVariableOverride]
    cells_2: Count = Field(1, description='the number of cells along the second lattice vector, 1 if the lattice is not '
                                          'periodic along it')

    def shape(self, cell: Atoms) -> Atoms:
        if cell.pbc[2]:
            raise ValueError('only a planar lattice or a chain can have a supercell; choose another patch')
        if self.cells_2 > 1 and not cell.pbc[1]:
            raise ValueError('the lattice is not periodic along its second vector; remove patch.cells_2')
        return cell.repeat((self.cells_1, self.cells_2, 1))


Patch = Annotated[Parallelogram | Rectangle | Hexagon | Supercell, Field(discriminator='kind'),
                  of_known_kind(Parallelogram, Rectangle, Hexagon, Supercell)]
