"""Atoms for tools that assume eV, Angstrom and atomic mass units: the numbers that they call Angstrom are in mm, and THz are Hz.

A frequency is the root of a stiffness divided by a mass, and a tool prints `15.633 sqrt(K/m)` for numbers K in eV/Angstrom^2 and
m in amu, whatever they mean.  If K is in N/mm and 1 g is written as `GRAM`, this is the frequency in Hz.  Stiffness and mass may
also be multiplied by a common number.  It is chosen so that the masses are those of the chemical symbols, which some tools look
up in a table of their own.

The unit is Hz, not kHz, because tools have absolute thresholds: to them a mode is imaginary below -0.01 THz, and a structure is
at rest below 0.01 eV/Angstrom.  In kHz these would mean 10 Hz and 1e4 N: lattices that buckle, and any forces, would pass.
"""

from __future__ import annotations

import warnings
from typing import Any, ClassVar

import numpy as np
from ase import Atoms
from ase.calculators.calculator import Calculator, PropertyNotImplementedError, all_changes
from ase.data import atomic_masses

from ..traits import takes
from .calculator import stress_per_volume
from .repulsion import Repulsion, masses_of
from .rest import freedom
from .supercells import fitted, sites_of, strayed

GRAM = 9.64853082147604e-3
"""Mass of 1 g in a tool whose THz are Hz and whose eV are mJ: (2 pi 15.633302 / 1000)^2, with phonopy's constants, those of 1986.
Those of ASE give 9.6485333e-3, and its frequencies are 1.3e-7 higher."""
SAME_MASS = 1e-9  # relative spread of the ratio of masses to those of the symbols that is round-off


class _Rescaled(Calculator):
    """A calculator whose energies and forces are those of another one, multiplied by a number; it also has a stress."""

    implemented_properties: ClassVar[list[str]] = ['energy', 'free_energy', 'energies', 'forces', 'stress']

    def __init__(self, calc: Repulsion, scale: float) -> None:
        super().__init__()
        self.unscaled, self.scale = calc, scale

    def __repr__(self) -> str:
        return f'{self.unscaled!r} for other tools, energies times {self.scale:.7g}'

    def calculate(self, atoms: Atoms | None = None, properties: Any = ('energy',), system_changes: Any = all_changes) -> None:
        super().calculate(atoms, properties, system_changes)
        calc, here = fitted(self.unscaled, self.atoms)  # pyright: ignore[reportArgumentType]  which ASE has just set
        if calc is self.unscaled and calc.reference.pbc.any() and strayed(calc, here):  # as large, but in another order
            calc = calc.on(sites_of(calc, here))  # pyright: ignore[reportArgumentType]
        found = calc.answers(here, ('energy', 'forces'))
        if 'stress' in properties:
            if not calc.pairwise:
                raise PropertyNotImplementedError(f'{type(calc).__name__} has no stress; choose a number of shells')
            found['stress'] = stress_per_volume(calc, here)  # pyright: ignore[reportArgumentType]  what is pairwise has bonds
        self.results = {name: self.scale * value for name, value in found.items()}


@takes('all neighbours', 'conventional', 'oblique')
def for_ase_tools(atoms: Atoms) -> Atoms:
    """The same atoms for tools that expect eV, Angstrom and amu: the numbers that they call Angstrom are in mm, and THz are Hz.

    Use them with any tool that takes ASE's atoms with a calculator and computes vibrations, bands or a relaxation from its
    forces: ASE itself, janus-core, matcalc, phonopy and programs built on it. Such a tool may make supercells of its own.

    What tools call ps is s, and what they call Angstrom/ps is mm/s.  Masses are those of the chemical symbols, so that tools
    that look masses up are right too, and energies are scaled to match. Heat capacities and everything else that involves
    Planck's constant come out wrong.  The stress is that of the bonds alone.

    Tools that impose the acoustic sum rule erase the foundation.

    Parameters
    ----------
    atoms : ase.Atoms
        With a PairCalculator or AllNeighbours.

    Returns
    -------
    ase.Atoms
        A copy with a calculator of its own.

    Raises
    ------
    ValueError
        If particles are held: supercells that tools make do not keep constraints.

    Warns
    -----
    UserWarning
        If the masses are not in the ratio of those of the symbols: tools that look masses up need them set.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.stiffness import for_ase_tools
    >>> magnets = for_ase_tools(read_scene(ready_scene('prototype')).atoms())
    >>> magnets.get_masses().round(3)  # amu, the mass of Nd
    array([144.242])
    >>> magnets.positions[0, 0] += 1e-4  # all magnets at once, against the pillars
    >>> stiffness = -magnets.get_forces()[0, 0] / 1e-4
    >>> round(float(15.633302 * (stiffness / 144.242) ** 0.5), 3)  # THz, by the factor of phonopy: the cut-off at 26.551 Hz
    26.551
    """
    calc: Any = atoms.calc
    if not isinstance(calc, Repulsion):
        raise ValueError(f'the atoms carry {calc!r} as calculator; attach atoms.calc = PairCalculator(atoms, law, ...) first')
    freedom(atoms)  # refuses constraints that are not supported
    masses = GRAM * masses_of(atoms)
    scales = atomic_masses[atoms.numbers] / masses
    if np.ptp(scales) > SAME_MASS * scales[0]:
        warnings.warn('the masses are not in the ratio of those of the symbols: tools that look masses up by symbol, such as '
                      'matcalc, are wrong until you give them atoms.get_masses(); other tools '
                      'are right', UserWarning, stacklevel=2)
    found = atoms.copy()
    found.set_masses(scales[0] * masses)
    found.calc = _Rescaled(calc, scales[0])
    return found
