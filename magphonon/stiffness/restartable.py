"""`Restartable`: conversion of a calculator to a dictionary for ASE's files and databases, and back without loss.

`Shared`: a calculator that threads may share, and that calculates again after any change of the atoms.
"""

from __future__ import annotations

from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING, ClassVar

import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator, all_changes

from ..errors import shown
from ..interactions.bond_laws import laws_from_dict, laws_to_dict
from ..lattices.bonds import Bonds

if TYPE_CHECKING:
    from typing import Any, Self

    from ..interactions.bond_laws import Laws

class Shared(Calculator):
    """An ASE calculator that several threads may use at once.

    A lock prevents other threads from calculating between a calculation and the copy of its results.  Each copy of the
    calculator has its own lock.
    """

    atoms: Any  # of ASE, which declares them as None

    @cached_property
    def _lock(self):
        return RLock()

    def __getstate__(self):
        return {name: value for name, value in vars(self).items() if name != '_lock'}

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


UNITS = 'mm, g, ms'
"""The units of the numbers in such a dictionary, saved for readers of the file without this package."""


class Restartable(Shared):
    """An ASE calculator of a `reference` and `laws` that can be restored from its dictionary.

    Attributes
    ----------
    saved : tuple of str
        Keywords of the constructor that the forces depend on; each is an attribute of the same name.
    """

    saved: ClassVar[tuple[str, ...]]
    reference: Atoms
    laws: Any

    def todict(self, skip_default: bool = True) -> dict[str, Any]:
        """Everything that the forces depend on, for ASE's files and databases; `fromdict` restores the calculator from it."""
        parts = {name: getattr(self, name) for name in self.saved}
        return {'calculator': type(self).__name__, 'units': UNITS, 'reference': _reference_to_dict(self.reference),
                'potential': laws_to_dict(self.laws),
                **{name: _bonds_to_dict(part) if isinstance(part, Bonds) else part for name, part in parts.items()}}

    @classmethod
    def fromdict(cls, parameters: dict[str, Any], laws: Laws | None = None) -> Self:
        """The calculator that `todict` saved, without loss.

        Parameters
        ----------
        parameters : dict
            As ASE keeps it: `ase.io.read('file.traj').calc.parameters`, or `row.calculator_parameters` of a database.
        laws : PairLaw, or mapping from pairs of kinds to PairLaw, optional
            Replaces the one in the dictionary; needed for a law that is not of this package.

        Raises
        ------
        ValueError
            For the dictionary of something else, or a law that is not of this package.
        """
        parts = _checked(parameters, cls)
        reference = _reference_from_dict(parts['reference'])
        law = laws_from_dict(parts['potential']) if laws is None else laws
        given: Any = {name: _bonds_from_dict(parts[name], reference) if name == 'bonds' else parts[name] for name in cls.saved}
        return cls(reference, law, **given)


def _checked(parameters, cls):
    name = cls.__name__
    of = parameters.get('calculator') if isinstance(parameters, dict) else None
    if of is None:
        raise ValueError(f'the parameters of {name} must be a dictionary from {name}.todict(), not {shown(parameters)}')
    if of != name:
        raise ValueError(f'these are parameters of {of}, not of {name}; take {of}.fromdict, or magphonon.restored(atoms)')
    if missing := [key for key in ('reference', 'potential', *cls.saved) if key not in parameters]:
        raise ValueError(f'the parameters of {name} lack {", ".join(missing)}; write them again with this version')
    return parameters


def _reference_to_dict(atoms):
    """Rest positions, cell, masses, tags and constraints; other arrays are left out."""
    parts = atoms.todict()
    parts.pop('info', None)
    return parts | {'constraints': [constraint.todict() for constraint in atoms.constraints]}


def _reference_from_dict(parts):
    constraints = parts['constraints']
    arrays = {name: np.array(value) for name, value in parts.items() if name != 'constraints'}
    return Atoms.fromdict(arrays | {'constraints': constraints})


def _bonds_to_dict(bonds):
    """Which particles are bonded, in their order; their vectors follow from the reference."""
    return {'i': bonds.i, 'j': bonds.j, 'shift': bonds.shift, 'cutoff': bonds.cutoff}


def _bonds_from_dict(parts, reference):
    i, j, shift = (np.array(parts[name], int) for name in ('i', 'j', 'shift'))
    shift = shift.reshape(-1, 3)
    vectors = reference.positions[j] + shift @ reference.cell.array - reference.positions[i]
    return Bonds(i, j, shift, vectors, len(reference), parts['cutoff'])
