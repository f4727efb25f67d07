"""`magphonon explore SCENE -o FILE.html`: a page with sliders that move the bands of both models.

The page needs no server and no network: any browser opens the file.  Sliders change the spacing, the exponent of an inverse power
and the foundation; marks on them show where the lattice buckles.  A click on a branch moves the lattice in this mode.  A
structure from a table has no bands: its page shows how a tone travels through it.
"""

from __future__ import annotations

import os
import tomllib
from argparse import ArgumentParser, Namespace
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING

from .. import units as u
from ..files import whole_file
from .arguments import add_scene, default_folder, left_out

if TYPE_CHECKING:
    from ..scenes.scene import Scene

HELP = 'a page for the browser: sliders move the bands, a burst runs through the lattice'
CYCLES = 120  # of the tone in a structure, most of which is nearly steady
SUM = b'<!-- magphonon explore, sha256 '
"""Beginning of the last line of every such page, which holds the checksum of the rest; a file without it is not replaced."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument('-o', '--output', dest='page', metavar='FILE.html', help='the page (default: SCENE-explore.html)')


def run(options: Namespace) -> None:
    from ..plotting.explorer import POINTS, Explorer, structure_page
    from ..scenes.scene import read_scene
    from ..stability.buckling import stability_boundary, stability_boundary_of_exponents
    from .neighbours import omission

    file = Path(f'{default_folder(options)}.html' if options.page is None else options.page)
    _refuse_foreign(file)
    scene = read_scene(options.scene).counted()
    if scene.finite and not scene.single and scene.frf is not None and scene.frf.force is not None:
        return _write(options, file, structure_page(*_pushed(scene), options.scene.text), [])
    _refuse_unknown(scene)
    atoms = scene.perfect_cell()
    points = scene.bands.path if scene.bands is not None else None
    explorer = Explorer(atoms, scene.lattice.path(points, POINTS))  # pyright: ignore[reportAttributeAccessIssue]  no oscillator
    if explorer.exponents is not None:
        border = stability_boundary_of_exponents(atoms, explorer.exponents.values)
    else:
        border = stability_boundary(atoms, explorer.scales)
    perfect = 'This lattice is perfect: [defects] and [disorder] belong to a patch.' if scene.defects or scene.disorder else ''
    template = _template(options.scene.text, scene, atoms)
    _write(options, file, explorer.page(scene.title, options.scene.text, template, border, perfect),
           [*filter(None, [perfect]), *left_out(scene), *omission(scene, options.verbose)])


def _write(options, file, page, words):
    file.parent.mkdir(parents=True, exist_ok=True)
    with whole_file(file, 'wb') as out:
        out.write(page.encode() + _signature(page.encode()))
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
        tables['law'] = {'kind': 'inverse_power', 'force_N': '{force_N}', 'a': '{exponent}'}
    tables['law']['shells'] = scene.law.shells
    tables['foundation'] = {'stiffness_N_per_m': '{foundation_N_per_m}'}
    return toml(tables)


def _signature(page):
    return SUM + sha256(page).hexdigest().encode() + b' -->\n'


def _refuse_foreign(file):
    if file.suffix.lower() not in ('.html', '.htm'):
        raise ValueError(f'-o {str(file)!r} must be the name of a page, ending in .html')
    if file.is_dir():
        raise IsADirectoryError(f'{file} is a directory; name a file in it, such as {file / "explorer.html"}')
    if os.path.lexists(file):
        if file.is_symlink() or not file.is_file():
            raise ValueError(f'{file} is not a regular file but, for example, a pipe or a link; choose another name')
        page, mark, rest = file.read_bytes().rpartition(SUM)
        if mark + rest != _signature(page):
            raise ValueError(f'{file} is not a page of "magphonon explore", or was edited, and is not replaced; choose another '
                             'name, or move it away')


def _refuse_unknown(scene: Scene) -> None:
    """Refuse scenes that the page cannot compute: only planar lattices with a few shells of neighbours are possible."""
    if scene.single:
        raise ValueError('the oscillator is one particle and has no bands; use "magphonon frf"')
    if scene.finite:
        raise ValueError('a finite structure has no bands to explore; "magphonon modes" shows its modes')
    if scene.lattice.kind == 'file':
        raise ValueError('lattice.kind = "file": positions from a file may lose their balance when the spacing or the exponent '
                         'changes; the explorer needs a lattice given by its name, such as kind = "triangular"')
    if scene.foundation is not None and scene.foundation.out_of_plane is not None:
        raise ValueError('[foundation.out_of_plane]: the explorer shows motion in the plane; omit this table, or use '
                         '"magphonon bands"')
    if scene.foundation is not None and scene.foundation.leans:
        raise ValueError('foundation.pillar.lean: leaning softens the foundation by an amount that depends on the spacing, '
                         'which the explorer does not compute; omit lean, or use "magphonon bands"')
    if scene.cell().pbc.all():
        raise ValueError(f'lattice.kind = "{scene.lattice.kind}" is a lattice in space, but the explorer draws planar ones; use '
                         '"magphonon bands"')
