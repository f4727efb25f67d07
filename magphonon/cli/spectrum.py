"""`magphonon spectrum SCAN SCENE`: a measured scan of a row of points, its map and ridges over the bands of a scene.

The scan is a table of text or a universal file.  Its points may have any numbers, and some may be missing or dead; the
names of the columns give units and components.  Of the scene only the lattice, its law and its foundation are needed.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from .arguments import add_output, add_pictures, add_scene, drawing

HELP = 'map and ridges of a measured scan of a row, over the bands of a scene'
RESULTS = 'spectrum_*_ridges.*', 'spectrum_*.npz', 'spectrum_*.png', 'spectrum_*.pdf'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('table', metavar='SCAN', help='table (.csv) with the columns time_s, point, x_m, y_m and u_x_m, u_y_m or '
                                                      'one of them, or velocities v_y_m_per_s; mm and um by the name (u_y_um); '
                                                      'or a universal file (.uff, .unv) with records of dataset 58')
    add_scene(parser)
    parser.add_argument('--geometry', metavar='POINTS.csv',
                        help='places of the points, columns point, x_m, y_m, if the scan has none; without them its points are '
                             'particles, numbered as in the row.csv that "magphonon burst" writes')
    parser.add_argument('--source', choices=('row', 'point'),
                        help='how the waves were driven: fronts along R1, or waves along the measured row (default: as [burst] '
                             'says, else point)')
    add_output(parser)
    add_pictures(parser)


def run(options: Namespace) -> None:
    from pathlib import Path

    from ..plotting.waves import plot_wave
    from ..scenes.scene import read_scene
    from ..waves.ridge_tables import write_ridges
    from ..waves.wave_analysis import report
    from .neighbours import neighbours
    from .results import results

    scene = read_scene(options.scene)
    with results(options, scene, options.table) as folder, drawing(options, folder, scene.title) as save:
        notes, found = _analysed(options, scene)
        name = Path(options.table).stem
        own = f'spectrum_{name}'  # distinct from results of `burst` and of other scans
        for wave in found:
            wave.spectrum.save(folder / f'{own}_{wave.motion}.npz')
            save(plot_wave(wave).figure, f'{own}_{wave.motion}')
        write_ridges(folder / f'{own}_ridges.csv', {name: found})
        text = '\n'.join([scene.title, *notes, '', report({name: found}), '', *neighbours(scene, _asked(found))])
        (folder / f'{own}_ridges.txt').write_text(text + '\n', encoding='utf-8')
    print(text)
    print(f'\npictures and data are in {options.output}')
    if any(wave.ridge is not None for wave in found):
        print(f'"magphonon fit {Path(options.output) / own}_ridges.csv --bands {options.scene}" fits the lattice to the ridges')


def _analysed(options, scene):
    from pathlib import Path

    import numpy as np

    from ..waves.rows import row_of
    from ..waves.scan_tables import read_places, read_scan
    from ..waves.wave_analysis import scan_waves

    cell, row = scene.perfect_cell(), None
    source = options.source or (scene.burst.source if scene.burst else 'point')
    scan = read_scan(options.table)  # its messages name the table
    if options.geometry is not None:
        scan = scan.placed(read_places(options.geometry))
    try:
        if scan.places is None:
            scan = scan.placed(_particles(scene))
            row = row_of(np.asarray(scan.places), cell)  # upwards, away from the source
        found = scan_waves(scan, cell, source, row)
    except ValueError as error:
        raise ValueError(f'{options.table}: {error}') from None
    places = round(2 * np.pi / found[0].spectrum.bin_xi)
    return [f'{Path(options.table).name}: {len(scan.names)} points on {places} places of the row, {len(scan.times)} frames',
            *scan.notes], found


def _asked(found):
    """The wavevectors of the ridges, if there are any."""
    import numpy as np

    q = [wave.wavevector * wave.ridge.xi[:, None] / (2 * np.pi) for wave in found if wave.ridge is not None]
    return {'the ridges': np.concatenate(q)} if q else None


def _particles(scene):
    """Places of the particles of the row of a scene with [patch] and [burst], by their numbers."""
    from ..waves.wave_source import site

    if scene.patch is None or scene.burst is None:
        raise ValueError('it does not say where its points are; add the columns x_m and y_m, or name a table of them with '
                         '--geometry POINTS.csv')
    patch = scene.patch_atoms()
    return {str(k): tuple(patch.positions[k, :2]) for k in site(scene.perfect_cell(), patch, scene.burst.source).row}
