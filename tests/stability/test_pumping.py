"""Growth by a modulated foundation: against dense searches of the test's own, and the verdict on each side of its threshold."""

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from magphonon import InversePower, MagneticRepulsion, Travelling, floquet_bands, lattices, read_scene, units as u, verdict
from magphonon.bands import bloch_modes
from magphonon.stability import parametric_growth


def chain(eps, W, kap, k=5.0):
    cell = lattices.chain(1.0, 1.0)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=Travelling(k, eps, W, kap))
    return cell


@pytest.mark.parametrize('seed', range(4))
def test_no_wave_grows_faster(seed):
    rng = np.random.default_rng(seed)
    cell = chain(rng.uniform(0.1, 0.6), rng.uniform(2.2, 8), (rng.uniform(-3, 3), 0))
    found = parametric_growth(cell)
    every = floquet_bands(cell, np.outer(np.arange(200) / 200, [1, 0, 0]), tolerance=1e-2).growth
    assert 0.01 < every.max() <= found.rate + 1e-4


def test_a_mesh_would_miss_it():
    cell = chain(0.004, 4.3, (0, 0))
    found = parametric_growth(cell)
    assert found.rate > 1e-3
    assert floquet_bands(cell, found.q, tolerance=1e-10).growth[0] == pytest.approx(found.rate, abs=1e-8)
    assert floquet_bands(cell, np.outer(np.arange(24) / 24, [1, 0, 0])).growth.max() < 1e-6


@pytest.mark.parametrize('g', [0.0, 1.5])
def test_a_finite_structure(g):
    patch = lattices.chain(1.0, 1.0).repeat((3, 1, 1))
    patch.set_pbc(False)
    law = Travelling(8.0, 0.5, 6.0, (1.0, 0.4))
    patch.calc = MagneticRepulsion(patch, InversePower(1.0, 4.0), foundation=law, gyration=g).balanced(range(len(patch)))
    calc, n = patch.calc, 2 * len(patch)
    K = calc.about(calc.reference, foundation=8.0, gyration=0.0).rest_hessian().toarray()
    turned = np.kron(np.eye(len(patch)), [[0, 1], [-1, 0]])

    def motion(t, y):
        x, v = y.reshape(2, n, n * 2)
        pumped = np.repeat(law.eps * np.cos(law.W * t - patch.positions @ law.kap), 2)
        return np.stack([v, -K @ x - 8.0 * pumped[:, None] * x + g * turned @ v]).ravel()

    T = 2 * np.pi / law.W
    end = solve_ivp(motion, (0, T), np.eye(2 * n).ravel(), 'DOP853', rtol=1e-9, atol=1e-9).y[:, -1].reshape(2 * n, 2 * n)
    rate = np.log(abs(np.linalg.eigvals(end)).max()) / T
    assert rate > 0.1
    found = parametric_growth(patch)
    assert (found.rate, found.q.tolist()) == (pytest.approx(rate, abs=1e-5), [0, 0, 0])
    patch.positions[0, 0] += 0.01  # a verdict is one about rest
    assert verdict(patch).pumping.rate == pytest.approx(rate, abs=1e-5)
    judged, highest = verdict(patch), np.linalg.eigvalsh(K)[-1]
    assert judged.timestep_limit == pytest.approx(2 / np.sqrt(highest + 8.0 * law.eps), rel=1e-6)
    assert judged.timestep_limit < 0.99 * 2 / np.sqrt(highest)  # the control: that of the mean springs
    assert 'makes waves grow' in str(judged)


def test_the_verdict_of_a_cell_that_gyrates_and_is_modulated():
    """The wave that grows fastest, against the monodromy of its own, and the step, against the stiffest springs."""
    cell, law, g = lattices.triangular(1.0, 1.0), Travelling(8.0, 0.3, 7.0, (0, 0)), 2.0
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=law, gyration=g)
    judged = verdict(cell)
    text = str(judged)
    n = np.array([[np.cos(t), np.sin(t)] for t in np.pi / 3 * np.arange(3)])
    blocks = [4 * np.outer(d, d) - (np.eye(2) - np.outer(d, d)) for d in n]  # f = 1 N, -df/dr = 4 N/mm

    def D(q):
        k = 2 * np.pi * q[:2] @ np.linalg.inv(cell.cell.array[:2, :2]).T
        return 8 * np.eye(2) + sum(2 * (1 - np.cos(k @ d)) * block for d, block in zip(n, blocks, strict=True))

    def motion(t, y, turns):
        x, v = y.reshape(2, 2, 4)
        return np.stack([v, -(D(judged.pumping.q) + 8 * law.eps * np.cos(law.W * t) * np.eye(2)) @ x
                         + turns * np.array([[0, 1], [-1, 0]]) @ v]).ravel()

    def rate(turns):
        T = 2 * np.pi / law.W
        end = solve_ivp(motion, (0, T), np.eye(4).ravel(), 'DOP853', rtol=1e-10, atol=1e-10, args=(turns,)).y[:, -1]
        return np.log(abs(np.linalg.eigvals(end.reshape(4, 4))).max()) / T

    assert judged.pumping.rate > 0.1
    assert judged.pumping.rate == pytest.approx(rate(g), abs=1e-6)
    assert abs(judged.pumping.rate - rate(0.0)) > 0.02  # the control: without gyration
    assert not judged.stable
    assert 'makes waves grow' in text
    highest = max(np.linalg.eigvalsh(D(np.array(q)))[-1] for q in ((0.5, 0), (0.5, 0.5), (0, 0.5)))
    assert judged.timestep_limit == pytest.approx(2 / np.sqrt(highest + 8 * law.eps), rel=1e-3)


@pytest.mark.parametrize(('eps', 'stable'), [(0.0816, True), (0.0818, False)])
def test_the_verdict_on_both_sides_of_the_threshold(eps, stable):
    """The shear wave half way to M grows from eps = 0.0817 on, against a damping of 4 per s."""
    cell = read_scene('prototype').perfect_cell()
    W = 2 * bloch_modes(cell, [[0, 0.25, 0]])[0][0, 0]
    cell.calc = cell.calc.about(cell, foundation=Travelling(cell.calc.foundation, eps, W, (0, 0)))
    judged = verdict(cell, damping=4 / u.s)
    assert judged.stable == stable
    assert judged.finding('pumping').fault != stable
    assert judged.timestep_limit < 2.13  # that of the mean springs
