"""Folders of results: one scene each, whole or untouched, whatever strikes and whoever writes at the same time."""

import errno
import json
import os
import pathlib
import re
import sys
from datetime import UTC, datetime, timedelta
from fnmatch import fnmatch
from hashlib import sha256
from types import SimpleNamespace

import pytest
from scene_files import ready_scene

from magphonon import __version__, read_scene
from magphonon.cli.main import main
from magphonon.cli.results import results
from magphonon.files import whole_file

CHAIN = ready_scene('chain').read_text().replace('points = 200', 'points = 20')
OTHER = CHAIN.replace('mass_kg = 1.0', 'mass_kg = 2.0').replace('title = "Chain', 'title = "Heavy chain')
PATTERNS = 'bands.*', 'zone.*'
FILES = {'bands.csv': 'q,f\n', 'bands.png': 'a picture', 'zone.png': 'another'}


def scene_file(folder, text=CHAIN, name='my.toml'):
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def write(out, scene, files=FILES, command='bands', version=''):
    """What a command does: files of which each says which run it is of; returns the notes."""
    options = SimpleNamespace(output=str(out), scene=str(scene), command=command, words=[command, str(scene), '-o', str(out)],
                              results=PATTERNS)
    with results(options, read_scene(scene)) as folder:
        for name, text in files.items():
            (folder / name).write_text(text + version)
    return options.notes


def contents(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob('*') if file.is_file()}


def whole(folder):
    """Whether the provenance vouches for every file there, and for no other."""
    known = json.loads((folder / 'provenance.json').read_text())
    there = {name: sha256(content).hexdigest() for name, content in contents(folder).items() if name != 'provenance.json'}
    return (all(run['complete'] for run in known['results'].values())
            and there == {name: file['sha256'] for name, file in known['files'].items()})


# --- what it says ----------------------------------------------------------------------------------------------------

def test_results_say_where_they_came_from(tmp_path, capsys):
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    before = datetime.now(UTC) - timedelta(seconds=1)  # the date is cut off to seconds
    assert main(['bands', str(scene), '-o', str(out)]) == 0
    assert main(['dos', str(scene), '-o', str(out)]) == 0
    assert whole(out)
    known = json.loads((out / 'provenance.json').read_text())
    assert list(known['results']) == ['bands', 'dos']
    for name in ('bands', 'dos'):
        part = known['results'][name]
        assert part['command'] == f'magphonon {name} {scene} -o {out}'
        assert before <= datetime.fromisoformat(part['date']) <= datetime.now(UTC)
        assert part['versions']['magphonon'] == __version__
        assert {'python', 'ase', 'phonopy', 'numpy'} < part['versions'].keys()
    assert known['scene']['title'] == read_scene(scene).title
    assert (out / 'scene.toml').read_bytes() == scene.read_bytes()
    columns = [(out / file).read_text().split('\n')[0] for file in ('bands.csv', 'dos.csv')]
    assert columns[0] != columns[1]  # which is why one must not replace the other


def test_the_copy_of_a_scene_can_be_run_with_the_table_of_its_law(tmp_path):
    (tmp_path / 'law.csv').write_text('r_m,f_N\n' + '\n'.join(f'{r},{1e4 * r**-4}' for r in (0.5, 0.8, 1.0, 1.3, 2.0)))
    text = re.sub(r'(?s)\[law\].*?\n\n', '[law]\nkind = "table"\nfile = "law.csv"\nshells = 1\n\n', CHAIN)
    write(tmp_path / 'out', scene_file(tmp_path, text))
    assert read_scene(tmp_path / 'out' / 'scene.toml') == read_scene(tmp_path / 'my.toml')
    write(tmp_path / 'out', tmp_path / 'my.toml', {'frf.csv': ''}, 'frf')
    assert set(contents(tmp_path / 'out')) == {*FILES, 'frf.csv', 'law.csv', 'scene.toml', 'provenance.json'}


# --- what is refused -------------------------------------------------------------------------------------------------

def test_another_scene_is_refused_with_both_names_and_what_differs(tmp_path, capsys):
    out = tmp_path / 'out'
    assert main(['bands', str(scene_file(tmp_path)), '-o', str(out)]) == 0
    before, other = contents(out), scene_file(tmp_path, OTHER, 'other.toml')
    capsys.readouterr()
    for command in (['bands', str(other)], ['dos', str(other)]):
        assert main([*command, '-o', str(out)]) == 2
        shown = capsys.readouterr()
        for words in ("'Chain held", "'Heavy chain held", 'differs in title, [lattice]', 'name another directory'):
            assert words in shown.err
        assert 'pictures and data' not in shown.out
        assert contents(out) == before
    assert main(['bands', str(other), '-o', str(tmp_path / 'apart')]) == 0  # the control


def test_an_edited_scene_replaces_the_results_of_its_own_command_but_mixes_with_no_other(tmp_path):
    out, edited = tmp_path / 'out', CHAIN.replace('mass_kg = 1.0', 'mass_kg = 2.0')
    write(out, scene_file(tmp_path))
    write(out, scene_file(tmp_path, edited), {'bands.csv': 'new'})
    assert (out / 'scene.toml').read_text() == edited
    assert (out / 'bands.csv').read_text() == 'new'
    write(out, tmp_path / 'my.toml', {'frf.csv': ''}, 'frf')
    with pytest.raises(ValueError, match=r'differs in \[lattice\]'):
        write(out, scene_file(tmp_path))


def test_comments_and_new_tables_make_no_other_scene(tmp_path):
    out = tmp_path / 'out'
    write(out, scene_file(tmp_path))
    write(out, scene_file(tmp_path, '# a comment\n' + CHAIN + '\n[plan]\nforce_N = 1.0\n'), {'plan_frf.csv': ''}, 'plan')
    assert (out / 'scene.toml').read_text().startswith('# a comment')
    assert whole(out)
    with pytest.raises(ValueError, match=r'differs in \[plan\]'):  # what has results may not change any more, nor go
        write(out, scene_file(tmp_path))


def test_two_tables_lie_side_by_side_but_another_one_of_the_same_name_is_refused(tmp_path):
    scene = scene_file(tmp_path)

    def spectrum(table, content):
        table.parent.mkdir(exist_ok=True)
        table.write_text(content)
        options = SimpleNamespace(output=tmp_path / 'out', scene=scene, command='spectrum', words=[], results=())
        with results(options, read_scene(scene), table) as folder:
            (folder / f'spectrum_{table.stem}.csv').write_text(content)

    spectrum(tmp_path / 'a.csv', 'first')
    spectrum(tmp_path / 'b.csv', 'second')
    spectrum(tmp_path / 'a.csv', 'first')
    before = contents(tmp_path / 'out')
    with pytest.raises(ValueError, match=r'"magphonon spectrum a" for another table'):
        spectrum(tmp_path / 'elsewhere' / 'a.csv', 'third')
    assert contents(tmp_path / 'out') == before
    spectrum(tmp_path / 'a.csv', 'measured again')
    assert (tmp_path / 'out' / 'spectrum_a.csv').read_text() == 'measured again'
    assert {'spectrum_a.csv', 'spectrum_b.csv'} < set(before)


def test_a_scene_in_the_folder_of_its_own_results_stays(tmp_path):
    scene = scene_file(tmp_path / 'out', name='scene.toml')
    write(tmp_path / 'out', scene)
    write(tmp_path / 'out', scene, version='second')
    assert whole(tmp_path / 'out')


# --- whole or untouched ----------------------------------------------------------------------------------------------

SECOND = dict(list(FILES.items())[:2])


def test_files_that_are_not_written_again_stay_and_are_named(tmp_path):
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    write(out, scene)
    (out / '.partial-x').mkdir()
    notes = write(out, scene, SECOND, version=' second')
    assert ['zone.png' in note for note in notes] == [True, False]
    assert '.partial-x' in notes[1]
    assert (out / 'zone.png').read_text() == FILES['zone.png']
    assert whole(out)


def test_an_edited_result_is_not_replaced_and_nothing_is_computed(tmp_path):
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    write(out, scene)
    (out / 'bands.csv').write_text('mine')
    before = contents(out)
    options = SimpleNamespace(output=out, scene=scene, command='bands', words=[], results=PATTERNS)
    with pytest.raises(ValueError, match=r'bands\.csv was edited'), results(options, read_scene(scene)):
        pytest.fail('the command has begun')
    assert contents(out) == before


@pytest.mark.parametrize('key', ['law', 'lattice'])
@pytest.mark.parametrize('name', ['bands.csv', 'Bands.csv', 'provenance.json', 'scene.toml'])
def test_a_file_of_the_scene_named_like_a_result_is_refused_before_anything_is_computed(key, name, tmp_path):
    """Its copy beside the results would have taken the place of one."""
    text = CHAIN.replace(f'[{key}]', f'[{key}]\nfile = "{name}"')
    options = SimpleNamespace(output=tmp_path, scene=scene_file(tmp_path, text), command='bands', words=[], results=PATTERNS)
    with pytest.raises(ValueError, match=re.escape(f'{key}.file = "{name}"')), results(options, read_scene(ready_scene('chain'))):
        pytest.fail('the command has begun')
    assert [file.name for file in tmp_path.iterdir()] == ['my.toml']


@pytest.mark.slow
def test_each_command_says_which_names_its_results_have(tmp_path):
    """Otherwise a table of such a name would not be refused at once."""
    from magphonon.cli import bands, burst, dos, fit, frf, modes, plan, sweep, uncertainty

    forces = tmp_path / 'forces.csv'
    forces.write_text('r_mm,f_N\n' + '\n'.join(f'{r},{2e4 * r**-4}' for r in range(8, 18)) + '\n')
    runs = {bands: 'bands chain --pdf', dos: 'dos chain', modes: 'modes vacancy --animate 2', frf: 'frf oscillator',
            plan: 'plan oscillator --run', uncertainty: 'uncertainty oscillator', fit: f'fit {forces}',
            burst: 'burst square', sweep: 'sweep chain --over law.a=3,4 --ask stability.needed --executor here'}
    for command, words in runs.items():
        out = tmp_path / words.split()[0]
        assert main([*words.split(), '-o', str(out)]) == 0
        for file in set(contents(out)) - {'provenance.json', 'scene.toml'}:
            assert any(fnmatch(file, pattern) for pattern in command.RESULTS), file


@pytest.mark.parametrize('error', [OSError(5, 'Input/output error'), KeyboardInterrupt()], ids=['disk', 'interrupt'])
def test_what_fails_while_files_take_their_names_is_not_vouched_for_and_can_be_repeated(error, tmp_path, monkeypatch):
    """Test_hostile_folders kills it at every file operation."""
    for at in range(4):
        scene, out = scene_file(tmp_path / str(at)), tmp_path / str(at) / 'out'
        write(out, scene)
        moved, replace = [], os.replace

        def move(a, b, at=at, moved=moved, replace=replace):
            moved.append(a)
            if len(moved) == at + 1:
                raise error
            replace(a, b)

        with monkeypatch.context() as patch:
            patch.setattr(os, 'replace', move)
            with pytest.raises(type(error)):
                write(out, scene, version=' second')
        assert whole(out) == (at == 0)
        assert not list(out.glob('.*'))
        write(out, scene, version=' third')
        assert whole(out)
        assert (out / 'bands.csv').read_text().endswith('third')


@pytest.mark.parametrize(('where', 'words'), [('inside', 'no space left for results in '), ('nowhere', 'no space left for '),
                                              ('elsewhere', 'No space left on device')])
def test_a_full_disk_is_told_by_the_folder_that_has_no_room(where, words, tmp_path):
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    options = SimpleNamespace(output=str(out), scene=str(scene), command='bands', words=['bands'], results=PATTERNS)

    def fill():
        with results(options, read_scene(scene)) as folder:
            named = {'inside': [str(folder / 'bands.csv')], 'nowhere': [], 'elsewhere': [str(tmp_path / 'record')]}[where]
            raise OSError(errno.ENOSPC, 'No space left on device', *named)

    with pytest.raises(OSError, match=words):
        fill()


# --- single files ----------------------------------------------------------------------------------------------------

def test_unfinished_files_that_others_left_stay(tmp_path):
    names = ['.x.partial', '.x.1.partial', f'.x.{os.getpid()}.partial', '.y.99999.partial', 'x.1.partial']
    for name in names:
        (tmp_path / name).write_text('')
    with whole_file(tmp_path / 'x'):
        pass
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted([*names, 'x'])


# --- tables beside the scene, and what others do meanwhile -----------------------------------------------------------

TABLED = CHAIN.partition('[law]')[0] + '[law]\nkind = "table"\nfile = "{}"\nshells = 1\n' + CHAIN[CHAIN.index('[bands]'):]


def table_of_forces(path):
    path.parent.mkdir(exist_ok=True)
    path.write_text('r_m,f_N\n' + ''.join(f'{r},{2 * r**-4}\n' for r in (0.5, 0.8, 1.0, 1.3, 2.0, 3.0)))


@pytest.mark.parametrize(('named', 'copied'), [('law.csv', True), ('./law.csv', True), ('{here}/law.csv', False)])
def test_results_of_a_table_can_be_computed_again_from_the_scene_among_them(named, copied, tmp_path):
    table_of_forces(tmp_path / 'law.csv')
    scene, out = scene_file(tmp_path, TABLED.format(named.format(here=tmp_path))), tmp_path / 'out'
    assert main(['bands', str(scene), '-o', str(out)]) == 0
    assert (out / 'law.csv').is_file() == copied
    assert main(['bands', str(out / 'scene.toml'), '-o', str(tmp_path / 'again')]) == 0
    assert (tmp_path / 'again' / 'bands.csv').read_text() == (out / 'bands.csv').read_text()


@pytest.mark.parametrize(('named', 'words'), [
    ('./bands.csv', 'has the same name as a result'), ('sub/law.csv', 'not in the folder of the scene'),
    ('../{name}/law.csv', 'not in the folder of the scene')])
def test_a_table_that_the_copy_of_the_scene_would_not_find_is_refused(named, words, tmp_path, capsys):
    for name in ('law.csv', 'bands.csv', 'sub/law.csv'):
        table_of_forces(tmp_path / name)
    scene, out = scene_file(tmp_path, TABLED.format(named.format(name=tmp_path.name))), tmp_path / 'out'
    assert main(['bands', str(scene), '-o', str(out)]) == 2
    assert words in capsys.readouterr().err
    assert not out.exists()


def test_a_file_that_appears_meanwhile_is_not_replaced(tmp_path, monkeypatch):
    mine = tmp_path / 'out' / 'bands.csv'

    def link(file, place):
        if place == mine:
            mine.write_text('mine')
        raise FileExistsError if place == mine else OSError(errno.EPERM, 'no links here')

    monkeypatch.setattr(os, 'link', link)
    with pytest.raises(ValueError, match='was made by another program while the command ran'):
        write(tmp_path / 'out', scene_file(tmp_path))
    assert mine.read_text() == 'mine'
    mine.unlink()
    monkeypatch.setattr(os, 'link', lambda file, place: (_ for _ in ()).throw(OSError(errno.EPERM, 'no links here')))
    write(tmp_path / 'out', scene_file(tmp_path))  # a file system without links
    assert whole(tmp_path / 'out')


@pytest.mark.parametrize('which', ['folder', 'file'])
def test_links_put_into_the_place_of_results_take_nothing_of_a_user(which, tmp_path):
    mine, scene = tmp_path / 'mine', scene_file(tmp_path)
    mine.mkdir()
    (mine / 'thesis.txt').write_text('thesis')
    options = SimpleNamespace(output=str(tmp_path / 'out'), scene=str(scene), command='bands', words=['bands'], results=PATTERNS)

    def planted(stage):
        if which == 'folder':
            stage.rmdir()
            stage.symlink_to(mine)
        else:
            (stage / 'bands.csv').symlink_to(mine / 'thesis.txt')

    with pytest.raises(ValueError, match='another program replaced'), results(options, read_scene(scene)) as stage:
        planted(stage)
    assert contents(mine) == {'thesis.txt': b'thesis'}


def test_a_record_that_is_read_only_is_not_replaced(tmp_path):
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    write(out, scene)
    (out / 'provenance.json').chmod(0o444)
    before = contents(out)
    with pytest.raises(ValueError, match=r'provenance\.json is read-only'):
        write(out, scene, version='2')
    assert contents(out) == before


@pytest.mark.skipif(sys.platform != 'linux', reason='names are bytes on Linux')
def test_a_folder_whose_name_is_no_text(tmp_path):
    out = os.fsdecode(os.fsencode(tmp_path) + b'/out\xff')
    write(out, scene_file(tmp_path))
    assert whole(pathlib.Path(out))
