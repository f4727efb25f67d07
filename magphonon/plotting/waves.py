"""Wavenumber-frequency maps over the bands, and snapshots of waves, drawn in SI on matplotlib axes."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units
from .axes import COLOURS, legend_above, new_axes
from .scales import label_frequencies

if TYPE_CHECKING:
    from pathlib import Path

    from ase import Atoms
    from matplotlib.axes import Axes

    from .results import Passage, Record, Site, Wave

FLOOR_dB = -40
"""Lowest power shown in a map, in decibels relative to the strongest."""
LINES = {'complete': (COLOURS[0], '-'), 'conventional': (COLOURS[1], '--')}
MARGIN = 1.4
"""Ratio of the upper end of a map to the highest frequency that it shows."""


def plot_wave(wave: Wave, ax: Axes | None = None) -> Axes:
    """Wavenumber-frequency map with the branches of both models and the ridge over it.

    Parameters
    ----------
    wave : Wave
        Its ridge is drawn as circles with their uncertainty.
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices, plot_wave
    >>> from magphonon.waves import Displacements, waves
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> t, x = np.arange(0, 80, 0.5), np.arange(24)
    >>> s = t[:, None] - x / 0.6  # the time since a pulse passed
    >>> u = np.exp(-(((s - 20) / 8) ** 2)) * np.cos(0.5 * s)
    >>> ax = plot_wave(waves(Displacements(t, x, np.stack([1e-3 * u, 0 * u], axis=2)), cell, 'row')[0])
    """
    ax = new_axes() if ax is None else ax
    spectrum, forward = wave.spectrum, wave.spectrum.xi >= 0
    with np.errstate(divide='ignore'):
        dB = 10 * np.log10(spectrum.power / spectrum.peak)
    lit = spectrum.omega[dB.max(axis=1) > FLOOR_dB / 2].max()  # also where all waves run backwards
    top = min(MARGIN * lit, spectrum.omega[-1])
    shown = spectrum.omega <= top
    image = ax.pcolormesh(spectrum.xi[forward], units.hertz(spectrum.omega[shown]), dB[np.ix_(shown, forward)].clip(FLOOR_dB),
                          cmap='Greys', vmin=FLOOR_dB, vmax=0, shading='nearest', rasterized=True)
    ax.figure.colorbar(image, ax=ax, label='power (dB)')
    for (model, name), branch in wave.branches.items():
        colour, line = LINES[model]
        ax.plot(branch.xi, units.hertz(branch.omega), line, color=colour, linewidth=1.6, label=model if name == 'shear' else None)
    if wave.ridge:
        ridge = wave.ridge
        ax.errorbar(ridge.xi, units.hertz(ridge.omega), units.hertz(ridge.sigma_omega), ridge.sigma_xi, fmt='o', color=COLOURS[3],
                    markersize=3.5, markerfacecolor='white', linewidth=0.9, label='ridge')
    ax.set(xlabel=r'phase per step $\xi = k\cdot R$ (rad)', xlim=(0, np.pi), ylim=(0, units.hertz(top)))
    label_frequencies(ax.yaxis)
    ax.set_xticks(np.pi * np.arange(5) / 4, ['0', 'π/4', 'π/2', '3π/4', 'π'])
    legend_above(ax, title=f'{wave.motion} motion')
    return ax


def plot_snapshot(patch: Atoms, field: Record, frame: int, site: Site, ax: Axes | None = None) -> Axes:
    """All particles of a patch at one time, darker for a larger displacement, with the source and the measured row.

    Parameters
    ----------
    patch : ase.Atoms
        Structure whose calculator stores the rest positions.
    field : Displacements
        Displacements of all particles of the patch.
    frame : int
    site : Site
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes
    """
    ax = new_axes() if ax is None else ax
    rest = patch.calc.reference.positions[:, :2] / units.m
    width = ax.get_position().width * ax.figure.get_figwidth()  # pyright: ignore[reportAttributeAccessIssue]  no subfigure
    diameter = 72 * width * patch.calc.bonds.lengths.min() / units.m / np.ptp(rest[:, 0])  # in points, to touch each other
    dots = ax.scatter(*rest.T, s=(0.8 * diameter) ** 2, c=_distance(field, frame), cmap='Greys', vmin=0, linewidths=0)
    ax.figure.colorbar(dots, ax=ax, label='displacement (m)', shrink=0.6)
    ax.plot(*rest[site.row].T, '--', color=COLOURS[0], linewidth=1, label='measured along $R_2$')
    ax.plot(*rest[site.driven].T, '-', color=COLOURS[1], marker='^', markersize=3, linewidth=1, label='driven')
    legend_above(ax, ncols=2, title=_moment(patch, field, frame))
    ax.set(xlabel='$x$ (m)', ylabel='$y$ (m)', aspect='equal')
    return ax


def crossing(passage: Passage) -> int:
    """Index of the frame of the whole patch closest to the time of the largest displacement in the middle of the row."""
    u = np.linalg.norm(passage.row.displacements[:, len(passage.row.particles) // 2], axis=1)
    return int(abs(passage.field.times - passage.row.times[u.argmax()]).argmin())


def save_animation(path: str | Path, patch: Atoms, field: Record, site: Site) -> None:
    """Write a GIF of all frames, each with its own grey scale, so that a wave is visible until it has decayed."""
    from matplotlib.animation import FuncAnimation, PillowWriter

    ax = plot_snapshot(patch, field, len(field.times) // 2, site)
    dots, title = ax.collections[0], ax.get_legend().get_title()

    def show(frame):
        distance = _distance(field, frame)
        dots.set_array(distance)
        dots.set_clim(0, distance.max() or 1)
        title.set_text(_moment(patch, field, frame))

    moving = FuncAnimation(ax.figure, show, frames=range(1, len(field.times)))  # pyright: ignore[reportArgumentType]  no subfigure
    moving.save(path, writer=PillowWriter(fps=8), dpi=120)


def _distance(field, frame):
    return np.linalg.norm(field.displacements[frame], axis=1) / units.m


def _moment(patch, field, frame):
    return f'{patch.calc.parameters.model} model, {field.times[frame] / units.s:.3f} s after the start'
