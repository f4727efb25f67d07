"""`magphonon bands`: its words, its numbers from closed forms, and that it fails where phonopy and D0 + D* disagree."""

import csv

import numpy as np
import pytest
from numpy.testing import assert_allclose
from structures import few_first

from magphonon import lattices
from magphonon.bands import Bands
from magphonon.cli.band_report import disagreement
from magphonon.cli.bands import _bands
from magphonon.cli.main import main
from magphonon.interactions import Cable, Spring
from magphonon.scenes import write_scene
from magphonon.scenes.scene import read_scene, reference
from magphonon.stiffness import PairCalculator

FILES = {'bands.png', 'zone.png', 'bands.csv', 'bands_complete.npz', 'bands_conventional.npz', 'bands_phonopy.npz', 'band.yaml',
         'phonopy_params.yaml'}
NUMBERS = reference()['prototype']
PRESSURE, A = 3**0.5 * NUMBERS['f_at_spacing'] / NUMBERS['spacing'], NUMBERS['a']  # closed forms of the triangular lattice

# scene, changes of its text, what it must say, files that it does not write.  The ideal law has f(L0)/L0 = 10 kN/m.
SCENES = {
    'prototype': ('bench', {}, [
        'M, branch 1 58.23269 92.106 58.23269', 'cut-off frequency (lowest at Gamma): 26.55069 Hz\n',  # sqrt(k/M)/2 pi
        "foundation: 19.6757 N/m in the scene; phonopy's force constants sum to 19.6757 N/m",
        f'removed: pressure {PRESSURE:.6g} N/m, bulk modulus {(A + 1) / 2 * PRESSURE:.6g} N/m, shear modulus',
        f"Poisson's ratio {(A + 5) / (3 * A - 1):.4g}", 'Stable in the plane, even without a foundation.'], set()),
    'chain on too soft springs': ('chain', {'5e4': '3e4'}, [  # it needs 4 f(L0)/L0
        'UNSTABLE: the static forces buckle this lattice; the softest mode is at q = (0.5, 0, 0)',
        # sqrt(3e4 N/m / M)/2 pi at Gamma; the branch across the chain falls from there through zero
        'cut-off frequency (lowest at Gamma): 27.56644 Hz; lowest on the path: -15.91549 Hz\n',
        'needs a foundation of 40000 N/m and has 30000 N/m', 'X, branch 1 -15.91549 27.56644 -15.91549'], {'zone.png'}),
    'square, unstable off the path alone': ('ideal', {'"triangular"': '"square"', 'GMKG': 'GM', '[bands]':
                                                      '[foundation]\nstiffness_N_per_m = 2e4\n\n[bands]'}, [
        'needs a foundation of 40000 N/m and has 20000 N/m'], set()),
    'kagome of D0 alone has a mode without stiffness': ('ideal', {'"triangular"': '"kagome"', 'points = 300': 'points = 3'}, [
        'none: a zero-stiffness mode'], set()),
    'w/k of electrons grows without end': ('wigner', {'points = 300': 'points = 3'}, [
        'unbounded', 'phonopy_params.yaml is not written'], {'phonopy_params.yaml'}),
    'all neighbours': ('bench', {'shells = 1': 'shells = "all"'}, ['at wavevectors commensurate with the supercell'], set()),
}


@pytest.mark.parametrize('name', few_first(SCENES, 4))
def test_the_report_says_what_theory_says(name, scene_file, tmp_path, capsys):
    base, changes, words, absent = SCENES[name]
    assert main(['bands', '--verbose', str(scene_file(changes, base)), '-o', str(tmp_path / 'out')]) == 0
    said = capsys.readouterr().out
    plain = '\n'.join(' '.join(line.split()) for line in said.splitlines()) + '\n'
    assert [phrase for phrase in words if phrase not in plain] == []
    assert ('UNSTABLE' in said) == (base in ('chain', 'ideal'))  # of which all here buckle
    assert not {'nan', 'inf'} & set(said.split())
    assert {file.name for file in (tmp_path / 'out').iterdir()} == FILES - absent
    if 'off the path' in name:
        assert Bands.load(tmp_path / 'out' / 'bands_complete.npz').omega.min() > 0
    if name == 'prototype':
        tables_of_the_prototype(tmp_path / 'out')


def tables_of_the_prototype(out):
    with open(out / 'bands.csv', newline='') as file:
        header, *rows = csv.reader(file)
    table = {name: np.array(column, dtype=float) for name, column in zip(header, zip(*rows, strict=True), strict=True)}
    assert header == ['path_rad_per_m', 'q1', 'q2', 'q3', 'complete_1_Hz', 'complete_2_Hz', 'conventional_1_Hz',
                      'conventional_2_Hz', 'phonopy_1_Hz', 'phonopy_2_Hz']
    M = np.argmin(abs(table['path_rad_per_m'] - 2 * np.pi / np.sqrt(3) / 0.01))  # from Gamma: 2 pi/(sqrt(3) L0)
    # analytic to the digits of the reference; phonopy to what its default displacement promises
    for model, truth, rtol in zip(('complete', 'conventional', 'phonopy'), ('complete', 'conventional', 'complete'),
                                  (1e-9, 1e-9, 1e-8), strict=True):
        assert_allclose([table[f'{model}_{mode}_Hz'][M] for mode in (1, 2)], NUMBERS[f'M_{truth}_Hz'], rtol=rtol)
    assert_allclose(Bands.load(out / 'bands_complete.npz').frequencies_Hz[:, 0], table['complete_1_Hz'], rtol=1e-13)


@pytest.mark.slow
def test_coulomb_crystal_in_space_has_no_conventional_model(scene_file, tmp_path, capsys):
    """At H all branches of bcc have w_p/sqrt(3), w_p^2 = 4 pi n Q^2/(4 pi eps0 M); D0 alone diverges, and is left out."""
    file = scene_file({'"triangular"': '"bcc"', '"GMKG"': '"GH"', 'points = 300': 'points = 5', '[6, 6]': '[2, 2, 2]'}, 'wigner')
    assert main(['bands', '--verbose', str(file), '-o', str(tmp_path / 'out')]) == 0
    assert 'no conventional model: the sums of D0 and D* diverge' in capsys.readouterr().out
    assert not (tmp_path / 'out' / 'bands_conventional.npz').exists()
    n = 3 * 3**0.5 / 4 / 5.1e-6**3  # two particles in a cube of 2/sqrt(3) L0
    plasma = (n * 1.602176634e-19**2 / 8.8541878128e-12 / 9.1093837e-31) ** 0.5
    omega = Bands.load(tmp_path / 'out' / 'bands_complete.npz').frequencies_Hz[-1] * 2 * np.pi
    assert_allclose(omega, plasma / 3**0.5, rtol=1e-8)  # eps0 is printed to 1e-9


@pytest.mark.parametrize(('law', 'rest', 'disagree'), [
    (Spring, 10.0, False), (Spring, 10.0000000001, False), (Spring, 10.5, False), (Spring, 12.0, False), (Cable, 9.9, False),
    (Cable, 10 * (1 - 1e-11), True)])  # it goes slack within any displacement
def test_bands_fails_where_the_two_roads_disagree(law, rest, disagree, tmp_path, capsys):
    net = lattices.triangular(10.0, 1.0)
    net.calc = PairCalculator(net, law(0.02, rest), foundation=0.01)
    write_scene(net, tmp_path / 'net.toml')
    scene = read_scene(tmp_path / 'net.toml')
    bands, _ = _bands(scene, scene.perfect_cell(), scene.band_path())
    assert bool(disagreement(scene, bands)) == disagree
    if disagree:
        assert main(['bands', str(tmp_path / 'net.toml'), '-o', str(tmp_path / 'out')]) == 1
        assert 'disagree' in capsys.readouterr().out
