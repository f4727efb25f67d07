"""Files of bands and force constants for phonopy and related programs.

Files are in mm and N. Masses are scaled (1 g is written as `GRAM` of `stiffness.other_tools`), so that the numbers that phonopy
prints as THz are in Hz. Where phonopy multiplies a frequency by Planck's constant, it assumes THz: heat capacities, free energies
and mean square displacements are then, without a warning, those of frequencies 10^12 times too high.
"""

from __future__ import annotations

import re
from itertools import pairwise
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from ase.dft.kpoints import BandPath, parse_path_string

from ..files import refuse_overflow, whole_file
from ..stiffness.other_tools import GRAM
from .force_constants import TO_HZ, force_constants_of, path_on

if TYPE_CHECKING:
    from phonopy import Phonopy

KEY = re.compile(r'[ -]*(\w+):')
DECIMALS = re.compile(r'-?\d+\.\d{6,}')  # a number as phonopy writes it, with decimals enough for Angstrom, u and eV


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
