"""Folders of results: a command writes its files into a hidden directory and moves them out only when all are complete.

Only the hidden directory that this process made is ever deleted. A file is replaced only by a result of the same name, and only
if its checksum shows that it is still what the command wrote. So no file of a user is touched, whatever is in the folder. The
checksums are in `provenance.json`.  It is written before the first file takes its name, with the command marked as not complete,
and again after the last one; a run that is killed between them can be repeated.
"""

from __future__ import annotations

import json
import os
import platform
import shlex
import shutil
import tomllib
from argparse import Namespace
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from errno import EDQUOT, EFBIG, ENOSPC
from fnmatch import fnmatch
from hashlib import file_digest, sha256
from importlib.metadata import version
from os import PathLike
from pathlib import Path
from stat import S_ISDIR, S_ISLNK, S_ISREG, S_IWUSR
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

from pydantic import BaseModel

from .. import __version__
from ..files import MEGABYTE, text_of
from ..scenes.sources import source_of

if TYPE_CHECKING:
    from ..scenes.scene import Scene

PROVENANCE, SCENE = 'provenance.json', 'scene.toml'
PACKAGES = ('ase', 'phonopy', 'numpy', 'scipy', 'matplotlib')  # packages whose versions are recorded with the results
COPY = 'a copy of the scene'  # value of `File.by` for files that no command computed
OTHERWISE = 'name another directory with -o'


class File(BaseModel, extra='forbid'):
    """Record of a file: the command that wrote it, its SHA-256 and that of the file which it replaced."""

    by: str
    sha256: str
    replaced: str = ''


class Run(BaseModel, extra='forbid'):
    """Record of the last run of a command: `inputs` are its measured tables with their SHA-256; `complete` if all files exist."""

    command: str
    date: str
    versions: dict[str, str]
    inputs: dict[str, str]
    complete: bool = False


class Origin(BaseModel, extra='forbid'):
    """The scene of a folder, how many shells of neighbours count in it, and the SHA-256 of each of its tables."""

    title: str
    shells: int | str = ''
    tables: dict[str, str]


class Provenance(BaseModel, extra='forbid'):
    """Content of `provenance.json`: all that is known about a folder; `sha256` is the checksum of the other entries."""

    sha256: str = ''
    scene: Origin | None = None
    results: dict[str, Run] = {}
    files: dict[str, File] = {}

    def checksum(self) -> str:
        """The value that `sha256` must have."""
        return _digest(self.model_dump_json(exclude={'sha256'}).encode())


@contextmanager
def results(options: Namespace, scene: Scene | None = None, *tables: str | PathLike[str]) -> Iterator[Path]:
    """Context with a directory to write into, whose files appear in the folder `options.output` when all of them are complete.

    The folder and its parents are made if they do not exist.  Files of an earlier run of the same command are replaced, unless
    they were edited; those that are not written again are left.  The `tables` are measured tables that the command reads.  The
    options get `written`, the folder, and `notes`, sentences about other files in it.

    ValueError is raised at once if the folder holds edited results, or results of another scene or table, or if the scene refers
    to a file with the name of a result. It is raised at the end if a new file would replace one that no command wrote.  In all
    these cases the folder stays unchanged.
    """
    folder, made = Path(options.output), []
    try:
        _make(folder, made)
        with _beside(folder) as stage:
            left = sorted(file.name for file in folder.iterdir() if file != stage
                          and (fnmatch(file.name, '.partial-*') or fnmatch(file.name, '.*.partial')))
            run = _Run(options, scene, tables)
            run.refuse_mixture(_provenance(folder))
            yield stage
            stale = run.move(stage)
    except OSError as error:
        if error.errno not in (ENOSPC, EFBIG, EDQUOT) or (error.filename and folder not in Path(error.filename).parents):
            raise  # such as a full disk that holds a long record elsewhere
        raise OSError(f'no space left for results in {folder} ({error.strerror}); nothing was written; make room or choose '
                      'another place') from None
    finally:
        for path in reversed(made):
            with suppress(OSError):  # a folder that is not empty stays
                path.rmdir()
    options.written, options.notes = folder, []
    if stale:
        options.notes.append(f'{", ".join(stale)} in {folder} are from an earlier run; this run did not write them again')
    if left:
        options.notes.append(f'{", ".join(left)} in {folder} may be left over from a command that was killed; nothing reads them')


def _make(folder, made):
    """Make the folder and its parents; those that this process made are added to `made`, the outermost first."""
    if os.path.lexists(folder) and not os.path.isdir(folder):  # unlike Path.is_dir, it returns False for a name that is too long
        raise NotADirectoryError(f'{folder} is a file; name a directory for the results')
    try:
        for path in reversed([path for path in (folder, *folder.parents) if not os.path.isdir(path)]):
            with suppress(FileExistsError):  # another command was faster
                path.mkdir()
                made.append(path)
    except OSError as error:
        raise type(error)(f'{folder} cannot be made ({error.strerror}); choose another place for the results') from None


@contextmanager
def _beside(folder):
    """Make a hidden directory within the folder, from which files can be renamed to their places without a copy."""
    try:
        stage = TemporaryDirectory(prefix='.partial-', dir=folder, ignore_cleanup_errors=True)
    except OSError as error:
        raise type(error)(f'{folder} cannot be written ({error.strerror}); choose another place for the results') from None
    with stage as name:
        yield Path(name)


class _Run:
    """A run of a command whose results go into a folder."""

    def __init__(self, options, scene, tables):
        self.folder, self.scene, self.tables = Path(options.output), None, {}
        self.name = ' '.join([options.command, *(Path(table).stem for table in tables if scene is not None)])
        self.record = Run(command=_text(shlex.join(['magphonon', *options.words])),
                          date=datetime.now(UTC).isoformat(timespec='seconds'),
                          versions={'magphonon': __version__, 'python': platform.python_version()}
                          | {package: version(package) for package in PACKAGES},
                          inputs={_text(table): _sum(table) for table in tables})
        if scene is None:
            return
        self.source = source_of(options.scene)
        tables = {key: value for key, value in scene.model_dump(mode='json').items() if value is not None}
        digests = {key: _digest(json.dumps(value, sort_keys=True).encode()) for key, value in tables.items()}
        self.scene = Origin(title=scene.title, shells=scene.law.shells, tables=digests)
        for key, named in tomllib.loads(self.source.text).items():
            path = Path(named.get('file', '') if key in ('law', 'lattice') else '')
            if path.name and not path.is_absolute():  # a file beside the scene, which is copied with it
                file = str(path)  # without ./
                if file != path.name:
                    raise ValueError(f'{key}.file = "{file}" is not in the folder of the scene, so the copy of the scene among '
                                     f'the results would not find it; put it beside the scene, or give its full path')
                if file.lower() in (PROVENANCE, SCENE) or any(fnmatch(file.lower(), pattern) for pattern in options.results):
                    raise ValueError(f'{key}.file = "{file}" has the same name as a result of "magphonon {self.name}", and both '
                                     f'would be written to the same folder; give the file another name')
                self.tables[file] = self.source.folder / file

    def refuse_mixture(self, known):
        """Raise ValueError if the folder holds results of another scene or table, or edited ones.

        A scene counts as the same if all its earlier tables are unchanged: results computed from them remain valid when another
        table is added.  A changed scene of the same title may replace the results of its own command, if the folder holds no
        results of other commands. So may a changed measured table with the same path.
        """
        there, run = known.scene, known.results.get(self.name, self.record)
        edited = there and self.scene and there.title == self.scene.title and known.results.keys() <= {self.name}
        if there and self.scene and not edited:
            differ = ['title'] * (there.title != self.scene.title) + [
                f'[{key}]' for key, digest in there.tables.items() if key != 'title' and self.scene.tables.get(key) != digest]
            if differ:
                raise ValueError(f'{self.folder} holds results ({", ".join(known.results)}) of the scene {there.title!r}, from '
                                 f'which the scene {self.scene.title!r} in {self.source} differs in {", ".join(differ)}; '
                                 f'{OTHERWISE}')
        for table, digest in self.record.inputs.items():
            if table not in run.inputs and digest not in run.inputs.values():
                raise ValueError(f'{self.folder} holds the results of "magphonon {self.name}" for another table, '
                                 f'{", ".join(run.inputs)}; {OTHERWISE}')
        for name, path in self.tables.items():
            self.replaces(name, _sum(path), COPY, known)
        for name, file in known.files.items():
            if file.by == self.name:
                self.replaces(name, file.sha256, self.name, known)

    def move(self, stage):
        """Move the new files and copies of the scene to their places; return the files of earlier runs that stay."""
        for path in (stage, *stage.iterdir()):
            if path.is_symlink():
                raise ValueError(f'another program replaced {path} by a link while the command ran; nothing was written')
        if self.scene is not None:
            (stage / SCENE).write_bytes(self.source.content)
        for name, path in self.tables.items():
            with open(path, 'rb') as table, open(stage / name, 'xb') as copy:
                shutil.copyfileobj(table, copy)
        known = _provenance(self.folder)
        self.refuse_mixture(known)
        new = {file.name: _sum(file) for file in sorted(stage.iterdir())}
        by = {name: COPY if name in (SCENE, *self.tables) else self.name for name in new}
        moved = [name for name, digest in new.items() if self.replaces(name, digest, by[name], known)]
        files = known.files | {name: File(by=by[name], sha256=digest) for name, digest in new.items()}
        for name in moved:
            if os.path.lexists(self.folder / name):
                files[name].replaced = _sum(self.folder / name)
        now = Provenance(scene=self.scene or known.scene, results=known.results | {self.name: self.record}, files=files)
        try:
            _write(now, stage, self.folder)  # first, so that a run that is killed now can be repeated
            for name in moved:
                if self.replaces(name, new[name], by[name], known):
                    _take(stage / name, self.folder / name)
            self.record.complete = True
            _write(now, stage, self.folder)
        except OSError as error:
            raise OSError(f'{self.folder} may hold only some of the new files ({error.strerror}); '
                          'give the command again') from error
        return [name for name, file in files.items()
                if file.by == self.name and name not in new and os.path.lexists(self.folder / name)]

    def replaces(self, name, digest, by, known):
        """Whether a new file must be moved to this name; False if it is there already, ValueError if another one is."""
        there, file = self.folder / name, known.files.get(name)
        if not os.path.lexists(there):
            return True
        found, mode = _sum(there) if there.is_file() else None, there.lstat().st_mode
        if found == digest:
            return False
        if not S_ISREG(mode):
            why = 'is a directory' if S_ISDIR(mode) else 'is a symbolic link' if S_ISLNK(mode) else 'is a pipe or a device'
        elif file is None:
            why = 'is not known as a result'
        elif file.by != by:
            why = f'is a result of "magphonon {file.by}"' if file.by != COPY else f'is {COPY}'
        elif found not in (file.sha256, file.replaced):
            why = 'was edited since it was written'
        elif not mode & S_IWUSR:
            why = 'is read-only'
        else:
            return True
        raise ValueError(f'{there} {why} and is not replaced; {OTHERWISE}, or move it away')


def _provenance(folder):
    file = folder / PROVENANCE
    if not os.path.lexists(file):
        return Provenance()
    if not file.stat().st_mode & S_IWUSR:
        raise ValueError(f'{file} is read-only and is not replaced; {OTHERWISE}')
    with suppress(OSError, ValueError):
        known = Provenance.model_validate_json(text_of(file, 10 * MEGABYTE))
        if not file.is_symlink() and known.sha256 == known.checksum() and all(Path(name).name == name for name in known.files):
            return known
    raise ValueError(f'{file} does not say where the results beside it come from, or was edited; {OTHERWISE}')


def _write(provenance, stage, folder):
    provenance.sha256 = provenance.checksum()
    (stage / PROVENANCE).write_text(provenance.model_dump_json(indent=1), encoding='utf-8')
    os.replace(stage / PROVENANCE, folder / PROVENANCE)


def _take(file, place):
    """Move a file to its place; if another program has meanwhile put a file there, that file stays."""
    if os.path.lexists(place):
        os.replace(file, place)
        return
    try:
        os.link(file, place)
    except FileExistsError:
        raise ValueError(f'{place} was made by another program while the command ran, and is not replaced; {OTHERWISE}') from None
    except OSError:  # a file system without links
        os.replace(file, place)


def _text(name):
    """A file name as text, even if its bytes are not valid text."""
    return str(name).encode(errors='backslashreplace').decode()


def _digest(content):
    return sha256(content).hexdigest()


def _sum(path):
    with open(path, 'rb') as file:
        return file_digest(file, 'sha256').hexdigest()
