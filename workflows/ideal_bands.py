"""Bands of the ideal triangular lattice, complete and conventional."""

import numpy as np
from ase.dft.kpoints import BandPath

from magphonon import MagneticRepulsion, analytic_bands, read_scene, units
from magphonon.bands import bloch_modes, sound_speeds
from magphonon.plotting.axes import letter_panels, new_axes, panels
from magphonon.plotting.bands import name_branches, plot_bands
from magphonon.plotting.modes import plot_mode
from magphonon.plotting.structures import plot_lattice
from magphonon.plotting.zone import plot_zone
from magphonon.scenes import ready_scene, reference

from .rows import BRANCHES, Check, Outcome, pairs, save_picture


def main(out):
    """Frequencies at M and K, sound speeds, and the smallest ratio of both models over the zone."""
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
    checks.append(Check('control: D0 alone at M shear (rad/s)', at_M, paper['M_complete'][0], 0.3, control='D0'))
    checks.append(Check('ideal step limit 2/omega_max (s)', 2 / bands['complete'].omega.max() / units.s, paper['dt_limit'], 1e-9))

    q = np.stack(np.meshgrid(np.arange(96), np.arange(96), 0), axis=-1).reshape(-1, 3)[1:] / 96  # without Gamma; M is on the mesh
    shear, without = (bloch_modes(cell, q, model)[0][:, 0] for model in ('complete', 'conventional'))
    checks.append(Check('smallest omega_complete / omega_conventional, shear', (shear / without).min(), 0.5, 1e-9))
    return Outcome(checks, [draw_lattice(out, cell), draw_bands(out, bands),
                            draw_mode(out, cell, bands['complete'])])


def draw_lattice(out, cell):
    """Draw the lattice with its vectors, and its zone, in the basis of the paper: R2 and R3, 60 degrees apart."""
    R1, R2 = cell.cell.array[:2]
    paper = cell.copy()
    paper.set_cell([R2, R2 - R1, cell.cell.array[2]])
    paper.calc = MagneticRepulsion(paper, cell.calc.laws)
    special = {'G': np.zeros(3), 'M': np.array([1 / 2, 1 / 2, 0]), 'K': np.array([2 / 3, 1 / 3, 0])}
    figure, (axes,) = panels(1, 2, height=2.9)
    plot_lattice(paper, ax=axes[0])
    for text in axes[0].texts:
        text.set_text(text.get_text().replace('_2', '_3').replace('_1', '_2'))  # as the paper numbers them
    plot_zone(BandPath(paper.cell, path='GMKG', special_points=special), ax=axes[1])
    axes[1].set_ylim(axes[1].get_xlim())  # as high as the other panel
    letter_panels(axes)
    return save_picture(figure, out / 'zone.png',
                        'Fig. 3 of the paper: (a) the lattice with its primitive vectors, (b) the first Brillouin zone with its '
                        'irreducible part, the path, and the axes of the phases per step along R2 and R3.')


def draw_bands(out, bands):
    """Draw both models along the path, in Hz and rad/s."""
    ax = new_axes()
    for (model, own), line in zip(bands.items(), ('-', '--'), strict=True):
        plot_bands(own, ax=ax, linestyle=line, label=model)
    name_branches(ax, bands['complete'])
    add_radians(ax)
    return save_picture(ax.figure, out / 'ideal_bands.png',
                        'Fig. 4 of the paper: D* halves the shear branch at M and hardly moves the longitudinal one.')


def draw_mode(out, cell, bands):
    """Draw the shear wave at M on the lattice."""
    ax = plot_mode(cell, bands, 'M', 0, ax=new_axes(height=3.4))
    ax.set_title('shear wave at M, ' + ax.get_title(loc='left').splitlines()[1].partition(',')[0], loc='left')
    return save_picture(ax.figure, out / 'mode_M.png',
                        'The shear wave at M at the time of its largest displacement: neighbouring rows slide past each '
                        'other (arrows); the grey lines are the paths of the particles.')


def add_radians(ax):
    """Add a scale of angular frequencies on the right of axes whose frequencies are in Hz."""
    there_and_back = (lambda f: 2 * np.pi * f), (lambda omega: omega / (2 * np.pi))
    ax.secondary_yaxis('right', functions=there_and_back).set_ylabel(r'$\omega$ (rad/s)')
    ax.tick_params(axis='y', right=False)
