"""Motion of a structure as a film, on one scale from the first frame to the last."""

from __future__ import annotations

import os
from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import numpy as np
from ase import Atoms
from numpy.typing import ArrayLike, NDArray

from .. import units
from ..errors import finite
from ..stiffness.repulsion import repulsion_of
from .axes import new_figure
from .structures import draw_bonds, frame, mark_defects, seen_about, spacing
from .waves import bar_of_crests, draw_crests, main_axis, mark_site, visible

if TYPE_CHECKING:
    from ..waves.wave_source import BurstSetup

LONGEST = 0.35  # largest displacement in a film, as a fraction of the shortest bond
DOT = 0.6  # diameter of a particle in lengths of the shortest bond
FRAMES = 24  # frames of one period of a mode
PER_SECOND = 12


def mode_frames(shape: ArrayLike, amplitude: float = 1.0) -> NDArray[np.float64]:
    """One period of a mode, as an argument of `animate`: the displacements `Re shape e^{-2 pi i t/T}`, shape (frames, particles,
    dim).

    Parameters
    ----------
    shape : array_like, shape (particles, dim)
        Shape of the mode in any unit, such as a row of `Modes.shapes`.
    amplitude : float
        Largest displacement of a particle in mm.
    """
    shape = np.asarray(shape) if np.iscomplexobj(shape) else finite('shape', shape)
    largest = np.linalg.norm(shape, axis=-1).max()
    if not largest:
        raise ValueError('the shape moves nothing; choose a mode')
    return np.real(np.multiply.outer(np.exp(-2j * np.pi * np.arange(FRAMES) / FRAMES), shape * amplitude / largest))


def _moving(films, particles):
    """Displacements of all films, shape (films, frames, particles, 2 or 3), and the largest of them."""
    u = np.array([finite('displacements', film) for film in films.values()])
    if u.ndim != 4 or u.shape[2] != particles or u.shape[3] not in (2, 3):
        raise ValueError(f'displacements must have the shape (frames, {particles}, 2 or 3), not {u.shape[1:]}')
    largest = max(np.linalg.norm(moment, axis=1).max() for film in u for moment in film)
    if not largest:
        raise ValueError('nothing moves in any frame; there is nothing to film')
    return u, largest


def animate(path: str | PathLike[str], atoms: Atoms, displacements: ArrayLike | Mapping[str, ArrayLike],
            times: ArrayLike | None = None, *, title: str = '', site: BurstSetup | None = None,
            centre: ArrayLike | None = None, defects: ArrayLike = ()) -> float:
    """Write a film of moving particles, with the same scale in every frame and the magnification in the title.

    Particles are coloured by their displacement along the axis with most of the motion. A wave needs at least 12 frames per
    period, or its crests seem to run backwards.

    Parameters
    ----------
    path : path-like
        Ends in `.gif`.
    atoms : ase.Atoms
        A planar structure with its PairCalculator, at the positions from which displacements are measured.
    displacements : array_like, shape (frames, particles, dim), or mapping from titles to such arrays
        Displacements in mm: for a mode from `mode_frames`, for a wave from `propagate` or a `Recorder`.  The films of a mapping,
        such as one for each model, run side by side, each 500 pixels wide.
    times : array_like, shape (frames,), optional
        In ms, shown in s.
    title : str
    site : BurstSetup, optional
        If given, the particles where a burst enters and is measured are marked.
    centre : array_like, shape (2,), optional
        Position in mm about which a periodic structure is drawn.
    defects : array_like, shape (defects, 2), optional
        Positions in mm to be marked by a cross.

    Returns
    -------
    float
        Factor by which displacements are drawn larger: the largest is drawn as a third of the shortest bond.
    """
    from matplotlib.animation import FuncAnimation, PillowWriter

    path, films = Path(path), displacements if isinstance(displacements, Mapping) else {'': displacements}
    u, largest = _moving(films, len(atoms))
    moments = None if times is None else finite('times', times, u.shape[1:2])
    bond = repulsion_of(atoms).bonds.lengths.min()
    factor = LONGEST * bond / largest
    if path.suffix.lower() != '.gif':
        raise ValueError(f'{path.name} must end in .gif')
    seen, axis = seen_about(atoms, centre), main_axis(u)
    rest = seen.positions[:, :2]
    wide, high = np.ptp(rest, axis=0) + 2 * bond
    figure = new_figure(5.0 * len(films), 1.2 + 3.6 * min(1.5, high / wide))
    drawn = []
    for ax, name, film in zip(figure.subplots(1, len(films), squeeze=False)[0], films, u, strict=True):
        draw_bonds(ax, seen)
        frame(ax, rest / units.m, spacing(atoms))
        dots, power = draw_crests(ax, seen, film[0, :, axis], visible(u[..., axis].reshape(-1, len(atoms))), DOT)
        if site is not None:
            mark_site(ax, seen, site)
        mark_defects(ax, seen, defects)
        ax.set_title(name)
        drawn.append((dots, film))
    bar_of_crests(dots, figure.axes, axis, power)

    def show(k):
        for dots, film in drawn:
            dots.set_offsets((rest + factor * film[k, :, :2]) / units.m)
            dots.set_array(film[k, :, axis] / units.m / 10.0**power)
        when = '' if moments is None else f', {moments[k] / units.s:.4f} s'
        line = f'displacements drawn {float(f"{factor:.3g}"):.12g} times as large{when}'
        lines = [title, line] if len(films) == 1 else [f'{title}; {line}', ' ']  # above the titles of both
        figure.suptitle('\n'.join(filter(None, lines)), fontsize='medium')

    show(0)
    figure.draw_without_rendering()
    figure.set_layout_engine('none')  # the axes stand still
    try:
        with TemporaryDirectory(prefix='.film-', dir=path.parent) as folder:
            whole = Path(folder) / 'film.gif'
            film = FuncAnimation(figure, show, frames=u.shape[1])
            film.save(whole, writer=PillowWriter(fps=PER_SECOND), dpi=100)
            os.replace(whole, path)
    except OSError as error:
        raise type(error)(f'{path} cannot be written ({error.strerror}); choose another place') from None
    return float(factor)
