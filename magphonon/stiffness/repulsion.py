"""`Repulsion`: what both calculators have in common, and the function that returns the calculator of atoms."""

from __future__ import annotations

from dataclasses import fields, replace
from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING, Any, ClassVar, Self

import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator, all_changes
from ase.constraints import dict2constraint
from numpy.typing import NDArray

from ..errors import one_of, positive, shown
from ..interactions.bond_laws import laws_from_dict, laws_of, laws_to_dict
from ..lattices.bonds import Bonds, lengths_of, vectors_between
from .sites import FLAT, RODS, Foundation, Sites, each_spring, gyration_blocks, height
from .supercells import NEAR, fitted, jumped, refuse_another_order

if TYPE_CHECKING:
    from ..interactions.bond_laws import Laws
    from ..interactions.pair_laws import PairInteraction, PairLaw
    from .calculator import PairCalculator
    from .matrices import Model

UNITS = 'mm, g, ms'  # the units of all numbers of a saved calculator
REFERENCE = 'numbers', 'positions', 'cell', 'pbc', 'masses', 'constraints'  # of a reference, and its tags
BONDS = 'i', 'j', 'shift', 'cutoff'


class Repulsion(Calculator):
    """Particles that repel each other, on a foundation: the base of `PairCalculator` and `AllNeighbours`.

    Bands, speeds of sound, phonopy's finite displacements and buckling use only the attributes and methods of this class, so they
    accept both calculators. Every Bloch matrix already contains the foundation.

    Several threads may use a calculator at once: a lock prevents other threads from calculating between a calculation and the
    copy of its results.  Each copy of the calculator has its own lock, and starts without the supercells that the original has
    stored.

    Attributes
    ----------
    reference : ase.Atoms
        The positions from which displacements are measured, without a calculator.
    bonds : Bonds
        The pairs that repel each other; for an infinite lattice, the nearest ones.
    interaction : PairInteraction
        Energy, gradient and stiffness of every bond, by its vector.
    pairwise : bool
        Whether the listed bonds are the complete repulsion.  Only then is the stiffness known bond by bond, as finite
        structures, other positions and other spacings require.
    dim : int
        Number of components of a displacement: 2 in the plane, 3 in space.
    model : str
        The model of the forces and of their stiffness at rest.
    bloch_models : tuple of str
        The models that have a Bloch matrix.
    saved, seldom : tuple of str
        Keywords of the constructor that the forces depend on: those that files hold, and those that they hold only if they are
        not zero. Each is an attribute of the same name, or one of `sites`.
    """

    pairwise: ClassVar[bool]
    saved: ClassVar[tuple[str, ...]]
    seldom: ClassVar[tuple[str, ...]]
    reference: Atoms
    bonds: Bonds
    interaction: PairInteraction
    dim: int
    atoms: Any  # of ASE, which declares them as None
    parameters: Any
    model: Any
    bloch_models: Any
    _laws: Any
    _sites: Sites
    seen: NDArray[np.float64] | None = None  # positions of the last call

    @cached_property
    def _lock(self):
        return RLock()

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name not in ('_asked', '_lock', 'supercells', 'seen')}

    def get_property(self, name: str, atoms: Atoms | None = None, allow_calculation: bool = True) -> Any:
        with self._lock:
            return super().get_property(name, atoms, allow_calculation)

    def check_state(self, atoms: Atoms, tol: float = 0.0) -> list[str]:
        """The name of the first array that differs from that of the last calculation, as a list; empty if all are equal.

        A displacement below 1e-15 is a change too, and exact comparison is cheaper than ASE's with a tolerance for every array.
        """
        if self.atoms is None:
            return all_changes
        pairs = ((name, getattr(self.atoms, name), getattr(atoms, name)) for name in ('positions', 'cell', 'pbc', 'numbers'))
        return next(([name] for name, before, now in pairs if not np.array_equal(before, now)), [])

    def todict(self, skip_default: bool = True) -> dict[str, Any]:
        """Everything that the forces depend on, for ASE's files and databases; `fromdict` restores the calculator from it."""
        own = vars(self.sites)
        parts = {name: own[name] if name in own else getattr(self, name) for name in (*self.saved, *self.seldom)}
        parts = {name: value for name, value in parts.items() if name in self.saved or np.any(value)}
        if 'bonds' in parts:  # their vectors follow from the reference
            parts['bonds'] = {name: getattr(parts['bonds'], name) for name in BONDS}
        return {'calculator': type(self).__name__, 'units': UNITS, 'reference': _reference_to_dict(self.reference),
                'potential': laws_to_dict(self.laws), **parts}

    @classmethod
    def fromdict(cls, parameters: dict[str, Any], laws: Laws | None = None) -> Self:
        """The calculator that `todict` saved, without loss.

        Parameters
        ----------
        parameters : dict
            As ASE keeps it: `ase.io.read('file.traj').calc.parameters`, or `row.calculator_parameters` of a database.
        laws : PairLaw, or mapping from pairs of kinds to PairLaw, optional
            Replaces the laws in the dictionary; needed for a law that is not part of this package.
        """
        name = cls.__name__
        given = _checked(cls, name, parameters)
        names = *cls.saved, *(name for name in cls.seldom if name in given)
        for none in [key for key in names if given[key] is None][:1]:
            raise ValueError(f'the entry {none} of the saved {name} is empty; write it again')
        reference = _reference_from_dict(given['reference'])
        parts: Any = {key: _bonds_from_dict(given[key], reference) if key == 'bonds' else given[key] for key in names}
        make: Any = cls
        return make(reference, laws_from_dict(given['potential']) if laws is None else laws, **parts)

    def answers(self, atoms: Atoms, properties: Any) -> dict[str, Any]:
        """Energy, forces and other requested `properties` of the displaced or strained reference, by name."""
        raise NotImplementedError

    def calculate(self, atoms: Atoms | None = None, properties: Any = ('energy',), system_changes: Any = all_changes) -> None:
        if atoms is not None and jumped(self, atoms):
            refuse_another_order(self, atoms)
        if atoms is not None:  # what `super().calculate` does, but constraints, which take longest to copy, are shared
            self.atoms = Atoms(cell=atoms.cell, pbc=atoms.pbc, constraint=atoms.constraints)
            self.atoms.arrays = {name: values.copy() for name, values in atoms.arrays.items()}
        calc, atoms = fitted(self, self.atoms)  # of the reference, or of a supercell of it in any order
        self.results = calc.answers(atoms, properties)
        self.seen = self.atoms.positions

    @cached_property
    def near(self) -> float:
        """Displacement in mm beyond which the nearest site may belong to another particle."""
        return NEAR * self.bonds.shortest

    @property
    def bond_sizes(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Size of the force of each bond at rest in N, and of its stiffness against stretching in N/mm."""
        R, law = self.bonds.vectors[:, : self.dim], self.interaction.central(self.dim)
        if law is not None:
            r = lengths_of(R)
            return abs(law.dphi(r)), abs(law.d2phi(r))
        return np.linalg.norm(self.interaction.forces(R)[1], axis=1), abs(np.einsum('bxx->b', self.interaction.stiffness(R)[0]))

    @cached_property
    def largest(self) -> tuple[float, float]:
        """Size of the largest force of a bond at rest in N, and of the largest stiffness against stretching in N/mm."""
        force, stiffness = self.bond_sizes
        return float(force.max(initial=0.0)), float(stiffness.max(initial=0.0))

    @cached_property
    def supercells(self) -> list[Any]:
        """Calculators made from this one for supercells, the latest first."""
        return []

    @property
    def sites(self) -> Sites:
        """The properties of each site. They are frozen: `changed(sites=...)` makes a calculator with other sites."""
        return self._sites

    def set(self, **parameters: Any) -> dict[str, Any]:
        """Change the parameters that `default_parameters` names; cached results are deleted."""
        for name in parameters:
            one_of('parameter', name, tuple(self.default_parameters))
        own = {f.name: f.metadata['checked'](parameters[f.name], self.reference, self.dim) for f in fields(Sites)
               if f.name in parameters}
        self._sites = replace(self._sites, **own)
        for made_of_sites in ('offset', '_asked'):
            vars(self).pop(made_of_sites, None)
        self.supercells.clear()
        changed = super().set(**parameters | own)
        self.reset()
        return changed

    def changed(self, reference: Atoms | None = None, bonds: Bonds | None = None, sites: Sites | None = None, *,
                laws: Any = None, model: Model | None = None, dim: int | None = None) -> Any:
        """A calculator with another reference, other bonds, sites, laws or another model. All calculators derived from another
        are made here.

        Everything not given stays the same, particle by particle; bonds are measured again at the reference.
        """
        raise NotImplementedError

    @property
    def laws(self) -> Any:
        """The pair law, or the laws of the pairs of kinds, as given; read-only: make a new calculator to change it."""
        return self._laws

    @property
    def law(self) -> PairLaw:
        """The pair law of every bond, for arrays of distances whose first axis is that of the bonds.

        A `magphonon.interactions.bond_laws.BondLaws`; or the law itself, if all bonds have the same law and all strengths are 1.
        For magnets that leave their plane it is the law in the plane.
        """
        found = self.interaction.central(self.dim)
        found = self.interaction.central(2) if found is None else found
        if found is None:
            names = ', '.join(sorted({type(law).__name__ for law in laws_of(self.laws)}))
            raise ValueError(f'the forces of {names} are not along the line between two particles: they have no law of the '
                             'distance')
        return found

    @property
    def strengths(self) -> NDArray[np.float64]:
        """Strength of each particle, shape (particles,); read-only: make a new calculator to change it."""
        return self._sites.strengths

    @property
    def foundation(self) -> Foundation:
        """Stiffness of the spring between each particle and its anchor, N/mm: one number, or shape (particles, dim)."""
        return self._sites.foundation

    @property
    def rate(self) -> Any:
        """Matrices B of the velocity-dependent forces -m B u', in 1/ms: shape (1 or particles, dim, dim), or zero."""
        return gyration_blocks(self.gyration, self.dim) if np.any(self.gyration) else 0.0

    @property
    def turning(self) -> float:
        """The largest rate of gyration in rad/ms; zero if nothing gyrates."""
        g = self._sites.gyration
        return float(np.max(np.linalg.norm(g, axis=1) if np.ndim(g) == 2 else abs(np.asarray(g))))

    @property
    def slack(self) -> NDArray[np.float64]:
        """Extension of the foundation springs at rest: vectors from anchor to rest in mm, shape (particles, 3)."""
        return np.broadcast_to(0.0, self.reference.positions.shape)

    @property
    def tied(self) -> bool:
        """Whether anything ties particles to their places."""
        return self._sites.has('foundation')

    @property
    def gyration(self) -> Any:
        """Rate g in rad/ms at which the force m u' x g turns velocities: one number, shape (particles,) or (particles, 3)."""
        return self._sites.gyration

    @property
    def layer(self) -> bool:
        """Whether the particles of a planar structure may move out of the plane, each on its own support."""
        flat = height(self.reference, self.bonds) <= FLAT * self.bonds.shortest
        return self.dim == 3 and not self.reference.pbc.all() and flat

    def in_plane(self) -> Any:
        """For a layer, the same calculator without motion out of its plane; for a planar structure, the calculator itself."""
        if not self.layer:
            return self
        springs = each_spring(self.foundation, len(self.reference), self.dim).reshape(-1, self.dim)[:, :2]
        return self.changed(sites=replace(self.sites, foundation=springs), dim=2)

    def on(self, supercell: Atoms) -> Repulsion:
        """The same calculator on a supercell of its reference."""
        raise NotImplementedError

    def displacements(self, atoms: Atoms) -> NDArray[np.float64]:
        """Displacements from the reference in mm, shape (particles, dim)."""
        raise NotImplementedError

    def bloch_matrix(self, q: NDArray[np.float64], model: Model | None = None) -> NDArray[np.complex128]:
        """Bloch matrix at the reference, foundation included, N/mm; `q` of shape (wavevectors, 3)."""
        raise NotImplementedError

    def bloch_gradient(self, q: NDArray[np.float64], model: Model | None = None) -> NDArray[np.complex128]:
        """Derivative of the Bloch matrix with respect to the Cartesian wavevector, in N.

        Its shape is (dim, wavevectors, particles * dim, particles * dim).
        """
        raise NotImplementedError

    def bloch_series(self, along: NDArray[np.float64],
                     model: Model | None = None) -> tuple[NDArray[np.complex128], NDArray[np.complex128], NDArray[np.complex128]]:
        """The Bloch matrix without foundation to second order in the wavevector `along`, a unit vector."""
        raise NotImplementedError

    def singular(self, along: NDArray[np.float64], model: Model | None = None) -> NDArray[np.float64]:
        """Signs of the terms that exceed the second order in long waves, shape (dim, dim); zero for laws of short range."""
        raise NotImplementedError


def repulsion_of(atoms: Atoms) -> PairCalculator:
    """The calculator of `atoms`, whose repulsion must be known bond by bond; the masses are checked too."""
    calc: Any = atoms.calc
    if not getattr(calc, 'pairwise', False):
        if not isinstance(calc, Repulsion):
            raise ValueError(f'the atoms carry {calc!r} as calculator; '
                             'attach atoms.calc = PairCalculator(atoms, law, ...)')
        raise ValueError(f'this needs the stiffness of each bond, which {type(calc).__name__} does not have; '
                         'attach atoms.calc = PairCalculator(atoms, law, ...) with a number of shells')
    masses_of(atoms)
    return calc  # pyright: ignore[reportReturnType]  what is pairwise is a PairCalculator or like one


def masses_of(atoms: Atoms) -> NDArray[np.float64]:
    """Masses in g, shape (particles,)."""
    masses = atoms.get_masses()
    for k in np.flatnonzero(~(np.isfinite(masses) & (masses > 0)))[:1]:
        positive(f'mass of particle {k}', masses[k], 'g')
    return masses


def _checked(cls, name, parameters):
    """The parameters of a calculator of this class, in its units."""
    of = parameters.get('calculator') if isinstance(parameters, dict) else None
    if of is None:
        raise ValueError(f'the parameters of {name} must be a dictionary from {name}.todict(), not {shown(parameters)}')
    if of != name:
        raise ValueError(f'these are parameters of {of}, not of {name}; take {of}.fromdict, or stiffness.restored(atoms)')
    given = _table(f'the saved {name}', parameters, ('units', 'reference', 'potential', *cls.saved))
    if given['units'] != UNITS:
        raise ValueError(f'the saved {name} has numbers in {shown(given["units"])}, not in {UNITS}; convert them first')
    return given


def _table(name, given, entries):
    """The given dictionary, or ValueError unless it has these entries."""
    if not isinstance(given, dict):
        raise ValueError(f'{name} must be a table of {", ".join(entries)}, not {shown(given)}')
    if missing := [entry for entry in entries if entry not in given]:
        raise ValueError(f'{name} lacks {", ".join(missing)}; write it again with this version')
    return given


def _reference_to_dict(atoms):
    """Rest positions, cell, masses, tags, rods and constraints; other arrays are left out."""
    parts = {'numbers': atoms.numbers, 'positions': atoms.positions, 'cell': atoms.cell.array, 'pbc': atoms.pbc,
             'masses': atoms.get_masses(), 'constraints': [constraint.todict() for constraint in atoms.constraints]}
    return parts | {name: atoms.get_array(name) for name in ('tags', RODS) if atoms.has(name)}


def _reference_from_dict(given):
    parts = _table('the entry reference', given, REFERENCE)
    try:
        atoms = Atoms(**{name: parts[name] for name in REFERENCE if name != 'constraints'}, tags=parts.get('tags'))
        atoms.set_constraint([dict2constraint(constraint) for constraint in parts['constraints']])
        if RODS in parts:
            atoms.set_array(RODS, np.asarray(parts[RODS], float))
    except Exception as error:  # ASE raises errors of all kinds for damaged data
        raise ValueError(f'the entry reference cannot be read ({error}); write the calculator again') from error
    return atoms


def _bonds_from_dict(given, reference):
    parts = _table('the entry bonds', given, BONDS)
    i, j, shift = (np.asarray(parts[name], int) for name in ('i', 'j', 'shift'))
    if i.shape != j.shape or not ((i >= 0) & (i < len(reference)) & (j >= 0) & (j < len(reference))).all():
        raise ValueError(f'the entry bonds must have pairs i, j of the {len(reference)} particles; write the calculator again')
    shift = shift.reshape(-1, 3)  # of none the files keep no shape
    return Bonds(i, j, shift, vectors_between(reference, i, j, shift), len(reference), parts['cutoff'])
