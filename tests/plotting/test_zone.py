"""The Brillouin zone with the path and its points."""

import numpy as np
import pytest
from cells import prototype
from figures import bands_of, drawn, ideal, texts_of

from magphonon import lattices, units as u
from magphonon.bands import band_path
from magphonon.plotting.zone import plot_zone


def test_zone_with_its_path():
    ax = drawn(plot_zone(bands_of(prototype()).path))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ('$k_x$ (rad/mm)', '$k_y$ (rad/mm)')
    (zone,) = ax.patches
    M, K = 2 * np.pi / (np.sqrt(3) * 0.010), 4 * np.pi / (3 * 0.010)  # rad/m
    corners = zone.get_xy()[:-1]
    assert corners.shape == (6, 2)
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), K, rtol=1e-12)
    path = np.linalg.norm(ax.lines[0].get_xydata(), axis=1)
    np.testing.assert_allclose(path, [0, M, K, 0], rtol=1e-7, atol=1e-9)  # ASE's special points carry eight digits
    assert {'Γ', 'M', 'K'} <= texts_of(ax)
    assert ax.get_aspect() == 1


@pytest.mark.parametrize('seed', range(6))
def test_the_path_is_drawn_in_the_upper_half_of_the_zone(seed):
    cell, angle = lattices.triangular(1.0, 1.0), np.random.default_rng(seed).uniform(0, 360) if seed else 0.0
    cell.rotate(angle, 'z', rotate_cell=True)
    path = band_path(cell, npoints=0)
    own = path.cell.reciprocal().array[:, :2] * 2 * np.pi * u.m
    given = np.array([q @ own for q in path.special_points.values()])
    if angle == 0:
        assert given[:, 1].sum() < 0  # ASE has them in the lower half
    dots = np.array([line.get_xydata()[0] for line in plot_zone(path).lines if line.get_marker() == 'o'])
    assert dots[:, 1].sum() >= 0
    assert len(dots) > 2
    for dot in dots:
        assert min(abs(np.concatenate([given - dot, given + dot])).max(axis=1)) < 1e-9 * abs(own).max()  # k or -k


def test_zone_path_with_a_break_is_drawn_in_two():
    cell = ideal(lattices.square, foundation=5e4)
    path = bands_of(cell, 'GX,MG').path
    stretches = [line for line in plot_zone(path).lines if len(line.get_xdata()) > 1]
    assert [len(line.get_xdata()) for line in stretches] == [2, 2]
