"""Tone bursts through the ideal lattice, each model over the branches of both."""

import numpy as np

from magphonon import read_scene, ready_scene, units
from magphonon.plotting.axes import legend_of_set, letter_panels, new_axes, panels
from magphonon.plotting.structures import plot_patch
from magphonon.plotting.waves import crossing
from magphonon.waves.spectrum import NORMAL
from magphonon.waves.wave_analysis import MODELS, waves

from .checks import Check, Outcome, save_picture
from .maps import RADIANS, finish_maps, plot_map, plot_signed

HALF_A_BIN = 0.5
BURSTS = {'shear': 'transverse', 'longitudinal': 'longitudinal'}  # branch and motion, in the order of the scene
SIDES = MODELS[::-1]   # conventional left, complete right, as in the paper
TOPS_Hz = 35.0, 105.0  # of the maps


def main(out):
    """Ridges on the branches of their own model and off those of the other; the maps, and the wave in the lattice."""
    scene = read_scene(ready_scene('ideal'))
    cell, checks, shear = scene.atoms(), [], {}
    figure, axes = panels(2, 2, height=2.3)
    letter_panels(axes, [f'{model} simulation, {motion} motion' for motion in BURSTS.values() for model in SIDES])
    for k, (branch, motion) in enumerate(BURSTS.items()):
        for ax, model in zip(axes[k], SIDES, strict=True):
            patch = scene.patch_atoms(model)
            site, passage = scene.burst.send(k, cell, patch)
            wave = waves(passage.row, cell, scene.burst.source)[0]
            checks += compared(f'{motion} burst, {model} simulation', wave, motion, model, branch)
            plot_map(ax, wave, scene.burst.carriers_Hz[k], TOPS_Hz[k])
            if branch == 'shear':
                shear[model] = passage
    finish_maps(figure, axes)
    for ax in axes[:, 1]:
        ax.secondary_yaxis('right', functions=RADIANS).set_ylabel(r'$\omega$ (rad/s)')
    maps = save_picture(figure, out / 'bursts.png',
                        'Fig. 6 of the paper: bursts at 120 and 400 rad/s. Every ridge lies on the branch of its own model: '
                        'shear tells the models apart, the longitudinal branch hardly moves.')
    return Outcome(checks, [draw_lattice(out, patch, site), maps, draw_crossing(out, patch, site, shear)])


def draw_lattice(out, patch, site):
    """The finite lattice with what drives it and where it is measured."""
    ax = plot_patch(patch, site, new_axes(5.5, 3.6))
    return save_picture(ax.figure, out / 'finite_lattice.png',
                        'Fig. 5 of the paper: the finite lattice, its rim held, with the row of sources and the measured row.')


def draw_crossing(out, patch, site, passages):
    """Horizontal displacement of both models at one time, when the faster wave is half way up the measured row."""
    figure, (axes,) = panels(1, 2, height=2.2)
    letter_panels(axes, SIDES)
    frame = crossing(passages['conventional'])
    fields = [passages[model].field.displacements[frame, :, 0] / (1e-6 * units.m) for model in SIDES]
    largest = np.abs(fields).max()
    for ax, field in zip(axes, fields, strict=True):
        image = plot_signed(ax, patch, field, largest, site)
        ax.set(xlabel='$x/L_0$', ylabel='$y/L_0$')
        ax.label_outer()
    figure.colorbar(image, ax=axes, label='$u_x/L_0$ ($10^{-6}$)', pad=0.02)
    legend_of_set(figure)
    time = passages['complete'].field.times[frame] / units.s
    return save_picture(figure, out / 'burst_crossing.png',
                        f'The burst of shear in both models at the same time, {time:.2f} s after its start: D* makes its waves '
                        'shorter and slower.')


def compared(record, wave, motion, model, branch):
    """The rows for one map: on its own branch, off the other model's, by how much for its uncertainty."""
    (other,) = set(MODELS) - {model}
    own, off = wave.misfits[model, branch], wave.misfits[other, branch]
    apart = {'shear': 5, 'longitudinal': 1}[branch]  # bins: D* hardly moves the longitudinal branch
    return [Check(f'{record}: strongest motion is the {motion} one', float(wave.motion == motion), 1.0, 0.0),
            Check(f'{record}: ridge off its own branch (bins)', own.bins, 0.0, HALF_A_BIN),
            Check(f'{record}: the same in its uncertainties', own.omega / own.sigma_omega, 0.0, NORMAL),
            Check(f'{record}: nearest branch with which the ridge agrees is its own',
                  float(wave.agrees_with[:1] == ((model, branch),)), 1.0, 0.0),
            Check(f'control: {record}: ridge off the {other} branch (bins)', off.bins, 0.0, apart, control=True),
            Check(f'control: {record}: the same in its uncertainties', off.omega / off.sigma_omega, 0.0, NORMAL, control=True)]
