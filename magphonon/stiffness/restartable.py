"""Base classes of both calculators: threads may share one (`Shared`), and it can be saved and restored (`Restartable`)."""

from __future__ import annotations

from functools import cached_property
from threading import RLock
from typing import Any, ClassVar, Self

import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator, all_changes
from ase.constraints import dict2constraint

from ..errors import finite, positive, shown
from ..interactions.bond_laws import Laws, laws_from_dict, laws_to_dict
from ..lattices.bonds import Bonds, vectors_between

UNITS = 'mm, g, ms'  # the units of all numbers of a saved calculator
REFERENCE = 'numbers', 'positions', 'cell', 'pbc', 'masses', 'constraints'  # of a reference, and its tags
BONDS = 'i', 'j', 'shift', 'cutoff'


class Shared(Calculator):
    """An ASE calculator that several threads may use at once.

    A lock prevents other threads from calculating between a calculation and the copy of its results.  Each copy of the
    calculator has its own lock, and starts without the supercells that the original has stored.
    """

    atoms: Any  # of ASE, which declares them as None

    @cached_property
    def _lock(self):
        return RLock()

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name not in ('_asked', '_lock', 'supercells', 'seen')}

    def get_property(self, name: str, atoms: Atoms | None = None, allow_calculation: bool = True) -> Any:
        with self._lock:
            return super().get_property(name, atoms, allow_calculation)

    def check_state(self, atoms: Atoms, tol: float = 0.0) -> list[str]:
        """The names of the arrays that differ from those of the last calculation.

        A displacement below 1e-15 is a change too, and exact comparison is cheaper than ASE's with a tolerance for every array.
        """
        if self.atoms is None:
            return all_changes
        changes = []
        if not np.array_equal(self.atoms.positions, atoms.positions):
            changes.append('positions')
        if not np.array_equal(self.atoms.cell.array, atoms.cell.array):
            changes.append('cell')
        if not np.array_equal(self.atoms.pbc, atoms.pbc):
            changes.append('pbc')
        if not np.array_equal(self.atoms.numbers, atoms.numbers):
            changes.append('numbers')
        return changes


class Restartable(Shared):
    """An ASE calculator of a `reference` and `laws` that can be restored from its dictionary.

    Attributes
    ----------
    sites : Sites
    saved : tuple of str
        Keywords of the constructor that the forces depend on; each is an attribute of the same name, or one of `sites`.
    seldom : tuple of str
        Keywords that are saved only if they are not zero, and are zero if a file lacks them.
    """

    saved: ClassVar[tuple[str, ...]]
    seldom: ClassVar[tuple[str, ...]] = ()
    reference: Atoms
    laws: Any
    sites: Any

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
        of = parameters.get('calculator') if isinstance(parameters, dict) else None
        if of is None:
            raise ValueError(f'the parameters of {name} must be a dictionary from {name}.todict(), not {shown(parameters)}')
        if of != name:
            raise ValueError(f'these are parameters of {of}, not of {name}; take {of}.fromdict, or magphonon.restored(atoms)')
        given = _table(f'the saved {name}', parameters, ('units', 'reference', 'potential', *cls.saved))
        if given['units'] != UNITS:
            raise ValueError(f'the saved {name} has numbers in {shown(given["units"])}, not in {UNITS}; convert them first')
        names = *cls.saved, *(name for name in cls.seldom if name in given)
        for none in [key for key in names if given[key] is None][:1]:
            raise ValueError(f'the entry {none} of the saved {name} is empty; write it again')
        reference = _reference_from_dict(given['reference'])
        parts: Any = {key: _bonds_from_dict(given[key], reference) if key == 'bonds' else given[key] for key in names}
        return cls(reference, laws_from_dict(given['potential']) if laws is None else laws, **parts)


def _table(name, given, entries):
    """The given dictionary, or ValueError unless it has these entries."""
    if not isinstance(given, dict):
        raise ValueError(f'{name} must be a table of {", ".join(entries)}, not {shown(given)}')
    if missing := [entry for entry in entries if entry not in given]:
        raise ValueError(f'{name} lacks {", ".join(missing)}; write it again with this version')
    return given


def _wholes(name, values, shape, least=-(2**31), most=2**31):
    found = finite(name, values, shape)
    if found.size and not (found.min() >= least and found.max() <= most and (found == np.rint(found)).all()):
        raise ValueError(f'{name} must hold whole numbers from {least} to {most}, not {shown(values)}')
    return found.astype(int)


def _reference_to_dict(atoms):
    """Rest positions, cell, masses, tags and constraints; other arrays are left out."""
    parts = {'numbers': atoms.numbers, 'positions': atoms.positions, 'cell': atoms.cell.array, 'pbc': atoms.pbc,
             'masses': atoms.get_masses(), 'constraints': [constraint.todict() for constraint in atoms.constraints]}
    return parts | ({'tags': atoms.get_tags()} if atoms.has('tags') else {})


def _reference_from_dict(given):
    parts = _table('the entry reference', given, REFERENCE)
    n = np.size(finite('reference.masses', parts['masses']))
    atoms = Atoms(numbers=_wholes('reference.numbers', parts['numbers'], (n,), 0, 118),
                  positions=finite('reference.positions', parts['positions'], (n, 3)),
                  cell=finite('reference.cell', parts['cell'], (3, 3)), pbc=_wholes('reference.pbc', parts['pbc'], (3,), 0, 1),
                  masses=finite('reference.masses', parts['masses'], (n,)))
    if 'tags' in parts:
        atoms.set_tags(_wholes('reference.tags', parts['tags'], (n,)))
    if not isinstance(parts['constraints'], list | tuple):
        raise ValueError(f'reference.constraints must be a list, not {shown(parts["constraints"])}')
    try:
        constraints = [dict2constraint(constraint) for constraint in parts['constraints']]
        for constraint in constraints:
            _wholes('the particles of a constraint', getattr(constraint, 'index', []), None, 0, n - 1)
    except Exception as error:  # ASE's reader raises errors of all kinds for damaged data
        raise ValueError('reference.constraints cannot be read; write the calculator again') from error
    atoms.set_constraint(constraints)
    return atoms


def _bonds_from_dict(given, reference):
    parts = _table('the entry bonds', given, BONDS)
    n, last = np.size(finite('bonds.i', parts['i'])), len(reference) - 1
    i, j = (_wholes(f'bonds.{end}', parts[end], (n,), 0, last) for end in ('i', 'j'))
    shift = _wholes('bonds.shift', np.reshape(parts['shift'], (0, 3)) if not n else parts['shift'], (n, 3))
    cutoff = None if parts['cutoff'] is None else positive('bonds.cutoff', parts['cutoff'], 'mm')
    return Bonds(i, j, shift, vectors_between(reference, i, j, shift), len(reference), cutoff)
