"""`magphonon sweep SCENE --over KEY=FROM:TO:COUNT --ask QUESTION`: maps of a quantity over keys of a scene.

A sweep that was killed continues where it stopped when the same command is given again: DIR holds its journal until it is done.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from .arguments import add_output, add_scene
from .pictures import add_pictures, drawing

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from xarray import Dataset

HELP = 'maps of bands, stability or responses over keys of a scene, on all cores, Dask or MPI'
RESULTS = 'sweep.*', 'sweep_*'
EXECUTORS = 'processes', 'here', 'dask', 'mpi'
JOURNAL = 'sweep.journal'
SHOWN_REASONS = 6
"""Number of reasons for bad points that are shown, the most frequent ones; the file holds all."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    parser.add_argument('--over', metavar='KEY=VALUES', action='append', required=True,
                        help='an axis: a key of the scene with FROM:TO:COUNT, FROM:TO:COUNT:log or A,B,C, as in law.a=3:6:50; '
                             'give it again for another axis')
    parser.add_argument('--ask', metavar='QUESTION', action='append', required=True,
                        help='bands.POINT.BRANCH, bands.gap.BRANCH, stability.needed, .margin, .growth or .spacing, '
                             'linear.amplitude, timestep.limit, verdict.faults, frf.peak_Hz or frf.peak_m_per_N; give it again '
                             'for another')
    parser.add_argument('--executor', choices=EXECUTORS, default='processes',
                        help='processes of this machine (default), this process alone, Dask, or the ranks of mpiexec')
    parser.add_argument('--workers', metavar='N', type=int, help='processes on this machine (default: one for each core)')
    parser.add_argument('--scheduler', metavar='ADDRESS', help='of a running Dask scheduler, such as tcp://10.0.0.1:8786')
    add_output(parser)
    add_pictures(parser, frequencies=False)


def run(options: Namespace) -> None:
    from ..errors import whole
    from ..sweeps.executors import Here, dask_workers, mpi_ranks, processes

    if options.workers is not None:
        whole('--workers', options.workers)
    if options.scheduler is not None and options.executor != 'dask':
        raise ValueError('--scheduler is the address of a Dask scheduler; add --executor dask')
    try:
        if options.executor == 'dask':
            with dask_workers(options.scheduler, options.workers) as executor:
                _lead(options, executor)
        elif options.executor == 'mpi':
            with mpi_ranks() as executor:
                if executor is not None:  # the first rank; the others have worked until now
                    _lead(options, executor)
        else:
            _lead(options, Here() if options.executor == 'here' else processes(options.workers))
    except ImportError as error:
        raise ValueError(f"{error}; pip install 'magphonon[sweep,dask,mpi]' installs all that sweeps need") from None
    except RuntimeError as error:  # of an executor: BrokenExecutor, or Dask's
        why = ' '.join(str(error).split()).rstrip('.')
        raise ValueError(f'the workers failed: {why}. See that each has this magphonon, and give the command again: it goes on '
                         'where it stopped') from None


def _lead(options, executor):
    """Read the scene, run the sweep, write its results."""
    from pathlib import Path

    from ..plotting.sweeps import plot_sweep
    from ..scenes.scene import read_scene
    from ..sweeps.dataset import sweep
    from ..sweeps.grid import axis_of
    from .results import results

    scene, axes = read_scene(options.scene), [axis_of(text) for text in options.over]
    if len(dict(axes)) < len(axes):
        raise ValueError('--over names a key twice; give each axis once')
    journal = Path(options.output) / JOURNAL
    if journal.is_symlink():
        raise ValueError(f'{journal} is a symbolic link, through which no journal is written; move it away')
    begun = not journal.exists()
    with results(options, scene) as folder, drawing(options, folder, scene.title) as save:
        answers = sweep(scene, dict(axes), options.ask, executor, journal)
        answers.to_netcdf(folder / 'sweep.nc', engine='h5netcdf')
        for name in options.ask:
            save(plot_sweep(answers, name).figure, f'sweep_{name}')
        report = _report(scene.title, answers, options.ask)
    if begun:  # by this very process
        journal.unlink()
    else:
        options.notes.append(f'{journal} belongs to the sweep that is now complete; remove it before the next one')
    print(report)
    print(f'pictures and data are in {options.output}')


def _report(title: str, answers: Dataset, asked: list[str]) -> str:
    """Range of each answer with the points where it is lowest and highest, and why points are bad."""
    from collections import Counter

    import numpy as np

    axes = list(answers.sizes)
    lines = [title, f'{answers.fault.size} points: ' + ' x '.join(f'{count} of {key}' for key, count in answers.sizes.items())]
    for name in asked:
        values, unit = answers[name].to_numpy(), answers[name].attrs['units']
        lines.append(f'\n{name} ({unit}): {np.isfinite(values).sum()} points answered')
        for word, place in (('lowest', np.nanargmin), ('highest', np.nanargmax)) if np.isfinite(values).any() else ():
            at = np.unravel_index(place(values), values.shape)
            where = ', '.join(f'{key} = {float(answers[key][k]):.6g}' for key, k in zip(axes, at, strict=True))
            lines.append(f'  {word:7} {values[at]:.6g} at {where}')
    reasons = Counter(fault for fault in answers.fault.to_numpy().ravel().tolist() if fault)
    if reasons:
        lines.append(f'\n{reasons.total()} points lack an answer, hatched in the pictures:')
        lines += [f'  {count} times: {reason}' for reason, count in reasons.most_common(SHOWN_REASONS)]
        if len(reasons) > SHOWN_REASONS:
            lines.append(f'  and {len(reasons) - SHOWN_REASONS} other reasons, in sweep.nc under "fault"')
    return '\n'.join(lines)
