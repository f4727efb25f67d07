"""The command `magphonon`: what anybody's scene file asks for, and ready scenes to start from.

Exit status: 0 when all is written, 1 when `check` finds a fault in what the scene describes, 2 for a mistake in the command,
the scene or the place of the results (one message, nothing written), 130 when interrupted, 143 when terminated.
"""

import argparse
import os
import sys
from contextlib import contextmanager
from importlib import import_module
from signal import SIGTERM, signal
from threading import current_thread, main_thread

from . import __version__

COMMANDS = ('bands', 'burst', 'check', 'design', 'fit', 'frf', 'plan', 'scene', 'spectrum', 'uncertainty')
"""Each is a module of `magphonon.commands`."""


def main(arguments=None):
    """Run the command with `arguments` (by default those of the shell) and return its exit status."""
    options = _parser().parse_args(arguments)
    try:
        with _termination_unwinds():
            status = options.run(options) or 0
        sys.stdout.flush()
    except BrokenPipeError:  # the reader, `head` for one, has seen enough; Python must not flush to it once more
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (ValueError, OSError) as error:
        print(f'magphonon: {error}', file=sys.stderr)
        return 2
    except Terminated:
        print('magphonon: terminated', file=sys.stderr)
        return 143
    except KeyboardInterrupt:
        print('magphonon: interrupted', file=sys.stderr)
        return 130
    return status


class Terminated(KeyboardInterrupt):
    """SIGTERM, which by itself would leave temporary files behind."""


@contextmanager
def _termination_unwinds():
    def unwind(*_):
        raise Terminated

    if current_thread() is not main_thread():  # only there may signals be handled
        yield
        return
    before = signal(SIGTERM, unwind)
    try:
        yield
    finally:
        signal(SIGTERM, before)


def _parser():
    parser = argparse.ArgumentParser(prog='magphonon', description='Static forces in repulsive lattices: bands with D0 + D*.')
    parser.add_argument('--version', action='version', version=f'magphonon {__version__}')
    commands = parser.add_subparsers(required=True, metavar='COMMAND')
    for name in COMMANDS:
        command = import_module(f'.commands.{name}', __package__)
        subparser = commands.add_parser(name, help=command.HELP, description=command.__doc__.partition(': ')[2])
        command.add_arguments(subparser)
        subparser.set_defaults(run=command.run)
    return parser
