"""`magphonon spectrum SCAN ... SCENE`: maps and ridges of scans of a row or of the plane, drawn over the bands of a scene.

A scan is a table of text or a universal file; points that cover the plane are recognised. Points may be numbered in any way; some
may be missing or dead.  The names of the columns give units and components. The scene needs only the lattice, its law and its
foundation.  Each scan is analysed on its own; `magphonon fit --bands` takes the ridges of all of them.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import units
from .arguments import add_output, add_scene, add_style, answering

HELP = 'dispersion points from a scan of the vibrometer, drawn over the bands of a scene'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('tables', metavar='SCAN', nargs='+',
                        help='table (.csv) with the columns time_s, point, x_m, y_m and one or both of u_x_m, u_y_m, or '
                             'velocities such as v_y_m_per_s; also in mm or um, as u_y_um; or a universal file (.uff, '
                             '.unv) with records of dataset 58; several scans are analysed one after the other')
    add_scene(parser)
    parser.add_argument('--geometry', metavar='POINTS.csv',
                        help='table of the positions of the points, with the columns point, x_m, y_m, if the scan has none; '
                             'without it points are particles, numbered as in the row.csv of "magphonon burst"')
    parser.add_argument('--source', choices=('row', 'point'),
                        help='the source of the waves: a row, with fronts along R1, or a point. For a scanned row the default '
                             'is the source that [burst] names, or a point if the scene has no [burst]; for a scan of the plane '
                             'it is noise if the motion does not decay, and a point if it does')
    parser.add_argument('--at', metavar='HZ', type=float,
                        help='for points that cover the plane: draw the motion at this frequency too, over the wavevectors '
                             '(with contours of the bands) and at the points')
    add_output(parser)
    add_style(parser)


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene
    from ..waves.scan_tables import read_places

    scene, stems = read_scene(options.scene), [Path(table).stem for table in options.tables]
    if twice := [stem for stem in stems if stems.count(stem) > 1]:
        raise ValueError(f'two of the scans are called {twice[0]}, so their results would have the same name; rename one of them')
    places, ridges = read_places(options.geometry) if options.geometry else None, []
    with answering(options, scene, *(f'spectrum_{stem}_*' for stem in stems)) as (folder, save, told):
        for table, stem in zip(options.tables, stems, strict=True):
            shown = _analysed(table, options, scene, places, folder, save)
            text = '\n'.join(_report(scene, shown, verbose=True)) + '\n'
            (folder / f'spectrum_{stem}_ridges.txt').write_text(text, encoding='utf-8')
            told += _report(scene, shown, options.verbose)
            if shown.q is not None:
                ridges.append(str(Path(options.output) / f'spectrum_{stem}_ridges.csv'))
    if ridges:
        print(f'"magphonon fit {" ".join(ridges)} --bands {options.scene}" fits the lattice to the ridges')


class Shown(NamedTuple):
    """What a scan shows: lines that answer, notes on how it was read, a text on its ridges, and their wavevectors."""

    answer: list[str]
    notes: list[str]
    text: str
    q: NDArray[np.float64] | None  # shape (points, 3)


def _report(scene, shown, verbose):
    """Lines on a scan, and how the omitted neighbours would change the frequencies at its ridges."""
    from .neighbours import omission

    told = ['', scene.title, *shown.notes, '', shown.text] if verbose else []
    return [*shown.answer, *told, *omission(scene, verbose, None if shown.q is None else {'the ridges': shown.q})]


def _analysed(table, options, scene, places, folder, save):
    """What one scan shows; its points are at `places` by their names, if these are given."""
    from ..waves.fields import is_field
    from ..waves.scan_tables import read_scan

    cell, scan = scene.perfect_cell(), read_scan(table)
    scan = scan.placed(places) if places else scan
    analyse = _field if scan.places is not None and is_field(np.asarray(scan.places), cell) else _row
    try:
        return analyse(Path(table).name, options, scene, cell, scan, folder, save)
    except ValueError as error:
        raise ValueError(f'{table}: {error}') from None


def _row(file, options, scene, cell, scan, folder, save):
    """Analyse a row of points, and write its files and pictures."""
    from ..plotting.waves import plot_wave
    from ..waves.ridge_tables import write_ridges
    from ..waves.rows import row_of
    from ..waves.wave_analysis import scan_waves
    from ..waves.wave_report import agreements, report

    if options.at is not None:
        raise ValueError('--at needs points that cover the plane, but these lie on one or a few rows')
    row, name = None, Path(file).stem
    source = options.source or (scene.burst.source if scene.burst else 'point')
    if scan.places is None:
        scan = scan.placed(_particles(scene))
        row = row_of(np.asarray(scan.places), cell)  # upwards, away from the source
    found = scan_waves(scan, cell, source, row)
    for wave in found:
        wave.spectrum.save(folder / f'spectrum_{name}_{wave.motion}.npz')
        save(plot_wave(wave).figure, f'spectrum_{name}_{wave.motion}')
    write_ridges(folder / f'spectrum_{name}_ridges.csv', {name: found})
    places = round(2 * np.pi / found[0].spectrum.bin_xi)
    notes = [f'{file}: {len(scan.names)} points on {places} places of the row, {len(scan.times)} frames',
             *scan.notes]
    q = [wave.wavevector * wave.ridge.xi[:, None] / (2 * np.pi) for wave in found if wave.ridge is not None]
    answer = agreements({name: found}) or [f'{name}: no ridge']
    return Shown(answer, notes, report({name: found}), np.concatenate(q) if q else None)


def _field(file, options, scene, cell, scan, folder, save):
    """Analyse points that cover the plane, and write their files and pictures."""
    from ..bands.bands import band_path
    from ..plotting.fields import plot_field, plot_field_at
    from ..waves.fields import field_at, field_map, field_of, field_ridges
    from ..waves.ridge_tables import write_points
    from ..waves.wave_report import field_report

    name, path = Path(file).stem, scene.band_path() if scene.bands else band_path(cell)
    field = field_of(scan, cell)
    found = field_map(field, cell, path)
    found.save(folder / f'spectrum_{name}_field.npz')
    try:
        points = field_ridges(field, cell, path, name, options.source)
        text = field_report(points, cell)
        answer = f'{len(points)} points on {len(points.names)} ridges: {", ".join(points.names)}'
        write_points(folder / f'spectrum_{name}_ridges.csv', points)
    except ValueError as error:
        points, text, answer = None, f'no ridges: {error}', f'no ridges: {error}'
    save(plot_field(found, path, cell, points), f'spectrum_{name}_field')
    if options.at is not None:
        omega = 2 * np.pi * options.at * units.Hz
        save(plot_field_at(field, cell, omega, field_at(field, cell, omega)), f'spectrum_{name}_at_{options.at:g}_Hz')
    notes = [f'{file}: {len(scan.times)} frames', *scan.notes, *field.notes]
    return Shown([f'{name}: {answer}'], notes, text, points.q if points else None)


def _particles(scene):
    """Positions of the particles in the row of a scene with [patch] and [burst], by their numbers."""
    from ..waves.wave_source import burst_setup

    if scene.patch is None or scene.burst is None:
        raise ValueError('the scan does not say where its points are; add the columns x_m and y_m, or name a table of them with '
                         '--geometry POINTS.csv')
    patch = scene.patch_atoms()
    return {str(k): tuple(patch.positions[k, :2]) for k in burst_setup(scene.perfect_cell(), patch, scene.burst.source).row}
