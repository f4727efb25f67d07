"""Where a scene comes from: the text of a file, a ready scene or a stream such as the standard input."""

from __future__ import annotations

import os
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from io import StringIO
from os import PathLike
from pathlib import Path
from typing import BinaryIO

from ..errors import nearest, one_of
from ..files import MEGABYTE, refuse_endless

MOST_BYTES = 10 * MEGABYTE
"""Largest size of a scene in bytes; the ready scenes have 3 kB."""
LIKENESS = 0.7
"""Least similarity at which a file name counts as mistyped; more than for keys, since 'wing' and 'rings' have 0.67."""
LIST = '"magphonon scene" lists scenes to start from'


@dataclass(frozen=True)
class Source:
    """The text of a scene and the place from which it was read.

    Messages call it by `name`: the path, the ready scene, or 'stdin'. Files that the scene refers to are looked for in `folder`.
    """

    name: str
    content: bytes
    folder: Path

    def __str__(self) -> str:
        return self.name

    @property
    def stem(self) -> str:
        """The name without folder and ending."""
        return Path(self.name).stem

    @property
    def suffix(self) -> str:
        """The ending of the name, '.toml'."""
        return Path(self.name).suffix

    @property
    def text(self) -> str:
        """The text, with line ends of any system converted to newlines."""
        return StringIO(self.content.decode('utf-8-sig'), newline=None).getvalue()


def source_of(scene: str | PathLike[str] | Source) -> Source:
    """The source of a scene: of a file or, if there is no such file, of the ready scene of this name."""
    if isinstance(scene, Source):
        return scene
    name, path = str(scene), Path(scene)
    if not name:
        raise ValueError(f"'' names no file; {LIST}")
    if name in ready_scenes() and not os.path.isfile(path):
        path = Path(str(ready_scenes()[name]))
    try:
        refuse_endless(path, MOST_BYTES)
        return Source(name, path.read_bytes(), path.parent)
    except OSError as error:
        meant = _meant(path) if isinstance(error, FileNotFoundError) else None
        mend = f'did you mean {meant}?' if meant else LIST
        raise type(error)(f'{path} cannot be read ({error.strerror}); {mend}') from None


def source_in_stream(stream: BinaryIO) -> Source:
    """The source of a scene read from a stream; files that it refers to are looked for in the current folder."""
    content = stream.read(MOST_BYTES + 1)
    if len(content) > MOST_BYTES:
        raise ValueError(f'stdin holds more than the {MOST_BYTES / MEGABYTE:g} MB that are read; it is probably not a scene')
    if not content.strip():
        raise ValueError('stdin is empty; send a scene into it, as in "magphonon scene prototype | magphonon bands -"')
    return Source('stdin', content, Path())


def _meant(path: Path) -> str | None:
    """A scene file in the same folder, or a ready scene, whose name is similar to that of a path that does not exist."""
    try:
        beside = {file.stem: file for file in path.parent.glob('*.toml')}
    except OSError:
        beside = {}
    for known in (beside, ready_scenes()):
        near = nearest(path.stem, known, LIKENESS)
        if near is not None:
            return repr(str(beside[near])) if known is beside else f'the ready scene {near!r}'
    return None


def ready_scenes() -> dict[str, Traversable]:
    """The scenes that come with the package: a dict from name to file.

    Examples
    --------
    >>> from magphonon.scenes import ready_scenes
    >>> 'prototype' in ready_scenes()
    True
    """
    found = (file for file in files('magphonon.data').iterdir() if file.name.endswith('.toml'))
    ordered = sorted(found, key=lambda file: file.name)
    return {file.name.removesuffix('.toml'): file for file in ordered if file.name != 'reference.toml'}


def ready_scene(name: str) -> Traversable:
    """The file of one of the `ready_scenes`.

    Examples
    --------
    >>> from magphonon.scenes import ready_scene
    >>> ready_scene('prototype').name
    'prototype.toml'
    """
    scenes = ready_scenes()
    return scenes[one_of('the scene', name, tuple(scenes))]
