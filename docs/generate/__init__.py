"""Pages of the site that are written from the code, so that they follow it: `write_all` is called by `docs/conf.py`."""

import shutil
from functools import partial

from . import api, commands, explorers, thresholds, traits, workflows


def write_all(folder, every=False):
    """Write all generated pages into `folder`, whose earlier pages are removed, but not what sphinx-gallery keeps there.

    `every` runs the longer workflows too.
    """
    for name, write in {'api': api.write, 'commands': commands.write, 'explorers': explorers.write,
                        'workflows': partial(workflows.write, every=every),
                        'traits': traits.write, 'validity': thresholds.write}.items():
        shutil.rmtree(folder / name, ignore_errors=True)
        (folder / name).mkdir(parents=True)
        write(folder / name)
