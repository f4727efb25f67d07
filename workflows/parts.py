"""Workflows run side by side; other processes import them from here, which they could not from `__main__`."""

from concurrent.futures import as_completed
from importlib import import_module

from tqdm import tqdm

from magphonon.plotting.axes import print_style
from magphonon.sweeps.executors import Processes, usable_cores

SHORTENED = ('speed_accuracy',)
"""Those that are shorter with --quick, and when all are run."""
LONGEST = ('speed_accuracy', 'planning', 'vibrometer', 'frf', 'bursts', 'stability')
"""Those that take longest, in order: they start first, so that no core waits for them in the end."""


def outcomes_of(names, out, quick):
    """Outcome of each workflow by its name, in the order of `names`; several run side by side on all cores."""
    if len(names) == 1:
        return {names[0]: run(names[0], out, quick)}
    with Processes(min(usable_cores(), len(names))) as pool:
        longest_first = sorted(names, key=lambda name: LONGEST.index(name) if name in LONGEST else len(LONGEST))
        futures = {name: pool.submit(run, name, out, quick) for name in longest_first}
        for done in tqdm(as_completed(futures.values()), total=len(names), desc='workflows', disable=None):
            done.result()  # raises at once what a workflow raised
    return {name: futures[name].result() for name in names}


def run(name, out, quick):
    """Outcome of one workflow, its pictures in the style of print."""
    workflow = import_module(f'.{name}', __package__)
    shorter = {'quick': quick} if name in SHORTENED else {}
    with print_style():
        return workflow.main(out, **shorter)
