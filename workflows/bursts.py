"""Tone bursts through the ideal lattice: the ridges of each model over the branches of both."""

from dataclasses import replace

import numpy as np

from magphonon import read_scene, units
from magphonon.plotting.axes import new_axes
from magphonon.plotting.structures import plot_patch
from magphonon.plotting.waves import crossing, plot_crossing, plot_waves
from magphonon.scenes import ready_scene
from magphonon.waves.spectrum import NORMAL
from magphonon.waves.wave_analysis import MODELS, Branch, branch, compare, waves
from magphonon.waves.wave_source import polarisations, wavevector

from . import ase_loop
from .closed_forms import IDEAL, along_the_row
from .ideal_bands import add_radians
from .rows import Check, Outcome, save_picture

NEAR = 0.3  # bins: a force that is 10 % wrong moves a ridge by 0.47 bins or more
BURSTS = {'shear': 'transverse', 'longitudinal': 'longitudinal'}  # branch and motion, in the order of the scene
SIDES = MODELS[::-1]   # conventional left, complete right, as in the paper
TOPS_Hz = 50.0, 105.0  # of the maps
ACROSS = 5             # magnets on either side of the measured row, together as wide as a wave of shear is long
NEARLY_PLANE = 1 / 3   # spread of the motion along a front, in amplitudes: the row of sources ends; from a point it is 1.6


def main(out):
    """The ridges lie on the branches of their own model and off those of the other; maps, and the wave in the lattice."""
    scene = read_scene(ready_scene('ideal'))
    cell, checks, maps, shear = scene.atoms(), [], [], {}
    patches = {model: scene.patch_atoms(model) for model in SIDES}
    for k, (name, motion) in enumerate(BURSTS.items()):
        maps.append([])
        for model, patch in patches.items():
            site, passage = scene.burst.send(k, cell, patch, engine='compiled')
            wave = waves(passage.row, cell, scene.burst.source)[0]
            checks += compared(f'{motion} burst, {model} simulation', wave, motion, model, name)
            maps[-1].append(wave)
            if model == 'complete':
                checks.append(Check(f'{motion} burst: spread of the motion along a front behind the row of sources (amplitudes)',
                                    spread(patch, cell, site, passage, motion), 0, NEARLY_PLANE, by='two methods'))
            if name == 'shear':
                shear[model] = patch, site, passage
    checks += drawn_branches(cell)
    patch = patches['complete']
    checks += ase_loop.burst(scene, cell, patch, 0, shear['complete'][2].row,
                             lambda record, wave: compared(record, wave, 'transverse', 'complete', 'shear'))
    point = scene.burst.model_copy(update={'source': 'point'})
    checks.append(Check('control: transverse burst from a point: spread of the motion along a front (amplitudes)',
                        spread(patch, cell, *point.send(0, cell, patch), 'transverse'), 0, NEARLY_PLANE,
                        control='a point source'))
    lattice = plot_patch(patch, site, ax=new_axes(5.5, 3.6)).figure
    return Outcome(checks, [
        save_picture(lattice, out / 'finite_lattice.png',
                     'Fig. 5 of the paper: the finite lattice, its rim held, with the row of sources and the measured row.'),
        draw_maps(out, maps, scene.burst.carriers_Hz),
        save_picture(plot_crossing(shear), out / 'burst_crossing.png',
                     'The same shear burst in both models, when the faster burst is half way up the measured row: '
                     'D* makes the waves shorter and slower.')])


def spread(patch, cell, site, passage, motion):
    """Largest difference of the motion along a front in the second quarter of the measured row, when the burst is half way."""
    u = passage.field.displacements[crossing(passage)] @ polarisations(cell, 'row')[motion]
    x, y = (patch.calc.reference.positions[:, :2] / cell.cell.lengths()[0]).T
    quarter = site.row[len(site.row) // 4:len(site.row) // 2]
    fronts = [(abs(y - y[at]) < 0.1) & (abs(x - x[at]) < ACROSS + 0.5) for at in quarter]
    return max(np.ptp(u[front]) for front in fronts) / abs(u[site.row[len(quarter):]]).max()


def draw_maps(out, maps, carriers_Hz):
    """Draw both models side by side; each row of maps has one scale, up to the highest frequency of its branches."""
    names = [f'{model} simulation, {motion} motion' for motion in BURSTS.values() for model in SIDES]
    figure, axes = plot_waves(maps, names, carriers_Hz)
    for row, top in zip(axes, TOPS_Hz, strict=True):
        for ax in row:
            ax.set_ylim(0, top)
        add_radians(row[1])
    return save_picture(figure, out / 'bursts.png',
                        'Fig. 6 of the paper: bursts at 120 and 400 rad/s. Every ridge lies on the branch of its own model. '
                        'The shear branches of the two models differ, the longitudinal ones hardly do.')


def closed_branch(magnets, source, branch, model):
    """A branch in closed form, which the package has no part in."""
    xi = np.linspace(0, np.pi, 2001)
    return Branch(xi, along_the_row(magnets, source, xi, model == 'complete')[:, list(BURSTS).index(branch)] / units.s)


def drawn_branches(cell):
    """Rows for the branches over which the ridges are drawn: the package's against the closed form."""
    for mode, name in enumerate(BURSTS):
        drawn, exact = branch(cell, wavevector(cell, 'row'), mode), closed_branch(IDEAL, 'row', name, 'complete')
        yield Check(f'{name} branch as drawn, Gamma-M: largest error / highest frequency',
                    abs(drawn.omega - exact.omega).max() / exact.omega.max(), 0, 1e-7)  # a root of round-off at Gamma


def distance(wave, branch):
    """Distance of the ridge of a wave from a branch; the uncertainty includes what oblique waves may add."""
    return compare(replace(wave.ridge, sigma_xi=wave.sigma_xi), branch)


def compared(record, wave, motion, model, branch):
    """Rows for one map: distance of the ridge from its own branch and that of the other model, in bins and in uncertainties."""
    (other,) = set(MODELS) - {model}
    exact = distance(wave, closed_branch(IDEAL, 'row', branch, model))
    own, off = wave.misfits[model, branch], wave.misfits[other, branch]  # with the branches of the package
    apart = {'shear': 5, 'longitudinal': 1}[branch]  # bins: D* hardly moves the longitudinal branch
    return [Check(f'{record}: the strongest motion is {motion}', float(wave.motion == motion), 1.0, 0.0, by='two methods'),
            Check(f'{record}: distance to its own branch (bins)', exact.bins, 0.0, NEAR),
            Check(f'{record}: distance to its own branch / uncertainty', own.omega / own.sigma_omega, 0.0, NORMAL,
                  by='two methods'),
            Check(f'{record}: of the branches with which the ridge agrees, its own is the nearest',
                  float(wave.agrees_with[:1] == ((model, branch),)), 1.0, 0.0, by='two methods'),
            Check(f'control: {record}: distance to the {other} branch (bins)', off.bins, 0.0, apart, control='D0'),
            Check(f'control: {record}: distance to the {other} branch / uncertainty',
                  off.omega / off.sigma_omega, 0.0, NORMAL, control='D0')]
