"""Options that several commands share: the scene, the directory of the results, and the pictures."""

from __future__ import annotations

import os
import re
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import did_you_mean

if TYPE_CHECKING:
    from matplotlib.figure import FigureBase

    from ..scenes.scene import Scene

STDIN = '-'  # argument for a scene that is read from a pipe
FOLDER = 'SCENE-COMMAND'  # placeholder for the default directory, which is named after scene and command


def add_scene(parser: ArgumentParser, needs: str = '') -> None:
    """Add the argument SCENE; `needs` says what the scene must contain."""
    parser.add_argument('scene', metavar='SCENE', help=f'scene file{needs}, or the name of a ready scene such as prototype, or - '
                                                       'for standard input')


def length(text: str) -> float:
    """A length in mm from words such as '10mm', or '0.01' in m."""
    from ..quantities import LENGTH

    return _quantity(text, LENGTH)


def force(text: str) -> float:
    """A force in N from words such as '5mN', or '0.005' in N."""
    from ..quantities import FORCE

    return _quantity(text, FORCE)


def share(text: str) -> float:
    """A fraction from 0 up to 1, such as '0.03'."""
    found = _quantity(text, {'': 1.0, '%': 0.01})
    if 0 <= found < 1:
        return found
    raise ArgumentTypeError(f'must be at least 0 and below 1, not {text!r}; write 3 percent as 0.03 or 3%')


def _quantity(text, units):
    match = re.fullmatch(r'\s*([-+.\deE]*[\d.])\s*([A-Za-z%]*)\s*', text)
    try:
        return float(match[1]) * units[match[2] or next(iter(units))]
    except (TypeError, ValueError, KeyError):
        raise ArgumentTypeError(f'{text!r} is not a number with one of the units {", ".join(filter(None, units))}') from None


def ready_table(name: str) -> str:
    """The file of this name if it exists, otherwise the table of this name that comes with the package."""
    from importlib.resources import files

    if os.path.lexists(name):
        return name
    ready = {table.name.removesuffix('.csv'): table for table in files('magphonon.data').iterdir() if table.name.endswith('.csv')}
    if name in ready:
        return str(ready[name])
    known = [*ready, *(file.name for file in Path(name).parent.glob('*') if file.is_file())]
    raise FileNotFoundError(f'{name or repr(name)} is not there{did_you_mean(Path(name).name, known)}')


def add_output(parser: ArgumentParser) -> None:
    """Add the options of commands that write a directory of results: -o DIR, --force and --verbose."""
    parser.add_argument('-o', '--output', metavar='DIR', default=FOLDER,
                        help='directory for the results, created if it does not exist (default: the name of the input and of the '
                             f'command, such as prototype-{parser.prog.split()[-1]})')
    add_force(parser)
    add_verbose(parser)


def add_verbose(parser: ArgumentParser) -> None:
    """Add the option --verbose."""
    parser.add_argument('--verbose', action='store_true', help='print everything that was found, not only the first line')


def add_force(parser: ArgumentParser) -> None:
    """Add the option --force."""
    parser.add_argument('--force', action='store_true', help='replace files that exist; without it the command refuses')


def find_inputs(options: Namespace) -> None:
    """Find the file of the scene, and name the directory of the results after it."""
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


def left_out(scene: Scene) -> list[str]:
    """A line that says that only the command `bands` uses the damping of [bands], if it is given."""
    return ['bands.damping_per_s ignored here: this command computes motion without losses; "magphonon bands" includes them'
            ] if scene.bands is not None and scene.bands.damping_per_s is not None else []


def add_style(parser: ArgumentParser) -> None:
    """Add the option --style of commands that draw."""
    parser.add_argument('--style', metavar='FILE', help='style sheet of matplotlib, whose settings replace those of the package; '
                                                        '"savefig.format: pdf" in it gives PDF')


@contextmanager
def answering(options: Namespace, scene: Scene,
              *names: str) -> Iterator[tuple[Path, Callable[[FigureBase, str], None], list[str]]]:
    """Context with the folder of results, a function that saves pictures in it, and a list of lines to print at the end.

    The `names` are those of the results, in patterns (see `results`).
    """
    from .results import results

    told: list[str] = []
    with results(options, *names) as folder, drawing(options, folder, scene.title) as save:
        yield folder, save, told
    print(*told, f'pictures and data are in {options.output}', sep='\n')


@contextmanager
def drawing(options: Namespace, folder: Path, title: str = '') -> Iterator[Callable[[FigureBase, str], None]]:
    """Context for drawing in the style for print; yields a function that saves a figure in the folder under a name.

    The title stands above all pictures. Size and format follow the style sheet of the options, if they have one.
    """
    from matplotlib import rcParams

    from ..plotting.axes import entitle, lay_out, print_style

    def save(figure, name):
        entitle(figure, title)
        form = rcParams['savefig.format']
        try:
            lay_out(figure)
            quick = {'pil_kwargs': {'compress_level': 3}} if form == 'png' else {}  # twice as fast as 6, a tenth larger
            figure.savefig(folder / f'{name}.{form}', **quick)
        except ValueError as error:
            why = str(error).strip().splitlines()[-1]
            raise ValueError(f'the picture {name} cannot be drawn ({why}); check its title, where a formula must be between two '
                             '$ signs, and the style sheet if there is one') from None

    with print_style(*([] if options.style is None else [options.style])):
        yield save
