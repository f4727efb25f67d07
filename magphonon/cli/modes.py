"""`magphonon modes SCENE`: modes of the lattice at special points, and modes of the patch with a list of local ones."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..files import write_columns
from ..findings import Finding, Findings
from .arguments import add_output, add_scene, add_style, answering, left_out

if TYPE_CHECKING:
    from ..bands.bands import Bands
    from ..response.normal_modes import Localisation, Modes
    from ..scenes.scene import Scene
    from ..stiffness.rest import LinearSystem

HELP = 'what moves in each mode, and which modes are local at a defect'
MOST_TURNING = 1500  # the same limit with gyroscopic forces: matrices are complex and of twice the size
MOST_REPEATED = 1000  # free directions of a patch whose modes are computed a second time, with all neighbours: a second
FARTHER = 1.5  # factor on cutoff_m with which modes of a structure are computed again, to see what it leaves out
SHOWN = 3  # largest number of modes of a patch that are drawn: the most local ones, or the lowest if none is local
MOST_BRANCHES = 6  # largest number of branches of a lattice whose modes are drawn at each special point
OUTSIDE = 1e-4
"""Distance of a local mode from the bands, as a fraction of the highest frequency: the bands may be wider between
points of the mesh."""

MOST_DIRECTIONS = 3000
"""Largest number of free directions for which all modes are computed; above it, only the lowest and those between the bands."""
LOWEST = 60  # number of the lowest modes of a larger patch

def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser)
    add_style(parser)
    parser.add_argument('--animate', metavar='MODE', type=int,
                        help='write a film of this mode of the patch, by its number in modes.csv')


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene

    scene = read_scene(options.scene)
    lattice, patch, left = _lattice_and_patch(scene)
    if patch is None and options.animate is not None:
        raise ValueError(f'--animate {options.animate}: the scene has no patch whose modes could be computed; add a table '
                         '[patch]')
    with answering(options, scene, 'modes.*', 'modes_lattice.*', 'mode_*.gif') as (folder, save, told):
        case = Case(scene, left, lattice, patch, options)
        if lattice is not None:
            _write_lattice(folder, case)
            if case.drawable:
                _draw_lattice(save, case)
        if patch is not None:
            _write(folder, save, case)
        told += REPORT.told(case, options.verbose)


def _lattice_and_patch(scene):
    """The lattice of a scene, its patch or finite structure, and lines that say what is omitted."""
    if scene.single:
        raise ValueError('the oscillator is one particle and has no bands or modes; use "magphonon frf"')
    left = left_out(scene)
    if scene.finite:
        return None, scene.patch_atoms(), left
    return scene.perfect_cell(), None if scene.patch is None else scene.patch_atoms(), left


@dataclass(frozen=True, eq=False)
class Case:
    """A scene, and the modes of its lattice and of its patch that several findings share."""

    scene: Scene
    left: list[str]
    lattice: Any
    patch: Any
    options: Namespace

    @cached_property
    def bands(self) -> dict[str, Bands]:
        """The bands of the lattice along its special points, by model."""
        from ..bands.bands import analytic_bands
        from .neighbours import special_points

        path = self.scene.lattice.path(''.join(special_points(self.scene)), 2)  # pyright: ignore[reportAttributeAccessIssue]  no oscillator
        return {model: analytic_bands(self.lattice, path, model, vectors=True) for model in self.lattice.calc.bloch_models}

    @cached_property
    def at(self) -> dict[str, int]:
        """Indices of the wavevectors of the special points on the path of `bands`, by their names."""
        from .neighbours import special_points

        path = self.bands['complete'].path
        return {name: int(abs(path.kpts - path.special_points[name]).max(axis=1).argmin()) for name in special_points(self.scene)}

    @property
    def drawable(self) -> bool:
        """Whether modes of the lattice can be drawn."""
        from ..bands.zone import PLANAR

        calc, branches = self.lattice.calc, self.bands['complete'].omega.shape[1]
        return calc.pairwise and tuple(self.lattice.pbc) == PLANAR and calc.dim == 2 and branches <= MOST_BRANCHES

    @cached_property
    def system(self) -> LinearSystem:
        """The linear system of the patch or the finite structure."""
        from ..stiffness.rest import LinearSystem
        from ..traits import LINEAR

        return LinearSystem.of(self.patch, *LINEAR).moving()

    @cached_property
    def ranges(self) -> NDArray[np.float64]:
        """Frequency ranges of the bands of the lattice; empty for a finite structure."""
        from ..bands.density import band_ranges

        return np.empty((0, 2)) if self.lattice is None else band_ranges(self.lattice)

    @cached_property
    def computed(self) -> tuple[Modes, bool]:
        """The computed modes of the patch, and whether these are all its modes."""
        return _modes(self.system, self.ranges)

    @property
    def found(self) -> Modes:
        return self.computed[0]

    @cached_property
    def extent(self) -> Localisation:
        from ..response.normal_modes import localisation

        return localisation(self.found, self.system)

    @cached_property
    def local(self) -> list[int]:
        """Indices of the modes outside the bands of the lattice, the most local first."""
        room = OUTSIDE * abs(self.found.omega).max()
        outside = [k for k, omega in enumerate(self.found.omega)
                   if not any(low - room <= omega <= high + room for low, high in self.ranges)]
        return sorted(outside, key=lambda k: self.extent.participation[k]) if len(self.ranges) else []

    @cached_property
    def shown(self) -> list[int]:
        """Indices of the modes that are drawn: the most local ones, or the lowest if the patch has no local modes."""
        order = np.argsort(self.extent.participation)
        every = range(len(self.found.omega)) if len(self.ranges) else order[~self.free[order]]
        return (self.local or [*every])[:SHOWN]

    @cached_property
    def free(self) -> NDArray[np.bool_]:
        """Mask of the modes that cost no energy."""
        return _of_no_stiffness(self.found.omega)

    @cached_property
    def defects(self) -> NDArray[np.float64]:
        return self.scene.defect_places()

    @property
    def about(self) -> dict[str, Any]:
        """Centre of the pictures of a periodic patch: its first defect, or else its most local mode; and the defects."""
        own = self.defects if len(self.defects) else self.extent.centre[self.shown, :2]
        return {'defects': self.defects, 'centre': own[0]}


REPORT = Findings()


@REPORT.answer
def count(case: Case) -> str:
    """How many modes the patch has, and whether some are local; without a patch, where those of the lattice lie."""
    if case.patch is None:
        f = case.bands['complete'].frequencies_Hz
        lowest = 0.0 if _of_no_stiffness(f).flat[f.argmin()] else f.min()
        return f'modes of the lattice at {", ".join(case.at)}: from {units.in_words("Hz", lowest, f.max(), digits=6)}'
    f, name = case.found.frequencies_Hz, 'structure' if case.scene.finite else 'patch'
    every, lowest = 'all' if case.computed[1] else 'the lowest and those between the bands, in all', 0.0 if case.free[0] else f[0]
    outside = f'; outside the bands of the lattice: {len(case.local) or "none"}' if len(case.ranges) else ''
    return f'modes of the {name}: {every} {len(f)}, from {units.in_words("Hz", lowest, f[-1], digits=6)}{outside}'


@REPORT.remark
def of_lattice(case: Case) -> Iterator[str]:
    """A table of the modes of the lattice at special points by both models."""
    from ..plotting.bands import mode_names
    from .band_report import ZERO_FRACTION

    yield '\n'.join([case.scene.title, *case.left])
    if case.lattice is None:
        return
    labels, top = mode_names(case.bands['complete']), case.bands['complete'].frequencies_Hz.max()
    yield f'{"modes of the lattice (Hz)":28}' + ''.join(f'{model:>14}' for model in case.bands)
    for name, where in case.at.items():
        for branch, polarisation in enumerate(labels[where]):
            found = [bands.frequencies_Hz[where, branch] for bands in case.bands.values()]
            shown = ''.join(f'{f if abs(f) > ZERO_FRACTION * top else 0.0:14.6g}' for f in found)
            yield f'{f"  {name}, branch {branch + 1}":28}{shown}  {polarisation}'.rstrip()
    if not case.drawable:
        yield (f'no picture: modes are drawn only for planar lattices with a number of shells, motion in the plane and at most '
               f'{MOST_BRANCHES} branches')


@REPORT.check
def without_energy(case: Case) -> Finding | None:
    """How many modes of a finite structure cost no energy, and how many would with D0 alone; always printed if there are any."""
    from ..stiffness.rest import LinearSystem

    if case.patch is None or not case.scene.finite or case.system.turning or case.system.directions > MOST_REPEATED:
        return None
    alone = LinearSystem.about(case.patch.calc.about(case.patch, model='conventional'), case.patch).moving()
    blind = _of_no_stiffness(_modes(alone, case.ranges)[0].omega)
    return Finding(blind, f'  modes that cost no energy: {case.free.sum()}; with D0 alone there would be {blind.sum()}',
                   fault=True) if (case.free | blind).any() else None


@REPORT.check
def stands(case: Case) -> Finding | None:
    """Whether a lattice that stands in a photo would be stable with this law."""
    if case.patch is None or not case.scene.finite or getattr(case.scene.lattice, 'positions', None) != 'rest':
        return None
    unstable = case.found.omega[0] < -OUTSIDE * abs(case.found.omega).max()
    return Finding(unstable, 'UNSTABLE: with this law and foundation the lattice in the photo would buckle; check them, and '
                             'cutoff_m', fault=True) if unstable else None


@REPORT.check
def most_local(case: Case) -> Finding | None:
    """The most local modes; always printed if some lie outside the bands, or if there are no bands."""
    if case.patch is None or not (case.local or not len(case.ranges)):
        return None
    lines, extent = ['the most local ones:'], case.extent
    for k in case.shown:
        centre = _place(case.system.atoms, extent.centre[k], case.defects)
        lines.append(f'  mode {k + 1}: {case.found.frequencies_Hz[k]:.6g} Hz, {extent.participation[k]:.3g} '
                     f'particles take part, {centre}, localisation length {extent.length[k] / 1e3:.3g} m')
    return Finding(case.shown, '\n'.join(lines), fault=True)


@REPORT.remark
def other_neighbours(case: Case) -> list[str] | None:
    """Lines that say how the omitted neighbours of a patch or structure would change the modes that are shown."""
    from ..scenes.scene import LONG_RANGE, PAIRS
    from ..stiffness.rest import LinearSystem

    if case.patch is None or case.system.turning:
        return None
    scene, system = case.scene, case.system
    cutoff = getattr(scene.lattice, 'cutoff_m', None)
    if scene.finite and cutoff and system.directions <= MOST_REPEATED and system.atoms.calc.pairwise:
        farther = scene.lattice.model_copy(update={'cutoff_m': FARTHER * cutoff})
        every = LinearSystem.of(scene.model_copy(update={'lattice': farther}).atoms()).moving()
        return _shifted(case, every, f'neighbours up to cutoff_m = {FARTHER * cutoff:.3g}')
    if scene.finite or not isinstance(getattr(scene.law, 'asked', None), int):
        return None
    enough = scene.converged_shells(PAIRS) if system.directions <= MOST_REPEATED else None
    if enough is None or enough.error > LONG_RANGE:
        return ['  the effect of farther neighbours on the modes of the patch was not computed']
    if enough.shells <= scene.law.asked:
        return None
    law = scene.law.with_shells(enough.shells, enough.cutoff / (scene.lattice.spacing_m * units.m))
    every = LinearSystem.of(scene.model_copy(update={'law': law}).patch_atoms()).moving()
    return _shifted(case, every, f'{enough.shells} shells of neighbours (farther ones do not matter)')


@REPORT.check
def others(case: Case) -> Finding:
    """How the omitted neighbours would change the frequencies of the lattice."""
    from .neighbours import omitted

    return Finding() if case.scene.finite else omitted(case.scene)


def _of_no_stiffness(omega):
    """Mask of the modes that cost no energy, such as the motion of a whole structure that nothing holds."""
    from .band_report import ZERO_FRACTION

    return abs(omega) < ZERO_FRACTION * abs(omega).max()


def _modes(system, ranges):
    from ..response.chebyshev import stable_interval
    from ..response.normal_modes import Modes, local_modes, modes

    size, turns = system.K.shape[0], system.turning
    if turns and size > MOST_TURNING:
        raise ValueError(f'the patch has {size} free directions; modes of gyroscopes need dense matrices, '
                         f'which may have up to {MOST_TURNING} rows: use a smaller patch, or "magphonon frf"')
    if size <= MOST_DIRECTIONS:
        return modes(system), True
    lowest = modes(system, LOWEST)
    top = np.sqrt(stable_interval(system.K).highest)
    gaps = [*zip(ranges[:-1, 1], ranges[1:, 0], strict=True), *((high, top) for high in ranges[-1:, 1] if high < top)]
    between = [local_modes(system, gap) for gap in gaps]
    omega = np.concatenate([lowest.omega, *(found.omega for found in between)])
    new = np.concatenate([np.ones(LOWEST, bool), *(found.omega > lowest.omega[-1] for found in between)])
    return Modes(omega[new], np.concatenate([lowest.shapes, *(found.shapes for found in between)])[new]), False


def _shifted(case, every, how):
    """Lines with the shifts of modes if more neighbours count; a mode is identified by the similarity of its shape."""
    from scipy.spatial import KDTree

    from ..response.normal_modes import modes

    system, found, there = case.system, case.found, modes(every)
    own = np.flatnonzero(system.mobile)
    same = np.flatnonzero(every.mobile)[KDTree(every.atoms.positions[every.mobile]).query(system.atoms.positions[own])[1]]
    a, b = (one.reshape(len(one), -1) for one in (found.shapes[list(case.shown)][:, own], there.shapes[:, same]))
    mac = (a @ b.T) ** 2 / np.outer((a**2).sum(axis=1), (b**2).sum(axis=1))
    told = []
    for k, row in zip(case.shown, mac, strict=True):
        f, other = found.frequencies_Hz[k], there.frequencies_Hz[row.argmax()]
        told.append(f'mode {k + 1} by {100 * (other / f - 1):+.2g} % to {other:.4g} Hz' if row.max() > 0.5 else
                    f'mode {k + 1} beyond recognition')
    return [f'  {how} would shift: {"; ".join(told)}']


def _write_table(file, extent):
    axes = 'xyz'[: extent.along.shape[1]]
    names = ['mode', 'frequency_Hz', 'participating_particles', 'localisation_length_m', *(f'centre_{x}_m' for x in axes),
             *(f'share_along_{x}' for x in axes)]
    write_columns(file, names, [np.arange(len(extent.omega)) + 1, extent.frequencies_Hz, extent.participation,
                                extent.length / units.m, *(extent.centre / units.m).T, *extent.along.T])


def _place(atoms, centre, defects):
    from ase.geometry import find_mic

    if not len(defects):
        small = abs(centre) < 1e-9 * np.ptp(atoms.positions, axis=0).max()  # round-off
        return f'centre at ({", ".join(f"{x / 1e3:.4g}" for x in np.where(small, 0.0, centre))}) m'
    away = find_mic(np.c_[centre[:2] - defects, np.zeros(len(defects))], atoms.cell, atoms.pbc)[1].min()
    return f'centre {away / 1e3:.2g} m from the defect' if len(defects) == 1 else f'centre {away / 1e3:.2g} m from a defect'


def _write_lattice(folder, case):
    rows = [(name, where, k) for name, where in case.at.items() for k in range(case.bands['complete'].omega.shape[1])]
    found = {f'{model}_Hz': [bands.frequencies_Hz[where, k] for _, where, k in rows] for model, bands in case.bands.items()}
    write_columns(folder / 'modes_lattice.csv', ['point', 'branch', *found],
                  [[name for name, *_ in rows], [k + 1 for *_, k in rows], *found.values()])


def _draw_lattice(save, case):
    from ..plotting.axes import legend_of_set, letter_panels, panels
    from ..plotting.modes import plot_mode

    bands = case.bands['complete']
    branches = bands.omega.shape[1]
    figure, axes = panels(len(case.at), branches, height=7.0 / max(branches, 2) + 0.2)
    for row, where in zip(axes, case.at.values(), strict=True):
        for branch, ax in enumerate(np.atleast_1d(row)):
            plot_mode(case.lattice, bands, where, branch, ax=ax)
    letter_panels(axes)
    legend_of_set(figure)
    save(figure, 'modes_lattice')


def _write(folder, save, case):
    """Write tables and pictures of the modes of the patch, and a film of one mode."""
    filmed, f = case.options.animate, case.found.frequencies_Hz
    if filmed is not None and not 1 <= filmed <= len(f):
        raise ValueError(f'--animate must be the number of a mode, 1 to {len(f)}, not {filmed}')
    case.extent.save(folder / 'modes.npz')
    _write_table(folder / 'modes.csv', case.extent)
    _draw(save, case)
    if filmed is not None:
        _film(folder, case, filmed)


def _draw(save, case):
    """Draw how many particles take part in each mode, and the shapes of the most local or the lowest modes."""
    from ..plotting.axes import legend_of_set, letter_panels, panels
    from ..plotting.modes import plot_extents, plot_shape

    figure, axes = panels(2, 2)
    plot_extents(case.extent, ax=axes[0, 0], bands=case.ranges)
    for ax in axes.flat[1 + len(case.shown) :]:
        ax.remove()
    for k, ax in zip(case.shown, axes.flat[1:], strict=False):
        title = f'mode {k + 1}, {case.found.frequencies_Hz[k]:.5g} Hz'
        plot_shape(case.system.atoms, case.found.shapes[k], ax=ax, title=title, **case.about)
    letter_panels(axes.flat[: 1 + len(case.shown)])
    legend_of_set(figure)
    save(figure, 'modes')


def _film(folder, case, filmed):
    """Save a film of one period of a mode whose largest displacement is a thousandth of the shortest bond; its title says by
    which factor motion is enlarged.
    """
    from ..plotting.animation import animate, mode_frames

    amplitude = case.system.calc.bonds.lengths.min() / 1000
    title = f'mode {filmed}, {case.found.frequencies_Hz[filmed - 1]:.5g} Hz, up to {amplitude / 1e3:.3g} m'
    animate(folder / f'mode_{filmed}.gif', case.system.atoms, mode_frames(case.found.shapes[filmed - 1], amplitude), title=title,
            **case.about)
