"""Lattices measured in a photo, and the intervals of finite structures: of specimens that the package did not simulate."""


import numpy as np
import pytest

from magphonon import modes, read_scene, units as u
from magphonon.design import mode_scatter
from magphonon.stiffness import Scatter
from tests.drawn_lattices import VECTORS, drawn_magnets, needed
from workflows import bench_lattice as bench

FORCE, A, K, SPACING = 0.2883, 3.77, 60.0, 10e-3  # N, of the force FORCE (SPACING/r)^A, N/m and m
PLACES = bench.sites(bench.triangular(SPACING), 0.075, 0.07)
REACH = 0.2  # m: all pairs
KNOWN = {'strength': 0.025, 'mass': 0.005, 'stiffness': 0.05}  # standard deviations from site to site
SCENE = """title = "A photo"
[lattice]
kind = "file"
file = "photo.csv"
mass_kg = 8e-4
cutoff_m = {cutoff}
{lattice}
[law]
{law}
{foundation}
"""
POWER = f'kind = "inverse_power"\nb_N_m_a = {FORCE * SPACING**A!r}\na = 3.77\nshells = 1'


def specimen(rng, missing=0, scatter=(0.025, 1.5e-4, 0.05, 0.005), off=(1.0, 1.0, 1.0), law=None, places=PLACES, springs=(K, K)):
    """A patch with some magnets missing, each with its own foot, strength, mass and pillar, its rim held; and its modes in Hz.

    All strengths, pillars and masses are `off` by three factors.
    """
    strength, spring, mass = off
    law = law or bench.tabulated(bench.power_law(FORCE, A, SPACING), 5e-3, REACH)
    law = bench.replace(law, force=strength**2 * law.force, slope=strength**2 * law.slope)
    inside = np.flatnonzero((abs(places) < 0.028).all(axis=1))
    gone = rng.choice(inside, missing, replace=False)
    lab = bench.built(places, law, REACH, rng, springs=np.array(springs) * spring, mass=8e-4 * mass, scatter=scatter,
                      missing=gone)
    return lab, bench.modes(lab)[0] / (2 * np.pi)


def photographed(folder, lab, rng, noise=0.0, at=None, keys='positions = "rest"', foundation=None, law=POWER, cutoff=0.2,
                 **columns):
    """The scene of a photo, turned, of any scale, in any order, whose two known points are far outside the magnets."""
    scale, turn, origin = rng.uniform(5e3, 3e4), rng.uniform(0, 2 * np.pi), rng.uniform(0, 3000, 2)
    marks = np.array([[-0.08, -0.07], [0.075, -0.06]])

    def seen(at):
        z = scale * np.exp(1j * turn) * (at @ [1, 1j])
        return np.stack([z.real, -z.imag], axis=1) + origin

    x, y = seen((lab.rest if at is None else at) + noise * rng.normal(size=lab.rest.shape)).T
    columns = {'x_px': x, 'y_px': y, 'held': lab.held} | columns
    rows = np.stack(list(columns.values()), axis=1)[rng.permutation(len(x))]
    (folder / 'photo.csv').write_text('\n'.join([','.join(columns), *(','.join(f'{x:.17g}' for x in row) for row in rows)]))
    foundation = f'[foundation]\nstiffness_N_per_m = {K}' if foundation is None else foundation
    text = SCENE.format(lattice=f'{keys}\npoints_px = {seen(marks).tolist()}\npoints_m = {marks.tolist()}', law=law,
                        foundation=foundation, cutoff=cutoff)
    (folder / 'photo.toml').write_text(text.replace('mass_kg = 8e-4\n', '') if 'mass_kg' in columns else text)
    return read_scene(folder / 'photo.toml')


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(3))
def test_a_photo_of_magnets_of_known_strength_gives_the_frequencies_of_the_lattice(seed, tmp_path):
    """Nothing is left to chance: what differs is the photo, read as that of the feet."""
    rng = np.random.default_rng(seed)
    lab, truth = specimen(rng, missing=1 + seed % 3)
    known = {'strength': lab.strengths, 'stiffness_N_per_m': lab.springs[:, 0], 'mass_kg': lab.masses, 'foundation': ''}
    found = modes(photographed(tmp_path, lab, rng, **known).atoms()).frequencies_Hz
    np.testing.assert_allclose(found, truth, rtol=1e-8)  # of a law by table
    twice = modes(photographed(tmp_path, lab, rng, **known, keys='positions = "anchors"').atoms()).frequencies_Hz
    assert abs(twice / truth - 1).max() > 0.02  # the control: moved to rest a second time
    feet = photographed(tmp_path, lab, rng, **known, at=lab.anchors, keys='positions = "anchors"')
    np.testing.assert_allclose(modes(feet.atoms()).frequencies_Hz, truth, rtol=1e-7)  # a force of 1e-9 remains


def pillars(springs=(K, K)):
    return f'[foundation]\nstiffness_N_per_m = {springs[0]}\nstiffness_y_N_per_m = {springs[1]}\n'


@pytest.mark.slow
@pytest.mark.parametrize(('positions', 'place', 'least'), [
    ('rest', 3e-5, 0.92), ('anchors', 1.5e-4, 0.88)])  # the first order knows no shift of the mean
def test_stated_intervals_hold_the_frequencies_of_specimens(positions, place, least, tmp_path):
    """95 % of them, of specimens whose strengths, masses, pillars and places nobody knows."""
    inside, near = [], []
    for seed in range(12):
        rng = np.random.default_rng(100 + seed)
        lab, truth = specimen(rng)
        at, noise = (lab.rest, place) if positions == 'rest' else (PLACES, 0.0)
        photographed(tmp_path, lab, rng, noise, at, f'positions = "{positions}"', pillars())
        for cutoff, found in (('0.2', inside), ('0.012', near)):
            file = tmp_path / 'photo.toml'
            file.write_text(file.read_text().replace('cutoff_m = 0.2', f'cutoff_m = {cutoff}'))
            scatter = Scatter(position=place * u.m, **KNOWN)
            omega, std = mode_scatter(read_scene(file).atoms(), scatter, at_rest=positions == 'rest')
            found.append(abs(u.hertz(omega) - truth) < 1.96 * u.hertz(std))
    assert np.mean(inside) >= least
    assert np.mean(np.array(inside)[:, :6]) >= least - 0.07  # the lowest: 72 that come in specimens
    assert np.mean(near) < 0.8  # the control: nearest neighbours alone


def standing(rng, *args, **told):
    """A specimen that stands: beside a hole the next magnets may slip into it."""
    for _ in range(9):
        try:
            return specimen(rng, *args, **told)
        except RuntimeError:
            continue
    raise RuntimeError('none of nine patches stands')


@pytest.mark.long
def test_photos_of_drawn_magnets(tmp_path):
    """24 specimens: rings, cubes, two powers, two lattices, kx unlike ky; nearest neighbours alone as the control."""
    cells = {'every pair': ([], []), 'nearest neighbours': ([], [])}
    for seed in range(24):
        rng, lattice = np.random.default_rng([seed, 364]), ('triangular', 'square')[seed % 2]
        law, head, shape = drawn_magnets(('ring', 'cube', 'two powers', 'disc', 'screened')[seed % 5], rng)
        springs = (1.5 * needed(law, lattice) + 40) * rng.uniform([0.9, 1.0], [1.1, 1.3])
        lab, truth = standing(rng, seed % 3, law=law, places=bench.sites(VECTORS[lattice], 0.075, 0.07), springs=springs)
        for name, cutoff in (('every pair', 0.2), ('nearest neighbours', 0.012)):
            scene = photographed(tmp_path, lab, np.random.default_rng(seed), 3e-5, lab.rest, foundation=pillars(springs),
                                 law=f'{head}shells = 1\n{shape}', cutoff=cutoff)
            omega, std = mode_scatter(scene.atoms(), Scatter(position=3e-5 * u.m, **KNOWN), at_rest=True)
            for values, one in zip(cells[name], (u.hertz(omega) / truth - 1, 1.96 * u.hertz(std) / truth), strict=True):
                values.append(one)
    shares = {}
    for name, (off, half) in cells.items():
        least = np.mean([abs(a[:6]) < b[:6] for a, b in zip(off, half, strict=True)])
        off, half = np.concatenate(off), np.concatenate(half)
        shares[name] = np.mean(abs(off) < half)
        print(f'{name}: {shares[name]:.3f} of {len(off)}, the six lowest {least:.3f}; half width {100 * np.median(half):.2f} %, '
              f'1.96 rms error {196 * np.sqrt(np.mean(off**2)):.2f} %', flush=True)
    off, half = map(np.concatenate, cells['every pair'])
    assert np.median(half) < 2 * 1.96 * np.sqrt(np.mean(off**2))
    assert shares['every pair'] >= 0.90
    assert shares['nearest neighbours'] < 0.7


@pytest.mark.parametrize(('columns', 'keys', 'message'), [
    ('x_px,y_px', '', 'the columns x_px,y_px are pixels of a photo; give the pixels of two known points'),
    ('x_px,y_px', 'points_px = [[0, 0], [9, 9]]', 'give the pixels of two known points'),
    ('x_px,y_px', 'points_px = [[1, 1], [1, 1]]\npoints_m = [[0, 0], [1, 0]]', 'give the pixels of two known points'),
    ('x_px,y_px', 'points_px = [[1, 1]]\npoints_m = [[0, 0]]', 'give the pixels of two known points'),
    ('x_px,y_mm', '', 'has the columns x_px, y_mm; give both in pixels or none'),
    ('x_mm,y_mm', 'points_px = [[0, 0], [9, 9]]', 'belong to a table with the columns x_px,y_px; remove them'),
    ('x_mm,y_mm', 'positions = "feet"', "lattice.positions must be one of 'anchors', 'rest'"),
])
def test_refusals(columns, keys, message, tmp_path):
    (tmp_path / 'photo.csv').write_text(f'{columns}\n0,0\n10,0\n')
    (tmp_path / 'photo.toml').write_text(SCENE.format(lattice=keys, law=POWER, foundation='', cutoff=0.2))
    with pytest.raises(ValueError, match=message):
        read_scene(tmp_path / 'photo.toml')
