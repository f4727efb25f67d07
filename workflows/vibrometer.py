"""Fig. 9: the prototype under a virtual vibrometer, and below its cut-off, where waves decay."""

import numpy as np

from magphonon import read_scene, ready_scene, units
from magphonon.bursts import send
from magphonon.evanescent import complex_bands, measured_decay
from magphonon.plotting import COLOURS, legend_above, new_axes
from magphonon.sites import polarisations, site, wavevector
from magphonon.waveplots import panels, plot_wave
from magphonon.waves import MODELS, waves

from .checks import Check, Outcome, save_picture

HALF_A_BIN = 0.5
GAP = 2 * np.pi * 15 * units.Hz   # the carrier below the cut-off of 26.55 Hz; the rest is chosen
CYCLES, DURATION = 10, 800 * units.ms
# Source, direction of its force and the motion that it drives; steps where that wave rules, which the fit takes:
# near a point all others decay first, while behind a row, whose ends send longitudinal waves, the first steps are clean.
# From a point the models are 3.7 % apart, and the steps of the fit move it by 2 %: only the row has the other as its control.
DECAYS = {'point': ((0, 1), 'longitudinal', slice(6, 16), None), 'row': ((1, 0), 'transverse', slice(4), 0.3)}


def main(out):
    """Ridges of the four bursts at the resolution of the row, and decay lengths against the complex wavenumber."""
    scene = read_scene(ready_scene('prototype'))
    checks, pictures = maps(scene, out)
    more, picture = gap(scene, out)
    return Outcome(checks + more, [*pictures, picture])


def maps(scene, out):
    """Transverse motion along the row, both models, as the vibrometer sees it."""
    cell, plan, checks = scene.atoms(), scene.burst, []
    figure, axes = panels(len(plan.carriers_Hz), 2)
    for k, carrier in enumerate(plan.carriers_Hz):
        for ax, model in zip(axes[k], MODELS, strict=True):
            (other,) = set(MODELS) - {model}
            _, passage = plan.send(k, cell, scene.patch_atoms(model))
            found = waves(scene.vibrometer.measure(passage.row, seed=k), cell, plan.source)
            wave = next(wave for wave in found if wave.motion == 'transverse')
            record, misfits = f'vibrometer {carrier:g} Hz, {model} simulation', wave.misfits
            checks += [Check(f'{record}: ridge off its own shear branch (bins)', misfits[model, 'shear'].bins, 0, HALF_A_BIN),
                       Check(f'control: {record}: ridge off the {other} shear branch (bins)', misfits[other, 'shear'].bins, 0,
                             1, control=True)]
            plot_wave(wave, ax).get_legend().set_title(f'{model} simulation, burst of {carrier:g} Hz')
    return checks, [save_picture(figure, out / 'vibrometer.png',
                                 'Fig. 9: the half-hexagon of magnets on pillars, driven at one of them, under a vibrometer.')]


def gap(scene, out):
    """A burst below the cut-off: no ridge, and a decay along the row that is Im k of the complete model."""
    cell, checks, ax = scene.atoms(), [], new_axes()
    for (source, (force, motion, steps, apart)), marker in zip(DECAYS.items(), 'os', strict=True):
        patch = scene.patch_atoms()
        where = site(cell, patch, source)
        drive = where.burst(force, scene.burst.force_N * units.N, GAP, CYCLES)
        row = send(patch, where, drive, 2 * scene.burst.damping_ratio * GAP, DURATION).row
        points = [len(wave.ridge.xi) if wave.ridge else 0 for wave in waves(row, cell, source) if wave.motion == motion]
        amplitude = abs(np.exp(-1j * GAP * row.t) @ row.along(polarisations(cell, source)[motion])) * 2 / len(row.t)
        n = np.arange(len(amplitude))[steps]
        decay, _ = measured_decay(amplitude[steps], n + (source == 'row'), source)  # behind a row the origin does not matter
        expected = {model: slowest(cell, source, motion, model) for model in MODELS}
        record = f'burst of 15 Hz from a {source}, {motion} motion'
        checks += [Check(f'{record}: points of a ridge', sum(points), 0, 0),
                   Check(f'{record}: decay per step, against Im k R2', decay, expected['complete'], 0.025)]
        if apart:
            checks.append(Check(f'control: {record}: decay, D0 alone', decay, expected['conventional'], apart, control=True))
        draw(ax, amplitude, n, expected, source, motion, marker)
    ax.set(xlabel='steps $R_2$ from the source', ylabel='amplitude at 15 Hz / that of the source',
           xlim=(-0.5, 20), ylim=(1e-5, 2), xticks=range(0, 21, 5))
    legend_above(ax, ncols=2)
    return checks, save_picture(ax.figure, out / 'evanescent.png',
                                'Below the cut-off of 26.55 Hz a burst does not travel: it decays as the complex wavenumber of '
                                'the complete model says. D0 alone lets shear reach too far; past eight steps from the row only '
                                'longitudinal motion from its ends is left.')


def draw(ax, amplitude, n, expected, source, motion, marker):
    """Amplitudes along the row, and what the wavenumber of either model makes of them at the steps `n`."""
    ax.semilogy(amplitude / amplitude[0], marker, color='k', markersize=4, fillstyle='none', label=f'{source} source, {motion}')
    for k, (model, line) in enumerate(zip(MODELS, ('-', '--'), strict=True)):
        wave = np.exp(-expected[model] * n)
        if source == 'point':  # spreading, with the correction that the fit of the decay has too
            wave /= np.sqrt(n)
            wave *= np.exp(np.polyval(np.polyfit(1 / n, np.log(amplitude[n] / wave), 1), 1 / n))
        ax.semilogy(n, wave * amplitude[n[0]] / wave[0] / amplitude[0], line, color=COLOURS[k],
                    label=rf'Im $k$, {model}' if source == 'point' else None)


def slowest(cell, source, motion, model):
    """Im xi of the slowest wave that moves the particles this way."""
    bands = complex_bands(cell, wavevector(cell, source), [GAP], model)
    across = abs(bands.vectors[0, :, 0] @ polarisations(cell, source)[motion])
    return bands.xi[0].imag[across > 0.9].min()
