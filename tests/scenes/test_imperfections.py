"""Defects in scenes: the tables against structures built in Python, what the reports say, and what is refused."""

import json
import re
import tomllib

import numpy as np
import pytest
from numpy.testing import assert_allclose
from scene_files import ready_scene
from scipy.optimize import minimize

from magphonon import MagneticRepulsion, relaxed, units as u
from magphonon.cli.main import main
from magphonon.errors import Unstable
from magphonon.response import natural_frequencies
from magphonon.scenes.scene import Scene, read_scene
from magphonon.stiffness.defects import with_vacancies

HZ = 1e3 / (2 * np.pi)


def tables(name='vacancy', **changes):
    return tomllib.loads(ready_scene(name).read_text(encoding='utf-8')) | changes


def scene(**changes):
    data = tables(**changes)
    return Scene.model_validate({key: value for key, value in data.items() if value is not None})


@pytest.mark.slow
def test_the_ready_scene_has_local_modes_in_the_gap():
    """Frequencies found independently by others, printed digits; unrelaxed they are not there."""
    ready = scene()
    f = natural_frequencies(ready.patch_atoms()) * HZ
    assert_allclose(f[(f > 71) & (f < 86)], [78.83, 78.83, 80.27], atol=0.005)
    rest = ready.relaxation()
    assert rest.shift == pytest.approx(2.85, abs=0.005)
    perfect = scene(defects=None).patch_atoms()
    assert len(perfect) == 200
    f = natural_frequencies(perfect) * HZ
    assert not ((f > 71) & (f < 86)).any()  # no mode of the perfect lattice lies there
    # control: the hole alone, held in balance by a load, without the motion towards it
    unrelaxed = with_vacancies(perfect, [0])
    unrelaxed.calc = unrelaxed.calc.balanced(range(199))
    f = natural_frequencies(unrelaxed) * HZ
    assert not ((f > 78.7) & (f < 80.4)).any()
    # how far the sites moved, counted by hand
    start = with_vacancies(perfect, [0]).positions
    far = np.linalg.norm(rest.atoms.positions - start, axis=1)
    assert rest.rms == pytest.approx(np.sqrt((far**2).mean()), rel=1e-9)


@pytest.mark.slow
def test_check_and_frf_say_how_far_the_sites_moved(tmp_path, capsys):
    text = ready_scene('vacancy').read_text(encoding='utf-8').replace('points = 401', 'points = 3')
    text = text.replace('_1 = 10', '_1 = 5').replace('_2 = 10', '_2 = 5')
    (tmp_path / 'v.toml').write_text(text)
    rest = scene(patch=PATCH | {'cells_2': 5}).relaxation()
    moved = f'moved by up to {rest.shift:.4g} mm (rms {rest.rms:.4g} mm)'
    assert main(['check', '--verbose', str(tmp_path / 'v.toml')]) == 0
    said = capsys.readouterr().out
    assert moved in said
    assert 'This equilibrium is stable' in said
    assert main(['frf', '--verbose', str(tmp_path / 'v.toml'), '-o', str(tmp_path / 'out')]) == 0
    assert moved in capsys.readouterr().out
    (tmp_path / 'soft.toml').write_text(text.replace('stiffness_N_per_m = 80.0', 'stiffness_N_per_m = 1.0'))
    assert main(['check', '--verbose', str(tmp_path / 'soft.toml')]) == 1
    said = capsys.readouterr().out
    assert 'soft.toml with [defects]: ' in said
    assert 'buckles or slides' in said


FIRST, SECOND = [0.01, 0.015], [0.03, 0.02]
PATCH = {'kind': 'supercell', 'cells_1': 5, 'cells_2': 6}


@pytest.mark.parametrize('model', ['complete', 'conventional'])
def test_the_tables_build_what_python_builds(model):
    defects = {'vacancies_m': [FIRST, SECOND]}
    found = scene(patch=PATCH, defects=defects, frf=None)
    ours = scene(patch=PATCH, defects=None, frf=None).patch_atoms(model)
    nearest = [np.linalg.norm(ours.positions[:, :2] - np.array(place) * u.m, axis=1).argmin() for place in (FIRST, SECOND)]
    ours = relaxed(with_vacancies(ours, nearest)).atoms
    theirs = found.patch_atoms(model)
    assert len(theirs) == 58
    assert np.array_equal(theirs.positions, ours.positions)
    assert np.array_equal(theirs.calc.rest_hessian(model).toarray(), ours.calc.rest_hessian(model).toarray())
    assert theirs.calc.model == model


def test_a_patch_with_a_rim_keeps_it():
    """Hexagon of the prototype: one magnet in its middle is missing; the rim stays held where it was."""
    whole = scene(name='bench', patch={'kind': 'hexagon', 'side_m': 0.05}, burst=None, frf=None,
                  foundation={'stiffness_N_per_m': 60.0})
    holed = scene(name='bench', patch={'kind': 'hexagon', 'side_m': 0.05}, burst=None, frf=None,
                  foundation={'stiffness_N_per_m': 60.0}, defects={'vacancies_m': [[0.0, 0.0]]})
    perfect, atoms = whole.patch_atoms(), holed.patch_atoms()
    assert len(atoms) == len(perfect) - 1
    kept = np.linalg.norm(perfect.positions, axis=1) > 1
    rim = perfect.get_tags()[kept] == 1
    assert np.array_equal(atoms.get_tags(), perfect.get_tags()[kept])
    assert np.array_equal(atoms.positions[rim], perfect.positions[kept][rim])
    assert abs(atoms.get_forces()).max() < 1e-8
    # by hand: the particle deleted first, the calculator made afterwards, relaxed
    again = perfect[kept]
    again.calc = MagneticRepulsion(again, perfect.calc.laws, foundation=0.06, cutoff=12.0)
    assert_allclose(atoms.positions, relaxed(again).atoms.positions, atol=1e-9)


@pytest.mark.parametrize(('changes', 'message'), [
    ({'defects': {}}, "defects lacks the key 'vacancies_m'"),
    ({'defects': {'vacancies_m': [[5.0, 0.0]]}, 'patch': {'kind': 'parallelogram', 'cells_1': 7, 'cells_2': 7}, 'frf': None},
     r's\.toml: defects\.vacancies_m\[0\] = \[5\.0, 0\.0\] is outside the structure'),
    ({'defects': {'vacancies_m': [[0.0, 0.0], [0.0, 1e-4]]}}, r'names the particle at \[0, 0\] twice'),
    ({'defects': {'vacancies_m': [[0.0]]}}, r'vacancies_m\[0\] must be a place \[x, y\]'),
    ({'patch': None, 'frf': None}, r'defects: there is no structure for it; add a table \[patch\]'),
])
def test_unsuitable_tables_are_refused(changes, message, tmp_path, capsys):
    def written(value):
        if isinstance(value, dict):
            return '{' + ', '.join(f'{key} = {written(item)}' for key, item in value.items()) + '}'
        return '[' + ', '.join(map(written, value)) + ']' if isinstance(value, list) else json.dumps(value)

    data = {key: value for key, value in tables(**changes).items() if value is not None}
    (tmp_path / 's.toml').write_text('\n'.join(f'{key} = {written(value)}' for key, value in data.items()))
    status = main(['check', '--verbose', str(tmp_path / 's.toml')])
    said = capsys.readouterr()
    assert status in (1, 2)
    assert re.search(message, said.err + said.out)


def lost(K, b=1.6209e-10, a=4.5824, L=0.01, n=4):
    """Largest motion in mm of the magnets around a hole in the paper's lattice on foundations of K N/m, by its energy alone."""
    grid = [(i + j / 2, j * 0.75**0.5) for i in range(-n, n + 1) for j in range(-n, n + 1) if abs(i + j) <= n and (i or j)]
    P = L * np.array(grid)
    pairs = np.array([(i, j) for i in range(len(P)) for j in range(i) if np.hypot(*(P[i] - P[j])) < 1.01 * L])
    free = np.hypot(*P.T) < (n - 0.9) * L

    def energy(x):
        u = np.zeros_like(P)
        u[free] = 1e-3 * x.reshape(-1, 2)
        D = (P + u)[pairs[:, 1]] - (P + u)[pairs[:, 0]]
        r = np.hypot(*D.T)
        G = K * u
        np.add.at(G, pairs[:, 0], (b * r ** (-a - 1))[:, None] * D)
        np.add.at(G, pairs[:, 1], -(b * r ** (-a - 1))[:, None] * D)
        return 1e3 * ((b / (a - 1) * r ** (1 - a)).sum() + K / 2 * (u * u).sum()), G[free].ravel()

    start = 1e-3 * np.random.default_rng(1).standard_normal(2 * free.sum())
    options = {'maxiter': 2000, 'ftol': 1e-15, 'gtol': 1e-9}
    return abs(minimize(energy, start, jac=True, method='L-BFGS-B', options=options).x).max()


@pytest.mark.slow
def test_a_hole_that_does_not_hold_names_the_foundation_that_holds_it(tmp_path):
    """In the paper's own lattice; with the weaker of the two a magnet falls into the hole, by a relaxation of its own."""
    file = tmp_path / 'hole.toml'
    text = ready_scene('prototype').read_text(encoding='utf-8').replace('side_m = 0.3 ', 'side_m = 0.1 ')
    file.write_text(f'{text}\n[defects]\nvacancies_m = [[0.0, 0.04]]\n')
    with pytest.raises(Unstable, match=r'a foundation of (\S+) N/m holds it, (\S+) N/m do not') as refused:
        read_scene(file).relaxation()
    enough, weak = map(float, re.findall(r'(\S+) N/m', str(refused.value)))
    assert weak < enough < 1.3 * weak
    assert lost(enough) < 2 < lost(weak)  # mm
    file.write_text(re.sub(r'(?s)\[foundation.*?(?=\n\[)', f'[foundation]\nstiffness_N_per_m = {enough}\n', file.read_text()))
    assert read_scene(file).relaxation().shift < 1
