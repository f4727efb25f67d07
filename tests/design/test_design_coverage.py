"""Designed lattices have the frequency that was wanted, and those that `uncertainty` states hold what is built.

Rings, cubes, discs, sums of two powers and screened laws on triangular and square lattices, what is built is summed
by `tests/drawn_lattices.py` over all pairs within 20 spacings.  In docs/coverage.md; some minutes of one core:

    python -m pytest -m long -n 0 -s tests/design/test_design_coverage.py
"""

import numpy as np
import pytest

from magphonon import read_scene
from magphonon.design.uncertainty import frequency_spread
from magphonon.scenes.tolerances import varied
from tests.drawn_lattices import MASS, VECTORS, WIDE, L, bloch, drawn_magnets, needed

KINDS = 'ring', 'cube', 'disc', 'two powers', 'screened'
POINTS = {'triangular': {'M': [0.5, 0, 0], 'K': [2 / 3, 1 / 3, 0]}, 'square': {'X': [0, 0.5, 0], 'M': [0.5, 0.5, 0]}}
BUILT = 12  # lattices after each design
SIGMA = np.array([0.01, 0.003, 0.005, 0.03])  # of remanence, spacing, mass and springs


def frequencies(law, lattice, points, spring, stretch, strength=1.0, mass=1.0):
    """In rad/ms, shape (points, 2), of the lattice that is built, of all pairs within 20 spacings."""
    waves = 2 * np.pi * np.array([*points.values()])[:, :2] @ np.linalg.inv(stretch * VECTORS[lattice]).T
    scale = strength**2  # of every force, so of the part that the springs do not give
    return 1e-3 * np.sqrt(scale) * bloch(law, lattice, waves, [spring / scale] * 2, 20 * L * stretch, stretch,
                                         mass=MASS * mass)


def drawn(folder, k):
    """The law, the lattice, its spring in N/m, the wanted frequency in Hz at a point and a branch, and the scene that asks."""
    rng = np.random.default_rng([k, 363])
    lattice = ('triangular', 'square')[k % 2]
    law, head, shape = drawn_magnets(KINDS[k % 5], rng)
    points, stretch, low = POINTS[lattice], rng.uniform(0.95, 1.25), 0.82
    spring = float((1.1 * needed(law, lattice, low) + 5) * rng.uniform(1.0, 1.3))
    point, branch = list(points)[rng.integers(2)], int(rng.integers(1, 3))
    wanted = frequencies(law, lattice, points, spring, stretch)[list(points).index(point), branch - 1] * 1e3 / (2 * np.pi)
    strength = 'forces_percent = 2.0\n' if not shape else 'remanence_percent = 1.0\n'

    def scene(shells):
        (file := folder / 'design.toml').write_text(
            f'title = "drawn"\n[lattice]\nkind = "{lattice}"\nspacing_m = {L}\nmass_kg = {MASS}\n[law]\n{head}shells = {shells}\n'
            f'{shape}[foundation]\nstiffness_N_per_m = {spring}\n'
            f'[design]\nspacings_m = [{low * L}, {1.6 * L}]\n'
            f'[design.edge]\npoint = "{point}"\nbranch = {branch}\nfrequency_Hz = {wanted}\n[uncertainty]\n{strength}'
            'spacing_percent = 0.3\nmass_percent = 0.5\nstiffness_percent = 3.0\n', encoding='utf-8')
        return read_scene(file)

    return law, lattice, spring, (point, branch, wanted), scene, rng


def designed(scene, points):
    """The spacings in spacings of L, and of the first the frequencies that `uncertainty` states and their deviations."""
    _, designs = scene.design.solve(scene)
    stretch = [one.spacing / (1e3 * L) for one in designs]
    scene = varied(scene, {'spacing': stretch[0]}).counted()
    return stretch, frequency_spread(scene.perfect_cell(), [*points.values()], scene.uncertainty.tolerances(scene))


@pytest.mark.long
def test_designs_of_drawn_lattices(tmp_path):
    """30 designs, 12 lattices of each: 1440 intervals; the control designs with the nearest neighbours alone."""
    cells, apart = {'"auto"': ([], []), '1': ([], [])}, {'"auto"': [], '1': []}
    for k in range(30):
        law, lattice, spring, (point, branch, wanted), scene, rng = drawn(tmp_path, k)
        points, off = POINTS[lattice], SIGMA * rng.standard_normal((BUILT, 4))
        for shells, (miss, half) in cells.items():
            try:
                stretches, spread = designed(scene(shells), points)
            except ValueError as error:
                print(k, KINDS[k % 5], lattice, shells, 'REFUSED', str(error)[:200], flush=True)
                continue
            for stretch in stretches:
                found = frequencies(law, lattice, points, spring, stretch)[list(points).index(point), branch - 1]
                apart[shells].append(found * 1e3 / (2 * np.pi) / wanted - 1)
            for strength, spacing, mass, stiff in 1 + off:
                built = frequencies(law, lattice, points, spring * stiff, stretches[0] * spacing, strength, mass)
                miss.append((spread.values / built - 1).ravel())
                half.append((WIDE * spread.std / built).ravel())
        print(k, KINDS[k % 5], lattice, f'{point}, branch {branch}, {wanted:.1f} Hz, {spring:.0f} N/m:',
              *(f'{name} {100 * apart[name][-1]:+.2f} %, {np.mean(abs(np.array(one[-BUILT:])) <= other[-BUILT:]):.2f} hold;'
                for name, (one, other) in cells.items()), flush=True)
    for name, cell in cells.items():
        miss, half = map(np.array, cell)
        print(f'{name}: {np.mean(abs(miss) <= half):.3f} of {miss.size} intervals hold, half width {100 * np.median(half):.2f}'
              f' %, 1.96 rms error {196 * np.sqrt(np.mean(miss**2)):.2f} %; as wanted within '
              f'{100 * max(map(abs, apart[name])):.3f} % of {len(apart[name])} spacings')
    miss, half = map(np.array, cells['"auto"'])
    assert np.mean(abs(miss) <= half) >= 0.90
    assert np.median(half) <= 2 * WIDE * np.sqrt(np.mean(miss**2))
    assert max(map(abs, apart['"auto"'])) < 2e-3
    near, stated = map(np.array, cells['1'])
    assert np.mean(abs(near) <= stated) < 0.6  # the control
