"""Folders of results: files take their names when all are complete, and replace files that exist only with --force."""

from __future__ import annotations

import os
from argparse import Namespace
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from fnmatch import fnmatch
from pathlib import Path
from tempfile import TemporaryDirectory

from ..files import room_for


@contextmanager
def results(options: Namespace, *names: str) -> Iterator[Path]:
    """Context with a directory to write into, whose files move into the folder `options.output` when all of them are complete.

    Without `options.force`, FileExistsError is raised at once if a file in the folder has one of the `names`, which may be
    patterns such as 'bands.*', and at the end if a file with the name of a result was made meanwhile. Nothing is deleted but the
    hidden directory that this process itself made. The options get `written`, the folder.
    """
    folder = Path(options.output)
    if os.path.lexists(folder) and not os.path.isdir(folder):  # unlike Path.is_dir, it returns False for a name that is too long
        raise NotADirectoryError(f'{folder} is a file; name a directory for the results')
    refuse_existing(options, [file for file in sorted(folder.glob('*')) if any(fnmatch(file.name, name) for name in names)])
    made = [path for path in (folder, *folder.parents) if not os.path.isdir(path)]
    try:
        with room_for(folder), _stage(folder) as stage:
            yield stage
            files = sorted(stage.iterdir())
            refuse_existing(options, [folder / file.name for file in files])
            for file in files:
                os.replace(file, folder / file.name)
    finally:
        for path in made:
            with suppress(OSError):  # a folder that is not empty stays
                path.rmdir()
    options.written = folder


@contextmanager
def _stage(folder):
    """Make a hidden directory in the folder, from which files can be renamed to their places without a copy."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        stage = TemporaryDirectory(prefix='.magphonon-', dir=folder, ignore_cleanup_errors=True)
    except OSError as error:
        raise type(error)(f'{folder} cannot be written ({error.strerror}); choose another place for the results') from None
    with stage as name:
        yield Path(name)


def refuse_existing(options: Namespace, files: Sequence[Path]) -> None:
    """Raise FileExistsError if one of the files exists, unless the options have --force."""
    for file in files if not options.force else ():
        if os.path.lexists(file):
            raise FileExistsError(f'{file} exists; name another place with -o, or give --force to replace it')
