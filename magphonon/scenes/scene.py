"""Scene files: a lattice in TOML with SI units in the keys, read, checked and built as ASE Atoms.

Every table of a scene is a frozen model: the physical system is described in `lattices`, `structures` and `laws` of this package,
the computations in `plans`.  A new table is a new class there and one line in `Scene`; contradictions between tables are checked
in `consistency`.
"""

from __future__ import annotations

import json
import os
import re
import tomllib
import warnings
from contextlib import contextmanager
from importlib.resources import files
from os import PathLike
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from ase import Atoms
from ase.dft.kpoints import BandPath
from numpy.typing import NDArray
from pydantic import Field, PrivateAttr, ValidationError, model_validator

from .. import units as u
from ..bands.bands import band_path
from ..bands.force_constants import enough_cells
from ..bands.neighbours import ConvergedShells, converged_shells, whole_reach
from ..errors import PhysicsError
from ..files import whole_file
from ..interactions.bond_laws import laws_from_dict, laws_to_dict
from ..lattices.bonds import bonds_within
from ..lattices.patches import surrounded
from ..response.frf import Dof
from ..stiffness.all_neighbours import AllNeighbours, nearest_distance
from ..stiffness.calculator import PairCalculator
from ..stiffness.matrices import Model
from ..stiffness.relaxation import MEND, Relaxation, enough_foundation, relaxed
from ..stiffness.repulsion import Repulsion
from ..stiffness.rest import freedom
from .consistency import check
from .fields import Table, Title, listed, reason
from .lattices import AnyLattice, Foundation, Oscillator, Patch, Supercell
from .laws import ALL, AUTO, TOLERANCE, Law, SavedLaw
from .members import Members, joined
from .plans import BandPlan, BurstPlan, FrfPlan
from .sources import Source, ready_scene as ready_scene, ready_scenes, source_of
from .structures import Defects, FileLattice
from .tolerances import Uncertainty

PAIRS = 3e-4
"""Where shells = 'all' has to become a number: largest relative change of a frequency by the omitted neighbours."""
LONG_RANGE = 0.01
"""Where a law of long range needs a number of shells: largest relative error of a frequency by the omitted neighbours."""
POINTS = 200
"""Wavevectors along the path of the bands in a scene written from Python."""
MOST_IN_A_CELL = 30
"""Largest number of particles in the cell of a file whose bands are computed to find how many neighbours it needs."""

DEEPEST = 100  # largest number of names in a key with dots; those of a scene have four
START = '"magphonon scene prototype" prints a scene to start from'
SLIPS = {r'=\s*[-+]?\d+,\d': 'numbers take a decimal point, as in 0.01',
         r'\\': "a path takes slashes, as in 'C:/bench/particles.csv'",
         r'=\s*[-+]?[\d.]+(e-?\d+)?\s*[^\W\d_]': 'a number stands alone: its unit is in the name of the key'}
"""What a line that is not TOML may hold, and what to write instead."""


@contextmanager
def _units_told_by_keys():
    """Suppress warnings of calculators about units, because `consistency` has already checked them by the keys of the scene."""
    with warnings.catch_warnings():
        warnings.filterwarnings('ignore', message='.*numbers are in mm, g, ms and N|a mass of .* every')
        yield


class Scene(Table):
    """A lattice, its law of repulsion, its foundation and the computations wanted for it.

    The fields are the tables of the file, in SI units.  `atoms`, `perfect_cell` and `band_path` use the units of the package.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> scene = read_scene('prototype')
    >>> scene.band_path().path, scene.patch_atoms().calc.model
    ('GMKG', 'complete')
    """

    title: Title = Field(description='a line that says what the scene is')
    lattice: AnyLattice = Field(description='a table [lattice]')
    law: Law = Field(description='a table [law]')
    members: Annotated[tuple[Members, ...], listed] = ()
    foundation: Foundation | None = None
    patch: Patch | None = None
    bands: BandPlan | None = None
    frf: FrfPlan | None = None
    defects: Defects | None = None
    burst: BurstPlan | None = None
    uncertainty: Uncertainty | None = None

    _name: str = PrivateAttr('')

    @model_validator(mode='after')
    def _consistent(self):
        own: Any = self.__dict__  # it is read-only for everybody else
        own['law'] = self._counted_law(self.law)
        check(self)
        return self

    def _counted_law(self, law: Any) -> Any:
        """The law with the number of shells that the perfect lattice needs, if the scene does not choose one itself."""
        lattice = self.lattice
        if isinstance(law, SavedLaw) or law.shells not in (AUTO, ALL):
            return law
        if isinstance(lattice, FileLattice) and (lattice.finite or law.shells == AUTO):
            self._choose_cutoff(lattice)
            return law.with_shells(1)
        if self.single or law.shells == ALL:
            return law.with_shells(1) if law.shells == AUTO else law
        enough = self.converged_shells(TOLERANCE)
        if enough.error > TOLERANCE and self._sums():
            return law.with_shells(ALL)
        return law.with_shells(enough.shells, enough.cutoff / (lattice.spacing_m * u.m))

    def _choose_cutoff(self, lattice: FileLattice) -> None:
        """Set the cutoff that the structure in a file needs, unless it has one; the number of shells then has no effect."""
        cell = self.cell()
        if lattice.cutoff is not None:
            return
        if not lattice.finite and len(cell) <= MOST_IN_A_CELL:
            lattice._cutoff = self.converged_shells(TOLERANCE).cutoff
        else:
            lattice._cutoff = whole_reach(cell, self._law())

    def _sums(self) -> bool:
        """Whether the sum over all neighbours can be computed for this law and lattice."""
        try:
            AllNeighbours(self.cell(), self._law())
        except ValueError:
            return False
        return True

    def converged_shells(self, tolerance: float) -> ConvergedShells:
        """Number of shells that the perfect lattice needs at its special points (see `magphonon.bands.converged_shells`)."""
        atoms = self.cell()
        with _units_told_by_keys():
            nearest = bonds_within(atoms, 1.2 * nearest_distance(atoms))
            still: dict[str, Any] = self._sites(atoms) | {'gyration': 0.0}
            atoms.calc = PairCalculator(atoms, self._law(), bonds=nearest, **still)
        return converged_shells(atoms, list(self.special_points.values()), tolerance)

    def with_shells(self, shells: int | str) -> Scene:
        """The same scene with another number of shells; 'auto' for as many as its bands need."""
        return self.model_copy(update={'law': self._counted_law(self.law.with_shells(shells))})

    def counted(self) -> Scene:
        """The same scene with a definite number of shells, for tools that need the stiffness of each bond.

        If shells = 'all', enough shells are taken for the others to change each frequency at the special points by less than
        `PAIRS`, or as many as can be counted. `magphonon.bands.neighbour_shifts` gives the remaining shifts.
        """
        if isinstance(self.law, SavedLaw) or self.law.shells != ALL:
            return self
        enough = self.converged_shells(PAIRS)
        if enough.error > LONG_RANGE:
            raise ValueError(f"law.shells = '{self.law.asked}': the force reaches so far that with {enough.shells} shells of "
                             f"neighbours frequencies are still {enough.error:.1%} off, and this computation needs a list of "
                             'bonds; "magphonon bands" sums over all neighbours')
        law = self.law.with_shells(enough.shells, enough.cutoff / (self.lattice.spacing_m * u.m))
        return self.model_copy(update={'law': law})

    def __eq__(self, other: object) -> bool:  # the name of its file does not matter
        return isinstance(other, Scene) and vars(self) == vars(other)

    @property
    def single(self) -> bool:
        """Whether the scene is the oscillator of one particle."""
        return isinstance(self.lattice, Oscillator)

    @property
    def finite(self) -> bool:
        """Whether the scene is a structure from a file that is not periodic in any direction."""
        return self.lattice.finite

    @property
    def special_points(self) -> dict[str, NDArray[np.float64]]:
        """The named wavevectors of the lattice, in fractions of the reciprocal vectors."""
        return self.lattice.path(None, npoints=0).special_points  # pyright: ignore[reportAttributeAccessIssue]  no oscillator

    def cell(self) -> Atoms:
        """One unit cell, or the oscillator, with the moving mass of the pillars but without a calculator."""
        atoms = self.lattice.cell()
        if self.foundation and self.foundation.moving_mass:
            atoms.set_masses(atoms.get_masses() + self.foundation.moving_mass)  # pyright: ignore[reportArgumentType]  ASE declares text
        return atoms

    def atoms(self) -> Atoms:
        """The structure of the scene with its calculator, `ase.Atoms` in mm, g and ms.

        With [defects] it is the patch or the finite structure that contains them, relaxed to rest; otherwise it is the
        `perfect_cell`.
        """
        relaxation = self.relaxation()
        return self.perfect_cell() if relaxation is None else relaxation.atoms

    @_units_told_by_keys()
    def perfect_cell(self) -> Atoms:
        """One unit cell, the oscillator or the finite structure, without [defects], with its PairCalculator or AllNeighbours."""
        lattice = self.lattice
        atoms = self.cell()
        if self.law.kind == 'saved':
            atoms = lattice.saved()  # pyright: ignore[reportAttributeAccessIssue]  as `check` makes sure
        elif self.members:
            tilted = {'dim': 3} if np.ptp(atoms.positions[:, 2]) > 0 else {}
            atoms = joined(atoms, self.members, **self._sites(atoms) | tilted)
        elif self.law.shells == ALL:
            try:
                atoms.calc = AllNeighbours(atoms, self._law(), **self._sites(atoms))  # pyright: ignore[reportArgumentType]  or it refuses
            except ValueError as error:
                raise ValueError(f"law.shells = '{ALL}': {error}") from None
        else:
            atoms.calc = self._pairs(atoms)
        if self.single:  # a constant force balances the repulsion of the three magnets
            atoms.calc = atoms.calc.balanced([Oscillator.free])  # pyright: ignore[reportAttributeAccessIssue]  of one shell
        return lattice.settled(atoms) if isinstance(lattice, FileLattice) else atoms

    def _pairs(self, atoms: Atoms) -> PairCalculator:
        """The calculator of so many shells of neighbours, or of all within the cutoff."""
        lattice, shells = self.lattice, self.law.shells
        bonds, reach = lattice.bonds, getattr(self.law, 'reach', None)
        if reach is not None:
            bonds = bonds_within(atoms, reach * lattice.spacing_m * u.m)
        try:
            return PairCalculator(atoms, self._law(), shells=shells, cutoff=lattice.cutoff, bonds=bonds, **self._sites(atoms))
        except ValueError as error:
            if isinstance(lattice, FileLattice):
                raise ValueError(f'lattice.file = {lattice.file!r}: {error}; if its positions have no clear shells, give '
                                 'cutoff_m, the distance within which particles interact') from None
            sphere = f', law.diameter_m = {self.law.diameter_m!r}' if self.law.kind == 'hertz' else ''
            raise type(error)(f'{lattice.spacing_given}{sphere}, law.shells = {shells!r}: {error}') from None

    def _law(self) -> Any:
        law: Any = self.law.potential()
        return self.foundation.law(law) if self.foundation else law

    def _sites(self, atoms: Atoms) -> dict[str, Any]:
        """Foundation, strengths and gyration, for each site or for all, as arguments of the calculators."""
        foundation = atoms.arrays.get('stiffness', self.foundation.stiffness if self.foundation else 0.0)
        if self.foundation:
            foundation = self.foundation.springs(foundation)
        sites = {'foundation': foundation} | ({'strengths': atoms.arrays['strength']} if atoms.has('strength') else {})
        gyration = getattr(self.lattice, 'gyration_rad_per_s', 0.0) / u.s
        return sites | ({'gyration': gyration} if gyration else {})

    @property
    def turns(self) -> bool:
        """Whether the particles gyrate."""
        return bool(getattr(self.lattice, 'gyration_rad_per_s', 0.0))

    def patch_atoms(self, model: Model = 'complete') -> Atoms:
        """The patch of [patch], or the finite structure, with its PairCalculator, `ase.Atoms` in mm, g and ms."""
        relaxation = self.relaxation(model)
        return self._perfect(model) if relaxation is None else relaxation.atoms

    def relaxation(self, model: Model = 'complete') -> Relaxation | None:
        """Relaxation of the patch or finite structure with [defects]; None if the scene has none."""
        if self.defects is None:
            return None
        called = self._name or repr(self.title)
        try:
            atoms = self.defects.applied(self._perfect(model))
            return relaxed(atoms)
        except PhysicsError as error:
            weak, enough = (k / (u.N / u.m) for k in enough_foundation(atoms))
            raise type(error)(f'{called} with [defects]: {str(error).partition(f"; {MEND}")[0]}; a foundation of {enough:.4g} '
                              f'N/m holds it, {weak:.4g} N/m do not') from None
        except ValueError as error:
            raise ValueError(f'{called}: {error}') from None

    def defect_places(self) -> NDArray[np.float64]:
        """Positions of the defects of the patch or the finite structure in mm, shape (defects, 2)."""
        return np.zeros((0, 2)) if self.defects is None else self.defects.places(self._perfect('complete'))

    @_units_told_by_keys()
    def _perfect(self, model: Model) -> Atoms:
        if self.finite:
            atoms = self.perfect_cell()
            atoms.calc.set(model=model)
            return atoms
        table = self.wanted('patch')
        try:
            patch = table.cut(self.cell())
        except ValueError as error:
            raise ValueError(f'{table.sizes}, {self.lattice.spacing_given}: {error}') from None
        whole = self.counted().perfect_cell()
        calc: Any = whole.calc
        if isinstance(table, Supercell):
            patch.calc = calc.on(patch)
            patch.calc.set(model=model)
            return patch
        sites = self._sites(patch)
        if self.law.shells == 1 and self.lattice.cutoff is None:
            patch.calc = PairCalculator(patch, calc.laws, model=model, **sites)
            return patch
        patch = surrounded(patch, whole, calc.bonds)
        free, bonds = freedom(patch)[0], bonds_within(patch, calc.bonds.cutoff or 1.000001 * calc.bonds.lengths.max())
        patch.calc = PairCalculator(patch, calc.laws, model=model, bonds=bonds.among(free[bonds.i] | free[bonds.j]),
                                       **sites)
        return patch

    def shaken(self, model: Model = 'complete', bench: bool = False) -> tuple[Atoms, Any, Dof]:
        """The system of [frf]: the oscillator or the patch, and the particle and direction of the force and of the response.

        These are the arguments of `magphonon.response.frf.receptance`. If the caller allows a `bench` and `frf.base_deg` is
        given, the direction of the bench replaces the force.
        """
        plan = self.wanted('frf')
        if plan.base_deg is not None and not bench:
            raise ValueError('frf.base_deg: a shaken bench is for "magphonon frf" and "magphonon fit --frf"; give [frf.force] '
                             'here')
        if self.single:
            atoms, free = self.perfect_cell(), Dof(Oscillator.free, np.array([0.0, 1.0, 0.0]))
            atoms.calc.set(model=model)
            return atoms, free, free
        atoms, picked = self.patch_atoms(model), {}
        for name in ('force', 'response'):
            try:
                picked[name] = pick.of(atoms) if (pick := getattr(plan, name)) is not None else None
            except ValueError as error:
                raise ValueError(f'frf.{name}{error}') from None
        if plan.base_deg is not None:
            picked['force'] = np.array([np.cos(plan.base_deg * u.deg), np.sin(plan.base_deg * u.deg), 0.0])
        return atoms, picked['force'], picked['response']

    def wanted(self, name: str) -> Any:
        """One of the tables of computations, such as 'bands'; a lattice without [bands] gets bands along ASE's path."""
        table = getattr(self, name)
        if name == 'bands' and table is None and not (self.single or self.finite):
            return BandPlan.model_validate({})
        if (self.finite or self.single) and name in ('bands', 'burst', 'patch'):
            what, shown = ('one particle', '"magphonon frf" shows its response') if self.single else (
                'a finite structure', '"magphonon modes" shows its modes')
            raise ValueError(f'[{name}] needs a lattice, and {self.title!r} is {what}; {shown}')
        if table is None:
            example = next(other for other, file in ready_scenes().items() if f'\n[{name}' in file.read_text(encoding='utf-8'))
            raise ValueError(f'the scene {self.title!r} has no table [{name}]; add one, as in "magphonon scene {example}"')
        return table

    def band_path(self) -> BandPath:
        """The path of [bands], `ase.dft.kpoints.BandPath`."""
        bands = self.wanted('bands')
        return self.lattice.path(bands.path, bands.points)  # pyright: ignore[reportAttributeAccessIssue]  no oscillator has [bands]

    def supercell(self) -> tuple[int, ...]:
        """Phonopy's supercell in three dimensions."""
        wanted = self.wanted('bands').supercell
        if wanted is None:
            calc: Any = self.perfect_cell().calc
            return tuple(map(int, enough_cells(calc)))
        return wanted + (1,) * (3 - len(wanted))


def read_scene(path: str | PathLike[str] | Source) -> Scene:
    """Read a scene.

    Parameters
    ----------
    path : path-like or Source
        A TOML file, or the name of a ready scene, which is used if there is no file of this name; `magphonon scene` lists the
        names.

    Raises
    ------
    OSError
        If the file cannot be read.
    ValueError
        If it is not TOML or not a scene; the message names each faulty key and its value, and says how to correct it.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> scene = read_scene('prototype')
    >>> scene.lattice.kind, scene.lattice.spacing_m
    ('triangular', 0.01)
    >>> cell = scene.atoms()  # ase.Atoms with its calculator
    """
    source = source_of(path)
    try:
        text = source.text
    except UnicodeDecodeError as error:
        raise ValueError(f'{source} is not TOML: its byte {error.start + 1} is not text in UTF-8; {START}') from None
    try:
        if any(words.count('.') > DEEPEST for words in re.split(r'[=,\[\]{}#\n]', text)):
            raise RecursionError  # of 100 kB of nested names tomllib would make 10 GB
        data = tomllib.loads(text)
    except ValueError as error:
        words = re.sub(r"\('([^()]*?)',?\)", lambda keys: '[' + keys[1].replace("', '", '.') + ']', str(error))
        raise ValueError(f'{source} is not TOML ({words}); {_slip(source, text, words)}') from None
    except RecursionError:
        raise ValueError(f'{source} is not a scene: it nests lists or tables hundreds deep; {START}') from None
    try:
        with np.errstate(over='raise', divide='raise', invalid='raise'):
            scene = Scene.model_validate(data, context={'folder': source.folder})
            scene._name = source.name
            return scene
    except ArithmeticError as error:
        raise ValueError(f'{source}: its numbers are too large or too small to compute with ({error.args[-1]}); '
                         'check their units and exponents, first those of [law]') from None
    except ValidationError as error:
        raise ValueError('\n'.join(f'{source}: {fault}' for fault in _faults(error, data))) from None


def _slip(source, text, words):
    """What to write instead of a line that is not TOML."""
    found = re.search(r'at line (\d+)', words)
    line = text.splitlines()[int(found[1]) - 1] if found else ''
    if source.suffix not in ('', '.toml'):
        return f'tables of measurements are for "magphonon fit"; {START}'
    return next((mend for slip, mend in SLIPS.items() if re.search(slip, line)), START)


def write_scene(atoms: Atoms, path: str | PathLike[str], title: str | None = None) -> None:
    """Write atoms with their calculator as a scene, for which every command gives the same numbers, bit by bit, as Python.

    The scene is `path`, NAME.toml. The particles, with law, bonds, foundation and anchors, go into NAME.traj beside it, a file of
    ASE.

    Parameters
    ----------
    atoms : ase.Atoms
        Atoms with PairCalculator or AllNeighbours.
    path : path-like
        Path of the scene file; its name ends in .toml.
    title : str, optional
        A line that says what the scene is.

    Raises
    ------
    ValueError
        If the atoms have no calculator of this package, or one whose law cannot be saved in a file; if `read_scene` would refuse
        the title or the name; if NAME.traj exists and is not the file of particles of a scene NAME.toml.
    OSError
        If one of the files cannot be written; then none is written.

    Examples
    --------
    >>> import tempfile
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, read_scene
    >>> from magphonon.scenes import write_scene
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
    beside = path.with_suffix('.traj')
    if os.path.lexists(beside) and not _names(path, beside.name):
        raise ValueError(f'{beside} exists and is not the file of particles of a scene {path.name}; move it, or choose another '
                         'name for the scene')
    tables = _tables_of(_checked(atoms), title, beside.name)
    scene_of(tables, atoms)  # with all checks of a scene that is read
    with whole_file(beside, 'wb') as particles, whole_file(path) as file:
        atoms.write(particles, format='traj')
        file.write(f'# The particles, their law, bonds and foundation are in {beside.name}, to the last bit: {atoms.calc!r}\n')
        file.write(toml(tables))


def _checked(atoms: Atoms) -> Atoms:
    """Return the atoms, or raise ValueError if a scene cannot hold them."""
    calc: Any = getattr(atoms, 'calc', None)
    if not isinstance(calc, Repulsion):
        raise ValueError(f'a scene is made of atoms with PairCalculator or AllNeighbours, not with {calc!r}; attach either')
    laws_from_dict(laws_to_dict(calc.laws))
    calc.displacements(atoms)  # refuses atoms that are not those of the calculator
    return atoms


def _tables_of(atoms: Atoms, title: str | None, file: str) -> dict[str, Any]:
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


def _names(path, particles):
    """Whether a scene written by `write_scene` has its particles and law in this file."""
    try:
        tables = tomllib.loads(path.read_text(encoding='utf-8'))
        return tables['lattice']['file'] == particles and tables['law']['kind'] == 'saved'
    except (OSError, ValueError, KeyError, TypeError):
        return False


def toml(tables: dict[str, Any], name: str = '') -> str:
    """The TOML text of tables, and of tables within them, which `tomllib` can read."""
    inner = {key: value for key, value in tables.items() if isinstance(value, dict)}
    lists = {key: value for key, value in tables.items() if isinstance(value, list) and value and isinstance(value[0], dict)}
    lines = [f'{key} = {json.dumps(value, ensure_ascii=False)}\n' for key, value in tables.items() if key not in inner | lists]
    parts = [f'\n[{name}{key}]\n{toml(table, f"{name}{key}.")}' for key, table in inner.items()]
    parts += [f'\n[[{name}{key}]]\n{toml(row, f"{name}{key}.")}' for key, rows in lists.items() for row in rows]
    return ''.join(lines + parts)


def scene_of(tables: dict[str, Any], particles: Atoms | None = None) -> Scene:
    """The scene of these tables, in the plain Python of `tomllib`; `particles` are those of its file."""
    try:
        return Scene.model_validate(tables, context=None if particles is None else {'structure': particles})
    except ValidationError as error:
        raise ValueError('\n'.join(_faults(error, tables))) from None


def _faults(error, data):
    return list(dict.fromkeys(_fault(found['loc'], reason(found), data) for found in error.errors()))


def _fault(loc, error, data):
    """The message with the dotted key in front, such as `law.a must be ...`; the kind of law in `loc` is no key."""
    name = ''
    for step in loc:
        if isinstance(data, dict) and step == data.get('kind'):
            continue
        name += f'[{step}]' if isinstance(step, int) else f'.{step}'
        if isinstance(step, int):
            data = data[step] if isinstance(data, list) and step < len(data) else None
        else:
            data = data.get(step) if isinstance(data, dict) else None  # a table of forces may stand in a file of its own
    text = str(error)
    return (name[1:] or 'the scene') + text if text[0] in ' .:[' else text


def reference() -> dict[str, Any]:
    """Numbers to check results against, in SI units: the tables of `data/reference.toml`, which gives the source of each number.

    Examples
    --------
    >>> from magphonon.scenes import reference
    >>> reference()['prototype']['gamma_Hz']
    26.550686524
    """
    return tomllib.loads((files('magphonon.data') / 'reference.toml').read_text(encoding='utf-8'))
