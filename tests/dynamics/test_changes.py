"""Settings that change between two runs, by an observer, or in the body of `irun`: every engine goes on as textbook velocity
Verlet does from the same state."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from oracles import neighbour_vectors, verlet

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.dynamics import Constant, Recorder
from magphonon.dynamics.engine import Blocks

pytestmark = pytest.mark.slow   # each compiles kernels of its own, which takes seconds

LAW, ANOTHER = InversePower(b=3000.0, a=4.6), InversePower(b=1500.0, a=4.1)
L0, DT, STEPS, K = 10.0, 0.02, 25, 0.5  # mm, ms, steps from one change to the next, N/mm
EXACT = 1e-9  # of the largest displacement: positions of 30 mm are rounded to 4e-15 mm, displacements are 0.1 mm and more


class Moved:
    """A patch in motion, and beside it the truth: absolute positions and velocities, moved by textbook pair forces."""

    def __init__(self, rng, engine):
        cell = getattr(lattices, rng.choice(['triangular', 'square', 'honeycomb']))(L0, 0.7)
        self.atoms = atoms = lattices.hexagon(cell, rng.uniform(20, 30))
        self.bonds = np.array([(i, j) for i, j, *_ in neighbour_vectors(atoms, 1.2 * L0) if i < j]).T
        atoms.set_masses(rng.uniform(0.5, 1.0, len(atoms)))
        self.law, self.k, self.strengths, self.load = LAW, K, np.ones(len(atoms)), np.zeros((len(atoms), 3))
        self.push = np.zeros((len(atoms), 3))
        self.model, self.rim, self.anchors, self.gamma, self.dt = 'complete', atoms.constraints, atoms.get_positions(), 0.0, DT
        self.renew(atoms)
        self.x, self.v = atoms.positions[:, :2].copy(), rng.uniform(-1, 1, (len(atoms), 2))
        atoms.set_momenta(atoms.get_masses()[:, None] * np.pad(self.v, ((0, 0), (0, 1))))
        self.dyn = DrivenVerlet(atoms, DT, engine=engine)

    def renew(self, reference):
        self.atoms.calc = MagneticRepulsion(reference, self.law, foundation=self.k, bonds=self.bonds.T.tolist(), load=self.load,
                                            anchors=self.anchors, strengths=self.strengths, model=self.model)

    def dphi(self, r):
        return self.strengths[self.bonds].prod(axis=0) * self.law.dphi(r)

    def apart(self):
        """Move the truth on by STEPS; how far the dynamics is from it, as a share of the largest displacement."""
        atoms, rest, k = self.atoms, self.atoms.calc.reference.positions, np.array(self.k).reshape(-1, 1)
        pull = (self.load + self.push - k * (rest - self.anchors))[:, :2]
        u, self.v = verlet(atoms, self, self.dt, STEPS, bonds=(*self.bonds, (rest[self.bonds[1]] - rest[self.bonds[0]])[:, :2]),
                           foundation=k, model=self.model, damping=self.gamma, drive=lambda _: pull, velocities=self.v,
                           displacements=self.x - rest[:, :2])
        self.x = rest[:, :2] + u
        return max(abs(atoms.positions[:, :2] - self.x).max(), abs(atoms.get_velocities()[:, :2] - self.v).max(),
                   abs(self.dyn.velocities - self.v).max(), abs(self.dyn.displacements - u).max()) / abs(u).max()


def inner(moved, rng, count):
    return rng.choice(np.flatnonzero(moved.atoms.get_tags() != lattices.RIM), count, replace=False)


def pillars_moved(moved, rng):
    """A calculator about another reference, whose springs are slack there."""
    reference = moved.atoms.calc.reference.copy()
    reference.positions[inner(moved, rng, 3), :2] += rng.uniform(-1, 1, (3, 2))
    moved.anchors = reference.get_positions()
    moved.renew(reference)


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


def kicked(moved, rng):
    moved.x = moved.x + rng.uniform(-0.1, 0.1, moved.x.shape) * moved.atoms.get_momenta()[:, :2].any(axis=1, keepdims=True)
    moved.atoms.positions[:, :2] = moved.x


def slowed(moved, rng):
    share = rng.uniform(0, 1, (len(moved.atoms), 1))
    moved.v = share * moved.v
    moved.atoms.set_momenta(share * moved.atoms.get_momenta())


def stiffer(moved, rng):
    moved.k = K * (rng.uniform(0.5, 2) if rng.random() < 0.5 else rng.uniform(0.5, 2, len(moved.atoms)))
    moved.atoms.calc.set(foundation=moved.k)


def of_another_law(moved, rng):
    moved.law = ANOTHER if moved.law is LAW else LAW
    moved.renew(moved.atoms.calc.reference)


def of_other_strengths(moved, rng):
    moved.strengths = rng.uniform(0.9, 1.1, len(moved.atoms))
    moved.renew(moved.atoms.calc.reference)


def loaded(moved, rng):
    moved.load = rng.uniform(-0.05, 0.05, moved.load.shape) * [1, 1, 0]
    moved.renew(moved.atoms.calc.reference)


def pushed(moved, rng):
    particles, force = inner(moved, rng, 3), rng.uniform(0.01, 0.05, 3)
    moved.push = np.zeros(moved.push.shape)
    moved.push[particles, 1] = force
    moved.dyn.drives = [Constant(particles, (0, 1), force)]


def with_fixed_directions(moved, rng):
    moved.model = 'conventional' if moved.model == 'complete' else 'complete'
    moved.atoms.calc.set(model=moved.model)


def damped(moved, rng):
    moved.gamma = rng.uniform(0, 0.5) if rng.random() < 0.5 else rng.uniform(0, 0.5, len(moved.atoms))
    moved.dyn.damping = moved.gamma


def slower(moved, rng):
    """Drives are functions of the number of steps times the step, so they must go first."""
    moved.push, moved.dyn.drives = 0 * moved.push, []
    moved.dt = moved.dyn.dt = DT * rng.uniform(0.5, 1.5)


CHANGES = (pillars_moved, about_where_it_is, guided, released, heavier, kicked, slowed, pushed, stiffer, of_another_law,
           of_other_strengths, loaded, with_fixed_directions, damped, slower)


def largest_difference(seed, engine, changes, way='runs'):
    """Over STEPS before the first and after each of the changes, which are made between runs, by an observer or in `irun`."""
    rng = np.random.default_rng(seed)
    moved, apart, left = Moved(rng, engine), [], list(changes)
    dyn, steps = moved.dyn, STEPS * (len(changes) + 1)

    def look():
        if dyn.nsteps == STEPS * (len(apart) + 1):
            apart.append(moved.apart())
            if left:
                left.pop(0)(moved, rng)

    if way == 'observer':
        dyn.attach(look, interval=5)
        dyn.run(steps)
    elif way == 'body':
        dyn.attach(lambda: None, interval=STEPS)
        for _ in dyn.irun(steps):
            look()
    else:
        for _ in range(steps // STEPS):
            dyn.run(STEPS)
            look()
    assert len(apart) == len(changes) + 1
    return max(apart)


@pytest.mark.slow
@pytest.mark.parametrize('way', ['runs', 'observer', 'body'])
@pytest.mark.parametrize('engine', ['auto', 'ase', 'compiled'])
@pytest.mark.parametrize('seed', range(4))
def test_every_change_is_followed(engine, seed, way):
    changes = np.random.default_rng(seed).permutation(CHANGES)
    assert largest_difference(seed, engine, changes, way) < EXACT


@pytest.mark.parametrize('change', [change for change in CHANGES if change not in (about_where_it_is, released)])
def test_a_change_that_is_not_followed_is_noticed(change):
    """The control: each of them leads to another motion, but for a mere reference and the release of whom nobody held."""
    moved, left = (Moved(np.random.default_rng(5), 'compiled') for _ in range(2))
    for one in moved, left:
        one.dyn.run(STEPS)
    moved.x = left.x = moved.atoms.positions[:, :2].copy()
    change(moved, np.random.default_rng(6))
    for one in moved, left:
        one.dyn.run(STEPS)
    assert abs(moved.atoms.positions - left.atoms.positions).max() > 1e3 * EXACT


@pytest.mark.parametrize('way', [kicked, about_where_it_is])
def test_a_recorder_sees_what_an_observer_before_it_has_changed(way):
    found = []
    for engine in ('ase', 'compiled'):
        moved = Moved(np.random.default_rng(7), engine)
        moved.dyn.attach(lambda moved=moved: moved.dyn.nsteps == STEPS and way(moved, np.random.default_rng(8)), interval=STEPS)
        recorder = Recorder(moved.dyn, interval=STEPS)
        moved.dyn.run(2 * STEPS)
        found.append(recorder.displacements)
    np.testing.assert_allclose(*found, rtol=0, atol=EXACT)


@pytest.mark.parametrize('engine', ['auto', 'ase', 'compiled'])
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
    moved = Moved(np.random.default_rng(0), 'compiled')
    with pytest.raises(ValueError, match='damping') as first:
        DrivenVerlet(moved.atoms, DT, damping=damping)
    with pytest.raises(ValueError, match='damping') as later:
        moved.dyn.damping = damping
    assert str(first.value) == str(later.value)


@pytest.mark.parametrize('blocks', [1, 3])
def test_atoms_are_where_blocks_are_after_an_interrupt_between_two_looks(blocks, monkeypatch):
    moved = Moved(np.random.default_rng(blocks), 'compiled')
    steps, advance = [], Blocks.advance

    def interrupted(self, first, count):
        if len(steps) == blocks:
            raise KeyboardInterrupt
        steps.append(count)
        return advance(self, first, count)

    monkeypatch.setattr(Blocks, 'advance', interrupted)
    with pytest.raises(KeyboardInterrupt):
        moved.dyn.run(200)  # nobody observes: looks at the bonds are all that ends a block
    monkeypatch.undo()
    assert moved.dyn.nsteps == sum(steps)
    whole = Moved(np.random.default_rng(blocks), 'compiled')
    whole.dyn.run(sum(steps))
    assert np.array_equal(moved.atoms.positions, whole.atoms.positions)
    # the control: they have moved on
    assert abs(moved.atoms.positions - Moved(np.random.default_rng(blocks), 'compiled').atoms.positions).max() > 0.1
    moved.dyn.run(200 - sum(steps))
    whole.dyn.run(200 - sum(steps))
    assert abs(moved.dyn.displacements - whole.dyn.displacements).max() < EXACT * abs(whole.dyn.displacements).max()
