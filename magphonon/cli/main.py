"""The command `magphonon`: it runs the subcommands on scene files and prints ready scenes to start from.

Exit status: 0 when all is written, 1 when `check` finds a fault in what the scene describes, 2 for an error in the command, the
scene or the directory of the results (one message; nothing is written unless the message says so), 3 when the results are written
but the report could not be shown, 130 when interrupted or terminated.
"""

from __future__ import annotations

import argparse
import gc
import os
import signal
import sys
import warnings
from collections.abc import Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from importlib import import_module
from io import StringIO
from pkgutil import iter_modules
from threading import current_thread, main_thread

if 'OMP_NUM_THREADS' not in os.environ:  # before numpy is loaded: on small matrices threads of OpenBLAS wait more than they work
    os.environ.setdefault('OPENBLAS_NUM_THREADS', '1')

from .. import __version__
from ..errors import did_you_mean
from .arguments import find_inputs

SHARED = 'arguments', 'band_report', 'fit_report', 'main', 'neighbours', 'results'
FIRST = 'scene', 'bands', 'check', 'fit', 'burst', 'explore'
COMMANDS = *FIRST, *sorted({module.name for module in iter_modules([os.path.dirname(__file__)])}.difference(FIRST, SHARED))
"""The commands, those that a bench needs first: each is a module beside this one, with its HELP, `add_arguments(parser)` and
`run(options)`."""
SYNONYMS = {'dispersion': 'bands', 'response': 'frf', 'stability': 'check', 'verdict': 'check', 'wave': 'burst',
            'tolerances': 'bands', 'shapes': 'modes'}
"""Common terms and the names of the commands that they mean."""
CYCLES = 300_000, 5, 5
"""Thresholds of Python's garbage collector: with its own 700 a burst spends a tenth of its time on collection, a workflow a
twentieth; imports make 120 000 objects that stay, matplotlib as many more."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command with `arguments` (by default those of the shell) and return its exit status."""
    _open_streams()
    gc.set_threshold(*CYCLES)
    os.environ['MPLBACKEND'] = 'agg'  # pictures go to files, whatever backend the shell sets for matplotlib
    options = _options(list(sys.argv[1:] if arguments is None else arguments))
    kept = StringIO()  # output to a file or a pipe is written at the end
    with redirect_stdout(sys.stdout if sys.stdout.isatty() else kept):
        status = _status(options)
    try:
        sys.stdout.write(kept.getvalue())
        sys.stdout.flush()
    except BrokenPipeError:  # the reader of the pipe, such as `head`, has finished
        _forget_output()
    except OSError as error:
        _forget_output()
        _tell(f'the report could not be shown ({error.strerror})' + '; the results are written' * hasattr(options, 'written'))
        return status or 3
    return status


def _status(options):
    try:
        if current_thread() is main_thread():  # no other one can handle signals
            signal.signal(signal.SIGTERM, _unwind)
        with _no_silent_overflow():
            find_inputs(options)
            return options.run(options) or 0
    except RuntimeWarning as warning:
        return _refusal(f'numbers became too large or too small to compute with ({warning}); check units and exponents, first of '
                        f'all in the law, in {_inputs(options)}')
    except FloatingPointError as error:
        return _refusal(f'{error}; check units and exponents, first of all in the law, in {_inputs(options)}')
    except MemoryError as error:
        return _refusal(f'{_inputs(options)} needs more memory than is available ({error or "the system gave no more"}); '
                        'make it smaller')
    except ValueError as error:
        return _refusal(error)
    except OSError as error:
        told = error.filename is None or error.errno is None  # raised by the package itself, with a full message
        return _refusal(error if told else f'{error.filename} cannot be opened ({error.strerror})')
    except KeyboardInterrupt:
        _tell('interrupted')
        return 130


def _unwind(number, _):
    """End a job that a batch system terminates as if it were interrupted, so that its temporary files are removed."""
    raise KeyboardInterrupt


def _refusal(words):
    _tell(words)
    return 2


def _said(words):
    return ''.join(x if x.isprintable() or x in '\n\t' else repr(x)[1:-1] for x in f'magphonon: {words}')  # nor escape codes


def _tell(words):
    text = _said(words)
    with suppress(OSError):  # a full disk behind `2>`: the exit status still reports the error
        print(text, file=sys.stderr, flush=True)


def _inputs(options):
    return ' and '.join(str(getattr(options, name)) for name in ('table', 'file', 'scene') if getattr(options, name, None))


def _open_streams():
    """Connect streams that the shell has closed (`>&-`) to nowhere, and escape letters that the terminal cannot show."""
    for name, mode in (('stdin', 'r'), ('stdout', 'w'), ('stderr', 'w')):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode))  # noqa: SIM115  as long as the process
    if hasattr(sys.stdout, 'reconfigure'):  # streams replaced by tests lack it
        sys.stdout.reconfigure(errors='backslashreplace')  # pyright: ignore[reportAttributeAccessIssue]  which hasattr asks for


def _forget_output():
    """Redirect the output to nowhere, so that Python does not flush to a closed pipe again when it exits."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


@contextmanager
def _no_silent_overflow():
    """Turn an overflow, a division by zero or a NaN in a formula of the package into an error that ends the command; other
    warnings are sentences, without the line of the program.
    """
    before, told = warnings.formatwarning, set()

    def sentence(message, *_, **__):
        odd = getattr(message, 'what', None)  # of a unit, which users of commands mend in the scene
        words = _said(f'warning: {odd + "; check the units of the scene, which its keys name" if odd else message}') + '\n'
        return '' if words in told else told.add(words) or words

    with warnings.catch_warnings():
        warnings.filterwarnings('error', category=RuntimeWarning, module=r'magphonon\.')
        warnings.filterwarnings('ignore', message='Glyph .* missing from')  # letters of a title that the font lacks
        warnings.formatwarning = sentence
        try:
            yield
        finally:
            warnings.formatwarning = before


def _options(arguments):
    parser = parser_of([first] if (first := next(iter(arguments), '-')) in COMMANDS else COMMANDS)
    if not first.startswith('-') and first not in COMMANDS:
        meant = did_you_mean(SYNONYMS.get(first, first), COMMANDS, f'the commands are {", ".join(COMMANDS)}')
        parser.error(f'there is no command {first!r}{meant}')
    options, unknown = parser.parse_known_args(arguments)
    for word in unknown[:1]:
        meant = did_you_mean(word, options.flags, f'its options are {", ".join(options.flags)}')
        wrong = f'has no option {word!r}{meant}' if word.startswith('-') else f'takes no further argument {word!r}'
        parser.error(f'"magphonon {options.command}" {wrong}')
    if getattr(options, 'output', None) in ('', [], '--'):  # argparse made a list of '--' before Python 3.13
        parser.error("-o names no directory; '.' is the current one")
    return options


def parser_of(names: Sequence[str] = COMMANDS) -> argparse.ArgumentParser:
    """A parser of some commands: a command that runs needs no other."""
    parser = argparse.ArgumentParser(prog='magphonon',
                                     description='Vibrations of lattices whose particles repel each other, such as magnets: '
                                                 'bands, waves, responses and stability, with the static forces and without.',
                                     epilog='The first six are enough for magnets of your own. Try "magphonon bands prototype", '
                                            'the bands of a published lattice in three seconds.')
    parser.add_argument('--version', action='version', version=f'magphonon {__version__}')
    commands = parser.add_subparsers(required=True, metavar='COMMAND')
    for name in names:
        command = import_module(f'.{name}', __package__)
        told = (command.__doc__ or '').partition(': ')[2]  # python -OO leaves out docstrings
        subparser = commands.add_parser(name, help=command.HELP, description=told)
        command.add_arguments(subparser)
        flags = [flag for action in subparser._actions for flag in action.option_strings]
        subparser.set_defaults(run=command.run, command=name, flags=flags)
    return parser


if __name__ == '__main__':
    sys.exit(main())
