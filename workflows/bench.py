"""On a simulated bench: the intervals that the commands state, tested by a laboratory that shares no code with the package.

Each path is what a group would do with its own data, from a measurement to intervals. The lattice is that of `bench_lattice`: all
neighbours, discs whose force is integrated over their faces, scatter of all parts, and a vibrometer with faults. The control of
each path is the same analysis with nearest neighbours alone; for forces, the analysis without the errors that all rows share.
"""

import tempfile
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from magphonon import read_scene
from magphonon.bands import band_path
from magphonon.interactions.fits import SharedErrors, fit_forces
from magphonon.interactions.force_tables import Forces
from magphonon.response.transfer_functions import TransferFunction
from magphonon.scenes import fit_bands, fit_frf
from magphonon.scenes.band_fits import NEAREST
from magphonon.waves import Scan, field_of, field_ridges, read_ridges, scan_waves
from magphonon.waves.ridge_tables import write_points, write_ridges

from . import bench_lattice as bench
from .rows import Check, Outcome

REACH = 45e-3  # m, of the force in finite patches
SPACING = 10e-3  # m
LEAST = 0.75
"""Share of the few intervals of a path that must contain the truth. Of 12 intervals of 95 %, fewer contain it once in 500
cases; of 12 intervals of 50 %, more contain it once in 14."""
SURELY = 3.5  # standard deviations that one value may be off: once in two thousand, while one interval in twenty misses


def main(out, quick=False):
    """A row for each interval that is tested; `quick` takes the paths and specimens that need seconds."""
    del out
    return Outcome([row for path in (QUICK if quick else PATHS) for row in path(quick)])


def judged(path, quantities, intervals, truths, control, least=LEAST, control_truths=None, without='nearest neighbours'):
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
        The intervals with nearest neighbours alone, for the first of the same specimens, or for others with `control_truths`.
    """
    intervals, truths, control = (np.asarray(one, float) for one in (intervals, truths, control))
    others = truths[:len(control)] if control_truths is None else np.asarray(control_truths, float)
    rows = [Check(f'{path}: {name}, within {SURELY:g} standard deviations', (low + high) / 2, truth,
                  SURELY * (high - low) / 3.92 / abs(truth))
            for name, (low, high), truth in zip(quantities, intervals[0], truths[0], strict=True)]
    held, wrong = (((ends[..., 0] <= true) & (true <= ends[..., 1])) for ends, true in ((intervals, truths), (control, others)))
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
    return (f'title = "bench"\n[lattice]\nkind = "triangular"\nspacing_m = {SPACING}\nmass_kg = 8e-4\n[law]\n'
            f'kind = "inverse_power"\nforce_N = 0.26\na = 4.0\nshells = {shells}\n[foundation]\nstiffness_N_per_m = 23.0\n')


def ridges(source, quick):
    """`spectrum` and `fit --bands`: three bursts, shear and longitudinal.

    With a point source, exponent and foundation have priors of ten percent, which are two and seven percent off.  The control
    takes the answer of nearest neighbours alone, and with a point source no priors, and is told that the source was a row.
    """
    law, rng = bench.tabulated(bench.disc_force(2.5e-3, 5e-3, 1.32), 8e-3, REACH + 5e-3), np.random.default_rng(1)
    vectors, names = bench.triangular(SPACING), ('force', 'a', 'bond stiffness')
    R2, strong = vectors[1] / SPACING, 5.0 if source == 'point' else 1.0
    shear, longitudinal = ((1, 0), (0, 1)) if source == 'row' else ((R2[1], -R2[0]), R2)
    bursts = ((2e-3, shear, 42, 0.4), (4e-3, longitudinal, 60, 0.25), (4e-3, longitudinal, 95, 0.25))
    found, truths = {'"auto"': [], '1': []}, []
    with tempfile.TemporaryDirectory() as folder:
        scene_file, table = Path(folder, 'bench.toml'), Path(folder, 'ridges.csv')
        for side in (1, -1) if quick else (1, -1, 0.3, -0.3):
            lab = bench.built(bench.sites(vectors, *((0.26, 0.22) if source == 'row' else (0.28, 0.25))), law, REACH, rng)
            moved = partial(bench.small_motion, shapes=bench.modes(lab))
            scans = [line_scan(lab, vectors, source, strong * force * np.array(along), carrier, duration, rng, moved=moved)
                     for force, along, carrier, duration in bursts]
            spacing = np.linalg.norm(bench.mean_vectors(lab, vectors, 6 * SPACING)[0])
            f, slope = (float(value) for value in law(spacing))
            truths.append([f, -slope * spacing / f, -slope])
            known = {'a': (1 + 0.07 * side) * truths[-1][1], 'foundation': (1 - 0.07 * side) * lab.springs.mean()}
            priors = {name: (value, 0.1 * value) for name, value in known.items()} if source == 'point' else {}
            for shells in ('"auto"', '1') if abs(side) == 1 else ('"auto"',):  # two are enough for the control
                scene_file.write_text(scene_text(shells), encoding='utf-8')
                scene, alone = read_scene(scene_file), shells == '1'
                cell = scene.perfect_cell()
                driven = ('transverse', 'longitudinal', 'longitudinal')
                write_ridges(table, {f'{k}': [wave for wave in scan_waves(scan, cell, source) if wave.motion == driven[k]]
                                     for k, scan in enumerate(scans)})
                points = read_ridges(table)
                if alone:
                    points = replace(points, sources=('row',) * len(points.names))
                values = fit_bands(scene, points, priors={} if alone else priors).values(part=NEAREST if alone else None)
                found[shells].append([values[name][0] * np.exp(np.array([-1.96, 1.96]) * values[name][1]) for name in names])
    return judged(f'ridges of a {source} source', ('force (N)', 'exponent', 'bond stiffness (N/m)'), found['"auto"'], truths,
                  found['1'])


def noise_of_the_plane(quick):
    """`spectrum` of all magnets in motion by noise alone, then `fit --bands`."""
    law, rng = bench.tabulated(bench.disc_force(2.5e-3, 5e-3, 1.32), 7e-3, REACH + 5e-3), np.random.default_rng(6)
    vectors, names, frames = bench.triangular(SPACING), ('force', 'a', 'bond stiffness'), 4000
    found, truths = {1: [], 9: []}, []
    with tempfile.TemporaryDirectory() as folder:
        for specimen in range(2 if quick else 4):
            lab = bench.built(bench.sites(vectors, 0.22, 0.22), law, REACH, rng)
            omega, shapes = bench.modes(lab)
            w = 2 * np.pi * np.fft.rfftfreq(frames, 1e-3)
            modal = rng.normal(size=(len(omega), len(w), 2)).view(complex)[..., 0] * (w < 2 * np.pi * 250)
            modal = np.fft.irfft(modal / (omega[:, None] ** 2 + 1j * lab.damping * w - w**2), frames)[:, : frames // 2]
            u = bench.measured(np.einsum('nxm,mt->tnx', shapes, modal, optimize=True)[:, ~lab.held], 1000.0, rng)
            u *= 1e-3 / abs(u).max()
            scan = Scan(np.arange(len(u)) * 1.0, tuple(map(str, range(u.shape[1]))), 1e3 * lab.rest[~lab.held],
                        {'x': u[..., 0], 'y': u[..., 1]})
            spacing = np.linalg.norm(bench.mean_vectors(lab, vectors, 3 * SPACING)[0])
            f, slope = (float(value) * lab.strengths[~lab.held].mean() ** 2 for value in law(spacing))  # 0.3 % are told here
            truths.append([f, -slope * spacing / f, -slope])
            for shells in (9, 1) if specimen < 2 else (9,):  # two are enough for the control
                (file := Path(folder, 'bench.toml')).write_text(scene_text(shells), encoding='utf-8')
                scene = read_scene(file)
                cell = scene.perfect_cell()
                points = field_ridges(field_of(scan, cell), cell, band_path(cell, 'GMKG'))
                write_points(Path(folder, 'ridges.csv'), points)
                values = fit_bands(scene, read_ridges(Path(folder, 'ridges.csv'))).values(part=NEAREST if shells == 1 else None)
                found[shells].append([values[name][0] * np.exp(np.array([-1.96, 1.96]) * values[name][1]) for name in names])
    return judged('noise of the plane', ('force (N)', 'exponent', 'bond stiffness (N/m)'), found[9], truths, found[1])


def forces(_):
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


def transfer_functions(_):
    """`fit --frf`: one magnet pushed, three others seen along x and y, noise of 1 % of the peak; the last fit is the control."""
    law, rng = bench.tabulated(bench.disc_force(2.5e-3, 5e-3, 1.32), 6e-3, REACH + 5e-3), np.random.default_rng(3)
    places, names = bench.sites(bench.triangular(SPACING), 0.085, 0.075), ('force', 'foundation_x', 'foundation_y')
    found, truths = [], []
    for cutoff in (REACH, REACH, 13e-3):
        if len(found) < 2:
            lab = bench.built(places, law, REACH, rng)
            functions, free = tapped(lab, places, rng), ~lab.held
            truths.append([float(law(SPACING)[0]) * lab.strengths[free].mean() ** 2, *lab.springs[free].mean(axis=0)])
        values = fit_frf(scene_of_particles(lab, places, cutoff), functions, stated=['complete']).values()
        stated = {name: value * np.exp(np.array([-1.96, 1.96]) * sigma) if np.isfinite(sigma) else [np.nan] * 2
                  for name, (value, sigma) in values.items()}  # of what is not this model no interval is stated, and none holds
        found.append([stated[name] for name in names])
    return judged('transfer functions', ('force (N)', 'foundation x (N/m)', 'foundation y (N/m)'), found[:2], truths, found[2:],
                  control_truths=truths[1:])


def tapped(lab, places, rng, noise=0.01):
    """Transfer functions of the laboratory's lattice, the magnet in the middle pushed at 40 degrees."""
    near = [int(np.linalg.norm(places - at, axis=1).argmin()) for at in ((0, 0), (0.01, 0), (-0.015, 0.017), (0, -0.026))]
    omega, angle = 2 * np.pi * np.linspace(8, 160, 80), np.deg2rad(40)
    moved = bench.response(lab, bench.pushed(lab, near[0], (np.cos(angle), np.sin(angle))), omega)[:, near[1:]]
    sigma = noise * abs(moved).max()
    moved = moved + sigma * (rng.standard_normal(moved.shape) + 1j * rng.standard_normal(moved.shape))
    drive = np.array([*1e3 * places[near[0]], angle])
    return [TransferFunction(f'{k}{axis}', 1e-3 * omega, 1e3 * moved[:, k, axis], 1e3 * sigma, 0,
                             np.array([*1e3 * places[near[1 + k]], axis * np.pi / 2]), drive)
            for k in range(3) for axis in (0, 1)]


def scene_of_particles(lab, places, cutoff):
    """The scene of this lattice as planned, not as built, with parameters about ten percent off."""
    with tempfile.TemporaryDirectory() as folder:
        rows = [f'{x},{y},{int(held)}' for (x, y), held in zip(places.tolist(), lab.held, strict=True)]
        Path(folder, 'places.csv').write_text('\n'.join(['x_m,y_m,held', *rows]), encoding='utf-8')
        (file := Path(folder, 'bench.toml')).write_text(
            'title = "bench"\n[lattice]\nkind = "file"\nfile = "places.csv"\nmass_kg = 8e-4\npositions = "anchors"\n'
            f'cutoff_m = {cutoff}\n[law]\nkind = "magnets"\nremanence_T = 1.27\nshells = 1\n[law.ring]\nouter_diameter_m = 5e-3\n'
            'height_m = 5e-3\n[foundation]\n'
            'stiffness_N_per_m = 22.0\nstiffness_y_N_per_m = 22.5\n[frf]\nfrom_Hz = 8.0\nto_Hz = 160.0\npoints = 140\n'
            'damping_per_s = 7.0\n[frf.force]\nat_m = [0.0, 0.0]\ndirection_deg = 40.0\n[frf.response]\n'
            'at_m = [0.01, 0.0]\ndirection_deg = 0.0\n', encoding='utf-8')
        return read_scene(file)


PATHS = (forces, partial(ridges, 'row'), partial(ridges, 'point'), transfer_functions, noise_of_the_plane)
"""One function for each path; it returns rows, see `judged`."""
QUICK = PATHS[:2]
"""Those that take seconds."""
