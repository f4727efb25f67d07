"""`magphonon plan SCENE --tolerance 1e-3 [--run]`: the cheapest method that meets a tolerance, and with --run its answer."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import nullcontext

from ..errors import positive
from .arguments import add_output, add_scene, default_folder

HELP = 'the simplest model that meets your tolerance'
RESULTS = 'plan_*',
LEAST_TOLERANCE = 1e-7
"""Smallest relative tolerance: at Gamma a frequency is the square root of a rounded eigenvalue, a few 1e-8 of the highest one."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser, ' with [frf] or [burst]')
    parser.add_argument('--tolerance', metavar='X', type=float, default=1e-3,
                        help='allowed relative error of the wanted results (default: 1e-3)')
    parser.add_argument('--run', dest='answer', action='store_true', help='run the recommended method')
    add_output(parser, default=None)


def run(options: Namespace) -> None:
    from ..planning.scene import scene_plans
    from ..scenes.scene import read_scene
    from .costs import refuse_costly
    from .neighbours import omission
    from .results import results

    tolerance = positive('--tolerance', options.tolerance)
    if not LEAST_TOLERANCE <= tolerance < 1:
        raise ValueError(f'--tolerance must lie between {LEAST_TOLERANCE:g} and 1, not {tolerance:g}; a frequency near zero is '
                         'the square root of a rounded eigenvalue and has no more correct digits')
    if options.output is not None and not options.answer:
        raise ValueError(f'-o {options.output} is the directory for the results of --run; add --run, or omit -o')
    scene = read_scene(options.scene)
    refuse_costly(scene, 'frf', 'burst')
    options.output = options.output or default_folder(options)
    with results(options, scene) if options.answer else nullcontext() as folder:
        for wanted in scene_plans(scene, tolerance):
            print(wanted.plan.first, *([wanted.report(), ''] if options.verbose else []), sep='\n')
            if folder is not None:
                wanted.run(folder)
    print(*(f'{line}\n' for line in omission(scene, options.verbose)), sep='', end='')
    if options.answer:
        print(f'data are in {options.output}')
