"""`magphonon bands SCENE`: bands of a scene, by the Bloch matrix and by phonopy; with [uncertainty], as ribbons of two standard
deviations.

The exit status is 1 if phonopy's bands are not those of the Bloch matrix. It is 0 even if the lattice buckles; "magphonon check"
reports that with status 1.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from dataclasses import replace

from .. import units
from ..files import write_columns
from .arguments import add_output, add_scene, add_style, answering

HELP = 'the bands of a lattice with D* and without it, beside those of phonopy'


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser)
    add_style(parser)


def run(options: Namespace) -> int:
    from ..bands.bands import analytic_bands
    from ..scenes.scene import read_scene
    from .band_report import disagreement, report

    scene = read_scene(options.scene)
    with answering(options, scene, 'bands.*', 'bands_*.*', 'band.yaml', 'phonopy_*.yaml', 'zone.*') as (folder, save, told):
        atoms, path, plan = scene.perfect_cell(), scene.band_path(), scene.wanted('bands')
        bands, phonon = _bands(scene, atoms, path)
        lossy = analytic_bands(atoms, path, damping=plan.damping_of(atoms)) if plan.damping_per_s is not None else None
        _save(folder, bands | ({'damped': lossy} if lossy is not None else {}), phonon)
        spread = None if scene.uncertainty is None else _spread(scene, path, folder)
        _draw(save, scene, atoms, bands, spread)
        told += report(scene, atoms, bands, phonon, lossy, spread, options.verbose)
    return int(bool(disagreement(scene, bands)))


def _bands(scene, atoms, path):
    """The bands of both models and of phonopy, and phonopy's object; None without phonopy or for velocity-dependent forces.

    Heavy pillars have their stiffness at the frequency of each wave.
    """
    from ..bands.bands import analytic_bands
    from ..bands.force_constants import finite_displacements, phonopy_bands
    from ..stability.verdicts import verdict

    def with_pillars(found):
        return replace(found, omega=scene.foundation.slowed(found.omega, atoms.get_masses())) if scene.foundation else found

    bands = {model: analytic_bands(atoms, path, model, vectors=True) for model in atoms.calc.bloch_models}
    if not bands['complete'].omega.any():
        raise ValueError(f'all bands are zero: {verdict(atoms).finding("buckling").words}')
    if atoms.calc.turning:  # displacements alone do not show it
        return bands, None
    try:
        phonon = finite_displacements(atoms, scene.supercell())
    except ModuleNotFoundError:
        return {name: with_pillars(found) for name, found in bands.items()}, None
    except ValueError as error:
        given = scene.wanted('bands').supercell or scene.supercell()
        raise ValueError(f'bands.supercell = {list(given)}: {error}') from None
    bands['phonopy'] = phonopy_bands(phonon, path, vectors=True)
    return {name: with_pillars(found) for name, found in bands.items()}, phonon


def _spread(scene, path, folder):
    """Standard deviations of the bands of the complete model due to [uncertainty], written into the folder."""
    from ..design.uncertainty import frequency_spread

    counted = scene.counted()
    spread = frequency_spread(counted.perfect_cell(), path.kpts, scene.uncertainty.tolerances(counted))
    spread.save(folder / 'bands_spread.npz')
    branches = range(1, spread.values.shape[1] + 1)
    write_columns(folder / 'bands_spread.csv', ['path_rad_per_m', *(f'std_{branch}_Hz' for branch in branches)],
                  [path.get_linear_kpoint_axis()[0] * units.m, *units.hertz(spread.std.T)],
                  missing=[f'std_{branch}_Hz' for branch in branches])  # a frequency of zero has no slope
    return spread


def _save(folder, bands, phonon):
    from ..bands.phonopy_files import write_band_yaml, write_phonopy_params
    from .band_report import LEAST_WRITTEN_N_per_mm

    path = bands['complete'].path
    names, columns = ['path_rad_per_m', 'q1', 'q2', 'q3'], [path.get_linear_kpoint_axis()[0] * units.m, *path.kpts.T]
    for name, result in bands.items():
        result.save(folder / f'bands_{name}.npz')
        names += [f'{name}_{mode + 1}_Hz' for mode in range(result.omega.shape[1])]
        columns += [*result.frequencies_Hz.T]
        if result.decay is not None:
            names += [f'{name}_{mode + 1}_decay_per_s' for mode in range(result.decay.shape[1])]
            columns += [*result.decay.T * units.s]
    write_columns(folder / 'bands.csv', names, columns)
    if phonon is None:
        return
    write_band_yaml(phonon, path, folder / 'band.yaml')
    if abs(phonon.force_constants).max() > LEAST_WRITTEN_N_per_mm:
        write_phonopy_params(phonon, folder / 'phonopy_params.yaml')


def _draw(save, scene, atoms, bands, spread):
    from ..bands.bloch import PLANAR
    from ..plotting.bands import name_branches, plot_bands
    from ..plotting.response import plot_band_ribbons
    from ..plotting.zone import plot_zone
    from ..scenes.laws import ALL

    complete = 'complete, $D^0+D^{*}$'
    ax = plot_bands(bands['complete'], label=complete) if spread is None else plot_band_ribbons(bands['complete'], spread,
                                                                                                label=complete)
    if 'conventional' in bands:
        plot_bands(bands['conventional'], ax=ax, linestyle='--', label='conventional, $D^0$')
    if 'phonopy' in bands:
        name = 'phonopy' if scene.law.shells != ALL else 'phonopy, interpolated'
        plot_bands(bands['phonopy'], ax=ax, linestyle='', marker='o', fillstyle='none', label=name)
    name_branches(ax, bands['complete'])
    save(ax.figure, 'bands')
    if tuple(atoms.pbc) == PLANAR:
        save(plot_zone(bands['complete'].path).figure, 'zone')
