"""Band diagrams: data in SI, labels with units, legends; drawn without pyplot."""

from dataclasses import replace

import numpy as np
import pytest
from cells import prototype
from figures import bands_of, drawn, ideal, legend_of

from magphonon import lattices
from magphonon.bands.bands import Bands
from magphonon.design.uncertainty import Spread
from magphonon.plotting.bands import plot_bands
from magphonon.plotting.response import plot_band_ribbons


@pytest.fixture(scope='module')
def three_bands():
    cell = prototype()
    ax = plot_bands(bands_of(cell), label='complete')
    plot_bands(bands_of(cell, model='conventional'), ax=ax, linestyle='--', label='conventional')
    return drawn(plot_bands(bands_of(cell), ax=ax, linestyle='', marker='.', label='phonopy'))


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


def test_a_ribbon_shares_the_entry_of_its_curve_in_the_legend():
    bands = bands_of(prototype(), npoints=30)
    spread = Spread(('mass',), np.array([[4e-4]]), bands.omega, bands.omega[None] / 2)
    ax = None
    for model in ('complete', 'conventional'):
        ax = plot_band_ribbons(Bands(bands.path, bands.omega), spread, ax=ax, label=model)
    drawn(ax)
    assert legend_of(ax) == [rf'{model}, $\pm2\sigma$' for model in ('complete', 'conventional')]
