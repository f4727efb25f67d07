"""Maps over the Brillouin zone: ratios, the path and its points."""

import numpy as np
import pytest
from cells import prototype
from figures import bands_of, drawn, ideal, legend_of, maps_of, texts_of
from matplotlib.contour import QuadContourSet

from magphonon import lattices, units as u
from magphonon.bands import band_path
from magphonon.plotting.zone import plot_ratio, plot_zone


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


def is_cut_at_the_zone(artist, ax):
    clip = artist.get_clip_path()
    return clip is not None and np.array_equal(clip.get_fully_transformed_path().vertices,
                                               ax.patches[0].get_transform().transform(ax.patches[0].get_xy()))


def hatched_in(ax):
    return [artist for artist in ax.collections if isinstance(artist, QuadContourSet) and any(artist.hatches)]


def test_unstable_part_of_the_zone_is_hatched():
    soft, stable = maps_of(prototype('square')), maps_of(prototype())
    ax = drawn(plot_ratio(*soft, 0))
    assert legend_of(ax)[-1] == 'unstable'
    (hatched,) = hatched_in(ax)
    assert is_cut_at_the_zone(hatched, ax)
    region = hatched.get_paths()[0]
    assert region.contains_point((0, 0.99 * np.pi / 0.010))  # near X
    assert not region.contains_point((0, 0.1 * np.pi / 0.010))  # the foundation holds long waves
    control = plot_ratio(*stable, 0)
    assert not hatched_in(control)
    assert control.get_legend() is None


def test_ratio_map():
    ax = drawn(plot_ratio(*maps_of(ideal()), 0))
    filled, lines = (artist for artist in ax.collections if isinstance(artist, QuadContourSet))
    assert filled.get_cmap().name == 'cividis'
    # from 0.5 on Gamma-M to sqrt((a - 1)/a) at K
    assert filled.levels[0] == pytest.approx(0.5, abs=1e-12)
    assert filled.levels[-1] >= np.sqrt(3 / 4) > lines.levels[-1]
    np.testing.assert_allclose(lines.levels, filled.levels[10:-10:10], rtol=1e-14)  # ten shades from line to line
    bar = ax.figure.axes[1]
    assert bar.get_ylabel() == r'$\omega_\mathrm{complete}/\omega_\mathrm{conventional}$, branch 1 of 2'
    assert texts_of(ax) == {'Γ', 'M', 'K'}
    assert is_cut_at_the_zone(filled, ax)
    assert is_cut_at_the_zone(lines, ax)
    assert set(lines.levels) <= set(bar.get_yticks())  # the numbers of the lines


def test_a_branch_without_any_ratio_is_refused():
    with pytest.raises(ValueError, match=r'at no wavevector is branch 1 of 4 stable in both models.* add a foundation'):
        plot_ratio(*maps_of(ideal(lattices.honeycomb)), 0)
    with pytest.raises(ValueError, match='branch must be 0 to 1, not 2'):
        plot_ratio(*maps_of(ideal()), 2)
