"""Folders of results: each belongs to one scene, records its origin, and changes as a whole or not at all.

A command writes into a hidden directory within the folder.  When its files are complete, they are moved together:

1. the files of the same command's earlier run are set aside, `provenance.json` first;
2. the new ones are moved in, `provenance.json` last: a folder without it is not complete.

If a step fails, the earlier files are restored.  If the process is killed meanwhile, the next command finishes the move.
Commands that use the same folder at the same time wait for each other.
"""

from __future__ import annotations

import json
import os
import platform
import shlex
import shutil
import tempfile
import tomllib
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from errno import ENOSPC
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING

from .. import __version__
from ..files import lock, still_there, whole_file
from ..scenes.sources import source_of

if TYPE_CHECKING:
    from argparse import Namespace
    from collections.abc import Iterator
    from os import PathLike

    from ..scenes.scene import Scene

PROVENANCE, SCENE = 'provenance.json', 'scene.toml'
PACKAGES = ('ase', 'phonopy', 'numpy', 'scipy', 'matplotlib')
"""Packages whose versions are recorded with the results."""
READY, ASIDE = '.ready', '.aside'
"""In the hidden directory: the list of files to remove, written when all new files are complete; the files that were replaced."""


@contextmanager
def results(options: Namespace, scene: Scene | None = None, table: str | PathLike[str] | None = None) -> Iterator[Path]:
    """A directory to write into, whose files appear in the folder `options.output` together, when all are complete.

    The folder is made if it does not exist, with its parents.  Files of an earlier run of the same command for the same scene
    (and a table of the same name) are replaced, also those that are not written again.

    Parameters
    ----------
    options : argparse.Namespace
        With `output`, the name of the `command`, its `words` and the `scene`, a path or a Source.
    scene : Scene, optional
    table : path-like, optional
        The measured table, if the command reads one.

    Yields
    ------
    pathlib.Path

    Raises
    ------
    OSError
        At once if `output` is no directory, or cannot be made or written.
    ValueError
        If the folder holds results of another scene or table, or a file of the same name that is not a result of this command.
        After any error the folder is unchanged.
    """
    folder = Path(options.output)
    missing = [path for path in (folder, *folder.parents) if not os.path.isdir(path)]
    try:
        _make(folder, missing)
        with _hidden(folder) as stage:
            origin = _Origin(options, scene, table)
            with _alone(folder):
                origin.refuse_mixture(_provenance(folder))
            yield stage
            copies = origin.copy_scene(stage)
            with _alone(folder):
                _move_in(stage, folder, origin, copies)
    except OSError as error:
        if error.errno != ENOSPC or (error.filename and folder not in Path(error.filename).parents):
            raise  # such as a full disk that holds a long record elsewhere
        raise OSError(f'no space left for results in {folder}, nothing was written; make room or choose another place') from None
    finally:
        for made in missing:
            with suppress(OSError):  # it stays if there is anything in it
                made.rmdir()
    options.written = folder


def _make(folder, missing):
    """Make the folder and its parents; the `missing` ones do not exist yet, the innermost first."""
    if os.path.lexists(folder) and not os.path.isdir(folder):  # unlike Path.is_dir, it returns False for a name that is too long
        raise NotADirectoryError(f'{folder} is a file; name a directory for the results')
    try:
        for path in reversed(missing):
            path.mkdir(exist_ok=True)
    except OSError as error:
        raise type(error)(f'{folder} cannot be made ({error.strerror}); choose another place for the results') from None


@contextmanager
def _hidden(folder):
    """A hidden directory within the folder, locked as long as its process lives."""
    try:
        while True:
            stage = Path(tempfile.mkdtemp(prefix='.partial-', dir=folder))
            with suppress(FileNotFoundError):  # another command may remove it before it is locked
                handle = os.open(stage, os.O_RDONLY)
                lock(handle, wait=True)
                if still_there(handle, stage):
                    break
                os.close(handle)
    except OSError as error:
        raise type(error)(f'{folder} cannot be written ({error.strerror}); choose another place for the results') from None
    try:
        yield stage
    finally:
        if not (stage / READY).exists():  # otherwise a move could neither be finished nor undone: the next command tries again
            shutil.rmtree(stage)
        os.close(handle)


@contextmanager
def _alone(folder):
    """Keep other commands from changing the folder, and finish or remove the work of killed ones."""
    handle = os.open(folder, os.O_RDONLY)
    try:
        lock(handle, wait=True)
        for left in folder.glob('.partial-*'):
            _collect(left, folder)
        yield
    finally:
        os.close(handle)


def _collect(stage, folder):
    """Finish or remove the work of another process, if that process has ended."""
    try:
        handle = os.open(stage, os.O_RDONLY)
    except OSError:
        return
    try:
        if lock(handle) and still_there(handle, stage):
            if (stage / READY).exists():
                _finish(stage, folder)
            shutil.rmtree(stage)
    finally:
        os.close(handle)


class _Origin:
    """Where the results of one command come from.

    A scene counts as the same if all its earlier tables are unchanged: results computed from them remain valid when another
    table is added.

    Parameters
    ----------
    options, scene, table
        As `results` takes them.
    """

    def __init__(self, options, scene, table):
        self.name = options.command if table is None or scene is None else f'{options.command} {Path(table).stem}'
        self.folder, self.scene, self.source = options.output, scene, None
        self.record = {'command': shlex.join(['magphonon', *options.words]),
                       'date': datetime.now(UTC).isoformat(timespec='seconds'),
                       'versions': {'magphonon': __version__, 'python': platform.python_version()}
                       | {name: version(name) for name in PACKAGES},
                       'inputs': {}}
        if scene is not None:
            self.source = source_of(options.scene)
            self.tables = {key: _digest(value) for key, value in scene.model_dump(mode='json').items() if value is not None}
        if table is not None:
            self.record['inputs'][Path(table).name] = _sum(table)

    def refuse_mixture(self, known):
        """Raise ValueError if the folder, whose provenance is `known`, holds results of another scene or table.

        An edited scene with the same title may replace the results of its own command, if there are no results of others.
        """
        there = known.get('scene')
        edited = there is not None and self.scene is not None and there['title'] == self.scene.title
        if self.scene is not None and there is not None and not (edited and set(known['results']) <= {self.name}):
            differ = [f'[{key}]' if key != 'title' else key
                      for key, digest in there['tables'].items() if self.tables.get(key) != digest]
            if differ:
                raise ValueError(f'{self.folder} holds results ({", ".join(known["results"])}) of the scene {there["title"]!r}, '
                                 f'from which the scene {self.scene.title!r} in {self.source} differs in {", ".join(differ)}; '
                                 'name another directory with -o, or remove this one')
        inputs = known['results'].get(self.name, self.record)['inputs']
        for table in inputs:
            if inputs[table] != self.record['inputs'].get(table):
                raise ValueError(f'{self.folder} holds the results of "magphonon {self.name}" for another table {table}; '
                                 'name another directory with -o, or remove this one')

    def copy_scene(self, stage):
        """Copy the scene, and the tables in its directory, to its results; return the names of all copies."""
        if self.source is None:
            return []
        (stage / SCENE).write_bytes(self.source.content)
        tables = tomllib.loads(self.source.text)
        beside = [tables[name]['file'] for name in ('law', 'lattice') if 'file' in tables[name]]
        # a table elsewhere is not copied: the scene still names it
        copied = [name for name in dict.fromkeys(beside) if Path(name).name == name]
        for name in copied:
            shutil.copyfile(self.source.folder / name, stage / name)
        return [SCENE, *copied]

    def provenance(self, known, files):
        """The provenance of the folder with these `files`, a dict of checksums by name, added to what is `known`."""
        scene = known.get('scene') if self.scene is None else {'title': self.scene.title, 'file': SCENE, 'tables': self.tables}
        return {'complete': True, 'scene': scene, 'results': known['results'] | {self.name: self.record | {'files': files}}}


def _provenance(folder):
    """What is known of the results in a folder."""
    file = folder / PROVENANCE
    try:
        known = json.loads(file.read_text(encoding='utf-8'))
    except FileNotFoundError:
        return {'results': {}}
    except (OSError, ValueError, RecursionError):
        known = None
    if not _tells_origin(known):
        raise ValueError(f'{file} does not say where the results beside it come from; name another directory with -o, or remove '
                         'this one')
    return known


def _tells_origin(known):
    """Whether an object has the form of a provenance."""
    if not isinstance(known, dict) or not isinstance(known.get('results'), dict):
        return False
    scene = known.get('scene')
    return (all(isinstance(part, dict) and isinstance(part.get('files'), dict) and isinstance(part.get('inputs'), dict)
                for part in known['results'].values())
            and (scene is None or (isinstance(scene, dict) and 'title' in scene and isinstance(scene.get('tables'), dict))))


def _move_in(stage, folder, origin, copies):
    """Check that no file of another origin would be replaced, and move the new files in."""
    known = _provenance(folder)
    origin.refuse_mixture(known)
    new = sorted(file.name for file in stage.iterdir())
    earlier = known['results'].get(origin.name, {'files': ()})['files']
    for name in new:
        _refuse_foreign(stage / name, folder / name, known, origin.name)
    sums = {name: _sum(stage / name, sync=True) for name in new}
    with whole_file(stage / PROVENANCE) as file:
        json.dump(origin.provenance(known, {name: value for name, value in sums.items() if name not in copies}), file, indent=1)
    gone = [name for name in earlier if name not in new and (folder / name).is_file()]
    with whole_file(stage / READY) as file:
        json.dump(gone, file)
    _replace(stage, folder, gone, new)
    (stage / READY).unlink()


def _refuse_foreign(new, there, known, name):
    """Raise ValueError if a new file would replace a file that is not an earlier result of the command `name`."""
    owner = next((other for other, part in known['results'].items() if there.name in part['files']), None)
    if not os.path.lexists(there):
        return
    ours = owner == name or (new.name == SCENE and known.get('scene') is not None)
    if not there.is_dir() and (ours or there.read_bytes() == new.read_bytes()):  # such as the scene itself
        return
    whose = 'is a directory' if there.is_dir() else f'is a result of "magphonon {owner}"' if owner else 'is not known as a result'
    raise ValueError(f'{there} {whose} and is not replaced, so nothing was written; name another directory with -o, or move it '
                     'away')


def _replace(stage, folder, gone, new):
    """Set aside what is there under these names, and move the new files in; put everything back if that fails."""
    aside, moved = [], []
    (stage / ASIDE).mkdir()
    try:
        for name in (PROVENANCE, *gone, *new):
            aside.append(name)
            if os.path.lexists(folder / name):
                os.replace(folder / name, stage / ASIDE / name)
        for name in (*new, PROVENANCE):
            moved.append(name)
            os.replace(stage / name, folder / name)
    except BaseException:
        for name in moved:
            if not (stage / name).exists():
                os.replace(folder / name, stage / name)
        for name in reversed(aside):
            if (stage / ASIDE / name).exists():
                os.replace(stage / ASIDE / name, folder / name)
        (stage / READY).unlink()
        raise


def _finish(stage, folder):
    """Finish the move of a process that was killed during it."""
    for name in json.loads((stage / READY).read_text(encoding='utf-8')):
        (folder / name).unlink(missing_ok=True)
    new = sorted(file.name for file in stage.iterdir() if file.name not in (READY, ASIDE, PROVENANCE))
    for name in (*new, PROVENANCE):
        if (stage / name).exists():
            os.replace(stage / name, folder / name)


def _digest(value):
    return sha256(json.dumps(value, sort_keys=True).encode()).hexdigest()


def _sum(path, sync=False):
    """Checksum of a file; with `sync` it is made sure that the file is on the disk."""
    total = sha256()
    with open(path, 'rb') as file:
        while piece := file.read(2**20):
            total.update(piece)
        if sync:
            os.fsync(file.fileno())
    return total.hexdigest()
