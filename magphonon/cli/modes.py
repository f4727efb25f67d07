"""`magphonon modes SCENE`: modes of the lattice at special points, and modes of the patch with a list of local ones."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..files import write_columns
from .arguments import add_output, add_scene, add_style, answering, left_out

if TYPE_CHECKING:
    from ..response.normal_modes import Localisation, Modes
    from ..stiffness.rest import LinearSystem

HELP = 'what moves in each mode, and which modes are local at a defect'
MOST_REPEATED = 1000  # free directions of a structure whose modes are computed a second time, with D0 alone: a second
SHOWN = 3  # largest number of modes of a patch that are drawn: the most local ones, or the lowest if none is local
MOST_BRANCHES = 6  # largest number of branches of a lattice whose modes are drawn at each special point
OUTSIDE = 1e-4
"""Distance of a local mode from the bands, as a fraction of the highest frequency: the bands may be wider between
points of the mesh."""


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser)
    add_style(parser)
    parser.add_argument('--animate', metavar='MODE', type=int,
                        help='write a film of this mode of the patch, by its number in modes.csv')


class Patch(NamedTuple):
    """The modes of a patch or a finite structure, and those of them that are shown."""

    system: LinearSystem
    modes: Modes
    ranges: NDArray[np.float64]  # of the bands of the lattice; empty for a finite structure
    extent: Localisation
    local: list[int]  # indices of the modes outside the bands, the most local first
    shown: list[int]  # the most local ones, or the lowest if the patch has no local modes
    defects: NDArray[np.float64]


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene

    scene = read_scene(options.scene)
    if scene.single:
        raise ValueError('the oscillator is one particle and has no bands or modes; use "magphonon frf"')
    cell = None if scene.finite else scene.perfect_cell()
    atoms = scene.patch_atoms() if scene.finite or scene.patch is not None else None
    if atoms is None and options.animate is not None:
        raise ValueError(f'--animate {options.animate}: the scene has no patch whose modes could be computed; add a table '
                         '[patch]')
    with answering(options, scene, 'modes.*', 'modes_lattice.*', 'mode_*.gif') as (folder, save, told):
        answer, everything, lines = '', [scene.title, *left_out(scene)], []
        if cell is not None:
            answer, of_lattice = _lattice(scene, cell, folder, save)
            everything += of_lattice
        if atoms is not None:
            patch = _solved(scene, cell, atoms)
            _write(folder, save, patch, options.animate)
            answer, lines = _patch_report(scene, patch)
        told += [answer, *(everything if options.verbose else []), *lines, *_left_out(scene, atoms, options.verbose)]


def _left_out(scene, atoms, verbose):
    """What the modes leave out, in words: farther neighbours, and for a net the supports that keep it in its plane."""
    from ..stability.verdicts import verdict
    from .neighbours import omission

    told = [] if scene.finite else omission(scene, verbose)
    return told + ([verdict(atoms).finding('supports').words] if scene.members and atoms.calc.dim == 2 else [])


def _lattice(scene, cell, folder, save):
    """Write and draw the modes of the lattice at its special points; the answer in one line, and a table of both models."""
    from ..bands.bands import analytic_bands
    from ..plotting.bands import mode_names
    from .band_report import ZERO_FRACTION
    from .neighbours import special_points

    points = special_points(scene)
    path = scene.lattice.path(''.join(points), 2)
    both = {model: analytic_bands(cell, path, model, vectors=True) for model in cell.calc.bloch_models}
    bands, f = both['complete'], both['complete'].frequencies_Hz
    at = [int(abs(path.kpts - path.special_points[name]).max(axis=1).argmin()) for name in points]
    places, branches = np.repeat([*points], f.shape[1]), np.tile(np.arange(f.shape[1]) + 1, len(at))
    found = {f'{model}_Hz': one.frequencies_Hz[at].ravel() for model, one in both.items()}
    write_columns(folder / 'modes_lattice.csv', ['point', 'branch', *found], [places, branches, *found.values()])
    lines = [f'{"modes of the lattice (Hz)":28}' + ''.join(f'{model:>14}' for model in both)]
    for name, branch, label, *values in zip(places, branches, mode_names(bands)[at].ravel(), *found.values(), strict=True):
        shown = ''.join(f'{value:14.6g}' for value in np.where(abs(np.array(values)) > ZERO_FRACTION * f.max(), values, 0.0))
        lines.append(f'{f"  {name}, branch {branch}":28}{shown}  {label}'.rstrip())
    lowest = 0.0 if _of_no_stiffness(f).flat[f.argmin()] else f.min()
    answer = f'modes of the lattice at {", ".join(points)}: from {units.in_words("Hz", lowest, f.max(), digits=6)}'
    return answer, [*lines, *_draw_lattice(save, cell, bands, at)]


def _draw_lattice(save, cell, bands, at):
    """Draw the modes at the special points, if they can be drawn; a line that says so if not."""
    from ..bands.bloch import PLANAR
    from ..plotting.axes import legend_of_set, letter_panels, panels
    from ..plotting.modes import plot_mode

    branches = bands.omega.shape[1]
    if not cell.calc.pairwise or tuple(cell.pbc) != PLANAR or cell.calc.dim != 2 or branches > MOST_BRANCHES:
        return ['no picture: modes are drawn only for planar lattices with a number of shells, motion in the plane and at most '
                f'{MOST_BRANCHES} branches']
    rows, columns = sorted((len(at), branches))  # as wide as can be: the picture should fit on a page
    figure, axes = panels(rows, columns, height=7.0 / max(columns, 2) + 0.2)
    for (branch, point), ax in np.ndenumerate(axes if rows == branches else axes.T):
        plot_mode(cell, bands, at[point], branch, ax=ax)
    letter_panels(axes)
    legend_of_set(figure)
    save(figure, 'modes_lattice')
    return []


def _solved(scene, cell, atoms):
    """The modes of a patch or a finite structure."""
    from ..bands.density import band_ranges
    from ..response.normal_modes import localisation, lowest_and_local
    from ..stiffness.rest import LinearSystem
    from ..traits import LINEAR

    system = LinearSystem.of(atoms, *LINEAR).moving()
    ranges = np.empty((0, 2)) if cell is None else band_ranges(cell)
    found = lowest_and_local(system, ranges)
    extent = localisation(found, system)
    order, room = np.argsort(extent.participation, kind='stable'), OUTSIDE * abs(found.omega).max()
    inside = ((found.omega[:, None] >= ranges[:, 0] - room) & (found.omega[:, None] <= ranges[:, 1] + room)).any(axis=1)
    if len(ranges):
        local = order[~inside[order]].tolist()
        shown = local or [*range(len(order))]
    else:
        local, shown = [], order[~_of_no_stiffness(found.omega)[order]].tolist()
    return Patch(system, found, ranges, extent, local, shown[:SHOWN], scene.defect_places())


def _patch_report(scene, patch):
    """The answer in one line, and lines on modes without energy, an unstable photo, and the most local modes."""
    f, free, bounded = patch.modes.frequencies_Hz, _of_no_stiffness(patch.modes.omega), len(patch.ranges) > 0
    answer = (f'modes of the {"structure" if scene.finite else "patch"}: '
              f'{"all" if len(f) == patch.system.directions else "the lowest and those between the bands, in all"} {len(f)}, '
              f'from {units.in_words("Hz", 0.0 if free[0] else f[0], f[-1], digits=6)}'
              + f'; outside the bands of the lattice: {len(patch.local) or "none"}' * bounded)
    lines = _without_energy(patch, free) if scene.finite else []
    if scene.finite and getattr(scene.lattice, 'positions', None) == 'rest' and f[0] < -OUTSIDE * abs(f).max():
        lines.append('UNSTABLE: with this law and foundation the lattice in the photo would buckle; check them, and cutoff_m')
    if patch.local or not bounded:
        lines.append('the most local ones:')
        lines += [f'  mode {k + 1}: {f[k]:.6g} Hz, {patch.extent.participation[k]:.3g} particles take part, '
                  f'{_place(patch.system.atoms, patch.extent.centre[k], patch.defects)}, '
                  f'localisation length {patch.extent.length[k] / 1e3:.3g} m' for k in patch.shown]
    return answer, lines


def _without_energy(patch, free):
    """A line with the number of modes of a finite structure that cost no energy, and what it would be with D0 alone."""
    from ..response.normal_modes import lowest_and_local
    from ..stiffness.rest import LinearSystem

    system = patch.system
    if system.turning or system.directions > MOST_REPEATED:
        return []
    alone = LinearSystem.about(system.atoms.calc.about(system.atoms, model='conventional'), system.atoms).moving()
    blind = _of_no_stiffness(lowest_and_local(alone, patch.ranges).omega)
    told = f'  modes that cost no energy: {free.sum()}; with D0 alone there would be {blind.sum()}'
    return [told] if (free | blind).any() else []


def _of_no_stiffness(omega):
    """Mask of the modes that cost no energy, such as the motion of a whole structure that nothing holds."""
    from .band_report import ZERO_FRACTION

    return abs(omega) < ZERO_FRACTION * abs(omega).max()


def _place(atoms, centre, defects):
    from ase.geometry import find_mic

    if not len(defects):
        small = abs(centre) < 1e-9 * np.ptp(atoms.positions, axis=0).max()  # round-off
        return f'centre at ({", ".join(f"{x / 1e3:.4g}" for x in np.where(small, 0.0, centre))}) m'
    away = find_mic(np.c_[centre[:2] - defects, np.zeros(len(defects))], atoms.cell, atoms.pbc)[1].min()
    return f'centre {away / 1e3:.2g} m from the defect' if len(defects) == 1 else f'centre {away / 1e3:.2g} m from a defect'


def _write(folder, save, patch, filmed):
    """Write tables of the modes of a patch, draw those that are shown, and film one mode if it is `filmed`.

    The film shows one period of the mode with a largest displacement of a thousandth of the shortest bond.
    """
    from ..plotting.animation import animate, mode_frames
    from ..plotting.axes import legend_of_set, letter_panels, panels
    from ..plotting.modes import plot_extents, plot_shape

    extent, f, atoms = patch.extent, patch.modes.frequencies_Hz, patch.system.atoms
    if filmed is not None and not 1 <= filmed <= len(f):
        raise ValueError(f'--animate must be the number of a mode, 1 to {len(f)}, not {filmed}')
    extent.save(folder / 'modes.npz')
    axes = 'xyz'[: extent.along.shape[1]]
    names = ['mode', 'frequency_Hz', 'participating_particles', 'localisation_length_m', *(f'centre_{x}_m' for x in axes),
             *(f'share_along_{x}' for x in axes)]
    write_columns(folder / 'modes.csv', names, [np.arange(len(f)) + 1, f, extent.participation, extent.length / units.m,
                                                *(extent.centre / units.m).T, *extent.along.T])
    own = patch.defects if len(patch.defects) else extent.centre[patch.shown, :2]
    about = {'defects': patch.defects, 'centre': own[0]}  # of the pictures of a periodic patch
    figure, axes = panels(2, 2)
    plot_extents(extent, ax=axes[0, 0], bands=patch.ranges)
    for ax in axes.flat[1 + len(patch.shown) :]:
        ax.remove()
    for k, ax in zip(patch.shown, axes.flat[1:], strict=False):
        plot_shape(atoms, patch.modes.shapes[k], ax=ax, title=f'mode {k + 1}, {f[k]:.5g} Hz', **about)
    letter_panels(axes.flat[: 1 + len(patch.shown)])
    legend_of_set(figure)
    save(figure, 'modes')
    if filmed is not None:
        amplitude = patch.system.calc.bonds.lengths.min() / 1000
        animate(folder / f'mode_{filmed}.gif', atoms, mode_frames(patch.modes.shapes[filmed - 1], amplitude),
                title=f'mode {filmed}, {f[filmed - 1]:.5g} Hz, up to {amplitude / 1e3:.3g} m', **about)
