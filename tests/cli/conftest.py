"""Scene files written for tests."""

import pytest

from magphonon.scenes.scene import ready_scene


@pytest.fixture
def scene_file(tmp_path):
    """A function that writes a ready scene with texts replaced by others."""
    def write(changes, name='prototype'):
        text = ready_scene(name).read_text()
        for old, new in changes.items():
            assert old in text, old
            text = text.replace(old, new)
        file = tmp_path / 'my.toml'
        file.write_bytes(text.encode())
        return file
    return write
