"""The command `magphonon`: what it shows and writes, and how it fails."""

import csv
import os
import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene

import magphonon
from magphonon.bands import Bands
from magphonon.cli.main import main
from magphonon.scenes.scene import read_scene, ready_scenes, reference

FILES = {'bands.png', 'zone.png', 'bands.csv', 'bands_complete.npz', 'bands_conventional.npz', 'bands_phonopy.npz', 'band.yaml',
         'phonopy_params.yaml'}


def command(*arguments, **options):
    """The command in a process of its own, as a shell would start it."""
    return subprocess.run([sys.executable, '-m', 'magphonon', *map(str, arguments)], capture_output=True, text=True,
                          timeout=600, **options)


# --- what it does ----------------------------------------------------------------------------------------------------

def test_bands_of_the_prototype(scene_file, tmp_path):
    out = tmp_path / 'out'
    done = command('bands', '--verbose', scene_file({}), '-o', out)
    assert (done.returncode, done.stderr) == (0, '')
    assert {file.name for file in out.iterdir()} == FILES

    numbers = reference()['prototype']
    with open(out / 'bands.csv', newline='') as file:
        header, *rows = csv.reader(file)
    table = {name: np.array(column, dtype=float) for name, column in zip(header, zip(*rows, strict=True), strict=True)}
    assert header == ['path_rad_per_m', 'q1', 'q2', 'q3', 'complete_1_Hz', 'complete_2_Hz', 'conventional_1_Hz',
                      'conventional_2_Hz', 'phonopy_1_Hz', 'phonopy_2_Hz']
    M = np.argmin(abs(table['path_rad_per_m'] - 2 * np.pi / np.sqrt(3) / 0.01))  # from Gamma: 2 pi/(sqrt(3) L0)
    # analytic to the digits of the reference; phonopy to what its default displacement promises
    for mode in (0, 1):
        assert_allclose(table[f'complete_{mode + 1}_Hz'][M], numbers['M_complete_Hz'][mode], rtol=1e-9)
        assert_allclose(table[f'conventional_{mode + 1}_Hz'][M], numbers['M_conventional_Hz'][mode], rtol=1e-9)
        assert_allclose(table[f'phonopy_{mode + 1}_Hz'][M], numbers['M_complete_Hz'][mode], rtol=1e-8)

    assert_allclose(Bands.load(out / 'bands_complete.npz').frequencies_Hz[:, 0], table['complete_1_Hz'], rtol=1e-13)
    shown = [line.split() for line in done.stdout.splitlines()]
    assert ['M,', 'branch', '1', '58.23269', '92.106', '58.23269'] in shown
    assert "foundation: 19.6757 N/m in the scene; phonopy's force constants sum to 19.6757 N/m" in done.stdout
    assert 'cut-off frequency (lowest at Gamma): 26.55069 Hz\n' in done.stdout  # sqrt(19.6757 N/m / 0.70698 g)/2 pi
    pressure, a = 3**0.5 * numbers['f_at_spacing'] / numbers['spacing'], numbers['a']  # closed forms of the triangular lattice
    assert f"removed: pressure {pressure:.6g} N/m, bulk modulus {(a + 1) / 2 * pressure:.6g} N/m, shear modulus" in done.stdout
    assert f"Poisson's ratio {(a + 5) / (3 * a - 1):.4g}" in done.stdout
    assert 'Stable in the plane, even without a foundation.' in done.stdout
    assert 'UNSTABLE' not in done.stdout


def test_unstable_lattice_is_called_unstable(scene_file, tmp_path, capsys):
    """A chain on springs of 30 kN/m, where the closed form 4 f(L0)/L0 asks for 40 kN/m; nothing on its path is hidden."""
    status = main(['bands', '--verbose', str(scene_file({'5e4': '3e4'}, 'chain')), '-o', str(tmp_path / 'out')])
    shown = capsys.readouterr().out
    assert status == 0
    assert 'UNSTABLE: the static forces buckle this lattice; the softest mode is at q = (0.5, 0, 0)' in shown
    # sqrt(3e4 N/m / M)/2 pi at Gamma; the branch across the chain falls from there through zero
    assert 'cut-off frequency (lowest at Gamma): 27.56644 Hz; lowest on the path: -15.91549 Hz\n' in shown
    assert 'needs a foundation of 40000 N/m and has 30000 N/m' in shown
    assert ['X,', 'branch', '1', '-15.91549', '27.56644', '-15.91549'] in [line.split() for line in shown.splitlines()]
    assert {file.name for file in (tmp_path / 'out').iterdir()} == FILES - {'zone.png'}  # a chain has no plane to draw


def test_instability_off_the_path_is_called_too(scene_file, tmp_path, capsys):
    """The square lattice on half of the springs that it needs, drawn along the diagonal: there every branch is stable."""
    file = scene_file({'kind = "triangular"': 'kind = "square"'}, 'ideal')
    text = file.read_text().replace('GMKG', 'GM') + '\n[foundation]\nstiffness_N_per_m = 2e4\n'
    file.write_text(text)
    main(['bands', '--verbose', str(file), '-o', str(tmp_path / 'out')])
    assert Bands.load(tmp_path / 'out' / 'bands_complete.npz').omega.min() > 0
    assert 'needs a foundation of 40000 N/m and has 20000 N/m' in capsys.readouterr().out


def test_coulomb_crystal_in_space_has_no_conventional_model(scene_file, tmp_path, capsys):
    """At H all branches of bcc have w_p/sqrt(3), w_p^2 = 4 pi n Q^2/(4 pi eps0 M); D0 alone diverges, and is left out."""
    text = scene_file({}, 'wigner').read_text().replace('"triangular"', '"bcc"').replace('"GMKG"', '"GH"')
    (tmp_path / 'bcc.toml').write_text(text.replace('points = 300', 'points = 5').replace('[6, 6]', '[2, 2, 2]'))
    assert main(['bands', '--verbose', str(tmp_path / 'bcc.toml'), '-o', str(tmp_path / 'out')]) == 0
    shown = capsys.readouterr().out
    assert 'no conventional model: the sums of D0 and D* diverge' in shown
    n = 3 * 3**0.5 / 4 / 5.1e-6**3  # two particles in a cube of 2/sqrt(3) L0
    plasma = (n * 1.602176634e-19**2 / 8.8541878128e-12 / 9.1093837e-31) ** 0.5
    omega = Bands.load(tmp_path / 'out' / 'bands_complete.npz').frequencies_Hz[-1] * 2 * np.pi
    assert_allclose(omega, plasma / 3**0.5, rtol=1e-8)  # eps0 is printed to 1e-9
    assert not (tmp_path / 'out' / 'bands_conventional.npz').exists()


def test_scenes_are_listed_and_printed(capsys, tmp_path):
    assert main(['scene']) == 0
    assert [line.split()[0] for line in capsys.readouterr().out.splitlines()] == list(ready_scenes())
    for name, file in ready_scenes().items():
        assert main(['scene', name]) == 0
        (tmp_path / 'copy.toml').write_text(capsys.readouterr().out)
        copy, scene = read_scene(tmp_path / 'copy.toml'), read_scene(file)
        beside = name in ('demultiplexer', 'prism')  # a table stands beside the ready scene
        assert copy == scene or (beside and copy.atoms() == scene.atoms())


# --- how it fails ----------------------------------------------------------------------------------------------------

MISTAKES = {
    'no such scene file': (['bands', '{d}/no.toml', '-o', '{d}/out'], 'no.toml', '"magphonon scene" lists'),
    'bad value': (['bands', '{d}/bad.toml', '-o', '{d}/out'], 'lattice.spacing_m', 'must be a positive number, not -0.01'),
    'narrow supercell': (['bands', '{d}/narrow.toml', '-o', '{d}/out'], '(2, 2, 1)', 'give supercell=(3, 3, 1)'),
    'output is a file': (['bands', '{d}/good.toml', '-o', '{d}/law.csv'], 'law.csv is a file', 'name a directory'),
    'output in a file': (['bands', '{d}/good.toml', '-o', '{d}/law.csv/x'], 'law.csv/x', 'choose another place'),
    'output not writable': (['bands', '{d}/good.toml', '-o', '/proc/x'], '/proc', 'choose another place'),
    'no command': ([], 'COMMAND', 'required'),
    'unknown option': (['bands', '{d}/good.toml', '-o', '{d}/out', '--fast'], '--fast', 'usage: magphonon'),
}


if not os.path.exists('/proc'):
    del MISTAKES['output not writable']


@pytest.fixture
def desk(tmp_path):
    """A directory with good and bad scenes."""
    good = ready_scene('bench').read_text()
    (tmp_path / 'good.toml').write_text(good)
    (tmp_path / 'bad.toml').write_text(good.replace('spacing_m = 0.01', 'spacing_m = -0.01'))
    (tmp_path / 'narrow.toml').write_text(good.replace('[3, 3]', '[2, 2]'))
    (tmp_path / 'law.csv').write_text('r_m,f_N\n0.01,0.2\n')
    return tmp_path


def status_of(arguments):
    try:
        return main(arguments)
    except SystemExit as exit:  # argparse's way out
        return exit.code


@pytest.mark.parametrize(('arguments', 'value', 'mend'), MISTAKES.values(), ids=MISTAKES)
def test_mistake_ends_in_words_and_writes_nothing(arguments, value, mend, desk, capsys):
    before = {file: file.read_bytes() for file in desk.iterdir()}
    assert status_of([argument.format(d=desk) for argument in arguments]) == 2
    shown = capsys.readouterr()
    assert value in shown.err
    assert mend in shown.err
    assert shown.out == ''
    assert {file: file.read_bytes() for file in desk.iterdir()} == before


@pytest.mark.slow
@pytest.mark.parametrize('name', ['bad value', 'output in a file'])
def test_no_traceback_in_a_shell(name, desk):
    done = command(*(argument.format(d=desk) for argument in MISTAKES[name][0]))
    assert done.returncode == 2
    assert 'Traceback' not in done.stderr
    assert MISTAKES[name][1] in done.stderr
    assert done.stdout == ''


@pytest.mark.parametrize(('accident', 'status', 'words'), [
    (KeyboardInterrupt(), 130, 'interrupted'), (OSError(28, 'No space left on device'), 2, 'no space left; make room')])
@pytest.mark.parametrize('existing', [False, True])
def test_accident_leaves_nothing(accident, status, words, existing, desk, capsys, monkeypatch):
    """The bands are computed and saved, but not all is drawn, when it happens."""
    def strike(*_):
        raise accident

    monkeypatch.setattr('magphonon.cli.bands._draw', strike)
    out = desk / 'out'
    if existing:
        out.mkdir()
    assert main(['bands', '--verbose', str(desk / 'good.toml'), '-o', str(out)]) == status
    assert words in capsys.readouterr().err
    left = {'good.toml', 'bad.toml', 'narrow.toml', 'law.csv'} | ({'out'} if existing else set())
    assert {file.name for file in desk.rglob('*')} == left


@pytest.mark.slow
def test_reader_that_has_seen_enough_is_no_error():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, 'w') as pipe:
        done = subprocess.run([sys.executable, '-m', 'magphonon', 'scene', 'prototype'], stdout=pipe, stderr=subprocess.PIPE,
                              text=True, timeout=600)
    assert (done.returncode, done.stderr) == (0, '')


def test_every_public_name_is_there_and_listed():
    for name in magphonon.__all__:
        assert getattr(magphonon, name).__doc__, name
    assert {'Diverged', 'response', 'DrivenVerlet'} <= set(dir(magphonon))
    with pytest.raises(AttributeError, match="No magphonon attribute nonsense"):
        _ = magphonon.nonsense


# --- what an import costs --------------------------------------------------------------------------------------------

@pytest.mark.parametrize(('statement', 'absent'), [
    ('import magphonon', ['numpy', 'scipy', 'ase', 'phonopy', 'matplotlib', 'pydantic', 'numba']),
    ('from magphonon import MagneticRepulsion, find_bonds, InversePower, lattices, stiffness, units',
     ['phonopy', 'matplotlib', 'pydantic', 'numba', 'ase.md']),
    ('from magphonon import analytic_bands, finite_displacements, plot_bands', ['phonopy', 'matplotlib', 'pydantic', 'ase.md']),
    ('from magphonon import cli', ['numpy', 'ase', 'phonopy', 'matplotlib', 'pydantic']),
])
def test_import_is_light(statement, absent):
    done = subprocess.run([sys.executable, '-c', f'{statement}\nimport sys\nprint(*sys.modules)'], capture_output=True, text=True,
                          check=True, timeout=600)
    assert 'magphonon' in done.stdout.split()
    assert not set(absent) & set(done.stdout.split())


def test_a_report_goes_into_a_folder_of_its_own(tmp_path, capsys):
    (tmp_path / 'summary.json').write_text('mine')
    assert main(['reproduce', 'chain', '-o', str(tmp_path)]) == 2
    assert 'summary.json exists; name another place with -o, or give --force' in capsys.readouterr().err
    assert [file.read_text() for file in tmp_path.iterdir()] == ['mine']
