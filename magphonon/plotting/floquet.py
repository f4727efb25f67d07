"""Floquet bands, drawn in SI on matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..units import m
from .axes import COLOURS, in_house_style, label_frequencies, legend_above, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..bands.floquet import FloquetBands

GROWING = 1e-9  # imaginary part, as a fraction of the largest frequency, from which a wave is drawn as one that grows


@in_house_style
def plot_floquet(bands: FloquetBands, along: NDArray[np.float64], *, ax: Axes | None = None) -> Axes:
    """Draw quasi-frequencies as dots, whose size grows with the weight of the harmonic at q itself; growing waves are in colour.

    Parameters
    ----------
    bands : FloquetBands
    along : ndarray, shape (wavevectors,)
        Position of each wavevector on the axis, in rad/mm.
    ax : matplotlib.axes.Axes, optional

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, Travelling, floquet_bands, lattices
    >>> from magphonon.plotting import plot_floquet
    >>> cell = lattices.chain(1.0, 1.0)
    >>> k = Travelling(5.0, 0.2, W=0.9, kap=(2.0, 0))
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=k)
    >>> q = np.linspace(-0.5, 0.5, 21)
    >>> ax = plot_floquet(floquet_bands(cell, np.outer(q, [1, 0, 0])), 2 * np.pi * q)
    """
    ax = new_axes() if ax is None else ax
    x, f = np.broadcast_arrays(along[:, None] * m, bands.frequencies_Hz.real)
    grows = np.imag(bands.omega) > GROWING * abs(bands.omega).max()
    for own, colour, name in ((~grows, COLOURS[0], 'waves'), (grows, COLOURS[1], 'waves that grow')):
        if own.any():
            ax.scatter(x[own], f[own], s=4 * bands.weight[own], color=colour, linewidths=0, label=name)
    ax.set(xlabel='wavevector along the path (rad/m), back on the left', xlim=(x.min(), x.max()))
    label_frequencies(ax.yaxis)
    legend_above(ax, ncols=2)
    return ax
