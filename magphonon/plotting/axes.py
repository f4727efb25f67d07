"""Axes, colours and legends that all pictures share."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from typing import Any

    from matplotlib.axes import Axes
    from matplotlib.legend import Legend

COLOURS = ('#0072B2', '#D55E00', '#000000', '#009E73', '#CC79A7', '#E69F00', '#56B4E9')
"""Okabe and Ito's colours, which colour-blind readers can distinguish; in grey the line styles are different."""
UNSTABLE = {'facecolor': '0.9', 'edgecolor': '0.6', 'hatch': '///', 'linewidth': 0}
"""Style of every region where modes are unstable."""
MARKERS = 40  # on each branch: few enough to see the line behind them


def new_axes(width: float = 5.2, height: float = 4.0) -> Axes:
    """Axes of a figure of its own, `width` x `height` in inches.

    Examples
    --------
    >>> from magphonon.plotting import new_axes
    >>> new_axes(width=4.0).figure.get_size_inches().tolist()
    [4.0, 4.0]
    """
    from matplotlib.figure import Figure

    return Figure((width, height), dpi=200, layout='compressed').add_subplot()


def legend_above(ax: Axes, **options: Any) -> Legend:
    """Legend above the axes, where it covers no data, in as many columns as the figure is wide enough for."""
    options = {'loc': 'lower center', 'bbox_to_anchor': (0.5, 1.0), 'ncols': 3, 'frameon': False} | options
    for columns in range(options['ncols'], 0, -1):
        legend = ax.legend(**options | {'ncols': columns})
        if legend.get_window_extent().width < ax.figure.bbox.width:
            break
    return legend


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
