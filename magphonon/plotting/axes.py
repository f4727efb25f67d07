"""What all pictures share: print style, colours, panels, legends, and axes in SI, labelled with the unit that suits them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from functools import wraps
from logging.handlers import QueueHandler
from os import PathLike
from pathlib import Path
from queue import SimpleQueue
from shutil import which
from string import ascii_lowercase
from typing import TYPE_CHECKING, Any, TypeVar
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from ..units import PREFIXES, prefix_power

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure, FigureBase
    from matplotlib.legend import Legend

STYLE = Path(__file__).parent / 'magphonon.mplstyle'
"""A style sheet of matplotlib: fonts, lines, ticks and colours for a column of Physical Review B."""
COLUMN_in, PAGE_in = 3.4, 7.0  # width of a column and of a page of Physical Review B in inches
COLOURS = ('#00428F', '#E77245', '#000000', '#008A66', '#8F457C', '#E7A221', '#8CD6F2')
"""The colours of the print style, which colour-blind readers can distinguish, and which differ in grey too."""
UNSTABLE = {'facecolor': '0.9', 'edgecolor': '0.6', 'hatch': '///', 'linewidth': 0}
"""Style of every region where modes are unstable."""
MARKERS = 40  # on each branch: few enough to see the line behind them
HOUSE: WeakSet[Figure] = WeakSet()
"""Figures that the package made outside of a `print_style`; everything it draws on them has the style of the package."""
Draw = TypeVar('Draw', bound='Callable[..., Any]')
IN_FORCE: list[str] = []  # the style contexts that are active now


@contextmanager
def print_style(*sheets: str | PathLike[str]) -> Iterator[None]:
    """Context in which pictures are drawn and saved for a column of Physical Review B, 3.4 inches wide.

    Make the figure, draw on it and save it within the `with` block, because matplotlib reads the settings at each of these steps.

    Parameters
    ----------
    *sheets : path-like
        Style sheets of matplotlib, whose settings replace those of this package.

    Examples
    --------
    >>> from magphonon.plotting import new_axes
    >>> from magphonon.plotting.axes import print_style
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
            raise ValueError(f'{asking} asks for LaTeX (text.usetex), which is not installed; remove this line from it')
        IN_FORCE.append('print')
        try:
            yield
        finally:
            IN_FORCE.pop()


def _load(sheet):
    """Apply the settings of a style sheet; faults that matplotlib would only log as warnings are errors here."""
    from matplotlib import rc_file

    logger, faults = logging.getLogger('matplotlib'), SimpleQueue()
    collector = QueueHandler(faults)
    logger.addHandler(collector)
    try:
        rc_file(str(sheet), use_default_template=False)
    except UnicodeDecodeError:
        raise ValueError(f'{sheet} is not a style sheet of matplotlib: it is not text in UTF-8') from None
    finally:
        logger.removeHandler(collector)
    if not faults.empty():
        fault = faults.get().getMessage().strip().splitlines()[0]
        raise ValueError(f'{sheet} is not a style sheet of matplotlib: {fault}')


def in_house_style(draw: Draw) -> Draw:
    """Decorator that lets a function draw in the style of the package, unless another style is active or axes are passed."""
    @wraps(draw)
    def drawn(*args, **options):
        given = [figure for value in (*args, *options.values()) for figure in _figures(value)]
        if IN_FORCE or not HOUSE.issuperset(given):
            return draw(*args, **options)
        with print_style():
            found = draw(*args, **options)
            for figure in _figures(found[0] if isinstance(found, tuple) else found):
                HOUSE.add(figure)
                for ax in figure.axes:  # matplotlib makes ticks as late as it can, and in the style of that time
                    _ = [(axis.majorTicks, axis.minorTicks) for axis in (ax.xaxis, ax.yaxis)]
        return found

    return drawn  # pyright: ignore[reportReturnType]  it takes and returns the same


def _figures(value: Any) -> list[Figure]:
    """List with the figure that an argument is or belongs to; an empty list if it belongs to none."""
    from matplotlib.artist import Artist

    first = value.flat[0] if isinstance(value, np.ndarray) and value.dtype == object and value.size else value
    figure = first.get_figure(root=True) if isinstance(first, Artist) else None
    return [] if figure is None else [figure]


def label(axis: Axis, quantity: str, unit: str, power: int) -> None:
    """Label an axis with a quantity and a unit, and print its numbers in units of 10^power times the unit of the data."""
    from matplotlib.ticker import FuncFormatter, ScalarFormatter

    def printed(value, _):
        return f'{value / 10.0**power:.10g}'.replace('-', '\N{MINUS SIGN}')

    axis.set_major_formatter(FuncFormatter(printed) if power else ScalarFormatter())
    axis.set_label_text(f'{quantity} ({PREFIXES[power]}{unit})')


def label_frequencies(axis: Axis) -> None:
    """Label an axis of data in Hz; it is printed in kHz or MHz if numbers in Hz would be unreadable."""
    largest = max(map(abs, axis.get_view_interval()))
    label(axis, 'frequency', 'Hz', 0 if 0.1 <= largest < 2e4 else prefix_power(largest))


def label_places(ax: Axes, spacing_m: float) -> None:
    """Label axes of x and y with data in m; the unit is chosen so that the distance of two neighbours is printed as 1 to 999."""
    for axis, name in ((ax.xaxis, '$x$'), (ax.yaxis, '$y$')):
        label(axis, name, 'm', prefix_power(spacing_m))


def label_wavevectors(ax: Axes, spacing_m: float) -> None:
    """Label axes of k_x and k_y with data in rad/m; the printed unit is the inverse of one near the neighbour distance."""
    power = prefix_power(10 * spacing_m)  # so that the zone, some radians wide per spacing, does not end at 0.005
    for axis, name in ((ax.xaxis, '$k_x$'), (ax.yaxis, '$k_y$')):
        label(axis, name, 'm', -power)
        axis.set_label_text(f'{name} (rad/{PREFIXES[power]}m)')


@in_house_style
def new_axes(width: float | None = None, height: float | None = None) -> Axes:
    """Axes of a new figure, `width` x `height` in inches, by default the size of the current style.

    The current style is that of this package, or of an enclosing `print_style`. To draw in matplotlib's style, or yours, pass
    your own axes to the functions that draw: ``plot_bands(bands, ax=plt.figure().gca())``.

    Examples
    --------
    >>> from magphonon.plotting import new_axes
    >>> new_axes(width=4.0, height=3.0).figure.get_size_inches().tolist()
    [4.0, 3.0]
    """
    return new_figure(width, height).add_subplot()


@in_house_style
def new_figure(width: float | None = None, height: float | None = None) -> Figure:
    """A figure unknown to pyplot, whose axes leave room for their labels; its size and style are as in `new_axes`."""
    from matplotlib import rcParams
    from matplotlib.figure import Figure

    usual = rcParams['figure.figsize']
    return Figure((width or usual[0], height or usual[1]), layout='compressed')


@in_house_style
def panels(rows: int, columns: int, width: float | None = None,
           height: float | None = None) -> tuple[Figure, NDArray[np.object_]]:
    """A figure with `rows x columns` panels. By default one column of panels is as wide as a column of Physical Review B,
    and several are as wide as its page.

    Parameters
    ----------
    rows, columns : int
    width : float, optional
        Width of the figure, in inches.
    height : float, optional
        Height of a row of panels, in inches; by default three quarters of the width of a panel.

    Returns
    -------
    matplotlib.figure.Figure
    ndarray of matplotlib.axes.Axes, shape (rows, columns)

    Examples
    --------
    >>> from magphonon.plotting import letter_panels, panels
    >>> figure, axes = panels(1, 2)
    >>> letter_panels(axes, ['conventional', 'complete'])
    >>> axes[0, 1].get_title(loc='left')
    '(b) complete'
    """
    width = width or (COLUMN_in if columns == 1 else PAGE_in)
    figure = new_figure(width, rows * (height or 0.75 * width / columns))
    return figure, figure.subplots(rows, columns, squeeze=False)


@in_house_style
def letter_panels(axes: NDArray[np.object_] | Sequence[Axes], names: Sequence[str] = ()) -> None:
    """Put (a), (b), ... above the left corner of each panel, row by row, followed by its name in `names`, or its old title."""
    flat = np.ravel(np.asarray(axes))
    for letter, ax, name in zip(ascii_lowercase, flat, names or [ax.get_title(loc='left') for ax in flat], strict=False):
        ax.set_title(f'({letter}) {name}'.rstrip(), loc='left')


@in_house_style
def legend_above(ax: Axes, **options: Any) -> Legend:
    """Add a legend above the axes, where it covers no data, in as many columns as fit into the width of the figure."""
    options = {'loc': 'lower center', 'bbox_to_anchor': (0.5, 1.0), 'frameon': False} | options
    return _fitting(ax.legend, ax.figure.bbox.width, options)


@in_house_style
def legend_of_set(figure: Figure, **options: Any) -> Legend:
    """Add one legend above all panels of a figure, which lists the name of each curve once."""
    named = {label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    options = {'loc': 'outside upper center', 'handles': list(named.values()), 'labels': list(named), 'frameon': False} | options

    def make(**options):
        while figure.legends:
            figure.legends[0].remove()
        return figure.legend(**options)

    return _fitting(make, figure.bbox.width, options)


def _fitting(make, width, options):
    """A legend in three columns, or in fewer if it would be wider than the figure."""
    for columns in range(options.pop('ncols', 3), 0, -1):
        legend = make(ncols=columns, **options)
        if legend.get_window_extent().width < width:
            break
    return legend


def lay_out(figure: Figure) -> None:
    """Place the panels of a figure of the package for good; `savefig` would lay it out again, in a drawing of its own.

    Matplotlib measures all ticks anew for each spine, to make room for those that point outwards.  There are none in the style
    of the package, whose spines lie on the edges of their axes.
    """
    from matplotlib import rcParams

    for ax in figure.axes if rcParams['xtick.direction'] == rcParams['ytick.direction'] == 'in' else ():
        for side in {'left', 'right', 'top', 'bottom'}.intersection(ax.spines):
            ax.spines[side].set_in_layout(False)
    if (engine := figure.get_layout_engine()) is not None:
        engine.execute(figure)
    figure.set_layout_engine(None)


def entitle(figure: FigureBase, title: str) -> None:
    """Write a title above everything else in a figure, unless it is empty."""
    if title and figure.legends:  # which stand where matplotlib would put the title
        figure.legends[0].set_title(title)
    elif title:
        figure.suptitle(title)


def point_name(name: str) -> str:
    """Name of a special point as it is printed: Γ for G, and indices as subscripts."""
    name = 'Γ' if name == 'G' else name
    return name if len(name) == 1 else f'{name[0]}$_{{{name[1:].lstrip("_")}}}$'
