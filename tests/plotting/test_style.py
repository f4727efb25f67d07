"""The style for print: its colours can be told apart without colour, and it is in force only where it was asked for."""

from itertools import combinations

import matplotlib as mpl
import numpy as np
import pytest
from figures import drawn
from matplotlib.figure import Figure

from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices
from magphonon.plotting import plot_bands
from magphonon.plotting.axes import COLOURS, print_style

TO_XYZ = np.array([[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.0721750], [0.0193339, 0.1191920, 0.9503041]])
"""Of linear sRGB, IEC 61966-2-1."""
SEEN = {'all': np.eye(3),
        'protanopes': np.array([[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216],
                                [-0.003882, -0.048116, 1.051998]]),
        'deuteranopes': np.array([[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413],
                                  [-0.011820, 0.042940, 0.968881]])}
"""What is seen of linear sRGB: Machado, Oliveira and Fernandes, IEEE Trans. Vis. Comput. Graph. 15, 1291 (2009), severity 1."""
PLAINLY_LIGHTER, PLAINLY_OTHER = 8, 20
"""Differences of CIE lightness and of CIELAB colour; a practised eye just sees a difference of 1 side by side."""


def lab(colours, seen='all'):
    """CIELAB of colours such as '#00428F', shape (colours, 3)."""
    share = np.array([[int(colour[k:k + 2], 16) / 255 for k in (1, 3, 5)] for colour in colours])
    light = np.where(share <= 0.04045, share / 12.92, ((share + 0.055) / 1.055) ** 2.4)
    t = np.clip(light @ SEEN[seen].T, 0, 1) @ TO_XYZ.T / TO_XYZ.sum(axis=1)
    x, y, z = np.where(t > (6 / 29) ** 3, np.cbrt(t), t / (3 * (6 / 29) ** 2) + 4 / 29).T
    return np.stack([116 * y - 16, 500 * (x - y), 200 * (y - z)], axis=1)


def least(values):
    return min(np.linalg.norm(a - b) for a, b in combinations(values, 2))


def test_colours_differ_in_grey_and_for_colour_blind_readers():
    assert least(lab(COLOURS)[:, :1]) > PLAINLY_LIGHTER
    assert all(least(lab(COLOURS, seen)) > PLAINLY_OTHER for seen in SEEN)


def test_colours_that_look_alike_in_grey_are_noticed():
    okabe_ito = '#0072B2', '#D55E00', '#000000', '#009E73', '#CC79A7', '#E69F00', '#56B4E9'
    assert least(lab(okabe_ito)[:, :1]) < 1  # its orange and its sky blue


def test_the_style_sheet_has_the_colours_of_the_pictures():
    with print_style():
        assert mpl.rcParams['axes.prop_cycle'].by_key()['color'] == list(COLOURS)


@pytest.mark.parametrize('text', ['colour: red\n', 'lines.linewidth: thick\n', 'no colon\n', '\xff\n'])
def test_a_file_that_is_no_style_sheet_is_refused_and_changes_nothing(tmp_path, text):
    own, before = tmp_path / 'own.mplstyle', dict(mpl.rcParams)
    own.write_bytes(text.encode('latin1'))
    with pytest.raises(ValueError, match='is not a style sheet of matplotlib'), print_style(own):
        pass
    assert dict(mpl.rcParams) == before


def test_a_style_sheet_that_is_not_there_is_told_by_its_name():
    with pytest.raises(FileNotFoundError), print_style('nowhere.mplstyle'):
        pass


def test_pictures_of_the_package_have_its_style_without_asking_and_axes_of_the_caller_keep_theirs():
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0))
    bands = analytic_bands(cell, cell.cell.bandpath('GMKG', npoints=20, pbc=cell.pbc))
    before, own = dict(mpl.rcParams), Figure().add_subplot()
    house = plot_bands(bands, label='first')
    plot_bands(bands, ax=house, label='second')  # drawn later, by another call
    plot_bands(bands, ax=own, label='own')
    drawn(house.figure)
    drawn(own.figure)
    assert dict(mpl.rcParams) == before

    def looks(ax):
        texts = [ax.yaxis.label, *ax.get_yticklabels(), *ax.get_legend().get_texts()]
        return {text.get_fontfamily()[0] for text in texts}, {line.get_linewidth() for line in ax.lines}

    assert looks(house) == ({'STIXGeneral'}, {1.2})
    assert looks(own) == ({before['font.family'][0]}, {before['lines.linewidth']})
    assert house.figure.get_figwidth() == 3.4
    with print_style():
        again = plot_bands(bands, label='asked')
    assert looks(again)[1] == {1.2}
