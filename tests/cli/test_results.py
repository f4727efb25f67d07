"""Folders of results: files appear together, replace others only with --force, and nothing else in a folder changes."""

import errno
import os
from types import SimpleNamespace

import pytest

from magphonon.cli.main import main
from magphonon.cli.results import results

NAMES = 'bands.csv', 'bands.png', 'zone.png'


def write(out, text, force=False, error=None):
    """What a command does: it writes three files, and perhaps fails."""
    options = SimpleNamespace(output=str(out), force=force)
    with results(options, 'bands.*') as folder:
        for name in NAMES:
            (folder / name).write_text(text)
        if error is not None:
            raise error


def contents(folder):
    return {str(file.relative_to(folder)): os.readlink(file) if file.is_symlink() else file.read_text()
            for file in folder.rglob('*') if not file.is_dir() or file.is_symlink()}


def test_results_of_another_run_are_replaced_with_force_alone(tmp_path):
    write(tmp_path / 'a' / 'b', 'first')
    (tmp_path / 'a' / 'b' / 'bands.txt').write_text('mine')
    with pytest.raises(FileExistsError, match=r'bands\.csv exists; name another place with -o, or give --force to replace it'):
        write(tmp_path / 'a' / 'b', 'second')
    assert set(contents(tmp_path / 'a' / 'b').values()) == {'first', 'mine'}
    write(tmp_path / 'a' / 'b', 'second', force=True)
    assert contents(tmp_path / 'a' / 'b') == dict.fromkeys(NAMES, 'second') | {'bands.txt': 'mine'}


def test_a_command_refuses_before_it_computes(tmp_path, monkeypatch, capsys):
    (tmp_path / 'out').mkdir()
    (tmp_path / 'out' / 'bands.csv').write_text('mine')
    monkeypatch.setattr('magphonon.cli.bands._bands', lambda *given: pytest.fail('the command has begun'))
    assert main(['bands', 'ideal', '-o', str(tmp_path / 'out')]) == 2
    assert 'out/bands.csv exists; name another place with -o, or give --force' in capsys.readouterr().err
    assert contents(tmp_path) == {'out/bands.csv': 'mine'}


def test_a_file_made_meanwhile_is_not_replaced(tmp_path):
    def run():
        with results(SimpleNamespace(output=str(tmp_path), force=False), 'bands.*') as folder:
            (folder / 'zone.png').write_text('new')
            (tmp_path / 'zone.png').write_text('of another program')

    with pytest.raises(FileExistsError, match=r'zone\.png exists'):
        run()
    assert contents(tmp_path) == {'zone.png': 'of another program'}


@pytest.mark.parametrize('error', [ValueError('no'), KeyboardInterrupt()])
@pytest.mark.parametrize('before', [True, False])
def test_a_command_that_fails_changes_nothing(error, before, tmp_path):
    if before:
        write(tmp_path / 'out', 'first')
        (tmp_path / 'out' / '.magphonon-old').mkdir()  # of a command that was killed
        (tmp_path / 'out' / '.magphonon-old' / 'bands.csv').write_text('half')
    there = contents(tmp_path)
    with pytest.raises(type(error)):
        write(tmp_path / 'out', 'second', force=True, error=error)
    assert contents(tmp_path) == there
    assert (tmp_path / 'out').exists() == before


def test_what_cannot_take_its_name_leaves_each_file_whole(tmp_path, monkeypatch):
    """A disk that fails after the first file: no file is half, none is lost, and the command can be repeated."""
    write(tmp_path, 'first')
    moved, replace = [], os.replace

    def move(a, b):
        moved.append(b)
        if len(moved) == 2:
            raise OSError(errno.EIO, 'Input/output error')
        replace(a, b)

    with monkeypatch.context() as patch:
        patch.setattr(os, 'replace', move)
        with pytest.raises(OSError, match='Input/output error'):
            write(tmp_path, 'second', force=True)
    assert list(contents(tmp_path).values()).count('second') == 1
    assert set(contents(tmp_path)) == set(NAMES)
    write(tmp_path, 'third', force=True)
    assert contents(tmp_path) == dict.fromkeys(NAMES, 'third')


def test_links_are_replaced_and_not_followed(tmp_path):
    (tmp_path / 'thesis.txt').write_text('thesis')
    (tmp_path / 'out').mkdir()
    for name in NAMES[:2]:
        (tmp_path / 'out' / name).symlink_to(tmp_path / 'thesis.txt')
    (tmp_path / 'out' / NAMES[2]).symlink_to(tmp_path / 'nowhere')
    with pytest.raises(FileExistsError, match=r'bands\.csv exists'):
        write(tmp_path / 'out', 'new')
    write(tmp_path / 'out', 'new', force=True)
    assert contents(tmp_path) == {'thesis.txt': 'thesis'} | {f'out/{name}': 'new' for name in NAMES}


@pytest.mark.parametrize(('name', 'words'), [('file', 'is a file; name a directory'), ('file/x', 'choose another place')])
def test_a_folder_that_cannot_be_is_refused_in_words(name, words, tmp_path):
    (tmp_path / 'file').write_text('mine')
    with pytest.raises(OSError, match=words):
        write(tmp_path / name, 'new')
    assert contents(tmp_path) == {'file': 'mine'}


def test_a_full_disk_is_told_by_the_folder(tmp_path):
    with pytest.raises(OSError, match='out cannot be written: no space left; make room'):
        write(tmp_path / 'out', 'new', error=OSError(errno.ENOSPC, 'No space left on device'))
    assert not (tmp_path / 'out').exists()
    with pytest.raises(OSError, match='No space left on device'):  # of another file
        write(tmp_path / 'out', 'new', error=OSError(errno.ENOSPC, 'No space left on device', '/elsewhere'))
