"""However many faults a scene has, and in whichever tables, one answer names them all and nothing else."""

import copy
import tomllib

import numpy as np
import pytest

from magphonon.scenes.keys import scene_keys
from magphonon.scenes.scene import read_scene, ready_scene
from magphonon.scenes.sources import Source

SCENES = 'prototype', 'tolerances', 'vacancy', 'layer', 'design', 'oscillator'
DRAWN = 12
"""Scenes drawn from each ready one."""
KEYS = {(key.table, kind, key.name): key for key in scene_keys() for kind in key.kinds or ('',)}


def toml(value):
    if isinstance(value, dict):
        return '{' + ', '.join(f'{key} = {toml(item)}' for key, item in value.items()) + '}'
    if isinstance(value, list):
        return '[' + ', '.join(map(toml, value)) + ']'
    return str(value).lower() if isinstance(value, bool) else f'"{value}"' if isinstance(value, str) else repr(value)


def tables_of(scene, place=''):
    """The tables of a scene with their places: '' for the scene itself, 'foundation.pillar'."""
    yield place, scene
    for name, value in scene.items():
        if isinstance(value, dict):
            yield from tables_of(value, f'{place}.{name}' if place else name)


def spoil(table, place, rng):
    """Spoil one key of a table; the beginning of the line that must tell it."""
    name = str(rng.choice([name for name in table if name != 'kind' and not isinstance(table[name], dict)] or ['']))
    key = KEYS.get((place, table.get('kind', ''), name), KEYS.get((place, '', name)))
    whole = f'{place}.{name}' if place else name
    told = place or 'the scene'
    fault = rng.choice(['unknown', 'missing', 'type', 'range'])
    if fault == 'missing' and key is not None and key.default == 'required':
        del table[name]
        return f"{told} lacks the key '{name}'; add "
    if fault == 'type' and key is not None and not key.type.startswith('table'):
        table[name] = {'no': 1}
        return f'{whole} must be '
    if fault == 'range' and key is not None and key.unit and key.type == 'number' and '_deg' not in name and key.allowed:
        table[name] = -1e-3 if rng.integers(2) or ' to ' not in key.allowed else 1e30
        return f'{whole} must '
    table['zzz'] = 1
    return f"{told} has no key 'zzz'; its keys are "


def answer(scene):
    content = ''.join(f'{key} = {toml(value)}\n' for key, value in scene.items()).encode()
    try:
        read_scene(Source('drawn', content, ready_scene('prototype').parent))
    except ValueError as error:
        return [line.removeprefix('drawn: ') for line in str(error).splitlines()]
    return []


@pytest.mark.parametrize('name', SCENES)
def test_one_answer_names_every_fault_and_no_other(name):
    rng = np.random.default_rng(sum(map(ord, name)))
    good = tomllib.loads(ready_scene(name).read_text(encoding='utf-8'))
    assert answer(good) == []  # the control: toml() writes what the file says
    most = 0
    for _ in range(DRAWN):
        scene = copy.deepcopy(good)
        places = list(tables_of(scene))
        chosen = rng.permutation(len(places))[: rng.integers(2, len(places) + 1)]
        expected = sorted(spoil(places[k][1], places[k][0], rng) for k in chosen)
        said = sorted(answer(scene))
        assert [begin for begin in expected if not any(line.startswith(begin) for line in said)] == []
        assert len(said) == len(expected)
        most = max(most, len(said))
    assert most >= 4
