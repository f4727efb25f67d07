"""Arguments that several commands have: the scene and the directory of the results."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

STDIN = '-'
"""Takes the place of a scene that comes through a pipe."""
FOLDER = 'SCENE-COMMAND'
"""Stands for the directory that is taken if none is named."""


def add_scene(parser: ArgumentParser, needs: str = '') -> None:
    """Add the argument SCENE; `needs` says what must be in it."""
    parser.add_argument('scene', metavar='SCENE', help=f'scene file{needs}, or the name of a ready scene such as prototype, or - '
                                                       'for standard input')


def add_output(parser: ArgumentParser, default: str | None = FOLDER) -> None:
    """Add the option -o DIR; without a `default` the command decides what its absence means."""
    parser.add_argument('-o', '--output', metavar='DIR', default=default,
                        help='directory for the results, made if it is not there (default: SCENE-COMMAND, such as '
                             f'prototype-{parser.prog.split()[-1]})')


def find_inputs(options: Namespace) -> None:
    """Find the source of the scene, and name the directory of the results after it.

    Raises
    ------
    OSError, ValueError
        If there is no such scene.
    """
    if getattr(options, 'scene', None) is None:
        return
    import sys

    from ..scenes.sources import source_in_stream, source_of

    options.scene = source_in_stream(sys.stdin.buffer) if options.scene == STDIN else source_of(options.scene)
    if getattr(options, 'output', None) == FOLDER:
        options.output = default_folder(options)


def default_folder(options: Namespace) -> str:
    """The directory for the results of a command on a scene, such as 'prototype-bands'."""
    return f'{options.scene.stem}-{options.command}'
