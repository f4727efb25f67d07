"""Folders of results: one scene each, whole or untouched, whatever strikes and whoever writes at the same time."""

import json
import os
import re
import signal
import subprocess
import sys
import time
from contextlib import suppress
from datetime import UTC, datetime, timedelta
from hashlib import sha256
from types import SimpleNamespace

import pytest

from magphonon import __version__, read_scene, ready_scene
from magphonon.cli.main import main
from magphonon.cli.results import results
from magphonon.files import whole_file

CHAIN = ready_scene('chain').read_text().replace('points = 200', 'points = 20')
OTHER = CHAIN.replace('mass_kg = 1.0', 'mass_kg = 2.0').replace('title = "Chain', 'title = "Heavy chain')
FILES = {'bands.csv': 'q,f\n', 'bands.png': 'a picture', 'zone.png': 'another'}


def scene_file(folder, text=CHAIN, name='my.toml'):
    folder.mkdir(exist_ok=True)
    (folder / name).write_text(text)
    return folder / name


def write(out, scene, files=FILES, command='bands', version='', pause=0.0):
    """What a command does: files of which each says which run it is of."""
    options = SimpleNamespace(output=str(out), scene=str(scene), command=command, words=[command, str(scene), '-o', str(out)])
    with results(options, read_scene(scene)) as folder:
        for name, text in files.items():
            (folder / name).write_text(text + version)
            time.sleep(pause)


def contents(folder):
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.rglob('*') if file.is_file()}


def whole(folder):
    """Whether the provenance vouches for every file there, and for no other."""
    known = json.loads((folder / 'provenance.json').read_text())
    sums = {name: part for run in known['results'].values() for name, part in run['files'].items()}
    there = {name: sha256(content).hexdigest() for name, content in contents(folder).items()}
    return known['complete'] and {name: there[name] for name in there if name not in ('provenance.json', 'scene.toml')} == sums


# --- what it says ----------------------------------------------------------------------------------------------------

def test_results_say_where_they_came_from(tmp_path, capsys):
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    before = datetime.now(UTC) - timedelta(seconds=1)  # the date is cut off to seconds
    assert main(['bands', str(scene), '-o', str(out)]) == 0
    assert main(['plan', str(scene), '--run', '-o', str(out)]) == 0
    assert whole(out)
    known = json.loads((out / 'provenance.json').read_text())
    assert list(known['results']) == ['bands', 'plan']
    for name, extra in (('bands', ''), ('plan', ' --run')):
        part = known['results'][name]
        assert part['command'] == f'magphonon {name} {scene}{extra} -o {out}'
        assert before <= datetime.fromisoformat(part['date']) <= datetime.now(UTC)
        assert part['versions']['magphonon'] == __version__
        assert {'python', 'ase', 'phonopy', 'numpy'} < part['versions'].keys()
    assert known['scene']['title'] == read_scene(scene).title
    assert (out / known['scene']['file']).read_bytes() == scene.read_bytes()
    columns = [(out / file).read_text().split('\n')[0] for file in ('bands.csv', 'plan_bands.csv')]
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
    for command in (['bands', str(other)], ['plan', str(other), '--run']):
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
    assert set(contents(out)) == {'bands.csv', 'scene.toml', 'provenance.json'}  # nothing of the scene before the edit is left
    assert (out / 'scene.toml').read_text() == edited
    write(out, tmp_path / 'my.toml', {'frf.csv': ''}, 'frf')
    with pytest.raises(ValueError, match=r'differs in \[lattice\]'):
        write(out, scene_file(tmp_path))


def test_comments_and_new_tables_make_no_other_scene(tmp_path):
    out = tmp_path / 'out'
    write(out, scene_file(tmp_path))
    write(out, scene_file(tmp_path, '# a comment\n' + CHAIN + '\n[plan]\nedge = "X"\n'), {'plan_bands.csv': ''}, 'plan')
    assert (out / 'scene.toml').read_text().startswith('# a comment')
    assert whole(out)
    with pytest.raises(ValueError, match=r'differs in \[plan\]'):  # what has results may not change any more, nor go
        write(out, scene_file(tmp_path))


@pytest.mark.parametrize('text', [
    '{"scene": 1, "results": {}}', '{"scene": {"title": "x"}, "results": {}}', '[]', 'null', '[' * 100_000,
    '{"results": {"bands": []}}', '{"results": {"bands": {"files": 1, "inputs": 1}}}'])
def test_a_provenance_of_another_form_is_refused(text, tmp_path, capsys):
    (tmp_path / 'chain.toml').write_text(ready_scene('chain').read_text())
    out = tmp_path / 'out'
    out.mkdir()
    (out / 'provenance.json').write_text(text)
    assert main(['bands', str(tmp_path / 'chain.toml'), '-o', str(out)]) == 2
    assert 'provenance.json does not say where the results beside it come from; name another' in capsys.readouterr().err
    assert [file.name for file in out.iterdir()] == ['provenance.json']


def test_two_tables_lie_side_by_side_but_another_one_of_the_same_name_is_refused(tmp_path):
    scene = scene_file(tmp_path)

    def spectrum(table, content):
        table.parent.mkdir(exist_ok=True)
        table.write_text(content)
        options = SimpleNamespace(output=tmp_path / 'out', scene=scene, command='spectrum', words=[])
        with results(options, read_scene(scene), table) as folder:
            (folder / f'spectrum_{table.stem}.csv').write_text(content)

    spectrum(tmp_path / 'a.csv', 'first')
    spectrum(tmp_path / 'b.csv', 'second')
    spectrum(tmp_path / 'a.csv', 'first')
    before = contents(tmp_path / 'out')
    with pytest.raises(ValueError, match=r'"magphonon spectrum a" for another table a.csv; name another directory'):
        spectrum(tmp_path / 'elsewhere' / 'a.csv', 'third')
    assert contents(tmp_path / 'out') == before
    assert {'spectrum_a.csv', 'spectrum_b.csv'} < set(before)


@pytest.mark.parametrize('name', ['bands.csv', 'bands.png', 'zone.png', 'provenance.json', 'scene.toml'])
@pytest.mark.parametrize('what', ['a directory', 'a file'])
def test_what_is_no_result_is_never_replaced(name, what, tmp_path):
    """Nor is anything else of the folder: not even the files whose places are free."""
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    if what == 'a directory':
        write(out, scene)
        (out / name).unlink()
        (out / name).mkdir()
    else:
        out.mkdir()
        (out / name).write_text('mine')
    before = contents(out)
    with pytest.raises((ValueError, OSError), match=re.escape(name)):
        write(out, scene, version='second')
    assert contents(out) == before
    assert not list(out.glob('.*'))


def test_a_scene_in_the_folder_of_its_own_results_stays(tmp_path):
    scene = scene_file(tmp_path / 'out', name='scene.toml')
    write(tmp_path / 'out', scene)
    write(tmp_path / 'out', scene, version='second')
    assert whole(tmp_path / 'out')


# --- whole or untouched ----------------------------------------------------------------------------------------------

MOVES = 9  # three files, the scene and the provenance, each set aside and moved in; the last file is gone the second time


def struck(monkeypatch, at, strike):
    """Make the move number `at` of a commit fail; returns the list of moves."""
    moves, replace = [], os.replace

    def move(a, b):
        if not str(a).endswith('.partial'):  # not whole_file's
            moves.append((a, b))
            if len(moves) == at + 1:
                strike()
        replace(a, b)

    monkeypatch.setattr(os, 'replace', move)
    return moves


SECOND = dict(list(FILES.items())[:2])


def second_run(tmp_path):
    """A folder with results, and the run that will replace them with fewer files."""
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    write(out, scene)
    return out, lambda: write(out, scene, SECOND, version=' second')


def raises(error):
    def strike():
        raise error
    return strike


@pytest.mark.parametrize('error', [OSError(5, 'Input/output error'), KeyboardInterrupt()], ids=['disk', 'interrupt'])
def test_a_commit_that_fails_leaves_the_old_folder_as_it_was(error, tmp_path, monkeypatch):
    out, again = second_run(tmp_path)
    before = contents(out)
    for at in range(MOVES):
        with monkeypatch.context() as patch:
            struck(patch, at, raises(error))
            with pytest.raises(type(error)):
                again()
        assert contents(out) == before
        assert not list(out.glob('.*'))
    again()
    assert set(contents(out)) == {*SECOND, 'scene.toml', 'provenance.json'}  # the control
    assert whole(out)


@pytest.mark.filterwarnings('ignore:.*fork:DeprecationWarning')
def test_a_commit_that_is_killed_is_finished_by_the_next_command(tmp_path, monkeypatch):
    steps = set()
    for at in range(MOVES + 1):
        out, again = second_run(tmp_path / str(at)) if (tmp_path / str(at)).mkdir() is None else None
        pid = os.fork()
        if not pid:
            try:
                struck(monkeypatch, at, lambda: os.kill(os.getpid(), signal.SIGKILL))
                again()
            finally:
                os._exit(0)
        killed = os.WIFSIGNALED(os.waitpid(pid, 0)[1])
        assert killed == (at < MOVES)
        if killed:
            assert not (out / 'provenance.json').exists() or whole_but_hidden(out)  # nothing vouches for a mixture
            steps.add((out / 'provenance.json').exists())
        write(out, tmp_path / str(at) / 'my.toml', {'frf.csv': ''}, 'frf')
        assert whole(out)
        assert set(contents(out)) == {*SECOND, 'frf.csv', 'scene.toml', 'provenance.json'}
        assert (out / 'bands.csv').read_text().endswith('second')
    assert steps == {False, True}


def whole_but_hidden(out):
    known = json.loads((out / 'provenance.json').read_text())['results']['bands']['files']
    return all(sha256((out / name).read_bytes()).hexdigest() == value for name, value in known.items())


@pytest.mark.slow
def test_leftovers_of_killed_commands_are_collected_and_those_of_living_ones_are_not(tmp_path):
    scene, out = scene_file(tmp_path), tmp_path / 'out'
    program = ('import os, signal, sys; sys.path.insert(0, sys.argv[3]); from test_results import *\n'
               'options = SimpleNamespace(output=sys.argv[2], scene=sys.argv[1], command="bands", words=[])\n'
               'with results(options, read_scene(sys.argv[1])) as folder, whole_file(folder / "bands.csv") as file, '
               'whole_file(sys.argv[2] + "/state.npz"):\n'
               '    print("in", flush=True); sys.stdin.readline()\n')
    start = [sys.executable, '-c', program, str(scene), str(out), os.path.dirname(__file__)]
    with subprocess.Popen(start, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as living:
        assert living.stdout.readline() == 'in\n'
        dead = subprocess.Popen(start, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        assert dead.stdout.readline() == 'in\n'
        assert len(list(out.glob('.partial-*'))) == len(list(out.glob('.state.npz.*.partial'))) == 2
        dead.kill()
        dead.communicate()
        write(out, scene)
        with whole_file(out / 'state.npz') as file:
            file.write('state')
        assert len(list(out.glob('.partial-*'))) == len(list(out.glob('.state.npz.*.partial'))) == 1
        living.communicate('go on\n')
        assert living.returncode == 0
    assert not list(out.glob('.*'))


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, 'SIGHUP'), reason='needs a terminal that can be closed')
def test_a_closed_terminal_leaves_nothing(tmp_path):
    text = ready_scene('ideal').read_text()
    out = tmp_path / 'out'
    out.mkdir()
    slow = ('import signal, sys, time; signal.signal(signal.SIGHUP, signal.SIG_DFL); '  # ignored where the tests run under nohup
            'from matplotlib.figure import Figure; save = Figure.savefig; '
            'Figure.savefig = lambda *args, **options: (time.sleep(30), save(*args, **options)); '  # waits to be closed
            'from magphonon.cli.main import main; sys.exit(main(sys.argv[1:]))')
    process = subprocess.Popen([sys.executable, '-c', slow, 'burst', str(scene_file(tmp_path, text)), '-o', str(out)],
                               stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while process.poll() is None and not list(out.glob('.partial-*/*')):
        time.sleep(0.02)
    process.send_signal(signal.SIGHUP)
    process.communicate()
    assert process.returncode == 129
    assert not list(out.iterdir())


# --- at the same time ------------------------------------------------------------------------------------------------

@pytest.mark.filterwarnings('ignore:.*fork:DeprecationWarning')
def test_commands_at_once_in_one_folder_leave_one_whole_result(tmp_path):
    """Six processes, each with files of its own version and one more of its own: the last one's stay, and only those."""
    for attempt in range(2):
        scene, out = scene_file(tmp_path / f'{attempt}'), tmp_path / f'{attempt}' / 'out'
        children = []
        for k in range(6):
            children.append(os.fork())
            if not children[-1]:
                with suppress(BaseException):
                    write(out, scene, FILES | {f'own{k}.csv': ''}, version=f' {k}', pause=0.002)
                    os._exit(0)
                os._exit(1)
        assert [os.waitpid(pid, 0)[1] for pid in children] == [0] * 6
        assert whole(out)
        versions = {(out / name).read_text()[-1] for name in FILES}
        assert len(versions) == 1
        assert set(contents(out)) == {*FILES, f'own{versions.pop()}.csv', 'scene.toml', 'provenance.json'}


@pytest.mark.slow
def test_two_scenes_at_once_in_one_folder_leave_one_whole_result(tmp_path):
    out = tmp_path / 'out'
    start = [[sys.executable, '-m', 'magphonon', 'bands', str(scene_file(tmp_path, text, name)), '-o', str(out)]
             for text, name in ((CHAIN, 'my.toml'), (OTHER, 'other.toml'))]
    both = [subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) for command in start]
    said = [process.communicate()[1] for process in both]
    assert sorted(process.returncode for process in both) == [0, 2]
    assert any('holds results (bands) of the scene' in words for words in said)
    assert whole(out)
    winner = both[0].returncode == 2
    assert (out / 'scene.toml').read_text() == (CHAIN, OTHER)[winner]


# --- single files ----------------------------------------------------------------------------------------------------

def test_a_file_is_on_the_disk_before_it_takes_its_name(tmp_path, monkeypatch):
    order, sync, replace = [], os.fsync, os.replace
    monkeypatch.setattr(os, 'fsync', lambda file: order.append(os.fstat(file).st_size) or sync(file))
    monkeypatch.setattr(os, 'replace', lambda a, b: order.append('takes its name') or replace(a, b))
    with whole_file(tmp_path / 'x') as file:
        file.write('12345')
    assert order == [5, 'takes its name']


def test_who_reads_a_file_while_it_is_replaced_reads_the_old_one(tmp_path):
    for text in ('old', 'new'):
        with whole_file(tmp_path / 'x') as file:
            file.write(text)
        if text == 'old':
            reader = open(tmp_path / 'x')  # noqa: SIM115
    with reader:
        assert reader.read() == 'old'
    assert (tmp_path / 'x').read_text() == 'new'


def test_unfinished_files_that_others_hold_or_that_only_look_like_it_stay(tmp_path):
    for name in ('.x.partial', '.x.1.partials', '.y.99999.partial', 'x.1.partial'):
        (tmp_path / name).write_text('')
    (tmp_path / '.x.99999.partial').write_text('left by a process that is gone')
    with whole_file(tmp_path / 'x'):
        pass
    assert sorted(file.name for file in tmp_path.iterdir()) == ['.x.1.partials', '.x.partial', '.y.99999.partial', 'x',
                                                                'x.1.partial']
