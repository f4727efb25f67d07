"""Fig. 6: tone bursts through the ideal lattice, each model over the branches of both."""

from magphonon import read_scene, ready_scene
from magphonon.plotting.axes import panels
from magphonon.plotting.waves import crossing, plot_snapshot, plot_wave
from magphonon.waves.spectrum import NORMAL
from magphonon.waves.wave_analysis import MODELS, waves

from .checks import Check, Outcome, save_picture

HALF_A_BIN = 0.5
BURSTS = {'shear': 'transverse', 'longitudinal': 'longitudinal'}  # branch and motion, in the order of the scene


def main(out):
    """Ridges on the branches of their own model and off those of the other; the maps, and the wave in the lattice."""
    scene = read_scene(ready_scene('ideal'))
    cell, checks, snapshots = scene.atoms(), [], []
    figure, axes = panels(2, 2)
    for k, (branch, motion) in enumerate(BURSTS.items()):
        for ax, model in zip(axes[k], MODELS, strict=True):
            patch = scene.patch_atoms(model)
            site, passage = scene.burst.send(k, cell, patch)
            wave = waves(passage.row, cell, scene.burst.source)[0]
            checks += compared(f'{motion} burst, {model} simulation', wave, motion, model, branch)
            plot_wave(wave, ax).get_legend().set_title(f'{model} simulation, {motion} motion')
            if branch == 'shear':
                snapshots.append((patch, passage.field, crossing(passage), site))
    pictures = [save_picture(figure, out / 'bursts.png',
                             'Fig. 6: bursts at 120 and 400 rad/s; every ridge lies on the branch of its own model.')]
    figure, axes = panels(1, 2)
    for ax, snapshot in zip(axes[0], snapshots, strict=True):
        plot_snapshot(*snapshot, ax)
    pictures.append(save_picture(figure, out / 'burst_crossing.png',
                                 'The shear burst in both models, each when it has reached the middle of the measured row.'))
    return Outcome(checks, pictures)


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
