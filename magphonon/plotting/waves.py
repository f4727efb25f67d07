"""Wavenumber-frequency maps over the bands, and snapshots of waves, drawn in SI on matplotlib axes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from itertools import zip_longest
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import NDArray

from .. import units
from .axes import (
    COLOURS,
    PREFIXES,
    COLUMN_in,
    PAGE_in,
    in_house_style,
    label_frequencies,
    legend_above,
    legend_of_set,
    letter_panels,
    new_axes,
    panels,
    prefix_power,
)
from .structures import draw_particles, frame, spacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import EllipseCollection
    from matplotlib.figure import Figure

    from ..dynamics.motion import Motion
    from ..stiffness.matrices import Model
    from ..waves.wave_analysis import Wave
    from ..waves.wave_source import BurstRecord, BurstSetup

FLOOR_dB = -40  # lowest power shown in a map, in decibels relative to the strongest
LINES: dict[Model, tuple[str, str]] = {'complete': (COLOURS[0], '-'), 'conventional': (COLOURS[1], '--')}
MARGIN = 1.4  # ratio of the upper end of a map to the highest frequency that it shows
POWER = 'power (dB)'
BESIDE_in = 0.9  # room for names, legend and colour bar beside panels whose sides are equal lengths
SATURATED = 0.02  # share of the particles, those next to the source, that are beyond the scale of a picture of crests


@in_house_style
def plot_wave(wave: Wave, *, ax: Axes | None = None) -> Axes:
    """Draw a wavenumber-frequency map, with the branches of both models and the ridge over it.

    Parameters
    ----------
    wave : Wave
        Its ridge is drawn as circles with their uncertainty.
    ax : matplotlib.axes.Axes, optional

    Examples
    --------
    >>> import numpy as np
    >>> from magphonon import InversePower, MagneticRepulsion, lattices
    >>> from magphonon.plotting import plot_wave
    >>> from magphonon.dynamics import Motion
    >>> from magphonon.waves import waves
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> t, x = np.arange(0, 80, 0.5), np.arange(24)
    >>> s = t[:, None] - x / 0.6  # the time since a pulse passed
    >>> u = np.exp(-(((s - 20) / 8) ** 2)) * np.cos(0.5 * s)
    >>> ax = plot_wave(waves(Motion(t, x, np.stack([1e-3 * u, 0 * u], axis=2)), cell, 'row')[0])
    """
    ax = new_axes() if ax is None else ax
    image = _draw_map(ax, wave, _top(wave))
    ax.figure.colorbar(image, ax=ax, label=POWER)
    legend_above(ax, ncols=2, title=f'{wave.motion} motion')  # no wider than the axes, beside which is the bar
    return ax


@in_house_style
def plot_waves(table: Sequence[Sequence[Wave | None]], names: Sequence[str] = (),
               carriers_Hz: Sequence[float] = ()) -> tuple[Figure, NDArray[np.object_]]:
    """Draw a set of wavenumber-frequency maps on equal axes, with letters, one legend and one colour bar.

    Parameters
    ----------
    table : sequence of sequence of Wave
        Each inner sequence is one row of panels; None gives an empty panel with its name and a note that the wave is too weak.
    names : sequence of str, optional
        Names of the panels, row by row.
    carriers_Hz : sequence of float, optional
        Carrier of the burst in each row, drawn as a dotted line.

    Returns
    -------
    matplotlib.figure.Figure
    ndarray of matplotlib.axes.Axes, shape (rows, columns)
        The panels; call `legend_of_set` again after drawing more on them.
    """
    figure, axes = panels(len(table), len(table[0]), height=2.3)
    letter_panels(axes, names)
    shown = np.array([[wave is not None for wave in row] for row in table])
    top, image = max(_top(wave) for row in table for wave in row if wave), None
    for row, line, carrier in zip_longest(axes, table, carriers_Hz):
        for ax, wave in zip(row, line, strict=True):
            if wave is None:
                ax.text(0.5, 0.5, 'too weak to be shown', color='0.35', ha='center', va='center', transform=ax.transAxes)
                ax.set_axis_off()
                continue
            image = _draw_map(ax, wave, top)
            if carrier is not None:
                ax.axhline(carrier, color='0.3', linestyle=':', linewidth=0.9, label='carrier')
    _label_outer(axes, shown)
    if image is not None:
        figure.colorbar(image, ax=axes[:, -1], label=POWER, pad=0.02, aspect=30)  # each parent measures it again
    legend_of_set(figure, ncols=4)
    return figure, axes


def _label_outer(axes, shown):
    """Label the x axis of a panel only if no panel is below it, and the y axis only if none is to the left of it."""
    for (row, column), ax in np.ndenumerate(axes):
        if shown[row + 1 :, column].any():
            ax.set_xlabel('')
            ax.tick_params(labelbottom=False)
            ax.xaxis.set_in_layout(False)  # which would measure every tick
        if shown[row, :column].any():
            ax.set_ylabel('')
            ax.tick_params(labelleft=False)
            ax.yaxis.set_in_layout(False)


def _top(wave):
    spectrum = wave.spectrum
    lit = spectrum.omega[spectrum.power.max(axis=1) > 10 ** (FLOOR_dB / 20) * spectrum.peak].max()  # also if all run backwards
    return min(MARGIN * lit, spectrum.omega[-1])


def draw_power(ax: Axes, x: NDArray[np.float64], y: NDArray[np.float64], power: NDArray[np.float64]) -> Any:
    """Draw a power, shape (y, x), in units of the strongest, as a grey map in decibels; returns the image."""
    with np.errstate(divide='ignore'):
        dB = 10 * np.log10(power)
    return ax.pcolormesh(x, y, dB.clip(FLOOR_dB), cmap='Greys', vmin=FLOOR_dB, vmax=0, shading='nearest', rasterized=True)


def _draw_map(ax, wave, top):
    """Draw the map up to the frequency `top` in rad/ms, with its branches and its ridge; returns the image."""
    spectrum, forward = wave.spectrum, wave.spectrum.xi >= 0
    shown = spectrum.omega <= top
    image = draw_power(ax, spectrum.xi[forward], units.hertz(spectrum.omega[shown]),
                       spectrum.power[np.ix_(shown, forward)] / spectrum.peak)
    for (model, name), branch in wave.branches.items():
        colour, line = LINES[model]
        ax.plot(branch.xi, units.hertz(branch.omega), line, color=colour, label=model if name == 'shear' else None)
    if wave.ridge:
        ridge = wave.ridge
        ax.errorbar(ridge.xi, units.hertz(ridge.omega), units.hertz(ridge.sigma_omega), ridge.sigma_xi, fmt='o', color=COLOURS[3],
                    markerfacecolor='white', linewidth=0.9, label='ridge')
    ax.set(xlabel=r'phase per step $\xi = k\cdot R_2$ (rad)', xlim=(0, np.pi), ylim=(0, units.hertz(top)))
    label_frequencies(ax.yaxis)
    ax.set_xticks(np.pi * np.arange(5) / 4, ['0', 'π/4', 'π/2', '3π/4', 'π'])
    return image


@in_house_style
def plot_snapshot(patch: Atoms, field: Motion, frame: int, site: BurstSetup, *, ax: Axes | None = None) -> Axes:
    """Draw all particles of a patch at one time: crests and troughs of their motion, with the source and the recorded row.

    Parameters
    ----------
    patch : ase.Atoms
        Structure whose calculator stores the rest positions.
    field : Motion
        The motion of all particles of the patch.
    frame : int
    site : BurstSetup
    ax : matplotlib.axes.Axes, optional

    Returns
    -------
    matplotlib.axes.Axes
        Particles are coloured by the component u_x or u_y with most of the motion in all frames, so that all frames of one run
        can be compared. The scale is symmetric about zero.
    """
    ax = new_axes(height=_height(patch, COLUMN_in - BESIDE_in)) if ax is None else ax
    axis = main_axis(field.displacements)
    crests = field.displacements[frame, :, axis]
    dots, power = draw_crests(ax, patch, crests, visible([crests]))
    mark_site(ax, patch, site)
    bar_of_crests(dots, ax, axis, power)
    legend_above(ax, ncols=2, title=f'{patch.calc.parameters.model} model, {field.times[frame] / units.s:.3f} s after the start')
    return ax


@in_house_style
def plot_crossing(passages: Mapping[str, tuple[Atoms, BurstSetup, BurstRecord]]) -> Figure:
    """Draw a burst in several simulations on one colour scale, at the time at which it has reached the middle of the row in the
    first of them.

    Parameters
    ----------
    passages : mapping
        Patch, `BurstSetup` and `BurstRecord` of each simulation, by its name.
    """
    frame = min(crossing(passage) for *_, passage in passages.values())
    fields = {name: passage.field for name, (*_, passage) in passages.items()}
    axis = main_axis(np.concatenate([field.displacements[frame] for field in fields.values()]))
    shown = {name: field.displacements[frame, :, axis] for name, field in fields.items()}
    patch = next(iter(passages.values()))[0]
    figure, axes = panels(1, len(passages), height=_height(patch, (PAGE_in - BESIDE_in) / len(passages)))
    when = np.mean([field.times[frame] for field in fields.values()]) / units.s  # their steps differ by some percent
    letter_panels(axes, [f'{name}, {when:.2g} s' for name in fields])
    largest = visible(list(shown.values()))
    for ax, (name, (patch, site, _)) in zip(axes.ravel().tolist(), passages.items(), strict=True):
        dots, power = draw_crests(ax, patch, shown[name], largest)
        mark_site(ax, patch, site)
    bar_of_crests(dots, axes, axis, power, pad=0.02, shrink=0.8)
    _label_outer(axes, np.ones(axes.shape, bool))
    legend_of_set(figure)
    return figure


def crossing(passage: BurstRecord) -> int:
    """Index of the frame of the whole patch when the particle in the middle of the row is displaced most."""
    u = np.linalg.norm(passage.row.displacements[:, len(passage.row.particles) // 2], axis=1)
    return int(abs(passage.field.times - passage.row.times[u.argmax()]).argmin())


def _height(patch, width):
    wide, high = np.ptp(patch.calc.reference.positions[:, :2], axis=0)
    return BESIDE_in + width * min(1.2, high / wide)


def main_axis(displacements: NDArray[np.float64]) -> int:
    """Number of the axis along which displacements, shape (..., dim), are largest on the whole."""
    flat = displacements.reshape(-1, displacements.shape[-1])
    return int(np.einsum('ix,ix->x', flat, flat).argmax())


def visible(crests: Sequence[NDArray[np.float64]] | NDArray[np.float64]) -> float:
    """Half the range in mm of a colour scale on which particles can be distinguished, except those next to the source."""
    seen = max(np.quantile(abs(u), 1 - SATURATED) for u in crests)
    return float(seen or max(abs(u).max() for u in crests) or 1.0)


def draw_crests(ax: Axes, patch: Atoms, crests: NDArray[np.float64], largest: float,
                diameter: float = 0.95) -> tuple[EllipseCollection, int]:
    """Draw particles coloured by displacement on a scale up to `largest`, in mm; returns the dots and the power of their unit."""
    power = prefix_power(largest / units.m)
    dots = draw_particles(ax, patch.positions[:, :2] / units.m, diameter * spacing(patch), linewidths=0, cmap='RdBu_r')
    dots.set_array(crests / units.m / 10.0**power)
    dots.set_clim(*(np.array([-1, 1]) * largest / units.m / 10.0**power))
    frame(ax, patch.positions[:, :2] / units.m, spacing(patch))
    return dots, power


def mark_site(ax: Axes, patch: Atoms, site: BurstSetup) -> None:
    """Mark the recorded row and the driven particles."""
    rest = patch.positions[:, :2] / units.m
    ax.plot(*rest[site.row].T, '--', color='black', linewidth=0.9, label='row')
    ax.plot(*rest[site.driven].T, '^', color=COLOURS[3], markersize=4, label='driven')


def bar_of_crests(dots: EllipseCollection, axes: Any, axis: int, power: int, **options: Any) -> None:
    """Add the colour bar for displacements along an axis of the structure."""
    label = f'displacement $u_{"xyz"[axis]}$ ({PREFIXES[power]}m)'
    np.ravel(axes)[0].figure.colorbar(dots, ax=axes, label=label, extend='both', **options)
