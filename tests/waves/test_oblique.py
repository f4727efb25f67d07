"""Point sources: what a row sees of oblique waves, by the Green function of the lattice, and uncertainties that take it in."""

import numpy as np
import pytest
from scans import scene_text, triangular_branches

from magphonon import MagneticRepulsion, lattices, propagate, read_scene, units as u
from magphonon.dynamics import Motion
from magphonon.waves import burst_setup, sampled, waves, wavevector
from magphonon.waves.wave_analysis import Stationary, stationary_waves

NORMAL = 1.96
XI = np.linspace(0, np.pi, 1001)


def drawn(seed):
    """Spacing, mass, tension f/L and stiffness a f/L of a bond and foundation of a triangular lattice, in mm, g, N/mm."""
    rng = np.random.default_rng([31, seed])
    L, m, f, a, k = rng.uniform([8, 0.5, 0.15, 3.2, 0.015], [14, 1, 0.4, 5, 0.03])
    return rng, L, m, f / L, a * f / L, k


def scene_of(folder, L, m, tension, stiffness, k):
    a = stiffness / tension
    (folder / 'my.toml').write_text(scene_text(1e-3 * L, 1e-3 * m, tension * L * (1e-3 * L) ** a, a, 1e3 * k))
    return read_scene(folder / 'my.toml')


def seen_from_a_point(omega, direction, m, tension, stiffness, k, places=500):
    """Response along R2 to a force at its start, by a sum of closed-form Bloch matrices over the zone; a little damped."""
    one, two = np.meshgrid(*2 * [2 * np.pi * np.arange(places) / places], indexing='ij')
    D = np.zeros((places, places, 2, 2)) + k * np.eye(2)
    for angle, phase in ((0, one), (60, two), (120, two - one)):
        n = np.array([np.cos(np.radians(angle)), np.sin(np.radians(angle))])
        D += 2 * (1 - np.cos(phase))[..., None, None] * (stiffness * np.outer(n, n) - tension * (np.eye(2) - np.outer(n, n)))
    G = np.linalg.inv(D - m * (omega * (1 - 0.006j)) ** 2 * np.eye(2))
    return np.fft.ifft(np.einsum('i,xyij,j->xy', direction, G, direction).mean(axis=0))


@pytest.mark.parametrize('seed', range(3))
def test_the_row_sees_the_oblique_wave_where_the_bands_say(seed, tmp_path):
    """Driven along the row at a frequency of a longitudinal wave, a long row sees an oblique shear wave that is stronger."""
    rng, *lattice = drawn(seed)
    _, m, tension, stiffness, k = lattice
    cell = scene_of(tmp_path, *lattice).atoms()
    own = rng.uniform(0.8, 1.3)
    omega = np.interp(own, XI, triangular_branches(XI, 60, 1.0, m, tension, stiffness, k)[:, 1])
    found = stationary_waves(cell, wavevector(cell, 'point'))[1].phases([omega])
    n = np.arange(20, 140)
    row = seen_from_a_point(omega, np.array([0.5, 3**0.5 / 2]), m, tension, stiffness, k)[n]
    window = np.sin(np.pi * (n - 19.5) / len(n)) ** 2
    xi = np.linspace(0.2, 1.7, 1501)
    power = max((abs(np.exp(sign * 1j * np.outer(xi, n)) @ (row * window)) for sign in (1, -1)), key=max)
    peak = xi[power.argmax()]
    assert np.nanmin(abs(found - peak)) < 2 * np.pi / len(n) / 2  # half a bin of this row
    assert abs(own - peak) > 2 * np.pi / len(n)  # the control: the wave along the row is not the strongest


def scanned(seed, folder, source='point'):
    """Errors of the ridges of a simulated burst in their uncertainties, with oblique waves and without, in turn."""
    rng, *lattice = drawn(seed)
    L, m, tension, stiffness, k = lattice
    cell = scene_of(folder, *lattice).atoms()
    patch = lattices.half_hexagon(cell, side=L * rng.integers(18, 25))
    patch.calc = MagneticRepulsion(patch, cell.calc.laws, foundation=k)
    where, angle = burst_setup(cell, patch, source), np.radians(rng.uniform(0, 180))
    branches = triangular_branches(XI, 60, 1.0, m, tension, stiffness, k)
    carrier = np.interp(rng.uniform(0.6, 2.0), XI, branches[:, 0])
    times = 1.0 * np.arange(1, 400)
    drive = where.burst((np.cos(angle), np.sin(angle)), 2.5e-4 * u.N, carrier)
    moved = propagate(patch, times, [drive], 0.02 * carrier, where.row)
    noise = rng.uniform(0.01, 0.05) * abs(moved.displacements[:, len(where.row) // 2]).max()
    record = sampled(moved, 1.0, noise, seed)
    for wave in waves(record, cell, source):
        if wave.ridge:
            r = wave.ridge
            off = [r.omega - np.interp(r.xi, XI, one) for one in branches.T]
            slopes = [np.interp(r.xi, XI, np.gradient(one, XI)) for one in branches.T]
            for sigma in (wave.sigma_xi, r.sigma_xi):
                yield np.min([abs(d) / np.hypot(r.sigma_omega, s * sigma) for d, s in zip(off, slopes, strict=True)], axis=0)


@pytest.mark.slow
def test_uncertainties_of_ridges_from_a_point_cover_the_branch(tmp_path):
    """Twenty-four drawn lattices, patches, carriers, directions of the force and noises."""
    found = [one for seed in range(24) for one in scanned(seed, tmp_path)]
    scores, without = (np.concatenate(found[k::2]) for k in (0, 1))
    print(f'\n{len(scores)} points: coverage {np.mean(scores < NORMAL):.3f}, by all else {np.mean(without < NORMAL):.3f}')
    assert len(scores) > 200
    assert np.mean(scores < NORMAL) >= 0.95
    assert np.mean(without < NORMAL) < 0.9  # the control


def test_a_row_of_sources_sends_no_oblique_waves(tmp_path):
    _, *lattice = drawn(40)
    cell = scene_of(tmp_path, *lattice).atoms()
    t, n = np.arange(0, 400, 2.0)[:, None], np.arange(24)
    omega = triangular_branches(np.array([1.2]), 60, 1.0, *lattice[1:])[0, 0]
    across = np.array([-(3**0.5) / 2, 0.5])
    u_row = 1e-3 * np.sin(omega * t - 1.2 * n)[..., None] * across * (np.sin(np.pi * t / 400) ** 2)[..., None]
    by_source = {}
    for source in ('row', 'point'):
        wave = waves(sampled(Motion(t[:, 0], n, u_row), 0.5, 1e-5), cell, source)[0]
        by_source[source] = wave.blurred
    assert by_source == {'row': 0, 'point': by_source['point']}
    assert by_source['point'] > 0  # the control


@pytest.mark.parametrize('seed', range(3))
def test_phases_between_the_points_of_the_grid(seed):
    """omega = top sin(xi/2) is inverted in closed form; from each point of the grid by its tangent, to the square of a step."""
    rng = np.random.default_rng(seed)
    top, xi = rng.uniform(0.3, 3), (np.arange(200) + 0.5) * np.pi / 200
    grid = Stationary(xi, top * np.sin(xi / 2), top / 2 * np.cos(xi / 2), np.pi / 200)
    asked = rng.uniform(0.1, 2.6, 9)
    found = grid.phases(top * np.sin(asked / 2))
    assert (np.isfinite(found).sum(axis=1) >= 1).all()
    assert np.nanmax(abs(found - asked[:, None])) < grid.step**2  # half of it times the curvature over the slope, below 2
    assert np.nanmax(abs(np.where(np.isfinite(found), xi, np.nan) - asked[:, None])) > 0.3 * grid.step  # the control
    assert np.isnan(grid.phases([1.01 * top, 1.1 * top])).all()
