"""Measured shapes beside computed ones: of specimens that the package did not simulate, mixed, few, noisy and wrong."""

import re

import numpy as np
import pytest
from ase.constraints import FixAtoms

from magphonon import InversePower, MagneticRepulsion, lattices, modes, read_scene
from magphonon.cli.main import main
from magphonon.response import compared
from magphonon.response.measured_shapes import ALIKE
from workflows import bench_lattice as bench

SPACING = 10.0
SCENE = """title = "Patch"
[lattice]
kind = "file"
file = "particles.csv"
mass_kg = 8e-4
cutoff_m = {cutoff}
positions = "rest"
[law]
kind = "inverse_power"
b_N_m_a = {b!r}
a = 3.77
shells = 1
[foundation]
stiffness_N_per_m = 60.0
"""


def written(folder, places, shapes, directions=('u_x', 'u_y'), frequencies=None, noise=0.0, factor=1.0):
    """A table of shapes (modes, points, 2) of any amplitude and phase at places in mm."""
    rng = np.random.default_rng(5)
    rows = ['mode,frequency_Hz,x_mm,y_mm,' + ','.join(f'{name},{name}_im' for name in directions)]
    for k, shape in enumerate(shapes):
        u = factor * rng.uniform(0.1, 10) * (shape / abs(shape).max() + noise * rng.normal(size=shape.shape))
        f = k + 1.0 if frequencies is None else frequencies[k]
        for (x, y), (ux, uy) in zip(places, u, strict=True):
            each = [f'{part:.9g}' for name, one in (('u_x', ux), ('u_y', uy)) if name in directions
                    for part in (np.real(one), np.imag(one))]
            rows.append(f'm{k + 1},{f:.9g},{x:.9g},{y:.9g},' + ','.join(each))
    (folder / 'shapes.csv').write_text('\n'.join(rows))
    return folder / 'shapes.csv'


@pytest.fixture
def patch():
    """A hexagon of equal masses, whose shapes are orthogonal, in a frame that hides no axis."""
    atoms = lattices.hexagon(lattices.triangular(SPACING, 0.8), 3 * SPACING)
    atoms.calc = MagneticRepulsion(atoms, InversePower(2000.0, 4.0), foundation=0.06)
    return atoms


@pytest.mark.parametrize(('share', 'alike'), [(ALIKE + 0.01, True), (ALIKE - 0.01, False)])
def test_a_mixture_is_the_mode_of_which_it_has_more_than_half(share, alike, patch, tmp_path):
    found = modes(patch)
    mixed = np.sqrt(share) * found.shapes[4] + np.sqrt((1 - share) / 2) * (found.shapes[9] + found.shapes[20])
    comparison = compared(written(tmp_path, patch.positions[:, :2], [mixed], factor=np.exp(0.7j)), patch, found)
    assert comparison.mac[0, 4] == pytest.approx(share, abs=1e-6)  # of the digits of the table
    assert (comparison.mac[0, 4] > comparison.least[0]) == alike
    assert (comparison.mac[0] > ALIKE).sum() == alike


@pytest.mark.parametrize('points', [2, 4, 10])
def test_few_points_match_by_chance_no_more_often_than_stated(points, patch, tmp_path):
    """One in a hundred, by chance within 0.0016 for 4000 unrelated shapes.  With a half alone most of them match."""
    rng, found = np.random.default_rng(points), modes(patch)
    free = np.flatnonzero(np.any(found.shapes, axis=(0, 2)))
    at = rng.choice(free, points, replace=False)
    comparison = compared(written(tmp_path, patch.positions[at, :2], rng.normal(size=(4000, points, 2))), patch, found)
    best = comparison.mac.max(axis=1)
    assert (best > comparison.least).mean() < 0.02
    assert ((best > ALIKE).mean() > 0.3) == (points < 10)  # the control


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(2))
def test_shapes_of_a_specimen_find_their_modes(seed, tmp_path, capsys):
    """Half of its magnets, one direction, 10 % noise: each of the six lowest is found; with nearest neighbours fewer are."""
    rng, a, force = np.random.default_rng(seed), 3.77, 0.2883
    law = bench.tabulated(bench.power_law(force, a, 10e-3), 5e-3, 0.06)
    lab = bench.built(bench.sites(bench.triangular(10e-3), 0.075, 0.07), law, 0.05, rng, springs=(60.0, 60.0),
                      scatter=(0.01, 5e-5, 0.02, 0.002))
    omega, shapes = bench.modes(lab)
    seen = rng.permutation(np.flatnonzero(~lab.held))[: (~lab.held).sum() // 2]
    table = written(tmp_path, 1e3 * lab.rest[seen], shapes[seen, :, :6].transpose(2, 0, 1), frequencies=omega[:6] / (2 * np.pi),
                    noise=0.1)
    rows = [f'{x!r},{y!r},{int(held)}' for (x, y), held in zip(lab.rest.tolist(), lab.held, strict=True)]
    (tmp_path / 'particles.csv').write_text('\n'.join(['x_m,y_m,held', *rows]))
    matched = {}
    for cutoff in (0.05, 0.012):
        (tmp_path / 'patch.toml').write_text(SCENE.format(cutoff=cutoff, b=force * 10e-3**a))
        assert main(['modes', str(tmp_path / 'patch.toml'), '--compare', str(table), '-o', str(tmp_path / f'out{cutoff}')]) == 0
        shown = capsys.readouterr().out
        matched[cutoff] = {int(name): int(mode) for name, mode in re.findall(r'm(\d), [\d.]+ Hz: mode (\d+), .*MAC', shown)}
    own = np.diff(omega[:7])[[0, 0, 1, 2, 3, 4]] / omega[:6] > 0.02  # others mix with their neighbours
    assert {name: mode for name, mode in matched[0.05].items() if own[name - 1] and own[min(name, 5)]}.items() <= {
        (k + 1, k + 1) for k in range(6)}
    assert len(matched[0.05]) >= 4
    columns = np.genfromtxt(tmp_path / 'out0.05' / 'mac.csv', delimiter=',', names=True)
    found = modes(read_scene(tmp_path / 'patch.toml').atoms())
    assert len(columns) == len(found.omega)
    assert columns['mac_1'].max() > 0.8
    assert (tmp_path / 'out0.05' / 'mac.png').exists()


@pytest.mark.parametrize(('text', 'message'), [
    ('mode,x_mm,y_mm\n1,0,0\n', 'has neither u_x nor u_y'),
    ('mode,x_mm,y_mm,u_x\n1,0,0,1\n1,4,3,1\n', 'line 3 of .*: the nearest particle is 5 mm from x_mm, y_mm'),
    ('mode,x_mm,y_mm,u_x\n1,0,0,1\n1,0.1,0,2\n', 'the mode 1 has two rows for one particle'),
    ('mode,x_mm,y_mm,u_x\n1,0,0,0\n1,10,0,0\n', 'nothing moves in the mode 1'),
    ('mode,frequency_Hz,x_mm,y_mm,u_x\n1,0,0,0,1\n', 'line 2 of .*: frequency_Hz must be positive; leave the column out'),
    ('mode,frequency_Hz,x_mm,y_mm,u_x\n1,-40,0,0,1\n', 'line 2 of .*: frequency_Hz must be positive'),
])
def test_refusals(text, message, patch, tmp_path):
    (tmp_path / 'shapes.csv').write_text(text)
    with pytest.raises(ValueError, match=message):
        compared(tmp_path / 'shapes.csv', patch, modes(patch))


def test_one_direction_of_one_magnet_matches_nothing(patch, tmp_path):
    (tmp_path / 'shapes.csv').write_text('mode,x_mm,y_mm,u_x\n1,0,0,1\n')
    comparison = compared(tmp_path / 'shapes.csv', patch, modes(patch))
    assert comparison.mac.max() == pytest.approx(1)
    assert not (comparison.mac > comparison.least[:, None]).any()


@pytest.mark.parametrize(('factor', 'told'), [(1.0, False), (1.2, False), (0.5, True)])
def test_a_match_far_off_in_frequency_gets_a_word(factor, told, patch, tmp_path):
    from magphonon.cli.modes import matches

    found = modes(patch)
    table = written(tmp_path, patch.positions[:, :2], found.shapes[:3], frequencies=factor * found.frequencies_Hz[:3])
    lines = matches(compared(table, patch, found), found)
    assert [('too far apart in frequency' in line) for line in lines[1:]] == [told] * 3


@pytest.mark.parametrize(('factor', 'own'), [(1.0, True), (1.2, True), (3.0, False)])
def test_frequency_decides_between_modes_that_look_alike_at_few_points(factor, own, tmp_path):
    """Every second particle of a row tells a wave from its folded twin by frequency alone."""
    from magphonon.cli.modes import matches

    row = lattices.chain(SPACING, 0.8).repeat((24, 1, 1))
    row.pbc = False
    row.set_constraint(FixAtoms([0, 23]))
    row.calc = MagneticRepulsion(row, InversePower(2000.0, 4.0), foundation=0.06)
    found, at = modes(row), np.arange(0, 24, 2)
    along = np.flatnonzero((found.shapes[..., 0] ** 2).sum(axis=1) > (found.shapes[..., 1] ** 2).sum(axis=1))
    lowest = along[1]
    table = written(tmp_path, row.positions[at, :2], found.shapes[[lowest]][:, at], ('u_x',),
                    factor * found.frequencies_Hz[[lowest]])
    comparison = compared(table, row, found)
    twin = int(np.where(abs(found.omega / found.omega[lowest] - 1) > 0.6, comparison.mac[0], 0).argmax())
    assert comparison.mac[0, twin] > comparison.least[0]  # alone by its shape it could be either
    assert (comparison.best[0] == lowest) == own
    line, = matches(comparison, found)[1:]
    assert 'looks the same (aliasing)' in line
