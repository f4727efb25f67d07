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
from ase import Atoms
from ase.constraints import FixAtoms, FixBondLength, FixCom
from hypothesis import given, settings, strategies as st

import magphonon as mp
from magphonon import interactions, lattices, plotting, response, waves
from magphonon.bands import edge_weights, group_velocities, lattice_density
from magphonon.cli.main import COMMANDS, main, parser_of
from magphonon.dynamics.motion import Motion
from magphonon.errors import PhysicsError
from magphonon.response.stepped import remaining_transient
from magphonon.scenes.scene import ready_scenes, scene_of
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.ewald import lattice_sum

NAN, INF = float('nan'), float('inf')
PACKAGE = Path(mp.__file__).parent
LAW = mp.InversePower(b=1.0, a=4.0)
MAGNET = mp.interactions.Ring(6.35, 1.5875, 3.175, 1.3)


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
def strip():
    atoms = lattices.ribbon(cell(), 6)
    atoms.calc = mp.MagneticRepulsion(atoms, LAW)
    return atoms


def modes_of(atoms):
    return mp.analytic_bands(atoms, [[0.1, 0, 0], [0.2, 0, 0]], vectors=True)


@cache
def phonon():
    return mp.finite_displacements(cell())


@cache
def forces():
    return interactions.Forces(np.linspace(8, 15, 8), 2000 * np.linspace(8, 15, 8) ** -4.0, np.full(8, 1e-3))


# --- wrong values ----------------------------------------------------------------------------------------------------

NUMBER = [NAN, INF, -INF, 'x', None, [1.0, 2.0], 1j, 10**400, object()]
POSITIVE = [*NUMBER, -1.0, 0.0]
NOT_NEGATIVE = [*NUMBER, -1.0]
WHOLE = [NAN, INF, 2.5, -1, 0, 'x', None, [1], 2**64]
INDEX = [[-1], [10**6], [0.5], 'x', [NAN], np.arange(37) % 3 == 0]  # a mask was once read as the particles 0 and 1
RISING = [[0.2, 0.1], [0.3, 0.3], 'x', [NAN, 1.0], [[0.1, 0.2]]]
VECTOR = [[NAN, 1.0], [1.0, INF], [0.0, 0.0], 'x', [[1.0]], [], 5.0]
Q = [[[NAN, 0.0, 0.0]], [[0.0, INF, 0.0]], [[0.25, 0.5]], 'GMK', [[['x']]]]
COLUMN = [[NAN, 1.0, 2.0, 3.0], [1.0, 2.0, 3.0, INF], 'x', [[1.0], [2.0, 3.0]]]
CHOICE = ['no such', 7]
ATOMS = [lattices.triangular(1.0, 1.0)]  # without a calculator
NOT_PLANAR = [lattices.chain(1.0, 1.0)]
LAWS = [4.5, 'x', object()]
PATH = [4.5, 'GQ', [[NAN, 0, 0]], [[0.5, 0]], ['G', 'M']]

CALLS = {  # a function, its right arguments, and wrong values of each
    'InversePower': (mp.InversePower, {'b': (1.0, POSITIVE), 'a': (4.0, POSITIVE)}),
    'Yukawa': (mp.interactions.Yukawa, {'c': (1.0, POSITIVE), 'kappa': (1.0, POSITIVE)}),
    'Spring': (mp.interactions.Spring, {'k': (1.0, POSITIVE), 'L0': (1.0, NOT_NEGATIVE)}),
    'Cable': (mp.interactions.Cable, {'k': (1.0, POSITIVE), 'L0': (1.0, NOT_NEGATIVE)}),
    'Overlap': (mp.interactions.Overlap, {'energy': (1.0, POSITIVE), 'diameter': (1.0, POSITIVE)}),
    'Ring': (mp.interactions.Ring, {'outer': (5.0, POSITIVE), 'inner': (2.0, NOT_NEGATIVE), 'height': (3.0, POSITIVE),
                        'remanence': (1.0, POSITIVE)}),
    'Cuboid': (mp.interactions.Cuboid, dict.fromkeys(('length', 'width', 'height', 'remanence'), (3.0, POSITIVE))),
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
                                  'model': ('complete', CHOICE), 'shells': (1, WHOLE),
                                  'anchors': (None, [np.zeros((3, 3))]), 'strengths': (None, [[1.0, 1.0], [NAN]]),
                                  'load': (None, [[[NAN, 0, 0]], [[0, 0, 1.0]], np.zeros((3, 3))]),
                                  'gyration': (0.0, [[1.0, 2.0], NAN, 'x'])})
       for name in ('MagneticRepulsion', 'PairCalculator')},
    'AllNeighbours': (AllNeighbours, {'reference': (cell, []), 'law': (LAW, LAWS), 'foundation': (1.0, NOT_NEGATIVE)}),
    'analytic_bands': (mp.analytic_bands, {'atoms': (cell, [*ATOMS, patch]), 'path': ('GM', PATH), 'model': (None, CHOICE),
                                           'branches': (2, [0, 1.5, -1, 3])}),
    'lattice_density': (lattice_density, {'atoms': (cell, [*ATOMS, patch]), 'omega': ([0.1, 0.2], RISING),
                                          'steps': (6, WHOLE[:6])}),
    'edge_weights': (edge_weights, {'atoms': (strip, [cell, patch]), 'depth': (1.0, POSITIVE[:4]), 'bands': (
        lambda: modes_of(strip()), [lambda: mp.analytic_bands(strip(), [[0.1, 0, 0]]), lambda: modes_of(cell())])}),
    'group_velocities': (group_velocities, {'atoms': (cell, ATOMS), 'q': ([[0.25, 0.25, 0.0]], Q), 'model': (None, CHOICE)}),
    'sound_speeds': (mp.bands.sound_speeds, {'atoms': (cell, ATOMS), 'direction': ([1.0, 0.0], VECTOR), 'model': (None, CHOICE)}),
    'complex_bands': (mp.bands.complex_bands, {'atoms': (cell, ATOMS), 'direction': (
        [1, 0, 0], [[0, 0, 0], [NAN, 1, 0], 'x', 3, (0.123, 0.45, 0), (0, 0, 1)]),
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
    'relaxed': (mp.relaxed, {'atoms': (patch, ATOMS), 'steps': (10, WHOLE)}),
    'modes': (mp.modes, {'atoms': (patch, ATOMS), 'count': (3, [NAN, 2.5, -1, 0, 'x', [1]])}),
    'frequency_response': (mp.frequency_response, {
        'atoms': (patch, ATOMS), 'force': (lambda: np.eye(1, 3 * len(patch()), 3 * (len(patch()) // 2)).reshape(-1, 3),
                                           [lambda: np.full((len(patch()), 3), NAN), [[1.0, 0.0]], 'x']),
        'omega': ([1.0, 2.0], [[NAN], 'x', [INF]]), 'damping': (0.1, [NAN, -1.0, 'x', INF]),
        'particles': ([0], INDEX), 'tolerance': (1e-9, POSITIVE)}),
    'harmonic_response': (response.harmonic_response, {
        'atoms': (patch, ATOMS), 'force': (lambda: np.ones((len(patch()), 3)) * [1, 0, 0], [
            lambda: np.full((len(patch()), 3), NAN), np.zeros((3, 3)), lambda: np.ones((len(patch()), 3))]),
        'omega': ([1.0], [[NAN], 'x', [INF]]), 'damping': (0.1, [NAN, -1.0, 'x', [1.0, 2.0]])}),
    'density_of_states': (response.density_of_states, {
        'atoms': (patch, ATOMS), 'omega': ([1.0, 2.0], RISING), 'moments': (16, [63, *WHOLE[:-1]]), 'vectors': (2, [1, 2.5, NAN]),
        'seed': (0, [-1, 0.5])}),
    'local_modes': (response.local_modes, {'atoms': (patch, ATOMS), 'gap': ([0.1, 0.2], RISING)}),
    'lock_in': (response.stepped.lock_in, {'signal': (np.ones((100, 2)), []), 'dt': (1.0, POSITIVE),
                                   'omega': ([1.0, 1.0], [0.1, [1.0, 3.2], -1.0])}),
    'remaining_transient': (remaining_transient, {'amplitudes': ([1.0, 1.0, 1.0], [[1.0, 1.0]]), 'decay': (0.5, [1.0, NAN])}),
    'impulse_response': (response.impulse_response, {
        'signal': (np.append(0, np.ones(30)), [np.ones(30), np.zeros(19), np.zeros(30), np.append(0, np.full(30, NAN))]),
        'dt': (1.0, POSITIVE), 'impulse': (1.0, POSITIVE), 'omega': ([0.1], [[NAN]])}),
    'Dof': (response.Dof, {'particle': (0, []), 'direction': ([1.0, 0, 0], [[1.0, 0.0], [NAN, 0, 0], 'up'])}),
    'propagate': (mp.propagate, {
        'atoms': (patch, ATOMS), 'times': ([0.0, 1.0], [[NAN], [0.0, INF], 'x', [[0.0]], [1.0, 0.5], [], [-1.0]]),
        'damping': (0.0, [NAN, -1.0, 'x', INF]), 'particles': ([0], INDEX), 'tolerance': (1e-9, POSITIVE),
        'drives': ([], [[5.0], ['x'], [mp.dynamics.Harmonic(12, (0, 0, 1), 1.0, 0.1)],
                        [mp.dynamics.Harmonic(99, (0, 1), 1.0, 0.1)]])}),
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
    'calibrated': (interactions.calibrated, {'magnet': (MAGNET, []), 'r': (10.0, POSITIVE[:3]), 'f': (0.1, [-0.1, NAN])}),
    'Scatter': (mp.stiffness.Scatter, dict.fromkeys(
        ('position', 'strength', 'mass', 'stiffness'), (0.1, [-1.0, NAN, INF]))),
    'scattered': (mp.stiffness.scattered, {'atoms': (patch, []), 'scatter': (mp.stiffness.Scatter(0.1), []), 'seed': (0, [1.5])}),
    'substituted': (mp.stiffness.substituted, {'atoms': (patch, []), 'particle': (0, INDEX), 'mass': (1.0, POSITIVE[:3])}),
    'with_vacancies': (mp.stiffness.with_vacancies, {'atoms': (patch, []), 'particles': ([0], INDEX)}),
    'lattice_sum': (lattice_sum, {'lattice': (np.eye(2), [[[1, 0], [2, 0]], [1.0, 0.0], np.zeros((0, 2)), [[1], [2]]]),
                                        'law': (3.0, [0, -1.0, NAN, '3'])}),
    'frequency_shifts': (mp.stability.frequency_shifts, {'atoms': (cell, ATOMS), 'q': ((0.2, 0.21, 0), [[NAN, 0, 0]])}),
    'sampled': (waves.sampled, {'motion': (Motion(np.arange(20.0), np.arange(2), np.zeros((20, 2, 2))), []),
                                'rate': (1.0, [*POSITIVE, 0.01]), 'noise': (0.0, NOT_NEGATIVE)}),
    'wavenumber_frequency': (waves.wavenumber_frequency, {'displacements': (np.eye(20), [
        np.zeros((20, 20)), np.ones((20, 7)), np.ones((20, 20, 2)), np.full((20, 20), NAN), 1e303 * np.eye(20),
        1e-297 * np.eye(20), np.arange(20.0) + 1e-3 * np.arange(20.0)[:, None]]), 'dt': (1.0, POSITIVE)}),
    'branch': (waves.branch, {'atoms': (cell, ATOMS), 'direction': ((0, 1, 0), []), 'mode': (1, [2, -1, 0.5])}),
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


ALSO = {'cell': 'atoms', 'atoms': 'structure', 'signal': 'record', 'displacements': 'row', 'amplitudes': 'windows',
        'drives': 'force', 'particles': 'vacancies'}
"""What a message may call an argument instead."""


def names(words, argument, wrong):
    """Whether a message names an argument or shows its value, or an entry of it."""
    entries = wrong if isinstance(wrong, list | tuple) else []
    shown = [argument.removesuffix('s'), repr(wrong), str(wrong), *map(repr, entries), *filter(None, [ALSO.get(argument)])]
    return any(one in words for one in shown)


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


# --- structures of which something is wrong ----------------------------------------------------------------------------------

def with_(atoms, **changes):
    """A copy of a structure with other constraints, positions or masses, and its calculator."""
    other = atoms.copy()
    other.calc = atoms.calc
    for name, value in changes.items():
        getattr(other, f'set_{name}')(value)
    return other


TWO = Atoms('H2', [[0, 0, 0], [1, 0, 0]], masses=[1, 1])
SITUATIONS = {  # what is wrong, what is asked, and what the answer must show
    'a rod between two particles': (lambda: mp.verdict(with_(patch(), constraint=FixBondLength(17, 18))), 'FixCartesian'),
    'the centre of mass is held': (lambda: mp.propagate(with_(patch(), constraint=FixCom()), [1.0]), 'FixCartesian'),
    'all particles are held': (lambda: mp.modes(with_(patch(), constraint=FixAtoms(range(37)))), 'hold every particle'),
    'a strip that is held': (lambda: group_velocities(with_(strip(), constraint=FixAtoms(range(6))), [[0.1, 0, 0]]), 'hold'),
    'a strip with free edges': (lambda: group_velocities(with_(strip(), constraint=None), [[0.1, 0, 0]]), 'not at rest'),
    'a strip that is all rim': (lambda: lattices.ribbon(cell(), 2), 'inside its rim'),
    'modes of another patch': (lambda: response.localisation(mp.modes(patch()), cell().repeat((8, 8, 1))), '37'),
    'bonds of another patch': (lambda: mp.MagneticRepulsion(cell(), LAW, bonds=patch().calc.bonds), '37'),
    'particles in one another': (lambda: interactions.magnet_law(MAGNET).phi(6.4), '6.4'),
    'a ring without a wall': (lambda: interactions.Ring(5, 5, 1, 1.0), 'not 5'),
    'a film of another patch': (lambda: plotting.animate('film.gif', patch(), np.ones((2, 35, 2))), '37'),
    'a film of nothing': (lambda: plotting.animate('film.gif', patch(), np.zeros((2, 37, 2))), 'nothing moves'),
    'a film of no kind': (lambda: plotting.animate('film.avi', patch(), np.ones((2, 37, 2))), '.gif'),
    'a film in no folder': (lambda: plotting.animate('no/film.gif', patch(), np.ones((2, 37, 2))), 'another place'),
    'a mode without motion': (lambda: plotting.animation.mode_frames(np.zeros((3, 2))), 'moves nothing'),
    'sound along nothing': (lambda: mp.stiffness.elastic_moduli(cell()).speeds([0, 0]), 'direction'),
    'a member of one end': (lambda: mp.stiffness.net(TWO, [(0, 1)]), 'a member is'),
    'a member to half a node': (lambda: mp.stiffness.net(TWO, [(0, 0.5, interactions.Spring(1.0, 1.0))]), '0.5'),
    'two members between two nodes': (lambda: mp.stiffness.net(TWO, [
        (0, 1, interactions.Spring(1.0, 1.0)), (1, 0, interactions.Spring(2.0, 1.0))]), 'nodes 1 and 0'),
    'a mass that was spoilt': (lambda: mp.modes(with_(patch(), masses=np.where(np.arange(37) == 18, -1.0, 1.0))), 'particle 18'),
}


@pytest.mark.parametrize('what', SITUATIONS)
def test_a_structure_of_which_something_is_wrong_is_refused(what):
    ask, shown = SITUATIONS[what]
    with pytest.raises((ValueError, OSError)) as caught:
        ask()
    assert Path(caught.traceback[-1].path).is_relative_to(PACKAGE)
    assert shown in str(caught.value)


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
