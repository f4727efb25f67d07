"""On a simulated bench: the intervals that the commands state, tested by a laboratory that shares no code with the package.

Each path is what a group would do with its own data, from a measurement to intervals. The lattice is that of `bench_lattice`: all
neighbours, discs whose force is integrated over their faces, scatter of all parts, and a vibrometer with faults. The control of
the ridges is the same analysis with nearest neighbours alone; that of the forces, the analysis without the errors that all rows
share. The tests count more specimens, and the other paths (docs/coverage.md).
"""

import tempfile
from functools import partial
from pathlib import Path

import numpy as np

from magphonon import read_scene
from magphonon.interactions.fits import SharedErrors, fit_forces
from magphonon.interactions.force_tables import Forces
from magphonon.scenes import fit_bands
from magphonon.scenes.band_fits import NEAREST
from magphonon.waves import Scan, read_ridges, scan_waves
from magphonon.waves.ridge_tables import write_ridges

from . import bench_lattice as bench
from .rows import Check, Outcome

REACH = 45e-3  # m, of the force in finite patches
SPACING = 10e-3  # m
LEAST = 0.75
"""Share of the few intervals of a path that must contain the truth. Of 12 intervals of 95 %, fewer contain it once in 500
cases; of 12 intervals of 50 %, more contain it once in 14."""
SURELY = 3.5  # standard deviations that one value may be off: once in two thousand, while one interval in twenty misses


def main(out):
    """A row for each interval that is tested."""
    del out
    return Outcome([*forces(), *ridges()])


def judged(path, quantities, intervals, truths, control, least=LEAST, without='nearest neighbours'):
    """Rows of one path: values of the first specimen, and the share of intervals that contain the truth, also of the control.

    Parameters
    ----------
    path : str
    quantities : sequence of str
        With their units.
    intervals : array_like, shape (specimens, quantities, 2)
        Ends of the intervals of 95 % that the command states.
    truths : array_like, shape (specimens, quantities)
    control : array_like, shape (specimens, quantities, 2)
        The intervals of the wrong analysis of the same specimens.
    """
    intervals, truths, control = (np.asarray(one, float) for one in (intervals, truths, control))
    rows = [Check(f'{path}: {name}, within {SURELY:g} standard deviations', (low + high) / 2, truth,
                  SURELY * (high - low) / 3.92 / abs(truth))
            for name, (low, high), truth in zip(quantities, intervals[0], truths[0], strict=True)]
    held, wrong = (((ends[..., 0] <= truths) & (truths <= ends[..., 1])) for ends in (intervals, control))
    return [*rows, Check(f'{path}: share of {held.size} intervals of 95 %, of {len(held)} specimens, that contain the true value',
                         held.mean(), 1, 1 - least),
            Check(f'control: {path}, {without}: share of {wrong.size} intervals, of {len(wrong)} specimens', wrong.mean(), 1,
                  1 - least, control=without)]


def line_scan(lab, vectors, source, force, carrier_Hz, duration, rng, cycles=5, moved=bench.motion):
    """The scan along R2 of a burst in a triangular patch: a force (x, y) in N on its lowest row that moves, or on its middle."""
    (x, y), R2 = lab.anchors.T, vectors[1]
    inside = np.flatnonzero(~lab.held)
    row = inside[y[inside] < y[inside].min() + R2[1] / 2]
    if source == 'point':
        row = row[[abs(x[row] - x[inside].mean()).argmin()]]
        start, weights = lab.anchors[row[0]], np.ones(1)
    else:
        weights = np.cos(np.pi * (x[row] - x[inside].mean()) / (np.ptp(x[row]) + 2 * vectors[0, 0])) ** 2
        below = x[inside].mean() - np.ptp(y[inside]) / 2 / np.sqrt(3)
        start = lab.anchors[row[abs(x[row] - below).argmin()]]
    places = start + np.arange(1, int(np.ptp(y[inside]) / R2[1]))[:, None] * R2
    points = inside[np.linalg.norm(lab.anchors[inside] - places[:, None], axis=2).argmin(axis=1)]
    t, u = moved(lab, [(bench.pushed(lab, row, weights[:, None] * force), bench.burst(carrier_Hz, cycles))], duration, points)
    u = bench.measured(u, 1 / t[1], rng, dead=2)
    return Scan(1e3 * t, tuple(map(str, points)), 1e3 * places, {'x': 1e3 * u[..., 0], 'y': 1e3 * u[..., 1]})


def scene_text(shells):
    """The scene of the laboratory's lattice before the measurement: force, exponent and springs are about ten percent off."""
    return (f'title = "bench"\n[law]\nkind = "inverse_power"\nb_N_m_a = {0.26 * SPACING**4}\na = 4.0\nshells = {shells}\n'
            f'[lattice]\nkind = "triangular"\nspacing_m = {SPACING}\nmass_kg = 8e-4\n[foundation]\nstiffness_N_per_m = 23.0\n')


def ridges():
    """`spectrum` and `fit --bands`: three bursts of a row of sources, shear and longitudinal."""
    law, rng = bench.tabulated(bench.disc_force(2.5e-3, 5e-3, 1.32), 8e-3, REACH + 5e-3), np.random.default_rng(1)
    vectors, names = bench.triangular(SPACING), ('force', 'a', 'bond stiffness')
    shear, longitudinal = np.eye(2)
    bursts = ((2e-3 * shear, 42, 0.4), (4e-3 * longitudinal, 60, 0.25), (4e-3 * longitudinal, 95, 0.25))
    found, truths = {'"auto"': [], '1': []}, []
    with tempfile.TemporaryDirectory() as folder:
        scene_file, table = Path(folder, 'bench.toml'), Path(folder, 'ridges.csv')
        for _ in range(2):
            lab = bench.built(bench.sites(vectors, 0.26, 0.22), law, REACH, rng)
            moved = partial(bench.small_motion, shapes=bench.modes(lab))
            scans = [line_scan(lab, vectors, 'row', force, carrier, duration, rng, moved=moved)
                     for force, carrier, duration in bursts]
            spacing = np.linalg.norm(bench.mean_vectors(lab, vectors, 6 * SPACING)[0])
            f, slope = (float(value) for value in law(spacing))
            truths.append([f, -slope * spacing / f, -slope])
            for shells, fits in found.items():
                scene_file.write_text(scene_text(shells), encoding='utf-8')
                scene = read_scene(scene_file)
                cell = scene.perfect_cell()
                driven = ('transverse', 'longitudinal', 'longitudinal')
                write_ridges(table, {f'{k}': [wave for wave in scan_waves(scan, cell, 'row') if wave.motion == driven[k]]
                                     for k, scan in enumerate(scans)})
                values = fit_bands(scene, read_ridges(table)).values(part=NEAREST if shells == '1' else None)
                fits.append([values[name][0] * np.exp(np.array([-1.96, 1.96]) * values[name][1]) for name in names])
    return judged('ridges of a row source', ('force (N)', 'exponent', 'bond stiffness (N/m)'), found['"auto"'], truths,
                  found['1'])


def forces():
    """`fit`: tables of forces of discs, whose rows share errors of known size; the fit does not know the discs."""
    law, rng = bench.tabulated(bench.disc_force(2.5e-3, 5e-3, 1.32), 6e-3, 25e-3), np.random.default_rng(7)
    errors = SharedErrors(distance=0.1, zero=12e-3, hysteresis=2e-3, backlash=0.06)
    exact = SharedErrors(distance=0.0, zero=0.0, hysteresis=0.0, backlash=0.0, gain=0.0)
    r, direction = np.tile(np.linspace(7, 20, 15), 2), np.repeat([-1.0, 1.0], 15)
    f, slope = (float(value) for value in law(SPACING))
    found = {errors: [], exact: []}
    for _ in range(10):
        zero, away, hysteresis, backlash, gain = rng.standard_normal(5) * [0.012, 0.1, 0.002, 0.06, 0.01]
        true = law((r + away + direction * backlash / 2) / 1e3)[0]
        noise = np.hypot(0.005, 0.01 * true) * rng.standard_normal(len(r))
        table = Forces(r, (1 + gain) * true + zero + direction * hysteresis + noise, None, direction)
        for told, fits in found.items():
            force, steep, exponent = fit_forces(table, 1e3 * SPACING, told).intervals
            fits.append([force, 1e3 * steep, exponent])
    return judged('forces', ('force (N)', '-slope (N/m)', 'exponent'), found[errors],
                  [[f, -slope, -slope * SPACING / f]] * 10, found[exact], least=0.8, without='no errors that all rows share')
