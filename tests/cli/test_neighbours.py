"""What the commands say of neighbours that are left out, against bands with all of them."""

import re
import tomllib

import numpy as np
import pytest
from ridge_lattices import cantilever
from scene_files import ready_scene
from scipy.optimize import brentq
from structures import few_first

from magphonon import InversePower, MagneticRepulsion, lattices, units as u
from magphonon.bands import bloch_modes
from magphonon.cli.main import main
from magphonon.cli.neighbours import omission
from magphonon.scenes.scene import scene_of
from magphonon.stiffness import AllNeighbours

TABLE = {'kind': 'table', 'distances_m': [0.008, 0.009, 0.01, 0.011, 0.012, 0.013, 0.014, 0.015], 'shells': 1,
         'forces_N': [1.07, 0.612, 0.377, 0.246, 0.167, 0.118, 0.0857, 0.0638]}
SHIFT = re.compile(r'branch (\d) at (\w+) by ([+-][\d.]+) % to ([\d.]+) Hz')


def changed(name, **changes):
    """The tables of a ready scene with some of them changed, None for none of it."""
    tables = tomllib.loads(ready_scene(name).read_text())
    for place, value in changes.items():
        *path, key = place.split('__')
        table = tables
        for step in path:
            table = table[step]
        table.pop(key, None) if value is None else table.update({key: value})
    return tables


@pytest.mark.parametrize('kind', ['triangular', 'kagome', 'honeycomb', 'chain', 'square'])
def test_the_largest_shift_is_that_of_all_neighbours(kind):
    held = {'stiffness_N_per_m': 200.0}
    scene = scene_of(changed('square', lattice__kind=kind, foundation=held, patch=None, burst=None, bands=None))
    (line,) = omission(scene, True)
    assert line.startswith('Nearest neighbours only (shells = 1): farther ones would shift ')
    cell = scene.perfect_cell()
    every = cell.copy()
    every.calc = AllNeighbours(cell, cell.calc.laws, foundation=cell.calc.foundation)
    points = scene.special_points
    ((branch, point, percent, to),) = SHIFT.findall(line)
    few, many = (u.hertz(bloch_modes(atoms, list(points.values()))[0]) for atoms in (cell, every))
    at = [*points].index(point), int(branch) - 1
    assert float(percent) == pytest.approx(100 * (many / few - 1)[at], abs=0.51 * 10 ** -('.' in percent))
    assert float(to) == pytest.approx(many[at], rel=1e-3)
    assert abs(many / few - 1)[few > 0.01 * few.max()].max() == pytest.approx(abs(many / few - 1)[at])


def test_heavy_pillars_lower_what_farther_neighbours_raise():
    text = ready_scene('prototype').read_text().replace('# density_kg_per_m3', 'density_kg_per_m3')
    (line,) = omission(scene_of(tomllib.loads(text)), True)
    k, m, M = 19.6757, 2700 * np.pi * 7.9375e-4**2 * 0.15, 7.07e-4
    ((branch, point, _, to),) = SHIFT.findall(line)
    squares = (2 * np.pi * 67.4525) ** 2 * M - k  # of the magnets alone, by an exact sum over all neighbours on massless pillars
    w = brentq(lambda w: M * w**2 - squares - k * cantilever(3 * m * w**2 / k), 1.0, 400.0)
    assert (branch, point, float(to)) == ('1', 'M', pytest.approx(w / (2 * np.pi), rel=2e-4))  # four digits are printed
    assert float(to) < 0.9 * 67.4525


@pytest.mark.parametrize(('name', 'changes', 'words'), [
    ('oscillator', {}, None), ('steel', {}, None), ('neighbours', {}, None), ('wigner', {'law__shells': None}, None),
    ('prototype', {'law__shells': None}, None),
    ('prototype', {'law__shells': 5},
     r'^5 shells of neighbours \(shells = 5\): farther ones would shift branch 1 at M .* Omit law.shells'),
    ('rings', {'law': TABLE},
     r'if the forces keep falling as they do at the end of the table\. Measure the force at larger distances'),
])
def test_what_is_said_where_it_matters(name, changes, words):
    told = omission(scene_of(changed(name, **changes)), True)
    assert len(told) == bool(words)
    assert not words or re.search(words, told[0])


DISCS = """title = "8 mm discs"
lattice = {kind = "triangular", spacing_m = 0.008, mass_kg = 0.0008}
law = {kind = "inverse_power", b_N_m_a = 6.4545e-9, a = 3.8}
foundation = {stiffness_N_per_m = 20.0}
uncertainty = {spacing_percent = 1.0}
bands = {path = "GMKG", points = 20}
"""


@pytest.mark.slow
def test_an_interval_that_neighbours_leave_is_named(tmp_path, capsys):
    for shells in (1, None):
        (tmp_path / 'my.toml').write_text(DISCS if shells is None else DISCS.replace('a = 3.8', 'a = 3.8, shells = 1'))
        assert main(['bands', '--verbose', str(tmp_path / 'my.toml'), '-o', str(tmp_path / f'out_{shells}')]) == 0
        text = capsys.readouterr().out
        assert ('branch 1 at M by more than the 95 % interval.' in text) == (shells == 1)
        assert 'at G' not in text.partition('not enough here')[2].partition('\n')[0]  # where nothing moves it, and no interval is
        assert 'branch 1 at K' not in text.partition('not enough here')[2].partition('\n')[0]  # moved by less than the interval
    rows = [line.split() for line in text.splitlines() if line.startswith('  M, branch 1')]
    value, std = float(rows[0][3]), float(rows[-1][3])
    law, truths = InversePower(0.6 * 8**3.8, 3.8), []
    for kind in (AllNeighbours, MagneticRepulsion):
        cell = lattices.triangular(8.0, 0.8)
        cell.calc = kind(cell, law, foundation=0.02)
        truths.append(u.hertz(bloch_modes(cell, [[0.5, 0, 0]])[0][0, 0]))
    assert abs(truths[0] - value) < 0.1 * std
    assert abs(truths[1] - value) > 1.96 * std  # the control


@pytest.mark.parametrize(('command', 'name', 'words'), few_first([
    ('check', 'prototype', 'branch 1 at M by +16 %'), ('modes', 'prototype', 'branch 1 at M by +16 %'),
    ('explore', 'prototype', 'branch 1 at M by +16 %'),
    ('bands', 'chain', 'branch 1 at X by -0.91 %')], 1))
def test_every_command_says_it(command, name, words, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr('magphonon.plotting.explorer.VALUES', 10)  # each value of a slider costs the foundation that it needs
    where = {'check': [], 'explore': ['-o', str(tmp_path / 'x.html')]}.get(command, ['-o', str(tmp_path / 'out')])
    file = tmp_path / 'my.toml'
    file.write_text(ready_scene(name).read_text().replace('side_m = 0.3 ', 'side_m = 0.05 '))
    main([command, *['--verbose'] * (command != 'explore'), str(file), *where])
    text = capsys.readouterr().out
    assert 'Nearest neighbours only (shells = 1): farther ones would shift ' in text
    assert words in text
    assert text.count('farther ones would shift') == text.count('Omit law.shells') == 1
