"""An attack on folders of results: whatever stands in a folder, and whenever a command is killed, no file of a user changes.

Drawn folders combine what has destroyed files before (lists of names in hidden directories, names in `provenance.json`,
directories called like those of the package) with links, pipes, directories and edited files in the places of results.  The
whole tree is compared before and after.  The controls are variants that delete or replace: the same comparison catches them.
"""

import json
import os
import shutil
import signal
import stat
import sys
from contextlib import suppress
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scene_files import ready_scene

from magphonon import read_scene
from magphonon.cli import results as module
from magphonon.cli.results import COPY, File, Provenance, _sum, results

pytestmark = pytest.mark.skipif(not hasattr(os, 'mkfifo'), reason='needs pipes with names')
CHAIN = ready_scene('chain').read_text()
FORCES = 'r_m,f_N\n' + '\n'.join(f'{r},{1e4 * r**-4}' for r in (0.5, 0.8, 1.0, 1.3, 2.0))
TABLED = CHAIN.partition('[law]')[0] + '[law]\nkind = "table"\nfile = "law.csv"\nshells = 1\n'
NAMES = 'bands.csv', 'bands.png', 'zone.png'
WRITTEN = {*NAMES, 'scene.toml', 'law.csv', '.ready', 'provenance.json'}  # the law may be called .ready


def write(out, scene, text='new', names=NAMES):
    """What a command does; returns its notes, or the words of its refusal."""
    options = SimpleNamespace(output=str(out), scene=str(scene), command='bands', words=['bands'],
                              results=('bands.*', 'bands_*.npz', 'zone.*'))
    try:
        with results(options, read_scene(scene)) as folder:
            for name in names:
                (folder / name).write_text(f'{text} {name}')
    except (ValueError, OSError) as error:
        return str(error)
    return options.notes


def tree(top):
    """What stands below a folder: kind, permissions, and content or target, by path."""
    found = {}
    for folder, inner, names in os.walk(top):
        for name in inner + names:
            path = os.path.join(folder, name)
            mode = os.lstat(path).st_mode
            if stat.S_ISLNK(mode):
                what = os.readlink(path)
            else:
                what = Path(path).read_bytes() if stat.S_ISREG(mode) else None
            found[path] = stat.S_IFMT(mode), stat.S_IMODE(mode) if not stat.S_ISDIR(mode) else None, what
    return found


def damage(before, after, out, ours):
    """Paths that changed though they are no unedited results, `ours` by name, or that are new and no results."""
    changed = {path for path in before if after.get(path) != before[path]}
    places = {name: os.path.join(out, name) for name in WRITTEN}
    allowed = {path for name, path in places.items() if before.get(path, (0, 0, None))[2] == ours.get(name)}
    return changed - allowed | after.keys() - before - {str(out), *places.values()}


# --- what is in the way ----------------------------------------------------------------------------------------------

def draw_name(rng, desk):
    names = ['../thesis.txt', str(desk / 'thesis.txt'), 'notes.txt', '../data/run1.csv', '.', '..', 'a\nb.txt', '/', '../data',
             'ünï\u202e.txt', 'bands.csv', '']
    return names[rng.integers(len(names))]


def hidden_list(out, desk, rng):
    stage = out / f'.partial-{rng.integers(1000)}'
    stage.mkdir(exist_ok=True)
    (stage / '.ready').write_text(json.dumps([draw_name(rng, desk) for _ in range(3)]))
    (stage / '.aside').mkdir(exist_ok=True)
    (stage / 'bands.csv').write_text('planted')


def hidden_thing(out, desk, rng):
    path = out / '.partial-backup'
    if not os.path.lexists(path):
        [path.mkdir, lambda: path.write_text('mine'), lambda: os.mkfifo(path),
         lambda: path.symlink_to(desk / 'data')][rng.integers(4)]()
    if path.is_dir() and not path.is_symlink():
        (path / 'chapter.txt').write_text('mine')


def unfinished_file(out, desk, rng):
    for name in ('.bands.csv.99999.partial', f'.provenance.json.{os.getpid()}.partial', '.bands.csv.1.partial'):
        (out / name).write_text('mine')


def provenance(text):
    def plant(out, desk, rng):
        if (out / 'provenance.json').is_file():
            (out / 'provenance.json').write_text(text(out, desk, rng))
    return plant


def foreign_names(out, desk, rng):
    """The file of an earlier version, with names that it does not own."""
    return json.dumps({'complete': True, 'scene': None, 'results': {'bands': {
        'command': '', 'date': '', 'versions': {}, 'inputs': {}, 'files': {draw_name(rng, desk): '00' for _ in range(3)}}}})


def forged(out, desk, rng):
    """A valid file, checksum and all, that names files of the user: with their sums, or with wrong ones."""
    known = Provenance()
    with suppress(ValueError):
        known = Provenance.model_validate_json((out / 'provenance.json').read_text())
    for _ in range(3):
        name = draw_name(rng, desk)
        there = out / name
        right = there.is_file() and name not in NAMES and rng.random() < 0.5
        known.files[name] = File(by=rng.choice(['bands', 'frf', COPY]), sha256=_sum(there) if right else '00')
    known.sha256 = known.checksum()
    return known.model_dump_json()


def garbage(out, desk, rng):
    return ['[' * 100_000, 'null', '{"results": {"bands": 1}}', '\x00', '{"sha256": "' + '0' * 64 + '"}'][rng.integers(5)]


def put(kind):
    """Something of this kind in the place of a result."""
    def plant(out, desk, rng):
        path = out / [*NAMES, 'scene.toml', 'provenance.json'][rng.integers(5)]
        if path.is_dir() and not path.is_symlink():
            return
        path.unlink(missing_ok=True)
        {'link': lambda: path.symlink_to(desk / 'thesis.txt'), 'dangling link': lambda: path.symlink_to(desk / 'nowhere'),
         'link to a folder': lambda: path.symlink_to(desk / 'data'), 'pipe': lambda: os.mkfifo(path), 'folder': path.mkdir,
         'file': lambda: path.write_text('mine'), 'hard link': lambda: os.link(desk / 'thesis.txt', path)}[kind]()
        if kind == 'folder':
            (path / 'chapter.txt').write_text('mine')
    return plant


def edited(out, desk, rng):
    path = out / NAMES[rng.integers(3)]
    if path.is_file() and not path.is_symlink():
        path.write_text(path.read_text() + '# my comment')


def read_only(out, desk, rng):
    path = out / NAMES[rng.integers(3)]
    if path.is_file() and not path.is_symlink():
        path.chmod(0o444)


def own_files(out, desk, rng):
    for name in ('a\nb.txt', 'ünï\u202e.txt', '-rf', ' ', '.ready', '.aside'):
        (out / name).write_text('mine')
    (out / 'sub').mkdir(exist_ok=True)
    (out / 'sub' / 'bands.csv').write_text('mine')


def law_named_like_a_result(out, desk, rng):
    name = ['bands.csv', 'bands.png', 'provenance.json', 'scene.toml', '.ready', 'zone.png'][rng.integers(6)]
    (desk / name).write_text(FORCES)
    (desk / 'my.toml').write_text(TABLED.replace('law.csv', ['', './'][rng.integers(2)] + name))


def law_beside(out, desk, rng):
    (desk / 'law.csv').write_text(FORCES)
    (desk / 'my.toml').write_text(TABLED)


def other_scene(out, desk, rng):
    (desk / 'my.toml').write_text(CHAIN.replace('title = "', 'title = "Other '))


HOSTILITIES = [hidden_list, hidden_thing, unfinished_file, provenance(foreign_names), provenance(forged), provenance(forged),
               provenance(garbage), put('link'), put('dangling link'), put('link to a folder'), put('pipe'), put('folder'),
               put('file'), put('hard link'), edited, read_only, own_files, law_named_like_a_result, law_beside, other_scene]


def hostile(folder, seed, kinds):
    """A desk with a user's files and a folder of results (or none yet) in which some hostilities wait; what the package wrote."""
    rng = np.random.default_rng(seed)
    desk, ours = folder / str(seed), {}
    (desk / 'data').mkdir(parents=True)
    (desk / 'data' / 'run1.csv').write_text('measured')
    (desk / 'thesis.txt').write_text('thesis')
    (desk / 'my.toml').write_text(CHAIN)
    out = desk if rng.random() < 0.2 else desk / 'out'  # with -o . the user's files stand beside the results
    if rng.random() < 0.7:
        assert write(out, desk / 'my.toml', 'old', [*NAMES, 'bands_old.csv']) == []
        ours = {name: (out / name).read_bytes() for name in WRITTEN if (out / name).exists()}
    out.mkdir(exist_ok=True)
    (out / 'notes.txt').write_text('mine')
    for k in rng.choice(len(kinds), rng.integers(1, min(4, len(kinds) + 1)), replace=False):
        kinds[k](out, desk, rng)
    path = out / 'provenance.json'  # a forged one is well made: it may be replaced as the one of the package is
    if path.is_file() and not path.is_symlink() and b'"by":' in path.read_bytes():
        ours['provenance.json'] = path.read_bytes()
    return desk, out, ours


def attack(folder, seeds, kinds=HOSTILITIES):
    """The damage of a run in each hostile folder, and what it said."""
    harm, said = {}, []
    for seed in seeds:
        desk, out, ours = hostile(folder, seed, kinds)
        before = tree(desk)
        said.append(write(out, desk / 'my.toml', names=NAMES[: 1 + seed % 3]))
        if lost := damage(before, tree(desk), out, ours):
            harm[seed] = lost
    return harm, said


def test_no_file_of_a_user_changes_in_any_hostile_folder(tmp_path):
    harm, said = attack(tmp_path, range(80))
    assert not harm
    ran = [words for words in said if isinstance(words, list)]
    assert 15 < len(ran) < 65  # both are reached: runs that replace results, and refusals
    refusals = {words.partition(' and is not replaced')[0].split(' ', 1)[1] for words in said if 'and is not replaced' in words}
    assert len(refusals) >= 5


def test_the_comparison_catches_a_variant_that_deletes(tmp_path, monkeypatch):
    """The control: hidden directories are removed, and names in a list on the disk are unlinked, as they once were."""
    known = module._provenance

    def deleting(folder):
        for stage in folder.glob('.partial-*/.ready'):
            with suppress(ValueError, OSError):
                for name in json.loads(stage.read_text()):
                    (folder / name).unlink()
            shutil.rmtree(stage.parent)
        return known(folder)

    monkeypatch.setattr(module, '_provenance', deleting)
    harm, _ = attack(tmp_path, range(10), [hidden_list])
    assert len(harm) == 10
    assert any(path.endswith('thesis.txt') for paths in harm.values() for path in paths)


def test_the_comparison_catches_a_variant_that_does_not_look_at_sums(tmp_path, monkeypatch):
    monkeypatch.setattr(module._Run, 'replaces', lambda run, name, *rest: not os.path.lexists(run.folder / name)
                        or stat.S_ISREG(os.lstat(run.folder / name).st_mode))
    harm, _ = attack(tmp_path, range(20), [edited, put('file')])
    assert len(harm) >= 10


# --- kills -----------------------------------------------------------------------------------------------------------

OPERATIONS = ('open', 'os.rename', 'os.link', 'os.mkdir', 'os.remove', 'os.rmdir')


def killed(desk, out, at):
    """Run in a child that is killed before its file operation number `at` in this folder; whether it was."""
    pid = os.fork()
    if not pid:
        count = 0

        def strike(event, args):
            nonlocal count
            if event in OPERATIONS and isinstance(args[0], str | os.PathLike) and str(desk) in str(args[0]):
                count += 1
                if count == at:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(strike)
        write(out, desk / 'my.toml', 'new', NAMES[:2])
        os._exit(0)
    return os.WIFSIGNALED(os.waitpid(pid, 0)[1])


@pytest.mark.filterwarnings('ignore:.*fork:DeprecationWarning')
@pytest.mark.parametrize('first', [pytest.param(True, id='a new folder'),
                                   pytest.param(False, id='a folder with results', marks=pytest.mark.slow)])
def test_a_command_killed_at_any_file_operation_harms_nothing_and_can_be_repeated(first, tmp_path):
    mixed = at = 0
    while True:
        desk, at = tmp_path / str(at + 1), at + 1
        desk.mkdir()
        out = desk / 'out'
        law_beside(out, desk, None)
        if not first:
            assert write(out, desk / 'my.toml', 'old') == []
        ours = {name: (out / name).read_bytes() for name in WRITTEN if (out / name).exists()}
        out.mkdir(exist_ok=True)
        (out / 'notes.txt').write_text('mine')
        before = tree(desk)
        if not killed(desk, out, at):
            break
        lost = damage(before, tree(desk), out, ours)
        assert {path for path in lost if '.partial-' not in path} == set()
        known = module._provenance(out)
        now = [(out / name).read_text()[:3] for name in NAMES[:2] if (out / name).exists()]
        mixed += len(set(now)) == 2
        assert len(set(now)) < 2 or not known.results['bands'].complete  # nothing vouches for a mixture
        left = sorted(file.name for file in out.glob('.partial-*'))
        notes = write(out, desk / 'my.toml', 'new', NAMES[:2])
        assert all(any(name in note for note in notes) for name in left), notes
        known = module._provenance(out)
        assert known.results['bands'].complete
        assert all(_sum(out / name) == file.sha256 for name, file in known.files.items())
        assert (out / 'bands.csv').read_text() == 'new bands.csv'
        assert sorted(file.name for file in out.glob('.partial-*')) == left
    assert at > 25
    assert mixed or first
