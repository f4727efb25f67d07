"""The prototype under a virtual vibrometer, and below its cut-off, where waves decay."""

from dataclasses import replace

import numpy as np

from magphonon import read_scene, units
from magphonon.bands.evanescent import complex_bands
from magphonon.plotting.axes import COLOURS, PAGE_in, legend_of_set, letter_panels, new_axes, panels
from magphonon.plotting.structures import plot_patch
from magphonon.plotting.waves import plot_waves
from magphonon.response.frf import harmonic_response
from magphonon.response.stepped import fourier
from magphonon.scenes import ready_scene
from magphonon.waves.scans import sampled
from magphonon.waves.spectrum import NORMAL
from magphonon.waves.wave_analysis import MODELS, Branch, branch, compare, waves
from magphonon.waves.wave_source import burst_setup, polarisations, run_burst, wavevector

from .bursts import NEAR, closed_branch, distance
from .closed_forms import LINES, PROTOTYPE, decay_below_cutoff, triangular
from .rows import Check, Outcome, save_picture

HALF_A_BIN = 0.5
SIDES = MODELS[::-1]  # conventional left, complete right, as in the paper
HEIGHT_in = 1.8       # of a row of maps
# From a point energy runs along R2 where the frequency is stationary in k across R2: by symmetry on Gamma-K.  Waves of Gamma-M
# have fronts along R1 and come from a row of sources.  Long waves of both are as fast; at M shear ends, at 58.2 Hz.
APART = 45  # Hz; below both lines are within half a bin of the ridge, above it is off Gamma-M by more than a bin
GAP = 2 * np.pi * 15 * units.Hz   # the carrier below the cut-off of 26.55 Hz; the rest is chosen
CYCLES, DURATION = 10, 800 * units.ms
# Direction of the force, motion that it drives, and the steps compared: further out what rings on past the end of the record
# counts as well.
SOURCES = {'point': ((0, 1), 'longitudinal', slice(16)), 'row': ((1, 0), 'transverse', slice(6))}
LINEAR = 5e-3      # off the linear response: what rings on past the record costs 2e-3, past one of twice its length 8e-4
# Behind a row the wave falls by e^{-Im k R2} at first.  The decay comes out 0.3, 1.6 and 3.5 % larger over 4, 5 and 6 steps, as
# waves from the ends catch up.  Around a point a fit moves by 6 % with its steps, and the models are 3.7 % apart: none there.
PLAIN, DECAY = slice(4), 0.05
STEPS_SHOWN = 20
# A row of sources pushed at 60 degrees sends both waves at once.  D* moves the longitudinal branch by 0.16 to 0.6 bins where it
# moves the shear branch by four, so half a bin tells nothing there. FINE is twice the largest distance to the own branch.
BOTH, OBLIQUE_deg, FINE = (60, 80, 120), 60, 0.078
NO_SHEAR = 100         # Hz; a burst from here on has too little below 58.2 Hz, where shear ends, for a ridge above the noise
OF_BRANCHES = 0.3     # 27: a longitudinal ridge 0.04 bins off its branch changes 0.16 bins by a quarter
MOTIONS = {'transverse': 'shear', 'longitudinal': 'longitudinal'}


def main(out):
    """Ridges of the four bursts at the resolution of the row; amplitudes and complex wavenumber below the cut-off."""
    scene = read_scene(ready_scene('prototype'))
    checks, pictures = maps(scene, out)
    for part in both_motions, gap:
        more, picture = part(scene, out)
        checks, pictures = checks + more, [*pictures, picture]
    return Outcome(checks, pictures)


def measured(row, seed):
    """The motion of a row as a vibrometer measures it: the noise of a sample is 2 to 4 % of the wave half way up."""
    return sampled(row, 1000 * units.Hz, 5e-9 * units.m, seed)


def maps(scene, out):
    """Transverse motion along the row, both models, as the vibrometer sees it."""
    cell, plan, checks = scene.atoms(), scene.burst, []
    gamma_m, table = closed_branch(PROTOTYPE, 'row', 'shear', 'complete'), []
    patches, exact = {model: scene.patch_atoms(model) for model in SIDES}, {model: [] for model in SIDES}
    for k, carrier in enumerate(plan.carriers_Hz):
        table.append([])
        for model in SIDES:
            (other,) = set(MODELS) - {model}
            _, passage = plan.send(k, cell, patches[model])
            found = waves(measured(passage.row, k), cell, plan.source)
            wave = next(wave for wave in found if wave.motion == 'transverse')
            record, misfits = f'vibrometer {carrier:g} Hz, {model} simulation', wave.misfits
            own, off = misfits[model, 'shear'], misfits[other, 'shear']
            exact[model].append(distance(wave, closed_branch(PROTOTYPE, 'point', 'shear', model)).bins)
            checks += [Check(f'{record}: distance to its own shear branch, Gamma-K (bins)', own.bins, 0, HALF_A_BIN,
                             by='two methods'),
                       Check(f'{record}: this distance / its uncertainty', own.omega / own.sigma_omega, 0, NORMAL,
                             by='two methods'),
                       Check(f'{record}: the ridge agrees with its own branch and no other',
                             float(wave.agrees_with == ((model, 'shear'),)), 1, 0, by='two methods'),
                       Check(f'control: {record}: distance to the {other} shear branch (bins)', off.bins, 0, 0.7, control='D0')]
            table[-1].append(wave)
            if model == 'complete':
                checks.append(between_lines(record, carrier, compare(wave.ridge, branch(cell, wavevector(cell, 'row'), 0)).bins))
            if (carrier, model) == (60, 'complete'):
                checks += longitudinal(found, record)
    checks += [Check(f'vibrometer, {model} simulation: largest distance of the ridges to their shear branch, Gamma-K (bins)',
                     max(bins), 0, NEAR) for model, bins in exact.items()]
    return checks, [draw_experiment(out, scene), draw_maps(out, table, plan.carriers_Hz, gamma_m)]


def draw_maps(out, table, carriers_Hz, gamma_m):
    """Draw both models side by side, all maps on one scale."""
    names = [f'{model} simulation, {carrier:g} Hz' for carrier in carriers_Hz for model in SIDES]
    figure, axes = plot_waves(table, names, carriers_Hz)
    figure.set_size_inches(PAGE_in, HEIGHT_in * len(axes))
    for ax in axes[:, 1]:
        overlay(ax, gamma_m, 'complete, Γ-M')
    legend_of_set(figure, ncols=5)
    caption = ('Fig. 8 of the paper: transverse motion along the measured row. Waves from a point source run along it on '
               'Gamma-K; the branch on Gamma-M, drawn in S4, is several bins away above 50 Hz.')
    return save_picture(figure, out / 'vibrometer.png', caption)


def draw_experiment(out, scene):
    """Draw the half-hexagon, its source and the measured row."""
    patch = scene.patch_atoms()
    ax = plot_patch(patch, burst_setup(scene.atoms(), patch, scene.burst.source), ax=new_axes(5.5, 2.9))
    return save_picture(ax.figure, out / 'experiment.png',
                        'Fig. 7 of the paper: the half-hexagon of magnets on pillars, driven at one of them.')


def between_lines(record, carrier, bins):
    """Rows: long waves of the ridge are as near to Gamma-M as to Gamma-K, short ones are off Gamma-M by more than a bin."""
    if carrier < APART:
        return Check(f'{record}: distance to the branch on Gamma-M, that of a row of sources (bins)', bins, 0, HALF_A_BIN,
                     by='two methods')
    return Check(f'control: {record}: distance to the branch on Gamma-M, that of a row of sources (bins)',
                 bins, 0, 1, control='Gamma-M')


def longitudinal(found, record):
    """The ridge on no branch of Gamma-K: above M shear, waves M + k (k along Gamma-K) whose energy runs along the row.

    In them rows beside the measured one move against it.
    """
    wave = next(wave for wave in found if wave.motion == 'longitudinal')
    xi = np.linspace(0, np.pi, 1001)
    c1, c2 = LINES['point']
    oblique = Branch(xi, np.sqrt(triangular(PROTOTYPE, np.pi + c1 * xi, c2 * xi)[:, 0]) / units.s)
    above = wave.ridge.omega > oblique.omega[0]
    arrays = {name: getattr(wave.ridge, name)[above] for name in ('xi', 'omega', 'sigma_xi', 'sigma_omega', 'power')}
    misfit, nearest = compare(replace(wave.ridge, **arrays), oblique), min(misfit.bins for misfit in wave.misfits.values())
    record += ', longitudinal motion'
    return [Check(f'{record}: branches of Gamma-K with which the ridge agrees', len(wave.agrees_with), 0, 0, by='two methods'),
            Check(f'control: {record}: distance to the nearest branch of Gamma-K (bins)', nearest, 0, 1, control='Gamma-K'),
            Check(f'{record}: distance above 58.2 Hz to shear waves M + k (bins)', misfit.bins, 0, HALF_A_BIN)]


def both_motions(scene, out):
    """Both ridges of one record: D* moves the shear branch much more than the longitudinal one."""
    count = len(BOTH)
    plan = scene.burst.model_copy(update={'source': 'row', 'carriers_Hz': BOTH, 'directions_deg': (OBLIQUE_deg,) * count})
    cell, patch, table, checks = scene.atoms(), scene.patch_atoms(), [], []
    for k, carrier in enumerate(BOTH):
        _, passage = plan.send(k, cell, patch)
        found = {wave.motion: wave for wave in waves(measured(passage.row, k), cell, plan.source)
                 if carrier < NO_SHEAR or wave.motion == 'longitudinal'}
        table.append([found.get(motion) for motion in MOTIONS])
        for motion in found:
            name, misfits = MOTIONS[motion], found[motion].misfits
            own, off = distance(found[motion], closed_branch(PROTOTYPE, 'row', name, 'complete')), misfits['conventional', name]
            near, apart = (FINE, FINE) if name == 'longitudinal' else (HALF_A_BIN, 2)
            record = f'row of sources, {carrier:g} Hz: {name} ridge'
            checks += [Check(f'{record}: distance to its own branch, Gamma-M (bins)', own.bins, 0, near),
                       Check(f'control: {record}: distance to its branch of D0 alone (bins)', off.bins, 0, apart, control='D0')]
    shear, along = (separations(wave) for wave in table[0])
    checks.append(Check('row of sources, 60 Hz: distance to D0 alone, ratio shear / longitudinal, ridges and branches',
                        *np.divide(shear, along), OF_BRANCHES))
    figure, axes = plot_waves(table, [f'{motion} motion, {carrier:g} Hz' for carrier in BOTH for motion in MOTIONS], BOTH)
    figure.set_size_inches(PAGE_in, HEIGHT_in * len(axes))
    return checks, save_picture(figure, out / 'vibrometer_both.png', (
        'Fig. 8 of the paper, both motions of one record: waves from a row of sources pushed at 60°. D* moves the shear ridge by '
        'four bins and the longitudinal one by a fraction of a bin. A burst at 120 Hz has almost no power below 58.2 Hz, where '
        'the shear branch ends.'))


def separations(wave):
    """Bins between the ridge and the branch of D0 alone, and between the branches of both models at the ridge's wavenumbers."""
    own, other = (closed_branch(PROTOTYPE, 'row', MOTIONS[wave.motion], model) for model in MODELS)
    on_branch = replace(wave.ridge, omega=np.interp(wave.ridge.xi, own.xi, own.omega))
    return np.array([compare(ridge, other).bins for ridge in (wave.ridge, on_branch)])


def overlay(ax, line, label):
    """Draw one more line on a map, with its name."""
    ax.plot(line.xi, units.hertz(line.omega), '-.', color=COLOURS[4], label=label)


def gap(scene, out):
    """A burst below the cut-off: no ridge; amplitudes are those of linear response and decay by Im k of the complete model."""
    cell, checks = scene.atoms(), []
    figure, axes = panels(1, 2, height=2.5)
    letter_panels(axes, [f'{source} source, {motion} motion' for source, (_, motion, _) in SOURCES.items()])
    for ax, (source, (force, motion, steps)) in zip(axes[0], SOURCES.items(), strict=True):
        row, responses = shaken(scene, cell, source, force, motion)
        points = [len(wave.ridge.xi) if wave.ridge else 0 for wave in waves(row, cell, source) if wave.motion == motion]
        measured = responses.pop('measured')
        off = {model: abs(measured / U - 1)[steps].max() for model, U in responses.items()}
        record = f'burst of 15 Hz from a {source}, {motion} motion'
        checks += [Check(f'{record}: points of a ridge', sum(points), 0, 0, by='two methods'),
                   Check(f'{record}: difference from the linear response', off['complete'], 0, LINEAR, by='two methods'),
                   Check(f'control: {record}: amplitudes, difference from D0 alone', off['conventional'], 0, 0.3, control='D0')]
        if source == 'row':
            n, exact = np.arange(len(measured))[PLAIN], decay_below_cutoff(PROTOTYPE, GAP * units.s)
            decay, blind = (-np.polyfit(n, np.log(abs(u[PLAIN])), 1)[0] for u in (measured, responses['conventional']))
            checks += [Check(f'{record}: decay per step, against Im k R2', decay, exact, DECAY),
                       Check(f'control: {record}: decay of the response of D0 alone', blind, exact, 0.2, control='D0')]
        draw(ax, measured, responses, slowest(cell, source, motion, 'complete'), slice(6) if source == 'row' else slice(13, None))
    axes[0, 0].set_ylabel('amplitude / amplitude at step 0')
    legend_of_set(figure, ncols=4)
    return checks, save_picture(figure, out / 'evanescent.png',
                                'Below the cut-off of 26.55 Hz a burst does not travel: its amplitudes are those of linear '
                                'response with D0 + D*. The grey lines have the slope of the complex wavenumber: (a) around a '
                                'point source the decay reaches this slope only far away, (b) behind a row of sources at once.')


def shaken(scene, cell, source, force, motion):
    """The record along the row, and the Fourier amplitudes there at 15 Hz: measured, and of linear response in both models."""
    patch, across = scene.patch_atoms(), polarisations(cell, source)[motion]
    where, damping = burst_setup(cell, patch, source), 2 * scene.burst.damping_ratio * GAP
    drive = where.burst(force, scene.burst.force_N * units.N, GAP, CYCLES)
    row = run_burst(patch, where, drive, damping, DURATION).row
    amplitudes = {'measured': fourier(row.along(across), row.dt, [GAP])[0]}
    push = np.zeros((len(patch), 3), complex)
    push[drive.particles] = -0.25j * drive.end * drive.amplitude[:, None] * drive.direction  # of the Hann burst, at its carrier
    for model in MODELS:
        u = harmonic_response(scene.patch_atoms(model), push, [GAP], damping).response[0, where.row, :2]
        amplitudes[model] = u @ across
    return row, amplitudes


def draw(ax, measured, responses, decay, here):
    """Draw amplitudes along the row, measured and of both models, and the slope of the complex wavenumber."""
    n, first = np.arange(len(measured)), abs(measured[0])
    ax.semilogy(n, abs(measured) / first, 'o', color='k', fillstyle='none', markersize=5, label='simulated burst')
    for (model, U), look in zip(responses.items(), ({'marker': '.', 'color': COLOURS[0]}, {'marker': 'x', 'color': COLOURS[1]}),
                                strict=True):
        ax.semilogy(n, abs(U) / first, linestyle='', label=f'linear response, {model}', **look)
    along = n[:STEPS_SHOWN + 1][here]  # where one wave is left
    ax.semilogy(along, 0.6 * abs(measured[along[0]]) / first * np.exp(-decay * (along - along[0])), '-', color='0.5',
                label=r'slope Im $k$, complete')
    ax.set(xlabel=r'steps $\mathbf{R}_2$ from the source', xlim=(-0.5, STEPS_SHOWN + 0.5), ylim=(1e-5, 3), xticks=range(0, 21, 5))


def slowest(cell, source, motion, model):
    """Im xi of the slowest-decaying wave that moves the particles in this direction."""
    bands = complex_bands(cell, wavevector(cell, source), [GAP], model)
    across = abs(bands.vectors[0, :, 0] @ polarisations(cell, source)[motion])
    return bands.xi[0].imag[across > 0.9].min()
