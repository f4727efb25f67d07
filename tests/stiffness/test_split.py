"""D0 and D* of atoms with any ASE calculator over pairs, against differences of the calculator's own forces."""

import re

import ase.units
import numpy as np
import pytest
from ase import Atoms
from ase.build import bulk
from ase.calculators.calculator import Calculator, all_changes
from ase.calculators.emt import EMT
from ase.calculators.lj import LennardJones
from ase.calculators.mixing import SumCalculator
from ase.calculators.morse import MorsePotential
from ase.neighborlist import neighbor_list
from structures import few_first

from magphonon import analytic_bands
from magphonon.bands import bloch_modes
from magphonon.stiffness import split

PER_S = ase.units._e * 1e20 / ase.units._amu  # eV/Angstrom^2/amu in 1/s^2


class Pairs(Calculator):
    """c_ab (cos(pi r/(2 rc)))^4 r^-a over pairs of any elements within rc, or of all atoms if rc is infinite."""

    implemented_properties = ['energy', 'forces']  # noqa: RUF012

    def __init__(self, strengths, a, reach, many=0.0):
        super().__init__()
        self.strengths, self.a, self.reach, self.many = strengths, a, reach, many

    def slope(self, r):
        if np.isinf(self.reach):
            return r**-self.a, -self.a * r ** (-self.a - 1)
        x = np.pi * r / (2 * self.reach)
        return np.cos(x) ** 4 * r**-self.a, -np.cos(x) ** 3 * r**-self.a * (4 * np.sin(x) * x / r + self.a * np.cos(x) / r)

    def calculate(self, atoms=None, properties=('energy',), system_changes=all_changes):
        super().calculate(atoms, properties, system_changes)
        within = self.reach if np.isfinite(self.reach) else 1000.0
        i, j, r, R = neighbor_list('ijdD', atoms, within)
        symbols = np.array(atoms.get_chemical_symbols())
        c = np.array([self.strengths[frozenset(pair)] for pair in zip(symbols[i], symbols[j], strict=True)])
        phi, slope = self.slope(r)
        forces = np.zeros((len(atoms), 3))
        np.add.at(forces, i, (c * slope / r)[:, None] * R)
        density = np.bincount(i, phi, len(atoms))  # of an embedded atom, whose energy is not that of its pairs
        np.add.at(forces, i, (self.many * (density[i] + density[j]) * slope / r)[:, None] * R)
        self.results = {'energy': (c * phi).sum() / 2 + self.many * (density**2).sum() / 2, 'forces': forces}


class Network(Calculator):
    """A learned kind of energy, `sum_i w.a(W G_i)` of descriptors `G_ik = sum_j exp(-eta_k r_ij^2) cos^2(pi r_ij/2 rc)`."""

    implemented_properties = ['energy', 'forces']  # noqa: RUF012

    def __init__(self, seed, bend):
        super().__init__()
        rng = np.random.default_rng(seed)
        self.reach, self.bend = rng.uniform(4.5, 6.5), bend
        self.eta, self.W, self.w = rng.uniform(0.02, 0.2, 4), rng.normal(size=(5, 4)), rng.normal(size=5)

    def calculate(self, atoms=None, properties=('energy',), system_changes=all_changes):
        super().calculate(atoms, properties, system_changes)
        i, j, r, R = neighbor_list('ijdD', atoms, self.reach)
        x, e = np.pi * r / (2 * self.reach), np.exp(-self.eta * r[:, None] ** 2)
        g = e * np.cos(x)[:, None] ** 2
        slope = -2 * self.eta * r[:, None] * g - e * (np.sin(2 * x) * x / r)[:, None]
        inner = np.stack([np.bincount(i, one, len(atoms)) for one in g.T], axis=1) @ self.W.T
        of_one = self.w * (1 - self.bend + self.bend / np.cosh(inner) ** 2) @ self.W  # of an atom's energy by its descriptors
        pull = ((of_one[i] + of_one[j]) * slope).sum(axis=1)
        forces = np.zeros((len(atoms), 3))
        np.add.at(forces, i, (pull / r)[:, None] * R)
        activated = (1 - self.bend) * inner + self.bend * np.tanh(inner)
        self.results = {'energy': float((activated @ self.w).sum()), 'forces': forces}


@pytest.mark.parametrize('seed', few_first(range(3), 1))
def test_an_energy_of_a_learned_kind_is_refused_by_as_much_as_its_network_bends(seed):
    argon = bulk('Ar', 'fcc', a=5.3)
    shaken = argon.repeat(2)
    shaken.rattle(0.2, seed=seed)
    shaken.calc = Network(seed, bend=1.0)
    exact = shaken.calc.get_forces(shaken)[3, 1]
    energies = []
    for step in (1e-4, -1e-4):
        moved = shaken.copy()
        moved.positions[3, 1] += step
        energies.append(shaken.calc.get_potential_energy(moved))
    assert exact == pytest.approx((energies[1] - energies[0]) / 2e-4, rel=1e-5, abs=1e-6)  # its gradient is exact
    said = []
    for bend in (1.0, 0.01):
        argon.calc = Network(seed, bend)
        with pytest.raises(ValueError, match=r'Network is not a sum over pairs.* D\* is defined') as refused:
            split(argon, argon.calc.reach)
        said.append(float(re.search(r'by up to (\S+) of the largest', str(refused.value))[1]))
    assert said[0] > 10 * said[1] > 1e-5
    argon.calc = Network(seed, bend=0.0)  # the control: a network without a bend is a sum over pairs
    exact = by_differences(argon, np.array([1, 0, 1]) / 3)
    omega = bloch_modes(split(argon, argon.calc.reach), [[1 / 3, 0, 1 / 3]])[0].ravel()
    found = np.sort(1e6 * np.sign(omega) * omega**2)
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-5 * abs(exact).max())


def by_differences(atoms, q, h=1e-4):
    """Squared frequencies in 1/s^2 at q of a supercell as large as the forces reach, from the calculator's own forces alone."""
    n = [3 if periodic else 1 for periodic in atoms.pbc]
    large, cells = atoms.repeat(n), np.array(list(np.ndindex(*n)))
    large.calc, count = atoms.calc, len(atoms)
    D = np.zeros((3 * count, 3 * count), complex)
    for k in range(3 * count):
        forces = []
        for step in (h, -h):
            moved = large.copy()
            moved.calc = atoms.calc
            moved.positions[k // 3, k % 3] += step
            forces.append(moved.get_forces())
        column = -(forces[0] - forces[1]) / (2 * h)
        for c, cell in enumerate(cells):
            wrapped = (cell + 1) % 3 - 1 if all(m == 3 for m in n) else np.where(np.array(n) == 3, (cell + 1) % 3 - 1, 0)
            D[:, k] += np.exp(-2j * np.pi * (q @ wrapped)) * column[c * count : (c + 1) * count].ravel()
    mass = np.sqrt(np.repeat(atoms.get_masses(), 3))
    return np.linalg.eigvalsh((D + D.conj().T) / 2 / np.outer(mass, mass)) * PER_S


def cells():
    rng = np.random.default_rng(4)
    for structure, a in (('fcc', 5.3), ('bcc', 4.2), ('hcp', 3.8)):
        crystal = bulk('Ar', structure, a=a)
        crystal.set_cell(crystal.cell.array * rng.uniform(0.97, 1.03), scale_atoms=True)
        yield structure, crystal, Pairs({frozenset({'Ar'}): 50.0}, rng.uniform(2, 6), 1.35 * a)
    salt = bulk('NaCl', 'rocksalt', a=5.6)
    yield 'rocksalt', salt, Pairs({frozenset({'Na'}): 3.0, frozenset({'Cl'}): 20.0, frozenset({'Na', 'Cl'}): 9.0}, 4.0, 4.3)


@pytest.mark.parametrize('given', list(cells()), ids=lambda given: given[0])
def test_frequencies_are_those_of_the_calculators_own_forces(given):
    _, atoms, atoms.calc = given
    q = np.random.default_rng(len(atoms)).integers(-1, 2, 3) / 3  # a wave that fits into three cells along each vector
    exact, here = by_differences(atoms, q), split(atoms)
    found, without = (np.sort(np.sign(omega) * omega**2).ravel() * 1e6
                      for omega in (bloch_modes(here, q[None], model)[0] for model in ('complete', 'conventional')))
    np.testing.assert_allclose(found, exact, rtol=0, atol=1e-6 * abs(exact).max())
    assert abs(without - exact).max() > 1e-2 * abs(exact).max()


@pytest.mark.parametrize('calc', [LennardJones(sigma=3.4, epsilon=0.0103, rc=6.0),
                                  MorsePotential(epsilon=0.01, r0=3.7, rho0=5.0, rcut1=1.5, rcut2=1.8)])
def test_calculators_of_ase_are_split_and_their_reach_is_found(calc):
    argon = bulk('Ar', 'fcc', a=5.256)
    argon.calc = calc
    here = split(argon)
    end = calc.parameters.get('rc') or calc.parameters['rcut2'] * calc.parameters['r0']
    assert here.calc.bonds.lengths.max() < end * 1e-7
    assert len(here.calc.bonds) == len(neighbor_list('i', argon, end)) // 2
    X = analytic_bands(here, 'X').frequencies_Hz
    np.testing.assert_allclose(X, analytic_bands(split(argon, cutoff=end * (1 - 1e-6)), 'X').frequencies_Hz, rtol=1e-9)


@pytest.mark.parametrize('seed', few_first(range(4), 1))
@pytest.mark.parametrize('given', [True, False])
def test_stiffness_is_right_just_within_the_end_of_the_forces_and_of_sums_of_calculators(seed, given):
    rng = np.random.default_rng(seed)
    sigma, epsilon, end = rng.uniform(2.4, 3.5, 2), rng.uniform(0.01, 0.5, 2), 8.0
    r = end * (1 - 10 ** rng.uniform(-5, -2.5))  # the force jumps at the end
    triple = Atoms('Ar3', [[0, 0, 0], [4.0, 0, 0], [r, 0, 0]])
    triple.calc = SumCalculator([LennardJones(sigma=s, epsilon=e, rc=end) for s, e in zip(sigma, epsilon, strict=True)])
    here = split(triple, end if given else None)
    lengths = here.calc.bonds.lengths
    x = sigma[:, None] / (lengths * 1e7)
    exact = (4 * epsilon[:, None] * (156 * x**12 - 42 * x**6)).sum(axis=0) / lengths**2 * ase.units._e * 1e3
    assert lengths.max() == pytest.approx(r * 1e-7)
    np.testing.assert_allclose(here.calc.law.d2phi(lengths), exact, rtol=0, atol=1e-6 * abs(exact).max())


class Bent(Calculator):
    """Neighbours in a row joined by springs, `sum (r - 1.5)^2/2`, and stiff against bending, `bend sum (1 + cos angle)`."""

    implemented_properties = ['energy', 'forces']  # noqa: RUF012
    bend = 0.0

    def calculate(self, atoms=None, properties=('energy',), system_changes=all_changes):
        super().calculate(atoms, properties, system_changes)
        R = np.diff(atoms.positions, axis=0)
        r = np.linalg.norm(R, axis=1)[:, None]
        n, joined = R / r, r < 3
        pull = joined * (r - 1.5) * n
        cosine = (n[1:] * n[:-1]).sum(axis=1)[:, None]
        pull[1:] -= self.bend * (n[:-1] - cosine * n[1:]) / r[1:]
        pull[:-1] -= self.bend * (n[1:] - cosine * n[:-1]) / r[:-1]
        zero = np.zeros((1, 3))
        self.results = {'energy': float((joined * (r - 1.5) ** 2).sum() / 2 + self.bend * (1 - cosine).sum()),
                        'forces': np.vstack([pull, zero]) - np.vstack([zero, pull])}


@pytest.mark.parametrize('along', np.eye(3))
def test_a_row_that_resists_bending_is_refused_although_its_angles_are_straight(along):
    row = Atoms('Ar4', np.outer(np.arange(4), 1.6 * along))
    row.calc = Bent()
    split(row)  # the control
    row.calc.bend = 0.1
    with pytest.raises(ValueError, match='not a sum over pairs'):
        split(row)


def test_many_body_energies_are_refused_with_the_difference():
    copper = bulk('Cu', 'fcc', a=3.6)
    copper.calc = EMT()
    with pytest.raises(ValueError, match=r'EMT is not a sum over pairs.*up to 0\.\d+ of the largest'):
        split(copper)
    argon = bulk('Ar', 'fcc', a=5.3)
    for many, refused in ((0.0, False), (1e-2, True)):
        argon.calc = Pairs({frozenset({'Ar'}): 50.0}, 4.0, 7.0, many)
        if refused:
            with pytest.raises(ValueError, match='not a sum over pairs'):
                split(argon)
        else:
            split(argon)


def test_a_force_without_an_end_asks_for_a_cutoff():
    chain = Atoms('Ar', cell=[4.0, 20, 20], pbc=(True, False, False))
    chain.calc = Pairs({frozenset({'Ar'}): 1.0}, 3.0, np.inf)
    with pytest.raises(ValueError, match='give a cutoff= in Angstrom'):
        split(chain)
    with pytest.raises(ValueError, match='carry no calculator'):
        split(Atoms('Ar'))
    for x, words in ((0.0, 'coincide'), (np.nan, 'finite number')):
        with pytest.raises(ValueError, match=words):
            split(Atoms('Ar2', [[0, 0, 0], [x, 0, 0]], calculator=LennardJones()))


class Pin(Calculator):
    """A spring between one atom and its place, in structures of numbers of atoms for which it `acts`."""

    implemented_properties = ['energy', 'forces']  # noqa: RUF012

    def __init__(self, k, atom, place, acts):
        super().__init__()
        self.k, self.atom, self.place, self.acts = k, atom, place, acts

    def calculate(self, atoms=None, properties=('energy',), system_changes=all_changes):
        super().calculate(atoms, properties, system_changes)
        forces, u = np.zeros((len(atoms), 3)), np.zeros(3)
        if self.acts(len(atoms)):
            u = atoms.positions[self.atom] - self.place
            forces[self.atom] = -self.k * u
        self.results = {'energy': self.k * u @ u / 2, 'forces': forces}


@pytest.mark.parametrize('repeat', few_first([[2, 2, 1], [3, 2, 2], [3, 3, 3]], 1))
@pytest.mark.parametrize('share', few_first([0.0, 0.4, 0.99], 1))
def test_a_pin_on_one_atom_is_no_sum_over_pairs(repeat, share):
    """All forces are compared, not those of a few atoms: the stiffness of the pinned one would be wrong.

    Two atoms alone do not see the pin; one that knows its own structure only does not act in several cells either.
    """
    atoms = bulk('Ar', 'fcc', a=5.256).repeat(repeat)
    lj = LennardJones(sigma=3.4, epsilon=0.0103, rc=4.5)
    at = int(share * len(atoms))
    for k, acts in ((1.0, lambda n: n > 2), (1.0, lambda n: n == len(atoms)), (np.nan, lambda n: n > 2)):
        atoms.calc = SumCalculator([lj, Pin(k, at, atoms.positions[at].copy(), acts)])
        with pytest.raises(ValueError, match='is not a sum over pairs'):
            split(atoms)
    atoms.calc = lj  # the control
    split(atoms)


def test_potentials_of_matscipy_need_a_cell_around_two_atoms():
    from matscipy.calculators.pair_potential import PairPotential
    from matscipy.calculators.pair_potential.calculator import LennardJonesCut

    argon, found = bulk('Ar', 'fcc', a=5.256), []
    for calc in (LennardJones(sigma=3.4, epsilon=0.0103, rc=7.5), PairPotential({(18, 18): LennardJonesCut(0.0103, 3.4, 7.5)})):
        argon.calc = calc
        found.append([analytic_bands(split(argon), 'GX', model).omega ** 2 for model in ('complete', 'conventional')])
    np.testing.assert_allclose(found[1], found[0], rtol=0, atol=1e-9 * np.max(found[0]))
