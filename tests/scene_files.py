"""The scenes that tests read: those of the package, and those of the folder `ready` beside this file."""

from pathlib import Path

from magphonon.scenes import sources

FOLDER = Path(__file__).parent / 'ready'


def ready_scene(name):
    """The file of a scene of the tests or, if they have none of this name, of the package."""
    file = FOLDER / f'{name}.toml'
    return file if file.exists() else Path(str(sources.ready_scene(name)))
