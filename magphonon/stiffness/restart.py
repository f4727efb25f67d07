"""Restart: restores the calculator of atoms that were read from files of ASE.

ASE writes `calc.todict()` with the atoms to .traj files and databases.  It contains everything that the forces depend on,
including rest positions, anchors and bonds::

    atoms = magphonon.stiffness.restored(ase.io.read('relaxed.traj'))

    atoms = magphonon.stiffness.restored(ase.db.connect('lattices.db').get(1))
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from ase import Atoms

from ..errors import one_of
from .all_neighbours import AllNeighbours
from .calculator import PairCalculator
from .sites import RODS

if TYPE_CHECKING:
    from ase.db.row import AtomsRow

    from ..interactions.bond_laws import Laws

CALCULATORS = {'PairCalculator': PairCalculator, 'MagneticRepulsion': PairCalculator, 'AllNeighbours': AllNeighbours}


def restored(atoms: Atoms | AtomsRow, parameters: dict[str, Any] | None = None, laws: Laws | None = None) -> Atoms:
    """A copy of the atoms with the calculator that they had when they were written.

    Parameters
    ----------
    atoms : ase.Atoms or ase.db.row.AtomsRow
        As `ase.io.read` returns them from a .traj file, or a row of ase.db: `db.get(1)`, not `db.get_atoms(1)`, which leaves the
        calculator behind.
    parameters : dict, optional
        Parameters of the calculator; by default those that ASE's reader left on `atoms.calc`.
    laws : PairLaw, or mapping from pairs of kinds to PairLaw, optional
        Replaces the law in the file; needed if that law is not part of this package.

    Examples
    --------
    >>> import tempfile
    >>> from ase.io import read, write
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.stiffness import restored
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=2.0)
    >>> energy, file = cell.get_potential_energy(), tempfile.mkdtemp() + '/cell.traj'
    >>> write(file, cell)
    >>> again = restored(read(file))
    >>> bool(abs(again.get_potential_energy() - energy) < 1e-12)
    True
    """
    if not isinstance(atoms, Atoms):
        own = atoms.calculator_parameters  # pyright: ignore[reportAttributeAccessIssue]
        atoms, parameters = atoms.toatoms(), own if parameters is None else parameters
    calc: Any = atoms.calc
    found = getattr(calc, 'parameters', None) if parameters is None else parameters
    if not isinstance(found, dict) or 'calculator' not in found:
        raise ValueError('these atoms were written without a calculator of magphonon; from an ase.db pass the row, as in '
                         'restored(db.get(1)); otherwise attach PairCalculator(atoms, law, ...) again')
    cls = CALCULATORS[one_of('the calculator', found['calculator'], tuple(CALCULATORS))]
    atoms = atoms.copy()
    atoms.calc = cls.fromdict(found, laws)
    if atoms.calc.reference.has(RODS) and len(atoms) == len(atoms.calc.reference):  # ASE's files keep no such array
        atoms.set_array(RODS, atoms.calc.reference.get_array(RODS))
    return atoms
