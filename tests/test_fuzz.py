"""Mutated scenes and tables through the commands: an answer or a refusal in own words, never anything in between.

Ready scenes, made small, are mutated as data and now and then as bytes; the same seed gives the same file.
Forty times as many, other ones:  python -m pytest -n 0 -m long tests/test_fuzz.py
"""

import copy
import json
import math
import random
import re
import shutil
import signal
import tomllib
import warnings
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from dataclasses import replace
from io import StringIO
from pathlib import Path

import matplotlib as mpl
import numpy as np
import pytest
from scene_files import ready_scene

from magphonon import errors
from magphonon.cli import main, uncertainty
from magphonon.response import frf
from magphonon.scenes import band_fits
from magphonon.scenes.scene import Scene, ready_scenes

resource = pytest.importorskip('resource')
pytestmark = pytest.mark.skipif(not Path('/proc/self/statm').exists(), reason='the limit of memory needs to know what is used')

READY = [scene for scene in (tomllib.loads(file.read_text(encoding='utf-8')) for file in ready_scenes().values())
         if 'spacing_m' in scene['lattice']]
"""Those whose particles are no table in a file of its own."""
EXTREMES = [0, 0.0, -1, 1, 2, 2**31, 2**63, 2**64, 10**25, 10**400, -(2**64), 1e300, -1e300, 1e-300, 5e-324, 1e12, 1e-12, 1e18,
            1e9, math.nan, math.inf, -math.inf, True, False, '', ' ', 'x', 'all', 'ALL', 'G', 'GMGMGM', 'nan', '1', 'a\0b',
            'größe 😀', '$\\input{x}$', '$x', '$$', 300 * 'x', 'two\nlines', '/dev/zero', '/dev/null', '.', '../x.csv', [],
            [[]], [1], [1, 2], [0.0, -0.0], [math.nan, 1], [2**70, 3], ['G'], [1e300, 1e-300], {}, {'kind': 'x'}, {'a': {}}]
FACTORS = [-1, 0.1, 10, 1e-3, 1e3, 1e-6, 1e6, 1e-30, 1e30]
NEAR = [0.5, 0.8, 0.99, 1.0001, 1.01, 1.2, 1.5, 2, 3]
"""Factors that leave most scenes what they are, and lead into the depths of a command."""
CELLS = ['', 'x', 'nan', 'inf', '-1', '0', '1e300', '1e-300', '1e400', '0,5', '"a', '"1\n2"', '1' * 200, 'größe', '\0', '0x10',
         '1_0', ' ']
COMMANDS = {'check': 99, 'bands': 8, 'frf': 8, 'uncertainty': 4, 'burst': 4}
"""How many scenes each command gets, 132 in all: most of them those that answer in a moment."""
GENTLE = {'check': 0.1, 'burst': 0.9}
"""Probability that a mutation is a small one, 0.7 for commands that do not stand here: most of their scenes shall be answered."""


# --- scenes and tables as nobody would write them --------------------------------------------------------------------

def small(scene, rng):
    """A ready scene with few points, small patches and short records, which takes a moment."""
    scene, spacing = copy.deepcopy(scene), scene['lattice']['spacing_m']
    sizes = {'bands': {'points': [2, 3, 9]}, 'frf': {'points': [2, 5, 40]},
             'patch': {'cells_1': [9, 13], 'cells_2': [9, 13], 'side_m': [9 * spacing, 11 * spacing],
                       'width_m': [9 * spacing], 'height_m': [11 * spacing]}}
    for table, keys in sizes.items():
        for key in keys.keys() & scene.get(table, {}).keys():
            scene[table][key] = rng.choice(keys[key])
    if 'bands' in scene:
        scene['bands']['supercell'] = [min(n, 3) for n in scene['bands'].get('supercell', (3, 3))]
    if 'burst' in scene:
        burst = scene['burst']
        one = rng.randrange(len(burst['carriers_Hz']))
        for key in burst.keys() & {'carriers_Hz', 'directions_deg'}:
            burst[key] = [burst[key][one]]
        burst['duration_s'] = 1.5 * burst.get('cycles', 5) / burst['carriers_Hz'][0]
    if 'frf' in scene and 'response' in scene['frf']:
        scene['frf']['response']['at_m'] = [0.0, 3 * spacing]
    return scene


def places(data):
    """Every table or list in a scene with each of its keys or indices."""
    steps = data.items() if isinstance(data, dict) else enumerate(data)
    return [(data, step) for step, _ in steps] + [found for _, value in steps if isinstance(value, dict | list)
                                                  for found in places(value)]


def mutate(data, rng, gentle):
    """One change, somewhere; with the probability `gentle` only of a number by a factor near one."""
    where = places(data)
    table, step = rng.choice(where)
    kind = 'near' if rng.random() < gentle else rng.choice(
        ['extreme', 'extreme', 'extreme', 'factor', 'near', 'near', 'delete', 'unknown', 'rename', 'copy'])
    if kind == 'extreme':
        table[step] = copy.deepcopy(rng.choice(EXTREMES))
    elif kind == 'delete':
        del table[step]
    elif kind == 'copy':
        other, name = rng.choice(where)
        table[step] = copy.deepcopy(other[name])
    elif kind == 'unknown' and isinstance(table, dict):
        table[rng.choice(['colour', 'b', 'spacing', 'kindd', 'größe', '', 'a.b'])] = copy.deepcopy(rng.choice(EXTREMES))
    elif kind == 'rename' and isinstance(table, dict):
        table[f'{step}s'] = table.pop(step)
    elif kind in ('factor', 'near'):
        numbers = [(table, step) for table, step in where
                   if isinstance(table[step], int | float) and not isinstance(table[step], bool)]
        table, step = rng.choice(numbers or [({'x': 1}, 'x')])
        with np.errstate(over='ignore'):
            scaled = float(np.float64(min(table[step], 1e308)) * rng.choice(FACTORS if kind == 'factor' else NEAR))
        table[step] = round(scaled) if isinstance(table[step], int) and math.isfinite(scaled) and rng.random() < 0.8 else scaled


def toml(value):
    """A value as TOML."""
    if isinstance(value, dict):
        return '{' + ', '.join(f'{json.dumps(key)} = {toml(item)}' for key, item in value.items()) + '}'
    if isinstance(value, list):
        return '[' + ', '.join(map(toml, value)) + ']'
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False).replace('\x7f', '')


def scene_text(rng, command):
    """A scene file that a command may be asked to read, mutated as data and now and then as bytes."""
    gentle = GENTLE.get(command, 0.7)
    data = small(rng.choice([scene for scene in READY if command not in Scene.model_fields or command in scene]), rng)
    for _ in range(rng.choice([0, 1, 1, 1, 2, 3])):
        mutate(data, rng, gentle)
    text = ''.join(f'{json.dumps(key)} = {toml(value)}\n' for key, value in data.items()).encode()
    return damaged(text, rng) if rng.random() < 0.06 * (1 - gentle) else text


def damaged(text, rng):
    """The bytes of a file that was cut off, doubled, or otherwise spoilt."""
    at = rng.randrange(len(text) + 1)
    return rng.choice([
        lambda: text[:at], lambda: text + text, lambda: b'\xef\xbb\xbf' + text, lambda: text[:at] + b'\xff\x00' + text[at:],
        lambda: b'x = ' + 1000 * b'[' + 1000 * b']' + b'\n' + text, lambda: text.replace(b'\n', b'\r\n'), lambda: b'',
        lambda: text.decode().encode('utf-16'), lambda: text.replace(b'.', b',', 1)])()


def forces(rng):
    """A table of forces that follow an inverse power with some noise."""
    a, n, noise = rng.uniform(2, 6), rng.choice([1, 2, 3, 4, 5, 9, 20]), rng.choice([0, 1e-3, 0.1])
    rows = [[f'{x:.6g}', f'{0.2 * (x / 0.01) ** -a * (1 + noise * rng.uniform(-1, 1)):.6g}']
            for x in np.linspace(0.008, 0.015, n)]
    more = rng.random() < 0.4
    return [['r_m', 'f_N'] + ['sigma_N'] * more, *(row + ['1e-3'] * more for row in rows)]


def ridges(rng):
    """A table of few or many ridges, of the prototype or of other frequencies and wavenumbers."""
    n, points = rng.choice([1, 2, 2, 4, 100]), rng.choice([1, 3, 8])
    wide, high = rng.choice([1, 1, 1, 1, 5, 1e-3]), rng.choice([1, 1, 1, 1, 10, 1e-3, 1e3])
    rows = []
    for ridge in range(n):
        for xi in wide * (0.5 + 2 * np.arange(points) / points):
            rows.append([f'{ridge}', ('transverse', 'longitudinal', 'x')[ridge % 3], f'{xi:.6g}', rng.choice(['0.01', '0']),
                         f'{high * (30 + 15 * xi + 5 * (ridge % 3)):.6g}', '0.05', '0', f'{xi / 6.2831853:.6g}'])
    return [['record', 'motion', 'xi_rad', 'sigma_xi_rad', 'frequency_Hz', 'sigma_frequency_Hz', 'q1', 'q2'], *rows]


def table_text(table, rng):
    """The table in bytes, after none, one or two changes."""
    header, *rows = table
    for _ in range(rng.choice([0, 1, 1, 2])):
        row, power = rng.choice([header, *rows]), rng.choice([-300, -9, -6, -3, 3, 6, 9, 300])
        k = rng.randrange(len(row))
        kind = rng.choice(['cell', 'cell', 'factor', 'row', 'column', 'double', 'scale'])
        if kind == 'cell':
            row[k] = rng.choice(CELLS)
        elif kind == 'factor' and row is not header:
            row[k] = f'{row[k]}e{power}'
        elif kind == 'row' and rows:
            del rows[rng.randrange(len(rows))]
        elif kind == 'column' and len(row) > 1:
            del row[-1]
        elif kind == 'double' and rows:
            rows.append(list(rng.choice(rows)))
        elif kind == 'scale':
            for one in rows:
                one[min(k, len(one) - 1)] += f'e{power}'
    text = '\n'.join(','.join(row) for row in [header, *rows]).encode() + b'\n'
    return damaged(text, rng) if rng.random() < 0.1 else text


# --- the judge -------------------------------------------------------------------------------------------------------

NAMED = re.compile(rf'(?<![\w.])(({"|".join(Scene.model_fields)})(\.\w|\[| has | lacks | must | names |:)|title)'
                   rf'|\[({"|".join(Scene.model_fields)})[\].]|--\w|no key|lacks the|is not TOML|is not a scene|in the law')
"""What a refusal of a scene says beyond the name of the file: a key, a table or an option, or that it is none."""
FOREIGN = re.compile(r'Traceback|pydantic|numpy|np\.float|ufunc|dtype|NoneType|zip\(\)|SVD|did not converge|Optimal parameters'
                     r'|allowed size|object at|Errno|ParseFatal'
                     r'|codec|index \d|out of bounds|broadcast|singular matrix|cannot convert|Number of rows|array\(')
"""What other people's complaints look like."""
NOT_A_NUMBER = re.compile(r'(?<![A-Za-z])(nan|inf)(?![A-Za-z])', re.IGNORECASE)
SLOW = 'no answer in time'


class TooSlow(BaseException):
    """No answer within the time of a case; no Exception, which a command might take for its own."""


@contextmanager
def limits(seconds, memory=3 * 2**30):
    """Time of the processor, which other processes on the machine do not shorten, and memory beyond what the process has."""
    def strike(*_):
        raise TooSlow

    present = int(Path('/proc/self/statm').read_text().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGPROF, strike)
    signal.setitimer(signal.ITIMER_PROF, seconds)
    resource.setrlimit(resource.RLIMIT_AS, (present + memory, hard))
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGPROF, before)


def judged(arguments, inputs, out, seconds=20):
    """Run a command on these files, the scene or the table last, and judge how it ends: its faults, and its exit status."""
    said, complaints = StringIO(), StringIO()
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter('always')
        try:
            with limits(seconds), redirect_stdout(said), redirect_stderr(complaints):
                status = main.main(arguments)
        except TooSlow:
            return [SLOW], None
        except SystemExit as ended:
            status = ended.code
        except BaseException as error:
            return [f'traceback: {type(error).__name__}: {str(error)[:200]}'], None
    faults = [f'warning: {one.message}'[:200] for one in warned if issubclass(one.category, RuntimeWarning)]
    if status not in (0, 2) and (status != 1 or arguments[0] != 'check'):
        faults.append(f'exit status {status}')
    if status == 2:
        faults += unclear(complaints.getvalue(), inputs)
        if out.exists():
            faults.append(f'left {sorted(file.name for file in out.iterdir())} behind')
    else:
        faults += ['nan or inf in the report'] * bool(NOT_A_NUMBER.search(said.getvalue()))
        # NaN beside std_ says that a frequency of zero has no slope
        faults += [f'{file.name} holds what is no number' for file in out.rglob('*') if file.suffix in ('.csv', '.txt', '.yaml')
                   and not file.name.startswith('band_uncertainty') and NOT_A_NUMBER.search(file.read_text(encoding='utf-8'))]
    return faults, status


def unclear(error, inputs):
    """What a refusal lacks: own words, and the file or, where it is a scene, the key, the table or the option at fault."""
    faults = [] if 'magphonon' in error else [f'no message: {error[:200]!r}']
    if found := FOREIGN.search(error):
        faults.append(f'foreign words {found.group()!r}: {error[:300]}')
    *tables, last = inputs
    if any(str(file) in error for file in tables):
        return faults
    try:
        tomllib.loads(last.read_text(encoding='utf-8-sig'))
    except (ValueError, RecursionError):
        return faults + [f'names no file: {error[:300]}'] * (str(last) not in error)
    return faults + [f'names no key: {error[:300]}'] * (last.suffix == '.toml' and not NAMED.search(error.replace(str(last), '')))


def verdict(command, files, folder, output=True, between=()):
    """The judge's verdict on a command that reads files of these contents, a dict of name to bytes, the scene last."""
    desk = Path(folder) / 'desk'
    shutil.rmtree(desk, ignore_errors=True)
    desk.mkdir()
    for name, content in files.items():
        (desk / name).write_bytes(content)
    inputs, out = [desk / name for name in files], desk / 'out'
    arguments = [command, *map(str, inputs[:-1]), *between, str(inputs[-1])]
    if output and command != 'check':
        arguments += ['-o', str(out)]
    return judged(arguments, inputs, out)


@pytest.fixture(autouse=True)
def cheap(monkeypatch, tmp_path):
    """Pictures are drawn all the same, with few pixels; fewer lattices are drawn at random, and fewer ridges are suspected: the
    limits of time are for commands that hang, on slow processors too.
    """
    monkeypatch.chdir(tmp_path)  # where a design of sites writes what it found
    monkeypatch.setitem(mpl.rcParams, 'savefig.dpi', 20)
    monkeypatch.setattr(uncertainty, 'SAMPLES', 20)
    monkeypatch.setattr(band_fits, 'SUSPECTS', 1)


# --- what is tried ---------------------------------------------------------------------------------------------------

def many(verdict_of, seeds):
    """The faults by seed, and the exit statuses."""
    found = {seed: verdict_of(seed) for seed in seeds}
    return {seed: faults for seed, (faults, _) in found.items() if faults}, [status for _, status in found.values()]


def scenes(command, folder):
    def one(seed):
        rng = random.Random(f'{command} {seed}')  # noqa: S311, nothing secret
        return verdict(command, {'my.toml': scene_text(rng, command)}, folder)
    return one


def tables(kind, folder):
    def one(seed):
        rng, pictures = random.Random(f'{kind.__name__} {seed}'), seed % 8 == 0  # noqa: S311, nothing secret; pictures take long
        files = {f'{kind.__name__}.csv': table_text(kind(rng), rng)}
        if kind is forces:
            return verdict('fit', files, folder, pictures)
        return verdict('fit', files | {'my.toml': ready_scene('bench').read_bytes()}, folder, pictures, ['--bands'])
    return one


@pytest.mark.slow
@pytest.mark.parametrize('command', COMMANDS)
def test_mutated_scenes(command, tmp_path):
    faults, status = many(scenes(command, tmp_path), range(COMMANDS[command]))
    assert faults == {}
    assert sum(one in (0, 1) for one in status) >= len(status) / 8  # otherwise nothing but the reading of scenes was tried


@pytest.mark.slow
@pytest.mark.parametrize('kind', [forces, ridges])
def test_mutated_tables(kind, tmp_path):
    faults, status = many(tables(kind, tmp_path), range(20))
    assert faults == {}
    assert set(status) == {0, 2}  # otherwise nothing was fitted, or nothing refused


@pytest.mark.long
@pytest.mark.parametrize('command', [*COMMANDS, forces, ridges])
def test_many(command, tmp_path):
    if callable(command):
        assert many(tables(command, tmp_path), range(20, 1000))[0] == {}
    else:
        assert many(scenes(command, tmp_path), range(COMMANDS[command], 41 * COMMANDS[command]))[0] == {}


# --- controls: faults that are put into the package are seen -----------------------------------------------------------

@pytest.mark.slow
def test_control_of_numbers_and_words(tmp_path, monkeypatch):
    """A check of numbers that fails from 2**64 on, as numpy's does, and refusals that name no key, or in other people's words."""
    def of_numpy(value):
        if abs(value) >= 2**64:
            raise TypeError("ufunc 'isfinite' not supported for the input types")
        return np.isfinite(value)

    with monkeypatch.context() as patch:
        patch.setattr(errors, 'isfinite', of_numpy)
        found, _ = many(scenes('check', tmp_path), range(30))
    assert any(one.startswith('traceback: TypeError') for of_one in found.values() for one in of_one)
    refusal = main._refusal
    for words, fault in (('a number of the scene is wrong', 'names no key'), ('ufunc of law.a', 'foreign words')):
        monkeypatch.setattr(main, '_refusal', lambda _, words=words: refusal(words))
        found, _ = many(scenes('check', tmp_path), range(10))
        assert any(one.startswith(fault) for of_one in found.values() for one in of_one)


def test_control_of_results_and_time(tmp_path, monkeypatch):
    """With the guard of what is written an infinite response is refused; without it, infinity is seen; so is what never ends."""
    receptance = frf.receptance

    def scaled(*arguments):
        found = receptance(*arguments)
        return replace(found, response=found.response * np.inf)

    oscillator = {'my.toml': ready_scene('oscillator').read_bytes()}
    with np.errstate(invalid='ignore'):
        monkeypatch.setattr(frf, 'receptance', scaled)
        assert verdict('frf', oscillator, tmp_path) == ([], 2)
        for guard in ('magphonon.files.refuse_overflow', 'magphonon.results.refuse_overflow'):
            monkeypatch.setattr(guard, lambda *arguments: None)
        assert 'frf.csv holds what is no number' in verdict('frf', oscillator, tmp_path)[0]

    def forever(*arguments):
        while True:
            pass

    monkeypatch.setattr(frf, 'receptance', forever)
    file = tmp_path / 'desk' / 'my.toml'
    assert judged(['frf', str(file), '-o', str(tmp_path / 'new')], [file], tmp_path / 'new', seconds=0.5) == ([SLOW], None)
