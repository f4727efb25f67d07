"""The compiled engine against ASE's own loop, on structures drawn over all traits that it takes, and what it leaves to it."""

from dataclasses import dataclass, field

import numpy as np
import pytest
from ase.build import bulk
from ase.constraints import FixAtoms, FixedLine, FixedPlane

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.dynamics import Constant, Harmonic, PrescribedMotion, ToneBurst, memory_layout
from magphonon.interactions import Yukawa

L0, MASS, STEPS = 10.0, 0.7, 70  # mm, g; three blocks, the last one cut short
LAW, OTHER = InversePower(b=8900.0, a=4.5), Yukawa(300.0, 0.2)
EXACT = 2e-10
"""Of the largest displacement or velocity: ASE's loop rounds positions of 50 mm at 1e-14 mm, and under constraints makes
velocities of their differences, by a step of 0.02 ms; both add up over 70 steps of motion by 0.05 mm."""
ONE_KERNEL = dict.fromkeys(('in space', 'damping of each', 'another lattice', 'periodic', 'holes', 'scattered', 'springs of each',
                            'conventional', 'strengths', 'load', 'gyration', 'two laws', 'another law'), False)
"""Without these traits all structures run through the same compiled code, so that fast tests compile once."""

pytestmark = pytest.mark.filterwarnings('ignore:the foundation of')  # stiff on purpose: strains stay small


@dataclass
class Drawn:
    """A structure and its motion; each trait is there or not."""

    seed: int
    traits: dict = field(default_factory=dict)

    def __post_init__(self):
        rng = self.rng = np.random.default_rng(self.seed)
        self.order = int(rng.choice([2, 2, 4, 6]))
        self.atoms = self.space() if self.one('in space', 0.15) else self.plane()
        count, dim = len(self.atoms), self.atoms.calc.dim
        self.free = np.setdiff1d(np.arange(count), self.held())
        self.damping = rng.choice([0.0, 0.1])
        if self.order == 2 and self.one('damping of each', 0.3):
            self.damping = rng.uniform(0, 0.2, count)
        self.drives = []
        a, b, c, *some = rng.choice(self.free, 9, replace=False)
        if self.one('drives', 0.4):
            self.drives += [ToneBurst([a, b], (1, 1), 0.3, 1.0), Harmonic(c, (0, 1), 0.2, 1.3, 0.4), Constant([a], (1, 0), 0.1)]
        if len(self.held()) and self.one('walls', 0.3):
            self.drives.append(PrescribedMotion(Harmonic(self.held()[:2], (1, 0.3), 0.05, 1.5)))
        if self.one('guided', 0.4):
            line, plane = (0.6, 0.8, 0), (1, 0, 0)
            self.atoms.set_constraint([*self.atoms.constraints, FixedLine(some[:1], line), FixedPlane(some[1:3], plane)])
        moved = np.zeros((count, 3))
        moved[self.free, :dim] = rng.uniform(-0.05, 0.05, (len(self.free), dim))
        for constraint in self.atoms.constraints:
            constraint.adjust_momenta(self.atoms, moved)
        self.atoms.positions += moved
        self.atoms.set_momenta(MASS * 4 * moved)

    def one(self, trait, share):
        """Whether the structure has a trait."""
        return self.traits.setdefault(trait, bool(self.rng.random() < share))

    def held(self):
        return np.concatenate([np.zeros(0, int), *(c.index for c in self.atoms.constraints if isinstance(c, FixAtoms))])

    def plane(self):
        rng = self.rng
        name = str(rng.choice(['square', 'honeycomb'])) if self.one('another lattice', 0.5) else 'triangular'
        cell = getattr(lattices, name)(L0, MASS)
        atoms = lattices.hexagon(cell, 45.0) if rng.random() < 0.5 else lattices.parallelogram(cell, 9, 8)
        if self.one('periodic', 0.15):
            atoms = cell.repeat((5, 4, 1) if rng.random() < 0.5 else (1, 12, 1))  # bonded to images of themselves
        if self.one('holes', 0.3):
            atoms = atoms[np.sort(rng.permutation(len(atoms))[: round(0.95 * len(atoms))])]
        if self.one('scattered', 0.3):
            atoms.positions[:, :2] += 0.03 * L0 * rng.uniform(-1, 1, (len(atoms), 2))
        if self.one('shuffled', 0.3):
            atoms = atoms[rng.permutation(len(atoms))]
            atoms.set_array('site', None)
        if self.one('free edges', 0.2):
            atoms.set_constraint()
        count = len(atoms)
        options = {'foundation': rng.uniform(20, 30, (count, 2)) if self.one('springs of each', 0.3) else 25.0}
        options['model'] = 'conventional' if self.one('conventional', 0.25) else 'complete'
        if self.one('strengths', 0.2):
            options['strengths'] = rng.uniform(0.9, 1.1, count)
        if self.one('load', 0.3):
            loaded = rng.random((count, 1)) < rng.choice([0.05, 1.0])
            options['load'] = np.pad(0.3 * loaded * rng.normal(size=(count, 2)), ((0, 0), (0, 1)))
        if self.order == 2 and self.one('gyration', 0.25):
            options['gyration'] = rng.uniform(-1, 1, count) if rng.random() < 0.5 else 0.5
        if self.one('two laws', 0.2):
            atoms.set_tags(rng.integers(0, 2, count))
            laws = {(0, 0): LAW, (0, 1): LAW, (1, 1): OTHER}
        else:
            laws = OTHER if self.one('another law', 0.2) else LAW
        atoms.calc = MagneticRepulsion(atoms, laws, cutoff=1.25 * L0, **options)
        return atoms

    def space(self):
        rng = self.rng
        atoms = bulk('Cu', 'fcc', a=L0 * 2**0.5, cubic=True).repeat((3, 2, 3))
        atoms.set_masses(MASS * rng.uniform(0.5, 2, len(atoms)))
        atoms.set_constraint(FixAtoms(rng.permutation(len(atoms))[:3]))
        atoms.calc = MagneticRepulsion(atoms, LAW, foundation=25.0)
        return atoms

    def run(self, engine, **options):
        atoms = self.atoms.copy()
        atoms.calc = self.atoms.calc
        dyn = DrivenVerlet(atoms, 0.02 if self.order == 2 else 0.05, self.drives, self.damping, engine, self.order, **options)
        dyn.run(STEPS)
        assert dyn.engine == engine
        return np.stack([dyn.displacements, dyn.velocities])


def misfit(states, expected):
    return max((abs(states - expected).max(axis=(1, 2)) / abs(expected).max(axis=(1, 2))).tolist())


def compare(drawn):
    off = misfit(drawn.run('compiled'), drawn.run('ase'))
    assert off < EXACT, f'{off:.2g}: {[name for name, there in drawn.traits.items() if there]}'


@pytest.mark.parametrize('seed', range(6))
def test_the_engine_computes_the_states_of_ases_loop(seed):
    compare(Drawn(seed, ONE_KERNEL.copy()))


@pytest.mark.slow
@pytest.mark.parametrize('seed', range(40))
def test_and_that_with_all_traits(seed):
    compare(Drawn(seed))


def test_every_trait_is_drawn():
    there = [{name for name, has in Drawn(seed).traits.items() if has} for seed in range(40)]
    assert set.union(*there) == {name for seed in range(40) for name in Drawn(seed).traits}


@pytest.mark.parametrize('change', ['damping', 'drives', 'order'])
def test_another_motion_is_noticed(change):
    """The control: it is off by far more than what is allowed."""
    drawn = Drawn(1)
    expected = drawn.run('ase')
    if change == 'damping':
        drawn.damping = drawn.damping + 1e-4
    elif change == 'drives':
        drawn.drives = [*drawn.drives, Constant([drawn.free[0]], (1, 0), 1e-4)]
    else:
        drawn.order, drawn.damping = (4 if drawn.order == 2 else 2), float(np.max(drawn.damping))
    assert misfit(drawn.run('ase'), expected) > 1e3 * EXACT


@pytest.mark.parametrize(('seed', 'traits'), [(0, ONE_KERNEL), (3, ONE_KERNEL), *(
    pytest.param(seed, {}, marks=pytest.mark.slow) for seed in range(20))])
def test_the_bits_are_the_same_for_any_number_of_threads(seed, traits, monkeypatch):
    monkeypatch.setattr(memory_layout, 'RUN', 16)  # so that drives and holes lie in several runs
    drawn = Drawn(seed, traits | {'drives': True, 'guided': True})
    expected = drawn.run('compiled')
    for threads in (2, 3, 5):
        assert np.array_equal(drawn.run('compiled', threads=threads), expected)


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
