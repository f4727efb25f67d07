"""Every engine of a run against plain velocity Verlet, on patches drawn over lattices, shapes, holes, masses, constraints.

The long part draws thousands over everything: `python -m pytest -m long tests/test_differential.py`.
"""

from dataclasses import dataclass, replace
from unittest import mock

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from oracles import neighbour_vectors, verlet
from structures import few_first

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.dynamics import Harmonic, memory_layout

pytestmark = pytest.mark.filterwarnings('ignore:the foundation of')  # stiff on purpose: strains stay small

LAW = InversePower(b=8900.0, a=4.5)
L0 = 10.0
REACHES = {'square': (1.2, 1.7, 2.1), 'triangular': (1.3, 1.9, 2.2), 'honeycomb': (1.3, 1.85, 2.1), 'kagome': (1.3, 1.85, 2.1)}
"""Between the shells of neighbours, in spacings."""
DT, STEPS = 0.1, 40  # ms; a twentieth of a period, and past the end of one block
EXACT = 1e-9
"""Of the largest displacement.  Positions of 500 mm are rounded to 1e-13 mm, 40 steps double that a few times, and the smallest
largest displacement drawn is 0.01 mm; ASE's loop under FixAtoms makes momenta of such differences."""
ENGINES = {'ase': 'ase'} | dict.fromkeys(('compiled grid', 'compiled found', 'compiled table'), 'compiled')
"""The last two are given the particles in any order and not their places on a grid; one finds these, the other must not."""


@dataclass
class Case:
    """A structure and what moves it.

    The `atoms` stand at their anchors; `shift` from there, shape (particles, dim), is the rest from which they start.
    """

    atoms: Atoms
    reach: float
    shells: int
    model: str
    foundation: float
    damping: np.ndarray
    pushed: np.ndarray
    velocities: np.ndarray
    shift: np.ndarray | float = 0.0
    load: np.ndarray | float = 0.0
    threads: int = 1

    @property
    def dim(self):
        return self.velocities.shape[1]

    def forces(self, t):
        """Of the drive, the dead load, and the foundation at rest."""
        forces = np.zeros_like(self.velocities) + self.load - self.foundation * self.shift
        forces[self.pushed, :2] += 0.02 * np.sin(0.5 * t + 0.3) * np.array([0.6, 0.8])
        return forces

    def expected(self):
        i, j, R = (np.array(x) for x in zip(*((i, j, v[: self.dim]) for i, j, _, v in neighbour_vectors(self.atoms, self.reach)
                                              if i < j), strict=True))
        shift = np.zeros_like(self.velocities) + self.shift
        return verlet(self.atoms, LAW, DT, STEPS, bonds=(i, j, R + shift[j] - shift[i]), foundation=self.foundation,
                      model=self.model, damping=self.damping, drive=self.forces, velocities=self.velocities)[0]

    def at_rest(self, order):
        """The atoms in an order, at rest, with their calculator."""
        def in_space(x):
            return np.pad(np.zeros_like(self.velocities) + x, ((0, 0), (0, 3 - self.dim)))[order]

        anchors = self.atoms[order]
        near = {'shells': self.shells} if self.shells else {'cutoff': self.reach}
        calc = MagneticRepulsion(anchors, LAW, foundation=self.foundation, model=self.model, load=in_space(self.load), **near)
        atoms = anchors.copy()
        atoms.positions += in_space(self.shift)
        atoms.calc = calc.about(atoms)
        atoms.set_momenta(atoms.get_masses()[:, None] * in_space(self.velocities))
        return atoms

    def run(self, name):
        """Displacements at the end by an engine; a shuffled patch without places on a grid goes into a table."""
        order = np.arange(len(self.atoms))
        if name in ('compiled found', 'compiled table'):
            order = np.random.default_rng(0).permutation(order)
        atoms = self.at_rest(order)
        if name in ('compiled found', 'compiled table'):
            atoms.calc.reference.set_array('site', None)
        drive = Harmonic(np.flatnonzero(np.isin(order, self.pushed)), (0.6, 0.8), 0.02, 0.5, 0.3)
        dyn = DrivenVerlet(atoms, DT, [drive], self.damping[order], ENGINES[name], threads=self.threads)
        with mock.patch.object(memory_layout, 'SPREAD', 0 if name == 'compiled table' else memory_layout.SPREAD):
            dyn.run(STEPS)
        assert dyn.engine == ENGINES[name]
        if name in ('compiled grid', 'compiled table'):
            assert (dyn._blocks.layout.offset is None) == (name == 'compiled table')
        u = np.empty_like(self.velocities)
        u[order] = dyn.displacements
        return u


def patch_of(rng, kind, most):
    """A patch of 20 to `most` particles in one of the four shapes, cut anywhere on the lattice."""
    cell = getattr(lattices, kind)(L0, 0.7)
    area = np.linalg.norm(np.cross(*cell.cell.array[:2])) / len(cell) * np.exp(rng.uniform(np.log(20), np.log(most)))
    shape, long = rng.choice(['parallelogram', 'rectangle', 'hexagon', 'half_hexagon']), np.sqrt(area * rng.uniform(0.4, 2.5))
    cell.positions[:, :2] += rng.uniform(0, L0, 2)
    try:
        if shape == 'parallelogram':
            n = np.maximum(np.round([long / cell.cell.lengths()[0], area / long / cell.cell.lengths()[1]]).astype(int), 3)
            return lattices.parallelogram(cell, *n)
        if shape == 'rectangle':
            return lattices.rectangle(cell, long, area / long)
        return getattr(lattices, shape)(cell, np.sqrt(area / (2.6 if shape == 'hexagon' else 1.3)))
    except ValueError:  # too small to have an inside
        return patch_of(rng, kind, most)


def drawn(seed, kinds=tuple(REACHES), most=2000, shells=3, models=('complete', 'conventional'), foundation=(0.5, 2.0)):
    rng = np.random.default_rng(seed)
    kind = rng.choice(kinds)
    patch = patch_of(rng, kind, most)
    if rng.random() < 0.5:
        holes = rng.random(len(patch)) < rng.uniform(0, 0.15)
        patch = patch[~holes | (np.arange(len(patch)) == len(patch) // 2)]
    if rng.random() < 0.3:
        patch.set_constraint()  # free edges
    patch.set_masses(0.7 * (rng.uniform(0.5, 2, len(patch)) if rng.random() < 0.5 else np.ones(len(patch))))
    inner = rng.permutation(np.setdiff1d(np.arange(len(patch)), patch.constraints[0].index if patch.constraints else []))
    angle = rng.uniform(0, 2 * np.pi)
    guides = FixedLine(inner[:1], (np.cos(angle), np.sin(angle), 0)), FixedPlane(inner[1:3], (0, 1, 0)), FixAtoms(inner[3:5])
    patch.set_constraint([*patch.constraints, *(c for c in guides if len(c.index) and rng.random() < 0.4)])
    count = int(rng.integers(1, shells + 1))
    return Case(patch, REACHES[kind][count - 1] * L0, count, str(rng.choice(models)), rng.uniform(*foundation),
                rng.uniform(0, 0.05, len(patch)) * (rng.random() < 0.5), inner[-3:],
                10 ** rng.uniform(-2, -0.3) * rng.uniform(-1, 1, (len(patch), 2)))


def strained(seed, **limits):
    """A drawn patch with anchors apart from rest and dead loads: relaxed, so that all bonds differ, or shifted as a whole."""
    case, rng = drawn(seed, **limits), np.random.default_rng([seed, 1])
    load = 0.05 * rng.normal(size=case.velocities.shape) * (rng.random((len(case.atoms), 1)) < 0.2)
    if rng.random() < 0.3:
        return replace(case, load=load, shift=np.zeros_like(load) + 0.03 * L0 * rng.uniform(-1, 1, 2))
    rest = relaxed(replace(case, load=load).at_rest(np.arange(len(load)))).atoms.positions
    return replace(case, load=load, shift=(rest - case.atoms.positions)[:, :2])


def scattered(seed, **limits):
    """A drawn patch with its particles up to 2 % of a spacing off their places, not at rest: each bond has its own law."""
    case, rng = drawn(seed, **limits), np.random.default_rng([seed, 4])
    atoms = case.atoms.copy()
    atoms.positions[:, :2] += 0.02 * L0 * rng.uniform(-1, 1, (len(atoms), 2))
    return replace(case, atoms=atoms, shells=0)


def chain(seed):
    """A chain in its line, held at its ends, with a hole, loads and springs that are not slack."""
    rng = np.random.default_rng([seed, 2])
    atoms = lattices.chain(L0, 0.7).repeat((int(rng.integers(12, 30)), 1, 1))
    atoms.pbc = False
    atoms.set_masses(0.7 * rng.uniform(0.5, 2, len(atoms)))
    atoms.set_constraint([FixAtoms([0, len(atoms) - 1]), FixedLine(range(1, len(atoms) - 1), (1, 0, 0))])
    hole = rng.integers(3, len(atoms) - 3)
    return _prestressed(atoms[np.arange(len(atoms)) != hole], rng, int(rng.integers(1, 3)), (1.5, 2.5), np.array([1.0, 0.0]))


def crystal(seed):
    """A simple cubic crystal, periodic, with holes, loads and springs that are not slack."""
    rng = np.random.default_rng([seed, 3])
    atoms = Atoms('Nd', cell=L0 * np.eye(3), pbc=True, masses=[0.7]).repeat((4, 3, 5))
    atoms.set_masses(0.7 * rng.uniform(0.5, 2, len(atoms)))
    atoms = atoms[np.sort(rng.permutation(len(atoms))[:54])]
    atoms.set_constraint(FixAtoms(rng.permutation(54)[:5]))
    return _prestressed(atoms, rng, 1, (1.2, 1.5), np.ones(3))


def _prestressed(atoms, rng, shells, reaches, free):
    shape = len(atoms), len(free)
    case = Case(atoms, reaches[shells - 1] * L0, shells, str(rng.choice(('complete', 'conventional'))),
                rng.uniform(0.5, 2.0), 0.05 * rng.random(shape[0]), rng.permutation(np.arange(1, shape[0] - 1))[:3],
                10 ** rng.uniform(-2, -0.3) * rng.uniform(-1, 1, shape))
    return replace(case, load=0.05 * rng.normal(size=shape), shift=0.02 * L0 * rng.normal(size=shape) * free)


def misfit(u, expected):
    return abs(u - expected).max() / abs(expected).max()


def compare(seeds, engines, draw=drawn, **limits):
    for seed in seeds:
        case = draw(seed, **limits)
        expected = case.expected()
        for name in engines:
            off = misfit(case.run(name), expected)
            assert off < EXACT, f'{draw.__name__}({seed}, **{limits}): {name} is off by {off:.2g} of the largest displacement'


@pytest.mark.parametrize('part', few_first(range(8), 1))
def test_ases_loop_is_velocity_verlet_on_any_patch(part):
    compare(range(part, 40, 8), ['ase'], most=300)


# numba compiles anew for every number of bond groups and of coefficients: a few seconds each.  These draws need few of them:
# lattices of three groups, and a foundation that keeps strains below 1/64.
SIMILAR = {'kinds': ('triangular', 'honeycomb'), 'shells': 1, 'models': ('complete',), 'foundation': (20.0, 30.0)}


@pytest.mark.slow
def test_compiled_blocks_are_velocity_verlet_on_patches_whose_particles_are_off_their_places():
    for name in ('compiled grid', 'compiled found', 'compiled table'):
        compare(range(500, 515), [name], scattered, most=700, **SIMILAR | {'kinds': ('triangular',)})


@pytest.mark.parametrize('change', [{'model': 'conventional'}, {'foundation': 1.01}, {'reach': 1.9 * L0}])
def test_another_model_foundation_or_bond_list_is_noticed(change):
    # the control: the oracle about another structure is off by more than the tolerance, for every patch
    for seed in range(3):
        case = drawn(seed, kinds=('triangular',), shells=1, models=('complete',), most=100)
        other = replace(case, **change)
        assert misfit(case.run('ase'), other.expected()) > 1e3 * EXACT


# --- prestressed: loads, and anchors that are not where particles rest ----------------------------------------------------


def test_relaxed_and_loaded_patches_move_as_they_should():
    compare(range(400, 405), ['ase'], strained, most=120)


def test_chains_and_crystals_move_as_they_should():
    compare(range(3), ['ase'], chain)
    compare(range(2), ['ase'], crystal)


@pytest.mark.parametrize('change', [{'load': 0.0}, {'shift': 0.0}])
@pytest.mark.parametrize('draw', [strained, chain, crystal])
def test_what_is_not_loaded_or_stands_at_its_anchors_is_noticed(draw, change):
    case = draw(1, most=60) if draw is strained else draw(1)
    assert misfit(case.run('ase'), replace(case, **change).expected()) > 1e3 * EXACT


@pytest.mark.long
@pytest.mark.parametrize('twenty', range(10))
def test_two_hundred_prestressed_structures(twenty):
    seeds = range(20 * twenty, 20 * (twenty + 1))
    compare(seeds, ['ase'], strained, most=500)
    compare(seeds, ['ase'], chain)
    compare(seeds, ['ase'], crystal)


@pytest.mark.long
@pytest.mark.parametrize('hundred', range(20))
def test_all_engines_are_velocity_verlet_on_two_thousand_patches(hundred):
    compare(range(100 * hundred, 100 * (hundred + 1)), ENGINES)
    compare(range(100 * hundred, 100 * hundred + 20), [name for name in ENGINES if 'compiled' in name], scattered, shells=1)
