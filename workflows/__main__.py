"""`python -m workflows [NAME ...] [--quick] [-o DIR]`: run the workflows, print one table, write the report."""

import argparse
import os
import sys
from concurrent.futures import ProcessPoolExecutor, as_completed
from datetime import datetime
from multiprocessing import get_context
from pathlib import Path
from time import perf_counter

os.environ.setdefault('OMP_NUM_THREADS', '1')  # before numpy is loaded: threads get in the way of its small matrices

from tqdm import tqdm

from .accuracy import machine
from .chapters import NAMES, SHORTENED, cores, run
from .mutations import MUTATED, as_markdown, table
from .report import counted, text_table, write_html, write_summary

LONGEST = ('bursts', 'frf', 'speed_accuracy', 'vibrometer', 'stability', 'nonlinearity', 'bench', 'claims')
"""The workflows that take longest, in order: they start first, so that no core waits for them in the end.  The first two share no
compiled steps; `speed_accuracy` finds those of `bursts` in numba's cache."""


def main(arguments=None):
    """Run the named workflows, all by default; returns the exit status, 1 if any check failed."""
    parser = argparse.ArgumentParser(prog='python -m workflows', description="The paper's results, reproduced and compared.")
    parser.add_argument('names', nargs='*', metavar='NAME', help=f'one of {", ".join(NAMES)}; all by default')
    parser.add_argument('--quick', action='store_true', help=f'shorten {", ".join(SHORTENED)}, as when all are run')
    parser.add_argument('--mutate', action='store_true', help='put wrong physics into the package and count rows that notice it; '
                        'all chapters with a stiffness by default, which takes some minutes')
    parser.add_argument('-o', '--out', type=Path, default=Path('out'), metavar='DIR', help='where to write (default: out)')
    options = parser.parse_args(arguments)
    unknown = [name for name in options.names if name not in NAMES]
    if unknown:
        parser.error(f'there is no workflow {unknown[0]!r}; choose from {", ".join(NAMES)}')
    try:
        options.out.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        parser.error(f'cannot write to {options.out}: {error.strerror}; name another directory with -o')

    if options.mutate:
        for name in set(options.names) - set(MUTATED):
            parser.error(f'{name} has no stiffness to put wrong')
        print(as_markdown(table(options.names or MUTATED, options.out)))
        return 0
    start = perf_counter()
    outcomes = outcomes_of(options.names or NAMES, options.out, options.quick or not options.names)
    write_summary(options.out / 'summary.json', outcomes)
    write_html(options.out / 'report.html', outcomes, provenance(perf_counter() - start))
    print(text_table(outcomes))
    checks = [check for outcome in outcomes.values() for check in outcome.checks]
    print(f'\n{counted(outcomes)}; pictures and report.html in {options.out}/')
    return 0 if all(check.passed for check in checks) else 1


def outcomes_of(names, out, quick):
    """Outcomes by the name of the workflow, in the order of `names`; several workflows run side by side on all cores."""
    if len(names) == 1:
        return {names[0]: run(names[0], out, quick)}
    with ProcessPoolExecutor(min(cores(), len(names)), get_context('spawn')) as pool:
        longest_first = sorted(names, key=lambda name: LONGEST.index(name) if name in LONGEST else len(LONGEST))
        futures = {name: pool.submit(run, name, out, quick) for name in longest_first}
        for done in tqdm(as_completed(futures.values()), total=len(names), desc='workflows', disable=None):
            done.result()  # raises at once what a workflow raised
    return {name: futures[name].result() for name in names}


def provenance(seconds):
    """Lines that say when, for how long, on which machine and with which versions the workflows ran."""
    now = datetime.now().astimezone()
    return [f'{now:%d %B %Y, %H:%M %Z}; computed in {seconds:.0f} s', *machine()]


if __name__ == '__main__':
    sys.exit(main())
