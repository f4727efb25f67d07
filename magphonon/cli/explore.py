"""`magphonon explore SCENE -o FILE.html`: a page with sliders that move the bands of both models.

The page needs no server and no network: any browser opens the file.  Sliders change the spacing, the exponent of an inverse power
and the foundation; marks on them show where the lattice buckles.  A click on a branch moves the lattice in this mode.  A
structure from a table has no bands: its page shows how a tone travels through it.
"""

from __future__ import annotations

import tomllib
from argparse import ArgumentParser, Namespace
from itertools import pairwise
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import bisect

from .. import units as u
from ..files import whole_file
from .arguments import add_force, add_scene, default_folder, left_out
from .results import refuse_existing

if TYPE_CHECKING:
    from ..plotting.explorer import Explorer
    from ..scenes.scene import Scene

HELP = 'a page for the browser: sliders move the bands, a burst runs through the lattice'
EXACT = 1e-9  # width of the interval within which an exponent is found
CYCLES = 120  # of the tone in a structure, most of which is nearly steady


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument('-o', '--output', dest='page', metavar='FILE.html', help='the page (default: SCENE-explore.html)')
    add_force(parser)


def run(options: Namespace) -> None:
    from ..plotting.explorer import POINTS, Explorer, structure_page
    from ..scenes.scene import read_scene
    from .neighbours import omission

    file = Path(f'{default_folder(options)}.html' if options.page is None else options.page)
    if file.suffix.lower() not in ('.html', '.htm'):
        raise ValueError(f'-o {str(file)!r} must be the name of a page, ending in .html')
    if file.is_dir():
        raise IsADirectoryError(f'{file} is a directory; name a file in it, such as {file / "explorer.html"}')
    refuse_existing(options, [file])
    scene = read_scene(options.scene).counted()
    if scene.finite and not scene.single and scene.frf is not None and scene.frf.force is not None:
        return _write(options, file, structure_page(*_pushed(scene), options.scene.text), [])
    _refuse_unknown(scene)
    atoms = scene.perfect_cell()
    points = scene.bands.path if scene.bands is not None else None
    explorer = Explorer(atoms, scene.lattice.path(points, POINTS))  # pyright: ignore[reportAttributeAccessIssue]  no oscillator
    perfect = 'This lattice is perfect: [defects] belong to a patch.' if scene.defects else ''
    template = _template(options.scene.text, scene, atoms)
    _write(options, file, explorer.page(scene.title, options.scene.text, template, border(explorer), perfect),
           [*filter(None, [perfect]), *left_out(scene), *omission(scene, False)])


def border(explorer: Explorer) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Exponents, or multiples of the spacing where the slider of the exponent is missing, and the foundation needed, in N/mm.

    The exponents above which the lattice needs no foundation are added, because the foundation needed has a kink there.
    """
    from ..interactions.pair_laws import InversePower
    from ..stability.buckling import STEPS, critical_foundation, softest_of
    from ..stiffness.rest import LinearSystem

    atoms = explorer.atoms
    if explorer.exponents is None:
        system = LinearSystem.of(atoms)
        return explorer.scales, np.array([softest_of(system, scale=scale, steps=STEPS).needed for scale in explorer.scales])
    calc: Any = atoms.calc
    shortest, force = explorer.spacing, -calc.law.dphi(explorer.spacing)

    def needed(a):
        cell = atoms.copy()
        cell.calc = calc.changed(laws=InversePower(force * shortest**a, a))
        return critical_foundation(cell, steps=STEPS).k

    found = {a: needed(a) for a in explorer.exponents.values.tolist()}
    for low, high in pairwise([*found]):
        if (found[low] > 0) != (found[high] > 0):
            found[bisect(lambda a: 1 if needed(a) > 0 else -1, low, high, xtol=EXACT)] = 0.0
    at = np.array(sorted(found))
    return at, np.array([found[a] for a in at.tolist()])


def _write(options, file, page, words):
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file, 'wb') as out:
        out.write(page.encode())
    options.written = file
    print('\n'.join([f'{file} is written; open it in a browser', *words]))


def _pushed(scene):
    """The structure, the force on it in SI, and the title."""
    atoms, frf = scene.patch_atoms(), scene.frf
    force = frf.force.of(atoms)
    drive = {'source': str(force.particle), 'direction': force.direction[:2].tolist(), 'cycles': CYCLES,
             'damping_per_s': frf.damping_per_s, 'carrier_Hz': (frf.from_Hz + frf.to_Hz) / 2, 'highest_Hz': frf.to_Hz}
    return atoms, drive, scene.title


def _template(text, scene, atoms):
    """The scene without its comments, with a name in place of each value that a slider changes."""
    from ..scenes.scene import toml

    tables, masses = tomllib.loads(text), atoms.get_masses() / u.kg
    tables['lattice'] |= {'spacing_m': '{spacing_m}', 'mass_kg': masses[0]}  # with the part of the pillars that moves along
    if len(masses) > 1:
        tables['lattice']['relative_masses'] = (masses / masses[0]).tolist()
    if scene.law.kind == 'inverse_power':
        tables['law'] = {'kind': 'inverse_power', 'b_N_m_a': '{b_N_m_a}', 'a': '{exponent}'}
    tables['law']['shells'] = scene.law.shells
    tables['foundation'] = {'stiffness_N_per_m': '{foundation_N_per_m}'}
    return toml(tables)


def _refuse_unknown(scene: Scene) -> None:
    """Refuse scenes that the page cannot compute: only planar lattices with a few shells of neighbours are possible."""
    if scene.single:
        raise ValueError('the oscillator is one particle and has no bands; use "magphonon frf"')
    if scene.finite:
        raise ValueError('a finite structure has no bands to explore; "magphonon modes" shows its modes')
    if scene.lattice.kind == 'file':
        raise ValueError('lattice.kind = "file": positions from a file may lose their balance when the spacing or the exponent '
                         'changes; the explorer needs a lattice given by its name, such as kind = "triangular"')
    if scene.turns:
        raise ValueError('lattice.gyration_rad_per_s: the explorer shows lattices that do not turn; use "magphonon bands"')
    if scene.foundation is not None and scene.foundation.out_of_plane is not None:
        raise ValueError('[foundation.out_of_plane]: the explorer shows motion in the plane; omit this table, or use '
                         '"magphonon bands"')
    if scene.cell().pbc.all():
        raise ValueError(f'lattice.kind = "{scene.lattice.kind}" is a lattice in space, but the explorer draws planar ones; use '
                         '"magphonon bands"')
