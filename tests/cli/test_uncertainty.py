"""`magphonon uncertainty`: what it shows and writes, and how it fails."""

import csv

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene

from magphonon.cli.main import main
from magphonon.design.uncertainty import Spread, response_spread
from magphonon.response.frf import receptance
from magphonon.scenes.scene import read_scene
from magphonon.scenes.tolerances import varied

BANDS = {'band_uncertainty.png', 'contributions.png', 'band_uncertainty.csv', 'band_uncertainty.npz'}
FRF = {'frf_uncertainty.png', 'frf_uncertainty.csv', 'frf_uncertainty.npz'}


def scene_file(folder, text):
    file = folder / 'my.toml'
    file.write_text(text)
    return str(file)


def table(file):
    with open(file, newline='') as lines:
        header, *rows = csv.reader(lines)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


@pytest.mark.slow
def test_bands_of_a_lattice_with_tolerances(tmp_path, capsys):
    """Without foundation, 1 % of spacing is (a + 1)/2 = 2.5 % of every frequency, and 1 % of the mass 0.5 %: 2.55 % together."""
    text = ready_scene('ideal').read_text().partition('[patch]')[0]
    text += '\n[bands]\npath = "GMKG"\npoints = 30\nsupercell = [3, 3]\n[uncertainty]\nspacing_m = 0.01\nmass_percent = 1.0\n'
    assert main(['uncertainty', '--verbose', scene_file(tmp_path, text), '-o', str(tmp_path / 'out')]) == 0
    assert {file.name for file in (tmp_path / 'out').iterdir()} == BANDS
    columns = table(tmp_path / 'out' / 'band_uncertainty.csv')
    moving = columns['frequency_1_Hz'] > 1e-3
    assert moving.sum() == 28  # all but Gamma at both ends
    for mode in (1, 2):
        f, std = (columns[f'{name}_{mode}_Hz'][moving] for name in ('frequency', 'std'))
        assert_allclose(std / f, np.hypot(0.025, 0.005), rtol=1e-9)
    shown = capsys.readouterr().out
    # omega_M = 141.42 rad/s of the paper is 22.5079 Hz
    assert ['M,', 'branch', '1', '22.5079', '0.574', '0.56', '0.11'] in [line.split() for line in shown.splitlines()]
    assert 'Monte Carlo check (1000 samples): standard deviations agree within' in shown
    assert 'too wide' not in shown
    assert 'G, branch' not in shown  # sound has no frequency there
    assert Spread.load(tmp_path / 'out' / 'band_uncertainty.npz').names == ('spacing', 'mass')


@pytest.mark.slow
def test_tolerances_too_wide_for_a_ribbon_are_called_so(tmp_path, capsys):
    """A chain on springs of 42 kN/m, which needs 40: 3 % of spacing buckles a part of them."""
    text = ready_scene('chain').read_text().replace('5e4', '4.2e4') + '\n[uncertainty]\nspacing_percent = 3.0\n'
    assert main(['uncertainty', '--verbose', scene_file(tmp_path, text), '-o', str(tmp_path / 'out')]) == 0
    shown = capsys.readouterr().out
    assert 'too wide for a propagation to first order' in shown
    # k < 4 f/L0 ~ L0^-5: L0 below 0.9903, a third of a normal distribution of 3 %
    share = float(shown.partition('UNSTABLE: ')[2].split()[0])
    assert share == pytest.approx(37, abs=5)  # 1000 samples: 1.5


def test_response_of_the_oscillator(tmp_path, capsys):
    out = tmp_path / 'out'
    assert main(['uncertainty', '--verbose', str(ready_scene('oscillator')), '-o', str(out)]) == 0
    assert {file.name for file in out.iterdir()} == FRF
    columns = table(out / 'frf_uncertainty.csv')
    # far above resonance u = F/(m w^2): 0.1 % of the mass, and a little of the spring
    assert 0.001 < columns['std_m_per_N'][-1] / columns['amplitude_m_per_N'][-1] < 0.005
    assert 'response: the standard deviation of the amplitude has a median of' in capsys.readouterr().out


def test_a_mass_by_itself_is_that_of_all_where_one_is_free(tmp_path, capsys):
    """Of the oscillator, whose other magnets are held; a table with nothing else besides is enough."""
    text = ready_scene('oscillator').read_text().partition('[uncertainty]')[0].replace('points = 961', 'points = 61')
    columns = []
    for k, key in enumerate(('mass_percent', 'each_mass_percent')):
        out = tmp_path / str(k)
        scene = tmp_path / f'{k}.toml'
        scene.write_text(f'{text}[uncertainty]\n{key} = 0.5\n')
        assert main(['uncertainty', '--verbose', str(scene), '-o', str(out)]) == 0
        columns.append(table(out / 'frf_uncertainty.csv'))
    np.testing.assert_allclose(columns[1]['std_m_per_N'], columns[0]['std_m_per_N'], rtol=1e-9)
    assert columns[0]['std_m_per_N'].max() > 0


def test_bands_do_not_scatter_with_each_magnet(tmp_path, capsys):
    text = ready_scene('ideal').read_text().partition('[uncertainty]')[0]
    assert main(['uncertainty', '--verbose', scene_file(tmp_path, text + '[uncertainty]\neach_strength_percent = 1.0\n'),
                 '-o', str(tmp_path / 'out')]) == 0
    assert 'broadens the bands of an infinite lattice but does not shift them' in capsys.readouterr().out


@pytest.mark.parametrize(('to', 'warns'), [('40.0', True), ('33.0', False)])
def test_a_ribbon_too_narrow_on_top_of_the_peak_is_called_so(to, warns, tmp_path, capsys):
    """1 % of k = 45 kN/m and 0.1 % of m w^2 move k - m w^2 = 0 by z = 452/(m w gamma) = 0.178 widths of the peak at 33.76 Hz."""
    text = ready_scene('oscillator').read_text().replace('to_Hz = 64.0', f'to_Hz = {to}').replace('points = 961', 'points = 401')
    assert main(['uncertainty', '--verbose', scene_file(tmp_path, text), '-o', str(tmp_path / 'out')]) == 0
    shown = capsys.readouterr().out
    assert ('the ribbon is too narrow' in shown) == warns  # 0.76 Hz below the peak, 0.4 of its width, the slope is all
    if warns:
        second = shown.partition('standard deviation is up to ')[2].splitlines()[0].replace(',', ' ').split()
        # u ~ 1 - z^2/2: std z^2/sqrt(2), mean z^2/2; two digits are printed, and the points lie 0.06 Hz apart
        assert float(second[0]) == pytest.approx(2.2, abs=0.15)
        assert float(second[3]) == pytest.approx(33.76, abs=0.15)
        assert float(second[-3]) == pytest.approx(1.6, abs=0.15)


@pytest.mark.slow
def test_in_a_patch_only_peaks_are_called_too_narrow(tmp_path, capsys):
    """37 free magnets, 100 drawn at random: on the peak that is told the mean is lower; in the dip where the second order is
    largest it is higher, though the second order of one resonance would have it lower by a third.
    """
    text = ready_scene('bench').read_text().partition('[patch]')[0].partition('[bands]')[0]
    text += """[patch]\nkind = "hexagon"\nside_m = 0.04\n[frf]\nfrom_Hz = 20.0\nto_Hz = 180.0\npoints = 97\ndamping_per_s = 40.0
force = {at_m = [0.0, 0.0], direction_deg = 90.0}\nresponse = {at_m = [0.0, 0.02], direction_deg = 90.0}
[uncertainty]\nmass_percent = 1.0\nyoungs_modulus_percent = 3.0\nb_percent = 2.9\n"""
    file = scene_file(tmp_path, text)
    assert main(['uncertainty', '--verbose', file, '-o', str(tmp_path / 'out')]) == 0
    words = capsys.readouterr().out.partition(' peaks the ribbon is too narrow')[2].splitlines()[0].replace(',', ' ').split()
    told, at = float(words[words.index('%') - 1]) / 100, float(words[words.index('Hz') - 1])
    scene = read_scene(file)
    tolerances, omega = scene.uncertainty.tolerances(scene), scene.frf.omega
    atoms, source, answer = scene.shaken()
    spread = response_spread(atoms, source.force(len(atoms)), answer, omega, scene.frf.damping, tolerances)
    peak, dip = abs(omega / (2 * np.pi) * 1e3 - at).argmin(), (spread.second_order / spread.values).argmax()
    assert spread.values[peak] > max(spread.values[peak - 1], spread.values[peak + 1])
    drawn = []
    for factors in tolerances.samples(100, 1):
        changed = varied(scene, dict(zip(tolerances.changes, factors, strict=True)))
        atoms, source, answer = changed.shaken('complete')
        found = receptance(atoms, source, answer, np.sort(omega[[peak, dip]]), changed.frf.damping).response
        drawn.append(abs(found)[np.argsort(np.argsort([peak, dip]))] / spread.values[[peak, dip]])
    drawn = np.array(drawn)
    assert 0.4 * told < drawn[:, 0].std() < 1.2 * told  # the sampling error is 7 %; the next order lowers it
    assert -0.8 * told < drawn[:, 0].mean() - 1 < -0.2 * told
    assert drawn[:, 1].mean() > 1.1


@pytest.mark.parametrize(('old', 'new', 'words'), [
    ('spacing_percent = 0.2', '', ('no table [uncertainty]',)),
    ('spacing_percent = 0.2', 'each_mass_percent = 60.0', ('uncertainty.each_mass_percent = 60.0 is more than the 50',)),
    ('spacing_percent = 0.2', 'each_stiffness_percent = 1.0', ('belongs to a foundation, but the scene has none',)),
    ('spacing_percent = 0.2', 'height_percent = 0.2', ('height is no parameter of this scene', 'spacing, mass, b, a')),
])
def test_mistake_ends_in_words_and_writes_nothing(old, new, words, tmp_path, capsys):
    text = ready_scene('oscillator').read_text()
    assert old in text
    text = text.replace(old, new) if new else text.partition('[uncertainty]')[0]
    assert main(['uncertainty', '--verbose', scene_file(tmp_path, text), '-o', str(tmp_path / 'out')]) == 2
    shown = capsys.readouterr()
    assert all(word in shown.err for word in words), shown.err
    assert shown.out == ''
    assert {file.name for file in tmp_path.iterdir()} == {'my.toml'}


def test_scene_without_anything_to_propagate_to_is_refused(tmp_path, capsys):
    text = ready_scene('oscillator').read_text()
    text = text.partition('[frf]')[0] + text[text.index('[uncertainty]'):]
    assert main(['uncertainty', '--verbose', scene_file(tmp_path, text), '-o', str(tmp_path / 'out')]) == 2
    assert 'has no [frf], so there is no response' in capsys.readouterr().err


KEPT = {'spacing': 0.004, 'mass': 0.01, 'stiffness': 0.02, 'b': 0.03, 'force': 0.03, 'youngs_modulus': 0.02, 'radius': 0.01}


@pytest.mark.slow
@pytest.mark.parametrize(('law', 'foundation', 'names', 'unused'), [
    ('b_N_m_a = 2.5e-9\na = 4.0', 'stiffness_N_per_m = 30.0', ('spacing', 'mass', 'stiffness', 'b'), ['a']),
    ('force_N = 0.25\na = 4.0', 'stiffness_N_per_m = 30.0', ('mass', 'force'), []),
    ('b_N_m_a = 2.5e-9\na = 4.0', '[foundation.pillar]\nyoungs_modulus_Pa = 3e9\nradius_m = 7.9e-4\nheight_m = 0.02',
     ('youngs_modulus', 'radius'), []),
    ('b_N_m_a = 2.5e-9\na = 4.0', 'stiffness_N_per_m = 30.0\nstiffness_y_N_per_m = 36.0', ('mass',), ['stiffness'])])
def test_tolerances_act_on_the_modes_of_a_patch_or_are_named(law, foundation, names, unused, tmp_path, capsys):
    """Against differences of scenes with each parameter a thousandth off; without a tolerance its share is missing."""
    from magphonon import modes
    from magphonon.design import mode_scatter

    told = ''.join(f'{name}_percent = {100 * KEPT.get(name, 0.01)}\n' for name in (*names, *unused))
    file = scene_file(tmp_path, 'title = "Patch"\n[lattice]\nkind = "triangular"\nspacing_m = 0.01\nmass_kg = 8e-4\n[law]\n'
                      f'kind = "inverse_power"\n{law}\nshells = 2\n[foundation]\n{foundation}\n[patch]\nkind = "hexagon"\n'
                      f'side_m = 0.0305\n[uncertainty]\n{told}')
    scene = read_scene(file)
    scatter, left = scene.known_of_structure
    assert left == unused
    omega, std = mode_scatter(scene.patch_atoms(), scatter)
    own = {name: (modes(varied(scene, {name: 1.001}).patch_atoms()).omega - omega) / 1e-3 * KEPT[name] for name in names}
    assert_allclose(std, np.sqrt(sum(one**2 for one in own.values())), rtol=0.02)
    assert (abs(own[names[0]]) > 0.05 * std).all()  # the control: each counts
    assert main(['modes', file, '-o', str(tmp_path / 'out')]) == 0
    assert (f'Not used here: the tolerances of {", ".join(unused)};' in capsys.readouterr().out) == bool(unused)
