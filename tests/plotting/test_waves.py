"""What the pictures of waves show, in SI."""

import numpy as np
import pytest
from numpy.testing import assert_allclose

from magphonon import MagneticRepulsion, lattices, units as u
from magphonon.plotting.axes import panels
from magphonon.plotting.waves import crossing, plot_snapshot, plot_wave
from magphonon.waves.tone_burst import Passage
from magphonon.waves.vibrometer import Displacements
from magphonon.waves.wave_analysis import waves
from magphonon.waves.wave_source import polarisations, site


def wave_of(cell, amplitude=1.0):
    """A shear wave of the complete model at xi = 1: 141.421356 rad/s sin(1/2) = 10.791 Hz."""
    t, n = 2.0 * np.arange(400)[:, None], np.arange(40)
    motion = amplitude * np.cos(0.141421356 * np.sin(0.5) * t - n)
    return waves(Displacements(t[:, 0], n, motion[..., None] * polarisations(cell, 'row')['transverse']), cell, 'row')[0]


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
    (wave,) = waves(Displacements(t[:, 0], n, u), ideal, 'row')
    assert wave.ridge is None
    ax = plot_wave(wave)
    assert ax.collections[0].get_array().max() < -30
    assert ax.get_ylim()[1] > 0.07 / (2 * np.pi) * 1e3  # Hz


@pytest.fixture
def passage(ideal):
    """Particles of a patch that move one after the other, up the measured row."""
    patch = lattices.parallelogram(ideal, 12, 12)
    patch.calc = MagneticRepulsion(patch, ideal.calc.potential)
    where = site(ideal, patch, 'row')
    rise = np.zeros((len(where.row), len(patch), 2))
    rise[np.arange(len(where.row)), where.row, 1] = 3 * u.mm
    t = 100.0 * np.arange(len(where.row)) * u.ms
    return patch, where, Passage(Displacements(t, where.row, rise[:, where.row]), Displacements(t, np.arange(len(patch)), rise),
                                 3 * u.mm)


def test_a_snapshot_shows_where_particles_rest_and_how_far_they_are(passage):
    patch, where, left = passage
    ax = plot_snapshot(patch, left.field, 4, where)
    dots = ax.collections[0]
    assert_allclose(dots.get_offsets(), patch.positions[:, :2] / 1000)  # mm in m
    assert np.argmax(dots.get_array()) == where.row[4]
    assert dots.get_array().max() == pytest.approx(3e-3)
    assert (ax.get_xlabel(), ax.get_ylabel()) == ('$x$ (m)', '$y$ (m)')
    assert ax.get_legend().get_title().get_text() == 'complete model, 0.400 s after the start'
    measured = next(line for line in ax.lines if 'measured' in line.get_label())
    assert_allclose(measured.get_ydata(), patch.positions[where.row, 1] / 1000)
    ax.figure.canvas.draw()


def test_crossing_is_when_the_middle_of_the_row_moves(passage):
    _, where, left = passage
    assert crossing(left) == len(where.row) // 2


def test_panels_are_always_a_table_of_axes():
    for shape in ((1, 2), (2, 2), (1, 1)):
        assert panels(*shape)[1].shape == shape
