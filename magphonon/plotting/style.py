"""The style of pictures for print, in force for a while; pyplot's settings stay as the user has them."""

from __future__ import annotations

import logging
from contextlib import contextmanager
from logging.handlers import QueueHandler
from pathlib import Path
from queue import SimpleQueue
from shutil import which
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Iterator
    from os import PathLike

STYLE = Path(__file__).parent / 'magphonon.mplstyle'
"""A style sheet of matplotlib: fonts, lines, ticks and colours for a column of Physical Review B."""
COLUMN_in, PAGE_in = 3.4, 7.0
"""Width of a column and of a page of Physical Review B in inches."""


@contextmanager
def print_style(*sheets: str | PathLike[str]) -> Iterator[None]:
    """Draw and save pictures for a column of Physical Review B, 3.4 inches wide.

    Make the figure, draw on it and save it within the `with`: matplotlib asks for the settings at each of these steps.

    Parameters
    ----------
    *sheets : path-like
        Style sheets of matplotlib, whose settings replace those of the house.

    Raises
    ------
    ValueError
        If a sheet has a line that is no setting of matplotlib, or asks for LaTeX where there is none.
    OSError
        If a sheet cannot be read.

    Examples
    --------
    >>> from magphonon.plotting import new_axes, print_style
    >>> with print_style():
    ...     width, height = new_axes().figure.get_size_inches()
    >>> print(f'{width} inches')
    3.4 inches
    """
    from matplotlib import rc_context, rcParams

    with rc_context():
        for sheet in (STYLE, *sheets):
            _load(Path(sheet))
        if rcParams['text.usetex'] and which('latex') is None:
            asking = sheets[-1] if sheets else 'matplotlibrc'
            raise ValueError(f'{asking} asks for LaTeX (text.usetex), which is not installed; take this line out of it')
        yield


def _load(sheet):
    """Put the settings of a sheet in force; what matplotlib would only log as a warning is an error."""
    from matplotlib import rc_file

    logger, faults = logging.getLogger('matplotlib'), SimpleQueue()
    collector = QueueHandler(faults)
    logger.addHandler(collector)
    try:
        rc_file(str(sheet), use_default_template=False)
    except UnicodeDecodeError:
        raise ValueError(f'{sheet} is no style sheet of matplotlib: it is no text in UTF-8') from None
    finally:
        logger.removeHandler(collector)
    if not faults.empty():
        fault = faults.get().getMessage().strip().splitlines()[0]
        raise ValueError(f'{sheet} is no style sheet of matplotlib: {fault}')
