"""Arguments that several commands have: the scene and the directory of the results."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

STDIN = '-'
"""Argument for a scene that is read from a pipe."""
FOLDER = 'SCENE-COMMAND'
"""Placeholder for the default directory, which is named after scene and command."""


def add_scene(parser: ArgumentParser, needs: str = '') -> None:
    """Add the argument SCENE; `needs` says what must be in it."""
    parser.add_argument('scene', metavar='SCENE', help=f'scene file{needs}, or the name of a ready scene such as prototype, or - '
                                                       'for standard input')


def add_output(parser: ArgumentParser, default: str | None = FOLDER) -> None:
    """Add the option -o DIR; without a `default` the command itself handles its absence."""
    parser.add_argument('-o', '--output', metavar='DIR', default=default,
                        help='directory for the results, created if it does not exist (default: SCENE-COMMAND, such as '
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
