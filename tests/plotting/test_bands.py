"""What the axes hold: data in SI, labels with units, legends; drawn without pyplot."""

import io
import subprocess
import sys
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.colors import to_hex
from matplotlib.contour import QuadContourSet
from matplotlib.path import Path
from matplotlib.quiver import Quiver

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices, units as u
from magphonon.bands.zone import zone_map
from magphonon.interactions.force_tables import Forces
from magphonon.plotting.axes import COLOURS
from magphonon.plotting.bands import plot_bands
from magphonon.plotting.fits import plot_fits
from magphonon.plotting.modes import plot_mode
from magphonon.plotting.response import plot_response
from magphonon.plotting.uncertainty import plot_response_ribbon
from magphonon.plotting.zone import plot_isofrequency, plot_ratio, plot_zone
from magphonon.response.frf import FrequencyResponse

STEPS = 48


def ideal(lattice=lattices.triangular, foundation=0.0):
    """Sec. IV of the paper: f = 1e4 N m^4 r^-4 on particles of 1 kg, 1 m apart."""
    cell = lattice(1 * u.m, 1 * u.kg)
    cell.calc = MagneticRepulsion(cell, InversePower(b=1e4 * u.N * u.m**4, a=4), foundation=foundation * u.N / u.m)
    return cell


def prototype(lattice=lattices.triangular):
    cell = lattice(10 * u.mm, 0.707 * u.g)
    law = InversePower(b=1.6209e-10 * u.N * u.m**4.5824, a=4.5824)
    cell.calc = MagneticRepulsion(cell, law, foundation=19.675721234 * u.N / u.m)
    return cell


def bands_of(cell, path='GMKG', npoints=300, **options):
    return analytic_bands(cell, cell.cell.bandpath(path, npoints=npoints, pbc=cell.pbc), **options)


def maps_of(cell):
    return zone_map(cell, STEPS), zone_map(cell, STEPS, model='conventional')


def drawn(ax):
    """Draw the figure, as every warning is an error, and return its axes."""
    ax.figure.savefig(io.BytesIO())
    return ax


def legend_of(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def texts_of(ax):
    return {text.get_text() for text in ax.texts}


def only(kind, ax):
    (artist,) = [artist for artist in ax.collections if isinstance(artist, kind)]
    return artist


# ---- bands ----

@pytest.fixture(scope='module')
def three_bands():
    cell = prototype()
    ax = plot_bands(bands_of(cell), label='complete')
    plot_bands(bands_of(cell, model='conventional'), ax=ax, linestyle='--', label='conventional')
    return drawn(plot_bands(bands_of(cell), ax=ax, linestyle='', marker='.', label='phonopy'))


def test_band_diagram_has_one_legend_entry_per_call(three_bands):
    assert legend_of(three_bands) == ['complete', 'conventional', 'phonopy']


def test_band_diagram_is_labelled(three_bands):
    assert three_bands.get_ylabel() == 'frequency (Hz)'
    assert [label.get_text() for label in three_bands.get_xticklabels()] == ['Γ', 'M', 'K', 'Γ']
    assert all(line.get_visible() for line in three_bands.get_xgridlines())  # the lines at special points
    assert not any(line.get_visible() for line in three_bands.get_ygridlines())


def test_band_diagram_in_Hz(three_bands):
    _, M, _, end = three_bands.get_xticks()
    lines = three_bands.lines  # two branches of each of three calls
    at_M = [np.interp(M, line.get_xdata(), line.get_ydata()) for line in lines]
    # recomputed in 50-digit arithmetic from the supplement's data, printed to 12 digits
    complete, conventional = [58.2326897819, 149.476338113], [92.1059950118, 155.050524158]
    np.testing.assert_allclose(at_M, complete + conventional + complete, rtol=1e-10)
    assert three_bands.get_xlim() == (0, end)
    bottom, top = three_bands.get_ylim()
    assert bottom == 0  # the gap below the lowest band shows
    assert conventional[1] < top < 1.2 * conventional[1]  # also of those drawn after the first


def test_band_diagram_differs_in_grey_and_in_colour(three_bands):
    looks = [(line.get_linestyle(), line.get_marker(), line.get_color()) for line in three_bands.lines]
    assert looks[::2] == looks[1::2]  # all branches of one call alike
    assert [look[:2] for look in looks[::2]] == [('-', 'None'), ('--', 'None'), ('None', '.')]
    assert [to_hex(look[2]).upper() for look in looks[::2]] == list(COLOURS[:3])


def test_markers_are_thinned_unless_told(three_bands):
    for line in three_bands.lines[4:]:
        assert len(line.get_xdata()) / line.get_markevery() == pytest.approx(40, rel=0.1)
    ax = plot_bands(bands_of(ideal()), marker='o', markevery=50, c='black')
    assert {(line.get_markevery(), line.get_color()) for line in ax.lines} == {(50, 'black')}
    assert ax.get_legend() is None


def test_a_break_in_the_path_breaks_the_lines():
    cell = ideal(lattices.square, foundation=5e4)
    ax = drawn(plot_bands(bands_of(cell, 'GX,MG', npoints=50)))
    assert [label.get_text() for label in ax.get_xticklabels()] == ['Γ', 'X,M', 'Γ']
    for line in ax.lines:
        x, f = line.get_data()
        (gap,) = np.flatnonzero(np.isnan(f))
        assert x[gap - 1] == x[gap + 1] == ax.get_xticks()[1]
        assert abs(f[gap + 1] - f[gap - 1]) > 1  # Hz: the frequencies at X and M, which no line joins
    control = plot_bands(bands_of(cell, 'GXMG', npoints=50))
    assert not any(np.isnan(line.get_ydata()).any() for line in control.lines)


def test_unstable_modes_are_shaded_and_named_once():
    cell = ideal(lattices.square)
    bands = bands_of(cell, 'GXMG')
    ax = plot_bands(bands_of(cell, 'GXMG', model='conventional'), label='conventional')
    assert not ax.patches  # control: the conventional model hides it
    assert ax.get_ylim()[0] == 0
    plot_bands(bands, ax=ax, label='complete')
    drawn(plot_bands(bands, ax=ax, marker='.', linestyle='', label='again'))
    (shaded,) = ax.patches
    lowest = -200 / (2 * np.pi)  # Hz, -sqrt(4 f/(L M)) of the shear mode at X
    assert shaded.get_y() == ax.get_ylim()[0]
    assert 1.3 * lowest < shaded.get_y() < lowest
    assert shaded.get_y() + shaded.get_height() == pytest.approx(0, abs=1e-12)
    assert [text.get_text() for text in ax.texts] == ['unstable']
    assert legend_of(ax) == ['conventional', 'complete', 'again']


def test_round_off_at_gamma_is_not_called_unstable():
    bands = bands_of(ideal())
    # roots of what squares of frequencies are off by: 1e-16 by the Bloch matrix, 1e-10 by phonopy; and modes that truly grow
    for lowest, shaded in ((-1e-8, 0), (-1e-5, 0), (-1e-4, 1), (-1e-3, 1)):
        omega = bands.omega.copy()
        omega[0, 0] = lowest * omega.max()
        ax = plot_bands(replace(bands, omega=omega))
        assert len(ax.patches) == len(ax.texts) == shaded


@pytest.mark.parametrize(('factor', 'unit', 'share'), [(1e-4, 'mHz', 1e-3), (1, 'Hz', 1), (1e3, 'kHz', 1e3), (1e6, 'MHz', 1e6)])
def test_the_axis_prints_a_unit_that_suits(factor, unit, share):
    bands = bands_of(prototype())  # up to 155 Hz
    scaled = replace(bands, omega=factor * bands.omega)
    ax = plot_bands(scaled, label='one')
    plot_bands(scaled, ax=ax, label='two')
    drawn(ax)
    assert ax.get_ylabel() == f'frequency ({unit})'
    np.testing.assert_allclose([float(text.get_text()) * share for text in ax.get_yticklabels()], ax.get_yticks(), rtol=1e-9)
    assert ax.yaxis.get_offset_text().get_text() == ''
    np.testing.assert_array_equal(ax.lines[0].get_ydata(), scaled.frequencies_Hz[:, 0])  # the data stay in Hz


@pytest.mark.parametrize('labels', [('complete', 'conventional', 'phonopy'),
                                    ('complete, $D^0+D^*$', 'conventional, $D^0$', 'phonopy, interpolated'),
                                    ('a' * 50, 'b' * 40, 'c')])
def test_the_legend_stays_inside_the_figure(labels):
    ax = None
    for label in labels:
        ax = plot_bands(bands_of(prototype()), ax=ax, label=label)
    drawn(ax)
    inside, box = ax.figure.bbox, ax.get_legend().get_window_extent()
    assert inside.x0 <= box.x0 < box.x1 <= inside.x1
    assert box.y1 <= inside.y1
    assert legend_of(ax) == list(labels)


def test_bands_on_another_path_are_refused():
    ax = plot_bands(bands_of(prototype()))
    for other in (bands_of(prototype(), 'GKMG'), bands_of(ideal())):
        with pytest.raises(ValueError, match=r'another path .* than those on the axes; compute both on the same path'):
            plot_bands(other, ax=ax)
    assert len(ax.lines) == 2


# ---- modes ----

def arrows_of(ax):
    arrows = only(Quiver, ax)
    return arrows.XY.T, np.array([arrows.U, arrows.V])


def test_shear_and_longitudinal_mode_at_M():
    cell = prototype()
    bands = bands_of(cell, vectors=True)
    ax = drawn(plot_mode(cell, bands, 'M', 0))
    assert ax.get_title() == 'M, branch 1\n58.23 Hz, transverse'
    assert (ax.get_xlabel(), ax.get_ylabel()) == ('$x$ (m)', '$y$ (m)')
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
    assert plot_mode(cell, bands, 40, 1).get_title().startswith(f'$q$ = (0, {bands.path.kpts[40, 1]:.3g}), branch 2\n')
    assert plot_mode(cell, bands, 'K', 0).get_title() == 'K, branch 1\n119.9 Hz, degenerate'


def test_light_and_heavy_particles_swing_by_their_masses():
    # At Gamma the optical mode of a honeycomb cell leaves the centre of mass at rest: u1/u2 = -m2/m1.
    cell = ideal(lattices.honeycomb)
    cell.set_masses([1 * u.kg, 4 * u.kg])
    bands = bands_of(cell, vectors=True)
    _, (ux, uy) = arrows_of(plot_mode(cell, bands, 'G', 3))
    first, second = (np.array([ux[k::2], uy[k::2]]) for k in (0, 1))
    np.testing.assert_allclose(first, -4 * second, atol=1e-9 * abs(first).max())


def test_unstable_mode_shows_its_growth_rate():
    cell = ideal(lattices.square)
    title = plot_mode(cell, bands_of(cell, 'GXMG', vectors=True), 'X', 0).get_title()
    assert title == 'X, branch 1\nunstable, grows at 200 1/s'  # sqrt(4 f/(L M))


@pytest.mark.parametrize(('q', 'mode', 'message'), [
    ('X', 0, "the path has no special point 'X'; it knows G"),
    (300, 0, 'index from 0 to 299, not 300'),
    (-1, 0, 'index from 0 to 299, not -1'),
    ('M', 2, 'mode must be 0 to 1, not 2'),
    ('M', -1, 'mode must be 0 to 1, not -1'),
])
def test_modes_that_do_not_exist_are_refused(q, mode, message):
    cell = prototype()
    with pytest.raises(ValueError, match=message):
        plot_mode(cell, bands_of(cell, vectors=True), q, mode)


def test_modes_need_vectors_and_a_path_through_the_point():
    cell = prototype()
    with pytest.raises(ValueError, match='ask for them with vectors=True'):
        plot_mode(cell, bands_of(cell), 'M', 0)
    with pytest.raises(ValueError, match='the path GM does not pass through K; choose a path that does'):
        plot_mode(cell, bands_of(cell, 'GM', vectors=True), 'K', 0)


# ---- over the zone ----

def test_zone_with_its_path():
    ax = drawn(plot_zone(bands_of(prototype()).path))
    assert (ax.get_xlabel(), ax.get_ylabel()) == ('$k_x$ (rad/m)', '$k_y$ (rad/m)')
    (zone,) = ax.patches
    M, K = 2 * np.pi / (np.sqrt(3) * 0.010), 4 * np.pi / (3 * 0.010)  # rad/m
    corners = zone.get_xy()[:-1]
    assert corners.shape == (6, 2)
    np.testing.assert_allclose(np.linalg.norm(corners, axis=1), K, rtol=1e-12)
    path = np.linalg.norm(ax.lines[0].get_xydata(), axis=1)
    np.testing.assert_allclose(path, [0, M, K, 0], rtol=1e-7, atol=1e-9)  # ASE's special points carry eight digits
    assert texts_of(ax) == {'Γ', 'M', 'K'}
    assert ax.get_aspect() == 1


def test_zone_path_with_a_break_is_drawn_in_two():
    cell = ideal(lattices.square, foundation=5e4)
    path = bands_of(cell, 'GX,MG').path
    stretches = [line for line in plot_zone(path).lines if len(line.get_xdata()) > 1]
    assert [len(line.get_xdata()) for line in stretches] == [2, 2]


def test_zone_of_a_chain_is_refused():
    cell = lattices.chain(10 * u.mm, 0.707 * u.g)
    with pytest.raises(ValueError, match='planar lattices, but the special points of the path GX span no plane'):
        plot_zone(cell.cell.bandpath('GX', npoints=10, pbc=cell.pbc))


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
    assert legend_of(ax) == ['complete', 'conventional', 'group velocity']
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
    ax = drawn(plot_isofrequency(*maps_of(prototype(lattices.honeycomb)), 0))
    assert legend_of(ax)[:2] == ['complete', 'conventional (26.55 throughout)']


def hatched_in(ax):
    return [artist for artist in ax.collections if isinstance(artist, QuadContourSet) and any(artist.hatches)]


def test_unstable_part_of_the_zone_is_hatched():
    soft, stable = maps_of(prototype(lattices.square)), maps_of(prototype())
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
    assert filled.levels[-1] >= np.sqrt(3 / 4) > filled.levels[-2]
    np.testing.assert_array_equal(lines.levels, filled.levels[1:-1])
    bar = ax.figure.axes[1]
    assert bar.get_ylabel() == r'$\omega_\mathrm{complete}/\omega_\mathrm{conventional}$, branch 1 of 2'
    assert {'Γ', 'M', 'K'} < texts_of(ax)
    assert is_cut_at_the_zone(filled, ax)
    assert is_cut_at_the_zone(lines, ax)
    inside = ax.patches[0].get_path()
    numbers = [text for text in ax.texts if text.get_text()[0] == '0']
    assert numbers
    assert all(inside.contains_point(text.get_position()) for text in numbers)


def test_a_branch_without_any_ratio_is_refused():
    with pytest.raises(ValueError, match=r'branch 1 of 4 is nowhere stable in both models: .* add a foundation'):
        plot_ratio(*maps_of(ideal(lattices.honeycomb)), 0)
    for plot in (plot_isofrequency, plot_ratio):
        with pytest.raises(ValueError, match='branch must be 0 to 1, not 2'):
            plot(*maps_of(ideal()), 2)


# ---- manners ----

def test_pyplot_and_its_settings_are_left_alone():
    import matplotlib as mpl
    import matplotlib.pyplot as plt

    before = dict(mpl.rcParams)
    cell = prototype()
    bands = bands_of(cell, vectors=True)
    for ax in (plot_bands(bands, label='complete'), plot_zone(bands.path), plot_mode(cell, bands, 'M', 0),
               plot_ratio(*maps_of(cell), 0), plot_isofrequency(*maps_of(cell), 0)):
        drawn(ax)
    assert dict(mpl.rcParams) == before
    assert plt.get_fignums() == []


def test_given_axes_are_drawn_on():
    from matplotlib.figure import Figure

    cell = prototype()
    bands = bands_of(cell, vectors=True)
    maps = maps_of(cell)
    axes = Figure().subplots(5)
    for ax, plot in zip(axes, (lambda ax: plot_bands(bands, ax=ax), lambda ax: plot_zone(bands.path, ax=ax),
                               lambda ax: plot_mode(cell, bands, 'M', 0, ax=ax), lambda ax: plot_ratio(*maps, 0, ax=ax),
                               lambda ax: plot_isofrequency(*maps, 0, ax=ax)), strict=True):
        assert plot(ax) is ax
        assert ax.has_data()


def test_matplotlib_is_imported_only_to_draw():
    code = "import sys, magphonon.plotting.bands, magphonon.plotting.zone; sys.exit('matplotlib' in sys.modules)"
    assert subprocess.run([sys.executable, '-c', code], check=False).returncode == 0


# Units of the axes: 1 rad/ms is 1000/2 pi Hz, 1 mm/N is 1e-3 m/N, 1 mm is 1e-3 m

def test_responses_are_drawn_in_metres_per_newton_over_hertz():
    omega, response = np.array([0.1, 0.2, 0.3]), np.array([1.0, 4.0j, -2.0])
    amplitude, phase = (ax.lines[0] for ax in plot_response(FrequencyResponse(omega, response)))
    np.testing.assert_allclose(amplitude.get_xdata(), omega * 1e3 / (2 * np.pi))
    np.testing.assert_allclose(amplitude.get_ydata(), [1e-3, 4e-3, 2e-3])
    np.testing.assert_allclose(phase.get_ydata(), [0, 90, 180])


def test_the_ribbon_of_a_response_has_the_units_of_its_line():
    spread = SimpleNamespace(values=np.array([6.0, 8.0, 6.0]), std=np.array([0.5, 1.0, 0.5]))  # mm, under 2 N
    ax = plot_response_ribbon(np.array([0.1, 0.2, 0.3]), spread, force=2.0)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), [3e-3, 4e-3, 3e-3])
    x, y = ax.collections[0].get_paths()[0].vertices.T
    np.testing.assert_allclose([x.min(), x.max()], np.array([0.1, 0.3]) * 1e3 / (2 * np.pi))
    np.testing.assert_allclose([y.min(), y.max()], [2.5e-3, 5e-3])  # two standard deviations to each side


def test_measured_forces_and_laws_share_the_axis_in_metres():
    law = InversePower(b=1.0, a=2.0)
    forces = Forces(np.array([8.0, 10.0, 14.0]), law.b * np.array([8.0, 10.0, 14.0]) ** -2)
    fit = SimpleNamespace(law=law, name='inverse power', offset=0.0, spacing=10.0)
    upper, lower = plot_fits(forces, [fit]).axes
    points, curve = (next(line for line in upper.lines if line.get_label() == name) for name in ('_nolegend_', fit.name))
    np.testing.assert_allclose(points.get_xdata(), [8e-3, 10e-3, 14e-3])
    np.testing.assert_allclose(curve.get_xdata()[[0, -1]], [8e-3, 14e-3])
    np.testing.assert_allclose(curve.get_ydata()[[0, -1]], forces.f[[0, -1]])
    residuals = next(line for line in lower.lines if len(line.get_xdata()) == 3)
    np.testing.assert_allclose(residuals.get_ydata(), 0, atol=1e-12)


@pytest.mark.parametrize('sigma', [None, np.array([2e-3, 1e-3, 5e-5])])
def test_residuals_of_far_points_are_seen_beside_those_of_near_ones(sigma):
    law, r = InversePower(b=1e4, a=4.0), np.array([8.0, 10.0, 30.0])
    f = law.b * r**-4
    off = 0.03 * f * np.array([1, -1, 1]) if sigma is None else 2 * sigma * np.array([1, -1, 1])
    fit = SimpleNamespace(law=law, name='inverse power', offset=0.0, spacing=10.0)
    _, lower = plot_fits(Forces(r, f + off, sigma), [fit]).axes
    drawn = next(line for line in lower.lines if len(line.get_xdata()) == 3).get_ydata()
    np.testing.assert_allclose(drawn, [3, -3, 3] if sigma is None else [2, -2, 2])
    assert lower.get_ylabel() == ('measured - fitted (%)' if sigma is None else 'measured - fitted (sigma)')
