"""`magphonon spectrum FILE.csv SCENE`: a measured table of displacements, analysed like a simulated one."""

from __future__ import annotations

from typing import TYPE_CHECKING

from .arguments import add_output, add_scene
from .pictures import add_pictures, drawing

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

HELP = 'map and ridges of a measured table of displacements, over the bands of a scene'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('table', metavar='FILE.csv', help='displacements, columns time_s, particle, u_x_m, u_y_m; particles are '
                                                          'numbered as in the row.csv that "magphonon burst" writes')
    add_scene(parser, ' with [patch] and [burst], which tell the row and its bands')
    add_output(parser)
    add_pictures(parser)


def run(options: Namespace) -> None:
    from pathlib import Path

    from ..planning.scene import neglected
    from ..plotting.waves import plot_wave
    from ..scenes.scene import read_scene
    from ..waves.vibrometer import read_displacements
    from ..waves.wave_analysis import report, waves, write_ridges
    from ..waves.wave_source import site
    from .results import results

    scene = read_scene(options.scene)
    cell, source = scene.atoms(), scene.wanted('burst').source
    row = site(cell, scene.patch_atoms(), source).row
    with results(options, scene, options.table) as folder, drawing(options, folder, scene.title) as save:
        record = read_displacements(options.table, row)  # its messages name the table
        try:
            found = waves(record, cell, source)
        except ValueError as error:
            raise ValueError(f'{options.table}: {error}') from None
        name = Path(options.table).stem
        own = f'spectrum_{name}'  # beside the results of `burst`, and of other tables
        for wave in found:
            wave.spectrum.save(folder / f'{own}_{wave.motion}.npz')
            save(plot_wave(wave).figure, f'{own}_{wave.motion}')
        write_ridges(folder / f'{own}_ridges.csv', {name: found})
        text = '\n'.join([scene.title, '', report({name: found}), '', *neglected(scene)])
        (folder / f'{own}_ridges.txt').write_text(text + '\n', encoding='utf-8')
    print(text)
    print(f'\npictures and data are in {options.output}')
