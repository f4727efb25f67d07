"""Time steps of particles each of which is its own: kinds, strengths and springs, by every engine, against textbook Verlet.

More of them: `python -m pytest -n 0 -m long tests/dynamics/test_own_sites.py`; each draw may ask numba to compile another kernel.
"""

from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixedLine
from oracles import lattice, neighbour_vectors, verlet

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, Tabulated, Yukawa, lattices

ENGINES = ['ase', 'numpy', *(['compiled'] if find_spec('numba') else [])]
TABLE = np.array([3.0, 5.0, 7.5, 14.0, 20.0, 30.0, 45.0])
MAGNETS, SOFT, SCREENED = InversePower(b=6200.0, a=4.5824), InversePower(b=25.0, a=2.0), Yukawa(c=20.0, kappa=0.3)
LAWS = [{(0, 0): MAGNETS, (1, 0): SOFT, (1, 1): SCREENED},
        {(0, 0): MAGNETS, (1, 0): Tabulated(TABLE, 4000 * TABLE**-4.0), (1, 1): SCREENED}, MAGNETS]
"""About 0.2 N at 10 mm each.  The table has knots, so that no single polynomial serves it."""
DT, STEPS = 0.02, 80
EXACT = 1e-9  # of the largest displacement: round-off of positions and of momenta over the steps


class Drawn:
    """A patch or a periodic piece, whose bonds lie on a grid or in a table, with sites of their own."""

    def __init__(self, seed):
        rng = np.random.default_rng(seed)
        cell = lattice(['triangular', 'honeycomb', 'square'][seed % 3])
        atoms = [lattices.hexagon(cell, 35.0), cell.repeat((4, 3, 1)), lattices.parallelogram(cell, 5, 6)][rng.integers(3)]
        if rng.random() < 0.5:
            atoms.positions[:, :2] += rng.uniform(-0.2, 0.2, (len(atoms), 2))
        n = len(atoms)
        atoms.set_tags(rng.integers(0, 2, n))
        atoms.set_masses(rng.uniform(0.5, 1.5, n))
        held = atoms.constraints[0].index if atoms.constraints else np.array([0])
        free = np.setdiff1d(np.arange(n), held)
        atoms.set_constraint([FixAtoms(held), FixedLine(free[-1:], (0.6, 0.8, 0))])
        few = rng.random() < 0.5  # a few strengths make kinds of bonds, all different ones do not
        self.strengths = rng.choice([0.0, 0.8, 1.0, 1.3], n) if few else rng.uniform(0.7, 1.3, n)
        self.springs = rng.uniform(0.2, 0.6, [(n, 2), (n, 1), (1, 2)][rng.integers(3)])
        self.potential, self.model = LAWS[seed % len(LAWS)], str(rng.choice(['complete', 'conventional']))
        self.atoms, size = atoms, rng.choice([1e-3, 1.2])  # the laws in one polynomial, and in pieces
        self.u, self.v = size * rng.uniform(-1, 1, (2, n, 2)) * np.isin(np.arange(n), free)[:, None]
        self.v[free[-1]] = 0.0
        atoms.calc = MagneticRepulsion(atoms, self.potential, foundation=self.springs, strengths=self.strengths, model=self.model,
                                       cutoff=12.0)

    def truth(self, strengths=None, kinds=None, springs=None):
        """By the oracle, which may mistake sites for each other."""
        strengths = self.strengths if strengths is None else strengths
        kinds = self.atoms.get_tags() if kinds is None else kinds
        found = [(i, j, v[:2]) for i, j, cell, v in neighbour_vectors(self.atoms, 12.0) if (i, cell) < (j, (0, 0, 0))]
        i, j, R = (np.array(part) for part in zip(*found, strict=True))
        known = {frozenset(pair): law for pair, law in self.potential.items()} if isinstance(self.potential, dict) else {}
        laws = [known.get(frozenset((kinds[a], kinds[b])), self.potential) for a, b in zip(i, j, strict=True)]

        def dphi(r):
            return np.array([strengths[a] * strengths[b] * law.dphi(r[n])
                             for n, (a, b, law) in enumerate(zip(i, j, laws, strict=True))])

        springs = np.broadcast_to(self.springs, (len(self.atoms), 2)) if springs is None else springs
        # what pushes at the places where the structure is drawn pushes in the engines, too
        return verlet(self.atoms, SimpleNamespace(dphi=dphi), DT, STEPS, bonds=(i, j, R), foundation=springs, model=self.model,
                      displacements=self.u, velocities=self.v)[0]

    def run(self, engine):
        atoms = self.atoms.copy()
        atoms.calc = self.atoms.calc
        atoms.positions[:, :2] += self.u
        atoms.set_momenta(atoms.get_masses()[:, None] * np.pad(self.v, ((0, 0), (0, 1))), apply_constraint=False)
        dyn = DrivenVerlet(atoms, DT, engine=engine)
        dyn.run(STEPS)
        assert dyn.engine == engine
        return dyn.displacements


def compare(seed, engine):
    drawn = Drawn(seed)
    truth, found = drawn.truth(), drawn.run(engine)
    assert abs(found - truth).max() < EXACT * abs(truth).max()
    mistaken = [drawn.truth(strengths=drawn.strengths[::-1]),
                drawn.truth(springs=np.broadcast_to(drawn.springs, found.shape)[::-1, ::-1])]
    if isinstance(drawn.potential, dict):
        mistaken.append(drawn.truth(kinds=1 - drawn.atoms.get_tags()))
    assert min(abs(found - wrong).max() for wrong in mistaken) > 1e4 * EXACT * abs(truth).max()


@pytest.mark.parametrize(('seed', 'engine'), [(0, 'ase'), (1, 'numpy'), (2, 'numpy'), (3, 'numpy'), (6, 'compiled')])
def test_engines_are_textbook_verlet_where_sites_differ(seed, engine):
    if engine == 'compiled':
        pytest.importorskip('numba')
    compare(seed, engine)


@pytest.mark.long
@pytest.mark.parametrize('engine', ENGINES)
@pytest.mark.parametrize('seed', range(7, 60))
def test_fifty_structures(seed, engine):
    compare(seed, engine)
