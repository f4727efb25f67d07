"""Scene files: a lattice in TOML with SI units in the keys, read, checked and built as ASE Atoms.

Every table of a scene is a frozen model: the physical system is described in `magphonon.scenes.lattices`, `laws` and `supports`,
the computations in `magphonon.scenes.plans` and `design`.  A new table is a new class there and one line in `Scene`.
"""

from __future__ import annotations

import re
import tomllib
import warnings
from importlib.resources import files
from itertools import chain, pairwise
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from ase.dft.kpoints import parse_path_string
from pydantic import Field, ValidationError, model_validator

from .. import units as u
from ..errors import one_of
from ..response.place import Place
from ..stiffness.all_neighbours import AllNeighbours
from ..stiffness.calculator import MagneticRepulsion
from ..stiffness.scale import FREQUENCIES_Hz, frequency_scale
from ..textfiles import MEGABYTE, text_of
from .design import DesignPlan
from .fields import Table, Text, fault, raise_all, reason
from .lattices import ALL, AnyLattice, Oscillator, Patch
from .laws import Law, MagnetsLaw
from .plans import BandPlan, BurstPlan, FrfPlan, PlanTable, VibrometerPlan
from .supports import Foundation
from .tolerances import Uncertainty

if TYPE_CHECKING:
    from importlib.resources.abc import Traversable
    from os import PathLike
    from typing import Any

    from ase import Atoms
    from ase.dft.kpoints import BandPath
    from numpy.typing import NDArray

DENSITIES_kg_per_m3 = 500, 5e5
"""Range of the moving mass divided by the volume of its magnet: from less than any magnet to more than a magnet with a heavy
holder."""
LEAST_SHARE = 1e-12
"""Smallest stiffness of the repulsion, as a fraction of the foundation; a smaller one is lost in the round-off of the
foundation."""
SENSIBLE_SHARE = 1e-6
"""Stiffness of the repulsion, as a fraction of the foundation, above which a structure behaves as a lattice."""
MOST_SHELLS = 300
"""Largest number of shells, about 4000 neighbours of each particle; beyond it the sum over all neighbours is used."""
MOST_LEGS = 100
"""Largest number of points along a path; a picture has no room for more names."""
MOST_BYTES = 10 * MEGABYTE
"""Largest size of a scene file in bytes; the ready scenes have 3 kB."""


class Scene(Table):
    """A lattice, its law of repulsion, its foundation and the computations wanted for it.

    The fields are the tables of the file, in SI units.  `atoms` and `band_path` use the units of the package.
    """

    title: Text = Field(description='a line that says what it is')
    lattice: AnyLattice = Field(description='a table [lattice]')
    law: Law = Field(description='a table [law]')
    foundation: Foundation | None = None
    patch: Patch | None = None
    bands: BandPlan | None = None
    frf: FrfPlan | None = None
    burst: BurstPlan | None = None
    vibrometer: VibrometerPlan | None = None
    plan: PlanTable | None = None
    uncertainty: Uncertainty | None = None
    design: DesignPlan | None = None

    @model_validator(mode='after')
    def _consistent(self):
        if self.single:
            self._check_oscillator()
        if self.law.shells != ALL and self.law.shells > MOST_SHELLS:
            raise ValueError(f"law.shells must be at most {MOST_SHELLS}, not {self.law.shells}; for a force of longer range "
                             f"use '{ALL}', the sum over all neighbours")
        with warnings.catch_warnings():
            warnings.filterwarnings('ignore', message='.*numbers here are in mm, g, ms and N')  # refused by its keys instead
            atoms = self.atoms()
        self._check_scale(atoms)
        faults = []
        for table, check in (('title', self._check_title), ('law', self._check_mass), ('bands', self._check_bands),
                             ('frf', self._check_frf), ('plan', self._check_plan), ('vibrometer', self._check_vibrometer),
                             ('foundation', self._check_pillar), ('uncertainty', self._check_uncertainty),
                             ('design', self._check_design)):
            try:
                if getattr(self, table) is not None:
                    check()
            except ValueError as error:
                faults.append(fault(self, error))
        raise_all(faults)
        return self

    @property
    def single(self) -> bool:
        """Whether it is the oscillator of one particle."""
        return isinstance(self.lattice, Oscillator)

    @property
    def special_points(self) -> dict[str, NDArray[np.float64]]:
        """The named wavevectors of the lattice, in fractions of the reciprocal vectors."""
        return self.lattice.path(None, npoints=0).special_points  # pyright: ignore[reportAttributeAccessIssue]  no oscillator

    def _check_title(self):
        if self.title.count('$') < 2:
            return
        from matplotlib.mathtext import MathTextParser  # late: it takes half a second

        try:
            MathTextParser('path').parse(self.title)
        except ValueError as error:
            fault = str(error).splitlines()[-1].partition(': ')[2]  # behind the name of matplotlib's exception
            raise ValueError(f'title holds a formula that cannot be drawn: {fault}; correct the text between the $, or write '
                             '\\$ for a dollar sign') from None

    def _check_mass(self):
        if not isinstance(self.law, MagnetsLaw):
            return
        density = self.lattice.mass_kg / (self.law.magnet().volume / u.m**3)
        if not DENSITIES_kg_per_m3[0] <= density <= DENSITIES_kg_per_m3[1]:
            raise ValueError(f'lattice.mass_kg = {self.lattice.mass_kg!r} would give the magnet {density:.3g} kg/m3, and magnets '
                             'have about 7500; check the unit of the mass, which is kg, and of the sizes, which is m')

    def _check_vibrometer(self):
        if self.burst is not None:
            self.vibrometer.refuse_aliasing(self.burst.carriers_Hz)
        if self.vibrometer.noise_m > self.lattice.spacing_m:
            raise ValueError(f'vibrometer.noise_m must be less than the spacing of {self.lattice.spacing_m!r} m, not '
                             f'{self.vibrometer.noise_m!r}')

    def _check_pillar(self):
        if self.foundation.moving_mass and (self.uncertainty or self.design):
            raise ValueError('foundation.pillar.density_kg_per_m3: [uncertainty] and [design] treat pillars as massless; '
                             'take it out, and add 33/140 of the mass of a pillar to lattice.mass_kg')

    def _check_uncertainty(self):
        self.uncertainty.tolerances(self)

    def _check_design(self):
        self.design.check(self)

    def _check_oscillator(self):
        if self.law.shells != 1:
            raise ValueError(f'law.shells of the oscillator must be 1, not {self.law.shells}: its bonds all have one length')
        if self.bands is not None:
            raise ValueError('bands: the oscillator is one particle and has no bands; take the table [bands] out')

    def _check_bands(self):
        kind, wanted, periodic = self.lattice.kind, list(self.bands.supercell), int(self.lattice.cell().pbc.sum())
        if len(wanted) != periodic:
            raise ValueError(f'bands.supercell of the {kind} lattice must hold {periodic} whole numbers, not {wanted}')
        known = self.special_points
        if len(self.bands.path) > MOST_LEGS:
            raise ValueError(f'bands.path must join at most {MOST_LEGS} points, not {len(self.bands.path)}')
        legs = parse_path_string(self.bands.path)
        if not all(len(leg) > 1 and set(leg) <= set(known) for leg in legs):
            raise ValueError(f'bands.path of the {kind} lattice must join points out of {", ".join(known)}, '
                             f'not {self.bands.path!r}')
        for a, b in chain.from_iterable(map(pairwise, legs)):
            if a == b:
                raise ValueError(f'bands.path goes from {a} to {a} in {self.bands.path!r}; name each point once in a row')

    def _check_frf(self):
        for name in ('force', 'response'):
            given = getattr(self.frf, name) is not None
            if given and self.single:
                raise ValueError(f'frf.{name}: the oscillator is driven and measured along its guide; take [frf.{name}] out')
            if not given and not self.single:
                raise ValueError(f'frf lacks the table {name!r}; add [frf.{name}] with at_m and direction_deg')
        if not self.single and self.patch is None:
            raise ValueError('frf: there is no patch to drive; add a table [patch]')

    def _check_plan(self):
        if self.plan.edge is None:
            return
        if self.bands is None:
            raise ValueError(f'plan.edge = {self.plan.edge!r} is an edge of bands; add a table [bands]')
        known, branches = self.special_points, self.atoms().calc.dim * len(self.atoms())
        if self.plan.edge not in known:
            raise ValueError(f'plan.edge of the {self.lattice.kind} lattice must be one of {", ".join(known)}, '
                             f'not {self.plan.edge!r}')
        if self.plan.branch > branches:
            raise ValueError(f'plan.branch must be at most {branches}, not {self.plan.branch}')

    def _check_scale(self, atoms):
        calc = atoms.calc
        if not calc.potential.dphi(calc.bonds.lengths).any():
            raise ValueError(f'lattice.spacing_m = {self.lattice.spacing_m!r} is so large that nothing repels; spheres repel '
                             'only if the spacing is less than their diameter')
        repulsion, k = abs(calc.potential.d2phi(calc.bonds.lengths)).max(), calc.foundation
        f = frequency_scale(calc)
        if not FREQUENCIES_Hz[0] <= f <= FREQUENCIES_Hz[1]:
            raise ValueError(f'law, foundation and lattice.mass_kg give frequencies of about {f:.1g} Hz; '
                             f'check their units and exponents ({self._numbers()})')
        if not LEAST_SHARE * k <= repulsion:
            given, lost = (stiffness / (u.N / u.m) for stiffness in (k, repulsion))
            raise ValueError(f'lattice.spacing_m = {self.lattice.spacing_m!r}: the repulsion then has a stiffness of '
                             f'{lost:.1g} N/m, which is lost in the round-off of the foundation, {given:.3g} N/m'
                             f'{self._millimetres(calc.potential, k)}; check their units and exponents')

    def _numbers(self):
        """The numbers of the law, for a message."""
        return ', '.join(f'law.{key} = {value!r}' for key, value in self.law if isinstance(value, float))

    def _millimetres(self, law, k):
        """A question for the user, if the spacing would make sense in mm."""
        meant = self.lattice.spacing_m / 1000
        try:
            sensible = law.d2phi(meant * u.m) >= SENSIBLE_SHARE * k
        except (ValueError, ArithmeticError):
            sensible = False
        return f'; it is in metres: did you mean {meant:g}?' if sensible else ''

    def cell(self) -> Atoms:
        """One unit cell, or the oscillator, with the moving mass of the pillars but without a calculator."""
        atoms = self.lattice.cell()
        if self.foundation and self.foundation.moving_mass:
            atoms.set_masses(atoms.get_masses() + self.foundation.moving_mass)  # pyright: ignore[reportArgumentType]  ASE declares text
        return atoms

    def atoms(self) -> Atoms:
        """One unit cell, or the oscillator, with its MagneticRepulsion or AllNeighbours, `ase.Atoms` in mm, g and ms."""
        atoms = self.cell()
        foundation = self.foundation.k if self.foundation else 0.0
        if self.law.shells == ALL:
            try:
                atoms.calc = AllNeighbours(atoms, self.law.potential(), foundation=foundation)  # pyright: ignore[reportArgumentType]  or it refuses
            except ValueError as error:
                raise ValueError(f"law.shells = '{ALL}': {error}") from None
            return atoms
        atoms.calc = MagneticRepulsion(atoms, self.law.potential(), foundation=foundation, shells=self.law.shells,
                                       bonds=self.lattice.bonds)
        if self.single:  # a constant force balances the repulsion of the three magnets
            atoms.calc = atoms.calc.balanced([Oscillator.free])
        return atoms

    def patch_atoms(self, model: str = 'complete') -> Atoms:
        """The patch of [patch] with its MagneticRepulsion, `ase.Atoms` in mm, g and ms.

        Raises
        ------
        ValueError
            If the scene has no patch, or one that cannot be cut, or particles that repel beyond their nearest neighbours.
        """
        table = self.wanted('patch')
        try:
            patch = table.cut(self.cell())
        except ValueError as error:
            raise ValueError(f'{table.sizes}, lattice.spacing_m = {self.lattice.spacing_m!r}: {error}') from None
        if self.law.shells != 1:
            raise ValueError(f'law.shells = {self.law.shells!r}: the held rim of a patch is one row of particles and balances '
                             'forces between nearest neighbours only; take shells = 1, or in Python magphonon.relaxed(patch)')
        calc = self.atoms().calc
        patch.calc = MagneticRepulsion(patch, calc.potential, foundation=calc.foundation, model=model)
        return patch

    def shaken(self, model: str = 'complete') -> tuple[Atoms, Place, Place]:
        """The system of [frf]: the oscillator or the patch, and the particle and direction of the force and of the response.

        Returns
        -------
        atoms : ase.Atoms
        source, answer : Place
            As `magphonon.response.frf.receptance` takes them.

        Raises
        ------
        ValueError
            If there is no such table, or no free particle where it points.
        """
        plan = self.wanted('frf')
        if self.single:
            atoms, free = self.atoms(), Place(Oscillator.free, np.array([0.0, 1.0, 0.0]))
            atoms.calc.set(model=model)
            return atoms, free, free
        atoms, picked = self.patch_atoms(model), []
        for name in ('force', 'response'):
            try:
                picked.append(getattr(plan, name).of(atoms))
            except ValueError as error:
                raise ValueError(f'frf.{name}{error}') from None
        source, answer = picked
        return atoms, source, answer

    def wanted(self, name: str) -> Any:
        """One of the tables of computations, such as 'bands'.

        Raises
        ------
        ValueError
            If the scene has none.
        """
        table = getattr(self, name)
        if table is None:
            have = [other for other, file in ready_scenes().items() if f'\n[{name}' in file.read_text(encoding='utf-8')]
            example = 'prototype' if 'prototype' in have else have[0]
            raise ValueError(f'the scene {self.title!r} has no table [{name}]; add one, as in "magphonon scene {example}"')
        return table

    def band_path(self) -> BandPath:
        """The path of [bands], `ase.dft.kpoints.BandPath`."""
        bands = self.wanted('bands')
        return self.lattice.path(bands.path, bands.points)  # pyright: ignore[reportAttributeAccessIssue]  no oscillator has [bands]

    def supercell(self) -> tuple[int, ...]:
        """Phonopy's supercell in three dimensions."""
        wanted = self.wanted('bands').supercell
        return wanted + (1,) * (3 - len(wanted))


def read_scene(path: str | PathLike[str]) -> Scene:
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
    if not str(path):
        raise ValueError("'' names no file; " + '"magphonon scene" lists scenes to start from')
    path = Path(path)
    try:
        text = text_of(path, MOST_BYTES)
    except OSError as error:
        mend = (f'"magphonon scene {path} > {path}.toml" writes the ready scene of this name' if str(path) in ready_scenes()
                else '"magphonon scene" lists scenes to start from')
        raise type(error)(f'{path} cannot be read ({error.strerror}); {mend}') from None
    except UnicodeDecodeError as error:
        raise ValueError(f'{path} is not TOML, which is text in UTF-8: byte {error.start + 1} is none; '
                         '"magphonon scene prototype" prints a scene to start from') from None
    try:
        data = tomllib.loads(text)
    except ValueError as error:
        words = re.sub(r"\('([^()]*?)',?\)", lambda keys: '[' + keys[1].replace("', '", '.') + ']', str(error))
        raise ValueError(f'{path} is not TOML ({words}); "magphonon scene prototype" prints a scene to start from') from None
    except RecursionError:
        raise ValueError(f'{path} is not a scene: it nests lists or tables hundreds deep; "magphonon scene prototype" prints one '
                         'to start from') from None
    try:
        with np.errstate(over='raise', divide='raise', invalid='raise'):
            return Scene.model_validate(data, context={'folder': path.parent})
    except ArithmeticError as error:
        raise ValueError(f'{path}: its numbers are too large or too small to compute with ({error.args[-1]}); '
                         'check their units and exponents, first those of [law]') from None
    except ValidationError as error:
        faults = dict.fromkeys(_fault(found['loc'], reason(found), data) for found in error.errors())
        raise ValueError('\n'.join(f'{path}: {fault}' for fault in faults)) from None


def _fault(loc, error, data):
    """The error with the dotted key in front, as `law.a must be ...`; `loc` also holds the kind of law, which is no key."""
    name = ''
    for step in loc:
        if isinstance(data, dict) and step == data.get('kind'):
            continue
        name += f'[{step}]' if isinstance(step, int) else f'.{step}'
        data = data.get(step) if isinstance(data, dict) else None  # a table of forces may stand in a file of its own
    text = str(error)
    return (name[1:] or 'the scene') + text if text[0] in ' .:' else text


def ready_scenes() -> dict[str, Traversable]:
    """The scenes that come with the package: a dict from name to file."""
    found = (file for file in files('magphonon.data').iterdir() if file.name.endswith('.toml'))
    ordered = sorted(found, key=lambda file: file.name)
    return {file.name.removesuffix('.toml'): file for file in ordered if file.name != 'reference.toml'}


def ready_scene(name: str) -> Traversable:
    """The file of one of the `ready_scenes`.

    Raises
    ------
    ValueError
        For an unknown name.
    """
    scenes = ready_scenes()
    return scenes[one_of('the scene', name, tuple(scenes))]


def reference() -> dict[str, Any]:
    """Numbers to check against, in SI units: the tables of `data/reference.toml`, where each has its source."""
    return tomllib.loads((files('magphonon.data') / 'reference.toml').read_text(encoding='utf-8'))
