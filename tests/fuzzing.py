"""Scenes and tables as nobody would write them, and a judge of what a command makes of them.

Scenes are drawn from the JSON schema of `Scene` itself, with values that its ready scenes give to each key, and then mutated.
"""

import copy
import csv
import json
import math
import re
import signal
import tomllib
import warnings
from contextlib import contextmanager, redirect_stderr, redirect_stdout
from importlib.resources import files
from io import StringIO

import numpy as np

from magphonon import cli
from magphonon.scenes import Scene, ready_scenes

SCHEMA = Scene.model_json_schema()
READY = [tomllib.loads(file.read_text(encoding='utf-8')) for file in ready_scenes().values()]

SMALL = {'points': [2, 5, 9], 'supercell': [[3, 3], [3], [3, 3, 3]], 'duration_s': [0.12, 0.2, 30.0], 'cells_1': [7, 12],
         'cells_2': [7, 12], 'side_m': [0.06, 0.1, 6.0], 'width_m': [0.1], 'height_m': [0.1, 0.15, 0.003], 'cycles': [2, 5],
         'sampling_rate_Hz': [200, 1000], 'noise_m': [0.0, 5e-9], 'carriers_Hz': [[40.0], [60, 50]],
         'directions_deg': [[90.0], [0, 90]], 'kind': ['parallelogram', 'rectangle', 'hexagon', 'half_hexagon', 'chain', 'square',
                                                       'kagome', 'bcc', 'hertz', 'table', 'magnets', 'dipoles', 'coulomb']}
"""Values in place of those of the ready scenes: small structures, which take a moment."""

EXTREMES = [0, 0.0, -1, 1, 2, 2**31, 2**63, 2**64, 10**25, 10**400, -(2**64), 1e300, -1e300, 1e-300, 5e-324, 1e12, 1e-12, 1e18,
            1e9, math.nan, math.inf, -math.inf, True, False, '', ' ', 'x', 'all', 'ALL', 'G', 'GMGMGM', 'nan', '1', 'a\0b',
            'größe 😀', '$\\input{x}$', '$x', '$$', 300 * 'x', 'two\nlines', '/dev/zero', '/dev/null', '.', '../x.csv', [],
            [[]], [1], [1, 2], [0.0, -0.0], [math.nan, 1], [2**70, 3], ['G'], [1e300, 1e-300], {}, {'kind': 'x'}, {'a': {}}]
FACTORS = [-1, 0.1, 10, 1e-3, 1e3, 1e-6, 1e6, 1e-30, 1e30, 1.0001, 0.5, 3]

FOREIGN = re.compile(r'Traceback|pydantic|numpy|np\.float|ufunc|dtype|NoneType|zip\(\)|SVD|converge|allowed size|object at|Errno'
                     r'|ParseFatal|codec|index \d|out of bounds|broadcast|singular matrix|cannot convert|Number of rows|array\(')
"""What other people's complaints look like."""
DOCUMENTED = {0, 1, 2}
NOT_A_NUMBER = re.compile(r'(?<![A-Za-z])(nan|inf)(?![A-Za-z])', re.IGNORECASE)


def resolved(schema):
    while '$ref' in schema:
        schema = SCHEMA['$defs'][schema['$ref'].rsplit('/', 1)[1]]
    return schema


def keys_of(schema=SCHEMA):
    """All keys of all tables."""
    return {key for table in [schema, *schema['$defs'].values()] for key in table.get('properties', {})}


def values_by_key():
    """What the ready scenes give to each key."""
    found = {}

    def visit(table):
        for key, value in table.items():
            if isinstance(value, dict):
                visit(value)
            else:
                found.setdefault(key, []).append(value)

    for scene in READY:
        visit(scene)
    return found | SMALL


VALUES = values_by_key()
KEYS = keys_of()


def drawn(schema, key, rng):
    """A value of a schema: sensible ones for its key where some are known."""
    schema = resolved(schema)
    if 'const' in schema:
        return schema['const']
    if 'enum' in schema:
        return rng.choice(schema['enum'])
    choices = [one for one in schema.get('oneOf', schema.get('anyOf', [])) if resolved(one).get('type') != 'null']
    if any(resolved(one).get('type') == 'object' for one in choices):
        return drawn(rng.choice(choices), key, rng)
    if schema.get('type') == 'object':
        optional = 0.3 if schema is not SCHEMA else 0.5
        return {name: drawn(field, name, rng) for name, field in schema['properties'].items()
                if name in schema.get('required', ()) or rng.random() < optional}
    if key in VALUES:
        return copy.deepcopy(rng.choice(VALUES[key]))
    return {'integer': 3, 'string': 'x', 'array': [1.0, 2.0], 'boolean': True}.get(schema.get('type'), 1e-3)


def shrunk(table, rng):
    """A ready scene with small sizes."""
    return {key: shrunk(value, rng) if isinstance(value, dict) else
            rng.choice(SMALL[key]) if key in SMALL and key not in ('kind', 'supercell') and rng.random() < 0.9 else value
            for key, value in table.items()}


def scene_data(rng):
    """A scene that is mostly right, as TOML reads it."""
    if rng.random() < 0.3:
        return drawn(SCHEMA, 'scene', rng)
    return shrunk(copy.deepcopy(rng.choice(READY)), rng)


def places(data):
    """Every table or list in a scene with each of its keys or indices."""
    steps = data.items() if isinstance(data, dict) else enumerate(data)
    return [(data, step) for step, _ in steps] + [found for _, value in steps if isinstance(value, dict | list)
                                                  for found in places(value)]


def mutate(data, rng):
    """One change, somewhere."""
    where = places(data)
    if not where:
        data['title'] = 'x'
        return
    table, step = rng.choice(where)
    kind = rng.choice(['extreme', 'extreme', 'extreme', 'factor', 'factor', 'delete', 'unknown', 'rename', 'copy'])
    if kind == 'extreme':
        table[step] = copy.deepcopy(rng.choice(EXTREMES))
    elif kind == 'factor':
        numbers = [(t, s) for t, s in where if isinstance(t[s], int | float) and not isinstance(t[s], bool)]
        if numbers:
            table, step = rng.choice(numbers)
            factor = rng.choice(FACTORS)
            try:
                scaled = table[step] * factor
            except OverflowError:
                scaled = math.inf
            whole = isinstance(table[step], int) and math.isfinite(scaled) and rng.random() < 0.8
            table[step] = round(scaled) if whole else scaled
    elif kind == 'delete':
        del table[step]
    elif kind == 'copy':
        other, name = rng.choice(where)
        table[step] = copy.deepcopy(other[name])
    elif isinstance(table, dict):
        if kind == 'unknown':
            table[rng.choice(['colour', 'b', 'spacing', 'kindd', 'größe', '', 'a.b'])] = copy.deepcopy(rng.choice(EXTREMES))
        else:
            table[f'{step}s'] = table.pop(step)


def toml(value):
    """A value as TOML."""
    if isinstance(value, dict):
        return '{' + ', '.join(f'{json.dumps(key)} = {toml(item)}' for key, item in value.items()) + '}'
    if isinstance(value, list):
        return '[' + ', '.join(map(toml, value)) + ']'
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False).replace('\x7f', '')


def scene_text(rng):
    """A command and a scene file, mutated as data and now and then as bytes."""
    data = scene_data(rng)
    wanted = [table for table in ('bands', 'design', 'frf', 'burst', 'uncertainty') if table in data]
    command = rng.choice(['check', 'check', *wanted, *wanted, 'plan'])
    for _ in range(rng.choice([0, 1, 1, 1, 2, 3])):
        mutate(data, rng)
    text = ''.join(f'{json.dumps(key)} = {toml(value)}\n' for key, value in data.items()).encode()
    return command, damaged(text, rng) if rng.random() < 0.06 else text


def damaged(text, rng):
    """The bytes of a file that was cut off, doubled, or otherwise spoilt."""
    at = rng.randrange(len(text) + 1)
    return rng.choice([
        lambda: text[:at], lambda: text + text, lambda: b'\xef\xbb\xbf' + text, lambda: text[:at] + b'\xff\x00' + text[at:],
        lambda: b'x = ' + 1000 * b'[' + 1000 * b']' + b'\n' + text, lambda: text.replace(b'\n', b'\r\n'), lambda: b'',
        lambda: text.decode().encode('utf-16'), lambda: text.replace(b'.', b',', 1)])()


# --- tables of numbers -----------------------------------------------------------------------------------------------

CELLS = ['', 'x', 'nan', 'inf', '-1', '0', '1e300', '1e-300', '1e400', '0,5', '"a', '"1\n2"', '1' * 200, 'größe', '\0', '0x10',
         '1_0', ' ']


def force_table(rng):
    """A table of forces for `fit`, mutated."""
    a, n, noise = rng.uniform(2, 6), rng.choice([1, 2, 3, 4, 5, 9, 20]), rng.choice([0, 1e-3, 0.1])
    r = np.linspace(0.008, 0.015, n)
    rows = [[f'{x:.6g}', f'{0.2 * (x / 0.01) ** -a * (1 + noise * rng.uniform(-1, 1)):.6g}'] for x in r]
    header = ['r_m', 'f_N']
    if rng.random() < 0.4:
        header, rows = [*header, 'sigma_N'], [[*row, '1e-3'] for row in rows]
    return table_text(header, rows, rng)


def displacement_table(rng, particles):
    """A table of displacements for `spectrum`, mutated: a wave along the particles of a row."""
    frames, dt = rng.choice([2, 10, 60]), 1e-3
    rows = [[f'{k * dt:.9g}', str(particle), f'{1e-7 * math.sin(0.25 * k - 0.6 * n):.6g}', f'{1e-7 * math.cos(0.3 * k - n):.6g}']
            for k in range(frames) for n, particle in enumerate(particles)]
    return table_text(['time_s', 'particle', 'u_x_m', 'u_y_m'], rows, rng)


def table_text(header, rows, rng):
    for _ in range(rng.choice([0, 1, 1, 2])):
        row = rng.choice([header, *rows])
        kind = rng.choice(['cell', 'cell', 'factor', 'row', 'column', 'double', 'scale'])
        if kind == 'cell' and row:
            row[rng.randrange(len(row))] = rng.choice(CELLS)
        elif kind == 'factor' and row and row is not header:
            k = rng.randrange(len(row))
            row[k] = f'{row[k]}e{rng.choice([-300, -9, -3, 3, 9, 300])}'
        elif kind == 'row' and rows:
            del rows[rng.randrange(len(rows))]
        elif kind == 'column' and row:
            del row[-1]
        elif kind == 'double' and rows:
            rows.append(list(rng.choice(rows)))
        elif kind == 'scale':
            k, power = rng.randrange(len(header) or 1), rng.choice([-300, -6, -3, 3, 6, 300])
            for one in rows:
                if k < len(one):
                    one[k] = f'{one[k]}e{power}'
    text = '\n'.join(','.join(row) for row in [header, *rows]).encode() + b'\n'
    return damaged(text, rng) if rng.random() < 0.1 else text


# --- the judge -------------------------------------------------------------------------------------------------------

class TooSlow(BaseException):
    """No answer within the time of a case; no Exception, which a command might take for its own."""


@contextmanager
def limits(seconds, memory):
    """Time of the wall, and memory beyond that which the process has."""
    import resource

    def strike(*_):
        raise TooSlow

    with open('/proc/self/statm') as statm:
        present = int(statm.read().split()[0]) * resource.getpagesize()
    soft, hard = resource.getrlimit(resource.RLIMIT_AS)
    before = signal.signal(signal.SIGALRM, strike)
    signal.alarm(seconds)
    resource.setrlimit(resource.RLIMIT_AS, (present + memory, hard))
    try:
        yield
    finally:
        signal.alarm(0)
        resource.setrlimit(resource.RLIMIT_AS, (soft, hard))
        signal.signal(signal.SIGALRM, before)


def verdict(arguments, inputs, out, seconds=120, memory=3 * 2**30):
    """Run a command in this process, and say what is wrong with how it ends: a list of texts, empty for a sound one.

    Parameters
    ----------
    arguments : list of str
    inputs : list of pathlib.Path
        Its files; a message must name one of them, or a key or a table of a scene.
    out : pathlib.Path
        The directory of its results, in a directory of its own.
    """
    said, complaints, wrong = StringIO(), StringIO(), []
    with warnings.catch_warnings(record=True) as warned:
        warnings.simplefilter('always')
        try:
            with limits(seconds, memory), redirect_stdout(said), redirect_stderr(complaints):
                status = cli.main(arguments)
        except TooSlow:
            return [f'no answer in {seconds} s'], None
        except SystemExit as ended:
            status = ended.code
        except BaseException as error:
            return [f'traceback: {type(error).__name__}: {str(error)[:200]}'], None
    wrong += [f'warning: {one.message}'[:200] for one in warned if issubclass(one.category, RuntimeWarning)]
    error = complaints.getvalue()
    if status not in DOCUMENTED or (status == 1 and arguments[0] != 'check'):
        wrong.append(f'exit status {status}')
    if status == 2:
        wrong += unclear(error, inputs, out)
    elif NOT_A_NUMBER.search(re.sub('speed of sound.*', '', said.getvalue(), flags=re.DOTALL)):
        wrong.append('nan or inf in the report')
    if status == 0:
        wrong += [f'{file.name} holds what is no number' for file in out.rglob('*') if holds_no_number(file)]
    elif out.exists() and any(out.iterdir()):
        wrong.append(f'left {sorted(file.name for file in out.iterdir())} behind')
    wrong += [f'left {file.name} behind' for file in out.parent.rglob('*partial*')]
    return wrong, status


def unclear(error, inputs, out):
    """What a message lacks."""
    found = FOREIGN.search(error)
    named = any(str(file) in error for file in (*inputs, out)) or any(
        re.search(rf'(?<![A-Za-z_]){re.escape(name)}(?![A-Za-z_])', error) for name in KEYS)
    return ([f'foreign words {found.group()!r}: {error[:300]}'] if found else []) + (
        [] if named else [f'names neither key nor file: {error[:300]}']) + (
        [] if 'magphonon: ' in error else [f'no message: {error[:200]!r}'])


def holds_no_number(file):
    """Whether a result holds NaN or infinity."""
    if file.suffix == '.npz':
        with np.load(file) as arrays:
            return any(np.issubdtype(array.dtype, np.inexact) and not np.isfinite(array).all() for array in arrays.values())
    if file.suffix == '.csv':
        with open(file, newline='', encoding='utf-8') as lines:
            return any(NOT_A_NUMBER.fullmatch(cell.strip().lstrip('+-')) for row in csv.reader(lines) for cell in row)
    return file.suffix in ('.txt', '.yaml') and bool(NOT_A_NUMBER.search(file.read_text(encoding='utf-8')))


def data_file(name):
    return files('magphonon.data').joinpath(name)
