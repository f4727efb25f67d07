"""Noise: a heat bath gives every wave the energy kT; the stiffness kT/<|u_q|^2> of a wave is not that of D0 alone."""

import numpy as np

from magphonon import DrivenVerlet, Recorder, analytic_bands, read_scene, units as u
from magphonon.dynamics import highest_frequency
from magphonon.plotting.axes import COLOURS, legend_above, letter_panels, panels
from magphonon.plotting.bands import plot_bands, plot_thermal
from magphonon.waves import thermal_bands, thermal_run

from .rows import Check, Outcome, save_picture

M, K = [(0.5, 0, 0), (0, 0.5, 0), (0.5, 0.5, 0)], (2 / 3, 1 / 3, 0)
BETWEEN = [(0, 1 / 6, 0), (0, 1 / 3, 0), (1 / 6, -1 / 6, 0)]  # on the way from Gamma to M, and from K to Gamma
COLD, HOT = 1e-8, 0.01                       # kT in f L
FIRST, AT_HOT = -4.32, -0.0441               # change of stiffness of M shear: per kT/(f L), and at HOT to second order
STEPS, SEEDS = 2500, 4                       # of hot runs


def main(out):
    """The harmonic limit against closed forms, and the first anharmonic shift against a Laplace integral of the 36 magnets."""
    scene = read_scene('thermal')
    cell = scene.perfect_cell()
    L = cell.calc.bonds.lengths.min()
    f = -cell.calc.law.dphi(np.array([L]))[0]
    cold = in_the_cold(cell, COLD * f * L)
    misfit = {model: abs((cold.omega[:4] - closed(cell, f / L, model)) / cold.error[:4]).max()
              for model in cell.calc.bloch_models}
    runs = [thermal_run(cell, scene.supercell(), HOT * f * L, M, STEPS, seed) for seed in range(SEEDS)]
    change = np.array([((run.omega / run.linear) ** 2 - 1)[:, 0] for run in runs])
    error = change.mean(axis=1).std(ddof=1) / np.sqrt(SEEDS)
    checks = [
        Check('shear at M from kT/<|u|^2> (Hz)', u.hertz(cold.omega[:3, 0].mean()), u.hertz(closed(cell, f / L)[0, 0]), 0.08),
        Check('harmonic limit at M and K, largest misfit in standard errors', misfit['complete'], 0.0, 4.0),
        Check('control: harmonic limit with D0 alone, largest misfit in standard errors',
              misfit['conventional'], 0.0, 4.0, control=True),
        Check(f'shear at M at kT = {HOT:g} f L: change of stiffness', change.mean(), AT_HOT, 0.7),
        Check('control: no change of the stiffness of shear at M', 0.0, AT_HOT, 0.7, control=True),
    ]
    return Outcome(checks, [picture(out, scene, cell, cold, change.mean(), error)])


def in_the_cold(cell, kT):
    """Bands from thermal motion in a run that is so cold that forces are harmonic."""
    atoms = cell.repeat((6, 6, 1))
    atoms.calc = cell.calc.on(atoms)
    moved, fastest = atoms.copy(), highest_frequency(atoms)
    moved.calc = atoms.calc
    dyn = DrivenVerlet(moved, 0.3 / fastest, damping=0.3 * fastest, temperature_mJ=kT)
    dyn.run(500)
    record = Recorder(dyn, interval=8)
    dyn.run(5000)
    return thermal_bands(atoms, record.displacements, kT, cell, [*M, K, *BETWEEN], dyn.dt)


def closed(cell, stiffness, model='complete'):
    """Angular frequencies at three M and K: m w^2 - k is 2a - 6, 6a - 2, 4.5 (a - 1), with D0 alone 2a, 6a, 4.5 a times f/L."""
    a, D0 = 4.5824, model == 'conventional'
    at_m, at_k = ([2 * a, 6 * a], 4.5 * a) if D0 else ([2 * a - 6, 6 * a - 2], 4.5 * (a - 1))
    k = np.array([at_m, at_m, at_m, [at_k, at_k]]) * stiffness + cell.calc.foundation
    return np.sqrt(k / cell.get_masses()[0])


def picture(out, scene, cell, cold, change, error):
    """Draw bands with the points from a cold bath, and the change of stiffness with the temperature."""
    figure, (axes,) = panels(1, 2, height=3.0)
    letter_panels(axes)
    bands, shift = axes
    path = scene.band_path()
    plot_bands(analytic_bands(cell, path), ax=bands, label='$D^0+D^*$')
    plot_bands(analytic_bands(cell, path, 'conventional'), ax=bands, linestyle='--', label='$D^0$')
    plot_thermal(bands, cold, path)
    x = np.array([0, 1.6 * HOT])
    shift.plot(100 * x, 100 * FIRST * x, '-', color=COLOURS[0], label='first order')
    shift.errorbar([100 * HOT], [100 * change], [200 * error], fmt='s', color='black', fillstyle='none', capsize=3,
                   label='time steps')
    shift.axhline(0, color='0.7', linewidth=0.8, zorder=0)
    shift.set(xlabel='$kT/(f L_0)$ (%)', ylabel='stiffness of shear at M, change (%)', xlim=(0, 160 * HOT))
    legend_above(shift, ncols=2)
    return save_picture(figure, out / 'noise.png',
                        'Waves of the prototype in a heat bath. (a) At low temperature their stiffness, with two standard '
                        'errors, lies on the branches with D*, not on those of D0 alone. (b) At higher temperature the shear '
                        'wave at M softens.')
