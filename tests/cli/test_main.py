"""The command `magphonon`: what it shows and writes, and how it fails."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from scene_files import ready_scene
from structures import few_first

import magphonon
from magphonon.cli.main import main, parser_of
from magphonon.scenes.scene import read_scene, ready_scenes


def command(*arguments, **options):
    """The command in a process of its own, as a shell would start it."""
    return subprocess.run([sys.executable, '-m', 'magphonon', *map(str, arguments)], capture_output=True, text=True,
                          timeout=600, **options)


# --- what it does ----------------------------------------------------------------------------------------------------

def test_scenes_are_listed_and_printed(capsys, tmp_path):
    assert main(['scene']) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(ready_scenes())
    for name, file in ready_scenes().items():
        assert main(['scene', name]) == 0
        (tmp_path / 'copy.toml').write_text(capsys.readouterr().out)
        copy, scene = read_scene(tmp_path / 'copy.toml'), read_scene(file)
        beside = name in ('demultiplexer', 'prism')  # a table stands beside the ready scene
        assert copy == scene or (beside and copy.atoms() == scene.atoms())


NOT_FOR = {  # commands that cannot show what is in a ready scene, and why
    'demultiplexer': {'bands': 'is a finite structure', 'burst': 'is a finite structure'},
    'gyro': {'explore': 'lattice.gyration_rad_per_s'},
    'layer': {'explore': 'foundation.out_of_plane'},
    'oscillator': dict.fromkeys(['bands', 'burst', 'explore', 'modes'], 'is one particle'),
    'prism': dict.fromkeys(['bands', 'burst', 'explore'], 'finite structure')}


@pytest.mark.slow
@pytest.mark.parametrize('name', ready_scenes())
@pytest.mark.parametrize('what', ['bands', 'burst', 'check', 'explore', 'frf', 'modes'])
def test_each_command_takes_each_ready_scene_or_says_why_not(name, what, tmp_path, monkeypatch, capsys):
    """Warnings are errors here."""
    monkeypatch.chdir(tmp_path)
    status, why = main([what, name]), NOT_FOR.get(name, {}).get(what)
    if why is None and what in ('burst', 'frf') and getattr(read_scene(name), what) is None:
        why = f'has no table [{what}]; add one, as in'
    said = capsys.readouterr()
    assert status == (2 if why else 0)
    assert (why or '') in said.err
    assert bool(said.out) != bool(said.err)
    assert bool([*tmp_path.iterdir()]) == (not why and what != 'check')


# --- how it fails ----------------------------------------------------------------------------------------------------

MISTAKES = {
    'bad value': (['bands', '{d}/bad.toml', '-o', '{d}/out'], 'lattice.spacing_m', 'must be a positive number, not -0.01'),
    'narrow supercell': (['bands', '{d}/narrow.toml', '-o', '{d}/out'], '2 x 2 x 1', 'give it 3 x 3 x 1 cells'),
    'output in a file': (['bands', '{d}/good.toml', '-o', '{d}/law.csv/x'], 'law.csv/x', 'choose another place'),
    'output not writable': (['bands', '{d}/good.toml', '-o', '/proc/x'], '/proc', 'choose another place'),
    'no command': ([], 'COMMAND', 'required'),
    'unknown option': (['bands', '{d}/good.toml', '-o', '{d}/out', '--fast'], '--fast', 'usage: magphonon'),
}


if not os.path.exists('/proc'):
    del MISTAKES['output not writable']


@pytest.fixture
def desk(tmp_path):
    """A directory with good and bad scenes."""
    good = ready_scene('bench').read_text()
    (tmp_path / 'good.toml').write_text(good)
    (tmp_path / 'bad.toml').write_text(good.replace('spacing_m = 0.01', 'spacing_m = -0.01'))
    (tmp_path / 'narrow.toml').write_text(good.replace('[3, 3]', '[2, 2]'))
    (tmp_path / 'law.csv').write_text('r_m,f_N\n0.01,0.2\n')
    return tmp_path


def status_of(arguments):
    try:
        return main(arguments)
    except SystemExit as exit:  # argparse's way out
        return exit.code


@pytest.mark.parametrize(('arguments', 'value', 'mend'), MISTAKES.values(), ids=MISTAKES)
def test_mistake_ends_in_words_and_writes_nothing(arguments, value, mend, desk, capsys):
    before = {file: file.read_bytes() for file in desk.iterdir()}
    assert status_of([argument.format(d=desk) for argument in arguments]) == 2
    shown = capsys.readouterr()
    assert value in shown.err
    assert mend in shown.err
    assert shown.out == ''
    assert {file: file.read_bytes() for file in desk.iterdir()} == before


@pytest.mark.slow
@pytest.mark.parametrize('name', ['bad value', 'output in a file'])
def test_no_traceback_in_a_shell(name, desk):
    done = command(*(argument.format(d=desk) for argument in MISTAKES[name][0]))
    assert done.returncode == 2
    assert 'Traceback' not in done.stderr
    assert MISTAKES[name][1] in done.stderr
    assert done.stdout == ''


@pytest.mark.parametrize(('accident', 'status', 'words', 'existing'), [
    (KeyboardInterrupt(), 130, 'interrupted', False),
    (OSError(28, 'No space left on device'), 2, 'no space left; make room', True)])
def test_accident_leaves_nothing(accident, status, words, existing, desk, capsys, monkeypatch):
    """The bands are computed and saved, but not all is drawn, when it happens."""
    def strike(*_):
        raise accident

    monkeypatch.setattr('magphonon.cli.bands._draw', strike)
    out = desk / 'out'
    if existing:
        out.mkdir()
    assert main(['bands', '--verbose', str(desk / 'good.toml'), '-o', str(out)]) == status
    assert words in capsys.readouterr().err
    left = {'good.toml', 'bad.toml', 'narrow.toml', 'law.csv'} | ({'out'} if existing else set())
    assert {file.name for file in desk.rglob('*')} == left


@pytest.mark.slow
def test_reader_that_has_seen_enough_is_no_error():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, 'w') as pipe:
        done = subprocess.run([sys.executable, '-m', 'magphonon', 'scene', 'prototype'], stdout=pipe, stderr=subprocess.PIPE,
                              text=True, timeout=600)
    assert (done.returncode, done.stderr) == (0, '')


# --- what an import costs --------------------------------------------------------------------------------------------

@pytest.mark.parametrize(('statement', 'absent'), few_first([
    ('import magphonon', ['numpy', 'scipy', 'ase', 'phonopy', 'matplotlib', 'pydantic', 'numba']),
    ('from magphonon import MagneticRepulsion, InversePower, lattices, stiffness, units',
     ['phonopy', 'matplotlib', 'pydantic', 'numba', 'ase.md']),
    ('from magphonon import analytic_bands, finite_displacements, plot_bands', ['phonopy', 'matplotlib', 'pydantic', 'ase.md']),
    ('from magphonon import cli', ['numpy', 'ase', 'phonopy', 'matplotlib', 'pydantic']),
], 1))
def test_import_is_light(statement, absent):
    done = subprocess.run([sys.executable, '-c', f'{statement}\nimport sys\nprint(*sys.modules)'], capture_output=True, text=True,
                          check=True, timeout=600)
    assert 'magphonon' in done.stdout.split()
    assert not set(absent) & set(done.stdout.split())


def test_a_report_goes_into_a_folder_of_its_own(tmp_path, capsys):
    (tmp_path / 'summary.json').write_text('mine')
    assert main(['reproduce', 'chain', '-o', str(tmp_path)]) == 2
    assert 'summary.json exists; name another place with -o, or give --force' in capsys.readouterr().err
    assert [file.read_text() for file in tmp_path.iterdir()] == ['mine']


def test_messages_name_only_options_that_exist():
    """In all texts of the package, but for those of phonopy and of the queue of a cluster."""
    (commands,) = (action for action in parser_of()._actions if action.choices)
    known = {'--version', '--no-sym-fc', '--nosym', '--nonac', '--band', '--tolerance', '--ntasks', '--job-name', '--time'}
    known |= {flag for command in commands.choices.values() for action in command._actions for flag in action.option_strings}
    texts = [(file.name, node.value) for file in Path(magphonon.__file__).parent.rglob('*.py')
             for node in ast.walk(ast.parse(file.read_text())) if isinstance(node, ast.Constant) and isinstance(node.value, str)]
    named = {(file, flag) for file, text in texts for flag in re.findall(r'(?<![\w-])--[a-z][a-z-]+', text)}
    assert len(named) > 40
    assert [one for one in sorted(named) if one[1] not in known] == []
