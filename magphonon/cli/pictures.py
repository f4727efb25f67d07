"""The pictures of a command: the options that change them, and how they are drawn and saved."""

from __future__ import annotations

from contextlib import contextmanager
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace
    from collections.abc import Callable, Iterator
    from pathlib import Path

    from matplotlib.figure import FigureBase


def add_pictures(parser: ArgumentParser, frequencies: bool = True) -> None:
    """Add the options of pictures, with --fmax if some have a frequency axis (`frequencies`)."""
    group = parser.add_argument_group('pictures')
    group.add_argument('--pdf', action='store_true', help='write each picture as PDF too')
    group.add_argument('--title', metavar='TEXT', help="title of the pictures (default: the scene's); '' for none")
    if frequencies:
        group.add_argument('--fmax', metavar='HZ', type=float, help='upper end of the frequency axes in Hz')
    group.add_argument('--style', metavar='FILE', help='style sheet of matplotlib, whose settings replace those of the package')


@contextmanager
def drawing(options: Namespace, folder: Path, title: str = '') -> Iterator[Callable[[FigureBase, str], None]]:
    """Draw in the style for print, and save as set by the options.

    Parameters
    ----------
    options : argparse.Namespace
        Including those of `add_pictures`.
    folder : pathlib.Path
    title : str
        Title of all pictures, unless the options set one.

    Yields
    ------
    callable
        Function that saves a figure in the folder, by a name without file ending.

    Raises
    ------
    ValueError
        At once if the file is not a style sheet or the highest frequency is not positive; on saving a picture whose frequencies
        begin above it, or whose title matplotlib cannot draw.
    OSError
        At once if the style sheet cannot be read.
    """
    from ..errors import positive
    from ..plotting.axes import end_frequencies, entitle, print_style

    highest = getattr(options, 'fmax', None)
    if highest is not None:
        positive('--fmax', highest, 'Hz')

    def save(figure, name):
        entitle(figure, title if options.title is None else options.title)
        if highest is not None:
            try:
                end_frequencies(figure, highest)
            except ValueError as error:
                raise ValueError(f'--fmax {highest:g}: {error}') from None
        try:
            for ending in ('png', *(['pdf'] if options.pdf else [])):
                figure.savefig(folder / f'{name}.{ending}')
        except ValueError as error:
            why = str(error).strip().splitlines()[-1]
            raise ValueError(f'the picture {name} cannot be drawn ({why}); check its title: a formula must be between '
                             'two $ signs') from None

    with print_style(*([] if options.style is None else [options.style])):
        yield save
