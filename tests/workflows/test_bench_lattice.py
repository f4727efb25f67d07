"""The laboratory that judges the package: against closed forms, against its own second derivatives, and alone."""

import ast
from pathlib import Path

import numpy as np
import pytest

from workflows import bench_lattice as bench

SPACING, FORCE, MASS = 10e-3, 0.25, 8e-4


def small_lab(seed=0, **kind):
    law = bench.tabulated(bench.power_law(FORCE, 4, SPACING), 8e-3, 40e-3)
    places = bench.sites(bench.triangular(SPACING), 0.07, 0.07)
    return bench.built(places, law, 35e-3, np.random.default_rng(seed), **kind)


def test_it_imports_nothing_of_the_package():
    tree = ast.parse(Path(bench.__file__).read_text(encoding='utf-8'))
    imported = {getattr(node, 'module', None) or name.name for node in ast.walk(tree)
                if isinstance(node, ast.Import | ast.ImportFrom) for name in node.names}
    assert {name.split('.')[0] for name in imported} == {'dataclasses', 'numpy', 'numba', 'scipy'}
    assert not any(isinstance(node, ast.ImportFrom) and node.level for node in ast.walk(tree))


def test_bands_of_nearest_neighbours_are_those_of_the_paper():
    law = bench.tabulated(bench.power_law(FORCE, 4, SPACING), 8e-3, 40e-3)
    M = np.linalg.inv(bench.triangular(SPACING)).T[1] * np.pi
    squares = [(2 * 4 - 6) * FORCE / SPACING / MASS, (6 * 4 - 2) * FORCE / SPACING / MASS]  # omega^2 m L/f = 2a - 6 and 6a - 2
    assert bench.bloch(law, bench.triangular(SPACING), 1.2 * SPACING, M, MASS, (0, 0))[0] ** 2 == pytest.approx(squares, rel=1e-7)
    springs = bench.bloch(law, bench.triangular(SPACING), 1.2 * SPACING, M, MASS, (0, 0), static=False)[0] ** 2
    assert springs == pytest.approx([2 * 4 * FORCE / SPACING / MASS, 6 * 4 * FORCE / SPACING / MASS], rel=1e-7)


def test_charged_faces_are_dipoles_from_afar():
    """Two discs of the moment m have 3 mu0 m^2/(4 pi r^4); nearer, the spread of the charges alters it."""
    force = bench.disc_force(2.5e-3, 5e-3, 1.32)
    moment = 1.32 / bench.MU0 * np.pi * 2.5e-3**2 * 5e-3
    ratio = force(np.array([10e-3, 0.1, 0.5])) / (3 * bench.MU0 * moment**2 / (4 * np.pi) / np.array([10e-3, 0.1, 0.5]) ** 4)
    assert ratio[2] == pytest.approx(1, abs=2e-3)
    assert abs(ratio[0] - 1) > 0.02


@pytest.mark.parametrize('static', [True, False])
def test_the_stiffness_is_the_derivative_of_the_forces(static):
    lab, rng = small_lab(static=static), np.random.default_rng(3)
    u = 1e-8 * rng.standard_normal(lab.rest.shape)
    up, down = (bench._forces(bench.replace(lab, rest=lab.rest + side * u)).ravel() for side in (1, -1))
    K = bench.stiffness(lab)
    assert K @ u.ravel() == pytest.approx((down - up) / 2, abs=1e-6 * abs(K @ u.ravel()).max())
    assert abs(bench._forces(lab)[~lab.held]).max() < 1e-9 * FORCE
    other = bench.stiffness(small_lab(static=not static)) @ u.ravel()  # the control
    assert abs(other - (down - up) / 2).max() > 0.1 * abs(K @ u.ravel()).max()


def test_the_response_is_that_of_the_modes():
    lab = small_lab(damping=40)
    k = int(np.linalg.norm(lab.rest, axis=1).argmin())
    omega = 2 * np.pi * 60
    exact = bench.response(lab, bench.pushed(lab, [k], (1e-6, 0)), [omega])[0, k, 0]
    values, shapes = bench.modes(lab)
    assert exact == pytest.approx(np.sum(shapes[k, 0] ** 2 * 1e-6 / (values**2 - omega**2 + 1j * omega * lab.damping)), rel=1e-9)


@pytest.mark.slow
def test_time_steps_move_as_the_modes_do():
    lab = small_lab(damping=40)
    k = int(np.linalg.norm(lab.rest, axis=1).argmin())
    drives, seen = [(bench.pushed(lab, [k], (1e-6, 2e-6)), bench.burst(60.0, 5))], [k, k + 1, k + 5]
    t, stepped = bench.motion(lab, drives, 0.2, seen)
    times, modal = bench.small_motion(lab, drives, 0.2, seen, bench.modes(lab))
    assert np.array_equal(t, times)
    assert abs(modal - stepped).max() < 5e-3 * abs(stepped).max()  # steps of a thirtieth of the shortest period: 2.4e-3
    slack = bench.small_motion(lab, drives, 0.2, seen, bench.modes(small_lab(static=False)))[1]  # the control
    assert abs(slack - stepped).max() > 0.2 * abs(stepped).max()


def test_a_vibrometer_shows_what_is_there_late_noisy_and_with_dead_points():
    rng, t = np.random.default_rng(0), np.arange(400) / 1000
    u = np.sin(2 * np.pi * 50 * t)[:, None] * np.sin(np.pi * t / 0.4)[:, None] ** 2 * np.ones(6)
    assert bench.measured(u, 1000, rng, noise=0, jitter=0, drift=0) == pytest.approx(u, abs=1e-9)
    shown = bench.measured(u, 1000, rng, noise=0.01, jitter=0, drift=0, dead=2)
    assert sorted(np.std(shown, axis=0) < 0.02) == [False] * 4 + [True] * 2
