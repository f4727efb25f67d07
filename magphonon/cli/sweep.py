"""`magphonon sweep SCENE --over KEY=FROM:TO:COUNT --ask QUESTION`: maps of a quantity over keys of a scene.

A sweep that was killed continues where it stopped when the same command is given again. Until the
sweep is complete, its journal is in the directory of the results.
"""

from __future__ import annotations

import re
from argparse import ArgumentParser, Namespace
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from io import RawIOBase
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..errors import finite, shown, whole
from .arguments import add_output, add_pictures, add_scene, answering

if TYPE_CHECKING:
    from xarray import Dataset

HELP = 'maps of bands, stability and responses over any numbers of a scene'
RESULTS = 'sweep.*', 'sweep_*'
EXECUTORS = 'processes', 'here', 'dask', 'mpi'
JOURNAL = 'sweep.journal'
MOST_VALUES = 10**6  # largest number of values of an axis
SHOWN_REASONS = 6  # number of reasons for bad points that are shown, the most frequent ones; the file holds all
NUMBER = re.compile(r'(?<![\w.])-?\d+(?:\.\d+)?(?:e[+-]?\d+)?(?![\w.]*\w)')
"""A number in a reason, but not one in the name of a question."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument('--over', metavar='KEY=VALUES', action='append', required=True,
                        help='an axis: a key of the scene with FROM:TO:COUNT, FROM:TO:COUNT:log or A,B,C, as in '
                             'lattice.spacing_m=0.008:0.014:25; give it again for another axis. To vary an exponent at constant '
                             'force, give law.a=3:6:50 and law.force_N=0.24')
    parser.add_argument('--ask', metavar='QUESTION', action='append', required=True,
                        help='bands.POINT.BRANCH, bands.gap.BRANCH, stability.needed, .margin, .growth or .spacing, '
                             'linear.amplitude, timestep.limit, verdict.faults, frf.peak_Hz or frf.peak_m_per_N; give it again '
                             'for another')
    parser.add_argument('--executor', choices=EXECUTORS, default='processes',
                        help='processes on this machine (default), this process alone, Dask, or the ranks of mpiexec')
    parser.add_argument('--workers', metavar='N', type=int, help='processes on this machine (default: one for each core)')
    parser.add_argument('--scheduler', metavar='ADDRESS', help='address of a running Dask scheduler, such as '
                                                               '`tcp://10.0.0.1:8786`')
    add_output(parser)
    add_pictures(parser, frequencies=False)


def run(options: Namespace) -> None:
    if options.workers is not None:
        whole('--workers', options.workers)
    if options.scheduler is not None and options.executor != 'dask':
        raise ValueError('--scheduler is the address of a Dask scheduler; add --executor dask')
    try:
        with _where(options) as workers:
            if workers is not None:
                _lead(options, workers)
    except ImportError as error:
        raise ValueError(f"{error}; pip install 'magphonon[sweep,dask,mpi]' installs everything that sweeps need") from None
    except RuntimeError as error:  # of joblib, where a process died, or of Dask
        why = ' '.join(str(error).split()).rstrip('.')
        raise ValueError(f'the workers failed: {why}. Make sure that each has this version of magphonon and enough memory, use '
                         f'fewer --workers, and give the command again: it continues where it stopped') from None


@contextmanager
def _where(options: Namespace) -> Iterator[dict[str, Any] | None]:
    """Context with the arguments of `sweep` that say where points are computed; None in an MPI rank that was only a worker."""
    if options.executor == 'processes':
        yield {'workers': options.workers or -1}
    elif options.executor == 'here':
        yield {'workers': 1}
    elif options.executor == 'dask':
        from dask.distributed import Client
        from joblib import cpu_count, parallel_config

        own = {'n_workers': options.workers or cpu_count(), 'threads_per_worker': 1, 'dashboard_address': ':0'}
        try:
            client = Client(options.scheduler) if options.scheduler else Client(**own)
        except (OSError, ValueError) as error:
            raise OSError(f'no Dask scheduler answers at {options.scheduler} ({error}); '
                          'start one with "dask scheduler"') from None
        with client, parallel_config(backend='dask', client=client):
            yield {}
    else:
        from mpi4py import MPI
        from mpi4py.futures import MPICommExecutor

        if MPI.COMM_WORLD.size < 2:
            raise ValueError('MPI has one rank, and the first rank only distributes the work; start more, as in "mpiexec -n 3 '
                             'magphonon sweep ..."')
        with MPICommExecutor(MPI.COMM_WORLD, root=0) as executor:
            yield None if executor is None else {'executor': executor}


def axis_of(text: str) -> tuple[str, NDArray[np.float64]]:
    """Key and values of an axis, `KEY=FROM:TO:COUNT`, `KEY=FROM:TO:COUNT:log` or `KEY=A,B,C`."""
    key, equals, given = text.partition('=')
    if not (key and equals and given):
        raise ValueError(f'--over {text} must be KEY=FROM:TO:COUNT, KEY=FROM:TO:COUNT:log or KEY=A,B,C, as in '
                         'lattice.spacing_m=0.008:0.012:50')
    try:
        if ':' not in given:
            return key, finite(f'--over {key}', [float(value) for value in given.split(',')])
        first, last, count, *logarithmic = given.split(':')
        first, last = finite(f'--over {key}', [float(first), float(last)])
        number = whole(f'the count of --over {key}', float(count))
    except (ValueError, OverflowError) as error:
        raise ValueError(f'--over {text} is not a range of numbers ({error}); write it as law.a=3:6:50 or law.a=3,4,6') from None
    if number > MOST_VALUES:
        raise ValueError(f'--over {text} has {number} values, but an axis may have at most {MOST_VALUES}')
    if logarithmic not in ([], ['log']):
        raise ValueError(f"--over {text}: after the count only 'log' may follow, not {shown(':'.join(logarithmic))}")
    if not logarithmic:
        return key, np.linspace(first, last, number)
    if min(first, last) <= 0:
        raise ValueError(f'--over {text}: a logarithmic axis needs two positive ends')
    return key, np.geomspace(first, last, number)


@contextmanager
def _new(path: Path) -> Iterator[RawIOBase | None]:
    """Context with a new file, open for writing; None if a file of this name exists already."""
    try:
        file = path.open('xb', buffering=0)
    except FileExistsError:
        yield None
        return
    with file:
        try:
            yield file
        finally:
            if not file.tell():
                path.unlink(missing_ok=True)


def _lead(options, workers):
    from ..plotting.sweeps import plot_sweep
    from ..scenes.scene import read_scene
    from ..sweeps.dataset import sweep
    from .neighbours import omission

    scene, axes = read_scene(options.scene), [axis_of(text) for text in options.over]
    if len(dict(axes)) < len(axes):
        raise ValueError('--over names a key twice; give each axis once')
    journal = Path(options.output) / JOURNAL
    with answering(options, scene) as (folder, save, told), _new(journal) as own:
        answers = sweep(scene, dict(axes), options.ask, journal=own or journal, **workers)
        answered = [name for name in options.ask if np.isfinite(answers[name]).any()]
        if not answered:
            raise ValueError('\n'.join(['no point has an answer, so nothing is written:', *_reasons(answers)]))
        answers.to_netcdf(folder / 'sweep.nc', engine='h5netcdf')
        for name in answered:
            save(plot_sweep(answers, name).figure, f'sweep_{name}')
        told += _report(scene.title, answers, options.ask, options.verbose)
        told += [f'At the values of the scene itself: {line}' for line in omission(scene, options.verbose)]
    if own:  # this process made the journal; a later process that continued it may have finished it
        journal.unlink(missing_ok=True)
    else:
        options.notes.append(f'{journal} of an earlier command is still there; the sweep is complete, so you may remove it')


def _report(title: str, answers: Dataset, asked: list[str], verbose: bool) -> list[str]:
    axes, first = list(answers.sizes), []
    lines = [title, f'{answers.fault.size} points: ' + ' x '.join(f'{count} of {key}' for key, count in answers.sizes.items())]
    for name in asked:
        values, unit = answers[name].to_numpy(), answers[name].attrs['units']
        if np.isfinite(values).any():
            first.append(f'{name} is {np.nanmin(values):.6g} to {np.nanmax(values):.6g} {unit} at {np.isfinite(values).sum()} of '
                         f'{values.size} points'.replace(' 1 at', ' at'))
        lines.append(f'\n{name} ({unit}): {np.isfinite(values).sum()} points have an answer')
        for word, place in (('lowest', np.nanargmin), ('highest', np.nanargmax)) if np.isfinite(values).any() else ():
            at = np.unravel_index(place(values), values.shape)
            where = ', '.join(f'{key} = {float(answers[key][k]):.6g}' for key, k in zip(axes, at, strict=True))
            lines.append(f'  {word:7} {values[at]:.6g} at {where}')
    return [*first, *(lines if verbose else []), *_reasons(answers)]


def _reasons(answers: Dataset) -> list[str]:
    """Lines that say why points lack an answer; reasons that differ only in numbers are merged, with the range of each number."""
    alike: defaultdict[str, list[list[str]]] = defaultdict(list)
    for fault in filter(None, answers.fault.to_numpy().ravel().tolist()):
        alike[NUMBER.sub('{}', fault.replace('{', '{{').replace('}', '}}'))].append(NUMBER.findall(fault))
    if not alike:
        return []
    lines = [f'\n{sum(map(len, alike.values()))} points have no answer and are hatched in the pictures:']
    for words, numbers in sorted(alike.items(), key=lambda item: -len(item[1]))[:SHOWN_REASONS]:
        ends = [(min(column, key=float), max(column, key=float)) for column in zip(*numbers, strict=True)]
        ranges = [low if low == high else f'{low} to {high}' for low, high in ends]
        lines.append(f'  {len(numbers)} times: {words.format(*ranges)}')
    if len(alike) > SHOWN_REASONS:
        lines.append(f'  and {len(alike) - SHOWN_REASONS} other reasons, in sweep.nc under "fault"')
    return lines
