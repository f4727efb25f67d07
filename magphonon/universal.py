"""Universal files, as instruments write them: the datasets that pyuff reads."""

from __future__ import annotations

from os import PathLike
from typing import Any


def universal_sets(path: str | PathLike[str]) -> list[dict[str, Any]]:
    """The datasets of a universal file, as dicts of pyuff."""
    try:
        import pyuff
    except ImportError:
        raise ValueError(f"{path} is a universal file, which pyuff reads; install it with pip install 'magphonon[vibrometer]', "
                         'or export the measurement as CSV') from None
    try:
        sets: Any = pyuff.UFF(str(path)).read_sets()
    except OSError:
        raise
    except Exception as error:  # pyuff fails on other files in many ways
        raise ValueError(f'{path} is no universal file that pyuff reads ({type(error).__name__}: {error}); export it again, '
                         'or as CSV') from None
    return [sets] if isinstance(sets, dict) else list(sets)
