"""`magphonon read FILE`: show how all commands read a file of measurements, with a picture and a clean table.

Forces between two magnets, ridges, transfer functions, and scans are recognised by what they hold.  The report says how each
column was understood and which range it covers, so that a wrong unit is easily seen. The clean table is in SI; every command
reads it like the original.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from functools import partial
from importlib import import_module
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np

from .. import units as u
from ..errors import not_negative
from ..files import MEGABYTE, write_columns
from ..readers import content
from ..tables import read_table
from .arguments import add_output, add_pictures, drawing, length, ready_table

HELP = 'how a file of measurements is understood, with a picture and a clean table'
RESULTS = 'clean*.csv', 'clean.p*'
KINDS = {'forces': ('interactions.force_tables', 'read_forces'), 'ridges': ('waves.ridge_tables', 'read_ridges'),
         'transfer functions': ('response.transfer_functions', 'read_transfer'), 'a scan': ('waves.scan_tables', 'read_scan')}
"""The kinds of records that a file may hold, and the function that reads each."""
MOST_BYTES = 1000 * MEGABYTE  # of a scan, the largest of all
MOST_WORDS = 6  # different words of a column that are listed


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('file', metavar='FILE', help='text, .npz, .mat, .h5, .tdms, .xlsx or universal file of an instrument')
    parser.add_argument('--contact', metavar='R', type=length, default=0.0,
                        help='for a table of forces over gaps: size of a magnet along the line between the two, such as 6.35mm')
    add_output(parser, default=None)
    add_pictures(parser, frequencies=False)


def run(options: Namespace) -> None:
    from ..plotting import plot_forces, plot_ridges, plot_scan, plot_transfer
    from .results import results

    file = options.file = ready_table(options.file)
    kind, record = held(file, not_negative('--contact', options.contact, 'mm'))
    tables = [*columns_of(kind, record)]
    options.output = options.output or f'{Path(file).stem}-read'
    with results(options, None, file) as folder, drawing(options, folder, Path(file).name) as save:
        for k, table in enumerate(tables):
            write_columns(folder / f'clean{f"_{k + 1}" if len(tables) > 1 else ""}.csv', [*table], [*table.values()])
        draw: Any = {'forces': plot_forces, 'ridges': plot_ridges, 'a scan': plot_scan,
                     'transfer functions': partial(plot_transfer, curves={})}[kind]
        save(getattr(drawn := draw(record), 'figure', drawn), 'clean')
    print('\n'.join([f'{file} holds {kind}.', *_understood(file, kind, {*chain(*tables)}),
                     *(f'  {note}' for note in getattr(record, 'notes', ()))]))
    for table in tables:
        print('\n'.join(['', *(_range(name, np.asarray(column)) for name, column in table.items())]))
    print(f'\npicture and clean table are in {options.output}')


def held(file: str, contact: float = 0.0) -> tuple[str, Any]:
    """The kind of records in a file, and these records; `contact` in mm is needed if a table of forces gives gaps."""
    if Path(file).suffix == '.toml':
        raise ValueError(f'{file} is a scene and holds no measurements')
    faults = []
    for kind, (module, reader) in KINDS.items():
        try:
            given = {'contact': contact} if kind == 'forces' else {}
            return kind, getattr(import_module(f'magphonon.{module}'), reader)(file, **given)
        except ValueError as error:
            faults.append(f'as {kind}: {error}')
    content(file, MOST_BYTES)  # a file that cannot be read at all gives a single message
    raise ValueError(f'{file} is no kind of record that can be read:\n  ' + '\n  '.join(faults))


def _understood(file, kind, clean):
    """Lines with the quantity of each column whose name the clean table changes, and notes on how the file was read."""
    module = import_module(f'magphonon.{KINDS[kind][0]}')
    found = content(file, MOST_BYTES)
    if isinstance(found, list):
        return [f'  {len(found)} data sets of a universal file']
    table = read_table(file, **module.ASKED, held=found)
    told = [f'  {name}: {quantity}{f" in {table.told[quantity].unit}" * bool(table.told[quantity].unit)}'
            for quantity, name in ((quantity, head.name) for quantity, head in table.told.items())
            if quantity in table and name not in clean]
    return told


def _range(name, column):
    if column.dtype.kind in 'US':
        words = [*dict.fromkeys(column.tolist())]
        listed = ', '.join(words[:MOST_WORDS]) or 'empty'
        return f'  {name}: {listed}' + f' and {len(words) - MOST_WORDS} more' * (len(words) > MOST_WORDS)
    return f'  {name}: {len(column)} values from {column.min():.6g} to {column.max():.6g}'


def columns_of(kind: str, record: Any) -> Iterator[dict[str, Any]]:
    """Yield the clean tables of a record, each a dict of columns in SI by their names."""
    yield from {'forces': _of_forces, 'ridges': _of_ridges, 'transfer functions': _of_transfer, 'a scan': _of_scan}[kind](record)


def _of_forces(forces):
    own, ways = {'r_m': forces.r / u.m, 'f_N': forces.f / u.N}, {-1.0: 'approach', 0.0: '', 1.0: 'return'}
    if forces.sigma is not None:
        own['sigma_N'] = forces.sigma / u.N
    if forces.direction.any():
        own['direction'] = [ways[way] for way in forces.direction.tolist()]
    if forces.pairs > 1:
        own['pair'] = forces.pair
    yield own


def _of_ridges(points):
    from ..waves.ridge_tables import columns_of

    yield columns_of(points)


def _of_transfer(functions):
    """Tables of transfer functions: those with known points share one table, the others have one each."""
    groups: dict[Any, list] = {}
    for k, one in enumerate(functions):
        placed = one.answer is not None
        key = one.shaken, one.sigma is None, one.drive is None, placed or k
        groups.setdefault(key, []).append(one)
    for group in groups.values():
        per, unit = ('', 1.0) if group[0].shaken else ('_m_per_N', u.m / u.N)
        h = np.concatenate([one.response for one in group]) / unit
        own = {'frequency_Hz': np.concatenate([u.hertz(one.omega) for one in group]), f're{per}': h.real, f'im{per}': h.imag}
        if group[0].sigma is not None:
            own[f'sigma{per}'] = np.concatenate([np.broadcast_to(one.sigma, one.omega.shape) for one in group]) / unit
        for end, names in (('answer', ('x_m', 'y_m', 'direction_deg')), ('drive', ('drive_x_m', 'drive_y_m', 'drive_deg'))):
            if getattr(group[0], end) is not None:
                places = np.concatenate([np.tile(getattr(one, end), (len(one.omega), 1)) for one in group])
                columns = zip(names, (places / [u.m, u.m, u.deg]).T, strict=True)
                own |= {name: column for name, column in columns if not (end == 'drive' and group[0].shaken) or 'deg' in name}
        yield own


def _of_scan(scan):
    frames, points = len(scan.times), len(scan.names)
    places = [] if scan.places is None else [('x_m', scan.places[:, 0]), ('y_m', scan.places[:, 1])]
    yield {'time_s': np.repeat(scan.times / u.s, points), 'point': np.tile(scan.names, frames),
           **{name: np.tile(column / u.m, frames) for name, column in places},
           **{f'u_{part}_m' if part else 'u_m': moved.ravel() / u.m for part, moved in scan.motions.items()}}
