"""ASE's loop against plain velocity Verlet, and the compiled engine against ASE's loop, on structures drawn over all traits.

Thousands of them: `python -m pytest -n 0 -m long tests/dynamics/test_engine.py`.
"""

from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from oracles import OwnLaws, allowed_motion, verlet
from structures import LAWS, held_by, structure

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.dynamics import Constant, Harmonic, PrescribedMotion, ToneBurst, memory_layout

L0, MASS, STEPS = 10.0, 0.7, 70  # mm, g; three blocks, the last one cut short
LAW = InversePower(b=8900.0, a=4.5)
EXACT = 2e-10
"""Of the largest displacement or velocity, for structures within 50 mm, and in proportion for wider ones: ASE's loop rounds
absolute positions, of 50 mm at 1e-14 mm, and under constraints makes velocities of their differences, by a step of 0.02 ms; both
add up over 70 steps of motion by 0.05 mm.
The oracle knows nothing of the force of 1e-10 N that may be left where particles relaxed."""
ONE_KERNEL = {'cells': ['triangular'], 'shells': 1, 'laws': LAWS[1:2]} | dict.fromkeys(
    ('layer', 'damping of each', 'periodic', 'holes', 'moved', 'anchors', 'relaxed', 'springs', 'conventional', 'strengths',
     'kinds', 'load', 'gyration', 'table'), False)
"""So restricted, all structures run through the same compiled code, and fast tests compile once."""

pytestmark = pytest.mark.filterwarnings('ignore:the foundation of')  # stiff on purpose: strains stay small


class Motion:
    """A drawn structure and what moves it, each trait there or not."""

    def __init__(self, seed, most=80, shells=2, order=None, **traits):
        self.case = structure(seed, most, shells=shells, foundation=(20.0, 30.0), **{'held elsewhere': False} | traits)
        self.rng, self.traits, self.atoms = np.random.default_rng([seed, 5]), self.case.traits, self.case.atoms
        rng, count, dim, held = self.rng, len(self.atoms), self.case.dim, held_by(self.atoms)
        free = np.setdiff1d(np.arange(count), held)
        size = self.case.truth.k.min() / 25  # of forces: springs are softer where particles relaxed
        self.order, self.damping, self.load = order or int(rng.choice([2, 2, 4, 6])), rng.choice([0.0, 0.1]), np.zeros((count, 3))
        if self.order == 2 and self.one('damping of each', 0.3):
            self.damping = rng.uniform(0, 0.2, count)
        if self.one('load', 0.3):
            loaded = rng.random((count, 1)) < rng.choice([0.05, 1.0])
            self.load[:, :dim] = 0.3 * size * loaded * rng.normal(size=(count, dim))
        gyration = 0.0
        if self.order == dim == 2 and self.one('gyration', 0.4):
            gyration = rng.uniform(-1, 1, count) if rng.random() < 0.5 else 0.5
        calc = self.atoms.calc
        self.atoms.calc = calc.about(calc.reference, calc.load + self.load, gyration=gyration)
        self.drives, self.table = [], self.one('table', 0.2)
        self.pushed = rng.permutation(np.setdiff1d(free, [k for c in self.atoms.constraints for k in c.index]))[:3]
        if len(self.pushed) == 3 and self.one('drives', 0.4):
            a, b, c = self.pushed
            self.drives += [ToneBurst([a, b], (1, 1), 0.3 * size, 1.0), Harmonic(c, (0, 1), 0.2 * size, 1.3, 0.4),
                            Constant([a], (1, 0), 0.1 * size)]
        if len(held) and self.one('walls', 0.3):
            self.drives.append(PrescribedMotion(Harmonic(held[:2], (1, 0.3), 0.05, 1.5)))
        allowed = allowed_motion(self.atoms, dim)
        self.moved = np.einsum('ixy,iy->ix', allowed, rng.uniform(-0.05, 0.05, (count, dim)))
        moved = np.pad(self.moved, ((0, 0), (0, 3 - dim)))
        self.atoms.positions += moved
        self.atoms.set_momenta(4 * self.atoms.get_masses()[:, None] * moved, apply_constraint=False)

    def one(self, trait, share):
        """Whether the motion has a trait."""
        return self.traits.setdefault(trait, bool(self.rng.random() < share))

    @property
    def dt(self):
        return 0.02 if self.order == 2 else 0.05

    def run(self, engine, **options):
        """Displacements from rest and velocities at the end."""
        atoms = self.atoms.copy()
        atoms.calc = self.atoms.calc
        dyn = DrivenVerlet(atoms, self.dt, self.drives, self.damping, engine, self.order, **options)
        with mock.patch.object(memory_layout, 'SPREAD', 0 if self.table else memory_layout.SPREAD):
            dyn.run(STEPS)
        assert dyn.engine == engine
        if engine == 'compiled':
            self.on_grid = dyn._blocks.layout.offset is not None
            assert not (self.on_grid and self.table)
        return np.stack([dyn.displacements, dyn.velocities])

    def expected(self, **changes):
        """The same by textbook forces, of a structure whose traits may be mistaken."""
        truth, dim = replace(self.case.truth, **changes), self.case.dim
        pairs = truth.pairs
        once = [(i, cell) < (j, (0, 0, 0)) for i, j, cell in zip(pairs.i, pairs.j, map(tuple, pairs.cell), strict=True)]
        i, j = pairs.i[once], pairs.j[once]
        R = (truth.x[j] + pairs.cell[once] @ pairs.periods - truth.x[i])[:, :dim]
        static = self.load[:, :dim] - self.case.truth.pairs.forces(truth.x)

        def forces(t):
            total = static.copy()
            for drive in self.drives:
                total[drive.particles] += drive(t)[:, :dim]
            return total

        return np.stack(verlet(truth.perfect, OwnLaws(*pairs.own, i, j), self.dt, STEPS, bonds=(i, j, R), foundation=truth.k,
                               model=truth.model, damping=self.damping, drive=forces, velocities=4 * self.moved,
                               displacements=self.moved))


def misfit(states, expected):
    return max((abs(states - expected).max(axis=(1, 2)) / abs(expected).max(axis=(1, 2))).tolist())


def compare(motion, expected, engine):
    off = misfit(motion.run(engine), expected)
    allowed = EXACT * max(1.0, abs(motion.atoms.positions).max() / 50)
    assert off < allowed, f'{off:.2g}: {[name for name, there in motion.traits.items() if there]}'


def stepped_by_hand(seed, **traits):
    """A motion of the order that the oracle steps, without what it does not know."""
    return Motion(seed, order=2, gyration=False, walls=False, **traits)


@pytest.mark.parametrize('seeds', [range(12), pytest.param(range(100, 200), marks=pytest.mark.slow),
                                   pytest.param(range(1000, 3000), marks=pytest.mark.long)])
def test_ases_loop_is_velocity_verlet(seeds):
    for seed in seeds:
        motion = stepped_by_hand(seed, most=(24, 80)[seed % 2])
        compare(motion, motion.expected(), 'ase')


@pytest.mark.parametrize('seed', range(6))
def test_the_engine_computes_the_states_of_ases_loop(seed):
    walls = {'walls': True, 'free edges': False} if seed == 4 else {}
    motion = Motion(seed, **ONE_KERNEL | walls)
    assert any(isinstance(one, PrescribedMotion) for one in motion.drives) == bool(walls)
    compare(motion, motion.run('ase'), 'compiled')


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(40))
def test_and_that_with_all_traits(seed):
    motion = Motion(seed, most=80 if seed % 5 else 1500)
    compare(motion, motion.run('ase'), 'compiled')
    assert seed != 20 or (motion.on_grid and motion.traits['shuffled'])  # one that is not in order and finds its grid


@pytest.mark.long
@pytest.mark.parametrize('hundred', range(10))
def test_a_thousand_motions(hundred):
    for seed in range(100 * hundred, 100 * (hundred + 1)):
        motion = Motion(seed, most=2000 if seed % 5 == 0 else 200, shells=1 + (seed % 5 == 1))
        compare(motion, motion.run('ase'), 'compiled')


def test_every_trait_is_drawn():
    drawn = [Motion(seed, most=24).traits for seed in range(40)]
    never = {name for name in set.union(*map(set, drawn)) if not any(traits.get(name) for traits in drawn)}
    assert never == {'held elsewhere'}  # a run begins at the rest of its calculator


@pytest.mark.parametrize('change', ['model', 'springs', 'bond', 'load', 'place'])
def test_another_structure_is_noticed(change):
    """The control: it is off by far more than what is allowed, and so it is for the engines that agree with ASE's loop."""
    off = []
    for seed in range(3):
        motion = stepped_by_hand(seed, most=24, conventional=False, moved=True, relaxed=False, load=True)
        found, truth = motion.run('ase'), motion.case.truth
        if change == 'load':
            motion.load = 0 * motion.load
        free, pairs = allowed_motion(motion.atoms, motion.case.dim).any(axis=(1, 2)), truth.pairs
        lost = int(np.flatnonzero(free[pairs.i] & (pairs.i != pairs.j))[0])  # to its own image none changes its length
        other = {'model': {'model': 'conventional'}, 'springs': {'k': 1.01 * truth.k}, 'bond': {'lost': lost}, 'load': {},
                 'place': {'x': truth.perfect.positions}}[change]
        off.append(misfit(found, motion.expected(**other)))
    assert sorted(off)[change == 'load'] > 1e3 * EXACT  # one load is that of particles that are held


@pytest.mark.parametrize('change', ['damping', 'drives', 'order'])
def test_another_motion_is_noticed(change):
    """The control: it is off by far more than what is allowed."""
    motion = Motion(1, most=24, drives=True)
    expected = motion.run('ase')
    if change == 'damping':
        motion.damping = motion.damping + 1e-4
    elif change == 'drives':
        motion.drives = [*motion.drives, Constant([motion.pushed[0]], (1, 0), 1e-4)]
    else:
        motion.order, motion.damping = (4 if motion.order == 2 else 2), float(np.max(motion.damping))
    assert misfit(motion.run('ase'), expected) > 1e3 * EXACT


@pytest.mark.parametrize(('seed', 'traits'), [(0, ONE_KERNEL), (3, ONE_KERNEL), *(
    pytest.param(seed, {}, marks=pytest.mark.slow) for seed in range(20))])
def test_the_bits_are_the_same_for_any_number_of_threads(seed, traits, monkeypatch):
    monkeypatch.setattr(memory_layout, 'RUN', 16)  # so that drives and holes lie in several runs
    motion = Motion(seed, **traits, drives=True, guided=True)
    expected = motion.run('compiled')
    for threads in (2, 3, 5):
        assert np.array_equal(motion.run('compiled', threads=threads), expected)


def struck(engine, law=LAW, speed=2.5):
    atoms = lattices.parallelogram(lattices.triangular(L0, MASS), 6, 6)
    atoms.calc = MagneticRepulsion(atoms, law, foundation=0.02)
    atoms.set_momenta(np.outer(np.arange(36) == 14, [MASS * speed, 0.1, 0]))
    dyn = DrivenVerlet(atoms, 0.02, [Harmonic(15, (0, 1), 0.1, 1.3)], 0.05, engine=engine)
    seen = []
    dyn.attach(lambda: seen.append(dyn.engine), 50)
    dyn.run(200)
    return dyn.displacements, seen


@pytest.mark.slow
def test_motion_beyond_the_law_is_left_to_ases_loop_and_comes_back():
    (u, seen), (expected, _) = struck('compiled'), struck('ase')
    assert abs(u - expected).max() < 1e-10 * abs(expected).max()
    assert set(seen) == {'ase', 'compiled'}


def test_a_law_that_is_noise_is_left_to_ases_loop():
    class Rough(InversePower):
        def dphi(self, r):
            return super().dphi(r) * (1 + 1e-6 * np.sin(1e9 * np.asarray(r)))

    u, seen = struck('compiled', Rough(8900.0, 4.5), speed=0.1)
    assert seen[-1] == 'ase'
    assert np.isfinite(u).all()
