"""Half a slip of units is told with the value that was probably meant, and numbers that are meant pass without a word."""

import re
from dataclasses import dataclass, replace

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms
from ase.dft.kpoints import BandPath
from ase.units import kB
from structures import few_first

from magphonon import (
    DrivenVerlet,
    InversePower,
    ToneBurst,
    analytic_bands,
    critical_foundation,
    frequency_response,
    lattices,
    propagate,
    units as u,
    verdict,
)
from magphonon.bands import complex_bands, edge_flow, lattice_density
from magphonon.bands.bloch import damped_modes
from magphonon.dynamics import Harmonic, PrescribedMotion
from magphonon.response import density_of_states, harmonic_response, modes
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
    k = max(bond, 30.0) * 10 ** rng.uniform(-0.7, 0.0)  # N/m
    law = law if bond > 30 else InversePower(law.b * 30 / bond, law.a)
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
             lambda w: propagate(patch, [0.0, 100 / f], [ToneBurst(0, (1, 0), 1e-6, omega=w)]),
             lambda w: propagate(held, [0.0, 100 / f], [PrescribedMotion(Harmonic(0, (1, 0), 1e-6, omega=w))]),
             lambda w: DrivenVerlet(patch, 10 / f, [Harmonic([0, 1], (1, 0), 1e-6, omega=w)]),
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


@dataclass(frozen=True)
class Bench:
    """The published prototype, in mm, g and ms, and what is asked of it; a slip replaces one of the numbers."""

    spacing: float = 10.0
    mass: float | None = 0.707
    b: float = 1.6209e-10 * u.N * u.m**4.5824
    k: float = 0.0196757
    gyration: float = 0.0
    pbc: tuple[bool, ...] | bool = (True, True, False)
    omega: float = 0.25
    damping: float = 0.004
    last: float = 50.0
    dt: float = 0.1
    force: float = 1e-4
    speed: float = 0.0
    kelvin: float = 0.0
    amplitude: float = 1e-3

    def cell(self):
        cell = lattices.triangular(self.spacing, self.mass or 1.0)
        cell = cell if self.mass else Atoms('H', cell=cell.cell, pbc=cell.pbc)  # masses of symbols
        cell.pbc = self.pbc
        cell.calc = PairCalculator(cell, InversePower(self.b, 4.5824), foundation=self.k, gyration=self.gyration)
        return cell

    def patch(self):
        cell = self.cell()
        patch = cell.repeat([3 if along else 1 for along in cell.pbc])
        patch.calc = cell.calc.on(patch)
        patch.set_velocities(np.full((len(patch), 3), [self.speed, 0, 0]))
        if self.kelvin:
            patch.set_momenta(np.random.default_rng(0).normal(size=(9, 3)) * np.sqrt(self.mass * self.kelvin * kB))  # as ASE does
        return patch

    def respond(self):
        patch, push = self.patch(), np.zeros((9, 3))
        push[0, 0] = 1.0
        return frequency_response(patch, push, self.omega * np.array([0.8, 1, 1.2]), self.damping)

    def burst(self):
        return propagate(self.patch(), np.linspace(0, self.last, 26), [ToneBurst(0, (0, 1), self.force, omega=self.omega)],
                         damping=self.damping)

    def shake(self):
        held = self.patch()
        held.set_constraint(FixAtoms([0]))
        return propagate(held, np.linspace(0, self.last, 26),
                         [PrescribedMotion(Harmonic(0, (1, 0), self.amplitude, omega=self.omega))], damping=self.damping)

    def step(self):
        DrivenVerlet(self.patch(), self.dt, [ToneBurst(4, (0, 1), self.force, omega=self.omega)], damping=self.damping).run(500)


STATIC = {'spacing', 'b', 'k', 'pbc'}
TOOLS = {  # and what enters there besides the static numbers
    'analytic_bands': (lambda bench: analytic_bands(bench.cell(), 'GMK'), {'mass', 'gyration'}),
    'damped_modes': (lambda bench: damped_modes(bench.cell(), [[0.5, 0, 0]], damping=bench.damping),
                     {'mass', 'gyration', 'damping'}),
    'complex_bands': (lambda bench: complex_bands(bench.cell(), (1, 0, 0), [bench.omega], damping=bench.damping),
                      {'mass', 'omega', 'damping'}),
    'lattice_density': (lambda bench: lattice_density(bench.cell(), [0.9 * bench.omega, bench.omega], 6), {'mass', 'omega'}),
    'critical_foundation': (lambda bench: critical_foundation(bench.cell()), set()),
    'verdict': (lambda bench: verdict(bench.cell(), damping=bench.damping), {'gyration', 'damping'}),
    'modes': (lambda bench: modes(bench.patch()), {'mass'}),
    'frequency_response': (Bench.respond, {'mass', 'gyration', 'omega', 'damping'}),
    'propagate': (Bench.burst, {'mass', 'omega', 'damping', 'last', 'force', 'speed', 'kelvin'}),
    'a moving rim': (Bench.shake, {'mass', 'omega', 'damping', 'last', 'amplitude'}),
    'DrivenVerlet': (Bench.step, {'mass', 'gyration', 'omega', 'damping', 'dt', 'force', 'speed', 'kelvin'}),
}
SLIPS = {  # the slip, and what is said of it, most of it with the number that was meant
    'spacing in m': ({'spacing': 0.01}, 'multiply SI values by their units'),
    'spacing in cm': ({'spacing': 1.0}, r'if 1 cm or inches were meant, give 1 \* 10 \* units.mm'),
    'spacing in inches': ({'spacing': 0.3937}, r'or 0.3937 \* 25.4 \* units.mm'),
    'spacing in um': ({'spacing': 1e4}, 'the stiffest bond has'),
    'mass in kg': ({'mass': 7.07e-4}, r'if 0.000707 kg was meant, give 0.000707 \* units.kg'),
    'mass in mg': ({'mass': 707.0}, r'if 707 mg was meant, give 707 \* 1e-3 \* units.g'),
    'no mass': ({'mass': None}, 'only the masses of their symbols'),
    'all in SI': ({'spacing': 0.01, 'mass': 7.07e-4, 'b': 1.6209e-10, 'k': 19.6757}, 'multiply SI values by their units'),
    'b in N m^a': ({'b': 1.6209e-10}, r'if b of the law was meant in N m\^a'),
    'b converted twice': ({'b': 1.6209e-10 * 1e3**9.1648}, r'as it is if it is in N mm\^a'),
    'foundation in N/m': ({'k': 19.6757}, r'19.6757 N/m was meant, give 19.6757 \* units.N / units.m'),
    'gyration in rad/s': ({'gyration': 100.0}, 'if 100 rad/s was meant, give 100 / units.s'),
    'a period along z': ({'pbc': True}, r'set atoms.pbc = \(True, True, False\)'),
    'omega in Hz': ({'omega': 40.0}, r'Hz was meant, give (36|38|40) \* 2 \* pi \* units.Hz'),
    'omega in rad/s': ({'omega': 250.0}, r'rad/s was meant, give 2[0-9.]+ / units.s'),
    'omega in kHz': ({'omega': 0.04}, None),  # below the pillars' own frequency, where springs are measured, too
    'damping in 1/s': ({'damping': 4.0}, 'if 4 1/s was meant, give 4 / units.s'),
    'times in s': ({'last': 0.05}, r'if 0.05 s was meant, give 0.05 \* units.s'),
    'dt in s': ({'dt': 1e-4}, r'if 0.0001 s was meant, give 0.0001 \* units.s'),
    'dt in us': ({'dt': 100.0}, 'exceeds the stability limit'),
    'force of 1 N': ({'force': 1.0}, 'where linear theory fails; take forces|diverged'),
    'speed in mm/s': ({'speed': 50.0}, r'if 50 mm/s was meant, give 50 \* units.mm / units.s'),
    '300 K': ({'kelvin': 300.0}, 'moves out of the plane'),
    'amplitude in um': ({'amplitude': 10.0}, 'where linear theory fails; take forces'),
}


def outcome(tool, slip):
    """' ' where the slipped number does not enter; '-' for silence, 'w' for a warning, 'r' for a refusal, '?' for other words."""
    run, enters = TOOLS[tool]
    changes, said = SLIPS[slip]
    if not (STATIC | enters).intersection(changes):
        return ' '
    try:
        run(replace(Bench(), **changes))  # warnings are errors
    except (UserWarning, ValueError) as error:
        return '?' if not re.search(said, str(error)) else 'w' if isinstance(error, UserWarning) else 'r'
    return '-'


@pytest.mark.parametrize('slip', SLIPS)
def test_a_slip_is_told_where_it_enters_first(slip):
    found = next(one for tool in TOOLS if (one := outcome(tool, slip)) != ' ')
    assert found in ('wr' if SLIPS[slip][1] else '-')


@pytest.mark.slow
def test_slips_in_all_tools():
    """In each tool at most one slip of 20 passes without a word, and the bench itself, typed right, gets none."""
    for run, _ in TOOLS.values():
        run(Bench())
    table = {slip: ''.join(outcome(tool, slip) for tool in TOOLS) for slip in SLIPS}
    print(*(f'{slip:18} {"  ".join(row)}' for slip, row in table.items()), sep='\n')
    for column in zip(*table.values(), strict=True):
        assert column.count('-') <= 1
    told = ''.join(table.values())
    assert told.count('?') == 0
    assert told.count('-') < 0.05 * sum(map(told.count, '-wr'))


@pytest.mark.parametrize('seed', few_first(range(500), 7))
def test_nothing_is_said_of_a_bench_in_the_right_units(seed):
    """Spacings of 2 to 100 mm, forces of 1 mN to 30 N, pillars of 1 to 5000 N/m, masses of 0.01 g to a steel rod 25 times as tall
    as the spacing; warnings are errors.
    """
    rng = np.random.default_rng(seed)
    L, f, k = (10 ** rng.uniform(*np.log10(ends)) for ends in ((2, 100), (1e-3, 30), (1e-3, 5)))
    mass = 10 ** rng.uniform(-2, np.log10(min(100, 25 * 7.85e-3 * L**3)))
    a, cell = rng.uniform(2, 6), LATTICES[seed % len(LATTICES)](L * u.mm, mass * u.g)
    cell.calc = PairCalculator(cell, InversePower(f * L**a, a), foundation=k * u.N / u.mm)
    needed = critical_foundation(cell).k
    cell.calc.set(foundation=max(k, 1.1 * needed))
    omega = np.sqrt((a * f / L + k) / mass)
    damping = omega * 10 ** rng.uniform(-4, -0.5)
    damped_modes(cell, [[0.5, 0, 0]], damping=damping)
    verdict(cell, damping=damping)
    patch = cell.repeat([3 if along else 1 for along in cell.pbc])
    patch.calc = cell.calc.on(patch)
    propagate(patch, np.linspace(0, 20 / omega, 26), [ToneBurst(0, (0, 1), 1e-3 * f, omega=omega)], damping=damping)
    DrivenVerlet(patch, 0.05 / omega, [ToneBurst(0, (1, 0), 1e-3 * f, omega=omega)], damping)


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
