"""The scripts in README and on the pages for users of other tools run as they stand there and find what they say."""

import json
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

README = Path(__file__).parents[1] / 'README.md'
COMING_FROM = README.parent / 'docs' / 'reference' / 'coming_from.md'
TEXT = '\n'.join(page.read_text(encoding='utf-8') for page in (README, README.parent / 'docs' / 'reference' / 'phonopy.md'))

# The script states the pillars' 19.67572... N/m to six digits, at most 2.6e-6 off; a frequency goes as the root of a stiffness.
ROUNDED = 1.3e-6


def script_with(word):
    blocks = re.findall(r'```python\n(.*?)```', TEXT, re.S)
    [script] = [code for code in blocks if word in code]
    return compile(script, str(README), 'exec')


def started(tool):
    """The names that the script for users of a tool leaves behind."""
    section = COMING_FROM.read_text(encoding='utf-8').partition(f'\n## {tool}\n')[2].partition('\n## ')[0]
    [script] = re.findall(r'```python\n(.*?)```', section, re.S)
    exec(compile(script, str(COMING_FROM), 'exec'), names := {})
    return names


@pytest.fixture(scope='module')
def session(tmp_path_factory):
    """The names that the script leaves behind, and the directory it ran in."""
    import matplotlib
    matplotlib.use('Agg')
    import matplotlib.pyplot as plt

    folder, names = tmp_path_factory.mktemp('readme'), {}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        exec(script_with('savefig'), names)
    plt.close('all')
    return names, folder


def at_m(names, bands):
    path = names['path']
    at = abs(path.kpts - path.special_points['M']).max(axis=1).argmin()
    return names[bands].frequencies_Hz[at]


def test_the_picture_is_drawn(session):
    import matplotlib.image

    picture = matplotlib.image.imread(session[1] / 'bands.png')
    assert np.ptp(picture[..., :3]) > 0.5  # not blank


@pytest.mark.parametrize('bands', ['complete', 'numerical'])
def test_frequencies_at_m_are_the_papers(session, bands):
    expected = [58.2326897819, 149.476338113]  # arXiv:1911.10410, Supplement, recomputed in 50-digit arithmetic
    np.testing.assert_allclose(at_m(session[0], bands), expected, rtol=ROUNDED)


def test_conventional_fails_them(session):
    shear, longitudinal = at_m(session[0], 'conventional')
    assert shear / 58.2326897819 == pytest.approx(92.1059950118 / 58.2326897819, rel=ROUNDED)  # 58 % too high
    assert longitudinal > 1.03 * 149.476338113


def test_the_first_sentences_say_what_the_script_finds(session):
    [true, blind] = [at_m(session[0], model)[0] for model in ('complete', 'conventional')]
    text = ' '.join(README.read_text(encoding='utf-8').split())
    less = f'{true:.0f} Hz, {100 * (1 - true / blind):.0f} % less,'
    assert f'the shear wave at M has {blind:.0f} Hz by D⁰ and {less} by D⁰ + D\\*' in text
    assert len(text.split()) <= 450  # seen in a minute
    assert README.read_text(encoding='utf-8').count('\n') <= 70


def test_who_comes_from_phonopy_finds_its_bands():
    names = started('phonopy')
    assert names['difference'] < 1e-6  # phonopy's displacements are good to 1e-9 of 150 Hz
    assert names['mesh'].frequencies.max() > 149


def test_who_comes_from_ase_finds_the_perfect_lattice():
    assert started('ASE')['off'] < 1e-6  # forces below 1e-9 N on springs of 0.02 N/mm


def test_who_comes_from_comsol_finds_what_only_prestress_shows(capsys):
    names = started('COMSOL')
    f, L = 1.6209e-10 * 0.01**-4.5824, 0.01
    assert f'needs {4 * f / L:.2f} N/m' in capsys.readouterr().out  # rows that slide past each other
    # a third of 4 f/L is left at X with D*, all of 6 f/L at Gamma without
    expected = np.sqrt(np.array([2, 6]) * f / L / 7.07e-4) / (2 * np.pi)
    np.testing.assert_allclose([names[bands].frequencies_Hz.min() for bands in ('bands', 'blind')], expected, rtol=1e-9)
    cell, half = names['cell'], names['needed'] / 2
    cell.calc.set(foundation=half)
    assert names['analytic_bands'](cell, 'GXMG').omega.min() < 0  # it buckles,
    assert names['analytic_bands'](cell, 'GXMG', model='conventional').omega.min() > 0  # and looks stable, as README says


def test_who_comes_from_matlab_finds_the_bands_by_hand(tmp_path, monkeypatch):
    from scipy.io import loadmat

    monkeypatch.chdir(tmp_path)
    np.testing.assert_allclose(started('MATLAB')['by_hand'], [58.2326897819, 149.476338113], rtol=ROUNDED)
    assert loadmat('prototype.mat')['K'].shape == (2, 2)


def test_time_steps_follow_the_exact_transient(capsys):
    names, page = started('LAMMPS'), COMING_FROM.read_text(encoding='utf-8')
    # velocity Verlet moves every frequency by (w dt)^2/24, 1e-6 at 40 Hz and 5e-6 at 100 Hz; 100 rad of phase accumulate
    assert names['off'] < 5e-4
    assert f"off by {names['off']:.1e}" in capsys.readouterr().out
    assert f'# {names["off"]:.1e}' in page
    assert f'{names["linear"].products} products' in page
    assert f'patch of {len(names["patch"])} magnets' in ' '.join(page.split())


@pytest.fixture(scope='module')
def shell(tmp_path_factory):
    """The folder of the bands after README's lines for the shell, those that install and test left out."""
    blocks = re.findall(r'^```(\w*)\n(.*?)^```', TEXT, re.S | re.M)
    lines = ['magphonon bands prototype', *(line for language, block in blocks if not language for line in block.splitlines())]
    folder = tmp_path_factory.mktemp('shell')
    shutil.copytree(README.parent / 'data', folder / 'data')
    environment = os.environ | {'PATH': f'{Path(sys.executable).parent}:{os.environ["PATH"]}', 'MPLBACKEND': 'Agg'}
    for tool, place in (('magphonon', folder), ('phonopy', folder / 'prototype-bands')):
        for line in [line for line in lines if line.startswith(tool)]:
            done = subprocess.run(line, shell=True, cwd=place, env=environment, capture_output=True, text=True)
            assert done.returncode == 0, f'{line}\n{done.stdout}\n{done.stderr}'
    return folder / 'prototype-bands'


@pytest.mark.slow
def test_the_lines_for_the_shell_draw_the_bands(shell):
    import matplotlib.image

    assert np.ptp(matplotlib.image.imread(shell / 'bands.png')[..., :3]) > 0.5


@pytest.mark.slow
def test_the_lines_for_the_shell_find_m_and_k(shell, paper):
    import yaml

    bands = yaml.safe_load((shell / 'band.yaml').read_text(encoding='utf-8'))
    pieces = np.cumsum(bands['segment_nqpoint'])
    M, K = ([mode['frequency'] for mode in bands['phonon'][end - 1]['band']] for end in pieces)
    p = paper['prototype']
    f = p['b'] * p['spacing'] ** -p['a']
    # at K each of the three bonds counts three times: m w^2 = 9/2 (phi'' + phi'/r) + k, twice
    at_k = np.sqrt((9 / 2 * (p['a'] - 1) * f / p['spacing'] + p['k_eq']) / p['mass']) / (2 * np.pi)
    assert at_k == pytest.approx(119.947, abs=5e-4)
    # phonopy's displacements are good to 1e-9 of the highest frequency; its file keeps ten decimals
    np.testing.assert_allclose(sorted(M)[1:], [58.2326897819, 149.476338113], rtol=ROUNDED)
    np.testing.assert_allclose(sorted(K)[1:], [at_k, at_k], rtol=ROUNDED)
    assert abs(M[0]) < 1e-3  # out of the plane nothing acts


FOREIGN = ('"bandpath"', '"SubFigure"')
"""Complaints of which others are the cause: ASE takes an array for pbc, and matplotlib's figure of an axis can be saved."""


def complaints(folder):
    """What pyright says of the programs in a folder: each as the name of its file and the message."""
    (folder / 'pyrightconfig.json').write_text(json.dumps({'typeCheckingMode': 'basic'}))  # it finds the package where pip put it
    done = subprocess.run([sys.executable, '-m', 'pyright', '--outputjson', '--pythonpath', sys.executable, '.'],
                          cwd=folder, capture_output=True, text=True)
    if not done.stdout.startswith('{'):
        pytest.skip(f'pyright cannot run: {done.stderr or done.stdout}')
    found = [(Path(one['file']).name, one['message']) for one in json.loads(done.stdout)['generalDiagnostics']]
    return [(file, message) for file, message in found if not any(words in message for words in FOREIGN)]


MODELS = """from magphonon import InversePower, MagneticRepulsion, analytic_bands, lattices
cell = lattices.chain(1.0, 1.0)
cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), model='conventional')
analytic_bands(cell, 'GX', model='complete')
"""


@pytest.mark.slow
def test_a_type_checker_knows_the_two_models(tmp_path):
    pytest.importorskip('pyright')
    for name, wrong in {'right': '', 'of_the_calculator': 'conventional', 'of_the_tool': 'complete'}.items():
        (tmp_path / f'{name}.py').write_text(MODELS.replace(f"'{wrong}'", "'Complete'"), encoding='utf-8')
    found = complaints(tmp_path)
    assert sorted(file for file, _ in found) == ['of_the_calculator.py', 'of_the_tool.py']
    assert all("Literal['Complete']" in message for _, message in found)


@pytest.mark.slow
def test_a_type_checker_finds_nothing_in_the_programs_and_finds_mistakes_in_them(tmp_path):
    pytest.importorskip('pyright')
    mistakes = {'keyword': ('foundation=', 'fundation='), 'name': ('analytic_bands,', 'analytical_bands,'),
                'attribute': ('linear.displacements)', 'linear.displacement)'), 'type': ('a=4.5824)', "a='4.5824')")}
    programs = re.findall(r'```python\n(.*?)```', TEXT + COMING_FROM.read_text(encoding='utf-8'), re.S)
    for k, program in enumerate(programs):
        (tmp_path / f'program_{k}.py').write_text(program, encoding='utf-8')
        for name, (right, wrong) in mistakes.items():
            if right in program:
                (tmp_path / f'{name}_{k}.py').write_text(program.replace(right, wrong), encoding='utf-8')
    found = complaints(tmp_path)
    assert [message for file, message in found if file.startswith('program')] == []
    assert {file.split('_')[0] for file, _ in found} == set(mistakes)  # the controls
