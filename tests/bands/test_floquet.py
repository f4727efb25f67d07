"""Floquet bands against the monodromy of a supercell, which the test integrates itself, and against coupled modes."""

from dataclasses import dataclass

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import brentq

from magphonon import (
    InversePower,
    MagneticRepulsion,
    Travelling,
    analytic_bands,
    floquet_bands,
    lattices,
    modes,
    read_scene,
    units as u,
)
from magphonon.bands import bloch_modes

HZ = 2 * np.pi * u.Hz
TURN = np.array([0, 2 * np.pi / 3 / (10 * np.sqrt(3) / 2), 0])  # a third of a turn per row of the prototype
GAP = -0.1254903  # along Gamma-M, in the second reciprocal vector


def prototype(eps, W=8 * HZ, kap=TURN, **changed):
    cell = read_scene('prototype').perfect_cell()
    cell.calc = cell.calc.about(cell, foundation=Travelling(cell.calc.foundation, eps, W, kap), **changed)
    return cell


def shear(q):
    return bloch_modes(read_scene('prototype').perfect_cell(), [[0, q, 0]])[0][0, 0]


def multipliers(atoms, repeat, q, damping=0.0, rtol=1e-13):
    """e^{-i w T} of all waves of a supercell that holds whole waves of the modulation, from its equations of motion."""
    law, cells = atoms.calc.parameters.foundation, atoms.repeat(repeat)
    mean = atoms.calc.about(atoms, foundation=law.k).on(cells)
    m, n = np.repeat(cells.get_masses(), 2), 2 * len(cells)
    K = mean.bloch_matrix(np.array([q]) * repeat)[0] / np.sqrt(np.outer(m, m))
    k = np.broadcast_to(mean.foundation, (len(cells), 2)) / cells.get_masses()[:, None]
    g = np.broadcast_to(atoms.calc.gyration, len(atoms))[0]
    c = np.repeat(np.tile(np.broadcast_to(damping, len(atoms)), len(cells) // len(atoms)), 2)

    def motion(t, y):
        x, v = y.reshape(2, n, -1)
        pumped = law.eps * np.cos(law.W * t - cells.positions @ law.kap)
        a = -K @ x - (pumped[:, None] * k).ravel()[:, None] * x - c[:, None] * v
        a[::2] += g * v[1::2]
        a[1::2] -= g * v[::2]
        return np.stack([v, a]).ravel()

    T = 2 * np.pi / law.W
    end = solve_ivp(motion, (0, T), np.eye(2 * n, dtype=complex).ravel(), 'DOP853', rtol=rtol, atol=rtol).y[:, -1]
    return np.linalg.eigvals(end.reshape(2 * n, 2 * n)), T


def away(bands, found, T):
    """How far quasi-frequencies are from those of the multipliers, rad/ms."""
    return abs(np.exp(-1j * bands.omega[0] * T)[:, None] - found).min(axis=1).max() / T


@dataclass
class Drawn:
    atoms: object
    repeat: tuple
    q: np.ndarray
    damping: object


def drawn(seed):
    """A lattice with masses and springs of its own, modulated by a wave of a few cells, which may run out of the plane's axes."""
    rng = np.random.default_rng(seed)
    cell = [lattices.square, lattices.triangular, lattices.honeycomb][seed % 3](1.0, 1.0)
    n = len(cell)
    cell.set_masses(rng.uniform(0.5, 2, n))
    repeat = (3, 1, 1) if seed % 2 else (1, 2, 1)
    kap = np.array([rng.integers(1, 3) / N if N > 1 else rng.integers(0, 2) for N in repeat]) @ (
        2 * np.pi * cell.cell.reciprocal().array) * [1, 1, 0]
    k = 8.0 if seed % 4 == 0 else rng.uniform(8, 12, (n, 2))
    law = Travelling(k, rng.uniform(0.05, 0.9), rng.uniform(2, 9), kap)
    cell.calc = MagneticRepulsion(cell, InversePower(1.0, 4.0), foundation=law, gyration=0.7 * (seed in (2, 5)))
    return Drawn(cell, repeat, np.append(rng.uniform(-0.5, 0.5, 2), 0), rng.uniform(0, 0.3, n) if seed % 3 else 0.0)


@pytest.mark.parametrize('seed', range(8))
def test_they_are_those_of_the_monodromy(seed):
    case = drawn(seed)
    found, T = multipliers(case.atoms, case.repeat, case.q, case.damping, 1e-9)
    bands = floquet_bands(case.atoms, case.q, damping=case.damping, tolerance=1e-11)
    largest = abs(bands.omega).max()
    assert away(bands, found, T) < 1e-7 * largest  # where two waves are about to grow, round-off counts by its square root
    law = case.atoms.calc.parameters.foundation
    for wrong in (Travelling(law.k, law.eps, law.W, -np.array(law.kap)), Travelling(law.k, law.eps / 2, law.W, law.kap)):
        case.atoms.calc = case.atoms.calc.about(case.atoms, foundation=wrong)
        other = floquet_bands(case.atoms, case.q, damping=case.damping, tolerance=1e-11)
        moved = abs(other.omega - bands.omega).max() > 1e-5 * largest  # of a wave that stands the mirror image is the same
        assert not moved or away(other, found, T) > 3e-7 * largest
    assert moved


def test_gap_on_one_side_only():
    cell = prototype(0.05)
    there, back = (floquet_bands(cell, [0, q, 0], tolerance=1e-11) for q in (GAP, -GAP))
    pair = np.sort(there.omega[0, np.argsort(there.weight[0])[1:3]].real)  # the two that share the shear wave
    assert np.ptp(pair) / HZ == pytest.approx(0.476629, abs=1e-6)
    crossing = brentq(lambda q: shear(q + 1 / 3) - shear(q) - 8 * HZ, -0.15, -0.1)
    assert shear(crossing) / HZ == pytest.approx(33.18603, abs=2e-5)  # where the two would cross
    w1, w2 = shear(GAP), shear(GAP + 1 / 3)
    k, m = cell.calc.site_stiffness, cell.get_masses()[0]
    assert 0.05 * k / (2 * m * np.sqrt(w1 * w2)) / HZ == pytest.approx(0.476693, abs=1e-6)  # coupled modes
    assert sorted(back.weight[0])[2] > 0.999  # against the modulation each wave goes by itself
    found, T = multipliers(cell, (1, 3, 1), [0, GAP, 0])
    assert away(there, found, T) < 1e-12


def test_D0_alone_has_its_gap_elsewhere():
    conventional = floquet_bands(prototype(0.05), [0, GAP, 0], 'conventional')
    assert sorted(conventional.weight[0])[2] > 0.9


@pytest.mark.parametrize(('eps', 'c', 'rate'), [(0.05, 0.0, 1.223413), (0.0816, 4.0, -0.003), (0.0818, 4.0, 0.002)])
def test_gain_and_its_threshold(eps, c, rate):
    cell = prototype(eps, 2 * shear(0.25), (0, 0))
    growth = floquet_bands(cell, [0, 0.25, 0], damping=c / u.s, tolerance=1e-10).growth[0] * u.s
    assert growth == pytest.approx(rate, abs=1e-6 if c == 0 else 1.5e-3)


def test_what_supposes_constant_springs_says_so():
    cell = prototype(0.05)
    for tool in (modes, lambda atoms: analytic_bands(atoms, 'GM'), lambda atoms: atoms.calc.foundation):
        with pytest.raises(ValueError, match=r'Travelling.*use floquet_bands or time steps'):
            tool(cell)
    with pytest.raises(ValueError, match='foundation=Travelling'):
        floquet_bands(read_scene('prototype').perfect_cell(), [0, 0.1, 0])
