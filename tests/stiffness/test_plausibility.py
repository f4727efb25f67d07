"""Half a slip of units is told with the value that was probably meant, and numbers that are meant pass without a word."""

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from ase.dft.kpoints import BandPath
from structures import few_first

from magphonon import DrivenVerlet, InversePower, ToneBurst, analytic_bands, frequency_response, lattices, propagate, units as u
from magphonon.bands import complex_bands, edge_flow, lattice_density
from magphonon.dynamics import Harmonic, PrescribedMotion
from magphonon.response import density_of_states, harmonic_response
from magphonon.stiffness import AllNeighbours, PairCalculator

LATTICES = [lattices.chain, lattices.square, lattices.triangular, lattices.honeycomb, lattices.kagome]
HERTZ = 2 * np.pi / 1e3  # in rad/ms, by hand


def drawn(seed):
    """A cell, its law, the stiffness of a bond in N/m, and a mass in g: powers of 2 to 7, 2 to 40 mm, 0.05 to 20 g."""
    rng = np.random.default_rng(seed)
    f, L, a, mass = 10 ** rng.uniform(-2, 1), rng.uniform(2, 40), rng.uniform(2, 7), 10 ** rng.uniform(-1.3, 1.3)
    cell = LATTICES[seed % len(LATTICES)](L * u.mm, mass * u.g)
    return cell, InversePower(f * L**a, a), 1e3 * a * f / L, mass, rng


@pytest.mark.parametrize('seed', range(10))
def test_a_foundation_typed_in_newton_per_metre(seed):
    cell, law, bond, _, rng = drawn(seed)
    k = max(bond, 10.0) * 10 ** rng.uniform(-0.7, 0.0)  # N/m
    law = law if bond > 10 else InversePower(law.b * 10 / bond, law.a)
    PairCalculator(cell, law, foundation=k * u.N / u.m)
    with pytest.warns(UserWarning, match='N/m was meant') as told:
        PairCalculator(cell, law, foundation=k)
    assert f'give {k:.6g} * units.N / units.m, which is {k / 1e3:.6g} N/mm' in str(told[0].message)


@pytest.mark.parametrize('seed', few_first(range(10), 2))
def test_frequencies_typed_in_hertz(seed):
    cell, law, bond, mass, rng = drawn(seed)
    cell.calc = PairCalculator(cell, law, foundation=4 * bond * u.N / u.m)
    f = rng.uniform(0.5, 1.8) * np.sqrt(5 * bond / (mass / 1e3)) / (2 * np.pi)  # Hz
    patch = cell.repeat([2 if periodic else 1 for periodic in cell.pbc])
    patch.calc = cell.calc.on(patch)
    push = np.zeros((len(patch), 3))
    push[0, 0] = 1
    held = patch.copy()
    held.calc = patch.calc
    held.set_constraint(FixAtoms([0]))
    tools = [lambda w: frequency_response(patch, push, w, 0.1), lambda w: harmonic_response(patch, push, [w], 0.1),
             lambda w: frequency_response(patch, push, np.linspace(0.8, 1.2, 5) * w, 0.1),
             lambda w: propagate(patch, [0.0, 1.0], [ToneBurst(0, (1, 0), 1e-6, omega=w)]),
             lambda w: propagate(held, [0.0, 1.0], [PrescribedMotion(Harmonic(0, (1, 0), 1e-6, omega=w))]),
             lambda w: DrivenVerlet(patch, 1e-3 / f, [Harmonic([0, 1], (1, 0), 1e-6, omega=w)]),
             lambda w: density_of_states(patch, [0.9 * w, w], 8, 2),
             lambda w: lattice_density(cell, [0.9 * w, w], 6)]
    for tool in tools:
        tool(f * HERTZ)
        with pytest.warns(UserWarning, match='Hz was meant') as told:
            tool(f)
        assert len(told) == 1
        assert f'which is {f * HERTZ:.4g} rad/ms' in str(told[0].message) or tool in tools[6:]  # the mean of two


def test_waves_along_a_direction_and_edges_typed_in_hertz():
    cell = lattices.square(10 * u.mm, 1 * u.g)
    cell.calc = PairCalculator(cell, InversePower(0.1 * 10**4.0, 4.0), foundation=20 * u.N / u.m)
    strip = lattices.ribbon(cell, 4)
    strip.calc = PairCalculator(strip, cell.calc.laws, foundation=20 * u.N / u.m)
    complex_bands(cell, (1, 0, 0), [40 * HERTZ])
    with pytest.warns(UserWarning, match='40 Hz was meant'):
        complex_bands(cell, (1, 0, 0), [40.0])
    with pytest.warns(UserWarning, match='60 Hz was meant'):
        edge_flow(strip, 60.0)


def test_masses_that_nobody_gave_are_those_of_symbols():
    iron = Atoms('Fe', cell=[10, 10, 10], pbc=(True, True, False))
    for make in PairCalculator, AllNeighbours:
        iron.calc = make(iron, InversePower(1e3, 4.0), foundation=1.0)
        iron.get_forces()  # statics has no masses
        with pytest.warns(UserWarning, match=r'55\.845 for Fe, which count as grams.*here 9\.273e-23 g'):
            analytic_bands(iron, 'GX')
    iron.set_masses([0.7])
    analytic_bands(iron, 'GX')


@pytest.mark.parametrize(('ratio', 'told'), [(1e8, False), (4e8, False), (3e9, True), (1e12, True)])
def test_masses_so_unequal_that_digits_are_lost(ratio, told):
    """The light particle follows the heavy one at once, K_HH - K_HL K_LL^-1 K_LH, up to 1/ratio: no small number in it."""
    cell, q = lattices.honeycomb(1.0, 1.0), [0.31, 0.17, 0]
    cell.set_masses([1 / ratio, 1.0])
    with pytest.warns(UserWarning, match='accurate only to') if told else np.errstate():
        cell.calc = PairCalculator(cell, InversePower(1.0, 4.0), foundation=5.0)
    light, heavy, R = slice(0, 2), slice(2, 4), np.array([cell.positions[1] + s @ cell.cell.array - cell.positions[0]
                                                         for s in np.array(list(np.ndindex(3, 3, 1))) - [1, 1, 0]])[:, :2]
    shifts = (np.array(list(np.ndindex(3, 3))) - 1)[np.linalg.norm(R, axis=1) < 1.01]
    n = R[np.linalg.norm(R, axis=1) < 1.01]
    bonds = 5 * n[:, :, None] * n[:, None] - np.eye(2)  # 4 n n - (1 - n n)
    between = -(np.exp(2j * np.pi * shifts @ q[:2])[:, None, None] * bonds).sum(axis=0)
    K = np.block([[bonds.sum(axis=0) + 5 * np.eye(2), between], [between.conj().T, bonds.sum(axis=0) + 5 * np.eye(2)]])
    follows = K[heavy, heavy] - K[heavy, light] @ np.linalg.solve(K[light, light], K[light, heavy])
    found = analytic_bands(cell, BandPath(cell.cell, [q])).omega[0, :2]
    apart = abs(found / np.sqrt(np.linalg.eigvalsh(follows)) - 1).max()
    assert len(n) == 3
    assert apart < 1e-15 * ratio
    assert apart > 1e-6 or ratio < 1e12  # the control: digits are lost


def test_other_scales_are_meant():
    """Ions of 40 amu on a trap of 1 MHz, dust of a plasma, colloids, argon, units of one, free oscillators: not a word."""
    e2 = 2.30708e-28 * u.N * u.m**2
    for spacing, mass, law, k in [
        (10e-6 * u.m, 40 * 1.66e-27 * u.kg, InversePower(e2, 2.0), 40 * 1.66e-27 * u.kg * (2 * np.pi * 1e6 / u.s) ** 2),
        (0.5e-3 * u.m, 6e-13 * u.kg, InversePower(1e8 * e2, 2.0), 0.0),
        (10e-6 * u.m, 1e-13 * u.kg, InversePower(1e-12 * u.N * (10e-6 * u.m) ** 4, 4.0), 1e-6 * u.N / u.m),
        (3.7e-10 * u.m, 39.9 * 1.66e-27 * u.kg, InversePower(1e-10 * u.N * (3.7e-10 * u.m) ** 13, 13.0), 0.0),
        (1.0, 1.0, InversePower(1.0, 4.0), 500.0), (3.0, 1.0, InversePower(1.0, 4.0), 1e3),
        (0.1 * u.m, 50e-3 * u.kg, InversePower(2.0 * u.N * (0.1 * u.m) ** 4, 4.0), 2e3 * u.N / u.m)]:
        cell = lattices.triangular(spacing, mass)
        PairCalculator(cell, law, foundation=k)
