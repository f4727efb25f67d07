"""Completion as bash does it, with the script that the command prints."""

import shlex
import shutil
import subprocess
import sys

import pytest

from magphonon.cli.main import COMMANDS, main
from magphonon.scenes import ready_scenes

pytest.importorskip('shtab')
BASH = shutil.which('bash')
pytestmark = pytest.mark.skipif(BASH is None, reason='a system without bash')


@pytest.fixture
def script(tmp_path, capsys):
    """The script, in a folder with a scene, a table and a folder."""
    assert main(['completion', 'bash']) == 0
    (tmp_path / 'script.sh').write_text(capsys.readouterr().out)
    (tmp_path / 'mine.toml').touch()
    (tmp_path / 'scan.csv').touch()
    (tmp_path / 'minutes').mkdir()
    return tmp_path / 'script.sh'


CASES = {
    'ban': {'bands'}, '': set(COMMANDS), 'bands pro': {'prototype'}, 'bands mi': {'mine.toml', 'minutes'},
    'scene proto': {'prototype'}, 'scene mi': set(), 'spectrum sc': {'scan.csv', 'script.sh'}, 'spectrum scan.csv rin': {'rings'},
    'bands chain -o m': {'minutes'}, 'bands chain --out': {'--output'}, 'burst --engine l': {'lammps'},
    'explore chain -o mi': {'mine.toml', 'minutes'}, 'fit ridges.csv --bands rin': {'rings'},
    'scene ': set(ready_scenes()), 'completion z': {'zsh'}}


def test_bash_completes_commands_scenes_files_and_options(script):
    program = ['complete() { :; }; compopt() { :; }', f'source {script}']
    for line in CASES:
        words = f'magphonon {line}'.split(' ')
        program += [f'COMP_WORDS=({shlex.join(words)}); COMP_CWORD={len(words) - 1}; _shtab_magphonon; echo "${{COMPREPLY[@]}}"']
    done = subprocess.run([BASH, '--norc', '-c', '\n'.join(program)], cwd=script.parent, capture_output=True, text=True)
    assert done.stderr == ''
    assert {line: set(said.split()) for line, said in zip(CASES, done.stdout.splitlines(), strict=True)} == CASES


def test_without_shtab_the_command_says_how_to_install_it(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, 'shtab', None)
    assert main(['completion', 'bash']) == 2
    assert "pip install 'magphonon[completion]'" in capsys.readouterr().err
