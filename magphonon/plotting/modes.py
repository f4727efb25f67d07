"""Mode shapes drawn on their lattice or patch, and how far the modes of a patch extend."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units
from .axes import COLOURS, in_house_style, label_frequencies, label_places, legend_above, legend_of_set, new_axes, point_name
from .bands import mode_names
from .structures import FREE, SIZE, draw_bonds, draw_particles, frame, in_cells, mark_defects, seen_about, spacing, window

if TYPE_CHECKING:
    from matplotlib.axes import Axes

    from ..bands.bands import Bands
    from ..response.normal_modes import Localisation

ROUND_OFF = 1e-6  # difference of equal frequencies, as a fraction of the highest: the square root of a rounded eigenvalue
ARROW = 0.39  # longest arrow of a mode shape of a lattice in bond lengths
# Of a mode of a patch: the longest arrow in bond lengths, and the fraction of it below which no arrow is drawn.
LONG_ARROW, STILL = 1.4, 0.03


@in_house_style
def plot_mode(atoms: Atoms, bands: Bands, q: str | int, mode: int, *, ax: Axes | None = None) -> Axes:
    """Draw the shape of a mode: particles at rest, their orbits, and their displacements when the largest one occurs.

    Modes of equal frequency can be combined arbitrarily; one combination is drawn and labelled degenerate.

    Parameters
    ----------
    atoms : ase.Atoms
        One cell of a planar lattice with its PairCalculator.
    bands : Bands
        Bands of these atoms, with modes (`vectors=True`).
    q : str or int
        Name of a special point on the path, or index of a wavevector of the path.
    mode : int
        Number of the branch by ascending frequency, counted from 0 here and from 1 in the picture.
    ax : matplotlib.axes.Axes, optional

    Examples
    --------
    >>> from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices
    >>> from magphonon.plotting import plot_mode
    >>> cell = lattices.triangular(1.0, 1.0)
    >>> cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    >>> bands = analytic_bands(cell, cell.cell.bandpath('GMKG', npoints=50, pbc=cell.pbc), vectors=True)
    >>> ax = plot_mode(cell, bands, 'M', 0)
    """
    from matplotlib.collections import LineCollection

    if bands.vectors is None:
        raise ValueError('these bands were computed without modes; compute them with vectors=True')
    where = _wavevector(bands.path, q)
    if not 0 <= mode < bands.omega.shape[1]:
        raise ValueError(f'mode must be 0 to {bands.omega.shape[1] - 1}, not {mode!r}')
    own = ax is None
    ax = new_axes(height=3.8) if ax is None else ax
    half, cells = window(atoms)
    u = bands.vectors[where, mode] / np.sqrt(atoms.get_masses())[:, None]
    largest = u.flat[abs(u).argmax()]  # drawn in the phase where it is real
    u = u * largest.conj() / abs(largest) * np.exp(2j * np.pi * cells @ bands.path.kpts[where])[:, None, None]
    u *= ARROW * spacing(atoms) / abs(u).max()  # of the longest orbit
    inside = (abs(in_cells(atoms, cells)) <= half - ARROW * spacing(atoms)).all(axis=-1)  # with their whole orbit
    rest, u = in_cells(atoms, cells)[inside], u[inside]

    draw_bonds(ax, atoms, cells)
    turn = np.exp(1j * np.linspace(0, 2 * np.pi, 49))
    orbits = rest[:, None, :] + (u[:, None, :] * turn[:, None]).real
    ax.add_collection(LineCollection(list(orbits), colors='0.55', linewidths=0.8, zorder=2, label='orbit'))
    draw_particles(ax, rest, 0.6 * SIZE * spacing(atoms), zorder=3, **FREE)
    ax.quiver(*rest.T, *u.real.T, color=COLOURS[0], angles='xy', scale_units='xy', scale=1, width=0.007, zorder=4)
    ax.plot([], [], linestyle='', marker=r'$\rightarrow$', markersize=10, color=COLOURS[0], label='displacement')
    title = f'{_printed_wavevector(bands.path, where)}, branch {mode + 1}\n{_printed_frequency(bands, where, mode)}'
    ax.set_title(title, loc='left')
    ax.set(xlim=(-half, half), ylim=(-half, half), aspect='equal')
    label_places(ax, spacing(atoms))
    if own:
        legend_of_set(ax.figure)  # pyright: ignore[reportArgumentType]  no subfigure
    return ax


@in_house_style
def plot_shape(atoms: Atoms, shape: NDArray[np.float64], *, ax: Axes | None = None, title: str = '',
               centre: ArrayLike | None = None, defects: ArrayLike = ()) -> Axes:
    """Draw the shape of a mode of a patch: an arrow on every particle; darker particles have more of the kinetic energy.

    For a complex mode the orbits are drawn too, and the arrows are the displacements when the largest one occurs.

    Parameters
    ----------
    atoms : ase.Atoms
        A planar structure with its PairCalculator, at rest.
    shape : ndarray, shape (particles, dim)
        A row of `Modes.shapes`; real or complex.
    ax : matplotlib.axes.Axes, optional
    title : str
    centre : array_like, shape (2,), optional
        Position in mm about which a periodic structure is drawn; by default the particle with the most energy.
    defects : array_like, shape (defects, 2), optional
        Positions in mm to be marked by a cross.
    """
    from matplotlib.collections import LineCollection

    ax = new_axes(height=3.4) if ax is None else ax
    share = atoms.get_masses() * (abs(shape) ** 2).sum(axis=1)
    # a local mode at the border of a periodic patch would be drawn in pieces
    seen = seen_about(atoms, atoms.positions[share.argmax(), :2] if centre is None else centre)
    rest = seen.positions[:, :2] / units.m
    length = np.linalg.norm(shape, axis=1)
    moving = length > STILL * length.max()
    arrows = LONG_ARROW * spacing(atoms) / length.max() * shape[moving, :2]
    dots = draw_particles(ax, rest, 0.8 * spacing(atoms), cmap='Greys', edgecolors='0.55', linewidths=0.4)
    dots.set_array(share / share.sum())
    dots.set_clim(0, (share / share.sum()).max())
    if np.iscomplexobj(arrows):
        largest = arrows.flat[abs(arrows).argmax()]  # drawn in the phase where it is real
        orbits = (arrows[:, None] * np.exp(-1j * np.linspace(0, 2 * np.pi, 49))[:, None] * abs(largest) / largest).real
        ax.add_collection(LineCollection(list(rest[moving][:, None] + orbits), colors='0.35', linewidths=0.6, zorder=2.5))
        arrows = orbits[:, 0]
    ax.quiver(*rest[moving].T, *arrows.T, color=COLOURS[1], angles='xy', scale_units='xy', scale=1, width=0.006, zorder=3)
    ax.set_title(title, loc='left')
    mark_defects(ax, seen, defects)
    frame(ax, np.concatenate([rest, rest[moving] + arrows]), spacing(atoms))
    return ax


@in_house_style
def plot_extents(extent: Localisation, *, ax: Axes | None = None, bands: Sequence[tuple[float, float]] = ()) -> Axes:
    """Draw the number of particles that take part in each mode, against its frequency; bands of the lattice are shaded.

    Parameters
    ----------
    extent : Localisation
    ax : matplotlib.axes.Axes, optional
    bands : sequence of (low, high)
        Ranges of angular frequency in rad/ms.
    """
    own = ax is None
    ax = new_axes() if ax is None else ax
    for k, (low, high) in enumerate(bands):
        name = None if k else 'bands of the lattice'
        ax.axvspan(units.hertz(low), units.hertz(high), color='0.9', linewidth=0, zorder=0, label=name)
    dots: dict[str, Any] = {'color': COLOURS[0], 'markersize': 2.5, 'markerfacecolor': 'none'}
    ax.plot(extent.frequencies_Hz, extent.participation, 'o', label='modes', **dots)
    label_frequencies(ax.xaxis)
    ax.set(ylabel='particles that take part', yscale='log', ylim=(0.8, 1.5 * extent.participation.max()))
    if own:
        legend_above(ax)
    return ax


def _wavevector(path, q):
    if isinstance(q, str):
        if q not in path.special_points:
            raise ValueError(f'the path has no special point {q!r}; it has {", ".join(path.special_points)}')
        distance = abs(path.kpts - path.special_points[q]).max(axis=1)
        if distance.min() > 1e-6:
            raise ValueError(f'the path {path.path} does not pass through {q}; choose a path that does')
        return distance.argmin()
    if not 0 <= q < len(path.kpts):
        raise ValueError(f'q must be the name of a special point or an index from 0 to {len(path.kpts) - 1}, not {q!r}')
    return q


def _printed_wavevector(path, where):
    for name, point in path.special_points.items():
        if abs(path.kpts[where] - point).max() < 1e-6:
            return point_name(name)
    return '$q$ = ({:.3g}, {:.3g})'.format(*path.kpts[where])


def _printed_frequency(bands, where, mode):
    if bands.omega[where, mode] < 0:
        return f'unstable, grows at {-bands.omega[where, mode] * units.s:.4g} 1/s'
    others = np.delete(bands.omega[where], mode)
    degenerate = abs(others - bands.omega[where, mode]).min(initial=np.inf) < ROUND_OFF * abs(bands.omega).max()
    polarisation = 'degenerate' if degenerate else mode_names(bands)[where, mode]
    return f'{bands.frequencies_Hz[where, mode]:.4g} Hz' + (f', {polarisation}' if polarisation else '')
