"""Mutated scenes and tables through the commands: an answer or a refusal in own words, never anything in between.

Forty times as many, other ones:  python -m pytest -n 0 -m long tests/test_fuzz.py
"""

import random
import re
import shutil
from dataclasses import replace
from pathlib import Path

import fuzzing
import judge
import matplotlib as mpl
import numpy as np
import pytest

from magphonon import errors
from magphonon.cli import main, results, uncertainty
from magphonon.cli.costs import costs
from magphonon.response import frf
from magphonon.scenes.scene import read_scene, ready_scene
from magphonon.waves.wave_source import site

pytestmark = pytest.mark.skipif(not Path('/proc/self/statm').exists(), reason='the limit of memory needs to know what is used')

COMMANDS = {'check': 95, 'design': 4, 'bands': 8, 'plan': 9, 'frf': 8, 'uncertainty': 4, 'burst': 4}
"""How many scenes each command gets, 132 in all: most of them those that answer in a moment."""
GENTLE = {'check': 0.1, 'design': 0.5}
"""Probability that a mutation is a small one, 0.7 for commands that do not stand here: most of their scenes shall be answered."""
PROMISED = 5.0
"""Seconds of an estimate: a command that has promised less must end within the time of a case."""
TOLD = 1e8
"""Multiplications of a plan, some seconds: one that tells less before it is run must end too."""


@pytest.fixture(autouse=True)
def cheap(monkeypatch, request):
    """Pictures are drawn all the same, with few pixels; fewer lattices are drawn at random.

    The impacts that leave a cage, seven seconds in space, are left to the long run and to tests of their own.
    """
    if not request.node.get_closest_marker('long'):
        request.getfixturevalue('no_impacts')
    monkeypatch.setitem(mpl.rcParams, 'savefig.dpi', 20)
    monkeypatch.setattr(uncertainty, 'SAMPLES', 20)


def verdict(command, files, folder, output=True, between=()):
    """The judge's verdict on a command that reads files of these contents, a dict of name to bytes, the scene last."""
    desk = Path(folder) / 'desk'
    shutil.rmtree(desk, ignore_errors=True)
    desk.mkdir()
    for name, content in files.items():
        (desk / name).write_bytes(content)
    inputs, out = [desk / name for name in files], desk / 'out'
    arguments = [command, *map(str, inputs[:-1]), *between, str(inputs[-1])]
    if output and command not in ('check', 'design'):
        arguments += ['-o', str(out)]
    if command == 'plan':
        arguments.append('--run')
    found = judge.judged(arguments, inputs, out)
    if found.faults == [judge.SLOW] and long_work(command, inputs[-1], out):
        return judge.Verdict([], None)
    return found


def long_work(command, file, out):
    """Whether a command tells that it will take its time: by its estimate, or a plan by its cost, before it is run."""
    if command == 'plan':
        words = judge.judged(['plan', str(file)], [file], out).words
        return any(float(cost) > TOLD for cost in re.findall(r'(\d\.\de[+-]\d+)  <- recommended', words))
    try:
        return sum(cost.seconds for cost in costs(read_scene(file)) if cost.table == command) > PROMISED
    except ValueError:
        return False


def scene_verdict(seed, command, folder):
    rng = random.Random(f'{command} {seed}')  # noqa: S311, nothing secret
    return verdict(command, {'my.toml': fuzzing.scene_text(rng, command, GENTLE.get(command, 0.7))}, folder)


def table_verdict(seed, row, folder):
    rng = random.Random(f'table {seed}')  # noqa: S311, nothing secret
    if rng.random() < 0.8:
        return verdict('fit', {'forces.csv': fuzzing.force_table(rng)}, folder, output=seed % 3 == 0)  # pictures take long
    files = {'scan.csv': fuzzing.displacement_table(rng, row), 'my.toml': small_patch()}
    return verdict('spectrum', files, folder)


def ridges_verdict(seed, folder):
    rng = random.Random(f'ridges {seed}')  # noqa: S311, nothing secret
    output = seed % 8 == 0  # pictures take long
    return verdict('fit', {'ridges.csv': fuzzing.ridge_table(rng), 'my.toml': small_patch()}, folder, output, between=['--bands'])


def small_patch():
    return ready_scene('prototype').read_bytes().replace(b'side_m = 0.3 ', b'side_m = 0.1 ')


@pytest.fixture(scope='module')
def row(tmp_path_factory):
    """The particles of the row that `spectrum` wants."""
    file = tmp_path_factory.mktemp('row') / 'my.toml'
    file.write_bytes(small_patch())
    scene = read_scene(file)
    return list(site(scene.atoms(), scene.patch_atoms(), 'point').row)


def faults(verdicts):
    """Those of a dict of seed to verdict, by seed."""
    return {seed: found.faults for seed, found in verdicts.items() if found.faults}


@pytest.mark.slow
@pytest.mark.parametrize('command', COMMANDS)
def test_mutated_scenes(command, tmp_path):
    verdicts = {seed: scene_verdict(seed, command, tmp_path) for seed in range(COMMANDS[command])}
    assert faults(verdicts) == {}
    answered = [seed for seed, found in verdicts.items() if found.status in (0, 1)]
    assert len(answered) >= len(verdicts) / 8  # otherwise nothing but the reading of scenes was tried


def test_mutated_tables(tmp_path, row):
    assert faults({seed: table_verdict(seed, row, tmp_path) for seed in range(25)}) == {}


@pytest.mark.slow
def test_mutated_ridges(tmp_path):
    verdicts = {seed: ridges_verdict(seed, tmp_path) for seed in range(16)}
    assert faults(verdicts) == {}
    assert {found.status for found in verdicts.values()} == {0, 2}  # otherwise nothing was fitted, or nothing refused


@pytest.mark.long
def test_many_mutated_ridges(tmp_path):
    assert faults({seed: ridges_verdict(seed, tmp_path) for seed in range(16, 1000)}) == {}


@pytest.mark.long
@pytest.mark.parametrize('command', COMMANDS)
def test_many_mutated_scenes(command, tmp_path):
    n = COMMANDS[command]
    assert faults({seed: scene_verdict(seed, command, tmp_path) for seed in range(n, 41 * n)}) == {}


@pytest.mark.long
def test_many_mutated_tables(tmp_path, row):
    assert faults({seed: table_verdict(seed, row, tmp_path) for seed in range(25, 1050)}) == {}


# --- controls: faults that are put into the package are seen -----------------------------------------------------------

def test_control_of_numbers(tmp_path, monkeypatch):
    """A check of numbers that does not know those from 2**64 on, as numpy's does not know such whole numbers, is found out."""
    def of_numpy(value):
        if abs(value) >= 2**64:
            raise TypeError("ufunc 'isfinite' not supported for the input types")
        return np.isfinite(value)

    monkeypatch.setattr(errors, 'isfinite', of_numpy)
    found = faults({seed: scene_verdict(seed, 'check', tmp_path) for seed in range(30)})
    assert any(one.startswith('traceback: TypeError') for of_one in found.values() for one in of_one)


def test_control_of_words(tmp_path, monkeypatch):
    """Refusals that name no key, and those in other people's words, are told from good ones."""
    refusal = main._refusal
    for words, fault in (('a number of the scene is wrong', 'names no key'), ('ufunc of law.a', 'foreign words')):
        monkeypatch.setattr(main, '_refusal', lambda _, words=words: refusal(words))
        found = faults({seed: scene_verdict(seed, 'check', tmp_path) for seed in range(10)})
        assert any(one.startswith(fault) for of_one in found.values() for one in of_one)


def oscillator(folder, monkeypatch, factor):
    """The end of a frequency response that comes out `factor` times too large."""
    receptance = frf.receptance

    def scaled(*arguments):
        found = receptance(*arguments)
        return replace(found, response=found.response * factor)

    with monkeypatch.context() as patched, np.errstate(invalid='ignore'):
        patched.setattr(frf, 'receptance', scaled)
        return verdict('frf', {'my.toml': ready_scene('oscillator').read_bytes()}, folder)


def test_control_of_results(tmp_path, monkeypatch):
    """With the guard of what is written an infinite response is refused; without it, the judge sees infinity in a result."""
    guarded = oscillator(tmp_path, monkeypatch, np.inf)
    assert (guarded.faults, guarded.status) == ([], 2)
    monkeypatch.setattr('magphonon.files.refuse_overflow', lambda *arguments: None)
    assert not oscillator(tmp_path, monkeypatch, 2.0).faults
    assert 'frf.csv holds what is no number' in oscillator(tmp_path, monkeypatch, np.inf).faults


def test_control_of_leftovers(tmp_path, monkeypatch):
    """A command that fails and does not take its files away is seen."""
    monkeypatch.setattr(results.shutil, 'rmtree', lambda folder, **_: None)
    found = oscillator(tmp_path, monkeypatch, np.inf)
    assert found.status == 2
    assert any('behind' in one for one in found.faults)


def test_control_of_time(tmp_path, monkeypatch):
    """A command that does not end is seen."""
    def forever(*arguments):
        while True:
            pass

    monkeypatch.setattr(frf, 'receptance', forever)
    (tmp_path / 'my.toml').write_bytes(ready_scene('oscillator').read_bytes())
    arguments = ['frf', str(tmp_path / 'my.toml'), '-o', str(tmp_path / 'out')]
    assert judge.judged(arguments, [tmp_path / 'my.toml'], tmp_path / 'out', seconds=0.5).faults == [judge.SLOW]
