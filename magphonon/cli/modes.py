"""`magphonon modes SCENE`: modes of the lattice at special points, and modes of the patch with a list of local ones."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..files import write_columns
from .arguments import add_output, add_pictures, add_scene, drawing, lattice_and_patch

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from ..scenes.scene import Scene
    from .costs import Cost

HELP = 'mode shapes of the lattice and of a patch: how far each mode reaches, and which are local'
RESULTS = 'modes.*', 'modes_lattice.*', 'mode_*.gif', 'mac.*'
MOST_DIRECTIONS = 3000
"""Largest number of free directions for which all modes are computed; above it, the lowest ones and those between the bands."""
MOST_TURNING = 1500  # the same where forces turn velocities: matrices are complex and of twice the size
MOST_REPEATED = 1000  # free directions of a patch whose modes are computed a second time, with all neighbours: a second
LOWEST = 60  # number of the lowest modes of a larger patch
SHOWN = 3  # largest number of modes of a patch that are drawn: the most local ones, or the lowest if none is local
MOST_BRANCHES = 6  # largest number of branches of a lattice whose modes are drawn at each special point
FAR = 0.25  # relative distance in frequency beyond which shapes alike are no match; a law known to 10 % gives a fifth
OUTSIDE = 1e-4
"""Distance of a local mode from the bands, as a fraction of the highest frequency: the bands may be wider between
points of the mesh."""

DRAWN, MOST_DRAWN = 40, 600
"""Number of patches drawn at random with the scatter of [uncertainty], and largest number of free directions of one."""
SHAPES_bytes = 40  # memory for all modes of a structure with their shapes, divided by the square of its free directions


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser)
    add_pictures(parser)
    parser.add_argument('--animate', metavar='MODE', type=int,
                        help='write a film of this mode of the patch, by its number in modes.csv')
    parser.add_argument('--compare', metavar='TABLE',
                        help='compare measured shapes, a table with the columns mode,frequency_Hz,x_mm,y_mm,u_x,u_y, with the '
                        'modes of the patch')


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene
    from .costs import refuse_cost
    from .neighbours import neighbours
    from .results import results

    scene = read_scene(options.scene)
    refuse_cost(scene, cost(scene))
    lattice, patch, report = lattice_and_patch(scene)
    for option in ('animate', 'compare'):
        if patch is None and (given := getattr(options, option)) is not None:
            raise ValueError(f'--{option} {given}: the scene has no patch whose modes it could take; add a table [patch]')
    with results(options, scene) as folder, drawing(options, folder, scene.title) as save:
        report = [scene.title, *report]
        if lattice is not None:
            report += _of_lattice(save, scene, lattice)
        if patch is not None:
            report += _of_patch(folder, save, lattice, patch, scene, options)
        drawn = any(folder.glob('*.png'))
    print('\n'.join([*report, *neighbours(scene, brief=True)]))
    print(f'pictures and data are in {options.output}' if drawn else 'no pictures: modes are drawn of planar lattices that have '
          f'a number of shells, motion in the plane and at most {MOST_BRANCHES} branches')


def cost(scene: Scene) -> Cost:
    """Estimated cost of the command."""
    from .costs import Cost, FACTOR_bytes, PICTURES_bytes, particles_of, size_key

    size = 2 * particles_of(scene)
    if size <= MOST_DIRECTIONS:
        memory = SHAPES_bytes * size**2 * 8**scene.turns  # complex, of twice the size
    else:
        memory = (FACTOR_bytes + 16 * LOWEST) * size / 2
    return Cost('modes', {size_key(scene): PICTURES_bytes + memory}, 6)


def _of_lattice(save, scene, atoms):
    from ..bands.bands import analytic_bands
    from ..bands.zone import PLANAR
    from ..plotting.axes import legend_of_set, letter_panels, panels
    from ..plotting.bands import mode_names
    from ..plotting.modes import plot_mode
    from .band_report import ZERO_FRACTION
    from .neighbours import special_points

    names = list(special_points(scene))
    path = scene.lattice.path(''.join(names), 2)
    bands = analytic_bands(atoms, path, vectors=True)
    at = [int(abs(path.kpts - path.special_points[name]).max(axis=1).argmin()) for name in names]
    labels = mode_names(bands)
    conventional = analytic_bands(atoms, path, 'conventional') if 'conventional' in atoms.calc.bloch_models else None
    top = bands.frequencies_Hz.max()
    report = [f'{"modes of the lattice (Hz)":28}' + f'{"complete":>14}' + f'{"conventional":>14}' * (conventional is not None)]
    for name, where in zip(names, at, strict=True):
        for branch, polarisation in enumerate(labels[where]):
            found = [which.frequencies_Hz[where, branch] for which in (bands, conventional) if which is not None]
            shown = ''.join(f'{f if abs(f) > ZERO_FRACTION * top else 0.0:14.6g}' for f in found)
            report.append(f'{f"  {name}, branch {branch + 1}":28}{shown}  {polarisation}'.rstrip())
    drawable = atoms.calc.pairwise and tuple(atoms.pbc) == PLANAR and atoms.calc.dim == 2
    if not drawable or bands.omega.shape[1] > MOST_BRANCHES:
        return report
    branches = bands.omega.shape[1]
    figure, axes = panels(len(names), branches, height=7.0 / max(branches, 2) + 0.2)
    for row, where in zip(axes, at, strict=True):
        for branch, ax in enumerate(np.atleast_1d(row)):
            plot_mode(atoms, bands, where, branch, ax=ax)
    letter_panels(axes)
    legend_of_set(figure)
    save(figure, 'modes_lattice')
    return report


def _of_patch(folder, save, lattice, patch, scene, options):
    from ..bands.density import band_ranges
    from ..response.normal_modes import localisation
    from ..stiffness.rest import LinearSystem
    from ..traits import LINEAR

    system, defects = LinearSystem.of(patch, *LINEAR).moving(), scene.defect_places()
    ranges = band_ranges(lattice) if lattice is not None else np.empty((0, 2))
    (found, every), filmed = _modes(system, ranges), options.animate
    if filmed is not None and not 1 <= filmed <= len(found.omega):
        raise ValueError(f'--animate must be the number of a mode, 1 to {len(found.omega)}, not {filmed}')
    extent = localisation(found, system)
    extent.save(folder / 'modes.npz')
    spread, told = _spread(scene, system, found)
    _write_table(folder / 'modes.csv', extent, spread)
    room = OUTSIDE * abs(found.omega).max()
    outside = [k for k, omega in enumerate(found.omega) if not any(low - room <= omega <= high + room for low, high in ranges)]
    free = _of_no_stiffness(found.omega)
    order = np.argsort(extent.participation)
    local = sorted(outside, key=lambda k: extent.participation[k]) if len(ranges) else []
    drawn = (local or [*(order[~free[order]] if not len(ranges) else range(len(found.omega)))])[:SHOWN]
    # pictures and films show one image of a periodic patch, about its first defect or else its most local mode
    about = {'defects': defects, 'centre': defects[0] if len(defects) else extent.centre[drawn[0], :2]}
    _draw(save, system, found, extent, ranges, drawn, about)
    name, lowest = 'structure' if scene.finite else 'patch', 0.0 if free[0] else found.frequencies_Hz[0]
    which = 'all' if every else 'the lowest and those between the bands,'
    report = ['', f'modes of the {name}: {which} {len(found.omega)}, from {lowest:.6g} to {found.frequencies_Hz[-1]:.6g} Hz']
    if scene.finite and not system.turning and system.directions <= MOST_REPEATED:
        alone = LinearSystem.about(patch.calc.about(patch, model='conventional'), patch).moving()
        blind = _of_no_stiffness(_modes(alone, ranges)[0].omega)
        if (free | blind).any():
            report.append(f'  {free.sum()} of them cost no energy; by D0 alone it would be {blind.sum()}')
    if scene.finite and scene.lattice.positions == 'rest' and found.omega[0] < -OUTSIDE * abs(found.omega).max():
        report.append('UNSTABLE: what stands in the photo would not stand with this law and foundation; check them, and cutoff_m')
    if len(ranges):
        report.append(f'  {len(local)} of them lie outside the bands of the lattice' + (', the most local ones:' * bool(local)))
    else:
        report.append('  the most local ones:')
    for k in drawn if local or not len(ranges) else []:
        centre = _place(system.atoms, extent.centre[k, :2], defects)
        uncertain = f' +- {spread["std_Hz"][k]:.2g}' if spread else ''
        report.append(f'  mode {k + 1}: {found.frequencies_Hz[k]:.6g}{uncertain} Hz, {extent.participation[k]:.3g} particles '
                      f'take part, {centre}, localisation length {extent.length[k] / 1e3:.3g} m')
    report += told + _with_others(scene, system, found, drawn)
    if options.compare is not None:
        report += _compared(folder, save, system, found, options.compare)
    if filmed is not None:
        report.append(_film(folder, system, found, filmed, about))
    return report


def _of_no_stiffness(omega):
    """Which modes cost no energy, such as the motion of the whole structure where nothing holds it."""
    from .band_report import ZERO_FRACTION

    return abs(omega) < ZERO_FRACTION * abs(omega).max()


def _modes(system, ranges):
    from ..response.chebyshev import stable_interval
    from ..response.normal_modes import Modes, local_modes, modes

    size, turns = system.K.shape[0], system.turning
    if turns and size > MOST_TURNING:
        raise ValueError(f'the patch has {size} free directions; modes of particles whose velocities turn take dense matrices, '
                         f'of up to {MOST_TURNING}: take a smaller patch, or "magphonon frf"')
    if size <= MOST_DIRECTIONS:
        return modes(system), True
    lowest = modes(system, LOWEST)
    top = np.sqrt(stable_interval(system.K).highest)
    gaps = [*zip(ranges[:-1, 1], ranges[1:, 0], strict=True), *((high, top) for high in ranges[-1:, 1] if high < top)]
    between = [local_modes(system, gap) for gap in gaps]
    omega = np.concatenate([lowest.omega, *(found.omega for found in between)])
    new = np.concatenate([np.ones(LOWEST, bool), *(found.omega > lowest.omega[-1] for found in between)])
    return Modes(omega[new], np.concatenate([lowest.shapes, *(found.shapes for found in between)])[new]), False


def _spread(scene, system, found):
    """Columns of modes.csv with the scatter that [uncertainty] names for each site, and what the terminal says of it."""
    from ..design.scatter import mode_scatter, sampled_modes

    scatter = scene.uncertainty.tolerances(scene).scatter if scene.uncertainty is not None else None
    if not scatter:
        return {}, []
    first = units.hertz(mode_scatter(system, scatter, found).std)
    if system.directions > MOST_DRAWN:
        return {'std_Hz': first}, ['  +- is the standard deviation by the scatter of each site, to first order']
    drawn = sampled_modes(system.atoms, scatter, DRAWN)
    lost = np.isnan(drawn[:, 0]).mean()
    drawn = units.hertz(drawn[~np.isnan(drawn[:, 0])])
    told = ['  +- is the larger of two standard deviations: by the scatter of each site to first order, and about these '
            f'frequencies of {len(drawn)} structures drawn at random, mode by mode in ascending order; both are in modes.csv']
    if lost:
        told.append(f'UNSTABLE: {100 * lost:.2g} % of the structures drawn buckle')
    if lost > 0.5:
        return {'std_Hz': first}, told
    about = np.sqrt(np.mean((drawn - found.frequencies_Hz) ** 2, axis=0))  # scatter shifts the mean, too, to second order
    return {'std_Hz': np.fmax(first, about), 'first_order_std_Hz': first, 'drawn_std_Hz': about}, told


def _with_others(scene, system, found, shown):
    """What the neighbours that a patch leaves out would change of the modes that are shown."""
    from scipy.spatial import KDTree

    from ..response.normal_modes import modes
    from ..scenes.scene import LONG_RANGE, PAIRS
    from ..stiffness.rest import LinearSystem

    if scene.finite or system.turning or not isinstance(getattr(scene.law, 'asked', None), int):
        return []
    enough = scene.converged_shells(PAIRS) if scene.disorder is None and system.directions <= MOST_REPEATED else None
    if enough is None or enough.error > LONG_RANGE:
        return ['  what other neighbours would change of these modes was not computed']
    if enough.shells <= scene.law.asked:
        return []
    law = scene.law.with_shells(enough.shells, enough.cutoff / (scene.lattice.spacing_m * units.m))
    every = LinearSystem.of(scene.model_copy(update={'law': law}).patch_atoms()).moving()
    there = modes(every)
    own = np.flatnonzero(system.mobile)
    same = np.flatnonzero(every.mobile)[KDTree(every.atoms.positions[every.mobile]).query(system.atoms.positions[own])[1]]
    a, b = (one.reshape(len(one), -1) for one in (found.shapes[list(shown)][:, own], there.shapes[:, same]))
    mac = (a @ b.T) ** 2 / np.outer((a**2).sum(axis=1), (b**2).sum(axis=1))
    told = []
    for k, row in zip(shown, mac, strict=True):
        f, other = found.frequencies_Hz[k], there.frequencies_Hz[row.argmax()]
        told.append(f'mode {k + 1} by {100 * (other / f - 1):+.2g} % to {other:.4g} Hz' if row.max() > 0.5 else
                    f'no mode is like mode {k + 1}')
    return [f'  with {enough.shells} shells of neighbours, beyond which none counts: {"; ".join(told)}']


def _compared(folder, save, system, found, table):
    """Table, picture and lines of the report of measured shapes beside the computed ones."""
    from ..plotting.modes import plot_comparison
    from ..response.measured_shapes import compared

    comparison = compared(table, system.atoms, found)
    f = found.frequencies_Hz
    write_columns(folder / 'mac.csv', ['mode', 'frequency_Hz', *(f'mac_{k + 1}' for k in range(len(comparison.names)))],
                  [np.arange(len(f)) + 1, f, *comparison.mac])
    save(plot_comparison(comparison, found).figure, 'mac')
    return ['', *matches(comparison, found)]


def matches(comparison, found) -> list[str]:
    """A line for each measured shape: the computed mode that is most like it."""
    f = found.frequencies_Hz
    lines = ['measured shapes (MAC of 1 is the same shape; columns of mac.csv in this order):']
    for name, omega, mac, least in zip(comparison.names, comparison.omega, comparison.mac, comparison.least, strict=True):
        best, measured = int(mac.argmax()), units.hertz(omega)
        known = not np.isnan(measured)
        what = f'  {name}{f", {measured:.6g} Hz" if known else ""}: '
        off = f' ({100 * (f[best] / measured - 1):+.2g} %)' if known else ''
        if mac[best] > least:
            far = bool(abs(f[best] / measured - 1) > FAR)  # not, if unknown
            lines.append(f'{what}mode {best + 1}, {f[best]:.6g} Hz{off}, MAC {mac[best]:.3f}'
                         + (', too far in frequency for one mode: are u_x and u_y exchanged, or is the law another?' * far))
        else:
            lines.append(f'{what}no mode alike; the nearest is mode {best + 1}, {f[best]:.6g} Hz{off}, with MAC {mac[best]:.3f}, '
                         f'and a match needs {least:.3f} with so many measured directions')
    return lines


def _write_table(file, extent, spread):
    axes = 'xyz'[: extent.along.shape[1]]
    names = ['mode', 'frequency_Hz', 'participating_particles', 'localisation_length_m', *(f'centre_{x}_m' for x in axes),
             *(f'share_along_{x}' for x in axes)]
    write_columns(file, [*names, *spread], [np.arange(len(extent.omega)) + 1, extent.frequencies_Hz, extent.participation,
                                            extent.length / units.m, *(extent.centre / units.m).T, *extent.along.T,
                                            *spread.values()])


def _place(atoms, centre, defects):
    from ase.geometry import find_mic

    if not len(defects):
        return 'centre at ({:.4g}, {:.4g}) m'.format(*centre / 1e3)
    away = find_mic(np.c_[centre - defects, np.zeros(len(defects))], atoms.cell, atoms.pbc)[1].min()
    return f'centre {away / 1e3:.2g} m from the defect' if len(defects) == 1 else f'centre {away / 1e3:.2g} m from a defect'


def _draw(save, system, found, extent, ranges, drawn, about):
    """How many particles take part in each mode, and the shapes of the most local ones or of the lowest."""
    from ..plotting.axes import legend_of_set, letter_panels, panels
    from ..plotting.modes import plot_extents, plot_shape

    figure, axes = panels(2, 2)
    plot_extents(extent, ax=axes[0, 0], bands=ranges)
    for ax in axes.flat[1 + len(drawn) :]:
        ax.remove()
    for k, ax in zip(drawn, axes.flat[1:], strict=False):
        plot_shape(system.atoms, found.shapes[k], ax=ax, title=f'mode {k + 1}, {found.frequencies_Hz[k]:.5g} Hz', **about)
    letter_panels(axes.flat[: 1 + len(drawn)])
    legend_of_set(figure)
    save(figure, 'modes')


def _film(folder, system, found, filmed, about):
    """A film of one period of a mode whose largest displacement is a thousandth of the shortest bond; a line of the report."""
    from ..plotting.animation import animate, mode_frames

    amplitude = system.calc.bonds.lengths.min() / 1000
    title = f'mode {filmed}, {found.frequencies_Hz[filmed - 1]:.5g} Hz'
    shown = mode_frames(found.shapes[filmed - 1], amplitude)
    factor = animate(folder / f'mode_{filmed}.gif', system.atoms, shown, title=title, **about)
    return (f'  mode_{filmed}.gif: one period of mode {filmed}, with displacements of up to {amplitude / 1e3:.3g} m drawn '
            f'{factor:.3g} times as large')
