"""`Shared`: a calculator that threads may share, and that calculates again after any change of the atoms."""

from __future__ import annotations

from functools import cached_property
from threading import RLock
from typing import TYPE_CHECKING

import numpy as np
from ase.calculators.calculator import Calculator, all_changes

if TYPE_CHECKING:
    from typing import Any

    from ase import Atoms


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
