"""What the pictures of waves show, in SI."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.contour import ContourSet
from numpy.testing import assert_allclose

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.bands.bloch import bloch_modes
from magphonon.dynamics.motion import Motion
from magphonon.plotting.animation import animate
from magphonon.plotting.fields import plot_field_at
from magphonon.plotting.waves import plot_crossing, plot_snapshot, plot_wave
from magphonon.waves.wave_analysis import waves
from magphonon.waves.wave_source import BurstRecord, burst_setup, polarisations


def wave_of(cell, amplitude=1.0):
    """A shear wave of the complete model at xi = 1: 141.421356 rad/s sin(1/2) = 10.791 Hz."""
    t, n = 2.0 * np.arange(400)[:, None], np.arange(40)
    motion = amplitude * np.cos(0.141421356 * np.sin(0.5) * t - n)
    return waves(Motion(t[:, 0], n, motion[..., None] * polarisations(cell, 'row')['transverse']), cell, 'row')[0]


def test_a_map_has_its_branches_and_its_ridge_in_hertz(ideal):
    ax = plot_wave(wave_of(ideal))
    assert ax.get_ylabel() == 'frequency (Hz)'
    assert '(rad)' in ax.get_xlabel()
    branches = [line for line in ax.lines if len(line.get_xdata()) > 1000]
    assert [line.get_linestyle() for line in branches] == ['-', '-', '--', '--']  # told apart without colour
    # at M: complete 141.42 and 469.04 rad/s, conventional 282.84 and 489.90 (Sec. IV)
    edges = [2 * np.pi * line.get_ydata()[-1] for line in branches]
    assert_allclose(edges, [141.421356, 469.041576, 282.842712, 489.897949], rtol=1e-7)
    (ridge,) = ax.containers
    assert_allclose(ridge[0].get_xdata(), 1, atol=0.01)
    assert_allclose(ridge[0].get_ydata(), 141.421356 * np.sin(0.5) / (2 * np.pi), rtol=1e-3)
    assert [text.get_text() for text in ax.get_legend().get_texts()] == ['complete', 'conventional', 'ridge']
    assert ax.get_legend().get_title().get_text() == 'transverse motion'
    assert ax.get_ylim()[1] > 11
    ax.figure.canvas.draw()


def test_the_map_does_not_depend_on_the_amplitude(ideal):
    small, large = (plot_wave(wave_of(ideal, amplitude)).collections[0].get_array() for amplitude in (1e-9, 1.0))
    assert_allclose(small, large, atol=1e-6)
    assert large.max() == 0
    assert large.min() == -40


def test_a_wave_that_runs_backwards_leaves_an_empty_map(ideal):
    t, n = 2.0 * np.arange(400)[:, None], np.arange(40)
    u = np.cos(0.07 * t + n)[..., None] * polarisations(ideal, 'row')['transverse']
    (wave,) = waves(Motion(t[:, 0], n, u), ideal, 'row')
    assert wave.ridge is None
    ax = plot_wave(wave)
    assert ax.collections[0].get_array().max() < -30
    assert ax.get_ylim()[1] > 0.07 / (2 * np.pi) * 1e3  # Hz


@pytest.fixture
def passage(ideal):
    """Particles of a patch that move one after the other, up the measured row."""
    patch = lattices.parallelogram(ideal, 12, 12)
    patch.calc = MagneticRepulsion(patch, ideal.calc.laws)
    where = burst_setup(ideal, patch, 'row')
    rise = np.zeros((len(where.row), len(patch), 2))
    rise[np.arange(len(where.row)), where.row, 1] = 3 * u.mm
    t = 100.0 * np.arange(len(where.row)) * u.ms
    return patch, where, BurstRecord(Motion(t, where.row, rise[:, where.row]), Motion(t, np.arange(len(patch)), rise),
                                 3 * u.mm)


def test_a_snapshot_shows_where_particles_rest_and_how_far_they_are(passage):
    patch, where, left = passage
    ax = plot_snapshot(patch, left.field, 4, where)
    dots = ax.collections[0]
    assert_allclose(dots.get_offsets(), patch.positions[:, :2] / 1000)  # mm in m
    assert np.argmax(dots.get_array()) == where.row[4]
    assert dots.get_array().max() == pytest.approx(3)
    assert ax.figure.axes[1].get_ylabel() == 'displacement $u_y$ (mm)'
    assert sum(dots.get_clim()) == 0
    assert (ax.get_xlabel(), ax.get_ylabel()) == ('$x$ (m)', '$y$ (m)')
    assert ax.get_legend().get_title().get_text() == 'complete model, 0.400 s after the start'
    measured = next(line for line in ax.lines if line.get_label() == 'row')
    assert_allclose(measured.get_ydata(), patch.positions[where.row, 1] / 1000)
    ax.figure.canvas.draw()


def test_a_crest_and_a_trough_have_opposite_colours(passage):
    patch, where, left = passage
    left.field.displacements[4, where.row[5], 1] = -3 * u.mm  # the particle behind moves against the first one
    colours = plot_snapshot(patch, left.field, 4, where).collections[0]
    crest, trough = colours.to_rgba(colours.get_array())[where.row[4:6], :3]
    assert crest[0] > 2 * crest[2]  # red
    assert trough[2] > 2 * trough[0]  # blue


def test_one_moment_of_two_simulations_is_drawn_on_one_scale(passage):
    patch, where, early = passage
    field = early.field
    late = BurstRecord(Motion(field.times, where.row, np.roll(field.displacements[:, where.row], 2, axis=0) / 2),
                   Motion(field.times, field.particles, np.roll(field.displacements, 2, axis=0) / 2), 1.5 * u.mm)
    figure = plot_crossing({'late': (patch, where, late), 'early': (patch, where, early)})
    figure.canvas.draw()
    (one, other), bars = figure.axes[:2], figure.axes[2:]
    assert len(bars) == 1
    assert one.collections[0].get_clim() == other.collections[0].get_clim()
    moved = [ax.collections[0].get_array() for ax in (one, other)]
    middle = len(where.row) // 2  # the earlier one is there
    assert [array.argmax() for array in moved] == [where.row[middle - 2], where.row[middle]]
    assert [array.max() for array in moved] == [1.5, 3]
    assert [ax.get_title(loc='left') for ax in (one, other)] == ['(a) late, 0.5 s', '(b) early, 0.5 s']


@pytest.mark.slow
def test_a_film_has_one_scale_and_fixed_axes(passage, tmp_path):
    from PIL import Image

    patch, where, left = passage
    left.field.displacements[:] *= np.exp(-np.arange(len(left.field.times)))[:, None, None]  # it decays
    animate(tmp_path / 'film.gif', patch, left.field.displacements, left.field.times, site=where)
    with Image.open(tmp_path / 'film.gif') as film:
        frames = []
        for k in range(film.n_frames):
            film.seek(k)
            frames.append(np.asarray(film.convert('RGB'), dtype=int))
    red = [(frame[..., 0] - frame[..., 1])[:, : frame.shape[1] // 2].max() for frame in frames]  # crests, not the colour bar
    assert red[0] > 2 * red[-1] + 20
    ink = np.array([frame.max(axis=2) < 100 for frame in frames])[:, -100:]  # the axis of x
    changed = (ink ^ ink[0]).sum(axis=(1, 2)) / ink[0].sum()
    assert changed.max() < 0.2  # each frame of a GIF has its own palette; axes that moved by two pixels would change half
    assert (np.roll(ink[0], (2, 2), (0, 1)) ^ ink[0]).sum() > 0.5 * ink[0].sum()


def test_contours_of_a_field_are_where_the_branches_have_its_frequency():
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, InversePower(2370.0, 4.0), foundation=0.02)
    k, omega, rng = np.linspace(-0.45, 0.45, 61), 0.5, np.random.default_rng(0)
    field = SimpleNamespace(sites=rng.uniform(0, 50, (5, 2)), spacing=10.0)
    zone = plot_field_at(field, cell, omega, (k, rng.uniform(0.1, 1, (61, 61)), rng.normal(size=(5, 2)) + 0j)).axes[0]
    contours = [part for part in zone.collections if isinstance(part, ContourSet)]
    assert contours
    for part in contours:
        q = np.concatenate([path.vertices for path in part.get_paths()]) @ cell.cell.array[:2, :2].T / (2 * np.pi)
        found = np.stack([bloch_modes(cell, np.pad(q, ((0, 0), (0, 1))), model)[0] for model in ('complete', 'conventional')])
        assert abs(found - omega).min(axis=(0, 2)).max() < 0.01 * omega  # between the points of the mesh
