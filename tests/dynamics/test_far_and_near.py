"""A few bonds far from rest among many near it: each run of slots takes the law that reaches as far as its bonds do."""

from unittest import mock

import numpy as np
import pytest

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.dynamics import kernels_numba, memory_layout
from magphonon.dynamics.engine import PIECES, Blocks
from magphonon.interactions.pair_laws import Hertz

pytestmark = pytest.mark.slow   # each compiles kernels of its own, which takes seconds

L0, MASS, DT = 10.0, 0.7, 0.02
REPULSION, CONTACT_AT_REST = InversePower(b=8900.0, a=4.5), Hertz(1.0, 10.05)
ALIKE = 1e-11
"""Of the largest force: the law in pieces is good to 1e-12, and positions of 1e2 mm round at 1e-14."""
LAYOUTS = ['grid', 'grid', 'own laws on a grid', 'table']


@pytest.fixture(autouse=True)
def _short_runs(monkeypatch):
    monkeypatch.setattr(kernels_numba, 'RUN', 48)  # so that small patches have many
    monkeypatch.setattr(kernels_numba, 'PART', 16)  # of which few are far


class Drawn:
    """A patch of any outline, holes and model, near rest but for the neighbourhood of one particle."""

    def __init__(self, seed, law=REPULSION, far=0.3 * L0):
        self.rng, self.layout = np.random.default_rng(seed), LAYOUTS[seed % len(LAYOUTS)]
        cell = lattices.triangular(L0, MASS)
        atoms = lattices.hexagon(cell, 60.0) if self.rng.random() < 0.5 else lattices.parallelogram(cell, 12, 13)
        if self.rng.random() < 0.5:
            atoms = atoms[self.rng.random(len(atoms)) > 0.03]
        if self.layout == 'own laws on a grid':
            atoms.positions[:, :2] += 0.02 * L0 * self.rng.uniform(-1, 1, (len(atoms), 2))
        if self.layout == 'table':
            atoms = atoms[self.rng.permutation(len(atoms))]
        atoms.set_array('site', None)
        atoms.calc = MagneticRepulsion(atoms, law, foundation=0.5, cutoff=1.4 * L0,
                                       model=str(self.rng.choice(['complete', 'conventional'])))
        free = np.flatnonzero(atoms.get_tags() != lattices.RIM)
        away = np.linalg.norm(atoms.positions - atoms.positions[self.rng.choice(free)], axis=1)
        size = np.where(away < 1.5 * L0, far, 1e-3)
        self.atoms, self.u = atoms, np.zeros((len(atoms), 3))
        self.u[free, :2] = (size[:, None] * self.rng.uniform(-1, 1, (len(atoms), 2)))[free]

    def moved(self):
        moved = self.atoms.copy()
        moved.calc = self.atoms.calc
        moved.positions += self.u
        moved.set_momenta(0 * self.u)
        return moved

    def in_layout(self):
        return mock.patch.object(memory_layout, 'SPREAD', 0 if self.layout == 'table' else memory_layout.SPREAD)

    def blocks(self):
        moved = self.moved()
        with self.in_layout():
            blocks = Blocks(moved, DT, [], np.zeros(len(moved)))
        blocks._level = PIECES
        blocks.use()
        assert (blocks.layout.offset is None) == (self.layout == 'table')
        assert blocks.layout.own_laws or 'own' not in self.layout
        return moved, blocks


def accelerations(blocks):
    blocks._kernel.accelerate(blocks._state, blocks._external(np.zeros(1))[0])
    return blocks.layout.gather(blocks._state[2]).T.copy()


def laws(blocks):
    """The laws from which a run chooses, that of small motion first."""
    return [law for law in blocks._kernel._given if isinstance(law, (kernels_numba.Polynomial, kernels_numba.PiecesOfAll))]


def misfit(a, expected):
    return abs(a - expected).max() / abs(expected).max()


@pytest.mark.parametrize('seed', [*range(6), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(6, 12))])
def test_each_run_has_the_forces_of_the_law_itself(seed):
    moved, blocks = Drawn(seed).blocks()
    expected = moved.get_forces()[:, :2] / MASS
    a = accelerations(blocks)
    assert misfit(a, expected) < ALIKE
    near, *others = laws(blocks)
    for law in others:
        law.c[:] *= 1 + 1e-7
    other = (accelerations(blocks) != a).any(axis=1)
    assert other.any()
    assert not other.all()  # most runs take the law of small motion
    near.limit[:] = np.inf  # the control: the law of small motion wherever bonds are
    assert misfit(accelerations(blocks), expected) > 1e3 * ALIKE


@pytest.mark.parametrize('seed', range(4))
def test_bonds_within_half_their_reach_take_the_polynomial_between(seed):
    moved, blocks = Drawn(seed, far=0.07 * L0).blocks()  # increments up to 0.4
    a = accelerations(blocks)
    assert misfit(a, moved.get_forces()[:, :2] / MASS) < ALIKE
    _, between, pieces = laws(blocks)
    pieces.c[:] = np.nan
    assert np.array_equal(accelerations(blocks), a)
    between.limit[:] = 0.1  # the control: it reaches less far, and others are asked
    assert np.isnan(accelerations(blocks)).any()


@pytest.mark.slow
def test_a_law_with_an_edge_is_searched_for_its_halved_pieces():
    for seed in (20, 21, 23):
        moved, blocks = Drawn(seed, CONTACT_AT_REST, far=0.006 * L0).blocks()  # across the edge and back
        expected = moved.get_forces()[:, :2] / MASS
        assert misfit(accelerations(blocks), expected) < ALIKE
        child = laws(blocks)[-1].child
        assert (child >= 0).any()
        child[:] = -1  # the control: the pieces before they were halved
        assert misfit(accelerations(blocks), expected) > 1e3 * ALIKE


@pytest.mark.parametrize('seed', range(4))
def test_one_bond_beyond_all_pieces_is_noticed_among_bonds_at_rest(seed):
    drawn = Drawn(seed)
    _, blocks = drawn.blocks()
    layout, u = blocks.layout, blocks._state[0]
    b = drawn.rng.integers(len(layout.i))

    def out(times):
        """Whether one so many times as long is; the others of its particle are between, in a model of full lengths."""
        u[:] = 0.0
        u[:, layout.j[b]] = (times - 1) * layout.vectors(b)
        return blocks._kernel.accelerate(blocks._state, np.zeros((len(blocks._motion.driven), 2)))

    assert [out(times) for times in (3.1, 0.3, np.nan)] == [True] * 3
    if drawn.atoms.calc.parameters.model != 'conventional':
        assert [out(times) for times in (2.7, 0.4)] == [False] * 2
    assert not out(1.001)


@pytest.mark.parametrize('seed', range(4))
def test_the_choice_leaves_every_bit_as_it_is_for_any_threads(seed, monkeypatch):
    drawn = Drawn(seed)

    def run(threads, together, engine='compiled'):
        monkeypatch.setattr(kernels_numba, 'TOGETHER', together)
        dyn = DrivenVerlet(drawn.moved(), DT, engine=engine, threads=threads)
        with drawn.in_layout():
            dyn.run(0)
        dyn._blocks._fit(PIECES)
        dyn.run(40)
        assert dyn.engine == engine
        return dyn.displacements

    expected = run(1, 1)
    for threads, together in ((1, 3), (2, 1), (3, 2), (2, 40)):
        assert np.array_equal(run(threads, together), expected)
