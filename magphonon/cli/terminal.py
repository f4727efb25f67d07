"""Text on a terminal: long sentences are wrapped, and the words of a verdict have colours.

What goes into a file or a pipe stays as it is.  NO_COLOR (https://no-color.org) and TERM=dumb turn the colours off.  The library
rich would do the same, but it takes 30 ms to import, half as long as the command takes to start.
"""

from __future__ import annotations

import os
import re
from shutil import get_terminal_size
from textwrap import TextWrapper
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import TextIO

COLOURS = {'OK': '1;32', 'WARNING': '1;33', 'UNSTABLE': '1;31', 'NOT OK': '1;31', 'TOO COSTLY': '1;31'}
"""Escape codes of ANSI terminals: bold green, yellow and red.  The words say the same without them."""
VERDICTS = re.compile(rf'\b({"|".join(sorted(COLOURS, key=len, reverse=True))})\b')
WIDEST = 100
"""Longest line of wrapped text, in letters; longer ones are hard to read."""
NOT_PROSE = re.compile(r'\S  +\S|^#|^\w+ = ')
"""What shows that a line is the row of a table or stands in a scene file, into which it may be copied: it is not wrapped."""


def wrapped(text: str) -> str:
    """The text in lines that the terminal has room for; rows of tables and of scenes are left as they are."""
    width = min(get_terminal_size().columns, WIDEST)
    return '\n'.join(_wrapped_line(line, width) for line in text.split('\n'))


def _wrapped_line(line, width):
    if len(line) <= width or NOT_PROSE.search(line):
        return line
    indent = re.match(r' *(- )?', line)[0]  # pyright: ignore[reportOptionalSubscript]  it matches the empty text
    return TextWrapper(width, initial_indent=indent, subsequent_indent=' ' * max(len(indent), 2), break_long_words=False,
                       break_on_hyphens=False).fill(line[len(indent) :])


def coloured(text: str) -> str:
    """The text with the words of a verdict in colour, unless the user wants none."""
    if os.environ.get('NO_COLOR') or os.environ.get('TERM') == 'dumb':
        return text
    return VERDICTS.sub(lambda word: f'\x1b[{COLOURS[word[0]]}m{word[0]}\x1b[0m', text)


class Terminal:
    """A stream that wraps and colours the lines that are written to it.

    Parameters
    ----------
    stream : text stream
        The terminal.
    """

    def __init__(self, stream: TextIO) -> None:
        self.stream, self.begun = stream, ''

    def write(self, text: str) -> int:
        """Show the lines that are complete, and keep the rest until its line is."""
        *lines, self.begun = (self.begun + text).split('\n')
        self.stream.writelines(coloured(wrapped(line)) + '\n' for line in lines)
        return len(text)

    def flush(self) -> None:
        """Show what was written without the end of its line."""
        self.stream.write(coloured(wrapped(self.begun)))
        self.begun = ''
        self.stream.flush()

    def isatty(self) -> bool:
        """Whether it is a terminal, which it is."""
        return True
