"""Notebooks that run in the browser: JupyterLite with Pyodide, for `python -m sphinx -t lite docs docs/_build`.

The browser fetches Pyodide, NumPy, SciPy and Matplotlib from the network.  Without one, but with a copy of the interpreter of
Pyodide 314.0.6, the kernel starts and the first cell runs; the second stops at `import numpy`.  What comes after it is untried.
phonopy and psutil are not among Pyodide's packages; magphonon works without them.
"""

import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[2]
FIRST = ['%pip install -q --no-deps magphonon\n', '%pip install -q ase lazy_loader pydantic tqdm']


def wheel(folder):
    """The wheel of these sources, which the site serves."""
    folder.mkdir(parents=True, exist_ok=True)
    for old in folder.glob('magphonon-*.whl'):
        old.unlink()
    subprocess.run([sys.executable, '-m', 'pip', 'wheel', '-q', '--no-deps', '-w', folder, ROOT], check=True)  # noqa: S603
    return next(folder.glob('magphonon-*.whl'))


def forget(app, exception):
    """Let the next build write the pages of examples anew: without `-t lite` their buttons would lead nowhere."""
    for known in (Path(app.srcdir) / 'generated').glob('**/*.md5'):
        known.unlink()


def prepare(notebook, name):
    """Let a notebook of sphinx-gallery begin with the packages that it needs."""
    notebook['cells'].insert(0, {'cell_type': 'code', 'execution_count': None, 'metadata': {}, 'outputs': [], 'source': FIRST})
