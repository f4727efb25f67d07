"""The energy log of a run, in the units of the package."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ase.md.logger import MDLogger

if TYPE_CHECKING:
    from pathlib import Path
    from typing import IO, Any

    from ase import Atoms
    from ase.md.md import MolecularDynamics


class EnergyLog(MDLogger):
    """Time and energies of a run, a line at a time: ASE's MDLogger, whose own columns are ps, eV and K.

    The total is that of the particles, their bonds, springs and dead loads; drives and damping change it.

    Parameters
    ----------
    dyn : ase.md.md.MolecularDynamics
    atoms : ase.Atoms
    logfile : path or file
        '-' is the terminal.
    comm : object
        ASE's communicator.
    """

    def __init__(self, dyn: MolecularDynamics, atoms: Atoms, logfile: str | Path | IO[str], comm: Any) -> None:
        super().__init__(dyn, atoms, logfile, header=False, comm=comm)  # pyright: ignore[reportArgumentType]  Path too
        self.hdr = f'{"Time[ms]":<16}' + ''.join(f'{name:>20}' for name in ('Etot[mJ]', 'Epot[mJ]', 'Ekin[mJ]'))
        self.logfile.write(self.hdr + '\n')

    def __call__(self) -> None:
        potential, kinetic = self._potential_energy(), self.atoms.get_kinetic_energy()
        energies = ''.join(f'{energy:20.11e}' for energy in (potential + kinetic, potential, kinetic))
        self.logfile.write(f'{self.dyn.get_time():<16.10g}{energies}\n')
        self.logfile.flush()
