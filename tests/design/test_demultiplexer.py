"""The demultiplexer and designs of the gallery, judged without the package: workflows/built_device.py, and sums of this file."""

import ast
import csv
import runpy
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest
from ridge_lattices import cantilever

from workflows import built_device, demultiplexer
from workflows.built_device import DIAMETER, EXPONENT, MAGNET, ROD, SPRING, B, Device
from workflows.demultiplexer import SIZES, judged

ROOT = Path(__file__).parents[2]
RODS = 1.33, 1.50, 1.68, 1.89  # mm


def device():
    return Device.read(files('magphonon.data').joinpath('demultiplexer.csv'))


def test_the_judge_imports_nothing_of_the_package():
    tree = ast.parse(Path(built_device.__file__).read_text(encoding='utf-8'))
    imports = [node for node in ast.walk(tree) if isinstance(node, ast.Import | ast.ImportFrom)]
    assert {name.name if isinstance(node, ast.Import) else node.module for node in imports for name in node.names} == {
        'numpy', 'dataclasses'}


def test_it_keeps_thirty_decibels_each_way():
    found = device()
    assert replace(found, reach=np.inf).decibels().min() > 36  # a factor of two in amplitude above 30
    for control in ({'s': 1 + 0 * found.s}, {'m': 0 * found.m + MAGNET}):  # without its strengths, without the rods' mass
        assert replace(found, **control).decibels().min() < 20


def test_it_is_built_from_a_list():
    found = device()
    free = ~found.held
    assert set(found.s) == {0.87, 0.93, 1.0, 1.07, 1.15}
    rods = DIAMETER * (found.k[free] / SPRING) ** 0.25
    which = abs(rods[:, None] - RODS).argmin(1)
    np.testing.assert_allclose(rods, np.array(RODS)[which], rtol=1e-5)
    assert set(which) == {0, 1, 2, 3}
    np.testing.assert_allclose(found.m[free], MAGNET + ROD * (rods / DIAMETER) ** 2, rtol=1e-4)  # the mass follows the rod
    whole = [(a, b) for a in range(-6, 7) for b in range(-6, 7) if abs(a + b) <= 6]
    lattice = 0.01 * np.array([(a + b / 2, b * 3**0.5 / 2) for a, b in whole])
    away = abs(found.X[:, None] - lattice).max(2)
    assert sorted(away.argmin(1)) == list(range(127))
    assert away.min(1).max() < 1.01e-3  # feet within a millimetre of the lattice, along each axis
    assert away.min(1)[found.held].max() < 1e-5
    on_the_rim = [max(abs(a), abs(b), abs(a + b)) == 6 for a, b in whole]
    np.testing.assert_array_equal(found.held, np.array(on_the_rim)[away.argmin(1)])


def tables():
    """The tables of the page, by their rows' names."""
    copies, trims = (list(csv.DictReader(files('magphonon.data').joinpath(name).read_text(encoding='utf-8').splitlines()))
                     for name in ('demultiplexer_copies.csv', 'demultiplexer_trim.csv'))
    return {(row['copies'], row['of']): row for row in copies}, trims


def test_the_tables_of_the_page_say_what_the_page_says():
    copies, trims = tables()
    reached = {name: float(row['reached_dB']) for name, row in copies.items()}
    as_built = reached['errors', 'all']
    assert as_built > 28
    assert float(copies['errors', 'all']['above_30_percent']) >= 80
    for D in ('D0', 'D0 + D*'):
        for who in ('nearest', 'all'):
            if (D, who) != ('D0 + D*', 'all'):
                assert reached['designed with', f'{D}, {who} neighbours'] < 5
    assert reached['designed with', 'D0 + D*, all neighbours'] > 15
    assert reached['all, larger', 'place of each foot: 0.3 mm'] < as_built - 8
    assert reached['all, and', 'rim 64 times as stiff'] < 20 < reached['all, and', 'rim of beams 256 times as stiff as a rod']
    kept = [row for row in trims if row['model'] == 'complete']
    assert len(kept) == 10
    assert max(float(row['built_dB']) for row in kept) <= 30  # rounded
    assert sum(float(row['trimmed_dB']) > 30 for row in kept) >= 8
    assert all(float(row['chi']) < 2 for row in kept)
    refused = [row for row in trims if row['model'] == 'conventional']
    assert len(refused) == 3
    assert all(float(row['chi']) > 10 and not row['trimmed_dB'] for row in refused)


@pytest.mark.slow
def test_unseen_copies():
    """Of the same errors with other numbers; and the tolerance that matters, feet to 0.3 mm."""
    found, rng = device(), np.random.default_rng(31)
    fine = np.array([found.copy(rng, **SIZES).decibels().min() for _ in range(100)])
    coarse = np.array([found.copy(rng, **SIZES | {'foot': 0.3}).decibels().min() for _ in range(40)])
    assert np.quantile(fine, 0.2) > 28
    assert fine.min() > 14
    assert np.median(coarse) < np.median(fine) - 6
    of_page = float(tables()[0]['errors', 'all']['reached_dB'])
    assert np.quantile(judged(found), 0.2) == pytest.approx(of_page, abs=0.1)  # the row of the page is that of the solver


@pytest.mark.slow
def test_a_copy_of_the_page_is_trimmed_again(monkeypatch):
    monkeypatch.setattr(demultiplexer, 'TRIMMED', 1)
    monkeypatch.setattr(demultiplexer, 'REFUSED', 0)
    [(copy, _, before, after, chi)] = demultiplexer.trim_table(device())
    row = tables()[1][0]
    assert copy == int(row['copy'])
    assert before == float(row['built_dB'])
    assert after == pytest.approx(float(row['trimmed_dB']), abs=0.3)
    assert chi == pytest.approx(float(row['chi']), abs=0.05)


def page(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return runpy.run_path(str(ROOT / 'docs/gallery' / name))


@pytest.mark.slow
def test_the_lens_of_the_gallery(tmp_path, monkeypatch):
    found = page('2_waves/plot_26_lens.py', tmp_path, monkeypatch)
    atoms, calc = found['design'].atoms, found['design'].atoms.calc
    lens = Device(calc.anchors[:, :2] / 1e3, atoms.get_masses() / 1e3, calc.strengths, 1e3 * calc.foundation[:, 0],
                  np.isin(np.arange(len(atoms)), atoms.constraints[0].index), reach=0.045)
    K, free = lens.stiffness()
    push = np.isin(free, [2 * one.particle + 1 for one in found['row']])  # each along y
    u = np.linalg.solve(K + np.diag(lens.moving(2 * np.pi * 70)[0, free]), push)
    energy = np.zeros(2 * len(atoms))
    energy[free] = abs(u) ** 2
    loud, quiet = (energy.reshape(-1, 2)[some].sum() for some in (found['focus'], np.setdiff1d(found['far'], found['focus'])))
    assert 10 * np.log10(loud / quiet) == pytest.approx(found['design'].value, abs=0.01)
    assert found['design'].value > 20


def branches(cell, a1, a2, masses, strengths, springs, b, a, reach, q):
    """Frequencies in Hz of Bloch waves, and the forces on the particles; SI, sums over all pairs within reach."""
    n, H, F = len(cell), np.zeros((2 * len(cell), 2 * len(cell)), complex), np.zeros((len(cell), 2))
    cells = [np.array([k, m]) for k in range(-8, 9) for m in range(-8, 9)]
    for i in range(n):
        for j in range(n):
            for shift in cells:
                R = cell[j] + shift @ [a1, a2] - cell[i]
                r = np.linalg.norm(R)
                if 0 < r < reach:
                    f, e = b * strengths[i] * strengths[j] * r**-a, R / r
                    D = f / r * ((a + 1) * np.outer(e, e) - np.eye(2))
                    F[i] -= f * e
                    H[2 * i : 2 * i + 2, 2 * i : 2 * i + 2] += D
                    H[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] -= D * np.exp(2j * np.pi * (q @ shift))
    H += np.diag(np.repeat(springs, 2))
    roots = np.repeat(masses, 2) ** -0.5
    return np.sqrt(np.linalg.eigvalsh(roots[:, None] * H * roots)) / (2 * np.pi), F


@pytest.mark.slow
def test_the_gap_of_the_gallery(tmp_path, monkeypatch):
    found = page('1_bands/plot_27_designed_gap.py', tmp_path, monkeypatch)
    atoms, calc = found['design'].atoms, found['design'].atoms.calc
    [gap] = found['band_gaps'](atoms) / (2 * np.pi) * 1e3
    zone = [np.array([a, b]) / 9 for a in range(9) for b in range(9)]
    R, cell = atoms.positions[:, :2] / 1e3, atoms.cell[:2, :2] / 1e3
    springs = 1e3 * np.broadcast_to(calc.foundation, (4, 2))[:, 0]
    waves, forces = zip(*(branches(R, *cell, atoms.get_masses() / 1e3, calc.strengths, springs, B, EXPONENT, 0.045, q)
                          for q in zone), strict=True)
    waves = np.array(waves)
    np.testing.assert_allclose(forces[0], springs[:, None] * (R - calc.anchors[:, :2] / 1e3), atol=1e-9)  # N: it is at rest
    assert waves[:, :6].max() < gap[0] * 1.001
    assert waves[:, 6:].min() > gap[1] * 0.999
    assert waves[:, 6:].min() - waves[:, :6].max() < 1.1 * np.diff(gap)[0]
    assert np.diff(gap)[0] > 30


@pytest.mark.slow
@pytest.mark.parametrize('reach', [1.2, 4.5])
def test_forty_hertz(reach, tmp_path, monkeypatch, capsys):
    """The spacing, the exponent and the height that the page prints, by sums of this file."""
    page('1_bands/plot_28_forty_hertz.py', tmp_path, monkeypatch)
    lines = [line.split() for line in capsys.readouterr().out.splitlines() if f'within {reach} ' in line]
    assert len(lines) == 3
    for line in lines:
        given = {'spacing': 10.0, 'exponent': 4.5824, 'height': 150.0} | {line[4]: float(line[5].rstrip(','))}
        L, a, h = given['spacing'] / 1e3, given['exponent'], given['height'] / 150
        a1, a2 = L * np.array([[1.0, 0.0], [0.5, 3**0.5 / 2]])
        k = 19.676 / h**3
        k = k * cantilever(3 * 8.02e-4 * h * (80 * np.pi) ** 2 / k) * np.ones(1)  # at 40 Hz
        [lowest, _], _ = branches(np.zeros((1, 2)), a1, a2, 7.07e-4, np.ones(1), k, 0.2369 * 0.01**a, a, reach * L,
                                  np.array([0.5, 0]))
        assert lowest == pytest.approx(40, abs=0.1)  # four digits are printed
