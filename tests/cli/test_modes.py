"""`magphonon modes` on lattices, patches and structures from files: what is written and what is said."""

import csv

import numpy as np
import pytest
from motion import L0, LAW, MASS
from scene_files import ready_scene

from magphonon import MagneticRepulsion, lattices, modes, relaxed
from magphonon.cli.main import main
from magphonon.response.normal_modes import Localisation
from magphonon.scenes import write_scene
from magphonon.scenes.scene import read_scene


@pytest.fixture
def prototype(tmp_path):
    """The prototype's scene with a smaller patch."""
    text = ready_scene('bench').read_text()
    assert 'side_m = 0.3 ' in text
    file = tmp_path / 'my.toml'
    file.write_text(text.replace('side_m = 0.3 ', 'side_m = 0.08 '))
    return file


def table(file):
    with open(file, newline='') as rows:
        header, *rows = csv.reader(rows)
    return dict(zip(header, np.array(rows, dtype=float).T, strict=True))


@pytest.mark.slow
def test_modes_of_the_prototype(prototype, tmp_path, capsys):
    out = tmp_path / 'out'
    assert main(['modes', '--verbose', str(prototype), '-o', str(out), '--animate', '2']) == 0
    assert {file.name for file in out.iterdir()} == {'modes.png', 'modes_lattice.png', 'modes_lattice.csv', 'modes.csv',
                                                     'modes.npz', 'mode_2.gif'}
    lines = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ['M,', 'branch', '1', '58.2327', '92.106', 'shear'] in lines
    assert lines[0][-7:] == ['outside', 'the', 'bands', 'of', 'the', 'lattice:', 'none']
    expected = modes(read_scene(prototype).patch_atoms()).frequencies_Hz
    np.testing.assert_allclose(table(out / 'modes.csv')['frequency_Hz'], expected, rtol=1e-12)
    np.testing.assert_allclose(Localisation.load(out / 'modes.npz').frequencies_Hz, expected, rtol=1e-12)


def test_a_scene_without_a_patch_and_one_out_of_a_file(tmp_path, capsys):
    chain = tmp_path / 'chain.toml'
    chain.write_text(ready_scene('chain').read_text())
    assert main(['modes', '--verbose', str(chain), '-o', str(tmp_path / 'modes')]) == 0
    assert {file.name for file in (tmp_path / 'modes').iterdir()} == {'modes_lattice.csv'}
    told = capsys.readouterr().out.splitlines()
    assert ['X,', 'branch', '1', '15.9155', '35.5881', 'transverse'] in [line.split() for line in told]
    assert any(line.startswith('no picture') for line in told)
    atoms = lattices.parallelogram(lattices.triangular(L0, MASS), 7, 7)
    light = 24
    masses = atoms.get_masses()
    masses[light] *= 0.2
    atoms.set_masses(masses)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.0196757)
    write_scene(relaxed(atoms).atoms, tmp_path / 'file.toml', title='a light magnet')
    assert main(['modes', '--verbose', str(tmp_path / 'file.toml'), '-o', str(tmp_path / 'light')]) == 0
    shown = capsys.readouterr().out
    assert 'modes of the structure: all 50, from' in shown


@pytest.mark.slow
def test_a_local_mode_is_named(prototype, tmp_path, capsys, monkeypatch):
    cell = lattices.triangular(L0, MASS)

    def with_a_light_magnet(scene, model='complete'):
        atoms = lattices.parallelogram(cell, 9, 9)
        masses = atoms.get_masses()
        masses[40] *= 0.2
        atoms.set_masses(masses)
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.0196757, model=model)
        return atoms

    monkeypatch.setattr('magphonon.scenes.scene.Scene.patch_atoms', with_a_light_magnet)
    found = {}
    for most in (3000, 20):  # all modes; the lowest ones and those between the bands
        monkeypatch.setattr('magphonon.response.normal_modes.MOST_DIRECTIONS', most)
        monkeypatch.setattr('magphonon.response.normal_modes.LOWEST', 8)
        assert main(['modes', '--verbose', str(prototype), '-o', str(tmp_path / 'out'), '--force']) == 0
        shown = capsys.readouterr().out
        assert 'outside the bands of the lattice: 2' in shown
        found[most] = [line.split(': ')[1] for line in shown.splitlines() if line.startswith('  mode ')]
    assert found[3000] == found[20]
    assert table(tmp_path / 'out' / 'modes.csv')['mode'].tolist() == list(range(1, 11))


def test_what_cannot_be_done_is_refused(prototype, tmp_path, capsys):
    oscillator = tmp_path / 'oscillator.toml'
    oscillator.write_text(ready_scene('oscillator').read_text())
    chain = tmp_path / 'chain.toml'
    chain.write_text(ready_scene('chain').read_text())
    for arguments, words in ((['modes', str(oscillator)], 'use "magphonon frf"'),
                             (['modes', str(chain), '--animate', '1'], 'has no patch whose modes could be computed'),
                             (['modes', str(prototype), '--animate', '99999'], '--animate must be the number of a mode, 1 to ')):
        assert main([*arguments, '-o', str(tmp_path / 'out')]) == 2
        assert words in capsys.readouterr().err
        assert not (tmp_path / 'out').exists()
