"""`magphonon frf`: the oscillator against its closed form, a patch against forces alone, and how it fails."""

import csv
import subprocess
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene
from structures import few_first

from magphonon import units
from magphonon.cli import frf
from magphonon.cli.main import main
from magphonon.scenes.scene import read_scene

# Sec. III of the paper: vertical stiffness in N/m at the four angles in degrees, with D* and without; M = 1 kg
STIFFNESS = {30.0: (4.5e4, 6e4), 90.0: (12e4, 12e4), 0.0: (2e4, 4e4), 45.0: (7e4, 8e4)}
GAMMA = 12.0  # 1/s, in the scene

PATCH = '''
[patch]
kind = "parallelogram"
cells_1 = 5
cells_2 = 5
[frf]
from_Hz = 20.0
to_Hz = 160.0
points = 29
damping_per_s = 20.0
[frf.force]
at_m = [0.0, 0.0]
direction_deg = 90.0
[frf.response]
at_m = [0.012, 0.001]
direction_deg = 30.0
'''


@pytest.fixture
def scene_file(tmp_path):
    """A function that writes a scene with some texts replaced."""
    def write(text, *changes):
        for old, new in changes:
            assert old in text
            text = text.replace(old, new)
        file = tmp_path / 'my.toml'
        file.write_text(text)
        return file
    return write


@pytest.fixture(scope='module')
def oscillator():
    return ready_scene('oscillator').read_text()


@pytest.fixture(scope='module')
def patch():
    """The prototype's magnets in a small patch."""
    return ready_scene('bench').read_text().partition('[patch]')[0] + PATCH


def table(folder):
    with open(folder / 'frf.csv', newline='') as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


def run(file, folder):
    assert main(['frf', '--verbose', str(file), '-o', str(folder)]) == 0
    return table(folder)


# --- the oscillator --------------------------------------------------------------------------------------------------

@pytest.mark.parametrize('theta0', few_first(STIFFNESS, 2))
def test_oscillator_is_the_closed_form(theta0, oscillator, scene_file, tmp_path, capsys):
    found = run(scene_file(oscillator, ('theta0_deg = 30.0', f'theta0_deg = {theta0}')), tmp_path / 'out')
    w = 2 * np.pi * found['frequency_Hz']
    expected = [1 / (k - w**2 + 1j * GAMMA * w) for k in STIFFNESS[theta0]]
    shown = capsys.readouterr().out
    for model, response, k in zip(('complete', 'conventional'), expected, STIFFNESS[theta0], strict=True):
        # round-off of the stiffness, amplified at resonance by omega/gamma, 30 at most
        assert_allclose(found[f'{model}_amplitude_m_per_N'], abs(response), rtol=1e-11)
        assert_allclose(found[f'{model}_phase_deg'], np.degrees(np.angle(response)), atol=1e-9)
        assert f'natural frequencies: {np.sqrt(k) / (2 * np.pi):.6g} Hz' in shown
        peak = found['frequency_Hz'][abs(response).argmax()]
        assert f'{peak:14.6g} Hz {abs(response).max():14.6g} m/N' in shown
    apart = abs(found['complete_amplitude_m_per_N'] / abs(expected[1]) - 1).max()
    assert apart > 1 if theta0 < 90 else apart < 1e-11  # the wrong model is seen, except where it is right


def test_a_curve_without_peak_says_so_and_lists_none(oscillator, scene_file, tmp_path, capsys):
    run(scene_file(oscillator, ('from_Hz = 16.0', 'from_Hz = 60.0')), tmp_path / 'out')
    lines = capsys.readouterr().out.splitlines()
    assert [line for line in lines if 'peaks' in line] == 2 * ['  0 peaks from 60 to 64 Hz, in steps of 0.00417 Hz']


@pytest.mark.slow
def test_one_particle_builds_no_lattice_and_takes_no_steps(oscillator, scene_file, tmp_path):
    code = f'from magphonon.cli.main import main\nmain(["frf", "{scene_file(oscillator)}", "-o", "{tmp_path / "out"}"])\n' \
           'import sys\nprint(*sys.modules)'
    done = subprocess.run([sys.executable, '-c', code], capture_output=True, text=True, check=True, timeout=600)
    loaded = set(done.stdout.splitlines()[-1].split())
    assert {'magphonon.response.frf', 'magphonon.stiffness.calculator'} <= loaded
    assert not {'ase.md', 'magphonon.dynamics.verlet', 'phonopy', 'numba'} & loaded


# --- a patch ---------------------------------------------------------------------------------------------------------

def test_patch_is_what_its_forces_say(patch, scene_file, tmp_path):
    """Stiffness by differences of the forces between all particles, every one of them free or held, solved densely."""
    file = scene_file(patch)
    found = run(file, tmp_path / 'out')
    atoms = read_scene(file).patch_atoms()
    rest, step = atoms.positions.copy(), 1e-5 * 10 * units.mm
    free = [(k, x) for k in range(25) if atoms.get_tags()[k] == 0 for x in (0, 1)]
    assert len(free) == 18
    K = np.empty((18, 18))
    for column, (k, x) in enumerate(free):
        forces = []
        for sign in (1, -1):
            atoms.positions[:] = rest
            atoms.positions[k, x] += sign * step
            forces.append(np.array([atoms.get_forces(apply_constraint=False)[i] for i in free]))
        K[:, column] = (forces[1] - forces[0]) / (2 * step)
    where = {name: np.linalg.norm(rest[:, :2] - np.array(at) * units.m, axis=1).argmin()
             for name, at in (('force', (0, 0)), ('response', (0.012, 0.001)))}
    push = np.array([k == where['force'] and x == 1 for k, x in free], dtype=float)
    seen = np.array([(k == where['response']) * (np.cos(np.pi / 6), np.sin(np.pi / 6))[x] for k, x in free])
    w, m = 2 * np.pi * found['frequency_Hz'] * units.Hz, atoms.get_masses()[0]
    expected = [seen @ np.linalg.solve(K + (-v**2 + 1j * v * 20 / units.s) * m * np.eye(18), push) for v in w]
    amplitude = np.abs(expected) / (units.m / units.N)
    # the differences are wrong by 1e-9 of a stiffness, which resonances of a quality of some 30 and zeros magnify
    assert_allclose(found['complete_amplitude_m_per_N'], amplitude, atol=1e-6 * amplitude.max())
    assert abs(found['conventional_amplitude_m_per_N'] - amplitude).max() > 0.1 * amplitude.max()


# --- how it fails ----------------------------------------------------------------------------------------------------

MISTAKES = {
    'no frf': ('patch', (PATCH[PATCH.index('[frf]'):], ''), 'has no table [frf]; add one'),
    'no angle': ('oscillator', ('theta0_deg = 30.0', ''), "lattice lacks the key 'theta0_deg'; add the angle in degrees"),
    'shells': ('oscillator', ('shells = 1', 'shells = 2'), 'law.shells of the oscillator must be 1, not 2'),
    'bands': ('oscillator', ('[frf]', '[bands]\npath = "GM"\npoints = 9\nsupercell = [3]\n[frf]'),
              'bands: the particles have no periods'),
    'downwards': ('oscillator', ('to_Hz = 64.0', 'to_Hz = 8.0'), 'frf.to_Hz must lie above from_Hz = 16.0, not 8.0'),
    'force on the oscillator': ('oscillator', ('[frf]', '[frf.force]\nat_m = [0, 0]\ndirection_deg = 0\n[frf]'),
                                'frf.force: the oscillator is driven and measured along its guide; remove [frf.force]'),
    'no patch': ('patch', (PATCH.partition('[frf]')[0], ''), 'frf: there is no structure for it; add a table [patch]'),
    'no force': ('patch', (PATCH[PATCH.index('[frf.force]'):PATCH.index('[frf.resp')], ''),
                 "frf needs [frf.response], and either [frf.force] or base_deg"),
    'on the rim': ('patch', ('at_m = [0.0, 0.0]', 'at_m = [0.02, 0.0]'), 'frf.force.at_m = [0.02, 0.0] is nearest to the held'),
    'outside': ('patch', ('at_m = [0.012, 0.001]', 'at_m = [12, 1]'), 'frf.response.at_m = [12.0, 1.0] is outside'),
}


@pytest.mark.parametrize(('name', 'change', 'words'), MISTAKES.values(), ids=MISTAKES)
def test_mistake_ends_in_words_and_writes_nothing(name, change, words, scene_file, tmp_path, capsys, request):
    file = scene_file(request.getfixturevalue(name), change)
    assert main(['frf', '--verbose', str(file), '-o', str(tmp_path / 'out')]) == 2
    shown = capsys.readouterr()
    assert words in shown.err
    assert shown.out == ''
    assert {left.name for left in tmp_path.iterdir()} == {'my.toml'}


@pytest.mark.filterwarnings('ignore:.*would buckle under')
@pytest.mark.parametrize(('a', 'b', 'status'), [(2.0, 2.4e-5, 2), (4.0, 2.4e-9, 0)])  # 0.24 N at 10 mm, as in the prototype
def test_response_of_an_unstable_patch_is_refused(a, b, status, patch, scene_file, tmp_path, capsys):
    """Without pillars, the shear modulus is negative for exponents below 3."""
    file = scene_file(patch, ('a = 4.5824', f'a = {a}'), ('b_N_m_a = 1.6209e-10', f'b_N_m_a = {b}'),
                      ('radius_m = 7.9375e-4', 'radius_m = 1e-6'))
    assert main(['frf', '--verbose', str(file), '-o', str(tmp_path / 'out')]) == status
    assert ('fastest growing mode has the rate' in capsys.readouterr().err) is (status == 2)
    assert (tmp_path / 'out').exists() is (status == 0)


def test_the_difference_from_a_measurement_is_its_root_mean_square():
    """A quarter of the values is off by 0.3 of the peak, in any direction: 0.15."""
    rng = np.random.default_rng(0)
    measured = np.exp(1j * rng.uniform(0, 6, 40)) * np.append(2.0, rng.uniform(0.1, 1.9, 39))
    off = 0.6 * np.exp(1j * rng.uniform(0, 6, 40)) * (np.arange(40) % 4 == 0)
    _, words, _ = frf._compared([SimpleNamespace(response=measured, coherence=None, name='own')], {'complete': [measured + off]})
    assert words == '  complete 0.15  (own)'
