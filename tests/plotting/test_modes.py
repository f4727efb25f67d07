"""Modes drawn on their lattice."""

from types import SimpleNamespace

import numpy as np
import pytest
from ase.cell import Cell
from cells import prototype
from figures import arrows_of, bands_of, drawn, ideal

from magphonon import lattices, units as u
from magphonon.bands.bands import Bands
from magphonon.plotting.bands import mode_names, name_branches, plot_bands
from magphonon.plotting.modes import plot_mode


def test_shear_and_longitudinal_mode_at_M():
    cell = prototype()
    bands = bands_of(cell, vectors=True)
    ax = drawn(plot_mode(cell, bands, 'M', 0))
    assert ax.get_title(loc='left') == 'M, branch 1\n58.23 Hz, shear'
    assert (ax.get_xlabel(), ax.get_ylabel()) == ('$x$ (mm)', '$y$ (mm)')
    (x, y), (ux, uy) = arrows_of(ax)
    k = 2 * np.pi / (np.sqrt(3) * 0.010)  # rad/m, along y: neighbouring rows 8.66 mm apart move against each other
    largest = ux[np.hypot(x, y).argmin()]
    assert 0.2 * 0.010 < abs(largest) < 0.5 * 0.010  # m: seen, and not reaching the neighbour's
    np.testing.assert_allclose(ux, largest * np.cos(k * y), atol=1e-9 * abs(largest))
    np.testing.assert_allclose(uy, 0, atol=1e-9 * abs(largest))
    _, (ux, uy) = arrows_of(plot_mode(cell, bands, 'M', 1))  # control: the other branch moves the other way
    np.testing.assert_allclose(ux, 0, atol=1e-9 * abs(uy).max())
    assert abs(uy).max() == pytest.approx(abs(largest), rel=1e-9)


def test_mode_far_from_special_points_and_at_a_crossing():
    cell = prototype()
    bands = bands_of(cell, vectors=True)
    assert plot_mode(cell, bands, 40, 1).get_title(loc='left').startswith(f'$q$ = (0, {bands.path.kpts[40, 1]:.3g}), branch 2\n')
    assert plot_mode(cell, bands, 'K', 0).get_title(loc='left') == 'K, branch 1\n119.9 Hz, degenerate'


def test_light_and_heavy_particles_swing_by_their_masses():
    # At Gamma the optical mode of a honeycomb cell leaves the centre of mass at rest: u1/u2 = -m2/m1.
    cell = ideal(lattices.honeycomb)
    cell.set_masses([1 * u.kg, 4 * u.kg])
    bands = bands_of(cell, vectors=True)
    _, (ux, uy) = arrows_of(plot_mode(cell, bands, 'G', 3))
    arrows = np.array([ux, uy])
    heavy = np.linalg.norm(arrows, axis=0) < 0.5 * np.linalg.norm(arrows, axis=0).max()
    assert heavy.any()
    light = np.repeat(-4 * arrows[:, heavy][:, :1], (~heavy).sum(), axis=1)
    np.testing.assert_allclose(arrows[:, ~heavy], light, atol=1e-9 * abs(arrows).max())


def test_unstable_mode_shows_its_growth_rate():
    cell = ideal(lattices.square)
    title = plot_mode(cell, bands_of(cell, 'GXMG', vectors=True), 'X', 0).get_title(loc='left')
    assert title == 'X, branch 1\nunstable, grows at 200 1/s'  # sqrt(4 f/(L M))


@pytest.mark.parametrize('path', ['GMKG', 'GK'])
def test_branches_are_named_by_their_motion_beside_their_own_curve(path):
    cell = prototype()
    bands = bands_of(cell, path, vectors=True)
    ax = plot_bands(bands)
    name_branches(ax, bands)
    x, height = bands.path.get_linear_kpoint_axis()[0], ax.get_ylim()[1]
    named = {text.get_text(): text.get_position() for text in ax.texts}
    assert set(named) == {'shear', 'longitudinal'}  # shear is the softer one up to K
    for name, (at, y) in named.items():
        k = abs(x - at).argmin()
        share = bands.longitudinal[k]
        branch = share.argmax() if name == 'longitudinal' else share.argmin()
        apart = abs(bands.frequencies_Hz[k] - y) / height
        assert apart[branch] < 0.14
        assert (np.delete(apart, branch) > 0.035).all()  # the other curve does not run through the name


def test_modes_of_a_layer_out_of_its_plane_are_named_so():
    def path(periods):  # the same wavevector in a chain, a layer and a crystal
        points = dict(enumerate(np.eye(3)[:periods]))
        return SimpleNamespace(kpts=np.array([[0.1, 0, 0]]), cell=Cell(np.eye(3)), special_points=points)

    modes = np.eye(3).reshape(1, 3, 1, 3).astype(complex)  # along x, y and z
    names = [mode_names(Bands(path(periods), np.array([[3.0, 2.0, 1.0]]), modes)).tolist() for periods in (1, 2, 3)]
    other = [['longitudinal', 'transverse', 'transverse']]
    assert names == [other, [['longitudinal', 'shear', 'out of the plane']], other]
