"""Scenes by file, by name and through a pipe; where results go if no directory is named."""

import io
import sys

import pytest
from scene_files import ready_scene

from magphonon.cli.main import main
from magphonon.scenes import read_scene

CHAIN = ready_scene('chain').read_text().replace('points = 200', 'points = 20')
HEAVY = CHAIN.replace('mass_kg = 1.0', 'mass_kg = 2.0').replace('title = "Chain', 'title = "Heavy chain')


@pytest.fixture(autouse=True)
def desk(tmp_path, monkeypatch):
    """An empty present folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


def pipe(text, monkeypatch):
    content = text if isinstance(text, bytes) else text.encode()
    monkeypatch.setattr(sys, 'stdin', io.TextIOWrapper(io.BytesIO(content)))


def names(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob('*'))


def test_a_ready_scene_is_taken_by_its_name_unless_a_file_has_it(desk, capsys):
    assert main(['bands', 'oscillator']) == 2  # read, and refused for what is in it
    assert "'Oscillator of arXiv:1911.10410, Sec. III, at 30 degrees' is one particle" in capsys.readouterr().err
    assert read_scene('ideal') == read_scene(ready_scene('ideal'))
    (desk / 'ideal').mkdir()
    assert read_scene('ideal').lattice.mass_kg == 1.0  # a folder is no file
    (desk / 'prototype').write_text(HEAVY)
    assert read_scene('prototype').title.startswith('Heavy chain')


@pytest.mark.parametrize(('given', 'meant'), [
    ('protoype', "did you mean the ready scene 'prototype'?"), ('prototype.toml', "the ready scene 'prototype'?"),
    ('Mien', "did you mean 'mine.toml'?"), ('mine.tml', "did you mean 'mine.toml'?"),
    ('sub/twn.toml', "did you mean 'sub/twin.toml'"),
    ('sub/mine.toml', '"magphonon scene" lists'), ('no.toml', '"magphonon scene" lists')])
def test_a_name_that_is_no_scene_is_told_the_near_one(given, meant, desk, capsys):
    (desk / 'mine.toml').write_text(CHAIN)
    (desk / 'sub').mkdir()
    (desk / 'sub' / 'twin.toml').write_text(CHAIN)
    assert main(['check', given]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f'magphonon: {given} cannot be read (No such file or directory); ')
    assert meant in said


def test_a_scene_through_a_pipe_finds_its_files_in_the_present_folder(desk, monkeypatch, capsys):
    (desk / 'row.csv').write_text('x_m,y_m\n0,0\n')
    text = CHAIN.replace('kind = "chain"', 'kind = "file"\nfile = "row.csv"\ncell_m = [[1.0, 0.0]]')
    text = text.replace('spacing_m = 1.0', '')
    pipe(text, monkeypatch)
    assert main(['check', '-']) == 0
    assert capsys.readouterr().out.startswith('Stable in the plane')
    pipe(text, monkeypatch)
    (desk / 'row.csv').rename(desk / 'gone.csv')
    assert main(['check', '-']) == 2
    assert 'stdin: lattice.file: row.csv' in capsys.readouterr().err


@pytest.mark.parametrize(('content', 'words'), [
    ('', 'stdin is empty'), (b'\xff\xfe', 'stdin is not TOML: its byte 1 is not text in UTF-8'),
    ('x = [', 'stdin is not TOML ('),
    ('x = 1', "stdin: the scene lacks the key 'title'"), (b'#' * (10 * 2**20 + 1), 'stdin holds more than the 10 MB')],
    ids=range(5))
def test_a_pipe_without_a_scene(content, words, monkeypatch, capsys):
    pipe(content, monkeypatch)
    assert main(['check', '-']) == 2
    assert words in capsys.readouterr().err


def test_parents_of_the_results_are_made_and_go_with_them_if_they_fail(desk, capsys):
    (desk / 'mine.toml').write_text(CHAIN)
    (desk / 'a').mkdir()
    assert main(['bands', 'mine.toml', '-o', 'a/b/c/d']) == 0
    assert (desk / 'a' / 'b' / 'c' / 'd' / 'bands.csv').exists()
    before = names(desk)
    (desk / 'narrow.toml').write_text(ready_scene('bench').read_text().replace('[3, 3]', '[2, 2]'))
    assert main(['bands', 'narrow.toml', '-o', 'a/e/f/g']) == 2
    assert names(desk) == sorted([*before, 'narrow.toml'])
