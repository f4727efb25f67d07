"""Bonds beyond the range of their law: the calculator raises Diverged instead of a force, whoever moves the particles."""

import numpy as np
import pytest
from ase import Atoms
from ase.md.verlet import VelocityVerlet
from structures import few_first

from magphonon import InversePower, lattices
from magphonon.dynamics import Diverged, highest_frequency
from magphonon.interactions import Cable, Overlap, Spring, Tabulated, Yukawa
from magphonon.stiffness import PairCalculator

L0, MASS = 10.0, 0.707
MAGNETS = InversePower(6200.0, 4.5824)


def patch(side=40.0):
    atoms = lattices.hexagon(lattices.triangular(L0, MASS), side)
    atoms.calc = PairCalculator(atoms, MAGNETS, foundation=0.02)
    u = np.random.default_rng(1).normal(0, 1e-3, (len(atoms), 3)) * [1, 1, 0]
    atoms.set_velocities(u)
    return atoms


def leapfrog(atoms, dt, steps):
    """Somebody's own loop."""
    v = atoms.get_velocities()
    for _ in range(steps):
        v += dt * atoms.get_forces() / MASS
        atoms.positions += dt * v


@pytest.mark.parametrize('run', few_first([lambda atoms, dt, steps: VelocityVerlet(atoms, dt).run(steps), leapfrog], 1))
@pytest.mark.parametrize('share', [0.98, 1.05])
def test_integrators_stop_where_their_step_is_too_long(run, share):
    atoms = patch()
    dt = share * 2 / highest_frequency(atoms)
    if share < 1:
        run(atoms, dt, 1000)
        assert abs(atoms.positions - atoms.calc.reference.positions).max() < 1.0
        return
    with pytest.raises(Diverged, match=r'particle \d+ is [\d.]+ mm from its neighbour \d+ instead of 10 mm') as caught:
        run(atoms, dt, 200)
    assert caught.value.time is None
    bonds = atoms.calc.bonds
    bond = atoms.positions[bonds.j] - atoms.positions[bonds.i]
    ratio = np.linalg.norm(bond, axis=1)[bonds.i == caught.value.particle] / L0
    assert ratio.max() > 3 or ratio.min() < 1 / 3


def pair(law, length, model='complete', **options):
    """Two particles that rest 10 mm apart, now `length` apart."""
    atoms = Atoms('Nd2', positions=[[0, 0, 0], [L0, 0, 0]], masses=[MASS, MASS])
    atoms.calc = PairCalculator(atoms, law, model=model, **options)
    atoms.positions[1, 0] = length
    return atoms


@pytest.mark.parametrize('model', ['complete', 'conventional'])
@pytest.mark.parametrize('law', [MAGNETS, Yukawa(20.0, 0.1), Spring(1.0, 9.0), Tabulated(np.geomspace(1, 60, 30),
                                                                                       np.geomspace(1, 60, 30) ** -3)])
@pytest.mark.parametrize('ratio', [0.2, 0.33, 0.34, 1.0, 2.99, 3.01, 5.0])
def test_a_bond_has_a_force_from_a_third_to_three_times_its_length(law, model, ratio):
    atoms = pair(law, ratio * L0, model)
    if 1 / 3 < ratio < 3:
        assert atoms.get_forces()[1, 0] == pytest.approx(-law.dphi(ratio * L0), rel=1e-12)
        assert atoms.calc.get_hessian(atoms).nnz
        return
    for ask in (atoms.get_forces, atoms.get_potential_energy, lambda: atoms.calc.get_hessian(atoms)):
        with pytest.raises(Diverged, match=f'particle 0 is {ratio * L0:g} mm from its neighbour 1 instead of 10 mm'):
            ask()


@pytest.mark.parametrize(('law', 'length'), [
    (Overlap(300.0, 2.5, 10.5), 35.0), (Overlap(300.0, 2.5, 10.5), 1e4), (Cable(1.0, 9.5), 2.0), (Cable(1.0, 9.5), 1e-3)])
def test_contacts_that_opened_and_cables_that_are_slack_have_no_force_at_any_distance(law, length):
    assert not pair(law, length).get_forces().any()


def test_a_cable_in_tension_has_a_range():
    with pytest.raises(Diverged):
        pair(Cable(1.0, 9.5), 31.0).get_forces()


def test_a_table_still_names_its_first_distance():
    with pytest.raises(ValueError, match=r'distance 7 mm is outside the table \(8 to 20 mm\)'):
        pair(Tabulated([8.0, 9.0, 10.0, 12.0, 20.0], [0.66, 0.38, 0.24, 0.10, 0.01]), 7.0).get_forces()


def test_each_bond_is_judged_by_its_own_length():
    """A short bond and one of three and a half times its length: the longer one may be shorter than the limit of the other."""
    atoms = Atoms('Nd3', positions=[[0, 0, 0], [10, 0, 0], [45, 0, 0]], masses=[MASS] * 3)
    atoms.calc = PairCalculator(atoms, MAGNETS, bonds=[(0, 1), (1, 2)])
    atoms.positions[2, 0] = 36.0  # 26 mm of 35
    atoms.get_forces()
    atoms.positions[1, 0] = 31.0
    with pytest.raises(Diverged, match='particle 0 is 31 mm from its neighbour 1 instead of 10 mm'):
        atoms.get_forces()
    atoms.positions[1:, 0] = 10.0, 20.0
    with pytest.raises(Diverged, match='particle 1 is 10 mm from its neighbour 2 instead of 35 mm'):
        atoms.get_forces()


@pytest.mark.parametrize('repeat', few_first([1, 2, 4, 7], 1))
@pytest.mark.parametrize('wrapped', [False, True])
def test_a_lattice_that_drifts_through_its_periods_keeps_its_bonds(repeat, wrapped):
    """Each particle is measured from the nearest image of its site; as they pass the border one by one, bonds must not jump."""
    cell = lattices.triangular(L0, MASS)
    atoms = cell.repeat((repeat, repeat, 1))
    atoms.calc = PairCalculator(atoms, MAGNETS)
    still = atoms.copy()
    still.calc = PairCalculator(still, MAGNETS)
    rng = np.random.default_rng(3)
    v = rng.normal(0, 0.01, (len(atoms), 3)) * [1, 1, 0]
    still.set_velocities(v)
    drift = np.array([1.0, 0.3, 0.0])
    atoms.set_velocities(v + drift)
    for a in (still, atoms):
        dyn = VelocityVerlet(a, 0.1)
        for _ in range(40):
            dyn.run(20)
            if wrapped and a is atoms:
                a.wrap()
    assert np.allclose(atoms.get_velocities() - drift, still.get_velocities(), rtol=0, atol=1e-9)
