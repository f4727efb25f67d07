"""Axes, colours and legends that all pictures share."""

from __future__ import annotations

from string import ascii_lowercase
from typing import TYPE_CHECKING

import numpy as np

from .style import COLUMN_in, PAGE_in

if TYPE_CHECKING:
    from collections.abc import Sequence
    from typing import Any

    from matplotlib.axes import Axes
    from matplotlib.figure import Figure, FigureBase
    from matplotlib.legend import Legend
    from numpy.typing import NDArray

COLOURS = ('#00428F', '#E77245', '#000000', '#008A66', '#8F457C', '#E7A221', '#8CD6F2')
"""The colours of the print style, which colour-blind readers can distinguish, and which differ in grey too."""
UNSTABLE = {'facecolor': '0.9', 'edgecolor': '0.6', 'hatch': '///', 'linewidth': 0}
"""Style of every region where modes are unstable."""
MARKERS = 40  # on each branch: few enough to see the line behind them


def new_axes(width: float | None = None, height: float | None = None) -> Axes:
    """Axes of a figure of its own, `width` x `height` in inches, by default as large as the style in force has it.

    Examples
    --------
    >>> from magphonon.plotting import new_axes
    >>> new_axes(width=4.0, height=3.0).figure.get_size_inches().tolist()
    [4.0, 3.0]
    """
    return new_figure(width, height).add_subplot()


def new_figure(width: float | None = None, height: float | None = None) -> Figure:
    """A figure that pyplot never sees, whose axes leave room for their labels; its size as in `new_axes`."""
    from matplotlib import rcParams
    from matplotlib.figure import Figure

    usual = rcParams['figure.figsize']
    return Figure((width or usual[0], height or usual[1]), layout='compressed')


def panels(rows: int, columns: int, width: float | None = None,
           height: float | None = None) -> tuple[Figure, NDArray[np.object_]]:
    """A figure with `rows x columns` panels, as wide as a column of the journal for one column of panels, or as its page.

    Parameters
    ----------
    rows, columns : int
    width : float, optional
        Of the figure, in inches.
    height : float, optional
        Of a row of panels, in inches; by default three quarters of the width of a panel.

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


def letter_panels(axes: NDArray[np.object_] | Sequence[Axes], names: Sequence[str] = ()) -> None:
    """Put (a), (b), ... above the left corner of each panel, row by row, before its name: one of `names`, or the one it has."""
    flat = np.ravel(np.asarray(axes))
    for letter, ax, name in zip(ascii_lowercase, flat, names or [ax.get_title(loc='left') for ax in flat], strict=False):
        ax.set_title(f'({letter}) {name}'.rstrip(), loc='left')


def legend_above(ax: Axes, **options: Any) -> Legend:
    """Legend above the axes, where it covers no data, in as many columns as the figure is wide enough for."""
    options = {'loc': 'lower center', 'bbox_to_anchor': (0.5, 1.0), 'frameon': False} | options
    return _fitting(ax.legend, ax.figure.bbox.width, options)


def legend_of_set(figure: Figure, **options: Any) -> Legend:
    """One legend above all panels of a figure, in which each name of their curves stands once."""
    named = {label: handle for ax in figure.axes for handle, label in zip(*ax.get_legend_handles_labels(), strict=True)}
    options = {'loc': 'outside upper center', 'handles': list(named.values()), 'labels': list(named), 'frameon': False} | options

    def make(**options):
        while figure.legends:
            figure.legends[0].remove()
        return figure.legend(**options)

    return _fitting(make, figure.bbox.width, options)


def _fitting(make, width, options):
    """A legend in three columns or, where that is wider than the figure, in fewer."""
    for columns in range(options.pop('ncols', 3), 0, -1):
        legend = make(ncols=columns, **options)
        if legend.get_window_extent().width < width:
            break
    return legend


def entitle(figure: FigureBase, title: str) -> None:
    """Write a title above all else in a figure; an empty one is none."""
    if title and figure.legends:  # which stand where matplotlib would put the title
        figure.legends[0].set_title(title)
    elif title:
        figure.suptitle(title)


def point_name(name: str) -> str:
    """Name of a special point as it is printed: Γ for G, an index lowered.

    Examples
    --------
    >>> from magphonon.plotting import point_name
    >>> point_name('G'), point_name('M')
    ('Γ', 'M')
    """
    name = 'Γ' if name == 'G' else name
    return name if len(name) == 1 else f'{name[0]}$_{{{name[1:].lstrip("_")}}}$'
