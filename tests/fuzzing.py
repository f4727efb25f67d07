"""Scenes and tables as nobody would write them, drawn with a `random.Random`: the same seed gives the same file.

Scenes are drawn from the JSON schema of `Scene` itself, with values that its ready scenes give to each key, or are ready
scenes made small; both are then mutated.
"""

import copy
import json
import math
import tomllib

import numpy as np

from magphonon.scenes.scene import Scene, ready_scenes

SCHEMA = Scene.model_json_schema()
READY = [tomllib.loads(file.read_text(encoding='utf-8')) for file in ready_scenes().values()]
EXTREMES = [0, 0.0, -1, 1, 2, 2**31, 2**63, 2**64, 10**25, 10**400, -(2**64), 1e300, -1e300, 1e-300, 5e-324, 1e12, 1e-12, 1e18,
            1e9, math.nan, math.inf, -math.inf, True, False, '', ' ', 'x', 'all', 'ALL', 'G', 'GMGMGM', 'nan', '1', 'a\0b',
            'größe 😀', '$\\input{x}$', '$x', '$$', 300 * 'x', 'two\nlines', '/dev/zero', '/dev/null', '.', '../x.csv', [],
            [[]], [1], [1, 2], [0.0, -0.0], [math.nan, 1], [2**70, 3], ['G'], [1e300, 1e-300], {}, {'kind': 'x'}, {'a': {}}]
FACTORS = [-1, 0.1, 10, 1e-3, 1e3, 1e-6, 1e6, 1e-30, 1e30]
NEAR = [0.5, 0.8, 0.99, 1.0001, 1.01, 1.2, 1.5, 2, 3]
"""Factors that leave most scenes what they are, and lead into the depths of a command."""


# --- scenes ----------------------------------------------------------------------------------------------------------

def resolved(schema):
    """The schema to which a reference leads."""
    while '$ref' in schema:
        schema = SCHEMA['$defs'][schema['$ref'].rsplit('/', 1)[1]]
    return schema


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
    return found


VALUES = values_by_key()


def drawn(schema, key, rng):
    """A value of a schema: one that a ready scene gives to its key, where there is one."""
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


def small(scene, rng):
    """A ready scene with few points, small patches and short records, which takes a moment."""
    scene, spacing = copy.deepcopy(scene), scene['lattice']['spacing_m']
    sizes = {'bands': {'points': [2, 3, 9]}, 'frf': {'points': [2, 5, 40]},
             'patch': {'cells_1': [6, 9], 'cells_2': [6, 9], 'side_m': [6 * spacing, 9 * spacing],
                       'width_m': [7 * spacing], 'height_m': [9 * spacing]}}
    for table, keys in sizes.items():
        for key in keys.keys() & scene.get(table, {}).keys():
            scene[table][key] = rng.choice(keys[key])
    if 'bands' in scene:
        scene['bands']['supercell'] = [min(n, 3) for n in scene['bands']['supercell']]
    if 'burst' in scene:
        one = rng.randrange(len(scene['burst']['carriers_Hz']))
        for key in ('carriers_Hz', 'directions_deg'):
            scene['burst'][key] = [scene['burst'][key][one]]
        scene['burst']['duration_s'] = 1.5 * scene['burst']['cycles'] / scene['burst']['carriers_Hz'][0]
    if 'frf' in scene and 'response' in scene['frf']:
        scene['frf']['response']['at_m'] = [0.0, 3 * spacing]
    return scene


def scene_data(rng, command, share_drawn=0.3):
    """A scene that is mostly right, as TOML reads it: drawn from the schema, or a ready one with the table of the command."""
    if rng.random() < share_drawn:
        return drawn(SCHEMA, 'scene', rng)
    fit = [scene for scene in READY if command not in SCHEMA['properties'] or command in scene]
    return small(rng.choice(fit), rng)


def places(data):
    """Every table or list in a scene with each of its keys or indices."""
    steps = data.items() if isinstance(data, dict) else enumerate(data)
    return [(data, step) for step, _ in steps] + [found for _, value in steps if isinstance(value, dict | list)
                                                  for found in places(value)]


def mutate(data, rng, gentle=0.0):
    """One change, somewhere; with the probability `gentle` only of a number by a factor near one."""
    where = places(data)
    if not where:
        data['title'] = 'x'
        return
    table, step = rng.choice(where)
    kind = 'near' if rng.random() < gentle else rng.choice(
        ['extreme', 'extreme', 'extreme', 'factor', 'near', 'near', 'delete', 'unknown', 'rename', 'copy'])
    if kind == 'extreme':
        table[step] = copy.deepcopy(rng.choice(EXTREMES))
    elif kind in ('factor', 'near'):
        scale(where, rng.choice(FACTORS if kind == 'factor' else NEAR), rng)
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


def scale(where, factor, rng):
    """Multiply one of the numbers; a whole one mostly stays whole."""
    numbers = [(table, step) for table, step in where
               if isinstance(table[step], int | float) and not isinstance(table[step], bool)]
    if not numbers:
        return
    table, step = rng.choice(numbers)
    try:
        scaled = table[step] * factor
    except OverflowError:  # a whole number that no float holds
        scaled = math.inf
    whole = isinstance(table[step], int) and math.isfinite(scaled) and rng.random() < 0.8
    table[step] = round(scaled) if whole else scaled


def toml(value):
    """A value as TOML."""
    if isinstance(value, dict):
        return '{' + ', '.join(f'{json.dumps(key)} = {toml(item)}' for key, item in value.items()) + '}'
    if isinstance(value, list):
        return '[' + ', '.join(map(toml, value)) + ']'
    if isinstance(value, int) and not isinstance(value, bool):
        return str(value)
    return repr(value) if isinstance(value, float) else json.dumps(value, ensure_ascii=False).replace('\x7f', '')


def scene_text(rng, command, gentle=0.0):
    """A scene file that a command may be asked to read, mutated as data and now and then as bytes.

    `gentle` is the probability that a mutation only changes a number a little; such scenes are mostly answered.
    """
    data = scene_data(rng, command, share_drawn=0.3 * (1 - gentle))
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


def ridge_table(rng):
    """A table of ridges for `fit --bands`, mutated: few or many, of the prototype or of other frequencies and wavenumbers."""
    ridges, points = rng.choice([1, 2, 2, 4, 100]), rng.choice([1, 3, 8])
    scale_xi, scale_Hz = rng.choice([1, 1, 1, 1, 5, 1e-3]), rng.choice([1, 1, 1, 1, 10, 1e-3, 1e3])
    header = ['record', 'motion', 'xi_rad', 'sigma_xi_rad', 'frequency_Hz', 'sigma_frequency_Hz', 'q1', 'q2']
    rows = []
    for ridge in range(ridges):
        for k in range(points):
            xi = scale_xi * (0.5 + 2 * k / points)
            rows.append([f'{ridge}', ('transverse', 'longitudinal', 'x')[ridge % 3], f'{xi:.6g}', rng.choice(['0.01', '0']),
                         f'{scale_Hz * (30 + 15 * xi + 5 * (ridge % 3)):.6g}', '0.05', '0', f'{xi / 6.2831853:.6g}'])
    return table_text(header, rows, rng)


def table_text(header, rows, rng):
    """The table in bytes, after none, one or two changes."""
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
