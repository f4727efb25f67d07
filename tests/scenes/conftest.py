"""Scene files written for tests."""

import copy
import json
import tomllib

import pytest
from scene_files import ready_scene

SCENE = tomllib.loads(ready_scene('bench').read_text())


def toml(value):
    """A value as TOML."""
    if isinstance(value, dict):
        return '{' + ', '.join(f'{key} = {toml(item)}' for key, item in value.items()) + '}'
    if isinstance(value, list):
        return '[' + ', '.join(map(toml, value)) + ']'
    return repr(value) if isinstance(value, float) else json.dumps(value)


@pytest.fixture
def as_toml():
    return toml


@pytest.fixture
def scene_file(tmp_path):
    """A function that writes the prototype's scene with changes, {'law.a': 3.0}; a value of None removes the key."""
    def write(changes, base=SCENE):
        scene = copy.deepcopy(base)
        for name, value in changes.items():
            *tables, key = name.split('.')
            table = scene
            for step in tables:
                table = table[step]
            table[key] = value
            if value is None:
                del table[key]
        file = tmp_path / 'my.toml'
        file.write_text(''.join(f'{key} = {toml(value)}\n' for key, value in scene.items()))
        return file
    return write
