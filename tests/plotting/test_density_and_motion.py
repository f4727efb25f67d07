"""Densities, spectral functions, extents and films: what they show is what was given, in SI, on one scale."""

import numpy as np
import pytest
from cells import prototype
from figures import drawn, legend_of
from motion import patch

from magphonon import InversePower, MagneticRepulsion, lattices, modes, units as u
from magphonon.bands import lattice_density
from magphonon.bands.density import DensityOfStates, band_ranges
from magphonon.plotting import plot_density, plot_extents
from magphonon.plotting.modes import plot_shape
from magphonon.response import density_of_states, localisation


def test_densities_of_a_lattice_and_a_patch_share_axes():
    ax = plot_density(lattice_density(prototype(), steps=24), label='lattice')
    found = density_of_states(patch(12), moments=64)
    drawn(plot_density(found, ax=ax, label='patch'))
    assert legend_of(ax) == ['lattice', 'patch']
    assert ax.get_xlabel() == 'frequency (Hz)'
    for line in ax.lines:  # each is a share: its integral over Hz is one
        assert np.trapezoid(line.get_ydata(), line.get_xdata()) == pytest.approx(1, abs=0.03)  # 400 bins with peaks
    np.testing.assert_allclose(ax.lines[1].get_xdata(), found.frequencies_Hz)
    (shaded,) = ax.collections
    edges = shaded.get_paths()[0].vertices
    k = found.error.argmax()
    at = edges[np.isclose(edges[:, 0], found.frequencies_Hz[k])][:, 1]
    assert np.ptp(at) == pytest.approx(4 * found.error[k] / found.modes * 2 * np.pi * u.Hz, rel=1e-9)


def test_peaks_of_flat_branches_are_cut_and_their_heights_written():
    chain = lattices.chain(1.0, 1.0)
    chain.calc = MagneticRepulsion(chain, InversePower(1.0, 4.0), foundation=10.0)
    ax = plot_density(lattice_density(chain, model='conventional'))  # transverse: all at one frequency
    highest = ax.lines[0].get_ydata().max()
    assert 5 * ax.get_ylim()[1] < highest
    written = [text.get_text() for text in ax.texts]
    assert f'up to {highest:.2g}' in written
    assert all(float(text.removeprefix('up to ')) > ax.get_ylim()[1] for text in written)
    control = plot_density(lattice_density(prototype(), steps=24))
    assert control.get_ylim()[1] > control.lines[0].get_ydata().max()
    assert not control.texts


def test_extents_and_shapes():
    atoms, cell = patch(8), prototype()
    found = modes(atoms)
    extent = localisation(found, atoms)
    ranges = band_ranges(cell, 24)
    ax = drawn(plot_extents(extent, bands=ranges))
    np.testing.assert_allclose(ax.lines[0].get_ydata(), extent.participation)
    assert legend_of(ax) == ['bands of the lattice', 'modes']
    ax = drawn(plot_shape(atoms, found.shapes[3], title='a mode'))
    shares = ax.collections[0].get_array()
    assert np.sum(shares) == pytest.approx(1)
    arrows = ax.collections[1]
    length = np.linalg.norm(found.shapes[3], axis=1)
    drawn_ones = found.shapes[3][length > 0.03 * length.max()]
    np.testing.assert_allclose(np.stack([arrows.U, arrows.V], axis=1), drawn_ones / length.max() * 1.4 * 0.01, rtol=1e-9)


def test_a_mode_at_the_border_of_a_periodic_patch_is_drawn_in_one_piece():
    cell = prototype()
    sheet = cell.repeat((7, 8, 1))
    sheet.calc = MagneticRepulsion(sheet, cell.calc.law, foundation=cell.calc.foundation)
    shape = np.zeros((56, 2))
    shape[[0, 7, 48, 55], 0] = 2, 1, 1, 1  # the corners of the patch are neighbours of each other
    far = [np.ptp(plot_shape(atoms, shape).collections[1].XY, axis=0).max() for atoms in (sheet, patch_without_periods(sheet))]
    assert far[0] == pytest.approx(0.015)  # 1.5 spacings of 10 mm
    assert far[1] > 0.06  # control: where nothing repeats, the corners are far apart


def test_modes_are_drawn_about_the_defect_that_is_marked(tmp_path):
    """Whatever image of the hole a mode is centred on, all pictures show the same one."""
    cell = prototype()
    sheet = cell.repeat((7, 8, 1))
    sheet.calc = MagneticRepulsion(sheet, cell.calc.law, foundation=cell.calc.foundation)
    hole = sheet.positions[0, :2]
    rng = np.random.default_rng(1)
    for image in ([0, 0, 0], [1, 0, 0], [-1, 1, 0], [2, -1, 0]):
        shape = np.zeros((56, 2))
        shape[rng.choice([1, 7, 48, 49, 8]), 0] = 1  # neighbours of the hole, at opposite ends of the patch
        where = hole + (np.array(image) @ sheet.cell.array)[:2]
        ax = plot_shape(sheet, shape, centre=where, defects=[hole])
        cross = next(line for line in ax.lines if line.get_label() == 'defect')
        np.testing.assert_allclose(np.ravel(cross.get_xydata()), where / 1e3, atol=1e-12)
        drawn = ax.collections[1]
        assert np.linalg.norm(drawn.XY - where / 1e3, axis=1).max() < 0.0101  # one spacing of 10 mm


def patch_without_periods(sheet):
    alone = sheet.copy()
    alone.pbc = False
    alone.calc = sheet.calc
    return alone


def test_the_highest_of_several_densities_fits_on_the_axes():
    f = 2 * np.pi * np.linspace(-1e-9, 0.1, 50)  # round-off below zero
    low, high = (DensityOfStates(f, height * np.ones(50), 1.0, 0 * f, 0 * f) for height in (1.0, 5.0))
    ax = drawn(plot_density(high, ax=plot_density(low)))
    assert ax.get_ylim()[0] == 0
    assert ax.get_ylim()[1] > max(line.get_ydata().max() for line in ax.lines)
    assert ax.get_xlim()[0] == 0
