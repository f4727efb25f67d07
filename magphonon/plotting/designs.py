"""Pictures of a structure in which every magnet was designed: its parts in colour, the convergence of the design, and the
tolerance of each part.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..stiffness.rest import freedom
from .axes import COLOURS, in_house_style, legend_of_set, letter_panels, new_axes, panels
from .structures import SIZE, draw_particles, frame, halo, spacing

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..response.frf import Dof

WIDE = 2.2  # diameter of a particle that is coloured, in that of one that is not


@in_house_style
def plot_sites(atoms: Atoms, values: ArrayLike, label: str, places: Mapping[str, Dof] | None = None, *,
               ax: Axes | None = None, **look: Any) -> Axes:
    """Draw one number for each site in colour, grey if it is not known, and the names of some places.

    Parameters
    ----------
    atoms : ase.Atoms
        A structure with its MagneticRepulsion.
    values : array_like, shape (particles,)
    label : str
        Label of the colour bar, with the unit.
    places : mapping of str to Dof, optional
        Places to be named in the picture.
    ax : matplotlib.axes.Axes, optional
    **look
        Properties of matplotlib's collections, such as `cmap` or `norm`.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.plotting import plot_sites
    >>> patch = read_scene('ideal').patch_atoms()
    >>> ax = plot_sites(patch, patch.calc.strengths, 'strength')
    """
    ax = new_axes(height=3.0) if ax is None else ax
    X, values = atoms.positions[:, :2] / units.m, np.asarray(values, float)
    known = np.isfinite(values)
    draw_particles(ax, X[~known], WIDE * SIZE * spacing(atoms), facecolors='0.85', edgecolors='none')
    dots = draw_particles(ax, X[known], WIDE * SIZE * spacing(atoms), **{'cmap': 'viridis', 'linewidths': 0} | look)
    dots.set_array(values[known])
    for name, place in (places or {}).items():
        x, y = X[place.particle]
        ax.text(x, y, name, ha='center', va='center', fontsize='small', path_effects=halo(2), zorder=4)
    frame(ax, X, spacing(atoms))
    ax.figure.colorbar(dots, ax=ax, label=label, shrink=0.8, pad=0.02)
    return ax


@in_house_style
def plot_design(atoms: Atoms, places: Mapping[str, Dof] | None = None, *, axes: NDArray[Any] | None = None) -> NDArray[Any]:
    """Draw the strength of every magnet and the stiffness of every pillar, in two panels; held magnets have no pillar.

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.plotting import plot_design
    >>> axes = plot_design(read_scene('ideal').patch_atoms())
    """
    row: Any = panels(1, 2, height=2.6)[1][0] if axes is None else axes
    calc, free = atoms.calc, freedom(atoms)[0]
    springs = np.broadcast_to(calc.foundation, (len(atoms), calc.dim))[:, 0] / (units.N / units.m)
    plot_sites(atoms, calc.strengths, 'strength', places, ax=row[0])
    plot_sites(atoms, np.where(free, springs, np.nan), 'stiffness of the pillar (N/m)', places, ax=row[1], cmap='cividis')
    row[1].set_ylabel('')
    row[1].tick_params(labelleft=False)
    letter_panels(row)
    return row


@in_house_style
def plot_convergence(histories: Mapping[str, ArrayLike], label: str, *, ax: Axes | None = None) -> Axes:
    """Draw the convergence of designs: the best value so far at each evaluation.

    Examples
    --------
    >>> from magphonon.plotting import plot_convergence
    >>> ax = plot_convergence({'complete': [0.0, 20.0, 31.0]}, 'contrast (dB)')
    """
    ax = new_axes(height=2.4) if ax is None else ax
    for (name, history), colour in zip(histories.items(), COLOURS, strict=False):
        known = np.where(np.isfinite(np.asarray(history, float)), history, np.nan)
        ax.plot(1 + np.arange(len(known)), known, color=colour, label=name)
    ax.set(xlabel='evaluations', ylabel=label)
    if len(histories) > 1:
        ax.legend(frameon=False)
    return ax


@in_house_style
def plot_levels(frequencies_Hz: ArrayLike, levels: Mapping[str, Mapping[str, ArrayLike]],
                marks: ArrayLike = ()) -> NDArray[Any]:
    """Draw displacement per force as a function of frequency at several places, one panel for each state, on one scale.

    Parameters
    ----------
    frequencies_Hz : array_like
    levels : mapping of str to mapping of str to array_like
        Levels by state, such as 'before', and by place, in mm/N.
    marks : array_like
        Frequencies in Hz to be marked.

    Examples
    --------
    >>> from magphonon.plotting import plot_levels
    >>> axes = plot_levels([50, 60], {'before': {'A': [1, 2]}, 'designed': {'A': [2, 8]}}, marks=[60])
    """
    figure, found = panels(1, len(levels), height=2.6)
    row: Any = found[0]
    letter_panels(row, list(levels))
    for ax, each in zip(row, levels.values(), strict=True):
        for (name, h), colour in zip(each.items(), COLOURS, strict=False):
            ax.semilogy(frequencies_Hz, h, color=colour, label=name)
        for mark in np.ravel(marks):
            ax.axvline(mark, color='0.7', linewidth=0.8, zorder=0)
        ax.set(xlabel='frequency (Hz)')
    ends = np.array([ax.get_ylim() for ax in row])
    for ax in row:
        ax.set_ylim(ends.min(), ends.max())
    row[0].set_ylabel('displacement per force (mm/N)')
    for ax in row[1:]:
        ax.tick_params(labelleft=False)
    legend_of_set(figure)
    return row
