"""Scenes written from Python: whatever write_scene accepts, read_scene reads back equal."""

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings, strategies as some

from magphonon import InversePower, MagneticRepulsion, lattices, read_scene
from magphonon.scenes import write_scene

TITLES = ['plain', 'two\nlines', 'a\ttab', 'a magnet 🧲', '\U0001d6fc and β', 'x' * 200, 'x' * 201, '"quoted" \\ and \'so\'',
          '$a_1$', '$a_',
          '$\\frac{1$ and $',
          ' ', '\u2028', '\u0085', '\x7f', '\ufeff', 'é' * 200, '#comment', "'''", '"""', '[table]', 'a\rb', '\ud800']
NAMES = ['mine', 'mine@1', '@', 'mine@2:', '🧲', 'a b', 'a"b', "a'b", 'a\\b', 'a\tb', 'a\nb',
         'x' * 190, 'x' * 201, 'mine.toml', 'a#b', 'ü',
         'a%b', '-', '.hidden', 'a.traj', 'a.csv', '*', '\x7f', '~']


@pytest.fixture
def cell():
    cell = lattices.triangular(10.0, 0.7)
    cell.calc = MagneticRepulsion(cell, InversePower(1e4, 4.6), foundation=0.02)
    return cell


def accepted(cell, folder, name, title):
    """Whether write_scene takes them; then read_scene gives the same scene and atoms, and otherwise there is no file."""
    file = folder / f'{name}.toml'
    try:
        write_scene(cell, file, title)
    except (ValueError, OSError):
        assert list(folder.iterdir()) == []
        return False
    scene = read_scene(file)
    assert scene.title == (title or '1 particles from Python')
    np.testing.assert_array_equal(scene.atoms().positions, cell.positions)
    assert scene.atoms().calc.todict().keys() == cell.calc.todict().keys()
    assert scene.lattice.file == f'{name}.traj'
    return True


def test_titles_and_names(cell, tmp_path):
    for kind, words in (('title', TITLES), ('name', NAMES)):
        taken = 0
        for k, word in enumerate(words):
            folder = tmp_path / f'{kind}{k}'
            folder.mkdir()
            taken += accepted(cell, folder, *(('mine', word) if kind == 'title' else (word, 'plain')))
        assert taken >= 12


@pytest.mark.slow
@settings(max_examples=12, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(title=some.text(max_size=30))
def test_drawn_titles(cell, tmp_path_factory, title):
    accepted(cell, tmp_path_factory.mktemp('drawn'), 'mine', title)


def test_what_no_scene_can_hold_is_refused_in_its_own_words(cell, tmp_path):
    for atoms, title, words in ((cell, 7, 'title must be text'), (cell, 'a\x1bb', r"title must be one line .*'a\\x1bb'$"),
                                ('Nd', 'text', 'a scene is made of atoms with')):
        with pytest.raises(ValueError, match=words) as refused:
            write_scene(atoms, tmp_path / 'mine.toml', title)
        assert type(refused.value) is ValueError


def test_a_trajectory_of_the_user_is_not_replaced(cell, tmp_path):
    (tmp_path / 'run.traj').write_bytes(b'my run')
    with pytest.raises(ValueError, match='is not the file of particles'):
        write_scene(cell, tmp_path / 'run.toml')
    (tmp_path / 'run.toml').write_text('title = "a scene of its own"')
    with pytest.raises(ValueError, match='is not the file of particles'):
        write_scene(cell, tmp_path / 'run.toml')
    assert (tmp_path / 'run.traj').read_bytes() == b'my run'
    write_scene(cell, tmp_path / 'mine.toml')
    write_scene(cell, tmp_path / 'mine.toml', 'again')
    assert read_scene(tmp_path / 'mine.toml').title == 'again'
