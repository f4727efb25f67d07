"""What is wrong is refused by name: each argument of each public function is given wrong values, in every command and key too.

A call gets one argument that cannot be right, all others are.  It must raise a ValueError or TypeError of this package, such as a
PhysicsError, whose words name the argument or show its value; it must not return, and no other error may shine through.
"""

import copy
import inspect
import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

import magphonon as mp
from magphonon import interactions, lattices, response, waves
from magphonon.bands import group_velocities
from magphonon.cli.main import COMMANDS, main, parser_of
from magphonon.errors import PhysicsError
from magphonon.scenes.scene import read_scene, ready_scenes, scene_of
from magphonon.stiffness import AllNeighbours

NAN, INF = float('nan'), float('inf')
PACKAGE = Path(mp.__file__).parent
LAW = mp.InversePower(b=1.0, a=4.0)


@cache
def cell():
    atoms = lattices.triangular(1.0, 1.0)
    atoms.calc = mp.MagneticRepulsion(atoms, LAW, foundation=1.0)
    return atoms


@cache
def turning():
    atoms = lattices.triangular(1.0, 1.0)
    atoms.calc = mp.MagneticRepulsion(atoms, LAW, foundation=1.0, gyration=0.5)
    return atoms


@cache
def patch():
    atoms = lattices.hexagon(cell(), 3.0)
    atoms.calc = mp.MagneticRepulsion(atoms, LAW, foundation=6.0)
    return atoms


@cache
def phonon():
    return mp.finite_displacements(cell())


@cache
def forces():
    return interactions.force_tables.synthetic_forces(mp.InversePower(2000.0, 4.0), np.linspace(8, 15, 8), 1e-3, seed=0)


# --- wrong values ----------------------------------------------------------------------------------------------------

NUMBER = [NAN, INF, -INF, 'x', None, [1.0, 2.0], 1j, 10**400, object()]
POSITIVE = [*NUMBER, -1.0, 0.0]
NOT_NEGATIVE = [*NUMBER, -1.0]
WHOLE = [NAN, INF, 2.5, -1, 0, 'x', None, [1], 2**64]
INDEX = [[-1], [10**6], [0.5], 'x', [NAN]]
VECTOR = [[NAN, 1.0], [1.0, INF], [0.0, 0.0], 'x', [[1.0]], [], 5.0]
Q = [[[NAN, 0.0, 0.0]], [[0.0, INF, 0.0]], [[0.25, 0.5]], 'GMK', [[['x']]]]
COLUMN = [[NAN, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, INF], 'x', [[1.0], [2.0, 3.0]]]
CHOICE = ['no such', 7]
ATOMS = [lattices.triangular(1.0, 1.0)]  # without a calculator
NOT_PLANAR = [lattices.chain(1.0, 1.0)]
LAWS = [4.5, 'x', object()]
PATH = [4.5, 'GQ', [[NAN, 0, 0]], ['G', 'M']]

CALLS = {  # a function, its right arguments, and wrong values of each
    'InversePower': (mp.InversePower, {'b': (1.0, POSITIVE), 'a': (4.0, POSITIVE)}),
    'Yukawa': (mp.interactions.Yukawa, {'c': (1.0, POSITIVE), 'kappa': (1.0, POSITIVE)}),
    'Spring': (mp.interactions.Spring, {'k': (1.0, POSITIVE), 'L0': (1.0, NOT_NEGATIVE)}),
    'Cable': (mp.interactions.Cable, {'k': (1.0, POSITIVE), 'L0': (1.0, NOT_NEGATIVE)}),
    'Hertz': (mp.interactions.Hertz, {'stiffness': (1.0, POSITIVE), 'diameter': (1.0, POSITIVE)}),
    'Ring': (mp.interactions.Ring, {'outer': (5.0, POSITIVE), 'inner': (2.0, NOT_NEGATIVE), 'height': (3.0, POSITIVE),
                        'remanence': (1.0, POSITIVE)}),
    'Cuboid': (mp.interactions.Cuboid, dict.fromkeys(('length', 'width', 'height', 'remanence'), (3.0, POSITIVE))),
    'Sphere': (mp.interactions.Sphere, {'diameter': (3.0, POSITIVE), 'remanence': (1.0, POSITIVE)}),
    'Tabulated': (mp.interactions.Tabulated, {'r': ([1.0, 2, 3, 4], COLUMN), 'f': ([4.0, 3, 2, 1], COLUMN)}),
    **{f'lattices.{name}': (getattr(lattices, name), {'spacing': (1.0, POSITIVE), 'mass': (1.0, POSITIVE)})
       for name in ('triangular', 'square', 'chain', 'honeycomb', 'kagome', 'fcc', 'bcc')},
    'lattices.oscillator': (lattices.oscillator, {'theta0': (0.5, NUMBER), 'spacing': (1.0, POSITIVE), 'mass': (1.0, POSITIVE)}),
    'lattices.hexagon': (lattices.hexagon, {'cell': (cell, NOT_PLANAR), 'side': (3.0, POSITIVE)}),
    'lattices.half_hexagon': (lattices.half_hexagon, {'cell': (cell, NOT_PLANAR), 'side': (3.0, POSITIVE)}),
    'lattices.parallelogram': (lattices.parallelogram, {'cell': (cell, NOT_PLANAR), 'n1': (5, WHOLE), 'n2': (5, WHOLE)}),
    'lattices.rectangle': (lattices.rectangle, {'cell': (cell, NOT_PLANAR), 'width': (5.0, POSITIVE), 'height': (5.0, POSITIVE)}),
    'lattices.ribbon': (lattices.ribbon, {'cell': (cell, NOT_PLANAR), 'rows': (4, WHOLE)}),
    'find_bonds': (lattices.find_bonds, {'atoms': (cell, []), 'shells': (1, WHOLE), 'cutoff': (None, [NAN, -1.0, 'x', [1.0]])}),
    'explicit_bonds': (lattices.bonds.explicit_bonds, {'atoms': (patch, []), 'pairs': (
        [(0, 1)], [[], [(0, 0)], [(0, 10**6)], [(0, 0.5)], [(0, 1), (1, 0)], 'x'])}),
    **{name: (getattr(mp.stiffness, name), {'reference': (cell, []), 'laws': (LAW, LAWS), 'foundation': (1.0, NOT_NEGATIVE),
                                  'model': ('complete', CHOICE), 'shells': (1, WHOLE)})
       for name in ('MagneticRepulsion', 'PairCalculator')},
    'AllNeighbours': (AllNeighbours, {'reference': (cell, []), 'law': (LAW, LAWS), 'foundation': (1.0, NOT_NEGATIVE)}),
    'analytic_bands': (mp.analytic_bands, {'atoms': (cell, ATOMS), 'path': ('GM', PATH), 'model': (None, CHOICE)}),
    'group_velocities': (group_velocities, {'atoms': (cell, ATOMS), 'q': ([[0.25, 0.25, 0.0]], Q), 'model': (None, CHOICE)}),
    'sound_speeds': (mp.bands.sound_speeds, {'atoms': (cell, ATOMS), 'direction': ([1.0, 0.0], VECTOR), 'model': (None, CHOICE)}),
    'complex_bands': (mp.bands.complex_bands, {'atoms': (cell, ATOMS), 'direction': ([1, 0, 0], [[0, 0, 0], [NAN, 1, 0], 'x', 3]),
                                         'omega': ([1.0], [[NAN], 'x', [[1.0]]]), 'damping': (0.0, [NAN, -1.0, 'x'])}),
    'chern_numbers': (mp.bands.chern_numbers, {'cell': (turning, ATOMS), 'model': (None, CHOICE)}),
    'finite_displacements': (mp.finite_displacements, {
        'atoms': (cell, ATOMS),
        'supercell': ((3, 3, 1), [(2, 2, 1), (3, 3, 2), (3, 3), (3, 3.5, 1), 'x', (0, 3, 1), (NAN, 3, 1),
                                  [[3, 0, 0], [0, 3, 0], [0, 1, 1]], [[3, 0, 0], [0, NAN, 0], [0, 0, 1]], -3 * np.eye(3)]),
        'distance': (1e-3, [0.0, -1.0, NAN, 0.5, 'x', [1.0]])}),
    'phonopy_bands': (mp.phonopy_bands, {'phonon': (phonon, [None, 4.5]), 'path': ('GM', PATH)}),
    'critical_foundation': (mp.critical_foundation, {'atoms': (cell, ATOMS), 'model': (None, CHOICE)}),
    'verdict': (mp.verdict, {'atoms': (cell, ATOMS), 'damping': (0.0, [NAN, -1.0, 'x', INF])}),
    'relaxed': (mp.relaxed, {'atoms': (patch, ATOMS), 'tolerance': (1e-9, POSITIVE), 'steps': (10, WHOLE)}),
    'modes': (mp.modes, {'atoms': (patch, ATOMS), 'count': (3, [NAN, 2.5, -1, 0, 'x', [1]])}),
    'frequency_response': (mp.frequency_response, {
        'atoms': (patch, ATOMS), 'force': (lambda: np.eye(1, 3 * len(patch()), 3 * (len(patch()) // 2)).reshape(-1, 3),
                                           [lambda: np.full((len(patch()), 3), NAN), [[1.0, 0.0]], 'x']),
        'omega': ([1.0, 2.0], [[NAN], 'x', [INF]]), 'damping': (0.1, [NAN, -1.0, 'x', INF]),
        'particles': ([0], INDEX), 'tolerance': (1e-9, POSITIVE)}),
    'propagate': (mp.propagate, {
        'atoms': (patch, ATOMS), 'times': ([0.0, 1.0], [[NAN], [0.0, INF], 'x', [[0.0]], [1.0, 0.5]]),
        'damping': (0.0, [NAN, -1.0, 'x', INF]), 'particles': ([0], INDEX), 'tolerance': (1e-9, POSITIVE),
        'drives': ([], [[5.0], ['x']])}),
    'DrivenVerlet': (mp.DrivenVerlet, {
        'atoms': (patch, ATOMS), 'timestep': (0.01, POSITIVE), 'damping': (0.0, [NAN, -1.0, 'x', INF]),
        'drives': ([], [[5.0], ['x']]), 'engine': ('auto', CHOICE)}),
    'Recorder': (mp.dynamics.Recorder, {'dyn': (lambda: mp.DrivenVerlet(patch(), 0.01), []), 'particles': ([0], INDEX),
                               'interval': (10, WHOLE)}),
    'Harmonic': (mp.dynamics.Harmonic, {'particles': ([0], ['x', [0.5], [NAN], [-1]]), 'direction': ((1.0, 0.0), VECTOR),
                               'amplitude': (1.0, [NAN, INF, 'x']), 'omega': (1.0, [NAN, INF, 'x'])}),
    'ToneBurst': (mp.ToneBurst, {'particles': ([0], ['x', [0.5], [NAN], [-1]]), 'direction': ((1.0, 0.0), VECTOR),
                                 'amplitude': (1.0, [NAN, INF, 'x']), 'omega': (1.0, POSITIVE), 'cycles': (5, POSITIVE),
                                 'start': (0.0, NUMBER)}),
    'Constant': (mp.dynamics.Constant, {'particles': ([0], ['x', [0.5], [NAN], [-1]]), 'direction': ((1.0, 0.0), VECTOR),
                               'force': (1.0, [NAN, INF, 'x'])}),
    'read_scene': (mp.read_scene, {'path': (str(ready_scenes()['ideal']), [''])}),
    'ready_scene': (mp.scenes.ready_scene, {'name': ('ideal', CHOICE)}),
    'interactions.Forces': (interactions.Forces, {'r': ([8.0, 9, 10, 11], COLUMN), 'f': ([4.0, 3, 2, 1], COLUMN)}),
    'interactions.SharedErrors': (interactions.SharedErrors, dict.fromkeys(
        ('distance', 'backlash', 'gain'), (0.1, NOT_NEGATIVE))),
    'interactions.fit_forces': (interactions.fit_forces, {'forces': (forces, []), 'spacing': (10.0, POSITIVE)}),
    'response.estimated': (response.estimated, {
        'drive': (np.ones(64), [[1.0, NAN], np.ones(3), 'x']), 'answer': (np.ones(64), [np.full(64, NAN), np.ones(63), 'x']),
        'dt': (1.0, POSITIVE), 'estimator': ('H1', CHOICE)}),
    'waves.burst_setup': (waves.burst_setup, {'cell': (cell, []), 'patch': (lambda: lattices.half_hexagon(cell(), 10.0), []),
                                              'source': ('point', CHOICE)}),
}
ELSEWHERE = {'Bands', 'PrescribedMotion', 'magnet_law', 'for_ase_tools', 'restored', 'edge_flow', 'plot_bands', 'plot_mode',
             'plot_wave', 'write_scene', 'sweep'}
"""Public functions whose arguments are tried by their own tests."""
CASES = [(name, argument, k) for name, (_, given) in CALLS.items() for argument, (_, wrong) in given.items()
         for k in range(len(wrong))]


def of(value):
    """A value, or what makes it."""
    return value() if inspect.isfunction(value) or hasattr(value, 'cache_info') else value


@settings(max_examples=len(CASES), deadline=None, derandomize=True)
@given(st.sampled_from(CASES))
def test_a_wrong_argument_is_refused_by_name(case):
    name, argument, k = case
    function, given = CALLS[name]
    arguments = {key: of(right) for key, (right, _) in given.items()}
    arguments[argument] = of(given[argument][1][k])
    with pytest.raises((ValueError, TypeError)) as caught:
        function(**arguments)
    assert Path(caught.traceback[-1].path).is_relative_to(PACKAGE), f'{caught.value!r} is of another package'
    assert names(str(caught.value), argument, arguments[argument])


def names(words, argument, wrong):
    """Whether a message names an argument or shows its value, or an entry of it."""
    entries = wrong if isinstance(wrong, list | tuple) else []
    shown = [argument.removesuffix('s'), repr(wrong), str(wrong), *map(repr, entries)]
    return any(one in words for one in shown) or (argument == 'cell' and 'atoms' in words)


@pytest.mark.parametrize('name', CALLS)
def test_control_right_arguments_are_taken(name):
    function, given = CALLS[name]
    function(**{key: of(right) for key, (right, _) in given.items()})


def test_every_public_function_is_tried():
    """Names that stand at the top of the package; a new one gets its line here."""
    public = {name for name in dir(mp) if callable(getattr(mp, name)) and name[0] != '_'}
    errors = {name for name in public if inspect.isclass(getattr(mp, name)) and issubclass(getattr(mp, name), PhysicsError)}
    assert public - errors - ELSEWHERE <= CALLS.keys()
    assert not ELSEWHERE & CALLS.keys()


# --- keys of scenes and options of commands --------------------------------------------------------------------------

def leaves(tables, at=()):
    for key, value in tables.items():
        yield from leaves(value, (*at, key)) if isinstance(value, dict) else [((*at, key), value)]


SCENES = {name: tomllib.loads(file.read_text(encoding='utf-8')) for name, file in ready_scenes().items()}
KEYS = {at: (name, value) for name, tables in SCENES.items() if tables['lattice']['kind'] != 'file'
        for at, value in leaves(tables) if at != ('title',)}
WRONG = {bool: [3, 'x', NAN, []], int: [NAN, 2.5e-400, 'x', [1.0, 2.0], True, -(10**400)], str: ['no such', 7, []],
         float: [NAN, INF, 'x', [1.0, 2.0], True, 10**400], list: [[NAN], 'x', 5.0, [['x']], {}]}


@settings(max_examples=len(KEYS) * 4, deadline=None, derandomize=True)
@given(st.sampled_from(sorted(KEYS)).flatmap(lambda at: st.tuples(st.just(at), st.sampled_from(WRONG[type(KEYS[at][1])]))))
def test_a_wrong_value_of_a_scene_is_refused_by_its_key(case):
    at, wrong = case
    tables = table = copy.deepcopy(SCENES[KEYS[at][0]])
    for key in at[:-1]:
        table = table[key]
    table[at[-1]] = wrong
    with pytest.raises(ValueError, match=at[-1]):
        scene_of(tables)


@pytest.mark.parametrize('text', [b'', b'\0', b'title = 0,5', b'\xff\xfe', b'[lattice', b'[lattice]\nkind = "no"\n', b'x'])
def test_what_is_no_scene_is_refused_by_its_name(text, tmp_path):
    (tmp_path / 'mine.toml').write_bytes(text)
    with pytest.raises((ValueError, OSError), match=r'mine\.toml'):
        read_scene(tmp_path / 'mine.toml')


OPTIONS = [(command, action.option_strings[-1]) for command in COMMANDS
           for action in parser_of([command])._subparsers._group_actions[0].choices[command]._actions
           if action.option_strings and (action.type or action.choices)]


@pytest.mark.parametrize(('command', 'option'), [*OPTIONS, ('bands', '--outptu'), ('check', 'further'), ('bnads', '-o')])
def test_a_wrong_option_is_refused_by_its_name(command, option, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit) as ended:
        main([command, 'ideal', option, 'no such'])
    assert ended.value.code == 2
    said = capsys.readouterr().err
    assert option in said or command == 'bnads'
    assert 'Traceback' not in said
    assert not list(tmp_path.iterdir())
