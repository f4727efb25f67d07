"""Pictures of particles at rest: a lattice with its primitive vectors, and a patch with its held rim, its source and its row."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import product
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import finite
from ..stiffness.repulsion import repulsion_of
from ..stiffness.rest import freedom
from .axes import COLOURS, in_house_style, label_places, legend_above, new_axes

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.collections import EllipseCollection

    from ..waves.wave_source import BurstSetup

WINDOW = 2.4  # half the window on a lattice, in lattice constants
REACH = 5  # number of cells to each side that fill this window
FINE = 45  # width of a patch in bond lengths from which its particles are dots
MANY = 1000  # particles, beyond which they are drawn as pixels
SIZE = 0.36  # diameter of a particle in lengths of the shortest bond
FREE: dict[str, Any] = {'facecolors': 'white', 'edgecolors': '0.25'}
HELD: dict[str, Any] = {'facecolors': '0.6', 'edgecolors': '0.25'}


@in_house_style
def plot_lattice(atoms: Atoms, *, ax: Axes | None = None) -> Axes:
    """Draw a planar lattice around one of its cells, with its bonds and its primitive vectors.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell with its PairCalculator.
    ax : matplotlib.axes.Axes, optional

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.plotting import letter_panels, panels, plot_lattice, plot_zone
    >>> from magphonon.plotting.axes import print_style
    >>> scene = read_scene('prototype')
    >>> with print_style():
    ...     figure, ((left, right),) = panels(1, 2, height=3.0)
    ...     _ = plot_lattice(scene.atoms(), ax=left), plot_zone(scene.band_path(), ax=right)
    ...     letter_panels([left, right])
    """
    ax = new_axes(height=3.2) if ax is None else ax
    half, cells = window(atoms)
    places = in_cells(atoms, cells)
    draw_bonds(ax, atoms, cells)
    near = (abs(places) < half + spacing(atoms)).all(axis=-1)
    first = atoms.positions[0, :2] / units.m
    corners = first + np.array([[0, 0], [1, 0], [1, 1], [0, 1]]) @ atoms.cell.array[:2, :2] / units.m
    ax.fill(*corners.T, facecolor=COLOURS[6], alpha=0.35, linewidth=0, zorder=1)
    draw_particles(ax, places[near], SIZE * spacing(atoms), **FREE)
    for k, R in enumerate(atoms.cell.array[:2, :2] / units.m, start=1):
        draw_arrow(ax, first, first + R, f'$R_{k}$')
    ax.set(xlim=(-half, half), ylim=(-half, half), aspect='equal')
    label_places(ax, spacing(atoms))
    return ax


@in_house_style
def plot_patch(patch: Atoms, site: BurstSetup | None = None, *, ax: Axes | None = None) -> Axes:
    """Draw a planar structure with its bonds: squares for held particles, circles for those that move.

    Parameters
    ----------
    patch : ase.Atoms
        With its PairCalculator.
    site : BurstSetup, optional
        Where a burst enters and where it is measured; triangles and a line of filled circles mark it.
    ax : matplotlib.axes.Axes, optional

    Examples
    --------
    >>> from magphonon import read_scene
    >>> from magphonon.plotting import plot_patch
    >>> from magphonon.waves import burst_setup
    >>> scene = read_scene('ideal')
    >>> patch = scene.patch_atoms()
    >>> ax = plot_patch(patch, burst_setup(scene.atoms(), patch, scene.burst.source))
    """
    from matplotlib.collections import PolyCollection

    ax = new_axes(height=3.2) if ax is None else ax
    rest, diameter = patch.positions[:, :2] / units.m, SIZE * spacing(patch)
    fine = np.ptp(rest, axis=0).max() > FINE * spacing(patch)  # bonds and edges would turn it grey
    if not fine:
        draw_bonds(ax, patch)
    held = ~freedom(patch)[0]
    draw_particles(ax, rest[~held], diameter, **({'facecolors': '0.8', 'edgecolors': 'none'} if fine else FREE))
    squares = rest[held][:, None] + diameter / 2 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    ax.add_collection(PolyCollection(list(squares), linewidths=0.5, zorder=2, **HELD))
    handles = [_mark('o', *(('0.8', '0.8') if fine else ('white', '0.25')), 'free')]
    handles += [_mark('s', '0.6', '0.25', 'held')] * bool(held.any())
    if site is not None:
        draw_particles(ax, rest[site.row], diameter, facecolors=COLOURS[0], edgecolors=COLOURS[0])
        draw_particles(ax, rest[site.driven], 1.5 * diameter, facecolors=COLOURS[1], edgecolors=COLOURS[1])
        handles += [_mark('o', COLOURS[1], COLOURS[1], 'driven'), _mark('o', COLOURS[0], COLOURS[0], 'measured')]
    frame(ax, rest, spacing(patch))
    legend_above(ax, handles=handles, ncols=len(handles), handletextpad=0.1)
    return ax


def spacing(atoms: Atoms) -> float:
    """Length of the shortest bond in m."""
    return repulsion_of(atoms).bonds.lengths.min() / units.m


def window(atoms: Atoms) -> tuple[float, NDArray[np.int_]]:
    """Half the width in m of the part of a lattice that is drawn, and the cells that fill it, shape (cells, 3)."""
    cells = np.array(list(product(range(-REACH, REACH + 1), range(-REACH, REACH + 1), (0,))))
    return WINDOW * atoms.cell.lengths()[:2].min() / units.m, cells


def in_cells(atoms: Atoms, cells: ArrayLike) -> NDArray[np.float64]:
    """Positions of the particles in some cells in m, shape (cells, particles, 2)."""
    return ((np.asarray(cells) @ atoms.cell.array)[:, None] + atoms.positions)[..., :2] / units.m


def seen_about(atoms: Atoms, centre: ArrayLike | None) -> Atoms:
    """A copy of a periodic structure with every particle at its image in the cell about `centre` (mm, shape (2,))."""
    seen = atoms.copy()
    seen.calc = atoms.calc
    if centre is not None and atoms.pbc.any():
        place = np.append(finite('centre', centre, (2,)), atoms.positions[0, 2])
        seen.wrap(center=atoms.cell.scaled_positions(place))
    return seen


def mark_defects(ax: Axes, seen: Atoms, defects: ArrayLike) -> None:
    """Draw crosses at positions in mm, each moved into the cell in which the particles of `seen` are drawn."""
    places = np.reshape(np.asarray(defects, float), (-1, 2))
    if not len(places):
        return
    there = Atoms(positions=np.pad(places, ((0, 0), (0, 1))), cell=seen.cell, pbc=seen.pbc)
    if seen.pbc.any():
        there.wrap(center=seen.cell.scaled_positions(seen.positions.mean(axis=0)))
    ax.plot(*there.positions[:, :2].T / units.m, 'x', color=COLOURS[3], markersize=6, label='defect')


def draw_bonds(ax: Axes, atoms: Atoms, cells: ArrayLike = ((0, 0, 0),)) -> None:
    """Draw bonds at rest as grey lines, in the given cells."""
    from matplotlib.collections import LineCollection

    bonds, places = repulsion_of(atoms).bonds, in_cells(atoms, cells)
    starts = places[:, bonds.i]
    ends = np.stack([starts, starts + bonds.vectors[:, :2] / units.m], axis=-2)
    ax.add_collection(LineCollection(list(ends.reshape(-1, 2, 2)), colors='0.8', linewidths=0.6, zorder=1))


def draw_particles(ax: Axes, places: ArrayLike, diameter: float, **look: Any) -> EllipseCollection:
    """Draw circles of a `diameter` in m at positions in m; they keep their size relative to the bonds on every scale.

    Thousands of them are pixels even in a PDF, which would take long to write and to open.
    """
    from matplotlib.collections import EllipseCollection

    places = np.reshape(places, (-1, 2))
    size = np.full(len(places), diameter)
    dots = EllipseCollection(size, size, np.zeros(len(places)), units='xy', offsets=places, offset_transform=ax.transData,
                             **{'linewidths': 0.5, 'zorder': 2, 'rasterized': len(places) > MANY} | look)
    ax.add_collection(dots)
    return dots


def draw_arrow(ax: Axes, start: Sequence[float] | NDArray[np.float64], end: ArrayLike, text: str, colour: str = 'black') -> None:
    """Draw an arrow with its name beyond its head."""
    (x, y), ahead = np.asarray(end), np.subtract(end, start)
    ahead = 9 * ahead / np.linalg.norm(ahead)  # points
    look = {'arrowstyle': '-|>', 'color': colour, 'linewidth': 1.2, 'shrinkA': 0, 'shrinkB': 0, 'mutation_scale': 8}
    ax.annotate('', (x, y), (start[0], start[1]), arrowprops=look, zorder=5)
    ax.annotate(text, (x, y), xytext=(ahead[0], ahead[1]), textcoords='offset points', ha='center', va='center', color=colour,
                zorder=6, path_effects=halo(2))


def halo(width: float) -> list[Any]:
    """A path effect that puts white around letters, so that they can be read on lines."""
    from matplotlib.patheffects import withStroke

    return [withStroke(linewidth=width, foreground='white')]


def frame(ax: Axes, places: NDArray[np.float64], room: float) -> None:
    """Set axes of x and y around positions in m, with a margin `room`, the distance of two neighbours."""
    (left, low), (right, high) = places.min(axis=0) - 0.6 * room, places.max(axis=0) + 0.6 * room
    ax.set(xlim=(left, right), ylim=(low, high), aspect='equal')
    label_places(ax, room)


def _mark(marker, face, edge, name):
    from matplotlib.lines import Line2D

    return Line2D([], [], linestyle='', marker=marker, markersize=5, markerfacecolor=face, markeredgecolor=edge, label=name)
