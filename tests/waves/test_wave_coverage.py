"""Intervals of lattices fitted to waves hold the truth of magnets, lattices and faults that are drawn.

Rings, cubes and sums of two powers on triangular, square and honeycomb lattices, kx unlike ky, records that are clipped, drift
as 1/f, hum, are tilted, or have unequal gains.  In docs/coverage.md; each takes some minutes of one core:

    python -m pytest -m long -n 0 -s tests/waves/test_wave_coverage.py
"""

import numpy as np
import pytest

from magphonon import read_scene
from magphonon.bands import band_path
from magphonon.scenes import fit_bands
from magphonon.waves import field_of, field_ridges, read_ridges, scan_waves
from magphonon.waves.ridge_tables import write_points, write_ridges
from magphonon.waves.scans import Samples, assembled
from tests.drawn_lattices import FAULTS, MASS, VECTORS, Tally, bloch, plain_fit, specimen, spoilt
from workflows import bench_lattice as bench

FIRST = {'row': 1100, 'point': 1100, 'thermal': 1100, 'base': 1300, 'honeycomb': 1100}  # of seeds on which nothing was chosen
SPECIMENS, WITHOUT = 24, 40


def scene_of(folder, one, rng, more=''):
    """The lattice as its owner knows it: force, exponent and springs some ten percent off, as an inverse power."""
    off = np.exp(0.1 * rng.uniform(-1, 1, 4)) * [one.truth['force'], 4.2, *one.springs]
    (file := folder / 'scene.toml').write_text(
        f'title = "drawn"\n[lattice]\nkind = "{one.lattice}"\nspacing_m = 0.01\nmass_kg = {MASS}\n{more}[law]\n'
        f'kind = "inverse_power"\nb_N_m_a = {off[0] * 0.01 ** off[1]}\na = {off[1]}\nshells = "auto"\n'
        f'[foundation]\nstiffness_N_per_m = {off[2]}\nstiffness_y_N_per_m = {off[3]}\n', encoding='utf-8')
    return read_scene(file)


def read(times, names, places, u):
    """A scan as it is read from a file: of the samples of each point."""
    return assembled('scan', {str(name): Samples(times, {'x': u[:, k, 0], 'y': u[:, k, 1]}, tuple(places[k]))
                              for k, name in enumerate(names)}, False)


def scanned(one, source, side, carrier, seconds, fault, rng):
    """The scan along R2 of a burst of five cycles on the lowest row that moves, or on its middle, along `side`."""
    lab, R2 = one.lab, VECTORS[one.lattice][1]
    (x, y), inside = lab.anchors.T, np.flatnonzero(~lab.held)
    row = inside[y[inside] < y[inside].min() + R2[1] / 2]
    middle = x[inside].mean()
    if source == 'point':
        row = row[[abs(x[row] - middle).argmin()]]
        start, weights = lab.anchors[row[0]], np.ones(1)
    else:
        weights = np.cos(np.pi * (x[row] - middle) / (np.ptp(x[row]) + 2e-2)) ** 2
        start = lab.anchors[row[abs(x[row] - (middle - np.ptp(y[inside]) / 2 * R2[0] / R2[1])).argmin()]]
    places = start + np.arange(1, int(np.ptp(y[inside]) / R2[1]))[:, None] * R2
    points = inside[np.linalg.norm(lab.anchors[inside] - places[:, None], axis=2).argmin(axis=1)]
    drive = bench.pushed(lab, row, weights[:, None] * np.array(side)), bench.burst(carrier, 5)
    t, u = bench.small_motion(lab, [drive], seconds, points, one.modes)
    u = spoilt(bench.measured(u, 1 / t[1], rng, dead=1), fault, rng)
    return read(1e3 * t, points, 1e3 * places, u)


def ridges_of(one, source, scene, folder, fault, rng):
    """Ridges of three bursts, shear and longitudinal, at frequencies where the bands of the lattice are."""
    R2 = VECTORS[one.lattice][1] / 0.01
    k = np.outer([1.4, 0.9, 1.9], np.linalg.inv(VECTORS[one.lattice]).T[1])
    carriers = bloch(one.law, one.lattice, k, one.springs, static=one.static)[range(3), [0, 1, 1]] / (2 * np.pi)
    sides = ((1, 0), (0, 1), (0, 1)) if source == 'row' else ((R2[1], -R2[0]), R2, R2)
    cell, found = scene.perfect_cell(), {}
    for name, side, carrier, seconds in zip('123', sides, carriers, (0.4, 0.25, 0.25), strict=True):
        waves = scan_waves(scanned(one, source, side, carrier, seconds, fault, rng), cell, source)
        found[name] = [wave for wave in waves if wave.motion == ('transverse' if name == '1' else 'longitudinal')]
    write_ridges(folder / 'ridges.csv', found)
    return read_ridges(folder / 'ridges.csv')


def field_points(one, kind, scene, folder, fault, rng, seconds=2.0, path=None):
    """Ridges of all magnets but some, moved by noise on each ('thermal') or of the base."""
    (omega, shapes), lab, frames = one.modes, one.lab, int(2e3 * seconds)
    w = 2 * np.pi * np.fft.rfftfreq(frames, 1e-3)
    band = w < 2 * np.pi * 250
    if kind == 'base':
        force = np.einsum('nxm,n,xf->mf', shapes, lab.masses, rng.normal(size=(2, len(w), 2)).view(complex)[..., 0] * band)
    else:
        force = rng.normal(size=(len(omega), len(w), 2)).view(complex)[..., 0] * band
    modal = np.fft.irfft(force / (omega[:, None] ** 2 + 1j * lab.damping * w - w**2), frames)[:, : frames // 2]
    kept = np.flatnonzero(~lab.held & (rng.random(len(lab.held)) > 0.05))
    u = np.einsum('nxm,mt->tnx', shapes[kept], modal, optimize=True)
    u = spoilt(bench.measured(u, 1000.0, rng, jitter=1e-4), fault, rng)
    places = 1e3 * lab.rest[kept] + [30, -40] + 0.05 * rng.normal(size=(len(kept), 2))
    scan = read(np.arange(len(u)) * 1.0, kept, places, 1e-3 / abs(u).max() * u)
    cell = scene.perfect_cell()
    write_points(folder / 'ridges.csv', field_ridges(field_of(scan, cell), cell, band_path(cell, path)))  # as the commands do
    return read_ridges(folder / 'ridges.csv')


def priors_of(one, rng, names=('a', 'foundation_x', 'foundation_y')):
    """What is known to ten percent beforehand, drawn as far off."""
    return {name: (value, 0.1 * value) for name in names for value in [one.truth[name] * (1 + 0.1 * rng.standard_normal())]}


def tally(path, seeds, folder, static=True):
    """Specimens of a path, one after the other."""
    found = Tally(path if static else f'{path} without D*')
    kind = 'thermal' if path == 'honeycomb' else path
    for seed in seeds:
        rng, fault = np.random.default_rng([seed, 7]), FAULTS[(seed + seed // 6) % len(FAULTS)] if static else 'none'
        size = {'row': 0.24, 'point': 0.24, 'honeycomb': 0.28}.get(path, 0.2)
        one = specimen(seed, size, ('honeycomb',) if path == 'honeycomb' else ('triangular', 'square'), static)
        scene, words = scene_of(folder, one, rng), f'seed {seed}, {fault}'
        try:
            if path in ('row', 'point'):
                points = ridges_of(one, path, scene, folder, fault, rng)
            else:
                points = field_points(one, kind, scene, folder, fault, rng)
            fits = fit_bands(scene, points, priors=priors_of(one, rng) if path == 'point' else {})
        except ValueError as error:
            found.refusal(one, words, error)
            continue
        plain = plain_fit(one, fits.points) if len(fits.points) > 3 else {}
        found.add(one, f'{words}, {len(fits.points)} points', fits.values(), plain, fits.evidence)
    print(found.summary(), flush=True)
    return found


@pytest.mark.long
@pytest.mark.parametrize('path', FIRST)
def test_intervals_hold_the_truth_of_drawn_lattices(path, tmp_path):
    found = tally(path, range(FIRST[path], FIRST[path] + SPECIMENS), tmp_path)
    assert found.share >= 0.9
    assert min(found.evidence) > -2  # never against D* where it is


@pytest.mark.long
def test_no_false_claim_about_static_forces(tmp_path):
    found = tally('row', range(500, 500 + WITHOUT), tmp_path, static=False)
    assert max(found.evidence) < 2


@pytest.mark.slow
@pytest.mark.parametrize('relative', [(1.0, 1.0), (1.0, 1.6)])
def test_two_magnets_to_the_cell(relative, tmp_path):
    """Points of all four branches of a honeycomb; the controls: exchanged masses or springs, and no static forces."""
    one, rng = specimen(600, 0.28, ('honeycomb',), relative=relative), np.random.default_rng(4)
    scene = scene_of(tmp_path, one, rng, f'relative_masses = {list(relative)}\n')
    points = field_points(one, 'thermal', scene, tmp_path, 'none', rng)
    assert set(points.motions) == {f'branch {k}' for k in (1, 2, 3, 4)}
    k = 2 * np.pi * points.q[:, :2] @ np.linalg.inv(VECTORS['honeycomb']).T / one.stretch
    branch = np.array([int(motion.split()[1]) - 1 for motion in points.motions])[points.ridge]

    def share(springs=one.springs, masses=relative, static=True):
        true = bloch(one.law, 'honeycomb', k, springs, stretch=one.stretch, static=static, mass=MASS * np.array(masses))
        off = points.frequencies_Hz - true[np.arange(len(k)), branch] / (2 * np.pi)
        return np.mean(abs(off) < 1.96e3 / (2 * np.pi) * points.sigma_omega)

    assert share() >= 0.9
    assert share(static=False) < 0.5
    assert share(springs=one.springs[::-1]) < 0.5
    if relative[0] != relative[1]:
        assert share(masses=(1.3, 1.3)) < 0.5
        return
    values = fit_bands(scene, points).values()
    assert np.mean([abs(np.log(values[name][0] / true)) <= 1.96 * values[name][1] for name, true in one.truth.items()]) >= 0.8
