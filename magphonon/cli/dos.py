"""`magphonon dos SCENE`: density of states of the lattice and of the patch, and the unfolded bands of the patch."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import dataclass
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .. import units
from ..files import write_columns
from ..findings import Finding, Findings
from .arguments import add_output, add_pictures, add_scene, answering, lattice_and_patch

if TYPE_CHECKING:
    from ..bands.density import DensityOfStates
    from ..response.spectral_density import SpectralFunction
    from ..scenes.scene import Scene

HELP = 'densities of states of lattice and patch: where the modes lie, and where the gaps are'
RESULTS = 'dos.*', 'dos_*', 'spectral.*'
FREQUENCIES = 400  # number of bins of the density of a lattice
MOMENTS, VECTORS, SPECTRAL_MOMENTS = 512, 16, 256
"""Chebyshev moments and random vectors of the density of a patch, moments of its spectral function: they resolve 0.3 % and 0.6 %
of the highest frequency."""
WAVEVECTORS = 60  # number of wavevectors along the path


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser)
    add_pictures(parser)


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene

    scene = read_scene(options.scene)
    lattice, patch, left = lattice_and_patch(scene)
    with answering(options, scene) as (folder, save, told):
        axes, found, ends, of_patch, unfolded = None, {}, {}, None, None
        if lattice is not None:
            axes, found, ends = _of_lattice(folder, lattice)
        if patch is not None:
            axes, of_patch = _of_patch(folder, patch, axes)
            if lattice is not None and scene.bands is not None:
                path = scene.lattice.path(scene.bands.path, WAVEVECTORS)  # pyright: ignore[reportAttributeAccessIssue]  no oscillator
                unfolded = _unfolded(folder, save, lattice, patch, path)
        save(axes.figure, 'dos')  # pyright: ignore[reportOptionalMemberAccess]  a scene has one of both
        told += REPORT.told(Case(scene, left, found, ends, of_patch, unfolded), options.verbose)


@dataclass(frozen=True)
class Case:
    """A scene; for each model, the density of its lattice and the ends of the branches in Hz; and the density of its patch."""

    scene: Scene
    left: list[str]
    lattice: dict[str, DensityOfStates]
    ends: dict[str, NDArray[np.float64]]
    patch: DensityOfStates | None
    unfolded: SpectralFunction | None


REPORT = Findings()


@REPORT.answer
def where(case: Case) -> str:
    """The ranges of frequency with modes, and the gaps between them."""
    if not case.lattice:
        return _modes_of_patch(case.patch)
    ends, found = case.ends['complete'], case.lattice['complete']
    gaps = [units.in_words('Hz', low, high, digits=6) for (_, low), (high, _) in pairwise(ends) if high > low]
    return (f'{found.modes:.0f} branches from {units.in_words("Hz", ends[0, 0], ends[-1, 1], digits=6)}, most modes at '
            f'{_hertz(found, found.density.argmax())}; ' + (f'no modes from {" and ".join(gaps)}' if gaps else 'no gap'))


@REPORT.remark
def of_lattice(case: Case) -> list[str]:
    """Branches and gaps of the lattice in each model."""
    lines = [case.scene.title, *case.left]
    for model, found in case.lattice.items():
        ends, f = case.ends[model], found.frequencies_Hz
        lines.append(f'lattice, {model}: {found.modes:.0f} branches from {ends[0, 0]:.6g} to {ends[-1, 1]:.6g} Hz, most modes '
                     f'at {_hertz(found, found.density.argmax())}, in frequency bins of {f[1] - f[0]:.3g} Hz')
        lines += [f'  gap from {low:.6g} to {high:.6g} Hz' for (_, low), (high, _) in pairwise(ends)]
    return lines


@REPORT.remark
def of_patch(case: Case) -> str | None:
    """How well the density of the patch is known."""
    if (found := case.patch) is None:
        return None
    middle = len(found.omega) // 2
    return (f'{_modes_of_patch(found)}; {VECTORS} random vectors, standard error up to '
            f'{found.error.max() / found.density.max():.2g} of the highest density; resolution '
            f'{units.hertz(found.width[0]):.3g} Hz at low frequencies, {units.hertz(found.width[middle]):.3g} Hz at '
            f'{_hertz(found, middle)}')


@REPORT.remark
def unfolded_bands(case: Case) -> str | None:
    """What the picture spectral.png shows, the unfolded bands."""
    return case.unfolded and (f'spectral.png: the modes of the patch along {case.scene.band_path().path}, resolved to '
                              f'{units.hertz(case.unfolded.width[0]):.3g} Hz at low frequencies')


@REPORT.check
def others(case: Case) -> Finding:
    """How the omitted neighbours would change the frequencies of the lattice."""
    from .neighbours import omitted

    return Finding() if case.scene.finite else omitted(case.scene)


def _modes_of_patch(found: Any) -> str:
    return f'patch: {found.modes:.0f} free directions'


def _of_lattice(folder, atoms):
    from ..bands.density import band_ranges, lattice_density
    from ..plotting.density import plot_density
    from .band_report import ZERO_FRACTION

    wide = [lattice_density(atoms, model=model) for model in atoms.calc.bloch_models]
    omega = np.linspace(min(found.omega[0] for found in wide), max(found.omega[-1] for found in wide), FREQUENCIES)
    axes, densities, limits, names, columns = None, {}, {}, ['frequency_Hz'], [units.hertz(omega)]
    for model, style in zip(atoms.calc.bloch_models, ('-', '--'), strict=False):
        found = densities[model] = lattice_density(atoms, omega, model=model)
        found.save(folder / f'dos_{model}.npz')
        axes = plot_density(found, ax=axes, label=f'lattice, {model}', linestyle=style)
        names.append(f'{model}_share_per_Hz')
        columns.append(found.per_Hz)
        ends = units.hertz(band_ranges(atoms, model=model))
        limits[model] = np.where(abs(ends) < ZERO_FRACTION * ends.max(), 0.0, ends)
    write_columns(folder / 'dos.csv', names, columns)
    return axes, densities, limits


def _hertz(found, k):
    return units.in_words('Hz', found.frequencies_Hz[k])


def _of_patch(folder, patch, axes):
    from ..plotting.density import plot_density
    from ..response.spectral_density import density_of_states

    found = density_of_states(patch, moments=MOMENTS, vectors=VECTORS)
    found.save(folder / 'dos_patch.npz')
    axes = plot_density(found, ax=axes, label='patch', linewidth=1)
    error = found.error * found.per_Hz.max() / found.density.max()
    write_columns(folder / 'dos_patch.csv', ['frequency_Hz', 'share_per_Hz', 'standard_error_per_Hz', 'resolution_Hz'],
                  [found.frequencies_Hz, found.per_Hz, error, units.hertz(found.width)])
    return axes, found


def _unfolded(folder, save, lattice, patch, path):
    from ..bands.bands import analytic_bands
    from ..plotting.axes import legend_of_set
    from ..plotting.bands import plot_bands
    from ..plotting.density import plot_spectral_function
    from ..response.spectral_density import spectral_function

    found = spectral_function(patch, lattice, path.kpts, moments=SPECTRAL_MOMENTS)
    found.save(folder / 'spectral.npz')
    axes = plot_spectral_function(found, path)
    for model, style in zip(lattice.calc.bloch_models, ('-', '--'), strict=False):
        plot_bands(analytic_bands(lattice, path, model), ax=axes, label=f'lattice, {model}', linestyle=style, linewidth=0.8)
    axes.get_legend().remove()  # it is wider than the axes and would displace the colour bar
    legend_of_set(axes.figure)  # pyright: ignore[reportArgumentType]  no subfigure
    save(axes.figure, 'spectral')
    return found
