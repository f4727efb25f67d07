"""Fig. 4: bands of the ideal triangular lattice, complete and conventional."""

import numpy as np

from magphonon import analytic_bands, read_scene, ready_scene, sound_speeds, units
from magphonon.bands import frequency_ratio, zone_map
from magphonon.plotting.bands import plot_bands
from magphonon.plotting.modes import plot_mode
from magphonon.plotting.zone import plot_isofrequency, plot_ratio, plot_zone
from magphonon.scenes.scene import reference

from .checks import BRANCHES, Check, Outcome, pairs, save_picture


def main(out):
    """Frequencies at M and K, sound speeds, and the maps over the zone."""
    paper = reference()['triangular']
    cell = read_scene(ready_scene('ideal')).atoms()
    path = cell.cell.bandpath('GMKG', npoints=300, pbc=cell.pbc)
    corners = cell.cell.bandpath('MK', npoints=2, pbc=cell.pbc)
    checks = []
    bands = {}
    for model in ('complete', 'conventional'):
        at_M, at_K = analytic_bands(cell, corners, model).omega / (units.rad / units.s)
        checks += pairs(f'ideal M, {model} (rad/s)', at_M, paper[f'M_{model}'], 1e-9, BRANCHES)
        checks += pairs(f'ideal K, {model} (rad/s)', at_K, 2 * [paper[f'K_{model}']], 1e-9, BRANCHES)
        suffix = '' if model == 'complete' else '_conventional'
        speeds = sound_speeds(cell, (1, 0), model) / (units.m / units.s)
        checks += pairs(f'ideal sound speeds, {model} (m/s)', speeds, [paper[f'c_T{suffix}'], paper[f'c_L{suffix}']], 1e-9,
                        BRANCHES)
        bands[model] = analytic_bands(cell, path, model, vectors=True)
    at_M = analytic_bands(cell, corners, 'conventional').omega[0, 0] / (units.rad / units.s)
    checks.append(Check('control: D0 alone at M shear (rad/s)', at_M, paper['M_complete'][0], 0.3, control=True))
    checks.append(Check('ideal step limit 2/omega_max (s)', 2 / bands['complete'].omega.max() / units.s, paper['dt_limit'], 1e-9))

    complete, conventional = (zone_map(cell, model=model) for model in ('complete', 'conventional'))
    ratio = frequency_ratio(complete, conventional)
    checks.append(Check('smallest omega_complete / omega_conventional, shear', np.nanmin(ratio[..., 0]), 0.5, 1e-9))
    ax = plot_bands(bands['complete'], label='complete')
    plot_bands(bands['conventional'], ax=ax, linestyle='--', label='conventional')
    pictures = [
        save_picture(ax.figure, out / 'ideal_bands.png',
                     'Fig. 4: D* halves the shear branch at M and hardly moves the longitudinal one.'),
        save_picture(plot_zone(bands['complete'].path).figure, out / 'zone.png', 'The first Brillouin zone and the path.'),
        save_picture(plot_mode(cell, bands['complete'], 'M', 0).figure, out / 'mode_M.png', 'The shear mode at M.'),
        save_picture(plot_ratio(complete, conventional, 0).figure, out / 'ratio_shear.png',
                     'Where in the zone the shear branch falls: the mode-selective shift.'),
        save_picture(plot_ratio(complete, conventional, 1).figure, out / 'ratio_longitudinal.png',
                     'The same for the upper branch.'),
        save_picture(plot_isofrequency(complete, conventional, 0).figure, out / 'isofrequency_shear.png',
                     'Contours of the shear branch with the directions of the group velocity.'),
    ]
    return Outcome(checks, pictures)
