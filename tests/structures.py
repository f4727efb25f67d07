"""Structures drawn over all that the package allows, each made of one number, and what is true of them by dense algebra."""

from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import product

import numpy as np
import pytest
from ase import Atoms
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from oracles import Pairs, free_basis, lattice

from magphonon import InversePower, MagneticRepulsion, lattices, relaxed
from magphonon.interactions import Yukawa

L0 = 10.0
REACHES = {
    'chain': (1.5, 2.5, 3.5), 'square': (1.2, 1.7, 2.1), 'triangular': (1.3, 1.9, 2.2), 'honeycomb': (1.3, 1.85, 2.1),
    'kagome': (1.3, 1.85, 2.1), 'fcc': (1.2, 1.55, 1.85), 'bcc': (1.07, 1.3, 1.8),
}
"""Between the shells of neighbours, in spacings."""
LAWS = [InversePower(b=0.2 * L0**a, a=a) for a in (2.0, 4.5824, 9.0)] + [Yukawa(c=20.0, kappa=0.3)]
"""About 0.2 N at the spacing, so that D* is of the order of 0.02 N/mm."""
PATCHES = ['parallelogram', 'rectangle', 'hexagon', 'half_hexagon']


def few_first(cases, few):
    """Values for `parametrize`, tuples for several names: the first few in the fast tests, the others in the slow ones."""
    cases = list(cases)
    slow = (pytest.param(*(case if isinstance(case, tuple) else (case,)), marks=pytest.mark.slow) for case in cases[few:])
    return [*cases[:few], *slow]


@dataclass(frozen=True)
class Truth:
    """A structure as the oracle sees it: where its particles belong, where they are, what they weigh and what holds them."""

    perfect: Atoms
    x: np.ndarray
    reach: float
    model: str
    masses: np.ndarray
    k: np.ndarray
    own: tuple
    lost: int | None = None

    @property
    def displaced(self):
        """How far particles are from where they belong, mm."""
        return abs(self.x - self.perfect.positions).max()

    def pairs_of(self, perfect):
        laws, *sites = self.own
        own = laws, *(np.tile(values, len(perfect) // len(self.x)) for values in sites)
        pairs = Pairs(perfect, None, self.reach, self.model, own, dim=self.k.shape[1])
        return pairs if self.lost is None else pairs.without(self.lost % len(pairs.i))

    @cached_property
    def pairs(self):
        return self.pairs_of(self.perfect)

    @cached_property
    def scale(self):
        """Stiffness of the stiffest bond, N/mm."""
        return self.pairs.stiffest(self.x)

    def fastest(self, squares):
        """Highest angular frequency or rate, rad/ms; that of one bond where round-off is all there is."""
        return np.sqrt(max(abs(squares).max(), self.scale / self.masses.max()))

    @cached_property
    def stiffness(self):
        """Dense matrix of the structure, N/mm."""
        return self.pairs.hessian(self.x) + np.diag(self.k.ravel())

    @property
    def common(self):
        """The softest spring of any particle that is not held, N/mm."""
        return np.delete(self.k, held_by(self.perfect), axis=0).min()

    def waves(self, q):
        """Stiffness for the wavevectors q, shape (waves, rows, rows)."""
        return self.pairs.bloch(self.x, q) + np.diag(self.k.ravel())

    def repeated(self, repeat):
        """Dense matrix of several cells with periodic borders, and the masses of its rows."""
        cells = self.perfect.repeat(repeat)
        count = len(cells) // len(self.x)
        H = self.pairs_of(cells).hessian(cells.positions + np.tile(self.x - self.perfect.positions, (count, 1)))
        return H + np.diag(np.tile(self.k.ravel(), count)), np.tile(self.rows, count)

    @property
    def rows(self):
        """The mass that belongs to each row of the matrix."""
        return np.repeat(self.masses, self.pairs.dim)


@dataclass(frozen=True)
class Case:
    """A structure, what is true of it, and the number that it and all that is asked about it were drawn from."""

    atoms: Atoms
    truth: Truth
    seed: int
    traits: dict = field(default_factory=dict)

    @property
    def dim(self):
        return self.atoms.calc.dim

    @property
    def rng(self):
        """The same draws each time: a wrong truth is asked the same."""
        return np.random.default_rng([self.seed, 1])

    def on_foundation(self, k):
        """The same structure at the same rest on springs the softest of which has the stiffness k, the others so much more."""
        atoms = self.atoms.copy()
        springs = np.maximum(self.truth.k - self.truth.common + k, 0)  # a softer one may be that of a particle that is held
        atoms.calc = self.atoms.calc.about(self.atoms, foundation=springs).balanced(np.arange(len(atoms)))
        return replace(self, atoms=atoms)

    def reduced(self, truth):
        """Stiffness within what the constraints leave free, its masses, and the basis."""
        B = free_basis(truth.perfect, self.dim)
        return B.T @ truth.stiffness @ B, B.T @ (truth.rows[:, None] * B), B


def weighted(H, m):
    return H / np.sqrt(m * m[:, None])


class Chance:
    """Whether a structure has a trait: as prescribed, else by chance."""

    def __init__(self, rng, prescribed):
        self.rng, self.traits = rng, dict(prescribed)

    def __call__(self, trait, share):
        return self.traits.setdefault(trait, bool(self.rng.random() < share))


def cell_and_reach(rng, cells, most_shells):
    """One cell, and a reach between two shells with their number, if it has a name."""
    name = str(rng.choice(cells))
    if name != 'oblique':
        shells = int(rng.integers(1, most_shells + 1))
        return name, lattice(name, L0), REACHES[name][shells - 1] * L0, shells
    angle, side = np.deg2rad(rng.uniform(62, 88)), rng.uniform(0.85, 1.3)
    vectors = L0 * np.array([[1, 0, 0], [side * np.cos(angle), side * np.sin(angle), 0], [0, 0, 2]])
    cell = Atoms('Nd', cell=vectors[[1, 0, 2] if angle > 1.3 else [0, 1, 2]], pbc=(1, 1, 0))  # some are left-handed
    images = np.array(list(product(range(-4, 5), repeat=2))) @ cell.cell.array[:2]
    distances = np.sort(np.linalg.norm(images, axis=1))
    if ((distances > 1.0001 * distances[1]) & (distances < 1.02 * distances[1])).any():  # patches need a clear first shell
        return cell_and_reach(rng, ['oblique'], most_shells)
    distances = distances[(distances > L0 * max(1, side) * 1.001) & (distances < 2.4 * L0)]
    widest = np.diff(distances).argmax()
    return name, cell, distances[widest : widest + 2].mean(), None


def places(rng, has, name, cell, most):
    """Places of particles: cells of a lattice or of a strip with held walls, or a patch, whose edge is held or free."""
    planar = not cell.pbc.all()
    if not planar or has('periodic', 0.5):
        if planar and name != 'chain' and has('strip', 0.2):
            return lattices.ribbon(cell, max(3, int(rng.integers(4, 7)) // len(cell)))
        return supercell(rng, cell, most)
    atoms = patch(rng, name, cell, most)
    if has('free edges', 0.5):
        atoms.set_constraint()
    return atoms


def supercell(rng, cell, most):
    least = 1 + (most > 24)  # at one cell each bond may join a particle to its own image
    counts = np.where(cell.pbc, rng.integers(least, max(4, int(most ** (1 / cell.pbc.sum()))), 3), 1)
    while np.prod(counts) * len(cell) > most:
        counts[counts.argmax()] -= 1
    return cell.repeat(counts)


def patch(rng, name, cell, most):
    """A line, or a shape of roughly `most` particles."""
    if name == 'chain':
        atoms = cell.repeat((int(rng.integers(4, max(most, 4) + 1)), 1, 1))
        atoms.pbc = False
        return atoms
    side, shape = np.sqrt(most * abs(np.linalg.det(cell.cell.array[:2, :2])) / len(cell)), str(rng.choice(PATCHES))
    if shape == 'parallelogram':
        return lattices.parallelogram(cell, *np.maximum(np.round(side / cell.cell.lengths()[:2]).astype(int), 4))
    if shape == 'rectangle':
        long = side * rng.uniform(0.9, 1.2)
        return lattices.rectangle(cell, max(long, 4 * L0), max(side**2 / long, 4 * L0))
    return getattr(lattices, shape)(cell, max(side / (1.6 if shape == 'hexagon' else 1.1), 3.2 * L0))


def held_by(atoms):
    held = [constraint.index for constraint in atoms.constraints if isinstance(constraint, FixAtoms)]
    return np.concatenate([np.array([], int), *held])


def unlike_sites(rng, has, n, dim, laws):
    """Laws of pairs of kinds or one law, kinds, strengths, and factors of the springs of each site."""
    share = 0.7 * has('unlike', 0.5)
    law, kinds, strengths, factors = laws[rng.integers(len(laws))], np.zeros(n, int), np.ones(n), np.ones((n, dim))
    if has('kinds', share):
        law, kinds = dict(zip([(0, 0), (1, 0), (1, 1)], rng.permutation(laws).tolist(), strict=False)), rng.integers(0, 2, n)
    if has('strengths', share):
        strengths = rng.uniform(0.8, 1.2, n)
        if has('attraction', 0.3):
            strengths[1::4] *= -1
    if has('springs', share):
        factors = factors * rng.uniform(0.5, 1.5, [(n, dim), (n, 1), (1, dim)][rng.integers(3)])
    return law, kinds, strengths, factors


def with_holes(rng, perfect):
    """Whether one or two inner particles, or more of many, could be taken out."""
    inner = rng.permutation(np.setdiff1d(np.arange(len(perfect)), held_by(perfect)))
    if len(inner) < 5:
        return False
    del perfect[inner[: rng.integers(1, 3 + len(perfect) // 40)].tolist()]
    return True


def guides(rng, perfect, dim):
    """Some of: a particle that is held, one on an oblique line, two on planes."""
    free = rng.permutation(np.setdiff1d(np.arange(len(perfect)), held_by(perfect)))
    if len(free) < 5:
        return []
    line, plane = (np.pad(rng.normal(size=dim), (0, 3 - dim)) for _ in range(2))
    chosen = FixAtoms(free[:1]), FixedLine(free[1:2], line), FixedPlane(free[2:4], plane)
    return [guide for guide in chosen if rng.random() < 0.5]


def structure(seed, most=24, cells=(*REACHES, 'oblique'), shells=3, laws=LAWS, foundation=(0.0, 0.03, 0.3), **traits):
    """A structure at rest with its calculator, and the truth about it.

    Of roughly `most` particles, on one of the lattices `cells`, bonded within up to `shells` shells by one of the `laws`, on a
    `foundation` of one of these springs (N/mm); each of the `traits` is there (True) or not (False), the others as chance has it.
    """
    rng = np.random.default_rng(seed)
    has = Chance(rng, traits)
    name, cell, reach, shell = cell_and_reach(rng, cells, shells)
    perfect = places(rng, has, name, cell, most)
    holes = has('holes', 0.5) and with_holes(rng, perfect)
    if has('shuffled', 0.2):
        perfect = perfect[rng.permutation(len(perfect))]
        perfect.set_array('site', None)
    n, dim = len(perfect), 3 if perfect.pbc.all() or has('layer', 0.15) else 2
    masses = rng.uniform(0.5, 1.5, n) if has('masses', 0.5) else np.full(n, 0.7)
    perfect.set_masses(masses)
    if has('guided', 0.9):
        perfect.set_constraint([*perfect.constraints, *guides(rng, perfect, dim)])

    law, kinds, strengths, factors = unlike_sites(rng, has, n, dim, laws)
    if isinstance(law, dict):
        perfect.set_tags(kinds)
    relaxes = strengths.min() > 0 and has('relaxed', 0.2)  # what attracts may fall onto its neighbour
    k = (0.6 if relaxes else float(rng.choice(foundation))) * factors
    if dim == 3 and not perfect.pbc.all():
        k[:, 2] = max(2.0, k.max()) if relaxes or min(foundation) else rng.uniform(0.1, 2.0)  # it keeps its plane, or does not
    scatter, moved = np.zeros((2, n, 3))
    if has('anchors', 0.4):
        scatter[:, :dim] = 0.4 * rng.uniform(-1, 1, (n, dim))
    if has('moved', 0.8):
        moved[:, :dim] = rng.choice([0.01, 0.6]) * rng.uniform(-1, 1, (n, dim))
    named = shell and not holes and has('named shells', 0.5)  # a hole may empty a shell
    calc = MagneticRepulsion(perfect, law, foundation=k, strengths=strengths, anchors=perfect.positions + scatter,
                             model='conventional' if has('conventional', 0.3) else 'complete',
                             **({'shells': shell} if named else {'cutoff': reach}))
    atoms = perfect.copy()
    if relaxes:
        atoms.calc = calc
        atoms = relaxed(atoms).atoms
    else:
        atoms.positions += moved
        atoms.calc = calc.about(atoms).balanced(np.arange(n))
        if has('held elsewhere', 0.2):
            atoms.calc = atoms.calc.about(perfect)
    x = atoms.get_positions()
    if has('in another image', 0.5):
        atoms.positions += np.where(perfect.pbc, rng.integers(-1, 2, (n, 3)), 0) @ perfect.cell.array
    laws = {frozenset(pair): one for pair, one in (law if isinstance(law, dict) else {(0, 0): law}).items()}
    return Case(atoms, Truth(perfect, x, reach, calc.model, masses, k, (laws, kinds, strengths)), seed, has.traits)
