"""The scripts in README run as they stand there and find what they say."""

import re
from pathlib import Path

import numpy as np
import pytest

README = Path(__file__).parents[1] / 'README.md'

# The script states the pillars' 19.67572... N/m to six digits, at most 2.6e-6 off; a frequency goes as the root of a stiffness.
ROUNDED = 1.3e-6


def script_with(word):
    blocks = re.findall(r'```python\n(.*?)```', README.read_text(encoding='utf-8'), re.S)
    [script] = [code for code in blocks if word in code]
    return compile(script, str(README), 'exec')


@pytest.fixture(scope='module')
def session(tmp_path_factory):
    """The names that the script leaves behind, and the directory it ran in."""
    import matplotlib
    matplotlib.use('Agg')
    import matplotlib.pyplot as plt

    folder, names = tmp_path_factory.mktemp('readme'), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(script_with('plot_bands'), names)
    plt.close('all')
    return names, folder


def at_m(names, bands):
    path = names['path']
    at = abs(path.kpts - path.special_points['M']).max(axis=1).argmin()
    return names[bands].frequencies_Hz[at]


def test_the_picture_is_drawn(session):
    import matplotlib.image

    picture = matplotlib.image.imread(session[1] / 'bands.png')
    assert np.ptp(picture[..., :3]) > 0.5  # not blank


@pytest.mark.parametrize('bands', ['complete', 'numerical'])
def test_frequencies_at_m_are_the_papers(session, bands):
    expected = [58.2326897819, 149.476338113]  # arXiv:1911.10410, Supplement, recomputed in 50-digit arithmetic
    np.testing.assert_allclose(at_m(session[0], bands), expected, rtol=ROUNDED)


def test_conventional_fails_them(session):
    shear, longitudinal = at_m(session[0], 'conventional')
    assert shear / 58.2326897819 == pytest.approx(92.1059950118 / 58.2326897819, rel=ROUNDED)  # 58 % too high
    assert longitudinal > 1.03 * 149.476338113


def test_time_steps_follow_the_exact_transient(capsys):
    names = {}
    exec(script_with('propagate'), names)
    # velocity Verlet moves every frequency by (w dt)^2/24, 1e-6 at 40 Hz and 5e-6 at 100 Hz; 100 rad of phase accumulate
    assert names['off'] < 5e-4
    assert f"off by {names['off']:.1e}" in capsys.readouterr().out
    assert f'# {names["off"]:.1e}' in README.read_text(encoding='utf-8')
    assert f'{names["linear"].products} products' in README.read_text(encoding='utf-8')
