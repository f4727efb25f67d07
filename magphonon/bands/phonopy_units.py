"""A phonon in the default units of phonopy and related programs: Angstrom, atomic mass unit, eV, and thus THz.

Frequencies of magnets in Hz are numbers like any others, and phonopy plots and tabulates them without harm.  Where it
multiplies them by Planck's constant it takes them for THz: heat capacities, free energies and mean square displacements
of a phonon in mm, g and N are then wrong by twelve powers of ten in the frequency, without a word.
"""

from __future__ import annotations

import warnings
from typing import TYPE_CHECKING

import numpy as np

from ..errors import finite
from ..units import J, kg, m
from .force_constants import TO_HZ, force_constants_of

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from numpy.typing import ArrayLike
    from phonopy import Phonopy

ZERO_FRACTION = 1e-6
"""Fraction of the highest frequency below which a frequency is zero: it is the square root of a rounded eigenvalue."""


def in_phonopy_units(phonon: Phonopy) -> Phonopy:
    """The same phonon in Angstrom, atomic mass units and eV/Angstrom^2, with frequencies in THz.

    For whatever knows no other units, files for Euphonic and others::

        in_phonopy_units(phonon).save('phonopy.yaml', settings={'force_constants': True})

    Parameters
    ----------
    phonon : phonopy.Phonopy
        From `finite_displacements`, in mm, g and N.

    Returns
    -------
    phonopy.Phonopy
        With force constants but without the forces they came from; never symmetrised, as the sum rule erases the foundation.

    Raises
    ------
    ValueError
        For a phonon without force constants, or one whose frequencies are not in Hz.

    Examples
    --------
    >>> from magphonon import finite_displacements, read_scene, ready_scene
    >>> from magphonon.bands import in_phonopy_units
    >>> phonon = finite_displacements(read_scene(ready_scene('prototype')).atoms())
    >>> crystal = in_phonopy_units(phonon)
    >>> round(float(crystal.run_qpoints([[0.5, 0, 0]]).frequencies[0, 2] * 1e12), 3)  # THz to Hz
    149.476
    """
    from phonopy import Phonopy
    from phonopy.physical_units import get_physical_units
    from phonopy.structure.atoms import PhonopyAtoms

    force_constants_of(phonon)
    if not abs(phonon.unit_conversion_factor / TO_HZ - 1) < 1e-6:  # the seven digits that a file keeps
        raise ValueError(f'the phonon has the unit conversion factor {phonon.unit_conversion_factor:.6g}, not {TO_HZ:.6g}: it is '
                         'not in mm, g and N with frequencies in Hz; convert one from finite_displacements')
    unit = get_physical_units()
    angstrom, amu, eV = unit.Angstrom * m, unit.AMU * kg, unit.EV * J
    cell = phonon.unitcell
    rescaled = PhonopyAtoms(symbols=cell.symbols, masses=cell.masses / amu, cell=cell.cell / angstrom,
                            scaled_positions=cell.scaled_positions)
    # phonopy compares positions to an absolute length, which grows with the numbers
    crystal = Phonopy(rescaled, phonon.supercell_matrix, primitive_matrix='P', is_symmetry=False,
                      symprec=phonon.symmetry.tolerance / angstrom)
    crystal.force_constants = phonon.force_constants / (eV / angstrom**2)
    return crystal


def thermal_properties(phonon: Phonopy, temperatures: ArrayLike, mesh: Sequence[int]) -> Any:
    """Heat capacity, entropy and free energy of the lattice's harmonic modes, by phonopy.

    Modes of zero frequency do not count, such as those along z of a planar lattice: round-off would make some of them
    oscillators as soft as one likes, of the heat capacity k each.

    Parameters
    ----------
    phonon : phonopy.Phonopy
        From `finite_displacements`.
    temperatures : array_like
        In K.
    mesh : three ints
        Numbers of wavevectors along the reciprocal vectors, from Gamma on; 1 along those that are not periodic.

    Returns
    -------
    phonopy.phonon.thermal_properties.ThermalProperties
        With the arrays `temperatures` (K), `heat_capacity` and `entropy` (J/K per mole of cells), `free_energy` (kJ per
        mole of cells).

    Raises
    ------
    ValueError
        As `in_phonopy_units`; also for a lattice with unstable modes, which has no equilibrium.

    Examples
    --------
    >>> from magphonon import finite_displacements, read_scene, ready_scene
    >>> from magphonon.bands import thermal_properties
    >>> phonon = finite_displacements(read_scene(ready_scene('prototype')).atoms())
    >>> warm = thermal_properties(phonon, [300.0], [4, 4, 1])
    >>> round(float(warm.heat_capacity[0] / 8.314462618), 3)  # k for each of two modes
    2.0
    """
    crystal = in_phonopy_units(phonon)
    frequencies = crystal.run_mesh(np.asarray(mesh), is_gamma_center=True).frequencies
    zero = ZERO_FRACTION * abs(frequencies).max()
    if frequencies.min() < -zero:
        raise ValueError(f'the lattice is unstable, with frequencies down to {frequencies.min() * 1e12:.4g} Hz on this mesh: '
                         'it has no thermal equilibrium; hold it with a foundation')
    with warnings.catch_warnings():
        # phonopy warns of modes at Gamma that are slow beside 1 THz; on a foundation they are oscillators like all others
        warnings.filterwarnings('ignore', message=r'\d+ acoustic mode')
        return crystal.run_thermal_properties(temperatures=finite('temperatures', temperatures).ravel(), cutoff_frequency=zero)
