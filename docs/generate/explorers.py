"""Pages of the explorer for some ready scenes; Sphinx copies them to the root of the site (`html_extra_path`)."""

import contextlib
import io
import tempfile
from pathlib import Path

from magphonon.cli.main import main
from magphonon.scenes import ready_scene

SCENES = ('prototype', 'ideal', 'square', 'demultiplexer')


def write(folder):
    """One page for each scene, and that of the honeycomb whose bench turns, at rest: its burst has a slider for the gyration."""
    still = [line for line in ready_scene('gyro').read_text(encoding='utf-8').splitlines() if not line.startswith('gyration')]
    with tempfile.TemporaryDirectory() as place:
        gyro = Path(place) / 'gyro.toml'
        gyro.write_text('\n'.join(still), encoding='utf-8')
        for name, scene in [*zip(SCENES, SCENES, strict=True), ('gyro', str(gyro))]:
            with contextlib.redirect_stdout(io.StringIO()):
                status = main(['explore', scene, '-o', str(folder / f'{name}-explore.html')])
            if status:
                raise RuntimeError(f'magphonon explore {name}: exit status {status}')
