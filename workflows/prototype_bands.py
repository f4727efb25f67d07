"""Bands of the prototype, magnets on pillars, by both methods."""

import numpy as np

from magphonon import MagneticRepulsion, analytic_bands, finite_displacements, phonopy_bands, read_scene, units
from magphonon.bands.force_constants import foundation_recovered
from magphonon.plotting.axes import COLOURS, new_axes
from magphonon.plotting.bands import name_branches, plot_bands
from magphonon.scenes import ready_scene, reference

from .rows import BRANCHES, Check, Outcome, pairs, save_picture


def main(out):
    """The numbers of the Supplement, analytic and by phonopy; the pillar's stiffness recovered from sums of force constants."""
    paper = reference()['prototype']
    scene = read_scene(ready_scene('prototype'))
    cell = scene.atoms()
    law, per_metre = cell.calc.laws, units.N / units.m
    checks = [
        Check('prototype force at the spacing (N)', -law.dphi(10 * units.mm) / units.N, paper['f_at_spacing'], 1e-9),
        Check('prototype df/dr at the spacing (N/m)', -law.d2phi(10 * units.mm) / per_metre, paper['df_dr_at_spacing'], 1e-9),
        Check('pillar stiffness (N/m)', cell.calc.parameters.foundation / per_metre, paper['k_eq'], 1e-9),
    ]
    corners = cell.cell.bandpath('GMK', npoints=3, pbc=cell.pbc)
    phonon = finite_displacements(cell)
    methods = {
        'complete': analytic_bands(cell, corners),
        'conventional': analytic_bands(cell, corners, 'conventional'),
        'phonopy': phonopy_bands(phonon, corners),
    }
    for name, bands in methods.items():
        model, tolerance = ('complete', 1e-8) if name == 'phonopy' else (name, 1e-9)
        at_G, at_M, at_K = bands.frequencies_Hz
        checks += pairs(f'prototype cut-off, {name} (Hz)', at_G, 2 * [paper['gamma_Hz']], tolerance, BRANCHES)
        checks += pairs(f'prototype M, {name} (Hz)', at_M, paper[f'M_{model}_Hz'], tolerance, BRANCHES)
        checks += pairs(f'prototype K, {name} (Hz)', at_K, 2 * [paper[f'K_{model}_Hz']], tolerance, BRANCHES)
    bare = cell.copy()
    bare.calc = MagneticRepulsion(bare, law)
    at_M = analytic_bands(bare, corners).frequencies_Hz[1]
    checks += pairs('prototype M without pillars (Hz)', at_M, paper['M_no_foundation_Hz'], 1e-9, BRANCHES)
    recovered = foundation_recovered(phonon)[0, 0, 0] / per_metre
    checks.append(Check('foundation recovered from phonopy row sums (N/m)', recovered, paper['k_eq'], 1e-8))
    checks.append(Check('control: D0 alone, M shear against phonopy (Hz)', methods['conventional'].frequencies_Hz[1, 0],
                        methods['phonopy'].frequencies_Hz[1, 0], 0.3, control='D0', by='two methods'))

    path = scene.band_path()
    complete = analytic_bands(cell, path, vectors=True)
    ax = plot_bands(complete, label='complete')
    plot_bands(analytic_bands(cell, path, 'conventional'), ax=ax, linestyle='--', label='conventional')
    plot_bands(phonopy_bands(phonon, path), ax=ax, linestyle='', marker='.', label='phonopy')
    name_branches(ax, complete)
    return Outcome(checks, [draw_foundation(out, cell), save_picture(
        ax.figure, out / 'prototype_bands.png',
        'Fig. S4 of the paper: the prototype. D* lowers its shear branch; the pillars open the gap below 26.55 Hz.')])


def draw_foundation(out, cell):
    """Draw the lattice in space, with the spring between each magnet and the ground."""
    ax, up = new_axes(height=2.2), 1.2                       # in spacings
    R = cell.cell.array[:2, :2] / cell.cell.lengths()[0]
    seen = np.array([[1.0, 0.0], [0.35, 0.45]])               # of x and y in the plane of the paper
    places = np.stack(np.meshgrid(np.arange(4), np.arange(3), indexing='ij'), axis=-1) @ R @ seen
    for line in (*places, *places.swapaxes(0, 1), *(places[::-1].diagonal(k).T for k in range(-2, 3))):
        ax.plot(*line.T, color='0.7', linewidth=0.8, zorder=1)
    height = np.linspace(-up, 0, 12)
    zigzag = 0.07 * np.array([0, 0, *[1, -1] * 4, 0, 0])
    for x, y in places.reshape(-1, 2):
        ax.plot(x + zigzag, y + height, color=COLOURS[0], linewidth=0.9, zorder=2 - y)
        ax.plot([x - 0.15, x + 0.15], [y - up, y - up], color='0.25', linewidth=1.4)
        ax.plot(x, y, 'o', color='0.25', markerfacecolor='white', markersize=7, zorder=20 - y)
    ax.set(aspect='equal')
    ax.set_axis_off()
    return save_picture(ax.figure, out / 'foundation.png', (
        'Fig. S1 of the paper: the lattice on its elastic foundation. The grey lines are the repulsion between nearest '
        'neighbours, the springs are the pillars, each of which ties a magnet to the ground along both directions of the plane.'))
