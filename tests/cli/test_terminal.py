"""Text on a terminal of its own, and the same text in a pipe."""

import os
import pty
import re
import struct
import subprocess
import sys
from concurrent.futures import ThreadPoolExecutor
from fcntl import ioctl
from termios import TIOCSWINSZ

import pytest

from magphonon.cli.main import main
from magphonon.cli.terminal import coloured, wrapped
from magphonon.scenes import ready_scene

ESCAPE = re.compile(r'\x1b\[[\d;]*m')


def read_all(master):
    """What arrives at the other end of a terminal until it is closed."""
    said = b''
    while True:
        try:
            piece = os.read(master, 4096)
        except OSError:  # closed
            piece = b''
        if not piece:
            os.close(master)
            return said.decode().replace('\r\n', '\n')
        said += piece


def on_a_terminal(columns, *arguments):
    """What a process of its own shows on a terminal of this width, and its exit status."""
    master, slave = pty.openpty()
    ioctl(slave, TIOCSWINSZ, struct.pack('HHHH', 50, columns, 0, 0))
    plain = {name: value for name, value in os.environ.items() if name not in ('COLUMNS', 'LINES')}
    with subprocess.Popen([sys.executable, '-m', 'magphonon', *arguments], stdin=slave, stdout=slave, stderr=slave,
                          env=plain) as process:
        os.close(slave)
        return read_all(master), process.wait(600)


def shown_by(arguments, monkeypatch):
    """What the command shows if the standard output of this process is a terminal, and its exit status."""
    master, slave = pty.openpty()
    with ThreadPoolExecutor() as pool, monkeypatch.context() as patch:
        said = pool.submit(read_all, master)
        with open(slave, 'w') as terminal:
            patch.setattr(sys, 'stdout', terminal)
            status = main(arguments)
        return said.result(), status


def words(text):
    return ESCAPE.sub('', text).split()


def test_a_verdict_is_wrapped_and_coloured_on_a_terminal_and_plain_in_a_pipe(tmp_path, capsys, monkeypatch):
    """A chain on fewer springs than it needs has a bad word; the words are the same everywhere."""
    text = ready_scene('chain').read_text().partition('[frf]')[0]
    (tmp_path / 'weak.toml').write_text(text.replace('5e4', '3e4'))
    arguments = ['check', str(tmp_path / 'weak.toml')]
    assert main(arguments) == 1
    piped = capsys.readouterr().out
    assert '\x1b' not in piped
    assert max(map(len, piped.splitlines())) > 100  # the control: something is there to be wrapped
    for name, value in {'COLUMNS': '72', 'TERM': 'xterm', 'NO_COLOR': ''}.items():
        monkeypatch.setenv(name, value)
    shown, status = shown_by(arguments, monkeypatch)
    assert status == 1
    assert words(shown) == words(piped)
    assert max(map(len, ESCAPE.sub('', shown).splitlines())) <= 72
    assert '\x1b[1;31mUNSTABLE\x1b[0m' in shown
    monkeypatch.setenv('NO_COLOR', '1')
    assert shown_by(arguments, monkeypatch)[0] == ESCAPE.sub('', shown)


def test_a_refusal_is_wrapped_and_a_scene_is_not():
    said, status = on_a_terminal(40, 'check', 'nowhere/near/a/scene.toml')
    assert status == 2
    assert max(map(len, said.splitlines())) <= 40
    assert '"magphonon scene" lists' in ' '.join(said.split())
    said, status = on_a_terminal(40, 'scene', 'chain')
    assert status == 0
    assert max(map(len, said.splitlines())) > 40


def test_the_list_of_keys_fits_the_terminal(monkeypatch, capsys):
    monkeypatch.setenv('COLUMNS', '60')
    assert main(['scene', '--keys', 'foundation']) == 0
    piped = capsys.readouterr().out
    shown, _ = shown_by(['scene', '--keys', 'foundation'], monkeypatch)
    assert max(map(len, shown.splitlines())) <= 60 < max(map(len, piped.splitlines()))
    assert shown.split() == piped.split()


@pytest.mark.parametrize('line', [
    '  branch 1           1.41       2.40    and so on, far beyond the width of the terminal',
    'short', '', '# a comment of a scene file that is longer than that', 'forces_N = [1.0627436361480025, 0.8128145856709039]',
    'a/very/long/path/that/cannot/be/broken/without/becoming/useless/to/its/reader'])
def test_rows_of_tables_and_scenes_and_long_words_stay_whole(line, monkeypatch):
    monkeypatch.setenv('COLUMNS', '40')
    assert wrapped(line) == line


def test_points_of_a_list_are_indented(monkeypatch):
    monkeypatch.setenv('COLUMNS', '30')
    assert wrapped('  - The static forces balance on every particle.') == (
        '  - The static forces balance\n    on every particle.')


def test_only_whole_words_have_colours(monkeypatch):
    monkeypatch.delenv('NO_COLOR', raising=False)
    monkeypatch.setenv('TERM', 'xterm')
    assert coloured('Lattice: OK') == 'Lattice: \x1b[1;32mOK\x1b[0m'
    assert coloured('Lattice: NOT OK (1)') == 'Lattice: \x1b[1;31mNOT OK\x1b[0m (1)'
    assert coloured('OKAY, TOKYO') == 'OKAY, TOKYO'
    monkeypatch.setenv('TERM', 'dumb')
    assert coloured('Lattice: OK') == 'Lattice: OK'
