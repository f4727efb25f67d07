"""The dictionary that a calculator is saved as, and the calculator made from it again."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from ase.constraints import dict2constraint

from ..errors import finite, positive, shown
from ..interactions.bond_laws import Laws, laws_from_dict, laws_to_dict
from ..lattices.bonds import Bonds, vectors_between

if TYPE_CHECKING:
    from .repulsion import Repulsion

UNITS = 'mm, g, ms'  # the units of all numbers of a saved calculator
REFERENCE = 'numbers', 'positions', 'cell', 'pbc', 'masses', 'constraints'  # of a reference, and its tags
BONDS = 'i', 'j', 'shift', 'cutoff'


def to_dict(calc: Repulsion) -> dict[str, Any]:
    """All that the forces of a calculator depend on."""
    own = vars(calc.sites)
    parts = {name: own[name] if name in own else getattr(calc, name) for name in (*calc.saved, *calc.seldom)}
    parts = {name: value for name, value in parts.items() if name in calc.saved or np.any(value)}
    if 'bonds' in parts:  # their vectors follow from the reference
        parts['bonds'] = {name: getattr(parts['bonds'], name) for name in BONDS}
    return {'calculator': type(calc).__name__, 'units': UNITS, 'reference': _reference_to_dict(calc.reference),
            'potential': laws_to_dict(calc.laws), **parts}


def from_dict(cls: type[Repulsion], parameters: dict[str, Any], laws: Laws | None) -> Any:
    """A calculator of a class from what `to_dict` returned, with other laws if they are given."""
    name = cls.__name__
    given = _checked(cls, name, parameters)
    names = *cls.saved, *(name for name in cls.seldom if name in given)
    for none in [key for key in names if given[key] is None][:1]:
        raise ValueError(f'the entry {none} of the saved {name} is empty; write it again')
    reference = _reference_from_dict(given['reference'])
    parts: Any = {key: _bonds_from_dict(given[key], reference) if key == 'bonds' else given[key] for key in names}
    make: Any = cls
    return make(reference, laws_from_dict(given['potential']) if laws is None else laws, **parts)


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
