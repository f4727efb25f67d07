"""Constant forces, however small: linear answers are in proportion to them, and round-off of balanced forces is none."""

import numpy as np
import pytest
from oracles import Pairs, free_basis
from structures import few_first

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices, propagate
from magphonon.dynamics import Constant
from magphonon.response import propagation
from magphonon.stiffness.rest import static_forces

pytestmark = pytest.mark.filterwarnings('ignore:the foundation of')  # drawn from what bonds push, not how stiff they are

L0, T, DT = 10.0, 3.0, 0.003  # mm, ms
FORCES = 1e-8, 1e-11, 1e-13, 1e-18  # N, on particles between which 1 N acts
SEEDS = few_first(range(6), 1)
"""Triangular, square and honeycomb in turn, at rest by themselves and balanced; each lattice has compiled code of its own."""


class Pushed:
    """A patch at rest, in a lattice or balanced on random places, some particles of which are pushed at t = 0."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        cell = getattr(lattices, ('triangular', 'square', 'honeycomb')[seed % 3])(L0, 0.7)
        self.atoms = atoms = lattices.hexagon(cell, rng.uniform(20, 28))
        atoms.set_masses(rng.uniform(0.5, 1.0, len(atoms)))
        law, k = InversePower(b=rng.uniform(2e3, 8e3), a=rng.uniform(3, 5)), rng.uniform(2, 4)
        pairs = Pairs(atoms, law, 1.2 * L0)
        self.free = np.setdiff1d(np.arange(len(atoms)), atoms.constraints[0].index)
        self.balanced = seed % 2 == 1
        if self.balanced:  # by dead loads and springs of half a newton and more
            atoms.positions[self.free, :2] += rng.uniform(-0.5, 0.5, (len(self.free), 2))
        anchors = atoms.positions + self.balanced * np.pad(rng.uniform(-0.2, 0.2, (len(atoms), 2)), ((0, 0), (0, 1)))
        bonds = [(i, j) for i, j in zip(pairs.i.tolist(), pairs.j.tolist(), strict=True) if i < j]
        atoms.calc = MagneticRepulsion(atoms, law, foundation=k, bonds=bonds, anchors=anchors).balanced(self.free)
        if not self.balanced:
            atoms.calc = MagneticRepulsion(atoms, law, foundation=k, bonds=bonds)
        B, m = free_basis(atoms, 2), np.repeat(atoms.get_masses(), 2)
        H = pairs.hessian(atoms.positions) + k * np.eye(len(m))
        S = B / np.sqrt(m)[:, None]
        squares, modes = np.linalg.eigh(S.T @ H @ S)
        assert squares[0] > 0
        self.particles = rng.choice(self.free, 2, replace=False)
        angle = rng.uniform(0, 2 * np.pi)
        self.direction = np.array([np.cos(angle), np.sin(angle)])
        push = np.zeros((len(atoms), 2))
        push[self.particles] = self.direction
        modes = S @ modes
        self.exact = (modes @ ((modes.T @ push.ravel()) * (1 - np.cos(np.sqrt(squares) * T)) / squares)).reshape(-1, 2)  # mm/N

    def drives(self, force):
        return [Constant(self.particles, self.direction, force)]

    def loaded(self, force):
        load = self.atoms.calc.load.copy()
        load[self.particles, :2] += force * self.direction
        atoms = self.atoms.copy()
        atoms.calc = self.atoms.calc.about(self.atoms, load)
        return atoms


def propagated(atoms, drives):
    return propagate(atoms, [T], drives).displacements[0]


def stepped(atoms, drives):
    atoms, calc = atoms.copy(), atoms.calc
    atoms.calc = calc
    dyn = DrivenVerlet(atoms, DT, drives, engine='compiled')
    dyn.run(round(T / DT))
    return dyn.displacements


def departure(pushed, u, force):
    return abs(u / force - pushed.exact).max() / abs(pushed.exact).max()


@pytest.mark.parametrize('seed', SEEDS)
def test_a_linear_answer_is_in_proportion_to_the_force(seed):
    pushed = Pushed(seed)
    for force in FORCES:
        assert departure(pushed, propagated(pushed.atoms, pushed.drives(force)), force) < 1e-8
        # velocity Verlet turns the phase of its fastest motion, 12 rad/ms, by 3 (12 DT)^2 12/24
        assert departure(pushed, stepped(pushed.atoms, pushed.drives(force)), force) < 3e-3
        if not pushed.balanced:  # a load that balances others has no digits left for a small one
            for answer in (propagated, stepped):
                assert departure(pushed, answer(pushed.loaded(force), []), force) < 3e-3
                assert departure(pushed, answer(pushed.loaded(force), pushed.drives(0.5 * force)), 1.5 * force) < 3e-3


@pytest.mark.parametrize('seed', SEEDS)
def test_what_balances_leaves_nothing(seed):
    pushed = Pushed(seed)
    assert not static_forces(pushed.atoms.calc)[pushed.free].any()
    assert not stepped(pushed.atoms, []).any()
    if pushed.balanced:  # also where drives balance instead of loads
        calc = pushed.atoms.calc
        drives = [Constant(k, h[:2], np.linalg.norm(h)) for k, h in enumerate(calc.load) if h.any()]
        pushed.atoms.calc = calc.about(pushed.atoms, 0 * calc.load)
        assert abs(static_forces(pushed.atoms.calc)[pushed.free]).max() > 1e-2
        assert not stepped(pushed.atoms, drives).any()
        assert not propagated(pushed.atoms, drives).any()


def test_a_rule_that_drops_small_sums_is_noticed(monkeypatch):
    # the control: what is small beside the bonds was taken for round-off
    def drops(calc, push=0.0):
        total = static_forces(calc, push)
        return np.where(abs(total) > 1e-11 * abs(calc.laws.dphi(L0)), total, 0)

    monkeypatch.setattr(propagation, 'static_forces', drops)
    pushed = Pushed(0)
    assert departure(pushed, propagated(pushed.atoms, pushed.drives(1e-8)), 1e-8) < 1e-8
    assert departure(pushed, propagated(pushed.atoms, pushed.drives(1e-13)), 1e-13) == 1
