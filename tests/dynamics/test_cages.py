"""When a list of bonds made at rest ceases to hold: shots on both sides of the barrier, in every engine; planes; threads."""

import pickle
from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from copy import deepcopy
from itertools import product

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixedPlane
from ase.md.langevin import Langevin
from ase.units import kB
from motion import L0, LAW, MASS, patch

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.dynamics import Diverged
from magphonon.dynamics.cages import Cages, pairs_without_bond
from magphonon.lattices.bonds import explicit_bonds

ENGINES = ['ase', 'compiled']
WIDE = ['ase', pytest.param('compiled', marks=pytest.mark.slow)]  # strains for which several kernels are compiled


def test_pairs_without_bond_are_told_apart_where_their_numbers_exceed_32_bits():
    """Of 196 610 particles the pairs (0, 1) and (21 845, 21 847) are numbered 2^32 apart: i n + j."""
    places = 100.0 * np.arange(196_610)
    places[[1, 21_847]] = places[[0, 21_845]] + 1
    atoms = Atoms(numbers=0 * places, positions=np.stack([places, 0 * places, 0 * places], axis=1))
    other = pairs_without_bond(explicit_bonds(atoms, [(0, 1)]), atoms, 2.0)
    assert (other.i.tolist(), other.j.tolist()) == ([21_845], [21_847])


def shot(speed, degrees, engine, time=16.0, cell=None, law=LAW, foundation=0.0196757):
    """One particle in the middle of a hexagon of the prototype, shot in its plane; the run and the atoms."""
    atoms = lattices.hexagon(cell or lattices.triangular(L0, MASS), 6 * L0)
    atoms.calc = MagneticRepulsion(atoms, law, foundation=foundation)
    middle = np.linalg.norm(atoms.positions, axis=1).argmin()
    direction = np.cos(np.radians(degrees)), np.sin(np.radians(degrees)), 0
    atoms.set_momenta(np.outer(np.arange(len(atoms)) == middle, MASS * speed * np.array(direction)))
    DrivenVerlet(atoms, 0.02, engine=engine).run(round(time / 0.02))
    return atoms


def nearest_without_bond(atoms, spacing=L0):
    """By brute force over all pairs farther apart at rest than nearest neighbours."""
    now, rest = (np.linalg.norm(p[:, None] - p, axis=2) for p in (atoms.positions, atoms.calc.reference.positions))
    return now[rest > 1.1 * spacing].min()


@pytest.mark.slow
@pytest.mark.parametrize('engine', ENGINES)
def test_a_magnet_that_leaves_its_cell_ends_the_run(engine):
    # Through the gap between two neighbours (30 degrees).  At 3.5 m/s it turns back 11.5 mm from the magnet behind the gap; at
    # 4 m/s it went on, 2.24 spacings far, and passed a magnet at 0.02 mm.
    with pytest.raises(Diverged, match=r'has no bond.*the list of bonds is no longer valid') as caught:
        shot(4.0, 30, engine)
    good = caught.value.atoms
    assert 5 < caught.value.last_good < caught.value.time < 8
    assert L0 < nearest_without_bond(good) < 1.11 * L0  # looked at every tenth of a spacing


@pytest.mark.slow
@pytest.mark.parametrize('degrees', [0, 30])
def test_a_magnet_that_turns_back_does_not(degrees):
    assert nearest_without_bond(shot(3.5, degrees, 'compiled')) > L0


@pytest.mark.filterwarnings('ignore:a velocity of')
@pytest.mark.parametrize('engine', WIDE)
def test_a_shot_at_the_second_neighbour_is_stopped(engine):
    # the weak square lattice: nothing is in the way along the diagonal, and 0.0019 spacings were reached without a word
    with pytest.raises(Diverged, match='has no bond'):
        shot(0.3, 45, engine, 60.0, lattices.square(L0, MASS), InversePower(b=1e-3, a=4.0), foundation=0.0)


def pair(speed, law):
    atoms = Atoms('Nd2', positions=[[0, 0, 0], [L0, 0, 0]], masses=[MASS, MASS])
    atoms.calc = MagneticRepulsion(atoms, law)
    atoms.set_momenta([[0, 0, 0], [MASS * speed, 0, 0]])
    return atoms


@pytest.mark.parametrize(('speed', 'reached'), [(-0.5, 1 / 3), (0.5, 3.0)])
@pytest.mark.parametrize('engine', WIDE)
def test_bonds_end_at_a_third_and_at_three_times_their_length(engine, speed, reached):
    atoms = pair(speed, InversePower(b=1e-9, a=1.0))  # too weak to matter: the distance is 10 + speed t
    with pytest.raises(Diverged, match='mm from its neighbour 1 instead of 10 mm') as caught:
        DrivenVerlet(atoms, 0.1, engine=engine).run(10_000)
    at = L0 + speed * caught.value.time
    before = L0 + speed * caught.value.last_good
    assert (at <= reached * L0 <= before) if speed < 0 else (before <= reached * L0 <= at)
    assert abs(at - before) < 2.1  # between two looks: a block of 32 steps, or 0.1 of the spacing and one step


@pytest.mark.parametrize(('model', 'measure'), [('complete', 'length'), ('conventional', 'projection')])
def test_bonds_are_measured_as_the_model_measures_them(model, measure):
    """At right angles to the bond and along it, on either side of a third and of three times its length."""
    atoms = pair(0.0, InversePower(b=1e-9, a=1.0))
    atoms.calc.set(model=model)
    for along, across in product((0.05, 0.3, 0.35, 1.0, 2.9, 3.1), (0.0, 2.7, 2.95, 4.0)):
        size = np.hypot(along, across) if measure == 'length' else along
        u = L0 * np.array([[0, 0], [along - 1, across]])
        if 1 / 3 < size < 3:
            Cages(atoms).look(u, 0.0)
        else:
            with pytest.raises(Diverged, match='mm from its neighbour 1 instead of 10 mm'):
                Cages(atoms).look(u, 0.0)


@pytest.mark.parametrize(('name', 'clearance'), [
    # two that come straight at each other need not be looked at before each has gone half the way: second neighbours to the
    # distance of a bond, or neighbours to a third of it
    ('triangular', 1 / 3), ('square', (np.sqrt(2) - 1) / 2), ('honeycomb', 1 / 3)])
def test_nobody_looks_before_two_can_have_met(name, clearance):
    atoms = getattr(lattices, name)(L0, MASS)
    atoms.calc = MagneticRepulsion(atoms, LAW, shells=2 if name == 'honeycomb' else 1)
    cages = Cages(atoms)
    assert cages.clearance == pytest.approx(clearance * L0)
    assert cages.still(0.999 * clearance * L0)
    assert not cages.still(1.001 * clearance * L0)
    assert cages.steps_between_looks(speed=1.0, largest=0.0, dt=0.01, most=1000) == int(clearance * L0 / 0.01)
    assert cages.steps_between_looks(speed=1.0, largest=clearance * L0, dt=0.01, most=1000) == 100  # a tenth of a spacing


@pytest.mark.parametrize('spacing', [L0, 1.0])  # mm
def test_where_it_is_clear_at_a_glance_no_pair_without_a_bond_is_near(spacing):
    rng = np.random.default_rng(4)
    atoms = lattices.hexagon(lattices.triangular(spacing, MASS), 4 * spacing)
    atoms.calc = MagneticRepulsion(atoms, InversePower(0.2 * spacing**4, 4.0), foundation=0.02)
    cages, seen = Cages(atoms), {True: [], False: []}
    assert not cages.still(spacing)  # it has surveyed the pairs
    for size in np.repeat([0.2, 0.3, 0.4], 40):
        u = size * spacing * rng.uniform(-1, 1, (len(atoms), 2)) * (atoms.get_tags() != lattices.RIM)[:, None]
        moved = atoms.copy()
        moved.calc, moved.positions = atoms.calc, atoms.positions + np.pad(u, ((0, 0), (0, 1)))
        near = nearest_without_bond(moved, spacing)
        seen[cages.clear(u.T)].append(near)
        with nullcontext() if near >= spacing else pytest.raises(Diverged):
            cages.look(u, 0.0, bonded=False)
    assert min(seen[True]) >= spacing > min(seen[False])  # the control: pairs are near in some of the others
    assert len(seen[True]) > 20
    assert not cages.clear(np.full((2, len(atoms)), np.nan))


@pytest.mark.slow
def test_replicas_that_stand_in_each_other_are_not_judged():
    atoms = Atoms('Nd4', positions=[[0, 0, 0], [L0, 0, 0], [0, 0, 0], [L0, 0, 0]], masses=[MASS] * 4)
    atoms.calc = MagneticRepulsion(atoms, InversePower(b=1e-3, a=1.0), bonds=[(0, 1), (2, 3)])
    atoms.set_momenta(np.outer([0, -1, 0, 1], [MASS * 0.3, 0, 0]))
    DrivenVerlet(atoms, 0.1, engine='compiled').run(100)
    assert abs(atoms.positions[1, 0] - atoms.positions[3, 0]) > 1


@pytest.mark.slow
def test_drifting_and_turning_as_a_whole_is_no_escape():
    atoms = patch(5, held=False, law=InversePower(b=1e-6, a=1.0))
    atoms.calc.set(foundation=0.0)
    x, y, _ = atoms.positions.T
    atoms.set_momenta(MASS * np.stack([1 - 0.02 * y, 0.5 + 0.02 * x, 0 * x], axis=1))
    DrivenVerlet(atoms, 0.1, engine='compiled').run(200)  # 20 mm, and 23 degrees
    assert abs(atoms.positions - atoms.calc.reference.positions).max() > 2 * L0


# --- planar structures ----------------------------------------------------------------------------------------------


KT = 1e-6  # mJ


def warm(held):
    atoms = lattices.triangular(L0, MASS).repeat((6, 6, 1))
    if held:
        atoms.set_constraint(FixedPlane(range(36), (0, 0, 1)))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=0.0196757)
    atoms.set_momenta(np.sqrt(MASS * KT) * np.random.default_rng(0).normal(size=(36, 3)))  # through the constraint
    return atoms


def test_heat_out_of_the_plane_is_refused_with_the_mend():
    with pytest.raises(ValueError, match=r'moves out of the plane, but the structure is planar.*FixedPlane'):
        warm(held=False).get_forces()
    atoms = lattices.triangular(L0, MASS).repeat((2, 2, 1))
    atoms.calc = MagneticRepulsion(atoms, LAW)
    atoms.rattle(0.02 * L0, seed=1)  # as a finite difference may be; nothing acts on it
    atoms.get_forces()
    atoms.rattle(0.2 * L0, seed=1)
    with pytest.raises(ValueError, match=r'mm out of the plane, but the structure is planar.*FixedPlane'):
        atoms.get_forces()


def test_a_plane_keeps_langevins_heat_in_the_plane():
    atoms = warm(held=True)
    dyn = Langevin(atoms, 0.2, temperature_K=KT / kB, friction=0.05, fixcm=False, rng=np.random.default_rng(1))
    dyn.run(500)
    kinetic = []
    for _ in range(60):
        dyn.run(25)
        kinetic.append(atoms.get_kinetic_energy())
    assert not (atoms.positions[:, 2] - atoms.calc.reference.positions[:, 2]).any()
    # 72 freedoms with kT/2 each, not 108.  60 looks, every quarter of a decay time: 15 to 60 independent ones, each with a
    # spread of sqrt(2/72); three sigma are 13 % at most
    assert np.mean(kinetic) == pytest.approx(72 * KT / 2, rel=0.13)


# --- threads --------------------------------------------------------------------------------------------------------


def test_threads_may_share_a_calculator():
    atoms = patch(7, held=False)
    calc, rng = atoms.calc, np.random.default_rng(0)
    moved = []
    for _ in range(40):
        other = atoms.copy()
        other.positions[:, :2] += 0.1 * rng.normal(size=(49, 2))
        moved.append(other)
    expected = [deepcopy(calc).get_forces(other) for other in moved]
    with ThreadPoolExecutor(4) as pool:
        for _ in range(8):
            for forces, right in zip(pool.map(calc.get_forces, moved), expected, strict=True):
                assert np.array_equal(forces, right)
    assert np.array_equal(pickle.loads(pickle.dumps(calc)).get_forces(moved[0]), expected[0])
