"""`magphonon dos SCENE`: density of states of the lattice and of the patch, and the bands of the patch unfolded."""

from __future__ import annotations

from itertools import pairwise
from typing import TYPE_CHECKING

import numpy as np

from .. import units
from ..files import write_columns
from .arguments import add_output, add_pictures, add_scene, drawing, lattice_and_patch

if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from ..scenes.scene import Scene
    from .costs import Cost

HELP = 'density of states of the lattice and of a patch, and the unfolded bands of the patch'
RESULTS = 'dos.*', 'dos_*', 'spectral.*'
FREQUENCIES = 400  # number of bins of the density of a lattice
MOMENTS, VECTORS, SPECTRAL_MOMENTS = 512, 16, 256
"""Chebyshev moments and random vectors of the density of a patch, moments of its spectral function: they resolve 0.3 % and 0.6 %
of the highest frequency."""
WAVEVECTORS = 60  # number of wavevectors along the path
COLUMNS_bytes = 2900  # memory for one particle with its share of the matrix and of the random vectors


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser)
    add_pictures(parser)


def run(options: Namespace) -> None:
    from ..scenes.scene import read_scene
    from .costs import refuse_cost
    from .neighbours import neighbours
    from .results import results

    scene = read_scene(options.scene)
    refuse_cost(scene, cost(scene))
    lattice, patch, lines = lattice_and_patch(scene)
    with results(options, scene) as folder, drawing(options, folder, scene.title) as save:
        report, axes = [scene.title, *lines], None
        if lattice is not None:
            axes, told = _of_lattice(folder, lattice)
            report += told
        if patch is not None:
            axes, told = _of_patch(folder, patch, axes)
            report += told
            if lattice is not None and scene.bands is not None:
                path = scene.lattice.path(scene.bands.path, WAVEVECTORS)  # pyright: ignore[reportAttributeAccessIssue]  no oscillator
                report += _unfolded(folder, save, lattice, patch, path)
        save(axes.figure, 'dos')
    print('\n'.join([*report, *neighbours(scene, brief=True)]))
    print(f'pictures and data are in {options.output}')


def cost(scene: Scene) -> Cost:
    """Estimated cost of the command."""
    from .costs import Cost, PICTURES_bytes, particles_of, size_key

    return Cost('dos', {size_key(scene): PICTURES_bytes + COLUMNS_bytes * particles_of(scene)}, 9)


def _of_lattice(folder, atoms):
    from ..bands.density import band_ranges, lattice_density
    from ..plotting.density import plot_density
    from .band_report import ZERO_FRACTION

    wide = [lattice_density(atoms, model=model) for model in atoms.calc.bloch_models]
    omega = np.linspace(min(found.omega[0] for found in wide), max(found.omega[-1] for found in wide), FREQUENCIES)
    axes, report, names, columns = None, [], ['frequency_Hz'], [units.hertz(omega)]
    for model, style in zip(atoms.calc.bloch_models, ('-', '--'), strict=False):
        found = lattice_density(atoms, omega, model=model)
        found.save(folder / f'dos_{model}.npz')
        axes = plot_density(found, ax=axes, label=f'lattice, {model}', linestyle=style)
        names.append(f'{model}_share_per_Hz')
        columns.append(found.per_Hz)
        ends = units.hertz(band_ranges(atoms, model=model))
        ends = np.where(abs(ends) < ZERO_FRACTION * ends.max(), 0.0, ends)
        report.append(f'lattice, {model}: {found.modes:.0f} branches from {ends[0, 0]:.6g} to {ends[-1, 1]:.6g} Hz, most modes '
                      f'at {_hertz(found, found.density.argmax())}, in bins of {units.hertz(omega[1] - omega[0]):.3g} Hz')
        report += [f'  gap from {low:.6g} to {high:.6g} Hz' for (_, low), (high, _) in pairwise(ends)]
    write_columns(folder / 'dos.csv', names, columns)
    return axes, report


def _hertz(found, k):
    return f'{found.frequencies_Hz[k]:.4g} Hz'


def _of_patch(folder, patch, axes):
    from ..plotting.density import plot_density
    from ..response.spectral_density import density_of_states

    found = density_of_states(patch, moments=MOMENTS, vectors=VECTORS)
    found.save(folder / 'dos_patch.npz')
    axes = plot_density(found, ax=axes, label='patch', linewidth=1)
    error = found.error * found.per_Hz.max() / found.density.max()
    write_columns(folder / 'dos_patch.csv', ['frequency_Hz', 'share_per_Hz', 'standard_error_per_Hz', 'resolution_Hz'],
                  [found.frequencies_Hz, found.per_Hz, error, units.hertz(found.width)])
    middle = len(found.omega) // 2
    return axes, [f'patch: {found.modes:.0f} free directions; {VECTORS} random vectors, standard error up to '
                  f'{found.error.max() / found.density.max():.2g} of the highest density; resolution '
                  f'{units.hertz(found.width[0]):.3g} Hz at low frequencies, {units.hertz(found.width[middle]):.3g} Hz at '
                  f'{_hertz(found, middle)}']


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
    return [f'spectral.png: the modes of the patch along {path.path}, resolved to {units.hertz(found.width[0]):.3g} Hz at low '
            'frequencies']
