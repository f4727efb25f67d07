"""`magphonon bands SCENE`: bands of a scene, by the Bloch matrix and by phonopy.

The exit status is 1 if phonopy's bands are not those of the Bloch matrix. It is 0 even if the lattice buckles; "magphonon check"
reports that with status 1.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from .. import units
from ..errors import PhysicsError
from ..files import write_columns
from .arguments import add_output, add_pictures, add_scene, answering

HELP = 'the bands of a lattice with D* and without it, beside those of phonopy'
RESULTS = 'bands.*', 'bands_*.npz', 'band.yaml', 'phonopy_params.yaml', 'zone.*'


def add_arguments(parser: ArgumentParser) -> None:
    add_scene(parser)
    add_output(parser)
    add_pictures(parser)


def run(options: Namespace) -> int:
    from ..bands.bands import analytic_bands
    from ..scenes.scene import read_scene
    from .band_report import REPORT, Case

    scene, status = read_scene(options.scene), 0
    with answering(options, scene) as (folder, save, told):
        atoms, path, plan = scene.perfect_cell(), scene.band_path(), scene.wanted('bands')
        if scene.foundation is not None and scene.foundation.modulation is not None:
            told += _floquet(folder, save, atoms, path, plan, options.fmax)
        else:
            bands, phonon = _bands(scene, atoms, path)
            lossy = analytic_bands(atoms, path, damping=plan.damping_of(atoms)) if plan.damping_per_s is not None else None
            _save(folder, bands | ({'damped': lossy} if lossy is not None else {}), phonon)
            hot = _thermal_run(folder, plan, scene, atoms, path) if plan.temperature_J is not None else None
            _draw(save, scene, bands, options.fmax, hot)
            case = Case(scene, atoms, bands, phonon, lossy, hot)
            told += REPORT.told(case, options.verbose)
            status = int(REPORT.find('two_roads', case).fault)
    return status


def _bands(scene, atoms, path):
    """The bands of both models and of phonopy, and phonopy's object; None without phonopy or for velocity-dependent forces."""
    from ..bands.bands import analytic_bands
    from ..bands.force_constants import finite_displacements, phonopy_bands

    bands = {model: analytic_bands(atoms, path, model, vectors=True) for model in atoms.calc.bloch_models}
    if np.any(atoms.calc.rate):  # displacements alone do not show it
        return bands, None
    try:
        phonon = finite_displacements(atoms, scene.supercell())
    except ModuleNotFoundError:
        return bands, None
    except ValueError as error:
        given = scene.wanted('bands').supercell or scene.supercell()
        raise ValueError(f'bands.supercell = {list(given)}: {error}') from None
    return bands | {'phonopy': phonopy_bands(phonon, path, vectors=True)}, phonon


def _floquet(folder, save, atoms, path, plan, highest_Hz):
    """Compute, save and draw Floquet bands along a path and back, and return the lines that report them."""
    from ..bands.floquet import floquet_bands
    from ..plotting.floquet import plot_floquet
    from .band_report import floquet_report

    damping = 0.0 if plan.damping_per_s is None else plan.damping_of(atoms)
    q, x = np.concatenate([-path.kpts[::-1], path.kpts]), path.get_linear_kpoint_axis()[0]
    x = np.concatenate([-x[::-1], x])
    bands = {model: floquet_bands(atoms, q, model, damping) for model in atoms.calc.bloch_models}
    names, columns = ['path_rad_per_m', 'q1', 'q2', 'q3'], [x * units.m, *q.T]
    for model, found in bands.items():
        for k in range(found.omega.shape[1]):
            names += [f'{model}_{k + 1}_Hz', f'{model}_{k + 1}_growth_per_s', f'{model}_{k + 1}_weight']
            columns += [found.frequencies_Hz[:, k].real, np.imag(found.omega[:, k]) * units.s, found.weight[:, k]]
    write_columns(folder / 'bands.csv', names, columns)
    ax = plot_floquet(bands['complete'], x)
    ax.set_ylim(top=highest_Hz)
    save(ax.figure, 'bands')
    return floquet_report(bands, x)


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


def _draw(save, scene, bands, highest_Hz, hot=None):
    from ..bands.zone import PLANAR
    from ..plotting.bands import name_branches, plot_bands, plot_thermal
    from ..plotting.zone import plot_zone
    from ..scenes.laws import ALL

    ax = plot_bands(bands['complete'], label='complete, $D^0+D^*$')
    if 'conventional' in bands:
        plot_bands(bands['conventional'], ax=ax, linestyle='--', label='conventional, $D^0$')
    if 'phonopy' in bands:
        name = 'phonopy' if scene.law.shells != ALL else 'phonopy, interpolated'
        plot_bands(bands['phonopy'], ax=ax, linestyle='', marker='o', fillstyle='none', label=name)
    if hot is not None:
        plot_thermal(ax, hot, bands['complete'].path)
    ax.set_ylim(top=highest_Hz)  # before the names of the branches, which are placed within the visible range
    name_branches(ax, bands['complete'])
    save(ax.figure, 'bands')
    if tuple(scene.perfect_cell().pbc) == PLANAR:
        save(plot_zone(bands['complete'].path).figure, 'zone')


def _thermal_run(folder, plan, scene, atoms, path):
    """Thermal bands at the special points that fit into the supercell."""
    from ..bands.bands import points_on
    from ..bands.bloch import bloch_modes
    from ..dynamics.cages import Diverged
    from ..waves.thermal import fits, thermal_run
    from .band_report import ZERO_FRACTION

    repeats, points = scene.supercell(), points_on(path)
    q = np.array([points[name] for name in sorted(points)])
    linear = bloch_modes(atoms, q)[0]
    q = q[fits(q, np.diag(repeats)) & (linear.min(axis=1) > ZERO_FRACTION * linear.max())]  # not Gamma without a foundation
    try:
        hot = thermal_run(atoms, repeats, plan.temperature_J * units.J, q)
    except Diverged as error:
        raise PhysicsError(f'bands.temperature_J = {plan.temperature_J:g} tears the lattice apart: after '
                           f'{error.time / units.s:.4g} s particle {error.particle} had left its neighbours; lower the '
                           'temperature, or give a stiffer foundation if the lattice buckles ("magphonon check")') from None
    hot.save(folder / 'bands_thermal.npz')
    return hot
