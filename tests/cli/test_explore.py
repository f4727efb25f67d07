"""`magphonon explore`: a page is written whole or not at all, other files stay, and unsuitable scenes are refused in words."""

import json

import numpy as np
import pytest
from scene_files import ready_scene
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, critical_foundation, lattices
from magphonon.bands import band_path
from magphonon.cli.explore import border
from magphonon.cli.main import main
from magphonon.interactions import Yukawa
from magphonon.plotting import explorer


@pytest.fixture
def few_values(monkeypatch):
    """Sliders of a tenth of their values: each costs the foundation that it needs."""
    monkeypatch.setattr(explorer, 'VALUES', 10)


def test_a_page_is_written_and_replaced(few_values, tmp_path, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(['explore', 'vacancy', '-o', 'new/page.html']) == 0
    told, perfect = capsys.readouterr().out.splitlines()
    assert told == 'new/page.html is written; open it in a browser'
    assert perfect == 'This lattice is perfect: [defects] belong to a patch.'
    first = (tmp_path / 'new/page.html').read_text(encoding='utf-8')
    assert '<h1>Honeycomb of light and heavy magnets, one of them missing</h1>' in first
    assert 'This lattice is perfect: [defects] belong to a patch.' in first
    assert 'vacancies_m' in first  # the scene itself
    assert main(['explore', 'rings', '-o', 'new/page.html', '--force']) == 0
    assert '<h1>N42 rings on pillars' in (tmp_path / 'new/page.html').read_text(encoding='utf-8')
    assert main(['explore', str(ready_scene('steel'))]) == 0
    assert sorted(file.name for file in tmp_path.iterdir()) == ['new', 'steel-explore.html']


@pytest.mark.parametrize(('scene', 'words'), [
    ('oscillator', 'one particle and has no bands'), ('fcc', 'is a lattice in space'), ('layer', '[foundation.out_of_plane]')])
def test_scenes_that_it_does_not_know_are_refused(scene, words, tmp_path, capsys):
    assert main(['explore', str(ready_scene(scene)), '-o', str(tmp_path / 'page.html')]) == 2
    assert words in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_motion_out_of_the_plane_is_refused(scene_file, tmp_path, capsys):
    file = scene_file({'shells = "all" ': 'shells = 2 ', 'stiffness_N_per_m = 0 ': 'stiffness_N_per_m = 1e-9 '}, name='layer')
    assert main(['explore', str(file), '-o', str(tmp_path / 'page.html')]) == 2
    assert '[foundation.out_of_plane]: the explorer shows motion in the plane' in capsys.readouterr().err


@pytest.mark.parametrize(('cell', 'words'), [('', '"magphonon modes" shows its modes'),
                                             ('cell_m = [[0.03, 0.0]]\n', 'the explorer needs a lattice given by its name')])
def test_a_structure_from_a_file_is_refused(cell, words, tmp_path, capsys):
    (tmp_path / 'particles.csv').write_text('x_m,y_m,held\n0,0,0\n0.01,0,1\n0.02,0,0\n')
    (tmp_path / 'my.toml').write_text('title = "mine"\n[lattice]\nkind = "file"\nfile = "particles.csv"\nmass_kg = 1e-3\n'
                                      f'{cell}[law]\nkind = "inverse_power"\nb_N_m_a = 1e-8\na = 4.0\nshells = 1\n')
    assert main(['explore', str(tmp_path / 'my.toml'), '-o', str(tmp_path / 'page.html')]) == 2
    assert words in capsys.readouterr().err


@pytest.mark.parametrize(('by', 'words'), [('anchors', ''), ('rest', 'give positions = "anchors"')])
def test_a_structure_that_is_pushed_has_a_page(by, words, scene_file, tmp_path, capsys):
    table = ready_scene('demultiplexer').with_name('demultiplexer.csv').as_posix()
    file = scene_file({'"demultiplexer.csv"': f'"{table}"', '"anchors"': f'"{by}"'}, name='demultiplexer')
    assert main(['explore', str(file), '-o', str(tmp_path / 'page.html')]) == 2 * bool(words)
    assert words in capsys.readouterr().err
    if not words:
        page = (tmp_path / 'page.html').read_text(encoding='utf-8')
        structure = json.loads(page.split('id="data">')[1].split('</script>')[0])['structure']
        assert structure['drive']['carrier_Hz'] == 70
        assert len(structure['x']) == 127


LATTICES = ('chain', 'square', 'triangular', 'honeycomb', 'kagome')


def made(kind, spacing, law, foundation=0.0):
    cell = getattr(lattices, kind)(spacing, 1.3)
    cell.calc = MagneticRepulsion(cell, law, shells=2, foundation=foundation)
    return cell


@pytest.mark.parametrize('kind', few_first(LATTICES, 1))
def test_the_border_over_spacings_is_what_the_lattice_of_this_spacing_needs(kind, few_values):
    rng = np.random.default_rng(LATTICES.index(kind))
    spacing = rng.uniform(0.5, 20)
    law = Yukawa(rng.uniform(1, 9), rng.uniform(0.5, 2) / spacing)
    cell = made(kind, spacing, law, foundation=rng.uniform(0, 1))
    at, needed = border(explorer.Explorer(cell, band_path(cell, None, 5)))
    anew = [critical_foundation(made(kind, scale * spacing, law))[0] for scale in at[::5]]
    # two meshes find the same minimum, each to about 1e-12 of the stiffest bond
    np.testing.assert_allclose(needed[::5], anew, rtol=1e-9, atol=1e-9 * law.d2phi(at[0] * spacing))


@pytest.mark.parametrize('kind', few_first(LATTICES, 1))
def test_the_border_over_exponents_is_what_a_law_with_the_same_force_needs(kind, few_values):
    rng = np.random.default_rng(10 + LATTICES.index(kind))
    spacing, force = rng.uniform(0.5, 20), rng.uniform(0.1, 5)
    cell = made(kind, spacing, InversePower(force * spacing**3.0, 3.0))
    at, needed = border(explorer.Explorer(cell, band_path(cell, None, 5)))
    anew = [critical_foundation(made(kind, spacing, InversePower(force * spacing**a, a)))[0] for a in at[::5]]
    np.testing.assert_allclose(needed[::5], anew, rtol=1e-9, atol=1e-9 * 9 * force / spacing)


def test_the_border_of_a_triangular_lattice_ends_at_the_exponent_three(few_values):
    cell = lattices.triangular(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.58))
    at, needed = border(explorer.Explorer(cell, band_path(cell, None, 5)))
    assert at[needed == 0].min() == pytest.approx(3.0, abs=2e-9)  # the interval of the search
    np.testing.assert_allclose(needed, np.maximum(0, 2 * (3 - at)), rtol=1e-9, atol=1e-8)  # 2 (3 - a) f/L at M
