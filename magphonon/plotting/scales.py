"""Axes whose data are in SI and whose numbers are printed in the unit that suits them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.axis import Axis
    from matplotlib.figure import Figure

PREFIXES = {-12: 'p', -9: 'n', -6: 'µ', -3: 'm', 0: '', 3: 'k', 6: 'M', 9: 'G', 12: 'T'}
"""Prefixes of a unit by the power of ten."""
FREQUENCIES = 'frequencies'
"""Mark of an axis whose data are frequencies in Hz."""


def prefix_power(value: float) -> int:
    """Power of ten of the prefix with which a value is printed as 1 to 999, one of `PREFIXES`."""
    power = 3 * np.floor((np.log10(abs(value)) + 1e-9) / 3) if value else 0  # 1e-9: 0.999999999 m is a rounded metre
    return int(np.clip(power, min(PREFIXES), max(PREFIXES)))


def label(axis: Axis, quantity: str, unit: str, power: int) -> None:
    """Label an axis with a quantity and its unit, whose numbers are printed in 10^power of the unit of its data."""
    from matplotlib.ticker import FuncFormatter, ScalarFormatter

    def printed(value, _):
        return f'{value / 10.0**power:.10g}'.replace('-', '\N{MINUS SIGN}')

    axis.set_major_formatter(FuncFormatter(printed) if power else ScalarFormatter())
    axis.set_label_text(f'{quantity} ({PREFIXES[power]}{unit})')


def label_frequencies(axis: Axis) -> None:
    """Label an axis whose data are in Hz, in kHz or MHz if numbers in Hz would be unreadable."""
    largest = max(map(abs, axis.get_view_interval()))
    label(axis, 'frequency', 'Hz', 0 if 0.1 <= largest < 2e4 else prefix_power(largest))
    axis.set_gid(FREQUENCIES)


def label_places(ax: Axes, spacing_m: float) -> None:
    """Label axes of x and y whose data are in m, in the unit in which the distance of two neighbours is printed as 1 to 999."""
    for axis, name in ((ax.xaxis, '$x$'), (ax.yaxis, '$y$')):
        label(axis, name, 'm', prefix_power(spacing_m))


def label_wavevectors(ax: Axes, spacing_m: float) -> None:
    """Label axes of k_x and k_y whose data are in rad/m, in the inverse of a unit near the distance of two neighbours."""
    power = prefix_power(10 * spacing_m)  # so that the zone, some radians wide per spacing, does not end at 0.005
    for axis, name in ((ax.xaxis, '$k_x$'), (ax.yaxis, '$k_y$')):
        label(axis, name, 'm', -power)
        axis.set_label_text(f'{name} (rad/{PREFIXES[power]}m)')


def end_frequencies(figure: Figure, highest_Hz: float) -> None:
    """Let all axes of frequencies in a figure end at `highest_Hz`.

    Raises
    ------
    ValueError
        If one begins above it.
    """
    for ax in figure.axes:
        for axis, set_ends in ((ax.xaxis, ax.set_xlim), (ax.yaxis, ax.set_ylim)):
            if axis.get_gid() == FREQUENCIES:
                lowest = axis.get_view_interval()[0]
                if highest_Hz <= lowest:
                    raise ValueError(f'the frequencies in a picture begin at {lowest:.6g} Hz; choose an end above it')
                set_ends(lowest, highest_Hz)
                label_frequencies(axis)
