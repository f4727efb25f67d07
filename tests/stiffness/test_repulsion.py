"""Both calculators are a Repulsion: what is asked of one can be asked of the other, and the foundation is in every matrix."""

import numpy as np
import pytest
from ase.calculators.lj import LennardJones
from oracles import lattice

from magphonon import InversePower, MagneticRepulsion
from magphonon.stiffness import AllNeighbours
from magphonon.stiffness.matrices import MODELS
from magphonon.stiffness.repulsion import Repulsion, repulsion_of

STEEP = InversePower(b=1e12, a=12.0)  # neighbours beyond the first three shells add 1e-4 of the stiffness or less
CALCULATORS = {
    'MagneticRepulsion': lambda atoms, k: MagneticRepulsion(atoms, STEEP, foundation=k, shells=3),
    'AllNeighbours': lambda atoms, k: AllNeighbours(atoms, STEEP, foundation=k),
}
Q = np.random.default_rng(3).uniform(-1, 1, (5, 3))
LATTICES = ['chain', 'triangular', 'kagome', 'fcc']


def attached(name, kind, k=0.0):
    atoms = lattice(name)
    atoms.calc = CALCULATORS[kind](atoms, k)
    return atoms


@pytest.mark.parametrize('name', LATTICES)
def test_both_calculators_agree_where_the_law_ends_within_the_shells(name):
    near, endless = (attached(name, kind, k=0.3).calc for kind in CALCULATORS)
    q = Q * near.reference.pbc
    scale = abs(endless.bloch_matrix(q)).max()
    first = attached(name, 'MagneticRepulsion', k=0.3)
    first.calc = MagneticRepulsion(first, STEEP, foundation=0.3, shells=1)
    for model in MODELS:
        left_out = abs(near.bloch_matrix(q, model) - endless.bloch_matrix(q, model)).max()
        assert left_out < 5e-4 * scale
        assert left_out < abs(first.calc.bloch_matrix(q, model) - endless.bloch_matrix(q, model)).max()  # the control
    np.testing.assert_array_equal(near.singular(np.eye(near.dim)[0]), endless.singular(np.eye(near.dim)[0]))  # both are zero
    assert near.model == endless.model == 'complete'


def test_what_knows_no_single_bonds_is_refused_where_they_are_needed():
    atoms = attached('triangular', 'AllNeighbours')
    with pytest.raises(ValueError, match='AllNeighbours does not have'):
        repulsion_of(atoms)
    atoms.calc = LennardJones()
    assert not isinstance(atoms.calc, Repulsion)
    with pytest.raises(ValueError, match=r'attach atoms\.calc'):
        repulsion_of(atoms)
