"""Replicas: each moves as by itself, periodic or not, and what they cannot share is refused."""

import numpy as np
import pytest
from ase.constraints import FixAtoms, FixCartesian, FixCom, FixedLine
from oracles import Gaussian, neighbour_vectors, verlet

from magphonon import DrivenVerlet, InversePower, MagneticRepulsion, lattices
from magphonon.response import replicas
from magphonon.stiffness import AllNeighbours

L0, DT, STEPS, K = 10.0, 0.02, 60, 0.4
EXACT = 1e-9  # of the largest displacement, 0.1 mm and more: round-off of positions and of momenta over 60 steps


def cell_of(rng):
    """Three by three cells, periodic along both, one or no direction."""
    kind = rng.choice(['square', 'triangular', 'honeycomb'])
    atoms = getattr(lattices, kind)(L0, 0.7).repeat((3, 3, 1))
    atoms.pbc = [(1, 1, 0), (1, 0, 0), (0, 1, 0), False][rng.integers(4)]
    return atoms


def structure(rng, cell, law, model, k=K):
    """The cell with masses, particles that are held and velocities of its own; somewhat displaced from its rest."""
    atoms = cell.copy()
    atoms.set_masses(rng.uniform(0.5, 1.0, len(atoms)))
    held, guided = rng.permutation(len(atoms))[:2]
    atoms.set_constraint([FixAtoms([held]), FixedLine(guided, (0.6, 0.8, 0))])
    atoms.calc = MagneticRepulsion(atoms, law, foundation=k, model=model)
    u = rng.uniform(-0.2, 0.2, (len(atoms), 2)) * (np.arange(len(atoms)) != held)[:, None]
    atoms.positions[:, :2] += u
    v = rng.uniform(-1, 1, (len(atoms), 2))
    atoms.set_momenta(atoms.get_masses()[:, None] * np.pad(v, ((0, 0), (0, 1))), apply_constraint=False)
    return atoms, u, v


def bonds_of(atoms, periodic=True):
    """Each pair once, also of a particle and the image of another."""
    found = [(i, j, v[:2]) for i, j, cell, v in neighbour_vectors(atoms, 1.2 * L0) if i < j and (periodic or not any(cell))]
    return tuple(np.array(part) for part in zip(*found, strict=True))


def alone(atoms, u, v, law, model, periodic=True):
    rest = atoms.calc.reference
    rest.set_constraint(atoms.constraints)
    return verlet(rest, law, DT, STEPS, bonds=bonds_of(rest, periodic), foundation=atoms.calc.foundation, model=model,
                  velocities=v, displacements=u)[0]


@pytest.mark.parametrize('engine', ['ase', pytest.param('compiled', marks=pytest.mark.slow)])
@pytest.mark.parametrize('seed', range(8))
def test_each_moves_as_by_itself(engine, seed):
    rng = np.random.default_rng(seed)
    cell, law = cell_of(rng), InversePower(b=rng.uniform(2e3, 6e3), a=rng.uniform(3, 5))
    model = str(rng.choice(['complete', 'conventional']))
    springs = (K, 2 * K, rng.uniform(0, K, (len(cell), 2))) if engine == 'ase' else (K, K, K)
    drawn = [structure(rng, cell, InversePower(law.b, law.a), model, k) for k in springs]
    many = replicas([atoms for atoms, _, _ in drawn])
    dyn = DrivenVerlet(many, DT, engine=engine)
    dyn.run(STEPS)
    for found, one in zip(np.split(dyn.displacements, 3), drawn, strict=True):
        expected = alone(*one, law, model)
        assert abs(found - expected).max() < EXACT * abs(expected).max()
        if cell.pbc.any():  # the control: without the bonds across the edges of the cell, as they once were left out
            assert abs(found - alone(*one, law, model, periodic=False)).max() > 1e3 * EXACT * abs(expected).max()


def patch(law=None, foundation=0.3, model='complete', pbc=False, stretched=1.0):
    atoms = lattices.square(L0, 1.0).repeat((3, 3, 1))
    atoms.pbc = pbc
    atoms.set_cell(stretched * atoms.cell)
    atoms.calc = MagneticRepulsion(atoms, law or InversePower(b=3e3, a=4.6), foundation=foundation, model=model,
                                   bonds=[(0, 1), (1, 2)])
    return atoms


@pytest.mark.parametrize(('other', 'words'), [
    (patch(InversePower(b=9e3, a=4.6)), r'differs from structure 0 in its law \(InversePower\(b=9000.0.* instead of .*b=3000.0'),
    (patch(Gaussian()), 'in its law'),
    (patch(model='conventional'), r'in its model \(conventional instead of complete\)'), (patch(pbc=(1, 0, 0)), 'in its cell')])
def test_what_replicas_cannot_share_is_refused(other, words):
    with pytest.raises(ValueError, match=words):
        replicas([patch(), other])
    with pytest.raises(ValueError, match='differs'):
        replicas([other, patch()])
    replicas([other, other])


def test_other_cells_constraints_and_calculators_are_refused():
    with pytest.raises(ValueError, match='in its cell or periodicity'):
        replicas([patch(pbc=(1, 1, 0)), patch(pbc=(1, 1, 0), stretched=1.1)])
    replicas([patch(), patch(stretched=1.1)])  # nothing repeats
    held = patch()
    held.set_constraint(FixCom())
    with pytest.raises(ValueError, match='only FixAtoms, FixCartesian, FixedLine and FixedPlane are supported'):
        replicas([held])
    held.set_constraint(FixCartesian([1], (True, False, False)))
    (joined,) = replicas([held, held]).constraints
    assert joined.todict()['kwargs'] == {'a': [1, 1 + len(held)], 'mask': [True, False, False]}
    lattice = lattices.square(L0, 1.0)
    lattice.calc = AllNeighbours(lattice, InversePower(b=3e3, a=4.6), foundation=2.0)
    with pytest.raises(ValueError, match='AllNeighbours does not have'):
        replicas([lattice])
