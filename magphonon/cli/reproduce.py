"""`magphonon reproduce [NAME ...]`: the results of the paper, recomputed and compared, with pictures and a report.

It does the same as `python -m workflows` in the sources. The exit status is 1 if a number fails its check.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from importlib import import_module
from pathlib import Path

from .arguments import add_force
from .results import refuse_existing

HELP = 'recompute the paper, number by number, with a report'


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument('names', nargs='*', metavar='NAME',
                        help='workflows, such as prototype_bands; default: all, in one to three minutes')
    parser.add_argument('-o', '--output', metavar='DIR', default='out', help='directory for the report (default: out)')
    add_force(parser)


def run(options: Namespace) -> int:
    """Run the workflows and return 0 if all numbers pass, 1 otherwise."""
    folder = Path(options.output)
    if folder.is_dir():
        refuse_existing(options, sorted(folder.iterdir()))
    workflows = import_module('magphonon.workflows.__main__')  # in the sources the workflows are beside the package
    return workflows.main([*options.names, '-o', options.output])
