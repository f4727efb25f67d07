"""Files of bands and force constants for phonopy and related programs, and thermal properties by phonopy.

Files are in mm and N. Masses are scaled (1 g is written as `GRAM` of `stiffness.other_tools`), so that the numbers that phonopy
prints as THz are in Hz. Where phonopy multiplies a frequency by Planck's constant, it assumes THz. Heat
capacities, free energies and mean square displacements would then, without a warning, be those of frequencies 10^12 times too
high, so for these the frequencies are converted.
"""

from __future__ import annotations

import re
import warnings
from collections.abc import Sequence
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from ase.dft.kpoints import BandPath, parse_path_string
from numpy.typing import ArrayLike

from ..errors import Unstable, finite
from ..files import refuse_overflow, whole_file
from ..stiffness.other_tools import GRAM
from .force_constants import TO_HZ, force_constants_of, path_on

if TYPE_CHECKING:
    from phonopy import Phonopy

ZERO_FRACTION = 1e-6  # of the highest frequency: below is the square root of a rounded eigenvalue
KEY = re.compile(r'[ -]*(\w+):')
DECIMALS = re.compile(r'-?\d+\.\d{6,}')  # a number as phonopy writes it, with decimals enough for Angstrom, u and eV


def thermal_properties(phonon: Phonopy, temperatures: ArrayLike, mesh: Sequence[int]) -> Any:
    """Heat capacity, entropy and free energy of the lattice's harmonic modes, by phonopy.

    Modes of zero frequency do not count, such as those along z of a planar lattice: round-off would turn some of them into very
    soft oscillators, each with the heat capacity k.

    Parameters
    ----------
    phonon : phonopy.Phonopy
        From `finite_displacements`, or from `phonopy.load` of what `write_phonopy_params` wrote.
    temperatures : array_like
        In K.
    mesh : three ints
        Number of wavevectors along each reciprocal vector, starting at Gamma; 1 along directions that are not periodic.

    Returns
    -------
    phonopy.phonon.thermal_properties.ThermalProperties
        With the arrays `temperatures` (K), `heat_capacity` and `entropy` (J/K per mole of cells), `free_energy` (kJ per
        mole of cells).

    Raises
    ------
    ValueError
        If the lattice has unstable modes, so that it has no equilibrium.

    Examples
    --------
    >>> from magphonon import finite_displacements, read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import thermal_properties
    >>> phonon = finite_displacements(read_scene(ready_scene('prototype')).atoms())
    >>> warm = thermal_properties(phonon, [300.0], [4, 4, 1])
    >>> round(float(warm.heat_capacity[0] / 8.314462618), 3)  # k for each of two modes
    2.0
    """
    force_constants_of(phonon)  # raises an error if there are none
    crystal = phonon.replicate()
    crystal.force_constants = phonon.force_constants
    crystal.unit_conversion_factor = 1e-12 * phonon.unit_conversion_factor  # Hz to THz
    frequencies = crystal.run_mesh(np.asarray(mesh), is_gamma_center=True).frequencies
    zero = ZERO_FRACTION * abs(frequencies).max()
    if frequencies.min() < -zero:
        raise Unstable(f'the lattice is unstable, with frequencies down to {frequencies.min() * 1e12:.4g} Hz on this mesh: '
                         'it has no thermal equilibrium; hold it with a foundation')
    with warnings.catch_warnings():
        # phonopy warns of modes at Gamma that are slow beside 1 THz, or far from zero; on a foundation they are oscillators like
        # all others, and to symmetrise, as it advises, would erase them
        warnings.filterwarnings('ignore', message=r'(\d+|The) acoustic')
        return crystal.run_thermal_properties(temperatures=finite('temperatures', temperatures).ravel(), cutoff_frequency=zero)


def write_band_yaml(phonon: Phonopy, path: BandPath, file: str | PathLike[str]) -> None:
    """Write bands and modes as phonopy's band.yaml, for `phonopy-bandplot` and the phononwebsite viewer.

    Modes have phonopy's phase and three components. In a planar lattice, one mode per particle points along z and has the
    frequency zero.

    Parameters
    ----------
    phonon : phonopy.Phonopy
        From `finite_displacements`.
    path : ase.dft.kpoints.BandPath
        A path through named points, from `atoms.cell.bandpath(...)`.
    file : path-like
        Usually band.yaml; written whole or not at all.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from magphonon import finite_displacements, read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import write_band_yaml
    >>> scene = read_scene(ready_scene('prototype'))
    >>> file = Path(tempfile.mkdtemp()) / 'band.yaml'
    >>> write_band_yaml(finite_displacements(scene.atoms()), scene.band_path(), file)
    >>> file.exists()
    True
    """
    refuse_overflow(file, {'force constants': force_constants_of(phonon)})
    pieces, names, connected = _pieces(path_on(phonon, path))
    labels = [r'$\Gamma$' if name == 'G' else name for name in names]
    bands = phonon.run_band_structure(pieces, with_eigenvectors=True, path_connections=connected, labels=labels)
    # the viewer looks for a calculator (an unknown one leaves the lengths alone) and, in older versions, a supercell
    comment = {'calculator': 'magphonon', 'length_unit': 'mm', 'frequency_unit': 'Hz',
               'supercell_matrix': phonon.supercell_matrix.tolist()}
    with whole_file(file) as partial:
        bands.write_yaml(comment, partial.name)
        text = Path(partial.name).read_text(encoding='utf-8')
        partial.truncate(0)
        partial.write(_with_all_digits(text, {'mass': phonon.primitive.masses, 'lattice': phonon.primitive.cell}))


def _pieces(path):
    """Straight pieces of a path, both ends included, as phonopy wants them."""
    pieces = []
    names = []  # of the end of each piece, and of its start where it does not continue the piece before
    connected = []  # whether the next piece continues this one
    start = 0
    for section in filter(None, parse_path_string(path.path)):
        names.append(section[0])
        for a, b in pairwise(section):
            at_b = np.flatnonzero(abs(path.kpts[start + 1 :] - path.special_points[b]).max(axis=1) < 1e-9)
            if abs(path.kpts[start] - path.special_points[a]).max() > 1e-9 or not len(at_b):
                raise ValueError(f'the path {path.path!r} does not run from {a} to {b}; get it from atoms.cell.bandpath(...)')
            stop = start + 1 + at_b[0]
            pieces.append(path.kpts[start : stop + 1])
            names.append(b)
            connected.append(True)
            start = stop
        connected[-1:] = [False]
        start += 1
    if not pieces:
        raise ValueError('the path names no special points; get the path from atoms.cell.bandpath(...)')
    return pieces, names, connected


def write_phonopy_params(phonon: Phonopy, file: str | PathLike[str]) -> None:
    """Write cells, displacements, forces and force constants for `phonopy.load` and the `phonopy` command.

    When phonopy, Euphonic and others read this file, the frequencies that they call THz are in Hz, and the lengths that they call
    Angstrom are in mm: masses are written in the unit that makes it so. `phonopy.load` and Euphonic use the force constants as
    they are. The command `phonopy` would impose the acoustic sum rule, which erases the foundation, unless it is given
    `--no-sym-fc`::

        phonon = phonopy.load('phonopy_params.yaml')

        phonopy --no-sym-fc --nosym --nonac --band "0 0 0  1/2 0 0" phonopy_params.yaml

    In lattices smaller than 1e-4 mm, particles are closer than phonopy's tolerance of 1e-5: set `symprec=`, or `--tolerance` of
    the command, to the value `phonon.symmetry.tolerance`.

    Parameters
    ----------
    phonon : phonopy.Phonopy
        From `finite_displacements`.
    file : path-like
        Usually phonopy_params.yaml; written whole or not at all.

    Examples
    --------
    >>> import tempfile
    >>> from pathlib import Path
    >>> from magphonon import finite_displacements, read_scene
    >>> from magphonon.scenes import ready_scene
    >>> from magphonon.bands import write_phonopy_params
    >>> file = Path(tempfile.mkdtemp()) / 'phonopy_params.yaml'
    >>> write_phonopy_params(finite_displacements(read_scene(ready_scene('prototype')).atoms()), file)
    >>> file.exists()
    True
    """
    refuse_overflow(file, {'force constants': force_constants_of(phonon)})
    cells = phonon.primitive, phonon.unitcell, phonon.supercell
    gram = GRAM * (phonon.unit_conversion_factor / TO_HZ) ** -2  # a phonon that was loaded has these masses already
    exact = {'mass': gram * np.concatenate([cell.masses for cell in cells]), 'lattice': [cell.cell for cell in cells],
             'elements': phonon.force_constants}
    if displaced := (phonon.dataset or {}).get('first_atoms'):
        exact |= {key: [dict(one)[key] for one in displaced] for key in ('displacement', 'forces')}
    text = _with_all_digits(str(phonon.to_phonopy_yaml(settings={'force_constants': True})), exact)
    with whole_file(file) as out:
        out.write('# lengths in mm, forces in N, force constants in N/mm, masses in 103.64 g;\n'
                  '# frequencies are in Hz, not THz; the foundation survives only without symmetrisation (phonopy --no-sym-fc)\n')
        out.write(text)


def _with_all_digits(text, exact):
    """The text with all digits of the numbers below some of its keys; `exact` gives these numbers for each key, in order."""
    exact = {key: iter(np.ravel(numbers)) for key, numbers in exact.items()}
    lines, key = [], None
    for line in text.splitlines(keepends=True):
        found = KEY.match(line)
        key = found[1] if found else key
        if key in exact:
            line = DECIMALS.sub(lambda _, numbers=exact[key]: f'{next(numbers):.16e}', line)
        lines.append(line)
    return ''.join(lines)
