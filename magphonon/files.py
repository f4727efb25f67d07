"""Writing files whole: under a temporary name first, renamed when complete."""

import os
from contextlib import contextmanager
from pathlib import Path


@contextmanager
def whole_file(path, mode='w'):
    """Open `path` for writing so that it appears only when it is complete.

    Raises
    ------
    OSError
        If the directory does not exist or cannot be written; nothing is left behind.
    """
    path = Path(path)
    partial = path.with_name(f'.{path.name}.{os.getpid()}.partial')
    try:
        with open(partial, mode) as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.replace(partial, path)
    finally:
        partial.unlink(missing_ok=True)
