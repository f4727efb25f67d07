"""Mutated scenes and tables through the commands: an answer or a refusal in own words, never anything in between.

Thousands of them:  python -m pytest -n 0 -m long tests/test_fuzz.py
"""

import random
import shutil
from pathlib import Path

import fuzzing
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from magphonon.scenes import read_scene, ready_scene
from magphonon.sites import site

pytestmark = pytest.mark.skipif(not Path('/proc/self/statm').exists(), reason='the limit of memory needs to know what is used')

CHEAP = settings(deadline=None, derandomize=True, database=None, suppress_health_check=list(HealthCheck))
"""Of CI: the same cases every time, so that a change of code is what makes one fail."""
SEARCH = settings(CHEAP, derandomize=False)


def judged(command, files, folder):
    """What is wrong with a command on files of these contents, a dict of name to bytes."""
    desk = Path(folder) / 'desk'
    shutil.rmtree(desk, ignore_errors=True)
    desk.mkdir()
    for name, content in files.items():
        (desk / name).write_bytes(content)
    inputs, out = [desk / name for name in files], desk / 'out'
    arguments = [command, *map(str, inputs)]
    if command not in ('check', 'design'):
        arguments += ['-o', str(out)]
    if command == 'plan':
        arguments.append('--run')
    return fuzzing.verdict(arguments, inputs, out)


def scene_case(rng, folder):
    command, content = fuzzing.scene_text(rng)
    return judged(command, {'my.toml': content}, folder)


def row_of_prototype():
    scene = read_scene(ready_scene('prototype'))
    return site(scene.atoms(), scene.patch_atoms(), 'point').row


def table_case(rng, folder, row):
    if rng.random() < 0.5:
        return judged('fit', {'forces.csv': fuzzing.force_table(rng)}, folder)
    files = {'scan.csv': fuzzing.displacement_table(rng, list(row)), 'my.toml': ready_scene('prototype').read_bytes()}
    return judged('spectrum', files, folder)


@settings(CHEAP, max_examples=500)
@given(st.randoms(use_true_random=False))
def test_mutated_scenes(tmp_path_factory, rng):
    assert scene_case(rng, tmp_path_factory.getbasetemp())[0] == []


@settings(CHEAP, max_examples=100)
@given(st.randoms(use_true_random=False))
def test_mutated_tables(tmp_path_factory, rng):
    assert table_case(rng, tmp_path_factory.getbasetemp(), row_of_prototype())[0] == []


@pytest.mark.long
@settings(SEARCH, max_examples=5000)
@given(st.randoms(use_true_random=False))
def test_many_mutated_scenes(tmp_path_factory, rng):
    assert scene_case(rng, tmp_path_factory.getbasetemp())[0] == []


@pytest.mark.long
@settings(SEARCH, max_examples=1000)
@given(st.randoms(use_true_random=False))
def test_many_mutated_tables(tmp_path_factory, rng):
    assert table_case(rng, tmp_path_factory.getbasetemp(), row_of_prototype())[0] == []


def test_cases_are_refused_and_answered(tmp_path):
    """Both ends of the judge are used: of 60 cases a good part is answered and a good part refused."""
    ends = [scene_case(random.Random(seed), tmp_path)[1] for seed in range(60)]
    assert ends.count(0) >= 6
    assert ends.count(2) >= 20


# --- controls: a guard that is broken is found ---------------------------------------------------------------------

def found_by(seeds, folder):
    return [wrong for seed in range(seeds) for wrong in scene_case(random.Random(seed), folder)[0]]


def test_control_of_huge_numbers(tmp_path, monkeypatch):
    """Without the test for finite numbers, some come through to a traceback or a result."""
    import magphonon.errors as errors

    monkeypatch.setattr(errors, 'isfinite', lambda value: True)
    assert found_by(60, tmp_path)


def test_control_of_names(tmp_path, monkeypatch):
    """Messages without the names of the keys are told from those with them."""
    monkeypatch.setattr('magphonon.scenes._fault', lambda place, error, data: 'some number is wrong')
    monkeypatch.setattr('fuzzing.unclear', lambda error, inputs, out: CLEAR(error.replace(str(inputs[0]), ''), [], out))
    assert any('names neither key nor file' in wrong for wrong in found_by(30, tmp_path))


CLEAR = fuzzing.unclear
