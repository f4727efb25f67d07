"""What changes between two runs of one DrivenVerlet: every engine goes on as plain velocity Verlet does from the same state."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from oracles import neighbour_vectors, verlet

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.dynamics.engine import Blocks

LAW = InversePower(b=3000.0, a=4.6)
L0, DT, STEPS, K = 10.0, 0.02, 25, 0.5  # mm, ms, steps from one change to the next, N/mm
EXACT = 1e-9  # of the largest displacement: positions of 30 mm are rounded to 4e-15 mm, displacements are 0.1 mm and more


class Moved:
    """A patch in motion, and beside it the truth: absolute positions and velocities, moved by textbook pair forces."""

    def __init__(self, rng, engine):
        cell = getattr(lattices, rng.choice(['triangular', 'square', 'honeycomb']))(L0, 0.7)
        self.atoms = atoms = lattices.hexagon(cell, rng.uniform(20, 30))
        self.bonds = np.array([(i, j) for i, j, *_ in neighbour_vectors(atoms, 1.2 * L0) if i < j]).T
        atoms.set_masses(rng.uniform(0.5, 1.0, len(atoms)))
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=K)
        self.rim, self.anchors, self.k, self.gamma, self.dt = atoms.constraints, atoms.positions[:, :2].copy(), K, 0.0, DT
        self.x, self.v = self.anchors.copy(), rng.uniform(-1, 1, (len(atoms), 2))
        atoms.set_momenta(atoms.get_masses()[:, None] * np.pad(self.v, ((0, 0), (0, 1))))
        self.dyn = DrivenVerlet(atoms, DT, engine=engine)

    def run(self):
        """Both; how far they end apart, as a share of the largest displacement."""
        atoms, (i, j) = self.atoms, self.bonds
        u, self.v = verlet(atoms, LAW, self.dt, STEPS, bonds=(i, j, self.anchors[j] - self.anchors[i]), foundation=self.k,
                           damping=self.gamma, velocities=self.v, displacements=self.x - self.anchors)
        self.x = self.anchors + u
        self.dyn.run(STEPS)
        return max(abs(atoms.positions[:, :2] - self.x).max(), abs(atoms.get_velocities()[:, :2] - self.v).max(),
                   abs(self.dyn.velocities - self.v).max(),
                   abs(self.dyn.displacements - (self.x - atoms.calc.reference.positions[:, :2])).max()) / abs(u).max()


def inner(moved, rng, count):
    return rng.choice(np.flatnonzero(moved.atoms.get_tags() != lattices.RIM), count, replace=False)


def pillars_moved(moved, rng):
    """A calculator about another reference, whose springs are slack there."""
    reference = moved.atoms.calc.reference.copy()
    reference.positions[inner(moved, rng, 3), :2] += rng.uniform(-1, 1, (3, 2))
    moved.atoms.calc = MagneticRepulsion(reference, LAW, foundation=moved.k, bonds=moved.atoms.calc.bonds)
    moved.anchors = reference.positions[:, :2].copy()


def about_where_it_is(moved, rng):
    """The same forces, but displacements count from elsewhere."""
    moved.atoms.calc = moved.atoms.calc.about(moved.atoms)


def guided(moved, rng):
    one, two, held = np.split(inner(moved, rng, 4), [1, 3])
    angle = rng.uniform(0, 2 * np.pi)
    moved.atoms.set_constraint([*moved.rim, FixedLine(one, (np.cos(angle), np.sin(angle), 0)), FixedPlane(two, (0, 1, 0)),
                                FixAtoms(held)])


def released(moved, rng):
    moved.atoms.set_constraint(moved.rim)


def heavier(moved, rng):
    """The particles keep their momenta."""
    before = moved.atoms.get_masses()
    moved.atoms.set_masses(before * rng.uniform(0.6, 1.7, len(before)))
    moved.v *= (before / moved.atoms.get_masses())[:, None]


def stiffer(moved, rng):
    moved.k *= rng.uniform(0.5, 2)
    moved.atoms.calc.set(foundation=moved.k)


def damped(moved, rng):
    moved.gamma = rng.uniform(0, 0.5) if rng.random() < 0.5 else rng.uniform(0, 0.5, len(moved.atoms))
    moved.dyn.damping = moved.gamma


def slower(moved, rng):
    moved.dt = moved.dyn.dt = DT * rng.uniform(0.5, 1.5)


CHANGES = (pillars_moved, about_where_it_is, guided, released, heavier, stiffer, damped, slower)


def largest_difference(seed, engine, changes):
    rng = np.random.default_rng(seed)
    moved = Moved(rng, engine)
    apart = [moved.run()]
    for change in changes:
        change(moved, rng)
        apart.append(moved.run())
    return max(apart)


@pytest.mark.parametrize('engine', ['ase', 'numpy'])
@pytest.mark.parametrize('seed', range(8))
def test_every_change_is_followed(engine, seed):
    changes = np.random.default_rng(seed).permutation(CHANGES)
    assert largest_difference(seed, engine, changes) < EXACT


def without_a_look_at_the_reference(self, old):
    self._take(old.displacements, old.velocities, old._anchors)


def without_new_guides(self, old):
    self._motion.barred[:] = 0
    self.adopt_as_it_is(old)


def with_velocities_kept(self, old):
    old._masses = self._masses
    self.adopt_as_it_is(old)


@pytest.mark.parametrize(('fault', 'change', 'unseen'), [
    (without_a_look_at_the_reference, pillars_moved, stiffer), (without_a_look_at_the_reference, about_where_it_is, stiffer),
    (without_new_guides, guided, about_where_it_is), (with_velocities_kept, heavier, guided)])
def test_a_state_that_is_taken_over_wrongly_is_noticed(monkeypatch, fault, change, unseen):
    monkeypatch.setattr(Blocks, 'adopt_as_it_is', Blocks.adopt, raising=False)
    monkeypatch.setattr(Blocks, 'adopt', fault)
    assert largest_difference(0, 'numpy', [change]) > 1e3 * EXACT
    assert largest_difference(0, 'numpy', [unseen]) < EXACT


def test_displacements_keep_their_digits_where_the_reference_stays():
    # 1e-12 mm in positions of 30 mm would be read with two digits
    moved = Moved(np.random.default_rng(3), 'numpy')
    moved.atoms.set_momenta(1e-12 * moved.atoms.get_momenta())
    moved.v *= 1e-12
    moved.run()
    before = moved.dyn.displacements
    for change in (guided, heavier, stiffer, damped, slower, released):
        change(moved, np.random.default_rng(3))
    moved.dyn.run(0)
    assert np.array_equal(moved.dyn.displacements, before)


@pytest.mark.parametrize('engine', ['auto', 'ase', 'numpy'])
@pytest.mark.parametrize('allow_unstable', [False, True])
@pytest.mark.parametrize('change', [lambda atoms: setattr(atoms, 'pbc', False), lambda atoms: setattr(atoms, 'pbc', (1, 0, 0)),
                                    lambda atoms: atoms.set_cell(1.05 * atoms.cell),
                                    lambda atoms: atoms.set_cell(1.05 * atoms.cell, scale_atoms=True)])
def test_another_cell_is_refused_by_every_engine(engine, allow_unstable, change):
    atoms = lattices.honeycomb(L0, 0.7).repeat((3, 3, 1))
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=K)
    dyn = DrivenVerlet(atoms, DT, engine=engine, allow_unstable=allow_unstable)
    dyn.run(10)
    change(atoms)
    for _ in range(2):
        with pytest.raises(ValueError, match='the cell or its periodicity differs from the reference'):
            dyn.run(10)
    atoms.calc = MagneticRepulsion(atoms, LAW, foundation=K, bonds=[(0, 1)])
    dyn.run(10)


@pytest.mark.parametrize('damping', [-0.1, [0.1, 0.2], 'much', np.nan])
def test_an_impossible_damping_is_refused_as_at_the_start(damping):
    moved = Moved(np.random.default_rng(0), 'numpy')
    with pytest.raises(ValueError, match='damping') as first:
        DrivenVerlet(moved.atoms, DT, damping=damping)
    with pytest.raises(ValueError, match='damping') as later:
        moved.dyn.damping = damping
    assert str(first.value) == str(later.value)


@pytest.mark.parametrize('blocks', [1, 3])
def test_atoms_are_where_blocks_are_after_an_interrupt_between_two_looks(blocks, monkeypatch):
    moved = Moved(np.random.default_rng(blocks), 'numpy')
    steps, advance = [], Blocks.advance

    def interrupted(self, first, count):
        if len(steps) == blocks:
            raise KeyboardInterrupt
        advance(self, first, count)
        steps.append(count)

    monkeypatch.setattr(Blocks, 'advance', interrupted)
    with pytest.raises(KeyboardInterrupt):
        moved.dyn.run(200)  # nobody observes: looks at the bonds are all that ends a block
    monkeypatch.undo()
    assert moved.dyn.nsteps == sum(steps)
    whole = Moved(np.random.default_rng(blocks), 'numpy')
    whole.dyn.run(sum(steps))
    assert np.array_equal(moved.atoms.positions, whole.atoms.positions)
    # the control: they have moved on
    assert abs(moved.atoms.positions - Moved(np.random.default_rng(blocks), 'numpy').atoms.positions).max() > 0.1
    moved.dyn.run(200 - sum(steps))
    whole.dyn.run(200 - sum(steps))
    assert abs(moved.dyn.displacements - whole.dyn.displacements).max() < EXACT * abs(whole.dyn.displacements).max()
