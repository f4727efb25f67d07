"""Pages of the explorer for some ready scenes; Sphinx copies them to the root of the site (`html_extra_path`)."""

import contextlib
import io

from magphonon.cli.main import main

SCENES = ('prototype', 'ideal', 'square', 'honeycomb', 'kagome', 'chain')


def write(folder):
    """One page for each scene."""
    for name in SCENES:
        with contextlib.redirect_stdout(io.StringIO()):
            status = main(['explore', name, '-o', str(folder / f'{name}-explore.html')])
        if status:
            raise RuntimeError(f'magphonon explore {name}: exit status {status}')
