"""Maps over the Brillouin zone: contours, group velocities, ratios."""

import numpy as np
import pytest
from cells import prototype
from figures import arrows_of, bands_of, drawn, ideal, legend_of, maps_of, texts_of
from matplotlib.colors import to_hex
from matplotlib.contour import QuadContourSet
from matplotlib.path import Path

from magphonon import lattices, units as u
from magphonon.bands import band_path
from magphonon.plotting.axes import COLOURS
from magphonon.plotting.zone import plot_isofrequency, plot_ratio, plot_zone


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


def crossings_on_gamma_M(contours, level):
    """k_y in rad/m where a contour crosses the positive k_y axis."""
    path = contours.get_paths()[list(contours.levels).index(level)]
    points = np.concatenate(path.to_polygons(closed_only=False))
    near = points[(abs(points[:, 0]) < 0.03) & (points[:, 1] > 0)]
    return near[:, 1]


def test_isofrequency_contours_lie_where_the_closed_form_has_them():
    complete, conventional = maps_of(ideal())
    ax = drawn(plot_isofrequency(complete, conventional, 0))
    assert legend_of(ax) == ['complete', 'conventional', 'group velocity, complete']
    assert ax.get_legend().get_title().get_text() == 'frequency (Hz), branch 1 of 2'
    assert {'Γ', 'M', 'K'} < texts_of(ax)
    assert all(is_cut_at_the_zone(artist, ax) for artist in ax.collections if isinstance(artist, QuadContourSet))
    solid, dashed = (artist for artist in ax.collections if isinstance(artist, QuadContourSet))
    assert [look.linestyles for look in (solid, dashed)] == ['solid', 'dashed']
    assert [to_hex(look.colors).upper() for look in (solid, dashed)] == list(COLOURS[:2])
    # omega_T = sqrt(2 (a - 3) f/(L M)) sin(xi/2), conventional sqrt(2 a f/(L M)) sin(xi/2), xi = sqrt(3)/2 k_y L
    k, k_conventional = (4 / np.sqrt(3) * np.arcsin(2 * np.pi * 20 / np.sqrt(squared)) for squared in (2e4, 8e4))
    # linear interpolation on a mesh of 0.15 rad/m
    assert abs(crossings_on_gamma_M(solid, 20) - k).min() < 5e-3
    assert abs(crossings_on_gamma_M(dashed, 20) - k_conventional).min() < 5e-3
    assert abs(crossings_on_gamma_M(dashed, 20) - k).min() > 0.3  # control


def test_arrows_point_along_the_group_velocity():
    complete, conventional = maps_of(ideal())
    (kx, ky), (vx, vy) = arrows_of(plot_isofrequency(complete, conventional, 0))
    np.testing.assert_allclose(np.hypot(vx, vy), 1, rtol=1e-12)
    on_axis = (abs(kx) < 1e-9) & (ky > 0) & (ky < 3.6)  # from Gamma to short of M the closed form rises
    assert on_axis.sum() >= 2
    np.testing.assert_allclose(vy[on_axis], 1, rtol=1e-9)
    assert Path([(-2.2, -3.7), (2.2, -3.7), (4.2, 0), (2.2, 3.7), (-2.2, 3.7), (-4.2, 0)]).contains_points(np.c_[kx, ky]).all()
    assert not (np.hypot(kx, ky) < 1e-9).any()  # none at Gamma, where it vanishes


def test_a_flat_branch_has_no_contour_but_its_frequency_in_the_legend():
    # Honeycomb of nearest neighbours: the lowest conventional branch is the foundation alone, 26.55 Hz.
    ax = drawn(plot_isofrequency(*maps_of(prototype('honeycomb')), 0))
    assert legend_of(ax)[:2] == ['complete', 'conventional (26.55 throughout)']


def hatched_in(ax):
    return [artist for artist in ax.collections if isinstance(artist, QuadContourSet) and any(artist.hatches)]


def test_unstable_part_of_the_zone_is_hatched():
    soft, stable = maps_of(prototype('square')), maps_of(prototype())
    for plot in (plot_isofrequency, plot_ratio):
        ax = drawn(plot(*soft, 0))
        assert legend_of(ax)[-1] == 'unstable'
        (hatched,) = hatched_in(ax)
        assert is_cut_at_the_zone(hatched, ax)
        region = hatched.get_paths()[0]
        assert region.contains_point((0, 0.99 * np.pi / 0.010))  # near X
        assert not region.contains_point((0, 0.1 * np.pi / 0.010))  # the foundation holds long waves
        control = plot(*stable, 0)
        assert not hatched_in(control)
        assert control.get_legend() is None or 'unstable' not in legend_of(control)


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


@pytest.mark.parametrize('branch', [0, 1])
def test_labels_of_contours_are_apart_inside_the_zone_and_on_their_contour(branch):
    ax = drawn(plot_isofrequency(*maps_of(ideal()), branch))
    numbers = [text for text in ax.texts if text.get_text().isdigit()]
    places = np.array([text.get_position() for text in numbers])
    assert len(places) > 4
    assert ax.patches[0].get_path().contains_points(places).all()
    apart = np.linalg.norm(places[:, None] - places, axis=2) + np.ptp(ax.get_xlim()) * np.eye(len(places))
    assert apart.min() > 0.07 * np.ptp(ax.get_xlim())
    contours = [artist for artist in ax.collections if isinstance(artist, QuadContourSet) and len(artist.levels) > 1]
    for text in numbers:
        paths = [path for artist in contours for level, path in zip(artist.levels, artist.get_paths(), strict=True)
                 if level == float(text.get_text()) and to_hex(artist.get_edgecolor()[0]) == to_hex(text.get_color())]
        assert min(np.linalg.norm(path.vertices - text.get_position(), axis=1).min() for path in paths) < 1e-9


def test_a_branch_without_any_ratio_is_refused():
    with pytest.raises(ValueError, match=r'branch 1 of 4 is nowhere stable in both models: .* add a foundation'):
        plot_ratio(*maps_of(ideal(lattices.honeycomb)), 0)
    for plot in (plot_isofrequency, plot_ratio):
        with pytest.raises(ValueError, match='branch must be 0 to 1, not 2'):
            plot(*maps_of(ideal()), 2)
