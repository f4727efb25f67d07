"""Scene files written for the tests of commands, and the size of the pictures that these draw."""

import matplotlib as mpl
import pytest
from scene_files import ready_scene


@pytest.fixture(autouse=True)
def few_pixels(monkeypatch):
    """Pictures are drawn all the same, with a hundredth of their pixels: they took two thirds of the time of a burst."""
    monkeypatch.setitem(mpl.rcParams, 'savefig.dpi', 20)


@pytest.fixture
def scene_file(tmp_path):
    """A function that writes a ready scene with texts replaced by others."""
    def write(changes, name='bench'):
        text = ready_scene(name).read_text()
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new)
        file = tmp_path / 'my.toml'
        file.write_bytes(text.encode())
        return file
    return write
