"""Every question of every structure: walls and guides, sites of their own, layers, and all of it at once.

A structure is drawn from a kind and a seed; each of its answers is compared with the energies of single pairs, found by brute
force and derived by Cauchy's formula.  The controls are oracles that mistake its sites for each other: other particles are held,
other directions guided, other kinds, strengths and springs.

More of them: `python -m pytest -n 0 -m long tests/test_structures_and_questions.py` (some minutes).
"""

from types import SimpleNamespace

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine, FixedPlane
from oracles import OwnLaws, Pairs, free_basis, lattice, neighbour_vectors, verlet

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.bands import group_velocities
from magphonon.bands.bloch import bloch_modes
from magphonon.interactions import Yukawa

LAWS = {(0, 0): InversePower(b=6200.0, a=4.5824), (1, 0): InversePower(b=25.0, a=2.0), (1, 1): Yukawa(c=20.0, kappa=0.3)}
"""About 0.2 N at 10 mm each, and of different slope."""
REACHES = 12.0, 18.5  # one shell and two of all these lattices, scatter included
DT, STEPS = 0.02, 30


class Drawn:
    """A structure of a kind, made of a seed, at rest under dead loads; what is special about it can be mistaken."""

    def __init__(self, kind, seed):
        rng = self.rng = np.random.default_rng([seed, *map(ord, kind)])
        strip, layer, own = kind in ('walls', 'everything'), kind == 'layer', kind in ('sites', 'everything')
        name = ('triangular', 'square', 'honeycomb', 'kagome', 'chain', 'fcc')[seed % (4 if strip else 5 if layer else 6)]
        cell = lattice(name)
        if strip:
            atoms = lattices.ribbon(cell, 3 if name in ('honeycomb', 'kagome') else int(rng.integers(4, 7)))
            held = np.union1d(atoms.constraints[0].index, rng.choice(len(atoms), 1))[rng.integers(2) :]
        else:
            atoms = cell.repeat(np.where(cell.pbc, 3 if name == 'chain' else [2, 1, 1], 1))
            atoms.pbc &= bool(rng.random() < 0.7) or name == 'fcc'
            held = np.arange(rng.integers(2)) if len(atoms) > 2 else []
        n, self.dim = len(atoms), 3 if layer or name == 'fcc' else 2
        planar = 3 if name == 'fcc' else 2
        atoms.positions[:, :planar] += (0.0 if strip and not own else 0.3) * rng.uniform(-1, 1, (n, planar))
        atoms.set_masses(rng.uniform(0.5, 1.5, n))
        free = rng.permutation(np.setdiff1d(np.arange(n), held))
        constraints = [FixAtoms(held)] if len(held) else []
        if strip and len(free) > 2:
            constraints += [FixedLine(free[:1], (*rng.normal(size=2), 0)), FixedPlane(free[1:2], (*rng.normal(size=2), 0))]
        atoms.set_constraint(constraints)
        self.guided, self.own = len(constraints) > 1, own
        atoms.set_tags(rng.integers(0, 2, n) if own else 0)
        self.strengths = rng.uniform(0.7, 1.3, n) * np.where(np.arange(n) % 4 == 2, -1, 1) if own else np.ones(n)  # some attract
        self.springs = rng.uniform(0.2, 0.6, [(n, self.dim), (n, 1), (1, self.dim)][rng.integers(3)]) if own or layer else 0.3
        if layer:
            self.springs = np.column_stack([self.springs[:, :1], self.springs[:, :1], 2 + rng.uniform(0, 1, len(self.springs))])
        self.name = f'{kind} {seed}'
        self.model, self.reach = str(rng.choice(['complete', 'conventional'])), REACHES[rng.integers(2)]
        calc = MagneticRepulsion(atoms, LAWS if own else LAWS[0, 0], foundation=self.springs, strengths=self.strengths,
                                 model=self.model, cutoff=self.reach)
        atoms.calc = calc.balanced(range(n))
        self.atoms = atoms

    def mistaken(self):
        """Name -> a copy whose sites are mistaken for each other, of what differs between them."""
        atoms, n = self.atoms, len(self.atoms)
        for constraint in atoms.constraints:
            others = [c for c in atoms.constraints if c is not constraint]
            if isinstance(constraint, FixAtoms):
                other = FixAtoms((constraint.index + 1) % n)
            else:
                other = type(constraint)(constraint.index, np.cross(constraint.dir, (0, 0, 1)))
            yield type(other).__name__, self._copy(lambda atoms, all=(*others, other): atoms.set_constraint(all))
        if self.own:
            yield 'kinds', self._copy(lambda atoms: atoms.set_tags(1 - atoms.get_tags()))
            yield 'strengths', self._copy(strengths=self.strengths[::-1])
        if np.ptp(self.k):
            yield 'springs', self._copy(springs=self.k[::-1, ::-1])

    def _copy(self, change=lambda atoms: None, **changes):
        other = object.__new__(Drawn)
        other.__dict__.update(self.__dict__, atoms=self.atoms.copy(), **changes)
        change(other.atoms)
        return other

    # what the oracle says

    def pairs(self, model=None):
        own = {frozenset(pair): law for pair, law in LAWS.items()}, self.atoms.get_tags(), self.strengths
        return Pairs(self.atoms, None, self.reach, model or self.model, own, dim=self.dim)

    @property
    def x(self):
        return self.atoms.positions

    @property
    def k(self):
        return np.broadcast_to(self.springs, (len(self.atoms), self.dim))

    def pull(self, x, u):
        """Forces of bonds, springs and dead loads on all particles."""
        pairs = self.pairs('complete')
        return pairs.forces(x) - pairs.forces(self.x) - self.k * u

    def weighted(self, q, model=None):
        """The stiffness for a wave over the masses, and an orthonormal basis of what is free."""
        root = np.sqrt(np.repeat(self.atoms.get_masses(), self.dim))
        D = (self.pairs(model).bloch(self.x, q) + np.diag(self.k.ravel())) / np.outer(root, root)
        return D, free_basis(self.atoms, self.dim)  # a guided particle has one mass along all directions

    def squares(self, q, model=None):
        """Squared frequencies at a wavevector."""
        D, P = self.weighted(q, model)
        return np.linalg.eigvalsh(P.T @ D @ P)


def moved(drawn, model='complete'):
    """The structure away from its rest, and its displacements."""
    u = np.random.default_rng(7).uniform(-0.3, 0.3, (len(drawn.atoms), drawn.dim))
    atoms = drawn.atoms.copy()
    atoms.calc = drawn.atoms.calc.about(drawn.atoms.calc.reference, model=model)
    atoms.positions += np.pad(u, ((0, 0), (0, 3 - drawn.dim)))
    return atoms, u


def waves(drawn):
    return np.random.default_rng(8).uniform(-1, 1, (3, 3)) * drawn.atoms.pbc


# each question: what the package answers and what the oracle does; `oracle` may mistake sites

def energy(drawn, oracle):
    (atoms, u), pairs = moved(drawn), oracle.pairs('complete')
    r, r0 = (np.linalg.norm(x[pairs.j] + pairs.cell @ pairs.periods - x[pairs.i], axis=1) for x in (atoms.positions, oracle.x))
    spent = (pairs.law.phi(r) - pairs.law.phi(r0)).sum() / 2 + (oracle.k * u**2).sum() / 2 + (pairs.forces(oracle.x) * u).sum()
    return np.array([atoms.get_potential_energy(), atoms.get_potential_energies().sum()]), np.array([spent, spent])


def forces(drawn, oracle):
    atoms, u = moved(drawn)
    P = free_basis(oracle.atoms, drawn.dim)
    return atoms.get_forces()[:, : drawn.dim].ravel(), P @ (P.T @ oracle.pull(atoms.positions, u).ravel())


def stiffness(drawn, oracle):
    """Every entry, within what each takes for free."""
    atoms, _ = moved(drawn)
    P, own = (basis @ basis.T for basis in (free_basis(oracle.atoms, drawn.dim), free_basis(drawn.atoms, drawn.dim)))
    keep = np.flatnonzero(np.tile(np.arange(3) < drawn.dim, len(atoms)))
    H = atoms.calc.get_hessian(atoms).toarray()[np.ix_(keep, keep)]
    exact = oracle.pairs('complete').hessian(atoms.positions) + np.diag(oracle.k.ravel())
    return own @ H @ own, P @ exact @ P


def bands(drawn, oracle):
    q = waves(drawn)
    omega = bloch_modes(drawn.atoms, q, drawn.model)[0]
    return omega * abs(omega), np.array([oracle.squares(one) for one in q])


def shapes(drawn, oracle):
    """Energies of the modes, whose parts in directions that are not free count for nothing."""
    q = waves(drawn)[0]
    omega, found = bloch_modes(drawn.atoms, q[None], 'complete', vectors=True)
    D, P = oracle.weighted(q, 'complete')
    v = found[0].reshape(len(omega[0]), -1) @ P
    return np.einsum('ma,ab,mb->m', v.conj(), P.T @ D @ P, v).real, np.linalg.eigvalsh(P.T @ D @ P)


def velocities(drawn, oracle, h=1e-5):
    """Along the first reciprocal vector; those of slow waves have an error without bound."""
    q, (b, *_) = waves(drawn)[:1], drawn.atoms.cell.reciprocal().array * 2 * np.pi
    omega, velocity = group_velocities(drawn.atoms, q, 'complete')
    up, down = (np.sqrt(oracle.squares(q[0] + sign * np.array([h, 0, 0]), 'complete').astype(complex)).real for sign in (1, -1))
    known, exact = velocity[0] @ b[: velocity.shape[-1]], (up - down) / (2 * h)
    return known[omega[0] > 0.3 * omega.max()], exact[up > 0.3 * up.max()]


def steps(drawn, oracle):
    atoms, u = moved(drawn, drawn.model)
    free = free_basis(drawn.atoms, drawn.dim)
    u = (free @ (free.T @ u.ravel())).reshape(u.shape)
    atoms.positions[:, : drawn.dim] = drawn.x[:, : drawn.dim] + u
    dyn = DrivenVerlet(atoms, DT, engine='ase')
    dyn.run(STEPS)
    found = [pair for pair in neighbour_vectors(drawn.atoms, drawn.reach) if (pair[0], pair[2]) < (pair[1], (0, 0, 0))]
    i, j, _, R = (np.array(part) for part in zip(*found, strict=True))
    pairs = oracle.pairs()
    strengths, laws = zip(*OwnLaws(*pairs.own, i, j).each, strict=True)
    slopes = SimpleNamespace(dphi=lambda r: sum(np.where([own is one for own in laws], strengths * one.dphi(r), 0.0)
                                                for one in set(laws)))
    static = pairs.forces(oracle.x)
    return dyn.displacements, verlet(oracle.atoms, slopes, DT, STEPS, bonds=(i, j, R[:, : drawn.dim]), foundation=oracle.k,
                                     model=drawn.model, drive=lambda t: -static, velocities=0 * u, displacements=u)[0]


QUESTIONS = {  # and its tolerance, by the largest entry: round-off, or what is said
    energy: 1e-11, forces: 1e-11, stiffness: 1e-11, bands: 1e-11, shapes: 1e-11,
    velocities: 1e-6,  # differences over 1e-5 of the zone; the two sides of a crossing
    steps: 1e-9,  # positions are rounded in each step
}
KINDS = 'walls', 'sites', 'layer', 'everything'


def compare(question, kind, seeds):
    """Each answer, and whether every mistake is noticed in one of the structures at least: some have all sites alike."""
    noticed, tolerance = {}, QUESTIONS[question]
    for drawn in (Drawn(kind, seed) for seed in seeds):
        if question is velocities and not (drawn.atoms.pbc.any() and drawn.dim == 2):
            continue
        found, exact = question(drawn, drawn)
        assert found.shape == exact.shape
        assert apart(found, exact) < tolerance, drawn.name
        for name, wrong in drawn.mistaken():
            _, other = question(drawn, wrong)
            seen = other.shape != exact.shape or apart(other, exact) > 1e3 * tolerance
            noticed[name] = noticed.get(name, False) or seen or (name.startswith('Fix') and question is energy)
    return noticed


def apart(found, exact):
    return abs(found - exact).max() / (abs(exact).max() or 1.0)  # waves between walls may have no velocity at all


@pytest.mark.parametrize('kind', KINDS)
@pytest.mark.parametrize('question', QUESTIONS)
def test_answers_are_those_of_single_pairs(question, kind):
    noticed = compare(question, kind, range(4))
    assert all(noticed.values()), noticed
    assert noticed or kind == 'layer'


@pytest.mark.long
@pytest.mark.parametrize('seed', range(6, 60))
@pytest.mark.parametrize('kind', KINDS)
def test_many_structures(kind, seed):
    for question in QUESTIONS:
        compare(question, kind, [seed])
