"""The oscillator is drawn where its magnets are, with the forces that act on it; a picture is whole on screen and on paper."""

import numpy as np
import pytest
from PIL import Image

from magphonon.plotting.axes import new_axes
from workflows.oscillator import FORCE, draw_oscillator, oscillator
from workflows.rows import DPI, save_picture


@pytest.mark.parametrize('theta0', np.random.default_rng(3).uniform(0.1, 1.4, 3))
def test_magnets_and_forces_of_the_oscillator(theta0):
    ax = new_axes()
    draw_oscillator(ax, oscillator(theta0))
    squares = next(line for line in ax.lines if line.get_marker() == 's')
    c, s = np.cos(theta0), np.sin(theta0)
    np.testing.assert_allclose(sorted(squares.get_xydata().tolist()), sorted([[0, -1], [c, -s], [-c, -s]]), atol=1e-12)
    arrows = sorted(text.xy for text in ax.texts if getattr(text, 'arrow_patch', None))
    expected = sorted((FORCE * x, FORCE * y) for x, y in ((0, 1), (-c, s), (c, s)))  # all as strong, away from the fixed ones
    np.testing.assert_allclose(arrows, expected, atol=1e-12)
    assert abs(np.subtract(arrows, -np.array(expected))).max() > 0.1  # the control: attraction


def test_a_picture_is_written_for_screen_and_paper(tmp_path):
    ax = new_axes(3.0, 2.0)
    ax.plot([0, 1], [0, 1])
    picture = save_picture(ax.figure, tmp_path / 'line.png', 'A line.')
    assert picture == (tmp_path / 'line.png', 'A line.')
    with Image.open(picture.file) as image:
        assert image.size == (3 * DPI, 2 * DPI)
        assert image.text['Description'] == 'A line.'
    paper = (tmp_path / 'line.pdf').read_bytes()
    assert paper.startswith(b'%PDF')
    assert b'/MediaBox [ 0 0 216 144 ]' in paper  # points
    assert sorted(tmp_path.iterdir()) == [tmp_path / 'line.pdf', tmp_path / 'line.png']
